"""Sets of values that fit the data equally well, side by side, and the measurement that would tell them apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from structid.core.arrays import FloatArray, locked
from structid.core.display import format_number
from structid.core.dof import Dof
from structid.dynamics import Modes
from structid.forward import RecordProblem
from structid.forward.modal import compares_modes
from structid.identification.joint_problem import indices_of
from structid.identification.record_fit import structure_modes
from structid.inversion import Estimate

#: Differences that a test resolves with ease: of a frequency in parts of it, of the angle of a pair of shape entries in rad.
_FREQUENCY, _ANGLE = 0.01, 0.1
#: Places among which the deciding pair is sought, modes beyond the highest measured one, and sets that the words predict.
_MOST_PLACES, _MODES_BEYOND, _MOST_TOLD = 40, 2, 6


@dataclass(frozen=True)
class DecidingMeasurement:
    """Measurement that would distinguish sets of values which fit the data equally well.

    Attributes
    ----------
    name : str
        Such as ``the shape of mode 2 at 3X over that at 1X``.
    unit : str
    predicted : tuple of float
        What each set of values predicts.
    """

    name: str
    unit: str
    predicted: tuple[float, ...]

    @property
    def words(self) -> str:
        """The measurement's name, and the value with unit that each of the first six sets predicts of it.

        A count stands for further sets.
        """
        predictions = ", ".join(format_number(value, 3) for value in self.predicted[:_MOST_TOLD])
        more = len(self.predicted) - _MOST_TOLD
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.name}: {predictions}{f' and {more} more' if more > 0 else ''}{unit}"


@dataclass(frozen=True, eq=False)
class Alternatives:
    """Sets of values that fit the data equally well.

    Attributes
    ----------
    names, units : tuple of str
        Of the parameters.
    values : (n_sets, n_params) float array
        Physical values; the first set is that of the estimate, then the nearest to the start.
    cost : (n_sets,) float array
        Sum of squares of each, priors included.
    n_searches : tuple of int
        How many searches ended at each.
    is_exhaustive : bool
        Whether searches from wide starts went on until no more sets were to be expected.
    measured : str
        What was measured, in words.
    deciding : DecidingMeasurement or None
        None where the structure has no modes of its own.
    chosen_by_priors : bool
        Whether they fit the data alone, and priors choose the first.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    cost: FloatArray
    n_searches: tuple[int, ...]
    is_exhaustive: bool
    measured: str
    deciding: DecidingMeasurement | None
    chosen_by_priors: bool = False

    def __len__(self) -> int:
        return len(self.values)

    @property
    def words(self) -> str:
        """A clause with the number of sets of values and the measurement that would decide among them.

        Without such a measurement it says to give a prior or measure more, or nothing if priors choose the first set.
        """
        least = "" if self.is_exhaustive else "at least "
        which = "of which priors choose the first" if self.chosen_by_priors else "which fit equally well"
        if self.deciding is None:
            decides = "" if self.chosen_by_priors else "; give a prior, or measure more"
        else:
            decides = f"; what would decide: {self.deciding.words}"
        return f"{self.measured} alone allow {least}{len(self)} sets of values, {which}{decides}"

    @property
    def search_words(self) -> str:
        """A sentence on how many searches ended at the sets, and whether more sets are to be expected."""
        total = f"{sum(self.n_searches)} searches ended at these sets"
        if self.is_exhaustive:
            return f"{total}, from starts a factor of up to five away, and no more sets are to be expected"
        return f"{total}; there may be more: raise `wide_starts` to look for them"


def alternatives(
    estimate: Estimate, problems: Sequence[RecordProblem], without_priors: Estimate | None = None
) -> Alternatives | None:
    """Sets of values that fit the data equally well; None if there is only one.

    The first set is the estimate; the others follow by their relative distance from the initial values.

    Parameters
    ----------
    estimate : Estimate
        The first set, and the answers of all searches.
    problems : sequence of RecordProblem
        Problems of all records.
    without_priors : Estimate, optional
        Estimate from the data alone, whose sets are taken where the estimate with priors has a single one.
    """
    by_priors = without_priors is not None and estimate.search.n_fitting < 2
    searched = without_priors if by_priors and without_priors is not None else estimate
    fitting = [answer for answer in searched.search.answers if answer.fits]
    if len(fitting) < 2:
        return None
    if by_priors:
        fitting.sort(key=lambda answer: _relative_distance(answer.values, estimate.values))
    start = np.asarray(estimate.initial)
    others = sorted(fitting[1:], key=lambda answer: _relative_distance(answer.values, start))
    values = np.array([estimate.values, *(answer.values for answer in others)])
    return Alternatives(
        names=estimate.names,
        units=estimate.units,
        values=locked(values),
        cost=locked([answer.cost for answer in (fitting[0], *others)]),
        n_searches=tuple(answer.n_searches for answer in (fitting[0], *others)),
        is_exhaustive=searched.search.is_exhaustive,
        chosen_by_priors=by_priors,
        measured=_measured_words(problems),
        deciding=deciding_measurement(estimate.names, values, problems[0]),
    )


