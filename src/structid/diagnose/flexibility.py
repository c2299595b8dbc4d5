"""The inverse of a model's dynamic stiffness: line by line, or by its modes and a static rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.dynamics.normal_modes import modes
from structid.fem import Structure

#: Modes up to so many times the highest frequency of the lines stand for the motion there; at first and at most so many.
_BEYOND, _FIRST_MODES, _MOST_MODES = 3.0, 40, 160


class Flexibility(Protocol):
    """G = Z^-1 of a model at lines of a record."""

    def block(self, rows: IntArray) -> ComplexArray:
        """G among some degrees of freedom, (n_lines, n_rows, n_rows)."""

    def motion(self, forces: FloatArray | ComplexArray) -> ComplexArray:
        """G f under forces (n_dofs, n) or (n_lines, n_dofs, n): (n_lines, n_dofs, n)."""


@dataclass(frozen=True, eq=False)
class DenseFlexibility:
    """G as it is, (n_lines, n_dofs, n_dofs)."""

    inverse: ComplexArray

    def block(self, rows: IntArray) -> ComplexArray:
        block: ComplexArray = self.inverse[:, rows[:, None], rows]
        return block

    def motion(self, forces: FloatArray | ComplexArray) -> ComplexArray:
        motion: ComplexArray = self.inverse @ forces
        return motion


@dataclass(frozen=True, eq=False)
class ModalFlexibility:
    """G = R + P H P': a static rest R (n_dofs, n_dofs), mode shapes P (n_dofs, m) and their receptances H (n_lines, m, m)."""

    static: FloatArray
    shapes: FloatArray
    receptance: ComplexArray

    def block(self, rows: IntArray) -> ComplexArray:
        shapes = self.shapes[rows]
        block: ComplexArray = self.static[np.ix_(rows, rows)] + shapes @ self.receptance @ shapes.T
        return block

    def motion(self, forces: FloatArray | ComplexArray) -> ComplexArray:
        motion: ComplexArray = self.static @ forces + self.shapes @ (self.receptance @ (self.shapes.T @ forces))
        return motion


def modal_flexibility(structure: Structure, values: FloatArray, laplace: ComplexArray) -> ModalFlexibility:
    """G of a large model by the modes in and near the band; what all others do is taken as at the lowest line.

    With a shift s0 = min |s|, R = (K + s0^2 M)^-1 less what the modes have of it. Damping acts among the modes alone.

    Parameters
    ----------
    structure : Structure
    values : (n_values,) float array
        Property values.
    laplace : (n_lines,) complex array
        s, 1/s.

    References
    ----------
    Ewins (2000), Modal Testing, 2nd ed., section 5.3 (residual terms).
    """
    inertia, viscous, elastic, structural = (
        structure.matrix(kind, values) for kind in ("mass", "damping", "stiffness", "structural_damping")
    )
    top = _BEYOND * float(np.abs(laplace).max()) / (2 * np.pi)
    n_modes, most = _FIRST_MODES, min(_MOST_MODES, structure.n_dofs - 2)
    normal = modes(inertia, elastic, n_modes=min(n_modes, most))
    while n_modes < most and normal.frequency[-1] < top:
        n_modes *= 2
        normal = modes(inertia, elastic, n_modes=min(n_modes, most))
    shapes = normal.mode_shapes
    squares = (2 * np.pi * normal.frequency) ** 2
    shift = float(np.abs(laplace).min()) ** 2
    static = np.linalg.inv((elastic + shift * inertia).toarray()) - (shapes / (squares + shift)) @ shapes.T
    s = laplace[:, None, None]
    stiffness = s**2 * np.eye(len(squares)) + np.diag(squares)
    stiffness = stiffness + s * (shapes.T @ (viscous @ shapes)) + 1j * (shapes.T @ (structural @ shapes))
    return ModalFlexibility(static, shapes, np.linalg.inv(stiffness))
