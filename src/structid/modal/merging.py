"""Modes of several set-ups with common reference sensors, merged after each was identified (PoSER).

Every set-up measures the references and some places of its own. Its modes have a scale of their own; the references
bring them to a common one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import combinations, permutations

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.core.display import join_words
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError
from structid.modal.modal_record import ModalRecord, by_frequency, largest_entries, unscaled_shape_std
from structid.similarity import assign_pairs, mac, pairing_worth

_DOUBT = 0.01
_LEAST_WORTH = 0.5  # of a pair of modes
_SWEEPS = 200
_GROUPINGS = 10  # times the modes of all set-ups are grouped at most


@dataclass(frozen=True, eq=False)
class MergedModes:
    """Merged modes, and how far the set-ups agree.

    Attributes
    ----------
    modes : ModalRecord
        Shapes at all sensors of all set-ups; NaN at sensors of set-ups that all lack the mode.
    members : (n_setups, n_modes) int array
        Number (from 0) of the mode in every set-up; -1 where a set-up lacks it.
    frequency, damping_ratio : (n_setups, n_modes) float arrays
        Frequency in Hz and damping ratio that every set-up gives; NaN where a set-up lacks the mode.
    frequency_spread : (n_modes,) float array
        Standard deviation over the set-ups, Hz.
    scatter : (2 n_modes,) float array
        Standard deviation between set-ups of the frequencies (Hz), then damping ratios, beyond that of each set-up.
    chi_square : (n_modes,) float array
        Sum of the weighted squares of the frequencies about their mean, with one degree of freedom less than there are
        set-ups that state a deviation; NaN where fewer than two do.
    probability : (n_modes,) float array
        Probability of a larger chi-square, if the set-ups saw one and the same structure.
    """

    modes: ModalRecord
    members: IntArray
    frequency: FloatArray
    damping_ratio: FloatArray
    frequency_spread: FloatArray
    scatter: FloatArray
    chi_square: FloatArray
    probability: FloatArray


def merge_modes(
    setups: Sequence[ModalRecord], references: Sequence[Dof | str] | None = None, frequency_guard: float = 0.05
) -> ModalRecord:
    """Modes of all set-ups as one record; see `merged_setups`."""
    return merged_setups(setups, references, frequency_guard).modes


def merged_setups(
    setups: Sequence[ModalRecord],
    references: Sequence[Dof | str] | None = None,
    frequency_guard: float = 0.05,
    names: Sequence[str] | None = None,
) -> MergedModes:
    """Modes of several set-ups merged by their shared sensors, with shapes at all sensors.

    Modes of all set-ups are grouped. Each set-up in turn is paired with the groups so that the total worth of its pairs is as
    large as possible, until no mode changes its group. A pair of modes is worth MAC at the references times
    1 / (1 + (log(f / f_1) / guard)^2), a mode and a group the mean over the members; below one half a mode begins a new group,
    and groups of a single mode are left out. Frequencies and damping ratios are means over set-ups, weighted by the inverse of
    the variance of the set-up plus that of the scatter between set-ups. A quantity uses the set-ups that state its deviation;
    if none does, it is the plain mean, without a deviation. Shapes are the weighted least-squares fit of one shape, and of one
    complex factor for each set-up, to all entries measured; entries without a deviation get the median of the stated ones.
    Unknown entries (NaN) have no part, and stay unknown if no set-up knows them; a mode whose entries at the references are all
    unknown is lost.

    Parameters
    ----------
    setups : sequence of ModalRecord
        From independent records.
    references : sequence of Dof, optional
        Sensors that all set-ups have; by default all such.
    frequency_guard : float
        A pair is worth half as much at this logarithmic distance in frequency.
    names : sequence of str, optional
        Names of the set-ups in errors, such as their files.

    Returns
    -------
    MergedModes
        The covariance of frequencies and damping ratios follows from those of the set-ups and the scatter between them, a
        random effect; a warning names modes whose set-ups disagree (probability below 1 % for all modes together). The
        first warning says which modes are in one set-up only, and why; others, where deviations are missing.

    Raises
    ------
    InputError
        If there are fewer than two set-ups, one of them is given twice, or they have no references or no mode in common.

    References
    ----------
    Reynders, Magalhaes, Roeck and Cunha (2009), Merging strategies for multi-setup operational modal analysis,
    Proc. IMAC 27; DerSimonian and Laird (1986), Control. Clin. Trials 7, 177-188 (the scatter between set-ups).
    """
    called = [f"set-up {i}" for i in range(1, len(setups) + 1)] if names is None else list(names)
    if len(setups) < 2:
        raise InputError(f"two set-ups or more are merged, got {', '.join(called) or 'none'}; one needs no merging")
    _require_different(setups, called)
    shared = common_sensors([setup.channels for setup in setups], references, called)
    members = _members(setups, shared, frequency_guard)
    if not members.shape[1]:
        raise InputError(
            f"{', '.join(called)} have no mode in common: no MAC at the references with a frequency nearby; check the senses of the"
            " references, add references where the modes move, or widen `frequency_guard`"
        )
    notes = _losses(setups, members, shared, frequency_guard)
    notes += [f"set-up {i}: {words}" for i, setup in enumerate(setups, 1) for words in setup.warnings]
    return _merge_matched(setups, members, notes)


def _require_different(setups: Sequence[ModalRecord], called: Sequence[str]) -> None:
    """Raise `InputError` if two set-ups hold the same modes, which would count as two measurements.

    `called` are the names of the set-ups in the error.
    """
    for (a, first), (b, second) in combinations(zip(called, setups, strict=True), 2):
        if (
            first.channels == second.channels
            and np.array_equal(first.frequency, second.frequency)
            and np.array_equal(first.mode_shapes, second.mode_shapes, equal_nan=True)
        ):
            raise InputError(f"{a} and {b} hold the same modes to the last digit; give every set-up once")


def common_sensors(
    channels: Sequence[Sequence[Dof]], references: Sequence[Dof | str] | None, called: Sequence[str]
) -> tuple[Dof, ...]:
    """Reference sensors that all set-ups have, as positive directions: those of `references`, or all by default.

    By default they are in the order of the first set-up. `channels` are the sensors of each set-up, `called` the names
    of the set-ups in errors.

    Raises
    ------
    InputError
        If a set-up lacks one of `references`, or no sensor is in all set-ups.
    """
    unsigned = [{dof.unsigned for dof in part} for part in channels]
    common = set.intersection(*unsigned)
    if references is None:
        wanted = tuple(dof.unsigned for dof in channels[0] if dof.unsigned in common)
    else:
        wanted = tuple(dof.unsigned for dof in parse_dofs(references))
        for dof in wanted:
            if dof not in common:
                lacking = next(name for name, part in zip(called, unsigned, strict=True) if dof not in part)
                raise InputError(f"`references` must be in all set-ups; {dof} is not in {lacking}")
    if not wanted:
        sensors = "; ".join(f"{name} has {join_words(part)}" for name, part in zip(called, channels, strict=True))
        raise InputError(
            f"set-ups must have a sensor in common, and none is in all of them: {sensors}; keep references at the same"
            " places, and call them alike in all files"
        )
    return tuple(dict.fromkeys(wanted))


def rows_and_signs(setup: ModalRecord, dofs: Sequence[Dof]) -> tuple[list[int], FloatArray]:
    """Row numbers of a set-up's shapes for `dofs`, and the senses (+1.0 or -1.0) of its channels there, (n_dofs, 1).

    `dofs` are positive directions.
    """
    row_of = {dof.unsigned: i for i, dof in enumerate(setup.channels)}
    rows = [row_of[dof] for dof in dofs]
    return rows, np.array([[float(setup.channels[row].sign)] for row in rows])


def _rows(setup: ModalRecord, dofs: Sequence[Dof]) -> ComplexArray:
    """Shape entries (n_dofs, n_modes) of a set-up at `dofs`, counted positive along the axes."""
    rows, signs = rows_and_signs(setup, dofs)
    return np.asarray(setup.mode_shapes[rows] * signs, dtype=np.complex128)


def pair_worth(
    first: ModalRecord, second: ModalRecord, shared: Sequence[Dof], guard: float
) -> tuple[FloatArray, FloatArray]:
    """MAC of all pairs of modes over the references, and the worth of each pair; (n_first, n_second) each.

    `shared` are the reference sensors. The worth is MAC / (1 + (log(f / f_1) / guard)^2), with f and f_1 the frequencies of the
    two modes and the natural logarithm; it is 0 where no reference is known.
    """
    likeness = np.nan_to_num(mac(_rows(first, shared), _rows(second, shared)))
    return likeness, pairing_worth(likeness, first.frequency, second.frequency, guard)


def _members(setups: Sequence[ModalRecord], shared: Sequence[Dof], guard: float) -> IntArray:
    """Indices (from 0) in each set-up of every merged mode, (n_setups, n_modes), by mean frequency; -1 if missing.

    `shared` are the reference sensors; a pair is worth half as much at the logarithmic frequency distance `guard`. The
    set-up with the most modes is grouped first; grouping is repeated until it settles, at most ten times. A mode joins
    a group only if worth at least 0.5 there. Groups with a mode of only one set-up are left out.
    """
    worth = {(a, b): pair_worth(setups[a], setups[b], shared, guard)[1] for a, b in permutations(range(len(setups)), 2)}
    order = sorted(range(len(setups)), key=lambda number: -setups[number].n_modes)
    groups: list[dict[int, int]] = []
    for _ in range(_GROUPINGS):
        before = [dict(group) for group in groups]
        for number in order:
            for group in groups:
                group.pop(number, None)
            groups = [group for group in groups if group]
            n_modes, alone = setups[number].n_modes, set(range(setups[number].n_modes))
            if groups and n_modes:
                gain = np.array(
                    [[_worth_in(worth, number, mode, group) for group in groups] for mode in range(n_modes)]
                )
                for mode, place in zip(*assign_pairs(gain), strict=True):
                    if gain[mode, place] >= _LEAST_WORTH:
                        groups[place][number] = int(mode)
                        alone.discard(int(mode))
            groups += [{number: mode} for mode in sorted(alone)]
        if sorted(map(sorted, (group.items() for group in groups))) == sorted(
            map(sorted, (group.items() for group in before))
        ):
            break
    shown = [group for group in groups if len(group) > 1]
    shown.sort(key=lambda group: float(np.mean([setups[number].frequency[mode] for number, mode in group.items()])))
    return np.array([[group.get(number, -1) for group in shown] for number in range(len(setups))], dtype=int)


def _worth_in(worth: Mapping[tuple[int, int], FloatArray], number: int, mode: int, group: Mapping[int, int]) -> float:
    """Mean worth of a mode of set-up `number` paired with each mode of `group`.

    `worth[a, b]` is the matrix (n_modes of a, n_modes of b) of two set-ups; `group` maps set-up number to mode number.
    """
    return float(np.mean([worth[number, other][mode, member] for other, member in group.items()]))


def _losses(setups: Sequence[ModalRecord], members: IntArray, shared: Sequence[Dof], guard: float) -> list[str]:
    """A warning, as a list of one text, on the modes that merging leaves out and why; an empty list if none is left out.

    `members` (n_setups, n_modes) gives, for each set-up and merged mode, the number of the set-up's mode, from 0, or -1 if it
    has none; `shared` are the reference sensors, and `guard` is the logarithmic frequency distance at which a pair is worth
    half as much.
    """
    lost = []
    for number, (setup, merged) in enumerate(zip(setups, members, strict=True)):
        for mode in np.setdiff1d(np.arange(setup.n_modes), merged).tolist():
            why = _why_lost(setups, number, mode, shared, guard)
            lost.append(f"set-up {number + 1}: {setup.frequency[mode]:.4g} Hz ({why})")
    if not lost:
        return []
    whole, touched = sum(setup.n_modes for setup in setups), len({words.split(":")[0] for words in lost})
    return [
        f"merging leaves out {len(lost)} of {whole} modes, of {touched} of {len(setups)} set-ups, since no other set-up has"
        f" such a mode: {'; '.join(lost)}"
    ]


def _why_lost(setups: Sequence[ModalRecord], number: int, mode: int, shared: Sequence[Dof], guard: float) -> str:
    """Reason, as words for a warning, why a mode was not merged, with the nearest mode of each set-up without a match.

    Other reasons: none of its entries at the references is known, or every match is paired with another mode. The mode
    is number `mode` (from 0) of set-up `number`, `shared` are the reference sensors; `guard` is the logarithmic
    frequency distance at which a pair is worth half as much.
    """
    if np.isnan(_rows(setups[number], shared)[:, mode]).all():
        return "none of its references is known"
    reasons = []
    for other, setup in enumerate(setups):
        if other == number or not setup.n_modes:
            continue
        likeness, worth = (part[mode] for part in pair_worth(setups[number], setup, shared, guard))
        best = int(worth.argmax())
        if worth[best] < _LEAST_WORTH:
            near = f"nearest {setup.frequency[best]:.4g} Hz with a MAC of {likeness[best]:.2f} at the references"
            reasons.append(f"none in set-up {other + 1}, {near}")
    return ", ".join(reasons) or "its match is paired with another mode"


def _merge_matched(setups: Sequence[ModalRecord], members: IntArray, notes: list[str]) -> MergedModes:
    """`MergedModes`, by rising mean frequency, of the modes matched by `members`: weighted means and merged shapes.

    `members` (n_setups, n_modes) are mode indices (from 0) in each of `setups`, -1 where missing. `notes` are the
    warnings so far; further ones are appended to this list in place.
    """
    n_setups, n_modes = members.shape
    frequency = np.array([_values_of(setup.frequency, row) for setup, row in zip(setups, members, strict=True)])
    damping = np.array([_values_of(setup.damping_ratio, row) for setup, row in zip(setups, members, strict=True)])
    values = np.concatenate([frequency, damping], axis=1)
    covariances = [_covariance(setup, row) for setup, row in zip(setups, members, strict=True)]
    variance = np.array([np.diag(part) for part in covariances])
    scatter = _scatter(values, variance)
    mean, covariance = _weighted_mean(values, variance, covariances, scatter)
    chi_square, probability = _frequency_agreement(values[:, :n_modes], variance[:, :n_modes])
    shapes, std, channels, bare = _merge_shapes(setups, members)
    notes += _lost_deviations(values, variance, mean[:n_modes], bare)
    doubtful = np.flatnonzero(np.nan_to_num(probability, nan=1.0) < _DOUBT / n_modes)
    notes += [_disagreement(i, frequency[:, i], probability[i], scatter[i]) for i in doubtful.tolist()]
    order = np.argsort(mean[:n_modes], kind="stable")
    modes = by_frequency(
        mean[:n_modes], mean[n_modes:], shapes, channels, covariance, std, warnings=tuple(notes),
        source=f"{n_setups} set-ups merged after identification: {setups[0].source}",
    )  # fmt: skip
    return MergedModes(
        modes, members[:, order], frequency[:, order], damping[:, order], np.nanstd(frequency[:, order], axis=0, ddof=1),
        np.sqrt(np.concatenate([scatter[:n_modes][order], scatter[n_modes:][order]])),
        chi_square[order], probability[order],
    )  # fmt: skip


def _values_of(values: FloatArray, row: IntArray) -> FloatArray:
    """`values` of the modes in `row`; NaN where that is -1."""
    return np.append(values, np.nan)[row]


def _covariance(setup: ModalRecord, row: IntArray) -> FloatArray:
    """Covariance (2 n, 2 n) of n frequencies, then n damping ratios, of the modes `row` of a set-up.

    `row` (n,) are mode indices (from 0), -1 for a missing mode, whose rows and columns are NaN. All entries are NaN if
    the set-up states no covariance.
    """
    covariance = np.full((2 * len(row), 2 * len(row)), np.nan)
    there = np.flatnonzero(row >= 0)
    if setup.covariance is not None:
        both, places = (
            np.concatenate([part, part + n]) for part, n in ((row[there], setup.n_modes), (there, len(row)))
        )
        covariance[np.ix_(places, places)] = setup.covariance[np.ix_(both, both)]
    return covariance


def _inverse_variances(variance: FloatArray, counts: NDArray[np.bool_]) -> FloatArray:
    """1 / variance where the mask `counts` is true, else 0; all of the same shape."""
    return np.where(counts, 1 / np.where(counts, variance, 1.0), 0.0)


def _scatter(values: FloatArray, variance: FloatArray) -> FloatArray:
    """Between-set-up variance of each quantity, (n_quantities,), by DerSimonian and Laird; 0 where set-ups agree.

    `values` and `variance` are (n_setups, n_quantities). Only entries with a variance above 0 count.
    """
    counts = _stated(variance) & ~np.isnan(values)
    weight = _inverse_variances(variance, counts)
    total = np.maximum(weight.sum(axis=0), np.finfo(np.float64).tiny)
    mean = (weight * np.nan_to_num(values)).sum(axis=0) / total
    surplus = (weight * np.where(counts, values - mean, 0.0) ** 2).sum(axis=0) - (counts.sum(axis=0) - 1)
    return np.where(surplus > 0, surplus / np.maximum(total - (weight**2).sum(axis=0) / total, 1e-300), 0.0)


def _stated(variance: FloatArray) -> NDArray[np.bool_]:
    """Mask of the variances that are known and above 0, in the shape of `variance`; only these give a weight."""
    return np.asarray(np.nan_to_num(variance) > 0)


def _weighted_mean(
    values: FloatArray, variance: FloatArray, covariances: Sequence[FloatArray], scatter: FloatArray
) -> tuple[FloatArray, FloatArray | None]:
    """Weighted mean (n_quantities,) of frequencies and damping ratios over set-ups, and its covariance (None if unknown).

    Weights are 1 / (variance + scatter). A quantity whose deviation no set-up states is the plain mean over set-ups that
    know it, with NaN in the covariance. `values` and `variance` are (n_setups, n_quantities), `covariances`
    (n_quantities, n_quantities) for each set-up, and `scatter` (n_quantities,) is the variance between set-ups.
    """
    counts = _stated(variance) & ~np.isnan(values)
    weighed = counts.any(axis=0)
    weight = _inverse_variances(variance + scatter, counts)
    weight = np.where(weighed, weight, ~np.isnan(values))
    weight = weight / np.where(weight.any(axis=0), weight.sum(axis=0), np.nan)
    mean = np.where(weight.any(axis=0), (weight * np.nan_to_num(values)).sum(axis=0), np.nan)
    if not weighed.any():
        return mean, None
    covariance = np.zeros((len(mean), len(mean)))
    for w, setup_covariance in zip(weight, covariances, strict=True):
        covariance += np.where(np.outer(w, w) > 0, np.outer(w, w) * setup_covariance, 0.0)
    covariance += np.diag(
        (weight**2 * np.where(weighed, scatter, 0.0)).sum(axis=0) * _unsure_scatter(counts.sum(axis=0))
    )
    return mean, np.where(np.outer(weighed, weighed), covariance, np.nan)


def _unsure_scatter(n_setups: IntArray) -> FloatArray:
    """Factor, (n_quantities,), on the variance of scatter between set-ups, so that 1.96 deviations are the 95 % interval.

    `n_setups` is the number k of set-ups behind each quantity. Their scatter has k - 1 degrees of freedom: the square of
    Student's 97.5 % point over the normal one. Over 20,000 simulated quantities of 2, 3, 5 and 11 set-ups, with scatter of 0
    to 10 deviations, intervals hold 86 to 97 %.
    """
    from scipy import special

    return np.asarray((special.stdtrit(np.maximum(n_setups - 1, 1), 0.975) / special.ndtri(0.975)) ** 2)


def _frequency_agreement(frequency: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Chi-square of each mode's `frequency` (n_setups, n_modes) about its mean over set-ups, and its p-value, (n_modes,) each.

    Only set-ups that state a variance count; NaN for a mode with fewer than two of them. `variance` is shaped as
    `frequency`, NaN where it is not stated.
    """
    from scipy import special

    counts = _stated(variance)
    freedom = np.where(counts.sum(axis=0) > 1, counts.sum(axis=0) - 1.0, np.nan)
    weight = _inverse_variances(variance, counts)
    mean = (weight * np.nan_to_num(frequency)).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-300)
    chi_square = (weight * np.where(counts, frequency - mean, 0.0) ** 2).sum(axis=0)
    chi_square = np.where(np.isnan(freedom), np.nan, chi_square)
    return chi_square, special.gammaincc(freedom / 2, chi_square / 2)


