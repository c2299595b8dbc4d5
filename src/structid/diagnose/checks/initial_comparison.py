"""Records beside their initial models before a fit: responses with frequencies aligned, and what channels then show.

Where a frequency axis is warped so that resonances lie on each other, phases and sizes tell channels that are reversed, swapped,
scaled or misplaced.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.dof import Dof
from structid.core.errors import SingularModelError
from structid.core.units import ACCELERATION_KINDS, MISTAKEN_FORCES, STANDARD_GRAVITY, mistaken_motions, mistaken_unit
from structid.forward import FrfProblem, RecordProblem
from structid.forward.modal import compares_modes
from structid.identification.options import IdentifyOptions
from structid.identification.record_fit import peaks
from structid.identification.setups.setup import AnySetup
from structid.records import FrfRecord
from structid.records.record import DERIVATIVES
from structid.similarity import mac

if TYPE_CHECKING:
    from structid.forward import ModalProblem


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


#: Accord that the others must reach, and well; below which a channel is reversed, or fits far worse than the others.
_GOES, _GOES_WELL, _TURNED, _APART = 0.7, 0.9, -0.4, 0.4
#: Factors, as logarithms: by which a channel may be off, and beyond which its level, and its unit, is wrong.
_ABOUT_ONE, _LEVEL, _FAR = np.log(1.7), np.log(2.5), np.log(3.0)
#: Factor of all channels that is told, as a logarithm: where all sensors agree on it within so much, and where they differ.
_SHARED, _ALIKE, _SHARED_BY_MOST = np.log(1.6), 0.25, np.log(2.5)
#: Sensors that can agree, accord that they must reach, and part of the resonances with a like; that where loads agree on far more.
_FEWEST, _AGREE, _PAIRED, _PAIRED_IF_FAR = 3, 0.85, 0.6, 0.5
#: How far from a unit's factor a level may be, as a logarithm.
_NEAR = 0.35
#: Powers of ten from which on units differ, and how near they must be.
_DECADES, _NEAR_DECADE = 2, 0.2
_SUPPORT_REMEDY, _LOAD_REMEDY = "check the sensitivity and unit of its sensor", "check the load cell's sensitivity"
#: What reciprocity may miss by, and standard errors of that.
_RECIPROCAL, _ERRORS = 0.05, 6.0


class ChannelWarnings(NamedTuple):
    """Warnings on the channels of a record: on all or on loads, on sensors, and on pairs of degrees of freedom.

    Those of sensors, also that of a support that drives, are false where the model comes to explain the record as it is.
    """

    of_loads: tuple[str, ...] = ()
    of_sensors: tuple[str, ...] = ()
    of_pairs: tuple[str, ...] = ()

    @property
    def words(self) -> tuple[str, ...]:
        """All warnings, the gravest first."""
        return (*self.of_loads, *self.of_sensors, *self.of_pairs)


def channel_warnings(comparison: AlignedFrf) -> ChannelWarnings:
    """Warnings about channels of a record, from its comparison with the initial model and from reciprocity of the record.

    They are of loads, of sensors and of pairs. Of FRFs per motion of a support those of loads count as warnings of
    sensors. Where no FRF can be compared, only those of reciprocity are given.
    """
    record, level, agreement = comparison.record, comparison.level, comparison.accord
    of_pairs = tuple(_reciprocity(record))
    if not np.isfinite(level).any():
        return ChannelWarnings(of_pairs=of_pairs)
    of_loads = (*_whole_record(comparison, level, agreement), *_single_loads(record, level, agreement))
    of_sensors = tuple(_sensors(comparison, level, agreement))
    if record.is_per_motion:
        return ChannelWarnings((), (*of_loads, *of_sensors), of_pairs)
    return ChannelWarnings(of_loads, of_sensors, of_pairs)


def _whole_record(comparison: AlignedFrf, level: FloatArray, agreement: FloatArray) -> Iterator[str]:
    """Sentences on a factor or a sign that all channels share; a power of ten in units excludes further ones.

    `level` is the logarithm of measured over modelled magnitude, `agreement` the mean cosine of their phase angle, both
    (n_outputs, n_inputs). A power of ten is 100 or more, or 1/100 or less. A smaller factor is stated only where the
    loads agree on it, the phases fit and most resonances have a partner. None otherwise. `comparison` has the record
    and the paired resonances.
    """
    record = comparison.record
    common, goes = float(np.nanmedian(level)), float(np.nanmedian(agreement))
    measured_level = (
        f"the measured {record.kind} is {np.exp(common):.3g} times the initial model's (median over lines and channels,"
        " resonance upon resonance)"
    )
    decades = common / np.log(10)
    nearest = round(decades)
    if abs(nearest) >= _DECADES and abs(decades - nearest) <= _NEAR_DECADE:
        yield (
            f"{measured_level}, close to 10^{nearest}: record and model are in different units. structid works in m, N, kg and s."
            f" {_decade_remedy(nearest)}"
        )
        return
    is_driven = any(sensor.unsigned == load.unsigned for sensor in record.outputs for load in record.inputs)
    of_support = record.is_per_motion
    drive = "support" if of_support else "load"
    if goes <= -_GOES and not is_driven:
        yield (
            f"all sensors move against the model: the {drive} {_listed(record.inputs)} {'moves' if of_support else 'acts'} with"
            f" the opposite sense, or the FRF has another sign convention; relabel the {drive}, as in"
            ' relabel = {"load 3X" = "3X-"}'
        )
    loads = median(level, 0)
    alike = bool((np.abs(loads - common) < _NEAR).all())
    paired = [np.isfinite(one.mac) for one in comparison.pairs]
    agree = len(level) >= _FEWEST and float(np.nanmax(level) - np.nanmin(level)) < _ALIKE
    is_clear = abs(common) > (_SHARED if agree else _SHARED_BY_MOST) and abs(goes) >= _AGREE
    is_shared_and_far = len(loads) > 1 and abs(common) > _FAR
    needed = _PAIRED_IF_FAR if is_shared_and_far else _PAIRED
    if not (alike and is_clear and any(paired) and np.mean(paired) >= needed):
        return
    if record.kind == "accelerance" and abs(abs(common) - np.log(STANDARD_GRAVITY)) <= _NEAR:
        yield (
            f"{measured_level}, close to 9.81: accelerations look to be in m/s^2 and were read as g, or forces in kgf and read as"
            " N; correct the unit in the file or in [record]"
            if common > 0
            else f"{measured_level}, close to 1/9.81: accelerations look to be in g and were read as m/s^2; give"
            ' unit = "g/N" in [record]'
        )
        return
    if of_support:
        times = f"{np.exp(common):.2g}" if common > 0 else f"1/{np.exp(-common):.2g}"
        yield (
            f"support {_listed(record.inputs)}: its motion is {times} times what the record says, or the model is far off:"
            f" {measured_level}; {_SUPPORT_REMEDY}"
        )
        return
    unit = mistaken_unit(common, MISTAKEN_FORCES, _NEAR) if agree else ""
    cause = (
        f"the force is {np.exp(common):.2g} times what the record says, or the model's masses are too large by that"
        if common > 0
        else f"the force is 1/{np.exp(-common):.2g} of what the record says, or the model's masses are too small by that"
    )
    remedy = f", as if it were {unit}" if unit else f"; {_LOAD_REMEDY}"
    yield f"load {_listed(record.inputs)}: {cause}: {measured_level}{remedy}"


def _single_loads(record: FrfRecord, level: FloatArray, agreement: FloatArray) -> Iterator[str]:
    """Sentences on loads or driven supports whose level or sign differs from all others; none for a single load.

    Of two loads the one that is off differs from the other and from the model: two that are off by the same are off
    together. A factor counts above 1.7 or below 1/1.7. `level` is the logarithm of measured over modelled magnitude,
    `agreement` the mean cosine of their phase angle, both (n_outputs, n_inputs).
    """
    if len(record.inputs) < 2:
        return
    loads, goes = median(level, 0), median(agreement, 0)
    of_support = record.is_per_motion
    drive, acts = ("support", "moves") if of_support else ("load", "acts")
    for i, load in enumerate(record.inputs):
        others = np.delete(np.arange(len(loads)), i)
        level_of_others = float(median(loads[others], 0))
        reference = level_of_others if len(others) > 1 else 0.0
        if not float(median(goes[others], 0)) >= _GOES:
            continue
        if goes[i] <= _TURNED:
            yield f"{drive} {load} {acts} with the opposite sense at most sensors; check its sign, or relabel it"
        elif goes[i] >= _GOES and min(abs(loads[i] - level_of_others), abs(loads[i])) > _ABOUT_ONE:
            size = loads[i] - reference
            told = f"{drive} {load}: the measured {record.kind} is {np.exp(size):.2g} times the model's beside other {drive}s"
            if of_support:
                yield f"{told}: {_SUPPORT_REMEDY}"
            else:
                unit = mistaken_unit(size, MISTAKEN_FORCES, _NEAR)
                yield f"{told}: {f'the force looks to be {unit}' if unit else _LOAD_REMEDY}"


def _sensors(comparison: AlignedFrf, level: FloatArray, agreement: FloatArray) -> Iterator[str]:
    """Sentences on sensors that differ from all others in level or sign, that look exchanged, or that fit far worse.

    Those of level and sign are in the order of the sensors; exchanged pairs follow, then those that fit far worse. None
    with fewer than three sensors. `level` is the logarithm of measured over modelled magnitude, `agreement` the mean
    cosine of their phase angle, both (n_outputs, n_inputs); `comparison` has the record and both FRFs.
    """
    record = comparison.record
    apart: list[int] = []
    for o, fault, size in _faults(level, agreement):
        sensor = record.outputs[o]
        if fault == "turned":
            remedy = f'write relabel = {{"{sensor.place}" = "{sensor.place}-"}}'
            if sensor.sign < 0:
                remedy += ", or take that line out where the study has it"
            yield (
                f"sensor {sensor} reads with the opposite sense (beside the model and the other sensors); check its sign, or"
                f" {remedy}"
            )
        elif fault == "level":
            table = mistaken_motions(sensor.is_rotation, record.kind in ACCELERATION_KINDS)
            unit = mistaken_unit(size, table, _NEAR)
            times = f"{np.exp(size):.2g}" if size > 0 else f"1/{np.exp(-size):.2g}"
            yield f"sensor {sensor} reads {times} times the level of the others beside the model: " + (
                f"it looks to be {unit}; correct its unit" if unit else "check its sensitivity and unit"
            )
        else:
            apart.append(o)
    pairs = _exchanged(comparison, apart)
    for a, b in pairs:
        a_dof, b_dof = record.outputs[a], record.outputs[b]
        yield f"sensors {a_dof} and {b_dof} look exchanged: each moves as the model does at the other"
    for o in apart:
        if not any(o in pair for pair in pairs):
            yield (
                f"sensor {record.outputs[o]} fits the model far worse than the others: check its direction, position and cable"
            )


def _faults(
    level: FloatArray, agreement: FloatArray
) -> Iterator[tuple[int, Literal["turned", "level", "apart"], float]]:
    """Sensors that fit worse than all others, as (index from 0, fault, logarithm of the level relative to the others).

    Faults are "turned" (phase cosine of at most -0.4 at the level of the others to a factor of 1.7), "level" (off by
    more than a factor of 3, cosine at least 0.4), and "apart" (cosine below 0.4 or off by more than 2.5, where the
    median cosine of the others is at least 0.9). There are none for fewer than three sensors, or where that median is
    below 0.7. `level` is the logarithm of measured over modelled magnitude, `agreement` the mean cosine of their phase
    angle, both (n_outputs, n_inputs).
    """
    levels, goes = median(level - median(level, 0), 1), median(agreement, 1)
    if len(levels) < 3:
        return
    for o in range(len(levels)):
        others_agreement = float(median(np.delete(goes, o), 0))
        size = float(levels[o] - median(np.delete(levels, o), 0))
        if not (np.isfinite(goes[o]) and others_agreement >= _GOES):
            continue
        if goes[o] <= _TURNED and abs(size) <= _ABOUT_ONE:
            yield o, "turned", size
        elif abs(size) > _FAR and goes[o] >= _APART:
            yield o, "level", size
        elif others_agreement >= _GOES_WELL and (goes[o] < _APART or abs(size) > _LEVEL):
            yield o, "apart", size


def _exchanged(comparison: AlignedFrf, misfits: Sequence[int]) -> list[tuple[int, int]]:
    """Pairs of sensors, by index from 0, that agree with the model once exchanged; each sensor is in one pair at most.

    Candidates are the indices `misfits` of sensors that fit far worse than all others. Agreement is a mean cosine of
    the phase angle of at least 0.7 at both.
    """
    pairs: list[tuple[int, int]] = []
    for a, b in combinations(misfits, 2):
        changed = accord(comparison.measured[:, [a, b]], comparison.model[:, [b, a]])
        is_free = not any({a, b} & set(pair) for pair in pairs)
        if is_free and np.nanmin(median(changed, 1)) >= _GOES:
            pairs.append((a, b))
    return pairs


def _reciprocity(record: FrfRecord) -> Iterator[str]:
    """Sentences on pairs of channels that are both driven and measured and whose FRFs are not reciprocal.

    They must differ by 5 % and six standard errors in the median magnitude, or in sign, on at least eight lines on
    which both are clear of the noise.
    """
    sensors = {dof.unsigned: o for o, dof in enumerate(record.outputs)}
    loads = {dof.unsigned: i for i, dof in enumerate(record.inputs)}
    for one, other in combinations([dof for dof in loads if dof in sensors], 2):
        there = _signed(record, sensors[one], loads[other])
        back = _signed(record, sensors[other], loads[one])
        clear = np.isfinite(there) & np.isfinite(back)
        if clear.sum() < 8:
            continue
        ratio = there[clear] / back[clear]
        size = np.log(np.abs(ratio))
        middle = float(np.median(size))
        spread = 1.4826 * float(np.median(np.abs(size - middle))) * 1.2533 / np.sqrt(len(size))
        turned = float(np.mean(np.cos(np.angle(ratio)))) < _TURNED
        if turned or abs(middle) > max(_RECIPROCAL, _ERRORS * spread):
            times = f"{'-' if turned else ''}{np.exp(middle):.3g}"
            yield (
                f"reciprocity: {one.place} under a load at {other.place} is {times} times {other.place} under a load at"
                f" {one.place}, and should be the same: check sense and sensitivity of these sensors and loads"
            )


def _signed(record: FrfRecord, o: int, i: int) -> ComplexArray:
    """The FRF of output o and input i, (n_lines,), without the channels' signs; NaN where noise hides it."""
    values = record.values[:, o, i] * record.outputs[o].sign * record.inputs[i].sign
    noise = 0.0 if record.variance is None else np.sqrt(record.variance[:, o, i])
    return np.where(np.abs(values) > _CLEAR * noise, values, np.nan)


