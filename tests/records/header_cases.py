"""Record files written byte by byte over the variations that their headers allow, with the truth that they state.

Nothing here comes from structid or a library of the format: what is written follows the descriptions of datasets 15, 18, 58, 58b,
164, 2411 and 2420, and what people head tables with. A case is drawn from a seed. Its truth is in SI and along global axes; a case
that leaves something open, or contradicts itself, must not be read.
"""

import random
import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

GRAVITY, POUND = 9.80665, 0.45359237 * 9.80665
DISPLACEMENTS = {
    "m": 1,
    "mm": 1e-3,
    "um": 1e-6,
    "µm": 1e-6,
    "in": 0.0254,
    "mil": 25.4e-6,
    "mils": 25.4e-6,
    "inch": 0.0254,
    "MM": 1e-3,
}
VELOCITIES = {"m/s": 1, "mm/s": 1e-3, "in/s": 0.0254, "in/sec": 0.0254, "M/S": 1, "m s-1": 1, "ips": 0.0254}
ACCELERATIONS = {
    "m/s^2": 1, "m/s2": 1, "m/s/s": 1, "m/s**2": 1, "M/S2": 1, "m/sec^2": 1, "mm/s^2": 1e-3, "in/s^2": 0.0254, "in/sec^2": 0.0254,
    "g": GRAVITY, "G": GRAVITY, "gn": GRAVITY, "g's": GRAVITY, "gal": 0.01, "ft/s^2": 0.3048, "mg": GRAVITY * 1e-3,
}  # fmt: skip
MOTIONS = {"displacement": DISPLACEMENTS, "velocity": VELOCITIES, "acceleration": ACCELERATIONS}
FORCES = {"N": 1, "kN": 1e3, "KN": 1e3, "lbf": POUND, "LB": POUND, "lbs": POUND, "Lbf": POUND, "kgf": GRAVITY, "kip": 1e3 * POUND,
          "Newton": 1, "mN": 1e-3}  # fmt: skip
UNKNOWN = ("EU", "V", "mV", "Pa", "dB", "kg", "counts", "%", "g rms", "??", "uE", "A")
FREQUENCIES = {
    "Hz": 1,
    "HZ": 1,
    "hertz": 1,
    "kHz": 1e3,
    "rad/s": 1 / (2 * np.pi),
    "rad/sec": 1 / (2 * np.pi),
    "rpm": 1 / 60,
    "RPM": 1 / 60,
}
TIMES = {"s": 1, "sec": 1, "Seconds": 1, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "min": 60}
TYPES = {"displacement": 8, "velocity": 11, "acceleration": 12, "force": 13}
KINDS = {"displacement": "receptance", "velocity": "mobility", "acceleration": "accelerance"}


@dataclass
class Case:
    """A file and its truth.

    Attributes
    ----------
    content : bytes
    suffix : str
    options : dict
        Of `ReadOptions`.
    axis : (n,) array
        Hz or s.
    truth : dict
        Values (n,) in SI by output (node, axis 0 to 2), or by output and load of FRFs, along global axes and positive senses.
    quantity : str
    is_open : bool
        Whether the file says too little, or contradicts itself: to be refused.
    may_be_refused : bool
        Whether a reader may ask for more, though the file and the options say all.
    digits : float
        Relative size of the last digit of its numbers.
    axis_error : float
        Error of the axis that its digits explain, as a part of its largest value.
    notes : list of str
        What was drawn.
    """

    content: bytes = b""
    suffix: str = ".unv"
    options: dict = field(default_factory=dict)
    axis: np.ndarray = field(default_factory=lambda: np.zeros(0))
    truth: dict = field(default_factory=dict)
    quantity: str = "acceleration"
    is_frf: bool = True
    is_open: bool = False
    may_be_refused: bool = False
    digits: float = 1e-5
    axis_error: float = 5e-5
    notes: list = field(default_factory=list)

    def refuse(self, why: str) -> None:
        self.is_open = True
        self.notes.append(f"OPEN: {why}")


def judge(case: Case, path: Path, read, refusal: type[Exception]) -> tuple[str, str]:
    """What came of a case: ``read``, ``refused``, ``wrong`` or ``lost`` (refused though it says all), and in which words."""
    path.write_bytes(case.content)
    try:
        record = read(path, case.options)
    except refusal as error:
        return ("refused" if case.is_open or case.may_be_refused else "lost"), str(error)
    if case.is_open:
        return "wrong", "was read"
    words = _differences(case, record)
    return ("wrong", words) if words else ("read", "")


