"""The page of a plan."""

from __future__ import annotations

from structid.planning.planned import Plan
from structid.report.figures.plan import plan_figures
from structid.report.page import Page
from structid.report.planning.text import (
    assumption_lines,
    choice_lines,
    enough_lines,
    next_lines,
    options_text,
    parameter_table,
    test_table,
)
from structid.study.results.plan import PLAN_PAGE


def plan_page(found: Plan, title: str = "", notes: tuple[str, ...] = ()) -> Page:
    """The page and its figures."""
    words = {
        "title": title or "Structure",
        "determined": found.determined,
        "chosen_determines": found.chosen.determined,
        "options": options_text(found),
        "lines": [*assumption_lines(found), *choice_lines(found), *enough_lines(found), *next_lines(found)],
        "remarks": [
            *notes,
            *(f"the chosen test determines {d.words}" for d in found.identifiability.directions),
            *(f"in the chosen test {group.words}" for group in found.identifiability.groups),
        ],
        "tests": test_table(found),
        "parameters": parameter_table(found),
    }
    return Page(PLAN_PAGE, "plan.html.j2", plan_figures(found), words)
