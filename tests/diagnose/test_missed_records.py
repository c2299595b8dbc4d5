"""A record that the answer misses is told, however many values of another record hide it."""

from dataclasses import replace

import numpy as np
import pytest
from frame_cases import STUDY, off, written, written_modes

from structid.diagnose.verdict import Cause, are_causes
from structid.identification.identified import missed_parts
from structid.identification.joint_problem import freed_problems
from structid.inversion.fixed_values import FixedValueInfluence
from structid.modal.formats.files import read_modes, write_modes
from structid.study.run.diagnosis import diagnose_study
from structid.study.run.run import run_prepared
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study
from structid.unknowns.tolerances import Tolerances

_MODES = '[[record]]\nname = "ambient"\npath = "modes.json"\n\n[record.modes]\n\n[method]'


def both_records(folder, factor=1.0, text=STUDY, truth=STUDY):
    """FRFs with modes whose frequencies are `factor` times what the FRFs say."""
    written_modes(folder)
    path = written(folder, truth=truth)
    record = read_modes(folder / "modes.json")
    write_modes(folder / "modes.json", replace(record, frequency=factor * record.frequency))
    both = off(text).replace("[record]\n", '[[record]]\nname = "hammer"\n').replace("[method]", _MODES)
    path.write_text(both, encoding="utf-8")
    return path


def answered(path, explain=None):
    ready = prepare_study(load_study(path))
    return diagnose_study(ready, run_prepared(ready), explain)[0]


def test_modes_of_another_state_are_told_beside_many_lines_that_fit(tmp_path):
    result = answered(both_records(tmp_path, 1.005), explain=False)  # the verdict needs no cause
    found, diagnosis = result.identification, result.diagnosis
    assert found.estimate.chi_square_per_dof < 1.25, "the whole misfit shows nothing"
    assert found.missed[0].what == "the frequencies of record ambient"
    assert found.missed[0].n_values == 5
    assert found.missed[0].n_others == found.estimate.goodness.n_data - 5
    assert diagnosis.judgement.verdict == "wrong_model"
    assert "the frequencies of record ambient are missed by" in diagnosis.judgement.words


def test_modes_of_the_same_state_are_not(tmp_path):
    result = answered(both_records(tmp_path))
    assert result.identification.missed == ()
    assert result.diagnosis.judgement.verdict == "sound"


@pytest.mark.parametrize(("size", "is_missed"), [(1.0, False), (1.2, False), (5.0, True)])
def test_a_part_is_missed_where_its_values_are_far_beyond_their_errors(tmp_path, size, is_missed):
    """By the sum of squares of the part alone: residuals of a problem whose frequencies are moved by hand."""
    result = answered(both_records(tmp_path))
    found = result.identification
    modal = found.problems[1]
    moved = modal.data.frequency + size * modal.data.frequency_std * np.array([1, -1, 1, -1, 1])
    record = replace(modal.record, frequency=moved)
    problem = replace(modal, record=record)
    told = missed_parts(["hammer", "ambient"], (found.problems[0], problem), found.estimate)
    assert bool(told) == is_missed


def test_fixed_values_whose_influence_could_not_be_solved_for_are_exact(tmp_path):
    ready = prepare_study(load_study(both_records(tmp_path, 1.005)))
    found = run_prepared(ready).identification
    names, count = ["hammer", "ambient"], len(found.estimate.names)
    freed = freed_problems(ready.setups, found.problems, Tolerances(mass=0.01, stiffness=0.01))
    assert any(name.startswith("fixed ") for problem in freed for name in problem.names)
    none, zeros = np.zeros(0), np.zeros(count)
    unsolved = FixedValueInfluence((), (), none, np.zeros((count, 0)), none, found.estimate.theta, zeros)
    estimate = replace(found.estimate, spread=replace(found.estimate.spread, fixed=unsolved))
    [told] = missed_parts(names, found.problems, estimate, freed)
    [exact] = missed_parts(names, found.problems, estimate)
    assert told.chi_square_per_value == pytest.approx(exact.chi_square_per_value)


def test_what_removes_a_hidden_misfit_is_a_cause_though_nothing_moves():
    cause = Cause("record", ("ambient",), "", 0.06, 0.999)
    assert are_causes([cause], 1.06, is_hidden=True)
    assert not are_causes([cause], 1.06)
    assert not are_causes([Cause("record", ("ambient",), "", 0.02, 1.04)], 1.06, is_hidden=True)


def test_one_record_has_nothing_beside_it(tmp_path):
    ready = prepare_study(load_study(both_records(tmp_path)))
    found = run_prepared(ready).identification
    assert missed_parts([""], found.problems[:1], found.estimate) == ()


@pytest.mark.long
def test_a_damper_is_named_first_though_modes_beside_the_frfs_say_nothing_of_damping(tmp_path):
    lost = '[[unknown]]\nproperty = "loss_factor"\nelements = ["left", "girder", "right"]\n\n# how'
    damper = '[[structure.dashpot]]\nname = "damper"\nfirst = "5X"\nviscous_damping = 40.0\n\n[[unknown]]'
    truth = STUDY.replace("[[unknown]]", damper, 1)
    result = answered(both_records(tmp_path, 1.0, STUDY.replace("# how", lost), truth))
    first, *_ = result.diagnosis.causes
    assert (first.kind, first.where) == ("dashpot", ("5X",))
    assert first.chi_square_per_dof < 1.1
