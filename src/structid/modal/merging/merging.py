"""Modes of several set-ups with common reference sensors, merged after each was identified (PoSER).

Every set-up measures the references and some places of its own. Its modes have a scale of their own; the references
bring them to a common one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from structid.arrays import ComplexArray, FloatArray, IntArray
from structid.dof import Dof, parse_dofs
from structid.errors import InputError
from structid.modal.merging.shape_merging import merged_shape
from structid.modal.modal_record import ModalRecord
from structid.modal.shape_errors import unscaled_shape_std
from structid.similarity import mac

_DOUBT = 0.01


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
    frequency_spread, damping_spread : (n_modes,) float arrays
        Standard deviation over the set-ups.
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
    damping_spread: FloatArray
    chi_square: FloatArray
    probability: FloatArray


def merge_modes(
    setups: Sequence[ModalRecord], references: Sequence[Dof | str] | None = None, frequency_guard: float = 0.1
) -> ModalRecord:
    """Modes of all set-ups as one record; see `merged_setups`."""
    return merged_setups(setups, references, frequency_guard).modes


def merged_setups(
    setups: Sequence[ModalRecord], references: Sequence[Dof | str] | None = None, frequency_guard: float = 0.1
) -> Merging:
    """Modes that all set-ups have, with shapes at all sensors.

    Modes are paired with those of the first set-up: the sum of MAC at the references times
    1 / (1 + (log(f / f_1) / guard)^2) is made as large as it can be, and pairs worth less than one half are none.
    Frequencies and damping ratios are means weighted by the inverse variances (equal weights without them). Shapes are
    the weighted least-squares fit of one shape and one complex factor a set-up to all entries measured.

    Parameters
    ----------
    setups : sequence of ModalRecord
        From independent records.
    references : sequence of Dof, optional
        Sensors that all set-ups have; by default all such.
    frequency_guard : float
        A pair is worth half as much at this logarithmic distance in frequency.

    Returns
    -------
    Merging
        The covariance of frequencies and damping ratios follows from those of the set-ups; that of a mode whose
        set-ups disagree (probability below 1 % for all modes together) is multiplied by chi-square over its degrees of
        freedom, and a warning names the mode.

    Raises
    ------
    InputError
        If there are fewer than two set-ups, no references, or no mode in common.

    References
    ----------
    Reynders, Magalhaes, Roeck and Cunha (2009), Merging strategies for multi-setup operational modal analysis,
    Proc. IMAC 27; Birge (1932), Phys. Rev. 40, 207-227 (the factor on the covariance).
    """
    if len(setups) < 2:
        raise InputError(f"`setups` must hold two set-ups or more, got {len(setups)}; one needs no merging")
    shared = common_sensors([setup.channels for setup in setups], references)
    members = _members(setups, shared, frequency_guard)
    if not members.shape[1]:
        raise InputError(
            "`setups` have no mode in common: no MAC at the references with a frequency nearby; check the senses of the"
            " references, add references where the modes move, or widen `frequency_guard`"
        )
    return _merged(setups, members)


def common_sensors(channels: Sequence[Sequence[Dof]], references: Sequence[Dof | str] | None = None) -> tuple[Dof, ...]:
    """The references, counted positive along their axes: those named, or all that every set-up has."""
    own = [{dof.unsigned for dof in part} for part in channels]
    common = set.intersection(*own)
    if references is None:
        wanted = tuple(dof.unsigned for dof in channels[0] if dof.unsigned in common)
    else:
        wanted = tuple(dof.unsigned for dof in parse_dofs(references))
        for dof in wanted:
            if dof not in common:
                number = next(i for i, part in enumerate(own, 1) if dof not in part)
                raise InputError(f"`references` must be in all set-ups; {dof} is not in set-up {number}")
    if not wanted:
        raise InputError("`setups` must have a sensor in common, got none; keep references at the same places")
    return tuple(dict.fromkeys(wanted))


def _rows(setup: ModalRecord, dofs: Sequence[Dof]) -> ComplexArray:
    """Shapes at `dofs`, counted positive along their axes."""
    place = {dof.unsigned: i for i, dof in enumerate(setup.channels)}
    rows = [place[dof] for dof in dofs]
    sign = np.array([setup.channels[i].sign for i in rows])
    return np.asarray(setup.mode_shapes[rows] * sign[:, None], dtype=np.complex128)


def _members(setups: Sequence[ModalRecord], shared: Sequence[Dof], guard: float) -> IntArray:
    """Numbers of the modes that all set-ups have, (n_setups, n_modes)."""
    from scipy.optimize import linear_sum_assignment

    first = setups[0]
    pairs = [{i: i for i in range(first.n_modes)}]
    for setup in setups[1:]:
        distance = np.log(setup.frequency[None, :] / first.frequency[:, None]) / guard
        worth = mac(_rows(first, shared), _rows(setup, shared)) / (1 + distance**2)
        chosen = zip(*linear_sum_assignment(worth, maximize=True), strict=True)
        pairs.append({int(i): int(j) for i, j in chosen if worth[i, j] >= 0.5})
    kept = [i for i in range(first.n_modes) if all(i in own for own in pairs)]
    return np.array([[own[i] for i in kept] for own in pairs], dtype=int)


def _merged(setups: Sequence[ModalRecord], members: IntArray) -> Merging:
    n_setups, n_modes = members.shape
    frequency = np.array([s.frequency[m] for s, m in zip(setups, members, strict=True)])
    damping = np.array([s.damping_ratio[m] for s, m in zip(setups, members, strict=True)])
    values = np.concatenate([frequency, damping], axis=1)
    covariances = _covariances(setups, members)
    mean, covariance = _weighted_mean(values, covariances)
    chi_square, probability = _agreement(values[:, :n_modes], mean[:n_modes], covariances)
    notes = _notes(setups, members, frequency)
    doubtful = np.flatnonzero(np.nan_to_num(probability, nan=1.0) < _DOUBT / n_modes)
    if covariance is not None and doubtful.size:
        factor = np.ones(2 * n_modes)
        factor[doubtful] = np.sqrt(chi_square[doubtful] / (n_setups - 1))
        factor[doubtful + n_modes] = factor[doubtful]
        covariance = covariance * np.outer(factor, factor)
        notes += [_disagreement(i, frequency[:, i], probability[i], factor[i]) for i in doubtful.tolist()]
    order = np.argsort(mean[:n_modes], kind="stable")
    shapes, std, channels = _shapes(setups, members)
    both = np.concatenate([order, order + n_modes])
    modes = ModalRecord(
        mean[:n_modes][order], mean[n_modes:][order], shapes[:, order], channels,
        None if covariance is None else covariance[np.ix_(both, both)], None if std is None else std[:, order],
        tuple(notes), f"{n_setups} set-ups merged after identification: {setups[0].source}",
    )  # fmt: skip
    return Merging(
        modes, members[:, order], frequency[:, order], damping[:, order], frequency[:, order].std(axis=0, ddof=1),
        damping[:, order].std(axis=0, ddof=1), chi_square[order], probability[order],
    )  # fmt: skip


def _covariances(setups: Sequence[ModalRecord], members: IntArray) -> list[FloatArray] | None:
    """Of the frequencies, then damping ratios, of the paired modes of every set-up; None where one has none."""
    found = []
    for setup, own in zip(setups, members, strict=True):
        if setup.covariance is None:
            return None
        both = np.concatenate([own, own + setup.n_modes])
        part = setup.covariance[np.ix_(both, both)]
        if not (np.diag(part) > 0).all():
            return None
        found.append(part)
    return found


def _weighted_mean(values: FloatArray, covariances: list[FloatArray] | None) -> tuple[FloatArray, FloatArray | None]:
    """Mean over the set-ups with weights 1 / variance, each quantity by itself, and its covariance."""
    if covariances is None:
        return values.mean(axis=0), None
    weight = np.array([1 / np.diag(part) for part in covariances])
    weight = weight / weight.sum(axis=0)
    covariance = sum(np.outer(w, w) * part for w, part in zip(weight, covariances, strict=True))
    return (weight * values).sum(axis=0), np.asarray(covariance)


def _agreement(
    frequency: FloatArray, mean: FloatArray, covariances: list[FloatArray] | None
) -> tuple[FloatArray, FloatArray]:
    """Chi-square of the frequencies of every mode about their mean, and the probability of a larger one."""
    from scipy import special

    n_setups, n_modes = frequency.shape
    if covariances is None:
        return np.full(n_modes, np.nan), np.full(n_modes, np.nan)
    variance = np.array([np.diag(part)[:n_modes] for part in covariances])
    chi_square = ((frequency - mean) ** 2 / variance).sum(axis=0)
    return chi_square, special.gammaincc((n_setups - 1) / 2, chi_square / 2)


def _disagreement(mode: int, frequency: FloatArray, probability: float, factor: float) -> str:
    listed = ", ".join(f"{f:.5g}" for f in frequency)
    return (
        f"mode {mode + 1}: the set-ups disagree more than their intervals say ({listed} Hz, probability"
        f" {probability:.1g}): the structure changed between them, as with temperature or load, or a record is too short;"
        f" its standard deviations are {factor:.2g} times as wide. Measure the set-ups soon after one another"
    )


def _notes(setups: Sequence[ModalRecord], members: IntArray, frequency: FloatArray) -> list[str]:
    """Modes left out, and what the set-ups warn of."""
    notes = [f"set-up {i}: {words}" for i, setup in enumerate(setups, 1) for words in setup.warnings]
    for number, (setup, own) in enumerate(zip(setups, members, strict=True), 1):
        lost = np.delete(setup.frequency, own)
        if lost.size:
            listed = ", ".join(f"{f:.4g}" for f in lost)
            notes.append(f"set-up {number}: {listed} Hz are left out, since not all set-ups have such a mode")
    return notes


def _shapes(
    setups: Sequence[ModalRecord], members: IntArray
) -> tuple[ComplexArray, FloatArray | None, tuple[Dof, ...]]:
    """Merged shapes at all sensors, largest entry 1, their standard deviations, and the sensors."""
    channels = tuple(dict.fromkeys(dof.unsigned for setup in setups for dof in setup.channels))
    index = [np.array([channels.index(dof.unsigned) for dof in setup.channels]) for setup in setups]
    known = all(setup.shape_std is not None for setup in setups)
    shapes, stds = [], []
    for own in members.T:
        parts = [
            _rows(setup, [dof.unsigned for dof in setup.channels])[:, m] for setup, m in zip(setups, own, strict=True)
        ]
        errors = [_shape_error(setup, m) for setup, m in zip(setups, own, strict=True)]
        shape, std = merged_shape(parts, errors, index, len(channels))
        shapes.append(shape)
        stds.append(std)
    return np.array(shapes).T, np.array(stds).T if known else None, channels


def _shape_error(setup: ModalRecord, mode: int) -> FloatArray:
    """Standard deviation of every entry of the shape with its scale free; equal ones where none is known."""
    if setup.shape_std is None:
        return np.ones(len(setup.channels))
    shape = np.asarray(setup.mode_shapes[:, [mode]])
    largest = np.abs(shape).max()
    freed = unscaled_shape_std(shape / largest, setup.shape_std[:, [mode]] / largest)[:, 0] * largest
    return np.asarray(freed if (freed > 0).all() else np.ones(len(freed)))
