"""Relative change of every element, for mass, stiffness and damping apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.identification.identified import Identification
from structid.report.drawing import palette
from structid.report.text import exact, percent, with_unit

#: Panels of the structure drawing, and the kinds of property that each shows.
PANELS: dict[str, tuple[str, ...]] = {
    "mass": ("mass", "rotary_inertia"),
    "stiffness": ("stiffness",),
    "damping": ("viscous_damping", "loss_factor", "friction"),
    "thickness": ("thickness",),
}


@dataclass(frozen=True)
class Change:
    """What became of one element: the largest relative change among its parameters, and a text on each of them."""

    ratio: float
    identified: bool
    text: str


Changes = dict[tuple[str, int], Change]


@dataclass(frozen=True, eq=False)
class Panel:
    """Changes of one kind of property.

    Attributes
    ----------
    name : str
        A key of `PANELS`.
    changes : mapping of (element set, index) to Change
        Only elements that a parameter of this kind acts on.
    limit : float
        Relative change at the ends of the colour scale.
    """

    name: str
    changes: Changes
    limit: float

    @property
    def is_exceeded(self) -> bool:
        """Whether some change lies beyond the ends of the scale."""
        return any(abs(change.ratio) > self.limit for change in self.changes.values())

    @property
    def ticks(self) -> tuple[tuple[float, str], ...]:
        """Values and texts for the colour scale."""
        values = [part * self.limit for part in (-1.0, -0.5, 0.0, 0.5, 1.0)]
        return tuple((value, f"{'+' if value > 0 else ''}{exact(100 * value, 3)} %") for value in values)


@dataclass(frozen=True)
class Look:
    """How an element is drawn: its colour, whether a parameter of the panel acts on it, and whether it is in doubt."""

    colour: str = palette.KNOWN
    is_unknown: bool = False
    is_doubtful: bool = False


def look(panel: Panel | None, element: str, index: int) -> Look:
    """The look of one element in `panel`; grey where no parameter of the panel acts on it."""
    change = panel.changes.get((element, index)) if panel else None
    if panel is None or change is None:
        return Look()
    step = palette.diverging_step(np.array([change.ratio]), panel.limit)[0]
    return Look(palette.colours(palette.DIVERGING)[step], True, not change.identified)


def panels(identification: Identification) -> tuple[Panel, ...]:
    """The panels that have a parameter at all."""
    found = []
    for name, kinds in PANELS.items():
        changes = _changes(identification, kinds)
        if changes:
            found.append(Panel(name, changes, _limit([c.ratio for c in changes.values() if c.identified])))
    return tuple(found)


def _changes(identification: Identification, kinds: tuple[str, ...]) -> Changes:
    structure, unknown = identification.structure, identification.parameters
    found = identification.estimate
    own = identification.own_index
    before, after = unknown.values(found.initial[own]), unknown.values(found.values[own])
    design = unknown.design.tocsr()
    changes: Changes = {}
    for item in structure.properties:
        if item.term.kind not in kinds:
            continue
        for row, index in enumerate(range(item.values.start, item.values.stop)):
            columns = design.indices[design.indptr[index] : design.indptr[index + 1]]
            if not len(columns):
                continue
            ratio = float(after[index] / before[index] - 1) if before[index] else np.nan
            values = f"{exact(float(before[index]))} to {with_unit(exact(float(after[index])), item.term.unit)}"
            identified = bool(found.identified[own[columns]].all())
            text = f"{item.term.property.replace('_', ' ')}: {values} ({percent(ratio)})"
            text += "" if identified else ", not identified"
            key = (item.element, row)
            changes[key] = _merged(changes.get(key), Change(ratio, identified, text))
    return changes


def _merged(first: Change | None, second: Change) -> Change:
    """Both together: the larger change, identified only if both are."""
    if first is None:
        return second
    ratio = max(first.ratio, second.ratio, key=lambda r: abs(np.nan_to_num(r)))
    return Change(ratio, first.identified and second.identified, f"{first.text}\n{second.text}")


def _limit(ratios: list[float]) -> float:
    """A round number at the ends of the colour scale: from 5 to 100 %."""
    largest = max((abs(r) for r in ratios if np.isfinite(r)), default=0.0)
    return next((step for step in (0.05, 0.1, 0.2, 0.3, 0.5) if largest <= step), 1.0)
