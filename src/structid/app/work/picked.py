"""Modes of a record as the page picks them: poles of all orders, and the modes at chosen frequencies as a record."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from structid.app.work.scene import packed
from structid.modal.survey.options import ModesOptions
from structid.modal.survey.survey import MODES_PAGE, ModesResult, modes_of_file
from structid.records import ReadOptions
from structid.report.figures.survey import pole_kinds
from structid.similarity import mac
from structid.similarity.shapes import most_real
from structid.study.results.folder import staged_folder
from structid.study.results.modes import write_modes_results

_MOST_LINES = 3000


def survey(path: Path, read: ReadOptions, band: list[float] | None) -> dict[str, Any]:
    """Modes of the record with all poles behind them.

    Raises
    ------
    NoModesError, InputError
        As `modes_of_file`.
    """
    found = modes_of_file(path, ModesOptions(band=None if band is None else (band[0], band[1])), read)
    sweep = found.identification.sweep
    step = max(1, len(found.spectra.frequency) // _MOST_LINES)
    return {
        **_modes(found),
        "poles": {
            "frequency": packed(np.concatenate([p.frequency for p in sweep]) if sweep else [], np.float64),
            "damping": packed(np.concatenate([p.damping_ratio for p in sweep]) if sweep else [], np.float32),
            "order": packed(np.repeat([p.order for p in sweep], [len(p.poles) for p in sweep]), np.float32),
            "kind": packed(np.concatenate(pole_kinds(found)) if sweep else [], np.uint8),
        },
        "spectrum": {
            "name": found.spectra.name,
            "frequency": packed(found.spectra.frequency[::step], np.float64),
            "value": packed(found.spectra.values[::step, 0], np.float32),
        },
    }


def save(
    path: Path, read: ReadOptions, frequencies: list[float], folder: Path, band: list[float] | None
) -> dict[str, Any]:
    """The modes at `frequencies`, written as `structid modes --frequencies` writes them.

    Raises
    ------
    NoModesError, InputError
        As `modes_of_file`.
    """
    from structid.report.modes.page import modes_page

    chosen = ModesOptions(frequencies=tuple(frequencies), band=None if band is None else (band[0], band[1]))
    found = modes_of_file(path, chosen, read)
    with staged_folder(folder, MODES_PAGE) as staged:
        write_modes_results(found, staged)
        modes_page(found).write(staged)
    return _modes(found)


def _modes(found: ModesResult) -> dict[str, Any]:
    modes = found.modes
    std = found.std
    n = modes.n_modes
    return {
        "method": found.identification.method,
        "frequency": modes.frequency,
        "frequency_std": std[:n] if std is not None else [None] * n,
        "damping": modes.damping_ratio,
        "damping_std": std[n : 2 * n] if std is not None else [None] * n,
        "likeness": mac(modes.mode_shapes, modes.mode_shapes),
        "channels": [str(dof) for dof in modes.channels],
        "shapes": most_real(modes.mode_shapes).T,
        "warnings": list(found.warnings),
        "steps": list(found.steps),
    }
