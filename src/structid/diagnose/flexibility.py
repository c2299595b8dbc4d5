"""Receptances of a model, the inverse of its dynamic stiffness: frequency by frequency, or by its modes and a residual term."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.diagnose.thresholds import (
    FIRST_MODES,
    MODES_BEYOND_BAND,
    MOST_MODES,
)
from structid.dynamics.normal_modes import modes
from structid.fem import Structure


class Flexibility(Protocol):
    """Receptances G = Z^-1 of a model, m/N, at the frequencies of a record."""

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
