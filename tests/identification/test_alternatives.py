"""Sets of values that fit the data equally well: all are found, listed side by side, and called undetermined."""

import json
from dataclasses import replace

import numpy as np
import pytest
from frame_solutions import all_frames, frame, frame_frequencies, frame_matrices, frame_setup
from typer.testing import CliRunner

import structid as sid
from structid.cli import app as cli
from structid.forward import ModalSettings
from structid.identification.identify import identify_together
from structid.identification.options import IdentifyOptions
from structid.identification.search import wide_starts
from structid.identification.setups.modal import ModalSetup
from structid.inversion.search.multistart import expected_answers
from structid.report.identification import report_page

THREE = np.array([697.0, 446.0, 530.0]), np.array([90e3, 300e3, 210e3])
FOUR = np.array([737.0, 454.0, 554.0, 215.0]), np.array([260e3, 390e3, 340e3, 370e3])


@pytest.fixture(scope="module")
def three():
    return identify_together([frame_setup(THREE[0], frame_frequencies(*THREE))])


@pytest.mark.parametrize(
    ("masses", "stiffness", "count"), [(*THREE, 4), pytest.param(*FOUR, 6, marks=pytest.mark.long)]
)
def test_all_frames_of_the_same_frequencies_are_listed(masses, stiffness, count):
    frequency = frame_frequencies(masses, stiffness)
    truths = all_frames(masses, frequency, 500)
    found = identify_together([frame_setup(masses, frequency)])
    sets = found.alternatives
    assert len(truths) == len(sets) == count
    for truth in truths:
        assert np.abs(sets.values / truth - 1).max(axis=1).min() < 1e-5
    assert sets.is_exhaustive
    assert found.estimate.status is sid.Status.NOT_IDENTIFIABLE
    np.testing.assert_array_equal(sets.values[0], found.estimate.values)
    assert found.estimate.search.n_starts < 200


@pytest.mark.long
def test_a_search_that_ends_between_two_frames_goes_on_to_both():
    """At 0.1 % the first search ends where the frequencies do not see the way from one frame to the other."""
    masses = np.array([1446.0, 1212.0, 1243.0, 1249.0])
    frequency = frame_frequencies(masses, np.array([2.6923e6, 1.759e6, 1.849e6, 1.2231e6]))
    truths = all_frames(masses, frequency, 500)
    found = identify_together([frame_setup(masses, frequency, start=1.5e6, error=1e-3)])
    assert len(truths) == 2
    for truth in truths:
        assert np.abs(found.alternatives.values / truth - 1).max(axis=1).min() < 1e-4


def test_what_would_decide_is_what_the_frames_predict_most_differently(three):
    """Every other ratio of two entries of a shape has two frames that are nearer, by the angle whose tangent it is."""
    deciding = three.alternatives.deciding
    angles = []
    for values in three.alternatives.values:
        eigenvalues, shapes = np.linalg.eig(frame_matrices(THREE[0], values))
        angles.append([[np.arctan2(s[i], s[j]) % np.pi for i in range(3) for j in range(3) if i != j]
                       for s in shapes.T[np.argsort(eigenvalues)]])  # fmt: skip
    ordered = np.sort(np.array(angles), axis=0)
    gaps = np.diff(np.concatenate([ordered, ordered[:1] + np.pi]), axis=0).min(axis=0)
    mode, above, below = int(deciding.name.split()[4]), deciding.name.split()[6][0], deciding.name.split()[-1][0]
    own = np.arctan2(1.0, 1 / np.array(deciding.predicted)) % np.pi
    own = np.sort(own)
    assert np.diff([*own, own[0] + np.pi]).min() == pytest.approx(gaps.max(), rel=1e-6)
    eigenvalues, shapes = np.linalg.eig(frame_matrices(THREE[0], three.alternatives.values[1]))
    shape = shapes[:, np.argsort(eigenvalues)[mode - 1]]
    assert deciding.predicted[1] == pytest.approx(shape[int(above) - 1] / shape[int(below) - 1], rel=1e-5)


def test_the_deciding_measurement_leaves_one_frame():
    """The shape of one mode at two floors, with the frequencies: one frame fits, and the verdict is no longer open."""
    frequency = frame_frequencies(*THREE)
    eigenvalues, shapes = np.linalg.eig(frame_matrices(*THREE))
    shapes = shapes[:, np.argsort(eigenvalues)]
    measured = np.full((2, 3), np.nan)
    measured[:, 2] = shapes[[2, 0], 2]
    found = identify_together([frame_setup(THREE[0], frequency, shapes=measured, channels=("3X", "1X"))])
    assert found.alternatives is None
    np.testing.assert_allclose(found.estimate.values, THREE[1], rtol=1e-4)


@pytest.mark.parametrize(
    ("n_searches", "n_answers", "expected"), [(7, 1, 1.5), (46, 4, 4.5), (13, 4, 48 / 7), (3, 1, np.inf)]
)
def test_expected_number_of_minima(n_searches, n_answers, expected):
    assert expected_answers(n_searches, n_answers) == pytest.approx(expected)


