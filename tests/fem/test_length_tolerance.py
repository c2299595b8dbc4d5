"""Lengths of bars and beams with a tolerance: a common factor on them against the structure drawn longer."""

import numpy as np
import pytest

import structid as sid
from structid.core.errors import InputError
from structid.identification.record_fit import structure_modes
from structid.unknowns.tolerances import Tolerances, fixed_properties

STEP = 1e-4


def rod(stretch=1.0, pieces=1, tolerance=None, sliding=()) -> sid.Structure:
    """A rod in tension of two elements, held by springs against rotation, and a stay from its middle."""
    half = 1.5 * stretch
    nodes = {0: [0.0, 0.0], 1: [half, 0.0], 2: [2 * half, 0.0], 3: [half, -2.0]}
    sets = [
        sid.Beam("rod", [[0, 1], [1, 2]], 3.5, 3e3, axial_force=2e4, tolerance=tolerance),
        sid.Spring("hold", ["0RZ", "2RZ"], stiffness=6e3),
        sid.Bar("stay", [[1, 3]], mass=0.5, axial_stiffness=4e5),
    ]
    return sid.Structure(
        nodes, sets, fixed=["0Y", "2Y", "3X", "3Y"], active=["Y", "RZ"], subdivide=pieces, sliding=sliding
    )


@pytest.mark.parametrize("pieces", [1, 4])
def test_a_factor_on_the_lengths_is_the_rod_drawn_longer(pieces):
    structure = rod(pieces=pieces, tolerance={"length": 0.005})
    [index] = [p.values.start for p in structure.properties if p.term.property == "length"]
    values = np.array(structure.values)
    assert values[index] == 1.0
    plain = rod(pieces=pieces)
    np.testing.assert_allclose(
        structure_modes(structure, values, 5).frequency, structure_modes(plain, plain.values, 5).frequency, rtol=1e-9
    )
    values[index] = 1 + STEP
    longer = rod(1 + STEP, pieces)
    stretched = structure_modes(structure, values, 5).frequency
    np.testing.assert_allclose(stretched, structure_modes(longer, longer.values, 5).frequency, rtol=1e-9)
    assert (np.abs(stretched / structure_modes(plain, plain.values, 5).frequency - 1) > 0.5 * STEP).any()
    assert structure.mass_of(values, "Y") == pytest.approx(longer.mass_of(longer.values, "Y"))


def test_its_tolerance_is_that_of_a_fixed_value_and_a_number_states_none():
    unknown = [sid.Unknown("axial_force", "rod")]
    stated = rod(tolerance={"length": 0.005})
    [length] = [
        p for p in fixed_properties(stated, sid.parameters(stated, unknown), Tolerances()) if p.kind == "length"
    ]
    assert (length.label, length.tolerance) == ("length[rod]", 0.005)
    for tolerance in (None, 0.02, {"mass": 0.01}, {"length": 0.0}):
        assert "length" not in {item.term.property for item in rod(tolerance=tolerance).properties}
    with pytest.raises(InputError, match="`tolerance` of 'hold' must name its properties, got 'length'"):
        sid.Spring("hold", ["0RZ"], stiffness=1.0, tolerance={"length": 0.01})
    shearing = sid.Beam("b", [[0, 1]], 1.0, 1.0, shear_stiffness=5.0, tolerance={"length": 0.01})
    with pytest.raises(InputError, match="shear"):
        _ = sid.Structure({0: 0.0, 1: 1.0}, [shearing], fixed=["0Y", "0RZ"]).properties


def test_a_length_and_the_place_of_a_node_go_together():
    parts = [
        sid.Beam("rod", [[0, 1], [1, 2]], [3.0, 5.0], 3e3, tolerance={"length": 0.005}),
        sid.Spring("hold", ["0RZ"], stiffness=1.0),
    ]
    structure = sid.Structure({0: 0.0, 1: 1.5, 2: 3.0}, parts, fixed=["0Y", "2Y"], sliding=[1])
    values = np.array(structure.values)
    index = {item.term.property: item.values.start for item in structure.properties}
    values[index["length"]], values[index["position"]] = 1 + STEP, 1.6
    mass = 3.0 * (1.6 + 1.5 * STEP) + 5.0 * (1.4 + 1.5 * STEP)
    assert structure.mass_of(values, "Y") == pytest.approx(mass, rel=1e-12)
