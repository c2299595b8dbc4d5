"""Units of a universal file: dataset 164.

References
----------
Structural Dynamics Research Laboratory, University of Cincinnati: Universal file formats, dataset 164.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from structid.core.errors import FileError
from structid.core.units import FORCES, LENGTHS
from structid.files.uff.blocks import UffDataset
from structid.files.uff.fields import read_reals

_POUNDAL = 0.3048 * 0.45359237
#: Length in m and force in N of each units code of dataset 164; 9 is for other ones.
_CODES = {
    1: (1.0, 1.0), 2: (LENGTHS["ft"], FORCES["lbf"]), 3: (1.0, FORCES["kgf"]), 4: (LENGTHS["ft"], _POUNDAL),
    5: (1e-3, 1e-3), 6: (1e-2, 1e-2), 7: (LENGTHS["in"], FORCES["lbf"]), 8: (1e-3, FORCES["kgf"]), 10: (1e-3, 1.0),
}  # fmt: skip
_SAME = 1e-4


class UnitFactors(NamedTuple):
    """Units of a universal file: its numbers are divided by these to become m and N."""

    length: float
    force: float


def read_unit_factors(path: Path, blocks: Sequence[UffDataset]) -> UnitFactors | None:
    """The unit factors that dataset 164 states, by which numbers are divided to become m and N; None without dataset 164.

    `blocks` are the datasets of the file at `path`.

    Raises
    ------
    FileError
        If a factor is not positive, contradicts the units code beside it, or two datasets 164 differ.
    """
    stated = {_read_dataset_164(path, block) for block in blocks if block.number == 164}
    if len(stated) > 1:
        raise FileError(
            f"{path}: has several datasets 164 with different units; export the parts to files of their own"
        )
    return stated.pop() if stated else None


def _read_dataset_164(path: Path, block: UffDataset) -> UnitFactors:
    """The unit factors of one dataset 164; `FileError` if they are damaged or contradict their units code."""
    where = f"{path}: dataset {block.ordinal} (164)"
    lines = block.content.splitlines()
    try:
        code = int(lines[0][:10])
        numbers = read_reals(b"\n".join(lines[1:]))
        length, force = float(numbers[0]), float(numbers[1])
    except (ValueError, IndexError) as error:
        raise FileError(f"{where} is damaged ({error}); export it again") from error
    if not all(math.isfinite(factor) and factor > 0 for factor in (length, force)):
        raise FileError(f"{where} has unit factors {(length, force)}; they must be positive")
    if code in _CODES:
        unit = _CODES[code]
        if abs(length * unit[0] - 1) > _SAME or abs(force * unit[1] - 1) > _SAME:
            raise FileError(
                f"{where} has units code {code}, which stands for factors {1 / unit[0]:g} of length and {1 / unit[1]:g} of"
                f" force, but states {length:g} and {force:g}; correct one of them (code 9 is for other units)"
            )
    return UnitFactors(length, force)
