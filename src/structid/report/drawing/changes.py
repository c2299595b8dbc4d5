"""Relative changes of every element by kind of property, and their shading in a drawing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from structid.core.arrays import FloatArray
from structid.core.quantities import exact, percent, with_unit
from structid.fem import Structure
from structid.fem.contribution import Property
from structid.identification.identified import Identification
from structid.report.drawing import palette
from structid.report.rendering import plot
from structid.unknowns import Parameters

#: Shadings of a structure, and the kinds of property that each shows.
KINDS: dict[str, tuple[str, ...]] = {
    "mass": ("mass", "rotary_inertia"),
    "stiffness": ("stiffness",),
    "axial force": ("axial_force",),
    "damping": ("viscous_damping", "loss_factor", "friction"),
    "thickness": ("thickness",),
}
_LIMITS = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5)


@dataclass(frozen=True)
class Change:
    """Change of one element: the largest relative change among its parameters, and a text on each of them.

    `is_significant` says whether the interval of a parameter leaves its initial value out.
    """

    ratio: float
    identified: bool
    text: str
    is_significant: bool = True


#: By element set and index.
Changes = dict[tuple[str, int], Change]


@dataclass(frozen=True, eq=False)
class Shading:
    """Colours of the elements in one drawing of the structure.

    Attributes
    ----------
    title : str
    changes : mapping of (element set, index) to Change
        Only elements that have a colour.
    scale : ColourScale
    outlined : frozenset of (element set, index)
        Elements with a line round the region that they make up.
    """

    title: str
    changes: Changes
    scale: plot.ColourScale
    outlined: frozenset[tuple[str, int]] = frozenset()


@dataclass(frozen=True)
class ElementStyle:
    """Appearance of a drawn element: its colour, whether it is shaded, and whether its change is in doubt."""

    colour: str = palette.KNOWN
    is_unknown: bool = False
    is_doubtful: bool = False


def element_style(shading: Shading | None, element: str, index: int) -> ElementStyle:
    """Colour and style of one element: the one of row `index` in the element set named `element`.

    Grey if `shading` is None or has no value for it. An identified change within its 95 % interval has the colour of 0;
    one that is not identified is marked as doubtful.
    """
    change = shading.changes.get((element, index)) if shading else None
    if shading is None or change is None:
        return ElementStyle()
    ratio = change.ratio if change.is_significant or not change.identified else 0.0
    return ElementStyle(shading.scale.colour(ratio), True, not change.identified)


def shading(title: str, changes: Changes, limit: float) -> Shading:
    """Shading called `title` of elements by relative `changes` on a diverging colour scale, white at 0.

    The scale runs from -`limit` to `limit`, a fraction, as are the changes; larger changes have the end colours.
    """
    ticks = [part * limit for part in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    texts = tuple((value, f"{'+' if value > 0 else ''}{exact(100 * value, 3)} %") for value in ticks)
    exceeded = any(abs(change.ratio) > limit for change in changes.values())
    scale = plot.ColourScale(palette.DIVERGING, -limit, limit, "relative change", texts, is_exceeded=exceeded)
    return Shading(title, changes, scale)


def round_limit(ratios: Iterable[float], least: float = 0.05) -> float:
    """Round number for the ends of a colour scale: the smallest of 0.02, 0.05, 0.1, 0.2, 0.3, 0.5 and 1 that holds `ratios`.

    At least `least`; at most 1, even if a ratio is larger.
    """
    largest = max((abs(r) for r in ratios if np.isfinite(r)), default=0.0)
    return next((step for step in _LIMITS if max(largest, least) <= step), 1.0)


def properties_of(structure: Structure, kinds: tuple[str, ...]) -> Iterator[Property]:
    """Properties of `structure` of the given kinds."""
    return (item for item in structure.properties if item.term.kind in kinds)


def elements_of(item: Property, design: csr_array) -> Iterator[tuple[tuple[str, int], int, np.ndarray]]:
    """Yield key, index and parameters of each element of the property `item` on which a parameter acts.

    The key is (element set, row in it, from 0); the index is that of its value among all properties, which is its row
    in `design` (n_values, n_params). The parameters are an int array of the columns that are not 0 in this row.
    """
    for row, index in enumerate(range(item.values.start, item.values.stop)):
        columns = design.indices[design.indptr[index] : design.indptr[index + 1]]
        if len(columns):
            yield (item.element, row), index, columns


@dataclass(frozen=True, eq=False)
class IdentifiedParameters:
    """Initial and identified values of the parameters of a structure.

    Attributes
    ----------
    structure : Structure
    parameters : Parameters
    initial, values : (n_params,) float array
    identified : (n_params,) bool array
    intervals : (n_params, 2) float array
        95 % intervals.
    """

    structure: Structure
    parameters: Parameters
    initial: FloatArray
    values: FloatArray
    identified: NDArray[np.bool_]
    intervals: FloatArray


def shadings(identification: Identification) -> tuple[Shading, ...]:
    """Shadings of an identification's relative parameter changes, one for each kind of property that has parameters."""
    found, own = identification.estimate, identification.own_index
    return parameter_shadings(
        IdentifiedParameters(
            identification.structure,
            identification.parameters,
            found.initial[own],
            found.values[own],
            found.identified[own],
            identification.intervals.ends[own],
        )
    )


