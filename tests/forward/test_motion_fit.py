"""Identification from motion: exact recovery on several structures, chunks and merging, covariance, bias."""

import sys

import numpy as np
import pytest
from motion_cases import EVERYTHING, cantilever, frame, free_beam, moved

import structid.forward.motion.equations as time_equations_module
from structid import (
    Beam,
    PointMass,
    Spring,
    Status,
    Structure,
    TimeRecord,
    Unknown,
    from_matrices,
    parameters,
)
from structid.dynamics import harmonic_transient
from structid.dynamics.normal_modes import modes
from structid.forward import Motion, identify_motion, least_squares_bias
from structid.forward.motion.equations import time_equations
from structid.forward.motion.fit import motion_fit


def test_space_frame_with_damping_is_recovered():
    """57 parameters of a 3-D frame, 24 motions, condition 7: rounding leaves 4e-13."""
    structure = frame()
    names = (
        "mass", "polar_inertia", "bending_stiffness_y", "bending_stiffness_z", "axial_stiffness", "torsional_stiffness",
        "mass_damping",
    )  # fmt: skip
    unknowns = [Unknown(name, "frame", each=True) for name in names] + [Unknown("viscous_damping", "damper")]
    unknown = parameters(structure, unknowns)
    motion = moved(structure, n=80, rate=2000.0, loads=(0, 4, 7, 9, 14, 20))
    found = identify_motion(structure, unknown, motion)
    assert found.status is Status.CONVERGED
    assert (unknown.n_params, found.identifiability.rank) == (57, 57)
    assert np.abs(found.values / unknown.start - 1).max() <= 1e-11


def test_groups_ties_factors_and_known_properties_go_where_they_belong():
    """Wrong nominal values of the unknowns do not matter, right ones of the others do."""
    structure = cantilever()
    unknown = parameters(
        structure,
        [
            Unknown("mass", "beam:1-2", factor=True, start=3.0),
            Unknown("mass", "beam:3", start=9.0),
            Unknown("bending_stiffness", "beam:1", start=2.0),
            Unknown("bending_stiffness", "beam:2", tied_to="bending_stiffness[beam:1]", ratio=1.7),
            Unknown("mass_damping", "beam:4", start=1.0),
        ],
    )
    values = structure.values.copy()
    rows = {p.term.property: p.values.start for p in structure.properties}
    true = np.array([0.8, 1.3, 6.0, 0.21])
    values[rows["mass"] : rows["mass"] + 2] *= true[0]
    values[rows["mass"] + 2] = true[1]
    values[rows["bending_stiffness"] : rows["bending_stiffness"] + 2] = true[2], 1.7 * true[2]
    values[rows["mass_damping"] + 3] = true[3]
    part = {
        name: values[start : start + 4]
        for name, start in rows.items()
        if name not in ("loss_factor", "axial_stiffness")
    }
    actual = Structure(structure.nodes, [Beam("beam", structure.elements[0].nodes, **part)], ["0Y", "0RZ"])
    found = identify_motion(structure, unknown, moved(actual))
    assert found.values == pytest.approx(true, rel=1e-10)
    assert found.initial == pytest.approx([3.0, 9.0, 2.0, 1.0])


def dense_equations(structure, unknown, motion):
    """B and c as the textbook has them: dM/dp a + dC/dp v + dK/dp w, all samples one under another."""
    kinds = (("mass", motion.acceleration), ("damping", motion.velocity), ("stiffness", motion.displacement))

    def force(values):
        return sum(field @ structure.matrix(kind, values).toarray() for kind, field in kinds).ravel()

    columns = [force(unknown.design[:, [p]].toarray()[:, 0]) for p in range(unknown.n_params)]
    return np.stack(columns, axis=1), motion.force.ravel() - force(unknown.offset)


