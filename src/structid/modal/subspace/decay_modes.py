"""Modes of free decays: poles of a subspace method, refined on all samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from structid.arrays import ComplexArray, FloatArray
from structid.modal.correlations import Outputs, displacement_rows
from structid.modal.modal_record import ModalRecord
from structid.modal.subspace.decay_fit import decay_fit, decay_shapes, stands_out
from structid.modal.subspace.pole_uncertainty import free_decay_fit, is_free_decay

_SHOWN = 1.0  # exponent of the fastest decay that tells free motion from motion kept up
_FAR = 0.05  # of its size: a pole that moves further has left its mode


def decay_modes(data: Outputs, modes: ModalRecord) -> ModalRecord:
    """`modes` with those of them that stand out of the noise refined by maximum likelihood (`decay_fit`).

    Parameters
    ----------
    data : Outputs
        Records that `modes` come from.
    modes : ModalRecord
        By a subspace method; its frequencies, damping ratios, shapes and their covariance are replaced.

    Returns
    -------
    ModalRecord
        `modes` itself where the records are no free decays of them, or the search does not end near its start.
    """
    poles = modes.poles
    if not is_free_decay(data, free_decay_fit(data, poles)[1], poles):
        return modes
    strong = np.flatnonzero(stands_out(data, poles))
    fit = decay_fit(data, poles[strong]) if len(strong) else None
    if fit is None or (np.abs(fit.poles - poles[strong]) > _FAR * np.abs(poles[strong])).any():
        return modes
    s = fit.poles
    _, merge = displacement_rows(data, s)
    shapes, std = decay_shapes(fit, data.scale, merge)
    frequency, ratio = modes.frequency.copy(), modes.damping_ratio.copy()
    all_shapes = np.array(modes.mode_shapes)
    frequency[strong], ratio[strong], all_shapes[:, strong] = np.abs(s) / (2 * np.pi), -s.real / np.abs(s), shapes
    covariance, shape_std = modes.covariance, modes.shape_std
    if covariance is not None and shape_std is not None:
        covariance, shape_std = covariance.copy(), shape_std.copy()
        own = np.concatenate([strong, modes.n_modes + strong])
        covariance[own, :], covariance[:, own] = 0.0, 0.0
        covariance[np.ix_(own, own)] = _of_frequency_and_damping(s, fit.pole_covariance)
        shape_std[:, strong] = std
    notes = _shown_decay(data, s)
    order = np.argsort(frequency, kind="stable")
    both = np.concatenate([order, modes.n_modes + order])
    return replace(
        modes,
        frequency=frequency[order],
        damping_ratio=ratio[order],
        mode_shapes=all_shapes[:, order],
        covariance=None if covariance is None else covariance[np.ix_(both, both)],
        shape_std=None if shape_std is None else shape_std[:, order],
        changes=None,
        warnings=(*modes.warnings, *notes),
        source=f"{modes.source}, refined by maximum likelihood of the free decay",
    )


def _of_frequency_and_damping(s: ComplexArray, covariance: FloatArray) -> FloatArray:
    """Covariance of |s| / 2 pi and -Re s / |s| from that of Re s and Im s."""
    size = np.abs(s)
    slope = np.block(
        [
            [np.diag(s.real / size), np.diag(s.imag / size)],
            [np.diag(-(s.imag**2) / size**3) * 2 * np.pi, np.diag(s.real * s.imag / size**3) * 2 * np.pi],
        ]
    ) / (2 * np.pi)
    return np.asarray(slope @ covariance @ slope.T)


def _shown_decay(data: Outputs, s: ComplexArray) -> tuple[str, ...]:
    """A word where the records are too short to show that their motion dies out."""
    if float(np.max(-s.real)) * data.duration > _SHOWN:
        return ()
    return (
        f"no mode dies out in {data.duration:.3g} s, and the motion is taken as free: if forces kept it up, standard "
        "deviations are far too small; then measure longer",
    )
