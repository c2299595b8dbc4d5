"""Sensed motion as the terminal shows it."""

from __future__ import annotations

from rich.console import RenderableType
from rich.text import Text

from structid.core.quantities import number
from structid.prediction.virtual_sensing import LARGEST_CHECK, SensedMotion
from structid.report.tables import Table, printed


def sensing_text(sensed: SensedMotion) -> list[RenderableType]:
    """Terminal text of sensed motion and forces: heading, contradiction, table, checks of left-out sensors and remarks."""
    shown = sensed.overview()
    parts: list[RenderableType] = [Text(shown.words.partition(";")[0], style="bold")]
    if sensed.contradiction:
        parts.append(Text(sensed.contradiction, style="bold red"))
    parts.append(printed(Table(tuple(shown.header), tuple(map(tuple, shown.rows)), (1, 2))))
    if sensed.force_dofs:
        size, time = number(sensed.prior_std, 3), number(sensed.correlation_time, 3)
        about = f" about {number(sensed.force_frequency, 3)} Hz" if sensed.force_frequency > 0 else ""
        about += f", spectrum falling with f^-{2 * sensed.force_order}" if sensed.force_order > 1 else ""
        parts.append(
            Text(f"unknown forces before the record: standard deviation {size} N, correlation time {time} s{about}")
        )
    for dof, z in sensed.checks:
        good = z < LARGEST_CHECK
        verdict = "as it should be" if good else "more than it should be: the model or the forces are wrong there"
        parts.append(Text(f"{dof}, left out: error {number(z, 2)} times its stated deviation, {verdict}"))
    parts += [Text(f"note: {words}") for words in sensed.words]
    return parts
