"""Do 95 % bands of predictions at places without a sensor hold the truth? Noise and wrong fixed values, many times.

The structures, their truths and their FRFs are those of `tolerances.py`, by its own matrices. Each repeat draws fixed values and
noise anew, identifies, and predicts: accelerances at degrees of freedom that no sensor reads, natural frequencies, the change of
frequencies and accelerances by a mass that is added, and (of the chain) the largest displacements under a half-sine push, whose
truth comes from a matrix exponential. Of beams also: bending moment and strain of a fibre at an end of an element, as FRFs,
and the largest moment and strain under the push; their truth is the element's own matrix times its motion, the loss factor acting
as a damping ratio of its half at each mode. `--stresses` leaves all others out, `--frequencies` all but natural
frequencies.

    python benchmarks/accuracy/predictions.py [--repeats 100] [--seed 0] [--tolerance 0.01] [--only chain]
        [--stresses | --frequencies]
"""

from __future__ import annotations

import argparse
import os
import time
from collections import defaultdict
from itertools import pairwise

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.linalg import eigh, expm
from tolerances import DAMPING, RIGS, Rig, beam_matrices, frf_setup, matrices, truth

import structid as sid
from structid.prediction.changes import AddMass
from structid.prediction.predict import predict, predict_change, predict_together
from structid.prediction.quantities import Frf, History, Maxima, NaturalModes
from structid.unknowns.tolerances import Tolerances

UNSEEN = {
    "chain": ("2X", "5X"),
    "cantilever": ("5Y", "12Y"),
    "beam on three supports": ("3Y", "8Y"),
    "frame": ("8X", "5Y"),
}
#: Zone, number in it and number in the beam of an element of 0.15 m whose first end is read, and the height of the fibre, m.
READ, LENGTH, HEIGHT = ("b", 2, 5), 0.15, 0.02
#: Random models behind the bands of stresses.
DRAWS = 200
LOADED = {"chain": 4, "cantilever": 10, "beam on three supports": 7, "frame": 6}


def true_frf(rig: Rig, m, k, c, frequency: np.ndarray, outputs) -> np.ndarray:
    s = 2j * np.pi * frequency
    z = s[:, None, None] ** 2 * m + s[:, None, None] * c + k
    unit = np.zeros((len(rig.dofs), 1))
    unit[rig.index(rig.load)] = 1.0
    motion = np.linalg.solve(z, np.broadcast_to(unit, (len(s), *unit.shape)))
    return (s**2)[:, None, None] * motion[:, [rig.index(d) for d in outputs]]


def true_frf_of_all(rig: Rig, m, k, c, frequency: np.ndarray) -> np.ndarray:
    """Receptances of all degrees of freedom, (n_frequencies, n_dofs)."""
    s = 2j * np.pi * frequency
    z = s[:, None, None] ** 2 * m + s[:, None, None] * c + k
    unit = np.zeros((len(rig.dofs), 1))
    unit[rig.index(rig.load)] = 1.0
    return np.linalg.solve(z, np.broadcast_to(unit, (len(s), *unit.shape)))[..., 0]


