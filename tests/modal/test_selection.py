"""What is taken for a mode, what is left out and why, and peaks that no mode explains."""

from dataclasses import replace

import numpy as np
import pytest
from modal_cases import ambient_chain, chain_modes, decay

from structid import ModalRecord
from structid.modal import ModalOptions, modal_identification
from structid.modal.method import ModalIdentification
from structid.modal.poles.poles import Poles, modal_phase_deviation
from structid.modal.poles.stabilization import Cluster, mode_probability
from structid.modal.spectral.peaks import unexplained_peaks
from structid.modal.survey.rates import joined
from structid.modal.survey.survey import dies_out
from structid.records import FrfRecord


def cluster(size=20, **changes):
    numbers = {"stability": 0.9, "distance": 1e-3, "energy": 0.3, "collinearity": 1.0} | changes
    return Cluster(np.arange(size), np.zeros(size, int), np.full(size, 2.0), np.full(size, 0.01), 0, **numbers)


def test_probability_rises_with_stability_energy_and_collinearity_and_falls_with_distance():
    base = mode_probability(cluster())
    assert base > 0.9
    for change in ({"stability": 0.3}, {"distance": 0.1}, {"energy": 1e-3}, {"collinearity": 0.2}):
        assert mode_probability(cluster(**change)) < base
    assert np.isnan(mode_probability(cluster(size=2)))


def test_true_modes_are_likely_and_others_are_listed_with_a_reason():
    found = modal_identification(ambient_chain(3, duration=300.0), options=ModalOptions(n_pieces=0))
    assert found.modes.n_modes == 4
    assert (found.probability > 0.9).all()
    for part in found.left_out:
        assert 0.3 <= part.probability <= 1
        assert part.reason


def test_nine_frfs_of_few_lines_show_four_modes():
    """48 lines 0.77 Hz apart, half-power bandwidths of 0.24 to 0.76 Hz."""
    frequency, rng = np.array([12.0, 21.0, 30.0, 38.0]), np.random.default_rng(5)
    shapes, omega = rng.standard_normal((9, 4)), 2 * np.pi * frequency
    lines = np.linspace(8.0, 44.0, 48)
    s = 2j * np.pi * lines[:, None]
    values = (s**2 / (s**2 + 0.02 * omega * s + omega**2) * shapes[0]) @ shapes.T
    noise = rng.standard_normal((2, *values.shape))
    values = values + 0.01 * np.abs(values) * (noise[0] + 1j * noise[1]) / np.sqrt(2)
    names = [f"{i}X" for i in range(1, 10)]
    found = modal_identification(FrfRecord(lines, values[:, :, None], names, ["1X"], "accelerance"))
    np.testing.assert_allclose(found.modes.frequency, frequency, rtol=1e-3)
    assert max(found.orders) > 48 // 4


def test_peaks_that_no_mode_explains_are_named():
    lines = np.arange(0.0, 20.0, 0.02)
    level = sum(1 / ((lines**2 - f**2) ** 2 + (0.02 * f * lines) ** 2) for f in (3.0, 8.0, 8.1))
    known = ModalRecord([8.05], [0.01], [[1.0]], ["1X"])
    assert unexplained_peaks(lines, level, known) == pytest.approx([3.0], abs=0.03)
    both = ModalRecord([3.0, 8.05], [0.01, 0.01], [[1.0, 1.0]], ["1X"])
    assert not len(unexplained_peaks(lines, level, both))


def test_two_looks_keep_the_surer_of_a_mode_that_both_have():
    """Mode 2, below the split, is surer in the fast look; mode 3, above it, in the slow one."""

    def look(stds):
        shapes = np.linalg.qr(np.random.default_rng(0).standard_normal((4, 4)))[0][:, :3]
        variance = np.diag(np.square([*stds, *stds]))
        modes = ModalRecord([1.0, 2.0, 5.5], [0.01] * 3, shapes, ["1X", "2X", "3X", "4X"], variance)
        return ModalIdentification(modes, "pencil")

    both = joined(look([0.01, 0.05, 0.02]), look([0.02, 0.01, 0.06]), 5.0, 8.0)
    np.testing.assert_allclose(both.modes.frequency_std, [0.01, 0.01, 0.02])
    filtered = joined(look([0.01, 0.05, 0.02]), look([0.02, 0.01, 0.06]), 5.0, 5.2)
    np.testing.assert_allclose(filtered.modes.frequency_std, [0.01, 0.01, 0.06])


