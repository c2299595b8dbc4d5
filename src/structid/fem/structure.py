"""A structure: nodes, element sets, supports and ties, and from them element matrices on free degrees of freedom."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import get_type_hints

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray, locked, require_finite
from structid.core.display import Overview, Shown, join_words, plural
from structid.core.dof import DIRECTIONS, Dof, dofs_of_text, parse_dof
from structid.core.errors import InputError, naming, require_class
from structid.core.last_results import LastResults
from structid.fem.blocks import Pattern, pattern
from structid.fem.component import Component, Reduction, reductions
from structid.fem.contribution import (
    MATRIX_KINDS,
    Contribution,
    DenseSum,
    Property,
    dense_sum,
    rigid_mass,
    strain_operator,
    weigh_properties,
)
from structid.fem.elements import ElementSet, MatrixGroup
from structid.fem.elements.element import LENGTH, TRANSLATIONS, PropertyMatrices, dof_code, dof_of_code, joined_codes
from structid.fem.elements.matrix_group import GroupMatrices, SolverModel
from structid.fem.measured import MeasuredComponent
from structid.fem.modal_damping import ALL_MODES, damping_term, modal_damping
from structid.fem.node_positions import (
    LengthDependence,
    NodePosition,
    length_dependence,
    node_positions,
    stretched_lengths,
)
from structid.fem.subdivision import NumberedTerms, is_divisible, numbered_terms
from structid.fem.supports import (
    Base,
    DofEquations,
    Numbering,
    Tie,
    blocks_of_all,
    free_blocks,
    numbering,
    selection,
    tie_equations,
    tied_codes,
)
from structid.plotting import StructurePlots

#: Into which one element may be cut; its matrices are dense.
MOST_PIECES = 100
#: Degrees of freedom up to which the places of the entries of its matrices are kept.
_SMALL = 600
#: Selections of degrees of freedom that are kept: sensors and loads of a few records.
_SELECTIONS = 16
_ACTIVE = {1: ("X", "Y", "RZ"), 2: ("X", "Y", "RZ"), 3: DIRECTIONS}


@dataclass(frozen=True, eq=False, repr=False)
class Structure(Shown, StructurePlots):
    """Nodes, element sets, supports and ties.

    Parameters
    ----------
    nodes : mapping of int to position
        Position of each node in m: one, two or three coordinates, the same number for all.
    elements : sequence of ElementSet
        Element sets, each with a name of its own.
    fixed : sequence of degrees of freedom
        Degrees of freedom held at zero: ``"3X"``, or several of a node ``"3 X RZ"``, or the whole node ``"3"``.
    ties : sequence of RigidLink or Constraint
        Rigid links and constraints, by which degrees of freedom depend on others.
    active : sequence of directions, optional
        Directions that the structure can move in; the others are held. All of the dimension by default: X Y RZ
        for nodes with one or two coordinates, and what its elements move in besides, such as Z of a `Membrane`.
    subdivide : int
        Equal pieces of which each bar, beam and space beam is made. They are still one element: its number, its
        properties and its parameters are those of all pieces. Bars whose pieces nothing would hold sideways stay whole.
    bases : sequence of Base
        Supports that drive the structure where a record's inputs are there; held at zero otherwise.
    sliding : sequence of int
        Nodes whose place along the straight line of the bars and beams that meet there is a property, such as
        ``position[node 2]``: the distance in m from the neighbour at which the first of them begins.
    components : sequence of Component
        Parts that are reduced to their interface and a few modes.
    damping_ratio : float, optional
        Viscous damping of all modes, with whatever masses and stiffnesses they come to have, beside that of the
        elements. It is the property ``damping_ratio[all modes]``, and makes matrices full: up to 1200 degrees of
        freedom.
    measured : sequence of MeasuredComponent
        Parts that have no model but measured FRFs at the degrees of freedom of their interface. Matrices, modes and
        masses are without them.
    left_aside : sequence of str
        Sentences on contents of the model's file that no element stands for: a warning with every result.
    file_notes : sequence of str
        Sentences on other contents of that file that the structure lacks.

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
    subdivide: int = 1
    bases: tuple[Base, ...] = ()
    sliding: tuple[int, ...] = ()
    components: tuple[Component, ...] = ()
    damping_ratio: float | None = None
    measured: tuple[MeasuredComponent, ...] = ()
    left_aside: tuple[str, ...] = ()
    file_notes: tuple[str, ...] = ()

    def __init__(
        self,
        nodes: Mapping[int, ArrayLike],
        elements: Iterable[ElementSet],
        fixed: Iterable[str | Dof] = (),
        ties: Iterable[Tie] = (),
        active: Sequence[str] | None = None,
        subdivide: int = 1,
        bases: Iterable[Base] = (),
        sliding: Iterable[int] = (),
        components: Iterable[Component] = (),
        damping_ratio: float | None = None,
        measured: Iterable[MeasuredComponent] = (),
        left_aside: Iterable[str] = (),
        file_notes: Iterable[str] = (),
    ) -> None:
        """A structure of nodes (positions in m), element sets, supports and ties; matrices are made and checked here.

        `fixed` are the supports, `active` the directions of motion (None: those usual for the dimension), `subdivide`
        the pieces of each line, `bases` supports that drive, `sliding` nodes whose position is a property, `components`
        and `measured` reduced and measured parts, `damping_ratio` that of all modes. `left_aside` and `file_notes` are
        remarks on the mesh file.

        Raises
        ------
        InputError
            If an element or support names a node that does not exist, names repeat, directions or `subdivide` are out
            of range, or supports contradict ties.
        """
        if not isinstance(nodes, Mapping):
            raise InputError(
                f"`nodes` must be a mapping of label to position, got {type(nodes).__name__}; write {{1: 0.0, 2: 0.5}}"
            )
        if isinstance(elements, ElementSet):
            elements = [elements]
        positions = {int(label): locked(np.atleast_1d(np.asarray(x, dtype=np.float64))) for label, x in nodes.items()}
        _require_positions(positions)
        object.__setattr__(self, "nodes", positions)
        object.__setattr__(self, "elements", tuple(elements))
        object.__setattr__(self, "ties", tuple(ties))
        across = {d for made in self.elements for d in made.moves}
        usual = tuple(d for d in DIRECTIONS if d in across or d in _ACTIVE[self.dimension])
        directions = usual if active is None else tuple(d.upper() for d in active)
        if not directions or not set(directions) <= set(DIRECTIONS):
            raise InputError(f"`active` must list some of {' '.join(DIRECTIONS)}, got {active}")
        with naming("fixed"):
            object.__setattr__(self, "fixed", _fixed_dofs(fixed, directions))
        object.__setattr__(self, "active", directions)
        object.__setattr__(self, "subdivide", subdivide)
        object.__setattr__(self, "bases", tuple(bases))
        object.__setattr__(self, "sliding", tuple(dict.fromkeys(int(node) for node in sliding)))
        object.__setattr__(self, "components", tuple(components))
        object.__setattr__(self, "damping_ratio", None if damping_ratio is None else float(damping_ratio))
        object.__setattr__(self, "measured", tuple(measured))
        object.__setattr__(self, "left_aside", tuple(left_aside))
        object.__setattr__(self, "file_notes", tuple(file_notes))
        _require_names(self)
        beside = [e.name for e in self.elements if not isinstance(e, SolverModel)]
        if beside:
            self.require_masses(f"{beside[0]} beside them")
        _require_subdivision(self)
        _ = self.contributions  # so that what is wrong shows here, not at first use
        _require_supports(self)
        _require_interfaces(self)

    def overview(self) -> Overview:
        """Table of the element sets (name, type, properties), below a sentence on the structure.

        The sentence has the numbers of nodes, free degrees of freedom, sets and ties, the supports, measured components
        and the damping ratio of all modes.
        """
        words = (
            f"{plural(len(self.nodes), 'node')} in {self.dimension}-D, {self.n_dofs} free degrees of freedom,"
            f" {plural(len(self.elements), 'element set')}, {plural(len(self.ties), 'tie')};"
            f" fixed: {join_words([dof.place for dof in self.fixed]) or 'none'}"
        )
        words += "".join(f"; {item.words} at {join_words(item.interface)}" for item in self.measured)
        words += "" if self.damping_ratio is None else f"; damping ratio {self.damping_ratio:g} of all modes"
        names = {item.name: [p.term.property for p in self.properties if p.element == item.name] for item in self.sets}
        rows = [(item.name, type(item).__name__, ", ".join(names[item.name])) for item in self.sets]
        return Overview(words, ("element set", "type", "properties"), rows)

    @property
    def sets(self) -> tuple[ElementSet, ...]:
        """Element sets, with components in place of those that are in them: the owners of all properties."""
        within = {name for component in self.components for name in component.elements}
        return (
            *(element for element in self.elements if element.name not in within),
            *(reduction.group for reduction in self.reductions),
        )

    @property
    def has_matrices(self) -> bool:
        """True if its elements have masses and stiffnesses; else its responses alone are known."""
        return all(element.has_matrices for element in self.elements)

    @property
    def has_modes(self) -> bool:
        """True if its matrices are all there is of it, hence modes, and responses at any frequency."""
        return self.has_matrices and not self.measured

    def require_modes(
        self, what: str, remedy: str = "take FRFs as the record ([record.frf] makes them of time histories)"
    ) -> None:
        """Raise `InputError` if the structure has no modes, as one with parts known by FRFs alone, which `what` needs.

        `what` and `remedy` are words of the message: the computation that is asked for, and an alternative to a model.
        """
        if self.has_modes:
            return
        if self.measured:
            part, model = self.measured[0].words, "a model of the component"
        else:
            part = next(repr(element.name) for element in self.elements if not element.has_matrices)
            model = 'its matrices or modes (`gives = "matrices"` or `"modes"` of a solver)'
        raise InputError(
            f"{part} is known by its FRFs alone, which {what} cannot be computed with; {remedy}, or take {model}"
        )

    def require_scaled_modes(self, what: str, *remedy: str) -> None:
        """Raise `InputError` unless the structure has modes of known size; arguments as of `require_modes`."""
        self.require_modes(what, *remedy)
        self.require_masses(what)

    def require_masses(self, what: str) -> None:
        """Raise `InputError` if a solver gave modes without modal masses; `what` says what cannot be computed then."""
        free = [e.name for e in self.elements if isinstance(e, SolverModel) and not e.has_mass]
        if free:
            raise InputError(
                f"{free[0]!r} is made of modes without modal masses, so that their scale is free and {what} cannot be computed;"
                " let the solver print generalized masses (.f06, .frd), or write shapes of unit modal mass and `scaling` mass"
                " (.csv)"
            )

    @property
    def dimension(self) -> int:
        """Number of coordinates of a node."""
        return len(next(iter(self.nodes.values())))

    @cached_property
    def properties(self) -> tuple[Property, ...]:
        """Every property of every element set, in the order of their values in `values`.

        Sets come first, in the order of `sets`; then the variable node positions, the lengths with a tolerance, and the
        damping ratio of all modes.
        """
        items, start = [], 0
        terms_of = {**self._numbered.terms, **{item.component.name: item.terms for item in self.reductions}}
        for name in (element.name for element in self.sets):
            for term in terms_of[name]:
                items.append(Property(name, term, slice(start, start + len(term.values))))
                start += len(term.values)
        single = [(node_position.name, node_position.term) for node_position in self._node_positions]
        single += [
            (e.name, PropertyMatrices(LENGTH, "length", "1", np.ones(1)))
            for e in self.elements
            if e.has_uncertain_length
        ]
        single += [] if self.damping_ratio is None else [(ALL_MODES, damping_term(self.damping_ratio))]
        items += [Property(name, term, slice(start + i, start + i + 1)) for i, (name, term) in enumerate(single)]
        return tuple(items)

    @cached_property
    def _node_positions(self) -> tuple[NodePosition, ...]:
        """The nodes with variable position, checked."""
        return node_positions(self.sliding, self.elements, self.nodes, self.ties)

    @cached_property
    def _length_dependences(self) -> dict[str, LengthDependence]:
        """Dependence of element lengths on properties, by name of the element set, for sets whose lengths may change.

        They change with a length that has a tolerance, a factor on all, or with the position of a node.
        """
        index_of_length = {p.element: p.values.start for p in self.properties if p.term.kind == "length"}
        index_of_position = {p.element: p.values.start for p in self.properties if p.term.kind == "position"}
        of_node = {node_position.node: node_position for node_position in self._node_positions}
        dependences: dict[str, LengthDependence] = {}
        for element in self.elements:
            if element.name in index_of_length:
                dependences[element.name] = stretched_lengths(element, self.nodes, index_of_length[element.name])
            if element.is_line and np.isin(element.nodes, self.sliding).any():
                sliding = length_dependence(element, of_node, self.nodes, index_of_position)
                stretched = dependences.get(element.name)
                dependences[element.name] = sliding if stretched is None else sliding.followed_by(stretched)
        return dependences

    @cached_property
    def _numbered(self) -> NumberedTerms:
        """Matrix terms of all element sets, subdivided where asked, with the codes of motions between the pieces."""
        used = [element.codes(self.nodes) for element in self.elements if not element.follows]
        present = joined_codes([*used, tied_codes(self._equations)])
        return numbered_terms(self.elements, self.nodes, present, self.active or (), self.subdivide, self.sliding)

    @cached_property
    def divisible(self) -> tuple[ElementSet, ...]:
        """Element sets that `subdivide` cuts: beams, and bars whose pieces cannot move sideways."""
        return tuple(element for element in self.elements if is_divisible(element, self.nodes, self.active or ()))

    @cached_property
    def values(self) -> FloatArray:
        """Nominal values of all properties, one after another, (n_values,)."""
        parts = [p.term.values for p in self.properties]
        return locked(np.concatenate(parts) if parts else np.zeros(0))

    @cached_property
    def numbering(self) -> Numbering:
        """All degrees of freedom that elements and ties use, sorted, and the sparse map to them from the free ones.

        Those that supports hold, or that are outside the active directions, have empty rows. Raises `InputError` if
        ties run in a circle or hold what is fixed.
        """
        used = [matrix_term.codes for item in self.properties for matrix_term in item.term.matrix_terms]
        codes = joined_codes([*used, tied_codes(self._equations)])
        following = [reduction.following for reduction in self.reductions if reduction.following is not None]
        return numbering(codes.tolist(), self._constrained(codes), self._equations, following)

    def _constrained(self, codes: IntArray) -> frozenset[int]:
        """The codes among `codes` (n,) that are held at zero: by supports, or as directions outside `active`.

        A code is 6 times the label of a node plus 0 to 5 for X to RZ.
        """
        moves = np.isin(codes % 6, [DIRECTIONS.index(d) for d in self.active or ()]) | np.isin(
            codes, self._numbered.free
        )
        inactive = codes[~moves].tolist()
        fixed = [dof_code(d.node, d.direction) for d in self.fixed]
        return frozenset([*inactive, *fixed]) & frozenset(codes.tolist())

    @cached_property
    def reductions(self) -> tuple[Reduction, ...]:
        """Reductions of the components in `components` to their interface and a few modes, in their order.

        Components in `measured` have none. Raises `InputError` if a component cannot be reduced, or a line set of one
        has a tolerance of its length.
        """
        if not self.components:
            return ()
        _require_held_lengths(self)
        terms = self._numbered.terms
        codes = [
            matrix_term.codes for several in terms.values() for term in several for matrix_term in term.matrix_terms
        ]
        kept = [dof_code(dof.node, dof.direction) for component in self.measured for dof in component.interface]
        constrained = self._constrained(joined_codes(codes))
        return reductions(self.components, terms, self._equations, constrained, np.array(kept, dtype=np.int64))

    @cached_property
    def _equations(self) -> DofEquations:
        return tie_equations(self.ties, self.nodes, self.active or ())

    @property
    def dofs(self) -> tuple[Dof, ...]:
        """Free degrees of freedom in the order of the matrices; those inside elements have labels above the nodes'."""
        return tuple(dof_of_code(code) for code in self.numbering.free)

    def words(self, dof: Dof) -> str:
        """Text of one of `dofs` in messages, such as ``3X+``, or ``RZ inside joint 1``."""
        inside = self._numbered.owners.get(dof.node)
        return str(dof.unsigned) if inside is None else f"{dof.direction} inside {inside}"

    @property
    def n_dofs(self) -> int:
        return len(self.numbering.free)

    @cached_property
    def contributions(self) -> tuple[Contribution, ...]:
        """Element matrices on free degrees of freedom, each family with the property values that weigh it.

        Their weighted sums are the mass, damping, stiffness and other matrices. Modal damping, if `damping_ratio` is
        not None, is the last.
        """
        parts = weigh_properties(self.properties, partial(free_blocks, self.numbering), self._length_dependences)
        if self.damping_ratio is None or not self.n_dofs:
            return parts
        index = self.properties[-1].values.start
        return (*parts, modal_damping(parts, index, len(self.values), self.n_dofs))

    def element_contributions(self, name: str) -> tuple[Contribution, ...]:
        """Element matrices of one set on all degrees of freedom of `numbering`, supports and dependent ones included.

        Motion of all is `numbering.matrix` times that of the free ones; products of the matrices with it are the forces
        at the ends of each element.
        """
        properties = [item for item in self.properties if item.element == name]
        return weigh_properties(properties, partial(blocks_of_all, self.numbering), self._length_dependences)

    @property
    def base_supports(self) -> frozenset[Dof]:
        """Degrees of freedom, without sign, that the bases move."""
        return frozenset(dof.unsigned for base in self.bases for dof in base.supports)

    def driven(self, dofs: Iterable[Dof]) -> tuple[Base, ...]:
        """The bases whose supports are among the inputs `dofs`, in that order; () if all of them are forces.

        A base is a set of supports that one measured motion drives.

        Raises
        ------
        InputError
            If some are forces and others motions of bases, or two inputs move the same base.
        """
        chosen = tuple(dofs)
        base_of = [next((base for base in self.bases if base.moves(dof)), None) for dof in chosen]
        moving = [base for base in base_of if base is not None]
        if not moving:
            return ()
        if len(moving) < len(chosen):
            force = next(dof for dof, base in zip(chosen, base_of, strict=True) if base is None)
            raise InputError(
                f"{force} is a force, and others are motions of supports; give each kind a record of its own"
            )
        twice = next((base for base in moving if moving.count(base) > 1), None)
        if twice is not None:
            raise InputError(f"two inputs move base {twice.name!r}; leave one of them out, or make two bases")
        return tuple(moving)

    @cached_property
    def unreduced(self) -> Structure:
        """Copy with all degrees of freedom of its components, and the same properties."""
        return replace(self, components=tuple(replace(component, whole=True) for component in self.components))

    def release_supports(self, bases: tuple[Base, ...]) -> Structure:
        """The structure with the supports of `bases` released and those of each base tied to its first.

        It is cached, and has no bases of its own. A base is a set of supports that one motion drives. Components that
        hold such supports keep them on their interface.

        Raises
        ------
        InputError
            If the structure has a damping ratio of all modes, which is of motion against supports at rest.
        """
        if self.damping_ratio is not None:
            raise InputError(
                f"base {bases[0].name!r} drives the structure, and modal damping (`damping_ratio` of all modes) is of motion"
                " against supports at rest; use loss factors of twice the damping ratio, or measure forces"
            )
        if bases not in self._released:
            supports = {dof.unsigned for base in bases for dof in base.supports}
            fixed = tuple(dof for dof in self.fixed if dof.unsigned not in supports)
            ties = (*self.ties, *(tie for base in bases for tie in base.ties))
            parts = tuple(
                reduction.component.with_interface(supports & {*reduction.group.dofs}) for reduction in self.reductions
            )
            self._released[bases] = replace(self, fixed=fixed, ties=ties, bases=(), components=parts)
        return self._released[bases]

    @cached_property
    def _released(self) -> dict[tuple[Base, ...], Structure]:
        """Made once, so that what was found of one serves all records."""
        return {}

    def matrix(self, kind: str, values: FloatArray | None = None) -> sparse.csc_array:
        """Mass, damping, stiffness or structural damping matrix on the free degrees of freedom, (n_dofs, n_dofs), SI.

        Parameters
        ----------
        kind : {"mass", "damping", "stiffness", "structural_damping"}
            Mass matrix, viscous damping, stiffness, and imaginary part of the complex stiffness; ``friction:NAME`` for
            the matrix of a friction element.
        values : (n_values,) float array, optional
            Property values; the nominal ones by default.

        Raises
        ------
        InputError
            If there is no such kind of matrix. A kind that no element contributes to gives a matrix of zeros.
        """
        if kind not in MATRIX_KINDS and not kind.startswith("friction:"):
            raise InputError(f"`kind` must be one of {', '.join(MATRIX_KINDS)}, got {kind!r}")
        properties = self.values if values is None else values
        chosen = [part for part in self.contributions if part.matrix_kind == kind]
        if chosen and self.n_dofs <= _SMALL:
            return self._pattern(kind).summed(np.concatenate([part.weights(properties) for part in chosen]))
        total = sparse.csc_array((self.n_dofs, self.n_dofs))
        for part in chosen:
            total = total + part.blocks.assemble(part.weights(properties))
        return total

    def strain_operator(self, values: FloatArray) -> sparse.csr_array | None:
        """The matrix B with stiffness K = B'B at property values (n_values,), (n_strains, n_dofs): element strains.

        None where an element matrix is not a sum of squares, or where groups of matrices make up the stiffness.
        """
        return strain_operator(self.contributions, values, self.n_dofs)

    def dense_matrices(self, kinds: Sequence[str], values: FloatArray) -> FloatArray:
        """Matrices of several `kinds` as dense arrays, (n_kinds, n_dofs, n_dofs), at the property `values` (n_values,).

        They are on the free degrees of freedom, SI units, in the order of `kinds` ("mass", "damping", "stiffness",
        "structural_damping" or ``friction:NAME``); zeros where the structure has no such matrix.
        """
        key = tuple(kinds)
        if key not in self._dense_sums:
            self._dense_sums[key] = dense_sum(self.contributions, key, self.n_dofs, len(self.values))
        return self._dense_sums[key].at(values)

    @cached_property
    def _dense_sums(self) -> dict[tuple[str, ...], DenseSum]:
        """Dense matrices of several kinds as sums of element matrices, for small models, by the kinds asked for."""
        return {}

    def _pattern(self, kind: str) -> Pattern:
        """Common sparsity pattern of the element matrices of one kind, such as "mass"; made once."""
        if kind not in self._patterns:
            self._patterns[kind] = pattern([part.blocks for part in self.contributions if part.matrix_kind == kind])
        return self._patterns[kind]

    @cached_property
    def _patterns(self) -> dict[str, Pattern]:
        """Sparsity pattern of each kind of matrix; for small models, whose matrices are assembled many times."""
        return {}

    def selection(self, dofs: Iterable[Dof]) -> sparse.csc_array:
        """Columns that read (or load) `dofs` through the ties, signs included, (n_dofs, number of `dofs`); read only.

        Raises
        ------
        InputError
            If a degree of freedom is not part of the structure or is held at zero.
        """
        chosen = tuple(dofs)
        return self._selections.get_or_make(chosen, lambda: self._locked_selection(chosen))

    def _locked_selection(self, dofs: tuple[Dof, ...]) -> sparse.csc_array:
        """Columns that read `dofs`, (n_dofs, number of `dofs`), whose arrays cannot be written to."""
        columns = selection(self.numbering, self.nodes, dofs)
        columns.sort_indices()  # sparse products sort in place, which locked arrays refuse
        for array in (columns.data, columns.indices, columns.indptr):
            array.flags.writeable = False
        return columns

    @cached_property
    def _selections(self) -> LastResults[tuple[Dof, ...], sparse.csc_array]:
        """The last results of `selection`: each record of a model, smoothed or cut, asks for the same channels."""
        return LastResults(_SELECTIONS)

    def require_dofs(self, dofs: Iterable[Dof], inputs: bool = False) -> None:
        """Raise `InputError` if one of `dofs` is not free: not part of the structure, or held at zero.

        With `inputs`, they may be supports of bases instead, if all of them are; see `driven`.
        """
        wanted = tuple(dofs)
        if not (inputs and self.driven(wanted)):
            self.selection(wanted)

    def mass_of(self, values: FloatArray | None = None, direction: str | None = None) -> float:
        """Mass that takes part in rigid motion along `direction`, kg: r' M r on all motions, supports included.

        Parameters
        ----------
        values : (n_values,) float array, optional
            Property values; the nominal ones by default.
        direction : {"X", "Y", "Z"}, optional
            By default the first translation in which the structure has any mass, active ones before others.
        """
        properties = self.values if values is None else values
        return rigid_mass(self.properties, properties, self._along(direction), self._length_dependences)[0]

    def mass_gradient(self, direction: str | None = None, values: FloatArray | None = None) -> FloatArray:
        """Derivative of `mass_of` with respect to every property value, (n_values,), kg per unit of the value.

        Factors of matrix groups are included. `direction` and `values` are as in `mass_of`.
        """
        properties = self.values if values is None else values
        return rigid_mass(self.properties, properties, self._along(direction), self._length_dependences)[1]

    def _along(self, direction: str | None) -> Sequence[str]:
        """Translations in which mass is looked for."""
        return (direction,) if direction else sorted(TRANSLATIONS, key=lambda one: one not in (self.active or ()))


