"""Edits that add an element set with an unknown property."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from structid.diagnose.model_edits import AddPart, AddUnknown, Edit, rounded


def added_spring(table: str, entry: Mapping[str, Any], loss_factor: float | None) -> list[Edit]:
    """The edits that add a spring or joint of unknown stiffness; `loss_factor` is another unknown, None for none.

    `table` is the type of element set in a study, such as ``spring``, and `entry` its arguments, the name among them.
    """
    loss = {} if loss_factor is None else {"loss_factor": loss_factor}
    return [
        AddPart(table, {**entry, **loss}),
        *(AddUnknown({"property": prop, "elements": entry["name"]}) for prop in ("stiffness", *loss)),
    ]


def unknown_of_either_sign(prop: str, name: str, strength: float) -> AddUnknown:
    """The edit that declares `prop` of the added set `name` an unknown, which may be negative if `strength` is.

    A negative `strength` is the start; otherwise the start is the value of the set.
    """
    signed = {} if strength > 0 else {"positive": False, "start": rounded(strength)}
    return AddUnknown({"property": prop, "elements": name, **signed})
