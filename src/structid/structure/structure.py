"""A structure: nodes, element sets, supports and ties, and from them element matrices on free degrees of freedom."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from structid.arrays import FloatArray, IntArray, locked, require_finite
from structid.dof import DIRECTIONS, Dof, parse_dof
from structid.errors import InputError
from structid.structure.blocks import Blocks, ElementMatrices, MatrixBlocks
from structid.structure.contribution import Contribution, Property, ThicknessFactor
from structid.structure.elements import ElementSet, MatrixGroup, PointMass, RotaryInertia, Term
from structid.structure.elements.element import dof_code, dof_of_code, layers_of, node_codes
from structid.structure.supports import Tie, tie_equations, transformation

_ACTIVE = {1: ("X", "Y", "RZ"), 2: ("X", "Y", "RZ"), 3: DIRECTIONS}


_LAWS = {"mass": "inertia", "rotary_inertia": "inertia", "viscous_damping": "viscous", "stiffness": "elastic"}


@dataclass(frozen=True, eq=False)
class Structure:
    """Nodes, element sets, supports and ties.

    Parameters
    ----------
    nodes : mapping of int to position
        Position of each node in m: one, two or three coordinates, the same number for all.
    elements : sequence of ElementSet
        Element sets, each with a name of its own.
    fixed : sequence of degrees of freedom
        Degrees of freedom held at zero.
    ties : sequence of RigidLink or Constraint
        What makes degrees of freedom depend on others.
    active : sequence of directions, optional
        Directions that the structure can move in; the others are held. All of the dimension by default: X Y RZ
        for nodes with one or two coordinates, and Z where such a structure holds a `Membrane`.

    Raises
    ------
    InputError
        If an element names a node that does not exist, names repeat, or supports contradict ties.
    """

    nodes: Mapping[int, FloatArray]
    elements: tuple[ElementSet, ...]
    fixed: tuple[Dof, ...] = ()
    ties: tuple[Tie, ...] = ()
    active: tuple[str, ...] | None = None

    def __init__(
        self,
        nodes: Mapping[int, ArrayLike],
        elements: Iterable[ElementSet],
        fixed: Iterable[str | Dof] = (),
        ties: Iterable[Tie] = (),
        active: Sequence[str] | None = None,
    ) -> None:
        positions = {int(label): locked(np.atleast_1d(np.asarray(x, dtype=np.float64))) for label, x in nodes.items()}
        object.__setattr__(self, "nodes", positions)
        object.__setattr__(self, "elements", tuple(elements))
        object.__setattr__(self, "fixed", tuple(parse_dof(d) for d in fixed))
        object.__setattr__(self, "ties", tuple(ties))
        self._check_nodes()
        directions = self._default_active() if active is None else tuple(d.upper() for d in active)
        if not directions or not set(directions) <= set(DIRECTIONS):
            raise InputError(f"`active` must list some of {' '.join(DIRECTIONS)}, got {active}")
        object.__setattr__(self, "active", directions)
        self._check_names()
        _ = self.contributions  # so that what is wrong shows here, not at first use

    @property
    def dimension(self) -> int:
        """Number of coordinates of a node."""
        return len(next(iter(self.nodes.values())))

    @cached_property
    def properties(self) -> tuple[Property, ...]:
        """Every property of every element set, in order."""
        present = self._codes_of(e for e in self.elements if not isinstance(e, PointMass | RotaryInertia))
        found, start = [], 0
        for element in self.elements:
            for term in element.terms(self.nodes, present):
                found.append(Property(element.name, term, slice(start, start + len(term.values))))
                start += len(term.values)
        return tuple(found)

    @cached_property
    def values(self) -> FloatArray:
        """Nominal values of all properties, one after another, (n_values,)."""
        parts = [p.term.values for p in self.properties]
        return locked(np.concatenate(parts) if parts else np.zeros(0))

    @property
    def dofs(self) -> tuple[Dof, ...]:
        """Free degrees of freedom in the order of the matrices."""
        return tuple(dof_of_code(code) for code in self._free_codes)

    @property
    def n_dofs(self) -> int:
        return len(self._free_codes)

    @cached_property
    def contributions(self) -> tuple[Contribution, ...]:
        """Element matrices on free degrees of freedom with the values that weigh them."""
        found: list[Contribution] = []
        elastic: dict[str, list[Contribution]] = {}
        blocks: dict[tuple[int, int], ElementMatrices] = {}  # terms with the same matrices share them
        for item in self.properties:
            if item.term.codes is not None:
                law = f"friction:{item.element}" if item.term.kind == "friction" else _LAWS[item.term.kind]
                for layer in layers_of(item.term):
                    key = (id(layer.codes), id(layer.local if layer.matrices is None else layer.matrices))
                    if key not in blocks:
                        blocks[key] = self._free_blocks(layer)
                    thickness = self._thickness(item.element, layer.thickness_power)
                    found.append(Contribution(law, blocks[key], item.values, thickness=thickness))
                    if law == "elastic":
                        elastic.setdefault(item.element, []).append(found[-1])
            elif item.term.kind == "loss_factor":
                found += [replace(part, law="structural", factor=item.values) for part in elastic.get(item.element, [])]
        return tuple(found)

    def matrix(self, law: str, values: FloatArray | None = None) -> sparse.csc_array:
        """Sum of the element matrices that enter by `law`, (n_dofs, n_dofs).

        Parameters
        ----------
        law : {"inertia", "viscous", "elastic", "structural"}
            Mass matrix, viscous damping, stiffness, and imaginary part of the complex stiffness.
        values : (n_values,) float array, optional
            Property values; the nominal ones by default.
        """
        given = self.values if values is None else values
        total = sparse.csc_array((self.n_dofs, self.n_dofs))
        for part in self.contributions:
            if part.law == law:
                total = total + part.blocks.assemble(part.weights(given))
        return total

    def selection(self, dofs: Iterable[Dof]) -> sparse.csc_array:
        """Columns that read (or load) `dofs` through the ties, signs included, (n_dofs, number of `dofs`).

        Raises
        ------
        InputError
            If a degree of freedom is not part of the structure or is held at zero.
        """
        order = {code: i for i, code in enumerate(self._codes)}
        matrix = sparse.csr_array(self._transformation)
        rows: list[int] = []
        chosen = tuple(dofs)
        held = np.diff(matrix.indptr) == 0
        for dof in chosen:
            code = dof_code(dof.node, dof.direction)
            if dof.node not in self.nodes:
                near = difflib.get_close_matches(str(dof.node), [str(n) for n in self.nodes], 1, 0.0)
                raise InputError(f"{dof} is at node {dof.node}, which the structure does not have (nearest: {near[0]})")
            if code not in order:
                here = [str(dof_of_code(c).unsigned) for c in self._codes if c // 6 == dof.node]
                raise InputError(
                    f"{dof} is not part of the structure; node {dof.node} moves in {', '.join(here) or 'nothing'}"
                )
            if held[order[code]]:
                raise InputError(f"{dof} is held at zero by the supports; move the sensor or load, or free it")
            rows.append(order[code])
        if not rows:
            return sparse.csc_array((self.n_dofs, 0))
        signs = sparse.diags_array(np.array([float(dof.sign) for dof in chosen]))
        return sparse.csc_array((signs @ matrix[np.array(rows), :]).T)

    def mass_of(self, values: FloatArray | None = None, direction: str | None = None) -> float:
        """Mass that takes part in rigid motion along `direction`, kg: r' M r on all degrees of freedom.

        Parameters
        ----------
        values : (n_values,) float array, optional
            Property values; the nominal ones by default.
        direction : {"X", "Y", "Z"}, optional
            By default the first translation in which the structure has any mass.
        """
        return self._mass(self.values if values is None else values, direction)[0]

    def mass_gradient(self, direction: str | None = None, values: FloatArray | None = None) -> FloatArray:
        """Derivative of `mass_of` with respect to every value, (n_values,). Factors of matrix groups are included."""
        return self._mass(self.values if values is None else values, direction)[1]

    def _mass(self, values: FloatArray, direction: str | None) -> tuple[float, FloatArray]:
        """`mass_of` and its gradient."""
        total, gradient = 0.0, np.zeros(len(self.values))
        for candidate in (direction,) if direction else DIRECTIONS[:3]:
            axis = DIRECTIONS.index(candidate)
            for item in self.properties:
                for layer in layers_of(item.term) if item.term.kind == "mass" and item.term.codes is not None else ():
                    unit, thickness = _rigid_mass(layer, axis), self._thickness(item.element, layer.thickness_power)
                    factor = 1.0 if thickness is None else thickness.of(values)
                    gradient[item.values] += unit * factor
                    total += float(unit * factor @ values[item.values])
                    if thickness is not None:
                        gradient[thickness.value] += unit * values[item.values] * thickness.slope(values)
            if gradient.any():
                break
        return total, gradient

    def _thickness(self, element: str, power: int) -> ThicknessFactor | None:
        """How the thickness of `element` enters matrices that go with its `power`."""
        if power == 0:
            return None
        found = next(p for p in self.properties if p.element == element and p.term.kind == "thickness")
        return ThicknessFactor(found.values, found.term.values, power)

    def _default_active(self) -> tuple[str, ...]:
        across = {d for element in self.elements for d in getattr(element, "transverse", ())}
        return tuple(d for d in DIRECTIONS if d in across or d in _ACTIVE[self.dimension])

    def _check_nodes(self) -> None:
        if not self.nodes:
            raise InputError("`nodes` must hold at least one node, got none")
        sizes = {len(x) for x in self.nodes.values()}
        if len(sizes) > 1 or not sizes <= {1, 2, 3}:
            raise InputError(f"`nodes` must all have 1, 2 or 3 coordinates, got {sorted(sizes)}")
        for label, x in self.nodes.items():
            if label < 0:
                raise InputError(f"node labels must not be negative, got {label}")
            require_finite(f"position of node {label}", x)

    def _check_names(self) -> None:
        names = [e.name for e in self.elements]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two element sets are called {name!r}; give each a name of its own")
        for element in self.elements:
            for node in np.unique(element.nodes):
                if node >= 0 and int(node) not in self.nodes:
                    raise InputError(f"{element.name!r} uses node {node}, which the structure does not have")
        for dof in self.fixed:
            if dof.node not in self.nodes:
                raise InputError(f"`fixed` names {dof} at node {dof.node}, which the structure does not have")

    def _codes_of(self, elements: Iterable[ElementSet]) -> frozenset[int]:
        """Codes that `elements` and the ties use."""
        codes: set[int] = set()
        for element in elements:
            own = getattr(element, "directions", None) or getattr(element, "transverse", None)
            if own:  # cells of a mesh, whose matrices are dear
                nodes = np.unique(element.nodes)
                codes.update(node_codes(nodes[nodes >= 0][:, None], own).ravel().tolist())
                continue
            for term in element.terms(self.nodes, frozenset()):
                for layer in layers_of(term):
                    if layer.codes is not None:
                        codes.update(int(c) for c in np.unique(layer.codes) if c >= 0)
        for code, others in self._equations.items():
            codes.update((code, *others))
        return frozenset(codes)

    @cached_property
    def _equations(self) -> dict[int, dict[int, float]]:
        assert self.active is not None
        return tie_equations(self.ties, self.nodes, self.active)

    @cached_property
    def _codes(self) -> list[int]:
        """All codes that elements and ties use, in order."""
        used = [layer.codes for p in self.properties for layer in layers_of(p.term) if layer.codes is not None]
        codes = {c for table in used for c in np.unique(table).tolist()}
        for code, others in self._equations.items():
            codes.update((code, *others))
        return sorted(c for c in codes if c >= 0)

    @cached_property
    def _resolved(self) -> tuple[sparse.csr_array, list[int]]:
        assert self.active is not None
        held = {c for c in self._codes if DIRECTIONS[c % 6] not in self.active}
        held.update(dof_code(d.node, d.direction) for d in self.fixed)
        return transformation(self._codes, frozenset(held) & frozenset(self._codes), self._equations)

    @property
    def _transformation(self) -> sparse.csr_array:
        return self._resolved[0]

    @property
    def _free_codes(self) -> list[int]:
        return self._resolved[1]

    def _free_blocks(self, term: Term) -> ElementMatrices:
        """The term's matrices on free degrees of freedom."""
        assert term.codes is not None
        known = np.array(self._codes, dtype=np.int64)
        place = np.minimum(np.searchsorted(known, term.codes), len(known) - 1)
        if term.matrices is not None:
            rows = self._transformation[place[0], :]
            return MatrixBlocks([rows.T @ matrix @ rows for matrix in term.matrices])
        assert term.local is not None
        position = np.where(known[place] == term.codes, place, -1)
        return _tied_blocks(position, term.local, self._transformation, self.n_dofs)


