"""Options of an identification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal

from structid.core.constraints import Count, Limits, NotNegative, Positive, require_band
from structid.forward.frf.continuation import START_ERROR
from structid.inversion import LevenbergMarquardt, Method
from structid.inversion.intervals import IntervalKind
from structid.unknowns import Regularization
from structid.unknowns.tolerances import Tolerances


@dataclass(frozen=True, kw_only=True)
class IdentifyOptions:
    """Options of an identification: which lines count, what is minimized, how it is searched for, and what is shown.

    Parameters
    ----------
    band : (float, float), optional
        Lowest and highest frequency used, Hz; all lines by default.
    exclude : sequence of (float, float)
        Stretches of the band that are left out, Hz.
    evaluation_band : (float, float), optional
        Where the fit is judged and drawn, Hz; the lines that were used by default. A wider one shows how the model
        does on lines that had no part in the fit.
    every : int
        Only every so many of the remaining lines is used: 4 leaves a quarter of a long record, for a first look.
    residual : Form
        Residual of the last stage; see `FrfProblem`.
    model_error : float
        Error of the model as a part of each value's magnitude, added to the noise.
    reduced : float, optional
        Largest error of the model's FRFs, in parts of the largest of their line, with which a large model may find them
        from few factorizations; see `FrfProblem`. 1e-5 by default for models of 1,000 degrees of freedom or more and records
        of 20 lines or more; 0 solves for every line.
    regularization : sequence of Smoothness or Sparsity
        What holds parameters that the data alone do not determine.
    pole_free_start : bool
        Whether a search on easier forms of the residual comes first, for starts far from the answer.
    start : {"near", "continuation"}
        Which way the search comes first: by easier forms of the residual, for initial values that are near, or by
        continuation from the right half-plane, which carries further (see `decay_continuation`). The other ways
        follow in `restarts`.
    start_error : float
        Expected error of the initial values in the logarithm, for the continuation: 0.5 is a factor of 1.65.
    restarts : int
        How many more searches are tried where the fit does not reach the noise: one by another way from the same
        start, then from random starts about 20 % from it. The best fit is kept. A matrix-free search has one start.
    uniqueness_starts : int
        How many more searches begin at such random starts even where a search fits: a test whether other parameters
        fit the data as well. There are four at least where a fit is to be doubted: the data push a parameter beyond its
        bound, or an answer from modes alone is more than a factor of two away from its start.
    wide_starts : int, optional
        How many more searches begin at most at factors of up to five from the start, and along the weakest directions from
        each answer, where a search fits: they end where no more answers are to be expected. Every set of values that fits
        as well is listed. By default up to 200 for modes of small models where no shape is known or where there are fewer values
        than twice the parameters, else none.
    seed : int
        Seed of random starts and of posterior draws.
    method : Method
        Search of the last stage.
    matrix_free : bool, optional
        Whether the parameters are searched for without a Jacobian; by default where one is too large.
    intervals : {"laplace", "profile", "bootstrap", "sampling"}
        How the 95 % interval of each parameter is found, in rising order of cost; see
        `structid.inversion.intervals`.
    direction : str, optional
        Translation of the total mass; the first that has mass by default.
    n_modes : int
        How many modes of the identified model are given.
    tolerances : Tolerances
        How well the values are known that the model holds, of element sets and records that state none of their own; `EXACT` for
        simulated ones. Intervals and verdicts allow for them.
    """

    band: tuple[float, float] | None = None
    exclude: Sequence[tuple[float, float]] = ()
    evaluation_band: tuple[float, float] | None = None
    every: Count = 1
    residual: Literal["output", "log", "pole_free"] = "output"
    model_error: NotNegative = 0.0
    reduced: Annotated[float, Limits(least=0, most=0.01)] | None = None
    regularization: Sequence[Regularization] = ()
    pole_free_start: bool = True
    start: Literal["near", "continuation"] = "near"
    start_error: Positive = START_ERROR
    restarts: int = 2
    uniqueness_starts: int = 0
    wide_starts: Annotated[int, Limits(least=0)] | None = None
    seed: int = 0
    method: Method = field(default_factory=LevenbergMarquardt)
    matrix_free: bool | None = None
    intervals: IntervalKind = "laplace"
    direction: Literal["X", "Y", "Z"] | None = None
    n_modes: Count = 12
    tolerances: Tolerances = field(default_factory=Tolerances)

    def __post_init__(self) -> None:
        """Raise `InputError` if a band or exclusion begins below 0 Hz or goes from high to low, or a band has no end."""
        bands = {"band": [self.band], "evaluation_band": [self.evaluation_band], "exclude": self.exclude}
        for name, pairs in bands.items():
            for pair in pairs:
                if pair is not None:
                    require_band(name, pair, is_line_allowed=True, is_open_allowed=name == "exclude")
