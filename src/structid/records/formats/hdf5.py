"""HDF5 files: structid's own layout, or bare arrays (at any depth, such as ``test/frf``) with `ReadOptions`."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from structid.core.errors import InputError
from structid.core.units import parse_frequency_unit, parse_frf_unit, parse_unit
from structid.files import atomic_write
from structid.files.contained import Field, hdf5_attributes, hdf5_datasets, hdf5_fields
from structid.records.formats.bare import Shapes, read_bare
from structid.records.formats.layout import MARK, fields_of, record_from
from structid.records.formats.options import ReadOptions
from structid.records.formats.selection import select_channels
from structid.records.formats.stated import Statements, is_statement, statements_of
from structid.records.record import FrfRecord, TimeRecord

if TYPE_CHECKING:
    import h5py


def read(path: Path, options: ReadOptions) -> FrfRecord | TimeRecord:
    """The record in the HDF5 file at `path`: structid's layout, or bare arrays that `options` describe.

    In structid's layout `options` choose among channels and must not contradict the file. Units in attributes of bare
    arrays stand for options that are not set.

    Raises
    ------
    FileError
        If the file is not HDF5, is damaged, or has its values in other files.
    InputError
        If it holds bare arrays and an option is missing, or an option contradicts the file.
    """
    shapes: Shapes = {name: (dataset.shape, dataset.dtype) for name, dataset in hdf5_datasets(path).items()}
    if MARK in shapes:
        fields = hdf5_fields(path, [name for name in shapes if "/" not in name])
        return select_channels(path, record_from(path, fields), options)
    attributes = hdf5_attributes(path)
    options, words = _with_stated_units(path, shapes, attributes, options)
    loaded = hdf5_fields(
        path, _needed_datasets(shapes, {options.array, options.frequency_array, options.coherence_array})
    )
    beside = [name for name, (_, dtype) in shapes.items() if dtype.kind in "fiuO" and is_statement(name)]
    statements = attributes | statements_of(hdf5_fields(path, beside))
    record = read_bare(path, shapes, lambda name: np.asarray(loaded[name]), options, statements)
    return replace(record, source=f"{record.source}; {words}") if words else record


def _with_stated_units(
    path: Path, shapes: Shapes, attributes: Statements, options: ReadOptions
) -> tuple[ReadOptions, str]:
    """Options completed by the units in the attributes of the arrays to read, and words on them ("" if nothing was added).

    `shapes` has the shape and type of each array by name, `attributes` the texts at ``array@attribute``. Raises
    `InputError` if an attribute contradicts a unit that `options` has already.
    """
    stated: dict[str, tuple[str, ...]] = {}
    for address, value in attributes.items():
        dataset, _, key = address.rpartition("@")
        if key.lower() in ("unit", "units", "unit_string") and isinstance(value, tuple):
            stated.setdefault(dataset, value)
    numeric = [name for name, (_, dtype) in shapes.items() if dtype.kind in "fciu"]
    others = {options.frequency_array, options.coherence_array}
    left = [name for name in numeric if name not in others]
    name = options.array or (left[0] if len(left) == 1 else "")
    is_frf = bool(options.frequency_array)
    changes: dict[str, Any] = {}
    words = []
    for key, array in (("unit" if is_frf else "units", name), ("axis_unit", options.frequency_array)):
        texts = tuple(text.strip() for text in stated.get(array, ()) if text.strip())
        if not array or not texts:
            continue
        option = getattr(options, key)
        if not option:
            changes[key] = texts if key == "units" else texts[0]
            words.append(f"{array} in {', '.join(dict.fromkeys(texts))} by its attribute")
        elif option and not _agree(key, option, texts):
            raise InputError(
                f"{path}: array {array!r} states {', '.join(dict.fromkeys(texts))} as its unit, but `{key}`"
                f" {option if isinstance(option, str) else ', '.join(option)} was given; leave it out",
                key,
            )
    return replace(options, **changes), ", ".join(words)


def _agree(key: str, option: str | tuple[str, ...], stated: tuple[str, ...]) -> bool:
    """True if the units `option` and those `stated` by a file mean the same; a single unit holds for all channels.

    `key` is ``unit`` (of FRFs), ``units`` (of channels) or ``axis_unit`` (of frequencies) and decides how texts are
    parsed; where one cannot be parsed, the texts must be equal. False if the numbers of units differ otherwise.
    """
    parse: Callable[[str], object] = {"unit": parse_frf_unit, "units": parse_unit, "axis_unit": parse_frequency_unit}[
        key
    ]
    texts = (option,) if isinstance(option, str) else option
    count = max(len(texts), len(stated))
    if len(texts) not in (1, count) or len(stated) not in (1, count):
        return False
    try:
        pairs = zip(*(each * count if len(each) == 1 else each for each in (texts, stated)), strict=True)
        return all(parse(a) == parse(b) for a, b in pairs)
    except InputError:
        return texts == stated


def _needed_datasets(shapes: Shapes, wanted: set[str]) -> set[str]:
    """Names of the datasets to load: those in `wanted` that exist, and all numeric ones if it is clear that they are meant.

    It is clear if `wanted` holds no name but "", or if the file has at most one numeric dataset besides the wanted ones.
    """
    named = {name for name in shapes if name in wanted}
    numeric = {name for name, (_, dtype) in shapes.items() if dtype.kind in "fciu"}
    return named if any(wanted) and len(numeric) > len(named) + 1 else named | numeric


def write(path: Path, record: FrfRecord | TimeRecord) -> None:
    """Write `record` to `path` as an HDF5 file in structid's layout, complete.

    It is made in memory, so that a full disk shows as an ordinary error when the bytes are written.

    Raises
    ------
    FileError
        If the file cannot be written.
    InputError
        If a text of the record holds control characters.
    """
    import h5py

    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        for name, field in fields_of(record).items():
            _store(file, name, field)
    with atomic_write(path) as temporary:
        temporary.write_bytes(content.getbuffer())


def _store(file: h5py.File, name: str, field: Field) -> None:
    """Store `field` of a record, an array or texts, under `name` in an open HDF5 file."""
    import h5py

    if isinstance(field, np.ndarray):
        file.create_dataset(name, data=field)
    else:
        file.create_dataset(name, data=field, dtype=h5py.string_dtype("utf-8"))
