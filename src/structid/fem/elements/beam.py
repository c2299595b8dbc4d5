"""Bars, and beams on a line, in a plane or in space, by Hermite cubics (Euler-Bernoulli, or Timoshenko with shear)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from structid.core.arrays import FloatArray, IntArray, locked, require_shape
from structid.core.dof import DIRECTIONS
from structid.core.errors import InputError
from structid.fem.elements.element import (
    LOSS_FACTOR,
    PER_STRAIN_RATE,
    PER_VELOCITY,
    TRANSLATIONS,
    ElementMatrixTerm,
    ElementSet,
    Matrices,
    NodeCoordinates,
    Nodes,
    OptionalSignedValues,
    OptionalValues,
    ShearRatio,
    Values,
    Vector,
    declared,
    element,
    element_vectors,
    node_codes,
    node_table,
    rotate_matrices,
    shear_ratio,
)

#: Points and weights by which products of two cubics are integrated from 0 to 1.
_POINTS, _WEIGHTS = (part / 2 for part in np.polynomial.legendre.leggauss(4))
_POINTS = _POINTS + 0.5
#: What both types of beam say of the rotation of their sections, and of their shear.
ROTARY_INERTIA = "Mass moment of the sections per length, rho I"
AXIAL_FORCE = "Static axial force, tension positive; it stiffens the beam sideways"
SHEAR = "G times the shear area; without it, or infinite, the beam does not shear"


def hermite_mass(length: FloatArray) -> FloatArray:
    """Consistent mass for unit mass per length, (n, 4, 4), in the order w1 theta1 w2 theta2 with theta = dw/dx.

    `length` (n,) is in m.

    References
    ----------
    Norris (1986), Eqs. (3.19a) and (3.19b).
    """
    h, one = length, np.ones_like(length)
    rows = [
        [156 * one, 22 * h, 54 * one, -13 * h],
        [22 * h, 4 * h**2, 13 * h, -3 * h**2],
        [54 * one, 13 * h, 156 * one, -22 * h],
        [-13 * h, -3 * h**2, -22 * h, 4 * h**2],
    ]
    return np.moveaxis(np.array(rows), 2, 0) * (h / 420)[:, None, None]


def hermite_stiffness(length: FloatArray) -> FloatArray:
    """Bending stiffness for unit EI, (n, 4, 4), in the order w1 theta1 w2 theta2 with theta = dw/dx.

    `length` (n,) is in m.

    References
    ----------
    Norris (1986), Eq. (3.20a).
    """
    h, one = length, np.ones_like(length)
    rows = [
        [12 * one, 6 * h, -12 * one, 6 * h],
        [6 * h, 4 * h**2, -6 * h, 2 * h**2],
        [-12 * one, -6 * h, 12 * one, -6 * h],
        [6 * h, 2 * h**2, -6 * h, 4 * h**2],
    ]
    return np.moveaxis(np.array(rows), 2, 0) / (h**3)[:, None, None]


@dataclass(frozen=True, eq=False)
class BendingPlane:
    """Beams that bend in one plane, and shear in it where `shear` has values: their element matrix terms.

    A Timoshenko beam that only its ends load has a cubic deflection and a parabolic rotation of its section:

        w = w1 + L (theta1 (x - x^2 / 2) + theta2 x^2 / 2) - a x + s a (x - 3 x^2 + 2 x^3),
        theta = theta1 (1 - x) + theta2 x - 6 s (a / L) x (1 - x),     x from 0 to 1,

    with a = w1 - w2 + (theta1 + theta2) L / 2 and the ratio s = 1 / (1 + 12 EI / (G A_s L^2)), which is 1 without
    shear: then they are Hermite's. Stiffness is exact with these, so that nothing locks; masses are consistent with
    them, in powers of s.

    Attributes
    ----------
    codes : (n, n_codes) int array
    across : (n, 4, n_codes) float array
        From the coordinates of the elements to w1 theta1 w2 theta2.
    length : (n,) float array
    bending, shear : (str, (n,) float array)
        Properties EI and G A_s: name and nominal values; None for the second where nothing shears.

    References
    ----------
    Przemieniecki (1968), Theory of Matrix Structural Analysis, Eq. (5.116); Friedman and Kosmatka (1993), Comput.
    Struct. 47, 473-481 (masses).
    """

    codes: IntArray
    across: FloatArray
    length: FloatArray
    bending: tuple[str, FloatArray]
    shear: tuple[str, FloatArray | None]

    @property
    def stiffness(self) -> tuple[ElementMatrixTerm, ...]:
        """Element matrices of bending in the plane for unit bending stiffness, reduced by the shear if there is any.

        One term without shear. Otherwise two, whose sum for rigid shear is Hermite's matrix: a uniform curvature theta2
        - theta1 with the stiffness EI / L, and the part with a shear force, with 12 EI / L^3, whose compliance L^3 / 12
        EI the shear raises by L / GA.
        """
        if self.shear[1] is None:
            return (self._matrix_term(hermite_stiffness(self.length)),)
        even, odd = np.array([0.0, -1.0, 0.0, 1.0]), self._odd
        uniform = np.outer(even, even) / self.length[:, None, None]
        growing = odd[:, :, None] * odd[:, None, :] * (12 / self.length**3)[:, None, None]
        return self._matrix_term(uniform), self._matrix_term(growing, 1)

    @property
    def mass(self) -> tuple[ElementMatrixTerm, ...]:
        """Consistent mass matrices of bending in the plane for unit mass per length.

        One term without shear, otherwise one for each power 0, 1, 2 of the shear ratio: the part of bending in the
        deflection by a shear force.
        """
        if self.shear[1] is None:
            return (self._matrix_term(hermite_mass(self.length)),)
        x, one = _POINTS[:, None], np.ones(len(self.length))
        plain = [1 + 0 * x * one, (x - x**2 / 2) * self.length, 0 * x * one, x**2 / 2 * self.length]
        bent = (x - 3 * x**2 + 2 * x**3)[..., None] * self._odd
        return self._consistent(np.stack(plain, axis=-1) - x[..., None] * self._odd, bent)

    @property
    def rotary_inertia(self) -> tuple[ElementMatrixTerm, ...]:
        """Element matrices of the rotary inertia of the sections about the plane's normal, for unit inertia per length.

        One term without shear, otherwise one for each power 0, 1, 2 of the shear ratio: the part of bending in the
        deflection by a shear force.
        """
        x, one = _POINTS[:, None], np.ones(len(self.length))
        plain = np.stack([0 * x * one, (1 - x) * one, 0 * x * one, x * one], axis=-1)
        bent = (-6 * x * (1 - x) / self.length)[..., None] * self._odd
        if self.shear[1] is None:
            return (self._matrix_term(self._product(plain + bent, plain + bent)),)
        return self._consistent(plain, bent)

    @property
    def axial_force(self) -> tuple[ElementMatrixTerm, ...]:
        """Geometric stiffness for unit tension, consistent with the deflection: the integral of w' w'.

        One term without shear, otherwise one for each power 0, 1, 2 of the shear ratio: the part of bending in the
        deflection by a shear force.

        References
        ----------
        Przemieniecki (1968), Theory of Matrix Structural Analysis, chapter 15.
        """
        x, one = _POINTS[:, None], np.ones(len(self.length))
        turned = np.stack([0 * x * one, (1 - x) * one, 0 * x * one, x * one], axis=-1)
        plain = turned - self._odd / self.length[:, None]
        bent = (1 - 6 * x + 6 * x**2)[..., None] * self._odd / self.length[:, None]
        if self.shear[1] is None:
            return (self._matrix_term(self._product(plain + bent, plain + bent)),)
        return self._consistent(plain, bent)

    @property
    def _odd(self) -> FloatArray:
        """Coefficients of a = w1 - w2 + (theta1 + theta2) L / 2 in the order w1 theta1 w2 theta2, (n, 4)."""
        one = np.ones_like(self.length)
        return np.stack([one, self.length / 2, -one, self.length / 2], axis=1)

    def _consistent(self, plain: FloatArray, bent: FloatArray) -> tuple[ElementMatrixTerm, ...]:
        """Matrix terms of the shapes `plain` + s `bent`: those of s^0, s^1 and s^2, in this order.

        Both are values at the integration points, (n_points, n, 4), in the order w1 theta1 w2 theta2.
        """
        mixed = self._product(plain, bent)
        return (
            self._matrix_term(self._product(plain, plain)),
            self._matrix_term(mixed + np.swapaxes(mixed, 1, 2), 1),
            self._matrix_term(self._product(bent, bent), 2),
        )

    def _product(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Integral of products of shapes along the beams, (n, 4, 4)."""
        integrals: FloatArray = np.einsum("g,gni,gnj,n->nij", _WEIGHTS, first, second, self.length)
        return integrals

    def _matrix_term(self, local: FloatArray, power: int = 0) -> ElementMatrixTerm:
        """An element matrix term from local matrices (n_elements, 4, 4) on (w1 theta1 w2 theta2) of the plane.

        They are turned to the coordinates `codes`. With a `power` of the shear ratio s and a shear stiffness, they are
        multiplied by the nominal s^power and change with s^power.
        """
        name, values = self.shear
        if power == 0 or values is None:
            return ElementMatrixTerm(self.codes, rotate_matrices(local, self.across))
        shear = ShearRatio(self.bending[0], name, 12 / self.length**2, power)
        nominal = shear_ratio(self.bending[1], values, shear.ratio) ** power
        return ElementMatrixTerm(self.codes, rotate_matrices(local * nominal[:, None, None], self.across), shear=shear)


