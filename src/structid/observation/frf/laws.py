"""How matrices enter the dynamic stiffness at each line, and which of several load columns are alike."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from structid.arrays import ComplexArray, FloatArray


def law_coefficients(laws: tuple[str, ...], laplace: ComplexArray, sliding: dict[str, FloatArray]) -> ComplexArray:
    """How each law enters the dynamic stiffness, (n_frequencies, n_laws): s^2, s, 1, i, i / amplitude.

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


def distinct_columns(columns: sparse.csc_array) -> tuple[sparse.csc_array, list[tuple[int, float]]]:
    """The columns that differ by more than their sign, and for each given column its place among them and its sign."""
    kept: dict[tuple[bytes, bytes], int] = {}
    first, places = [], []
    for j in range(columns.shape[1]):
        part = slice(columns.indptr[j], columns.indptr[j + 1])
        index, value = columns.indices[part], columns.data[part]
        order = np.argsort(index)
        index, value = index[order].astype(np.int64), value[order]
        sign = 1.0 if not value.size or value[0] > 0 else -1.0
        key = (index.tobytes(), (sign * value).tobytes())
        if key not in kept:
            kept[key] = len(kept)
            first.append((j, sign))
        places.append((kept[key], sign))
    unique = columns[:, [j for j, _ in first]] @ sparse.diags_array([s for _, s in first])
    return sparse.csc_array(unique), places
