"""`structid predict`: FRFs, histories and modes of a results folder, before and after changes, with bands; and their files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from structid.core.constraints import split_commas
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError
from structid.core.json_types import Entry
from structid.files import csv_text
from structid.prediction.changes import Change, changed_model
from structid.prediction.model_error import ModelError
from structid.prediction.options import PredictOptions
from structid.prediction.predict import PredictedChange, Prediction, predict, predict_change
from structid.prediction.quantities import Frf, History, Maxima, NaturalModes, Quantity
from structid.records import ReadOptions, TimeRecord, read_record
from structid.study.results.stored_model import stored_loads, stored_model, stored_model_error, stored_study

PREDICTION_PAGE = "prediction.html"


@dataclass(frozen=True, eq=False)
class StudyPrediction:
    """What was predicted from a results folder; `PredictedChange` where there are changes.

    Attributes
    ----------
    folder : Path
        The results that it is made from.
    title : str
    modes : Prediction or PredictedChange
    frf, history, maxima : the same or None
    changes : tuple of str
        In words.
    """

    folder: Path
    title: str
    modes: Prediction | PredictedChange
    frf: Prediction | PredictedChange | None
    history: Prediction | PredictedChange | None
    maxima: Prediction | PredictedChange | None
    changes: tuple[str, ...]

    @property
    def words(self) -> str:
        """What the bands include."""
        shown = self.frf or self.modes
        return shown.before.words if isinstance(shown, PredictedChange) else shown.words


def predict_study(
    folder: Path, options: PredictOptions, changes: Sequence[Change] = (), study: Path | None = None
) -> StudyPrediction:
    """Predictions from a results folder of `structid identify`.

    Raises
    ------
    InputError
        If the folder, its study, a place or a change cannot be used.
    NoAnswerError
        If the data do not determine the model.
    """
    source = stored_study(folder, study)
    model = stored_model(folder, source)
    changed_model(model.structure, model.parameters, changes)
    sensors = parse_dofs(split_commas(options.sensors))

    def of(quantity: Quantity, error: ModelError | None = None) -> Prediction | PredictedChange:
        if changes:
            return predict_change(model, quantity, changes, options.draws, options.seed, error)
        return predict(model, quantity, options.draws, options.seed, error)

    frf = history = maxima = None
    if sensors:
        loads = parse_dofs(split_commas(options.loads) or stored_loads(folder))
        band = options.band or source.options.band
        if band is None:
            raise InputError("`band` must be given: the study does not state one under [method]", "band")
        quantity = Frf(sensors, loads, np.linspace(*band, options.lines), options.kind)
        frf = of(quantity, stored_model_error(folder, source, model))
    if options.history is not None:
        if not sensors:
            raise InputError("`sensors` must name where the motion under `history` is wanted, got none", "sensors")
        pushed = _history(options.history, sensors, options.motion)
        history, maxima = of(pushed), of(Maxima(pushed))
    words = tuple(change.words for change in changes)
    return StudyPrediction(folder, source.title, of(NaturalModes(options.modes)), frf, history, maxima, words)


def _history(path: Path, sensors: tuple[Dof, ...], motion: str) -> History:
    """The motion under the forces of a record."""
    record = read_record(path, ReadOptions())
    if not isinstance(record, TimeRecord):
        raise InputError(f"{path}: holds FRFs; `history` takes forces over time", "history")
    pushes = [i for i, quantity in enumerate(record.quantities) if quantity == "force"]
    if not pushes:
        raise InputError(f"{path}: holds no force; a channel in N or N m is one", "history")
    loads = tuple(record.channels[i] for i in pushes)
    return History(sensors, loads, record.values[:, pushes], record.sampling_rate, motion)


def prediction_summary(found: StudyPrediction) -> dict[str, Entry]:
    """The content of prediction.json."""
    modes = parts_of(found.modes)
    return {
        "title": found.title,
        "results": found.folder.as_posix(),
        "changes": list(found.changes),
        "bands": found.words,
        "level": 0.95,
        "modes": [
            {
                "frequency_hz": {name: _value(part, (k, 0)) for name, part in modes.items()},
                "damping_ratio": {name: _value(part, (k, 1)) for name, part in modes.items()},
            }
            for k in range(len(next(iter(modes.values())).values))
        ],
        **({} if found.maxima is None else {"maxima": _maxima(parts_of(found.maxima))}),
    }


def _maxima(parts: dict[str, Prediction]) -> list[dict[str, Entry]]:
    """The largest motion of each output by each of the predictions."""
    outputs = next(iter(parts.values())).quantity.axes["output"]
    return [
        {"output": output, **{name: _value(part, (i,)) for name, part in parts.items()}}
        for i, output in enumerate(outputs)
    ]


def parts_of(found: Prediction | PredictedChange) -> dict[str, Prediction]:
    """The predictions by their names in files: ``value``, or ``before``, ``after`` and ``difference``."""
    if isinstance(found, PredictedChange):
        return {"before": found.before, "after": found.after, "difference": found.difference}
    return {"value": found}


def _value(part: Prediction, index: tuple[int, ...]) -> dict[str, Entry]:
    ends = [float(part.low[index]), float(part.high[index])]
    return {"value": float(np.real(part.values[index])), "std": float(part.std[index]), "interval_95": ends}


def prediction_csv(found: Prediction | PredictedChange) -> str:
    """A table of one quantity: its axis, then value and ends of the band of every channel; FRFs as real and imaginary part too."""
    parts = parts_of(found)
    first = next(iter(parts.values()))
    axis, *channels = first.quantity.axes.items()
    names = [f"{a}/{b}" for a in channels[0][1] for b in channels[1][1]] if len(channels) > 1 else list(channels[0][1])
    header, columns = [f"{axis[0]} ({'Hz' if axis[0] == 'frequency' else 's'})"], [np.asarray(axis[1], dtype=float)]
    for label, part in parts.items():
        before = "" if label == "value" else f"{label} "
        tables = {"low": part.low, "high": part.high}
        if np.iscomplexobj(part.values):
            tables = {
                "real": part.values.real,
                "imaginary": part.values.imag,
                "magnitude": np.abs(part.values),
                **tables,
            }
        else:
            tables = {"value": part.values.real, **tables}
        for what, table in tables.items():
            flat = table.reshape(len(columns[0]), -1)
            header += [f"{before}{name} {what} ({first.quantity.unit})" for name in names]
            columns += list(flat.T)
    return csv_text(header, ([f"{value:.9g}" for value in row] for row in np.column_stack(columns).tolist()))
