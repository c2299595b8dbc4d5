"""A comparison in words and tables, as the terminal shows it, and its page."""

from __future__ import annotations

from rich.console import RenderableType
from rich.text import Text

from structid.compare.states.comparing import COMPARE_PAGE, ComparisonResult
from structid.core.display import first_warnings
from structid.core.quantities import number, percent, unit_text, with_std
from structid.report.figures.comparison import comparison_figures
from structid.report.page import Page
from structid.report.tables import Table, printed

_HEADER = (
    "Parameter", "Unit", "Baseline", "Later", "Change", "Std", "p", "p corrected", "Declared", "Detection limit",
)  # fmt: skip


def comparison_table(result: ComparisonResult) -> Table:
    """Table of all compared parameters, one row each, declared changes first and marked "changed".

    Columns are name, unit, values before and after with deviations, relative change, its deviation, p-value, adjusted
    p-value, mark and detection limit.
    """
    comparison = result.comparison
    order = comparison.order
    rows: list[tuple[str, ...]] = []
    for i in order:
        before = with_std(float(comparison.before[i]), float(comparison.covariance_before[i, i]) ** 0.5)
        after = with_std(float(comparison.after[i]), float(comparison.covariance_after[i, i]) ** 0.5)
        rows.append(
            (
                comparison.names[i],
                unit_text(comparison.units[i]),
                before,
                after,
                percent(float(comparison.relative_change[i])),
                percent(float(comparison.relative_std[i]), 2, signed=False),
                _probability(float(comparison.p_values[i])),
                _probability(float(comparison.adjusted[i])),
                "changed" if comparison.changed[i] else "",
                percent(float(comparison.relative_detection_limit[i]), 2, signed=False),
            )
        )
    marks = tuple("changed" if comparison.changed[i] else "" for i in order)
    return Table(_HEADER, tuple(rows), (2, 3, 4, 5, 6, 7, 9), marks)


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
    """Two digits; what is below one in a million million is told as that."""
    return f"< 10{chr(0x207B)}¹²" if value < 1e-12 else number(value, 2)


def comparison_page(result: ComparisonResult) -> Page:
    """Report page of a comparison of two states, with its figures."""
    comparison = result.comparison
    words = {
        "title": f"{result.baseline.title} → {result.later.title}",
        "complete": comparison.is_complete,
        "any_changed": bool(comparison.changed.any()) or result.is_contradicted,
        "words": result.words,
        "warnings": result.warnings,
        "facts": facts(result)[1:],
        "changes": comparison_table(result),
    }
    return Page(COMPARE_PAGE, "compare.html.j2", comparison_figures(result), words)
