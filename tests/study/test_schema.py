"""The JSON Schema of study files and the document: both say what the declarations say, and the schema what is read."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import jsonschema
import pytest
from typer.testing import CliRunner

from structid import GaussNewton, InputError, LevenbergMarquardt, load_study
from structid.cli.app import app
from structid.core.constraints import Count, Limits, NotNegative, constraint_violation
from structid.fem import ELEMENT_TYPES
from structid.fem.elements.element import declarations
from structid.inversion.search.least_squares import Method
from structid.study.json_schema import study_schema, study_table
from structid.study.schema.method import _make_options, method_table
from structid.study.schema.model.structure import element_table
from structid.study.schema.tables import Table, kind_of
from study_cases import CHAIN, replaced, write_chain

ROOT = Path(__file__).parents[2]
DOCUMENT = (ROOT / "docs" / "study-file.md").read_text(encoding="utf-8")
VALIDATOR = jsonschema.Draft202012Validator(study_schema())
EXAMPLES = sorted((ROOT / "examples").rglob("*.toml"))


def test_the_schema_is_one_of_draft_2020_12_and_holds_no_name_twice():
    jsonschema.Draft202012Validator.check_schema(study_schema())
    text = json.dumps(study_schema())
    for name in study_schema()["$defs"]:
        assert f'"#/$defs/{name}"' in text


def test_the_schema_beside_the_examples_is_the_present_one():
    kept = json.loads((ROOT / "examples" / "study.schema.json").read_text(encoding="utf-8"))
    assert kept == json.loads(json.dumps(study_schema())), "write it again: structid schema examples/study.schema.json"


@pytest.mark.parametrize("path", EXAMPLES, ids=[path.parent.name for path in EXAMPLES])
def test_examples_name_the_schema_and_keep_it(path):
    text = path.read_text(encoding="utf-8")
    assert text.startswith("#:schema ../study.schema.json\n")
    VALIDATOR.validate(tomllib.loads(text))


def test_the_command_shows_and_writes_it(tmp_path):
    shown = CliRunner().invoke(app, ["schema"])
    assert shown.exit_code == 0
    assert json.loads(shown.output) == json.loads(json.dumps(study_schema()))
    written = CliRunner().invoke(app, ["schema", str(tmp_path / "s.json")])
    assert written.exit_code == 0
    assert (tmp_path / "s.json").read_text(encoding="utf-8") == shown.output
    assert CliRunner().invoke(app, ["schema", str(tmp_path / "none" / "s.json")]).exit_code == 2
    assert CliRunner().invoke(app, ["schema", str(tmp_path / "s.json")]).exit_code == 0  # anew


@pytest.mark.parametrize("mine", ["[structure]", '{"title": "mine"}', "[1]", b"\xff"])
def test_the_command_replaces_no_other_file(tmp_path, mine):
    content = mine if isinstance(mine, bytes) else mine.encode()
    (tmp_path / "study.toml").write_bytes(content)
    done = CliRunner().invoke(app, ["schema", str(tmp_path / "study.toml")])
    assert done.exit_code == 2
    assert "study.toml: is there already and is no schema of studies" in done.stderr
    assert (tmp_path / "study.toml").read_bytes() == content


@pytest.mark.parametrize(
    "old, new",
    [
        ("mass = 2.4", "mas = 2.4"),
        ("mass = 2.4", "mass = -2.4"),
        ("mass = 2.4", "mass = true"),
        ("mass = 2.4\n", ""),
        ('first = "1X"\n', ""),
        ("1 = 0.0", "one = 0.0"),
        ("[[structure.spring]]", "[[structure.sprng]]"),
        ("each = true", "each = 1.5"),
        ("each = true", "prior = {mean = 1.0, std = 0.0}"),
        ("relative = 0.01", "relative = -1"),
        ("relative = 0.01", "relative = 10"),
        ("band = [0.5, 12.0]", 'residual = "logs"'),
        ("band = [0.5, 12.0]", "band = [12.0]"),
        ("band = [0.5, 12.0]", "reduced = 1"),
        ("band = [0.5, 12.0]", "step_tolerance = 0"),
    ],
)
def test_what_the_schema_marks_is_what_reading_refuses(tmp_path, old, new):
    text = replaced(old, new)
    assert VALIDATOR.is_valid(tomllib.loads(CHAIN))
    assert not VALIDATOR.is_valid(tomllib.loads(text))
    with pytest.raises(InputError):
        load_study(write_chain(tmp_path, text))


def tables(table: Table, path: str = "") -> Iterator[tuple[str, Table]]:
    """A table and all inside it, by their headers."""
    yield path, table
    for name, key in table.keys.items():
        if isinstance(key.holds, Table):
            yield from tables(key.holds, f"{path}.{name}".strip("."))


def test_every_key_says_what_it_is():
    silent = [
        f"{path} {name}" for path, table in tables(study_table()) for name, key in table.keys.items() if not key.words
    ]
    assert silent == []


# ---- the document


def documented(heading: str) -> dict[str, str]:
    """Keys in the first column of the tables of a section of the document, with what stands in the column of defaults."""
    part = DOCUMENT.split(f"\n{heading}", 1)[1].split("\n## ")[0].split("\n### ")[0]
    found = {}
    for line in part.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("|") and cells[0].startswith("`"):
            for name in re.findall(r"`([^`]+)`", cells[0]):
                found[name.strip("[]").rpartition(".")[2]] = cells[1] if len(cells) > 2 else ""
    return found


SECTIONS = {
    "## `[[unknown]]`": "unknown",
    "### `[[record.channel_error]]`": "record.channel_error",
    "### `[record.time]`": "record.time",
    "### `[record.modes]`": "record.modes",
    "## `[[regularization]]`": "regularization",
    "## `[method]`": "method",
    "## `[plan]`": "plan",
    "### A mesh from a file": "structure.mesh",
    "### Components": "structure.component",
}
BESIDES = {"structure.mesh": {"mesh", "group", "points", "support"}}


@pytest.mark.parametrize("heading", SECTIONS)
def test_the_document_lists_the_keys_of_a_section_and_their_defaults(heading):
    table = dict(tables(study_table()))[SECTIONS[heading]]
    listed = documented(heading)
    assert set(listed) - BESIDES.get(SECTIONS[heading], set()) == set(table.keys)
    for name, key in table.keys.items():
        told = re.match(r'^`?"?([\w.+-]+)"?`?$', listed.get(name, ""))
        if told and isinstance(key.default, str | int | float):
            assert told[1] == str(key.default).lower() or float(told[1]) == key.default, name


def test_the_document_has_every_key_somewhere():
    missing = {
        f"{path} {name}"
        for path, table in tables(study_table())
        for name, key in table.keys.items()
        if not re.search(rf"[`.\[]{name}\b|\b{name} =", DOCUMENT)
    }
    assert missing == set()


def refused(table: Table, given: dict[str, object], path: str = "") -> Iterator[str]:
    """Keys of `given` that `table`, or a table inside it, does not have or whose values it does not take; by their path."""
    for name, value in given.items():
        key, place = table.keys.get(name), f"{path}.{name}".strip(".")
        if key is None:
            if table.labels is None or not name.isdigit() or not table.labels.accepts(value):
                yield place
        elif not isinstance(key.holds, Table):
            if not key.holds.accepts(value):
                yield place
        elif key.holds.short is None or not key.holds.short.accepts(value):
            for one in value if isinstance(value, list) else [value]:
                yield from refused(key.holds, one, place)


@pytest.mark.parametrize("example", re.findall(r"```toml\n(.*?)```", DOCUMENT, re.DOTALL))
def test_every_example_of_the_document_is_taken(example):
    assert list(refused(study_table(), tomllib.loads(example))) == []


def test_a_wrong_word_in_an_example_is_seen():
    given = tomllib.loads('record.csv.separator = ";"\nplan.noise.part = 1\nstructure.nodes.one = 0.0')
    assert list(refused(study_table(), given)) == ["record.csv.separator", "plan.noise.part", "structure.nodes.one"]


def row(name: str) -> str:
    """The row of an element type in the document, from its declaration."""
    kind = ELEMENT_TYPES[name]
    table, said = element_table(kind, on_mesh=False), declarations(kind)
    required, optional = [], []
    for key, entry in table.keys.items():
        if key not in ("name", "group", "tolerance"):
            unit = " or ".join(u for u in (said[key].unit, said[key].about_axes) if u not in ("", "1"))
            text = f"`{key}` {unit}".strip().replace("^2", "²").replace("^3", "³").replace("^4", "⁴")
            (required if entry.required else optional).append(text)
    return f"| `[[structure.{name}]]` | {', '.join(required)} | {', '.join(optional)} |"


@pytest.mark.parametrize("name", ELEMENT_TYPES)
def test_the_document_has_the_row_of_every_element_type(name):
    assert row(name) in DOCUMENT


# ---- declarations


@dataclass(frozen=True)
class Group:
    """A group.

    Parameters
    ----------
    depth : int
        How deep it goes.
    """

    depth: Count = 3


@dataclass(frozen=True)
class Width:
    """Options that others are made of.

    Parameters
    ----------
    width : float
        How wide it is.
    """

    width: NotNegative = 1.0


@dataclass(frozen=True)
class Options(Width):
    """Options with a base, a group and a choice of searches.

    Parameters
    ----------
    group : Group
    method : Method
        Which search.
    """

    group: Group = Group()
    method: Method = field(default_factory=LevenbergMarquardt)
    matrix_free: bool | None = None


def test_a_field_of_a_group_of_options_is_a_key_by_itself():
    keys = method_table(Options).keys
    assert {"width", "depth", "search", "max_iterations", "gain_tolerance", "step_control"} == set(keys) & {
        "width", "depth", "search", "max_iterations", "gain_tolerance", "step_control", "group", "method", "matrix_free"
    }  # fmt: skip
    assert (keys["depth"].words, keys["width"].words) == ("How deep it goes.", "How wide it is.")
    assert keys["depth"].default == 3
    assert keys["max_iterations"].default is None  # not the same in all searches
    given = {"depth": 5, "step_control": False}
    assert _make_options(Options, given, "gauss_newton") == Options(
        1.0, Group(5), GaussNewton(step_control=False), False
    )
    assert given == {}


def test_tolerances_of_the_search_come_from_the_study(tmp_path):
    text = replaced("band = [0.5, 12.0]", "gain_tolerance = 1e-9\nacceleration = 0.0")
    assert load_study(write_chain(tmp_path, text)).options.method == LevenbergMarquardt(
        gain_tolerance=1e-9, acceleration=0.0
    )
    text = replaced("band = [0.5, 12.0]", 'search = "gauss_newton"\ngain_tolerance = 1e-9')
    with pytest.raises(InputError, match=r"\[method\] gain_tolerance: is none of this `search`"):
        load_study(write_chain(tmp_path, text))


@pytest.mark.parametrize(
    "annotation, good, bad, words",
    [
        (Count, 1, 0, "a whole number of at least 1"),
        (NotNegative | None, 0.0, -1, "a number of at least 0"),
        (Annotated[float, Limits(above=-1, below=0.5)], 0.3, 0.5, "a number between -1 and 0.5"),
        (Annotated[float, Limits(above=0, most=0.01)], 0.01, 0.0, "a number above 0 and at most 0.01"),
        (Literal["a", "b"], "a", "c", 'one of "a", "b"'),
        (float | Literal["auto"], "auto", "none", 'a number, as in 0.4 or one of "auto"'),
        (tuple[float, float], [1, 2], [2, 1], "two increasing numbers, as in [4.5, 85.0]"),
        (tuple[Count, ...], [1, 2], [1, 0], "a whole number of at least 1, or a list of these"),
        (str | tuple[str, ...], ["a"], [], "a text or a list of texts"),
        (bool, True, 1, "true or false"),
        (float, 1, True, "a number, as in 0.4"),
        (float, 1, float("nan"), "a number, as in 0.4"),
        (float, 1, 1e300, "a number, as in 0.4"),
        (str, "a", " ", "a text in quotes"),
    ],
)
def test_a_kind_is_made_of_an_annotation(annotation, good, bad, words):
    kind = kind_of(annotation)
    assert kind.words == words
    assert kind.accepts(good)
    assert not kind.accepts(bad)


def test_an_annotation_that_no_file_can_give_is_told():
    with pytest.raises(TypeError, match="no value of a study file"):
        kind_of(dict[str, float])


@pytest.mark.parametrize(
    "annotation, value, words",
    [
        (Count, 0, "must be at least 1, got 0"),
        (Annotated[float, Limits(above=0, most=1)], 2.0, "must be above 0 and at most 1, got 2"),
        (Annotated[float, Limits(above=-1, below=1)], 1.0, "must lie between -1 and 1, got 1"),
        (Literal["a", "b"], "c", "must be one of a, b, got 'c'"),
        (float | Literal["auto"], "none", "must be one of auto, a number, got 'none'"),
        (Count | None, None, ""),
        (Literal["a"] | Group, Group(), ""),
    ],
)
def test_python_values_are_held_by_the_same_annotations(annotation, value, words):
    assert constraint_violation(annotation, value) == words
