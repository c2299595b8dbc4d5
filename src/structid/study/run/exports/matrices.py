"""State equations and matrices of an identified model in files of other programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from scipy import sparse

from structid.core.constraints import split_commas
from structid.core.errors import FileError, InputError
from structid.fem import Structure
from structid.fem.importers import (
    ImportedMatrix,
    Op4Options,
    dof_table,
    write_abaqus,
    write_matrices,
    write_numbering,
    write_op4,
)
from structid.files import atomic_write
from structid.prediction.identified_model import IdentifiedModel
from structid.prediction.options import ExportOptions
from structid.prediction.state_space import state_space

#: Names of the matrices, as programs of finite elements call those of an analysis set, and their kinds.
_MATRICES = {"MAA": "mass", "BAA": "damping", "KAA": "stiffness", "K4AA": "structural_damping"}
#: Suffixes of files with one matrix each, and of an Abaqus deck.
_ONE_EACH, _ABAQUS = (".npz", ".npy", ".mtx"), ".inp"
#: Degrees of freedom up to which OP4 has whole columns, which MYSTRAN reads too.
_MOST_DENSE = 3000
MATRIX_SUFFIXES = (".op4", ".pch", ".mat", ".inp", ".mtx", ".npz", ".npy")


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
        One line on each file.

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
    structure.require_modes("matrices")
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
    """Every file that `export_matrices` may write for `path`: the matrices, and the text file with the numbering of rows."""
    files = [path, path.with_suffix(".dofs.txt")]
    if path.suffix.lower() in _ONE_EACH:
        files[:1] = [_file_of(path, name) for name in _MATRICES]
    if path.suffix.lower() == _ABAQUS:
        files += [_file_of(path.with_suffix(".mtx"), name) for name in _MATRICES]
    return files


def _file_of(path: Path, name: str) -> Path:
    return path.with_name(f"{path.stem}_{name}{path.suffix}")


def _write_files(path: Path, items: Sequence[ImportedMatrix], structure: Structure) -> list[str]:
    """Write matrices to files whose names begin with the stem of `path`, and return a line on what was written."""
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
