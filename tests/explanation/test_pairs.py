"""Of two faults each alone may lower the misfit little: looks beside near fits tell which to begin with."""

from dataclasses import replace

import numpy as np
import pytest
from frame_cases import STUDY, off, written

from structid.criticism.candidate import Candidate
from structid.explanation import explain
from structid.explanation.explain import Explanation, explained
from structid.explanation.pairs import promising
from structid.explanation.refits import Fitted, approached
from structid.explanation.trial import base_trial
from structid.inversion.search.work import ALONE, PLAIN_TOOLS
from structid.records.formats import read_record, write_record
from structid.study.run.run import run_started
from structid.study.run.start import started
from structid.study.schema.study import load_study

JOINT = '[[structure.joint]]\nname = "knee"\nelement = "girder:1"\nat = "3RZ"\nstiffness = 250.0\n\n[[unknown]]'
SWAP = Candidate("swap", ("2X", "3X"), record=0)
OTHERS = (
    (Candidate("mass", ("4",)), 0.3),
    (Candidate("support", ("6RZ",)), 1e-3),
    (Candidate("spring", ("3X",)), 1e3),
)


def fitted(folder, truth, order):
    """The study of the frame fitted to the record of another one, whose channels come in some order."""
    path = written(folder, off(), truth)
    record = read_record(folder / "frf.npz")
    write_record(folder / "frf.npz", replace(record, values=record.values[:, order]))
    ready = started(load_study(path))
    found = run_started(ready).identification
    theta = found.estimate.theta
    return Fitted(
        base_trial(ready.study, ready.setups, found.problems, theta), theta, found.estimate.goodness.chi_square
    )


def begun(base):
    changes = [*OTHERS[:1], (SWAP, 1.0), *OTHERS[1:]]
    return tuple((one, q, approached(base, (one, q, np.inf), PLAIN_TOOLS)["theta"]) for one, q in changes)


def test_two_faults_are_found_by_the_one_beside_which_a_second_promises_most(tmp_path, monkeypatch):
    """Though the likeliest single change, as the fits to all data say, is none of them, and so none is clear."""
    base = fitted(tmp_path, STUDY.replace("[[unknown]]", JOINT, 1), [1, 0, 2, 3])
    once, seen = explain._once, []

    def unclear(first, *given):
        seen.append(first)
        return Explanation(first, (), (), 100, begun=begun(first)) if len(seen) == 1 else once(first, *given)

    monkeypatch.setattr(explain, "_once", unclear)
    found = explained(base)
    assert [one.trial.changes[-1][0].kind for one in found.causes] == ["swap"]
    kinds = {(one.trial.changes[-1][0].kind, one.trial.changes[-1][0].where) for one in found.further.causes[:2]}
    assert ("joint", ("girder:1", "3RZ")) in kinds
    assert found.further.causes[0].cost < 1.2 * base.trial.target.n_data


@pytest.mark.parametrize("is_exchanged", [True, False])
def test_changes_are_in_the_order_of_what_a_second_leaves_beside_them(tmp_path, is_exchanged):
    """None promises much where nothing is wrong."""
    truth = STUDY.replace("[[unknown]]", JOINT, 1) if is_exchanged else STUDY
    base = fitted(tmp_path, truth, [1, 0, 2, 3] if is_exchanged else [0, 1, 2, 3])
    found = promising(base, begun(base), ALONE, "looks")
    assert [one[0].kind for one in found][:1] == (["swap"] if is_exchanged else [])
