"""Element matrices of a structure with the values that weigh them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from structid.arrays import FloatArray
from structid.dof import DIRECTIONS
from structid.structure.blocks import ElementMatrices
from structid.structure.elements.element import TRANSLATIONS, Layer, Term

_LAWS = {"mass": "inertia", "rotary_inertia": "inertia", "viscous_damping": "viscous", "stiffness": "elastic"}


@dataclass(frozen=True, eq=False)
class Property:
    """One property of one element set, and where its values stand among all values of the structure."""

    element: str
    term: Term
    values: slice

    @property
    def label(self) -> str:
        return f"{self.term.property}[{self.element}]"


@dataclass(frozen=True, eq=False)
class ThicknessFactor:
    """(thickness / nominal thickness) to a power, a number an element; the element matrices hold the nominal one.

    Attributes
    ----------
    value : slice
        Where the thicknesses stand among the values of the structure.
    nominal : (n_elements,) float array
        m.
    power : int
        1 for membrane stiffness and mass, 3 for bending.
    """

    value: slice
    nominal: FloatArray
    power: int

    def of(self, values: FloatArray) -> FloatArray:
        """The factors, (n_elements,); 1 at the nominal values."""
        powers: FloatArray = (values[self.value] / self.nominal) ** self.power
        return powers

    def slope(self, values: FloatArray) -> FloatArray:
        """Their derivatives with respect to the thicknesses, (n_elements,), 1/m."""
        ratio = values[self.value] / self.nominal
        slopes: FloatArray = self.power * ratio ** (self.power - 1) / self.nominal
        return slopes


@dataclass(frozen=True, eq=False)
class Contribution:
    """Element matrices on free degrees of freedom, with the values that weigh them.

    The weight of element e is ``values[value][e]``, times ``values[factor][e]`` for structural damping
    (stiffness times loss factor), times a power of the thickness where the element has one. `law` says how it enters
    the dynamic stiffness: ``inertia`` by -omega^2, ``viscous`` by i omega, ``elastic`` by 1, ``structural`` by i,
    ``friction:NAME`` by i over the sliding amplitude of the friction element NAME.
    """

    law: str
    blocks: ElementMatrices
    value: slice
    factor: slice | None = None
    thickness: ThicknessFactor | None = None

    @property
    def is_product(self) -> bool:
        """Whether the weight is a product of several values."""
        return self.factor is not None or self.thickness is not None

    @property
    def places(self) -> tuple[slice, ...]:
        """Where the values stand that make up the weights."""
        more = (self.factor, None if self.thickness is None else self.thickness.value)
        return (self.value, *(place for place in more if place is not None))

    def weights(self, values: FloatArray) -> FloatArray:
        """Weight of each element, (n_elements,)."""
        own = values[self.value]
        if self.factor is not None:
            own = own * values[self.factor]
        return own if self.thickness is None else own * self.thickness.of(values)

    def touched(self, changing: np.ndarray) -> np.ndarray:
        """Whether each element's weight changes with the values marked in `changing` (n_values,), (n_elements,)."""
        mask: np.ndarray = changing[self.value]
        if self.factor is not None:
            mask = mask | changing[self.factor]
        return mask if self.thickness is None else mask | changing[self.thickness.value]

    def partial_slopes(self, values: FloatArray) -> list[tuple[slice, FloatArray]]:
        """Derivative of the weights with respect to each of the values that make them up: where they stand, and it."""
        factor = 1.0 if self.factor is None else values[self.factor]
        power = 1.0 if self.thickness is None else self.thickness.of(values)
        own = values[self.value]
        slopes = [np.broadcast_to(factor * power, own.shape)]
        if self.factor is not None:
            slopes.append(own * power)
        if self.thickness is not None:
            slopes.append(own * factor * self.thickness.slope(values))
        return list(zip(self.places, slopes, strict=True))


def weighed(properties: Sequence[Property], blocks_of: Callable[[Layer], ElementMatrices]) -> tuple[Contribution, ...]:
    """What every property contributes; `blocks_of` gives the matrices of a layer on free degrees of freedom."""
    found: list[Contribution] = []
    elastic: dict[str, list[Contribution]] = {}
    blocks: dict[int, ElementMatrices] = {}  # properties with the same matrices share them
    for item in properties:
        if item.term.kind == "loss_factor":
            found += [replace(part, law="structural", factor=item.values) for part in elastic.get(item.element, [])]
        for layer in item.term.layers:
            law = f"friction:{item.element}" if item.term.kind == "friction" else _LAWS[item.term.kind]
            if id(layer) not in blocks:
                blocks[id(layer)] = blocks_of(layer)
            thickness = _thickness(properties, item.element, layer.power)
            found.append(Contribution(law, blocks[id(layer)], item.values, thickness=thickness))
            if law == "elastic":
                elastic.setdefault(item.element, []).append(found[-1])
    return tuple(found)


def rigid_mass(
    properties: Sequence[Property], values: FloatArray, direction: str | None = None
) -> tuple[float, FloatArray]:
    """Mass that takes part in rigid motion, and its derivative with respect to every value; see `Structure.mass_of`."""
    total, gradient = 0.0, np.zeros(len(values))
    masses = [(item, layer) for item in properties if item.term.kind == "mass" for layer in item.term.layers]
    for candidate in (direction,) if direction else TRANSLATIONS:
        for item, layer in masses:
            unit = _rigid(layer, DIRECTIONS.index(candidate))
            thickness = _thickness(properties, item.element, layer.power)
            factor = 1.0 if thickness is None else thickness.of(values)
            gradient[item.values] += unit * factor
            total += float(unit * factor @ values[item.values])
            if thickness is not None:
                gradient[thickness.value] += unit * values[item.values] * thickness.slope(values)
        if gradient.any():
            break
    return total, gradient


def _thickness(properties: Sequence[Property], element: str, power: int) -> ThicknessFactor | None:
    """How the thickness of `element` enters matrices that go with its `power`."""
    if power == 0:
        return None
    found = next(p for p in properties if p.element == element and p.term.kind == "thickness")
    return ThicknessFactor(found.values, found.term.values, power)


def _rigid(layer: Layer, axis: int) -> FloatArray:
    """r' B_e r for rigid motion along `axis`, (n_elements,)."""
    motion = ((layer.codes >= 0) & (layer.codes % 6 == axis)).astype(np.float64)
    if layer.whole is not None:
        return np.array([motion[0] @ (layer.whole @ motion[0])])
    return np.einsum("ei,eij,ej->e", motion, layer.local, motion)
