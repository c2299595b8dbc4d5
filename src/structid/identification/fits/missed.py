"""Records, and kinds of values of modes, that an answer misses while the many values of others hide it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray
from structid.core.display import plural
from structid.forward import RecordProblem
from structid.forward.modal import compares_modes
from structid.inversion import Estimate
from structid.inversion.fixed_values import FIXED
from structid.inversion.problem import expected_square

#: Probability, of all parts together, below which noise is not why a part is missed.
_RISK = 1e-3
#: Chi-square per value, in parts of what is expected, from where on values are missed: of modes, whose errors are less
#: surely known than those of lines, and of other records.
_OF_MODES, _OF_LINES = 4.0, 1.25
#: Chi-square per degree of freedom of all data, below which they hide what one part misses.
_HIDES = 2.0


@dataclass(frozen=True)
class MissedValues:
    """Values of a record that the answer misses.

    Attributes
    ----------
    what : str
        Such as ``the frequencies of "ambient"``.
    n_values, n_others : int
        Of them, and of all other data.
    chi_square_per_value : float
    """

    what: str
    n_values: int
    n_others: int
    chi_square_per_value: float

    @property
    def is_far(self) -> bool:
        """True if the values are missed by so much that no interval of the fit can be valid."""
        return self.chi_square_per_value > _OF_MODES

    @property
    def words(self) -> str:
        """Sentence on the values that are missed, by how much, and why the whole misfit does not show it."""
        size = float(np.sqrt(self.chi_square_per_value))
        return (
            f"{self.what} are missed by {size:.2g} times their stated errors (root mean square of"
            f" {plural(self.n_values, 'value')}), which the fit to {plural(self.n_others, 'other value')} hides"
        )


def missed_parts(
    names: Sequence[str], problems: Sequence[RecordProblem], estimate: Estimate, freed: Sequence[RecordProblem] = ()
) -> tuple[MissedValues, ...]:
    """Records, or kinds of values of modes, that the fit misses beyond their errors, the worst first.

    A part is missed if its sum of squares per value exceeds a limit (4 for modes, 1.25 for lines, more with few
    averages) and is improbable at 0.1 % for all parts together, by chi-square with as many degrees of freedom as
    values. Empty with fewer than two parts to test, or if the misfit of the whole is 2 or more.

    Parameters
    ----------
    names : sequence of str
        Names of the records; "" for a single one.
    problems : sequence of RecordProblem
        Problem of each record.
    estimate : Estimate
        Estimate of all parameters.
    freed : sequence of RecordProblem
        Problems with the fixed values of their models among the unknowns; where given, the fit within tolerances is
        tested.
    """
    is_whole = len(problems) == 1 and not compares_modes(problems[0])
    if is_whole or not estimate.goodness.misfit < _HIDES:
        return ()
    parts = []
    free = dict(zip(estimate.names, estimate.theta.tolist(), strict=True))
    if freed and (fixed := estimate.fixed) is not None:
        problems, asked = freed, fixed.asked * fixed.tolerance
        free = dict(zip(estimate.names, fixed.theta.tolist(), strict=True))
        free |= zip((FIXED + name for name in fixed.names), asked.tolist(), strict=True)
    for name, problem in zip(names, problems, strict=True):
        # a fixed value whose influence could not be solved for is exact
        theta = np.array([free.get(key, 0.0) if key.startswith(FIXED) else free[key] for key in problem.names])
        residual = problem.residual(theta)[: problem.n_data]
        parts += [(what, rows, least) for what, rows, least in _tested_parts(name, problem, residual) if len(rows)]
    if len(parts) < 2:
        return ()
    missed = []
    for what, rows, least in parts:
        square, n = float(rows @ rows), len(rows)
        if square > least * n and float(special.gammaincc(n / 2, square / 2)) * len(parts) < _RISK:
            missed.append(MissedValues(what, n, estimate.goodness.n_data - n, square / n))
    return tuple(sorted(missed, key=lambda one: -one.chi_square_per_value))


def _tested_parts(name: str, problem: RecordProblem, residual: FloatArray) -> Iterator[tuple[str, FloatArray, float]]:
    """Parts of a record to be tested: name, residual rows, and the chi-square per value above which the part is missed.

    A record of modes has a part for each kind of value, without residuals of exactly 0; any other record is one part.
    `name` is the record, "" for a single one. `residual` (n_residuals,) is whitened; rows of a part are (n,).
    """
    if compares_modes(problem):
        kinds = problem.row_kinds
        for kind in dict.fromkeys(kinds.tolist()):
            rows = residual[(kinds == kind) & (residual != 0)]
            yield f"the {kind} of {f'record {name}' if name else 'the modes'}", rows, _OF_MODES
        return
    few = 1.0 if problem.rows.averages is None else float(expected_square(problem.rows.averages).mean())
    yield f"the values of record {name}", residual, _OF_LINES * few
