"""Sense, unit and level of every sensor and load, told from a record beside the initial model and from reciprocity.

All is told relative to the other channels: parameters that start far off move all channels alike, or by little.
Limits are set on right models whose parameters start 15 to 30 % off, each on its own: 220 studies of eight structures, 300
of a shear frame.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Literal, NamedTuple

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.dof import Dof
from structid.core.units import ACCELERATION_KINDS, MISTAKEN_FORCES, STANDARD_GRAVITY, mistaken_motions, mistaken_unit
from structid.diagnose.checks.aligned_responses import AlignedFrf, accord, median
from structid.records import FrfRecord

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
#: Standard deviations from where on a value stands out of its noise.
_CLEAR = 3.0
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

    Exchanged pairs are named before those that fit far worse; none with fewer than three sensors.

    `level` is the logarithm of measured over modelled magnitude, `agreement` the mean cosine of their phase angle, both
    (n_outputs, n_inputs).
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
