"""Error of a model's frequencies by the size of its elements, from a comparison with a refined mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.diagnose.checks.refined_mesh import RefinedStructure, n_split, obstacle, refined, split_power
from structid.dynamics import Modes
from structid.fem import Structure
from structid.forward import RecordProblem
from structid.forward.modal import compares_modes
from structid.identification.mesh_pieces import MESH_ERROR
from structid.identification.record_fit import LEAST_DAMPING, structure_modes
from structid.identification.setups.setup import AnySetup
from structid.similarity import assign_pairs

#: Degrees of freedom of the finest model that is solved, and modes that are looked at.
_MOST_DOFS, _MOST_MODES = 20_000, 40
#: Degrees of freedom up to which all modes come at once.
_ALL = 600
#: Damping ratio where there is none.
_USUAL_DAMPING = 0.01
#: Pieces from which on smaller elements are no remedy.
_MOST_PIECES = 16
#: Part of a half-bandwidth by which a mode may be off by its mesh, and relative change of a frequency that is rounding.
_PART, _ROUNDING = 0.1, 1e-6
#: Powers of the element length that errors go with; the usual one where only one refinement can be solved.
_ORDERS, _USUAL = (1.0, 6.0), 2.0
#: Parts of the band's end up to which modes are looked at, below which they are a rigid body's, and up to which one is lost.
_LOOKED, _RIGID, _LOST = 1.3, 1e-3, 0.97
#: Likeness from which on a mode of the refined model is one of the coarse model's, and how far apart they may be.
_ALIKE, _FARTHEST = 0.5, 1.0
#: Part of their frequencies by which modes of an initial model may be off, and degrees of freedom up to which the mesh of an
#: answer is judged.
_NEAR, _SMALL = 0.15, 600


@dataclass(frozen=True, eq=False)
class MeshErrors:
    """Frequencies of a model beside those extrapolated to infinitely small elements.

    Attributes
    ----------
    structure : Structure
    number : (n_judged,) int array
        Number of each mode in the band among all modes of the model, from 0.
    frequency, damping_ratio : (n_judged,) float arrays
        Of these modes, with the elements as they are, in Hz and 1; ratios are at least 0.001, and 0.01 without damping.
    error, order : (n_judged,) float arrays
        Relative error of each frequency, positive where it is too high; and the power of the element length to which the error
        is proportional.
    passed_over : (n_lost,) float array
        Frequencies, Hz, of modes of the refined model in the band that match no mode of the present one.
    deviation : float
        Least relative standard deviation of the measured frequencies; infinite where none are measured.
    """

    structure: Structure
    number: IntArray
    frequency: FloatArray
    damping_ratio: FloatArray
    error: FloatArray
    order: FloatArray
    passed_over: FloatArray
    deviation: float

    @cached_property
    def allowed(self) -> FloatArray:
        """Relative errors that modes may have, (n_judged,): a tenth of the damping ratio, or `deviation` if less."""
        return np.minimum(_PART * self.damping_ratio, self.deviation)

    @property
    def tolerance(self) -> float:
        """The least relative error that a mode in the band may have; that of a mode of usual damping where none was judged."""
        return float(self.allowed.min(initial=min(_PART * _USUAL_DAMPING, self.deviation)))

    @cached_property
    def needed(self) -> int:
        """Number of pieces to cut each element into, along each edge, so that no mode is off by more than allowed.

        It follows from the error and the order of convergence of each mode, for errors within its `tolerance`. 0 where
        no error is above `allowed`.
        """
        size = np.abs(self.error)
        if not (size > self.allowed).any():
            return 0
        return int(np.ceil(np.max((size / self.tolerance) ** (1 / self.order)) - 1e-9))

    @property
    def n_elements(self) -> int:
        """Number of elements once each is cut into the `needed` pieces."""
        return n_split(self.structure) * max(self.needed, 1) ** split_power(self.structure)

    @property
    def worst(self) -> int:
        """Position among the judged modes of the one whose error is largest in parts of what is allowed."""
        return int((np.abs(self.error) / self.allowed).argmax())

    @property
    def half_bandwidths(self) -> FloatArray:
        """Relative errors over damping ratios, without sign, (n_judged,): parts of half the resonance width."""
        return np.abs(self.error) / self.damping_ratio

    @property
    def finding(self) -> str:
        """Clause on modes that the mesh lacks or, without any, on the mode with the largest error.

        "" if no mode is lacking and no error is above `self.allowed`.
        """
        if not self.needed and not self.passed_over.size:
            return ""
        if self.passed_over.size:
            listed = ", ".join(f"{value:.4g}" for value in self.passed_over[:3])
            return f"with smaller elements the model has modes at {listed} Hz that it lacks with these"
        worst = self.worst
        sense = "high" if self.error[worst] > 0 else "low"
        off = (
            f"{abs(self.error[worst]) / self.tolerance:.2g} times the deviation that is stated of measured modes"
            if self.tolerance == self.deviation
            else f"{self.half_bandwidths[worst]:.2g} times half its resonance width"
        )
        return (
            f"the mesh is too coarse: mode {self.number[worst] + 1} at {self.frequency[worst]:.4g} Hz is"
            f" {100 * abs(self.error[worst]):.2g} % too {sense}, {off}"
        )

    @property
    def words(self) -> str:
        """Clause with the `finding` and a remedy, such as a finer subdivision; "" where there is no finding."""
        found = self.finding
        if not found:
            return ""
        if not self.needed or self.needed > _MOST_PIECES:
            return f"{found}; refine the mesh, or take elements of higher order"
        remedy = (
            f"cells 1/{self.needed} as long bring"
            if any(made.cells for made in self.structure.elements)
            else f"`subdivide = {self.structure.subdivide * self.needed}` in [structure] brings"
        )
        whom = (
            "it"
            if not self.passed_over.size and np.count_nonzero(np.abs(self.error) > self.allowed) == 1
            else "every mode"
        )
        return f"{found}; {remedy} {whom} below {100 * self.tolerance:.2g} % ({self.n_elements} elements)"


def mesh_errors(
    structure: Structure, values: FloatArray, band: tuple[float, float], deviation: float = np.inf
) -> MeshErrors | str:
    """Discretization errors of the natural frequencies in `band`, or a sentence on why they are not known.

    The model is solved again with elements a half and a quarter as long; the error is extrapolated with the power of
    the element length that the three solutions show (Richardson).

    Parameters
    ----------
    structure : Structure
    values : (n_values,) float array
        Property values.
    band : (float, float)
        Lower and upper end of the frequency band, Hz.
    deviation : float
        Smallest relative standard deviation of the measured frequencies; infinite for records without modes. The error
        of a mode may be as large as this, or as a tenth of its damping ratio if that is less.

    Returns
    -------
    MeshErrors or str
        The text is "" for a structure without a mesh. Only the first refinement is used where the second has more than
        20 000 degrees of freedom.

    References
    ----------
    Roache (1994), Perspective: a method for uniform reporting of grid refinement studies, J. Fluids Eng. 116, 405-413.
    """
    why = obstacle(structure)
    if why is not None:
        return why
    finer = [made for made in (refined(structure, values, times, _MOST_DOFS) for times in (2, 4)) if made is not None]
    if not finer:
        return f"the mesh was not judged: twice as fine, the model has more than {_MOST_DOFS} degrees of freedom"
    low, high = band
    own = structure_modes(structure, values, min(_MOST_MODES, structure.n_dofs))
    looked = np.flatnonzero((own.frequency <= _LOOKED * high) & (own.frequency > _RIGID * high))
    if not looked.size:
        return "the mesh was not judged: the initial model has no mode in the band"
    count = len(looked) + int(looked[0])
    frequency = own.frequency[looked]
    other: list[FloatArray] = []
    for made in finer:
        found = structure_modes(made.structure, made.values, _ALL if made.structure.n_dofs <= _ALL else count + 8)
        if np.count_nonzero(found.frequency <= _RIGID * high) > np.count_nonzero(own.frequency <= _RIGID * high):
            return (
                "the mesh was not judged: pieces of its bars would move sideways without stiffness; make beams of them to"
                " have it judged"
            )
        pairs = _match_modes(structure, values, own, looked, made, found)
        other.append(np.where(pairs >= 0, found.frequency[pairs], np.nan))
        lost = found.frequency[np.setdiff1d(np.arange(len(found.frequency)), pairs)]
    limit, order = _limit(frequency, other)
    kept = np.isfinite(limit) & (np.maximum(limit, frequency) >= low) & (np.minimum(limit, frequency) <= high)
    error = frequency[kept] / limit[kept] - 1
    ratio = own.damping_ratio[looked[kept]]
    damping = np.where(ratio > 0, np.maximum(ratio, LEAST_DAMPING), _USUAL_DAMPING)
    lost = lost[(lost > max(low, _RIGID * high)) & (lost < _LOST * high)]
    return MeshErrors(structure, looked[kept], frequency[kept], damping, error, order[kept], lost, deviation)


def checked_mesh(setup: AnySetup, problem: RecordProblem, theta: FloatArray | None = None) -> MeshErrors | str:
    """Mesh errors of a set-up's structure in the band of its record, or a text that says why they cannot be computed.

    They are evaluated at the free variables `theta`, (n_params,), by default at the initial values of the parameters.
    For a record of modes the band is 15 % wider at both ends, since the initial model may miss the measured modes by
    that.
    """
    low, high = float(problem.frequency.min()), float(problem.frequency.max())
    values = setup.parameters.values(
        setup.parameters.start if theta is None else problem.physical(theta)[: setup.parameters.n_params]
    )
    if not compares_modes(problem):
        return mesh_errors(setup.structure, values, (low, high))
    deviation = float((problem.data.frequency_std / problem.data.frequency).min())
    return mesh_errors(setup.structure, values, ((1 - _NEAR) * low, (1 + _NEAR) * high), deviation)


def mesh_warnings(
    setups: Sequence[AnySetup], problems: Sequence[RecordProblem], theta: Sequence[FloatArray]
) -> tuple[str, ...]:
    """Warnings that the mesh shifts modes by more than the standard deviations with which they were fitted.

    Only records of modes of structures up to 600 degrees of freedom are checked; FRFs and histories show a shift as a
    misfit. The three sequences have one entry for each record; `theta` holds the free variables of its problem,
    (n_params,). `setups` have the structures.
    """
    messages = []
    for setup, problem, theta_of_record in zip(setups, problems, theta, strict=True):
        if compares_modes(problem) and setup.structure.n_dofs <= _SMALL:
            errors = checked_mesh(setup, problem, theta_of_record)
            messages.append("" if isinstance(errors, str) else errors.words)
    return tuple(f"{MESH_ERROR}: {words}" for words in dict.fromkeys(messages) if words)


def _limit(frequency: FloatArray, refined_frequencies: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Natural frequencies (n,) extrapolated to elements of zero length, and the orders of convergence (n,).

    `frequency` (n,) are those of the present mesh, `refined_frequencies` one or two arrays (n,) for elements a half and a
    quarter as long. The order is between 1 and 6, and 2 where only one refinement is known or the changes are rounding.
    """
    first = frequency - refined_frequencies[0]
    order = np.full(len(frequency), _USUAL)
    last, change = refined_frequencies[0], first
    if len(refined_frequencies) == 2:
        second = refined_frequencies[0] - refined_frequencies[1]
        is_clear = (
            (np.abs(first) > _ROUNDING * frequency) & (np.abs(second) > _ROUNDING * frequency) & (first * second > 0)
        )
        ratio = np.divide(first, second, out=np.full(len(frequency), 2**_USUAL), where=is_clear)
        order = np.clip(np.log2(np.maximum(ratio, 1.0)), *_ORDERS)
        last, change = refined_frequencies[1], second
    return last - change / (2**order - 1), order


