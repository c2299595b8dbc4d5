"""Predictions as the terminal shows them, and their page."""

from __future__ import annotations

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from structid.core.display import NOTHING, number, percent, plural, span_text, unit_text, value_words
from structid.core.isolation import paths_as_called
from structid.prediction.predict import PredictedChange, Prediction
from structid.prediction.quantities import Frf
from structid.prediction.tuned_damper import TunedDamper
from structid.report.figures.prediction import frf_figure, history_figure, spectrum_figure
from structid.report.page import Page, Table, printed
from structid.study.run.predicting import PREDICTION_PAGE, StudyPrediction, parts_of

#: Part of a value that rounding makes at most.
_ROUNDING = 1e-7


def modes_table(prediction: Prediction | PredictedChange) -> Table:
    """Table of predicted natural frequencies (Hz) and damping ratios (%), with 95 % intervals.

    With changes of the structure it has values before and after them, and the change, instead of the intervals of
    damping.
    """
    parts = parts_of(prediction)
    header: tuple[str, ...]
    if isinstance(prediction, PredictedChange):
        header = ("Mode", "Before (Hz)", "After (Hz)", "Change (Hz)", "Damping before", "Damping after")
    else:
        header = ("Mode", "Frequency (Hz)", "95 % interval", "Damping ratio", "95 % interval")
    rows = []
    for k in range(len(next(iter(parts.values())).values)):
        cells = [str(k + 1)]
        if isinstance(prediction, PredictedChange):
            cells += [_value(part, (k, 0), float(prediction.before.values[k, 0])) for part in parts.values()]
            cells += [_percent(part, (k, 1)) for name, part in parts.items() if name != "difference"]
        else:
            cells += [
                _value(prediction, (k, 0)),
                _interval(prediction, (k, 0)),
                _percent(prediction, (k, 1)),
                _interval(prediction, (k, 1), 100),
            ]
        rows.append(tuple(cells))
    return Table(header, tuple(rows), tuple(range(len(header))))


def participation_table(prediction: StudyPrediction) -> Table | None:
    """Table of the effective mass of each mode along each axis, with the part of the moving mass; None if it was not asked for.

    With changes, of the structure before and after them.
    """
    header, columns = ["Mode"], []
    for axis, found in prediction.participation.items():
        for label, part in parts_of(found).items():
            if label == "difference":
                continue
            header += [
                f"Along {axis}{'' if label == 'value' else ' ' + label} (kg)",
                "Part of the mass",
                "95 % interval",
            ]
            n_modes = range(len(part.values))
            columns.append([_value(part, (k, 1), float(part.values[:, 1].max())) for k in n_modes])
            columns += [[_percent(part, (k, 2)) for k in n_modes], [_interval(part, (k, 2), 100) for k in n_modes]]
    rows = tuple((str(k + 1), *cells) for k, cells in enumerate(zip(*columns, strict=True)))
    return Table(tuple(header), rows, tuple(range(len(header)))) if columns else None


def outputs_table(prediction: Prediction | PredictedChange, title: str = "Largest") -> Table:
    """Table of a quantity with one value for each output, such as the largest predicted motion, with 95 % intervals.

    `title` heads the column of values; with changes there are columns before, after and for the difference instead.
    """
    parts = parts_of(prediction)
    first = next(iter(parts.values()))
    names = {"value": title}
    header = ["Sensor", "Unit"]
    for name in parts:
        header += [names.get(name, name.capitalize()), "95 % interval"]
    rows = []
    for i, (output, unit) in enumerate(zip(first.quantity.axes["output"], first.quantity.units, strict=True)):
        cells = [str(output), unit_text(unit)]
        for part in parts.values():
            cells += [number(float(part.values[i])), _interval(part, (i,))]
        rows.append(tuple(cells))
    return Table(tuple(header), tuple(rows), tuple(range(2, len(header))))


def _value(part: Prediction, index: tuple[int, ...], size: float = 0.0) -> str:
    """Text of the value at `index` with its deviation; "0" where both are only rounding errors of values as large as `size`."""
    value, std = float(part.values[index]), float(part.std[index])
    return "0" if max(abs(value), std) <= _ROUNDING * size else value_words(value, std)


def _percent(part: Prediction, index: tuple[int, ...]) -> str:
    return percent(float(part.values[index]), signed=False)


def _interval(part: Prediction, index: tuple[int, ...], factor: float = 1.0) -> str:
    """Text of the 95 % interval of the value at `index`, times `factor` (100 for per cent); a dash if it is not finite.

    `part` is the prediction that has it.
    """
    low, high = factor * float(part.low[index]), factor * float(part.high[index])
    if not np.isfinite([low, high]).all():
        return NOTHING
    return span_text(low, high, "%" if factor == 100 else "")


