"""Predictions before and after changes, and exports, that the page of the workbench asks of an identified model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from structid.core.arrays import FloatArray, thin_band, thin_curve
from structid.core.constraints import split_commas
from structid.core.dof import is_whole_number, parse_dofs
from structid.core.errors import InputError
from structid.core.json_types import StoredEntry
from structid.fem import Base
from structid.fem.elements.element import dof_of_code
from structid.files.contained import hdf5_fields, texts_of
from structid.prediction.changes import AddMass, AddSupport, AddTunedMassDamper, Change, Remove, Scale
from structid.prediction.linear_response import is_support, movable_supports
from structid.prediction.options import ExportOptions, PredictOptions
from structid.prediction.predict import Prediction
from structid.prediction.quantities import Frf
from structid.prediction.recovery import linear_element_outputs
from structid.study.results.stored_model import stored_model, stored_study
from structid.study.run.exports import ExportFiles, Offer, list_offers, write_model_files
from structid.study.run.predicting import parts_of, predict_stored, prediction_summary
from structid.workbench.work.scene import packed

#: Names of one sort that are offered for choice, at most.
_MOST_NAMES = 1500
#: Sampled models behind a 95 % band, lines of a predicted FRF, and modes.
_DRAWS, _LINES, _MODES = 200, 400, 8
#: Points of a predicted history that are drawn, at most; a longer one is drawn by the extremes of bins.
_MOST_POINTS = 4000
#: Texts of the measured FRFs in estimate.h5.
_MEASURED = ("outputs", "inputs", "kind")
#: Kind of the change that seeks frequency and damping of a tuned mass damper itself.
_TUNE = "tune"


def use_facts(folder: Path) -> dict[str, StoredEntry]:
    """Names and options that the page offers for predictions and exports of an identified model, from its results folder.

    Keys are ``dofs``, ``nodes``, ``supports``, ``element_outputs`` and ``properties``, at most 1500 each; ``sets``; of
    the measured FRFs ``outputs`` and ``inputs`` (empty without), and ``kind`` (else accelerance); ``band`` in Hz; and
    ``offers``, the kinds of export.

    Raises
    ------
    FileError
        If the folder is of another version, or its study has changed.
    NoAnswerError
        If the data do not determine the model.
    """
    study = stored_study(folder)
    model, structure = stored_model(folder, study), study.structure
    fields = hdf5_fields(folder / "estimate.h5", [f"frf/{name}" for name in _MEASURED])
    outputs, inputs, kind = (texts_of(fields[f"frf/{name}"]) if f"frf/{name}" in fields else () for name in _MEASURED)
    moving = [code for code in structure.numbering.moving.tolist() if code // 6 in structure.nodes]
    return {
        "dofs": [str(dof_of_code(code)) for code in moving[:_MOST_NAMES]],
        "nodes": list(structure.nodes)[:_MOST_NAMES],
        "supports": [dof.place for dof in movable_supports(structure) if not dof.is_rotation][:_MOST_NAMES],
        "element_outputs": list(islice(linear_element_outputs(structure), _MOST_NAMES)),
        "outputs": outputs,
        "inputs": inputs,
        "kind": kind[0] if kind else "accelerance",
        "band": study.options.band,
        "properties": [item.label for item in structure.properties if item.term.values.any()][:_MOST_NAMES],
        "sets": [element.name for element in structure.elements],
        "offers": [
            {
                "kind": _export_kind(offer),
                "content": offer.content,
                "suffixes": offer.suffixes,
                "obstacle": offer.obstacle,
            }
            for offer in list_offers(model, study)
        ],
    }


def _export_kind(offer: Offer) -> str:
    """The field of `ExportFiles` that a kind of export fills, from the flag of the command."""
    return offer.flag.removeprefix("--").replace("-", "_")


def _band(options: Mapping[str, Any]) -> tuple[float, float] | None:
    """The frequency range ``band`` of the page's options, in Hz; None where it is left out."""
    return None if options.get("band") is None else (float(options["band"][0]), float(options["band"][1]))


#: What makes a change, and its keys in the order of its arguments, by the kind of the change.
_CHANGES: dict[str, tuple[Callable[..., Change], tuple[str, ...]]] = {
    "mass": (AddMass, ("node", "mass")),
    "scale": (Scale, ("label", "factor")),
    "support": (AddSupport, ("dof",)),
    "damper": (AddTunedMassDamper, ("dof", "mass", "frequency", "damping_ratio")),
    "remove": (Remove, ("name",)),
}


