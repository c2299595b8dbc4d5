"""Noise of FRFs of a structure from errors of the measured FRFs of its components."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from structid.core.arrays import ComplexArray, FloatArray
from structid.fem.measured import MeasuredComponent
from structid.forward.frf.products import Whitening
from structid.forward.frf.response import Response
from structid.forward.frf.solvers.coupling import SubstructureCoupling
from structid.inversion.problem import RowNoise

#: Rows of the covariance that are made at most, in entries.
_MOST_ENTRIES = 20_000_000


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
    """Yield errors of all receptance entries with stated variance of the measured components.

    An entry and its reciprocal count as one. The change of the response is g' dY q with g and q the interface forces
    under a unit force at a sensor and under the load, at parameters `physical` (n_params,). Nothing comes without
    measured components of stated variance.
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
        """Rows of unit variance, then those of every error, (n_data + n_errors, n_data); None if they are too many to be formed."""
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

    Data are real parts, then imaginary parts; `errors` must have an entry. None if n_data (n_data + n_errors) exceeds
    2e7.
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
