"""The dynamic stiffness of a structure: the coefficients of its matrices, and its derivative with respect to the parameters."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray, NumberArray
from structid.dynamics.receptance import DENSE_UP_TO
from structid.fem import Structure
from structid.fem.assembly import Assembly, assembly, structure_matrix_kinds
from structid.forward.contraction import DenseSlopes, ParameterForces, dense_slopes, parameter_forces
from structid.forward.sensitive import (
    SensitiveElements,
    WeightedParts,
    sensitive_elements,
    slope_value_indices,
    weighted_elements,
)
from structid.unknowns import Parameters


def matrix_coefficients(
    matrix_kinds: tuple[str, ...], laplace: ComplexArray, sliding: dict[str, FloatArray]
) -> ComplexArray:
    """Coefficient of each of `matrix_kinds` in the dynamic stiffness, (n_frequencies, n_matrices), in their order.

    It is s^2 for mass, s for damping, 1 for stiffness, i for structural damping and i / amplitude for friction, whose
    `sliding` amplitude is (n_frequencies,) by element name; 0 without one. `laplace` (n_frequencies,) is s in 1/s.
    """
    table: dict[str, ComplexArray] = {
        "mass": laplace**2,
        "damping": laplace,
        "stiffness": np.ones_like(laplace),
        "structural_damping": np.full_like(laplace, 1j),
    }
    table.update({f"friction:{name}": np.asarray(1j / amplitude) for name, amplitude in sliding.items()})
    zero = np.zeros_like(laplace)
    return np.stack([table.get(matrix_kind, zero) for matrix_kind in matrix_kinds], axis=1)


@dataclass(frozen=True, eq=False)
class StiffnessSlopes:
    """The matrices of a parametrized structure, and how they change.

    Attributes
    ----------
    structure : Structure
    parameters : Parameters
        Only the property values that they give the structure matter.
    """

    structure: Structure
    parameters: Parameters

    @cached_property
    def matrix_kinds(self) -> tuple[str, ...]:
        """Kinds of the matrices of the structure, such as "mass", in the order of the matrix coefficients."""
        return structure_matrix_kinds(self.structure)

    @cached_property
    def assembled(self) -> Assembly:
        """The matrices on one sparsity pattern, for large models."""
        return assembly(self.structure)

    def serves(self, structure: Structure, parameters: Parameters) -> bool:
        """True where these are the derivatives for that structure and parameters, whose priors and starts do not matter."""
        known = self.parameters
        same = known.design is parameters.design and known.offset is parameters.offset
        return same and self.structure is structure

    def parts_at(self, physical: FloatArray, coefficients: ComplexArray) -> tuple[WeightedParts, ComplexArray]:
        """Element matrices with the derivatives of their weights, and the factor of each kind in Z, (n_lines, n_kinds).

        Matrices that enter the dynamic stiffness Z with one factor are of one kind. The element matrices are cached for
        the last parameters.

        Parameters
        ----------
        physical : (n_params,) float array
        coefficients : (n_lines, n_matrices) complex array
            Coefficient of each matrix (s^2 of mass, s of damping, ...) in the dynamic stiffness.
        """
        structure, parameters = self.structure, self.parameters
        key = parameters.values(physical)[self._steering].tobytes()
        weighted = self._parts_cache.get(key)
        if weighted is None:
            weighted = weighted_elements(structure, parameters, self._sensitive, physical)
            self._parts_cache.clear()
            self._parts_cache[key] = weighted
        factors = np.zeros((len(coefficients), len(weighted.uses)), dtype=np.complex128)
        for kind, uses in enumerate(weighted.uses):
            for matrix_kind, scale in uses:
                factors[:, kind] += coefficients[:, self.matrix_kinds.index(matrix_kind)] * scale
        return weighted, factors

    def forces_at(self, physical: FloatArray, coefficients: ComplexArray) -> tuple[ParameterForces, ComplexArray]:
        """Operator for the forces (dZ/dp) x of all parameters, and the factors (n_lines, n_maps) of its maps.

        `physical` (n_params,) are the parameters, `coefficients` (n_lines, n_matrices) those of the matrices in the
        dynamic stiffness Z. The operator is cached as long as the derivatives of the weights stay.
        """
        parts, factors = self.parts_at(physical, coefficients)
        cached = self._forces_cache.get("last")
        if cached is None or (cached[0] is not parts and not cached[0].same_slopes(parts)):
            forces = parameter_forces(parts.parts, self.parameters.n_params, self.structure.n_dofs)
            cached = self._forces_cache["last"] = parts, forces
        return cached[1], factors

    def products(
        self, physical: FloatArray, coefficients: ComplexArray, x: NumberArray, y: NumberArray
    ) -> ComplexArray:
        """Products y' (dZ/dp) x without conjugate, Z the dynamic stiffness, (n_lines, n_y, n_x, n_params).

        Fields are `x` (n_lines, n_dofs, n_x) and `y` (n_lines, n_dofs, n_y). `physical` (n_params,) are the parameters,
        `coefficients` (n_lines, n_matrices) those of the matrices in Z.
        """
        if self.structure.n_dofs <= DENSE_UP_TO:
            return self.dense.at(self.parameters.values(physical)).products(coefficients, x, y)
        forces, factors = self.forces_at(physical, coefficients)
        products = np.empty((len(x), y.shape[2], x.shape[2], self.parameters.n_params), dtype=np.complex128)
        for line, factor in enumerate(factors):
            products[line] = np.transpose(forces.products(factor, x[line], y[line]), (2, 0, 1))
        return products

    @cached_property
    def dense(self) -> DenseSlopes:
        """The derivatives as dense matrices, for small models."""
        return dense_slopes(self.structure, self.matrix_kinds, self.parameters.design)

    @cached_property
    def _sensitive(self) -> tuple[SensitiveElements, ...]:
        return sensitive_elements(self.structure, self.parameters)

    @cached_property
    def _steering(self) -> IntArray:
        return slope_value_indices(self.structure, self.parameters, self._sensitive)

    @cached_property
    def _parts_cache(self) -> dict[bytes, WeightedParts]:
        """The last `WeightedParts`, by the values that they depend on."""
        return {}

    @cached_property
    def _forces_cache(self) -> dict[str, tuple[WeightedParts, ParameterForces]]:
        """The last `ParameterForces`, and the weights that they were made for."""
        return {}
