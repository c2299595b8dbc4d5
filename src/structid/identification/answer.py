"""The search that the set-ups of a study ask for: over FRFs and modes, finite spectra, or time histories."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from structid.errors import InputError
from structid.estimation import Estimate, Problem, stage_plans, thinned
from structid.estimation.estimate import estimate
from structid.estimation.search.work import StageProgress, Work
from structid.identification.identified import AnySetup
from structid.identification.regularizing import Held, regularized
from structid.identification.search import RecordProblem, searched, together
from structid.identification.time_fit import target, time_estimate
from structid.observation.frf.frequency_continuation import few_line_plans

if TYPE_CHECKING:
    from structid.identification.identify import IdentifyOptions


@dataclass(frozen=True, eq=False)
class Answer:
    """What a search gave.

    Attributes
    ----------
    estimate : Estimate
    problems : tuple of FrfProblem or ModalProblem
        Of each record, with the polarities that were found.
    target : Problem or None
        The problem that was solved, if one of many rows.
    held : tuple of Held
        The regularizations as they were used.
    """

    estimate: Estimate
    problems: tuple[RecordProblem, ...]
    target: Problem | None
    held: tuple[Held, ...]


def answered(
    setups: Sequence[AnySetup],
    problems: tuple[RecordProblem, ...],
    options: IdentifyOptions,
    progress: StageProgress | None,
    work: Work,
) -> Answer:
    """The answer of the search that the set-ups ask for.

    Raises
    ------
    InputError
        If their ways of fitting do not go together.
    """

    def search(problem: Problem) -> Estimate:
        plans = few_line_plans(problem, stage_plans(problem)) if options.pole_free_start else ()
        return estimate(
            problem,
            options.method,
            plans,
            restarts=options.restarts,
            seed=options.seed,
            progress=progress,
            sample=thinned(problem),
            uniqueness_starts=options.uniqueness_starts,
            work=work,
        )

    fits = [setup.time for setup in setups]
    first = fits[0]
    if first is not None and first.fit != "spectra":
        if (
            len(setups) > 1
            or options.regularization
            or options.intervals != "laplace"
            or options.band
            or options.exclude
        ):
            raise InputError(
                f"fit {first.fit!r} takes one record, all of it, without regularization and with Laplace intervals;"
                " use fit 'spectra' for more"
            )
        found = time_estimate(problems[0], first, options.restarts, options.seed, work, progress)
        return Answer(found, problems, None, ())
    if any(fit is not None for fit in fits):
        if options.regularization or any(fit is not None and fit.fit != "spectra" for fit in fits):
            raise InputError("several records, and regularization, go with fit 'spectra' and with FRFs only")
        aim = target(problems, fits, options.exclude)
        return Answer(search(aim), problems, aim, ())
    terms, method, staged = options.regularization, options.method, options.pole_free_start
    problems, held = regularized(problems, terms, method, staged, work)
    found, problems = searched(problems, search)
    return Answer(found, problems, together(problems), held)
