"""The methods of chapters 3 and 4 on structures that are not the dissertation's: a membrane with a hole, a space frame."""

from dataclasses import replace

import numpy as np
import pytest

from structid import (
    FrfProblem,
    FrfRecord,
    GaussNewton,
    Membrane,
    Motion,
    PointMass,
    SpaceBeam,
    Structure,
    Unknown,
    identify,
    identify_motion,
    parameters,
    sampled_transient,
    simulated_record,
    with_declared_noise,
)
from structid.forward import one_step_values
from structid.forward.frf.response import response
from structid.inversion import minimize


def membrane_with_a_hole(n=6):
    """A square of n by n cells without the middle four, held at its rim; mass and tension differ by rows of cells."""
    nodes = {(n + 1) * j + i + 1: (i / n, j / n) for j in range(n + 1) for i in range(n + 1)}
    hole = {(i, j) for i in (n // 2 - 1, n // 2) for j in (n // 2 - 1, n // 2)}
    rows: dict[int, list[list[int]]] = {}
    for j in range(n):
        for i in range(n):
            if (i, j) not in hole:
                a = (n + 1) * j + i + 1
                rows.setdefault(j // 2, []).extend([[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]])
    sets = [Membrane(f"row {j}", t, 0.3 + 0.1 * j, 40.0 - 5.0 * j, mass_damping=0.2) for j, t in rows.items()]
    used = {k for triangles in rows.values() for t in triangles for k in t}
    rim = [f"{k}Z" for k in sorted(used) if {0.0, 1.0} & set(nodes[k])]
    structure = Structure({k: nodes[k] for k in sorted(used)}, sets, rim)
    return structure, [Unknown(p, s.name) for s in sets for p in ("mass", "tension")]


def space_frame():
    """Four clamped columns and four beams with masses at the corners."""
    feet = {1: (0, 0, 0), 2: (4, 0, 0), 3: (4, 5, 0), 4: (0, 5, 0)}
    nodes = feet | {i + 4: (*p[:2], 3.0) for i, p in feet.items()}
    given = {"axial_stiffness": 1e7, "torsional_stiffness": 8e4, "polar_inertia": 2.0, "mass_damping": 4.0}
    columns = SpaceBeam("columns", [[i, i + 4] for i in range(1, 5)], 20.0, 2e5, 3e5, **given)
    beams = SpaceBeam("beams", [[5, 6], [6, 7], [7, 8], [8, 5]], 15.0, 1e5, 2e5, **given)
    lumps = PointMass("lumps", [5, 6, 7], [300.0, 200.0, 100.0])
    fixed = [f"{i}{d}" for i in feet for d in ("X", "Y", "Z", "RX", "RY", "RZ")]
    structure = Structure(nodes, [columns, beams, lumps], fixed)
    unknowns = [Unknown("mass", "lumps", each=True), Unknown("mass", "columns"), Unknown("mass", "beams")]
    unknowns += [Unknown(f"bending_stiffness_{a}", s) for s in ("columns", "beams") for a in "yz"]
    return structure, unknowns


CASES = {
    "membrane with a hole": (membrane_with_a_hole, (0.5, 12.0), ("17Z", "20Z", "33Z"), "17Z"),
    "space frame": (space_frame, (0.5, 12.0), ("5X", "6Y", "7X", "8Y"), "5X"),
}


@pytest.mark.parametrize("case", CASES)
def test_chapter_3_identifies_it_from_its_motion(case):
    structure, unknowns = CASES[case][0]()
    truth = parameters(structure, unknowns)
    rng = np.random.default_rng(6)
    where = np.eye(structure.n_dofs)[:, [0, structure.n_dofs // 2]]
    signals = 100.0 * rng.standard_normal((80, 2))
    matrices = [structure.matrix(kind) for kind in ("mass", "stiffness", "damping")]
    moved = sampled_transient(*matrices[:2], where, signals, 100.0, matrices[2])
    motion = Motion(moved.time, signals @ where.T, moved.acceleration, moved.velocity, moved.displacement)
    found = identify_motion(structure, truth, motion)
    assert np.abs(found.values / truth.start - 1).max() <= 1e-9


@pytest.mark.parametrize("case", CASES)
def test_chapter_4_identifies_it_from_all_motions_and_from_a_few(case):
    make, band, sensors, load = CASES[case]
    structure, unknowns = make()
    truth = parameters(structure, unknowns)
    lines = np.linspace(*band, 60)
    full = FrfRecord(lines, np.ones((60, structure.n_dofs, 1)), structure.dofs, (load,), "receptance")
    full = replace(full, values=response(structure, truth, full).values_at(truth.start))
    start = truth.started_at(truth.start * np.exp(0.1 * np.random.default_rng(4).standard_normal(truth.n_params)))
    assert np.abs(one_step_values(structure, start, full) / truth.start - 1).max() <= 1e-9

    like = FrfRecord(lines, np.ones((60, len(sensors), 1)), sensors, (load,), "accelerance")
    few = with_declared_noise(simulated_record(structure, truth, like), relative=0.01)
    assert np.abs(identify(structure, start, few).estimate.values / truth.start - 1).max() <= 1e-9


def test_classical_iteration_converges_on_the_membrane_from_near():
    structure, unknowns = membrane_with_a_hole()
    truth = parameters(structure, [replace(u, positive=False) for u in unknowns])
    full = FrfRecord(np.array([0.6, 1.1]), np.ones((2, structure.n_dofs, 1)), structure.dofs, ("17Z",), "receptance")
    full = replace(full, values=response(structure, truth, full).values_at(truth.start))
    start = truth.started_at(truth.start * np.linspace(0.97, 1.03, truth.n_params))
    found = minimize(FrfProblem(structure, start, full, "equation"), GaussNewton(step_control=False, max_iterations=8))
    error = np.abs(found.history / truth.start - 1).max(axis=1)
    assert error[0] == pytest.approx(0.03)
    assert error[-1] <= 1e-9
