"""Harmonic balance of dry friction: sliding amplitudes that the motion itself has, and how they move with it."""

from __future__ import annotations

import numpy as np

from structid.arrays import ComplexArray, FloatArray

_MOST_ITERATIONS = 60


def balanced_amplitudes(
    flexibility: ComplexArray, free: ComplexArray, force: FloatArray, floor: FloatArray
) -> FloatArray:
    """Amplitudes s = abs(q) of q = b - A (i r q / s) at every line, (n_frequencies, n_contacts), by Newton's method.

    Where friction exceeds the force that reaches a contact it sticks, and `floor` stands for its amplitude.

    Parameters
    ----------
    flexibility : (n_frequencies, n_contacts, n_contacts) complex array
        A: motion of each contact per unit force at each contact, without friction.
    free : (n_frequencies, n_contacts) complex array
        b: motion of each contact under the drive, without friction.
    force : (n_contacts,) float array
        r: friction force per unit drive.
    floor : (n_frequencies, n_contacts) float array
        Amplitude of a contact that sticks; small against abs(b).
    """
    n_contacts = len(force)
    size = np.maximum(np.abs(free), floor)
    for _ in range(_MOST_ITERATIONS):
        system = np.eye(n_contacts) + flexibility * (1j * force / size)[:, None, :]
        solved = np.linalg.solve(system, np.concatenate([free[..., None], flexibility], axis=2))
        motion, reach = solved[..., 0], solved[..., 1:]
        unit = np.conj(motion) / np.maximum(np.abs(motion), np.finfo(float).tiny)
        slope = (unit[..., None] * reach * (1j * force * motion / size**2)[:, None, :]).real
        error = np.abs(motion) - size
        stuck = (size <= floor) & (error <= 0)
        error[stuck] = 0.0
        slope[stuck] = 0.0
        step = np.linalg.solve(np.eye(n_contacts) - slope, error[..., None])[..., 0]
        new = np.maximum(np.clip(size + step, 0.2 * size, 5.0 * size), floor)
        change = np.abs(new - size) / size
        size = new
        if change.max(initial=0.0) < 1e-12:
            break
    return size


def add_amplitude_change(
    derivative: ComplexArray, motion: ComplexArray, reach: ComplexArray, force: FloatArray, size: FloatArray
) -> ComplexArray:
    """The whole derivative of outputs and contacts from that at fixed sliding amplitudes.

    With s the amplitudes, dH = dH|s + (dH/ds) ds and ds = Re(conj(q) dq) / s, solved for ds line by line.

    Parameters
    ----------
    derivative : (n_frequencies, n_outputs + n_contacts, n_params) complex array
        Derivative of receptances at fixed amplitudes, contacts last.
    motion : (n_frequencies, n_contacts) complex array
        q, motion of the contacts under the drive.
    reach : (n_frequencies, n_outputs + n_contacts, n_contacts) complex array
        Receptance from a force at each contact.
    force : (n_contacts,) float array
        r.
    size : (n_frequencies, n_contacts) float array
        s; where it differs from abs(q) the contact sticks and s stays.
    """
    n_contacts = len(force)
    by_size = reach * (1j * force * motion / size**2)[:, None, :]
    slides = np.abs(np.abs(motion) / size - 1) < 1e-6
    unit = (slides * np.conj(motion) / size)[..., None]
    coupling = np.eye(n_contacts) - (unit * by_size[:, -n_contacts:]).real
    change = np.linalg.solve(coupling, (unit * derivative[:, -n_contacts:]).real)
    return derivative + by_size @ change
