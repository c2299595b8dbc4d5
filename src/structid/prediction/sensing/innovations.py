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
#: The same for a contradiction where the drawn models differ and errors are correlated in time. Right models that are known within
#: 1 % make up to 1.2 under forces of a narrow spectrum, which the replicates do not have, with bands that hold; wrong ones whose
#: bands miss the truth by more than three deviations made 2 or more.
_CLEARLY_LARGER = 1.5
#: Least excess of `foretold_part` over that of replicates that counts.
_FORETOLD = 0.05
#: The same for directions in which another spectrum of the forces, or more noise, shows too: these make about 0.5, wrong models
#: more than 3.
_CLEARLY_FORETOLD = 1.0
#: Standard deviation of the noise of a sensor over that of its readings, where the record states none.
ASSUMED_NOISE = 0.01
#: Prediction errors as a part of the readings from which on they are no noise of sensors, stated or not.
_NO_NOISE = 0.5


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
    """Mean square of whitened innovations (n_times, n): 1 where the model and its noise are right."""
    return float(np.mean(whitened**2))


def foretold_part(whitened: FloatArray) -> float:
    """Sum over lags of squared correlations between innovations `whitened` (n_times, n) and earlier ones, over n.

    Lags run to 50 samples, or a quarter of the record if that is less. Where it is small it is about the part of their
    variance that a linear prediction from earlier ones would remove; it may exceed 1. Chance alone makes it n n_lags /
    n_times. Hosking (1980), J. Am. Stat. Assoc. 75, 602-608.
    """
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
    has_stated_noise: bool,
    is_distributed: bool,
    spread: FloatArray,
) -> InnovationVerdict:
    """Verdict on the innovations of a record, compared with those of `replicates`, records simulated by plausible models.

    It says whether they contradict the model, and has a sentence on the first thing found, be it a contradiction, a doubt or a
    note; "" if nothing is.

    There are two replicates or more, of as many samples and of the same directions. Unforced directions contradict the model if
    their innovations are larger by 20 %, or are correlated in time; open ones among them only if they are clearly correlated.
    Between 1.2 and 2.5 times the size is a doubt in their stead where the uncertainty of the model may make the excess:
    innovations are correlated in time, as those of a narrow spectrum are, and the excess is less than three deviations of them
    among models within the uncertainty. Where the record does not state the noise of its sensors (`has_stated_noise` false),
    only clear correlation, and errors of half of the readings or more, contradict the model: the rest may be noise. Forced
    directions, and weak correlation in open ones, contradict it only where all directions are forced, and are a note elsewhere.
    Nothing contradicts it where more independent unknown forces act than sensors measure (`is_distributed`).

    `spread` (n,) is the root mean square, over samples and models within the uncertainty, of their innovations of the record less
    those of the filter, in the directions of `record`; 0 where the model is exact.

    Mehra and Peschon (1971), Automatica 7, 637-640 (innovations as a test); Rubin (1984), Annals of Statistics 12, 1151-1172
    (replicates within the uncertainty).
    """
    forced, open_alone = record.is_forced, record.is_open & ~record.is_forced

    def columns(chosen: npt.NDArray[np.bool_]) -> tuple[FloatArray, list[FloatArray]]:
        return record.whitened[:, chosen], [item.whitened[:, chosen] for item in replicates]

    # each is "" where nothing is found; the first finding is told
    clear = _correlated(*columns(~forced), _CLEARLY_FORETOLD)
    is_lenient = has_stated_noise and _may_be_uncertainty(*columns(~forced), spread[~forced])
    least = _CLEARLY_LARGER if is_lenient else _LARGER
    doubt = _larger(*columns(~forced))
    unforced = _larger(*columns(~forced), least) or _correlated(*columns(~forced & ~open_alone)) or clear
    of_forces = _larger(*columns(forced)) or _correlated(*columns(forced)) or _correlated(*columns(open_alone))
    found = unforced or doubt or of_forces
    if is_distributed and found:
        return InnovationVerdict(
            False,
            f"the model is wrong, or the unknown forces have another spectrum than the one that is taken here:"
            f" {found}; more unknown forces than sensors cannot tell which, and bands may miss the truth; compare"
            " with a sensor that is left out",
        )
    is_assumed = not (has_stated_noise or _larger(*columns(~forced), _NO_NOISE / ASSUMED_NOISE - 1))
    if unforced and not clear and is_assumed:
        return InnovationVerdict(
            False,
            f"{unforced}, and no choice of these forces explains it; the record states no noise, so that"
            f" {100 * ASSUMED_NOISE:g} % of each sensor's reading was assumed: state the noise; if it is not that large, the model"
            " is wrong, and bands may miss the truth",
        )
    if unforced:
        noise = (
            "than stated" if has_stated_noise else f"than the {100 * ASSUMED_NOISE:g} % of its reading that is assumed"
        )
        return InnovationVerdict(
            True,
            f"the model does not explain the record: {unforced}, and no choice of these forces explains it; the model is wrong,"
            f" a force acts where none is named, or the sensors have more noise {noise}, and bands may miss the truth",
        )
    if doubt:
        return InnovationVerdict(
            False,
            f"{doubt}, and no choice of these forces explains it: a model that is right within its uncertainty does so under"
            " forces of a narrow spectrum, but it may be wrong, a force may act where none is named, or the sensors may have more"
            " noise than stated, and the bands may be too narrow by that factor; compare with a sensor that is left out",
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


def _larger(whitened: FloatArray, replicates: Sequence[FloatArray], least: float = _LARGER) -> str:
    """Words on whitened innovations (n_times, n) that are significantly larger than those of replicates; else "".

    Their mean square must exceed that of each replicate, and in logarithms the mean by three standard deviations; their
    root mean square must exceed the geometric mean of those of replicates by more than the part `least` of it.
    `replicates` are two arrays like `whitened` or more. "" too if n is 0.
    """
    if not whitened.size:
        return ""
    square, usual = mean_square(whitened), [mean_square(item) for item in replicates]
    ratio = np.sqrt(square / _geometric_mean(usual))
    if _is_beyond(square, usual) and ratio > 1 + least:
        return f"the prediction errors of the sensors are {ratio:.2g} times as large as they should be"
    return ""


def _correlated(whitened: FloatArray, replicates: Sequence[FloatArray], least: float = _FORETOLD) -> str:
    """Words on whitened innovations (n_times, n) that are more correlated in time than those of replicates, else "".

    The sum of squared correlations with earlier ones, over n, must exceed those of all replicates, in logarithms their
    mean by three standard deviations, and their mean by more than `least`; "" too if n is 0. `replicates` are two
    arrays like `whitened` or more.
    """
    if not whitened.size:
        return ""
    part, usual = foretold_part(whitened), [foretold_part(item) for item in replicates]
    if _is_beyond(part, usual) and part - np.mean(usual) > least:
        return "the prediction errors of the sensors are correlated in time, and should be white noise"
    return ""


def _may_be_uncertainty(whitened: FloatArray, replicates: Sequence[FloatArray], spread: FloatArray) -> bool:
    """True if the uncertainty of the model may make whitened innovations (n_times, n) larger than those of replicates.

    They are then no white noise, whose sum of squared correlations has the mean n n_lags / n_times and the variance 2
    n_lags / n_times^2, and their excess in mean square is less than nine times that of `spread` (n,), the deviation of
    innovations among models within the uncertainty. False if n is 0.
    """
    if not whitened.size:
        return False
    count, n = whitened.shape
    n_lags = _n_lags(count)
    correlated = foretold_part(whitened) - n * n_lags / count
    usual = _geometric_mean([mean_square(item) for item in replicates])
    is_within = mean_square(whitened) - usual < _SIGNIFICANT**2 * np.mean(spread**2)
    return bool(is_within and correlated > max(_FORETOLD, _SIGNIFICANT * np.sqrt(2 * n_lags) / count))


def _n_lags(count: int) -> int:
    return min(_LAGS, count // 4)


def _geometric_mean(values: Sequence[float]) -> float:
    return float(np.exp(np.mean(np.log(values))))


def _is_beyond(value: float, usual: Sequence[float]) -> bool:
    """True if a value exceeds all of `usual`, and its logarithm the mean of theirs by more than three deviations.

    `usual` are two positive values or more.
    """
    if not value > max(usual):
        return False
    logs = np.log(usual)
    return bool(np.log(value) > logs.mean() + _SIGNIFICANT * logs.std(ddof=1))
