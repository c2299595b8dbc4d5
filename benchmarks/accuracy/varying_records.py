"""Set-ups of a chain whose clamp differs from one to the next: do the intervals of what is common hold the truth?

Simulated by the matrices below, not by structid. Each repeat draws the clamp's stiffness of every set-up about a common
value, and the noise; what the model holds is exact.

    python benchmarks/accuracy/varying_records.py [--repeats 100] [--setups 8] [--scatter 0.05]
"""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import structid as sid
from structid.unknowns.tolerances import EXACT

MASSES = np.array([1.2, 1.0, 0.8, 1.1, 0.9])
SPRINGS = np.array([9.0e3, 1.1e4, 8.0e3, 1.0e4])
CLAMP, LOSS, NOISE = 6.0e3, 0.03, 0.02
FREQUENCY = np.linspace(3.0, 32.0, 60)
SENSORS = (1, 4)
#: Outlying clamp of `outlying_setup`, and by how many scatters.
NAMES = ("clamp", "s1", "s2", "s3", "s4")


def receptance(clamp: float, frequency: np.ndarray) -> np.ndarray:
    """Responses of all masses to a force on the last, (n_lines, 5), m/N."""
    stiffness = np.diag(np.concatenate([[clamp], SPRINGS]) + np.concatenate([SPRINGS, [0.0]]))
    stiffness -= np.diag(SPRINGS, 1) + np.diag(SPRINGS, -1)
    omega = 2 * np.pi * frequency[:, None, None]
    dynamic = stiffness * (1 + 1j * LOSS) - omega**2 * np.diag(MASSES)
    return np.linalg.solve(dynamic, np.eye(5)[:, 4:])[:, :, 0]


def setups(clamps: np.ndarray, rng: np.random.Generator, unknown: list[sid.Unknown]) -> list[sid.Setup]:
    """A set-up for each clamp, with noise in proportion to each channel's mean magnitude."""
    ends = [["1X", "2X"], ["2X", "3X"], ["3X", "4X"], ["4X", "5X"]]
    elements = [sid.PointMass(f"m{k}", [k], m, directions=["X"]) for k, m in enumerate(MASSES, 1)]
    elements.append(sid.Spring("clamp", "1X", stiffness=5.0e3, loss_factor=LOSS))
    elements += [sid.Spring(f"s{k}", a, b, stiffness=1e4, loss_factor=LOSS) for k, (a, b) in enumerate(ends, 1)]
    structure = sid.Structure({k: float(k) for k in range(1, 6)}, elements)
    made = []
    for clamp in clamps:
        clean = receptance(float(clamp), FREQUENCY)[:, list(SENSORS), None]
        std = NOISE * np.abs(clean).mean(axis=0, keepdims=True) * np.ones_like(clean.real)
        noise = (rng.standard_normal(clean.shape) + 1j * rng.standard_normal(clean.shape)) / np.sqrt(2)
        record = sid.FrfRecord(
            frequency=FREQUENCY,
            values=clean + std * noise,
            outputs=tuple(sid.Dof(k + 1, "X") for k in SENSORS),
            inputs=(sid.Dof(5, "X"),),
            kind="receptance",
            variance=std**2,
            noise_source="declared",
        )
        made.append(sid.Setup(structure, sid.parameters(structure, unknown), record))
    return made


def declared(varies: bool | float) -> list[sid.Unknown]:
    """All stiffnesses; the clamp's as it is said."""
    return [sid.Unknown("stiffness", name, varies=varies if name == "clamp" else False) for name in NAMES]


@dataclass(frozen=True)
class Repeat:
    """What one repeat gave: whether intervals hold the clamp and the springs, error over std of these, scatter, outlying."""

    clamp: bool
    springs: tuple[bool, ...]
    others: tuple[float, ...]
    scatter: float
    scatter_held: bool
    outlying: tuple[str, ...]
    error: float
    std: float


def repeat(seed: int, n: int = 8, scatter: float = 0.05, varies: bool | float = True, moved: float = 0.0) -> Repeat:
    """One draw; the clamp of the third set-up is moved by `moved` scatters besides."""
    rng = np.random.default_rng(seed)
    clamps = CLAMP * np.exp(scatter * rng.standard_normal(n))
    clamps[2] *= np.exp(scatter * moved)
    options = sid.IdentifyOptions(restarts=0, tolerances=EXACT)
    found = sid.identify_together(setups(clamps, rng, declared(varies)), options)
    ends = dict(zip(found.estimate.names, found.intervals.ends, strict=True))
    truth = dict(zip((f"stiffness[{name}]" for name in NAMES), (CLAMP, *SPRINGS), strict=True))
    held = {name: bool(ends[name][0] <= value <= ends[name][1]) for name, value in truth.items()}
    clamp = found.estimate.names.index("stiffness[clamp]")
    one = found.priors.varied[0] if found.priors.varied else None
    return Repeat(
        held["stiffness[clamp]"],
        tuple(held[f"stiffness[{name}]"] for name in NAMES[1:]),
        tuple(
            (value - k) / std
            for (value, std), k in (
                (found.estimate[f"stiffness[{n}]"], k) for n, k in zip(NAMES[1:], SPRINGS, strict=True)
            )
        ),
        one.scatter if one else 0.0,
        bool(one and one.interval[0] <= scatter <= one.interval[1]),
        tuple(one.records[k] for k in one.outlying) if one else (),
        float(np.log(found.estimate.values[clamp] / CLAMP)),
        float(found.estimate.std_free[clamp]),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=100, help="seeds 0 on")
    parser.add_argument("--setups", type=int, default=8)
    parser.add_argument("--scatter", type=float, default=0.05)
    chosen = parser.parse_args()
    print("              | clamp | springs | scatter, median | its interval | called outlying | error / std, rms")
    cases = {
        "one unknown": (False, 0.0),
        "varies = true": (True, 0.0),
        "given": (chosen.scatter, 0.0),
        "third + 6 s": (True, 6.0),
    }
    for name, (varies, moved) in cases.items():
        found = [repeat(seed, chosen.setups, chosen.scatter, varies, moved) for seed in range(chosen.repeats)]
        wrong = np.mean([any(r != "record 3" or not moved for r in one.outlying) for one in found])
        right = np.mean(["record 3" in one.outlying for one in found]) if moved else np.nan
        print(
            f"{name:13s} | {np.mean([one.clamp for one in found]):.2f}  | {np.mean([one.springs for one in found]):.2f}"
            f"    | {np.median([one.scatter for one in found]):.4f}          | {np.mean([one.scatter_held for one in found]):.2f}"
            f"         | false {wrong:.2f}, right {right:.2f} |"
            f" {np.sqrt(np.mean([(one.error / one.std) ** 2 for one in found])):.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
