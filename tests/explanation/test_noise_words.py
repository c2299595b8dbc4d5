"""A misfit is told in parts of the noise that the record has: stated, from coherence or repeats, or assumed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from structid.criticism.verdict import judged
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


def test_noises_of_several_kinds_are_those_of_the_records(tmp_path):
    text = _NO_NOISE.replace("[record]\n", "[[record]]\n").replace(
        "[method]", '[[record]]\npath = "other.npz"\n[record.noise]\nrelative = 0.001\n[method]'
    )
    path = write_chain(tmp_path, text, chain_record(variance=np.full((230, 2, 1), 1e-9)))
    (tmp_path / "other.npz").write_bytes((tmp_path / "frf.npz").read_bytes())
    assert "times the noise of the records" in judged(run_study(load_study(path)).identification).words