def _tied_blocks(position: IntArray, local: FloatArray, matrix: sparse.csr_array, n_free: int) -> Blocks:
    """Blocks on free degrees of freedom: those of tied elements become T_e' B_e T_e, the others keep their size."""
    counts = np.append(np.diff(matrix.indptr), 0)
    first = np.append(matrix.indices[np.minimum(matrix.indptr[:-1], max(matrix.nnz - 1, 0))] if matrix.nnz else [], 0)
    value = np.append(matrix.data[np.minimum(matrix.indptr[:-1], max(matrix.nnz - 1, 0))] if matrix.nnz else [], 0.0)
    simple = (counts == 0) | ((counts == 1) & (np.resize(value, counts.shape) == 1.0))
    if simple[position].all():
        dofs = np.where(counts[position] == 1, np.resize(first, counts.shape)[position], -1).astype(np.int64)
        return Blocks(dofs, local, n_free)
    tied = [
        _tied_element(row[row >= 0], block[np.ix_(row >= 0, row >= 0)], matrix)
        for row, block in zip(position, local, strict=True)
    ]
    size = max(len(free) for free, _ in tied)
    dofs = -np.ones((len(tied), size), dtype=np.int64)
    blocks = np.zeros((len(tied), size, size))
    for e, (free, block) in enumerate(tied):
        dofs[e, : len(free)] = free
        blocks[e, : len(free), : len(free)] = block
    return Blocks(dofs, blocks, n_free)


