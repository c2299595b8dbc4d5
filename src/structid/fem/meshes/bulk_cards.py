"""Nastran bulk data cards as tables of fields, with included files and replication (`=`, `*n`) written out.

Coordinate systems, of definition and of displacement, are those of CORD1 and CORD2 cards.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import FileError
from structid.fem.importers.bulk_lines import BulkLines, Origins, bulk_lines
from structid.fem.importers.fixed_fields import FieldError, as_real, chunks, is_blank, real_numbers, whole_numbers
from structid.fem.meshes.coordinate_systems import CoordinateSystem, axes_of_points
from structid.files import require_readable

_INCLUDE = re.compile(rb"\s*INCLUDE\s+(?:'([^']*)'|\"([^\"]*)\"|([^$]+))", re.IGNORECASE)
_SYMBOL = re.compile(r"([A-Za-z_]\w+):(.*)", re.DOTALL)  # one letter is a drive of Windows
_BEGIN = re.compile(rb"BEGIN\b\s*(?:BULK\b)?\s*(\w*)\s*=?\s*(\w*)")
_CARD_NAME = re.compile(rb"^ {0,7}([A-Za-z]\w{0,7})(?=[*, \t\r\n]|$)", re.MULTILINE)
_NO_BEGIN = "there is a CEND but no BEGIN BULK behind it; export it again, or add the line"
_NO_END = "there is no ENDDATA, so that a deck that was cut short between two cards would not show"
_MOST_INCLUDES = 20
_STEP = re.compile(rb"\*\(?\s*([-+]?[\d.][\d.eEdD+-]*)\s*\)?$")
_REPEAT = re.compile(rb"=\s*\(?\s*(\d+)\s*\)?$")
_WHOLE = re.compile(rb"[-+]?\d+$")
_MOST_CARDS = 5_000_000
_REMEDY = "write the cards out"
SYSTEM_CARDS = ("CORD1R", "CORD1C", "CORD1S", "CORD2R", "CORD2C", "CORD2S")
_CP, _CD, _PS = 1, 5, 6


@dataclass(frozen=True, eq=False)
class BulkText:
    """The bulk data of a deck.

    Attributes
    ----------
    path : Path
    content : bytes
        Included files in their places, replicated cards written out.
    case_control : bytes
        The lines before BEGIN BULK.
    origins : Origins
        File and line of each line of `content`.
    has_end : bool
        Whether there is an ENDDATA.
    """

    path: Path
    content: bytes
    case_control: bytes
    origins: Origins
    has_end: bool

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user on how the deck was read."""
        return () if self.has_end else (_NO_END,)

    def count_cards(self) -> Counter[str]:
        """Number of cards by name."""
        return Counter(name.decode().upper() for name in _CARD_NAME.findall(self.content))


@dataclass(eq=False)
class _Lines:
    """Lines with the file and number of each."""

    paths: list[Path]
    text: list[bytes]
    file: list[int]
    number: list[int]

    def location(self, row: int) -> str:
        """File and number of a line."""
        return f"{self.paths[self.file[row]]}, line {self.number[row]}"


