"""A record beside the initial model whose resonances are drawn onto the measured ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.forward import FrfProblem
from structid.identification.record_fit import peaks
from structid.records import FrfRecord
from structid.records.record import DERIVATIVES
from structid.similarity import mac

#: Cost of a resonance without a partner, and of a pair whose shapes differ wholly; both in the logarithm of frequency.
_ALONE, _UNLIKE = 0.25, 0.3
#: Common factors of all frequencies that are tried, as logarithms, and what they cost.
_SHIFTS, _COMMON = sorted(np.linspace(-0.7, 0.7, 15).tolist(), key=abs), 0.5
#: Lines that channels are looked at on, and standard deviations that a value has to be above its noise.
_MOST_LINES, _CLEAR = 400, 3.0
#: Clear lines that an FRF has at least to tell of its sensor, and how small it is at least beside others of that sensor and load.
_FEWEST_LINES, _CANCELS = 10, 0.4
#: Part of the largest response below which the model's is nothing but rounding.
_SILENT = 1e-12


@dataclass(frozen=True)
class ResonancePair:
    """A measured resonance and that of the initial model, in order.

    Attributes
    ----------
    measured, model : float
        Hz; NaN where one has no match.
    mac : float
        MAC of the two shapes at sensors and loads; NaN where one is missing.
    """

    measured: float
    model: float
    mac: float


@dataclass(frozen=True, eq=False)
class AlignedFrf:
    """Measured FRFs in parts of the model's, resonance upon resonance.

    Attributes
    ----------
    record : FrfRecord
        Some of its lines.
    pairs : tuple of ResonancePair
    model : (n_lines, n_outputs, n_inputs) complex array
        Accelerances of the model, each line taken from the model's frequency that belongs to it.
    measured : the same
        Accelerances; NaN where noise hides them, or where the model's are nil, as at sensors that no load moves.
    """

    record: FrfRecord
    pairs: tuple[ResonancePair, ...]
    model: ComplexArray
    measured: ComplexArray

    @property
    def level(self) -> FloatArray:
        """Logarithm of measured over modelled magnitude, median over lines, (n_outputs, n_inputs); NaN without any."""
        size = np.abs(self.measured) / np.maximum(np.abs(self.model), np.finfo(float).tiny)
        return median(np.log(np.maximum(size, np.finfo(float).tiny)), 0)

    @property
    def accord(self) -> FloatArray:
        """Mean cosine of the phase angle between measured and model, (n_outputs, n_inputs); 1 in phase, -1 if reversed."""
        return accord(self.measured, self.model)


def accord(measured: ComplexArray, model: ComplexArray) -> FloatArray:
    """Cosine of the phase angle between `measured` and `model` (n_lines, ...), averaged over the lines, (...).

    NaN in either array leaves that line out; NaN where no line is left.
    """
    product = measured * model.conj()
    cosine = product.real / np.maximum(np.abs(product), np.finfo(float).tiny)
    count = (~np.isnan(cosine)).sum(axis=0)
    found: FloatArray = np.where(count > 0, np.nansum(cosine, axis=0) / np.maximum(count, 1), np.nan)
    return found


def median(values: FloatArray, axis: int) -> FloatArray:
    """Median of `values` (any shape) along `axis`, which is dropped; NaN values are left out, NaN where all are NaN."""
    moved = np.moveaxis(values, axis, 0)
    flat = moved.reshape(len(moved), -1)
    found: FloatArray = np.full(flat.shape[1], np.nan)
    some = ~np.isnan(flat).all(axis=0)
    found[some] = np.nanmedian(flat[:, some], axis=0)
    return found.reshape(moved.shape[1:])


def aligned(problem: FrfProblem, predicted: ComplexArray) -> AlignedFrf:
    """Measured and modelled FRFs with the model's frequency axis warped so that their resonances coincide.

    The magnitudes then differ by the level of the mass lines between resonances, which does not depend on stiffness,
    and by the gains of the channels. At most 400 lines above 0 Hz are used.

    Parameters
    ----------
    problem : FrfProblem
        The record, and the model at its start values.
    predicted : (n_lines, n_outputs, n_inputs) complex array
        FRFs of the initial model on the problem's lines.

    Returns
    -------
    AlignedFrf
        Both as accelerances on the record's lines; measured values are NaN where they are below three standard
        deviations of the noise, where the model is silent, or where an FRF cannot judge its sensor. Without a pair of
        resonances the axis is not warped.
    """
    record = problem.record
    pairs = resonance_pairs(record, predicted)
    both = [(pair.measured, pair.model) for pair in pairs if np.isfinite(pair.measured) and np.isfinite(pair.model)]
    keep = np.flatnonzero(record.frequency > 0)
    if len(keep) > _MOST_LINES:
        keep = keep[np.linspace(0, len(keep) - 1, _MOST_LINES).round().astype(int)]
    if not len(keep):
        empty: ComplexArray = np.zeros((0, *record.values.shape[1:]), complex)
        return AlignedFrf(record, pairs, empty, empty)
    used = record.lines(keep)
    axis = used.frequency
    if both:
        measured_peaks, model_peaks = np.array(both).T
        axis = axis * np.exp(np.interp(np.log(axis), np.log(measured_peaks), np.log(model_peaks / measured_peaks)))
        bent = replace(used, frequency=axis)
        if not problem.structure.has_modes:  # parts of it are known at lines alone; between them is close enough
            found = _interpolate(axis, record.frequency, predicted)
        else:
            found = problem.predicted_on(bent, problem.physical(np.asarray(problem.theta_start)))
    else:
        bent, found = used, predicted[keep]
    power = DERIVATIVES["accelerance"] - DERIVATIVES[record.kind]
    model = found * (bent.laplace**power)[:, None, None]
    measured = used.values * (used.laplace**power)[:, None, None]
    if used.variance is not None:
        measured = np.where(np.abs(used.values) > _CLEAR * np.sqrt(used.variance), measured, np.nan)
    measured = np.where(np.abs(model) > _SILENT * np.abs(model).max(initial=0.0), measured, np.nan)
    return AlignedFrf(used, pairs, model, np.where(_can_judge(model, measured), measured, np.nan))


def _can_judge(model: ComplexArray, measured: ComplexArray) -> np.ndarray:
    """Mask (n_outputs, n_inputs) of FRFs that can judge their sensor: enough clear lines, and no strong cancellation.

    Both FRFs are (n_lines, n_outputs, n_inputs), `measured` with NaN on lines that are not clear. Ten clear lines are
    enough, or all if there are fewer. An FRF below 0.4 of what its row and column suggest is a small difference of
    large terms, which any error of the start values changes completely; this is judged only with two outputs and two
    inputs or more.
    """
    clear = np.isfinite(measured).sum(axis=0)
    enough: np.ndarray = clear >= min(_FEWEST_LINES, len(measured))
    size = np.where(clear > 0, np.median(np.abs(model), axis=0), np.nan)
    if min(size.shape) < 2 or np.isnan(size).all(axis=0).any() or np.isnan(size).all(axis=1).any():
        return enough
    size = np.log(np.maximum(size, np.finfo(float).tiny))
    beside = size - np.nanmean(size, axis=0) - np.nanmean(size, axis=1)[:, None] + np.nanmean(size)
    return enough & ~(beside < np.log(_CANCELS))


def _interpolate(wanted: FloatArray, frequency: FloatArray, values: ComplexArray) -> ComplexArray:
    """FRFs at the frequencies `wanted` (Hz), interpolated linearly from `values` at the ascending lines `frequency` (Hz).

    The lines are the first axis of `values`; beyond the first and last line the values there are kept.
    """
    after = np.clip(np.searchsorted(frequency, wanted), 1, len(frequency) - 1)
    part = np.clip((wanted - frequency[after - 1]) / (frequency[after] - frequency[after - 1]), 0, 1)[:, None, None]
    interpolated: ComplexArray = (1 - part) * values[after - 1] + part * values[after]
    return interpolated


def resonance_pairs(record: FrfRecord, predicted: ComplexArray) -> tuple[ResonancePair, ...]:
    """Peaks of a record and of a model on its lines, paired in order by frequency and shape, sorted by frequency.

    Each pair has the two frequencies, Hz, and the MAC of the shapes; a peak without a partner has NaN for the rest. The
    pairing has the least total cost of distances in log frequency, after a common shift that costs half of itself, and
    0.3 (1 - MAC); a peak alone costs 0.25. `predicted` (n_lines, n_outputs, n_inputs) are the model's FRFs.
    """
    (f, own), (g, other) = (_shapes(record, values) for values in (record.values, predicted))
    likeness = np.nan_to_num(mac(own.T, other.T)) if len(f) and len(g) else np.zeros((len(f), len(g)))
    apart = np.log(f)[:, None] - np.log(g)
    ways = [
        in_order(np.abs(apart - shift) + _UNLIKE * (1 - likeness), _ALONE, _COMMON * abs(shift)) for shift in _SHIFTS
    ]
    pairs, _ = min(ways, key=lambda way: way[1])
    return tuple(
        ResonancePair(
            float(f[i]) if i is not None else float("nan"),
            float(g[j]) if j is not None else float("nan"),
            float(likeness[i, j]) if i is not None and j is not None else float("nan"),
        )
        for i, j in pairs
    )


def _shapes(record: FrfRecord, values: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Peak frequencies (n_peaks,) in Hz of FRFs, and their quadrature parts there (n_peaks, n_frfs).

    `values` (n_lines, n_outputs, n_inputs) are FRFs on the lines of `record`. The quadrature part is the imaginary one, of
    mobilities the real one.
    """
    peak_frequencies = peaks(record.frequency, values, record.kind)
    near = np.abs(record.frequency[:, None] - peak_frequencies).argmin(axis=0)
    part = values.real if record.kind == "mobility" else values.imag
    return peak_frequencies, part[near].reshape(len(peak_frequencies), values[0].size)