def _differences(case: Case, record) -> str:
    axis = record.frequency if case.is_frf else record.time
    size = np.abs(case.axis).max()
    if axis.shape != case.axis.shape or np.abs(axis - case.axis).max() > case.axis_error * size:
        return f"axis {axis[:3]}..., truth {case.axis[:3]}..."
    if case.is_frf:
        if record.kind != KINDS[case.quantity]:
            return f"kind {record.kind}"
        found = {
            ((o.node, o.axis), (i.node, i.axis)): o.sign * i.sign * record.values[:, a, b]
            for a, o in enumerate(record.outputs)
            for b, i in enumerate(record.inputs)
        }
    else:
        if set(record.quantities) != {case.quantity}:
            return f"quantities {record.quantities}"
        found = {(c.node, c.axis): c.sign * record.values[:, j] for j, c in enumerate(record.channels)}
    if set(found) != set(case.truth):
        return f"has {sorted(found)}, truth {sorted(case.truth)}"
    scale = max(np.abs(values).max() for values in case.truth.values())
    for name, values in case.truth.items():
        if np.abs(found[name] - values).max() > 30 * case.digits * scale:
            ratio = np.abs(found[name]).max() / np.abs(values).max()
            return f"{name} differs: {ratio:.6g} times the truth"
    return ""


# universal files


def dataset(number, *lines):
    return ("\n".join(["    -1", f"{number:6d}", *lines, "    -1", ""])).encode("latin-1")


def fortran(value, width, digits, letter="E"):
    """A number as Fortran writes it in so many columns."""
    text = f"{value:.{digits}E}"
    mantissa, power = text.split("E")
    exponent = f"{letter}{int(power):+03d}" if abs(int(power)) < 100 else f"{int(power):+04d}"
    return (mantissa + exponent).rjust(width)


def units_dataset(code, length, force):
    """Dataset 164: factors by which the file's numbers are divided to be SI."""
    return dataset(164, f"{code:10d}{'units':20s}{1:10d}", "".join(fortran(x, 25, 16, "D") for x in (length, force, 1.0)),
                   fortran(273.15, 25, 16, "D"))  # fmt: skip


def rotation(rng, is_right):
    """Axes as rows in global axes: of quarter turns, or any."""
    if is_right:
        order = rng.sample(range(3), 3)
        rows = np.zeros((3, 3))
        for i, j in enumerate(order):
            rows[i, j] = rng.choice((1.0, -1.0))
        if np.linalg.det(rows) < 0:
            rows[2] *= -1
        return rows
    q, _ = np.linalg.qr(np.array([[rng.gauss(0, 1) for _ in range(3)] for _ in range(3)]))
    return q * np.sign(np.linalg.det(q))


def universal_case(seed):
    rng = random.Random(seed)
    case = Case(suffix=rng.choice((".unv", ".uff", ".ufb")))
    case.is_frf = rng.random() < 0.65
    case.quantity = rng.choice(("acceleration",) * 3 + ("velocity", "displacement"))
    nodes = rng.sample((1, 2, 7, 60101, 123456, 99999999), rng.choice((1, 2)))
    axes = _node_axes(case, rng, nodes)
    count = rng.choice((5, 9, 12))
    case.axis, axis_numbers, axis_head, even = _axis(case, rng, count)
    outputs = _channels(case, rng, nodes, axes)
    loads = [(nodes[0], rng.choice((1, 2, 3)) * rng.choice((1, -1)))] if case.is_frf else [(0, 0)]
    if case.is_frf and not _is_along_global(axes.get(nodes[0]), abs(loads[0][1]) - 1):
        case.refuse("a load along no global axis")
    noise = np.random.default_rng(rng.randrange(2**32))
    motion, force = _units(case, rng)
    signal = _signals(case, noise, nodes, count)
    functions = []
    for output in outputs:
        for load in loads:
            functions.append((output, load, _seen(case, signal, axes, output, load) / motion.factor * force.factor))
    if rng.random() < 0.05:
        functions.append(functions[0])
        case.refuse("a pair twice")
    form = _form(case, rng)
    kind, values_of = _function_type(case, rng)
    blocks = [*motion.blocks, *case.blocks]
    rng.shuffle(blocks)
    for output, load, values in functions:
        blocks.append(
            _function(case, form, kind, output, load, values_of(values), axis_numbers, axis_head, even, motion, force)
        )
    if case.is_frf and rng.random() < 0.3:
        ones = np.full(count, 0.5)
        sides = [_Unit("", 1.0, [], 0), _Unit("", 1.0, [], 0)]
        coherences = [
            _function(case, form | {"complex": False}, 6, o, i, ones, axis_numbers, axis_head, even, *sides)
            for o, i, _ in functions
        ]
        blocks = [*coherences, *blocks] if rng.random() < 0.5 else [*blocks, *coherences]
    case.content = (dataset(151, *["NONE"] * 7) if rng.random() < 0.5 else b"") + b"".join(blocks)
    case.truth = _truth(case, signal, axes, outputs, loads)
    return case