def read_changes(stated: Sequence[Mapping[str, Any]]) -> list[Change]:
    """Changes of a structure from mappings, each with a ``kind`` and the values of that kind.

    Kinds: ``mass`` (node, mass), ``scale`` (label, factor), ``support`` (dof), ``damper`` (dof, mass, frequency,
    damping_ratio) and ``remove`` (name). Masses are in kg, frequencies in Hz. Changes keep the order of `stated`.

    Raises
    ------
    InputError
        If a kind is unknown, a value is missing, or a node is no number.
    """
    changes: list[Change] = []
    for table in stated:
        if table.get("kind") not in _CHANGES:
            raise InputError(f"a change must be one of {', '.join(_CHANGES)}, got {table.get('kind')!r}")
        make, keys = _CHANGES[table["kind"]]
        _require(table, keys)
        values = [_node(table[key]) if key == "node" else table[key] for key in keys]
        changes.append(make(*values))
    return changes


def _require(change: Mapping[str, Any], keys: Sequence[str]) -> None:
    """Raise `InputError` for the first of `keys` that a change leaves out."""
    missing = [key for key in keys if change.get(key) in (None, "")]
    if missing:
        raise InputError(f"{change['kind']}: `{missing[0]}` must be given, got nothing")


def _node(stated: Any) -> int:
    """Node label as an integer from `stated`, a text that the page sends; `InputError` if it is no number."""
    text = str(stated).strip()
    if not is_whole_number(text):
        raise InputError(f"`node` must be a number of a node, got {stated!r}")
    return int(text)


def predict_use(
    folder: Path, options: Mapping[str, Any], changes: Sequence[Mapping[str, Any]]
) -> dict[str, StoredEntry]:
    """Predicted modes, and the FRF from one load to one sensor with its 95 % interval, before and after changes.

    The answer holds ``changes``, ``bands`` and ``modes`` of `prediction_summary` and, if an FRF was predicted, ``frf`` of the
    first sensor and load, ``output`` and ``input``: packed frequency (Hz), ``unit``, ``kind``, the supports that ``moved``, and
    curves before and after. Under the loads of a file there is ``history`` of the first sensor, ``output``: packed ``time`` (s),
    ``unit``, the loads in ``words``, curves before and after, which are ``thinned`` to minimum and maximum of bins if they are
    long, and the ``largest`` value with its 95 % interval, before, after, and the difference.

    Parameters
    ----------
    folder : Path
        Results of an identification.
    options : mapping
        ``sensor`` (a degree of freedom or an element output) and ``load`` (a degree of freedom), "" for none; ``band`` ([low,
        high] in Hz or None); and ``kind``, the kind of FRF, "accelerance" by default; where a load is at a support, the
        transmissibility is predicted instead. ``history`` is the path of a file of loads over time or None, with ``motion``
        ("acceleration" by default) and ``filtered`` as of `PredictOptions`.
    changes : sequence of mapping
        See `read_changes`. One may have the kind ``tune``: a tuned mass damper with a ``mass`` (kg) and a ``dof``, whose
        frequency and damping are optimized.
    """
    tuned = [table for table in changes if table.get("kind") == _TUNE]
    source, load = stored_study(folder), str(options.get("load") or "")
    load_dofs = parse_dofs(split_commas(load))
    moves_support = any(is_support(source.structure, dof) for dof in load_dofs)
    asked = PredictOptions(
        sensors=str(options.get("sensor") or ""),
        loads=load,
        kind="transmissibility" if moves_support else options.get("kind") or "accelerance",
        band=_band(options),
        lines=_LINES,
        modes=_MODES,
        draws=_DRAWS,
        tune_damper=_damper_text(tuned),
        history=options.get("history"),
        motion=str(options.get("motion") or "acceleration"),
        filtered=bool(options.get("history") and options.get("filtered")),
    )
    others = read_changes([table for table in changes if table.get("kind") != _TUNE])
    predicted = predict_stored(source, folder, asked, others)
    summary = prediction_summary(predicted)
    answer: dict[str, StoredEntry] = {key: summary[key] for key in ("changes", "bands", "modes")}
    if predicted.frf is not None:
        parts = parts_of(predicted.frf)
        quantity = next(iter(parts.values())).quantity
        if not isinstance(quantity, Frf):
            raise TypeError(f"an FRF is of the quantity Frf, got {type(quantity).__name__}")
        moved = [dof.place for each in quantity.inputs if isinstance(each, Base) for dof in each.supports]
        answer["frf"] = {
            "output": str(quantity.axes["output"][0]),
            "input": str(load_dofs[0] if load_dofs else quantity.axes["input"][0]),
            "frequency": packed(np.asarray(quantity.axes["frequency"], dtype=float), np.float64),
            "unit": quantity.unit,
            "kind": quantity.kind,
            "moved": moved,
            "parts": {name: _curves(part) for name, part in parts.items() if name != "difference"},
        }
    if predicted.history is not None and predicted.maxima is not None:
        parts, maxima = parts_of(predicted.history), parts_of(predicted.maxima)
        quantity = next(iter(parts.values())).quantity
        time = np.asarray(quantity.axes["time"], dtype=float)
        answer["history"] = {
            "output": str(quantity.axes["output"][0]),
            "time": packed(thin_curve(time, time, _MOST_POINTS)[0], np.float64),
            "unit": quantity.units[0],
            "words": predicted.loads,
            "thinned": len(time) > _MOST_POINTS,
            "parts": {name: _history_curves(time, part) for name, part in parts.items() if name != "difference"},
            "largest": {
                name: [float(v[0]) for v in (part.values, part.low, part.high)] for name, part in maxima.items()
            },
        }
    return answer


