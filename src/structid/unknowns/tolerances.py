"""Tolerances of the fixed values of a model: the errors that intervals and verdicts allow for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from structid.core.arrays import FloatArray, IntArray, locked
from structid.core.constraints import Limits, require_declared
from structid.fem import Structure
from structid.unknowns.named_unknowns import DAMPING
from structid.unknowns.parameters import Parameters

#: A standard deviation as a part of the value itself.
Part = Annotated[float, Limits(least=0, most=1)]
#: Kinds of properties that masses, and stiffnesses, are known by.
_MASSES, _STIFFNESSES = ("mass", "rotary_inertia"), ("stiffness", "thickness", "axial_force")
_DAMPINGS = (*DAMPING, "friction")
#: Elements of a set up to which each of different values has an error of its own.
_MOST_ALONE = 20


@dataclass(frozen=True)
class Tolerances:
    """Tolerances of the fixed values of a model, as standard deviations in parts of each value.

    They are those of all element sets and records that state no `tolerance` or `calibration` of their own. All elements of a set
    err together in a property, as those of one drawing do; properties and sets err independently. Where up to 20 elements of a set
    have different values, as masses that were weighed one by one do, they may err together or each on its own, and no combination
    of them is held to be known better than in the worse of the two cases.

    Parameters
    ----------
    mass : float
        Of fixed masses and rotary inertias.
    stiffness : float
        Of fixed stiffnesses, thicknesses and axial forces.
    damping : float
        Of fixed dampings and friction forces.
    calibration : float
        Of the common gain of all channels of a record: sensors over load cells, or over the motion of a support.
    """

    mass: Part = 0.01
    stiffness: Part = 0.01
    damping: Part = 0.3
    calibration: Part = 0.01

    def __post_init__(self) -> None:
        require_declared(self)

    def of_kind(self, kind: str) -> float:
        """The relative tolerance for a property of this kind; 0 for a kind without one, such as a node coordinate."""
        if kind in _MASSES:
            return self.mass
        if kind in _STIFFNESSES:
            return self.stiffness
        return self.damping if kind in _DAMPINGS else 0.0


#: Of a model and a record that are exact, as simulated ones are.
EXACT = Tolerances(0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class FixedProperty:
    """Values of one property of an element set that no parameter changes, and that err together.

    Attributes
    ----------
    label : str
        Such as ``mass[deck]``, or ``mass[deck:2]`` of one element.
    kind : str
    element : str
        Its element set.
    tolerance : float
        Standard deviation in parts of the value, greater than 0.
    indices : (n,) int array
        Where its values stand among all values of the structure.
    """

    label: str
    kind: str
    element: str
    tolerance: float
    indices: IntArray


def fixed_properties(structure: Structure, unknown: Parameters, tolerances: Tolerances) -> tuple[FixedProperty, ...]:
    """Every property of the structure with a tolerance and values that no parameter changes and that are not 0.

    A property with different values of up to 20 elements comes once for all of them and then once for each. Each of the
    n elements has the tolerance T, all together T sqrt(1 - 1 / n): the covariance T^2 (I + (1 - 1 / n) 11') of their
    errors is the least that is below neither T^2 I, of errors of their own, nor T^2 11', of an error in common.

    Parameters
    ----------
    structure : Structure
        Structure with its properties.
    unknown : Parameters
        Parameters of that structure, which do not count as fixed.
    tolerances : Tolerances
        Tolerances of element sets that state none.
    """
    stated = {element.name: element.tolerance for element in structure.elements}
    is_fixed = unknown.is_fixed
    fixed = []
    for item in structure.properties:
        indices = item.values.start + np.flatnonzero(is_fixed[item.values])
        tolerance = _own_tolerance(stated.get(item.element), item.term.property)
        tolerance = tolerances.of_kind(item.term.kind) if tolerance is None else tolerance
        if not (len(indices) and tolerance > 0):
            continue
        whole = FixedProperty(item.label, item.term.kind, item.element, tolerance, locked(indices, int))
        fixed.append(whole)
        values = unknown.offset[indices]
        if len(indices) <= _MOST_ALONE and (values != values[0]).any():
            fixed[-1] = replace(whole, tolerance=tolerance * float(np.sqrt(1 - 1 / len(indices))))
            numbers = indices - item.values.start + 1
            fixed += [
                replace(whole, label=f"{item.term.property}[{item.element}:{number}]", indices=locked([index], int))
                for number, index in zip(numbers, indices, strict=True)
            ]
    return tuple(fixed)


def _own_tolerance(tolerance: float | Mapping[str, float] | None, name: str) -> float | None:
    """The tolerance that an element set states for the property `name`; None where it states none."""
    return tolerance.get(name) if isinstance(tolerance, Mapping) else tolerance


def relative_sensitivities(values: FloatArray, properties: tuple[FixedProperty, ...]) -> FloatArray:
    """Derivatives of all property `values` (n_values,) by a relative change of each property, (n_values, n_properties).

    A column has the values that belong to its property and zeros elsewhere. `properties` are the fixed ones.
    """
    columns = np.zeros((len(values), len(properties)))
    for number, item in enumerate(properties):
        columns[item.indices, number] = values[item.indices]
    return columns
