"""`python -m fuzz.true_decks`: decks whose truth is known, in every way of writing them that the formats allow.

The writers know nothing of the readers: numbers are written first, and the truth is worked out from what was written by
mathematics of its own (points of systems one after another, directions by differences, kinetic and strain energies).
"""

from __future__ import annotations

import argparse
import math
import random
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from structid.core.dof import DIRECTIONS
from structid.fem.meshes import Mesh, read_mesh

Vector = np.ndarray


@dataclass
class System:
    """A coordinate system by its origin and axes in basic coordinates."""

    number: int
    form: str
    origin: Vector
    axes: Vector

    def point(self, a: float, b: float, c: float) -> Vector:
        """The basic coordinates of local ones."""
        x, y, z = self.axes
        if self.form == "R":
            return self.origin + a * x + b * y + c * z
        if self.form == "C":
            return self.origin + a * math.cos(math.radians(b)) * x + a * math.sin(math.radians(b)) * y + c * z
        t, p = math.radians(b), math.radians(c)
        radius = x * math.sin(t) * math.cos(p) + y * math.sin(t) * math.sin(p) + z * math.cos(t)
        return self.origin + a * radius

    def directions(self, position: Vector) -> Vector:
        """Directions at a point, by differences of `point` along each local coordinate."""
        x, y, z = self.axes @ (position - self.origin)
        local = [x, y, z]
        if self.form == "C":
            local = [math.hypot(x, y), math.degrees(math.atan2(y, x)), z]
        if self.form == "S":
            r = math.sqrt(x * x + y * y + z * z)
            local = [r, math.degrees(math.atan2(math.hypot(x, y), z)), math.degrees(math.atan2(y, x))]
        rows = []
        for k in range(3):
            step = 0.5  # a chord of a circle, and of a line, has the direction at its middle
            up, down = list(local), list(local)
            up[k] += step
            down[k] -= step
            along = self.point(*up) - self.point(*down)
            rows.append(along / np.linalg.norm(along))
        return np.array(rows)


BASIC = System(0, "R", np.zeros(3), np.eye(3))


@dataclass
class Truth:
    """What a deck says."""

    nodes: dict[int, Vector] = field(default_factory=dict)
    directions: dict[int, Vector] = field(default_factory=dict)
    cells: dict[str, list[list[int]]] = field(default_factory=dict)
    bodies: dict[int, tuple[float, Vector, Vector]] = field(default_factory=dict)
    springs: list[tuple[float, dict[tuple[int, int], Vector]]] = field(default_factory=list)
    node_sets: dict[str, list[int]] = field(default_factory=dict)
    arms: dict[tuple[int, ...], list[Vector]] = field(default_factory=dict)
    means: list[tuple[int, str, list[tuple[float, str, list[int]]]]] = field(default_factory=list)


def number(rng: random.Random, low: float = -9.0, high: float = 9.0) -> float:
    """A number that a field of eight characters holds exactly."""
    return round(rng.uniform(low, high), 2)


def real(rng: random.Random, value: float, width: int) -> str:
    """One of the ways to write a number, within `width` characters."""
    mantissa, exponent = f"{value:.4e}".split("e")
    mantissa, power = mantissa.rstrip("0"), int(exponent)
    shifted = f"{float(mantissa) * 10:.4f}".rstrip("0")
    ways = [
        f"{value:.2f}",
        f"{value:.2f}".rstrip("0"),
        f"{value:.2f}".replace("0.", ".", 1) if abs(value) < 1 else f"{value:.2f}",
        f"{mantissa}{power:+d}",
        f"{mantissa}E{power:+d}",
        f"{mantissa}E{power}",
        f"{mantissa}D{power:+03d}",
        f"{mantissa}e{power:+03d}",
        f"{shifted}{power - 1:+d}",
    ]
    fitting = [way for way in ways if len(way) <= width]
    return rng.choice(fitting)


