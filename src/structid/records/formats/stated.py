"""Units, rates and times that a file of bare arrays states beside an array, which options must not contradict."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np

from structid.core.dof import as_dof
from structid.core.errors import FileError, InputError, about
from structid.core.units import FrfUnit, Unit, parse_frequency_unit, parse_frf_unit, parse_time_unit, parse_unit
from structid.records.formats.headers import is_read_by, units_in_name
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
#: Where the names of channels stand.
_NAMES = {"channels", "channelnames", "channellabels", "dofs", "labels", "names"}
#: Names of angular frequencies.
_ANGULAR = re.compile(r"omegas?|\u03c9|w|om|.*rad.*", re.IGNORECASE)


def _with_plurals(words: str) -> set[str]:
    """Set of the words in a text, each also with an s at its end."""
    return {word + end for word in words.split() for end in ("", "s")}


#: Attributes by which stored values are to be multiplied or shifted (the CF conventions of NetCDF), in any array.
_PACKED = _with_plurals("scalefactor addoffset")
_FACTORS = {"cal", "calib"} | _with_plurals(
    "scalefactor scale scaling scalingfactor gain slope conversion multiplier calibration calibrationfactor calfactor"
)
_SHIFTS = _with_plurals("addoffset offset intercept dcoffset")
#: Names by which stored values may be multiplied or shifted, each with the value that leaves them as they are.
_SCALES = {**dict.fromkeys(_FACTORS, 1.0), **dict.fromkeys(_SHIFTS, 0.0)}
_SENSITIVITIES = {"sensitivity", "sensitivities", "sensorsensitivity"}
#: Places below the parent of an array where structs of test software keep its unit and step.
_LABELS, _INCREMENTS = (("quantity", "label"),), (("xvalues", "increment"),)
_AGREE = 1e-3
#: A rate or step in words: a number, and its unit if there is one.
_RATE_IN_WORDS = re.compile(r"\s*([+-]?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?)\s*([^\d\s][^\d]*)?\s*")
#: Times without a unit may be in s, ms or us.
_TIME_UNITS = (1.0, 1e-3, 1e-6)


def is_statement(name: str) -> bool:
    """True if the name of an array or attribute suggests a unit, rate, step, times, channel names, a scale or a sensitivity."""
    plain = tuple(_plain(part) for part in _parts(name))
    known = _UNITS | _RATES | _STEPS | _TIMES | _NAMES | _SENSITIVITIES | _SCALES.keys()
    is_unit_of_array = plain[-1].endswith(("unit", "units"))
    return plain[-1] in known or is_unit_of_array or _with_unit(name) is not None or plain[-2:] in _LABELS + _INCREMENTS


def statements_of(fields: Mapping[str, np.ndarray | str | tuple[str, ...]]) -> dict[str, np.ndarray | tuple[str, ...]]:
    """Texts and arrays of a file by name, as `require_agreement` takes them: a single text becomes a tuple."""
    return {name: (field,) if isinstance(field, str) else field for name, field in fields.items()}


def require_agreement(
    path: Path, array: str, shape: tuple[int, ...], dtype: np.dtype, statements: Statements, options: ReadOptions
) -> str:
    """Check the metadata stored beside an array against the options; returns notes on what was overruled or not applied.

    Parameters
    ----------
    path : Path
        File, named in errors.
    array : str
        Name (path in the file) of the array.
    shape : tuple of int
        Shape of the array, with its points along the first axis.
    dtype : dtype
        Type of the array as stored.
    statements : mapping
        Texts, small arrays and attributes beside the array and above it, by name.
    options : ReadOptions

    Returns
    -------
    str
        Notes on a unit in the file that the option overrules, and on factors that are not applied; "" for none.

    Raises
    ------
    FileError
        If the array is stored scaled or shifted.
    InputError
        If it may be scaled, and no option states the unit of its values; if a rate, a step or times contradict
        `sampling_rate`; if a unit beside it is not SI and no option states the unit; if names of channels, or the unit in
        the array's name, differ from the options.
    """
    parts, notes, elsewhere, is_rate_stated = _parts(array), list[str](), list[str](), False
    _require_name_agrees(path, array, options)
    for name, value in statements.items():
        if name == array:
            continue
        where = _parts(name)
        key, is_own = _key(where, parts), "@" in name and where[:-1] == parts
        if key in _SCALES or key in _SENSITIVITIES:
            if is_own or np.size(value) in {1, *shape[1:], math.prod(shape[1:])}:
                notes.append(_judge_scale(path, array, dtype, name, key, value, is_own, options))
        elif key in _UNITS and isinstance(value, tuple):
            notes.append(_compare_units(path, array, name, value, options))
        elif key in _NAMES and isinstance(value, tuple):
            _require_channels(path, name, value, options)
        elif options.sampling_rate and (numbers := _numbers_of(value, _plain(where[-1]))) is not None:
            base, factor = _with_unit(name) or (key or _plain(where[-1]), 1.0)
            if key:
                units = _TIME_UNITS if base == key else (1.0,)
                n_points = shape[0] if shape else 0
                agrees = _agrees_on_rate(path, name, base, numbers * factor, n_points, options.sampling_rate, units)
                is_rate_stated = is_rate_stated or agrees
            elif base in _RATES | _STEPS:
                elsewhere.append(_note_of_rate(name, base, numbers * factor, options.sampling_rate))
    return "; ".join(filter(None, notes if is_rate_stated else notes + elsewhere))


def _numbers_of(value: np.ndarray | tuple[str, ...], plain: str) -> np.ndarray | None:
    """The numbers of a statement as floats, of a rate or step in words (``200 Hz``) in Hz or s; None if it holds none.

    `value` is what the statement holds, an array of its shape or texts; `plain` is the last part of its name in small
    letters.
    """
    if isinstance(value, np.ndarray):
        return value.astype(float) if value.dtype.kind in "fiu" else None
    if len(value) != 1 or plain not in _RATES | _STEPS:
        return None
    match = _RATE_IN_WORDS.fullmatch(value[0])
    if match is None:
        return None
    parse = parse_frequency_unit if plain in _RATES else parse_time_unit
    unit = re.sub(r"^(S/s|sps)$", "Hz", (match[2] or "").strip(), flags=re.IGNORECASE)
    try:
        return np.array([float(match[1]) * (parse(unit) if unit else 1.0)])
    except InputError:
        return None


def _note_of_rate(name: str, plain: str, numbers: np.ndarray, rate: float) -> str:
    """Note on a rate (Hz) or step (s) that stands elsewhere in the file, where it differs from the sampling rate `rate`; else "".

    `name` is that of the statement, `plain` its last part in small letters and without a unit, `numbers` what it holds.
    """
    if numbers.size != 1 or not 0 < numbers.flat[0] < np.inf:
        return ""
    stated = float(numbers.flat[0] if plain in _RATES else 1 / numbers.flat[0])
    if abs(stated / rate - 1) <= _AGREE:
        return ""
    return f"sampled at {rate:g} Hz as given, though {name} says {stated:.6g}"


def _parts(name: str) -> tuple[str, ...]:
    return tuple(part for part in re.split(r"[./@]+", name) if part)


def _plain(part: str) -> str:
    return re.sub("[^a-z]", "", part.lower())


def _with_unit(name: str) -> tuple[str, float] | None:
    """Plain name and factor to Hz or s of a rate, step or times whose name ends with its unit, as ``fs_khz`` or ``dt_ms``.

    None for other names.
    """
    base, _, unit = _parts(name)[-1].rpartition("_")
    parse = (
        parse_frequency_unit if _plain(base) in _RATES else parse_time_unit if _plain(base) in _STEPS | _TIMES else None
    )
    try:
        return None if parse is None else (_plain(base), parse(unit))
    except InputError:
        return None


def frequency_unit(path: Path, name: str, options: ReadOptions) -> str:
    """Unit of an array of frequencies, from `axis_unit` or from the array's name; "", which means Hz, if neither states it.

    Raises
    ------
    InputError
        If name and option state different units, or the name is that of an angular frequency and no unit is stated.
    """
    last = _parts(name)[-1]
    stated = ""
    for text in (last, last.rpartition("_")[2]):
        with suppress(InputError):
            parse_frequency_unit(text)
            stated = text
    if stated and options.axis_unit:
        with about("axis_unit"):
            factor = parse_frequency_unit(options.axis_unit)
        if abs(parse_frequency_unit(stated) / factor - 1) > 1e-9:
            raise InputError(
                f"{path}: array {name!r} says by its name that it is in {stated}, but `axis_unit` {options.axis_unit} was given;"
                " leave it out",
                "axis_unit",
            )
    if not stated and not options.axis_unit and _ANGULAR.fullmatch(last):
        raise InputError(
            f"{path}: array {name!r} does not say the unit of its frequencies, and its name is one of angular frequencies; give"
            f" {option_words(axis_unit='rad/s')} or Hz",
            "axis_unit",
        )
    return options.axis_unit or stated


def _require_name_agrees(path: Path, array: str, options: ReadOptions) -> None:
    """Raise `InputError` if the array's name, such as ``acc_g``, states another unit than the options."""
    parse: Callable[[str], FrfUnit | Unit] = parse_frf_unit if options.frequency_array else parse_unit
    for _, unit, _ in units_in_name(_parts(array)[-1], parse):
        if _is_other_unit(unit, options):
            raise InputError(
                f"{path}: array {array!r} says another unit by its name than the one that was given; correct one of them",
                "unit" if options.frequency_array else "units",
            )