def _lost_deviations(
    values: FloatArray, variance: FloatArray, frequency: FloatArray, bare: NDArray[np.bool_]
) -> list[str]:
    """Warnings on set-ups that state no standard deviations though others do, and how these are treated; [] if none.

    `values` and `variance` (n_setups, 2 n_modes) are of frequencies, then damping ratios; `frequency` (n_modes,) is in Hz;
    `bare` (n_setups, n_modes) is true where shape entries of a set-up lack a deviation.
    """
    n = len(frequency)
    counts, known = _stated(variance), ~np.isnan(values)
    notes = []
    for what, part in (("frequencies", slice(0, n)), ("damping ratios", slice(n, None))):
        if not counts[:, part].any():
            continue
        for number, (stated, is_known) in enumerate(zip(counts[:, part], known[:, part], strict=True), 1):
            modes, others = is_known & ~stated, counts[:, part].any(axis=0)
            for lost, words in (
                (modes & others, "these have no part in the means, which are of the others"),
                (modes & ~others, "nor does another set-up, and the means have none"),
            ):
                if lost.any():
                    notes.append(
                        f"set-up {number} states no deviations of the {what} of {_named(lost, frequency)}: {words}"
                    )
    for number, lost in enumerate(bare, 1):
        if lost.any():
            notes.append(
                f"set-up {number} states no deviations of shape entries of {_named(lost, frequency)}: they are taken to"
                " have the middle one of those that are stated"
            )
    return notes


