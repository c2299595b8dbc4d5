"""Words that a new reader does not understand are in no message, page or document; docstrings begin with their subject."""

import ast
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
#: What readers stumbled over, each with what is written in its place.
REPLACED = {
    "half-bandwidths?": "half its resonance width",
    "no further decrease is promised": "the search has converged",
    "pole-free": "bounded residual",
    "decay [0-9.]+ omega": "smoothed FRFs",
    "condition ind(ex|ices)": "are correlated",
    "is not white": "has an order that noise has not",
    "swings of its own": "a loose part or a cable resonates",
    "of its deviations": "standard deviations",
    "family-wise": "joint risk",
    "beside the next": "after the next",
    "second causes": "second changes",
    "the drive": "the force",
    "the intervals carry": "the intervals include",
    "not told from 0": "is not significantly different from 0",
    "rest on\\*": "sensitivity to fixed values",
    "(is|are) not told apart": "cannot be distinguished",
    "goes? with the model": "fits far worse than the others",
    "held on the axis": "measured FRFs, prior at the start",
    "next to nothing of": "hardly determines",
    "(a|no) like in the model": "matches no mode of the model",
    "record would have": "the record prefers",
    "what is not there": "a broken link",
}
#: Of texts in small letters.
PATTERN = re.compile("|".join(f"({words})(?![a-z])" for words in REPLACED))
_DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
MODULES = sorted((ROOT / "src" / "structid").rglob("*.py"))
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "src" / "structid" / "report" / "templates").glob("*.j2")),
    *sorted((ROOT / "src" / "structid" / "workbench" / "static").rglob("*.js")),
]


class Strings(NamedTuple):
    """String constants of a module: docstrings of all that may have one, "" where it has none, and all others but bare lines."""

    docstrings: list[str]
    messages: list[str]


@cache
def strings(path: Path) -> Strings:
    """The tree is not kept: 700 of them make every collection of garbage slow."""
    docstrings, texts, bare = [], [], set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Constant):
            if isinstance(node.value, str):
                texts.append(node)
        elif isinstance(node, ast.Expr):
            bare.add(id(node.value))
        elif isinstance(node, _DOCUMENTED):
            docstrings.append(ast.get_docstring(node) or "")
    return Strings(docstrings, [node.value for node in texts if id(node) not in bare])


def test_the_pattern_sees_them():
    assert PATTERN.search("0.42 half-bandwidths off")
    assert PATTERN.search("decay 0.7 omega search")
    assert not PATTERN.search("the driver leaves")


def test_no_message_has_them():
    assert len(MODULES) > 100
    texts = [(path.name, text) for path in MODULES for text in strings(path).messages]
    assert len(texts) > 10_000
    assert [(name, text) for name, text in texts if PATTERN.search(text.lower())] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_no_page_has_them(page):
    lines = page.read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if PATTERN.search(line.lower())] == []


def test_first_lines_of_docstrings_stand_alone():
    leaning = re.compile(r"(What|Where|Whether|How|Of|The same|Those|Its)\b")
    read = [(path.name, text) for path in MODULES for text in strings(path).docstrings]
    assert len(read) > 5000
    assert [(name, text) for name, text in read if leaning.match(text)] == []