class BulkWriter:
    """Cards of Nastran in any form of field, with any continuation."""

    def __init__(self, rng: random.Random) -> None:
        self.rng, self.lines, self.marks = rng, list[str](), 0

    def card(self, name: str, *fields: float | str | None, form: str = "") -> None:
        """Write one card."""
        rng = self.rng
        form = form or rng.choice(["small", "large", "free", "free large"])
        width = {"small": 8, "large": 16, "free": 12, "free large": 16}[form]
        words = ["" if f is None else real(rng, f, width) if isinstance(f, float) else str(f) for f in fields]
        while words and not words[-1]:
            words.pop()
        each = 4 if "large" in form else 8
        rows = [words[i : i + each] for i in range(0, max(len(words), 1), each)]
        if "large" in form and len(rows) % 2:
            rows.append([])
        self.marks += 1
        marked = rng.random() < 0.5
        for place, row in enumerate(rows):
            mark = f"+{self.marks % 999}{chr(65 + place % 26)}" if marked else ""
            before = f"{self.marks % 999}{chr(64 + place % 26)}" if marked and place else ""
            star = "*" if "large" in form else "+"
            head = name + ("*" if "large" in form else "") if place == 0 else (star + before)
            last = place == len(rows) - 1
            if "free" in form:
                cells = [rng.choice(["", " "]) + word for word in row]
                if marked and not last:
                    cells += [""] * (each - len(cells)) + [mark]
                self.lines.append(",".join([head if place == 0 or rng.random() < 0.7 or star == "*" else "", *cells]))
            else:
                if place and not marked and star == "+" and rng.random() < 0.4:
                    head = ""
                text = head.ljust(8) + "".join(
                    (word.rjust(width) if rng.random() < 0.3 else word.ljust(width)) for word in row
                )
                self.lines.append((text.ljust(72) + mark if marked and not last else text).rstrip())
        if rng.random() < 0.1:
            self.lines.append(rng.choice(["$ a comment, = *1", "", "$"]))


def systems_of(rng: random.Random, deck: BulkWriter) -> list[System]:
    """Chained CORD2R, CORD2C and CORD2S."""
    made = [BASIC]
    for index in range(rng.randint(0, 4)):
        reference, form = rng.choice(made), rng.choice("RCS")
        while True:
            points = []
            for _ in range(3):
                first = abs(number(rng)) + 1 if reference.form != "R" else number(rng)
                points.append([first, number(rng, 10, 80), number(rng, 10, 80)])
            a, b, c = (reference.point(*point) for point in points)
            z = (b - a) / np.linalg.norm(b - a)
            x = (c - a) - z * (z @ (c - a))
            if np.linalg.norm(x) > 0.5 and np.linalg.norm(b - a) > 0.5:
                break
        x /= np.linalg.norm(x)
        system = System(10 + index, form, a, np.array([x, np.cross(z, x), z]))
        deck.card(
            f"CORD2{form}",
            system.number,
            reference.number or rng.choice([None, 0]),
            *(x for point in points for x in point),
        )
        made.append(system)
    return made


