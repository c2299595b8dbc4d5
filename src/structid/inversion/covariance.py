"""Covariance of an estimate: from the noise alone, and from residuals that the model leaves correlated."""

from __future__ import annotations

import numpy as np
from scipy import special

from structid.core.arrays import FloatArray, IntArray
from structid.inversion.linearization import Linearization, triangle_of
from structid.inversion.problem import Problem, expected_square, few_averages, square_variance

_FEWEST_BLOCKS = 10
_FEWEST_CHANNELS = 4
_ROUNDED = 1e-12

#: Least degrees of freedom of Student's t: with one the intervals of simulated truths held them all.
LEAST_FREEDOM = 2.0


def inverse_information(jacobian: FloatArray) -> FloatArray:
    """Inverse (J'J)^-1 by singular values, (n_params, n_params); NaN for parameters in a null direction.

    A direction is null where its singular value, with unit columns, is below 1e-10 of the largest. `jacobian` is
    (n_rows, n_params).
    """
    scale = np.linalg.norm(jacobian, axis=0)
    n_params = len(scale)
    if not np.isfinite(jacobian).all():
        return np.full((n_params, n_params), np.nan)
    safe = np.where(scale > 0, scale, 1.0)
    _, singular, rows = np.linalg.svd(triangle_of(jacobian / safe))
    singular = np.concatenate([singular, np.zeros(n_params - len(singular))])
    sound = singular > 1e-10 * singular.max(initial=0.0)
    covariance = (rows[sound].T / singular[sound] ** 2) @ rows[sound] / np.outer(safe, safe)
    lost = (np.abs(rows[~sound]) > 1e-6).any(axis=0) | (scale == 0)
    covariance[lost, :] = covariance[:, lost] = np.nan
    return covariance


def shift_of_minimum(jacobian: FloatArray, changes: FloatArray) -> FloatArray:
    """First-order shift -(J'J)^-1 J'c of a minimum by a change c of the residual; NaN for parameters not determined.

    `jacobian` (n_rows, n_params) is that of the residual there. `changes` holds the first rows of c, (n,) or (n, n_changes),
    and all others are 0. The result is (n_params,) or (n_params, n_changes).
    """
    inverse = inverse_information(jacobian)
    determined = np.isfinite(np.diag(inverse))
    shift = np.full((len(inverse), *changes.shape[1:]), np.nan)
    shift[determined] = -inverse[np.ix_(determined, determined)] @ (jacobian[: len(changes), determined].T @ changes)
    return shift


def noise_covariance(problem: Problem, theta: FloatArray, linearization: Linearization) -> FloatArray:
    """Covariance of the free variables from noise alone, (n_params, n_params); NaN for parameters not determined.

    It is A^-1 (J' Sigma J + P'P) A^-1 with A = J'J + P'P, where J are the data rows and P the prior rows of the
    Jacobian, and Sigma the covariance of the whitened errors by `problem.noise_law`. For independent unit errors it is
    A^-1; for variances estimated from n averages Sigma is n / (n - 3). `theta` (n_params,) are the free variables at
    which `linearization` was made.
    """
    bread, rows = inverse_information(linearization.jacobian), problem.n_data
    seen = np.isfinite(np.diag(bread))
    scores = problem.noise_law(theta).score_covariance(linearization.jacobian[:rows])
    if scores is None or not seen.any():
        return bread
    inner, prior = np.ix_(seen, seen), linearization.jacobian[rows:, seen]
    meat = scores[inner] + prior.T @ prior
    covariance = np.full_like(bread, np.nan)
    covariance[inner] = bread[inner] @ meat @ bread[inner]
    return covariance


