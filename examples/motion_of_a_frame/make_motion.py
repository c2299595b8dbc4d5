"""Motion of every floor of a six-storey frame, as a camera would give it, and the force of a shaker with 1 % error."""

from pathlib import Path

import numpy as np

import structid as sid

HERE = Path(__file__).parent
#: What the study does not know, from the ground up: kg, N/m, N s/m.
MASS = np.array([410.0, 395.0, 400.0, 388.0, 402.0, 300.0])
STIFFNESS = np.array([2.1e6, 2.0e6, 1.5e6, 1.9e6, 1.8e6, 1.2e6])
DAMPING = np.array([900.0, 850.0, 1400.0, 800.0, 780.0, 500.0])
FLOORS = range(1, 7)
RATE, SAMPLES = 50.0, 250


def true_structure():
    """The frame as it is: floors that move along X, each tied to the one below."""
    below, above = [f"{floor - 1}X" for floor in FLOORS], [f"{floor}X" for floor in FLOORS]
    sets = [
        sid.PointMass("floor", list(FLOORS), MASS),
        sid.Spring("storey", below, above, stiffness=STIFFNESS),
        sid.Dashpot("damper", below, above, viscous_damping=DAMPING),
    ]
    return sid.Structure(dict.fromkeys(range(7), 0.0), sets, ["0X"], active=["X"])


def motion(structure, rng):
    """Steady motion under a force at the top and one at the second floor that repeat after the record."""
    mass, damping, stiffness = (structure.matrix(law).toarray() for law in ("mass", "damping", "stiffness"))
    lines = np.arange(1, 121)
    omega = 2 * np.pi * RATE / SAMPLES * lines
    spectrum = np.zeros((len(lines), 6), dtype=complex)
    spectrum[:, [1, 5]] = rng.standard_normal((len(lines), 2)) + 1j * rng.standard_normal((len(lines), 2))
    dynamic = stiffness - omega[:, None, None] ** 2 * mass + 1j * omega[:, None, None] * damping
    shape = np.linalg.solve(dynamic, 100.0 * spectrum[..., None])[..., 0]
    wave = np.exp(1j * np.outer(np.arange(SAMPLES) / RATE, omega))
    rates = (shape, 1j * omega[:, None] * shape, -(omega[:, None] ** 2) * shape, 100.0 * spectrum)
    return [np.real(wave @ part) for part in rates]


def main():
    """Writes motion.h5."""
    rng = np.random.default_rng(3)
    structure = true_structure()
    displacement, velocity, acceleration, force = motion(structure, rng)
    force += 0.01 * np.std(force[:, 5]) * rng.standard_normal(force.shape)
    values = np.concatenate([acceleration, velocity, displacement, force], axis=1)
    kinds = np.repeat(["acceleration", "velocity", "displacement", "force"], 6)
    record = sid.TimeRecord(RATE, values.astype(np.float32), structure.dofs * 4, tuple(kinds.tolist()))
    sid.write_record(HERE / "motion.h5", record)


if __name__ == "__main__":
    main()
