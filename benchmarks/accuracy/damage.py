"""Locating a 10 % loss of stiffness in one of 15 beam elements; every repeat counts.

The beam of Norris (1986), chapter 3 (free-free, Table 3.1), loss factor 0.01. Receptances of five transverse sensors to
one load, 200 logarithmically spaced lines over the first eight elastic modes, noise of 1 % of each value. For each seed a
baseline is measured, and masses and stiffnesses of all elements are identified from starts 10 % off (log-normal); then
every element in turn loses 10 %, and so does none. Each later state is measured afresh and identified from the baseline,
whose result with its covariance is the prior of the masses. An element counts as located where it, and only it, is declared.

Seed k draws the baseline from (k, 0), element e from (k, e), and the undamaged repeat from (k, 16). Results go to a file
line by line, so that a run that was stopped goes on.

    python benchmarks/accuracy/damage.py [--repeats 100] [--undamaged 300] [--level 0.01] [--out damage.jsonl]
"""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import replace
from functools import cache
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import structid as sid
from structid.compare.states import carried, unchanged_parameters
from structid.dynamics.normal_modes import modes
from structid.inversion.covariance import inverse_information
from structid.inversion.diagnostics.residual_tests import detectable
from structid.inversion.estimate import estimate
from structid.inversion.state_comparison import Comparison, compare_states
from structid.reproduce.chapter_3 import ACTUAL, N_ELEMENTS, beam

SENSORS, LOAD, N_LINES, LOSS, NOISE = (1, 5, 9, 13, 16), 1, 200, 0.1, 0.01
UNDAMAGED = N_ELEMENTS + 1


@cache
def structure() -> sid.Structure:
    return beam(ACTUAL, {"loss_factor": np.full(N_ELEMENTS, 0.01)})


@cache
def axis() -> np.ndarray:
    """Lines from below the first elastic mode to above the eighth, Hz."""
    found = modes(structure().matrix("mass"), structure().matrix("stiffness"), None, None, 10).frequency
    return np.geomspace(0.8 * found[2], 1.05 * found[9], N_LINES)


@cache
def unknown(masses: bool = True) -> sid.Parameters:
    """Stiffness, and mass, of every element; the truth of the baseline is where they start."""
    kinds = ("mass", "bending_stiffness") if masses else ("bending_stiffness",)
    return sid.parameters(structure(), [sid.Unknown(kind, "beam", each=True) for kind in kinds])


def damaged(element: int) -> sid.Parameters:
    """Parameters whose start is the true state with element 1 to 15 damaged; another number damages none."""
    truth = np.array(unknown().start)
    if 1 <= element <= N_ELEMENTS:
        truth[N_ELEMENTS + element - 1] *= 1 - LOSS
    return unknown().started_at(truth)


def template(sensors: tuple[int, ...] = SENSORS, loads: tuple[int, ...] = (LOAD,)) -> sid.FrfRecord:
    shape = (N_LINES, len(sensors), len(loads))
    outputs, inputs = (tuple(sid.parse_dof(f"{n}Y") for n in nodes) for nodes in (sensors, loads))
    return sid.FrfRecord(axis(), np.ones(shape, complex), outputs, inputs, "receptance")


def measured(truth: sid.Parameters, rng: np.random.Generator) -> sid.FrfRecord:
    """A record with noise of 1 % of each value, declared as such on the noisy values."""
    noisy = sid.simulated_record(structure(), truth, template(), NOISE, rng)
    return sid.with_declared_noise(noisy, relative=NOISE)


def baseline_of(seed: int) -> sid.Estimate:
    rng = np.random.default_rng((seed, 0))
    record = measured(damaged(0), rng)
    start = unknown().started_at(unknown().start * np.exp(0.1 * rng.standard_normal(unknown().n_params)))
    problem = sid.FrfProblem(structure(), start, record)
    return estimate(problem, plans=problem.schedules(), search=sid.Search(restarts=2, seed=seed))


def state(seed: int, case: int, baseline: sid.Estimate) -> sid.Estimate:
    """The later state `case` of a seed: an element's number, or 16 for none."""
    record = measured(damaged(case), np.random.default_rng((seed, case)))
    prior = carried(baseline, unknown(), unchanged_parameters(baseline, unknown(), ["mass"]))
    return estimate(sid.FrfProblem(structure(), prior, record))


def compared(seed: int, case: int, baseline: sid.Estimate, level: float) -> Comparison:
    names = unchanged_parameters(baseline, unknown(), ["mass"])
    return compare_states(baseline, state(seed, case, baseline), names, level)


def line(seed: int, case: int, found: Comparison) -> dict[str, object]:
    return {
        "seed": seed, "case": case, "level": found.level, "status": found.status.value,
        "declared": (np.flatnonzero(found.changed) + 1).tolist(), "p": found.p_values.tolist(),
        "change": found.relative_change.tolist(), "std": found.relative_std.tolist(),
    }  # fmt: skip


def run(repeats: int, undamaged: int, level: float, out: Path) -> list[dict[str, object]]:
    """All cases, those in `out` taken from there."""
    done = [json.loads(text) for text in out.read_text().splitlines()] if out.exists() else []
    done = [row for row in done if row["level"] == level]
    known = {(row["seed"], row["case"]) for row in done}
    with out.open("a") as stream:
        for seed in range(max(repeats, undamaged)):
            cases = [*(range(1, N_ELEMENTS + 1) if seed < repeats else ()), *([UNDAMAGED] if seed < undamaged else ())]
            missing = [case for case in cases if (seed, case) not in known]
            if not missing:
                continue
            baseline = baseline_of(seed)
            for case in missing:
                done.append(line(seed, case, compared(seed, case, baseline, level)))
                stream.write(json.dumps(done[-1]) + "\n")
                stream.flush()
    return done


