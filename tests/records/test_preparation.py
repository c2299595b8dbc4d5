"""Preparation keeps the poles, says every step, refuses what cannot be, and meets the published modes of a building."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import freqz

from structid import InputError, Preparation, prepare
from structid.dynamics.transient import free_decay
from structid.modal import identify_modes
from structid.records import TimeRecord
from structid.records.preparation import band_filter, decimation_filter, rate_ratio

PALISADEN = Path(__file__).parents[3] / "shared" / "data" / "palisaden_building"
RNG = np.random.default_rng


def decay(rate=100.0, duration=30.0):
    """Displacements at four places of three modes in free decay: 1.1, 3.7 and 6.2 Hz, damping 0.5 %."""
    omega = 2 * np.pi * np.array([1.1, 3.7, 6.2])
    shapes = np.array([[1.0, 1, 1], [0.6, -1, 0.2], [0.3, 0.4, -1], [1, -0.2, 0.7]])
    time = np.arange(round(duration * rate)) / rate
    motion = free_decay(omega, shapes, time, velocity=shapes[0] * omega, damping_ratio=0.005)[0]
    return TimeRecord(rate, motion, [f"{i}Y" for i in range(1, 5)], ["displacement"] * 4), omega


def errors(record, omega, order):
    modes = identify_modes(record, orders=[order], n_pieces=0)
    near = np.abs(modes.omega[:, None] - omega).argmin(axis=0)
    return np.abs(modes.omega[near] / omega - 1).max(), np.abs(modes.damping_ratio[near] / 0.005 - 1).max()


def noise(n=4000, rate=100.0, seed=1, channels=("1X", "2X"), **more):
    values = RNG(seed).standard_normal((n, len(channels)))
    return TimeRecord(rate, values, channels, ("velocity",) * len(channels), **more)


@pytest.mark.parametrize("detrend, extra", [("none", 0), ("mean", 1), ("linear", 2), (3, 4)])
def test_decimation_and_detrend_keep_poles(detrend, extra):
    """Exact: the decay passes a FIR filter as z^t; a trend of degree p adds p + 1 poles at 0 that need room in the order."""
    record, omega = decay()
    prepared = prepare(record, Preparation(sampling_rate=20.0, detrend=detrend))
    frequency, damping = errors(prepared.record, omega, 6 + extra)
    assert frequency < 1e-11
    assert damping < 1e-9


def test_rational_rate_keeps_poles_within_its_images():
    """Seven samples for every 20: what is left of the images is 80 dB down."""
    record, omega = decay()
    prepared = prepare(record, Preparation(sampling_rate=35.0, detrend="none"))
    assert prepared.record.sampling_rate == 35.0
    frequency, damping = errors(prepared.record, omega, 6)
    assert frequency < 1e-5
    assert damping < 2e-3


def test_band_keeps_poles_of_a_decay():
    record, omega = decay()
    prepared = prepare(record, Preparation(band=(0.8, 9.0), detrend="none"))
    frequency, damping = errors(prepared.record, omega, 6)
    assert frequency < 1e-9
    assert damping < 1e-9


def test_kept_edges_spoil_damping():
    """Why edges are dropped: with them the record starts and ends in what the filter makes of a cut decay."""
    record, omega = decay(duration=15.0)
    kept = prepare(record, Preparation(band=(0.8, 9.0), detrend="none", edges="keep"))
    assert len(kept.record.values) == len(record.values)
    assert errors(kept.record, omega, 6)[1] > 1e-3
    assert "kept at either end, with edge effects" in kept.steps[0]


def test_samples_stay_at_their_times():
    """A slow sine at the times of the record, whatever was dropped."""
    time = np.arange(3000) / 100 + 7.0
    record = TimeRecord(100.0, np.sin(2 * np.pi * 1.5 * time)[:, None], ("1X",), ("velocity",), start=7.0)
    for preparation in (
        Preparation("none", sampling_rate=20.0),
        Preparation("none", sampling_rate=30.0),
        Preparation("none", band=(0.7, 10.0)),
        Preparation("none", interval=(9.0, 31.0), band=(None, 4.0), sampling_rate=25.0),
    ):
        result = prepare(record, preparation).record
        assert np.abs(result.values[:, 0] - np.sin(2 * np.pi * 1.5 * result.time)).max() < 2e-3
        assert result.start > 7.0


def test_steps_in_words_with_numbers():
    prepared = prepare(
        noise(),
        Preparation("linear", (1.0, 6.0), 20.0, (2.0, 36.0), ("2X",), outliers="none"),
    )
    assert prepared.steps == (
        "kept 1 of 2 channels: 2X+",
        "cut to 2-36 s, 3401 of 4000 samples",
        "straight line taken off each channel",
        "decimated by 5 to 20 Hz (FIR of 267 taps, flat to 8 Hz, -3 dB at 8.81 Hz, -80 dB from 10 Hz on); 1.33 s dropped at "
        "either end",
        "band-pass filtered, flat within 1-6 Hz (FIR of 217 taps without delay, -3 dB at 0.805 Hz and 6.59 Hz); 5.4 s "
        "dropped at either end",
    )
    assert [f.kind for f in prepared.findings] == ["aliasing", "filter"]


def test_filters_keep_their_word():
    """0.001 dB and 80 dB of the decimation, 0.01 dB and 60 dB of the band, on a dense grid."""
    fir = decimation_filter(100.0, rate_ratio(100.0, 20.0))
    lines, response = freqz(fir.taps, worN=20000, fs=100.0)
    level = 20 * np.log10(np.abs(response) + 1e-15)
    assert np.abs(level[lines <= 8]).max() < 1e-3
    assert level[lines >= 10].max() < -80
    lines, response = freqz(band_filter(1.0, 6.0, 20.0).taps, worN=20000, fs=20.0)
    level = 20 * np.log10(np.abs(response) + 1e-15)
    assert np.abs(level[(lines >= 1) & (lines <= 6)]).max() < 0.01
    assert max(level[lines <= 0.5].max(), level[lines >= 7.5].max()) < -60


@pytest.mark.parametrize(
    "preparation",
    [
        Preparation(3), Preparation("none", sampling_rate=20.0), Preparation("none", sampling_rate=30.0),
        Preparation("none", band=(5.0, 20.0)),
    ],
)  # fmt: skip
def test_noise_variance_carried(preparation):
    """The variance declared for white noise is that of the samples after the steps, to 3 % (chance: 1 % in 2e4 samples)."""
    record = replace(noise(60000, channels=("1X", "2X", "3X")), variance=np.ones(3))
    result = prepare(record, preparation).record
    assert result.variance == pytest.approx(result.values.var(axis=0).mean(), rel=0.03)


def test_repairs_are_counted_and_close():
    time = np.arange(6000) / 100
    clean = np.sin(2 * np.pi * 2 * time) + 0.5 * np.sin(2 * np.pi * 3.3 * time) + 1e-3 * RNG(2).standard_normal(6000)
    spoiled = np.array(clean)
    spoiled[1000] += 5
    spoiled[2000:2008] = spoiled[1999]  # nine samples of one value, the first of them true
    spoiled[4000:4100] = 0.0
    record = TimeRecord(100.0, spoiled[:, None], ("1X",), ("velocity",))
    reported = prepare(record, Preparation("none"))
    assert [f.kind for f in reported.findings] == ["drop_out", "spikes"]
    assert np.array_equal(reported.record.values, record.values)
    prepared = prepare(record, Preparation("none", outliers="replace", dropouts="replace"))
    assert prepared.steps == (
        "9 of 6000 samples of channel 1X+ velocity invented: drop-outs, by cubic interpolation",
        "1 drop-outs of channel 1X+ velocity left as they are, 100 samples: longer than 10 samples each; cut them with "
        "`interval`",
        "1 of 6000 samples of channel 1X+ velocity invented: spikes, by cubic interpolation",
    )
    error = np.abs(prepared.record.values[:, 0] - clean)
    assert np.delete(error, np.arange(4000, 4100)).max() < 0.03
    quiet = prepare(record, Preparation("none", outliers="none", dropouts="none"))
    assert quiet.findings == ()


@pytest.mark.parametrize(
    "settings, word",
    [
        ({"band": (1.0, 60.0)}, r"`band` must end below 50 Hz, half the record's sampling rate of 100 Hz, got 60 Hz"),
        (
            {"band": (1.0, 9.0), "sampling_rate": 20.0},
            r"`sampling_rate` must be at least 22.5 Hz for a band up to 9 Hz",
        ),
        ({"band": (70.0, None)}, "must end below 50 Hz"),
        ({"sampling_rate": 200.0}, "at most 100 Hz, the record's own, got 200 Hz"),
        ({"sampling_rate": 100 / np.pi}, "ratio of whole numbers up to 1000"),
        ({"interval": (50.0, 60.0)}, r"`interval` must keep at least 16 samples of 0-39.99 s"),
        ({"channels": ("7Z",)}, r"`channels` must name channels of the record, got 7Z\+; it has 1X\+, 2X\+"),
        ({"band": (0.01, None)}, "too short for a filter of"),
    ],
)
def test_refused_with_numbers(settings, word):
    with pytest.raises(InputError, match=word):
        prepare(noise(), Preparation(**settings))


@pytest.mark.parametrize("seconds", [5.33, 5.35, 6.5])
def test_a_record_that_decimation_leaves_too_few_samples_of_is_refused(seconds):
    """The filter takes 5.3 s: what is left counts at the new rate."""
    values = np.random.default_rng(0).standard_normal((round(1000 * seconds), 1))
    short = TimeRecord(1000.0, values, ["1X"], ["acceleration"])
    with pytest.raises(InputError, match="too short for a filter of"):
        prepare(short, Preparation(sampling_rate=10.0))


def test_kept_edges_count_among_the_samples_that_decimation_leaves():
    """The filter takes 5.3 s: the record must be longer, no more."""
    values = np.random.default_rng(0).standard_normal((6000, 1))
    kept = Preparation(sampling_rate=10.0, edges="keep")
    assert len(prepare(TimeRecord(1000.0, values, ["1X"], ["acceleration"]), kept).record.values) == 60
    with pytest.raises(InputError, match=r"too short for a filter of .* leaves 16 samples at 10 Hz"):
        prepare(TimeRecord(1000.0, values[:5000], ["1X"], ["acceleration"]), kept)


@pytest.mark.parametrize(
    "settings",
    [
        {"detrend": "median"}, {"detrend": 11}, {"detrend": True}, {"band": (3.0, 1.0)}, {"band": (-1.0, 1.0)},
        {"interval": (1.0,)}, {"outliers": "remove"}, {"dropouts": ""}, {"edges": "mirror"}, {"longest_gap": 0},
    ],
)  # fmt: skip
def test_settings_refused(settings):
    with pytest.raises(InputError, match=f"`{next(iter(settings))}`"):
        Preparation(**settings)


@pytest.mark.skipif(not PALISADEN.exists(), reason="the building's data are not part of the package")
@pytest.mark.parametrize("method", ["ssi_cov", "pencil"])
def test_palisaden_building_from_100_hz(method):
    """Aloisio et al. (2020), 1.882, 2.422 and 2.687 Hz to 0.5 %: twenty minutes at 100 Hz decimated to 20 Hz."""
    values = np.load(PALISADEN / "acc_100Hz_first20min.npy")
    record = TimeRecord(100.0, values, [f"{i}X" for i in range(1, 7)], ["acceleration"] * 6)
    prepared = prepare(record, Preparation("linear", sampling_rate=20.0))
    assert prepared.findings == ()
    modes = identify_modes(prepared.record, method=method, n_pieces=0)
    for published in (1.882, 2.422, 2.687):
        assert np.abs(modes.frequency / published - 1).min() < 0.005


def test_damaged_channels_named():
    record = noise()
    values = np.array(record.values)
    values[:, 1] = 0
    prepared = prepare(replace(record, values=values))
    assert (prepared.findings[0].kind, prepared.findings[0].channel) == ("constant", "2X+ velocity")
