"""Feet that turn together: which supports give way as one."""

import numpy as np

from structid.diagnose.causes import SensorDelay, Support
from structid.diagnose.score_test import Screened
from structid.diagnose.screening import _feet
from structid.diagnose.search import _ranks_of_derived


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