def bound(
    sensors: tuple[int, ...], loads: tuple[int, ...], masses: bool, relative: bool = True
) -> tuple[sid.FrfProblem, np.ndarray]:
    """Problem and Cramer-Rao standard deviations of the stiffnesses as parts of their values.

    Noise is 1 % of each value, or of each channel's rms over the lines.
    """
    clean = sid.simulated_record(structure(), unknown(), template(sensors, loads))
    size = np.abs(clean.values)
    if not relative:
        size = np.broadcast_to(np.sqrt((size**2).mean(axis=0, keepdims=True)), size.shape)
    record = replace(clean, variance=(NOISE * size) ** 2, noise_source="declared")
    problem = sid.FrfProblem(structure(), unknown(masses), record)
    covariance = inverse_information(problem.linearize(problem.theta_start).jacobian)
    return problem, np.sqrt(np.diag(covariance))[-N_ELEMENTS:]


def report_located(done: list[dict[str, object]], repeats: int, undamaged: int, level: float) -> None:
    """Located share of every element and the rate of false alarms."""
    print(f"located: the damaged element and only it declared, Holm at {100 * level:g} %; aim at least 95 % an element")
    print("  element   located   missed   others too   change found, mean   its std, median")
    worst = 1.0
    for element in range(1, N_ELEMENTS + 1):
        rows = [row for row in done if row["case"] == element and row["seed"] < repeats]
        right = sum(row["declared"] == [element] and row["status"] == "converged" for row in rows)
        missed = sum(element not in row["declared"] for row in rows)
        change = 100 * np.mean([row["change"][element - 1] for row in rows])
        std = 100 * np.median([row["std"][element - 1] for row in rows])
        worst = min(worst, right / len(rows))
        print(
            f"  {element:7d} {right:5d}/{len(rows):<4d} {missed:6d} {len(rows) - right - missed:10d}"
            f" {change:18.2f} % {std:15.2f} %"
        )
    rows = [row for row in done if row["case"] == UNDAMAGED and row["seed"] < undamaged]
    alarms = sum(bool(row["declared"]) for row in rows)
    print(f"worst element: {100 * worst:.0f} % located")
    print(
        f"undamaged repeats: {alarms} false alarms in {len(rows)} ({100 * alarms / len(rows):.1f} %), aim at most 5 %"
    )
    for other in (0.05, 0.01, 0.001):
        false = sum(min(np.array(row["p"]) * N_ELEMENTS) <= other for row in rows)
        print(f"  at a level of {100 * other:g} %: {false} of {len(rows)} ({100 * false / len(rows):.1f} %)")
    statuses = [row["status"] for row in done]
    print("ended: " + ", ".join(f"{name} {statuses.count(name)}" for name in sorted(set(statuses))))


def report_bounds(level: float) -> None:
    """The Cramer-Rao bound with either noise, and the refusal of what cannot carry the damage."""
    _, known = bound(SENSORS, (LOAD,), masses=False)
    print(f"Cramer-Rao bound, 1 % of each value, masses known: {100 * known.max():.2f} % at worst (aim 0.7 %)")
    problem, refused = bound(SENSORS, (LOAD,), masses=False, relative=False)
    print(f"Cramer-Rao bound, 1 % of each channel's rms, masses known: {100 * refused.max():.0f} % at worst")
    rng = np.random.default_rng(0)
    noise = np.sqrt(problem.record.variance / 2)
    noise = noise * (rng.standard_normal(noise.shape) + 1j * rng.standard_normal(noise.shape))
    record = replace(problem.record, values=problem.record.values + noise)
    ended = estimate(replace(problem, record=record))
    print(f"  identification from such a record (seed 0): status {ended.status.value}, aim not_identifiable")
    factor = np.sqrt(2) * detectable(N_ELEMENTS, level, 0.9)
    print(
        f"  a change of {100 * LOSS:g} % in any element is declared with probability 0.9 from two states that each have"
    )
    print("  (masses known; averages: how many times those behind 1 % of the rms)")
    print("  sensors loads   worst std   averages needed")
    everywhere = tuple(range(1, N_ELEMENTS + 2))
    for sensors, loads in (
        (SENSORS, (LOAD,)),
        (everywhere, (LOAD,)),
        (everywhere, (1, 8, 16)),
        (everywhere, everywhere),
    ):
        worst = bound(sensors, loads, masses=False, relative=False)[1].max()
        averages = np.ceil((worst * factor / LOSS) ** 2)
        print(f"  {len(sensors):7d} {len(loads):5d} {100 * worst:9.1f} % {averages:14,.0f}")


def main() -> None:
    """Print bounds, located shares and false alarms."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=100, help="seeds with damage, from 0")
    parser.add_argument("--undamaged", type=int, default=300, help="seeds without damage, from 0")
    parser.add_argument("--level", type=float, default=0.01, help="family-wise level of the test")
    parser.add_argument("--out", type=Path, default=Path("damage.jsonl"), help="results, one a line; resumed")
    chosen = parser.parse_args()
    print(
        f"{chosen.repeats} seeds an element and {chosen.undamaged} without damage, from 0; load {LOAD}Y, sensors {SENSORS}"
    )
    report_bounds(chosen.level)
    done = run(chosen.repeats, chosen.undamaged, chosen.level, chosen.out)
    report_located(done, chosen.repeats, chosen.undamaged, chosen.level)


if __name__ == "__main__":
    main()
