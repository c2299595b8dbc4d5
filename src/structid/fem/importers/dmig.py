"""Nastran DMIG cards, as bulk data and punch files hold them: entries with grid point and component of row and column.

What is kept: name, values, numbering, symmetry. A symmetric matrix (form 6) has one triangle in the file.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from scipy import sparse

from structid.core.arrays import IntArray
from structid.core.errors import FileError, InputError
from structid.fem.importers.bulk_lines import BulkLines, bulk_lines
from structid.fem.importers.fixed_fields import is_blank
from structid.fem.importers.imported import ImportedMatrix, codes_of, matrix_from_entries, tables_of

Field = Literal["large", "small", "free"]


class _Entries(NamedTuple):
    """Every entry of every matrix: the line it stands on, its column's card, row, and value."""

    line: IntArray
    card: IntArray
    node: IntArray
    component: IntArray
    real: np.ndarray
    imaginary: np.ndarray


class _Header(NamedTuple):
    line: int
    name: str
    form: int
    kind: int
    polar: bool
    columns: int


def read(path: Path) -> list[ImportedMatrix]:
    """Every DMIG matrix in the Nastran file at `path`, in the order of their headers; other cards are passed over.

    Small, large and free field; comments, blank lines, continuations, exponents written ``D`` or left out. Rows have
    node and component; symmetric matrices are complete. Values stay in the units of the file.

    Raises
    ------
    FileError
        If there is no DMIG, a header is missing or doubled, a field cannot be read, or an entry is given twice.
    """
    lines = bulk_lines(path, ("DMIG",))
    if not len(lines.start):
        raise FileError(f"{path}: holds no DMIG card; write some with PARAM,EXTOUT,DMIGPCH or EXTSEOUT(DMIGPCH)")
    starts = np.flatnonzero(lines.card == np.arange(len(lines.card)))
    width = lines.width[starts]
    names = np.array([word.decode("latin-1") for word in lines.words(starts, 8, width).tolist()])
    grid = lines.integers(starts, 8 + width, width, "the column's grid point (field 3 of DMIG)")
    headers = _read_headers(lines, starts[grid == 0], names[grid == 0])
    component = np.zeros(len(lines.start), dtype=np.int64)
    node = np.zeros(len(lines.start), dtype=np.int64)
    node[starts] = grid
    component[starts] = lines.integers(starts, 8 + 2 * width, width, "the column's component (field 4 of DMIG)")
    entries = _read_entries(lines, np.isin(lines.card, starts[grid != 0]))
    named = dict(zip(starts.tolist(), names.tolist(), strict=True))
    without_header = [start for start in starts[grid != 0].tolist() if named[start] not in headers]
    if without_header:
        raise FileError(
            f"{path}, line {lines.number[without_header[0]]}: DMIG {named[without_header[0]]!r} has no header (a card with 0 in "
            "field 3); the file is cut short, add the header"
        )
    owner = np.zeros(len(lines.start), dtype=np.int64)
    order = {name: i for i, name in enumerate(headers)}
    owner[starts] = [order.get(name, -1) for name in names.tolist()]
    return [
        _make_matrix(lines, header, _select_entries(entries, owner[entries.card] == i), node, component)
        for i, header in enumerate(headers.values())
    ]


def _select_entries(entries: _Entries, keep: np.ndarray) -> _Entries:
    return _Entries(*(column[keep] for column in entries))


