"""A gain that all sensors of a record share, which only several loads distinguish from that of one load."""

from __future__ import annotations

import numpy as np
import pytest
from frame_cases import FREQUENCY, STUDY, off, written, written_modes, written_shaken
from test_each_cause import begun, require_explained

from structid.core.errors import InputError
from structid.core.units import STANDARD_GRAVITY
from structid.diagnose.causes import Mass, RecordGain, SensorGain, candidates
from structid.diagnose.receptances import receptances_at
from structid.diagnose.refits import fit_fully
from structid.diagnose.screening import _exchanged
from structid.diagnose.tested_model import TestedModel
from structid.inversion.search.work import PLAIN_CONTEXT
from structid.records import FrfRecord
from structid.records.formats import write_record
from structid.study.run.diagnosis import diagnose_study, suggestion_text
from structid.study.run.run import run_prepared
from structid.study.run.start import prepare_study, study_problems
from structid.study.schema.study import load_study

MASS = '[[structure.point_mass]]\nname = "more"\nnodes = [4]\nmass = 0.3\n\n'
HEAVIER = STUDY.replace("[[unknown]]", f"{MASS}[[unknown]]", 1)
OUTPUTS, LOADS = ("2X", "3X", "4Y", "5Y"), ("2X", "4Y")


def written_with_loads(folder, gain=1.0, outputs=OUTPUTS, loads=LOADS, truth=STUDY, text=STUDY, sensor_gain=1.0):
    """A study whose sensors all read `gain` times the truth, the first `sensor_gain` times more, under several loads."""
    blank = np.ones((len(FREQUENCY), len(outputs), len(loads)), complex)
    write_record(folder / "frf.npz", FrfRecord(FREQUENCY, blank, outputs, loads, "accelerance"))
    path = folder / "study.toml"
    path.write_text(truth.replace("absolute = 1e-6", "absolute = 1e-3"), encoding="utf-8")
    [problem] = study_problems(load_study(path))
    values = gain * problem.predicted(problem.theta_start)
    values[:, 0] *= sensor_gain
    rng = np.random.default_rng(1)
    errors = rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape)
    values = values + errors / np.sqrt(2) * np.hypot(0.01 * np.abs(values), 1e-3)
    write_record(folder / "frf.npz", FrfRecord(FREQUENCY, values, outputs, loads, "accelerance"))
    path.write_text(text.replace("absolute = 1e-6", "absolute = 1e-3"), encoding="utf-8")
    return path


def point_of(base):
    return base.modified.point_at(base.modified.shown_problems, base.theta + 0.002)


def gains(base):
    return [one for one in candidates(point_of(base).records) if isinstance(one, RecordGain)]


def test_it_is_offered_for_several_loads_alone(tmp_path):
    [gain] = gains(begun(written_with_loads(tmp_path)))
    assert (gain.where, gain.record, gain.record_name) == (("all sensors",), 0, "")
    [roving] = gains(begun(written_with_loads(tmp_path, outputs=("3X",))))
    assert (roving.where, roving.sensor) == (("3X",), "3X")
    assert gains(begun(written(tmp_path))) == []
    assert gains(begun(written_shaken(tmp_path))) == []


def test_its_effect_is_that_of_the_changed_study(tmp_path):
    base = begun(written_with_loads(tmp_path))
    view = base.modified.views[0].problem
    [gain], fields = gains(base), receptances_at(view, view.theta_start)
    changed = base.modified.changed(gain, np.log(0.1)).views[0].problem
    lines = np.searchsorted(view.frequency, fields.problem.frequency)
    own = changed.predicted(changed.theta_start)[lines] - fields.frf
    np.testing.assert_allclose(gain.effect(fields, np.log([0.1]))[0], own, rtol=1e-6)


