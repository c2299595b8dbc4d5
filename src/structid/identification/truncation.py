"""Error of a reduced model (components, swept lines) against the unreduced one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from structid.core.arrays import FloatArray
from structid.dynamics.reduced_sweep import reading_error
from structid.fem import Structure
from structid.forward import FrfProblem, ResponseCache
from structid.identification.record_fit import structure_modes

#: Lines over the band, and at the highest peaks, at which FRFs are compared; modes that are.
_SPREAD, _PEAKS, _MOST_MODES = 3, 2, 40
#: Error beyond which it is a warning.
_LARGEST = 1e-3
#: Part of the end of the band below which modes are a rigid body's.
_RIGID = 1e-3
_REMEDY = "raise `up_to` of the component, or name where it is loaded in its `interface`"
_OF_SWEEPS = "take a smaller `reduced`"


@dataclass(frozen=True)
class Truncation:
    """Error of the modes that components leave out, or of the motions that a reduced sweep does.

    Attributes
    ----------
    error : float
        Largest relative error.
    words : str
    remedy : str
    """

    error: float
    words: str
    remedy: str = _REMEDY

    @property
    def warning(self) -> str:
        """The words with a remedy where the error is large; else ""."""
        return f"{self.words}; {self.remedy}" if self.error > _LARGEST else ""


def frf_truncation(problem: FrfProblem, theta: FloatArray) -> Truncation | None:
    """Error of FRFs by reduced components or a reduced sweep, at up to five lines of the record.

    None if nothing is reduced. Lines are three spread over the band and the two highest peaks. The error is the largest
    over the lines, relative to the largest FRF of a line.

    Parameters
    ----------
    problem : FrfProblem
        Problem with the reduced structure.
    theta : (n_params,) float array
        Free variables.
    """
    if not (problem.structure.components or problem.is_reduced):
        return None
    reduced = problem.predicted(theta)
    size = np.abs(reduced).reshape(len(reduced), -1).max(axis=1)
    inner = size[1:-1]
    peaks = 1 + np.flatnonzero((inner >= size[:-2]) & (inner >= size[2:]))
    highest = peaks[np.argsort(-size[peaks])][:_PEAKS]
    spread = np.linspace(0, len(reduced) - 1, _SPREAD + 2)[1:-1].round().astype(int)
    lines = np.unique(np.concatenate([highest, spread]))
    structure = problem.structure.unreduced if problem.structure.components else problem.structure
    few = problem.record.lines(lines)
    whole = replace(
        problem,
        structure=structure,
        record=few,
        cache=ResponseCache() if problem.structure.components else problem.cache,
    )
    exact = whole.predicted(theta)
    errors = [reading_error(*pair) for pair in zip(exact, reduced[lines], strict=True)]
    worst = int(np.argmax(errors))
    return Truncation(
        errors[worst],
        f"reduction changes the model's FRFs by up to {errors[worst]:.1g} of the largest at a line ({len(lines)} lines solved with"
        f" nothing reduced, the worst at {problem.frequency[lines[worst]]:.5g} Hz)",
        _REMEDY if problem.structure.components else _OF_SWEEPS,
    )


def modes_truncation(structure: Structure, values: FloatArray, top: float) -> Truncation | None:
    """Relative error of natural frequencies up to `top` (Hz) by reduced components; None for a structure without them.

    `values` (n_values,) are the property values. At most 40 modes are compared, up to the limits of the components,
    without those of a rigid body. The error is 0 if no mode is left.
    """
    if not structure.components:
        return None
    top = min(top, *(component.up_to for component in structure.components))
    reduced = structure_modes(structure, values, min(_MOST_MODES, structure.n_dofs)).frequency
    looked = np.flatnonzero((reduced <= top) & (reduced > _RIGID * top))
    if not looked.size:
        return Truncation(0.0, "reduction was not judged: the model has no mode in the band")
    exact = structure_modes(structure.unreduced, values, int(looked[-1]) + 1).frequency
    errors = np.abs(reduced[looked] / exact[looked] - 1)
    worst = int(np.argmax(errors))
    return Truncation(
        float(errors[worst]),
        f"reduction changes natural frequencies by up to {errors[worst]:.1g} ({len(looked)} modes up to {top:.5g} Hz solved"
        f" for with nothing reduced, the worst at {reduced[looked[worst]]:.5g} Hz)",
    )
