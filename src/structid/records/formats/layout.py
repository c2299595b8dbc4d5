"""structid's own layout: a record as named fields, the same in every format that holds named arrays.

A field is an array of numbers, a text, or a tuple of texts. Absent optional fields are left out.

======================  =====================================================================
field                   meaning
======================  =====================================================================
``structid_record``     ``frf 1`` or ``time 1``: type of record and version of the layout
``frequency``           Hz, (n_frequencies,)
``sampling_rate``       Hz, one number; with ``start``, s
``values``              SI, (n_frequencies, n_outputs, n_inputs) or (n_times, n_channels)
``outputs, inputs``     degrees of freedom such as ``12Z+``; ``channels`` of a time record
``kind, quantities``    what the values are
``variance``            of the values; ``coherence``, ``averages``, ``noise_source``, ``relative``, ``sizes``,
                        ``decay``, ``segment`` as in `FrfRecord`
``source``              where the record came from
======================  =====================================================================
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from structid.core.dof import Dof, parse_dofs
from structid.core.errors import FileError, InputError
from structid.records.record import FrfRecord, TimeRecord

if TYPE_CHECKING:
    from structid.files.contained import Field

MARK = "structid_record"
_FRF_MARK, _TIME_MARK = "frf 1", "time 1"


def fields_of(record: FrfRecord | TimeRecord) -> dict[str, Field]:
    """Fields of `record` by name in structid's layout, arrays and texts; `record_from` restores the record from them.

    Raises
    ------
    InputError
        If a text holds characters that a file format cannot keep.
    """
    fields = _frf_fields(record) if isinstance(record, FrfRecord) else _time_fields(record)
    for name, field in fields.items():
        if isinstance(field, str) and not _is_plain(field):
            raise InputError(f"`{name}` must be plain text to be written, got {field!r}; remove control characters")
    return fields


def _is_plain(text: str) -> bool:
    """True if every format keeps `text`: no null characters, no halves of a surrogate pair."""
    return "\0" not in text and not any("\ud800" <= letter <= "\udfff" for letter in text)


def _time_fields(record: TimeRecord) -> dict[str, Field]:
    """Arrays and texts of a time record by their names in structid's layout; a variance of None is left out."""
    fields: dict[str, Field] = {
        MARK: _TIME_MARK,
        "sampling_rate": np.float64(record.sampling_rate).reshape(1),
        "start": np.float64(record.start).reshape(1),
        "values": record.values,
        "channels": _names(record.channels),
        "quantities": tuple(record.quantities),
        "source": record.source,
    }
    if record.variance is not None:
        fields["variance"] = record.variance
    return fields


def _frf_fields(record: FrfRecord) -> dict[str, Field]:
    """Arrays and texts of an FRF record by their names in structid's layout; fields that are None are left out."""
    fields: dict[str, Field] = {
        MARK: _FRF_MARK,
        "frequency": record.frequency,
        "values": record.values,
        "outputs": _names(record.outputs),
        "inputs": _names(record.inputs),
        "kind": record.kind,
        "noise_source": record.noise_source,
        "source": record.source,
    }
    arrays = {name: getattr(record, name) for name in ("variance", "coherence", "relative", "sizes", "decay")}
    numbers = {name: getattr(record, name) for name in ("averages", "segment")}
    fields |= {name: array for name, array in arrays.items() if array is not None}
    return fields | {name: np.array([number]) for name, number in numbers.items() if number is not None}


def _names(dofs: tuple[Dof, ...]) -> tuple[str, ...]:
    return tuple(str(dof) for dof in dofs)


def record_from(path: Path, fields: Mapping[str, Field]) -> FrfRecord | TimeRecord:
    """The record that `fields` in structid's layout hold; `path` is for errors.

    Raises
    ------
    FileError
        If a field is missing or of the wrong type, or the layout is of a later version.
    InputError
        If the fields do not make a record.
    """
    mark = _text(path, fields, MARK)
    if mark == _FRF_MARK:
        return _frf_record(path, fields)
    if mark == _TIME_MARK:
        return _time_record(path, fields)
    raise FileError(f"{path}: has the structid layout {mark!r}, which this version does not know; update structid")


