"""Model with the modes of a solver on few degrees of freedom: exact where differences by its parameters are taken.

The solver gives frequencies and shapes at a centre and at two points of each parameter. On the span of all these shapes
there are matrices M and K that have each run's modes exactly, and quadratic through the three of a parameter; so the model has
the solver's modes at the centre, and their slopes to the second order of the steps, whether modes are close, cross or turn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.linalg import eigh, qr

from structid.core.arrays import FloatArray
from structid.core.dof import DIRECTIONS, Dof
from structid.core.errors import InputError
from structid.core.units import LENGTHS
from structid.external.expansion import Point, expand_about_centre
from structid.external.outputs import ModesOut, RunDeck, RunModes, require_same_dofs
from structid.external.runs import Solver, needed_runs, point_words, run_words
from structid.external.solved import ShapeTie, SolvedModel, SolverCheck, Units, model_parameters
from structid.external.steps import Pair, StepRules, take_differences
from structid.fem.elements.matrix_group import Part, Powers, SolverModel
from structid.inversion.search.work import TaskExecutor

#: Motions beside the centre's shapes that are smaller than so many times the rounding of printed shapes are left out.
_ROUNDINGS = 4.0
#: Multiples of the highest frequency between which what is beside the centre's shapes has its own.
_BESIDE = (1.5, 10.0)
#: Least cosine between the lowest modes of two runs, so that they span the same motions.
_ALIKE = 0.6
_RULES = StepRules(first=0.01, least=1e-5, most=0.1, no_effect=2e-7, what="frequency")


@dataclass(frozen=True, eq=False)
class Tangent:
    """The model on a few degrees of freedom that the others follow.

    Attributes
    ----------
    masters : tuple of Dof
        Degrees of freedom of the rows and columns of `mass` and `stiffness`.
    mass, stiffness : mapping of Powers to (n, n) float array
        The matrix at the centre under (), and its coefficients of the first and second power of each parameter's change
        from the centre, in the unit of the parameter.
    tie : ShapeTie
        By which all other degrees of freedom that move follow the masters.
    constrained : tuple of Dof
        Degrees of freedom that no mode moves.
    n_modes : int
        Number of the solver's lowest modes that the matrices have.
    """

    masters: tuple[Dof, ...]
    mass: Mapping[Powers, FloatArray]
    stiffness: Mapping[Powers, FloatArray]
    tie: ShapeTie
    constrained: tuple[Dof, ...]
    n_modes: int


def tangent(name: str, centre: RunModes, differences: Sequence[Pair[RunModes]]) -> Tangent:
    """Mass and stiffness matrices of small size, by powers of the parameters, that have the modes of solver runs.

    In each parameter the matrices are parabolas through three runs; effects of several parameters add. Unless all runs
    have shapes of unit modal mass, each mode is scaled by its coordinates below: the columns of [C; D] get the length
    1.

    Parameters
    ----------
    name : str
        Name of the returned tie, by which all other degrees of freedom that move follow those of the matrices.
    centre : RunModes
        Modes with every parameter at its centre value, in SI units, as those of all runs.
    differences : sequence of Pair
        For each parameter, the modes at two changes of it from the centre value, the other parameters at theirs.

    Returns
    -------
    Tangent
        Degrees of freedom, matrices and tie, the degrees of freedom that move in no run as constrained, and the number
        of modes that all runs have in common.

    Raises
    ------
    InputError
        If there are fewer moving degrees of freedom than modes, or no modes are alike between runs.

    Notes
    -----
    With the centre's shapes Phi and their eigenvalues Lambda, a run's shapes are Phi C + U D, where U spans the motion
    outside Phi. With unit masses and stiffnesses kappa of U, the run's modes are those of

        M_qq = C^-T (1 - D'D) C^-1,  K_qq = C^-T (Lambda - D'D Lambda - Lambda D'D + kappa D'D) C^-1,
        K_uq = (D Lambda - kappa D) C^-1.

    Degrees of freedom of the matrices are those on which the span of Phi and U is best determined, by a pivoted QR.
    """
    runs = [run for difference in differences for run in difference.runs]
    moved = np.abs(centre.values).max(axis=1) > 0
    for run in runs:
        moved |= np.abs(run.values[:, : centre.values.shape[1]]).max(axis=1) > 0
    n_modes = _count_common_modes(centre, runs, int(moved.sum()))
    phi = centre.values[moved, :n_modes]
    size = float(np.linalg.norm(phi, axis=0).max())
    inverse = np.linalg.pinv(phi)
    coordinates = [inverse @ run.values[moved, :n_modes] for run in runs]
    rests = [run.values[moved, :n_modes] - phi @ c for run, c in zip(runs, coordinates, strict=True)]
    u = _orthonormal_span(rests, _ROUNDINGS * size * centre.rounding, int(moved.sum()) - n_modes) * size
    free = [u.T @ rest / size**2 for rest in rests]
    if not (centre.has_mass and all(run.has_mass for run in runs)):
        scales = [np.sqrt((c**2).sum(axis=0) + (d**2).sum(axis=0)) for c, d in zip(coordinates, free, strict=True)]
        coordinates = [c / s for c, s in zip(coordinates, scales, strict=True)]
        free = [d / s for d, s in zip(free, scales, strict=True)]
    stiff = _outer_stiffness(centre, differences, n_modes, coordinates, free)
    n = n_modes + u.shape[1]
    zero = _run_matrices(centre.frequency[:n_modes], np.eye(n_modes), np.zeros((n - n_modes, n_modes)), stiff)
    pairs = [
        _run_matrices(run.frequency[:n_modes], c, d, stiff) for run, c, d in zip(runs, coordinates, free, strict=True)
    ]
    basis = np.concatenate([phi, u], axis=1)
    chosen = np.sort(qr(basis.T, mode="r", pivoting=True)[1][:n])
    to_masters = np.linalg.inv(basis[chosen])
    dofs = [Dof(int(node), DIRECTIONS[component - 1]) for node, component in centre.dofs[moved].tolist()]
    others = np.setdiff1d(np.arange(len(dofs)), chosen)
    mass: dict[Powers, FloatArray] = {(): to_masters.T @ zero[0] @ to_masters}
    stiffness: dict[Powers, FloatArray] = {(): to_masters.T @ zero[1] @ to_masters}
    remaining_pairs = iter(pairs)
    for difference in differences:
        pairs_of_parameter = [next(remaining_pairs) for _ in difference.changes]
        for k, table in enumerate((mass, stiffness)):
            for power, row in enumerate(
                _parabola(difference.changes, [pair[k] - zero[k] for pair in pairs_of_parameter]), 1
            ):
                table[(difference.name, power),] = to_masters.T @ row @ to_masters
    masters = tuple(dofs[i] for i in chosen)
    tie = ShapeTie(name, tuple(dofs[i] for i in others), masters, basis[others] @ to_masters)
    constrained = tuple(Dof(int(node), DIRECTIONS[component - 1]) for node, component in centre.dofs[~moved].tolist())
    return Tangent(masters, _symmetric(mass), _symmetric(stiffness), tie, constrained, n_modes)


def _count_common_modes(centre: RunModes, runs: Sequence[RunModes], n_moved: int) -> int:
    """Largest number of lowest modes whose shapes span the same motions at the centre and in all runs.

    They do if the cosine of the largest principal angle is above 0.6. `n_moved` is the number of degrees of freedom
    that move in the runs.

    Raises
    ------
    InputError
        If there are more modes than `n_moved`, or not even the first mode spans the same motion in all runs.
    """
    n_common = min([len(centre.frequency), *(len(run.frequency) for run in runs)])
    if n_moved < n_common:
        raise InputError(
            f"the solver gives {n_common} modes at {n_moved} degrees of freedom that move; let it give the shapes at more nodes, or"
            " fewer modes"
        )
    for count in range(n_common, 0, -1):
        first = np.linalg.qr(centre.values[:, :count])[0]
        cosines = [
            np.linalg.svd(first.T @ np.linalg.qr(run.values[:, :count])[0], compute_uv=False)[-1] for run in runs
        ]
        if min(cosines, default=1.0) > _ALIKE:
            return count
    raise InputError(
        "no modes of the solver are alike before and after a step of its parameters; take smaller steps (`step`)"
    )


def _orthonormal_span(residuals: Sequence[FloatArray], least: float, n_most: int) -> FloatArray:
    """Orthonormal basis, (n_dofs, n), of the parts of runs' shapes that the shapes at the centre do not span.

    `residuals` are the runs' shapes less their projection on the centre's, (n_dofs, n_modes) each. The basis has at most
    `n_most` directions, those with singular values above `least`; it is (0, 0) without runs.
    """
    if not residuals:
        return np.zeros((0, 0))
    vectors, singular, _ = np.linalg.svd(np.concatenate(residuals, axis=1), full_matrices=False)
    return vectors[:, : min(int((singular > least).sum()), n_most)]


def _run_matrices(frequency: FloatArray, c: FloatArray, d: FloatArray, kappa: float) -> tuple[FloatArray, FloatArray]:
    """Mass and stiffness matrices, (n, n) each, that have the modes of one run of the solver; n = n_modes + n_outside.

    The first n_modes coordinates are factors of the mode shapes at the centre, the others those of directions outside them, which
    have unit mass and the stiffness `kappa`, (rad/s)^2. The run's shapes have the coordinates `c` (n_modes, n_modes) and `d`
    (n_outside, n_modes); `frequency` (n_modes,) is in Hz.
    """
    m, e = c.shape[0], d.shape[0]
    eigenvalues = (2 * np.pi * frequency) ** 2
    inverse = np.linalg.inv(c)
    inner = d.T @ d
    mass, stiffness = np.eye(m + e), np.zeros((m + e, m + e))
    mass[:m, :m] = inverse.T @ (np.eye(m) - inner) @ inverse
    inner_stiffness = np.diag(eigenvalues) - inner * eigenvalues - eigenvalues[:, None] * inner + kappa * inner
    stiffness[:m, :m] = inverse.T @ inner_stiffness @ inverse
    stiffness[m:, :m] = (d * eigenvalues - kappa * d) @ inverse
    stiffness[:m, m:] = stiffness[m:, :m].T
    stiffness[m:, m:] = kappa * np.eye(e)
    return mass, stiffness


def _parabola(changes: Sequence[float], differences: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Linear and quadratic coefficient of the parabola through 0 with the values `differences` at the two `changes`.

    `changes` are two changes of a parameter, `differences` an array for each; both coefficients have the shape of one of them.
    """
    a, b = changes
    square: FloatArray = (differences[1] / b - differences[0] / a) / (b - a)
    return differences[0] / a - a * square, square


