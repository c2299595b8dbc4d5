"""Maps between a physical parameter and the free variable that an estimator moves."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from structid.arrays import FloatArray

Transform = Literal["log", "linear", "interval"]


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

    @cached_property
    def _masks(self) -> tuple[np.ndarray, np.ndarray]:
        """Which parameters are of kind ``log``, and of ``interval``."""
        kinds = np.array(self.kinds, dtype=object)
        return kinds == "log", kinds == "interval"

    def physical(self, theta: FloatArray) -> FloatArray:
        """Physical values of the free variables `theta`."""
        log, interval = self._masks
        values = np.array(theta, dtype=np.float64)
        values[log] = np.exp(values[log])
        span = self.upper[interval] - self.lower[interval]
        values[interval] = self.lower[interval] + span * _logistic(theta[interval])
        return values

    def slope(self, theta: FloatArray) -> FloatArray:
        """Derivative of the physical value with respect to the free variable."""
        log, interval = self._masks
        slope = np.ones(len(theta))
        slope[log] = np.exp(theta[log])
        part = _logistic(theta[interval])
        slope[interval] = (self.upper[interval] - self.lower[interval]) * part * (1 - part)
        return slope

    def free(self, values: FloatArray) -> FloatArray:
        """Free variables of physical `values`."""
        log, interval = self._masks
        theta = np.array(values, dtype=np.float64)
        theta[log] = np.log(theta[log])
        part = (theta[interval] - self.lower[interval]) / (self.upper[interval] - self.lower[interval])
        theta[interval] = np.log(part / (1 - part))
        return theta


def _logistic(x: FloatArray) -> FloatArray:
    return 0.5 * (1 + np.tanh(0.5 * x))
