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
from structid.external.outputs import MatricesOut
from structid.external.runs import RunCounts, Solver, needed_runs, point_words, run_words
from structid.external.solved import SolvedModel, SolverCheck, Units, model_parameters
from structid.fem.elements.matrix_group import Part, SolverModel
from structid.fem.importers import ImportedMatrix, dof_table, dofs_of, in_si, on_dofs
from structid.fem.importers.checks import require_semidefinite
from structid.fem.importers.imported import codes_of, tables_of
from structid.inversion.search.work import TaskExecutor


@dataclass(frozen=True, eq=False)
class SolvedMatrices(SolvedModel):
    """Model from the matrices that a solver exports.

    Attributes
    ----------
    out : MatricesOut
    """

    model: SolverModel
    out: MatricesOut

    @property
    def is_exact(self) -> bool:
        return True

    def checked(self, values: Point, work: TaskExecutor) -> SolverCheck:
        """Largest difference between the model's matrices and a solver run at `values` (by name), with a sentence.

        An entry (i, j) is relative to the root of the product of the run's diagonal entries i and j. `work` runs the
        solver, unless this run is kept already; `InputError` if it fails.
        """
        [folder], _ = needed_runs(self.solver, [values], work)
        worst = 0.0
        for key, item in self.out.read(folder).items():
            of_solver = in_si(
                on_dofs(item, dof_table(self.model.dofs)), self.model.dofs, self.units.length, self.units.force
            )
            size = np.sqrt(np.abs(of_solver.diagonal())) + 1e-300
            difference = sparse.coo_array(of_solver - self.model.matrix(key, values))
            worst = max(
                worst, float((np.abs(difference.data) / (size[difference.row] * size[difference.col])).max(initial=0.0))
            )
        return SolverCheck(
            worst, f"the solver with the updated deck gives the model's matrices to {worst:.2g} of their diagonals"
        )


def solved_matrices(
    name: str, solver: Solver, out: MatricesOut, units: Units, work: TaskExecutor, indefinite: bool = False
) -> SolvedMatrices:
    """A model of matrices exported by a solver: polynomials in the deck's parameters, which need no further runs.

    Parameters
    ----------
    name : str
        Name of the model in its structure.
    solver : Solver
        Deck, command and folder of the runs.
    out : MatricesOut
        Reads the matrices in the folder of a run.
    units : Units
        Units of the deck.
    work : TaskExecutor
        Executor of the runs.
    indefinite : bool
        True to accept matrices that are not positive semidefinite.

    Raises
    ------
    InputError
        If a run fails, its matrices differ in size from the first run's, no polynomial of low order is verified, or a
        matrix at the nominal values is not positive semidefinite and that is not accepted.
    """
    counts = RunCounts()
    pattern = _Pattern()
    matrices_of_run: dict[Path, Mapping[str, ImportedMatrix]] = {}

    def evaluate(points: Sequence[Point]) -> tuple[FloatArray, FloatArray]:
        """Matrix entries of the solver's runs at `points`, (n_points, n_entries), and their sizes, (n_entries,).

        Runs that are not kept yet are made; the counts of runs, and the entries that new matrices add, are updated.
        """
        nonlocal counts, pattern
        folders, made = needed_runs(solver, points, work)
        counts = RunCounts(0, counts.made + made.made)
        for folder, point in zip(folders, points, strict=True):
            if folder not in matrices_of_run:
                matrices_of_run[folder] = out.read(folder)
                pattern = pattern.with_run(matrices_of_run[folder], point_words(point))
        return pattern.rows([matrices_of_run[folder] for folder in folders])

    polynomials = expansion(evaluate, solver.deck)
    dofs = dofs_of(tables_of(pattern.codes))
    rows = {powers: pattern.matrices(row) for powers, row in polynomials.coefficients.items()}
    parts = [
        Part(key, powers, in_si(matrix, dofs, units.length, units.force))
        for powers, matrices in rows.items()
        for key, matrix in matrices.items()
        if matrix.nnz
    ]
    nominal = pattern.matrices(polynomials.at(solver.deck.nominal))
    for key, matrix in nominal.items() if not indefinite else ():
        require_semidefinite(f"{key} of the solver", in_si(matrix, dofs, units.length, units.force), dofs)
    constrained = {
        dof
        for item in next(iter(matrices_of_run.values())).values()
        if item.constrained is not None
        for dof in dofs_of(item.constrained)
    }
    model = SolverModel(name, dofs, tuple(parts), model_parameters(solver, polynomials.references))
    nominal_values = solver.deck.nominal
    counts = replace(counts, kept=polynomials.n_points - counts.made)
    facts = _describe_matrices(polynomials, pattern, counts)
    return SolvedMatrices(
        solver, model, (), tuple(sorted(constrained & set(dofs))), counts, facts, nominal_values, units, out
    )