def _require_positions(nodes: Mapping[int, FloatArray]) -> None:
    """Raise `InputError` unless there are nodes, with labels from 0 and finite positions of 1, 2 or 3 coordinates.

    All must have the same number of coordinates.
    """
    if not nodes:
        raise InputError("`nodes` must hold at least one node, got none")
    sizes = {len(x) for x in nodes.values()}
    if len(sizes) > 1 or not sizes <= {1, 2, 3}:
        raise InputError(f"`nodes` must all have 1, 2 or 3 coordinates, got {sorted(sizes)}")
    for label, x in nodes.items():
        if label < 0:
            raise InputError(f"node labels must not be negative, got {label}")
        require_finite(f"position of node {label}", x)


def _require_names(structure: Structure) -> None:
    """Raise `InputError` if two parts share a name, or elements or supports name nodes that do not exist.

    Parts are element sets, components and measured components, sliding nodes, and the damping ratio of all modes.
    """
    names = [e.name for e in structure.elements] + [component.name for component in structure.components]
    names += [component.name for component in structure.measured] + [f"node {label}" for label in structure.sliding]
    names += [] if structure.damping_ratio is None else [ALL_MODES]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"two parts of the structure are called {name!r}; give each a name of its own")
    for element in structure.elements:
        for node in np.unique(element.nodes).tolist():
            if node >= 0 and node not in structure.nodes:
                raise InputError(f"{element.name!r} uses node {node}, which the structure does not have")
    for dof in structure.fixed:
        if dof.node not in structure.nodes:
            raise InputError(f"`fixed` names {dof} at node {dof.node}, which the structure does not have")


