"""The page of sensed motion shows the bands that were stated, sensors that were left out, and what the record does not tell."""

import numpy as np
import pytest
from page_parts import as_array, figures, words
from report_cases import sensed

from structid.report.sensing import sensing_page


def test_bands_are_95_percent_of_the_stated_deviations():
    motion = sensed()
    assert motion.checks[0][1] == pytest.approx(1.0)
    drawn = figures(sensing_page(motion, "Mast", "wind.h5").text)
    assert set(drawn) == {"sensed_motion", "sensed_left_out", "sensed_forces"}
    for name, value, std in (
        ("sensed_motion", motion.values[:, 0], motion.std[:, 0]),
        ("sensed_left_out", motion.left_out[0].sensed, motion.left_out[0].std),
        ("sensed_forces", motion.forces[:, 0], motion.force_std[:, 0]),
    ):
        [panel] = drawn[name]
        area, curve = panel["data"][:2]
        np.testing.assert_allclose(as_array(curve["y"]), value, rtol=1e-5)
        np.testing.assert_allclose(as_array(area["y"])[: len(value)], value + 1.959964 * std, rtol=1e-5)
    measured = drawn["sensed_left_out"][0]["data"][2]
    np.testing.assert_allclose(as_array(measured["y"]), motion.left_out[0].measured, rtol=1e-5)


def test_a_long_history_is_drawn_by_the_extremes_of_bins():
    motion = sensed(n=9000)
    page = sensing_page(motion, "Mast", "wind.h5").text
    assert "Samples are drawn by minimum and maximum of short bins." in page
    assert "of short bins" not in sensing_page(sensed(), "Mast", "wind.h5").text
    [panel] = figures(page)["sensed_left_out"]
    area, curve, measured = (as_array(trace["y"]) for trace in panel["data"])
    for drawn, value in ((curve, motion.left_out[0].sensed), (measured, motion.left_out[0].measured)):
        bins = value.reshape(1500, 6)
        np.testing.assert_allclose(drawn, np.column_stack([bins.min(axis=1), bins.max(axis=1)]).ravel(), rtol=1e-5)
    high, low = area[:3000], area[3000:6000][::-1]
    assert ((low < curve) & (curve < high)).all()
    left = motion.left_out[0]
    top, bottom = left.sensed + 1.959964 * left.std, left.sensed - 1.959964 * left.std
    np.testing.assert_allclose((high.max(), low.min()), (top.max(), bottom.min()), rtol=1e-5)


def test_a_contradicted_model_is_told_first():
    text = words(sensing_page(sensed("the model does not explain the record"), "Mast", "wind.h5").text)
    assert text.index("Do not rely on this") < text.index("Motion at the wanted places")
    assert "The model does not explain the record." in text
    assert "the record hardly determines the force at 2X+" in text
    assert "Do not rely on this" not in words(sensing_page(sensed(), "Mast", "wind.h5").text)