def _describe_matrices(polynomials: Expansion, pattern: _Pattern, counts: RunCounts) -> tuple[str, ...]:
    """A tuple of one sentence on the polynomials: runs, size, order in each parameter, products, and accuracy."""
    words = {1: "linear", 2: "quadratic", 3: "cubic", 4: "of fourth order"}
    orders = ", ".join(f"{words[order]} in {name}" for name, order in polynomials.orders.items())
    crossed = "".join(f", with products of {a} and {b}" for a, b in polynomials.crossed)
    return (
        f"solver: {run_words(counts)}; matrices of {len(pattern.codes)} degrees of freedom are {orders}{crossed}, verified to"
        f" {polynomials.error:.1g} of their size",
    )


@dataclass(frozen=True, eq=False)
class _Pattern:
    """Union of the sparsity patterns of the runs so far: solvers leave out entries that cancel, in each run others.

    Attributes
    ----------
    codes_by_kind : mapping of str to int array
        Codes of node and component of each kind of matrix, sorted.
    codes : (n_dofs,) int array
        Codes of node and component of all kinds of matrix together.
    entries : (n_entries,) int array
        (Number of the kind times n_dofs plus column) times n_dofs plus row; what a further run adds is at the end.
    """

    codes_by_kind: Mapping[str, np.ndarray] = field(default_factory=dict)
    codes: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    entries: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def with_run(self, table: Mapping[str, ImportedMatrix], run_words: str) -> _Pattern:
        """The pattern of matrix entries extended by those of a run; `table` has its matrices by kind (mass, ...).

        `run_words` describe the run in the `InputError` that is raised if its degrees of freedom differ from the first run's.
        """
        codes_of_run = {key: np.sort(codes_of(item.dofs)) for key, item in table.items() if item.dofs is not None}
        first = self.codes_by_kind or codes_of_run
        for key, codes in codes_of_run.items():
            if not np.array_equal(codes, first[key]):
                raise InputError(
                    f"the {key} of the run at {run_words} has {len(codes)} rows, that of the first run {len(first[key])}, or"
                    " others; keep mesh and supports as they are, and mark numbers that change neither"
                )
        pattern = replace(self, codes_by_kind=first, codes=np.unique(np.concatenate(list(first.values()))))
        new = np.setdiff1d(pattern._entries_of(table)[0], self.entries)
        return replace(pattern, entries=np.concatenate([self.entries, new]))

    def rows(self, tables: Sequence[Mapping[str, ImportedMatrix]]) -> tuple[FloatArray, FloatArray]:
        """Matrix entries of each run, (n_runs, n_entries), and the size to compare changes of each with, (n_entries,).

        `tables` have the imported matrices of each run by kind; an entry that a run lacks is 0. The size is the root of
        the product of the two diagonal entries, of which the largest over the runs counts.
        """
        values = np.zeros((len(tables), len(self.entries)))
        order = np.argsort(self.entries)
        for row, table in zip(values, tables, strict=True):
            entries, data = self._entries_of(table)
            row[order[np.searchsorted(self.entries, entries, sorter=order)]] = data
        kind, column, row_of = self._rows_and_columns()
        on_diagonal = row_of == column
        diagonal = np.zeros((len(self.codes_by_kind), len(self.codes)))
        diagonal[kind[on_diagonal], column[on_diagonal]] = np.abs(values[:, on_diagonal]).max(axis=0)
        largest = diagonal.max(axis=1, initial=1e-300)
        return values, np.sqrt(diagonal[kind, row_of] * diagonal[kind, column]) + 1e-12 * largest[kind]

    def matrices(self, row: FloatArray) -> dict[str, sparse.csc_array]:
        """Sparse matrices (n_dofs, n_dofs) by kind (mass, ...): the symmetric parts of those in `row` (n_entries,)."""
        matrices, n = {}, len(self.codes)
        kind, column, row_of = self._rows_and_columns()
        for number, key in enumerate(self.codes_by_kind):
            chosen = (kind == number) & (row != 0)
            matrix = sparse.coo_array((row[chosen], (row_of[chosen], column[chosen])), (n, n)).tocsc()
            matrices[key] = sparse.csc_array((matrix + matrix.T) / 2)
        return matrices

    def _rows_and_columns(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Number of the kind of matrix, column and row of each entry, (n_entries,) each."""
        remainder, row = np.divmod(self.entries, len(self.codes))
        kind, column = np.divmod(remainder, len(self.codes))
        return kind, column, row

    def _entries_of(self, table: Mapping[str, ImportedMatrix]) -> tuple[np.ndarray, FloatArray]:
        """Position codes and values of all matrix entries of a run, (n,) each; `table` has its matrices by kind.

        A code stands for kind, column and row.
        """
        found_entries, values = [], []
        for number, key in enumerate(self.codes_by_kind):
            item = table[key]
            assert item.dofs is not None
            index = np.searchsorted(self.codes, codes_of(item.dofs))
            entries = item.matrix.tocoo()
            n = len(self.codes)
            found_entries.append((number * n + index[entries.col].astype(np.int64)) * n + index[entries.row])
            values.append(entries.data)
        return np.concatenate(found_entries), np.concatenate(values)
