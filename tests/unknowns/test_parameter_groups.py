"""Declarations of many parameters: arrays give what a loop over elements gives."""

import sys

import numpy as np
import pytest

from structid import (
    Bar,
    Beam,
    Field,
    InputError,
    PointMass,
    Smoothness,
    SpaceBeam,
    Spring,
    Structure,
    Unknown,
    parameters,
)
from structid.unknowns import penalty
from structid.unknowns.unknown import parameter_group


def chain(n, **properties):
    table = np.stack([np.arange(n), np.arange(1, n + 1)], axis=1)
    beam = Beam("beam", table, **({"mass": 2.0, "bending_stiffness": 5.0} | properties))
    return Structure({i: float(i) for i in range(n + 1)}, [beam], ["0Y", "0RZ"])


def three_sets():
    """Space beams in two sets and a mass; the first set has unequal masses."""
    first = SpaceBeam("a", [[0, 1], [1, 2], [2, 3]], [1.0, 2.0, 4.0], 2.0, 3.0, 4.0)
    second = SpaceBeam("b", [[3, 4], [4, 5]], 7.0, 2.0, 3.0)
    return Structure({i: (0.0, 0.0, float(i)) for i in range(6)}, [first, second, PointMass("tip", [5], 9.0)])


def place(structure, label):
    return next(p.values for p in structure.properties if p.label == label)


def test_design_and_offset_are_those_of_a_loop_over_elements():
    structure = three_sets()
    unknowns = [
        Unknown("mass", ["a", "b"], each=True),
        Unknown("stiffness", ["a:1-2", "b"], each=True, name="k"),
        Unknown("mass", "tip", tied_to="mass[b:1]", ratio=0.5),
        Unknown("stiffness", "a:3", fixed=True, start=1.5),
    ]
    made = parameters(structure, unknowns)
    assert made.names == (
        "mass[a:1]",
        "mass[a:2]",
        "mass[a:3]",
        "mass[b:1]",
        "mass[b:2]",
        "stiffness[k:1]",
        "stiffness[k:2]",
    )
    assert made.elements == (("a",),) * 3 + (("b",),) * 2 + (("a", "b"),) * 2
    assert made.units == ("kg/m",) * 5 + ("1",) * 2
    dense, offset = np.zeros((len(structure.values), 7)), structure.values.copy()
    mass_a, mass_b = place(structure, "mass[a]").start, place(structure, "mass[b]").start
    for row in range(3):
        dense[mass_a + row, row] = 1
    for row in range(2):
        dense[mass_b + row, 3 + row] = 1
    dense[place(structure, "mass[tip]").start, 3] = 0.5
    offset[[*range(mass_a, mass_a + 3), mass_b, mass_b + 1, place(structure, "mass[tip]").start]] = 0
    for item in structure.properties:
        used = item.term.kind == "stiffness" and item.term.values.any()
        for row in range(2 if used and item.element in "ab" else 0):
            dense[item.values.start + row, 5 + row] = structure.values[item.values.start + row]
            offset[item.values.start + row] = 0
        if used and item.element == "a":
            offset[item.values.start + 2] *= 1.5
    np.testing.assert_array_equal(made.design.toarray(), dense)
    np.testing.assert_array_equal(made.offset, offset)
    assert made.start.tolist() == [1, 2, 4, 7, 7, 1, 1]


def test_a_field_weighs_every_element_by_its_functions_at_the_middle():
    structure = three_sets()
    made = parameters(structure, [Unknown("mass", ["a", "b"], field=Field((1, 1, 2)))])
    middles = np.array([0.5, 1.5, 2.5, 3.5, 4.5])
    at = (middles - 0.5) / 4
    hats = np.clip(np.stack([1 - 2 * at, 1 - 2 * np.abs(at - 0.5), 2 * at - 1], axis=1), 0, None)
    nominal = np.array([1.0, 2, 4, 7, 7])
    rows = np.r_[place(structure, "mass[a]"), place(structure, "mass[b]")]
    np.testing.assert_allclose(made.design.toarray()[rows], hats * nominal[:, None], atol=1e-15)
    assert made.elements == (("a",), ("a", "b"), ("b",))
    assert made.names == tuple(f"mass[a, b:field {k}]" for k in (1, 2, 3))


def test_elements_named_twice_take_part_once():
    structure = three_sets()
    once = parameters(structure, [Unknown("mass", "a"), Unknown("mass", "b", each=True)])
    twice = parameters(
        structure, [Unknown("mass", ["a", "a:2-3"], name="a"), Unknown("mass", ["b:2", "b:1-2"], each=True)]
    )
    np.testing.assert_array_equal(twice.values(np.array([2.0, 5, 6])), once.values(np.array([2.0, 6, 5])))
    assert twice.names[1:] == ("mass[b:2]", "mass[b:1]")


