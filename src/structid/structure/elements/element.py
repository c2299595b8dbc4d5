"""What an element set tells the structure: its properties, and one matrix an element for each of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from structid.arrays import FloatArray, IntArray, locked
from structid.dof import DIRECTIONS, Dof
from structid.errors import InputError

Kind = Literal["mass", "rotary_inertia", "viscous_damping", "stiffness", "loss_factor", "friction", "thickness"]
Positions = Mapping[int, FloatArray]

TRANSLATIONS = DIRECTIONS[:3]


@dataclass(frozen=True, eq=False)
class Layer:
    """Matrices that a property weighs besides its first ones, with another power of the thickness.

    Parameters
    ----------
    codes : (n_elements, n_local) int array
    local : (n_elements, n_local, n_local) float array
        At unit value and nominal thickness.
    thickness_power : int
    """

    codes: IntArray
    local: FloatArray
    thickness_power: int


@dataclass(frozen=True, eq=False)
class Term:
    """One property of an element set and the matrices that it weighs.

    Parameters
    ----------
    property : str
        Name, such as ``bending_stiffness``.
    kind : Kind
        Physical kind; it fixes how the term enters the dynamic stiffness: ``mass`` and ``rotary_inertia`` by
        -omega^2, ``viscous_damping`` by i omega, ``stiffness`` by 1, ``loss_factor`` by i times the element's stiffness.
    unit : str
        SI unit of the values.
    values : (n_elements,) float array
        Nominal values.
    codes : (n_elements, n_local) int array, optional
        Degree of freedom codes, see `dof_code`; -1 where a row is not used. None for a loss factor or thickness, which
        weigh other terms' matrices.
    local : (n_elements, n_local, n_local) float array, optional
        Element matrices at unit value.
    matrices : tuple of sparse arrays, optional
        Whole matrices instead of small ones; rows follow `codes[0]`.
    thickness_power : int
        Power of the element's thickness that the matrices go with; they hold the nominal thickness. A set with such a
        term has one of kind ``thickness``, in m, without matrices.
    besides : tuple of Layer
        Further matrices that the same values weigh: of a shell, bending besides stretching.
    """

    property: str
    kind: Kind
    unit: str
    values: FloatArray
    codes: IntArray | None = None
    local: FloatArray | None = None
    matrices: tuple[sparse.csc_array, ...] | None = None
    thickness_power: int = 0
    besides: tuple[Layer, ...] = ()


class ElementSet(Protocol):
    """A named set of elements of one type."""

    @property
    def name(self) -> str: ...

    @property
    def nodes(self) -> IntArray:
        """Node labels, (n_elements, nodes of an element); -1 stands for the ground."""
        ...

    def terms(self, positions: Positions, present: frozenset[int]) -> tuple[Term, ...]:
        """Properties with their matrices.

        Parameters
        ----------
        positions : mapping of node label to position in m
        present : frozenset of int
            Codes of the degrees of freedom that elements other than inertias use.
        """
        ...


def layers_of(term: Term) -> tuple[Term, ...]:
    """One term for each power of the thickness, without `besides`."""
    others = (
        replace(term, codes=x.codes, local=x.local, thickness_power=x.thickness_power, besides=()) for x in term.besides
    )
    return (replace(term, besides=()), *others) if term.besides else (term,)


def dof_code(node: int, direction: str) -> int:
    """An integer for a node and a direction: 6 node + axis."""
    return 6 * node + DIRECTIONS.index(direction)


def dof_of_code(code: int) -> Dof:
    """The degree of freedom that `dof_code` numbered."""
    return Dof(int(code) // 6, DIRECTIONS[int(code) % 6])


def node_codes(nodes: IntArray, directions: tuple[str, ...]) -> IntArray:
    """Codes of all `directions` at each node of each element, node by node, (n_elements, n_nodes n_directions)."""
    axes = np.array([DIRECTIONS.index(d) for d in directions])
    return (6 * nodes[:, :, None] + axes).reshape(nodes.shape[0], -1)


def node_table(name: str, nodes: ArrayLike, columns: int) -> IntArray:
    """`nodes` as a locked (n_elements, columns) integer array; a single element may be given as one row."""
    table = np.atleast_2d(np.asarray(nodes))
    if columns == 1 and table.shape[0] == 1 and table.shape[1] != 1:
        table = table.T
    if table.ndim != 2 or table.shape[1] != columns or table.size == 0:
        raise InputError(f"`nodes` of {name!r} must have {columns} labels an element, got shape {np.shape(nodes)}")
    if not np.issubdtype(table.dtype, np.integer):
        raise InputError(f"`nodes` of {name!r} must be whole numbers, got {np.asarray(nodes).tolist()}")
    return locked(table, np.int64)


def property_values(element: str, name: str, values: ArrayLike, n_elements: int, minimum: float = 0.0) -> FloatArray:
    """`values` as one number an element; a single number stands for all of them."""
    try:
        array = np.broadcast_to(np.asarray(values, dtype=np.float64), (n_elements,))
    except ValueError as error:
        raise InputError(
            f"`{name}` of {element!r} must be one number or {n_elements}, got shape {np.shape(values)}"
        ) from error
    if not np.isfinite(array).all() or (array < minimum).any():
        raise InputError(f"`{name}` of {element!r} must be finite and at least {minimum:g}, got {array.tolist()}")
    return locked(array)


def store_element_set(element: Any, name: str, nodes: ArrayLike, columns: int, **properties: ArrayLike) -> None:
    """Store name, node table and properties, one number an element, in a frozen element set, all of them checked."""
    table = node_table(name, nodes, columns)
    checked = {key: property_values(name, key, value, len(table)) for key, value in properties.items()}
    set_fields(element, name=name, nodes=table, **checked)


def set_fields(element: Any, **values: Any) -> None:
    """Store checked values in a frozen element."""
    for name, value in values.items():
        object.__setattr__(element, name, value)


def element_vectors(name: str, nodes: IntArray, positions: Positions) -> tuple[FloatArray, FloatArray]:
    """Lengths (n_elements,) and unit vectors (n_elements, n_dimensions) of two-node elements."""
    start = np.array([positions[int(n)] for n in nodes[:, 0]])
    end = np.array([positions[int(n)] for n in nodes[:, 1]])
    difference = end - start
    length = np.linalg.norm(difference, axis=1)
    if (length <= 0).any():
        e = int(np.argmin(length))
        raise InputError(f"element {e + 1} of {name!r} has no length: nodes {nodes[e, 0]} and {nodes[e, 1]} coincide")
    return length, difference / length[:, None]


def rotated(local: FloatArray, rotation: FloatArray) -> FloatArray:
    """rotation' local rotation for every element: (n, a, a) and (n, a, b) to (n, b, b)."""
    return np.swapaxes(rotation, 1, 2) @ local @ rotation
