"""The three operations of element matrices against a dense textbook construction."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from structid import Blocks, InputError
from structid.fem import MatrixBlocks
from structid.fem.blocks import pattern


def random_family(seed, kind):
    rng = np.random.default_rng(seed)
    n_dofs, n_elements, n_local = 7, 5, 3
    dofs = np.array([rng.choice(n_dofs, n_local, replace=False) for _ in range(n_elements)])
    if kind == "held":
        dofs[1, 2] = dofs[3, 0] = -1
    local = rng.standard_normal((n_elements, n_local, n_local))
    local += np.swapaxes(local, 1, 2)
    dense = np.zeros((n_elements, n_dofs + 1, n_dofs + 1))
    for e in range(n_elements):
        dense[e][np.ix_(dofs[e], dofs[e])] += local[e]
    dense = dense[:, :n_dofs, :n_dofs]  # index -1 went to the extra row
    if kind == "matrices":
        return MatrixBlocks([sparse.csc_array(d) for d in dense]), dense, rng
    return Blocks(dofs, local, n_dofs), dense, rng


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10_000), st.sampled_from(["plain", "held", "matrices"]))
def test_operations_equal_dense_sums(seed, kind):
    family, dense, rng = random_family(seed, kind)
    weights = rng.standard_normal(5)
    x = rng.standard_normal((4, 7, 2)) + 1j * rng.standard_normal((4, 7, 2))
    y = rng.standard_normal((4, 7, 3)) + 1j * rng.standard_normal((4, 7, 3))
    assert family.assemble(weights).toarray() == pytest.approx(np.einsum("e,eij->ij", weights, dense), abs=1e-12)
    both = pattern([family, family.take(np.array([4, 1]))]).summed(np.append(weights, [2.0, -weights[1]]))
    expected = np.einsum("e,eij->ij", weights * [1, 0, 1, 1, 1], dense) + 2 * dense[4]
    assert both.toarray() == pytest.approx(expected, abs=1e-12)
    assert both.nnz == np.count_nonzero(both.toarray())
    expected = np.einsum("fia,eij,fjb->feab", y, dense, x)
    assert family.bilinear(y, x) == pytest.approx(expected, abs=1e-11)
    some = np.array([3, 0])
    assert family.take(some).bilinear(y, x) == pytest.approx(expected[:, some], abs=1e-11)


def test_blocks_refuse_dofs_out_of_range():
    with pytest.raises(InputError, match="`dofs` must lie"):
        Blocks(np.array([[0, 9]]), np.zeros((1, 2, 2)), 3)
