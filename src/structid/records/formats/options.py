"""Options of reading: what a file does not say about itself, said by the user."""

from __future__ import annotations

import codecs
import math
import shlex
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, fields
from typing import Literal, get_args

from structid.core.constraints import Count, Number, Positive, split_commas
from structid.core.errors import InputError

Axes = Literal["", "named"]
Resample = Literal["", "spline"]
#: Whether options are named as flags of the command line.
_AS_FLAGS: ContextVar[bool] = ContextVar("options_as_flags", default=False)
_TEXTS = ("array", "frequency_array", "kind", "unit", "axis_unit", "coherence_array")
_LISTS = ("channels", "quantities", "units", "outputs", "inputs", "columns")
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
        """Split `parts` at commas if they are one text, and raise `InputError` on a value or word that is not allowed.

        `parts` must hold re and im, or magnitude and phase, each once.
        """
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


@dataclass(frozen=True)
class ReadOptions:
    """Options to read arrays that do not describe themselves, or a part of a file that does.

    A list may also be given as one text with commas: ``channels="1Z+, 2Z+"``. Every field is a flag of the commands that
    read a record, and a key of ``[record]``.
    In a file that describes itself `outputs`, `inputs` and `channels` choose; the other options must
    agree with the file where they are given.

    Parameters
    ----------
    sampling_rate : float, optional
        Samples per second of a bare time array.
    channels : tuple of str
        Degrees of freedom of the columns of a bare time array, or of columns and channels that another program named, as in
        ``1X+,2X+``; else those to use.
    quantities : tuple of str
        ``displacement``, ``velocity``, ``acceleration`` or ``force`` of each channel, as in ``acceleration,force``, or
        one for all.
    units : tuple of str
        Unit of each time channel, as in ``g,N`` or ``mm/s^2``, or one for all; says the quantity too. SI if not given.
    array : str
        Name of the array (NPZ, MAT, HDF5); in a UFF file with both, ``frf`` or ``time``.
    frequency_array : str
        Name of the array of frequencies that belongs to a bare FRF array, in Hz or in `axis_unit`.
    outputs : tuple of str
        Sensors of a bare FRF array, as in ``1X-,2X+``, shape (n_frequencies, n_outputs, n_inputs), or
        (n_frequencies, n_outputs) with one input, or of a table with names of its own, in its order; else those to use.
    inputs : tuple of str
        Loads of a bare FRF array, as in ``3X+``, or of a table with names of its own; else those to use.
    kind : str
        ``receptance``, ``mobility`` or ``accelerance`` of a bare FRF array.
    unit : str
        Unit of a bare FRF array, or of a table of FRFs that says none, such as ``g/lbf``; says the kind too. Arrays are SI if not
        given.
    axis_unit : str
        Unit of the axis where the file does not say it: ``Hz``, ``kHz``, ``rad/s`` or ``rpm`` of frequencies, ``s``, ``ms``,
        ``us`` or ``min`` of times.
    axes : str
        ``named`` where sensors and loads of a universal file are called by the axes that their names say, whatever coordinate
        systems the nodes have; by default they are turned into global axes.
    coherence_array : str
        Name of an array of coherences of the same shape.
    averages : int, optional
        Number of independent averages behind each FRF value.
    start : float, optional
        Time in s of the first sample read of time histories; the rest of the file may hold gaps.
    stop : float, optional
        Time in s of the last sample read.
    longest_gap : int, optional
        Samples of the longest gap (NaN, infinite, an empty cell) in time histories that is filled by cubic
        interpolation; the record's `source` then says how many samples were invented. Gaps are refused without it.
    resample : str
        ``spline`` where time histories at uneven times are brought to an even raster by cubic splines; the record's `source`
        then says what that cost. They are refused without it.
    columns : tuple of str
        Columns of a table, channels of a logger's file (TDMS, MDF, miniSEED, WAV, Parquet) or functions of a universal file
        that are read, by name or by number from 1, as in ``Acc 1,Acc 3`` or ``2,4``; all by default. `channels` says what
        they are, in this order; of frequency responses `outputs` and `inputs`, one a function, or one for all.
    time_column : str
        Column or channel that holds the times, by name or number; recognised by its name by default.
    csv : CsvLayout, optional
        How a CSV table is laid out where that cannot be recognised.

    Raises
    ------
    InputError
        If an entry is of the wrong type.
    """

    sampling_rate: Positive | None = None
    channels: tuple[str, ...] = ()
    quantities: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    array: str = ""
    frequency_array: str = ""
    outputs: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    kind: str = ""
    unit: str = ""
    axis_unit: str = ""
    axes: Axes = ""
    coherence_array: str = ""
    averages: Count | None = None
    start: float | None = None
    stop: float | None = None
    longest_gap: Count | None = None
    resample: Resample = ""
    columns: tuple[str | int, ...] = ()
    time_column: str | int = ""
    csv: CsvLayout | None = None

    def __post_init__(self) -> None:
        """Make lists of channels, units and so on tuples of texts, and raise `InputError` on a value out of range."""
        for name in _LISTS:
            object.__setattr__(self, name, _as_texts(name, getattr(self, name)))
        object.__setattr__(self, "time_column", str(self.time_column))
        for name in _TEXTS:
            if not isinstance(getattr(self, name), str):
                raise InputError(f"`{name}` must be a text, got {getattr(self, name)!r}")
        if self.averages is not None and (not isinstance(self.averages, int) or self.averages < 1):
            raise InputError(f"`averages` must be a whole number, at least 1, got {self.averages!r}")
        if self.sampling_rate is not None and not _is_positive(self.sampling_rate):
            raise InputError(f"`sampling_rate` must be a positive number of Hz, got {self.sampling_rate!r}")

        for name, allowed in (("axes", get_args(Axes)), ("resample", get_args(Resample))):
            if getattr(self, name) not in allowed:
                raise InputError(f"`{name}` must be {allowed[1]}, or left out, got {getattr(self, name)!r}", name)
        for name in ("start", "stop"):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, (int, float)) and math.isfinite(value)):
                raise InputError(f"`{name}` must be a time in s, got {value!r}")
        if self.longest_gap is not None and (not isinstance(self.longest_gap, int) or self.longest_gap < 1):
            raise InputError(f"`longest_gap` must be a whole number, at least 1, got {self.longest_gap!r}")

    def given(self) -> tuple[str, ...]:
        """Names of the options that differ from their empty default: None, "" or ()."""
        return tuple(f.name for f in fields(self) if getattr(self, f.name) not in (None, "", ()))