@pytest.mark.parametrize("one_block", [False, True])
@pytest.mark.parametrize("weighted", [False, True])
def test_noisy_fit_equals_dense_least_squares(one_block, weighted, monkeypatch):
    if one_block:
        monkeypatch.setattr(time_equations_module, "_STATE_ENTRIES", 0)
    structure = cantilever()
    unknown = parameters(structure, [*EVERYTHING[:2], Unknown("mass_damping", "beam:2-3")])
    exact, rng = moved(structure), np.random.default_rng(7)
    noisy = {name: getattr(exact, name) * (1 + 0.05 * rng.standard_normal(exact.force.shape)) for name in
             ("acceleration", "velocity", "displacement")}  # fmt: skip
    motion = Motion(exact.time, exact.force, **noisy)
    weights = np.linspace(0.5, 2.0, structure.n_dofs) if weighted else None
    fit = motion_fit(structure, unknown, weights).updated(motion)
    assert len(fit.equations.columns) == (1 if one_block else structure.n_dofs)
    matrix, right = dense_equations(structure, unknown, motion)
    if weighted:
        rows = np.tile(weights, motion.n_times)
        matrix, right = matrix * rows[:, None], right * rows
    scale = np.linalg.norm(matrix, axis=0)
    expected = np.linalg.lstsq(matrix / scale, right, rcond=None)[0] / scale
    residual = right - matrix @ expected
    variance = residual @ residual / (len(right) - 9)
    covariance = np.linalg.inv(matrix.T @ matrix) * variance
    found = fit.estimate()
    assert found.values == pytest.approx(expected, rel=1e-11)
    assert found.covariance == pytest.approx(covariance, rel=1e-8, abs=1e-14)
    assert found.goodness.degrees_of_freedom == len(right) - 9
    assert fit.solution().condition == pytest.approx(np.linalg.cond(matrix / scale), rel=1e-9)


@pytest.mark.parametrize("one_block", [False, True])
def test_one_sample_one_chunk_and_the_whole_record_give_the_same(one_block, monkeypatch):
    """Noisy motion; parts fitted apart and merged in any order too. To 1e-12 of each value."""
    if one_block:
        monkeypatch.setattr(time_equations_module, "_STATE_ENTRIES", 0)
    structure = cantilever()
    unknown = parameters(structure, EVERYTHING)
    exact, rng = moved(structure), np.random.default_rng(3)
    motion = Motion(
        exact.time,
        exact.force,
        exact.acceleration * (1 + 0.01 * rng.standard_normal(exact.force.shape)),
        exact.velocity,
        exact.displacement,
    )
    empty = motion_fit(structure, unknown)
    variance = {"acceleration": 0.1}
    whole = empty.updated(motion, variance)
    single = empty
    for k in range(motion.n_times):
        single = single.updated(motion.at([k]), variance)
    parts = [empty.updated(motion.at(slice(*edges)), variance) for edges in ((0, 7), (7, 40), (40, 60))]
    merged = parts[2].merged(parts[0]).merged(parts[1])
    monkeypatch.setattr(sys.modules["structid.forward.motion.fit"], "_CHUNK_ENTRIES", 1)
    chunked = empty.updated(motion, variance)
    expected = whole.estimate()
    for fit in (single, merged, chunked, parts[0].merged(parts[1].merged(parts[2]))):
        found = fit.estimate()
        assert found.values == pytest.approx(expected.values, rel=1e-12)
        assert found.std_noise == pytest.approx(expected.std_noise, rel=1e-10)
        assert fit.n_samples == 60
        assert fit.energy == pytest.approx(whole.energy, rel=1e-12)
        assert fit.error == pytest.approx(whole.error, rel=1e-12)
        assert fit.bias() == pytest.approx(whole.bias(), rel=1e-9)
    assert empty.n_samples == 0


def test_matrix_groups_of_another_code_are_identified():
    structure = cantilever()
    groups = {
        "a": {"mass": structure.matrix("mass"), "stiffness": 0.3 * structure.matrix("stiffness")},
        "b": {"stiffness": 0.7 * structure.matrix("stiffness") + np.eye(8), "damping": structure.matrix("damping")},
    }
    imported = from_matrices(groups, [str(d) for d in structure.dofs])
    unknown = parameters(
        imported, [Unknown("mass", "a"), Unknown("stiffness", "a"), Unknown("stiffness", "b"), Unknown("damping", "b")]
    )
    found = identify_motion(imported, unknown, moved(imported))
    assert found.values == pytest.approx(np.ones(4), rel=1e-9)


