"""The no-U-turn sampler for a density whose covariance is roughly the unit matrix."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from structid.core.arrays import FloatArray
from structid.inversion.search.least_squares import StoredValues

#: Logarithm of a density and its gradient; minus infinity where there is none.
LogDensity = Callable[[FloatArray], tuple[float, FloatArray]]

_DIVERGED = 1000.0
_DEEPEST = 8


@dataclass(frozen=True, eq=False)
class Place:
    """Coordinates `x` (n_params,), the logarithm of the density there, and its gradient (n_params,)."""

    x: FloatArray
    log_density: float
    gradient: FloatArray


@dataclass(frozen=True, eq=False)
class _State:
    """A place on a trajectory, and the momentum `p` (n_params,) there."""

    at: Place
    p: FloatArray

    @property
    def energy(self) -> float:
        return -self.at.log_density + 0.5 * float(self.p @ self.p)


@dataclass(frozen=True, eq=False)
class _Tree:
    """A stretch of trajectory: its two ends, a state drawn from it by weight, and what rules its growth.

    `log_weight` is the logarithm of the sum of its weights and `momentum` (n_params,) the sum of its momenta;
    `stopped` and `diverged` say that it does not grow on. `acceptance` is the sum of the acceptance probabilities of
    `n_steps` steps.
    """

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
class StepSize:
    """Step size in dual averaging: logarithms of the present step, of its mean and of that which steps are drawn to.

    `error` is the mean amount, decaying with time, by which acceptance fell short of 80 %.
    """

    log_size: float
    log_mean: float
    error: float
    centre: float

    def after(self, i: int, accepted: float) -> StepSize:
        """Step size after draw `i` (from 0) of a phase, by dual averaging towards an acceptance of 80 %.

        `accepted` is the mean acceptance probability of the draw.
        """
        error = self.error + (0.8 - accepted - self.error) / (i + 11)
        log_size = float(self.centre - np.sqrt(i + 1) / 0.05 * error)
        return StepSize(
            log_size, self.log_mean + (log_size - self.log_mean) * float(i + 1) ** -0.75, error, self.centre
        )


@dataclass(frozen=True, eq=False)
class ChainState:
    """State of a chain between two draws: all that the next draws depend on, except the random numbers.

    Attributes
    ----------
    phase : int
        0 and 1 in the two halves of the warm-up, 2 while draws are kept.
    done : int
        Draws of this phase so far.
    at : Place
        In the coordinates y with `factor` y = x.
    factor : (n_params, n_params) float array
    step : StepSize
    warmup : (done, n_params) float array
        Draws of this phase, empty in the last one.
    n_gradients, n_divergent : int
        Evaluations of all phases; divergent draws of this one.
    acceptance : float
        Sum over the draws of this phase.
    """

    phase: int
    done: int
    at: Place
    factor: FloatArray
    step: StepSize
    warmup: FloatArray
    n_gradients: int
    n_divergent: int
    acceptance: float


def restored(kept: StoredValues) -> ChainState:
    """The state of which `dataclasses.asdict` was kept."""
    return ChainState(**{**kept, "at": Place(**kept["at"]), "step": StepSize(**kept["step"])})


def begun(log_density: LogDensity, start: FloatArray) -> ChainState:
    """The state of a chain before its first draw, at `start` (n_params,)."""
    return _phase(log_density, start, np.eye(len(start)), 0.5, 0, 0)


def continued(
    log_density: LogDensity, state: ChainState, n_warmup: int, n_draws: int, n: int, rng: np.random.Generator
) -> tuple[ChainState, FloatArray]:
    """Chain after at most `n` further draws of the no-U-turn sampler, and the kept draws, (at most n, n_params).

    Multinomial weights; the step size is adapted in the warm-up towards an acceptance of 80 %. After half of the warm-up the
    coordinates are scaled by the covariance of its draws. Kept draws are in these coordinates: `draws @ state.factor.T` are the
    samples, where `state` is the returned chain. The result does not depend on how the draws are divided into calls.

    Parameters
    ----------
    log_density : callable
        Log density and its gradient (n_params,) at x (n_params,); minus infinity where the density is 0.
    state : ChainState
        From `begun`, at a point of positive density, or from an earlier call.
    n_warmup, n_draws : int
        Length of the warm-up, whose draws are not kept, and number of draws kept by the whole chain.
    n : int
        Most draws of this call, warm-up included.
    rng : numpy Generator

    References
    ----------
    Hoffman and Gelman (2014), J. Mach. Learn. Res. 15, algorithm 6; Betancourt (2017), arXiv:1701.02434, A.3.
    """
    lengths = (n_warmup // 2, n_warmup - n_warmup // 2, n_draws)
    kept: list[FloatArray] = []
    with np.errstate(over="ignore", invalid="ignore"):
        while True:
            while state.phase < 2 and state.done == lengths[state.phase]:
                state = _next_phase(log_density, state)
            if n == 0 or state.done == lengths[state.phase]:
                return state, np.array(kept).reshape(len(kept), len(state.at.x))
            state, n = _draw_next(log_density, state, rng), n - 1
            if state.phase == 2:
                kept.append(state.at.x)


def _phase(
    log_density: LogDensity, x: FloatArray, factor: FloatArray, size: float, phase: int, spent: int
) -> ChainState:
    """Chain state before the first draw of a phase; the log density is evaluated once.

    `x` (n_params,) is the place in the coordinates of the phase, `factor` (n_params, n_params) takes these to the
    parameters, `size` is the first step size, `phase` 0 to 2, and `spent` the number of gradients so far.
    """
    value, gradient = _in_coordinates(log_density, factor, phase)(x)
    step = StepSize(float(np.log(size)), float(np.log(size)), 0.0, float(np.log(10 * size)))
    return ChainState(phase, 0, Place(x, value, gradient), factor, step, np.zeros((0, len(x))), spent + 1, 0, 0.0)


def _next_phase(log_density: LogDensity, state: ChainState) -> ChainState:
    """Chain state at the start of the next phase, with coordinates and step size from the draws of this one.

    Phases are 0 and 1, the halves of the warm-up, and 2, the kept draws. The coordinates are changed after phase 0
    only, to those in which its draws without the first quarter have about unit covariance; they stay if there is no
    more than one such draw. `log_density` gives the log density and its gradient, which are evaluated once.
    """
    size, x, factor = float(np.exp(state.step.log_mean)), state.at.x, state.factor
    if state.phase == 0:
        kept = state.warmup[len(state.warmup) // 4 :]
        if len(kept) > 1:
            factor = np.linalg.cholesky(_shrunk_covariance(kept))
        x = np.linalg.solve(factor, x)
    return _phase(log_density, x, factor, size, state.phase + 1, state.n_gradients)


def _in_coordinates(log_density: LogDensity, factor: FloatArray, phase: int) -> LogDensity:
    """Log density and gradient by coordinates y, with x = `factor` y; `log_density` of x itself in phase 0.

    `factor` is (n_params, n_params).
    """
    if phase == 0:
        return log_density

    def turned(y: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = log_density(factor @ y)
        return value, factor.T @ gradient

    return turned


def _shrunk_covariance(draws: FloatArray) -> FloatArray:
    """Sample covariance (n_params, n_params) of `draws` (n_draws, n_params), drawn to the unit matrix by five draws' weight."""
    n, dimension = draws.shape
    covariance = np.cov(draws, rowvar=False).reshape(dimension, dimension)
    return (n * covariance + 5 * np.eye(dimension)) / (n + 5)


