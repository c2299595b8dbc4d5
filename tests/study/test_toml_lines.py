"""Line numbers of keys: by table, and by hypothesis against texts whose lines are known by construction."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from structid.core.errors import InputError
from structid.study.schema.edits import changed_text
from structid.study.schema.section import StudyText
from structid.study.schema.study import load_study
from structid.study.schema.toml_lines import toml_lines
from study_cases import write_chain

TABLE = [
    ("a = 1\nb = 2\n", {("a",): 1, ("b",): 2}),
    ("# a = 1\n\na = 1 # b = 2\nb = 3", {("a",): 3, ("b",): 4}),
    ("[t]\nx = [\n 1, # ]\n [2,\n 3],\n]\ny = 0\n", {("t",): 1, ("t", "x"): 2, ("t", "x", 1, 1): 5, ("t", "y"): 7}),
    ('a = """one\n[no]\nb = 1 \\""" \n"""\nb = 2\n', {("a",): 1, ("b",): 5}),
    ("a = '''\nx'''''\nb = 1\n", {("a",): 1, ("b",): 3}),
    ('a = "\\\\"\nb = "]#"\nc = \'\\\'\nd = 1\n', {("a",): 1, ("b",): 2, ("c",): 3, ("d",): 4}),
    ("[[e]]\nn = 1\n[[e]]\nn = 2\n[e.sub]\nm = 3\n", {("e", 0, "n"): 2, ("e", 1, "n"): 4, ("e", 1, "sub", "m"): 6}),
    ("[[e]]\n[[e.f]]\n[[e.f]]\nk=1\n[[e]]\n[[e.f]]\nk=2\n", {("e", 0, "f", 1, "k"): 4, ("e", 1, "f", 0, "k"): 7}),
    ('p = {mean = 1, std = {x = 2}}\n"q.r" = 1\ns.t.u = 1\n', {("p", "std", "x"): 1, ("q.r",): 2, ("s", "t", "u"): 3}),
    ("a = 1\r\nb = 1979-05-27T07:32:00Z\r\nc = 1979-05-27 07:32:00\r\nd = inf\r\n", {("b",): 2, ("c",): 3, ("d",): 4}),
    ("[ a . 'b c' ]\nx = 1\n", {("a", "b c"): 1, ("a", "b c", "x"): 2}),
    ("x = [{a = 1},\n {a = 2}]\n", {("x", 0, "a"): 1, ("x", 1, "a"): 2}),
    ("x = []\ny = {}\nz = 1", {("x",): 1, ("y",): 2, ("z",): 3}),
]


@pytest.mark.parametrize("text, expected", TABLE)
def test_lines_of_keys_are_those_of_the_text(text, expected):
    tomllib.loads(text.replace("\r\n", "\n"))
    lines = toml_lines(text)
    assert {path: lines[path] for path in expected} == expected


BARE = st.text("abcXYZ019_-", min_size=1, max_size=4)
QUOTED = st.text(st.characters(codec="utf-8", exclude_categories=["C"]), max_size=5)
KEYS = st.lists(st.one_of(BARE, QUOTED), min_size=1, max_size=4, unique=True)
VALUES = st.sampled_from(
    ["1", "-2.5e3", "true", "inf", "07:32:00", '"a#]\\"}"', "'[[t]]'", '"""\nk = 1\n"""', "'''\n[x]\n'''", "[]", "{}",
     "[1,\n2, # ]\n]", '[["a", 1],\n["b", 2]]', "{i = [1, 2], j.k = 'x'}", '"""a\\"""b"""', '""""q""""']
)  # fmt: skip
FILLERS = st.sampled_from(["", "\n", "# c = 1\n", "  \t\n\n", '# """\n', "# [[t]]\n"])


def written(key: str) -> str:
    if key and all(letter in "abcXYZ019_-" for letter in key):
        return key
    return '"' + key.replace("\\", "\\\\").replace('"', '\\"') + '"'


