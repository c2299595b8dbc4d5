"""Output error: exact response and sensitivities, incidental unknowns, search, covariance, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg
from time_cases import all_of, chain, everything, off, record_of, undamped_free

from structid import Beam, InputError, LevenbergMarquardt, Spring, Status, Structure, TimeRecord, Unknown, parameters
from structid.dynamics import harmonic_transient, sampled_transient
from structid.dynamics.exact_discretization import exponential_derivative
from structid.forward import Oscillation, TimeOptions, output_error_problem
from structid.forward.time.identify_time import identify_time
from structid.forward.time.output_error import time_model
from structid.inversion import minimize

MIXED = [("1X", "acceleration"), ("2X", "velocity"), ("3X", "displacement"), ("3X-", "acceleration")]
FREE = TimeOptions(initial="unknown")


def matrices(structure):
    return [structure.matrix(law).toarray() for law in ("mass", "damping", "stiffness")]


def textbook(structure, force, where, step, hold, start):
    """State-space response by scipy's matrix exponential of the force's own generator: (n_times, 3 n_dofs) w v a."""
    m, c, k = matrices(structure)
    n, inverse = len(m), np.linalg.inv(m)
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ k, -inverse @ c]])
    b = np.concatenate([np.zeros_like(where), inverse @ where])
    zero = np.zeros((where.shape[1],) * 2)
    wide = np.block([[a, b, 0 * b], [np.zeros((zero.shape[0], 2 * n)), zero, np.eye(len(zero)) * (hold == "first")],
                     [np.zeros((zero.shape[0], 2 * n)), zero, zero]])  # fmt: skip
    power, state, found = linalg.expm(wide * step), start, []
    for i, f in enumerate(force):
        found.append(np.concatenate([state, (a @ state + b @ f)[n:]]))
        slope = (force[min(i + 1, len(force) - 1)] - f) / step
        state = (power @ np.concatenate([state, f, slope]))[: 2 * n]
    return np.array(found)


@pytest.mark.parametrize("hold", ["first", "zero"])
@pytest.mark.parametrize("made", [chain, undamped_free])
def test_readings_equal_the_textbook_state_space(made, hold):
    structure, sensors = made(), MIXED
    unknown = everything(structure)
    start = np.array([0.1, -0.2, 0.3, 1.0, 0.0, -0.5])
    options = TimeOptions(force=hold, initial="unknown")
    record = record_of(structure, unknown, sensors, n=40, loads=("1X", "3X-"), options=options, initial=start)
    where = structure.selection(record.channels[4:]).toarray()
    found = textbook(structure, record.values[:, 4:], where, 0.05, hold, start)
    expected = np.column_stack([found[:, 6], found[:, 4], found[:, 2], -found[:, 8]])
    assert record.values[:, :4] == pytest.approx(expected, abs=1e-11 * np.abs(expected).max())


def test_readings_equal_the_transients_of_dynamics():
    structure = chain()
    m, c, k = matrices(structure)
    record = record_of(structure, everything(structure), all_of(structure, "acceleration"), n=30, loads=("2X",))
    where = structure.selection(record.channels[-1:]).toarray()
    exact = sampled_transient(m, k, where, record.values[:, -1:], 20.0, c)
    assert record.values[:, :3] == pytest.approx(exact.acceleration, abs=1e-11)


@pytest.mark.parametrize("made", [chain, undamped_free])
@pytest.mark.parametrize("gap", [0.0, 0.05, 0.13])
def test_oscillation_from_rest_before_the_first_sample_is_exact(made, gap):
    structure = made()
    m, c, k = matrices(structure)
    time = 2.0 + gap + 0.05 * np.arange(50)
    force = np.zeros((50, 1))
    record = TimeRecord(20.0, np.column_stack([np.zeros((50, 3)), force]), ("1X", "2X", "3X", "1X"),
                        ("acceleration",) * 3 + ("force",), start=time[0])  # fmt: skip
    options = TimeOptions(force=Oscillation(9.0), rest_time=2.0)
    model = time_model(structure, everything(structure), record, options)
    cosine, sine = np.cos(18.0), np.sin(18.0)  # so that it is a cosine from the rest on
    found = model.readings(everything(structure).start, np.array([cosine, sine]), None, 50)
    load = np.array([1.0, 0, 0])
    exact = harmonic_transient(m, k, load, 9.0, time - 2.0, None if made is undamped_free else c)
    assert found == pytest.approx(exact.acceleration, abs=1e-10)


def test_derivative_of_the_exponential_equals_scipy():
    rng = np.random.default_rng(0)
    a, e = 3 * rng.standard_normal((7, 7)), rng.standard_normal((7, 4, 7))
    e[:3] = 0
    power, slope = exponential_derivative(a, e)
    assert power == pytest.approx(linalg.expm(a), rel=1e-11)
    for j in range(4):
        assert slope[:, j] == pytest.approx(linalg.expm_frechet(a, e[:, j])[1], rel=1e-10, abs=1e-8)
    assert exponential_derivative(np.zeros((2, 2)), np.zeros((2, 0, 2)))[0] == pytest.approx(np.eye(2))


def differences(function, theta, size=1e-6):
    steps = size * np.eye(len(theta))
    return np.stack([(function(theta + d) - function(theta - d)) / (2 * size) for d in steps], axis=-1)


@pytest.mark.parametrize("made", [chain, undamped_free])
def test_jacobian_equals_differences(made):
    """Mixed kinds, two loads, chunks of steps; groups and ties come with the parameters' design."""
    structure = made()
    record = record_of(structure, everything(structure), MIXED, n=60, loads=("1X", "3X"), rng=np.random.default_rng(1))
    problem = output_error_problem(structure, off(everything(structure)), record)
    at = problem.linearize(problem.theta_start)
    by_differences = differences(problem.residual, problem.theta_start)
    assert at.jacobian == pytest.approx(by_differences, rel=1e-6, abs=1e-6 * np.abs(by_differences).max())
    assert at.residual == pytest.approx(problem.residual(problem.theta_start), abs=1e-9)
    assert at.n_eliminated == 0


