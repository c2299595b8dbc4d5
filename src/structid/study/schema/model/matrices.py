"""Parts of a structure that files describe: matrices of another finite element code, and components known by measured FRFs.

Their tables are ``[structure.matrices]``, ``[[structure.matrix_group]]`` and ``[[structure.measured_component]]``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from scipy import sparse

from structid.core.arrays import IntArray
from structid.core.constraints import NotNegative, Positive
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError
from structid.core.json_types import JsonValue
from structid.core.units import FORCES, LENGTHS
from structid.fem import MatrixGroup, importers
from structid.study.schema.section import InputFiles, Section
from structid.study.schema.tables import (
    BOOLEAN,
    INTEGER,
    TEXT,
    TEXTS,
    Key,
    Kind,
    Schema,
    Table,
    as_list,
    choice,
    either,
    kind_of_argument,
    list_of,
    several,
    table_of,
)

if TYPE_CHECKING:
    from structid.fem.importers import ImportedMatrix


from collections.abc import Callable
from dataclasses import fields

from structid.core.arrays import FloatArray
from structid.core.display import join_words
from structid.fem import MeasuredComponent
from structid.records import FrfRecord
from structid.records.formats import ReadOptions
from structid.study.schema.records.record import load_record, read_source, record_table

_KEYS = ("mass", "stiffness", "damping")
#: Names that files give by themselves, so that `matrix` need not say which.
_OWN_NAMES = {"mass": ("MASS",), "stiffness": ("STIFFNESS",), "damping": ("VISCOUSDAMPING", "DAMPING")}
_MOST_LABELS = 20_000_000
_RANGE = re.compile(r"^\s*(\d+)(?:\s*-\s*(\d+))?\s*$")
_LABEL = either(INTEGER, replace(TEXT, schema={"type": "string", "pattern": _RANGE.pattern}))
_LABELS = replace(several(_LABEL), words='element labels, as in [1, 2, 3] or "1-320" or ["1-10", "25"]')
_RECORD = record_table(Table())
#: All keys of a measured component: those that say how a record is read, and its own.
MEASURED = _RECORD.only("relabel", "frf", "noise", *(one.name for one in fields(ReadOptions))) | {
    "name": replace(_RECORD.keys["name"], words="What messages call it", required=True),
    "path": replace(
        _RECORD.keys["path"],
        words="Its FRFs, measured by itself: a file as records are, see docs/record-files.md",
        required=True,
    ),
    "interface": Key(TEXTS, "Degrees of freedom at which it moves with the model; all sensors of the file by default"),
}


@dataclass(frozen=True)
class SourceEntry:
    """A matrix of a file."""

    path: Annotated[str, "The file"]
    matrix: Annotated[str | None, "Its name in the file, where there are several"] = None
    elements: Annotated[
        int | str | tuple[int | str, ...] | None, _LABELS, "Of a file written element by element: which of them"
    ] = None
    one_triangle: Annotated[bool, "Only one triangle is stored; the other is to be added"] = False


_SOURCE = table_of(SourceEntry)
_FILE = Kind(
    'a file, or a table such as { path = "model.op4", matrix = "KAA" }',
    {"anyOf": [TEXT.schema, {"type": "object", "minProperties": 1}]},
    lambda value: value != {},
)


@dataclass(frozen=True)
class ExportsEntry:
    """A group as the difference of two exports."""

    base: Annotated[str | Mapping[str, JsonValue], _FILE, "The first export"]
    changed: Annotated[str | Mapping[str, JsonValue], _FILE, "The second, with the parameter times `factor`"]
    factor: Annotated[Positive, "Of the second; the group is their difference over `factor` - 1"]
    third: Annotated[
        str | Mapping[str, JsonValue] | None, _FILE, "A third export, which checks the linear dependence"
    ] = None
    third_factor: Annotated[Positive | None, "Its factor"] = None


_EXPORTS = table_of(ExportsEntry)
_WAYS: Schema = {"anyOf": [TEXT.schema, _SOURCE.schema, _EXPORTS.schema]}
MATRICES = Kind(
    f"{_FILE.words}, or a list of these",
    {"anyOf": [*_WAYS["anyOf"], list_of(_WAYS)]},
    lambda value: all(map(_FILE.accepts, as_list(value))),
)
#: All keys of ``[structure.matrices]``.
NUMBERING = Table(
    {
        "dofs": Key(TEXTS, "What the rows stand for: a text file, or a list of degrees of freedom"),
        "length_unit": Key(choice(*LENGTHS), "Of the files", default="m"),
        "force_unit": Key(choice(*FORCES), "Of the files", default="N"),
    }
)
#: All keys of ``[[structure.matrix_group]]``.
GROUP = Table(
    {
        "name": Key(TEXT, "Name of the group", required=True),
        **{key: Key(MATRICES, f"A file, a table or a list of these, which are summed: the {key}") for key in _KEYS},
        "loss_factor": Key(kind_of_argument(NotNegative), "Structural damping of `stiffness`", default=0.0),
        "indefinite": Key(BOOLEAN, "Lets matrices through that are not positive semidefinite", default=False),
    }
)


@dataclass(frozen=True, eq=False)
class _Reader:
    """Files read so far; each once."""

    files: InputFiles
    known: dict[Path, Mapping[str, ImportedMatrix]] = field(default_factory=dict)

    def matrices(self, name: str) -> Mapping[str, ImportedMatrix]:
        """The matrices of the file `name`, by the names in it; each file is read once and then kept in `known`."""
        path = self.files.folder / name
        if path not in self.known:
            self.known[path] = importers.read_matrices(self.files.path(name))
        return self.known[path]


def read_groups(section: Section, files: InputFiles) -> tuple[list[tuple[Section, MatrixGroup]], list[Dof]]:
    """Matrix groups from files, in SI units, each with its section, and the degrees of freedom marked as constrained.

    Those that no group has are left out of the latter. Without ``[structure.matrices]`` units are m and N, and rows are
    numbered by the files.

    Parameters
    ----------
    section : Section
        ``[structure]``.
    files : InputFiles
        List of input files, to which the files read are added.

    Raises
    ------
    StudyError
        If ``[structure.matrices]`` stands without a group, or a group cannot be read; with its place in the study.
    """
    entries = section.sections("matrix_group")
    matrices = section.section("matrices")
    if matrices is None:
        return _read_entries(entries, None, ("m", "N"), _Reader(files))
    values = matrices.values(NUMBERING)
    if not entries:
        raise matrices.error("there is no [[structure.matrix_group]]; add one a group, with `name` and `stiffness`")
    dofs = None
    if "dofs" in values:
        with matrices.located("dofs"):
            text = values["dofs"]
            dofs = importers.read_numbering(files.path(text)) if isinstance(text, str) else parse_dofs(text)
    units = (values.get("length_unit", "m"), values.get("force_unit", "N"))
    return _read_entries(entries, dofs, units, _Reader(files))


def _read_entries(
    entries: list[Section], dofs: tuple[Dof, ...] | None, units: tuple[str, str], reader: _Reader
) -> tuple[list[tuple[Section, MatrixGroup]], list[Dof]]:
    """Matrix groups of the tables `entries`, each with its table, and the degrees of freedom that files constrain.

    Constrained ones that no group has are left out. The rows of the matrices belong to `dofs` or, if that is None, to
    those that the files state. `units` are those of length and force in the files.
    """
    groups = [(entry, _read_group(entry, dofs, units, reader)) for entry in entries]
    constrained = [
        item.constrained
        for matrices in reader.known.values()
        for item in matrices.values()
        if item.constrained is not None
    ]
    if not constrained:
        return groups, []
    present = {dof.unsigned for _, group in groups for dof in group.dofs}
    return groups, [dof for dof in importers.dofs_of(np.unique(np.concatenate(constrained), axis=0)) if dof in present]


def _read_group(entry: Section, dofs: tuple[Dof, ...] | None, units: tuple[str, str], reader: _Reader) -> MatrixGroup:
    """The group of matrices that one entry describes, in SI units, on `dofs` or, if None, on those of its files.

    Each matrix must be positive semidefinite unless the entry says ``indefinite``, else `StudyError`. `units` are those
    of length and force in the files. Several files of one key are added.
    """
    values = entry.values(GROUP)
    parts: dict[str, list[ImportedMatrix]] = {}
    for key in _KEYS:
        if key in values:
            with entry.located(key):
                parts[key] = [_read_matrix(entry, key, item, reader) for item in as_list(values[key])]
    rows = dofs if dofs is not None else _own_numbering(entry, parts)
    matrices = {key: _sum_matrices(entry, key, items, rows, units) for key, items in parts.items()}
    with entry.located():
        group = MatrixGroup(values["name"], rows, loss_factor=values.get("loss_factor", 0.0), **matrices)
    if not values.get("indefinite", False):
        for key, matrix in group.given.items():
            with entry.located(key):
                importers.require_semidefinite(key, matrix, group.dofs)
    return group


def _own_numbering(entry: Section, by_key: Mapping[str, list[ImportedMatrix]]) -> tuple[Dof, ...]:
    """The degrees of freedom that the matrix files of a group state for their rows, each once, in the order of nodes.

    `by_key` are the imported matrices by key of `entry`, the group's table; () if there are none, `StudyError` if a
    file states no numbering.
    """
    tables: list[IntArray] = []
    for key, imported_matrices in by_key.items():
        for imported in imported_matrices:
            if imported.dofs is None:
                raise entry.error(
                    f"the rows of {imported.name!r} have no numbering of their own; add [structure.matrices] with "
                    '`dofs = "dofs.txt"` or a list of degrees of freedom',
                    key,
                )
            tables.append(imported.dofs)
    if not tables:
        return ()
    with entry.located():
        return importers.dofs_of(importers.tables_of(np.unique(importers.codes_of(np.concatenate(tables)))))


def _sum_matrices(
    entry: Section, key: str, imported_matrices: list[ImportedMatrix], dofs: tuple[Dof, ...], units: tuple[str, str]
) -> sparse.csc_array:
    """The sum of the matrices `imported_matrices` of a key, on `dofs` and in SI units, sparse (n_dofs, n_dofs).

    `units` are those of length and force in the files. `InputError`, with the place in the study, if a matrix without a numbering
    of its own has another size.
    """
    total = sparse.csc_array((len(dofs), len(dofs)))
    with entry.located(key):
        for imported in imported_matrices:
            if imported.dofs is None and imported.matrix.shape != total.shape:
                raise InputError(
                    f"{imported.name!r} must be {total.shape} like the degrees of freedom in `dofs`, got {imported.matrix.shape}"
                )
            total = total + (
                imported.matrix if imported.dofs is None else importers.on_dofs(imported, _signed_table(dofs, imported))
            )
        return importers.in_si(total, dofs, *units)


def _signed_table(dofs: tuple[Dof, ...], imported: ImportedMatrix) -> IntArray:
    """Node and component (1 to 6) of `dofs`, (n_dofs, 2), as the file of `imported` numbers them.

    The component is 0 at scalar points of the file, which structid calls RX.
    """
    table = importers.dof_table(dofs)
    assert imported.dofs is not None
    scalar = np.isin(table[:, 0], imported.dofs[imported.dofs[:, 1] == 0, 0]) & (table[:, 1] == 4)
    table[scalar, 1] = 0
    return table


def _read_matrix(entry: Section, key: str, value: Any, reader: _Reader) -> ImportedMatrix:
    """Matrix under `key` of an entry, whose `value` names a file, a matrix or elements in it, or two exports.

    Of two exports, the change is taken. It is as the file has it, in its units and numbering; a single triangle is
    completed if ``one_triangle`` says so. `InputError` unless it is real and square.
    """
    if isinstance(value, str):
        return _require_real_square(_choose_matrix(key, value, None, reader), value)
    section = Section(entry.source, (*entry.path, key), value)
    if "base" in value or "changed" in value:
        return _read_difference(entry, key, section, reader)
    source = section.read(SourceEntry)
    imported = _require_real_square(_choose_matrix(key, source.path, source.matrix, reader), source.path)
    if source.elements is not None:
        imported = importers.of_elements(imported, _labels(source.elements))
    return _complete_triangle(imported) if source.one_triangle else imported


def _read_difference(entry: Section, key: str, section: Section, reader: _Reader) -> ImportedMatrix:
    """A group matrix computed from the difference of two exports of one mesh, checked by a third if there is one.

    `key` is mass, stiffness or damping; `section` names the files and the factors by which the group was changed. The
    matrix is as the files have it, in their units. `InputError` if their numberings differ.
    """
    files_given = section.read(ExportsEntry)
    files = {"base": files_given.base, "changed": files_given.changed, "third": files_given.third}
    imported_matrices = {
        name: _read_matrix(entry, key, file, reader) for name, file in files.items() if file is not None
    }
    base = imported_matrices["base"]
    matrices = {}
    for name, imported in imported_matrices.items():
        numbering, first = imported.dofs, base.dofs
        if (numbering is None) != (first is None) or (
            numbering is not None and first is not None and not np.array_equal(numbering, first)
        ):
            raise InputError(f"`{name}` must have the numbering of `base`; export the same mesh")
        matrices[name] = imported.matrix
    third = matrices.get("third")
    group = importers.group_from_exports(
        matrices["base"], matrices["changed"], files_given.factor, third, files_given.third_factor
    )
    return importers.ImportedMatrix(base.name, group, base.dofs)


def _choose_matrix(key: str, name: str, matrix: str | None, reader: _Reader) -> ImportedMatrix:
    """The matrix called `matrix` in the file `name`, in upper or lower case.

    None takes the only one, or the one that fits `key`. `key` is mass, stiffness or damping. `InputError` if there is
    no such matrix, or several could be meant.
    """
    matrices = reader.matrices(name)
    if matrix is None:
        fitting = [imported for imported in matrices.values() if imported.name in _OWN_NAMES[key]]
        if len(matrices) == 1 or len(fitting) == 1:
            return fitting[0] if fitting else next(iter(matrices.values()))
        raise InputError(
            f'{name} holds {len(matrices)} matrices ({", ".join(matrices)}); say which: {{ path = "{name}", matrix = '
            f'"{next(iter(matrices))}" }}'
        )
    for imported in matrices.values():
        if imported.name.upper() == matrix.upper():
            return imported
    raise InputError(f"{name} holds no matrix {matrix!r}, only {', '.join(matrices)}; name one of these")


def _require_real_square(imported: ImportedMatrix, name: str) -> ImportedMatrix:
    """The matrix `imported` unchanged; `InputError` with the file's `name` unless it is real and square."""
    if np.iscomplexobj(imported.matrix.data):
        raise InputError(
            f"{name}: must hold a real matrix, {imported.name!r} is complex ({imported.matrix.dtype}); export without structural "
            "damping and give `loss_factor`"
        )
    if not imported.is_square:
        raise InputError(f"{name}: must hold a square matrix, {imported.name!r} is rectangular {imported.matrix.shape}")
    return imported


