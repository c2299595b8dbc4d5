"""Derivatives of the matrices of a parametrized structure, seen only through products y' (dA/dp) x."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from structid.arrays import FloatArray
from structid.observation.sensitive import SensitiveElements, sensitive_elements, weight_slope
from structid.structure import Structure
from structid.unknowns import Parameters


@dataclass(frozen=True, eq=False)
class MatrixSlopes:
    """Products y' (dA/dp) x with the derivatives of mass, damping and stiffness; made by `matrix_slopes`."""

    structure: Structure
    parameters: Parameters
    elements: tuple[SensitiveElements, ...]

    def products(
        self, physical: FloatArray, laws: Iterable[str], y: FloatArray, x: FloatArray
    ) -> dict[str, FloatArray]:
        """y' (dA/dp) x for the matrix A of each law.

        Parameters
        ----------
        physical : (n_params,) float array
        laws : iterable of {"inertia", "viscous", "elastic", "structural"}
        y : (n, n_dofs, n_y) float array
        x : (n, n_dofs, n_x) float array

        Returns
        -------
        dict of str to (n, n_y, n_x, n_params) float array
        """
        shape = (x.shape[0], y.shape[2], x.shape[2], self.parameters.n_params)
        found: dict[str, FloatArray] = {law: np.zeros(shape) for law in laws}
        weights = self._weight_slopes(physical)
        for number, group in enumerate(self.elements):
            forms = np.moveaxis(group.blocks.bilinear(y, x), 1, -1)
            for member in group.members:
                law = self.structure.contributions[member].law
                if law in found:
                    slope = weights[number, member]
                    found[law] += (slope.T @ forms.reshape(-1, len(group.rows)).T).T.reshape(shape)
        return found

    def _weight_slopes(self, physical: FloatArray) -> dict[tuple[int, int], sparse.csr_array]:
        """How the weights of each group's members change, by group and member: found once at each point, for all modes."""
        key = physical.tobytes()
        if key not in self._latest:
            values = self.parameters.values(physical)
            found = {
                (number, member): weight_slope(self.structure.contributions[member], self.parameters, values)[
                    group.rows
                ]
                for number, group in enumerate(self.elements)
                for member in group.members
            }
            self._latest.clear()
            self._latest[key] = found
        return self._latest[key]

    @cached_property
    def _latest(self) -> dict[bytes, dict[tuple[int, int], sparse.csr_array]]:
        """Slopes of the last point."""
        return {}


def matrix_slopes(structure: Structure, unknown: Parameters) -> MatrixSlopes:
    """The `MatrixSlopes` of a parametrized structure."""
    return MatrixSlopes(structure, unknown, sensitive_elements(structure, unknown))
