"""Rectangular, cylindrical and spherical coordinate systems of decks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.core.arrays import FloatArray

#: Sine of the angle up to which two directions lie on one line: far above rounding, far below what anyone means.
_ALONG = 1e-9


@dataclass(frozen=True, eq=False)
class CoordinateSystem:
    """A coordinate system in basic coordinates.

    Attributes
    ----------
    form : str
        R (rectangular: x, y, z), C (cylindrical: r, theta, z) or S (spherical: see `to_basic`); angles in degrees.
    origin : (3,) float array
    axes : (3, 3) float array
        Unit vectors x, y and z as rows.
    """

    form: str
    origin: FloatArray
    axes: FloatArray

    def to_basic(self, coordinates: FloatArray) -> FloatArray:
        """Basic coordinates of points, (n, 3); of a sphere r, the angle from the z axis, and that about it from x."""
        return self.origin + rectangular(self.form, coordinates) @ self.axes

    def directions_at(self, positions: FloatArray) -> FloatArray:
        """Unit vectors of the three directions, as rows, at `positions` (n, 3) in basic coordinates, (n, 3, 3).

        They are x, y, z of a rectangular system; radial, around, z of a cylindrical one; radial, polar, around of a
        spherical one. On the z axis, where radial directions have no meaning, those of angle 0 are taken, as Nastran
        does.
        """
        positions = np.atleast_2d(positions)
        if self.form == "R":
            return np.broadcast_to(self.axes, (len(positions), 3, 3)).copy()
        local = (positions - self.origin) @ self.axes.T
        about = np.arctan2(local[:, 1], local[:, 0])
        zero, one = np.zeros(len(local)), np.ones(len(local))
        out = np.stack([np.cos(about), np.sin(about), zero], axis=1)
        around = np.stack([-np.sin(about), np.cos(about), zero], axis=1)
        up = np.stack([zero, zero, one], axis=1)
        if self.form == "C":
            return np.stack([out, around, up], axis=1) @ self.axes
        down = np.arctan2(np.linalg.norm(local[:, :2], axis=1), local[:, 2])[:, None]
        radial, polar = np.sin(down) * out + np.cos(down) * up, np.cos(down) * out - np.sin(down) * up
        return np.stack([radial, polar, around], axis=1) @ self.axes


def axes_of_points(origin: FloatArray, on_z: FloatArray, in_xz: FloatArray) -> FloatArray | None:
    """Axes x, y, z as rows (3, 3) of a coordinate system given by three points (3,); None if they lie on a line.

    The points are its origin, a point on z, and one in the half plane of z and positive x. An angle between their
    directions of less than 1e-9 rad counts as a line.
    """
    z, across = on_z - origin, in_xz - origin
    y = np.cross(z, across)
    if not np.linalg.norm(y) > _ALONG * np.linalg.norm(z) * np.linalg.norm(across):
        return None
    axes = np.stack([np.cross(y, z), y, z])
    directions: FloatArray = axes / np.linalg.norm(axes, axis=1)[:, None]
    return directions


def axes_from_x(origin: FloatArray, on_x: FloatArray, in_xy: FloatArray) -> FloatArray | None:
    """Axes x, y, z as rows (3, 3) of a system given by its origin, a point on x, and one in the half plane of x and y.

    None if the points (3,) lie on a line, as in `axes_of_points`.
    """
    axes = axes_of_points(origin, on_x, in_xy)
    return None if axes is None else axes[[2, 0, 1]]


def rectangular(form: str, coordinates: FloatArray) -> FloatArray:
    """Rectangular coordinates (n, 3) from `coordinates` (n, 3) in the form R, C or S; angles are in degrees.

    R is x, y, z; C is r, theta, z; S is r, the angle from the z axis, and the angle about it from x.
    """
    if form == "R":
        return coordinates
    first, second = coordinates[:, 0], np.radians(coordinates[:, 1])
    if form == "C":
        return np.stack([first * np.cos(second), first * np.sin(second), coordinates[:, 2]], axis=1)
    around = np.radians(coordinates[:, 2])
    across = first * np.sin(second)
    return np.stack([across * np.cos(around), across * np.sin(around), first * np.cos(second)], axis=1)


def unit_normals(corners: FloatArray) -> FloatArray:
    """Unit normals (n_cells, 3) of triangles and quadrilaterals `corners` (n_cells, 3 or 4, 3).

    Seen from its tip, corners turn counterclockwise. That of a quadrilateral is across both of its diagonals; zero for
    cells without area.
    """
    if corners.shape[1] == 3:
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    else:
        normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    sizes = np.linalg.norm(normals, axis=1, keepdims=True)
    unit: FloatArray = normals / np.where(sizes > 0, sizes, 1.0)
    return unit
