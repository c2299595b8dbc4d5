"""Plain values: what TOML and JSON hold, and what results and checkpoints are made of before they are written."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, MutableMapping, Sequence
from typing import Any, TypeAlias, TypeVar, overload

import numpy as np

T = TypeVar("T")

#: What a file of TOML or JSON holds, without the dates of TOML, which no key takes.
JsonValue: TypeAlias = "str | int | float | bool | Sequence[JsonValue] | Mapping[str, JsonValue] | None"
#: What a file of results or a checkpoint is made of: arrays and numbers of NumPy too.
StoredEntry: TypeAlias = (
    "str | int | float | bool | np.ndarray | np.generic | Sequence[StoredEntry] | Mapping[str, StoredEntry] | None"
)
#: Tables that are edited, such as those of a study file; they are checked when they are read again.
Tables: TypeAlias = MutableMapping[str, Any]


@overload
def as_list(value: list[T] | tuple[T, ...]) -> list[T]: ...
@overload
def as_list(value: str) -> list[str]: ...
@overload
def as_list(value: Sequence[T]) -> list[T]: ...
@overload
def as_list(value: T) -> list[T]: ...
def as_list(value: object) -> object:
    """A single entry as a list of one."""
    return list(value) if isinstance(value, list | tuple) else [value]


def json_text(value: StoredEntry) -> str:
    """`value` as strict JSON text, indented, in which numbers that are not finite are null."""
    return json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def plain(value: StoredEntry) -> JsonValue:
    """`value` in types of JSON: arrays and sequences as lists, mappings as objects, NumPy numbers as Python's.

    NaN and infinite numbers become None; text stays.
    """
    if isinstance(value, str):
        return value
    if isinstance(value, Mapping):
        return plain_table(value)
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, Sequence):
        return [plain(entry) for entry in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def plain_table(table: Mapping[str, StoredEntry]) -> dict[str, JsonValue]:
    """A table in the types of JSON."""
    return {str(key): plain(entry) for key, entry in table.items()}