def _relative_distance(values: FloatArray, start: FloatArray) -> float:
    """Norm of the relative differences between `values` and `start`, (n_params,) each; absolute where the start is 0."""
    scale = np.where(start != 0, np.abs(start), 1.0)
    return float(np.linalg.norm((values - start) / scale))


def _measured_words(problems: Sequence[RecordProblem]) -> str:
    """The measured quantities as the subject of a sentence.

    They are "these modes" or "these frequencies" (modes without shapes) if all problems compare modes, else "these
    data".
    """
    modal = [problem for problem in problems if compares_modes(problem)]
    if len(modal) == len(problems):
        return "these modes" if any(problem.data.has_shapes for problem in modal) else "these frequencies"
    return "these data"


def deciding_measurement(
    names: tuple[str, ...], values: FloatArray, problem: RecordProblem
) -> DecidingMeasurement | None:
    """Measurement that differs most between the sets of values: a natural frequency, or a ratio of shape entries.

    The frequency is one that was not measured. None if the structure has no modes of its own or no candidate exists.
    Modes go up to two beyond the measured ones.

    Parameters
    ----------
    names : tuple of str
        Names of all parameters, in the order of `values`.
    values : (n_sets, n_params) float array
        Physical values.
    problem : RecordProblem
        That of the first record, with its structure.
    """
    if not problem.structure.has_modes:
        return None
    of_problem = values[:, indices_of(names, problem.names)]
    n_measured = problem.data.measured.size if compares_modes(problem) else 0
    count = max(n_measured, 1) + _MODES_BEYOND
    sets = [structure_modes(problem.structure, problem.property_values(each), count) for each in of_problem]
    n_modes = min(len(each.frequency) for each in sets)
    candidates = [_shape_candidate(problem.structure.dofs, sets, mode) for mode in range(n_modes)]
    if n_measured:
        candidates += [_frequency_candidate(sets, mode) for mode in range(n_measured, n_modes)]
    seen = [candidate for candidate in candidates if candidate is not None]
    return max(seen, key=lambda candidate: candidate[0])[1] if seen else None


def _frequency_candidate(sets: Sequence[Modes], mode: int) -> tuple[float, DecidingMeasurement]:
    """Smallest relative gap between the sets in the frequency of a mode, over 1 %, and the frequency as a measurement.

    `mode` counts from 0.
    """
    frequency = np.array([each.frequency[mode] for each in sets])
    gap = float(np.diff(np.sort(np.log(np.maximum(frequency, np.finfo(float).tiny)))).min())
    return gap / _FREQUENCY, DecidingMeasurement(f"the frequency of mode {mode + 1}", "Hz", tuple(frequency.tolist()))


def _shape_candidate(dofs: Sequence[Dof], sets: Sequence[Modes], mode: int) -> tuple[float, DecidingMeasurement] | None:
    """Smallest gap between the sets in the ratio of two shape entries of a mode, and that ratio as a measurement.

    The gap is that of the angle of the pair of entries, in multiples of 0.1 rad; the pair with the largest gap is
    taken, among at most 40 translations. `sets` are the modes for each set of values, `dofs` the degrees of freedom of
    their shapes, and `mode` counts from 0. None with fewer than two translations, or if a shape is zero.
    """
    moving = np.array([i for i, dof in enumerate(dofs) if not dof.is_rotation], dtype=int)
    if len(moving) < 2:
        return None
    moving = moving[np.unique(np.linspace(0, len(moving) - 1, _MOST_PLACES).astype(int))]
    shapes = np.array([each.mode_shapes[moving, mode] for each in sets])
    size = np.abs(shapes).max(axis=1, keepdims=True)
    if not (size > 0).all():
        return None
    shapes = shapes / size
    angles = (
        np.arctan2(shapes[:, :, None], shapes[:, None, :]) % np.pi
    )  # of each pair of places, whatever the sign of the shape
    ordered = np.sort(angles, axis=0)
    gaps = np.diff(np.concatenate([ordered, ordered[:1] + np.pi]), axis=0).min(axis=0)
    gaps[np.diag_indices(len(moving))] = 0.0
    first, second = np.unravel_index(int(np.argmax(gaps)), gaps.shape)
    if np.abs(shapes[:, first]).min() > np.abs(shapes[:, second]).min():
        first, second = second, first
    with np.errstate(divide="ignore"):
        ratio = shapes[:, first] / shapes[:, second]
    above, below = dofs[moving[first]].place, dofs[moving[second]].place
    name = f"the shape of mode {mode + 1} at {above} over that at {below}"
    return float(gaps[first, second]) / _ANGLE, DecidingMeasurement(name, "", tuple(ratio.tolist()))