def test_wide_starts_are_made_for_few_values_of_small_models_alone():
    masses, stiffness = THREE
    frequency = frame_frequencies(masses, stiffness)
    eigenvalues, shapes = np.linalg.eig(frame_matrices(masses, stiffness))
    shapes = shapes[:, np.argsort(eigenvalues)]
    bare = frame_setup(masses, frequency)
    full = frame_setup(masses, frequency, shapes=shapes, channels=("1X", "2X", "3X"))
    one_entry = frame_setup(masses, frequency, shapes=shapes[:1], channels=("1X",))
    options = IdentifyOptions()
    assert [wide_starts([one.prepared(options).problem]) for one in (bare, full, one_entry)] == [200, 0, 200]
    large = frame_setup(np.full(120, 500.0), np.array([1.0, 2.0, 3.0]))
    assert wide_starts([large.prepared(options).problem]) == 25
    assert identify_together([bare], replace(options, wide_starts=0)).alternatives is None


def test_a_combination_that_the_data_leave_open_is_not_searched_widely():
    """Two frequencies of three stiffnesses: a curve of answers, which is told by its direction and takes one search."""
    found = identify_together([frame_setup(THREE[0], frame_frequencies(*THREE)[:2])])
    assert found.estimate.status is sid.Status.NOT_IDENTIFIABLE
    assert found.estimate.search.n_starts == 1
    assert found.alternatives is None


def test_frequencies_that_no_values_give_are_no_answer():
    """With one stiffness for all storeys the ratio of two frequencies is fixed: as many values as parameters, and a misfit."""
    structure = frame(THREE[0], 2.5e5)
    unknown = sid.parameters(
        structure,
        [sid.Unknown("stiffness", "storey"), sid.Unknown("mass", "floor", factor=True, prior=sid.Prior(1.0, 0.001))],
    )
    record = sid.ModalRecord(np.array([2.0, 3.0]), np.full(2, np.nan), np.full((1, 2), np.nan), ("1X",))
    found = identify_together([ModalSetup(structure, unknown, record, ModalSettings(frequency_error=0.002))])
    assert found.estimate.covariance_basis == "model_error"


STUDY = """\
title = "Three storeys from their frequencies"
[structure]
active = ["X"]
fixed = ["0X"]
[structure.nodes]
0 = [0.0, 0.0]
1 = [0.0, 3.0]
2 = [0.0, 6.0]
3 = [0.0, 9.0]
[[structure.point_mass]]
name = "floor"
nodes = [1, 2, 3]
mass = [697.0, 446.0, 530.0]
[[structure.spring]]
name = "storey"
first = ["0X", "1X", "2X"]
second = ["1X", "2X", "3X"]
stiffness = 2.5e5
[[unknown]]
property = "stiffness"
elements = "storey"
each = true
[record]
path = "modes.csv"
[record.modes]
frequency_error = 0.002
"""


def written(folder, frequency, text=STUDY):
    rows = "\n".join(f"{value:.15g}" for value in frequency)
    (folder / "modes.csv").write_text(f"Frequency [Hz]\n{rows}\n", encoding="utf-8")
    (folder / "frame.toml").write_text(text, encoding="utf-8")
    return str(folder / "frame.toml")


def test_a_study_of_frequencies_alone_lists_all_frames_and_exits_1(tmp_path):
    study = written(tmp_path, frame_frequencies(*THREE))
    done = CliRunner().invoke(cli.app, ["identify", study, "--out", str(tmp_path / "out")])
    assert done.exit_code == 1
    assert "Undetermined: these frequencies alone allow 4 sets of values" in done.output
    assert "nan" not in done.output
    result = json.loads((tmp_path / "out" / "estimate.json").read_text(encoding="utf-8"))
    assert result["verdict"] == "undetermined"
    told = np.array([list(one["values"].values()) for one in result["alternatives"]["sets"]])
    for truth in all_frames(THREE[0], frame_frequencies(*THREE), 500):
        assert np.abs(told / truth - 1).max(axis=1).min() < 1e-5
    assert "Sets of values that fit equally well" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_as_many_frequencies_as_parameters_and_one_answer_are_untested(tmp_path):
    """One stiffness from one frequency: it fits whatever the model, and nothing says otherwise, no number is missing."""
    text = STUDY.replace("each = true\n", "")
    study = written(tmp_path, frame_frequencies(*THREE)[:1], text)
    done = CliRunner().invoke(cli.app, ["identify", study, "--out", str(tmp_path / "out"), "--no-report"])
    assert done.exit_code == 1
    assert done.output.startswith("Untested:")
    assert "nan" not in done.output


def test_the_page_shows_the_sets_side_by_side(three):
    table = report_page(three).words["alternatives"][1]
    assert table.header[2:] == ("Set 1", "Set 2", "Set 3", "Set 4")
    assert len(table.rows) == 4
    assert report_page(replace(three, alternatives=None)).words["alternatives"] is None