def _read_headers(lines: BulkLines, line_indices: IntArray, names: np.ndarray) -> dict[str, _Header]:
    """The header (form, type, polar flag, number of columns) of each DMIG matrix by its name, in order.

    `line_indices` are the header lines, `names` their matrices. Raises `FileError` for a second header, or an unknown
    form or type.
    """
    headers: dict[str, _Header] = {}
    for line, name in zip(line_indices.tolist(), names.tolist(), strict=True):
        where = f"{lines.path}, line {lines.number[line]}"
        if name in headers:
            raise FileError(
                f"{where}: DMIG {name!r} has a second header, the first is on line {lines.number[headers[name].line]}; "
                "write each matrix under a name of its own"
            )
        form, kind, polar, columns = _read_header_fields(lines, line)
        if form not in (1, 2, 6, 9) or kind not in (1, 2, 3, 4):
            raise FileError(
                f"{where}: the header of DMIG {name!r} has form {form} and type {kind}; the form must be 1, 2, 6 or 9 "
                "and the type 1 to 4"
            )
        headers[name] = _Header(line, name, form, kind, polar != 0, columns)
    return headers


def _read_header_fields(lines: BulkLines, line: int) -> tuple[int, int, int, int]:
    """Form, type, polar flag and number of columns of the header on line index `line`: fields 4, 5, 7 and 9.

    The last two are 0 where a header in large or free field has no second line.
    """
    first = np.array([line])
    width = int(lines.width[line])
    if width == 8:
        values = [int(lines.integers(first, 8 * i, 8, "a field of the header")[0]) for i in (3, 4, 6, 8)]
        return values[0], values[1], values[2], values[3]
    form = int(lines.integers(first, 8 + 2 * width, width, "the form")[0])
    kind = int(lines.integers(first, 8 + 3 * width, width, "the type")[0])
    second = np.flatnonzero(lines.card == line)[1:2]
    if not second.size:
        return form, kind, 0, 0
    polar = int(lines.integers(second, 8 + width, width, "POLAR")[0])
    columns = int(lines.integers(second, 8 + 3 * width, width, "NCOL")[0])
    return form, kind, polar, columns


