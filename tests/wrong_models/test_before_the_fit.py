"""`check` on simulated studies: each fault of channels, samples, window and mesh is said, and right models are left alone."""

from pathlib import Path

import pytest
from wrong_models.faults import Fault
from wrong_models.study_files import Case, written

from structid.study.run.check import check_study
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study

#: What a right model has on any rig: too few lines a bandwidth, and elements as large as the truth's.
_OF_THE_TEST = (
    "lines in its half-power bandwidth;",
    "the mesh is too coarse",
    "that it lacks with these",
    "lines in its",
)


def told(tmp_path, rig, record, *faults, start="far"):
    case = Case(f"{rig}-{record}-before", rig, record, faults, start)
    written(case, tmp_path)
    result = check_study(load_study(tmp_path / "study.toml"))
    return [
        one for one in result.warnings if one.startswith("leakage:") or not any(words in one for words in _OF_THE_TEST)
    ]


@pytest.mark.parametrize("rig", ["two_span", "portal", "shear", "tower", "grillage", "truss", "rail", "hall"])
def test_right_models_that_start_far_off_are_silent(tmp_path, rig):
    records = ["frf", "frf2", "hits5", "states", *([] if rig == "hall" else ["time"])]
    for record in records:
        folder = tmp_path / record
        written(Case(f"{rig}-{record}-right", rig, record, (), "far"), folder)
        assert prepare_study(load_study(folder / "study.toml")).channel_warnings == ()


@pytest.mark.parametrize(
    "rig, record, fault, words",
    [
        ("portal", "frf", Fault("unit", "9X", "9.80665"), "sensor 9X+ reads"),
        ("two_span", "time", Fault("unit", "6Y", "9.80665"), "in m/s^2 and read as g"),
        ("rail", "frf", Fault("polarity", "3Y"), "sensor 3Y+ reads with the opposite sense"),
        ("shear", "time", Fault("polarity", "4X"), "sensor 4X+ reads with the opposite sense"),
        ("tower", "frf", Fault("swap", "9X", "12X"), "sensors 9X+ and 12X+ look exchanged"),
        ("tower", "frf", Fault("load_gain", "11X", "0.22481"), "load 11X+: the force is"),
        ("two_span", "time", Fault("clipping", "4Y", "0.35"), "channel 4Y+ acceleration is clipped"),
        ("rail", "h1", Fault("window", "any", "512"), "leakage: window 'hann'"),
        ("portal", "frf2", Fault("load_swap", "any"), "reciprocity: 4X under a load at 7Y"),
    ],
)
def test_faults_are_said_and_their_twins_are_not(tmp_path, rig, record, fault, words):
    assert told(tmp_path / "right", rig, record) == []
    assert any(words in one for one in told(tmp_path / "wrong", rig, record, fault, start="near"))


def test_the_mesh_is_judged_and_few_averages_are_told(tmp_path):
    case = Case("rail-hits5-before", "rail", "hits5", (), "near")
    written(case, tmp_path)
    result = check_study(load_study(tmp_path / "study.toml"))
    assert result.mesh.needed == 2
    assert "`subdivide = 2` in [structure]" in result.mesh.words
    [fact] = result.beside[0].facts
    assert fact.startswith("coherence from 5 averages: a chi-square of 1.67 per degree of freedom is expected")
    text = (tmp_path / "study.toml").read_text().replace("subdivide = 1\n", "subdivide = 4\n", 1)
    (tmp_path / "study.toml").write_text(text)
    finer = check_study(load_study(tmp_path / "study.toml"))
    assert finer.mesh.words == ""
    hall = Case("hall-frf-before", "hall", "frf", (), "near")
    written(hall, tmp_path / "hall")
    assert "come from elsewhere" in check_study(load_study(tmp_path / "hall" / "study.toml")).mesh


def test_the_first_structure_is_told_what_will_go_wrong():
    """Its first mode lies between two lines of the model and has no peak there; the table finds it among the modes."""
    study = Path(__file__).parents[2] / "examples" / "first_structure" / "study.toml"
    result = check_study(load_study(study))
    assert result.warnings[0].startswith("the mesh is too coarse: mode 3 at 133.3 Hz is 1.5 % too high")
    assert any(words.startswith("leakage: window 'hann'") and "(0.26 lines" in words for words in result.warnings)
    pairs = result.beside[0].resonances
    assert [pair.model for pair in pairs] == pytest.approx([6.38, 44.7, 133.3], rel=2e-3)
    assert pairs[0].mac != pairs[0].mac
    assert pairs[1].mac > 0.95


def test_measured_resonances_stand_beside_the_models(tmp_path):
    for record in ("frf", "modal"):
        written(Case(f"rail-{record}-pairs", "rail", record, (), "near"), tmp_path / record)
        result = check_study(load_study(tmp_path / record / "study.toml"))
        pairs = result.beside[0].resonances
        assert len(pairs) >= 4
        for pair in pairs[:4]:
            assert abs(pair.model / pair.measured - 1) < 0.12
            assert pair.mac > 0.9
            near = min(result.modes, key=lambda mode: abs(mode.frequency - pair.model))
            width = near.damping_ratio * pair.model
            assert pair.half_bandwidths == pytest.approx((pair.model - pair.measured) / width, rel=1e-6)
