"""What a structure answers: FRFs, modes, and histories by the exact discretization of its equations of motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import linalg

from wrong_models.assembly import System

DERIVATIVES = {"receptance": 0, "mobility": 1, "accelerance": 2}
#: A sensor: degrees of freedom with their direction cosines.
Sensor = dict[str, float]


def looked(system: System, sensors: Sequence[Sensor]) -> np.ndarray:
    """Rows that take readings from displacements, (n_sensors, n_dofs)."""
    return np.array([sum(part * system.column(dof) for dof, part in sensor.items()) for sensor in sensors])


def frf(
    system: System,
    frequency: np.ndarray,
    sensors: Sequence[Sensor],
    loads: Sequence[str],
    kind: str,
    decay: float = 0.0,
) -> np.ndarray:
    """FRFs, (n_lines, n_sensors, n_loads), at s = decay + 2 pi i f; motion per motion where one is given."""
    s = (decay + 2j * np.pi * frequency)[:, None, None]
    pushed = np.array([system.column(load) for load in loads]).T
    dynamic = s**2 * system.mass + s * system.damping + system.stiffness
    if system.driven:
        at = system.dofs.index(system.driven)
        rest = np.delete(np.arange(len(system.dofs)), at)
        driven = np.ones((len(frequency), len(system.dofs), 1), dtype=complex)
        driven[:, rest] = -np.linalg.solve(dynamic[:, rest[:, None], rest], dynamic[:, rest, at, None])
        return looked(system, sensors) @ driven
    motion = np.linalg.solve(dynamic, np.broadcast_to(pushed, (len(frequency), *pushed.shape)))
    return s ** DERIVATIVES[kind] * (looked(system, sensors) @ motion)


def modes(system: System, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies in Hz, damping ratios (first order) and shapes of unit modal mass, (n_dofs, n), of the lowest modes."""
    squares, shapes = linalg.eigh(system.stiffness.real, system.mass)
    omega, shapes = np.sqrt(np.maximum(squares[:n], 0.0)), shapes[:, :n]
    lost = np.einsum("im,ij,jm->m", shapes, system.stiffness.imag, shapes) / omega**2
    lost += np.einsum("im,ij,jm->m", shapes, system.damping, shapes) / omega
    return omega / (2 * np.pi), lost / 2, shapes


def steady(
    system: System, force: np.ndarray, rate: float, sensors: Sequence[Sensor], loads: Sequence[str], kind: str
) -> np.ndarray:
    """Samples (n_times, n_sensors) of the motion that repeats with a force (n_times, n_loads) below half the rate."""
    spectrum, frequency = np.fft.rfft(force, axis=0), np.fft.rfftfreq(len(force), 1 / rate)
    found = np.zeros((len(frequency), len(sensors)), dtype=complex)
    strong = np.flatnonzero(abs(spectrum).max(axis=1) > 1e-12 * abs(spectrum).max())
    for lines in np.array_split(strong, len(strong) // 500 + 1):
        found[lines] = np.einsum("fol,fl->fo", frf(system, frequency[lines], sensors, loads, kind), spectrum[lines])
    return np.fft.irfft(found, len(force), axis=0)


def history(
    system: System, force: np.ndarray, loads: Sequence[str], step: float, friction: Sequence[tuple[str, float]] = ()
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Displacement, velocity and acceleration from rest, each (n_times, n_dofs), under forces (n_times, n_loads).

    Forces run straight between samples, and the answer at the samples is exact. Dry friction (degree of freedom, N) is
    constant over a step and found so that the velocity at its end is zero or has its sign (sticking or sliding).
    """
    n = len(system.dofs)
    pushed = np.array([system.column(load) for load in loads]).T
    held = np.array([system.column(dof) for dof, _ in friction]).T.reshape(n, len(friction))
    inverse = np.linalg.inv(system.mass)
    drive = np.hstack([pushed, held])
    q = drive.shape[1]
    whole = np.zeros((2 * n + 2 * q, 2 * n + 2 * q))
    whole[:n, n : 2 * n] = np.eye(n)
    whole[n : 2 * n, :n], whole[n : 2 * n, n : 2 * n] = -inverse @ system.stiffness.real, -inverse @ system.damping
    whole[n : 2 * n, 2 * n : 2 * n + q] = inverse @ drive
    whole[2 * n : 2 * n + q, 2 * n + q :] = np.eye(q) / step
    moved = linalg.expm(whole * step)
    free, now, change = moved[: 2 * n, : 2 * n], moved[: 2 * n, 2 * n : 2 * n + q], moved[: 2 * n, 2 * n + q :]
    m = len(loads)
    given = force[:-1] @ now[:, :m].T + np.diff(force, axis=0) @ change[:, :m].T
    state, rubbed = np.zeros((len(force), 2 * n)), np.zeros((len(force), len(friction)))
    for k, push in enumerate(given):
        state[k + 1] = free @ state[k] + push
        for j, (_, limit) in enumerate(friction):
            slip, grip = held[:, j] @ state[k + 1, n:], held[:, j] @ now[n:, m + j]
            rubbed[k + 1, j] = -np.clip(slip / grip, -limit, limit)
            state[k + 1] += now[:, m + j] * rubbed[k + 1, j]
    place, speed = state[:, :n], state[:, n:]
    loaded = force @ pushed.T + rubbed @ held.T
    return place, speed, (loaded - speed @ system.damping.T - place @ system.stiffness.real.T) @ inverse.T


def band_limited(rng: np.random.Generator, n: int, rate: float, low: float, high: float) -> np.ndarray:
    """Periodic Gaussian noise of unit rms between `low` and `high` Hz, (n,)."""
    frequency = np.fft.rfftfreq(n, 1 / rate)
    lines = (rng.standard_normal(len(frequency)) + 1j * rng.standard_normal(len(frequency))) * (
        (frequency >= low) & (frequency <= high)
    )
    found = np.fft.irfft(lines, n)
    return found / found.std()


def h1(force: np.ndarray, motion: np.ndarray, length: int, window: str = "hann") -> tuple[np.ndarray, np.ndarray, int]:
    """H1, (n_lines, n_sensors), coherence and number of segments, halves of which overlap, of one force (n_times,)."""
    weights = np.hanning(length + 1)[:-1] if window == "hann" else np.ones(length)
    starts = range(0, len(force) - length + 1, length // 2 if window == "hann" else length)
    x = np.array([np.fft.rfft(weights * force[a : a + length]) for a in starts])
    y = np.array([np.fft.rfft(weights[:, None] * motion[a : a + length], axis=0) for a in starts])
    return (*averaged(x, y), len(starts))


def averaged(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """H1 and coherence, (n_lines, n_sensors), of spectra (n_averages, n_lines) and (n_averages, n_lines, n_sensors)."""
    cross = (y * x.conj()[:, :, None]).mean(axis=0)
    power, answer = (abs(x) ** 2).mean(axis=0)[:, None], (abs(y) ** 2).mean(axis=0)
    nothing = np.finfo(float).tiny  # lines without force
    return cross / np.maximum(power, nothing), abs(cross) ** 2 / np.maximum(power * answer, nothing)
