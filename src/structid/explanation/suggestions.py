"""Causes as studies ready to run, with the lines in which they differ."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tomlkit

from structid.criticism.candidate import Candidate
from structid.explanation.edits import edit
from structid.study.schema.study import Study

FOLDER = "suggestions"


def suggestion_name(number: int, changes: Sequence[tuple[Candidate, float]]) -> str:
    """Such as ``1-support-9Y.toml``."""
    words = " ".join(f"{candidate.kind} {' '.join(candidate.where[:2])}" for candidate, _ in changes)
    return f"{number}-{re.sub(r'[^A-Za-z0-9]+', '-', words).strip('-')[:60]}.toml"


def suggestion_text(study: Study, changes: Sequence[tuple[Candidate, float]]) -> tuple[str, tuple[str, ...]]:
    """The study with changes, its comments kept, and the lines that differ."""
    document = tomlkit.parse(study.text)
    for candidate, strength in changes:
        edit(document, candidate, strength)
    text = tomlkit.dumps(document)
    lines = difflib.ndiff(study.text.splitlines(), text.splitlines())
    return text, tuple(line for line in lines if line[:2] in ("+ ", "- ") and line[2:].strip())


def write_suggestion(study: Study, changes: Sequence[tuple[Candidate, float]], path: Path, place: Path) -> None:
    """Write the study with changes to `path`, which will stand in the folder `place`; its files are found from there."""
    document = tomlkit.parse(suggestion_text(study, changes)[0])
    away = Path(os.path.relpath(study.path.parent.resolve(), place.resolve()))
    _moved(document, {name for name in study.digests if name != study.path.name}, away)
    text = tomlkit.dumps(document)
    schema = re.match(r"#:schema (?!\w+://)(\S+)", text)
    if schema:
        text = text.replace(schema[1], (away / schema[1]).as_posix(), 1)
    path.write_bytes(text.encode("utf-8"))


def _moved(table: Any, names: set[str], away: Path) -> None:
    """Give every name of a file its path from another folder."""
    items = list(table.items()) if isinstance(table, dict) else list(enumerate(table))
    for key, value in items:
        if isinstance(value, str):
            if Path(value).as_posix() in names and not Path(value).is_absolute():
                table[key] = (away / value).as_posix()
        elif isinstance(value, dict | list):
            _moved(value, names, away)
