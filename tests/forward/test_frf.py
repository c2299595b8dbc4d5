"""FRF problems: the fast response against dense textbook matrices, and every derivative against differences."""

from dataclasses import replace

import numpy as np
import pytest

from structid import (
    Beam,
    Dashpot,
    FrfProblem,
    FrfRecord,
    Friction,
    InputError,
    PointMass,
    Prior,
    RigidLink,
    RotaryInertia,
    SpaceBeam,
    Spring,
    Structure,
    Unknown,
    estimate,
    from_matrices,
    parameters,
    with_declared_noise,
)
from structid.forward.frf.response import response


def frame():
    """A plate on two columns with springs, dashpots, friction, links and offsets: every kind of term at once."""
    nodes = {1: (0, 0, 0), 2: (0, 0, 1.0), 3: (0.4, 0, 0), 4: (0.4, 0, 1.0), 5: (0.2, 0, 1.0), 6: (0.2, 0.3, 1.1)}
    elements = [
        SpaceBeam("columns", [[1, 2], [3, 4]], 2.0, 30.0, 40.0, 5e3, 20.0, 0.01, loss_factor=0.03, mass_damping=0.4),
        PointMass("plate", [5], 3.0),
        RotaryInertia("tilt", [5], 0.2, "RY"),
        Spring("brace", "6X", stiffness=200.0, loss_factor=0.1),
        Dashpot("damper", ["5X", "5Z"], ["1X", "1Z"], viscous_damping=[4.0, 2.0]),
        Friction("rail", "3X", friction_force=0.02, measured_by=["6X-"]),
    ]
    fixed = ["1Y", "1Z", "1RX", "1RY", "1RZ", "3Y", "3Z", "3RX", "3RY", "3RZ"]
    return Structure(nodes, elements, fixed, [RigidLink("plate", 5, [2, 4, 6])])


def frame_unknowns():
    return [
        Unknown("mass", "plate"),
        Unknown("rotary_inertia", "tilt"),
        Unknown("bending_stiffness_y", "columns", each=True),
        Unknown("loss_factor", "columns"),
        Unknown("mass_damping", "columns", bounds=(0.0, 1.0)),
        Unknown("stiffness", "brace", prior=Prior(180.0, 40.0)),
        Unknown("loss_factor", "brace"),
        Unknown("viscous_damping", "damper", factor=True),
        Unknown("friction_force", "rail", positive=False),
    ]


def cantilever(n=6):
    beam = Beam("beam", [[i, i + 1] for i in range(n)], 1.0, 10.0, loss_factor=0.02, stiffness_damping=0.01)
    return Structure({i: float(i) for i in range(n + 1)}, [beam], ["0Y", "0RZ"])


def measured_frame(kind="accelerance"):
    structure = frame()
    made = parameters(structure, frame_unknowns())
    rng = np.random.default_rng(7)
    shape = (25, 3, 1)
    values = 0.1 * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    record = FrfRecord(np.linspace(0.5, 6.0, 25), values, ("6X-", "5X+", "1X+"), ("5X+",), kind)
    return structure, made, with_declared_noise(record, relative=0.02)


def dense_frf(structure, made, record, sliding):
    """Textbook: assemble dense M, C, K, H element by element in property order, invert line by line."""
    values = made.values(made.start)
    loads, sensors = structure.selection(record.inputs).toarray(), structure.selection(record.outputs).toarray()
    power = {"receptance": 0, "mobility": 1, "accelerance": 2}[record.kind]
    result = np.zeros(record.values.shape, complex)
    for line, frequency in enumerate(record.frequency):
        omega = 2 * np.pi * frequency
        z = np.zeros((structure.n_dofs, structure.n_dofs), complex)
        for part in structure.contributions:
            weights = part.weights(values)
            matrix = sum(
                part.blocks.take(np.array([e])).assemble(np.array([w])).toarray() for e, w in enumerate(weights)
            )
            law = {"mass": -(omega**2), "damping": 1j * omega, "stiffness": 1.0, "structural_damping": 1j}
            z += matrix * (law[part.matrix_kind] if part.matrix_kind in law else 1j / sliding[line])
        result[line] = (1j * omega) ** power * sensors.T @ np.linalg.inv(z) @ loads
    return result


