"""The declaration of an unknown property, and the group of parameters that it makes: by element, for a set, or a smooth field."""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray
from structid.core.constraints import Count, Positive
from structid.core.errors import InputError
from structid.fem import Property, Structure
from structid.unknowns.priors import Prior

_LARGEST_DEGREE = 5
Entry = TypeVar("Entry")
_SELECTION = re.compile(r"^(?P<name>.+?):(?P<first>\d+)(?:-(?P<last>\d+))?$")


@dataclass(frozen=True)
class Field:
    """A coarse grid over the box around the elements; each of its functions is one parameter.

    The factor on an element's nominal value is the sum of coefficients times functions at the element's middle. The functions
    are products of B-splines along X, Y and Z: not negative, with sum 1 everywhere. So coefficients that are all 1
    leave the nominal values, and positive coefficients keep the property positive.

    Parameters
    ----------
    intervals : tuple of int
        Intervals along X, Y and Z, 1 or more; one number for each coordinate of the nodes (later ones may be left out
        where the elements lie in a plane or on a line).
    degree : int
        Of the B-splines: 1 (the default) for linear variation between the grid's nodes, 3 for cubic splines, 0 for
        one constant an interval. There are `intervals` + `degree` functions along an axis.

    References
    ----------
    de Boor (1978), A Practical Guide to Splines, chapter IX.
    """

    intervals: tuple[Count, ...]
    degree: int = 1

    def __post_init__(self) -> None:
        """Make `intervals` a tuple of ints; raise `InputError` unless it and the degree are in range.

        Allowed are 1 to 3 intervals of at least 1, and degrees from 0 to 5.
        """
        object.__setattr__(self, "intervals", tuple(int(n) for n in np.atleast_1d(self.intervals)))
        if not 1 <= len(self.intervals) <= 3 or min(self.intervals) < 1:
            raise InputError(f"`intervals` of a field must be 1 to 3 whole numbers of at least 1, got {self.intervals}")
        if not 0 <= self.degree <= _LARGEST_DEGREE:
            raise InputError(f"`degree` of a field must lie from 0 to {_LARGEST_DEGREE}, got {self.degree}")


def field_functions(field: Field, middles: FloatArray) -> tuple[sparse.csc_array, tuple[str, ...]]:
    """Values of the shape functions of `field` at the middles of the elements, sparse, and labels of its grid points.

    Axes along which the elements do not extend are left out of the grid.

    Parameters
    ----------
    field : Field
        Number of intervals along each axis, and the degree of the splines.
    middles : (n_elements, n_coordinates) float array
        Middles of the elements, m.

    Returns
    -------
    (n_elements, n_functions) sparse array, and the position of each function in the grid, such as ``2,1`` (from 1).
        Functions that no element sees are left out.

    Raises
    ------
    InputError
        If the elements extend along an axis that `intervals` says nothing of.
    """
    low, extent = middles.min(axis=0), np.ptp(middles, axis=0)
    flat = extent <= 1e-9 * max(extent.max(), np.finfo(float).tiny)
    if (~flat[len(field.intervals) :]).any():
        raise InputError(
            f"`intervals` of the field must have {middles.shape[1]} numbers, one for each coordinate, got"
            f" {len(field.intervals)}: the elements extend along {'XYZ'[int(np.flatnonzero(~flat)[-1])]} too"
        )
    total = sparse.csr_array(np.ones((len(middles), 1)))
    grid_points: list[tuple[int, ...]] = [()]
    for axis, count in enumerate(field.intervals[: middles.shape[1]]):
        if flat[axis]:
            continue
        splines = _splines((middles[:, axis] - low[axis]) / extent[axis], count, field.degree)
        total = sparse.csr_array(
            sparse.hstack([total[:, [k]].multiply(splines) for k in range(total.shape[1])], format="csr")
        )
        grid_points = [(*grid_point, i + 1) for grid_point in grid_points for i in range(splines.shape[1])]
    columns = sparse.csc_array(total)
    columns.eliminate_zeros()
    seen = np.flatnonzero(np.diff(columns.indptr))
    names = tuple(",".join(map(str, grid_points[k])) or "1" for k in seen)
    return sparse.csc_array(columns[:, seen]), names


