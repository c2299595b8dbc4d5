"""Right models with wrong fixed values, on structures that `tolerances.py` has not: grillage, guyed mast, truss.

Truths are simulated by this file's own matrices: a grillage of girders and cross beams that bend and twist (FRFs), a mast under
its weight that stays hold (FRFs, modes, and modes that `identify_modes` takes from ambient motion), and a truss with nodal masses
(histories under a random force). Every fixed mass, stiffness and damping and the gain of the record is drawn about what the model
says. `--length` draws the scale of the drawing as well, which no tolerance carries.

    python benchmarks/accuracy/tolerances_elsewhere.py [--repeats 20] [--seed 0] [--tolerance 0.005 0.02] [--length 0.001]
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.linalg import eigh
from scipy.signal import cont2discrete, lfilter
from tolerances import (
    DAMPING,
    SETUPS,
    Part,
    Rig,
    Told,
    beam_matrices,
    between,
    judge,
    matrices,
    row,
    truth,
)

import structid as sid
from structid.unknowns.tolerances import Tolerances

#: Power of a common scale of all lengths by which each property of a line acts on translations, rotations times length.
LENGTH_POWERS = {
    "mass": 1, "bending_stiffness": -3, "bending_stiffness_y": -3, "torsional_stiffness": -3, "polar_inertia": -1,
    "axial_stiffness": -1, "axial_force": -1, "stiffness_damping": -1,
}  # fmt: skip


def assembled(dofs: tuple[str, ...], elements: list[tuple[list[str], np.ndarray]]) -> np.ndarray:
    """Sum of element matrices, each on the degrees of freedom named beside it; those not among `dofs` are held."""
    index = {dof: i for i, dof in enumerate(dofs)}
    total = np.zeros((len(dofs), len(dofs)))
    for names, matrix in elements:
        local = [k for k, name in enumerate(names) if name in index]
        rows = [index[names[k]] for k in local]
        total[np.ix_(rows, rows)] += matrix[np.ix_(local, local)]
    return total


def rod(h: float) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness for EA = 1 and consistent mass for 1 kg/m of a rod of length `h`."""
    return np.array([[1.0, -1.0], [-1.0, 1.0]]) / h, np.array([[2.0, 1.0], [1.0, 2.0]]) * h / 6


def string(h: float) -> np.ndarray:
    """Geometric stiffness of a beam element under a tension of 1 N, degrees of freedom w, slope, w, slope."""
    return np.array([[36, 3 * h, -36, 3 * h], [3 * h, 4 * h**2, -3 * h, -(h**2)],
                     [-36, -3 * h, 36, -3 * h], [3 * h, -(h**2), -3 * h, 4 * h**2]]) / (30 * h)  # fmt: skip