def bulk_text(path: Path, linked: Mapping[str, Path] | None = None) -> BulkText:
    """The bulk data of the deck at `path`, with included files in place and replicated cards written out.

    Included files are also looked for in `linked`, by name. The result has the text, what stands before it (case
    control), and the file and line that each line comes from. Without BEGIN BULK and CEND the whole file is bulk data;
    ENDDATA ends it.

    Raises
    ------
    FileError
        If case control is not followed by bulk data, superelements have sections of bulk data of their own, or an
        included file cannot be read.
    """
    lines = _Lines([], [], [], [])
    _take_lines(lines, path, path.parent, linked or {}, 0)
    begin, stop, has_end, has_case = -1, len(lines.text), False, False
    for row, line in enumerate(lines.text):
        word = line.strip().upper()
        if word.startswith(b"BEGIN") and (match := _BEGIN.match(word)):
            _require_one_section(lines, row, match, begin >= 0)
            begin = row if begin < 0 else begin
        elif word.startswith(b"ENDDATA"):
            stop, has_end = row, True
            break
        has_case |= word.split(b"$")[0].strip() == b"CEND"
    if begin < 0 and has_case:
        raise FileError(f"{path}: is no whole deck: {_NO_BEGIN}")
    rows = slice(begin + 1, stop)
    text, source = _expand_replication(lines.text[rows], lambda index: lines.location(begin + 1 + index))
    chosen = np.array(source, dtype=np.int64)
    number, file = (np.array(values[rows], dtype=np.int64)[chosen] for values in (lines.number, lines.file))
    origins = Origins(tuple(lines.paths), file, number)
    return BulkText(path, b"\n".join(text), b"\n".join(lines.text[: begin + 1]), origins, has_end)


def _require_one_section(lines: _Lines, row: int, match: re.Match[bytes], begun: bool) -> None:
    """Raise `FileError` if a BEGIN line starts the bulk data of a superelement or the like, another model.

    `row` is the index of the line in `lines`, `match` the parts of it (word and number); `begun` says that bulk data
    have begun. Superelement 0 is allowed as the first.
    """
    word, name = match[1].decode("latin-1"), match[2].decode("latin-1")
    if not word or (word == "SUPER" and not begun and not name.strip("0")):
        return
    said = lines.text[row].strip().decode("latin-1")
    raise FileError(
        f"{lines.location(row)}: {said!r} begins the bulk data of {f'{word.lower()} {name}'.strip()}; decks of several"
        " sections are not read: write the model as one, or export the superelement as matrices"
    )


def _take_lines(lines: _Lines, path: Path, root: Path, linked: Mapping[str, Path], depth: int) -> None:
    """Append the lines of the file at `path` to `lines`, with those of included files in place of INCLUDE.

    Each comes with the index of its file and its number in it. `root` is the folder of the deck, `linked` has files by
    name that are not there; `depth` counts nested includes. Raises `FileError` above 20 of them, or if a file cannot be read.
    """
    if depth > _MOST_INCLUDES:
        raise FileError(f"{path}: includes itself, or more than {_MOST_INCLUDES} files in one another; write one file")
    lines.paths.append(path)
    file = len(lines.paths) - 1
    content = path.read_bytes().replace(b"\r\n", b"\n").split(b"\n")
    row = 0
    while row < len(content):
        if content[row].lstrip()[:7].upper() != b"INCLUDE":
            lines.text.append(content[row])
            lines.file.append(file)
            lines.number.append(row + 1)
            row += 1
            continue
        text, last = content[row].rstrip(), row
        while text.count(b"'") % 2 and last + 1 < len(content):  # a name may run over several lines
            last += 1
            text += content[last].strip()
        match = _INCLUDE.match(text)
        name = next((g for g in match.groups() if g), b"").decode("utf-8", "replace") if match else ""
        try:
            included = _included_file(name.strip().replace("\\", "/"), root, path.parent, linked)
        except FileError as error:
            raise FileError(f"{path}, line {row + 1}: the included file cannot be read ({error})") from error
        _take_lines(lines, included, root, linked, depth + 1)
        row = last + 1


def _included_file(name: str, root: Path, parent: Path, linked: Mapping[str, Path]) -> Path:
    """Path of the file that an INCLUDE names, looked for in the folder `root` of the deck, in the folder `parent`, in `linked`.

    `parent` is that of the including file. A name ``SYMBOL:rest`` begins at the folder in the environment variable
    SYMBOL. Raises `FileError` if the file cannot be read, or the variable is not set.
    """
    symbol = _SYMBOL.fullmatch(name)
    if symbol is not None:
        folder = next((os.environ[key] for key in (symbol[1], symbol[1].upper()) if key in os.environ), None)
        if folder is None:
            raise FileError(
                f"{name}: {symbol[1]} is a logical symbol of the solver's set-up that is not known here; set an environment"
                f" variable {symbol[1]} to its folder, or write the path out"
            )
        return require_readable(Path(folder) / symbol[2].lstrip("/"))
    for folder_path in dict.fromkeys((root, parent)):
        if (folder_path / name).is_file():
            return require_readable(folder_path / name)
    return require_readable(linked.get(name, root / name))