def test_record_gives_the_same_as_motion_and_integration_comes_close():
    """Rule `trapezoid` at (omega h)^2 / 12 = 2e-3 for the highest natural frequency."""
    beam = Beam("beam", [[0, 1], [1, 2]], [1.3, 1.9], [7.0, 19.0])
    structure = Structure({0: 0.0, 1: 1.0, 2: 2.0}, [beam], ["0Y", "0RZ"])
    unknown = parameters(structure, EVERYTHING[:2])
    mass, stiffness = structure.matrix("mass"), structure.matrix("stiffness")
    highest = 2 * np.pi * modes(mass, stiffness).frequency[-1]
    rate = highest / np.sqrt(12 * 2e-3)
    time = np.arange(1000) / rate
    load = np.array([0.0, 0, 1, 0.3])
    moving = harmonic_transient(mass, stiffness, load, 0.3 * highest, time)
    force = np.cos(0.3 * highest * time)[:, None] * load
    channels = [str(d) for d in structure.dofs]
    values = [moving.acceleration, moving.velocity, moving.displacement, force]
    names = np.repeat(["acceleration", "velocity", "displacement", "force"], 4).tolist()
    record = TimeRecord(rate, np.hstack(values), channels * 4, names)
    assert identify_motion(structure, unknown, record).values == pytest.approx(unknown.start, rel=1e-11)
    only = TimeRecord(rate, np.hstack([values[0], force]), channels * 2, names[:4] + names[12:])
    found = identify_motion(structure, unknown, only, rule="trapezoid")
    error = np.abs(found.values / unknown.start - 1).max()
    assert 1e-6 < error <= 1e-2


def test_covariance_covers_force_noise_as_often_as_it_says():
    """Exact motion and 5 % force noise, where least squares is right: 400 repeats, seeds 0 to 399, 8 parameters.

    95 % intervals of each parameter within four binomial standard deviations, 4.4 %; mean squared standardized error
    within 10 % of 1.
    """
    structure = cantilever()
    unknown = parameters(structure, EVERYTHING[:2])
    motion = moved(structure)
    size = 0.05 * motion.force.std()
    fit = motion_fit(structure, unknown)
    scores = []
    for seed in range(400):
        noise = size * np.random.default_rng(seed).standard_normal(motion.force.shape)
        noisy = Motion(motion.time, motion.force + noise, motion.acceleration, motion.velocity, motion.displacement)
        found = fit.updated(noisy).estimate()
        scores.append((found.values - unknown.start) / found.std)
    inside = (np.abs(scores) <= 1.96).mean(axis=0)
    assert np.abs(inside - 0.95).max() <= 0.044
    assert (np.array(scores) ** 2).mean() == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("known_part", [False, True])
def test_predicted_bias_is_the_mean_error_over_repeats(known_part):
    """Noise on all three quantities, small enough for first order: 300 seeds, within 10 % of the largest bias."""
    structure = cantilever(2)
    chosen = [Unknown("mass", "beam:1"), Unknown("bending_stiffness", "beam", each=True)]
    unknown = parameters(structure, chosen if known_part else [*EVERYTHING[:2], EVERYTHING[3]])
    motion = moved(structure, n=500, rate=50.0)
    std = {name: 0.03 * getattr(motion, name).std(axis=0) for name in ("acceleration", "velocity", "displacement")}
    fit = motion_fit(structure, unknown)
    errors = []
    for seed in range(300):
        rng = np.random.default_rng(seed)
        noisy = {name: getattr(motion, name) + s * rng.standard_normal(motion.force.shape) for name, s in std.items()}
        errors.append(fit.updated(Motion(motion.time, motion.force, **noisy)).solution().values - unknown.start)
    relative = np.mean(errors, axis=0) / unknown.start
    variance = {name: s**2 for name, s in std.items()}
    predicted = least_squares_bias(structure, unknown, motion, variance, exact_motion=True) / unknown.start
    assert np.abs(relative).max() > 0.01
    assert np.abs(predicted - relative).max() <= 0.1 * np.abs(relative).max()
    last = Motion(motion.time, motion.force, **noisy)
    from_noisy = least_squares_bias(structure, unknown, last, variance) / unknown.start
    assert np.abs(from_noisy - relative).max() <= 0.15 * np.abs(relative).max()
    message = fit.updated(last, variance).estimate().message
    assert "predicted bias from the noise of the motion" in message


