"""The command `structid convert`: a record from one format to another."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from structid.cli.base import say
from structid.core.errors import FileError
from structid.files import claimed
from structid.records import FrfRecord, ReadOptions, Record, read_record, write_record
from structid.records.formats import how_read


def convert(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="IN", help="Record: NPZ, NPY, HDF5, CSV, MAT, UFF, TDMS, MDF, miniSEED, WAV or Parquet."
        ),
    ],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="File to write; the suffix gives the format.")],
    read: ReadOptions,
) -> None:
    """Read a record and write it in another format, in SI units; the suffix of each file gives its format.

    \b
    Examples:
      structid convert measured.uff measured.h5
      structid convert impact.npy impact.csv --sampling-rate 1024 --channels 1X+,2X+ --units g,N
      structid convert logger.tdms record.h5 --columns "Acc 1,Force" --channels 1X+,3X+
      structid convert frf.npz frf.uff --array accelerance --frequency-array freq_hz
          --outputs 1X-,2X+ --inputs 1X+ --kind accelerance
    """
    if target.exists() and source.exists() and target.samefile(source):
        raise FileError(f"{target}: is the file that is read; write to another one")
    record = read_record(source, read)
    with claimed(target):
        write_record(target, record)
    if how_read(record.source, source):
        say(f"read: {record.source}")
    say(_summary(record, target))


def _summary(record: Record, path: Path) -> str:
    """One line on a record that was written."""
    if isinstance(record, FrfRecord):
        size = (
            f"{record.kind}, {len(record.frequency)} lines, {len(record.outputs)} outputs, {len(record.inputs)} inputs"
        )
    else:
        size = f"time histories, {record.values.shape[0]} samples at {record.sampling_rate:g} Hz"
        size += f", {len(record.channels)} channels"
    return f"{path}: {size}"
