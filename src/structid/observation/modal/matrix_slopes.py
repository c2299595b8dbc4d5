"""Derivatives of the matrices of a parametrized structure, seen only through products y' (dA/dp) x."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

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
        values = self.parameters.values(physical)
        for group in self.elements:
            forms = np.moveaxis(group.blocks.bilinear(y, x), 1, -1)
            for member in group.members:
                part = self.structure.contributions[member]
                if part.law in found:
                    slope = weight_slope(part, self.parameters, values)[group.rows]
                    found[part.law] += (slope.T @ forms.reshape(-1, len(group.rows)).T).T.reshape(shape)
        return found


def matrix_slopes(structure: Structure, unknown: Parameters) -> MatrixSlopes:
    """The `MatrixSlopes` of a parametrized structure."""
    return MatrixSlopes(structure, unknown, sensitive_elements(structure, unknown))
