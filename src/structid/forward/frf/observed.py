"""FRFs as a record has them: with errors of sensors, load cells and measured components, and from averaged segments.

Under a stationary random force the expected cross spectrum of Hann-windowed segments is that of the force times the FRF,
averaged over the lines around with the power spectrum of the window (Bendat and Piersol 2010, section 11.5). In time
the impulse response is multiplied by the correlation of the window with itself, which for segments of duration T is 1
at no lag and 0 from T on. Written as a sum of decaying oscillations, sum of c exp(-a t / T), it makes of H(s) the sum
of c H(s + a / T).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.core.errors import InputError
from structid.fem.measured import MeasuredComponent
from structid.forward.channel_errors import ChannelErrors
from structid.forward.frf.line_equations import matrix_coefficients, read
from structid.forward.frf.products import Whitening
from structid.forward.frf.response import Response
from structid.forward.frf.solvers import SubstructureCoupling
from structid.inversion.problem import RowNoise
from structid.records import FrfRecord
from structid.records.record import DERIVATIVES, FrfKind

#: Rows of the covariance that are made at most, in entries.
_MOST_ENTRIES = 20_000_000
#: a and c with its conjugate for each pair: within 1.1e-4 of the correlation of a Hann window at every lag, up to 5 T.
_RATES = np.array([7.1280398 + 2.4029110j, 6.3283629 + 7.2468134j, 4.2522907 + 12.3814214j])
_PARTS = 0.5 * np.array([2.0649946 + 3.6948381j, -1.1024809 - 0.0996842j, 0.0374863 - 0.0205247j])
RATES, PARTS = np.concatenate([_RATES, _RATES.conj()]), np.concatenate([_PARTS, _PARTS.conj()])
#: Lines from the lowest on that read what leaks from below 0 Hz.
LEAST_LINE = 2.0


@dataclass(frozen=True, eq=False)
class ErrorsOfEntry:
    """One entry of a component's receptance, and its reciprocal one.

    Attributes
    ----------
    deviation : (n_own,) float array
        Standard deviation of its real part, and of its imaginary part, at each of the component's own lines.
    weights : (n_own, n_lines) sparse array
        Weight of each of these lines in the receptance at each line of the record.
    change : (n_lines, n_outputs, n_inputs) complex array
        Change of the response per unit change of the entry, at each line of the record.
    """

    deviation: FloatArray
    weights: sparse.csr_array
    change: ComplexArray


def errors_of_entries(model: Response, physical: FloatArray) -> Iterator[ErrorsOfEntry]:
    """Yield an `ErrorsOfEntry` for each entry (i, j), i <= j, of every measured component of stated variance.

    It has the standard deviation of the receptance entry (m/N), its weight at each line of the model, and the change of
    the FRFs, in the kind of the record, per m/N: g' dY q, with g and q the interface forces under a unit force at a
    sensor and under the load, at parameters `physical` (n_params,). An entry and its reciprocal count as one.
    """
    solver, structure = model.solver, model.slopes.structure
    if not isinstance(solver, SubstructureCoupling) or all(
        component.variance is None for component in structure.measured
    ):
        return
    forces = solver.forces(physical, model.fixed_coefficients)
    sides = model.channels
    g, q = sides.under_sensors(forces)[..., : sides.n_outputs], sides.under_loads(forces)
    first = solver.n_driven
    for component in structure.measured:
        n = len(component.interface)
        if component.variance is not None:
            weights = component.weights_at(model.frequency)
            for i, j in zip(*(index.tolist() for index in np.triu_indices(n)), strict=True):
                change = g[:, first + i, :, None] * q[:, first + j, None]
                if i != j:
                    change = change + g[:, first + j, :, None] * q[:, first + i, None]
                yield ErrorsOfEntry(_deviation(component, i, j), weights, change * model.kind_factor[:, None, None])
        first += n


def _deviation(component: MeasuredComponent, i: int, j: int) -> FloatArray:
    """Standard deviation (n_own,) of either part of the mean of entries (i, j) and (j, i) of a measured component.

    Parts are the real and the imaginary one; `i` and `j` count its interface from 0. The unit is m/N. `n_own` is the
    number of lines of the component; it must have a variance.
    """
    assert component.variance is not None
    variance = component.variance[:, i, j]
    if i != j:
        variance = (variance + component.variance[:, j, i]) / 4
    return np.sqrt(variance / 2)


@dataclass(frozen=True, eq=False)
class ComponentNoise:
    """Noise of whitened data rows with errors of measured components, which vary together from row to row.

    Attributes
    ----------
    entries : callable
        Gives the errors of every entry of the components' receptances.
    whitening : Whitening
    rows : RowNoise
        Noise of the data themselves.
    n_data : int
    """

    entries: Callable[[], Iterator[ErrorsOfEntry]]
    whitening: Whitening
    rows: RowNoise
    n_data: int

    @property
    def factor(self) -> FloatArray | None:
        """Rows of unit variance, then those of every error, (n_data + n_errors, n_data); None if they are too many."""
        rows = error_rows(self.entries(), self.whitening)
        return None if rows is None else np.concatenate([np.eye(self.n_data), rows])

    def score_covariance(self, jacobian: FloatArray) -> FloatArray:
        """Covariance of J'r over the errors of data and components, (n_params, n_params).

        `jacobian` (n_data, n_params) are the data rows J.
        """
        covariance = self.rows.score_covariance(jacobian)
        return (jacobian.T @ jacobian if covariance is None else covariance) + error_score_covariance(
            self.entries(), self.whitening, jacobian
        )


def error_score_covariance(errors: Iterator[ErrorsOfEntry], whitening: Whitening, jacobian: FloatArray) -> FloatArray:
    """Covariance (n_params, n_params) of J'e, with e the whitened error of FRFs by errors of measured components.

    `errors` has the standard deviation of each entry of the components' receptances and its effect, `whitening` the
    weights of the data. J is `jacobian` (n_data, n_params), the whitened data rows, real parts before imaginary parts.
    """
    n_params = jacobian.shape[1]
    top, low = np.split(jacobian, 2)
    total = np.zeros((n_params, n_params))
    for entry, rows in _whitened_changes(errors, whitening):
        by_line = np.einsum("lc,lcp->lp", rows.real, top.reshape(*rows.shape, n_params))
        by_line += np.einsum("lc,lcp->lp", rows.imag, low.reshape(*rows.shape, n_params))
        factor = entry.deviation[:, None] * (entry.weights @ by_line)
        total += factor.T @ factor
    return total


def error_rows(errors: Iterator[ErrorsOfEntry], whitening: Whitening) -> FloatArray | None:
    """Change of the whitened data by one standard deviation of each component error, (n_errors, n_data).

    Rows follow `errors` (one at least), the real part of an entry before the imaginary one, lines of its component
    fastest. Columns are real parts of the data, then imaginary ones. `whitening` turns changes of the FRFs into those
    of the data. None if n_data (n_data + n_errors) exceeds 2e7.
    """
    changes: list[FloatArray] = []
    for entry, rows in _whitened_changes(errors, whitening):
        n_data, n_changes = 2 * rows.size, (len(changes) + 1) * len(entry.deviation)
        if n_data * (n_data + n_changes) > _MOST_ENTRIES:
            return None
        wide = entry.deviation[:, None, None] * entry.weights.toarray()[:, :, None] * rows
        flat = wide.reshape(len(wide), -1)
        changes.append(np.concatenate([flat.real, flat.imag], axis=1))
    return np.concatenate(changes)


def _whitened_changes(
    errors: Iterator[ErrorsOfEntry], whitening: Whitening
) -> Iterator[tuple[ErrorsOfEntry, ComplexArray]]:
    """Yield each entry of `errors` twice, with the whitened data per unit of its real, then imaginary part.

    Data are complex, (n_lines, n_channels); `whitening` turns changes of the response into those of the data. Channels
    are outputs, each with all its inputs.
    """
    for entry in errors:
        for part in (1.0, 1j):
            rows = whitening.rows(part * entry.change[..., None])
            yield entry, rows.reshape(len(rows), -1)


@dataclass(frozen=True, eq=False)
class ObservedFrf:
    """FRFs as a record has them, for physical parameters: those of the structure, then those of the channels.

    Parameters
    ----------
    model : Response
    channels : ChannelErrors or None
    record : FrfRecord
        Gives lines and kind.
    """

    model: Response
    channels: ChannelErrors | None
    record: FrfRecord

    def values(self, physical: FloatArray) -> ComplexArray:
        """FRFs with channel errors, (n_frequencies, n_outputs, n_inputs), in the kind of the record.

        `physical` (n_params,) are the parameters of the structure, then those of the channels.
        """
        if self.channels is None:
            return self.model.values_at(physical)
        of_structure, of_channels = np.split(physical, [self.model.parameters.n_params])
        model, laplace = self._shift_by_decay(self.channels, of_channels)
        return model.values_at(of_structure) * self.channels.factor(of_channels, laplace)

    def derivatives(self, physical: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """FRFs with channel errors, (n_frequencies, n_outputs, n_inputs), and their derivatives, (..., n_params).

        Derivatives are by `physical` (n_params,), the parameters of the structure, then those of the channels; FRFs are
        in the kind of the record.
        """
        if self.channels is None:
            return self.model.derivatives_at(physical)
        of_structure, of_channels = np.split(physical, [self.model.parameters.n_params])
        model, laplace = self._shift_by_decay(self.channels, of_channels)
        values, derivative = model.derivatives_at(of_structure)
        change = self.channels.log_slopes(of_channels, laplace) * values[..., None]
        for row in self.channels.rows("window_decay"):
            steep = _laplace_slope(model, of_structure, values, laplace, self.record.kind)
            change[..., row] = steep - self.channels.lateness(of_channels) * values
        factor = self.channels.factor(of_channels, laplace)[..., None]
        return values * factor[..., 0], np.concatenate([derivative, change], axis=-1) * factor

    def _shift_by_decay(self, channels: ChannelErrors, rest: FloatArray) -> tuple[Response, ComplexArray]:
        """Response model and its Laplace variable s (n_frequencies,), 1/s, shifted by an unknown window decay.

        A window exp(-decay t) turns H at i omega into H at s = decay + i omega. Nothing is shifted if the decay is no
        parameter. `rest` are the parameters of the channels.
        """
        decay = channels.decay(rest)
        if decay is None:
            return self.model, self.record.laplace
        laplace = self.record.laplace + decay
        coefficients = matrix_coefficients(self.model.slopes.matrix_kinds, laplace, {})
        factor = laplace ** DERIVATIVES[self.record.kind]
        return replace(self.model, fixed_coefficients=coefficients, kind_factor=factor), laplace


def _laplace_slope(
    model: Response, physical: FloatArray, values: ComplexArray, laplace: ComplexArray, kind: FrfKind
) -> ComplexArray:
    """Derivative dH/ds of the FRFs `values` of `model`, in the unit of H times s, (n_frequencies, n_outputs, n_inputs).

    With H = s^n S' Z^-1 F and Z = s^2 M + s C + K it is n H / s - s^n Y' (2 s M + C) X, where X = Z^-1 F and Y = Z^-1
    S. `physical` are the parameters of the structure, `laplace` (n_frequencies,) is s in 1/s, `kind` gives n: 0 for
    receptance, 1 for mobility, 2 for accelerance.
    """
    fields = model.fields_at(physical, model.channels.columns)
    x, y = model.channels.under_loads(fields), model.channels.under_sensors(fields)
    weights = model.parameters.values(physical)
    inertia, viscous = (model.slopes.structure.matrix(matrix_kind, weights) for matrix_kind in ("mass", "damping"))
    s = laplace[:, None, None]
    change = 2 * s * read(sparse.csr_array(inertia), x)
    change = change + read(sparse.csr_array(viscous), x)
    slope: ComplexArray = DERIVATIVES[kind] * values / s - model.kind_factor[:, None, None] * (
        np.swapaxes(y, 1, 2) @ change
    )
    return slope


@dataclass(frozen=True, eq=False)
class LeakedFrf:
    """FRFs whose lines read what leaks from their neighbours, for physical parameters.

    Attributes
    ----------
    observed : ObservedFrf
        FRFs at all shifted lines that are summed; see `leaking_lines`.
    line_indices : (n_lines, n_parts) int array
        Index among the shifted lines of each part of a line.
    """

    observed: ObservedFrf
    line_indices: IntArray

    def values(self, physical: FloatArray) -> ComplexArray:
        """The FRFs, (n_lines, n_outputs, n_inputs)."""
        return self._weighted_sums(self.observed.values(physical))

    def derivatives(self, physical: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """The FRFs and their derivative with respect to the physical parameters, (..., n_params)."""
        values, derivative = self.observed.derivatives(physical)
        return self._weighted_sums(values), self._weighted_sums(derivative)

    def _weighted_sums(self, parts: ComplexArray) -> ComplexArray:
        """Weighted sums over the shifted lines of each line, (n_lines, ...), of FRFs `parts` (n_shifted_lines, ...).

        Shifts and weights are those of a sum of exponentials that fits the correlation of a Hann window.
        """
        flat = parts.reshape(len(parts), -1)
        sums = np.zeros((len(self.line_indices), flat.shape[1]), dtype=np.complex128)
        for weight, indices in zip(PARTS, self.line_indices.T, strict=True):
            sums += weight * flat[indices]
        return sums.reshape(-1, *parts.shape[1:])


def require_leaking(record: FrfRecord, segment: float) -> None:
    """Raise `InputError` if the lowest line of a record is below two divided by the segment duration, `segment` in s.

    Such a line reads what leaks from below 0 Hz.
    """
    if record.frequency[0] * segment < LEAST_LINE:
        raise InputError(
            f"leakage of segments of {segment:g} s is modelled from {LEAST_LINE / segment:g} Hz on, and the lowest line is"
            f" {record.frequency[0]:g} Hz; begin the band there"
        )


def leaking_lines(record: FrfRecord, segment: float) -> tuple[FrfRecord, IntArray]:
    """Record at all shifted lines that leakage mixes, and the index in it of each shift, (n_lines, n_shifts).

    The new record is sorted by frequency and has values of 0, without variance.

    Parameters
    ----------
    record : FrfRecord
    segment : float
        Duration of its segments, s.
    """
    laplace = (record.laplace[:, None] + RATES / segment).ravel()
    order = np.argsort(laplace.imag, kind="stable")
    positions = np.empty(len(order), dtype=np.int64)
    positions[order] = np.arange(len(order))
    lines = replace(
        record,
        frequency=laplace.imag[order] / (2 * np.pi),
        decay=laplace.real[order],
        values=np.zeros((len(order), *record.values.shape[1:])),
        variance=None,
        coherence=None,
        segment=None,
        relative=None,
        sizes=None,
    )
    return lines, positions.reshape(-1, len(RATES))
