"""Fields of a small structure under harmonic loads by dense matrices: lines solved together, or summed over poles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from structid.core.arrays import ComplexArray, FloatArray, IntArray, NumberArray
from structid.dynamics.receptance import singular_model

#: Entries of one stretch of lines, which is to stay near the processor.
_CHUNK_ENTRIES = 65_536
#: Matrices by s^2, s, 1 and i; any further ones are of friction, of rank one.
_BASIC = 4
#: Where friction makes fields smaller by more than this, they are solved for: the difference would lose digits.
MOST_SMALLER = 1e3
_CHECKED = np.array([[1.0, -1.0], [-1.0, 1.0]])
#: Largest difference to the direct solution where both are computed, in parts of the field, or in parts of what the last
#: digit of the matrices and the order of the unknowns change in the direct solution.
TOLERANCE, ROUNDINGS = 1e-10, 30.0
_SPREAD = 8
#: Poles whose inverse times the variable of every line stays below this are summed by so many terms of a power series, which is
#: exact to rounding, where they are more than twice as many.
_FAR, _FAR_TERMS = 0.25, 27
#: Lines that one eigenvalue problem is worth: these, and so many for each degree of freedom.
_LEAST, _EACH, _EACH_DAMPED = 60, 1, 5


@dataclass(frozen=True, eq=False)
class DenseFields:
    """X with Z X = loads, Z = the sum of coefficient times matrix, at every line.

    Lines that are many enough are summed over the poles of the structure (`modal_fields`), and what friction does to
    them is added: it acts by one force a contact, so the fields change by products with the fields of those forces
    (Woodbury). Otherwise each line is factorized.

    Attributes
    ----------
    matrices : (n_matrices, n_dofs, n_dofs) float array
        Mass, viscous damping, stiffness, structural damping, then one of rank one for each contact with friction.
    laplace : (n_lines,) complex array
        s, 1/s.
    loads : (n_dofs, n_loads) float array
        Right-hand sides.
    frequency : (n_lines,) float array
        Hz; for messages.
    """

    matrices: FloatArray
    laplace: ComplexArray
    loads: FloatArray
    frequency: FloatArray

    def solve_in_chunks(
        self, coefficients: ComplexArray, loads: IntArray, reader: FloatArray | None = None
    ) -> Iterator[tuple[slice, ComplexArray]]:
        """Chunks of lines, each as (slice of lines, fields) with fields (n, n_dofs, n_chosen) under the chosen loads.

        Parameters
        ----------
        coefficients : (n_lines, n_matrices) complex array
            Weights of the matrices at each line: mass (s^2), viscous damping (s), stiffness (1), structural damping
            (i), then friction contacts, whose weights may differ from line to line.
        loads : (n_chosen,) int array
            Columns of the attribute `loads`.
        reader : (n_read, n_dofs) float array, optional
            If given, ``reader @ fields``, (n, n_read, n_chosen), is returned in place of the fields.

        Raises
        ------
        SingularModelError
            If Z, the weighted sum of the matrices, cannot be factorized at one of the lines.
        """
        n_lines, n_dofs, n_loads = len(self.laplace), self.matrices.shape[1], self.loads.shape[1]
        frictions = _BASIC + np.flatnonzero(coefficients[:, _BASIC:].any(axis=0))
        both = np.concatenate([np.eye(n_dofs) if reader is None else reader, self._contacts[:, frictions - _BASIC].T])
        modal = self.modal and self.modal.read(both, np.concatenate([loads, n_loads + frictions - _BASIC]))
        n_read, n_chosen = len(both) - len(frictions), len(loads)
        step = max(1, _CHUNK_ENTRIES // (n_dofs * (n_dofs if modal is None else n_chosen + len(frictions))))
        for first in range(0, n_lines, step):
            lines = np.arange(first, min(first + step, n_lines))
            part = slice(first, first + len(lines))
            if modal is None:
                yield part, self._solve_lines(lines, coefficients, loads, reader)
                continue
            fields = whole = modal.at(part)
            if len(frictions):
                free = np.ascontiguousarray(whole[:, :n_read, :n_chosen])
                slip = self._friction_forces(whole[:, n_read:], coefficients[part], frictions)
                fields = free - whole[:, :n_read, n_chosen:] @ slip
                is_lost = _squares(free) > MOST_SMALLER**2 * _squares(fields)
                if is_lost.any():
                    fields[is_lost] = self._solve_lines(lines[is_lost], coefficients, loads, reader)
            yield part, fields

    @cached_property
    def modal(self) -> _ModalFields | None:
        """Fields under the loads, then under unit forces at friction contacts, without friction, as a sum over modes.

        None where there are too few lines for an eigenvalue problem to be worth it, or the sum is not exact enough.
        """
        is_damped = bool(self.matrices[1].any())
        if not worthwhile(len(self.laplace), self.matrices.shape[1], is_damped):
            return None
        loads = np.concatenate([self.loads, self._contacts], axis=1)
        return modal_fields(self.matrices[:_BASIC], loads, self.laplace)

    @cached_property
    def _contacts(self) -> FloatArray:
        """Direction vectors b of friction contacts, whose matrices are b b' or its negative, (n_dofs, n_contacts)."""
        directions = np.zeros((self.matrices.shape[1], len(self.matrices) - _BASIC))
        for contact, matrix in enumerate(self.matrices[_BASIC:]):
            dof = int(np.abs(np.diag(matrix)).argmax())
            if matrix[dof, dof]:
                directions[:, contact] = matrix[:, dof] / np.sqrt(abs(matrix[dof, dof]))
        return directions

    def _friction_forces(self, motion: ComplexArray, coefficients: ComplexArray, frictions: IntArray) -> NumberArray:
        """Friction forces against motion, (n_lines, n_contacts, n_loads), from motion of the contacts without friction.

        `motion` is (n_lines, n_contacts, n_loads + n_contacts): under the loads, then under unit forces at the
        contacts. `coefficients` (n_lines, n_matrices) weigh the matrices at each line; `frictions` are the indices of
        the contacts' matrices among these.
        """
        sign = np.sign(np.trace(self.matrices[frictions], axis1=1, axis2=2))
        factors = (coefficients[:, frictions] * sign)[:, :, None]
        n_loads = motion.shape[2] - len(frictions)
        return solve_small_systems(
            np.eye(len(frictions)) + factors * motion[:, :, n_loads:], factors * motion[:, :, :n_loads]
        )

    def _solve_lines(
        self, lines: IntArray, coefficients: ComplexArray, loads: IntArray, reader: FloatArray | None
    ) -> ComplexArray:
        """Fields (n, n_dofs, n_chosen) at the n `lines` (indices) under chosen loads, one factorization for each line.

        With a `reader` (n_read, n_dofs), reader @ fields, (n, n_read, n_chosen). `coefficients` (n_lines, n_matrices)
        weigh the matrices at each line, `loads` are column indices of the loads. `SingularModelError` if a line cannot
        be solved.
        """
        n_dofs = self.matrices.shape[1]
        stiffness = coefficients[lines] @ self.matrices.reshape(-1, n_dofs**2)
        try:
            fields = np.linalg.solve(stiffness.reshape(-1, n_dofs, n_dofs), self.loads[:, loads].astype(np.complex128))
        except np.linalg.LinAlgError as error:
            low, high = self.frequency[lines[[0, -1]]]
            raise singular_model(float(low), float(high)) from error
        return fields if reader is None else reader @ fields


