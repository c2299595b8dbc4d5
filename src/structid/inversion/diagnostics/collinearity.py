"""Parameters that data see almost only together: by correlation, and by variance-decomposition proportions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.core.arrays import FloatArray
from structid.inversion.covariance import inverse_information

#: Correlation from which two parameters count as seen together.
STRONG_CORRELATION = 0.95
#: Condition index and proportion of Belsley, Kuh and Welsch (1980), section 3.2.
STRONG_CONDITION, STRONG_PROPORTION = 30.0, 0.5


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
        others were known.
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
    indices above 30, which finds dependencies that no pair shows. Parameters that the data do not determine at all are
    in no group: `Identifiability.directions` names them.

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
    found = _correlated_sets(np.abs(correlation))
    for members in _sets_by_variance_proportions(condition, proportions):
        if members.difference(*found):
            inside = [group for group in found if group & members]
            found = [group for group in found if group not in inside] + [members.union(*inside)]
    lookup = _Directions(tuple(names[int(i)] for i in sound), jacobian[:, sound], condition, proportions)
    groups = [_group(sorted(m, key=lambda i: -std[i]), correlation, lookup, noise_scale) for m in found]
    return tuple(sorted(groups, key=lambda group: -float(group.alone.max())))


@dataclass(frozen=True, eq=False)
class _Directions:
    """Determined parameters, their columns, and the dependencies among them."""

    names: tuple[str, ...]
    jacobian: FloatArray
    condition: FloatArray
    proportions: FloatArray


def variance_proportions(jacobian: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Condition index of each singular direction, and its share in the variance of each parameter.

    Shapes (n_params,) and (n_params, n_params): ``proportions[k, j]`` for direction k and parameter j; columns sum to 1. The
    condition index is the largest singular value over that of the direction. `jacobian` (n_data, n_params) is scaled to columns
    of unit length first.
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
        one, other = clusters[int(first[k])], clusters[int(second[k])]
        if one is not other and size[np.ix_(sorted(one), sorted(other))].min() >= STRONG_CORRELATION:
            one |= other
            clusters.update(dict.fromkeys(other, one))
    return [group for i, group in clusters.items() if len(group) > 1 and i == min(group)]


def _sets_by_variance_proportions(condition: FloatArray, proportions: FloatArray) -> list[set[int]]:
    """Sets of indices of parameters that share near-dependencies, by their variance proportions; each has two members or more.

    `condition` (n,) are the condition indices of the singular directions, `proportions` (n, n_params) their shares in each
    variance. Directions with a condition index above `STRONG_CONDITION` count, and parameters with more than half of their
    variance in these together. A direction joins those of them with more than a tenth of its largest share; sets that
    overlap are merged.
    """
    strong = proportions[condition > STRONG_CONDITION]
    involved = np.flatnonzero(strong.sum(axis=0) > STRONG_PROPORTION)
    sets: list[set[int]] = []
    for part in strong:
        members = {int(j) for j in involved if part[j] > 0.1 * part.max()}
        linked = [other for other in sets if other & members]
        sets = [other for other in sets if other not in linked] + [members.union(*linked)]
    return [members for members in sets if len(members) > 1]


def _group(members: list[int], correlation: FloatArray, of: _Directions, noise_scale: float) -> CollinearGroup:
    """Collinear group of the parameters with indices `members`, with its standard deviations and a sentence.

    All other parameters count as unknown too. `correlation` (n_params, n_params) is the matrix of all parameters, `of`
    holds their names, Jacobian and singular directions, and `noise_scale` multiplies the noise.
    """
    others = [i for i in range(len(of.names)) if i not in members]
    triangle = np.asarray(np.linalg.qr(of.jacobian[:, others + members], mode="r"))
    root = triangle[len(others) :, len(others) :] / noise_scale
    inverse = np.linalg.inv(root)
    alone, given = np.linalg.norm(inverse, axis=1), 1 / np.linalg.norm(root, axis=0)
    named = tuple(of.names[i] for i in members)
    smallest = float(np.abs(correlation[np.ix_(members, members)]).min())
    index = float(of.condition[int(np.argmax(of.proportions[:, members].sum(axis=1)))])
    caveat = "" if noise_scale == 1.0 else " (were the model's errors independent from line to line)"
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
        f" {_span(given)}; as it is, each is known to {_span(alone)}"
    )
    return CollinearGroup(named, smallest, alone, float(given.max()), index, words + caveat)


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
