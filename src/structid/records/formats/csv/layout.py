"""Layout of a laboratory's table, as far as the user states it."""

from __future__ import annotations

import codecs
from dataclasses import dataclass
from typing import Literal, get_args

from structid.core.constraints import Number
from structid.core.errors import InputError

Separator = Literal["auto", "comma", "semicolon", "tab", "space"]
Decimal = Literal["auto", "point", "comma"]
PhaseUnit = Literal["", "deg", "rad"]
#: What a column of a frequency response holds.
PARTS = ("re", "im", "magnitude", "phase", "coherence", "std")


@dataclass(frozen=True)
class CsvLayout:
    """Layout of a CSV or text table; what is not given is recognised where the table leaves no doubt.

    Which columns are read, what they are called and their units are told by `columns`, `channels`, `units`,
    `time_column` and `sampling_rate` of `ReadOptions`, as for every other format.

    Parameters
    ----------
    skip_rows : int
        Lines above the header that are left out.
    header_rows : int, optional
        Lines that head the columns: 0 for none, 1 for names, 2 for names with units below them.
    footer_rows : int
        Lines at the end that are left out, such as means below the columns.
    separator : str
        ``comma``, ``semicolon``, ``tab`` or ``space`` (any run of blanks) between cells.
    decimal : str
        ``point`` or ``comma`` in numbers.
    encoding : str
        Of the text, such as ``cp1252`` or ``utf-16``.
    phase_unit : str
        ``deg`` or ``rad`` of phases, where neither header nor numbers say it.
    parts : tuple of str
        What the columns of each frequency response are, in their order, where their headers do not say it, as in
        ``re,im`` or ``magnitude,phase``: of ``re``, ``im``, ``magnitude``, ``phase``, ``coherence``, ``std``. The
        responses then are those of `outputs` and `inputs`, output after output.

    Raises
    ------
    InputError
        If a field has a value that is not listed here, or separator and decimal sign are both a comma.
    """

    skip_rows: Number = 0
    header_rows: Number | None = None
    footer_rows: Number = 0
    separator: Separator = "auto"
    decimal: Decimal = "auto"
    encoding: str = "utf-8"
    phase_unit: PhaseUnit = ""
    parts: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Convert and check the fields."""
        parts = self.parts.split(",") if isinstance(self.parts, str) else self.parts
        object.__setattr__(self, "parts", tuple(str(part).strip() for part in parts if str(part).strip()))
        if self.parts and sorted(set(self.parts) & set(PARTS[:4])) not in (["im", "re"], ["magnitude", "phase"]):
            raise InputError(
                f"`parts` must hold re and im, or magnitude and phase, got {', '.join(self.parts)}", "parts"
            )
        if set(self.parts) - set(PARTS) or len(set(self.parts)) < len(self.parts):
            raise InputError(f"`parts` must be of {', '.join(PARTS)}, each once, got {', '.join(self.parts)}", "parts")
        for name in ("skip_rows", "header_rows", "footer_rows"):
            value = getattr(self, name)
            if value is not None and (not isinstance(value, int) or value < 0):
                raise InputError(f"`{name}` must be a whole number of lines, at least 0, got {value!r}")
        if self.header_rows is not None and self.header_rows > 2:
            raise InputError(
                f"`header_rows` must be 0, 1 (names) or 2 (names and units), got {self.header_rows}; leave other lines out"
                " with `skip_rows`"
            )
        for name, allowed in (
            ("separator", (*SEPARATORS, "auto")),
            ("decimal", get_args(Decimal)),
            ("phase_unit", get_args(PhaseUnit)),
        ):
            if getattr(self, name) not in allowed:
                raise InputError(f"`{name}` must be one of {', '.join(allowed)}, got {getattr(self, name)!r}")
        if self.separator == self.decimal == "comma":
            raise InputError("`separator` and `decimal` cannot both be comma; one of them is another")
        try:
            codecs.lookup(self.encoding)
        except (LookupError, ValueError, TypeError) as error:
            raise InputError(f"`encoding` {self.encoding!r} is not known; give utf-8, cp1252 or utf-16") from error


SEPARATORS = {"semicolon": ";", "tab": "\t", "comma": ",", "space": " "}
