"""`python -m mutants`: makes each edit in a copy of the package and runs the tests that should fail for it."""

from __future__ import annotations

import argparse
import os
import queue
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from mutants.entries import PACKAGE, ROOT, Mutant, read_fault, read_mutants

#: Seconds after which the tests of one mutant are ended; an edit that makes a search endless is not seen by a test.
LIMIT = 600.0
#: Exit codes of pytest.
PASSED, FAILED = 0, 1


@dataclass(frozen=True)
class Outcome:
    """What came of one mutant: ``caught``, ``survived`` or ``error``, by which test or why, and the seconds it took."""

    mutant: Mutant
    state: str
    words: str
    seconds: float


def run_tests(targets: Sequence[str], source: Path, first_failure: bool) -> tuple[int, str]:
    """Exit code and output of pytest with the package imported from `source`."""
    path = os.pathsep.join(filter(None, (str(source), os.environ.get("PYTHONPATH", ""))))
    settings = {"PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1", "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    command = [sys.executable, "-m", "pytest", "-q", "-rfE", "--tb=no", "-p", "no:cacheprovider"]
    command += ["-m", "not long and not slow", *(["-x"] if first_failure else []), *targets]
    try:
        done = subprocess.run(
            command, cwd=ROOT, env={**os.environ, **settings}, text=True, capture_output=True, timeout=LIMIT, check=False
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return -1, f"took more than {LIMIT:g} s"
    return done.returncode, done.stdout + done.stderr


def read_failures(output: str) -> list[str]:
    """Names of the tests that failed, as pytest's summary lists them."""
    return re.findall(r"^(?:FAILED|ERROR) tests/(.+?)(?: - .*)?$", output, re.MULTILINE)


def try_mutant(mutant: Mutant, source: Path) -> Outcome:
    """Edits the copy of the package in `source`, runs the tests of the mutant and puts the file back."""
    start = time.monotonic()
    edited, original = source / "structid" / mutant.file, ROOT / PACKAGE / mutant.file
    edited.write_text(original.read_text(encoding="utf-8").replace(mutant.old, mutant.new), encoding="utf-8")
    try:
        code, output = run_tests(mutant.targets, source, first_failure=True)
    finally:
        shutil.copy2(original, edited)
    seconds = time.monotonic() - start
    if code == FAILED and (failures := read_failures(output)):
        return Outcome(mutant, "caught", failures[0], seconds)
    if code == PASSED:
        return Outcome(mutant, "survived", ", ".join(mutant.tests), seconds)
    last = output.strip().splitlines()[-1] if output.strip() else ""
    return Outcome(mutant, "error", f"pytest ended with {code}: {last}", seconds)


def find_broken_tests(mutants: Sequence[Mutant], source: Path) -> list[str]:
    """Named tests that fail, or select nothing, without any edit."""
    targets = sorted({target for mutant in mutants for target in mutant.targets})
    code, output = run_tests(targets, source, first_failure=False)
    if code == PASSED:
        return []
    return read_failures(output) or [output.strip().splitlines()[-1]]


def copy_package(folder: Path) -> Path:
    """The path to import the package from, below `folder`."""
    shutil.copytree(ROOT / PACKAGE, folder / "structid")
    code = "import structid; print(structid.__file__)"
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    shown = subprocess.run([sys.executable, "-c", code], env=environment, text=True, capture_output=True, check=True)
    if not Path(shown.stdout.strip()).is_relative_to(folder.resolve()):
        raise SystemExit(f"Python imports structid from {shown.stdout.strip()}, not from the copy in {folder}")
    return folder


def try_mutants(mutants: Sequence[Mutant], workers: int, unedited: bool) -> list[Outcome]:
    """Outcomes of all mutants, `workers` at a time; one line is printed for each as it ends."""
    with tempfile.TemporaryDirectory(prefix="structid-mutants-") as folder:
        copies = [copy_package(Path(folder).resolve() / str(number)) for number in range(workers)]
        broken = find_broken_tests(mutants, copies[0]) if unedited else []
        if broken:
            raise SystemExit("tests that fail without any edit:\n" + "\n".join(f"  {test}" for test in broken))
        free: queue.SimpleQueue[Path] = queue.SimpleQueue()
        for copy in copies:
            free.put(copy)

        def try_next(mutant: Mutant) -> Outcome:
            source = free.get()
            try:
                outcome = try_mutant(mutant, source)
            finally:
                free.put(source)
            print(f"{outcome.state:<9} {mutant.name:<42} {outcome.seconds:5.0f} s  {outcome.words}", flush=True)
            return outcome

        with ThreadPoolExecutor(workers) as pool:
            return list(pool.map(try_next, mutants))


def print_summary(outcomes: Sequence[Outcome]) -> None:
    """Prints a line a package, those that no test caught, and how many were caught."""
    packages = sorted({outcome.mutant.package for outcome in outcomes})
    print(f"\n{'package':<16} {'caught':>6} {'of':>4}")
    for package in packages:
        states = [outcome.state for outcome in outcomes if outcome.mutant.package == package]
        print(f"{package:<16} {states.count('caught'):>6} {len(states):>4}")
    missed = [outcome for outcome in outcomes if outcome.state != "caught"]
    for outcome in missed:
        print(f"\n{outcome.state}: {outcome.mutant.name} ({outcome.mutant.file})")
        print(f"  {outcome.mutant.words}\n  {outcome.words}")
    print(f"\n{len(outcomes) - len(missed)} of {len(outcomes)} mutants caught")


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m mutants", description=__doc__)
    parser.add_argument("names", nargs="*", help="mutants or packages to try; all by default")
    parser.add_argument("--workers", type=int, default=2, help="how many at a time")
    parser.add_argument("--list", action="store_true", help="print the mutants and try none")
    parser.add_argument("--without-baseline", action="store_true", help="do not first run the tests without any edit")
    options = parser.parse_args()
    every = read_mutants()
    unknown = sorted(set(options.names) - {m.name for m in every} - {m.package for m in every})
    if unknown:
        parser.error(f"no mutant or package is named {', '.join(unknown)}; `--list` prints the names")
    mutants = [m for m in every if not options.names or m.name in options.names or m.package in options.names]
    if options.list:
        for mutant in mutants:
            print(f"{mutant.name:<42} {mutant.file}: {mutant.words}")
        return 0
    faults = [f"{mutant.name}: {fault}" for mutant in mutants if (fault := read_fault(mutant))]
    if faults:
        raise SystemExit("\n".join(faults))
    start = time.monotonic()
    outcomes = try_mutants(mutants, options.workers, not options.without_baseline)
    print_summary(outcomes)
    print(f"{time.monotonic() - start:.0f} s")
    return 0 if all(outcome.state == "caught" for outcome in outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())
