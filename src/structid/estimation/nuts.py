"""The no-U-turn sampler for a density whose covariance is roughly the unit matrix."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from structid.arrays import FloatArray

#: Logarithm of a density and its gradient; minus infinity where there is none.
LogDensity = Callable[[FloatArray], tuple[float, FloatArray]]

_DIVERGED = 1000.0
_DEEPEST = 8


@dataclass(frozen=True, eq=False)
class _State:
    """A place on a trajectory: position, momentum, logarithm of the density and its gradient."""

    x: FloatArray
    p: FloatArray
    log_density: float
    gradient: FloatArray

    @property
    def energy(self) -> float:
        return -self.log_density + 0.5 * float(self.p @ self.p)


@dataclass(frozen=True, eq=False)
class _Tree:
    """A stretch of trajectory: its ends, a state drawn from it by weight, and what rules its growth."""

    backward: _State
    forward: _State
    drawn: _State
    log_weight: float
    momentum: FloatArray
    stopped: bool
    diverged: bool
    acceptance: float
    n_steps: int


@dataclass(frozen=True, eq=False)
class NutsChain:
    """One chain.

    Attributes
    ----------
    draws : (n_draws, n_params) float array
    n_divergent : int
        Draws whose trajectory left the energy by more than 1000.
    step_size : float
    acceptance : float
        Mean over the draws.
    n_gradients : int
        Evaluations, warm-up included.
    """

    draws: FloatArray
    n_divergent: int
    step_size: float
    acceptance: float
    n_gradients: int


def nuts_chain(
    log_density: LogDensity, start: FloatArray, n_warmup: int, n_draws: int, rng: np.random.Generator
) -> NutsChain:
    """Draws by the no-U-turn sampler with multinomial weights; the step size is set in the warm-up, to accept 80 %.

    Half-way through the warm-up the coordinates are turned and scaled by the covariance of the draws so far.

    Parameters
    ----------
    log_density : callable
    start : (n_params,) float array
        Where the density is not 0.
    n_warmup, n_draws : int
    rng : numpy Generator

    References
    ----------
    Hoffman and Gelman (2014), J. Mach. Learn. Res. 15, algorithm 6; Betancourt (2017), arXiv:1701.02434, A.3.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        return _chain(log_density, start, n_warmup, n_draws, rng)


