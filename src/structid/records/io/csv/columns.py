"""Columns of a CSV table by their headers, as records; and records as headed columns."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from structid.arrays import FloatArray
from structid.dof import Dof, parse_dof
from structid.errors import FileError, InputError
from structid.records.io.bare import require_same_rotation
from structid.records.io.csv.table import Table
from structid.records.io.gaps import sourced, whole
from structid.records.io.options import ReadOptions
from structid.records.record import FrfKind, FrfRecord, TimeRecord
from structid.units import FrfUnit, Unit, parse_frf_unit, parse_unit

_CHANNEL = re.compile(r"^(?P<dof>[^\[\]]+?)\s*\[(?P<unit>[^\[\]]+)\]$")
_PAIR = re.compile(
    r"^(?P<output>[^\[\]/]+?)\s*/\s*(?P<input>[^\[\]/]+?)\s*(\[(?P<unit>[^\[\]]*)\])?\s*(?P<part>re|im|coherence|std)$"
)
#: Unevenness of the time column allowed, as a part of the step.
_EVEN = 1e-6


def _column(table: Table, j: int, error: InputError | None = None, text: str = "") -> FileError:
    reason = str(error) if error else text
    return FileError(f"{table.path}: line 1, column {j + 1} ({table.names[j]!r}): {reason}")


def time_record(table: Table, options: ReadOptions | None = None) -> TimeRecord:
    """The time record in `table`, its gaps treated as `options` say.

    Raises
    ------
    FileError
        If a header is not a degree of freedom with its unit, the time column is not even, or a gap stays.
    """
    channels: list[Dof] = []
    units: list[Unit] = []
    for j in range(1, len(table.names)):
        match = _CHANNEL.match(table.names[j])
        if match is None:
            raise _column(table, j, text="head a channel with degree of freedom and unit, as in 12Z+ [m/s^2]")
        try:
            channels.append(parse_dof(match["dof"]))
            units.append(parse_unit(match["unit"]))
            require_same_rotation(table.path, match["dof"], channels[-1].is_rotation, units[-1].rotation)
        except InputError as error:
            raise _column(table, j, error) from error
    rate = sampling_rate(table.path, table.values[:, 0])
    start = float(table.values[0, 0])
    kept = whole(table.path, table.values[:, 1:], channels, rate, start, options or ReadOptions(), first_line=2)
    return TimeRecord(
        sampling_rate=rate,
        values=kept.values * np.array([unit.factor for unit in units]),
        channels=tuple(channels),
        quantities=tuple(unit.quantity for unit in units),
        start=kept.start,
        source=sourced(table.path, kept.note),
    )


def sampling_rate(path: Path, time: FloatArray) -> float:
    """Samples per second of an even time column.

    Raises
    ------
    FileError
        If there are fewer than two samples, or a step differs by more than 1e-6 of it, rounding apart.
    """
    if time.size < 2:
        raise FileError(f"{path}: one line does not tell a sampling rate; give at least two samples")
    step = (time[-1] - time[0]) / (time.size - 1)
    if step <= 0:
        raise FileError(f"{path}: column 1: time must increase, got {time[0]:g} first and {time[-1]:g} last")
    off = np.abs(np.diff(time) - step)
    allowed = _EVEN * step + 4 * np.finfo(float).eps * float(np.abs(time).max())
    if off.max() > allowed:
        i = int(np.argmax(off))
        raise FileError(
            f"{path}: line {i + 3}, column 1: time must be even, got a step of {time[i + 1] - time[i]:.9g} s where the "
            f"mean is {step:.9g} s; {_uneven_remedy(time, i)}"
        )
    return float(1 / step)


def _uneven_remedy(time: FloatArray, i: int) -> str:
    """What to do about an uneven step from sample `i` to the next."""
    usual = float(np.median(np.diff(time)))
    missing = (time[i + 1] - time[i]) / usual - 1 if usual > 0 else 0.0
    if missing > 0.5 and abs(missing - round(missing)) < 0.01 * (missing + 1):
        return (
            f"{round(missing)} lines are missing at the usual step of {usual:.9g} s: cut the file there, or add these lines "
            f"with empty cells and interpolate with ReadOptions(longest_gap={round(missing)})"
        )
    return "resample, or write more digits"


def time_header(record: TimeRecord) -> tuple[list[str], list[FloatArray]]:
    """Headers and columns of a time record."""
    names = [f"{dof} [{unit}]" for dof, unit in zip(record.channels, record.units, strict=True)]
    return ["time_s", *names], [record.time, *record.values.T]


class _Column(NamedTuple):
    output: Dof
    input: Dof
    unit: FrfUnit | None
    part: str


def _pair(table: Table, j: int) -> _Column:
    match = _PAIR.match(table.names[j])
    if match is None:
        hint = "head a pair with output/input, unit and part, as in 12Z+/3Z+ [(m/s^2)/N] re (or im, std, coherence)"
        raise _column(table, j, text=hint)
    part = match["part"]
    try:
        output, load = parse_dof(match["output"]), parse_dof(match["input"])
        unit = None if part == "coherence" else parse_frf_unit(match["unit"] or "")
        if unit is not None:
            require_same_rotation(table.path, f"output {output}", output.is_rotation, unit.output_rotation)
            require_same_rotation(table.path, f"input {load}", load.is_rotation, unit.input_rotation)
    except InputError as error:
        raise _column(table, j, error) from error
    return _Column(output, load, unit, part)


def frf_record(table: Table) -> FrfRecord:
    """The FRF record in `table`; every output needs a pair with every input.

    Raises
    ------
    FileError
        If a header cannot be read, a pair is missing or doubled, or kinds are mixed.
    """
    columns = [_pair(table, j) for j in range(1, len(table.names))]
    outputs = tuple(dict.fromkeys(column.output for column in columns))
    inputs = tuple(dict.fromkeys(column.input for column in columns))
    parts: dict[str, FloatArray] = {}
    for j, column in enumerate(columns, start=1):
        shape = (table.values.shape[0], len(outputs), len(inputs))
        part = parts.setdefault(column.part, np.full(shape, np.nan))
        place = (slice(None), outputs.index(column.output), inputs.index(column.input))
        if not np.isnan(part[place]).all():
            raise _column(table, j, text="this pair and part is there twice; remove one")
        part[place] = table.values[:, j] * (column.unit.factor if column.unit else 1.0)
    _require_complete(table, parts, outputs, inputs)
    return FrfRecord(
        frequency=table.values[:, 0],
        values=parts["re"] + 1j * parts["im"],
        outputs=outputs,
        inputs=inputs,
        kind=_kind(table, columns),
        variance=parts["std"] ** 2 if "std" in parts else None,
        coherence=parts.get("coherence"),
        noise_source="declared" if "std" in parts else "unknown",
        source=str(table.path),
    )


def _kind(table: Table, columns: list[_Column]) -> FrfKind:
    kinds = {column.unit.kind for column in columns if column.unit is not None}
    if len(kinds) != 1:
        raise FileError(
            f"{table.path}: line 1: one table holds one kind, got {', '.join(sorted(kinds))}; split the table"
        )
    return kinds.pop()


def _require_complete(
    table: Table, parts: dict[str, FloatArray], outputs: tuple[Dof, ...], inputs: tuple[Dof, ...]
) -> None:
    for part in ("re", "im", *(name for name in parts if name not in ("re", "im"))):
        for a, output in enumerate(outputs):
            for b, load in enumerate(inputs):
                if part not in parts or np.isnan(parts[part][:, a, b]).any():
                    raise FileError(
                        f"{table.path}: line 1: no column {output}/{load} {part}; every output needs one "
                        "for every input"
                    )


def _frf_unit(record: FrfRecord, output: Dof, load: Dof) -> str:
    motion = {"receptance": "", "mobility": "/s", "accelerance": "/s^2"}[record.kind]
    above = ("rad" if output.is_rotation else "m") + motion
    return f"({above})/{'(N m)' if load.is_rotation else 'N'}"


def frf_header(record: FrfRecord) -> tuple[list[str], list[FloatArray]]:
    """Headers and columns of an FRF record."""
    header, columns = ["frequency_hz"], [record.frequency]
    for a, output in enumerate(record.outputs):
        for b, load in enumerate(record.inputs):
            name = f"{output}/{load} [{_frf_unit(record, output, load)}]"
            header += [f"{name} re", f"{name} im"]
            columns += [record.values[:, a, b].real, record.values[:, a, b].imag]
            if record.coherence is not None:
                header.append(f"{output}/{load} coherence")
                columns.append(record.coherence[:, a, b])
            if record.variance is not None:
                header.append(f"{name} std")
                columns.append(np.sqrt(record.variance[:, a, b]))
    return header, columns
