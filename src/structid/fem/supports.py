"""Constraints of a structure (supports, rigid links, multi-point constraints), and the degrees of freedom left free."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray
from structid.core.dof import DIRECTIONS, Dof, parse_dof
from structid.core.errors import InputError
from structid.fem.blocks import Blocks, ElementMatrices, MatrixBlocks
from structid.fem.elements.element import ElementMatrixTerm, dof_code, dof_of_code

DofEquations = dict[int, dict[int, float]]
#: Part of a map to free degrees of freedom from which on it is full.
_FULL = 0.2


@dataclass(frozen=True, eq=False)
class FollowingDofs:
    """Very many degrees of freedom that follow the same others.

    Attributes
    ----------
    dependents, masters : (n_dependents,), (n_masters,) int arrays
        Codes.
    matrix : (n_dependents, n_masters) float array
        Motion of each dependent for a unit motion of each master.
    """

    dependents: IntArray
    masters: IntArray
    matrix: FloatArray


class Tie(Protocol):
    """Anything that makes degrees of freedom depend on others."""

    @property
    def name(self) -> str: ...

    def equations(self, positions: Mapping[int, FloatArray], active: Sequence[str]) -> DofEquations:
        """Equations of the dependent degrees of freedom: {dependent code: {code that it follows: coefficient}}.

        `positions` of nodes in m; `active` are the directions in which nodes move.
        """
        ...


@dataclass(frozen=True)
class RigidLink:
    """Nodes that move with a main node as one rigid body: u = u_main + rotation x (position - position_main).

    Parameters
    ----------
    name : str
        Name of the link.
    main : int
        Node that carries the motion.
    dependents : tuple of int
        Nodes that follow it.
    directions : tuple of str, optional
        In which they follow it; in every active direction by default. X, Y and RZ make a floor that is rigid in its
        plane.
    """

    name: str
    main: int
    dependents: tuple[int, ...]
    directions: tuple[str, ...] | None = None

    def __init__(
        self,
        name: str,
        main: int,
        dependents: int | Iterable[int],
        directions: str | Iterable[str] | None = None,
    ) -> None:
        """A link called `name` by which the nodes `dependents` follow the node `main` rigidly.

        They do so in the given `directions`, or in every active direction if None.

        Raises
        ------
        InputError
            If there are no dependent nodes, `main` is among them, or a direction is unknown.
        """
        nodes = (dependents,) if isinstance(dependents, int) else tuple(int(n) for n in dependents)
        if not nodes or main in nodes:
            raise InputError(f"rigid link {name!r} needs dependent nodes other than its main node {main}, got {nodes}")
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "main", int(main))
        object.__setattr__(self, "dependents", nodes)
        named = (directions,) if isinstance(directions, str) else directions
        chosen = None if named is None else tuple(d.upper() for d in named)
        if chosen is not None and not (chosen and set(chosen) <= set(DIRECTIONS)):
            raise InputError(f"`directions` of rigid link {name!r} must be among {' '.join(DIRECTIONS)}, got {chosen}")
        object.__setattr__(self, "directions", chosen)

    def equations(self, positions: Mapping[int, FloatArray], active: Sequence[str]) -> DofEquations:
        """Equations of the dependent nodes: {dependent code: {code of the main node: coefficient}}.

        A code is 6 times the label of a node plus 0 to 5 for X to RZ. `positions` in m; `active` are the directions in
        which nodes move, of which those of the link, if it names some, count.
        """
        result: DofEquations = {}
        for node in self.dependents:
            arm = np.zeros(3)
            difference = positions[node] - positions[self.main]
            arm[: len(difference)] = difference
            motion = np.eye(6)
            motion[:3, 3:] = [[0, arm[2], -arm[1]], [-arm[2], 0, arm[0]], [arm[1], -arm[0], 0]]
            for direction in (d for d in active if self.directions is None or d in self.directions):
                row = motion[DIRECTIONS.index(direction)]
                result[dof_code(node, direction)] = {
                    dof_code(self.main, d): float(row[DIRECTIONS.index(d)]) for d in active if row[DIRECTIONS.index(d)]
                }
        return result


@dataclass(frozen=True)
class Constraint:
    """One degree of freedom as a weighted sum of others (a multi-point constraint).

    Parameters
    ----------
    name : str
        Name of the constraint.
    dependent : Dof
        Degree of freedom that follows.
    depends_on : tuple of (Dof, float)
        Degrees of freedom that it follows, with their coefficients.
    """

    name: str
    dependent: Dof
    depends_on: tuple[tuple[Dof, float], ...]

    def __init__(self, name: str, dependent: str | Dof, depends_on: Iterable[tuple[str | Dof, float]]) -> None:
        """A constraint called `name`: `dependent` is a weighted sum of other degrees of freedom.

        `depends_on` are pairs of a degree of freedom and its coefficient; `InputError` unless all are finite.
        """
        pairs = tuple((parse_dof(d), float(c)) for d, c in depends_on)
        if not all(np.isfinite(c) for _, c in pairs):
            raise InputError(f"coefficients of constraint {name!r} must be finite, got {[c for _, c in pairs]}")
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "dependent", parse_dof(dependent))
        object.__setattr__(self, "depends_on", pairs)

    def equations(self, positions: Mapping[int, FloatArray], active: Sequence[str]) -> DofEquations:
        """Equation of the constraint with the signs of its dofs: {dependent code: {other code: coefficient}}.

        A code is 6 times the label of a node plus 0 to 5 for X to RZ. `positions` and `active` are not needed; repeated
        degrees of freedom are summed.
        """
        dependent = self.dependent
        others: dict[int, float] = {}
        for dof, coefficient in self.depends_on:
            code = dof_code(dof.node, dof.direction)
            others[code] = others.get(code, 0.0) + dependent.sign * dof.sign * coefficient
        return {dof_code(dependent.node, dependent.direction): others}


@dataclass(frozen=True)
class MiddleNode:
    """A node that moves as the mean of the two corners beside it, so that its side stays straight.

    Parameters
    ----------
    name : str
    label : int
    ends : (int, int)
    directions : tuple of str
        Directions in which its elements move.
    """

    name: str
    label: int
    ends: tuple[int, int]
    directions: tuple[str, ...] = ("X", "Y", "Z")

    def equations(self, positions: Mapping[int, FloatArray], active: Sequence[str]) -> DofEquations:
        """Own codes with those of the ends; see `Tie.equations`."""
        return {
            dof_code(self.label, d): {dof_code(end, d): 0.5 for end in self.ends}
            for d in self.directions
            if d in active
        }


@dataclass(frozen=True)
class Base:
    """Supports that drive the structure with one motion: a shaking table, the ground under a building.

    A record whose input is at one of them has the acceleration of that support in place of a force; all supports of the
    base then move alike, and all others stay at rest. For records without such an input, and for modes, they are held.
    What the ground holds without a node, such as a spring with one end, does not move.

    Parameters
    ----------
    name : str
        Name of the base.
    supports : tuple of Dof
        Held degrees of freedom, such as ``1X``; one that points the other way, ``2X-``, moves against the others.
    """

    name: str
    supports: tuple[Dof, ...]

    def __init__(self, name: str, supports: str | Dof | Iterable[str | Dof]) -> None:
        """A base called `name`: supported degrees of freedom that one measured motion drives.

        The structure fixes these `supports`; `InputError` if there are none.
        """
        named = (supports,) if isinstance(supports, str | Dof) else tuple(supports)
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "supports", tuple(parse_dof(dof) for dof in named))
        if not self.supports:
            raise InputError(f'base {name!r} has no support; name what moves, as in `supports = ["1X", "2X"]`')

    def moves(self, dof: Dof) -> bool:
        """True if `dof` is one of its supports."""
        return any(support.unsigned == dof.unsigned for support in self.supports)

    @property
    def ties(self) -> tuple[Constraint, ...]:
        """Constraints by which all supports follow the first."""
        first, *others = self.supports
        return tuple(Constraint(f"base {self.name}", other, [(first, 1.0)]) for other in others)


def tie_equations(ties: Sequence[Tie], positions: Mapping[int, FloatArray], active: Sequence[str]) -> DofEquations:
    """All equations of `ties`: {dependent code: {code that it follows: coefficient}}.

    A code is 6 times the label of a node plus 0 to 5 for X, Y, Z, RX, RY, RZ. `positions` of nodes in m; `active` are
    the directions in which nodes move.

    Raises
    ------
    InputError
        If two ties claim the same degree of freedom.
    """
    equations: DofEquations = {}
    for tie in ties:
        for code, others in tie.equations(positions, active).items():
            if code in equations:
                raise InputError(
                    f"{dof_of_code(code).unsigned} depends twice, the second time by {tie.name!r}; drop one"
                )
            equations[code] = others
    return equations


def tied_codes(equations: DofEquations) -> IntArray:
    """Codes (n,) of all degrees of freedom that take part in the equations of ties, dependent or not."""
    codes = {code for dependent, others in equations.items() for code in (dependent, *others)}
    return np.array(sorted(codes), dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Numbering:
    """The map u = T q from free degrees of freedom to all of them.

    Attributes
    ----------
    codes : (n_all,) int array
        Codes of all of them in order, see `dof_code`.
    matrix : (n_all, n_free) sparse array
        The map T.
    free : tuple of int
        Codes of the free ones.
    """

    codes: IntArray
    matrix: sparse.csr_array
    free: tuple[int, ...]

    @property
    def moving(self) -> IntArray:
        """Codes of all that are not held at zero."""
        return self.codes[np.diff(self.matrix.indptr) > 0]

    def directions(self, node: int) -> list[str]:
        """Directions in which elements or ties use a node, constrained or not."""
        first, last = np.searchsorted(self.codes, [6 * node, 6 * node + 6])
        return [dof_of_code(code).direction for code in self.codes[first:last].tolist()]


def numbering(
    codes: Sequence[int], constrained: frozenset[int], equations: DofEquations, following: Sequence[FollowingDofs] = ()
) -> Numbering:
    """Numbering of the free degrees of freedom, with the sparse map u = T q (n_all, n_free) from them to all.

    A code is 6 times the label of a node plus 0 to 5 for X, Y, Z, RX, RY, RZ.

    Parameters
    ----------
    codes : sequence of int
        All codes in increasing order, n_all of them.
    constrained : frozenset of int
        Codes held at zero.
    equations : mapping
        Dependent codes, each with the codes and weights that it follows; a dependent may follow another dependent.
    following : sequence of FollowingDofs
        Groups of dependent codes that follow common masters by a matrix; no master may depend on its group.

    Raises
    ------
    InputError
        If a degree of freedom is fixed and depends on others too, or constraints run in a circle.
    """
    for code in constrained & equations.keys():
        raise InputError(
            f"{dof_of_code(code)} is fixed and also depends on others; fix the degrees of freedom it follows"
        )
    _require_no_circle(equations)
    known = np.array(codes, dtype=np.int64)
    dependent = np.isin(known, [*equations, *(code for reduced in following for code in reduced.dependents.tolist())])
    free = np.flatnonzero(~dependent & ~np.isin(known, list(constrained)))
    follow = _dependence_matrix(known, equations, following)
    part = sparse.csr_array((np.ones(len(free)), (free, np.arange(len(free)))), (len(known), len(free)))
    matrix = part
    while part.nnz:
        part = follow @ part
        matrix = matrix + part
    return Numbering(known, sparse.csr_array(matrix), tuple(known[free].tolist()))


def _dependence_matrix(
    codes: IntArray, equations: DofEquations, following: Sequence[FollowingDofs]
) -> sparse.csr_array:
    """Sparse matrix D (n_all, n_all) of direct dependences, u = D u in rows of dependent codes; others are empty.

    Rows and columns are `codes` (sorted), 6 times the label of a node plus 0 to 5 for X to RZ; entries are the weights
    of `equations` and of the groups `following`.
    """
    entries = [(code, other, value) for code, others in equations.items() for other, value in others.items()]
    tables = [np.array([entry[:2] for entry in entries], dtype=np.int64).reshape(-1, 2)]
    values: list[FloatArray] = [np.array([entry[2] for entry in entries], dtype=np.float64)]
    for group in following:
        tables.append(
            np.stack([a.ravel() for a in np.meshgrid(group.dependents, group.masters, indexing="ij")], axis=1)
        )
        values.append(group.matrix.ravel())
    rows, columns = np.searchsorted(codes, np.concatenate(tables)).T
    return sparse.coo_array((np.concatenate(values), (rows, columns)), (len(codes), len(codes))).tocsr()


def _require_no_circle(equations: DofEquations) -> None:
    """Raise `InputError` if a degree of freedom depends on itself through `equations`; the message shows the circle.

    `equations` maps dependent codes (6 times the label of a node plus 0 to 5 for X to RZ) to the codes and weights that
    they follow.
    """
    done: set[int] = set()
    for start in equations:
        path = [start]
        ways = [iter(equations[start])]
        while path:
            code = next(ways[-1], None)
            if code is None:
                done.add(path.pop())
                ways.pop()
            elif code in path:
                loop = " -> ".join(str(dof_of_code(c)) for c in (*path[path.index(code) :], code))
                raise InputError(f"constraints run in a circle: {loop}; remove one of them")
            elif code in equations and code not in done:
                path.append(code)
                ways.append(iter(equations[code]))


def selection(all_dofs: Numbering, nodes: Mapping[int, FloatArray], dofs: Iterable[Dof]) -> sparse.csc_array:
    """Sparse columns that read (or load) `dofs` on free degrees of freedom, signs included, (n_free, n_chosen).

    A dependent degree of freedom reads those that it follows. `all_dofs` is the numbering and `nodes` are all nodes by
    label. Raises `InputError` if a degree of freedom is at no node, not part of the structure, or held at zero.
    """
    chosen = tuple(dofs)
    codes, is_constrained = all_dofs.codes, np.diff(all_dofs.matrix.indptr) == 0
    rows = []
    for dof in chosen:
        if dof.node not in nodes:
            nearest = difflib.get_close_matches(str(dof.node), [str(n) for n in nodes], 1, 0.0)
            raise InputError(f"{dof} is at node {dof.node}, which the structure does not have (nearest: {nearest[0]})")
        code = dof_code(dof.node, dof.direction)
        row = int(np.searchsorted(codes, code))
        if row == len(codes) or codes[row] != code:
            free_here = [f"{dof.node}{direction}+" for direction in all_dofs.directions(dof.node)]
            raise InputError(
                f"{dof} is not part of the structure; node {dof.node} moves in {', '.join(free_here) or 'nothing'}"
            )
        if is_constrained[row]:
            raise InputError(
                f"{dof} is held at zero by the supports; move the sensor or load, free it, or, where its motion was"
                " measured and drives the structure, make it a support of a base ([[structure.base]])"
            )
        rows.append(row)
    if not rows:
        return sparse.csc_array((len(all_dofs.free), 0))
    signs = sparse.diags_array(np.array([float(dof.sign) for dof in chosen]))
    return sparse.csc_array((signs @ all_dofs.matrix[np.array(rows), :]).T)


def free_blocks(all_dofs: Numbering, matrix_term: ElementMatrixTerm) -> ElementMatrices:
    """Element matrices on the free degrees of freedom: T' B T with the map T of the numbering `all_dofs`.

    B are those of `matrix_term`, on all degrees of freedom. A term with a matrix on all of its codes (`whole`) becomes
    a single dense or sparse matrix, any other one block for each element.
    """
    position = _positions_in(all_dofs, matrix_term)
    if matrix_term.whole is not None:
        rows = all_dofs.matrix[position[0], :]
        columns = np.unique(rows.indices).astype(np.int64)
        if rows.nnz > max(_FULL * rows.shape[0] * len(columns), rows.shape[0]):
            dense = rows[:, columns].toarray()
            return Blocks(columns[None], (dense.T @ (matrix_term.whole @ dense))[None], len(all_dofs.free))
        return MatrixBlocks([rows.T @ matrix_term.whole @ rows])
    return _tied_blocks(position, matrix_term.local, all_dofs.matrix, len(all_dofs.free))


def blocks_of_all(all_dofs: Numbering, matrix_term: ElementMatrixTerm) -> Blocks:
    """The element matrices of a matrix term on all degrees of freedom, also those of supports and dependents."""
    return Blocks(_positions_in(all_dofs, matrix_term), matrix_term.local, len(all_dofs.codes))


def _positions_in(all_dofs: Numbering, matrix_term: ElementMatrixTerm) -> IntArray:
    """Index among all degrees of freedom of each code of a matrix term, in the shape of `codes`; -1 if absent."""
    index = np.minimum(np.searchsorted(all_dofs.codes, matrix_term.codes), len(all_dofs.codes) - 1)
    return np.where(all_dofs.codes[index] == matrix_term.codes, index, -1)


def _tied_blocks(position: IntArray, local: FloatArray, matrix: sparse.csr_array, n_free: int) -> Blocks:
    """Blocks on free degrees of freedom, from element matrices on all of them.

    `local` (n_elements, n, n) are the matrices and `position` (n_elements, n) their rows in `matrix` (n_all, n_free),
    -1 for none; `matrix` maps free degrees of freedom to all. Where no element is tied, blocks keep their size;
    otherwise all become T_e' B_e T_e on the free degrees of freedom that each element moves with, padded with -1 to a
    common size.
    """
    counts = np.append(np.diff(matrix.indptr), 0)
    first = np.append(matrix.indices[np.minimum(matrix.indptr[:-1], max(matrix.nnz - 1, 0))] if matrix.nnz else [], 0)
    value = np.append(matrix.data[np.minimum(matrix.indptr[:-1], max(matrix.nnz - 1, 0))] if matrix.nnz else [], 0.0)
    simple = (counts == 0) | ((counts == 1) & (np.resize(value, counts.shape) == 1.0))
    if simple[position].all():
        dofs = np.where(counts[position] == 1, np.resize(first, counts.shape)[position], -1).astype(np.int64)
        return Blocks(dofs, local, n_free)
    n_elements, n_local = position.shape
    n_masters = counts[position].ravel()
    line = np.repeat(np.arange(position.size), n_masters)
    entry = np.arange(len(line)) + np.repeat(
        np.append(matrix.indptr[:-1], 0)[position].ravel() - np.cumsum(n_masters) + n_masters, n_masters
    )
    element = line // n_local
    pairs, column = np.unique(element * n_free + matrix.indices[entry], return_inverse=True)
    owner = pairs // n_free
    begin, size = np.searchsorted(owner, np.arange(n_elements)), int(np.bincount(owner, minlength=1).max())
    ties = np.zeros((n_elements, n_local, size))
    np.add.at(ties, (element, line % n_local, column - begin[element]), matrix.data[entry])
    dofs = -np.ones((n_elements, size), dtype=np.int64)
    dofs[owner, np.arange(len(pairs)) - begin[owner]] = pairs % n_free
    return Blocks(dofs, np.swapaxes(ties, 1, 2) @ local @ ties, n_free)
