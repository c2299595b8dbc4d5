"""A study as the page knows it: its text, its digest, its tables, and where it is broken."""

from __future__ import annotations

import datetime
import math
import re
from functools import cache
from typing import Any

from structid.records.formats import ReadOptions
from structid.study.schema.tables import Table, table_of
from structid.study.schema.toml_lines import parse_toml

#: Tables that the page does not look at are left out where the text is longer.
_LONG = 3_000_000


def study_answer(text: str, digest: str) -> dict[str, Any]:
    """Study for the web page: ``text``, ``digest``, parsed ``table``, and ``broken``, the line and message of a TOML error.

    ``table`` is None if the text is broken, else ``broken`` is None. Above 3 million characters, ``table`` lacks ``structure``.
    """
    try:
        table = parse_toml(text)
    except (ValueError, RecursionError) as error:
        line_match = re.search(r"at line (\d+)", str(error))
        line = int(line_match[1]) if line_match else text.count("\n") + 1
        return {"text": text, "digest": digest, "table": None, "broken": {"line": line, "words": str(error)}}
    if len(text) > _LONG:
        table = {name: part for name, part in table.items() if name != "structure"}
    return {"text": text, "digest": digest, "table": _as_json_value(table), "broken": None}


@cache
def reading_keys() -> list[dict[str, Any]]:
    """Options of ``[record]`` and ``[record.csv]`` for reading a file, each with name, description, default and choices.

    ``within`` is "csv" for keys of ``[record.csv]``, else ""; ``is_list`` and ``is_number`` tell the type.
    """
    found = []
    for name, key in table_of(ReadOptions).keys.items():
        inner = key.holds.keys if isinstance(key.holds, Table) else {name: key}
        for own, one in inner.items():
            schema = one.holds.schema
            found.append(
                {
                    "name": own,
                    "within": name if own != name else "",
                    "words": one.description.replace("`", ""),
                    "default": "" if one.default is None else one.default,
                    "choices": schema.get("enum", []),
                    "is_list": "array" in str(schema),
                    "is_number": schema.get("type") in ("number", "integer"),
                }
            )
    return found


def _as_json_value(value: Any) -> Any:
    """Copy of `value` that can be written as JSON: dates, times and non-finite numbers become text."""
    if isinstance(value, dict):
        return {key: _as_json_value(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_as_json_value(one) for one in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return str(value) if isinstance(value, datetime.date | datetime.time) else value
