"""How the three records were made: a bridge of two spans in plain NumPy, 72 beam elements, noise on every channel."""

from pathlib import Path

import numpy as np

FOLDER = Path(__file__).parent
SPANS = (2.0, 1.6)  # m
TRUTH = {
    "mass[deck]": 12.0,  # kg/m
    "bending_stiffness[west]": 3400.0,  # N m^2
    "bending_stiffness[east]": 2900.0,
    "stiffness[pier]": 3.0e5,  # N/m, between the middle of the bridge and the ground
    "mass[crate]": 3.2,  # kg, on the east span
    "mass_damping[deck]": 6.0,  # N s/m^2
    "stiffness_damping[deck]": 0.3,  # N m^2 s
}
PIECE = 0.05  # m
SENSORS = {"P1": 0.5, "P2": 1.0, "P3": 1.5, "P4": 2.4, "P5": 2.8, "P6": 3.2}  # m from the west abutment
CRATE = 3.2
HAMMER, SHAKER = "P2", "P5"


def bridge() -> tuple[np.ndarray, np.ndarray, np.ndarray, list[int]]:
    """Mass, damping, stiffness of the free deflections and rotations, and the rows of the sensors."""
    h, n = PIECE, round(sum(SPANS) / PIECE)
    bending = 1 / h**3 * np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                                   [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]])  # fmt: skip
    inertia = h / 420 * np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2],
                                  [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]])  # fmt: skip
    mass, damping, stiffness = np.zeros((3, 2 * n + 2, 2 * n + 2))
    for e in range(n):
        place = np.ix_(range(2 * e, 2 * e + 4), range(2 * e, 2 * e + 4))
        side = "west" if (e + 0.5) * h < SPANS[0] else "east"
        stiffness[place] += TRUTH[f"bending_stiffness[{side}]"] * bending
        mass[place] += TRUTH["mass[deck]"] * inertia
        damping[place] += TRUTH["mass_damping[deck]"] * inertia + TRUTH["stiffness_damping[deck]"] * bending
    pier, crate = (2 * round(x / h) for x in (SPANS[0], CRATE))
    stiffness[pier, pier] += TRUTH["stiffness[pier]"]
    mass[crate, crate] += TRUTH["mass[crate]"]
    free = [i for i in range(2 * n + 2) if i not in (0, 2 * n)]  # the abutments hold, and let turn
    rows = [free.index(2 * round(x / h)) for x in SENSORS.values()]
    inside = np.ix_(free, free)
    return mass[inside], damping[inside], stiffness[inside], rows


def accelerances(frequency: np.ndarray, loads: list[int]) -> np.ndarray:
    """Acceleration of every sensor per force at the rows `loads`, shape (lines, sensors, loads)."""
    mass, damping, stiffness, rows = bridge()
    force = np.eye(len(mass))[:, loads]
    s = 2j * np.pi * frequency
    return np.array([z**2 * np.linalg.solve(z**2 * mass + z * damping + stiffness, force)[rows] for z in s])


def motion(force: np.ndarray, rate: float, loads: list[int]) -> np.ndarray:
    """Accelerations under forces, shape (samples, loads), of a bridge at rest before; shape (samples, sensors)."""
    size = 2 ** int(np.ceil(np.log2(len(force) + 30 * rate)))  # room for what rings on
    response = accelerances(np.fft.rfftfreq(size, 1 / rate), loads)
    spectrum = np.einsum("fsl,fl->fs", response, np.fft.rfft(force, size, axis=0))
    return np.fft.irfft(spectrum, size, axis=0)[: len(force)]


def band_limited(rng: np.random.Generator, shape: tuple[int, int], rate: float, low: float, high: float) -> np.ndarray:
    """Random numbers of deviation 1 with all their power between two frequencies, as behind an anti-alias filter."""
    spectrum = np.fft.rfft(rng.standard_normal(shape), axis=0)
    frequency = np.fft.rfftfreq(shape[0], 1 / rate)
    spectrum[(frequency < low) | (frequency > high)] = 0
    made = np.fft.irfft(spectrum, shape[0], axis=0)
    return made / made.std(axis=0)


