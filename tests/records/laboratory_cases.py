"""Tables under names of laboratories, in several languages, with known truth: twins of those of `header_cases`.

Units stand in brackets of all sorts, without brackets, in a line of their own, in two places, in an option, or nowhere; times
are rounded, shifted by an epoch, uneven or incomplete; numbers may have thousands apart; columns may hold levels or densities.
"""

import random

import numpy as np
from header_cases import FORCES, FREQUENCIES, GRAVITY, MOTIONS, TIMES, Case
from header_cases import WRITERS as HEADER_WRITERS

NAMES = (
    "Acc {}",
    "Beschleunigung {}",
    "Accélération {}",
    "Sensor-{}",
    "AI{}",
    "Kanal {}",
    "Voie {}",
    "ch{:02d}",
    "B{} top",
)
CLOCKS = ("Time", "Zeit", "Temps", "Tiempo", "t", "Tempo")
AXES = ("Frequency", "Frequenz", "Fréquence", "Freq", "Frecuencia")
BRACKETS = ("[{}]", "({})", "{{{}}}", "<{}>")
LEVELS = (
    "g rms",
    "m/s² RMS",
    "grms",
    "dB",
    "dB re 1 g",
    "g²/Hz",
    "(m/s^2)^2/Hz",
    "g/√Hz",
    "mm p-p",
    "mm/s pk",
    "g PSD",
)
FRF_LEVELS = ("{} dB", "{} (dB)", "LogMag {}", "20log10 {}", "{} PSD", "CSD {}")
PARTS = {
    "re,im": (("Real", "Imag"), ("Re", "Im"), ("Realteil", "Imaginärteil"), ("Partie réelle", "Partie imaginaire"),
              ("H1.re", "H1.im")),
    "magnitude,phase": (("Mag", "Phase"), ("Magnitude", "Phase"), ("Betrag", "Winkel"), ("Amplitude", "Phase"), ("Module", "Phase"),
                        ("Modulus", "Angle")),
}  # fmt: skip
STEPS = (0.5, 0.25, 0.0078125, 0.002)


def laboratory_case(seed):
    rng = random.Random(seed)
    case = Case(suffix=rng.choice((".csv", ".txt", ".tsv")), is_frf=rng.random() < 0.4, digits=1e-6)
    case.is_grouped = False
    case.quantity = rng.choice(("acceleration",) * 3 + ("velocity", "displacement"))
    noise = np.random.default_rng(rng.randrange(2**32))
    axis = _frequencies(case, rng) if case.is_frf else _times(case, rng)
    columns = _responses(case, rng, noise) if case.is_frf else _histories(case, rng, noise)
    below = [axis[1], *(column[1] for column in columns)]
    names = [axis[0], *(column[0] for column in columns)]
    cells = [axis[2], *(column[2] for column in columns)]
    if not case.is_frf and rng.random() < 0.1:
        names, below = [rng.choice(("No", "Index", "Sample", "#")), *names], ["", *below]
        cells = [[str(i) for i in range(len(cells[0]))], *cells]
        case.options |= {"columns": ",".join(str(j) for j in range(3, 3 + len(columns)))}
    is_plain = not case.is_grouped and not any("," in cell for column in cells for cell in column)
    separator = rng.choice(",;\t" if is_plain else ";\t")
    lines = [names, *([below] if any(below) else []), *zip(*cells, strict=True)]
    if any(below) and not all(below[1:]):
        case.may_be_refused = True  # a line that is half of units is one that the user may have to name
    texts = [separator.join(f'"{cell}"' if separator in cell else cell for cell in line) for line in lines]
    case.content = ("\n".join(texts) + "\n").encode("utf-8")
    return case


def _numbers(case, rng, values):
    """Cells with a point or a comma, in one form for the whole table, drawn once."""
    if not hasattr(case, "comma"):
        case.comma = rng.random() < 0.35
    return [f"{x:.9e}".replace(".", "," if case.comma else ".") for x in values]


def _axis_head(case, rng, words, units, quiet):
    """Name, text below, and the factor of the numbers; `quiet` is the unit that nothing says."""
    word, unit = rng.choice(words), rng.choice(list(units))
    way = rng.choice(("bracket",) * 4 + ("row", "row", "both", "contradiction", "bare", "option", "nothing"))
    case.notes.append(f"axis {word!r} {unit!r} {way}")
    bracket = rng.choice(BRACKETS[:2])
    if way == "bracket":
        return f"{word} {bracket.format(unit)}", "", units[unit]
    if way == "bare":
        short = rng.choice([u for u in units if u.isalpha()])
        case.may_be_refused = True
        return word + rng.choice((" / ", " in ", "_", " ")) + short, "", units[short]
    if way == "row":
        return word, rng.choice(("{}", bracket)).format(unit), units[unit]
    if way in ("both", "contradiction"):
        other = rng.choice([u for u, f in units.items() if (abs(f / units[unit] - 1) < 1e-9) == (way == "both")])
        if way == "contradiction":
            case.refuse(f"axis in {unit} and {other}")
        return f"{word} {bracket.format(unit)}", rng.choice(("{}", bracket)).format(other), units[unit]
    if way == "option":
        case.options["axis_unit"] = unit
        return word, "", units[unit]
    case.refuse("an axis without unit")
    return word, "", units[quiet]


