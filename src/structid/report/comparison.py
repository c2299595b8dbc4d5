"""The comparison of two states: its words and tables, as the terminal shows them, its page and its figures."""

from __future__ import annotations

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from structid.compare.states import COMPARE_PAGE, ComparisonResult, DrawableStructure
from structid.core.display import first_warnings, number, percent, prefixed, with_std
from structid.inversion.state_comparison import Comparison
from structid.report.drawing import palette
from structid.report.drawing.drawing import structure_picture
from structid.report.figures.parameters import NORMAL_95
from structid.report.figures.structure import (
    KINDS,
    Change,
    Changes,
    Shading,
    elements_of,
    properties_of,
    round_limit,
    shading,
    structure_figure,
)
from structid.report.page import Page, Table, printed
from structid.report.rendering import plot

_HEADER = (
    "Parameter", "Baseline", "Later", "Unit", "Change", "Std", "p", "Declared", "Detection limit",
)  # fmt: skip


def comparison_table(result: ComparisonResult) -> Table:
    """Table of all compared parameters, one row each, in the order of `Comparison.order`, declared changes first.

    Columns are name, values before and after with standard deviations, their unit, relative change, its standard deviation,
    the p-value corrected for the number of tests, mark ("changed" or "") and relative detection limit.
    """
    comparison = result.comparison
    order = comparison.order
    rows: list[tuple[str, ...]] = []
    for i in order:
        before, after = float(comparison.before[i]), float(comparison.after[i])
        factor, unit = prefixed(comparison.units[i], before, after)
        variances = comparison.covariance_before[i, i], comparison.covariance_after[i, i]
        std_before, std_after = (float(variance) ** 0.5 / factor for variance in variances)
        rows.append(
            (
                comparison.names[i],
                with_std(before / factor, std_before),
                with_std(after / factor, std_after),
                unit,
                percent(float(comparison.relative_change[i])),
                percent(float(comparison.relative_std[i]), 2, signed=False),
                _probability(float(comparison.adjusted[i])),
                "changed" if comparison.changed[i] else "",
                percent(float(comparison.relative_detection_limit[i]), 2, signed=False),
            )
        )
    marks = tuple("changed" if comparison.changed[i] else "" for i in order)
    return Table(_HEADER, tuple(rows), (1, 2, 4, 5, 6, 8), marks)


def facts(result: ComparisonResult) -> list[str]:
    """Sentences on how two states were compared: titles, basis, correction for several tests, joint test, detection limit."""
    comparison = result.comparison
    rule = (
        "Holm: no false declaration among all of them with probability"
        f" {percent(1 - comparison.level, 3, signed=False)} or more"
        if comparison.correction == "holm"
        else f"Benjamini-Hochberg: on average at most {percent(comparison.level, 2, signed=False)} of those declared are false"
    )
    together = (
        f"all changes together: chi-square {number(comparison.statistic, 3)} for {len(comparison.names)} parameters,"
        f" probability {_probability(comparison.probability)} if nothing had changed"
    )
    power = percent(comparison.power, 2, signed=False)
    return [
        f"{result.baseline.title} → {result.later.title}",
        f"basis: {result.basis_words}",
        f"corrected for {len(comparison.names)} tests by {rule}",
        together,
        *([result.unchanged.words] if result.unchanged is not None and not result.is_contradicted else []),
        f"detection limit: smallest single change that is declared with probability {power}",
    ]


def comparison_text(result: ComparisonResult) -> list[RenderableType]:
    """Terminal text of a comparison of two states: titles, warnings, the result as a sentence, its basis, and the table."""
    warnings = [Text(words, style="yellow") for words in first_warnings(result.warnings)]
    first, *rest = facts(result)
    return [
        Text(first, style="bold"),
        *warnings,
        Text(result.words, style="bold red" if result.is_contradicted else "bold"),
        *map(Text, rest),
        printed(comparison_table(result)),
    ]


def _probability(value: float) -> str:
    """Probability as text with two digits; "< 10⁻¹²" below that."""
    return f"< 10{chr(0x207B)}¹²" if value < 1e-12 else number(value, 2)


def comparison_page(result: ComparisonResult) -> Page:
    """Report page of a comparison of two states, with its figures."""
    comparison = result.comparison
    words = {
        "title": f"{result.baseline.title} → {result.later.title}",
        "complete": comparison.is_complete,
        "any_changed": bool(comparison.changed.any()),
        "is_contradicted": result.is_contradicted,
        "words": result.words,
        "warnings": result.warnings,
        "facts": facts(result)[1:],
        "changes": comparison_table(result),
    }
    return Page(COMPARE_PAGE, "compare.html.j2", comparison_figures(result), words)