def bulk_deck(rng: random.Random, folder: Path) -> tuple[Path, Truth]:
    """A bulk data file, with its included files."""
    deck, truth = BulkWriter(rng), Truth()
    systems = systems_of(rng, deck)
    default = rng.choice(systems) if rng.random() < 0.3 else None
    default_cd = rng.choice(systems) if default is not None and rng.random() < 0.5 else None
    if default is not None:
        deck.card("GRDSET", None, default.number, None, None, None, default_cd.number if default_cd else None)
    labels = rng.sample(range(1, 9999), 12)
    for label in labels:
        system, cd = rng.choice(systems), rng.choice(systems)
        local = [number(rng) for _ in range(3)]
        if system.form != "R":
            local = [abs(local[0]) + 1, number(rng, 5, 170), number(rng, 5, 170)]
        blank_cp, blank_cd = rng.random() < 0.4, rng.random() < 0.5
        used = (default or BASIC) if blank_cp else system
        used_cd = (default_cd or BASIC) if blank_cd else cd
        if used.form != "R" and local[0] <= 0:
            local = [abs(local[0]) + 1, number(rng, 5, 170), number(rng, 5, 170)]
        position = used.point(*local)
        truth.nodes[label] = position
        truth.directions[label] = used_cd.directions(position)
        cp = None if blank_cp else system.number
        deck.card("GRID", label, cp, *local, None if blank_cd else cd.number)
    if rng.random() < 0.5:
        _replicated_grids(rng, deck, truth)
    _cord1(rng, deck, truth, labels)
    every = list(truth.nodes)
    for index, (name, count) in enumerate(
        rng.choices([("CQUAD4", 4), ("CTRIA3", 3), ("CHEXA", 8), ("CTETRA", 4), ("CBAR", 2), ("CROD", 2)], k=6)
    ):
        eid, nodes = 100 + index, rng.sample(every, count)
        pid = rng.choice([None, rng.randint(1, 3)])
        deck.card(name, eid, pid, *nodes, *_offset(rng, truth, name, nodes))
        truth.cells.setdefault(str(pid or eid), []).append(nodes)
    deck.card("CQUAD4", 99, 7, *every[:4])
    truth.cells.setdefault("7", []).append(every[:4])
    _bodies(rng, deck, truth, systems, every)
    _springs(rng, deck, truth, every)
    _means(rng, deck, truth, every)
    return _bulk_files(rng, folder, deck.lines), truth


def _offset(rng: random.Random, truth: Truth, name: str, nodes: list[int]) -> list[float | str | None]:
    """Fields behind the nodes of a plate or bar that stands off them, along its normal or the directions of their motion."""
    if rng.random() < 0.5 or tuple(nodes) in truth.arms:
        return []
    places = [truth.nodes[node] for node in nodes]
    height = number(rng, 0.1, 0.9)
    if name in ("CQUAD4", "CTRIA3"):
        sides = (
            (places[2] - places[0], places[3] - places[1])
            if len(nodes) == 4
            else (places[1] - places[0], places[2] - places[0])
        )
        normal = np.array([np.linalg.det([*sides, unit]) for unit in np.eye(3)])
        if not normal @ normal > 1e-3:
            return []
        truth.arms[tuple(nodes)] = [height * normal / math.sqrt(sum(normal**2))] * len(nodes)
        return [None, height]
    if name == "CBAR":
        local = [[number(rng, -1, 1) for _ in range(3)] for _ in range(2)]
        truth.arms[tuple(nodes)] = [
            sum(part * axis for part, axis in zip(parts, truth.directions[node], strict=True))
            for parts, node in zip(local, nodes, strict=True)
        ]
        return [0.3, 0.4, 0.5, rng.choice([None, "GGG"]), None, None, *local[0], *local[1]]
    return []


def _replicated_grids(rng: random.Random, deck: BulkWriter, truth: Truth) -> None:
    """A row of grid points by `=`, `*n` and `=n`, in basic coordinates."""
    first, count, step = 20000, rng.randint(1, 6), rng.randint(1, 5)
    start, increment = [number(rng) for _ in range(3)], number(rng, 0.1, 2.0)
    deck.lines.append(f"GRID,{first},0," + ",".join(f"{x:.2f}" for x in start) + ",0")
    stepped = rng.choice([f"*{increment:.2f}", f"*({increment:.2f})"])
    labels = rng.choice([f"*{step}", f"*({step})"])
    deck.lines.append(f"={rng.choice([',', ' , '])}{labels},=,{stepped},=,{rng.choice(['=,=', '=='])}")
    if count > 1:
        deck.lines.append(rng.choice([f"={count - 1}", f"=({count - 1})"]))
    for k in range(count + 1):
        label = first + k * step
        truth.nodes[label] = np.array([start[0] + k * increment, start[1], start[2]])
        truth.directions[label] = np.eye(3)


