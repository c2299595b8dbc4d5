"""A structure with smaller elements: lines cut into pieces, cells split along all of their edges."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.dof import DIRECTIONS, Dof
from structid.fem import Structure
from structid.fem.elements import ElementSet
from structid.fem.elements.element import declarations
from structid.fem.measuring_points import MeshPoint
from structid.fem.structure import MOST_PIECES

#: Nodes of a child by the corners of its parent that each lies in the middle of.
ChildCorners = tuple[tuple[int, ...], ...]


def _boxes(corners: Sequence[tuple[int, ...]]) -> tuple[ChildCorners, ...]:
    """Elements into which a line, quadrilateral or hexahedron is halved along each edge, one at each of its corners.

    `corners` are parametric coordinates, 0 or 1. A child is a tuple of its nodes; each node is the tuple of parent
    corners (indices in `corners`) in whose middle it lies.
    """

    def middle_of(at: tuple[int, ...], to: tuple[int, ...]) -> tuple[int, ...]:
        stays = [a == b for a, b in zip(at, to, strict=True)]
        return tuple(
            i
            for i, corner in enumerate(corners)
            if all(own == a for own, a, stay in zip(corner, at, stays, strict=True) if stay)
        )

    return tuple(tuple(middle_of(at, to) for to in corners) for at in corners)


def _at_corners(n: int) -> tuple[ChildCorners, ...]:
    """One child at each of the `n` corners of a triangle or tetrahedron, its nodes in the order of the parent's corners.

    A node is the tuple of one or two parent corners in whose middle it lies.
    """
    return tuple(tuple((at,) if at == to else (min(at, to), max(at, to)) for to in range(n)) for at in range(n))


_RING = [(0, 0), (1, 0), (1, 1), (0, 1)]
#: How each kind of cell is split; a tetrahedron's inner octahedron about its diagonal from the middle of 0-2 to that of 1-3.
_CHILDREN: dict[str, tuple[ChildCorners, ...]] = {
    "line": _boxes([(0,), (1,)]),
    "triangle": (*_at_corners(3), ((0, 1), (1, 2), (0, 2))),
    "quad": _boxes(_RING),
    "tetra": (
        *_at_corners(4),
        *(((0, 2), (1, 3), a, b) for a, b in (((0, 1), (1, 2)), ((1, 2), (2, 3)), ((2, 3), (0, 3)), ((0, 3), (0, 1)))),
    ),
    "hexahedron": _boxes([(*at, z) for z, at in product((0, 1), _RING)]),
}
_DIMENSION = {"triangle": 2, "quad": 2, "tetra": 3, "hexahedron": 3}
#: Corners of each side, by which rims are known.
_SIDES: dict[str, tuple[tuple[int, ...], ...]] = {
    "triangle": ((0, 1), (1, 2), (0, 2)),
    "quad": ((0, 1), (1, 2), (2, 3), (0, 3)),
    "tetra": ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)),
    "hexahedron": ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 4, 5), (1, 2, 5, 6), (2, 3, 6, 7), (0, 3, 4, 7)),
}


@dataclass(frozen=True, eq=False)
class RefinedStructure:
    """A structure with smaller elements.

    Attributes
    ----------
    structure : Structure
    values : (n_values,) float array
        Property values of this structure.
    inside : mapping of int to int
        Labels in this structure of the nodes that were inside elements of the original one, by their labels there; other
        nodes keep their labels.
    """

    structure: Structure
    values: FloatArray
    inside: Mapping[int, int]

    def places(self, structure: Structure) -> IntArray:
        """Positions of the degrees of freedom of `structure`, the original one, among those of the refined one, (n_dofs,)."""
        place = {code: i for i, code in enumerate(self.structure.numbering.free)}
        own = (divmod(code, 6) for code in structure.numbering.free)
        return np.array([place[6 * self.inside.get(node, node) + axis] for node, axis in own])


def split_power(structure: Structure) -> int:
    """Power of the pieces of an edge in the number of elements: 1 for lines, 2 for plane cells, 3 for solid ones."""
    return max((_DIMENSION[kind] for made in structure.elements for kind in _kinds(made)), default=1)


def n_split(structure: Structure) -> int:
    """Number of elements that refinement makes smaller: cells, or pieces of lines where there are no cells."""
    cells = [made for made in structure.elements if made.cells]
    return sum(len(made.nodes) for made in cells or structure.divisible) * structure.subdivide


def obstacle(structure: Structure) -> str | None:
    """Sentence on why a structure cannot be refined; "" if it has no mesh or no matrices, None if it can be refined."""
    if not structure.has_matrices:
        return ""
    if structure.measured:
        return f"the mesh was not judged: the model has no modes without {structure.measured[0].words}"
    whole = {
        p.element for p in structure.properties for matrix_term in p.term.matrix_terms if matrix_term.whole is not None
    }
    if whole:
        return f"the mesh was not judged: the matrices of {_listed(sorted(whole))} come from elsewhere, or are reduced"
    cells = [made for made in structure.elements if made.cells]
    if not cells and not structure.divisible:
        return ""
    if not cells:
        return None
    odd = [made.name for made in cells if any(kind not in _CHILDREN for kind in _kinds(made))]
    if odd:
        return f"the mesh was not judged: cells of the kinds of {_listed(odd)} are not split"
    if structure.subdivide > 1 or structure.sliding or any(made.loosened is not None for made in structure.elements):
        return "the mesh was not judged: cells beside lines with joints, `sliding` or `subdivide` are not split"
    if any(not isinstance(tie, MeshPoint) for tie in structure.ties):
        return "the mesh was not judged: cells with rigid links or constraints are not split"
    return None


def refined(structure: Structure, values: FloatArray, times: int, most_dofs: int) -> RefinedStructure | None:
    """The structure with elements 1/`times` as long; None if it is then too large.

    A new node is supported if it lies between nodes of a free side that are all supported in that direction.

    Parameters
    ----------
    structure : Structure
        Structure for which `obstacle` returns None.
    values : (n_values,) float array
        Property values.
    times : int
        Number of pieces along each edge; a power of 2 for areas and solids.
    most_dofs : int
        Most degrees of freedom of the result. Of lines alone it is too large also with more than 100 pieces for an
        element.
    """
    if not any(made.cells for made in structure.elements):
        more = (times - 1) * n_split(structure) * len(structure.active or DIRECTIONS)
        if structure.n_dofs + more > most_dofs or structure.subdivide * times > MOST_PIECES:
            return None
        return RefinedStructure(
            replace(structure, subdivide=structure.subdivide * times), values, _inner_labels(structure, times)
        )
    if structure.n_dofs * times ** split_power(structure) > most_dofs:
        return None
    finer = RefinedStructure(structure, values, {})
    for _ in range(times.bit_length() - 1):
        finer = _halve_cells(finer)
    return finer


def _inner_labels(structure: Structure, times: int) -> dict[int, int]:
    """New labels by present ones, for nodes inside subdivided elements and at released ends.

    Each present piece is cut into `times` pieces; labels follow the largest of the structure's nodes.
    """
    first = max(structure.nodes) + 1
    pieces, n_lines = structure.subdivide, sum(len(made.nodes) for made in structure.divisible)
    new_labels = {
        first + line * (pieces - 1) + piece - 1: first + line * (pieces * times - 1) + piece * times - 1
        for line in range(n_lines)
        for piece in range(1, pieces)
    }
    before, after = first + n_lines * (pieces - 1), first + n_lines * (pieces * times - 1)
    loosened = sum(made.loosened is not None for made in structure.elements)
    return new_labels | {before + joint: after + joint for joint in range(loosened)}


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (" and others" if len(names) > 3 else "")


def _kinds(elements: ElementSet) -> list[str]:
    return (
        [elements.cells[count] for count in np.unique((elements.nodes >= 0).sum(axis=1)).tolist()]
        if elements.cells
        else []
    )


def _kind_of(elements: ElementSet, row: IntArray) -> str:
    return elements.cells[int((row >= 0).sum())] if elements.cells else "line"


class _Middles:
    """Labels of the nodes amid others, each made when it is first asked for."""

    def __init__(self, structure: Structure) -> None:
        """An empty table of midway nodes; new labels follow the largest label of the nodes and mesh points of `structure`."""
        self.positions = dict(structure.nodes)
        self.labels: dict[frozenset[int], int] = {}
        ties = [tie.label for tie in structure.ties if isinstance(tie, MeshPoint)]
        self.next = max([*self.positions, *ties]) + 1

    def label(self, corners: frozenset[int]) -> int:
        """Label of the node midway between the nodes `corners`, made at their mean position at the first call.

        A single corner is its own node.
        """
        if len(corners) == 1:
            return next(iter(corners))
        if corners not in self.labels:
            self.labels[corners] = self.next
            self.positions[self.next] = np.mean([self.positions[node] for node in sorted(corners)], axis=0)
            self.next += 1
        return self.labels[corners]


def _halve_cells(refined: RefinedStructure) -> RefinedStructure:
    """The structure with all areas and solids halved along each edge, and lines where their halves stay stable.

    Lines are halved if they may be subdivided, or lie along an edge of an area or solid. Children get the property
    values of their parent; new nodes on supported free sides are supported. `refined` is the structure before, with its
    property values.
    """
    structure = refined.structure
    middles, edges = _Middles(structure), _edges(structure)
    divisible = {made.name for made in structure.divisible}
    elements: list[ElementSet] = []
    parents: dict[str, IntArray] = {}
    for made in structure.elements:
        if not (made.cells or made.is_line):
            elements.append(made)
            continue
        rows, parent = [], []
        for e, row in enumerate(made.nodes):
            is_whole = made.is_line and made.name not in divisible and frozenset(row.tolist()) not in edges
            for child in [((0,), (1,))] if is_whole else _CHILDREN[_kind_of(made, row)]:
                nodes = [middles.label(frozenset(int(row[i]) for i in corners)) for corners in child]
                rows.append(nodes + [-1] * (made.nodes.shape[1] - len(nodes)))
                parent.append(e)
        parent_of = np.array(parent)
        each = {
            name: getattr(made, name)[parent_of]
            for name, what in declarations(made).items()
            if what.kind is not None and getattr(made, name) is not None
        }
        elements.append(replace(made, nodes=np.array(rows), **each))
        parents[made.name] = parent_of
    held = (*structure.fixed, *_supports_of_middles(structure, middles))
    finer = replace(structure, nodes=middles.positions, elements=tuple(elements), fixed=held)
    old = {(p.element, p.term.property): refined.values[p.values] for p in structure.properties}
    parts = []
    for p in finer.properties:
        values, of_element = old[p.element, p.term.property], parents.get(p.element)
        by_element = of_element is not None and len(p.term.values) == len(of_element)
        parts.append(values[of_element] if by_element else values)
    return RefinedStructure(finer, np.concatenate(parts), {})


def _edges(structure: Structure) -> set[frozenset[int]]:
    """Pairs of node labels between which a new node of an area or solid lies after a split."""
    return {
        frozenset(int(row[i]) for i in corners)
        for made in structure.elements
        if made.cells
        for row in made.nodes
        for child in _CHILDREN[_kind_of(made, row)]
        for corners in child
        if len(corners) == 2
    }


def _supports_of_middles(structure: Structure, middles: _Middles) -> list[Dof]:
    """Supports of the new nodes in `middles` on free sides, in directions in which all parent nodes are supported.

    A side is free if it belongs to a single area or solid of `structure`.
    """
    sides: dict[frozenset[int], int] = {}
    for made in structure.elements:
        if made.cells:
            for row in made.nodes:
                for side in _SIDES[_kind_of(made, row)]:
                    corners = frozenset(int(row[i]) for i in side)
                    sides[corners] = sides.get(corners, 0) + 1
    at_rim: dict[int, list[frozenset[int]]] = {}
    for rim, count in sides.items():
        if count == 1:
            for node in rim:
                at_rim.setdefault(node, []).append(rim)
    fixed: dict[int, set[str]] = {}
    for dof in structure.fixed:
        fixed.setdefault(dof.node, set()).add(dof.direction)
    supports = []
    for corners, label in middles.labels.items():
        shared = set.intersection(*(fixed.get(node, set()) for node in corners))
        if shared and any(corners <= rim for rim in at_rim.get(min(corners), ())):
            supports += [Dof(label, direction) for direction in sorted(shared)]
    return supports
