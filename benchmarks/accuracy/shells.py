"""Shells against published benchmarks on refined meshes: ratio to the reference, for quadrilaterals and triangles.

    python benchmarks/accuracy/shells.py [--finest 32]

References: MacNeal and Harder (1985), Finite Elem. Anal. Des. 1, 3-20; Belytschko, Wong and Chiang (1992), Comput. Methods
Appl. Mech. Engrg. 96, 93-107 (thin twisted beam); Leissa (1973), J. Sound Vib. 31, 257-293.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.sparse.linalg import spsolve

import structid as sid
from structid.dynamics.normal_modes import modes

ALL = ("X", "Y", "Z", "RX", "RY", "RZ")
DIAPHRAGM, ACROSS_X, ACROSS_Y, ACROSS_Z = "Y Z RX", "X RY RZ", "Y RX RZ", "Z RX RY"


def grid(kind: str, shape: tuple[int, int], size: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 2) of a rectangle and its cells (from 1)."""
    axes = [np.linspace(0, length, n + 1) for n, length in zip(shape, size, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    number = np.arange(1, len(points) + 1).reshape(shape[0] + 1, -1)
    cells = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1).reshape(-1, 4)
    return points, cells if kind == "quads" else np.concatenate([cells[:, :3], cells[:, [0, 2, 3]]])


def shell(points: np.ndarray, cells: np.ndarray, held: dict[str, np.ndarray], **given: float) -> sid.Structure:
    """A structure of one shell, held where the masks say."""
    given = {"density": 1.0} | given
    fixed = {f"{n + 1}{d}" for words, mask in held.items() for n in np.flatnonzero(mask) for d in words.split()}
    return sid.Structure(dict(enumerate(points, 1)), [sid.Shell("shell", cells, **given)], sorted(fixed))


def moved(structure: sid.Structure, load: dict[tuple[int, str], float]) -> dict[tuple[int, str], float]:
    """Displacements by (node, direction) of forces by the same."""
    place = {(dof.node, dof.direction): k for k, dof in enumerate(structure.dofs)}
    force = np.zeros(structure.n_dofs)
    for key, value in load.items():
        if key in place:
            force[place[key]] += value
    solved = spsolve(structure.matrix("stiffness").tocsc(), force)
    return {key: float(solved[k]) for key, k in place.items()}


def nearest(flat: np.ndarray, place: tuple[float, float]) -> int:
    return int(np.argmin(np.linalg.norm(flat - place, axis=1))) + 1


def bent(flat: np.ndarray, radius: float) -> np.ndarray:
    angle = np.radians(flat[:, 1])
    return np.column_stack([flat[:, 0], radius * np.sin(angle), radius * np.cos(angle)])


def roof(kind: str, n: int) -> float:
    """Scordelis-Lo roof under its weight: the middle of the free edge."""
    flat, cells = grid(kind, (n, n), (25.0, 40.0))
    x, angle = flat.T
    points = bent(flat, 25.0)
    held = {DIAPHRAGM: x < 1e-9, ACROSS_X: x > 25 - 1e-9, ACROSS_Y: angle < 1e-9}
    load: dict[tuple[int, str], float] = {}
    for row in cells:
        a, b, c = points[row[:3] - 1]
        area = np.linalg.norm(np.cross(b - a, c - a)) / (1 if len(row) == 4 else 2)
        for node in row.tolist():
            load[node, "Z"] = load.get((node, "Z"), 0.0) - 90.0 * float(area) / len(row)
    structure = shell(points, cells, held, youngs_modulus=4.32e8, thickness=0.25, poisson=0.0)
    return -moved(structure, load)[nearest(flat, (25.0, 40.0)), "Z"] / 0.3024


def cylinder(kind: str, n: int) -> float:
    """Pinched cylinder with diaphragms: under the force."""
    flat, cells = grid(kind, (n, n), (300.0, 90.0))
    x, angle = flat.T
    held = {DIAPHRAGM: x < 1e-9, ACROSS_X: x > 300 - 1e-9, ACROSS_Y: angle < 1e-9, ACROSS_Z: angle > 90 - 1e-9}
    structure = shell(bent(flat, 300.0), cells, held, youngs_modulus=3e6, thickness=3.0, poisson=0.3)
    top = (nearest(flat, (300.0, 0.0)), "Z")
    return -moved(structure, {top: -0.25})[top] / 1.8248e-5


def hemisphere(kind: str, n: int) -> float:
    """Hemisphere with a hole of 18 degrees under four alternating forces."""
    flat, cells = grid(kind, (n, n), (90.0, 72.0))
    around, up = np.radians(flat.T)
    points = 10 * np.column_stack([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)])
    first, second = nearest(flat, (0.0, 0.0)), nearest(flat, (90.0, 0.0))
    held = {ACROSS_Y: flat[:, 0] < 1e-9, ACROSS_X: flat[:, 0] > 90 - 1e-9, "Z": np.arange(1, len(flat) + 1) == first}
    structure = shell(points, cells, held, youngs_modulus=6.825e7, thickness=0.04, poisson=0.3)
    return moved(structure, {(first, "X"): 1.0, (second, "Y"): -1.0})[first, "X"] / 0.0940


