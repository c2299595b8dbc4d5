"""`python -m fuzz.true_modes`: files of modes whose truth is known, in every way of writing them that the formats allow.

The writers know nothing of the readers: shapes in SI and global axes are drawn first, then told as a header of dataset 55 or
2414, a listing or a punch file would tell them: in its units, axes, kind of motion, columns and exponents. Each file must be read
right, or refused where it holds no modes or does not say enough.
"""

from __future__ import annotations

import argparse
import cmath
import math
import random
import secrets
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fuzz.binary_results import Writer
from structid.core.errors import InputError
from structid.modal import ModalRecord
from structid.modal.formats.files import read_modes
from structid.modal.formats.options import ModeFileOptions

_TOLERANCE = 3e-5


@dataclass
class Mode:
    """A mode in SI and global axes: `shape[node]` has six components of the displacement, those not measured are 0."""

    s: complex
    shape: dict[int, np.ndarray]
    mass: float
    viscous: float | None = None  # damping ratio that is stated beside an undamped frequency

    @property
    def ratio(self) -> float:
        return -self.s.real / abs(self.s) if self.viscous is None else self.viscous


@dataclass
class Case:
    """A file and what reading it must give: its modes, scaled to unit modal mass or not, or a refusal."""

    name: str
    text: str
    modes: list[Mode] = field(default_factory=list)
    has_mass: bool = False
    has_damping: bool = False
    components: int = 6
    refused: bool = False
    options: ModeFileOptions = field(default_factory=ModeFileOptions)
    deck: str = ""
    content: bytes = b""


# ------------------------------------------------------------------------------------------------------ what all have in common


def draw_axes(rng: random.Random, right_angles: bool) -> np.ndarray:
    """Three axes as rows: a turn by multiples of 90 deg, or any."""
    if right_angles:
        order = rng.choice([(0, 1, 2), (1, 2, 0), (2, 0, 1)])
        axes = np.eye(3)[list(order)]
        return axes * np.array(rng.choice([(1, 1, 1), (-1, -1, 1), (1, -1, -1)]))[:, None]
    a, b, c = (rng.uniform(-3, 3) for _ in range(3))
    about_z = np.array([[math.cos(a), math.sin(a), 0], [-math.sin(a), math.cos(a), 0], [0, 0, 1]])
    about_y = np.array([[math.cos(b), 0, -math.sin(b)], [0, 1, 0], [math.sin(b), 0, math.cos(b)]])
    about_x = np.array([[1, 0, 0], [0, math.cos(c), math.sin(c)], [0, -math.sin(c), math.cos(c)]])
    return about_x @ about_y @ about_z


def draw_modes(
    rng: random.Random, nodes: list[int], measured: dict[int, list[int]], is_complex: bool, is_damped: bool
) -> list[Mode]:
    """Modes of different frequencies, moving in the measured components of each node."""
    modes, frequency = [], rng.uniform(0.5, 5)
    for _ in range(rng.randint(1, 3)):
        frequency *= rng.uniform(1.5, 3)
        omega, ratio = 2 * math.pi * frequency, rng.uniform(0.001, 0.1) if is_damped else 0.0
        shape = {}
        for node in nodes:
            vector = np.zeros(6, dtype=complex)
            for k in measured[node]:
                size = rng.choice([-1, 1]) * rng.uniform(0.2, 1) * (3.0 if k > 2 else 1.0)
                vector[k] = size * (cmath.exp(1j * rng.uniform(-0.5, 0.5)) if is_complex else 1)
            shape[node] = vector
        s = complex(-ratio * omega, omega * math.sqrt(1 - ratio**2))
        modes.append(Mode(s, shape, rng.uniform(0.2, 500)))
    return modes