def heading(prediction: StudyPrediction) -> str:
    """Heading in one line: the predicted quantities, the folder of the identification, loads and changes."""
    kinds = (
        (_frf_name(prediction.frf), prediction.frf),
        ("history", prediction.history),
        ("spectra", prediction.spectrum),
    )
    what = [name for name, part in kinds if part is not None]
    words = paths_as_called(f"{' and '.join([*what, 'modes'])} predicted from {prediction.folder}")
    words += f", {prediction.loads}" if prediction.loads else ""
    return f"{words}; {', '.join(prediction.changes)}" if prediction.changes else words


def _frf_name(frf: Prediction | PredictedChange | None) -> str:
    """The name of predicted FRFs in the heading: "FRFs", or "transmissibilities" where supports move."""
    part = frf.before if isinstance(frf, PredictedChange) else frf
    is_moved = part is not None and isinstance(part.quantity, Frf) and part.quantity.kind == "transmissibility"
    return "transmissibilities (motion per motion of the supports)" if is_moved else "FRFs"


def width_words(prediction: StudyPrediction) -> str:
    """Sentence on the median half-width of the 95 % bands of predicted FRFs, relative to the magnitude; "" without FRFs."""
    if prediction.frf is None:
        return ""
    words = []
    for name, part in parts_of(prediction.frf).items():
        if name != "difference":
            size = np.abs(part.values)
            half = np.divide(part.high - part.low, 2 * size, out=np.zeros(size.shape), where=size > 0)
            words.append(f"{'' if name == 'value' else name + ' '}{percent(float(np.median(half)), signed=False)}")
    return f"Half-width of the 95 % band of the FRFs, median over lines: {', '.join(words)}"


def damper_table(damper: TunedDamper) -> Table:
    """Table of the values of a tuned mass damper, tuned to be best over the uncertainty and for the identified model alone."""
    shown = damper.overview()
    return Table(tuple(shown.header), tuple(map(tuple, shown.rows)), tuple(range(1, len(shown.header))))


def _tables(prediction: StudyPrediction) -> dict[str, Table | None]:
    """Tables of maxima, root mean squares and extremes with one row for each output, by name; None if not predicted."""
    titles = {
        "maxima": (prediction.maxima, "Largest"),
        "root_mean_square": (prediction.root_mean_square, "Root mean square"),
        "largest": (prediction.largest, f"Largest in {prediction.duration or 0:g} s, on the mean"),
    }
    return {name: None if part is None else outputs_table(part, title) for name, (part, title) in titles.items()}


def prediction_text(prediction: StudyPrediction) -> list[RenderableType]:
    """Terminal text of a prediction: natural modes, largest motions, and what the bands include."""
    parts: list[RenderableType] = [Text(heading(prediction), style="bold"), printed(modes_table(prediction.modes))]
    if prediction.damper is not None:
        parts += [Text(prediction.damper.overview().words), printed(damper_table(prediction.damper))]
    tables = (participation_table(prediction), *_tables(prediction).values())
    parts += [printed(table) for table in tables if table is not None]
    parts += [Text(words) for words in (width_words(prediction), prediction.words) if words]
    if prediction.doubt:
        parts.append(Text(f"note: {prediction.doubt}"))
    return parts


def prediction_page(prediction: StudyPrediction) -> Page:
    """Report page of a prediction, with its figures."""
    figures = {}
    if prediction.frf is not None:
        figures["prediction_frf"] = frf_figure(prediction.frf)
    if prediction.history is not None:
        figures["prediction_history"] = history_figure(prediction.history)
    if prediction.spectrum is not None:
        figures["prediction_spectrum"] = spectrum_figure(prediction.spectrum)
    words = {
        "title": prediction.title or "Structure",
        "heading": heading(prediction),
        "changes": prediction.changes,
        "bands": prediction.words,
        "doubt": prediction.doubt,
        "width": width_words(prediction),
        "modes": modes_table(prediction.modes),
        "participation": participation_table(prediction),
        **_tables(prediction),
        "loads": prediction.loads,
        "damper": None if prediction.damper is None else damper_table(prediction.damper),
        "damper_words": "" if prediction.damper is None else prediction.damper.overview().words,
        "n_draws": plural(next(iter(parts_of(prediction.modes).values())).n_draws, "model"),
    }
    return Page(PREDICTION_PAGE, "prediction.html.j2", figures, words)
