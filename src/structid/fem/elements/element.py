"""Element types and sets: what a type declares, and one matrix an element for each property."""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from typing import Annotated, Any, ClassVar, Generic, Literal, TypeAlias, TypeVar, dataclass_transform

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray, locked
from structid.core.constraints import constraint_violation, declared_types, describe_type
from structid.core.display import names_like, plural
from structid.core.dof import DIRECTIONS, Dof
from structid.core.errors import InputError
from structid.lazy import LoadedByKey

Kind = Literal[
    "mass",
    "rotary_inertia",
    "viscous_damping",
    "stiffness",
    "loss_factor",
    "friction",
    "thickness",
    "position",
    "parameter",
    "damping_ratio",
    "axial_force",
    "length",
]
#: Symbols of elements in drawings; "flat" and "shell" are cells with two faces, with and without a gap between neighbours.
Symbol = Literal["line", "spring", "dashpot", "friction", "disc", "ring", "flat", "shell", "solid", "square"]
#: Name of the common factor on the lengths of a set of bars or beams, a property where a tolerance of it is stated.
LENGTH = "length"
NodeCoordinates = Mapping[int, FloatArray]

TRANSLATIONS = DIRECTIONS[:3]

Taken = TypeVar("Taken", contravariant=True)
Stored = TypeVar("Stored", covariant=True)
E = TypeVar("E", bound="ElementSet")


class Given(Generic[Taken, Stored]):
    """Type of a field that is given as one type and stored as another, in the words that type checkers understand."""

    def __get__(self, instance: object, owner: type | None = None) -> Stored:
        raise NotImplementedError

    def __set__(self, instance: object, value: Taken) -> None:
        raise NotImplementedError


#: One number an element, or one for all.
Values: TypeAlias = Annotated[Given[ArrayLike, FloatArray], "float or (n_elements,) array"]
#: The same, or none.
OptionalValues: TypeAlias = Annotated[
    Given[ArrayLike | None, FloatArray | None], "float or (n_elements,) array, optional"
]
#: The same of either sign, or none.
OptionalSignedValues: TypeAlias = Annotated[
    Given[ArrayLike | None, FloatArray | None], "float or (n_elements,) array of either sign, optional"
]
#: Node labels.
Nodes: TypeAlias = Annotated[Given[ArrayLike, IntArray], "(n_elements, n_nodes) int array"]
#: A direction in space.
Vector: TypeAlias = Annotated[Given[ArrayLike | None, FloatArray | None], "(3,) array, optional"]

Dofs: TypeAlias = Sequence[str | Dof] | str | Dof
#: Degrees of freedom at the ends of connectors, one an element.
Ends: TypeAlias = Annotated[Given[Dofs, tuple[Dof, ...]], "degree of freedom or sequence of them"]
OtherEnds: TypeAlias = Annotated[Given[Dofs | None, tuple[Dof, ...] | None], "the same, optional"]
#: Degree of freedom at an end of a single friction contact.
End: TypeAlias = Annotated[Given[str | Dof, tuple[Dof, ...]], "degree of freedom"]
OtherEnd: TypeAlias = Annotated[Given[str | Dof | None, tuple[Dof, ...] | None], "degree of freedom, optional"]
#: Degree of freedom of a joint, whatever its sense.
At: TypeAlias = Annotated[Given[str | Dof, Dof], "degree of freedom"]
#: Directions in which a mass has inertia.
Translations: TypeAlias = Annotated[
    Given[Iterable[str] | None, tuple[str, ...] | None], 'tuple of {"X", "Y", "Z"}, optional'
]

#: How well fixed properties are known: a number for all of them, or one for each by name.
Tolerance: TypeAlias = Annotated[float | Mapping[str, float] | None, "float or mapping of str to float, optional"]

#: Checks a given value and makes what is stored of it; the first argument is the name of the set, for messages.
Store = Callable[[str, Any], Any]


