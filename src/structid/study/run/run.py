"""A study from start to end: read, check, identify."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from structid.core.errors import InputError, NoAnswerError, SingularModelError, require_class
from structid.diagnose.checks.mesh import checked_mesh, mesh_warnings
from structid.diagnose.thresholds import NOISE_TOLERANCE
from structid.forward.modal import compares_modes
from structid.identification.identify import identify_together
from structid.identification.joint_problem import indices_of
from structid.identification.mesh_pieces import (
    BETTER,
    MESH_ERROR,
    MOVED,
    MeshPieces,
    division_words,
    judge_pieces,
    kept_words,
    undivided_words,
)
from structid.identification.options import IdentifyOptions
from structid.identification.search import chosen_method
from structid.inversion import Status
from structid.inversion.estimate import Goodness
from structid.inversion.search.work import SERIAL, StageProgress, TaskExecutor
from structid.study.results.result import StudyResult, provenance
from structid.study.run.resources import require_room
from structid.study.run.start import (
    PreparedStudy,
    compare_with_models,
    pieces_for_band,
    prepare_study,
    with_pieces,
)
from structid.study.run.workers import threads_for
from structid.study.schema.study import Study


class SearchFailedError(NoAnswerError):
    """The search came to where the model cannot be evaluated; there is no estimate."""


#: Degrees of freedom up to which the mesh is judged where the study states the number of pieces.
_MOST_JUDGED = 300


def run_study(study: Study, progress: StageProgress | None = None, work: TaskExecutor = SERIAL) -> StudyResult:
    """The result of a study: parameters with their uncertainty, and how the model fits its records.

    Parameters
    ----------
    study : Study
        The study to run.
    progress : callable, optional
        Called with the stage's name, the iteration and the sum of squares.
    work : TaskExecutor
        The way in which searches and their repeats run, and if they are kept; see `structid.study.run.long_run`.

    Returns
    -------
    StudyResult
        Also returned if the search did not converge or the data do not determine the answer: see
        ``identification.estimate.status``.

    Raises
    ------
    InputError, SingularModelError
        If the study cannot be run as it is, see `prepare_study`, or does not fit in memory.
    SearchFailedError
        If the search reached values without a model response.
    """
    require_class("study", study, Study, "make it by `load_study(path)`")
    ready = relinearized_study(study, progress, work)
    return confirm_result(ready, run_prepared(ready, progress, work), progress, work)[1]


def relinearized_study(
    study: Study, progress: StageProgress | None = None, work: TaskExecutor = SERIAL
) -> PreparedStudy:
    """The study with records and models prepared for the search.

    If a solver gives the model, the study is identified and the solver run again there until the linear model holds at
    the answer.
    """
    ready = prepare_study(study)
    if study.solved is None:
        return ready
    from structid.study.run.solver import relinearize_solver  # for solvers alone

    return relinearize_solver(ready, progress, work)


def confirm_result(
    ready: PreparedStudy, result: StudyResult, progress: StageProgress | None = None, work: TaskExecutor = SERIAL
) -> tuple[PreparedStudy, StudyResult]:
    """The prepared study and its result after two checks: finer meshes, and a run of the solver at the answer.

    The search is repeated where finer meshes change the values, and the study is then that of the finer mesh. The
    solver runs only if the study has one.
    """
    ready, result = refine_mesh(ready, result, progress, work)
    if ready.study.solved is not None:
        from structid.study.run.solver import with_nominal_start, with_solver  # for solvers alone

        result = with_solver(with_nominal_start(result), work)
    return ready, result


def refine_mesh(
    ready: PreparedStudy, result: StudyResult, progress: StageProgress | None = None, work: TaskExecutor = SERIAL
) -> tuple[PreparedStudy, StudyResult]:
    """The study and its result with beams divided into more pieces, until finer pieces hardly change values and misfit.

    Study and values stay where a solver gives the model, where the mesh changes no value, and where the record fits the
    elements as drawn in the study but not divided ones; the words on the mesh may change. Where the study states the
    number of pieces, a warning is added if the mesh changes a value. A warning also says what keeps the mesh from being
    judged or made finer.
    """
    if ready.study.solved is not None:
        return ready, result
    if not ready.study.leaves_pieces_open:
        return ready, _with_mesh_warning(ready, result)
    drawn_study, drawn_result = ready, result
    drawn, options = result.identification, ready.study.options
    fixed_mesh = undivided_words(ready.setups)
    if not any(setup.structure.divisible for setup in ready.setups):
        return ready, _with_mesh_words(result, (fixed_mesh,), "", False)
    count = 1
    mesh = judge_pieces(ready.setups, drawn, options, count)
    if not mesh.is_enough and not mesh.obstacle and mesh.needed > 2:
        halved = _identified_in_halves(ready, drawn.estimate.goodness, mesh, progress, work)
        if halved is not None:
            words = kept_words(drawn, halved.identification, 2, mesh.needed)
            return ready, _with_mesh_words(result, (words, fixed_mesh), "", True)
    if not mesh.is_enough and not mesh.obstacle and not _is_right(drawn.estimate.goodness):
        anew = _begun_anew(ready, mesh.needed, progress, work)
        if anew is not None:
            ready, result = anew
            count = ready.setups[0].structure.subdivide
            mesh = judge_pieces(ready.setups, result.identification, options, count)
    while not mesh.is_enough and not mesh.obstacle:
        try:
            finer, divided = _identified_in_pieces(ready, mesh.needed, progress, work, mesh.finer_minimum)
        except (InputError, NoAnswerError, SingularModelError) as error:
            mesh = replace(mesh, obstacle=f"{mesh.needed} pieces cannot be identified ({error})")
            break
        if divided.identification.estimate.status is Status.NOT_CONVERGED:
            mesh = replace(mesh, obstacle=f"with {mesh.needed} pieces the search does not converge")
            break
        if _fits_only_as_drawn(drawn.estimate.goodness, divided.identification.estimate.goodness):
            words = kept_words(drawn, divided.identification, mesh.needed, mesh.needed)
            return drawn_study, _with_mesh_words(drawn_result, (words, fixed_mesh), "", True)
        ready, result, count = finer, divided, mesh.needed
        mesh = judge_pieces(ready.setups, result.identification, options, count)
    division = "" if count == 1 else division_words(drawn, result.identification, count)
    return ready, _with_mesh_words(result, (division, fixed_mesh), mesh.warning, mesh.is_enough and not fixed_mesh)


def _identified_in_pieces(
    ready: PreparedStudy,
    count: int,
    progress: StageProgress | None,
    work: TaskExecutor,
    near: Mapping[str, float] | None = None,
    options: IdentifyOptions | None = None,
) -> tuple[PreparedStudy, StudyResult]:
    """The study `ready` with its beams cut into `count` pieces each, and its result.

    Records are not read again. `near` are free variables to start from, None for the study's starts; `options` replace
    those of the study. Raises what `compare_with_models` and `run_prepared` raise.
    """
    study, setups = with_pieces(ready.study, ready.setups, count)
    finer = compare_with_models(study if options is None else replace(study, options=options), setups)
    return finer, run_prepared(finer, progress, work, near)


def _begun_anew(
    drawn: PreparedStudy, needed: int, progress: StageProgress | None, work: TaskExecutor
) -> tuple[PreparedStudy, StudyResult] | None:
    """The study and its result with the pieces that the modes in the band need, searched from the study's starts.

    With elements as drawn in the study, `drawn`, the model may lack modes, and the search then may have ended far from
    the minimum that more pieces have. None if no mode of the first record's band is missing or that cannot be judged, if
    the band needs no more than `needed` pieces, or if the search fails or does not converge.
    """
    try:
        mesh = checked_mesh(drawn.setups[0], drawn.problems[0])
        if isinstance(mesh, str) or not mesh.passed_over.size:
            return None
        count, _ = pieces_for_band(drawn, mesh)
        if count <= needed:
            return None
        finer, result = _identified_in_pieces(drawn, count, progress, work)
    except (InputError, NoAnswerError, SingularModelError, np.linalg.LinAlgError):
        return None
    return None if result.identification.estimate.status is Status.NOT_CONVERGED else (finer, result)


def _identified_in_halves(
    ready: PreparedStudy, drawn: Goodness, mesh: MeshPieces, progress: StageProgress | None, work: TaskExecutor
) -> StudyResult | None:
    """The result with elements of two pieces, if the record fits the elements as drawn but does not fit their halves.

    None if it fits halves too, if `drawn`, the fit with elements as drawn, is not that of a right model, or if the
    search fails. The search starts at the minimum of `mesh`. Halves have a sixteenth of the error, so that more pieces,
    which take many times as long, fit no better. The fit alone counts, so there are no further starts, and intervals
    are those of Laplace.
    """
    if not _is_right(drawn):
        return None
    try:
        options = replace(ready.study.options, intervals="laplace", uniqueness_starts=0)
        _, halved = _identified_in_pieces(ready, 2, progress, work, mesh.finer_minimum, options)
    except (InputError, NoAnswerError, SingularModelError):
        return None
    estimate = halved.identification.estimate
    is_ended = estimate.status is not Status.NOT_CONVERGED
    return halved if is_ended and _fits_only_as_drawn(drawn, estimate.goodness) else None


def _is_right(drawn: Goodness) -> bool:
    """True if a fit leaves no more than noise and tolerances of fixed values, as that of a right model."""
    return drawn.misfit <= NOISE_TOLERANCE


def _fits_only_as_drawn(drawn: Goodness, divided: Goodness) -> bool:
    """True if the fit with elements as drawn is that of a right model, and the one with divided elements is far worse.

    No measured record is like that: it was simulated with the drawn elements.
    """
    is_worse = divided.misfit > NOISE_TOLERANCE * max(drawn.misfit, 1.0)
    return (
        _is_right(drawn)
        and is_worse
        and divided.chi_square_within_tolerances > drawn.chi_square_within_tolerances + BETTER
    )


def _with_mesh_words(result: StudyResult, clauses: Sequence[str], warning: str, is_fine: bool) -> StudyResult:
    """The result with new words on its mesh: the `clauses` that are not empty, joined by semicolons.

    A `warning` that is not "" becomes the first one. If the mesh `is_fine`, as it changes no value or the record was
    made with it, warnings on modes that the mesh shifts are removed.
    """
    identification, words = result.identification, "; ".join(clause for clause in clauses if clause)
    kept = [one for one in identification.warnings if not (is_fine and one.startswith(MESH_ERROR))]
    warnings = (*([warning] if warning else []), *kept)
    return replace(result, identification=replace(identification, mesh=words, warnings=warnings))


def _with_mesh_warning(ready: PreparedStudy, result: StudyResult) -> StudyResult:
    """The result, with a warning first if pieces half as long would change a value by 0.2 deviations, or make the misfit less.

    Beams are cut as the study says. The result is unchanged, without a check, where modes alone are compared, no
    element can be cut, or the structure has more than 300 degrees of freedom.
    """
    identification, structure = result.identification, ready.study.structure
    of_modes = all(compares_modes(problem) for problem in identification.problems)  # `mesh_warnings` looks at these
    if of_modes or not structure.divisible or structure.n_dofs > _MOST_JUDGED:
        return result
    mesh = judge_pieces(ready.setups, identification, ready.study.options, structure.subdivide)
    return _with_mesh_words(result, (), mesh.warning if mesh.moved >= MOVED or mesh.makes_misfit else "", False)


def run_prepared(
    ready: PreparedStudy,
    progress: StageProgress | None = None,
    work: TaskExecutor = SERIAL,
    near: Mapping[str, float] | None = None,
) -> StudyResult:
    """Identify a study whose records are already read.

    Warnings on faults, the mesh and channels come first in the result. `progress` is called with the name of the stage,
    its iteration and the sum of squares; None for no reports. `near` are free variables of a nearby answer by name,
    from which the search begins; None for the study's starts. `work` runs the search and its tasks.

    Raises
    ------
    SearchFailedError
        If the model becomes singular, or a factorization fails.
    InputError
        If the search does not fit in memory.
    """
    study = ready.study
    if not is_matrix_free(ready):
        require_room(study, ready.problems)
    try:
        with threads_for(ready.problems):
            answer = identify_together(ready.setups, study.options, progress, work, near)
    except (SingularModelError, np.linalg.LinAlgError) as error:
        raise SearchFailedError(
            f"{study.path}: the search failed: {error}; start closer to the truth, give bounds or priors, or narrow"
            " the band"
        ) from error
    theta_of_records = [
        answer.estimate.theta[indices_of(answer.estimate.names, problem.names)] for problem in answer.problems
    ]
    mesh_words = mesh_warnings(ready.setups, answer.problems, theta_of_records)
    warnings = (*ready.fault_warnings, *mesh_words, *ready.channel_warnings, *answer.warnings)
    answer = replace(answer, mesh="", warnings=warnings)  # the mesh is judged by `refine_mesh`
    return StudyResult(study, answer, provenance(study))


def is_matrix_free(ready: PreparedStudy) -> bool:
    """True if the search for the parameters runs without a Jacobian matrix; see `chosen_method`.

    Raises
    ------
    InputError
        If the study asks for that and it is not possible; with the place in the study file.
    """
    method = ready.study.section("method")
    with method.located("search" if "search" in method.table else None):
        return chosen_method(ready.problems, ready.study.options).is_matrix_free
