"""The plate in bending: patch test, analytical frequencies, mass, rotations, and thickness with its powers."""

import numpy as np
import pytest
from cells_cases import box

from structid import InputError, PointMass, Structure, Unknown, parameters
from structid.dynamics.normal_modes import modes
from structid.fem import Membrane, Plane, Plate
from structid.fem.elements.plate import _square_functions, _triangle_functions
from structid.forward.sensitivity import weight_slope

E, RHO, NU, T = 70e9, 2700.0, 0.3, 0.005
BENDING = E * T**3 / 12 / (1 - NU**2)


def plate_on(points, table, fixed=(), **given):
    given = {"youngs_modulus": E, "density": RHO, "thickness": T, "poisson": NU} | given
    return Structure({i + 1: p for i, p in enumerate(points)}, [Plate("plate", table + 1, **given)], fixed)


def field_of(structure, w, slope_x, slope_y):
    """Deflection and rotations RX = dw/dy, RY = -dw/dx on the degrees of freedom."""
    found = []
    for dof in structure.dofs:
        x, y = structure.nodes[dof.node]
        found.append({"Z": w(x, y), "RX": slope_y(x, y), "RY": -slope_x(x, y)}[dof.direction])
    return np.array(found)


CURVED = {
    "xx": (lambda x, y: x * x, lambda x, y: 2 * x, lambda x, y: 0.0, 4.0),
    "yy": (lambda x, y: y * y, lambda x, y: 0.0, lambda x, y: 2 * y, 4.0),
    "xy": (lambda x, y: x * y, lambda x, y: y, lambda x, y: x, 2 * (1 - NU)),
}


@pytest.mark.parametrize("kind", ["triangle", "quad"])
@pytest.mark.parametrize("curvature", CURVED)
def test_a_distorted_patch_holds_every_constant_curvature(kind, curvature):
    points, table = box(kind, (4, 3), (2.0, 1.0), jitter=0.25)
    structure = plate_on(points, table)
    *fields, energy = CURVED[curvature]
    field = field_of(structure, *fields)
    forces = structure.matrix("stiffness") @ field
    inner = np.array(
        [0 < structure.nodes[d.node][0] < 2 and 0 < structure.nodes[d.node][1] < 1 for d in structure.dofs]
    )
    assert inner.sum() == 18
    assert np.abs(forces[inner]).max() <= 1e-11 * np.abs(forces).max()
    assert field @ forces == pytest.approx(BENDING * energy * 2.0, rel=1e-11)


@pytest.mark.parametrize("kind", ["triangle", "quad"])
def test_plates_keep_rigid_motion_and_mass(kind):
    points, table = box(kind, (3, 3), (2.0, 1.0), jitter=0.25, seed=2)
    structure = plate_on(points, table)
    mass, stiffness = structure.matrix("mass").toarray(), structure.matrix("stiffness").toarray()
    assert np.abs(stiffness - stiffness.T).max() <= 1e-15 * np.abs(stiffness).max()
    eigenvalues = np.linalg.eigvalsh(stiffness)
    assert (eigenvalues <= 1e-9 * eigenvalues[-1]).sum() == 3
    assert np.linalg.eigvalsh(mass).min() > 0
    assert structure.mass_of() == pytest.approx(RHO * T * 2.0, rel=1e-12)
    tilt = field_of(structure, lambda x, y: 3 * x - y, lambda x, y: 3.0, lambda x, y: -1.0)
    assert np.abs(stiffness @ tilt).max() <= 1e-9 * np.abs(stiffness).max()
    exact = RHO * T * (9 * 8 / 3 + 2 / 3 - 2 * 3 * 1.0)  # integral of (3 x - y)^2 over 2 by 1
    assert tilt @ mass @ tilt == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize("functions, corners", [(_square_functions, [(-1, -1), (1, -1), (1, 1), (-1, 1)]),
                                                (_triangle_functions, [(0, 0), (1, 0), (0, 1)])])  # fmt: skip
def test_deflection_functions_own_one_value_or_slope(functions, corners):
    at, step = np.array(corners, dtype=float), 1e-6
    assert functions(at)[..., 0] == pytest.approx(np.eye(len(at)), abs=1e-12)
    assert np.abs(functions(at)[..., 1:]).max() <= 1e-12
    for axis in (0, 1):
        move = step * np.eye(2)[axis]
        slope = (functions(at + move) - functions(at - move)) / (2 * step)
        wanted = np.zeros_like(slope)
        wanted[range(len(at)), range(len(at)), 1 + axis] = 1.0
        assert slope == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize("kind", ["triangle", "quad"])
def test_frequencies_of_a_supported_square_converge_with_the_square_of_the_side(kind):
    exact = np.sort([np.pi / 2 * np.sqrt(BENDING / RHO / T) * (a * a + b * b) for a in (1, 2, 3) for b in (1, 2, 3)])[
        :5
    ]
    errors = []
    for n in (6, 12):
        points, table = box(kind, (n, n), (1.0, 1.0), jitter=0.15)
        rim = np.flatnonzero(np.any((points < 1e-9) | (points > 1 - 1e-9), axis=1))
        structure = plate_on(points, table, [f"{node + 1}Z" for node in rim])
        found = modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=5).frequency
        errors.append(np.abs(found / exact - 1))
    assert errors[1].max() <= 0.025
    assert errors[1].max() <= 0.35 * errors[0].max()