@dataclass
class _Unit:
    label: str
    factor: float
    blocks: list
    number: int


def _node_axes(case, rng, nodes):
    """Coordinate systems of the motion of each node, and the datasets that state them."""
    case.blocks = []
    choice = rng.choice(
        ("none", "none", "global", "right", "right", "right 18", "skew", "skew 18", "cylinder", "undefined")
    )
    case.notes.append(f"axes {choice}")
    if choice == "none":
        return {}
    number = rng.choice((15, 2411, 2411))
    label = 0 if choice == "global" else rng.choice((2, 5, 31))
    points = {node: [rng.uniform(-3, 3) for _ in range(3)] for node in nodes}
    origin = [rng.uniform(-1, 1) for _ in range(3)]
    rows = np.eye(3)
    if choice in ("right", "right 18", "skew", "skew 18"):
        rows = rotation(rng, choice.startswith("right"))
    for node in nodes:
        integers = "".join(f"{n:10d}" for n in (node, rng.choice((0, 1)), label, 11))
        if number == 15:
            case.blocks.append(dataset(15, integers + "".join(fortran(x, 13, 5) for x in points[node])))
        else:
            case.blocks.append(dataset(2411, integers, "".join(fortran(x, 25, 16, "D") for x in points[node])))
    if choice == "undefined":
        case.refuse("a coordinate system that is not defined")
        return {}
    if choice in ("right 18", "skew 18"):
        corners = [origin, list(origin + 2 * rows[0]), list(origin + rows[2] + 0.5 * rows[0])]
        numbers = [fortran(x, 13, 5) for corner in corners for x in corner]
        head = "".join(f"{n:10d}" for n in (label, 0, 0, 8, 1))
        case.blocks.append(dataset(18, head, "CS", "".join(numbers[:6]), "".join(numbers[6:])))
    elif choice != "global":
        kind = 1 if choice == "cylinder" else 0
        lines = ["".join(fortran(x, 25, 16, "D") for x in row) for row in (*rows, origin)]
        case.blocks.append(dataset(2420, f"{1:10d}", "part", f"{label:10d}{kind:10d}{8:10d}", "CS", *lines))
    if choice == "cylinder":
        axes = {}
        for node, point in points.items():
            x, y, _ = np.subtract(point, origin)
            c, s = x / np.hypot(x, y), y / np.hypot(x, y)
            axes[node] = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        return axes
    return dict.fromkeys(nodes, rows) if choice != "global" else {}


def _is_along_global(rows, axis):
    return rows is None or np.abs(rows[axis]).max() > 1 - 1e-9


def _skewed(rows, directions):
    return [d for d in directions if not _is_along_global(rows, abs(d) - 1)]


def _spanned(rows, directions):
    """Global axes that have a part of sensors along none of them."""
    return {j for d in _skewed(rows, directions) for j in range(3) if abs(rows[abs(d) - 1][j]) > 1e-9}


def _channels(case, rng, nodes, axes):
    """Sensors as (node, signed direction); one along no global axis needs the other two of its node."""
    channels = []
    for node in nodes:
        three = rng.random() < 0.5
        directions = (1, 2, 3) if three else rng.sample((1, 2, 3), rng.choice((1, 2)))
        if len(_spanned(axes.get(node), directions)) not in (0, len(_skewed(axes.get(node), directions))):
            case.refuse("a sensor along no global axis")
        channels += [(node, d * rng.choice((1, 1, -1))) for d in directions]
    if rng.random() < 0.04:
        channels[0] = (channels[0][0], 0)
        case.refuse("direction 0")
    return channels


