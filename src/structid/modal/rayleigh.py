"""The pseudo-Rayleigh quotient: modes from two averages over time of a free response.

With A = <y y'> and B = <ydot ydot'> (or -<yddot y'>) of the measured free motion y(t), the stationary values of
v'Bv / v'Av are the squared frequencies, and the inverse transpose of the stationary vectors holds the mode shapes.

References
----------
Norris (1986), chapter 5. The sign of -<yddot y'> in Eqs. (5.9) to (5.33), which print it positive, is mended here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structid.core.arrays import FloatArray, NumberArray, locked, require_finite
from structid.core.dof import Dof
from structid.core.errors import InputError
from structid.modal.modal_record import ModalRecord, unit_largest
from structid.records import TimeRecord
from structid.records.record import MOTION_DERIVATIVES

Form = Literal["as_printed", "symmetric_acceleration", "exact", "end_corrected", "second_difference"]
Pair = Literal[
    "displacement-velocity", "velocity-acceleration", "displacement-acceleration",
    "displacement", "velocity", "acceleration",
]  # fmt: skip
Rule = Literal["trapezoid", "left", "interior", "gregory"]

RULES = get_args(Rule)
_GREGORY_ORDER = 7  # differences at each end; from order 8 on some weights are negative

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
_SYMMETRIC = ("as_printed", "symmetric_acceleration")


@dataclass(frozen=True, eq=False)
class StationaryValues:
    """Stationary values of the quotient, smallest first, and what they rest on.

    Attributes
    ----------
    eigenvalues : (n_modes,) float or complex array
        Squared circular frequency, (rad/s)^2.
    vectors : (n_channels, n_modes) array
        Stationary vectors v: weights of the channels that let one mode through, v_r' phi_s = delta_rs. They carry
        the mass: V = M Phi for mass-normalized Phi.
    mode_shapes : (n_channels, n_modes) array
        Phi = V^-T, without a mass matrix; scaled to unit <q_r^2> in time for the symmetric forms.
    unsymmetrized : (n_modes,) float or complex array
        What the exact form next to a symmetric one gives: its gaps between frequencies are not widened. The
        eigenvalues themselves for the other forms.
    gram_eigenvalues : (n_channels,) float array
        Eigenvalues of A = <y y'> over the largest, after translations and rotations are each brought to unit root mean square.
    motion : FreeMotion
    """

    eigenvalues: NumberArray
    vectors: NumberArray
    mode_shapes: NumberArray
    unsymmetrized: NumberArray
    gram_eigenvalues: FloatArray
    motion: FreeMotion


def pseudo_rayleigh(
    records: TimeRecord | Sequence[TimeRecord],
    pair: Pair = "displacement-velocity",
    form: Form = "end_corrected",
    rule: Rule | None = None,
    n_modes: int | None = None,
    mass: ArrayLike | None = None,
    tolerance: float = 1e-12,
) -> ModalRecord:
    """Undamped modes of a free response, from averages over time; no excitation need be known.

    Parameters
    ----------
    records : TimeRecord or sequence of them
        Free responses. Averages are summed over records: two excitations separate a repeated frequency.
    pair : str
        The quantity y, and the one that holds the derivative: ``displacement-velocity``; ``velocity-acceleration``
        where rigid-body modes take part; ``displacement-acceleration`` for the two forms with -<yddot y'>; or one
        of ``displacement``, ``velocity``, ``acceleration`` alone for ``second_difference``.
    form : str
        ``as_printed``: B = <ydot ydot'> (Eqs. 5.8, 5.23), error of order 1 / (T gap) between frequencies.
        ``symmetric_acceleration``: B = -sym <yddot y'> (Eqs. 5.9, 5.33), error of order 1 / (T gap)^2.
        ``exact``: B = -<yddot y'>, not symmetrized: no error for any T, as far as there are no more modes than
        channels, no damping and no noise. ``end_corrected``: B = <ydot ydot'> - [ydot y'] / T, equal to ``exact``
        up to the quadrature error. ``second_difference``: from y alone, with omega = (2/h) asin(h sqrt(lambda) / 2),
        exact at any step h below the Nyquist limit.
    rule : {"trapezoid", "left", "interior", "gregory"}, optional
        How samples are averaged, see `sample_weights`; ``gregory`` by default for ``end_corrected``, else
        ``trapezoid``. ``second_difference`` takes all interior samples.
    n_modes : int, optional
        How many independent motions to keep, those of the largest eigenvalues of A (as `tolerance` compares them); by
        default all above `tolerance`.
    mass : (n_channels,) or (n_channels, n_channels) array, optional
        Mass of the channels (density times quadrature weight in the collocation form of Eq. 5.26, or the mass
        matrix of the interpolation functions in the finite element form of Eq. 5.22). Mode shapes are then M^-1 V, as
        the dissertation has them (of the V that lie in M times the measured motion, Phi (Phi' M Phi)^-1); without it
        they are Phi = V^-T, which needs no mass and is no less exact.
    tolerance : float
        Eigenvalues of A below this part of the largest count as zero, once translations and rotations are each brought
        to unit root mean square.

    Returns
    -------
    ModalRecord
        Frequencies in Hz, mode shapes with largest entry 1; no damping and no covariance.

    Raises
    ------
    InputError
        If quantities or channels are missing, samples are too few, nothing moves, or nothing but a rigid body does.

    Notes
    -----
    For light damping, modes no more than channels and a signal-to-noise ratio above 40 dB. Cost 2 n^2 N for n
    channels and N samples. Undamped frequencies are estimated, with a bias of second order in the damping.

    References
    ----------
    Norris (1986), Eqs. (5.10) to (5.33); Chelidze and Zhou (2006), J. Sound Vib. 292, for the mode shapes V^-T.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.arange(200)[:, None] * 0.05
    >>> both = np.cos(2 * t) * [[1.0, 1.0]] + np.cos(5 * t) * [[1.0, -1.0]]
    >>> record = TimeRecord(20.0, both, ("1Z", "2Z"), ("displacement",) * 2)
    >>> pseudo_rayleigh(record, "displacement", "second_difference").omega.round(9).tolist()
    [2.0, 5.0]
    """
    found = stationary_values(records, pair, form, rule, n_modes, tolerance)
    shapes = found.mode_shapes if mass is None else _inverse_shapes(mass, found.mode_shapes)
    omega, kept, notes = _omega(found.eigenvalues, found.motion.step if form == "second_difference" else 0.0)
    _require_oscillation(omega, found.motion.duration, pair)
    order = np.flatnonzero(kept)[np.argsort(omega[kept], kind="stable")]
    omega = omega[order]
    notes += _doubt_notes(found, omega, pair, form, n_modes)
    source = f"pseudo-Rayleigh quotient, {form}, {pair}, {found.motion.duration:g} s"
    return ModalRecord(
        omega / (2 * np.pi), np.full(len(omega), np.nan), unit_largest(shapes[:, order]), found.motion.channels,
        warnings=notes, source=source,
    )  # fmt: skip


def stationary_values(
    records: TimeRecord | Sequence[TimeRecord],
    pair: Pair = "displacement-velocity",
    form: Form = "end_corrected",
    rule: Rule | None = None,
    n_modes: int | None = None,
    tolerance: float = 1e-12,
) -> StationaryValues:
    """Stationary values of the pseudo-Rayleigh quotient x' B x / x' A x with A = <y y'>, and their vectors.

    y is first brought to independent motions z with <z z'> = 1, by a QR and a singular value decomposition of the
    samples; A itself, whose condition number is the square of theirs, is never formed.

    Parameters
    ----------
    records : TimeRecord or sequence of them
        Free responses; averages < > over time are summed over them.
    pair, form, rule, n_modes, tolerance
        Measured quantities, form of B, rule of quadrature, greatest number of motions and least relative eigenvalue of
        A, as `pseudo_rayleigh` takes them. None for `rule` is ``gregory`` for ``end_corrected``, else ``trapezoid``;
        None for `n_modes` keeps all motions.

    Returns
    -------
    StationaryValues
        Eigenvalues (squared circular frequencies, (rad/s)^2), sorted by real part, with their vectors V and shapes
        V^-T, (n_channels, n_modes) each, in this order.

    Raises
    ------
    InputError
        If options do not fit together, or the records do not suit them.
    """
    quantities = _checked_quantities(pair, form)
    chosen = rule or ("gregory" if form == "end_corrected" else "trapezoid")
    if chosen not in RULES or (form == "second_difference" and rule not in (None, "interior")):
        words = "'interior' for second differences" if form == "second_difference" else ", ".join(RULES)
        raise InputError(f"`rule` must be {words}, got {rule!r}")
    given = (records,) if isinstance(records, TimeRecord) else tuple(records)
    motion = free_motion(given, quantities, chosen)
    to_z, from_z, gram = _independent_motions(motion, tolerance, n_modes)
    z, derivative = motion.base @ to_z, motion.derivative @ to_z
    weighted = derivative * motion.weights[:, None]
    if form == "as_printed":
        printed, exact = derivative.T @ weighted, _smooth_end_corrected(z, derivative, to_z, motion)
    elif form == "end_corrected":
        exact = derivative.T @ weighted - to_z.T @ motion.ends @ to_z
    else:
        exact = weighted.T @ z
        printed = 0.5 * (exact + exact.T)
    values, x = _real_where_close(*np.linalg.eig(exact))
    order = np.argsort(values.real, kind="stable")
    values, x = values[order], x[:, order]
    if form in _SYMMETRIC:
        eigenvalues, y = np.linalg.eigh(printed)
        return StationaryValues(eigenvalues, to_z @ y, from_z @ y, values, gram, motion)
    return StationaryValues(values, to_z @ np.linalg.inv(x).T, from_z @ x, values, gram, motion)


def _smooth_end_corrected(z: FloatArray, derivative: FloatArray, to_z: FloatArray, motion: FreeMotion) -> FloatArray:
    """(<zdot zdot'> - [zdot z'] / T) <z z'>^-1, (rank, rank), by Gregory's quadrature, whatever rule was asked for.

    `z` and `derivative` are (n_rows, rank), `to_z` (n_channels, rank) maps y to z.
    """
    weights = motion.smooth_weights[:, None]
    b = derivative.T @ (weights * derivative) - to_z.T @ motion.ends @ to_z
    return np.linalg.solve(z.T @ (weights * z), b.T).T


def _independent_motions(
    motion: FreeMotion, tolerance: float, n_modes: int | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Maps from channels y to independent motions z with <z z'> = 1 and back, and relative eigenvalues of <y y'>.

    The maps are (n_channels, rank) each: z = y @ first, y = z @ second'; eigenvalues (n_channels,) are over the
    largest, of translations and rotations that are first scaled to a root mean square of 1 each. Those below
    `tolerance` count as zero, and `n_modes`, if not None, is the rank kept. `motion` has the samples. `InputError` if
    `tolerance` is not between 0 and 1, or `n_modes` exceeds the motions there are.
    """
    if not 0 < tolerance < 1:
        raise InputError(f"`tolerance` must lie between 0 and 1, got {tolerance!r}")
    scale = _channel_scale(motion.base, motion.channels)
    root = np.sqrt(motion.weights)[:, None]
    triangle = np.linalg.qr(root * motion.base / scale, mode="r")
    _, singular, rows = np.linalg.svd(triangle)
    gram = np.square(singular / singular[0])
    rank = int(np.sum(gram > tolerance))
    if n_modes is not None:
        if not 1 <= n_modes <= rank:
            raise InputError(
                f"`n_modes` must lie from 1 to {rank}, the number of independent motions of {len(scale)} channels, "
                f"got {n_modes}; add sensors at other places, or a record with another excitation"
            )
        rank = n_modes
    basis = rows[:rank].T
    return basis / singular[:rank] / scale[:, None], scale[:, None] * basis * singular[:rank], gram


def _channel_scale(base: FloatArray, channels: tuple[Dof, ...]) -> FloatArray:
    """Scale of each channel, (n_channels,): root mean square of all translations, or of all rotations; 1 where that is 0.

    `base` (n_times, n_channels) are the samples of `channels`. `InputError` if all are 0.
    """
    turning = np.array([dof.is_rotation for dof in channels])
    scale = np.ones(len(channels))
    for group in (turning, ~turning):
        if group.any():
            scale[group] = np.sqrt(np.mean(np.square(base[:, group])))
    if not scale.any():
        raise InputError("`records` hold no motion: every sample is 0; check the channels, or excite the structure")
    return np.where(scale > 0, scale, 1.0)


def _real_where_close(eigenvalues: NumberArray, x: NumberArray) -> tuple[NumberArray, NumberArray]:
    """Eigenvalues and vectors (columns of `x`), with nearly real conjugate pairs replaced by two real ones each.

    Nearly real is an imaginary part of at most 1e-6 of the largest eigenvalue. The two vectors are real and imaginary
    part of the first. Pairs stand side by side, the positive imaginary part first, as LAPACK gives them. Both results
    are real if all eigenvalues are, nearly. `eigenvalues` is (n,), `x` (n_rows, n).
    """
    if np.isrealobj(eigenvalues):
        return eigenvalues, x
    vectors, x = x, x.copy()
    small = np.abs(eigenvalues.imag) <= 1e-6 * np.abs(eigenvalues).max()
    for i in np.flatnonzero(small & (eigenvalues.imag > 0)):
        x[:, i], x[:, i + 1] = vectors[:, i].real, vectors[:, i].imag
    eigenvalues = np.where(small, eigenvalues.real, eigenvalues)
    return (eigenvalues.real, x.real) if small.all() else (eigenvalues, x)


def _omega(eigenvalues: NumberArray, step: float) -> tuple[FloatArray, NDArray[np.bool_], tuple[str, ...]]:
    """Circular frequencies (rad/s), mask of the meaningful ones, and notes on the others; (n_modes,) each, and a tuple.

    `eigenvalues` are those of the quotient, omega^2; `step` is the time step of a second difference, s, else 0. Values that are
    negative or beyond the Nyquist frequency are not meaningful; of complex ones the magnitude is taken.
    """
    size = np.abs(eigenvalues)
    value = np.where(eigenvalues.imag == 0, np.maximum(eigenvalues.real, 0.0), size)
    kept = eigenvalues.real >= -1e-9 * size.max()
    sine = 0.5 * step * np.sqrt(value)
    kept &= sine <= 1.0
    omega = np.sqrt(value) if step == 0 else 2 / step * np.arcsin(np.minimum(sine, 1.0))
    notes = []
    if not kept.all():
        notes.append(
            f"{int((~kept).sum())} of {len(kept)} stationary values belong to no vibration (negative, or beyond the "
            "Nyquist frequency) and are left out: noise, damping or more modes than sensors. Lower `n_modes`, "
            "filter, or add sensors"
        )
    if (eigenvalues.imag != 0).any():
        notes.append(
            f"{int((eigenvalues.imag != 0).sum())} stationary values are complex; their magnitudes are given. Damping, "
            "noise or more modes than sensors: use a method that estimates damping"
        )
    return omega, kept, tuple(notes)


def _inverse_shapes(mass: ArrayLike, shapes: NumberArray) -> NumberArray:
    """Phi (Phi' M Phi)^-1, (n_channels, n_modes), for `shapes` Phi (n_channels, n_modes) and the mass matrix M.

    `mass` is M (n_channels, n_channels) or its diagonal (n_channels,). `InputError` if it has a wrong shape or is not
    finite, or the condition number of Phi' M Phi exceeds 1e12.
    """
    matrix = locked(mass, np.float64)
    require_finite("mass", matrix)
    n = len(shapes)
    if matrix.shape not in ((n,), (n, n)):
        raise InputError(f"`mass` must have shape ({n},) or ({n}, {n}) for {n} channels, got {matrix.shape}")
    product = shapes.T @ (matrix[:, None] * shapes if matrix.ndim == 1 else matrix @ shapes)
    if np.linalg.cond(product) > 1e12:
        raise InputError("`mass` must be positive for every motion of the channels; give no `mass` where it is not")
    return shapes @ np.linalg.inv(product)


def _checked_quantities(pair: str, form: str) -> tuple[str, ...]:
    """One or two measured quantities of `pair` that `form` uses; `InputError` if the two do not fit together."""
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


def _require_oscillation(omega: FloatArray, duration: float, pair: str) -> None:
    """Raise `InputError` if no mode completes half a period in `duration` (s).

    `omega` are the circular frequencies, rad/s; `pair` is the option of `pseudo_rayleigh`, for the remedy.
    """
    if omega.max(initial=0.0) * duration >= np.pi:
        return
    other = "" if pair == "velocity-acceleration" else ", measuring velocity and acceleration if it is free to drift"
    raise InputError(
        f"`records` hold no oscillation: the fastest motion turns by {omega.max(initial=0.0) * duration:.2g} rad in "
        f"{duration:g} s. A rigid-body motion carries no natural frequency: excite the structure so that it deforms"
        f"{other}; or measure longer"
    )


def _doubt_notes(
    stationary: StationaryValues, omega: FloatArray, pair: str, form: str, n_modes: int | None
) -> tuple[str, ...]:
    """Warnings on what makes the modes of a pseudo-Rayleigh quotient doubtful; () if nothing does.

    Causes: fewer motions than channels, less than half a period, close frequencies, accelerations that no constant
    matrix explains. `stationary` has the quotient's values and the motion; `omega` holds circular frequencies (rad/s),
    increasing; `pair` and `form` are the options of `pseudo_rayleigh`. `n_modes` is the number asked for, None for all.
    """
    motion, gram, rank = stationary.motion, stationary.gram_eigenvalues, len(stationary.eigenvalues)
    # the printed forms push neighbours apart, to a gap of order 1 / T whatever the true one
    apart = np.sqrt(np.maximum(stationary.unsymmetrized.real, 0.0)) if form in _SYMMETRIC else omega
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
    """One note that lists modes of less than half a period in `duration` (s), or []; without rigid-body modes that `pair` allows.

    `omega` (n_modes,) is in rad/s; `pair` names the measured motions, such as ``velocity-acceleration``.
    """
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
    """Warnings on neighbouring modes too close in frequency for the `duration` (s) of the records; [] if there are none.

    Too close is a gap times duration below pi. `apart` are the circular frequencies of the modes, rad/s, increasing; `form` is
    that of the quotient.
    """
    effect = (
        "their frequencies are pushed apart and their shapes mixed; use the form 'end_corrected' or 'exact', and measure"
        if form in _SYMMETRIC
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


def sample_weights(n_samples: int, rule: str) -> FloatArray:
    """Quadrature weights of samples 0..N for the average over the N steps between them, (n_samples,).

    Parameters
    ----------
    n_samples : int
        N + 1.
    rule : {"trapezoid", "left", "interior", "gregory"}
        ``left`` takes samples 0..N-1 and ``interior`` 1..N-1, each by 1/N; ``trapezoid`` halves the two ends;
        ``gregory`` corrects the trapezoid by differences at the ends, with an error of order step^9.

    References
    ----------
    Hildebrand (1974), Introduction to Numerical Analysis, 2nd ed., section 5.9 (Gregory's formula).
    """
    weights = np.ones(n_samples)
    if rule in ("left", "interior"):
        weights[-1] = 0.0
        weights[0] = float(rule == "left")
    else:
        weights[[0, -1]] = 0.5
    if rule == "gregory":
        order = min(_GREGORY_ORDER, (n_samples - 1) // 2)
        difference = np.array([1.0])
        for coefficient in _gregory_coefficients(order):
            difference = np.convolve(difference, [1.0, -1.0])
            weights[: len(difference)] -= coefficient * difference
            weights[::-1][: len(difference)] -= coefficient * difference
    return weights / (n_samples - 1)


def _gregory_coefficients(order: int) -> list[float]:
    """Magnitudes of Gregory's coefficients, `order` of them: 1/12, 1/24, 19/720, ..., of z / log(1 + z) from z^2 on."""
    series = [1.0]
    for n in range(1, order + 2):
        series.append(-sum(series[k] * (-1.0) ** (n - k) / (n - k + 1) for k in range(n)))
    return [abs(c) for c in series[2:]]


@dataclass(frozen=True, eq=False)
class FreeMotion:
    """All records' samples, one below the other.

    Attributes
    ----------
    channels : tuple of Dof
    base : (n_rows, n_channels) float array
        The first quantity y, in the unit of the record.
    derivative : (n_rows, n_channels) float array
        Its time derivative, or its negative second one (measured, or the second difference of y).
    weights : (n_rows,) float array
        Weight of each row in averages over time by the rule asked for; the sum is about 1.
    smooth_weights : (n_rows,) float array
        The same by ``gregory``, the most exact rule.
    ends : (n_channels, n_channels) float array
        [ydot y'] from start to end of each record, summed, over the total duration; zero where not asked for.
    inner, curvature : (n_inner, n_channels) float arrays
        y, and its negative second derivative at the same instants: measured, or by differences of samples.
    duration : float
        Length of the longest record, s.
    step : float
        Sampling step in s (of the first record).
    """

    channels: tuple[Dof, ...]
    base: FloatArray
    derivative: FloatArray
    weights: FloatArray
    smooth_weights: FloatArray
    ends: FloatArray
    inner: FloatArray
    curvature: FloatArray
    duration: float
    step: float

    @property
    def misfit(self) -> float:
        """Relative RMS part (0 to 1) of the acceleration that no constant matrix times the motion explains.

        It is 0 without acceleration. Undamped modes, no more than channels, leave nothing, whatever the step: the
        second difference of cos(w t) is -(4/h^2) sin^2(w h/2) cos(w t), and the central difference of its derivative
        -(w/h) sin(w h) cos(w t).
        """
        triangle = np.asarray(np.linalg.qr(np.concatenate([self.inner, self.curvature], axis=1), mode="r"))
        x, y = triangle[:, : len(self.channels)], triangle[:, len(self.channels) :]
        size = np.linalg.norm(y)
        return float(np.linalg.norm(y - x @ np.linalg.lstsq(x, y, rcond=1e-12)[0]) / size) if size > 0 else 0.0


def free_motion(records: Sequence[TimeRecord], quantities: Sequence[str], rule: str) -> FreeMotion:
    """Motion samples and time derivatives of free responses, checked, with weights for time averages.

    Parameters
    ----------
    records : sequence of TimeRecord
        Free responses with the same channels; lengths may differ, each counts by its duration.
    quantities : one or two names
        The first quantity, and the one that holds its first or second derivative. With one name the second
        derivative is taken by differences of samples; the first and last sample of each record then drop out.
    rule : {"trapezoid", "left", "interior", "gregory"}
        Quadrature of the averages over time; with one name all inner samples count alike.

    Returns
    -------
    FreeMotion
        Rows of all records one after another; the duration is the longest, the step (s) that of the first record.

    Raises
    ------
    InputError
        If a record lacks a quantity or has other channels, samples are too few, or sampling steps differ for
        differences.
    """
    channels = _channels(records, quantities)
    parts = [_one_record(record, channels, quantities, rule) for record in records]
    steps, durations = np.array([part.step for part in parts]), np.array([part.duration for part in parts])
    if len(quantities) == 1 and np.ptp(steps) > 1e-9 * steps.max():
        raise InputError(
            f"`records` must share one sampling step for second differences, got {steps.min():g} to {steps.max():g} s; "
            "resample them, or measure the derivative too"
        )
    shares = durations / durations.sum()
    return FreeMotion(
        channels,
        np.concatenate([part.base for part in parts]),
        np.concatenate([part.derivative for part in parts]),
        np.concatenate([share * part.weights for share, part in zip(shares, parts, strict=True)]),
        np.concatenate([share * part.smooth_weights for share, part in zip(shares, parts, strict=True)]),
        np.sum([part.ends for part in parts], axis=0) / durations.sum(),
        np.concatenate([part.inner for part in parts]),
        np.concatenate([part.curvature for part in parts]),
        float(durations.max()),
        float(steps[0]),
    )


def _one_record(record: TimeRecord, channels: tuple[Dof, ...], quantities: Sequence[str], rule: str) -> FreeMotion:
    """`FreeMotion` of one record: samples (n_rows, n_channels) at `channels`, and weights by `rule`.

    `quantities` are the motion and its first or (sign changed) second derivative; one alone: by differences, of equal
    weights, without first and last sample. `ends` [ydot y'] are not over the duration; 0 unless of a first derivative.
    """
    base, *measured = (_columns(record, channels, quantity) for quantity in quantities)
    step, inner, no_ends = 1 / record.sampling_rate, base[1:-1], np.zeros((len(channels),) * 2)
    spans = step * (len(base) - 1), step
    if not measured:
        second = (2 * inner - base[2:] - base[:-2]) / step**2
        equal = np.full(len(inner), 1 / len(inner))
        return FreeMotion(channels, inner, second, equal, equal, no_ends, inner, second, *spans)
    derivative = measured[0]
    weights, smooth = sample_weights(len(base), rule), sample_weights(len(base), "gregory")
    if MOTION_DERIVATIVES[quantities[1]] - MOTION_DERIVATIVES[quantities[0]] == 2:
        return FreeMotion(channels, base, -derivative, weights, smooth, no_ends, base, -derivative, *spans)
    ends = np.outer(derivative[-1], base[-1]) - np.outer(derivative[0], base[0])
    curvature = (derivative[:-2] - derivative[2:]) / (2 * step)
    return FreeMotion(channels, base, derivative, weights, smooth, ends, inner, curvature, *spans)


def _channels(records: Sequence[TimeRecord], quantities: Sequence[str]) -> tuple[Dof, ...]:
    """Degrees of freedom with all `quantities` in every one of `records`, in the order of the first record.

    `InputError` if a quantity is missing, degrees of freedom differ, a record has fewer than 3 samples, or all together
    have fewer than 2 n_channels + 2.
    """
    if not records:
        raise InputError("`records` must hold at least one TimeRecord, got none")
    wanted: tuple[Dof, ...] | None = None
    for number, record in enumerate(records, 1):
        if not isinstance(record, TimeRecord):
            raise InputError(f"`records` must be TimeRecords of free vibration, got {type(record).__name__}")
        for quantity in quantities:
            found = tuple(c for c, q in zip(record.channels, record.quantities, strict=True) if q == quantity)
            if not found:
                raise InputError(
                    f"record {number} has no {quantity} channel; it holds {', '.join(sorted(set(record.quantities)))}. "
                    "Choose another `pair`, or form='second_difference', which needs one quantity only"
                )
            wanted = found if wanted is None else wanted
            if set(found) != set(wanted):
                odd = ", ".join(str(dof) for dof in sorted(set(found) ^ set(wanted)))
                raise InputError(
                    f"{quantity} of record {number} must be at the same degrees of freedom as {quantities[0]} of "
                    f"record 1, got a difference at {odd}; leave out the channels that are not common"
                )
    assert wanted is not None
    n_samples = sum(len(record.values) for record in records)
    shortest = min(len(record.values) for record in records)
    if shortest < 3 or n_samples < 2 * len(wanted) + 2:
        raise InputError(
            f"`records` must hold at least {2 * len(wanted) + 2} samples for {len(wanted)} channels (3 a record), "
            f"got {n_samples} (shortest {shortest}); measure longer"
        )
    return wanted


def _columns(record: TimeRecord, channels: tuple[Dof, ...], quantity: str) -> FloatArray:
    """Samples of `quantity` at `channels`, (n_times, n_channels)."""
    column_of = {
        (str(dof), str(held)): i for i, (dof, held) in enumerate(zip(record.channels, record.quantities, strict=True))
    }
    return np.take(record.values, [column_of[str(channel), quantity] for channel in channels], axis=1)
