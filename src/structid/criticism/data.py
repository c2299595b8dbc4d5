"""Data that do not go with the rest: a channel, lines or a whole record whose errors are larger than stated."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from scipy import ndimage

from structid.core.arrays import FloatArray
from structid.criticism.candidate import Candidate
from structid.forward import FrfProblem, ModalProblem, RecordProblem, SpectraProblem

#: A line is outlying where its misfit is so many times that of the lines about it.
_OUTLYING = 8.0
_ABOUT = 21
#: Lines side by side; more of them are a resonance that the model misses.
_LONGEST = 3
_FEWEST_MODES = 2
#: Tones in one look, and lines beside one at which the square of it times less of its misfit is left, at most.
_LOUDEST, _SKIRT = 6, 4


def scaled_misfit(squares: float, n_rows: int) -> float:
    """Twice the negative logarithm of the likelihood of rows whose errors are larger by one factor, the likeliest, less a constant.

    Rows as stated have `squares` instead; one parameter is the price of the factor.
    """
    return float(n_rows * (1 + np.log(squares / n_rows))) if squares > n_rows > 0 else squares


def data_candidates(problems: Sequence[RecordProblem], names: Sequence[str]) -> Iterator[Candidate]:
    """Channels and records that may be left out.

    Parameters
    ----------
    problems : sequence of RecordProblem
    names : sequence of str
        Of the records.
    """
    for number, problem in enumerate(problems):
        if len(problems) > 1:
            yield Candidate("record", (names[number],), record=number)
        if isinstance(problem, FrfProblem):
            outputs = tuple(dof.place for dof in problem.record.outputs)
            if len(outputs) > 1:
                for name in outputs:
                    others = tuple(one for one in outputs if one != name)
                    yield Candidate("channel", (name,), record=number, others=others)


def outlying_lines(problems: Sequence[RecordProblem], residual: FloatArray) -> Iterator[Candidate]:
    """Lines of every record of FRFs that stand out, all of a record in one candidate.

    Parameters
    ----------
    problems : sequence of RecordProblem
        With all their lines.
    residual : (n_rows,) float array
        Whitened data rows of all.
    """
    first = 0
    for number, problem in enumerate(problems):
        own = residual[first : first + problem.n_data]
        first += problem.n_data
        spans = outlying(problem, own) if isinstance(problem, FrfProblem) else ()
        if spans:
            yield Candidate("outlying_lines", spans, record=number)
        heard = tones(problem, own) if isinstance(problem, SpectraProblem) else ()
        if heard:
            yield Candidate("tone", heard, record=number)


def misfit_of_lines(problem: RecordProblem, residual: FloatArray) -> FloatArray:
    """Mean square of the whitened data rows (n_data,) of each line, (n_lines,)."""
    count = np.bincount(problem.rows.lines, minlength=len(problem.frequency))
    found: FloatArray = np.bincount(problem.rows.lines, residual**2, len(problem.frequency)) / np.maximum(count, 1)
    return found


def outlying(problem: FrfProblem, residual: FloatArray) -> tuple[str, ...]:
    """Spans of lines whose misfit stands out from those about them, as ``49.8 to 50.2 Hz``; none where they are many."""
    frequency = problem.frequency
    size = misfit_of_lines(problem, residual)
    level = np.maximum(ndimage.median_filter(size, _ABOUT, mode="nearest"), 1.0)
    out = np.flatnonzero(size > _OUTLYING * level)
    if not 0 < len(out) <= max(3, len(frequency) // 10):
        return ()
    runs = [run for run in np.split(out, np.flatnonzero(np.diff(out) > 1) + 1) if len(run) <= _LONGEST]
    if not runs:
        return ()
    edges = np.concatenate([[2 * frequency[0] - frequency[1]], frequency, [2 * frequency[-1] - frequency[-2]]])
    middles = np.array([(a + b) / 2 for a, b in pairwise(edges)])
    return tuple(f"{middles[run[0]]:.5g} to {middles[run[-1] + 1]:.5g} Hz" for run in runs)


def tones(problem: SpectraProblem, residual: FloatArray) -> tuple[str, ...]:
    """Steady tones in the misfit of a record, as ``50.003 Hz``: its lines fall off from a peak as 1 / (f - f0)^2.

    The two lines about a tone have amplitudes in inverse proportion to their distances from it.
    """
    frequency, size = problem.frequency, misfit_of_lines(problem, residual)
    level = np.maximum(ndimage.median_filter(size, _ABOUT, mode="nearest"), 1.0)
    peaks = np.flatnonzero((size == ndimage.maximum_filter(size, 2 * _SKIRT + 1)) & (size > _OUTLYING * level))
    found = []
    for k in peaks[np.argsort(-size[peaks])][:_LOUDEST].tolist():
        if max(size[max(k - _SKIRT, 0)], size[min(k + _SKIRT, len(size) - 1)]) > size[k] / _SKIRT**2:
            continue
        near = k + 1 if k == 0 or (k + 1 < len(size) and size[k + 1] > size[k - 1]) else k - 1
        weights = np.sqrt(size[[k, near]])
        found.append(float(weights @ frequency[[k, near]] / weights.sum()))
    return tuple(f"{value:.7g} Hz" for value in sorted(found))


def changed_rows(candidate: Candidate, problems: Sequence[RecordProblem]) -> np.ndarray:
    """Which data rows of all problems a candidate leaves out, (n_rows,) bool."""
    parts = []
    for number, problem in enumerate(problems):
        taken = np.zeros(problem.n_data, dtype=bool)
        if number != candidate.record:
            parts.append(taken)
            continue
        if candidate.kind == "record":
            taken[:] = True
        elif candidate.kind == "channel":
            channels = [name.split("/")[0].removeprefix("shape at ").rstrip("+-") for name in problem.rows.names]
            is_it = np.array([channel == candidate.where[0] for channel in channels])
            taken = is_it[np.unique(problem.rows.series, return_inverse=True)[1]]
        elif candidate.kind == "extra_mode":
            taken = problem.rows.lines == int(candidate.detail["mode"])
        else:
            for where in candidate.where:
                low, high = (float(text) for text in where.removesuffix(" Hz").split(" to "))
                taken |= ((problem.frequency >= low) & (problem.frequency <= high))[problem.rows.lines]
        parts.append(taken)
    return np.concatenate(parts)


def extra_modes(problems: Sequence[RecordProblem]) -> Iterator[Candidate]:
    """Each mode of records of modes, as one that is none of this structure."""
    for number, problem in enumerate(problems):
        if isinstance(problem, ModalProblem) and len(problem.data.measured) > _FEWEST_MODES:
            used = tuple(str(mode + 1) for mode in problem.data.measured.tolist())
            for mode in problem.data.measured.tolist():
                where = (f"{problem.record.frequency[mode]:.5g} Hz",)
                others = tuple(one for one in used if one != str(mode + 1))
                yield Candidate("extra_mode", where, record=number, others=others, detail={"mode": float(mode)})


DATA_KINDS = ("channel", "outlying_lines", "record", "extra_mode")