def test_bias_through_a_noisy_known_property():
    """A stiff known spring beside a soft unknown one: its own noise rules the bias, 200 seeds, within 10 %."""
    parts = [
        PointMass("mass", [1, 2], 1.0),
        Spring("stiff", "1X", stiffness=50.0),
        Spring("soft", "1X", "2X", stiffness=4.0),
    ]
    structure = Structure({1: 0.0, 2: 1.0}, parts, active=["X"])
    unknown = parameters(structure, [Unknown("stiffness", "soft")])
    motion = moved(structure, n=400, loads=(0, 1))
    std = 0.1 * motion.displacement.std(axis=0)
    fit, errors = motion_fit(structure, unknown), []
    for seed in range(200):
        noise = std * np.random.default_rng(seed).standard_normal(motion.force.shape)
        noisy = Motion(motion.time, motion.force, motion.acceleration, motion.velocity, motion.displacement + noise)
        errors.append(fit.updated(noisy).solution().values[0] - 4.0)
    predicted = least_squares_bias(structure, unknown, motion, {"displacement": std**2}, exact_motion=True)
    assert abs(np.mean(errors)) > 4 * np.std(errors) / np.sqrt(200)
    assert predicted[0] == pytest.approx(np.mean(errors), rel=0.1)


def test_size_of_a_column_without_cancellation_bounds_its_norm():
    structure = cantilever()
    unknown = parameters(structure, EVERYTHING)
    motion = moved(structure)
    fit = motion_fit(structure, unknown).updated(motion)
    norm = np.linalg.norm(dense_equations(structure, unknown, motion)[0], axis=0)
    size = fit.equations.sizes(fit.energy)
    assert (size >= norm * (1 - 1e-12)).all()
    assert (size <= 1e4 * norm).all()


def test_message_says_that_least_squares_is_biased():
    structure = cantilever()
    found = identify_motion(structure, parameters(structure, EVERYTHING), moved(structure))
    assert "biases the values" in found.message
    assert "rank 16 of 16" in found.message
    assert np.isnan(found.spread.covariance_model_error).all()
    assert np.isnan(found.goodness.chi_square)
    assert found.covariance_basis == "noise"


def test_free_motion_is_enough_where_something_is_known():
    """Free vibration with one known mass: the scale comes from it."""
    structure = cantilever()
    motion = moved(structure)
    exact = motion.acceleration @ structure.matrix("mass") + motion.velocity @ structure.matrix("damping")
    w = -np.linalg.solve(structure.matrix("stiffness").toarray(), exact.T).T
    free = Motion(motion.time, np.zeros((60, 8)), motion.acceleration, motion.velocity, w)
    unknown = parameters(structure, [Unknown("mass", "beam:2-4", each=True), *EVERYTHING[1:]])
    assert identify_motion(structure, unknown, free).values == pytest.approx(unknown.start, rel=1e-8)


def test_velocity_is_not_asked_for_without_damping():
    structure = free_beam()
    motion = moved(structure)
    bare = Motion(motion.time, motion.force, motion.acceleration, None, motion.displacement)
    unknown = parameters(structure, EVERYTHING[:2])
    assert identify_motion(structure, unknown, bare).values == pytest.approx(unknown.start, rel=1e-10)
    assert time_equations(structure, unknown).columns.shape == (6, 4)
