"""Whether the error bars of expanded shapes hold: 10 sensors on a model of 2,000 degrees of freedom, repeated simulation.

The truth is the model with its stiffness in error between all its modes, as `expand` states it, and the measurement has
noise; counted is how often the true value lies within 1.96 standard deviations. Run: python
benchmarks/accuracy/expanded_shapes.py
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse

from structid import SpaceBeam, Structure
from structid.compare.mode_correlation import expand
from structid.core.arrays import FloatArray
from structid.core.dof import DIRECTIONS, Dof
from structid.dynamics import Modes
from structid.dynamics.normal_modes import modes


@dataclass(frozen=True, eq=False)
class Model:
    """Matrices and modes of a model, and sensors on it."""

    mass: sparse.csc_array
    stiffness: sparse.csc_array
    modes: Modes
    sensors: sparse.csc_array


def grid(n_x: int, n_y: int, n_sensors: int, n_modes: int, seed: int = 0) -> Model:
    """A grid of beams in a plane, held at its corners, with vertical sensors."""
    nodes = {1 + i + n_x * j: (0.5 * i, 0.5 * j, 0.0) for j in range(n_y) for i in range(n_x)}
    pairs = [(1 + i + n_x * j, 2 + i + n_x * j) for j in range(n_y) for i in range(n_x - 1)]
    pairs += [(1 + i + n_x * j, 1 + i + n_x * (j + 1)) for j in range(n_y - 1) for i in range(n_x)]
    beams = SpaceBeam(
        "beams", pairs, mass=12.0, bending_stiffness_y=2e7, bending_stiffness_z=2e5, axial_stiffness=4e8,
        torsional_stiffness=2e5, polar_inertia=0.05, orientation=(0.0, 0.0, 1.0),
    )  # fmt: skip
    corners = [1, n_x, 1 + n_x * (n_y - 1), n_x * n_y]
    structure = Structure(nodes, [beams], [Dof(node, d) for node in corners for d in DIRECTIONS])
    rng = np.random.default_rng(seed)
    free = [node for node in nodes if node not in corners]
    sensors = structure.selection([Dof(int(n), "Z") for n in rng.choice(free, n_sensors, replace=False)])
    mass, stiffness = structure.matrix("mass"), structure.matrix("stiffness")
    return Model(mass, stiffness, modes(mass, stiffness, n_modes=n_modes), sensors)


def wrong(model: Model, error: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Frequencies (Hz) and shapes of the model with K + dK, phi_j' dK phi_r = error omega_j omega_r times a normal number."""
    omega = 2 * np.pi * model.modes.frequency
    draw = rng.standard_normal((len(omega), len(omega)))
    change = error * np.outer(omega, omega) * (np.tril(draw) + np.tril(draw, -1).T)
    values, turn = linalg.eigh(np.diag(omega**2) + change)
    own = np.abs(turn).argmax(axis=1)  # of each mode of the model the true one that it is most of
    return np.sqrt(values[own]) / (2 * np.pi), model.modes.mode_shapes @ turn[:, own]


def coverage(
    model: Model, n_shapes: int, noise: float, error: float, is_dynamic: bool, repeats: int, seed: int
) -> tuple[float, float]:
    """Part of all values within 1.96 standard deviations, and the median deviation in parts of the largest entry.

    `noise` is in parts of the largest measured entry of each shape.
    """
    rng = np.random.default_rng(seed)
    inside, deviation = [], []
    bases = [tuple(sorted(range(n_shapes), key=lambda k, r=r: abs(k - r))) for r in range(n_shapes)]
    for _ in range(repeats):
        frequency, truth = wrong(model, error, rng)
        true = truth[:, :n_shapes]
        at = model.sensors.T @ true
        true, at = true / np.abs(at).max(axis=0), at / np.abs(at).max(axis=0)
        found = expand(
            at + noise * rng.standard_normal(at.shape), frequency[:n_shapes], model.sensors, model.modes, bases,
            shape_std=np.full(at.shape, noise), model_error=error,
            dynamic=(model.mass, model.stiffness) if is_dynamic else None,
        )  # fmt: skip
        moving = np.abs(true) > 1e-6 * np.abs(true).max(axis=0)
        inside.append((np.abs(found.shapes - true) <= 1.96 * found.std)[moving].mean())
        deviation.append(np.median((found.std / np.abs(true).max(axis=0))[moving]))
    return float(np.mean(inside)), float(np.mean(deviation))


def main() -> None:
    """Print a row a case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--nodes", type=int, nargs=2, default=(26, 13), help="nodes along and across the grid")
    chosen = parser.parse_args()
    model = grid(*chosen.nodes, 10, 60)
    print(f"{model.mass.shape[0]} degrees of freedom, 10 sensors, 4 shapes, {chosen.repeats} repeats")
    for word, is_dynamic in (("SEREP", False), ("dynamic", True)):
        for noise, error in ((0.02, 0.0), (0.02, 0.01), (0.001, 0.01), (0.02, 0.02), (0.001, 0.02), (0.001, 0.03)):
            if is_dynamic and error == 0:
                continue
            found, std = coverage(model, 4, noise, error, is_dynamic, chosen.repeats, 1)
            print(
                f"{word}: noise {100 * noise:g} %, error of the model {100 * error:g} %: {100 * found:.1f} % of the 95 % intervals"
                f" hold the truth, median deviation {100 * std:.2g} % of the largest entry"
            )


if __name__ == "__main__":
    main()