def _named(chosen: NDArray[np.bool_], frequency: FloatArray) -> str:
    if chosen.all():
        return "its modes"
    return ", ".join(f"{f:.4g} Hz" for f in frequency[chosen])


def _disagreement(mode: int, frequency: FloatArray, probability: float, scatter: float) -> str:
    listed = ", ".join(f"{f:.5g}" for f in frequency if np.isfinite(f))
    return (
        f"mode {mode + 1}: the set-ups disagree more than their intervals say ({listed} Hz, probability"
        f" {probability:.1g}): the structure changed between them, as with temperature or load, or a record is too short;"
        f" its standard deviation includes a scatter of {np.sqrt(scatter):.2g} Hz between set-ups. Measure the set-ups soon"
        " after one another"
    )


def _merge_shapes(
    setups: Sequence[ModalRecord], members: IntArray
) -> tuple[ComplexArray, FloatArray | None, tuple[Dof, ...], NDArray[np.bool_]]:
    """Merged shapes at all sensors, their standard deviations, the sensors, and a mask of missing deviations, in this order.

    Shapes and deviations are (n_channels, n_modes), the largest entry of a shape is 1; the deviations are None if no set-up
    states any. The mask (n_setups, n_modes) is true where a set-up lacks deviations of entries of a mode although it or
    another states some. `setups` are the modal records; `members` (n_setups, n_modes) are mode numbers in each, -1 where missing.
    """
    channels = tuple(dict.fromkeys(dof.unsigned for setup in setups for dof in setup.channels))
    index = [np.array([channels.index(dof.unsigned) for dof in setup.channels]) for setup in setups]
    shapes, stds = [], []
    bare = np.zeros(members.shape, dtype=bool)
    for mode, modes_of_setups in enumerate(members.T):
        parts, errors, places, numbers = [], [], [], np.flatnonzero(modes_of_setups >= 0).tolist()
        for setup, m, place in ((setups[number], int(modes_of_setups[number]), index[number]) for number in numbers):
            here = setup.known[:, m]
            parts.append(_rows(setup, [dof.unsigned for dof in setup.channels])[here, m])
            errors.append(_shape_error(setup, m)[here])
            places.append(place[here])
        measured = np.unique(np.concatenate(places))
        there = [np.searchsorted(measured, place) for place in places]
        is_stated = any(not np.isnan(error).all() for error in errors)
        weighed = _all_stated(parts, errors, places)
        shape, std = np.full(len(channels), complex(np.nan, np.nan)), np.full(len(channels), np.nan)
        shape[measured], own_std = merged_shape(parts, weighed, there, len(measured))
        std[measured] = own_std if is_stated else np.nan
        bare[numbers, mode] = [is_stated and bool(np.isnan(error).any()) for error in errors]
        shapes.append(shape)
        stds.append(std)
    known = np.array(stds).T
    return np.array(shapes).T, None if np.isnan(known).all() else known, channels, bare


