"""Outputs of a solver in the folder of a run, and checks that they are complete."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from structid.core.arrays import IntArray
from structid.core.dof import Dof
from structid.core.errors import FileError, InputError
from structid.external.deck import MatrixFile
from structid.external.shapes import RunModes, read_shapes
from structid.fem.importers import ImportedMatrix, dof_table, read_matrix, read_numbering

#: Files that others are read with, by suffix.
_BESIDE = {".sti": (".dof",), ".mas": (".dof",)}


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

        `FileError` if a matrix is complex or not square, or nothing states its rows.
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
        """Files of a run that are kept."""
        return (self.path,)

    @abstractmethod
    def read(self, folder: Path) -> object:
        """Content of the file; an `InputError` where it is missing, cut short, or lacks what is needed."""

    def require_whole(self, folder: Path) -> None:
        """Raise an `InputError` where the file cannot be used."""
        self.read(folder)


@dataclass(frozen=True, eq=False)
class ModesOut(OneFile):
    """Modes as a run gives them: frequencies and shapes."""

    def read(self, folder: Path) -> RunModes:
        """The modes in the folder of a run; see `read_shapes`."""
        return read_shapes(existing_file(folder, self.path))


def existing_file(folder: Path, name: str) -> Path:
    """Path of the file `name` in the folder of a run; if it is missing, an `InputError` that lists the files there."""
    path = folder / name
    if not path.is_file():
        names = sorted(one.name for one in folder.iterdir() if one.is_file() and one.stat().st_size)
        raise InputError(f"it wrote no {name}, only {', '.join(names[:12])}")
    return path
