"""CSV tables as laboratories and spreadsheets write them: one column an axis, one a channel, headed by what it holds.

Time histories: ``time_s``, then ``12Z+ [m/s^2]``, ``3Z+ [N]``.
Frequency response functions: ``frequency_hz``, then for each pair of output and input
``12Z+/3Z+ [(m/s^2)/N] re`` and ``... im``, optionally ``12Z+/3Z+ coherence`` and ``12Z+/3Z+ [(m/s^2)/N] std``.
Time histories of other headers are understood with `columns`, `channels` and `units` of `ReadOptions`; lines above and
below, separators and decimal signs with its `csv` where they are not recognised.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import FileError
from structid.files import atomic_write
from structid.records.formats.csv.columns import frf_header, frf_record, time_header, time_record
from structid.records.formats.csv.table import read_table
from structid.records.formats.options import ReadOptions
from structid.records.record import FrfRecord, TimeRecord


def read(path: Path, options: ReadOptions) -> FrfRecord | TimeRecord:
    """The record in the CSV table at `path`: UTF-8, with comma, semicolon, tab or blanks between cells.

    FRFs if the first column holds frequencies, else time histories. Decimal commas are understood where cells are not
    separated by commas, and units in a second header line. Lines without an entry at the end are skipped. The record's
    `source` says what was understood of a table that structid did not write.

    Raises
    ------
    FileError
        If a cell is no number, a line has too few cells, a header cannot be read, or time is not even; the message
        names line and column.
    InputError
        If `options` contradict the table.
    """
    table = read_table(path, options.csv, options.axis_unit)
    if table.is_frequency:
        return frf_record(table, options)
    return time_record(table, options)


def write(path: Path, record: FrfRecord | TimeRecord) -> None:
    """Write `record` to `path` as a CSV table with commas and all digits.

    Time records lose their noise variance and source, FRF records all but frequencies, values, channels, kind,
    coherence and variance.

    Raises
    ------
    FileError
        If the file cannot be written, or a time record has fewer than two samples.
    """
    if isinstance(record, TimeRecord):
        if record.values.shape[0] < 2:
            raise FileError(f"{path}: one sample does not tell a sampling rate in a table; write .npz instead")
        header, columns = time_header(record)
    else:
        header, columns = frf_header(record)
    with atomic_write(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
        stream.write(",".join(header) + "\n")
        stream.writelines(_lines(columns))


def _lines(columns: list[FloatArray]) -> Iterator[str]:
    for row in np.column_stack(columns).tolist():
        yield ",".join(map(repr, row)) + "\n"
