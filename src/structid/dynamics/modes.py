"""Natural frequencies, damping ratios and mode shapes of (mass, damping, stiffness)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.sparse.linalg import LinearOperator, eigsh

from structid.core.arrays import FloatArray
from structid.core.errors import SingularModelError
from structid.dynamics.factorization import factorizer

_DENSE_UP_TO = 600
#: Vectors, and times the shifted inverse is applied to them, that show where the lowest eigenvalues lie.
_BLOCK, _ITERATIONS = 8, 3
#: Part of the shift that the largest eigenvalue in sight must reach; part of the first shift that mechanisms are left.
_NEAR, _LEAST = 0.5, 1e-7
#: Times a block is looked through for modes passed over, and change of their eigenvalues, shifted, that counts as none.
_MOST_ROUNDS, _SAME = 50, 1e-8
#: Roundings of the largest eigenvalue that all eigenvalues of a dense problem are off by.
_DENSE_ROUNDINGS = 4
#: Mass of a combination of degrees of freedom, in parts of theirs, that is rounding.
_MASSLESS = 1e-11


@dataclass(frozen=True, eq=False)
class Modes:
    """Normal modes, with damping by first-order perturbation.

    Attributes
    ----------
    frequency : (n_modes,) float array
        Undamped natural frequency, Hz.
    damping_ratio : (n_modes,) float array
        Viscous damping ratio at resonance: (phi' C phi omega + phi' H phi) / (2 omega^2) for unit modal mass.
    mode_shapes : (n_dofs, n_modes) float array
        Mass-normalized, largest entry positive.
    rounding : (n_modes,) float array
        Relative error of each frequency that rounding can make: of the stiffness matrix, eps phi'|K|phi / (2 omega^2),
        and of a dense eigenvalue problem. A mode that does not rise above it, as a rigid body's, counts beside the
        lowest that does.
    """

    frequency: FloatArray
    damping_ratio: FloatArray
    mode_shapes: FloatArray
    rounding: FloatArray


def modes(
    mass: sparse.csc_array,
    stiffness: sparse.csc_array,
    damping: sparse.csc_array | None = None,
    structural: sparse.csc_array | None = None,
    n_modes: int | None = None,
) -> Modes:
    """The lowest modes of K phi = omega^2 M phi.

    Parameters
    ----------
    mass, stiffness : (n_dofs, n_dofs) sparse arrays
        Symmetric; degrees of freedom, or combinations of them, without mass follow the others statically.
    damping, structural : the same, optional
        Viscous damping, and imaginary part of the complex stiffness.
    n_modes : int, optional
        Number of modes; all by default (up to 20 for more than 600 degrees of freedom).

    Raises
    ------
    SingularModelError
        If an entry is not finite, or a motion has neither mass nor stiffness.
    """
    if not (np.isfinite(mass.data).all() and np.isfinite(stiffness.data).all()):
        raise SingularModelError("mass or stiffness of the model is not finite: a value has run away")
    n, error = mass.shape[0], 0.0
    if n <= _DENSE_UP_TO:
        eigenvalues, shapes = _dense_modes(mass.toarray(), stiffness.toarray())
        error = _DENSE_ROUNDINGS * np.finfo(np.float64).eps * float(eigenvalues[-1])
        eigenvalues, shapes = eigenvalues[:n_modes], shapes[:, :n_modes]
    else:
        count = min(n_modes or 20, n - 2)
        shift, inverse = _shift_below(stiffness, mass)
        start = np.random.default_rng(0).standard_normal(n)
        eigenvalues, shapes = eigsh(stiffness, count, mass, sigma=shift, which="LM", v0=start, OPinv=inverse)
        order = np.argsort(eigenvalues)
        eigenvalues, shapes = eigenvalues[order], shapes[:, order]
        if inverse is not None:
            eigenvalues, shapes = _add_missed_modes(stiffness, mass, shift, inverse, eigenvalues, shapes)
    omega = np.sqrt(np.maximum(eigenvalues, 0.0))
    shapes = shapes * np.sign(shapes[np.abs(shapes).argmax(axis=0), np.arange(shapes.shape[1])])
    loss = np.zeros(len(omega))
    if damping is not None:
        loss += omega * np.einsum("ij,ij->j", shapes, damping @ shapes)
    if structural is not None:
        loss += np.einsum("ij,ij->j", shapes, structural @ shapes)
    ratio = np.divide(loss, 2 * omega**2, out=np.zeros_like(loss), where=omega > 1e-6 * omega.max(initial=0.0))
    return Modes(omega / (2 * np.pi), ratio, shapes, _rounding_errors(stiffness, omega, shapes, error))


def _rounding_errors(stiffness: sparse.csc_array, omega: FloatArray, shapes: FloatArray, error: float) -> FloatArray:
    """Relative errors of the frequencies, (n_modes,), from rounding of the stiffness and from `error` of the eigenvalues."""
    size = np.abs(shapes)
    errors = error + np.finfo(np.float64).eps * np.einsum("ij,ij->j", size, abs(stiffness) @ size)
    clear = omega[omega**2 > errors]
    return np.asarray(errors / (2 * np.maximum(omega, clear.min() if len(clear) else np.inf) ** 2))


def _shift_below(stiffness: sparse.csc_array, mass: sparse.csc_array) -> tuple[float, LinearOperator | None]:
    """A shift just below the lowest eigenvalues of K x = lambda M x, and the inverse of K - shift M.

    The mean of all eigenvalues would be a safe shift, also for a structure that can move freely, but on a fine mesh it
    lies millions of times above the lowest, which Lanczos then cannot tell apart. A few inverse iterations of a small
    block show how far below they lie, and the shift follows until it is near them. The inverse is None where the
    diagonal of K has zeros.
    """
    shift = -1e-3 * abs(stiffness.diagonal()).sum() / max(mass.diagonal().sum(), np.finfo(float).tiny)
    least = _LEAST * shift
    block: FloatArray = np.random.default_rng(0).standard_normal((stiffness.shape[0], _BLOCK))
    while True:
        inverse = _shifted_inverse(sparse.csc_array(stiffness - shift * mass))
        if inverse is None:
            return shift, None
        for _ in range(_ITERATIONS):
            block = _orthonormal(inverse.matmat(mass @ block))
        low = _ritz(stiffness, mass, block)[0][-1]
        if low >= -_NEAR * shift or shift == least:
            return shift, inverse
        shift = min(-low, least)


def _add_missed_modes(
    stiffness: sparse.csc_array,
    mass: sparse.csc_array,
    shift: float,
    inverse: LinearOperator,
    eigenvalues: FloatArray,
    shapes: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Lowest eigenvalues and mode shapes, with those that Lanczos missed (repeated frequencies) added.

    From one vector Lanczos sees one of several modes with the same frequency, as of equal parts of a structure, and the
    others by rounding alone. Block iteration orthogonal to `shapes` finds them, until nothing changes.
    """
    count, rng = len(eigenvalues), np.random.default_rng(1)
    for _ in range(_MOST_ROUNDS):
        block: FloatArray = rng.standard_normal((len(shapes), min(_BLOCK, len(shapes) - count)))
        for _ in range(_ITERATIONS):
            block = block - shapes @ (shapes.T @ (mass @ block))
            block = _orthonormal(inverse.matmat(mass @ block))
        values, space = _ritz(stiffness, mass, _orthonormal(np.hstack([shapes, block])))
        change = np.abs(values[:count] - eigenvalues) / (np.abs(eigenvalues) - shift)
        if change.max() <= _SAME:
            break
        values, space = _ritz(stiffness, mass, _orthonormal(inverse.matmat(mass @ space)))
        eigenvalues, shapes = values[:count], space[:, :count]
    return eigenvalues, shapes