def _all_stated(
    parts: Sequence[ComplexArray], errors: Sequence[FloatArray], places: Sequence[IntArray]
) -> list[FloatArray]:
    """Standard deviations of all shape entries of each part, with unstated ones (NaN) replaced by the median of the stated ones.

    `parts` are the shapes of one mode in each set-up, `errors` their standard deviations, `places` the channel indices
    of their entries, (n_own_channels,) each; the result is like `errors`, and all 1 if none is stated. The median is
    taken of errors over the norm of the part at the sensors that all parts have.
    """
    shared = reduce(np.intersect1d, places)
    sizes = [float(np.linalg.norm(part[np.isin(place, shared)])) for part, place in zip(parts, places, strict=True)]
    scales = sizes if all(sizes) else [1.0] * len(parts)
    every = np.concatenate([error / scale for error, scale in zip(errors, scales, strict=True)])
    if np.isnan(every).all():
        return [np.ones(len(error)) for error in errors]
    usual = float(np.nanmedian(every))
    return [np.where(np.isnan(error), usual * scale, error) for error, scale in zip(errors, scales, strict=True)]


def _shape_error(setup: ModalRecord, mode: int) -> FloatArray:
    """Standard deviations of the shape entries of the mode with index `mode`, (n_channels,), as if the scale were free.

    NaN if unknown or 0. The set-up states those of shapes with the largest entry held at 1, whose error is in all other
    entries instead; it is moved back to that entry, with errors of all entries taken as equal and independent.
    """
    if setup.shape_std is None:
        return np.full(len(setup.channels), np.nan)
    shape = np.asarray(setup.mode_shapes[:, [mode]])
    largest = largest_entries(shape)
    freed = unscaled_shape_std(shape / largest, setup.shape_std[:, [mode]] / largest)[:, 0] * largest
    return np.asarray(np.where(np.nan_to_num(freed) > 0, freed, np.nan))


