"""When the pseudo-Rayleigh quotient cannot be used, or not trusted, in words with a remedy."""

from __future__ import annotations

import numpy as np

from structid.arrays import FloatArray
from structid.errors import InputError
from structid.modal.rayleigh.free_motion import FreeMotion

#: Quantities by the name of their pair.
PAIRS: dict[str, tuple[str, ...]] = {
    "displacement-velocity": ("displacement", "velocity"),
    "velocity-acceleration": ("velocity", "acceleration"),
    "displacement-acceleration": ("displacement", "acceleration"),
    "displacement": ("displacement",),
    "velocity": ("velocity",),
    "acceleration": ("acceleration",),
}
_NEEDS = {
    "as_printed": ("displacement-velocity", "velocity-acceleration"),
    "end_corrected": ("displacement-velocity", "velocity-acceleration"),
    "symmetric_acceleration": ("displacement-acceleration",),
    "exact": ("displacement-acceleration",),
    "second_difference": tuple(PAIRS),
}
_MISFIT = 0.1


def checked_quantities(pair: str, form: str) -> tuple[str, ...]:
    """The quantities that `form` takes from `pair`.

    Raises
    ------
    InputError
        If either is unknown, or the pair does not hold the derivative that the form needs.
    """
    if form not in _NEEDS:
        raise InputError(f"`form` must be one of {', '.join(_NEEDS)}, got {form!r}")
    if pair not in PAIRS:
        raise InputError(f"`pair` must be one of {', '.join(PAIRS)}, got {pair!r}")
    if pair not in _NEEDS[form]:
        raise InputError(
            f"`form` {form!r} needs `pair` {' or '.join(map(repr, _NEEDS[form]))}, got {pair!r}; "
            "without these quantities use form='second_difference'"
        )
    return PAIRS[pair][:1] if form == "second_difference" else PAIRS[pair]


def require_oscillation(omega: FloatArray, duration: float, pair: str) -> None:
    """Refuse a response in which no mode turns by half a period."""
    if omega.max(initial=0.0) * duration >= np.pi:
        return
    other = "" if pair == "velocity-acceleration" else ", measuring velocity and acceleration if it is free to drift"
    raise InputError(
        f"`records` hold no oscillation: the fastest motion turns by {omega.max(initial=0.0) * duration:.2g} rad in "
        f"{duration:g} s. A rigid-body motion carries no natural frequency: excite the structure so that it deforms"
        f"{other}; or measure longer"
    )


def quotient_warnings(
    omega: FloatArray,
    apart: FloatArray,
    gram: FloatArray,
    rank: int,
    motion: FreeMotion,
    pair: str,
    form: str,
    n_modes: int | None,
) -> tuple[str, ...]:
    """What makes the modes doubtful.

    Parameters
    ----------
    omega : (n_modes,) float array
        Identified, increasing, rad/s.
    apart : (n_modes,) float array
        Frequencies whose gaps count, rad/s: the printed forms push neighbours apart, to a gap of order 1 / T
        whatever the true one.
    gram : (n_channels,) float array
        Eigenvalues of A over the largest.
    rank : int
        How many of them were used.
    """
    notes = []
    if rank < len(gram):
        cause = (
            "as `n_modes` asks"
            if n_modes is not None
            else "so only as many modes are given. A repeated frequency excited once, and a mode that is not excited, "
            "cannot be seen: add a record with another excitation, or leave out sensors"
        )
        largest = f"the first eigenvalue of A left out is {gram[rank]:.1e} of the largest"
        notes.append(f"{len(gram)} channels reduced to {rank} independent motions ({largest}), {cause}")
    notes += _slow_modes(omega, motion.duration, pair)
    notes += _close_modes(apart, motion.duration, form)
    misfit = motion.misfit
    if misfit > _MISFIT:
        notes.append(
            f"{100 * misfit:.0f} % of the acceleration is not a constant matrix times the motion of the "
            f"{len(gram)} channels: more modes than sensors (several share one shape at the sensors, and their "
            "frequencies mix), heavy damping, or noise. Add sensors, low-pass filter, or use a method with delayed "
            "channels"
        )
    return tuple(notes)


def _slow_modes(omega: FloatArray, duration: float, pair: str) -> list[str]:
    """Modes of less than half a period, except those at rest in the quotient of velocity and acceleration."""
    at_rest = omega <= 1e-6 * omega.max()
    slow = np.flatnonzero((omega * duration < np.pi) & ~(at_rest & pair.startswith(("velocity", "acceleration"))))
    if not len(slow):
        return []
    listed = ", ".join(str(i + 1) for i in slow)
    return [
        f"mode {listed} turns less than half a period in {duration:g} s: a rigid-body motion, for which the pair "
        "'velocity-acceleration' is meant, or a record too short for it"
    ]


def _close_modes(apart: FloatArray, duration: float, form: str) -> list[str]:
    symmetric = form in ("as_printed", "symmetric_acceleration")
    effect = (
        "their frequencies are pushed apart and their shapes mixed; use the form 'end_corrected' or 'exact', and measure"
        if symmetric
        else "the smallest noise mixes their shapes; measure"
    )
    gaps = np.diff(apart)
    notes = []
    for i in np.flatnonzero(gaps * duration < np.pi):
        enough = (
            f"for at least {np.pi / gaps[i]:.3g} s" if gaps[i] > 1e-9 * apart[-1] else "after other excitations too"
        )
        notes.append(
            f"modes {i + 1} and {i + 2} (near {apart[i]:.5g} and {apart[i + 1]:.5g} rad/s) have T x gap / pi = "
            f"{gaps[i] * duration / np.pi:.2g}, below 1: {effect} {enough}"
        )
    return notes
