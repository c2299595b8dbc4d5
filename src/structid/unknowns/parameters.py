"""Parameters: named unknowns in physical units, mapped to the property values of a structure."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import TypeVar

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, locked
from structid.core.display import Overview, Shown, format_number, plural
from structid.core.errors import InputError, require_class
from structid.fem import Structure
from structid.inversion.problem import OF_RECORD
from structid.unknowns.named_unknowns import MAY_VANISH, NamedUnknowns, Transform, Transforms, begun_at
from structid.unknowns.priors import Coupling, Prior, no_priors, priors_of
from structid.unknowns.unknown import ParameterGroup, Unknown, element_sets, label_of, parameter_group, require_distinct

#: Scatter, in parts, from which a choice by the data begins.
BEGUN = 0.05
Entry = TypeVar("Entry")
#: Part of its start that the deviation of a damping is held against at least: it may be absent.
_ABSENT = 0.25


@dataclass(frozen=True)
class Scatter:
    """Parameters that differ from record to record: log own = log common + std e, with e of unit variance.

    Parameters
    ----------
    name : str
        What reports call it: that of the declaration, such as ``stiffness[clamp]``.
    common : tuple of str
        Names of the common values.
    own : tuple of str
        Names of the values of one record, in the same order; () before `own_values`.
    given : float or None
        Standard deviation of the logarithms, where it is stated; None where the data choose it.
    std : float
        The same as it is used.
    """

    name: str
    common: tuple[str, ...]
    own: tuple[str, ...] = ()
    given: float | None = None
    std: float = BEGUN


@dataclass(frozen=True, eq=False, repr=False)
class Parameters(Shown, NamedUnknowns):
    """Named unknowns of a structure; property values are ``offset + design @ p`` for physical parameters p.

    Attributes
    ----------
    elements : tuple of tuple of str
        Element sets that each parameter belongs to.
    offset : (n_values,) float array
        Property values that do not depend on the parameters.
    design : (n_values, n_params) sparse array
        How the parameters make up the property values.
    scatters : tuple of Scatter
        Which of them differ from record to record.
    unknowns : tuple of Unknown
        The declarations that they were made of; see `parameters`.
    """

    elements: tuple[tuple[str, ...], ...]
    offset: FloatArray
    design: sparse.csc_array
    scatters: tuple[Scatter, ...] = field(default=(), kw_only=True)
    unknowns: tuple[Unknown, ...] = field(default=(), kw_only=True)

    def values(self, physical: FloatArray) -> FloatArray:
        """Property values of the structure, (n_values,), for parameters `physical` (n_params,) in physical units."""
        return self.offset + self.design @ physical

    def overview(self) -> Overview:
        """Heading with the number of parameters, and one row each: start, prior, unit and element sets."""
        words = f"{plural(self.n_params, 'parameter')}, {int(self.priors.stated.sum())} with a prior"
        rows = [
            (
                name,
                format_number(start),
                f"{format_number(mean)} ± {format_number(std, 2)}" if stated else "",
                unit,
                ", ".join(map(str, elements)),
            )
            for name, start, mean, std, stated, unit, elements in zip(
                self.names,
                self.start,
                self.priors.mean,
                self.priors.std,
                self.priors.stated,
                self.units,
                self.elements,
                strict=True,
            )
        ]
        return Overview(words, ("parameter", "start", "prior", "unit", "elements"), rows)

    @property
    def is_fixed(self) -> np.ndarray:
        """True for each property value that no parameter changes and that is not 0, (n_values,) bool."""
        return (np.diff(self.design.tocsr().indptr) == 0) & (self.offset != 0)

    @property
    def has_priors(self) -> bool:
        """True if anything is known of the parameters beside their ranges."""
        return bool(self.priors.stated.any() or self.couplings)

    def without_priors(self) -> Parameters:
        """Copy of the parameters with their ranges but without priors."""
        return replace(self, priors=no_priors(self.n_params), couplings=())

    def coupled(self, *couplings: Coupling) -> Parameters:
        """A copy with additional couplings (knowledge of combinations of parameters).

        Raises
        ------
        InputError
            If a coupling is of another number of parameters, or is logarithmic in one that may be negative.
        """
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


def _sizes(group: ParameterGroup) -> FloatArray:
    """Scale of each parameter of the group that deviations are held against even if its value is smaller, (n_params,).

    The initial size of parameters that may be negative, a quarter of it for positive ones that may be absent, such as
    damping; else 0.
    """
    part = 1.0 if group.limits[0] < 0 else _ABSENT * (_transform(group) == "log") * np.isin(group.kinds, MAY_VANISH)
    return np.abs(group.start) * part


def parameters(structure: Structure, unknowns: Unknown | Iterable[Unknown]) -> Parameters:
    """The named parameters that the declarations `unknowns`, one or several, make on `structure`.

    Raises
    ------
    InputError
        If a declaration is of another class or names an element, property or parameter that does not exist (the nearest is
        named), if two declarations claim the same value, if a start lies outside its range, or if a prior, a tie, a
        scatter or a tolerance does not suit its parameter.

    Examples
    --------
    >>> from structid.fem import Beam, Structure
    >>> beam = Beam("beam", [[0, 1], [1, 2]], mass=2.0, bending_stiffness=5.0)
    >>> cantilever = Structure({0: 0.0, 1: 1.0, 2: 2.0}, [beam], fixed=["0Y", "0RZ"])
    >>> parameters(cantilever, [Unknown("mass", "beam", each=True)]).names
    ('mass[beam:1]', 'mass[beam:2]')
    """
    require_class("structure", structure, Structure, "make it by `Structure(nodes, elements, fixed)`")
    require_class("unknowns", unknowns, (Unknown, Iterable), 'write [Unknown("stiffness", "springs")]')
    unknowns = (unknowns,) if isinstance(unknowns, Unknown) else tuple(unknowns)
    for unknown in unknowns:
        if not isinstance(unknown, Unknown):
            raise InputError(f"`unknowns` must hold declarations of class Unknown, got {type(unknown).__name__}")
    groups = [parameter_group(structure, unknown) for unknown in unknowns]
    require_distinct(groups)
    offset, design = _assemble_map(structure, groups)
    free = [group for group in groups if group.is_free]
    for group in free:
        _ = group.limits
    for group in free:
        prior = group.unknown.prior
        if prior is not None:
            require_class(f"prior of {group.names[0]}", prior, Prior, "write `Prior(mean, std)`")
        if prior is not None and prior.problem:
            raise InputError(f"prior of {group.names[0]} {prior.problem}")
        if prior is not None and prior.kind == "lognormal" and group.limits[0] < 0:
            raise InputError(f"{group.names[0]} must be kept positive for a log-normal prior; declare it `positive`")
    group_index = np.repeat(np.arange(len(free)), [group.n_params for group in free])
    limits = np.array([group.limits for group in free], dtype=float).reshape(-1, 2)[group_index]
    transforms = Transforms(_joined((_transform(group),) * group.n_params for group in free), *locked(limits.T))
    start = [group.start for group in free]
    sizes = [_sizes(group) for group in free]
    made = Parameters(
        names=_joined(group.names for group in free),
        kinds=_joined(group.kinds for group in free),
        units=_joined(group.units for group in free),
        elements=_joined(element_sets(group) for group in free),
        start=locked(np.concatenate(start) if start else np.zeros(0)),
        transforms=transforms,
        priors=priors_of(group.unknown.prior for group in free).at(group_index),
        scale=locked(np.concatenate(sizes) if sizes else np.zeros(0)),
        offset=locked(offset),
        design=design,
        scatters=tuple(_scatter_of(group) for group in groups if group.unknown.varies is not False),
        unknowns=unknowns,
    )
    _require_tolerances_of_fixed(structure, design)
    return made.started_at(made.start)


def redeclared(current: Parameters, structure: Structure, unknowns: Iterable[Unknown]) -> Parameters:
    """The parameters of the declarations `unknowns` on `structure`, which may both have changed since `current`.

    Parameters whose names stay begin where they did in `current`, unless that is out of their range now, and stay
    coupled.

    Raises
    ------
    InputError
        If a declaration cannot be used on `structure`, or a parameter that is coupled is gone.
    """
    made = begun_at(parameters(structure, unknowns), dict(zip(current.names, current.start.tolist(), strict=True)))
    if not current.couplings:
        return made
    used = np.logical_or.reduce([coupling.used for coupling in current.couplings])
    gone = [name for name, is_used in zip(current.names, used, strict=True) if is_used and name not in made.names]
    if gone:
        raise InputError(f"{gone[0]} is coupled to other parameters and must stay; leave the coupling out")
    index = np.array([made.names.index(name) if name in made.names else 0 for name in current.names])
    return replace(made, couplings=tuple(coupling.at(index, made.n_params) for coupling in current.couplings))


def _require_tolerances_of_fixed(structure: Structure, design: sparse.csc_array) -> None:
    """Raise `InputError` if an element set states a tolerance for a property all of whose values have rows in `design`.

    `design` is (n_values, n_params). Such a property is an unknown, and a tolerance is of what is fixed. A tolerance of
    the whole set is wrong if all properties of the set that are not 0 are unknowns.
    """
    is_sought = np.diff(design.tocsr().indptr) > 0
    for element in structure.elements:
        stated = element.tolerance
        properties = [item for item in structure.properties if item.element == element.name and item.term.values.any()]
        sought = [item.term.property for item in properties if is_sought[item.values].all()]
        wrong = [name for name in sought if isinstance(stated, Mapping) and name in stated]
        if stated is not None and not isinstance(stated, Mapping) and properties and len(sought) == len(properties):
            wrong = sought
        if wrong:
            raise InputError(
                f"`tolerance` of {element.name!r} is of {wrong[0]}, which is an unknown; state what is known of it as the `prior`"
                " of the unknown, or leave the tolerance out"
            )


def _scatter_of(group: ParameterGroup) -> Scatter:
    """The scatter of a group of parameters that is declared to vary from record to record, relative to their value.

    Without a stated size it begins at 0.05. Raises `InputError` if the group is fixed, tied or may be negative, or the
    declared scatter is not above 0.
    """
    name = group.names[0] if group.n_params == 1 else f"{group.unknown.property}[{label_of(group.unknown)}]"
    if not group.is_free:
        raise InputError(f"{name} must be free to vary from record to record; leave `fixed` and `tied_to` out of it")
    if group.limits[0] < 0:
        raise InputError(f"{name} must be kept positive to vary from record to record; declare it `positive`")
    stated = None if group.unknown.varies is True else float(group.unknown.varies)
    if stated is not None and not 0 < stated < np.inf:
        raise InputError(f"`varies` of {name} must be true, or its scatter as a part greater than 0, got {stated:g}")
    return Scatter(name, group.names, given=stated, std=stated or BEGUN)


def _assemble_map(structure: Structure, groups: list[ParameterGroup]) -> tuple[FloatArray, sparse.csc_array]:
    """Offset (n_values,) and design matrix (n_values, n_params): property values are offset + design @ parameters.

    Fixed groups are part of the offset; tied ones have entries in the column of the parameter that they follow.
    """
    first_column, n_free = {}, 0
    for group in groups:
        if group.is_free:
            first_column[id(group)] = n_free
            n_free += group.n_params
    offset = np.array(structure.values)
    for group in groups:
        offset[group.indices] = 0.0
    rows, columns, entries = [], [], []
    for group in groups:
        leader, ratio = _resolve_tie(group, groups)
        base = group.base * ratio
        followed = group.owner if leader is None else np.full(len(group.indices), leader[1])
        source = group if leader is None else leader[0]
        if id(source) in first_column:
            rows.append(group.indices)
            columns.append(first_column[id(source)] + followed)
            entries.append(base)
        else:
            np.add.at(offset, group.indices, base * source.start[followed])
    if not rows:
        return offset, sparse.csc_array((len(offset), 0))
    table = (np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns)))
    return offset, sparse.coo_array(table, (len(offset), n_free)).tocsc()


def _resolve_tie(
    group: ParameterGroup, groups: list[ParameterGroup]
) -> tuple[tuple[ParameterGroup, int] | None, float]:
    """The parameter (its group, its index there) that a tied group follows in the end, and the ratio to it.

    None and 1.0 for a group that is not tied. `groups` are all groups of the declarations. Raises `InputError` if there is no
    such parameter, or ties run in a circle.
    """
    if group.unknown.tied_to is None:
        return None, 1.0
    parameter_of = {name: (other, k) for other in groups for k, name in enumerate(other.names)}
    ratio, name, seen = 1.0, group.names[0], [group.names[0]]
    target = group.unknown.tied_to
    while True:
        if target not in parameter_of:
            nearest = difflib.get_close_matches(target, parameter_of, 1, 0.0)
            raise InputError(
                f"{name} is tied to {target!r}, which is no parameter"
                + (f"; the nearest is {nearest[0]!r}" if nearest else "")
            )
        ratio *= group.unknown.ratio
        group, k = parameter_of[target]
        name = target
        if name in seen:
            raise InputError(f"ties run in a circle: {' -> '.join([*seen, name])}")
        if group.unknown.tied_to is None:
            return (group, k), ratio
        seen.append(name)
        target = group.unknown.tied_to


def _transform(group: ParameterGroup) -> Transform:
    """Transform of the parameters of `group`: "interval" between two bounds, "log" if they must be positive, else "linear"."""
    if group.is_bounded:
        return "interval"
    return "log" if group.limits[0] >= 0 else "linear"


def _joined(parts: Iterable[tuple[Entry, ...]]) -> tuple[Entry, ...]:
    return tuple(chain.from_iterable(parts))


def own_name(name: str, title: str) -> str:
    """Name of a parameter's value in one record, such as ``stiffness[clamp] @ record 3``."""
    return f"{name}{OF_RECORD}{title}"


