"""The verdict on innovations by their size, their correlation in time and what the drawn models make."""

import numpy as np
import pytest

from structid.prediction.sensing.innovations import Innovations, judge_innovations

N_TIMES = 400


def innovations(whitened, is_open=True):
    """Two directions that no force makes, which the spectrum of the forces may reach."""
    return Innovations(whitened, np.zeros(2, dtype=bool), np.full(2, is_open))


def judge(size, correlation, spread, has_stated_noise=True, is_open=True):
    """Verdict on innovations of root mean square `size` whose neighbours have a correlation, beside 20 white replicates."""
    rng = np.random.default_rng(1)
    white = rng.standard_normal((N_TIMES + 1, 2))
    record = white[1:] + correlation * white[:-1]
    record *= size / np.sqrt(np.mean(record**2))
    replicates = []
    for _ in range(20):
        values = rng.standard_normal((N_TIMES, 2))
        values *= (1 + 0.001 * rng.standard_normal()) / np.sqrt(np.mean(values**2))
        replicates.append(innovations(values, is_open))
    return judge_innovations(innovations(record, is_open), replicates, has_stated_noise, False, np.full(2, spread))


@pytest.mark.parametrize(
    ("size", "correlation", "spread", "is_contradicted", "has_words"),
    [
        (1.1, 0.0, 0.0, False, False),
        (1.3, 0.0, 0.0, True, True),
        (2.0, 0.0, 0.0, True, True),
        (2.0, 0.0, 2.0, True, True),  # white errors are no narrow spectrum
        (2.0, 0.7, 0.0, True, True),  # an exact model makes no excess
        (2.0, 0.7, 0.5, True, True),  # an excess of 1.7 is more than three deviations
        (2.0, 0.7, 0.6, False, True),
        (2.4, 0.7, 2.0, False, True),
        (2.6, 0.7, 2.0, True, True),
    ],
)
def test_larger_innovations_are_a_doubt_only_where_an_uncertain_model_makes_them(
    size, correlation, spread, is_contradicted, has_words
):
    verdict = judge(size, correlation, spread)
    assert (verdict.is_contradicted, bool(verdict.words)) == (is_contradicted, has_words)


def test_the_doubt_names_all_that_may_be_wrong():
    words = judge(2.0, 0.7, 2.0).words
    assert words.startswith("the prediction errors of the sensors are 2 times as large as they should be")
    for cause in (
        "forces of a narrow spectrum",
        "it may be wrong",
        "a force may act where none is named",
        "the sensors may have more noise than stated",
    ):
        assert cause in words


@pytest.mark.parametrize(("is_open", "is_contradicted"), [(False, True), (True, False)])
def test_weak_correlation_contradicts_the_model_only_where_no_spectrum_of_the_forces_makes_it(is_open, is_contradicted):
    verdict = judge(1.0, 0.4, 0.0, is_open=is_open)
    assert verdict.is_contradicted == is_contradicted
    assert "correlated in time" in verdict.words


def test_larger_innovations_without_a_stated_noise_are_a_note():
    verdict = judge(2.0, 0.0, 0.0, has_stated_noise=False)
    assert not verdict.is_contradicted
    assert "the record states no noise" in verdict.words
