"""A model of exported matrices: polynomials in the deck's parameters, which then need the solver no more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import sparse

from structid.arrays import FloatArray
from structid.errors import InputError
from structid.estimation.search.work import Work
from structid.solver.expansion import Expansion, Point, expansion
from structid.solver.model import Part, SolverModel
from structid.solver.outputs import MatricesOut
from structid.solver.runs import RunCounts, Solver, needed_runs, point_words, run_words
from structid.solver.solved import Checked, Solved, Units, model_parameters
from structid.structure.importers import ImportedMatrix, dof_table, dofs_of, in_si, on_dofs
from structid.structure.importers.definite import require_semidefinite
from structid.structure.importers.imported import codes_of, tables_of


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
    pattern: list[_Pattern] = []
    known: dict[Path, Mapping[str, ImportedMatrix]] = {}

    def evaluate(points: Sequence[Point]) -> tuple[FloatArray, FloatArray]:
        nonlocal counts
        folders, made = needed_runs(solver, points, work)
        counts = RunCounts(0, counts.made + made.made)
        known.update((folder, out.read(folder)) for folder in folders if folder not in known)
        tables = [known[folder] for folder in folders]
        pattern[:] = [_pattern(tables, [point_words(point) for point in points])]
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
    model = SolverModel(name, dofs, tuple(parts), model_parameters(solver, found.references))
    at = solver.deck.nominal
    counts = replace(counts, kept=found.n_points - counts.made)
    facts = _matrix_facts(found, own, counts)
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
