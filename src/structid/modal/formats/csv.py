"""Modes as CSV, one row (or column) a mode: what a spreadsheet opens, and what a table of published modes becomes."""

from __future__ import annotations

import csv
import io
import re
import unicodedata
from pathlib import Path
from typing import NamedTuple

import numpy as np

from structid.core.arrays import FloatArray, NumberArray
from structid.core.dof import Dof, parse_dof
from structid.core.errors import FileError, InputError
from structid.core.units import parse_frequency_unit
from structid.files import read_start
from structid.modal.modal_record import ModalRecord, Scaling, independent_errors, largest_entries, unit_largest
from structid.modal.poles.poles import modal_phase_collinearity
from structid.records.formats.csv.recognition import complex_parts, is_number

_NUMBERS = ("frequency_hz", "frequency_std_hz", "damping_ratio", "damping_std")
#: Bytes that tell what a table holds.
_HEAD = 16384
#: Columns, or lines where one mode is a column, among which frequencies and channels are looked for.
_MOST_COLUMNS = 500
_PARTS = ("real", "imaginary", "std")
_COUNTERS = ("mode", "no", "nr", "#", "mode no", "mode number", "mode nr", "channel", "dof", "sensor")
_FREQUENCY = ("frequency", "frequenz", "fréquence", "freq")
_DAMPING = ("damping ratio", "damping", "dämpfungsgrad", "dämpfung", "amortissement", "zeta", "xi", "ζ", "ξ")
#: Words for damping ratios that are in use for percentages too.
_RATIO_OR_PERCENT = ("damping", "dämpfung", "amortissement", "zeta", "xi", "ζ", "ξ")
_OTHER_DAMPING = re.compile(r"(q|quality factor|loss factor|eta|η|log(arithmic)? ?dec(rement)?)\b.*")
_STD = r"(std|std dev|standard deviation|deviation)"
#: Headers of frequencies and damping ratios in tables of other programs, blanks for points and underscores.
_OTHER_WORDS = re.compile(
    rf"(?P<before>{_STD}( of)? )?(natural |undamped |eigen)?(?P<quantity>{'|'.join((*_FREQUENCY, *_DAMPING))})(?P<after> {_STD})?"
    r"(?: ?(?:\[(?P<square>[^\]]*)\]|\((?P<round>[^)]*)\)|(?P<bare>hz|khz|rad/s|rpm|%)))?"
)
#: Units of damping: of ratios, and of critical damping in parts of a hundred.
_DAMPING_UNITS = {"-": 1.0, "1": 1.0, "%": 0.01}


def modes_csv(modes: ModalRecord) -> str:
    """Text of a CSV table of modes: a header, then one row for each mode.

    Columns are mode number, frequency (Hz), damping ratio, their standard deviations, MPC, scaling, then the shape by channel
    (``1X+``, or ``1X+ real`` and ``1X+ imaginary``) with its standard deviations (``1X+ std``). Unknown numbers are blank.
    """
    n, shapes = modes.n_modes, modes.mode_shapes
    std = np.full(2 * n, np.nan) if modes.covariance is None else np.sqrt(np.diag(modes.covariance))
    columns = [("mode", np.arange(1, n + 1)), ("frequency_hz", modes.frequency), ("frequency_std_hz", std[:n])]
    columns += [("damping_ratio", modes.damping_ratio), ("damping_std", std[n:])]
    columns += [("mpc", modal_phase_collinearity(shapes.astype(np.complex128))), ("scaling", np.full(n, modes.scaling))]
    for i, dof in enumerate(modes.channels):
        columns.append((f"{dof} real" if np.iscomplexobj(shapes) else str(dof), shapes[i].real))
        if np.iscomplexobj(shapes):
            columns.append((f"{dof} imaginary", shapes[i].imag))
        if modes.shape_std is not None:
            columns.append((f"{dof} std", modes.shape_std[i]))
    stream = io.StringIO()
    table = csv.writer(stream, lineterminator="\n")
    table.writerow([name for name, _ in columns])
    table.writerows([[_cell(values[k]) for _, values in columns] for k in range(n)])
    return stream.getvalue()


