"""What an identification gives: an estimate, and each record beside its model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib import import_module

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.display import Overview, Shown
from structid.core.dof import Dof
from structid.dynamics import Modes
from structid.fem import Structure
from structid.forward import FrfProblem, RecordProblem
from structid.identification.alternatives import Alternatives
from structid.identification.before.reduction import Truncation
from structid.identification.fits.missed import Missed
from structid.identification.fits.modal_fit import ModalFit
from structid.identification.fits.ratios import Ratios
from structid.identification.fits.record_fit import RecordFit
from structid.identification.fits.resonances import Resonance
from structid.identification.regularizing import Held
from structid.identification.together import places
from structid.identification.varying import Varied
from structid.inversion import Estimate, Problem
from structid.inversion.intervals.intervals import Intervals
from structid.plotting import IdentificationPlots
from structid.records import FrfRecord
from structid.unknowns import Parameters

#: Part of a variance from which on it is owed to priors, and of a direction's largest entry from which on a parameter is in it.
_MOSTLY, _TAKES_PART = 0.5, 0.1


@dataclass(frozen=True, eq=False, kw_only=True)
class Fits:
    """Each record beside the model; what is told of one record is told of the first.

    Attributes
    ----------
    fits : tuple of RecordFit
        One a record of responses.
    modal_fits : tuple of ModalFit
        One a record of modes.
    """

    fits: tuple[RecordFit, ...] = ()
    modal_fits: tuple[ModalFit, ...] = ()

    @property
    def first(self) -> RecordFit | ModalFit:
        """The first record: of responses, or of modes where there are no responses."""
        return self.fits[0] if self.fits else self.modal_fits[0]

    @property
    def structure(self) -> Structure:
        return self.first.problem.structure

    @property
    def parameters(self) -> Parameters:
        return self.first.problem.parameters

    @property
    def sensors(self) -> tuple[Dof, ...]:
        return self.fits[0].problem.record.outputs if self.fits else self.modal_fits[0].measured.channels

    @property
    def loads(self) -> tuple[Dof, ...]:
        """Modes have none."""
        return self.fits[0].problem.record.inputs if self.fits else ()

    @property
    def modes_initial(self) -> Modes:
        return self.first.modes_initial

    @property
    def modes(self) -> Modes:
        return self.first.modes

    @property
    def problem(self) -> FrfProblem:
        return self.fits[0].problem

    @property
    def measured(self) -> FrfRecord:
        """All lines of the first record of responses."""
        return self.fits[0].measured

    @property
    def evaluation(self) -> FrfRecord:
        """Those on which the fit is judged."""
        return self.fits[0].evaluation

    @property
    def relative_error(self) -> FloatArray:
        """See `RecordFit.relative_error`."""
        return self.fits[0].relative_error

    @property
    def resonances(self) -> tuple[Resonance, ...]:
        return self.fits[0].resonances if self.fits else ()


@dataclass(frozen=True, eq=False, kw_only=True)
class Known:
    """What was known of the parameters beside the data.

    Attributes
    ----------
    prior_mean, prior_std : (n_params,) float arrays
        Own prior of each parameter, physical units; NaN where there is none.
    prior_share : (n_params,) float array or None
        Part of each parameter's variance that stems from priors and regularization instead of data; None of a
        matrix-free search.
    held : tuple of Held
        Regularizations and their strengths.
    varied : tuple of Varied
        What differs from record to record, and by how much.
    """

    prior_mean: FloatArray
    prior_std: FloatArray
    prior_share: FloatArray | None = None
    held: tuple[Held, ...] = ()
    varied: tuple[Varied, ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class Scale:
    """What is known of the common scale of masses and stiffnesses.

    Attributes
    ----------
    total_mass, total_mass_std : float
        Of the first set-up's structure, kg; NaN where the structure has no mass property in kg.
    ratios : Ratios or None
        What remains where the data leave the scale free.
    rests_on_force : bool
        Whether it is the force's alone; see `ratios.rests_on_force`.
    """

    total_mass: float
    total_mass_std: float
    ratios: Ratios | None = None
    rests_on_force: bool = False


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Identification(Shown, IdentificationPlots, Scale, Known, Fits):
    """An estimate with what it was made from and what it predicts; see `Fits`, `Known` and `Scale` for its parts.

    Attributes
    ----------
    estimate : Estimate
        Of all parameters: those of the structure, then those of the records' channels.
    problems : tuple of RecordProblem
        Of each record, with the polarities that were found.
    target : Problem or None
        What was minimized; None by an estimator of time histories that minimizes nothing of many records.
    warnings : tuple of str
        What the reader should know first.
    intervals : Intervals
        95 % intervals of all parameters, and how they were found.
    ran_away : tuple of int
        Positions of parameters that ended far from their starts for no reason; see `warning_words.ran_away`.
    truncations : tuple of Truncation
        What reduction of components changes at the answer, as each record sees it.
    missed : tuple of Missed
        Records, or kinds of values of modes, that the answer misses beyond their errors, the worst first.
    freed : tuple of RecordProblem
        The problems with what their models hold among the unknowns, within its tolerances; () where that is taken as exact.
    alternatives : Alternatives or None
        Sets of values that fit the data equally well; None where one only was found.
    mesh : str
        Into how many pieces beams were cut by what the mesh moves values by, in words; "" where the study says the number.
    """

    estimate: Estimate
    problems: tuple[RecordProblem, ...]
    target: Problem | None
    warnings: tuple[str, ...]
    intervals: Intervals
    ran_away: tuple[int, ...] = ()
    truncations: tuple[Truncation, ...] = ()
    missed: tuple[Missed, ...] = ()
    freed: tuple[RecordProblem, ...] = ()
    alternatives: Alternatives | None = None
    mesh: str = ""

    @property
    def assumption(self) -> str:
        """What standard deviations and intervals allow the model's values to be wrong by, and how its mesh was chosen, in words."""
        return "; ".join(words for words in (self._assumed, self.mesh) if words)

    @property
    def _assumed(self) -> str:
        fixed = self.estimate.fixed
        if fixed is not None:
            return f"± includes {fixed.words}"
        can_tell = self.target is not None and self.estimate.uncertainty.has_matrix
        return "± takes what the model holds as exact" + (
            "" if can_tell else ": this search does not tell what it changes"
        )

    def overview(self) -> Overview:
        """What its estimate shows."""
        return self.estimate.overview()

    def summary(self) -> str:
        """Verdict, next step, and a row for each parameter: what `print` shows."""
        view: Shown = import_module("structid.study.results.view").results_view(self)
        return view.summary()

    @property
    def listed(self) -> tuple[int, ...]:
        """Positions of all parameters but the values that single records have of what varies."""
        own = {name for one in self.varied for name in one.own}
        return tuple(i for i, name in enumerate(self.estimate.names) if name not in own)

    def seen_from(self, number: int) -> Identification:
        """The same with the record of responses at position `number` (from 0) as the only one."""
        return replace(self, fits=(self.fits[number],))

    @property
    def by_prior(self) -> tuple[int, ...]:
        """Positions of the parameters that their own priors tell more of than the data, alone or in an unseen combination."""
        if self.prior_share is None:
            return ()
        is_open = np.zeros(len(self.prior_share), dtype=bool)
        for direction in self.estimate.identifiability.directions:
            size = np.abs(direction.vector)
            is_open |= size > _TAKES_PART * size.max()
        is_by_prior = np.isfinite(self.prior_std) & ((self.prior_share > _MOSTLY) | is_open)
        return tuple(np.flatnonzero(is_by_prior).tolist())

    @property
    def own_index(self) -> IntArray:
        """Positions of `parameters` among all."""
        return places(self.estimate.names, self.parameters.names)
