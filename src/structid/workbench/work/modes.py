"""Modes as the page has them: picked from poles of all orders, merged, saved, and beside those of a study's model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from structid.compare.correlation import values_at
from structid.compare.mode_correlation import correlated_modes
from structid.core.display import file_names
from structid.core.dof import parse_dofs, renamed
from structid.core.errors import InputError
from structid.core.json_types import StoredEntry
from structid.modal import ModalRecord
from structid.modal.formats.files import read_modes
from structid.modal.merging import merged_setups
from structid.modal.survey.options import ModesOptions
from structid.modal.survey.setups import modes_of_setups
from structid.modal.survey.survey import MODES_PAGE, ModesResult, modes_of_file
from structid.records import ReadOptions
from structid.report.figures.survey import pole_kinds
from structid.report.modes import modes_page
from structid.similarity import mac, most_real
from structid.study.results.folder import staged_folder
from structid.study.results.hdf5 import stored_parameters
from structid.study.results.modes import write_merged, write_modes_results
from structid.study.schema.model.structure import leaves_pieces_open
from structid.study.schema.records.sensors import channel_names, used_names
from structid.study.schema.unknowns import read_parameters
from structid.workbench.folder import holds_modes
from structid.workbench.work.scene import ReadModel, packed

_MOST_LINES = 3000


def survey(path: Path, read: ReadOptions, band: list[float] | None) -> dict[str, StoredEntry]:
    """Modes of a record with all poles of the stabilization diagram and the spectrum, packed for the page.

    `read` says how the file is read; `band` is [low, high] in Hz, None for the default. ``poles`` hold frequency (Hz),
    damping ratio, model order, kind (0 outside the criteria, 1 alone, 2 of a cluster, 3 chosen as a mode) and real
    shape of the poles of all orders; ``spectrum`` has every k-th line, at most about 6000, of the first singular value.

    Raises
    ------
    NoModesError
        If no mode is found.
    InputError
        If the file or the options cannot be used.
    """
    result = modes_of_file(path, ModesOptions(band=None if band is None else (band[0], band[1])), read)
    sweep = result.identification.sweep
    step = max(1, len(result.spectra.frequency) // _MOST_LINES)
    return {
        **_modes(result),
        "poles": {
            "frequency": packed(np.concatenate([p.frequency for p in sweep]) if sweep else [], np.float64),
            "damping": packed(np.concatenate([p.damping_ratio for p in sweep]) if sweep else [], np.float32),
            "order": packed(np.repeat([p.order for p in sweep], [len(p.poles) for p in sweep]), np.float32),
            "kind": packed(np.concatenate(pole_kinds(result)) if sweep else [], np.uint8),
            "shape": packed(np.concatenate([most_real(p.shapes).T for p in sweep]) if sweep else [], np.float32),
        },
        "spectrum": {
            "name": result.spectra.name,
            "frequency": packed(result.spectra.frequency[::step], np.float64),
            "value": packed(result.spectra.values[::step, 0], np.float32),
        },
    }


def save(
    path: Path, read: ReadOptions, frequencies: list[float], folder: Path, band: list[float] | None
) -> dict[str, StoredEntry]:
    """Identify the modes at `frequencies` (Hz) of the record at `path`, write them into `folder`, and return them for the page.

    The files are those of ``structid modes --frequencies``; `band` is [low, high] in Hz, None for the default.

    Raises
    ------
    NoModesError, InputError
        As `modes_of_file`.
    """
    chosen = ModesOptions(frequencies=tuple(frequencies), band=None if band is None else (band[0], band[1]))
    return _write_modes(modes_of_file(path, chosen, read), folder)


def merge(paths: Sequence[Path], read: ReadOptions, folder: Path, band: list[float] | None) -> dict[str, StoredEntry]:
    """Merge modes of several set-ups by their common reference sensors, write them into `folder`, and return them for the page.

    Parameters
    ----------
    paths : sequence of Path
        Either records, whose modes are identified first, or files of modes.
    read : ReadOptions
        How records are read.
    folder : Path
        Results folder.
    band : list of float or None
        Frequency band [low, high] in Hz for records, None for the default.

    Raises
    ------
    InputError
        If records and files of modes are mixed, there are fewer than two, or set-ups share no sensor or no mode.
    """
    saved = [path for path in paths if holds_modes(path)]
    if saved and len(saved) < len(paths):
        other = next(path.name for path in paths if path not in saved)
        raise InputError(
            f"{other} is a record and {saved[0].name} holds modes; save the modes of each record, merge these"
        )
    if saved:
        merging = merged_setups([read_modes(path) for path in paths], names=file_names(paths))
        with staged_folder(folder, "modes.json", MODES_PAGE) as staged:
            write_merged(merging.modes, staged)
        return {**_told(merging.modes), "setups": merging.frequency.T, "spread": merging.frequency_spread}
    if len(paths) < 2:
        raise InputError("choose two records or more, or two files of modes; one needs no merging")
    options = ModesOptions(band=None if band is None else (band[0], band[1]))
    return _write_modes(modes_of_setups(paths, options, read), folder)


def _write_modes(result: ModesResult, folder: Path) -> dict[str, StoredEntry]:
    """Write modes and their report into `folder`, replacing earlier ones, and return the modes for the page.

    These are frequencies (Hz), damping ratios, standard deviations, shapes, MAC between the modes, channels and
    warnings.
    """
    with staged_folder(folder, "modes.json", MODES_PAGE) as staged:
        write_modes_results(result, staged)
        modes_page(result).write(staged)
    return _modes(result)


def _modes(result: ModesResult) -> dict[str, StoredEntry]:
    """Modes for the page: the keys of `_told` with ``method``, ``steps``, and ``warnings`` of the whole result."""
    return {
        **_told(result.modes),
        "method": result.identification.method,
        "warnings": list(result.warnings),
        "steps": list(result.steps),
    }


def _told(modes: ModalRecord) -> dict[str, StoredEntry]:
    """Modes for the page: ``frequency`` (Hz), ``damping``, their ``..._std``, ``likeness``, ``channels``, ``shapes``, ``warnings``.

    ``likeness`` is the MAC of each pair of modes; ``shapes`` has a row for each mode.
    """
    std = modes.std
    n = modes.n_modes
    return {
        "frequency": modes.frequency,
        "frequency_std": std[:n],
        "damping": modes.damping_ratio,
        "damping_std": std[n:],
        "likeness": mac(modes.mode_shapes, modes.mode_shapes),
        "channels": [str(dof) for dof in modes.channels],
        "shapes": most_real(modes.mode_shapes).T,
        "warnings": list(modes.warnings),
    }


def posted_modes(posted: dict[str, Any]) -> ModalRecord:
    """Modal record of unsaved modes that the page sends as the mapping `posted`.

    Its keys are ``frequency`` (Hz), ``damping`` (ratios), ``shapes`` (a row of real entries for each mode) and
    ``channels`` (names).

    Raises
    ------
    InputError
        If there are no modes.
    """
    if not posted["frequency"]:
        raise InputError("no mode is taken that has a shape; take one, or save the modes first")
    shapes = np.array(posted["shapes"], dtype=float).T
    return ModalRecord(
        posted["frequency"], posted["damping"], shapes, parse_dofs(posted["channels"]), source="the page"
    )


def beside(model: ReadModel, measured: ModalRecord, results: Path | None) -> dict[str, Any]:
    """Comparison of `measured` modes with those of `model`, at start values or at the values in the folder `results`.

    ``frequency`` and ``model`` are in Hz, ``mac`` is (n_measured, n_shown), ``pair`` gives for each measured mode the column of
    its model mode or None, ``together`` those of all model modes that it is compared with; ``number`` is that of each model
    mode shown, from 1. ``difference`` (relative) and ``remarks`` have an entry for each measured mode. The other keys are
    ``likeness``, ``warnings`` and ``sensors``, the number of channels. Channels are renamed by ``relabel`` of the study's record.

    Raises
    ------
    InputError
        If a channel is not part of the structure, or `results` holds no value of the study's parameters.
    """
    structure = model.structure
    identified: Mapping[str, float] = {}
    if results is not None:
        stored = stored_parameters(results)
        identified = stored.values
        if leaves_pieces_open(model.root.inner("structure")):
            structure = replace(structure, subdivide=stored.pieces)
    unknown = read_parameters(model.root, structure)
    values = unknown.values(values_at(unknown.names, unknown.start, identified))
    aimed = channel_names(structure)
    given = {} if model.record is None else model.record.inner("relabel").table
    relabel = {name: str(own) for name, own in given.items()}
    channels = measured.channels
    for names in (relabel, aimed):
        channels = renamed(channels, (), used_names(names, channels))[0]
    correlation = correlated_modes(structure, values, replace(measured, channels=channels))
    pairing, shown = correlation.pairing, correlation.shown
    column = {int(mode): k for k, mode in enumerate(shown)}
    return {
        "frequency": correlation.measured.frequency,
        "model": correlation.model.frequency[shown],
        "number": shown + 1,
        "mac": pairing.mac[:, shown],
        "pair": [column.get(int(mode)) for mode in pairing.number],
        "together": [
            [column[k] for k in pairing.partners(i) if k in column] for i in range(correlation.measured.n_modes)
        ],
        "difference": correlation.frequency_difference,
        "likeness": pairing.likeness,
        "remarks": [correlation.remark(i) for i in range(correlation.measured.n_modes)],
        "warnings": correlation.warnings,
        "sensors": len(channels),
    }
