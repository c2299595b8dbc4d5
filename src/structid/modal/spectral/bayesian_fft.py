"""Fast Bayesian FFT method: modes of ambient motion in bands of the spectrum, with their posterior covariance.

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
value, Mech. Syst. Signal Process. 26, 60-75; Part II: posterior uncertainty, 76-90; Au (2017), Operational Modal Analysis,
Springer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.dof import Dof
from structid.core.errors import InputError, NoModesError
from structid.modal.correlations import ScaledMotion, outputs
from structid.modal.method import ModalIdentification, ModalOptions
from structid.modal.modal_record import ModalRecord, by_frequency, joined
from structid.modal.spectral.peaks import (
    Band,
    Spectrum,
    automatic_bands,
    automatic_peaks,
    centred,
    chosen_peaks,
    default_segment,
    mode_places,
    singular_spectrum,
)
from structid.records import TimeRecord

_PARALLEL = 1e-6  # least eigenvalue of the Gram matrix of shapes that its inverse may have
_FEW_LINES = 4.0  # half-power bandwidth in lines of the record below which leakage shows in the damping
_DAMPING = (0.003, 0.01, 0.03)
_DAMPING_LIMITS = (1e-5, 0.5)
_SEARCH_LINES = 200
_SEARCHES = 2
_SEARCH_STEPS = 20
_STEPS = 40
_DECREMENT = 1e-8
_STEP = 1e-4  # of coordinates of order 1, for differences of gradients


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
    """Transfer function h of every line of `data` and mode, and its derivatives by ln f and ln zeta, (n_lines, m) each.

    h is (i b)^d / (1 - b^2 + 2 i zeta b), with b the frequency of the line over that of the mode and d the derivative
    (0 to 2) of displacement that the lines hold; f and zeta are the frequencies and damping ratios of `modes`.
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
    """Negative log-likelihood of the lines F of `data`, up to a constant, and products with the covariance E of each.

    E is Phi H Phi' + S_e I for the shapes Phi and the noise S_e of `modes`, and `spectra` H (n_lines, m, m), the
    spectral densities of the modal responses. The fields are, in this order, the value, (S_e I + Phi' Phi H)^-1,
    (n_lines, m, m), E^-1 F, (n_lines, n_channels), Phi' E^-1 F, (n_lines, m), and the sum of tr E^-1. Kernels of size m
    serve instead of n_channels; where shapes span all channels or are nearly parallel, E itself is inverted.
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
    """Gradient (m^2,) of a function by the coordinates of a lower Cholesky factor `root` (m, m).

    `slope` (m, m) is the gradient by the factor's entries, real parts by Re and imaginary ones by Im. The order is that
    of `Chart`: logarithms of the diagonal, then real and imaginary parts below it over the diagonal entry of their row.
    """
    below, size, lower = np.tril_indices(len(root), -1), root.diagonal().real, np.tril(root)
    slope_log = np.sum(slope.real * lower.real + slope.imag * lower.imag, axis=1)
    part = slope[below] * size[below[0]]
    return np.concatenate([slope_log, part.real, part.imag])


def bayesian_fft(
    records: TimeRecord | Sequence[TimeRecord], options: ModalOptions | None = None
) -> ModalIdentification:
    """Most probable modes of ambient motion and their posterior covariance, band by band.

    In each band the Fourier lines of the whole record, without a window, are complex normal with the spectral density
    of a few modes under white modal forces (correlated with each other) and of noise that is equal in all channels.

    Parameters
    ----------
    records : TimeRecord or sequence of them
        Displacement, velocity or acceleration. Several records of the same channels are taken to have the same modal
        forces and noise; their log-likelihoods add up. Channels of various quantities are brought to the commonest one
        by powers of i omega, and averaged where they share a degree of freedom.
    options : ModalOptions, optional
        Used are `bands`, `frequencies` (where the modes are, one each; in bands given, as a start for the search
        only), `segment` (of the singular spectra that bands are chosen from) and `criteria`. Without `bands`, these lie
        around the automatic peaks of the first singular value, and `warnings` names them.

    Returns
    -------
    ModalIdentification
        Real mode shapes. `covariance` and `shape_std` are those of a normal distribution about the most probable
        values; bands are independent of each other. NaN for a band whose data do not determine its modes.

    Raises
    ------
    InputError
        If a band lies outside the spectrum or has fewer lines than (m + 1)^2 for m modes, no band is found, a
        frequency is near no peak, or no mode meets `criteria`.

    Notes
    -----
    Assumes white forces and noise within a band, light damping and a record much longer than the memory of its modes,
    1 / (zeta omega): lines are then independent, and leakage is small. A warning says where the half-power bandwidth
    2 zeta f is less than four lines. Prior distributions are uniform. For one well separated mode and long data the
    variances are zeta / (2 pi N_c B_f) f^2 and zeta / (2 pi N_c B_zeta), with N_c periods in the record.

    Cost O(n_lines (n m + m^3)) an evaluation and n m evaluations for the Hessian, for n channels.

    References
    ----------
    Au (2012), Mech. Syst. Signal Process. 26, 60-75 and 76-90; Au (2014), Uncertainty law in ambient modal
    identification, Mech. Syst. Signal Process. 48, 15-33.
    """
    options = options or ModalOptions()
    data = centred(outputs(records))
    notes: list[str] = []
    bands = _bands(data, options, notes)
    posteriors, channels = [], None
    for number, band in enumerate(bands, 1):
        lines, channels = band_lines(data, band.low, band.high)
        need = (band.n_modes + 1) ** 2
        if len(lines.frequency) < need:
            raise InputError(
                f"`bands` must hold at least {need} lines for {band.n_modes} modes, got {len(lines.frequency)} in "
                f"{band.low:.4g} to {band.high:.4g} Hz; widen the band, or measure longer"
            )
        posteriors.append(posterior(lines, band.peaks))
        notes += _band_warnings(number, band, posteriors[-1], data)
    assert channels is not None
    modes = _modal_record(
        posteriors, channels, options, notes, f"Bayesian FFT, {len(bands)} bands, {data.duration:g} s"
    )
    return ModalIdentification(modes, "bayesian_fft", options=options)


def band_lines(data: ScaledMotion, low: float, high: float) -> tuple[BandLines, tuple[Dof, ...]]:
    """Scaled Fourier lines of all records from `low` to `high` (Hz), and the degrees of freedom measured.

    All channels are brought to the commonest quantity by powers of i omega.

    Returns
    -------
    BandLines
        Lines of all records, one record after another, scaled so that their mean square is 1. Those at 0 Hz and at half
        the sampling rate are left out.
    tuple of Dof
        One for each column of the lines; channels of one degree of freedom are averaged.
    """
    kinds = data.derivative
    kind = int(np.bincount(kinds).argmax())
    dofs = tuple(dict.fromkeys(data.channels))
    merge = np.array([[channel == dof for dof in dofs] for channel in data.channels], dtype=float)
    merge /= merge.sum(axis=0)
    frequency, lines = [], []
    for y in data.series:
        f = np.fft.rfftfreq(len(y), 1 / data.sampling_rate)
        keep = np.flatnonzero((f >= low) & (f <= high) & (f > 0) & (f < data.sampling_rate / 2))
        own = np.stack([np.fft.rfft(column)[keep] for column in y.T], axis=1) * data.scale
        own = own * np.sqrt(2 / (len(y) * data.sampling_rate))
        frequency.append(f[keep])
        lines.append(own * (2j * np.pi * f[keep, None]) ** (kind - kinds) @ merge)
    values = np.concatenate(lines)
    size = np.sqrt(np.mean(np.abs(values) ** 2)) if len(values) else 1.0
    return BandLines(np.concatenate(frequency), np.asarray(values / size, dtype=np.complex128), kind), dofs


def _bands(data: ScaledMotion, options: ModalOptions, notes: list[str]) -> tuple[Band, ...]:
    """Bands of `options`, or bands around automatic peaks of `data`, with limits and frequencies of their modes, in Hz.

    A note that lists automatic bands, or names a band without a peak, is appended to `notes`. `InputError` if a band
    does not suit the spectrum, bands overlap, or a frequency asked for is near no peak.
    """
    if options.bands is not None:
        spectrum = singular_spectrum(data, options.segment or default_segment(data))
        top = data.sampling_rate / 2
        return tuple(_given_band(spectrum, top, *band, options, notes) for band in options.separate_bands)
    spectrum, peaks = chosen_peaks(data, options)
    bands = automatic_bands(spectrum, peaks.tolist())
    listed = ", ".join(f"{b.low:.4g}-{b.high:.4g} Hz ({b.n_modes})" for b in bands)
    notes.append(f"bands (number of modes): {listed}; chosen from the singular spectra. Give `bands` to set them")
    return bands


def _given_band(
    spectrum: Spectrum, top: float, low: float, high: float, options: ModalOptions, notes: list[str]
) -> Band:
    """Band from `low` to `high` (Hz) with the frequencies (Hz) where its modes may be, one for each mode.

    These are the `options.frequencies` inside the band; without them its significant peaks and crests of the singular
    values, or else the line of the greatest first singular value, and a note on that is appended to `notes`.
    `InputError` if the band reaches beyond `top` (Hz), half the sampling rate, or none of the frequencies lies in it.
    """
    if high > top:
        raise InputError(f"`bands` must lie between 0 and {top:g} Hz, got ({low:g}, {high:g}); sample faster")
    if options.frequencies is not None:
        own = tuple(sorted(float(f) for f in options.frequencies if low <= f <= high))
        if not own:
            raise InputError(f"`frequencies` must name a mode in every band, got none in {low:g} to {high:g} Hz")
        return Band(low, high, own)
    peaks = mode_places(spectrum, low, high, [int(k) for k in automatic_peaks(spectrum)])
    if not peaks:
        middle = 0.5 * (low + high)
        inside = np.flatnonzero((spectrum.frequency >= low) & (spectrum.frequency <= high))
        peaks = (float(spectrum.frequency[inside[spectrum.values[inside, 0].argmax()]]) if len(inside) else middle,)
        notes.append(f"no peak stands out between {low:g} and {high:g} Hz; one mode is searched for anyway")
    return Band(low, high, peaks)


def _band_warnings(number: int, band: Band, posterior: Posterior, data: ScaledMotion) -> list[str]:
    """Warnings on a frequency band whose modes are doubtful; an empty list if none is.

    They are on a search that has not converged, values that the data do not determine, resonances of less than four
    lines of the longest record, and modes outside the band. `posterior` has the modes found, `number` (from 1) is that
    of the band in the words.
    """
    words, spacing = [], 1 / data.duration
    where = f"band {number}, {band.low:.4g} to {band.high:.4g} Hz"
    if not posterior.converged:
        words.append(f"{where}: the search for the most probable values has not converged; change the band")
    if not np.isfinite(posterior.covariance).all():
        words.append(
            f"{where}: the data do not determine all that {band.n_modes} modes need, so no covariance is given; widen "
            "the band, or look for fewer modes there"
        )
    for f, zeta in zip(posterior.modes.frequency, posterior.modes.damping_ratio, strict=True):
        if 2 * zeta * f < _FEW_LINES * spacing:
            words.append(
                f"{where}: the half-power bandwidth of the mode at {f:.4g} Hz is {2 * zeta * f / spacing:.2g} lines of "
                f"{spacing:.2g} Hz; leakage raises its damping ratio. Measure longer"
            )
        if not band.low < f < band.high:
            words.append(f"{where}: a mode was found at {f:.4g} Hz, outside the band; it fits a slope, not a peak")
    return words


def _modal_record(
    posteriors: Sequence[Posterior], channels: tuple[Dof, ...], options: ModalOptions, notes: list[str], source: str
) -> ModalRecord:
    """Modal record of the modes of all bands that meet `options.criteria`, by increasing frequency.

    `posteriors` has one item per band, with shapes at `channels`. Modes left out are appended to `notes`, which become
    the warnings. `NoModesError` if none is left. `source` says where the record comes from.
    """
    parts = []
    for posterior in posteriors:
        unit, std = _unit_largest(posterior.modes.shapes, posterior.shape_covariance)
        parts.append(
            by_frequency(
                posterior.modes.frequency, posterior.modes.damping_ratio, unit, channels, posterior.covariance, std
            )
        )
    modes = joined(parts, (), source)
    good = options.criteria.meets(modes.frequency, modes.damping_ratio)
    if not good.any():
        raise NoModesError("`records` show no mode that meets `criteria`; widen them, or change `bands`")
    notes += [
        f"the mode at {modes.frequency[k]:.4g} Hz, damping ratio {modes.damping_ratio[k]:.3g}, does not meet `criteria`:"
        " left out"
        for k in np.flatnonzero(~good)
    ]
    return replace(modes.some_modes(np.flatnonzero(good)), warnings=tuple(notes))


def _unit_largest(shapes: FloatArray, covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """`shapes` (n_channels, n_modes) with largest entry 1, and the standard deviation of every entry, shaped alike.

    `covariances` (n_modes, n_channels, n_channels) are those of each of `shapes` as given; the deviation of the largest
    entry is 0.
    """
    unit, std = np.empty_like(shapes), np.empty_like(shapes)
    for r, (shape, covariance) in enumerate(zip(shapes.T, covariances, strict=True)):
        top = int(np.abs(shape).argmax())
        unit[:, r] = shape / shape[top]
        change = np.eye(len(shape))
        change[:, top] -= unit[:, r]
        spread = change @ covariance @ change.T / shape[top] ** 2
        std[:, r] = np.sqrt(np.maximum(np.diag(spread), 0.0))
    return unit, std


@dataclass(frozen=True, eq=False)
class Posterior:
    """Modes of a band and how well its data determine them.

    Attributes
    ----------
    modes : BandModes
        Most probable.
    covariance : (2 m, 2 m) float array
        Covariance of all frequencies (Hz), then all damping ratios; NaN where the data do not determine them.
    shape_covariance : (m, n_channels, n_channels) float array
        Covariance of each shape of unit norm; singular along the shape itself, since the norm is fixed.
    converged : bool
        Whether a last Newton step would change no coordinate by 1e-4 of its standard deviation.
    """

    modes: BandModes
    covariance: FloatArray
    shape_covariance: FloatArray
    converged: bool


def posterior(data: BandLines, frequencies: Sequence[float]) -> Posterior:
    """Most probable modes near `frequencies` (Hz, one for each mode) and their posterior covariance.

    The search has several starts, and uses part of the lines and the directions in which the band has most power; the
    best result is refined with all lines and channels. Covariances are NaN where the data do not determine the modes,
    and `converged` is false where the steps did not suffice.
    """
    every = max(1, len(data.frequency) // _SEARCH_LINES)
    kept = min(data.n_channels, 2 * len(frequencies) + 2)
    basis = np.linalg.eigh((data.lines.T @ data.lines.conj()).real)[1][:, ::-1][:, :kept]
    part = replace(data, frequency=data.frequency[::every], lines=data.lines[::every] @ basis)
    likely = sorted(starts(part, frequencies), key=lambda modes: negative_log_likelihood(part, modes))[
        : min(len(frequencies), _SEARCHES)
    ]
    searched = [_newton(part, modes, _SEARCH_STEPS)[0].centre for modes in likely]
    best = min(searched, key=lambda modes: negative_log_likelihood(part, modes))
    return _refine_posterior(data, replace(best, shapes=basis @ best.shapes))


def _newton(data: BandLines, modes: BandModes, n_steps: int) -> tuple[Chart, float, FloatArray]:
    """Chart about the modes where Newton's method from `modes` ended, decrease still expected before, and Hessian.

    The Hessian (size, size) is that of the negative log-likelihood of the lines `data` in the chart's coordinates; all
    NaN if `n_steps` did not suffice or an entry is not finite. The decrease is of twice that function; infinite if none
    was computed.
    """
    place = chart(modes)
    unknown = np.full((place.size,) * 2, np.nan)
    decrement = np.inf
    for _ in range(n_steps):
        x = coordinates(place)
        value, slope = gradient(data, place, x)
        curvature = hessian(data, place, x)
        if not np.isfinite(curvature).all():
            return place, decrement, unknown
        values, vectors = np.linalg.eigh(curvature)
        along = vectors.T @ slope
        size = np.maximum(np.abs(values), 1e-9 * np.abs(values).max())
        decrement = float(np.sum(along**2 / size))
        if decrement < _DECREMENT:
            return place, decrement, curvature
        step = -vectors @ (along / size)
        step = _shorten_step(data, place, x, step)
        while not gradient(data, place, x + step)[0] < value:
            step = 0.5 * step
            if np.abs(step).max() < 1e-9:
                return place, decrement, curvature
        place = chart(modes_at(place, x + step))
    return place, decrement, unknown


def _shorten_step(data: BandLines, chart: Chart, x: FloatArray, step: FloatArray) -> FloatArray:
    """The `step` (size,) from coordinates `x` (size,) shortened as a whole to at most 1 in every coordinate.

    Its entries for frequencies and damping ratios are then cut off where these would leave the lines of the band or the
    range from 1e-5 to 0.5.
    """
    step = step / max(1.0, float(np.abs(step).max()))
    m = chart.centre.n_modes
    low, high = _limits(data, chart.centre)
    step[: 2 * m] = np.clip(x[: 2 * m] + step[: 2 * m], low, high) - x[: 2 * m]
    return np.asarray(step)


def _limits(data: BandLines, start: BandModes) -> tuple[FloatArray, FloatArray]:
    """Least and greatest coordinates of frequencies, then damping ratios, in the search, (2 m,) each.

    Coordinates are ln(f / f_0) / zeta_0 and ln(zeta / zeta_0) about the modes `start` (f_0, zeta_0). Frequencies stay
    within the lines of `data`, damping ratios from 1e-5 to 0.5; the coordinate 0 of `start` is always allowed.
    """
    zeta = start.damping_ratio
    ends = [np.log(f / start.frequency) / zeta for f in (data.frequency.min(), data.frequency.max())]
    ratios = [np.log(limit / zeta) for limit in _DAMPING_LIMITS]
    low, high = (np.concatenate(pair) for pair in zip(ends, ratios, strict=True))
    return np.minimum(low, 0.0), np.maximum(high, 0.0)


def _refine_posterior(data: BandLines, modes: BandModes) -> Posterior:
    """Posterior of the modes: Newton's method from the near start `modes`, and covariance from the inverse Hessian.

    Covariances are NaN if the Hessian is not positive definite or the steps did not suffice.
    """
    place, decrement, curvature = _newton(data, modes, _STEPS)
    modes = place.centre
    n, m = modes.shapes.shape
    inverse = _inverse(curvature)
    if inverse is None:
        return Posterior(modes, np.full((2 * m,) * 2, np.nan), np.full((m, n, n), np.nan), decrement < _DECREMENT)
    size = np.concatenate([modes.frequency * modes.damping_ratio, modes.damping_ratio])
    shapes = np.empty((m, n, n))
    for r, tangent in enumerate(place.tangents):
        own = slice(2 * m + r * (n - 1), 2 * m + (r + 1) * (n - 1))
        shapes[r] = tangent @ inverse[own, own] @ tangent.T
    covariance = size[:, None] * inverse[: 2 * m, : 2 * m] * size
    return Posterior(modes, covariance, shapes, decrement < _DECREMENT)


def hessian(data: BandLines, chart: Chart, x: FloatArray) -> FloatArray:
    """Hessian (size, size), symmetric, of the negative log-likelihood of the lines `data`, by central differences.

    Differences are of its gradient. It is taken at the coordinates `x` (size,) that `chart` maps to frequencies,
    damping ratios, shapes, forces and noise.
    """
    rows = []
    for e in np.eye(len(x)) * _STEP:
        rows.append((gradient(data, chart, x + e)[1] - gradient(data, chart, x - e)[1]) / (2 * _STEP))
    return np.asarray((np.array(rows) + np.array(rows).T) / 2)


def _inverse(curvature: FloatArray) -> FloatArray | None:
    """Inverse of the symmetric matrix `curvature`; None if it is not finite or not clearly positive definite.

    The least eigenvalue must exceed 1e-11 of the greatest one.
    """
    if not np.isfinite(curvature).all():
        return None
    values, vectors = np.linalg.eigh(curvature)
    if values[0] <= 1e-7 * values[-1] * _STEP:
        return None
    return np.asarray((vectors / values) @ vectors.T)


def starts(data: BandLines, frequencies: Sequence[float]) -> list[BandModes]:
    """Starting points for the search for modes near `frequencies` (Hz): one for each choice of shapes.

    Shapes come from the lines near each frequency, and from principal directions of all lines in several orders; the
    damping ratio of each start is the likeliest of 0.003, 0.01 and 0.03.
    """
    m, n = len(frequencies), data.n_channels
    whole = np.linalg.eigh((data.lines.T @ data.lines.conj()).real)[1][:, ::-1]
    basis = whole[:, : min(m, n)]
    basis = basis[:, np.arange(m) % basis.shape[1]]
    turned = basis + np.roll(basis, 1, axis=1) * np.array([1.0 if r % 2 else -1.0 for r in range(m)])
    turned = turned / np.maximum(np.linalg.norm(turned, axis=0), 1e-12)
    choices = [_local_shapes(data, frequencies)]
    for shapes in (basis, turned) if min(m, n) > 1 else (basis,):
        orders = list(permutations(range(m))) if m <= 3 else [tuple(range(m))]
        choices += [shapes[:, list(order)] for order in orders]
    found = []
    for shapes in choices:
        rough = [_rough(data, frequencies, [zeta] * m, shapes) for zeta in _DAMPING]
        found.append(min(rough, key=lambda modes: negative_log_likelihood(data, modes)))
    return found


def _local_shapes(data: BandLines, frequencies: Sequence[float]) -> FloatArray:
    """Shapes (n_channels, n_modes), principal directions of the lines nearest each of `frequencies` (Hz).

    They are kept distinct if possible: the strongest direction is taken whose MAC with all earlier shapes is below 0.9,
    or the strongest of all if there is none. A quarter of the lines count, divided by the number of modes, and five at
    least.
    """
    shapes: list[FloatArray] = []
    width = max(5, len(data.frequency) // (4 * len(frequencies)))
    for f in frequencies:
        near = data.lines[np.argsort(np.abs(data.frequency - f))[:width]]
        vectors = np.linalg.eigh((near.T @ near.conj()).real)[1][:, ::-1]
        free = [v for v in vectors.T if all((v @ s) ** 2 < 0.9 for s in shapes)]
        shapes.append(free[0] if free else vectors[:, 0])
    return np.stack(shapes, axis=1)


def _rough(data: BandLines, frequencies: Sequence[float], zetas: Sequence[float], shapes: FloatArray) -> BandModes:
    """Modes at `frequencies` (Hz) with damping ratios `zetas` and `shapes`, and rough force and noise densities.

    `frequencies` increase; those that coincide are moved up by a fifth of zeta f. `shapes` is (n_channels, n_modes).
    The force densities (m, m) are diagonal.
    """
    m, n = len(frequencies), data.n_channels
    frequency = np.array(frequencies, dtype=float)
    for r in range(1, m):  # modes that begin alike stay alike
        frequency[r] = max(frequency[r], frequency[r - 1] * (1 + 0.2 * zetas[r]))
    values = np.linalg.eigvalsh((data.lines.T @ data.lines.conj()).real / len(data.lines))
    power = np.sort(np.sum(np.abs(data.lines) ** 2, axis=1))
    noise = float(np.mean(values[: n - m])) if n > m else float(power[len(power) // 10]) / (10 * n)
    noise = max(noise, 1e-12 * float(values[-1]))
    modes = BandModes(frequency, np.array(zetas, dtype=float), shapes, np.eye(m, dtype=complex), noise)
    h = transfer(data, modes)[0]
    seen = np.mean(np.abs(data.lines @ shapes) ** 2, axis=0)
    return replace(modes, force=np.diag(np.maximum(seen, noise) / np.mean(np.abs(h) ** 2, axis=0) / m).astype(complex))
