"""Every record as FRFs, which changes are screened on: as they are, averaged from histories, or made of measured modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, evenly_spaced_indices
from structid.diagnose.thresholds import (
    MODAL_VIEW_DECAY,
    MODAL_VIEW_ERROR,
    MODAL_VIEW_LINES,
    MODAL_VIEW_LOADS,
    NEAR_LINES,
)
from structid.forward import FrfProblem, ModalProblem, RecordProblem
from structid.forward.frf.continuation import LEVELS, smoothed_records
from structid.identification.modal_fit import damping_ratios, paired_modes
from structid.identification.options import IdentifyOptions
from structid.identification.setups.setup import AnySetup
from structid.records import FrfRecord

Values = TypeVar("Values", FloatArray, ComplexArray)


@dataclass(frozen=True, eq=False)
class FrfView:
    """A record as FRFs.

    Attributes
    ----------
    problem : FrfProblem
        FRF problem on the record's lines, without smoothing.
    smooth : dict of float to FrfRecord or None
        Smoothed data by their decay, as far as they were asked for; shared by views of the same data.
    chosen : (n,) float array, optional
        The frequencies of `near`, where they are known.
    """

    problem: FrfProblem
    smooth: dict[float, FrfRecord | None] = field(default_factory=dict)
    chosen: FloatArray | None = None

    def smoothed_at(self, level: float) -> FrfRecord | None:
        """FRFs of the record smoothed with a decay of `level` times the angular frequency; None if it cannot be done.

        That is where the lines of the record do not allow this decay, or the model has no modes. Made at the first
        call, then cached in `self.smooth`.
        """
        if level not in self.smooth:
            has_modes = self.problem.structure.has_modes
            known = dict(smoothed_records(self.problem.record, (level,))) if has_modes else {}
            self.smooth[level] = known.get(level)
        return self.smooth[level]

    @cached_property
    def near(self) -> FloatArray:
        """Frequencies in Hz, (n,), of the lines on which quick fits of changes are made.

        `self.chosen` if that is not None, else up to 300 lines of the record, evenly chosen.
        """
        if self.chosen is not None:
            return self.chosen
        frequency = self.problem.frequency
        return frequency[evenly_spaced_indices(len(frequency), NEAR_LINES)]

    def of(self, problem: RecordProblem) -> FrfView:
        """The view with the same data and quick-fit lines, and the structure, parameters and channel errors of `problem`."""
        channels = None if problem.channels is None else problem.channels.seen_by(self.problem.record)
        own = replace(self.problem, structure=problem.structure, parameters=problem.parameters, channels=channels)
        return FrfView(own, self.smooth, self.near)


def views(
    setups: Sequence[AnySetup], problems: Sequence[RecordProblem], theta: Sequence[FloatArray], options: IdentifyOptions
) -> tuple[FrfView, ...]:
    """Records of a study as FRFs, one view for each: as measured, averaged from histories, or synthesized from modes.

    Parameters
    ----------
    setups, problems : sequences
        Set-up and problem of each record.
    theta : sequence of (n_own,) float arrays
        Free variables of each problem, at which measured modes are scaled.
    options : IdentifyOptions
        Decide how histories are averaged. Histories that are not have no view.
    """
    found = []
    for setup, problem, own in zip(setups, problems, theta, strict=True):
        if isinstance(problem, FrfProblem):
            found.append(FrfView(problem))
        elif (shown := setup.shown_problem(options, problem.channels)) is not None:
            found.append(FrfView(shown))
        elif isinstance(problem, ModalProblem):
            found.append(modal_view(problem, own))
    return tuple(found)


def modal_view(problem: ModalProblem, theta: FloatArray) -> FrfView:
    """View of measured modes as FRFs with their stated errors, scaled to unit modal mass by the model's shapes.

    Modes and shape entries that were not measured are the model's. Damping that is not fitted is the model's, with
    errors as large as all that it does. Lines lie off the axis, where damping hardly counts, 90 from 0.7 to 1.15 times
    the measured frequencies and these; smoothed data are those of the same modes farther off. The loads are the two
    channels that move most. `theta` (n_params,) are the free variables of the model.
    """
    state, pairs = problem.model.state(problem.physical(theta)), paired_modes(problem, theta)
    seen, gains = state.seen, problem.model.readings(problem.physical(theta))[0][:, None]
    shapes, frequency = seen.copy(), state.modes.frequency.copy()
    given, like = problem.data.shapes[:, problem.data.measured], seen[:, pairs.number]
    known = ~np.isnan(given)
    given = np.where(known, given, 0.0)
    energy = np.einsum("cm,cm->m", given, given)
    size = np.einsum("cm,cm->m", given, like) / np.where(energy > 0, energy, 1.0)
    shapes[:, pairs.number] = np.where(known, given * size, like)
    frequency[pairs.number] = problem.data.frequency
    shape_std, frequency_std = np.zeros_like(shapes), np.zeros_like(frequency)
    stated = problem.data.shape_std[:, problem.data.measured]
    shape_std[:, pairs.number] = np.where(known, stated * np.abs(size), 0.0)
    frequency_std[pairs.number] = problem.data.frequency_std
    of_model = np.maximum(damping_ratios(state), 0.0)
    damping = np.zeros(len(frequency))
    if problem.settings.use_damping:
        measured = np.nan_to_num(problem.record.damping_ratio[problem.data.measured])
        damping[pairs.number] = np.where(of_model[pairs.number] > 0, measured, 0.0)
    likely = np.where(damping > 0, damping, of_model)
    kept = frequency > 0
    span = np.geomspace(0.7 * problem.data.frequency.min(), 1.15 * problem.data.frequency.max(), MODAL_VIEW_LINES)
    lines = np.unique(np.concatenate([span, problem.data.frequency]))
    channels = problem.record.channels
    drive = np.sort(np.argsort(-np.abs(shapes[:, pairs.number]).max(axis=1))[:MODAL_VIEW_LOADS])
    loads = tuple(channels[i] for i in drive)

    outputs, omega = shapes[:, kept], 2 * np.pi * frequency[kept]
    inputs, input_std = (shapes / gains)[drive][:, kept], (shape_std / gains)[drive][:, kept]
    output_std, omega_std = shape_std[:, kept], 2 * np.pi * frequency_std[kept]

    def record(level: float) -> FrfRecord:
        """FRFs of the modes, with variances, on lines whose decay is `level` times their angular frequency."""
        decay = level * 2 * np.pi * lines
        s = (decay + 2j * np.pi * lines)[:, None]
        of_mode, undamped = (1 / (s**2 + 2 * s * one[kept] * omega + omega**2) for one in (likely, damping))
        values = _synthesized(outputs, of_mode, inputs)
        size_of_line = np.sqrt((np.abs(values) ** 2).mean(axis=(1, 2), keepdims=True))
        power = np.abs(of_mode) ** 2
        variance = (
            MODAL_VIEW_ERROR**2 * (np.abs(values) ** 2 + (size_of_line / 5) ** 2)
            + np.abs(values - _synthesized(outputs, undamped, inputs)) ** 2
            + _synthesized(output_std**2, power, inputs**2)
            + _synthesized(outputs**2, power, input_std**2)
            + _synthesized(outputs**2, (2 * omega * omega_std * power) ** 2, inputs**2)
        )
        return FrfRecord(
            lines, values, channels, loads, "receptance", variance=variance, decay=decay, noise_source="declared"
        )

    near = record(MODAL_VIEW_DECAY)
    errors = None if problem.channels is None else problem.channels.seen_by(near)
    own = FrfProblem(problem.structure, problem.parameters, near, channels=errors)
    return FrfView(own, {level: record(level) if level > MODAL_VIEW_DECAY else near for level in LEVELS})


def _synthesized(outputs: FloatArray, of_mode: Values, inputs: FloatArray) -> Values:
    """Sum over modes of output (o, m), factor of every line (l, m) and input (i, m): (n_lines, n_outputs, n_inputs)."""
    found: Values = np.einsum("om,lm,im->loi", outputs, of_mode, inputs)
    return found
