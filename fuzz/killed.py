"""`python -m fuzz.killed`: runs killed or interrupted at random moments and run again, to the same digits.

`identify` goes on from its checkpoint, `motion` from its file, `modes` and `compare` begin anew. Nothing half written may be
left beside or in the results.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fuzz.seeds import CHAIN, EXAMPLES, write_chain

SIGNALS = (signal.SIGKILL, signal.SIGINT, signal.SIGTERM)
#: Exit codes of runs that wrote their results.
ENDED = (0, 1, 3)
SEVERAL = CHAIN + "uniqueness_starts = 2\n"
#: What differs from run to run.
_PASSING = ("seconds", "peak_memory_bytes", "provenance", "source")


@dataclass(frozen=True)
class Command:
    """A command, what it writes, and how it is told to go on.

    Attributes
    ----------
    words : tuple of str
    answer : str
        The file of the results with all digits.
    resumed : tuple of str
        Further words where a checkpoint is left.
    """

    words: tuple[str, ...]
    answer: str
    resumed: tuple[str, ...] = ()


_OUT = ("--out", "out")
COMMANDS = {
    "identify": Command(
        ("identify", "chain.toml", *_OUT, "--no-report", "--checkpoint", "0"), "estimate.json", ("--resume",)
    ),
    "motion": Command(
        ("motion", "motion/study.toml", *_OUT, "--chunk", "40", "--checkpoint", "state.npz"), "motion.json"
    ),
    "modes": Command(("modes", "motion/motion.h5", *_OUT, "--orders", "2:16", "--no-report"), "modes.json"),
    "compare": Command(("compare", "chain.toml", "after.toml", *_OUT, "--no-report"), "compare.json"),
}


def prepared(folder: Path) -> None:
    """The input files of all commands."""
    write_chain(folder / "chain.toml", SEVERAL)
    (folder / "after.toml").write_text(CHAIN.replace("1200.0", "1210.0"))
    shutil.copytree(EXAMPLES / "motion_of_a_frame", folder / "motion")


def started(command: Command, folder: Path, further: tuple[str, ...] = ()) -> subprocess.Popen[str]:
    """The running command, which takes Ctrl-C as on a terminal."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    return subprocess.Popen(
        [sys.executable, "-m", "structid", *command.words, *further],
        cwd=folder,
        env=environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


def digits(folder: Path, command: Command) -> Any:
    """The answer, without what differs from run to run."""
    found = json.loads((folder / "out" / command.answer).read_text(encoding="utf-8"))
    return {key: value for key, value in found.items() if key not in _PASSING}


def names(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def whole_run(command: Command, folder: Path) -> tuple[Any, list[str], float]:
    """The answer of an undisturbed run, the files that are there behind it, and its time."""
    prepared(folder)
    begun = time.perf_counter()
    process = started(command, folder)
    _, said = process.communicate()
    if process.returncode not in ENDED:
        raise SystemExit(f"{' '.join(command.words)} ends with {process.returncode}: {said}")
    return digits(folder, command), names(folder), time.perf_counter() - begun


def killed(command: Command, folder: Path, number: signal.Signals, moment: float) -> str | None:
    """What is wrong after a run was ended at `moment` (s) and run again; None where nothing is."""
    prepared(folder)
    process = started(command, folder)
    try:
        process.wait(moment)
    except subprocess.TimeoutExpired:
        process.send_signal(number)
    _, said = process.communicate()
    if process.returncode == 130 and "Traceback" in said:
        return f"a traceback: {said[-1500:]}"
    if process.returncode not in (*ENDED, 130, -number):
        return f"ended with {process.returncode}: {said[-1500:]}"
    if process.returncode in ENDED:
        return None
    left = (folder / "out.checkpoint" / "run.json").exists()
    again = started(command, folder, command.resumed if left else ())
    _, said = again.communicate()
    return None if again.returncode in ENDED else f"run again, ended with {again.returncode}: {said[-1500:]}"


def main() -> int:
    """Run, print, and say by the exit code whether all answers are the same."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100, help="how many runs are ended [default: 100]")
    parser.add_argument("--seed", type=int, default=1, help="of the random moments [default: 1]")
    given = parser.parse_args()
    rng, good, bad = random.Random(given.seed), Counter[str](), []
    with tempfile.TemporaryDirectory() as name:
        wholes = {}
        for word, command in COMMANDS.items():
            wholes[word] = whole_run(command, _made(Path(name) / f"whole_{word}"))
        for index in range(given.count):
            word = list(COMMANDS)[index % len(COMMANDS)]
            command, number = COMMANDS[word], SIGNALS[index // len(COMMANDS) % len(SIGNALS)]
            answer, files, seconds = wholes[word]
            folder, moment = _made(Path(name) / f"killed_{index}"), rng.uniform(0.3, 1.0) * seconds
            wrong = killed(command, folder, number, moment)
            if wrong is None and digits(folder, command) != answer:
                wrong = "another answer"
            if wrong is None and names(folder) != files:
                wrong = f"other files: {sorted(set(names(folder)) ^ set(files))}"
            if wrong is None:
                good[word] += 1
            else:
                bad.append(f"{word}, {number.name} after {moment:.2f} s: {wrong}")
            shutil.rmtree(folder)
    print("\n".join(f"{word}: {count} ended and run again to the same digits" for word, count in good.items()))
    print(f"{good.total()} of {given.count}", *bad, sep="\n")
    return 1 if bad else 0


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder


if __name__ == "__main__":
    sys.exit(main())
