"""Properties that a model holds: how often is one of a right model doubted, and is a wrong one told before it misleads?

Buildings of five to nine floors with random masses and stiffnesses, three measured modes at a part of the floors. The ground's
springs and those of the lower storeys are unknown; masses, the roof and the upper storeys are held, and in the second half of the
studies the upper storeys are not what the model says. Studies state a tolerance of 0: intervals take what is held as exact. The
matrices are this file's own.

    python benchmarks/accuracy/held_values.py [--repeats 200]
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.linalg import eigh

from structid.diagnose.verdict import is_sound
from structid.modal import ModalRecord
from structid.modal.formats.files import write_modes
from structid.modal.modal_record import independent_errors
from structid.study.run.diagnosis import diagnose_study
from structid.study.run.run import run_prepared
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study

FREQUENCY_ERROR, SHAPE_ERROR = 2e-3, 0.02
#: Of what the model says of the upper storeys, what they are.
FACTORS = (0.9, 0.95, 0.97, 1.03, 1.05, 1.1)


@dataclass
class Told:
    """What was said of a study: whether it was sound without, its verdict, the first change, coverage of 95 % intervals."""

    was_sound: bool
    verdict: str
    first: str
    held_before: int
    held_after: int


def study(folder: Path, seed: int, factor: float) -> tuple[Path, dict[str, float]]:
    """The path of a study and its truth, by name."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(5, 10))
    lower = int(rng.integers(2, n - 1))  # storeys of one unknown
    mass, roof = rng.uniform(4, 8), rng.uniform(2, 5)
    ground, below, above = rng.uniform(5e3, 1.2e4, 3)
    k = np.array([ground, *[below] * (lower - 1), *[factor * above] * (n - lower)])
    stiffness = np.diag(k + np.append(k[1:], 0.0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    squares, shapes = eigh(stiffness, np.diag([mass] * (n - 1) + [roof]))
    sensors = np.sort(rng.choice(n, size=min(n, 4), replace=False))
    frequency, shapes = np.sqrt(squares[:3]) / (2 * np.pi), shapes[sensors, :3]
    shapes = shapes / np.abs(shapes).max(axis=0)
    std = FREQUENCY_ERROR * frequency
    frequency = frequency + std * rng.standard_normal(3)
    shapes = shapes + SHAPE_ERROR * rng.standard_normal(shapes.shape)
    errors = independent_errors(np.concatenate([std, np.full(3, 1e-3)]))
    channels = [f"{i + 1}X" for i in sensors]
    record = ModalRecord(frequency, np.full(3, 0.01), shapes, channels, errors, np.full(shapes.shape, SHAPE_ERROR))
    write_modes(folder / "modes.json", record)
    starts = rng.uniform(0.9, 1.1, 2) * (ground, below)
    (folder / "study.toml").write_text(_text(n, lower, mass, roof, *starts, above), encoding="utf-8")
    return folder / "study.toml", {"stiffness[ground]": ground, "stiffness[lower]": below}


def _text(n: int, lower: int, mass: float, roof: float, ground: float, below: float, above: float) -> str:
    nodes = "\n".join(f"{i} = {float(i)}" for i in range(1, n + 1))
    sets = [("lower", range(1, lower), below), ("upper", range(lower, n), above)]
    springs = "\n".join(
        f'[[structure.spring]]\nname = "{name}"\nfirst = {[f"{i}X" for i in of]}\nsecond = {[f"{i + 1}X" for i in of]}\n'
        f"stiffness = {value}\n"
        for name, of, value in sets
    )
    return f"""
[structure]
active = ["X"]
tolerance = 0

[structure.nodes]
{nodes}

[[structure.point_mass]]
name = "floors"
nodes = {list(range(1, n))}
mass = {mass}

[[structure.point_mass]]
name = "roof"
nodes = [{n}]
mass = {roof}

[[structure.spring]]
name = "ground"
first = "1X"
stiffness = {ground}

{springs}
[[unknown]]
property = "stiffness"
elements = "ground"

[[unknown]]
property = "stiffness"
elements = "lower"

[record]
path = "modes.json"

[record.modes]

[method]
restarts = 0
"""


def told(seed: int, factor: float) -> Told:
    with tempfile.TemporaryDirectory() as name:
        path, truth = study(Path(name), seed, factor)
        ready = prepare_study(load_study(path))
        before = run_prepared(ready)
        after, _ = diagnose_study(ready, before, explain=False)
    assert after.diagnosis is not None
    named = after.diagnosis.suggestions
    return Told(
        is_sound(before.identification),
        after.diagnosis.judgement.verdict,
        named[0].where[0] if named else "",
        _holding(before.identification.intervals.ends, before.estimate.names, truth),
        _holding(after.identification.intervals.ends, before.estimate.names, truth),
    )


def _holding(ends: np.ndarray, names: tuple[str, ...], truth: dict[str, float]) -> int:
    return sum(bool(low <= truth[name] <= high) for name, (low, high) in zip(names, ends, strict=True))


def row(title: str, answers: list[Told]) -> None:
    sound = [one for one in answers if one.was_sound]
    doubted = [one for one in sound if one.verdict == "approximate"]
    first = sum(one.first == "stiffness[upper]" for one in doubted)
    before, after = (
        100 * np.mean([part / 2 for part in parts] or [np.nan])
        for parts in ([one.held_before for one in sound], [one.held_after for one in sound])
    )
    left = [one.held_after / 2 for one in sound if one.verdict == "sound"]
    print(
        f"{title:28s} {len(answers):7d} {len(sound):7d} {len(doubted):8d} {first:12d} {before:10.1f} % {after:9.1f} %"
        f" {100 * np.mean(left or [np.nan]):13.1f} %",
        flush=True,
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=200, help="studies a row; seeds count on from row to row")
    repeats, begun = parser.parse_args().repeats, time.perf_counter()
    heads = "studies     fit  doubted  upper first  held before    held now     where sound"
    print(f"{'upper storeys':28s} {heads}")
    for number, factor in enumerate((1.0, *FACTORS)):
        seeds = range(number * repeats, (number + 1) * repeats)
        title = "as the model holds them" if factor == 1 else f"{factor:g} of what it holds"
        row(title, [told(seed, factor) for seed in seeds])
    print(f"seeds 0 to {(1 + len(FACTORS)) * repeats - 1}, {time.perf_counter() - begun:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
