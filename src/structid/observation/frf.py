"""Frequency response functions as a least-squares problem, in several forms of the residual."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from structid.arrays import ComplexArray, FloatArray, IntArray, stack_real
from structid.errors import InputError
from structid.estimation.problem import Linearization
from structid.observation.response import Response, response
from structid.parameters import Parameters
from structid.records import FrfRecord
from structid.structure import Friction, Structure

_PLANS = ((0.3, (0.5,)), (0.25, (3.0, 1.0, 0.3, 0.1)))

Form = Literal["output", "log", "pole_free", "equation"]


@dataclass(frozen=True, eq=False)
class FrfProblem:
    """Parameters of a structure from measured FRFs.

    Forms of the residual between model h and measurement m, whose noise has standard deviation s:

    - ``output``: (h - m) / s. Maximum likelihood for additive noise.
    - ``log``: log(h / m) / (s / |m|), real part and phase. Maximum likelihood for errors in proportion to the
      FRF, as model error is; plain relative weighting of h - m would favour small h, hence large masses.
    - ``pole_free``: (h - m) / sqrt((|h|^2 + |m|^2) / 2) / (s / |m|). Bounded near resonances, for poor starts.
    - ``equation``: L^-1 (h - m) with L L' = Y' conj(Y), Y = Z^-1 S: equation-error weighting of the measured
      outputs, which with full steps is the iteration of Norris (1986), Eqs. (4.17) and (4.26).

    Parameters
    ----------
    structure : Structure
    parameters : Parameters
    record : FrfRecord
        With variance, unless `model_error` is given.
    form : Form
    model_error : float
        Error of the model itself, as a part of each value's magnitude; added in quadrature to the noise.
    measured_sliding : bool
        Whether friction slides with measured amplitudes, for poor starts; see `Friction`.
    """

    structure: Structure
    parameters: Parameters
    record: FrfRecord
    form: Form = "output"
    model_error: float = 0.0
    measured_sliding: bool = False

    def __post_init__(self) -> None:
        if self.record.variance is None and self.model_error <= 0 and self.form != "equation":
            raise InputError(
                "the record has no noise level; declare `noise` (relative or absolute), give coherence and averages,"
                " or give `model_error`"
            )
        if self.form != "equation" and not (self._deviation > 0).all():
            line, output, _ = np.argwhere(self._deviation <= 0)[0]
            raise InputError(
                f"noise of {self.record.outputs[output]} is 0 at {self.record.frequency[line]:g} Hz;"
                " declare an absolute noise or a model error, so that every line has a finite weight"
            )
        if self.form in ("log", "pole_free") and (self.record.values == 0).any():
            raise InputError(f"form {self.form!r} needs measured values other than 0; use form 'output'")

    @property
    def names(self) -> tuple[str, ...]:
        return self.parameters.names

    @property
    def kinds(self) -> tuple[str, ...]:
        return self.parameters.kinds

    @property
    def units(self) -> tuple[str, ...]:
        return self.parameters.units

    @property
    def theta_start(self) -> FloatArray:
        return self.parameters.theta_start

    @property
    def n_data(self) -> int:
        return 2 * self.record.values.size

    @cached_property
    def lines(self) -> IntArray:
        """Frequency index of each data row."""
        index = np.broadcast_to(np.arange(len(self.record.frequency))[:, None, None], self.record.values.shape)
        return np.concatenate([index.ravel(), index.ravel()])

    @cached_property
    def series(self) -> IntArray:
        """Channel of each data row: 2 (output n_inputs + input), plus 1 for imaginary parts."""
        n_lines, n_outputs, n_inputs = self.record.values.shape
        index = np.tile(2 * np.arange(n_outputs * n_inputs), n_lines)
        return np.concatenate([index, index + 1])

    @cached_property
    def model(self) -> Response:
        """The structure's response at the record's lines, sensors and loads."""
        return response(self.structure, self.parameters, self.record, self.measured_sliding)

    def stage_plans(self) -> tuple[tuple[tuple[str, FrfProblem], ...], ...]:
        """Easier forms of the problem, for poor starts: a short way to the answer, and a longer one if that fails.

        Both begin with the pole-free residual and every parameter drawn to its start: what the data say weakly stays
        where it is until the rest has settled. The short way takes errors of half of each value, which follows a
        start that is far off in a few parameters; the long way lets them fall from three times to a tenth, which is
        surer where many are off. Friction slides with measured amplitudes.
        """
        return tuple(self._plan(std, errors) for std, errors in _PLANS)

    def _plan(self, std: float, errors: tuple[float, ...]) -> tuple[tuple[str, FrfProblem], ...]:
        near = replace(self, form="pole_free", parameters=self.parameters.kept_near_start(std), measured_sliding=True)
        first = tuple((f"pole-free, errors of {e:g}", replace(near, model_error=e)) for e in errors)
        if not any(isinstance(e, Friction) and e.measured_by for e in self.structure.elements):
            return first
        return *first, ("measured sliding", replace(self, measured_sliding=True))

    def physical(self, theta: FloatArray) -> FloatArray:
        return self.parameters.transforms.physical(theta)

    def slope(self, theta: FloatArray) -> FloatArray:
        return self.parameters.transforms.slope(theta)

    def predicted(self, theta: FloatArray) -> ComplexArray:
        """The model's FRF in the record's kind, (n_frequencies, n_outputs, n_inputs)."""
        return self.model.values_at(self.physical(theta))

    def residual(self, theta: FloatArray) -> FloatArray:
        if self.form == "equation":
            return self.linearize(theta).residual
        data, _ = self._whitened(self.predicted(theta), None)
        return np.concatenate([stack_real(data.ravel()), self._prior(theta)[0]])

    def linearize(self, theta: FloatArray) -> Linearization:
        slope = self.slope(theta)
        predicted, derivative = self.model.derivatives_at(self.physical(theta))
        derivative = derivative * slope
        if self.form == "equation":
            data, change = self._equation(theta, predicted, derivative)
        else:
            data, change = self._whitened(predicted, derivative)
        prior, prior_slope = self._prior(theta)
        jacobian = np.concatenate([stack_real(change.reshape(-1, len(theta))), prior_slope])
        return Linearization(np.concatenate([stack_real(data.ravel()), prior]), jacobian)

    @cached_property
    def _deviation(self) -> FloatArray:
        """Standard deviation of the real (and of the imaginary) part of every value."""
        variance = 0.5 * (self.model_error * np.abs(self.record.values)) ** 2
        return np.sqrt(variance if self.record.variance is None else variance + 0.5 * self.record.variance)

    def _whitened(self, h: ComplexArray, dh: ComplexArray | None) -> tuple[NDArray[Any], NDArray[Any]]:
        """Complex residual and its derivative; `dh` None where only the residual is wanted."""
        m, s = self.record.values, self._deviation
        change = np.zeros((*h.shape, 0), dtype=np.complex128) if dh is None else dh
        if self.form == "output":
            return (h - m) / s, change / s[..., None]
        relative = s / np.abs(m)
        if self.form == "log":
            return np.log(h / m) / relative, change / (h * relative)[..., None]
        size = np.sqrt(0.5 * (np.abs(h) ** 2 + np.abs(m) ** 2))
        growth = (np.conj(h)[..., None] * change).real / (2 * size**2)[..., None]
        data = (h - m) / size
        return data / relative, (change / size[..., None] - data[..., None] * growth) / relative[..., None]

    def _equation(self, theta: FloatArray, h: ComplexArray, dh: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Residual and derivative weighted by the inverse of Y' conj(Y), the weight held fixed."""
        weight = self.model.sensor_gram(self.physical(theta))
        factor = np.linalg.cholesky(weight)
        receptance_scale = self.model.kind_factor[:, None, None]
        data = np.linalg.solve(factor, (h - self.record.values) / receptance_scale)
        flat = (dh / receptance_scale[..., None]).reshape(*dh.shape[:2], -1)
        change = np.linalg.solve(factor, flat).reshape(dh.shape)
        return data, change

    def _prior(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rows of the priors and their derivative with respect to the free variables."""
        residual, jacobian = self.parameters.prior_rows(self.physical(theta))
        return residual, jacobian * self.slope(theta)
