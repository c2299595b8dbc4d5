"""Right models whose fixed values are wrong by their tolerance: are they called wrong, and do intervals hold?

Truths are simulated by this file's own matrices: springs and masses, Euler-Bernoulli beams and a portal frame. Each repeat draws
every fixed mass, stiffness and damping, and the gain of the record, about what the model says, with the tolerance as the standard
deviation. `--states` identifies two states with the same draws, of which the second has one stiffness 5 % lower.

    python benchmarks/accuracy/tolerances.py [--repeats 40] [--seed 0] [--tolerance 0.005 0.02] [--states] [--exact]
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.linalg import eigh, expm

import structid as sid
from structid.core.dof import parse_dofs
from structid.diagnose.verdict import judged
from structid.identification.setups.setup import AnySetup
from structid.modal import ModalRecord
from structid.modal.modal_record import independent_errors
from structid.unknowns.tolerances import Tolerances

DAMPING = 0.3


@dataclass(frozen=True)
class Part:
    """A property of the truth: its nominal value and the matrix that one unit of it weighs; damping is structural where `loss`."""

    name: str
    value: float
    kind: str  # "mass", "stiffness", "viscous"
    matrix: np.ndarray
    loss: str = ""


@dataclass(frozen=True)
class Rig:
    """A structure, its model, and where it is measured."""

    name: str
    structure: sid.Structure
    parts: tuple[Part, ...]
    losses: dict[str, float]
    unknown: tuple[sid.Unknown, ...]
    dofs: tuple[str, ...]
    sensors: tuple[str, ...]
    load: str
    band: tuple[float, float]
    changed: str
    held_losses: tuple[str, ...] = field(default=())

    def index(self, dof: str) -> int:
        return self.dofs.index(dof)


def matrices(rig: Rig, values: dict[str, float]):
    """Mass, stiffness (complex with loss factors) and viscous damping."""
    n = len(rig.dofs)
    m, k, c = np.zeros((n, n)), np.zeros((n, n), dtype=complex), np.zeros((n, n))
    for part in rig.parts:
        value = values[part.name]
        if part.kind == "mass":
            m += value * part.matrix
        elif part.kind == "viscous":
            c += value * part.matrix
        else:
            k += value * (1 + 1j * values.get(part.loss, 0.0)) * part.matrix
    return m, k, c


def between(n: int, i: int, j: int | None = None) -> np.ndarray:
    jump = np.zeros(n)
    jump[i] = 1.0
    if j is not None:
        jump[j] = -1.0
    return np.outer(jump, jump)


def chain(n: int = 6) -> Rig:
    """Masses on springs with dashpots; every second spring and one dashpot are unknown."""
    mass, spring, dash = (
        [2.0 + 0.3 * i for i in range(n)],
        [4e4 - 3e3 * i for i in range(n)],
        [8.0 + i for i in range(n)],
    )
    sets: list = [sid.PointMass(f"m{i + 1}", [i + 1], mass=mass[i]) for i in range(n)]
    parts = [Part(f"mass[m{i + 1}]", mass[i], "mass", between(n, i)) for i in range(n)]
    for i in range(n):
        below = f"{i}X" if i else None
        sets.append(sid.Spring(f"k{i + 1}", f"{i + 1}X", second=below, stiffness=spring[i]))
        sets.append(sid.Dashpot(f"c{i + 1}", f"{i + 1}X", second=below, viscous_damping=dash[i]))
        matrix = between(n, i, i - 1 if i else None)
        parts += [Part(f"stiffness[k{i + 1}]", spring[i], "stiffness", matrix)]
        parts += [Part(f"viscous_damping[c{i + 1}]", dash[i], "viscous", matrix)]
    structure = sid.Structure({i + 1: float(i + 1) for i in range(n)}, sets, active=["X"])
    unknown = [sid.Unknown("stiffness", f"k{i}") for i in (1, 3, 5)]
    unknown += [sid.Unknown("viscous_damping", [f"c{i + 1}" for i in range(n)], name="all")]
    return Rig(
        "chain", structure, tuple(parts), {}, tuple(unknown), tuple(f"{i + 1}X" for i in range(n)), ("1X", "3X", "4X", "6X"),
        "6X", (3.0, 45.0), "stiffness[k3]",
    )  # fmt: skip


def beam_matrices(length: float) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness for EI = 1 and mass for 1 kg/m of an Euler-Bernoulli element, degrees of freedom Y RZ Y RZ."""
    h = length
    k = np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                  [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]) / h**3  # fmt: skip
    m = np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2],
                  [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]]) * h / 420  # fmt: skip
    return k, m


