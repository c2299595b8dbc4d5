"""What every sensor would tell of the parameters, under every load, at every line: the blocks that a plan chooses from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.dof import Dof
from structid.core.errors import InputError
from structid.fem import Friction, Structure
from structid.forward.frf.response import response
from structid.inversion.diagnostics.design import information_root
from structid.records import FrfRecord
from structid.records.record import FrfKind
from structid.unknowns import Parameters

_CHUNK_BYTES = 48_000_000
_LARGEST_BYTES = 1_500_000_000
#: Responses this small, as a part of the largest at their line, are rounding and are taken as noise.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Candidates:
    """Every place and line that a test could use, and the noise it would have.

    Attributes
    ----------
    structure : Structure
    parameters : Parameters
        The derivatives are taken at their initial values.
    sensors, loads : tuple of Dof
    frequency : (n_lines,) float array
        Hz.
    kind : {"receptance", "mobility", "accelerance", "transmissibility"}
    relative_noise, absolute_noise : float
        Standard deviation of the complex noise: a part of each value's magnitude, and in the SI unit of `kind`,
        added in quadrature.
    """

    structure: Structure
    parameters: Parameters
    sensors: tuple[Dof, ...]
    loads: tuple[Dof, ...]
    frequency: FloatArray
    kind: FrfKind
    relative_noise: float
    absolute_noise: float

    @property
    def scale(self) -> FloatArray:
        """Size of each parameter, to which its standard deviation is relative."""
        start = np.abs(self.parameters.start)
        return np.where(start > 0, start, 1.0)


def pair_roots(given: Candidates) -> FloatArray:
    """Triangular R with R'R the information of one sensor under one load over all lines, (n_sensors, n_loads, n_params, n_params).

    Lines are processed in chunks, and each chunk is merged into the triangles before the next is computed.

    Raises
    ------
    InputError
        If there are so many pairs that their triangles do not fit in memory.
    """
    n_params = given.parameters.n_params
    size = 8 * len(given.sensors) * len(given.loads) * n_params**2
    if size > _LARGEST_BYTES:
        raise InputError(
            f"{len(given.sensors)} sensors times {len(given.loads)} loads with {n_params} parameters are too many"
            f" candidates ({size / 1e9:.1f} GB); name fewer in `sensors` and `loads`"
        )
    roots = np.zeros((len(given.sensors), len(given.loads), n_params, n_params))
    for loads, _, rows in _row_chunks(given, range(len(given.sensors)), range(len(given.loads))):
        n_lines = rows.shape[0]
        by_pair = np.moveaxis(rows, 0, 2).reshape(*rows.shape[1:3], n_lines * 2, n_params)
        stacked = np.concatenate([roots[:, loads], by_pair], axis=2)
        roots[:, loads] = np.linalg.qr(stacked, mode="r")
    return roots


def line_roots(given: Candidates, sensors: tuple[int, ...], loads: tuple[int, ...]) -> FloatArray:
    """R with R'R the information of each line from the given sensors and loads (indices), (n_lines, n_rows, n_params)."""
    n_params, n_lines = given.parameters.n_params, len(given.frequency)
    parts: dict[int, list[FloatArray]] = {}
    for _, lines, rows in _row_chunks(given, sensors, loads):
        parts.setdefault(lines.start, []).append(rows.reshape(rows.shape[0], -1, n_params))
    roots = [information_root(np.concatenate(blocks, axis=1)) for _, blocks in sorted(parts.items())]
    return np.concatenate(roots).reshape(n_lines, -1, n_params)


def _row_chunks(
    given: Candidates, sensors: range | tuple[int, ...], loads: range | tuple[int, ...]
) -> Iterator[tuple[slice, slice, FloatArray]]:
    """Chunks of whitened sensitivities: slice of `loads`, slice of lines, rows (n_lines, n_sensors, n_loads, 2, n_params)."""
    n_params, n_dofs = given.parameters.n_params, given.structure.n_dofs
    has_friction = any(isinstance(element, Friction) for element in given.structure.elements)
    per_load = 16 * len(sensors) * n_params
    group = 1 if has_friction else max(1, _CHUNK_BYTES // max(per_load, 1))
    for first_load in range(0, len(loads), group):
        part = slice(first_load, min(first_load + group, len(loads)))
        chosen = tuple(loads)[part]
        per_line = max(per_load * len(chosen), 16 * n_dofs * (len(sensors) + len(chosen)))
        step = max(1, _CHUNK_BYTES // max(per_line, 1))
        for first in range(0, len(given.frequency), step):
            lines = slice(first, min(first + step, len(given.frequency)))
            yield part, lines, _whitened_sensitivities(given, tuple(sensors), chosen, lines)


def _whitened_sensitivities(
    given: Candidates, sensors: tuple[int, ...], loads: tuple[int, ...], lines: slice
) -> FloatArray:
    """Derivatives of the FRFs by relative parameter changes, divided by the noise, (n_lines, n_sensors, n_loads, 2, n_params).

    The fourth axis has the real and the imaginary part; `sensors` and `loads` are indices of candidates.
    """
    frequency = given.frequency[lines]
    record = FrfRecord(
        frequency,
        np.zeros((len(frequency), len(sensors), len(loads)), dtype=np.complex128),
        tuple(given.sensors[s] for s in sensors),
        tuple(given.loads[i] for i in loads),
        given.kind,
    )
    values, derivative = response(given.structure, given.parameters, record).derivatives_at(given.parameters.start)
    std = _noise_deviation(given, values)
    # a value that nothing moves, at rest on the path of every load, has no noise either and tells nothing
    weight = np.divide(1.0, std, out=np.zeros_like(std), where=std > 0)
    rows = derivative * given.scale * weight[..., None]
    return np.stack([rows.real, rows.imag], axis=3)


def _noise_deviation(given: Candidates, values: ComplexArray) -> FloatArray:
    """Standard deviation of the real (and of the imaginary) part of each FRF value, as `values` (n_lines, n_sensors, n_loads)."""
    size = np.abs(values)
    rounding = _ROUNDING * size.max(axis=(1, 2), keepdims=True)
    noise = np.hypot(given.relative_noise * size, given.absolute_noise)
    is_rounding = size < rounding
    return np.where(is_rounding, np.maximum(noise, size.max(axis=(1, 2), keepdims=True)), noise) / np.sqrt(2)
