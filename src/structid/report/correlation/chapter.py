"""What pages show of each record beside a model, or beside the initial and the identified one."""

from __future__ import annotations

from collections.abc import Sequence

from structid.correlation.correlating import before_and_after
from structid.correlation.modes import ModesCorrelation
from structid.correlation.responses import ResponsesCorrelation
from structid.identification.identified import Identification
from structid.report.correlation.text import (
    expansion_table,
    frac_words,
    modes_table,
    orthogonality_facts,
    resonances_table,
    summary_words,
    surplus_table,
)
from structid.report.figures.correlation import (
    ALONE,
    BEFORE_AND_AFTER,
    comac_figure,
    fdac_figure,
    frac_figure,
    mac_figure,
)
from structid.report.figures.side_by_side import side_by_side_figure
from structid.report.rendering import plot

Figures = dict[str, plot.Figure]


def modes_part(parts: Sequence[ModesCorrelation], key: str) -> tuple[Figures, dict[str, object]]:
    """Figures, whose names begin with `key`, and words of measured modes beside one model or two, the last one counting."""
    part, words = parts[-1], ALONE if len(parts) == 1 else BEFORE_AND_AFTER
    drawn = {
        f"{key}_mac": mac_figure(parts, words),
        f"{key}_comac": comac_figure(parts, words) if part.n_paired else None,
        f"{key}_shapes": side_by_side_figure(part),
    }
    told = {
        "key": key,
        "is_modal": True,
        "title": part.name,
        "words": [_told(word, summary_words(one), len(parts)) for word, one in zip(words, parts, strict=True)],
        "warnings": part.warnings,
        "table": modes_table(part),
        "surplus": surplus_table(part),
        "facts": orthogonality_facts(part),
        "expansion": expansion_table(part),
        "resonances": None,
    }
    return {name: figure for name, figure in drawn.items() if figure is not None}, told


def responses_part(parts: Sequence[ResponsesCorrelation], key: str) -> tuple[Figures, dict[str, object]]:
    """The same of measured responses."""
    part, words = parts[-1], ALONE if len(parts) == 1 else BEFORE_AND_AFTER
    drawn = {f"{key}_frac": frac_figure(parts, words), f"{key}_fdac": fdac_figure(parts, words)}
    told = {
        "key": key,
        "is_modal": False,
        "title": part.name,
        "words": [_told(word, frac_words(one), len(parts)) for word, one in zip(words, parts, strict=True)],
        "warnings": part.warnings,
        "resonances": resonances_table(part),
    }
    return {name: figure for name, figure in drawn.items() if figure is not None}, told


def _told(word: str, words: str, count: int) -> str:
    inside = words if words[:2].isupper() else words[0].lower() + words[1:]
    return f"{words}." if count == 1 else f"{word.capitalize()} model: {inside}."


def side_by_side_chapter(found: Identification) -> tuple[Figures, list[dict[str, object]]]:
    """The chapter of an identification: each record beside the initial and the identified model."""
    figures: Figures = {}
    parts: list[dict[str, object]] = []
    modal, responses = before_and_after(found)
    for drawn, told in (
        *(modes_part(both, f"correlation_{number}_modes") for number, both in enumerate(modal, 1)),
        *(responses_part(both, f"correlation_{number}_responses") for number, both in enumerate(responses, 1)),
    ):
        figures |= drawn
        parts.append(told)
    if len(parts) == 1:
        parts[0]["title"] = ""
    return figures, parts