def test_rotations_of_a_strip_are_those_of_a_beam():
    length, width = 1.0, 0.05
    points, table = box("quad", (10, 1), (length, width))
    left = [f"{n + 1}{d}" for n in np.flatnonzero(points[:, 0] < 1e-9) for d in ("Z", "RX", "RY")]
    structure = plate_on(points, table, left, poisson=0.0)
    names = [str(d) for d in structure.dofs]
    load, tip = np.zeros(len(names)), np.flatnonzero(points[:, 0] > length - 1e-9) + 1
    for node in tip:
        load[names.index(f"{node}Z+")] = 0.5
    moved = np.linalg.solve(structure.matrix("stiffness").toarray(), load)
    stiffness = E * width * T**3 / 12
    assert moved[names.index(f"{tip[0]}Z+")] == pytest.approx(length**3 / 3 / stiffness, rel=1e-9)
    assert moved[names.index(f"{tip[0]}RY+")] == pytest.approx(-(length**2) / 2 / stiffness, rel=1e-9)


@pytest.mark.parametrize("kind, mass_power, stiffness_power", [(Plate, 1, 3), (Plane, 1, 1)])
def test_thickness_enters_with_its_own_powers(kind, mass_power, stiffness_power):
    points, table = box("quad", (2, 2), (1.0, 1.0), jitter=0.2)
    nodes = {i + 1: p for i, p in enumerate(points)}
    rng = np.random.default_rng(0)
    thick, thicker = rng.uniform(0.01, 0.02, (2, len(table)))
    one = Structure(nodes, [kind("p", table + 1, E, RHO, thick, NU, loss_factor=0.1, stiffness_damping=5.0)])
    other = Structure(nodes, [kind("p", table + 1, E, RHO, thicker, NU, loss_factor=0.1, stiffness_damping=5.0)])
    place = next(p.values for p in one.properties if p.term.property == "thickness")
    values = np.array(one.values)
    values[place] = thicker
    for law in ("mass", "stiffness", "structural_damping", "damping"):
        wanted = other.matrix(law).toarray()
        assert np.abs(one.matrix(law, values).toarray() - wanted).max() <= 1e-13 * np.abs(wanted).max()
    assert one.mass_of(values) == pytest.approx(other.mass_of(), rel=1e-13)
    powers = {p.matrix_kind: p.scale.exponents[0] for p in one.contributions if p.matrix_kind in ("mass", "stiffness")}
    assert powers == {"mass": mass_power, "stiffness": stiffness_power}


def test_derivatives_to_thickness_are_differences():
    points, table = box("quad", (2, 1), (1.0, 1.0))
    structure = plate_on(points, table, loss_factor=0.05)
    unknown = parameters(
        structure, [Unknown(p, "plate", each=True) for p in ("thickness", "youngs_modulus", "loss_factor", "density")]
    )
    start, steps = np.array(unknown.start), 1e-6 * np.array(unknown.start)
    values = unknown.values(start)
    for part in structure.contributions:
        slope = weight_slope(part, unknown, values).toarray()
        for k, step in enumerate(steps):
            move = step * np.eye(len(steps))[k]
            up, down = (part.weights(unknown.values(start + sign * move)) for sign in (1, -1))
            scale = np.abs(part.weights(values)).max() / start[k]
            assert slope[:, k] == pytest.approx((up - down) / (2 * step), abs=1e-8 * max(scale, 1e-12))
    gradient = structure.mass_gradient(values=values) @ unknown.design
    for k, step in enumerate(steps):
        move = step * np.eye(len(steps))[k]
        up, down = (structure.mass_of(unknown.values(start + sign * move)) for sign in (1, -1))
        assert gradient[k] == pytest.approx((up - down) / (2 * step), abs=1e-7 * structure.mass_of() / start[k])


def test_a_plane_structure_moves_across_where_it_holds_a_plate():
    points, table = box("quad", (1, 1), (1.0, 1.0))
    assert {d.direction for d in plate_on(points, table).dofs} == {"Z", "RX", "RY"}
    nodes = {i + 1: p for i, p in enumerate(points)}
    both = Structure(nodes, [Plate("p", table + 1, E, RHO, T, NU), Plane("q", table + 1, E, 0.0, T, NU)])
    assert {d.direction for d in both.dofs} == {"X", "Y", "Z", "RX", "RY"}
    skin = Structure(nodes, [Membrane("m", table[:, :3] + 1, 1.0, 1.0), PointMass("load", [1], 1.0)])
    assert {d.direction for d in skin.dofs} == {"Z"}


def test_plates_take_corners_only():
    with pytest.raises(InputError, match=r"element 1 of 'plate' has 6 nodes; it can have 3 \(triangle\), 4 \(quad\)"):
        Plate("plate", [[1, 2, 3, 4, 5, 6]], E, RHO, T, NU)


@pytest.mark.parametrize("kind, jitter", [("triangle", 0.25), ("quad", 0.0)])
def test_the_mass_of_a_quadratic_deflection_is_exact(kind, jitter):
    points, table = box(kind, (3, 2), (2.0, 1.0), jitter=jitter)
    structure = plate_on(points, table)
    field = field_of(structure, lambda x, y: x * x + x * y, lambda x, y: 2 * x + y, lambda x, y: x)
    exact = RHO * T * (2.0**5 / 5 + 2 * 2.0**4 / 4 / 2 + 2.0**3 / 3 / 3)  # integral of (x^2 + x y)^2 over 2 by 1
    assert field @ structure.matrix("mass") @ field == pytest.approx(exact, rel=1e-12)
