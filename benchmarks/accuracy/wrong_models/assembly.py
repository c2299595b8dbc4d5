"""A structure as a table (the `[structure]` of a study file as a dictionary) and its matrices.

Beside the keys of the study file the table may hold `ties` (one degree of freedom is another: "9001Y" -> "4Y"),
`friction` and `base` (held degrees of freedom that a shaking table moves alike), and beams may have a `shear_stiffness`.
Degrees of freedom are texts such as "12RZ".
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from wrong_models.elements import ELEMENTS

Table = dict[str, Any]
TRANSLATIONS = ("X", "Y", "Z")
#: Entries of a table that are no element sets.
PLAIN = ("active", "fixed", "nodes", "ties", "friction", "base", "driven")
#: Properties that `stiffness` stands for.
STIFFNESSES = {
    "beam": ("bending_stiffness", "axial_stiffness"),
    "space_beam": ("bending_stiffness_y", "bending_stiffness_z", "axial_stiffness", "torsional_stiffness"),
    "bar": ("axial_stiffness",),
    "membrane": ("tension",),
    "plate": ("bending_stiffness",),
    "spring": ("stiffness",),
}


def split(dof: str) -> tuple[int, str]:
    """Node and direction of "12RZ"."""
    node, direction = re.fullmatch(r"(\d+)(R?[XYZ])", dof).groups()  # type: ignore[union-attr]
    return int(node), direction


def sets(table: Table) -> Iterator[tuple[str, dict[str, Any]]]:
    """Element sets with their types."""
    for kind, listed in table.items():
        if kind not in PLAIN:
            yield from ((kind, own) for own in listed)


def find(table: Table, name: str) -> tuple[str, dict[str, Any]]:
    """Type and entry of the element set `name`."""
    return next((kind, own) for kind, own in sets(table) if own["name"] == name)


def count(own: dict[str, Any]) -> int:
    """Number of elements of a set."""
    return len(own["nodes"] if "nodes" in own else own["first"])


def row(own: dict[str, Any], i: int) -> dict[str, Any]:
    """Element `i` of a set: its own entry of every list."""
    return {key: value[i] if isinstance(value, list) and key != "directions" else value for key, value in own.items()}


@dataclass(frozen=True)
class System:
    """Matrices over the degrees of freedom `dofs` that move; `stiffness` is complex with loss factors.

    The motion of `driven` is given, where there is one.
    """

    dofs: tuple[str, ...]
    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    ties: dict[str, str]
    driven: str = ""

    def column(self, dof: str) -> np.ndarray:
        """1 at `dof`; zeros where it is held."""
        dof = self.ties.get(dof, dof)
        return np.array([float(own == dof) for own in self.dofs])


def _parts(table: Table) -> Iterator[tuple[list[str], np.ndarray, np.ndarray, np.ndarray]]:
    """Degrees of freedom, mass, damping and stiffness of every element but the point masses."""
    for kind, own in sets(table):
        for i in range(0 if kind == "point_mass" else count(own)):
            p = row(own, i)
            if kind in ELEMENTS:
                made = ELEMENTS[kind](np.array([table["nodes"][n] for n in p["nodes"]], dtype=float), p)
                dofs = [f"{node}{direction}" for node in p["nodes"] for direction in made.directions]
                yield dofs, made.mass, made.damping, made.stiffness
            elif kind == "rotary_inertia":
                yield (
                    [f"{p['nodes']}{p['direction']}"],
                    np.array([[p["rotary_inertia"]]]),
                    np.zeros((1, 1)),
                    np.zeros((1, 1)),
                )
            else:
                dofs = [p["first"]] + ([p["second"]] if "second" in p else [])
                jump = np.outer([1, -1][: len(dofs)], [1, -1][: len(dofs)])
                stiff = p.get("stiffness", 0.0) * (1 + 1j * p.get("loss_factor", 0.0))
                yield dofs, 0.0 * jump, p.get("viscous_damping", 0.0) * jump, stiff * jump


def _masses(table: Table, used: set[str]) -> Iterator[tuple[str, float]]:
    """Point masses in the directions that other elements give to their nodes, or in those they name."""
    for own in table.get("point_mass", ()):
        for i in range(count(own)):
            p = row(own, i)
            directions = p.get("directions") or [d for d in TRANSLATIONS if f"{p['nodes']}{d}" in used]
            yield from ((f"{p['nodes']}{d}", p["mass"]) for d in directions)


def assembled(table: Table) -> System:
    """The matrices of a structure, its held degrees of freedom left out."""
    ties, parts = table.get("ties", {}), list(_parts(table))
    used = {dof for dofs, *_ in parts for dof in dofs}
    parts += [([dof], np.array([[kg]]), np.zeros((1, 1)), np.zeros((1, 1))) for dof, kg in _masses(table, used)]
    held = set(table["fixed"])
    order: dict[str, int] = {}
    for dofs, *_ in parts:
        for dof in (ties.get(dof, dof) for dof in dofs):
            if split(dof)[1] in table["active"] and dof not in held:
                order.setdefault(dof, len(order))
    whole = [np.zeros((len(order), len(order)), dtype=complex) for _ in range(3)]
    for dofs, *matrices in parts:
        places = [order.get(ties.get(dof, dof), -1) for dof in dofs]
        kept = [i for i, at in enumerate(places) if at >= 0]
        at = [places[i] for i in kept]
        for total, matrix in zip(whole, matrices, strict=True):
            np.add.at(total, np.ix_(at, at), matrix[np.ix_(kept, kept)])
    return System(tuple(order), whole[0].real, whole[1].real, whole[2], ties, table.get("driven", ""))


def shaken(table: Table) -> Table:
    """The structure on its moving table: what that moves is free, and follows the first."""
    first, *others = table["base"]
    free = [dof for dof in table["fixed"] if dof not in table["base"]]
    return {**table, "fixed": free, "ties": {**table.get("ties", {}), **dict.fromkeys(others, first)}, "driven": first}
