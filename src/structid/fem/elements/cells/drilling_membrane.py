"""Membranes whose corners turn about the normal: stiffness for unit modulus and thickness, all cells at once.

The triangle is the optimal one of Felippa (2003): constant strains by lumped tractions, which pass the patch test, and on
top of them the linear strains that corner rotations beyond the mean rotation make, with coefficients for which pure
bending in the plane is exact at every aspect ratio of a rectangle of triangles. The rotation is that of the material, and
its stiffness that of the material: no spring holds it. A quadrilateral is the mean of its two divisions into triangles.
"""

from __future__ import annotations

import numpy as np

from structid.core.arrays import FloatArray

#: Share of side rotations in the lumped tractions (alpha_b of the reference).
_TRACTIONS = 1.5
#: Natural strains along the sides from corner rotations, at corner 1 (beta_1 to beta_9 of the reference).
_STRAINS = np.array([[1.0, 2.0, 1.0], [0.0, 1.0, -1.0], [-1.0, -1.0, -2.0]])
_LEAST_HIGHER = 0.01
_DIVISIONS = ((0, 1, 2), (0, 2, 3), (0, 1, 3), (1, 2, 3))


def drilling_stiffness(corners: FloatArray, elasticity: FloatArray, poisson: float, share: float = 1.0) -> FloatArray:
    """Stiffness on (u, v, rotation about the normal) at each corner, (n_cells, 3 n_corners, 3 n_corners).

    Parameters
    ----------
    corners : (n_cells, 3 or 4, 2) float array
        Counter-clockwise, m.
    elasticity : (3, 3) float array
        Plane stress from strain for unit modulus.
    poisson : float
        The stiffness of linear strains follows it, by (1 - 4 poisson^2) / 2, and at least 0.01.
    share : float
        Fraction of the stiffness against linear strains; 1 is the element of the reference, exact for in-plane bending.

    References
    ----------
    Felippa (2003), Comput. Methods Appl. Mech. Engrg. 192, 2125-2168 (the element called OPT).
    """
    higher = share * max(0.5 * (1 - 4 * poisson**2), _LEAST_HIGHER)
    n = corners.shape[1]
    if n == 3:
        return _triangle_stiffness(corners, elasticity, higher)
    total = np.zeros((len(corners), 3 * n, 3 * n))
    for division in _DIVISIONS:
        rows = np.ravel([[3 * k, 3 * k + 1, 3 * k + 2] for k in division])
        total[:, rows[:, None], rows] += 0.5 * _triangle_stiffness(corners[:, division], elasticity, higher)
    return total


def mean_strains(corners: FloatArray) -> FloatArray:
    """Maps (n_cells, 3, 3 n_corners) to the mean strains (xx, yy, engineering xy) of cells, from their corner motions.

    These are (u, v, rotation) corner by corner. The maps are L' / area of the lumped tractions L. `corners` are as in
    `drilling_stiffness`.
    """
    n = corners.shape[1]
    divisions, share = (((0, 1, 2),), 1.0) if n == 3 else (_DIVISIONS, 0.5)
    total = np.zeros((len(corners), 3, 3 * n))
    area = np.zeros(len(corners))
    for division in divisions:
        rows = np.ravel([[3 * k, 3 * k + 1, 3 * k + 2] for k in division])
        total[:, :, rows] += share * np.swapaxes(_lumped_tractions(corners[:, division]), 1, 2)
        area += share * _area(corners[:, division])
    return total / area[:, None, None]