def beam(cantilever: bool) -> Rig:
    """A cantilever, or a beam on three supports of which the middle one is a spring; three bending stiffnesses are unknown."""
    n_elements, h = 12, 0.15
    nodes = {i: [h * i, 0.0] for i in range(n_elements + 1)}
    zones = {"a": range(4), "b": range(4, 8), "c": range(8, 12)}
    fixed = ["0Y", "0RZ"] if cantilever else ["0Y", f"{n_elements}Y"]
    dofs = tuple(d for i in range(n_elements + 1) for d in (f"{i}Y", f"{i}RZ") if d not in fixed)
    n = len(dofs)
    k_unit, m_unit = beam_matrices(h)
    bending, mass = {"a": 900.0, "b": 880.0, "c": 920.0}, {"a": 2.35, "b": 2.36, "c": 2.34}
    parts, sets = [], []

    def spread(unit: np.ndarray, elements) -> np.ndarray:
        total = np.zeros((n, n))
        for e in elements:
            own = [f"{e}Y", f"{e}RZ", f"{e + 1}Y", f"{e + 1}RZ"]
            at = [(k, dofs.index(d)) for k, d in enumerate(own) if d in dofs]
            for p, i in at:
                for q, j in at:
                    total[i, j] += unit[p, q]
        return total

    for zone, elements in zones.items():
        table = [[e, e + 1] for e in elements]
        sets.append(sid.Beam(zone, table, mass=mass[zone], bending_stiffness=bending[zone], loss_factor=0.01))
        parts.append(Part(f"bending_stiffness[{zone}]", bending[zone], "stiffness", spread(k_unit, elements), "loss"))
        parts.append(Part(f"mass[{zone}]", mass[zone], "mass", spread(m_unit, elements)))
    point = dofs.index("8Y")
    sets.append(sid.PointMass("block", [8], mass=0.8))
    parts.append(Part("mass[block]", 0.8, "mass", between(n, point)))
    if not cantilever:
        sets.append(sid.Spring("middle", "5Y", stiffness=5e4))
        parts.append(Part("stiffness[middle]", 5e4, "stiffness", between(n, dofs.index("5Y"))))
    structure = sid.Structure(nodes, sets, fixed=fixed, active=["Y", "RZ"])
    unknown = [sid.Unknown("bending_stiffness", zone) for zone in zones]
    unknown += [sid.Unknown("loss_factor", list(zones), name="all")]
    name = "cantilever" if cantilever else "beam on three supports"
    return Rig(
        name, structure, tuple(parts), {"loss": 0.01}, tuple(unknown), dofs, ("2Y", "4Y", "7Y", "10Y"), "7Y",
        (2.0, 160.0) if cantilever else (10.0, 400.0), "bending_stiffness[b]",
    )  # fmt: skip


