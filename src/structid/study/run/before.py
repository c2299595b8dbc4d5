"""Checks of a study's model and records before anything is fitted: mesh, resonances, samples, windows, coherence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.core.arrays import FloatArray
from structid.diagnose.checks.aligned_responses import ResonancePair
from structid.diagnose.checks.initial_comparison import InitialComparison
from structid.dynamics import Modes
from structid.forward import RecordProblem
from structid.identification.fits.resonances import LEAST_DAMPING
from structid.identification.setups.setup import AnySetup
from structid.inversion.averaging import expected_square
from structid.records import FrfRecord, TimeRecord
from structid.records.quality.signal_checks import signal_checks
from structid.records.quality.spectral_checks import drifts
from structid.records.quality.window_checks import leakage
from structid.study.schema.records.record import RecordSource, read_histories

#: Part of its frequency within which a mode that shows no peak may belong to a measured one.
_HIDDEN = 0.1
#: Averages from which on the chi-square that their coherence leads to is not worth a word.
_MANY = 100


@dataclass(frozen=True)
class ResonanceCheck(ResonancePair):
    """A pair, and how far apart it is.

    Attributes
    ----------
    half_bandwidths : float
        How far the model is above, by the model's damping; NaN where it has none.
    """

    half_bandwidths: float


@dataclass(frozen=True, eq=False)
class RecordCheck:
    """One record beside its model, before a fit.

    Attributes
    ----------
    title : str
    resonances : tuple of ResonanceCheck
    warnings : tuple of str
        Of samples and windows.
    facts : tuple of str
    """

    title: str
    resonances: tuple[ResonanceCheck, ...]
    warnings: tuple[str, ...]
    facts: tuple[str, ...]


def checked_record(
    title: str,
    source: RecordSource,
    setup: AnySetup,
    problem: RecordProblem,
    comparison: InitialComparison,
    modes: Modes,
) -> RecordCheck:
    """The checks of one record before a fit: resonances beside the model's, warnings on signals and windows, and remarks.

    Parameters
    ----------
    title : str
        Name that messages about the record begin with.
    source : RecordSource
        The record's tables in the study file, from which its files are read again.
    setup : RecordSetup
        Structure, parameters and record.
    problem : RecordProblem
        Problem of the lines in the band.
    comparison : InitialComparison
        Measured resonances paired with those of the initial model.
    modes : Modes
        Modes of the initial model.
    """
    warnings: list[str] = []
    histories = read_histories(source)
    for record in histories:
        found = [one for one in signal_checks(record) if one.severity != "note"]
        slow = drifts(record) if not any(one.kind == "short" for one in found) else ()
        warnings += [one.words for one in (*found, *slow)]
    warnings += leaking_windows(source, histories, problem, modes)
    lost = setup.truncation(problem, problem.theta_start)
    warnings += [lost.warning] if lost is not None and lost.warning else []
    reduced = () if lost is None else (*(one.words for one in setup.structure.reductions), lost.words)
    read = tuple(f"read: {record.source}" for record in histories if "; " in record.source)
    return RecordCheck(title, _resonances(comparison, modes), tuple(warnings), (*read, *reduced, *_facts(setup)))


def _resonances(comparison: InitialComparison, modes: Modes) -> tuple[ResonanceCheck, ...]:
    """Each measured resonance (Hz) with that of the model, the MAC, and their distance in half-bandwidths.

    Where the model has no peak between lines, the nearest mode without another partner is taken. NaN where there is none.
    """
    free = np.ones(len(modes.frequency), dtype=bool)
    for pair in comparison.resonances:
        if free.size and np.isfinite(pair.model):
            free[np.abs(modes.frequency - pair.model).argmin()] = False
    checks = []
    for pair in comparison.resonances:
        model, distance = pair.model, float("nan")
        distances = np.abs(modes.frequency - (pair.measured if np.isnan(model) else model))
        if np.isnan(model):
            distances = np.where(free & (distances <= _HIDDEN * pair.measured), distances, np.inf)
        nearest = int(distances.argmin()) if distances.size else -1
        if nearest >= 0 and np.isfinite(distances[nearest]):
            if np.isnan(model):
                model, free[nearest] = float(modes.frequency[nearest]), False
            damping = float(modes.damping_ratio[nearest])
            if damping > 0:
                distance = (model - pair.measured) / (max(damping, LEAST_DAMPING) * model)
        checks.append(ResonanceCheck(pair.measured, model, pair.mac, distance))
    return tuple(checks)


def _facts(setup: AnySetup) -> tuple[str, ...]:
    """A remark on the noise or the chi-square if coherence was estimated from few averages; an empty tuple otherwise."""
    record = setup.record
    if not isinstance(record, FrfRecord) or record.noise_source != "coherence" or not record.averages:
        return ()
    n = record.averages
    if n > _MANY:
        return ()
    if n <= 2:
        return (f"coherence from {n} averages does not tell the noise; state it in [record.noise]",)
    expected = float(expected_square(n))
    return (
        f"coherence from {n} averages: a chi-square of {expected:.3g} per degree of freedom is expected where all is right",
    )


def leaking_windows(
    source: RecordSource, histories: list[TimeRecord], problem: RecordProblem, modes: Modes
) -> list[str]:
    """At most one warning, if the window of averaged spectra blurs resonances in the band; an empty list for other records.

    `histories` are the time records from which the spectra were averaged, `modes` those of the initial model.
    """
    if source.frf is None or source.time is not None or not histories:
        return []
    settings = source.frf.others
    length = settings.get("segment_length") or len(histories[0].values)
    window = settings.get("window", "hann")
    axis: FloatArray = problem.frequency
    in_band = (modes.frequency >= axis[0]) & (modes.frequency <= axis[-1])
    words = leakage(histories[0], length, window, modes.frequency[in_band], modes.damping_ratio[in_band])
    return [words] if words else []
