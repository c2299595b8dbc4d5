"""What is done with a damaged file: the reader of its kind, as the commands call it."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
from typer.main import get_command

from structid.cli.app import app
from structid.cli.base import DONE, EXIT_CODES, UNUSABLE_INPUT
from structid.compare.states import stored_state
from structid.core.errors import InputError
from structid.fem.importers import dofs_of, read_matrices, read_numbering
from structid.fem.meshes import read_mesh, require_sound
from structid.modal.formats.files import read_modes
from structid.modal.method import ModalOptions
from structid.modal.spectral.fdd import fdd
from structid.modal.subspace.stored_correlations import correlation_modes
from structid.records.formats import ReadOptions, read_record
from structid.records.formats.geometry import read_geometry
from structid.records.formats.spectra import read_correlation, read_spectrum
from structid.records.on_disk import open_record
from structid.study.run.long_run import Checkpoint
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study

TIME = ReadOptions(sampling_rate=10.0, channels="1X,2X,3X", units="g")
SPECTRUM = ReadOptions(
    frequency_array="f", array="s", kind="spectrum", channels="1X,2X", inputs="1X", units="g", averages=9
)
LAB = ReadOptions(channels="1X,2X,3X")
LOGGED = ReadOptions(channels="1X,2X,3X", units="g")
FRF = ReadOptions(frequency_array="f", array="h", outputs="1X,2X", inputs="1X", kind="mobility")


def record(path: Path) -> None:
    read_record(path)


def bare_history(path: Path) -> None:
    read_record(path, TIME)


def bare_frf(path: Path) -> None:
    read_record(path, FRF)


def lab_table(path: Path) -> None:
    read_record(path, LAB)


def logger(path: Path) -> None:
    read_record(path, LOGGED)


def chunks(path: Path) -> None:
    for part in open_record(path, TIME if path.suffix == ".npy" or "bare" in path.name else None).chunks(longest=7):
        assert np.isfinite(part).all()


def matrices(path: Path) -> None:
    for item in read_matrices(path).values():
        if item.dofs is not None and item.is_square:
            dofs_of(item.dofs)


def numbering(path: Path) -> None:
    read_numbering(path)


def mesh(path: Path) -> None:
    found = require_sound(read_mesh(path), drop_orphans=True, duplicates="merge", take="all")
    for group in found.groups:
        found.group_nodes(group)
    for part in found.parts:
        part.elements()


def modes(path: Path) -> None:
    read_modes(path)


def spectrum(path: Path) -> None:
    fdd(read_spectrum(path, SPECTRUM if path.suffix == ".npz" else None))


def correlation(path: Path) -> None:
    correlation_modes(read_correlation(path), ModalOptions(orders=[2, 4]))


def geometry(path: Path) -> None:
    read_geometry(path)


def study(path: Path) -> None:
    """As far as `check` and `identify` come before the search."""
    prepare_study(load_study(path))


def checkpoint(path: Path) -> None:
    owner = {"layout": "structid checkpoint 2", "versions": {}, "inputs": {"a": "b"}}
    with_lock = Checkpoint(path.parent, owner, resume=True)
    with_lock.close()


def results(path: Path) -> None:
    stored_state(path.parent)


def identify(path: Path) -> None:
    """The command as a user calls it."""
    _called("identify", str(path), "--no-report", "--no-explain", "--out", str(path.with_suffix("")))
    shutil.rmtree(path.with_suffix(""), ignore_errors=True)


def plan(path: Path) -> None:
    """The command as a user calls it."""
    _called("plan", str(path), "--no-report", "--out", str(path.with_suffix("")))
    shutil.rmtree(path.with_suffix(""), ignore_errors=True)


def _called(*words: str) -> None:
    code = get_command(app)(words, standalone_mode=False) or DONE
    if code == UNUSABLE_INPUT:
        raise InputError("refused")
    if code not in EXIT_CODES:
        raise AssertionError(f"exit code {code}")


TARGETS: dict[str, Callable[[Path], None]] = {
    target.__name__: target
    for target in (
        record, bare_history, bare_frf, lab_table, logger, chunks, matrices, numbering, mesh, modes, spectrum, correlation,
        geometry, study, checkpoint, results, identify, plan,
    )
}  # fmt: skip
