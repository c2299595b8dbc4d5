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
from structid.fem.elements import MatrixGroup
from structid.fem.elements.element import Layer, Power, Term, dof_code, dof_of_code, joined_codes
from structid.fem.matrices.contribution import Property, weighed
from structid.fem.numbering import Numbering, free_blocks
from structid.fem.supports import Equations, Following

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
    interface held (Craig and Bampton), beside the static answer to the inertia of the constraint modes, which stands for
    the modes left out. Its interface is where other element sets, ties and bases are, and what `interface` names. Sensors
    may be anywhere in it, and loads too, but loads amid it are answered best where they are named in `interface`.

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
    Craig and Bampton (1968), AIAA Journal 6(7), 1313-1319; Dickens, Nakagawa and Wittbrodt (1997), Computers & Structures
    62(6), 985-998, for vectors beside truncated modes.
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
        given = (interface,) if isinstance(interface, str | Dof) else tuple(interface)
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "elements", (elements,) if isinstance(elements, str) else tuple(elements))
        object.__setattr__(self, "up_to", float(up_to))
        object.__setattr__(self, "interface", tuple(dof.unsigned for dof in parse_dofs(given)))
        object.__setattr__(self, "whole", whole)
        if not self.elements:
            raise InputError(f"component {name!r} has no element sets; name them in `elements`")
        if not (np.isfinite(self.up_to) and self.up_to > 0):
            raise InputError(f"`up_to` of component {name!r} must be a frequency above 0, Hz, got {up_to}")

    def with_interface(self, dofs: Iterable[Dof]) -> Component:
        """The same with more of it kept."""
        return replace(self, interface=(*self.interface, *sorted(dofs)))


@dataclass(frozen=True, eq=False)
class Reduction:
    """A component with its matrices, and how it follows what is left of it.

    Attributes
    ----------
    component : Component
    group : MatrixGroup
        All of its degrees of freedom with its matrices, nothing reduced: ties reduce them.
    terms : tuple of Term
        Its properties.
    following : Following, optional
        How the degrees of freedom inside it follow its interface and some of their own, which stand for its modes.
    n_interface, n_modes : int
    """

    component: Component
    group: MatrixGroup
    terms: tuple[Term, ...]
    following: Following | None
    n_interface: int
    n_modes: int

    @property
    def inside(self) -> tuple[Dof, ...]:
        """Degrees of freedom that follow others."""
        return () if self.following is None else tuple(dof_of_code(code) for code in self.following.dependents.tolist())

    @property
    def words(self) -> str:
        """What was reduced to what."""
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
    terms: Mapping[str, tuple[Term, ...]],
    equations: Equations,
    held: frozenset[int],
    kept: IntArray,
) -> tuple[Reduction, ...]:
    """All `components` reduced.

    Parameters
    ----------
    components : sequence of Component
    terms : mapping of str to tuple of Term
        Properties of all element sets, by the name of the set.
    equations : mapping
        What ties make of degrees of freedom.
    held : frozenset of int
        Codes at zero.
    kept : (n,) int array
        Codes that belong to no component alone, whatever else is there.

    Raises
    ------
    InputError
        If element sets are not there or in two components, or a component has no interface or no inside, or cannot be reduced.
    """
    owners: dict[str, Component] = {}
    for component in components:
        for name in component.elements:
            if name not in terms:
                near = difflib.get_close_matches(name, terms, 1, 0.0)
                nearest = f"; the nearest is {near[0]!r}" if near else ""
                raise InputError(f"component {component.name!r}: there is no element set {name!r}{nearest}")
            if name in owners:
                raise InputError(
                    f"component {component.name!r}: element set {name!r} is in component {owners[name].name!r} already; take it"
                    " out of one of them"
                )
            owners[name] = component
    codes = {name: joined_codes([layer.codes for term in own for layer in term.layers]) for name, own in terms.items()}
    tied = joined_codes([kept, _tied(equations, joined_codes([*codes.values(), kept]))])
    found = []
    for one in components:
        own = joined_codes([codes[name] for name in one.elements])
        others = [codes[name] for name in terms if name not in one.elements]
        joined = joined_codes([tied, _named(one, own, equations), *others])
        found.append(_reduction(one, {name: terms[name] for name in one.elements}, own, joined, held))
    return tuple(found)


