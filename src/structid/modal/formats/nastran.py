"""Modes of Nastran: listings (``.f06``) and punch files as records."""

from __future__ import annotations

from pathlib import Path

from structid.core.errors import FileError
from structid.modal.formats.f06 import f06_modes
from structid.modal.formats.printed import RUN_AGAIN, ModeFileOptions, PrintedModes, printed_record
from structid.modal.formats.punch import punch_modes
from structid.modal.modal_record import ModalRecord

F06_SUFFIXES, PUNCH_SUFFIXES = (".f06",), (".pch", ".pun")


def nastran_modes(path: Path, options: ModeFileOptions | None = None) -> PrintedModes:
    """The modes of the listing or punch file at `path` as it prints them; none is an error."""
    text = path.read_text(encoding="latin-1")
    printed = (f06_modes if path.suffix.lower() in F06_SUFFIXES else punch_modes)(
        path, text, options or ModeFileOptions()
    )
    if not printed.modes:
        raise FileError(f"{path}: holds no eigenvectors of vibration; {RUN_AGAIN}")
    if not any(len(mode.nodes) for mode in printed.modes):
        raise FileError(
            f"{path}: the vectors hold scalar points only, which have no place and direction; print those of grid points"
        )
    return printed


def read_modes_nastran(path: Path, options: ModeFileOptions | None = None) -> ModalRecord:
    """The modes of a listing or punch file at the directions that move, entry of largest magnitude 1.

    Rotations are left out unless `options` state the unit of length: beside translations they mean something in metres only.

    Raises
    ------
    FileError
        If there are none, or points differ from mode to mode.
    """
    return printed_record(path, nastran_modes(path, options), options or ModeFileOptions())
