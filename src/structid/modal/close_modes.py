"""Close and repeated modes: which modes form a group, and what a record can say of its members.

Of a repeated frequency only the space is determined that its shapes span; every basis of it is as good as another.
Near a repeated frequency the shapes are those of a slightly different structure, and a measurement turns them among
themselves. Compare such groups with `structid.subspace_angles`, not with MAC, mode by mode.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.modal.modal_record import ModalRecord
from structid.similarity import mac

#: Standard deviations of a 95 % interval: a gap below it is not told from none.
NOT_TOLD_APART = 1.96
#: MAC from which on two shapes are one, and channels below which any two shapes may be alike.
_ONE_SHAPE, _FEWEST_CHANNELS = 0.99, 3


def gap_std(modes: ModalRecord) -> FloatArray:
    """Standard deviation of the frequency difference between each mode and the next, Hz, (n_modes - 1,).

    NaN where the modes have no covariance.
    """
    n = modes.n_modes
    if modes.covariance is None:
        return np.full(max(n - 1, 0), np.nan)
    return neighbour_std(modes.covariance[:n, :n])


def neighbour_std(covariance: FloatArray) -> FloatArray:
    """Standard deviation of the difference of neighbours, (n - 1,), from the covariance (n, n) of all."""
    variance = np.diag(covariance)[1:] + np.diag(covariance)[:-1] - 2 * np.diag(covariance, 1)
    return np.sqrt(np.maximum(variance, 0.0))


def is_close(modes: ModalRecord) -> np.ndarray:
    """Mask (n_modes - 1,) that is true for each mode that is close to the next in frequency.

    Close are modes whose gap is at most half the sum of both half-power bandwidths (2 zeta f each), so that their
    resonances overlap to one peak, or at most 1.96 of its standard deviations, so that the data cannot distinguish the
    two. An unknown bandwidth or standard deviation counts as 0; equal frequencies are always close.
    """
    f = modes.frequency
    bandwidth = 2 * np.maximum(np.nan_to_num(modes.damping_ratio), 0.0) * f
    overlap = 0.5 * (bandwidth[1:] + bandwidth[:-1])
    unsure = NOT_TOLD_APART * np.nan_to_num(gap_std(modes))
    return np.asarray(np.diff(f) <= np.maximum(overlap, unsure))


def close_groups(modes: ModalRecord) -> tuple[IntArray, ...]:
    """Mode numbers (from 0) of each group of close modes, by frequency; a single mode is a group too. See `is_close`."""
    return tuple(np.split(np.arange(modes.n_modes), np.flatnonzero(~is_close(modes)) + 1))


def repeated_modes(modes: ModalRecord) -> np.ndarray:
    """Mask (n_modes,) of modes that duplicate another in frequency and shape whose damping ratio is known better.

    Duplicates are within 1.96 standard deviations in frequency, errors taken as independent, with a MAC above 0.99: a model
    of too high an order gives a resonance two stable poles. All false without a covariance or with fewer than 3 channels.
    """
    repeated = np.zeros(modes.n_modes, dtype=bool)
    if len(modes.channels) < _FEWEST_CHANNELS or modes.covariance is None:
        return repeated
    n = modes.n_modes
    variance = np.diag(modes.covariance)[:n]
    gap = modes.frequency[:, None] - modes.frequency
    alike = (gap**2 <= NOT_TOLD_APART**2 * (variance[:, None] + variance)) & (mac(modes.mode_shapes) > _ONE_SHAPE)
    for m in np.argsort(-modes.std[n:], kind="stable"):
        repeated[m] = (alike[m] & ~repeated).sum() > 1
    return repeated


def close_mode_notes(
    modes: ModalRecord, duration: float, n_records: int = 1, free_decay: bool = False
) -> tuple[str, ...]:
    """Warnings on close and repeated modes, with remedies; () if there are none.

    Parameters
    ----------
    modes : ModalRecord
    duration : float
        Of the longest record, s.
    n_records : int
        Number of records with different excitations.
    free_decay : bool
        Whether the records are free decays. Free motion from one start moves the modes of a repeated frequency in one
        fixed proportion and shows one combination of their shapes.

    Returns
    -------
    tuple of str
        For each pair of neighbouring modes, one on a gap in frequency of at most one standard deviation of the gap, so
        that the two are not separate, or else one on T gap / pi below 1 for the duration T and the gap in rad/s (half a
        beat; the quotient of Norris needs more than about 1, methods with delays 0.1 even in little noise). Then, of
        free decays, one for each group of close modes with more members than `n_records`, unless two neighbours in it
        differ by more than 1.96 standard deviations.

    References
    ----------
    Norris (1986), chapter 5.
    """
    notes = []
    std, close = gap_std(modes), is_close(modes)
    for k, (first, second) in enumerate(pairwise(modes.frequency.tolist())):
        gap = second - first
        pair = f"modes {k + 1} and {k + 2} ({first:.5g} and {second:.5g} Hz)"
        apart = not (close[k] and gap <= np.nan_to_num(std[k]))
        if apart and 2 * duration * gap < 1:
            notes.append(
                f"{pair}: the longest record of {duration:.4g} s is shorter than half their beat of {1 / gap:.4g} s"
                f" (T gap / pi = {2 * duration * gap:.2g}): their shapes may be mixed; measure {0.5 / gap:.3g} s or more"
            )
        if not apart:
            notes.append(
                f"{pair} are not separate: their gap of {gap:.2g} Hz is within its standard deviation of"
                f" {np.nan_to_num(std[k]):.2g} Hz. Only the common subspace of their shapes is known: compare it by"
                " principal angles, not by MAC; measure longer to separate them"
            )
    for group in close_groups(modes) if free_decay else ():
        if len(group) > n_records and not any(_told_apart(modes, group, std)):
            listed = ", ".join(str(i + 1) for i in group)
            notes.append(
                f"modes {listed} may be one repeated frequency, and free motion from {n_records} start"
                f"{'' if n_records == 1 else 's'} shows at most {n_records} of its {len(group)} shapes; give"
                f" {len(group)} records, excited at different places"
            )
    return tuple(notes)


def _told_apart(modes: ModalRecord, group: IntArray, std: FloatArray) -> list[bool]:
    """True for each neighbouring pair of `group` whose frequency gap exceeds `NOT_TOLD_APART` of its standard deviations.

    `group` are mode numbers, `std` (n_modes - 1,) is that of `gap_std`, Hz.
    """
    pairs = group[:-1]
    gaps = modes.frequency[pairs + 1] - modes.frequency[pairs]
    return (gaps > NOT_TOLD_APART * np.nan_to_num(std[pairs])).tolist()
