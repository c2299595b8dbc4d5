"""Sensitivities of small models from all fields at once, family after family of element matrices."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from structid.arrays import ComplexArray, FloatArray
from structid.observation.sensitive import SensitiveElements, weight_slope
from structid.structure import Structure
from structid.unknowns import Parameters

_CHUNK_BYTES = 48_000_000


@dataclass(frozen=True, eq=False)
class BlockSensitivity:
    """-y' (dZ/dp) x of a parametrized structure, for all lines of fields x and y."""

    structure: Structure
    laws: tuple[str, ...]
    parameters: Parameters
    sensitive: tuple[SensitiveElements, ...]

    def at(self, weights: FloatArray, coefficients: ComplexArray, x: ComplexArray, y: ComplexArray) -> ComplexArray:
        """The derivative (n_frequencies, n_y, n_x, n_params) where the elements have these `weights`."""
        derivative = np.zeros((x.shape[0], y.shape[2], x.shape[2], self.parameters.n_params), dtype=np.complex128)
        for group in self.sensitive:
            self._add_group(derivative, group, weights, coefficients, x, y)
        return derivative

    def _add_group(
        self,
        derivative: ComplexArray,
        group: SensitiveElements,
        weights: FloatArray,
        coefficients: ComplexArray,
        x: ComplexArray,
        y: ComplexArray,
    ) -> None:
        """Subtract y' (dZ/dp) x of one family of element matrices, in stretches of lines that fit in memory."""
        contributions = self.structure.contributions
        slopes = [(contributions[m], self._slope(m, group, weights)) for m in group.members]
        n_lines, _, n_inputs = x.shape
        n_outputs = y.shape[2]
        per_line = 16 * len(group.rows) * (n_outputs + 2 * n_inputs) * 12
        step = max(1, _CHUNK_BYTES // per_line)
        for first in range(0, n_lines, step):
            part = slice(first, min(first + step, n_lines))
            forms = group.blocks.bilinear(y[part], x[part])
            flat = np.moveaxis(forms, 1, -1).reshape(-1, len(group.rows))
            for contribution, slope in slopes:
                law = self.laws.index(contribution.law)
                change = (slope.T @ flat.T).T.reshape(-1, n_outputs, n_inputs, slope.shape[1])
                derivative[part] -= coefficients[part, law, None, None, None] * change

    def _slope(self, member: int, group: SensitiveElements, weights: FloatArray) -> sparse.csr_array:
        """`weight_slope` of a contribution, kept where it does not depend on the values."""
        part = self.structure.contributions[member]
        if part.is_product:
            return weight_slope(part, self.parameters, weights)[group.rows]
        if member not in self._fixed_slopes:
            self._fixed_slopes[member] = weight_slope(part, self.parameters, weights)[group.rows]
        return self._fixed_slopes[member]

    @cached_property
    def _fixed_slopes(self) -> dict[int, sparse.csr_array]:
        """Of contributions whose weights are linear in the parameters, filled as they are asked for."""
        return {}
