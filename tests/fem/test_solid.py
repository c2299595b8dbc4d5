"""Plane and solid elements: patch tests, scikit-fem, rigid motion, mass, beams and blocks, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
import skfem
from cells_cases import box
from scipy import sparse
from skfem.helpers import dot
from skfem.models.elasticity import lame_parameters, linear_elasticity

from structid import InputError, Structure
from structid.dynamics.normal_modes import modes
from structid.fem import Plane, Solid
from structid.fem.elements.cells import CELLS, PLANE_CELLS, SOLID_CELLS

E, RHO, NU, T = 70e9, 2700.0, 0.3, 0.02
SIERRA = Path(__file__).parents[3] / "shared" / "data" / "sierra_block_ac_KM"
KINDS = [*PLANE_CELLS.values(), *SOLID_CELLS.values()]
SKFEM = {
    "triangle": (skfem.MeshTri, skfem.ElementTriP1()),
    "quad": (skfem.MeshQuad, skfem.ElementQuad1()),
    "tetra": (skfem.MeshTet, skfem.ElementTetP1()),
}


def structure_of(kind, points, table, formulation="full", **given):
    """The cells as one element set on nodes that count from 1."""
    common = {"youngs_modulus": E, "density": RHO, "poisson": NU, "formulation": formulation} | given
    flat = points.shape[1] == 2
    element = Plane("cells", table + 1, thickness=T, **common) if flat else Solid("cells", table + 1, **common)
    return Structure({i + 1: p for i, p in enumerate(points)}, [element])


def distorted(kind):
    d = 2 if kind in PLANE_CELLS.values() else 3
    return box(kind, (3, 2, 2)[:d], (2.0, 1.0, 0.8)[:d], jitter=0.2)


def on_dofs(structure, field):
    """A displacement field (n_nodes, d) on the degrees of freedom."""
    return np.array([field[dof.node - 1, dof.axis] for dof in structure.dofs])


@pytest.mark.parametrize("formulation", ["incompatible", "full", "mean_dilatation"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_patch_holds_every_constant_strain(kind, formulation):
    points, table = distorted(kind)
    d = points.shape[1]
    structure = structure_of(kind, points, table, formulation)
    stiffness = structure.matrix("stiffness")
    inner = on_dofs(structure, np.tile(inside(points)[:, None], d)).astype(bool)
    volume = np.prod(np.ptp(points, axis=0)) * (T if d == 2 else 1.0)
    rng = np.random.default_rng(3)
    for _ in range(3):
        gradient = rng.standard_normal((d, d))
        field = on_dofs(structure, points @ gradient.T)
        forces = stiffness @ field
        assert np.abs(forces[inner]).max(initial=0.0) <= 1e-11 * np.abs(forces).max()
        strain = (gradient + gradient.T) / 2
        first, second = E * NU / (1 - NU**2), E / (1 + NU)
        if d == 3:
            first = E * NU / (1 + NU) / (1 - 2 * NU)
        energy = volume * (first * np.trace(strain) ** 2 + second * (strain**2).sum())
        assert field @ stiffness @ field == pytest.approx(energy, rel=1e-11)


def inside(points):
    low, high = points.min(axis=0), points.max(axis=0)
    return np.all((points > low + 1e-9) & (points < high - 1e-9), axis=1)


@pytest.mark.parametrize("kind", KINDS)
def test_matrices_keep_rigid_motion_and_mass(kind):
    points, table = distorted(kind)
    d = points.shape[1]
    structure = structure_of(kind, points, table, "incompatible")
    stiffness, mass = structure.matrix("stiffness").toarray(), structure.matrix("mass").toarray()
    eigenvalues = np.linalg.eigvalsh(stiffness)
    assert (np.abs(eigenvalues) <= 1e-10 * eigenvalues[-1]).sum() == (3 if d == 2 else 6)
    assert np.abs(stiffness - stiffness.T).max() <= 1e-15 * np.abs(stiffness).max()
    assert np.linalg.eigvalsh(mass).min() > 0
    volume = np.prod(np.ptp(points, axis=0)) * (T if d == 2 else 1.0)
    assert structure.mass_of() == pytest.approx(RHO * volume, rel=1e-12)
    turn = np.zeros_like(points)
    turn[:, 0], turn[:, 1] = -points[:, 1], points[:, 0]
    rotation = on_dofs(structure, turn)
    assert np.abs(stiffness @ rotation).max() <= 1e-10 * np.abs(stiffness).max()
    lx, ly = np.ptp(points, axis=0)[:2]
    assert rotation @ mass @ rotation == pytest.approx(RHO * volume * (lx**2 + ly**2) / 3, rel=1e-11)


@pytest.mark.parametrize("kind", SKFEM)
def test_plain_matrices_are_those_of_scikit_fem(kind):
    points, table = distorted(kind)
    mesh_type, element = SKFEM[kind]
    basis = skfem.Basis(
        mesh_type(points.T, table.T), skfem.ElementVector(element), intorder=3
    )  # two points along a side
    state = {"state": "strain"} if points.shape[1] == 2 else {}
    structure = structure_of(kind, points, table, "full", **state)
    scale = T if points.shape[1] == 2 else 1.0
    stiffness = scale * linear_elasticity(*lame_parameters(E, NU)).assemble(basis)
    mass = scale * RHO * skfem.BilinearForm(lambda u, v, _: dot(u, v)).assemble(basis)
    place = np.array([basis.nodal_dofs[dof.axis, dof.node - 1] for dof in structure.dofs])
    for own, other in (("stiffness", stiffness), ("mass", mass)):
        dense = other.toarray()[np.ix_(place, place)]
        assert np.abs(structure.matrix(own).toarray() - dense).max() <= 1e-12 * np.abs(dense).max()


@pytest.mark.parametrize("kind", KINDS)
def test_interpolation_is_one_at_its_node_and_its_slopes_are_derivatives(kind):
    shape = CELLS[kind]
    assert shape.values(shape.corners) == pytest.approx(np.eye(shape.n_nodes), abs=1e-12)
    at = np.full((1, shape.corners.shape[1]), 0.21)
    for axis in range(at.shape[1]):
        step = 1e-6 * np.eye(at.shape[1])[axis]
        difference = (shape.values(at + step) - shape.values(at - step))[0] / 2e-6
        assert shape.slopes(at)[0, axis] == pytest.approx(difference, abs=1e-8)


@pytest.mark.parametrize("kind, shape, bound", [("hexahedron", (8, 1, 1), 0.03), ("tetra10", (8, 1, 1), 0.03)])
def test_a_slender_block_bends_like_a_beam(kind, shape, bound):
    size = (1.0, 0.05, 0.04)
    points, table = box(kind, shape, size)
    structure = structure_of(kind, points, table, "incompatible")
    held = [f"{n + 1}{d}" for n in np.flatnonzero(points[:, 0] < 1e-9) for d in "XYZ"]
    structure = Structure(structure.nodes, structure.elements, held)
    first = modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=1).frequency[0]
    beam = 1.8751041**2 / (2 * np.pi) * size[2] / np.sqrt(12) * np.sqrt(E / RHO)
    assert first == pytest.approx(beam, rel=bound)


def test_incompatible_quads_bend_exactly_where_plain_ones_lock():
    points, table = box("quad", (10, 1), (1.0, 0.1))
    tips = {}
    for formulation in ("incompatible", "full"):
        structure = structure_of("quad", points, table, formulation)
        held = ["1X", "1Y", "2X"] + [f"{n + 1}X" for n in np.flatnonzero(points[:, 0] < 1e-9)]
        structure = Structure(structure.nodes, structure.elements, held)
        right = {i: n + 1 for i, n in enumerate(np.flatnonzero(points[:, 0] > 1 - 1e-9))}
        load = np.zeros(structure.n_dofs)
        for node, sign in zip(right.values(), (-1, 1), strict=True):  # a couple of forces along x
            load[[str(d) for d in structure.dofs].index(f"{node}X+")] = sign * 100.0
        moved = np.linalg.solve(structure.matrix("stiffness").toarray(), load)
        tips[formulation] = moved[[str(d) for d in structure.dofs].index(f"{right[0]}Y+")]
    moment, inertia = 100.0 * 0.1, T * 0.1**3 / 12
    exact = moment / (2 * E * inertia)
    assert abs(tips["incompatible"]) == pytest.approx(exact, rel=1e-9)
    assert abs(tips["full"]) < 0.75 * exact


def test_mean_dilatation_does_not_lock_where_volume_is_kept():
    points, table = box("quad", (8, 2), (1.0, 0.25))
    held = [f"{n + 1}{d}" for n in np.flatnonzero(points[:, 0] < 1e-9) for d in "XY"]
    found = {}
    for formulation in ("mean_dilatation", "full"):
        for poisson in (0.3, 0.4999):
            made = structure_of("quad", points, table, formulation, poisson=poisson, state="strain")
            free = Structure(made.nodes, made.elements, held)
            found[formulation, poisson] = modes(free.matrix("mass"), free.matrix("stiffness"), n_modes=1).frequency[0]
    assert found["full", 0.4999] > 2 * found["full", 0.3]
    assert found["mean_dilatation", 0.4999] < 1.2 * found["mean_dilatation", 0.3]


def test_cell_types_mix_in_one_set():
    points, table = box("quad", (2, 1), (2.0, 1.0))
    mixed = np.array([table[0], [*table[1, :3], -1], [*table[1, [0, 2, 3]], -1]])
    rows = np.where(mixed >= 0, mixed + 1, -1)
    structure = Structure({i + 1: p for i, p in enumerate(points)}, [Plane("cells", rows, E, RHO, T, NU)])
    assert structure.mass_of() == pytest.approx(RHO * 2.0 * T, rel=1e-12)
    field = on_dofs(structure, points * [1.0, 0.0])
    assert field @ structure.matrix("stiffness") @ field == pytest.approx(E / (1 - NU**2) * 2.0 * T, rel=1e-12)


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda p, t: (p, t[:, [1, 0, 3, 2, 5, 4, 7, 6]]), "is turned inside out, as are 3 others: nodes"),
        (lambda p, t: (p * [1, 1, 0], t), "has no volume"),
        (lambda p, t: (np.where(np.arange(len(p))[:, None] == 8, p + np.array([0.45, 0.45, 0]), p), t), "is folded"),
        (lambda p, t: (p, t[:, :7]), "has 7 nodes; it can have 4 (tetra)"),
    ],
)
def test_bad_cells_are_named(change, words):
    points, table = change(*box("hexahedron", (2, 2, 1), (1.0, 1.0, 1.0)))
    with pytest.raises(InputError) as error:
        structure_of("hexahedron", points, table)
    assert words in str(error.value)
    assert "'cells'" in str(error.value)


@pytest.mark.parametrize(
    "given, words",
    [
        ({"poisson": 0.5}, "`poisson` of 'cells' must lie between -1 and 0.5, got 0.5"),
        ({"formulation": "reduced"}, "`formulation` of 'cells' must be one of incompatible, full, mean_dilatation"),
        ({"state": "axial"}, "`state` of 'cells' must be one of stress, strain"),
        ({"thickness": 0.0}, "`thickness` of 'cells' must be greater than 0"),
        ({"density": -1.0}, "`density` of 'cells' must be finite and at least 0"),
    ],
)
def test_bad_properties_are_named(given, words):
    given = {"youngs_modulus": E, "density": RHO, "thickness": T, "poisson": NU} | given
    with pytest.raises(InputError) as error:
        Plane("cells", [[1, 2, 3]], **given)
    assert words in str(error.value)


def test_tilted_planes_are_refused():
    nodes = {1: (0.0, 0.0, 0.0), 2: (1.0, 0.0, 0.0), 3: (0.0, 1.0, 0.5)}
    with pytest.raises(InputError, match=r"is not parallel to the x-y plane: nodes 1, 2, 3 have z from 0 to 0.5"):
        Structure(nodes, [Plane("cells", [1, 2, 3], E, RHO, T, NU)])


@pytest.mark.skipif(not SIERRA.exists(), reason="the Sierra/SD matrices (GPL) are not part of the package")
def test_hexahedra_are_those_of_another_code_and_split_its_matrix_in_two():
    mesh = np.load(SIERRA / "mesh_and_reference_modes.npz")
    place = mesh["dof_of_node_xyz_zero_based"]
    total = dict.fromkeys(("stiffness", "mass"), sparse.csc_array((place.size, place.size)))
    for block in ("hex_block1", "hex_block2"):
        cells = Solid(block, mesh[block], 70.33e9, 2704.327, 0.33)
        structure = Structure(dict(enumerate(mesh["xyz_m"], 1)), [cells])
        rows = np.array([place[dof.node - 1, dof.axis] for dof in structure.dofs])
        spread = sparse.csc_array((np.ones(len(rows)), (rows, np.arange(len(rows)))), (place.size, len(rows)))
        total = {law: matrix + spread @ structure.matrix(law) @ spread.T for law, matrix in total.items()}
    for law, name, bound in (("stiffness", "Kaa_lower.npz", 1e-13), ("mass", "Maa_lower.npz", 1e-6)):
        stored = sparse.load_npz(SIERRA / name)
        assert abs(sparse.tril(total[law]) - stored).max() <= bound * abs(stored).max()  # the density has seven digits
