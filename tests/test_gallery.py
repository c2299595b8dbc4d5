"""Every script of the gallery is there for a reason and uses public names; the site build runs it (`docs/truths.py`)."""

import ast
import importlib
import re
import runpy
from pathlib import Path

import pytest

import structid

ROOT = Path(__file__).parents[1]
GALLERY = ROOT / "examples" / "gallery"
SCRIPTS = sorted(path.relative_to(GALLERY).with_suffix("").as_posix() for path in GALLERY.glob("*/*.py"))


@pytest.mark.parametrize("name", SCRIPTS)
def test_script_says_what_one_learns(name):
    text = (GALLERY / f"{name}.py").read_text(encoding="utf-8")
    title, rule, rest = re.match(r'"""\n(.+)\n(=+)\n\n(.*?)"""', text, re.DOTALL).groups()
    assert len(rule) == len(title)
    assert "One learns" in " ".join(rest.split())
    assert len(text.splitlines()) <= 110


@pytest.mark.parametrize("name", SCRIPTS)
def test_script_uses_names_that_are_there(name):
    tree = ast.parse((GALLERY / f"{name}.py").read_text(encoding="utf-8"))
    used = {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "sid"
    }
    assert used <= set(structid.__all__)
    imports = [
        node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module.startswith("structid")
    ]
    for node in imports:
        module = importlib.import_module(node.module)
        assert all(hasattr(module, alias.name) for alias in node.names), node.module


def test_there_are_enough_and_every_promise_has_a_script():
    truths = runpy.run_path(str(ROOT / "docs" / "truths.py"))
    assert len(SCRIPTS) >= 24
    assert len(truths["HOLDS"]) >= 36
    assert set(truths["HOLDS"]) <= set(SCRIPTS)