@dataclass(frozen=True, eq=False)
class Cards:
    """All cards of one name.

    Attributes
    ----------
    lines : BulkLines
    first : (n_cards,) int array
        Line where each begins.
    fields : (n_cards, n_fields, width) uint8 array
        Data fields, from the first behind the name.
    """

    lines: BulkLines
    first: IntArray
    fields: np.ndarray

    def __len__(self) -> int:
        return len(self.first)

    def without(self, rows: IntArray) -> Cards:
        """All but some of the cards."""
        kept = np.setdiff1d(np.arange(len(self)), rows)
        return Cards(self.lines, self.first[kept], self.fields[kept])

    @property
    def n_fields(self) -> int:
        return int(self.fields.shape[1])

    def integers(self, field: int) -> IntArray:
        """The whole numbers in one field; 0 where blank."""
        return self._convert_field(field, whole_numbers, "a whole number").astype(np.int64)

    def reals(self, field: int) -> FloatArray:
        """The real numbers in one field; 0 where blank."""
        return self._convert_field(field, real_numbers, "a real number")

    def is_blank(self, field: int) -> np.ndarray:
        return np.ones(len(self), dtype=bool) if field >= self.fields.shape[1] else is_blank(self.fields[:, field])

    def words(self, number: int) -> list[str]:
        """The text of field `number` of every card, from 0 behind the card's name; "" behind the last field."""
        if number >= self.n_fields:
            return [""] * len(self)
        return [bytes(field).decode("latin-1").strip() for field in self.fields[:, number]]

    def row_words(self, row: int) -> list[str]:
        """The text of all fields of one card."""
        return [bytes(field).decode("latin-1").strip() for field in self.fields[row]]

    def _convert_field(self, field: int, convert: Callable[[np.ndarray], np.ndarray], wanted: str) -> np.ndarray:
        """Numbers (n_cards,) in the field with index `field` of all cards, by `convert`; 0 if no card has that field.

        Index 0 is the field behind the name. `convert` takes a table (n_cards, width) of bytes. Raises `FileError`,
        which names the line and says `wanted`, if a field is no such number.
        """
        if field >= self.fields.shape[1]:
            return np.zeros(len(self))
        try:
            return convert(self.fields[:, field])
        except FieldError as error:
            raise self.lines.error(int(self.first[error.index]), f"field {field + 2}", error.text, wanted) from None


def cards_of(text: BulkText, names: tuple[str, ...]) -> dict[str, Cards]:
    """Cards by name: those of each of `names` that `text` has; {} if it has none.

    Raises `FileError` if a continuation line does not follow the line that it continues.
    """
    lines = bulk_lines(text.path, names, text.content, whole_lines=True, origins=text.origins)
    if not len(lines.start):
        return {}
    all_lines = np.arange(len(lines.start))
    heads = all_lines[lines.card == all_lines]
    name_of = np.array([w.decode("latin-1").rstrip("*# ") for w in lines.words(heads, 0, 8).tolist()])
    count = np.where(lines.width == 8, 8, 4)
    before = np.cumsum(count) - count
    offset = before - before[lines.card]
    cards = {}
    for name in dict.fromkeys(name_of.tolist()):
        first = heads[name_of == name]
        rows = all_lines[np.isin(lines.card, first)]
        card = np.searchsorted(first, lines.card[rows])
        size = int((offset[rows] + count[rows]).max())
        fields = np.full((len(first), size, 24), ord(" "), dtype=np.uint8)
        for width, each in ((8, 8), (16, 4), (24, 4)):
            of_width = np.flatnonzero(lines.width[rows] == width)
            for part in chunks(len(of_width)):
                lines_of_part = of_width[part]
                taken = lines.take(rows[lines_of_part], 8, each * width).reshape(len(lines_of_part), each, width)
                column = offset[rows[lines_of_part]][:, None] + np.arange(each)
                fields[card[lines_of_part][:, None], column, :width] = taken
        cards[name] = Cards(lines, first, fields)
    return cards


