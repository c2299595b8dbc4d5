"""Where a structure is doubtful: parts that float, supports of nothing, and elements that are too long for a mode."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from structid.diagnose.checks.loose_parts import coarse_elements, structure_findings
from structid.diagnose.checks.mesh import mesh_errors
from structid.fem import Beam, Friction, PointMass, RigidLink, RotaryInertia, Spring, Structure

NODES = {n: [float(n), 0.0] for n in range(1, 9)}


def beam(name: str, *nodes: int, stiffness: float = 25.0) -> Beam:
    pairs = list(pairwise(nodes))
    return Beam(name, pairs, mass=0.8, bending_stiffness=stiffness, axial_stiffness=1e5)


def found(elements, fixed=(), ties=(), **more):
    structure = Structure(NODES, elements, fixed, ties, **more)
    return structure_findings(structure, structure.values)


CLAMP = ("1X", "1Y", "1RZ")


def test_a_part_that_floats_is_named_with_its_nodes_and_elements():
    [one] = found([beam("arm", 1, 2, 3), beam("lost", 5, 6, 7)], CLAMP)
    assert one.words.startswith("nothing joins nodes 5, 6, 7 to the rest or supports it")
    assert one.nodes == (5, 6, 7)
    assert {name: rows.tolist() for name, rows in one.elements.items()} == {"lost": [0, 1]}


@pytest.mark.parametrize(
    "more",
    [
        {"fixed": (*CLAMP, "7Y")},
        {"ties": [RigidLink("link", 3, 5)]},
        {"elements": [Spring("joint", ["3Y"], ["5Y"], stiffness=10.0)]},
        {"elements": [Spring("ground", ["6Y"], stiffness=10.0)]},
        {"elements": [Friction("slip", "3Y", "5Y", friction_force=3.0)]},
    ],
    ids=["support", "rigid link", "spring", "spring to ground", "friction"],
)
def test_a_part_that_something_joins_or_holds_is_none(more):
    elements = [beam("arm", 1, 2, 3), beam("other", 5, 6, 7), *more.get("elements", [])]
    assert not found(elements, more.get("fixed", CLAMP), more.get("ties", ()))


def test_of_a_free_structure_the_largest_part_is_the_structure():
    assert not found([beam("arm", 1, 2, 3)])
    [one] = found([beam("arm", 1, 2, 3, 4), beam("lost", 6, 7)])
    assert one.nodes == (6, 7)
    [one] = found([beam("large", 1, 2, 3, 4), beam("held", 6, 7)], ("6X", "6Y", "6RZ"))
    assert one.nodes == (1, 2, 3, 4)


def test_two_bodies_that_turn_on_their_springs_are_held():
    springs = Spring("turn", ["1RZ", "2RZ"], stiffness=10.0)
    discs = RotaryInertia("disc", [1, 2], rotary_inertia=[1.0, 2.0], direction="RZ")
    structure = Structure(NODES, [discs, springs], active=["RZ"])
    assert not structure_findings(structure, structure.values)


def test_a_support_of_nothing_is_named():
    [one] = found([beam("arm", 1, 2, 3), PointMass("tip", [3], mass=0.1)], (*CLAMP, "8Y", "2RX"))
    assert one.words == "node 8 is held, and no element or tie is there: its support does nothing"
    assert one.nodes == (8,)


def test_elements_where_a_mode_bends_that_the_mesh_puts_off():
    """A stiff arm and a soft one of one element each: the first mode bends the soft one."""
    structure = Structure(NODES, [beam("stiff", 1, 2, stiffness=2500.0), beam("soft", 2, 3)], CLAMP)
    mesh = mesh_errors(structure, structure.values, (0.1, 6.0))
    one = coarse_elements(structure, structure.values, mesh)
    assert {name: rows.tolist() for name, rows in one.elements.items()} == {"soft": [0]}
    assert one.words.startswith(mesh.words)
    fine = Structure(NODES, [beam("soft", 1, 2, 3)], CLAMP, subdivide=16)
    assert coarse_elements(fine, fine.values, mesh_errors(fine, fine.values, (0.1, 3.0))) is None


def test_half_of_the_energy_is_in_the_marked_elements():
    """Of a clamped beam in its first mode: energy EI w''^2 / 2 by the textbook shape, elements from the clamp on."""
    nodes = {n: [0.125 * (n - 1), 0.0] for n in range(1, 10)}
    elements = [Beam("arm", [(n, n + 1) for n in range(1, 9)], mass=0.8, bending_stiffness=25.0, axial_stiffness=1e5)]
    structure = Structure(nodes, elements, CLAMP)

    class One:
        words, number, worst = "off", np.array([0]), 0

    marked = coarse_elements(structure, structure.values, One()).elements["arm"]
    x = np.linspace(0.0, 1.0, 8001)
    b = 1.8751040687
    ratio = (np.cosh(b) + np.cos(b)) / (np.sinh(b) + np.sin(b))
    bending = (np.cosh(b * x) + np.cos(b * x) - ratio * (np.sinh(b * x) + np.sin(b * x))) ** 2
    share = np.cumsum(bending) / bending.sum()
    assert marked.tolist() == list(range(int(np.ceil(8 * x[np.searchsorted(share, 0.5)]))))
