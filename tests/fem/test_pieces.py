"""Elements of several equal pieces: the same as a finer mesh, with elements and values as they are written."""

from itertools import pairwise

import numpy as np
import pytest

from structid import (
    Bar,
    Beam,
    InputError,
    Joint,
    Plate,
    PointMass,
    SpaceBeam,
    Structure,
    Unknown,
    from_matrices,
    parameters,
    parse_dof,
)
from structid.dynamics.normal_modes import modes
from structid.unknowns import Smoothness, penalty

SPACE = {1: np.array([0.1, 0.0, 0.2]), 2: np.array([1.0, 0.7, -0.3]), 3: np.array([1.5, 0.2, 1.0])}
PAIRS = [[1, 2], [3, 2]]
MAKERS = {
    "bar on a line": (1, lambda nodes, twice: Bar("e", nodes, twice([2.0, 3.0]), twice([5.0, 4.0]), 0.1, 0.2, 0.3)),
    "bar that moves along X": (3, lambda nodes, twice: Bar("e", nodes, twice([2.0, 3.0]), twice([5.0, 4.0]))),
    "beam in a plane": (
        2,
        lambda nodes, twice: Beam("e", nodes, twice([2.0, 3.0]), twice([5.0, 4.0]), 90.0, 0.1, 0.2, 0.3),
    ),
    "beam in space": (
        3,
        lambda nodes, twice: SpaceBeam("e", nodes, twice([2.0, 3.0]), twice([5.0, 4.0]), 6.0, 90.0, 7.0, 0.1, 0.1, 0.2),
    ),
}


@pytest.mark.parametrize("case", MAKERS)
@pytest.mark.parametrize("pieces", [2, 5])
def test_pieces_are_those_of_a_finer_mesh(case, pieces):
    dimension, make = MAKERS[case]
    nodes = {label: place[:dimension] for label, place in SPACE.items()}
    active = ["X"] if "along X" in case else None
    short = Structure(nodes, [make(PAIRS, np.array), PointMass("m", 2, 1.0)], ["1X"], active=active, subdivide=pieces)
    finer, table = dict(nodes), []
    for first, last in PAIRS:
        chain = [first, *range(len(finer) + 10, len(finer) + 9 + pieces), last]
        finer |= {n: nodes[first] + (nodes[last] - nodes[first]) * k / pieces for k, n in enumerate(chain)} | nodes
        table += [list(pair) for pair in pairwise(chain)]
    sets = [make(table, lambda values: np.repeat(values, pieces)), PointMass("m", 2, 1.0)]
    long = Structure(finer, sets, ["1X"], active=active)
    assert short.n_dofs == long.n_dofs
    assert short.mass_of() == pytest.approx(long.mass_of(), rel=1e-12)
    for kind in ("mass", "stiffness", "damping", "structural_damping"):
        found, made = (np.linalg.eigvalsh(s.matrix(kind).toarray()) for s in (short, long))
        assert found == pytest.approx(made, rel=1e-9, abs=1e-12 * np.abs(made).max(initial=0.0))


@pytest.mark.parametrize(
    ("end", "active", "bent"),
    [((2.0, 0.0, 0.0), ["Y"], ["Y", "RZ"]), ((0.0, 0.0, 2.0), ["X", "Y"], ["X", "Y", "RX", "RY"]),
     ((1.2, 0.0, 1.6), ["X"], ["X", "Z", "RY"]), ((2.0, 0.0, 0.0), ["X", "Y", "RZ"], ["X", "Y", "RZ"])],
)  # fmt: skip
def test_pieces_turn_between_ends_that_active_keeps_from_turning(end, active, bent):
    """As the beam written out by hand, with the directions that bending takes free between its ends."""
    properties = {"axial_stiffness": 1e4, "torsional_stiffness": 300.0, "polar_inertia": 0.01}

    def beam(rows):
        return SpaceBeam("e", rows, 2.0, bending_stiffness_y=500.0, bending_stiffness_z=700.0, **properties)

    foot, tip = np.zeros(3), np.array(end)
    cut = Structure({0: foot, 4: tip}, [beam([[0, 4]])], [f"0{d}" for d in active], active=active, subdivide=4)
    held = [f"0{d}" for d in bent] + [f"4{d}" for d in bent if d not in active]
    nodes = {i: tip * i / 4 for i in range(5)}
    hand = Structure(nodes, [beam([[i, i + 1] for i in range(4)])], held, active=bent)
    assert cut.n_dofs == hand.n_dofs
    found, made = (modes(one.matrix("mass"), one.matrix("stiffness")).frequency for one in (cut, hand))
    assert found == pytest.approx(made, rel=1e-8)


def test_a_beam_in_pieces_has_the_frequencies_of_the_continuous_one():
    """Cantilever of one element, (beta L)^2 = 3.516015, 22.03449, 61.69721."""
    structure = Structure({0: 0.0, 1: 1.0}, [Beam("beam", [0, 1], 1.0, 1.0)], ["0Y", "0RZ"], subdivide=20)
    found = modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=3)
    assert 2 * np.pi * found.frequency == pytest.approx([3.516015, 22.03449, 61.69721], rel=2e-5)


