"""Of two faults each alone may lower the misfit little: looks beside near fits tell which to begin with."""

from dataclasses import replace

import pytest
from frame_cases import STUDY, off, written

from structid.diagnose import search
from structid.diagnose.causes import Mass, SpringToGround, Support, SwappedSensors
from structid.diagnose.modified_model import base_model
from structid.diagnose.refits import FittedModel, fit_near
from structid.diagnose.screening import promising_first_changes
from structid.diagnose.search import Explanation, search_causes
from structid.diagnose.tested_model import TestedModel
from structid.inversion.search.work import PLAIN_CONTEXT, SERIAL
from structid.records.formats import read_record, write_record
from structid.study.run.run import run_prepared
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study

JOINT = '[[structure.joint]]\nname = "knee"\nelement = "girder:1"\nat = "3RZ"\nstiffness = 250.0\n\n[[unknown]]'
SWAP = SwappedSensors(where=("2X", "3X"))
OTHERS = (
    (Mass(where=("4",)), 0.3),
    (Support(where=("6RZ",)), 1e-3),
    (SpringToGround(where=("3X",)), 1e3),
)


def fitted(folder, truth, order):
    """The study of the frame fitted to the record of another one, whose channels come in some order."""
    path = written(folder, off(), truth)
    record = read_record(folder / "frf.npz")
    write_record(folder / "frf.npz", replace(record, values=record.values[:, order]))
    ready = prepare_study(load_study(path))
    found = run_prepared(ready).identification
    theta = found.estimate.theta
    return FittedModel(
        base_model(TestedModel(ready.setups, ready.study.options), found.problems, theta),
        theta,
        found.estimate.goodness.chi_square,
    )


def begun(base):
    changes = [*OTHERS[:1], (SWAP, 1.0), *OTHERS[1:]]
    return tuple((one, q, fit_near(base, (one, q, ()), PLAIN_CONTEXT)["theta"]) for one, q in changes)


@pytest.mark.long
def test_two_faults_are_found_by_the_one_beside_which_a_second_promises_most(tmp_path, monkeypatch):
    """Though the likeliest single change, as the fits to all data say, is none of them, and so none is clear."""
    base = fitted(tmp_path, STUDY.replace("[[unknown]]", JOINT, 1), [1, 0, 2, 3])
    once, seen = search._search_once, []

    def unclear(first, *given):
        seen.append(first)
        return Explanation(first, (), (), 100, begun=begun(first)) if len(seen) == 1 else once(first, *given)

    monkeypatch.setattr(search, "_search_once", unclear)
    found = search_causes(base)
    assert [one.cause.kind for one in found.causes] == ["swap"]
    kinds = {(one.cause.kind, one.cause.where) for one in found.further.causes[:2]}
    assert ("joint", ("girder:1", "3RZ")) in kinds
    assert found.further.causes[0].chi_square < 1.2 * base.modified.target.n_data


@pytest.mark.parametrize("is_exchanged", [True, False])
def test_changes_are_in_the_order_of_what_a_second_leaves_beside_them(tmp_path, is_exchanged):
    """None promises much where nothing is wrong."""
    truth = STUDY.replace("[[unknown]]", JOINT, 1) if is_exchanged else STUDY
    base = fitted(tmp_path, truth, [1, 0, 2, 3] if is_exchanged else [0, 1, 2, 3])
    found = promising_first_changes(base, begun(base), SERIAL, "looks")
    assert [one[0].kind for one in found][:1] == (["swap"] if is_exchanged else [])