def _is_other_unit(stated: FrfUnit | Unit, options: ReadOptions, channel: int | None = None) -> bool:
    """True if the options state a unit of the same quantity as `stated`, but of another size.

    Options are `unit` for FRFs (if `frequency_array` is set), else `units`, or without these `quantities`, in SI.
    `channel` is the index of the channel whose option counts; None compares with the options of all channels.
    """
    by_options: list[tuple[str, float]]
    if options.frequency_array:
        by_options = [parse_frf_unit(options.unit)[:2]] if options.unit else []
    else:
        texts = options.units if channel is None else options.units[channel : channel + 1]
        by_options = [
            *(parse_unit(unit)[:2] for unit in texts),
            *((name, 1.0) for name in options.quantities if not texts),
        ]
    return any(kind == stated[0] and abs(factor / stated.factor - 1) > 1e-9 for kind, factor in by_options)


def _require_channels(path: Path, name: str, texts: tuple[str, ...], options: ReadOptions) -> None:
    """Raise `InputError` if the degrees of freedom stored beside the array differ from the option `channels`.

    `texts` are the names in the statement `name`; nothing is compared unless all of them are degrees of freedom.
    """
    stated, wanted = [as_dof(text) for text in texts], [as_dof(text) for text in options.channels]
    if None not in stated and len(stated) == len(wanted) and stated != wanted:
        raise InputError(
            f"{path}: {name} says channels {', '.join(map(str, stated))}, but `channels` {', '.join(map(str, wanted))} was given;"
            " correct one of them, or rename channels with `relabel` of a study",
            "channels",
        )


