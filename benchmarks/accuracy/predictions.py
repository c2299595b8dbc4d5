"""Do 95 % bands of predictions at places without a sensor hold the truth? Noise and wrong fixed values, many times.

The structures, truths and FRFs are those of `tolerances.py`, by its own matrices. Each repeat draws fixed values and noise anew,
identifies, and predicts at degrees of freedom that no sensor reads: accelerances, and the accelerations under a half-sine push and
the largest of them, whose truth comes from a matrix exponential. Of beams also the bending moment and the strain of a fibre at an
end of an element, whose truth is the element's own matrix times its motion. `--changes` adds natural frequencies and FRFs with a
mass that is added; `--frequencies` does nothing but these frequencies.

    python benchmarks/accuracy/predictions.py [--repeats 100] [--seed 0] [--tolerance 0.01] [--only chain] [--changes]
        [--frequencies]
"""

from __future__ import annotations

import argparse
import os
import time
from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.linalg import eigh, expm
from tolerances import DAMPING, RIGS, Rig, beam_matrices, frf_setup, matrices, receptances, truth

import structid as sid
from structid.prediction.changes import AddMass
from structid.prediction.predict import Prediction, predict_changes, predict_together
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
#: Random models behind a band, and lines of an FRF.
DRAWS, LINES = 200, 60
LOADED = {"chain": 4, "cantilever": 10, "beam on three supports": 7, "frame": 6}


@dataclass(frozen=True)
class Reading:
    """What is read at one point: its name in structid, and its rows over displacements and accelerations (n_dofs,)."""

    name: str
    of_displacement: np.ndarray
    of_acceleration: np.ndarray


def readings(rig: Rig, values: dict[str, float]) -> list[Reading]:
    """Accelerations where no sensor is, and of beams the moment and the strain of a fibre at the first end of an element."""
    one, none = np.eye(len(rig.dofs)), np.zeros(len(rig.dofs))
    found = [Reading(dof, none, one[rig.index(dof)]) for dof in UNSEEN[rig.name]]
    if rig.name not in ("cantilever", "beam on three supports"):
        return found
    zone, place, number = READ
    k_unit, m_unit = beam_matrices(LENGTH)
    rows = np.zeros((2, len(rig.dofs)))
    for column, dof in enumerate([f"{number}Y", f"{number}RZ", f"{number + 1}Y", f"{number + 1}RZ"]):
        rows[0, rig.index(dof)] = -values[f"bending_stiffness[{zone}]"] * k_unit[1, column]
        rows[1, rig.index(dof)] = -values[f"mass[{zone}]"] * m_unit[1, column]
    to_strain = -HEIGHT / values[f"bending_stiffness[{zone}]"]
    moment = Reading(f"M[{zone}:{place}@{number}]", rows[0], rows[1])
    strain = Reading(f"strain[{zone}:{place}@{number} y={HEIGHT}]", to_strain * rows[0], to_strain * rows[1])
    return [*found, moment, strain]


def true_frf(rig: Rig, m, k, c, frequency: np.ndarray, read: list[Reading]) -> np.ndarray:
    """Magnitudes of the FRFs of what is read, (n_frequencies, n_readings)."""
    motion = receptances(rig, m, k, c, frequency)
    of_displacement = np.array([each.of_displacement for each in read]).T
    of_acceleration = np.array([each.of_acceleration for each in read]).T
    return np.abs(motion @ of_displacement - ((2 * np.pi * frequency) ** 2)[:, None] * motion @ of_acceleration)


def true_history(rig: Rig, m, k, c, force: np.ndarray, rate: float, read: list[Reading]) -> np.ndarray:
    """What is read from rest under a force that runs in straight lines between samples, (n_times, n_readings)."""
    n = len(m)
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(m, k.real), -np.linalg.solve(m, c)]])
    b = np.concatenate([np.zeros(n), np.linalg.solve(m, np.eye(n)[rig.index(rig.load)])])
    whole = np.zeros((2 * n + 2, 2 * n + 2))
    whole[: 2 * n, : 2 * n], whole[: 2 * n, 2 * n], whole[2 * n, 2 * n + 1] = a / rate, b / rate, 1.0
    step = expm(whole)
    of_displacement = np.array([each.of_displacement for each in read])
    of_acceleration = np.array([each.of_acceleration for each in read])
    output = np.hstack([of_displacement, np.zeros((len(read), n))]) + of_acceleration @ a[n:]
    direct = of_acceleration @ b[n:]
    state, history = np.zeros(2 * n), np.zeros((len(force), len(read)))
    history[0] = direct * force[0]
    for i, (first, second) in enumerate(pairwise(force), 1):
        state = step[: 2 * n, : 2 * n] @ state + step[: 2 * n, 2 * n] * first + step[: 2 * n, -1] * (second - first)
        history[i] = output @ state + direct * second
    return history


