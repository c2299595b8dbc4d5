"""Sums over poles against dense solutions, and histories against a transient that is exact."""

import numpy as np
import pytest

import structid as sid
from structid.dynamics import sampled_transient
from structid.prediction.poles import Sides, reduce_structure, reduction_basis, simulate_history, sum_over_poles

OUTPUTS, INPUTS = ("10Y", "3Y", "7RZ"), ("10Y", "4Y")


def make_beam(fixed=(), **damping):
    beam = sid.Beam("beam", [[i, i + 1] for i in range(10)], mass=2.0, bending_stiffness=50.0, loss_factor=0.02)
    parts = [beam, *([sid.Dashpot("dashpot", "5Y", viscous_damping=0.8)] if fixed else [])]
    return sid.Structure({i: 0.2 * i for i in range(11)}, parts, fixed=fixed, **damping)


def sides_of(structure):
    return Sides(*(structure.selection([sid.parse_dof(d) for d in dofs]) for dofs in (OUTPUTS, INPUTS)))


def dense_receptance(structure, frequency):
    kinds = ("mass", "damping", "stiffness", "structural_damping")
    m, c, k, h = (structure.matrix(kind).toarray() for kind in kinds)
    out, into = (side.toarray() for side in (sides_of(structure).outputs, sides_of(structure).inputs))
    w = 2 * np.pi * frequency
    return np.stack([out.T @ np.linalg.solve(k + 1j * h + 1j * x * c - x**2 * m, into) for x in w])


@pytest.mark.parametrize(("fixed", "ratio"), [(("0Y", "0RZ"), None), ((), None), (("0Y", "0RZ"), 0.03)])
def test_receptance_is_that_of_all_degrees_of_freedom(fixed, ratio):
    structure = make_beam(fixed, damping_ratio=ratio)
    frequency, sides = np.linspace(0.5, 60, 300), sides_of(structure)
    basis = reduction_basis(structure, [structure.values], sides, 0.5, 60.0)
    found = sum_over_poles(reduce_structure(structure, structure.values, basis, sides)).frf(frequency)
    exact = dense_receptance(structure, frequency)
    assert np.abs(found - exact).max() < 2e-5 * np.abs(exact).max()


def test_a_basis_of_two_models_serves_both():
    structure = make_beam(("0Y", "0RZ"))
    frequency, sides = np.linspace(0.5, 60, 300), sides_of(structure)
    changed = sid.Structure(
        structure.nodes, [sid.Beam("beam", [[i, i + 1] for i in range(10)], mass=2.0, bending_stiffness=40.0, loss_factor=0.02)],
        fixed=("0Y", "0RZ"),
    )  # fmt: skip
    values = np.array(structure.values)
    stiffness = next(p.values for p in structure.properties if p.label == "bending_stiffness[beam]")
    values[stiffness] *= 0.8
    dashpot = next(p.values for p in structure.properties if p.label == "viscous_damping[dashpot]")
    values[dashpot] = 0.0
    basis = reduction_basis(structure, [structure.values, values], sides, 0.5, 60.0)
    found = sum_over_poles(reduce_structure(structure, values, basis, sides)).frf(frequency)
    exact = dense_receptance(changed, frequency)
    assert np.abs(found - exact).max() < 1e-4 * np.abs(exact).max()


@pytest.mark.parametrize("fixed", [("0Y", "0RZ"), ()], ids=["clamped", "free"])
@pytest.mark.parametrize("derivatives", [0, 1, 2])
def test_histories_are_exact_for_straight_loads(fixed, derivatives):
    structure = make_beam(fixed)
    sides = sides_of(structure)
    basis = reduction_basis(structure, [structure.values], sides, 1.0, 5000.0)  # all modes
    reduced = reduce_structure(structure, structure.values, basis, sides)
    loads = 0.1 * np.random.default_rng(0).standard_normal((400, 2)).cumsum(axis=0)
    m, c, k = (structure.matrix(kind).toarray() for kind in ("mass", "damping", "stiffness"))
    exact = sampled_transient(m, k, sides.inputs.toarray(), loads, 400.0, c)
    exact = (exact.displacement, exact.velocity, exact.acceleration)[derivatives] @ sides.outputs.toarray()
    found = simulate_history(sum_over_poles(reduced, reduced.damping).combined([derivatives]), loads, 400.0, loads)
    assert np.abs(found - exact).max() < 1e-6 * np.abs(exact).max()
