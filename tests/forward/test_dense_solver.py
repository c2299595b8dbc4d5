"""Small and medium models: values and Jacobians by poles, by factorization and with friction, as textbooks construct them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize

import structid as sid
from structid.forward.frf.response import ResponseCache, response
from structid.forward.frf.solvers import DenseOrSparseSolver
from structid.records.record import DERIVATIVES

LAWS = ("mass", "damping", "stiffness", "structural_damping")


def column(n=6, viscous=0.0, friction=(), record_kind="accelerance", n_lines=400):
    """Beam elements on a spring, every property unknown, friction (element, place, force) on it; its record is blank."""
    beam = sid.Beam("beam", [[i, i + 1] for i in range(n)], 1.0, 10.0, loss_factor=0.02, stiffness_damping=viscous)
    tip = sid.Spring("tip", f"{n}Y", stiffness=3.0, loss_factor=0.1)
    slides = [sid.Friction(f"slide{k}", *ends, friction_force=force) for k, (ends, force) in enumerate(friction)]
    structure = sid.Structure({i: float(i) for i in range(n + 1)}, [beam, tip, *slides], ["0Y", "0RZ"])
    unknowns = [
        sid.Unknown("mass", "beam:1-2"),
        sid.Unknown("bending_stiffness", "beam", each=n <= 6),
        sid.Unknown("loss_factor", "beam"),
        sid.Unknown("stiffness", "tip"),
        *[sid.Unknown("friction_force", f"slide{k}", positive=False) for k in range(len(friction))],
    ]
    unknowns += [sid.Unknown("stiffness_damping", "beam")] if viscous else []
    made = sid.parameters(structure, unknowns)
    outputs, inputs = (f"{n}Y-", f"{n // 2}RZ+", f"{n // 2}Y+"), (f"{n}Y+", "2Y-")
    inputs = inputs[: 1 if friction else 2]
    lowest = (1.875 / n) ** 2 * np.sqrt(10.0) / (2 * np.pi)
    lines = np.linspace(0.3, 60.0, n_lines) * lowest
    return structure, made, sid.FrfRecord(lines, np.ones((n_lines, 3, len(inputs))), outputs, inputs, record_kind)


def stiffness(structure, values, laplace, amplitudes=None):
    """Z at every line: the sum of all matrices, and of friction over its amplitudes (n_lines, n_contacts)."""
    s = laplace[:, None, None]
    factors = dict(zip(LAWS, (s**2, s, 1.0, 1j), strict=True))
    total = np.zeros((len(laplace), structure.n_dofs, structure.n_dofs), complex)
    for law, factor in factors.items():
        total += factor * structure.matrix(law, values).toarray()
    for k in range(0 if amplitudes is None else amplitudes.shape[1]):
        total += 1j / amplitudes[:, k, None, None] * structure.matrix(f"friction:slide{k}", values).toarray()
    return total


def slopes(structure, made, physical, laplace, amplitudes=None):
    """dZ/dp of every parameter: Z is linear in each of them, so a difference is exact."""
    for unit in np.eye(made.n_params):
        both = [
            stiffness(structure, made.values(physical * (1 + sign * 0.5 * unit)), laplace, amplitudes)
            for sign in (1, -1)
        ]
        yield (both[0] - both[1]) / (unit @ physical)


def textbook(structure, made, record, physical, amplitudes=None):
    """S' Z^-1 F and -S' Z^-1 (dZ/dp) Z^-1 F, line by line, amplitudes of friction held."""
    loads, sensors = (structure.selection(d).toarray() for d in (record.inputs, record.outputs))
    inverse = np.linalg.inv(stiffness(structure, made.values(physical), record.laplace, amplitudes))
    x, y = inverse @ loads, sensors.T @ inverse
    changes = [-y @ slope @ x for slope in slopes(structure, made, physical, record.laplace, amplitudes)]
    factor = (record.laplace ** DERIVATIVES[record.kind])[:, None, None]
    return factor * (sensors.T @ x), factor[..., None] * np.stack(changes, axis=-1)


def close(found, exact, part=1e-10):
    """Each line and each parameter to `part` of its largest entry."""
    scale = np.abs(exact).max(axis=(1, 2), keepdims=True)
    return (np.abs(found - exact) <= part * scale).all()


@pytest.mark.parametrize("kind", ["receptance", "accelerance"])
@pytest.mark.parametrize("viscous", [0.0, 0.05])
@pytest.mark.parametrize("n_lines", [30, 400])
def test_values_and_jacobian_equal_the_textbook(n_lines, viscous, kind):
    structure, made, record = column(viscous=viscous, record_kind=kind, n_lines=n_lines)
    at = response(structure, made, record)
    physical = made.start * np.exp(0.2 * np.random.default_rng(0).standard_normal(made.n_params))
    values, jacobian = textbook(structure, made, record, physical)
    found, derivative = at.derivatives_at(physical)
    assert (at.solver.at(physical, at.fixed_coefficients).modal is not None) == (n_lines == 400)
    assert close(found, values)
    assert close(derivative, jacobian)
    assert close(at.values_at(physical), values)


CONTACTS = {
    "one": [(("6Y",), 0.3)],
    "one between two": [(("6Y", "3Y"), 0.05)],
    "two": [(("6Y",), 0.1), (("2Y",), 0.2)],
    "stuck at times": [(("4Y",), 0.95)],
}


@pytest.mark.parametrize("case", CONTACTS)
@pytest.mark.parametrize("n_lines", [30, 400])
def test_friction_in_balance_equals_the_textbook(n_lines, case):
    """Amplitudes by a general solver of equations; their change with the parameters by the implicit function theorem."""
    structure, made, record = column(friction=CONTACTS[case], n_lines=n_lines)
    rng = np.random.default_rng(3)
    at, physical = response(structure, made, record), made.start * np.exp(0.1 * rng.standard_normal(made.n_params))
    found, jacobian = at.derivatives_at(physical)
    assert np.array_equal(at.values_at(physical), response(structure, made, record).values_at(physical))
    few = np.sort(rng.choice(n_lines, 20, replace=False))
    values, slope, stuck = balanced(structure, made, record.lines(few), physical)
    assert close(at.values_at(physical)[few], values)
    assert close(found[few], values)
    assert close(jacobian[few], slope)
    assert stuck.any() == (case == "stuck at times")
    assert not stuck.all(axis=0).any()


def balanced(structure, made, record, physical):
    """Values, their derivatives and which contacts stick."""
    b = np.stack(
        [slide_of(structure, element) for element in structure.elements if hasattr(element, "sliding")], axis=1
    )
    load, sensors = structure.selection(record.inputs).toarray(), structure.selection(record.outputs).toarray()
    force = np.array([value for value, name in zip(physical, made.names, strict=True) if "friction" in name])
    free = np.linalg.inv(stiffness(structure, made.values(physical), record.laplace))
    start = np.linalg.inv(stiffness(structure, made.values(made.start), record.laplace))
    floor = 1e-4 * np.abs(b.T @ start @ load)[:, :, 0]
    drive, flexibility = (b.T @ free @ load)[:, :, 0], b.T @ free @ b

    def excess(log_size, line):
        pull = 1j * force / np.exp(log_size)
        q = np.linalg.solve(np.eye(len(force)) + flexibility[line] * pull, drive[line])
        return np.log(np.abs(q)) - log_size

    amplitudes = np.array(
        [np.exp(optimize.root(excess, np.log(np.abs(drive[k])), (k,), tol=1e-13).x) for k in range(len(drive))]
    )
    if len(force) == 1:  # s = |b - i r A q / s| is a quadratic equation
        along = (1j * force * flexibility[:, :, 0]).real
        rest = along**2 - np.abs(force * flexibility[:, :, 0]) ** 2 + np.abs(drive) ** 2
        amplitudes = np.sqrt(np.maximum(rest, 0.0)) - along
    stuck = amplitudes < floor
    amplitudes = np.maximum(amplitudes, floor)
    inverse = np.linalg.inv(stiffness(structure, made.values(physical), record.laplace, amplitudes))
    x, y, reach = inverse @ load, sensors.T @ inverse, b.T @ inverse
    factor = (record.laplace ** DERIVATIVES[record.kind])[:, None, None]
    jacobian = []
    by_size = [
        1j * force[k] / amplitudes[:, k] ** 2 * np.outer(b[:, k], b[:, k])[:, :, None] for k in range(len(force))
    ]
    by_size = [np.moveaxis(each, 2, 0) for each in by_size]  # -dZ/ds of each contact
    q = (b.T @ x)[:, :, 0]
    for slope in slopes(structure, made, physical, record.laplace, amplitudes):
        change = (reach @ slope @ x)[:, :, 0]
        matrix = np.stack([(reach @ each @ x)[:, :, 0] for each in by_size], axis=2)
        unit = np.conj(q) / np.abs(q) * ~stuck
        moved = np.linalg.solve(
            np.eye(len(force)) - (unit[:, :, None] * matrix).real, -(unit * change).real[:, :, None]
        )[:, :, 0]
        total = -slope + sum(each * moved[:, k, None, None] for k, each in enumerate(by_size))
        jacobian.append(y @ total @ x)
    return factor * (sensors.T @ x), factor[..., None] * np.stack(jacobian, axis=-1), stuck


def slide_of(structure, element):
    slide = structure.selection(element.first).toarray()[:, 0]
    return slide if element.second is None else slide - structure.selection(element.second).toarray()[:, 0]


def test_friction_with_given_amplitudes_by_poles_and_by_factorization():
    """Measured sliding: friction is known at every line, and poles without it serve them all."""
    structure, made, record = column(friction=[(("6Y",), 0.3)])
    slides = sid.Friction("slide0", "6Y", friction_force=0.3, measured_by=record.outputs[:1])
    structure = sid.Structure(structure.nodes, [*structure.elements[:2], slides], ["0Y", "0RZ"])
    rng = np.random.default_rng(0)
    record = replace(record, values=rng.uniform(0.1, 1.0, record.values.shape) + 0j)
    amplitude = np.abs(record.as_kind("receptance").values[:, :1, 0])
    at = response(structure, made, record, measured_sliding=True)
    values, jacobian = textbook(structure, made, record, made.start, amplitude)
    found, derivative = at.derivatives_at(made.start)
    assert at.solver.at(made.start, at.fixed_coefficients).modal is not None
    assert close(found, values)
    assert close(derivative, jacobian)


@pytest.mark.parametrize("n_lines", [40, 600])
def test_medium_models_equal_line_by_line(n_lines):
    structure, made, record = column(45, n_lines=n_lines)
    at = response(structure, made, record)
    assert at.is_large == (n_lines == 40)
    if n_lines == 600:
        assert isinstance(at.solver, DenseOrSparseSolver)
        assert at.solver.dense.at(made.start, at.fixed_coefficients).modal is not None
        other = replace(at, solver=at.solver.sparse)
        # condition about 1e8: rounding of either shows as 1e-7 at most
        for found, exact in zip(at.derivatives_at(made.start), other.derivatives_at(made.start), strict=True):
            assert close(found, exact, 1e-7)
        assert close(at.values_at(made.start), other.values_at(made.start), 1e-7)
        assert close(at.sensor_gram(made.start), other.sensor_gram(made.start), 1e-7)


def test_medium_models_are_factorized_where_poles_do_not_serve(monkeypatch):
    structure, made, record = column(45, n_lines=600)
    at = response(structure, made, record)
    monkeypatch.setattr(np.linalg, "eig", lambda matrix: (np.ones(len(matrix)), np.eye(len(matrix))))
    assert at.solver.dense.at(made.start, at.fixed_coefficients).modal is None
    large = replace(at, solver=at.solver.sparse)
    assert np.array_equal(at.values_at(made.start), large.values_at(made.start))


def test_sensor_gram_and_sensitivity_of_small_models():
    structure, made, record = column()
    at = response(structure, made, replace(record, kind="receptance"))
    sensors = structure.selection(record.outputs).toarray()
    z = stiffness(structure, made.values(made.start), record.laplace)
    y = np.linalg.inv(z) @ sensors
    assert close(at.sensor_gram(made.start), np.swapaxes(y, 1, 2) @ y.conj())
    x = np.random.default_rng(0).standard_normal((len(z), structure.n_dofs, 2)) + 0j
    exact = [-np.swapaxes(y, 1, 2) @ slope @ x for slope in slopes(structure, made, made.start, record.laplace)]
    assert close(at.sensitivity_at(made.start, x, y), np.stack(exact, axis=-1))


def test_thickness_enters_every_slope():
    """A power of a value and a product of three: no difference is exact, so against a fourth-order one."""
    nodes = {1: (0, 0, 0), 2: (1, 0, 0), 3: (1, 1, 0), 4: (0, 1, 0)}
    plate = sid.Plate("plate", [[1, 2, 3, 4]], 70e9, 2700.0, 5e-3, 0.3, loss_factor=0.02)
    structure = sid.Structure(nodes, [plate], ["1Z", "1RX", "1RY", "2Z", "2RX", "2RY"], active=["Z", "RX", "RY"])
    kinds = ("youngs_modulus", "density", "thickness", "loss_factor")
    made = sid.parameters(structure, [sid.Unknown(kind, "plate") for kind in kinds])
    record = sid.FrfRecord(np.linspace(1.0, 60.0, 300), np.ones((300, 1, 1)), ("3Z",), ("4Z",), "receptance")
    at = response(structure, made, record)
    derivative = at.derivatives_at(made.start)[1]
    for k, unit in enumerate(np.eye(4)):
        four = [at.values_at(made.start * (1 + step * 1e-4 * unit)) for step in (2, 1, -1, -2)]
        difference = (8 * (four[1] - four[2]) - (four[0] - four[3])) / (12e-4 * made.start[k])
        assert np.abs(derivative[..., k] - difference).max() <= 1e-6 * np.abs(difference).max()


def test_what_does_not_depend_on_priors_starts_or_lines_is_shared():
    structure, made, record = column()
    cache = ResponseCache()
    one = response(structure, made, record, cache=cache)
    moved = made.started_at(1.1 * made.start).kept_near_start(0.1)
    assert one.slopes is response(structure, moved, record.lines(np.arange(50)), cache=cache).slopes
    others = sid.parameters(structure, [sid.Unknown("mass", "beam")])
    assert response(structure, others, record, cache=cache).slopes is not one.slopes
    again = sid.Structure(structure.nodes, structure.elements, ["0Y"])
    assert response(again, made, record, cache=cache).slopes is not one.slopes
    assert response(structure, made, record).slopes is not one.slopes


def test_the_fields_and_amplitudes_last_asked_for_are_kept():
    """Of three points the one asked for in between stays: a search goes back to its best point."""
    structure, made, record = column(friction=[(("6Y",), 0.3)], n_lines=5)
    at = response(structure, made, record)
    first, second, third = (made.start * factor for factor in (1.0, 1.1, 1.2))
    solver, sliding = at.solver, at._sliding
    fields = solver.at(first, at.fixed_coefficients)
    amplitudes = sliding.at(first)
    for physical in (second, first, third):
        solver.at(physical, at.fixed_coefficients)
        sliding.at(physical)
    assert solver.at(first, at.fixed_coefficients) is fields
    assert sliding.at(first) is amplitudes
    assert len(solver._cache) == len(sliding._cache) == 2
