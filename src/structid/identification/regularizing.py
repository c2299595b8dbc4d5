"""Smoothness and sparsity in an identification: their strengths chosen, and what each parameter owes to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from structid.arrays import FloatArray, locked
from structid.estimation import Estimate, LevenbergMarquardt, Linearization, Problem, stage_plans
from structid.estimation.regularization.strengths import (
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
from structid.estimation.search.least_squares import Method
from structid.estimation.search.work import ALONE, Work
from structid.identification.search import RecordProblem, decided, together
from structid.unknowns import Coupling, Regularization, Smoothness, Sparsity, penalty, term_name

#: Where the magnitude of a logarithm is rounded off: changes below 0.1 % count as none.
_SMOOTHING = 1e-3


@dataclass(frozen=True, eq=False)
class Held:
    """One regularization as it was used.

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
    """

    name: str
    rule: str
    strengths: FloatArray
    n_free: int | None
    converged: bool

    @property
    def words(self) -> str:
        """What it is and how strong, in one sentence."""
        how = "as given" if self.rule == "given" else f"chosen by {self.rule.replace('_', ' ')}"
        if self.n_free is not None:
            text = f"{self.name}, {how}: {self.n_free} of {len(self.strengths)} parameters leave their start"
        else:
            strength = float(self.strengths[0])
            text = (
                f"{self.name}, {how}: strength {strength:.3g}, neighbours within {100 * strength**-0.5:.3g} % (1 std)"
            )
        return text + ("" if self.converged else "; the choice did not settle")


def regularized(
    problems: Sequence[RecordProblem],
    terms: Sequence[Regularization],
    method: Method,
    staged: bool = True,
    work: Work = ALONE,
) -> tuple[tuple[RecordProblem, ...], tuple[Held, ...]]:
    """The problems with the rows of `terms` at the strengths that they give or the data choose.

    The rows stand with the parameters of the first problem, which the others share by name.

    Parameters
    ----------
    problems : sequence of FrfProblem or ModalProblem
        Of one or several records.
    terms : sequence of Smoothness or Sparsity
    method : Method
        Search of every fit.
    staged : bool
        Whether the first fit goes by easier forms of the residual.
    work : Work
        Runs the fits.

    Raises
    ------
    InputError
        If a term does not suit the parameters, or a rule for one term alone meets several.
    """
    if not terms:
        return tuple(problems), ()
    search = _Search(tuple(decided(p, p.theta_start) for p in problems), tuple(terms), method, work)
    theta = np.array(search.problem.theta_start)
    if staged:
        for _, stage in stage_plans(search.with_strengths(search.start))[0]:
            theta = work.minimize(stage, LevenbergMarquardt(gain_tolerance=1e-6), theta).theta
    found = settled(search.refit, search.model, search.choose, theta, search.start)
    held = tuple(
        _held(term, part.residual, strength, found.converged)
        for term, part, strength in zip(search.terms, found.model.penalties, found.strengths, strict=True)
    )
    return coupled(problems, search.couplings(found.strengths)), held


def coupled(problems: Sequence[RecordProblem], couplings: Sequence[Coupling]) -> tuple[RecordProblem, ...]:
    """The problems with `couplings`, which stand with the parameters of the first."""
    first = problems[0]
    return (replace(first, parameters=first.parameters.coupled(*couplings)), *problems[1:])


def _held(term: Regularization, rest: FloatArray, strength: FloatArray | float, converged: bool) -> Held:
    rule = term.strength if isinstance(term.strength, str) else "given"
    strengths = np.array(np.broadcast_to(strength, rest.shape))
    if isinstance(term, Sparsity):
        return Held(term_name(term), rule, locked(strengths), int((np.abs(rest) > _SMOOTHING).sum()), converged)
    return Held(term_name(term), rule, locked(strengths), None, converged or rule == "given")


@dataclass(frozen=True, eq=False)
class _Search:
    """What `settled` needs of problems with terms."""

    problems: tuple[RecordProblem, ...]
    terms: tuple[Regularization, ...]
    method: Method
    work: Work

    @cached_property
    def problem(self) -> Problem:
        """All of them, without the terms."""
        return together(self.problems)

    @cached_property
    def unit(self) -> tuple[Coupling, ...]:
        """The rows of every term at strength 1."""
        first = self.problems[0]
        return tuple(penalty(first.structure, first.parameters, term) for term in self.terms)

    @cached_property
    def start(self) -> Strengths:
        """Strengths of the first fit: those given, and where data and penalty weigh the same."""
        at = self.model(np.array(self.problem.theta_start))
        return tuple(
            at.balance(k) if isinstance(term, Sparsity) or isinstance(term.strength, str) else float(term.strength)
            for k, term in enumerate(self.terms)
        )

    def couplings(self, strengths: Strengths) -> tuple[Coupling, ...]:
        return tuple(c.scaled(s) for c, s in zip(self.unit, strengths, strict=True))

    def with_strengths(self, strengths: Strengths) -> Problem:
        return together(coupled(self.problems, self.couplings(strengths)))

    def refit(self, strengths: Strengths, theta: FloatArray) -> FloatArray:
        return self.work.minimize(self.with_strengths(strengths), self.method, theta).theta

    def model(self, theta: FloatArray) -> LocalModel:
        """Data and penalties at `theta`; the parameters of the first problem's structure come first."""
        n = self.problems[0].parameters.n_params
        physical, slope = self.problem.physical(theta)[:n], self.problem.slope(theta)[:n]
        penalties = []
        for coupling in self.unit:
            residual, jacobian = coupling.rows(physical)
            wide = np.zeros((len(residual), len(theta)))
            wide[:, :n] = jacobian * slope
            penalties.append(Linearization(residual, wide))
        return LocalModel(self.problem.linearize(theta), tuple(penalties))

    def choose(self, model: LocalModel, strengths: Strengths) -> Strengths:
        made = list(strengths)
        together = [
            k for k, t in enumerate(self.terms) if isinstance(t, Smoothness) and t.strength == "marginal_likelihood"
        ]
        if together:
            found = marginal_likelihood_strengths(
                _folded(model, together, strengths), tuple(float(np.asarray(strengths[k])) for k in together)
            )
            for k, strength in zip(together, found, strict=True):
                made[k] = strength
        for k, term in enumerate(self.terms):
            if isinstance(term, Sparsity):
                made[k] = self._sparse(model, k, tuple(made))
            elif term.strength == "l_curve":
                made[k] = l_curve_strength(_folded(model, [k], tuple(made)))
            elif term.strength == "discrepancy":
                local = _folded(model, [k], tuple(made))
                made[k] = discrepancy_strength(local, len(local.data.residual))
        return tuple(made)

    def _sparse(self, model: LocalModel, index: int, strengths: Strengths) -> FloatArray:
        given = self.terms[index].strength
        if isinstance(given, str):
            return sparse_strengths(model, index, strengths)
        return absolute_strengths(model, index, strengths, given, _SMOOTHING)


