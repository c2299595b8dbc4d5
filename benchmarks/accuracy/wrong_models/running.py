"""Make the studies, run `structid identify` on each as a user would, and print what it got right."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from wrong_models.cases import ALIASES, SETS, cases
from wrong_models.judging import HEADER, Judged, as_json, by_kind, judged, line, summary
from wrong_models.study_files import MODES_COMMAND, Case, written


def run(case: Case, folder: Path, limit: float) -> Judged:
    """Write the study of `case` into `folder`, identify it, and judge the answer."""
    shutil.rmtree(folder, ignore_errors=True)
    truth = written(case, folder)
    modes = folder / MODES_COMMAND
    begun, left = time.monotonic(), limit
    if modes.exists():
        _structid(json.loads(modes.read_text(encoding="utf-8")), folder, limit)
        left = max(1.0, limit - (time.monotonic() - begun))
    begun = time.monotonic()
    code = _structid(["identify", "study.toml", "--out", "results", "--no-report"], folder, left)
    seconds = time.monotonic() - begun
    path = folder / "results" / "estimate.json"
    answer = json.loads(path.read_text(encoding="utf-8")) if path.exists() else None
    return judged(truth, answer, code, seconds)


def _structid(words: Sequence[str], folder: Path, limit: float) -> int | None:
    """Exit code of a command of structid in `folder`, None after `limit` seconds; what it says is kept in said.txt."""
    command = [sys.executable, "-m", "structid", *words]
    environment = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg", **os.environ}
    with (folder / "said.txt").open("a", encoding="utf-8") as said:
        ways = {"cwd": folder, "stdout": said, "stderr": said, "env": environment, "timeout": limit}
        try:
            return subprocess.run(command, check=False, **ways).returncode  # type: ignore[call-overload]
        except subprocess.TimeoutExpired:
            return None


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is asked for; 1 where a bar that can be judged is missed."""
    parser = argparse.ArgumentParser(
        prog="wrong_models.py",
        description="Studies whose model or record is wrong in a known way, identified and judged.",
    )
    parser.add_argument("--set", choices=tuple(SETS), default="development")
    parser.add_argument(
        "--only", nargs="+", metavar="NAME", default=(), help="studies whose names hold one of these words"
    )
    parser.add_argument("--jobs", type=int, default=1, help="studies at a time")
    parser.add_argument("--limit", type=float, default=300.0, metavar="SECONDS", help="of each study")
    parser.add_argument("--out", type=Path, help="keep the studies, their results and results.json in this folder")
    parser.add_argument("--list", action="store_true", help="print the studies and end")
    parser.add_argument(
        "--aliases", action="store_true", help="find the aliases of each fault anew, write aliases.json and end"
    )
    given = parser.parse_args(arguments)
    chosen = [one for one in cases(given.set) if not given.only or any(word in one.name for word in given.only)]
    if not chosen:
        parser.error(f"no study of {given.set} has {' or '.join(given.only)} in its name; see --list")
    if given.list:
        print("\n".join(f"{one.name:58s} {' + '.join(map(str, one.faults)) or 'right model'}" for one in chosen))
        return 0
    if given.aliases:
        return _write_aliases(chosen, given.jobs)
    with tempfile.TemporaryDirectory() as temporary:
        root = given.out or Path(temporary)
        print(HEADER, flush=True)
        rows: list[Judged] = []
        with ThreadPoolExecutor(given.jobs) as pool:
            for one in pool.map(lambda case: run(case, root / case.name, given.limit), chosen):
                rows.append(one)
                print(line(one), flush=True)
        if given.out:
            (root / "results.json").write_text(json.dumps(as_json(rows), indent=1) + "\n", encoding="utf-8")
    return report(rows)


def report(rows: Sequence[Judged]) -> int:
    """Print the bars and the kinds of fault; 1 where a bar is missed."""
    print(f"\n{'':52s} {'figure':>8s} {'bar':>8s}")
    found = summary(rows)
    for row in found:
        figure = "" if row["figure"] is None else f"{row['figure']:.3g}"
        met = {None: "", True: "met", False: "MISSED"}[row["met"]]
        print(f"{row['what']:52s} {figure:>8s} {row['bar']:>8s} {met:6s} {row['detail']}")
    print("\nsingle faults by kind", *by_kind(rows), sep="\n")
    return int(any(row["met"] is False for row in found))


def _write_aliases(chosen: Sequence[Case], jobs: int) -> int:
    from concurrent.futures import ProcessPoolExecutor

    from wrong_models.telling_apart import can_look_into, told_apart

    known = json.loads(ALIASES.read_text(encoding="utf-8")) if ALIASES.exists() else {}
    looked = [one for one in chosen if can_look_into(one)]
    with ProcessPoolExecutor(jobs) as pool:
        for case, found in zip(looked, pool.map(told_apart, looked), strict=True):
            known[case.name] = found
            print(f"{case.name:58s} {json.dumps(found)}", flush=True)
    text = ",\n".join(f" {json.dumps(name)}: {json.dumps(found)}" for name, found in sorted(known.items()))
    ALIASES.write_text("{\n" + text + "\n}\n", encoding="utf-8")
    return 0
