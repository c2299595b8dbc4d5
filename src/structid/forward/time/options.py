"""Assumptions on force, start and sensors when parameters are identified from time histories."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from structid.core.constraints import Count, Number, Positive, require_declared
from structid.core.errors import InputError
from structid.records.record import Quantity
from structid.unknowns.tolerances import EXACT, Tolerances

TimeMethod = Literal["output_error", "instrumental", "weak"]
Hold = Literal["first", "zero"]
Initial = Literal["rest", "unknown"]


@dataclass(frozen=True)
class Oscillation:
    """A force whose waveform is known: a cos(omega t) + b sin(omega t), t the time of the record.

    Amplitudes come from the record's force channels: by least squares where these are exact (variance 0), and together
    with the parameters, as unknowns of their own, where they are noisy.

    Parameters
    ----------
    omega : float
        rad/s.
    sine : bool
        Whether b is free; otherwise it is 0.
    """

    omega: float
    sine: bool = True

    def __post_init__(self) -> None:
        if not np.isfinite(self.omega) or self.omega <= 0:
            raise InputError(f"`omega` must be positive, got {self.omega!r} rad/s; a constant force is a sampled one")


@dataclass(frozen=True)
class TimeOptions:
    """Options of `identify_time`: how a record is read, and by which estimator.

    Parameters
    ----------
    method : {"output_error", "instrumental", "weak"}
        ``output_error``: maximum likelihood of what the sensors read, wherever they are. ``instrumental``: refined
        instrumental variables, linear, where acceleration, velocity and displacement of every degree of freedom are
        had. ``weak``: integrals against test functions, where every degree of freedom has one of the three.
    force : {"first", "zero"} or Oscillation
        Between its samples the force runs straight, or stays; or it is an oscillation.
    initial : {"rest", "unknown"}
        State at the first sample (or at `rest_time`). Not used by ``weak``.
    rest_time : float, optional
        Time in s, at or before the first sample, until which the structure was at rest; needs an `Oscillation` where
        it is before the first sample, since nothing else says how large the force was until then.
    quantities : tuple of {"displacement", "velocity", "acceleration"}
        Kinds of channels that are fitted; others serve at most to start from.
    first_samples : int, optional
        Samples of the first stage of ``output_error``; later stages double it. Made from the numbers of channels and
        parameters by default.
    restarts : int
        How many random starts ``output_error`` tries where a stage misses the noise, and after two of them up to six
        made by posterior linearization for initial values that are far off; with 0 there is neither.
    misfit_probability : float
        Probability of its chi-square below which a fit misses the noise.
    seed : int
        Of these starts.
    max_iterations : int
        Of each stage, and of the reweighting of ``instrumental`` and ``weak``.
    tolerances : Tolerances
        Of the values that the model holds fixed and of the common gain of the record; exact by default.
    window : float, optional
        Length of the test functions of ``weak`` in s. They pass frequencies up to about 5 / `window` Hz; by default
        95 % of the power of every channel, but no longer than a fifth of the record.
    windows : int, optional
        Number of test functions; evenly spread, eight to a length by default.
    drift : int
        ``weak`` is made blind to polynomials of time with this many terms added to any channel: 1 for an offset, 2 for
        an offset and a straight drift.
    """

    method: TimeMethod = "output_error"
    force: Hold | Oscillation = "first"
    initial: Initial = "rest"
    rest_time: float | None = None
    quantities: tuple[Quantity, ...] = ("displacement", "velocity", "acceleration")
    first_samples: Count | None = None
    restarts: Number = 6
    misfit_probability: float = 1e-4
    seed: int = 0
    max_iterations: Count = 50
    tolerances: Tolerances = EXACT
    window: Positive | None = None
    windows: Count | None = None
    drift: Number = 0

    def __post_init__(self) -> None:
        """Raise `InputError` on an undeclared value, wrong `quantities`, or a `rest_time` where the start is unknown.

        `quantities` must hold at least one of the three kinds of motion, and nothing else.
        """
        require_declared(self)
        if not self.quantities or not set(self.quantities) <= {"displacement", "velocity", "acceleration"}:
            raise InputError(f"`quantities` must list kinds of motion, got {self.quantities!r}")
        if self.rest_time is not None and self.initial == "unknown":
            raise InputError("`rest_time` contradicts `initial` 'unknown'; leave one of them out")
