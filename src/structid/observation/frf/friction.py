"""Harmonic balance of dry friction: sliding amplitudes that the motion itself has, and how they move with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from structid.arrays import ComplexArray, FloatArray
from structid.dynamics.dense_fields import MOST_SMALLER
from structid.observation.frf.sliding import require_one_load
from structid.records import FrfRecord
from structid.structure import Friction, Structure

_MOST_ITERATIONS = 60
#: A Newton step by no more than this part leaves an error of rounding.
_SMALL_STEP = 1e-8


@dataclass(frozen=True, eq=False)
class Contact:
    """A friction element that slides with the model's own amplitude: where its law and its force stand."""

    law: int
    value: int


def sliding_contacts(
    structure: Structure, laws: tuple[str, ...], record: FrfRecord, measured: set[str]
) -> tuple[tuple[Contact, ...], sparse.csc_array]:
    """Friction elements in harmonic balance, and the columns that read their sliding motion."""
    contacts, columns = [], [sparse.csc_array((structure.n_dofs, 0))]
    for element in structure.elements:
        if isinstance(element, Friction) and element.name not in measured:
            require_one_load(element, record)
            value = next(p.values.start for p in structure.properties if p.element == element.name)
            contacts.append(Contact(laws.index(f"friction:{element.name}"), value))
            slide = structure.selection(element.first)
            columns.append(slide if element.second is None else slide - structure.selection(element.second))
    return tuple(contacts), sparse.csc_array(sparse.hstack(columns))


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
    size = np.maximum(np.abs(free), floor)
    moving = np.arange(len(size))
    for _ in range(_MOST_ITERATIONS):
        new = _newton_step(flexibility[moving], free[moving], force, floor[moving], size[moving])
        change = (np.abs(new - size[moving]) / size[moving]).max(axis=1, initial=0.0)
        size[moving] = new
        moving = moving[change > _SMALL_STEP]
        if not len(moving):
            break
    return size


def _newton_step(
    flexibility: ComplexArray, free: ComplexArray, force: FloatArray, floor: FloatArray, size: FloatArray
) -> FloatArray:
    """The next amplitudes from `size`, no more than five times larger or smaller."""
    n_contacts = len(force)
    pull = 1j * force / size
    system = np.eye(n_contacts) + flexibility * pull[:, None, :]
    solved = np.linalg.solve(system, np.concatenate([free[..., None], flexibility], axis=2))
    motion, reach = solved[..., 0], solved[..., 1:]
    unit = np.conj(motion) / np.maximum(np.abs(motion), np.finfo(float).tiny)
    slope = (unit[..., None] * reach * (pull * motion / size)[:, None, :]).real
    error = np.abs(motion) - size
    stuck = (size <= floor) & (error <= 0)
    error[stuck] = 0.0
    slope[stuck] = 0.0
    step = np.linalg.solve(np.eye(n_contacts) - slope, error[..., None])[..., 0]
    return np.maximum(np.clip(size + step, 0.2 * size, 5.0 * size), floor)


def slid_readings(free: ComplexArray, reach: ComplexArray, factors: ComplexArray) -> ComplexArray | None:
    """Readings with friction from those without it; None where their difference would lose digits.

    Parameters
    ----------
    free : (n_frequencies, n_outputs + n_contacts, n_inputs) complex array
        Readings under the loads, contacts last.
    reach : (n_frequencies, n_outputs + n_contacts, n_contacts) complex array
        Readings under unit forces at the contacts.
    factors : (n_frequencies, n_contacts) complex array
        Force on the structure per sliding motion of each contact, i r / s, against that motion.
    """
    n_contacts = factors.shape[1]
    system = np.eye(n_contacts) + factors[:, :, None] * reach[:, -n_contacts:]
    readings = free - reach @ np.linalg.solve(system, factors[:, :, None] * free[:, -n_contacts:])
    before, after = (np.linalg.norm(values, axis=(1, 2)) for values in (free, readings))
    return None if (before > MOST_SMALLER * after).any() else readings


def add_amplitude_change(
    derivative: ComplexArray, motion: ComplexArray, reach: ComplexArray, force: FloatArray, size: FloatArray
) -> None:
    """Make the derivative of outputs and contacts at fixed sliding amplitudes the whole one, in place.

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
    derivative += by_size @ change