def merged_shape(
    parts: Sequence[ComplexArray], errors: Sequence[FloatArray], index: Sequence[IntArray], n_channels: int
) -> tuple[ComplexArray, FloatArray]:
    """Merged shape, largest entry 1, by weighted least squares over parts of free scale, and its standard deviations.

    Parameters
    ----------
    parts : sequence of (n_own,) complex arrays
        Entries of the shape that each set-up measured, in its scale.
    errors : sequence of (n_own,) float arrays
        Standard deviation of real and imaginary part of each entry.
    index : sequence of (n_own,) int arrays
        Channel number, from 0 to n_channels - 1, of each entry.
    n_channels : int
        Every channel must be in some part.

    Returns
    -------
    (n_channels,) complex array
        Largest entry 1.
    (n_channels,) float array
        Standard deviation of the real part of every entry, from the information matrix of shape and factors; 0 at the
        largest.

    Raises
    ------
    InputError
        If a part shares no channel with the others.

    Notes
    -----
    Alternating least squares over shape and factors: channels that parts share decide the factors, since an entry of
    one part alone fits its part exactly.
    """
    factors = np.ones(len(parts), dtype=np.complex128)
    shape: ComplexArray = np.zeros(n_channels, dtype=np.complex128)
    done: list[int] = []
    for s in _order(index):  # a first shape: each part scaled to those before it
        is_placed = np.isin(index[s], done)
        if is_placed.any():
            factors[s] = _best_factor(parts[s][is_placed], errors[s][is_placed], shape[index[s][is_placed]])
        new = ~is_placed
        shape[index[s][new]] = parts[s][new] / factors[s]
        done += index[s][new].tolist()
    for _ in range(_SWEEPS):
        before = shape
        shape = _best_shape(parts, errors, index, factors, n_channels)
        factors = np.array([_best_factor(p, e, shape[i]) for p, e, i in zip(parts, errors, index, strict=True)])
        if np.abs(shape - before).max() <= 1e-12 * np.abs(shape).max():
            break
    largest = int(np.abs(shape).argmax())
    std = _deviation(errors, index, shape, factors, largest)
    return shape / shape[largest], std


