"""What one run of a study gives, complete when constructed; files and reports are made from it."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from structid._version import __version__
from structid.arrays import FloatArray
from structid.dynamics.receptance import factorizer_words
from structid.study.identification import Identification
from structid.study.study import Study


@dataclass(frozen=True)
class Provenance:
    """What an answer was made from; the same input gives the same provenance, on any day and in any folder.

    Attributes
    ----------
    structid, numpy, scipy, python : str
        Versions.
    inputs : mapping of str to str
        SHA-256 of every input file, by the name that the study gives it.
    seed : int or None
        Of the starts that are tried where a fit misses the noise; None where none may be.
    settings : mapping
        The ``[method]`` of the study with its defaults filled in.
    factorizer : str
        What solves for the response of the model; empty where there is no model.
    """

    structid: str
    numpy: str
    scipy: str
    python: str
    inputs: Mapping[str, str]
    seed: int | None
    settings: Mapping[str, Any]
    factorizer: str = ""


@dataclass(frozen=True, eq=False)
class StudyResult:
    """A study, what was identified, and from what.

    Attributes
    ----------
    study : Study
    identification : Identification
    provenance : Provenance
    """

    study: Study
    identification: Identification
    provenance: Provenance


def provenance(study: Study) -> Provenance:
    """Versions, digests of the study's input files as they were when it was read, and its settings."""
    return Provenance(
        structid=__version__,
        numpy=np.__version__,
        scipy=scipy.__version__,
        python=platform.python_version(),
        inputs=dict(study.digests),
        seed=study.options.seed if study.options.restarts or study.options.uniqueness_starts else None,
        settings=study.settings,
        factorizer=factorizer_words(max(source.structure.n_dofs for source in study.setups)),
    )


def correlation(covariance: FloatArray) -> FloatArray:
    """Correlation matrix of a covariance; NaN where that is NaN or a variance is 0."""
    std = np.sqrt(np.diag(covariance))
    scale = np.outer(std, std)
    return np.divide(covariance, scale, out=np.full_like(scale, np.nan), where=scale > 0)
