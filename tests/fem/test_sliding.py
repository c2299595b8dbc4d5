"""Nodes that slide along their beams: matrices of the structure drawn elsewhere, exact derivatives, a roller's place."""

import numpy as np
import pytest

from structid import (
    Bar,
    Beam,
    FrfRecord,
    InputError,
    Joint,
    ModalRecord,
    ModalSetup,
    Plane,
    PointMass,
    RigidLink,
    SpaceBeam,
    Spring,
    Structure,
    Unknown,
    estimate,
    identify_together,
    parameters,
)
from structid.dynamics.normal_modes import modes
from structid.forward import ModalProblem, ModalSettings
from structid.forward.frf.response import response
from structid.forward.sensitivity import require_linear_weights

LAWS = ("mass", "stiffness", "damping", "structural_damping")
UNIT = np.array([0.6, 0.0, 0.8])


def line(place: float, pieces: int = 3, sliding=(2,)) -> Structure:
    """A beam over a roller at `place`, with a mass there and a joint, in a plane and at an angle."""
    nodes = {k: (0.6 * x, 0.8 * x) for k, x in ((1, 0.0), (2, place), (3, 2.0))}
    sets = [
        Beam("beam", [[1, 2], [2, 3]], [2.0, 3.0], [5.0, 7.0], 400.0, 0.01, 0.2, 1e-3, rotary_inertia=[0.02, 0.03]),
        Bar("rod", [[3, 2]], 0.5, 90.0, mass_damping=0.1),
        PointMass("load", [2], 0.4),
        Spring("roller", "2Y", stiffness=1e4),
        Joint("hinge", "beam:2", "2RZ", 60.0),
    ]
    return Structure(nodes, sets, ["1X", "1Y", "1RZ", "3Y"], subdivide=pieces, sliding=sliding)


def moved(structure: Structure, **places: float) -> np.ndarray:
    values = structure.values.copy()
    for item in structure.properties:
        if item.term.kind == "position":
            values[item.values] = places[item.element.replace(" ", "")]
    return values


@pytest.mark.parametrize("pieces", [1, 3])
def test_matrices_are_those_of_the_structure_drawn_there(pieces):
    drawn, there = line(0.7, pieces), line(1.1, pieces, ())
    assert [p.label for p in drawn.properties if p.term.kind == "position"] == ["position[node 2]"]
    plain = line(0.7, pieces, ())
    for law in LAWS:
        expected, nominal = there.matrix(law).toarray(), plain.matrix(law).toarray()
        assert np.abs(drawn.matrix(law).toarray() - nominal).max() <= 1e-11 * np.abs(nominal).max()
        found = drawn.matrix(law, moved(drawn, node2=1.1)).toarray()
        assert np.abs(found - expected).max() <= 1e-11 * np.abs(expected).max()
    assert drawn.mass_of(moved(drawn, node2=1.1)) == pytest.approx(there.mass_of(), rel=1e-11)


def test_the_gradient_of_the_mass_is_a_difference():
    structure = line(0.7)
    place = next(p.values.start for p in structure.properties if p.term.kind == "position")
    ends = [structure.mass_of(moved(structure, node2=0.7 + step)) for step in (1e-3, -1e-3)]
    assert structure.mass_gradient()[place] == pytest.approx((ends[0] - ends[1]) / 2e-3, rel=1e-8)


def test_two_ends_of_one_space_beam_slide():
    def made(a: float, b: float, sliding=(2, 3)) -> Structure:
        nodes = {k: tuple(x * UNIT) for k, x in ((1, 0.0), (2, a), (3, b), (4, 3.0))}
        beam = SpaceBeam(
            "e", [[1, 2], [2, 3], [3, 4]], 2.0, 3.0, 5.0, 7.0, 11.0, 0.1, rotary_inertia_y=0.01, rotary_inertia_z=0.02
        )
        return Structure(nodes, [beam], ["1X", "1Y", "1Z", "1RX", "1RY", "1RZ"], subdivide=2, sliding=sliding)

    drawn, there = made(1.0, 2.0), made(1.3, 1.9, ())
    for law in ("mass", "stiffness"):
        expected = there.matrix(law).toarray()
        # the place of node 3 is measured from node 2 where that was drawn
        found = drawn.matrix(law, moved(drawn, node2=1.3, node3=0.9)).toarray()
        assert np.abs(found - expected).max() <= 1e-11 * np.abs(expected).max()


