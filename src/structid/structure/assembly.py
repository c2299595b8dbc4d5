"""All matrices of a structure on one sparsity pattern, so that a sum of them is a sum of arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from structid.arrays import FloatArray, IntArray
from structid.structure.structure import Structure

BASIC_LAWS = ("inertia", "viscous", "elastic", "structural")


@dataclass(frozen=True, eq=False)
class Assembly:
    """The union pattern of a structure's matrices and the maps from element weights to its entries.

    Attributes
    ----------
    structure : Structure
    laws : tuple of str
        ``inertia viscous elastic structural`` and one ``friction:NAME`` for each friction element.
    indices, indptr : int arrays
        The pattern in compressed columns.
    maps : tuple of (n_entries, n_elements) sparse arrays
        One for each contribution of the structure.
    """

    structure: Structure
    laws: tuple[str, ...]
    indices: IntArray
    indptr: IntArray
    maps: tuple[sparse.csr_array, ...]

    def data(self, values: FloatArray) -> FloatArray:
        """Entries of mass, viscous damping, stiffness and so on, (n_laws, n_entries), in the order of `laws`."""
        rows = np.zeros((len(self.laws), len(self.indices)))
        for part, entries in zip(self.structure.contributions, self.maps, strict=True):
            rows[self.laws.index(part.law)] += entries @ part.weights(values)
        return rows


def structure_laws(structure: Structure) -> tuple[str, ...]:
    """Every law by which matrices of `structure` enter its dynamic stiffness: the basic ones, then each friction."""
    frictions = dict.fromkeys(part.law for part in structure.contributions if part.law not in BASIC_LAWS)
    return (*BASIC_LAWS, *frictions)


def assembly(structure: Structure) -> Assembly:
    """The `Assembly` of `structure`; made once, used for every set of values."""
    n = structure.n_dofs
    families = {id(part.blocks): part.blocks for part in structure.contributions}
    used = [np.arange(n) * (n + 1)]  # the diagonal; then one family's entries in memory at a time
    for blocks in families.values():
        row, column, _, _ = blocks.entries()
        used.append(np.unique(column * n + row))
    pattern = np.unique(np.concatenate(used))
    found: dict[int, sparse.csr_array] = {}
    for key, blocks in families.items():
        row, column, element, value = blocks.entries()
        place = np.searchsorted(pattern, column * n + row)
        found[key] = sparse.coo_array((value, (place, element)), (len(pattern), blocks.n_elements)).tocsr()
    maps = [found[id(part.blocks)] for part in structure.contributions]
    indptr = np.concatenate([[0], np.cumsum(np.bincount(pattern // n, minlength=n))])
    return Assembly(structure, structure_laws(structure), pattern % n, indptr.astype(np.int64), tuple(maps))