def test_what_is_wrong_with_one_of_many_is_named():
    structure = three_sets()
    many = Unknown("mass", "a", each=True)
    for unknowns, words in (
        ([many, Unknown("mass", "a:2")], r"mass\[a:2\]; give one of them a `name`"),
        ([many, Unknown("mass", "a:2", name="m")], r"mass\[a:2\] and mass\[m\] claim the same value"),
        ([Unknown("mass", "a", each=True, bounds=(0.5, 3.0))], r"mass\[a:3\] must lie between 0.5 and 3, got 4"),
        ([Unknown("mass", "a", each=True, tied_to="mass[a:2]")], r"mass\[a:1\] -> mass\[a:2\] -> mass\[a:2\]"),
        (
            [Unknown("polar_inertia", "a", each=True, factor=True)],
            r"polar_inertia\[a:1\] is a factor on nominal values",
        ),
        ([Unknown("mass", [])], "names no elements"),
    ):
        with pytest.raises(InputError, match=words):
            parameters(structure, unknowns)


def test_neighbours_are_the_pairs_of_elements_that_share_a_node():
    structure = chain(50)
    unknown = parameters(
        structure, [Unknown("mass", "beam", each=True), Unknown("bending_stiffness", "beam", each=True)]
    )
    rows = np.asarray(penalty(structure, unknown, Smoothness("bending_stiffness", "beam:3-40", 1.0)).matrix)
    expected = np.zeros((37, 100))
    expected[np.arange(37), 52 + np.arange(37)], expected[np.arange(37), 53 + np.arange(37)] = 1, -1
    np.testing.assert_array_equal(rows, expected)


def calls_of(n):
    """Functions called, in Python and C, to make two parameters for each of n elements."""
    structure, calls = chain(n), []
    sys.setprofile(lambda frame, event, argument: calls.append(event))
    try:
        made = parameters(structure, [Unknown(p, "beam", each=True) for p in ("mass", "bending_stiffness")])
    finally:
        sys.setprofile(None)
    assert (made.n_params, made.names[-1], made.design.nnz) == (2 * n, f"bending_stiffness[beam:{n}]", 2 * n)
    return len(calls)


def test_elements_are_not_gone_through_one_by_one():
    assert calls_of(3000) < calls_of(30) + 100


def test_kinds_and_first_entries_of_a_family():
    one = parameter_group(three_sets(), Unknown("stiffness", "a", each=True))
    assert one.n_params == 3
    assert one.kinds == ("stiffness",) * 3
    assert one.is_factor.all()
    np.testing.assert_array_equal(one.owner[one.first], np.arange(3))


def test_several_quantities_of_one_value_make_a_factor():
    column = Structure({1: (0, 0, 0), 2: (0, 0, 1)}, [SpaceBeam("c", [1, 2], 1.0, 3.0, 3.0)])
    for each in (False, True):
        assert parameters(column, [Unknown("stiffness", "c", each=each)]).units == ("1",)


def test_the_ground_is_no_place_of_a_field():
    sets = [Spring("g", ["1X", "3X"], stiffness=5.0), Spring("s", ["1X"], ["3X"], stiffness=5.0)]
    structure = Structure({1: 0.0, 3: 4.0}, sets, active=["X"])
    made = parameters(structure, [Unknown("stiffness", ["g", "s"], field=Field((1,)))])
    rows = np.r_[place(structure, "stiffness[g]"), place(structure, "stiffness[s]")]
    np.testing.assert_allclose(made.design.toarray()[rows] / 5.0, [[1, 0], [0, 1], [0.5, 0.5]], atol=1e-15)


def bays(n: int = 8) -> Structure:
    table = [[k, k + 1] for k in range(n)]
    sets = [Bar("deck", table, 1.0, 5.0), Bar("rail", [[0, n]], 1.0, 5.0)]
    return Structure({k: float(k) for k in range(n + 1)}, sets, ["0X"], active=["X"])


def test_neighbours_share_a_parameter():
    made = parameters(
        bays(), [Unknown("axial_stiffness", "deck", each=4, start=6.0), Unknown("mass", "deck", each=True)]
    )
    assert made.names[:3] == ("axial_stiffness[deck:1-4]", "axial_stiffness[deck:5-8]", "mass[deck:1]")
    values = made.values(np.array([7.0, 9.0, *made.start[2:]]))
    stiffness = next(p.values for p in bays().properties if p.label == "axial_stiffness[deck]")
    assert values[stiffness].tolist() == [7.0] * 4 + [9.0] * 4
    some = parameters(bays(), [Unknown("mass", "deck:3-8", each=2)])
    assert some.names == ("mass[deck:3-4]", "mass[deck:5-6]", "mass[deck:7-8]")
    assert parameters(bays(), [Unknown("mass", "deck", each=1)]).names == made.names[2:]


@pytest.mark.parametrize(
    ("elements", "each", "words"),
    [
        ("deck", 3, "`each` = 3 of mass.deck. makes no whole groups of 8 elements"),
        (["deck:1-3", "deck:6"], 2, "the group from element 3 on is not of neighbours"),
        ("rail", 2, "no whole groups of 1 elements"),
    ],
)
def test_groups_that_are_none_are_named(elements, each, words):
    with pytest.raises(InputError, match=words):
        parameters(bays(), [Unknown("mass", elements, each=each)])
