"""Element matrices of a structure with the values that weigh them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeAlias

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray
from structid.core.dof import DIRECTIONS
from structid.fem.elements.element import Layer, Term, shear_share
from structid.fem.matrices.blocks import ElementMatrices
from structid.fem.sliding import Lengthening

_LAWS = {
    "mass": "inertia",
    "rotary_inertia": "inertia",
    "viscous_damping": "viscous",
    "stiffness": "elastic",
    "axial_force": "elastic",
}


@dataclass(frozen=True, eq=False)
class Property:
    """One property of one element set, and where its values stand among all values of the structure."""

    element: str
    term: Term
    values: slice

    @property
    def label(self) -> str:
        return f"{self.term.property}[{self.element}]"


#: Where values stand among those of the structure, one an element.
Place: TypeAlias = slice | IntArray


class Factor(Protocol):
    """What multiplies the weights of element matrices and is not linear in the values."""

    @property
    def places(self) -> tuple[Place, ...]:
        """Where the values stand that it depends on, among the values of the structure; one an element."""
        ...

    def of(self, values: FloatArray) -> FloatArray:
        """The factors, (n_elements,)."""
        ...

    def slope(self, values: FloatArray, place: int) -> FloatArray:
        """Their derivatives with respect to the values at one of `places`, (n_elements,)."""
        ...

    def touched(self, changing: np.ndarray) -> np.ndarray:
        """Whether each changes with the values marked in `changing` (n_values,), (n_elements,)."""
        mask: np.ndarray = np.any([changing[place] for place in self.places], axis=0)
        return mask

    def change(self, values: FloatArray, design: sparse.csr_array) -> sparse.csr_array:
        """Their derivatives with respect to parameters that change values by `design`, (n_elements, n_params)."""
        slopes = ((place, self.slope(values, number)) for number, place in enumerate(self.places))
        return sum_of(design[place].multiply(slope[:, None]) for place, slope in slopes)


@dataclass(frozen=True, eq=False)
class ShearFactor(Factor):
    """The share G / (G + ratio E) of `ShearShare` over the nominal one, to a power; the element matrices hold the nominal.

    Attributes
    ----------
    bending, shear : slice
        Where E and G stand among the values of the structure.
    ratio : (n_elements,) float array
        1/m^2.
    nominal : (n_elements,) float array
        Share at the nominal values.
    power : int
    """

    bending: slice
    shear: slice
    ratio: FloatArray
    nominal: FloatArray
    power: int = 1

    @property
    def places(self) -> tuple[slice, ...]:
        """See `Factor.places`."""
        return (self.bending, self.shear)

    def of(self, values: FloatArray) -> FloatArray:
        """See `Factor.of`."""
        shares: FloatArray = (
            shear_share(values[self.bending], values[self.shear], self.ratio) / self.nominal
        ) ** self.power
        return shares

    def slope(self, values: FloatArray, place: int) -> FloatArray:
        """See `Factor.slope`."""
        bending, shear = values[self.bending], values[self.shear]
        whole = shear + self.ratio * bending
        common = self.ratio / whole**2 / self.nominal * self.power * (shear / whole / self.nominal) ** (self.power - 1)
        return common * (-shear, bending)[place]


@dataclass(frozen=True, eq=False)
class Monomial(Factor):
    """A product of powers of values over their references, a number an element; element matrices hold the references.

    Attributes
    ----------
    at : tuple of slice
        Where the values stand among the values of the structure.
    references : tuple of (n_elements,) float array or float
        Nominal thicknesses, for one.
    exponents : tuple of int
        Of a thickness 1 for membrane stiffness and mass, 3 for bending.
    """

    at: tuple[slice, ...]
    references: tuple[FloatArray | float, ...]
    exponents: tuple[int, ...]

    @property
    def places(self) -> tuple[slice, ...]:
        """See `Factor.places`."""
        return self.at

    def of(self, values: FloatArray) -> FloatArray:
        """See `Factor.of`."""
        first, *others = self._powers(values)
        return math.prod(others, start=first)

    def slope(self, values: FloatArray, place: int) -> FloatArray:
        """See `Factor.slope`."""
        powers = self._powers(values)
        at, reference, exponent = self._parts[place]
        slope = exponent * (values[at] / reference) ** (exponent - 1) / reference
        return math.prod((*powers[:place], *powers[place + 1 :]), start=slope)

    @property
    def _parts(self) -> list[tuple[slice, FloatArray | float, int]]:
        return list(zip(self.at, self.references, self.exponents, strict=True))

    def _powers(self, values: FloatArray) -> list[FloatArray]:
        return [(values[place] / reference) ** exponent for place, reference, exponent in self._parts]


@dataclass(frozen=True, eq=False)
class LengthFactor(Factor):
    """(length / nominal length) to a power, a number an element; the element matrices hold the nominal one.

    Attributes
    ----------
    lengthening : Lengthening
    power : int
        Such as -3 of bending stiffness, 1 of mass.
    """

    lengthening: Lengthening
    power: int

    @property
    def places(self) -> tuple[Place, ...]:
        """See `Factor.places`."""
        return self.lengthening.at

    def of(self, values: FloatArray) -> FloatArray:
        """See `Factor.of`."""
        powers: FloatArray = self.lengthening.ratio(values) ** self.power
        return powers

    def slope(self, values: FloatArray, place: int) -> FloatArray:
        """See `Factor.slope`, 1/m."""
        steep = self.power * self.lengthening.ratio(values) ** (self.power - 1) / self.lengthening.lengths
        return steep * self.lengthening.slopes[place]


@dataclass(frozen=True, eq=False)
class Contribution:
    """Element matrices on free degrees of freedom, with the values that weigh them.

    The weight of element e is ``values[value][e]``, times ``values[factor][e]`` for structural damping
    (stiffness times loss factor), times what `scale` gives where the element has a thickness, shears or has an end that
    slides, or where it is an entry of a modal damping.

    `law` says how it enters the dynamic stiffness: ``inertia`` by -omega^2, ``viscous`` by i omega, ``elastic``
    by 1, ``structural`` by i, ``friction:NAME`` by i over the sliding amplitude of the friction element NAME.
    """

    law: str
    blocks: ElementMatrices
    value: Place
    factor: slice | None = None
    scale: Factor | None = None

    @property
    def first(self) -> int:
        """Where the first of its values stands."""
        return int(np.r_[self.value][0])

    @property
    def is_product(self) -> bool:
        """Whether the weight is a product of several values."""
        return self.factor is not None or self.scale is not None

    @property
    def places(self) -> tuple[Place, ...]:
        """Where the values stand that make up the weights."""
        factor: tuple[Place, ...] = () if self.factor is None else (self.factor,)
        return (self.value, *factor, *(() if self.scale is None else self.scale.places))

    def weights(self, values: FloatArray) -> FloatArray:
        """Weight of each element, (n_elements,)."""
        own = values[self.value]
        if self.factor is not None:
            own = own * values[self.factor]
        return own if self.scale is None else own * self.scale.of(values)

    def touched(self, changing: np.ndarray) -> np.ndarray:
        """Whether each element's weight changes with the values marked in `changing` (n_values,), (n_elements,)."""
        places = (self.value,) if self.factor is None else (self.value, self.factor)
        mask: np.ndarray = np.any([changing[place] for place in places], axis=0)
        return mask if self.scale is None else mask | self.scale.touched(changing)

    def change(self, values: FloatArray, design: sparse.csr_array) -> sparse.csr_array:
        """Derivative of the weights with respect to parameters that change values by `design`, (n_elements, n_params)."""
        if not self.is_product:
            return design[self.value]
        own, factor = values[self.value], 1.0 if self.factor is None else values[self.factor]
        parts = [design[self.value].multiply(self.slope(values, 0)[:, None])]
        if self.factor is not None:
            parts.append(design[self.factor].multiply(self.slope(values, 1)[:, None]))
        if self.scale is not None:
            parts.append(self.scale.change(values, design).multiply((own * factor)[:, None]))
        return sum_of(parts)

    def slope(self, values: FloatArray, place: int) -> FloatArray:
        """Derivative of the weights with respect to the values at one of `places`, (n_elements,)."""
        factor = 1.0 if self.factor is None else values[self.factor]
        own, before = values[self.value], 1 if self.factor is None else 2
        if self.scale is not None and place >= before:
            return own * factor * self.scale.slope(values, place - before)
        scale = 1.0 if self.scale is None else self.scale.of(values)
        return np.full(own.shape, factor * scale) if place == 0 else own * scale


