"""A small model with the modes of a solver: exact at the values of its parameters about which differences are taken.

The solver gives frequencies and shapes at a centre and at two points of each parameter. On the span of all these shapes
there are matrices M and K that have each run's modes exactly, which are linear between the two points; so the model has the
solver's modes at the centre, and their slopes to the second order of the steps, whether modes are close, cross or turn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from structid.arrays import FloatArray
from structid.dof import DIRECTIONS, Dof
from structid.errors import InputError
from structid.solver.shapes import Shapes
from structid.structure.elements.element import dof_code
from structid.structure.supports import Equations

#: Motions beside the centre's shapes that are smaller than so many times the rounding of printed shapes are left out.
_ROUNDINGS = 4.0
#: What is added to the span beside the centre's shapes stands at this multiple of the highest frequency.
_FAR = 3.0
#: Least cosine between the lowest modes of two runs, so that they span the same motions.
_ALIKE = 0.6


@dataclass(frozen=True, eq=False)
class ShapeTie:
    """Degrees of freedom that follow others by the shapes that a solver gave.

    Attributes
    ----------
    name : str
    dependents, masters : tuple of Dof
    matrix : (n_dependents, n_masters) float array
    """

    name: str
    dependents: tuple[Dof, ...]
    masters: tuple[Dof, ...]
    matrix: FloatArray

    def equations(self, positions: Mapping[int, FloatArray], active: Sequence[str]) -> Equations:
        """See `Tie.equations`."""
        codes = [dof_code(dof.node, dof.direction) for dof in self.masters]
        return {
            dof_code(dof.node, dof.direction): dict(zip(codes, row, strict=True))
            for dof, row in zip(self.dependents, self.matrix.tolist(), strict=True)
        }


@dataclass(frozen=True, eq=False)
class Tangent:
    """The model on a few degrees of freedom that the others follow.

    Attributes
    ----------
    masters : tuple of Dof
        What its matrices stand on.
    mass, stiffness : mapping of str to (n, n) float array
        Under "" at the centre, under a parameter's name the slope.
    tie : ShapeTie
    held : tuple of Dof
        That no mode moves.
    n_modes : int
        Modes of the solver that it has.
    """

    masters: tuple[Dof, ...]
    mass: Mapping[str, FloatArray]
    stiffness: Mapping[str, FloatArray]
    tie: ShapeTie
    held: tuple[Dof, ...]
    n_modes: int


@dataclass(frozen=True, eq=False)
class Differences:
    """Runs on both sides of the centre, or twice on one, for a parameter.

    Attributes
    ----------
    name : str
    changes : tuple of float
        Changes of its value, one or two of different size or sense.
    runs : tuple of Shapes
        At the centre with each change.
    """

    name: str
    changes: tuple[float, ...]
    runs: tuple[Shapes, ...]


def tangent(name: str, centre: Shapes, differences: Sequence[Differences]) -> Tangent:
    """The model of the runs.

    Parameters
    ----------
    name : str
        Of the tie.
    centre : Shapes
        In SI units, as all runs.
    differences : sequence of Differences

    Raises
    ------
    InputError
        If the shapes are given at fewer degrees of freedom than there are modes, or no modes are alike between runs.

    Notes
    -----
    With the centre's shapes Phi and their frequencies, a run's shapes are Phi C + U D, U spanning what Phi does not; with the
    masses of U one and its stiffnesses kappa, the run's modes are those of

        M_qq = C^-T (1 - D'D) C^-1,  K_qq = C^-T (Lambda - D'D Lambda - Lambda D'D + kappa D'D) C^-1,
        K_uq = (D Lambda - kappa D) C^-1.
    """
    runs = [run for one in differences for run in one.runs]
    moved = np.abs(centre.values).max(axis=1) > 0
    for run in runs:
        moved |= np.abs(run.values[:, : centre.values.shape[1]]).max(axis=1) > 0
    n_modes = _alike_modes(centre, runs, int(moved.sum()))
    phi = centre.values[moved, :n_modes]
    size = float(np.linalg.norm(phi, axis=0).max())
    inverse = np.linalg.pinv(phi)
    coordinates = [inverse @ run.values[moved, :n_modes] for run in runs]
    rests = [run.values[moved, :n_modes] - phi @ c for run, c in zip(runs, coordinates, strict=True)]
    u = _span(rests, _ROUNDINGS * size * centre.rounding, int(moved.sum()) - n_modes) * size
    free = [u.T @ rest / size**2 for rest in rests]
    if not (centre.has_mass and all(run.has_mass for run in runs)):
        scales = [np.sqrt((c**2).sum(axis=0) + (d**2).sum(axis=0)) for c, d in zip(coordinates, free, strict=True)]
        coordinates = [c / s for c, s in zip(coordinates, scales, strict=True)]
        free = [d / s for d, s in zip(free, scales, strict=True)]
    top = max(run.frequency[:n_modes].max() for run in [centre, *runs])
    kappa = (2 * np.pi * _FAR * top) ** 2
    n = n_modes + u.shape[1]
    zero = _matrices(centre.frequency[:n_modes], np.eye(n_modes), np.zeros((n - n_modes, n_modes)), kappa)
    pairs = [_matrices(run.frequency[:n_modes], c, d, kappa) for run, c, d in zip(runs, coordinates, free, strict=True)]
    basis = np.concatenate([phi, u], axis=1)
    chosen = np.sort(qr(basis.T, mode="r", pivoting=True)[1][:n])
    to_masters = np.linalg.inv(basis[chosen])
    dofs = [Dof(int(node), DIRECTIONS[component - 1]) for node, component in centre.dofs[moved].tolist()]
    others = np.setdiff1d(np.arange(len(dofs)), chosen)
    mass, stiffness = ({"": to_masters.T @ zero[k] @ to_masters} for k in (0, 1))
    at = iter(pairs)
    for one in differences:
        own = [next(at) for _ in one.changes]
        for k, table in enumerate((mass, stiffness)):
            table[one.name] = to_masters.T @ _slope(one.changes, [pair[k] - zero[k] for pair in own]) @ to_masters
    masters = tuple(dofs[i] for i in chosen)
    tie = ShapeTie(name, tuple(dofs[i] for i in others), masters, basis[others] @ to_masters)
    held = tuple(Dof(int(node), DIRECTIONS[component - 1]) for node, component in centre.dofs[~moved].tolist())
    return Tangent(masters, _symmetric(mass), _symmetric(stiffness), tie, held, n_modes)


def _alike_modes(centre: Shapes, runs: Sequence[Shapes], n_moved: int) -> int:
    """How many of the lowest modes span the same motions in all runs: the highest may have left the list."""
    most = min([len(centre.frequency), *(len(run.frequency) for run in runs)])
    if n_moved < most:
        raise InputError(
            f"the solver gives {most} modes at {n_moved} degrees of freedom that move; let it give the shapes at more nodes, or"
            " fewer modes"
        )
    for count in range(most, 0, -1):
        first = np.linalg.qr(centre.values[:, :count])[0]
        cosines = [
            np.linalg.svd(first.T @ np.linalg.qr(run.values[:, :count])[0], compute_uv=False)[-1] for run in runs
        ]
        if min(cosines, default=1.0) > _ALIKE:
            return count
    raise InputError(
        "no modes of the solver are alike before and after a step of its parameters; take smaller steps (`step`)"
    )


def _span(rests: Sequence[FloatArray], least: float, most: int) -> FloatArray:
    """Orthonormal columns of what the runs' shapes have beside the centre's, of at least this size."""
    if not rests:
        return np.zeros((0, 0))
    left, singular, _ = np.linalg.svd(np.concatenate(rests, axis=1), full_matrices=False)
    return left[:, : min(int((singular > least).sum()), most)]


def _matrices(frequency: FloatArray, c: FloatArray, d: FloatArray, kappa: float) -> tuple[FloatArray, FloatArray]:
    """M and K of a run on the coordinates of the centre's shapes and of what is beside them; see `tangent`."""
    m, e = c.shape[0], d.shape[0]
    eigenvalues = (2 * np.pi * frequency) ** 2
    inverse = np.linalg.inv(c)
    inner = d.T @ d
    mass, stiffness = np.eye(m + e), np.zeros((m + e, m + e))
    mass[:m, :m] = inverse.T @ (np.eye(m) - inner) @ inverse
    own = np.diag(eigenvalues) - inner * eigenvalues - eigenvalues[:, None] * inner + kappa * inner
    stiffness[:m, :m] = inverse.T @ own @ inverse
    stiffness[m:, :m] = (d * eigenvalues - kappa * d) @ inverse
    stiffness[:m, m:] = stiffness[m:, :m].T
    stiffness[m:, m:] = kappa * np.eye(e)
    return mass, stiffness


def _slope(changes: Sequence[float], differences: Sequence[FloatArray]) -> FloatArray:
    """Slope at the centre of the polynomial through no change and these."""
    if len(changes) == 1:
        return differences[0] / changes[0]
    a, b = changes
    slope: FloatArray = (differences[0] * b / a - differences[1] * a / b) / (b - a)
    return slope


def _symmetric(table: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    return {name: (matrix + matrix.T) / 2 for name, matrix in table.items()}
