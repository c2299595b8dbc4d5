"""Low-order polynomials of a solver's results in its parameters, fitted and verified at further points."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from math import comb

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import InputError
from structid.external.deck import Deck, DeckParameter
from structid.fem.elements.matrix_group import Powers

#: Change of a parameter as a part of its value, over which the dependence is found.
RANGE = 0.5
MOST_ORDER = 4
#: Parts of the range: the first of them gives the slope, the second verifies it, then each verifies those before.
_PARTS = (1.0, 0.5, -0.5, 0.25, -1.0, 0.75)
#: Parts of the range at points where all parameters change, in turn.
_JOINT = (0.37, 0.83, -0.29, 0.61, -0.53)
#: Entries that change by less than this part of their size are rounding of the file.
ROUNDING = 1e-11
_AGREE, _AGREE_OF_CHANGE = 1e-8, 1e-5

Point = dict[str, float]
#: Numbers at several points, (n_points, n_numbers), and what each is measured by, (n_numbers,). Further points may add numbers
#: at the end, which are then 0 at all points before; those that were there keep their places.
Evaluate = Callable[[Sequence[Point]], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True, eq=False)
class Expansion:
    """Numbers as a sum of coefficients times powers of the parameters.

    Attributes
    ----------
    coefficients : mapping of Powers to (n_numbers,) float array
        Coefficients of powers of each parameter's value over its reference.
    references : mapping of str to float
    orders : mapping of str to int
        Highest power of each parameter.
    crossed : tuple of (str, str)
        Parameters that are multiplied with each other.
    error : float
        Largest difference from the numbers at the points that verify the sum, relative to the size of each number.
    n_points : int
        Number of points at which the numbers were evaluated.
    """

    coefficients: Mapping[Powers, FloatArray]
    references: Mapping[str, float]
    orders: Mapping[str, int]
    crossed: tuple[tuple[str, str], ...]
    error: float
    n_points: int

    def at(self, values: Mapping[str, float]) -> FloatArray:
        """Values of the polynomials, (n_numbers,), for parameter `values` by name, in the units of the deck."""
        total = np.zeros(len(next(iter(self.coefficients.values()))))
        for powers, coefficient in self.coefficients.items():
            total = total + coefficient * np.prod([(values[n] / self.references[n]) ** p for n, p in powers])
        return total


@dataclass(frozen=True, eq=False)
class _Axis:
    """One parameter: u = value / reference - origin runs over its range."""

    name: str
    reference: float
    origin: float
    range: float

    def value(self, part: float) -> float:
        return self.reference * (self.origin + self.range * part)

    def u(self, value: float) -> float:
        return value / self.reference - self.origin


def axis(parameter: DeckParameter, nominal: float, usual: float) -> _Axis:
    """The range over which a parameter is varied on both sides of its nominal value, inside its bounds.

    It extends by `parameter.step` or, without a step, by `usual`, both relative to the nominal value (for a nominal value of 0
    the step is absolute), but at most 0.9 of the way to the nearer bound.

    Raises
    ------
    InputError
        If the nominal value is 0 and the parameter has no step, or the nominal value lies at a bound.
    """
    low, high = parameter.limits
    if not nominal and parameter.step is None:
        raise InputError(f"parameter {parameter.name!r} is 0; give `step`, by how much it changes, in its unit")
    reference = nominal or parameter.step or 1.0
    wide = (usual if parameter.step is None else parameter.step) if nominal else 1.0
    room = min(nominal - low, high - nominal) / abs(reference)
    if not room > 0:
        raise InputError(
            f"parameter {parameter.name!r} is {nominal:g}, at one of its `bounds`; leave room on both sides"
        )
    return _Axis(parameter.name, reference, 1.0 if nominal else 0.0, min(wide, 0.9 * room))


def expansion(evaluate: Evaluate, deck: Deck) -> Expansion:
    """Polynomials of low order in the deck's parameters, for the numbers that `evaluate` returns.

    They are verified at points that they were not fitted to. Each parameter is varied alone first: a straight line is
    verified at a third point, and if it fails, the order is raised up to the fourth, each verified at a further point.
    A point at which all parameters change verifies the sum; if that fails, products of pairs of parameters are added
    and verified.

    Parameters
    ----------
    evaluate : callable
        Returns the numbers at a sequence of parameter values, (n_points, n_numbers), and the size of each,
        (n_numbers,).
    deck : Deck
        Deck with its parameters and their nominal values.

    Raises
    ------
    InputError
        If a parameter changes nothing, or no polynomial is verified.
    """
    axes = [axis(parameter, deck.nominal[parameter.name], RANGE) for parameter in deck.parameters]
    table = _Table(evaluate, deck, {parameter_axis.name: parameter_axis for parameter_axis in axes})
    table.evaluate_at([{}, *({parameter_axis.name: part} for parameter_axis in axes for part in _PARTS[:2])])
    orders = {parameter_axis.name: _lowest_order(table, parameter_axis) for parameter_axis in axes}
    polynomial: dict[Powers, FloatArray] = {(): table.row({})}
    for parameter_axis in axes:
        line = _fit_powers(table, parameter_axis, orders[parameter_axis.name])
        _require_effect(table, parameter_axis, line)
        polynomial |= _along(parameter_axis, line)
    crossed: tuple[tuple[str, str], ...] = ()
    if len(axes) > 1:
        joint_points = [
            {parameter_axis.name: _JOINT[(k + first) % len(_JOINT)] for k, parameter_axis in enumerate(axes)}
            for first in range(2)
        ]
        table.evaluate_at(joint_points[:1])
        if not table.agrees(polynomial, joint_points[0]):
            table.evaluate_at([_both(a, b, p, q) for a, b in combinations(axes, 2) for p, q in _grid(orders, a, b)])
            for a, b in combinations(axes, 2):
                products_of_pair = _fit_products(table, polynomial, a, b, orders)
                polynomial |= products_of_pair
                crossed += ((a.name, b.name),) if products_of_pair else ()
            table.evaluate_at(joint_points[1:])
            if not all(table.agrees(polynomial, point) for point in joint_points):
                raise InputError(
                    f"what the solver gives is no polynomial in {', '.join(deck.names)} together: it is missed by"
                    f" {table.relative_errors(polynomial, joint_points[0])[0]:.2g} of its size where all of them"
                    " change; take fewer parameters, smaller"
                    ' `step`, or `gives = "modes"`'
                )
    error = max(table.relative_errors(polynomial, point)[0] for point in table.points)
    references = {a.name: a.reference for a in axes}
    return Expansion(_in_powers_of_values(polynomial, table), references, orders, crossed, error, len(table.points))


class _Table:
    """Numbers at points that are given by parts of each parameter's range; each evaluated once."""

    def __init__(self, evaluate: Evaluate, deck: Deck, axes: Mapping[str, _Axis]) -> None:
        """An empty table of numbers at points.

        `evaluate` maps a sequence of parameter values by name to the numbers, (n_points, n_numbers), and the size of
        each, (n_numbers,); `axes` has the range of each parameter of `deck` by name.
        """
        self.evaluate, self.deck, self.axes = evaluate, deck, axes
        self.rows: FloatArray = np.zeros((0, 0))
        self.size: FloatArray = np.zeros(0)
        self.points: list[dict[str, float]] = []

    def evaluate_at(self, points: Sequence[dict[str, float]]) -> None:
        """Evaluate the numbers at all known points and at those of `points` that are new; nothing happens without a new one.

        Points give each changed parameter as a part of its range, by name. Known points are evaluated again, since numbers may
        be added to them.
        """
        new = [point for point in points if point not in self.points]
        if new:
            self.points += new
            self.rows, self.size = self.evaluate([self.values(point) for point in self.points])

    def values(self, point: Mapping[str, float]) -> Point:
        """Values of all parameters at a point, as the deck shows them."""
        return self.deck.shown(
            {name: parameter_axis.value(point.get(name, 0.0)) for name, parameter_axis in self.axes.items()}
        )

    def u(self, point: Mapping[str, float], name: str) -> float:
        return self.axes[name].u(self.values(point)[name])

    def row(self, point: dict[str, float]) -> FloatArray:
        numbers: FloatArray = self.rows[self.points.index(point)]
        return numbers

    def relative_errors(self, polynomial: Mapping[Powers, FloatArray], point: dict[str, float]) -> tuple[float, float]:
        """Largest error of a polynomial at `point`, and largest change of a result from the nominal point to `point`.

        Both are parts of the size of each number, as `evaluate` states it. `polynomial` maps powers to coefficients
        (n_numbers,); `point`, the part of its range by which each parameter is changed, has been evaluated.
        """
        predicted = np.zeros(self.rows.shape[1])
        for powers, row in polynomial.items():
            predicted[: len(row)] += row * np.prod([self.u(point, name) ** k for name, k in powers])
        change = np.abs(self.row(point) - self.row({})) / self.size
        return float((np.abs(self.row(point) - predicted) / self.size).max()), float(change.max())

    def agrees(self, coefficients: Mapping[Powers, FloatArray], point: dict[str, float]) -> bool:
        missed, change = self.relative_errors(coefficients, point)
        return missed <= _AGREE + _AGREE_OF_CHANGE * change


