"""A study of very many parameters: smoothness chosen and parameters found without a Jacobian, J'J or a covariance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy import sparse

from structid.arrays import locked
from structid.errors import InputError
from structid.estimation import JointProblem
from structid.estimation.free_estimate import FreeEstimate, free_estimate
from structid.estimation.regularization.free_strengths import (
    Differences,
    SettledStrengths,
    balanced_strengths,
    settled_strengths,
)
from structid.estimation.search.levenberg_marquardt_free import (
    FreeLevenbergMarquardt,
    free_levenberg_marquardt,
    needs_free_search,
)
from structid.estimation.search.minimum import Progress
from structid.estimation.search.work import ALONE, StageProgress, Work
from structid.identification.identified import RecordFit, Setup
from structid.identification.identify import IdentifyOptions, prepared_problem, record_fit, titles
from structid.identification.regularizing import Held, coupled
from structid.identification.search import RecordProblem, alike, together
from structid.identification.warning_words import record_fit_warnings
from structid.observation import FrfProblem
from structid.structure import Friction
from structid.unknowns import Coupling, Smoothness, penalty, term_name

_STAGED = FreeLevenbergMarquardt(max_iterations=20, gain_tolerance=1e-3, inner_tolerance=1e-3)


@dataclass(frozen=True, eq=False)
class FreeIdentification:
    """Very many parameters with what they were made from and what they predict.

    Attributes
    ----------
    estimate : FreeEstimate
    fits : tuple of RecordFit
        Each record beside the model.
    held : tuple of Held
        Smoothness and its strength.
    determined : tuple of float
        How many combinations the data determine in spite of each smoothness; NaN where its strength was given.
    total_mass, total_mass_std : float
        kg; NaN where the structure has no mass property in kg.
    warnings : tuple of str
        What the reader should know first.
    """

    estimate: FreeEstimate
    fits: tuple[RecordFit, ...]
    held: tuple[Held, ...]
    determined: tuple[float, ...]
    total_mass: float
    total_mass_std: float
    warnings: tuple[str, ...]

    @property
    def fit(self) -> RecordFit:
        """The first record."""
        return self.fits[0]


def searches_free(problems: Sequence[RecordProblem], options: IdentifyOptions) -> bool:
    """Whether the parameters are searched for without a Jacobian: where asked for, or where one is too large.

    Raises
    ------
    InputError
        If it is asked for and the study has what such a search cannot do.
    """
    if options.matrix_free is False:
        return False
    obstacle = free_obstacle(problems, options)
    if options.matrix_free:
        if obstacle:
            raise InputError(f"search 'matrix_free' {obstacle}; leave it out, or choose 'levenberg_marquardt'")
        return True
    return not obstacle and needs_free_search(together(problems))[0]


def free_obstacle(problems: Sequence[RecordProblem], options: IdentifyOptions) -> str:
    """What a search without a Jacobian cannot do of this study; "" where nothing stands in its way."""
    for problem in problems:
        if not isinstance(problem, FrfProblem):
            return "takes records of responses, got one of modes"
        if problem.channels is not None:
            return "takes no errors of channels"
        if any(isinstance(element, Friction) for element in problem.structure.elements):
            return "takes no dry friction"
    if options.intervals != "laplace":
        return f"takes intervals 'laplace', got {options.intervals!r}"
    for term in options.regularization:
        if not isinstance(term, Smoothness):
            return f"takes smoothness as the only regularization, got {term_name(term)}"
        if isinstance(term.strength, str) and term.strength != "marginal_likelihood":
            return f"takes a given strength or 'marginal_likelihood', got {term.strength!r} for {term_name(term)}"
    return ""


def identify_free(
    setups: Sequence[Setup], options: IdentifyOptions, progress: StageProgress | None = None, work: Work = ALONE
) -> FreeIdentification:
    """The parameters of records of responses, without a Jacobian.

    Parameters
    ----------
    setups : sequence of Setup
        Parameters of the same name are one unknown; the smoothness is that of the first structure.
    options : IdentifyOptions
    progress : callable, optional
        Called with the stage's name, the iteration and the sum of squares.
    work : Work
        Keeps the state after each iteration.

    Returns
    -------
    FreeIdentification
        Also where the search failed: see ``estimate.status``.
    """
    prepared = [prepared_problem(s.structure, s.parameters, s.record, options, s.channel_unknowns) for s in setups]
    problems = _of_responses(alike([problem for problem, _ in prepared]))
    first = problems[0]
    terms = [term for term in options.regularization if isinstance(term, Smoothness)]
    unit = tuple(penalty(first.structure, first.parameters, term) for term in terms)
    made = partial(_smoothed, problems, unit)
    settled = _settled(made, unit, terms, options, progress, work)
    whole = made(settled.strengths)
    found = free_estimate(
        whole,
        FreeLevenbergMarquardt(max_iterations=options.method.max_iterations, gain_tolerance=1e-8),
        seed=options.seed,
        progress=_named(progress, "final"),
        theta=settled.theta,
        keeper=work.keeper(whole),
    )
    held = tuple(
        _held(term, coupling, strength, settled.converged)
        for term, coupling, strength in zip(terms, unit, settled.strengths, strict=True)
    )
    mass, std = _total_mass(setups[0], found, options.direction)
    fits = tuple(
        record_fit(title, setup, problem, (found.theta[index], found.values[index], found.initial[index]), options)
        for title, setup, problem, index in zip(titles(setups), setups, problems, whole.columns, strict=True)
    )
    prefixed = record_fit_warnings(fits, [own for _, own in prepared])
    return FreeIdentification(found, fits, held, settled.determined, mass, std, (*prefixed, *_warnings(found, held)))


def _of_responses(problems: Sequence[RecordProblem]) -> tuple[FrfProblem, ...]:
    return tuple(problem for problem in problems if isinstance(problem, FrfProblem))


def _smoothed(problems: Sequence[RecordProblem], unit: Sequence[Coupling], strengths: Sequence[float]) -> JointProblem:
    rows = [coupling.scaled(strength) for coupling, strength in zip(unit, strengths, strict=True)]
    return JointProblem(coupled(problems, rows))


def _settled(
    made: Callable[[Sequence[float]], JointProblem],
    unit: Sequence[Coupling],
    terms: Sequence[Smoothness],
    options: IdentifyOptions,
    progress: StageProgress | None,
    work: Work,
) -> SettledStrengths:
    """The strengths, and where the last search begins: after easier forms of the residual, and the fits on the way."""
    given = tuple(None if isinstance(term.strength, str) else float(term.strength) for term in terms)
    unheld = made([1.0] * len(given))
    differences = [_differences(coupling, len(unheld.names)) for coupling in unit]
    theta = np.asarray(unheld.theta_start)
    strengths = balanced_strengths(unheld, theta, differences, given)
    if options.pole_free_start:
        for name, stage in made(strengths).stage_plans()[0]:
            told = _named(progress, name)
            theta = free_levenberg_marquardt(stage, _STAGED, theta, told, work.keeper(stage)).theta
    if None not in given:
        return SettledStrengths(strengths, (np.nan,) * len(given), theta, True, 0)
    told, keeper = _named(progress, "strength of smoothness"), work.keeper(unheld)
    return settled_strengths(made, differences, given, strengths, theta, options.seed, told, keeper)


def _named(progress: StageProgress | None, stage: str) -> Progress | None:
    return None if progress is None else partial(progress, stage)


def _differences(coupling: Coupling, n_params: int) -> Differences:
    """The rows of `coupling` among all parameters, of which its own are the first."""
    own = coupling.matrix.shape[1]

    def wide(rows: sparse.csr_array) -> sparse.csr_array:
        return sparse.csr_array((rows.data, rows.indices, rows.indptr), (rows.shape[0], n_params))

    return Differences(
        wide(sparse.csr_array(coupling.matrix)),
        lambda physical: coupling.residual(physical[:own]),
        lambda physical: wide(coupling.sparse_rows(physical[:own])[1]),
    )


def _held(term: Smoothness, coupling: Coupling, strength: float, converged: bool) -> Held:
    rule = term.strength if isinstance(term.strength, str) else "given"
    return Held(term_name(term), rule, locked(np.full(len(coupling.target), strength)), None, converged)


def _total_mass(setup: Setup, found: FreeEstimate, direction: str | None) -> tuple[float, float]:
    """Total mass and its standard deviation by the draws, kg."""
    n = setup.parameters.n_params
    values = setup.parameters.values(found.values[:n])
    gradient = setup.structure.mass_gradient(direction, values) @ setup.parameters.design
    mass = setup.structure.mass_of(values, direction)
    if not gradient.any():
        return mass, 0.0
    if len(found.draws) < 2:
        return mass, float("nan")
    return mass, float(np.sqrt(np.mean((found.physical_draws[:, :n] @ gradient) ** 2)))


def _warnings(found: FreeEstimate, held: Sequence[Held]) -> tuple[str, ...]:
    """What was used, what the fit misses, and how many parameters are not known."""
    warnings = [item.words for item in held]
    if found.covariance_basis == "model_error":
        warnings.append(
            "the fit misses the noise: the model, its fixed values or the smoothness do not suit; standard deviations"
            " come from the residual"
        )
    unknown = [name for name, seen in zip(found.names, found.identified, strict=True) if not seen]
    if unknown:
        listed = ", ".join(unknown[:4]) + (f" and {len(unknown) - 4} more" if len(unknown) > 4 else "")
        warnings.append(
            f"{len(unknown)} of {len(found.names)} parameters are not identified: their standard deviations are larger"
            f" than their values or not known: {listed}"
        )
    return tuple(warnings)
