"""Shells in space: patches in any rotation, published benchmarks, rings and beams, mass, and thickness with its powers."""

import numpy as np
import pytest
from cells_cases import box
from scipy.sparse.linalg import spsolve

from structid import FrfRecord, InputError, Structure, Unknown, parameters
from structid.dynamics.normal_modes import modes
from structid.fem import Shell
from structid.fem.elements.elastic import plane_elasticity
from structid.fem.elements.shell import drilling_stiffness
from structid.forward.frf.response import response
from structid.forward.sensitivity import weight_slope

E, RHO, NU, T = 70e9, 2700.0, 0.3, 0.005
TURN = np.linalg.qr(np.random.default_rng(5).standard_normal((3, 3)))[0]
TURN = TURN * np.sign(np.linalg.det(TURN))
PLACE = np.array([1.0, -2.0, 0.5])
THICK = 0.2  # so that rounding of the stretching does not hide the bending
BENDING = E * THICK**3 / 12 / (1 - NU**2)
STRETCHING = E * THICK / (1 - NU**2)


def shell_on(points, table, fixed=(), **given):
    given = {"youngs_modulus": E, "density": RHO, "thickness": T, "poisson": NU} | given
    return Structure({i + 1: p for i, p in enumerate(points)}, [Shell("shell", table + 1, **given)], fixed)


def turned(flat):
    """Points of a plane in space."""
    return np.column_stack([flat, np.zeros(len(flat))]) @ TURN.T + PLACE


def on_dofs(structure, moved, rotated):
    """Displacements and rotations (n_nodes, 3) in the axes of the plane, on the degrees of freedom."""
    both = np.concatenate([moved @ TURN.T, rotated @ TURN.T], axis=1)
    return np.array(
        [both[dof.node - 1, ["X", "Y", "Z", "RX", "RY", "RZ"].index(dof.direction)] for dof in structure.dofs]
    )


def constant_field(flat, kind):
    """Displacements, rotations and twice the energy per area of a constant strain or curvature."""
    x, y = flat.T
    o, one = np.zeros_like(x), np.ones_like(x)
    return {
        "stretch x": ((x, o, o), (o, o, o), STRETCHING),
        "stretch y": ((o, y, o), (o, o, o), STRETCHING),
        "shear": ((y, o, o), (o, o, -one / 2), STRETCHING * (1 - NU) / 2),
        "curve x": ((o, o, x * x), (o, -2 * x, o), 4 * BENDING),
        "curve y": ((o, o, y * y), (2 * y, o, o), 4 * BENDING),
        "twist": ((o, o, x * y), (x, -y, o), 2 * (1 - NU) * BENDING),
    }[kind]


@pytest.mark.parametrize("kind", ["triangle", "quad"])
@pytest.mark.parametrize("state", ["stretch x", "stretch y", "shear", "curve x", "curve y", "twist"])
def test_a_distorted_patch_in_any_rotation_holds_every_constant_strain_and_curvature(kind, state):
    flat, table = box(kind, (4, 3), (2.0, 1.0), jitter=0.25)
    structure = shell_on(turned(flat), table, thickness=THICK)
    moved, rotated, energy = constant_field(flat, state)
    field = on_dofs(structure, np.transpose(moved), np.transpose(rotated))
    forces = structure.matrix("stiffness") @ field
    inside = np.all((flat > 1e-9) & (flat < [2 - 1e-9, 1 - 1e-9]), axis=1)
    inner = np.array([inside[dof.node - 1] for dof in structure.dofs])
    assert inner.sum() == 36
    assert np.abs(forces[inner]).max() <= 1e-11 * np.abs(forces).max()
    assert field @ forces == pytest.approx(energy * 2.0, rel=1e-11)


def tube(kind, shape, radius, length):
    """A closed tube along X: points and table."""
    flat, table = box(kind, shape, (length, 2 * np.pi))
    around = np.column_stack([flat[:, 0], radius * np.cos(flat[:, 1]), radius * np.sin(flat[:, 1])])
    first = shape[1] + 1
    number = np.arange(len(flat)).reshape(-1, first)
    number[:, -1] = number[:, 0]
    used, place = np.unique(number.ravel()[table], return_inverse=True)
    return around[used], place.reshape(table.shape)