def _order(index: Sequence[IntArray]) -> list[int]:
    """Order of the set-ups in which each shares a channel with an earlier one, starting with set-up 0.

    `index` holds the channel indices (n_own_channels,) of each set-up. Raises `InputError` if no such order exists.
    """
    order, seen, rest = [0], set(index[0].tolist()), list(range(1, len(index)))
    while rest:
        s = next((s for s in rest if seen & set(index[s].tolist())), None)
        if s is None:
            raise InputError("`setups` must be linked by common sensors, got parts that share none")
        rest.remove(s)
        order.append(s)
        seen |= set(index[s].tolist())
    return order


def _best_shape(
    parts: Sequence[ComplexArray],
    errors: Sequence[FloatArray],
    index: Sequence[IntArray],
    factors: ComplexArray,
    n_channels: int,
) -> ComplexArray:
    """Weighted least-squares shape (n_channels,) of the parts at given scale `factors` (n_setups,) of the parts.

    `errors` are the standard deviations of the parts' entries, `index` their channels; part s is modelled as factors[s]
    * shape[index[s]]. Each of `parts`, `errors` and `index` has one array (n_own_channels,) for each set-up.
    """
    top, bottom = np.zeros(n_channels, dtype=np.complex128), np.zeros(n_channels)
    for part, error, entries, factor in zip(parts, errors, index, factors, strict=True):
        np.add.at(top, entries, factor.conj() * part / error**2)
        np.add.at(bottom, entries, np.abs(factor) ** 2 / error**2)
    return np.asarray(top / bottom)


