"""Offsets of shells and beams of Abaqus and CalculiX from their nodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.fem.meshes.abaqus_assembly import Assembly, PartData
from structid.fem.meshes.abaqus_keywords import KeywordBlock
from structid.fem.meshes.coordinate_systems import unit_normals
from structid.fem.meshes.deck_parts import CellOffsets, DeckPart, split_by_obstacle
from structid.fem.meshes.mesh import CellBlock

_SECTIONS = ("SHELL SECTION", "SHELL GENERAL SECTION", "BEAM SECTION", "BEAM GENERAL SECTION")
_SIDES = {"SPOS": 0.5, "SNEG": -0.5, "MIDDLE": 0.0}
#: Cosine of the angle between normals of cells at a node up to which solvers take the mean of them.
_SMOOTH = np.cos(np.radians(20.0))


class SectionOffsets:
    """Offsets of the sections of an input file.

    Parameters
    ----------
    assembly : Assembly
    blocks : sequence of CellBlock
    rows_of : sequence of dict of label to row
        Cells of each block.
    positions : mapping of label to position in m
    length : float
        Unit of the file, m.
    """

    def __init__(
        self,
        assembly: Assembly,
        blocks: Sequence[CellBlock],
        rows_of: Sequence[Mapping[int, int]],
        positions: Mapping[int, FloatArray],
        length: float,
    ) -> None:
        self._assembly, self._blocks, self._rows_of = assembly, blocks, rows_of
        self._positions, self._length = positions, length

    def parts(self) -> list[DeckPart]:
        """Deck parts of the offsets: by kind of section, apart for those that cannot be read, and then centroids of beams.

        Parts that cannot be taken say why in `obstacle`.
        """
        parts = []
        every = [*self._assembly.scopes, *([self._assembly.own] if self._assembly.own is not None else [])]
        for keyword in _SECTIONS:
            kind = f"{keyword} OFFSET"
            items = []
            for scope in every:
                for block in scope.blocks:
                    if block.keyword == keyword and _is_offset(block):
                        try:
                            items.append(("", DeckPart(kind, 1, offsets=tuple(self._offsets(scope, block)))))
                        except (ValueError, IndexError, KeyError) as error:
                            items.append((str(error), DeckPart(kind, 1)))
            parts += split_by_obstacle(kind, items)
        count = sum(block.keyword in ("CENTROID", "SHEAR CENTER") for scope in every for block in scope.blocks)
        return [*parts, *([DeckPart("BEAM CENTROID", count, obstacle="move the nodes")] if count else [])]

    def _offsets(self, scope: PartData, block: KeywordBlock) -> list[CellOffsets]:
        """The offsets of the cells of one section block, one `CellOffsets` for each cell block that has some of them.

        Raises `ValueError` if cells of its element set cannot have offsets.
        """
        members = self._members(scope, block.options.get("ELSET", ""))
        chosen = []
        for index, rows_of in enumerate(self._rows_of):
            rows = np.array(sorted(rows_of[label] for label in members if label in rows_of), dtype=np.int64)
            if len(rows):
                chosen.append((index, rows))
        is_shell = block.keyword.startswith("SHELL")
        kinds = {self._blocks[index].kind for index, _ in chosen}
        if not kinds <= ({"triangle", "quad"} if is_shell else {"line"}):
            raise ValueError(f"no element for its cells ({', '.join(sorted(kinds))})")
        if is_shell:
            return self._shell_offsets(block, chosen)
        return [self._beam_offsets(scope, block, index, rows) for index, rows in chosen]

    def _members(self, scope: PartData, name: str) -> set[int]:
        """Labels in the mesh of the elements of the set `name` in a scope; raises `ValueError` if there are none."""
        key, labels = name.upper(), set[int]()
        by_owner = self._assembly.cell_sets.get(key, {}) if scope is self._assembly.own else {}
        for owner, members in by_owner.items():
            labels |= {label + self._assembly.shifts[owner] for label in members}
        labels |= {label + self._assembly.shift(scope) for label in scope.cell_sets.get(key, set())}
        if not labels:
            raise ValueError(f"there is no element set {name!r}")
        return labels

    def _shell_offsets(self, block: KeywordBlock, chosen: Sequence[tuple[int, IntArray]]) -> list[CellOffsets]:
        """Offsets in m of shells whose nodes lie on a surface some thicknesses above their middle.

        They run along the mean normal at each node, or along the cell's where normals there differ too much. `chosen` are cell
        blocks, by index, with the rows of the section; `block` is the keyword of the section, with the option OFFSET.
        """
        part, thickness = _offset_in_thicknesses(block.options["OFFSET"]), self._length * _thickness(block)
        corners = [self._corners(index, rows) for index, rows in chosen]
        normals = [unit_normals(positions) for positions in corners]
        at_node: dict[int, list[FloatArray]] = {}
        for (index, rows), own in zip(chosen, normals, strict=True):
            for cell, normal in zip(self._blocks[index].nodes[rows].tolist(), own, strict=True):
                for node in cell:
                    at_node.setdefault(node, []).append(normal)
        mean = {node: _mean_direction(several) for node, several in at_node.items()}
        offsets = []
        for (index, rows), own in zip(chosen, normals, strict=True):
            cells = self._blocks[index].nodes[rows].tolist()
            along = [
                [normal if mean[n] is None else mean[n] for n in cell] for cell, normal in zip(cells, own, strict=True)
            ]
            offsets.append(CellOffsets(index, rows, -part * thickness * np.array(along)))
        return offsets

    def _beam_offsets(self, scope: PartData, block: KeywordBlock, index: int, rows: IntArray) -> CellOffsets:
        """Arms, m, from the nodes to the axis of beams of CalculiX whose nodes lie widths along local directions 1 and 2 off it.

        `index` is that of the cell block, `rows` are its cells in the section; `scope` is the part that has the section, `block`
        the keyword. Raises `ValueError` if the section has no widths, or local direction 1 is along a beam.
        """
        shape = block.options.get("SECTION", "").upper()
        words = [[float(word) for word in row if word] for row in block.rows if any(row)]
        if shape not in ("RECT", "CIRC"):
            raise ValueError(f"its section {shape or 'is not named, and'} has no width")
        widths = self._length * np.array([*words[0], *words[0]][:2])
        guide = np.array(words[1][:3] if len(words) > 1 else [0.0, 0.0, -1.0]) @ scope.turn.T
        ends = self._corners(index, rows)
        along = ends[:, 1] - ends[:, 0]
        along = along / np.linalg.norm(along, axis=1, keepdims=True)
        first = guide - (along @ guide)[:, None] * along
        size = np.linalg.norm(first, axis=1, keepdims=True)
        if (size < 1e-8 * np.linalg.norm(guide)).any():
            raise ValueError("its local direction 1 is along its axis")
        first = first / size
        shares = [float(block.options.get(key, "") or 0) for key in ("OFFSET1", "OFFSET2")]
        arm = -(shares[0] * widths[0] * first + shares[1] * widths[1] * np.cross(along, first))
        return CellOffsets(index, rows, np.repeat(arm[:, None], 2, axis=1))

    def _corners(self, index: int, rows: IntArray) -> FloatArray:
        """Positions of the nodes of cells, (n_cells, n_nodes, 3)."""
        return np.array([[self._positions[node] for node in cell] for cell in self._blocks[index].nodes[rows].tolist()])


def _is_offset(block: KeywordBlock) -> bool:
    return any(key.startswith("OFFSET") and not _is_zero(value) for key, value in block.options.items())


def _is_zero(word: str) -> bool:
    try:
        return _offset_in_thicknesses(word) == 0
    except ValueError:
        return False


def _offset_in_thicknesses(word: str) -> float:
    """An offset in thicknesses from `word`: a number, or SPOS (0.5), SNEG (-0.5) or MIDDLE (0); `ValueError` for others."""
    side = _SIDES.get(word.upper())
    if side is not None:
        return side
    try:
        return float(word)
    except ValueError:
        raise ValueError(f"its offset {word!r} is a distribution") from None


def _thickness(block: KeywordBlock) -> float:
    """Thickness of a shell section, in the unit of the file; the sum of the layers of a composite.

    Raises `ValueError` if it varies over the section or is not stated.
    """
    if "NODAL THICKNESS" in block.options or block.options.get("SHELL THICKNESS"):
        raise ValueError("its thickness varies")
    firsts = [float(row[0]) for row in block.rows if any(row)]
    if not firsts or block.keyword != "SHELL SECTION":
        raise ValueError("it has no thickness")
    return sum(firsts) if "COMPOSITE" in block.options else firsts[0]


def _mean_direction(normals: Sequence[FloatArray]) -> FloatArray | None:
    """The unit mean (3,) of the unit vectors `normals`; None if one of them is more than 20 degrees (`_SMOOTH`) from it."""
    total = np.sum(normals, axis=0)
    size = float(np.linalg.norm(total))
    if size == 0 or min(float(normal @ total) for normal in normals) < _SMOOTH * size:
        return None
    mean: FloatArray = total / size
    return mean