def _outer_stiffness(
    centre: RunModes,
    differences: Sequence[Pair[RunModes]],
    n_modes: int,
    coordinates: Sequence[FloatArray],
    free: Sequence[FloatArray],
) -> float:
    """Stiffness, (rad/s)^2, outside the shapes at the centre that makes the stiffness matrix most nearly linear.

    It minimizes the quadratic coefficients, in the changes of each parameter, of the stiffness of the centre's shapes.
    It is that of 1.5 to 10 times the highest frequency of all runs; the upper end is returned if no shape leaves the
    centre's. `differences` hold the two runs of each parameter, of which the `n_modes` lowest modes count. Each run's
    shapes have coordinates in the centre's shapes, `coordinates` (n_modes, n_modes), and in the directions outside,
    `free` (n_outside, n_modes), in the order of the runs.
    """
    eigenvalues = [
        (2 * np.pi * run.frequency[:n_modes]) ** 2 for pair_of_runs in differences for run in pair_of_runs.runs
    ]
    top = max([float(centre.frequency[:n_modes].max()), *(float(np.sqrt(e.max()) / (2 * np.pi)) for e in eigenvalues)])
    centre_eigenvalues = (2 * np.pi * centre.frequency[:n_modes]) ** 2
    changes_of_runs = [
        (
            _run_matrices(np.sqrt(e) / (2 * np.pi), c, d, 0.0)[1][:n_modes, :n_modes] - np.diag(centre_eigenvalues),
            d.T @ d,
        )
        for e, c, d in zip(eigenvalues, coordinates, free, strict=True)
    ]
    product = size = 0.0
    rows = iter(changes_of_runs)
    for pair_of_runs in differences:
        changes_of_pair = [next(rows) for _ in pair_of_runs.changes]
        curvature, outer_motion = (
            _parabola(pair_of_runs.changes, [pair[k] for pair in changes_of_pair])[1] for k in (0, 1)
        )
        scale = float(np.abs(outer_motion).max()) or 1.0  # parameters of any unit count alike
        product += float(np.sum(curvature * outer_motion)) / scale**2
        size += float(np.sum(outer_motion * outer_motion)) / scale**2
    nearest, farthest = ((2 * np.pi * part * top) ** 2 for part in _BESIDE)
    return float(np.clip(-product / size, nearest, farthest)) if size else farthest


