"""Predictions as the terminal shows them, and their page."""

from __future__ import annotations

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from structid.core.display import plural
from structid.core.quantities import NOTHING, number, percent, unit_text, value_words
from structid.prediction.predict import PredictedChange, Prediction
from structid.prediction.tuned_damper import TunedDamper
from structid.report.figures.prediction import frf_figure, history_figure, spectrum_figure
from structid.report.page import Page
from structid.report.tables import Table, printed
from structid.study.run.predicting import PREDICTION_PAGE, StudyPrediction, parts_of

#: Part of a value that rounding makes at most.
_ROUNDING = 1e-7


def modes_table(found: Prediction | PredictedChange) -> Table:
    """Table of predicted natural frequencies and damping ratios, before and after changes if there are any."""
    parts = parts_of(found)
    header: tuple[str, ...]
    if isinstance(found, PredictedChange):
        header = ("Mode", "Before (Hz)", "After (Hz)", "Change (Hz)", "Damping before", "Damping after")
    else:
        header = ("Mode", "Frequency (Hz)", "95 % interval", "Damping ratio", "95 % interval")
    rows = []
    for k in range(len(next(iter(parts.values())).values)):
        cells = [str(k + 1)]
        if isinstance(found, PredictedChange):
            cells += [_value(part, (k, 0), float(found.before.values[k, 0])) for part in parts.values()]
            cells += [_percent(part, (k, 1)) for name, part in parts.items() if name != "difference"]
        else:
            cells += [
                _value(found, (k, 0)),
                _interval(found, (k, 0)),
                _percent(found, (k, 1)),
                _interval(found, (k, 1), 100),
            ]
        rows.append(tuple(cells))
    return Table(header, tuple(rows), tuple(range(len(header))))


def outputs_table(found: Prediction | PredictedChange, title: str = "Largest") -> Table:
    """Table of a quantity with one value an output, such as the largest predicted motion of each sensor."""
    parts = parts_of(found)
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
    """Value and deviation; 0 where both are rounding of values of this `size`."""
    value, std = float(part.values[index]), float(part.std[index])
    return "0" if max(abs(value), std) <= _ROUNDING * size else value_words(value, std)


def _percent(part: Prediction, index: tuple[int, ...]) -> str:
    return percent(float(part.values[index]), signed=False)


def _interval(part: Prediction, index: tuple[int, ...], factor: float = 1.0) -> str:
    """Text of the interval of the value at `index`, times `factor` (100 for per cent); a dash if not finite."""
    low, high = factor * float(part.low[index]), factor * float(part.high[index])
    if not np.isfinite([low, high]).all():
        return NOTHING
    return f"{number(low)} to {number(high)}{' %' if factor == 100 else ''}"


def heading(found: StudyPrediction) -> str:
    """Heading in one line: the predicted quantities, the folder, loads and changes."""
    kinds = (("FRFs", found.frf), ("history", found.history), ("spectra", found.spectrum))
    what = [name for name, part in kinds if part is not None]
    words = f"{' and '.join([*what, 'modes'])} predicted from {found.folder}"
    words += f", {found.loads}" if found.loads else ""
    return f"{words}; {', '.join(found.changes)}" if found.changes else words


def width_words(found: StudyPrediction) -> str:
    """Sentence on the median half-width of the predicted FRFs' 95 % bands; "" if no FRF is predicted."""
    if found.frf is None:
        return ""
    words = []
    for name, part in parts_of(found.frf).items():
        if name != "difference":
            size = np.abs(part.values)
            half = np.divide(part.high - part.low, 2 * size, out=np.zeros(size.shape), where=size > 0)
            words.append(f"{'' if name == 'value' else name + ' '}{percent(float(np.median(half)), signed=False)}")
    return f"Half-width of the 95 % band of the FRFs, median over lines: {', '.join(words)}"


def damper_table(damper: TunedDamper) -> Table:
    """Table of the values of a tuned mass damper, best over the uncertainty and for the identified model."""
    shown = damper.overview()
    return Table(tuple(shown.header), tuple(map(tuple, shown.rows)), tuple(range(1, len(shown.header))))


def _tables(found: StudyPrediction) -> dict[str, Table | None]:
    """Tables with one row an output, by their names in the page; None of what was not predicted."""
    titles = {
        "maxima": (found.maxima, "Largest"),
        "root_mean_square": (found.root_mean_square, "Root mean square"),
        "largest": (found.largest, f"Largest in {found.duration or 0:g} s, on the mean"),
    }
    return {name: None if part is None else outputs_table(part, title) for name, (part, title) in titles.items()}


def prediction_text(found: StudyPrediction) -> list[RenderableType]:
    """Terminal text of a prediction: natural modes, largest motions, and what the bands include."""
    parts: list[RenderableType] = [Text(heading(found), style="bold"), printed(modes_table(found.modes))]
    if found.damper is not None:
        parts += [Text(found.damper.overview().words), printed(damper_table(found.damper))]
    parts += [printed(table) for table in _tables(found).values() if table is not None]
    parts += [Text(words) for words in (width_words(found), found.words) if words]
    if found.doubt:
        parts.append(Text(f"note: {found.doubt}"))
    return parts


def prediction_page(found: StudyPrediction) -> Page:
    """Report page of a prediction, with its figures."""
    figures = {}
    if found.frf is not None:
        figures["prediction_frf"] = frf_figure(found.frf)
    if found.history is not None:
        figures["prediction_history"] = history_figure(found.history)
    if found.spectrum is not None:
        figures["prediction_spectrum"] = spectrum_figure(found.spectrum)
    words = {
        "title": found.title or "Structure",
        "heading": heading(found),
        "changes": found.changes,
        "bands": found.words,
        "doubt": found.doubt,
        "width": width_words(found),
        "modes": modes_table(found.modes),
        **_tables(found),
        "loads": found.loads,
        "damper": None if found.damper is None else damper_table(found.damper),
        "damper_words": "" if found.damper is None else found.damper.overview().words,
        "n_draws": plural(next(iter(parts_of(found.modes).values())).n_draws, "model"),
    }
    return Page(PREDICTION_PAGE, "prediction.html.j2", figures, words)
