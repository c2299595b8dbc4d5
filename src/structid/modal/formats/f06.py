"""Modes in the listings of MSC, NX and COSMIC Nastran and of MYSTRAN (``.f06``): vectors page after page, real or complex.

A row is read only below the title of a vector and the names of its columns; any other title, page or line ends the table.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from structid.core.arrays import NumberArray
from structid.core.errors import FileError
from structid.files.uff.datasets import real_number
from structid.modal.formats.printed import (
    RUN_AGAIN,
    ModeFileOptions,
    PrintedMode,
    PrintedModes,
    VectorKey,
    chosen_run,
    complex_values,
    oscillating,
    parse_numbers,
    same_eigenvalue,
    undamped,
)

_REAL = r"[-+]?\d*\.\d*(?:[EDed]?[-+]\d+)?"
#: A printed number: with a point and, but for 0.0, an exponent, so that one that is cut short is told.
_NUMBER = re.compile(
    r"(?:[-+]?(?:\d+\.\d*|\.\d+)(?:[EDed][-+]?\d+|[-+]\d+)|[-+]?0?\.0*|[-+]?(?:nan|inf(?:inity)?))$", re.IGNORECASE
)
_PHASE = re.compile(r"[-+]?\d+\.\d*(?:[EDed]?[-+]\d+)?$")
_PAGE = re.compile(r"^1.*\bPAGE\s+\d+\s*$")
_SPACED = re.compile(r"(?:\b[A-Z] ){4}")
_FATAL = re.compile(r"^[\s01]*(?:(?:\*\*\*|\^\^\^) (?:USER|SYSTEM) FATAL\b|\*ERROR\s+\d+:)")
_RUN = {name: re.compile(rf"\b{name}\s+(\d+)\s*$") for name in ("SUBCASE", "SUPERELEMENT")}
_REAL_TABLE = re.compile(r"\bR E A L\s+E I G E N V A L U E S\s*$")
_TABLE_ROW = re.compile(rf"^\s*(\d+)\s+(\d+)((?:\s+{_REAL}){{5}})\s*$")
_BUCKLING = re.compile(r"buckling load factors", re.IGNORECASE)
_EIGENVALUE = re.compile(rf"^\s+EIGENVALUE =\s*({_REAL})(?:\s*\(CYCLIC FREQUENCY =\s*({_REAL})\s*HZ\))?")
_COMPLEX_EIGENVALUE = re.compile(rf"^\s+COMPLEX EIGENVALUE =\s*({_REAL})\s*,\s*({_REAL})")
_CYCLES = re.compile(rf"^\s+CYCLES =\s*({_REAL})")
_VECTOR = re.compile(r"\b(R E A L|C O M P L E X)\s+E I G E N V E C T O R\s+N ?O ?\.\s*(\d+)\s*$")
_MYSTRAN_VECTOR = re.compile(r"^\s+E I G E N V E C T O R\s*$")
_MYSTRAN_MODE = re.compile(r"^\s*OUTPUT FOR EIGENVECTOR\s+(\d+)")
_POINTS = re.compile(r"^\s*POINT ID\.\s+TYPE\s+T1\b")
_GRIDS = re.compile(r"^\s*GRID\s+COORD\s+T1\b")
_POINT_ROW = re.compile(r"^[ 0]\s*(\d+)\s+([A-Z])(?:\s|$)")
_GRID_ROW = re.compile(r"^\s+(\d+)\s+(\d+)\s+(?=[-+.\d*])")
#: Columns from the letter of a point to its first number, and of a number.
_TO_FIRST, _WIDTH = 4, 15
_FORMS = {"(REAL/IMAGINARY)": False, "(MAGNITUDE/PHASE)": True}


@dataclass
class _Vector:
    """Values on the pages of one vector."""

    mode: int
    cycles: str | None
    is_complex: bool
    line: int
    is_polar: bool | None = None
    rows: dict[int, list[list[str]]] = field(default_factory=dict)
    systems: dict[int, int] = field(default_factory=dict)
    scalars: set[int] = field(default_factory=set)
    has_fluid: bool = False


@dataclass
class _Page:
    """Heading of a table: run and eigenvalue."""

    subcase: int | None = None
    superelement: int | None = None
    eigenvalue: tuple[str, ...] = ()
    cycles: str | None = None
    mode: int | None = None  # of MYSTRAN


class _Listing:
    """Reader of a listing, line by line; `vectors` and `table` hold the values read so far."""

    def __init__(self, path: Path) -> None:
        """A reader that has read no line of the listing at `path` yet."""
        self.path = path
        self.vectors: dict[VectorKey, _Vector] = {}
        #: Eigenvalue, cycles and generalized mass of each row, by the number of the mode.
        self.table: dict[int, list[tuple[float, float, float]]] = {}
        self.page = _Page()
        self.state = ""  # "table", "title", "rows" or "second": the line of imaginary parts or phases
        self.since_page = 99
        self.vector: _Vector | None = None
        self.node = -1  # of a row whose second line follows; -1 where the row is left out
        self.first_column = 0
        self.repeated: list[list[str]] = []  # second lines of the point as it was printed before
        self.last_row = 0

    def read(self, lines: Sequence[str]) -> None:
        for number, line in enumerate(lines, 1):
            self._read_line(number, line)

    def _read_line(self, number: int, line: str) -> None:
        """Read one line (`number` from 1) according to the state that earlier lines have left; updates `vectors` and `table`.

        `FileError` if it reports a fatal error of the run or is damaged.
        """
        self.since_page += 1
        if self.state == "second":
            self._read_second(number, line)
        elif self.state == "rows" and self._read_row(number, line):
            if line.strip():
                self.last_row = number
        elif not line.strip():
            return
        elif _PAGE.match(line):
            self.page, self.state, self.since_page = _Page(), "", 0
        elif _FATAL.match(line):
            raise FileError(f"{self.path}, line {number}: {' '.join(line.split())[:100]}; correct the deck")
        elif _SPACED.search(line):
            self._read_title(number, line)
        elif self.state == "table":
            self._read_table(number, line)
        elif self.state == "title":
            self._read_columns(number, line)
        else:
            self._read_context(line)

    def _read_context(self, line: str) -> None:
        """Read subcase, superelement, eigenvalue or mode number from a `line` above a title into `page`.

        Other lines are ignored. Subcase and superelement count only within three lines of a page's begin or in a line
        that begins with 0, which first clears the subcase.
        """
        if line.startswith("0"):  # the last of the lines that head a page, which some keep without the others
            self.page.subcase = None
        if line.startswith("0") or self.since_page <= 3:
            for name, pattern in _RUN.items():
                if match := pattern.search(line):
                    setattr(self.page, name.lower(), int(match[1]))
        if match := _EIGENVALUE.match(line):
            self.page.eigenvalue, self.page.cycles = (match[1],), match[2]
        elif match := _COMPLEX_EIGENVALUE.match(line):
            self.page.eigenvalue = (match[1], match[2])
        elif match := _MYSTRAN_MODE.match(line):
            self.page.mode = int(match[1])

    def _read_title(self, number: int, line: str) -> None:
        """Read a title in spaced letters, line `number` (from 1) of the listing with text `line`, and set the state.

        The title of the table of real eigenvalues begins that table; that of an eigenvector begins the vector, added to
        `vectors` with the context that earlier lines have left; any other title ends both.
        """
        self.state = ""
        if _REAL_TABLE.search(line):
            self.state = "table"
            return
        match = _VECTOR.search(line)
        if match is None and not (_MYSTRAN_VECTOR.match(line) and self.page.mode is not None):
            return
        cycles = _CYCLES.match(line)
        is_complex = match is not None and match[1].startswith("C")
        mode = int(match[2]) if match else self.page.mode or 0
        page = self.page
        key = VectorKey(page.subcase, page.superelement, mode, page.eigenvalue, is_complex)
        new = _Vector(mode, cycles[1] if cycles else page.cycles, is_complex, number)
        self.vector, self.state = self.vectors.setdefault(key, new), "title"
        self.page = _Page(page.subcase, page.superelement)

    def _read_table(self, number: int, line: str) -> None:
        """Read line `number` (from 1) of the listing, a row of the eigenvalue table, and add it to `table`.

        Any other line is read as one above a title. `FileError` if it is of a buckling analysis.
        """
        if match := _TABLE_ROW.match(line):
            _, _, cycles, mass, _ = (real_number(text) for text in match[3].split())
            self.table.setdefault(int(match[1]), []).append((real_number(match[3].split()[0]), cycles, mass))
        elif _BUCKLING.search(line):
            raise FileError(
                f"{self.path}, line {number}: the eigenvalues are buckling load factors; run normal modes (SOL 103)"
            )
        else:
            self._read_context(line)

    def _read_columns(self, number: int, line: str) -> None:
        """Read a line between the title of a vector and its rows: form of complex numbers, or column headings.

        `FileError` if the form is not stated or columns are not those of points sorted by mode. `number` is that of the
        line in the file, `line` its text.
        """
        assert self.vector is not None
        text = line.strip()
        if text in _FORMS:
            self.vector.is_polar = _FORMS[text]
        elif _POINTS.match(line) or _GRIDS.match(line):
            if self.vector.is_complex and self.vector.is_polar is None:
                raise FileError(
                    f"{self.path}, line {number}: a complex vector must be in (REAL/IMAGINARY) or (MAGNITUDE/PHASE), and the"
                    f" listing says neither; {RUN_AGAIN}"
                )
            self.state = "rows"
        elif text.startswith("HARMONIC"):  # pressures on rings of a fluid
            self.vector.has_fluid, self.state = True, ""
        elif not text.startswith("(in global"):
            raise FileError(
                f"{self.path}, line {number}: a vector is printed in columns {' '.join(text.split())[:60]!r}, not by points; let"
                " the solver print it sorted by mode (SORT1), of a model of grid points"
            )

    def _read_row(self, number: int, line: str) -> bool:
        """Read a row of the present vector from a line; True if it is a row or blank, and the vector goes on.

        Any other text but ``SYS`` ends the vector. `number` is that of the line, from 1. Scalar points are counted
        only. `FileError` if the row is damaged or contradicts an earlier print of the point.
        """
        assert self.vector is not None
        if match := _POINT_ROW.match(line):
            node, kind = int(match[1]), match[2]
            fields = self._six_numbers(number, line, match.start(2) + _TO_FIRST, kind == "G")
        elif match := _GRID_ROW.match(line):
            node, kind, fields = int(match[1]), "G", line[match.end() :].split()
            if len(fields) != 6 or not all(map(_NUMBER.match, fields)):
                raise self._broken(number, line)
            if self.vector.systems.setdefault(node, int(match[2])) != int(match[2]):
                raise self._broken(number, line)
        else:
            if line.strip() not in ("", "SYS"):
                self.state = ""
            return not line.strip()
        if kind != "G":
            self.vector.scalars.add(node)
            self.node = -1
        else:
            parts = self.vector.rows.setdefault(node, [])
            if parts and parts[0] != fields:
                raise self._two_motions(number, node)
            self.repeated = parts[1:]
            self.vector.rows[node] = [fields]
            self.node = node
        if self.vector.is_complex:
            self.state = "second"
        return True

    def _read_second(self, number: int, line: str) -> None:
        """Read the second line of a complex eigenvector row, imaginary parts or phases, and add it to the point's row.

        The second line of a scalar point is passed over. `FileError` if the line is damaged or contradicts an earlier
        print of the point. `number` is that of the line in the file.
        """
        assert self.vector is not None
        self.state = "rows"
        if self.node < 0:
            return
        fields = self._six_numbers(number, line, self.first_column, True, self.vector.is_polar is True)
        if self.repeated and self.repeated != [fields]:
            raise self._two_motions(number, self.node)
        self.vector.rows[self.node].append(fields)
        self.last_row = number

    def _six_numbers(self, number: int, line: str, first: int, is_grid: bool, is_phase: bool = False) -> list[str]:
        """The six numbers of a row as texts, from columns of 15 that begin at column index `first`; "" for a blank one.

        Where the row is not set in these columns, its words are taken in order. `is_grid` says that the
        row is of a grid point, which has six numbers or the first three, `is_phase` that they are phases. `FileError`
        if a text is no number or some are missing. `line` is the text and `number` that of the line in the file.
        `first_column` is set.
        """
        self.first_column = first
        fields = [line[first + k * _WIDTH : first + (k + 1) * _WIDTH].strip() for k in range(6)]
        tail = line[first + 6 * _WIDTH :].strip()
        words = line[first - 1 :].split()
        if [text for text in fields if text] != words or tail:
            fields = words + [""] * (6 - len(words))
        number_form = _PHASE if is_phase else _NUMBER
        if not all(number_form.match(text) for text in fields if text):
            raise self._broken(number, line)
        n_given = sum(map(bool, fields))
        if is_grid and not (n_given == 6 or (n_given == 3 and all(fields[:3]))):
            raise self._broken(number, line)
        return fields

    def _two_motions(self, number: int, node: int) -> FileError:
        assert self.vector is not None
        return FileError(
            f"{self.path}, line {number}: point {node} is printed twice in mode {self.vector.mode} with different"
            " motions, as of several runs or of parts of a cyclic or substructured model; keep the vectors of one of them"
        )

    def _broken(self, number: int, line: str) -> FileError:
        return FileError(
            f"{self.path}, line {number}: must hold a point and its six motions, got {line.strip()[:80]!r}; the file is damaged"
            f" or cut short, {RUN_AGAIN}"
        )


def f06_modes(path: Path, text: str, options: ModeFileOptions) -> PrintedModes:
    """Vibration modes in the `text` of a Nastran f06 listing, in the units of the model; no mode if it has no vectors.

    `options` choose the subcase, and real or complex modes where the listing has both. Eigenvalues are s in rad/s, of
    complex modes those with a positive imaginary part; generalized masses are NaN where none is printed. `path` is for
    errors.

    Raises
    ------
    FileError
        If the run failed, is one of buckling or several runs have modes, a vector has no frequency, or a row is
        damaged.
    """
    lines = text.splitlines()
    listing = _Listing(path)
    listing.read(lines)
    if lines and listing.last_row == len(lines) and not text.endswith(("\n", "\r")):
        raise FileError(f"{path}, line {len(lines)}: ends within a row; the file is cut short, {RUN_AGAIN}")
    vectors = {key: v for key, v in listing.vectors.items() if v.rows or v.scalars or v.has_fluid}
    if not vectors:
        return PrintedModes([])
    for key, vector in vectors.items():
        if len(key.eigenvalue) == 1 and vector.cycles is None:
            raise FileError(
                f"{path}, line {vector.line}: mode {key.mode} has an eigenvalue ({key.eigenvalue[0]}) but no frequency, as of a"
                " buckling analysis; run normal modes (SOL 103)"
            )
    keys = chosen_run(path, list(vectors), options)
    if keys[0].is_complex:
        for key in keys:
            if len(key.eigenvalue) != 2:
                raise FileError(f"{path}, line {vectors[key].line}: mode {key.mode} has no eigenvalue; {RUN_AGAIN}")
        modes, notes = oscillating(path, keys, [complex(*map(real_number, key.eigenvalue)) for key in keys])
        return PrintedModes([_printed_mode(path, key, vectors[key], s, np.nan) for key, s in modes], notes)
    s, masses, notes = _real_eigenvalues(path, listing, keys)
    parts = zip(keys, s, masses, strict=True)
    return PrintedModes([_printed_mode(path, key, vectors[key], value, mass) for key, value, mass in parts], notes)


def _real_eigenvalues(
    path: Path, listing: _Listing, keys: Sequence[VectorKey]
) -> tuple[list[complex], list[float], tuple[str, ...]]:
    """Eigenvalues s = i omega (rad/s) and generalized masses of the undamped modes `keys`, in their order, and notes.

    Eigenvalues come from the pages of the vectors or, where these print none, from the eigenvalue table; masses from
    the row of the table with the same eigenvalue, NaN where there is none. A note names the first page that contradicts
    the table. `FileError` if a mode has no eigenvalue or one that contradicts its frequency, one is negative, or all
    masses are 0, as in a buckling analysis. `listing` is the reader with vectors and table; `path` is for errors.
    """
    squares: list[float] = []
    masses: list[float] = []
    notes: list[str] = []
    for key in keys:
        vector, rows = listing.vectors[key], listing.table.get(key.mode, [])
        where = f"{path}, line {vector.line}: mode {key.mode}"
        if not key.eigenvalue:  # MYSTRAN prints it in the table alone, others where CYCLES stands by itself
            if vector.cycles is None and len(rows) != 1:
                raise FileError(f"{where} has no eigenvalue{' of its own' if rows else ''}; {RUN_AGAIN}")
            square = rows[0][0] if vector.cycles is None else (2 * np.pi * real_number(vector.cycles)) ** 2
        else:
            square = real_number(key.eigenvalue[0])
            cycles = real_number(vector.cycles or "")
            if not same_eigenvalue((2 * np.pi * cycles) ** 2, abs(square)) and abs(square) > 1e-6:
                raise FileError(
                    f"{where} has the eigenvalue {square:g} and {cycles:g} cycles, which is not its root over 2 pi; the"
                    " file is damaged, or of no vibration analysis"
                )
        matching = [row for row in rows if same_eigenvalue(row[0], square) or abs(row[0] - square) < 1e-6]
        if rows and not matching and not notes:
            notes.append(
                f"the page of mode {key.mode} has the eigenvalue {square:g}, a table of eigenvalues {rows[0][0]:g}: the page is"
                " followed"
            )
        squares.append(square)
        masses.append(matching[0][2] if matching else np.nan)
    if masses and not any(masses):
        raise FileError(f"{path}: all generalized masses are 0, as of a buckling analysis; run normal modes")
    return undamped(path, squares), masses, tuple(notes)


def _printed_mode(path: Path, key: VectorKey, vector: _Vector, eigenvalue: complex, mass: float) -> PrintedMode:
    """`PrintedMode` from the rows of a vector: values (n_points, 6), complex for a complex vector, NaN where blank.

    `key` names the mode in errors, `eigenvalue` is s in rad/s, `mass` the generalized mass (NaN if not printed).
    `FileError` if a row is incomplete or a value is not finite.
    """
    rows = list(vector.rows.values())
    n_parts = 2 if vector.is_complex else 1
    if any(len(parts) != n_parts for parts in rows):
        raise FileError(f"{path}: a row of mode {key.mode} is incomplete; the file is cut short, {RUN_AGAIN}")
    texts = [text for row in rows for part in row for text in part]
    parts = parse_numbers(path, texts).reshape(len(rows), n_parts, 6)
    nodes = np.array(list(vector.rows), dtype=np.int64)
    if not np.isfinite(parts).all():
        point = nodes[np.argmin(np.isfinite(parts).all(axis=(1, 2)))]
        raise FileError(f"{path}: the shape of mode {key.mode} is NaN or infinite at point {point}; {RUN_AGAIN}")
    parts[np.array([not text for text in texts], dtype=bool).reshape(parts.shape)] = np.nan
    values: NumberArray = parts[:, 0]
    if vector.is_complex:
        values = complex_values(parts[:, 0], parts[:, 1], vector.is_polar is True)
    systems = np.array([vector.systems.get(int(node), -1) for node in nodes], dtype=np.int64)
    return PrintedMode(eigenvalue, nodes, values, systems, mass, len(vector.scalars))