def twisted(kind: str, n: int, thickness: float, direction: str, reference: float) -> float:
    """Twisted beam under a force at its tip; n cells across, six times as many along."""
    flat, cells = grid(kind, (6 * n, n), (12.0, 1.1))
    x, y, angle = flat[:, 0], flat[:, 1] - 0.55, flat[:, 0] / 12 * np.pi / 2
    points = np.column_stack([x, y * np.cos(angle), y * np.sin(angle)])
    structure = shell(points, cells, {" ".join(ALL): x < 1e-9}, youngs_modulus=29e6, thickness=thickness, poisson=0.22)
    tip = np.flatnonzero(x > 12 - 1e-9) + 1
    share = np.full(len(tip), 1.0 / n)
    share[[0, -1]] /= 2
    load = {(int(node), direction): float(part) for node, part in zip(tip, share, strict=True)}
    return moved(structure, load)[int(tip[n // 2]), direction] / reference


def clamped(kind: str, n: int) -> float:
    """Clamped square in a turned plane: the worst of the first four frequencies."""
    flat, cells = grid(kind, (n, n), (1.0, 1.0))
    rim = np.any((flat < 1e-9) | (flat > 1 - 1e-9), axis=1)
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    points = np.column_stack([flat, np.zeros(len(flat))]) @ turn.T
    given = {"youngs_modulus": 70e9, "density": 2700.0, "thickness": 0.002, "poisson": 0.3}
    structure = shell(points, cells, {" ".join(ALL): rim}, **given)
    found = modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=4).frequency
    unit = np.sqrt(70e9 * 0.002**2 / 12 / (1 - 0.09) / 2700.0) / (2 * np.pi)
    ratios = found / unit / [35.992, 73.413, 73.413, 108.27]
    return float(ratios[np.argmax(np.abs(ratios - 1))])


def main() -> None:
    """Prints one row a benchmark and cell type."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--finest", type=int, default=32, help="cells along a side (default 32)")
    finest = arguments.parse_args().finest
    sides = [n for n in (4, 8, 16, 32, 64) if n <= finest]
    cases = {
        "Scordelis-Lo roof": roof,
        "pinched cylinder": cylinder,
        "hemisphere": hemisphere,
        "clamped square": clamped,
    }
    print(f"{'ratio to the reference (target 1)':34s}{'':11s}" + "".join(f"{n:>9d}" for n in sides))
    for name, case in cases.items():
        for kind in ("quads", "triangles"):
            print(f"{name:34s}{kind:11s}" + "".join(f"{case(kind, n):9.4f}" for n in sides), flush=True)
    print(f"{'cells across':34s}{'':11s}" + "".join(f"{n:>9d}" for n in (2, 4, 8)))
    for thickness, across, along in ((0.32, 1.754e-3, 5.424e-3), (0.0032, 1.294e3, 5.256e3)):
        for direction, reference in (("Z", along), ("Y", across)):
            for kind in ("quads", "triangles"):
                name = f"twisted beam, t = {thickness:g}, {direction}"
                row = "".join(f"{twisted(kind, n, thickness, direction, reference):9.4f}" for n in (2, 4, 8))
                print(f"{name:34s}{kind:11s}{row}", flush=True)


if __name__ == "__main__":
    main()
