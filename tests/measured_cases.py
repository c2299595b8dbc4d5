"""A component that only its FRFs are known of, with a model of the rest: by the library, and as one dense model of all."""

import numpy as np

from structid import Beam, FrfRecord, MeasuredComponent, Spring, Structure
from structid.core.dof import parse_dofs

FREQUENCY = np.linspace(2.0, 120.0, 140)
NODES = {k: [0.3 * k, 0.0] for k in range(5)} | {11: [0.6, 0.1], 12: [1.2, 0.1]}
MOUNT, BENDING = np.array([3e4, 5e4]), 2e3
INSIDE = 6


def machine(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Mass and complex stiffness (8, 8) of a free chain of 8 masses, each joined to its next two; 0 and 5 are its interface."""
    rng = np.random.default_rng(seed)
    mass, stiffness = np.diag(rng.uniform(0.5, 2.0, INSIDE + 2)), np.zeros((INSIDE + 2,) * 2)
    for i in range(INSIDE + 2):
        for j in range(max(0, i - 2), i):
            pull = np.zeros(INSIDE + 2)
            pull[[i, j]] = 1.0, -1.0
            stiffness += rng.uniform(0.5, 2.0) * 1e5 * np.outer(pull, pull)
    return mass, stiffness * (1 + 0.05j)


def machine_receptance(frequency: np.ndarray = FREQUENCY) -> np.ndarray:
    """At its interface, (n_lines, 2, 2), m/N."""
    mass, stiffness = machine()
    s = 2j * np.pi * frequency[:, None, None]
    return np.linalg.inv(s**2 * mass + stiffness)[:, [[0], [5]], [0, 5]]


def beam_on_machine(components=None, mount=MOUNT, bending=BENDING, **others) -> Structure:
    """A cantilever with springs to nodes 11 and 12, which have nothing else."""
    if components is None:
        components = [MeasuredComponent("machine", ["11Y", "12Y"], FREQUENCY, machine_receptance())]
    return Structure(
        NODES,
        [
            Beam("beam", [[k, k + 1] for k in range(4)], mass=3.0, bending_stiffness=bending, loss_factor=0.02),
            Spring("mount", first=["2Y", "4Y"], second=["11Y", "12Y"], stiffness=mount, loss_factor=0.05),
        ],
        fixed=["0Y", "0RZ"],
        active=["Y", "RZ"],
        measured=components,
        **others,
    )


def dense_frf(bare: Structure, record: FrfRecord, ends=("11Y", "12Y")) -> np.ndarray:
    """Receptances of `bare`, which has no component, and the machine, all of its degrees of freedom beside the model's."""
    n = bare.n_dofs
    mass, stiffness, structural, viscous = (
        bare.matrix(law).toarray() for law in ("mass", "stiffness", "structural_damping", "damping")
    )
    place = np.zeros((INSIDE + 2, n + INSIDE))
    place[[0, 5], :n] = bare.selection(parse_dofs(ends)).toarray().T
    place[[i for i in range(INSIDE + 2) if i not in (0, 5)], n:] = np.eye(INSIDE)
    own_mass, own_stiffness = machine()
    whole = [place.T @ own @ place for own in (own_mass, own_stiffness)]
    whole[0][:n, :n] += mass
    whole[1][:n, :n] += stiffness + 1j * structural
    s = record.laplace[:, None, None]
    z = s**2 * whole[0] + whole[1]
    z[:, :n, :n] += s * viscous
    loads, sensors = (
        np.vstack([bare.selection(dofs).toarray(), np.zeros((INSIDE, len(dofs)))])
        for dofs in (record.inputs, record.outputs)
    )
    return sensors.T @ np.linalg.solve(z, loads[None])


def asked(outputs=("1Y", "3Y-", "11Y"), inputs=("3Y",), kind="receptance", frequency=FREQUENCY) -> FrfRecord:
    """A record of nothing yet: lines, sensors and loads."""
    return FrfRecord(frequency, np.ones((len(frequency), len(outputs), len(inputs))), outputs, inputs, kind)
