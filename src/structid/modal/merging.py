"""Modes of several set-ups with common reference sensors, merged after each was identified (PoSER).

Every set-up measures the references and some places of its own. Its modes have a scale of their own; the references
bring them to a common one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.core.display import join_words
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError
from structid.modal.modal_record import ModalRecord, by_frequency, largest_entries, unscaled_shape_std
from structid.similarity import mac
from structid.similarity.pairing import assigned, pairing_worth

_DOUBT = 0.01
_LEAST_WORTH = 0.5  # of a pair of modes
_SWEEPS = 200


@dataclass(frozen=True, eq=False)
class Merging:
    """Merged modes, and how far the set-ups agree.

    Attributes
    ----------
    modes : ModalRecord
        Shapes at all sensors of all set-ups.
    members : (n_setups, n_modes) int array
        Number (from 0) of the mode in every set-up.
    frequency, damping_ratio : (n_setups, n_modes) float arrays
        Of every set-up, Hz and 1.
    frequency_spread : (n_modes,) float array
        Standard deviation over the set-ups, Hz.
    chi_square : (n_modes,) float array
        Of the frequencies about their weighted mean, n_setups - 1 degrees of freedom; NaN without covariance.
    probability : (n_modes,) float array
        Of a larger chi-square, if the set-ups saw one and the same structure.
    """

    modes: ModalRecord
    members: IntArray
    frequency: FloatArray
    damping_ratio: FloatArray
    frequency_spread: FloatArray
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
) -> Merging:
    """Modes that all set-ups have, with shapes at all sensors.

    Modes are paired with those of the first set-up: the sum of MAC at the references times
    1 / (1 + (log(f / f_1) / guard)^2) is made as large as it can be, and pairs worth less than one half are none.
    Frequencies and damping ratios are means weighted by the inverse variances, each quantity by itself: of the set-ups
    that state its deviation, or of all that know it, without a deviation, where none does. Shapes are the weighted
    least-squares fit of one shape and one complex factor a set-up to all entries measured; entries without a deviation
    are taken to have the middle one of those that are stated. Entries that a set-up does not know are left to the others; a
    mode of a set-up that knows none at the references is lost.

    Parameters
    ----------
    setups : sequence of ModalRecord
        From independent records.
    references : sequence of Dof, optional
        Sensors that all set-ups have; by default all such.
    frequency_guard : float
        A pair is worth half as much at this logarithmic distance in frequency.
    names : sequence of str, optional
        What errors call the set-ups, such as their files.

    Returns
    -------
    Merging
        The covariance of frequencies and damping ratios follows from those of the set-ups; that of a mode whose
        set-ups disagree (probability below 1 % for all modes together) is multiplied by chi-square over its degrees of
        freedom, and a warning names the mode. The first warning says which modes are lost, and why; others, where deviations
        are missing.

    Raises
    ------
    InputError
        If there are fewer than two set-ups, one of them is given twice, or they have no references or no mode in common.

    References
    ----------
    Reynders, Magalhaes, Roeck and Cunha (2009), Merging strategies for multi-setup operational modal analysis,
    Proc. IMAC 27; Birge (1932), Phys. Rev. 40, 207-227 (the factor on the covariance).
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
    return _merged(setups, members, notes)


def _require_different(setups: Sequence[ModalRecord], called: Sequence[str]) -> None:
    """One set-up given twice would count as two measurements."""
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
    """The references, counted positive along their axes: those named, or all that every set-up has."""
    own = [{dof.unsigned for dof in part} for part in channels]
    common = set.intersection(*own)
    if references is None:
        wanted = tuple(dof.unsigned for dof in channels[0] if dof.unsigned in common)
    else:
        wanted = tuple(dof.unsigned for dof in parse_dofs(references))
        for dof in wanted:
            if dof not in common:
                lacking = next(name for name, part in zip(called, own, strict=True) if dof not in part)
                raise InputError(f"`references` must be in all set-ups; {dof} is not in {lacking}")
    if not wanted:
        sensors = "; ".join(f"{name} has {join_words(part)}" for name, part in zip(called, channels, strict=True))
        raise InputError(
            f"set-ups must have a sensor in common, and none is in all of them: {sensors}; keep references at the same"
            " places, and call them alike in all files"
        )
    return tuple(dict.fromkeys(wanted))


def _rows(setup: ModalRecord, dofs: Sequence[Dof]) -> ComplexArray:
    """Shapes at `dofs`, counted positive along their axes."""
    place = {dof.unsigned: i for i, dof in enumerate(setup.channels)}
    rows = [place[dof] for dof in dofs]
    sign = np.array([setup.channels[i].sign for i in rows])
    return np.asarray(setup.mode_shapes[rows] * sign[:, None], dtype=np.complex128)


