"""Loads to predict under: pulses, sines, noise of a stated spectrum."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray, require_shape
from structid.core.errors import FileError, InputError
from structid.core.units import parse_frequency_unit, parse_unit
from structid.files import require_readable

#: A unit at the end of a heading, and the unit of a density: a square per frequency.
_IN_BRACKETS = re.compile(r"[(\[](.+)[)\]]\s*$")
_DENSITY_UNIT = re.compile(r"\s*(?P<unit>\(.+\)|[^()]+?)(?:\^?2|²|\*\*2)\s*/\s*(?P<per>[^()]+|\([^()]+\))\s*")
#: Most samples of a history: with its bands it takes some hundred bytes a sample and output.
_MOST_SAMPLES = 1e7


def half_sine(amplitude: float, width: float, duration: float, sampling_rate: float) -> FloatArray:
    """Half-sine pulse of `amplitude` and `width`, s, from the start of a record of `duration`, s, (n_times,).

    `sampling_rate` is in Hz.

    Raises
    ------
    InputError
        If `width` is not positive, a period of twice `width` has fewer than eight samples, or the record has fewer than two
        samples or more than ten million.
    """
    _require_rate(width, 0.5 / width if width > 0 else np.nan, duration, sampling_rate, "width of the pulse")
    t = np.arange(round(duration * sampling_rate)) / sampling_rate
    return np.where(t < width, amplitude * np.sin(np.pi * np.minimum(t, width) / width), 0.0)


def sine(amplitude: float, frequency: float, duration: float, sampling_rate: float) -> FloatArray:
    """Sine of `amplitude` and `frequency`, Hz, that begins at 0, over `duration`, s, (n_times,).

    `sampling_rate` is in Hz.

    Raises
    ------
    InputError
        If `frequency` is not positive, a period has fewer than eight samples, or the record has fewer than two samples or
        more than ten million.
    """
    _require_rate(frequency, frequency, duration, sampling_rate, "frequency of the sine")
    t = np.arange(round(duration * sampling_rate)) / sampling_rate
    return np.asarray(amplitude * np.sin(2 * np.pi * frequency * t))


def coloured_noise(
    frequency: FloatArray, density: FloatArray, duration: float, sampling_rate: float, rng: np.random.Generator
) -> FloatArray:
    """Gaussian noise, (n_times,), with a one-sided spectral density that is linear between lines and 0 outside them.

    Parameters
    ----------
    frequency, density : (n_frequencies,) float arrays
        Hz, and N^2/Hz (or (m/s^2)^2/Hz of a support).
    duration, sampling_rate : float
        s, and samples per second.
    rng : numpy Generator

    Raises
    ------
    InputError
        If the highest frequency exceeds half the sampling rate, the record has not from 2 to 10 million samples, or the
        arrays differ in length.
    """
    require_shape("density", np.asarray(density), (len(frequency),), "one value a line")
    if frequency[-1] > sampling_rate / 2:
        raise InputError(
            f"`sampling_rate` must be at least twice the highest line of the spectrum, {frequency[-1]:g} Hz, got {sampling_rate:g}"
        )
    _require_samples(duration, sampling_rate)
    n = round(duration * sampling_rate)
    lines = np.fft.rfftfreq(n, 1 / sampling_rate)
    power = np.interp(lines, frequency, density, left=0.0, right=0.0) * sampling_rate * n / 2
    phase = (rng.standard_normal(len(lines)) + 1j * rng.standard_normal(len(lines))) / np.sqrt(2)
    return np.asarray(np.fft.irfft(np.sqrt(power) * phase, n))


def read_density(path: Path, is_support: bool | None = None) -> tuple[FloatArray, FloatArray]:
    """Frequencies, Hz, and one-sided spectral densities of a load, (n_frequencies,) each, from a table of two columns.

    Densities are in N^2/Hz, or in (m/s^2)^2/Hz for the motion of a support. Units in the heading, as in ``f (Hz), S
    (kN^2/Hz)``, are converted to these; without units the values are taken as they are. Cells are separated by commas,
    semicolons or tabs; lines that begin with ``#`` are skipped.

    Parameters
    ----------
    path : Path
    is_support : bool, optional
        Whether the density is of the acceleration of a support, not of a force; not compared with the heading by
        default.

    Raises
    ------
    FileError
        If the file cannot be read, a line does not hold two numbers, there are fewer than two, frequencies do not rise
        from above 0 Hz, a density is negative, or units of the heading are none of a density or of another quantity.
    """
    rows: list[tuple[float, float]] = []
    hertz, square = 1.0, 1.0
    for number, line in enumerate(require_readable(path).read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        cells = [cell for cell in line.replace(";", ",").replace("\t", ",").split(",") if cell.strip()]
        if not cells or line.lstrip().startswith("#"):
            continue
        try:
            first, second = (float(cell) for cell in cells)
        except ValueError as error:
            if not rows and not cells[0].strip()[:1].isdigit():
                if len(cells) == 2:
                    with _located(path, number):
                        hertz, square = _heading_factors(cells[0], cells[1], is_support)
                continue
            raise FileError(
                f"{path}, line {number}: a spectrum has two numbers a line, Hz and density, got {line.strip()!r}"
            ) from error
        if not np.isfinite([first, second]).all() or second < 0 or first <= 0 or (rows and first <= rows[-1][0]):
            raise FileError(
                f"{path}, line {number}: frequencies must rise from above 0 Hz and densities be at least 0, got {line.strip()!r}"
            )
        rows.append((first, second))
    if len(rows) < 2:
        raise FileError(f"{path}: a spectrum needs at least two lines of frequency (Hz) and density, got {len(rows)}")
    table = np.array(rows)
    return hertz * table[:, 0], square * table[:, 1]


@contextmanager
def _located(path: Path, number: int) -> Iterator[None]:
    """Context manager that turns an `InputError` into a `FileError` with the line `number` of the file at `path`."""
    try:
        yield
    except InputError as error:
        raise FileError(f"{path}, line {number}: {error}") from error


def _heading_factors(frequency: str, density: str, is_support: bool | None) -> tuple[float, float]:
    """Factors of the columns with these headings to Hz and to N^2/Hz or (m/s^2)^2/Hz; 1 where they state no unit in brackets.

    `is_support` says that the density must be of an acceleration (True) or a force (False); None accepts both.
    `InputError` if the unit cannot be read or is of another quantity. `frequency` and `density` are the headings.
    """
    axis, unit = (match[1] if (match := _IN_BRACKETS.search(text)) else "" for text in (frequency, density))
    hertz = parse_frequency_unit(axis) if axis else 1.0
    if not unit:
        return hertz, 1.0
    parts = _DENSITY_UNIT.fullmatch(unit)
    if parts is None:
        raise InputError(
            f"cannot read {unit!r} as the unit of a spectral density; write N^2/Hz, (m/s^2)^2/Hz or g^2/Hz"
        )
    squared = parse_unit(parts["unit"])
    if squared.quantity not in ("force", "acceleration") or (
        is_support is not None and is_support != (squared.quantity == "acceleration")
    ):
        wanted = {True: "an acceleration of the support", False: "a force", None: "a force or acceleration"}[is_support]
        raise InputError(f"the density must be of {wanted}, got {unit!r}, of {squared.quantity}; correct unit or place")
    return hertz, squared.factor**2 / parse_frequency_unit(parts["per"])


def _require_samples(duration: float, sampling_rate: float) -> None:
    """Raise `InputError` unless a history of `duration`, s, has from two to ten million samples.

    `sampling_rate` is in Hz.
    """
    if not duration * sampling_rate >= 2:
        raise InputError(f"`duration` must hold at least two samples, got {duration:g} s", "duration")
    if duration * sampling_rate > _MOST_SAMPLES:
        raise InputError(
            f"`duration` must hold at most {_MOST_SAMPLES:g} samples, got {duration:g} s at {sampling_rate:g} Hz; shorten it, or"
            " lower the sampling rate",
            "duration",
        )


def _require_rate(value: float, frequency: float, duration: float, sampling_rate: float, what: str) -> None:
    """Raise `InputError` unless a load of `frequency`, Hz, has at least eight samples a period and fits the record.

    `value` is the option that `what` names in errors, and must be positive; the record has 2 to 10 million samples.
    `duration` is in s, `sampling_rate` in Hz.
    """
    if not (np.isfinite(value) and value > 0):
        raise InputError(f"the {what} must be greater than 0, got {value:g}")
    if not sampling_rate >= 8 * frequency:
        raise InputError(
            f"`sampling_rate` must be at least {8 * frequency:g} Hz for the {what} of {value:g}, got {sampling_rate:g}; with fewer"
            " samples the load is another one"
        )
    _require_samples(duration, sampling_rate)


def band_limited_loads(loads: FloatArray) -> FloatArray:
    """Samples (n_times, n_loads) of loads behind a filter against aliasing, corrected for straight lines between them.

    Straight lines weaken such loads by sinc(f / rate)^2, by 3 % at a tenth of the rate, so that the samples are made stronger by
    as much; what the lines add above half the rate hardly moves the modes below it.
    """
    if not loads.size:
        return loads
    both = np.fft.rfft(np.concatenate([loads, loads[::-1]]), axis=0)
    weakened = np.sinc(np.linspace(0, 0.5, len(both))) ** 2
    return np.asarray(np.fft.irfft(both / weakened[:, None], 2 * len(loads), axis=0)[: len(loads)])