def sum_of(matrices: Iterable[sparse.sparray]) -> sparse.csr_array:
    """Their sum."""
    first, *others = matrices
    return sparse.csr_array(sum(others, first))


def weighed(
    properties: Sequence[Property],
    blocks_of: Callable[[Layer], ElementMatrices],
    lengthenings: Mapping[str, Lengthening],
) -> tuple[Contribution, ...]:
    """What every property contributes.

    Parameters
    ----------
    properties : sequence of Property
    blocks_of : callable
        The matrices of a layer on free degrees of freedom.
    lengthenings : mapping of str to Lengthening
        Of element sets with ends that slide.
    """
    found: list[Contribution] = []
    elastic: dict[str, list[Contribution]] = {}
    blocks: dict[int, ElementMatrices] = {}  # properties with the same matrices share them
    for item in properties:
        if item.term.kind == "loss_factor":
            found += [replace(part, law="structural", factor=item.values) for part in elastic.get(item.element, [])]
        for layer in item.term.layers:
            law = layer.law or (f"friction:{item.element}" if item.term.kind == "friction" else _LAWS[item.term.kind])
            if id(layer) not in blocks:
                blocks[id(layer)] = blocks_of(layer)
            scale = _scale(properties, item.element, layer, lengthenings)
            found.append(Contribution(law, blocks[id(layer)], item.values, scale=scale))
            if law == "elastic" and item.term.kind != "axial_force":  # a force has no loss
                elastic.setdefault(item.element, []).append(found[-1])
    return tuple(found)


