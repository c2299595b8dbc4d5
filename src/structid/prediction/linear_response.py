"""Responses of a structure as functions of its parameters: forces and moving supports in, motions, forces and stresses out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray
from structid.core.dof import Dof, parse_dof
from structid.core.errors import InputError
from structid.dynamics.factorization import factorizer
from structid.fem import Base, Structure
from structid.fem.elements.element import dof_code
from structid.prediction.poles import (
    PoleSum,
    Sides,
    extend_basis,
    reduce_structure,
    reduction_basis,
    sum_over_poles,
)
from structid.prediction.recovery import Output, OutputMap, output_map
from structid.unknowns import Parameters

#: What acts: a force at a degree of freedom, or a base whose supports move.
Input: TypeAlias = Dof | Base


@dataclass(frozen=True, eq=False)
class LinearResponse:
    """A structure as a sum over its poles for any physical parameters, on one basis of motions.

    Attributes
    ----------
    outputs : OutputMap
        On the degrees of freedom of the structure, or of the one whose driving supports are released.
    poles_at : callable
        Displacements of the rows of `outputs` in one group a derivative, per unit force and per unit acceleration of supports, at
        physical parameters (n_params,).
    """

    outputs: OutputMap
    poles_at: Callable[[FloatArray], PoleSum]


def parse_inputs(inputs: Sequence[Input | str]) -> tuple[Input, ...]:
    """Degrees of freedom that are loaded, read from their names, and bases as they are; a single text is a list of one."""
    return tuple(
        each if isinstance(each, Base) else parse_dof(each)
        for each in ([inputs] if isinstance(inputs, str) else inputs)
    )


def input_words(inputs: Sequence[Input]) -> tuple[str, ...]:
    """Names of `inputs`, in their order: degrees of freedom such as ``12Y``, and bases by their own."""
    return tuple(each.name if isinstance(each, Base) else str(each) for each in inputs)


def movable_supports(structure: Structure) -> list[Dof]:
    """Supports (positive directions) that elements are attached to, so that their motion moves the structure."""
    codes = set(structure.numbering.codes.tolist())
    return [
        dof
        for dof in dict.fromkeys(each.unsigned for each in structure.fixed)
        if dof_code(dof.node, dof.direction) in codes
    ]


def is_support(structure: Structure, dof: Dof) -> bool:
    """True if the structure is held at the degree of freedom, in either sense."""
    return dof.unsigned in {each.unsigned for each in structure.fixed}


def support_base(structure: Structure, dof: Dof, together: bool = True) -> Base:
    """Base that the support `dof` is part of: a base declared by the structure, else all supports in its direction together.

    If not `together`, a support without a declared base moves alone.

    Raises
    ------
    InputError
        If the structure has no support at `dof` that elements hold to.
    """
    declared = next((base for base in structure.bases if base.moves(dof)), None)
    if declared is not None:
        return declared
    movable = movable_supports(structure)
    supports = [each for each in movable if each.direction == dof.direction]
    if dof.unsigned not in supports:
        named = ", ".join(each.place for each in movable[:6]) or "none"
        raise InputError(f"{dof} cannot be moved: it is no support that elements hold to; such supports are {named}")
    if not together:
        return Base(f"support {dof.place}", [dof])
    return Base(
        f"supports in {dof.direction}",
        [dof, *(replace(each, sign=dof.sign) for each in supports if each != dof.unsigned)],
    )


def linear_response(
    structure: Structure,
    parameters: Parameters,
    points: Sequence[FloatArray],
    outputs: Sequence[Output],
    inputs: Sequence[Input],
    derivative: int,
    band: tuple[float, float],
    is_viscous: bool = False,
    relative: bool = False,
) -> LinearResponse:
    """Response of a structure to forces and to accelerations of supports, as a function of its physical parameters.

    Parameters
    ----------
    structure : Structure
    parameters : Parameters
        Of that structure.
    points : sequence of (n_params,) float arrays
        Physical parameters: the identified ones, then others for which the basis should serve.
    outputs : sequence of Dof or ElementOutput
    inputs : sequence of Dof or Base
    derivative : {0, 1, 2}
        Of the motions among the outputs.
    band : (float, float)
        Hz, in which the basis serves.
    is_viscous : bool
        Whether loss factors are replaced by viscous dampings that take as much energy at each resonance.
    relative : bool
        Whether motions are those beyond the quasi-static motion that the supports force on the structure. Where all
        supports move alike, this is the motion against the ground.

    Returns
    -------
    LinearResponse
        Map of the outputs, and a function from physical parameters (n_params,) to a sum over poles of displacements.

    Raises
    ------
    InputError
        If an input is a base and the structure can move as a rigid body even with its supports fixed.
    """
    bases = tuple(each for each in inputs if isinstance(each, Base))
    if bases:
        return _with_supports(
            structure, parameters, points, outputs, inputs, bases, derivative, band, is_viscous, relative
        )
    found = output_map(structure, outputs, derivative)
    loads = structure.selection([each for each in inputs if isinstance(each, Dof)])
    nominal = parameters.values(points[0])
    basis = reduction_basis(
        structure, [parameters.values(each) for each in points], Sides(found.rows(nominal), loads), *band
    )

    def poles_at(physical: FloatArray) -> PoleSum:
        values = parameters.values(physical)
        reduced = reduce_structure(structure, values, basis, Sides(found.rows(values), loads))
        return sum_over_poles(reduced, reduced.viscous_equivalent() if is_viscous else None)

    return LinearResponse(found, poles_at)


def _with_supports(
    structure: Structure,
    parameters: Parameters,
    points: Sequence[FloatArray],
    outputs: Sequence[Output],
    inputs: Sequence[Input],
    bases: tuple[Base, ...],
    derivative: int,
    band: tuple[float, float],
    is_viscous: bool,
    relative: bool,
) -> LinearResponse:
    """Response of a structure to forces and to accelerations of its moving supports `bases`, at least one.

    With u = G u_g + r, where G is the quasi-static motion under unit motion of each base, the rest obeys M r'' + C r' +
    K r = -(M G + M_g) u_g'' - (C G + C_g) u_g' (Clough and Penzien 1993, Dynamics of Structures, Eq. 26.11), M_g and
    C_g the masses and dampings between structure and supports. Loss factors and modal damping act on r alone. The other
    arguments, and the result, are those of `linear_response`. `InputError` if the structure can move as a rigid body
    with its supports fixed.
    """
    released = replace(structure, damping_ratio=None).release_supports(bases)
    found = output_map(released, outputs, derivative)
    number_of = {code: index for index, code in enumerate(released.numbering.free)}
    free = np.array([number_of[code] for code in structure.numbering.free], dtype=np.int64)
    support = released.selection([base.supports[0] for base in bases])
    loads = structure.selection([each for each in inputs if isinstance(each, Dof)])
    is_base = np.array([isinstance(each, Base) for each in inputs])
    hidden = (
        np.tile(found.is_motion, len(found.orders)) if relative else np.zeros(len(found.orders) * found.n_rows, bool)
    )
    plain = replace(structure, damping_ratio=None)
    same_values = slice(0, len(released.values))  # the damping ratio of all modes stands last

    def columns_at(values: FloatArray, kind: str, motion: FloatArray) -> FloatArray:
        """Forces (n_free, n_bases) of the matrix `kind` under `motion` (n_free, n_bases) and one base at a time by 1.

        `motion` is that of the free degrees of freedom; `values` are the property values.
        """
        inner, whole = plain.matrix(kind, values[same_values]), released.matrix(kind, values[same_values])
        return np.asarray(inner @ motion + (whole @ support).toarray()[free])

    def quasi_static(values: FloatArray) -> FloatArray:
        """Quasi-static motion (n_free, n_bases) of the free degrees of freedom under unit motion of each base.

        `values` (n_values,) are the property values. `InputError` if the structure can move freely with its supports
        fixed.
        """
        stiffness = sparse.csc_array(plain.matrix("stiffness", values[same_values]))
        stiffness.sort_indices()
        pulled = columns_at(values, "stiffness", np.zeros((len(free), len(bases))))
        if not stiffness.diagonal().all():
            _refuse_loose(structure, bases)
        solver = factorizer().analyse(stiffness.indices, stiffness.indptr).factor(stiffness.data)
        motion = -np.asarray(solver.solve(pulled))
        if not np.isfinite(motion).all() or np.abs(motion).max(initial=0.0) > _MOST_MOVED:
            _refuse_loose(structure, bases)
        return np.asarray(motion, dtype=np.float64)

    values_of = [parameters.values(each) for each in points]
    statics = [quasi_static(values) for values in values_of]
    pushes = columns_at(values_of[0], "mass", statics[0])
    inner_rows = found.rows(values_of[0])[free, :]
    sides = Sides(inner_rows, sparse.csc_array(sparse.hstack([loads, sparse.csc_array(pushes)])))
    basis = reduction_basis(structure, values_of, sides, *band)
    basis = extend_basis(basis, np.hstack(statics), plain.matrix("mass", values_of[0][same_values]))
    everything = sparse.csc_array(sparse.eye_array(len(free)))

    def poles_at(physical: FloatArray) -> PoleSum:
        """Response (rows of the outputs by `inputs`) as a sum over poles, at the physical parameters (n_params,).

        Outputs are displacements per unit force and per unit acceleration of each base. `InputError` if the structure
        can move freely with its supports fixed.
        """
        values = parameters.values(physical)
        reduced = reduce_structure(structure, values, basis, Sides(everything, loads))
        if reduced.is_rigid.any():
            _refuse_loose(structure, bases)
        motions, rows = reduced.outputs, found.rows(values)
        rest = motions.T @ columns_at(values, "stiffness", statics[0])
        static = statics[0] - motions @ (rest / (reduced.omega**2)[:, None])
        by_acceleration = -motions.T @ columns_at(values, "mass", static)
        by_speed = -motions.T @ columns_at(values, "damping", static)
        read = replace(
            reduced, outputs=rows[free, :].T @ motions, inputs=np.hstack([reduced.inputs, by_acceleration, by_speed])
        )
        poles = sum_over_poles(read, reduced.viscous_equivalent() if is_viscous else None)
        n_loads, n_bases = loads.shape[1], len(bases)
        forced, shaken, dragged = np.split(poles.into, [n_loads, n_loads + n_bases], axis=1)
        dragged = dragged / poles.poles[:, None]
        into = np.zeros((len(poles.poles), len(inputs)), dtype=complex)
        into[:, ~is_base], into[:, is_base] = forced, shaken + dragged
        integrals = np.zeros((3, len(poles.out), len(inputs)), dtype=complex)
        carried = rows[free, :].T @ static + (rows.T @ support).toarray()
        integrals[0][:, is_base] = np.where(hidden[:, None], 0.0, carried)
        integrals[1][:, is_base] = -poles.out @ dragged
        return PoleSum(poles.poles, poles.out, into, integrals)

    return LinearResponse(found, poles_at)


#: Motion per motion of supports beyond which they are not what holds the structure.
_MOST_MOVED = 1e8


def _refuse_loose(structure: Structure, bases: Sequence[Base]) -> None:
    names = ", ".join(dof.place for base in bases for dof in base.supports)
    raise InputError(
        f"the structure can move as a rigid body even with its supports at {names} fixed, so that their motion does not determine"
        " its own; support the loose part"
    )
