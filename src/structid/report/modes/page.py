"""The page of a modal identification, with shapes that move."""

from __future__ import annotations

from dataclasses import asdict

from structid.modal.survey.survey import MODES_PAGE, ModesResult
from structid.report.figures.shapes import shapes_figure
from structid.report.figures.survey import (
    complexity_figure,
    damping_figure,
    mac_figure,
    spectra_figure,
    stabilization_figure,
)
from structid.report.modes.text import method_words, mode_table, record_words, remarks, scale_sentence, std_sentence
from structid.report.page import Page
from structid.report.tables import provenance_facts
from structid.shown import counted


def modes_page(result: ModesResult) -> Page:
    """The page and its figures; those that the method cannot give are left out."""
    drawn = {
        "stabilization": stabilization_figure(result),
        "mode_shapes": shapes_figure(result),
        "singular_values": spectra_figure(result),
        "damping": damping_figure(result),
        "automac": mac_figure(result),
        "complexity": complexity_figure(result),
    }
    words = {
        "title": result.title,
        "found": counted(result.modes.n_modes, "mode"),
        "doubtful": bool(result.warnings) or any(remarks(result)),
        "warnings": result.warnings,
        "scale": scale_sentence(result),
        "std": std_sentence(result),
        "facts": (record_words(result), method_words(result)),
        "steps": result.steps,
        "modes": mode_table(result),
        "provenance": provenance_facts(asdict(result.provenance)),
    }
    return Page(
        MODES_PAGE, "modes.html.j2", {name: figure for name, figure in drawn.items() if figure is not None}, words
    )