def _lowest_order(table: _Table, axis: _Axis) -> int:
    """Lowest order, 1 to 4, at which a polynomial in one parameter predicts the next point.

    The points needed are evaluated in `table`; all other parameters are at their nominal values. `InputError` if no
    order predicts it.
    """
    for order in range(1, MOST_ORDER + 1):
        table.evaluate_at([{axis.name: part} for part in _PARTS[: order + 1]])
        polynomial = {(): table.row({})} | _along(axis, _fit_powers(table, axis, order))
        if table.agrees(polynomial, {axis.name: _PARTS[order]}):
            return order
    error, change = table.relative_errors(polynomial, {axis.name: _PARTS[MOST_ORDER]})
    raise InputError(
        f"what the solver gives is no polynomial in {axis.name!r} up to order {MOST_ORDER}: it is missed by"
        f" {error / change:.2g} of its change; mark another quantity (of a Poisson's ratio, the shear modulus), give a smaller"
        ' `step`, or take `gives = "modes"`'
    )


def _along(axis: _Axis, rows: Sequence[FloatArray]) -> dict[Powers, FloatArray]:
    """Coefficients `rows` of u, u^2, ... of one parameter, by the powers that they belong to; `axis` defines u."""
    return {((axis.name, k),): row for k, row in enumerate(rows, 1)}


