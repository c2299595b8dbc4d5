"""Kalman filter with steady gains over a record, its likelihood and its innovations, and the Rauch-Tung-Striebel smoother.

The smoother gives outputs over the record, and what the record leaves open of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from structid.core.arrays import FloatArray, square_root
from structid.core.errors import NoAnswerError
from structid.dynamics.exact_discretization import stepped
from structid.prediction.poles import ReducedMatrices
from structid.prediction.sensing.innovations import Innovations
from structid.prediction.sensing.state_equations import (
    ForceProcess,
    SensingSetup,
    StateEquations,
    state_equations,
    stationary_covariance,
    symmetric,
)

#: By how much rounding may let an error of a state seem to grow from reading to reading; more is a filter that has lost its digits.
_UNSTABLE = 1e-9
#: Times that a matrix is squared to see that its powers fade.
_SQUARINGS = 12
#: Largest doublings of the number of samples after which the covariance must have settled, and by what part it may still grow.
_DOUBLINGS, _CONVERGED = 40, 1e-12
#: Size of known forces, and of motion without unknown ones, before a record over that in it.
_BEFORE = 10.0
#: Standard deviation that a direction of the sensors is left open by, over that of their noise, from which on forces reach it.
_OPEN = 0.3


@dataclass(frozen=True, eq=False)
class SteadyFilter:
    """A Kalman filter with steady gains, as far as all readings under the same known forces share it.

    Attributes
    ----------
    system : StateEquations
    entered : (n_times - 1, n_states) float array
        Effect of the known forces on the states from sample to sample.
    gain : (n_states, n_used) float array
        K, the steady gain.
    predicted, updated : (n_states, n_states) float arrays
        Steady covariances before and after a reading.
    keep, step : (n_states, n_states) float arrays
        I - K C, what a reading leaves of an error before it, and A (I - K C), what is left of it before the next reading; A is
        the transition and C reads the state.
    sizes : (n_used,) float array
        Variances of the innovations in the directions in which they are independent, ascending.
    whiten : (n_used, n_used) float array
        These directions, one a column, over the standard deviations.
    seen : (n_used, n_states) float array
        Reads the state in these directions.
    information : (n_states, n_states) float array
        That of all readings on an error of the first state.
    first : (n_states, n_states) float array
        Covariance of the first state, of what known and unknown forces made before the record.
    free : (n_states, n_states) float array or None
        Covariance of modes that moved by themselves, but for its size, which the readings give; None with unknown forces.
    """

    system: StateEquations
    entered: FloatArray
    gain: FloatArray
    predicted: FloatArray
    updated: FloatArray
    keep: FloatArray
    step: FloatArray
    sizes: FloatArray
    whiten: FloatArray
    seen: FloatArray
    information: FloatArray
    first: FloatArray
    free: FloatArray | None


@dataclass(frozen=True, eq=False)
class Filtered:
    """States of a Kalman filter over a record.

    Attributes
    ----------
    steady : SteadyFilter
    from_rest : (n_times, n_states) float array
        Mean before the reading of each sample if the first one were 0.
    start : (n_states,) float array
        Mean that the whole record gives the first state before its reading.
    read : (n_times, n_used) float array
        Readings without what known forces make in them at once, in standard deviations of their noise.
    start_covariance : (n_states, n_states) float array
        What the record leaves open of the first state, beyond the steady covariance before a reading.
    log_likelihood : float
        Of the record, less a constant.
    """

    steady: SteadyFilter
    from_rest: FloatArray
    start: FloatArray
    read: FloatArray
    start_covariance: FloatArray
    log_likelihood: float

    def before(self) -> FloatArray:
        """Mean of the state before the reading of each sample, (n_times, n_states), in its scaled units."""
        at_rest = np.zeros_like(self.from_rest[1:])
        return self.from_rest + stepped(self.steady.step, at_rest, self.start)

    def prediction_errors(self) -> FloatArray:
        """Readings less those expected from the samples before, in standard deviations of their noise, (n_times, n_used)."""
        return self.read - self.before() @ self.steady.system.reading.T


def fit_record(setup: SensingSetup, reduced: ReducedMatrices, process: ForceProcess) -> Filtered:
    """The record of `setup`, filtered under the equations of a structure whose unknown forces are `process`.

    `reduced` is the structure on its modes.
    """
    return filter_record(setup, steady_filter(setup, state_equations(setup, reduced, process)))


def log_likelihood(setup: SensingSetup, reduced: ReducedMatrices, process: ForceProcess) -> float:
    """Logarithm of the likelihood of the record, less a constant; -inf where the filter has no steady gains."""
    try:
        return fit_record(setup, reduced, process).log_likelihood
    except NoAnswerError:
        return -np.inf


def steady_filter(setup: SensingSetup, system: StateEquations) -> SteadyFilter:
    """The part of a Kalman filter under the equations `system` that all readings under the known forces share.

    It holds gains and covariances once they have settled, and those of the first state. Before the record known forces
    count as noise of ten times their size, since nobody knows what they did then. `setup` has the record and its forces.

    Raises `NoAnswerError` if the sensors see too little or the filter loses its digits.
    """
    n_samples = len(setup.channels.measured)
    predicted = _predicted_covariance(system)
    innovation = system.reading @ predicted @ system.reading.T + np.eye(len(system.reading))
    gain = np.linalg.solve(innovation, system.reading @ predicted).T
    keep = np.eye(len(predicted)) - gain @ system.reading
    step = system.transition @ keep
    sizes, directions = np.linalg.eigh(innovation)
    if not (sizes[0] > 0 and _fades(step)):
        raise NoAnswerError(
            "the forces move the sensors by so much more than the noise that is stated that the filter loses its digits; state"
            " the noise that the sensors really have"
        )
    whiten = directions / np.sqrt(sizes)
    seen = whiten.T @ system.reading
    constant, rising = np.hsplit(system.entry, 2)
    pushed = _BEFORE * (constant + rising) * np.sqrt(np.mean(setup.channels.known**2, axis=0))
    return SteadyFilter(
        system,
        np.asarray(np.hstack([setup.driving[:-1], setup.driving[1:]]) @ system.entry.T),
        gain,
        predicted,
        predicted - gain @ innovation @ gain.T,
        keep,
        step,
        sizes,
        whiten,
        seen,
        symmetric(sum_of_powers(step.T, seen.T @ seen, step, n_samples)),
        stationary_covariance(system, system.noise + pushed @ pushed.T, n_samples),
        None if setup.n_forces else stationary_covariance(system, np.eye(len(predicted)), n_samples),
    )


def filter_record(setup: SensingSetup, steady: SteadyFilter) -> Filtered:
    """Kalman filter over the record of `setup`: means from sample to sample, initial state and log-likelihood.

    Means (n_times, n_states) are those before each reading if the first state were 0; the initial state has mean and
    covariance by the whole record. The log-likelihood lacks a constant. A record begins in motion: its initial state
    has the stationary covariance. That is the covariance of the steady filter and an independent part, on which all
    innovations depend linearly: de Jong (1991), Annals of Statistics 19, 1073-1083.
    """
    system, step, rest = steady.system, steady.step, np.zeros(len(steady.step))
    read = setup.channels.readings - setup.channels.known @ system.direct.T
    drive = read[:-1] @ (system.transition @ steady.gain).T + steady.entered
    from_rest = stepped(step, drive, rest)
    error = (read - from_rest @ system.reading.T) @ steady.whiten
    root = square_root(_first_covariance(setup, steady) - steady.predicted)
    score = root.T @ stepped(step.T, (error @ steady.seen)[::-1], rest)[-1]
    posterior = np.eye(root.shape[1]) + root.T @ steady.information @ root
    start = np.linalg.solve(posterior, np.column_stack([score, root.T]))
    likelihood = 0.5 * (score @ start[:, 0] - (error**2).sum() - np.linalg.slogdet(posterior)[1])
    return Filtered(
        steady,
        from_rest,
        root @ start[:, 0],
        read,
        symmetric(root @ start[:, 1:]),
        float(likelihood - 0.5 * len(read) * np.log(steady.sizes).sum()),
    )


def innovations_of(fit: Filtered) -> Innovations:
    """Readings less those that the filter expects from the samples before."""
    steady, n = fit.steady, len(fit.steady.sizes)
    return Innovations(
        fit.prediction_errors() @ steady.whiten,
        np.arange(n) >= n - steady.system.n_combined,
        steady.sizes > 1 + _OPEN**2,
    )


def simulate_record(setup: SensingSetup, fit: Filtered, rng: np.random.Generator) -> SensingSetup:
    """A setup whose measured channels are random: a record that the model of `fit` could have given.

    The known forces stay those of the record; the first state, noise of the sensors and unknown forces are drawn from `rng`.
    """
    steady, system, channels = fit.steady, fit.steady.system, setup.channels
    of_start, of_noise = square_root(steady.predicted + fit.start_covariance), square_root(system.noise)
    first = fit.start + of_start @ rng.standard_normal(of_start.shape[1])
    drive = rng.standard_normal((len(channels.known) - 1, of_noise.shape[1])) @ of_noise.T
    states = stepped(system.transition, drive + steady.entered, first)
    noise = rng.standard_normal(channels.readings.shape)
    read = states @ system.reading.T + channels.known @ system.direct.T + noise
    return replace(setup, channels=replace(channels, measured=read * np.sqrt(channels.variance)))


def _first_covariance(setup: SensingSetup, steady: SteadyFilter) -> FloatArray:
    """Covariance (n_states, n_states) of the state at the start of the record.

    It is the stationary covariance under all forces, which `steady` has. Without unknown forces that of free vibration
    is added, scaled so that the sensors read ten times what they read in the record.
    """
    free, reading = steady.free, steady.system.reading
    if free is None:
        return steady.first
    made = np.einsum("ij,jk,ik->i", reading, free, reading)
    seen = np.mean(setup.channels.readings**2, axis=0)
    return steady.first + _BEFORE**2 * float(seen @ made) / max(float(made @ made), np.finfo(float).tiny) * free


def _predicted_covariance(system: StateEquations) -> FloatArray:
    """Covariance (n_states, n_states) of the state before each reading, once it has settled.

    Chu, Fan, Lin and Wang (2004), Int. J. Control 77, 767-788, Algorithm 3.1: P = A P (I + C' C P)^-1 A' + Q by doubling the
    number of samples. `NoAnswerError` if it does not settle.
    """
    step: FloatArray = system.transition.T
    seen: FloatArray = system.reading.T @ system.reading
    covariance = system.noise
    one = np.eye(len(step))
    for _ in range(_DOUBLINGS):
        after, read = np.hsplit(np.linalg.solve(one + seen @ covariance, np.hstack([step, seen @ step.T])), 2)
        grown = np.asarray(step.T @ covariance @ after)
        seen, step = symmetric(seen + step @ read), np.asarray(step @ after, dtype=np.float64)
        covariance = symmetric(covariance + grown)
        if not np.isfinite(covariance).all():
            break
        if np.abs(grown).max() <= _CONVERGED * np.abs(covariance).max():
            return covariance
    raise NoAnswerError("these sensors do not tell the motion: none of them sees one of the modes; measure more places")


def _fades(step: FloatArray) -> bool:
    """True if the powers of a matrix (n, n) fade, or grow by no more than rounding makes them.

    A power of norm below 1 proves it, and a few products are cheaper than the eigenvalues.
    """
    power = step
    for _ in range(_SQUARINGS):
        size = float(np.linalg.norm(power))
        if size < 1:
            return True
        if not size < 1 / np.finfo(float).eps:
            break
        power = power @ power
    return bool(np.abs(np.linalg.eigvals(step)).max() < 1 + _UNSTABLE)


def sum_of_powers(left: FloatArray, middle: FloatArray, right: FloatArray, count: int = 2**_DOUBLINGS) -> FloatArray:
    """Sum over k from 0 to count - 1 of left^k middle right^k, by doubling, so that no digits cancel.

    All are (n, n). The default `count` is large enough for the infinite sum, if the powers fade.
    """
    total, before, after = np.zeros_like(middle), np.eye(len(left)), np.eye(len(right))
    for digit in f"{count:b}":
        total, before, after = total + before @ total @ after, before @ before, after @ after
        if digit == "1":
            total, before, after = middle + left @ total @ right, before @ left, after @ right
    return total


#: Part of the variance far from the ends, below which what is missing at the end of the record no longer counts.
_SETTLED = 1e-4
#: Part of the variance that the start of a record adds, below which what it leaves at the end does not count.
_NEGLIGIBLE = 1e-12
#: Samples that are worked on together.
_BLOCK = 256


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Mean and variance (n_times, n) of wanted outputs, left-out sensors, unknown forces, in this order and SI units.

    `covariance` (n, n) is that far from the ends of the record.
    """

    mean: FloatArray
    variance: FloatArray
    covariance: FloatArray


def smooth(setup: SensingSetup, fit: Filtered) -> Smoothed:
    """Smoothed wanted outputs, left-out sensors and unknown forces, in this order, with their variance at each sample.

    Mean and variance are (n_times, n), in SI units; the variance is larger near the ends of the record. The covariance
    (n, n) is the one far from the ends. `fit` is the Kalman filter run over the record of `setup`.
    """
    (mean, back), steady = smoothed_outputs(setup, fit), fit.steady
    predicted, updated, rows = steady.predicted, steady.updated, steady.system.wanted
    covariance = symmetric(linalg.solve_discrete_lyapunov(back, updated - back @ predicted @ back.T))
    wanted = rows @ covariance @ rows.T
    variance = np.tile(np.maximum(np.diag(wanted), 0.0), (len(mean), 1))
    unmoved = steady.system.unmoved
    at_end = _variance_beside_end(rows, back, updated - covariance, variance)[::-1]
    onwards = sum_of_powers(back, steady.keep - back @ steady.step, steady.step)
    at_start = _variance_of_start(rows, onwards, back, fit, variance)
    return Smoothed(mean, variance + at_end + at_start + np.diag(unmoved), wanted + unmoved)


def smoothed_outputs(setup: SensingSetup, fit: Filtered) -> tuple[FloatArray, FloatArray]:
    """Smoothed outputs (n_times, n), SI units, and the smoother gain (n_states, n_states).

    Outputs are in order the wanted ones, left-out sensors and unknown forces. The gain is the factor by which the error
    of a later state, in the scaled units of the filter, corrects the state one sample before. `fit` is the Kalman
    filter run over the record.
    """
    steady, system, before = fit.steady, fit.steady.system, fit.before()
    back = np.linalg.solve(steady.predicted, system.transition @ steady.updated).T
    after = before @ steady.keep.T + fit.read @ steady.gain.T
    drive = (after[:-1] - before[1:] @ back.T)[::-1]
    smoothed = stepped(back, drive, after[-1])[::-1]
    return smoothed @ system.wanted.T + setup.channels.known @ system.wanted_direct.T, back


def error_spectra(
    setup: SensingSetup, reduced: ReducedMatrices, process: ForceProcess, frequency: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Spectral densities of outputs under the unknown forces, and of their error, (n_frequencies, n_outputs) each.

    Outputs are in order the wanted ones, left-out sensors and unknown forces; densities are up to one factor.
    `frequency` is in Hz. The second is the error of the smoother far from the ends of a record. `process` is that of
    each unknown force. `reduced` is the structure on its modes.
    """
    system = state_equations(setup, reduced, process)
    root = square_root(system.noise).astype(complex)
    before, after = np.zeros((2, len(frequency), len(system.wanted)))
    for k, point in enumerate(np.exp(2j * np.pi * frequency / setup.rate)):
        states = np.linalg.solve(point * np.eye(len(root)) - system.transition, root)
        read, wanted = system.reading @ states, system.wanted @ states
        both = wanted @ read.conj().T
        before[k] = (np.abs(wanted) ** 2).sum(axis=1)
        told = np.linalg.solve(np.eye(len(read)) + read @ read.conj().T, both.conj().T)
        after[k] = np.maximum(before[k] - np.einsum("ij,ji->i", both, told).real, 0.0)
    return before, after


def _variance_beside_end(wanted: FloatArray, step: FloatArray, excess: FloatArray, steady: FloatArray) -> FloatArray:
    """Excess of the variance of outputs over the `steady` one near an end of the record, (n_times, n), from the end inwards.

    The outputs are `wanted` (n, n_states) times the state, whose covariance at the end exceeds the steady one by `excess`
    (n_states, n_states); each sample inwards multiplies the error of the state by `step` (n_states, n_states).
    """
    beyond, rows = np.zeros_like(steady), wanted
    for k in range(len(beyond)):
        beyond[k] = np.maximum(np.einsum("ij,jk,ik->i", rows, excess, rows, optimize=True), 0.0)
        if (beyond[k] <= _SETTLED * steady[k]).all():
            break
        rows = rows @ step
    return beyond


def _variance_of_start(
    wanted: FloatArray, onwards: FloatArray, back: FloatArray, filtered: Filtered, steady: FloatArray
) -> FloatArray:
    """Excess of the variance of outputs, (n_times, n), by what the record leaves open of its first state.

    In a record without end an error of the first state leaves `onwards` (n_states, n_states) of itself when all readings from
    it onwards are smoothed. Of N samples the smoothed state k is off by onwards step^k + back^(N-1-k) (keep - onwards)
    step^(N-1) times that error. `wanted` (n, n_states) reads the outputs from the state, `back` is the smoother gain, and
    `steady` (n_times, n) the variance without this excess.
    """
    step, excess, count = filtered.steady.step, filtered.start_covariance, len(steady)
    late = (filtered.steady.keep - onwards) @ np.linalg.matrix_power(step, count - 1)
    beyond, early = np.zeros_like(steady), (wanted @ onwards).T
    has_late = np.abs(late @ excess @ late.T).max() > _NEGLIGIBLE * np.abs(onwards @ excess @ onwards.T).max()
    for first in range(0, count, _BLOCK):
        size = min(_BLOCK, count - first)
        nothing = np.zeros((size, *early.shape))
        columns = stepped(step.T, nothing, early)
        columns, early = columns[:-1], columns[-1]
        if has_late:
            from_end = (wanted @ np.linalg.matrix_power(back, count - first - size)).T
            columns = columns + late.T @ stepped(back.T, nothing[1:], from_end)[::-1]
        beyond[first : first + size] = np.maximum(np.einsum("kji,kji->ki", excess @ columns, columns), 0.0)
        if not has_late and (beyond[first + size - 1] <= _SETTLED * steady[0]).all():
            break
    return beyond
