"""Do 95 % bands of predictions at places without a sensor hold the truth? Noise and wrong fixed values, many times.

The structures, their truths and their FRFs are those of `tolerances.py`, by its own matrices. Each repeat draws fixed values and
noise anew, identifies, and predicts: accelerances at degrees of freedom that no sensor reads, natural frequencies, the change of
frequencies and accelerances by a mass that is added, and (of the chain) the largest displacements under a half-sine push, whose
truth comes from a matrix exponential.

    python benchmarks/accuracy/predictions.py [--repeats 100] [--seed 0] [--tolerance 0.01] [--only chain]
"""

from __future__ import annotations

import argparse
import os
import time
from collections import defaultdict
from itertools import pairwise

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.linalg import eigh, expm
from tolerances import DAMPING, RIGS, Rig, frf_setup, matrices, truth

import structid as sid
from structid.prediction.changes import AddMass
from structid.prediction.predict import predict, predict_change
from structid.prediction.quantities import Frf, History, Maxima, NaturalModes
from structid.unknowns.tolerances import Tolerances

UNSEEN = {
    "chain": ("2X", "5X"),
    "cantilever": ("5Y", "12Y"),
    "beam on three supports": ("3Y", "8Y"),
    "frame": ("8X", "5Y"),
}
LOADED = {"chain": 4, "cantilever": 10, "beam on three supports": 7, "frame": 6}


def true_frf(rig: Rig, m, k, c, frequency: np.ndarray, outputs) -> np.ndarray:
    s = 2j * np.pi * frequency
    z = s[:, None, None] ** 2 * m + s[:, None, None] * c + k
    unit = np.zeros((len(rig.dofs), 1))
    unit[rig.index(rig.load)] = 1.0
    motion = np.linalg.solve(z, np.broadcast_to(unit, (len(s), *unit.shape)))
    return (s**2)[:, None, None] * motion[:, [rig.index(d) for d in outputs]]


def true_maxima(rig: Rig, m, k, c, force: np.ndarray, rate: float, outputs) -> np.ndarray:
    n = len(m)
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(m, k.real), -np.linalg.solve(m, c)]])
    b = np.concatenate([np.zeros(n), np.linalg.solve(m, np.eye(n)[rig.index(rig.load)])])
    whole = np.zeros((2 * n + 2, 2 * n + 2))
    whole[: 2 * n, : 2 * n], whole[: 2 * n, 2 * n], whole[2 * n, 2 * n + 1] = a / rate, b / rate, 1.0
    step = expm(whole)
    state, most = np.zeros(2 * n), np.zeros(len(outputs))
    for first, second in pairwise(force):
        state = (
            step[: 2 * n, : 2 * n] @ state + step[: 2 * n, 2 * n] * first + step[: 2 * n, 2 * n + 1] * (second - first)
        )
        most = np.maximum(most, np.abs(state[[rig.index(d) for d in outputs]]))
    return most


def with_mass(rig: Rig, m: np.ndarray, node: int, mass: float) -> np.ndarray:
    changed = np.array(m)
    for direction in "XYZ":
        if f"{node}{direction}" in rig.dofs:
            i = rig.index(f"{node}{direction}")
            changed[i, i] += mass
    return changed


def repeat(rig: Rig, tolerance: float, seed: int, inside: dict[str, list[np.ndarray]]) -> None:
    values, _, gain = truth(rig, np.random.default_rng(seed), tolerance)
    options = sid.IdentifyOptions(tolerances=Tolerances(tolerance, tolerance, DAMPING, tolerance))
    found = sid.identify_together([frf_setup(rig, values, gain, np.random.default_rng(seed + 10_000), 0.01)], options)
    m, k, c = matrices(rig, values)
    frequency, outputs = np.linspace(*rig.band, 120), UNSEEN[rig.name]
    node, mass = LOADED[rig.name], 0.05 * rig.structure.mass_of()
    heavy = with_mass(rig, m, node, mass)

    def hertz(m: np.ndarray) -> np.ndarray:
        return np.sqrt(eigh(k.real, m, eigvals_only=True)[:3]) / (2 * np.pi)

    def put(what: str, predicted, true: np.ndarray) -> None:
        inside[what].append(((predicted.low <= true) & (true <= predicted.high)).ravel())

    quantity = Frf(outputs, [rig.load], frequency)
    changed = predict_change(found, quantity, [AddMass(node, mass)], seed=seed)
    before, after = (np.abs(true_frf(rig, each, k, c, frequency, outputs)) for each in (m, heavy))
    put("frf", changed.before, before)
    put("frf + mass", changed.after, after)
    put("frf change", changed.difference, after - before)
    changed = predict_change(found, NaturalModes(3), [AddMass(node, mass)], seed=seed)
    for what, predicted, true in (
        ("hertz", changed.before, hertz(m)),
        ("hertz + mass", changed.after, hertz(heavy)),
        ("hertz change", changed.difference, hertz(heavy) - hertz(m)),
    ):
        inside[what].append((predicted.low[:, 0] <= true) & (true <= predicted.high[:, 0]))
    if rig.name == "chain":
        rate = 20 * rig.band[1]
        at = np.arange(800) / rate
        force = 100 * np.where(at < 0.02, np.sin(np.pi * at / 0.02), 0.0)
        history = History(outputs, [rig.load], force[:, None], rate, "displacement")
        put("maxima", predict(found, Maxima(history), seed=seed), true_maxima(rig, m, k, c, force, rate, outputs))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tolerance", type=float, default=0.01)
    parser.add_argument("--only", nargs="+", default=list(RIGS), choices=list(RIGS))
    chosen = parser.parse_args()
    print(
        f"inside the 95 % band, %; {chosen.repeats} repeats from seed {chosen.seed}, fixed values off by {chosen.tolerance:g}"
    )
    whole: dict[str, list[np.ndarray]] = defaultdict(list)
    for name in chosen.only:
        inside: dict[str, list[np.ndarray]] = defaultdict(list)
        begun = time.process_time()
        for seed in range(chosen.seed, chosen.seed + chosen.repeats):
            repeat(RIGS[name](), chosen.tolerance, seed, inside)
        each = (time.process_time() - begun) / chosen.repeats
        print_row(name, inside, f"{each:.2f} s each")
        for what, parts in inside.items():
            whole[what] += parts
    print_row("all", whole, "")


def print_row(name: str, inside: dict[str, list[np.ndarray]], words: str) -> None:
    cells = "  ".join(f"{what} {100 * np.concatenate(parts).mean():.1f}" for what, parts in inside.items())
    print(f"{name:24s} {cells}  {words}", flush=True)


if __name__ == "__main__":
    main()