@dataclass(frozen=True)
class Declared:
    """Declaration of one field of an element type; limits and choices stand in the annotation.

    Parameters
    ----------
    words : str
        What it is.
    kind : Kind, optional
        Of a property, whose numbers weigh a matrix an element. It fixes how the property enters the dynamic stiffness:
        ``mass`` and ``rotary_inertia`` by -omega^2, ``viscous_damping`` by i omega, ``stiffness`` by 1, ``loss_factor``
        by i times the element's stiffness. A ``thickness`` weighs the matrices of the others by its powers, a
        ``position`` by those of the lengths that it changes. An ``axial_force`` enters by 1, is of either sign and has
        no loss. A ``parameter`` weighs matrices that say themselves how they enter.
    unit : str
        SI unit.
    of : str
        The property whose matrix it weighs too; by default it has one of its own.
    positive : bool
        Whether 0 is refused.
    unlimited : bool
        Whether leaving it out is the same as one infinite number: nothing gives way there.
    optional : bool
        Whether it may be left out, and is no property of the set then.
    about_axes : str
        Unit between rotations.
    stored : Store, optional
    """

    words: str
    kind: Kind | None = None
    unit: str = ""
    of: str = ""
    positive: bool = False
    about_axes: str = ""
    stored: Store | None = None
    unlimited: bool = False
    optional: bool = False


def checked_tolerance(name: str, tolerance: float | Mapping[str, float]) -> float | Mapping[str, float]:
    """The `tolerance` of the set `name`, relative, as a float, or as a dict by property, after a check.

    Raises `InputError` unless all of its numbers lie from 0 (exact) to 1.
    """
    parts = tolerance if isinstance(tolerance, Mapping) else {"": tolerance}
    for key, part in parts.items():
        if not 0 <= part <= 1:
            of = f" of {key}" if key else ""
            raise InputError(
                f"`tolerance` of {name!r}{of} must be at least 0 and at most 1, got {part:g}; 0.01 is 1 %, 0 is exact"
            )
    return dict(tolerance) if isinstance(tolerance, Mapping) else float(tolerance)


#: What many types say of their damping.
LOSS_FACTOR: tuple[str, Kind, str] = ("Structural damping: stiffness times (1 + i loss_factor)", "loss_factor", "1")
PER_VELOCITY: tuple[str, Kind] = ("Viscous damping in proportion to velocity", "viscous_damping")
PER_STRAIN_RATE: tuple[str, Kind] = ("Viscous damping in proportion to strain rate", "viscous_damping")


def declared(
    words: str,
    kind: Kind | None = None,
    unit: str = "",
    of: str = "",
    about_axes: str = "",
    positive: bool = False,
    stored: Store | None = None,
    unlimited: bool = False,
    optional: bool = False,
    **options: Any,
) -> Any:
    """A field of an element type, see `Declared`; `options` are those of `dataclasses.field`, such as `default`."""
    what = Declared(words, kind, unit, of, positive, about_axes, stored, unlimited, optional or unlimited)
    return field(metadata={"declared": what}, **options)


def declarations(kind: type[ElementSet] | ElementSet) -> dict[str, Declared]:
    """Declaration of each field of an element type, by name."""
    return {item.name: item.metadata["declared"] for item in fields(kind)}


@dataclass_transform(field_specifiers=(declared,), eq_default=False)  # frozen, mypy forgets `Given` of inherited fields
def element(cls: type[E]) -> type[E]:
    """Class decorator that makes an element type a frozen dataclass with its fields listed in the docstring.

    The parameters come after the summary, before sections of notes and references. The initializer explains wrong
    arguments by an `InputError`.
    """
    decorated = dataclass(frozen=True, eq=False, repr=False)(cls)
    decorated.__init__ = _with_known_arguments(decorated, decorated.__init__)  # type: ignore[method-assign]
    types, rows = declared_types(decorated), []
    for item in fields(decorated):
        declaration: Declared = item.metadata["declared"]
        unit = " or ".join(word for word in (declaration.unit, declaration.about_axes) if word not in ("", "1"))
        default = "" if item.default in (MISSING, None) else f", default {item.default!r}"
        if item.init:
            rows += [f"{item.name} : {describe_type(types[item.name])}{default}"]
            rows += [f"    {declaration.words}{', ' * bool(unit)}{unit}."]
    text = inspect.cleandoc(cls.__doc__ or "")
    summary, *others = re.split(r"\n\n(?=(?:Notes|References)\n---)", text)
    decorated.__doc__ = "\n\n".join([summary, "\n".join(["Parameters", "----------", *rows]), *others])
    return decorated


def _with_known_arguments(kind: type[ElementSet], init: Callable[..., None]) -> Callable[..., None]:
    """Wrapper of `init`, the initializer of the element type `kind`, whose `InputError` explains wrong arguments.

    It is raised where a name is unknown, or arguments are missing or too many, in place of Python's `TypeError`.
    """
    signature = inspect.signature(init)

    @functools.wraps(init)
    def checked(*positional: object, **named: object) -> None:
        """Call `init` with these arguments; `InputError` that names all arguments of the type if they do not fit."""
        try:
            signature.bind(*positional, **named)
        except TypeError as error:
            names = [name for name in signature.parameters if name != "self"]
            raise InputError(_wrong_arguments(kind, names, named, str(error))) from None
        init(*positional, **named)

    return checked


