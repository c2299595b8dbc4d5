"""Modes of a record under an exponential window, with the decay of the window taken off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from structid.arrays import FloatArray
from structid.errors import InputError
from structid.modal.modal_record import ModalRecord


def without_window_damping(modes: ModalRecord, decay: float) -> ModalRecord:
    """`modes` with every pole s moved to s + decay.

    A window e^(-decay t) on a free decay moves each pole by -decay and keeps the damped frequency: with s = -zeta omega
    + i omega_d, omega'^2 = omega^2 - 2 zeta omega decay + decay^2 and zeta' = (zeta omega - decay) / omega'.

    Parameters
    ----------
    modes : ModalRecord
        As identified from the windowed record.
    decay : float
        1/s, one over the time constant of the window; the sum over several windows that lie on one record.

    Returns
    -------
    ModalRecord
        Frequency and damping ratio without the window, their covariance by the exact first derivatives. The standard
        deviation of the decay rate zeta omega stays, and is large against what is left where the window did most of
        the damping: a warning then says so. Modes without a damping ratio (NaN) keep their frequency, and rigid-body
        modes (0 Hz) stay as they are.

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
    omega, ratio = modes.omega, np.asarray(modes.damping_ratio)
    known = np.isfinite(ratio) & (omega > 0)
    rate = np.where(known, ratio * omega, 0.0)
    size = np.sqrt(np.maximum(omega**2 - 2 * rate * decay + decay**2, 0.0))
    omega_new = np.where(known, size, omega)
    ratio_new = np.where(known, (rate - decay) / np.where(known, size, 1.0), ratio)
    order = np.argsort(omega_new, kind="stable")
    covariance = None if modes.covariance is None else _carried(modes, omega_new, ratio_new, known, decay)
    if covariance is not None:
        both = np.concatenate([order, order + modes.n_modes])
        covariance = covariance[np.ix_(both, both)]
    return replace(
        modes,
        frequency=omega_new[order] / (2 * np.pi),
        damping_ratio=ratio_new[order],
        mode_shapes=modes.mode_shapes[:, order],
        covariance=covariance,
        shape_std=None if modes.shape_std is None else modes.shape_std[:, order],
        changes=None,
        warnings=(*modes.warnings, *_doubts(ratio_new[order], covariance)),
        source=f"{modes.source}, window decay of {decay:g} 1/s taken off".removeprefix(", "),
    )


def _carried(
    modes: ModalRecord, omega_new: FloatArray, ratio_new: FloatArray, known: np.ndarray, decay: float
) -> FloatArray:
    """Covariance of frequencies (Hz) and damping ratios after the shift, modes in their old order."""
    omega = np.where(known, modes.omega, 1.0)
    ratio = np.where(known, modes.damping_ratio, 0.0)
    new, new_ratio = np.where(known, omega_new, 1.0), np.where(known, ratio_new, 0.0)
    by_omega = np.where(known, (omega - ratio * decay) / new, 1.0)
    by_ratio = np.where(known, -omega * decay / new, 0.0) / (2 * np.pi)
    ratio_by_omega = np.where(known, (ratio - new_ratio * by_omega) / new, 0.0) * 2 * np.pi
    ratio_by_ratio = np.where(known, (omega - new_ratio * 2 * np.pi * by_ratio) / new, 1.0)
    slope = np.block([[np.diag(by_omega), np.diag(by_ratio)], [np.diag(ratio_by_omega), np.diag(ratio_by_ratio)]])
    old = np.asarray(modes.covariance)
    lost = np.isnan(old)
    carried = slope @ np.where(lost, 0.0, old) @ slope.T
    touched = (np.abs(slope) > 0).astype(float)
    spoiled = touched @ lost.astype(float) @ touched.T > 0
    return np.where(spoiled, np.nan, carried)


def _doubts(ratio: FloatArray, covariance: FloatArray | None) -> list[str]:
    """Words on modes whose damping the window hides."""
    notes, n = [], len(ratio)
    negative = [str(i + 1) for i in range(n) if ratio[i] < 0]
    if negative:
        notes.append(
            f"mode {', '.join(negative)} is left with negative damping once the window is taken off: check the time "
            "constant of the window, or measure without one"
        )
    if covariance is not None:
        std = np.sqrt(np.diag(covariance)[n:])
        unsure = [str(i + 1) for i in range(n) if ratio[i] >= 0 and std[i] > 0.5 * ratio[i]]
        if unsure:
            notes.append(
                f"the window did so much of the damping of mode {', '.join(unsure)} that what is left is not known to half "
                "of itself: measure with a longer window"
            )
    return notes
