"""Mutants declared in `list.toml`: one edit of one formula each, and the tests that should see it."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGE = Path("src/structid")
LIST = Path(__file__).with_name("list.toml")


@dataclass(frozen=True)
class Mutant:
    """One edit of a formula.

    Attributes
    ----------
    name : str
    file : str
        Below `src/structid`.
    old, new : str
        Text that occurs once in the file, and the text that replaces it.
    words : str
        The fault that the edit makes, in words.
    tests : tuple of str
        Files or ids of quick tests, below `tests`, of which one must fail.
    """

    name: str
    file: str
    old: str
    new: str
    words: str
    tests: tuple[str, ...]

    @property
    def package(self) -> str:
        """First folder of the file, or the module at the top that it is."""
        return self.file.split("/", 1)[0].removesuffix(".py")

    @property
    def targets(self) -> tuple[str, ...]:
        """The tests as pytest takes them, from the root of the repository."""
        return tuple(f"tests/{test}" for test in self.tests)


def read_mutants(path: Path = LIST) -> tuple[Mutant, ...]:
    """All mutants, in the order of the list.

    Raises
    ------
    ValueError
        If two have one name, or one lacks a key or has another.
    """
    tables = tomllib.loads(path.read_text(encoding="utf-8"))["mutant"]
    keys = set(Mutant.__dataclass_fields__)
    for table in tables:
        if set(table) != keys:
            raise ValueError(f"{path.name}: {table.get('name', table)} must have the keys {', '.join(sorted(keys))}")
    names = [table["name"] for table in tables]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"{path.name}: `name` must be given once, got {', '.join(twice)} twice")
    return tuple(Mutant(**{**table, "tests": tuple(table["tests"])}) for table in tables)


def read_fault(mutant: Mutant, root: Path = ROOT) -> str:
    """The reason why a mutant cannot be made or tested; empty if it can."""
    path = root / PACKAGE / mutant.file
    if not path.is_file():
        return f"{mutant.file} is no file of the package"
    count = path.read_text(encoding="utf-8").count(mutant.old)
    if count != 1:
        return f"the old text occurs {count} times in {mutant.file}, it must occur once"
    if mutant.new == mutant.old:
        return "old and new text are the same"
    if not mutant.tests:
        return "no test is named"
    return next((fault for test in mutant.tests if (fault := _test_fault(test, root))), "")


def _test_fault(test: str, root: Path) -> str:
    """The reason why a test cannot be run: no such file, or no function of that name in it."""
    file, *functions = test.split("::")
    path = root / "tests" / file
    if not path.is_file():
        return f"tests/{file} is no file"
    text = path.read_text(encoding="utf-8")
    missing = [name for name in functions if f"def {name.split('[')[0]}(" not in text]
    return f"tests/{file} has no {missing[0]}" if missing else ""
