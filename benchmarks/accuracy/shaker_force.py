"""The force of a shaker on a plate from eight accelerometers: is it inside its band, and are forces that no sensor sees named?

A clamped plate, whose modulus and loss factor are known within 1 and 10 %, is shaken at one node by a force that nobody measures:
one of a stated correlation time, then noise of a shaker between 20 and 180 Hz, which the smoother does not know. Its size is the
likeliest one. The truth is drawn within the uncertainty and runs through a matrix exponential at eight steps a sample and a filter
against aliasing. Then sensors stand on the axis of symmetry, with forces on both sides: only their sum moves a sensor.

    python benchmarks/accuracy/shaker_force.py [--repeats 10] [--seed 0] [--samples 2000]
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.signal import butter, sosfilt
from virtual_sensing import STEPS, moved_by, random_force, sampled

import structid as sid
from structid.prediction.identified_model import IdentifiedModel, identified_model
from structid.prediction.sensing.sense import SensedMotion, sense
from structid.prediction.sensing.state_equations import UnknownForces

RATE, CORRELATION, FORCE = 1000.0, 2e-3, 10.0
COLUMNS, ROWS = 8, 6
SHAKER, MIRRORED = "22Z", ("20Z", "24Z")
SENSORS = ("11Z", "15Z", "20Z", "24Z", "31Z", "39Z", "43Z", "50Z")
ON_AXIS = ("13Z", "22Z", "31Z", "40Z", "49Z")


def plate() -> IdentifiedModel:
    """An aluminium plate of 0.6 m by 0.5 m by 3 mm, clamped all round."""
    nodes = {
        j * (COLUMNS + 1) + i: [0.6 * i / COLUMNS, 0.5 * j / ROWS] for j in range(ROWS + 1) for i in range(COLUMNS + 1)
    }
    corners = np.array([0, 1, COLUMNS + 2, COLUMNS + 1])
    cells = [(j * (COLUMNS + 1) + i + corners).tolist() for j in range(ROWS) for i in range(COLUMNS)]
    skin = sid.Plate("skin", cells, density=2700.0, youngs_modulus=7e10, thickness=3e-3, poisson=0.33, loss_factor=0.02)
    rim = [node for node, (x, y) in nodes.items() if x in (0.0, 0.6) or y in (0.0, 0.5)]
    structure = sid.Structure(nodes, [skin], fixed=[f"{node}{d}" for node in rim for d in ("Z", "RX", "RY")])
    unknown = [sid.Unknown("youngs_modulus", "skin"), sid.Unknown("loss_factor", "skin")]
    parameters = sid.parameters(structure, unknown)
    return identified_model(structure, parameters, parameters.start, np.diag((parameters.start * [0.01, 0.1]) ** 2))


def shaken(
    model: IdentifiedModel, dofs: tuple[str, ...], force: np.ndarray, sensors: tuple[str, ...], rng: np.random.Generator
) -> sid.TimeRecord:
    """A record of accelerations with 1 % noise, of a plate drawn within the uncertainty."""
    [physical] = model.draw_parameters(1, rng)
    structure, values = model.structure, model.parameters.values(physical)
    mass, stiffness = (structure.matrix(kind, values).toarray() for kind in ("mass", "stiffness"))
    names = [str(dof.unsigned).rstrip("+") for dof in structure.dofs]
    index = [names.index(name) for name in dofs]
    _, accelerated = moved_by(mass, stiffness, physical[1], index, force, RATE * STEPS)
    read = sampled(accelerated[:, [names.index(name) for name in sensors]])
    noise = 0.01 * read.std(axis=0)
    read = read + noise * rng.standard_normal(read.shape)
    return sid.TimeRecord(RATE, read, sensors, ("acceleration",) * len(sensors), variance=noise**2)


def sense_forces(model: IdentifiedModel, record: sid.TimeRecord, dofs: tuple[str, ...], seed: int) -> SensedMotion:
    return sense(model, record, ["21Z"], "acceleration", UnknownForces(dofs, CORRELATION), seed=seed)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--samples", type=int, default=2000)
    chosen = parser.parse_args()
    model, n = plate(), chosen.samples * STEPS
    band = butter(4, (20.0, 180.0), "bandpass", fs=RATE * STEPS, output="sos")
    print(
        f"{model.structure.n_dofs} degrees of freedom, {len(SENSORS)} accelerometers, {chosen.repeats} repeats from seed"
        f" {chosen.seed}"
    )
    for words in ("correlation time as stated", "noise from 20 to 180 Hz"):
        z, errors = [], []
        for seed in range(chosen.seed, chosen.seed + chosen.repeats):
            rng = np.random.default_rng(seed)
            force = random_force(rng, n, RATE * STEPS, CORRELATION, FORCE)
            if words.startswith("noise"):
                force = sosfilt(band, rng.standard_normal(n))
                force *= FORCE / force.std()
            told = sense_forces(model, shaken(model, (SHAKER,), force[:, None], SENSORS, rng), (SHAKER,), seed)
            settled = slice(int(0.3 * RATE), -2 * STEPS)
            error = (told.forces[:, 0] - sampled(force))[settled]
            z.append(error / told.force_std[settled, 0])
            errors.append(error.std() / sampled(force).std())
        whole = np.concatenate(z)
        print(
            f"{words}: inside the 95 % band {100 * np.mean(np.abs(whole) < 1.96):.1f} %, root mean square of error over stated"
            f" deviation {np.sqrt(np.mean(whole**2)):.2f}, error {100 * np.median(errors):.1f} % of the force"
        )
    rng = np.random.default_rng(chosen.seed)
    forces = np.column_stack([random_force(rng, n, RATE * STEPS, CORRELATION, FORCE) for _ in MIRRORED])
    told = sense_forces(model, shaken(model, MIRRORED, forces, ON_AXIS, rng), MIRRORED, chosen.seed)
    print(
        f"forces at {' and '.join(MIRRORED)}, sensors on the axis between them: {'; '.join(told.words) or 'nothing named'}"
    )


if __name__ == "__main__":
    main()