def grillage() -> Rig:
    """Two girders on four supports with three cross beams; bending of both girders and of the cross beams is unknown."""
    n, h, width = 8, 0.5, 1.2
    nodes = {100 * side + i: [h * i, width * side, 0.0] for side in (0, 1) for i in range(n + 1)}
    nodes |= {200 + i: [h * i, width / 2, 0.0] for i in (2, 4, 6)}
    tables = {f"girder{side + 1}": [[100 * side + i, 100 * side + i + 1] for i in range(n)] for side in (0, 1)}
    tables["cross"] = [pair for i in (2, 4, 6) for pair in ([i, 200 + i], [200 + i, 100 + i])]
    fixed = ["0Z", f"{n}Z", "100Z", f"{100 + n}Z"]
    dofs = tuple(f"{node}{d}" for node in nodes for d in ("Z", "RX", "RY") if f"{node}{d}" not in fixed)
    values = {
        "girder1": {"mass": 12.0, "bending_stiffness_y": 4.0e4, "torsional_stiffness": 9e3, "polar_inertia": 0.02},
        "girder2": {"mass": 12.1, "bending_stiffness_y": 4.1e4, "torsional_stiffness": 9e3, "polar_inertia": 0.02},
        "cross": {"mass": 7.0, "bending_stiffness_y": 2.2e4, "torsional_stiffness": 4e3, "polar_inertia": 0.01},
    }  # fmt: skip
    parts, sets = [], []
    for name, table in tables.items():
        losses = "loss" if name.startswith("girder") else "loss of cross beams"
        sets.append(sid.SpaceBeam(name, table, loss_factor=0.012, bending_stiffness_z=1e5, **values[name]))
        elements: dict[str, list[tuple[list[str], np.ndarray]]] = {key: [] for key in values[name]}
        for a, b in table:
            across = np.subtract(nodes[b], nodes[a])
            length = float(np.linalg.norm(across))
            c, s = across[:2] / length
            names = [f"{node}{d}" for node in (a, b) for d in ("Z", "RX", "RY")]
            bend = np.kron(np.eye(2), np.array([[1, 0, 0], [0, s, -c]]))  # w and its slope along the beam
            twist = np.kron(np.eye(2), np.array([[0, c, s]]))
            k, m = beam_matrices(length)
            k_rod, m_rod = rod(length)
            elements["bending_stiffness_y"].append((names, bend.T @ k @ bend))
            elements["mass"].append((names, bend.T @ m @ bend))
            elements["torsional_stiffness"].append((names, twist.T @ k_rod @ twist))
            elements["polar_inertia"].append((names, twist.T @ m_rod @ twist))
        for key, several in elements.items():
            kind = "mass" if key in ("mass", "polar_inertia") else "stiffness"
            parts.append(Part(f"{key}[{name}]", values[name][key], kind, assembled(dofs, several),
                              losses if kind == "stiffness" else ""))  # fmt: skip
    sets.append(sid.PointMass("machine", [103], mass=15.0))
    parts.append(Part("mass[machine]", 15.0, "mass", between(len(dofs), dofs.index("103Z"))))
    structure = sid.Structure(nodes, sets, fixed=fixed, active=["Z", "RX", "RY"])
    unknown = [sid.Unknown("bending_stiffness_y", name) for name in tables]
    unknown += [sid.Unknown("loss_factor", ["girder1", "girder2"], name="all")]
    return Rig(
        "grillage", structure, tuple(parts), {"loss": 0.012, "loss of cross beams": 0.012}, tuple(unknown), dofs,
        ("2Z", "5Z", "104Z", "106Z", "204Z"), "3Z", (3.0, 80.0), "bending_stiffness_y[girder1]",
    )  # fmt: skip


