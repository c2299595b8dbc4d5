"""Linear structures from sample to sample without discretization error, and the derivatives of that step.

The state z = [scale q; dq/dt] in modal coordinates q of the undamped structure obeys dz/dt = A z + B f. A generator
makes the force between samples (constant, straight, or an oscillation), so that one matrix exponential of the wide
system holds transition and input exactly (Van Loan 1978), and its Frechet derivative holds their sensitivities.

References
----------
Van Loan (1978), IEEE Trans. Automatic Control 23, 395-404. Al-Mohy and Higham (2009), SIAM J. Matrix Anal. Appl. 30,
1639-1657: derivative of the exponential by scaling and squaring.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.core.arrays import FloatArray

_LARGEST_NORM = 0.5
_TAYLOR_ORDER = 14  # 0.5^15 / 15! = 2e-17
#: Fewer steps, and steps of more multiplications, are taken one by one.
_LEAST_STEPS, _MOST_WORK = 100, 5000


@dataclass(frozen=True, eq=False)
class Step:
    """One step of a discrete system z' = transition z + entry u, and its derivatives.

    Attributes
    ----------
    transition : (n_states, n_states) float array
    entry : (n_states, n_inputs) float array
        Effect of the generator's state at the beginning of the step.
    transition_change : (n_states, n_params, n_states) float array
    entry_change : (n_states, n_params, n_inputs) float array
        Derivatives with respect to the parameters; the parameters stand in the middle so that all products are plain.
    """

    transition: FloatArray
    entry: FloatArray
    transition_change: FloatArray
    entry_change: FloatArray


def exact_step(
    rate: FloatArray,
    coupling: FloatArray,
    generator: FloatArray,
    step: float,
    rate_change: FloatArray,
    coupling_change: FloatArray,
) -> Step:
    """Discrete step of dz/dt = rate z + coupling u, du/dt = generator u, over `step` seconds, exact to rounding.

    Parameters
    ----------
    rate : (n_states, n_states) float array
        A, 1/s; well scaled, as modal states are.
    coupling : (n_states, n_inputs) float array
        B, by which the generator's state u drives z.
    generator : (n_inputs, n_inputs) float array
        1/s. Zero for inputs that stay constant; [[0, 1], [0, 0]] for straight lines.
    step : float
        s.
    rate_change : (n_states, n_params, n_states) float array
    coupling_change : (n_states, n_params, n_inputs) float array
        Derivatives of A and B; n_params may be 0.

    Returns
    -------
    Step
        Matrices with z' = transition z + entry u, where u is the generator's state at the beginning of the step, and
        their derivatives, with the parameter as the middle axis.
    """
    n_states, n_inputs = coupling.shape
    wide, n_params = n_states + n_inputs, rate_change.shape[1]
    size = float(np.abs(coupling).max(initial=0.0))
    unit = size / max(float(np.abs(rate).max(initial=0.0)), 1 / step) if size > 0 else 1.0
    system = np.zeros((wide, wide))
    system[:n_states, :n_states], system[:n_states, n_states:] = rate, coupling / unit
    system[n_states:, n_states:] = generator
    change = np.zeros((wide, n_params, wide))
    change[:n_states, :, :n_states], change[:n_states, :, n_states:] = rate_change, coupling_change / unit
    power, slope = exponential_derivative(system * step, change * step)
    return Step(
        power[:n_states, :n_states],
        power[:n_states, n_states:] * unit,
        slope[:n_states, :, :n_states],
        slope[:n_states, :, n_states:] * unit,
    )


def exponential_derivative(matrix: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Matrix exponential exp(A) and its Frechet derivatives in directions E, by Taylor series, scaling and squaring.

    Parameters
    ----------
    matrix : (n, n) float array
        A.
    directions : (n, n_params, n) float array
        E[:, j, :] is the j-th direction.

    Returns
    -------
    (n, n) and (n, n_params, n) float arrays
        The second has the derivative in direction j at [:, j, :].
    """
    n, n_params = len(matrix), directions.shape[1]
    norm = float(np.abs(matrix).sum(axis=0).max(initial=0.0))
    halvings = max(0, int(np.ceil(np.log2(norm / _LARGEST_NORM)))) if norm > 0 else 0
    a = matrix / 2**halvings
    moving = np.flatnonzero(np.abs(directions).any(axis=(1, 2)))
    e = (directions[moving] / 2**halvings).reshape(len(moving) * n_params, n)
    term, slope_term = np.eye(n), np.zeros((n, n_params * n))
    power, slope = term.copy(), slope_term.copy()
    for order in range(1, _TAYLOR_ORDER + 1):
        slope_term = a @ slope_term
        slope_term[moving] += (e @ term).reshape(len(moving), n_params * n)
        slope_term /= order
        term = a @ term / order
        power += term
        slope += slope_term
    for _ in range(halvings):
        slope = power @ slope + (slope.reshape(n * n_params, n) @ power).reshape(n, n_params * n)
        power = power @ power
    return power, slope.reshape(n, n_params, n)


def stepped(transition: FloatArray, drive: FloatArray, start: FloatArray) -> FloatArray:
    """States x_{k+1} = transition x_k + drive_k from x_0 = `start`, (n_steps + 1, n_states, ...), `start` first.

    Parameters
    ----------
    transition : (n_states, n_states) float array
    drive : (n_steps, n_states, ...) float array
    start : (n_states, ...) float array
    """
    if len(drive) >= _LEAST_STEPS and transition.size * start[0].size <= _MOST_WORK:
        return _step_in_blocks(transition, drive, start)
    states = np.empty((len(drive) + 1, *start.shape))
    states[0] = start
    for k, input_change in enumerate(drive):
        np.matmul(transition, states[k], out=states[k + 1])
        states[k + 1] += input_change
    return states


def _step_in_blocks(transition: FloatArray, drive: FloatArray, start: FloatArray) -> FloatArray:
    """States x_{k+1} = transition x_k + drive_k from `start`, (n_steps + 1, n_states, ...), by blocks side by side.

    Each block first runs from rest; its final state shows where the next block begins. `transition` (n_states,
    n_states) advances the state by one step, `drive` (n_steps, n_states, ...) is added in each, `start` (n_states, ...)
    is the first.
    """
    n_steps, n = drive.shape[:2]
    length = int(np.sqrt(n_steps / 2))
    count = -(-n_steps // length)
    padded = np.zeros((count * length, n, start[0].size))
    padded[:n_steps] = drive.reshape(n_steps, n, -1)
    block_drive = np.ascontiguousarray(padded.reshape(count, length, n, -1).transpose(1, 2, 0, 3)).reshape(
        length, n, -1
    )
    from_rest = np.zeros(block_drive.shape[1:])
    for each in block_drive:
        from_rest = transition @ from_rest + each
    across = np.linalg.matrix_power(transition, length)
    block_starts = np.empty((n, count, start[0].size))
    state = start.reshape(n, -1)
    for k, end in enumerate(np.moveaxis(from_rest.reshape(block_starts.shape), 1, 0)):
        block_starts[:, k] = state
        state = across @ state + end
    states = np.empty((count * length + 1, n, start[0].size))
    states[0] = block_starts[:, 0]
    later = states[1:].reshape(count, length, n, -1)
    moving = block_starts.reshape(n, -1)
    for k, each in enumerate(block_drive):
        moving = transition @ moving + each
        later[:, k] = np.moveaxis(moving.reshape(block_starts.shape), 1, 0)
    return states[: n_steps + 1].reshape(n_steps + 1, *start.shape)