def _worth(
    first: ModalRecord, second: ModalRecord, shared: Sequence[Dof], guard: float
) -> tuple[FloatArray, FloatArray]:
    """MAC at the references, and what the pair of two modes is worth, (n_modes of first, n_modes of second) each."""
    likeness = np.nan_to_num(mac(_rows(first, shared), _rows(second, shared)))
    return likeness, pairing_worth(likeness, first.frequency, second.frequency, guard)


def _members(setups: Sequence[ModalRecord], shared: Sequence[Dof], guard: float) -> IntArray:
    """Numbers of the modes that all set-ups have, (n_setups, n_modes)."""
    first = setups[0]
    pairs = [{i: i for i in range(first.n_modes)}]
    for setup in setups[1:]:
        worth = _worth(first, setup, shared, guard)[1]
        pairs.append({int(i): int(j) for i, j in zip(*assigned(worth), strict=True) if worth[i, j] >= _LEAST_WORTH})
    kept = [i for i in range(first.n_modes) if all(i in own for own in pairs)]
    return np.array([[own[i] for i in kept] for own in pairs], dtype=int)


def _losses(setups: Sequence[ModalRecord], members: IntArray, shared: Sequence[Dof], guard: float) -> list[str]:
    """How many modes of how many set-ups are lost, which, and why."""
    lost = []
    for number, (setup, own) in enumerate(zip(setups, members, strict=True)):
        for mode in np.setdiff1d(np.arange(setup.n_modes), own).tolist():
            why = _why_lost(setups, number, mode, shared, guard)
            lost.append(f"set-up {number + 1}: {setup.frequency[mode]:.4g} Hz ({why})")
    if not lost:
        return []
    whole, touched = sum(setup.n_modes for setup in setups), len({words.split(":")[0] for words in lost})
    return [
        f"merging loses {len(lost)} of {whole} modes, of {touched} of {len(setups)} set-ups, since not all set-ups have"
        f" such a mode: {'; '.join(lost)}"
    ]


def _why_lost(setups: Sequence[ModalRecord], number: int, mode: int, shared: Sequence[Dof], guard: float) -> str:
    """The set-ups that lack a mode like this, and how near their nearest comes."""
    if np.isnan(_rows(setups[number], shared)[:, mode]).all():
        return "none of its references is known"
    reasons = []
    for other, setup in enumerate(setups):
        if other == number or not setup.n_modes:
            continue
        likeness, worth = (part[mode] for part in _worth(setups[number], setup, shared, guard))
        best = int(worth.argmax())
        if worth[best] < _LEAST_WORTH:
            near = f"nearest {setup.frequency[best]:.4g} Hz with a MAC of {likeness[best]:.2f} at the references"
            reasons.append(f"none in set-up {other + 1}, {near}")
    return ", ".join(reasons) or "its like is paired with another mode"


def _merged(setups: Sequence[ModalRecord], members: IntArray, notes: list[str]) -> Merging:
    n_setups, n_modes = members.shape
    frequency = np.array([s.frequency[m] for s, m in zip(setups, members, strict=True)])
    damping = np.array([s.damping_ratio[m] for s, m in zip(setups, members, strict=True)])
    values = np.concatenate([frequency, damping], axis=1)
    covariances = [_covariance(setup, own) for setup, own in zip(setups, members, strict=True)]
    variance = np.array([np.diag(part) for part in covariances])
    mean, covariance = _weighted_mean(values, variance, covariances)
    chi_square, probability = _agreement(values[:, :n_modes], mean[:n_modes], variance[:, :n_modes])
    shapes, std, channels, bare = _shapes(setups, members)
    notes += _lost_deviations(values, variance, mean[:n_modes], bare)
    doubtful = np.flatnonzero(np.nan_to_num(probability, nan=1.0) < _DOUBT / n_modes)
    if covariance is not None and doubtful.size:
        factor = np.ones(2 * n_modes)
        factor[doubtful] = np.sqrt(chi_square[doubtful] / (_stated(variance)[:, doubtful].sum(axis=0) - 1))
        factor[doubtful + n_modes] = factor[doubtful]
        covariance = covariance * np.outer(factor, factor)
        notes += [_disagreement(i, frequency[:, i], probability[i], factor[i]) for i in doubtful.tolist()]
    order = np.argsort(mean[:n_modes], kind="stable")
    modes = by_frequency(
        mean[:n_modes], mean[n_modes:], shapes, channels, covariance, std, warnings=tuple(notes),
        source=f"{n_setups} set-ups merged after identification: {setups[0].source}",
    )  # fmt: skip
    return Merging(
        modes, members[:, order], frequency[:, order], damping[:, order], frequency[:, order].std(axis=0, ddof=1),
        chi_square[order], probability[order],
    )  # fmt: skip