def plane_line(a: np.ndarray, b: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Length, and maps from X Y RZ of both ends to extension (2, 6) and to deflection and slope (4, 6) of a line."""
    length = float(np.linalg.norm(b - a))
    c, s = (b - a) / length
    return length, np.kron(np.eye(2), [[c, s, 0]]), np.kron(np.eye(2), [[-s, c, 0], [0, 0, 1]])


def mast() -> Rig:
    """A mast of two sections under its weight, on a hinge, with stays at two levels; both sections and both stays are unknown."""
    n, h = 12, 1.0
    nodes = {i: [0.0, h * i] for i in range(n + 1)} | {101: [-6.0, 0.0], 102: [6.0, 0.0]}
    fixed = ["0X", "0Y", *(f"{node}{d}" for node in (101, 102) for d in ("X", "Y", "RZ"))]
    dofs = tuple(f"{node}{d}" for node in nodes for d in ("X", "Y", "RZ") if f"{node}{d}" not in fixed)
    sections = {"lower": range(7), "upper": range(7, n)}
    stays = {"stays6": [[101, 6], [102, 6]], "stays11": [[101, 11], [102, 11]]}
    bending, weight, axial, force = (
        {"lower": 9.0e4, "upper": 6.0e4},
        {"lower": 14.0, "upper": 11.0},
        {"lower": 4e7, "upper": 3e7},
        {"lower": -2500.0, "upper": -1200.0},
    )
    parts: list[Part] = []
    sets: list = []
    for name, span in sections.items():
        table = [[i, i + 1] for i in span]
        sets.append(sid.Beam(name, table, mass=weight[name], bending_stiffness=bending[name], axial_stiffness=axial[name],
                             axial_force=force[name], loss_factor=0.015))  # fmt: skip
        several: list[list[tuple[list[str], np.ndarray]]] = [[], [], [], []]
        for a, b in table:
            length, along, across = plane_line(np.array(nodes[a]), np.array(nodes[b]))
            names = [f"{node}{d}" for node in (a, b) for d in ("X", "Y", "RZ")]
            (k, m), (k_rod, m_rod) = beam_matrices(length), rod(length)
            of_element = (
                across.T @ m @ across + along.T @ m_rod @ along,
                across.T @ k @ across,
                along.T @ k_rod @ along,
                across.T @ string(length) @ across,
            )
            for group, matrix in zip(several, of_element, strict=True):
                group.append((names, matrix))
        mass, bend, stretch, tension = (assembled(dofs, group) for group in several)
        parts += [
            Part(f"mass[{name}]", weight[name], "mass", mass),
            Part(f"bending_stiffness[{name}]", bending[name], "stiffness", bend, "loss"),
            Part(f"axial_stiffness[{name}]", axial[name], "stiffness", stretch, "loss"),
            Part(f"axial_force[{name}]", force[name], "stiffness", tension),
        ]
    for name, table in stays.items():
        sets.append(sid.Bar(name, table, mass=0.4, axial_stiffness=2.0e5, loss_factor=0.015))
        stiff, inert = [], []
        for a, b in table:
            length, along, _ = plane_line(np.array(nodes[a]), np.array(nodes[b]))
            names = [f"{node}{d}" for node in (a, b) for d in ("X", "Y", "RZ")]
            k_rod, m_rod = rod(length)
            stiff.append((names, along.T @ k_rod @ along))
            inert.append((names, np.kron(m_rod, np.diag([1.0, 1.0, 0.0]))))
        parts += [
            Part(f"axial_stiffness[{name}]", 2.0e5, "stiffness", assembled(dofs, stiff), "loss"),
            Part(f"mass[{name}]", 0.4, "mass", assembled(dofs, inert)),
        ]
    sets.append(sid.PointMass("antenna", [n], mass=25.0))
    for d in ("X", "Y"):
        parts.append(Part("mass[antenna]", 25.0, "mass", between(len(dofs), dofs.index(f"{n}{d}"))))
    structure = sid.Structure(nodes, sets, fixed=fixed)
    unknown = [sid.Unknown("bending_stiffness", name) for name in sections]
    unknown += [sid.Unknown("axial_stiffness", name) for name in stays]
    unknown += [sid.Unknown("loss_factor", [*sections, *stays], name="all")]
    return Rig(
        "guyed mast", structure, merged(parts), {"loss": 0.015}, tuple(unknown), dofs, ("3X", "5X", "8X", "10X", "12X"), "8X",
        (1.0, 60.0), "bending_stiffness[lower]",
    )  # fmt: skip


def merged(parts: list[Part]) -> tuple[Part, ...]:
    """Parts with those of one name added."""
    named: dict[str, Part] = {}
    for part in parts:
        first = named.get(part.name)
        named[part.name] = part if first is None else replace(part, matrix=first.matrix + part.matrix)
    return tuple(named.values())


def truss() -> Rig:
    """A truss of four panels with masses at its nodes; its chords in two parts and its diagonals are unknown."""
    panel, height, n = 1.5, 1.2, 4
    nodes = {i: [panel * i, 0.0] for i in range(n + 1)} | {10 + i: [panel * (i + 0.5), height] for i in range(n)}
    tables = {
        "bottom": [[i, i + 1] for i in range(n)],
        "top": [[10 + i, 11 + i] for i in range(n - 1)],
        "diagonals": [pair for i in range(n) for pair in ([i, 10 + i], [10 + i, i + 1])],
    }
    fixed = ["0X", "0Y", f"{n}Y"]
    dofs = tuple(f"{node}{d}" for node in nodes for d in ("X", "Y") if f"{node}{d}" not in fixed)
    axial, weight = {"bottom": 8e6, "top": 9e6, "diagonals": 5e6}, {"bottom": 4.0, "top": 4.5, "diagonals": 2.0}
    parts, sets = [], []
    for name, table in tables.items():
        damping = 2e-4 * axial[name]
        sets.append(sid.Bar(name, table, mass=weight[name], axial_stiffness=axial[name], stiffness_damping=damping))
        stiff, inert = [], []
        for a, b in table:
            ends = np.array(nodes[a]), np.array(nodes[b])
            length = float(np.linalg.norm(ends[1] - ends[0]))
            names = [f"{node}{d}" for node in (a, b) for d in ("X", "Y")]
            along = np.kron(np.eye(2), ((ends[1] - ends[0]) / length)[None])
            k_rod, m_rod = rod(length)
            stiff.append((names, along.T @ k_rod @ along))
            inert.append((names, np.kron(m_rod, np.eye(2))))
        k, m = assembled(dofs, stiff), assembled(dofs, inert)
        parts += [
            Part(f"axial_stiffness[{name}]", axial[name], "stiffness", k),
            Part(f"mass[{name}]", weight[name], "mass", m),
            Part(f"stiffness_damping[{name}]", damping, "viscous", k),
        ]
    for name, node, mass in (("load2", 2, 60.0), ("load11", 11, 40.0)):
        sets.append(sid.PointMass(name, [node], mass=mass))
        parts += [Part(f"mass[{name}]", mass, "mass", between(len(dofs), dofs.index(f"{node}{d}"))) for d in ("X", "Y")]
    structure = sid.Structure(nodes, sets, fixed=fixed, active=["X", "Y"])
    unknown = [sid.Unknown("axial_stiffness", name) for name in tables]
    unknown += [sid.Unknown("stiffness_damping", list(tables), name="all")]
    return Rig(
        "truss", structure, merged(parts), {}, tuple(unknown), dofs, ("1Y", "3Y", "12Y", "4X"), "2Y", (8.0, 120.0),
        "axial_stiffness[bottom]",
    )  # fmt: skip


def ambient_setup(
    rig: Rig, values: dict[str, float], gain: float, rng: np.random.Generator, noise: float
) -> sid.ModalSetup:
    """Modes that `identify_modes` takes from accelerations under white forces on all translations."""
    m, k, _ = matrices(rig, values)
    squares, shapes = eigh(k.real, m)
    omega = np.sqrt(squares)
    rate, n_samples = 3 * rig.band[1], 16_000
    used = omega < np.pi * rate
    damping = 0.5 * np.imag(np.einsum("im,ij,jm->m", shapes, k, shapes)) / squares
    driven = [i for i, dof in enumerate(rig.dofs) if "R" not in dof]
    forces = rng.standard_normal((n_samples, len(driven)))
    sensors = [rig.index(dof) for dof in rig.sensors]
    motion = np.zeros((n_samples, len(sensors)))
    for mode in np.flatnonzero(used):
        w, z = omega[mode], damping[mode]
        numerator, denominator, _ = cont2discrete(([1, 0, 0], [1, 2 * z * w, w**2]), 1 / rate)
        q = lfilter(np.ravel(numerator), denominator, forces @ shapes[driven, mode])
        motion += np.outer(q, shapes[sensors, mode])
    motion *= gain
    motion += 3 * noise * motion.std(axis=0) * rng.standard_normal(motion.shape)
    record = sid.TimeRecord(rate, motion, tuple(rig.sensors), ("acceleration",) * len(sensors))
    modes = sid.identify_modes(record)
    unknown = [u for u in rig.unknown if u.property not in ("loss_factor", "viscous_damping", "stiffness_damping")]
    return sid.ModalSetup(rig.structure, sid.parameters(rig.structure, unknown), modes)


def histories_setup(
    rig: Rig, values: dict[str, float], gain: float, rng: np.random.Generator, noise: float
) -> sid.TimeSetup:
    """Accelerations under a random force that is filtered below half the sampling rate, simulated by steps an eighth as long."""
    m, k, c = matrices(rig, values)
    n, rate, n_samples, finer = len(rig.dofs), 4 * rig.band[1], 2048, 8
    spectrum = np.fft.rfft(rng.standard_normal(n_samples * finer))
    spectrum[np.fft.rfftfreq(n_samples * finer, 1 / (finer * rate)) > 0.4 * rate] = 0.0
    force = np.fft.irfft(spectrum) * np.minimum(np.arange(n_samples * finer) / (32 * finer), 1.0)
    force /= force.std()
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(m, k.real), -np.linalg.solve(m, c)]])
    b = np.concatenate([np.zeros(n), np.linalg.solve(m, np.eye(n)[rig.index(rig.load)])])
    poles, vectors = np.linalg.eig(a)
    driven, sensors = np.linalg.solve(vectors, b), [n + rig.index(dof) for dof in rig.sensors]
    step = 1 / (finer * rate)
    grown = np.exp(poles * step)
    second = (grown - 1 - poles * step) / (poles**2 * step)
    first = (grown - 1) / poles - second
    motion = np.outer(force[::finer], b[sensors])
    for i, pole in enumerate(poles):  # exact for a force that runs straight over each short step
        state = lfilter([second[i], first[i]], [1, -grown[i]], force)[::finer]
        motion += (np.outer(state, pole * vectors[sensors, i]) * driven[i]).real
    sigma, small = noise * np.sqrt((motion**2).mean(axis=0)), 1e-3
    measured = gain * motion + sigma * rng.standard_normal(motion.shape)
    read = force[::finer] + small * rng.standard_normal(n_samples)
    record = sid.TimeRecord(
        rate, np.column_stack([read, measured]), (rig.load, *rig.sensors), ("force", *["acceleration"] * len(sensors)),
        variance=np.array([small**2, *sigma**2]),
    )  # fmt: skip
    return sid.TimeSetup(rig.structure, sid.parameters(rig.structure, rig.unknown), record, sid.TimeFit())


STUDIES: dict[str, tuple[Callable[[], Rig], str]] = {
    "grillage/frf": (grillage, "frf"),
    "grillage/modes": (grillage, "modes"),
    "mast/frf": (mast, "frf"),
    "mast/modes": (mast, "modes"),
    "mast/ambient": (mast, "ambient"),
    "truss/histories": (truss, "histories"),
}


def with_lengths_off(rig: Rig, values: dict[str, float], scale: float) -> dict[str, float]:
    """Values that act on translations as `values` do with all lengths a factor `scale` larger."""
    points = {element.name for element in rig.structure.elements if isinstance(element, sid.PointMass)}
    powers = {
        name: 0 if name.split("[")[-1].rstrip("]") in points else LENGTH_POWERS.get(name.split("[")[0], 0)
        for name in values
    }
    return {name: value * scale ** powers[name] for name, value in values.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tolerance", type=float, nargs="+", default=[0.005, 0.02])
    parser.add_argument("--length", type=float, default=0.0, help="standard deviation of the scale of all lengths")
    parser.add_argument("--only", nargs="+", default=list(STUDIES), choices=list(STUDIES))
    chosen = parser.parse_args()
    print("structure                record tolerance  hold %  noise %  sound approx  wrong misfit")
    whole = {tolerance: Told() for tolerance in chosen.tolerance}
    for study in chosen.only:
        build, kind = STUDIES[study]
        rig, setup = build(), (SETUPS | {"ambient": ambient_setup, "histories": histories_setup})[kind]
        for tolerance in chosen.tolerance:
            options = sid.IdentifyOptions(tolerances=Tolerances(tolerance, tolerance, DAMPING, tolerance))
            told, begun = Told(), time.process_time()
            for seed in range(chosen.seed, chosen.seed + chosen.repeats):
                rng = np.random.default_rng(seed)
                values, wanted, gain = truth(rig, rng, tolerance)
                values = with_lengths_off(rig, values, 1 + chosen.length * rng.standard_normal())
                judge(setup(rig, values, gain, rng, 0.01), wanted, options, told)
            row(rig.name, kind, tolerance, told, (time.process_time() - begun) / chosen.repeats)
            for key in vars(told):
                getattr(whole[tolerance], key).extend(getattr(told, key))
    for tolerance, told in whole.items():
        row("all", "", tolerance, told, float("nan"))


if __name__ == "__main__":
    main()