def frame() -> Rig:
    """A portal of two columns and a girder that bend and stretch; the columns' stiffnesses and the girder's mass are unknown."""
    per, height, span = 4, 2.0, 3.0
    points = [(0.0, height * i / per) for i in range(per + 1)]
    points += [(span * i / per, height) for i in range(1, per + 1)]
    points += [(span, height * (per - i) / per) for i in range(1, per + 1)]
    nodes = {i: list(p) for i, p in enumerate(points)}
    last = len(points) - 1
    sets, parts = [], []
    fixed = [f"{i}{d}" for i in (0, last) for d in ("X", "Y", "RZ")]
    dofs = tuple(f"{i}{d}" for i in range(last + 1) for d in ("X", "Y", "RZ") if f"{i}{d}" not in fixed)
    n = len(dofs)
    spans = {"left": range(per), "girder": range(per, 2 * per), "right": range(2 * per, 3 * per)}
    stiff = {"left": 2.0e4, "girder": 3.0e4, "right": 2.1e4}
    weights = {"left": 2.5, "girder": 4.0, "right": 2.6}
    axial = {"left": 4e7, "girder": 5e7, "right": 4e7}
    for zone, elements in spans.items():
        bend, stretch, inert = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
        for e in elements:
            a, b = np.array(points[e]), np.array(points[e + 1])
            h = float(np.linalg.norm(b - a))
            cos, sin = (b - a) / h
            turn = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
            whole = np.kron(np.eye(2), turn)
            k_unit, m_unit = beam_matrices(h)
            across = [1, 2, 4, 5]
            kb, ks, mm = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((6, 6))
            kb[np.ix_(across, across)] = k_unit
            mm[np.ix_(across, across)] = m_unit
            ks[np.ix_([0, 3], [0, 3])] = np.array([[1, -1], [-1, 1]]) / h
            mm[np.ix_([0, 3], [0, 3])] += np.array([[2, 1], [1, 2]]) * h / 6
            own = [f"{node}{d}" for node in (e, e + 1) for d in ("X", "Y", "RZ")]
            at = [(k, dofs.index(d)) for k, d in enumerate(own) if d in dofs]
            for total, unit in ((bend, kb), (stretch, ks), (inert, mm)):
                turned = whole.T @ unit @ whole
                for p, i in at:
                    for q, j in at:
                        total[i, j] += turned[p, q]
        table = [[e, e + 1] for e in elements]
        sets.append(sid.Beam(zone, table, mass=weights[zone], bending_stiffness=stiff[zone], axial_stiffness=axial[zone],
                             loss_factor=0.01))  # fmt: skip
        parts.append(Part(f"bending_stiffness[{zone}]", stiff[zone], "stiffness", bend, "loss"))
        parts.append(Part(f"axial_stiffness[{zone}]", axial[zone], "stiffness", stretch, "loss"))
        parts.append(Part(f"mass[{zone}]", weights[zone], "mass", inert))
    structure = sid.Structure(nodes, sets, fixed=fixed)
    unknown = [
        sid.Unknown("bending_stiffness", "left"),
        sid.Unknown("bending_stiffness", "right"),
        sid.Unknown("mass", "girder"),
    ]
    unknown += [sid.Unknown("loss_factor", list(spans), name="all")]
    return Rig(
        "frame", structure, tuple(parts), {"loss": 0.01}, tuple(unknown), dofs, ("2X", "4X", "6Y", "10X"), "4X", (3.0, 110.0),
        "bending_stiffness[left]",
    )  # fmt: skip


RIGS: dict[str, Callable[[], Rig]] = {
    "chain": chain, "cantilever": lambda: beam(True), "beam": lambda: beam(False), "frame": frame,
}  # fmt: skip


def sought(rig: Rig) -> dict[str, tuple[str, ...]]:
    """Of each parameter's name the properties of the truth that it is."""
    held = {part.name for part in rig.parts}
    found = {}
    for name in sid.parameters(rig.structure, rig.unknown).names:
        if name in held:
            found[name] = (name,)
        elif name.startswith("loss_factor"):
            found[name] = ("loss",)
        else:
            found[name] = tuple(part.name for part in rig.parts if part.kind == "viscous")
    return found


def truth(rig: Rig, rng: np.random.Generator, tolerance: float) -> tuple[dict[str, float], dict[str, float], float]:
    """Values of all properties, of the parameters, and the gain of the record."""
    names = sought(rig)
    of_unknown = {own for several in names.values() for own in several}
    values = {part.name: part.value for part in rig.parts} | rig.losses
    for part in rig.parts:
        if part.name not in of_unknown:
            spread = DAMPING * (tolerance > 0) if part.kind == "viscous" else tolerance
            values[part.name] *= (
                np.exp(spread * rng.standard_normal()) if part.kind == "viscous" else 1 + spread * rng.standard_normal()
            )
    for name in rig.losses.keys() - of_unknown:
        values[name] *= np.exp(DAMPING * (tolerance > 0) * rng.standard_normal())
    factors = {name: float(f) for name, f in zip(names, rng.uniform(0.85, 1.15, len(names)), strict=True)}
    for name, several in names.items():
        for own in several:
            values[own] *= factors[name]
    start = dict(zip(names, sid.parameters(rig.structure, rig.unknown).start, strict=True))
    wanted = {
        name: start[name] * factors[name] if len(several) > 1 else values[several[0]] for name, several in names.items()
    }
    return values, wanted, 1 + tolerance * rng.standard_normal()


