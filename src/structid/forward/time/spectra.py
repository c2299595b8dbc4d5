"""Forces and motions of one finite record as a least-squares problem: no leakage error, noise on both sides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray, stack_real
from structid.core.errors import InputError
from structid.fem import Friction, Structure
from structid.forward.channel_errors import ChannelErrors
from structid.forward.frf.continuation import thinned_lines
from structid.forward.frf.response import ResponseCache
from structid.forward.record_problem import (
    RecordFacts,
    RecordProblem,
    complex_rows,
    linearization_with_priors,
    residual_with_priors,
)
from structid.forward.time.spectra_model import SpectraModel
from structid.inversion.linearization import Linearization
from structid.inversion.problem import DataRows, Schedule
from structid.records import TimeRecord
from structid.records.transforms.finite_spectra import FiniteSpectra, finite_spectra
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
    cache : ResponseCache
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
    cache: ResponseCache = field(default_factory=ResponseCache, repr=False)
    tones: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        """Raise `InputError` if the structure has friction or no modes, or a window's decay is unknown."""
        self.structure.require_modes("histories")
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
        """Weighted residual at the free variables `theta` (n_params,) with its Jacobian, prior rows included."""
        at, change = self.model.changes(self.physical(theta))
        left, _ = at.linear.project_out(np.moveaxis(change, 2, 0).reshape(change.shape[2], -1))
        rows = stack_real(left.T) * self.slope(theta)
        return linearization_with_priors(self.unknowns, theta, at.data, rows, at.linear.rank)


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

    Damped forces and motions obey the same equation at s = sigma + i omega, without approximation, and have no resonances for
    large sigma. Each stage has a Gaussian prior at the start and an error of a tenth of each value. Stages are (name, problem);
    the first sequence has finer steps.

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
