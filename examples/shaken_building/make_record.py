"""How record.csv was made: a building of three storeys on a shaking table, in plain NumPy."""

from pathlib import Path

import numpy as np

RATE, SECONDS = 50.0, 60.0
MASS = np.array([820.0, 820.0, 640.0])  # kg
STIFFNESS = np.array([5.2e5, 3.9e5, 4.4e5])  # N/m
DAMPING = np.array([900.0, 700.0, 750.0])  # N s/m


def chain(values: np.ndarray) -> np.ndarray:
    """What springs (or dampers) between the table and floors one above the other make of the floors' motions."""
    drift = np.eye(3) - np.eye(3, k=-1)
    return drift.T @ np.diag(values) @ drift


def main() -> None:
    """Write accelerations of table and floors; the record begins and ends in the middle of the shaking."""
    rng = np.random.default_rng(11)
    n = int(RATE * SECONDS)
    frequency = np.fft.rfftfreq(3 * n, 1 / RATE)
    level = ((frequency > 0.3) & (frequency < 20.0)) / np.maximum(frequency, 1.0) ** 0.5
    table = level * np.exp(2j * np.pi * rng.random(len(frequency)))
    s = 2j * np.pi * frequency[:, None, None]
    dynamic = s**2 * np.diag(MASS) + s * chain(DAMPING) + chain(STIFFNESS)
    drift = np.linalg.solve(dynamic, np.tile(-MASS[:, None], (len(frequency), 1, 1)))  # under -M 1 of the table
    floors = (1 + (s**2 * drift)[..., 0]) * table[:, None]
    clean = np.fft.irfft(np.column_stack([table, floors]), 3 * n, axis=0)[n : 2 * n]
    clean *= 0.8 / clean[:, 0].std()
    noisy = clean + 0.01 * rng.standard_normal(clean.shape)
    lines = ["Time [s],0X [m/s^2],1X [m/s^2],2X [m/s^2],3X [m/s^2]"]
    lines += [",".join([f"{i / RATE:.2f}", *(f"{x:.4f}" for x in row)]) for i, row in enumerate(noisy)]
    Path(__file__).with_name("record.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
