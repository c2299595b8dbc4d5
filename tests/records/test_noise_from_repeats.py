"""Noise of few repeats and of coherence that files round: what is known of it, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from structid import FrfRecord, InputError
from structid.records import from_repeats, with_coherence_noise, with_declared_noise

FREQUENCY = np.arange(1.0, 61.0, 0.1)


def truth():
    s = 2j * np.pi * FREQUENCY
    return sum(1 / (s**2 + 2 * 0.02 * w * s + w**2) for w in 2 * np.pi * np.array([9.0, 23.0, 41.0]))[:, None, None]


def repeated(count, relative, absolute, seed):
    rng, h = np.random.default_rng(seed), truth()
    size = np.hypot(relative * np.abs(h), absolute) / np.sqrt(2)
    noise = size * (rng.standard_normal((count, *h.shape)) + 1j * rng.standard_normal((count, *h.shape)))
    return from_repeats([FrfRecord(FREQUENCY, h + one, ["1X"], ["1X"], "receptance") for one in noise])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"kind": "mobility"}, r"their kind: repeat 1 \(a\) has receptance, where repeat 3 \(c\) has mobility"),
        ({"outputs": ("3X", "2Y")}, r"outputs: repeat 1 \(a\) has 2X\+, where repeat 3 \(c\) has 2Y\+"),
        ({"outputs": ("2X", "3X")}, r"outputs: repeat 1 \(a\) has another order"),
        ({"inputs": ["7Z"]}, r"inputs: repeat 1 \(a\) has 1X\+, where repeat 3 \(c\) has 7Z\+"),
        (
            {"decay": [0.4, 0.4, 0.4]},
            r"windows, 1/s: repeat 1 \(a\) has 0, 0, 0, where repeat 3 \(c\) has 0.4, 0.4, 0.4",
        ),
        ({"segment": 2.0}, r"segments, s: repeat 1 \(a\) has None, where repeat 3 \(c\) has 2"),
        ({"frequency": [1, 2.5, 3]}, r"frequencies, Hz: repeat 1 \(a\) has 2, where repeat 3 \(c\) has 2.5"),
        (
            {"frequency": [1, 2], "values": np.ones((2, 2, 1))},
            r"Hz: repeat 1 \(a\) has 3, where repeat 3 \(c\) has none",
        ),
    ],
)
def test_repeats_that_differ_say_in_what(changes, words):
    first = FrfRecord([1, 2, 3], np.ones((3, 2, 1)), ["3X", "2X"], ["1X"], "receptance", source="a")
    with pytest.raises(InputError, match=f"must share .*{words}"):
        from_repeats([first, replace(first, source="b"), replace(first, source="c", **changes)])


def test_a_repeat_that_is_longer_than_the_first_is_the_one_with_more():
    record = FrfRecord([1, 2, 3], np.ones((3, 1, 1)), ["3X"], ["1X"], "receptance")
    with pytest.raises(InputError, match="repeat 2 has 3, where repeat 1 has none"):
        from_repeats([record.band(1, 2), record])


@pytest.mark.parametrize(("relative", "absolute"), [(0.02, 0.0), (0.0, 3e-6)])
@pytest.mark.parametrize("count", [2, 3, 5, 8, 15])
def test_the_whitened_error_of_few_repeats_is_as_large_as_it_should_be(count, relative, absolute):
    """Seeds 0 to 9: mean square 1 where the noise is known; 24 degrees of freedom leave 1.09, 2 and 4 infinitely much."""
    squares = []
    for seed in range(10):
        record = repeated(count, relative, absolute, seed)
        squares.append(np.abs(record.values - truth()) ** 2 / record.variance)
    assert np.mean(squares) == pytest.approx(1.05, abs=0.1)
    assert np.max(squares) < 60


def test_many_repeats_tell_each_line_by_itself():
    record = repeated(15, 0.02, 0.0, 0)
    rng, h = np.random.default_rng(0), truth()
    size = 0.02 * np.abs(h) / np.sqrt(2)
    values = h + size * (rng.standard_normal((15, *h.shape)) + 1j * rng.standard_normal((15, *h.shape)))
    np.testing.assert_allclose(record.variance, values.var(axis=0, ddof=1) / 15, rtol=1e-12)


def test_coherence_that_a_file_rounds_to_one_is_what_rounds_to_it():
    coherence = np.full((len(FREQUENCY), 1, 1), 0.999)
    coherence[100:110] = 1.0
    record = FrfRecord(FREQUENCY, truth(), ["1X"], ["1X"], "receptance", coherence=coherence, averages=10)
    variance = with_coherence_noise(record).variance
    np.testing.assert_allclose(variance[105] / np.abs(truth()[105]) ** 2, 5e-6 / 10, rtol=1e-4)
    always = replace(record, coherence=np.ones_like(coherence))
    assert (with_coherence_noise(always).variance == 0).all()  # which the fit refuses


def test_coherence_of_one_average_says_nothing():
    coherence = np.full((len(FREQUENCY), 1, 1), 0.9)
    record = FrfRecord(FREQUENCY, truth(), ["1X"], ["1X"], "receptance", coherence=coherence, averages=1)
    with pytest.raises(InputError, match=r"from 2 averages on, got `averages` = 1.*declare the noise instead"):
        with_coherence_noise(record)


def test_noise_in_words_and_magnitudes_without_phase_are_refused():
    values = np.linspace(1.0, 4.0, 12).reshape(12, 1, 1)
    with pytest.raises(InputError, match="magnitudes without their phase"):
        FrfRecord(np.arange(1.0, 13), values, ["3X"], ["1X"], "receptance")
    record = FrfRecord(np.arange(1.0, 13), values - 2, ["3X"], ["1X"], "receptance")  # undamped: both signs
    assert np.array_equal(
        record.values, FrfRecord(record.frequency, values + 0j, ["3X"], ["1X"], "receptance").values - 2
    )
    with pytest.raises(InputError, match="`relative` must be a finite number, got '1 %'"):
        with_declared_noise(record, relative="1 %")  # type: ignore[arg-type]
