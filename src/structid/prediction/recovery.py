"""Internal forces and stresses of elements as functions of the motion of a structure: stress recovery."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, TypeAlias

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray
from structid.core.dof import Dof, is_whole_number, parse_dof
from structid.core.errors import InputError
from structid.fem import Structure
from structid.fem.blocks import Blocks
from structid.fem.contribution import Contribution
from structid.fem.elements import ElementSet
from structid.fem.elements.elastic import plane_elasticity
from structid.fem.elements.element import node_codes
from structid.fem.elements.plate import ThinSet

_TEXT = re.compile(
    r"^(?P<what>[A-Za-z_]+)\[(?P<set>[^\]@]+?)(?::(?P<number>\d+))?@(?P<where>\w+)(?P<rest>(?:\s+\w+\s*=\s*[^\s=\]]+)*)\s*\]$"
)
_PAIR = re.compile(r"(\w+)\s*=\s*([^\s=\]]+)")
_FORCES = ("N", "V", "VY", "VZ", "T", "M", "MY", "MZ")
_SURFACES = {"top": 0.5, "middle": 0.0, "bottom": -0.5}
#: Components of stress, which are linear in the loads, and what is not.
_LINEAR_STRESSES = ("stress_xx", "stress_yy", "stress_xy")
_STRESSES = (*_LINEAR_STRESSES, "von_mises")
#: Matrices that make up the force at the end of an element, by the derivative of motion that they multiply.
_MATRICES = ("stiffness", "damping", "mass")
#: von Mises stress squared is s' A s of the stresses xx, yy and xy.
VON_MISES = np.array([[1.0, -0.5, 0.0], [-0.5, 1.0, 0.0], [0.0, 0.0, 3.0]])
_EXAMPLES = "M[deck:3@12], stress[deck:3@12 y=0.05 E=2.1e11] or von_mises[plate:17@top]"


@dataclass(frozen=True)
class _Term:
    """A `column` (n_free,) over the degrees of freedom, for a `derivative` of displacement in time (0, 1 or 2).

    Its `weight` is a function of the property values (n_values,).
    """

    derivative: int
    column: FloatArray
    weight: Callable[[FloatArray], float]


class ElementOutput(Protocol):
    """Something that is read from an element: an internal force, a strain or a stress."""

    @property
    def unit(self) -> str:
        """SI unit."""
        ...

    def terms(self, structure: Structure) -> list[list[_Term]]:
        """Sums of weighted columns over the free degrees of freedom: one, or the three components of a von Mises stress."""
        ...


#: A degree of freedom whose motion is read, or what is read from an element.
Output: TypeAlias = Dof | ElementOutput


@dataclass(frozen=True)
class SectionForce:
    """Internal force at an end of a bar or beam, N or N m, on the section whose normal runs from its first node to its second.

    It is what the element's matrices make of its motion: stiffness, viscous damping and inertia, so that forces at a node are in
    balance. Without what loss factors and modal damping add. Loads act at nodes.

    Parameters
    ----------
    name : str
        Element set.
    number : int or None
        Number of the element in the set, from 1; None in a set of one element.
    node : int
        At which end.
    component : {"N", "V", "M", "VY", "VZ", "T", "MY", "MZ"}
        Axial force (tension positive), shear force and moment of beams in a plane; of beams in space about their local axes.
    """

    name: str
    number: int | None
    node: int
    component: str

    def __str__(self) -> str:
        return f"{self.component}[{_element_words(self.name, self.number)}@{self.node}]"

    @property
    def unit(self) -> str:
        """N, or N m of moments."""
        return "N m" if self.component[0] in "MT" else "N"

    def terms(self, structure: Structure) -> list[list[_Term]]:
        """Force at the end of the element as one sum of terms: column over free degrees of freedom, weight, order.

        Terms of stiffness act on displacements (order 0), of damping on velocities (1) and of mass on accelerations
        (2).

        Raises
        ------
        InputError
            If the set, element, node or component does not exist.
        """
        element, row = _element_of(structure, self.name, self.number, str(self))
        directions = element.section_directions(structure.nodes)
        if not directions:
            raise InputError(
                f"{self}: {self.name!r} is no set of bars or beams, which have internal forces at their ends;"
                f" of {type(element).__name__.lower()} elements {_offered(element)}"
            )
        if self.component not in directions:
            raise InputError(f"{self}: elements of {self.name!r} have {', '.join(directions)}, not {self.component}")
        end = _end_of(element, row, self.node, str(self))
        direction = directions[self.component][row] * (-1.0, 1.0)[end]
        to_free = structure.numbering.matrix
        terms = []
        for part in structure.element_contributions(self.name):
            if part.matrix_kind not in _MATRICES:
                continue
            blocks = part.blocks
            assert isinstance(blocks, Blocks)  # of lines all matrices are
            ends = slice(None, len(direction)) if end == 0 else slice(-len(direction), None)
            force = direction @ blocks.local[row][ends]
            if force.any():
                column = _over_free(to_free, blocks.dofs[row], force)
                terms.append(_Term(_MATRICES.index(part.matrix_kind), column, partial(_element_weight, part, row)))
        return [terms]


@dataclass(frozen=True)
class FibreStress:
    """Axial stress, Pa, or strain of a fibre at an end of a bar or beam: E (N / EA - y M_z / EI_z + z M_y / EI_y).

    Parameters
    ----------
    name, number, node
        See `SectionForce`.
    y, z : float
        Distance of the fibre from the neutral axis along the local axes, m. In a plane y is 90 degrees counter-clockwise from the
        line of the beam.
    youngs_modulus : float, optional
        E, Pa, which a beam of EA and EI does not say; it is taken as exact. Without it the output is the strain.
    """

    name: str
    number: int | None
    node: int
    y: float = 0.0
    z: float = 0.0
    youngs_modulus: float | None = None

    def __post_init__(self) -> None:
        """Raise `InputError` if `y`, `z` or the modulus is not finite, or the modulus not positive; None asks for a strain."""
        if not np.isfinite([self.y, self.z]).all():
            raise InputError(f"`y` and `z` of {self} must be finite, got {self.y:g} and {self.z:g}")
        if self.youngs_modulus is not None and not (np.isfinite(self.youngs_modulus) and self.youngs_modulus > 0):
            raise InputError(f"`E` of {self} must be greater than 0 Pa, got {self.youngs_modulus:g}")

    def __str__(self) -> str:
        """Text that `parse_output` reads, as ``stress[deck:3@12 y=0.05 E=2.1e+11]``; y and z of 0 are left out."""
        values = (("y", self.y), ("z", self.z), ("E", self.youngs_modulus))
        rest = "".join(f" {key}={value:g}" for key, value in values if value)
        what = "strain" if self.youngs_modulus is None else "stress"
        return f"{what}[{_element_words(self.name, self.number)}@{self.node}{rest}]"

    @property
    def unit(self) -> str:
        """Pa, or 1 of a strain."""
        return "1" if self.youngs_modulus is None else "Pa"

    def terms(self, structure: Structure) -> list[list[_Term]]:
        """Stress or strain of the fibre as one sum of terms: column over free degrees of freedom, weight, order.

        Axial force and bending moments at the end are divided by the stiffness of the section, and multiplied by
        Young's modulus for a stress.

        Raises
        ------
        InputError
            If the set, element or node does not exist, or the element cannot bend that way or carries no such force.
        """
        element, row = _element_of(structure, self.name, self.number, str(self))
        directions = element.section_directions(structure.nodes)
        levers = {"N": 1.0, "M": -self.y, "MZ": -self.y, "MY": self.z}
        bending = [component for component in ("M", "MY", "MZ") if component in directions]
        if not directions:
            raise InputError(f"{self}: {self.name!r} is no set of bars or beams; {_offered(element)}")
        if (self.y and not bending) or (self.z and "MY" not in directions):
            what = "do not bend" if not bending else "bend along y alone"
            raise InputError(f"{self}: elements of {self.name!r} {what}; leave {'z' if bending else 'y and z'} out")
        _end_of(element, row, self.node, str(self))
        terms = []
        for component, label in element.section_stiffness.items():
            lever = levers.get(component, 0.0) * (self.youngs_modulus or 1.0)
            if not lever or component not in directions:
                continue
            index = next(
                item.values.start + row
                for item in structure.properties
                if item.element == self.name and item.term.property == label
            )
            [forces] = SectionForce(self.name, self.number, self.node, component).terms(structure)
            terms += [
                _Term(each.derivative, lever * each.column, partial(_over_stiffness, each.weight, index))
                for each in forces
            ]
        if not terms:
            what = "strain" if self.youngs_modulus is None else "stress"
            raise InputError(f"{self}: give y: at the neutral axis the {what} is 0, since {self.name!r} carries no N")
        return [terms]


@dataclass(frozen=True)
class CellStress:
    """Stress at the centre of a plate or shell element, Pa, at its top, middle or bottom.

    It is the elastic stress of the strains there. In a plate x and y are the global axes; in a shell x is the part of global X in
    the plane of the element (of global Y where X is its normal). The top lies along the normal: +Z of a plate; of a shell the
    side from which its nodes run counter-clockwise.

    Parameters
    ----------
    name, number
        See `SectionForce`.
    surface : {"top", "middle", "bottom"}
    component : {"stress_xx", "stress_yy", "stress_xy", "von_mises"}
    """

    name: str
    number: int | None
    surface: str
    component: str

    def __str__(self) -> str:
        return f"{self.component}[{_element_words(self.name, self.number)}@{self.surface}]"

    @property
    def unit(self) -> str:
        """Pa."""
        return "Pa"

    def terms(self, structure: Structure) -> list[list[_Term]]:
        """Stress at the centre of the cell as sums of weighted columns over the free degrees of freedom.

        There is one sum for a component, and three (xx, yy, xy) for a von Mises stress.

        Raises
        ------
        InputError
            If the set is no plate or shell, or the element, surface or component does not exist.
        """
        element, row = _element_of(structure, self.name, self.number, str(self))
        if not isinstance(element, ThinSet):
            raise InputError(f"{self}: {self.name!r} is no set of plates or shells; {_offered(element)}")
        if self.surface not in _SURFACES:
            raise InputError(f"{self}: the surface must be top, middle or bottom, got {self.surface!r}")
        if self.component not in _STRESSES:
            raise InputError(f"{self}: plates and shells have {', '.join(_STRESSES)}, not {self.component}")
        strains = element.centre_strains(structure.nodes, row)
        codes = node_codes(element.nodes[[row]], element.moves)[0]
        codes = codes[codes >= 0]
        positions = np.searchsorted(structure.numbering.codes, codes)
        values = {
            item.term.property: item.values.start + row for item in structure.properties if item.element == self.name
        }
        modulus, thickness = values["youngs_modulus"], values["thickness"]
        height = _SURFACES[self.surface]
        elasticity = plane_elasticity(element.poisson, strain=False)
        to_free = structure.numbering.matrix
        rows = range(3) if self.component == "von_mises" else [_STRESSES.index(self.component)]
        found = []
        for component in rows:
            membrane, curvature = (_over_free(to_free, positions, elasticity[component] @ each) for each in strains)
            terms = [_Term(0, membrane, lambda v: float(v[modulus]))] if membrane.any() else []
            if height:
                terms.append(_Term(0, height * curvature, lambda v: float(v[modulus] * v[thickness])))
            found.append(terms)
        return found


def parse_output(text: str | Output) -> Output:
    """A degree of freedom, `12Y`, or what is read from an element: `M[deck:3@12]`.

    Forces at the ends of bars and beams are ``N[set:number@node]``, and so are V and M (in a plane), VY, VZ, T, MY and MZ (in
    space). ``strain[deck:3@12 y=0.05]`` is that of a fibre, ``stress[deck:3@12 y=0.05 E=2.1e11]`` its stress. Plates and shells
    have ``stress_xx``, ``stress_yy``, ``stress_xy`` and ``von_mises`` at ``@top``, ``@middle`` or ``@bottom``. The number may be
    left out of a set of one element.

    Raises
    ------
    InputError
        If `text` is none of these.

    Examples
    --------
    >>> parse_output("M[deck:3@12]")
    SectionForce(name='deck', number=3, node=12, component='M')
    """
    if not isinstance(text, str) or "[" not in text:
        return parse_dof(text) if isinstance(text, str) else text
    match = _TEXT.match(text.strip())
    if match is None:
        raise InputError(f"cannot read {text!r} as an output of an element; write {_EXAMPLES}")
    what, name, where = match["what"], match["set"].strip(), match["where"]
    number, options = int(match["number"]) if match["number"] else None, _numbers(text, match["rest"])
    allowed = {"stress": ("y", "z", "E"), "strain": ("y", "z")}.get(what, ())
    unknown = next((key for key in options if key not in allowed), None)
    if unknown is not None:
        raise InputError(f"{text}: {what} takes {' and '.join(allowed) or 'no numbers'}, got {unknown}")
    if what in _STRESSES:
        return CellStress(name, number, where, what)
    if what not in (*_FORCES, "stress", "strain"):
        raise InputError(
            f"{text}: elements have {', '.join((*_FORCES, 'strain', 'stress', *_STRESSES))}, got {what}; write {_EXAMPLES}"
        )
    if not is_whole_number(where):
        surfaces = ", or stress_xx, stress_yy, stress_xy or von_mises" if where in _SURFACES else ""
        raise InputError(
            f"{text}: {what} is at a node, as in {what}[{_element_words(name, number)}@12]{surfaces}; got {where!r}"
        )
    if what in _FORCES:
        return SectionForce(name, number, int(where), what)
    if what == "stress" and "E" not in options:
        raise InputError(f"{text}: a stress needs Young's modulus E, Pa, as in E=2.1e11; without it ask for the strain")
    return FibreStress(name, number, int(where), options.get("y", 0.0), options.get("z", 0.0), options.get("E"))


def parse_outputs(texts: Sequence[str | Output]) -> tuple[Output, ...]:
    """Outputs named by `texts`, each read by `parse_output`; a single text is a list of one."""
    return tuple(parse_output(text) for text in ([texts] if isinstance(texts, str) else texts))


def distinct_channels(name: str, channels: tuple[Any, ...]) -> tuple[Any, ...]:
    """`channels` unchanged; `InputError` if the tuple is empty or has duplicates. `name` is the argument in errors."""
    if not channels:
        raise InputError(f"`{name}` must name at least one channel, got none")
    for number, channel in enumerate(channels):
        if channel in channels[:number]:
            raise InputError(f"`{name}` names {channel} twice; leave one out")
    return channels


def is_von_mises(output: Output) -> bool:
    """True if an output is a von Mises stress, which is not linear in the loads."""
    return isinstance(output, CellStress) and output.component == "von_mises"


def output_unit(output: Output) -> str:
    """SI unit of what is read from an element; "" of a motion, whose unit its derivative says."""
    return "" if isinstance(output, Dof) else output.unit


def _numbers(text: str, numbers_text: str) -> dict[str, float]:
    """Numbers in `numbers_text`, such as y=0.05, by name; `text`, the whole output, is for errors.

    `InputError` if one is no number.
    """
    numbers: dict[str, float] = {}
    for key, value in _PAIR.findall(numbers_text):
        try:
            numbers[key] = float(value)
        except ValueError as error:
            raise InputError(f"{text}: {key} must be a number, got {value!r}") from error
    return numbers


@dataclass(frozen=True, eq=False)
class OutputMap:
    """Outputs as weighted sums of columns over displacements, velocities and accelerations; made by `output_map`.

    Attributes
    ----------
    columns : (n_dofs, n_terms) sparse array
    row : (n_terms,) int array
        Which row of the outputs each term adds to.
    derivative : (n_terms,) int array
        0 to 2: of which derivative of the motion.
    weights : tuple of callable
        Weight of each term as a function of the property values.
    first : (n_outputs + 1,) int array
        At which row each output begins; a von Mises stress has three.
    is_motion : (n_rows,) bool array
        Whether a row reads a degree of freedom.
    """

    columns: sparse.csc_array
    row: IntArray
    derivative: IntArray
    weights: tuple[Callable[[FloatArray], float], ...]
    first: IntArray
    is_motion: np.ndarray

    @property
    def n_rows(self) -> int:
        return int(self.first[-1])

    @property
    def is_linear(self) -> bool:
        """True if no output is a von Mises stress."""
        return self.n_rows == len(self.first) - 1

    @property
    def orders(self) -> tuple[int, ...]:
        """Derivatives of displacement in time that are read (0, 1 or 2), each once, rising."""
        return tuple(sorted(set(self.derivative.tolist())))

    def rows(self, values: FloatArray) -> sparse.csc_array:
        """Weights of the rows over the degrees of freedom, (n_dofs, n_orders * n_rows), sparse.

        Columns stand in groups, one for each derivative of motion that occurs (`orders`, rising), the rows in each.
        `values` (n_values,) are the property values.
        """
        weights = np.array([weight(values) for weight in self.weights])
        terms, group = np.arange(len(weights)), np.searchsorted(self.orders, self.derivative)
        shape = len(terms), len(self.orders) * self.n_rows
        spread = sparse.coo_array((weights, (terms, group * self.n_rows + self.row)), shape)
        return sparse.csc_array(self.columns @ spread.tocsc())

    def joined(self, values: FloatArray) -> FloatArray:
        """Outputs (..., n_outputs) from `values` (..., n_rows): three rows of stress components become one von Mises stress."""
        if self.is_linear:
            return values
        parts = [values[..., a:b] for a, b in zip(self.first[:-1], self.first[1:], strict=True)]
        joined = [
            np.sqrt(np.einsum("...i,ij,...j->...", each, VON_MISES, each)) if each.shape[-1] == 3 else each[..., 0]
            for each in parts
        ]
        return np.stack(joined, axis=-1)

    def powers(self, frf: np.ndarray) -> FloatArray:
        """Mean square of each output per mean square of each load, (n_frequencies, n_outputs, n_inputs).

        `frf` (n_frequencies, n_rows, n_inputs) are FRFs of the rows. Of a von Mises stress it is the mean of its square, a
        weighted sum of spectra and cross-spectra of its components: Segalman, Fulcher, Reese and Field (2000), J. Sound Vib.
        230, 393-410.
        """
        parts = [frf[:, a:b] for a, b in zip(self.first[:-1], self.first[1:], strict=True)]
        squares = [
            np.einsum("fai,ab,fbi->fi", np.conj(each), VON_MISES, each).real
            if each.shape[1] == 3
            else np.abs(each[:, 0]) ** 2
            for each in parts
        ]
        return np.stack(squares, axis=1)


def output_map(structure: Structure, outputs: Sequence[Output], derivative: int) -> OutputMap:
    """Outputs of a structure as sums over its free degrees of freedom.

    Parameters
    ----------
    structure : Structure
    outputs : sequence of Dof or ElementOutput
    derivative : {0, 1, 2}
        Of the motions that are read: displacement, velocity or acceleration. Forces and stresses have their own.

    Returns
    -------
    OutputMap
        Rows of weighted columns, one for each output, three for a von Mises stress.

    Raises
    ------
    InputError
        If an output is not part of the structure.
    """
    terms: list[_Term] = []
    rows: list[int] = []
    first, is_motion = [0], []
    for output in outputs:
        if isinstance(output, Dof):
            column = structure.selection([output]).toarray()[:, 0]
            parts = [[_Term(derivative, column, lambda values: 1.0)]]
        else:
            parts = output.terms(structure)
        for row, part in enumerate(parts, first[-1]):
            terms += part
            rows += [row] * len(part)
            is_motion.append(isinstance(output, Dof))
        first.append(first[-1] + len(parts))
    columns = np.array([term.column for term in terms]).reshape(-1, structure.n_dofs)
    return OutputMap(
        sparse.csc_array(columns.T),
        np.array(rows, dtype=np.int64),
        np.array([term.derivative for term in terms], dtype=np.int64),
        tuple(term.weight for term in terms),
        np.array(first),
        np.array(is_motion, dtype=bool),
    )


def _element_weight(part: Contribution, row: int, values: FloatArray) -> float:
    """Factor on the matrix of the element at index `row` of `part` at the property `values` (n_values,)."""
    return float(part.weights(values)[row])


def _over_stiffness(weight: Callable[[FloatArray], float], index: int, values: FloatArray) -> float:
    """`weight` of the property `values` over the stiffness, their entry `index`; 0 unless that is positive.

    `values` are (n_values,).
    """
    return weight(values) / float(values[index]) if values[index] > 0 else 0.0


def _over_free(to_free: sparse.csr_array, positions: IntArray, row: FloatArray) -> FloatArray:
    """A `row` (n,) over the degrees of freedom at `positions` (n,), -1 for none, as one over the free ones, (n_free,).

    `to_free` is sparse, (n_all, n_free): how each degree of freedom follows the free ones.
    """
    kept = positions >= 0
    return np.asarray(to_free[positions[kept], :].T @ row[kept])


def _element_words(name: str, number: int | None) -> str:
    """Element set and number as outputs are written: ``deck:3``, or ``deck`` without a number."""
    return name if number is None else f"{name}:{number}"


def _element_of(structure: Structure, name: str, number: int | None, text: str) -> tuple[ElementSet, int]:
    """Element set called `name`, and the row (from 0) of its element `number` (from 1); `text` is the output in errors.

    `InputError` if the structure has no such set or element, it is part of a component, or no number is given for a set
    of several elements.
    """
    for component in structure.components:
        if name in component.elements:
            raise InputError(
                f"{text}: {name!r} is part of component {component.name!r}, which is reduced to its interface and a few modes;"
                " take the component out of the study to see into it"
            )
    element = next((each for each in structure.elements if each.name == name), None)
    if element is None:
        near = difflib.get_close_matches(name, [each.name for each in structure.elements], 1, 0.0)
        raise InputError(f"{text}: the structure has no element set {name!r}; the nearest is {near[0]!r}")
    if number is None and len(element.nodes) > 1:
        first = text.replace(f"[{name}@", f"[{name}:1@", 1)
        raise InputError(
            f"{text}: {name!r} has elements 1 to {len(element.nodes)}; write the number of the one, such as {first}"
        )
    number = 1 if number is None else number
    if not 1 <= number <= len(element.nodes):
        raise InputError(f"{text}: {name!r} has elements 1 to {len(element.nodes)}, got {number}")
    return element, number - 1


def _end_of(element: ElementSet, row: int, node: int, text: str) -> int:
    """End of the element in `row` of its set that is at `node`: 0 for the first, 1 for the second.

    `InputError` if neither is; `text` is the output in errors.
    """
    ends = element.nodes[row].tolist()
    if node not in ends:
        raise InputError(f"{text}: the element runs from node {ends[0]} to {ends[1]}, got {node}")
    return ends.index(node)


def linear_element_outputs(structure: Structure) -> Iterator[str]:
    """Yield names of element outputs that are linear in the loads, such as ``M[deck:3@12]`` or ``stress_xx[plate:17@top]``.

    Forces and strains at nodes of bars and beams, stresses at top and bottom of plates and shells. In brackets: element set,
    element (counted from 1), and node or surface.
    """
    outer = [surface for surface, height in _SURFACES.items() if height]
    for element in structure.elements:
        if isinstance(element, ThinSet):
            for row in range(1, len(element.nodes) + 1):
                yield from (f"{what}[{element.name}:{row}@{surface}]" for surface in outer for what in _LINEAR_STRESSES)
            continue
        forces = element.section_directions(structure.nodes)
        names = (*forces, *(("strain",) if "N" in forces else ()))  # without an axial force the axis has no strain
        for row, nodes in enumerate(element.nodes.tolist() if names else (), 1):
            for what in names:
                yield from (f"{what}[{element.name}:{row}@{node}]" for node in nodes)


def _offered(element: ElementSet) -> str:
    """Words for error messages on the stresses and forces that can be read from elements of this type."""
    if isinstance(element, ThinSet):
        return "stress_xx, stress_yy, stress_xy and von_mises at top, middle and bottom can be predicted"
    if element.section_stiffness:
        return f"{', '.join(element.section_stiffness)}, strain and stress at their ends can be predicted"
    return "neither forces nor stresses can be predicted"
