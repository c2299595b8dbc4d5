"""The page of a correlation."""

from __future__ import annotations

from dataclasses import asdict

from structid.correlation.correlating import CORRELATION_PAGE, StudyCorrelation
from structid.report.correlation.chapter import Figures, modes_part, responses_part
from structid.report.correlation.text import at_words, channels_table
from structid.report.page import Page
from structid.report.tables import provenance_facts


def correlation_page(found: StudyCorrelation) -> Page:
    """The page and its figures."""
    figures: Figures = {}
    parts: list[dict[str, object]] = []
    for number, modal in enumerate(found.modes, 1):
        drawn, told = modes_part([modal], f"modes_{number}")
        figures |= drawn
        parts.append(told)
    for number, responses in enumerate(found.responses, 1):
        drawn, told = responses_part([responses], f"responses_{number}")
        figures |= drawn
        parts.append(told)
    words = {
        "title": found.study.title,
        "at": at_words(found),
        "is_paired": found.is_paired,
        "warnings": found.warnings,
        "parts": parts,
        "channels": channels_table(found),
        "provenance": provenance_facts(asdict(found.provenance)),
    }
    return Page(CORRELATION_PAGE, "correlation.html.j2", figures, words)
