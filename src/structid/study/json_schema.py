"""The JSON Schema of study files, which editors check and complete them by."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace

from structid.study.schema import tables
from structid.study.schema.method import method_table
from structid.study.schema.model.matrices import MATRICES
from structid.study.schema.model.structure import changes_table, structure_table
from structid.study.schema.plan import PLAN
from structid.study.schema.records.record import record_table
from structid.study.schema.section import SECTIONS
from structid.study.schema.tables import Schema, Table
from structid.study.schema.unknowns import PRIOR, REGULARIZATION, UNKNOWN

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_NAMED: dict[str, tables.Kind | Table] = {
    "text": tables.TEXT,
    "texts": tables.TEXTS,
    "numbers": tables.NUMBERS,
    "property": tables.PROPERTY,
    "position": tables.POSITION,
    "nodes": tables.NODES,
    "range": tables.RANGE,
    "prior": PRIOR,
    "matrices": MATRICES,
}


def study_table() -> Table:
    """All keys of a study file, those of its sections too."""
    inner = {
        "structure": structure_table(),
        "unknown": UNKNOWN,
        "record": record_table(changes_table()),
        "method": method_table(),
        "regularization": REGULARIZATION,
        "plan": PLAN,
    }
    return SECTIONS | {name: replace(SECTIONS.keys[name], holds=table) for name, table in inner.items()}


def study_schema() -> dict[str, object]:
    """The JSON Schema (draft 2020-12) of study files, as plain values; ``record`` may be a table or an array of tables."""
    elements = {name: key.holds for name, key in changes_table().keys.items() if key.listed}
    names = {_text(kind.schema): name for name, kind in (_NAMED | elements).items()}
    parts: dict[str, Schema] = {}
    whole = _with_references(study_table().schema, names, parts)
    record: Schema = {"$ref": "#/$defs/record"}
    parts["record"] = whole["properties"]["record"]
    whole["properties"]["record"] = {"anyOf": [record, {"type": "array", "items": record}]}
    return {"$schema": _DIALECT, "title": "structid study", **whole, "$defs": dict(sorted(parts.items()))}


def _text(schema: Schema) -> str:
    return json.dumps(schema, sort_keys=True)


def _with_references(schema: Schema, names: Mapping[str, str], parts: dict[str, Schema]) -> Schema:
    """The schema `schema` with a reference in place of each part that has a name, beside its description and default.

    `names` maps the JSON text of a part, without its description and default, to the name of the part. The parts that
    references stand for are added to `parts` by name.
    """
    annotations: Schema = {}
    bare: Schema = {**schema}
    if "description" in bare:
        annotations["description"] = bare.pop("description")
    if "default" in bare:
        annotations["default"] = bare.pop("default")
    name = names.get(_text(bare))
    result: Schema = {**bare}
    if "anyOf" in result:
        result["anyOf"] = [_with_references(part, names, parts) for part in result["anyOf"]]
    if "items" in result:
        result["items"] = _with_references(result["items"], names, parts)
    if "properties" in result:
        result["properties"] = {key: _with_references(part, names, parts) for key, part in result["properties"].items()}
    if "patternProperties" in result:
        patterns = {key: _with_references(part, names, parts) for key, part in result["patternProperties"].items()}
        result["patternProperties"] = patterns
    if "additionalProperties" in result and not isinstance(result["additionalProperties"], bool):
        result["additionalProperties"] = _with_references(result["additionalProperties"], names, parts)
    if name is None:
        return {**result, **annotations}
    parts[name] = result
    return {"$ref": f"#/$defs/{name}", **annotations}
