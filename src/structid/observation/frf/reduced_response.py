"""What a reduced sweep of a model is held to, and the last one that was made."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from structid.arrays import ComplexArray, IntArray
from structid.dynamics.receptance import single_blas
from structid.dynamics.reduced_sweep import ErrorOf, FieldSweep, reading_error
from structid.observation.contraction import ParameterForces

#: Readings of so many sets of parameters are kept.
_MOST_READINGS = 40
#: Derivatives may be off by so many times what readings may.
_DERIVATIVES = 10.0


def sweep_error(
    tolerance: float,
    sensors: sparse.csc_array,
    loads: IntArray,
    forces: tuple[ParameterForces, ComplexArray],
) -> ErrorOf:
    """How far fields of a basis are off, in parts of what is allowed.

    Readings may be off by `tolerance` of the largest of their line, derivatives by ten times that in root mean square
    over parameters. As readings are off by the product of what the fields of loads and sensors are, and derivatives by
    their sum, derivatives decide.

    Parameters
    ----------
    tolerance : float
    sensors : (n_dofs, n_sensors) sparse array
    loads : (n_loads,) int array
        Columns of the fields under loads.
    forces : (ParameterForces, (n_frequencies, n_maps) complex array)
    """
    maps, factors = forces

    def error(line: int, exact: NDArray[Any], found: NDArray[Any]) -> float:
        readings = reading_error(*(np.asarray(sensors.T @ fields[:, loads]) for fields in (exact, found))) / tolerance
        pair = [np.stack(maps.contracted(factors[line], fields[:, loads], fields)) for fields in (exact, found)]
        return max(readings, derivative_error(*pair) / (_DERIVATIVES * tolerance))

    return error


def derivative_error(exact: NDArray[Any], found: NDArray[Any]) -> float:
    """Root mean square over parameters of the relative difference of derivatives (n_loads, n_params, n_readings)."""
    size, off = (np.linalg.norm(values, axis=(0, 2)) for values in (exact, found - exact))
    return float(np.sqrt(np.mean((off[size > 0] / size[size > 0]) ** 2))) if size.any() else 0.0


class LastSweep:
    """The last `FieldSweep` of a model: values and derivatives at the same parameters share it.

    Attributes
    ----------
    n_factorizations : int
        Of all sweeps so far.
    readings : dict
        What sensors read, by what it depends on.
    """

    def __init__(self) -> None:
        self.readings: dict[bytes, ComplexArray] = {}
        self._key = b""
        self._sweep: FieldSweep | None = None
        self._before = 0

    @property
    def n_factorizations(self) -> int:
        return self._before + (self._sweep.n_factorizations if self._sweep is not None else 0)

    @property
    def n_basis(self) -> int:
        return 0 if self._sweep is None else self._sweep.n_basis

    def verified(self, key: bytes, begun: Callable[[], FieldSweep], error_of: ErrorOf) -> FieldSweep | None:
        """The sweep of `key`, with a basis that satisfies `error_of`; None where it would take too much."""
        if self._sweep is None or key != self._key:
            self._before = self.n_factorizations
            self._sweep = None  # its memory goes before the next takes any
            self._sweep, self._key = begun(), key
        with single_blas():
            return None if self._sweep.verified(error_of) is None else self._sweep

    def read(self, sweep: FieldSweep, sensors: sparse.csc_array) -> ComplexArray:
        """What sensors read at all lines under all columns; kept, for parameters are come back to."""
        while len(self.readings) >= _MOST_READINGS:
            del self.readings[next(iter(self.readings))]
        self.readings[self._key] = sweep.basis.read(sensors)
        return self.readings[self._key]

    def __getstate__(self) -> dict[str, object]:
        """Without the fields, which are large."""
        return {"readings": {}, "_key": b"", "_sweep": None, "_before": self.n_factorizations}
