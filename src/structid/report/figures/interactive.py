"""The figures of the page as Plotly descriptions: plain dictionaries that Plotly draws in the browser."""

from __future__ import annotations

from typing import Any

import numpy as np

from structid.identification.identified import Identification
from structid.report.drawing import palette
from structid.report.drawing.picture import Picture
from structid.report.figures.data import (
    History,
    ModeRows,
    ParameterRatios,
    Responses,
    band_used,
    correlation,
    history,
    mode_rows,
    parameter_ratios,
    ratio_ticks,
    responses,
)
from structid.report.figures.interactive_base import Figure, axis, base_layout, clean, numbers
from structid.report.figures.interactive_residuals import residual_channels_figure, residual_map_figure
from structid.report.figures.interactive_responses import responses_figure
from structid.report.figures.interactive_structure import structure_figures
from structid.report.figures.modal_data import modal_rows
from structid.report.figures.modal_fit import modal_fit_page_figure
from structid.report.text import with_std

_RATIO_CAPTION = (
    "Identified parameters over their initial values (blue line: initial value). Thick bars: one standard deviation,"
    " thin bars: 95 % interval; the interval of parameters that are not determined runs across the whole axis, dashed;"
    " a triangle at the edge stands for a value beyond it."
)


def page_figures(identification: Identification, data: Responses | None, drawn: Picture) -> dict[str, Figure]:
    """Every figure of the page by name."""
    return {
        "parameters": parameters_figure(parameter_ratios(identification)),
        **structure_figures(drawn),
        **({} if data is None else _first_record(data)),
        **_further_records(identification),
        **{
            f"modal-fit-{number}": modal_fit_page_figure(modal_rows(fit))
            for number, fit in enumerate(identification.modal_fits, 1)
        },
        "correlation": correlation_figure(correlation(identification), identification.estimate.names),
        "modes": modes_figure(mode_rows(identification), band_used(identification, data)),
        "convergence": convergence_figure(history(identification)),
    }


def _first_record(data: Responses) -> dict[str, Figure]:
    """Responses and residuals of the first record."""
    return {
        "responses": responses_figure(data),
        "residual-channels": residual_channels_figure(data),
        "residual-map": residual_map_figure(data),
    }


def _further_records(identification: Identification) -> dict[str, Figure]:
    """Responses and residuals of every record but the first."""
    figures = {}
    for number in range(1, len(identification.fits)):
        data = responses(identification.fits[number])
        figures[f"responses-{number + 1}"] = responses_figure(data)
        figures[f"residual-channels-{number + 1}"] = residual_channels_figure(data)
    return figures


def parameters_figure(rows: ParameterRatios) -> Figure:
    """A dot with its intervals for every parameter, over the initial value."""
    n = len(rows.names)
    place = np.arange(n)
    known = ~rows.is_wild
    data: list[dict[str, Any]] = []
    prior = np.isfinite(rows.prior_std)
    if prior.any():
        data.append(
            {
                "type": "bar", "orientation": "h", "name": "prior ± 1 std", "y": numbers(place[prior]), "width": 0.72,
                "base": numbers((rows.prior_mean - rows.prior_std)[prior]), "x": numbers(2 * rows.prior_std[prior]),
                "marker": {"color": palette.SKY, "opacity": 0.35}, "hoverinfo": "skip",
            }
        )  # fmt: skip
    if not known.all():
        data.append(_segments(*rows.limits, place[~known], palette.MUTED, 1.2, "not determined", "dash"))
    floor = rows.limits[0] / 10 if rows.log else None
    one_std = rows.ratio[:, None] + rows.std[:, None] * np.array([-1.0, 1.0])
    for ends, width, name in ((rows.interval, 1.2, "95 % interval"), (one_std, 4.0, "± 1 std")):
        low, high = np.clip(ends[known], floor, None).T
        data.append(_segments(low, high, place[known], palette.INK, width, name))
    for sure, name in ((rows.identified, "identified"), (~rows.identified, "not identified")):
        if sure.any():
            data.append(_dots(rows, place, sure, name))
    height = 150 + (24 if n <= 40 else 17) * n
    layout = base_layout(height, left=None)
    layout["xaxis"] = axis("identified value / initial value") | _ratio_range(rows.limits, rows.log)
    layout["yaxis"] = axis("") | {
        "tickvals": numbers(place), "ticktext": [clean(x) for x in rows.names], "range": [n - 0.4, -0.6],
        "automargin": True, "tickfont": {"size": 12 if n <= 40 else 10},
    }  # fmt: skip
    layout["shapes"] = [_vertical(1.0)]
    layout["bargap"] = 0
    return Figure(data, layout, _RATIO_CAPTION)


