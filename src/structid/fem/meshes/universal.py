"""Meshes of universal files: nodes (2411, 781, 15), elements (2412) and groups (2467 and the like).

I-DEAS, Simcenter, Salome and Code_Aster write them.

References
----------
Structural Dynamics Research Laboratory, University of Cincinnati: Universal file formats, datasets 2411, 2412 and 2467.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from structid.core.errors import FileError
from structid.fem.meshes.deck_parts import DeckPart, DeckUnits
from structid.fem.meshes.mesh import CellBlock, Mesh
from structid.files.uff.datasets import read_blocks, read_unit_factors
from structid.files.uff.geometry import read_elements, read_nodes, row_of_integers

_GROUPS = (2435, 2452, 2467, 2477)
_NODE, _ELEMENT = 7, 8


def read(path: Path, units: DeckUnits) -> Mesh:
    """The mesh of the universal file at `path`, in m.

    The unit of length is that of the file's dataset 164 or, where it has none, ``units.length``; the other units are
    not used.

    Raises
    ------
    FileError
        If the file is damaged, its dataset 164 differs from ``units.length`` (unless that is 1, the default), it has no
        nodes or no elements, or elements are axisymmetric or lack nodes.
    """
    blocks = read_blocks(path)
    nodes = read_nodes(path, blocks)
    factors = read_unit_factors(path, blocks)
    if factors is not None and units.length != 1 and abs(units.length * factors.length - 1) > 1e-4:
        raise FileError(
            f"{path}: its dataset 164 states a unit of length of {1 / factors.length:g} m, `length_unit` one of"
            f" {units.length:g} m; leave `length_unit` out, or correct the export"
        )
    scale = units.length if factors is None else 1.0
    if not nodes.points:
        raise FileError(f"{path}: holds no nodes (dataset 2411, 781 or 15); export the mesh too")
    elements = read_elements(path, blocks)
    if not elements.nodes:
        raise FileError(f"{path}: holds no elements (dataset 2412); export the mesh too")
    cells = tuple(CellBlock(kind, np.array(rows, dtype=np.int64)) for kind, rows in elements.nodes.items())
    labels = [np.array(elements.labels[kind], dtype=np.int64) for kind in elements.nodes]
    groups, node_groups = {}, {}
    for block in blocks:
        if block.number in _GROUPS:
            for name, chosen, members in _read_groups(f"{path}: dataset {block.ordinal} ({block.number})", block.lines):
                if chosen:
                    groups[name] = tuple(np.flatnonzero(np.isin(labels_of_block, chosen)) for labels_of_block in labels)
                if members:
                    node_groups[name] = np.unique(np.array(members, dtype=np.int64))
    positions = np.array([nodes.points[label] for label in nodes.points]).reshape(-1, 3) * scale
    parts = tuple(DeckPart(kind, count, obstacle="it is not read") for kind, count in elements.beside.items())
    return Mesh(
        np.fromiter(nodes.points, dtype=np.int64), positions, cells, groups, node_groups, path.name, parts,
        displacement_axes=dict(nodes.turned), cells_are_elements=True,
    )  # fmt: skip


def _read_groups(where: str, lines: list[str]) -> list[tuple[str, list[int], list[int]]]:
    """Name, element labels and node labels of each group in the `lines` of one dataset.

    `where` names the dataset in the `FileError` that is raised if a group is cut short.
    """
    groups, line_index = [], 0
    while line_index < len(lines):
        if not lines[line_index].strip():  # some writers leave a line for the members of an empty group
            line_index += 1
            continue
        count = row_of_integers(where, lines, line_index, 8)[7]
        if line_index + 1 >= len(lines) or line_index + 2 + -(-count // 2) > len(lines):
            raise FileError(f"{where} ends within a group; export the mesh again")
        name = lines[line_index + 1].strip()
        numbers = [
            n
            for row in range(line_index + 2, line_index + 2 + -(-count // 2))
            for n in row_of_integers(where, lines, row, 8)
        ]
        entities = list(zip(numbers[0::4], numbers[1::4], strict=False))[:count]
        groups.append(
            (name, [n for kind, n in entities if kind == _ELEMENT], [n for kind, n in entities if kind == _NODE])
        )
        line_index += 2 + -(-count // 2)
    return groups