def test_chunks_of_steps_change_nothing(monkeypatch):
    structure = chain()
    record = record_of(structure, everything(structure), MIXED, n=60)
    whole = output_error_problem(structure, everything(structure), record).linearize
    theta = everything(structure).theta_start
    expected = whole(theta).jacobian
    monkeypatch.setattr("structid.forward.time.model._CHUNK", 100)
    assert whole(theta).jacobian == pytest.approx(expected, abs=1e-9)


INCIDENTAL = {
    "start": (TimeOptions(initial="unknown"), 0.0),
    "samples": (TimeOptions(), 0.05),
    "both": (TimeOptions(force="zero", initial="unknown"), 0.05),
    "amplitude": (TimeOptions(force=Oscillation(5.0)), 0.05),
}


@pytest.mark.parametrize("case", INCIDENTAL)
def test_eliminated_unknowns_equal_those_of_the_joint_fit(case):
    """Cost by brute force over all unknowns (the model is linear in the others), its gradient by differences of that."""
    options, force_noise = INCIDENTAL[case]
    structure = chain()
    unknown = everything(structure)
    record = record_of(structure, unknown, MIXED, n=24, rng=np.random.default_rng(2), options=options,
                       force_noise=force_noise, initial=None)  # fmt: skip
    problem = output_error_problem(structure, unknown, record, options)
    n, times = 3, record.time

    def brute(theta):
        values = problem.physical(theta)
        forces = [record.values[:, 4:]]
        if case == "amplitude":
            forces = [np.cos(5 * times)[:, None], np.sin(5 * times)[:, None]]
        elif force_noise:
            forces += [np.eye(24)[:, [i]] for i in range(24)]
        starts = [None] * len(forces) + [np.eye(6)[i] for i in range(6)] * (options.initial == "unknown")
        forces += [np.zeros((24, 1))] * (len(starts) - len(forces))
        between = "first" if case == "amplitude" else options.force
        plain = replace(problem.model, drive=replace(problem.model.drive, force=between))
        rows = []
        for f, start in zip(forces, starts, strict=True):
            if case == "amplitude":
                k = len(rows)
                y = problem.model.readings(values, np.eye(2)[k], None, 24)
            else:
                y = plain.readings(values, f, start, 24)
            top = (y / problem.deviation).ravel()
            bottom = (f / problem.force_deviation).ravel() if force_noise else np.zeros(0)
            rows.append(np.concatenate([top, bottom]))
        data = (problem.measured / problem.deviation).ravel()
        if force_noise:
            data = np.concatenate([data, (record.values[:, 4:] / problem.force_deviation).ravel()])
        fixed = np.zeros_like(data) if case == "amplitude" else rows.pop(0)
        columns = np.stack(rows, axis=1)
        return float(
            np.linalg.norm(fixed + columns @ np.linalg.lstsq(columns, data - fixed, rcond=None)[0] - data) ** 2
        )

    theta = off(unknown, 0.05).theta_start
    at = problem.linearize(theta)
    assert at.residual @ at.residual == pytest.approx(brute(theta), rel=1e-8)
    assert at.residual == pytest.approx(problem.residual(theta), abs=1e-8)
    gradient = differences(brute, theta, 1e-5)
    assert 2 * at.jacobian.T @ at.residual == pytest.approx(gradient, abs=1e-5 * np.abs(gradient).max())
    assert at.n_eliminated == {"start": 2 * n, "samples": 24, "both": 30, "amplitude": 2}[case]