def _cell(value: object) -> str:
    if isinstance(value, float | np.floating):
        return repr(float(value)) if np.isfinite(value) else ""
    return str(value)


class _Table(NamedTuple):
    """Cells of a table of modes, one of `lines` a mode, under a header in the words of `modes_csv`.

    Numbers of columns in `factors` are multiplied by these. Whether the file `is_turned`, with one column a mode; `numbers` are
    the lines of the file, or columns, of the modes, and `notes` say what its header leaves open.
    """

    path: Path
    header: list[str]
    lines: list[list[str]]
    factors: dict[str, float]
    is_turned: bool
    numbers: list[int]
    notes: list[str]

    def locate(self, k: int, name: str) -> str:
        """Words on the position in the file of the value `name` of mode `k`."""
        return f"row `{name}`, {self.mode(k)}" if self.is_turned else f"{self.mode(k)}, column `{name}`"

    def mode(self, k: int) -> str:
        """Words on the line or column of mode `k`."""
        return f"{'column' if self.is_turned else 'line'} {self.numbers[k]}"


def _read_table(path: Path) -> _Table:
    """Table of modes in the text file at `path`, one row a mode, from commas, semicolons or tabs as separators.

    A table with one column a mode is transposed. Names of columns become those of this module, and decimal commas
    points (unless commas separate). `FileError` if it is no such table in UTF-8, lines differ in their number of cells,
    a column is doubled or in an unknown unit, decimal signs are mixed, or there is no column of frequencies or no mode.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
        separator = max((",", ";", "\t"), key=text.partition("\n")[0].count)
        rows = list(csv.reader(text.splitlines(), delimiter=separator, strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise FileError(f"{path}: is not a CSV table in UTF-8 ({error}); save it as CSV UTF-8") from error
    filled_rows = [i for i, row in enumerate(rows) if i == 0 or any(cell.strip() for cell in row)]
    numbers, rows = [i + 1 for i in filled_rows[1:]], [rows[i] for i in filled_rows]
    for number, row in zip(numbers, rows[1:], strict=True):
        if len(row) != len(rows[0]):
            raise FileError(f"{path}: line {number} has {len(row)} cells, the header {len(rows[0])}; mend the line")
    is_turned = any(_word_or_cell(row[0]) == "frequency_hz" and is_number(row[1]) for row in rows if len(row) > 1)
    if is_turned:
        numbers = list(range(2, len(rows[0]) + 1))
        rows = [list(column) for column in zip(*rows, strict=True)]
    try:
        words = [_canonical_column(cell) for cell in rows[0]]
    except InputError as error:
        raise FileError(f"{path}: {error}") from error
    header = [word.name for word in words]
    if "frequency_hz" not in header or len(rows) < 2:
        raise FileError(f"{path}: must have a column `frequency_hz` and one row a mode, got {', '.join(header[:8])}")
    doubled = [name for name in header if name and header.count(name) > 1]
    if doubled:
        raise FileError(f"{path}: has two columns `{doubled[0]}`; leave one out")
    lines = rows[1:]
    if separator != ",":
        _require_one_decimal_sign(path, lines)
        lines = [[cell.replace(",", ".") for cell in row] for row in lines]
    factors = {word.name: word.factor for word in words if word.factor != 1}
    return _Table(path, header, lines, factors, is_turned, numbers, [word.assumed for word in words if word.assumed])


def _require_one_decimal_sign(path: Path, lines: list[list[str]]) -> None:
    """Raise `FileError` if some numbers in the cells of `lines` have commas and others points, which may be of thousands."""
    numbers = [cell.strip() for row in lines for cell in row if is_number(cell)]
    with_comma, with_point = (
        next((cell for cell in numbers if sign in cell.removesuffix(".")), None) for sign in (",", ".")
    )  # "1." is the first
    if with_comma is not None and with_point is not None:
        raise FileError(
            f"{path}: has decimal commas, as in {with_comma}, and {with_point}, whose point may be that of thousands or of"
            " decimals; export all numbers alike, without thousands apart"
        )


class _Word(NamedTuple):
    """A column's name in this module, the factor to its unit, and words on an assumed unit."""

    name: str
    factor: float = 1.0
    assumed: str = ""


