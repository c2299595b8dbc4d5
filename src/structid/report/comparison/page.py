"""The page of a comparison."""

from __future__ import annotations

from structid.comparison.comparing import COMPARE_PAGE, ComparisonResult
from structid.report.comparison.text import comparison_table, facts
from structid.report.figures.comparison import comparison_figures
from structid.report.page import Page


def comparison_page(result: ComparisonResult) -> Page:
    """The page and its figures."""
    found = result.comparison
    words = {
        "title": f"{result.baseline.title} → {result.later.title}",
        "complete": found.is_complete,
        "any_changed": bool(found.changed.any()),
        "words": found.words,
        "warnings": result.warnings,
        "facts": facts(result)[1:],
        "changes": comparison_table(result),
    }
    return Page(COMPARE_PAGE, "compare.html.j2", comparison_figures(result), words)
