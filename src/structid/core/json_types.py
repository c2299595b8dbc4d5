"""Plain values: what TOML and JSON hold, and what results and checkpoints are made of before they are written."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np

#: What a file of TOML or JSON holds, without the dates of TOML, which no key takes.
Plain: TypeAlias = "str | int | float | bool | Sequence[Plain] | Mapping[str, Plain] | None"
#: What a file of results or a checkpoint is made of: arrays and numbers of NumPy too.
Entry: TypeAlias = "str | int | float | bool | np.ndarray | np.generic | Sequence[Entry] | Mapping[str, Entry] | None"


def json_text(value: Entry) -> str:
    """`value` as strict JSON text, indented, in which numbers that are not finite are null."""
    return json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def plain(value: Entry) -> Plain:
    """`value` in types of JSON: arrays as lists, NumPy numbers as Python's, numbers that are not finite as None."""
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


def plain_table(table: Mapping[str, Entry]) -> dict[str, Plain]:
    """A table in the types of JSON."""
    return {str(key): plain(entry) for key, entry in table.items()}
