"""Files for other programs from a results folder: mode shapes, mesh with values, matrices, state equations.

A deck with the identified numbers is written by `structid.study.run.exported_deck`.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy import sparse

from structid.core.arrays import AnyArray, FloatArray, IntArray
from structid.core.constraints import split_commas
from structid.core.display import plural
from structid.core.errors import FileError, InputError
from structid.dynamics import Modes, modes
from structid.fem import Structure
from structid.fem.elements import ElementSet, MatrixGroup
from structid.fem.elements.element import dof_of_code
from structid.fem.importers import (
    ImportedMatrix,
    Op4Options,
    dof_table,
    write_abaqus,
    write_matrices,
    write_numbering,
    write_op4,
)
from structid.files import atomic_write, csv_text
from structid.modal import ModalRecord
from structid.modal.formats.files import write_modes
from structid.modal.formats.options import CSV_SUFFIXES, JSON_SUFFIXES, WRITTEN_SUFFIXES
from structid.prediction.identified_model import ElementValues, IdentifiedModel, element_values
from structid.prediction.options import ExportOptions
from structid.prediction.quantities import NaturalModes
from structid.prediction.state_space import state_space
from structid.records.formats.geometry import Geometry
from structid.study.results.stored_model import ParameterSpread, stored_model, stored_spread, stored_study
from structid.study.run.exported_deck import deck_path, export_deck
from structid.study.schema.study import Study

#: Names of the matrices, as programs of finite elements call those of an analysis set, and their kinds.
_MATRICES = {"MAA": "mass", "BAA": "damping", "KAA": "stiffness", "K4AA": "structural_damping"}
#: Suffixes of files with one matrix each, and of an Abaqus deck.
_ONE_EACH, _ABAQUS = (".npz", ".npy", ".mtx"), ".inp"
#: Degrees of freedom up to which OP4 has whole columns, which MYSTRAN reads too.
_MOST_DENSE = 3000
MATRIX_SUFFIXES = (".op4", ".pch", ".mat", ".inp", ".mtx", ".npz", ".npy")
MESH_SUFFIXES = (".vtu", ".csv")
#: Number of a cell type in VTK, by the number of nodes of an element.
_POINT, _POINTS, _LINE = 1, 2, 3
_AREAS = {3: 5, 4: 9, 6: 22, 8: 23, 9: 28}
_SOLIDS = {4: 10, 5: 14, 6: 13, 8: 12, 10: 24, 15: 26, 20: 25, 27: 29}
#: Names of number types by kind and size.
_TYPES = {"f8": "Float64", "i8": "Int64", "u1": "UInt8"}


@dataclass(frozen=True)
class ExportFiles:
    """Files to write; None for those that are not wanted.

    Parameters
    ----------
    mode_shapes, mesh, matrices, deck, state_space : Path, optional
    """

    mode_shapes: Path | None = None
    mesh: Path | None = None
    matrices: Path | None = None
    deck: Path | None = None
    state_space: Path | None = None

    @property
    def paths(self) -> tuple[Path, ...]:
        """Every file that may be written, with those that belong to the matrices."""
        single = [getattr(self, item.name) for item in fields(self) if item.name != "matrices"]
        beside = [] if self.matrices is None else matrix_files(self.matrices)
        return (*(path for path in single if path is not None), *beside)


def write_exports(
    results: Path, files: ExportFiles, options: ExportOptions, study: Path | None = None, force: bool = False
) -> list[str]:
    """Write files from the identified model of a results folder, and return lines that describe them.

    `results` is the folder, `files` the paths by kind of content, and `study` the study file if it was moved since.
    `force` allows to write over existing files.

    Raises
    ------
    FileError
        If a file exists already and `force` is not set, a suffix is of no format, or the folder is of another version.
    InputError
        If the model has no such content, two files are one, or an option cannot be used.
    NoAnswerError
        If the data do not determine the model.
    """
    for path in files.paths:
        if files.paths.count(path) > 1:
            raise InputError(f"{path} is named for two kinds of content; give each a file of its own")
        if path.exists() and not force:
            raise FileError(f"{path}: exists already; add --force to write it anew, or write to another file")
    source = stored_study(results, study)
    return write_model_files(results, source, stored_model(results, source), files, options)


def write_model_files(
    results: Path, source: Study, model: IdentifiedModel, files: ExportFiles, options: ExportOptions
) -> list[str]:
    """Write files from a loaded model, over existing ones too, and return lines that describe them.

    `source` and `model` are the study and the identified model of the folder `results`; `files` holds the path of each
    kind of content, None for those not to be written.

    Raises
    ------
    FileError
        If a suffix is of no format, or a file cannot be written.
    InputError
        If the model has no such content, or an option cannot be used.
    """
    lines: list[str] = []
    if files.mode_shapes is not None:
        lines += export_modes(model, options.modes, source.title or "structid", files.mode_shapes)
    if files.mesh is not None:
        lines += export_mesh(model, stored_spread(results, source), options.modes, files.mesh)
    if files.deck is not None:
        spread = stored_spread(results, source)
        lines += export_deck(source, element_values(model, spread.initial, spread.covariance), files.deck)
    if files.matrices is not None:
        lines += export_matrices(model, files.matrices)
    if files.state_space is not None:
        lines.append(export_state_space(model, options, files.state_space))
    return lines


@dataclass(frozen=True)
class Offer:
    """One kind of file that `structid export` writes.

    Attributes
    ----------
    flag : str
        Such as ``--mesh``.
    content : str
        In words.
    suffixes : tuple of str
    obstacle : str
        Why this results folder cannot give it; "" if it can.
    """

    flag: str
    content: str
    suffixes: tuple[str, ...]
    obstacle: str = ""


def list_offers(model: IdentifiedModel, study: Study) -> tuple[Offer, ...]:
    """Every kind of file that `structid export` writes, with its suffixes and why this model cannot give it.

    In this order: mode shapes, mesh, matrices, deck, state equations. The reason is a text, "" if the model can. The
    deck has the suffix of the study's own; without such a deck it has none.
    """
    obstacle = deck_obstacle = ""
    try:
        model.structure.require_modes("it", "predict FRFs")
    except InputError as error:
        obstacle = str(error)
    suffixes: tuple[str, ...] = ()
    try:
        suffixes = (deck_path(study).suffix.lower(),)
    except InputError as error:
        deck_obstacle = str(error)
    return (
        Offer("--mode-shapes", "natural modes at all nodes", WRITTEN_SUFFIXES, obstacle),
        Offer("--mesh", "elements with values, changes, deviations, significance; mode shapes", MESH_SUFFIXES),
        Offer("--matrices", "mass, damping and stiffness matrices, with the numbering", MATRIX_SUFFIXES, obstacle),
        Offer("--deck", "the deck of the mesh with the identified numbers in it", suffixes, deck_obstacle),
        Offer(
            "--state-space",
            "state equations of low order; needs --sensors, --loads, --band",
            (".mat", ".npz", ".h5"),
            obstacle,
        ),
    )


def export_state_space(model: IdentifiedModel, options: ExportOptions, path: Path) -> str:
    """Write state equations of the identified model to `path`, and return a line that describes them.

    Raises
    ------
    InputError
        If sensors, loads or the band are missing or cannot be used.
    """
    sensors, loads = split_commas(options.sensors), split_commas(options.loads)
    for name, value in (("sensors", sensors), ("loads", loads), ("band", options.band)):
        if not value:
            raise InputError(f"`{name}` must be given for state equations, got none", name)
    made = state_space(
        model,
        sensors,
        loads,
        options.band or (0.0, 0.0),
        options.motion,
        options.order,
        options.largest_error,
        options.sampling_rate,
        options.draws,
    )
    made.write(path)
    return f"{path}: {made.overview().words}"


def export_matrices(model: IdentifiedModel, path: Path) -> list[str]:
    """Write mass, damping and stiffness in the format of the suffix, and the node and component of each row in a text file.

    The matrices are for the free degrees of freedom, in SI units; a matrix of zeros is left out.
    Formats that hold one matrix get a file for each, such as ``frame_KAA.mtx``. An Abaqus deck (.inp) has the nodes,
    and includes matrix files in the form of Abaqus.

    Returns
    -------
    list of str
        One line on the files of matrices, then one on the numbering.

    Raises
    ------
    InputError
        If the structure has no matrices.
    FileError
        If the suffix is of no format.
    """
    suffix = path.suffix.lower()
    if suffix not in MATRIX_SUFFIXES:
        raise FileError(f"{path}: the suffix must be one of {' '.join(MATRIX_SUFFIXES)}, got {path.suffix!r}")
    structure = model.structure
    structure.require_scaled_modes("matrices")
    table = dof_table(structure.dofs)
    items = []
    for name, matrix_kind in _MATRICES.items():
        matrix = structure.matrix(matrix_kind, model.values)
        if matrix.nnz:
            symmetric = 0.5 * (matrix + matrix.T)  # without what rounding makes of the sums of elements
            items.append(ImportedMatrix(name, sparse.csc_array(symmetric), table))
    lines = _write_files(path, items, structure)
    numbering = path.with_suffix(".dofs.txt")
    write_numbering(numbering, table)
    inside = sum(dof.node not in structure.nodes for dof in structure.dofs)
    within = f"; the last {inside} are inside elements" if inside else ""
    return [*lines, f"{numbering}: node and component of each row{within}"]


def matrix_files(path: Path) -> list[Path]:
    """Files that an export of matrices to `path` may write: matrices, and a text file with the numbering of rows.

    By the suffix of `path`, all matrices go into one file, or each into its own (.npz, .npy, .mtx); .inp has both.
    """
    files = [path, path.with_suffix(".dofs.txt")]
    if path.suffix.lower() in _ONE_EACH:
        files[:1] = [_file_of(path, name) for name in _MATRICES]
    if path.suffix.lower() == _ABAQUS:
        files += [_file_of(path.with_suffix(".mtx"), name) for name in _MATRICES]
    return files


def _file_of(path: Path, name: str) -> Path:
    return path.with_name(f"{path.stem}_{name}{path.suffix}")


def _write_files(path: Path, items: Sequence[ImportedMatrix], structure: Structure) -> list[str]:
    """Write matrices in the format of the suffix of `path`, and return a list with one line on what was written.

    Formats that hold one matrix get a file for each, named by the stem of `path` and the matrix; an Abaqus deck
    includes such files.
    """
    names = [item.name for item in items]
    imaginary = "; K4AA is the imaginary part of the stiffness" if "K4AA" in names else ""
    size = f"{structure.n_dofs} degrees of freedom, SI units"
    if path.suffix.lower() in _ONE_EACH:
        for item in items:
            write_matrices(_file_of(path, item.name), [item])
        shown = ", ".join(_file_of(path, name).name for name in names)
        return [f"{path.parent / shown}: of {size}{imaginary}"]
    if path.suffix.lower() == _ABAQUS:
        parts = {item.name: _file_of(path.with_suffix(".mtx"), item.name) for item in items}
        for item in items:
            write_abaqus(parts[item.name], item)
        with atomic_write(path) as temporary:
            temporary.write_text(_abaqus_deck(structure, parts), encoding="ascii")
        return [f"{path}: nodes, and {', '.join(part.name for part in parts.values())} of {size}{imaginary}"]
    if path.suffix.lower() == ".op4" and structure.n_dofs <= _MOST_DENSE:
        write_op4(path, items, Op4Options(layout="dense"))
    else:
        write_matrices(path, items)
    return [f"{path}: {', '.join(names)} of {size}{imaginary}"]


def _abaqus_deck(structure: Structure, parts: Mapping[str, Path]) -> str:
    """Text of an Abaqus deck of nodes and matrices, to include in a model or to add steps to.

    `parts` are the files of the matrices by their names: KAA, MAA, BAA, K4AA.
    """
    keywords = {"KAA": "STIFFNESS", "MAA": "MASS", "BAA": "VISCOUS DAMPING", "K4AA": "STRUCTURAL DAMPING"}
    nodes = [
        f"{node}, " + ", ".join(f"{x:.16g}" for x in [*position.tolist(), 0.0, 0.0][:3])
        for node, position in structure.nodes.items()
    ]
    inside = sorted({dof.node for dof in structure.dofs} - set(structure.nodes))
    return "\n".join(
        [
            "** Matrices of free degrees of freedom, m kg s; supports and ties are already in them",
            "*NODE, NSET=NALL",
            *nodes,
            *(f"{node}, 0.0, 0.0, 0.0" for node in inside),
            *(f"*MATRIX INPUT, NAME={name}, INPUT={part.name}" for name, part in parts.items()),
            "*MATRIX ASSEMBLE, " + ", ".join(f"{keywords[name]}={name}" for name in parts),
            "",
        ]
    )


def export_mesh(model: IdentifiedModel, spread: ParameterSpread, n_modes: int, path: Path) -> list[str]:
    """Write the structure with the values of its elements to `path`, .vtu or .csv; return a list with one line on it.

    A .vtu file also has the shapes of the `n_modes` lowest modes, where the structure has modes; `spread` has initial
    values and covariance of the parameters.

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
        (item.element, number, item.name, item.unit, *(_csv_cell(column[number - 1]) for column in columns))
        for item in properties
        for columns in [(item.value, item.std, item.initial, item.relative_change, item.significance)]
        for number in range(1, len(item.value) + 1)
    )
    return csv_text(header, rows)