def chi_square_law(problem: Problem, theta: FloatArray, linearization: Linearization) -> tuple[float, float]:
    """Scale and degrees of freedom of the scaled chi-square distribution of the sum of squares under noise alone.

    The degrees of freedom are those of `linearization`: rows less parameters, at least 0. For rows of independent
    errors the scale is 1; where few averages determine their variances, it is changed so that mean and variance of the
    sum are right (see `row_law`). For rows with correlated errors, where `problem.noise_law` has a factor, the residual
    has the covariance P Sigma P, with P the projection onto the complement of the Jacobian; scale and degrees of
    freedom match the mean and variance of the sum of squares (Satterthwaite 1946, Biometrics Bull. 2, 110-114). `theta`
    (n_params,) are the free variables at which `linearization` was made.
    """
    freedom = float(max(len(linearization.residual) - linearization.n_params - linearization.n_eliminated, 0))
    changes = problem.noise_law(theta).factor
    if changes is None or freedom == 0:
        scale, share = row_law(problem.rows.averages)
        return scale, share * freedom
    basis = np.linalg.qr(linearization.jacobian[: problem.n_data])[0]
    left = changes - (changes @ basis) @ basis.T
    gram = left @ left.T if len(left) <= left.shape[1] else left.T @ left
    mean, square = float(np.trace(gram)), float(np.sum(gram**2))
    return square / mean, mean**2 / square


def row_law(averages: FloatArray | None) -> tuple[float, float]:
    """Scale, and degrees of freedom per row, of the chi-square distribution of data rows with few averages.

    They match the mean m and the variance v of the expected square of a row: v / (2 m) and 2 m^2 / v. Their product m
    is the expected chi-square per degree of freedom of a correct model. Both are 1 where variances are known.

    Parameters
    ----------
    averages : (n_data,) float array or None
        Number of averages that the variance of each row was estimated from, infinite where it is known. None, an array
        of infinities alone, or one with an entry of 3 or less counts as known variances.
    """
    few = few_averages(averages)
    if few is None:
        return 1.0, 1.0
    mean, variance = float(expected_square(few).mean()), float(square_variance(few).mean())
    return variance / (2 * mean), 2 * mean**2 / variance


def fit_covariance(problem: Problem, theta: FloatArray) -> FloatArray:
    """Covariance (J'J)^-1 of the free variables from the curvature of the sum of squares at `theta`, prior rows included.

    Shape (n_params, n_params), NaN for undetermined parameters; the distribution of the errors is not used.
    """
    return inverse_information(problem.linearize(theta).jacobian)


def correlation_length(residual: FloatArray, lines: IntArray, series: IntArray) -> float:
    """Correlation length of a residual in lines: 1 + 2 times the sum of its autocorrelations from lag 1.

    The sum ends before the first autocorrelation below 0.05; the autocovariances are summed over all channels. `lines`
    and `series` (n_data,) are the line number and the channel number of each row. 1 for a residual of zeros. `residual`
    is (n_data,).
    """
    n_lines = int(lines.max(initial=0)) + 1
    numerator = np.zeros(n_lines)
    for channel in np.unique(series):
        rows = series == channel
        values = np.zeros(n_lines)
        np.add.at(values, lines[rows], residual[rows])
        spectrum = np.abs(np.fft.rfft(values, 2 * n_lines)) ** 2
        numerator += np.fft.irfft(spectrum)[:n_lines]
    if numerator[0] <= 0:
        return 1.0
    correlation = numerator / numerator[0]
    below = np.flatnonzero(correlation < 0.05)
    last = int(below[0]) if below.size else n_lines
    return float(1 + 2 * correlation[1:last].sum())


