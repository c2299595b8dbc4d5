"""Element sets of cells: their positions, types by number of nodes, and matrices of mixed types in one set."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from structid.arrays import FloatArray, IntArray, locked
from structid.dof import DIRECTIONS
from structid.errors import InputError
from structid.structure.elements.element import Layer, Positions, Term, property_values, set_fields

#: Matrices of cells of one type from labels, positions and the cell type.
CellMatrices = Callable[[IntArray, FloatArray, str], FloatArray]


def store_cells(
    element: Any, name: str, nodes: ArrayLike, cells: Mapping[int, str], poisson: float, **properties: ArrayLike
) -> None:
    """Store name, node table, Poisson's ratio and properties in a frozen element set, all of them checked.

    Rows of `nodes` may end in -1 where a set mixes cell types.
    """
    table = np.atleast_2d(np.asarray(nodes))
    if table.ndim != 2 or table.size == 0 or not np.issubdtype(table.dtype, np.integer):
        raise InputError(f"`nodes` of {name!r} must be a table of whole numbers, got shape {table.shape}")
    counts = (table >= 0).sum(axis=1)
    odd = ~np.isin(counts, list(cells))
    if odd.any():
        e = int(np.argmax(odd))
        known = ", ".join(f"{count} ({kind})" for count, kind in cells.items())
        raise InputError(f"element {e + 1} of {name!r} has {counts[e]} nodes; it can have {known}; mesh with these")
    if not -1 < poisson < 0.5:
        raise InputError(f"`poisson` of {name!r} must lie between -1 and 0.5, got {poisson:g}")
    checked = {key: property_values(name, key, value, len(table)) for key, value in properties.items()}
    if "thickness" in checked and (checked["thickness"] <= 0).any():
        raise InputError(f"`thickness` of {name!r} must be greater than 0, got {checked['thickness'].min():g}")
    set_fields(element, name=name, nodes=locked(table, np.int64), poisson=float(poisson), **checked)


def cell_positions(name: str, nodes: IntArray, positions: Positions, dimensions: int) -> FloatArray:
    """Positions of the cells' nodes along the first axes, (n_cells, n_nodes, dimensions); zeros where a row has ended."""
    size = len(next(iter(positions.values())))
    if size < dimensions:
        raise InputError(f"{name!r} needs {dimensions}-D nodes, got positions with {size} coordinates")
    labels, place = np.unique(nodes, return_inverse=True)
    table = np.array([positions[int(label)] if label >= 0 else np.zeros(size) for label in labels])
    found = table[place.reshape(nodes.shape)]
    if size > dimensions:
        _require_flat(name, nodes, found)
    flat: FloatArray = found[..., :dimensions]
    return flat


def _require_flat(name: str, nodes: IntArray, found: FloatArray) -> None:
    """Raise `InputError` at a plane cell that is not parallel to the x-y plane."""
    used = nodes >= 0
    high = np.where(used, found[..., 2], -np.inf).max(axis=1)
    low = np.where(used, found[..., 2], np.inf).min(axis=1)
    middle = found[:, :1, :2]
    span = np.where(used, np.linalg.norm(found[..., :2] - middle, axis=2), 0.0).max(axis=1)
    tilted = high - low > 1e-9 * span
    if tilted.any():
        e = int(np.argmax(tilted))
        labels = ", ".join(map(str, nodes[e][used[e]]))
        raise InputError(
            f"element {e + 1} of {name!r} is not parallel to the x-y plane: nodes {labels} have z from {low[e]:g} to"
            f" {high[e]:g}; turn the model so that it lies in x-y, or make it a shell"
        )


def cell_matrices(
    nodes: IntArray, positions: FloatArray, cells: Mapping[int, str], per_node: int, made: CellMatrices
) -> FloatArray:
    """Matrices of all cells, (n_cells, n_local, n_local), those of smaller cells padded with zeros."""
    counts = (nodes >= 0).sum(axis=1)
    size = per_node * nodes.shape[1]
    total = np.zeros((len(nodes), size, size))
    for count in np.unique(counts):
        rows, n = np.flatnonzero(counts == count), per_node * int(count)
        total[rows, :n, :n] = made(nodes[rows, :count], positions[rows, :count], cells[int(count)])
    return total


def cell_codes(nodes: IntArray, directions: tuple[str, ...]) -> IntArray:
    """Codes of all `directions` at each node of each cell, node by node; -1 where a row has ended."""
    axes = np.array([DIRECTIONS.index(d) for d in directions])
    codes = np.where(nodes[:, :, None] >= 0, 6 * nodes[:, :, None] + axes, -1)
    return codes.reshape(len(nodes), -1)


def elastic_terms(
    element: Any,
    codes: IntArray,
    mass: FloatArray,
    stiffness: FloatArray,
    powers: tuple[int, int],
    damping_unit: str,
    mass_besides: tuple[Layer, ...] = (),
    stiffness_besides: tuple[Layer, ...] = (),
) -> tuple[Term, ...]:
    """Properties of an elastic element set with the matrices that they weigh.

    Parameters
    ----------
    element : element set
        With `density`, `youngs_modulus`, `loss_factor`, `mass_damping`, `stiffness_damping`, and `thickness` if any.
    codes : (n_cells, n_local) int array
    mass, stiffness : (n_cells, n_local, n_local) float arrays
        For unit density and unit Young's modulus.
    powers : (int, int)
        Powers of the thickness that mass and stiffness go with.
    damping_unit : str
        Unit of `mass_damping`.
    mass_besides, stiffness_besides : tuples of Layer
        What goes with other powers of the thickness.
    """
    heavy, stiff = powers
    light, weak = mass_besides, stiffness_besides
    terms = [
        Term("density", "mass", "kg/m^3", element.density, codes, mass, None, heavy, light),
        Term("youngs_modulus", "stiffness", "Pa", element.youngs_modulus, codes, stiffness, None, stiff, weak),
        Term("loss_factor", "loss_factor", "1", element.loss_factor),
        Term("mass_damping", "viscous_damping", damping_unit, element.mass_damping, codes, mass, None, heavy, light),
        Term(
            "stiffness_damping",
            "viscous_damping",
            "Pa s",
            element.stiffness_damping,
            codes,
            stiffness,
            None,
            stiff,
            weak,
        ),
    ]
    if any(powers):
        terms.append(Term("thickness", "thickness", "m", element.thickness))
    return tuple(terms)
