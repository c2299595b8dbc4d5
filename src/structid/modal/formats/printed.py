"""Modes as a solver prints them: one run of a listing or punch file, and how its vectors become a record in SI units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray, IntArray, NumberArray
from structid.core.dof import DIRECTIONS, Dof
from structid.core.errors import FileError
from structid.fem.importers.fixed_fields import FieldError, real_numbers
from structid.modal.formats.options import ModeFileOptions
from structid.modal.modal_record import ModalRecord, Scaling, unit_largest

RUN_AGAIN = "let the solver print frequencies and displacements of all modes"
#: Size of a negative eigenvalue beside the largest one, above which the structure has buckled rather than floats.
_UNSTABLE = 1e-6
_SAME_EIGENVALUE = 2e-5


@dataclass(frozen=True, eq=False)
class PrintedMode:
    """One vector as it is printed.

    Attributes
    ----------
    eigenvalue : complex
        s in rad/s; of undamped modes on the positive imaginary axis.
    nodes : (n_points,) int array
    values : (n_points, 6) array, real or complex
        In the units of the model; NaN where a column is blank.
    systems : (n_points,) int array
        Coordinate system of the motion of each point; -1 where it is not printed.
    generalized_mass : float
        In the units of the model; NaN where it is not printed.
    n_scalar : int
        Points beside these that have no place: scalar, extra and fluid points.
    """

    eigenvalue: complex
    nodes: IntArray
    values: NumberArray
    systems: IntArray
    generalized_mass: float = np.nan
    n_scalar: int = 0

    @property
    def frequency(self) -> float:
        """Undamped natural frequency, Hz."""
        return float(abs(self.eigenvalue) / (2 * np.pi))


@dataclass(frozen=True, eq=False)
class PrintedModes:
    """The modes of one run, in the order of print, and what was left out of them in words."""

    modes: Sequence[PrintedMode]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class VectorKey:
    """The vector that a page belongs to: its run, its mode and the texts of its eigenvalue."""

    subcase: int | None
    superelement: int | None
    mode: int
    eigenvalue: tuple[str, ...]
    is_complex: bool = False

    @property
    def run(self) -> str:
        """Subcase and superelement in words."""
        parts = ("subcase", self.subcase), ("superelement", self.superelement)
        return ", ".join(f"{name} {number}" for name, number in parts if number is not None) or "no subcase"


def chosen_run(path: Path, keys: Sequence[VectorKey], options: ModeFileOptions) -> list[VectorKey]:
    """Keys of the vectors of one run, in the order of `keys`, which are those of all vectors of the file.

    The run is the subcase and kind of eigenvalue (real or complex) that `options` name, or the only one there is.

    Raises
    ------
    FileError
        If several runs have vectors, the subcase has none, or one mode has two eigenvalues.
    """
    subcase, runs = options.subcase, {key.run: key for key in keys}
    chosen = [key for key in keys if subcase is None or key.subcase == subcase]
    if {key.is_complex for key in chosen} == {True, False}:
        if not options.eigenvalues:
            raise FileError(
                f"{path}: holds real modes and complex ones, as of a damped or an aeroelastic analysis; choose with"
                " `eigenvalues`, which is real or complex"
            )
        chosen = [key for key in chosen if key.is_complex == (options.eigenvalues == "complex")]
    if not chosen:
        raise FileError(f"{path}: has no modes of subcase {subcase}, only of {'; '.join(runs)}; name one of these")
    run_names = dict.fromkeys(key.run for key in chosen)
    if len(run_names) > 1:
        remedy = "choose with `subcase`" if len({key.subcase for key in chosen}) > 1 else "print one of them"
        raise FileError(f"{path}: holds modes of {len(run_names)} runs ({'; '.join(run_names)}); {remedy}")
    modes: dict[int, VectorKey] = {}
    for key in chosen:
        other = modes.setdefault(key.mode, key)
        if other != key:
            raise FileError(
                f"{path}: mode {key.mode} is printed with the eigenvalues {', '.join(other.eigenvalue)} and"
                f" {', '.join(key.eigenvalue)}, as of several runs or cycles of design; keep the vectors of one of them"
            )
    return chosen


def oscillating(
    path: Path, keys: Sequence[VectorKey], s: Sequence[complex]
) -> tuple[list[tuple[VectorKey, complex]], tuple[str, ...]]:
    """Vectors with a positive frequency, each as (key, eigenvalue in rad/s), and a note on real eigenvalues left out.

    Each stands for a conjugate pair, whose eigenvalue with negative imaginary part is left out without a note; `s` are
    the eigenvalues of `keys` in rad/s. The notes are () if no eigenvalue is real.

    Raises
    ------
    FileError
        If no eigenvalue has a positive imaginary part.
    """
    with_frequency = [(key, value) for key, value in zip(keys, s, strict=True) if value.imag > 0]
    if not with_frequency:
        raise FileError(f"{path}: no complex eigenvalue has a frequency, all are real; there is no vibration in them")
    n_real = sum(value.imag == 0 for value in s)
    return with_frequency, (f"{n_real} real eigenvalues left out",) if n_real else ()


def undamped(path: Path, squares: Sequence[float]) -> list[complex]:
    """Eigenvalues s = i omega (rad/s) of undamped modes from `squares` omega^2; values negative by rounding become 0.

    Rounding is up to 1e-6 of the largest magnitude, or 1e-3 (rad/s)^2 if that is more.

    Raises
    ------
    FileError
        If one is negative beyond rounding, so that the structure is unstable.
    """
    largest = max((abs(square) for square in squares), default=0.0)
    for number, square in enumerate(squares, 1):
        if square < -max(_UNSTABLE * largest, 1e-3):
            raise FileError(
                f"{path}: mode {number} has the negative eigenvalue {square:.6g}; the model is unstable, or the analysis"
                " is not one of vibration: correct the deck"
            )
    return [1j * np.sqrt(max(square, 0.0)) for square in squares]


def same_eigenvalue(first: float, other: float) -> bool:
    """True if two printed eigenvalues are equal to the rounding of print, 2e-5 of the larger."""
    return abs(first - other) <= _SAME_EIGENVALUE * max(abs(first), abs(other)) + 1e-12


def complex_values(first: FloatArray, second: FloatArray, is_polar: bool) -> NumberArray:
    """Complex numbers from real and imaginary parts, or from magnitudes and phases in deg."""
    return np.asarray(first * np.exp(1j * np.deg2rad(second)) if is_polar else first + 1j * second)


def parse_numbers(path: Path, fields: Sequence[str]) -> FloatArray:
    """Numbers (n,) from text fields, also with Fortran's exponents, and those that a solver prints as NaN or infinite.

    `path` is for errors.

    Raises
    ------
    FileError
        If a field is no number.
    """
    table = np.array([field.encode("latin-1", "replace") for field in fields], dtype="S24")
    width = table.dtype.itemsize
    letters = np.frombuffer(table.tobytes(), dtype=np.uint8).reshape(-1, width)
    try:
        return real_numbers(np.where(letters == 0, np.uint8(ord(" ")), letters), must_be_finite=False)
    except FieldError as error:
        raise FileError(f"{path}: {error.text[:30]!r} is no number; the file is damaged, {RUN_AGAIN}") from error


def require_same_points(path: Path, modes: Sequence[PrintedMode]) -> None:
    """Raise `FileError` unless all modes have the points of the first one, in the same order and each once."""
    nodes = modes[0].nodes
    if len(np.unique(nodes)) != len(nodes):
        raise FileError(f"{path}: a point is printed twice in one mode; leave one of them")
    for number, mode in enumerate(modes, 1):
        if not np.array_equal(mode.nodes, nodes):
            raise FileError(
                f"{path}: mode {number} has other points than the first; the file is cut short, {RUN_AGAIN}"
            )


def printed_record(
    path: Path,
    printed: PrintedModes,
    options: ModeFileOptions,
    axes: Mapping[int, FloatArray] | None = None,
    words: Sequence[str] = (),
) -> ModalRecord:
    """Modal record, in SI units, of printed modes at the directions that move, by rising frequency; largest entry 1.

    Rotations are kept where `options` state the unit of length, as their size beside translations depends on it. Where
    they state the unit of force too, shapes have modal mass 1 by the generalized masses. Damping ratios are NaN if all
    eigenvalues are on the imaginary axis.

    Parameters
    ----------
    path : Path
        File, for errors and the `source` of the record.
    printed : PrintedModes
        Points, eigenvalues and vectors in the units of the model.
    options : ModeFileOptions
        Units of the model.
    axes : mapping of int to (3, 3) array, optional
        Axes, as rows in global ones, along which each point moves; without it the vectors are taken as global.
    words : sequence of str
        Remarks on how the file was read, for the `source` of the record.

    Raises
    ------
    FileError
        If points differ from mode to mode, a value is missing, a mode does not move, both units are stated but a
        generalized mass is missing, or without `axes` a point states another system than the global one.
    """
    require_same_points(path, printed.modes)
    modes = sorted(printed.modes, key=lambda mode: mode.frequency)
    notes = [*words, *printed.notes]
    shapes = np.stack([mode.values for mode in modes], axis=2)  # point, component, mode
    n_scalar = max(mode.n_scalar for mode in modes)
    if n_scalar:
        notes.append(f"{n_scalar} scalar points left out")
    has_rotations = not np.isnan(shapes[:, 3:]).any()
    if np.isnan(shapes[:, :3]).any() or (not has_rotations and not np.isnan(shapes[:, 3:]).all()):
        point = int(modes[0].nodes[np.argmax(np.isnan(shapes).any(axis=(1, 2)))])
        raise FileError(f"{path}: point {point} lacks some of its motions; {RUN_AGAIN}")
    shapes = _in_global_axes(path, modes, shapes, axes, notes)
    n_components = 6 if has_rotations and options.length is not None else 3
    if has_rotations and n_components == 3 and np.any(shapes[:, 3:] != 0):
        notes.append("rotations left out (give `length_unit` to keep them)")
    shapes = shapes[:, :n_components]
    if options.length is not None:
        shapes[:, :3] *= options.length
    rows = shapes.reshape(-1, len(modes))
    if (np.abs(rows).max(axis=0, initial=0.0) == 0).any():
        raise FileError(f"{path}: a mode has no translation anywhere; leave it out, or {RUN_AGAIN}")
    scaling: Scaling = "unit_largest"
    masses = np.array([mode.generalized_mass for mode in modes])
    if options.length is not None and options.force is not None:
        if not (masses > 0).all():
            raise FileError(f"{path}: prints no generalized masses, so that `force_unit` has no use; leave it out")
        rows, scaling = rows / np.sqrt(masses * options.force * options.length), "mass"
    moving = np.flatnonzero(np.abs(rows).max(axis=1) > 0)
    nodes = modes[0].nodes
    channels = [Dof(int(nodes[row // n_components]), DIRECTIONS[row % n_components]) for row in moving.tolist()]
    s = np.array([mode.eigenvalue for mode in modes])
    omega = np.abs(s)
    is_damped = np.any(s.real != 0)
    ratio = np.where(omega > 0, -s.real / np.where(omega > 0, omega, 1.0), np.nan)
    return ModalRecord(
        omega / (2 * np.pi), ratio if is_damped else np.full(len(s), np.nan),
        rows[moving] if scaling == "mass" else unit_largest(rows[moving]), channels, scaling=scaling,
        source="; ".join([path.name, *notes]),
    )  # fmt: skip


def _in_global_axes(
    path: Path,
    modes: Sequence[PrintedMode],
    shapes: NumberArray,
    axes: Mapping[int, FloatArray] | None,
    notes: list[str],
) -> NumberArray:
    """Mode shapes (n_points, 6, n_modes) turned from the points' displacement systems to global axes.

    `axes` maps node labels to (3, 3) axes as rows; a point without an entry, or whose system is 0 (global) in the first
    of `modes`, stays. None takes all shapes as global, and `FileError` if a point states another system. Assumptions
    are appended to `notes`.
    """
    systems, nodes = modes[0].systems, modes[0].nodes
    if axes is None:
        turned = np.flatnonzero(systems > 0)
        if turned.size:
            raise FileError(
                f"{path}: the motion of point {nodes[turned[0]]} is printed in coordinate system {systems[turned[0]]}; name the"
                " deck that defines it with `deck`"
            )
        if (systems < 0).any():
            notes.append(
                "displacement systems of the points taken as global (name the deck with `deck` to follow them)"
            )
        return shapes.copy()
    result = shapes.copy()
    for i, node in enumerate(nodes.tolist()):
        if node in axes and systems[i] != 0:  # 0: basic axes, as the file says
            for part in (slice(0, 3), slice(3, 6)):
                result[i, part] = axes[node].T @ shapes[i, part]
    return result
