"""Deviations of MAC, phase collinearity and phase deviation, against repeated measurements of known shapes."""

import numpy as np
import pytest

from structid import InputError, ModalRecord, mac
from structid.modal.modal_record import ModalChanges
from structid.modal.poles.poles import modal_phase_collinearity, modal_phase_deviation
from structid.modal.shape_uncertainty import collinearity_with_std, mac_with_std, phase_deviation_with_std

RNG = np.random.default_rng(3)
SENSORS = tuple(f"{i}Z" for i in range(1, 7))
SHAPES = RNG.standard_normal((6, 2)) * np.exp(0.3j * RNG.standard_normal((6, 2)))
OTHERS = SHAPES + 0.3 * RNG.standard_normal((6, 2))
#: Errors of entries of both modes that vary together, (12 numbers of real and imaginary parts, entries).
ROOT = 0.03 * (RNG.standard_normal((12, 6, 2)) + 1j * RNG.standard_normal((12, 6, 2))) / np.sqrt(12)


def measured(shapes, rng, stated=True):
    """Modes with shapes in error by `ROOT`."""
    seen = shapes + np.einsum("b,bcm->cm", rng.standard_normal(12), ROOT)
    changes = ModalChanges(np.zeros((12, 2)), np.zeros((12, 2)), ROOT) if stated else None
    return ModalRecord([1.0, 2.0], [0.01, 0.01], seen, SENSORS, changes=changes)


@pytest.mark.parametrize(
    ("quantity", "function"),
    [
        (collinearity_with_std, modal_phase_collinearity),
        (phase_deviation_with_std, modal_phase_deviation),
        (lambda modes: mac_with_std(modes, measured(OTHERS, np.random.default_rng(0), False)), None),
    ],
)
def test_deviations_are_the_scatter_of_repeats(quantity, function):
    """150 measurements of shapes far from real and of a MAC of 0.8 and 0.9: z rms of the corrected values 1 to within 12 %."""
    reference = measured(OTHERS, np.random.default_rng(0), False).mode_shapes
    truth = mac(SHAPES, reference) if function is None else function(SHAPES)
    rng, z = np.random.default_rng(11), []
    for _ in range(150):
        result = quantity(measured(SHAPES, rng))
        z.append(np.ravel((result.value - result.noise_effect - truth) / result.std))
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.12)


def test_two_measurements_of_one_shape_have_the_mac_that_their_errors_leave():
    """MAC of 1 less the energies of the errors across the shape; the mean of 150 repeats to 10 %, deviations never too small."""
    rng, values, results = np.random.default_rng(5), [], []
    for _ in range(150):
        results.append(mac_with_std(measured(SHAPES, rng), measured(SHAPES, rng)))
        values.append(np.diag(results[-1].value))
    lost = 1 - np.mean(values, axis=0)
    stated = -np.mean([np.diag(result.noise_effect) for result in results], axis=0)
    np.testing.assert_allclose(stated, lost, rtol=0.1)
    ratio = np.mean([np.diag(result.std) for result in results], axis=0) / np.std(values, axis=0)
    assert (ratio > 1.0).all()
    assert (ratio < 2.0).all()


def test_unknown_entries_have_no_part_and_records_without_deviations_none():
    rng = np.random.default_rng(2)
    holed = np.array(measured(SHAPES, rng).mode_shapes)
    holed[2, 0] = np.nan
    bare = ModalRecord([1.0, 2.0], [0.01, 0.01], holed, SENSORS, shape_std=np.where(np.isnan(holed), np.nan, 0.02))
    full = measured(OTHERS, rng, False)
    few = [0, 1, 3, 4, 5]
    result = mac_with_std(bare, full)
    np.testing.assert_allclose(result.value[0], mac(holed[few], full.mode_shapes[few])[0], rtol=1e-12)
    np.testing.assert_allclose(result.value, mac(holed, full.mode_shapes), rtol=1e-12)
    assert (result.std > 0).all()
    assert np.isnan(mac_with_std(full, full).std).all()
    assert np.isnan(collinearity_with_std(full).std).all()
    with pytest.raises(InputError, match="some_channels"):
        mac_with_std(bare, full.some_channels(few))
