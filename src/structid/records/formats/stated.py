"""Units, rates and times that a file of bare arrays states beside an array, which options must not contradict."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from structid.core.errors import FileError, InputError
from structid.core.units import parse_frf_unit, parse_unit
from structid.records.formats.options import ReadOptions, option_words

#: A text or texts, or numbers, by where they stand: parts between dots, slashes and ``@`` before an attribute.
Statements = Mapping[str, "np.ndarray | tuple[str, ...]"]

_UNITS = {"unit", "units", "unitstring", "yunit", "yunits", "unitlabel"}
_RATES = {
    "fs",
    "fsamp",
    "fsample",
    "samplingrate",
    "samplerate",
    "samplingfrequency",
    "samplefrequency",
    "srate",
    "sfreq",
}
_STEPS = {"dt", "deltat", "timestep", "sampleinterval", "samplinginterval", "samplingperiod", "wfincrement"}
_TIMES = {"t", "time", "times", "timevector", "zeit"}
_SCALES = {"scalefactor": 1.0, "addoffset": 0.0}
#: Places below the parent of an array where structs of test software keep its unit and step.
_LABELS, _INCREMENTS = (("quantity", "label"),), (("xvalues", "increment"),)
_AGREE = 1e-3
#: Times without a unit may be in s, ms or us.
_TIME_UNITS = (1.0, 1e-3, 1e-6)


def is_statement(name: str) -> bool:
    """True if what stands at `name` may be a unit, a rate, a step or times."""
    plain = tuple(re.sub("[^a-z]", "", part.lower()) for part in _parts(name))
    return plain[-1] in _UNITS | _RATES | _STEPS | _TIMES or plain[-2:] in _LABELS + _INCREMENTS


def statements_of(fields: Mapping[str, np.ndarray | str | tuple[str, ...]]) -> dict[str, np.ndarray | tuple[str, ...]]:
    """Texts and arrays of a file as statements beside its arrays."""
    return {name: (field,) if isinstance(field, str) else field for name, field in fields.items()}


def require_agreement(path: Path, array: str, n_points: int, statements: Statements, options: ReadOptions) -> None:
    """Raise an error where the file says something else of an array of `n_points` than the options do.

    Parameters
    ----------
    path : Path
    array : str
        Where the array stands.
    n_points : int
    statements : mapping
        What stands beside it and above it.
    options : ReadOptions

    Raises
    ------
    FileError
        If the array is stored scaled or shifted.
    InputError
        If a rate, a step or times contradict `sampling_rate`; if a unit that is not SI stands there and no unit was given.
    """
    parts = _parts(array)
    for name, value in statements.items():
        where = _parts(name)
        key, is_own = _key(where, parts), "@" in name and where[:-1] == parts
        if key in _SCALES and is_own:
            _require_unscaled(path, array, name, key, value)
        elif key in _UNITS and isinstance(value, tuple):
            _require_si(path, array, name, value, options)
        elif options.sampling_rate and isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
            _require_rate(path, name, key, value, n_points, options.sampling_rate)


def _parts(name: str) -> tuple[str, ...]:
    return tuple(part for part in re.split(r"[./@]+", name) if part)


def _key(where: tuple[str, ...], array: tuple[str, ...]) -> str:
    """The plain name of a statement that is about an array, "" where it is about something else."""
    plain = tuple(re.sub("[^a-z]", "", part.lower()) for part in where)
    if where[:-1] == array[: len(where) - 1]:
        return plain[-1]
    if plain[-2:] in _LABELS + _INCREMENTS and where[:-2] == array[: len(where) - 2]:
        return "unit" if plain[-2:] in _LABELS else "dt"
    return ""


def _require_unscaled(path: Path, array: str, name: str, key: str, value: np.ndarray | tuple[str, ...]) -> None:
    if isinstance(value, np.ndarray) and np.all(value == _SCALES[key]):
        return
    raise FileError(
        f"{path}: array {array!r} is stored scaled: {name} is {np.ravel(np.asarray(value))[0]}; store the values themselves,"
        " without that attribute"
    )


def _require_si(path: Path, array: str, name: str, texts: tuple[str, ...], options: ReadOptions) -> None:
    """Raise `InputError` if a unit that is not SI is stated, and the options give a kind without a unit."""
    is_frf = bool(options.frequency_array)
    if options.unit if is_frf else options.units:
        return
    option, kind = ("unit", "kind") if is_frf else ("units", "quantities")
    for text in texts:
        try:
            factor = parse_frf_unit(text).factor if is_frf else parse_unit(text).factor
        except InputError:
            factor = np.nan
        if text.strip(" -") and factor != 1.0:
            raise InputError(
                f"{path}: {name} says {text!r} beside array {array!r}, and `{kind}` alone means SI units; say the unit:"
                f" {option_words(**{option: None})}",
                option,
            )


def _require_rate(path: Path, name: str, key: str, value: np.ndarray, n_points: int, rate: float) -> None:
    """Raise `InputError` if a rate (Hz), a step (s) or the times of the samples contradict the sampling rate in Hz."""
    numbers = np.ravel(value).astype(float)
    if key in _TIMES and numbers.size == n_points > 2 and numbers[-1] > numbers[0]:
        stated = (n_points - 1) / (numbers[-1] - numbers[0])
        units: tuple[float, ...] = _TIME_UNITS
    elif numbers.size == 1 and numbers[0] > 0 and key in _RATES | _STEPS:
        stated, units = (numbers[0] if key in _RATES else 1 / numbers[0]), (1.0,)
    else:
        return
    if all(abs(stated / unit / rate - 1) > _AGREE for unit in units):
        raise InputError(
            f"{path}: {name} says {stated:.6g} samples a second, but `sampling_rate` {rate:g} was given; correct one of them",
            "sampling_rate",
        )