def turned(vector: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Components along `axes` of three translations and three rotations."""
    return np.concatenate([axes @ vector[:3], axes @ vector[3:]])


# ---------------------------------------------------------------------------------------------------------------- universal files

_UNITS = [(1, 1.0, 1.0), (9, 1000.0, 1.0), (10, 1000.0, 1.0), (7, 1 / 0.0254, 1 / 4.4482216152605), (9, 100.0, 10.0)]
_MOTION = {8: 0, 11: 1, 12: 2}


def real(rng: random.Random, value: float, style: str) -> str:
    """A number in thirteen columns."""
    text = f"{value:.5E}"
    mantissa, exponent = text.split("E")
    if style == "D":
        text = f"{mantissa}D{exponent}"
    if style == "short" and abs(int(exponent)) >= 10:
        text = f"{mantissa}{int(exponent):+04d}"
    return text.rjust(13)


def rows(rng: random.Random, values: list[float], style: str) -> list[str]:
    """Six numbers a line."""
    texts = [real(rng, value, style) for value in values]
    return ["".join(texts[i : i + 6]) for i in range(0, len(texts), 6)]


def integers(*values: int) -> str:
    return "".join(f"{value:10d}" for value in values)


def dataset(number: int, lines: list[str]) -> list[str]:
    return ["    -1", f"{number:6d}", *lines, "    -1"]


def vector_dataset(
    rng: random.Random,
    number: int,
    head: tuple[int, ...],
    specific: list[float],
    data: dict[int, list[float]],
    style: str,
) -> list[str]:
    """A dataset 55 or 2414 of the kind in `head`: model, analysis, characteristic, result, data type, values a node."""
    body = []
    for node, values in data.items():
        body += [
            f"{node:10d}" if rng.random() < 0.8 else f"{node:{rng.choice([11, 12, 1])}d}",
            *rows(rng, values, style),
        ]
    analysis = head[1]
    if number == 55:
        n_integers = {2: 2, 3: 2, 7: 2}.get(analysis, 2)
        lines = [rng.choice(["NONE", "mode", "    text -1 here"]) for _ in range(5)]
        reals = specific
        lines += [integers(*head), integers(n_integers, len(reals), 1, 1), *rows(rng, reals, style)]
        return dataset(55, lines + body)
    lines = [integers(1), "shape", integers(1), *["NONE"] * 5, integers(*head), integers(*[0] * 8), integers(0, 0)]
    if analysis == 2:
        frequency, mass, viscous, hysteretic = specific
        twelve = [0.0, frequency, (2 * math.pi * frequency) ** 2, mass, viscous, hysteretic, *[0.0] * 6]
    else:
        twelve = [0.0] * 6 + (specific + [0.0] * 6)[:6]
    return dataset(2414, lines + rows(rng, twelve, style) + body)


def geometry(rng: random.Random, nodes: list[int], scale: float) -> tuple[list[str], dict[int, np.ndarray]]:
    """Nodes, some with a displacement system of their own, and the axes of these."""
    systems, axes, lines = {}, {}, []
    for label in rng.sample(range(2, 40), rng.randint(0, 2)):
        systems[label] = (
            rng.choice([0, 0, 1]),
            draw_axes(rng, rng.random() < 0.5),
            [rng.uniform(-1, 1) for _ in range(3)],
        )
    if systems:
        body = [integers(1), "part"]
        for label, (kind, own, origin) in systems.items():
            body += [integers(label, kind, 8), "CS"]
            for row in [*own, np.array(origin) * scale]:
                body.append("".join(f"{x:25.16E}" for x in row))
        lines += dataset(2420, body)
    body = []
    for node in nodes:
        point = np.array([rng.uniform(-2, 2) for _ in range(3)])
        label = rng.choice([0, 1, *systems])
        if label in systems:
            kind, own, origin = systems[label]
            axes[node] = own
            if kind == 1:
                local = own @ (point - origin)
                angle = math.atan2(local[1], local[0])
                about = np.array(
                    [[math.cos(angle), math.sin(angle), 0], [-math.sin(angle), math.cos(angle), 0], [0, 0, 1]]
                )
                axes[node] = about @ own
        body += [integers(node, 1, label, 11), "".join(f"{x * scale:25.16E}".replace("E", "D") for x in point)]
    return lines + dataset(2411, body), axes


def universal(rng: random.Random) -> Case:
    """A universal file of modes, with other results beside them, or of other results alone."""
    nodes = rng.sample([*range(1, 60), 60101, 123456, 999999999], rng.randint(2, 5))
    width = rng.choice([3, 3, 6])
    number, analysis = rng.choice([55, 55, 2414]), rng.choice([2, 2, 3, 7])
    result = rng.choice([8, 8, 8, 11, 12, rng.choice([0, 1])])
    characteristic = rng.choice([2 if width == 3 else 3] * 3 + [0])
    data = rng.choice([2, 4, 5, 6]) if analysis == 2 else rng.choice([5, 6])
    style = rng.choice(["E", "E", "D", "short"])
    is_complex = data in (5, 6)
    code, f_length, f_force = rng.choice(_UNITS)
    has_units = rng.random() < 0.7
    f_length, f_force = (f_length, f_force) if has_units else (1.0, 1.0)
    lines: list[str] = []
    if has_units:
        body = [
            f"{code:10d}{'units':<20s}{2:10d}",
            "".join(f"{x:25.17E}" for x in (f_length, f_force, 1.0)).replace("E", "D"),
        ]
        lines += dataset(164, [*body, f"{273.15:25.17E}"])
    geometric, axes = geometry(rng, nodes, f_length) if rng.random() < 0.6 else ([], {})
    if rng.random() < 0.5:
        lines, geometric = geometric, lines
    lines += geometric
    if rng.random() < 0.4:
        lines += dataset(151, ["model", "NONE", "structid", "01-jan-26  12:00:00", "NONE", "NONE", "NONE"])
    measured = {node: sorted(rng.sample(range(width), rng.randint(1, width))) for node in nodes}
    for node, own in axes.items():
        if np.abs(own).max(axis=1).min() < 1 - 1e-9:  # a part of oblique directions is no part of the global ones
            measured[node] = list(range(width))
    modes = draw_modes(rng, nodes, measured, is_complex, analysis != 2)
    mass = rng.choice(["all", "all", "none", "one"])
    damping = [rng.choice([0.0, rng.uniform(0.001, 0.05)]) for _ in modes]
    case = Case(f"uff {number}", "", modes, components=width)
    blocks = []
    for k, mode in enumerate(modes):
        states_mass = mass == "all" or (mass == "one" and k == 0)
        n_mass = mode.mass * f_length * f_force if states_mass else 0.0
        if analysis == 2:
            specific = [mode.s.imag / (2 * math.pi), n_mass, damping[k], 0.0]
            mode.viscous = damping[k]
            factor = (2 * math.pi * specific[0]) ** _MOTION.get(result, 0)
            if is_complex:
                factor = (2j * math.pi * specific[0]) ** _MOTION.get(result, 0)
        else:
            modal_a = 2j * mode.s.imag * n_mass
            specific = [mode.s.real, mode.s.imag, modal_a.real, modal_a.imag, 0.0, 0.0]
            factor = mode.s ** _MOTION.get(result, 0)
        values = {}
        for node, vector in mode.shape.items():
            told = turned(vector, axes[node]) if node in axes else vector
            told = np.concatenate([told[:3] * f_length, told[3:]])[:width] * factor
            values[node] = (
                np.stack([told.real, told.imag], axis=1).ravel().tolist() if is_complex else told.real.tolist()
            )
        head = (rng.choice([0, 1]), analysis, characteristic, result, data, width)
        blocks.append(vector_dataset(rng, number, head, specific, values, style))
        if analysis != 2 and rng.random() < 0.3:  # the conjugate of it
            conjugate = {node: [v if i % 2 == 0 else -v for i, v in enumerate(own)] for node, own in values.items()}
            own = [specific[0], -specific[1], specific[2], -specific[3], 0.0, 0.0]
            blocks.append(vector_dataset(rng, number, head, own, conjugate, style))
    case.has_mass = mass == "all" or (mass == "one" and len(modes) == 1)
    case.has_mass = case.has_mass and result in _MOTION
    if characteristic == 0 and result not in _MOTION:
        case.refused = True
    others = []
    for _ in range(rng.randint(0, 2)):  # what is no mode
        change = rng.choice(["model", "analysis", "result", "characteristic"])
        head = [1, 2, 2, 8, 2, 3]
        if change == "model":
            head[0] = rng.choice([2, 3])
        if change == "analysis":
            head[1] = rng.choice([0, 1, 4, 5, 6])
        if change == "result":
            head[3] = rng.choice([2, 3, 4, 5, 6, 7, 9, 10, 13])
        if change == "characteristic":
            head[2], head[5] = rng.choice([(1, 1), (4, 6), (5, 9)])
        values = {node: [rng.uniform(-9, 9) for _ in range(head[5])] for node in nodes}
        others.append(vector_dataset(rng, 55, tuple(head), [rng.uniform(1, 9), 0.0, 0.0, 0.0], values, "E"))
    if others and rng.random() < 0.15:
        blocks, case.refused = [], True
    blocks += others
    rng.shuffle(blocks)
    if not blocks:
        return universal(rng)
    for block in blocks:
        lines += block
    case.text = rng.choice(["\n", "\r\n"]).join([*lines, ""])
    case.has_damping = True
    return case


# ---------------------------------------------------------------------------------------------------------- listings and punches


def nastran_modes(rng: random.Random, is_complex: bool) -> tuple[list[int], list[Mode]]:
    nodes = sorted(rng.sample([*range(1, 99), 100101, 12345678], rng.randint(2, 6)))
    measured = {node: sorted(rng.sample(range(6), rng.randint(1, 6))) for node in nodes}
    measured[nodes[0]] = sorted({0, *measured[nodes[0]]})
    return nodes, draw_modes(rng, nodes, measured, is_complex, is_complex)


def fixed(value: float) -> str:
    """A number as Nastran prints it in fifteen columns."""
    if value == 0:
        return "   0.0         "
    text = f"{value:.6E}"
    mantissa, exponent = text.split("E")
    return (text if abs(int(exponent)) < 100 else f"{mantissa}{int(exponent):+04d}").rjust(15)


class Listing:
    """Pages of a listing."""

    def __init__(self, rng: random.Random) -> None:
        self.rng, self.lines, self.number = rng, list[str](), 1
        self.cosmic, self.has_pages, self.rows = rng.random() < 0.3, rng.random() < 0.9, rng.randint(2, 9)
        self.words = rng.choice(["FRAME", "A FATAL FLAW 7", "E I G E N V A L U E S OF SUBCASE 9"])

    def page(self, subcase: int | None) -> None:
        self.number += 1
        if self.has_pages:
            self.lines.append(f"1    {self.words:<70s}MSC.NASTRAN  6/17/05   PAGE{self.number:6d}")
            self.lines.append(self.rng.choice(["", "     SUBTITLE, FATAL IF WRONG"]))
        self.lines.append("0" + ("" if subcase is None else f"{'SUBCASE':>115s} {subcase}{' ' * 14}"))

    def echo(self) -> None:
        self.page(None)
        self.lines += [
            "                         I N P U T   B U L K   D A T A   E C H O",
            "     $ FATAL CRACK AT 12",
            "     GRID,1,,0.,0.,0.",
        ]

    def table(self, modes: list[Mode], subcase: int | None, mass_is_zero: bool = False) -> None:
        self.page(subcase)
        self.lines.append("                                              R E A L   E I G E N V A L U E S")
        self.lines.append(
            "   MODE    EXTRACTION      EIGENVALUE            RADIANS             CYCLES            GENERALIZED         GENERALIZED"
        )
        self.lines.append(
            "    NO.       ORDER                                                                       MASS              STIFFNESS"
        )
        for k, mode in enumerate(modes, 1):
            omega, mass = mode.s.imag, 0.0 if mass_is_zero else mode.mass
            five = (omega**2, omega, omega / (2 * math.pi), mass, mass * omega**2)
            self.lines.append(f"{k:9d}{k:10d}" + "".join(f"{x:20.6E}" for x in five))

    def vectors(
        self,
        modes: list[Mode],
        told: list[dict[int, np.ndarray]],
        subcase: int | None,
        form: str,
        scalars: bool,
        width: int,
    ) -> None:
        """The vectors `told` of modes, page after page; `form` is real, (REAL/IMAGINARY), (MAGNITUDE/PHASE) or buckling."""
        rng = self.rng
        for k, (mode, shape) in enumerate(zip(modes, told, strict=True), 1):
            nodes = list(shape)
            for first in range(0, len(nodes), self.rows):
                self.page(subcase)
                omega = mode.s.imag
                if form in ("real", "buckling"):
                    cycles = f"{omega / (2 * math.pi):13.6E}"
                    title = f"R E A L   E I G E N V E C T O R   N O .{k:11d}"
                    if form == "buckling":
                        self.lines += [f"      EIGENVALUE = {omega**2:13.6E}", f"{'':41s}{title}"]
                    elif self.cosmic:
                        self.lines += [
                            f"      EIGENVALUE = {omega**2:13.6E}    (CYCLIC FREQUENCY = {cycles} HZ)",
                            "",
                            f"{'':41s}{title}",
                        ]
                    else:
                        self.lines += [
                            f"      EIGENVALUE = {omega**2:13.6E}",
                            f"          CYCLES = {cycles}         {title}",
                        ]
                else:
                    self.lines.append(f"      COMPLEX EIGENVALUE = {mode.s.real:13.6E}, {omega:13.6E}")
                    self.lines.append(f"{'':39s}C O M P L E X   E I G E N V E C T O R   NO.{k:11d}")
                    self.lines.append(f"{'':58s}{form}")
                self.lines += [
                    "",
                    "      POINT ID.   TYPE          T1             T2             T3             R1             R2             R3",
                ]
                for node in nodes[first : first + self.rows]:
                    self.row(node, "G", shape[node][:width], form)
                if scalars and first + self.rows >= len(nodes):
                    self.row(max(nodes) + 5, "S", np.array([9.0 + 1j, -8.0])[: rng.randint(1, 2)], form)

    def row(self, node: int, kind: str, values: np.ndarray, form: str) -> None:
        parts = [values.real]
        if form == "(REAL/IMAGINARY)":
            parts = [values.real, values.imag]
        if form == "(MAGNITUDE/PHASE)":
            parts = [np.abs(values), np.degrees(np.angle(values)) % 360]
        for i, part in enumerate(parts):
            head = f"{'0' if len(parts) == 2 and i == 0 else ' '}{node:13d}      {kind}   " if i == 0 else " " * 24
            if i == 1 and form == "(MAGNITUDE/PHASE)":
                text = "".join("   0.0         " if v == 0 else f"{v:13.4f}  " for v in part)
            else:
                text = "".join(fixed(v) for v in part)
            self.lines.append((head + text).ljust(self.rng.choice([0, 132])))

    def forces(self, title: str, nodes: list[int], subcase: int | None, above: str) -> None:
        """A table that looks like a vector and is none."""
        self.page(subcase)
        self.lines += [*([above] if above else []), f"{'':31s}{title}", ""]
        self.lines.append(
            "      POINT ID.   TYPE          T1             T2             T3             R1             R2             R3"
        )
        for node in nodes:
            self.row(node, "G", np.array([self.rng.uniform(-9e3, 9e3) for _ in range(6)]), "real")


_TABLES = (
    "F O R C E S   O F   S I N G L E - P O I N T   C O N S T R A I N T", "L O A D   V E C T O R",
    "D I S P L A C E M E N T   V E C T O R", "F O R C E S   O F   M U L T I - P O I N T   C O N S T R A I N T",
)  # fmt: skip


def displacement_deck(rng: random.Random, nodes: list[int]) -> tuple[str, dict[int, np.ndarray]]:
    """GRID cards with displacement systems, and the axes of the points that have one."""
    lines, axes = ["CEND", "BEGIN BULK"], {}
    own, origin = draw_axes(rng, False), np.array([rng.uniform(-1, 1) for _ in range(3)])
    form = rng.choice("RC")
    three = (origin, origin + own[2], origin + own[0])
    numbers = [f"{x:.12f}" for point in three for x in point]
    lines += [f"CORD2{form},7,0," + ",".join(numbers[:6]), "," + ",".join(numbers[6:])]
    for node in nodes:
        point = np.array([rng.uniform(-3, 3) for _ in range(3)])
        is_turned = rng.random() < 0.6
        lines.append(f"GRID,{node},,{point[0]:.9f},{point[1]:.9f},{point[2]:.9f}" + (",7" if is_turned else ""))
        if is_turned:
            axes[node] = own
            if form == "C":
                local = own @ (point - origin)
                angle = math.atan2(local[1], local[0])
                about = np.array(
                    [[math.cos(angle), math.sin(angle), 0], [-math.sin(angle), math.cos(angle), 0], [0, 0, 1]]
                )
                axes[node] = about @ own
    return "\n".join([*lines, "ENDDATA", ""]), axes


def units(rng: random.Random, case: Case, prints_mass: bool) -> tuple[float, float]:
    """Metres and newtons of the model, and the options that state them or not."""
    name, length = rng.choice([("mm", 1e-3), ("m", 1.0), ("in", 0.0254)])
    force_name, force = rng.choice([("N", 1.0), ("lbf", 4.4482216152605)])
    states_length = rng.random() < 0.5
    states_force = states_length and prints_mass and rng.random() < 0.6
    case.components = 6 if states_length else 3
    case.has_mass = states_force
    case.options = ModeFileOptions(
        length_unit=name if states_length else "", force_unit=force_name if states_force else ""
    )
    return length, force


def with_options(case: Case, **changes: object) -> None:
    own = {
        name: getattr(case.options, name) for name in ("subcase", "eigenvalues", "deck", "length_unit", "force_unit")
    }
    case.options = ModeFileOptions(**(own | changes))  # type: ignore[arg-type]


def in_model_units(mode: Mode, axes: dict[int, np.ndarray], length: float) -> dict[int, np.ndarray]:
    told = {}
    for node, vector in mode.shape.items():
        own = turned(vector, axes[node]) if node in axes else vector
        told[node] = np.concatenate([own[:3] / length, own[3:]])
    return told


def listing(rng: random.Random) -> Case:
    """A listing of Nastran."""
    form = rng.choice(["real", "real", "real", "(REAL/IMAGINARY)", "(MAGNITUDE/PHASE)", "buckling"])
    is_complex = form.startswith("(")
    nodes, modes = nastran_modes(rng, is_complex)
    case = Case("f06 " + form, "", modes, has_damping=is_complex)
    page = Listing(rng)
    length, force = units(rng, case, form == "real")
    axes: dict[int, np.ndarray] = {}
    if rng.random() < 0.4:
        case.deck, axes = displacement_deck(rng, nodes)
    if not case.deck and rng.random() < 0.2:
        page.lines.append("     SOL 103")
    width = 3 if rng.random() < 0.2 and all(not v[3:].any() for m in modes for v in m.shape.values()) else 6
    if width == 3 and axes:
        width = 6
    told = [in_model_units(mode, axes, length) for mode in modes]
    printed = [Mode(m.s, m.shape, m.mass / (force * length)) for m in modes]
    subcase = rng.choice([None, 1, 20])
    if rng.random() < 0.3:
        page.echo()
    others = lambda: [  # noqa: E731
        page.forces(rng.choice(_TABLES), nodes, subcase, rng.choice(["", f"      EIGENVALUE = {4.0e3:13.6E}"]))
        for _ in range(rng.randint(0, 2))
    ]
    others()
    if not is_complex:
        page.table(printed, subcase, mass_is_zero=form == "buckling" and rng.random() < 0.5)
    page.vectors(printed, told, subcase, form, rng.random() < 0.3, width)
    others()
    if subcase is not None and form == "real" and rng.random() < 0.3:  # of another subcase: chosen, or refused
        stiffer = [Mode(1.5 * m.s, m.shape, m.mass) for m in printed]
        page.table(stiffer, subcase + 1)
        page.vectors(stiffer, [{n: -2 * v for n, v in t.items()} for t in told], subcase + 1, form, False, width)
        if page.has_pages and rng.random() < 0.7:
            with_options(case, subcase=subcase)
        else:
            case.refused = True
    if rng.random() < 0.1:
        page.lines.append("0*** USER FATAL MESSAGE 9050 (SEKRRS)")
        case.refused = True
    case.refused |= form == "buckling"
    case.text = "\n".join([*page.lines, "1    * * * END OF JOB * * *", ""])
    return case


def mystran(rng: random.Random) -> Case:
    """A listing of MYSTRAN."""
    nodes, modes = nastran_modes(rng, False)
    case = Case("f06 mystran", "", modes)
    length, force = units(rng, case, True)
    axes: dict[int, np.ndarray] = {}
    is_buckling = rng.random() < 0.15
    if rng.random() < 0.5:
        case.deck, axes = displacement_deck(rng, nodes)
    page = Listing(rng)
    page.has_pages = False
    page.table([Mode(m.s, m.shape, m.mass / (force * length)) for m in modes], None)
    if is_buckling:
        page.lines.insert(2, f"{'':43s}(subcase 1 buckling load factors)")
        case.refused = True
    lines = page.lines
    for k, mode in enumerate(modes, 1):
        lines += ["", "", f" OUTPUT FOR EIGENVECTOR {k:8d}", " BEAM", ""]
        lines += [f"{'':57s}E I G E N V E C T O R", f"{'':46s}(in global coordinate system at each grid)"]
        lines += [
            f"{'':11s}GRID     COORD      T1            T2            T3            R1            R2            R3",
            f"{'':11s}          SYS",
        ]
        for node, own in in_model_units(mode, axes, length).items():
            texts = ["  0.0         " if v == 0 else f"{v:14.6E}" for v in own.real]
            lines.append(f"{'':6s} {node:8d} {7 if node in axes else 0:8d}" + "".join(texts))
        lines += [f"{'':25s}" + "------------- " * 6, f"{'':16s}MAX* :  " + f"{1.0:14.6E}" * 6]
        if rng.random() < 0.4:
            lines += [
                "",
                "",
                f" OUTPUT FOR EIGENVECTOR {k:8d}",
                "",
                f"{'':57s}S P C   F O R C E S",
                lines[-6] if len(lines) > 6 else "",
            ]
            lines += [
                f"{'':11s}GRID     COORD      T1            T2            T3            R1            R2            R3",
                f"{'':11s}          SYS",
            ]
            lines.append(f"{'':6s} {nodes[0]:8d} {0:8d}" + f"{77.0:14.6E}" * 6)
    if axes and rng.random() < 0.3:
        case.deck, case.refused = "", True
    case.text = "\n".join([*lines, ""])
    return case


def punch(rng: random.Random) -> Case:
    """A punch file of Nastran."""
    form = rng.choice(["REAL", "REAL", "REAL-IMAGINARY", "MAGNITUDE-PHASE"])
    is_complex = form != "REAL"
    nodes, modes = nastran_modes(rng, is_complex)
    case = Case("punch " + form, "", modes, has_damping=is_complex)
    length, _ = units(rng, case, False)
    axes: dict[int, np.ndarray] = {}
    if rng.random() < 0.4:
        case.deck, axes = displacement_deck(rng, nodes)
    subcase = rng.choice([1, 20])
    lines: list[str] = []

    def block(name: str, head: str, number: int, values: dict[int, np.ndarray], own: str, kind: str = "G") -> None:
        lines.extend(
            [
                "$TITLE   = FRAME",
                "$SUBTITLE=",
                "$LABEL   =",
                name,
                f"${head} OUTPUT",
                f"$SUBCASE ID = {number:11d}",
                *([own] if own else []),
            ]
        )
        for node, vector in values.items():
            parts = [vector.real]
            if head == "REAL-IMAGINARY":
                parts = [vector.real, vector.imag]
            if head == "MAGNITUDE-PHASE":
                parts = [np.abs(vector), np.degrees(np.angle(vector)) % 360]
            first = True
            for part in parts:
                for at in (0, 3):
                    label = f"{node:10d}       {kind}" if first else "-CONT-            "
                    lines.append(label + "".join(f"{v:18.6E}" for v in part[at : at + 3]))
                    first = False

    def told(factor: float, number: int, shapes: list[Mode]) -> None:
        for k, mode in enumerate(shapes, 1):
            values = {node: factor * own for node, own in in_model_units(mode, axes, length).items()}
            own = f"$EIGENVALUE = {mode.s.imag**2:14.7E}  MODE = {k:5d}"
            if is_complex:
                own = f"$EIGENVALUE = ({mode.s.real:15.7E},{mode.s.imag:15.7E}) MODE = {k:5d}"
            block("$EIGENVECTOR", form, number, values, own)

    def other() -> None:
        if rng.random() < 0.5:
            values = {node: np.array([rng.uniform(-9, 9) for _ in range(6)]) for node in nodes}
            name = rng.choice(["$DISPLACEMENTS", "$SPCF", "$OLOADS", "$ACCELERATION", "$EIGENVECTOR (SOLUTION SET)"])
            block(name, "REAL", subcase, values, rng.choice(["", "$EIGENVALUE =  4.0000000E+03  MODE =     1"]))

    other()
    told(1.0, subcase, modes)
    other()
    if rng.random() < 0.3:
        told(-2.0, subcase + 1, [Mode(1.5 * m.s, m.shape, m.mass) for m in modes])
        if rng.random() < 0.7:
            with_options(case, subcase=subcase)
        else:
            case.refused = True
    is_numbered = rng.random() < 0.7
    case.text = "".join(f"{line:<72}{i:8d}\n" if is_numbered else f"{line}\n" for i, line in enumerate(lines, 1))
    return case


def binary(rng: random.Random) -> Case:
    """Binary results of Nastran."""
    form = rng.choice(["real", "real", "real/imaginary", "magnitude/phase", "buckling", "by points"])
    is_complex = "/" in form
    nodes, modes = nastran_modes(rng, is_complex)
    case = Case("op2 " + form, "", modes, has_damping=is_complex, refused=form in ("buckling", "by points"))
    writer = Writer(rng.choice("<>"), rng.choice((4, 8)), rng.random() < 0.7)
    length, force = units(rng, case, form == "real")
    axes: dict[int, np.ndarray] = {}
    name = rng.choice(["OUGV1", "OUG1", "OPHIG", "BOUGV1", "BOPHIG", "OUGV1PAT"])
    if rng.random() < 0.4:
        case.deck, axes = displacement_deck(rng, nodes)
        case.refused |= name == "OUGV1PAT"
    is_basic = name.startswith("B")
    subcase, scalars = rng.choice([1, 20]), rng.sample(range(100, 200), rng.choice([0, 2]))

    def vectors(number: int, shapes: list[Mode], factor: float, told_axes: dict[int, np.ndarray]) -> list[bytes]:
        parts = []
        for k, mode in enumerate(shapes, 1):
            told = in_model_units(mode, told_axes, length)
            table = np.array([factor * told[node] for node in nodes])
            pair = (
                (np.abs(table), np.degrees(np.angle(table)) % 360)
                if form == "magnitude/phase"
                else (table.real, table.imag)
            )
            first, second = (mode.s.real, mode.s.imag) if is_complex else (mode.s.imag**2, 0.0)
            approach = 9 if is_complex else 8 if form == "buckling" else 2
            kind = (1000 if is_complex else 0) + (2000 if form == "by points" else 0) + 7
            code = 3 if form == "magnitude/phase" else 2 if is_complex else 1
            parts += [
                writer.heading(approach, kind, number, k, float(first), float(second), code, 14 if is_complex else 8),
                writer.vector(nodes, np.concatenate(pair, axis=1) if is_complex else table.real, scalars, is_complex),
            ]
        return parts

    tables = [(name, vectors(subcase, modes, 1.0, {} if is_basic else axes))]
    if is_basic and rng.random() < 0.5:  # the same along the axes of the points, which are passed over
        tables.insert(0, ("OUGV1", vectors(subcase, modes, -3.0, axes)))
    if rng.random() < 0.2:
        tables.append((name, vectors(subcase + 1, [Mode(1.5 * m.s, m.shape, m.mass) for m in modes], -2.0, axes)))
        if rng.random() < 0.7:
            with_options(case, subcase=subcase)
        else:
            case.refused = True
    masses = b"".join(
        writer.words(k, k, float(m.s.imag**2), float(m.s.imag), 1.0, m.mass / (force * length), 1.0)
        for k, m in enumerate(modes, 1)
    )
    tables.insert(0, ("LAMA", [writer.heading(2, 6, rng.choice([0, subcase]), 0, 0, 0, 0, 7), masses]))
    forces = writer.vector(nodes, np.full((len(nodes), 6), 77.0))
    tables.insert(rng.randint(0, len(tables)), ("OQG1", [writer.heading(2, 3, subcase, 1, 4e3, 0.0, 1, 8), forces]))
    for table_name, parts in tables:
        if rng.random() < 0.2:
            writer.matrix()
        writer.table(table_name, parts, rng.choice([1, 1, 3]))
    case.content = writer.end()
    return case


# ------------------------------------------------------------------------------------------------------------------- what came out

MAKERS = {"uff": universal, "f06": listing, "mystran": mystran, "pch": punch, "op2": binary}
_SUFFIXES = {"uff": (".uff", ".unv"), "f06": (".f06",), "mystran": (".f06",), "pch": (".pch", ".pun"), "op2": (".op2",)}


def faults(case: Case, record: ModalRecord) -> str:
    """What of the record is not the truth; "" where all is."""
    modes = sorted(case.modes, key=lambda mode: abs(mode.s))
    if record.n_modes != len(modes):
        return f"{record.n_modes} modes of {len(modes)}"
    if record.scaling != ("mass" if case.has_mass else "unit_largest"):
        return f"scaling {record.scaling}"
    expected: dict[tuple[int, int], np.ndarray] = {}
    for node in modes[0].shape:
        for k in range(case.components):
            entries = np.array([mode.shape[node][k] for mode in modes])
            if np.abs(entries).max() > 1e-12:
                expected[node, k] = entries
    got = {(dof.node, dof.axis): row for dof, row in zip(record.channels, record.mode_shapes, strict=True)}
    size = max(float(np.abs(row).max()) for row in expected.values())
    extra = [
        key
        for key in got.keys() - expected.keys()
        if np.abs(got[key]).max() > _TOLERANCE * np.abs(record.mode_shapes).max()
    ]
    if extra or expected.keys() - got.keys():
        return f"channels {sorted(got)} instead of {sorted(expected)}"
    assert size > 0
    for k, mode in enumerate(modes):
        if abs(record.frequency[k] * 2 * math.pi / abs(mode.s) - 1) > 2e-5:
            return f"mode {k + 1} at {record.frequency[k]} Hz instead of {abs(mode.s) / 2 / math.pi}"
        ratio = mode.ratio
        if case.has_damping:
            shown = 0.0 if np.isnan(record.damping_ratio[k]) else record.damping_ratio[k]
            if abs(shown - ratio) > 1e-3 * abs(ratio) + 1e-9:
                return f"damping ratio {shown} instead of {ratio}"
        reference = np.array([expected[key][k] for key in expected])
        own = np.array([got[key][k] for key in expected])
        if case.has_mass:
            reference = reference / math.sqrt(mode.mass)
        factor = complex(np.vdot(reference, own) / np.vdot(reference, reference))
        if np.abs(own - factor * reference).max() > _TOLERANCE * np.abs(own).max():
            return f"shape {own} instead of {reference}"
        if case.has_mass and abs(abs(factor) - 1) > _TOLERANCE:
            return f"mass scale {abs(factor)} times too large"
        if not case.has_mass and abs(np.abs(record.mode_shapes[:, k]).max() - 1) > 1e-9:
            return "largest entry is not 1"
    return ""


def judged(rng: random.Random, folder: Path, kind: str) -> tuple[str, str, str]:
    """Draws a file, has it read, and says what came of it: right, refused, wrong, false refusal; with words and name."""
    case = MAKERS[kind](rng)
    path = folder / f"modes{rng.choice(_SUFFIXES[kind])}"
    path.write_bytes(case.content or case.text.encode("ascii"))
    if case.deck:
        (folder / "deck.bdf").write_text(case.deck)
        with_options(case, deck=folder / "deck.bdf")
    try:
        record = read_modes(path, case.options)
    except InputError as error:
        return ("refused" if case.refused else "false refusal"), str(error), case.name
    if case.refused:
        return "wrong", f"read, though it must be refused: {record!r}", case.name
    words = faults(case, record)
    return ("wrong" if words else "right"), words, case.name


def run(seed: str, count: int, folder: Path) -> tuple[Counter[tuple[str, str]], list[str]]:
    """Outcomes of `count` files, and what must not be."""
    counts: Counter[tuple[str, str]] = Counter()
    bad = []
    for index in range(count):
        kind = list(MAKERS)[index % len(MAKERS)]
        outcome, words, name = judged(random.Random(f"{seed} {index}"), folder, kind)
        counts[name, outcome] += 1
        if outcome in ("wrong", "false refusal"):
            bad.append(f"{outcome}, {name}, index {index}: {words}")
    return counts, bad


def main() -> int:
    """Draw, read, print, and say by the exit code whether anything was read wrongly."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=5000, help="how many files [default: 5000]")
    parser.add_argument(
        "--seed", default=str(secrets.randbits(32)), help="of the random numbers [default: a fresh one]"
    )
    given = parser.parse_args()
    print(f"seed {given.seed}")
    with tempfile.TemporaryDirectory() as folder:
        counts, bad = run(given.seed, given.count, Path(folder))
    for (name, outcome), n in sorted(counts.items()):
        print(f"{name:30s}{outcome:15s}{n:7d}")
    print("\n".join(bad[:40]))
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
