"""Which refitted changes are causes: by a price for each parameter, by chance among all that were tried, by a part that matters."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from frame_cases import written
from scipy import stats
from test_each_cause import begun

import structid as sid
from structid.diagnose import search
from structid.diagnose.causes import Appendage, FaultyChannel, Mass
from structid.diagnose.causes.rotary_inertia import AddedRotaryInertia
from structid.diagnose.search import _is_heavier, _limit_of, _simpler, _weighed
from structid.diagnose.thresholds import ALIKE
from structid.diagnose.verdict import Cause, ParameterShift, find_moving_change

SWINGING = Appendage(where=("4Y",), frequency=25.0)
MASS, INERTIA = Mass(where=("4",)), AddedRotaryInertia(where=("4RZ",))
CHANNEL = FaultyChannel(where=("3X",), others=("2X", "4Y", "5Y"))
N_DATA, N_PARAMS = 960, 3


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    return begun(written(tmp_path_factory.mktemp("frame")))


@pytest.fixture(scope="module")
def trials(base):
    return {one.kind: base.modified.changed(one, 0.3) for one in (SWINGING, MASS, INERTIA, CHANNEL)}


def weighed(base, trials, cost, fits, tried=200):
    """What comes of a misfit before any change, and of kinds with their misfit and the part of it that is left out."""
    own = replace(base, chi_square=cost)
    changed = [
        replace(base, modified=trials[kind], theta=trials[kind].target.theta_start, chi_square=left, left_out=aside)
        for kind, left, aside in fits
    ]
    return _weighed(own, changed, tried)


def kinds(fits):
    return [one.cause.kind for one in fits]


@pytest.fixture
def uncorrelated(monkeypatch):
    """Residuals of which every line counts: those of these trials are of no fit."""
    monkeypatch.setattr(search, "correlation_length", lambda *rows: 0.7)


def test_a_resonance_wins_over_its_mass_by_stretches_of_lines_that_are_correlated(base, trials, monkeypatch):
    """A mass leaves 1500, a resonance of two more parameters 1482; what is left of each degree of freedom is 1.55."""
    edge = 18.0 / (1482.0 / (N_DATA - N_PARAMS - 3)) / stats.chi2.isf(0.01, 2)
    assert edge > 1.2
    for length, expected in ((edge - 0.05, ["mass", "appendage"]), (edge + 0.05, ["mass"])):
        monkeypatch.setattr(search, "correlation_length", lambda *rows, length=length: length)
        assert (
            kinds(weighed(base, trials, 5000.0, [("appendage", 1482.0, 0.0), ("mass", 1500.0, 0.0)]).causes) == expected
        )


def test_the_correlation_of_a_residual_is_counted_in_lines(base):
    smooth = np.repeat(np.random.default_rng(0).normal(size=6000), 2)
    target = SimpleNamespace(n_data=12_000, residual=lambda theta: np.append(smooth, 5.0))
    target.rows = SimpleNamespace(lines=np.arange(12_000), series=np.zeros(12_000, dtype=int))
    fitted = replace(base, modified=SimpleNamespace(target=target))
    assert search._lines_that_count_as_one(fitted) == pytest.approx(2.0, abs=0.1)


@pytest.mark.usefixtures("uncorrelated")
def test_the_price_of_a_parameter_is_the_logarithm_of_the_number_of_data(base, trials):
    assert (base.modified.target.n_data, len(base.modified.target.names)) == (N_DATA, N_PARAMS)
    assert len(trials["appendage"].target.names) == N_PARAMS + 3
    found = weighed(base, trials, 5000.0, [("appendage", 1482.0, 0.0), ("mass", 1500.0, 0.0), ("inertia", 1520.0, 0.0)])
    assert kinds(found.causes) == ["mass", "appendage", "inertia"]
    scale = 1482.0 / (N_DATA - N_PARAMS - 3)  # of the best of all models, by its degrees of freedom
    assert found.criteria == pytest.approx(
        [1500.0 / scale + 4 * np.log(N_DATA), 1482.0 / scale + 6 * np.log(N_DATA), 1520.0 / scale + 4 * np.log(N_DATA)]
    )
    scale = 1500.0 / (N_DATA - N_PARAMS - 1)
    near = 1500.0 + (ALIKE - 0.01) * scale, 1500.0 + (ALIKE + 0.01) * scale
    for cost, likely in zip(near, (["mass", "inertia"], ["mass"]), strict=True):
        assert kinds(weighed(base, trials, 5000.0, [("mass", 1500.0, 0.0), ("inertia", cost, 0.0)]).near) == likely


@pytest.mark.usefixtures("uncorrelated")
def test_a_local_resonance_gives_way_to_the_mass_that_it_holds_as_a_limit_by_a_likelihood_ratio(base, trials):
    scale = 1500.0 / (N_DATA - N_PARAMS - 1)
    edge = stats.chi2.isf(0.01, 2) * scale
    for drop, is_dropped in ((edge - 0.5, True), (edge + 0.5, False)):
        fits = [("appendage", 1500.0 - drop, 0.0), ("mass", 1500.0, 0.0)]
        assert ("appendage" not in kinds(weighed(base, trials, 5000.0, fits).causes)) is is_dropped


@pytest.mark.parametrize(
    ("cost", "drop", "tried", "is_cause"),
    [
        (5000.0, 30.0, 200, False),  # by far beyond chance, but a hundredth of the misfit
        (5000.0, 400.0, 200, False),
        (5000.0, 410.0, 200, True),
        (950.0, 16.0, 200, False),  # by chance among so many
        (950.0, 16.0, 100, True),
        (950.0, -1.0, 1, False),
    ],
)
def test_a_cause_lowers_the_misfit_beyond_chance_and_by_a_tenth_of_what_is_beyond_noise(
    base, trials, cost, drop, tried, is_cause
):
    found = weighed(base, trials, cost, [("mass", cost - drop, 0.0)], tried)
    assert bool(found.causes) is is_cause


def test_chance_is_that_of_chi_square_of_the_parameters_that_a_change_adds(base, trials):
    for kind, more in (("mass", 1), ("appendage", 3)):
        edge = stats.chi2.isf(0.01 / 200, more)
        for drop, is_cause in ((edge - 0.05, False), (edge + 0.05, True)):
            assert bool(weighed(base, trials, 950.0, [(kind, 950.0 - drop, 0.0)]).causes) is is_cause


def test_data_that_are_left_out_miss_twice_as_much_as_the_others(base, trials):
    """A channel of four: 240 of 960 values, with 240 of the misfit as its own, the others with 900."""
    assert trials["channel"].target.n_data == 720
    edge = 1140.0 + 2.0 * 240 * 900.0 / 720
    for cost, is_cause in ((edge - 2.0, False), (edge + 2.0, True)):
        assert bool(weighed(base, trials, cost, [("channel", 1140.0, 240.0)]).causes) is is_cause


def test_noise_is_no_misfit(base):
    dof = N_DATA - N_PARAMS
    for risk, is_more in ((1.05e-3, False), (0.95e-3, True)):
        assert replace(base, chi_square=float(stats.chi2.isf(risk, dof))).is_misfit is is_more


@pytest.mark.parametrize(("share", "is_wrong"), [(0.6, True), (0.4, False)])
def test_a_change_that_moves_a_value_makes_the_model_wrong_where_it_removes_most_of_the_misfit(share, is_wrong):
    shift = ParameterShift("stiffness[k]", "N/m", 1.0, 1.3, (1.2, 1.4), 5.0)
    change = Cause("mass", ("3",), "a mass at 3", share, 4.0, moved=(shift,), is_alike=True)
    assert (find_moving_change([change]) is not None) is is_wrong


@pytest.mark.parametrize(
    "frequency, loss_factor, limit", [(25.0, 0.03, None), (25.0, 1e6, "mass"), (1e5, 0.03, "mass")]
)
def test_a_local_resonance_that_its_spring_moves_rigidly_has_the_mass_as_its_limit(
    base, trials, frequency, loss_factor, limit
):
    """Stiff springs do so, and lossy ones as well."""
    modified = trials["appendage"]
    names = [name.partition("[")[0] for name in modified.target.names]
    theta = np.array(modified.target.theta_start)
    for name, value in {
        "mass": 0.3,
        "stiffness": 0.3 * (2 * np.pi * frequency) ** 2,
        "loss_factor": loss_factor,
    }.items():
        theta[-1 - names[::-1].index(name)] = np.log(value)
    one = replace(base, modified=modified, theta=theta)
    assert one.values["loss_factor[appendage spring 4Y]"] == pytest.approx(loss_factor)
    candidate = _limit_of(base, one)
    assert (None if candidate is None else candidate.kind) == limit


@pytest.mark.parametrize("side, limit", [("above", "mass"), ("below", "spring")])
def test_a_local_resonance_outside_the_lines_is_held_against_its_limit(base, trials, side, limit):
    modified = trials["appendage"]
    lines = np.concatenate([problem.frequency for problem in base.modified.problems])
    frequency = 1.2 * lines.max() if side == "above" else lines[lines > 0].min() / 1.2
    names = [name.partition("[")[0] for name in modified.target.names]
    theta = np.array(modified.target.theta_start)
    theta[-1 - names[::-1].index("mass")] = np.log(0.3)
    theta[-1 - names[::-1].index("stiffness")] = np.log(0.3 * (2 * np.pi * frequency) ** 2)
    one = replace(base, modified=modified, theta=theta)
    assert _limit_of(base, one) is None
    ((candidate, _, _),) = _simpler(base, one)
    assert candidate.kind == limit


@pytest.mark.parametrize("part, limit, causes", [(0.9, None, ["appendage"]), (1.1, "spring", [])])
def test_a_local_resonance_heavier_than_the_structure_is_no_cause_and_its_spring_is_tried(
    base, trials, part, limit, causes
):
    """A hose to the ground at no node was called a resonance of 1,232 kg: such a mass rests like the ground."""
    modified = trials["appendage"]
    total = 4.0 * (0.5 + 0.5 + 1.0) + 3.0 * 1.2  # kg, of columns and girder
    names = [name.partition("[")[0] for name in modified.target.names]
    theta = np.array(modified.target.theta_start)
    theta[-1 - names[::-1].index("mass")] = np.log(part * total)
    theta[-1 - names[::-1].index("stiffness")] = np.log(part * total * (2 * np.pi * 25.0) ** 2)
    one = replace(base, modified=modified, theta=theta, chi_square=1000.0)
    candidate = _limit_of(base, one)
    assert (None if candidate is None else candidate.kind) == limit
    assert [item[0].kind for item in _simpler(base, one)] == ([] if limit is None else [limit])
    assert kinds(_weighed(replace(base, chi_square=5000.0), [one], 200).causes) == causes


def test_a_local_resonance_is_weighed_against_the_masses_that_the_fit_identified():
    """A mass whose start is 1 kg is identified as 5 kg: 4 kg beside it are less than the structure, 6 kg are more."""
    structure = sid.Structure({1: 0.0}, [sid.PointMass("a", [1], mass=1.0)], active=["X"])
    sought = sid.parameters(structure, [sid.Unknown("mass", "a")])
    problem = SimpleNamespace(names=sought.names, property_values=sought.values, structure=structure)
    identified = {"mass[a]": 5.0}
    base = SimpleNamespace(modified=SimpleNamespace(problems=[problem]), values=identified)
    for added, is_heavier in ((4.0, False), (6.0, True)):
        one = SimpleNamespace(cause=SimpleNamespace(where=("1X",)), values={**identified, "mass[hose]": added})
        assert _is_heavier(base, one) is is_heavier
