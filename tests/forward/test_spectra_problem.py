"""Finite records: the transient is exact, the gradient is that of the likelihood, and noise on the force leaves no bias."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg

import structid as sid
from short_record_cases import RATE, chain, record, unknowns
from structid import InputError, Prior, Search, Status, estimate
from structid.forward import SpectraProblem, damped_stages
from structid.forward.time.spectra import spectra_problem
from structid.records.spectra import finite_spectra


@pytest.mark.parametrize("decay", [0.0, 0.5])
@pytest.mark.parametrize("quantity", ["displacement", "velocity", "acceleration"])
def test_spectra_problem_is_exact_for_a_record_that_neither_starts_nor_ends_at_rest(quantity, decay):
    # The transient of the four modes is exact; what is left is the alias of the jump, which the polynomial takes
    # to 1e-4 of the motion. Without the transient the same data miss by a tenth.
    structure = chain()
    unknown = unknowns(structure)
    rng = np.random.default_rng(0)
    clean = record(
        structure, unknown.values(unknown.start), rng, noise=0.0, force_noise=0.0, quantities=(quantity,) * 2
    )
    clean = replace(clean, variance=np.concatenate([[0.0], (clean.values[:, 1:] ** 2).mean(axis=0)]))
    spectra = finite_spectra(clean, band=(0.1, 12.0), decay=decay)
    with_transient = SpectraProblem(structure, unknown, spectra)
    without = SpectraProblem(structure, unknown, spectra, transient=False)
    error = [np.sqrt(np.mean(p.residual(p.theta_start) ** 2)) for p in (with_transient, without)]
    assert error[0] < 1e-4
    assert error[1] > 100 * error[0]


def test_spectra_jacobian_gives_the_gradient_of_the_likelihood():
    structure = chain()
    unknown = unknowns(structure, prior=Prior(3.0, 1.0))
    rng = np.random.default_rng(1)
    noisy = record(
        structure, unknown.values(unknown.start), rng, force_noise=0.05, quantities=("acceleration", "velocity")
    )
    problem = spectra_problem(structure, unknown, noisy, band=(0.1, 12.0))
    theta = problem.theta_start + 0.05 * rng.standard_normal(12)
    at = problem.linearize(theta)
    np.testing.assert_allclose(at.residual, problem.residual(theta), rtol=1e-9, atol=1e-9)
    gradient = 2 * at.jacobian.T @ at.residual
    step = 1e-5
    costs = np.array([[np.sum(problem.residual(theta + sign * step * e) ** 2) for sign in (1, -1)] for e in np.eye(12)])
    difference = (costs[:, 0] - costs[:, 1]) / (2 * step)
    np.testing.assert_allclose(gradient, difference, atol=1e-6 * np.abs(gradient).max())


@pytest.mark.parametrize("decay", [0.0, 0.7])
def test_spectra_residual_is_the_textbook_likelihood(decay):
    # Dense construction: C = cov(y) + H cov(u) H', and the transient found by lstsq on whitened rows.
    structure = chain()
    unknown = unknowns(structure)
    rng = np.random.default_rng(2)
    noisy = record(structure, unknown.values(unknown.start), rng, force_noise=0.1)
    problem = SpectraProblem(structure, unknown, finite_spectra(noisy, band=(0.3, 8.0), decay=decay), order=2)
    spectra = problem.spectra
    values = unknown.values(unknown.start)
    mass, damping, stiffness = (structure.matrix(kind, values).toarray() for kind in ("mass", "damping", "stiffness"))
    load = structure.selection(spectra.inputs).toarray()
    pick = structure.selection(spectra.outputs).toarray()
    rows, right = [], []
    top = abs(spectra.laplace[-1])
    for line, s in enumerate(spectra.laplace):
        inverse = np.linalg.inv(s**2 * mass + s * damping + stiffness)
        h = s**2 * pick.T @ inverse @ load
        noise = np.diag(spectra.motion_variance[line]) + spectra.force_variance[line] * h @ h.conj().T
        root = linalg.sqrtm(np.linalg.inv(noise)) * np.sqrt(2)
        power = s / top
        poly = np.kron(np.eye(2), power ** np.arange(3))
        columns = np.hstack([s**2 * pick.T @ inverse @ mass, s * s**2 * pick.T @ inverse @ mass, poly])
        rows.append(root @ columns)
        right.append(root @ (h @ spectra.force[line] - spectra.motion[line]))
    table, error = np.concatenate(rows), np.concatenate(right)
    table, error = np.concatenate([table.real, table.imag]), np.concatenate([error.real, error.imag])
    scale = np.linalg.norm(table, axis=0)
    misfit = error - table / scale @ np.linalg.lstsq(table / scale, error, rcond=1e-12)[0]
    at = problem.linearize(problem.theta_start)
    assert at.residual @ at.residual == pytest.approx(misfit @ misfit, rel=1e-9)
    assert at.n_eliminated == np.linalg.matrix_rank(table / scale, 1e-10)


def test_spectra_estimates_are_unbiased_and_their_intervals_hold_with_noise_on_the_force():
    structure = chain()
    unknown = unknowns(structure)
    scores, chi = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        noisy = record(structure, unknown.values(unknown.start), rng, noise=0.02, force_noise=0.1)
        problem = spectra_problem(structure, unknown, noisy, band=(0.1, 12.0))
        found = estimate(problem)
        assert found.status is Status.CONVERGED
        scores.append((found.values - unknown.start) / found.std_noise)
        chi.append(found.chi_square_per_dof)
    # 144 scores of 12 correlated parameters over 12 records: mean 0 +- 0.3, variance 1 within a factor of 1.6.
    assert np.abs(np.mean(scores)) < 0.6
    assert 0.6 < np.mean(np.square(scores)) < 1.6
    # about 900 degrees of freedom a record: the mean of twelve has a standard deviation of 0.014
    assert np.mean(chi) == pytest.approx(1.0, abs=0.05)


def test_spectra_are_identified_from_a_poor_start_through_faded_records():
    structure = chain()
    truth = unknowns(structure)
    rng = np.random.default_rng(4)
    noisy = record(structure, truth.values(truth.start), rng)
    start = truth.started_at(truth.start * np.exp(0.5 * rng.standard_normal(12)))
    problem = spectra_problem(structure, start, noisy, band=(0.1, 12.0))
    found = estimate(problem, plans=damped_stages(problem, noisy), search=Search(restarts=2))
    assert found.status is Status.CONVERGED
    assert found.covariance_basis == "noise"
    assert (np.abs(found.values - truth.start) < 4 * found.std).all()


def test_the_stages_of_a_periodic_record_are_exact_though_it_fades():
    # one period of a steady motion: the record needs no transient, its faded copies do
    structure = chain()
    unknown = unknowns(structure)
    n_times = 800
    clean = record(structure, unknown.values(unknown.start), np.random.default_rng(5), noise=0.0, force_noise=0.0)
    lines = np.fft.rfftfreq(n_times, 1 / RATE)[1:240]
    spectra = finite_spectra(replace(clean, variance=np.ones(3)), band=(lines[0], lines[-1]))
    h = SpectraProblem(structure, unknown, spectra).predicted(unknown.theta_start)[:, :, 0]
    rng = np.random.default_rng(6)
    force = np.exp(2j * np.pi * rng.uniform(size=len(lines)))
    table = np.zeros((n_times // 2 + 1, 3), complex)
    table[1:240] = np.column_stack([force, force[:, None] * h])
    values = np.fft.irfft(table, n_times, axis=0)
    periodic = replace(clean, values=values, variance=1e-12 * (values**2).mean(axis=0))
    problem = spectra_problem(structure, unknown, periodic, band=(0.1, 12.0), transient=False)
    assert np.sqrt(np.mean(problem.residual(problem.theta_start) ** 2)) < 1e-3
    for name, stage in damped_stages(problem, periodic)[0]:
        # each value counts with an error of a tenth of itself in a stage; without the transient the first misses by five
        assert np.sqrt(np.mean(stage.residual(stage.theta_start) ** 2)) < 1e-3, name


def test_a_kept_evaluation_and_a_part_of_the_lines_are_those_of_the_whole():
    structure = chain()
    unknown = unknowns(structure)
    noisy = record(structure, unknown.values(unknown.start), np.random.default_rng(7), force_noise=0.05)
    problem = spectra_problem(structure, unknown, noisy, band=(0.1, 12.0))
    theta, other = problem.theta_start + 0.01, problem.theta_start - 0.01
    plain = problem.linearize(theta)
    problem.residual(theta)
    kept = problem.linearize(theta)
    problem.residual(other)
    after = problem.linearize(theta)  # what was kept is of another point
    for at in (kept, after):
        np.testing.assert_array_equal(at.residual, plain.residual)
        np.testing.assert_array_equal(at.jacobian, plain.jacobian)
    assert problem.subsampled() is None  # too few to be worth it
    lines = np.arange(0, len(problem.frequency), 3)
    part = problem.with_lines(lines)
    np.testing.assert_array_equal(part.frequency, problem.frequency[lines])
    np.testing.assert_allclose(part.predicted(theta), problem.predicted(theta)[lines], rtol=1e-12)
    np.testing.assert_array_equal(part.spectra.motion_variance, problem.spectra.motion_variance[lines])


@pytest.mark.parametrize("decay", [0.0, 0.5])
def test_tones_that_no_force_made_are_taken_out_of_the_motions(decay):
    # On a line and between two, each half a promille of a line beside what is stated.
    structure = chain()
    unknown = unknowns(structure)
    rng = np.random.default_rng(6)
    clean = record(structure, unknown.values(unknown.start), rng, noise=0.0, force_noise=0.0)
    clean = replace(clean, variance=np.concatenate([[0.0], 1e-4 * (clean.values[:, 1:] ** 2).mean(axis=0)]))
    n = len(clean.values)
    time, line = np.arange(n) / RATE, RATE / n
    stated = (np.round(3.0 / line) * line, np.round(7.0 / line) * line + 0.4 * line)
    loud = clean.values[:, 1:].std(axis=0) * sum(
        np.sin(2 * np.pi * (f + 5e-4 * line) * time[:, None] + rng.uniform(0, 6, 2)) for f in stated
    )
    humming = replace(clean, values=clean.values + np.column_stack([np.zeros(n), loud]))

    def miss(made, tones):
        spectra = finite_spectra(made, band=(0.1, 12.0), decay=decay)
        problem = SpectraProblem(structure, unknown, spectra, tones=tones)
        at = problem.linearize(problem.theta_start)
        assert at.n_eliminated >= 4 * len(tones) * 2
        return np.sum(at.residual**2)

    quiet = miss(clean, stated)
    assert miss(humming, ()) > 1e4 + 10 * quiet
    assert miss(humming, stated) < quiet + 1.0


def test_tones_keep_the_gradient_of_the_likelihood():
    structure = chain()
    unknown = unknowns(structure)
    rng = np.random.default_rng(7)
    noisy = record(structure, unknown.values(unknown.start), rng, force_noise=0.05)
    problem = replace(spectra_problem(structure, unknown, noisy, band=(0.1, 12.0)), tones=(4.0,))
    theta = problem.theta_start + 0.05 * rng.standard_normal(len(problem.theta_start))
    at = problem.linearize(theta)
    step, unit = 1e-5, np.eye(len(theta))
    costs = np.array([[np.sum(problem.residual(theta + sign * step * e) ** 2) for sign in (1, -1)] for e in unit])
    gradient = 2 * at.jacobian.T @ at.residual
    np.testing.assert_allclose(gradient, (costs[:, 0] - costs[:, 1]) / (2 * step), atol=1e-6 * np.abs(gradient).max())


def test_spectra_problem_refuses_friction_and_silence_on_noise():
    structure = chain(friction=True)
    unknown = unknowns(structure)
    plain = chain()
    clean = record(plain, unknowns(plain).values(unknowns(plain).start), np.random.default_rng(5))
    with pytest.raises(InputError, match="friction 'rail'"):
        spectra_problem(structure, unknown, clean)
    with pytest.raises(InputError, match="no noise level"):
        spectra_problem(plain, unknowns(plain), replace(clean, variance=None))


def test_the_transient_of_a_mode_that_no_sensor_sees_bounds_no_derivative():
    """Two equal masses on either side of a sensor in their middle: their motion against each other is not seen."""
    parts = [sid.PointMass("m", [1, 2, 3], 2.0), sid.Dashpot("c", ["1X", "3X"], ["2X", "2X"], viscous_damping=0.7)]
    parts.append(sid.Spring("k", ["1X", "3X"], ["2X", "2X"], stiffness=1000.0))
    parts.append(sid.Spring("g", "2X", stiffness=500.0))
    structure = sid.Structure({1: 0.0, 2: 1.0, 3: 2.0}, parts, active=["X"])
    unknown = sid.parameters(structure, [sid.Unknown("stiffness", "k", each=True)])
    values = np.random.default_rng(4).standard_normal((800, 2))
    history = sid.TimeRecord(40.0, values, ("2X", "2X"), ("force", "acceleration"), variance=np.array([0.0, 0.01]))
    problem = spectra_problem(structure, unknown, history, band=(0.1, 12.0))
    jacobian = problem.linearize(problem.theta_start).jacobian[: problem.n_data]
    np.testing.assert_allclose(jacobian[:, 0], jacobian[:, 1], rtol=1e-6, atol=1e-6 * np.abs(jacobian).max())


def test_the_transient_of_a_mode_that_no_sensor_sees_bounds_no_derivative_of_a_fine_mesh():
    """A beam of 400 elements with its sensor in the middle: its halves are equal, and rounding of their motion is 1e-9 of it."""
    n, middle = 400, 200
    halves = [
        sid.Beam(name, [[i, i + 1] for i in line], 50.0, 2e6, loss_factor=0.02)
        for name, line in (("left", range(middle)), ("right", range(middle, n)))
    ]
    structure = sid.Structure({i: i * 10.0 / n for i in range(n + 1)}, halves, ["0Y", f"{n}Y"], active=["Y", "RZ"])
    unknown = sid.parameters(structure, [sid.Unknown("bending_stiffness", half.name) for half in halves])
    values, place = np.random.default_rng(4).standard_normal((300, 2)), f"{middle}Y"
    history = sid.TimeRecord(200.0, values, (place, place), ("force", "acceleration"), variance=np.array([0.0, 0.01]))
    problem = spectra_problem(structure, unknown, history, band=(1.0, 90.0))
    jacobian = problem.linearize(problem.theta_start).jacobian[: problem.n_data]
    np.testing.assert_allclose(jacobian[:, 0], jacobian[:, 1], rtol=1e-5, atol=1e-5 * np.abs(jacobian).max())