def loss_as_viscous(m: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Viscous damping that takes as much energy at each resonance as the imaginary part of the stiffness."""
    squares, shapes = eigh(k.real, m)
    lost = np.einsum("im,ij,jm->m", shapes, k.imag, shapes) / np.sqrt(squares)
    turned = m @ shapes
    return turned @ np.diag(lost) @ turned.T


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
    at = np.arange(400) / rate
    return 100 * np.where(at < 0.02, np.sin(np.pi * at / 0.02), 0.0), rate


Inside = dict[str, list[np.ndarray]]


def identified(rig: Rig, tolerance: float, *seeds: list[int]) -> tuple[sid.Identification, dict[str, float]]:
    """An identification from noisy FRFs with wrong fixed values, and the true values; one seed, or one of each."""
    generators = [np.random.default_rng(seed) for seed in seeds]
    values, _, gain = truth(rig, generators[0], tolerance)
    options = sid.IdentifyOptions(tolerances=Tolerances(tolerance, tolerance, DAMPING, tolerance))
    setup = frf_setup(rig, values, gain, generators[-1], 0.01)
    return sid.identify_together([setup], options), values


def inside(predicted: Prediction, true: np.ndarray) -> np.ndarray:
    """A mask of the true values that the band holds."""
    true = true.reshape(predicted.low.shape)
    return (predicted.low <= true) & (true <= predicted.high)


def repeat_responses(rig: Rig, found: sid.Identification, values: dict[str, float], seed: int, masks: Inside) -> None:
    """FRFs, histories and their maxima of one identification; loss factors act on histories as viscous dampings."""
    read, (m, k, c) = readings(rig, values), matrices(rig, values)
    names, frequency, (force, rate) = [each.name for each in read], np.linspace(*rig.band, LINES), push(rig)
    history = History(names, [rig.load], force[:, None], rate)
    quantities = Frf(names, [rig.load], frequency), history, Maxima(history)
    frf, moved, largest = predict_together(found, quantities, n_draws=DRAWS, seed=seed)
    true = true_history(rig, m, k, c + loss_as_viscous(m, k), force, rate, read)
    parts = (
        ("FRF", inside(frf, true_frf(rig, m, k, c, frequency, read))[..., 0]),
        ("history", inside(moved, true)[1:]),
        ("maximum", inside(largest, np.abs(true).max(axis=0))),
    )
    n_motions = len(UNSEEN[rig.name])
    for what, mask in parts:
        masks[what].append(mask[..., :n_motions].ravel())
        for column, element in enumerate(("moment", "strain")[: len(read) - n_motions], n_motions):
            masks[f"{what} of {element}"].append(mask[..., column].ravel())


def repeat_changes(
    rig: Rig, found: sid.Identification, values: dict[str, float], seed: int, masks: Inside, has_frfs: bool = True
) -> None:
    """Natural frequencies, and FRFs where asked for, before and after a mass is added, and the difference."""
    m, k, c = matrices(rig, values)
    frequency, read = np.linspace(*rig.band, LINES), readings(rig, values)[: len(UNSEEN[rig.name])]
    node, mass = LOADED[rig.name], 0.05 * rig.structure.mass_of()
    heavy = with_mass(rig, m, node, mass)

    def hertz(m: np.ndarray) -> np.ndarray:
        return np.sqrt(eigh(k.real, m, eigvals_only=True)[:3]) / (2 * np.pi)

    quantities = [NaturalModes(3), *([Frf(UNSEEN[rig.name], [rig.load], frequency)] if has_frfs else [])]
    of_modes, *of_frfs = predict_changes(found, quantities, [AddMass(node, mass)], n_draws=DRAWS, seed=seed)
    first, second = (true_frf(rig, each, k, c, frequency, read) for each in (m, heavy))
    for of_frf in of_frfs:
        masks["FRF + mass"].append(inside(of_frf.after, second).ravel())
        masks["change of FRF"].append(inside(of_frf.difference, second - first).ravel())
    for what, predicted, true in (
        ("hertz", of_modes.before, hertz(m)),
        ("hertz + mass", of_modes.after, hertz(heavy)),
        ("change of hertz", of_modes.difference, hertz(heavy) - hertz(m)),
    ):
        masks[what].append((predicted.low[:, 0] <= true) & (true <= predicted.high[:, 0]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tolerance", type=float, default=0.01)
    parser.add_argument("--only", nargs="+", default=list(RIGS), choices=list(RIGS))
    parser.add_argument("--changes", action="store_true")
    parser.add_argument("--frequencies", action="store_true")
    chosen = parser.parse_args()
    print(
        f"inside the 95 % band, %; {chosen.repeats} repeats from seed {chosen.seed}, fixed values off by {chosen.tolerance:g}"
    )
    whole: Inside = defaultdict(list)
    for name in chosen.only:
        masks: Inside = defaultdict(list)
        begun, rig = time.process_time(), RIGS[name]()
        for seed in range(chosen.seed, chosen.seed + chosen.repeats):
            if chosen.frequencies:  # the errors of the structures are independent
                found, values = identified(rig, chosen.tolerance, [seed, sorted(UNSEEN).index(rig.name)])
                repeat_changes(rig, found, values, seed, masks, has_frfs=False)
                continue
            found, values = identified(rig, chosen.tolerance, [seed], [seed + 10_000])
            repeat_responses(rig, found, values, seed, masks)
            if chosen.changes:
                repeat_changes(rig, found, values, seed, masks)
        each = (time.process_time() - begun) / chosen.repeats
        print_row(name, masks, f"{each:.2f} s each")
        for what, parts in masks.items():
            whole[what] += parts
    print_row("all", whole, "")


def print_row(name: str, masks: Inside, words: str) -> None:
    cells = "  ".join(f"{what} {100 * np.concatenate(parts).mean():.1f}" for what, parts in masks.items())
    print(f"{name:24s} {cells}  {words}", flush=True)


if __name__ == "__main__":
    main()