def comparison_figures(result: ComparisonResult) -> dict[str, plot.Figure]:
    """Figures of a comparison by name: "changes", and "map" if one of the two states has a structure to draw.

    The later state's structure is drawn if it has one, else the baseline's.
    """
    figures = {"changes": changes_figure(result.comparison)}
    drawn = result.later.drawn or result.baseline.drawn
    if drawn is not None:
        figures["map"] = map_figure(result.comparison, drawn)
    return figures


def changes_figure(comparison: Comparison) -> plot.Figure:
    """Figure of the relative change (%) of every parameter with its 95 % interval, over its detection limit.

    Parameters whose change has no standard deviation are marked as not determined, at 0.
    """
    heights, limit = np.arange(len(comparison.names), dtype=float), 100 * _axis_limit(comparison)
    ratio, std = 100 * comparison.relative_change, 100 * comparison.relative_std
    seen, half = np.isfinite(std), 100 * comparison.relative_detection_limit
    at, middle, tail = heights[seen], ratio[seen], NORMAL_95 * std[seen]
    below = f"below the detection limit ({percent(comparison.power, 2, signed=False)} power)"
    traces: list[plot.Trace] = [
        plot.boxes((-half[seen], half[seen]), (at - 0.36, at + 0.36), palette.GRID, below),
        plot.segments((0.0, 0.0), (-0.6, len(heights) - 0.4), plot.Pen(palette.MUTED)),
        plot.segments((middle - tail, middle + tail), (at, at), plot.Pen(palette.INK, 1.8), "95 % interval"),
    ]
    rows = zip(comparison.names, comparison.relative_change, comparison.relative_std, strict=True)
    texts = [f"{name}: {percent(change)}, std {percent(spread, 2, signed=False)}" for name, change, spread in rows]
    edge = plot.Pen(palette.INK, 1.2)
    for which, marker, label in (
        (seen & ~comparison.changed, plot.Marker("circle", 8.0, "white", edge), "no change declared"),
        (seen & comparison.changed, plot.Marker("diamond", 9.0, palette.FITTED, edge), "change declared"),
        (~seen, plot.Marker("x-thin", 8.0, "", plot.Pen(palette.MUTED)), "not determined"),
    ):
        words = tuple(text for text, chosen in zip(texts, which, strict=True) if chosen)
        traces.append(plot.Curve(np.where(seen, ratio, 0.0)[which], heights[which], None, marker, label, words))
    x = plot.Axis("change", "%", (-limit, limit))
    return plot.Figure((plot.panel(x, plot.rows_axis(comparison.names), *traces),), plot.rows_size(len(heights)))


def _axis_limit(comparison: Comparison) -> float:
    """Largest relative change on the axis, a fraction: it holds all changes and most intervals.

    It is 1.15 times the farthest interval end, or less: 1.5 times the largest change or 4 times the median end,
    whichever is larger. 1 if no change is known.
    """
    reach = np.abs(comparison.relative_change) + NORMAL_95 * comparison.relative_std
    reach = reach[np.isfinite(reach)]
    if not reach.size:
        return 1.0
    return float(
        min(1.15 * reach.max(), max(1.5 * np.nanmax(np.abs(comparison.relative_change)), 4 * np.median(reach)))
    )


def map_figure(comparison: Comparison, drawn: DrawableStructure) -> plot.Figure:
    """Figure of the structure with each element coloured by its declared change, white without; one panel for each kind.

    Kinds of property without compared parameters are left out.
    """
    shown = (_shading(comparison, drawn, name, kinds) for name, kinds in KINDS.items())
    picture = structure_picture(drawn.structure, drawn.outputs, drawn.inputs)
    return structure_figure(picture, tuple(shade for shade in shown if shade is not None))


def _shading(comparison: Comparison, drawn: DrawableStructure, name: str, kinds: tuple[str, ...]) -> Shading | None:
    """Shading of elements by the declared changes of one kind of property; None if none of its parameters was compared.

    `name` is the kind's name in the title, `kinds` are the kinds of property that belong to it. Changes not declared
    count as 0; of several parameters of an element the largest change counts. `drawn` is the structure with its
    parameters.
    """
    index_of = {label: i for i, label in enumerate(comparison.names)}
    changes: Changes = {}
    for item in properties_of(drawn.structure, kinds):
        for key, _, columns in elements_of(item, drawn.parameters.design.tocsr()):
            names = [drawn.parameters.names[c] for c in columns]
            for i in (index_of[label] for label in names if label in index_of):
                ratio = float(comparison.relative_change[i]) if comparison.changed[i] else 0.0
                change = Change(
                    ratio, bool(np.isfinite(comparison.p_values[i])), f"{comparison.names[i]}: {percent(ratio)}"
                )
                if key not in changes or abs(ratio) > abs(changes[key].ratio):
                    changes[key] = change
    if not changes:
        return None
    title = f"Declared change of {name} parameters (white: none declared)"
    return shading(title, changes, round_limit(change.ratio for change in changes.values()))