def _tied_element(row: IntArray, block: FloatArray, matrix: sparse.csr_array) -> tuple[IntArray, FloatArray]:
    """Free degrees of freedom of one element and its matrix on them."""
    part = matrix[row, :]
    free = np.unique(part.indices).astype(np.int64)
    dense = part[:, free].toarray() if len(free) else np.zeros((len(row), 0))
    return free, dense.T @ block @ dense


def _rigid_mass(term: Term, axis: int) -> FloatArray:
    """r' B_e r for rigid motion along `axis`, (n_elements,)."""
    assert term.codes is not None
    motion = ((term.codes >= 0) & (term.codes % 6 == axis)).astype(np.float64)
    if term.matrices is not None:
        return np.array([motion[0] @ (matrix @ motion[0]) for matrix in term.matrices])
    assert term.local is not None
    return np.einsum("ei,eij,ej->e", motion, term.local, motion)


def from_matrices(
    groups: Mapping[str, Mapping[str, Any]],
    dofs: Sequence[str | Dof],
    nodes: Mapping[int, ArrayLike] | None = None,
    fixed: Iterable[str | Dof] = (),
) -> Structure:
    """A structure from a user's own groups of matrices, each scaled by a factor of nominal value 1.

    Parameters
    ----------
    groups : mapping of name to {"mass": M, "stiffness": K, "damping": C, "loss_factor": eta}
        Symmetric sparse or dense matrices (n_dofs, n_dofs), any of them left out where the group has none.
    dofs : sequence of degrees of freedom
        What the rows stand for, the same for all groups.
    nodes : mapping of label to position, optional
        For pictures; all at the origin by default.
    fixed : sequence of degrees of freedom
        Degrees of freedom held at zero.

    Examples
    --------
    >>> import numpy as np
    >>> chain = from_matrices({"all": {"mass": np.eye(2), "stiffness": [[2, -1], [-1, 2]]}}, ["1X", "2X"])
    >>> chain.n_dofs
    2
    """
    elements = [MatrixGroup(name, dofs, **matrices) for name, matrices in groups.items()]
    labels = {parse_dof(d).node for d in dofs}
    positions = dict.fromkeys(sorted(labels), (0.0, 0.0, 0.0)) if nodes is None else nodes
    return Structure(positions, elements, fixed)
