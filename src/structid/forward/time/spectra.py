"""Forces and motions of one finite record as a least-squares problem: no leakage error, noise on both sides.

A structure makes finite spectra of motions of forces, of its state at both ends, and of tones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from structid.core.arrays import ComplexArray, FloatArray, IntArray, stack_real
from structid.core.errors import InputError
from structid.dynamics.normal_modes import Modes, frequencies_between, modes
from structid.fem import Friction, Structure
from structid.forward.channel_errors import ChannelErrors
from structid.forward.frf.continuation import thinned_lines
from structid.forward.frf.line_equations import read as readings_of
from structid.forward.frf.response import Response, ResponseCache, response
from structid.forward.record_problem import (
    RecordFacts,
    RecordProblem,
    complex_rows,
    linearization_with_priors,
    residual_with_priors,
)
from structid.inversion.linearization import LastEvaluation, Linearization
from structid.inversion.problem import DataRows, Schedule
from structid.records import FrfRecord, TimeRecord
from structid.records.record import FrfKind
from structid.records.spectra import FiniteSpectra, finite_spectra
from structid.unknowns import Parameters

#: Highest power of s in the polynomial of each output, and where a channel may be late: up to two samples are taken.
_ORDER, _LATE_ORDER = 4, 8
#: Decays of the stages, in parts of the highest circular frequency, and the order of their polynomials.
_WAYS = (((0.3, 0.1, 0.05, 0.025, 0.012, 0.006), 4), ((0.3, 0.1, 0.03, 0.01), 1))
#: A part of the lines is searched on where it is smaller by this factor; the answer is that of all.
_WORTH_SUBSAMPLING = 2.5
#: Relative error that the start is taken to have, and that of each value in the stages.
_START_ERROR, _STAGE_ERROR = 0.5, 0.1
NO_WINDOW = (
    "a window's decay is no error of histories that are fitted themselves, which need no window; take the windowed record's"
    " FRFs, or undo the window"
)
#: Modes up to this multiple of the highest line take part in the transient.
_REACH = 2.0
#: By which part of a line a tone is kept off it.
_OFF_LINE = 1e-4
#: Line at which a structure answers by its mass alone, in parts of the sampling rate.
_FAR = 10.0
#: Columns with singular values below this part of the largest count as dependent.
_DEPENDENT = 1e-10
#: A force whose motion at the sensors is below this part of what its size allows acts on a mode that no sensor sees. Rounding
#: leaves 6e-15 of it in a beam of 20 elements with its sensor in the middle, 6e-9 in one of 600 and 2e-8 in one of 1000; the
#: faintest mode that is seen there has 1e-2.
_UNSEEN = 1e-6
#: Normal equations serve where their smallest eigenvalue is above this part of their largest.
_RESOLVED = 1e-9
#: An evaluation is kept for its derivative where it takes no more than this; rows of a block of the orthogonalization.
_KEPT_BYTES, _BLOCK_ROWS = 2e8, 1024


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Evaluation of a `SpectraProblem` at one point, with its linear unknowns solved for.

    Attributes
    ----------
    y : (n_frequencies, n_dofs, n_outputs) complex array
        Motions under unit forces at the sensors.
    read : (n_frequencies, n_outputs) complex array
        Factor from displacement to the motion that each sensor reads.
    forced : (n_frequencies, n_outputs, n_inputs) complex array
        The part of each likeliest force in each reading.
    free : (n_frequencies, n_outputs) complex array
        The part of the transient in each reading, without its polynomials.
    driven : (n_frequencies, n_dofs, 1) complex array
        Motions under the likeliest forces.
    left : (n_frequencies, n_forces) complex array
        Forces of the transient.
    aliased : (n_frequencies, n_outputs, n_inputs) complex array
        The part of each likeliest force in each reading through aliases, as a factor on the response far above
        all modes.
    whitening : (n_frequencies, n_outputs, n_outputs) complex array
    linear : EliminatedColumns
        Columns of the linear unknowns, which explain a part of the whitened data.
    data : (n_data,) float array
    """

    y: ComplexArray
    read: ComplexArray
    forced: ComplexArray
    free: ComplexArray
    driven: ComplexArray
    left: ComplexArray
    aliased: ComplexArray
    whitening: ComplexArray
    linear: EliminatedColumns
    data: FloatArray

    @property
    def is_small(self) -> bool:
        """True if the model's matrices are small enough to be cached."""
        return self.linear.columns.nbytes + self.y.nbytes < _KEPT_BYTES