def _triangle_stiffness(corners: FloatArray, elasticity: FloatArray, higher: float) -> FloatArray:
    """Stiffness of triangles on (u, v, rotation) of each corner for unit thickness, (n_cells, 9, 9).

    `corners` (n_cells, 3, 2) are positions in m, `elasticity` (3, 3) is stress from strain in plane stress, and `higher` the
    factor on the stiffness against linear strains.
    """
    area = _area(corners)
    tractions = _lumped_tractions(corners)
    basic = tractions @ elasticity @ np.swapaxes(tractions, 1, 2) / area[:, None, None]
    beyond = _rotation_beyond_mean(corners, area)
    natural = _strain_from_natural(corners)
    inner = np.swapaxes(natural, 1, 2) @ elasticity @ natural
    at_corners = _natural_strains(corners, area)
    total = np.zeros((len(corners), 3, 3))
    for a, b in ((0, 1), (1, 2), (2, 0)):  # a rule of three points, at the middles of the sides
        middle = 0.5 * (at_corners[a] + at_corners[b])
        total += np.swapaxes(middle, 1, 2) @ inner @ middle
    linear = 0.75 * higher * area[:, None, None] * total
    stiffness = basic + np.swapaxes(beyond, 1, 2) @ linear @ beyond
    return 0.5 * (stiffness + np.swapaxes(stiffness, 1, 2))


def _area(corners: FloatArray) -> FloatArray:
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return 0.5 * (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])


def _lumped_tractions(corners: FloatArray) -> FloatArray:
    """Nodal forces (u, v, rotation of each corner) of unit constant stresses (xx, yy, xy), (n_cells, 9, 3).

    `corners` (n_cells, 3, 2) are positions.
    """
    forces = np.zeros((len(corners), 9, 3))
    for k in range(3):
        before, after = corners[:, (k + 2) % 3], corners[:, (k + 1) % 3]
        x, y = (before - after).T  # of corner k: x32 and y32
        next_x, next_y = (corners[:, k] - after).T  # x12, y12
        last_x, last_y = (before - corners[:, k]).T  # x31, y31
        forces[:, 3 * k, 0] = forces[:, 3 * k + 1, 2] = -y
        forces[:, 3 * k + 1, 1] = forces[:, 3 * k, 2] = x
        forces[:, 3 * k + 2, 0] = -_TRACTIONS / 6 * y * (next_y - last_y)
        forces[:, 3 * k + 2, 1] = _TRACTIONS / 6 * x * (last_x - next_x)
        forces[:, 3 * k + 2, 2] = _TRACTIONS / 3 * (next_x * next_y - last_x * last_y)
    return forces / 2


def _rotation_beyond_mean(corners: FloatArray, area: FloatArray) -> FloatArray:
    """Map from corner displacements and rotations to corner rotations less the mean rotation, (n_cells, 3, 9).

    `corners` (n_cells, 3, 2) are positions, `area` (n_cells,) that of each cell.
    """
    maps = np.zeros((len(corners), 3, 9))
    for k in range(3):
        x, y = (corners[:, (k + 2) % 3] - corners[:, (k + 1) % 3]).T
        maps[:, :, 3 * k] = (x / area / 4)[:, None]
        maps[:, :, 3 * k + 1] = (y / area / 4)[:, None]
        maps[:, k, 3 * k + 2] = 1.0
    return maps


def _side(corners: FloatArray, k: int) -> FloatArray:
    """Vectors from corner `k` to the next corner, (n_cells, 2)."""
    return corners[:, (k + 1) % 3] - corners[:, k]


def _strain_from_natural(corners: FloatArray) -> FloatArray:
    """Map from elongations along the sides 12, 23, 31 to strains (xx, yy, engineering xy), (n_cells, 3, 3).

    `corners` (n_cells, 3, 2) are positions.
    """
    rows = np.empty((len(corners), 3, 3))
    for k in range(3):
        side = _side(corners, k)
        c, s = (side / np.linalg.norm(side, axis=1)[:, None]).T
        rows[:, k] = np.stack([c**2, s**2, c * s], axis=1)
    return np.linalg.inv(rows)


def _natural_strains(corners: FloatArray, area: FloatArray) -> list[FloatArray]:
    """Elongations along the sides at each corner due to corner rotations: three maps (n_cells, 3, 3).

    `corners` (n_cells, 3, 2) are positions, `area` (n_cells,) that of each cell.
    """
    sides = np.stack([(_side(corners, k) ** 2).sum(axis=1) for k in range(3)], axis=1)
    scale = 2 * area[:, None, None] / 3 / sides[:, :, None]
    turned = (np.roll(_STRAINS, (k, k), axis=(0, 1)) for k in range(3))
    return [scale * each for each in turned]