def test_information_is_that_of_all_unknowns_together():
    """Schur complement: the projected J'J is the inverse of the parameters' block of the joint covariance."""
    structure = chain()
    unknown = everything(structure)
    record = record_of(structure, unknown, MIXED, n=40, options=FREE)
    problem = output_error_problem(structure, unknown, record, FREE)
    values = unknown.start
    change = problem.model.derivatives(values, record.values[:, 4:], np.zeros(6), 40)[1]
    wide = np.concatenate([change, problem.model.unit_starts(values, 40)], axis=2) / problem.deviation[:, None]
    wide = wide.reshape(160, -1) / np.linalg.norm(wide.reshape(160, -1), axis=0)
    joint = np.linalg.inv(wide.T @ wide)[:9, :9]
    own = problem.linearize(unknown.theta_start).jacobian / unknown.start
    norm = np.linalg.norm((change / problem.deviation[:, None]).reshape(160, -1), axis=0)
    assert np.linalg.inv(own.T @ own) * np.outer(norm, norm) == pytest.approx(joint, rel=1e-6)


@pytest.mark.parametrize("sensors", [MIXED, [("1X", "acceleration")]], ids=["mixed", "one"])
def test_exact_records_give_back_the_parameters(sensors):
    """Mass, damping and stiffness of every element, 10 % off, from one accelerometer even."""
    structure = chain()
    unknown = everything(structure)
    record = record_of(structure, unknown, sensors, n=100, noise=1e-3)
    found = identify_time(structure, off(unknown, 0.1), record)
    assert found.status is Status.CONVERGED
    assert found.values == pytest.approx(unknown.start, rel=1e-5)
    assert found.initial == pytest.approx(off(unknown, 0.1).start)


