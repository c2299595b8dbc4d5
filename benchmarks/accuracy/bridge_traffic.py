"""Motion of a bridge under unknown traffic: do stated deviations hold at twenty places without a sensor, and does it beat modes?

A girder over three spans carries lorries that come at random: axles that move, each with a static load and a dynamic part between
2 and 12 Hz. Six accelerometers with 1 % noise are read. The forces are unknown; the smoother is told that they act at every node
of the deck, or at five or seven, and must find their correlation time and size. The truth has its own matrices, drawn within the
uncertainty of the model, eight steps a sample and a filter against aliasing. Beside it stands open modal expansion: least squares
of the lowest modes at every sample, with the number of modes that is best in hindsight.

    python benchmarks/accuracy/bridge_traffic.py [--repeats 5] [--seed 0] [--seconds 20] [--forces everywhere]
        [--motions acceleration displacement]
"""

from __future__ import annotations

import argparse
import os
from collections import defaultdict
from itertools import pairwise

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.linalg import eigh
from scipy.signal import butter, sosfilt
from tolerances import beam_matrices
from virtual_sensing import STEPS, moved_by, sampled

import structid as sid
from structid.prediction.identified_model import IdentifiedModel, identified_model
from structid.prediction.sensing.sense import SensedMotion, sense
from structid.prediction.sensing.state_equations import UnknownForces

RATE = 100.0
#: Frequency, Hz, below which accelerometers tell less than half of a displacement here.
SLOW = 0.14
SPANS, LENGTH = (9, 11, 9), 3.0
STIFFNESS, MASS, LOSS = 4e10, 9e3, 0.03
SENSORS = ("3Y", "7Y", "12Y", "17Y", "22Y", "26Y")
FORCES = {
    "five": ("4Y", "12Y", "15Y", "18Y", "25Y"),
    "seven": ("2Y", "5Y", "12Y", "15Y", "18Y", "22Y", "25Y"),
    "everywhere": tuple(f"{i}Y" for i in range(30) if i not in np.cumsum([0, *SPANS])),
}
#: Relative deviations: of the bending stiffness of each span, and of the loss factor.
STD = (0.01, 0.01, 0.01, 0.1)
#: Lorries a second; m/s; N of each axle and m behind the first; dynamic part of an axle load.
ARRIVALS, SPEED, AXLES, DYNAMIC = 0.15, (18.0, 26.0), ((60e3, 0.0), (100e3, 4.5), (90e3, 5.8)), 0.15


def bridge() -> IdentifiedModel:
    """The model: three bending stiffnesses and a loss factor, known within a few percent."""
    ends = np.cumsum([0, *SPANS])
    nodes = {i: [LENGTH * i, 0.0] for i in range(ends[-1] + 1)}
    spans = [
        sid.Beam(
            f"span {k}", [[i, i + 1] for i in range(*between)], mass=MASS, bending_stiffness=STIFFNESS, loss_factor=LOSS
        )
        for k, between in enumerate(pairwise(ends), 1)
    ]
    structure = sid.Structure(nodes, spans, fixed=[f"{i}Y" for i in ends], active=["Y", "RZ"])
    unknown = [sid.Unknown("bending_stiffness", span.name) for span in spans]
    unknown.append(sid.Unknown("loss_factor", [span.name for span in spans], name="all"))
    parameters = sid.parameters(structure, unknown)
    return identified_model(structure, parameters, parameters.start, np.diag((np.array(STD) * parameters.start) ** 2))


