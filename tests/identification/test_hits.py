"""FRFs of a record of one hit, against those of the structure that made it."""

import numpy as np
import pytest

from structid import TimeRecord
from structid.identification.setups.time import frfs_of

RATE, COUNT, BEFORE = 512.0, 1024, 30
MASS, STIFFNESS = np.diag([2.0, 3.0]), np.array([[9e4, -4e4], [-4e4, 4e4]])


def accelerance(s):
    """Of force at 1X, with damping C, by its definition, (n, 2)."""
    s = np.asarray(s)[:, None, None]
    return (s**2 * np.linalg.inv(s**2 * MASS + s * DAMPING + STIFFNESS))[:, :, 0]


DAMPING = 2e-4 * STIFFNESS + 0.5 * MASS


def hit(noise=0.0, seed=0, hits=1):
    """Half a sine of eight samples; the response by transforms so long that all motion has died out."""
    long = 1 << 16
    force = np.zeros(long)
    for k in range(hits):
        force[BEFORE + 400 * k : BEFORE + 400 * k + 8] = 100 * np.sin(np.pi * (np.arange(8) + 0.5) / 8)
    lines = 2j * np.pi * np.fft.rfftfreq(long, 1 / RATE)
    h = accelerance(lines)
    h[0] = 0
    motion = np.fft.irfft(h * np.fft.rfft(force)[:, None], long, axis=0)
    values = np.column_stack([force, motion])[:COUNT]
    std = noise * values.std(axis=0)
    values = values + std * np.random.default_rng(seed).standard_normal(values.shape)
    variance = std**2 if noise else None
    return TimeRecord(RATE, values, ("1X", "1X", "2X"), ("force", "acceleration", "acceleration"), variance=variance)


def test_one_hit_gives_the_frfs_of_the_structure_at_the_decay_of_its_window():
    shown = frfs_of(hit())
    assert shown.decay is not None
    assert shown.decay[0] > 0  # the motion has not died out after two seconds
    exact, found = accelerance(shown.laplace), shown.values[:, :, 0]
    low = shown.frequency < 60
    assert low.sum() > 100
    assert np.abs(found - exact)[low].max() < 0.003 * np.abs(exact).max()
    assert np.median(np.abs(found / exact - 1)[low]) < 0.003


def test_the_variance_of_frfs_of_a_hit_is_that_of_repeated_hits():
    exact = accelerance(frfs_of(hit(0.01)).laplace)
    shown = [frfs_of(hit(0.01, seed)) for seed in range(60)]
    errors = np.array([one.values[5:100, :, 0] - exact[5:100] for one in shown])
    ratio = (np.abs(errors) ** 2).mean(axis=0) / shown[0].variance[5:100, :, 0]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("other", ["two hits", "motion before"])
def test_other_records_are_averaged(other):
    record = hit(hits=2) if other == "two hits" else hit()
    if other == "motion before":
        values = np.array(record.values)
        values[:, 1] += np.sin(np.arange(COUNT)) * values[:, 1].std()
        record = TimeRecord(RATE, values, record.channels, record.quantities)
    assert frfs_of(record).decay is None


@pytest.mark.parametrize("seed", [34, 184, 258])
def test_a_hit_that_is_hardly_above_its_noise_is_shown_by_segments(seed):
    """One sample of force, six deviations of its noise high: in these three of 300 seeds no line has more power than noise."""
    std = np.array([0.17, 1e-4])
    force, motion = np.zeros(2000), np.zeros(2000)
    force[100] = 1.0
    motion[100:] = np.exp(-0.005 * np.arange(1900)) * np.sin(0.1 * np.pi * np.arange(1900))
    values = np.column_stack([force, motion]) + std * np.random.default_rng(seed).standard_normal((2000, 2))
    shown = frfs_of(TimeRecord(1000.0, values, ("1X", "2X"), ("force", "acceleration"), variance=std**2))
    assert shown.decay is None
    assert shown.frequency.size > 0