def _cord1(rng: random.Random, deck: BulkWriter, truth: Truth, labels: list[int]) -> None:
    """A system by three grid points, and a grid point in it."""
    three = rng.sample(labels, 3)
    a, b, c = (truth.nodes[label] for label in three)
    across = np.cross(b - a, c - a)
    if np.linalg.norm(across) < 1.0:
        return
    z = (b - a) / np.linalg.norm(b - a)
    y = np.cross(z, c - a) / np.linalg.norm(np.cross(z, c - a))
    form = rng.choice("RCS")
    system = System(77, form, a, np.array([np.cross(y, z), y, z]))
    deck.card(f"CORD1{form}", 77, *three)
    local = [abs(number(rng)) + 1, number(rng, 5, 170), number(rng, 5, 170)]
    deck.card("GRID", 30001, 77, *local, 77)
    truth.nodes[30001] = system.point(*local)
    truth.directions[30001] = system.directions(truth.nodes[30001])


def _bodies(rng: random.Random, deck: BulkWriter, truth: Truth, systems: list[System], every: list[int]) -> None:
    """CONM2 with an arm and inertia in systems of their own."""
    for eid, node in enumerate(rng.sample(every, 3), 500):
        system, mass = rng.choice(systems), number(rng, 0.5, 9)
        arm = np.array([number(rng, -1, 1) for _ in range(3)]) * rng.choice([0, 1])
        xx, yy, zz = (number(rng, 5, 9) for _ in range(3))
        yx, zx, zy = (number(rng, -1, 1) * rng.choice([0, 1]) for _ in range(3))
        inertia = np.array([[xx, -yx, -zx], [-yx, yy, -zy], [-zx, -zy, zz]])
        fields = [xx, yx, yy, zx, zy, zz]
        if rng.random() < 0.3:
            deck.card(
                "CONM2", eid, node, -1, mass, *(float(round(x, 2)) for x in truth.nodes[node] + arm), None, *fields
            )
            truth.bodies[node] = mass, np.round(truth.nodes[node] + arm, 2) - truth.nodes[node], inertia
            continue
        deck.card("CONM2", eid, node, system.number or None, mass, *map(float, arm), None, *fields)
        turn = system.directions(truth.nodes[node])
        truth.bodies[node] = mass, turn.T @ arm, turn.T @ inertia @ turn


def _springs(rng: random.Random, deck: BulkWriter, truth: Truth, every: list[int]) -> None:
    """CELAS1 and CELAS2 between components, along the displacement systems of their grid points."""
    for eid in range(600, 604):
        first, second = rng.sample(every, 2)
        stiffness = number(rng, 1, 99)
        components = [rng.randint(1, 3), rng.randint(1, 3)]
        if rng.random() < 0.5:
            deck.card("PELAS", eid + 100, stiffness)
            head: list[float | int] = [eid, eid + 100]
            name = "CELAS1"
        else:
            head, name = [eid, stiffness], "CELAS2"
        to_ground = rng.random() < 0.3
        deck.card(name, *head, first, components[0], *([None, None] if to_ground else [second, components[1]]))
        works = {(first, 0): truth.directions[first][components[0] - 1]}
        if not to_ground:
            works[second, 0] = -truth.directions[second][components[1] - 1]
        truth.springs.append((stiffness, works))


def _means(rng: random.Random, deck: BulkWriter, truth: Truth, every: list[int]) -> None:
    """RBE3 of translations and rotations with weights, along the displacement systems of their grid points."""
    nodes = rng.sample(every, 7)
    components = rng.choice(["123456", "123", "456"])
    groups = [(number(rng, 0.5, 9), "123", nodes[1:4])]
    if rng.random() < 0.6:
        groups.append((number(rng, 0.5, 9), rng.choice(["456", "123456", "3", "15"]), nodes[4 : rng.randint(5, 7)]))
    fields: list[float | str | int | None] = [700, None, nodes[0], components]
    for weight, which, members in groups:
        fields += [weight, which, *members]
    deck.card("RBE3", *fields)
    truth.means.append((nodes[0], components, groups))