def _decade_remedy(decades: int) -> str:
    """A sentence on the units that a factor of 10^`decades` (measured over modelled) points to, and how to state them."""
    if decades == 3:
        cause = "The record may be in mm (or per kN), or the model's nodes in mm, or its masses in t and stiffnesses in kN/m"
    elif decades == -3:
        cause = "The record may be per mN or in km, or the model's stiffnesses in N/mm entered as N/m times 10^6"
    else:
        cause = "The record may be in other units than the file says, or a mass or stiffness of the model is"
    return f'{cause}: give the file\'s unit in [record], as in unit = "mm/N", or correct the model'


def _listed(dofs: Sequence[Dof]) -> str:
    return ", ".join(map(str, dofs))


@dataclass(frozen=True)
class InitialComparison:
    """A record beside its initial model.

    Attributes
    ----------
    resonances : tuple of ResonancePair
    warnings : ChannelWarnings
        Senses, units and levels of channels that do not look right.
    """

    resonances: tuple[ResonancePair, ...] = ()
    warnings: ChannelWarnings = field(default_factory=ChannelWarnings)


def compare_with_initial_model(setup: AnySetup, problem: RecordProblem, options: IdentifyOptions) -> InitialComparison:
    """Resonances and channels of a record beside those of the initial model, with warnings about the channels.

    Of modes only the resonances are compared. Histories are compared as averaged FRFs if the set-up gives any; else the
    result is empty. `problem` is that of `setup`; `options` say how histories are averaged.

    Raises
    ------
    SingularModelError, InputError
        If the initial model cannot be evaluated.
    """
    if compares_modes(problem):
        return _compare_modes(problem)
    averaged = setup.shown_problem(options, problem.channels)
    if averaged is not None:
        return _compare_responses(averaged, averaged.predicted(averaged.theta_start))
    if not isinstance(problem, FrfProblem):
        return InitialComparison()
    predicted = problem.predicted(problem.theta_start)
    if not np.isfinite(predicted).all():
        raise SingularModelError(
            "the initial model's response is not finite; check its masses, stiffnesses and supports"
        )
    return _compare_responses(problem, predicted)


def _compare_responses(problem: FrfProblem, predicted: ComplexArray) -> InitialComparison:
    comparison = aligned(problem, predicted)
    return InitialComparison(comparison.pairs, channel_warnings(comparison))


def _compare_modes(problem: ModalProblem) -> InitialComparison:
    """Measured modes with those of the initial model that they are paired with, then unmatched modes of the model.

    The latter, those passed over by the pairing, have NaN for the measured frequency and the MAC.
    """
    from structid.identification.modal_fit import paired_modes  # for records of modes alone

    theta = np.asarray(problem.theta_start)
    problem.residual(theta)
    pairs = paired_modes(problem, theta)
    columns = (problem.data.frequency.tolist(), pairs.frequency.tolist(), pairs.mac.tolist())
    resonances = [ResonancePair(*row) for row in zip(*columns, strict=True)]
    extra = [ResonancePair(np.nan, frequency, np.nan) for frequency in pairs.passed_over.tolist()]
    return InitialComparison((*resonances, *extra))
