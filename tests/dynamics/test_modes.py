"""Modes against closed forms, and the large-model path against the dense one."""

import numpy as np
import pytest
from scipy import sparse

from structid.dynamics import modes
from structid.structure import Beam, Structure


def test_damping_ratios_of_a_single_mass():
    m, k, c, h = 2.0, 50.0, 0.3, 1.5
    matrices = [sparse.csc_array(np.array([[v]])) for v in (m, k, c, h)]
    found = modes(*matrices)
    omega = np.sqrt(k / m)
    assert found.frequency == pytest.approx([omega / (2 * np.pi)])
    assert found.damping_ratio == pytest.approx([c / (2 * m * omega) + h / (2 * k)])
    assert found.mode_shapes == pytest.approx(np.array([[1 / np.sqrt(m)]]))


def test_motion_without_mass_follows_statically():
    """Two springs in series with no mass between: k/2 in effect."""
    stiffness = sparse.csc_array(np.array([[2.0, -1.0], [-1.0, 1.0]]))
    mass = sparse.csc_array(np.diag([0.0, 1.0]))
    found = modes(mass, stiffness)
    assert 2 * np.pi * found.frequency == pytest.approx([np.sqrt(0.5)])
    assert found.mode_shapes[:, 0] == pytest.approx([0.5, 1.0])


def test_sparse_path_equals_dense_path():
    n = 320  # 640 unknown motions: above the dense limit of 600
    beam = Beam("beam", [[i, i + 1] for i in range(n)], 1.0, 1.0)
    structure = Structure({i: i / n for i in range(n + 1)}, [beam], ["0Y", "0RZ"])
    found = modes(structure.matrix("inertia"), structure.matrix("elastic"), n_modes=4)
    assert 2 * np.pi * found.frequency == pytest.approx([3.516015, 22.03449, 61.69721, 120.9019], rel=1e-5)
    gram = found.mode_shapes.T @ (structure.matrix("inertia") @ found.mode_shapes)
    assert gram == pytest.approx(np.eye(4), abs=1e-8)