def _expand_replication(lines: list[bytes], locate: Callable[[int], str]) -> tuple[list[bytes], list[int]]:
    """The lines with replicated cards written out in free field, and the index of the line that each comes from.

    Parameters
    ----------
    lines : list of bytes
    locate : function
        Returns file and line, in words, of an index in `lines`, for messages.

    Raises
    ------
    FileError
        If a line replicates no card before it, one with continuation lines or one without steps, a field to be stepped
        is no number, or cards are too many.
    """
    if not any(_may_replicate(line) for line in lines):
        return lines, list(range(len(lines)))
    expanded: list[bytes] = []
    numbers: list[int] = []
    previous: list[bytes] = []
    steps: list[bytes] = []
    continued, n_repeated = False, 0
    for number, line in enumerate(lines):
        text = line.split(b"$")[0].rstrip()
        head = text[:8].strip()
        repeat = _REPEAT.match(text.strip().rstrip(b", \t"))
        if not text.strip() or (head[:1].isalpha() and not _may_replicate(line)):
            if text.strip():
                previous, steps, continued = _card_fields(text), [], False
            expanded.append(line)
            numbers.append(number)
            continue
        is_replicated = head[:1] == b"=" or head[:1].isalpha()
        if not is_replicated:  # a continuation line
            continued = True
            expanded.append(line)
            numbers.append(number)
            continue
        if not previous or continued:
            problem = "goes on over several lines" if continued else "is not there"
            raise FileError(f"{locate(number)}: {text.decode('latin-1')!r} repeats a card that {problem}; {_REMEDY}")
        if repeat is not None and not steps:
            raise FileError(f"{locate(number)}: {text.decode('latin-1')!r} has no card with steps before it; {_REMEDY}")
        count = int(repeat[1]) if repeat is not None else 1
        n_repeated += count
        if n_repeated > _MOST_CARDS:
            raise FileError(f"{locate(number)}: {n_repeated} cards are repeated up to here; at most {_MOST_CARDS} are")
        steps = steps if repeat is not None else _card_fields(text)
        for _ in range(count):
            previous = _next_card(previous, steps, locate(number))
            expanded.append(b",".join(previous))
            numbers.append(number)
    return expanded, numbers


def _may_replicate(line: bytes) -> bool:
    """True if a line of bulk data may stand for other cards: it begins with `=`, or has a free field `=`, `==` or `*n`.

    A card in fixed fields does not, nor a comment behind `$`.
    """
    text = line.split(b"$")[0].strip()
    if text.startswith(b"="):
        return True
    if b"=" not in text and b",*" not in text.replace(b" ", b""):
        return False
    if not text[:1].isalpha() or b"," not in text:
        return False
    return any(field == b"=" or field == b"==" or _STEP.match(field) for field in _card_fields(text)[1:])


def _card_fields(text: bytes) -> list[bytes]:
    """The fields of the card line `text`, its name first, in free, small or large format, stripped of blanks."""
    if b"," in text:
        return [field.strip() for field in text.split(b",")]
    text = text.expandtabs(8)
    if b"*" in text[:8]:
        return [text[:8].strip().rstrip(b"*"), *(text[i : i + 16].strip() for i in range(8, min(len(text), 72), 16))]
    return [text[i : i + 8].strip() for i in range(0, min(len(text), 72), 8)]


