"""How record.csv was made: a cantilever with a mass at its tip, shaken near the clamp, in plain NumPy."""

from pathlib import Path

import numpy as np
from scipy import signal

RATE, SECONDS = 512.0, 24.0
LENGTH, LINE_MASS, BENDING, TIP = 0.6, 0.81, 28.0, 0.12  # m, kg/m, N m^2, kg


def beam(pieces: int) -> tuple[np.ndarray, np.ndarray]:
    """Mass and stiffness of the free deflections and rotations, clamped at the first node."""
    h, n = LENGTH / pieces, 2 * (pieces + 1)
    k = BENDING / h**3 * np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                                   [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]])  # fmt: skip
    m = LINE_MASS * h / 420 * np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2],
                                        [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]])  # fmt: skip
    mass, stiffness = np.zeros((n, n)), np.zeros((n, n))
    for e in range(pieces):
        place = np.ix_(range(2 * e, 2 * e + 4), range(2 * e, 2 * e + 4))
        mass[place] += m
        stiffness[place] += k
    mass[-2, -2] += TIP
    return mass[2:, 2:], stiffness[2:, 2:]


def main() -> None:
    """Write the record as a laboratory would: semicolons, decimal commas."""
    mass, stiffness = beam(12)
    rng = np.random.default_rng(8)
    n = int(RATE * SECONDS)
    force = signal.sosfilt(signal.butter(4, [4, 160], "bandpass", fs=RATE, output="sos"), rng.standard_normal(n)) * 4
    size = 2 * n  # room for what rings on
    omega = 2 * np.pi * np.fft.rfftfreq(size, 1 / RATE)
    places = [6, 14, 22]  # deflections at 0.2, 0.4 and 0.6 m
    spectrum = np.fft.rfft(force, size)
    motion = np.zeros((len(omega), 3), complex)
    for i, w in enumerate(omega):
        dynamic = stiffness * (1 + 0.012j) - w**2 * mass if w else stiffness
        motion[i] = -(w**2) * np.linalg.solve(dynamic, np.eye(len(mass))[:, 6])[places] * spectrum[i]
    clean = np.column_stack([force, np.fft.irfft(motion, size, axis=0)[:n]])
    noisy = clean + 0.01 * clean.std(axis=0) * rng.standard_normal(clean.shape)
    lines = ["Time [s];2Y [N];2Y [m/s^2];3Y [m/s^2];4Y [m/s^2]"]
    lines += [
        ";".join([f"{i / RATE:.9f}", *(f"{x:.5g}" for x in row)]).replace(".", ",") for i, row in enumerate(noisy)
    ]
    Path(__file__).with_name("record.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
