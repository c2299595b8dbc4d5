"""Pairs of modes: crossed, missing, surplus, ambiguous and close ones, each made by hand."""

import numpy as np
import pytest

from structid import InputError, pair_modes

RNG = np.random.default_rng(4)
SHAPES = np.linalg.qr(RNG.standard_normal((8, 6)))[0]
HZ = np.array([2.0, 5.0, 9.0, 14.0, 20.0, 27.0])


def test_the_same_modes_are_paired_in_order():
    found = pair_modes(HZ, -3 * SHAPES, 1.05 * HZ, SHAPES)
    assert found.number.tolist() == [0, 1, 2, 3, 4, 5]
    assert found.likeness == pytest.approx(np.ones(6), abs=1e-12)
    assert (found.groups, found.ambiguous, found.surplus, found.missing.tolist()) == ((), {}, (), [])


def test_modes_that_cross_are_paired_by_shape():
    order = [1, 0, 2, 3, 4, 5]
    found = pair_modes([4.8, 5.0, 9.0], SHAPES[:, :3], [4.7, 5.2, 9.0, 14.0, 20.0, 27.0], SHAPES[:, order])
    assert found.number.tolist() == [1, 0, 2]


def test_of_two_alike_at_the_sensors_the_nearer_in_frequency_is_taken_and_the_other_named():
    model = SHAPES.copy()
    model[:, 4] = model[:, 1] + 0.05 * model[:, 3]
    found = pair_modes(HZ[:3], SHAPES[:, :3], HZ, model)
    assert found.number.tolist() == [0, 1, 2]
    assert found.ambiguous == {}  # 20 Hz is far from 5 Hz
    near = HZ.copy()
    near[2:5] = [5.6, 14.0, 5.4]
    order = np.argsort(near)
    found = pair_modes([2.0, 5.0], SHAPES[:, :2], near[order], model[:, order])
    assert found.number.tolist() == [0, 1]
    assert found.ambiguous == {1: (2,)}
    assert near[order][2] == 5.4


def test_a_mode_without_a_like_is_missing_and_those_that_were_not_measured_are_surplus():
    model = SHAPES[:, [0, 2, 3, 4]]
    found = pair_modes(HZ[[0, 1, 4]], SHAPES[:, [0, 1, 4]], HZ[[0, 2, 3, 4]], model)
    assert found.number.tolist() == [0, -1, 3]
    assert found.missing.tolist() == [1]
    assert found.surplus == (1, 2)
    assert found.partners(1) == ()


def test_close_modes_that_are_turned_in_their_plane_are_paired_as_a_space():
    turn = np.array([[np.cos(0.8), -np.sin(0.8)], [np.sin(0.8), np.cos(0.8)]])
    measured = SHAPES.copy()
    measured[:, 2:4] = SHAPES[:, 2:4] @ turn
    hz = np.array([2.0, 5.0, 9.0, 9.1, 20.0, 27.0])
    found = pair_modes(hz, measured, hz, SHAPES)
    assert found.groups == (((2, 3), (2, 3)),)
    assert found.likeness[2:4] == pytest.approx(1.0, abs=1e-12)
    assert found.mac[2, found.number[2]] == pytest.approx(np.sin(0.8) ** 2, rel=1e-12)
    far = np.array([2.0, 5.0, 9.0, 12.0, 20.0, 27.0])
    assert pair_modes(far, measured, far, SHAPES).groups == ()


def test_one_measured_mode_between_two_close_ones_of_the_model_is_held_against_both():
    both = 0.8 * SHAPES[:, 2] + 0.6 * SHAPES[:, 3]
    model = np.array([2.0, 5.0, 9.0, 9.1, 20.0, 27.0])
    found = pair_modes([5.0, 9.05], np.column_stack([SHAPES[:, 1], both]), model, SHAPES)
    assert found.number.tolist() == [1, 2]
    assert found.partners(1) == (2, 3)
    assert found.likeness[1] == pytest.approx(1.0, abs=1e-12)
    assert found.surplus == ()


def test_modes_that_move_no_sensor_and_rigid_ones_are_left_out():
    model = SHAPES.copy()
    model[:, 1] = 1e-12
    hz = HZ.copy()
    hz[0] = 1e-6
    found = pair_modes(HZ[2:4], SHAPES[:, 2:4], hz, model)
    assert found.number.tolist() == [2, 3]
    assert not found.mac[:, :2].any()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([1.0], SHAPES[:, :2], HZ, SHAPES), "one column a frequency"),
        (([0.0], SHAPES[:, :1], HZ, SHAPES), "above 0 Hz"),
        ((HZ, SHAPES[:5], HZ, SHAPES), "same channels, got 5 and 8"),
    ],
)
def test_what_cannot_be_paired_is_refused(arguments, words):
    with pytest.raises(InputError, match=words):
        pair_modes(*arguments)