def _require_supports(structure: Structure) -> None:
    """Raise `InputError` if a support of a base is not fixed, no element or tie uses it, or it is named twice."""
    fixed = {dof.unsigned for dof in structure.fixed}
    codes = set(structure.numbering.codes.tolist())
    owners: dict[Dof, Base] = {}
    for base in structure.bases:
        for dof in base.supports:
            if dof.unsigned not in fixed:
                raise InputError(f"base {base.name!r} has no support {dof.place}: it is not held; add it to `fixed`")
            if dof_code(dof.node, dof.direction) not in codes:
                raise InputError(f"base {base.name!r} moves nothing at {dof.place}: no element or tie is there")
            if owners.setdefault(dof.unsigned, base) is not base or base.supports.count(dof) > 1:
                raise InputError(f"base {base.name!r} has support {dof.place}, which is named twice; take one out")


def _require_interfaces(structure: Structure) -> None:
    """Raise `InputError` if an interface of a measured component is not part of the structure."""
    for component in structure.measured:
        try:
            structure.selection(component.interface)
        except InputError as error:
            raise InputError(
                f"measured component {component.name!r}: {error}; join the component to degrees of freedom that move with elements"
                " of the model, or by springs to a node of its own"
            ) from error


def _require_subdivision(structure: Structure) -> None:
    """Raise `InputError` unless `subdivide` is a whole number from 1 to 100 and lines can be cut.

    For 1 no line is needed; above, bars alone that nothing holds sideways are refused too.
    """
    pieces = structure.subdivide
    if not isinstance(pieces, int) or not 1 <= pieces <= MOST_PIECES:
        raise InputError(f"`subdivide` must be a whole number from 1 to {MOST_PIECES}, got {pieces!r}")
    if pieces > 1 and not any(element.is_line for element in structure.elements):
        raise InputError(
            "`subdivide` cuts bars, beams and space beams only, and the structure has none; take 1, and refine the mesh or"
            " the matrices in the program that made them"
        )
    if pieces > 1 and not structure.divisible:
        raise InputError(
            "`subdivide` would cut bars only, whose pieces nothing holds sideways; take 1, or make beams of them"
        )


