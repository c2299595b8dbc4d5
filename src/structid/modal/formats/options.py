"""Suffixes of files of modes, and what such a file may not say about itself."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from structid.core.errors import InputError
from structid.core.units import FORCES, LENGTHS

JSON_SUFFIXES, CSV_SUFFIXES, UFF_SUFFIXES = (".json",), (".csv",), (".uff", ".unv", ".uf")
#: Of Nastran, and of CalculiX.
F06_SUFFIXES, PUNCH_SUFFIXES, OP2_SUFFIXES = (".f06",), (".pch", ".pun"), (".op2",)
FRD_SUFFIXES = (".frd",)
WRITTEN_SUFFIXES = (*JSON_SUFFIXES, *UFF_SUFFIXES, *CSV_SUFFIXES, *PUNCH_SUFFIXES)


@dataclass(frozen=True)
class ModeFileOptions:
    """Options for what a file of modes does not say about itself.

    Parameters
    ----------
    subcase : int, optional
        Subcase of a Nastran file whose modes are meant, where several have modes.
    eigenvalues : str
        `real` or `complex`: which modes of a Nastran file are meant, where it has both.
    deck : Path, optional
        Nastran bulk data whose GRID cards say in which systems a listing or punch file gives motions; without it they count
        as global.
    length_unit : str
        Unit of length of the model or file, such as `mm`, where the file does not say it.
    force_unit : str
        Unit of force of the model or file, such as `N`, where the file does not say it.
    shape_axes : str
        `named` where directions of a universal file are called as they are named, whatever coordinate systems its nodes have; by
        default motions are turned into global axes.
    """

    subcase: int | None = None
    eigenvalues: str = ""
    deck: Path | None = None
    length_unit: str = ""
    force_unit: str = ""
    shape_axes: Literal["", "named"] = ""

    def __post_init__(self) -> None:
        """Raise `InputError` if `eigenvalues`, `shape_axes`, `length_unit` or `force_unit` is set to no known name."""
        if self.eigenvalues not in ("", "real", "complex"):
            raise InputError(f"`eigenvalues` must be real or complex, got {self.eigenvalues!r}", "eigenvalues")
        if self.shape_axes not in ("", "named"):
            raise InputError(f"`shape_axes` must be named, or left out, got {self.shape_axes!r}", "shape_axes")
        for name, unit, units in (("length_unit", self.length_unit, LENGTHS), ("force_unit", self.force_unit, FORCES)):
            if unit and unit not in units:
                raise InputError(f"`{name}` must be one of {' '.join(units)}, got {unit!r}", name)

    @property
    def length(self) -> float | None:
        """The stated unit of length in m; None if none is stated."""
        return LENGTHS[self.length_unit] if self.length_unit else None

    @property
    def force(self) -> float | None:
        """The stated unit of force in N; None if none is stated."""
        return FORCES[self.force_unit] if self.force_unit else None