def test_unknown_start_is_found_with_the_parameters():
    structure = chain()
    unknown = everything(structure)
    start = np.array([0.1, 0.0, -0.1, 1.0, 0.5, 0.0])
    rng = np.random.default_rng(3)
    record = record_of(structure, unknown, MIXED, n=100, noise=0.01, rng=rng, options=FREE, initial=start)
    found = identify_time(structure, off(unknown, 0.1), record, FREE)
    assert found.status is Status.CONVERGED
    assert 0.8 < found.chi_square_per_dof < 1.2
    assert found.goodness.degrees_of_freedom == 400 - 9 - 6
    assert (np.abs(found.values - unknown.start) < 4 * found.std).all()
    found_start = unknown.started_at(found.values)
    wrong = identify_time(structure, found_start, record, TimeOptions(restarts=0, first_samples=100, max_iterations=10))
    assert wrong.chi_square_per_dof > 5


def test_free_motion_gives_ratios_and_a_known_mass_the_scale():
    structure = chain()
    unknown = parameters(structure, [Unknown("stiffness", "k", each=True), Unknown("viscous_damping", "c", each=True)])
    start = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    record = record_of(structure, unknown, MIXED[:2], options=FREE, initial=start)
    quiet = TimeRecord(20.0, record.values[:, :2], record.channels[:2], record.quantities[:2], (1e-4, 1e-4))
    force = record_of(structure, unknown, MIXED[:2], options=FREE).values[:, :2]
    free = replace(quiet, values=quiet.values - force)  # by superposition
    found = identify_time(structure, off(unknown, 0.1), free, FREE)
    assert found.values == pytest.approx(unknown.start, rel=1e-5)
    scaled = identify_time(structure, everything(structure), free, FREE)
    assert scaled.status is Status.NOT_IDENTIFIABLE


def test_long_coarse_record_needs_its_short_beginning():
    """Sampled three times a second, 85 s long: all of it at once leads the same start nowhere, grown in time it does."""
    structure = undamped_free()
    unknown = everything(structure)
    sensors = all_of(structure, "acceleration")
    record = record_of(structure, unknown, sensors, n=256, rate=3.0, rng=np.random.default_rng(4))
    start = off(unknown, 0.1)
    grown = identify_time(structure, start, record)
    assert grown.status is Status.CONVERGED
    assert grown.chi_square_per_dof < 1.1
    assert (np.abs(grown.values - unknown.start) < 4 * grown.std).all()
    at_once = minimize(output_error_problem(structure, start, record), LevenbergMarquardt(max_iterations=15))
    assert at_once.costs[-1] > 100 * grown.goodness.chi_square


def test_covariance_is_that_of_repeats():
    """40 repeats, 5 parameters, unknown start: mean squared error over variance, and coverage."""
    structure = undamped_free()
    unknown = everything(structure)
    options, rng = TimeOptions(initial="unknown", restarts=0, first_samples=30), np.random.default_rng(6)
    scores = []
    for _ in range(40):
        record = record_of(structure, unknown, MIXED, n=30, noise=0.005, rng=rng, options=options)
        found = identify_time(structure, unknown, record, options)
        scores.append((found.values - unknown.start) / found.std)
    scores = np.array(scores)
    assert 0.7 < (scores**2).mean() < 1.4
    assert 0.9 < (np.abs(scores) < 1.96).mean() < 0.99


def test_noisy_amplitude_widens_the_common_scale_only():
    structure = chain()
    unknown = everything(structure)
    time, dofs, kinds = np.arange(100) / 20.0, ("1X", "2X", "3X", "1X"), ("acceleration",) * 3 + ("force",)
    options = TimeOptions(force=Oscillation(5.0))
    force = 2.0 * np.cos(5 * time)[:, None]
    blank = TimeRecord(20.0, np.column_stack([np.zeros((100, 3)), force]), dofs, kinds)
    model = time_model(structure, unknown, blank, options)
    motion = model.readings(unknown.start, np.array([2.0, 0.0]), None, 100)
    variance = np.append((1e-4 * motion.std(axis=0)) ** 2, 0.02**2)
    record = TimeRecord(20.0, np.column_stack([motion, force]), dofs, kinds, variance)
    noisy = identify_time(structure, unknown, record, options)
    known = identify_time(structure, unknown, replace(record, variance=variance * [1, 1, 1, 0]), options)
    relative = noisy.std / unknown.start
    scale = 0.02 / 2.0 / np.sqrt((np.cos(5 * time) ** 2).sum())
    assert relative == pytest.approx(np.full(9, scale), rel=0.05)
    assert (known.std / unknown.start).max() < scale / 3