def _chain(
    log_density: LogDensity, start: FloatArray, n_warmup: int, n_draws: int, rng: np.random.Generator
) -> NutsChain:
    first, size, spent, _, _ = _phase(log_density, start, n_warmup // 2, 0.5, True, rng)
    kept = first[len(first) // 4 :]
    factor = np.linalg.cholesky(_shrunk_covariance(kept)) if len(kept) > 1 else np.eye(len(start))

    def turned(y: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = log_density(factor @ y)
        return value, factor.T @ gradient

    y = np.linalg.solve(factor, first[-1] if len(first) else start)
    second, size, more, _, _ = _phase(turned, y, n_warmup - n_warmup // 2, size, True, rng)
    y = second[-1] if len(second) else y
    draws, _, most, n_divergent, acceptance = _phase(turned, y, n_draws, size, False, rng)
    return NutsChain(draws @ factor.T, n_divergent, size, acceptance, spent + more + most)


def _shrunk_covariance(draws: FloatArray) -> FloatArray:
    """Sample covariance drawn to the unit matrix by the weight of five draws."""
    n, dimension = draws.shape
    covariance = np.cov(draws, rowvar=False).reshape(dimension, dimension)
    return (n * covariance + 5 * np.eye(dimension)) / (n + 5)


def _phase(
    log_density: LogDensity, x: FloatArray, n_draws: int, size: float, adapt: bool, rng: np.random.Generator
) -> tuple[FloatArray, float, int, int, float]:
    """Draws, step size, gradients spent, divergent draws and mean acceptance of one phase."""
    draws = np.zeros((n_draws, len(x)))
    value, gradient = log_density(x)
    state = _State(x, np.zeros_like(x), value, gradient)
    log_size, log_mean, error = np.log(size), np.log(size), 0.0
    centre, spent, n_divergent, total = np.log(10 * size), 1, 0, 0.0
    for i in range(n_draws):
        tree = _trajectory(log_density, state, float(np.exp(log_size)), rng)
        state, draws[i] = tree.drawn, tree.drawn.x
        spent, n_divergent = spent + tree.n_steps, n_divergent + tree.diverged
        accepted = tree.acceptance / max(tree.n_steps, 1)
        total += accepted
        if adapt:
            error += (0.8 - accepted - error) / (i + 11)
            log_size = centre - np.sqrt(i + 1) / 0.05 * error
            log_mean += (log_size - log_mean) * (i + 1) ** -0.75
    return draws, float(np.exp(log_mean)), spent, n_divergent, total / max(n_draws, 1)


def _trajectory(log_density: LogDensity, state: _State, size: float, rng: np.random.Generator) -> _Tree:
    """A trajectory doubled until it turns back, from a fresh momentum."""
    begin = replace(state, p=rng.standard_normal(len(state.x)))
    tree = _Tree(begin, begin, begin, 0.0, begin.p, False, False, 0.0, 0)
    for depth in range(_DEEPEST):
        sign = 1 if rng.random() < 0.5 else -1
        grown = _grown(log_density, tree.forward if sign > 0 else tree.backward, sign * size, depth, begin.energy, rng)
        counted = replace(
            tree, acceptance=tree.acceptance + grown.acceptance, n_steps=tree.n_steps + grown.n_steps,
            diverged=grown.diverged,
        )  # fmt: skip
        if grown.stopped:
            return counted
        takes_new = np.log(rng.random()) < grown.log_weight - tree.log_weight
        tree = _joined(counted, grown, sign, grown.drawn if takes_new else tree.drawn)
        if tree.stopped:
            break
    return tree


def _grown(
    log_density: LogDensity, end: _State, step: float, depth: int, energy: float, rng: np.random.Generator
) -> _Tree:
    """2^depth leapfrog steps on from `end`."""
    if depth == 0:
        half = end.p + 0.5 * step * end.gradient
        x = end.x + step * half
        value, gradient = log_density(x)
        state = _State(x, half + 0.5 * step * gradient, value, gradient)
        gain = energy - state.energy if np.isfinite(value) else -np.inf
        diverged = not gain > -_DIVERGED
        return _Tree(state, state, state, gain, state.p, diverged, diverged, min(1.0, float(np.exp(min(gain, 0.0)))), 1)
    near = _grown(log_density, end, step, depth - 1, energy, rng)
    if near.stopped:
        return near
    sign = 1 if step > 0 else -1
    far = _grown(log_density, near.forward if sign > 0 else near.backward, step, depth - 1, energy, rng)
    both = replace(near, acceptance=near.acceptance + far.acceptance, n_steps=near.n_steps + far.n_steps)
    if far.stopped:
        return replace(both, stopped=True, diverged=far.diverged)
    takes_far = np.log(rng.random()) < far.log_weight - np.logaddexp(near.log_weight, far.log_weight)
    return _joined(both, far, sign, far.drawn if takes_far else near.drawn)


def _joined(near: _Tree, far: _Tree, sign: int, drawn: _State) -> _Tree:
    """Two neighbouring stretches as one, `far` ahead of `near` in the direction `sign`; counts are those of `near`."""
    early, late = (near, far) if sign > 0 else (far, near)
    momentum = near.momentum + far.momentum
    turned = _turns(momentum, early.backward, late.forward)
    turned |= _turns(early.momentum + late.backward.p, early.backward, late.backward)
    turned |= _turns(late.momentum + early.forward.p, early.forward, late.forward)
    return replace(
        near, backward=early.backward, forward=late.forward, drawn=drawn, momentum=momentum, stopped=turned,
        log_weight=float(np.logaddexp(near.log_weight, far.log_weight)),
    )  # fmt: skip


def _turns(momentum: FloatArray, first: _State, last: _State) -> bool:
    return bool(momentum @ first.p <= 0 or momentum @ last.p <= 0)
