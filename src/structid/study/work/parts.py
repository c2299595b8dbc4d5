"""What tasks share, as bytes for other processes: small, because what a worker can make itself is only named."""

from __future__ import annotations

import hashlib
import inspect
import io
import pickle
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from structid._version import __version__
from structid.errors import InputError, StructidError

_KEPT = 4


class PackageMissingError(StructidError):
    """A worker that came later has not got what the tasks share; it must be given to all of them again."""


#: What was given to this worker before its tasks, by digest; for all of its threads.
_GIVEN: dict[str, bytes] = {}


@dataclass(frozen=True)
class StudyPlace:
    """Where a worker finds the study.

    Attributes
    ----------
    path : str
        Of the study file, absolute.
    inputs : tuple of (str, str)
        Names and SHA-256 of the study file and all files that it names.
    """

    path: str
    inputs: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Package:
    """What tasks share, on its way to a worker.

    Attributes
    ----------
    content : bytes
    digest : str
        SHA-256 of all of it; a worker unpacks the same package once.
    place : StudyPlace or None
        None where nothing is left out.
    version : str
        Of structid that packed it.
    """

    content: bytes
    digest: str
    place: StudyPlace | None
    version: str


def packed(shared: Any, place: StudyPlace | None = None, parts: Sequence[object] = ()) -> Package:
    """`shared` as bytes, without what is cached in it, and with `parts` of the study by their number only.

    Parameters
    ----------
    shared : object
    place : StudyPlace, optional
        The study that the parts belong to; without it everything is packed.
    parts : sequence of object
        What `study_parts` gives of that study.
    """
    stream = io.BytesIO()
    _Packer(stream, parts if place is not None else ()).dump(shared)
    content = stream.getvalue()
    digest = hashlib.sha256(repr(place).encode() + content).hexdigest()
    return Package(content, digest, place, __version__)


def unpacked(package: Package) -> Any:
    """What was packed; each thread of a worker has its own, since factorizations are not shared.

    Raises
    ------
    PackageMissingError
        If the content is left out of `package` and was not `given`.
    InputError
        If this process runs another version of structid, or the study it finds is another one.
    """
    if package.version != __version__:
        raise InputError(
            f"the worker has structid {__version__}, the tasks come from {package.version}; install the same version"
        )
    known: dict[str, Any] = _memory().setdefault("shared", {})
    if package.digest not in known:
        content = package.content or _GIVEN.get(package.digest, b"")
        if not content:
            raise PackageMissingError(f"the package {package.digest[:12]} is not here")
        parts = () if package.place is None else _parts_at(package.place)
        while len(known) >= _KEPT:
            del known[next(iter(known))]
        known[package.digest] = _Unpacker(io.BytesIO(content), parts).load()
    return known[package.digest]


def given(package: Package) -> str:
    """Keep the content of a package for tasks whose package leaves it out; its digest, in answer."""
    while len(_GIVEN) >= _KEPT and package.digest not in _GIVEN:
        del _GIVEN[next(iter(_GIVEN))]
    _GIVEN[package.digest] = package.content
    return package.digest


def is_known(digest: str) -> bool:
    """Whether this thread has unpacked the package before."""
    return digest in _memory().get("shared", {})


_LOCAL = threading.local()


def _memory() -> dict[str, Any]:
    """What this thread of this worker keeps from task to task."""
    if not hasattr(_LOCAL, "memory"):
        _LOCAL.memory = {}
    memory: dict[str, Any] = _LOCAL.memory
    return memory


def _parts_at(place: StudyPlace) -> tuple[object, ...]:
    known: dict[StudyPlace, tuple[object, ...]] = _memory().setdefault("parts", {})
    if place not in known:
        from structid.study.run.run import load_study, study_parts

        study = load_study(Path(place.path))
        require_same(place.path, dict(place.inputs), study.digests)
        parts = study_parts(study)
        known.clear()
        known[place] = parts
    return known[place]


def require_same(path: str, wanted: Mapping[str, str], found: Mapping[str, str]) -> None:
    """Refuse a study with other files.

    Raises
    ------
    InputError
        If a file is missing or has another content.
    """
    for name in sorted({*wanted, *found}):
        if wanted.get(name) != found.get(name):
            raise InputError(
                f"{path}: {name} is not the file that the tasks were made from; give workers the same files"
            )


class _Packer(pickle.Pickler):
    """Leaves out what cached properties hold (analyses of factorizers cannot travel), and names the parts."""

    def __init__(self, stream: io.BytesIO, parts: Sequence[object]) -> None:
        super().__init__(stream, protocol=5)
        self._places = {id(part): number for number, part in enumerate(parts)}

    def persistent_id(self, obj: Any) -> int | None:
        return self._places.get(id(obj))

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, type) or not hasattr(type(obj), "__dataclass_fields__") or not hasattr(obj, "__dict__"):
            return NotImplemented
        cached = [name for name in vars(obj) if _is_cached(type(obj), name)]
        if not cached:
            return NotImplemented
        return _made, (type(obj), {name: value for name, value in vars(obj).items() if name not in cached})


def _is_cached(kind: type, name: str) -> bool:
    return isinstance(inspect.getattr_static(kind, name, None), cached_property)


def _made(kind: type, values: dict[str, Any]) -> Any:
    """An instance with these attributes, as it was before anything was cached in it."""
    made: Any = object.__new__(kind)
    vars(made).update(values)
    return made


class _Unpacker(pickle.Unpickler):
    def __init__(self, stream: io.BytesIO, parts: Sequence[object]) -> None:
        super().__init__(stream)
        self._parts = parts

    def persistent_load(self, pid: Any) -> Any:
        return self._parts[pid]