def _axis(case, rng, count):
    """Truth, numbers in the file, (type, axis label, unit label), and whether they are even."""
    even = rng.random() < 0.6
    units = FREQUENCIES if case.is_frf else TIMES
    if case.is_frf:
        axis = rng.choice((1.0, 2.0, 20.0)) + rng.choice((0.5, 1.0, 3.0)) * np.arange(count)
        if not even and rng.random() < 0.5:
            axis = axis + 0.1 * np.sin(np.arange(count))
    else:
        axis = rng.choice((0.0, 0.5)) + rng.choice((0.25, 0.002, 0.0078125)) * np.arange(count)
        if not even and rng.random() < 0.2:
            axis = axis + 0.1 * (axis[1] - axis[0]) * np.sin(np.arange(count))
            case.refuse("an uneven clock")
    label = rng.choice(list(units))
    own = 18 if case.is_frf else 17
    number = 19 if label.lower() == "rpm" and rng.random() < 0.5 else rng.choice((own, own, own, 0, 1))
    numbers, shown = axis / units[label], label
    fault = rng.random()
    if fault < 0.08:
        shown = "NONE"
        if rng.random() < 0.5:
            case.options["axis_unit"] = label
        elif number == own:
            numbers = axis  # Hz and s, as the format has them
        elif number != 19:  # whose unit is rpm
            case.refuse("an axis without a unit")
    elif fault < 0.12:
        shown = rng.choice(("samples", "1/s", "m/s", "Ohm", "order"))
        case.refuse("an axis in no unit of its kind")
    elif fault < 0.15:
        number = 20
        case.refuse("orders")
    elif fault < 0.17:
        number, shown = (17, "s") if case.is_frf else (18, "Hz")
        case.refuse("an axis of another kind")
    case.notes.append(f"axis {number} {shown!r}, true unit {label!r}")
    return axis, numbers, (number, rng.choice(("Frequency" if case.is_frf else "Time", "NONE", "")), shown), even


def _units(case, rng):
    """Units of motion and force, and how the file says them."""
    motions = MOTIONS[case.quantity]
    label, below = rng.choice(list(motions)), rng.choice(list(FORCES)) if case.is_frf else ""
    factor, force = motions[label], FORCES.get(below, 1.0)
    number, under = TYPES[case.quantity], 13 if case.is_frf else 0
    mode = rng.choice(
        ("labels",) * 5
        + ("164",) * 3
        + ("both", "contradiction", "nothing", "unknown", "option", "general", "whole", "half")
    )
    case.notes.append(f"units {label!r} per {below!r}, {mode}")
    blocks = []
    code, length, newton = rng.choice(
        ((1, 1.0, 1.0), (2, 0.3048, POUND), (7, 0.0254, POUND), (10, 1e-3, 1.0), (9, 1e-2, 1e3), (5, 1e-3, 1e-3))
    )
    option = f"({label})/({below})" if case.is_frf else label
    name = "unit" if case.is_frf else "units"
    if mode in ("164", "both", "contradiction"):
        blocks.append(units_dataset(code, 1 / length, 1 / newton))
    if mode == "164":
        label, below, factor, force = "NONE", rng.choice(("NONE", "")), length, newton if case.is_frf else 1.0
    elif mode == "both":
        same = [u for u, f in motions.items() if abs(f / length - 1) < 1e-9]
        under_same = [u for u, f in FORCES.items() if abs(f / newton - 1) < 1e-9] if case.is_frf else [""]
        if not same or not under_same:
            case.refuse("labels beside another dataset 164")
        else:
            label, below, factor, force = (
                rng.choice(same),
                rng.choice(under_same),
                length,
                newton if case.is_frf else 1.0,
            )
    elif mode == "contradiction":
        if abs(factor / length - 1) > 1e-3 or (case.is_frf and abs(force / newton - 1) > 1e-3):
            case.refuse("labels against dataset 164")
        if rng.random() < 0.3 and code != 9:
            blocks = [units_dataset(code, 1 / length * 2, 1 / newton)]
            case.refuse("a code against its factors")
    elif mode == "nothing":
        label = below = "NONE"
        case.refuse("no units at all")
    elif mode == "unknown":
        label = rng.choice(UNKNOWN)
        case.refuse("an unknown unit")
    elif mode == "half" and case.is_frf:
        label, below = rng.choice(((label, "NONE"), ("NONE", below), (label, "EU"), (label, "V")))
        case.refuse("one side without a unit")
    elif mode == "option":
        case.options[name] = option
        label, below = rng.choice((("NONE", "NONE"), ("EU", "EU"), ("V", "V"), (label, below)))
    elif mode == "whole" and case.is_frf:
        label, below = option, rng.choice(("NONE", below))
        if len(label) > 20:
            case.refuse("a label that is cut off")
    if mode == "general":
        number, under = rng.choice((0, 1)), rng.choice((0, 1)) if case.is_frf else 0
    elif rng.random() < 0.06 and mode != "option":
        number = rng.choice((2, 3, 9, 15))
        case.refuse("another type of data")
    elif rng.random() < 0.05 and mode == "labels":
        number = rng.choice([n for quantity, n in TYPES.items() if quantity != case.quantity])
        case.refuse("a type that is not of its unit")
    return _Unit(label, factor, blocks, number), _Unit(below, force, [], under)


