"""A record that a structure with known parameters would give: a twin to prove a method on before a test."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from structid.core.errors import InputError
from structid.fem import Structure
from structid.forward.frf.response import response
from structid.records import FrfRecord
from structid.unknowns import Parameters


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
    rng : numpy Generator
        Needed for noise.

    Returns
    -------
    FrfRecord
        With its variance, that of the noise that was added, where there is noise.

    Raises
    ------
    InputError
        If noise is asked for without `rng`.
    """
    record = replace(like, variance=None, coherence=None, averages=None, source="simulated")
    record = replace(record, values=response(structure, unknown, record).values_at(unknown.start))
    if relative_noise == 0:
        return record
    if rng is None:
        raise InputError("`rng` must be a numpy Generator where noise is asked for, got None")
    size = relative_noise * np.abs(record.values)
    noise = rng.standard_normal(size.shape) + 1j * rng.standard_normal(size.shape)
    return replace(record, values=record.values + size * noise / np.sqrt(2), variance=size**2, noise_source="declared")