def test_elements_stay_those_that_are_written():
    nodes = {0: 0.0, 1: 1.0, 2: 3.0}
    beam, joint = Beam("beam", [[0, 1], [1, 2]], [2.0, 3.0], 5.0), Joint("j", "beam:2", "1RZ", 7.0)
    structure = Structure(nodes, [beam, joint], ["0Y", "0RZ"], subdivide=4)
    assert structure.nodes.keys() == nodes.keys()
    unknown = parameters(structure, [Unknown("mass", "beam", each=True), Unknown("bending_stiffness", "beam:2")])
    assert unknown.names == ("mass[beam:1]", "mass[beam:2]", "bending_stiffness[beam:2]")
    assert penalty(structure, unknown, Smoothness("mass", "beam", strength=1.0)).matrix.shape == (1, 3)
    words = [structure.words(dof) for dof in structure.dofs[:6]]
    assert words == ["1Y+", "1RZ+", "2Y+", "2RZ+", "Y inside beam:1", "RZ inside beam:1"]
    assert structure.words(structure.dofs[-1]) == "RZ inside j"
    assert structure.n_dofs == 4 + 2 * 6 + 1
    with pytest.raises(InputError, match="which the structure does not have"):
        structure.selection([parse_dof("3Y")])


MAST = {0: (0.0, 0.0), 1: (0.0, 1.0), 2: (0.0, 2.0), 8: (0.8, 0.0), 9: (-0.9, 0.0)}
MAST_FIXED = ["0X", "0Y", "0RZ", "8X", "8Y", "9X", "9Y"]


def braced(strut, tube, finer=False):
    """A mast of two beams, or of four, between a strut and a tube."""
    nodes = MAST | ({3: (0.0, 0.5), 4: (0.0, 1.5)} if finer else {})
    rows = [[0, 3], [3, 1], [1, 4], [4, 2]] if finer else [[0, 1], [1, 2]]
    mast = Beam("mast", rows, 6.5, 4000.0, axial_stiffness=2e8)
    return Structure(nodes, [mast, strut, tube], MAST_FIXED, subdivide=1 if finer else 2)


def test_bars_whose_pieces_nothing_holds_sideways_stay_whole():
    """As a mast that is written in pieces between whole struts: no mode at 0 Hz."""
    strut, tube = Bar("strut", [[8, 1]], 0.4, 2.5e5), Beam("tube", [[9, 2]], 0.4, 0.0, axial_stiffness=3e5)
    cut, hand = braced(strut, tube), braced(strut, tube, finer=True)
    assert [one.name for one in cut.divisible] == ["mast"]
    assert cut.n_dofs == hand.n_dofs
    fixed = (*MAST_FIXED, "9RZ")  # an end that no bending stiffness holds
    found, made = (
        modes(one.matrix("mass"), one.matrix("stiffness")).frequency
        for one in (Structure(s.nodes, s.elements, fixed, subdivide=s.subdivide) for s in (cut, hand))
    )
    assert found == pytest.approx(made, rel=1e-8)
    assert found.min() > 1.0


def test_beams_are_cut_whatever_stiffness_they_have_along():
    flat = Beam("flat", [[0, 1]], 2.0, 5.0)
    assert Structure({0: (0.0, 0.0), 1: (1.0, 0.0)}, [flat], subdivide=3).n_dofs == 12


def test_bars_of_which_none_can_be_cut_are_refused():
    strut = Bar("strut", [[8, 1], [8, 2]], 0.4, 2.5e5)
    with pytest.raises(InputError, match="would cut bars only, whose pieces nothing holds sideways; take 1, or make"):
        Structure(MAST, [strut], ["8X", "8Y"], subdivide=2)


@pytest.mark.parametrize("pieces", [0, -1, 2.0, 101])
def test_pieces_are_a_whole_number(pieces):
    with pytest.raises(InputError, match="`subdivide` must be a whole number from 1 to 100"):
        Structure({0: 0.0, 1: 1.0}, [Beam("beam", [0, 1], 1.0, 1.0)], subdivide=pieces)


def test_only_lines_can_be_cut():
    corners = {1: (0.0, 0.0), 2: (1.0, 0.0), 3: (0.0, 1.0)}
    plate = Plate("plate", [1, 2, 3], 70e9, 2700.0, 0.01, 0.3)
    group = from_matrices({"g": {"mass": np.eye(2)}}, ["1X", "2X"]).elements[0]
    for sets in ([plate], [group]):
        with pytest.raises(
            InputError, match="cuts bars, beams and space beams only, and the structure has none; take 1"
        ):
            Structure(corners, sets, subdivide=2)
    mixed = Structure(corners, [plate, Beam("edge", [1, 2], 1.0, 1.0)], subdivide=2)
    assert mixed.n_dofs == Structure(corners, [plate, Beam("edge", [1, 2], 1.0, 1.0)]).n_dofs + 3