def _canonical_column(cell: str) -> _Word:
    """The module's name of a column, factor to its unit, and words on an assumed unit, from a header of any program.

    `cell` is the text of the header. Factors lead to Hz and to damping ratios; the words are "" where nothing is
    assumed. The name is "" for a complexity, which is not read, "mode" for a counter, and the text itself, with factor
    1, for any other column that is none of frequencies or damping.

    Raises
    ------
    InputError
        If it holds frequencies or damping in a unit that is not known.
    """
    text = _plain(cell)
    match = _OTHER_WORDS.fullmatch(text)
    if match is None:
        return _Word("mode" if text in _COUNTERS else "" if text.startswith("complexity") else cell.strip())
    quantity, std = match["quantity"], bool(match["before"] or match["after"])
    unit = next((match[name].strip() for name in ("square", "round", "bare") if match[name] is not None), None)
    if quantity in _DAMPING:
        if unit is not None and unit not in _DAMPING_UNITS:
            raise InputError(f"column {cell.strip()!r} is in a unit that is not known; write [%] or [-]")
        assumed = (
            "damping taken as a ratio, not in %" if unit is None and quantity in _RATIO_OR_PERCENT and not std else ""
        )
        return _Word("damping_std" if std else "damping_ratio", _DAMPING_UNITS[unit or "-"], assumed)
    name = "frequency_std_hz" if std else "frequency_hz"
    if unit is None:
        return _Word(name, 1.0, "" if std else "frequencies taken as Hz")
    return _Word(name, parse_frequency_unit(unit))


def _plain(cell: str) -> str:
    """A header in small letters, with blanks for points and underscores, and each letter with its accent as one sign."""
    return re.sub(r"[\s_.]+", " ", unicodedata.normalize("NFC", cell).lower()).strip()


def _word_or_cell(cell: str) -> str:
    """The module's word for a column with the header `cell`; the text itself for a column in a unit that is not known."""
    try:
        return _canonical_column(cell).name
    except InputError:
        return cell.strip()


def is_modes_table(path: Path) -> bool:
    """True if the first line or first column of a table names frequencies beside damping ratios or channels.

    False also if the file cannot be read, or states a unit that is none of these.
    """
    try:
        return _names_modes(read_start(path, _HEAD).decode("utf-8-sig", "replace").splitlines())
    except (OSError, InputError):
        return False


def _names_modes(head: list[str]) -> bool:
    """True if the first lines `head` of a table name frequencies of modes, and damping ratios or channels like ``1X+``.

    Names stand in the first line, or in the first cell of each line if modes are columns. `InputError` if frequencies
    or damping have an unknown unit.
    """
    if not any("freq" in plain or "fréq" in plain for plain in map(_plain, head)):
        return False
    separator = max((",", ";", "\t"), key=head[0].count)
    rows = [line.split(separator, _MOST_COLUMNS)[:_MOST_COLUMNS] for line in head[:_MOST_COLUMNS]]
    names = [_canonical_column(row[0])[0] for row in rows]
    is_turned = any(
        name == "frequency_hz" and len(row) > 1 and is_number(row[1]) for name, row in zip(names, rows, strict=True)
    )
    words = names if is_turned else [_canonical_column(cell)[0] for cell in rows[0]]
    return "frequency_hz" in words and ("damping_ratio" in words or any(map(_is_channel, words)))