def _segments(
    low: Any, high: Any, place: np.ndarray, colour: str, width: float, name: str, dash: str = "solid"
) -> dict[str, Any]:
    """Horizontal lines from `low` to `high`, as one trace."""
    gap = np.full(len(place), np.nan)
    x = np.column_stack([np.broadcast_to(low, place.shape), np.broadcast_to(high, place.shape), gap]).ravel()
    y = np.column_stack([place, place, gap]).ravel()
    line = {"color": colour, "width": width, "dash": dash}
    return {
        "type": "scatter", "mode": "lines", "x": numbers(x), "y": numbers(y), "line": line, "name": name,
        "hoverinfo": "skip",
    }  # fmt: skip


def _dots(rows: ParameterRatios, place: np.ndarray, which: np.ndarray, name: str) -> dict[str, Any]:
    filled = name == "identified"
    low, high = rows.limits
    symbol = np.select([rows.ratio < low, rows.ratio > high], ["triangle-left", "triangle-right"], "circle")
    marker = {
        "size": 9, "color": palette.FITTED if filled else "white", "symbol": symbol[which].tolist(),
        "line": {"color": "white" if filled else palette.FITTED, "width": 1 if filled else 2},
    }  # fmt: skip
    pairs = zip(rows.ratio.tolist(), rows.std.tolist(), strict=True)
    texts = [f"{clean(n)}: {with_std(r, s)}" for n, (r, s) in zip(rows.names, pairs, strict=True)]
    return {
        "type": "scatter", "mode": "markers", "name": name, "x": numbers(rows.shown[which]), "cliponaxis": False,
        "y": numbers(place[which]), "marker": marker, "hovertemplate": "%{text}<extra></extra>",
        "text": [t for t, w in zip(texts, which, strict=True) if w],
    }  # fmt: skip


def _ratio_range(limits: tuple[float, float], log: bool) -> dict[str, Any]:
    if not log:
        return {"range": numbers(limits)}
    ticks = ratio_ticks(limits)
    shown = {"tickvals": [value for value, _ in ticks], "ticktext": [text for _, text in ticks]}
    return {"type": "log", "range": numbers(np.log10(limits)), **shown}


def _vertical(x: float) -> dict[str, Any]:
    line = {"color": palette.INITIAL, "width": 1.5}
    return {"type": "line", "x0": x, "x1": x, "y0": 0, "y1": 1, "yref": "paper", "line": line, "layer": "below"}


def correlation_figure(matrix: np.ndarray, names: tuple[str, ...]) -> Figure:
    """Heat map of the correlation matrix, names on both axes."""
    n = len(names)
    texts = [clean(name) for name in names]
    size = min(150 + 24 * n + 7 * max(len(name) for name in names), 1000)
    trace = {
        "type": "heatmap", "z": [numbers(row, 3) for row in matrix], "zmin": -1, "zmax": 1, "xgap": 1, "ygap": 1,
        "colorscale": palette.plotly_scale(palette.DIVERGING),
        "colorbar": {"title": {"text": "correlation", "side": "right", "font": {"size": 12}}},
        "customdata": [[f"{a} / {b}" for b in texts] for a in texts],
        "hovertemplate": "%{customdata}: %{z:.3f}<extra></extra>", "hoverongaps": False,
    }  # fmt: skip
    layout = base_layout(size, left=None)
    ticks = {
        "tickvals": list(range(n)), "ticktext": texts, "automargin": True, "showgrid": False,
        "tickfont": {"size": 12 if n <= 30 else 9}, "zeroline": False,
    }  # fmt: skip
    layout["xaxis"] = axis("") | ticks | {"tickangle": -90 if n > 8 else -30, "constrain": "domain"}
    layout["yaxis"] = axis("") | ticks | {"autorange": "reversed", "scaleanchor": "x", "constrain": "domain"}
    layout["plot_bgcolor"] = "#D9D9D9"
    caption = "Correlation between the errors of two parameters, from the adopted covariance. Grey: not determined."
    return Figure([trace], layout, caption)


