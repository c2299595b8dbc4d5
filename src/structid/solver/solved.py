"""A structure's part that comes from a solver: runs made, their numbers brought to SI, and a model of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.linalg import eigh

from structid.arrays import FloatArray
from structid.dof import Dof
from structid.errors import InputError
from structid.estimation.search.work import Work
from structid.solver.deck import DeckParameter
from structid.solver.expansion import Expansion, Point, expansion
from structid.solver.model import ModelParameter, Part, SolverModel
from structid.solver.outputs import MatricesOut, ModesOut
from structid.solver.runs import RunCounts, RunFailedError, Solver, runs
from structid.solver.shapes import Shapes, require_same_dofs
from structid.solver.tangent import Differences, ShapeTie, tangent
from structid.structure.importers import ImportedMatrix, dof_table, dofs_of, in_si, on_dofs
from structid.structure.importers.definite import require_semidefinite
from structid.structure.importers.exports import FORCES, LENGTHS
from structid.structure.importers.imported import codes_of, tables_of

#: First step of differences of modes, as a part of the value.
STEP = 0.01
#: Relative changes of frequencies that steps should make; those outside are made larger or smaller, so many times.
_LEAST_CHANGE, _MOST_CHANGE, _TRIALS = 1e-5, 0.1, 4
_LARGEST_STEP = 0.3
_NO_EFFECT = 2e-7


@dataclass(frozen=True)
class Units:
    """Of what a solver gives; time is in seconds.

    Attributes
    ----------
    length, force : str
    """

    length: str = "m"
    force: str = "N"

    @property
    def mass(self) -> float:
        """kg."""
        return FORCES[self.force] / LENGTHS[self.length]


@dataclass(frozen=True)
class Checked:
    """The solver run once more, beside the model of it.

    Attributes
    ----------
    difference : float
        Largest relative difference: of frequencies, or of entries of matrices to their diagonals.
    words : str
    """

    difference: float
    words: str


@dataclass(frozen=True, eq=False)
class Solved(ABC):
    """What the runs of a solver gave.

    Attributes
    ----------
    solver : Solver
    model : SolverModel
        The element set.
    ties : tuple of ShapeTie
    held : tuple of Dof
    counts : RunCounts
    facts : tuple of str
        What was found, for the reader.
    at : mapping of str to float
        Values of the run that it is made about.
    units : Units
    """

    solver: Solver
    model: SolverModel
    ties: tuple[ShapeTie, ...]
    held: tuple[Dof, ...]
    counts: RunCounts
    facts: tuple[str, ...]
    at: Mapping[str, float]
    units: Units

    @property
    def nodes(self) -> tuple[int, ...]:
        """Labels of all nodes of the solver."""
        own = [dof.node for dof in (*self.model.dofs, *self.held)]
        return tuple(sorted({*own, *(dof.node for tie in self.ties for dof in tie.dependents)}))

    @property
    @abstractmethod
    def is_exact(self) -> bool:
        """Whether it holds at all values; else it is to be made again about the answer."""

    @abstractmethod
    def checked(self, values: Point, work: Work) -> Checked:
        """The solver run with `values`, beside the model.

        Raises
        ------
        InputError
            If the run fails.
        """


@dataclass(frozen=True, eq=False)
class SolvedMatrices(Solved):
    """Of exported matrices.

    Attributes
    ----------
    out : MatricesOut
    """

    out: MatricesOut

    @property
    def is_exact(self) -> bool:
        return True

    def checked(self, values: Point, work: Work) -> Checked:
        [folder], _ = _runs(self.solver, [values], work)
        worst = 0.0
        for key, item in self.out.read(folder).items():
            given = in_si(
                on_dofs(item, dof_table(self.model.dofs)), self.model.dofs, self.units.length, self.units.force
            )
            size = np.sqrt(np.abs(given.diagonal())) + 1e-300
            rest = sparse.coo_array(given - self.model.matrix(key, values))
            worst = max(worst, float((np.abs(rest.data) / (size[rest.row] * size[rest.col])).max(initial=0.0)))
        return Checked(
            worst, f"the solver with the updated deck gives the model's matrices to {worst:.2g} of their diagonals"
        )


@dataclass(frozen=True, eq=False)
class SolvedModes(Solved):
    """Of modes.

    Attributes
    ----------
    out : ModesOut
    n_modes : int
        Modes that the model has.
    """

    out: ModesOut
    n_modes: int

    @property
    def is_exact(self) -> bool:
        return False

    def checked(self, values: Point, work: Work) -> Checked:
        [folder], _ = _runs(self.solver, [values], work)
        given = self.out.read(folder).frequency[: self.n_modes]
        squared = eigh(*(self.model.matrix(key, values).toarray() for key in ("stiffness", "mass")), eigvals_only=True)
        own = np.sqrt(np.maximum(squared[: len(given)], 0.0)) / (2 * np.pi)
        moves = given > 1e-3 * given.max()
        worst = float(np.abs(own[moves] / given[moves] - 1).max())
        return Checked(
            worst, f"the solver with the updated deck gives the model's frequencies to {worst:.2g} of their value"
        )


def solved_matrices(
    name: str, solver: Solver, out: MatricesOut, units: Units, work: Work, indefinite: bool = False
) -> SolvedMatrices:
    """The model of exported matrices, polynomials in the parameters: exact, with no further run.

    Unless `indefinite`, they must be positive semidefinite.

    Raises
    ------
    InputError
        If a run fails, gives matrices of another size than the first, or no polynomial of low order verifies.
    """
    counts = RunCounts()
    pattern: list[_Pattern] = []
    known: dict[Path, Mapping[str, ImportedMatrix]] = {}

    def evaluate(points: Sequence[Point]) -> tuple[FloatArray, FloatArray]:
        nonlocal counts
        folders, made = _runs(solver, points, work)
        counts = RunCounts(0, counts.made + made.made)
        known.update((folder, out.read(folder)) for folder in folders if folder not in known)
        tables = [known[folder] for folder in folders]
        pattern[:] = [_pattern(tables, [_shown(point) for point in points])]
        return pattern[0].rows(tables)

    found = expansion(evaluate, solver.deck)
    [own] = pattern
    dofs = dofs_of(tables_of(own.codes))
    rows = {powers: own.matrices(row) for powers, row in found.coefficients.items()}
    parts = [
        Part(key, powers, in_si(matrix, dofs, units.length, units.force))
        for powers, matrices in rows.items()
        for key, matrix in matrices.items()
        if matrix.nnz
    ]
    nominal = own.matrices(found.at(solver.deck.nominal))
    for key, matrix in nominal.items() if not indefinite else ():
        require_semidefinite(f"{key} of the solver", in_si(matrix, dofs, units.length, units.force), dofs)
    held = {dof for item in next(iter(known.values())).values() if item.held is not None for dof in dofs_of(item.held)}
    model = SolverModel(name, dofs, tuple(parts), _parameters(solver, found.references))
    at = solver.deck.nominal
    counts = replace(counts, kept=found.n_points - counts.made)
    facts = _matrix_facts(found, own, counts)
    return SolvedMatrices(solver, model, (), tuple(sorted(held & set(dofs))), counts, facts, at, units, out)


def solved_modes(name: str, solver: Solver, out: ModesOut, units: Units, work: Work) -> SolvedModes:
    """The model of modes about the centre of each parameter, from differences.

    Raises
    ------
    InputError
        If a run fails, gives other nodes than the first, or a parameter changes no frequency.
    """
    centre = solver.deck.shown({one.name: one.centre for one in solver.deck.parameters})
    folders, counts = _runs(solver, [centre], work)
    at = out.read(folders[0])
    pending = {one.name: _Step(one, centre[one.name]) for one in solver.deck.parameters}
    done: dict[str, Differences] = {}
    for _ in range(_TRIALS):
        asked = [(key, centre | {key: value}) for key, step in pending.items() for value in step.values(solver, centre)]
        given, more = runs(solver, [point for _, point in asked], work)
        counts = counts + more
        for key, step in list(pending.items()):
            own = [(p, g) for (k, p), g in zip(asked, given, strict=True) if k == key]
            errors = [g for _, g in own if isinstance(g, RunFailedError)]
            if errors and not step.can_shrink:
                raise errors[0]
            if errors:
                step.shrink()
                continue
            shapes = tuple(out.read(folder) for _, folder in own if isinstance(folder, Path))
            for (point, _), run in zip(own, shapes, strict=True):
                require_same_dofs(at, run, _shown(point))
            changes = tuple(point[key] - centre[key] for point, _ in own)
            if step.settles(_change(at, shapes)):
                done[key] = Differences(key, changes, shapes)
                del pending[key]
        if not pending:
            break
    else:
        raise InputError(f"no step of {', '.join(pending)} gives differences that can be used; give `step`")
    turned = [replace(d, runs=tuple(_shapes_in_si(r, units) for r in d.runs)) for d in done.values()]
    small = tangent(f"shapes of {name}", _shapes_in_si(at, units), turned)
    references = {one.name: centre[one.name] or 1.0 for one in solver.deck.parameters}
    parts = []
    for key, table in (("mass", small.mass), ("stiffness", small.stiffness)):
        constant = table[""] - sum(table[n] * centre[n] for n in done)
        parts.append(Part(key, (), sparse.csc_array(constant)))
        parts += [Part(key, ((n, 1),), sparse.csc_array(table[n] * references[n])) for n in done if table[n].any()]
    model = SolverModel(name, small.masters, tuple(parts), _parameters(solver, references), reduced=True)
    frequency = ", ".join(f"{f:.5g}" for f in at.frequency[: small.n_modes])
    fact = (
        f"solver: {_counted(counts)}; modes at {frequency} Hz, {len(at.dofs)} degrees of freedom; differences about"
        f" {_shown(centre)} with steps {', '.join(f'{n} {max(map(abs, d.changes)):.2g}' for n, d in done.items())}"
    )
    ties = (small.tie,) if small.tie.dependents else ()
    return SolvedModes(solver, model, ties, small.held, counts, (fact,), centre, units, out, small.n_modes)


def _runs(solver: Solver, points: Sequence[Point], work: Work) -> tuple[list[Path], RunCounts]:
    """Folders of runs that must all succeed."""
    found, counts = runs(solver, points, work)
    folders = []
    for one in found:
        if isinstance(one, RunFailedError):
            kept = sum(isinstance(other, Path) for other in found)
            raise RunFailedError(
                f"{one}; deck and log of it are in {solver.folder / 'failed'}, {kept} finished runs are kept in {solver.folder}"
            )
        folders.append(one)
    return folders, counts


def _parameters(solver: Solver, references: Mapping[str, float]) -> tuple[ModelParameter, ...]:
    nominal = solver.deck.nominal
    return tuple(ModelParameter(p.name, p.unit, nominal[p.name], references[p.name]) for p in solver.deck.parameters)


def _shown(point: Mapping[str, float]) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in point.items())


def _counted(counts: RunCounts) -> str:
    return f"{counts.kept + counts.made} runs, {counts.kept} of them kept from before"


def _matrix_facts(found: Expansion, pattern: _Pattern, counts: RunCounts) -> tuple[str, ...]:
    words = {1: "linear", 2: "quadratic", 3: "cubic", 4: "of fourth order"}
    orders = ", ".join(f"{words[order]} in {name}" for name, order in found.orders.items())
    crossed = "".join(f", with products of {a} and {b}" for a, b in found.crossed)
    return (
        f"solver: {_counted(counts)}; matrices of {len(pattern.codes)} degrees of freedom are {orders}{crossed}, verified to"
        f" {found.error:.1g} of their size",
    )


@dataclass(frozen=True, eq=False)
class _Pattern:
    """Where the matrices of all runs have entries.

    Attributes
    ----------
    codes : (n_dofs,) int array
        Of node and component.
    places : mapping of str to (n_entries,) int array
        Column times n_dofs plus row, by the kind of matrix.
    """

    codes: np.ndarray
    places: Mapping[str, np.ndarray]

    def rows(self, tables: Sequence[Mapping[str, ImportedMatrix]]) -> tuple[FloatArray, FloatArray]:
        """The entries of each run, (n_runs, n_entries), and the size that each is measured by."""
        found = np.array([np.concatenate([self._entries(key, table[key]) for key in self.places]) for table in tables])
        sizes = []
        at, n = 0, len(self.codes)
        for places in self.places.values():
            row, column = places % n, places // n
            diagonal = np.zeros(n)
            own = found[:, at : at + len(places)]
            same = row == column
            diagonal[row[same]] = np.abs(own[:, same]).max(axis=0)
            sizes.append(np.sqrt(diagonal[row] * diagonal[column]) + 1e-12 * diagonal.max(initial=1e-300))
            at += len(places)
        return found, np.concatenate(sizes)

    def matrices(self, row: FloatArray) -> dict[str, sparse.csc_array]:
        """The matrices with these entries."""
        found, at, n = {}, 0, len(self.codes)
        for key, places in self.places.items():
            own = row[at : at + len(places)]
            kept = own != 0
            table = (own[kept], (places[kept] % n, places[kept] // n))
            matrix = sparse.coo_array(table, (n, n)).tocsc()
            found[key] = sparse.csc_array((matrix + matrix.T) / 2)
            at += len(places)
        return found

    def _entries(self, key: str, item: ImportedMatrix) -> FloatArray:
        values = np.zeros(len(self.places[key]))
        places, data = _placed(self.codes, item)
        values[np.searchsorted(self.places[key], places)] = data
        return values


def _placed(codes: np.ndarray, item: ImportedMatrix) -> tuple[np.ndarray, FloatArray]:
    assert item.dofs is not None
    own = np.searchsorted(codes, codes_of(item.dofs))
    table = item.matrix.tocoo()
    return own[table.col].astype(np.int64) * len(codes) + own[table.row], table.data


def _pattern(tables: Sequence[Mapping[str, ImportedMatrix]], words: Sequence[str]) -> _Pattern:
    """The pattern of all runs, which must have the degrees of freedom of the first."""
    codes: dict[str, np.ndarray] = {}
    for table, at in zip(tables, words, strict=True):
        for key, item in table.items():
            assert item.dofs is not None
            own = np.sort(codes_of(item.dofs))
            first = codes.setdefault(key, own)
            if not np.array_equal(own, first):
                raise InputError(
                    f"the {key} of the run at {at} has {len(own)} rows, that of the first run {len(first)}, or others; keep mesh"
                    " and supports as they are, and mark numbers that change neither"
                )
    every = np.unique(np.concatenate(list(codes.values())))
    places = {key: np.unique(np.concatenate([_placed(every, table[key])[0] for table in tables])) for key in codes}
    return _Pattern(every, places)


class _Step:
    """The step of one parameter's differences, on the way to one that can be used."""

    def __init__(self, parameter: DeckParameter, centre: float) -> None:
        self.parameter, self.centre = parameter, centre
        relative = STEP if parameter.step is None else parameter.step
        if not centre and parameter.step is None:
            raise InputError(f"parameter {parameter.name!r} is 0; give `step`, by how much it changes, in its unit")
        self.unit = abs(centre) or 1.0
        self.part = relative
        self.tried: set[float] = set()

    @property
    def can_shrink(self) -> bool:
        return self.part > 1e-4 and len(self.tried) < _TRIALS

    def values(self, solver: Solver, centre: Mapping[str, float]) -> list[float]:
        """On both sides of the centre; twice on one, where a bound is near."""
        self.tried.add(self.part)
        low, high = self.parameter.limits
        size = self.part * self.unit
        room_above, room_below = high - self.centre, self.centre - low
        if min(room_above, room_below) < size:
            sense = 1.0 if room_above > room_below else -1.0
            size = min(size, max(room_above, room_below) / 2)
            values = [self.centre + sense * size, self.centre + 2 * sense * size]
        else:
            values = [self.centre + size, self.centre - size]
        shown = [solver.deck.shown({**centre, self.parameter.name: v})[self.parameter.name] for v in values]
        if len({*shown, self.centre}) < 3:
            raise InputError(
                f"a step of {size:g} of {self.parameter.name!r} does not show in the digits of its mark; widen it, as in"
                f" {{{{{self.parameter.name}:16}}}}, or give `step`"
            )
        return shown

    def shrink(self) -> None:
        self.part /= 4

    def settles(self, change: float) -> bool:
        """Whether differences with this relative change of the frequencies can be used; the next step where not."""
        if change > _MOST_CHANGE and self.part > 1e-4 and self.part / 4 not in self.tried:
            self.shrink()
            return False
        if change < _LEAST_CHANGE and self.part < _LARGEST_STEP:
            self.part = min(10 * self.part, _LARGEST_STEP)
            return self.part in self.tried
        if change < _NO_EFFECT:
            raise InputError(
                f"parameter {self.parameter.name!r} has no effect: no frequency changes by more than {change:.1g} of its value"
                f" where it changes by {self.part:.2g}; look for the mark in a part of the deck that is not used, or take the"
                " parameter out"
            )
        return True


def _change(centre: Shapes, runs: Sequence[Shapes]) -> float:
    """Largest relative change of a frequency; of those that are no rigid motion."""
    largest = 0.0
    for run in runs:
        n = min(len(run.frequency), len(centre.frequency))
        first = centre.frequency[:n]
        moves = first > 1e-3 * first.max(initial=0.0)
        largest = max(
            largest, float(np.abs(run.frequency[:n] / np.where(moves, first, 1.0) - 1)[moves].max(initial=0.0))
        )
    return largest


def _shapes_in_si(shapes: Shapes, units: Units) -> Shapes:
    """Mass-normalized shapes in kg^-1/2 (translations)."""
    rotation = shapes.dofs[:, 1] > 3
    scale = np.where(rotation, 1.0 / LENGTHS[units.length], 1.0) / np.sqrt(units.mass)
    return replace(shapes, values=shapes.values * scale[:, None])