def _symmetric(table: Mapping[Powers, FloatArray]) -> dict[Powers, FloatArray]:
    return {powers: (matrix + matrix.T) / 2 for powers, matrix in table.items()}


@dataclass(frozen=True, eq=False)
class SolvedModes(SolvedModel):
    """Model from the modes that a solver gives.

    Attributes
    ----------
    out : ModesOut
    n_modes : int
        Modes that the model has.
    """

    model: SolverModel
    out: ModesOut
    n_modes: int

    @property
    def is_exact(self) -> bool:
        return False

    def checked(self, values: Point, work: TaskExecutor) -> SolverCheck:
        """Largest relative error of the model's frequencies against a solver run at `values` (by name), and a sentence.

        Rigid-body modes, below 0.1 % of the highest frequency, are left out. `work` runs the solver, unless this run is
        kept already; `InputError` if it fails.
        """
        [folder], _ = needed_runs(self.solver, [values], work)
        of_solver = self.out.read(folder).frequency[: self.n_modes]
        squared = eigh(*(self.model.matrix(key, values).toarray() for key in ("stiffness", "mass")), eigvals_only=True)
        of_model = np.sqrt(np.maximum(squared[: len(of_solver)], 0.0)) / (2 * np.pi)
        is_elastic = of_solver > 1e-3 * of_solver.max()
        worst = float(np.abs(of_model[is_elastic] / of_solver[is_elastic] - 1).max())
        return SolverCheck(
            worst, f"the solver with the updated deck gives the model's frequencies to {worst:.2g} of their value"
        )


