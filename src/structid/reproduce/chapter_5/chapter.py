"""Chapter 5, modal identification by the pseudo-Rayleigh quotient: Tables 5.1 and 5.2, Figures 5.1 to 5.4, two claims.

References
----------
Norris (1986), chapter 5.
"""

from __future__ import annotations

from structid.reproduce.chapter_5.simple_beam import claim_ten_modes, figures_5_1_and_5_2, table_5_1
from structid.reproduce.chapter_5.square_membrane import claim_close_frequencies, figure_5_3, figure_5_4, table_5_2
from structid.reproduce.item import Progress, ReproducedItem, Step, made


def items(progress: Progress | None = None) -> tuple[ReproducedItem, ...]:
    """Every table and figure of chapter 5, in its order, then the claims of its text that do not hold; nothing is random."""
    steps: tuple[Step, ...] = (
        (0.0, "Table 5.1", lambda _: [table_5_1()]),
        (1 / 7, "Table 5.2", lambda _: [table_5_2()]),
        (2 / 7, "Figures 5.1 and 5.2", lambda _: figures_5_1_and_5_2()),
        (3 / 7, "Figure 5.3", lambda _: [figure_5_3()]),
        (4 / 7, "Figure 5.4", lambda _: [figure_5_4()]),
        (5 / 7, "Claim: ten modes", lambda _: [claim_ten_modes()]),
        (6 / 7, "Claim: close frequencies", lambda _: [claim_close_frequencies()]),
    )
    return made(steps, progress)
