"""Innovations of a Kalman filter, and what their size and their correlation in time say against its model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from structid.core.arrays import FloatArray

#: Longest lag, in samples, over which innovations are correlated with earlier ones; at most a quarter of the record.
_LAGS = 50
#: Standard deviations, of the logarithms over replicates, by which a value must lie above their mean.
_SIGNIFICANT = 3.0
#: Least relative excess of the size of innovations over that of replicates that counts.
_LARGER = 0.2
#: Deviations by which the likeliest model may be off from the identified one, or as far as those of replicates if that is more, and
#: least ratio of its distance to this that counts.
_PLAUSIBLE, _FARTHER = 3.0, 2.0
#: Least excess of `foretold_part` over that of replicates that counts.
_FORETOLD = 0.05
#: The same for directions in which another spectrum of the forces, or more noise, shows too: these make about 0.5, wrong models
#: more than 3.
_CLEARLY_FORETOLD = 1.0


@dataclass(frozen=True, eq=False)
class Innovations:
    """Readings of sensors less those that a filter expects from earlier samples: white, of unit variance, if its model is right.

    Attributes
    ----------
    whitened : (n_times, n) float array
        In the directions in which the expected errors are independent, over their standard deviations.
    is_forced : (n,) bool array
        Directions in which unknown forces contribute most of the expected error, one for each force.
    is_open : (n,) bool array
        Directions in which the expected error exceeds the noise of the sensors, so that the spectrum of the forces counts in them
        too: a force that varies between samples moves the sensors in more than one direction. Forced ones may be among them.
    """

    whitened: FloatArray
    is_forced: npt.NDArray[np.bool_]
    is_open: npt.NDArray[np.bool_]


def mean_square(whitened: FloatArray) -> float:
    """Mean square of whitened innovations (n_times, n): 1 where the model and its noise are right; 0 if n is 0."""
    return float(np.mean(whitened**2)) if whitened.size else 0.0


def foretold_part(whitened: FloatArray) -> float:
    """Squared correlations of innovations `whitened` (n_times, n) with earlier ones, summed over lags and directions, over n.

    Lags run to `_LAGS` samples, or a quarter of the record if that is less. Where it is small it is about the part of their
    variance that a linear prediction from earlier ones would remove; it may exceed 1. Chance alone makes it n n_lags /
    n_times; it is 0 if n is 0. Hosking (1980), J. Am. Stat. Assoc. 75, 602-608.
    """
    if not whitened.size:
        return 0.0
    rms = np.sqrt(np.mean(whitened**2, axis=0))
    scaled = whitened / np.where(rms > 0, rms, 1.0)
    count, n = scaled.shape
    lags = range(1, _n_lags(count) + 1)
    return float(sum(((scaled[:-lag].T @ scaled[lag:] / count) ** 2).sum() for lag in lags) / n)


@dataclass(frozen=True)
class InnovationVerdict:
    """A verdict by the innovations of a record on the model of its filter and the spectrum of its forces.

    Attributes
    ----------
    is_contradicted : bool
        True where innovations that no force can make alone are too large or correlated in time, by more than the uncertainty of the
        model and an unknown noise of the sensors may make, so that the model or the stated noise is wrong or a force acts where
        none is named; and where every direction is forced and those of the forces are. Never with more forces than sensors.
    words : str
        A sentence on what is wrong or may be, also where `is_contradicted` is False; "" where nothing is.
    """

    is_contradicted: bool
    words: str


def judge_innovations(
    record: Innovations,
    replicates: Sequence[Innovations],
    apart: FloatArray,
    has_stated_noise: bool,
    is_distributed: bool,
) -> InnovationVerdict:
    """Verdict on the innovations of a record, compared with those of `replicates`, records simulated by plausible models.

    There are two replicates or more, of as many samples and of the same directions. `apart` (n_models, n_times, n) are the
    innovations of the record under models within the uncertainty less those of the filter; n_models is 0 for an exact model.

    Of unforced directions what the likeliest model within the uncertainty explains is taken away first, for the record and for each
    replicate: a right model makes large and correlated innovations under forces of a narrow spectrum, such as a sine at a
    resonance. They contradict the model if what remains is larger by 20 %; if it is correlated in time in
    directions that are not open; if it is clearly correlated in any; or if that model is farther from the identified one than its
    uncertainty lets it be. Where the record
    does not state the noise of its sensors (`has_stated_noise` false), only clear correlation does: the rest may be noise. Forced
    directions, and weak correlation in open ones, contradict the model only where all directions are forced, and are a note
    elsewhere. Nothing contradicts it where more independent unknown forces act than sensors measure (`is_distributed`).

    Mehra and Peschon (1971), Automatica 7, 637-640 (innovations as a test); Rubin (1984), Annals of Statistics 12, 1151-1172
    (replicates within the uncertainty).
    """
    forced, open_alone = record.is_forced, record.is_open & ~record.is_forced

    all_records = [record.whitened, *(item.whitened for item in replicates)]

    def squares(chosen: npt.NDArray[np.bool_]) -> list[float]:
        return [mean_square(item[:, chosen]) for item in all_records]

    def parts(whitened: Sequence[FloatArray], chosen: npt.NDArray[np.bool_]) -> list[float]:
        return [foretold_part(item[:, chosen]) for item in whitened]

    # each is "" where nothing is found; the first finding is told
    remaining = [_Remaining.of(item, apart, ~forced) for item in all_records]
    rests = [item.whitened for item in remaining]
    clear = _correlated(parts(rests, ~forced), _CLEARLY_FORETOLD)
    unforced = (
        _larger([item.size for item in remaining])
        or _correlated(parts(rests, ~forced & ~open_alone))
        or clear
        or _too_far([item.distance for item in remaining])
    )
    of_forces = (
        _larger(squares(forced))
        or _correlated(parts(all_records, forced))
        or _correlated(parts(all_records, open_alone))
    )
    found = unforced or of_forces
    if is_distributed and found:
        return InnovationVerdict(
            False,
            f"the model is wrong, or the unknown forces have another spectrum than the one that is taken here:"
            f" {found}; more unknown forces than sensors cannot tell which, and bands may miss the truth; compare"
            " with a sensor that is left out",
        )
    if unforced and not clear and not has_stated_noise:
        return InnovationVerdict(
            False,
            f"{unforced}, in what no choice of these forces explains: the record states no noise, and 1 % of what each sensor"
            " reads was taken; state it, for either it is another one, or the model is wrong, and bands may miss the truth",
        )
    if unforced:
        return InnovationVerdict(
            True,
            f"the model does not explain the record: {unforced}, in what no choice of these forces explains; the model is wrong,"
            " a force acts where none is named, or the sensors have more noise than stated, and bands may miss the truth",
        )
    if of_forces and forced.all():
        return InnovationVerdict(
            True,
            f"the model does not explain the record: {of_forces}; the model is wrong, or the unknown forces have another spectrum"
            " than that of their correlation time, and these sensors cannot tell which: use more sensors than unknown forces",
        )
    if of_forces and open_alone.any():
        return InnovationVerdict(
            False,
            f"the model is wrong, or the unknown forces have another spectrum than the one that is taken here: {of_forces}; forces"
            " that vary between samples move all of these sensors by more than their noise, so that they cannot tell which;"
            " compare with a sensor that is left out",
        )
    if of_forces:
        return InnovationVerdict(
            False,
            f"the unknown forces have another spectrum than the one that is taken here: {of_forces}; what the sensors say"
            " beyond the forces agrees with the model, but bands of forces may be too wide or too narrow",
        )
    return InnovationVerdict(False, "")


@dataclass(frozen=True, eq=False)
class _Remaining:
    """Innovations without the part that the likeliest model within the uncertainty explains.

    Attributes
    ----------
    whitened : (n_times, n) float array
    size : float
        Mean square of them, and of the distance, a value that counts: 1 where models and noise are right, 0 if none counts.
    distance : float
        Of that model from the identified one, in deviations.
    """

    whitened: FloatArray
    size: float
    distance: float

    @classmethod
    def of(cls, whitened: FloatArray, apart: FloatArray, counted: npt.NDArray[np.bool_]) -> _Remaining:
        """Innovations `whitened` (n_times, n), to which models within the uncertainty add `apart` (n_models, n_times, n).

        Directions that are `counted` (n,) tell the model. The uncertainty is the sample covariance of the models, in which
        innovations are linear: Evensen (2003), Ocean Dynamics 53, 343-367.
        """
        values, effects = whitened[:, counted].ravel(), apart / np.sqrt(max(len(apart), 1))
        columns = effects[..., counted].reshape(len(apart), values.size)
        weights = np.linalg.solve(columns @ columns.T + np.eye(len(columns)), columns @ values)
        square = float(np.sum((values - weights @ columns) ** 2) + weights @ weights)
        rest = whitened - np.tensordot(weights, effects, axes=1)
        return cls(rest, square / max(values.size, 1), float(np.sqrt(weights @ weights)))


def _too_far(distances: Sequence[float]) -> str:
    """Words on a record, the first of `distances` (deviations), that asks for a model much farther off than all others do, else "".

    That is more than twice as far as any of them, or as three deviations.
    """
    ratio = distances[0] / max(*distances[1:], _PLAUSIBLE)
    if ratio > _FARTHER:
        return f"the record asks for a model that is {ratio:.2g} times as far off as any that is plausible"
    return ""


def _larger(squares: Sequence[float]) -> str:
    """Words on innovations whose mean square, the first, is significantly larger than those of replicates; "" where it is not.

    Its root must also exceed the geometric mean of theirs by 20 %. "" too where it is 0.
    """
    square, usual = squares[0], squares[1:]
    if not square > 0:
        return ""
    ratio = np.sqrt(square / _geometric_mean(usual))
    if _is_beyond(square, usual) and ratio > 1 + _LARGER:
        return f"the prediction errors of the sensors are {ratio:.2g} times as large as they should be"
    return ""


def _correlated(parts: Sequence[float], least: float = _FORETOLD) -> str:
    """Words on innovations whose `foretold_part`, the first, is larger than those of replicates, else "".

    `least` is the least excess over the mean of theirs that counts.
    """
    part, usual = parts[0], parts[1:]
    if part > 0 and _is_beyond(part, usual) and part - np.mean(usual) > least:
        return "the prediction errors of the sensors are correlated in time, and should be white noise"
    return ""


def _n_lags(count: int) -> int:
    return min(_LAGS, count // 4)


def _geometric_mean(values: Sequence[float]) -> float:
    return float(np.exp(np.mean(np.log(values))))


def _is_beyond(value: float, usual: Sequence[float]) -> bool:
    """True if a positive value exceeds all of `usual`, and its logarithm the mean of theirs by more than three deviations."""
    if not value > max(usual):
        return False
    logs = np.log(usual)
    return bool(np.log(value) > logs.mean() + _SIGNIFICANT * logs.std(ddof=1))
