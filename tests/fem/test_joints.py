"""Flexible joints: textbook beams with springs at their ends, and what cannot be a joint."""

import numpy as np
import pytest
from scipy.optimize import brentq

from structid import (
    Bar,
    Beam,
    Constraint,
    InputError,
    Joint,
    PlanOptions,
    PointMass,
    SpaceBeam,
    Spring,
    Structure,
    TimeRecord,
    Unknown,
    parameters,
    parse_dof,
)
from structid.dynamics.normal_modes import modes
from structid.forward.motion.motion import recorded_motion
from structid.planning.plan import resolve_options

N, EI = 20, 7.0
NODES = {i: i / N for i in range(N + 1)}
BEAM = Beam("girder", [[i, i + 1] for i in range(N)], 3.0, EI)


def frequencies(structure: Structure, n: int = 3) -> np.ndarray:
    return 2 * np.pi * modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=n).frequency


def test_a_yielding_clamp_has_the_textbook_frequencies():
    """Held by a rotational spring k, simply supported at the other end: (k L / EI)(tanh b - tan b) = 2 b tan b tanh b.

    Blevins (1979), Formulas for Natural Frequency and Mode Shape, chapter 8; cubics are off by (b h)^4 / 1440 = 4e-5.
    """
    k = 5.0 * EI

    def equation(b: float) -> float:
        return k / EI * (np.tanh(b) * np.cos(b) - np.sin(b)) - 2 * b * np.sin(b) * np.tanh(b)

    grid = np.linspace(0.1, 11.0, 400)
    signs = np.sign([equation(b) for b in grid])
    roots = [brentq(equation, *grid[i : i + 2]) for i in np.flatnonzero(np.diff(signs))]
    structure = Structure(NODES, [BEAM, Joint("clamp", "girder:1", "0RZ", k)], ["0Y", "0RZ", f"{N}Y"])
    assert frequencies(structure) == pytest.approx(np.square(roots[:3]) * np.sqrt(EI / 3.0), rel=5e-5)


def test_a_joint_in_the_span_is_a_hinge_with_a_spring():
    """Deflection at the middle of a simply supported beam: P L^3 / 48 EI + P L^2 / 16 k, by the unit load theorem."""
    middle, k = N // 2, 4.0
    structure = Structure(NODES, [BEAM, Joint("hinge", f"girder:{middle}", f"{middle}RZ", k)], ["0Y", f"{N}Y"])
    force = structure.selection([parse_dof(f"{middle}Y")]).toarray()[:, 0]
    deflection = force @ np.linalg.solve(structure.matrix("stiffness").toarray(), force)
    assert deflection == pytest.approx(1 / (48 * EI) + 1 / (16 * k), rel=1e-9)


def test_a_joint_equals_a_second_node_that_is_tied_in_all_other_directions():
    """The same made by hand: a node of the element's own, constraints, and a spring."""
    nodes = {1: (0.0, 0.0, 0.0), 2: (1.0, 0.3, 0.2), 3: (1.4, 1.0, 0.9)}
    values = (2.0, 3.0, 4.0, 9.0, 5.0, 0.1, 0.02)
    pairs = [[1, 2], [2, 3]]
    joints = [
        Joint("a", "frame:2", "2RX", 6.0, 0.1),
        Joint("b", "frame:2", "2Z", 70.0),
        Joint("c", "frame:2", "3RY", 8.0),
        Joint("d", "frame:1", "2RX", 9.0),
    ]
    short = Structure(nodes, [SpaceBeam("frame", pairs, *values), *joints], ["1X"])
    long_nodes = nodes | {12: nodes[2], 13: nodes[3], 22: nodes[2]}
    free = {12: ("RX", "Z"), 13: ("RY",), 22: ("RX",)}
    ties = [
        Constraint(f"{n}{d}", f"{n}{d}", [(f"{n % 10}{d}", 1.0)])
        for n, loose in free.items()
        for d in ("X", "Y", "Z", "RX", "RY", "RZ")
        if d not in loose
    ]
    springs = [
        Spring("a", "12RX", "2RX", stiffness=6.0, loss_factor=0.1),
        Spring("b", "12Z", "2Z", stiffness=70.0),
        Spring("c", "13RY", "3RY", stiffness=8.0),
        Spring("d", "22RX", "2RX", stiffness=9.0),
    ]
    long = Structure(long_nodes, [SpaceBeam("frame", [[1, 22], [12, 13]], *values), *springs], ["1X"], ties)
    assert short.n_dofs == long.n_dofs == 17 + 4
    assert short.nodes.keys() == nodes.keys()
    for kind in ("mass", "stiffness", "structural_damping"):
        found, made = (np.linalg.eigvalsh(s.matrix(kind).toarray()) for s in (short, long))
        assert found == pytest.approx(made, rel=1e-10, abs=1e-12 * np.abs(made).max())
    assert frequencies(short, 12) == pytest.approx(frequencies(long, 12), rel=1e-6, abs=1e-4)


