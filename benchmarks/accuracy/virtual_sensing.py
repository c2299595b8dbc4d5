"""Motion at places without a sensor under forces that nobody measured: does the stated deviation hold, and is it better than modes?

A beam on three supports (the matrices of `tolerances.py`) is pushed at two places by independent forces with a correlation time of
0.02 s; four accelerometers with 1 % noise are read, all other translations are sensed. The truth runs through a matrix exponential
with eight steps a sample, and through a filter against aliasing as records do. Each repeat draws the truth within the uncertainty
of the model. Beside it stands open modal expansion: least squares of the lowest modes at every sample.

    python benchmarks/accuracy/virtual_sensing.py [--repeats 20] [--seed 0] [--samples 3000]
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.linalg import eigh, expm
from scipy.signal import decimate, lfilter
from tolerances import Rig, beam, matrices

import structid as sid
from structid.prediction.identified_model import identified_model
from structid.prediction.sensing.sense import sense
from structid.prediction.sensing.state_equations import UnknownForces

RATE, CORRELATION, FORCE, STEPS = 600.0, 0.02, 5.0, 8
PUSHED, READ, MODES = ("3Y", "9Y"), ("2Y", "4Y", "8Y", "10Y"), 4
#: Relative deviations of the model: bending stiffnesses, and the loss factor.
STD = {
    "bending_stiffness[a]": 0.01,
    "bending_stiffness[b]": 0.01,
    "bending_stiffness[c]": 0.01,
    "loss_factor[all]": 0.1,
}


def random_force(rng: np.random.Generator, n: int, rate: float, correlation: float, size: float) -> np.ndarray:
    """A stationary force of a correlation time, s, and a standard deviation, N, at n samples."""
    fade = np.exp(-1 / rate / correlation)
    drive = np.sqrt(1 - fade**2) * rng.standard_normal(n)
    drive[0] = rng.standard_normal()
    return size * lfilter([1.0], [1.0, -fade], drive)


def moved_by(
    mass: np.ndarray, stiffness: np.ndarray, loss: float, pushed: list[int], force: np.ndarray, rate: float
) -> tuple[np.ndarray, np.ndarray]:
    """Displacements and accelerations (n, n_dofs) under forces (n, n_pushed) that run in straight lines between samples.

    Every mode up to half the sampling rate has a damping ratio of half the loss factor.
    """
    squares, shapes = eigh(stiffness, mass)
    slow = squares < (np.pi * rate) ** 2
    omega, shapes = np.sqrt(squares[slow]), shapes[:, slow]
    size, n_forces = len(omega), len(pushed)
    a = np.block([[np.zeros((size, size)), np.eye(size)], [-np.diag(omega**2), -np.diag(loss * omega)]])
    b = np.vstack([np.zeros((size, n_forces)), shapes[pushed].T])
    wide = np.zeros((2 * size + 2 * n_forces,) * 2)
    wide[: 2 * size, : 2 * size], wide[: 2 * size, 2 * size : -n_forces] = a / rate, b / rate
    wide[2 * size : -n_forces, -n_forces:] = np.eye(n_forces)
    step = expm(wide)[: 2 * size]
    drive = np.hstack([force[:-1], np.diff(force, axis=0)]) @ step[:, 2 * size :].T
    transition, states = step[:, : 2 * size], np.zeros((len(force), 2 * size))
    for i in range(len(force) - 1):
        states[i + 1] = transition @ states[i] + drive[i]
    return states[:, :size] @ shapes.T, (states @ a.T + force @ b.T)[:, size:] @ shapes.T


def sampled(values: np.ndarray) -> np.ndarray:
    """Every eighth sample, behind a filter against aliasing."""
    return decimate(values, STEPS, ftype="fir", axis=0)


def simulate(
    rig: Rig, values: dict[str, float], rng: np.random.Generator, n: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Displacements, accelerations and forces at the samples."""
    m, k, _ = matrices(rig, values)
    fine = RATE * STEPS
    force = np.column_stack([random_force(rng, n * STEPS, fine, CORRELATION, FORCE) for _ in PUSHED])
    moved, accelerated = moved_by(m, k.real, values["loss"], [rig.index(d) for d in PUSHED], force, fine)
    return sampled(moved), sampled(accelerated), sampled(force)


def expanded(rig: Rig, measured: np.ndarray, wanted: list[int]) -> np.ndarray:
    """Open modal expansion of accelerations with the nominal modes."""
    m, k, _ = matrices(rig, {part.name: part.value for part in rig.parts} | rig.losses)
    shapes = eigh(k.real, m)[1][:, :MODES]
    amplitudes = np.linalg.lstsq(shapes[[rig.index(d) for d in READ]], measured.T, rcond=None)[0]
    return (shapes[wanted] @ amplitudes).T


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--samples", type=int, default=3000)
    chosen = parser.parse_args()
    rig = beam(False)
    parameters = sid.parameters(rig.structure, rig.unknown)
    sizes = np.array([STD[name] for name in parameters.names]) * parameters.start
    model = identified_model(rig.structure, parameters, parameters.start, np.diag(sizes**2))
    outputs = [d for d in rig.dofs if d.endswith("Y") and d not in READ]
    wanted = [rig.index(d) for d in outputs]
    squares = {"acceleration": [], "displacement": [], "force": []}
    errors, held = {"sensed": [], "expanded": []}, []
    for seed in range(chosen.seed, chosen.seed + chosen.repeats):
        rng = np.random.default_rng(seed)
        values = {part.name: part.value for part in rig.parts} | rig.losses
        factors = 1 + np.array(list(STD.values())) * rng.standard_normal(len(STD))
        for name, factor in zip(STD, factors, strict=True):
            values["loss" if name.startswith("loss") else name] *= factor
        moved, accelerated, force = simulate(rig, values, rng, chosen.samples)
        measured = accelerated[:, [rig.index(d) for d in READ]]
        noise = 0.01 * measured.std(axis=0)
        measured = measured + noise * rng.standard_normal(measured.shape)
        record = sid.TimeRecord(RATE, measured, READ, ("acceleration",) * len(READ), variance=noise**2)
        settled = slice(int(0.3 * RATE), -STEPS)  # the filter of the truth has no samples behind the last ones
        for motion, true in (("acceleration", accelerated), ("displacement", moved)):
            told = sense(model, record, outputs, motion, UnknownForces(PUSHED, CORRELATION, FORCE), seed=seed)
            squares[motion].append((((told.values - true[:, wanted]) / told.std)[settled] ** 2).mean())
            if motion == "acceleration":
                size = accelerated[settled][:, wanted].std()
                errors["sensed"].append((told.values - true[:, wanted])[settled].std() / size)
                errors["expanded"].append((expanded(rig, measured, wanted) - true[:, wanted])[settled].std() / size)
                z = ((told.forces - force) / told.force_std)[settled]
                squares["force"].append((z**2).mean())
                held.append((np.abs(z) < 1.96).mean())
    print(
        f"{chosen.repeats} repeats from seed {chosen.seed}, {chosen.samples} samples, {len(READ)} sensors, {len(outputs)} places"
    )
    for what, parts in squares.items():
        print(f"{what:13s} root mean square of error over stated deviation {np.sqrt(np.mean(parts)):.2f}")
    print(f"force         inside the 95 % band {100 * np.mean(held):.1f} %")
    print(
        "error of accelerations: "
        + ", ".join(f"{name} {100 * np.median(parts):.1f} %" for name, parts in errors.items())
    )


if __name__ == "__main__":
    main()