def test_priors_take_part():
    structure = chain()
    unknown = everything(structure)
    record = record_of(structure, unknown, [("1X", "acceleration")], n=60, noise=0.05, rng=np.random.default_rng(7))
    held = unknown.kept_near_start(1e-3)
    found = identify_time(structure, held, record)
    assert found.values == pytest.approx(unknown.start, rel=5e-3)
    assert (found.std / unknown.start < 1.1e-3).all()


def test_too_few_samples_are_not_identifiable():
    structure = chain()
    unknown = everything(structure)
    record = record_of(structure, unknown, [("1X", "acceleration")], n=6, rng=np.random.default_rng(8))
    found = identify_time(structure, unknown, record)
    assert found.status is Status.NOT_IDENTIFIABLE
    assert np.isnan(found.std).any()


def test_what_is_missing_is_said():
    structure = chain()
    unknown = everything(structure)
    record = record_of(structure, unknown, MIXED, n=30)
    cases = {
        "no noise level": replace(record, variance=None),
        "force channels": TimeRecord(
            20.0, record.values[:, :4], record.channels[:4], record.quantities[:4], np.ones(4)
        ),
        "must be greater than 0": replace(record, variance=np.array([1, 0, 1, 1, 0.0])),
        f"not negative, got -1 for {record.quantities[1]} at {record.channels[1].place}": replace(
            record, variance=np.array([1, -1, 1, 1, 0.0])
        ),
        "the rest must last": (record, TimeOptions(rest_time=-1.0)),
        "not come after": (record, TimeOptions(rest_time=1.0)),
        "must hold channels of displacement": (
            record_of(structure, unknown, MIXED[:1], n=30),
            TimeOptions(quantities=("displacement",)),
        ),
        "at most 1000 noisy force samples": record_of(structure, unknown, MIXED, n=1001, force_noise=0.1),
        "held at zero|not part": replace(record, channels=("1Y", *record.channels[1:])),
    }
    for words, case in cases.items():
        given, options = case if isinstance(case, tuple) else (case, TimeOptions())
        with pytest.raises(InputError, match=words):
            identify_time(structure, unknown, given, options)


def test_laws_without_time_domain_are_refused():
    spring = Spring("hysteretic", "1X", "2X", stiffness=3.0, loss_factor=0.02)
    structure = Structure(chain().nodes, [*chain().elements, spring], active=["X"])
    unknown = parameters(structure, [Unknown("mass", "m", each=True)])
    with pytest.raises(InputError, match="loss factors"):
        identify_time(structure, unknown, record_of(chain(), everything(chain()), MIXED, n=30))


def test_large_models_are_refused():
    beam = Beam("beam", [[i, i + 1] for i in range(101)], 1.0, 1.0)
    structure = Structure({i: float(i) for i in range(102)}, [beam])
    record = TimeRecord(1.0, np.ones((9, 2)), ("1Y", "1Y"), ("acceleration", "force"), (1.0, 0.0))
    with pytest.raises(InputError, match="at most 200 free degrees of freedom"):
        identify_time(structure, parameters(structure, [Unknown("mass", "beam")]), record)


@pytest.mark.parametrize(
    "given",
    [{"method": "magic"}, {"force": "cubic"}, {"initial": "maybe"}, {"quantities": ("force",)}, {"restarts": -1},
     {"first_samples": 0}, {"window": 0.0}, {"rest_time": 0.0, "initial": "unknown"}],
)  # fmt: skip
def test_options_are_checked(given):
    with pytest.raises(InputError):
        TimeOptions(**given)
    with pytest.raises(InputError):
        Oscillation(-1.0)
