"""Provenance of an answer: versions, digests of the input files, and settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Provenance:
    """Versions and input files that an answer was made from; the same input gives the same, on any day, in any folder.

    Attributes
    ----------
    structid, numpy, scipy, python : str
        Versions.
    inputs : mapping of str to str
        SHA-256 of every input file, by the name that the study gives it.
    seed : int or None
        Seed of the random starts that are tried where a fit misses the noise; None if there are none.
    settings : mapping
        The ``[method]`` of the study with its defaults filled in.
    factorizer : str
        Factorizer of the equations for the response of the model; empty without a model.
    """

    structid: str
    numpy: str
    scipy: str
    python: str
    inputs: Mapping[str, str]
    seed: int | None
    settings: Mapping[str, Any]
    factorizer: str = ""
