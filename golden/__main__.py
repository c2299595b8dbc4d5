"""`python -m golden REVISION`: runs every example with the code of a revision and of the working tree, and compares.

Both run on this machine, one after the other, with one BLAS thread, so that equal code gives equal digits. Numbers of
results must be equal; words are listed where they differ, so that each changed one can be accepted. The exit code is 1
where a number, an exit code or a file differs, 0 where at most words do, 2 where the revision is unknown.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
STUDIES = (
    "first_structure/study.toml",
    "three_storey_frame/study.toml",
    "two_span_bridge/study.toml",
    "plate_from_mesh/study.toml",
    "ambient_storeys/study.toml",
    "shaken_building/study.toml",
    "garteur_aeroplane/study.toml",
)
BRIDGE_MODES = [
    "modes", "two_span_bridge/ambient.csv", "--csv-skip-rows", "1", "--channels", "2Y,3Y,4Y,6Y,7Y,8Y",
]  # fmt: skip
#: Commands that make the records of a study, and the folder that they write.
FIRST = {"two_span_bridge/study.toml": (BRIDGE_MODES, "two_span_bridge/ambient_modes")}
COMMANDS = {
    **{f"identify {study}": ["identify", study, "--no-explain", "--no-report"] for study in STUDIES},
    **{f"check {study}": ["check", study] for study in STUDIES},
    "motion motion_of_a_frame/study.toml": ["motion", "motion_of_a_frame/study.toml"],
    "modes two_span_bridge/ambient.csv": BRIDGE_MODES,
    "plan two_span_bridge/study.toml": ["plan", "two_span_bridge/study.toml", "--sensors", "4"],
    "schema": ["schema", "out/schema.json"],
}
REPRODUCTION = {f"reproduce chapter {chapter}": ["reproduce", "--chapter", str(chapter)] for chapter in (3, 4, 5)}
# values that differ between two runs of one code
PASSING = re.compile(
    r"(^|_|\b)(seconds|elapsed|date|version|commit|python|platform|path|folder|memory|provenance|sha256|digests)(_|\b|$)"
)


@dataclass(frozen=True)
class Outcome:
    """What a command left: its exit code, the lines it printed and the JSON files it wrote."""

    code: int
    lines: list[str]
    files: dict[str, Any]


def main() -> int:
    """Compare the working tree with a revision and print what differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("revision", help="the revision to compare the working tree with, such as HEAD~3")
    parser.add_argument("--reproduction", action="store_true", help="also run chapters 3 to 5 of the dissertation")
    parser.add_argument("--only", help="commands whose name contains this text")
    arguments = parser.parse_args()
    commands = {**COMMANDS, **(REPRODUCTION if arguments.reproduction else {})}
    chosen = {name: words for name, words in commands.items() if (arguments.only or "") in name}
    if not chosen:
        parser.error(f"no command has {arguments.only!r} in its name; there are: {', '.join(commands)}")
    with tempfile.TemporaryDirectory() as folder:
        before = Path(folder) / "before"
        added = subprocess.run(
            ["git", "worktree", "add", "--quiet", "--detach", str(before), arguments.revision], cwd=ROOT
        )
        if added.returncode:
            return 2
        try:
            differing = sum(compare_command(name, words, before) for name, words in chosen.items())
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", str(before)], cwd=ROOT, check=True)
    print(f"{len(chosen) - differing} of {len(chosen)} commands give the same numbers")
    return int(differing > 0)


def compare_command(name: str, words: list[str], before: Path) -> bool:
    """Run one command with both trees, print what differs, and return True where a number or an exit code does."""
    old, new = run_command(words, before), run_command(words, ROOT)
    numbers = list(number_differences(old, new))
    changed_words = list(word_differences(old, new))
    if old.code == 2 and new.code == 2:
        numbers.append("both trees refuse the input: nothing is compared")
    print(f"{'DIFFERS' if numbers else 'same   '}  {name}  (exit code {new.code})", flush=True)
    for line in [*numbers[:20], *changed_words[:20]]:
        print(f"         {line}")
    for kind, lines in (("numbers", numbers), ("words", changed_words)):
        if len(lines) > 20:
            print(f"         and {len(lines) - 20} more {kind}")
    return bool(numbers)


def run_command(words: list[str], tree: Path) -> Outcome:
    """Run `structid` of `tree` on its own examples, in a copy that is thrown away."""
    with tempfile.TemporaryDirectory() as folder:
        examples = Path(folder) / "examples"
        shutil.copytree(tree / "examples", examples)
        out = examples / "out"
        out.mkdir()
        environment = {**os.environ, "PYTHONPATH": str(tree / "src"), "OPENBLAS_NUM_THREADS": "1", "COLUMNS": "120"}

        def run(words: list[str], target: list[str]) -> subprocess.CompletedProcess[str]:
            command = [sys.executable, "-m", "structid", *words, *target]
            return subprocess.run(command, cwd=examples, env=environment, capture_output=True, text=True, check=False)

        for study, (first_words, folder_name) in FIRST.items():
            if study in words:
                run(first_words, ["--out", folder_name])
        done = run(words, ["--out", str(out)] if words[0] in {"identify", "motion", "modes", "plan"} else [])
        said = (done.stdout + done.stderr).replace(str(examples), "")
        lines = [line for line in said.splitlines() if line.strip() and not PASSING.search(line)]
        files = {str(path.relative_to(out)): json.loads(path.read_text()) for path in sorted(out.rglob("*.json"))}
    return Outcome(done.returncode, lines, files)


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every value of a JSON document with its path; what passes with the run (times, versions, paths) is left out."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if not PASSING.search(key):
                yield from leaves(inner, f"{path}.{key}")
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from leaves(inner, f"{path}[{index}]")
    else:
        yield path, value


def numbers_of(outcome: Outcome) -> dict[str, Any]:
    """Numbers of JSON files, by file and path."""
    return {
        f"{file}{path}": value
        for file, content in outcome.files.items()
        for path, value in leaves(content)
        if isinstance(value, int | float) and not isinstance(value, bool)
    }


def texts_of(outcome: Outcome) -> list[str]:
    """Texts and choices of JSON files, each with its path, and the printed lines."""
    values = [
        f"{file}{path}: {value}"
        for file, content in outcome.files.items()
        for path, value in leaves(content)
        if isinstance(value, str | bool)
    ]
    return [*outcome.lines, *values]


def number_differences(old: Outcome, new: Outcome) -> Iterator[str]:
    """Lines on numbers, files and exit codes that differ; numbers that are new are no difference."""
    if old.code != new.code:
        yield f"exit code {old.code} -> {new.code}"
    if missing := old.files.keys() - new.files.keys():
        yield f"files missing: {', '.join(sorted(missing))}"
    before, after = numbers_of(old), numbers_of(new)
    for path, value in before.items():
        if path not in after:
            yield f"{path}: {value!r} -> gone"
        elif value != after[path] and not (value != value and after[path] != after[path]):
            yield f"{path}: {value!r} -> {after[path]!r}"


def word_differences(old: Outcome, new: Outcome) -> Iterator[str]:
    """Printed lines and texts of results that one tree has and the other has not."""
    before, after = texts_of(old), texts_of(new)
    lost, added = set(before) - set(after), set(after) - set(before)
    yield from (f"- {line}" for line in before if line in lost)
    yield from (f"+ {line}" for line in after if line in added)


if __name__ == "__main__":
    sys.exit(main())
