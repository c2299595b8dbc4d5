"""Errors that a mode has in all records alike: do intervals hold what a state lost, and is a right model left alone?

Four masses on a cantilever, moved about in twelve arrangements, before and after one of them is lost; five frequencies of each,
simulated by the elements below, which share nothing with structid. The error of a frequency is set from the scatter of the fit,
so that its chi-square tells nothing.

    python benchmarks/accuracy/errors_in_common.py [--repeats 20] [--right 150]
"""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass, replace
from functools import cache

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy import linalg
from six_masses_model import ResonanceProblem

import structid as sid
from structid.inversion.state_comparison import LATER, states_problem

LENGTH, BENDING, CLAMP, CLAMP_INERTIA, ROTARY = 0.5, 48.0, 1900.0, 5e-5, 4e-6
MASSES = np.array([0.015, 0.013, 0.017, 0.014])
#: Places of the masses, in parts of the length, of which each arrangement has four.
PLACES = np.arange(1, 9) / 8
N_MODES, N_ARRANGEMENTS = 5, 12
#: What the first mass has left, its own part, and the independent error of a frequency.
LEFT, NOISE = 0.1, 0.001
NAMES = tuple(f"m{k}" for k in range(1, 5))


@dataclass(frozen=True)
class Case:
    """What is left out of the model, and what the frequencies have besides noise.

    Parameters
    ----------
    without : str
        Name of the element that the model lacks.
    bias : float
        Error of each mode, in parts, the same in all arrangements and in both states: standard deviation over repeats.
    of_state : float
        The same, another in the later state.
    masses : float
        Part by which each mode sees all masses otherwise: standard deviation over modes and repeats.
    """

    without: str = ""
    bias: float = 0.0
    of_state: float = 0.0
    masses: float = 0.0


CASES = {
    "right": Case(),
    "clamp's inertia left out": Case("clamp inertia"),
    "rotary inertia of the masses left out": Case("rotary"),
    "each mode 0.3 % off": Case(bias=0.003),
    "each mode of each state 0.3 % off": Case(of_state=0.003),
    "each mode sees the masses 10 % otherwise": Case(masses=0.1),
    "each mode sees the masses 20 % otherwise": Case(masses=0.2),
}


def arrangements() -> list[np.ndarray]:
    """Places of the four masses in each arrangement, m."""
    rng = np.random.default_rng(1986)
    return [LENGTH * rng.permutation(PLACES[:-1])[:4] for _ in range(N_ARRANGEMENTS)]


