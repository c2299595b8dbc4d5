"""The declaration of an unknown property."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from structid.declared import Count, Positive
from structid.unknowns.field import Field
from structid.unknowns.priors import Prior


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
