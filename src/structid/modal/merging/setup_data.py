"""Motion channels of several set-ups in one order and scale: references first, then each set-up's own sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from structid.arrays import FloatArray
from structid.dof import Dof
from structid.errors import InputError
from structid.modal.correlations import outputs
from structid.records import TimeRecord


@dataclass(frozen=True, eq=False)
class SetupData:
    """Channels of all set-ups, dimensionless and of one level of excitation.

    Attributes
    ----------
    series : tuple of (n_times, n_own) float arrays
        One a set-up, references first in one order; positive along the axes.
    scale : (n_channels,) float array
        By which each of `channels` was divided, besides the level of its set-up.
    channels : tuple of Dof
        References, then the other sensors of each set-up in turn.
    n_references : int
    sampling_rate : float
        Hz.
    notes : tuple of str
        Sensors left out.
    """

    series: tuple[FloatArray, ...]
    scale: FloatArray
    channels: tuple[Dof, ...]
    n_references: int
    sampling_rate: float
    notes: tuple[str, ...]

    @property
    def duration(self) -> float:
        """Of the longest record, s."""
        return max(len(y) for y in self.series) / self.sampling_rate


def setup_data(setups: Sequence[TimeRecord], references: Sequence[Dof]) -> SetupData:
    """The channels of `setups`.

    The level of a set-up and the scale of a reference are those factors whose products are nearest, in the logarithm,
    to the root mean squares of the references: a louder set-up then counts as much as a quiet one. A sensor that two
    set-ups have but not all is taken from the first.

    Raises
    ------
    InputError
        If quantities or sampling rates differ, or a channel is dead.
    """
    found = [outputs(setup) for setup in setups]
    kinds = {quantity for data in found for quantity in data.quantities}
    if len(kinds) > 1:
        raise InputError(f"`setups` must hold one kind of motion, got {', '.join(sorted(kinds))}; select channels")
    rates = [data.sampling_rate for data in found]
    if not np.allclose(rates, rates[0], rtol=1e-9):
        raise InputError(f"`setups` must be sampled at one rate, got {', '.join(f'{r:g}' for r in rates)} Hz; resample")
    place = [{dof.unsigned: i for i, dof in enumerate(data.channels)} for data in found]
    rms = np.array([[data.scale[own[dof]] for dof in references] for data, own in zip(found, place, strict=True)])
    level, of_reference = _levels(rms)
    taken, channels, scale = set(references), list(references), of_reference.tolist()
    series, notes = [], []
    for number, (data, own, loudness) in enumerate(zip(found, place, level, strict=True), 1):
        new = [dof for dof in own if dof not in taken]
        twice = [str(dof) for dof in own if dof in taken and dof not in references]
        if twice:
            notes.append(f"set-up {number}: {', '.join(twice)} is measured in an earlier set-up and left out here")
        columns = np.array([own[dof] for dof in (*references, *new)])
        divisor = np.array([*of_reference, *(data.scale[own[dof]] / loudness for dof in new)])
        sign = np.array([data.channels[i].sign for i in columns])
        series.append(data.series[0][:, columns] * (data.scale[columns] * sign / (divisor * loudness)))
        channels += new
        scale += divisor[len(references) :].tolist()
        taken |= set(new)
    return SetupData(tuple(series), np.array(scale), tuple(channels), len(references), rates[0], tuple(notes))


def _levels(rms: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Factors of set-ups and of references, (n_setups,) and (n_references,), from rms (n_setups, n_references)."""
    logarithm = np.log(rms)
    of_reference = logarithm.mean(axis=0)
    return np.exp(logarithm.mean(axis=1) - of_reference.mean()), np.exp(of_reference)