def modes_figure(rows: ModeRows, band: tuple[float, float]) -> Figure:
    """Natural frequencies and damping ratios before and after, by mode number."""
    number = np.arange(1, len(rows.frequency) + 1)
    data = []
    pairs = (("", rows.initial_frequency, rows.frequency), ("2", 100 * rows.initial_damping, 100 * rows.damping))
    for which, before, after in pairs:
        places = {
            "xaxis": f"x{which}",
            "yaxis": f"y{which}",
            "type": "scatter",
            "mode": "markers",
            "x": numbers(number),
        }
        open_square = {"symbol": "square-open", "size": 10, "color": palette.INITIAL, "line": {"width": 2}}
        data.append(places | {"y": numbers(before), "name": "initial", "marker": open_square, "showlegend": not which})
        dot = {"size": 9, "color": palette.FITTED}
        data.append(places | {"y": numbers(after), "name": "identified", "marker": dot, "showlegend": not which})
    layout = base_layout(360)
    whole = {"dtick": 1 if len(number) < 16 else 5}
    layout["xaxis"] = axis("mode number") | {"domain": [0, 0.46]} | whole
    layout["xaxis2"] = axis("mode number") | {"domain": [0.56, 1], "anchor": "y2"} | whole
    layout["yaxis"] = axis("natural frequency (Hz)") | {"rangemode": "tozero"}
    layout["yaxis2"] = axis("damping ratio (%)") | {"anchor": "x2", "rangemode": "tozero"}
    layout["shapes"] = [
        {
            "type": "rect", "x0": 0, "x1": 1, "xref": "x domain", "y0": band[0], "y1": band[1], "layer": "below",
            "fillcolor": palette.YELLOW, "opacity": 0.25, "line": {"width": 0},
        }
    ]  # fmt: skip
    caption = "Natural frequencies and damping ratios of the initial and the identified model. Yellow: band used."
    return Figure(data, layout, caption)


def convergence_figure(course: History) -> Figure:
    """Parameters over their initial values against the iteration; the largest changes in colour."""
    iteration = numbers(np.arange(len(course.ratio)))
    data = []
    others = [i for i in range(len(course.names)) if i not in course.highlighted]
    for i in others:
        data.append(_course(course, i, iteration, palette.FAINT, 1.0) | {"showlegend": False})
    for i, colour in zip(course.highlighted, palette.CYCLE, strict=False):
        data.append(_course(course, i, iteration, colour, 2.0))
    layout = base_layout(340)
    layout["xaxis"] = axis("iteration of the last stage")
    layout["yaxis"] = axis("value / initial value") | _ratio_range(course.limits, course.log)
    layout["legend"] = {"x": 1.02, "y": 1, "yanchor": "top"}
    rest = f" Grey: the {len(others)} other parameters." if others else ""
    caption = f"Parameters along the last stage of the search; those that changed most are named.{rest}"
    return Figure(data, layout, caption)


def _course(course: History, i: int, iteration: list[Any], colour: str, width: float) -> dict[str, Any]:
    return {
        "type": "scatter", "mode": "lines+markers", "x": iteration, "y": numbers(course.ratio[:, i]),
        "name": clean(course.names[i]), "line": {"color": colour, "width": width}, "marker": {"size": 4},
    }  # fmt: skip
