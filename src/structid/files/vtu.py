"""VTK unstructured grids (.vtu) as ParaView, VTK and meshio read them: written by themselves, all digits, without a library."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from xml.sax.saxutils import quoteattr

import numpy as np

from structid.core.arrays import AnyArray, FloatArray, IntArray

#: Names of number types by kind and size.
_TYPES = {"f8": "Float64", "i8": "Int64", "u1": "UInt8"}


def vtu_text(
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