def _signals(case, noise, nodes, count):
    """Global motion of each node, (n, 3), or per force at the first node, (n, 3, 3)."""
    shape = (count, 3, 3) if case.is_frf else (count, 3)
    values = {}
    for node in nodes:
        values[node] = noise.normal(size=shape) + (1j * noise.normal(size=shape) if case.is_frf else 0)
    return values


def _seen(case, signal, axes, output, load):
    """What a sensor shows, in its direction and sense."""
    node, direction = output
    rows = axes.get(node, np.eye(3))
    way = np.sign(direction or 1) * rows[abs(direction or 1) - 1]
    seen = np.einsum("i,ni...->n...", way, signal[node])
    if not case.is_frf:
        return seen
    force = np.sign(load[1]) * axes.get(load[0], np.eye(3))[abs(load[1]) - 1]
    return seen @ force


def _truth(case, signal, axes, outputs, loads):
    """What must come out, by global channels."""
    if case.is_open:
        return {}
    places = {}
    for node, direction in outputs:
        rows = axes.get(node)
        if rows is None or _is_along_global(rows, abs(direction) - 1):
            axis = abs(direction) - 1 if rows is None else int(np.argmax(np.abs(rows[abs(direction) - 1])))
            places[node, axis] = signal[node][:, axis]
        else:
            own = [d for n, d in outputs if n == node]
            places |= {(node, axis): signal[node][:, axis] for axis in _spanned(rows, own)}
    if not case.is_frf:
        return places
    ((node, direction),) = loads
    rows = axes.get(node)
    below = abs(direction) - 1 if rows is None else int(np.argmax(np.abs(rows[abs(direction) - 1])))
    return {(place, (node, below)): values[:, below] for place, values in places.items()}


def _form(case, rng):
    form = {"binary": rng.random() < 0.4, "double": rng.random() < 0.5, "complex": case.is_frf, "order": rng.choice("<>"),
            "letter": rng.choice("EEDe"), "filled": rng.random() < 0.3, "newline": rng.choice((b"\n", b"\n", b"\r\n")),
            "float": 2, "short_axis": rng.random() < 0.5, "scale": 1.0}  # fmt: skip
    if form["binary"] and rng.random() < 0.06:
        form["float"] = rng.choice((1, 3))
        case.refuse("numbers of a VAX or a mainframe")
    if form["binary"] and rng.random() < 0.03:
        form["order"] = "="
        case.refuse("no byte order")
    case.digits = 1e-5 if not form["double"] else 1e-5 if not form["binary"] else 1e-7
    case.notes.append(f"form {form}")
    return form


def _function_type(case, rng):
    """Function type, and what becomes of the values."""
    if not case.is_frf:
        return (1, lambda values: values)
    draw = rng.random()
    if draw < 0.05:
        case.refuse("a magnitude")
        case.magnitude = True
        return 4, lambda values: np.abs(values)
    if draw < 0.08:
        case.refuse("spectra")
        return rng.choice((2, 3, 9, 12)), lambda values: values
    if draw < 0.1:
        case.refuse("a transmissibility per force")
        return 5, lambda values: values
    return 4, lambda values: values


