"""Element types that the page's editor offers, as the registry declares them: keys, units, words."""

from __future__ import annotations

import dataclasses

from structid.core.constraints import parameter_descriptions
from structid.core.json_types import StoredEntry
from structid.fem import ELEMENT_TYPES
from structid.fem.elements.element import declarations

EDITED = ("beam", "bar", "space_beam", "point_mass", "spring")


def element_kinds() -> dict[str, StoredEntry]:
    """Keys of each element type that the page can edit, by type: name, unit, description and whether required."""
    kinds: dict[str, StoredEntry] = {}
    for name in EDITED:
        kind = ELEMENT_TYPES[name]
        declared, words = declarations(kind), parameter_descriptions(kind)
        kinds[name] = [
            {
                "name": item.name,
                "unit": declared[item.name].unit,
                "words": words.get(item.name, ""),
                "required": item.default is dataclasses.MISSING,
            }
            for item in dataclasses.fields(kind)
            if item.init
        ]
    return kinds