@st.composite
def documents(draw):
    """A TOML text with the line of each key, written line by line."""
    text, expected = "", {}

    def line() -> int:
        return text.count("\n") + 1

    for key in draw(KEYS):
        text += draw(FILLERS)
        expected[(key,)] = line()
        text += f"{written(key)} = {draw(VALUES)} # end\n"
    for position in range(draw(st.integers(0, 3))):
        text += draw(FILLERS)
        expected["top table", position] = line()
        text += "[['top table']]\n"
        for key in draw(KEYS):
            text += draw(FILLERS)
            expected["top table", position, key] = line()
            text += f" {written(key)}={draw(VALUES)}\n"
    return text, expected


@settings(max_examples=150, deadline=None)
@given(documents())
def test_lines_of_any_document_are_those_it_was_written_on(document):
    text, expected = document
    tomllib.loads(text)
    lines = toml_lines(text)
    assert {path: lines.get(path) for path in expected} == expected


@settings(max_examples=150, deadline=None)
@given(documents())
def test_every_key_that_tomllib_finds_has_a_line(document):
    text, _ = document
    lines = toml_lines(text)

    def paths(value, path):
        if path:
            yield path
        entries = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        for key, inner in entries:
            yield from paths(inner, (*path, key))

    assert set(paths(tomllib.loads(text), ())) == set(lines)


def test_a_place_that_is_not_written_has_the_line_of_what_holds_it():
    text = "a = 1\n\n[b]\n[[b.c]]\nd = [\n1]\n"
    source = StudyText(Path("x.toml"), text)
    assert source.line(("b", "c", 0, "d", 0)) == 6
    assert source.line(("b", "c", 0, "d", 7)) == 5
    assert source.line(("b", "c", 0, "e", "f")) == 4
    assert source.line(("b", "x")) == 3
    assert source.line(("x",)) == 1


def test_lines_are_looked_for_only_when_an_error_names_one(tmp_path):
    study = load_study(write_chain(tmp_path))
    source = study.root.source
    assert "lines" not in vars(source)
    assert "line 4: [structure] active: wrong" in str(study.section("structure").error("wrong", "active"))
    assert "lines" in vars(source)
    assert source.table is study.root.table


def test_a_change_of_the_content_moves_no_table_and_no_comment():
    """Tables of one kind stand apart in the text, where an editor of the whole document would bring them together."""
    text = (
        '[structure]\nfixed = ["1X"]  # the wall\n\n[[structure.spring]]\nname = "a"\n\n# heavy\n[[structure.point_mass]]\n'
        'name = "m"\nmass = 2.0\n\n# soft\n[[structure.spring]]\nname = "b"\nstiffness = 1e3  # N/m\n\n[record]\npath = "r.csv"\n'
    )

    def change(study):
        study["structure"]["spring"][1]["stiffness"] = 2000.0
        study["structure"]["spring"].append({"name": "c", "nodes": [1, 2]})
        study["structure"]["fixed"] = ["1X", "2X"]
        study["record"].setdefault("relabel", {})["3X"] = "4X-"
        del study["structure"]["point_mass"][0]["mass"]

    expected = (
        text.replace('fixed = ["1X"]', 'fixed = ["1X", "2X"]').replace("mass = 2.0\n", "")
        .replace("1e3  # N/m\n", '2000.0  # N/m\n\n[[structure.spring]]\nname = "c"\nnodes = [1, 2]\n')
    )  # fmt: skip
    assert changed_text(text, change) == expected + 'relabel = { 3X = "4X-" }\n'


def test_a_table_made_after_one_was_left_out_is_a_new_one():
    """A new table may have the identity of one that is gone."""
    text = '[[record]]\npath = "a.csv"\n\n[[record]]\npath = "b.csv"\n\n[[structure.spring]]\nname = "c"\n'

    def change(study):
        del study["record"][1]
        study["structure"]["spring"] += [{"name": f"d{k}"} for k in range(20)]

    after = tomllib.loads(changed_text(text, change))
    assert [record["path"] for record in after["record"]] == ["a.csv"]
    assert [spring["name"] for spring in after["structure"]["spring"]] == ["c", *(f"d{k}" for k in range(20))]


def test_a_change_without_a_line_of_its_own_is_refused():
    text = '[[record]]\npath = "r.csv"\n'
    with pytest.raises(InputError, match="no line for the change"):
        changed_text(text, lambda study: study["record"].insert(0, {"path": "b.csv"}))
