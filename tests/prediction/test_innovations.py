"""The verdict on innovations by their size, their correlation in time and what models within the uncertainty make."""

import numpy as np
import pytest

from structid.prediction.sensing.innovations import Innovations, judge_innovations

N_TIMES = 400


def innovations(whitened, is_open=True):
    """Two directions that no force makes, which the spectrum of the forces may reach."""
    return Innovations(whitened, np.zeros(2, dtype=bool), np.full(2, is_open))


def judge(size, correlation=0.0, error=0.0, uncertainty=0.0, has_stated_noise=True, is_open=True):
    """Verdict on innovations of root mean square `size` whose neighbours have a correlation, beside 20 white replicates.

    An error of the model adds a sine of the root mean square `error` to them, and one of its deviation that of `uncertainty`.
    """
    rng = np.random.default_rng(1)
    sine = np.sqrt(2) * np.sin(0.3 * np.arange(N_TIMES))[:, None] * np.ones(2)
    white = rng.standard_normal((N_TIMES + 1, 2))
    record = white[1:] + correlation * white[:-1]
    record *= size / np.sqrt(np.mean(record**2))
    deviations, values = rng.standard_normal(20), rng.standard_normal((20, N_TIMES, 2))
    replicates = [innovations(each, is_open) for each in values]
    apart = -uncertainty * deviations[:, None, None] * sine
    return judge_innovations(innovations(record + error * sine, is_open), replicates, apart, has_stated_noise, False)


@pytest.mark.parametrize(
    ("case", "is_contradicted", "has_words"),
    [
        ({"size": 1.1}, False, False),
        ({"size": 1.3}, True, True),
        ({"size": 1.0, "error": 2.0}, True, True),  # an exact model makes no excess
        ({"size": 1.0, "error": 2.0, "uncertainty": 2.0}, False, True),  # a note on the spectrum
        ({"size": 1.0, "error": 4.0, "uncertainty": 2.0}, False, True),
        ({"size": 1.3, "error": 2.0, "uncertainty": 2.0}, True, True),  # beside what the uncertain model makes
        ({"size": 1.0, "error": 2.0, "uncertainty": 0.3}, True, True),  # no plausible model
    ],
)
def test_larger_innovations_contradict_a_model_unless_its_uncertainty_makes_them(case, is_contradicted, has_words):
    verdict = judge(**case)
    assert (verdict.is_contradicted, bool(verdict.words)) == (is_contradicted, has_words)


def test_a_model_that_is_farther_off_than_it_may_be_is_told_as_such():
    words = judge(1.0, error=2.0, uncertainty=0.3).words
    assert "the record asks for a model that is" in words
    for cause in ("the model is wrong", "a force acts where none is named", "the sensors have more noise than stated"):
        assert cause in words


@pytest.mark.parametrize(("is_open", "is_contradicted"), [(False, True), (True, False)])
def test_weak_correlation_contradicts_the_model_only_where_no_spectrum_of_the_forces_makes_it(is_open, is_contradicted):
    verdict = judge(1.0, correlation=0.4, is_open=is_open)
    assert verdict.is_contradicted == is_contradicted
    assert "correlated in time" in verdict.words


def test_larger_innovations_without_a_stated_noise_are_a_note():
    verdict = judge(2.0, has_stated_noise=False)
    assert not verdict.is_contradicted
    assert "the record states no noise" in verdict.words
