"""The structure as a grid with what became of every element and its mode shapes, for ParaView; the same as a table."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from structid.core.arrays import AnyArray, FloatArray, IntArray
from structid.core.display import plural
from structid.core.errors import FileError
from structid.fem import Structure
from structid.fem.elements import ElementSet, MatrixGroup
from structid.files import atomic_write, csv_text
from structid.prediction.element_values import ElementValues, element_values
from structid.prediction.identified_model import IdentifiedModel
from structid.study.results.stored_model import ParameterSpread
from structid.study.run.exports.mode_shapes import model_modes, node_translations

MESH_SUFFIXES = (".vtu", ".csv")
#: Number of a cell type in VTK, by the number of nodes of an element.
_POINT, _POINTS, _LINE = 1, 2, 3
_AREAS = {3: 5, 4: 9, 6: 22, 8: 23, 9: 28}
_SOLIDS = {4: 10, 5: 14, 6: 13, 8: 12, 10: 24, 15: 26, 20: 25, 27: 29}
#: Names of number types by kind and size.
_TYPES = {"f8": "Float64", "i8": "Int64", "u1": "UInt8"}


def export_mesh(model: IdentifiedModel, spread: ParameterSpread, n_modes: int, path: Path) -> list[str]:
    """Write the structure with the values of its elements to `path`, .vtu or .csv, and return lines that describe the content.

    A .vtu file also has the shapes of the `n_modes` lowest modes; `spread` has initial values and covariance of the parameters.

    Raises
    ------
    FileError
        If the suffix is neither, or the file cannot be written.
    """
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise FileError(f"{path}: the suffix must be one of {' '.join(MESH_SUFFIXES)}, got {path.suffix!r}")
    properties = element_values(model, spread.initial, spread.covariance)
    if path.suffix.lower() == ".csv":
        with atomic_write(path) as temporary:
            temporary.write_text(_elements_csv(properties), encoding="utf-8")
        count = sum(len(item.value) for item in properties)
        return [f"{path}: {plural(count, 'value')} of elements, with initial value, deviation, change and significance"]
    structure = model.structure
    text = _grid_text(model, properties, n_modes if structure.has_modes else 0)
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="ascii")
    names = ", ".join(f"{number} {element.name}" for number, element in enumerate(structure.elements, 1))
    n_cells = sum(len(element.nodes) for element in structure.elements)
    sought = list(dict.fromkeys(item.name for item in properties if item.is_sought.any()))
    return [
        f"{path}: {plural(len(structure.nodes), 'node')}, {plural(n_cells, 'cell')};"
        f" identified: {', '.join(sought)}; `element_set` is {names}"
    ]


def _elements_csv(properties: Sequence[ElementValues]) -> str:
    """CSV text with a row for each property of each element: value, deviation, initial value, change, significance."""
    header = (
        "element set",
        "element",
        "property",
        "unit",
        "value",
        "deviation",
        "initial",
        "relative change",
        "significance",
    )
    rows = (
        (item.element, number, item.name, item.unit, *(_cell(column[number - 1]) for column in columns))
        for item in properties
        for columns in [(item.value, item.std, item.initial, item.relative_change, item.significance)]
        for number in range(1, len(item.value) + 1)
    )
    return csv_text(header, rows)


def _cell(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.9g}"


def _grid_text(model: IdentifiedModel, properties: Sequence[ElementValues], n_modes: int) -> str:
    """Text of the VTK file (.vtu) of a model.

    `properties` become cell data, and the shapes of the `n_modes` lowest modes point data.
    """
    structure = model.structure
    points = np.zeros((len(structure.nodes), 3))
    points[:, : structure.dimension] = np.array(list(structure.nodes.values()))
    row_of = {node: row for row, node in enumerate(structure.nodes)}
    point_data: dict[str, AnyArray] = {"node_id": np.array(list(structure.nodes), dtype=np.int64)}
    if n_modes:
        computed = model_modes(model, n_modes)
        for number, motion in enumerate(node_translations(structure, computed.mode_shapes), 1):
            point_data[f"mode {number:02d}: {computed.frequency[number - 1]:.5g} Hz"] = motion
    cells: list[IntArray] = []
    cell_types: list[int] = []
    for element in structure.elements:
        for nodes in element.nodes.tolist():
            labels = [node for node in nodes if node >= 0]
            cells.append(np.array([row_of[label] for label in labels], dtype=np.int64))
            cell_types.append(_cell_type(element, len(labels)))
    return _vtu_text(points, cells, cell_types, point_data, _cell_data(structure, properties))


def _cell_type(element: ElementSet, n_nodes: int) -> int:
    """VTK number of the cell type of an element with `n_nodes` nodes."""
    if isinstance(element, MatrixGroup):
        return _POINTS
    if element.symbol == "solid":
        return _SOLIDS[n_nodes]
    if n_nodes == 1:
        return _POINT
    return _LINE if n_nodes == 2 or element.is_line else _AREAS[n_nodes]


def _cell_data(structure: Structure, properties: Sequence[ElementValues]) -> dict[str, AnyArray]:
    """Arrays for the cells of a VTK file by name, each (n_cells,), NaN where a cell lacks the property.

    They are the numbers (from 1) of element set and element, and the value of each property; for identified properties also
    the standard deviation, relative change and significance. Properties that are 0 throughout are left out.
    """
    counts = [len(element.nodes) for element in structure.elements]
    starts = dict(
        zip([element.name for element in structure.elements], np.cumsum([0, *counts[:-1]]).tolist(), strict=True)
    )
    sizes = dict(zip(starts, counts, strict=True))
    members = {**{name: (name,) for name in starts}, **{one.name: one.elements for one in structure.components}}
    data: dict[str, AnyArray] = {
        "element_set": np.repeat(np.arange(1, len(counts) + 1), counts).astype(np.int64),
        "element": np.concatenate([np.arange(1, count + 1) for count in counts]).astype(np.int64),
    }
    sought = {item.name for item in properties if item.is_sought.any()}
    for item in properties:
        if item.name not in sought and not item.value.any():
            continue
        columns: dict[str, FloatArray] = {f"{item.name} [{item.unit}]": item.value}
        if item.name in sought:
            columns |= {
                f"{item.name} deviation [{item.unit}]": item.std,
                f"{item.name} relative change": item.relative_change,
                f"{item.name} significance": item.significance,
            }
        for name in members.get(item.element, ()):
            cells = slice(starts[name], starts[name] + sizes[name])
            for key, column in columns.items():
                data.setdefault(key, np.full(sum(counts), np.nan))[cells] = column
    return data


def _vtu_text(
    points: FloatArray,
    cells: Sequence[IntArray],
    cell_types: Sequence[int],
    point_data: Mapping[str, AnyArray],
    cell_data: Mapping[str, AnyArray],
) -> str:
    """Text of a VTK file of an unstructured grid.

    Parameters
    ----------
    points : (n_points, 3) float array
        m.
    cells : sequence of (n_nodes,) int arrays
        Rows of `points`, in the order of VTK.
    cell_types : sequence of int
        Number of each cell's type in VTK: 1 a point, 3 a line, 5 a triangle, 12 a hexahedron ...
    point_data : mapping of str to (n_points,) or (n_points, 3) array
        Floats or whole numbers.
    cell_data : mapping of str to (n_cells,) array
        Floats or whole numbers, NaN where a cell has no such value.
    """
    connectivity = np.concatenate(cells) if cells else np.zeros(0)
    offsets = np.cumsum([len(cell) for cell in cells])
    return "\n".join(
        [
            '<?xml version="1.0"?>',
            '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64">',
            f'<UnstructuredGrid><Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(cells)}">',
            *_section("PointData", point_data),
            *_section("CellData", cell_data),
            *_section("Points", {"Points": np.asarray(points, dtype=np.float64)}),
            *_section(
                "Cells",
                {
                    "connectivity": connectivity.astype(np.int64),
                    "offsets": offsets.astype(np.int64),
                    "types": np.asarray(cell_types, dtype=np.uint8),
                },
            ),
            "</Piece></UnstructuredGrid>",
            "</VTKFile>",
            "",
        ]
    )


def _section(name: str, arrays: Mapping[str, AnyArray]) -> list[str]:
    """Lines of one section of the file."""
    return [f"<{name}>", *(_array_line(key, values) for key, values in arrays.items()), f"</{name}>"]


def _array_line(name: str, values: AnyArray) -> str:
    """The DataArray element called `name`: number of bytes, then the little-endian values of the array, in base 64.

    `values` is (n,) or (n, n_components), of a type in `_TYPES`.
    """
    array = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
    kind = _TYPES[f"{array.dtype.kind}{array.dtype.itemsize}"]
    components = f' NumberOfComponents="{array.shape[1]}"' if array.ndim > 1 else ""
    content = base64.b64encode(np.uint64(array.nbytes).tobytes() + array.tobytes()).decode("ascii")
    return f'<DataArray type="{kind}" Name={quoteattr(name)}{components} format="binary">{content}</DataArray>'
