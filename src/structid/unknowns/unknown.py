"""The declaration of an unknown property, and smooth fields: combinations of few functions on a coarse grid over a mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray
from structid.core.constraints import Count, Positive
from structid.core.errors import InputError
from structid.unknowns.priors import Prior

_LARGEST_DEGREE = 5


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
        """Make `intervals` a tuple of ints; raise `InputError` unless it and the degree are in range."""
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
    middles : (n_elements, n_coordinates) float array
        m.

    Returns
    -------
    (n_elements, n_functions) sparse array, and the place of each function in the grid, such as ``2,1`` (from 1).
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
        own = _splines((middles[:, axis] - low[axis]) / extent[axis], count, field.degree)
        total = sparse.csr_array(
            sparse.hstack([total[:, [k]].multiply(own) for k in range(total.shape[1])], format="csr")
        )
        grid_points = [(*grid_point, i + 1) for grid_point in grid_points for i in range(own.shape[1])]
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
