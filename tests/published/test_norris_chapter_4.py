"""Norris (1986), chapter 4, case 1: twelve parameters of a cantilever from all motions at one frequency."""

from dataclasses import replace

import numpy as np
import pytest

from structid import Beam, FrfProblem, FrfRecord, GaussNewton, Structure, Unknown, parameters
from structid.estimation import minimize
from structid.observation import one_step_values, response

ACTUAL = np.array([0.92, 1.28, 1.17, 0.63, 1.11, 0.98, 1.38, 0.68, 1.24, 0.56, 0.76, 1.12])  # Table 4.1
POSTULATED = np.array([0.90, 1.15, 1.20, 0.50, 1.20, 0.90, 1.30, 0.60, 1.10, 0.50, 0.90, 1.20])
HISTORY = [1.11e-1, 2.98e-2, 3.58e-3, 1.66e-5, 1.7e-10]  # of an independent reproduction
UNKNOWNS = [Unknown(p, "beam", each=True, positive=False) for p in ("mass", "bending_stiffness")]


def cantilever(values, **damping):
    beam = Beam("beam", [[i, i + 1] for i in range(6)], values[:6], values[6:], **damping)
    return Structure({i: float(i) for i in range(7)}, [beam], ["0Y", "0RZ"])


def all_motions(**damping):
    actual = cantilever(ACTUAL, **damping)
    known = parameters(actual, UNKNOWNS)
    record = FrfRecord(np.array([0.5 / (2 * np.pi)]), np.ones((1, 12, 1)), actual.dofs, ("6Y+",), "receptance")
    return replace(record, values=response(actual, known, record).values_at(known.start))


@pytest.mark.parametrize("damping", [{}, {"stiffness_damping": 0.01, "mass_damping": 0.02}, {"loss_factor": 0.02}])
def test_one_step_solve_is_exact_from_any_start(damping):
    record = all_motions(**damping)
    rng = np.random.default_rng(41)
    starts = [POSTULATED, *(ACTUAL * np.exp(rng.uniform(-1.5, 1.5, (20, 12))))]
    for start in starts:
        structure = cantilever(start, **damping)
        found = one_step_values(structure, parameters(structure, UNKNOWNS), record)
        assert np.abs(found / ACTUAL - 1).max() <= 1e-11


def test_classical_iteration_has_the_published_history():
    """RMS of relative errors, two significant digits; Eqs. (4.15)-(4.18) with the postulated motion in B."""
    structure = cantilever(POSTULATED)
    problem = FrfProblem(structure, parameters(structure, UNKNOWNS), all_motions(), "equation")
    found = minimize(problem, GaussNewton(step_control=False, max_iterations=5))
    error = np.sqrt(np.mean((found.history / ACTUAL - 1) ** 2, axis=1))
    assert error[:5] == pytest.approx(HISTORY, rel=2e-2)
    assert error[5] <= 1e-12


def test_eliminated_form_gives_the_step_of_the_arrow_system():
    """Eq. (4.24) as printed (with A = [B, -E], 4.22a corrected), dense, against the weighted step on the sensors."""
    structure = cantilever(POSTULATED)
    made = parameters(structure, UNKNOWNS)
    frequency = np.arange(1, 7) * 0.5 / (2 * np.pi)
    sensors = [0, 4, 7, 10]
    actual = cantilever(ACTUAL)
    record = FrfRecord(frequency, np.ones((6, 12, 1)), actual.dofs, ("6Y+",), "receptance")
    record = replace(record, values=response(actual, parameters(actual, UNKNOWNS), record).values_at(ACTUAL))
    part = record.channels(tuple(record.outputs[i] for i in sensors))
    found = minimize(FrfProblem(structure, made, part, "equation"), GaussNewton(step_control=False, max_iterations=1))
    hidden = [i for i in range(12) if i not in sensors]
    mass, stiffness = structure.matrix("inertia").toarray(), structure.matrix("elastic").toarray()
    load = structure.selection(record.inputs).toarray()[:, 0]
    rows, right = [], []
    for e, omega in enumerate(record.omega):
        z = stiffness - omega**2 * mass
        motion = np.linalg.solve(z, load)
        columns = [
            law * part_.blocks.apply(motion).toarray()
            for part_, law in zip(structure.contributions[:2], (-(omega**2), 1.0), strict=True)
        ]
        row = np.zeros((12, 12 + 6 * len(hidden)))
        row[:, :12] = np.concatenate(columns, axis=1)
        row[:, 12 + e * len(hidden) : 12 + (e + 1) * len(hidden)] = z[:, hidden]  # -E
        rows.append(row)
        right.append(-z[:, sensors] @ (record.values[e, sensors, 0].real - motion[sensors]))
    step = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0][:12]
    assert found.history[1] - found.history[0] == pytest.approx(step, rel=1e-9)
