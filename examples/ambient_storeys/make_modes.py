"""Modes of a four-storey frame from twenty minutes of simulated ambient motion, with their covariance."""

from pathlib import Path

import numpy as np
from scipy import linalg

from structid import TimeRecord, identify_modes
from structid.modal.formats.files import write_modes

MASS = np.array([5000.0, 5000.0, 5000.0, 4200.0])
STIFFNESS = np.array([2.4e6, 2.0e6, 1.5e6, 1.1e6])
DAMPING_RATIO = 0.01
RATE, DURATION = 25.0, 1200.0
SENSORS = {"1X": 0, "2X": 1, "4X": 3}


def matrices():
    """Mass, damping and stiffness; damping is the same ratio in every mode."""
    upper = np.append(STIFFNESS[1:], 0.0)
    stiffness = np.diag(STIFFNESS + upper) - np.diag(STIFFNESS[1:], 1) - np.diag(STIFFNESS[1:], -1)
    values, shapes = linalg.eigh(stiffness, np.diag(MASS))
    modal = np.diag(MASS) @ shapes
    return np.diag(MASS), modal @ np.diag(2 * DAMPING_RATIO * np.sqrt(values)) @ modal.T, stiffness


def ambient_record(seed=5):
    """Velocities at three floors under independent white forces on all, with 3 % noise."""
    mass, damping, stiffness = matrices()
    n = len(MASS)
    motion = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(mass, np.hstack([stiffness, damping]))]])
    force = np.vstack([np.zeros((n, n)), np.linalg.inv(mass)])
    step = linalg.expm(motion / RATE)
    held = np.linalg.solve(motion, (step - np.eye(2 * n)) @ force)
    rng = np.random.default_rng(seed)
    states = np.zeros((round((DURATION + 60) * RATE), 2 * n))
    for k in range(len(states) - 1):
        states[k + 1] = step @ states[k] + held @ rng.standard_normal(n) * 1e3
    velocity = states[round(60 * RATE) :, n:][:, list(SENSORS.values())]
    velocity = velocity + 0.03 * velocity.std(axis=0) * rng.standard_normal(velocity.shape)
    return TimeRecord(RATE, velocity, tuple(SENSORS), ("velocity",) * len(SENSORS), source="simulated ambient motion")


def main():
    """The modes, lowest first."""
    return identify_modes(ambient_record(), "ssi_cov")


if __name__ == "__main__":
    write_modes(Path(__file__).parent / "modes.json", main())