def _function(case, form, kind, output, load, values, axis, head, even, motion, force):
    """One dataset 58 or 58b."""
    is_complex = np.iscomplexobj(values)
    ordinate = (6 if form["double"] else 5) if is_complex else (4 if form["double"] else 2)
    step = axis[1] - axis[0]
    lines = ["structid twin", "NONE", "01-Jan-24 00:00:00", "NONE", "NONE"]
    names = ("NONE", "NONE")
    lines.append(
        f"{kind:5d}{1:10d}{0:5d}{0:10d} {names[0]:10s}{output[0]:10d}{output[1]:4d} {names[1]:10s}{load[0]:10d}{load[1]:4d}"
    )
    numbers = (axis[0], step, 0.0) if even else (0.0, 0.0, 0.0)
    lines.append(f"{ordinate:10d}{len(axis):10d}{int(even):10d}" + "".join(fortran(x, 13, 5) for x in numbers))
    for number, text, label in (
        head,
        (motion.number, "Response", motion.label),
        (force.number, "Force", force.label),
        (0, "NONE", "NONE"),
    ):
        lines.append(f"{number:10d}{0:5d}{0:5d}{0:5d} {text:20.20s} {label:20.20s}")
    columns = [values.real, values.imag] if is_complex else [values]
    table = np.column_stack(columns if even else [axis, *columns])
    newline = form["newline"]
    if form["binary"]:
        item = "d" if form["double"] else "f"
        first = "" if even else "f" if form["short_axis"] and form["double"] else item
        order = ">" if form["order"] == "=" else form["order"]
        body = b"".join(struct.pack(order + first + item * len(columns), *row) for row in table.tolist())
        flag = {"<": 1, ">": 2, "=": 0}[form["order"]]
        top = f"{58:6d}b{flag:6d}{form['float']:6d}{11:12d}{len(body):12d}{0:6d}{0:6d}{0:12d}{0:12d}"
        text = newline.join(line.encode("latin-1") for line in ["    -1", top, *lines, ""])
        return text + body + newline + b"    -1" + newline
    wide = [(13, 5)] if not even else []
    wide += [(20, 12) if form["double"] else (13, 5)] * len(columns)
    fields = [fortran(x, *wide[i % len(wide)], form["letter"]) for i, x in enumerate(table.ravel())]
    per_line = {True: {False: 4, True: 4}, False: {False: 6, True: 6}}[form["double"]][even]
    if not even and form["double"]:
        per_line = 3 if is_complex else 4
    if form["filled"]:
        while len(fields) % per_line:
            fields.append(fortran(0.0, *wide[len(fields) % len(wide)], form["letter"]))
    rows = ["".join(fields[i : i + per_line]) for i in range(0, len(fields), per_line)]
    return newline.join(line.encode("latin-1") for line in ["    -1", f"{58:6d}", *lines, *rows, "    -1", ""])


# tables

TIME_HEADS = {
    "Time [s]": 1, "time_s": 1, "Time (ms)": 1e-3, "Time ms": 1e-3, "time_ms": 1e-3, "t_us": 1e-6, "millis": 1e-3, "t [ms]": 1e-3,
    "Time, sec": 1, "Zeit [s]": 1, "Elapsed min": 60, "seconds": 1, "Time [min]": 60, "micros": 1e-6, "timestamp_ms": 1e-3,
    "T [s]": 1,
}  # fmt: skip
FREQUENCY_HEADS = {
    "Frequency [Hz]": 1, "frequency_hz": 1, "f [kHz]": 1e3, "omega [rad/s]": 1 / (2 * np.pi), "Frequency (rpm)": 1 / 60,
    "Freq. (Hz)": 1, "Frequenz [Hz]": 1, "Frequency, kHz": 1e3, "freq_khz": 1e3, "Frequency Hz": 1,
    "Frequency [rad/sec]": 1 / (2 * np.pi),
}  # fmt: skip
OPEN_TIMES = ("Time", "t", "timestamp", "Time [h*]", "Time [Hz]", "Zeit")
OPEN_FREQUENCIES = ("Frequency", "Frequency [orders]", "freq", "Frequency [1/s]", "Frequenz")


