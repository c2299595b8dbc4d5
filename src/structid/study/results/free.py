"""The results folder of a search without a Jacobian: estimate.json, parameters.csv, estimate.h5 and the study as run."""

from __future__ import annotations

import csv
import io
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from structid.study.results.folder import fit_summary, json_text, record_summaries
from structid.study.results.hdf5 import put, put_further_records, put_record, put_texts
from structid.study.results.result import FreeResult

PARAMETERS = "parameters.csv"
#: How many of the largest changes estimate.json names.
_MOST_CHANGES = 50


def write_free_results(result: FreeResult, folder: Path) -> None:
    """Write estimate.json, parameters.csv, estimate.h5 and study.toml into the existing `folder`.

    The same result gives the same bytes.
    """
    (folder / "estimate.json").write_text(json_text(free_summary(result)), encoding="utf-8")
    (folder / PARAMETERS).write_text(_table(result), encoding="utf-8")
    (folder / "estimate.h5").write_bytes(_hdf5(result))
    (folder / "study.toml").write_bytes(result.study.text.encode("utf-8"))


def free_summary(result: FreeResult) -> dict[str, Any]:
    """The content of estimate.json, before what is not finite becomes null."""
    found = result.identification
    estimate = found.estimate
    beyond, limit = estimate.beyond_chance()
    return {
        "title": result.study.title,
        "status": estimate.status.value,
        "status_text": estimate.status_words,
        "message": estimate.message,
        "search": "matrix_free",
        "reason": estimate.reason,
        "n_parameters": len(estimate.names),
        "n_determined": estimate.determined,
        "chi_square_per_dof": estimate.chi_square_per_dof,
        "covariance_basis": estimate.covariance_basis,
        "n_iterations": estimate.n_iterations,
        "fit": fit_summary(found.fit),
        **record_summaries(found.fits),
        "total_mass": {"value": found.total_mass, "std": found.total_mass_std, "unit": "kg"},
        "regularization": [
            {"name": item.name, "rule": item.rule, "strength": item.strengths[0], "n_determined": count,
             "text": item.words, "settled": item.converged}
            for item, count in zip(found.held, found.determined, strict=True)
        ],
        "n_beyond_chance": int(beyond.sum()),
        "chance_limit_std": limit,
        "largest_changes": [_row(result, i) for i in largest_changes(result, _MOST_CHANGES)],
        "parameters_file": PARAMETERS,
        "modes": [
            {"frequency_hz": frequency, "damping_ratio": ratio}
            for frequency, ratio in zip(found.fit.modes.frequency, found.fit.modes.damping_ratio, strict=True)
        ],
        "resonances": [{"measured_hz": r.measured, "predicted_hz": r.predicted} for r in found.fit.resonances],
        "warnings": found.warnings,
        "provenance": asdict(result.provenance),
    }  # fmt: skip


def largest_changes(result: FreeResult, count: int) -> list[int]:
    """Positions of the parameters that moved from their start by most standard deviations, most first."""
    size = np.abs(result.identification.estimate.distance)
    order: list[int] = np.argsort(-np.nan_to_num(size, nan=-1.0), kind="stable")[:count].tolist()
    return order


def _row(result: FreeResult, i: int) -> dict[str, Any]:
    found = result.identification.estimate
    return {
        "name": found.names[i],
        "kind": found.kinds[i],
        "unit": found.units[i],
        "value": found.values[i],
        "std": found.std[i],
        "std_relative_error": found.std_error[i],
        "initial": found.initial[i],
        "identified": bool(found.identified[i]),
        "change_in_std": found.distance[i],
    }


def _table(result: FreeResult) -> str:
    """All parameters, one a line; empty where a number is not known."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    keys = list(_row(result, 0))
    writer.writerow(keys)
    for i in range(len(result.identification.estimate.names)):
        row = _row(result, i)
        writer.writerow(["" if isinstance(v, float) and not np.isfinite(v) else v for v in row.values()])
    return text.getvalue()


def _hdf5(result: FreeResult) -> bytes:
    """Groups ``parameters`` (with the posterior draws), ``frf``, ``evaluation``, ``modes`` and ``modes_initial``."""
    import h5py  # so that `import structid` stays light

    buffer = io.BytesIO()
    found = result.identification.estimate
    note = "as in units, one a parameter"
    with h5py.File(buffer, "w", track_order=True) as file:
        file.attrs["format"] = "structid free estimate 1"
        file.attrs["structid"] = result.provenance.structid
        file.attrs["title"] = result.study.title
        group = file.create_group("parameters")
        for key in ("names", "kinds", "units"):
            put_texts(group, key, getattr(found, key))
        for key in ("initial", "values", "std"):
            put(group, key, getattr(found, key), note)
        put(group, "std_relative_error", found.std_error, "1")
        put(group, "draws", found.physical_draws, note)
        put(group, "identified", found.identified)
        group.attrs["covariance_basis"] = found.covariance_basis
        put_record(file, result.identification.fit)
        put_further_records(file, result.identification.fits)
    return buffer.getvalue()