def hammer(rng: np.random.Generator) -> None:
    """Accelerances by H1 of ten blows on P2, 8 s each, an exponential window that ends at 1 % on both channels."""
    rate, samples, blows = 256.0, 2048, 10
    time = np.arange(samples) / rate
    window = 0.01 ** (time / time[-1])
    row = bridge()[3][list(SENSORS).index(HAMMER)]
    pulse = np.where(time < 6 / rate, np.sin(np.pi * time * rate / 6), 0.0)[:, None]
    clean = motion(pulse, rate, [row])
    parts = []
    for _ in range(blows):
        strength = rng.uniform(80, 140)
        force = strength * pulse + 0.1 * rng.standard_normal(pulse.shape)
        answer = strength * clean + 0.08 * rng.standard_normal(clean.shape)
        parts.append((np.fft.rfft(force * window[:, None], axis=0), np.fft.rfft(answer * window[:, None], axis=0)))
    x, y = (np.array(one) for one in zip(*parts, strict=True))
    power, cross = (np.abs(x) ** 2).sum(0), (y * x.conj()).sum(0)
    response, coherence = cross / power, np.abs(cross) ** 2 / power / (np.abs(y) ** 2).sum(0)
    frequency = np.fft.rfftfreq(samples, 1 / rate)
    heads = ["Frequency [Hz]"]
    for name in SENSORS:
        pair = f"{name}/{HAMMER}"
        heads += [f"{pair} [(m/s^2)/N] re", f"{pair} [(m/s^2)/N] im", f"{pair} coherence"]
    used = (frequency >= 3) & (frequency <= 60)
    values = np.stack([response.real, response.imag, coherence], axis=-1).reshape(len(frequency), -1)
    rows = np.column_stack([frequency, values])[used]
    write("hammer.csv", [",".join(heads)], [[f"{x:.5g}" for x in one] for one in rows], ",")


def shaker(rng: np.random.Generator) -> None:
    """Force and accelerations of 24 s of random shaking at P5, in the English of a recorder."""
    rate, samples = 160.0, 3840
    row = bridge()[3][list(SENSORS).index(SHAKER)]
    force = 12 * band_limited(rng, (samples, 1), rate, 3, 60)
    clean = np.column_stack([force, motion(force, rate, [row])])
    noisy = clean + 0.01 * clean.std(axis=0) * rng.standard_normal(clean.shape)
    heads = ["Time [s],Force [N]," + ",".join(f"{name} [m/s^2]" for name in SENSORS)]
    write("shaker.csv", heads, [[f"{i / rate:.5f}", *(f"{x:.4g}" for x in one)] for i, one in enumerate(noisy)], ",")


def ambient(rng: np.random.Generator) -> None:
    """Accelerations of 100 s under forces that nobody measured, as a German logger writes them."""
    rate, samples = 80.0, 8000
    rows = [i for i in range(len(bridge()[0])) if i % 6 == 1]
    clean = 1e3 * motion(0.6 * band_limited(rng, (samples, len(rows)), rate, 1, 36), rate, rows)
    noisy = clean + 0.02 * clean.std(axis=0) * rng.standard_normal(clean.shape)
    heads = [
        "Messung Steg;18.9.",
        "Zeit;" + ";".join(f"Aufnehmer {k}" for k in range(1, 7)),
        "s;" + "mm/s²;" * 5 + "mm/s²",
    ]
    told = [[f"{i / rate:.4f}", *(f"{x:.1f}" for x in one)] for i, one in enumerate(noisy)]
    write("ambient.csv", heads, [[x.replace(".", ",") for x in one] for one in told], ";")


def write(name: str, heads: list[str], cells: list[list[str]], separator: str) -> None:
    """A table of text."""
    text = "\n".join([*heads, *(separator.join(one) for one in cells)]) + "\n"
    (FOLDER / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    seeded = np.random.default_rng(18)
    hammer(seeded)
    shaker(seeded)
    ambient(seeded)
