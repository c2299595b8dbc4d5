"""Identifiability of parameters: directions that data determine, collinear groups, and refusal by the Cramer-Rao bound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.core.arrays import FloatArray, locked
from structid.core.display import join_words
from structid.core.errors import SingularModelError
from structid.inversion.covariance import inverse_information
from structid.inversion.linearization import triangle_of
from structid.inversion.problem import Problem

#: Most parameters that the words on a direction name.
_MOST_NAMED = 12
#: Correlation from which two parameters count as seen together.
STRONG_CORRELATION = 0.95
#: Condition index and proportion of Belsley, Kuh and Welsch (1980), section 3.2.
STRONG_CONDITION, STRONG_PROPORTION = 30.0, 0.5
#: An estimate that fits to the noise and is this well determined overrules a hopeless bound at the initial values: a
#: value that wandered off with the noise is seldom four of its standard deviations from 0.
_WELL_DETERMINED = 0.25


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
    """Rank, undetermined directions (the worst first) and collinear groups of parameters, from a relative Jacobian.

    A direction is undetermined if its relative standard deviation is 1 or more, or its singular value is below 1e-10 of
    the largest.

    Parameters
    ----------
    jacobian : (n_data, n_params) float array
        Whitened derivative with respect to the logarithm of each parameter.
    values : (n_params,) float array
        Physical values, for the words.
    names : tuple of str
        Names of the parameters.
    noise_scale : float
        Factor on the noise (root of chi-square per degree of freedom where the noise level is not known).
    free : (n_params,) bool array, optional
        Parameters that count in rank, condition and directions; all by default. Groups are of all parameters.
    """
    counted = np.arange(len(names)) if free is None else np.flatnonzero(free)
    if len(jacobian) and np.isfinite(jacobian).all():
        jacobian = triangle_of(jacobian)  # says the same of every direction
    n_params = len(counted)
    singular = np.zeros(n_params)
    if jacobian.shape[0] and n_params:
        _, values_found, vectors = np.linalg.svd(np.linalg.qr(jacobian[:, counted], mode="r"))
        singular[: len(values_found)] = values_found
    else:
        vectors = np.eye(n_params)
    rows = np.zeros((len(vectors), len(names)))
    rows[:, counted] = vectors
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
    """Sentence on which parameters an undetermined direction of relative change involves, and what is determined.

    `vector` (n_params,) is the direction, `values` (n_params,) the physical parameters, `names` their names. Parameters
    with an entry above 0.1 of the largest count. Determined may be a sum or series of parameters of one kind, ratios,
    or a common scale with channel gains; else the direction itself is written out.

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
    """`names` joined with commas and "and"; of more than twelve, the first twelve and the number of the others."""
    if len(names) > _MOST_NAMED:
        return f"{', '.join(names[:_MOST_NAMED])} and {len(names) - _MOST_NAMED} more"
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]


def _gain_words(relative: FloatArray, names: list[str]) -> str:
    """Sentence part on a common scale of parameters that only channel gains could fix; "" if the direction is none.

    `relative` (n,) is the undetermined direction of relative change of the parameters `names`. It must include a gain,
    and all other parameters must change by the same part, to 10 % of the largest change.
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

    `relative` (n,) is the undetermined direction of relative change of parameters of one `kind`, `values` (n,) are
    their physical values. A sum is determined if the changes along the direction cancel to 5 %; a series (sum of
    reciprocals) is tested in the same way, only among stiffnesses.
    """
    change, inverse = relative * values, relative / values
    as_sum = abs(change.sum()) < 0.05 * np.abs(change).sum()
    as_series = "stiffness" in kind and abs(inverse.sum()) < 0.05 * np.abs(inverse).sum()
    if as_sum and as_series:
        return "together: as their sum, or in series (the sum of their reciprocals)"
    if as_series:
        return "in series, as the sum of their reciprocals"
    return "as a sum" if as_sum else ""


@dataclass(frozen=True, eq=False)
class CollinearGroup:
    """Parameters that the data determine much better together than alone.

    Attributes
    ----------
    members : tuple of str
        Names, the worst determined first.
    correlation : float
        Smallest magnitude of the correlations among them.
    alone : (n_members,) float array
        Relative standard deviation of each.
    together : float
        That of what the data do see: for two parameters their ratio or product, for more the worst of them if the
        other members were known.
    condition : float
        Condition index of the dependency that binds them; infinite for an exact one.
    words : str
        The same as a sentence.
    """

    members: tuple[str, ...]
    correlation: float
    alone: FloatArray
    together: float
    condition: float
    words: str