def _times(case, rng):
    count, step = 24, rng.choice(STEPS)
    name, below, factor = _axis_head(case, rng, CLOCKS, TIMES, "s")
    case.axis = rng.choice((0.0, 0.0, 1.0)) + step * np.arange(count)
    case.comma = rng.random() < 0.35
    way = rng.choice(("plain",) * 6 + ("epoch", "rounded", "jitter", "missing", "doubled", "falling", "clock", "date"))
    case.notes.append(f"times {way}")
    shown = case.axis / factor
    if way in ("clock", "date"):
        case.axis = case.axis - case.axis[0]
        case.options.pop("axis_unit", None)
        case.is_open = False
        stamps = [f"12:{int(t // 60):02d}:{t % 60:09.6f}" for t in case.axis]
        if way == "date":
            stamps = [f"2024-03-01T{stamp}" for stamp in stamps]
        case.may_be_refused = True
        return rng.choice(CLOCKS[:4]), "", stamps
    if way == "epoch":
        if factor != 1 or step < 0.002:
            return name, below, _numbers(case, rng, shown)
        case.axis = case.axis + 1.7e9
        case.may_be_refused = True
        return name, below, [f"{t:.7f}".replace(".", "," if case.comma else ".") for t in case.axis]
    if way == "rounded":
        case.may_be_refused = True
        case.axis_error = 1e-3
        return name, below, [f"{t:.4g}".replace(".", "," if case.comma else ".") for t in shown]
    if way == "jitter":
        shown = shown + 0.02 * (shown[1] - shown[0]) * np.sin(np.arange(count))
        case.refuse("an uneven clock")
    elif way == "missing":
        shown = np.delete(np.append(shown, 2 * shown[-1] - shown[-2]), 9)
        case.refuse("a line is missing")
    elif way == "doubled":
        shown[7] = shown[6]
        case.refuse("a time twice")
    elif way == "falling":
        shown = shown[::-1]
        case.refuse("times that fall")
    return name, below, _numbers(case, rng, shown)


def _frequencies(case, rng):
    count = 24
    name, below, factor = _axis_head(case, rng, AXES, FREQUENCIES, "Hz")
    case.axis = 4.0 + 0.5 * np.arange(count)
    shown = case.axis / factor
    way = rng.choice(("plain",) * 8 + ("falling", "doubled"))
    if way == "falling":
        shown = shown[::-1]
        case.refuse("frequencies that fall")
    elif way == "doubled":
        shown[7] = shown[6]
        case.refuse("a frequency twice")
    return name, below, _numbers(case, rng, shown)


def _unit_places(case, rng, name, label, others, option):
    """Header and text below of a column in the unit `label`, by a way drawn once for a case; `others` are units that differ."""
    if not hasattr(case, "way"):
        case.way = rng.choice(
            ("bracket",) * 4
            + ("row",) * 3
            + ("both", "both other", "inner", "bare", "option", "option other", "nothing")
        )
        case.bracket = rng.choice(BRACKETS)
        case.notes.append(f"units {label!r} {case.way} {case.bracket}")
        case.other = rng.choice(others)
        if case.way in ("option", "inner", "bare") or (case.way in ("bracket", "row") and rng.random() < 0.2):
            case.options[option] = label
        if case.way == "option other":
            case.options[option] = case.other
            case.refuse("an option against the header")
        if case.way == "both other":
            case.refuse("a header against the line below it")
        if case.way == "nothing":
            case.refuse("no unit")
        if case.bracket in BRACKETS[2:] and case.is_frf:
            case.may_be_refused = True
    boxed = case.bracket.format(label)
    if case.way == "bracket":
        return f"{name} {boxed}", ""
    if case.way == "option other":
        return rng.choice((f"{name} {boxed}", f"[{label}] {name}")), ""
    if case.way == "row":
        return name, rng.choice((label, boxed)) if case.bracket in BRACKETS[:2] else label
    if case.way in ("both", "both other"):
        return f"{name} {boxed}", label if case.way == "both" else case.other
    if case.way == "inner":
        return f"{boxed} {name}", ""
    if case.way == "bare":
        return f"{name}{rng.choice((' / ', ' in ', '_', ' '))}{label}", ""
    return name, ""