def _wrong_arguments(kind: type[ElementSet], names: Sequence[str], named: Iterable[str], trouble: str) -> str:
    """Message on a call of the element type `kind` with wrong arguments: the wrong one, the one meant, and all `names`.

    `named` are the names that the call used. Meant is the argument whose description begins with the wrong name, as
    that of the bending stiffness does with ``EI``, or else one of similar spelling, if any. `trouble`, Python's words,
    takes the place of both where all names are known.
    """
    every = f"the arguments of {kind.__name__} are {', '.join(names)}"
    wrong = next((name for name in named if name not in names), None)
    if wrong is None:
        return f"{kind.__name__}: {trouble}; {every}"
    described = declarations(kind)
    alike = [name for name in names if re.match(rf"{re.escape(wrong)}\b", described[name].words)]
    meant = next(iter([*alike, *names_like(wrong, names)]), None)
    return f"`{wrong}` is no argument of {kind.__name__}{f': write `{meant}`' if meant else ''}; {every}"


@dataclass(frozen=True, eq=False)
class ShearRatio:
    """Dependence of a beam's matrix on its shear flexibility: a power of s = G / (G + ratio E), the part of bending.

    Parameters
    ----------
    bending, shear : str
        The properties E and G, such as ``bending_stiffness`` and ``shear_stiffness``.
    ratio : (n_elements,) float array
        12 / length^2, 1/m^2.
    power : int
        Stiffness goes with s itself, mass has parts with s and s^2.
    """

    bending: str
    shear: str
    ratio: FloatArray
    power: int = 1


def shear_ratio(bending: FloatArray, shear: FloatArray, ratio: FloatArray) -> FloatArray:
    """Ratio s = shear / (shear + ratio bending) of `ShearRatio`: the flexibility that is bending, (n_elements,).

    `bending` is EI in N m^2, `shear` G A_s in N and `ratio` 12 / length^2, (n_elements,) each.
    """
    return shear / (shear + ratio * bending)


@dataclass(frozen=True)
class Power:
    """A property over a reference value, to a power."""

    property: str
    reference: float
    exponent: int


@dataclass(frozen=True, eq=False)
class ElementMatrixTerm:
    """Matrices of all elements of a set, at unit value of their property, unit thickness and nominal `shear` ratio.

    Parameters
    ----------
    codes : (n_elements, n_local) int array
        Degree of freedom codes, see `dof_code`; -1 where a row is not used.
    local : (n_elements, n_local, n_local) float array
    power : int
        Power of the thickness that they go with.
    whole : sparse array, optional
        In place of `local`: the matrix of a set that is one element.
    shear : ShearRatio, optional
        Shear ratio that weighs the matrices too.
    powers : tuple of Power
        Powers of properties that weigh the matrix too, of a set that is one element.
    matrix_kind : str
        How it enters the dynamic stiffness, see `Contribution`, where the kind of its property does not say it.
    reduced : bool
        Whether other degrees of freedom follow its own by shapes of vibration, so that rigid motion does not show its
        mass.
    length_power : int
        Power of the element's length that they go with, where that may change.
    """

    codes: IntArray
    local: FloatArray
    power: int = 0
    whole: sparse.csc_array | None = None
    shear: ShearRatio | None = None
    powers: tuple[Power, ...] = ()
    matrix_kind: str = ""
    reduced: bool = False
    length_power: int = 0


@dataclass(frozen=True, eq=False)
class PropertyMatrices:
    """One property of an element set and the matrices that it weighs.

    Parameters
    ----------
    property : str
        Name, such as ``bending_stiffness``.
    kind : Kind
        See `Declared`.
    unit : str
        SI unit of the values.
    values : (n_elements,) float array
        Nominal values.
    matrix_terms : sequence of ElementMatrixTerm
        For unit value and the nominal thickness: of a shell, stretching and bending. None of a loss factor or
        thickness, which weigh other terms' matrices.
    limits : (float, float), optional
        Between which the values make sense; from 0 on by default.
    """

    property: str
    kind: Kind
    unit: str
    values: FloatArray
    matrix_terms: Sequence[ElementMatrixTerm] = ()
    limits: tuple[float, float] | None = None