def table_case(seed):
    rng = random.Random(seed)
    case = Case(suffix=rng.choice((".csv", ".txt")), is_frf=rng.random() < 0.5, digits=1e-6)
    case.quantity = rng.choice(("acceleration",) * 3 + ("velocity", "displacement"))
    heads, opens, units = (
        (FREQUENCY_HEADS, OPEN_FREQUENCIES, FREQUENCIES) if case.is_frf else (TIME_HEADS, OPEN_TIMES, TIMES)
    )
    head = rng.choice(list(heads))
    factor, below = heads[head], ""
    if rng.random() < 0.15:
        head, known = rng.choice(opens), rng.choice(list(units))
        factor = units[known]
        if rng.random() < 0.5 and "[" not in head:
            case.options["axis_unit"] = known
        else:
            case.refuse(f"an axis headed {head}")
    elif rng.random() < 0.2:
        head, below = (
            rng.choice(("Frequency", "Frequenz") if case.is_frf else ("Time", "Zeit")),
            rng.choice(list(units)),
        )
        factor = units[below]
    count = 12
    step = rng.choice((0.5, 2.0)) if case.is_frf else rng.choice((0.25, 0.005, 0.002))
    case.axis = (step if case.is_frf else 0.0) + step * np.arange(count)
    noise = np.random.default_rng(rng.randrange(2**32))
    columns = [case.axis / factor]
    names, unders = [head], [below]
    label = rng.choice([u for u in MOTIONS[case.quantity] if "," not in u])
    motion, force, load = (
        MOTIONS[case.quantity][label],
        rng.choice(("N", "kN", "lbf", "kgf")),
        (3, 2, rng.choice((1, -1))),
    )
    whole, scale = (f"({label})/{force}", motion / FORCES[force]) if case.is_frf else (label, motion)
    unknown = rng.random() < 0.12
    shown = rng.choice(UNKNOWN) if unknown else whole
    if unknown and rng.random() < 0.4:
        case.options["unit" if case.is_frf else "units"] = whole
        if shown in ("dB", "g rms") and not case.is_frf:
            case.refuse("levels")
        shown, case.may_be_refused = "" if case.is_frf else shown, bool(below)  # units below names that are none
    elif unknown:
        case.refuse(f"channels in {shown}")
    case.notes.append(f"{head!r} {below!r}, {shown!r} for {whole!r}")
    parts = rng.choice(("re im", "re im", "complex", "mag deg", "mag rad", "mag", "mag phase")) if case.is_frf else ""
    for node, axis, sign in ((1, 2, rng.choice((1, -1))), (2, 0, 1)):
        values = noise.normal(size=count) + (1j * noise.normal(size=count) if case.is_frf else 0)
        name = f"{node}{'XYZ'[axis]}" + ("-" if sign < 0 else rng.choice(("", "+")))
        bracket = "" if below or not shown else f" [{shown}]"
        written = values / scale
        if case.is_frf:
            pair = f"{name}/{load[0]}{'XYZ'[load[1]]}{'-' if load[2] < 0 else ''}"
            case.truth[(node, axis), load[:2]] = sign * load[2] * values
            angle = np.angle(written)
            made = {
                "re im": [(" re", written.real, 0), (" im", written.imag, 0)], "complex": [("", written, 0)],
                "mag deg": [(" magnitude", np.abs(written), 0), (" phase", np.degrees(angle), "deg")],
                "mag rad": [(" magnitude", np.abs(written), 0), (" phase", angle, "rad")],
                "mag": [(" magnitude", np.abs(written), 0)],
                "mag phase": [(" magnitude", np.abs(written), 0), (" phase", angle, "")],
            }[parts]  # fmt: skip
            for text, numbers, unit in made:
                if unit == 0:
                    names.append(f"{pair}{bracket}{text}")
                    unders.append(shown if below else "")
                else:
                    names.append(f"{pair}{text}" + (f" [{unit}]" if unit and not below else ""))
                    unders.append(unit if below else "")
                columns.append(numbers)
        else:
            names.append(name + bracket)
            unders.append(shown if below else "")
            case.truth[node, axis] = sign * values
            columns.append(written)
    if parts in ("mag", "mag phase"):
        case.refuse(f"FRFs as {parts}")
    separator = rng.choice((",", ";", "\t"))
    comma = separator != "," and rng.random() < 0.4
    lines = [separator.join(names)]
    if below:
        lines.append(separator.join(unders))
    if any(separator in name for name in (*names, *unders)):
        lines = [
            separator.join(f'"{name}"' if separator in name else name for name in row)
            for row in (names, unders)[: len(lines)]
        ]
    for row in zip(*columns, strict=True):
        cells = [f"{x.real:.9e}{x.imag:+.9e}i" if isinstance(x, complex) else f"{x:.9e}" for x in row]
        lines.append(separator.join(cell.replace(".", ",") if comma else cell for cell in cells))
    case.content = ("\n".join(lines) + "\n").encode("utf-8")
    return case


WRITERS = {"universal": universal_case, "table": table_case}