def responses(rig: Rig, values: dict[str, float], frequency: np.ndarray) -> np.ndarray:
    """Accelerance at the sensors, (n_frequencies, n_sensors, 1)."""
    motion = receptances(rig, *matrices(rig, values), frequency)
    return -((2 * np.pi * frequency) ** 2)[:, None, None] * motion[:, [rig.index(d) for d in rig.sensors], None]


def receptances(rig: Rig, m, k, c, frequency: np.ndarray) -> np.ndarray:
    """Motion of all degrees of freedom under a unit force at the load, (n_frequencies, n_dofs)."""
    s = 2j * np.pi * frequency
    z = s[:, None, None] ** 2 * m + s[:, None, None] * c + k
    unit = np.zeros((len(rig.dofs), 1))
    unit[rig.index(rig.load)] = 1.0
    return np.linalg.solve(z, np.broadcast_to(unit, (len(s), *unit.shape)))[..., 0]


def frf_setup(rig, values, gain, rng, noise: float) -> sid.Setup:
    frequency = np.linspace(*rig.band, 200)
    clean = gain * responses(rig, values, frequency)
    sigma = noise * np.abs(clean) + noise * np.sqrt((np.abs(clean) ** 2).mean())
    error = sigma * (rng.standard_normal(clean.shape) + 1j * rng.standard_normal(clean.shape)) / np.sqrt(2)
    record = sid.FrfRecord(frequency, clean + error, rig.sensors, [rig.load], "accelerance", variance=sigma**2)
    return sid.Setup(rig.structure, sid.parameters(rig.structure, rig.unknown), record)


def modes_setup(rig, values, gain, rng, noise: float) -> sid.ModalSetup:
    m, k, _ = matrices(rig, values)
    squares, shapes = eigh(k.real, m)
    frequency = np.sqrt(squares) / (2 * np.pi)
    used = np.flatnonzero((frequency > rig.band[0]) & (frequency < rig.band[1]))[:5]
    sensors = np.array([rig.index(d) for d in rig.sensors])
    shape = shapes[np.ix_(sensors, used)]
    shape = shape / np.abs(shape).max(axis=0)
    f_std, s_std = 0.1 * noise * frequency[used], np.full(shape.shape, noise)
    f = frequency[used] + f_std * rng.standard_normal(len(used))
    shape = shape + s_std * rng.standard_normal(shape.shape)
    none = np.full(len(used), np.nan)
    channels = parse_dofs(rig.sensors)
    record = ModalRecord(f, none, shape, channels, independent_errors(np.concatenate([f_std, none])), s_std)
    unknown = [u for u in rig.unknown if u.property not in ("loss_factor", "viscous_damping")]
    return sid.ModalSetup(rig.structure, sid.parameters(rig.structure, unknown), record)


def time_setup(rig, values, gain, rng, noise: float) -> sid.TimeSetup:
    """A random force that runs straight between samples, of a structure with viscous damping."""
    m, k, c = matrices(rig, values)
    n, n_steps, rate = len(rig.dofs), 2048, 4 * rig.band[1]
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(m, k.real), -np.linalg.solve(m, c)]])
    b = np.zeros(2 * n)
    b[n:] = np.linalg.solve(m, np.eye(n)[rig.index(rig.load)])
    dt = 1 / rate
    size = 2 * n
    whole = np.zeros((size + 2, size + 2))
    whole[:size, :size], whole[:size, size], whole[size, size + 1] = a * dt, b * dt, 1.0
    step = expm(whole)
    phi, g0, g1 = step[:size, :size], step[:size, size] - step[:size, size + 1], step[:size, size + 1]
    force = rng.standard_normal(n_steps)
    state, outputs = np.zeros(size), np.zeros((n_steps, len(rig.sensors)))
    sensors = [rig.index(d) for d in rig.sensors]
    for i in range(n_steps):
        outputs[i] = (a @ state + b * force[i])[n:][sensors]
        if i + 1 < n_steps:
            state = phi @ state + g0 * force[i] + g1 * force[i + 1]
    sigma = noise * np.sqrt((outputs**2).mean(axis=0))
    measured = gain * outputs + sigma * rng.standard_normal(outputs.shape)
    small = 1e-3 * np.sqrt((force**2).mean())
    read = force + small * rng.standard_normal(n_steps)
    record = sid.TimeRecord(
        rate, np.column_stack([read, measured]), (rig.load, *rig.sensors), ("force", *["acceleration"] * len(rig.sensors)),
        variance=np.array([small**2, *sigma**2]),
    )  # fmt: skip
    return sid.TimeSetup(rig.structure, sid.parameters(rig.structure, rig.unknown), record, sid.TimeFit(hold="first"))


