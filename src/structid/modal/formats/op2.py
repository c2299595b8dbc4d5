"""Modes in the binary results of Nastran (``.op2``): eigenvectors with their eigenvalues, real or complex.

A file is a row of Fortran records. A record of one word is a marker: a positive one says how many words the next record has, a
negative one begins the next part of a table, 0 ends a table. Part 1 of a table is a trailer and part 2 its name; parts 3, 5 ...
are headings of 146 words, parts 4, 6 ... the data under them. Words have 4 bytes, or 8, in either order.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import FileError
from structid.modal.formats.printed import (
    RUN_AGAIN,
    ModeFileOptions,
    PrintedMode,
    PrintedModes,
    VectorKey,
    chosen_run,
    complex_values,
    oscillating,
    same_eigenvalue,
    undamped,
)

#: Tables of eigenvectors, those in basic axes first, and that of Patran, whose axes PARAM,OUGCORD chooses.
_BASIC, _OWN, _PATRAN = ("BOUGV1", "BOPHIG"), ("OUGV1", "OUG1", "OPHIG"), "OUGV1PAT"
_EIGENVALUES = ("LAMA", "BLAMA", "LAMAS")
_HEADING = 146
_APPROACH, _TABLE, _SUBCASE, _MODE, _FIRST, _SECOND, _FORMAT, _WIDTH = 0, 1, 3, 4, 5, 6, 8, 9
_REAL_MODES, _COMPLEX_MODES, _EIGENVECTORS = 2, 9, 7
_GRID = 1
_MAGNITUDE_PHASE = 3


@dataclass(frozen=True)
class _Words:
    """Byte order and size of the binary words of a file."""

    order: str
    size: int

    def integers(self, data: bytes) -> np.ndarray:
        return np.frombuffer(data, dtype=f"{self.order}i{self.size}")

    def reals(self, data: bytes) -> np.ndarray:
        return np.frombuffer(data, dtype=f"{self.order}f{self.size}")

    def text(self, data: bytes) -> str:
        """The text in `data`, four letters in each word, of 4 bytes or 8; blanks around it are dropped."""
        letters = np.frombuffer(data, dtype=np.uint8).reshape(-1, self.size)[:, :4]
        return letters.tobytes().decode("latin-1").strip()


@dataclass
class _Table:
    """A table of a file: its name and the data of its parts from the third on."""

    name: str
    parts: list[bytes] = field(default_factory=list)


def op2_modes(path: Path, options: ModeFileOptions) -> PrintedModes:
    """Vibration modes in a Nastran op2 file, in the units of the model; no mode if it has no vectors.

    `options` choose the subcase, and real or complex modes where the file has both. Eigenvalues are s in rad/s, of
    complex modes those with a positive imaginary part; generalized masses are NaN unless the file's table has the same
    eigenvalue.

    Raises
    ------
    FileError
        If the file is cut short or is none, several runs have modes, a vector is stored twice, or `options` name a deck
        and all vectors are in the table OUGV1PAT, which does not say their axes.
    """
    content = path.read_bytes()
    words = _words_of(path, content)
    tables = list(_tables(path, content, words))
    names = {table.name for table in tables}
    group = next((group for group in (_BASIC, _OWN, (_PATRAN,)) if names & set(group)), ())
    if options.deck is not None and group == (_PATRAN,):
        raise FileError(
            f"{path}: holds its vectors in table OUGV1PAT alone, whose directions PARAM,OUGCORD chooses and the file does not say;"
            " leave `deck` out where that is BASIC, else write OUGV1 (PARAM,POST,-1)"
        )
    vectors: dict[VectorKey, PrintedMode] = {}
    squares: dict[VectorKey, complex] = {}
    for table in tables:
        if table.name in group:
            for key, value, mode in _vectors(path, table, words, 0 if group == _BASIC else -1):
                if key in vectors:
                    raise FileError(
                        f"{path}: has the vector of mode {key.mode} ({key.run}) twice, as of several superelements or tables; write"
                        " one of them"
                    )
                vectors[key], squares[key] = mode, value
    if not vectors:
        return PrintedModes([])
    keys = chosen_run(path, list(vectors), options)
    notes: tuple[str, ...] = ()
    if keys[0].is_complex:
        kept, notes = oscillating(path, keys, [squares[key] for key in keys])
    else:
        kept = list(zip(keys, undamped(path, [squares[key].real for key in keys]), strict=True))
    masses = _generalized_masses(tables, words)
    modes = []
    for key, s in kept:
        square, mass = masses.get((key.subcase, key.mode), masses.get((0, key.mode), (np.nan, np.nan)))
        is_same = not key.is_complex and same_eigenvalue(square, squares[key].real)
        modes.append(replace(vectors[key], eigenvalue=s, generalized_mass=mass if is_same else np.nan))
    return PrintedModes(modes, notes)


def _words_of(path: Path, content: bytes) -> _Words:
    """Byte order and word size of the op2 file with this `content`; `FileError` if it does not begin as such a file."""
    for size in (4, 8):
        for order in "<>":
            if content[:4] == np.array(size, dtype=f"{order}i4").tobytes():
                return _Words(order, size)
    raise FileError(
        f"{path}: does not begin as a binary file of Nastran's results does; write it again (PARAM,POST,-1)"
    )


def _records(path: Path, content: bytes, words: _Words) -> Iterator[bytes]:
    """Fortran records of the file `content`, each stored between two copies of its length.

    `words` are byte order and word size. `FileError` if a record is cut short; its message begins with `path`.
    """
    offset, length_type = 0, f"{words.order}i4"
    while offset < len(content):
        head = content[offset : offset + 4]
        length = int(np.frombuffer(head, dtype=length_type)[0]) if len(head) == 4 else -1
        if length < 0 or length % words.size or content[offset + 4 + length : offset + 8 + length] != head:
            raise FileError(
                f"{path}: a record at byte {offset} is cut short or damaged; copy the file again, or {RUN_AGAIN}"
            )
        yield content[offset + 4 : offset + 4 + length]
        offset += 8 + length


def _tables(path: Path, content: bytes, words: _Words) -> Iterator[_Table]:
    """Tables of the op2 file `content` in the file's order: name, and the data in bytes of each part from the third on.

    Parts alternate: heading, then values. Tables without a name (matrices) are left out. `FileError` if the file is cut
    short or a record has the wrong length. `words` are byte order and word size; `path` is for errors.
    """
    records = _records(path, content, words)
    table: _Table | None = None
    part = 0
    for record in records:
        if len(record) != words.size:
            raise FileError(f"{path}: a record of {len(record)} bytes stands where a marker must; {RUN_AGAIN}")
        marker = int(words.integers(record)[0])
        if marker > 0:
            data = next(records, b"")
            if len(data) not in (
                marker * words.size,
                (marker + 1) * words.size,
            ):  # columns of matrices have their row besides
                raise FileError(f"{path}: a record has {len(data)} bytes instead of {marker * words.size}; {RUN_AGAIN}")
            if table is None:
                table, part = _Table(words.text(data) if marker == 2 else ""), 0
            elif part >= 3 and not (marker == 1 and not table.parts[-1]):  # the kind of a part stands before its data
                table.parts[-1] += data
        elif marker < 0 and table is not None:
            part = -marker
            if part >= 3:
                table.parts.append(b"")
        elif marker == 0 and table is not None:
            if table.name:
                yield table
            table = None
    if table is not None and table.name:
        raise FileError(f"{path}: ends within its table {table.name}; the file is cut short, {RUN_AGAIN}")


def _vectors(path: Path, table: _Table, words: _Words, system: int) -> Iterator[tuple[VectorKey, complex, PrintedMode]]:
    """Key, eigenvalue (omega^2, or s of complex modes) and mode of each eigenvector in a table, in the table's order.

    Values are (n_points, 6), complex if the table says so; other results of the table are passed over. `system` is the
    number of the coordinate system of the vectors, -1 if not known; `words` are byte order and word size of the file.
    The `eigenvalue` of the mode is the one returned. `FileError` if vectors are sorted by points, damaged or not
    finite.
    """
    for heading, data in zip(table.parts[0::2], table.parts[1::2], strict=False):
        if len(heading) != _HEADING * words.size:
            continue
        integers, reals = words.integers(heading), words.reals(heading)
        analysis, sort, kind = integers[_APPROACH] // 10, integers[_TABLE] // 1000, integers[_TABLE] % 1000
        if kind != _EIGENVECTORS or analysis not in (_REAL_MODES, _COMPLEX_MODES):
            continue
        if sort & 2:
            raise FileError(f"{path}: its vectors are sorted by points (SORT2); write them by modes (SORT1)")
        mode, width = int(integers[_MODE]), int(integers[_WIDTH])
        is_complex = width == 14
        if width not in (8, 14) or len(data) % (width * words.size):
            raise FileError(
                f"{path}: the vector of mode {mode} has lines of {width} words, or ends within one; {RUN_AGAIN}"
            )
        texts = (f"{reals[_FIRST]:.6g}", f"{reals[_SECOND]:.6g}") if is_complex else (f"{reals[_FIRST]:.6g}",)
        key = VectorKey(int(integers[_SUBCASE]), None, mode, texts, analysis == _COMPLEX_MODES)
        value = complex(reals[_FIRST], reals[_SECOND]) if analysis == _COMPLEX_MODES else complex(reals[_FIRST])
        rows = words.integers(data).reshape(-1, width)
        table_of_reals: FloatArray = words.reals(data).reshape(-1, width).astype(np.float64)
        is_grid = rows[:, 1] == _GRID
        values = table_of_reals[is_grid, 2:8]
        if not np.isfinite(table_of_reals[is_grid, 2:]).all():
            raise FileError(f"{path}: the vector of mode {mode} holds NaN or infinite values; {RUN_AGAIN}")
        shape = (
            complex_values(values, table_of_reals[is_grid, 8:14], integers[_FORMAT] == _MAGNITUDE_PHASE)
            if is_complex
            else values
        )
        nodes = (rows[is_grid, 0] // 10).astype(np.int64)
        n_scalar = int((~is_grid).sum())
        yield key, value, PrintedMode(value, nodes, shape, np.full(len(nodes), system), n_scalar=n_scalar)


def _generalized_masses(tables: list[_Table], words: _Words) -> dict[tuple[int | None, int], tuple[float, float]]:
    """Eigenvalue omega^2 and generalized mass, by (subcase, mode number), from the eigenvalue tables of a file.

    Numbers are in the units of the model; the subcase is 0 if the file does not state one. Modes are numbered from 1,
    as in the file. `words` are byte order and word size.
    """
    masses: dict[tuple[int | None, int], tuple[float, float]] = {}
    for table in tables:
        if table.name not in _EIGENVALUES:
            continue
        for heading, data in zip(table.parts[0::2], table.parts[1::2], strict=False):
            if len(heading) == _HEADING * words.size and len(data) % (7 * words.size) == 0:
                subcase = int(words.integers(heading)[_SUBCASE])
                rows = zip(words.integers(data).reshape(-1, 7)[:, 0], words.reals(data).reshape(-1, 7), strict=True)
                masses |= {(subcase, int(mode)): (float(row[2]), float(row[5])) for mode, row in rows}
    return masses
