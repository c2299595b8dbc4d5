"""Largest values of random response against simulation and Davenport, noise, pulses, and the distribution of maxima."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import signal

import structid as sid
from structid.core.errors import FileError, InputError
from structid.prediction.identified_model import identified_model
from structid.prediction.loads import coloured_noise, half_sine, read_density, sine
from structid.prediction.predict import _with_model_error, predict_together


def make_oscillator(damping=3.0, std=0.0):
    """2 kg on 8000 N/m: 10 Hz."""
    sets = [
        sid.PointMass("m", [1], mass=2.0),
        sid.Spring("k", "1X", stiffness=8e3),
        sid.Dashpot("c", "1X", viscous_damping=damping),
    ]
    structure = sid.Structure({1: 0.0}, sets, active=["X"])
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", "k")])
    return identified_model(structure, parameters, parameters.start, np.array([[(8e3 * std) ** 2]]))


def spectrum(kind="receptance", highest=60.0, n=12_000):
    frequency = np.linspace(0.01, highest, n)
    return sid.Spectrum(sid.Frf(["1X"], ["1X"], frequency, kind), np.full((n, 1), 2.0))


def test_the_largest_of_narrow_band_motion_is_that_of_simulations():
    """Records of 60 s of one mass with 1.2 % damping, from noise that is white up to 60 Hz, by exact steps."""
    model, duration, rate, n_records = make_oscillator(), 60.0, 240.0, 150
    n = int((duration + 6) * rate)
    rng = np.random.default_rng(1)
    pole = -3.0 / 4 + 1j * np.sqrt(4000.0 - (3.0 / 4) ** 2)
    forces = np.stack(
        [coloured_noise(np.array([1e-3, 60.0]), np.array([2.0, 2.0]), n / rate, rate, rng) for _ in range(n_records)]
    )
    state = signal.lfilter([1.0], [1.0, -np.exp(pole / rate)], forces / rate * np.exp(pole / rate / 2), axis=1)
    motion = (2 * state / (2j * pole.imag * 2.0)).real[:, int(6 * rate) :]
    largest = np.abs(motion).max(axis=1)
    mean, rms, median = (
        found.values[0]
        for found in predict_together(
            model,
            [
                sid.Extremes(spectrum(), duration),
                sid.RootMeanSquare(spectrum()),
                sid.Extremes(spectrum(), duration, 0.5),
            ],
            n_draws=50,
        )
    )
    assert rms == pytest.approx(motion.std(), rel=0.02)
    assert mean == pytest.approx(largest.mean(), rel=0.03)
    assert median == pytest.approx(np.median(largest), rel=0.04)
    assert median < mean


def test_the_largest_of_wide_band_motion_is_davenports():
    """Peak factor sqrt(2 ln N) + 0.577 / sqrt(2 ln N) with N = T / pi sqrt(m2 / m0), of accelerations of a nearly rigid mass."""
    model, duration = make_oscillator(damping=4000.0), 600.0
    density = spectrum("accelerance")
    largest, rms = predict_together(model, [sid.Extremes(density, duration), sid.RootMeanSquare(density)], n_draws=50)
    w = 2 * np.pi * density.frf.frequency
    s = np.abs(w**2 / (8e3 + 4000j * w - 2 * w**2)) ** 2
    root = np.sqrt(2 * np.log(duration / np.pi * np.sqrt((w**2 * s).sum() / s.sum())))
    assert largest.values[0] / rms.values[0] == pytest.approx(root + 0.5772 / root, rel=0.02)


def test_maxima_come_with_their_distribution_and_the_history_is_simulated_once(monkeypatch):
    calls = []
    evaluator = sid.History.evaluator
    monkeypatch.setattr(sid.History, "evaluator", lambda self, *parts: calls.append(1) or evaluator(self, *parts))
    push = half_sine(50.0, 0.02, 0.5, 500.0)[:, None]
    history = sid.History(["1X"], ["1X"], push, 500.0, "displacement")
    motion, largest = predict_together(make_oscillator(std=0.1), [history, sid.Maxima(history)], n_draws=200)
    assert len(calls) == 1
    assert motion.draws is None
    assert largest.draws.shape == (200, 1)
    low, high = np.quantile(largest.draws[:, 0], [0.025, 0.975], method="weibull")
    assert (largest.low[0], largest.high[0]) == pytest.approx((low, high))
    alone = sid.predict(make_oscillator(std=0.1), sid.Maxima(history), n_draws=200)
    assert alone.draws == pytest.approx(largest.draws)


def test_noise_has_its_spectrum_and_pulses_their_shape():
    frequency, density = np.array([2.0, 10.0, 30.0]), np.array([1.0, 4.0, 0.5])
    noise = coloured_noise(frequency, density, 400.0, 128.0, np.random.default_rng(0))
    lines, measured = signal.welch(noise, 128.0, nperseg=512)
    for low, high in ((4.0, 8.0), (15.0, 25.0)):
        inside = (lines >= low) & (lines <= high)
        assert measured[inside].mean() == pytest.approx(np.interp(lines[inside], frequency, density).mean(), rel=0.05)
    assert noise.var() == pytest.approx(np.trapezoid(density, frequency), rel=0.03)
    pulse = half_sine(3.0, 0.1, 1.0, 1000.0)
    assert (pulse.max(), pulse.sum() / 1000, pulse[101:].any()) == (
        pytest.approx(3.0),
        pytest.approx(0.6 / np.pi, rel=1e-3),
        False,
    )
    assert sine(2.0, 5.0, 1.0, 400.0)[20] == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1,2\n", "at least two lines"),
        ("1,2\n0.5,1\n", "line 2: frequencies must rise"),
        ("1,2\n2,-1\n", "line 2: frequencies must rise from above 0 Hz and densities be at least 0"),
        ("1,2\n2,x\n", "line 2: a spectrum has two numbers"),
        ("1,2,3\n2,2,3\n", "line 1: a spectrum has two numbers"),
    ],
)
def test_spectra_that_cannot_be_are_named(tmp_path, text, words):
    (tmp_path / "s.csv").write_text(text, encoding="utf-8")
    with pytest.raises(FileError, match=words):
        read_density(tmp_path / "s.csv")


@pytest.mark.parametrize(
    ("heading", "hertz", "square"),
    [
        ("f,S", 1.0, 1.0),
        ("f [kHz];S [kN^2/Hz]", 1e3, 1e6),
        ("f (Hz),S (g2/Hz)", 1.0, 9.80665**2),
        ("w (rad/s),S ((m/s^2)^2/(rad/s))", 0.5 / np.pi, 2 * np.pi),
    ],
)
def test_units_in_the_heading_of_a_spectrum_are_read(tmp_path, heading, hertz, square):
    (tmp_path / "s.csv").write_text(f"{heading}\n1,2\n2,3\n", encoding="utf-8")
    frequency, density = read_density(tmp_path / "s.csv")
    assert frequency == pytest.approx(hertz * np.array([1.0, 2.0]))
    assert density == pytest.approx(square * np.array([2.0, 3.0]))


@pytest.mark.parametrize(
    ("heading", "words"),
    [
        ("f (Hz),S (N/Hz)", "line 1: cannot read 'N/Hz' as the unit of a spectral density"),
        ("f (parsec),S", "line 1: cannot read 'parsec' as the unit of a frequency"),
        ("f (Hz),S (g^2/Hz)", "line 1: the density must be of a force, got 'g^2/Hz', of acceleration"),
    ],
)
def test_units_of_a_spectrum_that_cannot_be_are_named(tmp_path, heading, words):
    (tmp_path / "s.csv").write_text(f"{heading}\n1,2\n2,3\n", encoding="utf-8")
    with pytest.raises(FileError, match=re.escape(words)):
        read_density(tmp_path / "s.csv", is_support=False)


def test_loads_and_extremes_that_cannot_be_are_named():
    with pytest.raises(InputError, match="`sampling_rate` must be at least 400 Hz"):
        half_sine(1.0, 0.01, 1.0, 100.0)
    with pytest.raises(InputError, match="twice the highest line"):
        coloured_noise(np.array([1.0, 80.0]), np.ones(2), 1.0, 100.0, np.random.default_rng(0))
    with pytest.raises(InputError, match="`duration` must be greater than 0"):
        sid.Extremes(spectrum(), 0.0)
    with pytest.raises(InputError, match="`probability` must lie between 0 and 1"):
        sid.Extremes(spectrum(), 1.0, 1.0)
    with pytest.raises(InputError, match="`density` must be finite and at least 0"):
        sid.Spectrum(sid.Frf(["1X"], ["1X"], [1.0, 2.0]), np.array([[1.0], [-1.0]]))
    mises = sid.Spectrum(sid.Frf(["von_mises[p:1@top]"], ["1X"], [1.0, 2.0]), np.ones((2, 1)))
    with pytest.raises(InputError, match="is not Gaussian"):
        sid.Extremes(mises, 1.0)


def test_a_von_mises_stress_with_model_error_is_never_negative():
    load = np.zeros((4, 1))
    history = sid.History(["von_mises[p:1@top]", "1X"], ["1X"], load, 100.0)
    lowered = SimpleNamespace(added_to_histories=lambda draws, rate, rng: draws - 1.0)
    draws = np.full((3, 4, 2), 0.5)
    widened = _with_model_error(history, draws[0], draws, lowered, 0)
    assert (widened[..., 0] == 0.0).all()
    assert (widened[..., 1] == -0.5).all()
