"""Structures, true parameters and records of `broad_band.py`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

import structid as sid
from structid.core.arrays import FloatArray
from structid.core.dof import parse_dofs
from structid.reproduce.chapter_3 import ACTUAL
from structid.reproduce.chapter_4 import CASE_1

NOISE = 0.01
FINE = np.arange(1, 85001) * 1e-3
#: Of impacts: samples per second, of which one in ten is kept; length of the record and of the pulse, s.
RATE, LENGTH, PULSE, KEPT = 1000.0, 600.0, 0.08, 10


@dataclass(frozen=True, eq=False)
class Case:
    """A structure with true parameters, and the record that it would give without noise.

    With `impact`, force and accelerations of a hammer impact, the FRFs are made from those.
    """

    structure: sid.Structure
    truth: sid.Parameters
    clean: sid.FrfRecord
    impact: FloatArray | None = None


def beam(mass: FloatArray, stiffness: FloatArray, length: float, fixed: tuple[str, ...]) -> sid.Structure:
    """Beam elements on a line, of equal length."""
    count = len(mass)
    elements = sid.Beam(
        "beam",
        [[i, i + 1] for i in range(count)],
        mass,
        stiffness,
        mass_damping=0.01 * mass,
        stiffness_damping=0.001 * stiffness,
    )
    return sid.Structure({i: i * length / count for i in range(count + 1)}, [elements], fixed)


def uneven(count: int, seed: int) -> FloatArray:
    """Values around 1, uneven by about 30 %."""
    return np.exp(0.3 * np.random.default_rng([seed, count]).standard_normal(count))


def plane_frame(bays: int = 2, storeys: int = 3) -> sid.Structure:
    """A frame of columns and girders, 1 m a member, clamped at its feet; axial stiffness known and high."""
    nodes = {
        row * (bays + 1) + column: (float(column), float(row))
        for row in range(storeys + 1)
        for column in range(bays + 1)
    }
    members = [[r * (bays + 1) + c, (r + 1) * (bays + 1) + c] for r in range(storeys) for c in range(bays + 1)]
    members += [[r * (bays + 1) + c, r * (bays + 1) + c + 1] for r in range(1, storeys + 1) for c in range(bays)]
    mass, stiffness = uneven(len(members), 1), uneven(len(members), 2)
    elements = sid.Beam(
        "frame",
        members,
        mass,
        stiffness,
        axial_stiffness=300.0,
        mass_damping=0.01 * mass,
        stiffness_damping=0.001 * stiffness,
    )
    feet = tuple(f"{c}{direction}" for c in range(bays + 1) for direction in ("X", "Y", "RZ"))
    return sid.Structure(nodes, [elements], feet)


@cache
def case(name: str, n_lines: int) -> Case:
    """The case of that name; 0 lines stands for 0.001-85 rad/s in steps of 0.001, others are equally spaced."""
    values, struck = CASE_1.actual, name.startswith("impact_")
    name = name.removeprefix("impact_")
    if name == "cantilever":
        structure, sensors, load = beam(values[:6], values[6:], 6.0, ("0Y", "0RZ")), ("6Y+",), "6Y+"
    elif name == "free_beam":
        structure, sensors, load = beam(ACTUAL[:15], ACTUAL[15:], 15.0, ()), ("0Y+", "15Y+"), "15Y+"
    elif name.startswith("cantilever_"):
        _, elements, count = name.split("_")
        n, m = int(elements), int(count)
        structure = beam(uneven(n, 1), uneven(n, 2), float(n), ("0Y", "0RZ"))
        sensors, load = tuple(f"{round(n * (k + 1) / m)}Y+" for k in range(m)), f"{n}Y+"
    elif name.startswith("frame_"):
        structure, m = plane_frame(), int(name.split("_")[1])
        sensors, load = ("11X+", "9Y+", "7X+", "10Y+", "3X+", "8RZ+", "4X+", "5Y+", "6X+", "9X+")[:m], "11X+"
    else:
        raise SystemExit(f"there is no case {name!r}")
    families = [element.name for element in structure.elements]
    truth = sid.parameters(
        structure,
        [
            sid.Unknown(p, family, each=True, factor=False)
            for p in ("mass", "bending_stiffness", "stiffness_damping")
            for family in families
        ],
    )
    omega = FINE if n_lines == 0 else np.arange(1, n_lines + 1) * FINE[-1] / n_lines
    blank = np.ones((len(omega), len(sensors), 1), dtype=np.complex128)
    like = sid.FrfRecord(omega / (2 * np.pi), blank, sensors, (load,), "receptance")
    clean = sid.simulated_record(structure, truth, like)
    return Case(structure, truth, clean, impact(structure, sensors, load) if struck else None)


def impact(structure: sid.Structure, sensors: tuple[str, ...], load: str) -> FloatArray:
    """Force and accelerations after a smooth pulse, sampled so that nothing aliases, (n_times, 1 + n_sensors)."""
    time = np.arange(round(LENGTH * RATE)) / RATE
    force = np.where(time < PULSE, np.sin(np.pi * time / PULSE) ** 4, 0.0)
    where = structure.selection(parse_dofs((load,))).toarray()
    matrices = (structure.matrix(kind) for kind in ("mass", "stiffness", "damping"))
    mass, stiffness, damping = matrices
    motion = sid.sampled_transient(mass, stiffness, where, force[:, None], RATE, damping)
    read = motion.acceleration @ structure.selection(parse_dofs(sensors)).toarray()
    return np.column_stack([force, read])[::KEPT]


def measured(one: Case, rng: np.random.Generator) -> sid.FrfRecord:
    """The record with noise: of 1 % of each FRF value, or of 1 % of each time channel's largest value."""
    if one.impact is None:
        return sid.simulated_record(one.structure, one.truth, one.clean, NOISE, rng)
    std = NOISE * np.abs(one.impact).max(axis=0)
    return _from_rest(one.clean, one.impact + std * rng.standard_normal(one.impact.shape), std)


def _from_rest(like: sid.FrfRecord, signals: FloatArray, std: FloatArray) -> sid.FrfRecord:
    """FRFs from the transforms of a record that starts and ends at rest, its force known to be 0 after the pulse."""
    step = KEPT / RATE
    kept = np.ones(signals.shape)
    kept[step * np.arange(len(signals)) > PULSE, 0] = 0.0
    lines = np.arange(1, int(0.4 * len(signals)) + 1)
    found = step * np.fft.rfft(signals * kept, axis=0)[lines]
    noise = step**2 * kept.sum(axis=0) * std**2
    values = found[:, 1:] / found[:, :1]
    variance = (noise[1:] + np.abs(values) ** 2 * noise[0]) / np.abs(found[:, :1]) ** 2
    frequency = lines / (step * len(signals))
    record = sid.FrfRecord(
        frequency, values[:, :, None], like.outputs, like.inputs, "accelerance", variance[:, :, None],
        noise_source="declared",
    )  # fmt: skip
    return record.band(0.0, FINE[-1] / (2 * np.pi))
