"""Outputs of a solver in the folder of a run: checks that they are complete, and the modes that it prints."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.display import plural
from structid.core.dof import DIRECTIONS, Dof
from structid.core.errors import FileError, InputError
from structid.external.deck import MatrixFile
from structid.fem.importers import ImportedMatrix, dof_table, read_matrix, read_numbering
from structid.files import damage_told, require_readable
from structid.modal.formats.calculix import frd_modes
from structid.modal.formats.files import read_modes
from structid.modal.formats.nastran import nastran_modes, printed_axes
from structid.modal.formats.options import F06_SUFFIXES, FRD_SUFFIXES, OP2_SUFFIXES, PUNCH_SUFFIXES
from structid.modal.formats.printed import PrintedMode, require_same_points
from structid.modal.poles.poles import modal_phase_collinearity
from structid.similarity import most_real

#: Files that others are read with, by suffix.
_BESIDE = {".sti": (".dof",), ".mas": (".dof",)}


#: Suffixes that are read here; others are files of modes as `read_modes` knows them.
FRD, NASTRAN = FRD_SUFFIXES, (*F06_SUFFIXES, *PUNCH_SUFFIXES, *OP2_SUFFIXES)
#: Six and seven digits.
_ROUNDING = {".frd": 5e-6, **dict.fromkeys(NASTRAN, 5e-7)}
#: Modal phase collinearity below which a mode is truly complex: a ninth of its motion is a quarter of a period apart.
_LEAST_COLLINEARITY = 0.95
_TAKEN_AS_BASIC = (
    "neither file nor deck says the displacement systems of its points, taken as basic: leave field 7 of GRID empty"
)
_RUN_AGAIN = "let the solver print frequencies and displacements of all modes"


@dataclass(frozen=True, eq=False)
class MatricesOut:
    """Matrices as a run gives them.

    Attributes
    ----------
    matrices : mapping of str to MatrixFile
        Of ``stiffness``, ``mass`` and ``damping``, those that are there.
    numbering : str or tuple of Dof, optional
        What the rows stand for: a file of the run, or the degrees of freedom; the files say it themselves by default.
    """

    matrices: dict[str, MatrixFile]
    numbering: str | tuple[Dof, ...] | None = None

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the files in a run's folder that hold matrices or the numbering of their rows, each name once."""
        names = [file.path for file in self.matrices.values()]
        for name in tuple(names):
            path = Path(name)
            names += [str(path.with_suffix(suffix)) for suffix in _BESIDE.get(path.suffix.lower(), ())]
        names += [self.numbering] if isinstance(self.numbering, str) else []
        return tuple(dict.fromkeys(names))

    def require_whole(self, folder: Path) -> None:
        """Raise an `InputError` where a file is missing or cannot be read to its end."""
        self.read(folder)

    def read(self, folder: Path) -> dict[str, ImportedMatrix]:
        """The matrices in the folder of a run by kind (mass, ...), with node and component of each row.

        A numbering of the study or the run serves matrices whose files state none. `FileError` if a matrix is complex
        or not square, or nothing states its rows; `InputError` if a file is missing.
        """
        table = self._table(folder)
        matrices = {}
        for key, file in self.matrices.items():
            item = read_matrix(existing_file(folder, file.path), file.matrix)
            if not item.is_square or np.iscomplexobj(item.matrix.data):
                raise FileError(f"{file.path}: `{key}` must be a real square matrix, {item.name!r} is not")
            if table is None and item.dofs is None:
                raise FileError(
                    f"{file.path}: does not say what its rows stand for; give `dofs`: a file that the solver writes, or a list"
                )
            if table is not None and item.dofs is None:
                if len(table) != item.matrix.shape[0]:
                    raise FileError(
                        f"{file.path}: {item.name!r} has {item.matrix.shape[0]} rows and `dofs` names {len(table)}; correct"
                        " `dofs`"
                    )
                item = ImportedMatrix(item.name, item.matrix, table, constrained=item.constrained)
            matrices[key] = item
        return matrices

    def _table(self, folder: Path) -> IntArray | None:
        if self.numbering is None:
            return None
        return dof_table(
            read_numbering(existing_file(folder, self.numbering)) if isinstance(self.numbering, str) else self.numbering
        )


@dataclass(frozen=True, eq=False)
class OneFile(ABC):
    """Output of a run in one file, at `path` in its folder."""

    path: str

    @property
    def files(self) -> tuple[str, ...]:
        """Names of the files of a run that are kept: the one file that is read."""
        return (self.path,)

    @abstractmethod
    def read(self, folder: Path) -> object:
        """Content of the file; an `InputError` where it is missing, cut short, or lacks what is needed."""

    def require_whole(self, folder: Path) -> None:
        """Raise an `InputError` where the file cannot be used."""
        self.read(folder)