def _covariance(setup: ModalRecord, own: IntArray) -> FloatArray:
    """Of the frequencies, then damping ratios, of the paired modes of a set-up; NaN where it states none."""
    if setup.covariance is None:
        return np.full((2 * len(own), 2 * len(own)), np.nan)
    both = np.concatenate([own, own + setup.n_modes])
    return np.asarray(setup.covariance[np.ix_(both, both)])


def _stated(variance: FloatArray) -> NDArray[np.bool_]:
    """Which variances say something: those above 0, of whose measurements a weighted mean is made."""
    return np.asarray(np.nan_to_num(variance) > 0)


def _weighted_mean(
    values: FloatArray, variance: FloatArray, covariances: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray | None]:
    """Mean over the set-ups, (n_quantities,), with weights 1 / variance, each quantity by itself, and its covariance.

    A quantity whose deviation no set-up states is the plain mean of those that know it, with NaN in the covariance.
    """
    counts = _stated(variance) & ~np.isnan(values)
    weighed = counts.any(axis=0)
    weight = np.where(counts, 1 / np.where(counts, variance, 1.0), 0.0)
    weight = np.where(weighed, weight, ~np.isnan(values))
    weight = weight / np.where(weight.any(axis=0), weight.sum(axis=0), np.nan)
    mean = np.where(weight.any(axis=0), (weight * np.nan_to_num(values)).sum(axis=0), np.nan)
    if not weighed.any():
        return mean, None
    covariance = np.zeros((len(mean), len(mean)))
    for w, own in zip(weight, covariances, strict=True):
        covariance += np.where(np.outer(w, w) > 0, np.outer(w, w) * own, 0.0)
    return mean, np.where(np.outer(weighed, weighed), covariance, np.nan)