def _draw_next(log_density: LogDensity, state: ChainState, rng: np.random.Generator) -> ChainState:
    """Chain state after one more draw of its phase; in the warm-up also with an adapted step size.

    `log_density` gives the log density and its gradient; `rng` draws the momentum and the trajectory.
    """
    density = _in_coordinates(log_density, state.factor, state.phase)
    tree = _trajectory(density, state.at, float(np.exp(state.step.log_size)), rng)
    accepted = tree.acceptance / max(tree.n_steps, 1)
    moved = replace(
        state, done=state.done + 1, at=tree.drawn.at, n_gradients=state.n_gradients + tree.n_steps,
        n_divergent=state.n_divergent + tree.diverged, acceptance=state.acceptance + accepted,
    )  # fmt: skip
    if state.phase == 2:
        return moved
    warmup = np.concatenate([state.warmup, moved.at.x[None]])
    return replace(moved, step=state.step.after(state.done, accepted), warmup=warmup)


def _trajectory(log_density: LogDensity, start: Place, size: float, rng: np.random.Generator) -> _Tree:
    """Binary tree of leapfrog steps from `start` with a new random momentum, doubled until it turns back or diverges.

    `log_density` gives density and gradient, `size` is the step size; there are at most eight doublings. The next draw
    of the chain is `_Tree.drawn`, with the momentum that it has there. `rng` gives momentum, directions and choices.
    """
    begin = _State(start, rng.standard_normal(len(start.x)))
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
        tree = _join_trees(counted, grown, sign, grown.drawn if takes_new else tree.drawn)
        if tree.stopped:
            break
    return tree


def _grown(
    log_density: LogDensity, end: _State, step: float, depth: int, energy: float, rng: np.random.Generator
) -> _Tree:
    """Tree of 2^`depth` leapfrog steps from the state `end`, built recursively; shorter if it turns back or diverges.

    `step` is the step size, negative for backward. `energy` is that of the start of the trajectory: a state has the
    weight exp(`energy` - its energy), and an energy larger by more than 1000, or a density that is not finite, is a
    divergence. `rng` draws the state that stands for the tree, by weight. `log_density` gives the log density and its
    gradient.
    """
    if depth == 0:
        half = end.p + 0.5 * step * end.at.gradient
        x = end.at.x + step * half
        value, gradient = log_density(x)
        state = _State(Place(x, value, gradient), half + 0.5 * step * gradient)
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
    return _join_trees(both, far, sign, far.drawn if takes_far else near.drawn)


def _join_trees(near: _Tree, far: _Tree, sign: int, drawn: _State) -> _Tree:
    """Tree of two adjoining trajectories, `far` ahead of `near` in the direction `sign` (1 or -1).

    Step counts and acceptance are those of `near`. `drawn` is the state chosen from both. The result is `stopped` if the joined
    trajectory turns back.
    """
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