@dataclass(frozen=True, eq=False)
class RunDeck:
    """Deck of a run of Nastran, which tells along which axes points move.

    Attributes
    ----------
    name : str
        File in the folder of the run.
    linked : mapping of str to Path
        Further files of the deck by name, which may not be in that folder.
    """

    name: str
    linked: Mapping[str, Path]

    def axes(self, folder: Path, path: Path, nodes: IntArray, is_stated: bool = False) -> dict[int, FloatArray] | None:
        """Axes (3, 3), as rows in basic ones, of each node whose motion the file `path` prints along others, by label.

        None if there is no GRID, as where the bulk data are elsewhere. `is_stated`: PARAM,OUGCORD is passed over.
        `FileError` if the deck is damaged, lacks one of the `nodes` of the file, or asks for motions in a system that is
        neither the basic one nor those of the points.
        """
        return printed_axes(path, require_readable(folder / self.name), nodes, self.linked, is_stated)


@dataclass(frozen=True, eq=False)
class ModesOut(OneFile):
    """Modes as a run gives them: frequencies and shapes, those of Nastran turned to basic axes by the `deck` if there is one."""

    deck: RunDeck | None = None

    def read(self, folder: Path) -> RunModes:
        """The modes in the folder of a run; see `read_shapes`."""
        path = existing_file(folder, self.path)
        return read_shapes(path) if self.deck is None else read_shapes(path, partial(self.deck.axes, folder, path))


def existing_file(folder: Path, name: str) -> Path:
    """Path of the file `name` in the folder of a run.

    If it is missing, `InputError` names up to 12 files there that are not empty.
    """
    path = folder / name
    if not path.is_file():
        names = sorted(entry.name for entry in folder.iterdir() if entry.is_file() and entry.stat().st_size)
        raise InputError(f"it wrote no {name}, only {', '.join(names[:12])}")
    return path


@dataclass(frozen=True, eq=False)
class RunModes:
    """Modes of a run.

    Attributes
    ----------
    frequency : (n_modes,) float array
        Hz, ascending.
    dofs : (n_dofs, 2) int array
        Node and component (1 to 6) of each row.
    values : (n_dofs, n_modes) float array
        Mode shapes in the columns, with lengths in the unit of the solver.
    has_mass : bool
        Whether modal masses are 1 in the units of the solver; otherwise the scale of each shape is free.
    rounding : float
        Rounding of the numbers of shapes as printed, as a part of the size of a shape.
    notes : tuple of str
        What the file does not say, and how it was taken.
    """

    frequency: FloatArray
    dofs: IntArray
    values: FloatArray
    has_mass: bool
    rounding: float = 1e-9
    notes: tuple[str, ...] = ()


def read_shapes(
    path: Path, find_axes: Callable[[IntArray, bool], dict[int, FloatArray] | None] = lambda nodes, is_stated: None
) -> RunModes:
    """Frequencies in Hz, ascending, and real mode shapes in a file that a solver wrote, by node and component.

    Parameters
    ----------
    path : Path
        CalculiX ``.frd`` in text, Nastran or MYSTRAN ``.f06``, ``.pch`` or ``.op2``, or any file that
        `structid.modal.formats.files.read_modes` reads. Complex shapes in the latter are turned to be as real as can be,
        and their imaginary parts left out.
    find_axes : callable, optional
        Axes (3, 3), as rows in basic ones, of each of the nodes given whose motion Nastran prints along others; None if
        nothing tells them, which is the default. The second argument says whether the file itself states systems.

    Raises
    ------
    FileError
        If the file is missing, cut short, or holds no modes; if a mode is truly complex, or one of CalculiX, Nastran or
        MYSTRAN complex at all; if motions are printed in another coordinate system than the basic one, and no axes are known.
    """
    suffix = path.suffix.lower()
    if suffix not in (*FRD, *NASTRAN):
        return _shapes_of_modes_file(path)
    require_readable(path)
    with damage_told(path, "a file of modes", _RUN_AGAIN):
        printed = (frd_modes(path, path.read_text(encoding="latin-1")) if suffix in FRD else nastran_modes(path)).modes
    if not printed:
        raise FileError(f"{path}: holds no modes; {_RUN_AGAIN}")
    if any(np.iscomplexobj(mode.values) for mode in printed):
        raise FileError(f"{path}: holds complex modes; let the solver print real ones (SOL 103)")
    require_same_points(path, printed)
    systems, nodes = printed[0].systems, printed[0].nodes
    turned = np.flatnonzero(systems > 0)
    known = find_axes(nodes, len(turned) > 0) if suffix in NASTRAN and systems.any() else None
    if len(turned) and known is None:
        raise FileError(
            f"{path}: the motion of point {nodes[turned[0]]} is printed in coordinate system"
            f" {systems[turned[0]]}; let the deck give it in the basic system (field 7 of GRID)"
        )
    has_mass = all(mode.generalized_mass > 0 for mode in printed)
    values = np.stack([_mass_normalized(mode) for mode in printed], axis=2)
    width = 6 if np.isfinite(values[:, 3:]).all() else 3
    axes = known or {}
    rows = [row for row in np.flatnonzero(systems).tolist() if int(nodes[row]) in axes]  # 0: basic, as the file says
    for row in rows:
        for part in (slice(0, 3), slice(3, 6)):
            values[row, part] = axes[int(nodes[row])].T @ values[row, part]
    dofs = np.stack([np.repeat(nodes, width), np.tile(np.arange(1, width + 1), len(nodes))], axis=1)
    frequency = [mode.frequency for mode in printed]
    shapes = _sorted_shapes(path, frequency, dofs, values[:, :width].reshape(-1, len(printed)), has_mass, suffix)
    is_silent = suffix in NASTRAN and known is None and bool((systems < 0).any())
    return replace(shapes, notes=axes_notes(len(rows), is_silent))