def _frf_record(path: Path, fields: Mapping[str, Field]) -> FrfRecord:
    """The FRF record made from `fields` in structid's layout; `path` is named in errors.

    Raises `FileError` if a field is missing or of the wrong type, `InputError` if the fields do not make a record.
    Fields that `FrfRecord` may be made without may be missing.
    """
    frequency = _array(path, fields, "frequency").ravel()
    outputs = parse_dofs(_texts(path, fields, "outputs"))
    inputs = parse_dofs(_texts(path, fields, "inputs"))
    shape = (frequency.size, len(outputs), len(inputs))
    return FrfRecord(
        frequency=frequency,
        values=_in_shape(_array(path, fields, "values"), shape),
        outputs=outputs,
        inputs=inputs,
        kind=_text(path, fields, "kind"),  # type: ignore[arg-type]  # FrfRecord checks it
        variance=_optional(path, fields, "variance", shape),
        coherence=_optional(path, fields, "coherence", shape),
        relative=_optional(path, fields, "relative", shape),
        averages=int(_number(path, fields, "averages")) if "averages" in fields else None,
        noise_source=_text(path, fields, "noise_source"),
        source=_text(path, fields, "source"),
        decay=_optional(path, fields, "decay", frequency.shape),
        segment=_number(path, fields, "segment") if "segment" in fields else None,
        sizes=_optional(path, fields, "sizes", shape),
    )


def _time_record(path: Path, fields: Mapping[str, Field]) -> TimeRecord:
    """The time record made from `fields` in structid's layout; `path` is named in errors.

    Raises `FileError` if a field is missing or of the wrong type, or the samples are complex. The variance may be
    missing.
    """
    channels = parse_dofs(_texts(path, fields, "channels"))
    values = _array(path, fields, "values")
    if values.dtype.kind == "c":
        raise FileError(
            f"{path}: field 'values' of time histories must hold real numbers, got complex ones; write it again"
        )
    return TimeRecord(
        sampling_rate=_number(path, fields, "sampling_rate"),
        values=values,
        channels=channels,
        quantities=_texts(path, fields, "quantities"),  # type: ignore[arg-type]  # TimeRecord checks them
        variance=_optional(path, fields, "variance", (len(channels),)),
        start=_number(path, fields, "start"),
        source=_text(path, fields, "source"),
    )


def _in_shape(array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """`array` in `shape` where only axes of length 1 differ, as MATLAB drops and adds them; else unchanged."""
    if array.shape != shape and tuple(n for n in array.shape if n != 1) == tuple(n for n in shape if n != 1):
        return array.reshape(shape)
    return array


def _field(path: Path, fields: Mapping[str, Field], name: str) -> Field:
    """Field `name` of structid's layout; `FileError` if the file at `path` lacks it."""
    if name not in fields:
        raise FileError(f"{path}: has no field {name!r}; the file is incomplete, write it again with structid")
    return fields[name]


def _array(path: Path, fields: Mapping[str, Field], name: str) -> np.ndarray:
    """The numeric array in the field `name` of `fields`, of any shape.

    Raises `FileError` if it is missing or not numeric, or complex in another field than ``values``.
    """
    value = _field(path, fields, name)
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "fciu":
        raise FileError(f"{path}: field {name!r} must hold numbers; the file is damaged, write it again")
    if value.dtype.kind == "c" and name != "values":
        raise FileError(f"{path}: field {name!r} must hold real numbers; the file is damaged, write it again")
    return value


def _optional(path: Path, fields: Mapping[str, Field], name: str, shape: tuple[int, ...]) -> NDArray[np.float64] | None:
    return _in_shape(_array(path, fields, name), shape) if name in fields else None


def _number(path: Path, fields: Mapping[str, Field], name: str) -> float:
    """The single number in the field `name` of `fields`; `FileError` if it is missing or an array of another size."""
    array = _array(path, fields, name)
    if array.size != 1:
        raise FileError(f"{path}: field {name!r} must be one number, got shape {array.shape}")
    return float(array.ravel()[0])


def _text(path: Path, fields: Mapping[str, Field], name: str) -> str:
    """The text in the field `name` of `fields`; `FileError` if it is missing or of another type."""
    value = _field(path, fields, name)
    if not isinstance(value, str):
        raise FileError(f"{path}: field {name!r} must be a text; the file is damaged, write it again")
    return value


def _texts(path: Path, fields: Mapping[str, Field], name: str) -> tuple[str, ...]:
    """The texts in the field `name` of `fields` as a tuple, also for a single one; `FileError` if it is missing or holds others."""
    value = _field(path, fields, name)
    if isinstance(value, str):
        return (value,)
    if not isinstance(value, tuple):
        raise FileError(f"{path}: field {name!r} must be a list of texts; the file is damaged, write it again")
    return value
