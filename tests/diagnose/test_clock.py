"""A clock that is off: named where a stiffness is held, with the factor, and one factor on all stiffnesses beside it."""

from dataclasses import replace

import pytest
from frame_cases import STUDY, written
from test_each_cause import begun

from structid.diagnose.causes.clock import Clock
from structid.diagnose.refits import fit_fully, restore_fit
from structid.inversion.search.work import PLAIN_CONTEXT
from structid.records.formats import read_record, write_record
from structid.study.run.diagnosis import diagnose_study
from structid.study.run.run import run_prepared
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study


@pytest.mark.parametrize(
    ("factor", "words"), [(1.02, "off by a factor of 1.02"), (1 / 6.283185, "(rad/s taken for Hz)")]
)
def test_a_fit_gives_the_factor_of_the_axis(tmp_path, factor, words):
    path = written(tmp_path)
    record = read_record(tmp_path / "frf.npz")
    write_record(tmp_path / "frf.npz", replace(record, frequency=record.frequency / factor))
    base = begun(path)
    theta = base.modified.changed(Clock(), factor).theta_of(base.values)
    fit = restore_fit(base, Clock(), fit_fully(base, (Clock(), 0.996 * factor, theta), PLAIN_CONTEXT))
    assert fit.modified.changes[-1].strength == pytest.approx(factor, rel=4e-3)
    assert fit.chi_square < 1.5 * fit.modified.target.n_data < 0.05 * base.chi_square
    assert words in Clock().sentence(factor)
    assert f"{factor**-2:.4g} times on all stiffnesses looks the same" in Clock().sentence(factor)


@pytest.mark.long
def test_a_slow_clock_is_named_among_the_causes(tmp_path):
    path = written(tmp_path, STUDY)
    record = read_record(tmp_path / "frf.npz")
    write_record(tmp_path / "frf.npz", replace(record, frequency=record.frequency / 1.05))
    ready = prepare_study(load_study(path))
    result, _ = diagnose_study(ready, run_prepared(ready))
    assert result.diagnosis.judgement.verdict == "wrong_model"
    assert "clock" in [cause.kind for cause in result.diagnosis.named[:3]]