def _orthonormal(block: FloatArray) -> FloatArray:
    return np.asarray(linalg.qr(block, mode="economic")[0])


def _ritz(stiffness: sparse.csc_array, mass: sparse.csc_array, space: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues, ascending, and mass-normalized vectors of the best approximation in `space`."""
    values, turn = linalg.eigh(space.T @ (stiffness @ space), space.T @ (mass @ space))
    return values, space @ turn


def _shifted_inverse(shifted: sparse.csc_array) -> LinearOperator | None:
    """Inverse of the shifted stiffness as a linear operator; None if its diagonal has zeros."""
    shifted.sort_indices()
    if not shifted.diagonal().all():
        return None
    factor = factorizer().analyse(shifted.indices, shifted.indptr).factor(shifted.data)
    return LinearOperator(
        shifted.shape,
        matvec=lambda x: factor.solve(x.reshape(-1, 1))[:, 0],
        matmat=factor.solve,
        dtype=np.float64,
    )


def _dense_modes(mass: FloatArray, stiffness: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues and mode shapes of dense matrices; directions without mass are condensed statically."""
    has_mass = np.diag(mass) > 0
    if _is_definite(mass[np.ix_(has_mass, has_mass)]):
        return _condensed_modes(mass, stiffness, has_mass)
    scaling = 1 / np.sqrt(np.where(has_mass, np.diag(mass), 1.0))
    principal, directions = linalg.eigh(scaling[:, None] * mass * scaling)
    basis, has_mass = scaling[:, None] * directions, principal > _MASSLESS
    eigenvalues, shapes = _condensed_modes(np.diag(principal), basis.T @ stiffness @ basis, has_mass)
    return eigenvalues, basis @ shapes


def _is_definite(mass: FloatArray) -> bool:
    """True if the mass matrix is positive definite beyond rounding."""
    try:
        pivots = np.diag(linalg.cholesky(mass, lower=True)) ** 2
    except linalg.LinAlgError:
        return False
    return bool((pivots > _MASSLESS * np.diag(mass)).all())


def _condensed_modes(
    mass: FloatArray, stiffness: FloatArray, has_mass: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues and shapes, (n_dofs, n_modes), when degrees of freedom without mass are condensed statically."""
    if has_mass.all():
        return linalg.eigh(stiffness, mass)
    massless = ~has_mass
    try:
        follow = -linalg.solve(
            stiffness[np.ix_(massless, massless)], stiffness[np.ix_(massless, has_mass)], assume_a="sym"
        )
    except linalg.LinAlgError as error:
        raise SingularModelError(
            "part of the model has neither mass nor stiffness: hold it, or give it one of them"
        ) from error
    condensed = stiffness[np.ix_(has_mass, has_mass)] + stiffness[np.ix_(has_mass, massless)] @ follow
    eigenvalues, shapes = linalg.eigh(0.5 * (condensed + condensed.T), mass[np.ix_(has_mass, has_mass)])
    full = np.zeros((len(mass), shapes.shape[1]))
    full[has_mass], full[massless] = shapes, follow @ shapes
    return eigenvalues, full
