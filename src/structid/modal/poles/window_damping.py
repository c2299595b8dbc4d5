"""Modes of a record under an exponential window, with the decay of the window taken off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.errors import InputError
from structid.modal.modal_record import ModalRecord, by_frequency
from structid.modal.poles.poles import frequency_damping_slope


def without_window_damping(modes: ModalRecord, decay: float) -> ModalRecord:
    """Modes corrected for an exponential window: every pole s moved to s + `decay` (1/s).

    A window e^(-decay t) on a free decay moves each pole by -decay and keeps the damped frequency.

    Parameters
    ----------
    modes : ModalRecord
        As identified from the windowed record.
    decay : float
        1/s, one over the time constant of the window; the sum over several windows that lie on one record.

    Returns
    -------
    ModalRecord
        Frequency and damping ratio without the window, their covariance by the exact first derivatives; without
        `changes`. The standard deviation of the decay rate zeta omega stays, and is large against what is left where
        the window did most of the damping: a warning then says so. Modes without a damping ratio (NaN) keep their
        frequency, and rigid-body modes (0 Hz) stay as they are.

    Raises
    ------
    InputError
        If `decay` is negative or not finite.

    Notes
    -----
    Shapes of mixed quantities come from the windowed poles and stay as they are: the shift of decay / omega is in them.

    References
    ----------
    Fladung and Rost (1997), Application and correction of the exponential window for frequency response functions,
    Mech. Syst. Signal Process. 11, 23-36.

    Examples
    --------
    >>> modes = ModalRecord([10.0], [0.02], [[1.0]], ("1Z",))
    >>> clean = without_window_damping(modes, 1.0)
    >>> (clean.damping_ratio * clean.omega).round(4).tolist()
    [0.2566]
    """
    if not (np.isfinite(decay) and decay >= 0):
        raise InputError(
            f"`decay` must be a finite rate of at least 0 1/s, got {decay!r}; give 1 over the time constant"
        )
    known = np.isfinite(modes.damping_ratio) & (modes.omega > 0)
    before = np.where(known, modes.poles, 1j)
    after = before + decay * known
    moved = frequency_damping_slope(after) @ np.linalg.inv(frequency_damping_slope(before))
    size = np.abs(after)
    found = by_frequency(
        np.where(known, size / (2 * np.pi), modes.frequency),
        np.where(known, -after.real / size, modes.damping_ratio),
        modes.mode_shapes, modes.channels, _map_covariance(modes.covariance, moved), modes.shape_std, scaling=modes.scaling,
        source=f"{modes.source}, window decay of {decay:g} 1/s taken off".removeprefix(", "),
    )  # fmt: skip
    return replace(found, warnings=(*modes.warnings, *_damping_warnings(found)))


def _map_covariance(covariance: FloatArray | None, moved: FloatArray) -> FloatArray | None:
    """`covariance` after the linear map `moved` (n_new, n), (n_new, n_new); NaN where it depends on an unknown (NaN) entry.

    None if `covariance` is None.
    """
    if covariance is None:
        return None
    lost = np.isnan(covariance)
    touched = (np.abs(moved) > 0).astype(float)
    carried = moved @ np.where(lost, 0.0, covariance) @ moved.T
    return np.where(touched @ lost.astype(float) @ touched.T > 0, np.nan, carried)


def _damping_warnings(modes: ModalRecord) -> list[str]:
    """Warnings on modes whose damping ratio is negative, or has a standard deviation above half of it, or [].

    `modes` are those with the damping of an exponential window taken off.
    """
    notes, ratio = [], modes.damping_ratio
    negative = [str(i + 1) for i in np.flatnonzero(ratio < 0)]
    if negative:
        notes.append(
            f"mode {', '.join(negative)} is left with negative damping once the window is taken off: check the time "
            "constant of the window, or measure without one"
        )
    unsure = [str(i + 1) for i in np.flatnonzero((ratio >= 0) & (modes.std[modes.n_modes :] > 0.5 * ratio))]
    if unsure:
        notes.append(
            f"the window adds so much damping to mode {', '.join(unsure)} that the remainder is uncertain by more than "
            "half of it: measure with a longer window"
        )
    return notes
