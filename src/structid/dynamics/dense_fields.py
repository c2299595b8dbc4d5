"""Fields of a small structure under harmonic loads by dense matrices, many lines together."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from structid.arrays import ComplexArray, FloatArray, IntArray
from structid.dynamics.modal_fields import ModalFields, modal_fields, worthwhile
from structid.dynamics.receptance import singular_model

#: Entries of one stretch of lines, which is to stay near the processor.
_CHUNK_ENTRIES = 65_536
#: Matrices by s^2, s, 1 and i; any further ones are of friction, of rank one.
_BASIC = 4
#: Where friction makes fields smaller by more than this, they are solved for: the difference would lose digits.
MOST_SMALLER = 1e3


@dataclass(frozen=True, eq=False)
class DenseFields:
    """X with Z X = loads, Z = sum over laws of coefficient times matrix, at every line.

    Lines that are many enough are summed over the poles of the structure (`modal_fields`), and what friction does to
    them is added: it acts by one force a contact, so the fields change by products with the fields of those forces
    (Woodbury). Otherwise each line is factorized.

    Attributes
    ----------
    matrices : (n_laws, n_dofs, n_dofs) float array
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

    def stretches(self, coefficients: ComplexArray, loads: IntArray) -> Iterator[tuple[slice, ComplexArray]]:
        """Fields (n, n_dofs, n_chosen) under some of the loads for stretches of lines, one after another.

        Parameters
        ----------
        coefficients : (n_lines, n_laws) complex array
            How each matrix enters: s^2, s, 1, i, and of friction what may differ from line to line.
        loads : (n_chosen,) int array

        Raises
        ------
        SingularModelError
            If Z cannot be factorized at one of the lines.
        """
        n_lines, n_dofs, n_loads = len(self.laplace), self.matrices.shape[1], self.loads.shape[1]
        laws = _BASIC + np.flatnonzero(coefficients[:, _BASIC:].any(axis=0))
        modal = None if self.modal is None else self.modal.under(loads)
        pushed = None if self.modal is None else self.modal.under(n_loads + laws - _BASIC)
        step = max(1, _CHUNK_ENTRIES // (n_dofs * (n_dofs if modal is None else len(loads) + len(laws))))
        for first in range(0, n_lines, step):
            lines = np.arange(first, min(first + step, n_lines))
            part = slice(first, first + len(lines))
            if modal is None or pushed is None:
                yield part, self._solved(lines, coefficients, loads)
                continue
            fields = modal.at(part)
            if len(laws):
                before = _squares(fields)
                fields -= self._slip(fields, pushed.at(part), coefficients[part], laws)
                is_lost = before > MOST_SMALLER**2 * _squares(fields)
                if is_lost.any():
                    fields[is_lost] = self._solved(lines[is_lost], coefficients, loads)
            yield part, fields

    @cached_property
    def modal(self) -> ModalFields | None:
        """Under the loads, then unit forces at the contacts, without friction; None where each line is factorized."""
        is_damped = bool(self.matrices[1].any())
        if not worthwhile(len(self.laplace), self.matrices.shape[1], is_damped):
            return None
        loads = np.concatenate([self.loads, self._contacts], axis=1)
        return modal_fields(self.matrices[:_BASIC], loads, self.laplace)

    @cached_property
    def _contacts(self) -> FloatArray:
        """b of each further matrix, which is b b' or its negative, (n_dofs, n_contacts)."""
        found = np.zeros((self.matrices.shape[1], len(self.matrices) - _BASIC))
        for contact, matrix in enumerate(self.matrices[_BASIC:]):
            place = int(np.abs(np.diag(matrix)).argmax())
            if matrix[place, place]:
                found[:, contact] = matrix[:, place] / np.sqrt(abs(matrix[place, place]))
        return found

    def _slip(
        self, fields: ComplexArray, pushed: ComplexArray, coefficients: ComplexArray, laws: IntArray
    ) -> ComplexArray:
        """What friction takes from fields without it, from those under unit forces at the contacts."""
        contacts = self._contacts[:, laws - _BASIC].T.astype(np.complex128)
        sign = np.sign(np.trace(self.matrices[laws], axis1=1, axis2=2))
        factors = (coefficients[:, laws] * sign)[:, :, None]
        system = np.eye(len(laws)) + factors * (contacts @ pushed)
        return pushed @ np.linalg.solve(system, factors * (contacts @ fields))

    def _solved(self, lines: IntArray, coefficients: ComplexArray, loads: IntArray) -> ComplexArray:
        """Fields at some lines by a factorization at each."""
        n_dofs = self.matrices.shape[1]
        stiffness = coefficients[lines] @ self.matrices.reshape(-1, n_dofs**2)
        try:
            return np.linalg.solve(stiffness.reshape(-1, n_dofs, n_dofs), self.loads[:, loads].astype(np.complex128))
        except np.linalg.LinAlgError as error:
            low, high = self.frequency[lines[[0, -1]]]
            raise singular_model(float(low), float(high)) from error


def _squares(fields: ComplexArray) -> FloatArray:
    """Sum of the squares of all entries of each line, (n_lines,)."""
    flat = fields.view(np.float64).reshape(len(fields), -1)
    return np.asarray(np.einsum("ij,ij->i", flat, flat))
