"""Where nothing but the measured force says how large all masses and stiffnesses are, that is said."""

from dataclasses import replace

import numpy as np
import pytest

from structid import (
    FrfProblem,
    FrfRecord,
    PointMass,
    Prior,
    RotaryInertia,
    Spring,
    Structure,
    Unknown,
    estimate,
    parameters,
)
from structid.forward import simulated_record
from structid.identification.ratios import scale_from_force

_ALL = (Unknown("mass", "floors", each=True), Unknown("stiffness", "storeys"), Unknown("loss_factor", "storeys"))


@pytest.mark.parametrize(
    ("unknown", "form", "expected"),
    [
        (_ALL, "output", True),
        (_ALL, "log", True),
        ((Unknown("mass", "floors:1"), *_ALL[1:]), "output", False),
        ((_ALL[0], Unknown("stiffness", "storeys", prior=Prior(900.0, 30.0)), _ALL[2]), "output", False),
    ],
)
def test_the_scale_is_that_of_the_force_where_nothing_else_is_known(unknown, form, expected):
    nodes = {i: (float(i), 0.0) for i in range(3)}
    parts = [
        PointMass("floors", [1, 2], 2.0),
        Spring("storeys", ["1X", "2X"], ["0X", "1X"], stiffness=900.0, loss_factor=0.03),
    ]
    structure = Structure(nodes, parts, ["0X"], active=["X"])
    made, lines = parameters(structure, list(unknown)), np.linspace(0.5, 8.0, 60)
    record = simulated_record(
        structure, made, FrfRecord(lines, np.zeros((60, 2, 1), complex), ("1X", "2X"), ("2X",), "receptance")
    )
    record = replace(record, variance=(0.01 * np.abs(record.values)) ** 2)
    problem = FrfProblem(structure, made, record, form)
    found = estimate(problem)
    assert scale_from_force([problem], found) is expected
    if expected:  # a load cell that reads 1 % too much makes all of them 1 % larger
        louder = estimate(FrfProblem(structure, made, replace(record, values=record.values / 1.01), form))
        scaled = np.array(found.kinds) != "loss_factor"
        assert louder.values[scaled] / found.values[scaled] == pytest.approx(1.01, rel=1e-6)


def test_discs_that_turn_are_masses_too():
    parts = [
        RotaryInertia("discs", [1, 2], 2.0, "RX"),
        Spring("shafts", ["1RX", "2RX"], ["0RX", "1RX"], stiffness=900.0, loss_factor=0.03),
    ]
    structure = Structure({i: (float(i),) for i in range(3)}, parts, ["0RX"], active=["RX"])
    lines = np.linspace(0.5, 8.0, 60)
    blank = FrfRecord(lines, np.zeros((60, 2, 1), complex), ("1RX", "2RX"), ("2RX",), "receptance")
    for own, expected in ((["discs:1", "discs:2"], True), (["discs:1"], False)):
        inertias = [Unknown("rotary_inertia", name) for name in own]
        made = parameters(structure, [*inertias, Unknown("stiffness", "shafts")])
        record = simulated_record(structure, made, blank)
        problem = FrfProblem(structure, made, replace(record, variance=(0.01 * np.abs(record.values)) ** 2))
        assert scale_from_force([problem], estimate(problem)) is expected