def _complete_triangle(imported: ImportedMatrix) -> ImportedMatrix:
    """A matrix of which one triangle is stored, completed to both; `InputError` if it has entries in both."""
    upper, lower = sparse.triu(imported.matrix, 1), sparse.tril(imported.matrix, -1)
    if abs(upper).sum() > 0 and abs(lower).sum() > 0:
        raise InputError(f"{imported.name!r} has entries on both sides of the diagonal; leave `one_triangle` out")
    return importers.ImportedMatrix(
        imported.name, importers.complete_triangles(imported.matrix, imported.name), imported.dofs
    )


def _labels(entries: Sequence[int | str] | int | str) -> set[int]:
    """Element labels from `entries`, numbers and ranges such as ``"3-8"``, ends included.

    Raises `InputError` for a range that falls or spans more than 20 million labels. The schema has checked the form of
    texts: another one fails an assertion.
    """
    labels: set[int] = set()
    for entry in as_list(entries):
        match = _RANGE.match(str(entry))
        assert match is not None
        first, last = int(match[1]), int(match[2] or match[1])
        if last < first:
            raise InputError(f"elements {entry!r} must go from the lower to the higher label")
        if last - first > _MOST_LABELS:
            raise InputError(f"elements {entry!r} are more than {_MOST_LABELS}; give those that there are")
        labels.update(range(first, last + 1))
    return labels


