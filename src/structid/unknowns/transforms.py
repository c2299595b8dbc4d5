"""Maps between a physical parameter and the free variable that an estimator moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray, IntArray, locked

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
