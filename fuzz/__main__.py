"""`python -m fuzz`: damages files, has them read in processes of their own, and prints what came of it."""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import psutil

from fuzz.seeds import Seed, make_seeds

ROOT = Path(__file__).parent.parent
#: Processor time after which a file hangs, and how many times as long one that only waits.
SECONDS, PATIENCE = 20.0, 15
OUTCOMES = ("read", "refused", "other", "crash", "hang")


class Reader:
    """One `fuzz.worker`, replaced when it ends."""

    def __init__(self) -> None:
        self.process: subprocess.Popen[str] | None = None
        self.served = 0

    def ask(self, target: str, path: Path) -> tuple[str, str]:
        """What came of reading `path`, and in which words."""
        if self.process is None or self.served >= 300:
            self.close()
            self._start()
        assert self.process is not None
        assert self.process.stdin is not None
        self.served += 1
        late, answered = threading.Event(), threading.Event()
        watch = threading.Thread(target=self._end_where_stuck, args=(self.process, answered, late), daemon=True)
        watch.start()
        try:
            self.process.stdin.write(json.dumps({"target": target, "path": str(path)}) + "\n")
            self.process.stdin.flush()
            line = self.process.stdout.readline() if self.process.stdout else ""
        except BrokenPipeError:
            line = ""
        finally:
            answered.set()
            watch.join()
        if line:
            outcome, words = json.loads(line)
            return outcome, words
        code = self.process.wait()
        self.process = None
        return ("hang", f"took more than {SECONDS} s") if late.is_set() else ("crash", f"ended with {code}")

    def _start(self) -> None:
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
        environment["PYTHONPATH"] = os.pathsep.join([str(ROOT), *filter(None, sys.path)])
        self.process = subprocess.Popen(
            [sys.executable, "-m", "fuzz.worker"], cwd=ROOT, env=environment, text=True, stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        assert self.process.stdout is not None
        if self.process.stdout.readline() != "ready\n":
            raise SystemExit("the reading process does not start; run `python -m fuzz.worker` to see why")
        self.served = 0

    @staticmethod
    def _end_where_stuck(process: subprocess.Popen[str], answered: threading.Event, late: threading.Event) -> None:
        """End a process that has computed for SECONDS, or waited much longer on a busy machine, and gives no answer."""
        with suppress(psutil.NoSuchProcess):
            begun = _processor_seconds(process)
            for _ in range(PATIENCE):
                if answered.wait(SECONDS):
                    return
                if _processor_seconds(process) - begun > 0.9 * SECONDS:
                    break
            late.set()
            process.kill()

    def _kill(self) -> None:
        if self.process is not None:
            self.process.kill()

    def close(self) -> None:
        """End the process."""
        if self.process is not None:
            self._kill()
            self.process.communicate()
            self.process = None


def _processor_seconds(process: subprocess.Popen[str]) -> float:
    """Processor time that a process has taken so far."""
    times = psutil.Process(process.pid).cpu_times()
    return times.user + times.system


@dataclass
class Tally:
    """Outcomes by kind of file, and the cases that must not be."""

    counts: dict[str, Counter[str]] = field(default_factory=dict)
    bad: list[tuple[str, str, str]] = field(default_factory=list)
    slowest: dict[str, float] = field(default_factory=dict)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def note(self, seed: Seed, outcome: str, words: str, kept: str, seconds: float) -> None:
        with self.lock:
            self.counts.setdefault(seed.name, Counter())[outcome] += 1
            self.slowest[seed.name] = max(self.slowest.get(seed.name, 0.0), seconds)
            if outcome not in ("read", "refused"):
                self.bad.append((kept, outcome, words))

    def table(self) -> str:
        """One line a kind of file, and their sum."""
        total: Counter[str] = sum(self.counts.values(), Counter())
        lines = [f"{'file':34s}{'mutants':>9s}" + "".join(f"{name:>9s}" for name in OUTCOMES) + f"{'slowest':>10s}"]
        for name, counts in [*sorted(self.counts.items()), ("all", total)]:
            slowest = self.slowest.get(name, max(self.slowest.values(), default=0.0))
            numbers = "".join(f"{counts[outcome]:9d}" for outcome in OUTCOMES)
            lines.append(f"{name:34s}{counts.total():9d}{numbers}{slowest:8.2f} s")
        return "\n".join(lines)

    def shown(self) -> int:
        """Print the table and what must not be; 1 where anything must not."""
        print(self.table())
        for kept, outcome, words in self.bad[:40]:
            print(f"\n{outcome}: {kept}\n{words}")
        return 1 if self.bad else 0


def run(seeds: list[Seed], count: int, number: int, folder: Path, keep: Path | None, tally: Tally, part: range) -> None:
    """The mutants of `part` of all numbers from 0 to `count`, one after another."""
    reader = Reader()
    try:
        for index in part:
            seed = seeds[index % len(seeds)]
            rng = random.Random(f"{number} {index}")
            place = folder / f"case_{index}"
            path = seed.copied(place)
            path.write_bytes(rng.choice(seed.mutations)(rng, path.read_bytes()))
            begun = time.perf_counter()
            outcome, words = reader.ask(seed.target, path)
            kept = f"{seed.name} {index}"
            if outcome not in ("read", "refused") and keep is not None:
                kept = str(shutil.copytree(place, keep / f"{seed.name.replace('/', '_')}_{index}", dirs_exist_ok=True))
            tally.note(seed, outcome, words, kept, time.perf_counter() - begun)
            shutil.rmtree(place)
    finally:
        reader.close()


def main() -> int:
    """Run, print, and say by the exit code whether anything happened that must not."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000, help="how many mutants [default: 2000]")
    parser.add_argument("--seed", type=int, default=1, help="of the random numbers [default: 1]")
    parser.add_argument("--workers", type=int, default=2, help="processes that read [default: 2]")
    parser.add_argument("--only", default="", help="kinds of files whose name holds this")
    parser.add_argument("--keep", type=Path, default=None, help="folder for the files that must not be")
    given = parser.parse_args()
    tally = Tally()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        seeds = [seed for seed in make_seeds(folder / "seeds") if given.only in seed.name]
        if not seeds:
            raise SystemExit(f"no kind of file is called {given.only!r}")
        reader = Reader()
        for seed in seeds:  # a seed that is not read tells nothing
            outcome, words = reader.ask(seed.target, seed.copied(folder / "whole"))
            if outcome != "read":
                raise SystemExit(f"{seed.name}: the undamaged file is not read: {words}")
        reader.close()
        parts = [range(i, given.count, given.workers) for i in range(given.workers)]
        threads = [
            threading.Thread(target=run, args=(seeds, given.count, given.seed, folder, given.keep, tally, part))
            for part in parts
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    return tally.shown()


if __name__ == "__main__":
    sys.exit(main())
