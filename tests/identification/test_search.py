"""Polarities: which are tried, and which is kept."""

from types import SimpleNamespace

import numpy as np
import pytest

from structid import (
    ChannelUnknown,
    FrfProblem,
    IdentifyOptions,
    InputError,
    channel_errors,
    parameters,
    with_declared_noise,
)
from structid.fem import PointMass, Spring, Structure
from structid.identification.joint_problem import joint_problem
from structid.identification.search import PolarityTrials
from structid.inversion import Status
from structid.records import FrfRecord
from structid.unknowns import Unknown


def problem(signs, free=("1X", "2X")):
    springs = [Spring("link", "1X", "2X", stiffness=50.0), Spring("ground", "1X", stiffness=80.0)]
    structure = Structure({1: 0.0, 2: 1.0}, [PointMass("m", [1, 2], 1.0), *springs], active=["X"])
    unknown = parameters(structure, [Unknown("mass", "m")])
    frequency = np.linspace(0.2, 4.0, 40)
    record = FrfRecord(frequency, np.ones((40, 2, 1)), ("1X", "2X"), ("2X",), "accelerance")
    exact = FrfProblem(structure, unknown, with_declared_noise(record, 0.01)).predicted(unknown.theta_start)
    measured = with_declared_noise(
        FrfRecord(frequency, exact * np.array(signs)[:, None], ("1X", "2X"), ("2X",), "accelerance"), 0.01
    )
    errors = channel_errors(measured, [ChannelUnknown("polarity", dof) for dof in free])
    return FrfProblem(structure, unknown, measured, channels=errors)


def signs_of(problems):
    return tuple(sign for problem in problems for sign in problem.channels.polarities.tolist())


def fake_search(costs, tried):
    def search(problems):
        tried.append(signs_of(problems))
        whole = joint_problem(problems)
        return SimpleNamespace(
            names=whole.names,
            theta=np.array(whole.theta_start),
            goodness=SimpleNamespace(chi_square=costs(tried[-1])),
            covariance_basis="noise" if costs(tried[-1]) < 1 else "model_error",
            status=Status.CONVERGED,
        )

    return search


def fit_all(problems, search):
    trials = PolarityTrials.begun(problems, {})
    while trials.pending:
        trials.add(search(trials.pending[0]))
    return trials.best


@pytest.mark.parametrize("signs", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_polarities_that_the_initial_model_shows_take_one_search(signs):
    tried = []
    _, (found,) = fit_all((problem(signs),), fake_search(lambda s: 0.5, tried))
    assert tried == [signs]
    assert tuple(found.channels.polarities) == signs


def test_where_the_fit_misses_every_other_choice_is_tried_and_the_best_kept():
    tried = []
    best = (-1.0, 1.0, 1.0)
    problems = (problem((1, 1)), problem((1, 1), ("2X",)))
    _, found = fit_all(problems, fake_search(lambda s: 2.0 if s == best else 9.0, tried))
    assert tried[0] == (1.0, 1.0, 1.0)
    assert sorted(tried) == sorted({(a, b, c) for a in (1.0, -1.0) for b in (1.0, -1.0) for c in (1.0, -1.0)})
    assert signs_of(found) == best


def test_without_polarities_there_is_one_search():
    tried = []
    alone = problem((1, 1), ())
    _, found = fit_all((alone,), fake_search(lambda s: 9.0, tried))
    assert tried == [()]
    assert found[0] is alone


@pytest.mark.parametrize(
    "bands", [{"band": (10.0, 2.0)}, {"evaluation_band": (9.0, 1.0)}, {"exclude": [(1.0, 2.0), (5.0, 4.0)]}]
)
def test_bands_that_go_down_are_refused_with_their_name(bands):
    with pytest.raises(InputError, match=rf"`{next(iter(bands))}` must run from 0 Hz or more to the same or a higher"):
        IdentifyOptions(**bands)
