"""What was measured together, and what an identification gives: an estimate, and each record beside its model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from structid.arrays import ComplexArray, FloatArray, IntArray
from structid.dof import Dof
from structid.dynamics import Modes
from structid.estimation import Estimate
from structid.estimation.intervals.intervals import Intervals
from structid.identification.modal_setup import ModalFit, ModalSetup
from structid.identification.ratios import Ratios
from structid.identification.regularizing import Held
from structid.identification.resonances import Resonance
from structid.identification.time_fit import TimeFit
from structid.observation import ChannelUnknown, FrfProblem
from structid.records import FrfRecord
from structid.structure import Structure
from structid.unknowns import Parameters


@dataclass(frozen=True, eq=False)
class Setup:
    """One record and what it was measured on.

    Parameters
    ----------
    structure : Structure
        As it was for this record: with its supports and added masses.
    parameters : Parameters
        Those of this structure; names shared with other set-ups are the same unknowns.
    record : FrfRecord
    channel_unknowns : sequence of ChannelUnknown
        Errors of this record's sensors and loads that are identified too.
    name : str
        What reports call it.
    time : TimeFit, optional
        Histories that are fitted themselves; `record`, averaged from them, then only shows the fit.
    """

    structure: Structure
    parameters: Parameters
    record: FrfRecord
    channel_unknowns: Sequence[ChannelUnknown] = ()
    name: str = ""
    time: TimeFit | None = None


#: One record of a study with what it was measured on.
AnySetup = Setup | ModalSetup


@dataclass(frozen=True, eq=False)
class RecordFit:
    """What was identified, seen from one record.

    Attributes
    ----------
    name : str
    problem : FrfProblem
        Structure, parameters and the lines of the record that were used.
    theta : (n_own,) float array
        Free variables of this problem's own parameters at the end.
    measured : FrfRecord
        The whole record, before the band was cut out.
    predicted_initial, predicted : (n_frequencies, n_outputs, n_inputs) complex arrays
        The model's FRF at the used lines, with initial and with identified parameters, errors of channels included.
    evaluation : FrfRecord
        The lines on which the fit is judged.
    evaluation_initial, evaluation_predicted : (n_evaluated, n_outputs, n_inputs) complex arrays
        The model's FRF there.
    modes_initial, modes : Modes
        Of the initial and of the identified model.
    resonances : tuple of Resonance
        Peaks of the evaluated lines, measured beside predicted.
    time : TimeFit, optional
        Histories that were fitted in place of the FRFs.
    """

    name: str
    problem: FrfProblem
    theta: FloatArray
    measured: FrfRecord
    predicted_initial: ComplexArray
    predicted: ComplexArray
    evaluation: FrfRecord
    evaluation_initial: ComplexArray
    evaluation_predicted: ComplexArray
    modes_initial: Modes
    modes: Modes
    resonances: tuple[Resonance, ...]
    time: TimeFit | None = None

    @property
    def relative_error(self) -> FloatArray:
        """abs(predicted - measured) / abs(measured), (n_evaluated, n_outputs, n_inputs)."""
        return _relative(self.evaluation_predicted, self.evaluation.values)

    @property
    def initial_relative_error(self) -> FloatArray:
        """The same of the initial model."""
        return _relative(self.evaluation_initial, self.evaluation.values)

    @property
    def polarities(self) -> dict[str, int]:
        """+1 or -1 of every polarity that the data decided."""
        channels = self.problem.channels
        if channels is None:
            return {}
        return {n: int(p) for n, p in zip(channels.polarity_names, channels.polarities, strict=True)}


@dataclass(frozen=True, eq=False)
class Identification:
    """An estimate with what it was made from and what it predicts.

    Everything that belongs to one record of responses is told of the first; see `RecordFit` for what each means, and
    `seen_from` for the others. There is none of it where all records hold modes.

    Attributes
    ----------
    estimate : Estimate
        Of all parameters: those of the structure, then those of the records' channels.
    fits : tuple of RecordFit
        One a record of responses.
    prior_mean, prior_std : (n_params,) float arrays
        Own prior of each parameter, physical units; NaN where there is none.
    total_mass, total_mass_std : float
        Of the first set-up's structure, kg; NaN where the structure has no mass property in kg.
    warnings : tuple of str
        What the reader should know first.
    held : tuple of Held
        Regularizations and their strengths.
    prior_share : (n_params,) float array or None
        Part of each parameter's variance that stems from priors and regularization instead of data.
    intervals : Intervals or None
        95 % intervals of all parameters, and how they were found.
    modal_fits : tuple of ModalFit
        One a record of modes.
    ratios : Ratios or None
        What remains where the data leave a common scale of masses and stiffnesses free.
    """

    estimate: Estimate
    fits: tuple[RecordFit, ...]
    prior_mean: FloatArray
    prior_std: FloatArray
    total_mass: float
    total_mass_std: float
    warnings: tuple[str, ...]
    held: tuple[Held, ...] = ()
    prior_share: FloatArray | None = None
    intervals: Intervals | None = None
    modal_fits: tuple[ModalFit, ...] = ()
    ratios: Ratios | None = None

    def seen_from(self, number: int) -> Identification:
        """The same with the record at position `number` (from 0) as the only one."""
        return replace(self, fits=(self.fits[number],))

    @property
    def first(self) -> RecordFit | ModalFit:
        """The first record: of responses, or of modes where there are no responses."""
        return self.fits[0] if self.fits else self.modal_fits[0]

    @property
    def structure(self) -> Structure:
        """Of the first record."""
        return self.first.problem.structure

    @property
    def parameters(self) -> Parameters:
        """Of the first record."""
        return self.first.problem.parameters

    @property
    def sensors(self) -> tuple[Dof, ...]:
        """Of the first record."""
        return self.fits[0].problem.record.outputs if self.fits else self.modal_fits[0].measured.channels

    @property
    def loads(self) -> tuple[Dof, ...]:
        """Of the first record; modes have none."""
        return self.fits[0].problem.record.inputs if self.fits else ()

    @property
    def problem(self) -> FrfProblem:
        return self.fits[0].problem

    @property
    def theta(self) -> FloatArray:
        """Free variables of `problem`'s own parameters."""
        return self.fits[0].theta

    @property
    def own_index(self) -> IntArray:
        """Positions of `parameters` among all."""
        names = self.estimate.names
        return np.array([names.index(name) for name in self.parameters.names], dtype=int)

    @property
    def measured(self) -> FrfRecord:
        return self.fits[0].measured

    @property
    def predicted_initial(self) -> ComplexArray:
        return self.fits[0].predicted_initial

    @property
    def predicted(self) -> ComplexArray:
        return self.fits[0].predicted

    @property
    def evaluation(self) -> FrfRecord:
        return self.fits[0].evaluation

    @property
    def evaluation_initial(self) -> ComplexArray:
        return self.fits[0].evaluation_initial

    @property
    def evaluation_predicted(self) -> ComplexArray:
        return self.fits[0].evaluation_predicted

    @property
    def modes_initial(self) -> Modes:
        return self.first.modes_initial

    @property
    def modes(self) -> Modes:
        return self.first.modes

    @property
    def resonances(self) -> tuple[Resonance, ...]:
        return self.fits[0].resonances if self.fits else ()

    @property
    def relative_error(self) -> FloatArray:
        """Of the first record, see `RecordFit.relative_error`."""
        return self.fits[0].relative_error


def _relative(predicted: ComplexArray, measured: ComplexArray) -> FloatArray:
    return np.abs(predicted - measured) / np.maximum(np.abs(measured), np.finfo(float).tiny)