def _bulk_files(rng: random.Random, folder: Path, lines: list[str]) -> Path:
    """The cards as a deck: with or without executive and case control, ENDDATA and included files."""
    cards = _whole_cards(lines)
    body: list[str] = []
    if rng.random() < 0.5 and len(cards) > 12:
        cut = sorted(rng.sample(range(2, len(cards) - 1), 2))
        inner, middle = cards[cut[0] : cut[1]], rng.randint(0, cut[1] - cut[0])
        name, deeper = rng.choice(["a b/part one.inc", "parts/one.bdf", "one.dat"]), "parts/two.inc"
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / deeper).parent.mkdir(exist_ok=True)
        text = [line for card in inner[:middle] for line in card]
        quote = rng.choice(["'", '"'])
        text.append(f"include {quote}{deeper}{quote}")  # from the root, as solvers have it
        (folder / name).write_text("\n".join(text) + "\n")
        (folder / deeper).write_text("\n".join(line for card in inner[middle:] for line in card) + "\n")
        body = [line for card in cards[: cut[0]] for line in card]
        body.append(f"INCLUDE '{name}'")
        body += [line for card in cards[cut[1] :] for line in card]
    else:
        body = [line for card in cards for line in card]
    head = rng.choice([[], ["BEGIN BULK"], ["SOL 103", "CEND", "TITLE = a, b", "SPC = 1", "begin bulk"]])
    text = "\n".join([*head, *body, *rng.choice([[], ["ENDDATA"], ["enddata abc"]])]) + "\n"
    has_include = any(line.startswith("INCLUDE") for line in body)
    text = text.lower() if rng.random() < 0.2 and not has_include else text
    path = folder / f"deck{rng.choice(['.bdf', '.dat', '.nas', '.fem'])}"
    path.write_bytes(text.replace("\n", rng.choice(["\n", "\r\n"])).encode())
    return path


def _whole_cards(lines: list[str]) -> list[list[str]]:
    """Lines with those that continue them; replicated ones stay with what they repeat."""
    cards: list[list[str]] = []
    for line in lines:
        if cards and (not line or line[0] in " +*,=$"):
            cards[-1].append(line)
        else:
            cards.append([line])
    return cards


def abaqus_deck(rng: random.Random, folder: Path) -> tuple[Path, Truth]:
    """An Abaqus input file: flat, or parts in an assembly, with systems of nodes and turned instances."""
    truth, lines = Truth(), ["*HEADING", "a deck"]
    parts = {}
    for name in ("Panel", "Rib")[: rng.randint(1, 2)]:
        parts[name] = _abaqus_part(rng, folder, name)
    if len(parts) == 1 and rng.random() < 0.4:
        [(text, nodes, cells)] = parts.values()
        lines += text
        truth.nodes = nodes
        truth.cells = {"SKIN": cells}
        truth.node_sets = {"EDGE": sorted(nodes)[:2]}
    else:
        for name, (text, _, _) in parts.items():
            lines += [f"*Part, name={name}", *text, "*End Part"]
        lines += ["*Assembly, name=A"]
        shift, instances = 0, rng.choices(list(parts), k=rng.randint(1, 3))
        highest = max(max(max(nodes), 201) for _, nodes, _ in (parts[name] for name in instances))
        taken: set[int] = set()
        for index, name in enumerate(instances):
            _, nodes, cells = parts[name]
            placing, move = _placing(rng)
            lines += [f"*Instance, name={name}-{index}, part={name.upper()}", *placing, "*End Instance"]
            cell_labels = {200 + k for k in range(len(cells))}
            repeats = bool(taken & (set(nodes) | {-c for c in cell_labels}))
            shift = index * 10 ** len(str(highest)) if repeats else 0
            taken |= {n + shift for n in nodes} | {-(c + shift) for c in cell_labels}
            truth.nodes |= {label + shift: move(position) for label, position in nodes.items()}
            here = [[n + shift for n in cell] for cell in cells]
            truth.cells.setdefault("SKIN", []).extend(here)
            edge = sorted(nodes)[:2]
            lines += [f"*Nset, nset=E{index}, instance={name}-{index}", " " + ", ".join(map(str, edge))]
            truth.node_sets[f"E{index}"] = [n + shift for n in edge]
        lines += ["*End Assembly"]
    lines += ["*STEP", "*FREQUENCY", "4", "*END STEP"]
    path = folder / "deck.inp"
    path.write_bytes(rng.choice(["\n", "\r\n"]).join([*lines, ""]).encode())
    return path, truth