def _tied(equations: Equations, moved: IntArray) -> IntArray:
    """Codes that ties of what elements use depend on, and these; what only reads an element is no part of its interface."""
    found, pending = set(), [code for code in moved.tolist() if code in equations]
    while pending:
        code = pending.pop()
        if code not in found:
            found.add(code)
            pending += equations.get(code, {})
    return np.array(sorted(found), dtype=np.int64)


def _reduction(
    component: Component,
    terms: Mapping[str, tuple[Term, ...]],
    codes: IntArray,
    joined: IntArray,
    held: frozenset[int],
) -> Reduction:
    """A component of sets with these terms and codes, of which it is to keep those that are `joined`."""
    matrices = _matrices(component, terms, codes)
    kept, free = np.isin(codes, joined), ~np.isin(codes, list(held))
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
    group, made = _group(component, codes, matrices)
    if component.whole:
        return Reduction(component, group, made, None, len(border), len(inside))
    driven, shapes, n_modes = _basis(component, matrices, border, inside)
    chosen = linalg.qr(shapes.T, mode="r", pivoting=True)[1][: shapes.shape[1]]
    modal = linalg.solve(shapes[chosen].T, shapes.T).T if shapes.size else shapes
    matrix = np.concatenate([driven - modal @ driven[chosen], modal], axis=1)
    others = np.setdiff1d(np.arange(len(inside)), chosen)
    masters = np.concatenate([codes[border], codes[inside[chosen]]])
    following = Following(locked(codes[inside[others]]), locked(masters), locked(matrix[others]))
    return Reduction(component, group, made, following, len(border), n_modes)