def _splines(positions: FloatArray, intervals: int, degree: int) -> sparse.csr_array:
    """Values of B-splines on equal intervals of [0, 1] at `positions` (n,), sparse (n, intervals + degree)."""
    from scipy.interpolate import BSpline

    knots = np.concatenate([np.zeros(degree), np.linspace(0.0, 1.0, intervals + 1), np.ones(degree)])
    return sparse.csr_array(BSpline.design_matrix(np.clip(positions, 0.0, 1.0), knots, degree))


@dataclass(frozen=True)
class Unknown:
    """A declaration: this property of these elements is unknown.

    Parameters
    ----------
    property : str
        Property of the elements, such as ``mass`` or ``bending_stiffness``. ``stiffness`` stands for the only
        stiffness of an element, and for a common factor on all of them where it has several.
    elements : str or sequence of str
        Element sets; ``beam:3`` is element 3 of set ``beam``, ``beam:2-4`` elements 2 to 4 (counted from 1).
    each : bool or int
        One parameter an element instead of one for all; a number is that of the neighbours, in the order of the set, that
        share one: 4 makes ``deck:1-4``, ``deck:5-8`` and so on.
    start : float, optional
        Initial value, in the unit of the property (1 for a factor). The nominal value by default.
    factor : bool, optional
        Whether the parameter multiplies the nominal values instead of being the value. By default it does where
        the nominal values differ among the elements.
    name : str, optional
        What stands in the brackets of the parameter's name; made from `elements` by default.
    bounds : (float, float), optional
        The parameter stays strictly between them.
    positive : bool
        Whether the parameter is kept positive; True but for a parameter with bounds.
    prior : Prior, optional
        What was believed of it beforehand.
    fixed : bool
        Kept at its initial value; a way to switch a parameter off.
    tied_to : str, optional
        Name of another parameter that this one is a multiple of.
    ratio : float
        That multiple.
    field : Field, optional
        The property varies smoothly over the elements: one parameter for each function of a coarse grid, a factor on the
        nominal values. Names end in the function's place in the grid: ``youngs_modulus[deck:field 2,1]``.
    varies : bool or float
        Whether it differs from record to record, as a clamp does: each of three records or more then has a value of its own,
        drawn about a common one, which is what is reported. True lets the data choose the scatter; a number states it, as
        a standard deviation in parts (0.05 for 5 %).
    """

    property: str
    elements: str | Sequence[str]
    each: bool | Count = False
    start: float | None = None
    factor: bool | None = None
    name: str | None = None
    bounds: tuple[float, float] | None = None
    positive: bool = True
    prior: Prior | None = None
    fixed: bool = False
    tied_to: str | None = None
    ratio: float = 1.0
    field: Field | None = None
    varies: bool | Positive = False