def axes_notes(n_turned: int, is_silent: bool) -> tuple[str, ...]:
    """Words on motions of Nastran: how many points were turned, or, if `is_silent`, that nothing tells their axes."""
    if n_turned:
        return (f"motions of {plural(n_turned, 'point')} turned to basic axes by the deck",)
    return (_TAKEN_AS_BASIC,) if is_silent else ()


def _mass_normalized(mode: PrintedMode) -> FloatArray:
    """Motions of a mode scaled to a modal mass of 1, (n_points, 6); unchanged if the file prints no modal mass."""
    return np.real(mode.values) / (np.sqrt(mode.generalized_mass) if mode.generalized_mass > 0 else 1.0)


def require_last_line(path: Path) -> None:
    """Raise a `FileError` where a table ends within a line, as where the run that writes it was cut short."""
    if path.suffix.lower() == ".csv" and not path.read_bytes().endswith((b"\n", b"\r")):
        raise FileError(f"{path}: ends within a line; the file is cut short: end each line, the last one too")


def _shapes_of_modes_file(path: Path) -> RunModes:
    """Frequencies (Hz) and shapes, along positive directions, from a modes file of any format that structid reads.

    Complex shapes are turned to be as real as can be, and their imaginary parts left out. `FileError` if the file is cut
    short, a shape is zero, or one has parts of other phases, which matrices of mass and stiffness cannot give.
    """
    record = read_modes(path)
    require_last_line(path)
    collinearity = modal_phase_collinearity(record.mode_shapes.astype(np.complex128))
    is_complex = np.flatnonzero((collinearity < _LEAST_COLLINEARITY) & record.mode_shapes.any(axis=0))
    if len(is_complex):
        first = is_complex[0]
        raise FileError(
            f"{path}: mode {first + 1} at {record.frequency[first]:.6g} Hz is complex, with a phase collinearity of"
            f" {collinearity[first]:.2g}; let the solver print the real modes of mass and stiffness, without damping or rotation"
        )
    signs = np.array([dof.sign for dof in record.channels])
    dofs = np.array([(dof.node, DIRECTIONS.index(dof.direction) + 1) for dof in record.channels], dtype=np.int64)
    values = most_real(record.mode_shapes) * signs[:, None]
    return _sorted_shapes(path, record.frequency, dofs, values, record.scaling == "mass", "")


def _sorted_shapes(
    path: Path, frequency: Sequence[float] | FloatArray, dofs: IntArray, values: FloatArray, has_mass: bool, suffix: str
) -> RunModes:
    """Modes sorted by frequency (Hz), after checks; `dofs` (n_dofs, 2) are node and component (from 1).

    `values` (n_dofs, n_modes) are the shapes, in the order of `frequency`; `has_mass` says that they have unit modal
    mass; `suffix` is the file's suffix, which decides the rounding of its numbers ("" for the usual one). `FileError`
    if numbers of both differ, a number is not finite or a shape is zero.
    """
    frequencies = np.asarray(frequency, dtype=np.float64)
    if len(frequencies) != values.shape[1]:
        raise FileError(f"{path}: holds {len(frequencies)} frequencies and {values.shape[1]} shapes; {_RUN_AGAIN}")
    if not (np.isfinite(frequencies).all() and np.isfinite(values).all()):
        raise FileError(f"{path}: holds frequencies or shapes that are not finite; check the model, and {_RUN_AGAIN}")
    empty = np.flatnonzero(~values.any(axis=0))
    if len(empty):
        raise FileError(
            f"{path}: nothing moves in mode {empty[0] + 1}; the solver found no such mode: look into its log, ask for fewer modes"
        )
    order = np.argsort(frequencies, kind="stable")
    return RunModes(frequencies[order], dofs, values[:, order], has_mass, _ROUNDING.get(suffix, RunModes.rounding))


def require_same_dofs(first: RunModes, other: RunModes, words: str) -> None:
    """Raise `InputError` if the shapes of two runs have different nodes or components; `words` describe the run of `other`."""
    if not np.array_equal(first.dofs, other.dofs):
        raise InputError(
            f"the shapes of the run at {words} have {len(other.dofs)} degrees of freedom, those of the nominal run"
            f" {len(first.dofs)}, or others; keep the mesh, and mark numbers that do not renumber it"
        )
