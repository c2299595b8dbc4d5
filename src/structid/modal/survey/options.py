"""Options of `structid modes`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from structid.core.arrays import arrays_to_tuples
from structid.core.constraints import require_band
from structid.core.dof import is_whole_number
from structid.core.errors import InputError
from structid.modal.method import ModalOptions
from structid.modal.poles.poles import HardCriteria


@dataclass(frozen=True)
class ModesOptions:
    """Options of `structid modes`; the defaults suit any record. Every field is a flag of the command.

    Lists may be given as one text: ``frequencies="1.9,2.4"``; ``orders="10,20,30"``, ``"2:60"`` (in steps of 2) or
    ``"4:80:4"``; or as one number.

    Parameters
    ----------
    method : str, optional
        pencil, ssi_cov, ssi_data, fdd, bayesian_fft, lscf or, of stored spectra, efdd, see docs/modes.md [default: by the kind
        of record].
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
    remove_tones : tuple of float or str, optional
        Hz: tones of machines taken off time histories, as in 25,50; or auto, those that stand out.
    damping : (float, float), optional
        Least and greatest damping ratio of modes [default: -0.01 0.2, above 0 in ambient motion].
    deviation : float, optional
        Greatest standard deviation of a frequency over the frequency [default: 0.005 in free decays, except for modes with
        1 % of the energy or more; none in other motion].
    window : float, optional
        s: time constant of an exponential window that lies on the record, whose damping is taken off the modes.
    """

    method: str | None = None
    band: tuple[float, float] | None = None
    frequencies: tuple[float, ...] | None = None
    orders: tuple[int, ...] | None = None
    rate: float | None = None
    detrend: str | int = "mean"
    remove_tones: tuple[float, ...] | Literal["auto"] | None = None
    damping: tuple[float, float] | None = None
    deviation: float | None = None
    window: float | None = None

    def __post_init__(self) -> None:
        """Convert texts to numbers, arrays and single numbers of lists to tuples, and raise `InputError` on values out of range.

        Texts are lists in `frequencies` and `remove_tones` (but for "auto"), a list or range in `orders`, a number in
        `detrend`. No list may be empty. `frequencies`, `remove_tones`, `rate`, `deviation` and `window` must be
        positive, `band` a range.
        """
        arrays_to_tuples(self, "band", "frequencies", "orders", "remove_tones", "damping")
        for name in ("frequencies", "orders", "remove_tones"):
            if isinstance(value := getattr(self, name), int | float | np.number):
                object.__setattr__(self, name, tuple(np.atleast_1d(value).tolist()))
        for name, words in (("frequencies", ()), ("remove_tones", ("auto",))):
            value = getattr(self, name)
            if isinstance(value, str) and value not in words:
                value = _parse_numbers(name, value)
                object.__setattr__(self, name, value)
            if value is not None and not isinstance(value, str) and not all(np.isfinite(f) and f > 0 for f in value):
                raise InputError(f"`{name}` must be greater than 0 Hz, got {list(value)}")
        if isinstance(self.orders, str):
            object.__setattr__(self, "orders", _orders(self.orders))
        for name, example in (("frequencies", "1.9,2.4"), ("remove_tones", "25,50"), ("orders", "10,20,30 or 2:60")):
            value = getattr(self, name)
            if value is not None and len(value) == 0:
                raise InputError(f"`{name}` must hold at least one number, as in {example}; or leave it out")
        if isinstance(self.detrend, str) and is_whole_number(self.detrend):
            object.__setattr__(self, "detrend", int(self.detrend))
        if self.band is not None:
            require_band("band", self.band)
        for name, unit in (("rate", " Hz"), ("deviation", ""), ("window", " s")):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                raise InputError(f"`{name}` must be greater than 0{unit}, got {value:g}")

    @property
    def modal(self) -> ModalOptions:
        """`ModalOptions` with these orders, frequencies (Hz) and deviation, and with `band` and `damping` as hard criteria."""
        band, damping = self.band or (0.0, np.inf), self.damping or HardCriteria().damping_ratio
        return ModalOptions(self.orders, None, HardCriteria(band, damping), self.frequencies, deviation=self.deviation)


def _orders(text: str) -> tuple[int, ...]:
    """Model orders from a text such as ``10,20,30``, ``2:60`` (in steps of 2, end included) or ``4:80:4``.

    Raises `InputError` if the text is no list or range, or a range is empty.
    """
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


def _parse_numbers(name: str, text: str) -> tuple[float, ...]:
    """Numbers in a text such as ``1.9,2.4``; `InputError` that names the option `name` if a word is no number."""
    try:
        return tuple(float(word) for word in text.split(",") if word.strip())
    except ValueError as error:
        or_auto = ", or auto" if name == "remove_tones" else ""
        raise InputError(f"`{name}` must be numbers with commas, as in 1.9,2.4{or_auto}, got {text!r}") from error