def solve_small_systems(systems: NumberArray, right: NumberArray) -> NumberArray:
    """Solution X (n_lines, n, n_right) of `systems` X = `right`, one system (n, n) for each line.

    Systems of one or two unknowns are solved by Cramer's rule, all lines together: LAPACK takes line after line.

    Raises
    ------
    LinAlgError
        If a system is singular.
    """
    if systems.shape[1] > 2:
        return np.linalg.solve(systems, right)
    if systems.shape[1] == 1:
        determinant, adjugate = systems[:, 0, 0], np.ones((1, 1))
    else:
        determinant = systems[:, 0, 0] * systems[:, 1, 1] - systems[:, 0, 1] * systems[:, 1, 0]
        adjugate = np.swapaxes(systems[:, ::-1, ::-1], 1, 2) * _CHECKED
    if not determinant.all():
        raise np.linalg.LinAlgError("Singular matrix")
    return (adjugate / determinant[:, None, None]) @ right


def _squares(fields: ComplexArray) -> FloatArray:
    """Sum of the squares of all entries of each line, (n_lines,)."""
    flat = fields.view(np.float64).reshape(len(fields), -1)
    return np.asarray(np.einsum("ij,ij->i", flat, flat))


@dataclass(frozen=True, eq=False)
class _ModalFields:
    """Fields under several loads as a sum over poles; made by `modal_fields`.

    At a line with the variable t the field is the sum over poles of shape times drive over 1 - t m, where m is the
    inverse of t at the pole.

    Attributes
    ----------
    variable : (n_lines,) complex array
    inverse : (n_poles,) complex array
    shapes : (n_dofs, n_poles) complex array
    drive : (n_poles, n_loads) complex array
    """

    variable: ComplexArray
    inverse: ComplexArray
    shapes: ComplexArray
    drive: ComplexArray

    @cached_property
    def _far(self) -> NDArray[np.bool_]:
        """Mask (n_poles,) of the poles that are summed by a power series; all False where they are few."""
        far: NDArray[np.bool_] = np.abs(self.inverse) * self._largest < _FAR
        return far if far.sum() > 2 * _FAR_TERMS else np.zeros_like(far)

    @cached_property
    def _largest(self) -> float:
        """Largest size of the variable."""
        return float(np.abs(self.variable).max())

    @cached_property
    def _residues(self) -> ComplexArray:
        """Field of each term of the modal sum, (n_terms, n_dofs * n_loads), loads fastest; `_weights` multiplies them.

        Terms are the poles near the lines, then powers of the variable t (from 0), which stand for all far poles.
        """
        near, far = ~self._far, self._far
        fields = self.shapes.T[near, :, None] * self.drive[near, None, :]
        if far.any():
            powers = np.vander(self._largest * self.inverse[far], _FAR_TERMS, increasing=True).T
            fields = np.concatenate([fields, (self.shapes[:, far] * powers[:, None, :]) @ self.drive[far]])
        return fields.reshape(len(fields), -1)

    def _weights(self, variable: ComplexArray) -> ComplexArray:
        """Weight of each term at values t of the `variable` (n,), (n, n_terms): those of near poles, then powers of t.

        A near pole has 1 / (1 - t m) with its entry m of `inverse`; powers are those of t over its largest value, from
        0.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            weights: ComplexArray = 1 / (1 - variable[:, None] * self.inverse[~self._far])
        if self._far.any():
            powers = np.vander(variable / self._largest, _FAR_TERMS, increasing=True)
            weights = np.concatenate([weights, powers], axis=1)
        return weights

    def read(self, reader: FloatArray, loads: IntArray) -> _ModalFields:
        """Sum over the same poles for the readings of `reader` (n_read, n_dofs), under the loads at indices `loads`."""
        return replace(self, shapes=reader @ self.shapes, drive=self.drive[:, loads])

    def at(self, lines: slice | IntArray) -> ComplexArray:
        """The fields, or readings, at some lines, (n, n_dofs, n_loads); not finite at a line on an undamped pole."""
        weights = self._weights(self.variable[lines])
        with np.errstate(invalid="ignore"):
            return (weights @ self._residues).reshape(len(weights), len(self.shapes), -1)


def worthwhile(n_lines: int, n_dofs: int, damped: bool) -> bool:
    """True if `n_lines` lines are worth an eigenvalue problem, of twice the size with viscous damping (`damped`).

    They are from 60 + `n_dofs` lines on, or from 60 + 5 `n_dofs` with viscous damping.
    """
    return n_lines >= _LEAST + (_EACH_DAMPED if damped else _EACH) * n_dofs


def modal_fields(matrices: FloatArray, loads: FloatArray, laplace: ComplexArray) -> _ModalFields | None:
    """Fields X with (s^2 M + s C + K + i H) X = loads at all s, as a sum over the poles of the structure.

    Let s0 be the geometric mean of |s|. Without viscous damping and with t = s0^2 - s^2, the dynamic stiffness is Z =
    Z(s0) (I - t B), where B = Z(s0)^-1 M. With viscous damping and t = s - s0, the same holds for (X, t X / s0) and a B
    of twice the size. The eigenvectors of B serve all lines. As B is an inverse, modes near the lines are as exact as
    by factorization at each line, and motions without mass are modes with the eigenvalue 0. The sum is compared with
    the direct solution at the first line at or above each pole, and at a few more.

    Parameters
    ----------
    matrices : (4, n_dofs, n_dofs) float array
        M, C, K and H.
    loads : (n_dofs, n_loads) float array
    laplace : (n_lines,) complex array
        s, 1/s.

    Returns
    -------
    _ModalFields or None
        None where the sum differs from the direct solution by more than 1e-10, relative to it, and by more than
        rounding explains: the eigenvectors are then close to dependent, as those of critical damping are. None too if Z
        is singular at s0 or at a compared line, or the eigenvectors are dependent.
    """
    mass, damping = matrices[:2]
    stiffness = matrices[2] + 1j * matrices[3] if matrices[3].any() else matrices[2]
    size = np.abs(laplace)
    shift = float(np.exp(np.log(size[size > 0]).mean()))
    n = len(mass)
    try:
        shifted = shift**2 * mass + shift * damping + stiffness
        if damping.any():
            right = np.concatenate([(2 * shift * mass + damping) * shift, mass * shift**2, loads], axis=1)
            solved = np.linalg.solve(shifted, right)
            state = np.zeros((2 * n, 2 * n), dtype=solved.dtype)
            state[:n] = -solved[:, : 2 * n]
            state[n:, :n] = np.eye(n)
            inverse, vectors = np.linalg.eig(state)
            still = np.concatenate([solved[:, 2 * n :], np.zeros((n, loads.shape[1]))])
            by_modes = _ModalFields((laplace - shift) / shift, inverse, vectors[:n], np.linalg.solve(vectors, still))
            near = shift * (1 + 1 / inverse[inverse != 0])
        else:
            solved = np.linalg.solve(shifted, np.concatenate([shift**2 * mass, loads], axis=1))
            inverse, vectors = np.linalg.eig(solved[:, :n])
            drive = np.linalg.solve(vectors, solved[:, n:])
            by_modes = _ModalFields(1 - (laplace / shift) ** 2, inverse, vectors, drive)
            near = shift * np.sqrt(1 - 1 / inverse[inverse != 0] + 0j)
    except np.linalg.LinAlgError:
        return None
    lines = _check_lines(np.abs(near.imag), laplace.imag)
    s = laplace[lines, None, None]
    dynamic_stiffness = s**2 * mass + s * damping + stiffness
    return by_modes if _matches_direct_solution(by_modes.at(lines), dynamic_stiffness, loads) else None


def _matches_direct_solution(fields: ComplexArray, dynamic: ComplexArray, loads: FloatArray) -> bool:
    """True if `fields` (n_lines, n_dofs, n_loads) agree with Z^-1 loads, solved directly, as well as rounding allows.

    They do if the relative difference is at most 1e-10, or 30 times what changes of Z in the last digit make. `dynamic`
    has the dynamic stiffness Z at each line, (n_lines, n_dofs, n_dofs). False too if Z is singular.
    """
    right = loads.astype(np.complex128)
    try:
        exact = np.linalg.solve(dynamic, right)
        differences = _differences(fields, exact)
        if differences.max() <= TOLERANCE:
            return True
        digit = np.finfo(np.float64).eps * np.random.default_rng(0).uniform(-1.0, 1.0, dynamic.shape[1:])
        for lines in ([int(differences.argmax())], slice(None)):  # the worst line mostly says enough
            other = np.linalg.solve((dynamic[lines] * (1 + digit))[:, ::-1, ::-1], right[::-1])[:, ::-1]
            if differences.max() <= ROUNDINGS * _differences(other, exact[lines]).max():
                return True
    except np.linalg.LinAlgError:
        return False
    return False


def _differences(fields: ComplexArray, exact: ComplexArray) -> FloatArray:
    """Largest difference between two fields (n_lines, n_dofs, n_loads) at each line, (n_lines,).

    It is relative to the largest entry of each exact field.
    """
    largest = np.abs(exact).max(axis=1)
    off = np.abs(fields - exact).max(axis=1)
    return np.asarray((off / np.where(largest > 0, largest, 1.0)).max(axis=1))


def _check_lines(poles: FloatArray, lines: FloatArray) -> IntArray:
    """Index of the first line at or above each pole within the band, and of a few spread over it, increasing.

    `poles` (n_poles,) and `lines` (n_lines,) are frequencies in one unit and need not be sorted; poles outside the
    lines do not count.
    """
    order = np.argsort(lines)
    in_band = poles[(poles >= lines.min()) & (poles <= lines.max())]
    near = np.clip(np.searchsorted(lines[order], in_band), 0, len(lines) - 1)
    spread = np.linspace(0, len(lines) - 1, _SPREAD).astype(int)
    return np.unique(np.concatenate([order[near], spread]))
