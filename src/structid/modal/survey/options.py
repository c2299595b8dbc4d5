"""What the user of `structid modes` asks for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.errors import InputError


@dataclass(frozen=True)
class ModesOptions:
    """What the user asks for; every default serves without a look at the record. Every field is a flag of the command.

    Lists may be given as one text: ``frequencies="1.9,2.4"``; ``orders="10,20,30"``, ``"2:60"`` (in steps of 2) or
    ``"4:80:4"``.

    Parameters
    ----------
    method : str, optional
        pencil, era, era_dc, ssi_cov, ssi_data, itd, next_era, fdd, efdd, bayesian_fft or lscf, see docs/modes.md
        [default: by the kind of record].
    band : (float, float), optional
        Hz: look for modes there only.
    frequencies : tuple of float, optional
        Hz: the modes wanted, by hand, as in 1.9,2.4.
    orders : tuple of int, optional
        Numbers of states to try, as in 2:60 or 20,30,40.
    rate : float, optional
        Hz: decimate time histories to this sampling rate [default: lower where the band or the frequencies lie far below
        it; and a second look at a lower one for low modes, where the spectrum shows any].
    detrend : str or int
        Taken off each time history: mean, linear, none or a degree.
    """

    method: str | None = None
    band: tuple[float, float] | None = None
    frequencies: tuple[float, ...] | None = None
    orders: tuple[int, ...] | None = None
    rate: float | None = None
    detrend: str | int = "mean"

    def __post_init__(self) -> None:
        if isinstance(self.frequencies, str):
            object.__setattr__(self, "frequencies", _numbers(self.frequencies))
        if isinstance(self.orders, str):
            object.__setattr__(self, "orders", _orders(self.orders))
        if isinstance(self.detrend, str) and self.detrend.isdigit():
            object.__setattr__(self, "detrend", int(self.detrend))
        if self.band is not None and not 0 <= self.band[0] < self.band[1]:
            raise InputError(
                f"`band` must be least and greatest frequency in Hz, got {self.band[0]:g} {self.band[1]:g}"
            )
        if self.frequencies is not None and not all(np.isfinite(f) and f > 0 for f in self.frequencies):
            raise InputError(f"`frequencies` must be greater than 0 Hz, got {list(self.frequencies)}")
        if self.rate is not None and not (np.isfinite(self.rate) and self.rate > 0):
            raise InputError(f"`rate` must be greater than 0 Hz, got {self.rate:g}")


def _orders(text: str) -> tuple[int, ...]:
    try:
        if ":" not in text:
            return tuple(int(word) for word in text.split(",") if word.strip())
        first, last, *step = (int(word) for word in text.split(":"))
        found = tuple(range(first, last + 1, *(step or [2])))
    except (ValueError, TypeError) as error:
        raise InputError(f"`orders` must be numbers as in 10,20,30, or a range as in 2:60, got {text!r}") from error
    if not found:
        raise InputError(f"`orders` must hold at least one number, got {text!r}; write least:greatest")
    return found


def _numbers(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(word) for word in text.split(",") if word.strip())
    except ValueError as error:
        raise InputError(f"`frequencies` must be numbers with commas, as in 1.9,2.4, got {text!r}") from error
