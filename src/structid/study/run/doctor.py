"""State of this installation: versions, factorizers, threads and memory."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

from structid._version import __version__
from structid.study.run.resources import available_bytes

#: Packages that are not required, and what they are for.
OPTIONAL = {
    "numba": "time histories in one pass (extra `fast`)",
    "mkl": "the PARDISO factorizer (extra `pardiso`)",
    "dask": "clusters (extra `cluster`)",
    "distributed": "clusters (extra `cluster`)",
    "meshio": "VTK mesh files (extra `mesh`)",
    "npTDMS": "TDMS files (extra `tdms`)",
    "asammdf": "MDF files (extra `mdf`)",
    "obspy": "miniSEED files (extra `miniseed`)",
    "pyarrow": "Parquet files (extra `parquet`)",
    "emcee": "sampling (extra `sampling`)",
    "ansys-mapdl-reader": "Ansys files (extra `ansys`)",
}
_REQUIRED = ("numpy", "scipy", "h5py", "matplotlib", "psutil", "threadpoolctl")


@dataclass(frozen=True)
class Installation:
    """State of the installation: versions, libraries and extras.

    Attributes
    ----------
    structid, python, system : str
    required, optional : mapping of str to str
        Version of each package; empty where an optional one is not installed.
    factorizers : tuple of str
        With their versions, the one in use first.
    blas : tuple of str
        Libraries of linear algebra with their threads.
    processors : int
        That this process may use.
    free_bytes : int
        Memory that it may still take.
    """

    structid: str
    python: str
    system: str
    required: dict[str, str]
    optional: dict[str, str]
    factorizers: tuple[str, ...]
    blas: tuple[str, ...]
    processors: int
    free_bytes: int


def installation() -> Installation:
    """Versions, factorizers (the default first), BLAS threads, processors and free memory (bytes) of this installation."""
    from threadpoolctl import threadpool_info

    from structid.dynamics.factorization import factorizer, installed_factorizers

    default = factorizer().name
    names = sorted(installed_factorizers(), key=lambda name: name != default)
    blas = tuple(
        f"{pool['internal_api']} {pool['version'] or ''}".strip() + f", {pool['num_threads']} threads"
        for pool in threadpool_info()
    )
    allowed = getattr(os, "sched_getaffinity", None)
    return Installation(
        structid=__version__,
        python=platform.python_version(),
        system=f"{platform.system()} {platform.machine()}",
        required={name: _version(name) for name in _REQUIRED},
        optional={name: _version(name) for name in OPTIONAL},
        factorizers=tuple(factorizer(name).words for name in names),
        blas=tuple(dict.fromkeys(blas)),
        processors=len(allowed(0)) if allowed is not None else os.cpu_count() or 1,
        free_bytes=available_bytes(),
    )


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""
