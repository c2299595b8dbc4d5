"""Errors of sensors and load cells in responses: gain, delay, polarity, and the decay of a window."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray, locked
from structid.core.dof import Dof
from structid.unknowns.named_unknowns import NamedUnknowns


class ChannelsOfRecord(Protocol):
    """Sensors, loads and lines of a record of any kind, on which errors of channels are declared."""

    @property
    def outputs(self) -> tuple[Dof, ...]: ...

    @property
    def inputs(self) -> tuple[Dof, ...]: ...

    @property
    def frequency(self) -> FloatArray:
        """Hz, ascending."""


@dataclass(frozen=True, eq=False)
class ChannelErrors(NamedUnknowns):
    """Errors of the channels of one record, as named parameters; made by `channel_unknowns.channel_errors`.

    The logarithm of a channel's reading over the truth is the sum of the logarithms of its gains, less s times the sum
    of its delays. A delay is judged against one radian at the highest line.

    Attributes
    ----------
    outputs, inputs : tuple of Dof
        Sensors and loads of the record.
    of_outputs, of_inputs : (n_params, n_outputs), (n_params, n_inputs) bool arrays
        Channels that each parameter belongs to.
    polarity_names : tuple of str
    polarity_outputs, polarity_inputs : (n_polarities, n_outputs), (n_polarities, n_inputs) bool arrays
        The channel that each polarity turns.
    polarities : (n_polarities,) float array
        +1 or -1.
    """

    outputs: tuple[Dof, ...]
    inputs: tuple[Dof, ...]
    of_outputs: np.ndarray
    of_inputs: np.ndarray
    polarity_names: tuple[str, ...]
    polarity_outputs: np.ndarray
    polarity_inputs: np.ndarray
    polarities: FloatArray

    @property
    def exponents(self) -> FloatArray:
        """Power of each parameter in the factor on each FRF, (n_params, n_outputs, n_inputs)."""
        return self.of_outputs[:, :, None].astype(float) - self.of_inputs[:, None, :]

    @property
    def polarity_members(self) -> np.ndarray:
        """FRFs whose sign each polarity turns, (n_polarities, n_outputs, n_inputs) bool."""
        members: np.ndarray = self.polarity_outputs[:, :, None] | self.polarity_inputs[:, None, :]
        return members

    def seen_by(self, record: ChannelsOfRecord) -> ChannelErrors:
        """A copy for another record of the same test, with its sensors and loads in place of those of this record.

        A channel with the same degree of freedom, in either direction, keeps its errors; one that only `record` has gets none.
        """
        outputs, inputs = (_places(own, other) for own, other in
                           ((self.outputs, record.outputs), (self.inputs, record.inputs)))  # fmt: skip
        return replace(
            self, outputs=record.outputs, inputs=record.inputs,
            of_outputs=_taken(self.of_outputs, outputs), of_inputs=_taken(self.of_inputs, inputs),
            polarity_outputs=_taken(self.polarity_outputs, outputs), polarity_inputs=_taken(self.polarity_inputs, inputs),
        )  # fmt: skip

    def rows(self, kind: str) -> IntArray:
        """Indices of the parameters of that kind."""
        return np.array([i for i, own in enumerate(self.kinds) if own == kind], dtype=int)

    def readings(self, physical: FloatArray, laplace: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Complex factors from true to read values: of sensors (n_frequencies, n_outputs) and of load cells (..., n_inputs).

        Parameters
        ----------
        physical : (n_params,) float array
        laplace : (n_frequencies,) complex array
            s, 1/s.
        """
        gains, delays = self.rows("gain"), self.rows("delay")
        sides = (self.of_outputs, self.polarity_outputs), (self.of_inputs, self.polarity_inputs)
        output, input_ = (
            np.where(turned, self.polarities[:, None], 1.0).prod(axis=0)
            * np.exp(np.log(physical[gains]) @ of[gains] - laplace[:, None] * (physical[delays] @ of[delays]))
            for of, turned in sides
        )
        return output, input_

    def factor(self, physical: FloatArray, laplace: ComplexArray) -> ComplexArray:
        """Factor of the channel errors on every FRF, (n_frequencies, n_outputs, n_inputs); see `readings`."""
        output, input_ = self.readings(physical, laplace)
        return output[:, :, None] / input_[:, None, :]

    def lateness(self, physical: FloatArray) -> FloatArray:
        """Delay of every FRF, s, (n_outputs, n_inputs), from the values `physical` (n_errors,) of the channel errors."""
        delays = self.rows("delay")
        late: FloatArray = np.tensordot(physical[delays], self.exponents[delays], 1)
        return late

    def log_slopes(self, physical: FloatArray, laplace: ComplexArray) -> ComplexArray:
        """Derivative of the logarithm of `factor` by each physical parameter, (n_frequencies, n_outputs, n_inputs, n_params).

        `physical` (n_params,) are the errors, `laplace` (n_frequencies,) is s in 1/s. The column of a window's decay, which
        shifts s, is 0.
        """
        return np.einsum("fk,koi->foik", self._each_slope(physical, laplace), self.exponents)

    def output_slopes(self, physical: FloatArray, laplace: ComplexArray) -> ComplexArray:
        """Derivative of the logarithm of each sensor's reading by the errors, (n_frequencies, n_outputs, n_params).

        `physical` (n_params,) are the errors, `laplace` (n_frequencies,) is s in 1/s.
        """
        return np.einsum("fk,ko->fok", self._each_slope(physical, laplace), self.of_outputs)

    def _each_slope(self, physical: FloatArray, laplace: ComplexArray) -> ComplexArray:
        """Derivative of the logarithm of a reading by each error, (n_frequencies, n_params): 1 / gain, or -s for a delay.

        `physical` (n_params,) are the errors, `laplace` (n_frequencies,) is s in 1/s. The column of a window's decay is 0.
        """
        slopes = np.zeros((len(laplace), self.n_params), dtype=np.complex128)
        gains = self.rows("gain")
        slopes[:, gains] = 1 / physical[gains]
        slopes[:, self.rows("delay")] = -laplace[:, None]
        return slopes

    def decay(self, physical: FloatArray) -> float | None:
        """The window's decay, 1/s, where it is a parameter."""
        rows = self.rows("window_decay")
        return float(physical[rows[0]]) if len(rows) else None

    def decided(self, measured: ComplexArray, predicted: ComplexArray) -> ChannelErrors:
        """Copy of these errors with the polarities by which model and measurement agree best in phase.

        Each line of each FRF has one vote, so that resonances do not outweigh the rest; one polarity is decided after
        another until none changes.

        Parameters
        ----------
        measured, predicted : (n_frequencies, n_outputs, n_inputs) complex arrays
            The record, and the model with the present polarities.
        """
        size = np.maximum(np.abs(measured) * np.abs(predicted), np.finfo(float).tiny)
        every = self.polarity_members
        sign = np.where(every, self.polarities[:, None, None], 1.0).prod(axis=0)
        votes = ((np.conj(predicted) * measured).real / size).sum(axis=0) * sign
        polarities = np.array(self.polarities)
        for _ in range(1 + len(polarities)):
            before = polarities.copy()
            for k, members in enumerate(every):
                others = np.where(every, polarities[:, None, None], 1.0).prod(axis=0) * polarities[k]
                polarities[k] = 1.0 if (votes * others)[members].sum() >= 0 else -1.0
            if (before == polarities).all():
                break
        return replace(self, polarities=locked(polarities))


def _places(own: tuple[Dof, ...], others: tuple[Dof, ...]) -> list[int]:
    """Index in `own` of each degree of freedom in `others`, regardless of direction; -1 where `own` lacks it."""
    places = {dof.unsigned: i for i, dof in enumerate(own)}
    return [places.get(dof.unsigned, -1) for dof in others]


def _taken(members: np.ndarray, places: list[int]) -> np.ndarray:
    """Columns `places` of the mask `members` (n_params, n_channels); False where a place is -1."""
    wider = np.concatenate([members, np.zeros((len(members), 1), dtype=bool)], axis=1)
    return locked(wider[:, places])