def true_matrices(factors: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Mass and stiffness (n_dofs, n_dofs) and names of the free degrees of freedom; `factors` (3,) scale the spans' stiffness."""
    ends = np.cumsum([0, *SPANS])
    names = [f"{i}{d}" for i in range(ends[-1] + 1) for d in ("Y", "RZ")]
    k_unit, m_unit = beam_matrices(LENGTH)
    mass, stiffness = np.zeros((2, len(names), len(names)))
    for i in range(ends[-1]):
        part = slice(2 * i, 2 * i + 4)
        mass[part, part] += MASS * m_unit
        stiffness[part, part] += STIFFNESS * factors[np.searchsorted(ends, i, side="right") - 1] * k_unit
    free = [i for i, name in enumerate(names) if name not in {f"{end}Y" for end in ends}]
    return mass[np.ix_(free, free)], stiffness[np.ix_(free, free)], [names[i] for i in free]


def traffic(n: int, rate: float, rng: np.random.Generator) -> np.ndarray:
    """Vertical forces (n, n_nodes), N, at every node under lorries that come at random; axles between two nodes load both."""
    n_nodes, time = sum(SPANS) + 1, np.arange(n) / rate
    forces, rough = np.zeros((n, n_nodes)), butter(2, (2.0, 12.0), "bandpass", fs=rate, output="sos")
    for arrival in np.cumsum(rng.exponential(1 / ARRIVALS, int(3 * ARRIVALS * time[-1]) + 20)) - 5.0:
        speed, load = rng.uniform(*SPEED), rng.uniform(0.4, 1.2)
        for axle, behind in AXLES:
            dynamic = sosfilt(rough, rng.standard_normal(n))
            place = (speed * (time - arrival) - behind) / LENGTH
            on = np.flatnonzero((place >= 0) & (place < n_nodes - 1))
            force = -load * axle * (1 + DYNAMIC * dynamic[on] / dynamic.std())
            node = place[on].astype(int)
            forces[on, node] += force * (1 - place[on] + node)
            forces[on, node + 1] += force * (place[on] - node)
    return forces


def expanded(measured: np.ndarray, names: list[str], wanted: list[int], n_modes: int) -> np.ndarray:
    """Open modal expansion (n_times, n_wanted) of measured motions by the lowest modes of the nominal bridge."""
    mass, stiffness, _ = true_matrices(np.ones(3))
    shapes = eigh(stiffness, mass)[1][:, :n_modes]
    amplitudes = np.linalg.lstsq(shapes[[names.index(s) for s in SENSORS]], measured.T, rcond=None)[0]
    return (shapes[wanted] @ amplitudes).T


def record_of(accelerations: np.ndarray, rng: np.random.Generator) -> sid.TimeRecord:
    noise = 0.01 * accelerations.std(axis=0)
    noisy = accelerations + noise * rng.standard_normal(accelerations.shape)
    return sid.TimeRecord(RATE, noisy, SENSORS, ["acceleration"] * len(SENSORS), variance=noise**2)


def slow_parts(error: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Of histories (n_times, n): part of the power of the error in its mean, and up to `SLOW` Hz; error over truth up to there."""
    frequency = np.fft.rfftfreq(len(error), 1 / RATE)
    weights = np.where(frequency > 0, 2.0, 1.0)[:, None]
    of_error, of_true = (weights * np.abs(np.fft.rfft(values, axis=0)) ** 2 for values in (error, true))
    slow = frequency <= SLOW
    whole, below = of_error.sum(), of_error[slow].sum()
    return np.array([of_error[0].sum() / whole, below / whole, np.sqrt(below / of_true[slow].sum())])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--motions", nargs="+", default=["acceleration"], choices=["acceleration", "displacement"])
    parser.add_argument("--forces", default="everywhere", choices=list(FORCES))
    chosen = parser.parse_args()
    model, n = bridge(), int(chosen.seconds * RATE)
    squares, errors, explained = defaultdict(list), defaultdict(list), 0
    words: dict[str, int] = defaultdict(int)
    slow: list[np.ndarray] = []
    for seed in range(chosen.seed, chosen.seed + chosen.repeats):
        rng = np.random.default_rng(seed)
        factors = 1 + np.array(STD) * rng.standard_normal(len(STD))
        mass, stiffness, names = true_matrices(factors[:3])
        vertical = [i for i, name in enumerate(names) if name.endswith("Y")]
        outputs = [names[i] for i in vertical if names[i] not in SENSORS]
        wanted = [names.index(name) for name in outputs]
        forces = traffic(n * STEPS, RATE * STEPS, rng)[:, [int(names[i][:-1]) for i in vertical]]
        moved, accelerated = map(sampled, moved_by(mass, stiffness, LOSS * factors[3], vertical, forces, RATE * STEPS))
        record = record_of(accelerated[:, [names.index(name) for name in SENSORS]], rng)
        middle = slice(2 * STEPS, -2 * STEPS)
        for motion in chosen.motions:
            true = accelerated if motion == "acceleration" else moved
            told: SensedMotion = sense(model, record, outputs, motion, UnknownForces(FORCES[chosen.forces]), seed=seed)
            error, size = (told.values - true[:, wanted])[middle], true[middle][:, wanted].std()
            squares[motion].append((error / told.std[middle]) ** 2)
            errors[motion].append(error.std() / size)
            if motion == "displacement":
                slow.append(slow_parts(told.values - true[:, wanted], true[:, wanted]))
            if motion == "acceleration":
                explained += told.is_explained
                for sentence in (told.contradiction, *told.words):
                    words[sentence] += bool(sentence)
                for n_modes in range(2, len(SENSORS) + 1):
                    left = expanded(record.values, names, wanted, n_modes) - true[:, wanted]
                    errors[f"expanded by {n_modes} modes"].append(left[middle].std() / size)
    print(
        f"{chosen.repeats} repeats from seed {chosen.seed}, {chosen.seconds:g} s, {len(SENSORS)} sensors, {len(outputs)} places,"
        f" forces at {len(FORCES[chosen.forces])} nodes; model said to explain {explained} of them"
    )
    for motion, parts in squares.items():
        inside = 100 * np.mean([(part < 1.96**2).mean() for part in parts])
        each = np.sqrt([part.mean() for part in parts])
        print(
            f"{motion}: root mean square of error over stated deviation {np.sqrt(np.mean([part.mean() for part in parts])):.2f}"
            f" (records {each.min():.2f} to {each.max():.2f}), inside the 95 % band {inside:.1f} %,"
            f" error {100 * np.median(errors[motion]):.1f} % of the motion"
        )
    if slow:
        of_mean, below, ratio = np.mean(slow, axis=0)
        print(
            f"displacements: {100 * of_mean:.0f} % of the power of the error is in its mean, {100 * below:.0f} % up to {SLOW} Hz,"
            f" where the error is {ratio:.2f} of the motion"
        )
    expansions = [(np.median(parts), name) for name, parts in errors.items() if name.startswith("expanded")]
    for size, name in sorted(expansions)[:1]:
        print(f"accelerations, error of the best open modal expansion: {name}, {100 * size:.1f} %")
    for sentence, count in words.items():
        if count:
            print(f"{count} times: {sentence}")


if __name__ == "__main__":
    main()