#: The matrices that the properties of a set weigh, by the name of the property.
Matrices: TypeAlias = Mapping[str, Sequence[ElementMatrixTerm]]


@element
class ElementSet:
    """A named set of elements of one type.

    A type declares its arguments and properties as fields, and gives the `matrices` that the properties weigh.
    """

    #: Directions in which each of its nodes moves, where they are the same on any mesh.
    moves: ClassVar[tuple[str, ...]] = ()
    #: Whether its nodes move as those of other elements do: masses.
    follows: ClassVar[bool] = False
    #: Whether each element is straight between its two nodes, so that a joint may loosen its ends.
    is_line: ClassVar[bool] = False
    #: Stiffness over which each internal force makes the sections stretch or curve, by the name of the force.
    section_stiffness: ClassVar[Mapping[str, str]] = {}
    #: Types of its cells by number of nodes; none where its elements are no cells of a mesh.
    cells: ClassVar[Mapping[int, str]] = {}
    #: Symbol by which a drawing shows each element.
    symbol: ClassVar[Symbol] = "square"
    #: Whether its matrices say what it does; a set that has responses alone stands alone in a structure.
    has_matrices: ClassVar[bool] = True

    name: str = declared("Name of the set")
    nodes: Nodes = declared("Node labels, one row an element; -1 stands for the ground")
    tolerance: Tolerance = declared(
        "Standard deviation of what is held of its properties, in parts of each value: a number, or one for each property by"
        " name; by default that of the structure",
        stored=checked_tolerance,
        default=None,
        kw_only=True,
    )

    def __post_init__(self) -> None:
        """Convert and check each declared field: values of properties, limits, choices, tolerances.

        Raises `InputError`, which names the field and the set. An infinite value of a property without limit is stored
        as None.
        """
        types = declared_types(type(self))
        for name, declaration in declarations(self).items():
            value = getattr(self, name)
            if declaration.unlimited and isinstance(value, float) and value == np.inf:
                value = None
            if declaration.kind is not None and not (declaration.optional and value is None):
                is_signed = declaration.kind == "axial_force"
                value = property_values(self.name, name, value, len(self.nodes), declaration.positive, is_signed)
            problem = constraint_violation(types[name], value)
            if problem:
                raise InputError(f"`{name}` of {self.name!r} {problem}")
            if declaration.stored is not None and value is not None:
                value = declaration.stored(self.name, value)
            object.__setattr__(self, name, value)
        self._require_properties_of_tolerance()

    def __repr__(self) -> str:
        """Class, name, number of elements, and the value or range of each property that is not 0."""
        shown = [plural(len(self.nodes), "element")]
        for name, declaration in declarations(self).items():
            values = np.atleast_1d(getattr(self, name)) if declaration.kind is not None else np.zeros(0)
            if values.dtype.kind == "f" and values.any():
                unit = "" if declaration.unit in ("", "1") else f" {declaration.unit}"
                low, high = (f"{value:.5g}" for value in (values.min(), values.max()))
                shown.append(f"{name} {low if low == high else f'{low} to {high}'}{unit}")
        return f"<{type(self).__name__} {self.name!r}: {', '.join(shown)}>"

    @property
    def property_names(self) -> tuple[str, ...]:
        """Names of the properties that the set may have, as `property_matrices` gives them."""
        return tuple(name for name, what in declarations(self).items() if what.kind is not None)

    def _require_properties_of_tolerance(self) -> None:
        """Raise `InputError` if `tolerance` names something that is no property of the set, nor `length` of a line.

        A tolerance that is one number names none.
        """
        properties = (*self.property_names, *((LENGTH,) if self.is_line else ()))
        for name in self.tolerance if isinstance(self.tolerance, Mapping) else ():
            if name not in properties:
                raise InputError(
                    f"`tolerance` of {self.name!r} must name its properties, got {name!r}; they are {', '.join(properties)}"
                )

    @property
    def has_uncertain_length(self) -> bool:
        """True if a tolerance is stated of the lengths of its bars or beams, which are then a property of the set."""
        return self.is_line and isinstance(self.tolerance, Mapping) and self.tolerance.get(LENGTH, 0.0) > 0

    @property
    def loosened(self) -> tuple[str, Dof] | None:
        """The element, such as ``girder:1``, and the degree of freedom that the set releases; None except for joints.

        Matrices of a joint have code -1 in place of the released end.
        """
        return None

    def matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> Matrices:
        """Element matrices by the name of the property that multiplies them.

        `positions` of nodes in m; `used_codes` are the degrees of freedom that other elements use.
        """
        raise NotImplementedError

    def section_directions(self, positions: NodeCoordinates) -> Mapping[str, FloatArray]:
        """Unit vector of each internal force on the coordinates of a node, (n_elements, n_coordinates), by its name.

        Empty except for lines. Local x runs from the first node to the second; a force is that on the section whose
        normal is local x.
        """
        return {}

    def property_matrices(self, positions: NodeCoordinates, used_codes: IntArray) -> tuple[PropertyMatrices, ...]:
        """The properties of the set, in the order of their declaration, each with the matrices that it multiplies.

        Matrices are for a unit value of the property and the nominal thickness. Loss factor and thickness have none.
        Optional properties that are not stated are left out.

        Parameters
        ----------
        positions : mapping of node label to position in m
        used_codes : (n,) int array
            Codes (6 times the node plus 0 to 5 for X to RZ) of the degrees of freedom that the other elements use, but
            for those that follow others (masses, joints).
        """
        made = {
            name: self._at_nominal_thickness(matrix_terms)
            for name, matrix_terms in self.matrices(positions, used_codes).items()
        }
        properties = []
        for name, what in declarations(self).items():
            if what.kind in ("loss_factor", "thickness"):
                properties.append(PropertyMatrices(name, what.kind, self.unit(what), getattr(self, name)))
            elif what.kind is not None and (what.of or name) in made:
                limits = (-np.inf, np.inf) if what.kind == "axial_force" else None
                values, layers = getattr(self, name), made[what.of or name]
                properties.append(PropertyMatrices(name, what.kind, self.unit(what), values, layers, limits))
        return tuple(properties)

    def unit(self, what: Declared) -> str:
        """The unit of a property."""
        return what.unit

    def codes(self, positions: NodeCoordinates) -> IntArray:
        """Sorted codes (n_codes,) of the degrees of freedom that the set uses if no other elements are present.

        A code is 6 times the label of a node plus 0 to 5 for X, Y, Z, RX, RY, RZ. `positions` are node coordinates by
        label.
        """
        if self.moves:  # so that no matrices are made, which are dear on a mesh
            return joined_codes([node_codes(np.unique(self.nodes)[:, None], self.moves)])
        terms = self.property_matrices(positions, joined_codes([]))
        return joined_codes([matrix_term.codes for term in terms for matrix_term in term.matrix_terms])

    def _at_nominal_thickness(self, matrix_terms: Sequence[ElementMatrixTerm]) -> tuple[ElementMatrixTerm, ...]:
        """Copies of `matrix_terms` at the nominal thickness: each matrix times the power of the thickness it goes with.

        They are returned as they are if none goes with a power of a thickness.
        """
        if not any(matrix_term.power for matrix_term in matrix_terms):
            return tuple(matrix_terms)
        [name] = [name for name, what in declarations(self).items() if what.kind == "thickness"]
        thickness = getattr(self, name)[:, None, None]
        return tuple(
            ElementMatrixTerm(matrix_term.codes, matrix_term.local * thickness**matrix_term.power, matrix_term.power)
            for matrix_term in matrix_terms
        )


