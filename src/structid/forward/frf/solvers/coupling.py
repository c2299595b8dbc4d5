"""Fields of structures that are joined to what is no part of their matrices: supports that drive, measured components."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from structid.core.arrays import ComplexArray, FloatArray, IntArray, NumberArray
from structid.forward.frf.channels import Channels, read
from structid.forward.frf.slopes import StiffnessSlopes
from structid.forward.frf.solvers.solver import FrfSolver, LineDerivatives


@dataclass(frozen=True, eq=False)
class SubstructureCoupling:
    """The lines of a model some of whose degrees of freedom are joined to something else; see `Response`.

    What is joined has the receptance Y there, and motions b of its own. The force between the two brings them together: with
    X = Z^-1 (columns), columns b of unit forces at what is joined, and H their readings there, a forces column f gives

        x = X_f - X_b (Y + H_bb)^-1 (H_bf - b).

    A measured component has its own Y and no motion of its own: frequency-based substructuring in its dual form, which needs
    the inverse of neither Y nor H_bb. A support that drives has no Y, and a load at it is its motion, not a force. The same
    holds for the adjoint fields of sensors, so that derivatives are -y' (dZ/dp) x as ever.

    Attributes
    ----------
    free : FrfSolver
        Solver of the model without what is joined.
    slopes : StiffnessSlopes
    channels : Channels
        Loads and sensors; no sensor reads a support that drives.
    joined : (n_dofs, n_joined) sparse array
        Columns of what is joined, supports that drive first.
    receptance : (n_lines, n_joined, n_joined) complex array
        Y, the receptance of what is joined by itself.
    n_driven : int
        Number of supports that drive among the columns of `joined`.

    References
    ----------
    De Klerk, Rixen and Voormeeren (2008), AIAA Journal 46(5), 1169-1181.
    """

    free: FrfSolver
    slopes: StiffnessSlopes
    channels: Channels
    joined: sparse.csc_array
    receptance: ComplexArray
    n_driven: int

    @property
    def is_large(self) -> bool:
        return self.free.is_large

    def fields(
        self, physical: FloatArray, coefficients: ComplexArray, loads: sparse.csc_array | None = None
    ) -> Iterator[tuple[slice, NumberArray]]:
        """Yield the lines and the fields (n, n_dofs, n_loads) of the coupled structure, one block of lines after another.

        `loads` (n_dofs, n_loads) are all columns of the channels by default. `physical` (n_params,) are the parameters,
        `coefficients` (n_lines, n_matrices) the factors of the matrices in Z.
        """
        right, n_joined = self.channels.columns if loads is None else loads, self.joined.shape[1]
        for part, fields, push in self._fields_and_interface_forces(physical, coefficients, right):
            yield part, fields[:, :, n_joined:] - fields[:, :, :n_joined] @ push

    def forces(self, physical: FloatArray, coefficients: ComplexArray) -> ComplexArray:
        """Forces between the model and what is joined, under all columns of the channels, (n_lines, n_joined, n_columns)."""
        return np.concatenate(
            [push for _, _, push in self._fields_and_interface_forces(physical, coefficients, self.channels.columns)]
        )

    def _fields_and_interface_forces(
        self, physical: FloatArray, coefficients: ComplexArray, right: sparse.csc_array
    ) -> Iterator[tuple[slice, NumberArray, NumberArray]]:
        """Yield the lines, the fields of the model alone and the interface forces of one block of lines after another.

        Fields (n, n_dofs, n_joined + n_loads) are under unit interface forces, then under the load columns `right`
        (n_dofs, n_loads); forces are (n, n_joined, n_loads). `physical` (n_params,) are the parameters, `coefficients`
        (n_lines, n_matrices) the factors of the matrices in the dynamic stiffness.
        """
        n_joined = self.joined.shape[1]
        prescribed = np.zeros((n_joined, right.shape[1]))
        prescribed[: self.n_driven] = (self._reader[: self.n_driven] @ right).toarray()
        for part, fields in self.free.fields(physical, coefficients, self._with_interface_forces(right)):
            seen = read(self._reader, fields)
            yield (
                part,
                fields,
                np.linalg.solve(self.receptance[part] + seen[:, :, :n_joined], seen[:, :, n_joined:] - prescribed),
            )

    def readings(self, physical: FloatArray, coefficients: ComplexArray, columns: IntArray) -> ComplexArray:
        """Readings of sensors and contacts under the load columns at `columns`, (n_lines, n_sensors, n_columns).

        `columns` are indices. `physical` (n_params,) are the parameters, `coefficients` (n_lines, n_matrices) those of
        the matrices in Z. Small models solve for all columns, as derivatives do, so that both share cached fields.
        """
        if not self.is_large:
            every = self.fields(physical, coefficients)
            return np.concatenate([self.channels.read(x[:, :, columns]) for _, x in every])
        chosen = sparse.csc_array(self.channels.columns[:, columns])
        return np.concatenate([self.channels.read(x) for _, x in self.fields(physical, coefficients, chosen)])

    def derivatives(self, physical: FloatArray, coefficients: ComplexArray) -> Iterator[LineDerivatives]:
        """Yield the coupled structure's readings and their derivatives, for one block of lines after another.

        A `LineDerivatives` has the lines, the readings of sensors and contacts, their derivatives by the parameters,
        and the readings under unit contact forces. `physical` (n_params,) are the parameters, `coefficients` (n_lines,
        n_matrices) those of the matrices in the dynamic stiffness.
        """
        for part, fields in self.fields(physical, coefficients):
            x, y = self.channels.under_loads(fields), self.channels.under_sensors(fields)
            change = self.slopes.products(physical, -coefficients[part], x, y)
            reach = self.channels.read(y[:, :, self.channels.n_outputs :])
            yield LineDerivatives(part, self.channels.read(x), change, reach)

    @cached_property
    def _reader(self) -> sparse.csr_array:
        return sparse.csr_array(self.joined.T)

    def _with_interface_forces(self, loads: sparse.csc_array) -> sparse.csc_array:
        """Columns of unit forces at the interfaces, then `loads`; cached, so that the same object is returned again."""
        known = self._last.get("last")
        if known is None or known[0] is not loads:
            known = self._last["last"] = loads, sparse.csc_array(sparse.hstack([self.joined, loads]))
        return known[1]

    @cached_property
    def _last(self) -> dict[str, tuple[sparse.csc_array, sparse.csc_array]]:
        return {}
