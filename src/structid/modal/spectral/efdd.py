"""Enhanced frequency domain decomposition: frequency and damping from the bell around each peak.

References
----------
Brincker, Ventura and Andersen (2001), Damping estimation by frequency domain decomposition, Proc. 19th IMAC, 698-703;
Zhang, Wang and Tamura (2010), A frequency-spatial domain decomposition (FSDD) method for operational modal analysis,
Mech. Syst. Signal Process. 24(5), 1227-1239.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from structid.arrays import ComplexArray, FloatArray, IntArray
from structid.dof import Dof
from structid.errors import NoModesError
from structid.modal.correlations import Outputs, displacement_rows, outputs
from structid.modal.method import ModalIdentification, ModalOptions
from structid.modal.modal_record import ModalRecord
from structid.modal.spectral.bell import Bell, bell_fit
from structid.modal.spectral.peaks import (
    Spectrum,
    automatic_peaks,
    centred,
    chosen_peaks,
    hann,
    peak_range,
    segments,
)
from structid.records import TimeRecord

#: Modal assurance criterion with the vector of the peak that the lines of a bell must reach.
BELL_MAC = 0.8
_FEW_LINES = 4.0  # half-power bandwidth in line spacings below which the window widens the bell by much
_LEAST_AVERAGES = 10
_LEAST_PIECES = 5
_OVERLAP = 2 / 36


@dataclass(frozen=True, eq=False)
class Peak:
    """A peak of the first singular value, and the range of its bell.

    Attributes
    ----------
    line : int
        Of the spectrum.
    vector : (n_channels,) complex array
        First singular vector there, of the scaled channels.
    low, high : float
        Ends of the bell, Hz.
    """

    line: int
    vector: ComplexArray
    low: float
    high: float


def efdd(records: TimeRecord | Sequence[TimeRecord], options: ModalOptions | None = None) -> ModalIdentification:
    """Modes of ambient motion from the bells of the singular spectra, with the window's leakage taken out.

    The spectral matrix is seen through the singular vector u of each peak, u^* G u, over the lines whose singular
    vectors have a MAC of at least 0.8 with u (`BELL_MAC`). Its inverse Fourier transform is the correlation function of
    one mode. A decaying cosine is fitted to it by least squares; by Parseval's theorem this is done on the lines
    themselves, where each has an error in proportion to its value.

    Parameters
    ----------
    records : TimeRecord or sequence of them
        Displacement, velocity or acceleration in any mixture.
    options : ModalOptions, optional
        Used are `frequencies` (by hand; automatic peaks otherwise), `criteria`, `segment` and `n_pieces`. By default
        peaks come from segments that leave about 40 averages, and segments are then doubled while a half-power
        bandwidth is less than four line spacings and ten averages remain.

    Returns
    -------
    ModalIdentification
        Complex shapes. `covariance` from the spread of the bells over pieces of the record, `shape_std` likewise.

    Raises
    ------
    InputError
        If no peak stands out, a frequency is near no peak, or no mode meets `criteria`.

    Notes
    -----
    A window of finite length multiplies the correlation function by the correlation of the window with itself, which
    falls as motion with more damping would: the known bias of this method. Segments are padded with zeros here, so that
    this factor is known exactly, and the cosine to be fitted carries it. What remains is variance: a warning says where
    a half-power bandwidth 2 zeta f is less than four line spacings.

    A bell holds one mode; close modes with shapes far from orthogonal spoil each other's bells (use the method
    ``bayesian_fft``).

    References
    ----------
    Brincker, Ventura and Andersen (2001), Proc. 19th IMAC, 698-703.
    """
    options = options or ModalOptions()
    data = centred(outputs(records))
    spectrum, lines = chosen_peaks(data, options)
    peaks = _peaks(spectrum, lines)
    segment, notes = spectrum.segment, []
    while True:
        bells = _bells(data, peaks, segment)
        fits = [bell_fit(bell) for bell in bells]
        width = [2 * fit.damping_ratio * fit.frequency * segment / data.sampling_rate for fit in fits]
        room = _averages(data, 2 * segment) >= _LEAST_AVERAGES
        if options.segment is not None or not room or min(width) >= _FEW_LINES:
            break
        segment *= 2
    frequency = np.array([fit.frequency for fit in fits])
    ratio = np.array([fit.damping_ratio for fit in fits])
    kept = np.flatnonzero(options.criteria.meets(frequency, ratio))
    if not len(kept):
        raise NoModesError("`records` show no peak whose mode meets `criteria`; widen them, or give `frequencies`")
    kept = kept[np.argsort(frequency[kept], kind="stable")]
    notes += _doubts(frequency, ratio, width, segment / data.sampling_rate, kept, [fit.converged for fit in fits])
    changes = np.concatenate([[fits[k].changes[:, 0] for k in kept], [fits[k].changes[:, 1] for k in kept]]).T
    covariance = piece_covariance(changes, len(kept), options.n_pieces, notes)
    s = 2 * np.pi * frequency[kept] * (1j * np.sqrt(1 - ratio[kept] ** 2) - ratio[kept])
    picked = [peaks[k] for k in kept]
    shapes, std, places = displacement_shapes(data, spectrum, picked, s, options.n_pieces)
    source = f"enhanced frequency domain decomposition, segments of {segment / data.sampling_rate:.4g} s"
    modes = ModalRecord(frequency[kept], ratio[kept], shapes, places, covariance, std, tuple(notes), source)
    return ModalIdentification(modes, "efdd", options=options)


def _peaks(spectrum: Spectrum, lines: IntArray) -> list[Peak]:
    """The peaks on `lines`, each with its bell."""
    known = sorted({*automatic_peaks(spectrum).tolist(), *lines.tolist()})
    peaks = []
    for line in lines.tolist():
        first, last = peak_range(spectrum, line, [k for k in known if k != line])
        low, high = _bell_lines(spectrum, line, first, last)
        peaks.append(Peak(line, spectrum.vectors[line, :, 0], spectrum.frequency[low], spectrum.frequency[high]))
    return peaks


def _bell_lines(spectrum: Spectrum, line: int, first: int, last: int) -> tuple[int, int]:
    """The lines about `line`, three on either side at the least, where some singular vector resembles that of the peak."""
    vector = spectrum.vectors[line, :, 0]
    likeness = np.max(np.abs(np.einsum("c,kcj->kj", vector.conj(), spectrum.vectors[first : last + 1])) ** 2, axis=1)
    strange = first + np.flatnonzero(likeness < BELL_MAC)
    low = max([first, *(strange[strange < line] + 1)])
    high = min([last, *(strange[strange > line] - 1)])
    return max(min(low, line - 3), 1), min(max(high, line + 3), len(spectrum.frequency) - 2)


def _averages(data: Outputs, segment: int) -> int:
    """Half-overlapping segments of that length; 0 where a record is shorter."""
    if min(len(y) for y in data.series) < segment:
        return 0
    return sum((len(y) - segment) // (segment // 2) + 1 for y in data.series)


def _bells(data: Outputs, peaks: Sequence[Peak], segment: int) -> list[Bell]:
    """Spectra of every segment seen through the vector of each peak, on lines of half the spacing."""
    vectors = np.stack([peak.vector for peak in peaks], axis=1).conj()
    window = hann(segment)
    frequency = np.arange(segment + 1) * data.sampling_rate / (2 * segment)
    lines = [np.flatnonzero((frequency >= peak.low) & (frequency <= peak.high)) for peak in peaks]
    found: list[list[FloatArray]] = [[] for _ in peaks]
    for stretch in segments(data, segment):
        seen = np.fft.fft(window[:, None] * (stretch @ vectors), 2 * segment, axis=0)
        for k, own in enumerate(lines):
            found[k].append(2 * np.abs(seen[own, k]) ** 2 / (data.sampling_rate * np.sum(window**2)))
    start = [int(own[np.mean(values, axis=0).argmax()]) for own, values in zip(lines, found, strict=True)]
    power = [float(np.abs(peak.vector) ** 2 @ data.derivative) for peak in peaks]
    return [
        Bell(frequency[own], np.array(values), segment, data.sampling_rate, float(frequency[at]), order)
        for own, values, at, order in zip(lines, found, start, power, strict=True)
    ]


def _doubts(
    frequency: FloatArray, ratio: FloatArray, width: Sequence[float], length: float, kept: IntArray,
    converged: Sequence[bool],
) -> list[str]:  # fmt: skip
    """Words on modes left out, or whose bell is narrow for the segment."""
    words = []
    for k in range(len(frequency)):
        if k not in kept:
            words.append(
                f"the peak at {frequency[k]:.4g} Hz, damping ratio {ratio[k]:.3g}, does not meet `criteria`: left out"
            )
        elif not converged[k]:
            words.append(f"the fit to the bell at {frequency[k]:.4g} Hz has not converged; look at the singular values")
        elif width[k] < _FEW_LINES:
            words.append(
                f"the half-power bandwidth of the mode at {frequency[k]:.4g} Hz is {width[k]:.2g} line spacings of "
                f"{1 / length:.3g} Hz, and the Hann window alone is 1.4 wide: the window is taken out, but the damping "
                f"ratio is uncertain. Take segments of {_FEW_LINES * length / width[k]:.2g} s, with a longer record"
            )
    return words


def piece_covariance(changes: FloatArray, n_modes: int, n_pieces: int, notes: list[str]) -> FloatArray | None:
    """Covariance from what each segment adds to the estimate, (n_segments, 2 n_modes), in pieces of segments in a row.

    Neighbouring pieces share samples, which adds 2 / 36 to the variance of a spectrum by segments of a Hann window that
    overlap by half (Welch 1967). Few pieces know their own spread badly: the covariance is that of Student's
    distribution, (n - 1) / (n - 3) times that of the pieces. Modes are taken as independent where pieces are too few
    to tell.
    """
    if n_pieces < 2:
        return None
    total = _spread(changes, n_pieces)
    if total is None:
        notes.append(
            f"{len(changes)} segments are too few for a covariance, which needs {_LEAST_PIECES}: none is given. Measure "
            "longer, or shorten `segment`"
        )
        return None
    count = min(n_pieces, len(changes))
    if count <= 2 * n_modes:
        mode = np.tile(np.arange(n_modes), 2)
        total = np.where(mode[:, None] == mode, total, 0.0)
        notes.append(
            f"{count} pieces cannot tell how {2 * n_modes} numbers vary together: the covariance between modes is left "
            "out. Measure longer, or shorten `segment`"
        )
    return total


def _spread(changes: FloatArray, n_pieces: int) -> FloatArray | None:
    count = min(n_pieces, len(changes))
    if count < _LEAST_PIECES:
        return None
    pieces = np.array([part.sum(axis=0) for part in np.array_split(changes, count)])
    pieces = pieces - pieces.mean(axis=0)
    return np.asarray(pieces.T @ pieces * (1 + _OVERLAP) * count / (count - 3))


def displacement_shapes(
    data: Outputs, spectrum: Spectrum, peaks: Sequence[Peak], s: ComplexArray, n_pieces: int
) -> tuple[ComplexArray, FloatArray | None, tuple[Dof, ...]]:
    """Shapes of the peaks as displacement, with largest entry 1, and the standard deviation of their real parts.

    A change dG of the spectral matrix turns u_1 by the sum over j > 1 of u_j (u_j^* dG u_1) / (s_1 - s_j).
    """
    window, rate, segment = hann(spectrum.segment), data.sampling_rate, spectrum.segment
    raw = np.stack([peak.vector for peak in peaks], axis=1)
    places, merge = displacement_rows(data, s)
    shapes = np.einsum("cdm,dm->cm", merge, data.scale[:, None] * raw)
    top = np.abs(shapes).argmax(axis=0), np.arange(len(peaks))
    unit = shapes / shapes[top]
    lines = [peak.line for peak in peaks]
    waves = window[:, None] * np.exp(-2j * np.pi * np.outer(np.arange(segment), lines) / segment)
    turns = []
    for stretch in segments(data, segment):
        seen = (stretch.T @ waves) * np.sqrt(2 / (rate * np.sum(window**2)))
        turn = np.zeros_like(raw)
        for m, line in enumerate(lines):
            values, vectors = spectrum.values[line], spectrum.vectors[line]
            amounts = (vectors[:, 1:].conj().T @ seen[:, m]) * (seen[:, m].conj() @ vectors[:, 0])
            turn[:, m] = vectors[:, 1:] @ (amounts / (values[0] - values[1:]))
        turns.append(turn)
    change = np.einsum("cdm,bdm->bcm", merge, data.scale[:, None] * np.array(turns) / len(turns))
    change = (change - unit * change[:, top[0], top[1]][:, None, :]) / shapes[top]
    spread = _spread(change.real.reshape(len(turns), -1), n_pieces) if n_pieces > 1 else None
    std = None if spread is None else np.sqrt(np.diag(spread)).reshape(unit.shape)
    return unit, std, places
