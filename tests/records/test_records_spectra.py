"""Frequency response functions from time histories, against systems that are known exactly."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from structid.core.errors import InputError
from structid.records import TimeRecord, effective_averages, frf_from_time, with_coherence_noise

NUMERATOR, DENOMINATOR = [0.2, 0.1], [1, -1.2, 0.8]
RATE = 100.0


def record(*columns, channels=("1X", "2X"), quantities=("force", "acceleration")):
    return TimeRecord(RATE, np.column_stack(columns), channels, quantities, source="test")


def system(frequency):
    return signal.freqz(NUMERATOR, DENOMINATOR, 2 * np.pi * frequency / RATE)[1]


def test_the_motion_where_the_force_acts_is_an_output_by_default(rng):
    x, y, z = rng.normal(size=(3, 512))
    channels, quantities = ("3Y", "3Y", "5Y"), ("force", "acceleration", "acceleration")
    frf = frf_from_time(record(x, y, z, channels=channels, quantities=quantities), segment_length=64)
    assert [str(dof) for dof in (*frf.inputs, *frf.outputs)] == ["3Y+", "3Y+", "5Y+"]


@pytest.mark.parametrize("estimator", ["H1", "H2", "Hv"])
def test_periodic_input_is_exact(rng, estimator):
    """A period of steady state in a boxcar segment has no leakage: every estimator is exact to rounding."""
    x = np.tile(rng.normal(size=256), 9)
    y = signal.lfilter(NUMERATOR, DENOMINATOR, x)[-512:]
    frf = frf_from_time(record(x[-512:], y), ["1X"], ["2X"], estimator, 256, 0.0, "boxcar", detrend="none")
    np.testing.assert_allclose(frf.values[:, 0, 0], system(frf.frequency), rtol=1e-10)
    assert frf.frequency[0] == 0
    assert frf.frequency[-1] == RATE / 2
    assert frf.kind == "accelerance"
    np.testing.assert_allclose(frf.coherence, 1, atol=1e-12)
    assert frf.averages == 2


def test_single_input_agrees_with_scipy(rng):
    x = rng.normal(size=4000)
    y = signal.lfilter(NUMERATOR, DENOMINATOR, x) + 0.3 * rng.normal(size=4000)
    frf = frf_from_time(record(x, y), ["1X"], ["2X"], segment_length=128)
    settings = {"fs": RATE, "window": "hann", "nperseg": 128, "noverlap": 64, "detrend": "constant"}
    frequency, cross = signal.csd(x, y, **settings)
    power = signal.welch(x, **settings)[1]
    np.testing.assert_allclose(frf.frequency, frequency[1:], rtol=1e-14)
    np.testing.assert_allclose(frf.values[:, 0, 0], (cross / power)[1:], rtol=1e-10)
    np.testing.assert_allclose(frf.coherence[:, 0, 0], signal.coherence(x, y, **settings)[1][1:], rtol=1e-10)


def test_h1_h2_hv_relations(rng):
    """H2 = H1 / coherence, and Hv is their geometric mean, for one input."""
    x = rng.normal(size=4000)
    y = signal.lfilter(NUMERATOR, DENOMINATOR, x) + 0.3 * rng.normal(size=4000)
    h1, h2, hv = (frf_from_time(record(x, y), ["1X"], ["2X"], e, 128) for e in ("H1", "H2", "Hv"))
    np.testing.assert_allclose(h2.values, h1.values / h1.coherence, rtol=1e-10)
    np.testing.assert_allclose(hv.values, h1.values / np.sqrt(h1.coherence), rtol=1e-8)


@pytest.mark.parametrize("estimator", ["H1", "Hv"])
def test_two_inputs_exact(rng, estimator):
    """Responses that are sums of filtered periodic inputs: each column is found, senses kept."""
    x = [np.concatenate([np.tile(rng.normal(size=64), 4) for _ in range(6)]) for _ in range(2)]
    y1 = signal.lfilter(NUMERATOR, DENOMINATOR, x[0]) - signal.lfilter([0, 3], [1], x[1])
    y2 = signal.lfilter([1, 1], [1], x[1])
    parts = [
        record(*(c[k * 256 + 192 : k * 256 + 256] for c in (*x, y1, y2)),
               channels=("1X", "2X-", "3X", "4X"), quantities=("force", "force", "velocity", "velocity"))
        for k in range(6)
    ]  # fmt: skip
    frf = frf_from_time(parts, ["1X", "2X-"], ["3X", "4X"], estimator, window="boxcar", detrend="none")
    z = np.exp(-2j * np.pi * frf.frequency / RATE)
    # 192 samples of settling leave |0.8^(1/2)|^192 = 5e-10 of the transient
    np.testing.assert_allclose(frf.values[:, 0, 0], system(frf.frequency), atol=1e-6)
    np.testing.assert_allclose(frf.values[:, 0, 1], -3 * z, atol=1e-6)
    np.testing.assert_allclose(frf.values[:, 1, 0], 0, atol=1e-6)
    np.testing.assert_allclose(frf.values[:, 1, 1], 1 + z, atol=1e-6)
    assert frf.kind == "mobility"
    assert [str(d) for d in frf.inputs] == ["1X+", "2X-"]
    np.testing.assert_allclose(frf.coherence[:-1], 1, atol=1e-8)  # at the last line 1 + z is 0: no response


@pytest.mark.parametrize("overlap, window", [(0.0, "boxcar"), (0.5, "hann"), (0.75, "hann")])
def test_predicted_error_agrees_with_scatter(overlap, window):
    """Mean predicted variance over observed variance of 300 repeats: 1 within 8 % (about 4 deviations over 27 lines)."""
    rng = np.random.default_rng(7)
    values, predicted = [], []
    for _ in range(300):
        x = rng.normal(size=64 * 20)
        y = signal.lfilter(NUMERATOR, DENOMINATOR, x) + 0.5 * rng.normal(size=x.size)
        frf = frf_from_time(record(x, y), ["1X"], ["2X"], "H1", 64, overlap, window)
        values.append(frf.values[3:-2, 0, 0])
        predicted.append(frf.variance[3:-2, 0, 0])
    ratio = np.mean(np.mean(predicted, axis=0) / np.var(values, axis=0))
    assert ratio == pytest.approx(1, abs=0.08)


def test_predicted_error_of_two_inputs_agrees_with_scatter():
    rng = np.random.default_rng(8)
    values, predicted = [], []
    for _ in range(200):
        x = rng.normal(size=(64 * 12, 2)) @ [[1, 0.6], [0, 1]]
        y = 2 * x[:, 0] - x[:, 1] + rng.normal(size=len(x))
        data = record(x, y, channels=("1X", "2X", "3X"), quantities=("force", "force", "displacement"))
        frf = frf_from_time(data, ["1X", "2X"], ["3X"], "H1", 64, 0.0, "boxcar")
        values.append(frf.values[2:-2, 0])
        predicted.append(frf.variance[2:-2, 0])
    ratio = np.mean(np.mean(predicted, axis=0) / np.var(values, axis=0), axis=0)
    np.testing.assert_allclose(ratio, 1, atol=0.08)


def test_effective_averages_of_welch():
    boxcar, hann = np.ones(64), signal.get_window("hann", 64)
    assert effective_averages(boxcar, 64, [10]) == 10
    # half overlap: rho is 1/4 for a boxcar and 1/36 for a Hann window (Welch 1967; Harris 1978, Table 1: 16.7 %^2)
    assert effective_averages(boxcar, 32, [19]) == pytest.approx(19 / (1 + 2 * (18 / 19) / 4))
    assert effective_averages(hann, 32, [19]) == pytest.approx(19 / (1 + 2 * (18 / 19) / 36), rel=1e-6)
    assert effective_averages(hann, 32, [1, 1, 1]) == 3


def test_impacts_are_averaged(rng):
    """Impacts with an exponential window: the pole moves by the window's own decay, and by nothing else."""
    decay, parts = 40.0, []
    weights = np.exp(-np.arange(512) / decay)
    for _ in range(5):
        x = np.zeros(512)
        x[0] = rng.uniform(1, 2)
        parts.append(record(x, signal.lfilter(NUMERATOR, DENOMINATOR, x)))
    frf = frf_from_time(parts, ["1X"], ["2X"], window=("exponential", 0.0, decay), detrend="none")
    impulse = signal.lfilter(NUMERATOR, DENOMINATOR, np.eye(1, 512)[0]) * weights
    np.testing.assert_allclose(frf.values[:, 0, 0], np.fft.rfft(impulse), atol=1e-12)
    assert frf.averages == 5


