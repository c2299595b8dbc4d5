"""Damping ratios of one record by two programs: can one of them say 0.13 % and the other 0.33 or 0.45 %?

A chain of four masses with natural frequencies from 4 to 21 Hz, all with one damping ratio, under white forces at all
masses. Records come from the exact covariance of the continuous state over one step (Van Loan 1978), stationary from the
start, so that no filter and no method of the package has a part in them: velocities of the masses at 64 Hz with sensor noise
of 10 %, as of a laser. structid looks at them by default, pyOMA2's SSI (cov) with 30 block rows at order 20 and at order 40.

    python benchmarks/accuracy/damping_of_two_programs.py [--peer FOLDER] [--records 10] [--seed 0]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy import linalg

import structid as sid

RATE, RATIOS, SECONDS, ORDERS = 64.0, (0.0013, 0.0033, 0.0045), (40.0, 120.0), (20, 40)
PEER = """
import json, sys
import numpy as np
from pyoma2.algorithms import SSI
from pyoma2.setup import SingleSetup
answers = []
for values in np.load(sys.argv[1]):
    setup = SingleSetup(values, fs=float(sys.argv[2]))
    run = SSI(name="ssi", method="cov", br=30, ordmax=40, step=2)
    setup.add_algorithms(run)
    setup.run_by_name("ssi")
    columns = [int(order) // 2 for order in sys.argv[3:]]
    answers.append([[run.result.Fn_poles[:, k].tolist(), run.result.Xi_poles[:, k].tolist()] for k in columns])
print("RESULT" + json.dumps(answers))
"""


def chain() -> tuple[np.ndarray, np.ndarray]:
    """Circular frequencies (rad/s) and shapes of four equal masses on equal springs, one end fixed."""
    stiffness = 2 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1)
    stiffness[3, 3] = 1.0
    square, shapes = np.linalg.eigh(stiffness)
    return 2 * np.pi * 4.0 * np.sqrt(square / square[0]), shapes


def records(ratio: float, seconds: float, rng: np.random.Generator, count: int) -> np.ndarray:
    """Velocities with noise, (count, n_samples, 4)."""
    omega, shapes = chain()
    stiffness, damping = shapes * omega**2 @ shapes.T, shapes * (2 * ratio * omega) @ shapes.T
    state = np.block([[np.zeros((4, 4)), np.eye(4)], [-stiffness, -damping]])
    force = np.diag([0.0] * 4 + [1.0] * 4)
    both = linalg.expm(np.block([[-state, force], [np.zeros((8, 8)), state.T]]) / RATE)
    step = both[8:, 8:].T
    shock = np.linalg.cholesky(step @ both[:8, 8:] + 1e-14 * np.eye(8))
    start = np.linalg.cholesky(linalg.solve_continuous_lyapunov(state, -force))
    n = round(seconds * RATE)
    motion, x = np.empty((n, count, 4)), rng.standard_normal((count, 8)) @ start.T
    for k in range(n):
        motion[k] = x[:, 4:]
        x = x @ step.T + rng.standard_normal((count, 8)) @ shock.T
    values = motion.transpose(1, 0, 2)
    return np.asarray(values + 0.1 * values.std(axis=1, keepdims=True) * rng.standard_normal(values.shape))


def nearest(frequency: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """Damping ratio of the pole nearest to each mode; NaN where none is within 2 %."""
    truth = chain()[0] / (2 * np.pi)
    near = np.nanargmin(np.abs(frequency[:, None] - truth), axis=0)
    return np.where(np.abs(frequency[near] / truth - 1) < 0.02, ratio[near], np.nan)


def peer(environment: Path, every: np.ndarray) -> np.ndarray:
    """Damping ratios of the poles of pyOMA2 nearest to the modes, (n_records, n_orders, n_modes)."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "records.npy"
        np.save(path, every)
        command = [environment / "bin" / "python", "-c", PEER, path, str(RATE), *map(str, ORDERS)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    line = next(line for line in done.stdout.splitlines() if line.startswith("RESULT"))
    return np.array([[nearest(*np.array(pair)) for pair in answer] for answer in json.loads(line[6:])])


def main() -> None:
    """Print one row for each damping ratio and length."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--peer", type=Path, help="environment with pyOMA2; without it structid alone is shown")
    chosen = parser.parse_args()
    print(
        "  s  true %   structid % (10, 50, 90 of 100)  covered   pyOMA2 order 20          order 40         theirs > 2 ours"
    )
    for seconds in SECONDS:
        for ratio in RATIOS:
            rng = np.random.default_rng([chosen.seed, round(seconds), round(1e4 * ratio)])
            every = records(ratio, seconds, rng, chosen.records)
            names = ["1X", "2X", "3X", "4X"]
            ours, covered = [], []
            for values in every:
                modes = sid.identify_modes(sid.TimeRecord(RATE, values, names, ("velocity",) * 4))
                ours.append(nearest(modes.frequency, modes.damping_ratio))
                z = (ours[-1] - ratio) / nearest(modes.frequency, modes.std[modes.n_modes :])
                covered += (np.abs(z[np.isfinite(z)]) <= 1.96).tolist()
            theirs = np.full((len(every), 2, 4), np.nan) if chosen.peer is None else peer(chosen.peer, every)
            parts = [np.array(ours), theirs[:, 0], theirs[:, 1]]
            shown = [
                " ".join(f"{100 * q:.2f}" for q in np.quantile(part[np.isfinite(part)], [0.1, 0.5, 0.9]))
                if np.isfinite(part).any()
                else "-"
                for part in parts
            ]
            apart = np.sum(parts[1] > 2 * parts[0]) / max(np.isfinite(parts[0] + parts[1]).sum(), 1)
            print(
                f"{seconds:4.0f}  {100 * ratio:.2f}   {shown[0]:30s}  {100 * np.mean(covered):5.1f} %   {shown[1]:22s}"
                f"   {shown[2]:18s}   {100 * apart:.0f} %",
                flush=True,
            )


if __name__ == "__main__":
    main()
