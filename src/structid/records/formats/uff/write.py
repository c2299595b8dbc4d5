"""Records and geometry as datasets of a universal file, and the check that they came through."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.dof import Dof
from structid.core.errors import FileError
from structid.records.formats.geometry import Geometry
from structid.records.formats.uff.channels import DATA_TYPES, direction_of
from structid.records.record import QUANTITY_UNITS, FrfRecord, TimeRecord

_SIDES = {
    "receptance": ("displacement", "force"),
    "mobility": ("velocity", "force"),
    "accelerance": ("acceleration", "force"),
    "transmissibility": ("acceleration", "acceleration"),
}
_TAG = "    -1"
_LARGEST_NODE = 999_999_999
_NOTHING = f"{0:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20s} {'NONE':<20s}"


def file_bytes(path: Path, record: FrfRecord | TimeRecord, geometry: Geometry | None) -> Iterator[bytes]:
    """Content of a universal file of `record`, dataset by dataset: 164 (SI), geometry (if not None), 58b.

    Raises
    ------
    FileError
        If a node label has more than nine digits, or the abscissa of a single point needs more than six digits.
    """
    dofs = (*record.outputs, *record.inputs) if isinstance(record, FrfRecord) else record.channels
    for node in (*(dof.node for dof in dofs), *(geometry.nodes if geometry else ())):
        if node > _LARGEST_NODE:
            raise FileError(f"{path}: node {node} has more than the nine digits the format keeps apart; renumber it")
    yield SI_UNITS
    yield from geometry_blocks(geometry)
    yield from _frf_blocks(path, record) if isinstance(record, FrfRecord) else _time_blocks(path, record)


def block(number: int, lines: list[str]) -> bytes:
    """Dataset `number` as ASCII text, with its tags."""
    return "\n".join([_TAG, f"{number:6d}", *lines, _TAG, ""]).encode("ascii", errors="replace")


#: Dataset 164: what follows is in SI.
SI_UNITS = block(164, [f"{1:10d}{'SI':<20s}{1:10d}", "".join(f"{n:25.17e}" for n in (1, 1, 1)), f"{273.15:25.17e}"])


def geometry_blocks(geometry: Geometry | None) -> Iterator[bytes]:
    """Datasets 15 and 2411 (nodes, m) and 82 (trace lines) of a geometry, as bytes; nothing for None or without nodes.

    Each node stands in both datasets of nodes, in 15 with six digits; there is one dataset 82 for each line.
    """
    if geometry is None or not geometry.nodes:
        return
    short, full = [], []
    for node, point in geometry.nodes.items():
        head = f"{node:10d}{0:10d}{0:10d}{0:10d}"
        short.append(head + "".join(f"{x:13.5E}" for x in point))
        full += [head, "".join(f"{x:25.16E}" for x in point)]
    yield block(15, short)
    yield block(2411, full)
    for i, line in enumerate(geometry.lines, start=1):
        rows = [line[first : first + 8] for first in range(0, len(line), 8)]
        numbers = ["".join(f"{node:10d}" for node in row) for row in rows]
        yield block(82, [f"{i:10d}{len(line):10d}{0:10d}", f"line {i}", *numbers])


def _title(record: FrfRecord | TimeRecord) -> list[str]:
    averages = record.averages if isinstance(record, FrfRecord) else None
    return ["structid", "NONE", "NONE", "NONE" if averages is None else f"averages={averages}", "NONE"]


class _Axis(NamedTuple):
    """The abscissa: even where six digits, as the format has them, say it exactly; else one entry a point."""

    points: FloatArray
    even: bool
    start: float
    step: float
    line: str


def _make_axis(path: Path, points: FloatArray, step: float, data_type: int, unit: str) -> _Axis:
    """Abscissa of a function as it is written: points, evenness, rounded start and step, and the header line.

    `step` is the spacing of `points` (n_points,) if they are even; `data_type` (18 frequency) and `unit` describe them.
    Points whose even step needs more than six digits are stored one by one; a single such point raises `FileError`.
    """
    rounded_start, rounded_step = float(f"{points[0]:.5e}"), float(f"{step:.5e}")
    rebuilt = rounded_start + rounded_step * np.arange(points.size)
    even = bool(np.allclose(rebuilt, points, rtol=1e-14, atol=0)) and (points.size > 1 or rounded_step == step)
    if points.size == 1 and not even:
        raise FileError(f"{path}: one point has an axis of more than six digits, which is lost; write .npz instead")
    line = f"{data_type:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20s} {unit:<20s}"
    return _Axis(points, even, rounded_start if even else 0.0, rounded_step if even else 0.0, line)


def _function_bytes(
    number: int, output: Dof, load: Dof | None, values: FloatArray | ComplexArray, axis: _Axis, text: list[str]
) -> bytes:
    """Bytes of a dataset 58b with `values` (n_points,); `load` None leaves the reference out.

    `number` is the function type (1 time response, 4 FRF, 6 coherence), and `text` holds five title lines, then the
    lines of ordinate and denominator. `output` and `load` are response and reference, `axis` is the abscissa.
    """
    is_complex = np.iscomplexobj(values)
    columns = [values.real, values.imag] if is_complex else [values]
    body = np.stack(columns if axis.even else [axis.points, *columns], axis=1).astype("<f8").tobytes()
    reference = (load.node, direction_of(load)) if load else (0, 0)
    header = [
        _TAG,
        f"{58:6d}b{1:6d}{2:6d}{11:12d}{len(body):12d}{0:6d}{0:6d}{0:12d}{0:12d}",
        *text[:5],
        f"{number:5d}{0:10d}{0:5d}{0:10d} {'NONE':<10s}{output.node:10d}{direction_of(output):4d}"
        f" {'NONE':<10s}{reference[0]:10d}{reference[1]:4d}",
        f"{6 if is_complex else 4:10d}{len(values):10d}{int(axis.even):10d}{axis.start:13.5e}{axis.step:13.5e}{0.0:13.5e}",
        axis.line,
        *text[5:],
        _NOTHING,
        "",
    ]
    return "\n".join(header).encode("ascii") + body + f"{_TAG}\n".encode()


def _side(quantity: str, dof: Dof) -> str:
    """Line of dataset 58 for ordinate or denominator: data type and unit of `quantity` at `dof`."""
    unit = QUANTITY_UNITS[quantity][dof.is_rotation]
    return f"{DATA_TYPES[quantity]:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20s} {unit:<20s}"


def _frf_blocks(path: Path, record: FrfRecord) -> Iterator[bytes]:
    """Datasets 58b of the FRFs of a record as bytes, each followed by its coherence; inputs vary fastest."""
    step = float(record.frequency[1] - record.frequency[0]) if record.frequency.size > 1 else 1.0
    title, axis = _title(record), _make_axis(path, record.frequency, step, 18, "Hz")
    for a, output in enumerate(record.outputs):
        for b, load in enumerate(record.inputs):
            above, below = _SIDES[record.kind]
            sides = [_side(above, output), _side(below, load)]
            yield _function_bytes(4, output, load, record.values[:, a, b], axis, [*title, *sides])
            if record.coherence is not None:
                text = [*title, _NOTHING, _NOTHING]
                yield _function_bytes(6, output, load, record.coherence[:, a, b], axis, text)


def _time_blocks(path: Path, record: TimeRecord) -> Iterator[bytes]:
    """Datasets 58b of the time histories of `record`, one a channel."""
    title, axis = _title(record), _make_axis(path, record.time, 1 / record.sampling_rate, 17, "s")
    for i, (dof, quantity) in enumerate(zip(record.channels, record.quantities, strict=True)):
        yield _function_bytes(1, dof, None, record.values[:, i], axis, [*title, _side(quantity, dof), _NOTHING])


def require_same(path: Path, record: FrfRecord | TimeRecord, back: FrfRecord | TimeRecord) -> None:
    """Raise `FileError` unless `back`, read from the written file, has the values of `record` (0 and -0 are equal).

    Channels, kind or quantities, frequencies or sampling rate (to rounding), and the presence of coherence must agree
    too.
    """
    is_same = type(back) is type(record) and np.array_equal(back.values, record.values)
    if isinstance(record, FrfRecord) and isinstance(back, FrfRecord):
        is_same = (
            is_same and back.outputs == record.outputs and back.inputs == record.inputs and back.kind == record.kind
        )
        is_same = is_same and bool(np.allclose(back.frequency, record.frequency, rtol=1e-12, atol=0))
        is_same = is_same and (back.coherence is None) == (record.coherence is None)
    if isinstance(record, TimeRecord) and isinstance(back, TimeRecord):
        is_same = is_same and back.channels == record.channels and back.quantities == record.quantities
        is_same = is_same and abs(back.sampling_rate - record.sampling_rate) <= 1e-9 * record.sampling_rate
    if not is_same:
        raise FileError(
            f"{path}: does not read back as it was written; nothing was kept, write .npz instead and report this"
        )