@pytest.mark.parametrize("kind", ["receptance", "mobility", "accelerance"])
def test_response_equals_the_dense_inverse(kind):
    structure, made, record = measured_frame(kind)
    factor = (2j * np.pi * record.frequency) ** {"receptance": 0, "mobility": 1, "accelerance": 2}[kind]
    element = next(e for e in structure.elements if isinstance(e, Friction))
    sliding = element.sliding((record.values[:, [0], 0] / factor[:, None]) * -1)
    expected = dense_frf(structure, made, record, sliding)
    found = response(structure, made, record, measured_sliding=True).values_at(made.start)
    assert np.abs(found - expected).max() <= 1e-11 * np.abs(expected).max()


@pytest.mark.parametrize("measured_sliding", [True, False])
@pytest.mark.parametrize("form", ["output", "log", "pole_free"])
def test_jacobian_equals_central_differences(form, measured_sliding):
    structure, made, record = measured_frame()
    problem = FrfProblem(structure, made, record, form, measured_sliding=measured_sliding)
    theta = problem.theta_start + 0.1 * np.random.default_rng(3).standard_normal(made.n_params)
    exact = problem.linearize(theta).jacobian
    step = 1e-5
    for j, unit in enumerate(np.eye(len(theta))):
        four = [problem.residual(theta + k * step * unit) for k in (-2, -1, 1, 2)]
        difference = (four[0] - 8 * four[1] + 8 * four[2] - four[3]) / (12 * step)
        assert np.abs(exact[:, j] - difference).max() <= 1e-7 * np.abs(difference).max(), made.names[j]
    assert problem.linearize(theta).residual == pytest.approx(problem.residual(theta), rel=1e-12)


def test_a_direction_that_the_model_does_not_couple_is_compared_as_it_is_in_the_logarithmic_form():
    """Struck along X, a mass on two springs moves along X alone; what is measured along Y is noise, or some of it is not."""
    parts = [PointMass("m", [1], 2.0), Spring("x", "1X", stiffness=300.0), Spring("y", "1Y", stiffness=500.0)]
    structure = Structure({1: (0.0, 0.0)}, parts, ["1Z"])
    made = parameters(structure, [Unknown("stiffness", "x"), Unknown("mass", "m")])
    lines, rng = np.linspace(1.0, 3.0, 9), np.random.default_rng(4)
    blank = FrfRecord(lines, np.ones((9, 2, 1)), ("1X", "1Y"), ("1X",), "receptance")
    true = FrfProblem(structure, made, blank, model_error=1.0).predicted(made.theta_start + 0.1)
    std = 0.01 * np.abs(true[:, :1, :]) * np.ones((1, 2, 1))
    values = true + std * (rng.standard_normal(true.shape) + 1j * rng.standard_normal(true.shape))
    values[4, 1] = 50.0 * std[4, 1]
    problem = FrfProblem(structure, made, replace(blank, values=values, variance=2 * std**2), "log")
    at = problem.linearize(problem.theta_start)
    assert np.all(np.isfinite(at.residual))
    assert np.all(np.isfinite(at.jacobian))
    noise = problem.residual(made.theta_start + 0.1)
    assert 0.5 < np.median(np.abs(noise)) < 0.9
    step = 1e-6
    for j, unit in enumerate(np.eye(2)):
        ends = [problem.residual(problem.theta_start + sign * step * unit) for sign in (1, -1)]
        difference = (ends[0] - ends[1]) / (2 * step)
        assert at.jacobian[:, j] == pytest.approx(difference, rel=1e-6, abs=1e-6 * np.abs(difference).max())