def _named(component: Component, codes: IntArray, equations: Equations) -> IntArray:
    """Those of the `codes` of a component that its `interface` names, or points of it that follow them."""
    found = [np.zeros(0, dtype=np.int64)]
    for dof in component.interface:
        code = dof_code(dof.node, dof.direction)
        found.append(np.intersect1d(codes, [code, *_tied(equations, np.array([code]))]))
        if not len(found[-1]):
            order = np.lexsort((np.abs(codes - code), codes // 6 != dof.node))
            raise InputError(
                f"component {component.name!r}: {dof.place} of `interface` is no degree of freedom of it; the nearest is"
                f" {dof_of_code(int(codes[order[0]])).place}"
            )
    return np.concatenate(found)


def _matrices(
    component: Component, terms: Mapping[str, tuple[Term, ...]], codes: IntArray
) -> dict[str, sparse.csc_array]:
    """Matrices of a component by law, at nominal values."""
    properties, start = [], 0
    for name, several in terms.items():
        for term in several:
            properties.append(Property(name, term, slice(start, start + len(term.values))))
            start += len(term.values)
            if term.kind == "friction" or any(layer.stretch for layer in term.layers):
                what = "rubs" if term.kind == "friction" else "has an end that slides"
                raise InputError(
                    f"component {component.name!r}: element set {name!r} {what}, which no reduction keeps; take it out of"
                    " `elements`"
                )
    values = np.concatenate([item.term.values for item in properties])
    every = Numbering(codes, sparse.eye_array(len(codes), format="csr"), tuple(codes.tolist()))
    found = dict.fromkeys(("inertia", "viscous", "elastic", "structural"), sparse.csc_array((len(codes), len(codes))))
    for part in weighed(properties, partial(free_blocks, every), {}):
        found[part.law] = found[part.law] + part.blocks.assemble(part.weights(values))
    return found


def _group(
    component: Component, codes: IntArray, matrices: Mapping[str, sparse.csc_array]
) -> tuple[MatrixGroup, tuple[Term, ...]]:
    """The component as a group of matrices, and its properties."""
    stiffness, structural = matrices["elastic"], matrices["structural"]
    largest = abs(stiffness).max()
    at = np.unravel_index(abs(stiffness).argmax(), stiffness.shape)
    loss = float(structural[at] / stiffness[at]) if largest > 0 else 0.0
    is_one = abs(structural - loss * stiffness).max() <= _SAME_LOSS * loss * largest
    given = {
        key: matrices[law] if matrices[law].nnz else None
        for key, law in (("mass", "inertia"), ("stiffness", "elastic"), ("damping", "viscous"))
    }
    dofs = tuple(dof_of_code(code) for code in codes.tolist())
    group = MatrixGroup(component.name, dofs, **given, loss_factor=loss if is_one else 0.0)
    terms = group.terms({}, joined_codes([]))
    if is_one:
        return group, terms
    layer = Layer(
        codes[None], np.zeros((1, 0, 0)), whole=structural, law="structural", powers=(Power("stiffness", 1.0, 1),)
    )
    kept = [term for term in terms if term.kind != "loss_factor"]
    return group, (*kept, Term("structural_damping", "parameter", "1", np.ones(1), [layer]))


def _basis(
    component: Component,
    matrices: Mapping[str, sparse.csc_array],
    border: IntArray,
    inside: IntArray,
) -> tuple[FloatArray, FloatArray, int]:
    """Motions that the border makes (n_inside, n_border), motions with the border held (n_inside, n_held), and its modes.

    With the border held, first come modes K_ii phi = omega^2 M_ii phi, so many as the last number says, then what they lack of
    K_ii^-1 (M_ii Psi + M_ib), where Psi = -K_ii^-1 K_ib. Motions without force are among the modes; K_ii then has a small
    shift, which changes Psi by these motions alone.
    """
    stiffness, mass = matrices["elastic"], matrices["inertia"]
    elastic, heavy = (sparse.csc_array(matrix[inside][:, inside]) for matrix in (stiffness, mass))
    pull, drag = (matrix[inside][:, border].toarray() for matrix in (stiffness, mass))
    shapes, is_loose = _modes(component, heavy, elastic)
    shift = _SHIFT * (2 * np.pi * component.up_to) ** 2 if is_loose else 0.0
    solve = _solver(component, sparse.csc_array(elastic + shift * heavy))
    driven = -solve(pull + shift * drag)
    slow = solve(drag + heavy @ driven)
    size = np.linalg.norm(slow, axis=0)
    slow = slow[:, size > 0] / size[size > 0]
    for _ in range(2):
        slow = slow - shapes @ (shapes.T @ (heavy @ slow))
    left, singular, _ = np.linalg.svd(slow, full_matrices=False)
    n_new = min(int((singular > _NEW).sum()), len(inside) - shapes.shape[1])
    unit = shapes / np.linalg.norm(shapes, axis=0)
    return driven, np.concatenate([unit, left[:, :n_new]], axis=1), shapes.shape[1]


def _modes(component: Component, mass: sparse.csc_array, stiffness: sparse.csc_array) -> tuple[FloatArray, bool]:
    """All modes up to the limit of `component`, and whether one of them is a motion without force."""
    count, n = _FIRST_MODES, mass.shape[0]
    if not mass.nnz:
        return np.zeros((n, 0)), False
    try:
        while True:
            found = modes(mass, stiffness, n_modes=count)
            if found.frequency[-1] > component.up_to or len(found.frequency) < count or count >= n:
                break
            count *= 2
    except (np.linalg.LinAlgError, SingularMatrixError) as error:
        raise _mechanism(component) from error
    shapes: FloatArray = found.mode_shapes[:, found.frequency <= component.up_to]
    size = np.abs(shapes)
    rounding = np.finfo(np.float64).eps * np.einsum("ij,ij->j", size, abs(stiffness) @ size)
    is_loose = (2 * np.pi * found.frequency[: shapes.shape[1]]) ** 2 <= _ROUNDINGS * rounding
    return shapes, bool(is_loose.any())


def _solver(component: Component, matrix: sparse.csc_array) -> Callable[[FloatArray], FloatArray]:
    """Solutions with a positive definite matrix."""
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
        f"component {component.name!r} can move inside with neither stiffness nor mass; hold what is loose in `fixed`, leave its"
        " direction out of `active`, or give it stiffness"
    )
