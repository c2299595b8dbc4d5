"""Modes in universal files: dataset 55, data at nodes.

Normal modes (analysis type 2) hold frequency, modal mass and damping ratio; complex ones (3, 7) their eigenvalue and
modal A, which for a displacement shape x and residues R = x x' / A is 2 i omega_d times the modal mass.

References
----------
Structural Dynamics Research Laboratory, University of Cincinnati: Universal file formats, dataset 55.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import NumberArray
from structid.core.dof import DIRECTIONS, Dof
from structid.core.errors import FileError
from structid.files.uff import dataset_lines
from structid.modal.modal_record import ModalRecord, Scaling, unit_largest
from structid.records.formats import Geometry
from structid.records.formats.uff.write import SI_UNITS, block, geometry_blocks

_STRUCTURAL, _NORMAL, _COMPLEX, _DISPLACEMENT = 1, 2, 3, 8
_EIGENVALUES = (3, 7)
_HEADER = 9  # records 1 to 8 of a mode: five lines of text, the kind, integers and reals


def modes_uff(path: Path, modes: ModalRecord, geometry: Geometry | None = None) -> bytes:
    """A universal file of `modes` in SI units, with the geometry where it is given.

    Raises
    ------
    FileError
        If two channels are one direction at one node, which the format holds once, or an entry of a shape is unknown, for
        which it has no sign.
    """
    if not modes.known.all():
        raise FileError(
            f"{path}: universal files have no sign for the {int((~modes.known).sum())} unknown entries of the mode shapes;"
            " write .json or .csv, or leave out these modes or channels"
        )
    directions = [dof.unsigned for dof in modes.channels]
    for dof in directions:
        if directions.count(dof) > 1:
            raise FileError(f"{path}: two channels measure {dof.node}{dof.direction}; leave one of them out")
    parts = [SI_UNITS, *geometry_blocks(geometry)]
    parts += [block(55, _mode_lines(modes, k)) for k in range(modes.n_modes)]
    return b"".join(parts)


def _mode_lines(modes: ModalRecord, k: int) -> list[str]:
    is_complex = np.iscomplexobj(modes.mode_shapes)
    n_values = 6 if any(dof.is_rotation for dof in modes.channels) else 3
    omega, ratio = modes.omega[k], np.nan_to_num(modes.damping_ratio[k])
    damped = omega * np.sqrt(max(1 - ratio**2, 0.0))
    unit = float(modes.scaling == "mass")
    reals = [-ratio * omega, damped, 0.0, 2 * damped * unit, 0.0, 0.0]
    if not is_complex:
        reals = [modes.frequency[k], unit, ratio, 0.0]
    kind = [_STRUCTURAL, _COMPLEX if is_complex else _NORMAL, 3 if n_values == 6 else 2, _DISPLACEMENT]
    kind += [5 if is_complex else 2, n_values]
    lines = ["structid", modes.source[:80] or "NONE", "NONE", f"scaling {modes.scaling}"]
    lines.append(f"Mode {k + 1}, frequency {modes.frequency[k]:.5E} Hz")
    lines += [_integers(kind), _integers([2, len(reals), 1, k + 1]), *_reals(reals)]
    nodes: dict[int, NumberArray] = {}
    for dof, value in zip(modes.channels, modes.mode_shapes[:, k], strict=True):
        nodes.setdefault(dof.node, np.zeros(n_values, dtype=modes.mode_shapes.dtype))[dof.axis] = dof.sign * value
    for node, values in nodes.items():
        pairs = np.stack([values.real, values.imag], axis=1).ravel() if is_complex else values
        lines += [f"{node:10d}", *_reals(pairs.tolist())]
    return lines


def _integers(values: list[int]) -> str:
    return "".join(f"{value:10d}" for value in values)


def _reals(values: list[float]) -> list[str]:
    return ["".join(f"{x:13.5E}" for x in values[at : at + 6]) for at in range(0, len(values), 6)]


@dataclass(frozen=True, eq=False)
class _Mode:
    frequency: float
    damping_ratio: float
    factor: complex  # the shape times this has a modal mass of 1; 0 where the file does not say
    nodes: dict[int, NDArray[np.complex128]]
    is_complex: bool


def read_modes_uff(path: Path) -> ModalRecord:
    """The modes in the datasets 55 of the universal file at `path`; others of its datasets are left alone.

    Directions that are 0 throughout were not measured. Where every dataset states a modal mass or modal A, shapes get a
    modal mass of 1.

    Raises
    ------
    FileError
        If there are no modes, a dataset is damaged, or nodes differ between modes.
    """
    found = [mode for place, lines in dataset_lines(path, 55) if (mode := _mode(path, place, lines)) is not None]
    if not found:
        raise FileError(f"{path}: holds no modes (dataset 55 of normal or complex modes); export the mode shapes")
    found.sort(key=lambda mode: mode.frequency)
    nodes = list(found[0].nodes)
    for mode in found:
        if set(mode.nodes) != set(nodes):
            raise FileError(
                f"{path}: the mode of {mode.frequency:g} Hz has other nodes than the first; export all alike"
            )
    values = np.array([[mode.nodes[node] for node in nodes] for mode in found])  # mode, node, direction
    for mode, own in zip(found, values, strict=True):
        if not own.any():
            raise FileError(f"{path}: the mode shape of {mode.frequency:g} Hz is 0 throughout; export it again")
    moving = np.any(values != 0, axis=0)
    dofs = tuple(Dof(node, DIRECTIONS[j]) for i, node in enumerate(nodes) for j in np.flatnonzero(moving[i]))
    shapes = np.array([values[:, i, j] for i, j in np.argwhere(moving)])
    scaling: Scaling = "mass" if all(mode.factor != 0 for mode in found) else "unit_largest"
    shapes = shapes * np.array([mode.factor for mode in found]) if scaling == "mass" else shapes
    scaled = shapes if any(mode.is_complex for mode in found) else shapes.real
    return ModalRecord(
        np.array([mode.frequency for mode in found]), np.array([mode.damping_ratio for mode in found]),
        scaled if scaling == "mass" else unit_largest(scaled), dofs, source=path.name, scaling=scaling,
    )  # fmt: skip


def _mode(path: Path, place: int, lines: list[str]) -> _Mode | None:
    """The mode in one dataset 55, None where it holds something else."""
    where = f"{path}: dataset {place} (55)"
    kind = _numbers(where, lines, 5, 10, 6, "record 6")
    analysis, is_complex, n_values = int(kind[1]), int(kind[4]) in (5, 6), int(kind[5])
    if analysis != _NORMAL and analysis not in _EIGENVALUES:
        return None
    if n_values not in (3, 6):
        raise FileError(f"{where} has {n_values} values per node in record 6; it must be 3 or 6, export it again")
    reals = _numbers(where, lines, 7, 13, 4 if analysis == _NORMAL else 2, "record 8")
    if analysis == _NORMAL:
        frequency, ratio = reals[0], reals[2] or reals[3] / 2
        factor = complex(reals[1] ** -0.5) if reals[1] > 0 else 0j
    else:
        s = complex(reals[0], reals[1])
        frequency, ratio = abs(s) / (2 * np.pi), -s.real / abs(s) if s else 0.0
        modal_a = complex(reals[2], reals[3]) if len(reals) >= 4 else 0j
        factor = complex(np.sqrt(2j * abs(s.imag) / modal_a)) if modal_a and s.imag else 0j
    if not np.isfinite(frequency) or frequency < 0:
        raise FileError(f"{where} has a frequency of {frequency:g} Hz in record 8; it must be at least 0")
    nodes = _nodes(where, lines, n_values, is_complex)
    return _Mode(frequency, ratio if ratio else np.nan, factor, nodes, is_complex)


def _nodes(where: str, lines: list[str], n_values: int, is_complex: bool) -> dict[int, NDArray[np.complex128]]:
    """Records 9 and 10: the values at every node."""
    n_numbers = n_values * (2 if is_complex else 1)
    step = 1 + -(-n_numbers // 6)
    nodes: dict[int, NDArray[np.complex128]] = {}
    for at in range(_HEADER - 1, len(lines), step):
        node = int(_numbers(where, lines, at, 10, 1, f"line {at + 1}")[0])
        numbers: list[float] = []
        for row in range(at + 1, at + step):
            wanted = min(6, n_numbers - len(numbers))
            numbers += _numbers(where, lines, row, 13, wanted, f"node {node}")[:wanted]
        if node in nodes:
            raise FileError(f"{where} gives node {node} twice; export it again")
        values = np.array(numbers)
        if not np.isfinite(values).all():
            raise FileError(f"{where} has a value that is not finite at node {node}; export it again")
        nodes[node] = values[0::2] + 1j * values[1::2] if is_complex else values.astype(np.complex128)
    if not nodes:
        raise FileError(f"{where} has no nodes; export the mode shapes again")
    return nodes


def _numbers(where: str, lines: list[str], at: int, width: int, least: int, field: str) -> list[float]:
    """The numbers in the fixed columns of line `at`."""
    if at >= len(lines):
        raise FileError(f"{where} ends before {field}; the file is truncated, export it again")
    line = lines[at].rstrip()
    texts = [line[k : k + width] for k in range(0, len(line), width)]
    try:
        found = [float(text.replace("D", "E").replace("d", "e")) for text in texts]
    except ValueError:
        raise FileError(
            f"{where} has something other than numbers in {field}: {line[:60]!r}; export it again"
        ) from None
    if len(found) < least:
        raise FileError(f"{where} has {len(found)} of {least} numbers in {field}; export it again")
    return found