def solved_modes(name: str, solver: Solver, out: ModesOut, units: Units, work: TaskExecutor) -> SolvedModes:
    """A model with the modes of a solver, linearized by finite differences about the centre of each parameter.

    Parameters
    ----------
    name : str
        Name of the model in its structure.
    solver : Solver
        Deck, command and folder of the runs.
    out : ModesOut
        Reads frequencies and shapes in the folder of a run.
    units : Units
        Units of the deck.
    work : TaskExecutor
        Executor of the runs.

    Raises
    ------
    InputError
        If a run fails, has other nodes than the first, or a parameter changes no frequency.
    """
    out = replace(out, deck=RunDeck(solver.deck.main, solver.linked))
    solver = replace(solver, outputs=out)
    steps = take_differences(solver, out.read, _frequency_change, _RULES, work)
    shapes, centre = steps.centre, steps.at
    pairs = [replace(d, runs=(_shapes_in_si(d.runs[0], units), _shapes_in_si(d.runs[1], units))) for d in steps.pairs]
    small = tangent(f"shapes of {name}", _shapes_in_si(shapes, units), pairs)
    references = steps.references
    parts = []
    for key, table in (("mass", small.mass), ("stiffness", small.stiffness)):
        about_zero: dict[Powers, FloatArray] = {}
        for powers, matrix in table.items():
            for shift, factor in expand_about_centre(powers, centre, references):
                about_zero[shift] = about_zero.get(shift, 0.0) + factor * matrix
        parts += [Part(key, shift, sparse.csc_array(matrix)) for shift, matrix in about_zero.items()]
    has_mass = shapes.has_mass and all(run.has_mass for pair in pairs for run in pair.runs)
    parameters = model_parameters(solver, references)
    model = SolverModel(name, small.masters, tuple(parts), parameters, small.n_modes, has_mass)
    frequency = ", ".join(f"{f:.5g}" for f in shapes.frequency[: small.n_modes])
    fact = f"solver: {run_words(steps.counts)}; modes at {frequency} Hz, {len(shapes.dofs)} degrees of freedom; {steps.words}"
    facts = (fact, *shapes.notes)
    ties = (small.tie,) if small.tie.dependents else ()
    return SolvedModes(solver, model, ties, small.constrained, steps.counts, facts, centre, units, out, small.n_modes)


def _frequency_change(centre: RunModes, run: RunModes, point: Point) -> float:
    """Largest relative change of a frequency from the run `centre` to `run`, mode by mode in order of frequency.

    Rigid-body modes, below 0.1 % of the highest frequency, are left out. `point` are the parameter values of `run`, for
    the `InputError` if both have different degrees of freedom.
    """
    require_same_dofs(centre, run, point_words(point))
    n = min(len(run.frequency), len(centre.frequency))
    first = centre.frequency[:n]
    is_elastic = first > 1e-3 * first.max(initial=0.0)
    return float(np.abs(run.frequency[:n] / np.where(is_elastic, first, 1.0) - 1)[is_elastic].max(initial=0.0))


def _shapes_in_si(shapes: RunModes, units: Units) -> RunModes:
    """Shapes of unit modal mass converted from the deck's units to kg^-1/2, for rotations rad/m kg^-1/2; others likewise."""
    rotation = shapes.dofs[:, 1] > 3
    scale = np.where(rotation, 1.0 / LENGTHS[units.length], 1.0) / np.sqrt(units.mass)
    return replace(shapes, values=shapes.values * scale[:, None])
