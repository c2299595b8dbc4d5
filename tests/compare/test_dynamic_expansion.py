"""The dynamic expansion of shapes that are the model's own, at its frequencies: no force acts, so that they come back whole."""

import numpy as np

from structid import Beam, Structure
from structid.compare.mode_correlation import expand
from structid.core.dof import parse_dofs
from structid.dynamics.normal_modes import modes


def test_a_shape_of_the_model_at_its_frequency_is_carried_on_exactly():
    nodes = {k: 0.2 * (k - 1) for k in range(1, 8)}
    beam = Beam("beam", [[k, k + 1] for k in range(1, 7)], mass=3.0, bending_stiffness=500.0)
    structure = Structure(nodes, [beam], ["1Y", "1RZ"])
    mass, stiffness = structure.matrix("mass"), structure.matrix("stiffness")
    model = modes(mass, stiffness)
    sensors = structure.selection(parse_dofs(["3Y", "5Y-", "7Y"]))
    seen, std = np.asarray(sensors.T @ model.mode_shapes[:, :3]), np.array([[0.1], [0.2], [0.3]]) * np.ones(3)
    basis = [[0], [1], [2]]
    found = expand(seen, model.frequency[:3], sensors, model, basis, shape_std=std, dynamic=(mass, stiffness))
    size = np.abs(model.mode_shapes[:, :3]).max()
    np.testing.assert_allclose(found.shapes, model.mode_shapes[:, :3], rtol=0, atol=1e-7 * size)
    np.testing.assert_allclose(np.asarray(sensors.T @ found.std)[[0, 2]], std[[0, 2]], rtol=1e-7)
