"""Components: parts of a structure that are reduced once, to their interface and a few modes of their own."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import linalg, sparse

from structid.core.arrays import FloatArray, IntArray, locked
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError
from structid.dynamics.factorization import SingularMatrixError, factorizer
from structid.dynamics.normal_modes import modes
from structid.fem.contribution import MATRIX_KINDS, Property, weigh_properties
from structid.fem.elements import MatrixGroup
from structid.fem.elements.element import (
    ElementMatrixTerm,
    Power,
    PropertyMatrices,
    dof_code,
    dof_of_code,
    joined_codes,
)
from structid.fem.supports import DofEquations, FollowingDofs, Numbering, free_blocks

#: Modes that are sought first; twice as many until one lies above the limit.
_FIRST_MODES = 20
#: Roundings of the stiffness below which a square of a frequency is none.
_ROUNDINGS = 1e3
#: Part of the stiffness by which loss factors may differ and count as one.
_SAME_LOSS = 1e-12
#: Shift of a stiffness that holds nothing, in parts of the limit squared; part of a static motion that modes must lack.
_SHIFT, _NEW = 1e-6, 1e-9


@dataclass(frozen=True)
class Component:
    """A part of a structure that is reduced once, so that a large model costs little in each iteration.

    It moves as its interface makes it move without force inside (constraint modes), and in its lowest modes with the
    interface held (Craig and Bampton), beside the static answer to the inertia of the constraint modes, which stands
    for the modes left out. Its interface is where other element sets, ties and bases are, and what `interface` names.
    Sensors may be anywhere in it, and loads too, but loads amid it are answered best where they are named in
    `interface`.

    Its element sets have no properties of their own any more. It has factors ``mass``, ``stiffness`` and ``damping`` of
    nominal value 1, with which its modes stay what they are, and the ``loss_factor`` that all of it has (a factor
    ``structural_damping`` where its sets have several).

    Parameters
    ----------
    name : str
        Of what it becomes.
    elements : sequence of str
        Element sets that it is made of.
    up_to : float
        Modes up to this frequency are kept, Hz. Three times the highest frequency that counts is usual.
    interface : sequence of Dof
        Further degrees of freedom that are kept, such as those of loads amid the component.
    whole : bool
        Whether nothing is left out; to see what the reduction costs.

    References
    ----------
    Craig and Bampton (1968), AIAA Journal 6(7), 1313-1319; Dickens, Nakagawa and Wittbrodt (1997), Computers &
    Structures 62(6), 985-998, for vectors beside truncated modes.
    """

    name: str
    elements: tuple[str, ...]
    up_to: float
    interface: tuple[Dof, ...]
    whole: bool

    def __init__(
        self,
        name: str,
        elements: str | Iterable[str],
        up_to: float,
        interface: str | Dof | Iterable[str | Dof] = (),
        whole: bool = False,
    ) -> None:
        """A component of the element sets `elements`, reduced to its interface and to modes up to `up_to`, Hz.

        `elements` are names of element sets. `interface` are degrees of freedom kept beside those shared with other
        parts of the structure; signs are dropped. `whole` keeps the component unreduced.

        Raises
        ------
        InputError
            If there is no element set, or `up_to` is not a finite frequency above 0.
        """
        listed = (interface,) if isinstance(interface, str | Dof) else tuple(interface)
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "elements", (elements,) if isinstance(elements, str) else tuple(elements))
        object.__setattr__(self, "up_to", float(up_to))
        object.__setattr__(self, "interface", tuple(dof.unsigned for dof in parse_dofs(listed)))
        object.__setattr__(self, "whole", whole)
        if not self.elements:
            raise InputError(f"component {name!r} has no element sets; name them in `elements`")
        if not (np.isfinite(self.up_to) and self.up_to > 0):
            raise InputError(f"`up_to` of component {name!r} must be a frequency above 0, Hz, got {up_to}")

    def with_interface(self, dofs: Iterable[Dof]) -> Component:
        """Copy with more degrees of freedom on its interface."""
        return replace(self, interface=(*self.interface, *sorted(dofs)))


@dataclass(frozen=True, eq=False)
class Reduction:
    """A component with its matrices, and how it follows what is left of it.

    Attributes
    ----------
    component : Component
    group : MatrixGroup
        All of its degrees of freedom with its matrices, nothing reduced: ties reduce them.
    terms : tuple of PropertyMatrices
        Its properties.
    following : FollowingDofs, optional
        How the degrees of freedom inside it follow its interface and some of their own, which stand for its modes.
    n_interface, n_modes : int
    """

    component: Component
    group: MatrixGroup
    terms: tuple[PropertyMatrices, ...]
    following: FollowingDofs | None
    n_interface: int
    n_modes: int

    @property
    def inside(self) -> tuple[Dof, ...]:
        """Degrees of freedom that follow others."""
        return () if self.following is None else tuple(dof_of_code(code) for code in self.following.dependents.tolist())

    @property
    def words(self) -> str:
        """A sentence on the reduction: sizes before and after, number of modes and their frequency limit.

        Without a reduction it says that the component is not reduced.
        """
        whole = f"component {self.component.name}: {len(self.group.dofs)} degrees of freedom"
        if self.following is None:
            return f"{whole}, not reduced"
        n_static = len(self.following.masters) - self.n_interface - self.n_modes
        return (
            f"{whole} reduced to {self.n_interface} of its interface, {self.n_modes} modes up to {self.component.up_to:g} Hz and"
            f" {n_static} static motions"
        )


def reductions(
    components: Sequence[Component],
    properties_of_set: Mapping[str, tuple[PropertyMatrices, ...]],
    equations: DofEquations,
    constrained: frozenset[int],
    kept: IntArray,
) -> tuple[Reduction, ...]:
    """Reduction of each of `components` to its interface and a few modes, in the order of `components`.

    A code is 6 times the label of a node plus 0 to 5 for X, Y, Z, RX, RY, RZ.

    Parameters
    ----------
    components : sequence of Component
    properties_of_set : mapping of str to tuple of PropertyMatrices
        Properties of all element sets, by the name of the set.
    equations : mapping
        Codes of dependent degrees of freedom, each with the codes and weights that it follows.
    constrained : frozenset of int
        Codes held at zero.
    kept : (n,) int array
        Codes that are always part of the interface, such as those of measured components.

    Returns
    -------
    tuple of Reduction
        Matrices of each component, and how its inner degrees of freedom follow its interface and some of their own.

    Raises
    ------
    InputError
        If element sets are not there or in two components, or a component has no interface or no inside, or cannot be
        reduced.
    """
    owners: dict[str, Component] = {}
    for component in components:
        for name in component.elements:
            if name not in properties_of_set:
                near = difflib.get_close_matches(name, properties_of_set, 1, 0.0)
                nearest = f"; the nearest is {near[0]!r}" if near else ""
                raise InputError(f"component {component.name!r}: there is no element set {name!r}{nearest}")
            if name in owners:
                raise InputError(
                    f"component {component.name!r}: element set {name!r} is in component {owners[name].name!r} already; take it"
                    " out of one of them"
                )
            owners[name] = component
    codes = {
        name: joined_codes([matrix_term.codes for term in terms for matrix_term in term.matrix_terms])
        for name, terms in properties_of_set.items()
    }
    tied = joined_codes([kept, _codes_in_ties(equations, joined_codes([*codes.values(), kept]))])
    reduced = []
    for component in components:
        own_codes = joined_codes([codes[name] for name in component.elements])
        others = [codes[name] for name in properties_of_set if name not in component.elements]
        joined = joined_codes([tied, _interface_codes(component, own_codes, equations), *others])
        reduced.append(
            _reduce_component(
                component,
                {name: properties_of_set[name] for name in component.elements},
                own_codes,
                joined,
                constrained,
            )
        )
    return tuple(reduced)


def _codes_in_ties(equations: DofEquations, used_codes: IntArray) -> IntArray:
    """Codes in `used_codes` that ties make dependent, with all codes that they follow through ties; sorted, (n_codes,).

    A code is 6 times the label of a node plus 0 to 5 for X to RZ. `equations` maps dependent codes to the codes and
    weights that they follow. Codes of `used_codes` without an equation are left out, and so are dependents outside
    `used_codes`: they only read an element.
    """
    codes, pending = set(), [code for code in used_codes.tolist() if code in equations]
    while pending:
        code = pending.pop()
        if code not in codes:
            codes.add(code)
            pending += equations.get(code, {})
    return np.array(sorted(codes), dtype=np.int64)


def _reduce_component(
    component: Component,
    properties_of_set: Mapping[str, tuple[PropertyMatrices, ...]],
    codes: IntArray,
    joined: IntArray,
    constrained: frozenset[int],
) -> Reduction:
    """The component as one group of matrices, and how its inner degrees of freedom follow its interface and modes.

    How they follow is None if `component.whole`, which nothing reduces. `properties_of_set` are the properties of its
    element sets by name, and `codes` (6 times the node plus 0 to 5 for X to RZ) its degrees of freedom, in the order of
    the group. `joined` are the codes to keep and `constrained` those held at zero, both of the whole structure. Raises
    `InputError` if no code is kept or none is inside, or the component cannot be reduced.
    """
    matrices = _nominal_matrices(component, properties_of_set, codes)
    kept, free = np.isin(codes, joined), ~np.isin(codes, list(constrained))
    border, inside = np.flatnonzero(kept & free), np.flatnonzero(~kept & free)
    if not kept.any():
        raise InputError(
            f"component {component.name!r} has no interface: nothing else of the structure is at its nodes; join it by springs,"
            " other elements or ties, or name degrees of freedom that are kept in `interface`"
        )
    if not len(inside):
        raise InputError(
            f"component {component.name!r} has no degrees of freedom inside: all {len(codes)} belong to its interface or are"
            " held; leave it out"
        )
    group, new_terms = _as_matrix_group(component, codes, matrices)
    if component.whole:
        return Reduction(component, group, new_terms, None, len(border), len(inside))
    driven, shapes, n_modes = _reduction_basis(component, matrices, border, inside)
    chosen = linalg.qr(shapes.T, mode="r", pivoting=True)[1][: shapes.shape[1]]
    modal = linalg.solve(shapes[chosen].T, shapes.T).T if shapes.size else shapes
    matrix = np.concatenate([driven - modal @ driven[chosen], modal], axis=1)
    dependent = np.setdiff1d(np.arange(len(inside)), chosen)
    masters = np.concatenate([codes[border], codes[inside[chosen]]])
    following = FollowingDofs(locked(codes[inside[dependent]]), locked(masters), locked(matrix[dependent]))
    return Reduction(component, group, new_terms, following, len(border), n_modes)


def _interface_codes(component: Component, codes: IntArray, equations: DofEquations) -> IntArray:
    """Codes (n,) of a component that its `interface` names, and those that they follow through ties.

    They are in the order of `interface`, sorted for each entry, and may repeat. `codes` are those of the component,
    sorted, and `equations` the ties; the result is a subset. Raises `InputError` if a degree of freedom of `interface`,
    and all that it follows, are not among them.
    """
    parts = [np.zeros(0, dtype=np.int64)]
    for dof in component.interface:
        code = dof_code(dof.node, dof.direction)
        parts.append(np.intersect1d(codes, [code, *_codes_in_ties(equations, np.array([code]))]))
        if not len(parts[-1]):
            order = np.lexsort((np.abs(codes - code), codes // 6 != dof.node))
            raise InputError(
                f"component {component.name!r}: {dof.place} of `interface` is no degree of freedom of it; the nearest is"
                f" {dof_of_code(int(codes[order[0]])).place}"
            )
    return np.concatenate(parts)


def _nominal_matrices(
    component: Component, properties_of_set: Mapping[str, tuple[PropertyMatrices, ...]], codes: IntArray
) -> dict[str, sparse.csc_array]:
    """Matrices of a component at nominal property values by kind, sparse (n_codes, n_codes); all zero if it has none.

    Kinds are "mass", "damping", "stiffness" and "structural_damping". `properties_of_set` are the properties of its
    element sets by name, `codes` (n_codes,) its degrees of freedom in order (6 times the node plus 0 to 5 for X to RZ).
    Raises `InputError` if a set has friction or lengths that are properties, which no reduction keeps.
    """
    properties, start = [], 0
    for name, several in properties_of_set.items():
        for term in several:
            properties.append(Property(name, term, slice(start, start + len(term.values))))
            start += len(term.values)
            if term.kind == "friction" or any(matrix_term.length_power for matrix_term in term.matrix_terms):
                what = "rubs" if term.kind == "friction" else "has an end that slides"
                raise InputError(
                    f"component {component.name!r}: element set {name!r} {what}, which no reduction keeps; take it out of"
                    " `elements`"
                )
    values = np.concatenate([item.term.values for item in properties])
    numbering = Numbering(codes, sparse.eye_array(len(codes), format="csr"), tuple(codes.tolist()))
    matrices = dict.fromkeys(MATRIX_KINDS, sparse.csc_array((len(codes), len(codes))))
    for part in weigh_properties(properties, partial(free_blocks, numbering), {}):
        matrices[part.matrix_kind] = matrices[part.matrix_kind] + part.blocks.assemble(part.weights(values))
    return matrices


def _as_matrix_group(
    component: Component, codes: IntArray, matrices: Mapping[str, sparse.csc_array]
) -> tuple[MatrixGroup, tuple[PropertyMatrices, ...]]:
    """The component as a group of matrices with one factor each, and the properties of that group with their matrices.

    `codes` (n_codes,), 6 times the node plus 0 to 5 for X to RZ, are the degrees of freedom of the rows of the
    `matrices` (by kind). If structural damping is one multiple of the stiffness, to 1e-12, the group has that loss
    factor; otherwise a property with the matrix of structural damping stands in its place.
    """
    stiffness, structural = matrices["stiffness"], matrices["structural_damping"]
    largest = abs(stiffness).max()
    largest_entry = np.unravel_index(abs(stiffness).argmax(), stiffness.shape)
    loss = float(structural[largest_entry] / stiffness[largest_entry]) if largest > 0 else 0.0
    is_one = abs(structural - loss * stiffness).max() <= _SAME_LOSS * loss * largest
    parts = {kind: matrices[kind] if matrices[kind].nnz else None for kind in ("mass", "stiffness", "damping")}
    dofs = tuple(dof_of_code(code) for code in codes.tolist())
    group = MatrixGroup(component.name, dofs, **parts, loss_factor=loss if is_one else 0.0)
    terms = group.property_matrices({}, joined_codes([]))
    if is_one:
        return group, terms
    matrix_term = ElementMatrixTerm(
        codes[None],
        np.zeros((1, 0, 0)),
        whole=structural,
        matrix_kind="structural_damping",
        powers=(Power("stiffness", 1.0, 1),),
    )
    undamped = [term for term in terms if term.kind != "loss_factor"]
    return group, (*undamped, PropertyMatrices("structural_damping", "parameter", "1", np.ones(1), [matrix_term]))


def _reduction_basis(
    component: Component,
    matrices: Mapping[str, sparse.csc_array],
    border: IntArray,
    inside: IntArray,
) -> tuple[FloatArray, FloatArray, int]:
    """Static motions (n_inside, n_border), shapes with the border fixed (n_inside, n_shapes), and number of modes.

    The first of the shapes are the modes K_ii phi = omega^2 M_ii phi, scaled to length 1; then come orthonormal shapes
    that span the rest of K_ii^-1 (M_ii Psi + M_ib), where Psi = -K_ii^-1 K_ib are the static motions. Motions without
    force are among the modes; K_ii then has a small shift, which changes Psi by these motions alone. `matrices` are
    those of the component by kind; `border` and `inside` index their rows.
    """
    stiffness, mass = matrices["stiffness"], matrices["mass"]
    stiffness_inside, mass_inside = (sparse.csc_array(matrix[inside][:, inside]) for matrix in (stiffness, mass))
    stiffness_coupling, mass_coupling = (matrix[inside][:, border].toarray() for matrix in (stiffness, mass))
    shapes, is_loose = _modes_up_to_limit(component, mass_inside, stiffness_inside)
    shift = _SHIFT * (2 * np.pi * component.up_to) ** 2 if is_loose else 0.0
    solve = _factorized_solver(component, sparse.csc_array(stiffness_inside + shift * mass_inside))
    static = -solve(stiffness_coupling + shift * mass_coupling)
    slow = solve(mass_coupling + mass_inside @ static)
    size = np.linalg.norm(slow, axis=0)
    slow = slow[:, size > 0] / size[size > 0]
    for _ in range(2):
        slow = slow - shapes @ (shapes.T @ (mass_inside @ slow))
    left, singular, _ = np.linalg.svd(slow, full_matrices=False)
    n_new = min(int((singular > _NEW).sum()), len(inside) - shapes.shape[1])
    unit = shapes / np.linalg.norm(shapes, axis=0)
    return static, np.concatenate([unit, left[:, :n_new]], axis=1), shapes.shape[1]


def _modes_up_to_limit(
    component: Component, mass: sparse.csc_array, stiffness: sparse.csc_array
) -> tuple[FloatArray, bool]:
    """Modes up to the frequency limit of `component`, (n_dofs, n_modes), and True if one is a motion without force.

    `mass` and `stiffness` are those inside the component, with its border fixed; shapes are mass-normalized. Without
    any mass there are no modes, (n_dofs, 0). Raises `InputError` if a motion has neither mass nor stiffness.
    """
    count, n = _FIRST_MODES, mass.shape[0]
    if not mass.nnz:
        return np.zeros((n, 0)), False
    try:
        while True:
            result = modes(mass, stiffness, n_modes=count)
            if result.frequency[-1] > component.up_to or len(result.frequency) < count or count >= n:
                break
            count *= 2
    except (np.linalg.LinAlgError, SingularMatrixError) as error:
        raise _mechanism(component) from error
    shapes: FloatArray = result.mode_shapes[:, result.frequency <= component.up_to]
    size = np.abs(shapes)
    rounding = np.finfo(np.float64).eps * np.einsum("ij,ij->j", size, abs(stiffness) @ size)
    is_loose = (2 * np.pi * result.frequency[: shapes.shape[1]]) ** 2 <= _ROUNDINGS * rounding
    return shapes, bool(is_loose.any())


def _factorized_solver(component: Component, matrix: sparse.csc_array) -> Callable[[FloatArray], FloatArray]:
    """A function that solves A x = right for the positive definite `matrix` A, right-hand sides (n_dofs, n_right).

    `component` is named in the `InputError` that is raised if A is singular.
    """
    matrix.sort_indices()
    if not matrix.diagonal().all():
        raise _mechanism(component)
    try:
        factor = factorizer().analyse(matrix.indices, matrix.indptr).factor(matrix.data)
    except SingularMatrixError as error:
        raise _mechanism(component) from error
    return lambda right: np.asarray(factor.solve(right))


def _mechanism(component: Component) -> InputError:
    return InputError(
        f"component {component.name!r} can move inside with neither stiffness nor mass; fix loose parts with `fixed`, leave its"
        " direction out of `active`, or give it stiffness"
    )
