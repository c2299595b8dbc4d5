"""400 Monte-Carlo repeats on a Dask cluster of two workers, one of them killed half-way, from the command line.

``python benchmarks/cluster_end_to_end.py``: copies the example plate (168 degrees of freedom, 156 lines) with
``intervals = "bootstrap"``, starts ``dask scheduler`` and two ``dask worker`` without nannies, runs ``structid identify
--scheduler``, ends one worker by SIGKILL as soon as the checkpoint holds half of the repeats, and compares every digit
of estimate.json and estimate.h5 with those of ``structid identify`` alone. Wall times and peak memory of each process
are printed. ``--alone 0`` leaves the run alone out, ``--json PATH`` writes what is printed.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

EXAMPLE = Path(__file__).parents[1] / "examples" / "plate_from_mesh"
REPEATS = 400
_ENVIRONMENT = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "STRUCTID_THREADS": "1"}


@dataclass(eq=False)
class Command:
    """A running command, its wall time and the most memory that it held."""

    words: list[str]
    folder: Path
    begun: float = field(default_factory=time.perf_counter)
    seconds: float = 0.0
    peak: int = 0

    def __post_init__(self) -> None:
        self.log = tempfile.TemporaryFile(dir=self.folder)  # noqa: SIM115  closed with the process
        self.process = subprocess.Popen(
            self.words, cwd=self.folder, env=_ENVIRONMENT, stdout=self.log, stderr=subprocess.STDOUT
        )

    def watch(self) -> bool:
        """Whether it still runs; notes its peak memory as the kernel counts it."""
        try:
            text = Path(f"/proc/{self.process.pid}/status").read_text()
            found = [int(line.split()[1]) for line in text.splitlines() if line.startswith("VmHWM")]
            self.peak = max([self.peak, *found])
        except OSError:
            pass
        if self.process.poll() is None:
            return True
        self.seconds = self.seconds or time.perf_counter() - self.begun
        return False

    @property
    def said(self) -> str:
        self.log.seek(0)
        return self.log.read().decode(errors="replace")

    def end(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        self.log.close()


def structid(*words: str) -> list[str]:
    return [sys.executable, "-m", "structid", *words]


def dask(*words: str) -> list[str]:
    return [sys.executable, "-m", "dask", *words]


def written_study(folder: Path, lines: int | None) -> Path:
    """The example with bootstrap intervals, every so many lines only where `lines` says so."""
    shutil.copytree(EXAMPLE, folder / "plate")
    path = folder / "plate" / "study.toml"
    band = "" if lines is None else f"band = [5.0, {4.5 + lines:.1f}]\n"
    path.write_text(path.read_text(encoding="utf-8") + f'intervals = "bootstrap"\n{band}', encoding="utf-8")
    return path


def repeats_done(kept: Path) -> int:
    """Repeats in the checkpoint."""
    import numpy as np

    names: set[str] = set()
    for path in kept.glob("done-*.npz"):
        try:
            with np.load(path, allow_pickle=False) as file:
                names |= set(json.loads(str(file["tree"]))["map"])
        except OSError:  # two parts were just joined to one
            continue
    return sum(name.startswith("bootstrap replicates") for name in names)


def watched(command: Command, others: list[Command], each: Callable[[], None] = lambda: None) -> None:
    """Wait for the command, looking after all of them ten times a second."""
    while command.watch():
        for other in others:
            other.watch()
        each()
        time.sleep(0.1)
    if command.process.returncode:
        raise SystemExit(f"{' '.join(command.words)} ended with {command.process.returncode}:\n{command.said}")


def clustered(folder: Path, study: Path) -> dict[str, Any]:
    """The run on a cluster that loses a worker."""
    address_file = folder / "scheduler.json"
    started = [Command(dask("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard",
                            "--scheduler-file", str(address_file)), folder)]  # fmt: skip
    try:
        while not address_file.exists() or "address" not in address_file.read_text():
            if not started[0].watch():
                raise SystemExit(f"dask scheduler ended:\n{started[0].said}")
            time.sleep(0.1)
        address = json.loads(address_file.read_text())["address"]
        for _ in range(2):
            words = dask("worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard")
            started.append(Command(words, folder))
        killed: list[int] = []
        kept = folder / "clustered.checkpoint"

        def kill() -> None:
            if not killed and (done := repeats_done(kept)) >= REPEATS // 2:
                os.kill(started[1].process.pid, signal.SIGKILL)
                killed.append(done)

        time.sleep(3.0)  # both workers there before the run looks for them
        run = Command(
            structid("identify", str(study), "--out", "clustered", "--no-report", "--scheduler", address,
                     "--checkpoint", "1"), folder,
        )  # fmt: skip
        watched(run, started, kill)
        code = started[1].process.wait() if killed else None
        peaks = {"scheduler": started[0].peak, "worker killed": started[1].peak, "worker left": started[2].peak}
        return {
            "seconds": run.seconds,
            "peak_kB": {"structid": run.peak, **peaks},
            "repeats_when_killed": killed[0] if killed else None,
            "killed_worker_ended_with": code,
            "checkpoint_left": kept.exists(),
        }
    finally:
        for command in reversed(started):
            command.end()


def alone(folder: Path, study: Path) -> dict[str, Any]:
    """The same in one process."""
    run = Command(structid("identify", str(study), "--out", "alone", "--no-report"), folder)
    watched(run, [])
    return {"seconds": run.seconds, "peak_kB": {"structid": run.peak}}


def differences(one: Path, two: Path) -> list[str]:
    """Names of what differs in estimate.json or estimate.h5, bit by bit."""
    import h5py
    import numpy as np

    found = []
    first, second = (json.loads((folder / "estimate.json").read_text()) for folder in (one, two))
    found += [f"estimate.json {key}" for key in sorted({*first, *second}) if first.get(key) != second.get(key)]
    with h5py.File(one / "estimate.h5") as a, h5py.File(two / "estimate.h5") as b:
        names: list[str] = []
        a.visit(names.append)
        others: list[str] = []
        b.visit(others.append)
        found += sorted({*names} ^ {*others})
        for name in set(names) & set(others):
            if isinstance(a[name], h5py.Dataset):
                left, right = np.asarray(a[name][()]), np.asarray(b[name][()])
                if left.dtype != right.dtype or left.tobytes() != right.tobytes():
                    found.append(f"estimate.h5 {name}")
    return found


def measured(lines: int | None = None, with_alone: bool = True) -> dict[str, Any]:
    """Both runs and their comparison."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        study = written_study(folder, lines)
        result: dict[str, Any] = {"load": os.getloadavg()[0], "cluster": clustered(folder, study)}
        if with_alone:
            result["alone"] = alone(folder, study)
            result["differences"] = differences(folder / "alone", folder / "clustered")
        failed = json.loads((folder / "clustered" / "estimate.json").read_text())
        result["status"] = failed["status"]
    return result


