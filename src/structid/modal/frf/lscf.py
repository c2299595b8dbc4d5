"""Poly-reference least-squares complex frequency method: poles and participation from FRFs, for all orders at once.

With z = exp(i theta), theta from 0 to pi over the band, each row of the FRFs obeys H_o A(z) = B_o(z) with real
matrix polynomials; A(z) = I + A_1 z + ... + A_n z^n. Least squares over lines and outputs, the B_o eliminated, gives
normal equations with Toeplitz blocks; those of lower orders are their leading parts. Zeros of det A are the poles,
left null vectors of A the participation of the inputs. With the lowest coefficient held at I, poles that only fit
noise come out unstable, and fall to the criteria on damping.

The polynomials are in z, the FRFs of a structure rational in i omega: poles of the sweep are close, not exact, and
noise makes their damping too large. The modes picked from the sweep are therefore refined (`refinement`).

References
----------
Guillaume, Verboven, Vanlanduit, Van der Auweraer and Peeters (2003), A poly-reference implementation of the
least-squares complex frequency-domain estimator, IMAC 21; Peeters, Van der Auweraer, Guillaume and Leuridan (2004), The
PolyMAX frequency-domain method, Shock Vib. 11, 395-409, Eqs. (4) to (17); Cauberghe, Guillaume, Verboven,
Vanlanduit and Parloo (2005), On the influence of the parameter constraint on the stability of the poles and the
discrimination capabilities of the stabilisation diagrams, Mech. Syst. Signal Process. 19, 989-1014.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from structid.core.arrays import ComplexArray, FloatArray
from structid.core.errors import InputError
from structid.modal.frf.refinement import residue_shapes
from structid.modal.poles.poles import HardCriteria, Poles
from structid.records.record import DERIVATIVES, FrfRecord

_MAX_POLYNOMIAL = 60
_MAX_ORDER = 120
_LINES_A_COEFFICIENT = 4
_VALUES_AN_UNKNOWN = 4  # real ones of the FRFs, for each coefficient of the polynomials


@dataclass(frozen=True, eq=False)
class FrfBand:
    """Lines of one band, each FRF divided by a size of its output and one of its input.

    Attributes
    ----------
    laplace : (n_lines,) complex array
        s = decay + i omega, 1/s.
    values : (n_lines, n_outputs, n_inputs) complex array
        FRFs over `output_scale` and `input_scale`.
    variance : the same shape, or None
        E|error|^2 of `values`.
    output_scale, input_scale : (n_outputs,), (n_inputs,) float arrays
        The product of both for an output and an input has the unit of the FRF.
    power : int
        0, 1 or 2 for receptance, mobility or accelerance.
    """

    laplace: ComplexArray
    values: ComplexArray
    variance: FloatArray | None
    output_scale: FloatArray
    input_scale: FloatArray
    power: int

    @property
    def edges(self) -> tuple[float, float]:
        """Frequencies of the first and the last line, Hz."""
        return float(self.laplace[0].imag / (2 * np.pi)), float(self.laplace[-1].imag / (2 * np.pi))


def frf_band(record: FrfRecord, low: float, high: float) -> FrfBand:
    """Lines of `record` from `low` to `high` Hz, but not at 0 Hz, each FRF over the scales of output and input.

    The scale of an output is its root mean square over lines and inputs, that of an input over lines and scaled
    outputs; both are in the result, with the Laplace variable (1/s) of the lines and the variance of the scaled FRFs.
    The variance is not below rounding of the FRF; it is None if the record has none or zeros only in the band.

    Raises
    ------
    InputError
        If fewer than 16 lines are left, or an output or input is zero throughout.
    """
    keep = (record.frequency >= low) & (record.frequency <= high) & (record.laplace != 0)
    if keep.sum() < 16:
        raise InputError(
            f"the band from {low:g} to {high:g} Hz must hold at least 16 lines, got {int(keep.sum())}; widen `bands` or "
            "the frequency range of `criteria`, or measure longer for closer lines"
        )
    size = np.sqrt(np.mean(np.abs(record.values[keep]) ** 2, axis=0))
    for axis, kind, dofs in ((1, "output", record.outputs), (0, "input", record.inputs)):
        dead = np.flatnonzero(size.max(axis=axis) == 0)
        if len(dead):
            raise InputError(
                f"{kind} {dofs[dead[0]]} is 0 on all lines from {low:g} to {high:g} Hz; leave this channel out, or repair it"
            )
    outputs = np.sqrt(np.mean(size**2, axis=1))
    inputs = np.sqrt(np.mean((size / outputs[:, None]) ** 2, axis=0))
    scale = outputs[:, None] * inputs
    variance = None
    if record.variance is not None and record.variance[keep].any():
        rounding = (np.finfo(float).eps * np.abs(record.values[keep]).max(axis=0)) ** 2
        variance = np.maximum(record.variance[keep], np.where(rounding > 0, rounding, rounding.max())) / scale**2
    power = DERIVATIVES[record.kind]
    return FrfBand(record.laplace[keep], record.values[keep] / scale, variance, outputs, inputs, power)


@dataclass(frozen=True, eq=False)
class PoleSweep:
    """Poles of each model order in `sweep`, and the participation of the inputs in them, (n_inputs, n_poles) for each order."""

    sweep: tuple[Poles, ...]
    participation: tuple[ComplexArray, ...]


def pole_sweep(band: FrfBand, orders: Sequence[int] | None, criteria: HardCriteria) -> PoleSweep:
    """Poles of each order inside the band that meet the damping limits, with participation and displacement shapes.

    Parameters
    ----------
    band : FrfBand
    orders : sequence of int, optional
        Numbers of states; polynomials have 1 / n_inputs of it as their order, rounded up. By default polynomials of
        order 2 and more, up to 60 or as lines, inputs and outputs allow.
    criteria : HardCriteria
        Its range of damping ratios is used only.

    Returns
    -------
    PoleSweep
        Orders increase, the poles of each by |s|; shapes are multiplied by the scales of the outputs.
    """
    n_inputs = band.values.shape[2]
    degrees = polynomial_orders(band.values.shape, orders)
    omega, decay = band.laplace.imag, float(np.mean(band.laplace.real))
    span = omega[-1] - omega[0]
    start = 0.0 if omega[0] < 0.2 * span else omega[0]
    step = np.pi / (omega[-1] - start)
    sweep, participation = [], []
    common = np.ones((len(omega), n_inputs))
    if band.variance is not None:
        common = 1 / np.sqrt(np.mean(band.variance, axis=1))
    for degree, denominator in zip(degrees, denominators(band, (omega - start) * step, degrees), strict=True):
        values, vectors = right_poles(denominator)
        s = np.log(values) / step + 1j * start + decay
        inside = (s.imag > omega[0]) & (s.imag < omega[-1])
        ratio = -s.real / np.abs(s)
        inside &= (ratio >= criteria.damping_ratio[0]) & (ratio <= criteria.damping_ratio[1])
        s, vectors = s[inside], vectors[:, inside]
        ordered = np.argsort(np.abs(s), kind="stable")
        s, vectors = s[ordered], vectors[:, ordered]
        shapes = residue_shapes(band.laplace, band.values, common, s, vectors, band.power)
        energy = _energy_fractions(s, shapes, vectors, band.power)
        sweep.append(Poles(s, band.output_scale[:, None] * shapes, degree * n_inputs, energy))
        participation.append(vectors)
    return PoleSweep(tuple(sweep), tuple(participation))


def _energy_fractions(s: ComplexArray, shapes: ComplexArray, participation: ComplexArray, power: int) -> FloatArray:
    """Root of the energy of each resonance over all frequencies, relative to that of all poles, (n_poles,).

    `s` (n_poles,) are poles in rad/s, `shapes` (n_outputs, n_poles), `participation` (n_inputs, n_poles); `power` is 0, 1 or
    2 for receptance, mobility or accelerance. Squares add up to 1.
    """
    peak = np.linalg.norm(shapes, axis=0) * np.linalg.norm(participation, axis=0) * np.abs(s) ** power
    size = peak / np.sqrt(np.maximum(np.abs(s.real), 1e-6 * np.abs(s)))
    return np.asarray(size / max(float(np.linalg.norm(size)), np.finfo(np.float64).tiny))


def polynomial_orders(shape: tuple[int, ...], wanted: Sequence[int] | None) -> list[int]:
    """Orders n of the polynomials to try, increasing: `wanted` / n_inputs rounded up, or 2 to at most 60 by default.

    The default ends at 120 / n_inputs (4 at least) if that is less, and takes every order, or every second one if the
    greatest is above 20. FRFs of L lines, p outputs and m inputs hold 2 L p m real values, for n m^2 coefficients of A,
    which all outputs share, and n m for each output. Four values a coefficient leave room for n up to L / 4 with one
    FRF, and to nearly L / 2 with many outputs. Above order 60 the limit is L / 4, since every order above adds poles
    that fit noise, each of them to be refined.

    Parameters
    ----------
    shape : (n_lines, n_outputs, n_inputs)
        Of the FRFs.
    wanted : sequence of int, optional
        Numbers of states, n_inputs times n.

    Raises
    ------
    InputError
        If there are too few lines for an order.
    """
    n_lines, n_outputs, n_inputs = shape
    share = max(n_outputs / (n_outputs + n_inputs), 0.5)
    room = max(n_lines // _LINES_A_COEFFICIENT, min(int(2 * n_lines * share / _VALUES_AN_UNKNOWN), _MAX_POLYNOMIAL))
    if wanted is None:
        top = min(_MAX_POLYNOMIAL, max(_MAX_ORDER // n_inputs, 4), room)
        return list(range(2, top + 1, 2 if top > 20 else 1))
    orders = sorted({-(-int(n) // n_inputs) for n in wanted})
    if not orders or orders[0] < 1 or orders[-1] > room:
        raise InputError(
            f"`orders` must lie from 1 to {room * n_inputs} for {n_lines} lines, {n_outputs} outputs and {n_inputs} inputs,"
            " got "
            f"{list(wanted)}; widen the band, or lower the orders"
        )
    return orders


def denominators(band: FrfBand, angle: FloatArray, degrees: Sequence[int]) -> Iterator[FloatArray]:
    """Coefficients A_1 .. A_n, (n, n_inputs, n_inputs), of every order n in `degrees`, from one set of normal equations.

    They are those of the denominators A(z) = I + A_1 z + ... + A_n z^n of right matrix fractions B(z) A(z)^-1 of the
    FRFs, in the order of `degrees`. Equations of an output are weighted by 1 over its variance, averaged over the
    inputs, where the record has a variance.

    Parameters
    ----------
    band : FrfBand
    angle : (n_lines,) float array
        theta of z = exp(i theta).
    degrees : sequence of int
        Orders of the polynomials, increasing.
    """
    n, m = degrees[-1], band.values.shape[2]
    weight = np.ones(band.values.shape[:2]) if band.variance is None else 1 / band.variance.mean(axis=2)
    lag = np.arange(-n, n + 1)
    powers = np.exp(1j * angle[:, None] * lag)  # z^(s - r) of column s and row r
    diagonal = np.arange(n + 1)[None, :] - np.arange(n + 1)[:, None] + n
    h = band.values
    products = np.einsum("fo,foa,fob->fab", weight, h.conj(), h, optimize=True).reshape(len(h), -1)
    full = (powers.T @ products).real.reshape(-1, m, m)[diagonal].transpose(0, 2, 1, 3).reshape((n + 1) * m, -1)
    eliminated = []
    for o in range(h.shape[1]):
        gram = (powers.T @ weight[:, o]).real[diagonal]
        mixed = (powers.T @ (weight[:, o, None] * h[:, o])).real[diagonal].reshape(n + 1, -1)
        eliminated.append(linalg.solve_triangular(linalg.cholesky(gram, lower=True), mixed, lower=True))
    rows = np.array(eliminated)
    taken, done = np.zeros_like(full), 0
    for degree in degrees:
        new = rows[:, done : degree + 1].reshape(-1, rows.shape[2])
        taken, done = taken + new.T @ new, degree + 1
        size = (degree + 1) * m
        reduced = full[:size, :size] - taken[:size, :size]
        coefficients = np.linalg.lstsq(reduced[m:, m:], -reduced[m:, :m], rcond=None)[0]
        yield coefficients.reshape(degree, m, m)


def right_poles(denominator: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Poles z in the upper half plane with det A(z) = 0, and vectors w with A(z)^T w = 0, largest entry 1.

    Parameters
    ----------
    denominator : (n, n_inputs, n_inputs) float array
        A_1 .. A_n of A(z) = I + A_1 z + ... + A_n z^n.

    Returns
    -------
    (n_poles,) complex array
    (n_inputs, n_poles) complex array
    """
    n, m, _ = denominator.shape
    companion = np.eye(n * m, k=-m)
    companion[:m] = -denominator.transpose(2, 0, 1).reshape(m, n * m)  # y^n w = -sum of A_r' y^(n-r) w, y = 1 / z
    values, vectors = np.linalg.eig(companion)
    kept = values.imag < 0
    w = vectors[:m, kept]
    z = np.asarray(1 / values[kept], dtype=np.complex128)
    return z, w / w[np.abs(w).argmax(axis=0), np.arange(w.shape[1])]