def add_local_matrix(matrix_terms: tuple[ElementMatrixTerm, ...], local: FloatArray) -> tuple[ElementMatrixTerm, ...]:
    """Matrix terms with `local` added to the first, which does not depend on the shear."""
    return replace(matrix_terms[0], local=matrix_terms[0].local + local), *matrix_terms[1:]


def rod_mass(length: FloatArray) -> FloatArray:
    """Consistent mass of a rod of unit mass per length, (n, 2, 2)."""
    return np.array([[2.0, 1.0], [1.0, 2.0]]) * (length / 6)[:, None, None]


def rod_stiffness(length: FloatArray) -> FloatArray:
    """Stiffness of a rod of unit EA (or GJ), (n, 2, 2)."""
    return np.array([[1.0, -1.0], [-1.0, 1.0]]) / length[:, None, None]


@element
class Beam(ElementSet):
    """Straight beams on a line (deflection Y, rotation RZ) or in a plane (X, Y, RZ)."""

    is_line = True
    symbol = "line"
    section_stiffness: ClassVar = {"N": "axial_stiffness", "M": "bending_stiffness"}

    nodes: Nodes = declared("Node labels of the two ends", stored=node_table(2))
    mass: Values = declared("Mass per length", "mass", "kg/m")
    bending_stiffness: Values = declared("EI", "stiffness", "N m^2")
    axial_stiffness: Values = declared("EA; in a plane only", "stiffness", "N", default=0.0)
    loss_factor: Values = declared(*LOSS_FACTOR, default=0.0)
    mass_damping: Values = declared(*PER_VELOCITY, "N s/m^2", "mass", default=0.0)
    stiffness_damping: Values = declared(*PER_STRAIN_RATE, "N m^2 s", "bending_stiffness", default=0.0)
    shear_stiffness: OptionalValues = declared(SHEAR, "stiffness", "N", positive=True, unlimited=True, default=None)

    rotary_inertia: OptionalValues = declared(ROTARY_INERTIA, "rotary_inertia", "kg m", optional=True, default=None)
    axial_force: OptionalSignedValues = declared(AXIAL_FORCE, "axial_force", "N", optional=True, default=None)

    def section_directions(self, positions: NodeCoordinates) -> Mapping[str, FloatArray]:
        """Unit vectors of the internal forces on the motions of a node: V and M on a line, N, V and M in a plane.

        They are (n_elements, 2) on Y RZ or (n_elements, 3) on X Y RZ, by the name of the force; `positions` of nodes in
        m.
        """
        _, direction = element_vectors(self.name, self.nodes, positions)
        if direction.shape[1] == 1:
            unit = np.tile(np.eye(2), (len(direction), 1, 1))
            return {"V": unit[:, 0], "M": unit[:, 1]}
        along, across = _plane_maps(direction)
        return {"N": along[:, 0, :3], "V": across[:, 0, :3], "M": across[:, 1, :3]}

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """Element matrices for a unit value of each property, by its name: mass, bending stiffness and those stated.

        In a plane axial stiffness is among them, and mass acts along the beam too. `positions` are node coordinates in
        m by label; `used_codes` (degrees of freedom of other elements) are not needed.

        Raises
        ------
        InputError
            If nodes are in space, or beams on a line do not run along +X.
        """
        length, direction = element_vectors(self.name, self.nodes, positions)
        bending, shear = ("bending_stiffness", self.bending_stiffness), ("shear_stiffness", self.shear_stiffness)
        if direction.shape[1] == 1:
            if (direction < 0).any():
                raise InputError(f"beams of {self.name!r} must run along +X: give the end with the smaller x first")
            codes = node_codes(self.nodes, ("Y", "RZ"))
            across: FloatArray = np.broadcast_to(np.eye(4), (len(length), 4, 4))
            plane, along = BendingPlane(codes, across, length, bending, shear), None
        elif direction.shape[1] == 3:
            raise InputError(f"beams of {self.name!r} have 3-D nodes; use the element type `space_beam`")
        else:
            codes = node_codes(self.nodes, ("X", "Y", "RZ"))
            along, across = _plane_maps(direction)
            plane = BendingPlane(codes, across, length, bending, shear)
        terms = {"mass": plane.mass, "bending_stiffness": plane.stiffness}
        if along is not None:
            terms["mass"] = add_local_matrix(terms["mass"], rotate_matrices(rod_mass(length), along))
            terms["axial_stiffness"] = (ElementMatrixTerm(codes, rotate_matrices(rod_stiffness(length), along)),)
        if self.shear_stiffness is not None:
            terms["shear_stiffness"] = ()
        if self.rotary_inertia is not None:
            terms["rotary_inertia"] = plane.rotary_inertia
        if self.axial_force is not None:
            terms["axial_force"] = plane.axial_force
        return terms


