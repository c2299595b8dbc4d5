"""FRFs in the folder of a run: at the lines and channels that records have, complex and whole, or refused with what is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from structid.arrays import ComplexArray, FloatArray, IntArray
from structid.dof import Dof
from structid.errors import FileError
from structid.modal.files.nastran import PUNCH_SUFFIXES
from structid.records import FrfRecord, TimeRecord
from structid.records.io import read_record
from structid.shown import listed
from structid.solver.deck import FREQUENCIES
from structid.solver.frfs.punched import punched_frfs
from structid.solver.outputs import OneFile, there
from structid.solver.shapes import require_last_line
from structid.solver.solved import Units

#: Relative difference of frequencies that is rounding of a printed number.
_SAME_LINE = 1e-5
_MOST_TOLD = 6


@dataclass(frozen=True, eq=False)
class FrfsOut(OneFile):
    """FRFs as a run gives them.

    Attributes
    ----------
    path : str
        A file of FRFs as records are, or as Nastran punches them.
    frequency : (n_lines,) float array
        Lines that are needed, Hz.
    outputs, inputs : tuple of Dof
        Channels that are needed.
    loads : tuple of Dof
        What acts in each subcase of a punch file.
    units : Units
        Of a punch file.
    """

    frequency: FloatArray
    outputs: tuple[Dof, ...]
    inputs: tuple[Dof, ...]
    loads: tuple[Dof, ...] = ()
    units: Units = field(default_factory=Units)

    def read(self, folder: Path) -> ComplexArray:
        """Receptances of a run at the lines and channels that are needed, SI, (n_lines, n_outputs, n_inputs)."""
        path = there(folder, self.path)
        require_last_line(path)
        if path.suffix.lower() in PUNCH_SUFFIXES:
            record: FrfRecord | TimeRecord = punched_frfs(path, self.loads, self.units.length, self.units.force)
        else:
            record = read_record(path)
        if not isinstance(record, FrfRecord):
            raise FileError(f"{path}: holds time histories; let the solver write FRFs, real and imaginary parts")
        if record.is_per_motion:
            raise FileError(f"{path}: holds transmissibilities; let the solver write motion per force")
        if not record.values.any():
            raise FileError(f"{path}: every FRF is 0; look into the log of the solver, and whether the load acts")
        if not record.values.imag.any():
            raise FileError(
                f"{path}: the FRFs have no imaginary part: write real and imaginary parts in place of magnitudes, and give the"
                " model damping"
            )
        lines = self._lines(path, record.frequency)
        outputs, senses = _places(path, "sensor", self.outputs, record.outputs)
        inputs, ways = _places(path, "load", self.inputs, record.inputs)
        values = record.lines(lines).as_kind("receptance").values[:, outputs][:, :, inputs]
        return values * senses[:, None] * ways

    def _lines(self, path: Path, given: FloatArray) -> IntArray:
        """Where the lines that are needed are in the file."""
        after = np.clip(np.searchsorted(given, self.frequency), 1, max(len(given) - 1, 1))
        before = after - 1
        after = np.minimum(after, len(given) - 1)
        near = np.where(np.abs(given[before] - self.frequency) <= np.abs(given[after] - self.frequency), before, after)
        missing = self.frequency[np.abs(given[near] - self.frequency) > _SAME_LINE * self.frequency]
        if len(missing):
            told = listed([f"{line:.7g}" for line in missing], _MOST_TOLD)
            raise FileError(
                f"{path}: {len(missing)} of the {len(self.frequency)} lines of the record are missing, {told} Hz; FRFs are"
                f" not interpolated: let the solver compute the lines that {FREQUENCIES} beside the deck lists, or"
                " where the deck has {{frequency}}"
            )
        return near


def _places(path: Path, word: str, wanted: Sequence[Dof], own: Sequence[Dof]) -> tuple[IntArray, FloatArray]:
    """Where channels are in a file, and their sense against it."""
    known = {dof.unsigned: (k, dof.sign) for k, dof in enumerate(own)}
    missing = [str(dof.unsigned) for dof in wanted if dof.unsigned not in known]
    if missing:
        shown = ", ".join(str(dof) for dof in own[:_MOST_TOLD]) + (", ..." if len(own) > _MOST_TOLD else "")
        raise FileError(
            f"{path}: has no FRF of {word} {', '.join(missing[:_MOST_TOLD])}, which the record has; its {word}s are {shown}: let"
            " the solver write it under that node and direction, or choose by `channels_used` or `inputs` of [record]"
        )
    pairs = [(*known[dof.unsigned], dof.sign) for dof in wanted]
    return np.array([k for k, _, _ in pairs]), np.array([float(a * b) for _, a, b in pairs])