@pytest.mark.parametrize("kind", ["triangle", "quad"])
def test_shells_keep_rigid_motion_and_mass(kind):
    points, table = tube(kind, (3, 8), 0.3, 1.0)
    structure = shell_on(points @ TURN.T + PLACE, table)
    mass, stiffness = structure.matrix("mass").toarray(), structure.matrix("stiffness").toarray()
    assert np.abs(stiffness - stiffness.T).max() <= 1e-15 * np.abs(stiffness).max()
    eigenvalues = np.linalg.eigvalsh(stiffness)
    assert (np.abs(eigenvalues) <= 1e-12 * eigenvalues[-1]).sum() == 6
    assert np.linalg.eigvalsh(mass).min() > 0
    area = 8 * 2 * 0.3 * np.sin(np.pi / 8)
    assert structure.mass_of() == pytest.approx(RHO * T * area, rel=1e-12)
    for axis in np.eye(3):
        at = np.array([structure.nodes[n + 1] for n in range(len(points))])
        both = np.concatenate([np.cross(axis, at), np.tile(axis, (len(at), 1))], axis=1)
        order = [("X", "Y", "Z", "RX", "RY", "RZ").index(d.direction) for d in structure.dofs]
        field = both[[d.node - 1 for d in structure.dofs], order]
        assert np.abs(stiffness @ field).max() <= 1e-12 * np.abs(stiffness).max()


def test_the_rotary_inertia_of_a_turning_plate_is_that_of_a_solid():
    flat, table = box("quad", (3, 2), (2.0, 1.0), jitter=0.2)
    structure = shell_on(turned(flat), table, thickness=0.1)
    x, y = flat.T
    o, one = np.zeros_like(x), np.ones_like(x)
    field = on_dofs(structure, np.transpose((o, o, y)), np.transpose((one, o, o)))
    exact = RHO * 0.1 * 2.0 * (1.0 / 3 + 0.1**2 / 12)  # about the side y = 0 of the middle surface
    assert field @ structure.matrix("mass") @ field == pytest.approx(exact, rel=1e-12)


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.45])
@pytest.mark.parametrize("aspect", [0.25, 1.0, 8.0])
def test_bending_in_the_plane_is_exact_at_any_aspect_ratio(poisson, aspect):
    """Felippa (2003): the bending ratio of the optimal triangle is 1 at every aspect ratio."""
    x, y = (np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [aspect / 2, 0.5]).T
    corners, law = np.column_stack([x, y])[None], plane_elasticity(poisson, False)
    field = np.column_stack([x * y, -(x**2 + poisson * y**2) / 2, -x]).ravel()
    exact = aspect / 12
    assert field @ drilling_stiffness(corners, law, poisson)[0] @ field == pytest.approx(exact, rel=1e-10)
    halves = 0.0
    for half in ([0, 1, 2], [0, 2, 3]):
        own = field.reshape(4, 3)[half].ravel()
        halves += own @ drilling_stiffness(corners[:, half], law, poisson)[0] @ own
    assert halves == pytest.approx(exact, rel=1e-10)


def arch(kind, n, radius, half_length, degrees, **given):
    """A part of a cylinder about X with a diaphragm at x = 0 and planes of symmetry at the other straight cuts."""
    flat, table = box(kind, (n, n), (half_length, degrees))
    angle = np.radians(flat[:, 1])
    points = np.column_stack([flat[:, 0], radius * np.sin(angle), radius * np.cos(angle)])
    ends = {"Y Z RX": flat[:, 0] < 1e-9, "X RY RZ": flat[:, 0] > half_length - 1e-9, "Y RX RZ": flat[:, 1] < 1e-9}
    if degrees == 90.0:
        ends["Z RX RY"] = flat[:, 1] > 90.0 - 1e-9
    held = {f"{n + 1}{d}" for words, mask in ends.items() for n in np.flatnonzero(mask) for d in words.split()}
    return flat, points, table, shell_on(points, table, sorted(held), **given)


def moved_by(structure, load):
    """Displacements by (node, direction) of forces by (node, direction)."""
    names = {(dof.node - 1, dof.direction): k for k, dof in enumerate(structure.dofs)}
    force = np.zeros(structure.n_dofs)
    for key, value in load.items():
        if key in names:
            force[names[key]] += value
    solved = spsolve(structure.matrix("stiffness").tocsc(), force)
    return {key: solved[k] for key, k in names.items()}


