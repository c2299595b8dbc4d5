"""Single faults: what each does to the true structure or to the readings, and which causes name it.

A fault is written `kind where size`; see `FAULTS` and README.md. Structural faults change the table of the true structure;
faults of the record change its readings, before noise or after it; the rest are settings of the test or of the study.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from wrong_models.assembly import STIFFNESSES, Table, count, find, row, sets, split
from wrong_models.rigs import Rig, plain, viscous


@dataclass(frozen=True)
class Fault:
    """`size` is a number or a text, by the kind."""

    kind: str
    where: str
    size: str = ""

    @property
    def amount(self) -> float:
        return float(self.size)

    def __str__(self) -> str:
        return f"{self.kind} {self.where} {self.size}".strip()


@dataclass(eq=False)
class Readings:
    """A record before it is written; channels of motion lie along axis 1.

    Attributes
    ----------
    axis : (n,) array
        Hz of lines or modes, s of samples.
    motion : (n, n_sensors[, n_loads]) array
        FRFs, samples, or mode shapes.
    sensors, loads : list of str
    force : (n, n_loads) array, optional
        Of histories.
    coherence, averages, damping, std : optional
        Coherence of FRFs and the number of averages; damping ratios of modes; standard deviations of their shapes.
    """

    axis: np.ndarray
    motion: np.ndarray
    sensors: list[str]
    loads: list[str]
    force: np.ndarray | None = None
    coherence: np.ndarray | None = None
    averages: int = 0
    damping: np.ndarray | None = None
    std: np.ndarray | None = None


# --- the structure ------------------------------------------------------------------------------------------------


def new_node(table: Table, at: int) -> int:
    """Another node at the place of node `at`."""
    node = 9000 + len(table["nodes"])
    table["nodes"][node] = list(table["nodes"][at])
    return node


def add(table: Table, kind: str, **own: object) -> None:
    """One more element of a set of its own."""
    table.setdefault(kind, []).append({"name": f"fault {len(table.get(kind, ()))}", **own})


def support(table: Table, where: str, size: str) -> None:
    """A held degree of freedom rests on a spring."""
    table["fixed"].remove(where)
    add(table, "spring", first=[where], stiffness=float(size))


def joint(table: Table, where: str, size: str) -> None:
    """The end of a beam ("columns:3/4RZ") turns against its node on a spring; 0 is a hinge."""
    element, dof = where.split("/")
    name, number = element.split(":")
    node, direction = split(dof)
    own = find(table, name)[1]
    other = new_node(table, node)
    ends = list(own["nodes"][int(number) - 1])
    own["nodes"] = [list(e) for e in own["nodes"]]
    own["nodes"][int(number) - 1] = [other if end == node else end for end in ends]
    shared = [d for d in table["active"] if d != direction]
    table.setdefault("ties", {}).update({f"{other}{d}": f"{node}{d}" for d in shared})
    add(table, "spring", first=[dof], second=[f"{other}{direction}"], stiffness=float(size))


def mass(table: Table, where: str, size: str) -> None:
    """A mass at a node that the model does not have (negative: that it has too much)."""
    add(table, "point_mass", nodes=[int(where)], mass=float(size))


def inertia(table: Table, where: str, size: str) -> None:
    """A rotary inertia at a rotation that the model does not have (negative: that it has too much)."""
    node, direction = split(where)
    add(table, "rotary_inertia", nodes=[node], direction=direction, rotary_inertia=float(size))


def dashpot(table: Table, where: str, size: str) -> None:
    """A dashpot to the ground."""
    add(table, "dashpot", first=[where], viscous_damping=float(size))


def friction(table: Table, where: str, size: str) -> None:
    """Dry friction to the ground, N; the force of the shaker is 10 N rms."""
    table.setdefault("friction", []).append((where, float(size)))


def appendage(table: Table, where: str, size: str) -> None:
    """A mass on a spring of its own, "0.3@45": 0.3 kg tuned to 45 Hz, with 1 % of critical damping."""
    heavy, tuned = (float(part) for part in size.split("@"))
    node, direction = split(where)
    other, omega = new_node(table, node), 2 * np.pi * tuned
    ends = {"first": [where], "second": [f"{other}{direction}"]}
    add(table, "spring", **ends, stiffness=heavy * omega**2)
    add(table, "dashpot", **ends, viscous_damping=0.02 * heavy * omega)
    add(table, "point_mass", nodes=[other], mass=heavy, directions=[direction])


def shear(table: Table, where: str, size: str) -> None:
    """The beams of sets ("left,right") shear; G A_s in N."""
    for name in where.split(","):
        find(table, name)[1]["shear_stiffness"] = float(size)


def untied(table: Table, where: str, size: str) -> None:
    """One element of a set differs from the others: "girder:2" "bending_stiffness*0.7"; `stiffness` is all of them."""
    (name, number), (wanted, factor) = where.split(":"), size.split("*")
    kind, own = find(table, name)
    for key in STIFFNESSES[kind] if wanted == "stiffness" else (wanted,):
        values = np.array(np.broadcast_to(own[key], count(own)), dtype=float)
        values[int(number) - 1] *= float(factor)
        own[key] = values.tolist()


def scatter(table: Table, where: str, size: str) -> None:
    """Every element has a stiffness and a mass of its own, which differ by `size` (rms, relative)."""
    rng = np.random.default_rng(1)
    for kind, own in sets(table):
        for key in (*STIFFNESSES.get(kind, ()), "mass"):
            if key in own:
                own[key] = (own[key] * (1 + float(size) * rng.standard_normal(count(own)))).tolist()


def mesh(table: Table, where: str, size: str) -> None:
    """The beams of sets ("left,right") are parted into `size` elements each."""
    parts = int(size)
    for name in where.split(","):
        own = find(table, name)[1]
        rows, ends = [], []
        for i in range(count(own)):
            a, b = own["nodes"][i]
            chain = [a, *(new_node(table, a) for _ in range(parts - 1)), b]
            for k, node in enumerate(chain[1:-1], 1):
                span = np.subtract(table["nodes"][b], table["nodes"][a])
                table["nodes"][node] = (np.array(table["nodes"][a]) + span * k / parts).tolist()
            ends += [list(pair) for pair in pairwise(chain)]
            rows += [row(own, i)] * parts
        for key, value in own.items():
            if isinstance(value, list):
                own[key] = [one[key] for one in rows]
        own["nodes"] = ends


STRUCTURAL: dict[str, Callable[[Table, str, str], None]] = {
    made.__name__: made
    for made in (support, joint, mass, inertia, dashpot, friction, appendage, shear, untied, scatter, mesh)
}


def changed(rig: Rig, faults: tuple[Fault, ...]) -> Table:
    """The true structure with its faults."""
    swapped = any(fault.kind == "damping_law" for fault in faults)
    table = copy.deepcopy(viscous(rig).table if swapped else rig.table)
    for fault in faults:
        if fault.kind in STRUCTURAL:
            STRUCTURAL[fault.kind](table, fault.where, fault.size)
    return table


def other_state(table: Table, fault: Fault) -> Table:
    """The structure as it was in the record that belongs to another state: "columns:bending_stiffness*0.9"."""
    name, key, factor = re.fullmatch(r"(\w+):(\w+)\*([\d.]+)", fault.size).groups()  # type: ignore[union-attr]
    made = copy.deepcopy(table)
    own = find(made, name)[1]
    own[key] = plain(np.broadcast_to(own[key], count(own)) * float(factor))
    return made


# --- the readings -------------------------------------------------------------------------------------------------


def _gain(made: Readings, fault: Fault) -> None:
    made.motion[:, made.sensors.index(fault.where)] *= fault.amount


def _load_gain(made: Readings, fault: Fault) -> None:
    at = made.loads.index(fault.where)
    if made.force is not None:
        made.force[:, at] *= fault.amount
    else:
        made.motion[:, :, at] /= fault.amount


def _unit(made: Readings, fault: Fault) -> None:
    """Readings in another unit than stated; of a sensor, of a load, or of all sensors."""
    if fault.where in made.loads and fault.where not in made.sensors:
        _load_gain(made, fault)
    elif fault.where == "all":
        made.motion *= fault.amount
    else:
        _gain(made, fault)


def _delay(made: Readings, fault: Fault) -> None:
    """A sensor that is late, or a load (which is not also a sensor)."""
    of_load = fault.where not in made.sensors
    at = (made.loads if of_load else made.sensors).index(fault.where)
    if made.force is None:
        place, sign = (np.s_[:, :, at], 1) if of_load else (np.s_[:, at], -1)
        made.motion[place] *= np.exp(sign * 2j * np.pi * made.axis * fault.amount)[:, None]
        return
    values = made.force if of_load else made.motion
    whole = np.concatenate([values[:, at], np.zeros(len(made.axis))])
    frequency = np.fft.rfftfreq(len(whole), made.axis[1] - made.axis[0])
    late = np.fft.irfft(np.fft.rfft(whole) * np.exp(-2j * np.pi * frequency * fault.amount), len(whole))
    values[:, at] = late[: len(made.axis)]


def _polarity(made: Readings, fault: Fault) -> None:
    made.motion[:, made.sensors.index(fault.where)] *= -1


def _swap(made: Readings, fault: Fault) -> None:
    a, b = made.sensors.index(fault.where), made.sensors.index(fault.size)
    made.motion[:, [a, b]] = made.motion[:, [b, a]]


def _load_swap(made: Readings, fault: Fault) -> None:
    made.motion = made.motion[:, :, ::-1].copy()


BEFORE_NOISE: dict[str, Callable[[Readings, Fault], None]] = {
    "sensor_gain": _gain, "load_gain": _load_gain, "unit": _unit, "delay": _delay, "polarity": _polarity, "swap": _swap,
    "load_swap": _load_swap,
}  # fmt: skip


def _outlying(made: Readings, fault: Fault, rng: np.random.Generator) -> None:
    """Mains at `where` Hz and its multiples, `size` times the rms of each channel."""
    base = float(fault.where)
    level = fault.amount * np.sqrt((abs(made.motion) ** 2).mean(axis=0))
    if made.force is not None:
        made.motion += level * np.sqrt(2) * np.sin(2 * np.pi * base * made.axis + 1.0)[:, None]
        return
    for number in range(1, int(made.axis[-1] / base) + 1):
        at = int(np.argmin(abs(made.axis - number * base)))
        made.motion[at] += level * np.exp(2j * np.pi * rng.random(level.shape))


def _channel(made: Readings, fault: Fault, rng: np.random.Generator) -> None:
    """A channel with much noise (in parts of its rms), or dead: nothing but its own noise."""
    at = made.sensors.index(fault.where)
    own = made.motion[:, at]
    level = np.sqrt((abs(own) ** 2).mean())
    noise = rng.standard_normal(own.shape)
    if np.iscomplexobj(own):
        noise = (noise + 1j * rng.standard_normal(own.shape)) / np.sqrt(2)
    made.motion[:, at] = 0.02 * level * noise if fault.size == "dead" else own + fault.amount * level * noise


def _clipping(made: Readings, fault: Fault, rng: np.random.Generator) -> None:
    """A channel whose amplifier ends at a part of its largest value."""
    at = made.sensors.index(fault.where)
    limit = fault.amount * abs(made.motion[:, at]).max()
    made.motion[:, at] = np.clip(made.motion[:, at], -limit, limit)


def _extra_mode(made: Readings, fault: Fault, rng: np.random.Generator) -> None:
    """A mode that the structure does not have, at `where` Hz."""
    at = int(np.searchsorted(made.axis, float(fault.where)))
    made.motion = np.insert(made.motion, at, rng.standard_normal(len(made.sensors)), axis=0)
    made.axis = np.insert(made.axis, at, float(fault.where))
    for name in ("damping", "std"):
        values = getattr(made, name)
        setattr(made, name, np.insert(values, at, values[0], axis=0))


AFTER_NOISE: dict[str, Callable[[Readings, Fault, np.random.Generator], None]] = {
    "outlying_lines": _outlying, "channel": _channel, "clipping": _clipping, "extra_mode": _extra_mode,
}  # fmt: skip

#: Settings: of the test (`window`, `direction`, `record`), of the study (`noise_level`), or of the whole model.
SETTINGS = ("window", "direction", "record", "noise_level", "damping_law")
FAULTS = (*STRUCTURAL, *BEFORE_NOISE, *AFTER_NOISE, *SETTINGS)


# --- which causes name a fault --------------------------------------------------------------------------------------

#: Other kinds of cause that say the same of the same place.
SAME: dict[str, tuple[str, ...]] = {
    "unit": ("sensor_gain", "load_gain"), "polarity": ("direction",),
}  # fmt: skip


def accepted(fault: Fault, table: Table) -> list[dict[str, object]]:
    """Causes that count as right: kind and what their place must name, all of it; an empty list: any place."""
    kinds = ("channel",) if fault.kind == "clipping" else (fault.kind, *SAME.get(fault.kind, ()))
    if fault.kind == "scatter":
        kinds = ("untied", "mass")
    anywhere = ("scatter", "mesh", "damping_law", "window", "noise_level", "outlying_lines", "extra_mode", "load_swap")
    places: list[list[str]]
    if fault.kind in anywhere or fault.where == "all":
        places = [[]]
    elif fault.kind == "joint":
        element, dof = fault.where.split("/")
        node = str(split(dof)[0])
        meeting = [
            f"{own['name']}:{i + 1}"
            for kind in ("beam", "space_beam")
            for own in table.get(kind, ())
            for i, ends in enumerate(own["nodes"])
            if int(node) in ends
        ]
        places = [[one, node] for one in (meeting if len(meeting) == 2 else [element])]
    elif fault.kind == "swap":
        places = [[fault.where, fault.size]]
    elif fault.kind == "shear":
        places = [[name] for name in fault.where.split(",")]
    else:
        places = [[fault.where]]
    return [{"kind": kind, "where": place} for kind in kinds for place in places]
