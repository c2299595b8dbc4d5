"""Natural frequencies, damping ratios and mode shapes of (mass, damping, stiffness)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.sparse.linalg import LinearOperator, eigsh, splu

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
#: Relative error of a frequency by rounding from which on modes are found again from a root of the stiffness.
_ROUGH = 1e-9
#: Roundings of a root of the stiffness that strains, and so frequencies, are off by.
_ROOT_ROUNDINGS = 8
#: Times that modes of a large model are found from strains: the first time with a scaling that rounding may have spoilt.
_STRAIN_PASSES = 2
#: Part of the modes of a large model from which on all of them are found, after condensation.
_MOST_BY_LANCZOS = 3

#: The matrix B with K = B'B; None where there is none (`structid.fem.contribution`).
Strains = Callable[[], sparse.csr_array | None]
#: V'KV of a space V, (n, n).
_Energy = Callable[[FloatArray], FloatArray]


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
    matrix_rounding : (n_modes,) float array or None
        The first of these alone, which responses have that are solved from the assembled matrix; `rounding` where None.
    """

    frequency: FloatArray
    damping_ratio: FloatArray
    mode_shapes: FloatArray
    rounding: FloatArray
    matrix_rounding: FloatArray | None = None


def modes(
    mass: sparse.csc_array,
    stiffness: sparse.csc_array,
    damping: sparse.csc_array | None = None,
    structural: sparse.csc_array | None = None,
    n_modes: int | None = None,
    strains: Strains | None = None,
) -> Modes:
    """Lowest normal modes of K phi = omega^2 M phi, by rising frequency, with damping by first-order perturbation.

    Parameters
    ----------
    mass, stiffness : (n_dofs, n_dofs) sparse arrays
        Symmetric; degrees of freedom, or combinations of them, without mass follow the others statically.
    damping, structural : (n_dofs, n_dofs) sparse arrays, optional
        Viscous damping, and imaginary part of the complex stiffness.
    n_modes : int, optional
        How many; all by default (up to 20 for a model of more than 600 degrees of freedom).
    strains : function without arguments, optional
        Gives B with K = B'B, or None. It is called where rounding of the stiffness matrix shows in frequencies: modes
        are then computed from B, whose relative rounding errors are much smaller.

    Returns
    -------
    Modes
        Frequencies in Hz, damping ratios (0 for rigid-body modes), shapes (n_dofs, n_modes) of unit modal mass with the
        entry largest in size positive, and relative rounding errors of the frequencies.

    Raises
    ------
    SingularModelError
        If an entry is not finite, or a motion has neither mass nor stiffness.

    Notes
    -----
    A dense eigenvalue problem is off by eps times its largest eigenvalue. Where that, or the rounding of K, shows in a
    frequency, modes come from the singular values of R^-T L, largest first, with R'R = K + s M for a small shift s and
    L L' = M: they are 1 / sqrt(omega^2 + s), and the largest of them are exact to eps times the condition number of R.
    R comes from a QR decomposition of [B; sqrt(s) L'], or else from Cholesky's of K, which keeps its rounding.
    Large models are solved through [[a I, B], [B', -s M / a]] (Bjoerck 1996, Numerical Methods for Least Squares
    Problems, section 2.5.3).
    """
    if not (np.isfinite(mass.data).all() and np.isfinite(stiffness.data).all()):
        raise SingularModelError("mass or stiffness of the model is not finite: a value has run away")
    if mass.shape[0] <= _DENSE_UP_TO:
        omega, shapes, rounding = _small_modes(mass, stiffness, n_modes, strains)
    else:
        omega, shapes, rounding = _large_modes(mass, stiffness, n_modes or 20, strains)
    shapes = shapes * np.sign(shapes[np.abs(shapes).argmax(axis=0), np.arange(shapes.shape[1])])
    loss = np.zeros(len(omega))
    if damping is not None:
        loss += omega * np.einsum("ij,ij->j", shapes, damping @ shapes)
    if structural is not None:
        loss += np.einsum("ij,ij->j", shapes, structural @ shapes)
    ratio = np.divide(loss, 2 * omega**2, out=np.zeros_like(loss), where=omega > 1e-6 * omega.max(initial=0.0))
    return Modes(omega / (2 * np.pi), ratio, shapes, rounding, _rounding_errors(stiffness, omega, shapes, 0.0))


