"""Universal files: functions at nodal degrees of freedom (datasets 58 and 58b) with their units (164).

What is kept: values, frequencies or sampling rate, degrees of freedom with their sense, kinds, coherence, and
`averages`. Not kept: `variance`, `noise_source`, `source`.
"""

from __future__ import annotations

from pathlib import Path

from structid.core.errors import FileError, InputError
from structid.files import atomic_write
from structid.records.formats.geometry import Geometry
from structid.records.formats.options import ReadOptions, option_words
from structid.records.formats.selection import selected
from structid.records.formats.uff.blocks import datasets
from structid.records.formats.uff.frf import read_frfs
from structid.records.formats.uff.time import read_times
from structid.records.formats.uff.write import file_bytes, require_same
from structid.records.record import FrfRecord, TimeRecord

SUFFIXES: tuple[str, ...] = (".uff", ".unv", ".uf", ".ufb")

_FUNCTIONS = {
    0: "general", 1: "time response", 2: "auto spectrum", 3: "cross spectrum", 4: "frequency response function",
    6: "coherence", 9: "power spectral density", 12: "spectrum",
}  # fmt: skip


def read(path: Path, options: ReadOptions) -> FrfRecord | TimeRecord:
    """The record in the universal file at `path`, in SI units.

    FRFs (function type 4) become one record of all outputs and inputs, with coherence (6) where every pair has it;
    time responses (1) become one record of all channels. Datasets 15, 82, 151 are geometry and titles; others
    are skipped. Units come from dataset 164, else from the labels, else SI is meant.

    Raises
    ------
    FileError
        If the file is truncated or damaged, holds neither FRFs nor time responses, both (choose with
        ``ReadOptions(array="frf")`` or ``"time"``), or pairs are missing or doubled.
    """
    found = datasets(path)
    functions = [dataset for dataset in found if dataset["type"] == 58]
    frfs = [f for f in functions if f["func_type"] == 4]
    times = [f for f in functions if f["func_type"] == 1]
    if frfs and times and options.array not in ("frf", "time"):
        raise InputError(
            f"{path}: holds {len(frfs)} FRFs and {len(times)} time responses; choose with "
            f'{option_words(array=None)}, "frf" or "time"'
        )
    if frfs and (not times or options.array == "frf"):
        coherences = [f for f in functions if f["func_type"] == 6]
        return read_frfs(path, found, frfs, coherences, options)
    if times:
        return selected(path, read_times(path, found, times, options), options)
    others = sorted({int(f["func_type"]) for f in functions})
    names = ", ".join(_FUNCTIONS.get(number, f"function type {number}") for number in others)
    raise FileError(
        f"{path}: holds no frequency response function (type 4) or time response (type 1), only "
        f"{names or 'other datasets'};"
        " export those"
    )


def write(path: Path, record: FrfRecord | TimeRecord, geometry: Geometry | None = None) -> None:
    """Write `record` as a binary universal file in double precision (58b) and SI units, with optional geometry.

    The file is read back and compared before it takes its place.

    Raises
    ------
    FileError
        If the file cannot be written, or does not read back as it should.
    """
    path = Path(path)
    with atomic_write(path) as temporary:
        with temporary.open("wb") as stream:
            stream.writelines(file_bytes(path, record, geometry))
        require_same(path, record, read(temporary, ReadOptions()))
