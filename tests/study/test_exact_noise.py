"""Noise that a study states of histories: variances of an absolute and a relative part add."""

from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np

from structid import TimeRecord
from structid.identification.setups.time import TimeFit
from structid.study.schema.records.histories import TimeSource


def test_absolute_and_relative_noise_add_as_variances():
    """A relative part is one of the root mean square of the channel."""
    section = SimpleNamespace(located=lambda name: nullcontext())
    values = np.array([[3.0, 1.0], [-1.0, 2.0], [2.0, -2.0]])
    record = TimeRecord(10.0, values, ["1X", "2X"], ["force", "velocity"])
    noisy = TimeSource(section, (0.2,), (0.05, 0.1), TimeFit()).with_noise([record])
    np.testing.assert_allclose(noisy.variance, [0.04 + 0.05**2 * 14 / 3, 0.04 + 0.1**2 * 9 / 3], rtol=1e-12)
