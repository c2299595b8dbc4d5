"""Output error from initial values far off: posterior linearization finds what short stages and random starts miss."""

import numpy as np
import pytest
from time_cases import off, record_of

from structid import Beam, Status, Structure, Unknown, parameters
from structid.observation import TimeOptions
from structid.observation.time import output_error_search
from structid.observation.time.identify_time import identify_time

N_ELEMENTS = 4


def beam(seed):
    """A free beam, every mass and stiffness unknown, 30 % off, from accelerations of its translations, 2 % noise."""
    rng = np.random.default_rng(seed)
    nodes = {i + 1: float(i) for i in range(N_ELEMENTS + 1)}
    pairs = [[i, i + 1] for i in range(1, N_ELEMENTS + 1)]
    mass, stiffness = rng.uniform(1, 8, N_ELEMENTS), rng.uniform(1, 8, N_ELEMENTS)
    structure = Structure(nodes, [Beam("beam", pairs, mass, stiffness)])
    unknown = parameters(structure, [Unknown(kind, "beam", each=True) for kind in ("mass", "bending_stiffness")])
    sensors = [(f"{i}Y", "acceleration") for i in nodes]
    return structure, unknown, record_of(structure, unknown, sensors, 40, 2.0, loads=("3Y",), seed=seed, rng=rng)


@pytest.mark.parametrize("seed", [0, 3])
def test_where_the_first_starts_end_at_wrong_minima_the_answer_is_found(seed):
    structure, unknown, record = beam(seed)
    start = off(unknown, 0.3, seed)
    assert identify_time(structure, start, record, TimeOptions(restarts=0)).chi_square_per_dof > 5
    found = identify_time(structure, start, record)
    assert found.status is Status.CONVERGED
    assert found.chi_square_per_dof < 1.1
    assert (np.abs(found.values - unknown.start) < 4 * found.std).all()
    assert found.n_starts == 4  # the given one, two at random, and this


def test_a_start_that_fits_does_not_pay_for_it(monkeypatch):
    def never(*_):
        raise AssertionError("posterior linearization of a record that is fitted")

    monkeypatch.setattr(output_error_search, "posterior_linearized", never)
    structure, unknown, record = beam(0)
    assert identify_time(structure, off(unknown, 0.05), record).n_starts == 1