@contextmanager
def options_given_as_flags() -> Iterator[None]:
    """Context manager in which messages name options of reading as command-line flags; elsewhere they are keys of a study."""
    token = _AS_FLAGS.set(True)
    try:
        yield
    finally:
        _AS_FLAGS.reset(token)


def option_words(**values: object) -> str:
    """Text for an error message that names options of reading: as keys of a study and flags, or as flags alone.

    Keywords are the options and their values, None where no value is proposed. Flags stand alone within the context
    `options_given_as_flags`, as on the command line.
    """
    flags = _flags(values)
    if _AS_FLAGS.get():
        return flags
    return f"{_keys(values)} in the study, beside `path`, or in ReadOptions ({flags} on the command line)"


def layout_words(**values: object) -> str:
    """Options of the layout of a table, with their values where these are known: keys of a study, or flags.

    Keywords are the options; None stands for a value that is not known. Flags are given within
    `options_given_as_flags`.

    Examples
    --------
    >>> layout_words(skip_rows=1, decimal="comma")
    '`skip_rows = 1` and `decimal = "comma"` in [record.csv]'
    >>> with options_given_as_flags():
    ...     layout_words(skip_rows=1)
    '--csv-skip-rows 1'
    """
    if _AS_FLAGS.get():
        return _flags({f"csv_{name}": value for name, value in values.items()})
    return f"{_keys(values)} in [record.csv]"


def _keys(values: Mapping[str, object]) -> str:
    """Keys of a study with their values, texts in the quotes of TOML; a key alone where its value is None."""
    texts = {name: f'"{value}"' if isinstance(value, str) else value for name, value in values.items()}
    return " and ".join(f"`{name}`" if value is None else f"`{name} = {value}`" for name, value in texts.items())


def _flags(values: Mapping[str, object]) -> str:
    """Flags with their values as they are typed in a shell; a flag alone where its value is None."""
    return " ".join(
        f"--{name.replace('_', '-')}" + ("" if value is None else f" {shlex.quote(str(value))}")
        for name, value in values.items()
    )


def _is_positive(value: object) -> bool:
    return isinstance(value, (int, float)) and math.isfinite(value) and value > 0


def _as_texts(name: str, value: str | Iterable[object]) -> tuple[str, ...]:
    """The value of the option `name` as a tuple of texts, from a list or from a text that is split at commas.

    Raises `InputError` if the value is neither.
    """
    if isinstance(value, str):
        return split_commas(value)
    try:
        return tuple(str(part) for part in value)
    except TypeError as error:
        raise InputError(f"`{name}` must be a list of texts or one text with commas, got {value!r}") from error
