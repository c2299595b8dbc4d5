"""Forces and motions of one finite record as a least-squares problem: no leakage error, noise on both sides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from structid.arrays import ComplexArray, FloatArray, IntArray, stack_real
from structid.dynamics.modes import modes
from structid.errors import InputError
from structid.estimation.linearization import Linearization
from structid.estimation.problem import Stages
from structid.observation.channel_errors import ChannelErrors
from structid.observation.frf.continuation import thinned_lines
from structid.observation.frf.response import Models, Response, response
from structid.observation.latest import Latest
from structid.observation.record_problem import DataRows, RecordFacts, ResponseProblem, complex_rows
from structid.observation.time.eliminated import Evaluation, orthonormal
from structid.records import FrfRecord, TimeRecord
from structid.records.record import FrfKind
from structid.records.transforms.finite_spectra import FiniteSpectra, finite_spectra
from structid.structure import Friction, Structure
from structid.unknowns import Parameters

#: Highest power of s in the polynomial of each output, and where a channel may be late: up to two samples are taken.
_ORDER, _LATE_ORDER = 4, 8
#: Modes up to this multiple of the highest line take part in the transient.
_REACH = 2.0
#: By which part of a line a tone is kept off it.
_OFF_LINE = 1e-4
#: Decays of the stages, in parts of the highest circular frequency, and the order of their polynomials.
_WAYS = (((0.3, 0.1, 0.05, 0.025, 0.012, 0.006), 4), ((0.3, 0.1, 0.03, 0.01), 1))
#: A part of the lines is searched on where it is smaller by this factor; the answer is that of all.
_WORTH_THINNING = 2.5
#: Line at which a structure answers by its mass alone, in parts of the sampling rate.
_FAR = 10.0
#: Relative error that the start is taken to have, and that of each value in the stages.
_START_ERROR, _STAGE_ERROR = 0.5, 0.1
NO_WINDOW = (
    "a window's decay is no error of histories that are fitted themselves, which need no window; take the windowed record's"
    " FRFs, or undo the window"
)


@dataclass(frozen=True, eq=False)
class SpectraProblem(ResponseProblem):
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
        Off: the record is periodic, or starts and ends at rest.
    order : int
        Highest power of s in each output's polynomial, which takes the change of the measured quantity itself,
        the modes above the band, the alias of the jump between the end and the start of the record, and what a late
        channel holds of the time before it instead of its end; see `transient_order`.
    tones : tuple of float
        Hz: steady tones in the motions that no force made, such as mains, with a size and phase of each sensor's own. In the
        transform of a finite record each is (a + b s) / (s^2 + omega^2), and a tone a part of a line beside it shows in the
        square of that: both are linear unknowns beside those of the transient.
    record : TimeRecord, optional
        What the spectra were made from; its ways to the answer start from it, see `damped_stages`.
    channels : ChannelErrors, optional
        Errors of the record's channels; their parameters follow those of the structure.
    models : Models
        What it has in common with the problems that are made from it.

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
    models: Models = field(default_factory=Models, repr=False)
    tones: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        self.structure.require_modes("histories")
        friction = [e.name for e in self.structure.elements if isinstance(e, Friction)]
        if friction:
            raise InputError(
                f"friction {friction[0]!r} has no linear response to a general force; take it out of the structure, or"
                " use FRFs of a stepped sine"
            )
        if self.channels is not None and self.channels.decay(self.channels.start) is not None:
            raise InputError(NO_WINDOW)

    def compared(self, theta: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Cross spectra of every line, and the model's FRFs: over all lines other forces leave no sign."""
        return self.spectra.motion[:, :, None] * self.spectra.force.conj()[:, None, :], self.predicted(theta)

    @property
    def frequency(self) -> FloatArray:
        return self.spectra.frequency

    def with_lines(self, keep: IntArray) -> SpectraProblem:
        chosen = np.zeros(len(self.frequency), dtype=bool)
        chosen[keep] = True
        return replace(self, spectra=self.spectra.lines(chosen))

    def thinned(self) -> SpectraProblem | None:
        """The problem on lines closer together at low frequencies, as those of FRFs, where they are much fewer."""
        keep = thinned_lines(2 * np.pi * self.frequency)
        return None if _WORTH_THINNING * len(keep) > len(self.frequency) else self.with_lines(keep)

    @property
    def facts(self) -> RecordFacts:
        return replace(
            super().facts,
            line_spacing=np.full(len(self.frequency), 1 / self.spectra.duration),
            measures_force=not self.spectra.driven.any(),
            n_channels=len(self.spectra.outputs),
            record=self.record,
        )

    @cached_property
    def rows(self) -> DataRows:
        """Of each sensor."""
        return complex_rows(len(self.frequency), [str(output) for output in self.spectra.outputs])

    def stage_plans(self) -> Sequence[Stages]:
        """Ways to the answer; see `damped_stages`."""
        return () if self.record is None else damped_stages(self, self.record)

    @cached_property
    def model(self) -> Response:
        """The structure at the record's lines; of its sensors one stands for each place and direction."""
        return self._response(self.spectra.frequency)

    @cached_property
    def _far_model(self) -> Response:
        """The same at one line far above all modes."""
        return self._response(np.array([_FAR / self.spectra.straight]))

    def _response(self, frequency: FloatArray) -> Response:
        distinct = tuple(dict.fromkeys(self.spectra.outputs))
        shape = (len(frequency), len(distinct), len(self.spectra.inputs))
        decay = np.full(shape[0], self.spectra.decay)
        kind: FrfKind = "transmissibility" if self.spectra.driven.any() else "receptance"
        place = FrfRecord(frequency, np.zeros(shape, complex), distinct, self.spectra.inputs, kind, decay=decay)
        return response(self.structure, self.parameters, place, models=self.models)

    @cached_property
    def _columns(self) -> sparse.csc_array:
        """Loads, then sensors, then the forces of the transient, each (n_dofs, ...)."""
        structure = self.model.slopes.structure
        loads, sensors = structure.selection(self.spectra.inputs), structure.selection(self.spectra.outputs)
        return sparse.csc_array(sparse.hstack([loads, sensors, sparse.csc_array(self._transient_forces)]))

    @cached_property
    def _transient_forces(self) -> FloatArray:
        """M times the shapes of the start's modes near the band: what changes of state act like, (n_dofs, n).

        Supports that drive the structure are held in these, and carry no force.
        """
        known = self.model.slopes.structure
        n_dofs = known.n_dofs
        if not self.transient:
            return np.zeros((n_dofs, 0))
        values = self.parameters.values(self.parameters.start)
        mass = self.structure.matrix("inertia", values)
        found = modes(mass, self.structure.matrix("elastic", values))
        near = found.frequency <= _REACH * self.spectra.frequency[-1]
        forces = np.zeros((n_dofs, int(near.sum())))
        place = {code: i for i, code in enumerate(known.numbering.free)}
        forces[[place[code] for code in self.structure.numbering.free]] = mass @ found.mode_shapes[:, near]
        return forces

    @cached_property
    def _powers(self) -> ComplexArray:
        """s^d of each line and output, (n_frequencies, n_outputs)."""
        return self.spectra.laplace[:, None] ** self.spectra.orders[None, :]

    @cached_property
    def _input_powers(self) -> ComplexArray:
        """What each input holds over what acts: 1 of forces, s^2 of accelerations of supports; (n_frequencies, n_inputs)."""
        return self.spectra.laplace[:, None] ** (2 * self.spectra.driven)[None, :]

    @cached_property
    def _relative_laplace(self) -> ComplexArray:
        """s in parts of its size at the highest line, (n_frequencies,)."""
        return self.spectra.laplace / abs(self.spectra.laplace[-1])

    def predicted(self, theta: FloatArray) -> ComplexArray:
        """The model's FRFs, each in the kind of its sensor, (n_frequencies, n_outputs, n_inputs)."""
        return self._state(*self._split(self.physical(theta)))[2]

    def residual(self, theta: FloatArray) -> FloatArray:
        at = self._evaluated(theta)
        if at.is_small:
            self._latest.keep(theta, at)
        return self._residual(theta, at.data)

    def linearize(self, theta: FloatArray) -> Linearization:
        at, physical = self._latest.taken(theta) or self._evaluated(theta), self.physical(theta)
        own = physical[: self.parameters.n_params]
        change = self.model.sensitivity_at(own, at.motion, at.y)[:, :, 0] * at.read[:, :, None]
        if self.spectra.straight:
            change = change + np.einsum("foi,oip->fop", at.aliased, self._mass_line_change(own))
        change = at.whitening @ np.concatenate([change, self._channel_changes(physical, at)], axis=2)
        rows = stack_real(change.reshape(-1, change.shape[2]))
        rows -= at.basis @ (at.basis.T @ rows)
        return self._linearized(theta, at.data, rows * self.slope(theta), at.basis.shape[1])

    @cached_property
    def _latest(self) -> Latest[Evaluation]:
        """The derivative is asked for where a step was tried."""
        return Latest()

    def _state(
        self, own: FloatArray, read: ComplexArray, stated: ComplexArray
    ) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Motions under loads and transient forces, motions under unit sensor forces, and H with errors of channels."""
        n_in, n_out = len(self.spectra.inputs), len(self.spectra.outputs)
        fields = self.model.fields_at(own, self._columns)
        y = fields[:, :, n_in : n_in + n_out]
        x = np.concatenate([fields[:, :, :n_in], fields[:, :, n_in + n_out :]], axis=2)
        sensors = self._columns[:, n_in : n_in + n_out]
        motions = np.moveaxis(x[:, :, :n_in], 1, 0).reshape(x.shape[1], -1)
        h = np.swapaxes((sensors.T @ motions).reshape(n_out, -1, n_in), 0, 1)
        h = h * read[:, :, None] * (self.spectra.straight_share[:, None] / stated)[:, None, :]
        if self.spectra.straight:
            h += self._alias_factors(read, stated) * self._mass_line(own)
        return x, y, h

    def _alias_factors(self, read: ComplexArray, stated: ComplexArray) -> ComplexArray:
        """What multiplies the response far above all modes in H, errors of channels included."""
        of_sensors = self.spectra.straight_aliases * read / self._powers
        return of_sensors[:, :, None] * (self._input_powers / stated)[:, None, :]

    def _mass_line(self, own: FloatArray) -> FloatArray:
        """Accelerations per unit force (or motion per unit motion of supports) far above all modes, (n_outputs, n_inputs)."""
        x, _ = self._far_fields(own)
        n_in, n_out = len(self.spectra.inputs), len(self.spectra.outputs)
        sensors = self._columns[:, n_in : n_in + n_out]
        return np.real(self._far_powers * (sensors.T @ x[0]))

    def _mass_line_change(self, own: FloatArray) -> FloatArray:
        """Its derivative, (n_outputs, n_inputs, n_own_params)."""
        x, y = self._far_fields(own)
        return np.real(self._far_powers[:, None] * self._far_model.sensitivity_at(own, x, y)[0])

    def _far_fields(self, own: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        n_in, n_out = len(self.spectra.inputs), len(self.spectra.outputs)
        fields = self._far_model.fields_at(own, self._columns[:, : n_in + n_out])
        return fields[:, :, :n_in], fields[:, :, n_in:]

    @cached_property
    def _far_powers(self) -> ComplexArray:
        """s^2 at that line for forces, 1 for accelerations of supports, (n_inputs,)."""
        s = self.spectra.decay + 2j * np.pi * _FAR / self.spectra.straight
        return s ** (2.0 * ~self.spectra.driven)

    def _split(self, physical: FloatArray) -> tuple[FloatArray, ComplexArray, ComplexArray]:
        """Parameters of the structure, what sensors read over the displacement, and what load cells read over the force.

        Shapes (n_own,), (n_frequencies, n_outputs) and (n_frequencies, n_inputs).
        """
        own, rest = np.split(physical, [self.parameters.n_params])
        if self.channels is None:
            return own, self._powers, self._input_powers
        sensors, loads = self.channels.readings(rest, self.spectra.laplace)
        return own, self._powers * sensors, self._input_powers * loads

    def _evaluated(self, theta: FloatArray) -> Evaluation:
        physical, spectra = self.physical(theta), self.spectra
        own, read, stated = self._split(physical)
        x, y, h = self._state(own, read, stated)
        noise = np.einsum("foi,fi,fpi->fop", h, spectra.force_variance, h.conj())
        diagonal = np.arange(len(spectra.outputs))
        noise[:, diagonal, diagonal] += spectra.motion_variance
        whitening = np.linalg.inv(np.linalg.cholesky(noise) / np.sqrt(2))
        error = (h @ spectra.force[:, :, None])[:, :, 0] - spectra.motion
        reach = self._reach(y, read)
        whitened = whitening @ np.concatenate([error[:, :, None], reach], axis=2)
        basis, unknowns, scale = orthonormal(stack_real(self._whitened_columns(whitening, whitened[:, :, 1:])))
        misfit = stack_real(whitened[:, :, 0].reshape(-1))
        given = basis.T @ misfit
        data = misfit - basis @ given
        coefficients = -scale * (unknowns @ given)
        # the likeliest forces as load cells read them, u - cov(u) H' C^-1 e, with e = L (data) of the whitened misfit
        own_data = data[: error.size] + 1j * data[error.size :]
        weighed = np.conj(np.swapaxes(whitening, 1, 2)) @ own_data.reshape(*error.shape, 1) / 2
        force = spectra.force - spectra.force_variance * (np.conj(np.swapaxes(h, 1, 2)) @ weighed)[:, :, 0]
        n = self._transient_forces.shape[1]
        left = coefficients[:n] + self._relative_laplace[:, None] * coefficients[n : 2 * n]
        acting = force * self.spectra.straight_share[:, None] / stated
        motion = x @ np.concatenate([acting, left], axis=1)[:, :, None]
        aliased = self._alias_factors(read, stated) * force[:, None, :]
        free = (reach @ left[:, :n, None])[:, :, 0]
        return Evaluation(y, read, h * force[:, None, :], free, motion, aliased, whitening, basis, data)

    def _reach(self, y: ComplexArray, read: ComplexArray) -> ComplexArray:
        """How the transient's forces show in the motions, (n_frequencies, n_outputs, n_forces)."""
        return np.swapaxes(y, 1, 2) @ self._transient_forces * read[:, :, None]

    def _whitened_columns(self, whitening: ComplexArray, reach: ComplexArray) -> ComplexArray:
        """Every linear unknown in the whitened motions: jumps of each mode, then each output's polynomial and tones.

        Shape (n_frequencies * n_outputs, n_unknowns).
        """
        n_lines, n_out = self.spectra.motion.shape
        s = self._relative_laplace[:, None, None]
        own = (whitening[..., None] * self._own_shapes[:, None, None]).reshape(n_lines, n_out, -1)
        return np.concatenate([reach, s * reach, own], axis=2).reshape(n_lines * n_out, -1)

    @cached_property
    def _own_shapes(self) -> ComplexArray:
        """What each output may hold of its own, (n_frequencies, n_shapes): a polynomial in s, and tones."""
        s = self._relative_laplace
        powers = [s**k for k in range(self.order + 1 if self.transient else 0)]
        for tone in self.tones:
            off = _OFF_LINE / self.spectra.duration  # a tone on a line has no finite transform
            pole = s**2 + ((tone + off) / self.spectra.frequency[-1]) ** 2
            powers += [1 / pole, s / pole, 1 / pole**2, s / pole**2]
        return np.stack(powers, axis=1) if powers else np.zeros((len(s), 0), dtype=np.complex128)

    def _channel_changes(self, physical: FloatArray, at: Evaluation) -> ComplexArray:
        """Derivative of the motions with respect to the errors of channels, (n_frequencies, n_outputs, n_params).

        That of the transient is read with the sensor's error alone.
        """
        if self.channels is None:
            return np.zeros((*self.spectra.motion.shape, 0), dtype=np.complex128)
        rest, laplace = physical[self.parameters.n_params :], self.spectra.laplace
        of_loads = np.einsum("foik,foi->fok", self.channels.log_slopes(rest, laplace), at.forced)
        changes: ComplexArray = of_loads + self.channels.output_slopes(rest, laplace) * at.free[:, :, None]
        return changes


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


