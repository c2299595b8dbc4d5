"""Feet that turn together, and rollers that do not roll: supports that no linear look shows."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import eigh

import structid as sid
from structid.diagnose.causes import SensorDelay, SpringToGround, Support
from structid.diagnose.score_test import Screened
from structid.diagnose.screening import _clamps, _feet, _rollers
from structid.diagnose.search import _ranks_of_derived
from structid.modal import ModalRecord
from structid.modal.modal_record import independent_errors


def support(place, **more):
    return Support(where=(place,), strengths=np.array([1e-6, 3e-6, 9e-6]), **more)


def test_rotations_of_a_direction_of_all_directions_and_of_a_node_are_groups():
    held = [support(f"{node}{d}") for node in (1, 5) for d in ("X", "RX", "RY")]
    groups = [row.candidate.where for row in _feet(held, 7.0)]
    assert groups == [("1RX", "5RX"), ("1RY", "5RY"), ("1RX", "5RX", "1RY", "5RY"), ("1RX", "1RY"), ("5RX", "5RY")]
    assert {(row.strength, row.left) for row in _feet(held, 7.0)} == {(3e-6, 7.0)}


def test_a_plane_frame_has_one_group_and_a_driven_or_single_foot_none():
    assert [row.candidate.where for row in _feet([support("1RZ"), support("37RZ"), support("1Y")], 1.0)] == [
        ("1RZ", "37RZ")
    ]
    assert _feet([support("1RZ"), support("37RZ", driven=(0,))], 1.0) == []


def test_feet_come_first_where_a_look_promises_something_of_one_of_them():
    feet = _feet([support("1RZ"), support("37RZ")], 1.0)
    other = Screened(SensorDelay(where=("4X",)), 1.0, 1.0)
    assert _ranks_of_derived([other, *feet], [Screened(support("37RZ"), 3e-6, 0.5)]) == [8, 0]
    assert _ranks_of_derived([other, *feet], [other]) == [8, 9]


def test_of_feet_of_a_single_node_the_most_promising_come_first():
    feet = _feet([support(f"{node}{d}") for node in (1, 5) for d in ("RX", "RY")], 1.0)
    rows = [Screened(support("5RY"), 3e-6, 0.4), Screened(support("1RX"), 3e-6, 0.5)]
    assert _ranks_of_derived(feet, rows) == [0, 0, 0, 11, 0]


def test_hinges_of_all_supported_nodes_are_clamped_together_by_springs_of_one_stiffness():
    springs = [SpringToGround(where=(place,), strengths=np.array([1.0, 60.0])) for place in ("1RZ", "4RZ", "8X", "8RZ")]
    [row] = _clamps([support("1X"), *springs], {1, 8}, 7.0)
    assert (row.candidate.where, row.strength, row.left) == (("1RZ", "8RZ"), 60.0, 7.0)
    assert row.candidate.sentence(None) == "something holds 1RZ, 8RZ: springs to the ground"
    added, _ = row.candidate.edits(SimpleNamespace(unique_name=str), 60.0)
    assert added.entry == {"name": "spring 1RZ", "first": ["1RZ", "8RZ"], "stiffness": 60.0}
    assert _clamps(springs[:3], {1, 8}, 7.0) == []


def test_of_modes_free_translations_of_held_nodes_are_held_all_but_rigidly():
    springs = [SpringToGround(where=(place,), strengths=np.array([1.0, 60.0])) for place in ("4X", "7X", "7RZ")]
    of_modes, of_frfs = (SimpleNamespace(misfit=9.0, modified=SimpleNamespace(is_of_modes=is_so)) for is_so in (1, 0))
    rows = _rollers(of_modes, [support("7Y"), *springs], {1, 7})
    assert [(row.candidate.where, row.strength, row.left) for row in rows] == [(("7X",), 60.0, 9.0)]
    assert _rollers(of_frfs, springs, {1, 7}) == []


@pytest.mark.long
def test_a_roller_of_a_truss_that_is_stuck_is_named_by_its_modes():
    """A Warren truss of six bays; its bars are assembled here, and its roller at node 7 does not roll."""
    nodes = {k + 1: (3.0 * k, 0.0) for k in range(7)} | {k + 8: (3.0 * k + 1.5, 1.4) for k in range(6)}
    low, top = [[k, k + 1] for k in range(1, 7)], [[k, k + 1] for k in range(8, 13)]
    diagonals = [[k + 1, k + 8] for k in range(6)] + [[k + 8, k + 2] for k in range(6)]
    sets = {"low": (low, 15.2, 3.99e8), "top": (top, 17.6, 4.51e8), "diagonals": (diagonals, 7.95, 2.1e8)}
    mass, stiffness = np.zeros((26, 26)), np.zeros((26, 26))
    for pairs, mass_per_metre, axial_stiffness in sets.values():
        for a, b in pairs:
            along = np.subtract(nodes[b], nodes[a])
            length = np.linalg.norm(along)
            rows = np.ix_(*2 * [[2 * a - 2, 2 * a - 1, 2 * b - 2, 2 * b - 1]])
            block = axial_stiffness / length**3 * np.outer(along, along)
            stiffness[rows] += np.kron([[1, -1], [-1, 1]], block)
            mass[rows] += mass_per_metre * length / 6 * np.kron([[2, 1], [1, 2]], np.eye(2))
    deck = [55.0, *5 * [110.0], 55.0]
    mass[range(14), range(14)] += np.repeat(deck, 2)
    free = np.setdiff1d(np.arange(26), [0, 1, 12, 13])
    squares, vectors = eigh(stiffness[np.ix_(free, free)], mass[np.ix_(free, free)])
    channels = ["2Y", "3Y", "4Y", "5Y", "6Y", "4X"]
    shapes = vectors[[free.tolist().index(k) for k in (3, 5, 7, 9, 11, 6)], :5]
    shapes = shapes / np.abs(shapes).max(axis=0)
    frequency = np.sqrt(squares[:5]) / (2 * np.pi)
    errors = independent_errors(np.concatenate([1e-3 * frequency, np.full(5, 0.1)]))
    record = ModalRecord(frequency, np.full(5, 0.01), shapes, channels, errors, np.full(shapes.shape, 0.015))
    bars = [sid.Bar(name, pairs, mass=m, axial_stiffness=0.95 * ea) for name, (pairs, m, ea) in sets.items()]
    structure = sid.Structure(
        nodes, [*bars, sid.PointMass("deck", range(1, 8), deck)], fixed=["1X", "1Y", "7Y"], active=["X", "Y"]
    )
    unknown = sid.parameters(structure, [sid.Unknown("axial_stiffness", name) for name in sets])
    explained = sid.explain(sid.identify_together([sid.ModalSetup(structure, unknown, record)]))
    first = explained.causes[0]
    assert (first.kind, first.where) == ("spring", ("7X",))
    assert first.leaves_noise
