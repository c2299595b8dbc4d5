"""Each fault is named with channel and remedy; sound records of every kind raise no alarm."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from structid.records import TimeRecord, harmonic_indicator
from structid.records.quality import (
    clipped_samples,
    drop_outs,
    fill_missing,
    local_scale,
    quantum,
    signal_checks,
    spikes,
)

sys.path.append(str(Path(__file__).parents[1] / "modal"))
from modal_cases import ambient_chain, beam_decay

RNG = np.random.default_rng


def kinds(record, band=None):
    return [(finding.kind, finding.channel.partition(" ")[0]) for finding in signal_checks(record, band)]


def only(record, kind, band=None):
    found = [finding for finding in signal_checks(record, band) if finding.kind == kind]
    assert len(found) == 1
    return found[0]


@pytest.fixture(scope="module")
def chain():
    return ambient_chain(0, duration=300.0)


def changed(record, change):
    values = np.array(record.values)
    change(values)
    return replace(record, values=values)


def narrow_band(rng, n, rate, frequencies, damping_ratio, step):
    """A Gaussian signal of lightly damped modes in 2 % noise, standard deviation 1, in steps of `step`."""
    y = np.zeros(n)
    for f in frequencies:
        w = 2 * np.pi * f / rate
        r = np.exp(-damping_ratio * w)
        y += lfilter([1], [1, -2 * r * np.cos(w), r * r], rng.standard_normal(n + 2000))[2000:] * (1 - r)
    y = y / y.std() + 0.02 * rng.standard_normal(n)
    return np.round(y / step) * step if step else y


def hammer(seed, steps):
    """One impact: force, velocity and acceleration, 8 s at 1024 Hz, at rest before it."""
    rng, n = np.random.default_rng(seed), 8192
    force = np.zeros(n)
    at = 100 + rng.integers(200)
    force[at : at + 6] = np.hanning(8)[1:-1] * 1000
    values = np.zeros((n, 3))
    for gain, f, z in ((1, 12, 0.01), (0.8, 60.3, 0.01), (0.5, 130, 0.02)):
        w = 2 * np.pi * f / 1024
        r = np.exp(-z * w)
        a = [1, -2 * r * np.cos(w), r * r]
        values[:, 1] += gain * lfilter([0, 1], a, force)
        values[:, 2] += lfilter([1, -2, 1], a, force)
    values[:, 0] = force + 0.5 * rng.standard_normal(n)
    values[:, 1:] += 1e-4 * values[:, 1:].std(axis=0) * rng.standard_normal((n, 2))
    if steps:
        q = np.abs(values).max(axis=0) / steps
        values = np.round(values / q) * q
    return TimeRecord(1024.0, values, ("1X", "1X", "2X"), ("force", "velocity", "acceleration"))


def test_no_false_alarm_ambient():
    """200 seeded Gaussian records: 120 of the chain (4 channels each), 80 of narrow bands, most of them quantized.

    Spikes and drop-outs are to be reported less than 0.001 times a channel; every kind must stay silent here.
    """
    alarms = [found for seed in range(120) for found in kinds(ambient_chain(seed, duration=120.0))]
    bands = ((1.0, 2.3), (3.0, 9.0, 22.0), (0.5, 0.8), (8.0, 49.0))
    for seed in range(80):
        rng = np.random.default_rng(1000 + seed)
        step, ratio = (0.0, 1e-3, 0.05, 0.3)[seed % 4], (0.005, 0.02)[(seed // 16) % 2]
        y = narrow_band(rng, 8000, 200.0, bands[(seed // 4) % 4], ratio, step)
        alarms += kinds(TimeRecord(200.0, y[:, None], ("1X",), ("velocity",)))
    assert alarms == []


def test_no_false_alarm_hammer_and_decay():
    """Shocks, rings and decays into the last bits of the converter; only the wait before the impact may be noted."""
    for seed in range(20):
        found = kinds(hammer(seed, (0, 2000, 200)[seed % 3]))
        assert {kind for kind, _ in found} <= {"late_start"}
    for settings in ({}, {"noise": 0.05}, {"damping_ratio": 0.01}, {"damping_ratio": 0.05, "noise": 1e-3}):
        assert kinds(beam_decay(**settings)) == []


def test_constant_and_dead_channels_unusable(chain):
    def spoil(values):
        values[:, 1] = 3.25
        values[:, 3] *= 1e-11

    found = signal_checks(changed(chain, spoil))
    assert [(f.kind, f.severity, f.channel) for f in found] == [
        ("constant", "unusable", "2X+ velocity"), ("dead", "unusable", "4X+ velocity"),
    ]  # fmt: skip
    assert "3.25 at every sample" in found[0].words
    assert all("`channels`" in f.words for f in found)


def test_level_far_from_others(chain):
    def spoil(values):
        values[:, 2] *= 500

    assert kinds(changed(chain, spoil)) == [("level", "3X+")]


@pytest.mark.parametrize("step", [0.0, 1e-3, 0.05])
def test_clipping_found_with_its_share(chain, step):
    def spoil(values):
        y = np.clip(values[:, 0], -1.5 * values[:, 0].std(), 1.2 * values[:, 0].std())
        values[:, 0] = np.round(y / step) * step if step else y

    record = changed(chain, spoil)
    finding = only(record, "clipped")
    y = record.values[:, 0]
    share = np.mean((y == y.max()) | (y == y.min()))
    assert f"{share:.2%}" in finding.words
    assert finding.severity == "unusable"  # more than 5 %
    assert np.array_equal(clipped_samples(y), (y == y.max()) | (y == y.min()))


def test_clipped_impact_of_five_samples():
    def spoil(values):
        top = int(values[:, 0].argmax())
        values[top - 2 : top + 3, 0] = 700.0

    record = changed(hammer(1, 2000), spoil)
    assert only(record, "clipped").channel == "1X+ force"
    at = np.flatnonzero(clipped_samples(record.values[:, 0]))
    assert np.diff(at).tolist() == [1] * 4


def test_drop_outs_found_exactly(chain):
    def spoil(values):
        values[500:520, 1] = values[499, 1]
        values[900:908, 1] = 0.0

    record = changed(chain, spoil)
    assert drop_outs(record.values[:, 1]) == [(499, 520), (900, 908)]
    finding = only(record, "drop_out")
    assert "2 times, 29 samples" in finding.words
    assert '`Preparation(dropouts="replace")`' in finding.words


def test_drop_out_in_coarse_steps():
    y = narrow_band(np.random.default_rng(5), 8000, 200.0, (3.0, 9.0), 0.02, 0.05)
    assert drop_outs(y) == []
    y[4000:4300] = y[4000]
    assert [start for start, stop in drop_outs(y) if stop - start > 250]


def test_cable_lost_until_the_end(chain):
    def spoil(values):
        values[2500:, 0] = values[2500, 0]

    assert only(changed(chain, spoil), "drop_out").severity == "unusable"


def test_spikes_found_where_they_are():
    y = narrow_band(np.random.default_rng(2), 8000, 200.0, (3.0, 9.0), 0.01, 0.0)
    y[1000] += 3.0
    y[3000:3002] -= 3.0
    y[5000:5003] += 4.0
    assert np.flatnonzero(spikes(y)).tolist() == [1000, 3000, 3001, 5000, 5001, 5002]


def test_spikes_not_steps_kinks_or_rings():
    """A step, a change of slope, a short ring, and a burst of pulses six samples apart are no spikes."""
    n = np.arange(4000)
    noise = 1e-3 * np.random.default_rng(3).standard_normal(4000)
    step, kink = (n > 2000) * 1.0, np.maximum(n - 2000, 0) * 0.05
    ring = np.where(n > 2000, np.exp(-(n - 2000) / 15.0) * np.sin((n - 2000) * 0.8), 0.0)
    burst = ((n > 2000) & (n < 2040) & (n % 6 == 0)) * 1.0
    for signal in (step, kink, ring, burst):
        assert not spikes(signal + noise).any()
    assert spikes(noise + (n == 2004)).sum() == 1


def test_spike_scale_is_that_of_the_loudest_neighbour():
    """Standard deviation 1 in samples 640 to 703 only: the block before and after take it, to 25 % (64 samples)."""
    e = 1e-3 * RNG(8).standard_normal(1300)
    e[640:704] *= 1e3
    scale = local_scale(e)
    assert (scale[576:768] == scale[640]).all()
    assert scale[640] == pytest.approx(1, rel=0.25)
    assert scale[[575, 768]] == pytest.approx(1e-3, rel=0.5)


def test_short_record_by_band_and_by_spectrum(chain):
    assert kinds(chain, (0.03, 4.0)) == [("short", "")]
    assert "9 periods" in only(chain, "short", (0.03, 4.0)).words
    assert only(chain, "short", (0.008, 4.0)).severity == "unusable"
    drifting = replace(chain, values=chain.values + np.linspace(0, 40, len(chain.values))[:, None])
    assert kinds(drifting) == [("short", "")]
    assert kinds(replace(chain, values=chain.values[:40])) == [("short", "")]


def test_aliasing_suspected_without_a_filter(chain):
    white = np.random.default_rng(4).standard_normal((3000, 4))
    finding = only(replace(chain, values=white), "aliasing")
    assert "4 of 4 channels" in finding.words


@pytest.mark.parametrize("line", [50.02, 59.97, 100.03])
def test_mains_line_named(line):
    record = ambient_chain(3, duration=120.0, rate=500.0)
    assert kinds(record) == []
    hum = 0.05 * np.sin(2 * np.pi * line * record.time + 0.3)
    finding = only(replace(record, values=record.values + hum[:, None] * record.values.std(axis=0)), "mains")
    assert f"at {round(line)} Hz" in finding.words


def test_harmonic_indicator_tells_mode_from_harmonic():
    """1.5 for a harmonic, 3 for a mode: half-power width 1 Hz over 120 s, so within 0.6 of it."""
    rng = np.random.default_rng(6)
    mode = narrow_band(rng, 60000, 500.0, (50.0,), 0.01, 0.0)
    tone = np.sin(2 * np.pi * 50.0 * np.arange(60000) / 500.0 + 0.2) + 0.05 * rng.standard_normal(60000)
    record = TimeRecord(500.0, np.stack([mode, tone], axis=1), ("1X", "2X"), ("velocity",) * 2)
    indicator = harmonic_indicator(record, 50.0, width=2.0)
    assert abs(indicator[0] - 3) < 0.6
    assert abs(indicator[1] - 1.5) < 0.02
    with pytest.raises(ValueError, match="`frequency` must lie"):
        harmonic_indicator(record, 249.9, width=2.0)


def test_filled_reproduces_cubics():
    """Exact for a cubic with two samples on either side, for every length of the gap."""
    t = np.linspace(-1, 1, 60)
    y = 2 * t**3 - t**2 + 3 * t - 1
    missing = np.zeros(60, dtype=bool)
    missing[[10, 20, 21, 40, 41, 42, 43, 44]] = True
    spoiled = np.where(missing, np.nan, y)
    assert np.abs(fill_missing(spoiled, missing) - y).max() < 1e-12
    missing[:3] = True
    assert (fill_missing(np.where(missing, np.nan, y), missing)[:3] == y[3]).all()


def test_quantum_is_the_step():
    y = np.round(np.random.default_rng(7).standard_normal(500) / 0.05) * 0.05 + 0.3
    assert quantum(y) == pytest.approx(0.05, rel=1e-9)
