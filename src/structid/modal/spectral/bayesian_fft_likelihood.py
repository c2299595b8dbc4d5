"""Likelihood of the Fourier lines of ambient motion in one band, with its gradient.

F_k, the scaled Fourier transform at line k, is complex normal with covariance

    E_k = Phi H_k Phi' + S_e I,   H_k = diag(h_k) S diag(h_k)^*,   h_kr = (i b)^q / (1 - b^2 + 2 i zeta_r b),  b = f_k / f_r

for m modes with real shapes Phi of unit norm, modal forces of spectral density S (Hermitian), other motion and noise of
density S_e in every channel, and channels of the q-th derivative of displacement. With N = Phi' Phi the inverse and the
determinant need m x m matrices only,

    K_k = (S_e I + N H_k)^-1,   E_k^-1 = (I - Phi H_k K_k Phi') / S_e,   det E_k = S_e^(n - m) / det K_k,

so that an evaluation costs O(n_lines (n m + m^3)) for n channels.

References
----------
Au (2011), Fast Bayesian FFT method for ambient modal identification with separated modes, J. Eng. Mech. 137(3),
214-226; Au (2012), Fast Bayesian ambient modal identification in the frequency domain, Part I: posterior most probable
value, Mech. Syst. Signal Process. 26, 60-75; Part II: posterior uncertainty, 76-90.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray

_PARALLEL = 1e-6  # least eigenvalue of the Gram matrix of shapes that its inverse may have


@dataclass(frozen=True, eq=False)
class BandLines:
    """Fourier lines of one band, of one record or several.

    Attributes
    ----------
    frequency : (n_lines,) float array
        Hz.
    lines : (n_lines, n_channels) complex array
        Scaled so that the mean of F F^* is the one-sided spectral density, over its mean in the band.
    derivative : int
        0, 1 or 2 for displacement, velocity or acceleration.
    """

    frequency: FloatArray
    lines: ComplexArray
    derivative: int

    @property
    def n_channels(self) -> int:
        return self.lines.shape[1]


@dataclass(frozen=True, eq=False)
class BandModes:
    """Parameters of the modes and noise that explain the lines of a band.

    Attributes
    ----------
    frequency, damping_ratio : (m,) float arrays
        Natural frequencies in Hz, and damping ratios.
    shapes : (n_channels, m) float array
        Unit columns.
    force : (m, m) complex array
        Spectral density S of the modal forces, in the unit of the lines.
    noise : float
        S_e, in the unit of the lines.
    """

    frequency: FloatArray
    damping_ratio: FloatArray
    shapes: FloatArray
    force: ComplexArray
    noise: float

    @property
    def n_modes(self) -> int:
        return len(self.frequency)


@dataclass(frozen=True, eq=False)
class Chart:
    """Free coordinates x about given modes, all of order 1, with no direction in which the likelihood is flat.

    x holds ln(f / f_0) / zeta_0 (m), ln(zeta / zeta_0) (m), the components of each shape in the plane tangent to the
    unit sphere at its centre (m (n - 1)), the logarithms of the diagonal of the Cholesky factor L of S (m), the real
    and imaginary parts of L below the diagonal, each over the diagonal entry of its row (m (m - 1)), and ln S_e.

    Attributes
    ----------
    centre : BandModes
    tangents : (m, n_channels, n_channels - 1) float array
        Orthonormal columns, orthogonal to the shape of the centre.
    """

    centre: BandModes
    tangents: FloatArray

    @property
    def size(self) -> int:
        n, m = self.centre.shapes.shape
        return m * (n + 1) + m * m + 1


def chart(centre: BandModes) -> Chart:
    """Chart of coordinates about the modes `centre`, with an orthonormal tangent basis for each shape."""
    tangents = [np.linalg.svd(shape[None, :])[2][1:].T for shape in centre.shapes.T]
    return Chart(centre, np.array(tangents))


def coordinates(chart: Chart) -> FloatArray:
    """Coordinates x (size,) of the centre of a chart; only those of forces and noise differ from 0.

    Their order is: frequencies, damping ratios, shapes, Cholesky factor of the spectral density of the forces
    (logarithms of the diagonal, then real and imaginary parts below it over the diagonal entry of their row), logarithm
    of the noise.
    """
    m, x = chart.centre.n_modes, np.zeros(chart.size)
    root = np.linalg.cholesky(chart.centre.force)
    size, below = root.diagonal().real, np.tril_indices(m, -1)
    ratio = root[below] / size[below[0]]
    tail = np.concatenate([np.log(size), ratio.real, ratio.imag, [np.log(chart.centre.noise)]])
    x[-len(tail) :] = tail
    return x


def _root(x: FloatArray, m: int) -> ComplexArray:
    """Lower Cholesky factor L (m, m) of the spectral density of modal forces, S = L L^*, from coordinates of m modes.

    Of all coordinates `x` (size,) of a chart it uses the m^2 before the last: logarithms of the diagonal, then real and
    imaginary parts of the entries below it, row by row, over the diagonal entry of their row.
    """
    tail = x[len(x) - m * m - 1 : len(x) - 1]
    size, n_below = np.exp(tail[:m]), m * (m - 1) // 2
    below, root = np.tril_indices(m, -1), np.diag(size).astype(complex)
    root[below] = (tail[m : m + n_below] + 1j * tail[m + n_below :]) * size[below[0]]
    return root


def _vectors(chart: Chart, x: FloatArray) -> FloatArray:
    """Shapes (n_channels, m) at the coordinates `x` of the `chart`, before they are given unit norm."""
    n, m = chart.centre.shapes.shape
    t = x[2 * m : m * (n + 1)].reshape(m, n - 1)
    return np.asarray(chart.centre.shapes + np.einsum("mnt,mt->nm", chart.tangents, t))


def modes_at(chart: Chart, x: FloatArray) -> BandModes:
    """Modes, forces and noise with coordinates `x` (size,) in a chart."""
    centre, m = chart.centre, chart.centre.n_modes
    vectors, root = _vectors(chart, x), _root(x, m)
    return BandModes(
        centre.frequency * np.exp(centre.damping_ratio * x[:m]),
        centre.damping_ratio * np.exp(x[m : 2 * m]),
        vectors / np.linalg.norm(vectors, axis=0),
        root @ root.conj().T,
        float(np.exp(x[-1])),
    )


def transfer(data: BandLines, modes: BandModes) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Transfer function h of every line and mode, and its derivatives by ln f and ln zeta, (n_lines, m) each.

    h is (i b)^d / (1 - b^2 + 2 i zeta b), with b the frequency of the line over that of the mode and d the derivative (0 to 2)
    of displacement that the lines hold.
    """
    b = data.frequency[:, None] / modes.frequency
    friction = 2j * modes.damping_ratio * b
    below = 1 - b**2 + friction
    h = np.asarray((1j * b) ** data.derivative / below, dtype=np.complex128)
    to_frequency = h * ((friction - 2 * b**2) / below - data.derivative)
    return h, np.asarray(to_frequency, dtype=np.complex128), np.asarray(-h * friction / below, dtype=np.complex128)