def _plane_maps(direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Maps from (X Y RZ, X Y RZ) to axial and bending coordinates, (n_elements, 2, 6) and (n_elements, 4, 6).

    Axial are (u1 u2), bending (w1 theta1 w2 theta2). `direction` holds the unit vectors along the beams, (n_elements,
    2).
    """
    c, s = direction[:, 0], direction[:, 1]
    along = np.zeros((len(c), 2, 6))
    across = np.zeros((len(c), 4, 6))
    for end in (0, 1):
        column = 3 * end
        along[:, end, column], along[:, end, column + 1] = c, s
        across[:, 2 * end, column], across[:, 2 * end, column + 1] = -s, c
        across[:, 2 * end + 1, column + 2] = 1.0
    return along, across


@element
class Bar(ElementSet):
    """Bars between nodes on a line (X), in a plane (X, Y) or in space (X, Y, Z)."""

    is_line = True
    symbol = "line"
    section_stiffness: ClassVar = {"N": "axial_stiffness"}

    nodes: Nodes = declared("Node labels of the two ends", stored=node_table(2))
    mass: Values = declared("Mass per length", "mass", "kg/m")
    axial_stiffness: Values = declared("EA", "stiffness", "N")
    loss_factor: Values = declared(*LOSS_FACTOR, default=0.0)
    mass_damping: Values = declared(*PER_VELOCITY, "N s/m^2", "mass", default=0.0)
    stiffness_damping: Values = declared(*PER_STRAIN_RATE, "N s", "axial_stiffness", default=0.0)

    axial_force: OptionalSignedValues = declared(
        "Static axial force, tension positive; it stiffens the bar sideways, as a string",
        "axial_force",
        "N",
        optional=True,
        default=None,
    )

    def section_directions(self, positions: NodeCoordinates) -> Mapping[str, FloatArray]:
        """Axial force N; see `ElementSet.section_directions`."""
        return {"N": element_vectors(self.name, self.nodes, positions)[1]}

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """Element matrices for a unit value of mass, axial stiffness and, if stated, axial force, by property.

        `positions` are node coordinates in m by label; `used_codes` (of other elements) are not needed. Raises
        `InputError` for an axial force of nodes with one coordinate, which cannot move sideways.
        """
        length, direction = element_vectors(self.name, self.nodes, positions)
        dimensions = direction.shape[1]
        codes = node_codes(self.nodes, TRANSLATIONS[:dimensions])
        along = np.zeros((len(length), 2, 2 * dimensions))
        along[:, 0, :dimensions] = along[:, 1, dimensions:] = direction
        stiffness = rotate_matrices(rod_stiffness(length), along)
        mass = np.einsum("nij,kl->nikjl", rod_mass(length), np.eye(dimensions)).reshape(stiffness.shape)
        terms = {"mass": (ElementMatrixTerm(codes, mass),), "axial_stiffness": (ElementMatrixTerm(codes, stiffness),)}
        if self.axial_force is not None:
            if dimensions == 1:
                raise InputError(
                    f"`axial_force` of {self.name!r} needs nodes in a plane or in space, where bars move sideways; got a line"
                )
            sideways = np.eye(dimensions) - direction[:, :, None] * direction[:, None, :]
            string = np.einsum("nij,nkl->nikjl", rod_stiffness(length), sideways).reshape(stiffness.shape)
            terms["axial_force"] = (ElementMatrixTerm(codes, string),)
        return terms


def _checked_direction(name: str, orientation: ArrayLike) -> FloatArray:
    """The `orientation` of a set as a locked vector (3,); `InputError` unless it is finite and not zero.

    `name` is that of the set, for the message.
    """
    vector = locked(orientation, np.float64)
    require_shape("orientation", vector, (3,))
    if not (np.isfinite(vector).all() and vector.any()):
        raise InputError(f"`orientation` of {name!r} must be a direction, got {vector.tolist()}")
    return vector


@element
class SpaceBeam(ElementSet):
    """Straight beams between nodes in space, six degrees of freedom a node.

    The local x axis runs from the first node to the second, local y is the part of `orientation` across it.
    """

    moves = DIRECTIONS
    is_line = True
    symbol = "line"
    section_stiffness: ClassVar = {
        "N": "axial_stiffness",
        "T": "torsional_stiffness",
        "MY": "bending_stiffness_y",
        "MZ": "bending_stiffness_z",
    }

    nodes: Nodes = declared("Node labels of the two ends", stored=node_table(2))
    mass: Values = declared("Mass per length", "mass", "kg/m")
    bending_stiffness_y: Values = declared("EI about local y (deflection along local z)", "stiffness", "N m^2")
    bending_stiffness_z: Values = declared("EI about local z (deflection along local y)", "stiffness", "N m^2")
    axial_stiffness: Values = declared("EA", "stiffness", "N", default=0.0)
    torsional_stiffness: Values = declared("GJ", "stiffness", "N m^2", default=0.0)
    polar_inertia: Values = declared("Polar mass moment per length", "rotary_inertia", "kg m", default=0.0)
    loss_factor: Values = declared(*LOSS_FACTOR, default=0.0)
    mass_damping: Values = declared(*PER_VELOCITY, "N s/m^2", "mass", default=0.0)
    orientation: Vector = declared(
        "In the local x-y plane; by default global Y, or global X for beams along Y",
        stored=_checked_direction,
        default=None,
    )
    shear_stiffness_y: OptionalValues = declared(
        f"{SHEAR} along local y, with EI about z", "stiffness", "N", positive=True, unlimited=True, default=None
    )
    shear_stiffness_z: OptionalValues = declared(
        f"{SHEAR} along local z, with EI about y", "stiffness", "N", positive=True, unlimited=True, default=None
    )

    rotary_inertia_y: OptionalValues = declared(
        f"{ROTARY_INERTIA}, about local y", "rotary_inertia", "kg m", optional=True, default=None
    )
    rotary_inertia_z: OptionalValues = declared(
        f"{ROTARY_INERTIA}, about local z", "rotary_inertia", "kg m", optional=True, default=None
    )

    axial_force: OptionalSignedValues = declared(AXIAL_FORCE, "axial_force", "N", optional=True, default=None)

    def section_directions(self, positions: NodeCoordinates) -> Mapping[str, FloatArray]:
        """Unit vectors of the internal forces N, VY, VZ, T, MY and MZ on the motions X Y Z RX RY RZ of a node.

        They are (n_elements, 6) by the name of the force: normal and shear forces, torque and moments in the local axes
        of the beam. `positions` of nodes in m.
        """
        axes = _local_axes(self.name, element_vectors(self.name, self.nodes, positions)[1], self.orientation)
        wide = np.zeros((len(axes), 6, 6))
        wide[:, :3, :3] = wide[:, 3:, 3:] = axes
        return {name: wide[:, row] for row, name in enumerate(("N", "VY", "VZ", "T", "MY", "MZ"))}

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """Matrices of all beams for a unit value of each property, as terms by the property's name.

        They act on the six motions of both nodes. The names are mass, axial, torsional and bending stiffness, polar
        inertia, and where stated shear stiffness (no terms: it acts by the shear ratio), rotary inertia and axial
        force. `positions` maps nodes to X, Y, Z in m, else `InputError`; `used_codes` are not needed.
        """
        length, direction = element_vectors(self.name, self.nodes, positions)
        if direction.shape[1] != 3:
            raise InputError(f"beams of {self.name!r} need 3-D nodes; use the element type `beam`")
        codes = node_codes(self.nodes, DIRECTIONS)
        maps = _space_maps(_local_axes(self.name, direction, self.orientation))
        rod = rod_stiffness(length)
        by_property = {
            "polar_inertia": rotate_matrices(rod_mass(length), maps["twist"]),
            "axial_stiffness": rotate_matrices(rod, maps["along"]),
            "torsional_stiffness": rotate_matrices(rod, maps["twist"]),
        }
        about_y = ("bending_stiffness_y", self.bending_stiffness_y), ("shear_stiffness_z", self.shear_stiffness_z)
        about_z = ("bending_stiffness_z", self.bending_stiffness_z), ("shear_stiffness_y", self.shear_stiffness_y)
        rotary = {"about_y": self.rotary_inertia_y, "about_z": self.rotary_inertia_z}
        matrix_terms: dict[str, tuple[ElementMatrixTerm, ...]] = {
            name: (ElementMatrixTerm(codes, local),) for name, local in by_property.items()
        }
        matrix_terms["mass"] = (ElementMatrixTerm(codes, rotate_matrices(rod_mass(length), maps["along"])),)
        for name, (bending, shear) in (("about_y", about_y), ("about_z", about_z)):
            plane = BendingPlane(codes, maps[name], length, bending, shear)
            matrix_terms[bending[0]] = plane.stiffness
            matrix_terms["mass"] = (*add_local_matrix(matrix_terms["mass"], plane.mass[0].local), *plane.mass[1:])
            if shear[1] is not None:
                matrix_terms[shear[0]] = ()
            if rotary[name] is not None:
                matrix_terms[f"rotary_inertia_{name[-1]}"] = plane.rotary_inertia
            if self.axial_force is not None:
                matrix_terms["axial_force"] = (*matrix_terms.get("axial_force", ()), *plane.axial_force)
        return matrix_terms


def _local_axes(name: str, x: FloatArray, orientation: FloatArray | None) -> FloatArray:
    """Local axes x, y, z as rows, (n_elements, 3, 3), from unit vectors `x` (n_elements, 3) along the beams.

    Local y is the part of `orientation` (3,) across the beam; by default (None) of global Y, or of global X for beams
    with a Y part above 0.99. Raises `InputError`, which names the set, if `orientation` runs along a beam.
    """
    if orientation is not None:
        guide = np.broadcast_to(orientation, x.shape)
    else:
        guide = np.where(np.abs(x[:, [1]]) > 0.99, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    y = guide - (guide * x).sum(axis=1, keepdims=True) * x
    size = np.linalg.norm(y, axis=1, keepdims=True)
    if (size < 1e-8 * np.linalg.norm(guide, axis=1, keepdims=True)).any():
        raise InputError(f"`orientation` of {name!r} must not run along the beam, got {guide[0].tolist()}")
    y = y / size
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _space_maps(axes: FloatArray) -> dict[str, FloatArray]:
    """Maps (n_elements, 2 or 4, 12) from the twelve global coordinates of a beam to its local ones, by name.

    ``along`` and ``twist`` give axial motion and rotation at both ends; ``about_y`` and ``about_z`` give w1 theta1 w2
    theta2 of each bending plane. `axes` (n_elements, 3, 3) are the local axes as rows.
    """
    n = len(axes)
    maps: dict[str, FloatArray] = {
        key: np.zeros((n, size, 12)) for key, size in (("along", 2), ("twist", 2), ("about_y", 4), ("about_z", 4))
    }
    x, y, z = axes[:, 0], axes[:, 1], axes[:, 2]
    for end in (0, 1):
        translations, rotations = slice(6 * end, 6 * end + 3), slice(6 * end + 3, 6 * end + 6)
        maps["along"][:, end, translations] = x
        maps["twist"][:, end, rotations] = x
        maps["about_z"][:, 2 * end, translations] = y
        maps["about_z"][:, 2 * end + 1, rotations] = z
        maps["about_y"][:, 2 * end, translations] = z
        maps["about_y"][:, 2 * end + 1, rotations] = -y
    return maps
