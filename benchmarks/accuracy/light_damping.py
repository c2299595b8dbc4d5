"""Lightly damped modes in ambient motion: bias and intervals of frequency and damping, and what another program gives.

Four channels, three modes at 4, 9 and 15 Hz with damping ratios drawn from 0.1 to 0.5 %, white forces, sensor noise of
10 % of each channel, sampled at 50 Hz for 300 s (the slowest memory is 13 to 64 s) or --seconds; orders up to a random
number from 20 to 60, or the one of --order. Modes are those as they come, nearest to the truth within 1 %. Errors and
deviations are also told over the least that a record of this length allows, of a frequency f with damping ratio z
sqrt(f z / (2 pi T)), of the ratio sqrt(z / (2 pi f T)) (Au 2014). With --peer, pyOMA2's SSI (cov) of 30
block rows and its poles of order 20 nearest to the truth stand beside.

    python benchmarks/accuracy/light_damping.py [--records 60] [--seconds 300] [--seed 0] [--method pencil] [--order 20]
        [--peer FOLDER]
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
from scipy.signal import lfilter

import structid as sid
from structid.core.errors import NoModesError

RATE, FREQUENCY = 50.0, np.array([4.0, 9.0, 15.0])
PEER = """
import json, sys
import numpy as np
from pyoma2.algorithms import SSI
from pyoma2.setup import SingleSetup
setup = SingleSetup(np.load(sys.argv[1]), fs=50.0)
run = SSI(name="ssi", method="cov", br=30, ordmax=20, step=2)
setup.add_algorithms(run)
setup.run_by_name("ssi")
f, z = run.result.Fn_poles[:, -1], run.result.Xi_poles[:, -1]
keep = np.isfinite(f)
print("RESULT" + json.dumps([list(f[keep]), list(z[keep])]))
"""


def record(rng: np.random.Generator, seconds: float) -> tuple[sid.TimeRecord, np.ndarray]:
    """Velocities of four points, stationary from the start, and the damping ratios."""
    ratio = 10 ** rng.uniform(-3, np.log10(0.005), 3)
    n, settling = round(seconds * RATE), round(400 * RATE)
    poles = np.exp(2 * np.pi * FREQUENCY * (-ratio + 1j * np.sqrt(1 - ratio**2)) / RATE)
    force = rng.standard_normal((3, n + settling))
    motion = [lfilter([1.0], [1, -2 * p.real, abs(p) ** 2], f)[settling:] for p, f in zip(poles, force, strict=True)]
    values = (np.array(motion).T / np.std(motion, axis=1)) @ rng.standard_normal((3, 4))
    values = values + 0.1 * values.std(axis=0) * rng.standard_normal(values.shape)
    return sid.TimeRecord(RATE, values, ["1X", "2X", "3X", "4X"], ("velocity",) * 4), ratio


def peer(python: Path, record: sid.TimeRecord) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies and damping ratios of the poles of pyOMA2."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "record.npy"
        np.save(path, record.values)
        done = subprocess.run([python, "-c", PEER, path], capture_output=True, text=True, check=True)
    frequency, ratio = json.loads(next(line for line in done.stdout.splitlines() if line.startswith("RESULT"))[6:])
    return np.array(frequency), np.array(ratio)


def _both(values: np.ndarray) -> str:
    """Two numbers in words: of the frequency, then of the damping ratio."""
    return " ".join(f"{value:.2f}" for value in values)


def main() -> None:
    """Print one row a method."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=int, default=60)
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--method", help="this one alone")
    parser.add_argument("--order", type=int, help="this one in place of all up to a random one")
    parser.add_argument("--peer", type=Path)
    chosen = parser.parse_args()
    rows: dict[str, list[list[float]]] = {}
    missing = dict.fromkeys([chosen.method] if chosen.method else ("pencil", "ssi_cov", "ssi_data"), 0)
    for seed in range(chosen.seed, chosen.seed + chosen.records):
        rng = np.random.default_rng(seed)
        own, ratio = record(rng, chosen.seconds)
        top = 2 * int(rng.integers(10, 31))
        for method in missing:
            try:
                modes = sid.identify_modes(own, method, orders=[chosen.order] if chosen.order else range(2, top + 1, 2))
            except NoModesError:
                missing[method] += 3
                continue
            for f, z in zip(FREQUENCY, ratio, strict=True):
                near = int(np.abs(modes.frequency - f).argmin())
                if abs(modes.frequency[near] / f - 1) > 0.01:
                    missing[method] += 1
                    continue
                std = modes.std[[near, modes.n_modes + near]]
                errors = np.array([modes.frequency[near] - f, modes.damping_ratio[near] - z])
                least = np.sqrt(np.array([f * z, z / f]) / (2 * np.pi * chosen.seconds))
                found = [modes.damping_ratio[near] / z, std[1] / z]
                rows.setdefault(method, []).append([*errors / std, *found, *errors / least, *std / least])
        if chosen.peer is not None:
            frequency, theirs = peer(chosen.peer / "bin" / "python", own)
            for f, z in zip(FREQUENCY, ratio, strict=True):
                near = int(np.abs(frequency - f).argmin())
                rows.setdefault("pyOMA2", []).append([np.nan, np.nan, theirs[near] / z, *[np.nan] * 5])
    print(
        "method    covered: frequency  damping   z rms      damping found / true: median, 10 %, 90 %   stated std   missing"
        "   over the least: error, rms; deviation, median"
    )
    for method, values in rows.items():
        part = np.array(values)
        inside = 100 * np.mean(np.abs(part[:, :2]) <= 1.96, axis=0)
        rms = np.sqrt(np.mean(part[:, :2] ** 2, axis=0))
        middle, least, most = np.quantile(part[:, 2], [0.5, 0.1, 0.9])
        print(
            f"{method:9s} {inside[0]:17.1f} {inside[1]:9.1f}   {rms[0]:.2f} {rms[1]:.2f}   {middle:19.2f} {least:.2f} {most:.2f}"
            f"   {np.median(part[:, 3]):18.2f}   {missing.get(method, 0):8d}"
            f"   {_both(np.sqrt(np.mean(part[:, 4:6] ** 2, axis=0)))}; {_both(np.median(part[:, 6:8], axis=0))}"
        )


if __name__ == "__main__":
    main()