def test_a_likely_mode_that_one_look_lost_is_taken_from_the_other():
    """The slow look lost the mode at 2 Hz; the fast one has a pole of noise at 3 Hz besides, in few orders."""

    def look(frequency, spread):
        s = 2 * np.pi * np.array(frequency) * (-0.01 + 1j)
        shapes = np.linalg.qr(np.random.default_rng(0).standard_normal((4, 4)))[0][:, : len(s)]
        sweep = tuple(Poles(s, shapes, 2 * k + 8) for k in range(10))
        every = [
            Cluster(np.arange(10), np.full(10, i), np.full(10, f), np.full(10, 0.01), 0, 1.0, away, 0.5, 1.0)
            for i, (f, away) in enumerate(zip(frequency, spread, strict=True))
        ]
        modes = ModalRecord(frequency, [0.01] * len(s), shapes, ["1X", "2X", "3X", "4X"], np.eye(2 * len(s)) * 1e-4)
        return ModalIdentification(modes, "pencil", sweep, tuple(every))

    both = joined(look([1.0, 5.5], [1e-3, 1e-3]), look([1.0, 2.0, 3.0, 5.5], [1e-3, 1e-3, 1.0, 1e-3]), 5.0, 8.0)
    np.testing.assert_allclose(both.modes.frequency, [1.0, 2.0, 5.5])


def test_poles_of_one_look_do_not_lie_over_a_mode_of_the_other():
    """The fast look's mode at 3 Hz is taken from the slow one, where it is surer, though it lies above the split."""

    def look(std, n_orders):
        s = 2 * np.pi * np.array([1.0, 3.0]) * (-0.01 + 1j)
        shapes = np.eye(4)[:, :2]
        sweep = tuple(Poles(s * (1 + 1e-4 * k), shapes, 2 * k + 8) for k in range(n_orders))
        every = [
            Cluster(
                np.arange(n_orders),
                np.full(n_orders, i),
                f * (1 + 1e-4 * np.arange(n_orders)),
                np.full(n_orders, 0.01),
                0,
            )
            for i, f in enumerate((1.0, 3.0))
        ]
        modes = ModalRecord([1.0, 3.0], [0.01] * 2, shapes, ["1X", "2X", "3X", "4X"], np.eye(4) * std**2)
        return ModalIdentification(modes, "pencil", sweep, tuple(every))

    both = joined(look(1e-3, 3), look(1e-2, 4), 2.0, 8.0)
    assert [len(poles.frequency) for poles in both.sweep] == [2, 2, 2, 0, 0, 0, 0]


def test_modes_of_a_free_decay_that_die_out_are_no_tones():
    omega, shapes = chain_modes()
    record = decay(omega, shapes, 60.0, 0.05, velocity=shapes[0], damping_ratio=5e-4, noise=0.01)
    found = modal_identification(record)
    assert found.is_free_decay
    assert dies_out(found).sum() >= 3
    assert not dies_out(modal_identification(ambient_chain(0, duration=300.0))).any()


def test_phase_deviation_is_0_on_a_line_and_45_on_a_circle():
    line, circle = np.array([1.0, -2.0, 0.5]) * np.exp(0.7j), np.exp(2j * np.pi * np.arange(720) / 720)
    assert modal_phase_deviation(line[:, None]) == pytest.approx([0.0], abs=1e-6)
    assert modal_phase_deviation(circle[:, None]) == pytest.approx([45.0], abs=0.1)
    bent = np.array([1.0, np.exp(1j * np.radians(10.0))])
    assert modal_phase_deviation(bent[:, None]) == pytest.approx([5.0])
    assert np.isnan(modal_phase_deviation(np.full((2, 1), np.nan + 0j))).all()


def test_a_weak_steady_tone_in_a_decay_is_left_out_and_named():
    """Mains of 0.3 % of each channel beside four modes that die out."""
    omega, shapes = chain_modes()
    record = decay(omega, shapes, 100.0, 0.05, velocity=shapes[0], damping_ratio=0.01, noise=0.005)
    hum = 0.003 * record.values.std(axis=0) * np.sin(2 * np.pi * 5.0 * np.arange(len(record.values))[:, None] * 0.05)
    found = modal_identification(replace(record, values=record.values + hum))
    np.testing.assert_allclose(found.modes.omega, omega, rtol=1e-3)
    (tone,) = (part for part in found.left_out if "tone" in part.reason)
    assert tone.frequency == pytest.approx(5.0, rel=1e-3)
    assert any("tone" in words for words in found.modes.warnings)