def _is_channel(word: str) -> bool:
    """True if `word` is the name of a degree of freedom, such as ``1X+``."""
    try:
        parse_dof(word)
    except InputError:
        return False
    return True


def read_modes_csv(path: Path) -> ModalRecord:
    """Modes in the CSV table at `path`, by rising frequency: column ``frequency_hz``, and one for each channel.

    ``Frequency [Hz]``, ``Std. Frequency [Hz]``, ``Damping [%]`` and the like of other programs are understood, and a
    table with one column a mode. Standard deviations of shape entries are in columns such as ``1X+ std``. A shape entry
    that is blank or ``nan`` is unknown. Shapes get the largest entry 1 unless the column ``scaling`` says mass. Errors
    of frequencies and damping ratios count as independent; the covariance is None if no deviation is stated.

    Raises
    ------
    FileError
        If the file is not such a table, or a cell cannot be used; with its line and column.
    """
    table = _read_table(path)
    header, lines = table.header, table.lines
    frequency = _column(table, "frequency_hz")
    if np.isnan(frequency).any():
        where_blank = table.mode(int(np.argmax(np.isnan(frequency))))
        raise FileError(f"{path}: the mode of {where_blank} has no `frequency_hz`; give it, or leave the mode out")
    ratio = _column(table, "damping_ratio")
    if (ratio >= 1).any():
        k = int(np.argmax(ratio >= 1))
        raise FileError(
            f"{path}: {table.locate(k, 'damping_ratio')} must be a ratio below 1, got {ratio[k]:g}; write `Damping [%]` in the"
            " header where it is in %"
        )
    order = np.argsort(frequency, kind="stable")
    numbers = {name: _column(table, name)[order] for name in _NUMBERS}
    scaling = _scaling(path, header, lines)
    dofs = _channels(path, header)
    shapes, shape_std = _shapes(table, dofs)
    size = largest_entries(shapes, empty=1.0)
    if not size.all():
        raise FileError(
            f"{path}: {table.mode(int(np.argmin(size)))} has a mode shape of zeros; give it, or leave it blank where it is unknown"
        )
    if scaling == "mass" or np.allclose(size, 1.0, rtol=0, atol=1e-9):
        size = np.ones(len(lines))
    else:
        shapes = unit_largest(shapes)
    stds = np.concatenate([numbers["frequency_std_hz"], numbers["damping_std"]])
    return ModalRecord(
        numbers["frequency_hz"], numbers["damping_ratio"], shapes[:, order], dofs, scaling=scaling,
        source="; ".join([path.name, *table.notes]),
        covariance=None if np.isnan(stds).all() else independent_errors(stds),
        shape_std=None if shape_std is None else (shape_std / size)[:, order],
    )  # fmt: skip


def _column(table: _Table, name: str) -> FloatArray:
    """Values of the column `name` in its standard unit, (n_modes,); NaN for empty cells, ``nan`` or no column.

    `FileError` if a cell is neither a finite number nor ``nan``, or a frequency or deviation is negative.
    """
    values = np.full(len(table.lines), np.nan)
    if name in table.header:
        index, factor = table.header.index(name), table.factors.get(name, 1.0)
        remedy = "" if name == "frequency_hz" else "; leave it blank where it is not known"
        for k, row in enumerate(table.lines):
            text = row[index].strip()
            try:
                values[k] = float(text) * factor if text else np.nan
            except ValueError:
                is_halved = complex_parts(text) is not None and _is_channel(name)
                two = f"; write two columns, `{name} real` and `{name} imaginary`" if is_halved else remedy
                raise FileError(f"{table.path}: {table.locate(k, name)} must be a number, got {text!r}{two}") from None
            if np.isinf(values[k]):
                raise FileError(f"{table.path}: {table.locate(k, name)} must be finite, got {text}{remedy}")
            if name.endswith(("std", "_hz")) and values[k] < 0:
                raise FileError(f"{table.path}: {table.locate(k, name)} must not be negative, got {text}")
    return values


