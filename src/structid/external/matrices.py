"""A model of exported matrices: polynomials in the deck's parameters, which then need the solver no more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy import sparse

from structid.core.arrays import FloatArray
from structid.core.errors import InputError
from structid.external.expansion import Expansion, Point, expansion
from structid.external.model import Part, SolverModel
from structid.external.outputs import MatricesOut
from structid.external.runs import RunCounts, Solver, needed_runs, point_words, run_words
from structid.external.solved import Checked, Solved, Units, model_parameters
from structid.fem.importers import ImportedMatrix, dof_table, dofs_of, in_si, on_dofs
from structid.fem.importers.definite import require_semidefinite
from structid.fem.importers.imported import codes_of, tables_of
from structid.inversion.search.work import Work


@dataclass(frozen=True, eq=False)
class SolvedMatrices(Solved):
    """Of exported matrices.

    Attributes
    ----------
    out : MatricesOut
    """

    model: SolverModel
    out: MatricesOut

    @property
    def is_exact(self) -> bool:
        return True

    def checked(self, values: Point, work: Work) -> Checked:
        [folder], _ = needed_runs(self.solver, [values], work)
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
    pattern = _Pattern()
    known: dict[Path, Mapping[str, ImportedMatrix]] = {}

    def evaluate(points: Sequence[Point]) -> tuple[FloatArray, FloatArray]:
        nonlocal counts, pattern
        folders, made = needed_runs(solver, points, work)
        counts = RunCounts(0, counts.made + made.made)
        for folder, point in zip(folders, points, strict=True):
            if folder not in known:
                known[folder] = out.read(folder)
                pattern = pattern.with_run(known[folder], point_words(point))
        return pattern.rows([known[folder] for folder in folders])

    found = expansion(evaluate, solver.deck)
    dofs = dofs_of(tables_of(pattern.codes))
    rows = {powers: pattern.matrices(row) for powers, row in found.coefficients.items()}
    parts = [
        Part(key, powers, in_si(matrix, dofs, units.length, units.force))
        for powers, matrices in rows.items()
        for key, matrix in matrices.items()
        if matrix.nnz
    ]
    nominal = pattern.matrices(found.at(solver.deck.nominal))
    for key, matrix in nominal.items() if not indefinite else ():
        require_semidefinite(f"{key} of the solver", in_si(matrix, dofs, units.length, units.force), dofs)
    held = {dof for item in next(iter(known.values())).values() if item.held is not None for dof in dofs_of(item.held)}
    model = SolverModel(name, dofs, tuple(parts), model_parameters(solver, found.references))
    at = solver.deck.nominal
    counts = replace(counts, kept=found.n_points - counts.made)
    facts = _matrix_facts(found, pattern, counts)
    return SolvedMatrices(solver, model, (), tuple(sorted(held & set(dofs))), counts, facts, at, units, out)


def _matrix_facts(found: Expansion, pattern: _Pattern, counts: RunCounts) -> tuple[str, ...]:
    words = {1: "linear", 2: "quadratic", 3: "cubic", 4: "of fourth order"}
    orders = ", ".join(f"{words[order]} in {name}" for name, order in found.orders.items())
    crossed = "".join(f", with products of {a} and {b}" for a, b in found.crossed)
    return (
        f"solver: {run_words(counts)}; matrices of {len(pattern.codes)} degrees of freedom are {orders}{crossed}, verified to"
        f" {found.error:.1g} of their size",
    )


@dataclass(frozen=True, eq=False)
class _Pattern:
    """Where the matrices of the runs so far have entries: solvers leave out those that cancel, one run here, another there.

    Attributes
    ----------
    own : mapping of str to int array
        Codes of node and component of each kind of matrix, sorted.
    codes : (n_dofs,) int array
        Of all kinds.
    places : (n_entries,) int array
        (Number of the kind times n_dofs plus column) times n_dofs plus row; what a further run adds is at the end.
    """

    own: Mapping[str, np.ndarray] = field(default_factory=dict)
    codes: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    places: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def with_run(self, table: Mapping[str, ImportedMatrix], words: str) -> _Pattern:
        """With the entries of a run at `words`, which must have the degrees of freedom of the first."""
        own = {key: np.sort(codes_of(item.dofs)) for key, item in table.items() if item.dofs is not None}
        first = self.own or own
        for key, codes in own.items():
            if not np.array_equal(codes, first[key]):
                raise InputError(
                    f"the {key} of the run at {words} has {len(codes)} rows, that of the first run {len(first[key])}, or others;"
                    " keep mesh and supports as they are, and mark numbers that change neither"
                )
        pattern = replace(self, own=first, codes=np.unique(np.concatenate(list(first.values()))))
        new = np.setdiff1d(pattern._entries(table)[0], self.places)
        return replace(pattern, places=np.concatenate([self.places, new]))

    def rows(self, tables: Sequence[Mapping[str, ImportedMatrix]]) -> tuple[FloatArray, FloatArray]:
        """The entries of each run, (n_runs, n_entries), and the size that each is measured by."""
        found = np.zeros((len(tables), len(self.places)))
        order = np.argsort(self.places)
        for row, table in zip(found, tables, strict=True):
            places, data = self._entries(table)
            row[order[np.searchsorted(self.places, places, sorter=order)]] = data
        kind, column, row_of = self._at()
        same = row_of == column
        diagonal = np.zeros((len(self.own), len(self.codes)))
        diagonal[kind[same], column[same]] = np.abs(found[:, same]).max(axis=0)
        largest = diagonal.max(axis=1, initial=1e-300)
        return found, np.sqrt(diagonal[kind, row_of] * diagonal[kind, column]) + 1e-12 * largest[kind]

    def matrices(self, row: FloatArray) -> dict[str, sparse.csc_array]:
        """The matrices with these entries."""
        found, n = {}, len(self.codes)
        kind, column, row_of = self._at()
        for number, key in enumerate(self.own):
            kept = (kind == number) & (row != 0)
            matrix = sparse.coo_array((row[kept], (row_of[kept], column[kept])), (n, n)).tocsc()
            found[key] = sparse.csc_array((matrix + matrix.T) / 2)
        return found

    def _at(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Number of the kind, column and row of each place."""
        rest, row = np.divmod(self.places, len(self.codes))
        kind, column = np.divmod(rest, len(self.codes))
        return kind, column, row

    def _entries(self, table: Mapping[str, ImportedMatrix]) -> tuple[np.ndarray, FloatArray]:
        """Places and values of one run's entries."""
        places, values = [], []
        for number, key in enumerate(self.own):
            item = table[key]
            assert item.dofs is not None
            own = np.searchsorted(self.codes, codes_of(item.dofs))
            entries = item.matrix.tocoo()
            n = len(self.codes)
            places.append((number * n + own[entries.col].astype(np.int64)) * n + own[entries.row])
            values.append(entries.data)
        return np.concatenate(places), np.concatenate(values)
