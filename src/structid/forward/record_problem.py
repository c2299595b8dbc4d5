"""The least-squares problem of one record: a structure with unknown parameters against measured responses or modes."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Self, TypeVar, cast

import numpy as np
from scipy import sparse

from structid.core.arrays import ComplexArray, FloatArray, IntArray, locked
from structid.core.errors import InputError
from structid.fem import Structure
from structid.forward.channel_errors import ChannelErrors, ChannelsOfRecord
from structid.inversion.linearization import Linearization, OperatorLinearization
from structid.inversion.problem import ContinuationPath, DataRows, Problem, Schedule
from structid.unknowns import Parameters
from structid.unknowns.named_unknowns import NamedUnknowns, join_unknowns
from structid.unknowns.priors import free_prior_rows

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def residual_with_priors(unknowns: NamedUnknowns, theta: FloatArray, data: FloatArray) -> FloatArray:
    """Whitened `data` rows, then the residuals of all priors at the free variables `theta`, (n_residuals,)."""
    return np.concatenate(
        [data, unknowns.prior_residual(unknowns.physical(theta)), free_prior_rows(unknowns.free_prior, theta)[1]]
    )


def linearization_with_priors(
    unknowns: NamedUnknowns, theta: FloatArray, data: FloatArray, change: FloatArray, n_eliminated: int = 0
) -> Linearization:
    """Residual and Jacobian at the free variables `theta`: data rows, then priors of parameters and of free variables.

    Parameters
    ----------
    unknowns : NamedUnknowns
    theta : (n_params,) float array
    data : (n_data,) float array
        Whitened data rows.
    change : (n_data, n_params) float array
        Their derivative with respect to the free variables.
    n_eliminated : int
        Unknowns that were solved for inside the data rows; each takes one degree of freedom from chi-square.
    """
    residual, rows = unknowns.prior_rows(unknowns.physical(theta))
    members, free_residual, weights = free_prior_rows(unknowns.free_prior, theta)
    free_rows = np.zeros((len(members), len(theta)))
    free_rows[np.arange(len(members)), members] = weights
    jacobian = np.concatenate([change, rows * unknowns.slope(theta), free_rows])
    return Linearization(np.concatenate([data, residual, free_residual]), jacobian, n_eliminated)


def sparse_prior_rows(unknowns: NamedUnknowns, theta: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
    """Residual (n_priors,) of all priors at the free variables `theta` (n_params,), and its sparse derivative.

    Rows are priors of parameters, then those of free variables; the derivative (n_priors, n_params) is by the free
    variables.
    """
    residual, rows = unknowns.sparse_prior_rows(unknowns.physical(theta))
    members, free_residual, weights = free_prior_rows(unknowns.free_prior, theta)
    free_rows = sparse.csr_array((weights, (np.arange(len(members)), members)), (len(members), len(theta)))
    scaled = rows @ sparse.diags_array(unknowns.slope(theta))
    return np.concatenate([residual, free_residual]), sparse.csr_array(sparse.vstack([scaled, free_rows]))


def complex_rows(n_lines: int, names: Sequence[str], averages: FloatArray | None = None) -> DataRows:
    """Labels of data rows for complex values: real parts of all lines and channels first, then imaginary parts.

    In each part lines vary slowest. Channel k (from 0) of `names` has two series, 2 k (real) and 2 k + 1 (imaginary).
    `averages` (n_data,) are the numbers of averages behind the variances, None if these are known.
    """
    index, channel = np.repeat(np.arange(n_lines), len(names)), np.tile(2 * np.arange(len(names)), n_lines)
    both = tuple(name for name in names for _ in range(2))
    lines, series = np.concatenate([index, index]), np.concatenate([channel, channel + 1])
    return DataRows(lines, series, both, averages=averages)


@dataclass(frozen=True, eq=False)
class RecordFacts:
    """Facts about a problem's record beside its data.

    Attributes
    ----------
    line_spacing : (n_lines,) float array
        Distance of the used lines at each of them, Hz; NaN where lines resolve no resonance, as where modes were
        measured.
    window_bandwidth : (n_lines,) float array
        What an exponential window adds to the half-power bandwidth at each line, Hz.
    noise : str
        The noise that the residual is whitened by, by where it comes from.
    measures_force : bool
        Whether the record fixes the size of masses and stiffnesses, which is free without a measured force.
    takes_clock_for_stiffness : bool
        Whether frequencies that all read c times too high are what c^2 times all stiffnesses give. That holds for
        modes, and for accelerations per force or per motion of supports: A(s) of masses M and stiffnesses K is that of
        M and c^2 K at c s. Dashpots differ by c alone, which lightly damped records do not tell.
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
    takes_clock_for_stiffness: bool = False
    leaves_damping_out: bool = False
    n_channels: int = 1
    record: object = None


