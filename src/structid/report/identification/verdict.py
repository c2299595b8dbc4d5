"""The verdict on the page: the fact that matters first, and the causes of a misfit with the studies that they make."""

from __future__ import annotations

from collections.abc import Sequence

from structid.criticism.held import HeldValue, resting
from structid.criticism.verdict import Cause, Criticism
from structid.report.tables import Table
from structid.report.text import NOTHING, number, percent, with_unit
from structid.shown import counted

_MARKS = {"sound": "good", "approximate": "doubt", "wrong_model": "bad", "undetermined": "bad"}
_HELD = (
    "Held in the model",
    "1 % more of it moves most",
    "by",
    "in standard deviations",
    "The record would change it by",
)
_HEADER = ("Cause", "Misfit removed", "Chi-square per degree of freedom left", "What it adds", "Value that moves most")


def verdict_words(criticism: Criticism | None) -> dict[str, object]:
    """What the template shows of the verdict."""
    if criticism is None:
        return {"verdict": None, "held": None}
    judgement, causes = criticism.judgement, criticism.named
    return {
        "verdict": {
            "words": judgement.words,
            "mark": _MARKS[judgement.verdict],
            "reasons": judgement.reasons[1:],
            "heading": "What explains the misfit" if criticism.causes else "What would lower the misfit",
            "tried": f"{counted(criticism.n_tried, 'change')} of model and record tried" if criticism.n_tried else "",
            "causes": Table(_HEADER, tuple(_row(cause, causes[0]) for cause in causes), (1, 2)) if causes else None,
            "studies": [(cause.line, cause.study, "\n".join(cause.lines)) for cause in causes if cause.study],
        },
        "held": held_table(criticism.held) if criticism.held else None,
    }


def held_table(held: Sequence[HeldValue]) -> Table:
    """What the model holds, that which moves a value farthest first."""
    return Table(_HELD, tuple(_held_row(one) for one in resting(held)), (2, 3, 4))


def _held_row(one: HeldValue) -> tuple[str, ...]:
    at = one.most_moved
    pull = f"{percent(one.pull, 2)} ± {percent(one.pull_std, 2, signed=False)}" if one.pull_std > 0 else NOTHING
    return one.name, one.parameters[at], percent(0.01 * one.influence[at], 2), number(abs(one.distance[at]), 2), pull


def _row(cause: Cause, first: Cause) -> tuple[str, ...]:
    alike = " (the data do not tell it from the first)" if cause.is_alike and cause is not first else ""
    added = ", ".join(f"{name} = {with_unit(number(value), unit)}" for name, value, unit in cause.found)
    moved = ""
    if cause.moved:
        one = cause.moved[0]
        moved = f"{one.name}: {number(one.before)} to {with_unit(number(one.after), one.unit)}"
    return cause.line + alike, percent(cause.share, 3, signed=False), number(cause.chi_square_per_dof, 3), added, moved
