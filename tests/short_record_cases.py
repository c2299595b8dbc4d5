"""A chain of four masses and an exact time record of it that neither starts nor ends at rest."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from structid import Dashpot, Friction, PointMass, Spring, Structure, TimeRecord, Unknown, parameters
from structid.core.dof import parse_dofs

RATE, DURATION = 40.0, 20.0
SENSORS = ("4X", "2X")


def chain(friction=False):
    """Four masses in a row, 0.6 to 6.7 Hz, damping ratios below 1 %."""
    nodes = {i: float(i) for i in range(5)}
    here, back = [f"{i}X" for i in range(1, 5)], [f"{i}X" for i in range(4)]
    elements = [
        PointMass("m", [1, 2, 3, 4], 2.0),
        Spring("k", here, back, stiffness=1000.0),
        Dashpot("c", here, back, viscous_damping=0.7),
    ]
    if friction:
        elements.append(Friction("rail", "1X", friction_force=0.1))
    return Structure(nodes, elements, fixed=["0X"], active=["X"])


def unknowns(structure, **options):
    properties = (("mass", "m"), ("stiffness", "k"), ("viscous_damping", "c"))
    return parameters(structure, [Unknown(p, e, each=True, **options) for p, e in properties])


def multisine(rng, n_times, count=150):
    """Frequencies (Hz, none on the record's lines), amplitudes with phases, and the force at the samples."""
    frequency = rng.uniform(0.05, 12.0, count)
    amplitude = np.exp(2j * np.pi * rng.uniform(size=count))
    time = np.arange(n_times) / RATE
    return frequency, amplitude, (np.exp(2j * np.pi * np.outer(time, frequency)) @ amplitude).real


def exact_motion(structure, values, rng, n_times, initial=1.0):
    """Steady motion under a multisine plus a free decay of random state: exact at every sample."""
    mass, damping, stiffness = (structure.matrix(kind, values).toarray() for kind in ("mass", "damping", "stiffness"))
    n = len(mass)
    frequency, amplitude, force = multisine(rng, n_times)
    where = structure.selection(parse_dofs(["4X"])).toarray()[:, 0]
    omega = 2 * np.pi * frequency
    dynamic = -(omega[:, None, None] ** 2) * mass + 1j * omega[:, None, None] * damping + stiffness
    steady = np.linalg.solve(dynamic, np.broadcast_to(where[:, None], (len(omega), n, 1)))[:, :, 0] * amplitude[:, None]
    time = np.arange(n_times) / RATE
    turning = np.exp(1j * np.outer(time, omega))
    inverse = np.linalg.inv(mass)
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness, -inverse @ damping]])
    poles, vectors = linalg.eig(state)
    start = (
        initial
        * rng.standard_normal(2 * n)
        * np.repeat([np.abs(steady).sum(), np.abs(steady * omega[:, None]).sum()], n)
    )
    start *= 1 / np.sqrt(len(omega))
    free = (np.exp(np.outer(time, poles)) * np.linalg.solve(vectors, start)) @ vectors.T
    derivative = (np.exp(np.outer(time, poles)) * (poles * np.linalg.solve(vectors, start))) @ vectors.T
    displacement = (turning @ steady + free[:, :n]).real
    velocity = (turning @ (1j * omega[:, None] * steady) + free[:, n:]).real
    acceleration = (turning @ (-(omega[:, None] ** 2) * steady) + derivative[:, n:]).real
    return force, {"displacement": displacement, "velocity": velocity, "acceleration": acceleration}


def record(structure, values, rng, noise=0.01, force_noise=0.01, quantities=("acceleration",) * 2, initial=1.0):
    force, motion = exact_motion(structure, values, rng, round(RATE * DURATION), initial)
    pick = structure.selection(parse_dofs(SENSORS)).toarray()
    columns = [force, *(motion[q] @ pick[:, i] for i, q in enumerate(quantities))]
    table = np.column_stack(columns)
    std = np.array([force_noise, *[noise] * len(quantities)]) * np.sqrt((table**2).mean(axis=0))
    return TimeRecord(
        RATE,
        table + std * rng.standard_normal(table.shape),
        ("4X", *SENSORS),
        ("force", *quantities),
        variance=std**2,
    )


def chain_tables(mass, stiffness, damping):
    """The structure of `chain` as a study file has it, with other values."""
    return f"""\
[structure]
active = ["X"]
fixed = ["0X"]
[structure.nodes]
0 = 0.0
1 = 1.0
2 = 2.0
3 = 3.0
4 = 4.0
[[structure.point_mass]]
name = "m"
nodes = [1, 2, 3, 4]
mass = {mass}
[[structure.spring]]
name = "k"
first = ["1X", "2X", "3X", "4X"]
second = ["0X", "1X", "2X", "3X"]
stiffness = {stiffness}
[[structure.dashpot]]
name = "c"
first = ["1X", "2X", "3X", "4X"]
second = ["0X", "1X", "2X", "3X"]
viscous_damping = {damping}
"""