SETUPS = {"frf": frf_setup, "modes": modes_setup, "time": time_setup}


@dataclass
class Told:
    """What repeats gave."""

    held: list[np.ndarray] = field(default_factory=list)
    held_noise: list[np.ndarray] = field(default_factory=list)
    verdicts: list[str] = field(default_factory=list)
    misfits: list[float] = field(default_factory=list)


def repeat(rig: Rig, kind: str, tolerance: float, seed: int, options: sid.IdentifyOptions, told: Told) -> None:
    rng = np.random.default_rng(seed)
    values, wanted, gain = truth(rig, rng, tolerance)
    judge(SETUPS[kind](rig, values, gain, rng, 0.01), wanted, options, told)


def judge(setup: AnySetup, wanted: dict[str, float], options: sid.IdentifyOptions, told: Told) -> None:
    """Identify from one record, and note which intervals hold the values wanted, and the verdict."""
    found = sid.identify_together([setup], options)
    estimate = found.estimate
    true = np.array([wanted[name] for name in estimate.names])
    low, high = estimate.interval().T
    told.held.append((low <= true) & (true <= high))
    told.held_noise.append(np.abs(estimate.values - true) <= 1.96 * estimate.std_noise)
    told.verdicts.append(judged(found).verdict)
    told.misfits.append(estimate.goodness.misfit)