def test_sparse_factorization_and_matrix_groups_equal_the_dense_path():
    """80 elements (160 unknown motions) take the sparse solver; the same beam as imported groups must agree."""
    structure = cantilever(80)
    record = FrfRecord(
        np.array([0.001, 0.01, 0.05]), np.ones((3, 2, 2)), ("80Y-", "40RZ"), ("80Y", "20Y"), "receptance"
    )
    made = parameters(
        structure, [Unknown("bending_stiffness", "beam:1-40"), Unknown("bending_stiffness", "beam:41-80")]
    )
    values, derivative = response(structure, made, record).derivatives_at(made.start)
    laws = {law: structure.matrix(law).toarray() for law in ("mass", "damping", "stiffness", "structural_damping")}
    for line, omega in enumerate(record.omega):
        z = laws["stiffness"] + 1j * laws["structural_damping"] + 1j * omega * laws["damping"] - omega**2 * laws["mass"]
        loads, sensors = structure.selection(record.inputs).toarray(), structure.selection(record.outputs).toarray()
        expected = sensors.T @ np.linalg.solve(z, loads)
        # clamped beam of 80 elements: condition of z about 1e10, so 1e-16 of rounding shows as 1e-6 at most
        assert np.abs(values[line] - expected).max() <= 1e-6 * np.abs(expected).max()
    half = [np.r_[np.full(40, 10.0), np.zeros(40)], np.r_[np.zeros(40), np.full(40, 10.0)]]
    bending = next(p for p in structure.contributions if p.matrix_kind == "stiffness")
    groups = {
        name: {"stiffness": bending.blocks.assemble(w), "loss_factor": 0.02} for name, w in zip("ab", half, strict=True)
    }
    groups["rest"] = {"mass": structure.matrix("mass"), "damping": structure.matrix("damping")}
    imported = from_matrices(groups, structure.dofs)
    scaled = parameters(imported, [Unknown("stiffness", "a"), Unknown("stiffness", "b")])
    same, slope = response(imported, scaled, record).derivatives_at(scaled.start)
    assert np.abs(same - values).max() <= 1e-6 * np.abs(values).max()
    assert np.abs(slope - 10.0 * derivative).max() <= 1e-6 * np.abs(slope).max()


def test_reciprocity_and_unit_scaling():
    """Swapping load and sensor changes nothing; all masses, stiffnesses and dashpots times ten give a tenth."""
    structure = cantilever()
    made = parameters(
        structure, [Unknown("mass", "beam"), Unknown("stiffness", "beam"), Unknown("stiffness_damping", "beam")]
    )
    forward = FrfRecord(np.linspace(0.1, 1, 9), np.ones((9, 1, 1)), ("6Y",), ("3RZ",), "receptance")
    backward = replace(forward, outputs=("3RZ",), inputs=("6Y",))
    a = response(structure, made, forward).values_at(made.start)
    b = response(structure, made, backward).values_at(made.start)
    assert a == pytest.approx(b, rel=1e-10)
    tenth = response(structure, made, forward).values_at(10 * made.start)
    assert 10 * tenth == pytest.approx(a, rel=1e-10)


def test_log_form_is_not_drawn_to_large_masses_by_errors_in_proportion():
    """Two lines whose measured magnitudes err by factors of 2 and 1/2: log gives the middle, relative output does not."""
    structure = Structure({1: 0.0}, [PointMass("m", [1], 1.0, directions=("X",))])
    made = parameters(structure, [Unknown("mass", "m")])
    frequency = np.array([1.0, 2.0])
    record = FrfRecord(frequency, np.array([2.0, 0.5]).reshape(2, 1, 1), ("1X",), ("1X",), "accelerance")
    log = estimate(FrfProblem(structure, made, record, "log", model_error=0.1))
    output = estimate(FrfProblem(structure, made, record, "output", model_error=0.1))
    # the search ends when the promised decrease is 1e-13 of the sum of squares: 3e-7 in a parameter
    assert log.values == pytest.approx([1.0], rel=1e-6)
    assert output.values == pytest.approx([4.25 / 2.5], rel=1e-6)  # sum(1/m^2) / sum(1/m): small H, large mass


def test_missing_noise_and_zero_noise_are_refused():
    structure, made, record = measured_frame()
    with pytest.raises(InputError, match="no noise level"):
        FrfProblem(structure, made, replace(record, variance=None))
    variance = np.array(record.variance)
    variance[3, 1, 0] = 0.0
    with pytest.raises(InputError, match=r"noise of 5X\+/.* is 0 at"):
        FrfProblem(structure, made, replace(record, variance=variance))
    values, variance = np.array(record.values), np.array(record.variance)
    values[:, 1, 0], variance[:, 1, 0] = 0.0, 0.0
    with pytest.raises(InputError, match=r"5X\+/.* is 0 at every line, as a dead channel reads"):
        FrfProblem(structure, made, replace(record, values=values, variance=variance))


def test_friction_needs_its_sensor_and_one_load():
    structure, made, record = measured_frame()
    with pytest.raises(InputError, match="no output 6X"):
        response(structure, made, record.channels(record.outputs[1:]), measured_sliding=True)
    double = FrfRecord(
        record.frequency, np.repeat(record.values, 2, 2), record.outputs, ("5X", "1X"), kind="accelerance"
    )
    with pytest.raises(InputError, match="one load"):
        response(structure, made, double)
