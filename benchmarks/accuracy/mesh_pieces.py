"""Values from elements that are too long, against exact responses of beams: as drawn, and divided as the study leaves open.

A cantilever and a bridge of two spans, each span drawn as two elements. Records are accelerances of continuous Euler-Bernoulli
beams, by dynamic stiffnesses from the four functions that solve their equation, with 2 % noise. Errors are told in standard
deviations, which ought to have an rms of 1. With --drawn the record is simulated with the drawn elements.

    python benchmarks/accuracy/mesh_pieces.py [--repeats 10] [--drawn]
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

from structid import FrfRecord, load_study, run_study, simulated_record
from structid.core.arrays import ComplexArray, FloatArray
from structid.diagnose.verdict import judged
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


def exact_record(name: str, rng: np.random.Generator) -> FrfRecord:
    """Accelerances of a rig by exact dynamic stiffnesses, with noise."""
    nodes, fixed, spans, sensors, load, band = RIGS[name]
    dofs = [f"{node}{direction}" for node in range(1, len(nodes) + 1) for direction in ("Y", "RZ")]
    free = [i for i, dof in enumerate(dofs) if dof not in fixed]
    rows, column = [free.index(dofs.index(dof)) for dof in sensors], free.index(dofs.index(load))
    frequency: FloatArray = np.linspace(*band, N_LINES)
    values = np.zeros((N_LINES, len(rows), 1), complex)
    for line, omega in enumerate(2 * np.pi * frequency):
        whole = np.zeros((len(dofs), len(dofs)), complex)
        for mass, stiffness, first, last in spans:
            for node in range(first, last):
                index = slice(2 * node - 2, 2 * node + 2)
                length = nodes[node] - nodes[node - 1]
                whole[index, index] += exact_stiffness(length, mass, stiffness * (1 + 1j * LOSS_FACTOR), omega)
        force = np.eye(len(free))[:, column]
        values[line, :, 0] = -(omega**2) * np.linalg.solve(whole[np.ix_(free, free)], force)[rows]
    error = rng.standard_normal((2, *values.shape)) / np.sqrt(2)
    return FrfRecord(
        frequency, values + NOISE * np.abs(values) * (error[0] + 1j * error[1]), sensors, [load], "accelerance"
    )


def study_text(name: str, line: str, factor: float) -> str:
    """The study of a rig with `line` in its structure; values begin at `factor` times the truth."""
    nodes, fixed, spans, _, _, band = RIGS[name]
    placed = "\n".join(f"{number} = [{x}, 0.0]" for number, x in enumerate(nodes, 1))
    sets, unknowns = "", ""
    for number, (mass, stiffness, first, last) in enumerate(spans, 1):
        pairs = [[node, node + 1] for node in range(first, last)]
        sets += f"""
[[structure.beam]]
name = "span {number}"
nodes = {pairs}
mass = {mass * factor}
bending_stiffness = {stiffness / factor}
loss_factor = {LOSS_FACTOR}
"""
        for kind in ("mass", "bending_stiffness"):
            unknowns += f'[[unknown]]\nproperty = "{kind}"\nelements = "span {number}"\n'
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
[record]
path = "frf.npz"
calibration = 0
[record.noise]
relative = {NOISE}
[method]
band = [{band[0]}, {band[1]}]
"""


def errors_of(name: str, line: str, repeats: int, is_drawn: bool, folder: Path) -> FloatArray:
    """Errors in standard deviations, (repeats, n_params), of a study with `line`; verdicts and processor time are printed."""
    truth = np.array([value for mass, stiffness, _, _ in RIGS[name][2] for value in (mass, stiffness)])
    path, errors, told, seconds = folder / "study.toml", [], Counter(), 0.0
    for seed in range(repeats):
        record = exact_record(name, np.random.default_rng(seed))
        if is_drawn:
            path.write_text(study_text(name, "subdivide = 1", 1.0), encoding="utf-8")
            write_record(folder / "frf.npz", record)
            drawn = load_study(path)
            record = simulated_record(drawn.structure, drawn.parameters, record, NOISE, np.random.default_rng(seed))
        write_record(folder / "frf.npz", record)
        path.write_text(study_text(name, line, START), encoding="utf-8")
        begun = time.process_time()
        found = run_study(load_study(path)).identification
        seconds += time.process_time() - begun
        estimate, spans = found.estimate, range(1, len(truth) // 2 + 1)
        order = [estimate.names.index(f"{kind}[span {k}]") for k in spans for kind in ("mass", "bending_stiffness")]
        errors.append((estimate.values[order] - truth) / estimate.std[order])
        told[judged(found).verdict, found.structure.subdivide] += 1
    size = np.sqrt(np.mean(np.square(errors)))
    listed = ", ".join(f"{count} {verdict} with {pieces}" for (verdict, pieces), count in told.items())
    print(
        f"{name}, {line or 'pieces left open'}: errors {size:.2f} deviations rms; {listed} pieces; {seconds / repeats:.2f} s each"
    )
    return np.array(errors)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--drawn", action="store_true", help="records of the drawn elements")
    chosen = parser.parse_args()
    is_right = True
    with tempfile.TemporaryDirectory() as folder:
        for name in RIGS:
            for line in ("subdivide = 1", ""):
                errors = errors_of(name, line, chosen.repeats, chosen.drawn, Path(folder))
                is_right &= bool(line) or chosen.drawn or bool(np.sqrt(np.mean(errors**2)) < 1.6)
    return 0 if is_right else 1


if __name__ == "__main__":
    sys.exit(main())
