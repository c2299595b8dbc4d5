"""Checks of imported matrices, and group matrices from two exports of a model.

The units of a mass matrix are checked by its total mass; mass and stiffness must be positive semidefinite.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import norm, splu

from structid.core.arrays import FloatArray
from structid.core.dof import DIRECTIONS, Dof, parse_dofs
from structid.core.errors import InputError
from structid.core.units import FORCES, LENGTHS

#: Largest relative difference of masses that passes.
_MASS_ERROR = 0.1
#: Ratio of what a matrix gives to the declared mass, and what it then most likely is.
_RATIOS = (
    (1e-3, "masses of the model are in tonnes (mm, N, t): set `length_unit` to mm and `force_unit` to N"),
    (1e3, "masses of the model are in grams, or the declared mass is in tonnes"),
    (1e-6, "masses of the model are in 1e6 kg, or mm and m are mixed"),
    (1e6, "masses of the model are in milligrams, or mm and m are mixed"),
    (1e9, "the density was given per mm^3 in a model in m"),
    (1e-9, "the density was given per m^3 in a model in mm"),
    (1 / 175.126835, "masses of the model are in lbf s^2/in: set `length_unit` to in and `force_unit` to lbf"),
    (1 / 175126.835, "masses of the model are in kip s^2/in: set `length_unit` to in and `force_unit` to kip"),
    (1 / 14.5939029, "masses of the model are in slugs: set `length_unit` to ft and `force_unit` to lbf"),
    (1 / 0.45359237, "masses of the model are in pounds (lb)"),
    (
        386.0886 / 175.126835,
        "masses of the model are weights in lbf: give PARAM,WTMASS or divide the densities by 386.09",
    ),
    (9.80665, "masses of the model are weights in N: divide the densities by 9.80665"),
    (2.0, "both triangles were added, or a symmetric half was modelled"),
    (0.5, "a half of the structure was modelled, or one triangle of the matrix is missing"),
    (0.25, "a quarter of the structure was modelled"),
)
#: Degrees of freedom up to which definiteness is checked by factors.
_FACTORED_UP_TO = 20_000
#: Eigenvalues of the scaled matrix down to minus this count as zero: five digits, as short text fields have.
_ZERO = 1e-5


def total_mass(mass: Any, dofs: Sequence[str | Dof], direction: str = "X") -> float:
    """Mass that moves in rigid translation along `direction`: r' M r.

    Parameters
    ----------
    mass : (n, n) sparse or dense array
    dofs : n degrees of freedom
        Degree of freedom of each row.
    direction : {"X", "Y", "Z"}

    Returns
    -------
    float
        In the mass unit of the matrix. What is held in the exported model has no part in it.

    Raises
    ------
    InputError
        If `direction` is no translation, or `dofs` are not as many as the rows.

    Examples
    --------
    >>> total_mass(np.diag([2.0, 3.0, 3.0]), ["1X", "2X", "2Y"])
    5.0
    """
    if direction not in DIRECTIONS[:3]:
        raise InputError(f"`direction` must be X, Y or Z, got {direction!r}")
    parsed = parse_dofs(dofs)
    if len(parsed) != mass.shape[0]:
        raise InputError(f"`dofs` must name the {mass.shape[0]} rows of the mass matrix, got {len(parsed)}")
    rigid = np.array([dof.sign * (dof.direction == direction) for dof in parsed], dtype=np.float64)
    return float(rigid @ (mass @ rigid))


def require_total_mass(total: float, declared: float, left_aside: str = "") -> None:
    """Raise `InputError` if the mass `total` in the matrices differs from the `declared` one by more than a tenth.

    The message names the factor between them and its likely cause, such as a wrong unit. A `declared` mass or `total`
    that is not greater than 0 raises too.

    Parameters
    ----------
    total, declared : float
        kg; a tenth apart they pass, as a model is rarely right to the percent, and units are wrong by a factor.
    left_aside : str
        Parts of the model without an element, which the message names as the cause.
    """
    if not declared > 0:
        raise InputError(f"`total_mass` must be greater than 0, got {declared}")
    if total <= 0:
        raise InputError(
            f"the total mass of the model is {total:.6g}, the declared one {declared:.6g} kg; the mass matrix is "
            "missing, or its rows are not the degrees of freedom named"
        )
    ratio = total / declared
    if abs(ratio - 1) <= _MASS_ERROR:
        return
    likely = [words for factor, words in _RATIOS if abs(ratio / factor - 1) <= _MASS_ERROR]
    cause = left_aside or (likely[0] if likely else (
        "mass at degrees of freedom held in the export is not in the matrix; else check units, densities and numbering"
    ))  # fmt: skip
    raise InputError(
        f"the total mass of the model is {total:.6g} kg, the declared one {declared:.6g} kg: a factor of {ratio:.6g}; "
        f"{cause}"
    )


def in_si(matrix: Any, dofs: Sequence[str | Dof], length_unit: str = "m", force_unit: str = "N") -> sparse.csc_array:
    """A mass, damping or stiffness matrix in SI units, sparse (n, n), from one in other units of length and force.

    Energies scale with F L: D K D with D = sqrt(F/L) at translations and sqrt(F L) at rotations. In mm and N masses are
    in tonnes, in mm and mN in kg, in in and lbf in lbf s^2/in, in ft and lbf in slugs.

    Parameters
    ----------
    matrix : (n, n) sparse or dense array
    dofs : n degrees of freedom
        Degree of freedom of each row.
    length_unit, force_unit : str
        Units of `structid.core.units`, such as ``mm`` and ``N``; time is always in seconds.

    Raises
    ------
    InputError
        If a unit is not known.
    """
    for name, unit, known in (("length_unit", length_unit, LENGTHS), ("force_unit", force_unit, FORCES)):
        if unit not in known:
            raise InputError(f"`{name}` must be one of {' '.join(known)}, got {unit!r}")
    length, force = LENGTHS[length_unit], FORCES[force_unit]
    if length == force == 1.0:
        return sparse.csc_array(matrix)
    roots = [np.sqrt(force * length if dof.is_rotation else force / length) for dof in parse_dofs(dofs)]
    scale = sparse.diags_array(roots)
    return sparse.csc_array(scale @ sparse.csc_array(matrix) @ scale)


def group_from_exports(
    base: Any,
    changed: Any,
    factor: float,
    third: Any = None,
    third_factor: float | None = None,
    digits: int = 10,
) -> sparse.csc_array:
    """The matrix of all elements that one parameter scales, from exports with the parameter p and with `factor` p.

    Where K depends on p linearly, K(p) = K_0 + p K_1, the part of the group at p is

        p K_1 = (K(f p) - K(p)) / (f - 1),

    so that K(2p) - K(p) is the group itself. A factor of 2 or more keeps all digits.

    Parameters
    ----------
    base, changed : (n, n) sparse or dense arrays
        Exports with p and with `factor` p; the same mesh, numbering and boundary conditions.
    factor : float
        Positive, not 1.
    third : (n, n) sparse or dense array, optional
        An export with `third_factor` p: the dependence is then checked. Without it linearity is assumed.
    third_factor : float, optional
        Positive, not 1 and not `factor`.
    digits : int
        Significant digits of the exports. Differences below half a unit of the last one are taken for zero.

    Returns
    -------
    (n, n) csc_array

    Raises
    ------
    InputError
        If the exports are of different sizes or do not differ, or if the third shows that K does not depend on p
        linearly; the power it follows, where there is one, is named.

    References
    ----------
    Usual practice with solvers that give assembled matrices only; K and M are linear in moduli and densities.

    Examples
    --------
    >>> half = group_from_exports(np.diag([3.0, 1.0]), np.diag([5.0, 1.0]), 2.0)
    >>> half.toarray().tolist()
    [[2.0, 0.0], [0.0, 0.0]]
    """
    factor = float(factor)
    _require_factor("factor", factor)
    group = _matrix_difference("changed", base, changed, digits) / (factor - 1)
    if (third is None) != (third_factor is None):
        raise InputError("`third` and `third_factor` must be given together")
    if third is None or third_factor is None:
        return sparse.csc_array(group)
    third_factor = float(third_factor)
    _require_factor("third_factor", third_factor)
    if third_factor == factor:
        raise InputError(f"`third_factor` must differ from `factor`, got {third_factor} for both")
    other = _matrix_difference("third", base, third, digits) / (third_factor - 1)
    error = float(norm(other - group) / norm(group))
    if error > 10.0 ** (3 - digits):
        raise InputError(
            f"`third` must agree with a linear dependence, but its group differs by {error:.2g} of its norm;"
            f" {_power_hint(group * (factor - 1), other * (third_factor - 1), factor, third_factor)}"
        )
    return sparse.csc_array(group)


def _require_factor(name: str, factor: float) -> None:
    if not (math.isfinite(factor) and factor > 0 and factor != 1):
        raise InputError(f"`{name}` must be positive and not 1, got {factor}; export with twice the parameter")


def _matrix_difference(name: str, base: Any, changed: Any, digits: int) -> sparse.csc_array:
    """The sparse matrix `changed` - `base` without entries below their rounding to `digits` significant digits.

    `name` is that of `changed` in errors: `InputError` if the shapes differ or nothing is left.
    """
    first, second = sparse.csc_array(base, dtype=np.float64), sparse.csc_array(changed, dtype=np.float64)
    if first.shape != second.shape:
        raise InputError(
            f"`{name}` must have shape {first.shape} like `base`, got {second.shape}; export the same mesh with the same "
            "boundary conditions"
        )
    difference = sparse.csc_array(second - first)
    size = abs(first) + abs(second)
    kept = difference.multiply(abs(difference) > 0.5 * 10.0 ** (1 - digits) * size)
    result = sparse.csc_array(kept)
    result.eliminate_zeros()
    if not result.nnz:
        raise InputError(f"`{name}` must differ from `base`, but no entry does; change the parameter and export again")
    return result


def _power_hint(first: sparse.csc_array, second: sparse.csc_array, factor: float, third_factor: float) -> str:
    """A sentence that names the power of p which explains two differences of exports, or says that none does.

    `first` and `second` are the changes of a matrix by `factor` and by `third_factor` times p. Powers from -4 to 4.5
    are tried; the two changes must be proportional to 1e-6, and the power right to 1e-4.
    """
    ratio = float((first.multiply(second)).sum() / first.multiply(first).sum())
    same_shape = norm(second - ratio * first) < 1e-6 * norm(second)
    powers: FloatArray = np.concatenate([np.arange(-4.0, 0.0), np.arange(0.5, 5.0, 0.5)])
    expected = (third_factor**powers - 1) / (factor**powers - 1)
    best = int(np.argmin(abs(expected - ratio)))
    if same_shape and abs(expected[best] / ratio - 1) < 1e-4:
        return (
            f"the matrix follows p to the power {powers[best]:g}: take p^{powers[best]:g} as the parameter, that is the factors "
            f"{factor ** powers[best]:g} and {third_factor ** powers[best]:g}"
        )
    return "no single power of p gives both; split the group, or choose a parameter that enters linearly"


def require_semidefinite(name: str, matrix: sparse.csc_array, dofs: Sequence[Dof]) -> None:
    """Raise `InputError` if a symmetric matrix has negative eigenvalues; the message says where, if that is known.

    The matrix is scaled to a unit diagonal, so that translations and rotations count alike; eigenvalues down to -1e-5
    pass. Diagonal and every pair of rows are checked; up to 20,000 rows the whole matrix is factorized and the signs of
    the pivots are counted (Sylvester's law of inertia).

    Parameters
    ----------
    name : str
        Name of the matrix, for the message.
    matrix : (n, n) sparse array
    dofs : n degrees of freedom
        Degree of freedom of each row, for the message.
    """
    diagonal = matrix.diagonal()
    low = int(np.argmin(diagonal)) if len(diagonal) else 0
    if len(diagonal) and diagonal[low] < -_ZERO * abs(diagonal).max():
        raise InputError(
            f"`{name}` must be positive semidefinite, but its diagonal is {diagonal[low]:.6g} at {dofs[low].unsigned}; check "
            "signs and numbering, or set `indefinite = true` if this is intended (preload)"
        )
    root = np.sqrt(np.maximum(diagonal, 0.0))
    coordinates = matrix.tocoo()
    limit = (1 + _ZERO) * root[coordinates.row] * root[coordinates.col] + 1e-14 * abs(diagonal).max(initial=0.0)
    over = (coordinates.row != coordinates.col) & (abs(coordinates.data) > limit)
    if over.any():
        worst = int(np.argmax(np.where(over, abs(coordinates.data), 0.0)))
        i, j = coordinates.row[worst], coordinates.col[worst]
        raise InputError(
            f"`{name}` must be positive semidefinite, but the entry of {dofs[i].unsigned} and {dofs[j].unsigned} is "
            f"{coordinates.data[worst]:.6g} beside {diagonal[i]:.6g} and {diagonal[j]:.6g} on the diagonal (in "
            f"{int(over.sum()) // 2} pairs); entries are missing or out of place, or set "
            "`indefinite = true` if this is intended (preload)"
        )
    used = np.flatnonzero(root > 0)
    if 0 < len(used) <= _FACTORED_UP_TO:
        scaled = sparse.diags_array(1 / root[used]) @ matrix[used][:, used] @ sparse.diags_array(1 / root[used])
        count = _count_negative_pivots(sparse.csc_array(scaled + _ZERO * sparse.eye_array(len(used))))
        if count:
            raise InputError(
                f"`{name}` must be positive semidefinite, but has {count} negative eigenvalues; entries are missing or wrong, "
                "or set `indefinite = true` if this is intended (preload)"
            )


def _count_negative_pivots(matrix: sparse.csc_array) -> int:
    """Number of negative eigenvalues of a symmetric `matrix`, by the signs of the pivots of L D L'.

    At least 1 if pivots off the diagonal had to be taken; 1 if the matrix is singular.
    """
    try:
        factors = splu(matrix, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError:  # exactly singular
        return 1
    count = int((factors.U.diagonal() < 0).sum())
    return count if np.array_equal(factors.perm_r, factors.perm_c) else max(count, 1)