def _fit_powers(table: _Table, axis: _Axis, order: int) -> list[FloatArray]:
    """Coefficients of u, u^2, ..., u^order of one parameter, (n_numbers,) each, through `order` points of `table`.

    u is the change of the parameter from its nominal value, as a part of that value, or of the step where it is 0. The
    polynomial is that of the change from the nominal point, so that it meets that point too. Coefficients of numbers
    that change by no more than rounding are 0.
    """
    points = [{axis.name: part} for part in _PARTS[:order]]
    u = np.array([table.u(point, axis.name) for point in points])
    changes = np.array([table.row(point) - table.row({}) for point in points])
    changes[:, np.abs(changes).max(axis=0) <= ROUNDING * table.size] = 0.0
    return list(np.linalg.solve(u[:, None] ** np.arange(1, order + 1), changes))


def _require_effect(table: _Table, axis: _Axis, rows: Sequence[FloatArray]) -> None:
    if not any(row.any() for row in rows):
        low, high = table.values({}), table.values({axis.name: 1.0})
        raise InputError(
            f"parameter {axis.name!r} has no effect: nothing that the solver gives changes between {low[axis.name]:g} and"
            f" {high[axis.name]:g}; look for the mark in a part of the deck that is not used, or take the parameter out"
        )


def _grid(orders: Mapping[str, int], a: _Axis, b: _Axis) -> Iterator[tuple[float, float]]:
    yield from product(_PARTS[: orders[a.name]], _PARTS[: orders[b.name]])


