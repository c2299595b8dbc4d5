"""Receptances of a model at one point of its parameters, with which the effect of every candidate cause is computed.

A receptance is the inverse of the dynamic stiffness: frequency by frequency, or by modes and a residual term.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray, evenly_spaced_indices
from structid.core.dof import Dof
from structid.core.last_results import LastResults
from structid.diagnose.thresholds import (
    FEWEST_SCREENED_LINES,
    FIRST_MODES,
    MODES_BEYOND_BAND,
    MOST_INVERSE_ENTRIES,
    MOST_MODES,
)
from structid.dynamics.normal_modes import modes
from structid.fem import Base, Structure
from structid.fem.elements.element import dof_code, dof_of_code
from structid.fem.measured import joined_receptance
from structid.forward import FrfProblem
from structid.forward.frf.response import driving_bases
from structid.records.record import DERIVATIVES


class Flexibility(Protocol):
    """Receptances G = Z^-1 of a model, m/N, at the frequencies of a record."""

    def block(self, rows: IntArray) -> ComplexArray:
        """G among the degrees of freedom at indices `rows` (n_rows,), (n_lines, n_rows, n_rows)."""

    def motion(self, forces: FloatArray | ComplexArray) -> ComplexArray:
        """Motion G f, m or rad, under `forces` f, (n_dofs, n) or (n_lines, n_dofs, n): (n_lines, n_dofs, n)."""


@dataclass(frozen=True, eq=False)
class DenseFlexibility:
    """Receptances G as the full array `inverse` (n_lines, n_dofs, n_dofs), m/N."""

    inverse: ComplexArray

    def block(self, rows: IntArray) -> ComplexArray:
        block: ComplexArray = self.inverse[:, rows[:, None], rows]
        return block

    def motion(self, forces: FloatArray | ComplexArray) -> ComplexArray:
        motion: ComplexArray = self.inverse @ forces
        return motion


@dataclass(frozen=True, eq=False)
class ModalFlexibility:
    """G = R + P H P' by mode shapes P.

    Attributes
    ----------
    residual : (n_dofs, n_dofs) float array
        R: what all other modes contribute, the same at every frequency.
    shapes : (n_dofs, n_modes) float array
        P, mass-normalized.
    receptance : (n_lines, n_modes, n_modes) complex array
        H, between modal forces and coordinates; damping couples them.
    """

    residual: FloatArray
    shapes: FloatArray
    receptance: ComplexArray

    def block(self, rows: IntArray) -> ComplexArray:
        shapes = self.shapes[rows]
        block: ComplexArray = self.residual[rows[:, None], rows] + shapes @ self.receptance @ shapes.T
        return block

    def motion(self, forces: FloatArray | ComplexArray) -> ComplexArray:
        motion: ComplexArray = self.residual @ forces + self.shapes @ (self.receptance @ (self.shapes.T @ forces))
        return motion


def modal_flexibility(structure: Structure, values: FloatArray, laplace: ComplexArray) -> ModalFlexibility:
    """Receptances of a model by its lowest modes, to beyond the band, and a residual term for all others.

    The residual term is (K + s0^2 M)^-1 less what the computed modes have of it. The shift s0, the least |s|, keeps it
    finite for a body that is not held; higher modes hardly feel it. Damping acts among the computed modes alone. Modes
    are computed up to three times the highest |s|, 40 at least and 160 at most.

    Parameters
    ----------
    structure : Structure
        Its residual term is a full matrix.
    values : (n_values,) float array
        Values of all properties of the structure, in its order and in SI units.
    laplace : (n_lines,) complex array
        Laplace variable s = decay + i omega of each frequency, in 1/s.

    References
    ----------
    Ewins (2000), Modal Testing, 2nd ed.: residual terms.
    """
    mass, damping, stiffness, structural = (
        structure.matrix(kind, values) for kind in ("mass", "damping", "stiffness", "structural_damping")
    )
    top = MODES_BEYOND_BAND * float(np.abs(laplace).max()) / (2 * np.pi)
    most = min(MOST_MODES, structure.n_dofs - 2)
    n_modes = min(FIRST_MODES, most)
    normal = modes(mass, stiffness, n_modes=n_modes)
    while n_modes < most and normal.frequency[-1] < top:
        n_modes = min(2 * n_modes, most)
        normal = modes(mass, stiffness, n_modes=n_modes)
    shapes = normal.mode_shapes
    squares = (2 * np.pi * normal.frequency) ** 2
    shift = float(np.abs(laplace).min()) ** 2
    residual = np.linalg.inv((stiffness + shift * mass).toarray()) - (shapes / (squares + shift)) @ shapes.T
    s = laplace[:, None, None]
    dynamic = s**2 * np.eye(len(squares)) + np.diag(squares)
    dynamic = dynamic + s * (shapes.T @ (damping @ shapes)) + 1j * (shapes.T @ (structural @ shapes))
    return ModalFlexibility(residual, shapes, np.linalg.inv(dynamic))


#: Degrees of freedom up to which Z is inverted line by line; of larger models modes and a residual term take its place.
MOST_DENSE_DOFS = 600
#: Directions whose unit responses are kept.
_MOST_UNIT_RESPONSES = 64
#: Lines that a screen looks at where time counts.
MOST_LINES = 90


class ElementMatrix(NamedTuple):
    """Element matrix of one property, times the value of the property.

    Attributes
    ----------
    element : str
        Name of the element set.
    number : int
        Position of the element in the set, from 0.
    property, kind : str
        Name of the property, and its kind, such as ``mass``.
    codes : (n,) int array
        Codes of the degrees of freedom of the rows, below 0 for none.
    matrix : (n, n) float array
    loss : float
        Loss factor of the element; 0 without one.
    row : int
        Position of the property's value among all values of the structure.
    """

    element: str
    number: int
    property: str
    kind: str
    codes: IntArray
    matrix: FloatArray
    loss: float
    row: int


@dataclass(frozen=True, eq=False)
class Receptances:
    """The dynamic stiffness Z of a model at lines of its record, and what follows from it, its measured components included.

    Z is complex symmetric; all products are with the transpose. Friction is not part of it. Supports that drive the
    structure are free in it, with a motion that is given: no force and no change of Z moves them.

    Attributes
    ----------
    problem : FrfProblem
        On the lines that are looked at.
    values : (n_values,) float array
        Property values of the structure.
    channel_values : (n_channel_params,) float array
        Parameters of the record's channels.
    frf : (n_lines, n_outputs, n_inputs) complex array
        FRFs of the model in the kind of the record, errors of channels included.
    """

    problem: FrfProblem
    values: FloatArray
    channel_values: FloatArray
    frf: ComplexArray

    @cached_property
    def _bases(self) -> tuple[Base, ...]:
        return driving_bases(self.problem.structure, self.problem.record)

    @cached_property
    def structure(self) -> Structure:
        """Structure of the problem, with the supports that drive it released."""
        whole = self.problem.structure
        return whole.release_supports(self._bases) if self._bases else whole

    @cached_property
    def undriven(self) -> IntArray:
        """Indices (n_undriven,) of the degrees of freedom whose motion no support prescribes."""
        given = self.structure.selection([base.supports[0].unsigned for base in self._bases])
        return np.setdiff1d(np.arange(self.structure.n_dofs), given.indices)

    @cached_property
    def laplace(self) -> ComplexArray:
        """Laplace variable s of each line, (n_lines,), in 1/s."""
        return self.problem.record.laplace

    def stiffness_of(self, structure: Structure) -> ComplexArray:
        """The dynamic stiffness Z of `structure`, which has the same properties, (n_lines, n_dofs, n_dofs)."""
        return self._stiffness_columns(structure, np.arange(structure.n_dofs))

    def flexibility(self, rows: IntArray) -> ComplexArray:
        """Receptances G = Z^-1 among the degrees of freedom at indices `rows` (n_rows,), (n_lines, n_rows, n_rows).

        In SI units: m/N, or rad/(N m) for rotations. Measured components are included; zero at driven degrees of
        freedom.
        """
        block = self._alone.block(rows)
        if self._ends is None:
            return block
        pushed, receptance = self._joints
        joined: ComplexArray = block - pushed[:, rows] @ np.linalg.solve(receptance, np.swapaxes(pushed[:, rows], 1, 2))
        return joined

    @cached_property
    def _alone(self) -> Flexibility:
        """Receptances G = Z^-1 of the model without measured components; zero at driven degrees of freedom.

        In SI units: m/N, or rad/(N m) for rotations. By modes for more than 600 degrees of freedom without driving
        supports, else by an inverse at each line.
        """
        if self.structure.n_dofs > MOST_DENSE_DOFS and not self._bases:
            return modal_flexibility(self.structure, self.values, self.laplace)
        whole = self.stiffness_of(self.structure)
        own = np.s_[:, self.undriven[:, None], self.undriven]
        inverse = np.zeros_like(whole)
        inverse[own] = np.linalg.inv(whole[own])
        return DenseFlexibility(inverse)

    @cached_property
    def _ends(self) -> FloatArray | None:
        """Columns at the interfaces of measured components with the model, (n_dofs, n_ends); None without components."""
        parts = self.structure.measured
        return self.structure.selection([dof for one in parts for dof in one.interface]).toarray() if parts else None

    @cached_property
    def _joints(self) -> tuple[ComplexArray, ComplexArray]:
        """Motion of the model alone under unit forces at the joints, and the summed receptance of both sides there.

        Shapes are (n_lines, n_dofs, n_ends) and (n_lines, n_ends, n_ends). Joints are the degrees of freedom where
        measured components meet the model; there must be some.
        """
        assert self._ends is not None
        pushed = self._alone.motion(self._ends)
        own = joined_receptance(self.structure.measured, self.problem.frequency)
        return pushed, own + self._ends.T @ pushed

    def _joined(self, motion: ComplexArray) -> ComplexArray:
        """Motion (n_lines, n_dofs, n) of the model with its measured components, if any, from `motion` without them."""
        if self._ends is None:
            return motion
        pushed, receptance = self._joints
        joined: ComplexArray = motion - pushed @ np.linalg.solve(receptance, self._ends.T @ motion)
        return joined

    @cached_property
    def under_loads(self) -> ComplexArray:
        """Motion of all free degrees of freedom under each load of the record, (n_lines, n_dofs, n_inputs).

        It is x = G f under unit forces f, or x = b - G Z b under unit support motions b, with Z the dynamic stiffness
        and G its inverse. Measured components are included.
        """
        loads = self.structure.selection(self.problem.record.inputs).toarray()
        if not self._bases:
            return self._joined(self._alone.motion(loads))
        return self._joined(loads - self._alone.motion(self.stiffness_of(self.structure) @ loads))

    @cached_property
    def under_sensors(self) -> ComplexArray:
        """Motion y = G s under unit forces s at each sensor of the record, (n_lines, n_dofs, n_outputs)."""
        return self._joined(self._alone.motion(self.structure.selection(self.problem.record.outputs).toarray()))

    @cached_property
    def factor(self) -> ComplexArray:
        """Factor (n_lines, ...) by which receptances become FRFs of the record's kind, channel errors included.

        It broadcasts to `frf`, (n_lines, n_outputs, n_inputs).
        """
        kind = (self.laplace ** DERIVATIVES[self.problem.record.kind])[:, None, None]
        channels = self.problem.channels
        found: ComplexArray = kind if channels is None else kind * channels.factor(self.channel_values, self.laplace)
        return found

    @cached_property
    def columns(self) -> dict[Dof, FloatArray]:
        """Weights (n_dofs,) by which each free direction of a node follows the free degrees of freedom, by direction.

        Keys are unsigned; directions that follow only driven supports, or nothing, are left out.
        """
        moves = self._follow[:, self.undriven].any(axis=1)
        pairs = zip(self.structure.numbering.codes[moves].tolist(), self._follow[moves], strict=True)
        return {dof_of_code(code).unsigned: follow for code, follow in pairs}

    @cached_property
    def loose(self) -> tuple[tuple[Dof, ...], ComplexArray, ComplexArray]:
        """Supports that can be released, the dynamic stiffness Z between free motions and them, and Z of each alone.

        Shapes: (n_supports) tuple, (n_lines, n_dofs, n_supports), (n_lines, n_supports). Supports that drive are
        released against what moves them. There are none where the structure has reduced components.
        """
        structure = self.structure
        n_lines, n_dofs = len(self.laplace), structure.n_dofs
        none: tuple[tuple[Dof, ...], ComplexArray, ComplexArray]
        none = (), np.zeros((n_lines, n_dofs, 0), complex), np.zeros((n_lines, 0), complex)
        if structure.components:  # let go, they would be reduced to other degrees of freedom
            return none
        driving = [dof for base in self._bases for dof in base.supports]
        free = replace(structure, fixed=(), bases=(), ties=self.problem.structure.ties)
        place = {code: i for i, code in enumerate(free.numbering.free)}
        held = [d for d in (*structure.fixed, *driving) if dof_code(d.node, d.direction) in place]
        if not held:
            return none
        ends = np.array([place[dof_code(d.node, d.direction)] for d in held])
        columns = self._stiffness_columns(free, ends)
        follow = self.reached(np.array(free.numbering.free))
        return tuple(held), follow.T @ columns, columns[:, ends, np.arange(len(ends))]

    def _stiffness_columns(self, structure: Structure, columns: IntArray) -> ComplexArray:
        """Columns, by their indices `columns`, of the dynamic stiffness Z of `structure`, (n_lines, n_dofs, n_columns).

        Z = s^2 M + s C + K + i D, with D the structural damping, on the free degrees of freedom of `structure`, which
        may be another one with the same properties.
        """
        inertia, viscous, elastic, structural = (
            structure.matrix(kind, self.values)[:, columns].toarray()
            for kind in ("mass", "damping", "stiffness", "structural_damping")
        )
        s = self.laplace[:, None, None]
        stiffness: ComplexArray = s**2 * inertia + s * viscous + elastic + 1j * structural
        return stiffness

    def elements(self, kinds: tuple[str, ...]) -> Iterator[ElementMatrix]:
        """Element matrices of all properties of the given `kinds`, such as ``mass``, times the property's value.

        One for each element and matrix term. Properties whose matrix is given as a whole are left out. `loss` is 0
        where the element set has no loss factor, and for axial forces.
        """
        losses = {p.element: self.values[p.values] for p in self.structure.properties if p.term.kind == "loss_factor"}
        for item in self.structure.properties:
            if item.term.kind not in kinds:
                continue
            weights, loss = self.values[item.values], losses.get(item.element)
            for matrix_term in item.term.matrix_terms:
                if matrix_term.whole is not None:
                    continue
                for e, (codes, local) in enumerate(zip(matrix_term.codes, matrix_term.local, strict=True)):
                    lost = 0.0 if loss is None or item.term.kind == "axial_force" else float(loss[e])
                    matrix = float(weights[e]) * local
                    row = item.values.start + e
                    yield ElementMatrix(item.element, e, item.term.property, item.term.kind, codes, matrix, lost, row)

    def along(self, codes: IntArray, weights: FloatArray) -> tuple[IntArray, FloatArray]:
        """Indices (n_rows,) of the free degrees of freedom that take part in m directions, and weights (n_rows, m).

        The directions are `weights` (n_codes, m) on the degrees of freedom `codes` (n_codes,). Results are cached.
        """
        key = codes.tobytes(), weights.tobytes()
        known = self._directions.get(key)
        if known is None:
            directions = self.reached(codes).T @ weights
            rows = np.flatnonzero(directions.any(axis=1))
            known = self._directions[key] = rows, directions[rows]
        return known

    @cached_property
    def _directions(self) -> dict[tuple[bytes, bytes], tuple[IntArray, FloatArray]]:
        """Cache of `along` by the bytes of codes and weights, empty at first; many candidates share directions."""
        return {}

    @cached_property
    def unit_responses(self) -> LastResults[tuple[bytes, bytes], tuple[ComplexArray, ComplexArray]]:
        """Cache of responses and receptances, as of parts of unit stiffness, in the directions last asked for."""
        return LastResults(_MOST_UNIT_RESPONSES)

    def reached(self, codes: IntArray) -> FloatArray:
        """Weights (n_codes, n_dofs) by which degrees of freedom, given by codes, follow the free ones; zero where held."""
        place, is_known = self._rows_of_codes(codes)
        return np.where(is_known[:, None], self._follow[place], 0.0)

    def moves(self, codes: IntArray) -> bool:
        """True where any of the degrees of freedom `codes` can move; unknown codes do not count."""
        place, is_known = self._rows_of_codes(codes)
        return bool(self._can_move[place[is_known]].any())

    def _rows_of_codes(self, codes: IntArray) -> tuple[IntArray, np.ndarray]:
        """Rows (n_codes,) in `_follow` of the degrees of freedom `codes`, and a mask (n_codes,) of those that the model has.

        Rows of the others mean nothing.
        """
        known = self.structure.numbering.codes
        place: IntArray = np.minimum(np.searchsorted(known, codes), len(known) - 1)
        return place, known[place] == codes

    @cached_property
    def _can_move(self) -> np.ndarray:
        """Mask (n_codes,) of the degrees of freedom that follow free ones."""
        return np.asarray(self._follow.any(axis=1))

    @cached_property
    def _follow(self) -> FloatArray:
        """Matrix (n_codes, n_dofs) from the motion of the free degrees of freedom to that of all, sorted by code."""
        return np.asarray(self.structure.numbering.matrix.toarray())


def receptances_at(problem: FrfProblem, theta: FloatArray, most_lines: int = MOST_LINES) -> Receptances:
    """Receptances of an FRF problem at free variables, on as many of its lines as time and memory allow.

    Of more than `most_lines` lines as many are evenly chosen: 2e7 / min(n, 600)^2 of a model of n degrees of freedom if
    that is less, but at least 40.

    Parameters
    ----------
    problem : FrfProblem
    theta : (n_params,) float array
        Free variables of this problem, those of channels last.
    most_lines : int
        Upper limit of the number of lines, for the time that they take.
    """
    n_lines = len(problem.frequency)
    n_dofs = min(problem.structure.n_dofs, MOST_DENSE_DOFS)
    room = int(np.clip(MOST_INVERSE_ENTRIES / n_dofs**2, FEWEST_SCREENED_LINES, most_lines))
    if n_lines > room:
        problem = problem.with_lines(evenly_spaced_indices(n_lines, room))
    own, rest = np.split(problem.physical(theta), [problem.parameters.n_params])
    return Receptances(problem, problem.parameters.values(own), rest, problem.predicted(theta))