def two_states(
    rig: Rig, kind: str, tolerance: float, seed: int, options: sid.IdentifyOptions
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whether the intervals of changes hold, whether each is declared, and which truly changed."""
    rng = np.random.default_rng(seed)
    values, wanted, gain = truth(rig, rng, tolerance)
    later = values | {rig.changed: 0.95 * values[rig.changed]}
    states = [
        sid.identify_together([SETUPS[kind](rig, own, gain, rng, 0.01)], options).estimate for own in (values, later)
    ]
    compared = sid.compare_states(*states)
    change = np.array([-0.05 * wanted[name] if name == rig.changed else 0.0 for name in compared.names])
    inside = np.abs(compared.change - change) <= 1.96 * compared.std
    return inside, compared.changed, change != 0


def planned_errors(rig: Rig, tolerance: float, seeds: range, options: sid.IdentifyOptions) -> np.ndarray:
    """Errors of identified values over the deviations that `plan` gives them, (n_seeds, n_params); they are as the model begins."""
    nominal = {part.name: part.value for part in rig.parts} | rig.losses
    unknown, frequency = sid.parameters(rig.structure, rig.unknown), np.linspace(*rig.band, 200)
    absolute = 0.01 * np.sqrt((np.abs(responses(rig, nominal, frequency)) ** 2).mean())
    test = sid.PlanOptions(
        frequency, rig.sensors, [rig.load], n_sensors=len(rig.sensors), relative_noise=0.01, absolute_noise=absolute
    )
    expected = sid.plan(rig.structure, unknown, test, options.tolerances).chosen.std_with_tolerances
    errors = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        values, _, gain = truth(rig, rng, tolerance)
        values |= {name: nominal[name] for several in sought(rig).values() for name in several}
        clean = gain * responses(rig, values, frequency)
        sigma = np.hypot(0.01 * np.abs(clean), absolute)
        noise = sigma * (rng.standard_normal(clean.shape) + 1j * rng.standard_normal(clean.shape)) / np.sqrt(2)
        record = sid.FrfRecord(frequency, clean + noise, rig.sensors, [rig.load], "accelerance", variance=sigma**2)
        found = sid.identify(rig.structure, unknown, record, options).estimate
        errors.append(found.values / unknown.start - 1)
    return np.array(errors) / expected


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tolerance", type=float, nargs="+", default=[0.005, 0.02])
    parser.add_argument("--states", action="store_true")
    parser.add_argument("--plan", action="store_true", help="errors over what `structid plan` predicts of them")
    parser.add_argument("--only", nargs="+", default=None, help="such as chain/frf")
    chosen = parser.parse_args()
    print("structure                record tolerance  hold %  noise %  sound approx  wrong misfit")
    whole, whole_states = {t: Told() for t in chosen.tolerance}, {t: [] for t in chosen.tolerance}
    for name, made in RIGS.items():
        rig = made()
        for kind in SETUPS:
            if (kind == "time" and name != "chain") or (chosen.only and f"{name}/{kind}" not in chosen.only):
                continue
            for tolerance in chosen.tolerance:
                options = sid.IdentifyOptions(tolerances=Tolerances(tolerance, tolerance, DAMPING, tolerance))
                if chosen.plan:
                    if kind == "frf":
                        seeds = range(chosen.seed, chosen.seed + chosen.repeats)
                        errors = planned_errors(rig, tolerance, seeds, options)
                        sizes = "  ".join(f"{size:.2f}" for size in np.sqrt((errors**2).mean(axis=0)))
                        print(f"{rig.name:24} {tolerance:9.3f} rms error over plan, each value: {sizes}", flush=True)
                    continue
                if chosen.states:
                    pairs = [
                        two_states(rig, kind, tolerance, seed, options)
                        for seed in range(chosen.seed, chosen.seed + chosen.repeats)
                    ]
                    inside, declared, changed = (np.array(own) for own in zip(*pairs, strict=True))
                    false = (declared & ~changed).any(axis=1)
                    whole_states[tolerance].append((inside, false, declared[changed]))
                    states_row(rig.name, kind, tolerance, inside, false, declared[changed])
                    continue
                told, begun = Told(), time.process_time()
                for seed in range(chosen.seed, chosen.seed + chosen.repeats):
                    repeat(rig, kind, tolerance, seed, options, told)
                row(rig.name, kind, tolerance, told, (time.process_time() - begun) / chosen.repeats)
                for key in vars(told):
                    getattr(whole[tolerance], key).extend(getattr(told, key))
    for tolerance, rows in whole_states.items():
        if rows:
            inside, false, found = (
                np.concatenate([own.ravel() for own in several]) for several in zip(*rows, strict=True)
            )
            states_row("all", "", tolerance, inside, false, found)
    for tolerance, told in whole.items() if not (chosen.states or chosen.plan) else ():
        row("all", "", tolerance, told, float("nan"))


def states_row(
    name: str, kind: str, tolerance: float, inside: np.ndarray, false: np.ndarray, found: np.ndarray
) -> None:
    print(
        f"{name:24} {kind:6} {tolerance:9.3f} changes inside {100 * inside.mean():5.1f} %, a false declaration in"
        f" {100 * false.mean():4.1f} % of {false.size}, the true change declared in {100 * found.mean():5.1f} %", flush=True,
    )  # fmt: skip


def row(name: str, kind: str, tolerance: float, told: Told, seconds: float) -> None:
    held, noise = (100 * np.concatenate(own).mean() for own in (told.held, told.held_noise))
    counts = [told.verdicts.count(v) for v in ("sound", "approximate", "wrong_model")]
    other = len(told.verdicts) - sum(counts)
    print(
        f"{name:24} {kind:6} {tolerance:9.3f} {held:7.1f} {noise:8.1f} {counts[0]:6} {counts[1]:6} {counts[2]:6}"
        f" {np.median(told.misfits):.3f}  {seconds:.2f} s{f'; {other} undetermined' if other else ''}", flush=True,
    )  # fmt: skip


if __name__ == "__main__":
    main()