def _small_modes(
    mass: sparse.csc_array, stiffness: sparse.csc_array, n_modes: int | None, strains: Strains | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Circular frequencies (rad/s), mass-normalized shapes and relative rounding errors of a model solved densely.

    They are (n_modes,), (n_dofs, n_modes) and (n_modes,), by rising frequency; `n_modes` None gives all modes.
    `strains` makes an operator B with K = B'B, by which roundings of K are avoided; None, or a result of None, leaves
    them. Raises `SingularModelError` if no motion has a mass, or one has neither mass nor stiffness.
    """
    eigenvalues, shapes = _dense_modes(mass.toarray(), stiffness.toarray())
    if not len(eigenvalues):
        raise SingularModelError(
            "no motion of the model has a mass, so that it has no modes: masses have run away to 0"
        )
    error = _DENSE_ROUNDINGS * np.finfo(np.float64).eps * float(eigenvalues[-1])
    eigenvalues, shapes = eigenvalues[:n_modes], shapes[:, :n_modes]
    omega = np.sqrt(np.maximum(eigenvalues, 0.0))
    rounding = _rounding_errors(stiffness, omega, shapes, error)
    if rounding.max(initial=0.0) <= _ROUGH:
        return omega, shapes, rounding
    clear = eigenvalues[eigenvalues > 2 * eigenvalues * rounding]
    shift = float(clear.min()) if len(clear) else error
    operator = None if strains is None else strains()
    root = _root(mass.toarray(), stiffness.toarray(), operator, shift)
    if root is None:
        return omega, shapes, rounding
    omega, shapes = (part[..., : len(omega)] for part in _modes_of_root(*root, shift))
    exact = _rounding_errors(stiffness, omega, shapes, 0.0)
    return omega, shapes, exact if operator is None else np.minimum(exact, _root_rounding(stiffness, omega, shapes))


def _large_modes(
    mass: sparse.csc_array, stiffness: sparse.csc_array, n_modes: int, strains: Strains | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Circular frequencies (rad/s), mass-normalized shapes and relative rounding errors of the `n_modes` lowest modes.

    They are (n_modes,), (n_dofs, n_modes) and (n_modes,), by rising frequency, of sparse `mass` and `stiffness`
    (n_dofs, n_dofs). `strains` makes an operator B with K = B'B, by which roundings of K are avoided; None, or a result
    of None, leaves them. A dense solver that does not use it serves where a third or more of all modes are wanted.
    """
    n_with_mass = int((mass.diagonal() > 0).sum())
    if _MOST_BY_LANCZOS * n_modes >= n_with_mass:
        eigenvalues, shapes = _dense_modes(mass.toarray(), stiffness.toarray())
        error = _DENSE_ROUNDINGS * np.finfo(np.float64).eps * float(eigenvalues[-1])
        omega, shapes = np.sqrt(np.maximum(eigenvalues[:n_modes], 0.0)), shapes[:, :n_modes]
        return omega, shapes, _rounding_errors(stiffness, omega, shapes, error)
    shift, inverse = _shift_below(stiffness, mass)
    eigenvalues, shapes = _lanczos_modes(mass, stiffness, n_modes, shift, inverse, _energy_of(stiffness))
    omega = np.sqrt(np.maximum(eigenvalues, 0.0))
    rounding = _rounding_errors(stiffness, omega, shapes, 0.0)
    operator = strains() if strains is not None and rounding.max(initial=0.0) > _ROUGH else None
    if operator is None:
        return omega, shapes, rounding
    for _ in range(_STRAIN_PASSES):
        strained = np.square(operator @ shapes).sum(axis=0)
        size = np.einsum("ij,i,ij->j", shapes, stiffness.diagonal(), shapes)
        low = int(np.argmin(np.where(strained > -_LEAST * shift, strained, np.inf)))
        shift = -float(max(strained[low], -_LEAST * shift))
        inverse = _strain_inverse(operator, mass, -shift, float(np.sqrt(-2 * shift / size[low])))
        energy: _Energy = lambda space: (operator @ space).T @ (operator @ space)  # noqa: E731
        eigenvalues, shapes = _lanczos_modes(mass, stiffness, n_modes, shift, inverse, energy)
    omega = np.sqrt(np.maximum(eigenvalues, 0.0))
    return omega, shapes, np.minimum(rounding, _root_rounding(stiffness, omega, shapes))


def frequencies_between(
    known: Modes, mass: sparse.csc_array, stiffness: sparse.csc_array, lowest: float, highest: float
) -> tuple[FloatArray, bool]:
    """Natural frequencies (n_modes,) above `lowest` and up to `highest` (Hz), rising, and True if the list is complete.

    `known` are the lowest modes of the model, whose `mass` and `stiffness` are (n_dofs, n_dofs). If the list is not
    complete, as may be in a large model, it holds those of `known`, or only the first if all of `known` are at most
    `lowest`.
    """
    frequency = known.frequency
    is_all = mass.shape[0] <= _DENSE_UP_TO or bool(frequency[-1] > highest)
    if not is_all and frequency[-1] <= lowest:
        start, shift = np.random.default_rng(0).standard_normal(mass.shape[0]), (2 * np.pi * lowest) ** 2
        eigenvalues = eigsh(stiffness, 1, mass, sigma=shift, which="LA", v0=start, return_eigenvectors=False)
        frequency = np.sqrt(np.maximum(eigenvalues, 0.0)) / (2 * np.pi)
    return frequency[(frequency > lowest) & (frequency <= highest)], is_all


def _energy_of(stiffness: sparse.csc_array) -> _Energy:
    return lambda space: space.T @ (stiffness @ space)


def _lanczos_modes(
    mass: sparse.csc_array,
    stiffness: sparse.csc_array,
    n_modes: int,
    shift: float,
    inverse: LinearOperator | None,
    energy: _Energy,
) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues omega^2 nearest to `shift`, (rad/s)^2, ascending, and mass-normalized vectors (n_dofs, n_modes).

    M is `mass`, K `stiffness`. `inverse` is (K - `shift` M)^-1, with which modes that Lanczos missed are found; with
    None they are not, and SciPy factorizes. `energy` gives V'KV of a space V.
    """
    start = np.random.default_rng(0).standard_normal(mass.shape[0])
    eigenvalues, shapes = eigsh(stiffness, n_modes, mass, sigma=shift, which="LM", v0=start, OPinv=inverse)
    order = np.argsort(eigenvalues)
    eigenvalues, shapes = eigenvalues[order], shapes[:, order]
    return (
        (eigenvalues, shapes)
        if inverse is None
        else _add_missed_modes(energy, mass, shift, inverse, eigenvalues, shapes)
    )


def _strain_inverse(operator: sparse.csr_array, mass: sparse.csc_array, shift: float, scale: float) -> LinearOperator:
    """Inverse of B'B + `shift` M as a linear operator, from B itself (`operator`, (n_strains, n_dofs)).

    `mass` M is (n_dofs, n_dofs); `scale` is about the least singular value of B with its columns scaled to norm 1.
    """
    n_strains, n = operator.shape
    size = 1 / np.sqrt(np.asarray(operator.multiply(operator).sum(axis=0)).ravel())
    scaling = sparse.diags_array(size)
    scaled = sparse.csc_array(operator @ scaling)
    corner = sparse.csc_array((-shift / scale) * (scaling @ mass @ scaling))
    matrix = sparse.block_array([[scale * sparse.eye_array(n_strains), scaled], [scaled.T, corner]], format="csc")
    factor = splu(sparse.csc_matrix(matrix))

    def solve(forces: FloatArray) -> FloatArray:
        """Displacements (B'B + `shift` M)^-1 `forces`, of their shape: one force vector (n,) or (n, n_columns)."""
        columns = forces.reshape(n, -1)
        right = np.concatenate([np.zeros((n_strains, columns.shape[1])), (-size / scale)[:, None] * columns])
        return np.asarray(size[:, None] * factor.solve(right)[n_strains:]).reshape(forces.shape)

    return LinearOperator((n, n), matvec=solve, matmat=solve, dtype=np.float64)


def _root(
    mass: FloatArray, stiffness: FloatArray, operator: sparse.csr_array | None, shift: float
) -> tuple[FloatArray, FloatArray, NDArray[np.intp]] | None:
    """Triangle R, R'R = K + `shift` M, L (n_dofs, rank of M), L L' = M, and `order`; None if K + `shift` M has no R.

    M is `mass`, K `stiffness`, (n_dofs, n_dofs) each. Columns of R and rows of L are the degrees of freedom `order`.
    `operator` is B with K = B'B: R comes from a pivoted QR of [B; sqrt(shift) L']; from Cholesky's of K + `shift` M, in
    plain order, if it is None.
    """
    has_mass = np.diag(mass) > 0
    size = np.sqrt(np.where(has_mass, np.diag(mass), 1.0))
    principal, turn = linalg.eigh(mass / size[:, None] / size)
    kept = principal > _MASSLESS
    mass_root = size[:, None] * turn[:, kept] * np.sqrt(principal[kept])
    if operator is None:
        shifted = stiffness + shift * mass
        scale = np.sqrt(np.maximum(np.diag(shifted), np.finfo(np.float64).tiny))
        try:
            triangle = linalg.cholesky(shifted / scale[:, None] / scale) * scale
        except linalg.LinAlgError:
            return None
        return triangle, mass_root, np.arange(len(mass))
    rows = np.concatenate([operator.toarray(), np.sqrt(shift) * mass_root.T])
    rows = rows[np.argsort(-np.abs(rows).max(axis=1), kind="stable")]  # large rows first, or they spoil the small ones
    triangle, order = linalg.qr(rows, mode="r", pivoting=True)
    triangle = triangle[: len(mass)]
    return (triangle, mass_root[order], order) if np.diag(triangle).all() else None


def _modes_of_root(
    triangle: FloatArray, mass_root: FloatArray, order: NDArray[np.intp], shift: float
) -> tuple[FloatArray, FloatArray]:
    """Circular frequencies (n_modes,), rad/s, rising, and mass-normalized shapes (n_dofs, n_modes) of R'R - `shift` M.

    `triangle` is R (n_dofs, n_dofs), `mass_root` L (n_dofs, rank of M) with L L' = M; n_modes is that rank. `order`
    (n_dofs,) are the degrees of freedom of the columns of R and the rows of L; rows of the shapes are in plain order.
    """
    left, singular, _ = linalg.svd(linalg.solve_triangular(triangle, mass_root, trans="T"), full_matrices=False)
    shapes = np.empty_like(left)
    shapes[order] = linalg.solve_triangular(triangle, left) / singular
    return np.sqrt(np.maximum(1 / singular**2 - shift, 0.0)), shapes


def _root_rounding(stiffness: sparse.csc_array, omega: FloatArray, shapes: FloatArray) -> FloatArray:
    """Relative rounding errors, (n_modes,), of frequencies `omega` (n_modes,) in rad/s that come from strains.

    `shapes` (n_dofs, n_modes) are mass-normalized; `stiffness` (n_dofs, n_dofs) gives the size of the strains. Errors
    of frequencies lower than the lowest that rises above its error are relative to that one; all are 0 if none does.
    """
    size = np.abs(shapes)
    strained = np.sqrt(np.einsum("ij,ij->j", size, abs(stiffness) @ size))
    errors = _ROOT_ROUNDINGS * np.finfo(np.float64).eps * strained
    clear = omega[omega > errors]
    return np.asarray(errors / np.maximum(omega, clear.min() if len(clear) else np.inf))


def _rounding_errors(stiffness: sparse.csc_array, omega: FloatArray, shapes: FloatArray, error: float) -> FloatArray:
    """Relative errors, (n_modes,), of frequencies `omega` (rad/s) by rounding of the stiffness and of eigenvalues.

    `shapes` (n_dofs, n_modes) are mass-normalized; `error` is that of all eigenvalues omega^2, (rad/s)^2. Errors of
    frequencies lower than the lowest that rises above its error are relative to that one; all are 0 if none does.
    """
    size = np.abs(shapes)
    errors = error + np.finfo(np.float64).eps * np.einsum("ij,ij->j", size, abs(stiffness) @ size)
    clear = omega[omega**2 > errors]
    return np.asarray(errors / (2 * np.maximum(omega, clear.min() if len(clear) else np.inf) ** 2))


def _shift_below(stiffness: sparse.csc_array, mass: sparse.csc_array) -> tuple[float, LinearOperator | None]:
    """Negative shift, (rad/s)^2, just below the lowest eigenvalues, and the inverse of K - shift M.

    `stiffness` K and `mass` M are (n_dofs, n_dofs). The inverse is None if a diagonal entry is 0. Minus a thousandth of
    the mean of all eigenvalues is a safe shift, also for a structure that can move freely, but on a fine mesh it lies
    millions of times farther from 0 than the lowest, which Lanczos then cannot separate. Inverse iterations of a small
    block show how far off they lie, and the shift follows until it is near them.
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
        low = _ritz(_energy_of(stiffness), mass, block)[0][-1]
        if low >= -_NEAR * shift or shift == least:
            return shift, inverse
        shift = min(-low, least)


def _add_missed_modes(
    energy: _Energy,
    mass: sparse.csc_array,
    shift: float,
    inverse: LinearOperator,
    eigenvalues: FloatArray,
    shapes: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Lowest modes (omega^2 rising, vectors), as many as given: those that Lanczos missed push out the highest.

    `eigenvalues` and `shapes` (n_dofs, n_modes) are Lanczos' about `shift` < 0, `inverse` is (K - `shift` M)^-1,
    `energy` gives V'KV of a space V. Of equal modes one vector sees one: random ones beside `shapes` find the others.
    """
    count, rng = len(eigenvalues), np.random.default_rng(1)
    for _ in range(_MOST_ROUNDS):
        block: FloatArray = rng.standard_normal((len(shapes), min(_BLOCK, len(shapes) - count)))
        for _ in range(_ITERATIONS):
            block = block - shapes @ (shapes.T @ (mass @ block))
            block = _orthonormal(inverse.matmat(mass @ block))
        values, space = _ritz(energy, mass, _orthonormal(np.hstack([shapes, block])))
        change = np.abs(values[:count] - eigenvalues) / (np.abs(eigenvalues) - shift)
        if change.max() <= _SAME:
            break
        values, space = _ritz(energy, mass, _orthonormal(inverse.matmat(mass @ space)))
        eigenvalues, shapes = values[:count], space[:, :count]
    return eigenvalues, shapes


def _orthonormal(block: FloatArray) -> FloatArray:
    return np.asarray(linalg.qr(block, mode="economic")[0])


def _ritz(energy: _Energy, mass: sparse.csc_array, space: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues (n,), ascending, and mass-normalized vectors (n_dofs, n) of the best approximation in `space`.

    `energy` gives V'KV of a space V, `mass` is (n_dofs, n_dofs).
    """
    values, turn = linalg.eigh(energy(space), space.T @ (mass @ space))
    return values, space @ turn


def _shifted_inverse(shifted: sparse.csc_array) -> LinearOperator | None:
    """Inverse of the shifted stiffness as a linear operator, by the factorizer in use; None if a diagonal is 0.

    Indices of `shifted` (n_dofs, n_dofs) are sorted in place.
    """
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
    """Eigenvalues omega^2, ascending, and mass-normalized shapes (n_dofs, n_modes), of matrices (n_dofs, n_dofs).

    Motions without mass, of a degree of freedom or a combination of several, follow statically; n_modes counts the
    others.
    """
    has_mass = np.diag(mass) > 0
    if _is_definite(mass[np.ix_(has_mass, has_mass)]):
        return _condensed_modes(mass, stiffness, has_mass)
    size = 1 / np.sqrt(np.where(has_mass, np.diag(mass), 1.0))
    principal, turn = linalg.eigh(size[:, None] * mass * size)
    basis, has_mass = size[:, None] * turn, principal > _MASSLESS
    eigenvalues, shapes = _condensed_modes(np.diag(principal), basis.T @ stiffness @ basis, has_mass)
    return eigenvalues, basis @ shapes


def _is_definite(mass: FloatArray) -> bool:
    """True if the mass matrix (n, n) is positive definite beyond rounding, so that no motion is massless."""
    try:
        pivots = np.diag(linalg.cholesky(mass, lower=True)) ** 2
    except linalg.LinAlgError:
        return False
    return bool((pivots > _MASSLESS * np.diag(mass)).all())


def _condensed_modes(
    mass: FloatArray, stiffness: FloatArray, has_mass: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues omega^2, (rad/s)^2, rising, and shapes (n_dofs, n_modes) of unit modal mass.

    There is one mode for each degree of freedom in the mask `has_mass` (n_dofs,); those without mass follow statically.
    `mass` and `stiffness` are (n_dofs, n_dofs). Raises `SingularModelError` if those that follow have no stiffness.
    """
    if has_mass.all():
        return linalg.eigh(stiffness, mass)
    massless = ~has_mass
    try:
        follow = -linalg.solve(
            stiffness[np.ix_(massless, massless)], stiffness[np.ix_(massless, has_mass)], assume_a="sym"
        )
    except linalg.LinAlgError as error:
        raise SingularModelError(
            "part of the model has neither mass nor stiffness: fix it, or give it one of them"
        ) from error
    condensed = stiffness[np.ix_(has_mass, has_mass)] + stiffness[np.ix_(has_mass, massless)] @ follow
    eigenvalues, shapes = linalg.eigh(0.5 * (condensed + condensed.T), mass[np.ix_(has_mass, has_mass)])
    full = np.zeros((len(mass), shapes.shape[1]))
    full[has_mass], full[massless] = shapes, follow @ shapes
    return eigenvalues, full