def model_error_covariance(problem: Problem, linearization: Linearization) -> FloatArray:
    """Cluster-robust covariance of the free variables, (n_params, n_params), by stretches of lines and channels.

    With A = J'J and g_b = J_b' r_b summed over a block b of rows, it is A^-1 (sum of g_b g_b') A^-1, with blocks along
    the frequency or time axis (four correlation lengths long, at least ten of them). Where there are four channels or
    more, a variance is raised to that with channels as blocks if that is larger, and always to that of independent
    errors as large as the residual. Priors add their own information unchanged. Few blocks make a rough variance:
    standard deviations are scaled so that 1.96 of them are the 95 % interval of Student's t with one degree of freedom
    less than there are effective blocks (at least two), fewer than blocks where a parameter is seen at few resonances.
    It needs no noise level, but no error that is the same in all blocks can show in it. NaN for parameters not
    determined. `linearization` is that of `problem` at the minimum; J and r are its data rows.

    Where several records repeat the same quantities, such as each mode, it is raised in every direction to the
    jackknife covariance `left_out_covariance` with the quantities as blocks: errors of a quantity go together in all
    records.

    References
    ----------
    Liang and Zeger (1986), Biometrika 73, Eq. (5); Carter, Schnepel and Steigerwald (2017), Rev. Econ. Stat. 99,
    Eq. (8), for the effective number of blocks, here for errors of one size.
    """
    rows = problem.n_data
    residual, jacobian = linearization.residual[:rows], linearization.jacobian[:rows]
    prior = linearization.jacobian[rows:]
    bread = inverse_information(linearization.jacobian)
    seen = np.isfinite(np.diag(bread))
    inner = np.ix_(seen, seen)
    covariance = np.full_like(bread, np.nan)
    if not seen.any():
        return covariance
    root, known = bread[inner], prior[:, seen].T @ prior[:, seen]
    sums = [
        _block_scores(jacobian[:, seen], residual, b)
        for b in error_blocks(residual, problem.rows.lines, problem.rows.series)
    ]
    along = root @ (sums[0] + known) @ root
    freedom = effective_blocks(problem, linearization)[seen] - 1
    scale = special.stdtrit(np.maximum(freedom, LEAST_FREEDOM), 0.975) / special.ndtri(0.975)
    least = max(1.0, float(residual @ residual) / max(rows - int(seen.sum()), 1)) * np.diag(root)
    if len(sums) > 1:
        channels = np.diag(root @ (sums[1] + known) @ root)
        least = np.maximum(least, channels)
    size = np.diag(along)
    along[np.diag_indices_from(along)] = size = np.where(size > 0, size, least)  # rounding, where nothing is left over
    scale = np.maximum(scale, np.sqrt(least / size))
    covariance[inner] = along * np.outer(scale, scale)
    quantities = repeated_quantities(problem)
    return (
        covariance
        if quantities is None
        else larger_covariance(covariance, left_out_covariance(linearization, quantities))
    )


def repeated_quantities(problem: Problem) -> IntArray | None:
    """Number of the measured quantity of each data row, (n_data,), from 0, and -1 for rows of none; None if not usable.

    None if the problem numbers no quantities, if there are fewer than four, or if any is measured at one line only, which
    is a block already.
    """
    numbers = problem.rows.quantities
    if numbers is None:
        return None
    distinct, block = np.unique(numbers, return_inverse=True)
    block = block - int(np.count_nonzero(distinct < 0))
    pairs = np.unique(np.stack([block, problem.rows.lines])[:, block >= 0], axis=1)
    if len(distinct[distinct >= 0]) < _FEWEST_CHANNELS or (np.bincount(pairs[0]) < 2).any():
        return None
    return np.maximum(block, -1)


def left_out_covariance(linearization: Linearization, block: IntArray) -> FloatArray:
    """Jackknife covariance of the parameters, (n_params, n_params), leaving out one block of rows at a time.

    To first order the parameters move by d_b = (A - A_b)^-1 J_b' r_b without block b, with r the residual, J the Jacobian with
    its prior rows and A = J'J; r_b, J_b and A_b are of the block. The sum of d_b d_b' is multiplied by (n - 1) / n
    for n blocks. With few influential blocks it is rather too large than too small, and has no correction by Student's t. NaN
    for a parameter that one block alone determines.

    Parameters
    ----------
    linearization : Linearization
    block : (n_data,) int array
        Block of each data row from 0; rows of -1, and priors, stay.

    References
    ----------
    Efron and Stein (1981), Ann. Stat. 9, Eq. (1.6), for its sign; MacKinnon, Nielsen and Webb (2023), J. Econometrics 232,
    Eq. (16).
    """
    n_blocks, n_data = int(block.max()) + 1, len(block)
    moved = []
    for number in range(n_blocks):
        out = np.zeros(len(linearization.residual), dtype=bool)
        out[:n_data] = block == number
        score = linearization.jacobian[out].T @ linearization.residual[out]
        rest = inverse_information(linearization.jacobian[~out])
        lost = np.isnan(np.diag(rest))
        moved.append(np.where(lost, np.nan, np.nan_to_num(rest) @ score))
    steps = np.array(moved)
    return steps.T @ steps * ((n_blocks - 1) / n_blocks)


