"""Public names, file formats and entries of registries load on first use (PEP 562): a run loads only what it needs."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

T = TypeVar("T")


def lazy(
    package: str, file: str, gone: Mapping[str, str] = MappingProxyType({})
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a package from its stub, which type checkers read as well.

    Public names are imported at their first use, submodules too.

    Parameters
    ----------
    package, file : str
        `__name__` and `__file__` of the package. Beside the file is its stub (.pyi), with one line ``from module import
        name as name`` for every public name.
    gone : mapping of str to str
        What takes the place of names that were public once; their use is an `ImportError` that says it.
    """
    stub = ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    module_of = {alias.name: str(node.module) for node in imports for alias in node.names}
    names = sorted(module_of)

    def load(name: str) -> Any:
        """The public object or submodule `name` of the package, imported at its first use.

        `ImportError`, which says what to use, for a name that is gone; `AttributeError` if there is none.
        """
        if name in module_of:
            value = getattr(import_module(module_of[name]), name)
            setattr(sys.modules[package], name, value)
            return value
        if not name.startswith("_") and find_spec(f"{package}.{name}") is not None:
            return import_module(f"{package}.{name}")
        if name in gone:
            raise ImportError(f"`{package}.{name}` is gone; use {gone[name]}")
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    return load, lambda: names, names


@dataclass(frozen=True)
class FormatModule:
    """Module of a file format, loaded when a file of that format is read or written first.

    Attributes
    ----------
    module : str
        Full name of the module; its functions are attributes of this object.
    SUFFIXES : tuple of str
        Suffixes of the format's files, in lower case, with the dot.
    """

    module: str
    SUFFIXES: tuple[str, ...]

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(import_module(self.module), name)


class LoadedByKey(Mapping[str, T]):
    """Registry of objects in modules that load when an object is asked for; keys are listed without loading any.

    An entry is added as a key with the place of its object in the mapping that the registry is made of.

    Parameters
    ----------
    places : mapping of str to str
        ``module:name`` of the object of each key.
    """

    def __init__(self, places: Mapping[str, str]) -> None:
        """A registry from the places of its objects."""
        self.places = dict(places)

    def __getitem__(self, key: str) -> T:
        module, _, name = self.places[key].partition(":")
        value: T = getattr(import_module(module), name)
        return value

    def __iter__(self) -> Iterator[str]:
        return iter(self.places)

    def __len__(self) -> int:
        return len(self.places)

    def __contains__(self, key: object) -> bool:
        return key in self.places
