"""What Python and notebooks show: short texts, tables with every row, labelled arrays."""

from dataclasses import replace

import numpy as np
import pytest

import structid as sid
from structid.core.display import first_warnings


def structure():
    nodes = {1: [0.0], 2: [1.0], 3: [2.0]}
    spring = sid.Spring("columns <b>", ["1X", "2X"], ["2X", "3X"], stiffness=[900.0, 700.0], loss_factor=0.02)
    return sid.Structure(nodes, [sid.PointMass("floors", [2, 3], 2.0), spring], ["1X"], active=["X"])


def record():
    rng = np.random.default_rng(1)
    values = rng.standard_normal((40, 2, 1)) + 1j * rng.standard_normal((40, 2, 1))
    return sid.FrfRecord(np.arange(1.0, 41), values, ("2X", "3X-"), ("3X",), "accelerance")


def modes():
    return sid.ModalRecord(
        np.array([2.0, 5.0]), np.array([0.01, np.nan]), np.eye(2), ("2X", "3X"), covariance=np.diag([1, 4, 9, 16.0])
    )


def history():
    return sid.TimeRecord(10.0, np.arange(6.0).reshape(3, 2), ("2X", "3X"), ("force", "acceleration"))


def estimate():
    built = structure()
    unknown = sid.parameters(built, [sid.Unknown("stiffness", "columns <b>", each=True)])
    like = replace(record(), frequency=np.linspace(0.5, 8, 40), outputs=("2X", "3X"))
    given = sid.simulated_record(built, unknown, like, 0.01, np.random.default_rng(2))
    return sid.identify(built, unknown, given)


@pytest.mark.parametrize("made", [structure, record, modes, history], ids=lambda one: one.__name__)
def test_text_of_an_object_is_short_and_its_table_is_whole(made):
    shown = made()
    assert repr(shown).startswith(f"<{type(shown).__name__}: ")
    assert len(repr(shown)) < 250
    assert "array(" not in repr(shown)
    lines = str(shown).splitlines()
    assert len(lines) == 2 + len(shown.overview().rows)
    page = shown._repr_html_()
    assert page.count("<tr>") == len(lines) - 1
    assert "columns <b>" not in page


def test_estimates_show_values_and_name_what_there_is():
    found = estimate()
    told = found.estimate
    assert len(repr(told)) < 200
    assert repr(told)[10:] == repr(found)[16:]
    value = told["stiffness[columns <b>:1]"]
    assert value == (value.value, value.std)
    assert value.value == pytest.approx(900, rel=0.02)
    with pytest.raises(KeyError, match=r"no parameter 'mass'; there are stiffness\[columns <b>:1\], "):
        told["mass"]
    assert "stiffness[columns <b>:2]" in told.summary()


def test_data_frames_have_a_row_for_each():
    pandas = pytest.importorskip("pandas")
    told = estimate().estimate
    frame = told.to_dataframe()
    assert isinstance(frame, pandas.DataFrame)
    assert frame["value"].to_numpy() == pytest.approx(told.values)
    assert frame[["low", "high"]].to_numpy() == pytest.approx(told.interval())
    shapes = modes().to_dataframe()
    assert shapes.loc[2].to_numpy()[:2].tolist() == [5.0, 2.0]
    assert shapes["damping_std"].tolist() == [3.0, 4.0]


def test_labelled_arrays_find_a_channel_by_name():
    pytest.importorskip("xarray")
    given = record()
    labelled = given.to_xarray()
    assert labelled.sel(output="3X-", input="3X+", frequency=7.0).item() == given.values[6, 1, 0]
    assert history().to_xarray().sel(channel="3X+ acceleration", time=0.2).item() == 5.0


def test_warnings_are_folded_to_the_first_five():
    told = [f"number {i}" for i in range(25)]
    assert first_warnings(told[:5]) == [f"warning: number {i}" for i in range(5)]
    assert first_warnings(told) == [*(f"warning: number {i}" for i in range(5)), "20 more warnings: in the results"]
    assert first_warnings(told[:6])[-1] == "1 more warning: in the results"


def test_an_identification_prints_its_verdict_and_states():
    found = estimate()
    lines = str(found).splitlines()
    assert lines[0].startswith("Sound: ")
    assert lines[1] == "Use the values with their intervals."
    assert [line.split()[-1] for line in lines[3:]] == ["determined"] * len(found.estimate.names)
    view = sid.results_view(found)
    assert [one.value for one in view.parameters] == found.estimate.values.tolist()
    assert view.ranked_channels[0].error == max(one.error for one in view.channels)


def test_parameters_and_studies_show_starts_and_priors():
    unknown = sid.parameters(
        structure(), [sid.Unknown("stiffness", "columns <b>", each=True, prior=sid.Prior(1.0, 0.1))]
    )
    assert repr(unknown) == "<Parameters: 2 parameters, 2 with a prior>"
    assert "stiffness[columns <b>:1]  900" in str(unknown)