@pytest.mark.parametrize("kind", ["triangle", "quad"])
def test_the_roof_of_scordelis_and_lo_converges(kind):
    """MacNeal and Harder (1985): 0.3024 at the middle of the free edge; 0.3006 is the limit of thin shells."""
    found = []
    for n in (8, 16):
        given = {"youngs_modulus": 4.32e8, "thickness": 0.25, "poisson": 0.0}
        flat, points, table, structure = arch(kind, n, 25.0, 25.0, 40.0, **given)
        load = {}
        for row in table:
            a, b, c = points[row[:3]]
            area = np.linalg.norm(np.cross(b - a, c - a)) / (1 if len(row) == 4 else 2)
            for node in row:
                load[node, "Z"] = load.get((node, "Z"), 0.0) - 90.0 * area / len(row)
        corner = int(np.argmin(np.linalg.norm(flat - [25.0, 40.0], axis=1)))
        found.append(-moved_by(structure, load)[corner, "Z"])
    assert found[1] == pytest.approx(0.3006, rel=0.012)
    assert abs(found[1] / 0.3006 - 1) < 0.5 * abs(found[0] / 0.3006 - 1)


@pytest.mark.parametrize("kind", ["triangle", "quad"])
def test_the_pinched_cylinder_converges(kind):
    """MacNeal and Harder (1985): 1.8248e-5 under the force, diaphragms at both ends."""
    found = []
    for n in (8, 16):
        given = {"youngs_modulus": 3e6, "thickness": 3.0, "poisson": 0.3}
        flat, _, _, structure = arch(kind, n, 300.0, 300.0, 90.0, **given)
        top = int(np.argmin(np.linalg.norm(flat - [300.0, 0.0], axis=1)))
        found.append(-moved_by(structure, {(top, "Z"): -0.25})[top, "Z"] / 1.8248e-5)
    assert 0.95 < found[0] < 0.98
    assert found[1] == pytest.approx(1.0, abs=0.025)