class RecordProblem(Problem):
    """The problem of one record: it has a `structure` with `parameters`, a record, and may have errors of `channels`.

    A class of problems states the seam of `Problem` (the data rows, residual and Jacobian) and its `frequency`.
    Everything else has a default.
    """

    structure: Structure
    parameters: Parameters
    channels: ChannelErrors | None = None
    #: True where the record holds modes, False where it holds responses.
    compares_modes: ClassVar[bool] = False
    #: True where finite Fourier transforms of histories are compared.
    compares_spectra: ClassVar[bool] = False

    @cached_property
    def unknowns(self) -> NamedUnknowns:
        """Parameters of the structure, then those of the record's channels."""
        return self.parameters if self.channels is None else join_unknowns(self.parameters, self.channels)

    def linearize_operator(self, theta: FloatArray) -> OperatorLinearization:
        raise InputError(f"a matrix-free search {self.matrix_free_obstacle}; take a search with a Jacobian")

    def prior_rows(self, theta: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        return sparse_prior_rows(self.unknowns, theta)

    @property
    @abstractmethod
    def frequency(self) -> FloatArray:
        """Lines (or modes) that are used, Hz, ascending."""

    @property
    def facts(self) -> RecordFacts:
        """Facts about the record beside its data."""
        n_lines = len(self.frequency)
        return RecordFacts(np.full(n_lines, np.nan), np.zeros(n_lines))

    @property
    def measured_responses(self) -> ChannelsOfRecord | None:
        """Sensors, loads and lines of measured responses; None where the record has no responses."""
        return None

    def measured_and_predicted(self, theta: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Responses by whose phase polarities of channels are decided, (n_frequencies, n_outputs, n_inputs) each."""
        raise NotImplementedError(f"{type(self).__name__} decides no polarity of channels")

    def property_values(self, physical: FloatArray) -> FloatArray:
        """Property values of the structure at physical parameters, those of channels included, (n_values,)."""
        return self.parameters.values(physical[: self.parameters.n_params])

    @property
    def is_large(self) -> bool:
        """True where a few lines are enough to measure the cost of all of them."""
        return False

    @property
    def is_reduced(self) -> bool:
        """True where predictions come from a reduced basis, with a small error of their own."""
        return False

    @property
    def matrix_free_obstacle(self) -> str:
        """Reason why a matrix-free search of this record is impossible; "" if it is possible.

        It goes on a sentence that begins with the search, as in "a matrix-free search takes no dry friction".
        """
        return "takes FRFs, not time histories that are fitted themselves"

    def schedules(self) -> Sequence[Schedule]:
        """Easier forms of the problem for poor starts, in several alternative sequences; () where there are none."""
        return ()

    def continuation_paths(self) -> Sequence[ContinuationPath]:
        """Paths to the answer that a search with restarts takes in turn: `schedules`, and those made for a start."""
        return self.schedules()

    def subsampled(self) -> Self | None:
        """The problem with a part of its data, for searches; None where it is small enough."""
        return None

    @property
    def parts(self) -> tuple[NamedUnknowns, ...]:
        """The parameters of the structure, then those of the channels if there are any."""
        return (self.parameters,) if self.channels is None else (self.parameters, self.channels)

    def with_parts(self, parts: Sequence[NamedUnknowns]) -> Self:
        """Copy of the problem with other unknowns, such as other starts or priors.

        `parts` are the parameters of the structure and, if the problem has channel errors, these second.
        """
        changed: dict[str, object] = {"parameters": parts[0]}
        if len(parts) > 1:
            changed["channels"] = parts[1]
        return cast(Self, replace(cast("DataclassInstance", self), **changed))

    def with_parameters(self, parameters: Parameters) -> Self:
        """A copy with other starts or priors of the structure's parameters."""
        return self.with_parts((parameters, *self.parts[1:]))

    def with_structure(self, structure: Structure, parameters: Parameters) -> Self | None:
        """A copy with another structure and its parameters, same data and weights; None if data depend on these."""
        changed: dict[str, object] = {"structure": structure, "parameters": parameters}
        return cast(Self, replace(cast("DataclassInstance", self), **changed))

    def with_channels(self, channels: ChannelErrors) -> Self:
        """A copy with other errors of channels."""
        return self.with_parts((self.parameters, channels))

    def with_free_prior(self, mean: FloatArray, std: FloatArray) -> Self:
        """A copy with a Gaussian prior `mean`, `std` on its free variables, (n_params,) each."""
        ends = np.cumsum([part.n_params for part in self.parts])[:-1]
        priors = zip(self.parts, np.split(mean, ends), np.split(std, ends), strict=True)
        return self.with_parts([replace(part, free_prior=(m, s)) for part, m, s in priors])

    def with_lines(self, keep: IntArray) -> Self:
        """A copy on some of its lines, to measure their cost; the whole where the problem has no such part."""
        return self

    def reweighted(self, theta: FloatArray) -> Self:
        """A copy whose errors in proportion to a value are taken of the model's values at `theta`; itself by default.

        Errors as a part of the measured value favour values that noise makes small, so that masses and stiffnesses come
        out too high by about the square of the noise.
        """
        return self


P = TypeVar("P", bound=RecordProblem)


def polarities(problem: RecordProblem) -> tuple[float, ...]:
    """Polarity of each channel of `problem` whose polarity is unknown, +1 or -1."""
    return () if problem.channels is None else tuple(problem.channels.polarities.tolist())


def with_polarities(problem: P, signs: Sequence[float]) -> P:
    """A copy of `problem` with the polarities `signs`, +1 or -1 for each unknown one; itself without channel errors."""
    if problem.channels is None:
        return problem
    return problem.with_channels(replace(problem.channels, polarities=locked(signs, float)))


def decide_polarities(problem: P, theta: FloatArray) -> P:
    """A copy of `problem` with the polarities by which the model at `theta` agrees best in phase with the measurement.

    `theta` (n_params,) are free variables. Without polarities the problem itself is returned.
    """
    if problem.channels is None or not problem.channels.polarity_names:
        return problem
    return problem.with_channels(problem.channels.decided(*problem.measured_and_predicted(theta)))
