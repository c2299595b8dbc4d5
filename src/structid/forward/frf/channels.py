"""Loads and sensors of a model as columns on its degrees of freedom."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray, IntArray, NumberArray


@dataclass(frozen=True, eq=False)
class Channels:
    """Loads, sensors and the sliding motions of contacts; made by `channels`.

    Attributes
    ----------
    columns : (n_dofs, n_columns) sparse array
        Unit loads at all loads and sensors, each once: at a drive point one column serves both.
    inputs, outputs : ((n,) int array, (n,) float array)
        Column and sign of each load, and of each sensor; the last of `outputs` are contacts.
    n_contacts : int
    """

    columns: sparse.csc_array
    inputs: tuple[IntArray, FloatArray]
    outputs: tuple[IntArray, FloatArray]
    n_contacts: int

    @property
    def n_outputs(self) -> int:
        """Number of sensors without contacts."""
        return len(self.outputs[0]) - self.n_contacts

    @cached_property
    def sensors(self) -> sparse.csc_array:
        """Columns of the sensors and contacts, signs included, (n_dofs, n_outputs + n_contacts)."""
        index, sign = self.outputs
        return sparse.csc_array(self.columns[:, index] @ sparse.diags_array(sign))

    @cached_property
    def reader(self) -> sparse.csr_array:
        """Map from fields (n_dofs, n) to the readings of sensors and contacts."""
        return sparse.csr_array(self.sensors.T)

    def read(self, fields: NumberArray) -> NumberArray:
        """Readings of sensors and contacts, (n_lines, n_outputs + n_contacts, n), from fields (n_lines, n_dofs, n)."""
        return read(self.reader, fields)

    def under_loads(self, fields: NumberArray) -> NumberArray:
        """Fields under the loads, signs included, from fields (..., n_columns) under all `columns`."""
        return fields[..., _as_slice(self.inputs[0])] * self.inputs[1]

    def under_sensors(self, fields: NumberArray) -> NumberArray:
        """Fields under loads at sensors and contacts, signs included, from fields (..., n_columns) under all `columns`."""
        return fields[..., _as_slice(self.outputs[0])] * self.outputs[1]


def _as_slice(index: IntArray) -> slice | IntArray:
    """The `index` (n,) as a slice where it counts up by one, which takes no copy; as it is otherwise."""
    counts_up = len(index) > 0 and (np.diff(index) == 1).all()
    return slice(int(index[0]), int(index[-1]) + 1) if counts_up else index


def read(reader: sparse.csr_array, fields: NumberArray) -> NumberArray:
    """Readings (n_lines, n_readings, n) of fields (n_lines, n_dofs, n) by the sparse rows `reader` (n_readings, n_dofs)."""
    flat = np.moveaxis(fields, 1, 0).reshape(fields.shape[1], -1)
    readings = np.asarray(reader @ flat).reshape(reader.shape[0], fields.shape[0], fields.shape[2])
    return np.moveaxis(readings, 0, 1)


def channels(loads: sparse.csc_array, sensors: sparse.csc_array, slides: sparse.csc_array) -> Channels:
    """Columns of `loads`, `sensors` and friction contacts `slides`, (n_dofs, n) each; equal ones are merged.

    Columns that agree up to sign count as equal. The result has the distinct columns and, for each load and for each
    sensor and then contact, its column and its sign.
    """
    columns, places = _distinct(sparse.csc_array(sparse.hstack([loads, sensors, slides])))
    index, sign = np.array([p for p, _ in places], dtype=np.int64), np.array([s for _, s in places])
    n = loads.shape[1]
    return Channels(columns, (index[:n], sign[:n]), (index[n:], sign[n:]), slides.shape[1])


def _distinct(columns: sparse.csc_array) -> tuple[sparse.csc_array, list[tuple[int, float]]]:
    """Columns without repetitions up to sign, and for each column of `columns` its index among them and its sign.

    The sign is that of the first nonzero entry, which the distinct columns have positive; +1 for an empty column.
    """
    kept: dict[tuple[bytes, bytes], int] = {}
    first, places = [], []
    for j in range(columns.shape[1]):
        part = slice(columns.indptr[j], columns.indptr[j + 1])
        index, value = columns.indices[part], columns.data[part]
        order = np.argsort(index)
        index, value = index[order].astype(np.int64), value[order]
        sign = 1.0 if not value.size or value[0] > 0 else -1.0
        key = (index.tobytes(), (sign * value).tobytes())
        if key not in kept:
            kept[key] = len(kept)
            first.append((j, sign))
        places.append((kept[key], sign))
    unique = columns[:, [j for j, _ in first]] @ sparse.diags_array([s for _, s in first])
    return sparse.csc_array(unique), places
