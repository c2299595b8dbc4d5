"""Rauch-Tung-Striebel smoother of outputs over a record, and what the record leaves open of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from structid.core.arrays import FloatArray, square_root
from structid.dynamics.exact_discretization import stepped
from structid.prediction.poles import ReducedMatrices
from structid.prediction.sensing.forces import ForceProcess
from structid.prediction.sensing.kalman_filter import Filtered, sum_of_powers
from structid.prediction.sensing.setup import SensingSetup
from structid.prediction.sensing.state_equations import state_equations, symmetric

#: Part of the variance far from the ends, below which what is missing at the end of the record no longer counts.
_SETTLED = 1e-4
#: Part of the variance that the start of a record adds, below which what it leaves at the end does not count.
_CONVERGED = 1e-12
#: Samples that are worked on together.
_BLOCK = 256


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Mean and variance (n_times, n) of wanted outputs, left-out sensors, unknown forces; covariance (n, n) inside it."""

    mean: FloatArray
    variance: FloatArray
    covariance: FloatArray


def smooth(setup: SensingSetup, fit: Filtered) -> Smoothed:
    """Smoothed wanted outputs, left-out sensors and unknown forces, in this order, with their variance at each sample.

    Mean and variance are (n_times, n); the variance is larger near the ends of the record. The covariance (n, n) is the
    one far from the ends. `fit` is the Kalman filter run over the record.
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
    """Smoothed outputs (n_times, n), and the smoother gain (n_states, n_states).

    Outputs are in order the wanted ones, left-out sensors and unknown forces. The gain is the factor by which the error
    of a later state corrects the state one sample before. `fit` is the Kalman filter run over the record.
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
    has_late = np.abs(late @ excess @ late.T).max() > _CONVERGED * np.abs(onwards @ excess @ onwards.T).max()
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
