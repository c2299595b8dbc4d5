"""Poles of a vibrating structure with their mode shapes, and the hard criteria that a physical pole meets."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import (
    ComplexArray,
    FloatArray,
    IntArray,
    arrays_to_tuples,
    locked,
    require_finite,
    require_shape,
)
from structid.core.errors import InputError


@dataclass(frozen=True, eq=False)
class Poles:
    """Poles in the upper half plane, each standing for its conjugate pair, by increasing magnitude.

    Parameters
    ----------
    poles : (n_poles,) complex array
        s = -zeta omega + i omega sqrt(1 - zeta^2), rad/s.
    shapes : (n_channels, n_poles) complex array
        Motion of every channel, in the unit of the channel.
    order : int
        States of the model that the poles come from.
    energy : (n_poles,) float array, optional
        Size of the part of each pole in what the model was fitted to, over that of the whole; unknown by default.

    Raises
    ------
    InputError
        If shapes disagree or an entry is not finite.
    """

    poles: ComplexArray
    shapes: ComplexArray
    order: int
    energy: FloatArray | None = None

    def __post_init__(self) -> None:
        """Make arrays read-only and raise `InputError` on wrong shapes, or poles or shapes that are not finite.

        `energy` None becomes NaN for each pole.
        """
        object.__setattr__(self, "poles", locked(self.poles, np.complex128))
        energy = np.full(len(self.poles), np.nan) if self.energy is None else self.energy
        object.__setattr__(self, "energy", locked(energy, np.float64))
        require_shape("energy", np.asarray(self.energy), (len(self.poles),), "one for each pole")
        object.__setattr__(self, "shapes", locked(self.shapes, np.complex128))
        require_shape("poles", self.poles, (None,))
        require_shape("shapes", self.shapes, (None, len(self.poles)), "one column a pole")
        require_finite("poles", self.poles)
        require_finite("shapes", self.shapes)

    def select(self, indices: IntArray | NDArray[np.bool_]) -> Poles:
        """The poles at `indices`, or where a mask of them is true."""
        return Poles(self.poles[indices], self.shapes[:, indices], self.order, np.asarray(self.energy)[indices])

    @property
    def omega(self) -> FloatArray:
        """Undamped circular frequency |s|, rad/s."""
        return np.abs(self.poles)

    @property
    def frequency(self) -> FloatArray:
        """Undamped natural frequency, Hz."""
        return self.omega / (2 * np.pi)

    @property
    def damping_ratio(self) -> FloatArray:
        """Viscous damping ratio -Re(s) / |s|."""
        return np.asarray(-self.poles.real / self.omega)

    @property
    def mpc(self) -> FloatArray:
        """Modal phase collinearity of every shape: 1 for a real shape in any phase, 0 for a circular one."""
        return modal_phase_collinearity(self.shapes)


@dataclass(frozen=True)
class HardCriteria:
    """Hard criteria for poles; the defaults exclude only what no structure shows.

    Parameters
    ----------
    frequency : (float, float)
        Least and greatest undamped frequency, Hz.
    damping_ratio : (float, float)
        Least and greatest; a little below 0, for undamped free motion in noise. Ambient motion shows no mode below 0.
    mpc : float
        Least modal phase collinearity; 0 lets every shape pass.
    """

    frequency: tuple[float, float] = (0.0, np.inf)
    damping_ratio: tuple[float, float] = (-0.01, 0.2)
    mpc: float = 0.0

    def __post_init__(self) -> None:
        """Make tuples of arrays; raise `InputError` on a range of frequency or damping ratio that does not increase."""
        arrays_to_tuples(self, "frequency", "damping_ratio")
        for name in ("frequency", "damping_ratio"):
            low, high = getattr(self, name)
            if not low < high:
                raise InputError(f"`{name}` must be a range (least, greatest), got ({low!r}, {high!r})")

    @property
    def damped(self) -> HardCriteria:
        """Copy of these criteria with a damping ratio above 0, for modes of ambient motion."""
        low, high = self.damping_ratio
        return replace(self, damping_ratio=(max(low, float(np.nextafter(0.0, 1.0))), high))

    def meets(self, frequency: FloatArray, ratio: FloatArray) -> NDArray[np.bool_]:
        """Mask (n,) of frequencies (Hz) and damping ratios `ratio` that lie in both ranges, limits included.

        `mpc` is not tested.
        """
        good = (frequency >= self.frequency[0]) & (frequency <= self.frequency[1])
        return np.asarray(good & (ratio >= self.damping_ratio[0]) & (ratio <= self.damping_ratio[1]))

    def indices(self, poles: Poles) -> IntArray:
        """Indices (from 0), increasing, of the `poles` within both ranges and with the least MPC or more."""
        good = self.meets(poles.frequency, poles.damping_ratio)
        if self.mpc > 0:
            good &= poles.mpc >= self.mpc
        return np.flatnonzero(good)


def modal_phase_collinearity(shapes: ComplexArray) -> FloatArray:
    """Modal phase collinearity of each mode shape, (n_modes,): 1 for a real shape in any phase, 0 for a circular one.

    `shapes` is (n_channels, n_modes). Unknown entries (NaN) are passed over; NaN where all of a column are unknown.

    References
    ----------
    Pappa, Elliott and Schenk (1993), J. Guid. Control Dyn. 16(5), Eq. (21), without removal of the mean.
    """
    x, y = shapes.real, shapes.imag
    xx, yy, xy = (np.nansum(a * b, axis=0) for a, b in ((x, x), (y, y), (x, y)))
    total = np.where(np.isnan(shapes).all(axis=0), np.nan, xx + yy)
    return np.asarray(((xx - yy) ** 2 + 4 * xy**2) / np.where(total == 0, 1.0, total) ** 2)


def modal_phase_deviation(shapes: ComplexArray) -> FloatArray:
    """Mean phase deviation of each mode shape from a straight line, weighted by size, in degrees, (n_modes,).

    0 for a real shape in any phase, 45 for a circular one. Unknown entries (NaN) have no part; NaN where all are
    unknown. `shapes` is (n_channels, n_modes).

    References
    ----------
    Heylen, Lammens and Sas (1997), Modal Analysis Theory and Testing, section A.4 (MPD); the line by total least squares,
    as Reynders, Houbrechts and De Roeck (2012), Mech. Syst. Signal Process. 29, Eq. (10).
    """
    x, y = shapes.real, shapes.imag
    xx, yy, xy = (np.nansum(a * b, axis=0) for a, b in ((x, x), (y, y), (x, y)))
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    turned, size = shapes * np.exp(-1j * angle), np.abs(shapes)
    deviation = np.degrees(np.arctan2(np.abs(turned.imag), np.abs(turned.real)))
    total = np.where(np.isnan(shapes).all(axis=0), np.nan, np.nansum(size, axis=0))
    return np.asarray(np.nansum(deviation * size, axis=0) / np.where(total == 0, 1.0, total))


def frequency_damping_slope(poles: ComplexArray) -> FloatArray:
    """Derivatives of frequencies (Hz), then damping ratios, by all Re s, then all Im s, (2 n_poles, 2 n_poles).

    `poles` (n_poles,) are s in rad/s.
    """
    size = np.abs(poles)
    across = poles.imag / size**3
    slope = np.block([[np.diag(poles.real / size), np.diag(poles.imag / size)],
                      [np.diag(-poles.imag * across), np.diag(poles.real * across)]])  # fmt: skip
    slope[: len(size)] /= 2 * np.pi
    return slope


def state_poles(
    transition: FloatArray, output: FloatArray, sampling_rate: float, sizes: FloatArray | None = None
) -> Poles:
    """Continuous-time poles (rad/s) in the upper half plane, and shapes, of the model x(k+1) = A x(k), y(k) = C x(k).

    Poles are sorted by magnitude; shapes are C v for the eigenvectors v of A, (n_channels, n_poles), not scaled.

    Parameters
    ----------
    transition : (order, order) float array
        A. Eigenvalues on the real axis belong to no vibration, or to one at the Nyquist frequency, and are left out.
    output : (n_channels, order) float array
        C.
    sampling_rate : float
        Hz.
    sizes : (order,) float array, optional
        Singular values of the block Hankel matrix, where the states are those of its left singular vectors: they give
        the energy of each pole, |v| |w S| over |S| for the right and left eigenvectors v and w with w v = 1; NaN
        without them.

    Raises
    ------
    LinAlgError
        If the eigenvalues do not converge.
    """
    from scipy.linalg import lapack

    real, imaginary, _, basis, status = lapack.dgeev(transition, compute_vl=0)
    if status != 0:
        raise np.linalg.LinAlgError(f"the eigenvalues of a model of {len(transition)} states did not converge")
    values = real + 1j * imaginary
    kept = oscillating(values, sampling_rate)
    energy = None
    if sizes is not None:  # a pair stands in two columns of norm 1 together, real and imaginary part
        duals = np.linalg.inv(basis) * (0.5 / np.sqrt(sizes @ sizes) * sizes)
        square = np.einsum("ij,ij->i", duals, duals)
        energy = np.sqrt(square[kept] + square[kept + 1])
    columns = output @ basis
    shapes = columns[:, kept] + 1j * columns[:, kept + 1]
    return Poles(np.log(values[kept]) * sampling_rate, shapes, len(transition), energy)


def oscillating(values: ComplexArray, sampling_rate: float) -> IntArray:
    """Indices of the discrete poles `values` (n,) in the upper half plane, by increasing magnitude of their continuous ones.

    `sampling_rate` is in Hz.
    """
    kept = np.flatnonzero(values.imag > 0)
    size = np.abs(np.log(values[kept].astype(np.complex128)) * sampling_rate)
    return np.asarray(kept[np.argsort(size, kind="stable")])
