"""The results folder of `structid modes`: modes.json, and the modes for other programs."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np

from structid.core.json_types import StoredEntry, json_text
from structid.modal.formats.files import modal_fields, write_modes
from structid.modal.modal_record import ModalRecord
from structid.modal.shape_uncertainty import collinearity_with_std, phase_deviation_with_std
from structid.modal.survey.survey import ModesResult
from structid.modal.tracking import ModeTracks
from structid.records import FrfRecord, Geometry, Tone
from structid.records.stored_averages import CorrelationRecord, SpectrumRecord


def write_modes_results(result: ModesResult, folder: Path) -> None:
    """Write modes.json, modes.csv and modes.uff into the existing `folder`; the same result gives the same bytes.

    modes.uff is left out where the format cannot hold the channels, or entries of the shapes are unknown.
    """
    (folder / "modes.json").write_text(json_text(modes_summary(result)), encoding="utf-8")
    write_modes(folder / "modes.csv", result.modes)
    directions = [dof.unsigned for dof in result.modes.channels]
    if len(set(directions)) == len(directions) and result.modes.known.all():
        write_modes(folder / "modes.uff", result.modes, result.geometry)


def write_merged(modes: ModalRecord, folder: Path, geometry: Geometry | None = None) -> None:
    """Write modes merged from several files as modes.json, modes.csv and modes.uff into the existing `folder`.

    modes.uff is left out where entries of the shapes are unknown, which the format cannot say.
    """
    for suffix in ("json", "csv", "uff") if modes.known.all() else ("json", "csv"):
        write_modes(folder / f"modes.{suffix}", modes, geometry)


def modes_summary(result: ModesResult) -> dict[str, StoredEntry]:
    """Content of modes.json as a dictionary, in which numbers may still be NaN or infinite.

    It has frequencies, damping ratios, shapes and their deviations, MPC and MPD with deviations, statistics of the
    poles behind each mode, tones, ``left_out`` (candidates that are no modes), warnings, findings, the record, options
    and provenance.
    """
    identification = result.identification
    fields = modal_fields(result.modes)
    collinearity, deviation = collinearity_with_std(result.modes), phase_deviation_with_std(result.modes)
    return {
        "title": result.title,
        "method": identification.method,
        "n_modes": result.modes.n_modes,
        **{name: fields[name] for name in ("frequency_hz", "frequency_std_hz", "damping_ratio", "damping_std", "mpc")},
        "mpc_std": collinearity.std,
        "mpc_by_noise": collinearity.noise_effect,
        "mpd_deg": deviation.value,
        "mpd_std_deg": deviation.std,
        "mpd_by_noise_deg": deviation.noise_effect,
        "probability": identification.probability,
        **_clusters(result),
        **{name: fields[name] for name in ("channels", "scaling")},
        "tone_kurtosis": result.kurtosis,
        "tones_removed": [_tone(tone) for tone in result.tones],
        "scale": result.scale_words,
        **{name: fields[name] for name in ("mode_shapes", "shape_std", "covariance")},
        "left_out": [asdict(part) for part in identification.left_out],
        "warnings": list(result.modes.warnings),
        "findings": [asdict(finding) for finding in result.findings],
        "preparation": list(result.steps),
        "source": result.modes.source,
        "record": _record(result),
        "options": options_used(result),
        "provenance": asdict(result.provenance),
    }


def _tone(tone: Tone) -> dict[str, StoredEntry]:
    """The entry of a tone that was taken off: the fields of `Tone`, with ``_hz`` behind the names of frequencies."""
    return {
        "frequency_hz": tone.frequency,
        "lowest_hz": tone.lowest,
        "highest_hz": tone.highest,
        "kurtosis": tone.kurtosis,
        "channels": [str(dof) for dof in tone.channels],
        "units": list(tone.units),
        "amplitude": tone.amplitude,
        "variance_fraction": tone.variance_fraction,
    }


def _clusters(result: ModesResult) -> dict[str, StoredEntry]:
    """Dictionary of statistics of the poles, of all model orders, behind the modes.

    Every value is None for a method without orders. Values are lists with an entry for each mode: count, mean frequency
    (Hz), mean damping ratio and their spreads. ``n_orders`` is one number.
    """
    clusters = result.identification.clusters
    names = ("count", "n_orders", "cluster_frequency_hz", "cluster_frequency_spread_hz", "cluster_damping_ratio",
             "cluster_damping_spread")  # fmt: skip
    if len(clusters) != result.modes.n_modes:
        return dict.fromkeys(names)
    columns = (
        [c.size for c in clusters],
        len(result.identification.orders),
        [float(c.frequency.mean()) for c in clusters],
        [c.frequency_spread for c in clusters],
        [float(c.damping_ratio.mean()) for c in clusters],
        [float(c.damping_ratio.std()) for c in clusters],
    )
    return dict(zip(names, columns, strict=True))


def options_used(result: ModesResult) -> dict[str, StoredEntry]:
    """Fields of the identification's options as plain values, in nested dictionaries.

    ``orders`` are those that were used. The upper end of ``criteria.frequency`` (Hz) is None where there is no limit.
    """
    options = result.identification.options
    used = asdict(options)
    if result.identification.sweep:
        used["orders"] = list(result.identification.orders)
    low, high = options.criteria.frequency
    used["criteria"]["frequency"] = [low, high if np.isfinite(high) else None]
    return used


def _record(result: ModesResult) -> dict[str, StoredEntry]:
    """Entry of modes.json on the record: ``kind``, counts, band (Hz) or sampling rate (Hz), and channels as text."""
    record = result.record
    if isinstance(record, FrfRecord):
        return {
            "kind": record.kind, "unit": record.unit, "n_lines": len(record.frequency),
            "band_hz": [record.frequency[0], record.frequency[-1]],
            "outputs": [str(dof) for dof in record.outputs], "inputs": [str(dof) for dof in record.inputs],
        }  # fmt: skip
    if isinstance(record, SpectrumRecord):
        return {
            "kind": "spectra", "n_lines": len(record.frequency), "averages": record.averages,
            "band_hz": [record.frequency[0], record.frequency[-1]],
            "channels": [str(dof) for dof in record.channels], "references": [str(dof) for dof in record.references],
            "quantities": record.quantities,
        }  # fmt: skip
    if isinstance(record, CorrelationRecord):
        return {
            "kind": "correlation functions", "n_lags": len(record.values), "sampling_rate_hz": record.sampling_rate,
            "averages": record.averages,
            "channels": [str(dof) for dof in record.channels], "references": [str(dof) for dof in record.references],
            "quantities": record.quantities,
        }  # fmt: skip
    return {
        "kind": "time histories", "sampling_rate_hz": record.sampling_rate, "n_samples": len(record.values),
        "duration_s": len(record.values) / record.sampling_rate,
        "channels": [str(dof) for dof in record.channels], "quantities": record.quantities,
    }  # fmt: skip


def write_tracks(tracks: ModeTracks, folder: Path) -> None:
    """Write tracks.json into the existing `folder`: frequencies and damping ratios by record and mode, null where unseen."""
    content: dict[str, StoredEntry] = {
        "records": list(tracks.names),
        "members": tracks.members,
        "frequency_hz": tracks.frequency,
        "frequency_std_hz": tracks.frequency_std,
        "damping_ratio": tracks.damping_ratio,
        "damping_std": tracks.damping_std,
        "mac_with_the_last": tracks.likeness,
        "mac_std": tracks.likeness_std,
        "in_one_record_only": [{"record": tracks.names[n], "frequency_hz": f} for n, f in tracks.alone],
    }
    (folder / "tracks.json").write_text(json_text(content), encoding="utf-8")
