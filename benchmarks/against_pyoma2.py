"""Stochastic subspace identification beside pyOMA2 on the same records: time and error at equal order and delays.

Twelve modes from 1 to 18 Hz, damping ratios of 1 %, white forces, 2 % sensor noise, sampled at 50 Hz. Orders 2, 4, ...
48, 20 block rows, no covariance on either side; one BLAS thread, processor time of the identification alone (no
import, no file; a short record warms up), the two sides in turn. Errors are those of structid's modes as they come, of
its poles of order 48 and of pyOMA2's poles of order 48, those nearest to the truth by |f / f_true - 1| + 1 - MAC, over
all seeds. Half of the 24 poles are noise; by frequency alone one of these is nearest now and then, on either side, and its
damping wrong by hundreds of per cent. Modes are the poles nearest to all others of their cluster over the orders.

pyOMA2 is installed into an environment of its own on the first run:

    python benchmarks/against_pyoma2.py [--repeats 3] [--seed 0] [--peer FOLDER]
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
import venv
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.signal import lfilter

import structid as sid
from structid.modal import ModalOptions, modal_identification

PEER = "pyOMA-2==1.4.3"
RATE, N_MODES, RATIO, ROWS, MAX_ORDER = 50.0, 12, 0.01, 20, 48
SIZES = ((10, 20_000), (30, 100_000), (100, 100_000))
PAIRS = (("ssi_cov", "cov_R"), ("pencil", "cov"), ("ssi_data", "dat"))
PEER_CODE = """
import json, sys, time
import numpy as np
from pyoma2.algorithms import SSI
from pyoma2.setup import SingleSetup
path, method, rate, rows, order = sys.argv[1], sys.argv[2], float(sys.argv[3]), int(sys.argv[4]), int(sys.argv[5])
values = np.load(path)
for part in (values[:2000], values):  # the first one warms up
    setup = SingleSetup(part, fs=rate)
    start = time.process_time()
    run = SSI(name="ssi", method=method, br=rows, ordmax=order, step=2)
    setup.add_algorithms(run)
    setup.run_by_name("ssi")
    seconds = time.process_time() - start
