"""Frequency response functions as a least-squares problem, in several forms of the residual."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from structid.arrays import ComplexArray, FloatArray, IntArray, stack_real
from structid.errors import InputError
from structid.estimation.problem import Linearization
from structid.estimation.search.free_linearization import FreeLinearization
from structid.observation.channel_errors import ChannelErrors
from structid.observation.frf.continuation import continuation_plan, nearer, thinned_problem
from structid.observation.frf.products import STORED_BYTES, Whitening, free_response
from structid.observation.frf.response import Response, response
from structid.observation.frf.window_decay import laplace_slope, moved
from structid.records import FrfRecord
from structid.structure import Friction, Structure
from structid.unknowns import Parameters

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
    channels : ChannelErrors, optional
        Errors of the record's channels; their parameters follow those of the structure.
    start_prior : ((n_params,) array, (n_params,) array), optional
        Gaussian prior on the free variables besides the parameters' own: mean and standard deviation. It holds what
        the data of an easier form of the problem do not say; see `continuation_plan`.
    start_error : float, optional
        Expected error of the start in the logarithm (0.5 is a factor of 1.65): the search then comes by continuation
        first, which carries far. None begins with ways for a start that is near.
    factorizer : {"pardiso", "mumps", "superlu"}, optional
        Of models with more than 64 degrees of freedom; by default what the environment variable STRUCTID_FACTORIZER
        names, or the fastest that is installed.
    reduced : float, optional
        Largest error of values, in parts of the largest of their line, that a large model may find from few
        factorizations; derivatives to ten times that. It pays for solids and many lines; see `FieldSweep`.
    """

    structure: Structure
    parameters: Parameters
    record: FrfRecord
    form: Form = "output"
    model_error: float = 0.0
    measured_sliding: bool = False
    channels: ChannelErrors | None = None
    start_prior: tuple[FloatArray, FloatArray] | None = None
    start_error: float | None = None
    factorizer: str | None = None
    reduced: float | None = None

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
        if self.channels is not None:
            self._require_sound_channels(self.channels)

    def _require_sound_channels(self, channels: ChannelErrors) -> None:
        if self.form == "equation":
            raise InputError("form 'equation' takes no errors of channels; use form 'output'")
        if channels.decay(channels.start) is None:
            return
        if any(isinstance(element, Friction) for element in self.structure.elements):
            raise InputError("a window's decay as a parameter needs a structure without friction; give its known value")

    @property
    def names(self) -> tuple[str, ...]:
        return self.parameters.names + (self.channels.names if self.channels else ())

    @property
    def kinds(self) -> tuple[str, ...]:
        return self.parameters.kinds + (self.channels.kinds if self.channels else ())

    @property
    def units(self) -> tuple[str, ...]:
        return self.parameters.units + (self.channels.units if self.channels else ())

    @property
    def theta_start(self) -> FloatArray:
        return _joined(self.parameters.theta_start, self.channels.theta_start if self.channels else None)

    @property
    def start(self) -> FloatArray:
        """Initial physical values, (n_params,)."""
        return _joined(self.parameters.start, self.channels.start if self.channels else None)

    @property
    def prior_mean(self) -> FloatArray:
        """Mean of each parameter's own prior, NaN where it has none, (n_params,)."""
        return _joined(self.parameters.prior_mean, self.channels.prior_mean if self.channels else None)

    @property
    def prior_std(self) -> FloatArray:
        """Standard deviation of each parameter's own prior, NaN where it has none, (n_params,)."""
        return _joined(self.parameters.prior_std, self.channels.prior_std if self.channels else None)

    def sizes(self, physical: FloatArray) -> FloatArray:
        """What the standard deviation of each parameter is held against: its value, for a delay at least its scale."""
        n = self.parameters.n_params
        return _joined(np.abs(physical[:n]), self.channels.sizes(physical[n:]) if self.channels else None)

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
        return response(
            self.structure, self.parameters, self.record, self.measured_sliding, self.factorizer, self.reduced
        )

    def stage_plans(self) -> tuple[tuple[tuple[str, FrfProblem], ...], ...]:
        """Easier forms of the problem, for poor starts: a short way to the answer, and a longer one if that fails.

        Both begin with the pole-free residual and every parameter drawn to its start: what the data say weakly stays
        where it is until the rest has settled. The short way takes errors of half of each value, which follows a
        start that is far off in a few parameters; the long way lets them fall from three times to a tenth, which is
        surer where many are off. Friction slides with measured amplitudes. A third way is by continuation from the
        right half-plane, which carries furthest and comes first where `start_error` is given; see `continuation_plan`.
        """
        near = tuple(self._plan(std, errors) for std, errors in _PLANS)
        if self.start_error is None:
            far = continuation_plan(self)
            return (*near, far) if far else near
        far = continuation_plan(self, self.start_error)
        return (far, nearer(far), *near) if far else near

    def thinned(self) -> FrfProblem | None:
        """The problem on about 2000 lines, closer together at low frequencies; None with less than ten times as many."""
        return thinned_problem(self)

    def _plan(self, std: float, errors: tuple[float, ...]) -> tuple[tuple[str, FrfProblem], ...]:
        near = replace(self, form="pole_free", parameters=self.parameters.kept_near_start(std), measured_sliding=True)
        if self.channels is not None:
            near = replace(near, channels=self.channels.kept_near_start(std))
        first = tuple((f"pole-free, errors of {e:g}", replace(near, model_error=e)) for e in errors)
        if not any(isinstance(e, Friction) and e.measured_by for e in self.structure.elements):
            return first
        return *first, ("measured sliding", replace(self, measured_sliding=True))

    def physical(self, theta: FloatArray) -> FloatArray:
        own, rest = self._split(theta)
        return _joined(
            self.parameters.transforms.physical(own),
            self.channels.transforms.physical(rest) if self.channels else None,
        )

    def slope(self, theta: FloatArray) -> FloatArray:
        own, rest = self._split(theta)
        return _joined(
            self.parameters.transforms.slope(own), self.channels.transforms.slope(rest) if self.channels else None
        )

    def _split(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Those of the structure, and those of the channels."""
        return values[: self.parameters.n_params], values[self.parameters.n_params :]

    def predicted(self, theta: FloatArray) -> ComplexArray:
        """The model's FRF in the record's kind, errors of channels included, (n_frequencies, n_outputs, n_inputs)."""
        own, rest = self._split(self.physical(theta))
        if self.channels is None:
            return self.model.values_at(own)
        model, laplace = self._moved(rest)
        return model.values_at(own) * self.channels.factor(rest, laplace)

    def predicted_on(self, record: FrfRecord, physical: FloatArray) -> ComplexArray:
        """The same for the lines of `record`, which has the same channels, with physical parameters."""
        own, rest = self._split(physical)
        if self.channels is None and record is self.record and not self.measured_sliding:
            return self.model.values_at(own)
        if self.channels is None:
            again = response(self.structure, self.parameters, record, False, self.factorizer, self.reduced)
            return again.values_at(own)
        decay = self.channels.decay(rest)
        there = record if decay is None else replace(record, decay=record.laplace.real + decay)
        model = response(self.structure, self.parameters, there)
        return model.values_at(own) * self.channels.factor(rest, there.laplace)

    def decided(self, theta: FloatArray) -> FrfProblem:
        """The same problem with the polarities that the model at `theta` asks for."""
        if self.channels is None or not self.channels.polarity_names:
            return self
        return replace(self, channels=self.channels.decided(self.record.values, self.predicted(theta)))

    def _moved(self, rest: FloatArray) -> tuple[Response, ComplexArray]:
        """The response and its Laplace variables, moved by the window's decay where that is a parameter."""
        decay = self.channels.decay(rest) if self.channels else None
        if decay is None:
            return self.model, self.record.laplace
        laplace = self.record.laplace + decay
        return moved(self.model, laplace, self.record.kind), laplace

    def _derivatives(self, theta: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """The model's FRF and its derivative with respect to the physical parameters."""
        own, rest = self._split(self.physical(theta))
        if self.channels is None:
            return self.model.derivatives_at(own)
        model, laplace = self._moved(rest)
        values, derivative = model.derivatives_at(own)
        change = self.channels.log_slopes(rest, laplace) * values[..., None]
        for row in self.channels.rows("window_decay"):
            steep = laplace_slope(model, own, values, laplace, self.record.kind)
            change[..., row] = steep - self.channels.lateness(rest) * values
        factor = self.channels.factor(rest, laplace)[..., None]
        return values * factor[..., 0], np.concatenate([derivative, change], axis=-1) * factor

    def residual(self, theta: FloatArray) -> FloatArray:
        if self.form == "equation":
            return self.linearize(theta).residual
        data, _ = self._whitened(self.predicted(theta), None)
        return np.concatenate([stack_real(data.ravel()), self._prior_residual(theta)])

    def linearize(self, theta: FloatArray) -> Linearization:
        slope = self.slope(theta)
        predicted, derivative = self._derivatives(theta)
        derivative = derivative * slope
        if self.form == "equation":
            data, change = self._equation(theta, predicted, derivative)
        else:
            data, change = self._whitened(predicted, derivative)
        prior, prior_slope = self._prior(theta)
        jacobian = np.concatenate([stack_real(change.reshape(-1, len(theta))), prior_slope])
        return Linearization(np.concatenate([stack_real(data.ravel()), prior]), jacobian)

    def linearize_free(self, theta: FloatArray, stored_bytes: float = STORED_BYTES) -> FreeLinearization:
        """The residual and products with its derivative, which is not formed, for very many parameters.

        Parameters
        ----------
        theta : (n_params,) float array
        stored_bytes : float
            The Jacobian of the data is stored where it takes no more than this, and applied from fields otherwise.

        Raises
        ------
        InputError
            With errors of channels, the form ``equation`` or friction that slides with the model's own amplitude.
        """
        if self.channels is not None or self.form == "equation" or self.start_prior is not None:
            raise InputError(
                "a search without a Jacobian takes neither errors of channels nor form 'equation' nor a prior of the"
                " start; leave them out, or have fewer parameters"
            )
        physical, slope = self.physical(theta), self.slope(theta)
        at = free_response(self.model, physical, self._whitening, stored_bytes)
        residual, prior = self.sparse_prior(theta)
        data, _ = self._whitened(at.values, None)
        return FreeLinearization(
            residual=np.concatenate([stack_real(data.ravel()), residual]),
            forward=lambda v: at.forward(slope * v),
            adjoint=lambda u: slope * at.adjoint(u),
            data_squares=slope**2 * at.squares,
            prior=prior,
            words=at.words,
            jacobian=None if at.jacobian is None else at.jacobian * slope,
        )

    def sparse_prior(self, theta: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        """Residual (n_rows,) of the priors and its derivative, sparse (n_rows, n_params)."""
        if self.channels is not None or self.start_prior is not None:
            residual, dense = self._prior(theta)
            return residual, sparse.csr_array(dense)
        residual, rows = self.parameters.sparse_prior_rows(self.physical(theta))
        return residual, sparse.csr_array(rows @ sparse.diags_array(self.slope(theta)))

    def _whitening(self, h: ComplexArray, lines: slice) -> Whitening:
        """How the whitened residual at some lines changes with the response h there."""
        m, s = self.record.values[lines], self._deviation[lines]
        if self.form == "output":
            return Whitening((1 / s).astype(np.complex128), np.zeros_like(h))
        relative = s / np.abs(m)
        if self.form == "log":
            return Whitening(1 / (h * relative), np.zeros_like(h))
        size = np.sqrt(0.5 * (np.abs(h) ** 2 + np.abs(m) ** 2))
        turn = (h - m) / (4 * size**3 * relative)
        return Whitening(1 / (size * relative) - turn * np.conj(h), -turn * h)

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

    def _prior_residual(self, theta: FloatArray) -> FloatArray:
        """The residual of `_prior` alone."""
        if self.channels is not None or self.start_prior is not None:
            return self._prior(theta)[0]
        return self.parameters.prior_residual(self.physical(theta))

    def _prior(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rows of the priors and their derivative with respect to the free variables."""
        own, rest = self._split(self.physical(theta))
        residual, jacobian = self.parameters.prior_rows(own)
        if self.channels is not None:
            more, slopes = self.channels.prior_rows(rest)
            residual, jacobian = np.concatenate([residual, more]), linalg.block_diag(jacobian, slopes)
        jacobian = jacobian * self.slope(theta)
        if self.start_prior is None:
            return residual, jacobian
        mean, std = self.start_prior
        rows = np.flatnonzero(np.isfinite(std))
        held = ((theta - mean) / std)[rows]
        return np.concatenate([residual, held]), np.concatenate([jacobian, np.diag(1 / std)[rows]])


def _joined(first: FloatArray, second: FloatArray | None) -> FloatArray:
    return first if second is None else np.concatenate([first, second])
