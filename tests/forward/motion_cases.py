"""Structures and exact motions for the tests of identification from motion."""

import numpy as np

from structid import Beam, Dashpot, SpaceBeam, Structure, Unknown
from structid.dynamics import sampled_transient
from structid.forward import Motion


def moved(structure, seed=0, n=60, rate=20.0, loads=(0, 3)):
    """Exact motion under random loads at some degrees of freedom."""
    rng = np.random.default_rng(seed)
    where = np.eye(structure.n_dofs)[:, [i % structure.n_dofs for i in loads]]
    signals = rng.standard_normal((n, len(loads)))
    matrices = [structure.matrix(kind) for kind in ("mass", "stiffness", "damping")]
    found = sampled_transient(*matrices[:2], where, signals, rate, matrices[2])
    return Motion(found.time, signals @ where.T, found.acceleration, found.velocity, found.displacement)


def cantilever(n=4):
    rng = np.random.default_rng(1)
    mass, bending, c, k = rng.uniform(0.5, 2.0, (4, n))
    beam = Beam(
        "beam", [[i, i + 1] for i in range(n)], mass, 10 * bending, mass_damping=0.1 * c, stiffness_damping=0.2 * k
    )
    return Structure({i: float(i) for i in range(n + 1)}, [beam], ["0Y", "0RZ"])


EVERYTHING = [Unknown(p, "beam", each=True) for p in ("mass", "bending_stiffness", "mass_damping", "stiffness_damping")]


def frame():
    """A portal of space beams on four feet, eight beams with seven properties each, and a dashpot."""
    feet = {1: (0, 0, 0), 2: (2, 0, 0), 3: (2, 1.5, 0), 4: (0, 1.5, 0)}
    top = {i + 4: (*p[:2], 3.0) for i, p in feet.items()}
    rng = np.random.default_rng(2)

    def spread(value):
        return value * rng.uniform(0.7, 1.4, 8)

    members = SpaceBeam(
        "frame",
        [[1, 5], [2, 6], [3, 7], [4, 8], [5, 6], [6, 7], [7, 8], [8, 5]],
        spread(8.0), spread(4e4), spread(9e4), spread(2e7), spread(3e4), spread(0.02),
        mass_damping=spread(3.0),
    )  # fmt: skip
    damper = Dashpot("damper", "5X", "7X", viscous_damping=120.0)
    fixed = [f"{i}{d}" for i in feet for d in ("X", "Y", "Z", "RX", "RY", "RZ")]
    return Structure(feet | top, [members, damper], fixed)


def free_beam():
    beam = Beam("beam", [[0, 1], [1, 2]], [2.0, 3.0], [5.0, 4.0])
    return Structure({0: 0.0, 1: 1.0, 2: 2.0}, [beam])