def frequencies(places: np.ndarray, masses: np.ndarray) -> np.ndarray:
    """Of the true beam (1 kg/m) by eighty elements, Hz."""
    n = 80
    h = LENGTH / n
    bend = (
        BENDING
        / h**3
        * np.array(
            [
                [12, 6 * h, -12, 6 * h],
                [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                [-12, -6 * h, 12, -6 * h],
                [6 * h, 2 * h**2, -6 * h, 4 * h**2],
            ]
        )
    )
    move = (
        h
        / 420
        * np.array(
            [
                [156, 22 * h, 54, -13 * h],
                [22 * h, 4 * h**2, 13 * h, -3 * h**2],
                [54, 13 * h, 156, -22 * h],
                [-13 * h, -3 * h**2, -22 * h, 4 * h**2],
            ]
        )
    )
    stiffness, mass = np.zeros((2 * n + 2,) * 2), np.zeros((2 * n + 2,) * 2)
    for k in range(n):
        own = slice(2 * k, 2 * k + 4)
        stiffness[own, own] += bend
        mass[own, own] += move
    stiffness[1, 1] += CLAMP
    mass[1, 1] += CLAMP_INERTIA
    for place, value in zip(np.round(places / h).astype(int), masses, strict=True):
        mass[2 * place, 2 * place] += value
        mass[2 * place + 1, 2 * place + 1] += ROTARY
    squared = linalg.eigh(stiffness[1:, 1:], mass[1:, 1:], eigvals_only=True, subset_by_index=[0, N_MODES - 1])
    return np.sqrt(squared) / (2 * np.pi)


@cache
def log_frequencies(arrangement: int, masses: tuple[float, ...]) -> np.ndarray:
    """Of the true beam with the masses of an arrangement."""
    return np.log(frequencies(arrangements()[arrangement], np.array(masses)))


@cache
def model(arrangement: int, without: str) -> tuple[sid.Structure, sid.Parameters]:
    """The model of one arrangement, with a node at every place that a mass can have, and all of it unknown."""
    places = arrangements()[arrangement]
    nodes = {k: (LENGTH * k / 16,) for k in range(17)}
    at = [int(k) for k in np.round(16 * places / LENGTH)]
    elements = [sid.Beam("beam", [(k, k + 1) for k in range(16)], 1.0, 45.0)]
    elements += [sid.PointMass(name, [k], 0.014) for name, k in zip(NAMES, at, strict=True)]
    elements.append(sid.Spring("clamp", "0RZ", stiffness=2000.0))
    if without != "rotary":
        elements.append(sid.RotaryInertia("rotary", at, 3e-6, "RZ"))
    if without != "clamp inertia":
        elements.append(sid.RotaryInertia("clamp inertia", [0], 4e-5, "RZ"))
    structure = sid.Structure(nodes, elements, ["0Y"])
    unknown = [sid.Unknown("bending_stiffness", "beam"), sid.Unknown("stiffness", "clamp")]
    unknown += [sid.Unknown("mass", name) for name in NAMES]
    unknown += [sid.Unknown("rotary_inertia", name) for name in ("rotary", "clamp inertia") if name != without]
    return structure, sid.parameters(structure, unknown)


def simulated(case: Case, rng: np.random.Generator) -> list[np.ndarray]:
    """Frequencies of the two states, (n_arrangements, n_modes) each, Hz."""
    after = MASSES * np.array([LEFT, 1.0, 1.0, 1.0])
    clean = np.array([[log_frequencies(k, tuple(masses)) for k in range(N_ARRANGEMENTS)] for masses in (MASSES, after)])
    seen = clean - np.log(frequencies(np.array([]), np.array([])))
    errors = case.bias * rng.standard_normal(N_MODES) + case.of_state * rng.standard_normal((2, 1, N_MODES))
    errors = errors + case.masses * rng.standard_normal(N_MODES) * seen + NOISE * rng.standard_normal(clean.shape)
    return list(np.exp(clean + errors))


def identified(case: Case, states: list[np.ndarray]) -> sid.Estimate:
    """Both states in one fit, the error of a frequency as large as their scatter."""
    error, start = NOISE, None
    modes = tuple(range(1, N_MODES + 1))
    for _ in range(2):
        parts = []
        for state in states:
            own = [ResonanceProblem(*model(k, case.without), f, modes, error) for k, f in enumerate(state)]
            parts.append(sid.JointProblem(tuple(own)))
        shared = [name for name in parts[0].names if name not in {f"mass[{m}]" for m in NAMES}]
        found = sid.estimate(states_problem(*parts, shared), search=sid.Search(start=start))
        error, start = error * float(np.sqrt(found.chi_square_per_dof)), found.theta
    return found


def loss(found: sid.Estimate, basis: str) -> tuple[float, float]:
    """Mass lost and its standard deviation, kg."""
    weights = np.array([n in {f"mass[{m}]" for m in NAMES} for n in found.names], float)
    weights -= np.array([n in {f"mass[{m}]{LATER}" for m in NAMES} for n in found.names], float)
    covariance = replace(found, spread=replace(found.spread, covariance_basis=basis)).covariance
    return float(weights @ found.values), float(np.sqrt(weights @ covariance @ weights))


def repeat(case: Case, seed: int) -> tuple[bool, bool, bool, bool, float, float]:
    """Whether modes disagree; whether 95 % hold the loss as told, by noise, by modes left out; half widths of the last two."""
    found = identified(case, simulated(case, np.random.default_rng(seed)))
    truth = (1 - LEFT) * MASSES[0]
    held, widths = [], []
    for basis in (found.covariance_basis, "noise", "model_error"):
        value, std = loss(found, basis)
        held.append(abs(value - truth) <= 1.96 * std)
        widths.append(1.96 * std / truth)
    return found.spread.disagreement is not None, *held, widths[1], widths[2]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=20, help="of each wrong model, seeds 0 on")
    parser.add_argument("--right", type=int, default=150, help="of the right model")
    chosen = parser.parse_args()
    print(
        "model | modes disagree | the loss inside 95 % as told (where they disagree), by noise, by modes | half widths, % of it"
    )
    for name, case in CASES.items():
        found = np.array([repeat(case, seed) for seed in range(chosen.repeats if case != Case() else chosen.right)])
        told = found[:, 0] > 0
        among = f"{100 * found[told, 1].mean():.0f} %" if told.any() else "-"
        print(
            f"{name:40s} | {told.sum():4d} of {len(told):4d} | {100 * found[:, 1].mean():5.1f} ({among}),"
            f" {100 * found[:, 2].mean():5.1f}, {100 * found[:, 3].mean():5.1f}"
            f" | {100 * found[:, 4].mean():.1f}, {100 * found[:, 5].mean():.1f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
