"""Every record as FRFs, which changes are screened on: as they are, averaged from histories, or made of measured modes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from structid.arrays import ComplexArray, FloatArray
from structid.identification.fits.modal_fit import paired_modes
from structid.identification.options import IdentifyOptions
from structid.identification.setups.setup import AnySetup
from structid.identification.setups.time import TimeSetup
from structid.observation import FrfProblem, ModalProblem, RecordProblem
from structid.records import FrfRecord

#: Of FRFs made of modes: error of each value, decay of the lines in parts of their frequency, lines, and loads.
_ERROR, _DECAY, _LINES, _LOADS = 0.02, 0.02, 90, 2


def views(
    setups: Sequence[AnySetup], problems: Sequence[RecordProblem], theta: Sequence[FloatArray], options: IdentifyOptions
) -> tuple[FrfProblem, ...]:
    """One problem of FRFs for each record.

    Parameters
    ----------
    setups, problems : sequences
        Of the study.
    theta : sequence of (n_own,) float arrays
        Free variables of each problem, at which measured modes are given a scale.
    options : IdentifyOptions
    """
    found = []
    for setup, problem, own in zip(setups, problems, theta, strict=True):
        if isinstance(problem, FrfProblem):
            found.append(problem)
        elif isinstance(setup, TimeSetup):
            found.append(setup.shown_problem(options, problem.channels))
        elif isinstance(problem, ModalProblem):
            found.append(modal_view(problem, own))
    return tuple(found)


def modal_view(problem: ModalProblem, theta: FloatArray) -> FrfProblem:
    """FRFs of measured modes, scaled to unit modal mass by the model's, with the model's own modes and entries where none was
    measured.

    Lines lie off the axis, where damping hardly counts. The loads are the channels that move most.
    """
    state, pairs = problem.model_state(problem.physical(theta)), paired_modes(problem, theta)
    seen, gains = state.sensors.T @ state.modes.mode_shapes, problem.readings(problem.physical(theta))[0][:, None]
    shapes, frequency = seen.copy(), state.modes.frequency.copy()
    given, like = problem.data.shapes[:, problem.data.measured], seen[:, pairs.number]
    known = ~np.isnan(given)
    given = np.where(known, given, 0.0)
    energy = np.einsum("cm,cm->m", given, given)
    size = np.einsum("cm,cm->m", given, like) / np.where(energy > 0, energy, 1.0)
    shapes[:, pairs.number] = np.where(known, given * size, like)
    frequency[pairs.number] = problem.data.frequency
    damping = np.full(len(frequency), 1e-3)
    damping[pairs.number] = np.maximum(pairs.damping_ratio, 0.0)
    kept = frequency > 0
    span = np.geomspace(0.7 * problem.data.frequency.min(), 1.15 * problem.data.frequency.max(), _LINES)
    lines = np.unique(np.concatenate([span, problem.data.frequency]))
    drive = np.sort(np.argsort(-np.abs(shapes[:, pairs.number]).max(axis=1))[:_LOADS])
    decay = _DECAY * 2 * np.pi * lines
    s = decay + 2j * np.pi * lines
    values = _synthesized(
        shapes[:, kept], (shapes / gains)[drive][:, kept], 2 * np.pi * frequency[kept], damping[kept], s
    )
    channels = problem.record.channels
    size_of_line = np.sqrt((np.abs(values) ** 2).mean(axis=(1, 2), keepdims=True))
    record = FrfRecord(
        lines, values, channels, tuple(channels[i] for i in drive), "receptance",
        variance=_ERROR**2 * (np.abs(values) ** 2 + (size_of_line / 5) ** 2),
        decay=decay, noise_source="declared",
    )  # fmt: skip
    errors = None if problem.channels is None else problem.channels.seen_by(record)
    return FrfProblem(problem.structure, problem.parameters, record, channels=errors)


def _synthesized(
    outputs: FloatArray, inputs: FloatArray, omega: FloatArray, damping: FloatArray, s: ComplexArray
) -> ComplexArray:
    """Sum over modes of unit modal mass, (n_lines, n_outputs, n_inputs)."""
    of_mode = 1 / (s[:, None] ** 2 + 2 * s[:, None] * damping * omega + omega**2)
    found: ComplexArray = np.einsum("om,lm,im->loi", outputs, of_mode, inputs)
    return found
