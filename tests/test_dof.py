"""Names of degrees of freedom: every form, and the sense kept."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from structid.core.dof import DIRECTIONS, Dof, is_whole_number, parse_dof, parse_dofs, renamed
from structid.core.errors import InputError
from structid.dynamics.factorization import usable_threads
from structid.prediction.recovery import parse_output

dofs = st.builds(Dof, st.integers(0, 10**9), st.sampled_from(DIRECTIONS), st.sampled_from((1, -1)))


@pytest.mark.parametrize(
    "text, node, direction, sign",
    [
        ("12Z+", 12, "Z", 1), ("12Z", 12, "Z", 1), ("12Z-", 12, "Z", -1), ("12:+Z", 12, "Z", 1), ("12:-Z", 12, "Z", -1),
        ("12_z", 12, "Z", 1), ("12_-z", 12, "Z", -1), (" 3 RX- ", 3, "RX", -1), ("3rx", 3, "RX", 1), ("12-Z", 12, "Z", -1),
        ("12.1", 12, "X", 1), ("12.03", 12, "Z", 1), ("12.04", 12, "RX", 1), ("12.6-", 12, "RZ", -1), ("120.3", 120, "Z", 1),
    ],
)  # fmt: skip
def test_parse_dof_reads_form(text, node, direction, sign):
    assert parse_dof(text) == Dof(node, direction, sign)


@pytest.mark.parametrize(
    "text", ["", "Z", "12", "12Q", "12RW", "-3Z", "12Z++", "12:-Z+", "12.7", "12.0", "1.5.2", "x12Z"]
)
def test_parse_dof_refuses_with_example(text):
    with pytest.raises(InputError, match="12Z"):
        parse_dof(text)


@given(dofs)
def test_dof_text_round_trips(dof):
    assert parse_dof(str(dof)) == dof
    assert parse_dof(f"{dof.node}:{'+' if dof.sign > 0 else '-'}{dof.direction.lower()}") == dof
    assert parse_dof(f"{dof.node}.0{dof.axis + 1}{'+' if dof.sign > 0 else '-'}") == dof


def test_dof_unsigned_and_rotation():
    dof = Dof(4, "RY", -1)
    assert dof.unsigned == Dof(4, "RY", 1)
    assert dof.is_rotation
    assert not Dof(4, "Y").is_rotation
    assert [Dof(1, d).axis for d in DIRECTIONS] == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize("arguments", [(1, "Q"), (1, "z"), (1, "Z", 0), (1, "Z", 2)])
def test_dof_refuses(arguments):
    with pytest.raises(InputError, match="must be"):
        Dof(*arguments)


def test_parse_dofs_keeps_order():
    assert [str(dof) for dof in parse_dofs(["3Z-", Dof(1, "X"), "2.2"])] == ["3Z-", "1X+", "2Y+"]


def names(*groups):
    return tuple([str(dof) for dof in group] for group in groups)


def test_swapped_sensors_get_each_others_names_and_keep_their_senses():
    sensors, loads = parse_dofs(["3Z-", "5Z+", "7Z+"]), parse_dofs(["3Z+", "9Z-"])
    swapped = renamed(sensors, loads, {"3Z": "5Z", "5Z": "3Z"})
    assert names(*swapped) == (["5Z-", "3Z+", "7Z+"], ["3Z+", "9Z-"])
    assert renamed(*swapped, {"3Z": "5Z", "5Z": "3Z"}) == (sensors, loads)
    assert names(*renamed(sensors, loads, {"9_z": "8X", "7Z": "7Z-"})) == (["3Z-", "5Z+", "7Z-"], ["3Z+", "8X-"])
    assert names(*renamed(sensors, loads, {"3Z-": "4X", "9Z-": "8X-"})) == (["4X+", "5Z+", "7Z+"], ["3Z+", "8X-"])
    assert renamed(sensors, loads, {}) == (sensors, loads)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"4Z": "8Z"}, r"no channel 4Z; the record has 3Z-, 5Z\+, 3Z\+"),
        ({"3Z": "5Z"}, "3Z and 5Z would both be called 5Z"),
        ({"3Z": "8Z", "5Z": "8Z-"}, "3Z and 5Z would both be called 8Z"),
        ({"3Z": "8Z", "3Z-": "7Z"}, "3Z- is renamed twice"),
        ({"3Z": "up"}, "cannot read 'up'"),
    ],
)
def test_names_that_cannot_be_given_are_refused(given, words):
    with pytest.raises(InputError, match=words):
        renamed(parse_dofs(["3Z-", "5Z+"]), parse_dofs(["3Z+"]), given)


@pytest.mark.parametrize(
    "text, is_whole",
    [
        ("12", True),
        ("²", False),
        ("1²", False),
        ("", False),
        ("-1", False),
        ("1.0", False),
        ("9" * 15, True),
        ("9" * 16, False),
        ("9" * 5000, False),
    ],
)
def test_a_whole_number_is_what_int_reads(text, is_whole):
    assert is_whole_number(text) == is_whole
    assert not is_whole or int(text) >= 0


def test_numbers_that_int_refuses_are_refused_by_name(monkeypatch):
    monkeypatch.setenv("STRUCTID_THREADS", "²")
    with pytest.raises(InputError, match="STRUCTID_THREADS must be a positive whole number"):
        usable_threads(5)
    with pytest.raises(InputError, match="is at a node"):
        parse_output("M[deck:1@²]")
