"""What counts as a mode: damping in ambient motion, worth in free decays, and the limits that a user sets."""

from dataclasses import replace

import numpy as np
import pytest
from state_space_cases import ambient, chain, decay

from modes_cases import write_ambient
from structid import InputError
from structid.modal import METHODS, HardCriteria, ModalOptions, identify_modes, modal_identification
from structid.modal.poles.stabilization import Cluster
from structid.modal.subspace.subspace_modes import _with_borrowed_shapes_unknown
from structid.modal.survey.survey import modes_of_file

OF_TIME = [name for name, method in METHODS.items() if not method.of_frfs]
FREQUENCY = chain()[0]


@pytest.mark.parametrize("method", OF_TIME)
def test_ambient_motion_shows_no_mode_without_damping(method):
    """Three seeds with the hum of a machine at 9 Hz, whose poles lie on either side of the axis."""
    hums = 0
    for seed in range(3):
        result = modal_identification(ambient(seed, tone=9.0), method)
        found = result.modes
        assert not (found.damping_ratio <= 0).any()
        assert np.abs(found.frequency[:, None] / FREQUENCY - 1).min(axis=0).max() < 0.015
        hum = np.abs(found.frequency - 9.0) < 0.05
        words = [note for note in found.warnings if "noise or the tone of a machine, are left out: 9" in note]
        if method not in ("fdd", "bayesian_fft"):
            assert hum.sum() + len(words) == 1
        hums += hum.sum()
        assert len(result.clusters) in (0, found.n_modes)
    assert hums < 3 or method == "pencil"


def test_undamped_poles_asked_for_by_hand_are_no_modes_either():
    """A pole without damping stood nearest to 1.5 Hz; what is given has damping."""
    for seed in range(3):
        found = identify_modes(ambient(seed, tone=9.0), "ssi_cov", frequencies=[2.4, 9.0])
        assert (found.damping_ratio > 0).all()


def test_undamped_free_motion_keeps_its_modes():
    found = identify_modes(decay(0, ratio=0.0))
    np.testing.assert_allclose(found.frequency, FREQUENCY, rtol=1e-4)
    assert (np.abs(found.damping_ratio) < 1e-4).all()


def test_modes_of_a_decay_that_are_neither_certain_nor_strong_are_left_out():
    """The amplifiers' ringing at 14.3 Hz is a stable pole, uncertain by 1 %, with less than 1 % of the energy."""
    found = identify_modes(decay(0, rings=0.15))
    np.testing.assert_allclose(found.frequency, FREQUENCY, rtol=1e-3)
    assert any("less than 1 % of the energy are left out: 14." in note for note in found.warnings)
    wide = identify_modes(decay(0, rings=0.15), deviation=0.02)
    assert wide.n_modes == 5
    clean = identify_modes(decay(0))
    assert clean.n_modes == 4
    assert not any("left out" in note for note in clean.warnings)


def test_a_strong_mode_of_a_short_decay_stays_however_uncertain():
    """A third of a second: the lowest mode does not turn once, and holds most of the motion."""
    found = identify_modes(decay(2, duration=0.5, rate=200.0, noise=0.1))
    uncertain = found.frequency_std > 0.005 * found.frequency
    assert uncertain.any()
    assert np.abs(found.frequency[uncertain][:, None] / FREQUENCY - 1).min(axis=1).max() < 0.1


@pytest.mark.parametrize("method", ["pencil", "bayesian_fft"])
def test_limits_of_deviation_and_damping_hold_for_every_method(method):
    record = ambient(0)
    every = modal_identification(record, method)
    relative = every.modes.frequency_std / every.modes.frequency
    limit = float(np.sort(relative)[1:3].mean())
    few = modal_identification(record, method, replace(ModalOptions(), deviation=limit))
    np.testing.assert_array_equal(few.modes.frequency, every.modes.frequency[relative <= limit])
    assert few.modes.covariance.shape == (4, 4)
    assert len(few.clusters) in (0, 2)
    assert any(f"above {100 * limit:g} % of it are left out" in note for note in few.modes.warnings)
    with pytest.raises(InputError, match="no mode that stands out of the noise"):
        identify_modes(record, method, deviation=1e-9)
    damped = identify_modes(record, method, criteria=HardCriteria(damping_ratio=(0.0, 0.0115)))
    assert 0 < damped.n_modes < 4
    assert (damped.damping_ratio <= 0.0115).all()


def test_a_deviation_that_is_no_limit_is_named():
    with pytest.raises(InputError, match="`deviation` must be greater than 0, got 0"):
        ModalOptions(deviation=0.0)


def test_a_pole_beside_a_resonance_with_its_shape_is_judged_by_its_frequency_alone():
    """Poles at 5.1, 5.3, 5.3 and 8 Hz: only those within 20 % of the sure one and of its shape lose their own shape's worth."""
    poles = 2j * np.pi * np.array([5.1, 5.3, 5.3, 8.0])
    shapes = np.array([[1.0, 1.0, 1.0, 1.0], [-0.8, -0.7, 0.8, -0.8]])
    one = np.array([0])
    judged = [
        Cluster(one, one, np.abs(poles[k : k + 1]) / 6.28, np.array([0.01]), 0, excess=excess, shape_error=0.02)
        for k, excess in enumerate((1.0, 12.0, 12.0, 12.0))
    ]
    told = _with_borrowed_shapes_unknown(judged, poles, shapes)
    assert [cluster.shape_error for cluster in told] == [0.02, 1.0, 0.02, 0.02]


@pytest.mark.parametrize("seed", [5, 24])
def test_two_sensors_show_a_building_of_three_storeys_no_fourth_mode(seed, tmp_path):
    """Two records of 25, which showed a fourth mode within 8 % of the second or third, with its shape and a deviation of 1 %."""
    write_ambient(tmp_path / "ambient.h5", ("1X+", "2X+"), seed)
    found = modes_of_file(tmp_path / "ambient.h5").identification.modes
    assert found.frequency == pytest.approx([1.267, 3.55, 5.13], rel=0.01)
