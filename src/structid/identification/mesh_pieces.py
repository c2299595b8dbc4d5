"""Pieces that beams and bars are cut into, so that the mesh moves no value by much of its deviation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.display import join_words
from structid.core.errors import InputError, SingularModelError
from structid.forward import RecordProblem
from structid.identification.identified import Identification, theta_within_tolerances
from structid.identification.joint_problem import harmonize_shared_parameters, indices_of, joint_problem
from structid.identification.options import IdentifyOptions
from structid.identification.setups.setup import AnySetup, titles
from structid.inversion import Problem
from structid.inversion.covariance import shift_of_minimum
from structid.inversion.linearization import Linearization

#: Part of its standard deviation that the mesh may move a value by, and that a finer mesh is chosen for.
MOVED, _AIMED = 0.2, 0.1
#: Power of a piece's length that errors of beams go with; those of bars go with its square and are judged again.
_ORDER = 4
#: Most pieces that are tried, and degrees of freedom of the finest model that is solved.
MOST_PIECES, MOST_DOFS = 32, 3000
#: Steps by which a shift is followed where the first says that it matters, and part of it that the last of them may add.
_MOST_STEPS, _FOLLOWED = 4, 0.2
#: Farthest shift of a free variable that is followed, in parts of the size of its value.
_FARTHEST = 2.0
#: Chi-square, in parts of what is expected, beyond which a model is wrong whatever its mesh, and part of it that the mesh may be.
_WRONG, _MESH_PART = 9.0, 0.01
#: Chi-square, in parts of what is expected, from which on finer pieces are chosen where they take away this part of what is
#: beyond noise.
_BEYOND_NOISE, _MOST_OF_IT = 1.1, 0.5
#: Standard deviations beyond which the size of a shift says nothing more.
_MOST_TOLD = 100
#: Chi-square by which the drawn mesh fits a record better than a finer one where that is said: beyond chance.
BETTER = 10.0
#: How the warnings of an identification on its mesh begin: of values that it moves, of modes, of a mesh that was not judged.
MESH_MOVES = "the mesh moves"
MESH_MAKES = "the mesh makes"
MESH_ERROR = "the values carry an error of the mesh"
NOT_JUDGED = "what the mesh moves the values by is not known"
MESH_WARNINGS = (MESH_MOVES, MESH_MAKES, MESH_ERROR, NOT_JUDGED)
SUBDIVIDE_AUTO = '`subdivide = "auto"`'


@dataclass(frozen=True)
class MeshPieces:
    """Number of pieces into which each beam and bar is cut, and shift of the values by the mesh that is left.

    Attributes
    ----------
    count : int
    moved : float
        Largest shift of a determined value by the mesh, in its standard deviations from noise and tolerances; NaN where
        not known. Deviations are those from the misfit where this is far beyond noise, and not from the mesh.
    shifts : str
        The values that move by more than `MOVED`, the farthest first, each with its shift; "" for none.
    obstacle : str
        Why the mesh was not judged, or why no finer one is proposed; "" otherwise, also where more pieces are needed.
    finer_minimum : mapping of str to float
        Free variables near the minimum with pieces half as long, by name: followed where values move, a linear step where
        the mesh makes a misfit alone; empty where it was not looked for, or not found.
    makes_misfit : bool
        Whether the mesh moves no value, but pieces half as long may explain most of a misfit that is beyond noise.
    """

    count: int
    moved: float = float("nan")
    shifts: str = ""
    obstacle: str = ""
    finer_minimum: Mapping[str, float] = field(default_factory=dict)
    makes_misfit: bool = False

    @property
    def is_enough(self) -> bool:
        """True if the mesh is known to move every value by less than `MOVED`, and makes no misfit."""
        return self.moved < MOVED and not self.makes_misfit

    @property
    def needed(self) -> int:
        """Number of pieces to try next, for a mesh that is not enough.

        It is doubled until the mesh is estimated to move values by `_AIMED`, once where the minimum was not found, since the
        shift is then a guess. Where the mesh makes a misfit but moves no value, half as many are added, which leaves a
        tenth of that misfit of beams or less. It is at most `MOST_PIECES`, but `count` + 1
        from there on.
        """
        if self.moved < MOVED:
            wanted = self.count + self.count // 2
        else:
            doublings = int(np.ceil(np.log2(self.moved / _AIMED) / _ORDER)) if self.finer_minimum else 1
            wanted = self.count * 2 ** max(doublings, 1)
        return max(min(wanted, MOST_PIECES), self.count + 1)

    @property
    def warning(self) -> str:
        """A sentence where the mesh changes a value by 0.2 standard deviations or more, or makes a misfit, or why
        that is not known.

        It is "" where the mesh is fine enough. It says what to do, and whether intervals can still be used: not if the
        change is a standard deviation or more.
        """
        if self.is_enough:
            return ""
        if np.isnan(self.moved):
            return f"{NOT_JUDGED}: {self.obstacle}"
        remedy = self.obstacle or f"write {SUBDIVIDE_AUTO}, or {self.needed} in place of {self.count}"
        if self.makes_misfit:
            return f"{MESH_MAKES} a misfit beyond noise, though it moves no value: {remedy}"
        interval = "which intervals do not include" if self.moved < 1 else "so do not rely on these intervals"
        return f"{MESH_MOVES} {self.shifts}, {interval}: {remedy}"


def judge_pieces(
    setups: Sequence[AnySetup], identification: Identification, options: IdentifyOptions, count: int
) -> MeshPieces:
    """Shifts of the identified values by the mesh, for beams cut into `count` pieces, in standard deviations.

    With b the change of the residual by pieces half as long, values move by -(J'J)^-1 J'b. Where that is 0.2 standard
    deviations or more, the minimum is followed with the finer pieces, as far as that succeeds: with precise data and
    light damping resonances move by many of their widths, where the residual is not linear. If shifts cannot be
    computed, `obstacle` says why.

    Parameters
    ----------
    setups : sequence of RecordSetup
        Set-ups as they were identified.
    identification : Identification
        Result with its values and deviations.
    options : IdentifyOptions
        Those by which histories fitted by output error are prepared again.
    count : int
        Pieces of each beam at present.
    """
    problem, theta = identification.target, identification.estimate.theta
    if problem is None or not identification.estimate.uncertainty.has_matrix:
        return MeshPieces(count, obstacle="this search has no residual that shows it; state `subdivide`")
    if max(dofs_of_pieces(setup, 2 * count) for setup in setups) > MOST_DOFS:
        return MeshPieces(
            count, obstacle=f"with pieces half as long the model has more than {MOST_DOFS} degrees of freedom"
        )
    try:
        finer = _finer_problem(setups, identification.problems, options, 2 * count)
        columns = indices_of(identification.estimate.names, finer.names)
        finer_rows = finer.residual(theta[columns])[: finer.n_data]
    except (InputError, SingularModelError, np.linalg.LinAlgError) as error:
        return MeshPieces(count, obstacle=f"with pieces half as long the model cannot be evaluated ({error})")
    linearization = problem.linearize(theta)
    misfit_change = finer_rows - linearization.residual[: finer.n_data]  # priors know no mesh
    step = shift_of_minimum(linearization.jacobian, misfit_change)
    deviation = _deviation(identification)
    if _is_wrong_on_any_mesh(identification, linearization, misfit_change, step):
        deviation = np.maximum(deviation, identification.estimate.std)
    deviations_per_theta = problem.slope(theta) / np.where(deviation > 0, deviation, np.nan)
    finer_minimum: dict[str, float] = {}
    if _largest(step * deviations_per_theta) >= MOVED:
        followed = _followed_shift(finer, columns, theta, linearization, deviations_per_theta)
        if followed is not None:
            step = followed
            finer_minimum = dict(zip(problem.names, (theta + np.nan_to_num(step)).tolist(), strict=True))
    deviations = np.abs(step * deviations_per_theta)
    if not np.isfinite(deviations).any():
        return MeshPieces(count, obstacle="no value is determined that the mesh might move")
    deviations = np.nan_to_num(deviations)
    moved = float(deviations.max())
    far = [i for i in np.argsort(-deviations, kind="stable") if deviations[i] >= MOVED]
    shifts = [f"{problem.names[i]} by {_told(float(deviations[i]))}" for i in far]
    makes_misfit = moved < MOVED and _makes_misfit(setups, identification, misfit_change)
    if makes_misfit:
        finer_minimum = dict(zip(problem.names, (theta + np.nan_to_num(step)).tolist(), strict=True))
    is_finest = (moved >= MOVED or makes_misfit) and count >= MOST_PIECES
    obstacle = "no more pieces are tried: give the beams nodes of their own" if is_finest else ""
    return MeshPieces(
        count,
        moved,
        f"{join_words(shifts, 4)} standard deviations" if far else "",
        obstacle,
        finer_minimum,
        makes_misfit,
    )


def division_words(drawn: Identification, divided: Identification, count: int) -> str:
    """A sentence on beams that were divided into `count` pieces: the largest change of a value, in standard deviations.

    The change is from the answer with the mesh as `drawn` to the one `divided`. The sentence also says if the record
    fits the drawn mesh better.
    """
    names = _divisible_names(divided)
    before, after = drawn.estimate, divided.estimate
    columns = indices_of(before.names, after.names)
    deviation = _deviation(divided)
    shift = np.abs(after.values - before.values[columns]) / np.where(deviation > 0, deviation, np.nan)
    shift = np.nan_to_num(shift)
    farthest = int(shift.argmax())
    largest = float(shift[farthest])
    moved = _told(largest, "up to ")
    words = (
        f"each element of {join_words(names, 4)} was divided into {count} equal pieces, which moved values by {moved}"
        f" standard deviations ({after.names[farthest]}); `subdivide = 1` in [structure] keeps the mesh as drawn"
    )
    if not after.goodness.chi_square_within_tolerances > before.goodness.chi_square_within_tolerances + BETTER:
        return words
    drawn_misfit, misfit = _rounded(before.goodness.misfit), _rounded(after.goodness.misfit)
    return f"{words}, which fits the record better (chi-square {drawn_misfit} for {misfit} times what is expected)"


def kept_words(drawn: Identification, divided: Identification, count: int, needed: int) -> str:
    """A sentence on elements that stay as `drawn`, since the record fits them and not the ones `divided` into `count` pieces.

    `needed` is the number of pieces that a record of no such elements would ask for.
    """
    misfits = [_rounded(answer.estimate.goodness.misfit) for answer in (drawn, divided)]
    names = join_words(_divisible_names(divided), 4)
    return (
        f"the record fits the elements of {names} as drawn (chi-square {misfits[0]} times what is"
        f" expected) and not divided into {count} pieces ({misfits[1]} times), as a record does that was simulated with the drawn"
        f" ones: they stay as drawn; `subdivide = {needed}` in [structure] divides them"
    )


def _divisible_names(identification: Identification) -> list[str]:
    """Names of the element sets that `subdivide` divides, each once."""
    return list(dict.fromkeys(element.name for setup in identification.setups for element in setup.structure.divisible))


def undivided_words(setups: Sequence[AnySetup]) -> str:
    """A clause that names the element sets whose mesh the standard deviations take as exact, as it cannot be divided.

    They are sets of cells (plates, solids), those of one matrix for the whole set, and lines that nothing would hold
    between their pieces; "" if there are none.
    """
    structures = [setup.structure for setup in setups if setup.structure.has_matrices]
    whole = {
        p.element
        for structure in structures
        for p in structure.properties
        for matrix_term in p.term.matrix_terms
        if matrix_term.whole is not None
    }
    names = [
        element.name
        for structure in structures
        for element in structure.elements
        if element.cells or element.name in whole or (element.is_line and element not in structure.divisible)
    ]
    if not names:
        return ""
    return f"± takes the mesh of {join_words(list(dict.fromkeys(names)), 3)} as it is: only beams are divided"


def _finer_problem(
    setups: Sequence[AnySetup], problems: Sequence[RecordProblem], options: IdentifyOptions, count: int
) -> Problem:
    """Joint problem of all records with beams cut into `count` pieces, and the data and weights of `problems`.

    Histories fitted by output error, which depend on the structure, are prepared again.
    """
    cut = [
        setup.modelled_by(
            replace(setup.structure, subdivide=count if setup.structure.divisible else 1),
            setup.parameters,
            setup.channel_unknowns,
        )
        for setup in setups
    ]
    finer = [
        problem.with_structure(setup.structure, setup.parameters) or setup.prepared(options).problem
        for setup, problem in zip(cut, problems, strict=True)
    ]
    return joint_problem(harmonize_shared_parameters(finer, titles(setups)))


def dofs_of_pieces(setup: AnySetup, count: int) -> int:
    """Approximate number of degrees of freedom of `setup` with its beams and bars in `count` pieces each."""
    structure = setup.structure
    lines = sum(len(element.nodes) for element in structure.divisible)
    return structure.n_dofs + lines * (count - structure.subdivide) * len(structure.active or ())


def _deviation(identification: Identification) -> FloatArray:
    """Standard deviations (n_params,) from noise and tolerances of fixed values, without model error."""
    fixed = identification.estimate.fixed
    variance = identification.estimate.std_noise**2
    return np.sqrt(variance if fixed is None else variance + fixed.std**2)


def _is_wrong_on_any_mesh(
    identification: Identification, linearization: Linearization, misfit_change: FloatArray, step: FloatArray
) -> bool:
    """True if the misfit is far beyond noise, and a finer mesh, with parameters free again, changes less than 1 % of it.

    `misfit_change` (n_data,) is the change of the residual with a finer mesh, `step` (n_params,) the shift of the values by it.
    """
    goodness = identification.estimate.goodness
    left = misfit_change + (linearization.jacobian @ np.nan_to_num(step))[: len(misfit_change)]
    return goodness.misfit > _WRONG and float(left @ left) < _MESH_PART * goodness.chi_square


def _makes_misfit(setups: Sequence[AnySetup], identification: Identification, misfit_change: FloatArray) -> bool:
    """True if a finer mesh may explain most of a misfit that is beyond noise, but not far.

    `misfit_change` (n_data,) is the change of the data rows with the finer mesh. To first order, with parameters and
    fixed values (within their tolerances) free, it takes away half of the misfit beyond noise, and 10 or more; or what is
    left of it is larger than the whole residual, so that the first order tells nothing.
    """
    estimate, goodness = identification.estimate, identification.estimate.goodness
    if identification.target is None or not _BEYOND_NOISE < goodness.misfit < _WRONG:
        return False
    problem, theta = identification.target, estimate.theta
    if identification.freed and estimate.fixed is not None:
        problem = joint_problem(harmonize_shared_parameters(identification.freed, titles(setups)))
        theta = theta_within_tolerances(problem, estimate)
    linearization = problem.linearize(theta)
    jacobian, residual = linearization.jacobian, linearization.residual
    change = np.zeros(len(residual))
    change[: len(misfit_change)] = misfit_change
    change += jacobian @ np.nan_to_num(shift_of_minimum(jacobian, change))
    beyond = goodness.chi_square_within_tolerances * (1 - 1 / goodness.misfit)
    size, gain = float(change @ change), float(-(2 * residual + change) @ change)
    return gain > max(_MOST_OF_IT * beyond, BETTER) or size > float(residual @ residual)


def _followed_shift(
    finer: Problem, columns: IntArray, theta: FloatArray, linearization: Linearization, deviations_per_theta: FloatArray
) -> FloatArray | None:
    """Shift (n_params,) of the minimum to that of the `finer` problem by Gauss-Newton steps.

    Its sum of squares has the data of `finer` and the priors of the coarser problem. None if a step does not lower it,
    the shift exceeds two sizes of a parameter, the model cannot be evaluated, or four steps do not end it. The last,
    small step is taken unseen. `linearization` is that of the coarser problem at its minimum `theta`, whose rows of
    priors are kept. `columns` are the positions in `theta` of the parameters of `finer`, and `deviations_per_theta`
    times a shift is a number of deviations.
    """
    total, lowest = np.zeros(len(theta)), np.inf
    sizes, slope = finer.unknowns.sizes(finer.physical(theta[columns])), finer.slope(theta[columns])
    per_size = np.bincount(columns, np.divide(slope, sizes, out=np.zeros(len(slope)), where=sizes > 0), len(theta))
    for _ in range(_MOST_STEPS):
        begun = np.nan_to_num(total)
        try:
            at_finer = finer.linearize((theta + begun)[columns])
        except (InputError, SingularModelError, np.linalg.LinAlgError):
            return None
        jacobian, residual = linearization.jacobian.copy(), linearization.residual + linearization.jacobian @ begun
        jacobian[: finer.n_data] = 0.0
        jacobian[: finer.n_data, columns] = at_finer.jacobian[: finer.n_data]
        residual[: finer.n_data] = at_finer.residual[: finer.n_data]
        misfit = float(residual @ residual)
        if not misfit < lowest:
            return None
        lowest, step = misfit, shift_of_minimum(jacobian, residual)
        total = total + step
        if _largest(total * per_size) > _FARTHEST:
            return None
        if _largest(step * deviations_per_theta) <= _FOLLOWED * _largest(total * deviations_per_theta):
            return total
    return None


def _largest(values: FloatArray) -> float:
    """Largest magnitude among `values` (any shape), NaN left out; 0 if they are empty."""
    return float(np.abs(np.nan_to_num(values)).max(initial=0.0))


def _told(deviations: float, before: str = "") -> str:
    """A number of standard deviations with the words `before` it, or that there are more than `_MOST_TOLD`."""
    return f"{before}{_rounded(deviations)}" if deviations < _MOST_TOLD else f"more than {_MOST_TOLD}"


def _rounded(value: float) -> str:
    """A positive number to two digits below 10, and without decimals from 10 on."""
    return f"{value:.1f}" if 1 <= value < 10 else f"{value:.2g}" if value < 1 else f"{value:,.0f}"
