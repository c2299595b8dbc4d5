"""Structures and how they are tested: eight for development, six held out, three fresh; values in the tables are true."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from wrong_models.assembly import STIFFNESSES, Table, assembled, count, find, row, sets, split


@dataclass(frozen=True)
class Unknown:
    """An `[[unknown]]` of the study; `factor` where the parameter multiplies nominal values."""

    property: str
    elements: tuple[str, ...]
    each: bool = False
    factor: bool = False

    @property
    def label(self) -> str:
        return ", ".join(self.elements)


@dataclass(frozen=True)
class Rig:
    """A structure and its test.

    Attributes
    ----------
    table : Table
        The structure at its true values.
    unknowns : tuple of Unknown
    sensors, loads : tuple of str
        The second load is used in tests of two loads only.
    band : (float, float)
        Hz.
    known : tuple of (int, float)
        Nodes and known masses (kg) that set-ups may get in addition.
    kind : str
        Of its FRFs.
    exported : bool
        The study has the matrices of each element set in files, not its elements.
    n_modes : int
        Modes that a modal test finds.
    """

    table: Table
    unknowns: tuple[Unknown, ...]
    sensors: tuple[str, ...]
    loads: tuple[str, ...]
    band: tuple[float, float]
    known: tuple[tuple[int, float], ...]
    kind: str = "accelerance"
    exported: bool = False
    n_modes: int = 5


def unknown(text: str) -> tuple[Unknown, ...]:
    """ "mass floors; stiffness* legs,rings; stiffness storeys each": a star makes factors."""
    made = []
    for part in text.split(";"):
        words = part.split()
        elements = tuple(words[1].split(","))
        made.append(Unknown(words[0].rstrip("*"), elements, "each" in words[2:], words[0].endswith("*")))
    return tuple(made)


def run_of(*nodes: int) -> list[list[int]]:
    """Elements from node to node."""
    return [[a, b] for a, b in pairwise(nodes)]


def structure(active: str, fixed: str, nodes: dict[int, list[float]], **element_sets: dict[str, Any]) -> Table:
    """A table; the name of each set begins with its type, as in `beam_left`, `point_mass_roof`."""
    made: Table = {"active": active.split(), "fixed": fixed.split(), "nodes": nodes}
    kinds = ("space_beam", "beam", "bar", "membrane", "plate", "spring", "dashpot", "point_mass", "rotary_inertia")
    for key, own in element_sets.items():
        kind = next(kind for kind in kinds if key.startswith(kind))
        made.setdefault(kind, []).append({"name": key[len(kind) + 1 :], **own})
    return made


def two_span() -> Rig:
    """A beam over three supports, spans of 1.2 and 1.0 m."""
    own = {"mass": 3.0, "bending_stiffness": 400.0, "loss_factor": 0.02}
    table = structure(
        "Y RZ", "1Y 5Y 9Y", {i + 1: [x] for i, x in enumerate([0, 0.3, 0.6, 0.9, 1.2, 1.45, 1.7, 1.95, 2.2])},
        beam_left={"nodes": run_of(1, 2, 3, 4, 5), **own},
        beam_right={"nodes": run_of(5, 6, 7, 8, 9), **own, "bending_stiffness": 330.0},
    )  # fmt: skip
    free = unknown("mass left; mass right; bending_stiffness left; bending_stiffness right; loss_factor left,right")
    return Rig(table, free, ("2Y", "4Y", "6Y", "7Y"), ("3Y", "8Y"), (6.0, 140.0), ((7, 0.5), (2, 0.4)))


def portal() -> Rig:
    """A clamped portal frame that carries a machine; the members have been weighed."""
    steel = {"mass": 4.0, "bending_stiffness": 600.0, "axial_stiffness": 3e6, "loss_factor": 0.02}
    nodes = {1: [0, 0], 2: [0, 0.35], 3: [0, 0.7], 4: [0, 1], 5: [0.4, 1], 6: [0.8, 1], 7: [1.2, 1], 8: [1.6, 1]}
    nodes |= {9: [1.6, 0.7], 10: [1.6, 0.35], 11: [1.6, 0]}
    table = structure(
        "X Y RZ", "1X 1Y 1RZ 11X 11Y 11RZ", nodes,
        beam_left={"nodes": run_of(1, 2, 3, 4), **steel},
        beam_girder={"nodes": run_of(4, 5, 6, 7, 8), **steel, "bending_stiffness": 800.0},
        beam_right={"nodes": run_of(8, 9, 10, 11), **steel},
        point_mass_machine={"nodes": [6], "mass": 3.0},
    )  # fmt: skip
    free = unknown(
        "bending_stiffness left; bending_stiffness girder; bending_stiffness right; mass machine; "
        "loss_factor left,girder,right"
    )
    return Rig(table, free, ("4X", "5Y", "7Y", "2X", "9X"), ("4X", "7Y"), (2.0, 120.0), ((5, 1.0), (9, 0.8)), n_modes=6)


def shear() -> Rig:
    """A shear building of six storeys; the roof has been weighed, the floors are equal."""
    table = structure(
        "X", "", {i: [0.0] for i in range(1, 7)},
        point_mass_floors={"nodes": [1, 2, 3, 4, 5], "mass": 200.0},
        point_mass_roof={"nodes": [6], "mass": 150.0},
        spring_storeys={
            "first": ["2X", "3X", "4X", "5X", "6X"], "second": ["1X", "2X", "3X", "4X", "5X"],
            "stiffness": [3.2e5, 3.0e5, 2.8e5, 2.6e5, 2.4e5], "loss_factor": 0.03,
        },
        spring_ground={"first": ["1X"], "stiffness": 3.4e5, "loss_factor": 0.03},
    )  # fmt: skip
    free = unknown("stiffness ground; stiffness storeys each; mass floors; loss_factor ground,storeys")
    return Rig(
        table, free, ("1X", "2X", "4X", "5X", "6X"), ("6X", "3X"), (0.6, 14.0), ((4, 40.0), (2, 30.0)), n_modes=6
    )


def tower() -> Rig:
    """Four legs in space, two rings, four equal loads on the platform."""
    corners = ([0, 0], [0.8, 0], [0.8, 0.6], [0, 0.6])
    nodes = {4 * level + k + 1: [*xy, 0.9 * level] for level in range(3) for k, xy in enumerate(corners)}
    tube = {
        "mass": 2.0, "bending_stiffness_y": 1500.0, "bending_stiffness_z": 1500.0, "axial_stiffness": 5e6,
        "torsional_stiffness": 1100.0, "polar_inertia": 0.002, "loss_factor": 0.02,
    }  # fmt: skip
    table = structure(
        "X Y Z RX RY RZ", " ".join(f"{n}{d}" for n in range(1, 5) for d in ("X", "Y", "Z", "RX", "RY", "RZ")), nodes,
        space_beam_lower={"nodes": [[k, k + 4] for k in range(1, 5)], **tube},
        space_beam_upper={"nodes": [[k, k + 4] for k in range(5, 9)], **tube},
        space_beam_rings={"nodes": [p for a in (5, 9) for p in run_of(a, a + 1, a + 2, a + 3, a)], **tube},
        point_mass_platform={"nodes": [9, 10, 11, 12], "mass": 2.5},
    )  # fmt: skip
    free = unknown("stiffness* lower; stiffness* upper; stiffness* rings; mass platform; loss_factor lower,upper,rings")
    sensors = ("9X", "10Y", "12X", "6X", "7Y", "5Y")
    return Rig(table, free, sensors, ("11X", "9Y"), (4.0, 110.0), ((10, 1.0), (7, 0.8)), n_modes=6)


def grillage() -> Rig:
    """A cantilever grillage: three long beams tied by cross beams."""
    nodes = {5 * j + i + 1: [0.4 * i, 0.3 * j, 0.0] for j in range(3) for i in range(5)}
    bars = {
        "mass": 2.4,
        "axial_stiffness": 1e6,
        "polar_inertia": 0.001,
        "bending_stiffness_z": 300.0,
        "loss_factor": 0.02,
    }
    long = {**bars, "bending_stiffness_y": 300.0, "torsional_stiffness": 120.0}
    cross = {**bars, "bending_stiffness_y": 120.0, "torsional_stiffness": 60.0, "mass": 1.2}
    table = structure(
        "Z RX RY", " ".join(f"{n}{d}" for n in (1, 6, 11) for d in ("Z", "RX", "RY")), nodes,
        space_beam_long={"nodes": [p for j in range(3) for p in run_of(*range(5 * j + 1, 5 * j + 6))], **long},
        space_beam_cross={"nodes": [p for i in range(2, 6) for p in run_of(i, i + 5, i + 10)], **cross},
    )  # fmt: skip
    free = unknown(
        "bending_stiffness_y long; bending_stiffness_y cross; torsional_stiffness long; mass long; loss_factor long,cross"
    )
    return Rig(
        table, free, ("5Z", "9Z", "15Z", "3Z", "13Z"), ("4Z", "15Z"), (1.0, 70.0), ((10, 0.5), (14, 0.4)), n_modes=6
    )


def truss() -> Rig:
    """A truss bridge with pinned bars; the deck's masses are equal."""
    nodes = {i: [i - 1.0, 0.0] for i in range(1, 8)} | {i: [i - 7.0, 1.0] for i in range(8, 13)}
    steel = {"mass": 8.0, "axial_stiffness": 4e7, "loss_factor": 0.02}
    table = structure(
        "X Y", "1X 1Y 7Y", nodes,
        bar_bottom={"nodes": run_of(*range(1, 8)), **steel},
        bar_top={"nodes": run_of(*range(8, 13)), **steel},
        bar_posts={"nodes": [[i, i + 6] for i in range(2, 7)], **steel, "axial_stiffness": 3e7},
        bar_diagonals={"nodes": [[1, 8], [8, 3], [9, 4], [11, 4], [12, 5], [12, 7]], **steel, "axial_stiffness": 3e7},
        point_mass_deck={"nodes": [2, 3, 4, 5, 6], "mass": 120.0},
    )  # fmt: skip
    free = unknown(
        "axial_stiffness bottom; axial_stiffness top; axial_stiffness posts; axial_stiffness diagonals; mass deck; "
        "loss_factor bottom,top,posts,diagonals"
    )
    sensors = ("2Y", "4Y", "6Y", "9X", "5X", "10Y")
    return Rig(table, free, sensors, ("3Y", "12Y"), (8.0, 130.0), ((5, 25.0), (2, 20.0)), n_modes=6)


