"""Keywords of Abaqus and CalculiX input files, with the files that they include."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from structid.core.errors import FileError
from structid.files import require_readable

_MOST_INCLUDES = 20
#: Keywords whose data lines may stand in a file of their own.
_WITH_INPUT = ("NODE", "ELEMENT", "NSET", "ELSET", "EQUATION")
#: Keywords that Abaqus understands by their first letters too.
_SHORTENED = (
    "NODE", "ELEMENT", "NSET", "ELSET", "EQUATION", "TRANSFORM", "SYSTEM", "SURFACE", "COUPLING", "RIGID BODY", "SPRING",
    "DASHPOT", "ROTARY INERTIA", "PART", "INSTANCE", "ASSEMBLY", "INCLUDE", "KINEMATIC", "DISTRIBUTING",
)  # fmt: skip
_FEWEST_LETTERS = 3
_FORTRAN = re.compile(r"[dD](?=[-+]?\d+$)")
#: Keywords of several words, by their letters: CalculiX takes them without blanks too.
_IN_WORDS = {
    name.replace(" ", ""): name
    for name in (
        "RIGID BODY", "ROTARY INERTIA", "KINEMATIC COUPLING", "DISTRIBUTING COUPLING", "END PART", "END INSTANCE", "END ASSEMBLY",
        "SHELL SECTION", "SHELL GENERAL SECTION", "BEAM SECTION", "BEAM GENERAL SECTION", "SHEAR CENTER", "USER ELEMENT",
        "CONTACT PAIR", "PRE-TENSION SECTION", "CYCLIC SYMMETRY MODEL", "MASS ADJUST", "MODEL CHANGE", "EMBEDDED ELEMENT",
        "SHELL TO SOLID COUPLING", "NONSTRUCTURAL MASS", "CONNECTOR SECTION", "SURFACE SECTION", "SUBSTRUCTURE PATH",
    )
}  # fmt: skip
#: Options of several words, by their letters.
_OPTIONS_IN_WORDS = {
    name.replace(" ", ""): name
    for name in (
        "REF NODE", "ROT NODE", "TIE NSET", "PIN NSET", "ANALYTICAL SURFACE", "POSITION TOLERANCE", "NO ROTATION",
        "INFLUENCE RADIUS", "WEIGHTING METHOD", "NODAL THICKNESS", "SHELL THICKNESS", "COMPLEX STIFFNESS", "CYCLIC SYMMETRY",
        "TIED NSET", "MAX RATIO",
    )
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class KeywordBlock:
    """A keyword with its data lines.

    Attributes
    ----------
    line : int
        Line number in its file, from 1.
    keyword : str
        Name in capitals.
    options : dict of str to str
        Values by the names of the options in capitals; "" for an option without value.
    rows : list of list of str
        The words of each data line.
    """

    line: int
    keyword: str
    options: dict[str, str]
    rows: list[list[str]]


def keyword_blocks(path: Path) -> Iterator[KeywordBlock]:
    """Every keyword of the input file with its data lines, in order.

    Included files (*INCLUDE) and data files (INPUT=) are read in place; lines before the first keyword are skipped. A
    block has the line number of its keyword, the options, and the words of each data line.

    Raises
    ------
    FileError
        If an included file cannot be read, or more than 20 files include one another.
    """
    block: KeywordBlock | None = None
    for number, text in _read_lines(path, path.parent, 0):
        words = [word.strip() for word in text.split(",")]
        if text.startswith("*"):
            if block is not None:
                yield block
            keyword = " ".join(words[0][1:].upper().split())
            keyword = _IN_WORDS.get(keyword.replace(" ", ""), keyword)
            block = KeywordBlock(number, keyword, keyword_options(words[1:]), [])
            if keyword in _WITH_INPUT and block.options.get("INPUT"):
                included = _included_lines(path, path.parent, number, block.options, 0)
                block.rows.extend([word.strip() for word in line.split(",")] for _, line in included)
        elif block is not None:
            block.rows.append(words)
    if block is not None:
        yield block


def spelled_out(keyword: str) -> str:
    """The one keyword that is read of which `keyword` (in capitals) is short; "" if it is none or in full."""
    full = [name for name in _SHORTENED if name.startswith(keyword)]
    return full[0] if len(full) == 1 and full[0] != keyword and len(keyword) >= _FEWEST_LETTERS else ""


def keyword_options(words: list[str]) -> dict[str, str]:
    """Options such as ``NAME=STEEL`` by their names in capitals; those without a value have an empty one.

    ``REFNODE``, as CalculiX takes it, is ``REF NODE``; so are others of two words.
    """
    pairs = [
        (" ".join(key.upper().split()), value.strip().strip('"'))
        for key, _, value in (word.partition("=") for word in words if word)
    ]
    return {_OPTIONS_IN_WORDS.get(key.replace(" ", ""), key): value for key, value in pairs}


def _read_lines(path: Path, root: Path, depth: int) -> Iterator[tuple[int, str]]:
    """Yield line number and text of each line that is no comment or blank; continued keyword lines are joined.

    The number is that of the first line. Lines of the file at `path` come with those of included files in place. `root`
    is the folder of the job; `depth` counts nested includes, and `FileError` is raised above 20.
    """
    if depth > _MOST_INCLUDES:
        raise FileError(f"{path}: includes itself, or more than {_MOST_INCLUDES} files in one another; write one file")
    number, pending = 0, ""
    with path.open(encoding="utf-8-sig", errors="replace") as stream:
        for line_number, line in enumerate(stream, 1):
            text = line.strip()
            if not text or text.startswith("**"):
                continue
            number = number if pending else line_number
            text, pending = pending + text, ""
            name, *options = text.split(",")
            if text.startswith("*") and text.endswith(","):
                pending = text
            elif name.replace(" ", "").upper() == "*INCLUDE":
                yield from _included_lines(path, root, number, keyword_options(options), depth)
            else:
                yield number, text
    if pending:
        yield number, pending


def _included_lines(
    path: Path, root: Path, number: int, options: dict[str, str], depth: int
) -> Iterator[tuple[int, str]]:
    """Yield line number and text of each line of an included file, looked for in the job's folder, then beside `path`.

    `root` is the folder of the job, `path` the including file, and `number` the line of the keyword with these
    `options`; `depth` counts nested includes. Raises `FileError` if the file cannot be read.
    """
    name = options.get("INPUT", "").replace("\\", "/")
    try:
        folder = next((folder for folder in (root, path.parent) if (folder / name).is_file()), root)
        included = require_readable(folder / name)
    except FileError as error:
        raise FileError(f"{path}, line {number}: the included file cannot be read ({error})") from error
    yield from _read_lines(included, root, depth + 1)


def number_of(word: str) -> float:
    """The number `word`, whose exponent may begin with D; `ValueError` unless it is a finite one."""
    value = float(_FORTRAN.sub("e", word))
    if not math.isfinite(value) or "_" in word:  # Python reads 1_000
        raise ValueError(f"{word!r} is no finite number")
    return value


def numbers_of(row: Sequence[str], count: int) -> list[float]:
    """The first `count` numbers of a data line; blank words, and those that the line ends before, are 0.

    Raises `ValueError` unless all are finite.
    """
    return [number_of(word or "0") for word in (*row, *[""] * count)[:count]]