def _damper_text(tuned: Sequence[Mapping[str, Any]]) -> str:
    """Tuned mass damper as ``mass@dof``, the form of the option `tune_damper`; "" if `tuned` is empty.

    Raises `InputError` for more than one damper, or without ``dof`` or ``mass``.
    """
    if not tuned:
        return ""
    if len(tuned) > 1:
        raise InputError("one damper is tuned at a time; give frequency and damping of the others")
    _require(tuned[0], ("dof", "mass"))
    return f"{tuned[0]['mass']}@{tuned[0]['dof']}"


def _curves(part: Prediction) -> dict[str, StoredEntry]:
    """Packed ``value``, the magnitude, and ``low`` and ``high`` (95 % band) of the first channel of an FRF."""
    columns = {"value": np.abs(part.values), "low": part.low, "high": part.high}
    return {name: packed(column.reshape(len(column), -1)[:, 0], np.float32) for name, column in columns.items()}


def _history_curves(time: FloatArray, part: Prediction) -> dict[str, StoredEntry]:
    """Packed ``value``, ``low`` and ``high`` (95 % band) of the first sensor of a history over `time`, thinned if it is long."""
    _, value = thin_curve(time, part.values[:, 0].real, _MOST_POINTS)
    _, low, high = thin_band(time, part.low[:, 0], part.high[:, 0], _MOST_POINTS)
    return {name: packed(curve, np.float32) for name, curve in (("value", value), ("low", low), ("high", high))}


def export_use(
    folder: Path, kind: str, suffix: str, options: Mapping[str, Any], out: Path
) -> tuple[list[str], list[Path]]:
    """Write one kind of export file of an identified model into `out`; returns messages for the user and the paths that then exist.

    Existing files are replaced. `folder` holds the results, `kind` and `suffix` are as in ``offers`` of `use_facts`; `options`
    may hold ``sensor``, ``load``, ``band`` ([low, high] in Hz) and ``modes`` (their number, 10 by default).

    Raises
    ------
    InputError
        If the kind or its format is unknown, or the model has no such content.
    """
    study = stored_study(folder)
    model = stored_model(folder, study)
    offers = {_export_kind(offer): offer for offer in list_offers(model, study)}
    if kind not in offers or suffix not in offers[kind].suffixes:
        raise InputError(f"{kind} as {suffix} is no file of these results; choose one that is offered")
    out.mkdir(exist_ok=True)
    files = ExportFiles(**{kind: out / f"{folder.name}_{kind}{suffix}"})
    asked = ExportOptions(
        sensors=str(options.get("sensor") or ""),
        loads=str(options.get("load") or ""),
        band=_band(options),
        modes=int(options.get("modes") or 10),
    )
    lines = write_model_files(folder, study, model, files, asked)
    return lines, [path for path in files.paths if path.exists()]
