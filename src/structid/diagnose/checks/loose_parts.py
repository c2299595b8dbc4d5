"""Doubts about a structure before a fit, with the nodes and elements concerned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from structid.core.arrays import FloatArray, IntArray
from structid.core.display import join_words
from structid.diagnose.checks.mesh import MeshErrors
from structid.fem import Structure
from structid.fem.assembly import structure_matrix_kinds
from structid.identification.record_fit import structure_modes

#: Energy of a rigid motion, in parts of what the stiffness could take, below which nothing holds against it.
_ROUNDING = 1e-9
#: Share of a mode's elastic energy that marks where it bends.
_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class PlacedFinding:
    """A finding, and where it is.

    Attributes
    ----------
    words : str
    nodes : tuple of int
        Labels.
    elements : mapping of str to int array
        Numbers (from 0) of the elements of each set.
    """

    words: str
    nodes: tuple[int, ...] = ()
    elements: Mapping[str, IntArray] = field(default_factory=dict)


def structure_findings(structure: Structure, values: FloatArray) -> tuple[PlacedFinding, ...]:
    """Findings on supports of nodes without elements, and on parts joined neither to the rest nor to a support.

    `values` (n_values,) are the property values. Empty for structures without matrices.
    """
    if not structure.has_matrices:
        return ()
    return (*_idle_supports(structure), *_loose_parts(structure, values))


def _idle_supports(structure: Structure) -> list[PlacedFinding]:
    """A list with one finding on the supported nodes that no element or tie reaches; empty if there are none."""
    used = set((structure.numbering.codes // 6).tolist())
    idle = tuple(dict.fromkeys(dof.node for dof in structure.fixed if dof.node not in used))
    if not idle:
        return []
    return [PlacedFinding(f"{_nodes(idle)} held, and no element or tie is there: {_its(idle)} does nothing", idle)]


def _loose_parts(structure: Structure, values: FloatArray) -> list[PlacedFinding]:
    """Findings on parts that are joined to nothing else and that no stiffness restrains, one for each part.

    `values` (n_values,) are the property values. A part is restrained if some rigid translation (of a part that only
    turns, rotation) meets stiffness. Empty for a single part; where no part is restrained, the largest is left out.
    """
    codes = np.array(structure.numbering.free, dtype=np.int64)
    label, node = np.unique(codes // 6, return_inverse=True)
    of_node = sparse.csr_array((np.ones(len(node)), (node, np.arange(len(node)))), (len(label), len(node)))
    joined = sum(abs(structure.matrix(matrix_kind, values)) for matrix_kind in structure_matrix_kinds(structure))
    for component in structure.measured:
        ends = abs(structure.selection(component.interface))
        joined = joined + ends @ sparse.csc_array(np.ones((ends.shape[1],) * 2)) @ ends.T
    count, part = connected_components(of_node @ joined @ of_node.T, directed=False)
    if count < 2:
        return []
    own, axis = part[node], codes % 6
    shifts = np.bincount(own, weights=axis < 3, minlength=count) > 0  # a part that only turns is held against turning
    stiffness = structure.matrix("stiffness", values)
    largest, held = np.zeros(count), np.zeros(count, dtype=bool)
    np.maximum.at(largest, own, abs(stiffness).max(axis=1).toarray().ravel())
    for k in range(6):
        motion = ((axis == k) & (shifts[own] == (k < 3))).astype(float)
        held |= np.bincount(own, weights=motion * (stiffness @ motion), minlength=count) > _ROUNDING * largest
    loose = np.flatnonzero(~held)
    if not held.any():  # the whole structure is free: all but its largest part
        loose = np.setdiff1d(loose, np.bincount(part, minlength=count).argmax())
    found = []
    for one in loose.tolist():
        nodes = tuple(n for n in label[part == one].tolist() if n in structure.nodes)
        words = f"nothing joins {_nodes(nodes, '')} to the rest or supports it: a loose part"
        found.append(PlacedFinding(words, nodes, _touching(structure, nodes)))
    return found


def coarse_elements(structure: Structure, values: FloatArray, mesh: MeshErrors) -> PlacedFinding | None:
    """Finding that names the elements with half of the elastic energy of the mode with the largest mesh error.

    These are the fewest elements, of most energy, by the present mesh. None if no mode was judged, or if `mesh` has
    nothing to say: no error above what is allowed and no mode lost. `values` (n_values,) are the property values,
    `mesh` the errors of the same structure.
    """
    if not mesh.words or not mesh.number.size:
        return None
    mode = int(mesh.number[mesh.worst])
    shape = structure_modes(structure, values, min(mode + 8, structure.n_dofs)).mode_shapes[:, [mode]]
    energy: dict[str, FloatArray] = {}
    sets = {item.values.start: item.element for item in structure.properties}
    for own in structure.contributions:
        if own.matrix_kind == "stiffness":
            name, part = sets[own.first], own.weights(values) * own.blocks.bilinear(shape, shape)[:, 0, 0]
            energy[name] = energy.get(name, 0.0) + part
    told = np.concatenate(list(energy.values()))
    order = np.argsort(told)[::-1]
    least = told[order[np.searchsorted(np.cumsum(told[order]), _SHARE * told.sum())]]
    chosen = {name: np.flatnonzero(part >= least) for name, part in energy.items() if (part >= least).any()}
    words = f"{mesh.words}; half of the energy of mode {mode + 1} is in the marked elements"
    return PlacedFinding(words, (), chosen)


def _touching(structure: Structure, nodes: tuple[int, ...]) -> dict[str, IntArray]:
    rows = {e.name: np.flatnonzero(np.isin(e.nodes, nodes).any(axis=1)) for e in structure.elements if not e.follows}
    return {name: own for name, own in rows.items() if own.size}


def _nodes(labels: tuple[int, ...], verb: str = " is| are") -> str:
    one, _, many = verb.partition("|")
    return f"node {join_words(labels)}{one}" if len(labels) == 1 else f"nodes {join_words(labels)}{many}"


def _its(labels: tuple[int, ...]) -> str:
    return "its support" if len(labels) == 1 else "each support"
