"""Unknowns with what an estimator needs of each: a name, a start, a range, what is known of it, and its free variable.

The free variable is what the estimator moves; a transform maps it to the physical parameter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, Self, TypeVar

import numpy as np
from scipy import sparse, special

from structid.core.arrays import FloatArray, IntArray, locked, require_shape
from structid.core.errors import InputError
from structid.unknowns.priors import Coupling, Priors

Transform = Literal["log", "linear", "interval"]
#: How many times its start a parameter may become in a search: answers beyond a thousand times are doubted already.
FARTHEST = 1e6
_FARTHEST_LOGIT = 60.0


@dataclass(frozen=True, eq=False)
class Transforms:
    """One transform a parameter: ``log`` keeps it positive, ``interval`` within its bounds, ``linear`` leaves it.

    Parameters
    ----------
    kinds : tuple of {"log", "linear", "interval"}
    lower, upper : (n_params,) float arrays
        Bounds; used by ``interval``.
    """

    kinds: tuple[Transform, ...]
    lower: FloatArray
    upper: FloatArray

    def at(self, index: Sequence[int] | IntArray) -> Transforms:
        """Transforms of the parameters at `index` (n,), in that order."""
        chosen = np.asarray(index, dtype=np.intp)
        kinds = tuple(self.kinds[i] for i in chosen.tolist())
        return Transforms(kinds, locked(self.lower[chosen]), locked(self.upper[chosen]))

    def followed_by(self, other: Transforms) -> Transforms:
        """These transforms, then those of `other`."""
        lower, upper = (np.concatenate(pair) for pair in ((self.lower, other.lower), (self.upper, other.upper)))
        return Transforms(self.kinds + other.kinds, locked(lower), locked(upper))

    @cached_property
    def _masks(self) -> tuple[np.ndarray, np.ndarray]:
        """Masks (n_params,) of the parameters of kind ``log``, and of those of kind ``interval``."""
        kinds = np.array(self.kinds, dtype=object)
        return kinds == "log", kinds == "interval"

    def physical(self, theta: FloatArray) -> FloatArray:
        """Parameters in physical units, (n_params,), from the free variables `theta`, (n_params,).

        A bounded parameter is strictly inside its bounds, also where rounding would put it on one.
        """
        log, interval = self._masks
        values = np.array(theta, dtype=np.float64)
        values[log] = np.exp(values[log])
        low, high = self.lower[interval], self.upper[interval]
        inside = low + (high - low) * special.expit(theta[interval])
        values[interval] = np.clip(inside, np.nextafter(low, high), np.nextafter(high, low))
        return values

    def slope(self, theta: FloatArray) -> FloatArray:
        """Derivative of each physical parameter by its free variable at `theta` (n_params,), (n_params,)."""
        log, interval = self._masks
        slope = np.ones(len(theta))
        slope[log] = np.exp(theta[log])
        part = special.expit(theta[interval]) * special.expit(-theta[interval])
        slope[interval] = (self.upper[interval] - self.lower[interval]) * part
        return slope

    def free(self, values: FloatArray) -> FloatArray:
        """Free variables (n_params,) from `values` (n_params,) in physical units, strictly within their ranges.

        They are the logarithm of a positive parameter, the logit of its position between two bounds, or the value
        itself.
        """
        log, interval = self._masks
        theta = np.array(values, dtype=np.float64)
        theta[log] = np.log(theta[log])
        part = (theta[interval] - self.lower[interval]) / (self.upper[interval] - self.lower[interval])
        theta[interval] = np.log(part / (1 - part))
        return theta

    @property
    def bounds(self) -> FloatArray:
        """Lower and upper bound of each, (n_params, 2); infinite where it has none."""
        bounded = self._masks[1][:, None]
        return np.where(bounded, np.stack([self.lower, self.upper], axis=1), [-np.inf, np.inf])

    def reach(self, values: FloatArray, sizes: FloatArray) -> FloatArray:
        """Lowest and highest free variable that a search from the physical `values` may reach, (n_params, 2).

        A positive parameter stays within a factor of a million, an unlimited one within a million times its `sizes`
        (n_params,) (no limit where that is 0), and a bounded one as close to its bounds as rounding allows.
        """
        log, interval = self._masks
        far = np.where(log, np.log(FARTHEST), np.where(interval, _FARTHEST_LOGIT, FARTHEST * sizes))
        far, free = np.where(far > 0, far, np.inf), self.free(values)
        return np.stack([free - far, free + far], axis=1)


N = TypeVar("N", bound="NamedUnknowns")

#: Kinds of parameters that are damping, linear in the motion.
DAMPING = ("viscous_damping", "loss_factor", "damping_ratio")
#: Kinds of positive parameters that may be absent.
MAY_VANISH = (*DAMPING, "friction")


@dataclass(frozen=True, eq=False)
class NamedUnknowns:
    """Named unknowns, one entry each.

    Attributes
    ----------
    names, kinds, units : tuple of str
        Such as ``mass[plate 2]``, ``mass``, ``kg``.
    start : (n_params,) float array
        Initial physical values.
    transforms : Transforms
        How each is kept in its range.
    priors : Priors
        What is known of each alone.
    scale : (n_params,) float array
        Size that a standard deviation is held against even where the value is smaller, as for a delay, or the initial value
        of what may be negative; 0 for most.
    couplings : tuple of Coupling
        What is known of several of them together: correlated priors, smoothness, sparsity.
    free_prior : ((n_params,) array, (n_params,) array), optional
        Gaussian prior on the free variables besides: mean and standard deviation, NaN where there is none. It holds
        what the data of an easier form of a problem do not say.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    units: tuple[str, ...]
    start: FloatArray
    transforms: Transforms
    priors: Priors
    scale: FloatArray
    couplings: tuple[Coupling, ...] = field(default=(), kw_only=True)
    free_prior: tuple[FloatArray, FloatArray] | None = field(default=None, kw_only=True)

    @property
    def n_params(self) -> int:
        return len(self.names)

    @property
    def theta_start(self) -> FloatArray:
        """Free variables (n_params,) of the initial values."""
        return self.transforms.free(self.start)

    def physical(self, theta: FloatArray) -> FloatArray:
        """Values in physical units, (n_params,), at the free variables `theta`, (n_params,)."""
        return self.transforms.physical(theta)

    def slope(self, theta: FloatArray) -> FloatArray:
        """Derivative of each physical value with respect to its free variable, (n_params,)."""
        return self.transforms.slope(theta)

    @property
    def bounds(self) -> FloatArray:
        """Lower and upper bound of each physical value, (n_params, 2)."""
        return self.transforms.bounds

    def sizes(self, physical: FloatArray) -> FloatArray:
        """Sizes (n_params,) that standard deviations are compared with: the larger of the absolute value and `scale`."""
        return np.maximum(np.abs(physical), self.scale)

    @property
    def reach(self) -> FloatArray:
        """Free variables between which a search stays, (n_params, 2); see `Transforms.reach`."""
        return self.transforms.reach(self.start, self.sizes(self.start))

    def prior_rows(self, physical: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Whitened residual (n_rows,) of priors and couplings at `physical`, and dense derivative (n_rows, n_params).

        One row for each parameter with a prior, then the rows of the couplings; priors on free variables are not
        included. `physical` (n_params,) are the parameters in physical units, and the derivative is by these.
        """
        rows, residual, slope = self.priors.entries(physical)
        jacobian = np.zeros((len(rows), len(physical)))
        jacobian[np.arange(len(rows)), rows] = slope
        parts = [(residual, jacobian), *(coupling.rows(physical) for coupling in self.couplings)]
        return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])

    def prior_residual(self, physical: FloatArray) -> FloatArray:
        """The residual of `prior_rows` alone, (n_rows,)."""
        residual = self.priors.entries(physical)[1]
        return np.concatenate([residual, *(coupling.residual(physical) for coupling in self.couplings)])

    def sparse_prior_rows(self, physical: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        """Whitened residual (n_rows,) of priors and couplings at `physical`, and sparse derivative (n_rows, n_params).

        One row for each parameter with a prior, then the rows of the couplings; priors on free variables are not
        included. `physical` (n_params,) are the parameters in physical units, and the derivative is by these.
        """
        rows, residual, slope = self.priors.entries(physical)
        jacobian = sparse.csr_array((slope, (np.arange(len(rows)), rows)), (len(rows), self.n_params))
        parts = [(residual, jacobian), *(coupling.sparse_rows(physical) for coupling in self.couplings)]
        return np.concatenate([part[0] for part in parts]), sparse.csr_array(sparse.vstack([p[1] for p in parts]))

    def started_at(self, physical: FloatArray) -> Self:
        """A copy with the initial values `physical`, (n_params,), in physical units.

        Raises
        ------
        InputError
            If a value does not lie strictly within its range.
        """
        require_shape("physical", np.asarray(physical), (self.n_params,), "one value a parameter")
        outside = ~((self.transforms.lower < physical) & (physical < self.transforms.upper))
        if outside.any():
            k = int(np.argmax(outside))
            low, high = self.transforms.lower[k], self.transforms.upper[k]
            raise InputError(
                f"initial value of {self.names[k]} must lie between {low:g} and {high:g}, got {physical[k]:g}; give"
                " `start`, or another value of the element set"
            )
        return replace(self, start=locked(physical, np.float64))

    def kept_near_start(self, relative: float) -> Self:
        """A copy in which each parameter without a prior gets a Gaussian one with the mean at its start.

        Its standard deviation is `relative` times the parameter's size at the start; parameters of size 0 get none.
        """
        width = relative * self.sizes(self.start)
        free, priors = ~self.priors.stated & (width > 0), self.priors
        mean, std = np.where(free, self.start, priors.mean), np.where(free, width, priors.std)
        return replace(self, priors=Priors(mean, std, priors.lognormal))


def begun_at(unknowns: N, values: Mapping[str, float]) -> N:
    """A copy that starts at `values` (by name) where these lie within the range; other starts stay."""
    start = np.array([values.get(name, initial) for name, initial in zip(unknowns.names, unknowns.start, strict=True)])
    inside = (start > unknowns.transforms.lower) & (start < unknowns.transforms.upper)
    return unknowns.started_at(np.where(inside, start, unknowns.start))


def join_unknowns(first: NamedUnknowns, second: NamedUnknowns) -> NamedUnknowns:
    """The unknowns of `first` followed by those of `second`, as one set, with the priors and couplings of both.

    Couplings are extended to all unknowns; priors on free variables are NaN for a set that has none.
    """

    def both(one: FloatArray, other: FloatArray) -> FloatArray:
        return np.concatenate([one, other])

    n = first.n_params + second.n_params
    regularized = [u.free_prior or (np.full(u.n_params, np.nan),) * 2 for u in (first, second)]
    couplings = [c.among(n, 0) for c in first.couplings] + [c.among(n, first.n_params) for c in second.couplings]
    return NamedUnknowns(
        names=first.names + second.names,
        kinds=first.kinds + second.kinds,
        units=first.units + second.units,
        start=both(first.start, second.start),
        transforms=first.transforms.followed_by(second.transforms),
        priors=first.priors.followed_by(second.priors),
        scale=both(first.scale, second.scale),
        couplings=tuple(couplings),
        free_prior=(both(regularized[0][0], regularized[1][0]), both(regularized[0][1], regularized[1][1])),
    )