def _abaqus_part(rng: random.Random, folder: Path, name: str) -> tuple[list[str], dict[int, Vector], list[list[int]]]:
    system, lines = BASIC, []
    if rng.random() < 0.5:
        system, lines = _abaqus_system(rng)
    form, count = rng.choice(["", "R", "C"]), 6
    labels = sorted(rng.sample(range(1, 99), count))
    nodes, rows = {}, []
    for label in labels:
        local = [number(rng) if form != "C" else abs(number(rng)) + 1, number(rng, 5, 170), number(rng)]
        own = System(0, form or "R", system.origin, system.axes)
        nodes[label] = own.point(*local)
        rows.append(f"{label}, " + ", ".join(f"{x:.2f}" if rng.random() < 0.7 else f"{x:.4E}" for x in local))
    options = (f", SYSTEM={form}" if form else "") + rng.choice(["", ", NSET=ALL"])
    if rng.random() < 0.3:
        (folder / f"{name} nodes.inc").write_text("\n".join(rows) + "\n")
        lines += [f"*{rng.choice(['NODE', 'Node', 'node'])}{options}, INPUT={name} nodes.inc"]
    else:
        lines += [f"*NODE{options}", *rows]
    cells = [rng.sample(labels, 4) for _ in range(2)]
    kind = rng.choice(["S4", "S4R", "CPS4", "M3D4"])
    lines += [f"*ELEMENT, TYPE={kind},{rng.choice(['', chr(10)])} ELSET=SKIN"]
    for k, cell in enumerate(cells):
        words = [str(200 + k), *map(str, cell)]
        lines += [", ".join(words)] if rng.random() < 0.6 else [", ".join(words[:3]) + ",", ", ".join(words[3:])]
    lines += ["** a comment", "*NSET, NSET=EDGE", ",".join(map(str, labels[:2]))]
    return lines, nodes, cells


def _abaqus_system(rng: random.Random) -> tuple[System, list[str]]:
    """*SYSTEM: a shift, axes in the plane, or three points."""
    origin = np.array([number(rng) for _ in range(3)])
    if rng.random() < 0.3:
        return System(0, "R", origin, np.eye(3)), ["*SYSTEM", ", ".join(f"{v:.2f}" for v in origin)]
    on_x = origin + np.array([number(rng, 1, 5), number(rng, 1, 5), 0.0])
    first = ", ".join(f"{v:.2f}" for v in [*origin, *on_x])
    x = (on_x - origin) / np.linalg.norm(on_x - origin)
    if rng.random() < 0.5:
        return System(0, "R", origin, np.array([x, np.cross([0, 0, 1], x), [0, 0, 1]])), ["*SYSTEM", first]
    in_xy = origin + np.array([number(rng, 1, 5), number(rng, -5, -1), number(rng, 1, 5)])
    y = (in_xy - origin) - x * (x @ (in_xy - origin))
    y /= np.linalg.norm(y)
    return System(0, "R", origin, np.array([x, y, np.cross(x, y)])), [
        "*SYSTEM",
        first,
        ", ".join(f"{v:.2f}" for v in in_xy),
    ]


