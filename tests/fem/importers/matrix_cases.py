"""Matrices for the tests of importers, and the two blocks of the Sierra assembly in elements of our own."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
from scipy import sparse

from structid.core.errors import FileError
from structid.fem.importers import ImportedMatrix, read_matrices
from structid.fem.importers.imported import complete_triangles

DATA = Path(__file__).parent / "data"
SIERRA = Path(__file__).parents[4] / "shared" / "data" / "sierra_block_ac_KM"


def numbered(n):
    """Node and component of n rows: three translations a node, nodes from 10."""
    return np.stack([10 + np.arange(n) // 3, 1 + np.arange(n) % 3], axis=1)


def random_matrix(seed, n=12, symmetric=True, is_complex=False, density=0.4):
    """A sparse matrix whose entries span many decades, with empty rows and columns."""
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(n, n)) * 10.0 ** rng.integers(-9, 10, (n, n)) * (rng.random((n, n)) < density)
    if is_complex:
        values = values + 1j * values[::-1]
    if n > 4:
        values[3, :] = values[:, 3] = 0.0
    values[0, 0] = values[-1, -1] = 1.0
    return sparse.csc_array(values + values.T if symmetric else values)


def imported(seed=1, name="KAA", **options):
    matrix = random_matrix(seed, **options)
    return ImportedMatrix(name, matrix, numbered(matrix.shape[0]))


def outcome(path):
    """The matrices of a file, or None with what the refusal says."""
    try:
        return read_matrices(path), ""
    except FileError as error:
        return None, str(error)


def sierra():
    """Stiffness, mass, (node, component) of the rows, and the arrays of the mesh file."""
    mesh = dict(np.load(SIERRA / "mesh_and_reference_modes.npz"))
    matrices = [complete_triangles(sparse.load_npz(SIERRA / f"{n}aa_lower.npz"), n, True) for n in "KM"]
    rows = mesh["dof_of_node_xyz_zero_based"]
    table = np.empty((rows.size, 2), dtype=np.int64)
    for axis in range(3):
        table[rows[:, axis]] = np.stack([np.arange(1, len(rows) + 1), np.full(len(rows), axis + 1)], axis=1)
    return *matrices, table, mesh


YOUNG, POISSON, DENSITY = 70.33e9, 0.33, 2704.327
CORNERS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], dtype=float
)


FORMULATIONS = ("full integration", "selective integration", "incompatible modes")


def cube(edge, formulation="incompatible modes"):
    """Stiffness and mass (24, 24) of a cube of 8 nodes, in one of `FORMULATIONS`.

    Selective: the volumetric strain at the middle counts for all of the cube. Incompatible modes: Taylor, Beresford and
    Wilson (1976), nine inner degrees of freedom, condensed.
    """
    lam, mu = YOUNG * POISSON / (1 + POISSON) / (1 - 2 * POISSON), YOUNG / 2 / (1 + POISSON)
    elastic = np.diag([2 * mu] * 3 + [mu] * 3)
    volumetric = np.zeros((6, 6))
    volumetric[:3, :3] = lam + 2 * mu / 3
    elastic[:3, :3] -= 2 * mu / 3
    stiffness, coupling, inner, mass = np.zeros((24, 24)), np.zeros((24, 9)), np.zeros((9, 9)), np.zeros((24, 24))
    volume, middle = edge**3 / 8, strains(CORNERS / 8 * 2 / edge)
    selective = formulation == "selective integration"
    for point in itertools.product((-(3**-0.5), 3**-0.5), repeat=3):
        xi = np.array(point)
        factors = 1 + CORNERS * xi
        shape = factors.prod(axis=1) / 8
        slopes = CORNERS * np.roll(factors, 1, axis=1) * np.roll(factors, 2, axis=1) / 8
        compatible, bubbles = strains(slopes * 2 / edge), strains(np.diag(-2 * xi) * 2 / edge)
        volume_strain = middle if selective else compatible
        stiffness += volume * (compatible.T @ elastic @ compatible + volume_strain.T @ volumetric @ volume_strain)
        coupling += volume * compatible.T @ (elastic + volumetric) @ bubbles
        inner += volume * bubbles.T @ (elastic + volumetric) @ bubbles
        mass += volume * DENSITY * np.kron(np.outer(shape, shape), np.eye(3))
    if formulation == "incompatible modes":
        stiffness -= coupling @ np.linalg.solve(inner, coupling.T)
    return stiffness, mass


def strains(gradients):
    """Strain of unit displacements along x, y, z with these gradients, (6, 3 n)."""
    x, y, z = gradients.T
    zero = np.zeros_like(x)
    rows = [(x, zero, zero), (zero, y, zero), (zero, zero, z), (y, x, zero), (zero, z, y), (z, zero, x)]
    return np.array([np.stack(row, axis=-1).ravel() for row in rows])


def block(mesh, name, formulation="incompatible modes"):
    """Stiffness and mass of one block of the assembly, (3390, 3390), its nodes, and the rows of each cube (n, 24)."""
    rows, hexes = mesh["dof_of_node_xyz_zero_based"], mesh[name] - 1
    position = mesh["xyz_m"][hexes]
    middle, edge = position.mean(axis=1, keepdims=True), np.ptp(position, axis=1)
    np.testing.assert_allclose(edge, edge[0, 0], rtol=1e-9)
    corner = np.rint((position - middle) * 2 / edge[0, 0])
    order = np.array([[np.flatnonzero((c == own).all(axis=1))[0] for own in CORNERS] for c in corner])
    dofs = rows[np.take_along_axis(hexes, order, axis=1)].reshape(len(hexes), 24)
    at = (np.repeat(dofs, 24, axis=1).ravel(), np.tile(dofs, (1, 24)).ravel())
    made = [
        sparse.coo_array((np.tile(part.ravel(), len(hexes)), at), (rows.size,) * 2)
        for part in cube(edge[0, 0], formulation)
    ]
    return made[0].tocsc(), made[1].tocsc(), np.unique(hexes) + 1, dofs
