"""From poles over model orders to modes: which poles stay, which of them are one mode, which mode is meant.

Poles are called stable or not by two means of their distance to the nearest pole of the order before; the boundary
between the two is the width of a cluster. Clusters are modes that are large, by two means of the numbers of poles, or that
are likely to be modes (`mode_probability`).

References
----------
Neu, Janser, Khatibi and Orifici (2017), Fully automated operational modal analysis using multi-stage clustering,
Mech. Syst. Signal Process. 84, 308-323; Reynders, Houbrechts and De Roeck (2012), Fully automated (operational) modal
analysis, Mech. Syst. Signal Process. 29, 228-250. Both use more criteria; here it is the distance of poles and shapes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.modal.poles.poles import HardCriteria, Poles, modal_phase_collinearity

_STILL = 1e-3  # poles that move less from order to order are equally stable, those of noise-free motion included
_APART = 1e3  # distance of two poles of one order, which cannot be one mode
_FEWEST_POLES = 3  # of a cluster whose spread over the orders says something
#: Log odds of being a mode, for 1, stability, log10 of the distance, log10 of the energy, and collinearity.
_WEIGHTS = np.array([-8.92, 3.94, -2.18, 0.93, 2.21])
_LIKELY = 0.8  # probability from which on a cluster is taken for a mode, however few its poles


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

    @property
    def probability(self) -> float:
        """That the cluster is a mode (`mode_probability`); NaN where too little is known of it."""
        return mode_probability(self)

    @property
    def place(self) -> tuple[int, int]:
        """Order and index of the chosen pole."""
        return int(self.number[self.chosen]), int(self.index[self.chosen])

    @property
    def size(self) -> int:
        return len(self.number)

    @property
    def frequency_spread(self) -> float:
        """Standard deviation over the orders, Hz."""
        return float(self.frequency.std())


def pole_distance(
    first: ComplexArray, first_shapes: ComplexArray, second: ComplexArray, second_shapes: ComplexArray
) -> FloatArray:
    """Distance of poles, |s_i - s_j| / max(|s_i|, |s_j|) + 1 - MAC_ij, (n_first, n_second)."""
    size = np.maximum(np.abs(first)[:, None], np.abs(second)[None, :])
    x, y = (z / np.linalg.norm(z, axis=0) for z in (first_shapes, second_shapes))
    likeness = np.minimum(np.abs(x.conj().T @ y) ** 2, 1.0)
    return np.asarray(np.abs(first[:, None] - second[None, :]) / size + 1.0 - likeness)


def clusters(
    sweep: Sequence[Poles], scale: FloatArray, criteria: HardCriteria | None = None, keep_all: bool = False
) -> tuple[Cluster, ...]:
    """Clusters of stable poles over the model orders that are modes, by increasing frequency.

    Parameters
    ----------
    sweep : sequence of Poles
        One for each order, increasing.
    scale : (n_channels,) float array
        By which shapes are divided before they are compared.
    criteria : HardCriteria, optional
        Poles that do not meet them are left out.
    keep_all : bool
        Small clusters as well.
    """
    limits = criteria or HardCriteria()
    kept = [limits.indices(poles) for poles in sweep]
    s = np.concatenate([p.poles[k] for p, k in zip(sweep, kept, strict=True)])
    columns = [p.shapes[:, k] for p, k in zip(sweep, kept, strict=True)]
    shapes = np.asarray(np.concatenate(columns, axis=1) / scale[:, None], dtype=np.complex128)
    number = np.repeat(np.arange(len(sweep)), [len(k) for k in kept])
    index = np.concatenate(kept) if kept else np.zeros(0, dtype=int)
    energy = np.concatenate([np.asarray(p.energy)[k] for p, k in zip(sweep, kept, strict=True)])
    nearest = _nearest_before(s, shapes, number)
    near = np.log10(np.maximum(nearest, _STILL))
    boundary = _two_means_boundary(near[np.isfinite(near)])
    chosen = np.flatnonzero(near <= boundary)
    if not len(chosen):
        return ()
    labels = _linked(s[chosen], shapes[:, chosen], number[chosen], 10.0**boundary)
    pool = _Pool(s, shapes, number, index, energy, len(sweep))
    found = [_cluster(chosen[labels == label], pool) for label in np.unique(labels)]
    sizes = np.array([c.size for c in found], dtype=float)
    large = sizes > _two_means_boundary(np.append(sizes, 0.0))
    modes = [c for c, keep in zip(found, large, strict=True) if keep or keep_all or c.probability >= _LIKELY]
    return tuple(sorted(modes, key=lambda c: c.frequency[c.chosen]))


def _nearest_before(s: ComplexArray, shapes: ComplexArray, number: IntArray) -> FloatArray:
    """Distance of every pole to the nearest pole of the next lower order; infinite if there is none."""
    nearest = np.full(len(s), np.inf)
    for k in np.unique(number):
        here, before = np.flatnonzero(number == k), np.flatnonzero(number == k - 1)
        if len(before):
            nearest[here] = pole_distance(s[here], shapes[:, here], s[before], shapes[:, before]).min(axis=1)
    return nearest


def _two_means_boundary(values: FloatArray) -> float:
    """Boundary of two groups of `values` by one-dimensional 2-means; the maximum if all are equal."""
    ordered = np.sort(values)
    if len(ordered) < 2 or ordered[0] == ordered[-1]:
        return float(ordered.max(initial=-np.inf))
    n, total = np.arange(1, len(ordered)), np.cumsum(ordered)
    below, above = total[:-1] / n, (total[-1] - total[:-1]) / (len(ordered) - n)
    between = n * below**2 + (len(ordered) - n) * above**2
    cut = int(np.argmax(between))
    return float(0.5 * (below[cut] + above[cut]))


def _linked(s: ComplexArray, shapes: ComplexArray, number: IntArray, width: float) -> IntArray:
    """Cluster labels of poles by average linkage up to distance `width`, at most one pole of each order in one."""
    if len(s) < 2:
        return np.ones(len(s), dtype=int)
    from scipy.cluster.hierarchy import fcluster, linkage
    from scipy.spatial.distance import squareform

    distance = pole_distance(s, shapes, s, shapes)
    distance[number[:, None] == number[None, :]] = _APART
    np.fill_diagonal(distance, 0.0)
    tree = linkage(squareform(0.5 * (distance + distance.T), checks=False), method="average")
    return np.asarray(fcluster(tree, max(width, _STILL), criterion="distance"))


@dataclass(frozen=True, eq=False)
class _Pool:
    """All poles that meet the criteria, one after another, and of which order each is."""

    poles: ComplexArray
    shapes: ComplexArray
    number: IntArray
    index: IntArray
    energy: FloatArray
    n_orders: int


def _cluster(members: IntArray, pool: _Pool) -> Cluster:
    """Cluster of the poles `members` of a pool, with its central pole, stability and spread."""
    s, shapes, number = pool.poles[members], pool.shapes[:, members], pool.number[members]
    inside = pole_distance(s, shapes, s, shapes)
    omega, chosen = np.abs(s), int(inside.sum(axis=1).argmin())
    return Cluster(
        number,
        pool.index[members],
        omega / (2 * np.pi),
        np.asarray(-s.real / omega),
        chosen,
        stability=len(members) / (pool.n_orders - int(number.min())),
        distance=float(inside[chosen].sum() / max(len(members) - 1, 1)),
        energy=float(np.median(pool.energy[members])),
        collinearity=float(np.median(modal_phase_collinearity(shapes))),
    )


def evidence(cluster: Cluster) -> FloatArray:
    """What speaks for a cluster being a mode: 1, then stability, distance, energy and collinearity, (5,)."""
    distance, energy = (float(np.log10(max(value, 1e-6))) for value in (cluster.distance, cluster.energy))
    return np.array([1.0, cluster.stability, distance, energy, cluster.collinearity])


def mode_probability(cluster: Cluster) -> float:
    """Probability that a cluster is a mode, by logistic regression on simulated records.

    The weights are those of `_WEIGHTS`, which `python benchmarks/accuracy/mode_probability.py` prints.
    """
    if cluster.size < _FEWEST_POLES:
        return float("nan")
    return float(special.expit(evidence(cluster) @ _WEIGHTS))
