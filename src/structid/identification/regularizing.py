"""Smoothness and sparsity in an identification: their strengths chosen, and what each parameter owes to them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, locked
from structid.core.display import join_words
from structid.forward import RecordProblem
from structid.forward.record_problem import decide_polarities
from structid.forward.scatter import ScatterProblem, scatter_problems
from structid.identification.joint_problem import indices_of, joint_problem, joint_schedules
from structid.identification.options import IdentifyOptions
from structid.identification.varying import FoundScatter, found_scatter, free_scatters, with_scatters
from structid.inversion import Estimate, JointProblem, Linearization, Method, Problem
from structid.inversion.search.multistart import named
from structid.inversion.search.work import StageProgress, TaskExecutor
from structid.inversion.strengths import (
    LocalModel,
    Strengths,
    absolute_strengths,
    discrepancy_strength,
    l_curve_strength,
    marginal_likelihood_strengths,
    prior_share,
    settled,
    sparse_strengths,
)
from structid.unknowns import Coupling, Regularization, penalty, term_name

if TYPE_CHECKING:
    from structid.inversion.drawn_strengths import Differences

#: Where the magnitude of a logarithm is rounded off: changes below 0.1 % count as none.
_SMOOTHING = 1e-3


@dataclass(frozen=True, eq=False)
class AppliedRegularization:
    """A regularization with the strength that was used.

    Attributes
    ----------
    name : str
    rule : str
        ``given``, or how the strength was chosen.
    strengths : (n_rows,) float array
        Information of every row: 1 over the variance of the logarithm that it holds.
    n_free : int or None
        Of a sparsity: how many parameters it lets differ from their start; None for smoothness.
    converged : bool
        Whether the choice settled.
    determined : float
        How many combinations the data determine in spite of it, where that was counted; NaN elsewhere.
    """

    name: str
    rule: str
    strengths: FloatArray
    n_free: int | None
    converged: bool
    determined: float = float("nan")

    @property
    def words(self) -> str:
        """The regularization in a sentence: name, how its strength was found, and the strength.

        A sparsity has the number of parameters that leave their start instead. The sentence also says if the choice did
        not settle.
        """
        how = "as given" if self.rule == "given" else f"chosen by {self.rule.replace('_', ' ')}"
        if self.n_free is not None:
            text = f"{self.name}, {how}: {self.n_free} of {len(self.strengths)} parameters leave their start"
        else:
            strength = float(self.strengths[0])
            text = (
                f"{self.name}, {how}: strength {strength:.3g}, neighbours within {100 * strength**-0.5:.3g} % (1 std)"
            )
        return text + ("" if self.converged else "; the choice did not settle")


@dataclass(frozen=True, eq=False)
class Regularized:
    """Problems with regularizations at their strengths.

    Attributes
    ----------
    problems : tuple of RecordProblem
    regularizations : tuple of AppliedRegularization
    theta : FloatArray or None
        Free variables from which the search best goes on; None where it begins anew.
    scatters : mapping of str to FoundScatter
        What the data say of the scatters from record to record that they chose.
    """

    problems: tuple[RecordProblem, ...]
    regularizations: tuple[AppliedRegularization, ...] = ()
    theta: FloatArray | None = None
    scatters: Mapping[str, FoundScatter] = field(default_factory=dict)


def regularized(
    problems: Sequence[RecordProblem],
    options: IdentifyOptions,
    method: Method,
    progress: StageProgress | None,
    work: TaskExecutor,
) -> Regularized:
    """Problems with regularizations and scatters added, at strengths that are given or chosen by the data.

    Rows of regularizations are added to the first problem, whose parameters the others share by name. Without any, the
    problems stay as they are. A matrix-free search chooses strengths by posterior draws, any other by fits and
    linearized models in turn.

    Parameters
    ----------
    problems : sequence of RecordProblem
        Problems of one or several records.
    options : IdentifyOptions
        Options with the regularizations.
    method : Method
        Search of every fit.
    progress : callable, optional
        Called with the stage's name, the iteration and the sum of squares.
    work : TaskExecutor
        Runs the fits.

    Raises
    ------
    InputError
        If a term does not suit the parameters, or a rule for one term alone meets several.
    """
    if not options.regularization and not free_scatters(problems):
        return Regularized(tuple(problems))
    chosen = _regularize_by_draws if method.is_matrix_free else _regularize_by_local_models
    return chosen(problems, options, method, progress, work)


def takes_matrix_free(terms: Sequence[Regularization]) -> str:
    """Reason why the regularizations `terms` rule out a matrix-free search; "" if they allow it.

    It goes on a sentence that begins with the search, as in "search 'matrix_free' takes a given strength". Allowed are terms of
    smoothness whose strength is given or found by 'marginal_likelihood'.
    """
    for term in terms:
        if term.is_sparse:
            return f"takes smoothness as the only regularization, got {term_name(term)}"
        if term.rule not in ("given", "marginal_likelihood"):
            return f"takes a given strength or 'marginal_likelihood', got {term.strength!r} for {term_name(term)}"
    return ""


def coupled(problems: Sequence[RecordProblem], couplings: Sequence[Coupling]) -> tuple[RecordProblem, ...]:
    """Copies of the problems in which the parameters of the first have the additional `couplings`."""
    first = problems[0]
    return (first.with_parameters(first.parameters.coupled(*couplings)), *problems[1:])


def unit_penalties(problems: Sequence[RecordProblem], terms: Sequence[Regularization]) -> tuple[Coupling, ...]:
    """The rows of every term at strength 1, in the order of `terms`, by the parameters of the first problem."""
    first = problems[0]
    return tuple(penalty(first.structure, first.parameters, term) for term in terms)


def _regularize_by_draws(
    problems: Sequence[RecordProblem],
    options: IdentifyOptions,
    method: Method,
    progress: StageProgress | None,
    work: TaskExecutor,
) -> Regularized:
    """Regularized problems for a matrix-free search, with strengths that are stated or settled by posterior draws.

    Strengths begin where each regularization balances the data. If all are stated nothing is fitted. The result also
    has the free variables at which strengths settled, except when nothing was fitted.
    """
    from structid.inversion.drawn_strengths import balanced_strengths, settled_strengths

    terms, unit = options.regularization, unit_penalties(problems, options.regularization)

    def regularized_problems(strengths: Sequence[float]) -> tuple[RecordProblem, ...]:
        return coupled(problems, [c.scaled(s) for c, s in zip(unit, strengths, strict=True)])

    def made(strengths: Sequence[float]) -> Problem:
        return joint_problem(regularized_problems(strengths))

    stated = tuple(term.given for term in terms)
    unregularized = made([1.0] * len(terms))
    differences = [_differences(coupling, len(unregularized.names)) for coupling in unit]
    theta = np.asarray(unregularized.theta_start)
    strengths = balanced_strengths(unregularized, theta, differences, stated)
    if None not in stated:
        regularizations = [
            _applied_regularization(term, part.target, s, True)
            for term, part, s in zip(terms, unit, strengths, strict=True)
        ]
        return Regularized(regularized_problems(strengths), tuple(regularizations))
    if options.pole_free_start:
        theta = _run_first_stages(regularized_problems(strengths), method, theta, progress, work)
    named_progress = named(progress, "strength of smoothness")
    drawn = settled_strengths(made, differences, stated, strengths, theta, options.seed, named_progress, work.minimize)
    regularizations = [
        _applied_regularization(term, part.target, s, drawn.converged, count)
        for term, part, s, count in zip(terms, unit, drawn.strengths, drawn.determined, strict=True)
    ]
    return Regularized(regularized_problems(drawn.strengths), tuple(regularizations), drawn.theta)


def _regularize_by_local_models(
    problems: Sequence[RecordProblem],
    options: IdentifyOptions,
    method: Method,
    progress: StageProgress | None,
    work: TaskExecutor,
) -> Regularized:
    """Regularized problems with strengths and scatters chosen by fits and linearized models in turn, until they settle.

    The result also has the interval and the added covariance of each scatter, by name.
    """
    begun = tuple(decide_polarities(problem, problem.theta_start) for problem in problems)
    search = _Search(begun, tuple(options.regularization), method, work)
    theta = np.array(search.problem.theta_start)
    if options.pole_free_start:
        theta = _run_first_stages(search.regularized_problems(begun, search.start), method, theta, progress, work)
    answer = settled(search.refit, search.model, search.choose, theta, search.start)
    n_terms = len(search.terms)
    regularizations = tuple(
        _applied_regularization(term, part.residual, strength, answer.converged)
        for term, part, strength in zip(
            search.terms, answer.model.penalties[:n_terms], answer.strengths[:n_terms], strict=True
        )
    )
    scatters = {
        scatter.name: found_scatter(
            _with_penalties_as_data(answer.model, [k], answer.strengths), float(answer.strengths[k])
        )
        for k, scatter in enumerate(search.scatters, n_terms)
    }
    return Regularized(search.regularized_problems(problems, answer.strengths), regularizations, scatters=scatters)


def _run_first_stages(
    problems: Sequence[RecordProblem],
    method: Method,
    theta: FloatArray,
    progress: StageProgress | None,
    work: TaskExecutor,
) -> FloatArray:
    """Free variables (n_params,) after the stages of the first schedule of the joint problem, started at `theta`."""
    for name, stage in next(iter(joint_schedules(problems)), ()):
        theta = work.minimize(stage, method.for_stages(), theta, named(progress, name)).theta
    return theta


def _differences(coupling: Coupling, n_params: int) -> Differences:
    """The rows of `coupling` among all parameters, of which its own are the first."""
    from structid.inversion.drawn_strengths import Differences

    wide = coupling.among(n_params, 0)
    return Differences(sparse.csr_array(wide.matrix), wide.residual, lambda physical: wide.sparse_rows(physical)[1])


def _applied_regularization(
    term: Regularization,
    rest: FloatArray,
    strength: FloatArray | float,
    converged: bool,
    determined: float = float("nan"),
) -> AppliedRegularization:
    """Record of a regularization as it was used: name, rule and strengths of its rows.

    `rest` (n_rows,) is the residual of its rows at strength 1; for a sparsity, rows above 1e-3 are counted as free
    parameters. `strength` is one number or (n_rows,). `converged` says whether it settled (a given smoothness always
    does), `determined` how many combinations the data determine, NaN if that is not known.
    """
    strengths = locked(np.array(np.broadcast_to(strength, rest.shape)))
    n_free = int((np.abs(rest) > _SMOOTHING).sum()) if term.is_sparse else None
    settled = converged or (term.rule == "given" and not term.is_sparse)
    return AppliedRegularization(term_name(term), term.rule, strengths, n_free, settled, determined)


@dataclass(frozen=True, eq=False)
class _Search:
    """Fits and local models of problems with regularization terms, as `settled` needs them."""

    problems: tuple[RecordProblem, ...]
    terms: tuple[Regularization, ...]
    method: Method
    work: TaskExecutor

    @cached_property
    def scatters(self) -> tuple[ScatterProblem, ...]:
        """Scatters from record to record whose size the data choose."""
        return free_scatters(self.problems)

    @cached_property
    def problem(self) -> Problem:
        """The joint problem of all records, without the terms and scatters whose strengths are to be chosen."""
        chosen = {scatter.name for scatter in self.scatters}
        known = [scatter for scatter in scatter_problems(self.problems) if scatter.name not in chosen]
        return JointProblem((*self.problems, *known)) if len(self.problems) > 1 else self.problems[0]

    @cached_property
    def unit(self) -> tuple[Coupling, ...]:
        """The rows of every term at strength 1, of the parameters of the first problem."""
        return unit_penalties(self.problems, self.terms)

    @cached_property
    def _wide(self) -> tuple[Coupling, ...]:
        """The rows of every term and scatter at strength 1, of all parameters; those of the first problem come first."""
        names = self.problem.names
        return (
            *(coupling.among(len(names), 0) for coupling in self.unit),
            *(scatter.coupling.at(indices_of(names, scatter.names), len(names)) for scatter in self.scatters),
        )

    @cached_property
    def start(self) -> Strengths:
        """Strengths for the first fit, terms first and then scatters.

        Given strengths of smoothness, else those at which data and penalty weigh the same; for a scatter 1 / std^2.
        """
        model = self.model(np.array(self.problem.theta_start))
        terms = [model.balance(k) if t.is_sparse or t.given is None else t.given for k, t in enumerate(self.terms)]
        return (*terms, *(scatter.std**-2 for scatter in self.scatters))

    def regularized_problems(
        self, problems: Sequence[RecordProblem], strengths: Strengths
    ) -> tuple[RecordProblem, ...]:
        """Copies of `problems` with the regularization terms and scatters of this search at `strengths`, terms first.

        A scatter has the strength 1 / scatter^2.
        """
        n_terms = len(self.terms)
        pairs = zip(self.scatters, strengths[n_terms:], strict=True)
        made = with_scatters(problems, {scatter.name: float(s) ** -0.5 for scatter, s in pairs})
        return coupled(made, [c.scaled(s) for c, s in zip(self.unit, strengths[:n_terms], strict=True)])

    def with_strengths(self, strengths: Strengths) -> Problem:
        return joint_problem(self.regularized_problems(self.problems, strengths))

    def refit(self, strengths: Strengths, theta: FloatArray) -> FloatArray:
        return self.work.minimize(self.with_strengths(strengths), self.method, theta).theta

    def model(self, theta: FloatArray) -> LocalModel:
        """Linear model of residual and penalties at the free variables `theta` (n_params,).

        It holds the data, and the penalties of terms and then scatters at strength 1.
        """
        physical, slope = self.problem.physical(theta), self.problem.slope(theta)
        rows = [coupling.rows(physical) for coupling in self._wide]
        penalties = tuple(Linearization(residual, jacobian * slope) for residual, jacobian in rows)
        return LocalModel(self.problem.linearize(theta), penalties)

    def choose(self, model: LocalModel, strengths: Strengths) -> Strengths:
        """New strengths of all terms and then scatters, each by its rule, from a linear model and the present ones.

        Those by marginal likelihood, scatters among them, are chosen together; then each other one with the rest as
        data. A given strength of smoothness stays.
        """
        made = list(strengths)
        together = [k for k, t in enumerate(self.terms) if not t.is_sparse and t.rule == "marginal_likelihood"]
        together += range(len(self.terms), len(strengths))
        if together:
            together_strengths = marginal_likelihood_strengths(
                _with_penalties_as_data(model, together, strengths),
                tuple(float(np.asarray(strengths[k])) for k in together),
            )
            for k, strength in zip(together, together_strengths, strict=True):
                made[k] = strength
        for k, term in enumerate(self.terms):
            if term.is_sparse:
                made[k] = self._sparse(model, k, tuple(made))
            elif term.rule == "l_curve":
                made[k] = l_curve_strength(_with_penalties_as_data(model, [k], tuple(made)))
            elif term.rule == "discrepancy":
                local = _with_penalties_as_data(model, [k], tuple(made))
                made[k] = discrepancy_strength(local, len(local.data.residual))
        return tuple(made)

    def _sparse(self, model: LocalModel, index: int, strengths: Strengths) -> FloatArray:
        """Strengths (n_rows,) of the sparsity at position `index` of the terms.

        They are chosen by the data, or follow from the strength that the study states. `strengths` has those of all
        penalties of `model`, for one iteration.
        """
        stated = self.terms[index].given
        if stated is None:
            return sparse_strengths(model, index, strengths)
        return absolute_strengths(model, index, strengths, stated, _SMOOTHING)


def _with_penalties_as_data(model: LocalModel, kept: Sequence[int], strengths: Strengths) -> LocalModel:
    """Local model with all penalties but those at positions `kept` turned into rows of data, times the root of their strength.

    Those at `kept` stay penalties; `strengths` has one entry for each penalty of `model`, in order.
    """
    parts = [(model.data.residual, model.data.jacobian)]
    for k, part in enumerate(model.penalties):
        if k not in kept:
            root = np.sqrt(np.broadcast_to(strengths[k], part.residual.shape))
            parts.append((part.residual * root, part.jacobian * root[:, None]))
    data = Linearization(np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts]))
    return LocalModel(data, tuple(model.penalties[k] for k in kept))


def shares(problem: Problem | None, estimate: Estimate) -> FloatArray | None:
    """Part of each parameter's variance, (n_params,), that stems from priors and regularizations, 0 to 1.

    None without a covariance matrix; zeros where `problem` is None, as no problem was minimized.
    """
    if problem is None:
        return np.zeros(len(estimate.names))
    if not estimate.uncertainty.has_matrix:
        return None
    return prior_share(problem.linearize(estimate.theta).jacobian, problem.n_data)


def regularization_warnings(
    problems: Sequence[RecordProblem],
    estimate: Estimate,
    regularizations: Sequence[AppliedRegularization],
    share: FloatArray | None,
) -> tuple[str, ...]:
    """Sentences on the regularizations, and a warning on parameters that owe more than half of their variance to priors.

    `share` (n_params,) is that part; None leaves the warning out.
    """
    warnings = [item.words for item in regularizations]
    owing = [] if share is None else [name for name, part in zip(estimate.names, share, strict=True) if part > 0.5]
    if owing:
        sources = [coupling.name for p in problems for coupling in p.parameters.couplings]
        sources += ["their priors"] if any(p.unknowns.priors.stated.any() for p in problems) else []
        warnings.append(
            f"{len(owing)} of {len(estimate.names)} parameters are held by {' and '.join(dict.fromkeys(sources))} more than"
            f" by the data: {join_words(owing, 4)}"
        )
    return tuple(warnings)