def _fixed_dofs(fixed: Iterable[str | Dof], directions: Sequence[str]) -> tuple[Dof, ...]:
    """Degrees of freedom that `fixed` names, as in ``"3X"`` or ``"3 X RZ"``; ``"3"`` is node 3 in all `directions`.

    `directions` are those in which nodes move; a single text is a list of one. Raises `InputError` for another form.
    """
    texts = [fixed] if isinstance(fixed, str) else fixed
    if not isinstance(texts, Iterable) or isinstance(texts, Mapping):
        raise InputError(f'a list of degrees of freedom is needed, such as ["1X", "2"], got {fixed!r}')
    dofs: list[Dof] = []
    for text in texts:
        named = dofs_of_text(text)
        is_node = isinstance(text, str) and text.strip().isdigit()
        dofs += [dof for dof in named if not is_node or dof.direction in directions]
    return tuple(dofs)


def from_matrices(
    groups: Mapping[str, GroupMatrices],
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
        Degree of freedom of each row, the same for all groups.
    nodes : mapping of label to position, optional
        Positions for pictures, m; all at the origin by default.
    fixed : sequence of degrees of freedom
        Degrees of freedom held at zero: ``"3X"``, or several of a node ``"3 X RZ"``, or the whole node ``"3"``.

    Raises
    ------
    InputError
        If a group is no mapping, has another key, or its matrices have another size.

    Examples
    --------
    >>> import numpy as np
    >>> chain = from_matrices({"all": {"mass": np.eye(2), "stiffness": [[2, -1], [-1, 2]]}}, ["1X", "2X"])
    >>> chain.n_dofs
    2
    """
    require_class("groups", groups, Mapping, 'write {"all": {"mass": M, "stiffness": K}}')
    known = get_type_hints(GroupMatrices)
    for name, matrices in groups.items():
        require_class(f"groups[{name!r}]", matrices, Mapping, 'write {"mass": M, "stiffness": K}')
        wrong = [key for key in matrices if key not in known]
        if wrong:
            raise InputError(
                f"`groups[{name!r}]` must have no keys but {', '.join(known)}, got {wrong[0]!r}; rename it"
            )
    elements = [MatrixGroup(name, dofs, **matrices) for name, matrices in groups.items()]
    labels = {parse_dof(d).node for d in dofs}
    positions = dict.fromkeys(sorted(labels), (0.0, 0.0, 0.0)) if nodes is None else nodes
    return Structure(positions, elements, fixed)


def _require_held_lengths(structure: Structure) -> None:
    """Raise `InputError` if a line set of a component has a tolerance of its length, which changes its matrices."""
    for component in structure.components:
        for element in structure.elements:
            if element.name in component.elements and element.has_uncertain_length:
                raise InputError(
                    f"component {component.name!r}: element set {element.name!r} has a `tolerance` of its length, which no"
                    " reduction keeps; leave `length` out of it, or take the set out of `elements`"
                )
