"""What the least-squares problem of one record offers to those who solve, check and show it, beside `Problem`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Self, cast

import numpy as np
from scipy import sparse

from structid.core.arrays import ComplexArray, FloatArray, IntArray, locked
from structid.fem import Structure
from structid.forward.channel_errors import ChannelErrors, Measured
from structid.inversion.linearization import Linearization
from structid.inversion.problem import BaseProblem, OfUnknowns
from structid.unknowns import Parameters
from structid.unknowns.named_unknowns import NamedUnknowns, joined
from structid.unknowns.priors import held_rows

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


class NamedProblem(OfUnknowns, BaseProblem):
    """A problem of named unknowns."""

    @property
    @abstractmethod
    def unknowns(self) -> NamedUnknowns:
        """All that is unknown, with starts, ranges and priors."""

    @abstractmethod
    def residual(self, theta: FloatArray) -> FloatArray: ...

    @abstractmethod
    def linearize(self, theta: FloatArray) -> Linearization: ...

    def prior_rows(self, theta: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        residual, rows = self.unknowns.sparse_prior_rows(self.physical(theta))
        members, held, weights = held_rows(self.unknowns.held, theta)
        last = sparse.csr_array((weights, (np.arange(len(members)), members)), (len(members), len(theta)))
        scaled = rows @ sparse.diags_array(self.slope(theta))
        return np.concatenate([residual, held]), sparse.csr_array(sparse.vstack([scaled, last]))

    def _residual(self, theta: FloatArray, data: FloatArray) -> FloatArray:
        """Data rows, then those of the priors."""
        return np.concatenate(
            [data, self.unknowns.prior_residual(self.physical(theta)), held_rows(self.unknowns.held, theta)[1]]
        )

    def _linearized(
        self, theta: FloatArray, data: FloatArray, change: FloatArray, n_eliminated: int = 0
    ) -> Linearization:
        """Data rows with their derivative with respect to the free variables, then those of the priors."""
        residual, rows = self.unknowns.prior_rows(self.physical(theta))
        members, held, weights = held_rows(self.unknowns.held, theta)
        last = np.zeros((len(members), len(theta)))
        last[np.arange(len(members)), members] = weights
        jacobian = np.concatenate([change, rows * self.slope(theta), last])
        return Linearization(np.concatenate([data, residual, held]), jacobian, n_eliminated)


class ParameterProblem(NamedProblem):
    """A problem whose unknowns are the parameters of a structure."""

    parameters: Parameters

    @property
    def unknowns(self) -> NamedUnknowns:
        return self.parameters


@dataclass(frozen=True, eq=False)
class DataRows:
    """What the data rows of a problem are about.

    Attributes
    ----------
    lines, series : (n_data,) int arrays
        See `Problem`.
    names : tuple of str
        What each of `series` stands for, in their order.
    quantities : (n_data,) int array, optional
        See `Data`.
    """

    lines: IntArray
    series: IntArray
    names: tuple[str, ...]
    quantities: IntArray | None = None


def complex_rows(n_lines: int, names: Sequence[str]) -> DataRows:
    """Real parts of the values of all lines and channels, channels fastest, then imaginary parts, called alike."""
    index, channel = np.repeat(np.arange(n_lines), len(names)), np.tile(2 * np.arange(len(names)), n_lines)
    both = tuple(name for name in names for _ in range(2))
    return DataRows(np.concatenate([index, index]), np.concatenate([channel, channel + 1]), both)


@dataclass(frozen=True, eq=False)
class RecordFacts:
    """What is known of a problem's record beside its data.

    Attributes
    ----------
    line_spacing : (n_lines,) float array
        Distance of the used lines at each of them, Hz; NaN where lines resolve no resonance, as where modes were measured.
    window_bandwidth : (n_lines,) float array
        What an exponential window adds to the half-power bandwidth at each line, Hz.
    noise : str
        The noise that the residual is whitened by, by where it comes from.
    measures_force : bool
        Whether the record fixes the size of masses and stiffnesses, which is free without a measured force.
    leaves_damping_out : bool
        Whether damping was measured and does not count.
    n_channels : int
        Pairs of sensor and load, for the memory that they take.
    record : object
        The record itself, for the memory that it takes; None where it is not kept.
    """

    line_spacing: FloatArray
    window_bandwidth: FloatArray
    noise: str = "the stated noise"
    measures_force: bool = True
    leaves_damping_out: bool = False
    n_channels: int = 1
    record: object = None


class OfRows(ABC):
    """What has `rows` of data, and answers for them."""

    @property
    @abstractmethod
    def rows(self) -> DataRows: ...

    @property
    def n_data(self) -> int:
        return len(self.rows.lines)

    @property
    def lines(self) -> IntArray:
        return self.rows.lines

    @property
    def series(self) -> IntArray:
        return self.rows.series

    @property
    def quantities(self) -> IntArray | None:
        return self.rows.quantities


class Undecided:
    """What a search settles beside the parameters, signs and weights; there is nothing of it where others do not say more."""

    @property
    def polarities(self) -> FloatArray:
        """+1 or -1 of all that no continuous search can decide."""
        return locked(np.zeros(0))

    def decided(self, theta: FloatArray) -> Self:
        """The same with the polarities that the model at `theta` asks for."""
        return self

    def with_polarities(self, signs: Sequence[float]) -> Self:
        """The same with these polarities."""
        return self

    def reweighted(self, theta: FloatArray) -> Self:
        """The same with errors that are a part of each value's size taken of what the model has at `theta`.

        As a part of the *measured* size they are held smaller where noise makes a value small, which then weighs more: masses
        and stiffnesses come out too high by about the square of the noise. Itself where no error depends on size.
        """
        return self


class RecordProblem(OfRows, Undecided, ParameterProblem):
    """The problem of one record of responses, modes or time histories; what it does not say has a default here."""

    structure: Structure

    @property
    @abstractmethod
    def frequency(self) -> FloatArray:
        """Lines (or modes) that are used, Hz, ascending."""

    @property
    def matrix_free_obstacle(self) -> str:
        return "takes FRFs, not time histories that are fitted themselves"

    @property
    def parts(self) -> tuple[NamedUnknowns, ...]:
        """What `unknowns` is made of: the parameters of the structure first."""
        return (self.parameters,)

    @abstractmethod
    def with_parts(self, parts: Sequence[NamedUnknowns]) -> Self:
        """The same data with other starts or priors of its `parts`."""

    def with_parameters(self, parameters: Parameters) -> Self:
        """The same data with other starts or priors of the structure's parameters."""
        return self.with_parts((parameters, *self.parts[1:]))

    def held(self, mean: FloatArray, std: FloatArray) -> Self:
        """The same with a Gaussian prior on its free variables besides; see `NamedUnknowns.held`."""
        ends = np.cumsum([part.n_params for part in self.parts])[:-1]
        own = zip(self.parts, np.split(mean, ends), np.split(std, ends), strict=True)
        return self.with_parts([replace(part, held=(m, s)) for part, m, s in own])

    def property_values(self, physical: FloatArray) -> FloatArray:
        """Property values of the structure at physical parameters of all `parts`, (n_values,)."""
        return self.parameters.values(physical[: self.parameters.n_params])

    @property
    def channels(self) -> ChannelErrors | None:
        """Errors of its channels, where they are unknown."""
        return None

    @property
    def facts(self) -> RecordFacts:
        """What is known of the record beside its data."""
        n_lines = len(self.frequency)
        return RecordFacts(np.full(n_lines, np.nan), np.zeros(n_lines))

    @property
    def is_large(self) -> bool:
        """Whether a few lines are enough to tell what all of them cost."""
        return False

    @property
    def is_reduced(self) -> bool:
        """Whether predictions come from a reduced basis, and are off by a small part of their own."""
        return False

    def with_lines(self, keep: IntArray) -> Self:
        """The same on some of its lines, to measure what they cost; the whole where there is no such part."""
        return self