def _placing(rng: random.Random) -> tuple[list[str], Callable[[Vector], Vector]]:
    """Data lines of an instance and what they do to a position: quaternions turn it."""
    shift = np.array([number(rng) for _ in range(3)])
    kind = rng.randint(0, 2)
    if kind == 0:
        return [], lambda position: position
    line = ", ".join(f"{v:.2f}" for v in shift)
    if kind == 1:
        return [line], lambda position: position + shift
    start = np.array([number(rng) for _ in range(3)])
    end, degrees = start + np.array([number(rng, 1, 3) for _ in range(3)]), number(rng, -170, 170)
    axis = (end - start) / np.linalg.norm(end - start)
    half = math.radians(degrees) / 2
    w, u = math.cos(half), math.sin(half) * axis

    def turned(position: Vector) -> Vector:
        v = position + shift - start
        return start + v + 2 * w * np.cross(u, v) + 2 * np.cross(u, np.cross(u, v))

    return [line, ", ".join(f"{v:.2f}" for v in [*start, *end, degrees])], turned


def differences(mesh: Mesh, truth: Truth) -> list[str]:
    """What a mesh has otherwise than it is."""
    wrong = []
    if set(mesh.labels.tolist()) != set(truth.nodes):
        return [f"labels {sorted(mesh.labels.tolist())} instead of {sorted(truth.nodes)}"]
    for label, position in truth.nodes.items():
        if np.abs(mesh.nodes[label] - position).max() > 1e-9 * max(1.0, float(np.abs(position).max())):
            wrong.append(f"node {label} at {mesh.nodes[label]} instead of {position}")
    for label, directions in truth.directions.items():
        if np.abs(mesh.displacement_axes.get(label, np.eye(3)) - directions).max() > 1e-6:
            wrong.append(f"directions of node {label}")
    for name, cells in truth.cells.items():
        rows = [[n for n in row if n >= 0] for row in mesh.cells(name).tolist()]
        if sorted(rows) != sorted(cells):
            wrong.append(f"cells {rows} of {name} instead of {cells}")
    for name, nodes in truth.node_sets.items():
        if mesh.group_nodes(name).tolist() != sorted(nodes):
            wrong.append(f"nodes {mesh.group_nodes(name)} of {name} instead of {nodes}")
    arms = {
        tuple(mesh.blocks[offset.block].nodes[row].tolist()): arms
        for part in mesh.parts
        for offset in part.offsets
        for row, arms in zip(offset.rows.tolist(), offset.arms, strict=True)
    }
    if set(arms) != set(truth.arms) or any(np.abs(arms[key] - truth.arms[key]).max() > 1e-7 for key in arms):
        wrong.append(f"offsets {arms} instead of {truth.arms}")
    return wrong + _wrong_means(mesh, truth) + _wrong_bodies(mesh, truth) + _wrong_springs(mesh, truth)