def read_measured(entry: Section, files: InputFiles, dofs_of_set: Callable[[str], list[Dof]]) -> MeasuredComponent:
    """The component that an entry of ``[[structure.measured_component]]`` describes; an equal entry is read only once.

    Parameters
    ----------
    entry : Section
        The entry.
    files : InputFiles
        List of input files, to which the component's file is added.
    dofs_of_set : callable
        Gives the degrees of freedom of a text of `interface`, and checks that they are at nodes of the structure.

    Raises
    ------
    StudyError
        If its file cannot be read, or does not hold FRFs between all degrees of freedom of the interface.
    """
    source, values = read_source(entry, files, keys=MEASURED), entry.values(MEASURED)
    named = [dof for text in as_list(values.get("interface", ())) for dof in dofs_of_set(text)]
    key = files.digest(values["path"]), repr(entry.table)
    if key not in files.measured:
        files.measured[key] = _make_component(entry, values["name"], load_record(source), named)
    return files.measured[key]


def _make_component(entry: Section, name: str, record: FrfRecord, named: list[Dof]) -> MeasuredComponent:
    """The component called `name` from an FRF record, at the degrees of freedom `named`; at all its sensors if empty.

    Its FRFs, (n_frequencies, n_interface, n_interface), are receptances along the positive directions, at frequencies
    above 0. `entry` is the table of the component, at which `StudyError` points if a channel is missing.
    """
    interface = tuple(dict.fromkeys(dof.unsigned for dof in named or record.outputs))
    with entry.located("interface" if named else "path"):
        rows, columns = (_channel_indices(record, role, interface) for role in ("outputs", "inputs"))
        moving = record.lines(record.frequency > 0).as_kind("receptance")
        values = moving.values[:, rows[0][:, None], columns[0]] * np.outer(rows[1], columns[1])
        variance = None if moving.variance is None else moving.variance[:, rows[0][:, None], columns[0]]
        return MeasuredComponent(name, interface, moving.frequency, values, record.source, variance)


def _channel_indices(record: FrfRecord, role: str, interface: tuple[Dof, ...]) -> tuple[IntArray, FloatArray]:
    """Index and sign (1 or -1) of the channel of a record at each degree of freedom of `interface`, both (n_interface,).

    `role` is "outputs" or "inputs"; `InputError` if a channel is missing.
    """
    channels = {"outputs": record.outputs, "inputs": record.inputs}
    index_of = {dof.unsigned: index for index, dof in enumerate(channels[role])}
    missing = [dof.place for dof in interface if dof not in index_of]
    if missing:
        raise InputError(
            f"{record.source} has no {role.removesuffix('s')} {', '.join(missing)}: a component needs FRFs from loads at all"
            f" degrees of freedom of its interface to sensors at all of them, and the file has outputs {join_words(record.outputs)}"
            f" and inputs {join_words(record.inputs)}; measure the rest, correct names by `relabel`, or leave some out of"
            " `interface`"
        )
    index = np.array([index_of[dof] for dof in interface])
    return index, np.array([float(channels[role][k].sign) for k in index])
