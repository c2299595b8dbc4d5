"""A study small enough to see through: three masses in a row, two sensors, 1 % noise."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from structid.records import FrfRecord
from structid.records.formats import write_record

TRUE = {
    "mass[mass 1]": 2.0,
    "mass[mass 2]": 3.0,
    "mass[mass 3]": 1.0,
    "stiffness[ground]": 1000.0,
    "stiffness[upper:1]": 1000.0,
    "stiffness[upper:2]": 1000.0,
    "loss_factor[springs]": 0.02,
    "viscous_damping[damper]": 3.0,
}
NOISE = 0.01

CHAIN = """\
title = "Chain of three masses"

[structure]
active = ["X"]
[structure.nodes]
1 = 0.0
2 = 1.0
3 = 2.0
[[structure.point_mass]]
name = "mass 1"
nodes = 1
mass = 2.4
[[structure.point_mass]]
name = "mass 2"
nodes = 2
mass = 2.4
[[structure.point_mass]]
name = "mass 3"
nodes = 3
mass = 1.2
[[structure.spring]]
name = "ground"
first = "1X"
stiffness = 1200.0
loss_factor = 0.03
[[structure.spring]]
name = "upper"
first = ["1X", "2X"]
second = ["2X", "3X"]
stiffness = 900.0
loss_factor = 0.03
[[structure.dashpot]]
name = "damper"
first = "1X"
viscous_damping = 2.0

[[unknown]]
property = "mass"
elements = "mass 1"
[[unknown]]
property = "mass"
elements = "mass 2"
[[unknown]]
property = "mass"
elements = "mass 3"
[[unknown]]
property = "stiffness"
elements = "ground"
[[unknown]]
property = "stiffness"
elements = "upper"
each = true
[[unknown]]
property = "loss_factor"
elements = ["ground", "upper"]
name = "springs"
[[unknown]]
property = "viscous_damping"
elements = "damper"

[record]
path = "frf.npz"
[record.noise]
relative = 0.01

[method]
band = [0.5, 12.0]
"""


def exact_frf(frequency: np.ndarray, outputs: list[int], loads: list[int]) -> np.ndarray:
    """Accelerance of the chain by inversion of its dynamic stiffness, written out."""
    stiffness = np.array([[2000.0, -1000, 0], [-1000, 2000, -1000], [0, -1000, 1000]]) * (1 + 0.02j)
    mass, damping = np.diag([2.0, 3.0, 1.0]), np.diag([3.0, 0.0, 0.0])
    omega = 2 * np.pi * frequency[:, None, None]
    dynamic = -(omega**2) * mass + 1j * omega * damping + stiffness
    return -(omega**2) * np.linalg.inv(dynamic)[:, outputs, :][:, :, loads]


def chain_record(seed: int = 0, scale: float = 1.0, **changes: object) -> FrfRecord:
    """Accelerances at masses 1 and 3 for a load on mass 3, with noise in proportion."""
    frequency = np.arange(0.5, 12, 0.05)
    values = exact_frf(frequency, [0, 2], [2])
    random = np.random.default_rng(seed)
    error = random.standard_normal(values.shape) + 1j * random.standard_normal(values.shape)
    noisy = scale * values * (1 + NOISE * error / np.sqrt(2))
    fields = {"frequency": frequency, "values": noisy, "outputs": ("1X", "3X"), "inputs": ("3X",)}
    return FrfRecord(**{**fields, "kind": "accelerance", **changes})  # type: ignore[arg-type]


def write_chain(folder: Path, text: str = CHAIN, record: FrfRecord | None = None) -> Path:
    """The study file, with its record beside it."""
    folder.mkdir(parents=True, exist_ok=True)
    write_record(folder / "frf.npz", chain_record() if record is None else record)
    path = folder / "chain.toml"
    path.write_text(text, encoding="utf-8")
    return path


def replaced(old: str, new: str, text: str = CHAIN) -> str:
    """`text` with one passage changed; the passage must be there."""
    assert old in text
    return text.replace(old, new, 1)


def complaints(stderr: str) -> list[str]:
    """Lines that a command in a process of its own wrote, without those of progress, one a minute on a busy machine."""
    return [line for line in stderr.splitlines() if not re.search(r"sum of squares \S+, iteration|: \d+ of \d+", line)]


def line_of(passage: str, text: str) -> int:
    """Line on which `passage` begins."""
    return text[: text.index(passage)].count("\n") + 1


#: Masses 2 and 3 on one rigid body: their sum is all that any measurement tells.
RIGID = replaced(
    "[[unknown]]",
    '[[structure.rigid_link]]\nname = "link"\nmain = 2\ndependents = [3]\n[[unknown]]',
    replaced('first = ["1X", "2X"]\nsecond = ["2X", "3X"]', 'first = "1X"\nsecond = "2X"'),
)


def rigid_record() -> FrfRecord:
    """What the two-mass chain of RIGID answers: 2 kg and 4 kg, both springs 1000 N/m."""
    frequency = np.arange(0.5, 12, 0.05)
    omega = 2 * np.pi * frequency[:, None, None]
    stiffness = np.array([[2000.0, -1000], [-1000, 1000]]) * (1 + 0.02j)
    dynamic = stiffness + 1j * omega * np.diag([3.0, 0]) - omega**2 * np.diag([2.0, 4.0])
    values = -(omega**2) * np.linalg.inv(dynamic)[:, :, [1]]
    random = np.random.default_rng(5)
    error = random.standard_normal(values.shape) + 1j * random.standard_normal(values.shape)
    return chain_record(values=values * (1 + NOISE * error / np.sqrt(2)))


def bare(folder, **changes) -> str:
    """A study on a bare NPZ, whose arrays are not checked when they are written."""
    record = chain_record()
    arrays = {"h": record.values[:, :, 0], "f": record.frequency, **changes}
    np.savez(folder / "bare.npz", **arrays)
    keys = 'array = "h"\nfrequency_array = "f"\noutputs = ["1X", "3X"]\ninputs = ["3X"]\nkind = "accelerance"'
    return replaced('path = "frf.npz"', f'path = "bare.npz"\n{keys}')


def with_nan(values: np.ndarray) -> np.ndarray:
    values = values.copy()
    values[7, 1] = np.nan
    return values


def free_text() -> str:
    return CHAIN.replace('[[structure.spring]]\nname = "ground"', '[[structure.spring]]\nname = "ground"', 1).replace(
        'name = "ground"\nfirst = "1X"', 'name = "ground"\nfirst = "1X"\nsecond = "2X"'
    )


def record_from_zero():
    record = chain_record()
    values = np.concatenate([np.full((1, 2, 1), 1e-9), record.values])
    return replace(record, frequency=np.append(0.0, record.frequency), values=values)