def test_variance_is_none_without_enough_averages(rng):
    frf = frf_from_time(record(rng.normal(size=64), rng.normal(size=64)), ["1X"], ["2X"], segment_length=64)
    assert frf.variance is None
    assert (frf.averages, frf.noise_source) == (1, "unknown")
    x = rng.normal(size=64 * 30)
    frf = frf_from_time(record(x, x + rng.normal(size=x.size)), ["1X"], ["2X"], segment_length=64, overlap=0)
    assert (frf.averages, frf.noise_source) == (30, "coherence")
    # the record's own formula has n for n - 1
    np.testing.assert_allclose(with_coherence_noise(frf).variance, frf.variance * 29 / 30, rtol=1e-10)


@pytest.mark.parametrize(
    "changes, word",
    [
        ({"inputs": ["5X"]}, r"no force channel 5X\+; it has 1X\+"), ({"outputs": ["1X"]}, "motion channels"),
        ({"outputs": []}, "outputs"), ({"segment_length": None}, "segment_length"),
        ({"segment_length": 1000}, "longer than the longest record"), ({"segment_length": 1}, "at least 2"),
        ({"overlap": 1.0}, "overlap"), ({"window": "round"}, "window"), ({"detrend": "cubic"}, "detrend"),
        ({"estimator": "H3"}, "H1, H2 or Hv"), ({"inputs": ["1X", "3X"]}, "coherent"),
        ({"inputs": ["1X", "4X"], "estimator": "H2"}, "H2 takes one input"),
        ({"inputs": ["6X"]}, r"input 6X\+ has no power at any line, as a dead channel or a constant load"),
        ({"inputs": ["1X", "4X"], "segment_length": 400}, "at least as many segments"),
        ({"outputs": ["2X", "9X"]}, r"9X\+ is none"), ({"quantity": "force"}, "displacement, velocity"),
        ({"outputs": ["8X"]}, "choose one with `quantity`"),
        ({"outputs": ["2X", "7X"], "estimator": "Hv"}, r"output 7X\+ has no power at .* Hz, as a dead channel"),
        ({"outputs": ["7X"], "estimator": "H2"}, r"output 7X\+ has no power"),
    ],
)  # fmt: skip
def test_refuses(rng, changes, word):
    x = rng.normal(size=(400, 8))
    x[:, 2], x[:, 4:6] = 2 * x[:, 0], 0
    channels = ("1X", "2X", "3X", "4X", "6X", "7X", "8X", "8X")
    quantities = ("force", "acceleration", "force", "force", "force", "velocity", "velocity", "acceleration")
    call = {"inputs": ["1X"], "outputs": ["2X"], "segment_length": 64} | changes
    with pytest.raises(InputError, match=word):
        frf_from_time(record(x, channels=channels, quantities=quantities), **call)


