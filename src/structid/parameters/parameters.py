"""What is unknown: named parameters in physical units, mapped to the property values of a structure."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from structid.arrays import FloatArray, locked
from structid.errors import InputError
from structid.parameters.field import field_functions
from structid.parameters.priors import Coupling, prior_entries, prior_rows
from structid.parameters.transforms import Transform, Transforms
from structid.parameters.unknown import Unknown
from structid.structure import Property, Structure

_SELECTION = re.compile(r"^(?P<name>.+?):(?P<first>\d+)(?:-(?P<last>\d+))?$")


@dataclass(frozen=True, eq=False)
class Parameters:
    """Named unknowns of a structure; property values are ``offset + design @ p`` for physical parameters p.

    Attributes
    ----------
    names, kinds, units : tuple of str
        One entry a parameter, such as ``mass[plate 2]``, ``mass``, ``kg``.
    elements : tuple of tuple of str
        Element sets that each parameter belongs to.
    start : (n_params,) float array
        Initial physical values.
    transforms : Transforms
        How each parameter is kept in its range.
    prior_mean, prior_std : (n_params,) float arrays
        Prior in physical units; NaN where there is none.
    prior_lognormal : (n_params,) bool array
        Whether the prior is log-normal instead of Gaussian.
    offset : (n_values,) float array
        Property values that do not depend on the parameters.
    design : (n_values, n_params) sparse array
        How the parameters make up the property values.
    couplings : tuple of Coupling
        What is known of several parameters together: correlated priors, smoothness, sparsity.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    units: tuple[str, ...]
    elements: tuple[tuple[str, ...], ...]
    start: FloatArray
    transforms: Transforms
    prior_mean: FloatArray
    prior_std: FloatArray
    prior_lognormal: np.ndarray
    offset: FloatArray
    design: sparse.csc_array
    couplings: tuple[Coupling, ...] = ()

    @property
    def n_params(self) -> int:
        return len(self.names)

    @property
    def theta_start(self) -> FloatArray:
        """Free variables of the initial values."""
        return self.transforms.free(self.start)

    def values(self, physical: FloatArray) -> FloatArray:
        """Property values of the structure for physical parameters, (n_values,)."""
        return self.offset + self.design @ physical

    def prior_rows(self, physical: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Whitened residual of the priors and couplings, and its derivative with respect to the physical parameters.

        Shapes (n_rows,) and (n_rows, n_params): one row a parameter with a prior, then those of the couplings.
        """
        parts = [prior_rows(physical, self.prior_mean, self.prior_std, self.prior_lognormal)]
        parts += [coupling.rows(physical) for coupling in self.couplings]
        return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])

    def prior_residual(self, physical: FloatArray) -> FloatArray:
        """The residual of `prior_rows` alone, (n_rows,)."""
        own = prior_entries(physical, self.prior_mean, self.prior_std, self.prior_lognormal)[1]
        return np.concatenate([own, *(coupling.residual(physical) for coupling in self.couplings)])

    def sparse_prior_rows(self, physical: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        """`prior_rows` with the derivative as a sparse (n_rows, n_params) array."""
        rows, residual, slope = prior_entries(physical, self.prior_mean, self.prior_std, self.prior_lognormal)
        own = sparse.csr_array((slope, (np.arange(len(rows)), rows)), (len(rows), self.n_params))
        parts = [(residual, own), *(coupling.sparse_rows(physical) for coupling in self.couplings)]
        return np.concatenate([part[0] for part in parts]), sparse.csr_array(sparse.vstack([p[1] for p in parts]))

    @property
    def has_priors(self) -> bool:
        """Whether anything is known of the parameters beside their ranges."""
        return bool(np.isfinite(self.prior_std).any() or self.couplings)

    def without_priors(self) -> Parameters:
        """The same parameters with nothing known of them but their ranges."""
        nothing = locked(np.full(self.n_params, np.nan))
        none = locked(np.zeros(self.n_params), bool)
        return replace(self, prior_mean=nothing, prior_std=nothing, prior_lognormal=none, couplings=())

    def coupled(self, *couplings: Coupling) -> Parameters:
        """The same parameters with more knowledge of their combinations."""
        for coupling in couplings:
            if coupling.matrix.shape[1] != self.n_params:
                raise InputError(
                    f"coupling {coupling.name!r} must have {self.n_params} columns, one a parameter, got"
                    f" {coupling.matrix.shape[1]}; make it for these parameters"
                )
            used = coupling.used & (self.transforms.lower < 0)
            if coupling.logarithmic and used.any():
                name = self.names[int(np.argmax(used))]
                raise InputError(f"{name} must be kept positive for {coupling.name}; declare it `positive`")
        return replace(self, couplings=(*self.couplings, *couplings))

    def started_at(self, physical: FloatArray) -> Parameters:
        """The same parameters with other initial values."""
        for name, value, low, high in zip(
            self.names, physical, self.transforms.lower, self.transforms.upper, strict=True
        ):
            if not low < value < high:
                raise InputError(f"initial value of {name} must lie between {low:g} and {high:g}, got {value:g}")
        return replace(self, start=locked(physical, np.float64))

    def kept_near_start(self, relative: float) -> Parameters:
        """The same parameters, each without a prior drawn to its start by one of `relative` standard deviation."""
        width = relative * np.abs(self.start)
        free = ~np.isfinite(self.prior_std) & (width > 0)
        mean, std = np.where(free, self.start, self.prior_mean), np.where(free, width, self.prior_std)
        return replace(self, prior_mean=locked(mean), prior_std=locked(std))


@dataclass(frozen=True)
class _Group:
    """One parameter in the making: the property values it stands for, and its share in each of them."""

    unknown: Unknown
    label: str
    members: tuple[tuple[Property, tuple[int, ...]], ...]
    shares: FloatArray | None = None

    @property
    def name(self) -> str:
        return f"{self.unknown.property}[{self.label}]"

    @property
    def indices(self) -> np.ndarray:
        return np.concatenate([p.values.start + np.array(rows, dtype=np.int64) for p, rows in self.members])


def parameters(structure: Structure, unknowns: Iterable[Unknown]) -> Parameters:
    """The named parameters that `unknowns` declare on `structure`.

    Raises
    ------
    InputError
        If a declaration names an element, property or parameter that does not exist (the nearest is named), if
        two declarations claim the same value, or if a start lies outside its range.

    Examples
    --------
    >>> from structid.structure import Beam, Structure
    >>> beam = Beam("beam", [[0, 1], [1, 2]], mass=2.0, bending_stiffness=5.0)
    >>> cantilever = Structure({0: 0.0, 1: 1.0, 2: 2.0}, [beam], fixed=["0Y", "0RZ"])
    >>> parameters(cantilever, [Unknown("mass", "beam", each=True)]).names
    ('mass[beam:1]', 'mass[beam:2]')
    """
    groups = [group for unknown in unknowns for group in _groups(structure, unknown)]
    _require_distinct(structure, groups)
    names = [group.name for group in groups]
    free = [g for g in groups if g.unknown.tied_to is None and not g.unknown.fixed]
    column = {group.name: i for i, group in enumerate(free)}
    offset = np.array(structure.values)
    for group in groups:
        offset[group.indices] = 0.0
    rows, columns, entries = [], [], []
    for group in groups:
        leader, ratio = _leader(group, groups, names)
        base = _base(structure, group)
        index = group.indices
        if leader.name in column:
            rows.append(index)
            columns.append(np.full(len(index), column[leader.name]))
            entries.append(base * ratio)
        else:
            offset[index] += base * ratio * _start(structure, leader)
    if rows:
        table = (np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns)))
        design = sparse.coo_array(table, (len(offset), len(free))).tocsc()
    else:
        design = sparse.csc_array((len(offset), 0))
    kinds = tuple(_transform(g) for g in free)
    limits = [_limits(g) for g in free]
    transforms = Transforms(
        kinds, locked([low for low, _ in limits], float), locked([high for _, high in limits], float)
    )
    priors = [g.unknown.prior for g in free]
    for group, prior in zip(free, priors, strict=True):
        if prior is not None and prior.problem:
            raise InputError(f"prior of {group.name} {prior.problem}")
        if prior is not None and prior.kind == "lognormal" and _limits(group)[0] < 0:
            raise InputError(f"{group.name} must be kept positive for a log-normal prior; declare it `positive`")
    made = Parameters(
        names=tuple(g.name for g in free),
        kinds=tuple(g.members[0][0].term.kind for g in free),
        units=tuple("1" if _is_factor(structure, g) else g.members[0][0].term.unit for g in free),
        elements=tuple(tuple(dict.fromkeys(p.element for p, _ in g.members)) for g in free),
        start=locked([_start(structure, g) for g in free], float),
        transforms=transforms,
        prior_mean=locked([p.mean if p else np.nan for p in priors], float),
        prior_std=locked([p.std if p else np.nan for p in priors], float),
        prior_lognormal=locked([p is not None and p.kind == "lognormal" for p in priors], bool),
        offset=locked(offset),
        design=design,
    )
    return made.started_at(made.start)


def _groups(structure: Structure, unknown: Unknown) -> list[_Group]:
    """The parameters that one declaration makes."""
    texts = (unknown.elements,) if isinstance(unknown.elements, str) else tuple(unknown.elements)
    if not texts:
        raise InputError(f"unknown {unknown.property!r} names no elements")
    members = [member for text in texts for member in named_members(structure, unknown.property, text)]
    if unknown.field is not None:
        return _field_groups(structure, unknown, unknown.name or ", ".join(texts), members)
    if not unknown.each:
        return [_Group(unknown, unknown.name or ", ".join(texts), tuple(members))]
    made: dict[str, list[tuple[Property, tuple[int, ...]]]] = {}
    for item, rows in members:
        for row in rows:
            label = f"{unknown.name or item.element}:{row + 1}" if len(item.term.values) > 1 else item.element
            made.setdefault(label, []).append((item, (row,)))
    return [_Group(unknown, label, tuple(parts)) for label, parts in made.items()]


def _field_groups(
    structure: Structure, unknown: Unknown, label: str, members: list[tuple[Property, tuple[int, ...]]]
) -> list[_Group]:
    """One parameter for each function of a field."""
    assert unknown.field is not None
    if unknown.each or unknown.tied_to is not None or unknown.factor is False:
        raise InputError(
            f"{unknown.property}[{label}] is a field of factors; leave `each`, `tied_to` and `factor` out of it"
        )
    tables = {element.name: element.nodes for element in structure.elements}
    middles = np.array(
        [
            np.mean([structure.nodes[int(n)] for n in tables[item.element][row] if n >= 0], axis=0)
            for item, rows in members
            for row in rows
        ]
    )
    functions, places = field_functions(unknown.field, middles)
    made = []
    for k, place in enumerate(places):
        seen, shares = functions[:, [k]].nonzero()[0], functions[:, [k]].toarray()[:, 0]
        kept: list[tuple[Property, tuple[int, ...]]] = []
        start = 0
        for item, rows in members:
            own = tuple(rows[i - start] for i in seen if start <= i < start + len(rows))
            kept += [(item, own)] if own else []
            start += len(rows)
        made.append(_Group(unknown, f"{label}:field {place}", tuple(kept), shares[seen]))
    return made


def named_members(structure: Structure, wanted: str, text: str) -> list[tuple[Property, tuple[int, ...]]]:
    """Properties and element rows that `wanted` and one entry of `elements` name."""
    names = list(dict.fromkeys(p.element for p in structure.properties))
    chosen = _SELECTION.match(text)
    name, selection = (text, None) if text in names or chosen is None else (chosen["name"], chosen)
    if name not in names:
        near = difflib.get_close_matches(name, names, 1, 0.0)
        raise InputError(f"there is no element set {name!r}" + (f"; the nearest is {near[0]!r}" if near else ""))
    own = [p for p in structure.properties if p.element == name]
    found = [p for p in own if p.term.property == wanted]
    if not found and wanted == "stiffness":
        found = [p for p in own if p.term.kind == "stiffness"]
        used = [p for p in found if p.term.values.any()]
        found = used or found
    if not found:
        have = ", ".join(dict.fromkeys(p.term.property for p in own))
        raise InputError(f"element set {name!r} has no property {wanted!r}; it has {have}")
    count = len(found[0].term.values)
    rows = tuple(range(count))
    if selection is not None:
        first, last = int(selection["first"]), int(selection["last"] or selection["first"])
        if not 1 <= first <= last <= count:
            raise InputError(f"{text!r} asks for elements {first} to {last} of {name!r}, which has 1 to {count}")
        rows = tuple(range(first - 1, last))
    return [(p, rows) for p in found]


def _require_distinct(structure: Structure, groups: list[_Group]) -> None:
    owner: dict[int, _Group] = {}
    names: set[str] = set()
    for group in groups:
        if group.name in names:
            raise InputError(f"two parameters are called {group.name}; give one of them a `name`")
        names.add(group.name)
        for index in group.indices.tolist():
            other = owner.setdefault(index, group)
            if other is not group and (group.shares is None or other.unknown is not group.unknown):
                raise InputError(f"{other.name} and {group.name} claim the same value; take it out of one of them")


def _is_factor(structure: Structure, group: _Group) -> bool:
    if group.unknown.factor is not None or group.shares is not None:
        return group.unknown.factor is not False
    if len({p.term.property for p, _ in group.members}) > 1:
        return True
    nominal = structure.values[group.indices]
    return bool(np.ptp(nominal) > 0)


def _base(structure: Structure, group: _Group) -> FloatArray:
    nominal = structure.values[group.indices]
    if not _is_factor(structure, group):
        return np.ones(len(nominal))
    if not nominal.any():
        raise InputError(
            f"{group.name} is a factor on nominal values that are all 0; set nominal values or `factor = false`"
        )
    return nominal if group.shares is None else nominal * group.shares


def _start(structure: Structure, group: _Group) -> float:
    if group.unknown.start is not None:
        return float(group.unknown.start)
    return 1.0 if _is_factor(structure, group) else float(structure.values[group.indices][0])


def _leader(group: _Group, groups: list[_Group], names: list[str]) -> tuple[_Group, float]:
    """The parameter that `group` follows in the end, and the multiple of it."""
    ratio, seen = 1.0, [group.name]
    while group.unknown.tied_to is not None:
        target = group.unknown.tied_to
        if target not in names:
            near = difflib.get_close_matches(target, names, 1, 0.0)
            raise InputError(
                f"{group.name} is tied to {target!r}, which is no parameter"
                + (f"; the nearest is {near[0]!r}" if near else "")
            )
        ratio *= group.unknown.ratio
        group = groups[names.index(target)]
        if group.name in seen:
            raise InputError(f"ties run in a circle: {' -> '.join([*seen, group.name])}")
        seen.append(group.name)
    return group, ratio


def _transform(group: _Group) -> Transform:
    if group.unknown.bounds is not None:
        return "interval"
    return "log" if group.unknown.positive else "linear"


def _limits(group: _Group) -> tuple[float, float]:
    if group.unknown.bounds is not None:
        low, high = group.unknown.bounds
        if not low < high:
            raise InputError(f"bounds of {group.name} must increase, got {group.unknown.bounds}")
        return float(low), float(high)
    return (0.0, np.inf) if group.unknown.positive else (-np.inf, np.inf)