def _both(a: _Axis, b: _Axis, p: float, q: float) -> dict[str, float]:
    return {a.name: p, b.name: q}


def _fit_products(
    table: _Table, polynomial: Mapping[Powers, FloatArray], a: _Axis, b: _Axis, orders: Mapping[str, int]
) -> dict[Powers, FloatArray]:
    """Coefficients (n_numbers,), by powers, of products u_a^i u_b^j of two parameters; {} if none is missing.

    `a` and `b` are their ranges; u is the change of a parameter from its nominal value, as a part of that value, or of
    the step where it is 0. The products are fitted, at the points of `table` where both parameters change, to the
    numbers less the nominal ones and less the terms of `polynomial` with one parameter each. `orders` has the highest
    exponent of each parameter, by name.
    """
    points = [_both(a, b, p, q) for p, q in _grid(orders, a, b)]
    powers = list(product(range(1, orders[a.name] + 1), range(1, orders[b.name] + 1)))
    residuals = []
    for point in points:
        predicted = table.row({}).copy()
        for key, row in polynomial.items():
            if len(key) == 1 and key[0][0] in point:
                predicted[: len(row)] += row * table.u(point, key[0][0]) ** key[0][1]
        residuals.append(table.row(point) - predicted)
    residual = np.array(residuals)
    residual[:, np.abs(residual).max(axis=0) <= 10 * ROUNDING * table.size] = 0.0
    if not residual.any():
        return {}
    u = np.array([(table.u(point, a.name), table.u(point, b.name)) for point in points])
    system = np.array([[x**i * y**j for i, j in powers] for x, y in u])
    rows = np.linalg.solve(system, residual)
    return {((a.name, i), (b.name, j)): row for (i, j), row in zip(powers, rows, strict=True)}


def _in_powers_of_values(polynomial: Mapping[Powers, FloatArray], table: _Table) -> dict[Powers, FloatArray]:
    """Coefficients (n_numbers,) of `polynomial` by powers of value / reference of the parameters.

    Those of `polynomial` are by powers of u, the relative change of a parameter from the nominal value. Coefficients at
    rounding level are set to 0, and powers that have no other are left out.
    """
    total: dict[Powers, FloatArray] = {}
    centre = {name: parameter_axis.origin for name, parameter_axis in table.axes.items()}
    for powers, row in polynomial.items():
        for key, factor in expand_about_centre(powers, centre, dict.fromkeys(centre, 1.0)):
            total.setdefault(key, np.zeros(table.rows.shape[1]))[: len(row)] += factor * row
    for row in total.values():
        row[np.abs(row) <= 10 * ROUNDING * table.size] = 0.0
    return {key: row for key, row in total.items() if row.any()}


def expand_about_centre(
    powers: Powers, centre: Mapping[str, float], references: Mapping[str, float]
) -> Iterator[tuple[Powers, float]]:
    """Terms of a product of powers of (value - centre), as pairs of powers of value / reference and the factor.

    `powers` holds (name, exponent) pairs; `centre` and `references` are by name.
    """
    for chosen in product(*(range(k + 1) for _, k in powers)):
        factor = 1.0
        for (name, k), exponent in zip(powers, chosen, strict=True):
            factor *= comb(k, exponent) * (-centre[name]) ** (k - exponent) * references[name] ** exponent
        if factor:
            yield (
                tuple((name, exponent) for (name, _), exponent in zip(powers, chosen, strict=True) if exponent),
                factor,
            )
