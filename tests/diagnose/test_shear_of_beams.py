"""Which beams may shear: those of every plane in which they bend and have no shear yet, from guesses over two decades."""

import numpy as np
import pytest

import structid as sid
from structid.diagnose.causes import ShearFlexibility


def grid(**more):
    nodes = {1: [0.0, 0.0, 0.0], 2: [0.5, 0.0, 0.0], 3: [1.0, 0.0, 0.0], 4: [0.5, 0.5, 0.0]}
    known = {"mass": 2.0, "axial_stiffness": 1e6, "polar_inertia": 1e-3, "torsional_stiffness": 50.0}
    long = sid.SpaceBeam(
        "long", [[1, 2], [2, 3]], bending_stiffness_y=300.0, bending_stiffness_z=200.0, **known, **more
    )
    cross = sid.SpaceBeam("cross", [[2, 4]], bending_stiffness_y=100.0, bending_stiffness_z=200.0, **known)
    return sid.Structure(nodes, [long, cross], ["1Z", "1RX", "1RY"], active=["Z", "RX", "RY"])


def test_beams_of_a_grid_shear_where_they_bend():
    found = list(ShearFlexibility.of_structure(grid()))
    assert [(one.where, one.property_name) for one in found] == [
        (("long", "cross"), "shear_stiffness_z"),
        (("long",), "shear_stiffness_z"),
        (("cross",), "shear_stiffness_z"),
    ]
    assert found[1].strengths == pytest.approx(300.0 / (0.02 * 1.0) * np.array([1.0, 10.0, 100.0]))


def test_a_set_that_shears_is_no_candidate():
    assert [one.where for one in ShearFlexibility.of_structure(grid(shear_stiffness_z=1e5))] == [("cross",)]


def test_the_suggestion_frees_the_shear_of_that_plane():
    tables = {"structure": {"space_beam": [{"name": "long"}, {"name": "cross"}]}, "unknown": []}
    cause = ShearFlexibility(where=("long", "cross"), property_name="shear_stiffness_z")
    for one in cause.edits(None, 2e4):
        one.write(tables)
    assert [entry["shear_stiffness_z"] for entry in tables["structure"]["space_beam"]] == [2e4, 2e4]
    assert tables["unknown"][-1]["property"] == "shear_stiffness_z"
    assert tables["unknown"][-1]["elements"] == ["long", "cross"]
