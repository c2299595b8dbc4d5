"""Sensed motion as the terminal shows it, and its page."""

from __future__ import annotations

from rich.console import RenderableType
from rich.text import Text

from structid.core.quantities import number
from structid.prediction.sensing.result import LARGEST_CHECK, SensedMotion
from structid.report.figures.sensing import forces_figure, left_out_figure, sensed_figure
from structid.report.page import Page
from structid.report.tables import Table, printed

SENSING_PAGE = "sensed.html"


def _motion_table(sensed: SensedMotion) -> Table:
    """Table with a row for each output, then each force: root mean square of its values and of their standard deviations."""
    shown = sensed.overview()
    return Table(tuple(shown.header), tuple(map(tuple, shown.rows)), (1, 2))


def left_out_table(sensed: SensedMotion) -> Table:
    """Table with a row for each sensor that was left out: error over stated deviation, and a verdict on it."""
    rows = tuple((str(dof), number(z, 2), _check_words(z)) for dof, z in sensed.checks)
    return Table(("Sensor, left out", "Error over stated deviation", "Verdict"), rows, (1,))


def _check_words(z: float) -> str:
    good = z < LARGEST_CHECK
    return "as it should be" if good else "more than it should be: the model or the forces are wrong there"


def _prior_words(sensed: SensedMotion) -> str:
    """Words on size, correlation time and spectrum of the unknown forces before the record; "" where there are none."""
    if not sensed.force_dofs:
        return ""
    size, time = number(sensed.prior_std, 3), number(sensed.correlation_time, 3)
    about = f" about {number(sensed.force_frequency, 3)} Hz" if sensed.force_frequency > 0 else ""
    about += f", spectrum falling with f^-{2 * sensed.force_order}" if sensed.force_order > 1 else ""
    return f"unknown forces before the record: standard deviation {size} N, correlation time {time} s{about}"


def sensing_text(sensed: SensedMotion) -> list[RenderableType]:
    """Terminal text of sensed motion and forces: heading, contradiction, table, checks of left-out sensors and remarks."""
    parts: list[RenderableType] = [Text(sensed.overview().words.partition(";")[0], style="bold")]
    if sensed.contradiction:
        parts.append(Text(sensed.contradiction, style="bold red"))
    parts.append(printed(_motion_table(sensed)))
    if sensed.force_dofs:
        parts.append(Text(_prior_words(sensed)))
    parts += [
        Text(f"{dof}, left out: error {number(z, 2)} times its stated deviation, {_check_words(z)}")
        for dof, z in sensed.checks
    ]
    parts += [Text(f"note: {words}") for words in sensed.words]
    return parts


def sensing_page(sensed: SensedMotion, title: str, record: str) -> Page:
    """Report page of sensed motion, with its figures; `title` is that of the study, `record` names the file."""
    figures = {"sensed_motion": sensed_figure(sensed)}
    if sensed.left_out:
        figures["sensed_left_out"] = left_out_figure(sensed)
    if sensed.force_dofs:
        figures["sensed_forces"] = forces_figure(sensed)
    table, n_outputs = _motion_table(sensed), len(sensed.outputs)
    header = ("Where", "Root mean square", "Its standard deviation")
    words = {
        "title": title or "Structure",
        "heading": f"{sensed.overview().words.partition(';')[0]}, from {record}",
        "is_explained": sensed.is_explained,
        "contradiction": sensed.contradiction,
        "notes": sensed.words,
        "outputs": Table(header, table.rows[:n_outputs], (1, 2)),
        "forces": Table(header, table.rows[n_outputs:], (1, 2)),
        "left_out": left_out_table(sensed),
        "largest_check": f"{LARGEST_CHECK:g}",
        "prior": _prior_words(sensed),
    }
    return Page(SENSING_PAGE, "sensing.html.j2", figures, words)
