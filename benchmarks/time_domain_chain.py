"""A chain of beams identified from its motion on disk, from the command line, with wall time and peak memory.

``python benchmarks/time_domain_chain.py --elements 100000 --gigabytes 2`` writes a study and a record of all motions
(random motion, the forces that it asks for, and noise on the forces), runs ``structid motion`` on them in a process of
its own and compares every value with the truth.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import h5py
import numpy as np

import structid as sid

RATE = 1000.0
PROPERTIES = ("mass", "mass_damping", "bending_stiffness")


def main() -> None:
    """Write, run, compare, print."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--elements", type=int, default=1000)
    options.add_argument("--gigabytes", type=float, default=0.1)
    options.add_argument("--noise", type=float, default=0.01, help="of the force, in parts of its rms")
    options.add_argument("--threads", type=int, default=1)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--folder", type=Path, help="kept; a temporary one by default")
    chosen = options.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = chosen.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        begun = time.perf_counter()
        actual = written(folder, chosen.elements, chosen.gigabytes, chosen.noise, chosen.seed)
        print(f"study and record written in {time.perf_counter() - begun:.1f} s", flush=True)
        run(folder, chosen.threads, actual)


def run(folder: Path, threads: int, actual: np.ndarray) -> None:
    """The command, and its answer against the truth."""
    command = [sys.executable, "-m", "structid", "motion", str(folder / "beam.toml"), "--threads", str(threads)]
    begun = time.perf_counter()
    done = subprocess.run([*command, "--out", str(folder / "found")], capture_output=True, text=True, check=False)
    print(done.stdout + (done.stderr if done.returncode else ""))
    print(f"exit code {done.returncode}, {time.perf_counter() - begun:.1f} s with start and writing")
    summary = json.loads((folder / "found" / "motion.json").read_text())
    with (folder / "found" / "parameters.csv").open() as stream:
        table = list(csv.DictReader(stream))
    values = np.array([float(row["value"] or "nan") for row in table])
    std = np.array([float(row["standard_deviation"] or "nan") for row in table])
    error = values - actual
    print(f"largest relative error {np.abs(error / actual).max():.2e}")
    print(f"errors within two standard deviations: {np.mean(np.abs(error) <= 2 * std):.4f} (normal: 0.9545)")
    size = summary["record_bytes"]
    print(f"peak memory {summary['peak_memory_bytes'] / 1e6:.0f} MB for a record of {size / 1e6:.0f} MB")


def written(folder: Path, n: int, gigabytes: float, noise: float, seed: int) -> np.ndarray:
    """beam.toml and motion.h5 in `folder`; the true values of the parameters."""
    rng = np.random.default_rng(seed)
    actual = {name: rng.uniform(0.8, 1.2, n) for name in PROPERTIES}
    nodes = "\n".join(f"{i} = {float(i)}" for i in range(n + 1))
    pairs = ", ".join(f"[{i}, {i + 1}]" for i in range(n))
    unknowns = "\n".join(f'[[unknown]]\nproperty = "{p}"\nelements = "beam"\neach = true\n' for p in PROPERTIES)
    (folder / "beam.toml").write_text(
        f'title = "Chain of {n} beams"\n\n[structure]\nactive = ["Y", "RZ"]\nfixed = ["0Y", "0RZ"]\n\n'
        f'[structure.nodes]\n{nodes}\n\n[[structure.beam]]\nname = "beam"\nnodes = [{pairs}]\n'
        "mass = 1.0\nbending_stiffness = 1.0\nmass_damping = 1.0\n\n"
        f'{unknowns}\n[record]\npath = "motion.h5"\n'
    )
    beam = sid.Beam("beam", np.stack([np.arange(n), np.arange(1, n + 1)], axis=1), **actual)
    structure = sid.Structure({i: float(i) for i in range(n + 1)}, [beam], ["0Y", "0RZ"], active=["Y", "RZ"])
    matrices = [structure.matrix(law).tocsr() for law in ("mass", "damping", "stiffness")]
    n_dofs = structure.n_dofs
    names = [str(dof) for dof in structure.dofs]
    m = max(20, round(gigabytes * 1e9 / (32 * n_dofs)))
    text = h5py.string_dtype("utf-8")
    with h5py.File(folder / "motion.h5", "w") as file:
        file.create_dataset("structid_record", data="time 1", dtype=text)
        file.create_dataset("source", data="random motion", dtype=text)
        file["sampling_rate"], file["start"] = [RATE], [0.0]
        file.create_dataset("channels", data=names * 4, dtype=text)
        kinds = np.repeat(["acceleration", "velocity", "displacement", "force"], n_dofs)
        file.create_dataset("quantities", data=kinds.tolist(), dtype=text)
        values = file.create_dataset("values", (m, 4 * n_dofs), dtype=np.float64)
        step = max(1, 4_000_000 // n_dofs)
        for first in range(0, m, step):
            motion = rng.standard_normal((3, min(step, m - first), n_dofs))
            force = sum((matrix @ part.T).T for matrix, part in zip(matrices, motion, strict=True))
            force += noise * np.sqrt((force**2).mean()) * rng.standard_normal(force.shape)
            values[first : first + step] = np.concatenate([*motion, force], axis=1)
    return np.concatenate([actual[name] for name in PROPERTIES])


if __name__ == "__main__":
    main()