@dataclass(frozen=True, eq=False)
class ParameterGroup:
    """The parameters of one declaration; an entry is a property value of the structure that a parameter makes.

    Attributes
    ----------
    unknown : Unknown
    labels : tuple of str
        What stands in the brackets of each parameter's name.
    properties : tuple of Property
        Those that the declaration is about.
    indices : (n_entries,) int array
        Places among the values of the structure.
    owner : (n_entries,) int array
        Parameter that each entry belongs to, ascending.
    item : (n_entries,) int array
        Its property, a position in `properties`.
    nominal : (n_entries,) float array
    shares : (n_entries,) float array, optional
        What a parameter's function is at the entry; 1 where it is None.
    """

    unknown: Unknown
    labels: tuple[str, ...]
    properties: tuple[Property, ...]
    indices: IntArray
    owner: IntArray
    item: IntArray
    nominal: FloatArray
    shares: FloatArray | None = None

    @property
    def n_params(self) -> int:
        return len(self.labels)

    @property
    def is_free(self) -> bool:
        """True if its parameters are identified: neither fixed nor tied to another."""
        return self.unknown.tied_to is None and not self.unknown.fixed

    @cached_property
    def names(self) -> tuple[str, ...]:
        before = f"{self.unknown.property}["
        return tuple([f"{before}{label}]" for label in self.labels])

    @cached_property
    def first(self) -> IntArray:
        """Index, (n_params,), of the first entry of each parameter."""
        return np.searchsorted(self.owner, np.arange(self.n_params))

    @cached_property
    def is_factor(self) -> np.ndarray:
        """True for each parameter that multiplies nominal values instead of being the value, (n_params,).

        As declared in `factor`; by default where its entries differ in property or nominal value, and always for fields.
        """
        if self.unknown.factor is not None or self.shares is not None:
            return np.full(self.n_params, self.unknown.factor is not False)
        quantities = [item.term.property for item in self.properties]
        number = np.array([quantities.index(quantity) for quantity in quantities])[self.item]
        return _varies(number, self.first) | _varies(self.nominal, self.first)

    @property
    def base(self) -> FloatArray:
        """Property value of each entry where its parameter is 1, (n_entries,).

        It is the nominal value for a factor, else 1; for a field it is multiplied by the shape function.

        Raises
        ------
        InputError
            If a factor has nominal values that are all 0.
        """
        factor = self.is_factor
        empty = factor & ~np.logical_or.reduceat(self.nominal != 0, self.first)
        if empty.any():
            raise InputError(
                f"{self.names[int(np.argmax(empty))]} is a factor on nominal values that are all 0; set nominal values"
                " or `factor = false`"
            )
        values = np.where(factor[self.owner], self.nominal, 1.0)
        return values if self.shares is None else values * self.shares

    @property
    def start(self) -> FloatArray:
        """Initial value of each parameter, (n_params,)."""
        if self.unknown.start is not None:
            return np.full(self.n_params, float(self.unknown.start))
        return np.where(self.is_factor, 1.0, self.nominal[self.first])

    @property
    def limits(self) -> tuple[float, float]:
        """Lower and upper limit of every parameter of the group, in the parameter's unit (1 for factors); infinite if none.

        They are the declared `bounds`. Without bounds a node position lies between its neighbours, not quite up to them; any
        other property is at least 0, but for an axial force, or one declared with ``positive=False``, which have no limits.

        Raises
        ------
        InputError
            If the bounds do not increase, or those of a node between two neighbours do not lie between them.
        """
        lowest, highest = self._property_limits
        if self.unknown.bounds is None:
            return (lowest, highest) if self.unknown.positive or np.isfinite(highest) else (-np.inf, np.inf)
        low, high = self.unknown.bounds
        if not low < high:
            raise InputError(f"bounds of {self.names[0]} must increase, got {self.unknown.bounds}")
        if not (lowest <= low and high <= highest) and np.isfinite(highest):
            raise InputError(
                f"bounds of {self.names[0]} must lie between its neighbours, from {lowest:g} to {highest:g} m, got"
                f" {list(self.unknown.bounds)}"
            )
        return float(low), float(high)

    @cached_property
    def is_bounded(self) -> bool:
        """True if the parameters of the group have an upper limit, by declared bounds or by their property."""
        return self.unknown.bounds is not None or bool(np.isfinite(self._property_limits[1]))

    @cached_property
    def _property_limits(self) -> tuple[float, float]:
        """Lower and upper limit of the group that its properties impose; 0 and infinite for a property without limits.

        If parameters of the group are factors, limits of a property with an upper one are divided by its largest
        nominal value.
        """
        lows, highs = [], []
        for i, item in enumerate(self.properties):
            low, high = (0.0, np.inf) if item.term.limits is None else item.term.limits
            scale = float(self.nominal[self.item == i].max()) if self.is_factor.any() and np.isfinite(high) else 1.0
            lows.append(low / scale)
            highs.append(high / scale)
        return max(lows), min(highs)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Physical kind of each parameter, such as ``mass``."""
        return _select_entries([item.term.kind for item in self.properties], self.item[self.first])

    @property
    def units(self) -> tuple[str, ...]:
        units = [item.term.unit for item in self.properties]
        return _select_entries([*units, "1"], np.where(self.is_factor, len(units), self.item[self.first]))


def element_sets(group: ParameterGroup) -> tuple[tuple[str, ...], ...]:
    """Names of the element sets that each parameter of the group acts on, one tuple a parameter, each name once."""
    sets = [item.element for item in group.properties]
    number = np.array([sets.index(name) for name in sets])[group.item]
    names_of = list(_select_entries([(name,) for name in sets], number[group.first]))
    for k in np.flatnonzero(_varies(number, group.first)).tolist():
        numbers = number[group.owner == k].tolist()
        names_of[k] = tuple(dict.fromkeys(sets[i] for i in numbers))
    return tuple(names_of)


def _varies(numbers: np.ndarray, first: IntArray) -> np.ndarray:
    """True for each parameter (n_params,) whose `numbers` (n_entries,) differ; `first` (n_params,) is where its entries begin."""
    if not len(first):
        return np.zeros(0, dtype=bool)
    return np.asarray(np.maximum.reduceat(numbers, first) > np.minimum.reduceat(numbers, first))


def label_of(unknown: Unknown) -> str:
    """Label of all parameters of a declaration, in the brackets of a name."""
    texts = (unknown.elements,) if isinstance(unknown.elements, str) else unknown.elements
    return unknown.name or ", ".join(texts)


def _select_entries(table: Sequence[Entry], positions: IntArray) -> tuple[Entry, ...]:
    """Entries of `table` at `positions` (n,), in their order; a table of one entry has it everywhere."""
    if len(table) == 1:
        return (table[0],) * len(positions)
    return tuple([table[i] for i in positions.tolist()])


def parameter_group(structure: Structure, unknown: Unknown) -> ParameterGroup:
    """The parameters that the declaration `unknown` makes on `structure`, as one group.

    One parameter for all elements, or one for each (group of neighbours) with `each`, or one for each function of a
    field. Elements that are named twice take part once.

    Raises
    ------
    InputError
        If it names no elements, some that do not exist, or groups or a field that cannot be made.
    """
    texts = (unknown.elements,) if isinstance(unknown.elements, str) else tuple(unknown.elements)
    if not texts:
        raise InputError(f"unknown {unknown.property!r} names no elements")
    members = [member for text in texts for member in named_members(structure, unknown.property, text)]
    items = tuple({item.values.start: item for item, _ in members}.values())
    item_of_start = {item.values.start: i for i, item in enumerate(items)}
    indices = np.concatenate([item.values.start + rows for item, rows in members])
    item = np.concatenate([np.full(len(rows), item_of_start[owner_item.values.start]) for owner_item, rows in members])
    once = np.sort(np.unique(indices, return_index=True)[1])  # elements named twice take part once
    indices, item = indices[once], item[once]
    label = label_of(unknown)
    if unknown.field is not None:
        return _make_field_group(structure, unknown, label, items, indices, item)
    nominal = structure.values[indices]
    if not unknown.each:
        return ParameterGroup(unknown, (label,), items, indices, np.zeros_like(indices), item, nominal)
    labels, owner = _parameter_per_element(unknown, items, indices, item)
    order = np.argsort(owner, kind="stable")
    return ParameterGroup(unknown, labels, items, indices[order], owner[order], item[order], nominal[order])


def _parameter_per_element(
    unknown: Unknown, items: tuple[Property, ...], indices: IntArray, item: IntArray
) -> tuple[tuple[str, ...], IntArray]:
    """Labels of the parameters when `each` is set, and the parameter index of each entry, (n_entries,).

    There is one parameter for every `each` elements, in the order in which they are named. Labels are such as
    ``beam:3`` for one element, ``beam:1-4`` for several, or ``beam`` alone where the set has one element; the name that
    the declaration states stands for that of a larger set. `indices` (n_entries,) are the entries' positions among the
    property values, `item` (n_entries,) the index of the property of each in `items`.
    """
    single = [len(item_property.term.values) == 1 for item_property in items]
    words = [
        item_property.element if alone else unknown.name or item_property.element
        for item_property, alone in zip(items, single, strict=True)
    ]
    kinds = list(dict.fromkeys(zip(words, single, strict=True)))
    number = np.array([kinds.index(pair) for pair in zip(words, single, strict=True)])[item]
    row = indices - np.array([item_property.values.start for item_property in items])[item]
    lead, last = _neighbour_groups(unknown, [name for name, _ in kinds], number, row)
    largest = int(row.max()) + 1
    _, first, owner = np.unique(number * largest + lead, return_index=True, return_inverse=True)
    order = np.argsort(first)  # as they are named first
    named = first[order]
    spans = list(zip(number[named].tolist(), (lead[named] + 1).tolist(), (last[named] + 1).tolist(), strict=True))
    if unknown.each == 1:
        labels = [kinds[k][0] if kinds[k][1] else f"{kinds[k][0]}:{element}" for k, element, _ in spans]
    else:
        labels = [f"{kinds[k][0]}:{start}-{end}" for k, start, end in spans]
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return tuple(labels), rank[owner]


def _neighbour_groups(
    unknown: Unknown, names: Sequence[str], number: IntArray, row: IntArray
) -> tuple[IntArray, IntArray]:
    """First and last element row, from 0, of the group of neighbours that shares a parameter, (n_entries,) each.

    For each entry, `number` is the index of its element set in `names`, and `row` the element row, from 0; `unknown.each` is
    the size of a group. Raises `InputError` if the elements of a set make no whole groups, or those of a group are no
    neighbours.
    """
    size = int(unknown.each)
    if size == 1:
        return row, row
    first, last = np.empty_like(row), np.empty_like(row)
    for k, name in enumerate(names):
        of_set = number == k
        chosen = np.unique(row[of_set])
        if len(chosen) % size:
            raise InputError(
                f"`each` = {size} of {unknown.property}[{name}] makes no whole groups of {len(chosen)} elements; take a"
                ' divisor, or name fewer elements, as in `elements = "name:1-8"`'
            )
        starts, ends = chosen[::size], chosen[size - 1 :: size]
        if (ends - starts != size - 1).any():
            apart = int(starts[np.argmax(ends - starts != size - 1)]) + 1
            raise InputError(
                f"`each` = {size} of {unknown.property}[{name}]: the group from element {apart} on is not of neighbours; give it"
                " an [[unknown]] of its own"
            )
        group = np.searchsorted(chosen, row[of_set]) // size
        first[of_set], last[of_set] = starts[group], ends[group]
    return first, last


def _make_field_group(
    structure: Structure,
    unknown: Unknown,
    label: str,
    items: tuple[Property, ...],
    indices: IntArray,
    item: IntArray,
) -> ParameterGroup:
    """The group of a field: one parameter, a factor, for each shape function of its coarse grid that an element sees.

    `indices` (n_entries,) are positions among the property values, `item` (n_entries,) the index of the property of
    each in `items`. Raises `InputError` if `each`, `tied_to` or `factor = false` are set too. Names of parameters begin
    with `label`.
    """
    assert unknown.field is not None
    if unknown.each or unknown.tied_to is not None or unknown.factor is False:
        raise InputError(
            f"{unknown.property}[{label}] is a field of factors; leave `each`, `tied_to` and `factor` out of it"
        )
    functions, grid_points = field_functions(unknown.field, _element_centres(structure, items, indices, item))
    functions.sort_indices()
    entry, owner = functions.indices, np.repeat(np.arange(len(grid_points)), np.diff(functions.indptr))
    labels = tuple(f"{label}:field {grid_point}" for grid_point in grid_points)
    nominal = structure.values[indices[entry]]
    return ParameterGroup(
        unknown, labels, items, indices[entry], owner, item[entry], nominal, np.asarray(functions.data)
    )


def _element_centres(
    structure: Structure, items: tuple[Property, ...], indices: IntArray, item: IntArray
) -> FloatArray:
    """Mean position of the nodes of each entry's element, m, (n_entries, n_coordinates); ground nodes are left out.

    `indices` (n_entries,) are positions among the property values, `item` (n_entries,) the index of the property of
    each in `items`. An element with ground nodes alone has NaN.
    """
    tables = {element.name: element.nodes for element in structure.sets}
    labels = np.array(sorted(structure.nodes), dtype=np.int64)
    positions = np.array([structure.nodes[label] for label in labels.tolist()])
    middles = np.empty((len(indices), positions.shape[1]))
    for k, item_property in enumerate(items):
        of_item = item == k
        nodes = tables[item_property.element][indices[of_item] - item_property.values.start]
        real = nodes >= 0
        corners = positions[np.searchsorted(labels, np.where(real, nodes, labels[0]))] * real[:, :, None]
        middles[of_item] = corners.sum(axis=1) / real.sum(axis=1)[:, None]
    return middles


def named_members(structure: Structure, wanted: str, text: str) -> list[tuple[Property, IntArray]]:
    """Pairs of a property and its element rows (n_rows,), from 0, that `wanted` and `text`, an entry of `elements`, select.

    `text` is an element set such as ``girder``, or part of one such as ``girder:2-5``. The property `wanted` ``stiffness``
    stands for all stiffnesses of a set that has no property of that name.

    Raises
    ------
    InputError
        If there is no such element set, property or element.
    """
    names = list(dict.fromkeys(p.element for p in structure.properties))
    chosen = _SELECTION.match(text)
    name, selection = (text, None) if text in names or chosen is None else (chosen["name"], chosen)
    component = next((candidate.name for candidate in structure.components if name in candidate.elements), None)
    if component is not None:
        raise InputError(
            f"element set {name!r} is in component {component!r}, which is reduced once, so that no property of it can change:"
            f" take it out of the `elements` of the component, or name {component!r}, whose mass, stiffness and damping are"
            " factors of the whole"
        )
    if name not in names:
        if wanted in names and any(p.term.property == name for p in structure.properties):
            raise InputError(
                f"{wanted!r} is an element set and {name!r} its property; write `Unknown({name!r}, {wanted!r})`"
            )
        nearest = difflib.get_close_matches(name, names, 1, 0.0)
        raise InputError(f"there is no element set {name!r}" + (f"; the nearest is {nearest[0]!r}" if nearest else ""))
    of_set = [p for p in structure.properties if p.element == name]
    matches = [p for p in of_set if p.term.property == wanted]
    if not matches and wanted == "stiffness":
        matches = [p for p in of_set if p.term.kind == "stiffness"]
        used = [p for p in matches if p.term.values.any()]
        matches = used or matches
    if not matches:
        have = ", ".join(dict.fromkeys(p.term.property for p in of_set))
        raise InputError(f"element set {name!r} has no property {wanted!r}; it has {have}")
    count = len(matches[0].term.values)
    rows = np.arange(count)
    if selection is not None:
        first, last = int(selection["first"]), int(selection["last"] or selection["first"])
        if not 1 <= first <= last <= count:
            raise InputError(f"{text!r} asks for elements {first} to {last} of {name!r}, which has 1 to {count}")
        rows = np.arange(first - 1, last)
    return [(p, rows) for p in matches]


def require_distinct(groups: Sequence[ParameterGroup]) -> None:
    """Raise `InputError` if two parameters have the same name, or set the same property value.

    Shape functions of one field may share a value.
    """
    names = [name for group in groups for name in group.names]
    claimed = [group.indices if group.shares is None else np.unique(group.indices) for group in groups]
    all_indices = np.concatenate(claimed) if claimed else np.zeros(0, dtype=np.int64)
    if len(set(names)) == len(names) and len(np.unique(all_indices)) == len(all_indices):
        return
    taken: set[str] = set()
    owner: dict[int, tuple[ParameterGroup, str]] = {}
    for group in groups:
        for k, name in enumerate(group.names):
            if name in taken:
                raise InputError(f"two parameters are called {name}; give one of them a `name`")
            taken.add(name)
            last = group.first[k + 1] if k + 1 < group.n_params else len(group.indices)
            for index in group.indices[group.first[k] : last].tolist():
                other, owner_name = owner.setdefault(index, (group, name))
                if owner_name != name and (group.shares is None or other is not group):
                    raise InputError(f"{owner_name} and {name} claim the same value; take it out of one of them")
