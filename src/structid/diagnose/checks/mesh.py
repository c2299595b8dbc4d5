"""Error of a model's frequencies by the size of its elements, from a comparison with a refined mesh.

The refined structure has smaller elements: lines cut into pieces, cells split along all of their edges.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.dof import DIRECTIONS, Dof
from structid.dynamics import Modes
from structid.fem import Structure
from structid.fem.elements import ElementSet
from structid.fem.elements.element import declarations
from structid.fem.measuring_points import MeshPoint
from structid.fem.structure import MOST_PIECES
from structid.forward import RecordProblem
from structid.forward.modal import compares_modes
from structid.identification.mesh_pieces import MESH_ERROR
from structid.identification.record_fit import LEAST_DAMPING, structure_modes
from structid.identification.setups.setup import AnySetup
from structid.similarity import assign_pairs

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
    """Labels and positions (m) of the nodes midway between nodes, each made when it is first asked for."""

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


#: Degrees of freedom of the finest model that is solved, and modes that are looked at.
_MOST_DOFS, _MOST_MODES = 20_000, 40
#: Degrees of freedom up to which all modes come at once.
_ALL = 600
#: Damping ratio where there is none.
_USUAL_DAMPING = 0.01
#: Pieces from which on smaller elements are no remedy.
_MOST_PIECES = 16
#: Part of a half-bandwidth by which a mode may be off by its mesh, and relative change of a frequency that is rounding.
_PART, _ROUNDING = 0.1, 1e-6
#: Powers of the element length that errors go with; the usual one where only one refinement can be solved.
_ORDERS, _USUAL = (1.0, 6.0), 2.0
#: Parts of the band's end up to which modes are looked at, below which they are a rigid body's, and up to which one is lost.
_LOOKED, _RIGID, _LOST = 1.3, 1e-3, 0.97
#: Likeness from which on a mode of the refined model is one of the coarse model's, and how far apart they may be.
_ALIKE, _FARTHEST = 0.5, 1.0
#: Part of their frequencies by which modes of an initial model may be off, and degrees of freedom up to which the mesh of an
#: answer is judged.
_NEAR, _SMALL = 0.15, 600


@dataclass(frozen=True, eq=False)
class MeshErrors:
    """Frequencies of a model beside those extrapolated to infinitely small elements.

    Attributes
    ----------
    structure : Structure
    number : (n_judged,) int array
        Number of each mode in the band among all modes of the model, from 0.
    frequency, damping_ratio : (n_judged,) float arrays
        Of these modes, with the elements as they are, in Hz and 1; ratios are at least 0.001, and 0.01 without damping.
    error, order : (n_judged,) float arrays
        Relative error of each frequency, positive where it is too high; and the power of the element length to which the error
        is proportional.
    passed_over : (n_lost,) float array
        Frequencies, Hz, of modes of the refined model in the band that match no mode of the present one.
    deviation : float
        Least relative standard deviation of the measured frequencies; infinite where none are measured.
    """

    structure: Structure
    number: IntArray
    frequency: FloatArray
    damping_ratio: FloatArray
    error: FloatArray
    order: FloatArray
    passed_over: FloatArray
    deviation: float

    @cached_property
    def allowed(self) -> FloatArray:
        """Relative errors that modes may have, (n_judged,): a tenth of the damping ratio, or `deviation` if less."""
        return np.minimum(_PART * self.damping_ratio, self.deviation)

    @property
    def tolerance(self) -> float:
        """The least relative error that a mode in the band may have; that of a mode of usual damping where none was judged."""
        return float(self.allowed.min(initial=min(_PART * _USUAL_DAMPING, self.deviation)))

    @cached_property
    def needed(self) -> int:
        """Number of pieces to cut each element into, along each edge, so that no mode is off by more than allowed.

        It follows from the error and the order of convergence of each mode, for errors within its `tolerance`. 0 where
        no error is above `allowed`.
        """
        size = np.abs(self.error)
        if not (size > self.allowed).any():
            return 0
        return int(np.ceil(np.max((size / self.tolerance) ** (1 / self.order)) - 1e-9))

    @property
    def n_elements(self) -> int:
        """Number of elements once each is cut into the `needed` pieces."""
        return n_split(self.structure) * max(self.needed, 1) ** split_power(self.structure)

    @property
    def worst(self) -> int:
        """Position among the judged modes of the one whose error is largest in parts of what is allowed."""
        return int((np.abs(self.error) / self.allowed).argmax())

    @property
    def half_bandwidths(self) -> FloatArray:
        """Relative errors over damping ratios, without sign, (n_judged,): parts of half the resonance width."""
        return np.abs(self.error) / self.damping_ratio

    @property
    def finding(self) -> str:
        """Clause on modes that the mesh lacks or, without any, on the mode with the largest error.

        "" if no mode is lacking and no error is above `self.allowed`.
        """
        if not self.needed and not self.passed_over.size:
            return ""
        if self.passed_over.size:
            listed = ", ".join(f"{value:.4g}" for value in self.passed_over[:3])
            return f"with smaller elements the model has modes at {listed} Hz that it lacks with these"
        worst = self.worst
        sense = "high" if self.error[worst] > 0 else "low"
        off = (
            f"{abs(self.error[worst]) / self.tolerance:.2g} times the deviation that is stated of measured modes"
            if self.tolerance == self.deviation
            else f"{self.half_bandwidths[worst]:.2g} times half its resonance width"
        )
        return (
            f"the mesh is too coarse: mode {self.number[worst] + 1} at {self.frequency[worst]:.4g} Hz is"
            f" {100 * abs(self.error[worst]):.2g} % too {sense}, {off}"
        )

    @property
    def words(self) -> str:
        """Clause with the `finding` and a remedy, such as a finer subdivision; "" where there is no finding."""
        found = self.finding
        if not found:
            return ""
        if not self.needed or self.needed > _MOST_PIECES:
            return f"{found}; refine the mesh, or take elements of higher order"
        remedy = (
            f"cells 1/{self.needed} as long bring"
            if any(made.cells for made in self.structure.elements)
            else f"`subdivide = {self.structure.subdivide * self.needed}` in [structure] brings"
        )
        whom = (
            "it"
            if not self.passed_over.size and np.count_nonzero(np.abs(self.error) > self.allowed) == 1
            else "every mode"
        )
        return f"{found}; {remedy} {whom} below {100 * self.tolerance:.2g} % ({self.n_elements} elements)"


def mesh_errors(
    structure: Structure, values: FloatArray, band: tuple[float, float], deviation: float = np.inf
) -> MeshErrors | str:
    """Discretization errors of the natural frequencies in `band`, or a sentence on why they are not known.

    The model is solved again with elements a half and a quarter as long; the error is extrapolated with the power of
    the element length that the three solutions show (Richardson).

    Parameters
    ----------
    structure : Structure
    values : (n_values,) float array
        Property values.
    band : (float, float)
        Lower and upper end of the frequency band, Hz.
    deviation : float
        Smallest relative standard deviation of the measured frequencies; infinite for records without modes. The error
        of a mode may be as large as this, or as a tenth of its damping ratio if that is less.

    Returns
    -------
    MeshErrors or str
        The text is "" for a structure without a mesh. Only the first refinement is used where the second has more than
        20 000 degrees of freedom.

    References
    ----------
    Roache (1994), Perspective: a method for uniform reporting of grid refinement studies, J. Fluids Eng. 116, 405-413.
    """
    why = obstacle(structure)
    if why is not None:
        return why
    finer = [made for made in (refined(structure, values, times, _MOST_DOFS) for times in (2, 4)) if made is not None]
    if not finer:
        return f"the mesh was not judged: twice as fine, the model has more than {_MOST_DOFS} degrees of freedom"
    low, high = band
    own = structure_modes(structure, values, min(_MOST_MODES, structure.n_dofs))
    looked = np.flatnonzero((own.frequency <= _LOOKED * high) & (own.frequency > _RIGID * high))
    if not looked.size:
        return "the mesh was not judged: the initial model has no mode in the band"
    count = len(looked) + int(looked[0])
    frequency = own.frequency[looked]
    other: list[FloatArray] = []
    for made in finer:
        found = structure_modes(made.structure, made.values, _ALL if made.structure.n_dofs <= _ALL else count + 8)
        if np.count_nonzero(found.frequency <= _RIGID * high) > np.count_nonzero(own.frequency <= _RIGID * high):
            return (
                "the mesh was not judged: pieces of its bars would move sideways without stiffness; make beams of them to"
                " have it judged"
            )
        pairs = _match_modes(structure, values, own, looked, made, found)
        other.append(np.where(pairs >= 0, found.frequency[pairs], np.nan))
        lost = found.frequency[np.setdiff1d(np.arange(len(found.frequency)), pairs)]
    limit, order = _limit(frequency, other)
    kept = np.isfinite(limit) & (np.maximum(limit, frequency) >= low) & (np.minimum(limit, frequency) <= high)
    error = frequency[kept] / limit[kept] - 1
    ratio = own.damping_ratio[looked[kept]]
    damping = np.where(ratio > 0, np.maximum(ratio, LEAST_DAMPING), _USUAL_DAMPING)
    lost = lost[(lost > max(low, _RIGID * high)) & (lost < _LOST * high)]
    return MeshErrors(structure, looked[kept], frequency[kept], damping, error, order[kept], lost, deviation)


def checked_mesh(setup: AnySetup, problem: RecordProblem, theta: FloatArray | None = None) -> MeshErrors | str:
    """Mesh errors of a set-up's structure in the band of its record, or a text that says why they cannot be computed.

    The text is "" for a structure without a mesh. Errors are those at the free variables `theta`, (n_params,), by
    default at the initial values of the parameters. For a record of modes the band is 15 % wider at both ends, since
    the initial model may miss the measured modes by that, and an error may be as large as the least relative standard
    deviation of the measured frequencies.
    """
    low, high = float(problem.frequency.min()), float(problem.frequency.max())
    values = setup.parameters.values(
        setup.parameters.start if theta is None else problem.physical(theta)[: setup.parameters.n_params]
    )
    if not compares_modes(problem):
        return mesh_errors(setup.structure, values, (low, high))
    deviation = float((problem.data.frequency_std / problem.data.frequency).min())
    return mesh_errors(setup.structure, values, ((1 - _NEAR) * low, (1 + _NEAR) * high), deviation)


def mesh_warnings(
    setups: Sequence[AnySetup], problems: Sequence[RecordProblem], theta: Sequence[FloatArray]
) -> tuple[str, ...]:
    """Warnings that the mesh shifts modes by more than the standard deviations with which they were fitted.

    Only records of modes of structures up to 600 degrees of freedom are checked; FRFs and histories show a shift as a
    misfit. The three sequences have one entry for each record; `theta` holds the free variables of its problem,
    (n_params,). `setups` have the structures.
    """
    messages = []
    for setup, problem, theta_of_record in zip(setups, problems, theta, strict=True):
        if compares_modes(problem) and setup.structure.n_dofs <= _SMALL:
            errors = checked_mesh(setup, problem, theta_of_record)
            messages.append("" if isinstance(errors, str) else errors.words)
    return tuple(f"{MESH_ERROR}: {words}" for words in dict.fromkeys(messages) if words)


def _limit(frequency: FloatArray, refined_frequencies: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Natural frequencies (n,) extrapolated to elements of zero length, and the orders of convergence (n,).

    `frequency` (n,) are those of the present mesh, `refined_frequencies` one or two arrays (n,) for elements a half and a
    quarter as long. The order is between 1 and 6; 2 where only one refinement is known, or the two changes are rounding
    or of opposite sign. The limit is NaN where a refined frequency is.
    """
    first = frequency - refined_frequencies[0]
    order = np.full(len(frequency), _USUAL)
    last, change = refined_frequencies[0], first
    if len(refined_frequencies) == 2:
        second = refined_frequencies[0] - refined_frequencies[1]
        is_clear = (
            (np.abs(first) > _ROUNDING * frequency) & (np.abs(second) > _ROUNDING * frequency) & (first * second > 0)
        )
        ratio = np.divide(first, second, out=np.full(len(frequency), 2**_USUAL), where=is_clear)
        order = np.clip(np.log2(np.maximum(ratio, 1.0)), *_ORDERS)
        last, change = refined_frequencies[1], second
    return last - change / (2**order - 1), order


