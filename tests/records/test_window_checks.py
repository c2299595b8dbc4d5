"""Leakage of averaged spectra: told where a window blurs resonances or segments leak, silent where they do not."""

import numpy as np
import pytest
from scipy.signal import lfilter

from structid.records import TimeRecord, frf_from_time
from structid.records.quality import drifts, leakage

RATE, NATURAL, RATIO = 256.0, np.array([20.0]), np.array([0.01])


def shaken(force, seed=0):
    """One mode at 20 Hz with 1 % of critical damping under a force, 1 % noise on the motion."""
    w = 2 * np.pi * NATURAL[0] / RATE
    r = np.exp(-RATIO[0] * w)
    motion = lfilter([0, 1], [1, -2 * r * np.cos(w), r * r], force)
    motion = motion + 0.01 * motion.std() * np.random.default_rng(seed + 99).standard_normal(len(motion))
    return TimeRecord(RATE, np.stack([force, motion], axis=1), ("1X", "1X"), ("force", "displacement"))


def noise(seconds, seed=0):
    return np.random.default_rng(seed).standard_normal(int(seconds * RATE))


def test_the_blur_of_a_window_is_that_of_the_peak_that_it_makes():
    """With segments of 8 s the power spectrum of one mode, smoothed by that of the window, is lower by what the words say."""
    words = leakage(shaken(noise(60)), 2048, "hann", NATURAL, RATIO)
    assert "window 'hann' lowers the peak at 20 Hz" in words
    assert "(3.2 lines in its half-power bandwidth)" in words
    said = float(words.split("by about ")[1].split(" %")[0]) / 100
    window = abs(np.fft.rfft(np.hanning(2049)[:-1], 64 * 2048)) ** 2
    step = RATE / (64 * 2048)
    offset = step * np.arange(20 * 64)
    both = np.concatenate([window[: 20 * 64][::-1], window[1 : 20 * 64]])
    around = np.concatenate([-offset[::-1], offset[1:]])
    peak = 1 / (1 + (around / (RATIO[0] * NATURAL[0])) ** 2)
    assert said == pytest.approx(1 - (peak * both).sum() / both.sum(), rel=0.02)


def test_segments_longer_than_the_record_are_not_asked_for():
    words = leakage(shaken(noise(20)), 512, "hann", NATURAL, RATIO)
    assert "take segments" not in words
    assert "(the record has 5120)" in words


def test_segments_as_long_as_asked_for_are_silent():
    record = shaken(noise(400))
    words = leakage(record, 2048, "hann", NATURAL, RATIO)
    needed = int(words.split("segments of ")[1].split(" samples")[0])
    assert leakage(record, needed, "hann", NATURAL, RATIO) == ""
    assert leakage(record, int(0.8 * needed), "hann", NATURAL, RATIO) != ""


def test_no_window_is_right_for_periods_and_for_impacts_and_wrong_for_noise():
    length = 1024
    periodic = np.tile(noise(length / RATE), 8)
    settled = shaken(np.tile(noise(length / RATE), 12))
    settled = TimeRecord(RATE, settled.values[4 * length :], settled.channels, settled.quantities)
    assert leakage(settled, length, "boxcar", NATURAL, RATIO) == ""
    impact = np.zeros(4 * 8192)
    impact[200::8192] = 1.0
    assert leakage(shaken(impact), 8192, "boxcar", NATURAL, RATIO) == ""
    words = leakage(shaken(noise(len(periodic) / RATE)), length, "boxcar", NATURAL, RATIO)
    assert "segments neither repeat nor rest at their ends" in words
    assert leakage(settled, length, ("exponential", 0.0, 200.0), NATURAL, RATIO) == ""
    assert leakage(settled, length, "hann", NATURAL[:0], RATIO[:0]) == ""


def test_leakage_is_what_shows_in_the_damping_of_the_averaged_frf():
    """The half-power bandwidth of H1 is 8 % too wide or more where it is told, and right where it is not."""

    def width(length):
        record = frf_from_time(shaken(noise(8000, 3)), ["1X"], ["1X"], segment_length=length)
        size = abs(record.values[:, 0, 0]) ** 2
        above = record.frequency[size > size.max() / 2]
        return above[-1] - above[0]

    assert leakage(shaken(noise(60)), 1024, "hann", NATURAL, RATIO)
    assert width(1024) > 1.08 * 0.4
    assert leakage(shaken(noise(60)), 8192, "hann", NATURAL, RATIO) == ""
    assert width(8192) == pytest.approx(0.4, rel=0.08)


def drifting(share, seed=0):
    """A mode under noise, and a slow bend of so much of its power."""
    y = shaken(noise(60, seed)).values[:, 1]
    slow = np.sin(np.pi * np.arange(len(y)) / len(y))
    slow -= slow.mean()
    y = y + slow * np.sqrt(share * y.var() / slow.var())
    return TimeRecord(
        RATE, np.stack([y, shaken(noise(60, seed + 1)).values[:, 1]], axis=1), ("1X", "2X"), ("velocity",) * 2
    )


def test_a_drift_is_told_with_its_share():
    found = drifts(drifting(0.2))
    assert [one.channel for one in found] == ["1X+ velocity"]
    assert "`detrend`" in found[0].words
    share = float(found[0].words.split("drifts: ")[1].split("%")[0]) / 100
    assert share == pytest.approx(0.2 / 1.2, rel=0.05)


def test_no_drift_is_told_where_there_is_none():
    assert [one.kind for seed in range(60) for one in drifts(drifting(0.0, seed))] == []
    impact = np.zeros(8192)
    impact[100] = 1.0
    assert drifts(shaken(impact)) == ()
