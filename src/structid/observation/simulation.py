"""A record that a structure with known parameters would give: a twin to prove a method on before a test."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from structid.arrays import FloatArray
from structid.errors import InputError
from structid.observation.response import response, sliding_amplitudes
from structid.parameters import Parameters
from structid.records import FrfRecord
from structid.structure import Friction, Structure

_MOST_ITERATIONS = 2000


def simulated_record(
    structure: Structure,
    unknown: Parameters,
    like: FrfRecord,
    relative_noise: float = 0.0,
    rng: np.random.Generator | None = None,
) -> FrfRecord:
    """The FRFs of `structure` at the lines, sensors and loads of `like`, with Gaussian noise.

    Friction elements slide with the amplitude of the simulated motion itself (harmonic balance).

    Parameters
    ----------
    structure : Structure
    unknown : Parameters
        Their initial values are the truth.
    like : FrfRecord
        Gives lines, sensors, loads and kind; where there is friction its values start the harmonic balance.
    relative_noise : float
        Standard deviation of the complex noise as a part of each value's magnitude.
    rng : numpy Generator
        Needed for noise.

    Returns
    -------
    FrfRecord
        With its variance, that of the noise that was added, where there is noise.

    Raises
    ------
    InputError
        If noise is asked for without `rng`, or the harmonic balance does not settle (the friction sticks).
    """
    record = replace(like, variance=None, coherence=None, averages=None, source="simulated")
    record = replace(record, values=_balanced(structure, unknown, record))
    if relative_noise == 0:
        return record
    if rng is None:
        raise InputError("`rng` must be a numpy Generator where noise is asked for, got None")
    size = relative_noise * np.abs(record.values)
    noise = rng.standard_normal(size.shape) + 1j * rng.standard_normal(size.shape)
    return replace(
        record, values=record.values + size * noise / np.sqrt(2), variance=size**2, noise_source="declared"
    )


def _balanced(structure: Structure, unknown: Parameters, record: FrfRecord) -> np.ndarray:
    """FRFs whose own motion gives the sliding amplitudes."""
    if not any(isinstance(element, Friction) for element in structure.elements):
        return response(structure, unknown, record, {}).values_at(unknown.start)
    sliding = sliding_amplitudes(structure, record)
    for _ in range(_MOST_ITERATIONS):
        values = response(structure, unknown, record, sliding).values_at(unknown.start)
        found = sliding_amplitudes(structure, replace(record, values=values))
        change = max(float(np.abs(np.log(found[name] / sliding[name])).max()) for name in sliding)
        if change < 1e-10:
            return values
        sliding = {name: _geometric_mean(sliding[name], found[name]) for name in sliding}
    raise InputError(
        f"the friction does not settle: sliding amplitudes still change by {change:.2g}; lower `friction_force`,"
        " which must stay below the drive that reaches the sliding surface"
    )


def _geometric_mean(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.sqrt(a * b)