@dataclass(frozen=True, eq=False)
class Solved:
    """Quantities derived from the covariance of every line, without differences of large numbers.

    Attributes
    ----------
    value : float
        Negative log-likelihood.
    kernel : (n_lines, m, m) complex array
        K = (S_e I + N H)^-1.
    a : (n_lines, n_channels) complex array
        E^-1 F.
    seen : (n_lines, m) complex array
        Phi' E^-1 F = K Phi' F.
    trace : float
        Sum of tr E^-1 over the lines.
    """

    value: float
    kernel: ComplexArray
    a: ComplexArray
    seen: ComplexArray
    trace: float


def solved(data: BandLines, modes: BandModes, spectra: ComplexArray) -> Solved:
    """Negative log-likelihood of the lines F, up to a constant, and products with the covariance E of each line.

    E is Phi H Phi' + S_e I for shapes Phi, noise S_e and `spectra` H (n_lines, m, m), the spectral densities of the
    modal responses. The products are, in this order, (S_e I + Phi' Phi H)^-1, (n_lines, m, m), E^-1 F, Phi' E^-1 F and
    the sum of tr E^-1. Kernels of size m serve instead of n_channels; where shapes span all channels or are nearly
    parallel, E itself is inverted.
    """
    n, m = modes.shapes.shape
    gram = modes.shapes.T @ modes.shapes
    inner = modes.noise * np.eye(m) + gram @ spectra
    kernel = np.linalg.inv(inner)
    within = data.lines @ modes.shapes
    seen = (kernel @ within[:, :, None])[:, :, 0]
    if n > m and np.linalg.eigvalsh(gram)[0] > _PARALLEL:
        back = np.linalg.solve(gram, modes.shapes.T)
        a = seen @ back + (data.lines - within @ back) / modes.noise
        trace = len(within) * (n - m) / modes.noise + float(np.einsum("kii->", kernel).real)
    else:
        inverse = np.linalg.inv(modes.shapes @ spectra @ modes.shapes.T + modes.noise * np.eye(n))
        a = (inverse @ data.lines[:, :, None])[:, :, 0]
        trace = float(np.einsum("kii->", inverse).real)
    value = len(within) * (n - m) * np.log(modes.noise) + float(np.linalg.slogdet(inner)[1].sum())
    return Solved(value + float(np.sum((data.lines.conj() * a).real)), kernel, a, seen, trace)