last = [run.result.Fn_poles[:, -1], run.result.Xi_poles[:, -1]]
keep = np.isfinite(last[0])
shapes = run.result.Phi_poles[:, -1][keep].T
np.save(path + ".shapes.npy", shapes)
print("RESULT" + json.dumps({"seconds": seconds, "frequency": list(last[0][keep]), "ratio": list(last[1][keep])}))
"""


def truth() -> np.ndarray:
    """Natural frequencies, Hz."""
    return np.linspace(1.0, 18.0, N_MODES)


def true_shapes(n_channels: int) -> np.ndarray:
    """Shapes at the channels, (n_channels, n_modes)."""
    place = (np.arange(n_channels) + 0.5) / n_channels
    return np.asarray(np.sin(np.pi * np.outer(place, np.arange(1, N_MODES + 1))))


def record(n_channels: int, n_samples: int, seed: int) -> np.ndarray:
    """Accelerations, (n_samples, n_channels)."""
    rng = np.random.default_rng(seed)
    poles = np.exp((-RATIO + 1j * np.sqrt(1 - RATIO**2)) * 2 * np.pi * truth() / RATE)
    motion = [lfilter([1.0], [1, -2 * p.real, abs(p) ** 2], rng.standard_normal(n_samples)) for p in poles]
    values = (np.array(motion).T / np.std(motion, axis=1)) @ true_shapes(n_channels).T
    return np.asarray(values + 0.02 * values.std(axis=0) * rng.standard_normal(values.shape))


@dataclass(frozen=True)
class Answer:
    """Seconds of the processor, and frequencies (Hz), damping ratios and shapes of order `MAX_ORDER`."""

    seconds: float
    frequency: np.ndarray
    damping_ratio: np.ndarray
    shapes: np.ndarray


def ours(values: np.ndarray, method: str) -> tuple[Answer, Answer]:
    """The modes of structid, and its poles."""
    names = [f"{i + 1}Z" for i in range(values.shape[1])]
    options = ModalOptions(orders=range(2, MAX_ORDER + 1, 2), block_rows=ROWS, n_pieces=0)
    for part in (values[:2000], values):  # the first one warms up
        motion = sid.TimeRecord(RATE, part, names, ("acceleration",) * len(names))
        start = time.process_time()
        result = modal_identification(motion, method, options)
        seconds = time.process_time() - start
    last, modes = result.sweep[-1], result.modes
    keep = (last.damping_ratio > 0) & (last.damping_ratio < 0.1)  # as pyOMA2's hard criterion
    return (
        Answer(seconds, modes.frequency, modes.damping_ratio, np.asarray(modes.mode_shapes)),
        Answer(seconds, last.frequency[keep], last.damping_ratio[keep], last.shapes[:, keep]),
    )


def theirs(python: Path, path: Path, method: str) -> Answer:
    """The answer of the peer, in a process of its own."""
    command = [python, "-c", PEER_CODE, path, method, RATE, ROWS, MAX_ORDER]
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False)
    lines = [line for line in done.stdout.splitlines() if line.startswith("RESULT")]
    if not lines:
        raise SystemExit(f"pyOMA2 gave no result:\n{done.stderr[-2000:]}")
    result = json.loads(lines[0][6:])
    shapes = np.load(f"{path}.shapes.npy")
    return Answer(result["seconds"], np.array(result["frequency"]), np.array(result["ratio"]), shapes)


def errors(answer: Answer) -> tuple[np.ndarray, np.ndarray]:
    """Relative frequency and damping errors of the poles nearest to the true ones by frequency and shape."""
    away = np.abs(answer.frequency[:, None] / truth() - 1) + 1 - sid.mac(answer.shapes, true_shapes(len(answer.shapes)))
    near = away.argmin(axis=0)
    return answer.frequency[near] / truth() - 1, answer.damping_ratio[near] / RATIO - 1


def peer_python(folder: Path) -> Path:
    """Interpreter of the environment in `folder`, which is made where it is missing."""
    python = folder / "bin" / "python"
    if not python.exists():
        venv.create(folder, with_pip=True)
        subprocess.run([str(python), "-m", "pip", "install", "-q", PEER], check=True)
    return python


def row(python: Path, size: tuple[int, int], pair: tuple[str, str], seeds: range, scratch: Path) -> None:
    """Measure and print one line of the table."""
    seconds: tuple[list[float], ...] = ([], [], [])
    wrong: tuple[list[np.ndarray], ...] = ([], [], [])
    for seed in seeds:
        values = record(*size, seed)
        path = scratch / "record.npy"
        np.save(path, values)
        for side, answer in enumerate((*ours(values, pair[0]), theirs(python, path, pair[1]))):
            seconds[side].append(answer.seconds)
            wrong[side].append(np.array(errors(answer)))
    rms = [np.sqrt(np.mean(np.square(part), axis=(0, 2))) for part in wrong]
    own, _, peer = (statistics.median(part) for part in seconds)
    ratios = [b / a for a, _, b in zip(*seconds, strict=True)]
    frequency, damping = ("  ".join(f"{100 * part[i]:.{digits}f}" for part in rms) for i, digits in ((0, 4), (1, 2)))
    print(
        f"{size[0]:4d} x {size[1]:6d}  {pair[0]:9s}{pair[1]:6s} {own:8.3f} {peer:8.3f} {statistics.median(ratios):7.1f}"
        f"   {frequency}   {damping}",
        flush=True,
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--peer", type=Path, default=Path(tempfile.gettempdir()) / "structid-peer-pyoma2")
    parser.add_argument("--sizes", type=int, default=len(SIZES), help="how many of the sizes, smallest first")
    chosen = parser.parse_args()
    python = peer_python(chosen.peer)
    seeds = range(chosen.seed, chosen.seed + chosen.repeats)
    print(f"{PEER}; seeds {seeds.start} to {seeds.stop - 1}; bar: ratio at least 5, errors no greater than theirs")
    print(
        "channels x samples  ours     theirs  s ours s theirs   ratio   rms %: frequency of modes, poles, theirs; damping"
    )
    with tempfile.TemporaryDirectory() as scratch:
        for size in SIZES[: chosen.sizes]:
            for pair in PAIRS:
                row(python, size, pair, seeds, Path(scratch))


if __name__ == "__main__":
    sys.exit(main())