def _scaling(path: Path, header: list[str], lines: list[list[str]]) -> Scaling:
    """Scaling of the shapes, from the column `scaling`; "unit_largest" without such a column.

    `FileError` if rows differ or it is neither "mass" nor "unit_largest". `header` are the column names, `lines` the
    cells of each row.
    """
    stated = {row[header.index("scaling")].strip() for row in lines} if "scaling" in header else {"unit_largest"}
    if stated == {"mass"}:
        return "mass"
    if stated == {"unit_largest"}:
        return "unit_largest"
    raise FileError(f"{path}: column `scaling` must be unit_largest or mass, the same for all, got {sorted(stated)}")


def _channels(path: Path, header: list[str]) -> tuple[Dof, ...]:
    """Channels that have columns in the table, each once, in the order of the column names `header`.

    Columns of mode number, frequency, damping, MPC and scaling are passed over. `FileError` if any other is no channel
    such as ``1X+`` (with `real`, `imaginary` or `std` behind it), or two columns are of the same entries.
    """
    other_columns = {"", "mode", "mpc", "scaling", *_NUMBERS}
    channels: dict[Dof, None] = {}
    columns: dict[tuple[Dof, str], str] = {}
    for name in header:
        if name in other_columns:
            continue
        first, _, part = name.partition(" ")
        try:
            dof = parse_dof(first)
        except InputError as error:
            if _OTHER_DAMPING.fullmatch(_plain(name)):
                raise FileError(
                    f"{path}: column {name!r} is damping of another form; write `damping_ratio`, which is half the loss factor,"
                    " 1 / (2 Q), or for small damping the logarithmic decrement over 2 pi"
                ) from error
            raise FileError(f"{path}: column {name!r} is no channel ({error})") from error
        if part and part not in _PARTS:
            raise FileError(f"{path}: column {name!r} must end in {', '.join(_PARTS)}, or name the channel only")
        other = columns.setdefault((dof, part or "real"), name)
        if other is not name:
            raise FileError(f"{path}: columns {other!r} and {name!r} are of the same entries of {dof}; leave one out")
        channels[dof] = None
    return tuple(channels)


def _shapes(table: _Table, dofs: tuple[Dof, ...]) -> tuple[NumberArray, FloatArray | None]:
    """Mode shapes (n_channels, n_modes), real or complex, and the standard deviations of their entries, float or None.

    Rows are the channels `dofs`, whose columns in the table are ``1X+`` or ``1X+ real``, ``1X+ imaginary`` and ``1X+ std``. An
    entry without a real part is unknown, NaN. Shapes are complex if any cell holds an imaginary part; blank ones count as 0
    then. The deviations are None if no cell holds one.

    Raises `FileError` if a cell holds an imaginary part and the real part of that entry is blank or has no column.
    """
    names = {}
    for name in table.header:
        first, _, part = name.partition(" ")
        if first[:1].isdigit():
            names[parse_dof(first), part or "real"] = name
    rows: dict[str, list[FloatArray]] = {part: [] for part in _PARTS}
    for dof in dofs:
        for part in _PARTS:
            rows[part].append(_column(table, names.get((dof, part), "-")))
        halves = np.flatnonzero(np.isnan(rows["real"][-1]) & ~np.isnan(rows["imaginary"][-1]))
        if halves.size:
            where = table.locate(int(halves[0]), names.get((dof, "real"), f"{dof} real"))
            raise FileError(f"{table.path}: {where} is empty beside an imaginary part; give both, or neither")
    n_modes = len(_column(table, "-"))
    real, imaginary, std = (np.array(rows[part]).reshape(-1, n_modes) for part in _PARTS)
    shapes: NumberArray = real
    if not np.isnan(imaginary).all():
        shapes = real.astype(np.complex128)
        shapes.imag = np.where(np.isnan(imaginary), 0.0, imaginary)
    return shapes, None if np.isnan(std).all() else std