def _agreement(frequency: FloatArray, mean: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Chi-square of the frequencies of every mode about their mean, and the probability of a larger one.

    Of the set-ups that state a deviation; NaN for a mode of which fewer than two do.
    """
    from scipy import special

    counts = _stated(variance)
    freedom = np.where(counts.sum(axis=0) > 1, counts.sum(axis=0) - 1.0, np.nan)
    chi_square = np.where(counts, (frequency - mean) ** 2 / np.where(counts, variance, 1.0), 0.0).sum(axis=0)
    chi_square = np.where(np.isnan(freedom), np.nan, chi_square)
    return chi_square, special.gammaincc(freedom / 2, chi_square / 2)


def _lost_deviations(
    values: FloatArray, variance: FloatArray, frequency: FloatArray, bare: NDArray[np.bool_]
) -> list[str]:
    """What set-ups that state no deviation have no part in; nothing where none is stated of that kind at all.

    `values` and their variance are of frequencies, then damping ratios; `bare` are shapes that have entries without a deviation.
    """
    n = len(frequency)
    counts, known = _stated(variance), ~np.isnan(values)
    notes = []
    for what, own in (("frequencies", slice(0, n)), ("damping ratios", slice(n, None))):
        if not counts[:, own].any():
            continue
        for number, (stated, given) in enumerate(zip(counts[:, own], known[:, own], strict=True), 1):
            modes, others = given & ~stated, counts[:, own].any(axis=0)
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


def _disagreement(mode: int, frequency: FloatArray, probability: float, factor: float) -> str:
    join_words = ", ".join(f"{f:.5g}" for f in frequency)
    return (
        f"mode {mode + 1}: the set-ups disagree more than their intervals say ({join_words} Hz, probability"
        f" {probability:.1g}): the structure changed between them, as with temperature or load, or a record is too short;"
        f" its standard deviations are {factor:.2g} times as wide. Measure the set-ups soon after one another"
    )


def _shapes(
    setups: Sequence[ModalRecord], members: IntArray
) -> tuple[ComplexArray, FloatArray | None, tuple[Dof, ...], NDArray[np.bool_]]:
    """Merged shapes at all sensors, largest entry 1, their standard deviations, the sensors, and which lack deviations.

    The last are modes of set-ups, (n_setups, n_modes), beside others that state theirs.
    """
    channels = tuple(dict.fromkeys(dof.unsigned for setup in setups for dof in setup.channels))
    index = [np.array([channels.index(dof.unsigned) for dof in setup.channels]) for setup in setups]
    shapes, stds = [], []
    bare = np.zeros(members.shape, dtype=bool)
    for mode, own in enumerate(members.T):
        parts, errors, places = [], [], []
        for setup, m, place in zip(setups, own.tolist(), index, strict=True):
            here = setup.known[:, m]
            parts.append(_rows(setup, [dof.unsigned for dof in setup.channels])[here, m])
            errors.append(_shape_error(setup, m)[here])
            places.append(place[here])
        found = np.unique(np.concatenate(places))
        there = [np.searchsorted(found, place) for place in places]
        is_stated = any(not np.isnan(error).all() for error in errors)
        weighed = _all_stated(parts, errors, places)
        shape, std = np.full(len(channels), complex(np.nan, np.nan)), np.full(len(channels), np.nan)
        shape[found], own_std = merged_shape(parts, weighed, there, len(found))
        std[found] = own_std if is_stated else np.nan
        bare[:, mode] = [is_stated and bool(np.isnan(error).any()) for error in errors]
        shapes.append(shape)
        stds.append(std)
    known = np.array(stds).T
    return np.array(shapes).T, None if np.isnan(known).all() else known, channels, bare


def _all_stated(
    parts: Sequence[ComplexArray], errors: Sequence[FloatArray], places: Sequence[IntArray]
) -> list[FloatArray]:
    """Errors of the entries of each part, those that are not stated the middle one of the others, at the same scale.

    The scale is the size at the sensors that all parts have.
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
    """Standard deviation of every entry of the shape with its scale free; NaN where none is known."""
    if setup.shape_std is None:
        return np.full(len(setup.channels), np.nan)
    shape = np.asarray(setup.mode_shapes[:, [mode]])
    largest = largest_entries(shape)
    freed = unscaled_shape_std(shape / largest, setup.shape_std[:, [mode]] / largest)[:, 0] * largest
    return np.asarray(np.where(np.nan_to_num(freed) > 0, freed, np.nan))


def merged_shape(
    parts: Sequence[ComplexArray], errors: Sequence[FloatArray], index: Sequence[IntArray], n_channels: int
) -> tuple[ComplexArray, FloatArray]:
    """The shape psi and factors c_s that make the sum of |part_s - c_s psi|^2 / error_s^2 least.

    Parameters
    ----------
    parts : sequence of (n_own,) complex arrays
    errors : sequence of (n_own,) float arrays
        Standard deviation of real and imaginary part of each entry.
    index : sequence of (n_own,) int arrays
        Which channel of all each entry is.
    n_channels : int

    Returns
    -------
    (n_channels,) complex array
        Largest entry 1.
    (n_channels,) float array
        Standard deviation of the real part of every entry, from the information matrix of shape and factors; 0 at the
        largest.

    Notes
    -----
    Alternating least squares, which the references drive: an entry of one part alone fits its part exactly.
    """
    factors = np.ones(len(parts), dtype=np.complex128)
    shape: ComplexArray = np.zeros(n_channels, dtype=np.complex128)
    done: list[int] = []
    for s in _order(index):  # a first shape: each part scaled to those before it
        own = np.isin(index[s], done)
        if own.any():
            factors[s] = _best_factor(parts[s][own], errors[s][own], shape[index[s][own]])
        new = ~own
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
    """Parts so that each has a channel in common with those before it."""
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
    top, bottom = np.zeros(n_channels, dtype=np.complex128), np.zeros(n_channels)
    for part, error, own, factor in zip(parts, errors, index, factors, strict=True):
        np.add.at(top, own, factor.conj() * part / error**2)
        np.add.at(bottom, own, np.abs(factor) ** 2 / error**2)
    return np.asarray(top / bottom)


def _best_factor(part: ComplexArray, error: FloatArray, shape: ComplexArray) -> complex:
    weight = 1 / error**2
    return complex(np.sum(weight * shape.conj() * part) / np.sum(weight * np.abs(shape) ** 2))


def _deviation(
    errors: Sequence[FloatArray], index: Sequence[IntArray], shape: ComplexArray, factors: ComplexArray, largest: int
) -> FloatArray:
    """Of the real part of shape / shape[largest]: covariance by a real Jacobian, the first factor held.

    Errors of real and imaginary parts are alike, so that complex least squares does: J = d(c psi) has columns c (shape)
    and psi (factors), and (J^H W J)^-1 is the covariance of either part of the unknowns.
    """
    n, m = len(shape), len(factors)
    rows = []
    for s, (error, own) in enumerate(zip(errors, index, strict=True)):
        block = np.zeros((len(own), n + m), dtype=np.complex128)
        block[np.arange(len(own)), own] = factors[s]
        block[:, n + s] = shape[own]
        rows.append(block / error[:, None])
    jacobian = np.delete(np.concatenate(rows), n, axis=1)
    covariance = np.linalg.inv(jacobian.conj().T @ jacobian)[:n, :n]
    unit = shape / shape[largest]
    change = np.eye(n, dtype=np.complex128) / shape[largest]
    change[:, largest] -= unit / shape[largest]
    variance = np.einsum("ij,jk,ik->i", change, covariance, change.conj()).real
    variance[largest] = 0.0
    return np.sqrt(np.maximum(variance, 0.0))