class MeasuredProblem(RecordProblem):
    """The problem of a record whose sensors, and load cells where there are some, may have unknown errors.

    The parameters of its `channels`, where it has some, follow those of the structure.
    """

    @cached_property
    def unknowns(self) -> NamedUnknowns:
        """Parameters of the structure, then those of the record's channels."""
        return self.parameters if self.channels is None else joined(self.parameters, self.channels)

    @property
    def parts(self) -> tuple[NamedUnknowns, ...]:
        return (self.parameters,) if self.channels is None else (self.parameters, self.channels)

    def with_parts(self, parts: Sequence[NamedUnknowns]) -> Self:
        parameters, *channels = parts
        errors = cast(ChannelErrors, channels[0]) if channels else None
        return self.with_errors(errors, cast(Parameters, parameters))

    def with_errors(self, channels: ChannelErrors | None, parameters: Parameters | None = None) -> Self:
        """The same data with other errors of channels, and other parameters of the structure where they are given."""
        kept = self.parameters if parameters is None else parameters
        return cast(Self, replace(cast("DataclassInstance", self), channels=channels, parameters=kept))


class ResponseProblem(MeasuredProblem):
    """The problem of a record of responses, whose sensors and load cells may also be turned round."""

    @property
    @abstractmethod
    def measured(self) -> Measured:
        """Sensors, loads and lines of what was measured."""

    @property
    def polarities(self) -> FloatArray:
        return super().polarities if self.channels is None else self.channels.polarities

    def decided(self, theta: FloatArray) -> Self:
        if self.channels is None or not self.channels.polarity_names:
            return self
        return self.with_errors(self.channels.decided(*self.compared(theta)))

    @abstractmethod
    def compared(self, theta: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Measured and predicted responses by which polarities are decided, (n_frequencies, n_outputs, n_inputs)."""

    def with_polarities(self, signs: Sequence[float]) -> Self:
        if self.channels is None:
            return self
        return self.with_errors(replace(self.channels, polarities=locked(signs, float)))