def _match_modes(
    structure: Structure,
    values: FloatArray,
    modes: Modes,
    mode_numbers: IntArray,
    refined: RefinedStructure,
    refined_modes: Modes,
) -> IntArray:
    """Number, from 0, of the refined model's mode that matches each of the modes `mode_numbers`; -1 without a match.

    Modes are paired one to one by MAC with the mass matrix at the present nodes, which must be at least 0.5, among
    those with frequencies within a factor of e. `modes` and `refined_modes` are those of the structure and of the
    `refined` one, `values` (n_values,) the property values.
    """
    rows = refined.places(structure)
    mass = structure.matrix("mass", values)
    coarse, fine = modes.mode_shapes[:, mode_numbers], refined_modes.mode_shapes[rows]
    size = np.einsum("dm,dm->m", fine, mass @ fine)
    likeness = (coarse.T @ (mass @ fine)) ** 2 / np.where(size > 0, size, 1.0)
    near = (
        np.abs(np.log(np.maximum(refined_modes.frequency, 1e-300) / modes.frequency[mode_numbers][:, None])) < _FARTHEST
    )
    likeness = np.where(near, likeness, 0.0)
    pairs: IntArray = np.full(len(mode_numbers), -1)
    left, right = assign_pairs(likeness)
    good = likeness[left, right] >= _ALIKE
    pairs[left[good]] = right[good]
    return pairs
