"""Groups of close modes, and what is said of them."""

import numpy as np
import pytest
from modal_cases import decay

from structid import ModalRecord, subspace_angles
from structid.modal.close_modes import close_groups, close_mode_notes, gap_std, is_close, repeated_modes
from structid.modal.identification import identify_modes
from structid.similarity import mac


def record(frequency, damping=0.0, std=None, correlation=0.0):
    n = len(frequency)
    covariance = None
    if std is not None:
        covariance = np.zeros((2 * n, 2 * n))
        covariance[:n, :n] = std**2 * ((1 - correlation) * np.eye(n) + correlation)
    return ModalRecord(np.array(frequency), np.full(n, damping), np.eye(n), [f"{i + 1}X" for i in range(n)], covariance)


def test_close_modes_are_those_whose_half_power_bands_touch():
    # half-power bandwidths 2 zeta f = 0.02 Hz around 1 Hz: peaks overlap below a gap of 0.02 Hz
    assert is_close(record([1.0, 1.0199], damping=0.01)).all()
    assert not is_close(record([1.0, 1.0203], damping=0.01)).any()


def test_close_modes_are_those_that_their_intervals_do_not_tell_apart():
    # std of a gap of independent frequencies is sqrt(2) 0.01, its interval 1.96 times that: 0.0277 Hz
    assert is_close(record([1.0, 1.027], std=0.01)).all()
    assert not is_close(record([1.0, 1.029], std=0.01)).any()
    np.testing.assert_allclose(gap_std(record([1.0, 1.2], std=0.01)), 0.01 * np.sqrt(2))
    assert not is_close(record([1.0, 1.027], std=0.01, correlation=0.5)).any()  # a common error is no doubt of the gap


def test_close_modes_form_groups():
    modes = record([1.0, 2.0, 2.01, 2.02, 5.0], damping=0.005)
    assert [group.tolist() for group in close_groups(modes)] == [[0], [1, 2, 3], [4]]


def test_close_modes_without_damping_or_covariance_are_equal_ones_only():
    modes = record([1.0, 1.0, 1.0000001], damping=np.nan)
    assert is_close(modes).tolist() == [True, False]


@pytest.mark.parametrize(("duration", "warned"), [(99.0, True), (101.0, False)])
def test_close_mode_notes_warn_below_half_a_beat(duration, warned):
    notes = close_mode_notes(record([1.0, 1.005]), duration)  # gap 0.01 pi rad/s: T gap / pi = 1 at 100 s
    assert any("half their beat of 200 s" in note and "measure 100 s" in note for note in notes) is warned


def test_close_mode_notes_say_that_two_modes_are_not_separate():
    (note,) = close_mode_notes(record([1.0, 1.001], std=0.01), 1e4)
    assert "modes 1 and 2" in note
    assert "not separate" in note
    assert "principal angles" in note
    assert close_mode_notes(record([1.0, 1.1], std=0.01), 1e4) == ()


def twins(gap, turned=0.0, n_channels=4, frequency_std=0.01):
    """Two modes at 1 Hz and a bit more, of one shape or turned by an angle, the damping of the second better known."""
    first = np.eye(n_channels)[0]
    shapes = np.column_stack([first, np.cos(turned) * first + np.sin(turned) * np.eye(n_channels)[1]])
    covariance = np.diag([frequency_std, frequency_std, 0.02, 0.01]) ** 2
    names = [f"{i + 1}X" for i in range(n_channels)]
    return ModalRecord(np.array([1.0, 1.0 + gap]), np.full(2, 0.01), shapes, names, covariance)


def test_a_mode_found_twice_is_the_one_of_better_known_damping():
    # the gap's 95 % interval reaches 1.96 sqrt(2) 0.01 = 0.0277 Hz; a turn of 0.2 rad makes a MAC of 0.96
    assert repeated_modes(twins(0.02)).tolist() == [True, False]
    for told in (twins(0.03), twins(0.02, turned=0.2), twins(0.02, n_channels=2), record([1.0, 1.0])):
        assert not repeated_modes(told).any()


def test_close_mode_notes_ask_for_as_many_free_decays_as_shapes():
    modes = record([1.0, 1.001], std=0.01)
    assert any("give 2 records" in note for note in close_mode_notes(modes, 1e4, 1, free_decay=True))
    assert not any("records" in note for note in close_mode_notes(modes, 1e4, 2, free_decay=True))


def test_two_decays_of_a_repeated_frequency_give_its_subspace_where_shapes_are_arbitrary():
    omega, shapes = np.array([2.0, 2.0, 5.0]), np.linalg.qr(np.random.default_rng(1).standard_normal((4, 3)))[0]
    starts = [shapes[0], shapes[1]]
    records = [decay(omega, shapes, 60.0, 0.1, velocity=v, damping_ratio=0.01) for v in starts]
    found = identify_modes(records, orders=[6], n_pieces=0)
    assert len(found.frequency) == 3
    angles = subspace_angles(shapes[:, :2], found.mode_shapes[:, :2])
    np.testing.assert_allclose(angles, 0.0, atol=1e-6)
    assert mac(shapes[:, :2], found.mode_shapes[:, :2]).max() < 0.999  # no single shape is that of the truth
    single = identify_modes(records[0], orders=[4], n_pieces=0)
    assert len(single.frequency) == 2  # one start shows the pair as one mode


def test_identified_modes_carry_the_words_on_close_ones():
    omega, shapes = 2 * np.pi * np.array([2.0, 2.002]), np.array([[1.0, 1.0], [1.0, -1.0], [0.5, 0.8]])
    start = np.array([1.0, 1.0])
    record = decay(omega, shapes, 50.0, 0.05, velocity=start, noise=0.002, seed=1)  # a tenth of the beat of 500 s
    found = identify_modes(record, orders=[4])
    assert any("half their beat" in note for note in found.warnings)
    apart = decay(omega * [1.0, 1.5], shapes, 50.0, 0.05, velocity=start, noise=0.002, seed=1)
    assert not any("beat" in note for note in identify_modes(apart, orders=[4]).warnings)
