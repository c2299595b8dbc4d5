"""The simulated twin: exact without noise, noise of the stated size, friction in balance with its own motion."""

import numpy as np
import pytest

from structid import (
    FrfRecord,
    Friction,
    InputError,
    PointMass,
    Spring,
    Structure,
    Unknown,
    parameters,
    simulated_record,
)
from structid.forward.frf.response import response

LIKE = FrfRecord(np.linspace(0.5, 3.0, 40), np.ones((40, 2, 1)), ("1X", "2X"), ("1X",), "receptance")


def chain(friction=0.0, measured_by=()):
    elements = [PointMass("m", [1, 2], 1.0), Spring("k", ["1X", "2X"], ["2X", "3X"], stiffness=100.0, loss_factor=0.05)]
    elements.append(Friction("rail", "1X", friction_force=friction, measured_by=measured_by))
    structure = Structure({1: 0.0, 2: 1.0, 3: 2.0}, elements, ["3X"])
    return structure, parameters(structure, [Unknown("mass", "m")])


def test_friction_is_in_balance_with_the_motion_it_allows():
    """At every line Z(|x|) x = f with |x| the motion itself: friction force i r x/|x| has magnitude r."""
    structure, unknown = chain(0.3)
    record = simulated_record(structure, unknown, LIKE)
    mass, stiffness, loss = (structure.matrix(kind).toarray() for kind in ("mass", "stiffness", "structural_damping"))
    for omega, x in zip(record.omega, record.values[:, :, 0], strict=True):
        force = (stiffness + 1j * loss - omega**2 * mass) @ x + np.array([0.3j * x[0] / abs(x[0]), 0.0])
        assert force == pytest.approx(np.array([1.0, 0.0]), abs=1e-8)


def test_noise_has_the_size_that_the_record_states():
    """800 values: the mean of |error|^2 / variance is 1 within four standard deviations, 0.14."""
    structure, unknown = chain()
    clean = simulated_record(structure, unknown, LIKE)
    ratios = []
    for seed in range(10):
        noisy = simulated_record(structure, unknown, LIKE, 0.03, np.random.default_rng(seed))
        ratios.append(np.mean(np.abs(noisy.values - clean.values) ** 2 / noisy.variance))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.14)


def test_noise_needs_a_generator():
    structure, unknown = chain()
    with pytest.raises(InputError, match="`rng`"):
        simulated_record(structure, unknown, LIKE, 0.01)


def test_a_contact_whose_friction_exceeds_the_drive_sticks():
    """Friction of 1.5 N per N of drive at the driven mass: it moves by no more than 2e-4 of its free motion."""
    free, stuck = (simulated_record(*chain(r), LIKE).values[:, 0, 0] for r in (0.0, 1.5))
    assert (np.abs(stuck) <= 2e-4 * np.abs(free)).all()


def test_measured_amplitude_of_a_simulated_record_gives_the_balance_back():
    structure, unknown = chain(0.3)
    record = simulated_record(structure, unknown, LIKE)
    by_sensor, same = chain(0.3, ["1X"])
    assert response(by_sensor, same, record, measured_sliding=True).values_at(same.start) == pytest.approx(
        record.values, rel=1e-8
    )