def _csv_cell(value: float) -> str:
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
    """VTK number of the cell type of an element: that of a solid, an area, a line, a point, or a set of points.

    `n_nodes` is the number of nodes. A matrix group is a set of points, whatever their number.
    """
    if isinstance(element, MatrixGroup):
        return _POINTS
    if element.symbol == "solid":
        return _SOLIDS[n_nodes]
    if n_nodes == 1:
        return _POINT
    return _LINE if n_nodes == 2 or element.is_line else _AREAS[n_nodes]


def _cell_data(structure: Structure, properties: Sequence[ElementValues]) -> dict[str, AnyArray]:
    """Arrays for the cells of a VTK file by name, each (n_cells,), NaN where a cell lacks the property.

    They are the numbers (from 1) of element set and element, and the value of each property; for identified properties
    also the standard deviation, relative change and significance. Properties that are not identified and 0 throughout
    are left out.
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
            *_vtu_section("PointData", point_data),
            *_vtu_section("CellData", cell_data),
            *_vtu_section("Points", {"Points": np.asarray(points, dtype=np.float64)}),
            *_vtu_section(
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


def _vtu_section(name: str, arrays: Mapping[str, AnyArray]) -> list[str]:
    """Lines of the section called `name` of a .vtu file: its tags, between them a line for each array by name."""
    return [f"<{name}>", *(_array_line(key, values) for key, values in arrays.items()), f"</{name}>"]


def _array_line(name: str, values: AnyArray) -> str:
    """The DataArray element called `name`: number of bytes, then the little-endian values of the array, in base 64.

    `values` is (n,) or (n, n_components), of 8-byte floats, 8-byte integers or single bytes.
    """
    array = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
    kind = _TYPES[f"{array.dtype.kind}{array.dtype.itemsize}"]
    components = f' NumberOfComponents="{array.shape[1]}"' if array.ndim > 1 else ""
    content = base64.b64encode(np.uint64(array.nbytes).tobytes() + array.tobytes()).decode("ascii")
    return f'<DataArray type="{kind}" Name={quoteattr(name)}{components} format="binary">{content}</DataArray>'


def model_modes(model: IdentifiedModel, n_modes: int) -> Modes:
    """The `n_modes` lowest natural modes of an identified model, at most one for each degree of freedom.

    `InputError` if the structure has no modes of its own.
    """
    structure = model.structure
    structure.require_modes("modes")
    mass, stiffness, damping, loss = (
        structure.matrix(matrix_kind, model.values)
        for matrix_kind in ("mass", "stiffness", "damping", "structural_damping")
    )
    return modes(mass, stiffness, damping, loss, min(n_modes, structure.n_dofs))


def modes_covariance(model: IdentifiedModel, n_modes: int) -> FloatArray:
    """Covariance of frequencies (Hz), then damping ratios, of the lowest modes, (2 n_modes, 2 n_modes), to first order.

    Parameters are moved along each column of a factor of their covariance, which is one standard deviation; a positive
    one is moved to no less than 0.1 % of its value. Modes are matched by their shapes, in the order of the identified
    model.
    """
    structure, n_factors = model.structure, model.factor.shape[1]
    evaluate = NaturalModes(n_modes).evaluator(structure, model.parameters, [model.physical])
    moved = map(model.moved_parameters, np.eye(n_factors))
    nominal = evaluate(model.physical).real
    changes = np.array([(evaluate(physical).real - nominal).T.ravel() for physical in moved]).reshape(
        n_factors, 2 * n_modes
    )
    return np.asarray(changes.T @ changes)


def model_modes_record(model: IdentifiedModel, n_modes: int, source: str, with_covariance: bool = False) -> ModalRecord:
    """The `n_modes` lowest modes of an identified model with unit modal mass, at all moving degrees of freedom of its nodes.

    `source` is the text on their origin. The covariance of frequencies and damping ratios is None unless asked for by
    `with_covariance`.
    """
    structure, computed = model.structure, model_modes(model, n_modes)
    rows = [
        row
        for row, code in enumerate(structure.numbering.codes.tolist())
        if code // 6 in structure.nodes
        and structure.numbering.matrix.indptr[row + 1] > structure.numbering.matrix.indptr[row]
    ]
    return ModalRecord(
        computed.frequency,
        computed.damping_ratio,
        (structure.numbering.matrix @ computed.mode_shapes)[rows],
        tuple(dof_of_code(structure.numbering.codes[row]) for row in rows),
        modes_covariance(model, len(computed.frequency)) if with_covariance else None,
        source=source,
        scaling="mass",
    )


def node_translations(structure: Structure, mode_shapes: FloatArray) -> FloatArray:
    """Translations of all nodes, fixed and tied ones too, (n_modes, n_nodes, 3), from `mode_shapes` (n_dofs, n_modes).

    Nodes are in the order of the structure; a translation that the structure does not have is 0.
    """
    row_of = {node: row for row, node in enumerate(structure.nodes)}
    motion = np.zeros((mode_shapes.shape[1], len(row_of), 3))
    moved = structure.numbering.matrix @ mode_shapes
    for values, code in zip(moved, structure.numbering.codes.tolist(), strict=True):
        node, axis = divmod(code, 6)
        if node in row_of and axis < 3:
            motion[:, row_of[node], axis] = values
    return motion


def export_modes(model: IdentifiedModel, n_modes: int, title: str, path: Path) -> list[str]:
    """Write the `n_modes` lowest natural modes to `path` in the format of its suffix; return one line on the content.

    `title` is stored in the file. The shapes have unit modal mass.

    Raises
    ------
    InputError
        If the structure has no modes.
    FileError
        If the suffix is of no format, or the format cannot hold the modes.
    """
    record = model_modes_record(model, n_modes, title, path.suffix.lower() in (*JSON_SUFFIXES, *CSV_SUFFIXES))
    write_modes(path, record, _geometry(model.structure))
    ends = f"{record.frequency[0]:.4g} to {record.frequency[-1]:.4g} Hz"
    return [
        f"{path}: {plural(record.n_modes, 'mode')}, {ends}, of unit modal mass, at {len(record.channels)} degrees of freedom"
    ]


def _geometry(structure: Structure) -> Geometry:
    """Nodes of a structure with three coordinates (m), and each line element as a line through its nodes.

    A line with node 0 is left out, since 0 lifts the pen in the file format.
    """
    nodes: dict[int, tuple[float, float, float]] = {}
    for node, position in structure.nodes.items():
        padded = [*position.tolist(), 0.0, 0.0]
        nodes[node] = (padded[0], padded[1], padded[2])
    lines = tuple(
        tuple(int(node) for node in row if node >= 0)
        for element in structure.elements
        if element.is_line
        for row in element.nodes
        if 0 not in row  # which lifts the pen
    )
    return Geometry(nodes, lines)
