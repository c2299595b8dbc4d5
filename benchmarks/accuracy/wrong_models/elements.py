"""Element matrices of the simulator, each from its shape functions by quadrature or from its textbook closed form.

Every function takes the positions of the element's nodes, (n_nodes, n_coordinates), and its properties, and returns
an `Element`. Property names are those of the study file, so that one table describes both.

References
----------
Przemieniecki (1968), Theory of Matrix Structural Analysis, sections 5.6 and 11; Narayanaswami and Adelman (1974), AIAA J. 12
(the shape functions of a beam that shears); Zienkiewicz and Taylor (2000), vol. 2, section 4.3 (the rectangular plate).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

Properties = Mapping[str, float]


@dataclass(frozen=True)
class Element:
    """Matrices over `directions` of the first node, then of the second, and so on; `stiffness` may be complex."""

    directions: tuple[str, ...]
    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray


@cache
def gauss(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and weights on 0 to 1."""
    points, weights = np.polynomial.legendre.leggauss(n)
    return (points + 1) / 2, weights / 2


def flexure(length: float, stiffness: float, shear: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Unit mass and bending stiffness, (4, 4), order w1 theta1 w2 theta2; `shear` is GA_s in N, 0 for rigid."""
    phi = 12 * stiffness / (shear * length**2) if shear else 0.0
    s, weights = gauss(5)
    w = np.array([
        1 - 3 * s**2 + 2 * s**3 + phi * (1 - s),
        length * (s - 2 * s**2 + s**3 + phi * (s - s**2) / 2),
        3 * s**2 - 2 * s**3 + phi * s,
        length * (s**3 - s**2 + phi * (s**2 - s) / 2),
    ]) / (1 + phi)  # fmt: skip
    mass = length * (w * weights) @ w.T
    # the curvature is linear in s: its mean from the rotations, its slope from what they leave of the deflections
    turn, tilt = np.array([0, -1, 0, 1]) / length, np.array([2, length, -2, length]) / length
    bent = np.outer(turn, turn) * length + np.outer(tilt, tilt) * 3 / (length * (1 + phi))
    return mass, stiffness * bent


def rod(length: float) -> tuple[np.ndarray, np.ndarray]:
    """Unit mass and stiffness, (2, 2), of extension or torsion."""
    return np.array([[2.0, 1.0], [1.0, 2.0]]) * length / 6, np.array([[1.0, -1.0], [-1.0, 1.0]]) / length


def _damped(directions: tuple[str, ...], p: Properties, heavy: np.ndarray, stiff: np.ndarray, per: float) -> Element:
    """Mass-like and stiffness-like viscous damping, and the loss factor; `per` is the stiffness that `stiff` is of."""
    viscous = p.get("mass_damping", 0.0) * heavy + p.get("stiffness_damping", 0.0) * stiff / per
    return Element(directions, p["mass"] * heavy, viscous, stiff * (1 + 1j * p.get("loss_factor", 0.0)))


def beam(points: np.ndarray, p: Properties) -> Element:
    """A beam on a line (Y, RZ) or in a plane (X, Y, RZ); with `shear_stiffness`, N, one that shears."""
    span = points[1] - points[0]
    length = float(np.linalg.norm(span))
    heavy, stiff = flexure(length, p["bending_stiffness"], p.get("shear_stiffness", 0.0))
    if len(span) == 1:
        return _damped(("Y", "RZ"), p, heavy, stiff, p["bending_stiffness"])
    (c, s), n = span / length, np.zeros((6, 6))
    for end in (0, 3):
        n[end : end + 3, end : end + 3] = [[c, s, 0], [-s, c, 0], [0, 0, 1]]
    along, across = n[[0, 3]], n[[1, 2, 4, 5]]
    rod_heavy, rod_stiff = rod(length)
    heavy = across.T @ heavy @ across + along.T @ rod_heavy @ along
    bent = across.T @ stiff @ across
    made = _damped(("X", "Y", "RZ"), p, heavy, bent, p["bending_stiffness"])
    axial = along.T @ rod_stiff @ along * p.get("axial_stiffness", 0.0) * (1 + 1j * p.get("loss_factor", 0.0))
    return Element(made.directions, made.mass, made.damping, made.stiffness + axial)


def space_beam(points: np.ndarray, p: Properties) -> Element:
    """A beam in space; local y is the part of global Y (X for a beam along Y) across it."""
    span = points[1] - points[0]
    length = float(np.linalg.norm(span))
    x = span / length
    guide = np.eye(3)[0 if abs(x[1]) > 0.99 else 1]
    y = guide - (guide @ x) * x
    y /= np.linalg.norm(y)
    z = np.cross(x, y)
    maps = {name: np.zeros((size, 12)) for name, size in (("along", 2), ("twist", 2), ("in_xy", 4), ("in_xz", 4))}
    for end in (0, 1):
        shift, turn = slice(6 * end, 6 * end + 3), slice(6 * end + 3, 6 * end + 6)
        maps["along"][end, shift] = maps["twist"][end, turn] = x
        maps["in_xy"][2 * end, shift], maps["in_xy"][2 * end + 1, turn] = y, z
        maps["in_xz"][2 * end, shift], maps["in_xz"][2 * end + 1, turn] = z, -y

    def placed(name: str, matrix: np.ndarray) -> np.ndarray:
        return maps[name].T @ matrix @ maps[name]

    shear = p.get("shear_stiffness", 0.0)
    in_xy, in_xz = (flexure(length, p[f"bending_stiffness_{axis}"], shear) for axis in "zy")
    rod_heavy, rod_stiff = rod(length)
    heavy = placed("along", rod_heavy) + placed("in_xy", in_xy[0]) + placed("in_xz", in_xz[0])
    stiff = placed("in_xy", in_xy[1]) + placed("in_xz", in_xz[1]) + placed("along", rod_stiff) * p["axial_stiffness"]
    stiff += placed("twist", rod_stiff) * p["torsional_stiffness"]
    made = _damped(("X", "Y", "Z", "RX", "RY", "RZ"), p, heavy, stiff, 1.0)
    polar = placed("twist", rod_heavy) * p.get("polar_inertia", 0.0)
    return Element(made.directions, made.mass + polar, made.damping, made.stiffness)


def bar(points: np.ndarray, p: Properties) -> Element:
    """A bar in as many directions as its nodes have coordinates; it has mass across its axis too."""
    span = points[1] - points[0]
    n, length = len(span), float(np.linalg.norm(span))
    rod_heavy, rod_stiff = rod(length)
    along = np.kron(np.eye(2), span / length)
    stiff = along.T @ rod_stiff @ along * p["axial_stiffness"]
    return _damped(("X", "Y", "Z")[:n], p, np.kron(rod_heavy, np.eye(n)), stiff, p["axial_stiffness"])


def membrane(points: np.ndarray, p: Properties) -> Element:
    """A linear triangle under tension that moves along Z."""
    edges = np.vstack([np.ones(3), points[:, :2].T])
    area, slopes = abs(np.linalg.det(edges)) / 2, np.linalg.inv(edges)[:, 1:]
    heavy = area / 12 * (np.ones((3, 3)) + np.eye(3))
    return _damped(("Z",), p, heavy, area * p["tension"] * slopes @ slopes.T, p["tension"])


@cache
def _unit_plate(a: float, b: float, poisson: float) -> tuple[np.ndarray, np.ndarray]:
    """Unit mass and stiffness, (12, 12), of a rectangle of sides `a` and `b`, corners counter-clockwise from the origin."""
    powers = [(i, total - i) for total in range(4) for i in range(total, -1, -1)] + [(3, 1), (1, 3)]

    def row(x: float, y: float, dx: int = 0, dy: int = 0) -> np.ndarray:
        """The twelve monomials at a point, differentiated."""
        falls = [np.prod(np.arange(i, i - dx, -1)) * np.prod(np.arange(j, j - dy, -1)) for i, j in powers]
        return np.array(
            [f * x ** max(i - dx, 0) * y ** max(j - dy, 0) for f, (i, j) in zip(falls, powers, strict=True)]
        )

    corners = [(0.0, 0.0), (a, 0.0), (a, b), (0.0, b)]
    values = [r for x, y in corners for r in (row(x, y), row(x, y, 0, 1), -row(x, y, 1, 0))]  # w, RX = w,y, RY = -w,x
    shape = np.linalg.inv(np.array(values))
    law = np.array([[1, poisson, 0], [poisson, 1, 0], [0, 0, (1 - poisson) / 2]])
    heavy, stiff = np.zeros((12, 12)), np.zeros((12, 12))
    for x, wx in zip(*gauss(4), strict=True):
        for y, wy in zip(*gauss(4), strict=True):
            at, weight = (x * a, y * b), wx * wy * a * b
            w = row(*at) @ shape
            bent = np.array([row(*at, 2, 0), row(*at, 0, 2), 2 * row(*at, 1, 1)]) @ shape
            heavy += weight * np.outer(w, w)
            stiff += weight * bent.T @ law @ bent
    return heavy, stiff


def plate(points: np.ndarray, p: Properties) -> Element:
    """A rectangular thin plate along X and Y (Z, RX, RY at four corners), by Adini, Clough and Melosh's polynomial.

    Corners run counter-clockwise from the one of least X and Y. Properties: `bending_stiffness` (E t^3 / (12 (1 - nu^2)),
    N m), `mass` (kg/m^2), `poisson`.
    """
    a, b = (float(f"{side:.12g}") for side in np.ptp(points, axis=0)[:2])
    heavy, stiff = _unit_plate(a, b, p["poisson"])
    return _damped(("Z", "RX", "RY"), p, heavy, p["bending_stiffness"] * stiff, p["bending_stiffness"])


ELEMENTS = {"beam": beam, "space_beam": space_beam, "bar": bar, "membrane": membrane, "plate": plate}
