"""Every variation of a header is read as it says, or refused: files of a writer that shares nothing with structid."""

from collections import Counter

import numpy as np
import pytest
from fuzz.headers import read_case
from header_cases import judge
from laboratory_cases import WRITERS

from structid.core.errors import InputError
from structid.core.units import parse_unit
from structid.records.formats.headers import units_in_name
from structid.records.formats.named_channels import scale_of_times
from structid.records.formats.options import ReadOptions


@pytest.mark.parametrize("kind", WRITERS)
def test_headers_are_read_right_or_refused(tmp_path, kind):
    outcomes = Counter()
    for seed in range(200):
        case = WRITERS[kind](f"fixed {seed}")
        outcome, words = judge(case, tmp_path / f"a{case.suffix}", read_case, InputError)
        outcomes[outcome] += 1
        assert outcome in ("read", "refused"), f"{kind} {seed} {outcome}: {words}\n" + "\n".join(map(str, case.notes))
    assert min(outcomes["read"], outcomes["refused"]) > 40


@pytest.mark.parametrize("name", ["Acc G", "disp_in", "F_N"])
def test_a_last_word_that_may_be_a_channel_a_side_or_a_direction_is_no_unit(name):
    assert units_in_name(name, parse_unit) == []


@pytest.mark.parametrize("name", ["Force (in)", "Push (N)"])
def test_a_word_in_brackets_that_may_be_a_side_or_a_direction_is_no_sure_unit(name):
    assert not any(is_sure for _, _, is_sure in units_in_name(name, parse_unit))


@pytest.mark.parametrize("name", ["Acc_g", "Acc [g]", "a / g", "disp_mm"])
def test_a_unit_in_a_name_is_seen(name):
    assert units_in_name(name, parse_unit)


@pytest.mark.parametrize("name", ["", "Time"])
def test_a_unit_of_times_that_the_option_contradicts_is_told_whatever_the_channel_is_called(name):
    with pytest.raises(
        InputError, match="channel 1 says the unit of its times, but `axis_unit` s was given; leave it out"
    ):
        scale_of_times("channel 1", name, "ms", np.arange(3.0), ReadOptions(axis_unit="s"))