def collinear_groups(
    jacobian: FloatArray, names: tuple[str, ...], noise_scale: float = 1.0
) -> tuple[CollinearGroup, ...]:
    """Groups of parameters in near dependency, the worst determined first.

    Two rules find them: parameters whose correlations all reach 0.95 in magnitude, and parameters that owe more than
    half of their variance to singular directions that they share, of the Jacobian with unit columns and with condition
    indices above 30, which finds dependencies that no pair shows. Overlapping sets are merged. Parameters that the data
    do not determine at all are in no group. Empty without rows, if an entry is not finite, or if fewer than two are
    determined.

    Parameters
    ----------
    jacobian : (n_data, n_params) float array
        Whitened derivative with respect to the logarithm of each parameter.
    names : tuple of str
    noise_scale : float
        Factor on the noise.

    References
    ----------
    Belsley, Kuh and Welsch (1980), Regression Diagnostics, chapter 3.
    """
    if jacobian.shape[0] == 0 or not np.isfinite(jacobian).all():
        return ()
    covariance = noise_scale**2 * inverse_information(jacobian)
    sound = np.flatnonzero(np.isfinite(np.diag(covariance)))
    if len(sound) < 2:
        return ()
    covariance = covariance[np.ix_(sound, sound)]
    std = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(std, std)
    condition, proportions = variance_proportions(jacobian[:, sound])
    sets = _correlated_sets(np.abs(correlation))
    for members in _sets_by_variance_proportions(condition, proportions):
        if members.difference(*sets):
            inside = [group for group in sets if group & members]
            sets = [group for group in sets if group not in inside] + [members.union(*inside)]
    lookup = _Directions(tuple(names[int(i)] for i in sound), jacobian[:, sound], condition, proportions)
    groups = [_group(sorted(m, key=lambda i: -std[i]), correlation, lookup, noise_scale) for m in sets]
    return tuple(sorted(groups, key=lambda group: -float(group.alone.max())))


@dataclass(frozen=True, eq=False)
class _Directions:
    """Names of the determined parameters, and the dependencies among them.

    `jacobian` (n_data, n) has their columns, `condition` (n_directions,) the condition indices of its singular
    directions, and `proportions` (n_directions, n) the shares of these in the variance of each parameter.
    """

    names: tuple[str, ...]
    jacobian: FloatArray
    condition: FloatArray
    proportions: FloatArray


