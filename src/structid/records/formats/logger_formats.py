"""Registry of the files of loggers and recorders; what reads them loads when a file of one is read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from structid.core.errors import FileError
from structid.lazy import FormatModule
from structid.records.formats.options import ReadOptions
from structid.records.record import FrfRecord, TimeRecord


@dataclass(frozen=True)
class LoggerFormat:
    """A format that is read only.

    Attributes
    ----------
    kind : str
        Name of the format in `structid.files.loggers`.
    SUFFIXES : tuple of str
    extra : str
        Extra of the installation of structid that brings the library of the format; "" where none is needed.
    words : str
        Name of such a file in messages.
    """

    kind: str
    SUFFIXES: tuple[str, ...]
    extra: str
    words: str

    def read(self, path: Path, options: ReadOptions) -> FrfRecord | TimeRecord:
        """The time record in the file at `path`; all of its channels share a clock.

        Raises
        ------
        FileError
            If the library is missing, or the file is damaged or holds no time histories.
        InputError
            If `options` do not fit, or the chosen channels have different clocks.
        """
        record: TimeRecord = _READER.read(path, options, self)
        return record

    def write(self, path: Path, record: FrfRecord | TimeRecord) -> None:
        """Refuse: files of loggers are only read.

        Raises
        ------
        FileError
            Always.
        """
        raise FileError(f"{path}: {self.words} files are read only; write .npz, .h5, .mat, .csv or .uff")


LOGGERS: tuple[LoggerFormat, ...] = (
    LoggerFormat("tdms", (".tdms",), "tdms", "TDMS"),
    LoggerFormat("mdf", (".mf4", ".mdf"), "mdf", "MDF"),
    LoggerFormat("miniseed", (".mseed", ".miniseed"), "miniseed", "miniSEED"),
    LoggerFormat("lvm", (".lvm",), "", "LVM"),
    LoggerFormat("wav", (".wav",), "", "WAV"),
    LoggerFormat("parquet", (".parquet",), "parquet", "Parquet"),
)
_READER = FormatModule(
    "structid.records.formats.loggers", tuple(suffix for logger in LOGGERS for suffix in logger.SUFFIXES)
)
