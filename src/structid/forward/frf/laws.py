"""Coefficients of the matrices in the dynamic stiffness at each line."""

from __future__ import annotations

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray


def law_coefficients(laws: tuple[str, ...], laplace: ComplexArray, sliding: dict[str, FloatArray]) -> ComplexArray:
    """Coefficient of each matrix in the dynamic stiffness, (n_frequencies, n_laws): s^2, s, 1, i, i / amplitude.

    `laplace` is s, 1/s: i omega on the axis. Friction with no amplitude in `sliding` gets 0.
    """
    table: dict[str, ComplexArray] = {
        "inertia": laplace**2,
        "viscous": laplace,
        "elastic": np.ones_like(laplace),
        "structural": np.full_like(laplace, 1j),
    }
    table.update({f"friction:{name}": np.asarray(1j / amplitude) for name, amplitude in sliding.items()})
    zero = np.zeros_like(laplace)
    return np.stack([table.get(law, zero) for law in laws], axis=1)