def in_order(
    cost: FloatArray, unpaired_cost: float, initial_cost: float = 0.0
) -> tuple[Sequence[tuple[int | None, int | None]], float]:
    """Cheapest pairing of two sequences that keeps their order: pairs of indices (None where unpaired), and its cost.

    Parameters
    ----------
    cost : (n, m) float array
        Cost of pairing each item of the first with each of the second sequence.
    unpaired_cost : float
        Cost of each item that is left without a partner.
    initial_cost : float
        Cost added to the total of every pairing.

    References
    ----------
    Needleman and Wunsch (1970), J. Mol. Biol. 48, 443-453.
    """
    n, m = cost.shape
    total = np.zeros((n + 1, m + 1))
    total[:, 0], total[0] = (
        initial_cost + unpaired_cost * np.arange(n + 1),
        initial_cost + unpaired_cost * np.arange(m + 1),
    )
    for i in range(n):
        for j in range(m):
            total[i + 1, j + 1] = min(
                total[i, j] + cost[i, j], total[i, j + 1] + unpaired_cost, total[i + 1, j] + unpaired_cost
            )
    i, j = n, m
    pairs: list[tuple[int | None, int | None]] = []
    while i or j:
        if i and j and total[i, j] == total[i - 1, j - 1] + cost[i - 1, j - 1]:
            i, j = i - 1, j - 1
            pairs.append((i, j))
        elif i and total[i, j] == total[i - 1, j] + unpaired_cost:
            i -= 1
            pairs.append((i, None))
        else:
            j -= 1
            pairs.append((None, j))
    return pairs[::-1], float(total[n, m])
