"""What is unknown: named parameters in physical units, mapped to the property values of a structure."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import TypeVar

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, locked
from structid.core.errors import InputError
from structid.fem import Structure
from structid.unknowns.families import Family, element_sets, family, label_of, require_distinct
from structid.unknowns.named_unknowns import MAY_VANISH, NamedUnknowns, begun_at
from structid.unknowns.priors import Coupling, no_priors, priors_of
from structid.unknowns.scatter import BEGUN, Scatter
from structid.unknowns.transforms import Transform, Transforms
from structid.unknowns.unknown import Unknown

Entry = TypeVar("Entry")


@dataclass(frozen=True, eq=False)
class Parameters(NamedUnknowns):
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
        """Property values of the structure for physical parameters, (n_values,)."""
        return self.offset + self.design @ physical

    @property
    def has_priors(self) -> bool:
        """Whether anything is known of the parameters beside their ranges."""
        return bool(self.priors.stated.any() or self.couplings)

    def without_priors(self) -> Parameters:
        """The same parameters with nothing known of them but their ranges."""
        return replace(self, priors=no_priors(self.n_params), couplings=())

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


#: Part of its start that the deviation of a damping is held against at least: it may be absent.
_ABSENT = 0.25


def _sizes(one: Family) -> FloatArray:
    """What the deviations of parameters that may vanish are held against then, as they may be well known at that; else 0."""
    part = 1.0 if one.limits[0] < 0 else _ABSENT * (_transform(one) == "log") * np.isin(one.kinds, MAY_VANISH)
    return np.abs(one.start) * part


def parameters(structure: Structure, unknowns: Iterable[Unknown]) -> Parameters:
    """The named parameters that `unknowns` declare on `structure`.

    Raises
    ------
    InputError
        If a declaration names an element, property or parameter that does not exist (the nearest is named), if
        two declarations claim the same value, or if a start lies outside its range.

    Examples
    --------
    >>> from structid.fem import Beam, Structure
    >>> beam = Beam("beam", [[0, 1], [1, 2]], mass=2.0, bending_stiffness=5.0)
    >>> cantilever = Structure({0: 0.0, 1: 1.0, 2: 2.0}, [beam], fixed=["0Y", "0RZ"])
    >>> parameters(cantilever, [Unknown("mass", "beam", each=True)]).names
    ('mass[beam:1]', 'mass[beam:2]')
    """
    unknowns = tuple(unknowns)
    families = [family(structure, unknown) for unknown in unknowns]
    require_distinct(families)
    offset, design = _map(structure, families)
    free = [one for one in families if one.is_free]
    for one in free:
        _ = one.limits
    for one in free:
        prior = one.unknown.prior
        if prior is not None and prior.problem:
            raise InputError(f"prior of {one.names[0]} {prior.problem}")
        if prior is not None and prior.kind == "lognormal" and one.limits[0] < 0:
            raise InputError(f"{one.names[0]} must be kept positive for a log-normal prior; declare it `positive`")
    family_of = np.repeat(np.arange(len(free)), [one.n_params for one in free])
    limits = np.array([one.limits for one in free], dtype=float).reshape(-1, 2)[family_of]
    transforms = Transforms(_joined((_transform(one),) * one.n_params for one in free), *locked(limits.T))
    start = [one.start for one in free]
    sizes = [_sizes(one) for one in free]
    made = Parameters(
        names=_joined(one.names for one in free),
        kinds=_joined(one.kinds for one in free),
        units=_joined(one.units for one in free),
        elements=_joined(element_sets(one) for one in free),
        start=locked(np.concatenate(start) if start else np.zeros(0)),
        transforms=transforms,
        priors=priors_of(one.unknown.prior for one in free).at(family_of),
        scale=locked(np.concatenate(sizes) if sizes else np.zeros(0)),
        offset=locked(offset),
        design=design,
        scatters=tuple(_scatter(one) for one in families if one.unknown.varies is not False),
        unknowns=unknowns,
    )
    _require_tolerances_of_held(structure, design)
    return made.started_at(made.start)


def redeclared(known: Parameters, structure: Structure, unknowns: Iterable[Unknown]) -> Parameters:
    """The parameters of other declarations or of a changed structure; names that stay begin where they did, and stay coupled.

    Raises
    ------
    InputError
        As `parameters` does, or if a parameter that is coupled is gone.
    """
    made = begun_at(parameters(structure, unknowns), dict(zip(known.names, known.start.tolist(), strict=True)))
    if not known.couplings:
        return made
    used = np.logical_or.reduce([coupling.used for coupling in known.couplings])
    gone = [name for name, is_used in zip(known.names, used, strict=True) if is_used and name not in made.names]
    if gone:
        raise InputError(f"{gone[0]} is coupled to other parameters and must stay; leave the coupling out")
    index = np.array([made.names.index(name) if name in made.names else 0 for name in known.names])
    return replace(made, couplings=tuple(coupling.at(index, made.n_params) for coupling in known.couplings))


def _require_tolerances_of_held(structure: Structure, design: sparse.csc_array) -> None:
    """Raise `InputError` where an element set states how well a property is known that is sought."""
    is_sought = np.diff(design.tocsr().indptr) > 0
    for element in structure.elements:
        stated = element.tolerance
        own = [item for item in structure.properties if item.element == element.name and item.term.values.any()]
        sought = [item.term.property for item in own if is_sought[item.values].all()]
        wrong = [name for name in sought if isinstance(stated, Mapping) and name in stated]
        if stated is not None and not isinstance(stated, Mapping) and own and len(sought) == len(own):
            wrong = sought
        if wrong:
            raise InputError(
                f"`tolerance` of {element.name!r} is of {wrong[0]}, which is an unknown; state what is known of it as the `prior`"
                " of the unknown, or leave the tolerance out"
            )


def _scatter(one: Family) -> Scatter:
    """That of a declaration that varies from record to record."""
    name = one.names[0] if one.n_params == 1 else f"{one.unknown.property}[{label_of(one.unknown)}]"
    if not one.is_free:
        raise InputError(f"{name} must be free to vary from record to record; leave `fixed` and `tied_to` out of it")
    if one.limits[0] < 0:
        raise InputError(f"{name} must be kept positive to vary from record to record; declare it `positive`")
    given = None if one.unknown.varies is True else float(one.unknown.varies)
    if given is not None and not 0 < given < np.inf:
        raise InputError(f"`varies` of {name} must be true, or its scatter as a part greater than 0, got {given:g}")
    return Scatter(name, one.names, given=given, std=given or BEGUN)


def _map(structure: Structure, families: list[Family]) -> tuple[FloatArray, sparse.csc_array]:
    """Offset and design of `Parameters`."""
    first_column, n_free = {}, 0
    for one in families:
        if one.is_free:
            first_column[id(one)] = n_free
            n_free += one.n_params
    offset = np.array(structure.values)
    for one in families:
        offset[one.indices] = 0.0
    rows, columns, entries = [], [], []
    for one in families:
        leader, ratio = _leader(one, families)
        base = one.base * ratio
        followed = one.owner if leader is None else np.full(len(one.indices), leader[1])
        source = one if leader is None else leader[0]
        if id(source) in first_column:
            rows.append(one.indices)
            columns.append(first_column[id(source)] + followed)
            entries.append(base)
        else:
            np.add.at(offset, one.indices, base * source.start[followed])
    if not rows:
        return offset, sparse.csc_array((len(offset), 0))
    table = (np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns)))
    return offset, sparse.coo_array(table, (len(offset), n_free)).tocsc()


def _leader(one: Family, families: list[Family]) -> tuple[tuple[Family, int] | None, float]:
    """What all parameters of `one` follow in the end (None for themselves), and the multiple of it."""
    if one.unknown.tied_to is None:
        return None, 1.0
    places = {name: (own, k) for own in families for k, name in enumerate(own.names)}
    ratio, name, seen = 1.0, one.names[0], [one.names[0]]
    target = one.unknown.tied_to
    while True:
        if target not in places:
            near = difflib.get_close_matches(target, places, 1, 0.0)
            raise InputError(
                f"{name} is tied to {target!r}, which is no parameter"
                + (f"; the nearest is {near[0]!r}" if near else "")
            )
        ratio *= one.unknown.ratio
        one, k = places[target]
        name = target
        if name in seen:
            raise InputError(f"ties run in a circle: {' -> '.join([*seen, name])}")
        if one.unknown.tied_to is None:
            return (one, k), ratio
        seen.append(name)
        target = one.unknown.tied_to


def _transform(one: Family) -> Transform:
    if one.is_bounded:
        return "interval"
    return "log" if one.limits[0] >= 0 else "linear"


def _joined(parts: Iterable[tuple[Entry, ...]]) -> tuple[Entry, ...]:
    return tuple(chain.from_iterable(parts))