def larger_covariance(first: FloatArray, second: FloatArray) -> FloatArray:
    """Covariance `first` (n, n), raised so that no linear combination has a variance below that by `second` (n, n).

    With first = L L' and L^-1 second L^-T = V diag(w) V' it is L V diag(max(w, 1)) V' L'. Rows and columns of parameters with a
    NaN variance in either matrix are those of `first`.
    """
    both = np.isfinite(np.diag(first)) & np.isfinite(np.diag(second))
    inner = np.ix_(both, both)
    largest = first.copy()
    scale = np.sqrt(np.diag(first)[both])
    values, vectors = np.linalg.eigh(first[inner] / np.outer(scale, scale))
    values = np.maximum(values, _ROUNDED * values.max(initial=0.0))
    root = (vectors * np.sqrt(values)) * scale[:, None]
    back = (vectors / np.sqrt(values)).T / scale
    ratios, turned = np.linalg.eigh(back @ second[inner] @ back.T)
    more = root @ turned * np.sqrt(np.maximum(ratios - 1, 0.0))
    largest[inner] += more @ more.T
    return largest


def error_blocks(residual: FloatArray, lines: IntArray, series: IntArray) -> tuple[IntArray, ...]:
    """Block number of each data row, (n_data,), in one or two groupings: by stretches of lines, and by channels.

    Stretches are about four correlation lengths of `residual` (n_data,) long, shorter where there would be fewer than
    ten of them, but at least one line. The grouping by channels (real and imaginary part together) is left out if there
    are fewer than four. `lines` and `series` (n_data,) number the lines from 0 and the series: 2 k and 2 k + 1 are of
    channel k. Blocks count from 0.
    """
    n_lines = int(lines.max(initial=0)) + 1
    length = 4 * correlation_length(residual, lines, series)
    n_blocks = int(np.clip(n_lines / length, min(_FEWEST_BLOCKS, n_lines), n_lines))
    _, stretches = np.unique(lines * n_blocks // n_lines, return_inverse=True)
    distinct, channels = np.unique(series // 2, return_inverse=True)
    return (stretches, channels) if len(distinct) >= _FEWEST_CHANNELS else (stretches,)


def effective_blocks(problem: Problem, linearization: Linearization) -> FloatArray:
    """Effective number of blocks of lines that determine each parameter, (n_params,); NaN for undetermined parameters.

    It is (sum a)^2 / sum a^2 with a_b = (A^-1 J_b' J_b A^-1)_jj the share of block b in the variance of parameter j and
    A = J'J with prior rows. The blocks are the first grouping of `error_blocks`. `linearization` is that of `problem`
    at the minimum.
    """
    rows = problem.n_data
    block = error_blocks(linearization.residual[:rows], problem.rows.lines, problem.rows.series)[0]
    influence = linearization.jacobian[:rows] @ np.nan_to_num(inverse_information(linearization.jacobian))
    shares = np.zeros((int(block.max(initial=0)) + 1, influence.shape[1]))
    np.add.at(shares, block, influence**2)
    total, squares = shares.sum(axis=0), (shares**2).sum(axis=0)
    return np.divide(total**2, squares, out=np.full(len(total), np.nan), where=squares > 0)


def _block_scores(jacobian: FloatArray, residual: FloatArray, block: IntArray) -> FloatArray:
    """Sum over blocks b of g_b g_b' with g_b = J_b' r_b, times B / (B - 1) for B blocks: (n_params, n_params).

    `jacobian` is J, `residual` is r, and `block` (n_data,) numbers the blocks from 0. NaN if there is only one block.
    """
    n_blocks = int(block.max(initial=0)) + 1
    scores = np.zeros((n_blocks, jacobian.shape[1]))
    np.add.at(scores, block, jacobian * residual[:, None])
    if n_blocks < 2:
        return np.full((jacobian.shape[1],) * 2, np.nan)
    return scores.T @ scores * (n_blocks / (n_blocks - 1))
