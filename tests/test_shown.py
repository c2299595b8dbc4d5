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


def test_wrong_names_are_guessed_and_the_names_that_exist_are_listed():
    found = estimate()
    assert found["stiffness[columns <b>:1]"] == found.estimate["stiffness[columns <b>:1]"]
    with pytest.raises(
        sid.InputError, match=r"^no parameter 'stiffness'; did you mean 'stiffness\[columns <b>:1\]' or"
    ):
        found["stiffness"]
    with pytest.raises(sid.InputError, match=r"did you mean 'stiffness\[columns <b>:2\]'.*there are "):
        found["stifness[columns b:2]"]


def test_comparisons_and_modes_of_a_file_are_printed_as_tables(tmp_path):
    found = estimate()
    compared = sid.compare_states(found.estimate, found.estimate)
    assert str(compared).splitlines()[0] == compared.words == "no parameter changed (joint risk 5 %)"
    assert [line.split("  ")[0] for line in str(compared).splitlines()[2:]] == list(compared.names)
    assert "array(" not in repr(compared)
    with pytest.raises(sid.InputError, match=r"`later` must be an estimate, got Identification; .* `.estimate`"):
        sid.compare_states(found.estimate, found)
    t = np.arange(600)[:, None] * 0.02
    decay = np.exp(-0.1 * t) * (np.cos(20 * t) * [[1.0, 1.0]] + np.cos(50 * t) * [[1.0, -1.0]])
    sid.write_record(tmp_path / "decay.csv", sid.TimeRecord(50.0, decay, ("2X", "3X"), ("displacement",) * 2))
    result = sid.modes_of_file(tmp_path / "decay.csv")
    assert str(result).startswith("decay.csv, by pencil: 2 modes at 2 channels")
    assert str(result).splitlines()[1:] == str(result.modes).splitlines()[1:]
    assert len(repr(result)) < 120


def test_arguments_of_another_class_are_named_with_the_remedy(tmp_path):
    built, given = structure(), sid.with_declared_noise(record(), 0.01)
    unknown = sid.parameters(built, sid.Unknown("stiffness", "columns <b>"))
    setup = sid.Setup(built, unknown, given)
    bare = sid.Structure({1: [0.0], 2: [1.0], 3: [2.0]}, built.elements[1:], ["1X"], active=["X"])
    for call, words in (
        (lambda: sid.identify_together(setup), r"`setups` must be a list of set-ups, got a single one; write `\[setup\]`"),
        (lambda: sid.identify_together([(built, unknown)]), r"`setups\[0\]` must be .* got tuple; make it by `Setup`"),
        (lambda: sid.identify(built, unknown, given, {"band": (1, 9)}), r"`options` must be .* got dict; make it"),
        (lambda: sid.identify(built, sid.parameters(built, []), given), r"nothing is unknown; give .* one `Unknown`"),
        (lambda: sid.identify(bare, unknown, given), "made for another structure; make them by"),
        (lambda: sid.parameters(built, sid.Unknown("columns <b>", "stiffness")),
         r"is an element set and 'stiffness' its property; write `Unknown\('stiffness', 'columns <b>'\)`"),
        (lambda: sid.run_study("frame.toml"), r"`study` must be of class Study, got str; make it by `load_study\(path\)`"),
        (lambda: sid.read_record(given.values), r"`path` must be .* got ndarray; of arrays make a record by `FrfRecord`"),
        (lambda: sid.read_record(5), r"`path` must be of class str or PathLike, got int; give the path of a file"),
        (lambda: sid.write_record(given, tmp_path / "a.csv"), r"`path` must be .* got FrfRecord; the path comes first"),
        (lambda: sid.identify_modes(history(), {"rate": 2}), r"`method` must be of class str, got dict"),
        (lambda: sid.identify_modes(history(), band=(1, 2)), r"`band` is no setting of `identify_modes`; there are "),
    ):  # fmt: skip
        with pytest.raises(sid.InputError, match=words):
            call()


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
    for named in (found, told):
        assert ("stiffness[columns <b>:2]" in named, "mass" in named, 0 in named) == (True, False, False)
        assert list(named) == ["stiffness[columns <b>:1]", "stiffness[columns <b>:2]"]
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
