"""Values from elements that are too long, against exact responses of beams: as drawn, and divided as the study leaves open.

A cantilever and a bridge of two spans, each span drawn as two elements. Records are accelerances of continuous Euler-Bernoulli
beams, by dynamic stiffnesses from the four functions that solve their equation, with 2 % noise; with --data histories of force and
accelerations, cut from a longer motion, or frequencies and shapes of modes, the masses known then. Errors are told in standard
deviations, which ought to have an rms of 1. With --drawn the record is simulated with the drawn elements.

    python benchmarks/accuracy/mesh_pieces.py [--repeats 10] [--data frf histories modes] [--drawn]
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.linalg import eigh

from structid import FrfRecord, ModalRecord, TimeRecord, load_study, run_study, simulated_record
from structid.core.arrays import ComplexArray, FloatArray
from structid.diagnose.verdict import judged
from structid.modal.formats import write_modes
from structid.records.formats import write_record

NOISE, N_LINES = 0.02, 200
#: Of each rig: nodes in m, supports, spans (mass kg/m, bending stiffness N m2, first and last node), sensors, load, band in Hz.
RIGS = {
    "cantilever": ((0.0, 0.5, 1.0), ("1Y", "1RZ"), ((1.2, 60.0, 1, 3),), ("2Y", "3Y"), "2Y", (4.0, 70.0)),
    "bridge": (
        (0.0, 5.0, 10.0, 14.0, 18.0),
        ("1Y", "3Y", "5Y"),
        ((400.0, 4e7, 1, 3), (400.0, 3e7, 3, 5)),
        ("2Y", "4Y"),
        "2Y",
        (2.0, 40.0),
    ),
}
LOSS_FACTOR, START = 0.02, 1.2
#: Of histories: samples of the motion that they are cut from, and of the record; standard deviation of a frequency, in parts of it.
PERIOD, N_SAMPLES, FREQUENCY_STD = 4096, 1024, 5e-4
#: Unknown properties by the kind of data.
UNKNOWN = {
    "frf": ("mass", "bending_stiffness"),
    "histories": ("mass", "bending_stiffness"),
    "modes": ("bending_stiffness",),
}
#: Elements of a span that give the modes of the continuous beam to eight digits.
FINE = 40


def exact_stiffness(length: float, mass: float, stiffness: complex, omega: float) -> ComplexArray:
    """Dynamic stiffness (4, 4) of a beam for deflection and rotation at both ends."""
    k = (omega**2 * mass / stiffness) ** 0.25
    x = k * length
    c, s, ch, sh = np.cos(x), np.sin(x), np.cosh(x), np.sinh(x)
    below = 1 - c * ch
    direct, cross = k**3 * (c * sh + s * ch), -(k**3) * (s + sh)
    turn, far = k**2 * s * sh, k**2 * (ch - c)
    own, other = k * (s * ch - c * sh), k * (sh - s)
    matrix = [
        [direct, turn, cross, far],
        [turn, own, -far, other],
        [cross, -far, direct, -turn],
        [far, other, -turn, own],
    ]
    return np.array(matrix) * stiffness / below


def exact_accelerance(name: str, frequency: FloatArray) -> ComplexArray:
    """Accelerance (n_lines, n_sensors) of a rig at its load, by exact dynamic stiffnesses."""
    nodes, fixed, spans, sensors, load, _ = RIGS[name]
    dofs = [f"{node}{direction}" for node in range(1, len(nodes) + 1) for direction in ("Y", "RZ")]
    free = [i for i, dof in enumerate(dofs) if dof not in fixed]
    rows, column = [free.index(dofs.index(dof)) for dof in sensors], free.index(dofs.index(load))
    values = np.zeros((len(frequency), len(rows)), complex)
    for line, omega in enumerate(2 * np.pi * frequency):
        whole = np.zeros((len(dofs), len(dofs)), complex)
        for mass, stiffness, first, last in spans:
            for node in range(first, last):
                index = slice(2 * node - 2, 2 * node + 2)
                length = nodes[node] - nodes[node - 1]
                whole[index, index] += exact_stiffness(length, mass, stiffness * (1 + 1j * LOSS_FACTOR), omega)
        force = np.eye(len(free))[:, column]
        values[line] = -(omega**2) * np.linalg.solve(whole[np.ix_(free, free)], force)[rows]
    return values


def exact_frf(name: str, rng: np.random.Generator) -> FrfRecord:
    """Accelerances of a rig, with noise."""
    _, _, _, sensors, load, band = RIGS[name]
    frequency: FloatArray = np.linspace(*band, N_LINES)
    values = exact_accelerance(name, frequency)[:, :, None]
    error = rng.standard_normal((2, *values.shape)) / np.sqrt(2)
    return FrfRecord(
        frequency, values + NOISE * np.abs(values) * (error[0] + 1j * error[1]), sensors, [load], "accelerance"
    )


def exact_histories(name: str, rng: np.random.Generator) -> TimeRecord:
    """A force of random phases in the band and the accelerations under it, a quarter of its period, with noise on both."""
    _, _, _, sensors, load, band = RIGS[name]
    rate = 3.2 * band[1]
    frequency = np.fft.rfftfreq(PERIOD, 1 / rate)
    within = (frequency > 0.5 * band[0]) & (frequency < 1.25 * band[1])
    force = np.zeros(len(frequency), complex)
    force[within] = np.exp(2j * np.pi * rng.random(within.sum()))
    motion = np.zeros((len(frequency), len(sensors)), complex)
    motion[within] = exact_accelerance(name, frequency[within]) * force[within, None]
    values = np.fft.irfft(np.column_stack([force, motion]), PERIOD, axis=0)[:N_SAMPLES]
    values = values + NOISE * values.std(axis=0) * rng.standard_normal(values.shape)
    return TimeRecord(rate, values, [load, *sensors], ("force", *["acceleration"] * len(sensors)))


def exact_modes(name: str, rng: np.random.Generator) -> ModalRecord:
    """Frequencies and shapes of the first three modes, those of `FINE` elements a span, with errors."""
    nodes, fixed, spans, sensors, _, _ = RIGS[name]
    n = FINE * (len(nodes) - 1) + 1
    mass, stiffness = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2 * n))
    for linear_density, bending_stiffness, first, last in spans:
        for node in range(first, last):
            h = (nodes[node] - nodes[node - 1]) / FINE
            stiff = [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2]]
            heavy = [[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2]]
            stiff += [[-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]
            heavy += [[54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]]
            for piece in range((node - 1) * FINE, node * FINE):
                index = slice(2 * piece, 2 * piece + 4)
                stiffness[index, index] += np.array(stiff) * bending_stiffness / h**3
                mass[index, index] += np.array(heavy) * linear_density * h / 420
    fine = {
        f"{node}{d}": 2 * FINE * (node - 1) + i for node in range(1, len(nodes) + 1) for i, d in enumerate(("Y", "RZ"))
    }
    free = [i for i in range(2 * n) if i not in {fine[dof] for dof in fixed}]
    values, vectors = eigh(stiffness[np.ix_(free, free)], mass[np.ix_(free, free)], subset_by_index=(0, 2))
    shapes = vectors[[free.index(fine[dof]) for dof in sensors]]
    shapes = shapes / np.abs(shapes).max(axis=0)
    frequency = np.sqrt(values) / (2 * np.pi)
    frequency = frequency * (1 + FREQUENCY_STD * rng.standard_normal(3))
    shapes = shapes + NOISE * rng.standard_normal(shapes.shape)
    deviation = np.zeros((6, 6))
    deviation[:3, :3] = np.diag((FREQUENCY_STD * frequency) ** 2)
    deviation[3:, 3:] = 1e-6 * np.eye(3)
    return ModalRecord(frequency, np.full(3, 0.01), shapes, sensors, deviation, np.full(shapes.shape, NOISE))


def record_text(kind: str, band: tuple[float, float]) -> str:
    """The record of a study and what is asked of it, by the `kind` of data."""
    if kind == "modes":
        return '[record]\npath = "modes.json"\n[record.modes]\n'
    noise = f"[record.noise]\nrelative = {NOISE}" if kind == "frf" else f"[record.time]\nrelative_noise = {NOISE}"
    return f"""[record]