def _key(where: tuple[str, ...], array: tuple[str, ...]) -> str:
    """Plain name of a statement about the array, such as ``fs``, ``units`` or ``dt``; "" if it is about something else.

    `where` and `array` are the paths of both in the file, in parts. A statement is about the array if it is an attribute of the
    array, or stands in the same group or in one around that. Its plain name is the last part in small letters, without digits
    and marks, but ``units`` if that is the array's name with "unit" or "units" behind it. The plain name of ``quantity/label``
    is ``unit``, that of ``xvalues/increment`` ``dt``.
    """
    plain = tuple(_plain(part) for part in where)
    if where[:-1] == array[: len(where) - 1]:
        if re.fullmatch(rf"{re.escape(array[-1])}_?units?", where[-1], re.IGNORECASE):
            return "units"
        return plain[-1]
    if plain[-2:] in _LABELS + _INCREMENTS and where[:-2] == array[: len(where) - 2]:
        return "unit" if plain[-2:] in _LABELS else "dt"
    return ""


def _judge_scale(
    path: Path,
    array: str,
    dtype: np.dtype,
    name: str,
    key: str,
    value: np.ndarray | tuple[str, ...],
    is_own: bool,
    options: ReadOptions,
) -> str:
    """Note on a factor, offset or sensitivity beside an array, which is not applied; "" if it changes nothing.

    `array` is the name of the array and `dtype` its type; `name` is the statement, `key` its plain name and `value` its content.
    `is_own` says that it is an attribute of the array itself. Such an attribute raises `FileError` if it is one of packing,
    or scales whole numbers, and else `InputError` if no option states the unit of the values.
    """
    try:
        numbers = np.ravel(value)
        numbers = numbers if numbers.dtype.kind == "c" else numbers.astype(float)
    except ValueError:  # words, or a date
        return ""
    if numbers.dtype.kind == "c" or np.all(numbers == _SCALES.get(key, 1.0)):
        return ""
    shown = f"{name} is {', '.join(f'{number:g}' for number in numbers[:3])}{' ...' if numbers.size > 3 else ''}"
    option, example = ("unit", "(m/s^2)/N") if options.frequency_array else ("units", "m/s^2")
    units = (options.unit,) if options.frequency_array else options.units
    if key in _SENSITIVITIES and any(" at " in unit for unit in units):
        return ""
    if is_own and key in _SCALES and (key in _PACKED or dtype.kind in "iu"):
        raise FileError(
            f"{path}: array {array!r} is stored scaled: {shown}; store the values themselves, without that attribute"
        )
    if is_own and not any(units):
        problem = f"has a sensitivity, {shown}" if key in _SENSITIVITIES else f"may be stored scaled: {shown}"
        volts = "" if options.frequency_array else ', or as in "V at 100 mV/g" for voltages'
        raise InputError(
            f"{path}: array {array!r} {problem}; say what its values are, as in {option_words(**{option: example})}{volts}",
            option,
        )
    return f"{shown}, which is not applied"