def _next_card(previous: list[bytes], steps: list[bytes], where: str) -> list[bytes]:
    """The fields of the card that replication `steps` make of those of the `previous` one.

    A step is `=` (same field), `==` (all further fields the same), `*n` (field plus n; a blank or missing one counts as
    0), or a new field. The first field, the card's name, is never stepped. `where` names file and line in the
    `FileError` that is raised if a field to be stepped is no number.
    """
    card: list[bytes] = []
    for index, word in enumerate(steps):
        before = previous[index] if index < len(previous) else b""
        if word == b"==":
            return card + previous[index:]
        step = _STEP.match(word)
        if step is not None and index > 0:
            card.append(_add_step(before, step[1], where))
        else:
            card.append(before if word == b"=" else word)
    return card


def _add_step(before: bytes, step: bytes, where: str) -> bytes:
    """The number `before` plus `step`, as text; whole numbers stay whole, and a blank `before` counts as 0.

    Raises `FileError`, which begins with `where`, if one of them is no number.
    """
    if _WHOLE.match(before or b"0") and _WHOLE.match(step):
        return b"%d" % (int(before or b"0") + int(step))
    try:
        value = as_real(before) + as_real(step)
    except ValueError as error:
        raise FileError(
            f"{where}: a step of {step.decode('latin-1')} on {before.decode('latin-1')!r}, which is no number;"
            f" {_REMEDY}"
        ) from error
    return repr(value).encode()


@dataclass(frozen=True, eq=False)
class _SystemCard:
    """A coordinate system as its card has it.

    Attributes
    ----------
    form : str
        R, C or S.
    reference : int
        System of `points`; -1 where they are grid points.
    points : (3, 3) float array or (3,) int array
        Origin, a point on the z axis, a point in the x-z plane.
    """

    form: str
    reference: int
    points: np.ndarray


