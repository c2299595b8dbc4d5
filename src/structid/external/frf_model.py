"""FRFs that a solver computes: read from the folder of a run, and the model they give, linear in the parameters at each line."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.core.display import join_words
from structid.core.dof import DIRECTIONS, Dof
from structid.core.errors import FileError
from structid.core.units import FORCES, LENGTHS, FrfKind
from structid.external.deck import FREQUENCIES
from structid.external.expansion import Point
from structid.external.outputs import OneFile, RunDeck, axes_notes, existing_file, require_last_line
from structid.external.runs import Solver, needed_runs, run_words
from structid.external.solved import SolvedModel, SolverCheck, Units, model_parameters
from structid.external.steps import StepRules, take_differences
from structid.fem.elements.matrix_group import FrfRuns, SolverFrfs
from structid.inversion.search.work import TaskExecutor
from structid.modal.formats.options import PUNCH_SUFFIXES
from structid.modal.formats.printed import parse_numbers
from structid.records import FrfRecord, TimeRecord
from structid.records.formats import read_record

#: Relative difference of frequencies that is rounding of a printed number.
_SAME_LINE = 1e-5
_MOST_TOLD = 6
_KINDS: dict[str, FrfKind] = {
    "$DISPLACEMENTS": "receptance",
    "$VELOCITY": "mobility",
    "$ACCELERATION": "accelerance",
}
_HEADER = re.compile(r"^\$(SUBCASE ID|POINT ID|FREQUENCY)\s*=\s*([-+.\dEDed]+)")
_WIDTH, _CONTINUED, _LINES = 72, "-CONT-", 4
_RUN_AGAIN = "punch them as in DISPLACEMENT(PUNCH,REAL) = ALL"
#: Subcase, frequency, point and its six components, in the units of the deck.
Entry = tuple[int, float, int, ComplexArray]
#: FRFs bend where modes hardly do: a step of 0.002 moves a resonance by a thousandth of its frequency.
_RULES = StepRules(first=0.002, least=1e-4, most=0.3, no_effect=1e-6, what="FRF")


@dataclass(frozen=True, eq=False)
class FrfsOut(OneFile):
    """FRFs as a run gives them.

    Attributes
    ----------
    path : str
        Name of the file in the folder of a run: FRFs in a format of records, or punched by Nastran.
    frequency : (n_lines,) float array
        Lines that are needed, Hz.
    outputs, inputs : tuple of Dof
        Channels that are needed.
    loads : tuple of Dof
        Unit load that acts in each subcase of a punch file, in ascending order of subcases.
    units : Units
        Units of a punch file.
    deck : RunDeck, optional
        Turns the motions of a punch file to basic axes, where it is the bulk data of the run.
    """

    frequency: FloatArray
    outputs: tuple[Dof, ...]
    inputs: tuple[Dof, ...]
    loads: tuple[Dof, ...] = ()
    units: Units = field(default_factory=Units)
    deck: RunDeck | None = None

    def read(self, folder: Path) -> ComplexArray:
        """Receptances in the folder of a run at the needed lines and channels, m/N, (n_lines, n_outputs, n_inputs).

        They are along the positive directions. `FileError` if the file is cut short, holds no FRFs of motion per force
        or zeros alone, or lacks a line, a channel or the imaginary parts; if a needed load acts at a node of Nastran with
        axes of its own, along which a DAREA acts.
        """
        path = existing_file(folder, self.path)
        require_last_line(path)
        if path.suffix.lower() in PUNCH_SUFFIXES:
            punched = punched_frfs(path, self.loads, self.units.length, self.units.force)
            of_loads = self._axes(folder, punched, is_of_nodes=True) or {}
            if oblique := [dof for dof in self.inputs if dof.node in of_loads]:
                raise FileError(
                    f"{path}: load {oblique[0].unsigned} acts at node {oblique[0].node}, which has axes of its own (field 7 of"
                    " GRID), so that a DAREA does not act along basic ones; leave that field empty"
                )
            record: FrfRecord | TimeRecord = _in_basic_axes(punched, self._axes(folder, punched) or {})
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
        lines = self._line_indices(path, record.frequency)
        outputs, output_senses = _channel_indices(path, "sensor", self.outputs, record.outputs)
        inputs, input_senses = _channel_indices(path, "load", self.inputs, record.inputs)
        values = record.lines(lines).as_kind("receptance").values[:, outputs][:, :, inputs]
        return values * output_senses[:, None] * input_senses

    def notes(self, folder: Path) -> tuple[str, ...]:
        """Words on how FRFs of a punch file in the `folder` of a run were turned to basic axes; none for other files."""
        path = existing_file(folder, self.path)
        if path.suffix.lower() not in PUNCH_SUFFIXES:
            return ()
        punched = punched_frfs(path, self.loads, self.units.length, self.units.force)
        axes = self._axes(folder, punched)
        return axes_notes(len({dof.node for dof in punched.outputs} & set(axes or {})), axes is None)

    def _axes(self, folder: Path, punched: FrfRecord, is_of_nodes: bool = False) -> dict[int, FloatArray] | None:
        """Axes (3, 3), as rows in basic ones, of nodes of Nastran that move along others, by label; None without a GRID.

        `folder` is that of the run, `punched` the FRFs of its punch file. With `is_of_nodes` they are those that nodes
        have, also where the deck asks for motions along basic ones.
        """
        nodes = np.array([dof.node for dof in punched.outputs[::6]], dtype=np.int64)
        return None if self.deck is None else self.deck.axes(folder, folder / self.path, nodes, is_of_nodes)

    def _line_indices(self, path: Path, of_file: FloatArray) -> IntArray:
        """Index in `of_file`, the frequencies of the file `path` in Hz, of each needed line, (n_lines,).

        `FileError` if a line is missing: none in the file is within a relative distance of 1e-5.
        """
        after = np.clip(np.searchsorted(of_file, self.frequency), 1, max(len(of_file) - 1, 1))
        before = after - 1
        after = np.minimum(after, len(of_file) - 1)
        nearest = np.where(
            np.abs(of_file[before] - self.frequency) <= np.abs(of_file[after] - self.frequency), before, after
        )
        missing = self.frequency[np.abs(of_file[nearest] - self.frequency) > _SAME_LINE * self.frequency]
        if len(missing):
            text = join_words([f"{line:.7g}" for line in missing], _MOST_TOLD)
            raise FileError(
                f"{path}: {len(missing)} of the {len(self.frequency)} lines of the record are missing, {text} Hz; FRFs are"
                f" not interpolated: let the solver compute the lines that {FREQUENCIES} beside the deck lists, or"
                " where the deck has {{frequency}}"
            )
        return nearest


def _channel_indices(
    path: Path, word: str, channels: Sequence[Dof], file_channels: Sequence[Dof]
) -> tuple[IntArray, FloatArray]:
    """Index of each of `channels` among the channels of a file, and the sign into its sense, (n_channels,) each.

    The sign is 1 or -1. `file_channels` are those of the file at `path`; `word` is "sensor" or "load", for the
    `FileError` if a channel is missing.
    """
    index_and_sign = {dof.unsigned: (k, dof.sign) for k, dof in enumerate(file_channels)}
    missing = [str(dof.unsigned) for dof in channels if dof.unsigned not in index_and_sign]
    if missing:
        text = ", ".join(str(dof) for dof in file_channels[:_MOST_TOLD]) + (
            ", ..." if len(file_channels) > _MOST_TOLD else ""
        )
        raise FileError(
            f"{path}: has no FRF of {word} {', '.join(missing[:_MOST_TOLD])}, which the record has; its {word}s are {text}: let"
            " the solver write it under that node and direction, or choose by `channels_used` or `inputs` of [record]"
        )
    pairs = [(*index_and_sign[dof.unsigned], dof.sign) for dof in channels]
    return np.array([k for k, _, _ in pairs]), np.array([float(a * b) for _, a, b in pairs])


def punched_frfs(path: Path, loads: Sequence[Dof], length: str, force: str) -> FrfRecord:
    """The FRFs in a punch file of Nastran, in SI units; outputs are all six components of each node, by ascending node.

    The kind is that of the motions in the file: receptance, mobility or accelerance, the first of these that is there.

    Parameters
    ----------
    path : Path
        The punch file.
    loads : sequence of Dof
        The unit load of each subcase, in ascending order of subcases.
    length, force : str
        Units of the deck, such as ``mm`` and ``N``.

    Raises
    ------
    FileError
        If there are none, the file is cut short, or subcases are not as many as loads.
    """
    lines = path.read_text(encoding="latin-1").splitlines()
    kind = next((kind for title, kind in _KINDS.items() if any(line.startswith(title) for line in lines)), None)
    if kind is None:
        raise FileError(f"{path}: holds no displacements, velocities or accelerations; {_RUN_AGAIN}")
    table = {(case, frequency, node): values for case, frequency, node, values in _read_entries(path, lines, kind)}
    cases, frequency, nodes = (sorted({*keys}) for keys in zip(*table, strict=True)) if table else ([], [], [])
    if not table:
        raise FileError(f"{path}: holds no motions of grid points; {_RUN_AGAIN}")
    if len(table) != len(cases) * len(frequency) * len(nodes):
        raise FileError(
            f"{path}: points or frequencies are missing in a part of it; the file is cut short, {_RUN_AGAIN}"
        )
    if len(cases) != len(loads):
        raise FileError(
            f"{path}: holds {len(cases)} subcases, and `loads` names {len(loads)}; name what acts in each, in their order"
        )
    outputs = [Dof(int(node), direction) for node in nodes for direction in DIRECTIONS]
    values = np.array([[np.concatenate([table[case, f, node] for node in nodes]) for case in cases] for f in frequency])
    motion = np.array([1.0 if dof.is_rotation else LENGTHS[length] for dof in outputs])
    acting = np.array([dof.sign * FORCES[force] * (LENGTHS[length] if dof.is_rotation else 1.0) for dof in loads])
    scaled = np.moveaxis(values, 1, 2) * motion[:, None] / acting
    return FrfRecord(frequency, scaled, outputs, [dof.unsigned for dof in loads], kind)


def _in_basic_axes(record: FrfRecord, axes: Mapping[int, FloatArray]) -> FrfRecord:
    """FRFs of all six components of each node turned from its `axes` (3, 3), as rows in basic ones, to basic axes.

    Nodes without axes move along the basic ones already.
    """
    values = record.values.copy()
    for start in range(0, len(record.outputs), 3):
        turn = axes.get(record.outputs[start].node)
        if turn is not None:
            values[:, start : start + 3] = np.einsum("ji,fjk->fik", turn, values[:, start : start + 3])
    return replace(record, values=values)


def _read_entries(path: Path, lines: Sequence[str], motion_kind: FrfKind) -> Iterator[Entry]:
    """Subcase (1 by default), frequency in Hz, node and complex motion (6,) of each grid point in the lines of a punch file.

    Only motions of the kind `motion_kind` are read, others and scalar points skipped; magnitudes and phases (deg) become complex.
    `FileError` if the motions are real, or a point is incomplete.
    """
    kind: FrfKind | None = None
    header: dict[str, str] = {}
    is_polar, last_line = False, 0
    rows: list[list[str]] = []
    for line_number, line in enumerate(lines, 1):
        if line.startswith("$"):
            title = line[:_WIDTH].split()[0]
            match = _HEADER.match(line)
            if title == "$TITLE" or title in _KINDS:
                kind, header = None if "(SOLUTION" in line else _KINDS.get(title), {}
            elif line.startswith("$REAL OUTPUT") and kind == motion_kind:
                raise FileError(
                    f"{path}, line {line_number}: holds real motions; write real and imaginary parts: {_RUN_AGAIN}"
                )
            elif "OUTPUT" in line:
                is_polar = line.startswith("$MAGNITUDE-PHASE")
            elif match:
                header[match[1]] = match[2]
            continue
        if kind != motion_kind or not ("FREQUENCY" in header or "POINT ID" in header):
            continue
        words = line[:_WIDTH].split()
        if (words[:1] == [_CONTINUED]) != bool(rows) or len(words) != (4 if rows else 5):
            raise FileError(
                f"{path}, line {line_number}: is not part of a motion of a point; the file is damaged, {_RUN_AGAIN}"
            )
        rows.append(words)
        last_line = line_number
        if len(rows) == _LINES:
            first, words_of_values = rows[0][0], [*rows[0][2:], *(word for row in rows[1:] for word in row[1:])]
            frequency, node = (header["FREQUENCY"], first) if "FREQUENCY" in header else (first, header["POINT ID"])
            parts = parse_numbers(path, words_of_values).reshape(2, 6)
            values = parts[0] * np.exp(1j * np.radians(parts[1])) if is_polar else parts[0] + 1j * parts[1]
            if rows[0][1] == "G":
                yield int(header.get("SUBCASE ID", "1")), float(frequency.replace("D", "E")), int(node), values
            rows = []
    if rows:
        raise FileError(f"{path}, line {last_line}: ends within a point; the file is cut short, {_RUN_AGAIN}")


@dataclass(frozen=True, eq=False)
class SolvedFrfs(SolvedModel):
    """Model from the FRFs that a solver gives.

    Attributes
    ----------
    out : FrfsOut
    """

    model: SolverFrfs
    out: FrfsOut

    @property
    def is_exact(self) -> bool:
        return False

    def run_at(self, values: Point, work: TaskExecutor) -> FrfRuns:
        """FRFs of a solver run at `values` (by name) alone, without differences by the parameters.

        Raises
        ------
        InputError
            If the run fails.
        """
        [folder], _ = needed_runs(self.solver, [values], work)
        table = self.model.table
        return replace(
            table,
            centre=self.out.read(folder),
            runs=np.zeros((0, 2, *table.centre.shape)),
            changes=np.zeros((0, 2)),
            at={},
        )

    def checked(self, values: Point, work: TaskExecutor) -> SolverCheck:
        """Largest error of the model's FRFs against a solver run at `values` (by name), with a sentence.

        Errors are parts of the largest value of each FRF over its lines. `work` runs the solver, unless this run is
        kept already; `InputError` if it fails.
        """
        of_solver = self.run_at(values, work).centre
        of_model, _ = self.model.table.evaluated(np.array([values[name] for name in self.model.table.at]))
        worst = float((np.abs(of_model - of_solver).max(axis=0) / np.abs(of_solver).max(axis=0)).max())
        return SolverCheck(
            worst,
            f"the solver with the updated deck gives the model's FRFs to {worst:.2g} of the largest value of each",
        )


def solved_frfs(name: str, solver: Solver, out: FrfsOut, units: Units, work: TaskExecutor) -> SolvedFrfs:
    """A model with the FRFs of a solver, linearized by finite differences about the centre of each parameter.

    Parameters
    ----------
    name : str
        Name of the model in its structure.
    solver : Solver
        Deck, command and folder of the runs.
    out : FrfsOut
        Reads the needed FRFs in the folder of a run.
    units : Units
        Units of the deck.
    work : TaskExecutor
        Executor of the runs.

    Raises
    ------
    InputError
        If a run fails, or a parameter changes no FRF.
    """
    out = replace(out, deck=RunDeck(solver.deck.main, solver.linked))
    solver = replace(solver, outputs=out)
    steps = take_differences(solver, out.read, _change, _RULES, work)
    pairs = {pair.name: pair for pair in steps.pairs}
    names = solver.deck.names
    runs = FrfRuns(
        out.frequency,
        out.outputs,
        out.inputs,
        steps.centre,
        {name: steps.at[name] for name in names},
        np.array([pairs[name].changes for name in names]),
        np.array([pairs[name].runs for name in names]),
    )
    frfs = SolverFrfs(name, runs, model_parameters(solver, steps.references))
    fact = (
        f"solver: {run_words(steps.counts)}; {len(out.frequency)} lines from {out.frequency[0]:.5g} to {out.frequency[-1]:.5g} Hz,"
        f" {len(out.outputs)} x {len(out.inputs)} FRFs; {steps.words}"
    )
    [at_centre], _ = needed_runs(solver, [steps.at], work)
    facts = (fact, *out.notes(at_centre))
    return SolvedFrfs(solver, frfs, (), (), steps.counts, facts, steps.at, units, out)


def _change(centre: ComplexArray, run: ComplexArray, point: Point) -> float:
    """Relative change of the FRFs (n_lines, n_outputs, n_inputs) from `centre` to `run`: root mean square over all values.

    A change above 1 counts as 1; values that are 0 at the centre, and `point`, do not count.
    """
    size = np.abs(centre)
    there = size > 0
    return float(np.sqrt(np.mean(np.minimum(np.abs(run - centre)[there] / size[there], 1.0) ** 2)))