def _match_modes(
    structure: Structure,
    values: FloatArray,
    modes: Modes,
    mode_numbers: IntArray,
    refined: RefinedStructure,
    refined_modes: Modes,
) -> IntArray:
    """Number, from 0, of the refined model's mode that matches each of the modes `mode_numbers`; -1 without a match.

    Modes are paired one to one by MAC with the mass matrix at the present nodes, which must be at least 0.5, among
    those with frequencies within a factor of e. `modes` and `refined_modes` are those of the structure and of the
    `refined` one, `values` (n_values,) the property values.
    """
    rows = refined.places(structure)
    mass = structure.matrix("mass", values)
    coarse, fine = modes.mode_shapes[:, mode_numbers], refined_modes.mode_shapes[rows]
    size = np.einsum("dm,dm->m", fine, mass @ fine)
    likeness = (coarse.T @ (mass @ fine)) ** 2 / np.where(size > 0, size, 1.0)
    near = (
        np.abs(np.log(np.maximum(refined_modes.frequency, 1e-300) / modes.frequency[mode_numbers][:, None])) < _FARTHEST
    )
    likeness = np.where(near, likeness, 0.0)
    pairs: IntArray = np.full(len(mode_numbers), -1)
    left, right = assign_pairs(likeness)
    good = likeness[left, right] >= _ALIKE
    pairs[left[good]] = right[good]
    return pairs
