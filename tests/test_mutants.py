"""The list of `make mutants` stays in step: each edit finds its text once, and names tests that exist."""

from dataclasses import replace
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = {"core", "diagnose", "dynamics", "external", "fem", "forward", "identification", "inversion",
            "modal", "planning", "records", "report", "similarity", "study", "unknowns", "compare"}  # fmt: skip


@pytest.fixture
def entries(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    from mutants import entries

    return entries


def test_every_mutant_applies_and_names_tests_that_exist(entries):
    mutants = entries.read_mutants()
    assert [f"{one.name}: {fault}" for one in mutants if (fault := entries.read_fault(one))] == []
    assert len(mutants) >= 70
    assert {one.package for one in mutants} >= PACKAGES


def test_what_cannot_be_tried_is_told(entries):
    sound = next(one for one in entries.read_mutants() if one.name == "holm")
    assert entries.read_fault(sound) == ""
    for change, words in (
        ({"old": "no such text"}, "occurs 0 times"),
        ({"old": "return"}, "must occur once"),
        ({"new": sound.old}, "the same"),
        ({"file": "inversion/none.py"}, "no file of the package"),
        ({"tests": ()}, "no test is named"),
        ({"tests": ("inversion/test_none.py",)}, "is no file"),
        ({"tests": ("inversion/test_comparison.py::test_none",)}, "has no test_none"),
    ):
        assert words in entries.read_fault(replace(sound, **change))


@pytest.mark.parametrize(
    "text, words",
    [("[[mutant]]\nname = 'a'\n", "must have the keys"), ("{0}{0}", "must be given once, got a twice")],
)
def test_a_list_that_is_wrong_is_told(entries, tmp_path, text, words):
    whole = "[[mutant]]\nname = 'a'\nfile = ''\nold = ''\nnew = ''\nwords = ''\ntests = []\n"
    path = tmp_path / "list.toml"
    path.write_text(text.format(whole), encoding="utf-8")
    with pytest.raises(ValueError, match=words):
        entries.read_mutants(path)
