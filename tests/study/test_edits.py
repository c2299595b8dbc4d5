"""Edits of a study keep comments and order, and give what one would write by hand."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from structid.core.errors import InputError
from structid.study.schema import edits
from structid.study.schema.edits import changed_text, edited, value_of

EXAMPLES = Path(__file__).parent.parent.parent / "examples"
STUDIES = ("first_structure", "three_storey_frame", "ambient_storeys", "plate_from_mesh", "motion_of_a_frame")


def text_of(name: str) -> str:
    return (EXAMPLES / name / "study.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", STUDIES)
def test_no_edit_changes_nothing(name):
    assert edited(text_of(name), []) == text_of(name)


@pytest.mark.parametrize("name", STUDIES)
def test_setting_what_is_there_already_changes_nothing(name):
    text = text_of(name)
    record = tomllib.loads(text)["record"]["path"]
    title = tomllib.loads(text)["title"]
    assert (
        edited(text, [{"set": ["record", "path"], "to": f'"{record}"'}, {"set": ["title"], "to": f'"{title}"'}]) == text
    )


@pytest.mark.parametrize("name", ["first_structure", "three_storey_frame", "ambient_storeys"])
def test_the_last_unknown_taken_out_and_added_again_is_the_file_as_written_by_hand(name):
    text = text_of(name)
    entry = tomllib.loads(text)["unknown"][-1]
    number = len(tomllib.loads(text)["unknown"]) - 1
    without = edited(text, [{"remove": ["unknown", number]}])
    assert without != text
    table = {"property": f'"{entry["property"]}"', "elements": f'"{entry["elements"]}"'}
    table |= {"each": "true"} if entry.get("each") else {}
    assert edited(without, [{"add": ["unknown"], "table": table}]) == text


def test_the_study_of_the_first_structure_made_by_edits_is_the_file_written_by_hand():
    """All that the pages write: unknowns, record, spectra and band, from the structure on."""
    text = text_of("first_structure")
    bare = text[: text.index("\n[[unknown]]")]
    made = edited(
        bare,
        [
            {"add": ["unknown"], "table": {"property": '"bending_stiffness"', "elements": '"strip"'}},
            {"add": ["unknown"], "table": {"property": '"mass"', "elements": '"tip"'}},
            {"add": ["unknown"], "table": {"property": '"loss_factor"', "elements": '"strip"'}},
            {"set": ["record", "path"], "to": '"record.csv"'},
            {"set": ["record", "frf", "segment_length"], "to": "2048"},
            {"set": ["method", "band"], "to": "[4.0, 150.0]"},
        ],
    )
    by_hand = [line.split("#")[0].rstrip() for line in text.splitlines()]
    assert [line.split("#")[0].rstrip() for line in made.splitlines()] == by_hand


def test_the_ambient_study_made_by_edits_is_the_file_written_by_hand():
    text = text_of("ambient_storeys")
    bare = text[: text.index("\n[[unknown]]")]
    table = {"property": '"stiffness"', "elements": '"storey"', "each": "true"}
    edits = [
        {"add": ["unknown"], "table": table},
        {"set": ["record", "path"], "to": '"modes.json"'},
        {"set": ["record", "modes", "form"], "to": '"output"'},
    ]
    assert edited(bare, edits) == text


def test_the_frame_made_by_edits_is_the_file_written_by_hand():
    text = text_of("three_storey_frame")
    start, end = text.index("\n[[unknown]]"), text.index("\n[record]")
    table = tomllib.loads(text)
    edits = []
    for entry in table["unknown"]:
        elements = entry["elements"]
        words = f'"{elements}"' if isinstance(elements, str) else "[" + ", ".join(f'"{e}"' for e in elements) + "]"
        made = {"property": f'"{entry["property"]}"', "elements": words}
        made |= {"name": f'"{entry["name"]}"'} if "name" in entry else {}
        edits.append({"add": ["unknown"], "table": made})
    without = text[:start] + "\n" * 0
    assert edited(without, edits) == text[:end]


def test_a_value_keeps_its_comment():
    text = text_of("first_structure")
    found = edited(text, [{"set": ["structure", "beam", 0, "bending_stiffness"], "to": "27.5"}])
    assert found == text.replace("bending_stiffness = 25.0 ", "bending_stiffness = 27.5 ")
    found = edited(text, [{"set": ["method", "band"], "to": "[5.0, 140.0]"}])
    assert found == text.replace("band = [4.0, 150.0]", "band = [5.0, 140.0]")


def test_a_new_key_stands_with_its_table():
    text = text_of("three_storey_frame")
    found = edited(text, [{"set": ["unknown", 3, "prior"], "to": "{ mean = 0.125, std = 0.05 }"}])
    place = 'elements = "hardware"\n\n[[unknown]]'
    assert found == text.replace(place, 'elements = "hardware"\nprior = { mean = 0.125, std = 0.05 }\n\n[[unknown]]')
    assert edited(found, [{"remove": ["unknown", 3, "prior"]}]) == text


def test_sensors_come_and_go():
    text = text_of("first_structure")
    found = edited(text, [{"set": ["record", "sensors", "3Y"], "to": "{ node = 4, direction = [0.0, 1.0, 0.0] }"}])
    assert tomllib.loads(found)["record"]["sensors"] == {"3Y": {"node": 4, "direction": [0.0, 1.0, 0.0]}}
    for line in text.splitlines():
        assert line in found.splitlines()
    gone = edited(found, [{"remove": ["record", "sensors"]}])
    assert tomllib.loads(gone) == tomllib.loads(text)


@pytest.mark.parametrize("name", ["first_structure", "three_storey_frame"])
def test_a_record_becomes_one_of_several_and_is_alone_again(name):
    """Keys, tables and comments of the first stay where they are."""
    text = text_of(name)
    edits = [
        {"list": ["record"]},
        {"add": ["record"], "table": {"path": '"second.csv"'}},
        {"set": ["record", 1, "frf", "segment_length"], "to": "512"},
        {"add": ["record", 0, "channel_error"], "table": {"property": '"gain"', "outputs": '"all"'}},
    ]
    found = edited(text, edits)
    records = tomllib.loads(found)["record"]
    assert records[0].pop("channel_error") == [{"property": "gain", "outputs": "all"}]
    assert records == [tomllib.loads(text)["record"], {"path": "second.csv", "frf": {"segment_length": 512}}]
    for line in text.splitlines():
        assert line in found.splitlines() or line.startswith("[record]")
    gone = edited(found, [{"remove": ["record", 1]}, {"remove": ["record", 0, "channel_error"]}])
    assert gone == text.replace("[record]", "[[record]]", 1)


def test_a_record_without_a_header_cannot_be_one_of_several():
    with pytest.raises(InputError, match=r"put \[record\] above its keys"):
        edited('record.path = "a.npz"\n', [{"list": ["record"]}])


PRIOR = "{ mean = 1.0, std = 0.2 }"
TABLE = '[[unknown]]\nproperty = "mass"\n[unknown.prior]\nmean = 0.8  # drawn\nrelative_std = 0.1\n'
INLINE = 'unknown = [{ property = "mass" }, { property = "loss" }]  # two\nmethod.band = [1.0, 2.0]\n[plan]\n'


@pytest.mark.parametrize(
    ("text", "edit", "wanted"),
    [
        (TABLE, {"set": ["unknown", 0, "prior"], "to": PRIOR},
         '[[unknown]]\nproperty = "mass"\n[unknown.prior]\nmean = 1.0  # drawn\nstd = 0.2\n'),
        ("[[unknown]]\nprior.mean = 2.0\nprior.std = 1.0\n", {"set": ["unknown", 0, "prior"], "to": PRIOR},
         "[[unknown]]\nprior.mean = 1.0\nprior.std = 0.2\n"),
        ("[[unknown]]\nprior.mean = 2.0\nprior.std = 1.0\n", {"remove": ["unknown", 0, "prior"]}, "[[unknown]]\n"),
        (INLINE, {"set": ["unknown", 1, "property"], "to": '"m"'}, INLINE.replace('"loss"', '"m"')),
        (INLINE, {"remove": ["unknown", 1]}, INLINE.replace(', { property = "loss" }', "")),
        (INLINE, {"add": ["unknown"], "table": {"property": '"k"'}}, INLINE.replace('"loss" }', '"loss" }, { property = "k" }')),
        (INLINE, {"set": ["method", "exclude"], "to": "[]"}, INLINE.replace("[plan]", "method.exclude = []\n[plan]")),
    ],
)  # fmt: skip
def test_tables_are_changed_in_the_way_in_which_they_are_written(text, edit, wanted):
    assert edited(text, [edit]) == wanted


def test_numbers_stay_as_they_were_written():
    assert edited("a = 1.6e6  # soft\n", [{"set": ["a"], "to": "1.70e6"}]) == "a = 1.70e6  # soft\n"


@pytest.mark.parametrize("value", ["", "1 2", "1\nb = 2", "a", "[1", '"x" # y\nz = 1', "{", "=", "1\n[table]"])
def test_what_is_not_one_value_is_refused(value):
    with pytest.raises(InputError, match="value"):
        value_of(value)


@pytest.mark.parametrize(
    "edit",
    [{"set": ["unknown", 99, "each"], "to": "true"}, {"remove": ["nothing"]}, {"set": ["title", "deep"], "to": "1"}],
)
def test_a_path_that_leads_nowhere_is_told(edit):
    with pytest.raises(InputError):
        edited(text_of("first_structure"), [edit])


def test_a_broken_study_is_not_touched():
    with pytest.raises(InputError, match="nothing was changed"):
        edited("a = [1\n", [{"set": ["b"], "to": "1"}])


def test_a_change_that_passes_through_no_toml_is_told_by_its_edit(monkeypatch):
    """An edit may leave no TOML, such as an open list, for the next to read."""
    honest = edits._edited_once

    def broken(text, edit):
        return "a = [\n" if edit.get("set") == ["a"] else honest(text, edit)

    def change(content):
        content["a"], content["b"] = 2, 3

    monkeypatch.setattr(edits, "_edited_once", broken)
    with pytest.raises(InputError, match="set b: cannot be done as the study is written; edit the study file"):
        changed_text("a = 1\nb = 2\n", change)


def test_a_change_of_what_is_no_toml_is_refused():
    with pytest.raises(InputError, match="the study is no TOML as it stands, so nothing was changed"):
        changed_text("a = [", lambda content: None)


def test_a_list_of_tables_and_other_values_is_changed_as_a_whole():
    def change(content):
        content["q"].append([3])

    assert changed_text("q = [[1, 2], { w = 1 }] # c\n", change) == "q = [[1, 2], { w = 1 }, [3]] # c\n"
