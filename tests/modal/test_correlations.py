"""Covariances at lags against sums written out, whole and piece by piece."""

import numpy as np
import pytest
from modal_cases import beam_decay

import structid.modal.correlations as correlations_module
from structid import TimeRecord
from structid.modal.correlations import (
    lag_hankels,
    lag_sums,
    outputs,
    pieces,
    window_hankel,
    window_hankels,
)


def two_records():
    rng = np.random.default_rng(1)
    return [
        TimeRecord(10.0, rng.standard_normal((n, 3)) * [1.0, 50.0, 1e-3], ("1Z", "2Z", "1Z"), kinds)
        for n in (60, 45)
        for kinds in [("velocity", "velocity", "displacement")]
    ]


def by_hand(y, instants, rows, columns, offset):
    total = 0.0
    for t in instants:
        future = np.concatenate([y[t + offset + r] for r in range(rows)])
        past = np.concatenate([y[t - c] for c in range(columns)])
        total = total + np.outer(future, past)
    return total


@pytest.mark.parametrize(("rows", "columns", "offset"), [(4, 4, 1), (3, 5, 0), (5, 2, 3), (3, 1, -1)])
def test_window_hankel_is_the_sum_over_one_window(rows, columns, offset):
    y = np.random.default_rng(0).standard_normal((40, 2))
    found = window_hankel(y, 7, 29, rows, columns, offset)
    np.testing.assert_allclose(found, by_hand(y, range(7, 29), rows, columns, offset), rtol=0, atol=1e-13)


def test_window_hankel_of_a_window_shorter_than_its_lags_at_the_end_of_the_record():
    y = np.random.default_rng(4).standard_normal((40, 2))
    found = window_hankel(y, 33, 36, 4, 12, 1)
    np.testing.assert_allclose(found, by_hand(y, range(33, 36), 4, 12, 1), rtol=0, atol=1e-13)


@pytest.mark.parametrize(("first_lag", "stop"), [(-1, 2400), (0, 2500), (3, 2490)])
@pytest.mark.parametrize("at_once", [1, 7, 1000])
def test_lag_sums_over_many_segments_are_products_of_the_shifted_record(first_lag, stop, at_once, monkeypatch):
    monkeypatch.setattr(correlations_module, "_AT_ONCE", at_once)
    y = np.random.default_rng(2).standard_normal((2500, 3))
    ahead = np.concatenate([y, np.zeros((20, 3))])
    expected = [ahead[5 + k : stop + k].T @ y[5:stop] for k in range(first_lag, first_lag + 17)]
    found = lag_sums(y, first_lag, 17, 5, stop)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * len(y))


def test_pieces_of_the_window_add_up_over_records():
    data = outputs(two_records())
    parts = pieces(data, 3, 4, 5)
    assert sum(piece.part for piece in parts) == pytest.approx(1.0)
    assert {piece.record for piece in parts} == {0, 1}
    whole = sum(window_hankels(data, parts, 4, 4, 1))
    n = 60 + 45 - 2 * 7
    expected = sum(by_hand(y, range(3, len(y) - 4), 4, 4, 1) for y in data.series) / n
    np.testing.assert_allclose(whole, expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("n_pieces", [1, 6])
def test_pieces_of_lag_covariances_add_up_to_the_unbiased_ones(n_pieces):
    data = outputs(two_records())
    windows = pieces(data, 0, 6, n_pieces)
    whole = sum(lag_hankels(data, windows, 3, 3, 1)).reshape(3, 3, 3, 3)
    lags = [
        sum(y[k:].T @ y[: len(y) - k] for y in data.series) / sum(len(y) - k for y in data.series) for k in range(6)
    ]
    for r in range(3):
        for c in range(3):
            np.testing.assert_allclose(whole[r, :, c], lags[1 + r + c], rtol=0, atol=1e-13)


def test_every_channel_is_scaled_to_its_rms():
    data = outputs(two_records())
    both = np.concatenate(data.series)
    assert np.mean(both**2, axis=0) == pytest.approx(np.ones(3))
    assert data.scale == pytest.approx([1.0, 50.0, 1e-3], rel=0.25)
    assert data.derivative.tolist() == [1, 1, 0]


def test_forces_are_left_out():
    record = beam_decay(kinds=(0,))
    values = np.concatenate([record.values, record.values[:, :1]], axis=1)
    with_force = TimeRecord(20.0, values, (*record.channels, "1Y"), (*record.quantities, "force"))
    assert outputs(with_force).n_channels == 10