def force_spectra(h: ComplexArray, modes: BandModes) -> ComplexArray:
    """Spectral density H of the modal responses at every line, (n_lines, m, m); `h` (n_lines, m) is the transfer function."""
    return np.asarray(h[:, :, None] * modes.force * h[:, None, :].conj())


def negative_log_likelihood(data: BandLines, modes: BandModes) -> float:
    """Negative log-likelihood of the lines: the sum of ln det E_k + F_k^* E_k^-1 F_k over lines k, without constants."""
    return solved(data, modes, force_spectra(transfer(data, modes)[0], modes)).value


def gradient(data: BandLines, chart: Chart, x: FloatArray) -> tuple[float, FloatArray]:
    """Negative log-likelihood at coordinates `x` (size,) of a chart, up to a constant, and its gradient (size,).

    With the lines F_k, their covariances E_k, a_k = E_k^-1 F_k and W_k = E_k^-1 - a_k a_k^*, the change is the sum of
    tr(W_k dE_k).
    """
    modes, m = modes_at(chart, x), chart.centre.n_modes
    h, dh_f, dh_zeta = transfer(data, modes)
    spectra = force_spectra(h, modes)
    found = solved(data, modes, spectra)
    gram = modes.shapes.T @ modes.shapes
    q = found.kernel @ gram - found.seen[:, :, None] * found.seen[:, None, :].conj()  # Phi' W Phi
    root = _root(x, m)
    forced = modes.force * h[:, None, :].conj()  # S h^*
    turned = np.sum(forced * q.transpose(0, 2, 1), axis=2)
    slope_f, slope_zeta = (2 * np.sum(turned * dh, axis=0).real for dh in (dh_f, dh_zeta))
    slope_force = np.sum(h[:, :, None].conj() * q * h[:, None, :], axis=0)
    slope_root = 2 * slope_force @ root
    slope_noise = found.trace - float(np.sum(np.abs(found.a) ** 2))
    # derivative to Phi: 2 Re sum of W Phi H, with E^-1 Phi H = Phi H K
    inside = np.sum(spectra @ found.kernel, axis=0).real
    outside = found.a.T @ (found.seen.conj()[:, None, :] @ spectra)[:, 0]
    slope_shape = 2 * (modes.shapes @ inside - outside.real)
    return found.value, np.concatenate([
        chart.centre.damping_ratio * slope_f, slope_zeta, _along_tangents(chart, x, modes, slope_shape),
        _of_triangle(root, slope_root), [modes.noise * slope_noise],
    ])  # fmt: skip


def _along_tangents(chart: Chart, x: FloatArray, modes: BandModes, slope: FloatArray) -> FloatArray:
    """Gradient by the shape coordinates, (m (n_channels - 1),), from the gradient `slope` (n_channels, m) by unit shapes.

    `modes` are those at coordinates `x`.
    """
    length = np.linalg.norm(_vectors(chart, x), axis=0)
    across = (slope - modes.shapes * np.sum(modes.shapes * slope, axis=0)) / length
    return np.einsum("mnt,nm->mt", chart.tangents, across).ravel()


def _of_triangle(root: ComplexArray, slope: ComplexArray) -> FloatArray:
    """Gradient by the m^2 coordinates of a lower Cholesky factor `root` (m, m), from the gradient `slope` by its entries.

    The order is that of `Chart`: logarithms of the diagonal, then real and imaginary parts below it. `slope` is (m, m).
    """
    below, size, lower = np.tril_indices(len(root), -1), root.diagonal().real, np.tril(root)
    slope_log = np.sum(slope.real * lower.real + slope.imag * lower.imag, axis=1)
    part = slope[below] * size[below[0]]
    return np.concatenate([slope_log, part.real, part.imag])
