"""Dataset 1858 of universal files: weighting and window of the function before it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

from structid.core.display import plural
from structid.core.errors import FileError
from structid.files.uff.blocks import UffDataset
from structid.files.uff.fields import integers

_WEIGHTINGS = {1: "A", 2: "B", 3: "C", 4: "D"}
_EXPONENTIAL = (4, 6)


def qualifier_words(path: Path, blocks: Sequence[UffDataset], ordinals: Collection[int]) -> str:
    """Note on exponential windows that dataset 1858 states for the functions `ordinals`; "" if there are none.

    `ordinals` count the functions of the file from 1.

    Raises
    ------
    FileError
        If one of these functions has an acoustic weighting, or its dataset 1858 is damaged.
    """
    ordinal, windowed = 0, 0
    for block in blocks:
        ordinal += block.number == 58
        if block.number != 1858 or ordinal not in ordinals or len(block.lines) < 2:
            continue
        try:
            weighting, window = integers(block.lines[1], (6,) * 12)[:2]
        except ValueError as error:
            raise FileError(f"{path}: dataset {block.ordinal} (1858) is damaged ({error}); export it again") from error
        if weighting in _WEIGHTINGS:
            raise FileError(
                f"{path}: function {ordinal} has {_WEIGHTINGS[weighting]} weighting (dataset 1858), as sound levels have; export it"
                " without weighting"
            )
        windowed += window in _EXPONENTIAL
    if not windowed:
        return ""
    return (
        f"an exponential window lies on {plural(windowed, 'function')} (dataset 1858), whose damping is in them: state it"
        " (`window_decay` of a study, `structid modes --window`)"
    )
