"""Edits that add an element set with an unknown property."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from structid.diagnose.model_edits import AddPart, AddUnknown, Edit, rounded


def added_spring(table: str, entry: Mapping[str, Any], loss_factor: float | None) -> list[Edit]:
    """A spring or joint of unknown stiffness, with an unknown loss factor of its own where one is given."""
    loss = {} if loss_factor is None else {"loss_factor": loss_factor}
    return [
        AddPart(table, {**entry, **loss}),
        *(AddUnknown({"property": prop, "elements": entry["name"]}) for prop in ("stiffness", *loss)),
    ]


def unknown_of_either_sign(prop: str, name: str, strength: float) -> AddUnknown:
    """An unknown mass or inertia that may be too much in the model, which begins at the strength then."""
    signed = {} if strength > 0 else {"positive": False, "start": rounded(strength)}
    return AddUnknown({"property": prop, "elements": name, **signed})
