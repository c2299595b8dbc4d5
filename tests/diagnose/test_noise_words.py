"""A misfit is told in parts of the noise that the record has: stated, from coherence or repeats, or assumed."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from structid.diagnose.verdict import Cause, _off_resonances, judged, noise_ratio
from structid.identification.record_fit import Resonance
from structid.study.run.run import run_study
from structid.study.schema.study import load_study
from study_cases import CHAIN, chain_record, replaced, write_chain

_NO_NOISE = replaced("[record.noise]\nrelative = 0.01\n", "", CHAIN)


@pytest.mark.parametrize(
    ("source", "noise", "words"),
    [
        ("declared", 0.001, " times the stated noise;"),
        ("coherence", 0.001, " times the noise that coherence tells;"),
        ("repeats", 0.001, " times the noise that repeats tell;"),
        ("unknown", 0.001, " times the noise that the record has;"),
        ("unknown", None, " times the assumed noise (10 % of each value);"),
    ],
)
def test_the_noise_is_called_what_it_is(tmp_path, source, noise, words):
    record = chain_record()
    variance = None if noise is None else (noise * np.abs(record.values)) ** 2
    path = write_chain(tmp_path, _NO_NOISE, replace(record, variance=variance, noise_source=source))
    found = run_study(load_study(path)).identification
    assert words in judged(found).words


def test_noise_that_is_stated_too_large_is_no_misfit(tmp_path):
    """Intervals are those of the stated noise then: a residual below it makes them no narrower."""
    path = write_chain(tmp_path, replaced("relative = 0.01", "relative = 0.02"))
    found = run_study(load_study(path)).identification
    assert found.estimate.covariance_basis == "noise"
    assert judged(found).words == (
        "Approximate: the model explains the record to within 0.49 times the stated noise; that is more than the data show,"
        " and the intervals are those of the stated or assumed noise."
    )
    level = Cause("noise_level", ("all records",), "the noise is 0.5 times what was stated or assumed", 1.0, 1.0)
    assert judged(found, [level]).words.endswith("; the intervals are those of the stated or assumed noise.")


@pytest.mark.parametrize(("scale", "noise", "expected"), [(1e-3, 0.01, None), (1.0, 0.001, 9.7), (1.0, 0.1, 0.097)])
def test_a_calibration_beyond_its_tolerance_is_no_noise(tmp_path, scale, noise, expected):
    """A record a thousand times too small was called one of 13 times the noise: the tolerance of the calibration took the rest."""
    text = CHAIN.replace('elements = "upper"\neach = true', 'elements = "upper"')
    for number, mass in ((1, 2.0), (2, 3.0), (3, 1.0)):
        text = replaced(f'[[unknown]]\nproperty = "mass"\nelements = "mass {number}"\n', "", text)
        text = replaced(
            f"nodes = {number}\nmass = {1.2 if number == 3 else 2.4}", f"nodes = {number}\nmass = {mass}", text
        )
    path = write_chain(tmp_path, replaced("relative = 0.01", f"relative = {noise}", text), chain_record(scale=scale))
    ratio = noise_ratio(run_study(load_study(path)).identification)
    assert ratio is None if expected is None else ratio == pytest.approx(expected, rel=0.02)


def test_noises_of_several_kinds_are_those_of_the_records(tmp_path):
    text = _NO_NOISE.replace("[record]\n", "[[record]]\n").replace(
        "[method]", '[[record]]\npath = "other.npz"\n[record.noise]\nrelative = 0.001\n[method]'
    )
    path = write_chain(tmp_path, text, chain_record(variance=np.full((230, 2, 1), 1e-9)))
    (tmp_path / "other.npz").write_bytes((tmp_path / "frf.npz").read_bytes())
    assert "times the noise of the records" in judged(run_study(load_study(path)).identification).words


@pytest.mark.parametrize(("mode", "count"), [(8.1, 0), (9.5, 1)])
def test_a_mode_that_is_narrower_than_the_lines_is_no_resonance_that_the_model_lacks(mode, count):
    """Lines every 0.25 Hz see no peak of a mode at 8.1 Hz with 0.5 % of damping."""
    frequency = np.arange(5.0, 20.0, 0.25)
    problem = SimpleNamespace(
        frequency=frequency,
        rows=SimpleNamespace(lines=np.arange(len(frequency))),
        data_rows=lambda _: np.full(len(frequency), 3.0),
    )
    modes = SimpleNamespace(frequency=np.array([mode, 50.0]), damping_ratio=np.array([0.005, 0.005]))
    fit = SimpleNamespace(problem=problem, predicted=None, resonances=[Resonance(8.25, np.nan)], modes=modes)
    assert [words for _, words in _off_resonances(fit)] == ["the model has no resonance near 8.25 Hz"] * count