def variance_proportions(jacobian: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Condition index of each singular direction, and its share in the variance of each parameter.

    Shapes (n,) and (n, n_params) with n = min(n_data, n_params) directions, that of the largest singular value first;
    entry [k, j] of the shares is of direction k and parameter j, and columns sum to 1. The condition index is the
    largest singular value over that of the direction. `jacobian` (n_data, n_params) is scaled to columns of unit length
    first.
    """
    lengths = np.linalg.norm(jacobian, axis=0)
    unit = jacobian / np.where(lengths > 0, lengths, 1.0)
    _, singular, rows = np.linalg.svd(np.linalg.qr(unit, mode="r"), full_matrices=False)
    safe = np.maximum(singular, np.finfo(float).tiny ** 0.25)
    part = (rows / safe[:, None]) ** 2
    return singular[0] / safe, part / part.sum(axis=0)


def _correlated_sets(size: FloatArray) -> list[set[int]]:
    """Sets of indices of parameters whose absolute correlations are all at least 0.95, each with two members or more.

    `size` (n_params, n_params) holds the absolute correlations; pairs are merged in order of falling correlation.
    """
    clusters: dict[int, set[int]] = {i: {i} for i in range(len(size))}
    first, second = np.triu_indices(len(size), 1)
    strong = np.flatnonzero(size[first, second] >= STRONG_CORRELATION)
    for k in strong[np.argsort(-size[first[strong], second[strong]], kind="stable")].tolist():
        cluster, other = clusters[int(first[k])], clusters[int(second[k])]
        if cluster is not other and size[np.ix_(sorted(cluster), sorted(other))].min() >= STRONG_CORRELATION:
            cluster |= other
            clusters.update(dict.fromkeys(other, cluster))
    return [group for i, group in clusters.items() if len(group) > 1 and i == min(group)]


def _sets_by_variance_proportions(condition: FloatArray, proportions: FloatArray) -> list[set[int]]:
    """Sets of two or more indices of parameters that share near-dependencies, by their variance proportions.

    `condition` (n,) are the condition indices of the singular directions, `proportions` (n, n_params) their shares in
    each variance. Directions with a condition index above 30 count, and parameters with more than half of their
    variance in these together. Such a direction joins those of these parameters whose share is more than a tenth of its
    largest; sets that overlap are merged.
    """
    strong = proportions[condition > STRONG_CONDITION]
    involved = np.flatnonzero(strong.sum(axis=0) > STRONG_PROPORTION)
    sets: list[set[int]] = []
    for part in strong:
        members = {int(j) for j in involved if part[j] > 0.1 * part.max()}
        linked = [other for other in sets if other & members]
        sets = [other for other in sets if other not in linked] + [members.union(*linked)]
    return [members for members in sets if len(members) > 1]


def _group(members: list[int], correlation: FloatArray, directions: _Directions, noise_scale: float) -> CollinearGroup:
    """Collinear group of the parameters with indices `members`, with relative standard deviations and a sentence.

    Parameters that are no members count as unknown too. `correlation` (n_params, n_params) is that of all parameters,
    `directions` holds their names, relative Jacobian and singular directions, and `noise_scale` multiplies the noise.
    """
    others = [i for i in range(len(directions.names)) if i not in members]
    triangle = np.asarray(np.linalg.qr(directions.jacobian[:, others + members], mode="r"))
    root = triangle[len(others) :, len(others) :] / noise_scale
    inverse = np.linalg.inv(root)
    alone, others_known = np.linalg.norm(inverse, axis=1), 1 / np.linalg.norm(root, axis=0)
    named = tuple(directions.names[i] for i in members)
    smallest = float(np.abs(correlation[np.ix_(members, members)]).min())
    index = float(directions.condition[int(np.argmax(directions.proportions[:, members].sum(axis=1)))])
    caveat = " (noise alone)" if noise_scale == 1.0 else " (were the model's errors independent from line to line)"
    if len(members) == 2:
        pair = float(correlation[members[0], members[1]])
        together = float(np.linalg.norm(inverse[0] - np.sign(pair) * inverse[1]))
        words = (
            f"{named[0]} and {named[1]} are correlated ({_correlation_text(pair)}): their"
            f" {'ratio' if pair > 0 else 'product'} is known to {percent_text(together)}, each alone to {_span(alone)}"
        )
        return CollinearGroup(named, smallest, alone, together, index, words + caveat)
    words = (
        f"{', '.join(named[:-1])} and {named[-1]} are correlated: with the others known, each would be known to"
        f" {_span(others_known)}; as it is, each is known to {_span(alone)}"
    )
    return CollinearGroup(named, smallest, alone, float(others_known.max()), index, words + caveat)


def percent_text(value: float) -> str:
    """The relative standard deviation `value` in per cent, two digits.

    Examples
    --------
    >>> percent_text(0.00512), percent_text(26.0), percent_text(float("inf"))
    ('0.51 %', '2600 %', 'infinite')
    """
    if not np.isfinite(value):
        return "infinite" if value > 0 else "unknown"
    return f"{float(f'{100 * value:.2g}'):g} %"


def _span(values: FloatArray) -> str:
    """Text of the range of relative standard deviations `values`, such as ``2 to 5 %``; a single value if both ends agree."""
    low, high = percent_text(float(values.min())), percent_text(float(values.max()))
    return low if low == high else f"{low.removesuffix(' %')} to {high}"


def _correlation_text(value: float) -> str:
    """Correlation as text, with three to six decimals so that it does not round to 1."""
    digits = int(np.clip(np.ceil(-np.log10(max(1 - abs(value), 1e-12))), 3, 6))
    return f"{value:.{digits}f}"


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
        """Standard deviations over sizes, (n_params,); infinite where nothing determines the parameter, or its size is 0."""
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

    Noise is as whitened, and prior rows count as data. NaN for undetermined parameters, and for all if the model cannot
    be evaluated there. `point_name` is what sentences call the point, such as "the initial values".
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

    `initial` and `final` are the bounds at the start and at the estimate, and `names` are those of the parameters. The
    bound at the start is given if a parameter is False in `carried_at_start` (n_params,), the mask of those that it
    lets the data determine; that at the estimate if any there exceeds the value. With the first alone, a new start from
    the estimate is proposed.
    """
    said = [] if carried_at_start.all() else [initial.words(names)]
    if (final.relative > 1).any():
        said.append(final.words(names))
    elif said:
        said.append("where the start was far off and the fit is good, start again from the estimate")
    return "; ".join(said)