def test_a_stiff_joint_is_none_and_its_stiffness_is_a_parameter():
    plain = Structure(NODES, [BEAM], ["0Y", "0RZ"])
    jointed = Structure(NODES, [BEAM, Joint("j", "girder:3", "3RZ", 1e6 * EI)], ["0Y", "0RZ"])
    assert frequencies(jointed) == pytest.approx(frequencies(plain), rel=1e-5)
    [name] = parameters(jointed, [Unknown("stiffness", "j")]).names
    assert name == "stiffness[j]"
    assert [p.term.unit for p in jointed.properties if p.element == "j"] == ["N m/rad", "1"]
    assert jointed.mass_of() == pytest.approx(3.0)


def test_the_loosened_end_is_no_place_of_a_sensor_and_is_named_in_words():
    nodes, bars = {1: 0.0, 2: 1.0}, Bar("bar", [1, 2], 1.0, 5.0)
    structure = Structure(nodes, [bars, PointMass("m", 2, 1.0), Joint("j", "bar", "2X", 3.0)], active=["X"])
    assert [structure.words(dof) for dof in structure.dofs] == ["1X+", "2X+", "X inside j"]
    inside = structure.dofs[-1]
    with pytest.raises(InputError, match="which the structure does not have"):
        structure.selection([inside])
    options = PlanOptions(frequency=(1.0,), relative_noise=0.01)
    chosen = resolve_options(structure, parameters(structure, [Unknown("stiffness", "j")]), options)
    assert [str(dof) for dof in chosen.sensors] == ["1X+", "2X+"]


PLANE = {1: (0.0, 0.0), 2: (1.0, 0.0), 3: (1.0, 1.0)}
FRAME = Beam("frame", [[1, 2], [2, 3]], 1.0, 2.0)


@pytest.mark.parametrize(
    ("joint", "active", "words"),
    [
        (Joint("j", "fram:1", "1RZ", 1.0), None, "no set of bars or beams called fram; the nearest is frame"),
        (Joint("j", "m", "1RZ", 1.0), None, "no set of bars or beams called m"),
        (Joint("j", "frame:3", "1RZ", 1.0), None, "no element frame:3; frame has 1 to 2"),
        (Joint("j", "frame:0", "1RZ", 1.0), None, "no element frame:0"),
        (Joint("j", "frame", "1RZ", 1.0), None, "say which, as in frame:2"),
        (Joint("j", "frame:1", "3RZ", 1.0), None, "node 3 is none of frame:1, which runs from 1 to 2"),
        (Joint("j", "frame:1", "7RZ", 1.0), None, "'j' uses node 7"),
        (Joint("j", "frame:1", "2X", 1.0), None, "frame:1 has no stiffness in 2X.*some in Y RZ"),
        (Joint("j", "frame:1", "2RZ", 1.0), ["X", "Y"], "2RZ is held, as the structure moves in X Y only"),
        (Joint("frame", "frame:1", "2RZ", 1.0), None, "two parts of the structure are called 'frame'"),
        (Joint("other", "frame:1", "2RZ", 1.0), None, "joint 'other' is in the place of joint 'k'"),
    ],
)
def test_joints_that_cannot_be_are_refused(joint, active, words):
    sets = [FRAME, PointMass("m", 1, 1.0), Joint("k", "frame:1", "2RZ", 1.0), joint]
    if joint.name != "other":
        del sets[2]
    with pytest.raises(InputError, match=words):
        Structure(PLANE, sets, active=active)


def test_what_nothing_measures_inside_a_joint_is_named_by_it():
    sets = [Bar("bar", [1, 2], 1.0, 5.0), Joint("j", "bar", "2X", 3.0)]
    structure = Structure({1: 0.0, 2: 1.0}, sets, ["1X"], active=["X"])
    record = TimeRecord(10.0, np.ones((5, 2)), ("2X", "2X"), ("acceleration", "force"))
    with pytest.raises(InputError, match="acceleration is not measured at X inside j;"):
        recorded_motion(structure, record)