path = "{kind}.npz"
calibration = 0
{noise}
[method]
band = [{band[0]}, {band[1]}]
"""


def study_text(name: str, kind: str, line: str, factor: float) -> str:
    """The study of a rig with `line` in its structure; unknown values begin at `factor` times the truth."""
    nodes, fixed, spans, _, _, band = RIGS[name]
    placed = "\n".join(f"{number} = [{x}, 0.0]" for number, x in enumerate(nodes, 1))
    sets, unknowns = "", ""
    for number, (mass, stiffness, first, last) in enumerate(spans, 1):
        pairs = [[node, node + 1] for node in range(first, last)]
        sets += f"""
[[structure.beam]]
name = "span {number}"
nodes = {pairs}
mass = {mass if kind == "modes" else mass * factor}
bending_stiffness = {stiffness / factor}
loss_factor = {LOSS_FACTOR}
"""
        for unknown in UNKNOWN[kind]:
            unknowns += f'[[unknown]]\nproperty = "{unknown}"\nelements = "span {number}"\n'
    supports = ", ".join(f'"{dof}"' for dof in fixed)
    return f"""title = "{name}"
[structure]
active = ["Y", "RZ"]
fixed = [{supports}]
tolerance = 0
{line}
[structure.nodes]
{placed}
{sets}{unknowns}
{record_text(kind, band)}"""


def write_exact(name: str, kind: str, seed: int, folder: Path) -> None:
    """Write the record of a rig by the `kind` of data."""
    rng = np.random.default_rng(seed)
    if kind == "modes":
        write_modes(folder / "modes.json", exact_modes(name, rng))
    else:
        write_record(folder / f"{kind}.npz", exact_frf(name, rng) if kind == "frf" else exact_histories(name, rng))


def write_drawn(name: str, seed: int, folder: Path) -> None:
    """Write the FRFs of a rig as the elements of the study have them."""
    path, rng = folder / "study.toml", np.random.default_rng(seed)
    path.write_text(study_text(name, "frf", "subdivide = 1", 1.0), encoding="utf-8")
    drawn = load_study(path)
    record = simulated_record(
        drawn.structure, drawn.parameters, exact_frf(name, rng), NOISE, np.random.default_rng(seed)
    )
    write_record(folder / "frf.npz", record)


def errors_of(name: str, kind: str, line: str, repeats: int, is_drawn: bool, folder: Path) -> FloatArray:
    """Errors in standard deviations, (repeats, n_params), of a study with `line`; verdicts and processor time are printed."""
    spans = RIGS[name][2]
    truth = {
        f"{unknown}[span {number}]": value
        for number, (mass, stiffness, _, _) in enumerate(spans, 1)
        for unknown, value in (("mass", mass), ("bending_stiffness", stiffness))
        if unknown in UNKNOWN[kind]
    }
    path, errors, told, seconds = folder / "study.toml", [], Counter(), 0.0
    for seed in range(repeats):
        write_exact(name, kind, seed, folder)
        if is_drawn:
            write_drawn(name, seed, folder)
        path.write_text(study_text(name, kind, line, START), encoding="utf-8")
        begun = time.process_time()
        identification = run_study(load_study(path)).identification
        seconds += time.process_time() - begun
        estimate = identification.estimate
        order = [estimate.names.index(parameter) for parameter in truth]
        errors.append((estimate.values[order] - np.array(list(truth.values()))) / estimate.std[order])
        told[judged(identification).verdict, identification.structure.subdivide] += 1
    size, inside = np.sqrt(np.mean(np.square(errors))), np.mean(np.abs(errors) < 1.96)
    listed = ", ".join(f"{count} {verdict} with {pieces}" for (verdict, pieces), count in told.items())
    print(
        f"{name}, {kind}, {line or 'pieces left open'}: errors {size:.2f} deviations rms, {100 * inside:.0f} % inside;"
        f" {listed} pieces; {seconds / repeats:.2f} s each",
        flush=True,
    )
    return np.array(errors)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--data", nargs="+", choices=tuple(UNKNOWN), default=["frf"])
    parser.add_argument("--drawn", action="store_true", help="FRFs of the drawn elements")
    chosen = parser.parse_args()
    is_right = True
    with tempfile.TemporaryDirectory() as folder:
        for kind in ("frf",) if chosen.drawn else chosen.data:
            for name in RIGS:
                for line in ("subdivide = 1", ""):
                    errors = errors_of(name, kind, line, chosen.repeats, chosen.drawn, Path(folder))
                    is_right &= bool(line) or chosen.drawn or bool(np.sqrt(np.mean(errors**2)) < 1.6)
    return 0 if is_right else 1


if __name__ == "__main__":
    sys.exit(main())