def _compare_units(path: Path, array: str, name: str, texts: tuple[str, ...], options: ReadOptions) -> str:
    """Note on a stated unit that differs from the option's, which prevails; "" if they agree.

    `texts` are the units that the statement `name` holds. Raises `InputError` if they are not SI and the options state
    the quantities or the kind, but no unit. `array` is the name of the array.
    """
    is_frf = bool(options.frequency_array)
    parse: Callable[[str], FrfUnit | Unit] = parse_frf_unit if is_frf else parse_unit
    if options.unit if is_frf else options.units:
        for k, text in enumerate(texts):
            channel = k if len(texts) == len(options.units) else None
            is_told = channel is not None or 1 in (len(texts), len(options.units))
            if is_told and is_read_by(text, parse) and _is_other_unit(parse(text), options, channel):
                return f"in the unit that was given, though {name} says {text}"
        return ""
    option, kind = ("unit", "kind") if is_frf else ("units", "quantities")
    for text in texts:
        try:
            factor = parse(text).factor
        except InputError:
            factor = np.nan
        if text.strip(" -") and factor != 1.0:
            raise InputError(
                f"{path}: {name} says {text!r} beside array {array!r}, and `{kind}` alone means SI units; say the unit:"
                f" {option_words(**{option: None})}",
                option,
            )
    return ""


def _agrees_on_rate(
    path: Path, name: str, key: str, value: np.ndarray, n_points: int, rate: float, of_times: tuple[float, ...]
) -> bool:
    """True if a rate (Hz), a step (s) or the times of the samples agree with the sampling rate `rate` in Hz.

    `InputError` if they contradict it; False for any other statement. `key` is the plain name of the statement `name`, `value`
    what it says, and `n_points` the number of samples. `of_times` are the units, in s, that times may have: one of them must fit.
    """
    numbers = np.ravel(value).astype(float)
    if key in _TIMES and numbers.size == n_points > 2 and numbers[-1] > numbers[0]:
        stated = (n_points - 1) / (numbers[-1] - numbers[0])
        units = of_times
    elif numbers.size == 1 and numbers[0] > 0 and key in _RATES | _STEPS:
        stated, units = (numbers[0] if key in _RATES else 1 / numbers[0]), (1.0,)
    else:
        return False
    if all(abs(stated / unit / rate - 1) > _AGREE for unit in units):
        raise InputError(
            f"{path}: {name} says {stated:.6g} samples a second, but `sampling_rate` {rate:g} was given; correct one of them",
            "sampling_rate",
        )
    return True
