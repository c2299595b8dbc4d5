"""Identification from the time histories of a set-up themselves; averaged FRFs then only show the fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from structid.errors import InputError
from structid.estimation import Estimate, JointProblem, Problem
from structid.estimation.search.work import ALONE, StageProgress, Work
from structid.identification.search import RecordProblem, together
from structid.observation import FrfProblem, ModalProblem, SpectraProblem, TimeOptions, damped_stages
from structid.observation.time.identify_time import identify_time
from structid.observation.time.options import Hold, Initial, TimeMethod
from structid.records import TimeRecord
from structid.records.transforms.finite_spectra import finite_spectra

TimeWay = Literal["spectra", TimeMethod]


@dataclass(frozen=True, eq=False)
class TimeFit:
    """Forces and motions that are fitted themselves, and how.

    Parameters
    ----------
    record : TimeRecord or None
        With the noise variance of every channel. None while a study is read.
    fit : {"spectra", "output_error", "instrumental", "weak"}
        ``spectra``: finite Fourier transforms with their transient (see `SpectraProblem`); the others are the methods
        of `identify_time`.
    transient : bool
        Of ``spectra``; off for periodic records and those that start and end at rest.
    initial : {"rest", "unknown"}
        Of ``output_error`` and ``instrumental``: the state at the first sample.
    hold : {"first", "zero"}
        Of the same: between samples forces run straight, or stay.
    """

    record: TimeRecord | None
    fit: TimeWay = "spectra"
    transient: bool = True
    initial: Initial = "rest"
    hold: Hold = "first"

    @property
    def measured(self) -> TimeRecord:
        """The record.

        Raises
        ------
        InputError
            If there is none.
        """
        if self.record is None:
            raise InputError("`record` must be a time record, got None; give the histories that are to be fitted")
        return self.record


@dataclass(frozen=True, eq=False)
class StagedSpectra(SpectraProblem):
    """A `SpectraProblem` that knows the record which its ways to the answer start from."""

    record: TimeRecord | None = None

    def stage_plans(self) -> tuple[tuple[tuple[str, Problem], ...], ...]:
        """Ways to the answer; see `damped_stages`."""
        return () if self.record is None else damped_stages(self, self.record)


def target(
    problems: Sequence[RecordProblem], fits: Sequence[TimeFit | None], exclude: Sequence[tuple[float, float]] = ()
) -> Problem:
    """What is searched and judged: each FRF problem, or the finite spectra that its set-up asks for instead.

    Parameters
    ----------
    problems : sequence of FrfProblem or ModalProblem
        Whose lines give the band.
    fits : sequence of TimeFit or None
    exclude : sequence of (float, float)
        Stretches in Hz whose lines are left out.

    Raises
    ------
    InputError
        If channel errors are unknown in a set-up whose finite spectra are fitted.
    """
    if all(fit is None or fit.fit != "spectra" for fit in fits):
        return together(problems)
    pairs = zip(problems, fits, strict=True)
    made: list[Problem] = [p if fit is None else _spectra(p, fit, exclude) for p, fit in pairs]
    return made[0] if len(made) == 1 else JointProblem(tuple(made))


def _spectra(problem: RecordProblem, fit: TimeFit, exclude: Sequence[tuple[float, float]]) -> StagedSpectra:
    problem = _plain(problem)
    axis = problem.record.frequency
    spectra = finite_spectra(fit.measured, problem.record.inputs, band=(axis[0], axis[-1]))
    keep = np.ones(len(spectra.frequency), dtype=bool)
    for low, high in exclude:
        keep &= (spectra.frequency < low) | (spectra.frequency > high)
    return StagedSpectra(problem.structure, problem.parameters, spectra.lines(keep), fit.transient, record=fit.measured)


def _plain(problem: RecordProblem) -> FrfProblem:
    """The problem of averaged FRFs beside the histories, without errors of channels."""
    if isinstance(problem, ModalProblem):
        raise InputError("`time` must go with time histories, got modes; leave it out for this record")
    if problem.channels is not None:
        raise InputError(
            "errors of channels cannot be identified from the histories themselves; use [record.frf] for this record"
        )
    return problem


def time_estimate(
    problem: RecordProblem,
    fit: TimeFit,
    restarts: int,
    seed: int,
    work: Work = ALONE,
    progress: StageProgress | None = None,
) -> Estimate:
    """The estimate of `identify_time` by the method that the set-up asks for, which is not ``spectra``."""
    problem = _plain(problem)
    method = fit.fit
    if method == "spectra":
        raise InputError("`fit` must be a method of `identify_time`, got 'spectra'; see `target`")
    options = TimeOptions(method=method, force=fit.hold, initial=fit.initial, restarts=restarts, seed=seed)
    return identify_time(problem.structure, problem.parameters, fit.measured, options, work, progress)
