"""MAT files of MATLAB: structid's own layout, or bare arrays with `ReadOptions`; version 5 and 7.3 read, 5 written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy import sparse

from structid.core.errors import FileError
from structid.files import atomic_write
from structid.files.contained import Field, matlab_variables
from structid.records.formats.bare import Shapes, read_bare
from structid.records.formats.layout import MARK, fields_of, record_from
from structid.records.formats.options import ReadOptions
from structid.records.formats.selection import select_channels
from structid.records.formats.stated import statements_of
from structid.records.record import FrfRecord, TimeRecord

_LARGEST = 2**31 - 1


def read(path: Path, options: ReadOptions) -> FrfRecord | TimeRecord:
    """The record in the MAT file at `path`: structid's layout, or bare arrays that `options` describe.

    In structid's layout `options` choose among channels. A field of a struct is named with a dot, as in ``test.frf``.

    Raises
    ------
    FileError
        If the file is not a MAT file or is damaged.
    InputError
        If it holds bare arrays and an option is missing, or an option contradicts the file.
    """
    variables = matlab_variables(path)
    fields: dict[str, Field] = {name: value for name, value in variables.items() if not sparse.issparse(value)}
    if MARK in fields:
        return select_channels(path, record_from(path, fields), options)
    arrays = {name: field for name, field in fields.items() if isinstance(field, np.ndarray)}
    shapes: Shapes = {name: (array.shape, array.dtype) for name, array in arrays.items()}
    return read_bare(path, shapes, arrays.__getitem__, options, statements_of(fields))


def write(path: Path, record: FrfRecord | TimeRecord) -> None:
    """Write `record` to `path` as a MAT file of version 5 in structid's layout, complete.

    Raises
    ------
    FileError
        If the file cannot be written, or an array is larger than the 2 GB of version 5.
    InputError
        If a text of the record holds control characters.
    """
    from scipy.io import savemat

    fields = fields_of(record)
    if record.values.nbytes > _LARGEST:
        raise FileError(f"{path}: a MAT file of version 5 holds 2 GB an array at most; write .h5 instead")
    with atomic_write(path) as temporary, temporary.open("wb") as stream:
        savemat(
            stream, {name: _as_matlab(field) for name, field in fields.items()}, oned_as="column", do_compression=True
        )


def _as_matlab(field: Field) -> np.ndarray | str:
    return np.array(field, dtype=object) if isinstance(field, tuple) else field
