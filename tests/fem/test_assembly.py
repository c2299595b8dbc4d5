"""Assembled entries against sums of the element matrices, whatever their kind."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

import structid as sid
from structid.fem.assembly import assembly
from structid.fem.blocks import index_kind

sys.path.insert(0, str(Path(__file__).parents[1]))
from mesh_cases import solid

LAWS = ("mass", "damping", "stiffness", "structural_damping")


def frame():
    """Beams whose matrices have many zeros, springs to the ground, a rigid link and a point mass."""
    beam = sid.Beam("beam", [[i, i + 1] for i in range(6)], 2.0, 5.0)
    spring = sid.Spring("spring", ["3Y", "5Y"], stiffness=[40.0, 60.0], loss_factor=0.05)
    damper = sid.Dashpot("damper", "4Y", viscous_damping=0.3)
    mass = sid.PointMass("tip", 7, 0.5)
    nodes = {i: (float(i), 0.0) for i in range(7)} | {7: (6.0, 0.4)}
    return sid.Structure(nodes, [beam, spring, damper, mass], ["0Y", "0RZ"], [sid.RigidLink("link", 6, 7)])


def groups():
    rng = np.random.default_rng(1)
    full = rng.standard_normal((5, 5))
    sparse_one = np.diag([1.0, 0, 2.0, 0, 3.0])
    matrices = {"a": {"mass": np.eye(5), "stiffness": full @ full.T}, "b": {"stiffness": sparse_one}}
    return sid.from_matrices(matrices, [f"{i}X" for i in range(1, 6)])


CASES = {
    "plate": lambda: solid((5, 3), (2.0, 1.0), 2),
    "block": lambda: solid((3, 2, 2), (1.0, 1.0, 1.0), 3),
    "frame": frame,
    "groups": groups,
}


@pytest.mark.parametrize("name", list(CASES))
def test_entries_of_every_law_equal_the_sum_of_element_matrices(name):
    structure = CASES[name]()
    at, n = assembly(structure), structure.n_dofs
    values = structure.values * np.random.default_rng(0).uniform(0.5, 2.0, len(structure.values))
    for law, row in zip(at.matrix_kinds, at.data(values), strict=True):
        own = sparse.csc_array((row, at.indices, at.indptr), (n, n)).toarray()
        exact = structure.matrix(law, values).toarray() if law in LAWS else 0.0
        assert own == pytest.approx(exact, rel=1e-13, abs=1e-13 * np.abs(own).max(initial=0.0))
    dense = structure.dense_matrices(LAWS, values)
    assert np.array_equal(dense, [structure.matrix(law, values).toarray() for law in LAWS])


@pytest.mark.parametrize("name", list(CASES))
def test_pattern_has_narrow_indices_sorted_rows_and_the_diagonal(name):
    structure = CASES[name]()
    at, n = assembly(structure), structure.n_dofs
    assert at.indices.dtype == at.indptr.dtype == np.int32
    columns = np.repeat(np.arange(n), np.diff(at.indptr))
    assert (np.diff(columns.astype(np.int64) * n + at.indices) > 0).all()
    assert (at.indices == columns).sum() == n
    marked = sparse.csc_array((np.ones(len(at.indices)), at.indices, at.indptr), (n, n))
    assert abs(marked - marked.T).max() == 0


def test_zeros_of_sparse_element_matrices_are_no_entries():
    """The consistent mass of a beam couples nothing along it, and no spring fills what it does not join."""
    structure = frame()
    at = assembly(structure)
    used = {(i, i) for i in range(structure.n_dofs)}
    for part in structure.contributions:
        row, column, _, _ = part.blocks.entries()
        used |= set(zip(row.tolist(), column.tolist(), strict=True))
    assert len(at.indices) == len(used)


def test_full_element_matrices_are_not_copied():
    structure = solid((6, 2, 2), (1.0, 1.0, 1.0), 3)  # the first of three groups has degrees of freedom that are held
    shared = {
        part.matrix_kind: np.shares_memory(entries.data, part.blocks.local)
        for part, entries in zip(structure.contributions, assembly(structure).maps, strict=True)
        if part.blocks.dofs.min() >= 0
    }
    assert shared == {"mass": False, "stiffness": True, "structural_damping": True}  # mass has zeros between directions


def test_indices_widen_where_they_must():
    assert index_kind(2**31 - 1) is np.int32
    assert index_kind(2**31) is np.int64