def _read_entries(lines: BulkLines, wanted: np.ndarray) -> _Entries:
    """Entries on the `wanted` lines (mask), from groups of four fields: grid point, component and value of the row.

    Each has the index of its line, that of the line on which its card begins, grid point and component of the row, and
    real and imaginary part. Blank groups are left out. Raises `FileError` for a field that is no number.
    """
    is_start = lines.card == np.arange(len(lines.card))
    parts = []
    for first, width, chosen in (
        (8, 16, wanted & (lines.width == 16) & ~is_start),  # one group a continuation
        (8, 24, wanted & (lines.width == 24) & ~is_start),
        (40, 8, wanted & (lines.width == 8)),  # the second half of a small-field line
        (8, 8, wanted & (lines.width == 8) & ~is_start),  # its first half, of a continuation
    ):
        line = np.flatnonzero(chosen)
        if line.size:
            used = np.zeros(len(line), dtype=bool)
            for i in range(4):
                used |= ~is_blank(lines.take(line, first + i * width, width))
            line = line[used]
        parts.append(
            _Entries(
                line,
                lines.card[line],
                lines.integers(line, first, width, "the row's grid point"),
                lines.integers(line, first + width, width, "the row's component"),
                lines.reals(line, first + 2 * width, width, "the entry"),
                lines.reals(line, first + 3 * width, width, "the imaginary part"),
            )
        )
    return _Entries(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _make_matrix(
    lines: BulkLines, header: _Header, entries: _Entries, node: IntArray, component: IntArray
) -> ImportedMatrix:
    """The matrix of one header from its entries, rows and columns sorted by node and component.

    `node` and `component` are those of the column, by the index of the line on which its card begins. Raises
    `FileError` if there are no entries, one is not possible or comes twice, or a symmetric matrix is not symmetric.
    """
    if not len(entries.line):
        raise FileError(
            f"{lines.path}, line {lines.number[header.line]}: DMIG {header.name!r} has a header but no column; the file "
            "is cut short, or the matrix is empty and can be left out"
        )
    values = entries.real if header.kind < 3 else _complex_values(entries, header.polar)
    rows = np.stack([entries.node, entries.component], axis=1)
    columns = np.stack([node[entries.card], component[entries.card]], axis=1)
    bad = (rows[:, 0] < 1) | (rows[:, 1] < 0) | (rows[:, 1] > 6)
    if bad.any():
        entry = int(np.argmax(bad))
        shown = f"{rows[entry, 0]}, {rows[entry, 1]}"
        raise lines.error(int(entries.line[entry]), "grid point and component", shown, "positive, and 0 to 6")
    _require_single(lines, header, entries, rows, columns)
    try:
        if header.form in (2, 9):
            matrix = _rectangular_matrix(header.name, rows, columns, values)
            if 0 < header.columns < matrix.matrix.shape[1]:
                raise InputError(
                    f"{header.name!r} has {matrix.matrix.shape[1]} columns, but its header says {header.columns}"
                )
            return matrix
        return matrix_from_entries(header.name, rows, columns, values, header.form == 6)
    except InputError as error:
        raise FileError(f"{lines.path}, line {lines.number[header.line]}: {error}") from error


def _complex_values(entries: _Entries, polar: bool) -> np.ndarray:
    """Complex values (n_entries,) of `entries`, from real and imaginary parts.

    If `polar`, these are magnitude and phase in degrees.
    """
    if polar:
        values: np.ndarray = entries.real * np.exp(1j * np.deg2rad(entries.imaginary))
        return values
    return entries.real + 1j * entries.imaginary


def _require_single(lines: BulkLines, header: _Header, entries: _Entries, rows: IntArray, columns: IntArray) -> None:
    """Raise `FileError`, with both lines, if an entry of the matrix comes twice.

    `rows` and `columns` (n_entries, 2) are node and component of the row and column of each entry; `lines`, `header`
    and `entries` give the words of the message.
    """
    order = np.lexsort((codes_of(rows), codes_of(columns)))
    is_repeated = (np.diff(codes_of(rows)[order]) == 0) & (np.diff(codes_of(columns)[order]) == 0)
    if is_repeated.any():
        first, second = order[np.argmax(is_repeated)], order[np.argmax(is_repeated) + 1]
        a, b = sorted((int(lines.number[entries.line[first]]), int(lines.number[entries.line[second]])))
        raise FileError(
            f"{lines.path}, line {b}: DMIG {header.name!r} gives the entry of {rows[first].tolist()} and "
            f"{columns[first].tolist()} (grid point, component) a second time, after line {a}; take one out"
        )


def _rectangular_matrix(name: str, rows: IntArray, columns: IntArray, values: np.ndarray) -> ImportedMatrix:
    """A rectangular matrix called `name` from entries; the nodes and components in them, sorted, are its axes.

    `rows` and `columns` (n_entries, 2) are node and component of each entry, `values` (n_entries,).
    """
    row_codes, row = np.unique(codes_of(rows), return_inverse=True)
    column_codes, column = np.unique(codes_of(columns), return_inverse=True)
    matrix = sparse.coo_array((values, (row, column)), (len(row_codes), len(column_codes)))
    return ImportedMatrix(name, matrix.tocsc(), tables_of(row_codes), tables_of(column_codes))


def file_text(path: Path, matrices: Sequence[ImportedMatrix], field: Field = "large") -> str:
    """DMIG cards of `matrices` as text, only the lower triangle of a symmetric one; `path` is for errors.

    Large fields hold twelve digits of a positive number, small ones five; free fields are written with all digits,
    which structid reads and a solver may round.

    Raises
    ------
    InputError
        If `field` is not "large", "small" or "free".
    FileError
        If a matrix has no numbering, or a name that is not 1 to 8 letters and digits.
    """
    if field not in ("large", "small", "free"):
        raise InputError(f"`field` must be 'large', 'small' or 'free', got {field!r}")
    text = []
    for item in matrices:
        if item.dofs is None:
            raise FileError(
                f"{path}: {item.name!r} has no node and component of its rows, which DMIG needs; give `dofs`"
            )
        if not 0 < len(item.name) <= 8 or not item.name.isalnum():
            raise FileError(f"{path}: the name {item.name!r} must have 1 to 8 letters and digits; rename the matrix")
        text.extend(_card_lines(item, item.dofs, field))
    return "\n".join([*text, ""])


def _card_lines(item: ImportedMatrix, dofs: IntArray, field: Field) -> list[str]:
    """Lines of the DMIG cards of the matrix `item`, header first, then one card for each column with entries.

    `dofs` (n_rows, 2) are node and component of its rows; `field` is "large", "small" or "free". Of a symmetric matrix
    only the lower triangle is written.
    """
    is_complex = np.iscomplexobj(item.matrix.data)
    rectangular = not item.is_square
    symmetric = not rectangular and abs(item.matrix - item.matrix.T).nnz == 0
    columns = item.columns if item.columns is not None else dofs
    form = 9 if rectangular else 6 if symmetric else 1
    count = f"{item.matrix.shape[1]:>8d}" if rectangular else ""
    kind = 4 if is_complex else 2
    name = item.name.upper()
    header = f"DMIG    {name:<8s}{0:>8d}{form:>8d}{kind:>8d}{0:>8d}"
    lines = [f"{header:<64s}{count}".rstrip() if count else header]
    if field == "free":
        lines = [",".join(("DMIG", name, "0", str(form), str(kind), "0", "", "", count.strip())).rstrip(",")]
    stored = sparse.csc_array(sparse.tril(item.matrix) if symmetric else item.matrix)
    stored.sort_indices()
    stored.eliminate_zeros()
    rows = dofs.tolist()
    for j in np.flatnonzero(np.diff(stored.indptr)).tolist():
        column_range = slice(stored.indptr[j], stored.indptr[j + 1])
        pairs = [rows[i] for i in stored.indices[column_range].tolist()]
        values = stored.data[column_range].tolist()
        lines.extend(_column_lines(name, columns[j].tolist(), pairs, values, field))
    return lines


def _column_lines(
    name: str, column: list[int], rows: list[list[int]], values: list[complex], field: Field
) -> list[str]:
    """Lines of the DMIG card of one column: node and component of the column, then those of each row with its value.

    `column` is (node, component), `rows` are those of the entries, and `values` are real or complex. `name` is that of
    the matrix; `field` is "small", "large" or "free", the format of the card.
    """
    if field == "free":
        groups = [f"{n},{c},{v.real!r},{v.imag!r}" for (n, c), v in zip(rows, map(complex, values), strict=True)]
        lines = [f"DMIG,{name},{column[0]},{column[1]},,{groups[0]}"]
        return lines + ["," + ",".join(groups[i : i + 2]) for i in range(1, len(groups), 2)]
    if field == "large":
        lines = [f"DMIG*   {name:<16s}{column[0]:>16d}{column[1]:>16d}"]
        for (n, c), value in zip(rows, values, strict=True):
            second = _fixed_width(value.imag, 16) if isinstance(value, complex) else ""
            lines.append(f"*       {n:>16d}{c:>16d}{_fixed_width(value.real, 16)}{second}")
        return lines
    texts = [
        f"{n:>8d}{c:>8d}{_fixed_width(value.real, 8)}{_fixed_width(value.imag, 8) if isinstance(value, complex) else ' ' * 8}"
        for (n, c), value in zip(rows, values, strict=True)
    ]
    lines = [f"DMIG    {name:<8s}{column[0]:>8d}{column[1]:>8d}{'':8s}{texts[0]}".rstrip()]
    return lines + [("+       " + "".join(texts[i : i + 2])).rstrip() for i in range(1, len(texts), 2)]


def _fixed_width(value: float, width: int) -> str:
    """`value` as text of `width` characters with as many digits as fit, the exponent without ``E``."""
    for digits in range(width - 3, 0, -1):
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        if "." not in mantissa:
            mantissa += "."
        text = mantissa + f"{int(exponent):+d}"
        if len(text) <= width:
            return text.rjust(width)
    return f"{value:.0e}".rjust(width)