def _best_factor(part: ComplexArray, error: FloatArray, shape: ComplexArray) -> complex:
    weight = 1 / error**2
    return complex(np.sum(weight * shape.conj() * part) / np.sum(weight * np.abs(shape) ** 2))


def _deviation(
    errors: Sequence[FloatArray], index: Sequence[IntArray], shape: ComplexArray, factors: ComplexArray, largest: int
) -> FloatArray:
    """Standard deviation of the real part of shape / shape[largest], (n_channels,), to first order; 0 at `largest`.

    The Jacobian J of the products c psi of factors c and shape psi has columns c (for psi) and psi (for c). Real and
    imaginary parts have equal errors, so (J^H W J)^-1 is the covariance of either part of the unknowns; the factor of
    the first set-up is held fixed. `errors` and `index`, one array for each set-up, are the standard deviations of its
    entries and their rows in `shape` (n_channels,); `factors` (n_setups,) are the complex scales.
    """
    n, m = len(shape), len(factors)
    rows = []
    for s, (error, entries) in enumerate(zip(errors, index, strict=True)):
        block = np.zeros((len(entries), n + m), dtype=np.complex128)
        block[np.arange(len(entries)), entries] = factors[s]
        block[:, n + s] = shape[entries]
        rows.append(block / error[:, None])
    jacobian = np.delete(np.concatenate(rows), n, axis=1)
    covariance = np.linalg.inv(jacobian.conj().T @ jacobian)[:n, :n]
    unit = shape / shape[largest]
    change = np.eye(n, dtype=np.complex128) / shape[largest]
    change[:, largest] -= unit / shape[largest]
    variance = np.einsum("ij,jk,ik->i", change, covariance, change.conj()).real
    variance[largest] = 0.0
    return np.sqrt(np.maximum(variance, 0.0))
