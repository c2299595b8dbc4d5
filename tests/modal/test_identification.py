"""Modes from free and ambient records by every method: exactness, noise, close modes, many modes, bad input."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from modal_cases import ambient_chain, beam_decay, chain_modes, decay, nearest
from scipy.signal import lfilter

from structid import InputError, TimeRecord
from structid.modal import HardCriteria, identify_modes, modal_identification
from structid.modal.poles.stabilization import mode_probability
from structid.reproduce.chapter_5 import SENSORS, beam_omega, beam_shapes
from structid.similarity import mac

PALISADEN = Path(__file__).parents[3] / "shared" / "data" / "palisaden_building"
FREE = ("pencil", "ssi_data")


@pytest.mark.parametrize("method", FREE)
@pytest.mark.parametrize("ratio", [0.0, 0.005])
def test_free_decay_is_exact_without_noise(method, ratio):
    """1e-10 in frequency and 1e-9 in the damping ratio: rounding times the condition of slow modes."""
    found = identify_modes(beam_decay(damping_ratio=ratio), method, orders=[20], block_rows=20, n_pieces=0)
    assert found.n_modes == 10
    assert np.abs(found.omega / beam_omega(10) - 1).max() <= 1e-10
    assert np.abs(found.damping_ratio - ratio).max() <= 1e-9
    assert len(found.channels) == 10
    assert (1 - np.diag(mac(found.mode_shapes, beam_shapes(SENSORS, 10)))).max() <= 1e-10


def test_free_decay_is_found_by_itself_without_noise():
    found = identify_modes(beam_decay(damping_ratio=0.005), n_pieces=0)
    assert found.n_modes == 10
    assert np.abs(found.omega / beam_omega(10) - 1).max() <= 1e-10


@pytest.mark.parametrize("kinds", [(0,), (1,), (2,), (0, 1, 2)])
def test_any_quantities_serve(kinds):
    found = identify_modes(beam_decay(damping_ratio=0.01, kinds=kinds), orders=[20], block_rows=20, n_pieces=0)
    assert np.abs(found.omega / beam_omega(10) - 1).max() <= 1e-7
    assert (1 - np.diag(mac(found.mode_shapes, beam_shapes(SENSORS, 10)))).max() <= 1e-7


@pytest.mark.parametrize(("noise", "frequency_bar", "damping_bar"), [(0.01, 1e-4, 0.02), (0.05, 5e-4, 0.05)])
def test_noise_bars_of_the_pencil(noise, frequency_bar, damping_bar):
    """Root mean square over three seeds of modes 1-5 and 6-10; median of the damping errors over zeta."""
    errors, ratios = [], []
    for seed in range(3):
        found = identify_modes(beam_decay(noise, 0.005, seed), orders=[24], block_rows=20, n_pieces=0)
        near = nearest(found.omega, beam_omega(10))
        errors.append(found.omega[near] / beam_omega(10) - 1)
        ratios.append(np.abs(found.damping_ratio[near] / 0.005 - 1))
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.sqrt(np.mean(rms[:5] ** 2)) <= frequency_bar
    assert np.sqrt(np.mean(rms[5:] ** 2)) <= frequency_bar
    assert np.median(ratios) <= damping_bar


def test_modes_in_noise_are_found_by_themselves():
    found = identify_modes(beam_decay(0.01, 0.005, 1), n_pieces=0)
    assert found.n_modes == 10
    assert np.abs(found.omega / beam_omega(10) - 1).max() <= 5e-4


@pytest.mark.parametrize("ratio", [0.0, 0.002])
def test_two_close_modes_part_within_a_tenth_of_a_beat(ratio):
    """2.000 and 2.002 Hz in 50 s; 1e-10 of the frequency, 1e-7 of the gap."""
    frequency = np.array([0.7, 1.3, 2.0, 2.002, 3.1, 4.0])
    shapes = np.random.default_rng(5).standard_normal((6, 6))
    record = decay(2 * np.pi * frequency, shapes, 50.0, 0.05, velocity=np.ones(6), damping_ratio=ratio)
    found = identify_modes(record, orders=[12], block_rows=20, n_pieces=0)
    assert np.abs(found.frequency / frequency - 1).max() <= 1e-10
    assert (1 - np.diag(mac(found.mode_shapes, shapes))).max() <= 1e-8


def test_two_close_modes_part_in_noise():
    """0.1 % noise, 150 x 20 delays: the gap within 5 %, five times the figure of one seed."""
    frequency = np.array([0.7, 1.3, 2.0, 2.002, 3.1, 4.0])
    shapes = np.random.default_rng(5).standard_normal((6, 6))
    record = decay(2 * np.pi * frequency, shapes, 50.0, 0.05, noise=0.001, velocity=np.ones(6))
    found = identify_modes(record, orders=[12], block_rows=100, n_pieces=0)
    assert np.diff(found.frequency)[2] == pytest.approx(0.002, rel=0.05)


def test_more_modes_than_sensors():
    """Fifteen modes, of which the eleventh moves no sensor: fourteen from ten channels."""
    seen = np.delete(np.arange(15), 10)
    found = identify_modes(beam_decay(kinds=(0,), n_modes=15), orders=[28], block_rows=20, n_pieces=0)
    assert found.n_modes == 14
    assert np.abs(found.omega / beam_omega(15)[seen] - 1).max() <= 1e-8


def test_two_records_part_a_repeated_frequency():
    omega = np.array([2.0, 3.1, 3.1, 7.0])
    shapes = np.random.default_rng(2).standard_normal((4, 4))
    records = [
        decay(omega, shapes, 20.0, 0.05, velocity=np.array(v), damping_ratio=0.01)
        for v in ([1.0, 1.0, 0.5, 1.0], [-1.0, 0.3, -2.0, 0.4])
    ]
    found = identify_modes(records, orders=[8], block_rows=10, n_pieces=0)
    assert np.abs(found.omega / omega - 1).max() <= 1e-9


@pytest.mark.parametrize("method", ["pencil", "ssi_cov", "ssi_data"])
def test_ambient_modes_are_found_by_themselves(method):
    omega, shapes = chain_modes()
    found = identify_modes(ambient_chain(4), method, n_pieces=0)
    assert found.n_modes == 4 or method == "ssi_data"  # which is less smooth, and shows a fifth here
    near = nearest(found.omega, omega)
    assert np.abs(found.omega[near] / omega - 1).max() <= 0.01
    assert np.diag(mac(found.mode_shapes[:, near], shapes)).min() >= 0.98


def test_modes_are_chosen_by_frequency():
    found = identify_modes(ambient_chain(4), frequencies=[1.6, 3.0], n_pieces=0)
    assert found.frequency == pytest.approx([1.592, 2.991], rel=0.01)
    far = identify_modes(ambient_chain(4), frequencies=[1.5], n_pieces=0)
    assert any("nearest to 1.5 Hz" in note for note in far.warnings)


def test_palisaden_building_shows_its_three_modes():
    """Within 0.5 % of the published frequencies, by the default settings."""
    path = PALISADEN / "acc_20Hz_full90min.npy"
    if not path.exists():
        pytest.skip("the ambient record of the Palisaden building is not part of the package: shared/data is missing")
    values = np.load(path).astype(float)
    record = TimeRecord(20.0, values, ("1X", "1Y", "2X", "2Y", "3X", "3Y"), ("acceleration",) * 6)
    found = identify_modes(record)
    published = np.array([1.882, 2.422, 2.687])
    low = found.frequency[found.frequency < 3.0]
    assert low == pytest.approx(published, rel=0.005)
    assert found.covariance is not None
    std = np.sqrt(np.diag(found.covariance))[:3]
    assert (std > 1e-4).all()
    assert (std < 0.005).all()


# ---- bad input


def white(n_times=400, n_channels=2):
    return np.random.default_rng(0).standard_normal((n_times, n_channels))


def record_of(values, rate=20.0, quantity="acceleration"):
    n = values.shape[1]
    return TimeRecord(rate, values, [f"{i + 1}Z" for i in range(n)], [quantity] * n)


def test_a_channel_that_is_dead_in_each_of_two_records_is_named():
    first, second = white(), white()
    first[:, 1], second[:, 1] = 0.0, 3.0
    with pytest.raises(InputError, match=r"acceleration channel 2Z\+ is dead or constant"):
        identify_modes([record_of(first), record_of(second)])


@pytest.mark.parametrize("fault", [0.0, 3.0])
def test_a_dead_channel_is_named(fault):
    values = white()
    values[:, 1] = fault
    with pytest.raises(InputError, match=r"acceleration channel 2Z\+ is dead or constant .* leave this channel out"):
        identify_modes(record_of(values))


def test_short_records_say_what_is_needed():
    with pytest.raises(InputError, match=r"at least 16 samples, got 9; measure longer"):
        identify_modes(record_of(white(9)))
    with pytest.raises(InputError, match=r"at least 183 samples for lags up to 61 samples, got 100; measure longer"):
        identify_modes(record_of(white(100)), block_rows=30)


def test_one_channel_is_enough_for_frequencies():
    record = decay(np.array([2.0, 5.0]), np.ones((1, 2)), 30.0, 0.05, velocity=np.ones(2), damping_ratio=0.02)
    found = identify_modes(record, orders=[4], n_pieces=0)
    assert found.omega == pytest.approx([2.0, 5.0], rel=1e-9)
    assert any("one channel" in note for note in found.warnings)


def test_a_slow_mode_is_warned_of():
    record = decay(np.array([0.5, 5.0]), np.eye(2), 20.0, 0.05, velocity=np.ones(2))
    found = identify_modes(record, orders=[4], n_pieces=0)
    assert any("mode 1 turns less than three times in 20.05 s" in note for note in found.warnings)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"method": "fft"}, "`method` must be one of pencil"),
        ({"method": "era"}, "`method` 'era' is gone; use pencil"),
        ({"block_rows": 1}, "`block_rows` must be at least 2, got 1"),
        ({"orders": [0]}, "`orders` must lie from 1 to"),
        ({"orders": [30], "block_rows": 10}, "`orders` must lie from 1 to 18 for 2 channels and 10 block rows"),
    ],
)
def test_settings_out_of_range_are_named(given, words):
    with pytest.raises(InputError, match=words):
        identify_modes(record_of(white()), **given)


def test_records_must_fit_together():
    first = record_of(white())
    with pytest.raises(InputError, match="record 2 must have the channels and quantities of record 1"):
        identify_modes([first, record_of(white(), quantity="velocity")])
    with pytest.raises(InputError, match="record 2 must be sampled at 20 Hz"):
        identify_modes([first, record_of(white(), 25.0)])
    with pytest.raises(InputError, match="got forces only"):
        identify_modes(record_of(white(), quantity="force"))
    with pytest.raises(
        InputError, match=r"must be one or more records, got int; .* `record` of what `remove_tones` gives"
    ):
        identify_modes(5)
    with pytest.raises(InputError, match="one or more TimeRecords"):
        identify_modes([])


def test_criteria_that_nothing_meets_are_named():
    with pytest.raises(InputError, match="no mode that is stable"):
        identify_modes(ambient_chain(0), criteria=HardCriteria(frequency=(4.9, 5.0), mpc=0.9999), n_pieces=0)
    with pytest.raises(InputError, match=r"`frequency` must be a range"):
        HardCriteria(frequency=(2.0, 1.0))


@pytest.mark.parametrize(
    "given",
    [
        {"criteria": HardCriteria(frequency=(1.0, 20.0))},
        {"frequencies": [8.0]},
        {"frequencies": np.array([1.0, 8.0])},
        {"method": "bayesian_fft", "bands": [(1, 6)]},
    ],
)
def test_frequencies_beyond_half_the_sampling_rate_are_refused(given):
    with pytest.raises(InputError, match=r"at most 5 Hz, half the sampling rate, got (20|8|6) Hz"):
        identify_modes(ambient_chain(1), **given)


@pytest.mark.parametrize("n", [16, 20, 24, 40])
def test_very_short_records_fail_in_words_or_give_modes(n):
    record = ambient_chain(1)
    short = TimeRecord(record.sampling_rate, record.values[:n], record.channels, record.quantities)
    assert any("easure longer" in words for words in words_on(short))


def words_on(record):
    """Warnings on the modes, or the error in their place."""
    try:
        return identify_modes(record).warnings
    except InputError as error:
        return (str(error),)


@pytest.mark.parametrize("n", [60, 100, 200, 400])
def test_ambient_records_short_against_their_memory_are_not_taken_for_certain(n):
    """Less than the memory of the lowest mode, 29 s: either its spread is that of forced motion, or a word warns."""
    truth = chain_modes()[0] / (2 * np.pi)
    for seed in range(4):
        record = ambient_chain(seed)
        short = TimeRecord(record.sampling_rate, record.values[:n], record.channels, record.quantities)
        found = identify_modes(short)
        error = np.abs(found.frequency - truth[nearest(truth, found.frequency)])
        certain = error > 5 * np.sqrt(np.diag(found.covariance))[: found.n_modes]
        assert not certain.any() or any("if forces kept it up" in words for words in found.warnings)


@pytest.mark.parametrize("seed", range(6))
def test_white_noise_shows_no_mode_by_itself(seed):
    """Poles of noise are steady over the orders, but move with the data; by hand one is given all the same."""
    values = np.random.default_rng(seed).standard_normal((4000, 2))
    record = TimeRecord(100.0, values, ("1X", "2X"), ("acceleration",) * 2)
    with pytest.raises(InputError, match="show no mode"):
        identify_modes(record)
    assert identify_modes(record, frequencies=[20.0]).n_modes == 1


@pytest.mark.parametrize("seed", range(4))
def test_a_weak_mode_of_a_long_record_is_a_mode_of_high_probability(seed):
    """Of 1/1000 of the power, seen by fewer orders than strong modes: its shape and frequency are steady over the record."""
    rng, n = np.random.default_rng(seed), 24000
    frequency, ratio, size = np.array([1.9, 2.4, 2.7, 3.6]), np.array([1.5, 1.5, 1.5, 3.0]) / 100, [1.0, 0.6, 0.6, 0.04]
    poles = np.exp(2 * np.pi * frequency / 20 * (-ratio + 1j * np.sqrt(1 - ratio**2)))
    motion = [lfilter([1], [1, -2 * p.real, abs(p) ** 2], rng.standard_normal(n + 2000))[2000:] for p in poles]
    shapes = np.linalg.qr(rng.standard_normal((6, 6)))[0][:4]
    values = (np.array(motion).T / np.std(motion, axis=1) * size) @ shapes
    values = values + 0.02 * rng.standard_normal(values.shape)
    record = TimeRecord(20.0, values, [f"{i}X" for i in range(1, 7)], ("acceleration",) * 6)
    found = modal_identification(record)
    np.testing.assert_allclose(found.modes.frequency, frequency, rtol=0.01)
    assert found.probability.min() > 0.9
    cluster = found.clusters[-1]
    assert mode_probability(replace(cluster, excess=np.nan)) < 0.5
    assert mode_probability(replace(cluster, excess=30.0, shape_error=1.0)) < 0.5


def test_a_mode_with_a_pole_of_noise_beside_it_is_known_by_another_order():
    """Seed 1 and 100 s: 2.438 Hz, to 0.13 Hz by the middle pole of its cluster and to 0.01 Hz by a pole of another order."""
    modes = modal_identification(ambient_chain(1, duration=100.0)).modes
    truth = chain_modes()[0] / (2 * np.pi)
    assert modes.n_modes == 4
    assert (modes.frequency_std < 0.03).all()
    assert (np.abs(modes.frequency - truth) < 3 * modes.frequency_std).all()


def test_poles_less_certain_than_their_bandwidth_are_left_out_and_named():
    """Seed 1 and 100 s: a stable pole of noise at 0.92 Hz, where no mode is, and a second one of the third mode."""
    result = modal_identification(ambient_chain(1, duration=100.0))
    found = result.modes
    std = np.sqrt(np.diag(found.covariance))[: found.n_modes]
    assert (std <= 2 * np.maximum(found.damping_ratio * found.frequency, 0.01)).all()
    assert len(result.clusters) == found.n_modes == 4
    assert any("as those of noise do are left out: 0.9185, 2.367 Hz" in words for words in found.warnings)


def test_two_poles_of_one_resonance_and_one_shape_are_one_mode():
    """Seed 3 and 100 s: stable poles at 2.957 and 3.026 Hz of the mode at 2.990 Hz, with a MAC of 0.999."""
    found = identify_modes(ambient_chain(3, duration=100.0))
    assert found.n_modes == 4
    assert any("as those of noise do are left out: 3.026 Hz" in words for words in found.warnings)
