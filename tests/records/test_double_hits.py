"""A hammer that strikes twice at once is found; blows that are meant, and random forces, are none."""

import numpy as np
import pytest

from structid import TimeRecord
from structid.records.quality import channel_checks

RATE = 2000.0


def force_of(blows, n=8000, contact=8):
    force = 0.001 * np.random.default_rng(1).standard_normal(n)
    for first, size in blows:
        force[first : first + contact] += size * np.sin(np.pi * (np.arange(contact) + 0.5) / contact)
    motion = np.random.default_rng(2).standard_normal(n)
    return TimeRecord(RATE, np.column_stack([force, motion]), ("1X", "2X"), ("force", "acceleration"))


def found(blows, **more):
    return [one for one in channel_checks(force_of(blows, **more)) if one.kind == "double_hit"]


def test_a_second_blow_right_after_the_first_is_told_with_the_gaps_of_its_spectrum():
    [one] = found([(500, 100.0), (600, 40.0)])
    assert one.channel == "1X+ force"
    assert "hits twice within 0.05 s, at sample 50" in one.words
    assert "with 40 % of that force after it" in one.words
    assert "gaps every 20 Hz" in one.words


@pytest.mark.parametrize(
    "blows", [[(500, 100.0)], [(500, 100.0), (3000, 90.0), (5500, 110.0)], [(500, 100.0), (600, 5.0)]]
)
def test_single_blows_far_apart_and_ripples_are_none(blows):
    assert found(blows) == []


def test_a_random_force_has_no_blows():
    record = force_of([])
    assert not [one for one in channel_checks(record) if one.kind == "double_hit"]