def test_derivatives_to_a_place_are_differences():
    structure = line(0.7)
    unknown = parameters(structure, [Unknown("position", "node 2"), Unknown("bending_stiffness", "beam")])
    assert unknown.names[0] == "position[node 2]"
    assert unknown.units[0] == "m"
    frequency = np.linspace(0.3, 3.0, 5)
    like = FrfRecord(frequency, np.ones((5, 2, 1)), ["2X", "3X"], ["3X"], "accelerance")
    model, start = response(structure, unknown, like), np.array(unknown.start)
    assert start[0] == pytest.approx(0.7)
    _, slopes = model.derivatives_at(start)
    for k, step in enumerate(1e-4 * start):
        move = step * np.eye(2)[k]
        near, far = (model.values_at(start + m * move) - model.values_at(start - m * move) for m in (1, 2))
        difference = (8 * near - far) / (12 * step)
        assert np.abs(slopes[..., k] - difference).max() <= 1e-6 * np.abs(difference).max()


def beam_on_a_roller(place: float) -> Structure:
    """A cantilever of 2 m with a roller that slides."""
    strip = Beam("strip", [[1, 2], [2, 3]], 1.2, 150.0)
    return Structure({1: 0.0, 2: place, 3: 2.0}, [strip], ["1Y", "1RZ", "2Y"], subdivide=8, sliding=[2])


def two_frequencies(place: float) -> np.ndarray:
    structure = beam_on_a_roller(place)
    return modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=2).frequency


def roller_problem(frequency: np.ndarray, start: float = 1.0, error: float = 1e-3) -> ModalProblem:
    """Two frequencies and nothing else; shapes of one sensor have no say."""
    structure = beam_on_a_roller(start)
    record = ModalRecord(frequency, np.zeros(2), np.ones((1, 2)), ["3Y"])
    unknown = parameters(structure, [Unknown("position", "node 2")])
    return ModalProblem(structure, unknown, record, ModalSettings(frequency_error=error, shape_error=1e3))


def test_two_frequencies_give_the_place_of_a_roller():
    found = estimate(roller_problem(two_frequencies(1.37)))
    assert found.status.value == "converged"
    assert found.values == pytest.approx([1.37], abs=1e-7)


def test_the_interval_of_the_place_holds_the_truth():
    rng, clean = np.random.default_rng(5), two_frequencies(1.37)
    errors = []
    for _ in range(40):
        noisy = clean * (1 + 1e-3 * rng.standard_normal(2))
        found = estimate(roller_problem(noisy))
        errors.append((found.values[0] - 1.37) / found.std[0])
    assert np.abs(errors).max() < 4
    assert np.mean(np.square(errors)) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 40))


def test_a_roller_that_is_moved_has_a_place_in_each_record():
    """Two sliding nodes of one strip, each held in its own record; the bending stiffness is shared."""

    def strip(first: float, second: float, held: int, stiffness: float = 150.0) -> Structure:
        beam = Beam("strip", [[1, 2], [2, 3], [3, 4]], 1.2, stiffness, tolerance=0)
        nodes = {1: 0.0, 2: first, 3: second, 4: 2.0}
        return Structure(nodes, [beam], ["1Y", "1RZ", f"{held}Y"], subdivide=4, sliding=[2, 3])

    unknown = [Unknown("bending_stiffness", "strip"), Unknown("position", "node 2"), Unknown("position", "node 3")]
    setups = []
    for held in (2, 3):
        true = strip(1.23, 1.52, held, 160.0)
        three = modes(true.matrix("mass"), true.matrix("stiffness"), n_modes=3).frequency
        record = ModalRecord(three, np.zeros(3), np.ones((1, 3)), ["4Y"])
        drawn = strip(1.2, 1.55, held)
        settings = ModalSettings(frequency_error=1e-3, shape_error=1e3)
        setups.append(ModalSetup(drawn, parameters(drawn, unknown), record, settings=settings))
    found = identify_together(setups).estimate
    assert found.names == ("bending_stiffness[strip]", "position[node 2]", "position[node 3]")
    assert found.values == pytest.approx([160.0, 1.23, 1.52 - 1.2], rel=1e-6)