def test_unlike_repeats_are_refused(rng):
    first, other = record(rng.normal(size=(64, 2))), record(rng.normal(size=(64, 2)), channels=("1X", "3X"))
    with pytest.raises(InputError, match=r"share channels: .* has 2X\+ acceleration, where .* has 3X\+ acc"):
        frf_from_time([first, other], ["1X"], ["2X"])
    with pytest.raises(InputError, match=r"share their sampling rate, Hz: repeat 1 .* has .*, where repeat 2 .* has 7"):
        frf_from_time([first, replace(first, sampling_rate=7.0)], ["1X"], ["2X"])
    with pytest.raises(InputError, match="different lengths"):
        frf_from_time([first, record(rng.normal(size=(65, 2)))], ["1X"], ["2X"])
    with pytest.raises(InputError, match="at least one"):
        frf_from_time([], ["1X"], ["2X"])


def test_displacements_velocities_and_accelerations_side_by_side_become_one_kind(rng):
    """A period of steady state: what each sensor reads is the other's derivative, line by line."""
    x, n = rng.normal(size=256), 256
    s = 2j * np.pi * np.fft.rfftfreq(n, 1 / RATE)
    moved = np.fft.rfft(x) / (s**2 + 3 * s + 2000.0)
    moved[-1] = 0  # the last line of a series has no phase
    columns = [np.tile(np.fft.irfft(s**order * moved, n), 3) for order in range(3)]
    channels, quantities = ("1X", "2X", "3X", "4X"), ("force", "displacement", "velocity", "acceleration")
    times = record(np.tile(x, 3), *columns, channels=channels, quantities=quantities)
    settings = {"segment_length": n, "overlap": 0.0, "window": "boxcar"}
    for wanted, kind, order in (
        ("velocity", "mobility", 1),
        (None, "receptance", 0),
        ("acceleration", "accelerance", 2),
    ):
        frf = frf_from_time(times, ["1X"], channels[1:], quantity=wanted, **settings)
        expected = (s**order / (s**2 + 3 * s + 2000.0))[1:-1, None]
        assert frf.kind == kind
        np.testing.assert_allclose(frf.values[:-1, :, 0], np.repeat(expected, 3, axis=1), rtol=1e-8)


def test_variance_follows_the_kind(rng):
    x = rng.normal(size=64 * 30)
    noisy = [x + rng.normal(size=x.size), x + rng.normal(size=x.size)]
    times = record(x, *noisy, channels=("1X", "2X", "3X"), quantities=("force", "acceleration", "velocity"))
    both = frf_from_time(times, ["1X"], ["2X", "3X"], segment_length=64, quantity="acceleration")
    alone = frf_from_time(times, ["1X"], ["3X"], segment_length=64).as_kind("accelerance")
    np.testing.assert_allclose(both.values[:, 1:], alone.values, rtol=1e-12)
    np.testing.assert_allclose(both.variance[:, 1:], alone.variance, rtol=1e-12)
    np.testing.assert_allclose(both.coherence[:, 1:], alone.coherence, rtol=1e-12)


def test_loads_and_sensors_are_those_of_the_record_by_their_quantities(rng):
    x, y, z = rng.normal(size=(3, 512))
    measured = record(y, x, z, channels=("2X", "1X", "3X"), quantities=("acceleration", "force", "acceleration"))
    frf = frf_from_time(measured, segment_length=128)
    assert (frf.outputs, frf.inputs) == (record(y, z, channels=("2X", "3X")).channels, record(x, y).channels[:1])
    named = frf_from_time(measured, ["1X"], ["2X", "3X"], segment_length=128)
    np.testing.assert_array_equal(frf.values, named.values)
    with pytest.raises(InputError, match=r"no channel is a force.*`structid modes` gives modes"):
        frf_from_time(record(y, z, quantities=("acceleration", "acceleration")), segment_length=128)
