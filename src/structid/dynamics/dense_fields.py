"""Fields of a small structure under harmonic loads by dense matrices, many lines together."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray, NumberArray
from structid.dynamics.modal_fields import ModalFields, modal_fields, worthwhile
from structid.dynamics.receptance import singular_model

#: Entries of one stretch of lines, which is to stay near the processor.
_CHUNK_ENTRIES = 65_536
#: Matrices by s^2, s, 1 and i; any further ones are of friction, of rank one.
_BASIC = 4
#: Where friction makes fields smaller by more than this, they are solved for: the difference would lose digits.
MOST_SMALLER = 1e3
_CHECKED = np.array([[1.0, -1.0], [-1.0, 1.0]])


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
            Weight of each matrix at each line: s^2, s, 1, i, and that of friction, which may differ from line to line.
        loads : (n_chosen,) int array
            Columns of the attribute `loads`.
        reader : (n_read, n_dofs) float array, optional
            If given, ``reader @ fields``, (n, n_read, n_chosen), is returned in place of the fields.

        Raises
        ------
        SingularModelError
            If Z cannot be factorized at one of the lines.
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
            found = whole = modal.at(part)
            if len(frictions):
                free = np.ascontiguousarray(whole[:, :n_read, :n_chosen])
                slip = self._friction_forces(whole[:, n_read:], coefficients[part], frictions)
                found = free - whole[:, :n_read, n_chosen:] @ slip
                is_lost = _squares(free) > MOST_SMALLER**2 * _squares(found)
                if is_lost.any():
                    found[is_lost] = self._solve_lines(lines[is_lost], coefficients, loads, reader)
            yield part, found

    @cached_property
    def modal(self) -> ModalFields | None:
        """Fields under the loads, then under unit forces at the contacts, without friction, by modes; None if that is slower.

        None also if the sum over modes is not exact enough.
        """
        is_damped = bool(self.matrices[1].any())
        if not worthwhile(len(self.laplace), self.matrices.shape[1], is_damped):
            return None
        loads = np.concatenate([self.loads, self._contacts], axis=1)
        return modal_fields(self.matrices[:_BASIC], loads, self.laplace)

    @cached_property
    def _contacts(self) -> FloatArray:
        """Direction vectors b of the friction contacts, whose matrices are b b' or its negative, (n_dofs, n_contacts)."""
        directions = np.zeros((self.matrices.shape[1], len(self.matrices) - _BASIC))
        for contact, matrix in enumerate(self.matrices[_BASIC:]):
            dof = int(np.abs(np.diag(matrix)).argmax())
            if matrix[dof, dof]:
                directions[:, contact] = matrix[:, dof] / np.sqrt(abs(matrix[dof, dof]))
        return directions

    def _friction_forces(self, motion: ComplexArray, coefficients: ComplexArray, frictions: IntArray) -> NumberArray:
        """Friction forces, (n_lines, n_contacts, n_loads), from the motion of the contacts without friction.

        `motion` is (n_lines, n_contacts, n_loads + n_contacts): under the loads, then under unit forces at the
        contacts. `coefficients` weigh the matrices at each line; `frictions` are the indices of those of the contacts.
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
        """Fields (n, n_dofs, n_chosen) at `lines` (indices) under the chosen loads, one factorization for each line.

        With a `reader` (n_read, n_dofs), reader @ fields. `coefficients` (n_lines, n_matrices) weigh the matrices at each line,
        `loads` are columns. `SingularModelError` if a line cannot be solved.
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
    """Solution X (n_lines, n, n_right) of systems X = right, one system (n, n) for each line.

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