def rows(quick: bool) -> list[dict[str, Any]]:
    """The figures as rows of a table: what, bar, figure, met, detail."""
    found = measured(40 if quick else None)
    there, here = found["cluster"], found["alone"]
    ok = not found["differences"] and there["repeats_when_killed"] is not None
    peak = max(there["peak_kB"].values()) / 1e3
    detail = (
        f"{there['seconds']:.0f} s on the cluster, {here['seconds']:.0f} s alone; killed at {there['repeats_when_killed']}"
        f" of {REPEATS}; largest process {peak:.0f} MB (alone {here['peak_kB']['structid'] / 1e3:.0f} MB)"
    )
    figure = f"{len(found['differences'])} differences"
    return [
        {
            "what": f"{REPEATS} repeats on a cluster of two, one worker killed half-way, against one process",
            "bar": "the same digits",
            "figure": figure,
            "met": ok,
            "detail": detail,
        }
    ]


def main() -> None:
    """Print what the runs took and whether their digits are the same."""
    words = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words.add_argument("--lines", type=int, help="the first so many lines of the record only")
    words.add_argument("--alone", type=int, default=1, help="0: without the run to compare with")
    words.add_argument("--json", type=Path, metavar="PATH")
    given = words.parse_args()
    found = measured(given.lines, bool(given.alone))
    for kind in ("cluster", "alone"):
        if kind in found:
            run = found[kind]
            peaks = ", ".join(f"{name} {peak / 1e3:.0f} MB" for name, peak in run["peak_kB"].items())
            print(f"{kind}: {run['seconds']:.1f} s wall; peak memory {peaks}")
    there = found["cluster"]
    print(f"worker killed when {there['repeats_when_killed']} of {REPEATS} repeats were kept; status {found['status']}")
    if "differences" in found:
        print("same digits throughout" if not found["differences"] else f"OTHER DIGITS: {found['differences']}")
    if given.json:
        given.json.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