def damped_stages(problem: SpectraProblem, record: TimeRecord) -> tuple[Stages, ...]:
    """Ways to the answer of `problem` from a poor start: the same record with its signals faded out, less and less.

    Multiplied by exp(-sigma t), forces and motions obey the same equation at s = sigma + i omega, with the transient
    exp(-sigma T) w(T) - w(0); nothing is approximated. Far from the axis there are no resonances to be caught
    between, and the answer is followed down to the axis. Every parameter is drawn to its start, and each value
    counts with an error of a tenth of its size. The first way goes in finer steps than the second.

    Parameters
    ----------
    problem : SpectraProblem
    record : TimeRecord
        Where its spectra come from.

    References
    ----------
    Shin and Cha (2009), Geophys. J. Int. 177, 1067-1079 (waveform inversion in the Laplace-Fourier domain).
    """
    top = 2 * np.pi * problem.spectra.frequency[-1]
    near = problem.with_parts([part.kept_near_start(_START_ERROR) for part in problem.parts])
    near = replace(near, transient=True)  # of a periodic record too, once it fades
    band = (problem.spectra.frequency[0], problem.spectra.frequency[-1])
    ways = []
    for decays, order in _WAYS:
        way = []
        for decay in decays:
            outputs, straight = dict.fromkeys(problem.spectra.outputs), bool(problem.spectra.straight)
            faded = finite_spectra(record, problem.spectra.inputs, outputs, band, decay * top, straight)
            loose = faded.motion_variance + (_STAGE_ERROR * np.abs(faded.motion)) ** 2
            spectra = replace(faded, motion_variance=loose)
            way.append(
                (f"decay of {decay * top:.3g}/s", replace(near, spectra=spectra, order=min(order, problem.order)))
            )
        ways.append(tuple(way))
    return tuple(ways)
