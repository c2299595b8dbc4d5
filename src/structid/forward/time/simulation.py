"""A time record that a structure with known parameters would give: a twin to prove a method on before a test."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from structid.fem import Structure
from structid.forward.time.options import TimeOptions
from structid.forward.time.problem import declared_variance, time_model
from structid.records import TimeRecord
from structid.records.record import LOADS
from structid.unknowns import Parameters


def simulated_time_record(
    structure: Structure,
    unknown: Parameters,
    like: TimeRecord,
    options: TimeOptions | None = None,
    rng: np.random.Generator | None = None,
    initial: ArrayLike | None = None,
) -> TimeRecord:
    """The motion of `structure` at the samples and sensors of `like`, under its forces, with Gaussian noise.

    Parameters
    ----------
    structure : Structure
    unknown : Parameters
        Their initial values are the truth.
    like : TimeRecord
        Gives samples, channels, forces and, for noise, the variance of each channel.
    options : TimeOptions, optional
        What the force does between samples, and until when there was rest.
    rng : numpy Generator, optional
        Adds noise of the variance of `like` to all channels, forces included; no noise by default.
    initial : (2 n_dofs,) array, optional
        Displacement and then velocity at the first sample; rest by default.

    Raises
    ------
    InputError
        As `identify_time`, and if noise is asked for without a variance.
    """
    chosen = replace(options or TimeOptions(), quantities=("displacement", "velocity", "acceleration"))
    model = time_model(structure, unknown, like, chosen)
    moved = [i for i, q in enumerate(like.quantities) if q not in LOADS]
    loads = [i for i, q in enumerate(like.quantities) if q in LOADS]
    force = model.drive.known(like.values[:, loads])
    start = None if initial is None else np.asarray(initial, dtype=np.float64)
    values = np.array(like.values)
    values[:, moved] = model.readings(unknown.start, force, start, len(values))
    if rng is not None:
        values += np.sqrt(declared_variance(like)) * rng.standard_normal(values.shape)
    return replace(like, values=values, source="simulated")