def own_values(parameters: Parameters, title: str) -> Parameters:
    """Copy of `parameters` extended, for the record `title`, by a value of its own for each parameter that varies by record.

    These values come last and make up the property values; the common ones act only through their scatter. Unchanged if
    nothing varies.
    """
    common = [name for scatter in parameters.scatters for name in scatter.common]
    if not common:
        return parameters
    index_of = {name: i for i, name in enumerate(parameters.names)}
    columns, n, m = np.array([index_of[name] for name in common]), parameters.n_params, len(common)
    design, is_kept, ranges = parameters.design.tocsc(), np.ones(n), parameters.transforms
    is_kept[columns] = 0.0
    design = sparse.csc_array(sparse.hstack([design @ sparse.diags_array(is_kept), design[:, columns]]))
    design.eliminate_zeros()
    return replace(
        parameters,
        names=(*parameters.names, *(own_name(name, title) for name in common)),
        kinds=(*parameters.kinds, *(parameters.kinds[i] for i in columns)),
        units=(*parameters.units, *(parameters.units[i] for i in columns)),
        elements=(*parameters.elements, *(parameters.elements[i] for i in columns)),
        start=locked(np.concatenate([parameters.start, parameters.start[columns]])),
        transforms=ranges.followed_by(ranges.at(columns)),
        priors=parameters.priors.followed_by(no_priors(m)),
        scale=locked(np.concatenate([parameters.scale, parameters.scale[columns]])),
        couplings=tuple(coupling.among(n + m, 0) for coupling in parameters.couplings),
        design=design,
        scatters=tuple(
            replace(scatter, own=tuple(own_name(name, title) for name in scatter.common))
            for scatter in parameters.scatters
        ),
    )


def with_scatter(parameters: Parameters, std: Mapping[str, float]) -> Parameters:
    """`parameters` with new standard deviations of their scatters; `std` maps names of scatters to deviations.

    Scatters that `std` does not name keep theirs.
    """
    if not parameters.scatters:
        return parameters
    scatters = tuple(replace(scatter, std=std.get(scatter.name, scatter.std)) for scatter in parameters.scatters)
    return replace(parameters, scatters=scatters)
