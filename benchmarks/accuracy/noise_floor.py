"""FRFs with a noise floor that nobody stated: is a right model called right, a wrong one wrong, and do the intervals hold?

Chains of three to six masses with random masses, stiffnesses and damping, an accelerometer at every mass and a hammer at the
last. The noise is a part of each value and a floor, 0.3 to 3 % of the largest channel. The study states no noise, only the
part, or both. All stiffnesses are unknown and start 30 % off; masses are exact, and in the second half of the studies a
mass is 10 % heavier than drawn. The responses are this file's own.

    python benchmarks/accuracy/noise_floor.py [--repeats 40] [--seed 0]
"""

from __future__ import annotations

import argparse
import os
from collections import Counter

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from structid import PointMass, Spring, Structure, Unknown, identify, parameters
from structid.diagnose.verdict import judged
from structid.records import FrfRecord, with_declared_noise

STATEMENTS = ("nothing", "the part", "both")


def chain(seed: int, is_wrong: bool) -> tuple[FrfRecord, list[float], np.ndarray, float, float]:
    """Record, drawn masses (kg), true stiffnesses (N/m), the part and the floor ((m/s^2)/N) of the noise of one chain."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 7))
    masses, stiffness = rng.uniform(1, 3, n), rng.uniform(2e5, 6e5, n)
    loss_factor = rng.uniform(0.005, 0.03)
    true_masses = masses.copy()
    if is_wrong:
        true_masses[rng.integers(n)] *= 1.1
    k = np.diag(stiffness + np.append(stiffness[1:], 0.0)) - np.diag(stiffness[1:], 1) - np.diag(stiffness[1:], -1)
    highest = np.sqrt(np.linalg.eigvals(k / true_masses[:, None]).real.max()) / (2 * np.pi)
    frequency = np.linspace(0.02, 1.1, int(rng.integers(300, 1000))) * highest
    omega = 2 * np.pi * frequency
    dynamic = k * (1 + 1j * loss_factor) - omega[:, None, None] ** 2 * np.diag(true_masses)
    values = -(omega[:, None, None] ** 2) * np.linalg.inv(dynamic)[:, :, -1:]
    part, floor = rng.uniform(0.003, 0.02), rng.uniform(0.003, 0.03) * np.sqrt(np.mean(np.abs(values) ** 2))
    noise = (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape)) / np.sqrt(2)
    values = values + noise * np.hypot(part * np.abs(values), floor)
    outputs = [f"{node}X" for node in range(1, n + 1)]
    return FrfRecord(frequency, values, outputs, outputs[-1:], "accelerance"), masses.tolist(), stiffness, part, floor


def answer(seed: int, is_wrong: bool, statement: str) -> tuple[str, np.ndarray]:
    """The verdict, and the errors of the stiffnesses in standard deviations, (n,)."""
    record, masses, truth, part, floor = chain(seed, is_wrong)
    if statement != "nothing":
        record = with_declared_noise(record, part, floor if statement == "both" else 0.0)
    factor = np.random.default_rng(seed + 1).uniform(0.7, 1.3, len(truth))
    loss = {"loss_factor": 0.01}
    elements = [PointMass(f"mass {i}", i, mass=m, tolerance=0.0) for i, m in enumerate(masses, 1)]
    elements += [
        Spring(f"k{i}", f"{i}X", f"{i - 1}X" if i > 1 else None, stiffness=k, **loss)
        for i, k in enumerate(truth * factor, 1)
    ]
    structure = Structure({i: float(i) for i in range(1, len(masses) + 1)}, elements, active=["X"])
    springs = [f"k{i}" for i in range(1, len(truth) + 1)]
    unknown = [*(Unknown("stiffness", name) for name in springs), Unknown("loss_factor", springs)]
    found = identify(structure, parameters(structure, unknown), record)
    at = [found.estimate.names.index(f"stiffness[{name}]") for name in springs]
    return judged(found).verdict, (found.estimate.values[at] - truth) / found.estimate.std[at]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=40, help="chains of each kind")
    parser.add_argument("--seed", type=int, default=0, help="of the first chain")
    options = parser.parse_args()
    print(f"{options.repeats} chains from seed {options.seed}; errors are those of right models")
    print(
        f"{'stated':10} {'model':6} {'sound':>6} {'approximate':>12} {'wrong_model':>12} {'other':>6} {'z rms':>6} {'in 95 %':>8}"
    )
    for statement in STATEMENTS:
        for is_wrong in (False, True):
            answers = [answer(options.seed + k, is_wrong, statement) for k in range(options.repeats)]
            verdicts = Counter(verdict for verdict, _ in answers)
            counts = [verdicts.pop(name, 0) for name in ("sound", "approximate", "wrong_model")]
            errors = np.concatenate([errors for _, errors in answers])
            fits = (
                "" if is_wrong else f"{np.sqrt(np.mean(errors**2)):6.2f} {100 * np.mean(np.abs(errors) < 1.96):7.1f} %"
            )
            print(
                f"{statement:10} {'wrong' if is_wrong else 'right':6} {counts[0]:6} {counts[1]:12} {counts[2]:12}"
                f" {sum(verdicts.values()):6} {fits}"
            )


if __name__ == "__main__":
    main()
