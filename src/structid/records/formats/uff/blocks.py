"""The blocks of a universal file: found, checked to be whole, and read through pyuff."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple, TypedDict

import numpy as np

from structid.core.errors import FileError
from structid.files import require_readable

#: Datasets that are read; all others are skipped.
READ_TYPES = (15, 58, 82, 151, 164, 2411)
_TAG = re.compile(rb"[ ]{4}-1[ \t]*(\r\n|\n|\r|\Z)")
_HEADER_LINES = 12  # of dataset 58, with its number and without the tag
_BLANK = b" \t\r\n\x1a\0"
#: Bytes of a number, and numbers a value, by the ordinate data type of dataset 58.
_ORDINATES = {2: (4, 1), 4: (8, 1), 5: (4, 2), 6: (8, 2)}


class Block(NamedTuple):
    """Where a dataset starts in the file, and its number."""

    start: int
    number: int


class Dataset(TypedDict, total=False):
    """A dataset as pyuff reads it: what those of each number have of these."""

    type: int
    # of 58
    func_type: int
    id1: str
    id2: str
    id3: str
    id4: str
    id5: str
    rsp_node: int
    rsp_dir: int
    ref_node: int
    ref_dir: int
    num_pts: int
    abscissa_spacing: int
    abscissa_inc: float
    ordinate_spec_data_type: int
    ordinate_axis_units_lab: str
    orddenom_spec_data_type: int
    orddenom_axis_units_lab: str
    data: np.ndarray
    x: np.ndarray
    # of 15 and 2411, with x
    node_nums: np.ndarray
    y: np.ndarray
    z: np.ndarray
    # of 82
    nodes: np.ndarray
    # of 164
    length: float
    force: float


class _Form(NamedTuple):
    """How the values of a dataset 58 are stored."""

    binary: bool
    points: int
    values: int
    item: int


def datasets(path: Path) -> list[Dataset]:
    """The datasets of the universal file at `path` that structid reads, as pyuff's dictionaries.

    Raises
    ------
    FileError
        If the file is not a universal file, is truncated or damaged, or a dataset cannot be read.
    """
    data = _content(path)
    blocks = _blocks(path, data)
    found = []
    for number, (block, values) in enumerate(zip(blocks, _through_pyuff(path, blocks), strict=True)):
        if block.number == 58:
            _require_all_points(path, number, values)
        if block.number in READ_TYPES:
            found.append(values)
    return found


def dataset_lines(path: Path, wanted: int) -> list[tuple[int, list[str]]]:
    """Place in the file (from 1) and lines of every ASCII dataset of the number `wanted`, without tags and number.

    Raises
    ------
    FileError
        If the file is not a universal file, or is truncated or damaged.
    """
    data = _content(path)
    blocks = _blocks(path, data)
    ends = [*(block.start for block in blocks[1:]), len(data)]
    found = []
    for place, (block, end) in enumerate(zip(blocks, ends, strict=True), 1):
        if block.number == wanted:
            lines = data[block.start : end].decode("ascii", errors="replace").rstrip().splitlines()
            found.append((place, lines[2:-1]))
    return found


def _content(path: Path) -> bytes:
    path = require_readable(path)
    try:
        return path.read_bytes()
    except OSError as error:
        raise FileError(f"{path}: cannot be read ({error}); check the disk") from error


def _blocks(path: Path, data: bytes) -> list[Block]:
    found: list[Block] = []
    at = _skip_blank(data, 0)
    while at < len(data):
        tag = _TAG.match(data, _line_start(at))
        if tag is None:
            what = "is not a universal file" if not found else f"goes on with junk after dataset {len(found)}"
            raise FileError(f"{path}: {what} (byte {at}); copy or export it again")
        start, at = tag.start(), tag.end()
        number_line = data[at : at + 6]
        if not number_line.strip().isdigit():
            raise FileError(f"{path}: dataset {len(found) + 1} has no number (byte {at}); the file is damaged")
        number = int(number_line)
        at = _end_of_block(path, data, at, number, len(found) + 1)
        found.append(Block(start, number))
        at = _skip_blank(data, at)
    if not found:
        raise FileError(f"{path}: is not a universal file, it has no datasets; check the export")
    return found


def _skip_blank(data: bytes, at: int) -> int:
    while at < len(data) and data[at] in _BLANK:
        at += 1
    return at


def _line_start(at: int) -> int:
    """Where the four blanks of a tag that ends in `-1` at `at` begin."""
    return max(at - 4, 0)


def _truncated(path: Path, count: int) -> FileError:
    return FileError(f"{path}: ends within dataset {count}; the file is truncated, copy or export it again")


def _end_of_block(path: Path, data: bytes, at: int, number: int, count: int) -> int:
    """Position after the closing tag of the block whose first line starts at `at`."""
    if number == 58:
        form, body = _form(path, data, at, count)
        if form.binary:
            at = body + form.points * form.values * form.item
            if at > len(data):
                raise _truncated(path, count)
            while at < len(data) and data[at] in b"\r\n":
                at += 1
            tag = _TAG.match(data, at)
            if tag is None:
                raise FileError(
                    f"{path}: dataset {count} does not end after its {form.points} points; the file is "
                    "truncated or damaged"
                )
            return tag.end()
    while True:
        end = data.find(b"    -1", at)
        if end < 0:
            raise _truncated(path, count)
        tag = _TAG.match(data, end)
        if tag is not None and data[end - 1 : end] in (b"\n", b"\r"):
            return tag.end()
        at = end + 1


def _form(path: Path, data: bytes, at: int, count: int) -> tuple[_Form, int]:
    """Form of the dataset 58 whose first line starts at `at`, and where its values start."""
    lines = []
    body = at
    for _ in range(_HEADER_LINES):
        end = data.find(b"\n", body)
        if end < 0:
            raise _truncated(path, count)
        lines.append(data[body:end])
        body = end + 1
    binary = lines[0][6:7].lower() == b"b"
    try:
        ordinate, points, even = (int(lines[7][10 * i : 10 * i + 10]) for i in range(3))
        item, per_value = _ORDINATES[ordinate]
    except (ValueError, KeyError) as error:
        raise FileError(f"{path}: dataset {count} has a damaged header (record 7); export it again") from error
    if points < 1:
        raise FileError(f"{path}: dataset {count} has {points} points; export it again")
    abscissa_item = 1 if even == 0 else 0
    return _Form(binary, points, per_value + abscissa_item, item), body


def _through_pyuff(path: Path, blocks: list[Block]) -> list[Dataset]:
    import pyuff

    # pyuff raises nothing but the plain class Exception, so no narrower name exists for what it reports.
    try:
        file = pyuff.UFF(str(path))
        same = file.get_n_sets() == len(blocks)
        read = [b.number in READ_TYPES for b in blocks] if same else []
        return_sets: list[Dataset] = [file.read_sets(i) if wanted else {} for i, wanted in enumerate(read)]
    except Exception as error:
        if type(error) is not Exception:
            raise
        raise FileError(f"{path}: a dataset is damaged ({error}); copy or export it again") from error
    if not same:
        raise FileError(f"{path}: its datasets cannot be told apart; export it again as ASCII")
    return return_sets


def _require_all_points(path: Path, number: int, values: Dataset) -> None:
    """Raise unless pyuff found as many points as the header says, with an abscissa for each."""
    got = len(values["data"])
    if got != values["num_pts"] or len(values["x"]) < got:
        raise FileError(
            f"{path}: dataset {number + 1} has {got} of its {values['num_pts']} points; the file is "
            "truncated or damaged"
        )
    history = values.get("func_type") == 1  # its gaps are judged, and filled where asked, by `gaps`
    if not ((history or np.isfinite(values["data"]).all()) and np.isfinite(values["x"]).all()):
        raise FileError(f"{path}: dataset {number + 1} holds NaN or infinite values; repair or export it again")
