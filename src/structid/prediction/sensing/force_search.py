"""The likeliest process of unknown forces: its size, correlation time, order and frequency."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import signal
from scipy.optimize import minimize, minimize_scalar

from structid.core.arrays import FloatArray
from structid.core.errors import NoAnswerError
from structid.prediction.poles import ReducedMatrices
from structid.prediction.sensing.kalman_filter import filter_record, fit_record, log_likelihood, steady_filter
from structid.prediction.sensing.state_equations import (
    HIGHEST_ORDER,
    ForceProcess,
    SensingSetup,
    StateEquations,
    state_equations,
    stationary_covariance,
)

#: Orders of magnitude below and above a first guess of the unknown forces between which their size is sought, to what part of one;
#: of free structures, whose motion hardly says the size, as many above as below.
_BELOW, _ABOVE, _SURE = 2.0, 0.5, 0.01
#: Shortest correlation time that is sought, in samples, and number of times with which the search begins.
_SHORTEST, _TIMES = 0.1, 12
#: Segments of which the spectrum of forces is averaged to see their frequency, and evaluations that its search may take.
_SEGMENTS, _MOST_TRIALS = 8, 80
#: Samples of a record, and of each segment, that tell a frequency at all.
_FEWEST = 16
#: Longest correlation time of forces about a frequency, in lengths of the record: nearly a sine.
_LONGEST = 10.0
#: Steps towards shorter times, each by this factor, and by how much (log) the record may get less likely: that of chance.
_SHORTER, _STEPS, _LESS_LIKELY = 0.8, 18, 2.0


@dataclass(frozen=True)
class ChosenForces:
    """The process that unknown forces are taken to be, stated or estimated.

    Attributes
    ----------
    process : ForceProcess
    is_trusted : bool
        False where the likeliest size runs into its upper limit, and the size of the motion decides instead.
    greatest : float
        Logarithm of the greatest likelihood of the record that the search met, less a constant; it may exceed that of the
        chosen forces. NaN where nothing was sought.
    """

    process: ForceProcess
    is_trusted: bool = True
    greatest: float = float("nan")


def likeliest_std(setup: SensingSetup, reduced: ReducedMatrices, process: ForceProcess) -> ChosenForces:
    """Forces of the spectrum of `process`, of the standard deviation under which the record of `setup` is likeliest.

    The standard deviation (N) is sought from 0.01 to 3 times (100 times for a free structure) that which makes the
    measured motion, since a model whose resonances are off by a part of their width makes far larger forces likelier.
    Where the search runs into its upper limit, the size of the motion decides instead, and the result is not trusted.
    The greatest log-likelihood is returned too. `reduced` is the structure on its modes, inputs known forces, then
    unknown ones.
    """
    size, above = _first_std(setup, reduced, process), _decades_above(reduced)
    search = minimize_scalar(
        lambda decades: -log_likelihood(setup, reduced, replace(process, std=float(size * 10**decades))),
        bounds=(-_BELOW, above),
        method="bounded",
        options={"xatol": _SURE},
    )
    if search.x > above - 3 * _SURE:
        return ChosenForces(replace(process, std=size), False, -float(search.fun))
    return ChosenForces(replace(process, std=float(size * 10**search.x)), True, -float(search.fun))


def likeliest_time(
    setup: SensingSetup, reduced: ReducedMatrices, process: ForceProcess, std: float | None, is_near: bool = False
) -> ChosenForces:
    """Forces of the order of `process`, of an estimated correlation time and standard deviation.

    From the likeliest time and size on, the shortest time is taken under which the logarithm of the record's likelihood
    is at most 2 below the greatest: accelerations hardly tell slow forces from none. It is bisected, as if the record
    got less and less likely with shorter times; where it does not, a still shorter time may serve as well. The size
    falls with the time to the power `order` - 1/2, so that the spectral density at high frequencies stays; a stated
    `std`, N, is kept, None is estimated. Where the estimate runs into its upper limit, the size of the motion decides
    instead, and the result is not trusted. The search goes through all times first, unless that of `process` `is_near`.
    `reduced` is the structure on its modes.
    """
    shortest, longest = np.log(_SHORTEST / setup.rate), np.log(len(setup.channels.measured) / setup.rate / 4)
    above = _decades_above(reduced)

    def of_time(log_time: float, size: float) -> ForceProcess:
        return replace(process, correlation_time=float(np.exp(log_time)), std=size)

    def of_point(log_time: float, decades: float) -> ForceProcess:
        unit = of_time(log_time, 1.0)
        return replace(unit, std=float((_first_std(setup, reduced, unit) if std is None else std) * 10**decades))

    def likelihood(log_time: float, decades: float) -> float:
        return log_likelihood(setup, reduced, of_point(log_time, decades))

    def unlikely(point: FloatArray) -> float:
        log_time, decades = float(point[0]), float(point[1])
        is_within = shortest <= log_time <= longest and -_BELOW <= decades <= above
        return -likelihood(log_time, decades) if is_within else float("inf")

    times = np.linspace(shortest, longest, _TIMES).tolist()
    if is_near:
        first = float(np.clip(np.log(process.correlation_time), shortest, longest))
    else:
        by_motion = [likelihood(time, 0.0) for time in times]
        first = times[int(np.argmax(by_motion))]
        if max(by_motion) == -np.inf:
            fit_record(setup, reduced, of_point(first, 0.0))  # raises, with the reason
    if std is None:
        simplex = np.array(
            [[first, 0.0], [first + (times[0] - times[1]) * (1 if first > shortest else -1), 0.0], [first, -0.3]]
        )
        options = {"initial_simplex": simplex, "xatol": _SURE, "fatol": 0.1, "maxfev": 60}
        search = minimize(unlikely, simplex[0], method="Nelder-Mead", options=options)
        log_time, decades = search.x.tolist()
        if decades > above - 3 * _SURE:
            return ChosenForces(of_point(first, 0.0), False, -float(search.fun))
        largest = of_point(log_time, decades).std
    else:
        beside = max(first + times[0] - times[1], shortest), min(first + times[1] - times[0], longest)
        search = minimize_scalar(
            lambda log_time: -likelihood(log_time, 0.0), bounds=beside, method="bounded", options={"xatol": _SURE}
        )
        log_time, largest = float(search.x), std
    most = -float(search.fun)

    def shortened(step: int) -> ForceProcess:
        # with the same density beyond the correlation time
        smaller = largest * _SHORTER ** (step * (process.order - 0.5)) if std is None else std
        return of_time(log_time + step * np.log(_SHORTER), float(smaller))

    longest_step = min(_STEPS, max(int(np.ceil((shortest - log_time) / np.log(_SHORTER))) - 1, 0))
    likely, unlikely_from = 0, longest_step + 1
    while unlikely_from - likely > 1:
        step = (likely + unlikely_from) // 2
        if log_likelihood(setup, reduced, shortened(step)) >= most - _LESS_LIKELY:
            likely = step
        else:
            unlikely_from = step
    return ChosenForces(shortened(likely), True, most)


def likeliest_order(setup: SensingSetup, reduced: ReducedMatrices, chosen: ChosenForces) -> ChosenForces | None:
    """Forces whose spectrum falls more steeply, where the record is likelier under them by more than chance; else None.

    By more than chance is a log-likelihood above the greatest so far by over 2. They have a correlation time and a size
    too, so that nothing else is weighed. The order is raised from that of `chosen` one by one while the record gets
    likelier so and the size is not decided by a limit. `reduced` is the structure on its modes.
    """
    best = chosen
    while best.process.order < HIGHEST_ORDER:
        steeper = replace(best.process, order=best.process.order + 1)
        steeper_choice = likeliest_time(setup, reduced, steeper, None, is_near=True)
        if not (steeper_choice.is_trusted and steeper_choice.greatest > best.greatest + _LESS_LIKELY):
            break
        best = steeper_choice
    return None if best is chosen else best


def likeliest_frequency(
    setup: SensingSetup, reduced: ReducedMatrices, chosen: ChosenForces, forces: FloatArray
) -> ChosenForces | None:
    """Forces of a spectrum of first order about the likeliest frequency; None where the frequency is not worth a parameter.

    The search starts at the largest line of the `forces` (n_times, n_forces) that were sensed without a frequency, with
    the likeliest of a few correlation times. Searches with and without a frequency have a correlation time and a size;
    the frequency is one parameter more, which must raise the greatest log-likelihood by half the logarithm of n_times:
    Schwarz (1978), Annals of Statistics 6, 461-464. None also below 16 samples, and where the likeliest forces would
    move the sensors by far more than the record: such forces hide any model error. `reduced` is the structure on its
    modes, `chosen` the forces without a frequency.
    """
    count, rate = len(forces), setup.rate
    if count < _FEWEST:
        return None
    lines, power = signal.welch(forces, rate, nperseg=max(count // _SEGMENTS, _FEWEST), axis=0)
    peak = float(lines[1:][np.argmax(power[1:].sum(axis=1))])
    first, above = float(forces.std()), _decades_above(reduced)

    def of_point(point: FloatArray) -> ForceProcess:
        time, frequency, size = np.exp(point).tolist()
        return ForceProcess(time, size, frequency)

    def unlikely(point: FloatArray) -> float:
        """Negative log-likelihood of the record under forces of `point`, logarithms (3,) of time, frequency, size.

        Infinite for a time outside 0.1 samples to ten records, a frequency from half the sampling rate on, where the
        forces would move the sensors by more than 3 times (100 times for a free structure) what the record shows, or
        without a filter.
        """
        is_within = _SHORTEST / rate <= np.exp(point[0]) <= _LONGEST * count / rate and np.exp(point[1]) < rate / 2
        if not is_within:
            return float("inf")
        process = of_point(point)
        try:
            system = state_equations(setup, reduced, process)
            if not process.std < _std_of_motion(setup, system, process.std) * 10**above:
                return float("inf")
            return -filter_record(setup, steady_filter(setup, system)).log_likelihood
        except (NoAnswerError, np.linalg.LinAlgError):
            return float("inf")

    def first_point(time: float) -> FloatArray:
        """Logarithms (3,) of a correlation `time` (s), the frequency of the peak (Hz) and a size of the forces (N).

        The size is the lesser of that of the forces sensed before and that which makes the measured motion; the former
        alone where the latter cannot be found.
        """
        process = of_point(np.log([time, peak, first]))
        try:
            return np.log([time, peak, min(process.std, _first_std(setup, reduced, process))])
        except (NoAnswerError, np.linalg.LinAlgError):
            return np.log([time, peak, process.std])

    times = 1 / peak, np.sqrt(count / rate / peak), count / rate / 2
    start = min(map(first_point, times), key=unlikely)
    simplex = start + np.vstack([np.zeros(3), np.diag([-0.7, 0.02, 0.3])])
    options = {"initial_simplex": simplex, "xatol": _SURE, "fatol": 0.1, "maxfev": _MOST_TRIALS}
    search = minimize(unlikely, start, method="Nelder-Mead", options=options)
    likeliest = -float(search.fun)
    is_worth = likeliest > chosen.greatest + 0.5 * np.log(count)
    process = of_point(search.x)
    if not is_worth or not process.std < _first_std(setup, reduced, process) * 10 ** (above - 3 * _SURE):
        return None
    return ChosenForces(process, True, likeliest)


def _first_std(setup: SensingSetup, reduced: ReducedMatrices, process: ForceProcess) -> float:
    """First guess of the standard deviation of unknown forces of the spectrum of `process`, N, from the measured motion.

    Sensors that the forces hardly move hardly count. `NoAnswerError` if no sensor moves with them.
    """
    return _std_of_motion(setup, state_equations(setup, reduced, replace(process, std=1.0)), 1.0)


def _std_of_motion(setup: SensingSetup, system: StateEquations, std: float) -> float:
    """Standard deviation of the unknown forces, N, that makes the measured motion; `std` is that of `system`, N.

    The record's mean squares are fitted over the sensors of `setup`. `NoAnswerError` if no sensor moves with the
    forces.
    """
    covariance = stationary_covariance(system, system.noise, len(setup.channels.measured))
    made = np.einsum("ij,jk,ik->i", system.reading, covariance, system.reading) / std**2
    if not system.n_combined or not made.max() > 0:
        raise NoAnswerError(
            "no sensor moves with the unknown forces, so that their size cannot be told; state it, or use other sensors"
        )
    return float(np.sqrt(max(float(setup.channels.readings.var(axis=0) @ made), 1.0) / float(made @ made)))


def _decades_above(reduced: ReducedMatrices) -> float:
    """Orders of magnitude above a first guess of the unknown forces up to which their size is sought."""
    return _BELOW if reduced.is_rigid.any() else _ABOVE