def test_the_place_stays_between_its_neighbours():
    structure = beam_on_a_roller(1.0)
    unknown = parameters(structure, [Unknown("position", "node 2")])
    assert unknown.transforms.kinds == ("interval",)
    assert (unknown.transforms.lower[0], unknown.transforms.upper[0]) == pytest.approx((0.002, 1.998), abs=1e-12)
    narrow = parameters(structure, [Unknown("position", "node 2", bounds=(0.5, 1.5))])
    assert (narrow.transforms.lower[0], narrow.transforms.upper[0]) == (0.5, 1.5)
    with pytest.raises(
        InputError, match=r"bounds of position\[node 2\] must lie between its neighbours, from 0.002 to 1.998 m"
    ):
        parameters(structure, [Unknown("position", "node 2", bounds=(0.5, 2.5))])
    with pytest.raises(InputError, match=r"position\[node 2\].*2\.5"):
        parameters(structure, [Unknown("position", "node 2", start=2.5)])


def test_methods_that_are_linear_in_the_parameters_need_the_place():
    structure = beam_on_a_roller(1.0)
    with pytest.raises(InputError, match=r"position\[node 2\] must be known here.*fix it"):
        require_linear_weights(structure, parameters(structure, [Unknown("position", "node 2")]))
    require_linear_weights(structure, parameters(structure, [Unknown("mass", "strip")]))


SQUARE = {1: (0.0, 0.0), 2: (1.0, 0.0), 3: (1.0, 1.0), 4: (0.0, 1.0), 5: (2.0, 0.0), 6: (2.0, 1.0)}


@pytest.mark.parametrize(
    ("sets", "ties", "sliding", "words"),
    [
        ([Beam("e", [[1, 2], [2, 3]], 1.0, 1.0)], [], [2], "lines to nodes 1 and 3 meet at an angle"),
        ([Beam("e", [[1, 2], [2, 5]], 1.0, 1.0)], [], [9], "node 9, which the structure does not have"),
        (
            [Beam("e", [[1, 2]], 1.0, 1.0), PointMass("m", [6], 1.0)],
            [],
            [6],
            "node 6 of `sliding` is no end of a bar or beam",
        ),
        ([Beam("e", [[1, 2], [1, 5]], 1.0, 1.0)], [], [1], "has two neighbours on one side, 2 and 5"),
        ([Beam("e", [[1, 2], [2, 5]], 1.0, 1.0, shear_stiffness=3.0)], [], [2], "'e' shear, so that no end"),
        ([Beam("e", [[1, 2], [2, 5]], 1.0, 1.0)], [RigidLink("arm", 2, [3])], [2], "is in rigid link 'arm'"),
        (
            [Beam("e", [[1, 2], [2, 5]], 1.0, 1.0), Plane("p", [[2, 5, 6, 3]], 1.0, 1.0, 0.1, 0.3)],
            [],
            [2],
            "is a corner of cells of 'p'",
        ),
        ([Beam("node 2", [[1, 2], [2, 5]], 1.0, 1.0)], [], [2], "two parts of the structure are called 'node 2'"),
    ],
)
def test_nodes_that_cannot_slide_are_named(sets, ties, sliding, words):
    with pytest.raises(InputError, match=words):
        Structure(SQUARE, sets, ["1X", "1Y", "1RZ"], ties, sliding=sliding)
