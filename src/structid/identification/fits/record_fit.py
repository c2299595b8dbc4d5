"""The identified model beside one record of responses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.dynamics import Modes
from structid.forward import FrfProblem
from structid.identification.fits.model_modes import response_rounding, rounding_warnings, structure_modes
from structid.identification.fits.resonances import Resonance, resonances
from structid.identification.options import IdentifyOptions
from structid.records import FrfRecord


class FittedUnknowns(NamedTuple):
    """Unknowns of one problem: free variables at the end, and physical values after and before."""

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
