"""Frequency response functions as a least-squares problem, in several forms of the residual, with easier forms."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Self

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray, stack_real
from structid.core.errors import InputError
from structid.core.units import ACCELERATION_KINDS
from structid.fem import Friction, Structure
from structid.forward.channel_errors import ChannelErrors
from structid.forward.frf.continuation import (
    START_ERROR,
    is_noisy,
    smoothed_records,
    start_deviation,
    thinned_lines,
)
from structid.forward.frf.observed import (
    ComponentNoise,
    ErrorsOfEntry,
    LeakedFrf,
    ObservedFrf,
    errors_of_entries,
    leaking_lines,
    require_leaking,
)
from structid.forward.frf.products import STORED_BYTES, Form, WhitenedFrf, Whitening, response_products
from structid.forward.frf.response import Response, ResponseCache, response
from structid.forward.record_problem import (
    RecordFacts,
    RecordProblem,
    complex_rows,
    linearization_with_priors,
    residual_with_priors,
)
from structid.inversion.linearization import Linearization, OperatorLinearization
from structid.inversion.problem import ContinuationPath, DataRows, NoiseLaw, RowNoise
from structid.records import FrfRecord
from structid.unknowns import Parameters

#: Standard deviations of the starts, and errors of the values, of two ways by the pole-free residual.
_PLANS = ((0.3, (0.5,)), (0.25, (3.0, 1.0, 0.3, 0.1)))
#: What a start is expected to be off by where lines are added from the lowest on, and the error of each value meanwhile.
LINES_START_ERROR, LINES_ERROR = 0.3, 0.1
_MOST_STAGES, _MOST_LINES = 12, 60
#: How far from a measured magnitude that of a model is taken, in standard deviations.
_FAR_OFF = 5.0
#: A part of the data is worth it where it is smaller by this factor.
_WORTH_SUBSAMPLING = 10

_NOISE = {
    "declared": "the stated noise",
    "coherence": "the noise that coherence tells",
    "repeats": "the noise that repeats tell",
}

FrfSchedule = tuple[tuple[str, "FrfProblem"], ...]


@dataclass(frozen=True, eq=False)
class FrfProblem(RecordProblem):
    """Parameters of a structure from measured FRFs.

    Forms of the residual between model h and measurement m, whose noise has standard deviation s:

    - ``output``: (h - m) / s. Maximum likelihood for additive noise.
    - ``log``: log(h / m) / (s / |m|), real part and phase. Maximum likelihood for errors in proportion to the
      FRF, as model error is; plain relative weighting of h - m would favour small h, hence large masses. Values m that
      are noise, below 3 s, are compared as in ``output``.
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
    start_error : float, optional
        Expected error of the start in the logarithm (0.5 is a factor of 1.65): the search then comes by continuation
        first, which carries far. None tries schedules for a near start first.
    reduced : float, optional
        Largest error of values, in parts of the largest of their line, that a large model may find from few
        factorizations; derivatives to ten times that. It pays for solids and many lines; see `FieldSweep`.
    cache : ResponseCache
        Cache that it shares with the problems that are made from it; it names the factorizer of large models.
    """

    structure: Structure
    parameters: Parameters
    record: FrfRecord
    form: Form = "output"
    model_error: float = 0.0
    measured_sliding: bool = False
    channels: ChannelErrors | None = None
    start_error: float | None = None
    reduced: float | None = None
    cache: ResponseCache = field(default_factory=ResponseCache, repr=False)

    def __new__(cls, *given: object, **named: object) -> Self:
        if "factorizer" in named:
            raise InputError(f"`factorizer` is said in `cache`: write cache=ResponseCache({named['factorizer']!r})")
        return super().__new__(cls)

    def __post_init__(self) -> None:
        """Raise `InputError` if record, form of residual, channel errors, leakage and structure do not fit together.

        The record needs a noise level or `model_error` unless the form is ``equation``; every value needs a finite
        weight; unknown channel errors and leakage of segments need another form than ``equation``, and leakage no
        friction.
        """
        if self.record.variance is None and self.model_error <= 0 and self.form != "equation":
            averages = "the number of `averages` behind its coherence" if self.record.coherence is not None else ""
            raise InputError(
                "the record has no noise level; declare `noise` (relative or absolute), give"
                f" {averages or 'coherence and averages'}, or give `model_error`"
            )
        _require_weights(self.form, self.record, self._whitened.deviation)
        if self.channels is not None:
            _require_sound_channels(self, self.channels)
        if self.record.segment is not None:
            _require_leakage(self, self.record.segment)

    def measured_and_predicted(self, theta: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        return self.record.values, self.predicted(theta)

    @property
    def measured_responses(self) -> FrfRecord:
        return self.record

    @property
    def frequency(self) -> FloatArray:
        return self.record.frequency

    @property
    def is_large(self) -> bool:
        return self.model.is_large

    @property
    def is_reduced(self) -> bool:
        return self.reduced is not None and self.is_large

    @property
    def smoothed(self) -> tuple[tuple[float, FrfRecord], ...]:
        """Pairs of a level a and the FRFs at s = d + omega (a + i), d the decay of the record; see `smoothed_records`.

        () where the model is not known beside the axis.
        """
        return smoothed_records(self.record) if self.structure.has_modes else ()

    def with_lines(self, keep: IntArray) -> FrfProblem:
        return replace(self, record=self.record.lines(keep))

    @property
    def facts(self) -> RecordFacts:
        """Facts of the record for diagnostics: line spacing, window bandwidth (Hz), noise in words, number of channels.

        Spacing and bandwidth have an entry for each line: the distance to the line before (to the next for the first,
        infinite for a single one), and the decay of the window over pi. Others are whether the force was measured and
        whether a wrong clock looks like stiffness, and the record.
        """
        gaps, record = np.diff(self.frequency), self.record
        noise = _NOISE.get(record.noise_source, "the noise that the record has")
        if record.variance is None or record.noise_source == "scatter":
            floor = "" if record.variance is None else " and the floor that neighbouring lines show"
            noise = f"the assumed noise ({100 * self.model_error:.2g} % of each value{floor})"
        return RecordFacts(
            line_spacing=np.concatenate([gaps[:1], gaps]) if len(gaps) else np.full(1, np.inf),
            window_bandwidth=record.laplace.real / np.pi,
            noise=noise,
            measures_force=not record.is_per_motion,
            takes_clock_for_stiffness=record.kind in ACCELERATION_KINDS,
            n_channels=int(np.prod(record.values.shape[1:])),
            record=record,
        )

    def _averages(self) -> FloatArray | None:
        """Number of averages behind the variance of each data row, (n_data,), if it comes from coherence; else None.

        With `model_error` the number is larger: averages - 1 is divided by the square of the part that noise has in the
        variance (infinite without noise). Also None for the form ``equation``.
        """
        record = self.record
        if (
            record.noise_source != "coherence"
            or not record.averages
            or record.variance is None
            or self.form == "equation"
        ):
            return None
        if self.model_error == 0:
            return np.full(2 * record.values.size, float(record.averages))
        share = 0.5 * record.variance / self._whitened.deviation**2
        more = np.divide(record.averages - 1, share**2, out=np.full(share.shape, np.inf), where=share > 0)
        return np.tile(1 + more.ravel(), 2)

    def noise_law(self, theta: FloatArray) -> NoiseLaw:
        """Law of the noise of data rows at the free variables `theta` (n_params,), for standard errors and tests.

        Rows are independent, with the number of averages behind each variance; errors of measured components, if
        stated, add a covariance between rows that depends on `theta`.
        """
        rows = RowNoise(self.rows.averages)
        if not self.has_component_errors:
            return rows
        physical = self.physical(theta)
        whitening = self._whitened.whitening(self._observed.values(physical))
        return ComponentNoise(partial(self._component_errors, physical), whitening, rows, self.n_data)

    @property
    def has_component_errors(self) -> bool:
        """True if errors of measured components enter the intervals: variances are stated, and data are FRFs."""
        return self.form != "equation" and any(component.variance is not None for component in self.structure.measured)

    def _component_errors(self, physical: FloatArray) -> Iterator[ErrorsOfEntry]:
        """Yield each error of measured components, with the change of the observed FRFs by it, channel errors included.

        An `ErrorsOfEntry` belongs to one entry of a receptance. `physical` (n_params,) are the parameters of the
        structure, then those of the channels.
        """
        of_structure, of_channels = np.split(physical, [self.parameters.n_params])
        for entry in errors_of_entries(self.model, of_structure):
            factor = 1.0 if self.channels is None else self.channels.factor(of_channels, self.record.laplace)
            yield replace(entry, change=entry.change * factor)

    @cached_property
    def rows(self) -> DataRows:
        """Rows of each sensor, with its load where there are several."""
        loads = [f"/{load}" if len(self.record.inputs) > 1 else "" for load in self.record.inputs]
        names = [f"{output}{load}" for output in self.record.outputs for load in loads]
        return complex_rows(len(self.frequency), names, self._averages())

    @cached_property
    def model(self) -> Response:
        """The structure's response at the record's lines, sensors and loads."""
        return self._response(self.record, self.measured_sliding)

    def _response(self, record: FrfRecord, measured_sliding: bool) -> Response:
        return response(self.structure, self.parameters, record, measured_sliding, self.reduced, self.cache)

    @cached_property
    def _observed(self) -> ObservedFrf | LeakedFrf:
        return self._observed_on(self.record, self.model)

    def _observed_on(self, record: FrfRecord, model: Response | None = None) -> ObservedFrf | LeakedFrf:
        """Model of the FRFs that the channels of `record` show, with leakage if the record has segments.

        It gives FRFs for physical parameters of structure and channels. `model` is the response of the structure at the
        lines of `record`, made if None; it is not used with leakage, which needs other lines.
        """
        if record.segment is None:
            return ObservedFrf(model or self._response(record, False), self.channels, record)
        lines, positions = leaking_lines(record, record.segment)
        return LeakedFrf(ObservedFrf(self._response(lines, False), self.channels, lines), positions)

    @cached_property
    def _whitened(self) -> WhitenedFrf:
        """Measured FRFs, not yet divided, with the form of the residual and the standard deviation that divides it.

        The deviation is that of the real, and of the imaginary, part of each value, from noise and model error; parts
        of it that go with a value's size take `record.sizes` where these are known.
        """
        record, square = self.record, np.abs(self.record.values) ** 2
        sizes = square if record.sizes is None else record.sizes**2
        variance = 0.5 * self.model_error**2 * sizes
        if record.variance is not None:
            variance = variance + 0.5 * record.variance
        if record.relative is not None:
            variance = variance + 0.5 * record.relative**2 * (sizes - square)
        return WhitenedFrf(self.form, record.values, np.sqrt(np.maximum(variance, 0.0)))

    def reweighted(self, theta: FloatArray) -> FrfProblem:
        """Problem whose model error and relative noise are parts of the predicted magnitudes, not of the measured ones.

        Predictions are those at the free variables `theta` (n_params,), limited to five standard deviations from the
        measured magnitudes. The problem itself for another form than ``output``, or without model error and relative
        noise.
        """
        if self.form != "output" or (self.model_error == 0 and self.record.relative is None):
            return self
        measured = np.abs(self.record.values)
        noise = np.divide(self._whitened.deviation, measured, out=np.zeros_like(measured), where=measured > 0)
        most = 1 + _FAR_OFF * np.sqrt(2) * noise
        sizes = np.clip(np.abs(self.predicted(theta)), measured / most, measured * most)
        return replace(self, record=replace(self.record, sizes=sizes))

    def predicted(self, theta: FloatArray) -> ComplexArray:
        """The model's FRF in the record's kind, errors of channels included, (n_frequencies, n_outputs, n_inputs)."""
        return self._observed.values(self.physical(theta))

    def predicted_on(self, record: FrfRecord, physical: FloatArray) -> ComplexArray:
        """FRFs of the model at the lines of `record`, (n_frequencies, n_outputs, n_inputs), channel errors included.

        `record` must have the same channels; `physical` (n_params,) are parameters in physical units.
        """
        if record is self.record and not self.measured_sliding:
            return self._observed.values(physical)
        return self._observed_on(record).values(physical)

    def residual(self, theta: FloatArray) -> FloatArray:
        """Whitened residual of the lines, real parts before imaginary ones, then prior rows, at `theta` (n_params,)."""
        if self.form == "equation":
            return self.linearize(theta).residual
        return residual_with_priors(self.unknowns, theta, self.data_rows(self.predicted(theta)))

    def data_rows(self, predicted: ComplexArray) -> FloatArray:
        """Whitened data rows (n_data, ...) of the FRFs `predicted`, in the order of `rows`.

        `predicted` is (..., n_frequencies, n_outputs, n_inputs). Not for the form ``equation``.
        """
        data = self._whitened.residual(predicted)
        return stack_real(np.moveaxis(data.reshape(*predicted.shape[:-3], -1), -1, 0))

    def linearize(self, theta: FloatArray) -> Linearization:
        """Weighted residual at the free variables `theta` (n_params,) and its Jacobian by these, prior rows last.

        Data rows are the real parts of all values, then the imaginary parts, lines slowest and inputs fastest.
        """
        predicted, derivative = self._observed.derivatives(self.physical(theta))
        if self.form == "equation":
            data, change = _equation_rows(self, theta, predicted, derivative)
        else:
            data, change = self._whitened.residual(predicted), self._whitened.whitening(predicted).rows(derivative)
        rows = stack_real(change.reshape(-1, len(theta)))
        rows *= self.slope(theta)
        return linearization_with_priors(self.unknowns, theta, stack_real(data.ravel()), rows)

    @property
    def matrix_free_obstacle(self) -> str:
        """Reason why a matrix-free search of these FRFs is impossible; "" if it is possible.

        It goes on a sentence that begins with the search, as in "a matrix-free search takes no dry friction".
        """
        if self.channels is not None and self.channels.decay(self.channels.start) is not None:
            return "takes no unknown decay of a window"
        if self.form == "equation":
            return "takes no residual of form 'equation'"
        if self.record.segment is not None:
            return "takes no leakage of segments"
        if not self.structure.has_matrices:
            return "takes no FRFs that a solver gives"
        return "takes no dry friction" if _has_friction(self.structure) else ""

    def linearize_operator(self, theta: FloatArray, stored_bytes: float = STORED_BYTES) -> OperatorLinearization:
        """The residual and products with its derivative by the free variables, for very many parameters.

        Rows are data (real parts, then imaginary ones) in the products, and data, then priors in the residual.

        Parameters
        ----------
        theta : (n_params,) float array
            Free variables.
        stored_bytes : float
            The Jacobian of the data is stored where it takes no more than this, and applied from fields otherwise.

        Raises
        ------
        InputError
            If there is a `matrix_free_obstacle`.
        """
        if self.matrix_free_obstacle:
            return super().linearize_operator(theta)
        physical, n = self.physical(theta), self.parameters.n_params
        of_structure, of_channels = np.split(self.slope(theta), [n])
        laplace, whitened = self.record.laplace, self._whitened
        factor: ComplexArray = np.ones((len(laplace), 1, 1), dtype=np.complex128)
        if self.channels is not None:
            factor = self.channels.factor(physical[n:], laplace)

        def whitening(predicted: ComplexArray, lines: slice) -> Whitening:
            """The derivative of the residual with respect to the response without errors of channels."""
            return whitened.whitening(predicted * factor[lines], lines).scaled(factor[lines])

        products = response_products(self.model, physical[:n], whitening, stored_bytes)
        values = products.values * factor
        columns = np.zeros((2 * values.size, 0))
        jacobian = None if products.jacobian is None else products.jacobian * of_structure
        if self.channels is not None:
            relative = values[..., None] * self.channels.log_slopes(physical[n:], laplace)
            changes = whitened.whitening(values).rows(relative)
            columns = stack_real(changes.reshape(values.size, -1)) * of_channels
            jacobian = None if jacobian is None else np.hstack([jacobian, columns])
        residual, prior = self.prior_rows(theta)
        return OperatorLinearization(
            residual=np.concatenate([stack_real(whitened.residual(values).ravel()), residual]),
            forward=lambda v: products.forward(of_structure * v[:n]) + columns @ v[n:],
            adjoint=lambda u: np.concatenate([of_structure * products.adjoint(u), columns.T @ u]),
            data_squares=np.concatenate([of_structure**2 * products.squares, (columns**2).sum(axis=0)]),
            prior=prior,
            words=products.words,
            jacobian=jacobian,
        )

    def schedules(self) -> tuple[FrfSchedule, ...]:
        """Sequences of easier problems for poor starts, each a tuple of pairs (name, problem), in the order of trial.

        Two use the bounded (pole-free) residual with a prior at the start: a short one with an error of half of each
        value, and a longer one with errors falling from three times to a tenth. One fits smoothed FRFs; it comes last,
        or, with `start_error`, first, followed by itself with half that error, and is left out where the record has too
        few lines for it.
        """
        near = tuple(_pole_free_schedule(self, std, errors) for std, errors in _PLANS)
        if self.start_error is None:
            far = decay_continuation(self)
            return (*near, far) if far else near
        far = decay_continuation(self, self.start_error)
        return (far, tightened(far), *near) if far else near

    def continuation_paths(self) -> Sequence[ContinuationPath]:
        """Sequences of stages to try from a poor start: `frequency_continuation` for 2 to 60 lines, then `schedules`.

        The first is a function that makes its stages from the problem when called. Empty for FRFs of a solver, which
        are valid near the start only.
        """
        if not self.structure.has_matrices:
            return ()
        schedules = self.schedules()
        few = 1 < len(self.frequency) <= _MOST_LINES
        return (partial(frequency_continuation, self), *schedules) if few else schedules

    def subsampled(self) -> FrfProblem | None:
        """Problem on about 2000 lines, spread in the logarithm; None if these are more than a tenth of all lines."""
        keep = thinned_lines(self.record.omega)
        return None if _WORTH_SUBSAMPLING * len(keep) > len(self.frequency) else self.with_lines(keep)


def _has_friction(structure: Structure) -> bool:
    return any(isinstance(element, Friction) for element in structure.elements)


def _require_weights(form: Form, record: FrfRecord, deviation: FloatArray) -> None:
    """Raise `InputError` if a value has infinite weight, or is zero where `form` divides by measured values.

    The second holds for the forms ``log`` and ``pole_free``. `deviation` (n_lines, n_outputs, n_inputs) is the standard
    deviation of each value, which the form ``equation`` does not need.
    """
    if form != "equation" and not (deviation > 0).all():
        line, output, load = np.argwhere(deviation <= 0)[0]
        if not record.values[:, output, load].any():
            raise InputError(
                f"{record.outputs[output]}/{record.inputs[load]} is 0 at every line, as a dead channel reads: check it,"
                " or leave the sensor out (`channels_used` in [record] of a study)"
            )
        raise InputError(
            f"noise of {record.outputs[output]}/{record.inputs[load]} is 0 at {record.frequency[line]:g} Hz;"
            " declare an absolute noise or a model error, so that every line has a finite weight"
        )
    if form in ("log", "pole_free") and (record.values == 0).any():
        raise InputError(f"form {form!r} needs measured values other than 0; use form 'output'")


def _require_sound_channels(problem: FrfProblem, channels: ChannelErrors) -> None:
    """Raise `InputError` if the form ``equation`` is to have channel errors.

    An unknown decay of a window also needs a structure without friction and with matrices, not a solver's FRFs alone.
    """
    if problem.form == "equation":
        raise InputError("form 'equation' takes no errors of channels; use form 'output'")
    if channels.decay(channels.start) is not None:
        if _has_friction(problem.structure):
            raise InputError(
                "a window's decay as a parameter needs a structure without friction; give its known value, or correct the"
                " record for it"
            )
        problem.structure.require_modes("a window's decay", "correct the record for it")


def _require_leakage(problem: FrfProblem, segment: float) -> None:
    """Raise `InputError` if record, form or structure does not allow for leakage of segments of `segment` seconds.

    The form must not be ``equation``, and the structure must have no friction and have matrices, not FRFs alone.
    """
    require_leaking(problem.record, segment)
    if problem.form == "equation":
        raise InputError("form 'equation' takes no leakage of segments; use form 'output'")
    if _has_friction(problem.structure):
        raise InputError("leakage of segments needs a structure without friction, which random motion does not know")
    problem.structure.require_modes("leakage of segments", "leave `leakage` out, where segments are long enough")


def _equation_rows(
    problem: FrfProblem, theta: FloatArray, h: ComplexArray, dh: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """Residual (n_frequencies, n_outputs, n_inputs) of form ``equation``, and its derivative (..., n_params).

    `h` are the FRFs of the model and `dh` their derivative (..., n_params). The difference to the measured FRFs, as
    receptance, is weighted by the inverse of the Cholesky factor of Y' conj(Y), which counts as constant; Y is the
    motion of the model under unit forces at the sensors. `theta` (n_params,) are the free variables.
    """
    weight = problem.model.sensor_gram(problem.physical(theta))
    factor = np.linalg.cholesky(weight)
    receptance_scale = problem.model.kind_factor[:, None, None]
    data = np.linalg.solve(factor, (h - problem.record.values) / receptance_scale)
    flat = (dh / receptance_scale[..., None]).reshape(*dh.shape[:2], -1)
    change = np.linalg.solve(factor, flat).reshape(dh.shape)
    return data, change


def _pole_free_schedule(problem: FrfProblem, std: float, errors: tuple[float, ...]) -> FrfSchedule:
    """Stages (name, problem) of the bounded residual, one for each model error of `errors`, with a prior at the start.

    Errors are relative, and fall from stage to stage. The prior is Gaussian with standard deviation `std` in the
    logarithm. A stage with the original form and measured sliding follows if sensors measure a friction element.
    """
    near_start = problem.with_parts([part.kept_near_start(std) for part in problem.parts])
    near = replace(near_start, form="pole_free", measured_sliding=True)
    first = tuple((f"bounded residual, errors of {e:g}", replace(near, model_error=e)) for e in errors)
    if not any(isinstance(e, Friction) and e.measured_by for e in problem.structure.elements):
        return first
    return *first, ("measured sliding", replace(problem, measured_sliding=True))


def decay_continuation(problem: FrfProblem, start_error: float = START_ERROR) -> FrfSchedule:
    """Stages of fits at s = omega (a + i), a falling to 0, for poor starts, as (name, problem).

    Empty if lines are too few. With a near 1 an FRF has no resonances between which a fit could be caught; with a of 0
    it is the measured one. Each stage fits the logarithm of the FRF. The last one fits the FRF itself with the prior at
    the start: by the pole-free residual, or by the plain one if `is_noisy`. Also empty for the form ``equation`` and
    for different decays of the lines.

    Parameters
    ----------
    problem : FrfProblem
        Its `theta_start` is the centre of the prior, which determines what the smooth data leave open.
    start_error : float
        Standard deviation of that prior, in the logarithm; for damping at least 1.

    References
    ----------
    Shin and Cha (2009), Geophysical Journal International 177, 1067-1079.
    """
    decay = problem.record.decay
    if problem.form == "equation" or (decay is not None and np.ptp(decay) > 0):
        return ()
    smooth = problem.smoothed
    if not smooth:
        return ()
    near_start = _with_start_prior(problem, start_error)
    stages = [
        (f"smoothed FRFs, {level:g} times the frequency", _smooth_stage(near_start, record)) for level, record in smooth
    ]
    near = replace(near_start, form="output" if is_noisy(problem.record) else "pole_free")
    return *stages, ("measured FRFs, prior at the start", near.subsampled() or near)


def smooth_stage(problem: FrfProblem, record: FrfRecord, start_error: float) -> FrfProblem:
    """Stage of `decay_continuation` with the data `record`, an entry of `smoothed_records`.

    `start_error` is the standard deviation of the prior at the start, in the logarithm.
    """
    return _smooth_stage(_with_start_prior(problem, start_error), record)


def _with_start_prior(problem: FrfProblem, start_error: float) -> FrfProblem:
    """A copy with a Gaussian prior at the start, for stages: friction slides with measured amplitudes."""
    near_start = problem.with_free_prior(problem.theta_start, start_deviation(problem.unknowns, start_error))
    return replace(near_start, measured_sliding=True)


def _smooth_stage(near_start: FrfProblem, record: FrfRecord) -> FrfProblem:
    """`near_start` with the data `record` and residuals of the logarithm, without model error."""
    return replace(near_start, form="log", model_error=0.0, record=record)


def tightened(schedule: FrfSchedule, ratio: float = 0.5) -> FrfSchedule:
    """Stages of `schedule` with the standard deviations of their priors at the start multiplied by `ratio`."""
    priors = [(name, stage, stage.unknowns.free_prior) for name, stage in schedule]
    return tuple(
        (name, stage if prior is None else stage.with_free_prior(prior[0], ratio * prior[1]))
        for name, stage, prior in priors
    )


def frequency_continuation(
    problem: FrfProblem,
    centre: FloatArray | None = None,
    start_error: float = LINES_START_ERROR,
    stage_error: float = LINES_ERROR,
) -> FrfSchedule:
    """Stages, for poor starts, with more and more lines from the lowest on, as (name, problem).

    The last stage has all lines, without the prior of the others, by the bounded residual. Below the first resonance an
    FRF changes smoothly with every parameter, and each added line leads to the next resonance. A Gaussian prior
    determines what few lines leave open. Empty for the form ``equation`` or if a value is 0.

    Parameters
    ----------
    problem : FrfProblem
        In any form but ``equation``, which gives no stages.
    centre : (n_params,) float array, optional
        Free variables that the prior draws to; the problem's start by default.
    start_error : float
        Standard deviation of the prior, in the logarithm; for damping at least 1.
    stage_error : float
        Error of each value while lines are added, as a part of its magnitude; the problem's model error if larger.

    Returns
    -------
    tuple of (name, FrfProblem)
        At most thirteen stages, for `estimate`.
    """
    if problem.form == "equation" or (problem.record.values == 0).any():
        return ()
    order = np.argsort(problem.record.frequency, kind="stable")
    n_lines = len(order)
    counts = np.unique(np.ceil(np.linspace(0, n_lines, min(n_lines, _MOST_STAGES) + 1)[1:]).astype(int))
    centre = problem.theta_start if centre is None else centre
    near_start = problem.with_free_prior(centre, start_deviation(problem.unknowns, start_error))
    error = max(stage_error, problem.model_error)
    near_start = replace(near_start, form="pole_free", model_error=error, measured_sliding=True)
    stages = []
    for count in counts:
        used = near_start.record.lines(np.sort(order[:count]))
        stages.append((f"bounded residual, up to {used.frequency.max():g} Hz", replace(near_start, record=used)))
    return *stages, ("bounded residual", replace(problem, form="pole_free"))
