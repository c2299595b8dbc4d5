"""Refusal of parameters that the data cannot determine, by the Cramer-Rao bound at the start and the end of a search."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.core.arrays import FloatArray, locked
from structid.core.display import join_words
from structid.core.errors import SingularModelError
from structid.inversion.covariance import inverse_information
from structid.inversion.diagnostics.collinearity import percent_text
from structid.inversion.problem import Problem

#: An estimate that fits to the noise and is this well determined overrules a hopeless bound at the initial values: a
#: value that wandered off with the noise is seldom four of its standard deviations from 0.
_WELL_DETERMINED = 0.25


@dataclass(frozen=True, eq=False)
class Bound:
    """Smallest standard deviations that an unbiased estimate can have if the truth lies at one point.

    Attributes
    ----------
    std : (n_params,) float array
        From noise and priors, physical units; NaN where nothing determines the parameter.
    sizes : (n_params,) float array
        What each is held against, physical units.
    place : str
        The point, in words.
    """

    std: FloatArray
    sizes: FloatArray
    place: str

    @property
    def relative(self) -> FloatArray:
        """Standard deviations over sizes; infinite where nothing determines the parameter, or its size is 0."""
        safe = np.where(self.sizes > 0, self.sizes, np.nan)
        return np.nan_to_num(self.std / safe, nan=np.inf)

    def words(self, names: tuple[str, ...]) -> str:
        """Sentence with the Cramer-Rao bound over sizes: RMS of all parameters `names`, and the worst parameter.

        If some bounds are infinite, the sentence names these parameters only, three at most.
        """
        relative = self.relative
        worst = int(np.argmax(relative))
        if not np.isfinite(relative[worst]):
            lost = [name for name, value in zip(names, relative, strict=True) if not np.isfinite(value)]
            return f"at {self.place} the Cramér-Rao bound is infinite for {join_words(lost, 3)}"
        rms = percent_text(float(np.sqrt(np.mean(relative**2))))
        return (
            f"at {self.place} the Cramér-Rao bound is {rms} of the value (RMS of {len(names)} parameters),"
            f" {percent_text(float(relative[worst]))} for {names[worst]}"
        )


def bound_at(problem: Problem, theta: FloatArray, point_name: str) -> Bound:
    """Cramer-Rao bound of the parameters' standard deviations, physical units, if the truth were `theta` (n_params,).

    NaN for undetermined parameters, and for all if the model cannot be evaluated there. `point_name` is what sentences call the
    point, such as "the initial values".
    """
    values, slope = problem.physical(theta), problem.slope(theta)
    try:
        with np.errstate(all="ignore"):
            covariance = inverse_information(problem.linearize(theta).jacobian)
    except (SingularModelError, np.linalg.LinAlgError):
        covariance = np.full((len(values), len(values)), np.nan)
    return Bound(locked(np.sqrt(np.diag(covariance)) * np.abs(slope)), problem.unknowns.sizes(values), point_name)


def carried(initial: Bound, sizes: FloatArray, std: FloatArray, fits: bool) -> np.ndarray:
    """Mask of the parameters that the data can determine, judged by the bound at the initial values, (n_params,) bool.

    False where the bound there exceeds the size of the parameter there, unless the estimate fits (`fits`) and its standard
    deviation is at most a quarter of its size. True where the initial values have no bound at all.

    Parameters
    ----------
    initial : Bound
    sizes, std : (n_params,) float arrays
        At the estimate, physical units.
    fits : bool
        Whether the search converged and its residual is noise.
    """
    hopeless = initial.std > initial.sizes
    return ~(hopeless & ~(fits & (std <= _WELL_DETERMINED * sizes)))


def refusal_words(initial: Bound, final: Bound, carried_at_start: np.ndarray, names: tuple[str, ...]) -> str:
    """Sentences with the Cramer-Rao bounds that show that the data cannot determine a parameter; "" if none does.

    `initial` and `final` are the bounds at the start and at the estimate; `carried_at_start` (n_params,) is the mask by
    `carried`. `names` are those of the parameters.
    """
    said = [] if carried_at_start.all() else [initial.words(names)]
    if (final.relative > 1).any():
        said.append(final.words(names))
    elif said:
        said.append("where the start was far off and the fit is good, start again from the estimate")
    return "; ".join(said)