def dof_code(node: int, direction: str) -> int:
    """An integer for a node and a direction: 6 node + axis."""
    return 6 * node + DIRECTIONS.index(direction)


def dof_of_code(code: int) -> Dof:
    """The degree of freedom that `dof_code` numbered."""
    return Dof(int(code) // 6, DIRECTIONS[int(code) % 6])


def joined_codes(tables: Sequence[IntArray]) -> IntArray:
    """Sorted distinct codes of all `tables` of any shape, without -1, (n_codes,)."""
    codes: IntArray = np.unique(np.concatenate([np.zeros(0, np.int64), *(table.ravel() for table in tables)]))
    return codes[codes >= 0]


def node_codes(nodes: IntArray, directions: Sequence[str]) -> IntArray:
    """Codes of `directions` at each node of each element, (n_elements, n_nodes n_directions); -1 where a label is -1.

    `nodes` (n_elements, n_nodes) are labels. Codes go node by node, directions in their order within a node.
    """
    axes = np.array([DIRECTIONS.index(d) for d in directions])
    codes = np.where(nodes[:, :, None] >= 0, 6 * nodes[:, :, None] + axes, -1)
    return codes.reshape(len(nodes), -1)


def node_table(columns: int) -> Store:
    """A function that checks and stores node labels of elements with `columns` nodes each, as (n_elements, columns).

    It takes the name of the set, for errors, and the labels; a single element may be one row, and single nodes a flat
    list. It raises `InputError` unless there are `columns` whole numbers an element.
    """

    def stored(name: str, nodes: ArrayLike) -> IntArray:
        """Table of the node labels `nodes` of the set `name`, (n_elements, columns).

        Raises `InputError` unless there are `columns` whole numbers an element.
        """
        table = np.atleast_2d(np.asarray(nodes))
        if columns == 1 and table.shape[0] == 1 and table.shape[1] != 1:
            table = table.T
        if table.ndim != 2 or table.shape[1] != columns or table.size == 0:
            raise InputError(f"`nodes` of {name!r} must have {columns} labels an element, got shape {np.shape(nodes)}")
        if not np.issubdtype(table.dtype, np.integer):
            raise InputError(f"`nodes` of {name!r} must be whole numbers, got {np.asarray(nodes).tolist()}")
        return locked(table, np.int64)

    return stored


def property_values(
    element: str, name: str, values: ArrayLike, n_elements: int, positive: bool = False, signed: bool = False
) -> FloatArray:
    """`values` of the property `name` as one number for each element, (n_elements,); a single number holds for all.

    `element` is the name of the set, for errors. Raises `InputError` for text, a wrong number of values, values that
    are not finite, negative ones unless `signed`, and zeros if `positive`.
    """
    stated = np.asarray(values)
    if stated.dtype.kind in "USO" and any(isinstance(item, str | bytes) for item in stated.ravel()):
        raise InputError(
            f"`{name}` of {element!r} must be one number or {n_elements}, one for each element, got text: {values!r}"
        )
    try:
        array = np.broadcast_to(np.asarray(values, dtype=np.float64), (n_elements,))
    except ValueError as error:
        raise InputError(
            f"`{name}` of {element!r} must be one number or {n_elements}, one for each element, got shape {np.shape(values)}"
        ) from error
    if signed and not np.isfinite(array).all():
        raise InputError(f"`{name}` of {element!r} must be finite, got {array.tolist()}")
    if not np.isfinite(array).all() or (not signed and (array < 0).any()):
        raise InputError(f"`{name}` of {element!r} must be finite and at least 0, got {array.tolist()}")
    if positive and not array.all():
        raise InputError(f"`{name}` of {element!r} must be greater than 0, got {array.min():g}")
    return locked(array)


def element_vectors(name: str, nodes: IntArray, positions: NodeCoordinates) -> tuple[FloatArray, FloatArray]:
    """Lengths in m (n_elements,) and unit vectors (n_elements, n_dimensions) from first to second node.

    `nodes` (n_elements, 2 or more) are labels and `positions` theirs, m. Raises `InputError`, which names the set, if
    two ends coincide.
    """
    start = np.array([positions[int(n)] for n in nodes[:, 0]])
    end = np.array([positions[int(n)] for n in nodes[:, 1]])
    difference = end - start
    length = np.linalg.norm(difference, axis=1)
    if (length <= 0).any():
        e = int(np.argmin(length))
        raise InputError(f"element {e + 1} of {name!r} has no length: nodes {nodes[e, 0]} and {nodes[e, 1]} coincide")
    return length, difference / length[:, None]


def rotate_matrices(local: FloatArray, rotation: FloatArray) -> FloatArray:
    """R' B R for every element, with B = `local` (n, a, a) and R = `rotation` (n, a, b); the result is (n, b, b)."""
    return np.swapaxes(rotation, 1, 2) @ local @ rotation


#: Every element type by the name that a study file uses; its module loads at its first use.
ELEMENT_TYPES: LoadedByKey[type[ElementSet]] = LoadedByKey(
    {
        "bar": "structid.fem.elements.beam:Bar",
        "beam": "structid.fem.elements.beam:Beam",
        "dashpot": "structid.fem.elements.discrete:Dashpot",
        "friction": "structid.fem.elements.discrete:Friction",
        "joint": "structid.fem.elements.discrete:Joint",
        "membrane": "structid.fem.elements.elastic:Membrane",
        "plane": "structid.fem.elements.elastic:Plane",
        "plate": "structid.fem.elements.plate:Plate",
        "point_mass": "structid.fem.elements.discrete:PointMass",
        "rotary_inertia": "structid.fem.elements.discrete:RotaryInertia",
        "shell": "structid.fem.elements.shell:Shell",
        "solid": "structid.fem.elements.elastic:Solid",
        "space_beam": "structid.fem.elements.beam:SpaceBeam",
        "spring": "structid.fem.elements.discrete:Spring",
    }
)
