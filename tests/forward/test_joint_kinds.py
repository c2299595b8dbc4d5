"""Time histories and FRFs of one structure in one fit."""

import numpy as np
from time_cases import chain, everything, off, record_of

from structid import FrfProblem, FrfRecord, JointProblem, estimate, simulated_record
from structid.forward import TimeOptions, output_error_problem


def test_time_histories_and_frfs_together_beat_each_alone():
    structure = chain()
    truth, rng = everything(structure), np.random.default_rng(11)
    options = TimeOptions(initial="unknown")
    sensors = [("3X", "acceleration"), ("1X", "acceleration")]
    history = record_of(structure, truth, sensors, n=150, options=options, rng=rng, initial=np.full(6, 0.1))
    like = FrfRecord(np.linspace(0.3, 3.0, 60), np.zeros((60, 1, 1)), ("2X",), ("1X",), "accelerance")
    frf = simulated_record(structure, truth, like, 0.02, rng)
    start = off(truth, 0.03)
    parts = (output_error_problem(structure, start, history, options), FrfProblem(structure, start, frf))
    joint = JointProblem(parts)
    together, *alone = (estimate(problem) for problem in (joint, *parts))
    assert together.names == truth.names
    assert together.status.value == "converged"
    assert np.abs((together.values - truth.start) / together.std_noise).max() < 3.5
    assert all((together.std_noise < other.std_noise).all() for other in alone)
    # each fit loses its parameters and the time fit the six unknowns of its first state besides
    assert together.goodness.degrees_of_freedom == joint.n_data - truth.n_params - 6
    assert np.allclose(joint.unknowns.sizes(truth.start), truth.start)