def _folded(model: LocalModel, kept: Sequence[int], strengths: Strengths) -> LocalModel:
    """The model with all penalties but `kept` at their strengths, as if they were data."""
    parts = [(model.data.residual, model.data.jacobian)]
    for k, part in enumerate(model.penalties):
        if k not in kept:
            root = np.sqrt(np.broadcast_to(strengths[k], part.residual.shape))
            parts.append((part.residual * root, part.jacobian * root[:, None]))
    data = Linearization(np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts]))
    return LocalModel(data, tuple(model.penalties[k] for k in kept))


def shares(problem: Problem, found: Estimate) -> FloatArray:
    """Part of each parameter's variance that stems from priors of any kind, in the order of `found`; see `prior_share`."""
    return prior_share(problem.linearize(found.theta).jacobian, problem.n_data)


def regularization_warnings(
    problems: Sequence[RecordProblem], found: Estimate, held: Sequence[Held], share: FloatArray
) -> tuple[str, ...]:
    """What was used, and which parameters owe more than half of their variance to priors."""
    warnings = [item.words for item in held]
    owing = [name for name, part in zip(found.names, share, strict=True) if part > 0.5]
    if owing:
        listed = ", ".join(owing[:4]) + (f" and {len(owing) - 4} more" if len(owing) > 4 else "")
        sources = [coupling.name for p in problems for coupling in p.parameters.couplings]
        sources += ["their priors"] if any(np.isfinite(p.prior_std).any() for p in problems) else []
        warnings.append(
            f"{len(owing)} of {len(found.names)} parameters are held by {' and '.join(dict.fromkeys(sources))} more than"
            f" by the data: {listed}"
        )
    return tuple(warnings)