def element_rows(rig: Rig, values: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Rows (n_dofs,) of displacement and of acceleration that make up the bending moment at the first end of `READ`."""
    zone, _, number = READ
    k_unit, m_unit = beam_matrices(LENGTH)
    rows = np.zeros((2, len(rig.dofs)))
    for column, dof in enumerate([f"{number}Y", f"{number}RZ", f"{number + 1}Y", f"{number + 1}RZ"]):
        rows[0, rig.index(dof)] = -values[f"bending_stiffness[{zone}]"] * k_unit[1, column]
        rows[1, rig.index(dof)] = -values[f"mass[{zone}]"] * m_unit[1, column]
    return rows[0], rows[1]


def true_maxima(rig: Rig, m, k, c, force: np.ndarray, rate: float, of_displacement, of_acceleration) -> np.ndarray:
    """Largest magnitudes (n,) of what rows (n, n_dofs) read of displacements and accelerations."""
    n = len(m)
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(m, k.real), -np.linalg.solve(m, c)]])
    b = np.concatenate([np.zeros(n), np.linalg.solve(m, np.eye(n)[rig.index(rig.load)])])
    whole = np.zeros((2 * n + 2, 2 * n + 2))
    whole[: 2 * n, : 2 * n], whole[: 2 * n, 2 * n], whole[2 * n, 2 * n + 1] = a / rate, b / rate, 1.0
    step = expm(whole)
    read = np.hstack([of_displacement, np.zeros((len(of_displacement), n))]) + of_acceleration @ a[n:]
    direct = of_acceleration @ b[n:]
    state, most = np.zeros(2 * n), np.zeros(len(read))
    for first, second in pairwise(force):
        state = (
            step[: 2 * n, : 2 * n] @ state + step[: 2 * n, 2 * n] * first + step[: 2 * n, 2 * n + 1] * (second - first)
        )
        most = np.maximum(most, np.abs(read @ state + direct * second))
    return most


def loss_as_viscous(m: np.ndarray, k: np.ndarray, loss: float) -> np.ndarray:
    """Viscous damping that gives every mode the damping ratio loss / 2."""
    squares, shapes = eigh(k.real, m)
    turned = m @ shapes
    return turned @ np.diag(loss * np.sqrt(squares)) @ turned.T


def with_mass(rig: Rig, m: np.ndarray, node: int, mass: float) -> np.ndarray:
    changed = np.array(m)
    for direction in "XYZ":
        if f"{node}{direction}" in rig.dofs:
            i = rig.index(f"{node}{direction}")
            changed[i, i] += mass
    return changed


def push(rig: Rig) -> tuple[np.ndarray, float]:
    """A half-sine of 20 ms and 100 N, and its sampling rate."""
    rate = 20 * rig.band[1]
    at = np.arange(800) / rate
    return 100 * np.where(at < 0.02, np.sin(np.pi * at / 0.02), 0.0), rate


def repeat(rig: Rig, tolerance: float, seed: int, inside: dict[str, list[np.ndarray]], only: str = "") -> None:
    rng = np.random.default_rng([seed, sorted(UNSEEN).index(rig.name)])  # the structures' errors are independent
    values, _, gain = truth(rig, rng, tolerance)
    options = sid.IdentifyOptions(tolerances=Tolerances(tolerance, tolerance, DAMPING, tolerance))
    found = sid.identify_together([frf_setup(rig, values, gain, rng, 0.01)], options)
    m, k, c = matrices(rig, values)
    frequency, outputs = np.linspace(*rig.band, 120), UNSEEN[rig.name]
    node, mass = LOADED[rig.name], 0.05 * rig.structure.mass_of()
    heavy = with_mass(rig, m, node, mass)

    def hertz(m: np.ndarray) -> np.ndarray:
        return np.sqrt(eigh(k.real, m, eigvals_only=True)[:3]) / (2 * np.pi)

    def put(what: str, predicted, true: np.ndarray) -> None:
        inside[what].append(((predicted.low <= true) & (true <= predicted.high)).ravel())

    if rig.name in ("cantilever", "beam on three supports") and only != "frequencies":
        zone, number, node = READ
        names = [f"M[{zone}:{number}@{node}]", f"strain[{zone}:{number}@{node} y={HEIGHT}]"]
        rows, to_strain = element_rows(rig, values), -HEIGHT / values[f"bending_stiffness[{zone}]"]
        motion = true_frf_of_all(rig, m, k, c, frequency)
        moment = motion @ rows[0] - (2 * np.pi * frequency) ** 2 * (motion @ rows[1])
        found_frf = predict(found, Frf(names, [rig.load], frequency), n_draws=DRAWS, seed=seed)
        true = np.abs(moment)[:, None] * np.abs([1.0, to_strain])
        force, rate = push(rig)
        history = History(names, [rig.load], force[:, None], rate)
        [largest] = predict_together(found, [Maxima(history)], n_draws=DRAWS, seed=seed)
        viscous = c + loss_as_viscous(m, k, values["loss"])
        read = (np.outer([1.0, to_strain], row) for row in rows)
        true_largest = true_maxima(rig, m, k, viscous, force, rate, *read)
        for column, what in enumerate(("moment", "strain")):
            held = (found_frf.low[:, column, 0] <= true[:, column]) & (true[:, column] <= found_frf.high[:, column, 0])
            inside[what].append(held)
            top = true_largest[[column]]
            inside[f"largest {what}"].append((largest.low[[column]] <= top) & (top <= largest.high[[column]]))
    if only == "stresses":
        return
    if only != "frequencies":
        quantity = Frf(outputs, [rig.load], frequency)
        changed = predict_change(found, quantity, [AddMass(node, mass)], seed=seed)
        before, after = (np.abs(true_frf(rig, each, k, c, frequency, outputs)) for each in (m, heavy))
        put("frf", changed.before, before)
        put("frf + mass", changed.after, after)
        put("frf change", changed.difference, after - before)
    changed = predict_change(found, NaturalModes(3), [AddMass(node, mass)], seed=seed)
    for what, predicted, true in (
        ("hertz", changed.before, hertz(m)),
        ("hertz + mass", changed.after, hertz(heavy)),
        ("hertz change", changed.difference, hertz(heavy) - hertz(m)),
    ):
        inside[what].append((predicted.low[:, 0] <= true) & (true <= predicted.high[:, 0]))
    if rig.name == "chain" and not only:
        force, rate = push(rig)
        history = History(outputs, [rig.load], force[:, None], rate, "displacement")
        at_outputs = np.eye(len(rig.dofs))[[rig.index(d) for d in outputs]]
        largest = true_maxima(rig, m, k, c, force, rate, at_outputs, 0 * at_outputs)
        put("maxima", predict(found, Maxima(history), seed=seed), largest)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tolerance", type=float, default=0.01)
    parser.add_argument("--only", nargs="+", default=list(RIGS), choices=list(RIGS))
    parser.add_argument("--stresses", dest="alone", action="store_const", const="stresses", default="")
    parser.add_argument("--frequencies", dest="alone", action="store_const", const="frequencies")
    chosen = parser.parse_args()
    print(
        f"inside the 95 % band, %; {chosen.repeats} repeats from seed {chosen.seed}, fixed values off by {chosen.tolerance:g}"
    )
    whole: dict[str, list[np.ndarray]] = defaultdict(list)
    for name in chosen.only:
        inside: dict[str, list[np.ndarray]] = defaultdict(list)
        begun = time.process_time()
        for seed in range(chosen.seed, chosen.seed + chosen.repeats):
            repeat(RIGS[name](), chosen.tolerance, seed, inside, chosen.alone)
        each = (time.process_time() - begun) / chosen.repeats
        print_row(name, inside, f"{each:.2f} s each")
        for what, parts in inside.items():
            whole[what] += parts
    print_row("all", whole, "")


def print_row(name: str, inside: dict[str, list[np.ndarray]], words: str) -> None:
    cells = "  ".join(f"{what} {100 * np.concatenate(parts).mean():.1f}" for what, parts in inside.items())
    print(f"{name:24s} {cells}  {words}", flush=True)


if __name__ == "__main__":
    main()
