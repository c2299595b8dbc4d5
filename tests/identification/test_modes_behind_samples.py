"""Modes above half the sampling rate, which forces straight between samples excite: they are told of."""

import numpy as np
import pytest

from short_record_cases import SENSORS, chain, unknowns
from structid import IdentifyOptions, TimeFit, TimeRecord, TimeSetup

#: Hz, of four equal masses of 2 kg on springs of 1000 N/m, held at one end: in closed form.
NATURAL = np.sqrt(1000.0 / 2.0) * 2 * np.sin(np.pi * (2 * np.arange(1, 5) - 1) / 18) / (2 * np.pi)


def warnings_at(rate, hold):
    values = np.random.default_rng(0).standard_normal((200, 3))
    record = TimeRecord(rate, values, ("4X", *SENSORS), ("force", "acceleration", "acceleration"), variance=np.ones(3))
    setup = TimeSetup(chain(), unknowns(chain()), record, TimeFit(hold=hold))
    return [words for words in setup.prepared(IdentifyOptions()).warnings if "half the sampling rate" in words]


@pytest.mark.parametrize("count", [1, 3])
def test_modes_above_half_the_rate_are_counted(count):
    lowest = NATURAL[-count]
    [words] = warnings_at(2 * 0.95 * lowest, "first")
    assert f"the model has {count} such mode" in words
    assert f"the lowest at {lowest:.4g} Hz" in words


def test_nothing_is_said_of_filtered_forces_or_of_modes_below():
    assert warnings_at(2 * 0.95 * NATURAL[-3], "band_limited") == []
    assert warnings_at(2 * 1.05 * NATURAL[-1], "first") == []
