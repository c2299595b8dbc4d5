"""Chapter 5, modal identification by the pseudo-Rayleigh quotient: Tables 5.1 and 5.2, Figures 5.1 to 5.4, two claims.

References
----------
Norris (1986), chapter 5.
"""

from __future__ import annotations

from structid.reproduce.chapter_5.simple_beam import claim_ten_modes, figures_5_1_and_5_2, table_5_1
from structid.reproduce.chapter_5.square_membrane import claim_close_frequencies, figure_5_3, figure_5_4, table_5_2
from structid.reproduce.item import Item, Progress


def items(progress: Progress | None = None) -> tuple[Item, ...]:
    """Every table and figure of chapter 5, in its order, then the claims of its text that do not hold.

    Nothing is random; a few seconds in all.

    Parameters
    ----------
    progress : Progress, optional
        Called before each item and at the end.
    """
    made: list[Item] = []
    steps = (
        ("Table 5.1", lambda: [table_5_1()]),
        ("Table 5.2", lambda: [table_5_2()]),
        ("Figures 5.1 and 5.2", lambda: [*figures_5_1_and_5_2()]),
        ("Figure 5.3", lambda: [figure_5_3()]),
        ("Figure 5.4", lambda: [figure_5_4()]),
        ("Claim: ten modes", lambda: [claim_ten_modes()]),
        ("Claim: close frequencies", lambda: [claim_close_frequencies()]),
    )
    for done, (name, make) in enumerate(steps):
        if progress:
            progress(name, done / len(steps))
        made += make()
    if progress:
        progress("chapter 5", 1.0)
    return tuple(made)