def _histories(case, rng, noise):
    units = {u: f for u, f in MOTIONS[case.quantity].items() if "," not in u}
    label = rng.choice(list(units))
    others = [u for u, f in units.items() if abs(f / units[label] - 1) > 1e-9]
    level = rng.random() < 0.12
    columns, channels = [], []
    case.is_grouped, digits = rng.random() < 0.08, rng.choice((0, 1))
    marks = str.maketrans(",.", rng.choice((".,", " ,") if case.comma else (",.", " .", "'.")))
    case.may_be_refused = case.may_be_refused or case.is_grouped
    pattern = rng.choice(NAMES)
    for k in range(rng.choice((1, 2, 3))):
        axis, sign = rng.randrange(3), rng.choice((1, 1, -1))
        values = noise.normal(size=len(case.axis))
        name, below = _unit_places(case, rng, pattern.format(k + 1), label, others, "units")
        if level:
            shown = rng.choice(LEVELS)
            name, below = rng.choice((("{} [{}]", ""), ("{}", "{}"), ("{} {}", "")))
            name, below = name.format(pattern.format(k + 1), shown), below.format(shown)
            case.options["units"] = label
        channels.append(f"{k + 1}{'XYZ'[axis]}{'-' if sign < 0 else ''}")
        cells = _numbers(case, rng, values / units[label])
        if case.is_grouped:  # whole numbers, or with a decimal, of thousands that are set apart
            written = np.round(3e4 * values, digits)
            values = written * units[label]
            cells = [f"{x:,.{digits}f}".translate(marks) for x in written]
        case.truth[k + 1, axis] = sign * values
        columns.append((name, below, cells))
    case.options["channels"] = ",".join(channels)
    if level:
        case.refuse("levels")
    return columns


def _responses(case, rng, noise):
    label, force = rng.choice([u for u in MOTIONS[case.quantity] if " " not in u]), rng.choice(("N", "kN", "lbf"))
    whole, factor = f"({label})/{force}", MOTIONS[case.quantity][label] / FORCES[force]
    si = {"mm/N": 1e-3, "g/N": GRAVITY, "(m/s^2)/N": 1.0, "(mm/s)/kN": 1e-6}
    others = [unit for unit, value in si.items() if abs(value / factor - 1) > 1e-9]
    parts = rng.choice(list(PARTS))
    words = rng.choice(PARTS[parts])
    layout = {"parts": parts}
    swapped = rng.random() < 0.08
    level = rng.random() < 0.1
    degrees = rng.random() < 0.7
    says_phase = rng.choice(("header", "header", "option", "nothing", "contradiction"))
    columns, outputs = [], []
    for k in range(rng.choice((1, 2))):
        values = noise.normal(size=len(case.axis)) + 1j * noise.normal(size=len(case.axis))
        written = values / factor
        if parts == "re,im":
            numbers = (written.real, written.imag)
        else:
            numbers = (np.abs(written), np.degrees(np.angle(written)) if degrees else np.angle(written))
        outputs.append(f"{k + 1}Z")
        case.truth[(k + 1, 2), (3, 0)] = values
        pair = [(part, shown, cells) for part, shown, cells in zip(parts.split(","), words, numbers, strict=True)]
        for part, shown, cells in pair[::-1] if swapped else pair:
            below = ""
            if part == "phase":
                unit = rng.choice(("deg", "°") if degrees else ("rad",))
                name = f"{shown} [{unit}]" if says_phase in ("header", "contradiction") else shown
            else:
                name, below = _unit_places(case, rng, shown, whole, others, "unit")
                if level:
                    name, below = rng.choice(FRF_LEVELS).format(shown), ""
                    case.options["unit"] = whole
            columns.append((name, below, _numbers(case, rng, cells)))
    if parts != "re,im" and says_phase != "header":
        if says_phase == "option":
            layout["phase_unit"] = "deg" if degrees else "rad"
        elif says_phase == "contradiction":
            layout["phase_unit"] = "rad" if degrees else "deg"
            case.refuse("an option against the unit of phases")
        elif degrees:
            case.may_be_refused = True
        else:
            case.refuse("phases without a unit")
    if swapped:
        case.refuse("parts in another order than the headers say")
    if level:
        case.refuse("levels")
    case.notes.append(f"{words} {layout}")
    case.options |= {"csv": layout, "outputs": ",".join(outputs), "inputs": "3X"}
    return columns


WRITERS = {**HEADER_WRITERS, "laboratory": laboratory_case}