def _wrong_means(mesh: Mesh, truth: Truth) -> list[str]:
    """Means that are not the least squares of a rigid motion, for random motions of all nodes."""
    rng, wrong = np.random.default_rng(2), []
    for reference, components, groups in truth.means:
        [part] = [part for part in mesh.parts if part.kind == "RBE3"]
        nodes = sorted({node for _, _, members in groups for node in members})
        span = sum(np.linalg.norm(truth.nodes[n] - truth.nodes[reference]) for n in nodes) / len(nodes)
        moves = {label: rng.standard_normal(6) for label in truth.nodes}
        table, values = [], []
        for weight, which, members in groups:
            for node in members:
                for digit in map(int, which):
                    axis, root = truth.directions[node][(digit - 1) % 3], math.sqrt(weight)
                    arm = truth.nodes[node] - truth.nodes[reference]
                    if digit > 3:
                        table.append(root * span * np.concatenate([np.zeros(3), axis]))
                        values.append(root * span * axis @ moves[node][3:])
                    else:
                        table.append(root * np.concatenate([axis, np.cross(arm, axis)]))
                        values.append(root * axis @ moves[node][:3])
        if np.linalg.matrix_rank(np.array(table), tol=1e-3) < 6:
            continue
        motion = np.linalg.lstsq(np.array(table), np.array(values), rcond=None)[0]
        read = {DIRECTIONS.index(tie.dependent.direction): tie for tie in part.ties}
        if part.obstacle or {int(digit) - 1 for digit in components} != set(read):
            wrong.append(f"RBE3 of {reference}: {part.obstacle or sorted(read)}")
            continue
        for axis, tie in read.items():
            mean = sum(factor * moves[dof.node][DIRECTIONS.index(dof.direction)] for dof, factor in tie.depends_on)
            if abs(mean - motion[axis]) > 1e-6 * max(1.0, float(np.abs(motion).max())):
                wrong.append(f"RBE3 of {reference} along {axis}: {mean} instead of {motion[axis]}")
    return wrong


def _wrong_bodies(mesh: Mesh, truth: Truth) -> list[str]:
    """Kinetic energies of six motions that differ."""
    masses = {mass.node: mass.matrix for part in mesh.parts if part.kind == "CONM2" for mass in part.masses}
    if set(masses) != set(truth.bodies):
        return [f"bodies at {sorted(masses)} instead of {sorted(truth.bodies)}"]
    wrong = []
    motions = np.random.default_rng(0).standard_normal((8, 6))
    for node, (mass, arm, inertia) in truth.bodies.items():
        for motion in motions:
            velocity = motion[:3] + np.cross(motion[3:], arm)
            energy = mass * velocity @ velocity + motion[3:] @ inertia @ motion[3:]
            if abs(motion @ masses[node] @ motion - energy) > 1e-6 * abs(energy):
                wrong.append(f"the body at node {node}")
                break
    return wrong


def _wrong_springs(mesh: Mesh, truth: Truth) -> list[str]:
    """Strain energies of random displacements that differ, all springs together."""
    rng = np.random.default_rng(1)
    springs = [spring for part in mesh.parts for spring in part.springs]
    for _ in range(4):
        moves = {label: rng.standard_normal(6) for label in truth.nodes}
        energy = sum(
            k * sum(vector @ moves[node][:3] for (node, _), vector in works.items()) ** 2 for k, works in truth.springs
        )
        read = sum(
            spring.stiffness
            * sum(
                weight * moves[node][DIRECTIONS.index(direction)]
                for (node, direction), weight in spring.weights.items()
            )
            ** 2
            for spring in springs
        )
        if abs(read - energy) > 1e-6 * max(abs(energy), 1e-30):
            return ["springs"]
    return []


WRITERS = {"nastran": bulk_deck, "abaqus": abaqus_deck}


def check_deck(kind: str, seed: int, folder: Path) -> list[str]:
    """Differences of one deck, and nothing where it is read right."""
    path, truth = WRITERS[kind](random.Random(seed), folder)
    return differences(read_mesh(path), truth)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=random.SystemRandom().randrange(10**9))
    options = parser.parse_args()
    print(f"{options.count} decks whose truth is known, seed {options.seed}")
    wrong = 0
    for kind in WRITERS:
        for index in range(options.count // len(WRITERS)):
            with tempfile.TemporaryDirectory() as name:
                try:
                    words = check_deck(kind, options.seed + index, Path(name))
                except Exception as error:
                    words = [f"{type(error).__name__}: {error}"]
            if words:
                wrong += 1
                print(f"{kind}, seed {options.seed + index}: {'; '.join(words)[:300]}")
    print(f"read wrongly or refused: {wrong}")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
