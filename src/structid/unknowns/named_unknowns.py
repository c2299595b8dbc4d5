"""Unknowns with what an estimator needs of each: a name, a start, a range and what is known of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from structid.arrays import FloatArray, locked, require_shape
from structid.errors import InputError
from structid.unknowns.priors import prior_rows
from structid.unknowns.transforms import Transforms

#: Mean, standard deviation and whether it is log-normal, of a prior.
StatedPrior = tuple[float, float, bool]


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
    prior_mean, prior_std : (n_params,) float arrays
        Prior in physical units; NaN where there is none.
    prior_lognormal : (n_params,) bool array
        Whether the prior is log-normal instead of Gaussian.
    scale : (n_params,) float array
        Size that a standard deviation is held against even where the value is smaller, as for a delay; 0 for most.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    units: tuple[str, ...]
    start: FloatArray
    transforms: Transforms
    prior_mean: FloatArray
    prior_std: FloatArray
    prior_lognormal: np.ndarray
    scale: FloatArray

    @property
    def n_params(self) -> int:
        return len(self.names)

    @property
    def theta_start(self) -> FloatArray:
        """Free variables of the initial values."""
        return self.transforms.free(self.start)

    def sizes(self, physical: FloatArray) -> FloatArray:
        """What the standard deviation of each is held against, (n_params,)."""
        return np.maximum(np.abs(physical), self.scale)

    def prior_rows(self, physical: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Whitened residual of the priors and its derivative with respect to the physical values."""
        return prior_rows(physical, self.prior_mean, self.prior_std, self.prior_lognormal)

    def stated_prior(self, index: int) -> StatedPrior | None:
        """The prior of the unknown at `index`; None where there is none."""
        mean, std = float(self.prior_mean[index]), float(self.prior_std[index])
        return (mean, std, bool(self.prior_lognormal[index])) if np.isfinite(std) else None

    def started_at(self, physical: FloatArray) -> Self:
        """The same with other initial values."""
        require_shape("physical", np.asarray(physical), (self.n_params,), "one value a parameter")
        outside = ~((self.transforms.lower < physical) & (physical < self.transforms.upper))
        if outside.any():
            k = int(np.argmax(outside))
            low, high = self.transforms.lower[k], self.transforms.upper[k]
            raise InputError(
                f"initial value of {self.names[k]} must lie between {low:g} and {high:g}, got {physical[k]:g}"
            )
        return replace(self, start=locked(physical, np.float64))

    def kept_near_start(self, relative: float) -> Self:
        """The same, each without a prior drawn to its start by one of `relative` of its size as standard deviation."""
        width = relative * self.sizes(self.start)
        free = ~np.isfinite(self.prior_std) & (width > 0)
        mean, std = np.where(free, self.start, self.prior_mean), np.where(free, width, self.prior_std)
        return replace(self, prior_mean=locked(mean), prior_std=locked(std))

    def shared(self, first: Mapping[str, tuple[NamedUnknowns, int]], priors: Mapping[str, StatedPrior]) -> Self:
        """The same with start and scale of each as the unknowns that `first` names by it, and with these `priors`."""
        if not self.names:
            return self
        origin = [first[name] for name in self.names]
        mean, std, lognormal = zip(*(priors.get(name, (np.nan, np.nan, False)) for name in self.names), strict=True)
        return replace(
            self,
            start=locked([unknowns.start[i] for unknowns, i in origin], float),
            scale=locked([unknowns.scale[i] for unknowns, i in origin], float),
            prior_mean=locked(mean, float),
            prior_std=locked(std, float),
            prior_lognormal=locked(lognormal, bool),
        )


def joined(first: NamedUnknowns, second: NamedUnknowns) -> NamedUnknowns:
    """Those of both, one after the other."""
    one, other = first.transforms, second.transforms
    return NamedUnknowns(
        names=first.names + second.names,
        kinds=first.kinds + second.kinds,
        units=first.units + second.units,
        start=np.concatenate([first.start, second.start]),
        transforms=Transforms(
            one.kinds + other.kinds,
            np.concatenate([one.lower, other.lower]),
            np.concatenate([one.upper, other.upper]),
        ),
        prior_mean=np.concatenate([first.prior_mean, second.prior_mean]),
        prior_std=np.concatenate([first.prior_std, second.prior_std]),
        prior_lognormal=np.concatenate([first.prior_lognormal, second.prior_lognormal]),
        scale=np.concatenate([first.scale, second.scale]),
    )
