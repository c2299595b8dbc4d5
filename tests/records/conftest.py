"""Random records for the laws of this folder."""

import numpy as np
import pytest

from structid.records import FrfRecord, TimeRecord


@pytest.fixture
def rng():
    return np.random.default_rng(20240611)


@pytest.fixture
def frf(rng):
    shape = (7, 3, 2)
    return FrfRecord(
        frequency=1 + 0.5 * np.arange(7),
        values=rng.normal(size=shape) + 1j * rng.normal(size=shape),
        outputs=("1X-", "2RZ+", "12Z-"),
        inputs=("3Z-", "4RX+"),
        kind="mobility",
        variance=rng.uniform(size=shape),
        coherence=rng.uniform(size=shape),
        averages=12,
        noise_source="coherence",
        source="hammer, Äpfel  ",
    )


@pytest.fixture
def history(rng):
    return TimeRecord(
        sampling_rate=1200.0,
        values=rng.normal(size=(50, 3)),
        channels=("1X-", "2RZ+", "1X-"),
        quantities=("acceleration", "velocity", "force"),
        variance=rng.uniform(size=3),
        start=1 / 3,
        source=" shaker ",
    )