@pytest.mark.parametrize("thickness, across, along", [(0.32, 1.754e-3, 5.424e-3), (0.0032, 1.294e3, 5.256e3)])
@pytest.mark.parametrize("n, bound", [(2, 0.02), (4, 0.004)])
def test_warped_quadrilaterals_follow_the_twisted_beam(thickness, across, along, n, bound):
    """MacNeal and Harder (1985); Belytschko, Wong and Chiang (1992) for the thin one: unit forces at the tip."""
    flat, table = box("quad", (6 * n, n), (12.0, 1.1))
    x, y, angle = flat[:, 0], flat[:, 1] - 0.55, flat[:, 0] / 12 * np.pi / 2
    points = np.column_stack([x, y * np.cos(angle), y * np.sin(angle)])
    held = [f"{n + 1}{d}" for n in np.flatnonzero(x < 1e-9) for d in ("X", "Y", "Z", "RX", "RY", "RZ")]
    structure = shell_on(points, table, held, youngs_modulus=29e6, thickness=thickness, poisson=0.22)
    tip = np.flatnonzero(x > 12 - 1e-9)
    for direction, wanted in (("Y", across), ("Z", along)):
        share = np.r_[0.5, np.ones(n - 1), 0.5] / n
        moved = moved_by(structure, {(node, direction): part for node, part in zip(tip, share, strict=True)})
        assert moved[tip[n // 2], direction] == pytest.approx(wanted, rel=bound)


def strip(linear_strains, rows):
    """Tip deflection in its plane of a cantilever ten times as long as deep, over that of Timoshenko's theory."""
    flat, table = box("quad", (10 * rows, rows), (1.0, 0.1))
    held = [f"{n + 1}{d}" for n in np.flatnonzero(flat[:, 0] < 1e-9) for d in ("X", "Y", "Z", "RX", "RY", "RZ")]
    points = np.column_stack([flat, np.zeros(len(flat))])
    structure = shell_on(points, table, held, thickness=0.01, linear_strains=linear_strains)
    tip = np.flatnonzero(flat[:, 0] > 1 - 1e-9)
    share = np.r_[0.5, np.ones(rows - 1), 0.5] / rows
    moved = moved_by(structure, {(node, "Y"): part for node, part in zip(tip, share, strict=True)})
    return moved[tip[rows // 2], "Y"] / ((4 / 0.1**3 + 2.4 * (1 + NU) / 0.1) / (E * 0.01))


def test_linear_strains_make_webs_right_and_thin_curved_shells_false():
    assert strip(1.0, 1) == pytest.approx(1.0, abs=0.01)
    assert strip(0.1, 1) == pytest.approx(1.22, abs=0.01)
    assert strip(0.1, 2) == pytest.approx(1.035, abs=0.005)
    assert strip(0.1, 4) == pytest.approx(1.0, abs=0.01)
    found = {}
    for linear_strains in (0.1, 1.0):
        flat, table = box("quad", (8, 8), (90.0, 72.0))
        around, up = np.radians(flat.T)
        points = 10 * np.column_stack([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)])
        held = [f"{n + 1}{d}" for n in np.flatnonzero(flat[:, 0] < 1e-9) for d in ("Y", "RX", "RZ")]
        held += [f"{n + 1}{d}" for n in np.flatnonzero(flat[:, 0] > 90 - 1e-9) for d in ("X", "RY", "RZ")]
        first, second = (int(np.argmin(np.linalg.norm(flat - [a, 0], axis=1))) for a in (0.0, 90.0))
        given = {"youngs_modulus": 6.825e7, "thickness": 0.04, "linear_strains": linear_strains}
        structure = shell_on(points, table, [*held, f"{first + 1}Z"], **given)
        found[linear_strains] = moved_by(structure, {(first, "X"): 1.0, (second, "Y"): -1.0})[first, "X"] / 0.0940
    assert 0.86 < found[0.1] < 1.0  # MacNeal and Harder (1985)
    assert found[1.0] < 0.55


@pytest.mark.parametrize("share", [0.0, 1.5, -0.1])
def test_the_share_of_linear_strains_is_checked(share):
    with pytest.raises(InputError, match=r"`linear_strains` of 'shell' must be above 0 and at most 1"):
        Shell("shell", [[1, 2, 3]], E, RHO, T, NU, linear_strains=share)


@pytest.mark.parametrize("kind", ["triangle", "quad"])
def test_a_clamped_square_in_a_turned_plane_has_the_frequencies_of_leissa(kind):
    """Leissa (1973), table C, all sides clamped: 35.992, 73.413, 73.413, 108.27."""
    errors = []
    for n in (6, 12):
        flat, table = box(kind, (n, n), (1.0, 1.0), jitter=0.1)
        rim = np.flatnonzero(np.any((flat < 1e-9) | (flat > 1 - 1e-9), axis=1))
        held = [f"{n + 1}{d}" for n in rim for d in ("X", "Y", "Z", "RX", "RY", "RZ")]
        structure = shell_on(turned(flat), table, held, thickness=0.002)
        found = modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=4).frequency
        unit = np.sqrt(E * 0.002**2 / 12 / (1 - NU**2) / RHO) / (2 * np.pi)
        errors.append(np.abs(found / unit / [35.992, 73.413, 73.413, 108.27] - 1).max())
    assert errors[1] <= 0.03
    assert errors[1] <= 0.35 * errors[0]


def test_a_free_ring_has_the_frequencies_of_its_theory():
    """Love (1927), art. 293: omega^2 = E I / (rho A R^4) n^2 (n^2 - 1)^2 / (n^2 + 1) in the plane, n = 2, 3."""
    points, table = tube("quad", (2, 48), 0.3, 0.05)
    structure = shell_on(points, table, poisson=0.0)
    found = modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=20).frequency
    for n in (2, 3):
        exact = np.sqrt(E * T**2 / 12 / RHO / 0.3**4 * n**2 * (n**2 - 1) ** 2 / (n**2 + 1)) / (2 * np.pi)
        near = np.sort(np.abs(found / exact - 1))[:2]
        assert near[1] <= 0.006  # both of the pair


def test_a_slender_tube_bends_like_a_beam():
    length, radius = 4.0, 0.1
    points, table = tube("quad", (16, 16), radius, length)
    held = [f"{n + 1}{d}" for n in np.flatnonzero(points[:, 0] < 1e-9) for d in ("X", "Y", "Z", "RX", "RY", "RZ")]
    structure = shell_on(points, table, held)
    found = modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=3).frequency
    beam = 1.8751041**2 / (2 * np.pi * length**2) * np.sqrt(E * radius**2 / 2 / RHO)
    assert found[:2] == pytest.approx([beam, beam], rel=0.015)


