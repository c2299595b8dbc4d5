"""Poles and residues as a model of FRFs: its terms, its slopes, and residues by linear least squares (LSFD).

As receptance, with phi for the shape, l for the participation of the inputs and real matrices R_k for the modes
outside the band,

    H(s) = sum over modes of phi l' / (s - p) + conj(phi l') / (s - conj(p))  +  sum over k of R_k s^k,

times s for mobility and s^2 for accelerance. It is linear in phi and R_k, each output by itself. A mode below the band
is a series of powers -2, -3, ... of s, one above of 0, 1, 2, ...; a mode at f_r falls off by (f_r / f)^2, or (f / f_r)^2, from
each even power to the next, its damping stands in the odd ones. k = -2 and 0 alone are the common residual mass and
stiffness.

References
----------
Heylen, Lammens and Sas (1997), Modal analysis theory and testing, section A.3 (least-squares frequency domain method);
Verboven (2002), Frequency-domain system identification for modal analysis, Vrije Universiteit Brussel, chapter 4.
"""

from __future__ import annotations

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, stack_real

OUTSIDE = (-2, 0)  # powers of s that stand for the modes outside the band at least
_RANK = 1e-10  # of a column that is left after those before it, below which it says nothing new


def terms(
    laplace: ComplexArray,
    poles: ComplexArray,
    participation: ComplexArray,
    power: int,
    outside: tuple[int, ...] = OUTSIDE,
) -> ComplexArray:
    """Regressors of one output: factors of Re phi, Im phi and the terms of modes outside the band.

    Parameters
    ----------
    laplace : (n_lines,) complex array
        Laplace variable s of the lines, 1/s, nowhere 0.
    poles : (n_modes,) complex array
        In the upper half plane, rad/s.
    participation : (n_inputs, n_modes) complex array
        The residue of mode m at an input is phi times this.
    power : int
        0, 1 or 2 for receptance, mobility or accelerance.
    outside : tuple of int
        Powers of s, of receptance, that stand for the modes outside the band.

    Returns
    -------
    (n_lines, n_inputs, 2 n_modes + n_outside n_inputs) complex array
        The last axis are the unknowns, which are real: Re phi of all modes, Im phi of all modes, then for each power of s the
        coefficient of every input.
    """
    here, there = _fractions(laplace, poles, power)
    a, b = here[:, None, :] * participation, there[:, None, :] * participation.conj()
    each = np.eye(len(participation))
    static = [laplace[:, None, None] ** (power + k) * each for k in outside]
    return np.concatenate([a + b, 1j * (a - b), *static], axis=2)


def slopes(
    laplace: ComplexArray, poles: ComplexArray, participation: ComplexArray, shape: ComplexArray, power: int
) -> ComplexArray:
    """Derivatives of the FRFs of one output by Re p, Im p, and Re l, Im l of every input and mode.

    Parameters
    ----------
    laplace : (n_lines,) complex array
        Laplace variable of the lines, 1/s, nowhere 0.
    poles : (n_modes,) complex array
        p, in the upper half plane, rad/s.
    participation : (n_inputs, n_modes) complex array
        l.
    shape : (n_modes,) complex array
        Entry of this output in each shape.
    power : int
        0, 1 or 2 for receptance, mobility or accelerance.

    Returns
    -------
    (n_lines, n_inputs, 2 n_modes + 2 n_inputs n_modes) complex array
        Participation is counted input by input, all modes of each.
    """
    here, there = _fractions(laplace, poles, power)
    a = (here / (laplace[:, None] - poles) * shape)[:, None, :] * participation
    b = (there / (laplace[:, None] - poles.conj()) * shape.conj())[:, None, :] * participation.conj()
    n = len(participation)
    first, second = here * shape, there * shape.conj()
    each = np.eye(n)[None, :, :, None]
    real = (each * (first + second)[:, None, None, :]).reshape(len(laplace), n, -1)
    imag = (each * (1j * (first - second))[:, None, None, :]).reshape(len(laplace), n, -1)
    return np.concatenate([a + b, 1j * (a - b), real, imag], axis=2)


def _fractions(laplace: ComplexArray, poles: ComplexArray, power: int) -> tuple[ComplexArray, ComplexArray]:
    factor = laplace[:, None] ** power
    return factor / (laplace[:, None] - poles), factor / (laplace[:, None] - poles.conj())


def weighted(columns: ComplexArray, weights: FloatArray) -> FloatArray:
    """Real matrix of weighted columns, (2 n_lines n_inputs, n_columns): rows of real parts, then of imaginary parts.

    `columns` is (n_lines, n_inputs, n_columns), `weights` (n_lines, n_inputs).
    """
    n_lines, n_inputs, n_columns = columns.shape
    return stack_real(
        (columns * weights[:, :, None]).reshape(n_lines * n_inputs, n_columns)
    )  # where there is no column too


def residue_shapes(
    laplace: ComplexArray,
    values: ComplexArray,
    weights: FloatArray,
    poles: ComplexArray,
    participation: ComplexArray,
    power: int,
) -> ComplexArray:
    """Shapes phi of all outputs, (n_outputs, n_modes), by least squares with poles and participation held.

    Terms for modes outside the band are fitted along and dropped. Where the regressors are linearly dependent, the
    solution of least norm is taken.

    Parameters
    ----------
    laplace : (n_lines,) complex array
        Laplace variable of the lines, 1/s, nowhere 0.
    values : (n_lines, n_outputs, n_inputs) complex array
        FRFs.
    weights : (n_lines, n_inputs) float array
        The same for all outputs, which share one factorization.
    poles : (n_modes,) complex array
        In the upper half plane, rad/s.
    participation : (n_inputs, n_modes) complex array
    power : int
        0, 1 or 2 for receptance, mobility or accelerance.
    """
    matrix = weighted(terms(laplace, poles, participation, power), weights)
    right = weighted(values.transpose(0, 2, 1), weights)
    size = np.linalg.norm(matrix, axis=0)
    matrix = matrix / np.where(size > 0, size, 1.0)
    q, r = np.linalg.qr(matrix)
    regular = np.abs(np.diag(r)).min() > _RANK
    solution = np.linalg.solve(r, q.T @ right) if regular else np.linalg.lstsq(matrix, right, rcond=_RANK)[0]
    solution = solution / np.where(size > 0, size, 1.0)[:, None]
    n = len(poles)
    return np.asarray((solution[:n] + 1j * solution[n : 2 * n]).T)
