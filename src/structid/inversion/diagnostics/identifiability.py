"""Which directions of the parameters the data determine, and in words which they do not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.core.arrays import FloatArray
from structid.inversion.diagnostics.collinearity import CollinearGroup, collinear_groups
from structid.inversion.linearization import triangle_of

#: Most parameters that the words on a direction name.
_MOST_NAMED = 12


@dataclass(frozen=True, eq=False)
class Direction:
    """A combination of parameters that the data determine worse than to a factor of e.

    Attributes
    ----------
    vector : (n_params,) float array
        Relative change of each parameter, unit length.
    relative_std : float
        Standard deviation along it; infinite where the data do not see it at all.
    words : str
        The same as a sentence.
    """

    vector: FloatArray
    relative_std: float
    words: str


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Rank and condition of the problem in relative parameters, and what is not determined.

    Attributes
    ----------
    rank : int
        Number of directions of free parameters that the data alone determine to better than a factor of e.
    condition : float
        Largest over smallest singular value of the whitened Jacobian in relative parameters.
    singular_values : (n_free,) float array
        Of the parameters that are not at a bound: inverse standard deviations of the relative directions, largest first.
    directions : tuple of Direction
        Those not determined.
    groups : tuple of CollinearGroup
        Parameters that the data see almost only together, the worst determined first.
    """

    rank: int
    condition: float
    singular_values: FloatArray
    directions: tuple[Direction, ...]
    groups: tuple[CollinearGroup, ...] = ()

    @property
    def n_free(self) -> int:
        """Number of parameters that are not at a bound: the largest that the rank can be."""
        return len(self.singular_values)


def identifiability(
    jacobian: FloatArray,
    values: FloatArray,
    names: tuple[str, ...],
    noise_scale: float = 1.0,
    free: np.ndarray | None = None,
) -> Identifiability:
    """Rank and undetermined directions of the parameters, from a Jacobian by relative parameters.

    A direction is undetermined if its relative standard deviation is 1 or more, or its singular value is below 1e-10 of
    the largest.

    Parameters
    ----------
    jacobian : (n_data, n_params) float array
        Whitened derivative with respect to the logarithm of each parameter.
    values : (n_params,) float array
        Physical values, for the words.
    names : tuple of str
    noise_scale : float
        Factor on the noise (root of chi-square per degree of freedom where the noise level is not known).
    free : (n_params,) bool array, optional
        Parameters that count; all by default.
    """
    counted = np.arange(len(names)) if free is None else np.flatnonzero(free)
    if len(jacobian) and np.isfinite(jacobian).all():
        jacobian = triangle_of(jacobian)  # says the same of every direction
    n_params = len(counted)
    singular = np.zeros(n_params)
    if jacobian.shape[0] and n_params:
        _, found, own = np.linalg.svd(np.linalg.qr(jacobian[:, counted], mode="r"))
        singular[: len(found)] = found
    else:
        own = np.eye(n_params)
    rows = np.zeros((len(own), len(names)))
    rows[:, counted] = own
    largest = singular.max(initial=0.0)
    floor = max(noise_scale, 1e-10 * largest)
    directions = []
    for value, vector in zip(singular[::-1], rows[::-1], strict=True):
        if value > floor:
            break
        relative_std = noise_scale / value if value > 1e-10 * largest else np.inf
        directions.append(Direction(vector, float(relative_std), direction_words(vector, values, names)))
    smallest = singular.min(initial=np.inf)
    condition = float(largest / smallest) if smallest > 0 else np.inf
    groups = collinear_groups(jacobian, names, noise_scale)
    return Identifiability(n_params - len(directions), condition, singular, tuple(directions), groups)


def direction_words(vector: FloatArray, values: FloatArray, names: tuple[str, ...]) -> str:
    """Sentence on which parameters an undetermined direction of relative change involves.

    `vector` (n_params,) is the direction, `values` (n_params,) the physical parameters. Parameters with an entry above 0.1
    of the largest count.

    Examples
    --------
    >>> direction_words(np.array([1.0, -1.0]), np.array([2.0, 2.0]), ("mass[a]", "mass[b]"))
    'mass[a] and mass[b] only as a sum'
    """
    size = np.abs(vector) / np.abs(vector).max()
    members = np.flatnonzero(size > 0.1)
    listed = [names[i] for i in members]
    if len(members) == 1:
        return f"{listed[0]} not at all"
    joined = _join_names(listed)
    kinds = {name.split("[")[0] for name in listed}
    if len(kinds) == 1:
        together = _combination_words(vector[members], values[members], kinds.pop())
        if together:
            return f"{joined} only {together}"
    scaled = _gain_words(vector[members], listed)
    if scaled:
        return scaled
    if np.ptp(vector[members]) < 0.1 * np.abs(vector[members]).max():
        return f"{joined} only as ratios: their common scale is free"
    largest = members[np.sort(np.argsort(-size[members], kind="stable")[:_MOST_NAMED])]
    parts = " ".join(f"{'+' if vector[i] > 0 else '-'}{abs(vector[i]):.2f} {names[i]}" for i in largest)
    parts += "" if len(largest) == len(members) else f" and {len(members) - len(largest)} more"
    return f"{joined} only in combination: free along the relative change {parts}"


def _join_names(names: list[str]) -> str:
    """`names` joined with commas and "and"; above `_MOST_NAMED`, the first `_MOST_NAMED` and the number of the others."""
    if len(names) > _MOST_NAMED:
        return f"{', '.join(names[:_MOST_NAMED])} and {len(names) - _MOST_NAMED} more"
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]


def _gain_words(relative: FloatArray, names: list[str]) -> str:
    """Sentence part on a common scale of parameters that only channel gains could fix; "" if the direction is none.

    `relative` (n,) is the undetermined direction of relative change of the parameters `names`. It must include a gain, and all
    other parameters must change by about the same part.
    """
    is_gain = np.array([name.startswith("gain[") for name in names])
    others = relative[~is_gain]
    if not is_gain.any() or len(others) == 0 or np.ptp(others) > 0.1 * np.abs(others).max():
        return ""
    listed = [name for name, gain in zip(names, is_gain, strict=True) if not gain]
    gains = " and ".join(name for name, gain in zip(names, is_gain, strict=True) if gain)
    joined = _join_names(listed)
    how = "" if len(listed) == 1 else " only as ratios: their absolute size is proportional to"
    return f"{joined}{how or ' only together with'} {gains}"


def _combination_words(relative: FloatArray, values: FloatArray, kind: str) -> str:
    """Words on the combination of parameters that is determined, such as their sum; "" if there is none.

    `relative` (n,) is the undetermined direction of relative change of parameters of one `kind`, `values` (n,) are their
    physical values. A series (sum of reciprocals) is looked for only among stiffnesses.
    """
    change, inverse = relative * values, relative / values
    as_sum = abs(change.sum()) < 0.05 * np.abs(change).sum()
    as_series = "stiffness" in kind and abs(inverse.sum()) < 0.05 * np.abs(inverse).sum()
    if as_sum and as_series:
        return "together: as their sum, or in series (the sum of their reciprocals)"
    if as_series:
        return "in series, as the sum of their reciprocals"
    return "as a sum" if as_sum else ""
