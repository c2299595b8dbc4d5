"""Draws of every kind of interval for ArviZ's plots and tables."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import InputError
from structid.inversion.intervals.sampling import WITH_EXTRA

if TYPE_CHECKING:
    from arviz import InferenceData


class Drawn(Protocol):
    """Sources of draws: an `Estimate` (its Laplace interval), a `Profile`, a `Bootstrap`, `Samples`."""

    @property
    def names(self) -> tuple[str, ...]: ...

    def drawn(self, n_draws: int, rng: np.random.Generator) -> FloatArray:
        """Draws in physical units, (n_chains, n_draws, n_params)."""
        ...


def to_arviz(found: Drawn, n_draws: int = 4000, seed: int = 0) -> InferenceData:
    """Posterior draws as ``arviz.InferenceData``, one variable for each parameter.

    Parameters
    ----------
    found : Estimate, Profile, Bootstrap or Samples
        Of an estimate, draws from the normal distribution of the free variables that its intervals are of; of a profile,
        from the distribution whose quantiles are the ends of its intervals at all levels; of a bootstrap, its replicates; of
        samples, their chains.
    n_draws : int
        Of estimates and profiles; the others have as many as they have.
    seed : int

    Raises
    ------
    InputError
        If ArviZ, of the extra ``sampling``, is missing, or a profile has no limit on a side.
    """
    try:
        import arviz
    except ImportError as error:
        raise InputError(f"`arviz` must be installed to export draws, got {error}; {WITH_EXTRA}") from error
    draws = found.drawn(n_draws, np.random.default_rng(seed))
    return arviz.from_dict(posterior={name: draws[:, :, j] for j, name in enumerate(found.names)})
