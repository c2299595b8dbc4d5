"""Time and peak memory against elements, samples, frequencies, parameters and channels, measured.

    python benchmarks/scaling.py --out FOLDER [--quick] [--only LAW] [--points N]

Every point runs in a process of its own on one thread: processor time of the work, and how far it raised the largest
resident memory of the process over what interpreter, libraries and a tiny run of the same kind had taken. The slopes
are those of straight lines through the last three points of each law, on logarithmic axes. Writes `scaling.json` and
`scaling.png`.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

# Nothing large is imported before the runs: on Linux a process starts with the largest memory of the one that made it.

FOLDER = Path(__file__).resolve().parent
POINTS_OF_A_SLOPE = 3


@dataclass(frozen=True)
class Law:
    """What is varied, and the slopes that theory gives for time and memory where the variable is large."""

    name: str
    title: str
    axis: str
    sizes: tuple[int, ...]
    quick: tuple[int, ...]
    time_slope: float
    memory_slope: float


LAWS = (
    Law("motion_elements", "Motion, one pass", "beam elements", (1000, 3000, 10_000, 30_000), (300, 1000, 3000), 1, 1),
    Law("motion_samples", "Motion, one pass", "samples", (1000, 3000, 10_000, 30_000), (300, 1000, 3000), 1, 0),
    Law(
        "frf_elements", "FRF residual + Jacobian", "elements, 2-D", (500, 2000, 8000, 20_000), (128, 500, 2000), 1.5, 1
    ),
    Law("frf_frequencies", "FRF residual + Jacobian", "frequency lines", (4, 16, 64, 256), (4, 16, 64), 1, 0),
    Law("frf_parameters", "FRF residual + Jacobian", "parameters", (10, 100, 1000, 10_000), (10, 100, 1000), 0, 0),
    Law(
        "modal_samples", "Modes, SSI-cov", "samples", (10_000, 50_000, 250_000, 1_000_000), (3000, 10_000, 30_000), 1, 1
    ),
    Law("modal_channels", "Modes, SSI-cov", "channels", (10, 20, 40, 80), (5, 10, 20), 2, 2),
    Law("field_channels", "Full field", "channels", (1000, 5000, 25_000, 125_000), (3000, 10_000, 30_000), 1, 1),
)


def main() -> None:
    """Run all points, print the slopes, write and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder for scaling.json and scaling.png")
    parser.add_argument("--quick", action="store_true", help="three small sizes a law")
    parser.add_argument("--only", action="append", choices=[law.name for law in LAWS], help="one law; repeatable")
    parser.add_argument("--points", type=int, help="the first so many sizes of each law, at least two")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    begun = time.perf_counter()
    results = []
    print(f"{'law':18s} {'size':>9s} {'time, s':>10s} {'memory, MB':>11s}", flush=True)
    for law in LAWS:
        if given.only and law.name not in given.only:
            continue
        results.append(result_of(law, (law.quick if given.quick else law.sizes)[: given.points]))
    seconds = time.perf_counter() - begun
    print(f"{seconds:.0f} s")
    from all import machine  # after the runs: it loads NumPy
    from scaling_figure import draw

    whole = {"quick": given.quick, "seconds": seconds, "machine": machine(), "laws": results}
    (given.out / "scaling.json").write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")
    draw(results, given.out / "scaling.png")
    print(given.out / "scaling.png")


def result_of(law: Law, sizes: tuple[int, ...]) -> dict[str, Any]:
    """All points of one law, and their slopes."""
    points = []
    with tempfile.TemporaryDirectory() as folder:
        for size in sizes:
            if not law.name.startswith("frf"):  # the others read a record from disk
                step(law.name, size, folder, "prepare")
            found = json.loads(step(law.name, size, folder, "measure"))
            for path in Path(folder).iterdir():
                path.unlink()
            memory = max(found["peak"] - found["before"], 0)
            points.append({"size": size, "seconds": found["seconds"], "memory": memory, **found})
            print(f"{law.name:18s} {size:9d} {found['seconds']:10.4g} {memory / 1e6:11.1f}", flush=True)
    slopes = {key: slope([p["size"] for p in points], [p[key] for p in points]) for key in ("seconds", "memory")}
    wanted = f"(expected {law.time_slope:g} and {law.memory_slope:g})"
    print(f"{law.name:18s} slopes: time {slopes['seconds']:.2f}, memory {slopes['memory']:.2f} {wanted}", flush=True)
    return {**asdict(law), "points": points, "slopes": slopes}


def step(law: str, size: int, folder: str, name: str) -> str:
    """What one process says; its own words where it fails."""
    command = [sys.executable, str(FOLDER / "scaling_cases.py"), law, str(size), folder, name]
    single = dict.fromkeys(("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS", "STRUCTID_THREADS"), "1")
    done = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, **single})
    if done.returncode:
        said = done.stderr.strip().splitlines()
        raise SystemExit(f"{law}, size {size}: {said[-1] if said else f'ended with code {done.returncode}'}")
    return done.stdout


def slope(sizes: list[int], values: list[float]) -> float:
    """Of the straight line through the last points, both axes logarithmic; NaN where a value is not positive."""
    x = [math.log(size) for size in sizes[-POINTS_OF_A_SLOPE:]]
    if min(values[-POINTS_OF_A_SLOPE:]) <= 0:
        return float("nan")
    y = [math.log(value) for value in values[-POINTS_OF_A_SLOPE:]]
    middle, level = sum(x) / len(x), sum(y) / len(y)
    return sum((a - middle) * (b - level) for a, b in zip(x, y, strict=True)) / sum((a - middle) ** 2 for a in x)


if __name__ == "__main__":
    main()
