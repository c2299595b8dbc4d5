"""Modes of a structure with given property values."""

from __future__ import annotations

from functools import partial

import numpy as np

from structid.core.arrays import FloatArray
from structid.dynamics import Modes
from structid.dynamics.normal_modes import modes
from structid.fem import Structure
from structid.fem.elements.solver_model import SolverModel

#: Relative error of a frequency that is worth a word.
_ROUNDING = 1e-3


def structure_modes(structure: Structure, values: FloatArray, n_modes: int) -> Modes:
    """Lowest `n_modes` modes of `structure` with the property `values` (n_values,), without friction.

    No modes if the structure has none, as for FRFs of a solver. A structure from the modes of a solver has at most those modes.
    """
    if not structure.has_modes:
        return Modes(np.zeros(0), np.zeros(0), np.zeros((structure.n_dofs, 0)), np.zeros(0))
    mass, stiffness, damping, structural = (
        structure.matrix(matrix_kind, values) for matrix_kind in ("mass", "stiffness", "damping", "structural_damping")
    )
    n_solver = sum(element.own_modes for element in structure.elements if isinstance(element, SolverModel))
    strains = partial(structure.strain_operator, values)
    return modes(mass, stiffness, damping, structural, min(n_modes, n_solver) if n_solver else n_modes, strains)


def response_rounding(modes: Modes) -> FloatArray:
    """Relative error of each resonance, (n_modes,), in responses that are solved from the assembled stiffness matrix."""
    if modes.matrix_rounding is None:
        return modes.rounding
    return np.maximum(modes.rounding, modes.matrix_rounding)


def rounding_warnings(rounding: FloatArray) -> list[str]:
    """List with a warning if rounding moves a frequency by more than 0.1 %; else empty.

    `rounding` (n_modes,) are the relative errors of the frequencies.
    """
    worst = float(rounding.max(initial=0.0))
    if worst <= _ROUNDING:
        return []
    return [
        "the model is too fine, or too stiff in places, for double precision: rounding of its stiffness matrix alone can"
        f" move the frequency of mode {int(rounding.argmax()) + 1} by {100 * worst:.2g} %, and the responses near it; use"
        " longer elements or softer joints"
    ]
