"""Stabilization diagram: poles over model orders to modes, by stability, clustering and choice of one pole a mode.

Poles are called stable or not by two means of their distance to the nearest pole of the order before; the boundary
between the two is the width of a cluster. Larger clusters take the nearest like poles of smaller ones in the orders
that they lack (`_gather_scattered_poles`). Clusters are modes that are large, by two means of the numbers of poles,
unless they are `UNLIKELY` to be modes (`mode_probability`), or that are `LIKELY` to be.

References
----------
Neu, Janser, Khatibi and Orifici (2017), Fully automated operational modal analysis using multi-stage clustering,
Mech. Syst. Signal Process. 84, 308-323; Reynders, Houbrechts and De Roeck (2012), Fully automated (operational) modal
analysis, Mech. Syst. Signal Process. 29, 228-250. Both use more criteria; here it is the distance of poles and shapes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np
from scipy import special

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.modal.poles.poles import HardCriteria, Poles, modal_phase_collinearity

_STILL = 1e-3  # poles that move less from order to order are equally stable, those of noise-free motion included
_APART = 1e3  # distance of two poles of one order, which cannot be one mode
_ONE_MODE = 0.2  # distance to the middle of a cluster below which a pole belongs there: a MAC of 0.8
_ONE_POLE = 0.05  # part of it that the poles themselves may be apart
_FEWEST_POLES = 3  # of a cluster whose spread over the orders says something
#: Log odds of being a mode, for 1, stability, log10 of the distance, log10 of the energy, and collinearity.
_WEIGHTS = np.array([-8.92, 3.94, -2.18, 0.93, 2.21])
#: The same where deviations are known, for 1, log10 of the excess and log10 of the error of the shape.
_WEIGHTS_OF_DEVIATIONS = np.array([1.33, -3.72, -4.27])
#: Probability from which on a cluster is taken for a mode, however few its poles.
LIKELY = 0.8
#: Probability below which a cluster is no mode, however many its poles.
UNLIKELY = 0.1


@dataclass(frozen=True, eq=False)
class Cluster:
    """Poles of several orders taken for one mode.

    Attributes
    ----------
    number, index : (n_poles,) int arrays
        Which order of the sweep, and which of its poles.
    frequency, damping_ratio : (n_poles,) float arrays
        Hz and 1.
    chosen : int
        The pole nearest to all others, which stands for the mode.
    stability : float
        Part of the orders, from the first that has a pole of the cluster on, that have one.
    distance : float
        Mean `pole_distance` of the chosen pole to the others.
    energy : float
        Median of `Poles.energy`.
    collinearity : float
        Median modal phase collinearity.
    excess : float
        Standard deviation of the frequency of the chosen pole over the least that a record of this length allows; NaN where
        there is none.
    shape_error : float
        Standard deviation of the shape of the chosen pole over its size, channels scaled; NaN where there is none.
    """

    number: IntArray
    index: IntArray
    frequency: FloatArray
    damping_ratio: FloatArray
    chosen: int
    stability: float = np.nan
    distance: float = np.nan
    energy: float = np.nan
    collinearity: float = np.nan
    excess: float = np.nan
    shape_error: float = np.nan

    @property
    def probability(self) -> float:
        """Probability that the cluster is a mode (`mode_probability`); NaN where too little is known."""
        return mode_probability(self)

    @property
    def place(self) -> tuple[int, int]:
        """Number of the order in the sweep, from 0, and index of the chosen pole among the poles of that order."""
        return int(self.number[self.chosen]), int(self.index[self.chosen])

    @property
    def size(self) -> int:
        return len(self.number)

    @property
    def frequency_spread(self) -> float:
        """Standard deviation of the frequency of the poles over the orders, Hz."""
        return float(self.frequency.std())


def pole_distance(
    first: ComplexArray, first_shapes: ComplexArray, second: ComplexArray, second_shapes: ComplexArray
) -> FloatArray:
    """Distance between two sets of poles, |s_i - s_j| / max(|s_i|, |s_j|) + 1 - MAC_ij, (n_first, n_second).

    Poles are (n_first,) and (n_second,), their shapes (n_channels, n_first) and (n_channels, n_second).
    """
    x, y = (z / np.linalg.norm(z, axis=0) for z in (first_shapes, second_shapes))
    return _unit_distance(first, x, second, y)


def _unit_distance(
    first: ComplexArray, first_shapes: ComplexArray, second: ComplexArray, second_shapes: ComplexArray
) -> FloatArray:
    """Relative distance of poles plus 1 - MAC of their shapes, (n_first, n_second); 0 for equal poles and shapes.

    The distance of two poles is over the larger magnitude. Poles `first` (n_first,) and `second` (n_second,) are in
    rad/s; `first_shapes` (n_channels, n_first) and `second_shapes` (n_channels, n_second) have columns of norm 1.
    """
    size = np.maximum(np.abs(first)[:, None], np.abs(second)[None, :])
    apart, product = first[:, None] - second, first_shapes.conj().T @ second_shapes
    likeness = np.minimum(product.real**2 + product.imag**2, 1.0)
    return np.asarray(np.sqrt(apart.real**2 + apart.imag**2) / size + 1.0 - likeness)


def clusters(
    sweep: Sequence[Poles], scale: FloatArray, criteria: HardCriteria | None = None, keep_all: bool = False
) -> tuple[Cluster, ...]:
    """Clusters of stable poles over the model orders that are modes, by increasing frequency; () if no pole is stable.

    A pole is stable if its distance (relative, plus 1 - MAC) to the nearest of the next lower order is at most the
    boundary between two groups of such distances, by 2-means of their logarithms.

    Parameters
    ----------
    sweep : sequence of Poles
        One for each order, increasing.
    scale : (n_channels,) float array
        By which shapes are divided before they are compared.
    criteria : HardCriteria, optional
        Poles that do not meet them are left out; the defaults of `HardCriteria` if None.
    keep_all : bool
        Keep all clusters, also those that are probably no mode; by default only `likely_modes`.
    """
    limits = criteria or HardCriteria()
    kept = [limits.indices(poles) for poles in sweep]
    s = np.concatenate([p.poles[k] for p, k in zip(sweep, kept, strict=True)])
    columns = [p.shapes[:, k] for p, k in zip(sweep, kept, strict=True)]
    shapes = np.asarray(np.concatenate(columns, axis=1) / scale[:, None], dtype=np.complex128)
    shapes = shapes / np.linalg.norm(shapes, axis=0)
    number = np.repeat(np.arange(len(sweep)), [len(k) for k in kept])
    index = np.concatenate(kept) if kept else np.zeros(0, dtype=int)
    energy = np.concatenate([np.asarray(p.energy)[k] for p, k in zip(sweep, kept, strict=True)])
    near = np.log10(np.maximum(_nearest_before(s, shapes, number, len(sweep)), _STILL))
    boundary = _two_means_boundary(near[np.isfinite(near)])
    stable = np.flatnonzero(near <= boundary)
    if not len(stable):
        return ()
    s, shapes, number, index, energy = s[stable], shapes[:, stable], number[stable], index[stable], energy[stable]
    pool = _Pool(s, number, index, energy, modal_phase_collinearity(shapes), len(sweep))
    distance = _unit_distance(s, shapes, s, shapes)
    labels = _gather_scattered_poles(_link_clusters(distance, number, 10.0**boundary), distance, s, number)
    members = np.split(np.argsort(labels, kind="stable"), np.cumsum(np.bincount(labels)[1:])[:-1])
    every = sorted((_cluster(own, pool, distance) for own in members), key=lambda c: c.frequency[c.chosen])
    return tuple(every) if keep_all else likely_modes(every)


def likely_modes(every: Sequence[Cluster]) -> tuple[Cluster, ...]:
    """Clusters of `every` that are probably modes, in the same order.

    These are clusters in the larger of two groups by number of poles (two means) with a probability not below `UNLIKELY` (0.1),
    and all with a probability of `LIKELY` (0.8) or more.
    """
    sizes = np.array([c.size for c in every], dtype=float)
    large = sizes > _two_means_boundary(np.append(sizes, 0.0))
    return tuple(
        c
        for c, is_large in zip(every, large, strict=True)
        if (is_large and not c.probability < UNLIKELY) or c.probability >= LIKELY
    )


def _nearest_before(s: ComplexArray, shapes: ComplexArray, number: IntArray, n_orders: int) -> FloatArray:
    """Distance of every pole to the nearest pole of the next lower order, (n_poles,); infinite if there is none.

    The distance is that of the poles over the larger magnitude, plus 1 less the MAC. `s` (n_poles,), rad/s, and
    `shapes` (n_channels, n_poles), of norm 1, are of all poles; `number` is the index of the order of each, not
    decreasing. `n_orders` is the number of orders.
    """
    nearest = np.full(len(s), np.inf)
    edges = np.searchsorted(number, np.arange(n_orders + 1)).tolist()
    for first, here, after in zip(edges[:-2], edges[1:-1], edges[2:], strict=True):
        if first < here < after:
            distance = _unit_distance(s[here:after], shapes[:, here:after], s[first:here], shapes[:, first:here])
            nearest[here:after] = distance.min(axis=1)
    return nearest


def _two_means_boundary(values: FloatArray) -> float:
    """Boundary between two groups of `values` by one-dimensional 2-means: halfway between the two means.

    It is the maximum if all are equal, and -inf if there are none.
    """
    ordered = np.sort(values)
    if len(ordered) < 2 or ordered[0] == ordered[-1]:
        return float(ordered.max(initial=-np.inf))
    n, total = np.arange(1, len(ordered)), np.cumsum(ordered)
    below, above = total[:-1] / n, (total[-1] - total[:-1]) / (len(ordered) - n)
    between = n * below**2 + (len(ordered) - n) * above**2
    cut = int(np.argmax(between))
    return float(0.5 * (below[cut] + above[cut]))


def _link_clusters(distance: FloatArray, number: IntArray, width: float) -> IntArray:
    """Cluster labels 1, 2, ... of poles, (n_poles,), by average linkage up to the distance `width`.

    A cluster has at most one pole of each order. `distance` (n_poles, n_poles) is that between poles, `number`
    (n_poles,) the index of the order of each.
    """
    if len(distance) < 2:
        return np.ones(len(distance), dtype=int)
    from scipy.cluster.hierarchy import fcluster, linkage
    from scipy.spatial.distance import squareform

    apart = np.where(number[:, None] == number[None, :], _APART, 0.5 * (distance + distance.T))
    np.fill_diagonal(apart, 0.0)
    tree = linkage(squareform(apart, checks=False), method="average")
    return np.asarray(fcluster(tree, max(width, _STILL), criterion="distance"))


def _gather_scattered_poles(labels: IntArray, distance: FloatArray, poles: ComplexArray, number: IntArray) -> IntArray:
    """Cluster labels 1, 2, ..., (n_poles,), after clusters took like poles of smaller ones in the orders they lack.

    Larger clusters come first, and those of one pole take none. In each such order the nearest pole is taken, if its
    median distance to the cluster is below 0.2 and it lies within 5 % of the central pole. Poles of
    close or highly damped modes scatter over the orders and fall into several clusters. `labels`, `poles` (rad/s) and
    `number`, the index of the order of each pole, are (n_poles,); `distance` is (n_poles, n_poles). Labels without
    poles are closed up.
    """
    labels, sizes = labels.copy(), np.bincount(labels)
    taken = np.zeros(len(labels), dtype=bool)
    for label in np.argsort(-sizes, kind="stable")[: np.count_nonzero(sizes > 1)].tolist():
        members = np.flatnonzero(labels == label)
        if not len(members):
            continue
        taken[members] = True
        middle = poles[members[_total_distances(members, distance).argmin()]]
        away = np.median(distance[:, members], axis=1)
        like = (away < _ONE_MODE) & (np.abs(poles - middle) < _ONE_POLE * abs(middle))
        candidates = np.flatnonzero(like & ~taken & ~np.isin(number, number[members]))
        candidates = candidates[np.argsort(away[candidates], kind="stable")]
        nearest = candidates[np.unique(number[candidates], return_index=True)[1]]
        labels[nearest], taken[nearest] = label, True
    return np.unique(labels, return_inverse=True)[1] + 1


def _total_distances(members: IntArray, distance: FloatArray) -> FloatArray:
    """Sums of the distances of each of the poles `members` to all of them, (n_members,); the central pole has the least."""
    return np.asarray(distance[np.ix_(members, members)].sum(axis=1))


@dataclass(frozen=True, eq=False)
class _Pool:
    """Stable poles of all orders, one after another, of which order each is, and its phase collinearity."""

    poles: ComplexArray
    number: IntArray
    index: IntArray
    energy: FloatArray
    collinearity: FloatArray
    n_orders: int


def _cluster(members: IntArray, pool: _Pool, distance: FloatArray) -> Cluster:
    """Cluster of the poles `members` (indices in the pool), with its central pole, stability, distance and medians.

    The central pole has the least sum of distances to the others, whose mean is the cluster's distance; stability is
    the number of poles over that of orders from the first on that shows one. Energy and phase collinearity are medians.
    `distance` (n_poles, n_poles) is that between the poles of the pool.
    """
    s, number = pool.poles[members], pool.number[members]
    total = _total_distances(members, distance)
    omega, chosen = np.abs(s), int(total.argmin())
    return Cluster(
        number,
        pool.index[members],
        omega / (2 * np.pi),
        np.asarray(-s.real / omega),
        chosen,
        stability=len(members) / (pool.n_orders - int(number.min())),
        distance=float(total[chosen] / max(len(members) - 1, 1)),
        energy=median(pool.energy[members].tolist()),
        collinearity=median(pool.collinearity[members].tolist()),
    )


def evidence(cluster: Cluster) -> FloatArray:
    """Regressors of the probability that a cluster is a mode, (5,), or (3,) where its deviations are known.

    The five: 1, stability, log10 of the distance, log10 of the energy, and phase collinearity. The three, beside which
    these tell nothing more: 1, log10 of the deviation of the frequency over the least that the record allows
    (`excess`), and log10 of the deviation of the shape over its size. Values before the logarithm are cut to 1e-6 to
    1e6.
    """
    distance, energy, excess, error = (
        float(np.log10(np.clip(value, 1e-6, 1e6)))
        for value in (cluster.distance, cluster.energy, cluster.excess, cluster.shape_error)
    )
    if np.isfinite(excess + error):
        return np.array([1.0, excess, error])
    return np.array([1.0, cluster.stability, distance, energy, cluster.collinearity])


def mode_probability(cluster: Cluster) -> float:
    """Probability that a cluster is a mode, by logistic regression on simulated records; NaN below three poles.

    The weights are those of `_WEIGHTS`, or `_WEIGHTS_OF_DEVIATIONS` where deviations are known, which
    `python benchmarks/accuracy/mode_probability.py` prints.
    """
    if cluster.size < _FEWEST_POLES:
        return float("nan")
    known = evidence(cluster)
    return float(special.expit(known @ (_WEIGHTS if len(known) == len(_WEIGHTS) else _WEIGHTS_OF_DEVIATIONS)))