class BulkSystems:
    """The grid points and coordinate systems of a deck, resolved when asked for.

    Attributes
    ----------
    labels : (n_grids,) int array
        Labels of the grid points in the order of the cards, repeated ones too.
    """

    def __init__(self, path: Path, cards: dict[str, Cards]) -> None:
        """Read the grid points and coordinate system cards of the deck at `path`.

        Systems are resolved when asked for.
        """
        grids = cards["GRID"]
        self._path = path
        self.labels: IntArray = grids.integers(0)
        self._coordinates = np.stack([grids.reals(field) for field in (2, 3, 4)], axis=1)
        self._definition = _grid_numbers(cards, _CP)
        self.displacement: IntArray = _grid_numbers(cards, _CD)
        #: Whether grid points are held by fields of their own (PS).
        self.has_supports: bool = bool((_grid_numbers(cards, _PS) != 0).any())
        self._cards = _read_system_cards(cards)
        self._resolved = {0: CoordinateSystem("R", np.zeros(3), np.eye(3))}

    def basic_positions(self) -> FloatArray:
        """Positions of all grid points in the basic coordinate system, (n_grids, 3), in the unit of the file.

        Raises
        ------
        FileError
            If a coordinate system is not there, has no axes, or is defined by itself.
        """
        positions = self._coordinates.copy()
        for number in np.unique(self._definition[self._definition != 0]).tolist():
            rows = self._definition == number
            positions[rows] = self.system(number).to_basic(positions[rows])
        return positions

    def system(self, number: int, within: tuple[int, ...] = ()) -> CoordinateSystem:
        """Coordinate system `number` in basic coordinates and the unit of the file; resolved once, then remembered.

        `within` are the numbers of those being resolved. Raises `FileError` if it is not there, has no axes, or is
        defined by itself.
        """
        if number in self._resolved:
            return self._resolved[number]
        if number not in self._cards or number in within:
            problem = "is defined by itself" if number in within else "is not in the file"
            raise FileError(
                f"{self._path}: coordinate system {number} {problem}; export its CORD card, or basic coordinates"
            )
        card, within = self._cards[number], (*within, number)
        if card.reference < 0:
            points = np.stack([self._grid_point(number, label, within) for label in card.points.tolist()])
        else:
            points = self.system(card.reference, within).to_basic(card.points)
        axes = axes_of_points(*points)
        if axes is None:
            raise FileError(
                f"{self._path}: the points of coordinate system {number} lie on a line; correct its CORD card"
            )
        self._resolved[number] = CoordinateSystem(card.form, points[0], axes)
        return self._resolved[number]

    def _grid_point(self, number: int, label: int, within: tuple[int, ...]) -> FloatArray:
        """Basic position (3,) of the grid point `label` that a coordinate system refers to.

        `number` is that of the coordinate system; `within` are those being resolved. Raises `FileError` if the grid
        point is not there, or its own system is not or is being resolved.
        """
        rows = np.flatnonzero(self.labels == label)
        if not len(rows):
            raise FileError(f"{self._path}: coordinate system {number} names GRID {label}, which is not there; add it")
        system = self.system(int(self._definition[rows[0]]), within)
        return system.to_basic(self._coordinates[rows[:1]])[0]

    def displacement_axes(self, labels: IntArray, positions: FloatArray) -> dict[int, FloatArray]:
        """Directions of motion (3, 3), as rows, of each grid point whose displacement system is turned, by label.

        Parameters
        ----------
        labels : (n,) int array
        positions : (n, 3) float array
            Of these grid points, basic, in the unit of the file.

        Raises
        ------
        FileError
            If a coordinate system is not there, has no axes, or is defined by itself.
        """
        number_of = dict(zip(self.labels.tolist(), self.displacement.tolist(), strict=True))
        numbers = np.array([number_of[label] for label in labels.tolist()], dtype=np.int64)
        axes: dict[int, FloatArray] = {}
        for number in np.unique(numbers[numbers > 0]).tolist():  # -1 is the pressure of a fluid
            rows = np.flatnonzero(numbers == number)
            directions = self.system(number).directions_at(positions[rows])
            turned = np.abs(directions - np.eye(3)).max(axis=(1, 2)) > 1e-12
            axes |= zip(labels[rows[turned]].tolist(), directions[turned], strict=True)
        return axes


def _grid_numbers(cards: dict[str, Cards], field: int) -> IntArray:
    """Whole number in a field of each grid point, (n_grids,), such as its coordinate system.

    A blank field takes that of GRDSET. `field` counts from 0, behind the name of the card.
    """
    numbers = cards["GRID"].integers(field)
    if "GRDSET" in cards:
        numbers = np.where(cards["GRID"].is_blank(field), cards["GRDSET"].integers(field)[0], numbers)
    return numbers


def _read_system_cards(cards: dict[str, Cards]) -> dict[int, _SystemCard]:
    """Coordinate systems as their cards define them, by number: form (R, C or S), reference system and three points.

    CORD2 cards have points (3, 3) in the reference system; CORD1 cards have labels (3,) of grid points and the
    reference -1. Raises `FileError` for a field that is no number.
    """
    systems: dict[int, _SystemCard] = {}
    for name in SYSTEM_CARDS:
        card = cards.get(name)
        if card is None:
            continue
        if name[4] == "2":
            numbers, references = card.integers(0), card.integers(1)
            points = np.stack([card.reals(2 + k) for k in range(9)], axis=1).reshape(-1, 3, 3)
            for number, reference, three in zip(numbers.tolist(), references.tolist(), points, strict=True):
                systems[number] = _SystemCard(name[5], reference, three)
            continue
        for start in (0, 4):  # two systems a card
            table = np.stack([card.integers(start + k) for k in range(4)], axis=1)
            for number, *three in table[table[:, 0] > 0].tolist():
                systems[number] = _SystemCard(name[5], -1, np.array(three))
    return systems
