"""Modes in universal files: datasets 55 (data at nodes) and 2414 (analysis data), written as 55.

Normal modes (analysis type 2) hold frequency, modal mass and damping ratio; complex ones (3, 7) their eigenvalue s and
modal A, which for a displacement shape x and residues R = x x' / A is 2 i omega_d times the modal mass. Modal mass and modal A
belong to the displacement shape: one of velocity is s x, one of acceleration s^2 x.

References
----------
Structural Dynamics Research Laboratory, University of Cincinnati: Universal file formats, datasets 55 and 2414.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import NumberArray
from structid.core.display import join_words, plural
from structid.core.dof import DIRECTIONS, Dof, is_whole_number
from structid.core.errors import FileError, InputError
from structid.core.units import FORCES, LENGTHS
from structid.files.uff.datasets import UffDataset, integers, read_blocks, read_reals, read_unit_factors
from structid.files.uff.geometry import UniversalNodes, read_nodes
from structid.modal.formats.options import ModeFileOptions
from structid.modal.modal_record import ModalRecord, Scaling, unit_largest
from structid.records.formats.geometry import Geometry
from structid.records.formats.uff.write import SI_UNITS, block, geometry_blocks

_STRUCTURAL, _NORMAL, _COMPLEX, _DISPLACEMENT = 1, 2, 3, 8
_EIGENVALUES = (3, 7)
_LARGEST_LABEL = 9_999_999_999
#: Part of a direction along another axis that is rounding.
_ROUNDED = 1e-5
#: How often each kind of motion is the displacement differentiated by time.
_MOTIONS = {8: ("displacement", 0), 11: ("velocity", 1), 12: ("acceleration", 2)}
#: Result types of which a file says that it does not know them; 94 and 97 are scalars and tensors.
_UNKNOWN = (0, 1, 93, 95, 96)
_RESULTS = {
    2: "stress", 3: "strain", 4: "element force", 5: "temperature", 6: "heat flux", 7: "strain energy", 9: "reaction force",
    10: "kinetic energy", 13: "strain energy density", 14: "kinetic energy density", 32: "constraint forces",
}  # fmt: skip
_ANALYSES = {
    0: "an unknown analysis", 1: "a static analysis", 4: "a transient analysis", 5: "a frequency response", 6: "buckling",
    9: "a nonlinear static analysis",
}  # fmt: skip
_MODELS = {2: "heat transfer", 3: "fluid flow"}
_VECTORS = {2: 3, 3: 6}

T = TypeVar("T")


def modes_uff(path: Path, modes: ModalRecord, geometry: Geometry | None = None) -> bytes:
    """Content of a universal file of `modes` in SI units, with the nodes and lines of `geometry` if given.

    Raises
    ------
    FileError
        If two channels are one direction at one node, which the format holds once, an entry of a shape is unknown, for
        which it has no sign, or a node has more than ten digits.
    """
    if not modes.known.all():
        raise FileError(
            f"{path}: universal files have no sign for the {int((~modes.known).sum())} unknown entries of the mode shapes;"
            " write .json or .csv, or leave out these modes or channels"
        )
    if wide := [dof.node for dof in modes.channels if dof.node > _LARGEST_LABEL]:
        raise FileError(
            f"{path}: node {wide[0]} has more than the ten digits of the format; renumber it, or write .json"
        )
    directions = [dof.unsigned for dof in modes.channels]
    for dof in directions:
        if directions.count(dof) > 1:
            raise FileError(f"{path}: two channels measure {dof.node}{dof.direction}; leave one of them out")
    parts = [SI_UNITS, *geometry_blocks(geometry)]
    parts += [block(55, _mode_lines(modes, k)) for k in range(modes.n_modes)]
    return b"".join(parts)


def _mode_lines(modes: ModalRecord, k: int) -> list[str]:
    """Lines of text of a dataset 55 for the mode with index `k` (from 0), in SI units; directions not measured are 0.

    An unknown damping ratio is written as 0. Modal mass or modal A stand only where shapes are scaled to mass, else 0.
    """
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
    return ["".join(f"{x:13.5E}" for x in values[start : start + 6]) for start in range(0, len(values), 6)]


@dataclass(frozen=True)
class _Kind:
    """Type of data that the header of a dataset 55 or 2414 states."""

    model: int
    analysis: int
    characteristic: int
    result: int
    data: int
    n_values: int

    def objection(self) -> str:
        """Reason why the data are no mode shape, such as "results of buckling"; "" if they are one."""
        if self.model in _MODELS:
            return f"results of {_MODELS[self.model]}"
        if self.analysis != _NORMAL and self.analysis not in _EIGENVALUES:
            return f"results of {_ANALYSES.get(self.analysis, f'analysis type {self.analysis}')}"
        if self.result not in _MOTIONS and self.result not in _UNKNOWN:
            return _RESULTS.get(self.result, f"data of type {self.result}")
        if self.characteristic == 0 and self.result not in _MOTIONS:
            return "data of unknown type and characteristic"
        if self.characteristic not in (0, *_VECTORS):
            return f"scalars or tensors (data characteristic {self.characteristic})"
        return ""


@dataclass(frozen=True, eq=False)
class _Mode:
    """A mode as a dataset states it.

    Attributes
    ----------
    s : complex
        Eigenvalue, rad/s; of a normal mode i omega.
    damping_ratio : float
        NaN where it is not known.
    modal_mass : complex
        Modal A over 2 i omega_d of a complex mode, in the units of the file; 0 where it is not stated.
    order : int
        How often the shape is the displacement differentiated by time; -1 where the file does not say.
    nodes : dict of int to (n_values,) complex array
    """

    where: str
    number: int
    s: complex
    damping_ratio: float
    modal_mass: complex
    order: int
    nodes: dict[int, NDArray[np.complex128]]
    is_complex: bool


def read_modes_uff(path: Path, options: ModeFileOptions | None = None) -> ModalRecord:
    """The modes in the datasets 55 and 2414 of the universal file at `path`, in SI units and global axes.

    Directions that are 0 throughout were not measured. Where every dataset states a modal mass or modal A, shapes get a
    modal mass of 1. The `source` of the record says what was taken for granted and left out. None for `options` takes
    the defaults.

    Raises
    ------
    FileError
        If there are no modes, a dataset is damaged, nodes differ between modes, or most nodes with axes of their own were
        measured in directions that are along no global axes; fewer such nodes are left out, and modes that move no others.
    """
    options = options or ModeFileOptions()
    blocks = read_blocks(path)
    notes: list[str] = []
    modes = _read_datasets(path, blocks, notes)
    modes = _drop_duplicates(path, modes, notes)
    _require_vibrations(modes)
    length, force, has_units = _units(path, blocks, options)
    nodes = list(modes[0].nodes)
    for mode in modes:
        if set(mode.nodes) != set(nodes):
            raise FileError(f"{mode.where} has other nodes than the first mode; export all alike")
    values = np.array([[mode.nodes[node] for node in nodes] for mode in modes])  # mode, node, direction
    for mode, shape in zip(modes, values, strict=True):
        if not shape.any():
            raise FileError(f"{mode.where}: the mode shape is 0 throughout; export it again")
    universal = read_nodes(path, blocks)
    if options.shape_axes == "named":
        notes.append("directions as they are named, whatever coordinate systems the nodes have")
    else:
        _turn_to_global_axes(universal, nodes, values, notes)
        modes, values = _drop_unmoved(modes, values, notes)
    s = np.array([mode.s for mode in modes])
    values[:, :, :3] *= length
    scaling: Scaling = "unit_largest"
    if factors := _mass_factors(modes, force * length, notes):
        values, scaling = values * np.array(factors)[:, None, None], "mass"
    moving = np.any(values != 0, axis=0)
    if not has_units and (scaling == "mass" or moving[:, 3:].any()):
        notes.append("no units (dataset 164): taken as SI")
    dofs = tuple(Dof(node, DIRECTIONS[j]) for i, node in enumerate(nodes) for j in np.flatnonzero(moving[i]))
    shapes = np.array([values[:, i, j] for i, j in np.argwhere(moving)])
    scaled: NumberArray = shapes if any(mode.is_complex for mode in modes) else shapes.real
    return ModalRecord(
        np.abs(s) / (2 * np.pi), np.array([mode.damping_ratio for mode in modes]),
        scaled if scaling == "mass" else unit_largest(scaled), dofs, source="; ".join([path.name, *notes]), scaling=scaling,
    )  # fmt: skip


def _read_datasets(path: Path, blocks: Sequence[UffDataset], notes: list[str]) -> list[_Mode]:
    """All modes of the file in order of frequency; `FileError` if there is none.

    A note is appended to `notes` for datasets that hold other data. `blocks` are all datasets of the file.
    """
    modes: list[_Mode] = []
    objections: Counter[str] = Counter()
    for dataset in blocks:
        if dataset.number in (55, 2414):
            read_dataset = _read_55 if dataset.number == 55 else _read_2414
            mode = read_dataset(f"{path}: dataset {dataset.ordinal} ({dataset.number})", dataset.lines)
            if isinstance(mode, str):
                objections[mode] += 1
            else:
                modes.append(mode)
    left_out = [f"{words} ({count})" if count > 1 else words for words, count in objections.items()]
    if not modes:
        reason = f"; it holds {', '.join(left_out)}" if left_out else ""
        raise FileError(
            f"{path}: holds no modes (datasets 55 or 2414 of normal or complex modes at nodes){reason}; export the mode shapes"
        )
    notes += [f"left out: {words}" for words in left_out]
    return sorted(modes, key=lambda mode: abs(mode.s))


def _drop_duplicates(path: Path, modes: list[_Mode], notes: list[str]) -> list[_Mode]:
    """Modes with one shape each, in order: of one kind of dataset, of one motion, one of each conjugate pair.

    Datasets 55 are kept if 2414 hold the same modes, else `FileError`. Where shapes are of several motions, all but
    those of the lowest derivative (displacement first) are left out. Of complex modes those with a positive imaginary
    part or at 0 Hz stay; `FileError` if all eigenvalues are real. Remarks are appended to `notes`.
    """
    numbers = {mode.number for mode in modes}
    if len(numbers) > 1:
        first, second = ([mode for mode in modes if mode.number == number] for number in (55, 2414))
        same = len(first) == len(second)
        if not same or not np.allclose([m.s for m in first], [m.s for m in second], rtol=1e-4, atol=1e-6):
            raise FileError(f"{path}: holds modes in datasets 55 and others in datasets 2414; export one of the two")
        modes = first
        notes.append("left out: the same modes in datasets 2414")
    orders = {mode.order for mode in modes}
    if len(orders) > 1:
        kept = min(order for order in orders if order >= 0)
        notes.append("left out: shapes of other motions of the same modes")
        modes = [mode for mode in modes if mode.order == kept]
    if any(mode.s.imag > 0 for mode in modes):
        n_real = sum(mode.s.imag == 0 and mode.s.real != 0 for mode in modes)
        if n_real:
            notes.append(f"left out: {n_real} real eigenvalues")
        return [mode for mode in modes if mode.s.imag > 0 or mode.s == 0]
    if all(mode.s.imag == 0 and mode.s.real != 0 for mode in modes):
        raise FileError(f"{path}: all eigenvalues are real; there is no vibration in them")
    return modes


def _require_vibrations(modes: list[_Mode]) -> None:
    """Raise `FileError` if a damping ratio is 1 or more, or two modes in succession have equal poles and shapes."""
    for mode in modes:
        if mode.damping_ratio >= 1:
            raise FileError(
                f"{mode.where} states a damping ratio of {mode.damping_ratio:g}, with which nothing vibrates; correct it"
            )
    for first, second in pairwise(modes):
        same = first.s == second.s and first.nodes.keys() == second.nodes.keys()
        if same and all(np.array_equal(values, second.nodes[node]) for node, values in first.nodes.items()):
            raise FileError(f"{second.where} repeats the mode before it; keep one of the two")


def _units(path: Path, blocks: Sequence[UffDataset], options: ModeFileOptions) -> tuple[float, float, bool]:
    """Units of length (m) and of force (N) of a universal file, and True if the file or options state that of length.

    A unit is 1.0 where neither dataset 164 among `blocks`, the file's datasets, nor an option states it. `InputError`
    if an option contradicts the file.
    """
    factors = read_unit_factors(path, blocks)
    stated = (1.0, 1.0) if factors is None else (1 / factors.length, 1 / factors.force)
    units = []
    for name, unit, factor_of, value in (
        ("length_unit", options.length_unit, LENGTHS, stated[0]),
        ("force_unit", options.force_unit, FORCES, stated[1]),
    ):
        if unit and factors is not None and abs(factor_of[unit] / value - 1) > 1e-4:
            raise InputError(
                f"{path}: its dataset 164 states another unit than {unit}, of {value:g} SI units; leave `{name}` out",
                name,
            )
        units.append(factor_of[unit] if unit else value)
    return units[0], units[1], factors is not None or bool(options.length_unit)


def _mass_factors(modes: Sequence[_Mode], unit: float, notes: list[str]) -> list[complex]:
    """Complex factors, one for each mode, that turn shapes into displacements of unit modal mass (kg).

    They are [] if no mode states a modal mass, and also, with a remark in `notes`, if one states none, a file does not
    say that its shapes are displacements, velocities or accelerations, or one of the latter two is at 0 Hz.

    Parameters
    ----------
    modes : sequence of _Mode
    unit : float
        Unit of force times length in the file, in N m.
    notes : list of str
        Remarks are appended here.
    """
    n_stated = sum(mode.modal_mass != 0 for mode in modes)
    if not n_stated:
        return []
    unknown = next((mode for mode in modes if mode.order < 0), None)
    if n_stated < len(modes) or unknown is not None:
        reason = "which the file does not say to be of displacement" if unknown else "as some modes state none"
        notes.append(f"modal masses not used, {reason}")
        return []
    factors = []
    for mode in modes:
        if mode.order and mode.s == 0:
            notes.append("modal masses not used, as a shape of velocity or acceleration at 0 Hz has no displacement")
            return []
        s = mode.s if mode.is_complex and mode.s.real else complex(abs(mode.s))
        factors.append(complex(1 / np.sqrt(mode.modal_mass * unit)) / (s**mode.order if mode.order else 1.0))
    return factors


def _turn_to_global_axes(
    universal: UniversalNodes, nodes: Sequence[int], values: NDArray[np.complex128], notes: list[str]
) -> None:
    """Turn `values` (mode, node, direction) of nodes with displacement systems of their own to global axes, in place.

    A direction without motion was not measured, or, where rotations tell a computed shape, held. Nodes whose measured
    directions span more global axes than there are of them are set to 0, so that they are left out; `FileError` if most
    turned nodes are such. Remarks are appended to `notes`. `universal` has the nodes' coordinate systems, `nodes` are
    the labels along the second axis.
    """
    is_computed = bool(values[:, :, 3:].any())
    oblique: list[tuple[int, int]] = []
    n_turned = 0
    for i, node in enumerate(nodes):
        axes = universal.axes(node)
        if axes is None:
            continue
        n_turned += 1
        for part in (slice(0, 3), slice(3, 6)):
            motion = values[:, i, part]
            moving = np.any(motion != 0, axis=0)
            if not moving.any():
                continue
            touched = np.any(np.abs(axes[moving]) > _ROUNDED, axis=0)
            if touched.sum() > moving.sum() and not is_computed:
                oblique.append((node, int(moving.sum())))
                values[:, i, part] = 0.0
                continue
            values[:, i, part] = motion @ np.where(touched, axes, 0.0)
    if 2 * len(oblique) > n_turned:
        node, count = oblique[0]
        raise FileError(
            f"{universal.path}: node {node} was measured in {count} of the directions of its own coordinate"
            " system, which are along no global axes; export shapes in global axes, or all directions of the node, or give"
            ' `shape_axes = "named"` in [record.modes], and say by `direction` in [record.sensors] where such sensors point'
        )
    if oblique:
        labels = ", ".join(str(node) for node, _ in oblique[:5])
        more = f" and {len(oblique) - 5} more" if len(oblique) > 5 else ""
        word = "nodes" if len(oblique) > 1 else "node"
        notes.append(f"left out: {word} {labels}{more}, held or not measured along directions that are no global axes")
    if n_turned > len(oblique):
        words = plural(n_turned - len(oblique), "node")
        notes.append(f"motions of {words} turned from their displacement systems to global axes")


def _drop_unmoved(
    modes: list[_Mode], values: NDArray[np.complex128], notes: list[str]
) -> tuple[list[_Mode], NDArray[np.complex128]]:
    """Modes and `values` (mode, node, direction) without those that move only nodes that were left out.

    A remark is appended to `notes`; `FileError` if none is left.
    """
    moves = np.any(values != 0, axis=(1, 2))
    if moves.all():
        return modes, values
    if not moves.any():
        raise FileError(
            f"{modes[0].where}: only nodes that were measured in directions along no global axes move; export shapes in global"
            ' axes, or all directions of the node, or give `shape_axes = "named"` in [record.modes]'
        )
    left_out = join_words([f"{abs(modes[k].s) / (2 * np.pi):.6g}" for k in np.flatnonzero(~moves)])
    notes.append(f"left out: modes at {left_out} Hz, which move no other nodes")
    return [modes[k] for k in np.flatnonzero(moves)], values[moves]


def _read_55(where: str, lines: list[str]) -> _Mode | str:
    """Mode in one dataset 55 of a universal file (its `lines`), or words on other data, such as "results of buckling".

    `where` names the dataset in errors. `FileError` if a record is damaged, too short or not finite.
    """
    kind = _Kind(*_integers_of(where, lines, 5, 6, "record 6"))
    if words := kind.objection():
        return words
    n_integers, n_reals, *_ = _integers_of(where, lines, 6, 2, "record 7")
    if not (0 <= n_integers <= 10 and 1 <= n_reals <= 12):
        raise FileError(f"{where} states {n_integers} integers and {n_reals} reals in record 7; export it again")
    begin = 6 + -(-(2 + n_integers) // 8)
    n_lines = -(-n_reals // 6)
    reals = _reals_of(where, lines, begin, n_lines, "record 8")
    if len(reals) < (4 if kind.analysis == _NORMAL else 2):
        raise FileError(f"{where} has {len(reals)} numbers in record 8, too few for a mode; export it again")
    if kind.analysis == _NORMAL:
        return _make_mode(where, 55, kind, lines, begin + n_lines, _normal(where, *reals[:4]))
    return _make_mode(where, 55, kind, lines, begin + n_lines, _complex(reals))


def _read_2414(where: str, lines: list[str]) -> _Mode | str:
    """Mode in one dataset 2414 of a universal file (its `lines`), or words on other data, as "results of buckling".

    `where` names the dataset in errors. `FileError` if a record is damaged, too short or not finite.
    """
    (location,) = _integers_of(where, lines, 2, 1, "record 3")
    kind = _Kind(*_integers_of(where, lines, 8, 6, "record 9"))
    if words := kind.objection():
        return words
    if location != 1:
        return "results that are not at nodes"
    first, second = (_reals_of(where, lines, line_index, 1, f"record {line_index + 1}") for line_index in (11, 12))
    if len(first) < 6 or len(second) < 6:
        raise FileError(f"{where} must have six numbers in each of the records 12 and 13; export it again")
    stated = _normal(where, first[1], *first[3:6]) if kind.analysis == _NORMAL else _complex(second)
    return _make_mode(where, 2414, kind, lines, 13, stated)


_Stated = tuple[complex, float, complex]


def _normal(where: str, frequency: float, mass: float, viscous: float, hysteretic: float) -> _Stated:
    """Eigenvalue i omega (rad/s), damping ratio and modal mass of a normal mode.

    `frequency` is in Hz; the ratio is `viscous`, else half of `hysteretic`, else NaN; the mass is 0 if not stated.
    `FileError` if a number is not finite or the frequency negative. `where` names the dataset in errors.
    """
    if not np.isfinite([frequency, mass, viscous, hysteretic]).all() or frequency < 0:
        raise FileError(
            f"{where} has a frequency of {frequency:g} Hz; it must be at least 0, and all its numbers finite"
        )
    return 2j * np.pi * frequency, viscous or hysteretic / 2 or np.nan, complex(max(mass, 0.0))


def _complex(reals: Sequence[float]) -> _Stated:
    """Eigenvalue, damping ratio and modal A over 2 i omega_d of a complex mode.

    `reals` are real and imaginary part of the eigenvalue, then of modal A. The ratio is NaN without damping, the last 0 without
    modal A.
    """
    s, modal_a = complex(reals[0], reals[1]), complex(*reals[2:4]) if len(reals) >= 4 else 0j
    ratio = -s.real / abs(s) if s.real else np.nan
    return s, ratio, modal_a / (2j * s.imag) if s.imag else 0j


def _make_mode(where: str, number: int, kind: _Kind, lines: list[str], begin: int, stated: _Stated) -> _Mode:
    """Mode of a dataset of `lines`, whose nodes begin at line index `begin`.

    `stated` is its eigenvalue (rad/s), damping ratio and modal mass; `where` names the dataset in errors, `number` is
    55 or 2414. `FileError` if a value is not finite or the data have an unknown layout. `kind` is the layout that the
    header of the dataset states.
    """
    s, ratio, mass = stated
    if not np.isfinite([s.real, s.imag, mass.real, mass.imag]).all():
        raise FileError(f"{where} has an eigenvalue or modal mass that is not finite; export it again")
    width = _VECTORS.get(kind.characteristic, kind.n_values)
    if kind.n_values != width or kind.n_values not in (3, 6):
        raise FileError(
            f"{where} has {kind.n_values} values per node of data characteristic {kind.characteristic}; it must be 3 of 2"
            " (translations) or 6 of 3 (translations and rotations): export it again"
        )
    if kind.data not in (2, 4, 5, 6):
        raise FileError(f"{where} has data of type {kind.data}; it must be 2 or 4 (real), 5 or 6 (complex)")
    is_complex = kind.data in (5, 6)
    nodes = _read_nodes(where, lines, begin, kind.n_values, is_complex)
    order = _MOTIONS[kind.result][1] if kind.result in _MOTIONS else -1
    return _Mode(where, number, s, ratio, mass, order, nodes, is_complex or kind.analysis != _NORMAL)


def _read_nodes(
    where: str, lines: list[str], begin: int, n_values: int, is_complex: bool
) -> dict[int, NDArray[np.complex128]]:
    """Motion (6,) by node label: each node has a line with its label, then lines with its values.

    The nodes begin at index `begin` of the dataset's `lines`; each has `n_values` values, pairs of numbers if
    `is_complex`. Missing rotations are 0. `FileError`, with the dataset `where`, if a node is damaged, repeated or
    incomplete.
    """
    n_numbers = n_values * (2 if is_complex else 1)
    step = 1 + -(-n_numbers // 6)
    nodes: dict[int, NDArray[np.complex128]] = {}
    for line_index in range(begin, len(lines), step):
        words = lines[line_index].split()
        if len(words) != 1 or not is_whole_number(words[0]):
            raise FileError(
                f"{where} must have a node number in line {line_index + 1}, got {lines[line_index].strip()[:60]!r}; export it again"
            )
        node = int(words[0])
        numbers = _reals_of(where, lines, line_index + 1, step - 1, f"node {node}")
        if len(numbers) != n_numbers:
            raise FileError(f"{where} has {len(numbers)} of {n_numbers} numbers at node {node}; export it again")
        if node in nodes:
            raise FileError(f"{where} gives node {node} twice; export it again")
        values = np.array(numbers)
        if not np.isfinite(values).all():
            raise FileError(f"{where} has a value that is not finite at node {node}; export it again")
        full = np.zeros(6, dtype=np.complex128)
        full[:n_values] = values[0::2] + 1j * values[1::2] if is_complex else values
        nodes[node] = full
    if not nodes:
        raise FileError(f"{where} has no nodes; export the mode shapes again")
    return nodes


def _lines_of(where: str, lines: list[str], begin: int, count: int, field: str) -> list[str]:
    if begin + count > len(lines):
        raise FileError(f"{where} ends before {field}; the file is truncated, export it again")
    return lines[begin : begin + count]


def _integers_of(where: str, lines: list[str], begin: int, count: int, field: str) -> list[int]:
    """The first `count` whole numbers of the record in line `begin` (index) of a dataset's `lines`, in columns of ten.

    `where` names the dataset and `field` the record in the `FileError` for damage.
    """
    (line,) = _lines_of(where, lines, begin, 1, field)
    n_words = max(len(line.split()), count)
    return _numbers_of(where, line, field, lambda: integers(line, (10,) * n_words)[:count])


def _reals_of(where: str, lines: list[str], begin: int, count: int, field: str) -> list[float]:
    text = "\n".join(_lines_of(where, lines, begin, count, field))
    return _numbers_of(where, text, field, lambda: read_reals(text.encode("ascii", errors="replace")).tolist())


def _numbers_of(where: str, text: str, field: str, read: Callable[[], list[T]]) -> list[T]:
    try:
        return read()
    except ValueError:
        raise FileError(
            f"{where} has something other than numbers in {field}: {text[:60]!r}; export it again"
        ) from None