def rigid_mass(
    properties: Sequence[Property],
    values: FloatArray,
    directions: Sequence[str],
    lengthenings: Mapping[str, Lengthening],
) -> tuple[float, FloatArray]:
    """Mass that takes part in rigid motion along the first of `directions` that has any, and its derivative with respect to every
    value; see `Structure.mass_of`.
    """
    total, gradient = 0.0, np.zeros(len(values))
    pairs = [(item, layer) for item in properties for layer in item.term.layers]
    masses = [
        (i, layer) for i, layer in pairs if (i.term.kind == "mass" or layer.law == "inertia") and not layer.reduced
    ]
    for direction in directions:
        for item, layer in masses:
            unit = _rigid(layer, DIRECTIONS.index(direction))
            scale = _scale(properties, item.element, layer, lengthenings)
            factor = 1.0 if scale is None else scale.of(values)
            gradient[item.values] += unit * factor
            total += float(unit * factor @ values[item.values])
            if scale is not None:
                for number, place in enumerate(scale.places):
                    rows = np.arange(len(values))[place]
                    np.add.at(gradient, rows, unit * values[item.values] * scale.slope(values, number))
        if gradient.any():
            break
    return total, gradient


def _scale(
    properties: Sequence[Property], element: str, layer: Layer, lengthenings: Mapping[str, Lengthening]
) -> Factor | None:
    """What multiplies the weights of a layer of `element` that goes with a thickness, a length or powers, or that shears."""
    if layer.stretch:
        return LengthFactor(lengthenings[element], layer.stretch)
    if layer.shear is not None:
        own = {p.term.property: p for p in properties if p.element == element}
        bending, shear = own[layer.shear.bending], own[layer.shear.shear]
        share = shear_share(bending.term.values, shear.term.values, layer.shear.ratio)
        return ShearFactor(bending.values, shear.values, layer.shear.ratio, share, layer.shear.power)
    if layer.powers:
        own = {p.term.property: p for p in properties if p.element == element}
        parts = [(own[power.property].values, power.reference, power.exponent) for power in layer.powers]
        return Monomial(*zip(*parts, strict=True))
    if layer.power == 0:
        return None
    found = next(p for p in properties if p.element == element and p.term.kind == "thickness")
    return Monomial((found.values,), (found.term.values,), (layer.power,))


def _rigid(layer: Layer, axis: int) -> FloatArray:
    """r' B_e r for rigid motion along `axis`, (n_elements,)."""
    motion = ((layer.codes >= 0) & (layer.codes % 6 == axis)).astype(np.float64)
    if layer.whole is not None:
        return np.array([motion[0] @ (layer.whole @ motion[0])])
    return np.einsum("ei,eij,ej->e", motion, layer.local, motion)
