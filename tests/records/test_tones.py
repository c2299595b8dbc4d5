"""Tones of machines are taken off as they are; random motion of a lightly damped mode, and a decay, never are."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter

from structid import InputError, Preparation, prepare
from structid.records import TimeRecord, remove_tones

RATE, SHAPES = 80.0, np.array([[1.0, 0.8, 0.5], [1.0, -0.3, -0.9]])


def response(frequency, ratio, force):
    """Acceleration of an oscillator of mass 1 under a force that is linear between samples."""
    omega = 2 * np.pi * frequency
    matrix = np.zeros((4, 4))
    matrix[:2, :2] = np.array([[0, 1], [-(omega**2), -2 * ratio * omega]]) / RATE
    matrix[1, 2], matrix[2, 3] = 1 / RATE, 1
    step = expm(matrix)
    pushes = np.outer(force[:-1], step[:2, 2] - step[:2, 3]) + np.outer(force[1:], step[:2, 3])
    values, vectors = np.linalg.eig(step[:2, :2])
    motion = np.stack(
        [lfilter([1], [1, -v], p) for v, p in zip(values, (pushes @ np.linalg.inv(vectors).T).T, strict=True)], 1
    )
    state = np.vstack([[0, 0], (motion @ vectors.T).real])
    return force - 2 * ratio * omega * state[:, 1] - omega**2 * state[:, 0]


def ambient(seconds, ratio, seed, frequency=20.0, tone=None):
    """Random motion of modes at `frequency` and 9 Hz with 5 % noise, and what the force `tone` of a machine adds to it."""
    rng = np.random.default_rng(seed)
    lead, n = round(3 / (2 * np.pi * frequency * ratio) * RATE), round(seconds * RATE)
    forces = rng.standard_normal((2, lead + n))
    motion = sum(
        np.outer(response(f, r, force), shape)
        for f, r, force, shape in zip((frequency, 9.0), (ratio, 0.01), forces, SHAPES, strict=True)
    )
    motion += 0.05 * motion.std() * rng.standard_normal(motion.shape)
    time = (np.arange(lead + n) - lead) / RATE
    added = np.zeros_like(motion) if tone is None else np.outer(response(frequency, ratio, tone(time)), SHAPES[0])
    return motion[lead:], added[lead:]


def record(values, quantities=("acceleration",) * 3):
    return TimeRecord(RATE, values, tuple(f"{i + 1}X" for i in range(values.shape[1])), quantities)


@pytest.mark.parametrize("asked", ["auto", [20.2]])
def test_a_steady_tone_beside_a_mode_is_taken_off_to_its_error(asked):
    motion, added = ambient(200, 0.01, 1, tone=lambda t: np.cos(2 * np.pi * 20.2 * t + 0.4))
    done = remove_tones(record(motion + added), asked)
    (tone,) = done.tones
    left = done.record.values - motion
    assert tone.frequency == pytest.approx(20.2, abs=2e-4)
    assert tone.highest == tone.lowest == tone.frequency
    assert 1.5 <= tone.kurtosis < 1.7
    np.testing.assert_allclose(tone.amplitude, np.sqrt(2 * np.mean(added**2, axis=0)), rtol=0.05)
    np.testing.assert_allclose(tone.variance_fraction, (added.var(axis=0)) / (motion + added).var(axis=0), rtol=0.1)
    assert left.std() < 0.12 * motion.std()  # two lines, of some 80 under the half-power bandwidth of the mode
    assert done.absent == ()


@pytest.mark.parametrize("period", [40.0, 150.0])
def test_a_tone_that_wanders_by_a_fifth_of_a_per_cent_is_followed(period):
    swing = 0.04 * period

    def machine(t):
        return 2.0 * np.cos(2 * np.pi * 20.2 * t + swing * np.sin(2 * np.pi * t / period))

    motion, added = ambient(300, 0.01, 2, tone=machine)
    done = remove_tones(record(motion + added))
    (tone,) = done.tones
    assert (tone.lowest, tone.highest) == pytest.approx((20.16, 20.24), abs=0.006)
    assert (done.record.values - motion).std() < 0.05 * added.std()
    assert (done.record.values - motion).std() < 0.25 * motion.std()


def test_multiples_share_the_phase_of_a_wandering_tone():
    """The second multiple is too weak to be followed by itself."""

    def phase(t):
        return 2 * np.pi * 10.3 * t + 1.2 * np.sin(2 * np.pi * t / 60)

    time = np.arange(24000) / RATE
    rng = np.random.default_rng(3)
    hum = np.outer(5 * np.cos(phase(time)), [1.0, 0.5]) + np.outer(0.25 * np.cos(2 * phase(time) + 1), [0.2, 1.0])
    noise = rng.standard_normal(hum.shape)
    done = remove_tones(record(hum + noise, ("velocity",) * 2))
    assert [round(tone.frequency, 1) for tone in done.tones] == [10.3, 20.6]
    assert done.tones[1].amplitude == pytest.approx([0.05, 0.25], abs=0.03)
    assert (done.record.values - noise).std() < 0.12


@pytest.mark.parametrize(("frequency", "ratio", "seconds"), [(20.0, 0.002, 100), (20.0, 0.002, 300), (5.0, 0.001, 400)])
def test_a_lightly_damped_mode_is_no_tone(frequency, ratio, seconds):
    for seed in range(4):
        motion, _ = ambient(seconds, ratio, seed, frequency)
        for asked in ("auto", [frequency]):
            done = remove_tones(record(motion), asked)
            assert done.tones == ()
            assert (done.record.values == motion).all()
    assert "no tone stands out" in done.absent[0]


def test_a_decay_is_no_tone():
    time = np.arange(16000) / RATE
    decay = np.exp(-0.002 * 2 * np.pi * 20 * time) * np.cos(2 * np.pi * 20 * time)
    noise = 0.01 * np.random.default_rng(4).standard_normal((16000, 2))
    done = remove_tones(record(np.outer(decay, [1.0, -0.6]) + noise, ("velocity",) * 2))
    assert done.tones == ()


def test_short_records_do_not_tell_a_tone_from_a_mode():
    time = np.arange(1600) / RATE
    values = np.outer(np.cos(2 * np.pi * 20 * time), [1.0, 0.5])
    done = remove_tones(record(values, ("velocity",) * 2), [20.0, 39.9])
    assert done.tones == ()
    assert "a record of 20 s does not tell a tone from a mode of little damping there; 39.8 s would" in done.absent[0]
    assert "too near to half the sampling rate" in done.absent[1]


def test_forces_stay_and_channels_keep_their_places():
    time = np.arange(8000) / RATE
    tone = np.cos(2 * np.pi * 20.0 * time)
    values = np.stack([tone, 0.5 * tone, 0 * tone + 1.0], 1) + 0.1 * np.random.default_rng(5).standard_normal((8000, 3))
    values[:, 2] = 1.0
    done = remove_tones(record(values, ("force", "acceleration", "displacement")))
    (found,) = done.tones
    assert found.units == ("N", "m/s^2", "m")
    np.testing.assert_array_equal(done.record.values[:, [0, 2]], values[:, [0, 2]])
    assert found.amplitude == pytest.approx([0, 0.5, 0], abs=0.01)
    assert found.words.startswith("tone at 20 Hz taken off: 9")
    assert "of the variance of 2X" in found.words


@pytest.mark.parametrize("asked", ["auto", [20.02]])
def test_an_offset_is_no_tone_and_stays(asked):
    """Gravity in a raw accelerometer, 5000 times the tone: the offset would leak into the windows at the ends."""
    time, rng = np.arange(16000) / RATE, np.random.default_rng(9)
    noise = 1e-3 * rng.standard_normal((16000, 2))
    tone = 2e-3 * np.cos(2 * np.pi * 20.02 * time)[:, None]
    done = remove_tones(record(noise + tone + 9.81, ("acceleration",) * 2), asked)
    (found,) = done.tones
    assert found.frequency == pytest.approx(20.02, abs=1e-4)
    assert found.variance_fraction == pytest.approx([2 / 3, 2 / 3], rel=0.05)
    assert (done.record.values - noise - 9.81).std() < 5e-5


@pytest.mark.parametrize("quantity", ["force", "acceleration"])
@pytest.mark.parametrize("asked", ["auto", [12.5]])
def test_a_record_where_nothing_moves_has_no_tones(quantity, asked):
    values = np.ones((4000, 2)) if quantity == "acceleration" else np.random.default_rng(6).standard_normal((4000, 2))
    still = record(values, (quantity,) * 2)
    done = remove_tones(still, asked)
    assert done.tones == ()
    assert done.record is still


@pytest.mark.parametrize("asked", [50.0, "50"])
def test_a_preparation_takes_a_list_of_tones(asked):
    with pytest.raises(InputError, match=r"`remove_tones` must be a list .* got .*50.*; write one as \[50.0\]"):
        Preparation(remove_tones=asked)


@pytest.mark.parametrize("asked", [[0.0], [41.0], "all", 12.5])
def test_what_is_no_frequency_is_refused(asked):
    with pytest.raises(InputError, match="`frequencies`"):
        remove_tones(record(np.random.default_rng(6).standard_normal((4000, 2)), ("velocity",) * 2), asked)


def test_preparation_says_what_it_took_off_and_what_is_not_there():
    time = np.arange(16000) / RATE
    hum = np.outer(np.cos(2 * np.pi * 12.5 * time), [1.0, 0.5]) + np.random.default_rng(7).standard_normal((16000, 2))
    ready = prepare(record(hum, ("velocity",) * 2), Preparation(remove_tones=[12.5, 7.0]))
    assert [tone.frequency_words for tone in ready.tones] == ["12.5 Hz"]
    assert ready.steps[1].startswith("tone at 12.5 Hz taken off: 3")
    assert any(f.kind == "tone" and "no tone stands out at 7 Hz" in f.words for f in ready.findings)
    slow = prepare(record(hum, ("velocity",) * 2), Preparation(sampling_rate=20.0, remove_tones=[12.5]))
    assert "the tone at 12.5 Hz lies above half the sampling rate after decimation" in slow.steps
    none = prepare(record(hum[:, ::-1] * 0 + np.random.default_rng(8).standard_normal((16000, 2)), ("velocity",) * 2),
                   Preparation(remove_tones="auto"))  # fmt: skip
    assert none.steps[-1] == "no tone stands out: none is taken off"