def test_thickness_enters_stretching_bending_mass_and_rotary_inertia_with_its_own_powers():
    points, table = tube("quad", (2, 6), 0.3, 0.5)
    rng = np.random.default_rng(0)
    thick, thicker = rng.uniform(0.01, 0.05, (2, len(table)))
    given = {"loss_factor": 0.1, "stiffness_damping": 5.0, "mass_damping": 3.0}
    one, other = (shell_on(points, table, thickness=t, **given) for t in (thick, thicker))
    values = np.array(one.values)
    values[next(p.values for p in one.properties if p.term.property == "thickness")] = thicker
    for law in ("mass", "stiffness", "structural_damping", "damping"):
        wanted = other.matrix(law).toarray()
        assert np.abs(one.matrix(law, values).toarray() - wanted).max() <= 1e-13 * np.abs(wanted).max()
    assert one.mass_of(values) == pytest.approx(other.mass_of(), rel=1e-13)
    for law in ("mass", "stiffness", "structural_damping", "damping"):
        assert {p.scale.exponents[0] for p in one.contributions if p.matrix_kind == law} == {1, 3}


def test_derivatives_of_weights_mass_and_responses_are_differences():
    points, table = tube("quad", (2, 5), 0.2, 0.4)
    held = [f"{n + 1}{d}" for n in np.flatnonzero(points[:, 0] < 1e-9) for d in ("X", "Y", "Z", "RX", "RY", "RZ")]
    structure = shell_on(points, table, held, loss_factor=0.03, thickness=0.004)
    names = ("thickness", "youngs_modulus", "loss_factor", "density", "stiffness_damping")
    given = [Unknown(p, "shell", each=p == "thickness", start=None if p != "stiffness_damping" else 1e6) for p in names]
    unknown = parameters(structure, given)
    start = np.array(unknown.start)
    values = unknown.values(start)
    for part in structure.contributions:
        slope = weight_slope(part, unknown, values).toarray()
        for k, step in enumerate(1e-6 * start):
            move = step * np.eye(len(start))[k]
            up, down = (part.weights(unknown.values(start + sign * move)) for sign in (1, -1))
            scale = np.abs(part.weights(values)).max() / start[k]
            assert slope[:, k] == pytest.approx((up - down) / (2 * step), abs=1e-8 * max(scale, 1e-12))
    gradient = structure.mass_gradient(values=values) @ unknown.design
    for k, step in enumerate(1e-6 * start):
        move = step * np.eye(len(start))[k]
        up, down = (structure.mass_of(unknown.values(start + sign * move)) for sign in (1, -1))
        assert gradient[k] == pytest.approx((up - down) / (2 * step), abs=1e-7 * structure.mass_of() / start[k])
    last = len(points)
    like = FrfRecord(
        np.linspace(50, 900, 5),
        np.ones((5, 3, 1)),
        [f"{last}Z", f"{last - 2}Y", f"{last}RX"],
        [f"{last}Z"],
        "receptance",
    )
    model = response(structure, unknown, like)
    _, slopes = model.derivatives_at(start)
    for k, step in enumerate(3e-4 * start):
        move = step * np.eye(len(start))[k]
        near, far = (model.values_at(start + n * move) - model.values_at(start - n * move) for n in (1, 2))
        difference = (8 * near - far) / (12 * step)
        assert np.abs(slopes[..., k] - difference).max() <= 1e-6 * np.abs(difference).max()


@pytest.mark.parametrize(
    "points, row, words",
    [
        ([(0, 0, 0), (1, 0, 0), (2, 0, 0)], [1, 2, 3], "has no area: nodes 1, 2, 3; remove it"),
        (
            [(0, 0, 0), (1, 0, 1), (1, 1, 0), (0, 1, 1)],
            [1, 2, 3, 4],
            "is too far from flat: nodes 1, 2, 3, 4; divide it",
        ),
        ([(0, 0), (1, 0), (0, 1)], [1, 2, 3], "'shell' needs 3-D nodes, got positions with 2 coordinates"),
        ([(0, 0, 0), (1, 0, 0), (0.1, 0.1, 0), (0, 1, 0)], [1, 2, 3, 4], "is folded"),
    ],
)
def test_bad_facets_are_named(points, row, words):
    with pytest.raises(InputError) as error:
        shell_on(points, np.array([row]) - 1)
    assert words in str(error.value)


def test_cells_with_nodes_on_their_sides_are_refused():
    with pytest.raises(InputError, match=r"element 1 of 'shell' has 6 nodes; it can have 3 \(triangle\), 4 \(quad\)"):
        Shell("shell", [[1, 2, 3, 4, 5, 6]], E, RHO, T, NU)
