"""Records that a structure with known parameters would give: twins to prove a method on before a test."""

from __future__ import annotations

from dataclasses import replace
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike

from structid.core.errors import InputError, require_class
from structid.fem import Structure
from structid.forward.frf.response import response
from structid.forward.time.options import TimeOptions
from structid.forward.time.output_error import declared_variance, time_model
from structid.records import FrfRecord, TimeRecord
from structid.records.record import LOADS
from structid.unknowns import Parameters

_RNG_MADE_BY = "noise is drawn by a numpy Generator, as np.random.default_rng(1) is one"


def simulated_record(
    structure: Structure,
    unknown: Parameters,
    like: FrfRecord,
    relative_noise: float = 0.0,
    rng: np.random.Generator | None = None,
) -> FrfRecord:
    """The FRFs of `structure` at the lines, sensors and loads of `like`, with Gaussian noise.

    Parameters
    ----------
    structure : Structure
    unknown : Parameters
        Their initial values are the truth.
    like : FrfRecord
        Gives lines, sensors, loads and kind.
    relative_noise : float
        Standard deviation of the complex noise as a part of each value's magnitude.
    rng : numpy Generator, optional
        Needed for noise.

    Returns
    -------
    FrfRecord
        In the kind and unit of `like`; its variance E|noise|^2 is that of the noise that was added, None without noise.

    Raises
    ------
    InputError
        If an argument is of another class, `relative_noise` is negative, or noise is asked for without `rng`.
    """
    _require_parts(structure, unknown)
    require_class("like", like, FrfRecord, "make it by `FrfRecord`, with any values at its lines, sensors and loads")
    if not isinstance(relative_noise, Real) or not 0 <= float(relative_noise) < np.inf:
        raise InputError(f"`relative_noise` must be a finite number of at least 0, got {relative_noise!r}; 0.01 is 1 %")
    if relative_noise > 0 or rng is not None:
        require_class("rng", rng, np.random.Generator, _RNG_MADE_BY)
    record = replace(like, variance=None, coherence=None, averages=None, source="simulated")
    record = replace(record, values=response(structure, unknown, record).values_at(unknown.start))
    if rng is None or relative_noise == 0:
        return record
    size = relative_noise * np.abs(record.values)
    noise = rng.standard_normal(size.shape) + 1j * rng.standard_normal(size.shape)
    return replace(record, values=record.values + size * noise / np.sqrt(2), variance=size**2, noise_source="declared")


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
        Hold of the force between samples, and state before the first sample.
    rng : numpy Generator, optional
        Adds noise of the variance of `like` to all channels, forces included; no noise by default.
    initial : (2 n_dofs,) array, optional
        Displacement and then velocity at the first sample; rest by default.

    Returns
    -------
    TimeRecord
        `like` with the simulated readings in its motion channels, in their units.

    Raises
    ------
    InputError
        If the model has no time-domain equation or more than 200 free degrees of freedom, force or start do not suit
        it, or noise is asked for without a variance.
    """
    _require_parts(structure, unknown)
    require_class("like", like, TimeRecord, "make it by `TimeRecord`, with its forces and any motion")
    if rng is not None:
        require_class("rng", rng, np.random.Generator, _RNG_MADE_BY)
    chosen = replace(options or TimeOptions(), quantities=("displacement", "velocity", "acceleration"))
    model = time_model(structure, unknown, like, chosen)
    moved = [i for i, q in enumerate(like.quantities) if q not in LOADS]
    loads = [i for i, q in enumerate(like.quantities) if q in LOADS]
    force = model.drive.force_values(like.values[:, loads])
    start = None if initial is None else np.asarray(initial, dtype=np.float64)
    values = np.array(like.values)
    values[:, moved] = model.readings(unknown.start, force, start, len(values))
    if rng is not None:
        values += np.sqrt(declared_variance(like)) * rng.standard_normal(values.shape)
    return replace(like, values=values, source="simulated")


def _require_parts(structure: object, unknown: object) -> None:
    """Raise `InputError` unless these are a `Structure` and its `Parameters`."""
    require_class("structure", structure, Structure, "make it by `Structure(nodes, elements, fixed)`")
    require_class("unknown", unknown, Parameters, "make it by `parameters(structure, unknowns)`")
