"""The identified model beside one record of responses, its modes, and its resonances as an engineer reads them off.

Resonances are peaks of the imaginary part, measured beside predicted. A reduced model (components, swept lines) has its error
against the unreduced one beside them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.dynamics import Modes
from structid.dynamics.normal_modes import modes
from structid.dynamics.receptance import reading_error
from structid.fem import Structure
from structid.fem.elements.matrix_group import SolverModel
from structid.forward import FrfProblem, ResponseCache
from structid.identification.options import IdentifyOptions
from structid.records import FrfRecord
from structid.records.record import FrfKind

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


#: Damping ratio that a resonance is taken to have at least where its half-bandwidth is a measure.
LEAST_DAMPING = 0.001
_PROMINENCE = np.log(3.0)  # of a measured peak, whose sides are noisy
_MODEL_PROMINENCE = np.log(1.5)  # of a peak of a model, which has no noise
_FARTHEST = 0.15


@dataclass(frozen=True)
class Resonance:
    """A peak of the measured record and the nearest one of the model.

    Attributes
    ----------
    measured : float
        Hz.
    predicted : float
        Hz; NaN where the model has no peak within 15 %.
    """

    measured: float
    predicted: float


def resonances(record: FrfRecord, predicted: ComplexArray) -> tuple[Resonance, ...]:
    """Peaks of the measured FRFs, each with the nearest peak of the model within 15 % in frequency (Hz).

    NaN if there is none. A peak is a maximum of the sum over channels of abs(Im H) (abs(Re H) for mobility) that stands
    out by a factor of three, that of a model by 1.5, and exceeds half of the sum of abs(H).

    Parameters
    ----------
    record : FrfRecord
        Measured FRFs.
    predicted : (n_frequencies, n_outputs, n_inputs) complex array
        FRFs of the model at the same lines.
    """
    measured = peaks(record.frequency, record.values, record.kind)
    model = peaks(record.frequency, predicted, record.kind, _MODEL_PROMINENCE)
    matched = []
    for peak in measured:
        near = model[np.abs(model - peak) <= _FARTHEST * peak]
        nearest = float(near[np.abs(near - peak).argmin()]) if near.size else float("nan")
        matched.append(Resonance(float(peak), nearest))
    return tuple(matched)


def peaks(frequency: FloatArray, values: ComplexArray, kind: FrfKind, prominence: float = _PROMINENCE) -> FloatArray:
    """Frequencies (Hz) of the resonance peaks of FRFs, (n_peaks,), interpolated by a parabola through three logarithms.

    A peak is a maximum of the sum over channels of abs(Im H) (abs(Re H) for mobility) that stands out on both sides by
    the `prominence` and exceeds half of the sum of abs(H). Empty for fewer than five lines.

    Parameters
    ----------
    frequency : (n_frequencies,) float array
        Lines, Hz.
    values : (n_frequencies, n_outputs, n_inputs) complex array
        FRFs H.
    kind : FrfKind
        Kind of the FRFs.
    prominence : float
        Natural logarithm of the factor; by default that of three.
    """
    indicator = np.abs(values.real if kind == "mobility" else values.imag).sum(axis=(1, 2))
    size = np.abs(values).sum(axis=(1, 2))
    if len(indicator) < 5:
        return np.zeros(0)
    level = np.log(np.maximum(np.maximum(indicator, 0.5 * size), np.finfo(float).tiny))
    index = prominent(level, prominence)
    index = index[indicator[index] > 0.5 * size[index]]
    before, here, after = level[index - 1], level[index], level[index + 1]
    bend = before - 2 * here + after
    shift = np.where(bend < 0, 0.5 * (before - after) / np.where(bend < 0, bend, -1.0), 0.0)
    step = 0.5 * (frequency[index + 1] - frequency[index - 1])
    return frequency[index] + np.clip(shift, -0.5, 0.5) * step


def prominent(level: FloatArray, least: float) -> IntArray:
    """Indices of the maxima of `level` (n,) that exceed the minima on both sides by at least `least`."""
    peaks: list[int] = []
    top = low = float(level[0])
    index, rises = 0, False
    for i, value in enumerate(level.tolist()):
        if rises and value > top:
            top, index = value, i
        elif rises and top - value >= least:
            peaks.append(index)
            low, rises = value, False
        elif not rises and value < low:
            low = value
        elif not rises and value - low >= least:
            top, index, rises = value, i, True
    return np.array(peaks, dtype=np.int64)


class FittedUnknowns(NamedTuple):
    """Unknowns of one problem, (n_params,) each: free variables at the end, physical values there, and initial ones."""

    theta: FloatArray
    values: FloatArray
    initial: FloatArray


@dataclass(frozen=True, eq=False)
class PredictedLines:
    """Lines of a record beside the model, errors of channels included.

    Attributes
    ----------
    record : FrfRecord
    initial, final : (n_frequencies, n_outputs, n_inputs) complex arrays
        With initial and with identified parameters.
    """

    record: FrfRecord
    initial: ComplexArray
    final: ComplexArray


@dataclass(frozen=True, eq=False)
class RecordFit:
    """The identified model beside one record.

    Attributes
    ----------
    name : str
    problem : FrfProblem
        Structure, parameters and the lines of the record that were used, or that show the fit of time histories.
    theta : (n_own,) float array
        Free variables of this problem's own parameters at the end.
    measured : FrfRecord
        The whole record, before the band was cut out.
    used, judged : PredictedLines
        The lines in the fit, and those on which it is judged.
    modes_initial, modes : Modes
        Of the initial and of the identified model.
    resonances : tuple of Resonance
        Peaks of the judged lines, measured beside predicted.
    """

    name: str
    problem: FrfProblem
    theta: FloatArray
    measured: FrfRecord
    used: PredictedLines
    judged: PredictedLines
    modes_initial: Modes
    modes: Modes
    resonances: tuple[Resonance, ...]

    @property
    def predicted(self) -> ComplexArray:
        """The identified model's FRF at the used lines, (n_frequencies, n_outputs, n_inputs)."""
        return self.used.final

    @property
    def predicted_initial(self) -> ComplexArray:
        """FRFs of the initial model at the lines that were fitted, (n_lines, n_outputs, n_inputs)."""
        return self.used.initial

    @property
    def evaluation(self) -> FrfRecord:
        """The lines on which the fit is judged."""
        return self.judged.record

    @property
    def evaluation_predicted(self) -> ComplexArray:
        """FRFs of the identified model at the lines on which the fit is judged, (n_lines, n_outputs, n_inputs)."""
        return self.judged.final

    @property
    def evaluation_initial(self) -> ComplexArray:
        """FRFs of the initial model at the lines on which the fit is judged, (n_lines, n_outputs, n_inputs)."""
        return self.judged.initial

    @property
    def relative_error(self) -> FloatArray:
        """abs(predicted - measured) / abs(measured), (n_evaluated, n_outputs, n_inputs)."""
        return _relative(self.judged.final, self.judged.record.values)

    @property
    def initial_relative_error(self) -> FloatArray:
        """Relative error of the initial model, (n_evaluated, n_outputs, n_inputs)."""
        return _relative(self.judged.initial, self.judged.record.values)

    @property
    def polarities(self) -> dict[str, int]:
        """Sign, +1 or -1, of every channel polarity that the data decided, by its name.

        Empty without unknown channels.
        """
        channels = self.problem.channels
        if channels is None:
            return {}
        return {n: int(p) for n, p in zip(channels.polarity_names, channels.polarities, strict=True)}

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about channels that read with the opposite sense, and a model too fine for double precision."""
        turned = [name for name, sign in self.polarities.items() if sign < 0]
        words = [
            f"{name} is -1: the channel reads with the opposite sense; correct its sign in the record or the study"
            for name in turned
        ]
        return (*words, *rounding_warnings(response_rounding(self.modes)))


def record_fit(
    title: str, measured: FrfRecord, problem: FrfProblem, fitted: FittedUnknowns, options: IdentifyOptions
) -> RecordFit:
    """Initial and identified model beside one record of responses: FRFs, modes and resonances.

    Parameters
    ----------
    title : str
        Name of the record in reports.
    measured : FrfRecord
        Record with all lines.
    problem : FrfProblem
        Problem of the lines that were used.
    fitted : FittedUnknowns
        Free variables, values and initial values of the problem's parameters.
    options : IdentifyOptions
        Their evaluation band has the lines on which the fit is judged, by default those that were used; `n_modes` modes
        are computed.
    """
    before, after = (problem.property_values(values) for values in (fitted.initial, fitted.values))

    def beside(record: FrfRecord) -> PredictedLines:
        return PredictedLines(
            record, *(problem.predicted_on(record, values) for values in (fitted.initial, fitted.values))
        )

    used = beside(problem.record)
    judged = used if options.evaluation_band is None else beside(measured.band(*options.evaluation_band))
    return RecordFit(
        name=title,
        problem=problem,
        theta=fitted.theta,
        measured=measured,
        used=used,
        judged=judged,
        modes_initial=structure_modes(problem.structure, before, options.n_modes),
        modes=structure_modes(problem.structure, after, options.n_modes),
        resonances=resonances(judged.record, judged.final),
    )


def _relative(predicted: ComplexArray, measured: ComplexArray) -> FloatArray:
    return np.abs(predicted - measured) / np.maximum(np.abs(measured), np.finfo(float).tiny)


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
