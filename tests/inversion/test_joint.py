"""Several problems in one fit: rows, priors and residual statistics as if written out by hand."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import special

from structid import (
    ChannelUnknown,
    FrfProblem,
    FrfRecord,
    IdentifyOptions,
    InputError,
    JointProblem,
    PointMass,
    Prior,
    Setup,
    Spring,
    Structure,
    Unknown,
    channel_errors,
    estimate,
    identify,
    identify_together,
    parameters,
    with_declared_noise,
)
from structid.identification.joint_problem import joint_schedules
from structid.inversion import DataRows, FreeUnknowns, Linearization, Problem
from structid.inversion.covariance import correlation_length
from structid.unknowns.tolerances import EXACT


@dataclass(frozen=True, eq=False)
class Stretched(FreeUnknowns):
    """Unknowns whose physical values are free variables times a factor."""

    factor: float = 1.0

    def physical(self, theta):
        return self.factor * np.array(theta)

    def slope(self, theta):
        return np.full(len(theta), self.factor)


@dataclass(frozen=True, eq=False)
class Line(Problem):
    """design @ p = data for parameters by name, some with priors; the plainest problem there is."""

    labels: tuple[str, ...]
    design: np.ndarray
    data: np.ndarray
    priors: tuple[tuple[str, float, float], ...] = ()
    units: tuple[str, ...] = ()
    start: tuple[float, ...] = ()
    stretch: float = 1.0

    @property
    def unknowns(self):
        count = len(self.labels)
        return Stretched(
            self.labels, np.array(self.start or (0.5,) * count), ("mass",) * count, self.units, self.stretch
        )

    @property
    def rows(self):
        index = np.arange(len(self.data))
        return DataRows(index // 2, index % 2)

    def residual(self, theta):
        return self.linearize(theta).residual

    def linearize(self, theta):
        rows = np.array([[(n == name) / std for n in self.names] for name, _, std in self.priors])
        jacobian = np.concatenate([self.design, rows.reshape(-1, len(self.names))]) * self.stretch
        target = np.concatenate([self.data, [mean / std for _, mean, std in self.priors]])
        return Linearization(jacobian @ theta - target, jacobian, n_eliminated=1)


def two_lines(seed=0):
    rng = np.random.default_rng(seed)
    first = Line(("a", "b"), rng.standard_normal((12, 2)), rng.standard_normal(12), (("b", 0.3, 0.1),))
    second = Line(("c", "b"), rng.standard_normal((8, 2)), rng.standard_normal(8), (("b", 0.3, 0.1), ("c", 1.0, 2.0)))
    return first, second


def test_a_joint_fit_is_the_least_squares_solution_of_all_rows_with_each_prior_once():
    first, second = two_lines()
    found = estimate(JointProblem((first, second)))
    rows = np.zeros((22, 3))
    rows[:12, [0, 1]], rows[12:20, [2, 1]] = first.design, second.design
    rows[20, 1], rows[21, 2] = 10, 0.5
    target = np.concatenate([first.data, second.data, [3.0, 0.5]])
    expected = np.linalg.lstsq(rows, target, rcond=None)[0]
    assert found.names == ("a", "b", "c")
    assert np.allclose(found.values, expected, atol=1e-8)
    assert np.allclose(found.spread.covariance_noise, np.linalg.inv(rows.T @ rows), rtol=1e-8)
    assert found.goodness.degrees_of_freedom == 22 - 3 - 2  # each problem solved for one unknown inside


def test_rows_of_different_problems_are_never_neighbours_nor_one_channel():
    first, second = two_lines()
    joint = JointProblem((first, second))
    assert np.array_equal(joint.rows.lines, np.concatenate([first.rows.lines, 6 + second.rows.lines]))
    assert np.array_equal(joint.rows.series, np.concatenate([first.rows.series, 2 + second.rows.series]))
    odd = JointProblem((replace(first, data=first.data[:1], design=first.design[:1]), second))
    assert np.array_equal(odd.rows.series // 2, [0, *[1] * 8])  # real and imaginary part of one channel stay together
    alternating = np.array([1.0, 1.0, -1.0, -1.0] * 3)
    residual = np.concatenate([alternating, np.zeros(8)])
    alone = correlation_length(alternating, first.rows.lines, first.rows.series)
    assert np.isclose(correlation_length(residual, joint.rows.lines, joint.rows.series), alone)


def test_a_joint_problem_of_one_is_that_problem():
    first, _ = two_lines()
    alone, joint = estimate(first), estimate(JointProblem((first,)))
    assert np.array_equal(alone.values, joint.values)
    assert np.array_equal(alone.covariance, joint.covariance)
    whole, at = JointProblem((first,)), first.theta_start
    assert np.array_equal(whole.residual(at), first.residual(at))
    assert np.array_equal(whole.linearize(at).jacobian, first.linearize(at).jacobian)


def test_a_shared_parameter_begins_where_the_first_problem_has_it():
    first, second = two_lines()
    joint = JointProblem((first, replace(second, start=(0.7, 0.9))))
    assert np.array_equal(joint.theta_start, [0.5, 0.5, 0.7])
    other = chain()
    moved = parameters(other, UNKNOWNS).started_at(np.array([1.5, 1.6, 1.7, 910.0, 920.0, 930.0, 0.01]))
    later = Setup(other, moved, dense_record([1]))
    found = identify_together([setup([0, 2]), later], IdentifyOptions(restarts=0, pole_free_start=False))
    assert np.allclose(found.estimate.initial, setup([0]).parameters.start, rtol=1e-12)
    assert np.allclose(found.fits[1].problem.theta_start, found.fits[0].problem.theta_start, rtol=1e-12)


def test_shared_parameters_must_be_declared_alike():
    first, second = two_lines()
    with pytest.raises(InputError, match="b must have one unit in all problems, got 1 and kg in problem 2"):
        JointProblem((first, replace(second, units=("1", "kg"))))
    with pytest.raises(InputError, match="b must have the same bounds and transform"):
        JointProblem((first, replace(second, stretch=2.0)))
    with pytest.raises(InputError, match="at least one problem"):
        JointProblem(())
    other = JointProblem((first, replace(second, priors=(("b", 0.4, 0.1),))))
    with pytest.raises(InputError, match="prior of b must be the same in all problems, got another in problem 2"):
        other.residual(other.theta_start)
    kept = replace(other, first_prior_counts=True)
    assert len(kept.residual(kept.theta_start)) == 21


FREQUENCY = np.arange(0.5, 12, 0.1)
TRUE = {"m1": 2.0, "m2": 3.0, "m3": 1.0}
UNKNOWNS = [
    *(Unknown("mass", m) for m in TRUE),
    Unknown("stiffness", "springs", each=True),
    Unknown("loss_factor", "springs"),
]


def chain(added=0.0, fixed=()):
    masses = [PointMass(m, [i], 1.4) for i, m in enumerate(TRUE, 1)]
    more = [PointMass("added", [2], added)] if added else []
    springs = Spring("springs", ["1X", "1X", "2X"], ["4X", "2X", "3X"], stiffness=900.0, loss_factor=0.03)
    return Structure({i: float(i) for i in (1, 2, 3, 4)}, [*masses, *more, springs], ["4X", *fixed], active=["X"])


def dense_record(outputs, added=0.0, fixed=(), seed=None, gain=1.0):
    """Accelerance for a load on mass 2 by inversion, written out."""
    free = [i for i in range(3) if f"{i + 1}X" not in fixed]
    stiffness = np.array([[2000.0, -1000, 0], [-1000, 2000, -1000], [0, -1000, 1000]]) * (1 + 0.02j)
    mass = np.diag([2.0, 3.0 + added, 1.0])
    w2 = (2 * np.pi * FREQUENCY[:, None, None]) ** 2
    h = -w2 * np.linalg.inv((-w2 * mass + stiffness)[:, free][:, :, free])
    values = gain * h[:, [free.index(o) for o in outputs], :][:, :, [free.index(1)]]
    if seed is not None:
        rng = np.random.default_rng(seed)
        values = values * (
            1 + 0.01 * (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape)) / 2**0.5
        )
    names = tuple(f"{o + 1}X" for o in outputs)
    return with_declared_noise(FrfRecord(FREQUENCY, values, names, ("2X",), "accelerance"), 0.01)


def setup(outputs, added=0.0, fixed=(), errors=(), unknowns=UNKNOWNS, **more):
    structure = chain(added, fixed)
    return Setup(structure, parameters(structure, unknowns), dense_record(outputs, added, fixed, **more), errors)


def test_set_ups_of_one_structure_give_its_parameters_together():
    setups = [setup([0], seed=1), setup([2], added=0.7, seed=2), setup([1], fixed=("3X",), seed=3)]
    found = identify_together(setups)
    assert found.estimate.covariance_basis == "noise"
    truth = [*TRUE.values(), 1000.0, 1000.0, 1000.0, 0.02]
    distance = (found.estimate.values - truth) / found.estimate.std
    assert np.abs(distance).max() < 3.5
    assert [fit.measured.outputs[0].node for fit in found.fits] == [1, 3, 2]
    for k, fit in enumerate(found.fits):
        assert np.median(found.seen_from(k).relative_error) < 0.01
        assert np.allclose(fit.problem.physical(fit.theta), [found.estimate[n][0] for n in fit.problem.names])
    alone = identify(setups[0].structure, setups[0].parameters, setups[0].record).estimate
    assert alone.identifiability.rank < found.estimate.identifiability.rank == len(truth)


def test_a_common_gain_and_an_added_mass_that_is_known_give_absolute_masses():
    errors = [ChannelUnknown("gain", "all", name="accelerometer")]
    setups = [setup([0, 1], errors=errors, seed=1, gain=1.08), setup([2], 0.7, errors=errors, seed=2, gain=1.08)]
    exact = IdentifyOptions(tolerances=EXACT)
    found = identify_together(setups, exact)
    value, std = found.estimate["gain[accelerometer]"]
    assert abs(value - 1.08) < 3.5 * std < 0.02
    value, std = found.estimate["mass[m2]"]
    assert abs(value - 3.0) < 3.5 * std < 0.05
    alone = identify_together(setups[:1], exact).estimate
    assert alone.identifiability.rank == len(alone.names) - 1


def test_joint_jacobian_with_channel_errors_is_that_of_differences_at_every_stage():
    parts = []
    for k, (outputs, added) in enumerate((([0, 2], 0.0), ([1], 0.7))):
        made = setup(outputs, added, seed=k)
        declared = [
            ChannelUnknown("gain", "all", name="g", prior=Prior(1.0, 0.03)),
            ChannelUnknown("delay", f"{outputs[0] + 1}X"),
        ]
        channels = channel_errors(made.record, declared)
        parts.append(FrfProblem(made.structure, made.parameters, made.record, channels=channels))
    joint = JointProblem(tuple(parts))
    assert joint.names[-3:] == ("gain[g]", "delay[1X+]", "delay[2X+]")
    plans = joint_schedules(parts)
    assert len({problem.names for plan in plans for _, problem in plan}) == 1
    problems = [joint, *(plan[k][1] for plan in plans[::2] for k in (0, -1))]
    assert len(problems) > 3
    assert all(problem.names == joint.names for problem in problems)
    theta = joint.theta_start + 0.01 * np.random.default_rng(0).standard_normal(len(joint.names))
    theta[-2:] = 1e-3
    for problem in problems:
        found = problem.linearize(theta)
        assert np.allclose(found.residual, problem.residual(theta), rtol=1e-9, atol=1e-9)  # two orders of summation
        columns = []
        for unit in np.eye(len(theta)):
            far, near = (
                problem.residual(theta + k * 1e-5 * unit) - problem.residual(theta - k * 1e-5 * unit) for k in (2, 1)
            )
            columns.append((8 * near - far) / 12e-5)
        expected = np.array(columns).T
        assert np.abs(found.jacobian - expected).max() < 1e-7 * np.abs(expected).max()


def test_a_prior_stated_in_any_set_up_counts_once():
    stated = [replace(u, prior=Prior(2.0, 0.0005)) if u.elements == "m1" else u for u in UNKNOWNS]
    plain = [setup([0], seed=1), setup([2], seed=2)]
    once = [setup([0], seed=1), setup([2], seed=2, unknowns=stated)]
    twice = [setup([0], seed=1, unknowns=stated), setup([2], seed=2, unknowns=stated)]
    free, first, both = (identify_together(s).estimate for s in (plain, once, twice))
    assert first["mass[m1]"][1] < 0.8 * free["mass[m1]"][1]
    assert np.allclose(first.values, both.values, rtol=1e-8)
    assert np.allclose(first.std, both.std, rtol=1e-6)
    other = [replace(u, prior=Prior(2.1, 0.1)) if u.elements == "m1" else u for u in UNKNOWNS]
    with pytest.raises(InputError, match=r"prior of mass\[m1\] must be the same in all set-ups"):
        identify_together([setup([0], unknowns=stated), setup([2], unknowns=other)])


def test_errors_of_joint_estimates_are_as_large_as_their_covariance_says():
    """Mahalanobis distances over 12 repeats, gains drawn from their prior; a chi-square sum within its 99.8 % limits."""
    rng = np.random.default_rng(17)
    once = IdentifyOptions(restarts=0, pole_free_start=False)
    prior = Prior(1.0, 0.03)
    distances, n_params = [], 0
    for repeat in range(12):
        gains = {"A": 1 + 0.03 * rng.standard_normal(), "B": 1 + 0.03 * rng.standard_normal()}
        truth = {"m1": 2.0, "m2": 3.0, "m3": 1.0}
        setups = []
        for k, (output, name) in enumerate(((0, "A"), (2, "B"), (1, "A"))):
            errors = [ChannelUnknown("gain", "all", name=name, prior=prior)]
            made = setup([output], errors=errors, seed=1000 + 3 * repeat + k, gain=gains[name])
            start = np.array([*truth.values(), 1000.0, 1000.0, 1000.0, 0.02])
            setups.append(replace(made, parameters=made.parameters.started_at(start)))
        found = identify_together(setups, once).estimate
        error = found.values - [*start, gains["A"], gains["B"]]
        n_params = len(error)
        distances.append(error @ np.linalg.solve(found.spread.covariance_noise, error))
    low, high = special.chdtri(12 * n_params, [0.999, 0.001])
    assert low < sum(distances) < high