def parameter_shadings(answer: IdentifiedParameters) -> tuple[Shading, ...]:
    """Shadings of relative parameter changes, one for each kind of property in `KINDS` that has parameters.

    They are in the order of `KINDS`. The colour scale ends at a round value that holds the significant changes.
    `answer` has the structure and its parameters, initial and identified values.
    """
    shadings = []
    for name, kinds in KINDS.items():
        changes = _changes(answer, kinds)
        if changes:
            limit = round_limit(c.ratio for c in changes.values() if c.identified and c.is_significant)
            shadings.append(shading(f"Change of {name} parameters", changes, limit))
    return tuple(shadings)


def _changes(answer: IdentifiedParameters, kinds: tuple[str, ...]) -> Changes:
    """Relative change of each element in its properties of these `kinds`, by (element set, row).

    Elements without parameters are left out. Of several properties the largest change counts, significant ones (beyond
    the 95 % interval) first, and all texts are joined; the change is identified if all parameters are. NaN where the
    initial value is 0. `answer` has the structure and its parameters, initial and identified values and intervals.
    """
    before, after = answer.parameters.values(answer.initial), answer.parameters.values(answer.values)
    design = answer.parameters.design.tocsr()
    is_outside = (answer.initial < answer.intervals[:, 0]) | (answer.initial > answer.intervals[:, 1])
    changes: Changes = {}
    for item in properties_of(answer.structure, kinds):
        for key, index, columns in elements_of(item, design):
            ratio = float(after[index] / before[index] - 1) if before[index] else np.nan
            values = f"{exact(float(before[index]))} to {with_unit(exact(float(after[index])), item.term.unit)}"
            identified = bool(answer.identified[columns].all())
            text = f"{item.term.property.replace('_', ' ')}: {values} ({percent(ratio)})"
            is_significant = bool(is_outside[columns].any())
            text += ", not identified" if not identified else "" if is_significant else ", within its interval"
            changes[key] = _merge_changes(changes.get(key), Change(ratio, identified, text, is_significant))
    return changes


def _merge_changes(first: Change | None, second: Change) -> Change:
    """Combined change of one element: the larger of both by magnitude, significant ones before others, with both texts.

    The texts are on two lines. Identified only if both are; `second` if `first` is None.
    """
    if first is None:
        return second
    larger = max((first, second), key=lambda one: (one.is_significant, abs(np.nan_to_num(one.ratio))))
    text = f"{first.text}\n{second.text}"
    return Change(larger.ratio, first.identified and second.identified, text, larger.is_significant)