@pytest.mark.parametrize("factor", [1 / STANDARD_GRAVITY, 1.1])
def test_it_ranks_first_and_its_fit_alone_explains_all(tmp_path, factor):
    base = begun(written_with_loads(tmp_path, factor))
    point = point_of(base)
    first = min(point.screened(point.candidates([""])), key=lambda row: row.left)
    assert first.candidate.kind == "record_gain"
    assert first.strength == pytest.approx(np.log(factor), abs=0.1)
    one = first.candidate
    if factor < 0.5:  # it is fitted whatever else the looks show
        assert one.key in _exchanged(base, [point])
    fitted, _ = require_explained(base, one, first.strength, tmp_path)
    assert fitted.values["gain[all sensors]"] == pytest.approx(factor, rel=0.01)
    _, lines = suggestion_text(load_study(tmp_path / "study.toml"), fitted.modified.changes)
    assert '+ outputs = "all"' in lines


def test_a_factor_that_is_neither_of_a_unit_nor_of_a_calibration_is_no_cause(tmp_path):
    base = begun(written_with_loads(tmp_path, 60.0))
    [gain] = gains(base)
    theta = base.modified.changed(gain, np.log(60.0)).theta_of(base.values)
    assert fit_fully(base, (gain, np.log(60.0), theta), PLAIN_CONTEXT) == {}


@pytest.mark.parametrize(
    ("truth", "sensor_gain", "kind"),
    [
        (STUDY, 1.5, SensorGain),
        (HEAVIER, 1.0, Mass),
    ],
)
def test_it_does_not_push_out_a_gain_of_one_sensor_nor_a_mass(tmp_path, truth, sensor_gain, kind):
    base = begun(written_with_loads(tmp_path, truth=truth, sensor_gain=sensor_gain))
    point = point_of(base)
    rows = point.screened(point.candidates([""]))
    assert isinstance(min(rows, key=lambda row: row.left).candidate, kind)
    [own] = [row for row in rows if isinstance(row.candidate, RecordGain)]
    assert own.left > 3 * min(row.left for row in rows)


def test_modes_have_none(tmp_path):
    ready = prepare_study(load_study(written_modes(tmp_path)))
    with pytest.raises(InputError, match="modes do not show"):
        RecordGain(where=("all sensors",)).edits(TestedModel(ready.setups, ready.study.options), 0.1)


@pytest.mark.parametrize(
    ("given", "value", "kind", "words"),
    [
        (
            {},
            1 / STANDARD_GRAVITY,
            "unit",
            "all sensors are in another unit than stated: in g and read as m/s^2, or all loads in N and read as kgf",
        ),
        ({}, 39.37, "unit", "all sensors are in another unit than stated: in in and read as m"),
        ({}, 4.448, "unit", "all loads are in another unit than stated: in lbf and read as N"),
        ({"are_rotations": (False, True)}, 39.37, "record_gain", None),
        (
            {"record_name": "first"},
            1.25,
            "record_gain",
            "the calibration of all sensors is off by a factor of 1.25, or that of all loads by 0.8 in record first",
        ),
        ({"sensor": "3X"}, None, "record_gain", "the calibration of sensor 3X is off, or that of all loads"),
        (
            {"sensor": "3X"},
            1e3,
            "unit",
            "sensor 3X is in another unit than stated: in mm and read as m, or all loads in kN and read as N",
        ),
    ],
)
def test_its_words_name_the_unit_of_sensors_and_loads_or_both_calibrations(given, value, kind, words):
    gain = RecordGain(where=("all sensors",), **given)
    assert gain.named_kind(value) == kind
    assert words is None or gain.sentence(value) == words


@pytest.mark.long
def test_accelerations_in_g_under_two_loads_are_the_first_cause(tmp_path):
    ready = prepare_study(load_study(written_with_loads(tmp_path, 1 / STANDARD_GRAVITY, text=off())))
    first = diagnose_study(ready, run_prepared(ready))[0].diagnosis.causes[0]
    assert (first.kind, first.where) == ("unit", ("all sensors",))
    assert "in g and read as m/s^2" in first.words
    assert first.chi_square_per_dof == pytest.approx(1.0, abs=0.15)