def rail() -> Rig:
    """A free beam on a bed of equal springs."""
    table = structure(
        "Y RZ", "", {i + 1: [0.3 * i] for i in range(9)},
        beam_rail={"nodes": run_of(*range(1, 10)), "mass": 6.0, "bending_stiffness": 700.0, "loss_factor": 0.02},
        spring_bed={"first": [f"{i}Y" for i in range(1, 10)], "stiffness": 3e4, "loss_factor": 0.06},
        point_mass_weight={"nodes": [4], "mass": 2.0},
    )  # fmt: skip
    free = unknown("mass rail; bending_stiffness rail; stiffness bed; loss_factor rail; loss_factor bed")
    return Rig(
        table, free, ("1Y", "3Y", "6Y", "8Y"), ("5Y", "9Y"), (8.0, 110.0), ((2, 1.0), (7, 0.8)), "mobility", n_modes=6
    )


def hall() -> Rig:
    """A frame of two bays whose matrices come from another code: one group for the columns, one for each girder."""
    nodes = {k + 1: [1.2 * (k // 3), 0.5 * (k % 3)] for k in range(9)} | {
        10: [0.4, 1],
        11: [0.8, 1],
        12: [1.6, 1],
        13: [2.0, 1],
    }
    steel = {"mass": 5.0, "bending_stiffness": 700.0, "axial_stiffness": 4e6, "loss_factor": 0.02}
    table = structure(
        "X Y RZ", " ".join(f"{n}{d}" for n in (1, 4, 7) for d in ("X", "Y", "RZ")), nodes,
        beam_columns={"nodes": run_of(1, 2, 3) + run_of(4, 5, 6) + run_of(7, 8, 9), **steel},
        beam_west={"nodes": run_of(3, 10, 11, 6), **steel, "bending_stiffness": 900.0},
        beam_east={"nodes": run_of(6, 12, 13, 9), **steel, "bending_stiffness": 900.0},
    )  # fmt: skip
    free = unknown(
        "stiffness* columns; stiffness* west; stiffness* east; mass* west,east; loss_factor columns,west,east"
    )
    sensors = ("3X", "10Y", "12Y", "8X", "2X", "13Y")
    return Rig(table, free, sensors, ("6X", "11Y"), (3.0, 110.0), ((10, 1.0), (8, 0.8)), exported=True, n_modes=6)


def shaft() -> Rig:
    """A stepped shaft in two bearings with two discs."""
    xs = [0.0, 0.1, 0.22, 0.34, 0.46, 0.58, 0.7, 0.8]
    table = structure(
        "Y RZ", "", {i + 1: [x] for i, x in enumerate(xs)},
        beam_thin={"nodes": [*run_of(1, 2, 3), *run_of(6, 7, 8)], "mass": 6.0, "bending_stiffness": 1500.0, "loss_factor": 0.02},
        beam_thick={"nodes": run_of(3, 4, 5, 6), "mass": 11.0, "bending_stiffness": 5200.0, "loss_factor": 0.02},
        point_mass_discs={"nodes": [3, 6], "mass": 5.0},
        rotary_inertia_disc_inertia={"nodes": [3, 6], "rotary_inertia": 0.02, "direction": "RZ"},
        spring_bearings={"first": ["2Y", "7Y"], "stiffness": 8e5, "loss_factor": 0.05},
    )  # fmt: skip
    free = unknown(
        "bending_stiffness thin; bending_stiffness thick; mass discs; stiffness bearings; loss_factor thin,thick"
    )
    return Rig(table, free, ("1Y", "3Y", "5Y", "7Y"), ("4Y", "8Y"), (15.0, 420.0), ((5, 1.0), (1, 0.5)))


def mast() -> Rig:
    """A mast with two guys and an arm at its top, in a plane; stiff at the foot."""
    nodes = {i + 1: [0.0, 1.0 * i] for i in range(6)} | {7: [0.6, 5.0], 8: [1.2, 5.0], 9: [-2.5, 0.0], 10: [2.5, 0.0]}
    tube = {"mass": 6.0, "bending_stiffness": 5e4, "axial_stiffness": 3e7, "loss_factor": 0.025}
    table = structure(
        "X Y RZ", "1X 1Y 1RZ 9X 9Y 10X 10Y", nodes,
        beam_foot={"nodes": run_of(1, 2, 3), **tube, "mass": 9.0, "bending_stiffness": 9e4},
        beam_head={"nodes": run_of(3, 4, 5, 6), **tube},
        beam_arm={"nodes": run_of(6, 7, 8), **tube, "mass": 4.0, "bending_stiffness": 1e4},
        bar_guys={"nodes": [[4, 9], [4, 10]], "mass": 0.3, "axial_stiffness": 3e5, "loss_factor": 0.025},
        point_mass_lamp={"nodes": [8], "mass": 6.0},
    )  # fmt: skip
    free = unknown(
        "bending_stiffness foot; bending_stiffness head; bending_stiffness arm; axial_stiffness guys; mass lamp; "
        "loss_factor foot,head,arm,guys"
    )
    sensors = ("2X", "3X", "5X", "6X", "8Y", "7Y")
    return Rig(table, free, sensors, ("4X", "8Y"), (0.8, 90.0), ((5, 3.0), (7, 2.0)), n_modes=6)


def drum() -> Rig:
    """A square membrane in two halves of different weight."""
    n = 6
    nodes = {(n + 1) * i + j + 1: [0.2 * i, 0.2 * j] for i in range(n + 1) for j in range(n + 1)}
    edge = [k for k, (x, y) in nodes.items() if min(x, y) == 0.0 or max(x, y) > 0.2 * n - 1e-9]

    def half(columns: range) -> list[list[int]]:
        corners = [((n + 1) * i + j + 1, (n + 1) * (i + 1) + j + 1) for i in columns for j in range(n)]
        return [triangle for a, b in corners for triangle in ([a, b, b + 1], [a, b + 1, a + 1])]

    skin = {"mass": 1.2, "tension": 900.0, "loss_factor": 0.02}
    table = structure(
        "Z", " ".join(f"{k}Z" for k in edge), nodes,
        membrane_near={"nodes": half(range(3)), **skin}, membrane_far={"nodes": half(range(3, n)), **skin, "mass": 1.7},
        point_mass_gauge={"nodes": [25], "mass": 0.1},
    )  # fmt: skip
    free = unknown("tension near; tension far; mass near; mass far; loss_factor near,far")
    return Rig(
        table,
        free,
        ("10Z", "18Z", "33Z", "38Z", "27Z"),
        ("17Z", "32Z"),
        (8.0, 45.0),
        ((34, 0.1), (11, 0.08)),
        n_modes=6,
    )


def plate() -> Rig:
    """A cantilever plate with a thicker strip; its matrices come from another code, one group a part."""
    nx, ny = 5, 4
    nodes = {(ny + 1) * i + j + 1: [0.12 * i, 0.1 * j] for i in range(nx + 1) for j in range(ny + 1)}

    def cells(columns: range) -> list[list[int]]:
        firsts = [(ny + 1) * i + j + 1 for i in columns for j in range(ny)]
        return [[a, a + ny + 1, a + ny + 2, a + 1] for a in firsts]

    skin = {"mass": 8.1, "bending_stiffness": 181.0, "poisson": 0.33, "loss_factor": 0.02}
    table = structure(
        "Z RX RY", " ".join(f"{k}{d}" for k in range(1, ny + 2) for d in ("Z", "RX", "RY")), nodes,
        plate_root={"nodes": cells(range(2)), **skin},
        plate_strip={"nodes": cells(range(2, 3)), **skin, "mass": 10.8, "bending_stiffness": 430.0},
        plate_tip={"nodes": cells(range(3, nx)), **skin},
    )  # fmt: skip
    free = unknown("stiffness* root; stiffness* strip; stiffness* tip; mass* strip; loss_factor root,strip,tip")
    sensors = ("26Z", "30Z", "18Z", "12Z", "24Z")
    return Rig(table, free, sensors, ("21Z", "29Z"), (4.0, 220.0), ((20, 0.2), (23, 0.15)), exported=True)


def dome() -> Rig:
    """A space truss: a ring of six joints and a crown on bars from six pinned feet."""
    turn = np.pi / 3 * np.arange(6)
    ring = {
        i + 7: [round(float(1.5 * np.cos(a)), 6), round(float(1.5 * np.sin(a)), 6), 0.8 + 0.06 * i]
        for i, a in enumerate(turn)
    }
    feet = {
        i + 1: [round(float(2.5 * np.cos(a + 0.3)), 6), round(float(2.5 * np.sin(a + 0.3)), 6), 0.0]
        for i, a in enumerate(turn)
    }
    tube = {"mass": 3.0, "axial_stiffness": 5e6, "loss_factor": 0.02}
    legs = [[i + 1, i + 7] for i in range(6)] + [[i + 1, (i + 1) % 6 + 7] for i in range(6)]
    table = structure(
        "X Y Z", " ".join(f"{n}{d}" for n in range(1, 7) for d in "XYZ"), feet | ring | {13: [0.0, 0.0, 1.3]},
        bar_legs={"nodes": legs, **tube, "axial_stiffness": 7e6},
        bar_ring={"nodes": run_of(7, 8, 9, 10, 11, 12, 7), **tube},
        bar_crown={"nodes": [[i, 13] for i in range(7, 13)], **tube},
        point_mass_joints={"nodes": [*range(7, 13)], "mass": 6.0},
    )  # fmt: skip
    free = unknown(
        "axial_stiffness legs; axial_stiffness ring; axial_stiffness crown; mass joints; loss_factor legs,ring,crown"
    )
    sensors = ("13Z", "7Z", "9X", "10Z", "12Y", "8Y")
    return Rig(table, free, sensors, ("8Z", "11X"), (15.0, 160.0), ((9, 2.0), (12, 1.5)), n_modes=6)


def branches() -> Rig:
    """Two lines of masses that hang on one: a torsional train with a branch, in translation."""
    table = structure(
        "X", "", {i: [0.0] for i in range(1, 9)},
        point_mass_trunk={"nodes": [1, 2, 3], "mass": 12.0},
        point_mass_long_branch={"nodes": [4, 5, 6], "mass": 6.0},
        point_mass_short_branch={"nodes": [7, 8], "mass": 8.0},
        spring_trunk_springs={"first": ["2X", "3X"], "second": ["1X", "2X"], "stiffness": [9e4, 8e4], "loss_factor": 0.02},
        spring_ground={"first": ["1X"], "stiffness": 1e5, "loss_factor": 0.02},
        spring_long_springs={"first": ["4X", "5X", "6X"], "second": ["3X", "4X", "5X"], "stiffness": 5e4, "loss_factor": 0.02},
        spring_short_springs={"first": ["7X", "8X"], "second": ["3X", "7X"], "stiffness": 4e4, "loss_factor": 0.02},
    )  # fmt: skip
    free = unknown(
        "stiffness ground; stiffness trunk_springs each; stiffness long_springs; stiffness short_springs; mass trunk; "
        "loss_factor ground,trunk_springs,long_springs,short_springs"
    )
    sensors = ("1X", "3X", "5X", "7X", "8X")
    return Rig(table, free, sensors, ("6X", "2X"), (2.0, 32.0), ((5, 1.5), (8, 1.2)), "receptance", n_modes=6)


def crane() -> Rig:
    """A column with a jib held by a stay, a counterweight behind and a load at the tip, in a plane."""
    nodes = {1: [0.0, 0.0], 2: [0.0, 0.8], 3: [0.0, 1.6], 4: [0.0, 2.4], 5: [0.0, 3.0]}
    nodes |= {6: [0.7, 2.4], 7: [1.4, 2.4], 8: [2.1, 2.4], 9: [-0.6, 2.4], 10: [-1.1, 2.4]}
    tube = {"mass": 5.0, "axial_stiffness": 2e7, "loss_factor": 0.022}
    table = structure(
        "X Y RZ", "1X 1Y 1RZ", nodes,
        beam_column={"nodes": run_of(1, 2, 3, 4, 5), **tube, "mass": 8.0, "bending_stiffness": 3e4},
        beam_jib={"nodes": run_of(10, 9, 4, 6, 7, 8), **tube, "bending_stiffness": 9e3},
        bar_stay={"nodes": [[5, 7], [5, 10]], "mass": 0.5, "axial_stiffness": 4e5, "loss_factor": 0.022},
        point_mass_counterweight={"nodes": [10], "mass": 9.0},
    )  # fmt: skip
    free = unknown(
        "bending_stiffness column; bending_stiffness jib; axial_stiffness stay; mass counterweight; "
        "loss_factor column,jib,stay"
    )
    sensors = ("3X", "5X", "6Y", "8Y", "10Y")
    return Rig(table, free, sensors, ("8Y", "4X"), (1.0, 75.0), ((7, 1.5), (9, 2.0)), n_modes=6)


def rack() -> Rig:
    """Two bays and two storeys of a storage rack, its posts in baseplates that turn a little."""
    xs, ys = (0.0, 1.1, 2.2), (0.0, 0.5, 1.0, 1.45, 1.9)
    nodes = {5 * i + j + 1: [x, y] for i, x in enumerate(xs) for j, y in enumerate(ys)}
    nodes |= {16: [0.55, 1.0], 17: [1.65, 1.0], 18: [0.55, 1.9], 19: [1.65, 1.9]}
    steel = {"axial_stiffness": 9e6, "loss_factor": 0.03}
    posts = [pair for i in range(3) for pair in run_of(*range(5 * i + 1, 5 * i + 6))]
    table = structure(
        "X Y RZ", "1X 1Y 6X 6Y 11X 11Y", nodes,
        beam_posts={"nodes": posts, "mass": 3.0, "bending_stiffness": 1500.0, **steel},
        beam_lower={"nodes": run_of(3, 16, 8, 17, 13), "mass": 4.5, "bending_stiffness": 2200.0, **steel},
        beam_upper={"nodes": run_of(5, 18, 10, 19, 15), "mass": 4.5, "bending_stiffness": 1700.0, **steel},
        spring_plates={"first": ["1RZ", "6RZ", "11RZ"], "stiffness": 4000.0, "loss_factor": 0.03},
        point_mass_goods={"nodes": [16, 17, 18, 19], "mass": 6.0},
    )  # fmt: skip
    free = unknown(
        "bending_stiffness posts; bending_stiffness lower; bending_stiffness upper; stiffness plates; mass goods; "
        "loss_factor posts,lower,upper,plates"
    )
    sensors = ("3X", "5X", "16Y", "17Y", "18Y", "12X")
    return Rig(table, free, sensors, ("5X", "17Y"), (1.0, 60.0), ((17, 2.0), (5, 1.5)), n_modes=6)


def wing() -> Rig:
    """A cantilever whose two halves differ, with an engine under it and a tank at its tip."""
    table = structure(
        "Y RZ", "1Y 1RZ", {i + 1: [0.25 * i] for i in range(9)},
        beam_inner={"nodes": run_of(1, 2, 3, 4, 5), "mass": 14.0, "bending_stiffness": 2.5e4, "loss_factor": 0.018},
        beam_outer={"nodes": run_of(5, 6, 7, 8, 9), "mass": 8.0, "bending_stiffness": 8e3, "loss_factor": 0.018},
        point_mass_engine={"nodes": [4], "mass": 11.0}, point_mass_tank={"nodes": [9], "mass": 3.0},
    )  # fmt: skip
    free = unknown(
        "bending_stiffness inner; bending_stiffness outer; mass outer; mass engine; mass tank; loss_factor inner,outer"
    )
    return Rig(table, free, ("3Y", "5Y", "6Y", "8Y", "9Y"), ("7Y", "9Y"), (1.5, 130.0), ((6, 1.5), (8, 0.8)))


def chimney() -> Rig:
    """A cantilever that gets thinner, on a table; its lower half has been weighed."""
    table = structure(
        "Y RZ", "1Y 1RZ", {i + 1: [0.25 * i] for i in range(8)},
        beam_lower={"nodes": run_of(1, 2, 3, 4), "mass": 5.0, "bending_stiffness": 900.0, "loss_factor": 0.02},
        beam_upper={"nodes": run_of(4, 5, 6, 7, 8), "mass": 3.0, "bending_stiffness": 400.0, "loss_factor": 0.02},
        point_mass_platform={"nodes": [6], "mass": 1.0},
    ) | {"base": ["1Y"]}  # fmt: skip
    free = unknown("bending_stiffness lower; bending_stiffness upper; mass upper; loss_factor lower,upper")
    return Rig(table, free, ("2Y", "4Y", "5Y", "7Y", "8Y"), ("1Y",), (0.8, 90.0), ((5, 0.5), (7, 0.4)))


def podium() -> Rig:
    """Two towers on a podium of two storeys, tied by a bridge, under an earthquake; the floors have been weighed."""
    first = ["9X", "1X", "2X", "3X", "4X", "2X", "6X"]
    table = structure(
        "X", "9X", {i: [0.0] for i in range(1, 10)},
        point_mass_floors={"nodes": [1, 2, 3, 4, 5, 6, 7], "mass": [900.0, 900.0, 300.0, 300.0, 250.0, 280.0, 220.0]},
        spring_storeys={
            "first": first, "second": ["1X", "2X", "3X", "4X", "5X", "6X", "7X"], "loss_factor": 0.04,
            "stiffness": [2.6e6, 2.2e6, 7e5, 6e5, 5e5, 6.5e5, 4.5e5],
        },
        spring_bridge={"first": ["4X"], "second": ["7X"], "stiffness": 8e4, "loss_factor": 0.04},
    ) | {"base": ["9X"]}  # fmt: skip
    free = unknown("stiffness storeys each; stiffness bridge; loss_factor storeys,bridge")
    return Rig(table, free, ("1X", "2X", "3X", "5X", "6X", "7X"), ("9X",), (0.8, 16.0), ((3, 40.0), (7, 30.0)))


def shelf() -> Rig:
    """A portal frame with both feet in turning baseplates on a table, loaded with goods."""
    steel = {"mass": 4.0, "axial_stiffness": 4e6, "loss_factor": 0.025}
    nodes = {
        1: [0, 0],
        2: [0, 0.5],
        3: [0, 1.0],
        4: [0.5, 1.0],
        5: [1.0, 1.0],
        6: [1.5, 1.0],
        7: [1.5, 0.5],
        8: [1.5, 0],
    }
    table = structure(
        "X Y RZ", "1X 1Y 8X 8Y", nodes,
        beam_posts={"nodes": [*run_of(1, 2, 3), *run_of(6, 7, 8)], "bending_stiffness": 700.0, **steel},
        beam_girder={"nodes": run_of(3, 4, 5, 6), "bending_stiffness": 1200.0, **steel},
        spring_plates={"first": ["1RZ", "8RZ"], "stiffness": 2500.0, "loss_factor": 0.025},
        point_mass_goods={"nodes": [4, 5], "mass": 3.0},
    ) | {"base": ["1X", "8X"]}  # fmt: skip
    free = unknown(
        "bending_stiffness posts; bending_stiffness girder; stiffness plates; mass goods; loss_factor posts,girder,plates"
    )
    return Rig(table, free, ("2X", "3X", "4Y", "5Y", "7X"), ("1X",), (1.0, 70.0), ((3, 0.8), (5, 1.0)))


RIGS: dict[str, Callable[[], Rig]] = {
    made.__name__: made
    for made in (
        two_span, portal, shear, tower, grillage, truss, rail, hall, shaft, mast, drum, plate, dome, branches,
        crane, rack, wing, chimney, podium, shelf,
    )
}  # fmt: skip


def viscous(rig: Rig, strength: float = 1.0) -> Rig:
    """The rig with viscous damping in place of every loss factor, `strength` times as much in the middle of the band.

    Damping goes with the strain rate of bars and the speed of all else; springs get dashpots beside them.
    """
    table, omega = copy.deepcopy(rig.table), 2 * np.pi * float(np.sqrt(rig.band[0] * rig.band[1]))
    found: dict[str, tuple[str, str]] = {}
    for kind, own in list(sets(table)):
        loss = strength * own.pop("loss_factor", 0.0)
        if not loss:
            continue
        if kind == "spring":
            stiff = np.broadcast_to(own["stiffness"], count(own)) * loss / omega
            ends = {key: own[key] for key in ("first", "second") if key in own}
            name = f"{own['name']} dampers"
            table.setdefault("dashpot", []).append({"name": name, **ends, "viscous_damping": plain(stiff)})
            found[own["name"]] = ("viscous_damping", name)
        elif kind == "bar":
            own["stiffness_damping"] = plain(np.broadcast_to(own["axial_stiffness"], count(own)) * loss / omega)
            found[own["name"]] = ("stiffness_damping", own["name"])
        else:
            own["mass_damping"] = plain(np.broadcast_to(own["mass"], count(own)) * loss * omega)
            found[own["name"]] = ("mass_damping", own["name"])
    kept: list[Unknown] = []
    for one in rig.unknowns:
        if one.property != "loss_factor":
            kept.append(one)
            continue
        by_property: dict[str, list[str]] = {}
        for name in one.elements:
            by_property.setdefault(found[name][0], []).append(found[name][1])
        kept += [Unknown(name, tuple(elements), factor=True) for name, elements in by_property.items()]
    return replace(rig, table=table, unknowns=tuple(kept))


def plain(values: Any) -> Any:
    """One number where all are the same, else a list."""
    values = np.asarray(values, dtype=float)
    return float(values.flat[0]) if np.all(values == values.flat[0]) else values.tolist()


def properties(table: Table, one: Unknown) -> list[tuple[dict[str, Any], str]]:
    """Sets and properties that an unknown stands for."""
    found = []
    for name in one.elements:
        kind, own = find(table, name)
        whole = one.property == "stiffness" and kind != "spring"
        found += [(own, key) for key in (STIFFNESSES[kind] if whole else (one.property,))]
    return found


def started(rig: Rig, rng: np.random.Generator, off: tuple[float, float]) -> tuple[Table, dict[str, float]]:
    """The table that the study begins with, and the true value of every parameter.

    Each parameter's start is off by a factor between 1 + off[0] and 1 + off[1], up or down.
    """
    table, truth = copy.deepcopy(rig.table), {}
    for one in rig.unknowns:
        places = properties(table, one)
        own, key = places[0]
        many = count(own) if one.each else 1
        factor = (1 + rng.uniform(*off, many)) ** rng.choice([-1, 1], many)
        for number in range(many):
            label = f"{one.label}:{number + 1}" if one.each and many > 1 else one.label
            value = row(own, number if one.each else 0)[key]
            truth[f"{one.property}[{label}]"] = float(factor[number]) if one.factor else float(value)
        for own, key in places:
            values = np.broadcast_to(own[key], count(own))
            own[key] = plain(values / (factor if one.each else factor[0]))
    return table, truth


def exported(table: Table, names: tuple[str, ...]) -> dict[str, tuple[tuple[str, ...], np.ndarray, np.ndarray]]:
    """Degrees of freedom, mass and stiffness (without loss) of each element set, over all that it touches."""
    found = {}
    for name in names:
        kind, own = find(table, name)
        alone = assembled({"active": table["active"], "fixed": [], "nodes": table["nodes"], kind: [own]})
        order = np.array(sorted(range(len(alone.dofs)), key=lambda i: (split(alone.dofs[i]), i)))
        at = np.ix_(order, order)
        found[name] = (tuple(alone.dofs[i] for i in order), alone.mass[at], alone.stiffness.real[at])
    return found