@dataclass(frozen=True, eq=False)
class EliminatedColumns:
    """Columns of unknowns that enter whitened data linearly, and take their part of it.

    Attributes
    ----------
    columns : (n_columns, n_complex) complex array
        One column in each row; they span what the unknowns explain.
    inverse : (n_columns, n_columns) float array
        Inverse of the products of the columns, real and imaginary parts together.
    solution : (n_unknowns, n_columns) float array
        The unknowns by the products of the columns with data.
    rank : int
        Number of independent unknowns.
    """

    columns: ComplexArray
    inverse: FloatArray
    solution: FloatArray
    rank: int

    def project_out(self, data: ComplexArray) -> tuple[ComplexArray, FloatArray]:
        """Rows of `data` (n, n_complex) less the part that the columns explain, and the unknowns (n_unknowns, n) of it.

        Unknowns are real. The projection is repeated once, because normal equations lose digits by rounding.
        """
        left = np.ascontiguousarray(data).view(np.float64)
        columns, explained = self.columns.view(np.float64), np.zeros((len(self.solution), len(left)))
        for _ in range(2):
            products = columns @ left.T
            explained += self.solution @ products
            left = left - (self.inverse @ products).T @ columns
        return left.view(np.complex128), explained


@dataclass(frozen=True, eq=False)
class MassLine:
    """The response far above all modes, by which aliases of straight forces answer.

    Attributes
    ----------
    response : Response
        Response at one line far above all modes.
    columns : (n_dofs, n_inputs + n_outputs) sparse array
        Loads, then sensors.
    spectra : FiniteSpectra
    """

    response: Response
    columns: sparse.csc_array
    spectra: FiniteSpectra

    def values(self, of_structure: FloatArray) -> FloatArray:
        """Acceleration per unit force far above all modes, (n_outputs, n_inputs), at given parameters.

        For a driven support it is per unit acceleration of the support. `of_structure` (n_params,) are the
        parameters of the structure, without channel errors.
        """
        x, _ = self._fields(of_structure)
        n_in, n_out = len(self.spectra.inputs), len(self.spectra.outputs)
        sensors = self.columns[:, n_in : n_in + n_out]
        return np.real(self._powers * (sensors.T @ x[0]))

    def change(self, of_structure: FloatArray) -> FloatArray:
        """Derivative of `values` by the parameters `of_structure`, (n_outputs, n_inputs, n_params)."""
        x, y = self._fields(of_structure)
        return np.real(self._powers[:, None] * self.response.sensitivity_at(of_structure, x, y)[0])

    def _fields(self, of_structure: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        n_in, fields = len(self.spectra.inputs), self.response.fields_at(of_structure, self.columns)
        return fields[:, :, :n_in], fields[:, :, n_in:]

    @cached_property
    def _powers(self) -> ComplexArray:
        """s^2 at that line for forces, 1 for accelerations of supports, (n_inputs,)."""
        s = self.spectra.decay + 2j * np.pi * _FAR / self.spectra.straight
        return s ** (2.0 * ~self.spectra.driven)


@dataclass(frozen=True, eq=False)
class Transient:
    """Part of the motions that no force of the record made: linear unknowns with known shapes.

    Attributes
    ----------
    spectra : FiniteSpectra
    forces : (n_dofs, n) float array
        Force patterns of which the changes of state over the record are sums.
    order : int or None
        Highest power of s in the polynomial of each output; None without a transient.
    tones : tuple of float
        Hz.
    """

    spectra: FiniteSpectra
    forces: FloatArray
    order: int | None
    tones: tuple[float, ...]

    @cached_property
    def relative_laplace(self) -> ComplexArray:
        """s in parts of its size at the highest line, (n_frequencies,)."""
        return self.spectra.laplace / abs(self.spectra.laplace[-1])

    def reach(self, y: ComplexArray, read: ComplexArray) -> ComplexArray:
        """Motions by unit forces of the transient, as sensors read them, (n_frequencies, n_outputs, n_forces).

        `y` (n_frequencies, n_dofs, n_outputs) is the receptance from degrees of freedom to sensors, and `read`
        (n_frequencies, n_outputs) turns displacements into the motion that each sensor reads. A motion below 1e-6 of
        the largest possible is set to 0: it is rounding of a mode whose nodes are at all sensors, and would be fitted
        by a motion without bound.
        """
        motions: ComplexArray = np.swapaxes(y, 1, 2) @ self.forces * read[:, :, None]
        largest = np.linalg.norm(np.linalg.norm(y, axis=1) * read) * np.linalg.norm(self.forces, axis=0)
        motions[:, :, np.linalg.norm(motions, axis=(0, 1)) < _UNSEEN * largest] = 0.0
        return motions

    def columns(self, whitening: ComplexArray, reach: ComplexArray) -> ComplexArray:
        """Whitened regressors of all linear unknowns, (n_unknowns, n_frequencies * n_outputs), one in each row.

        The order is a constant for each force, a slope over s for each force, then for each output its polynomial and
        tones. `whitening` (n_frequencies, n_outputs, n_outputs) is the factor on the spectra, `reach` (n_frequencies,
        n_outputs, n_forces) the whitened motion by each force.
        """
        n_lines, n_out = self.spectra.motion.shape
        jumps, shapes, s = np.moveaxis(reach, 2, 0), self._own_shapes.T, self.relative_laplace[:, None]
        n_jumps, n_shapes = len(jumps), len(shapes)
        columns = np.empty((2 * n_jumps + n_out * n_shapes, n_lines, n_out), dtype=np.complex128)
        columns[:n_jumps] = jumps
        np.multiply(jumps, s, out=columns[n_jumps : 2 * n_jumps])
        by_output = columns[2 * n_jumps :].reshape(n_out, n_shapes, n_lines, n_out)
        np.multiply(np.moveaxis(whitening, 2, 0)[:, None], shapes[None, :, :, None], out=by_output)
        return columns.reshape(len(columns), n_lines * n_out)

    @cached_property
    def _own_shapes(self) -> ComplexArray:
        """Functions of frequency (n_frequencies, n_shapes) in each output's own part of a spectrum: powers, then tones.

        Powers of s go from 0 to `order`; there are none if that is None. A tone of angular frequency w has four: 1/p,
        s/p, 1/p^2 and s/p^2 with p = s^2 + w^2; s and w are relative to the highest line.
        """
        s = self.relative_laplace
        powers = [s**k for k in range(0 if self.order is None else self.order + 1)]
        for tone in self.tones:
            off = _OFF_LINE / self.spectra.duration  # a tone on a line has no finite transform
            pole = s**2 + ((tone + off) / self.spectra.frequency[-1]) ** 2
            powers += [1 / pole, s / pole, 1 / pole**2, s / pole**2]
        return np.stack(powers, axis=1) if powers else np.zeros((len(s), 0), dtype=np.complex128)


@dataclass(frozen=True, eq=False)
class SpectraModel:
    """Predictions of a `SpectraProblem` at any values of its parameters.

    `errors` are those of its channels, whose parameters follow those of the structure; `order` is None without a
    transient.
    """

    structure: Structure
    parameters: Parameters
    spectra: FiniteSpectra
    errors: ChannelErrors | None
    cache: ResponseCache
    order: int | None
    tones: tuple[float, ...]

    @cached_property
    def response(self) -> Response:
        """Response of the model at the record's lines."""
        return _response(self, self.spectra.frequency)

    @cached_property
    def mass_line(self) -> MassLine:
        """Response at one frequency far above all modes, where masses alone act."""
        far = np.array([_FAR / self.spectra.straight])
        return MassLine(_response(self, far), self.columns, self.spectra)

    @cached_property
    def start_modes(self) -> Modes:
        """Modes of the structure at the start: all of a small one, the lowest of a large one."""
        return modes(*self.start_matrices)

    @cached_property
    def start_matrices(self) -> tuple[sparse.csc_array, sparse.csc_array]:
        """Mass and stiffness of the structure at the start, (n_dofs, n_dofs)."""
        values = self.parameters.values(self.parameters.start)
        return self.structure.matrix("mass", values), self.structure.matrix("stiffness", values)

    def start_frequencies(self, lowest: float, highest: float) -> tuple[FloatArray, bool]:
        """Natural frequencies (Hz) at the start from `lowest` to `highest`, ascending, and True if they are complete.

        For a large structure they may be only the first of them.
        """
        return frequencies_between(self.start_modes, *self.start_matrices, lowest, highest)

    @cached_property
    def transient(self) -> Transient:
        return Transient(self.spectra, _forces(self), self.order, self.tones)

    @cached_property
    def columns(self) -> sparse.csc_array:
        """Loads, then sensors, each (n_dofs, ...)."""
        structure = self.response.slopes.structure
        loads, sensors = structure.selection(self.spectra.inputs), structure.selection(self.spectra.outputs)
        return sparse.csc_array(sparse.hstack([loads, sensors]))

    def predicted(self, physical: FloatArray) -> ComplexArray:
        """FRFs with errors of channels, (n_frequencies, n_outputs, n_inputs)."""
        return self._state(*self._split_parameters(physical))[2]

    def evaluated(self, physical: FloatArray) -> Evaluation:
        """Predicted spectra and whitened residual at `physical`, with transients solved for; stored for reuse if small.

        `physical` are the parameters of the structure, then those of channel errors.
        """
        evaluation = self._evaluate(physical)
        if evaluation.is_small:
            self._last.keep(physical, evaluation)
        return evaluation

    def changes(self, physical: FloatArray) -> tuple[Evaluation, ComplexArray]:
        """Evaluation at `physical`, and the derivative of the whitened motions, (n_frequencies, n_outputs, n_params).

        Transients stay as fitted in the derivative. `physical` are the parameters of the structure, then those of
        channel errors.
        """
        evaluation = self._last.taken(physical) or self._evaluate(physical)
        of_structure = physical[: self.parameters.n_params]
        # fields under the forces of the transient, of every degree of freedom at every line, are too many to be kept
        motion, forces = evaluation.driven.copy(), sparse.csc_array(self.transient.forces)
        if forces.shape[1]:
            for part, fields in self.response.solved_at(of_structure, forces):
                motion[part] += fields @ evaluation.left[part, :, None]
        receptance_change = self.response.sensitivity_at(of_structure, motion, evaluation.y)[:, :, 0]
        change = receptance_change * evaluation.read[:, :, None]
        if self.spectra.straight:
            change = change + np.einsum("foi,oip->fop", evaluation.aliased, self.mass_line.change(of_structure))
        change = np.concatenate([change, self._channel_changes(physical, evaluation)], axis=2)
        return evaluation, evaluation.whitening @ change

    @cached_property
    def _last(self) -> LastEvaluation[Evaluation]:
        """The derivative is asked for where a step was tried."""
        return LastEvaluation()

    def _state(
        self, of_structure: FloatArray, read: ComplexArray, stated: ComplexArray
    ) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Motions under loads, motions under unit forces at sensors, and FRFs with channel errors.

        Shapes (n_frequencies, n_dofs, n_inputs), (n_frequencies, n_dofs, n_outputs) and (n_frequencies, n_outputs,
        n_inputs). `of_structure` are the parameters of the structure; `read` (n_frequencies, n_outputs) and
        `stated` (n_frequencies, n_inputs) are the factors of sensors and of load cells.
        """
        n_in = len(self.spectra.inputs)
        fields = self.response.fields_at(of_structure, self.columns)
        x, y = fields[:, :, :n_in], fields[:, :, n_in:]
        h = readings_of(sparse.csr_array(self.columns[:, n_in:].T), x)
        h = h * read[:, :, None] * (self.spectra.hold_factor[:, None] / stated)[:, None, :]
        if self.spectra.straight:
            h += _alias_factors(self.spectra, read, stated) * self.mass_line.values(of_structure)
        return x, y, h

    def _split_parameters(self, physical: FloatArray) -> tuple[FloatArray, ComplexArray, ComplexArray]:
        """Parameters of the structure, factors of sensors and factors of load cells, from all `physical` parameters.

        Shapes (n_own,), (n_frequencies, n_outputs) and (n_frequencies, n_inputs). `physical` is (n_own + n_errors,).
        """
        of_structure, of_channels = np.split(physical, [self.parameters.n_params])
        if self.errors is None:
            return of_structure, self.spectra.output_powers, self.spectra.input_powers
        sensors, loads = self.errors.readings(of_channels, self.spectra.laplace)
        return of_structure, self.spectra.output_powers * sensors, self.spectra.input_powers * loads

    def _evaluate(self, physical: FloatArray) -> Evaluation:
        """Predicted spectra at the parameters `physical` (n_own + n_errors,), with transients fitted by least squares.

        The result has the fields of sensors and of the forces, the parts of each likeliest force and of the transients
        in each reading, the whitening, and the whitened residual. Nothing is taken from earlier calls.
        """
        spectra = self.spectra
        of_structure, read, stated = self._split_parameters(physical)
        x, y, h = self._state(of_structure, read, stated)
        noise = np.einsum("foi,fi,fpi->fop", h, spectra.force_variance, h.conj())
        diagonal = np.arange(len(spectra.outputs))
        noise[:, diagonal, diagonal] += spectra.motion_variance
        whitening = np.linalg.inv(np.linalg.cholesky(noise) / np.sqrt(2))
        error = (h @ spectra.force[:, :, None])[:, :, 0] - spectra.motion
        reach = self.transient.reach(y, read)
        whitened = whitening @ np.concatenate([error[:, :, None], reach], axis=2)
        linear = eliminated_columns(self.transient.columns(whitening, whitened[:, :, 1:]))
        left_over, explained = linear.project_out(whitened[:, :, 0].reshape(1, -1))
        coefficients = -explained[:, 0]
        # the likeliest forces as load cells read them, u - cov(u) H' C^-1 e, with e = L (data) of the whitened misfit
        weighed = np.conj(np.swapaxes(whitening, 1, 2)) @ left_over.reshape(*error.shape, 1) / 2
        force = spectra.force - spectra.force_variance * (np.conj(np.swapaxes(h, 1, 2)) @ weighed)[:, :, 0]
        n = self.transient.forces.shape[1]
        left = coefficients[:n] + self.transient.relative_laplace[:, None] * coefficients[n : 2 * n]
        acting = force * self.spectra.hold_factor[:, None] / stated
        driven = x @ acting[:, :, None]
        aliased = _alias_factors(self.spectra, read, stated) * force[:, None, :]
        free = (reach @ left[:, :n, None])[:, :, 0]
        data = stack_real(left_over[0])
        return Evaluation(y, read, h * force[:, None, :], free, driven, left, aliased, whitening, linear, data)

    def _channel_changes(self, physical: FloatArray, at: Evaluation) -> ComplexArray:
        """Derivative of the motions by the channel errors, (n_frequencies, n_outputs, n_errors), not whitened.

        The transient is read with the error of the sensor alone. `at` is the evaluation at `physical` (n_own +
        n_errors,).
        """
        if self.errors is None:
            return np.zeros((*self.spectra.motion.shape, 0), dtype=np.complex128)
        rest, laplace = physical[self.parameters.n_params :], self.spectra.laplace
        of_loads = np.einsum("foik,foi->fok", self.errors.log_slopes(rest, laplace), at.forced)
        changes: ComplexArray = of_loads + self.errors.output_slopes(rest, laplace) * at.free[:, :, None]
        return changes


def _response(model: SpectraModel, frequency: FloatArray) -> Response:
    """Receptance model of the structure at lines `frequency` (Hz), with each sensor place and direction once.

    Its kind is "transmissibility" if a support drives the structure.
    """
    distinct = tuple(dict.fromkeys(model.spectra.outputs))
    shape = (len(frequency), len(distinct), len(model.spectra.inputs))
    decay = np.full(shape[0], model.spectra.decay)
    kind: FrfKind = "transmissibility" if model.spectra.driven.any() else "receptance"
    lines = FrfRecord(frequency, np.zeros(shape, complex), distinct, model.spectra.inputs, kind, decay=decay)
    return response(model.structure, model.parameters, lines, cache=model.cache)


def _forces(model: SpectraModel) -> FloatArray:
    """Force patterns M phi (n_dofs, n_modes) of modes up to twice the highest line, by which changes of state act.

    Masses and modes are those at the start of the parameters. No column without a transient. Driving supports carry no
    force.
    """
    structure = model.response.slopes.structure
    n_dofs = structure.n_dofs
    if model.order is None:
        return np.zeros((n_dofs, 0))
    mass, _ = model.start_matrices
    start_modes = model.start_modes
    near = start_modes.frequency <= _REACH * model.spectra.frequency[-1]
    forces = np.zeros((n_dofs, int(near.sum())))
    row_of = {code: i for i, code in enumerate(structure.numbering.free)}
    forces[[row_of[code] for code in model.structure.numbering.free]] = mass @ start_modes.mode_shapes[:, near]
    return forces


def _alias_factors(spectra: FiniteSpectra, read: ComplexArray, stated: ComplexArray) -> ComplexArray:
    """Factor of the response far above all modes in H, channel errors included, (n_frequencies, n_outputs, n_inputs).

    `read` (n_frequencies, n_outputs) and `stated` (n_frequencies, n_inputs) are the factors of sensors and of load
    cells.
    """
    of_sensors = spectra.hold_aliases * read / spectra.output_powers
    return of_sensors[:, :, None] * (spectra.input_powers / stated)[:, None, :]


def eliminated_columns(columns: ComplexArray) -> EliminatedColumns:
    """Linear unknowns prepared for elimination, from their `columns` (n_unknowns, n_complex), one in each row.

    Normal equations are used if the ratio of their eigenvalues exceeds 1e-9, else an orthonormal basis in place of the
    columns. Unknowns whose columns are 0 explain nothing and are 0.

    References
    ----------
    Demmel, Grigori, Hoemmen and Langou (2012), SIAM J. Sci. Comput. 34, A206-A239 (TSQR).
    """
    kept = np.flatnonzero(columns.any(axis=1))
    if len(kept) < len(columns):
        few = eliminated_columns(columns[kept])
        solution = np.zeros((len(columns), few.solution.shape[1]))
        solution[kept] = few.solution
        return replace(few, solution=solution)
    real = np.ascontiguousarray(columns).view(np.float64)
    n = len(real)
    if n == 0:
        return EliminatedColumns(columns, np.zeros((0, 0)), np.zeros((0, 0)), 0)
    gram = real @ real.T
    size = np.sqrt(np.diag(gram))
    safe = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(gram / np.outer(safe, safe))
    if values[0] > _RESOLVED * values[-1]:
        half = vectors / np.sqrt(values) / safe[:, None]
        inverse = half @ half.T
        return EliminatedColumns(columns, inverse, inverse, n)
    basis, unknowns = _orthonormal(real.T / safe)
    rank = basis.shape[1]
    orthonormal = np.ascontiguousarray(basis.T).view(np.complex128)
    return EliminatedColumns(orthonormal, np.eye(rank), unknowns / safe[:, None], rank)


def _orthonormal(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Orthonormal basis Q (n_rows, rank) of the span of `columns`, and W (n, rank) with `columns` @ W = Q.

    `columns` (n_rows, n) have similar norms; singular values below 1e-10 of the largest count as 0.
    """
    n_rows, n = columns.shape
    blocks = max(1, n_rows // max(_BLOCK_ROWS, 2 * n))
    size = -(-n_rows // blocks)
    padded = np.zeros((blocks * size, n))
    padded[:n_rows] = columns
    within, triangles = np.linalg.qr(padded.reshape(blocks, size, n))
    between, triangle = np.linalg.qr(triangles.reshape(-1, n))
    left, singular, right = np.linalg.svd(triangle)
    rank = int((singular > _DEPENDENT * singular.max(initial=0.0)).sum())
    across = (between @ left[:, :rank]).reshape(blocks, -1, rank)
    return (within @ across).reshape(-1, rank)[:n_rows], right[:rank].T / singular[:rank]


@dataclass(frozen=True, eq=False)
class SpectraProblem(RecordProblem):
    """Parameters from the finite Fourier transforms of forces u and motions y of a test of any kind.

    A record that neither starts and ends at rest nor is periodic obeys, at multiples of one over its duration,

        y = s^d S' Z(s)^-1 [F u + M dv + (s M + C) dw] + polynomial in s,    s = i omega,

    with minus the changes of displacement, dw, and of velocity, dv, over the record; leakage is that transient and
    nothing else. Both changes are unknown and linear: they are solved for at every step (variable projection) and
    take their degrees of freedom from chi-square. So are the true forces, whose measurements carry noise:
    with e = H u + t - y and C = cov(y) + H cov(u) H', the sum of e' C^-1 e is the likelihood of forces and motions
    together, which is unbiased where H1 is not.

    Where forces run straight between samples, H is sampled as well: the share (sinh(s dt/2) / (s dt/2))^2 of H, and the
    aliases of the response far above all modes, whose mass line is taken to begin below the sampling rate.

    Where sensors read a and load cells b times the truth, H becomes diag(a) H diag(1 / b), and the transient is read
    through a; a delay takes what enters and leaves at the ends of the record for part of the transient.

    Parameters
    ----------
    structure : Structure
        Without friction.
    parameters : Parameters
    spectra : FiniteSpectra
    transient : bool
        False if the record is periodic, or starts and ends at rest.
    order : int
        Highest power of s in each output's polynomial, which takes the change of the measured quantity itself,
        the modes above the band, the alias of the jump between the end and the start of the record, and what a late
        channel holds of the time before it instead of its end; see `transient_order`.
    tones : tuple of float
        Hz: steady tones in the motions that no force made, such as mains, with a size and phase of each sensor's own.
        In the transform of a finite record each is (a + b s) / (s^2 + omega^2), and a tone a part of a line beside it
        shows in the square of that: both are linear unknowns beside those of the transient.
    record : TimeRecord, optional
        What the spectra were made from; its ways to the answer start from it, see `damped_stages`.
    channels : ChannelErrors, optional
        Errors of the record's channels; their parameters follow those of the structure.
    cache : ResponseCache
        Cache that it shares with the problems that are made from it.

    Raises
    ------
    InputError
        If the structure has friction, sensors and loads are not part of it, or a window's decay is unknown.

    References
    ----------
    Pintelon and Schoukens (2012), System Identification: A Frequency Domain Approach, 2nd ed., sections 6.3 (the
    transient), 8 and 9 (maximum likelihood with noise on inputs and outputs). Golub and Pereyra (1973), SIAM J. Numer.
    Anal. 10, 413-432; Kaufman (1975), BIT 15, 49-57 (variable projection; this Jacobian gives the exact gradient).
    """

    structure: Structure
    parameters: Parameters
    spectra: FiniteSpectra
    transient: bool = True
    order: int = _ORDER
    record: TimeRecord | None = None
    channels: ChannelErrors | None = None
    cache: ResponseCache = field(default_factory=ResponseCache, repr=False)
    tones: tuple[float, ...] = ()

    compares_spectra = True

    def __post_init__(self) -> None:
        """Raise `InputError` if the structure has friction or no modes, or a window's decay is unknown."""
        self.structure.require_scaled_modes("histories")
        friction = [e.name for e in self.structure.elements if isinstance(e, Friction)]
        if friction:
            raise InputError(
                f"friction {friction[0]!r} has no linear response to a general force; take it out of the structure, or"
                " use FRFs of a stepped sine"
            )
        if self.channels is not None and self.channels.decay(self.channels.start) is not None:
            raise InputError(NO_WINDOW)

    def measured_and_predicted(self, theta: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Cross spectra of motions and forces, and the model's FRFs, (n_frequencies, n_outputs, n_inputs) each."""
        return self.spectra.motion[:, :, None] * self.spectra.force.conj()[:, None, :], self.predicted(theta)

    @property
    def measured_responses(self) -> FiniteSpectra:
        return self.spectra

    @property
    def frequency(self) -> FloatArray:
        return self.spectra.frequency

    def with_lines(self, keep: IntArray) -> SpectraProblem:
        """A copy with the lines at the indices `keep` alone."""
        chosen = np.zeros(len(self.frequency), dtype=bool)
        chosen[keep] = True
        return replace(self, spectra=self.spectra.lines(chosen))

    def subsampled(self) -> SpectraProblem | None:
        """Problem on at most about 2000 lines, spread in the logarithm; None unless there are 2.5 times as many."""
        keep = thinned_lines(2 * np.pi * self.frequency)
        return None if _WORTH_SUBSAMPLING * len(keep) > len(self.frequency) else self.with_lines(keep)

    @property
    def facts(self) -> RecordFacts:
        return replace(
            super().facts,
            line_spacing=np.full(len(self.frequency), 1 / self.spectra.duration),
            measures_force=not self.spectra.driven.any(),
            takes_clock_for_stiffness=self.record is not None
            and set(self.record.quantities) <= {"acceleration", "force"},
            n_channels=len(self.spectra.outputs),
            record=self.record,
        )

    @cached_property
    def rows(self) -> DataRows:
        """Rows of each sensor."""
        return complex_rows(len(self.frequency), [str(output) for output in self.spectra.outputs])

    def schedules(self) -> Sequence[Schedule]:
        """Schedules of decaying exponentials; see `damped_stages`."""
        return () if self.record is None else damped_stages(self, self.record)

    @cached_property
    def model(self) -> SpectraModel:
        """Model of the spectra under forces and the transient."""
        return SpectraModel(
            self.structure, self.parameters, self.spectra, self.channels, self.cache,
            self.order if self.transient else None, self.tones,
        )  # fmt: skip

    def predicted(self, theta: FloatArray) -> ComplexArray:
        """The model's FRFs, each in the kind of its sensor, (n_frequencies, n_outputs, n_inputs)."""
        return self.model.predicted(self.physical(theta))

    def residual(self, theta: FloatArray) -> FloatArray:
        return residual_with_priors(self.unknowns, theta, self.model.evaluated(self.physical(theta)).data)

    def linearize(self, theta: FloatArray) -> Linearization:
        """Weighted residual at the free variables `theta` (n_params,) and its Jacobian by these, prior rows last.

        Transients are eliminated and take degrees of freedom. Data rows are real, then imaginary parts.
        """
        evaluation, change = self.model.changes(self.physical(theta))
        left, _ = evaluation.linear.project_out(np.moveaxis(change, 2, 0).reshape(change.shape[2], -1))
        rows = stack_real(left.T) * self.slope(theta)
        return linearization_with_priors(self.unknowns, theta, evaluation.data, rows, evaluation.linear.rank)


def spectra_problem(
    structure: Structure,
    unknown: Parameters,
    record: TimeRecord,
    band: tuple[float, float] | None = None,
    transient: bool = True,
    straight: bool = False,
) -> SpectraProblem:
    """The `SpectraProblem` of all channels of a time record, without windows, averages or leakage.

    Parameters
    ----------
    structure : Structure
    unknown : Parameters
    record : TimeRecord
        Forces and motions, with the noise variance of each channel.
    band : (float, float), optional
        Hz.
    transient : bool
        Off for periodic records and for those that start and end at rest.
    straight : bool
        Whether forces run straight between samples, see `finite_spectra`.
    """
    spectra = finite_spectra(record, band=band, straight=straight)
    return SpectraProblem(structure, unknown, spectra, transient, record=record)


def transient_order(channels: ChannelErrors | None) -> int:
    """Highest power of s in the polynomials of records whose channels have these errors."""
    return _LATE_ORDER if channels is not None and "delay" in channels.kinds else _ORDER


def damped_stages(problem: SpectraProblem, record: TimeRecord) -> tuple[Schedule, ...]:
    """Two sequences of stages for a poor start: fits to the record times exp(-sigma t), with falling sigma.

    Damped forces and motions obey the same equation at s = sigma + i omega, without approximation, and have no
    resonances for large sigma. Each stage has a Gaussian prior at the start and an error of a tenth of each value.
    Stages are (name, problem); the first sequence has finer steps.

    Parameters
    ----------
    problem : SpectraProblem
        Its undamped spectra give channels and band.
    record : TimeRecord
        Record that the spectra of `problem` come from.

    References
    ----------
    Shin and Cha (2009), Geophys. J. Int. 177, 1067-1079 (waveform inversion in the Laplace-Fourier domain).
    """
    top = 2 * np.pi * problem.spectra.frequency[-1]
    near = problem.with_parts([part.kept_near_start(_START_ERROR) for part in problem.parts])
    near = replace(near, transient=True)  # of a periodic record too, once it fades
    band = (problem.spectra.frequency[0], problem.spectra.frequency[-1])
    sequences = []
    for decays, order in _WAYS:
        stages = []
        for decay in decays:
            outputs, straight = dict.fromkeys(problem.spectra.outputs), bool(problem.spectra.straight)
            faded = finite_spectra(record, problem.spectra.inputs, outputs, band, decay * top, straight)
            loose = faded.motion_variance + (_STAGE_ERROR * np.abs(faded.motion)) ** 2
            spectra = replace(faded, motion_variance=loose)
            stages.append(
                (f"decay of {decay * top:.3g}/s", replace(near, spectra=spectra, order=min(order, problem.order)))
            )
        sequences.append(tuple(stages))
    return tuple(sequences)
