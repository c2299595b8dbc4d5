"""Every degree of freedom measured: one linear solve from any start."""

from dataclasses import replace

import numpy as np
import pytest

from structid import Beam, FrfRecord, InputError, Structure, Unknown, parameters
from structid.forward import measures_everything, one_step_values
from structid.forward.frf.response import response

FREQUENCY = np.linspace(0.05, 1.2, 20)


def beam(**damping):
    mass, stiffness = [1.0, 0.9, 1.1, 1.2, 0.8, 1.0], [10.0, 11.0, 9.0, 8.0, 9.5, 10.0]
    elements = [Beam("beam", [[i, i + 1] for i in range(6)], mass, stiffness, **damping)]
    return Structure({i: float(i) for i in range(7)}, elements, ["0Y", "0RZ"])


def simulated(structure, made, load="6Y"):
    blank = np.ones((len(FREQUENCY), structure.n_dofs, 1))
    record = FrfRecord(FREQUENCY, blank, structure.dofs, (load,), "accelerance")
    return replace(record, values=response(structure, made, record).values_at(made.start))


@pytest.mark.parametrize("damping", [{}, {"mass_damping": 0.05, "stiffness_damping": 0.02}, {"loss_factor": 0.03}])
def test_exact_data_give_exact_parameters_from_any_start(damping):
    """Five random starts up to a factor of ten off; rounding of the data times the condition leaves 1e-11."""
    structure = beam(**damping)
    unknowns = [Unknown(p, "beam", each=True) for p in ("mass", "bending_stiffness", *damping)]
    made = parameters(structure, unknowns)
    record = simulated(structure, made)
    rng = np.random.default_rng(11)
    for _ in range(5):
        start = made.started_at(made.start * np.exp(rng.uniform(-2.3, 2.3, made.n_params)))
        found = one_step_values(structure, start, record)
        assert np.abs(found / made.start - 1).max() <= 1e-10


def test_partial_sensors_are_refused():
    structure = beam()
    made = parameters(structure, [Unknown("mass", "beam")])
    record = simulated(structure, made)
    part = record.channels(record.outputs[:5])
    assert measures_everything(structure, record)
    assert not measures_everything(structure, part)
    with pytest.raises(InputError, match="12 free degrees of freedom"):
        one_step_values(structure, made, part)
