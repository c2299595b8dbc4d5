"""What each kind of change is in a study file: the tables that are added, the keys that are another."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from structid.core.dof import DIRECTIONS, Dof, parse_dof
from structid.core.errors import InputError
from structid.core.json_types import Plain
from structid.criticism.between import following
from structid.criticism.candidate import Candidate
from structid.study.schema.kinds import as_list
from structid.study.schema.model.structure import dofs_of_text
from structid.study.schema.section import Tables

#: A study file as nested tables, plain ones or those of an editor of TOML that keeps comments.

#: Tables that hold places together: no elements.
_TIES = ("rigid_link", "constraint")
_DIGITS = 6
#: Logarithm of a gain that a linear look may ask for, at most.
_LARGEST_LOG = 20.0
#: Angle, rad, within which a sensor that is turned stands at right angles.
_SQUARE = 0.03


class NoEditError(InputError):
    """The change cannot be written in this study."""


def edit(study: Tables, candidate: Candidate, strength: float) -> None:
    """Make the change of `candidate` in the tables of a study.

    Raises
    ------
    NoEditError
        If the study is written in a way that has no place for it.
    """
    _EDITS[candidate.kind](study, candidate, strength)


def _named(study: Tables, words: str) -> str:
    """`words`, with a number behind where a name of an element set or tie is taken."""
    taken = {entry.get("name") for _, entry in _entries(study)}
    return next(name for name in (words, *(f"{words} {k}" for k in range(2, 1000))) if name not in taken)


def _entries(study: Tables) -> Iterator[tuple[str, Tables]]:
    """The type and the table of every element set and tie."""
    for kind, entries in study["structure"].items():
        for entry in entries if isinstance(entries, list) else ():
            if isinstance(entry, dict):
                yield kind, entry


def _append(table: Tables, key: str, entry: Tables) -> None:
    if key in table:
        table[key].append(entry)
    else:
        table[key] = [entry]


def _unknown(study: Tables, prop: str, elements: str | Sequence[str], **more: Plain) -> None:
    _append(study, "unknown", {"property": prop, "elements": elements, **more})


def _of_either_sign(study: Tables, prop: str, name: str, strength: float) -> None:
    more = {} if strength > 0 else {"positive": False, "start": _round(strength)}
    _unknown(study, prop, name, **more)


def _round(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


def _spring(study: Tables, candidate: Candidate, strength: float) -> None:
    name, [at] = _named(study, f"spring {candidate.where[0]}"), candidate.where
    _sprung(study, "spring", {"name": name, "first": at, "stiffness": _round(strength)}, candidate)


def _sprung(study: Tables, kind: str, entry: Tables, candidate: Candidate) -> None:
    """A spring or joint of unknown stiffness, with damping of its own where the candidate has some."""
    _append(study["structure"], kind, {**entry, **candidate.detail})
    for prop in ("stiffness", *candidate.detail):
        _unknown(study, prop, entry["name"])


def _support(study: Tables, candidate: Candidate, strength: float) -> None:
    first, *others = candidate.where
    ends = {"first": [first, *others] if others else first, **_driving_end(study, candidate, parse_dof(first))}
    for text in candidate.where:
        freed = [_freed(place, parse_dof(text)) for place in _holding(study)]
        if not any(freed):
            raise NoEditError(f"{text} is held by a group of a mesh; hold it by `fixed` to let it give way")
    name = _named(study, f"support {first}")
    _sprung(study, "spring", {"name": name, **ends, "stiffness": _round(1 / strength)}, candidate)


def _driving_end(study: Tables, candidate: Candidate, dof: Dof) -> dict[str, str]:
    """The other end of a spring at a support that drives: a new node in its place, with its channel; none of other supports."""
    for base in study["structure"].get("base", []):
        driving = [one for text in as_list(base["supports"]) for one in dofs_of_text(str(text))]
        if all(one.unsigned != dof for one in driving):
            continue
        label = _new_node(study, dof.node)
        there = {one: f"{label if one.unsigned == dof else one.node}{one.direction}" for one in driving}
        base["supports"] = [text if one.sign > 0 else f"{text}-" for one, text in there.items()]
        end = f"{label}{dof.direction}"
        for place in _holding(study):
            place["fixed"] = [*as_list(place.get("fixed", [])), end]
        for number in candidate.driven:
            _rename(_records(study)[number], {candidate.where[0]: end})
        return {"second": end}
    return {}


def _holding(study: Tables) -> list[Tables]:
    """The tables with a ``fixed`` of their own."""
    return [study["structure"], *(r["structure"] for r in _records(study) if "fixed" in r.get("structure", {}))]


def _new_node(study: Tables, beside: int) -> int:
    """The label of a new node where another is."""
    nodes = study["structure"].get("nodes")
    if nodes is None or str(beside) not in nodes:
        raise NoEditError(f"a new node beside node {beside} needs [structure.nodes], where that is listed")
    label = max(int(key) for key in nodes) + 1
    nodes[str(label)] = list(as_list(nodes[str(beside)]))
    return label


def _freed(place: Tables, dof: Dof) -> bool:
    """Takes one direction out of ``fixed``; whether it was there."""
    kept: list[str] = []
    found = False
    for text in as_list(place.get("fixed", [])):
        held = dofs_of_text(text)
        rest = [one.direction for one in held if one.unsigned != dof]
        if len(rest) == len(held):
            kept.append(str(text))
            continue
        found = True
        kept += [f"{dof.node} {' '.join(rest)}" if len(rest) > 1 else f"{dof.node}{rest[0]}"] if rest else []
    if found:
        place["fixed"] = kept
    return found


def _dashpot(study: Tables, candidate: Candidate, strength: float) -> None:
    name = _named(study, f"dashpot {' '.join(candidate.where)}")
    places = dict(zip(("first", "second"), candidate.where, strict=False))
    _append(study["structure"], "dashpot", {"name": name, **places, "viscous_damping": _round(strength)})
    _unknown(study, "viscous_damping", name)


def _friction(study: Tables, candidate: Candidate, strength: float) -> None:
    at = candidate.where[0]
    name = _named(study, f"friction {at}")
    _append(study["structure"], "friction", {"name": name, "first": at, "friction_force": _round(strength)})
    _unknown(study, "friction_force", name)


def _mass(study: Tables, candidate: Candidate, strength: float) -> None:
    """A mass of the structure, or of one record."""
    where = study if candidate.record is None else _record(study, candidate)
    name = _named(study, f"mass {' '.join(candidate.where)}")
    entry = {"name": name, "nodes": [int(candidate.where[0])], "mass": _round(abs(strength))}
    _append(where.setdefault("structure", {}), "point_mass", entry)
    _of_either_sign(study, "mass", name, strength)


def _sensor_mass(study: Tables, candidate: Candidate, strength: float) -> None:
    """One mass at each sensor: of the structure, or of each record where the sensors are not the same."""
    name, of_record = _named(study, "mass of each sensor"), candidate.others
    places = [study] if len(set(of_record)) == 1 else _records(study)
    for place, nodes in zip(places, of_record, strict=False):
        if nodes:
            entry = {"name": name, "nodes": [int(node) for node in nodes.split()], "mass": _round(abs(strength))}
            _append(place.setdefault("structure", {}), "point_mass", entry)
    _of_either_sign(study, "mass", name, strength)


def _inertia(study: Tables, candidate: Candidate, strength: float) -> None:
    dof, name = parse_dof(candidate.where[0]), _named(study, f"inertia {candidate.where[0]}")
    entry = {"name": name, "nodes": [dof.node], "direction": dof.direction, "rotary_inertia": _round(abs(strength))}
    _append(study["structure"], "rotary_inertia", entry)
    _of_either_sign(study, "rotary_inertia", name, strength)


def _offset(study: Tables, candidate: Candidate, strength: float) -> None:
    """A mass at a new node that a rigid link holds to the one where it was."""
    (element, direction), structure = candidate.where, study["structure"]
    name, _, number = element.rpartition(":")
    entry = _entry(study, name)[1]
    if "nodes" not in entry:
        raise NoEditError(f"{element} is at no node that the study lists")
    nodes = list(as_list(entry["nodes"]))
    main = int(nodes[int(number) - 1])
    nodes[int(number) - 1] = label = _new_node(study, main)
    structure["nodes"][str(label)][DIRECTIONS.index(direction)] += _round(strength)
    entry["nodes"] = nodes
    entry.setdefault("directions", list(candidate.others))
    link = {"name": _named(study, f"offset {element}"), "main": main, "dependents": [label]}
    _append(structure, "rigid_link", link)


def _appendage(study: Tables, candidate: Candidate, strength: float) -> None:
    structure, dof = study["structure"], parse_dof(candidate.where[0])
    label = _new_node(study, dof.node)
    at, end = candidate.where[0], f"{label}{dof.direction}"
    mass, spring = (_named(study, f"{words} {at}") for words in ("appendage", "appendage spring"))
    inertia = "rotary_inertia" if dof.is_rotation else "mass"
    kind, along = ("rotary_inertia", "direction") if dof.is_rotation else ("point_mass", "directions")
    direction = dof.direction if dof.is_rotation else [dof.direction]
    _append(structure, kind, {"name": mass, "nodes": [label], inertia: _round(strength), along: direction})
    stiffness = strength * (2 * np.pi * candidate.detail["frequency"]) ** 2
    _append(structure, "spring", {
        "name": spring, "first": at, "second": end, "stiffness": _round(stiffness), "loss_factor": 0.03,
    })  # fmt: skip
    _unknown(study, inertia, mass)
    _unknown(study, "stiffness", spring)
    _unknown(study, "loss_factor", spring)


def _joint(study: Tables, candidate: Candidate, strength: float) -> None:
    element, at = candidate.where
    name = _named(study, f"joint {element} {at}")
    entry = {"name": name, "element": element, "at": at, "stiffness": _round(1 / strength)}
    _sprung(study, "joint", entry, candidate)


def _untied(study: Tables, candidate: Candidate, strength: float) -> None:
    """An element with a parameter of its own, a factor on what it has."""
    (prop,), where = candidate.others, candidate.where[0]
    name, _, number = where.rpartition(":")
    entries = [entry for entry in study["unknown"] if _is_of(entry, name, prop)]
    if any(entry.get("each") or entry.get("field") for entry in entries):
        raise NoEditError(f"{where} has a parameter of its own already")
    for entry in entries:
        _without(study, entry, name, int(number))
    _unknown(study, prop, where, factor=True, start=_round(1 + strength))


def _untied_set(study: Tables, candidate: Candidate, strength: float) -> None:
    """A whole set with a parameter of its own, a factor on what it has."""
    (prop,), (name,) = candidate.others, candidate.where
    entries = [entry for entry in study["unknown"] if _is_of(entry, name, prop)]
    for entry in entries:
        texts = [str(text) for text in as_list(entry["elements"])]
        kept = [text for text in texts if text != name]
        if entry.get("each") or entry.get("field") or len(kept) in (0, len(texts)):
            raise NoEditError(f"{name} is no whole set of a group with one value")
        _shrink(study, entry, texts, kept)
    _unknown(study, prop, name, factor=True, start=_round(1 + strength))


def _shrink(study: Tables, entry: Tables, texts: Sequence[str], kept: Sequence[str]) -> None:
    """Leaves an unknown some of its elements, its name and its sense: that of unequal elements is a factor."""
    if (
        "factor" not in entry
        and len({str(value) for text in texts for value in _values(study, text, entry["property"])}) > 1
    ):
        entry["factor"] = True
    entry["elements"] = list(kept)
    entry.setdefault("name", ", ".join(texts))


def _values(study: Tables, text: str, prop: str) -> list[Plain]:
    """The values of a property that the study has for elements, as ``deck`` or ``deck:2-4``."""
    own = [
        entry[prop]
        for _, entry in _entries(study)
        if entry.get("name") in (text, text.rpartition(":")[0]) and prop in entry
    ]
    return [value for values in own for value in as_list(values)]


def _is_of(entry: Tables, name: str, prop: str) -> bool:
    """Whether an unknown is this property of elements of a set; ``stiffness`` stands for that of springs and others."""
    is_property = entry["property"] in (prop, "stiffness") if "stiffness" in prop else entry["property"] == prop
    return is_property and any(text == name or text.rpartition(":")[0] == name for text in as_list(entry["elements"]))


def _without(study: Tables, entry: Tables, name: str, number: int) -> None:
    """Takes an element out of the elements of an unknown, which keeps its name."""
    texts = [str(text) for text in as_list(entry["elements"])]
    kept: list[str] = []
    for text in texts:
        own, _, span = text.rpartition(":")
        if text == name:
            kept += _spans(name, [k for k in range(1, _count(study, name) + 1) if k != number])
        elif own == name:
            low, _, high = span.partition("-")
            kept += _spans(name, [k for k in range(int(low), int(high or low) + 1) if k != number])
        else:
            kept.append(text)
    _shrink(study, entry, texts, kept)


def _spans(name: str, numbers: Sequence[int]) -> list[str]:
    """``set:2-4`` for each run of numbers."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return [f"{name}:{run[0]}" if len(run) == 1 else f"{name}:{run[0]}-{run[-1]}" for run in runs]


def _count(study: Tables, name: str) -> int:
    for _, entry in _entries(study):
        given = next((entry[key] for key in ("nodes", "first") if key in entry), None)
        if entry.get("name") == name and given is not None:
            return len(as_list(given))
    raise NoEditError(f"elements of {name} are not listed in the study, so that none can be named alone")


def _records(study: Tables) -> list[Tables]:
    given = study["record"]
    return list(given) if isinstance(given, list) else [given]


def _record(study: Tables, candidate: Candidate) -> Tables:
    return _records(study)[candidate.record or 0]


def _channel_error(side: str, prop: str) -> Callable[[Tables, Candidate, float], None]:
    def make(study: Tables, candidate: Candidate, strength: float) -> None:
        record = _record(study, candidate)
        if "modes" in record and (side, prop) != ("outputs", "gain"):
            raise NoEditError("of errors of channels, modes show the gains of sensors only")
        if record.get("time", {}).get("fit", "spectra") != "spectra":
            raise NoEditError("errors of channels are parameters of histories only where they are fitted as spectra")
        start = np.exp(np.clip(strength, -_LARGEST_LOG, _LARGEST_LOG)) if prop == "gain" else strength
        start = start if side == "outputs" else (1 / start if prop == "gain" else -start)
        _append(record, "channel_error", {"property": prop, side: list(candidate.where), "start": _round(float(start))})

    return make


def _relabel(study: Tables, candidate: Candidate, strength: float) -> None:
    """Channels by other names: turned round, elsewhere, or exchanged."""
    record, names = _record(study, candidate), candidate.where
    of = "load " if candidate.kind.startswith("load") else ""
    if candidate.kind.endswith("polarity"):
        changes = {of + names[0]: f"{names[0]}-"}
    elif candidate.kind.endswith("place"):
        changes = {of + names[0]: names[1]}
    else:
        changes = {of + names[0]: names[1], of + names[1]: names[0]}
    _rename(record, changes)


def _rename(record: Tables, changes: dict[str, str]) -> None:
    """Channels by other names, those that `relabel` gave them already among them."""
    given = record.setdefault("relabel", {})
    called = {(key.partition(" ")[0] if " " in key else "", parse_dof(name).place): key for key, name in given.items()}
    for old, new in changes.items():
        *side, place = old.split()
        key = called.get(("".join(side), place))
        if key is None:
            given[old] = new
            continue
        one, other = parse_dof(new), parse_dof(given[key])
        given[key] = one.place if one.sign == other.sign else f"{one.place}-"


def _left_out(study: Tables, candidate: Candidate, strength: float) -> None:
    """A channel that is not used."""
    _record(study, candidate)["channels_used"] = list(candidate.others)


def _excluded(study: Tables, candidate: Candidate, strength: float) -> None:
    """Lines that are not used."""
    method = study.setdefault("method", {})
    spans = [[float(text) for text in where.removesuffix(" Hz").split(" to ")] for where in candidate.where]
    method["exclude"] = [*[list(span) for span in method.get("exclude", [])], *spans]


def _tones(study: Tables, candidate: Candidate, strength: float) -> None:
    time = _record(study, candidate)["time"]
    time["tones"] = [*as_list(time.get("tones", [])), *(float(where.removesuffix(" Hz")) for where in candidate.where)]


def _without_record(study: Tables, candidate: Candidate, strength: float) -> None:
    if not isinstance(study["record"], list) or len(study["record"]) < 2:
        raise NoEditError("the only record cannot be left out")
    del study["record"][candidate.record or 0]


def _mesh(study: Tables, candidate: Candidate, strength: float) -> None:
    study["structure"]["subdivide"] = round(strength) * int(study["structure"].get("subdivide", 1))


def _entry(study: Tables, name: str) -> tuple[str, Tables]:
    """The type and the table of an element set; a tie may have the same name."""
    for kind, entry in _entries(study):
        if entry.get("name") == name and kind not in _TIES:
            return kind, entry
    raise NoEditError(f"{name} is no table of the study")


def _shear(study: Tables, candidate: Candidate, strength: float) -> None:
    (shear,) = candidate.others
    for name in candidate.where:
        _, entry = _entry(study, name)
        entry[shear] = _round(strength)
    names = list(candidate.where)
    _unknown(study, shear, names if len(names) > 1 else names[0])


def _damping_law(study: Tables, candidate: Candidate, strength: float) -> None:
    *names, law = candidate.where
    if law == "loss factor":
        for name in names:
            _entry(study, name)[1]["loss_factor"] = _round(strength)
            _unknown(study, "loss_factor", name)
        return
    kinds = {name: _entry(study, name)[0] for name in names}
    springs = [name for name, kind in kinds.items() if kind == "spring"]
    for name in springs:
        _dashpots(study, name, strength)
    others = [name for name in names if name not in springs]
    share = strength / 2 if others else strength
    weights = {"stiffness_damping": share, "mass_damping": share * (2 * np.pi * candidate.detail["frequency"]) ** 2}
    for prop, weight in weights.items():
        damped = [name for name in others if _viscous(_entry(study, name)[1], prop, weight)]
        if damped:
            _unknown(study, prop, damped if len(damped) > 1 else damped[0], factor=True)


def _viscous(entry: Tables, prop: str, weight: float) -> bool:
    """Gives a set damping in proportion to its stiffness or mass; whether it has any."""
    keys = ("mass", "density") if prop == "mass_damping" else ("bending_stiffness", "axial_stiffness", "youngs_modulus")
    nominal = [float(value) for value in as_list(next((entry[key] for key in keys if key in entry), 0.0))]
    damping = [_round(weight * value) for value in nominal]
    if any(damping):
        entry[prop] = damping if len(damping) > 1 else damping[0]
    return any(damping)


def _dashpots(study: Tables, name: str, strength: float) -> None:
    _, entry = _entry(study, name)
    beside = _named(study, f"dashpots {name}")
    damping = [_round(strength * k) for k in as_list(entry["stiffness"])]
    ends = {key: entry[key] for key in ("first", "second") if key in entry}
    _append(study["structure"], "dashpot", {
        "name": beside, **ends, "viscous_damping": damping if len(damping) > 1 else damping[0],
    })  # fmt: skip
    _unknown(study, "viscous_damping", beside)


def _held(study: Tables, candidate: Candidate, strength: float) -> None:
    """What the study holds, of one set, or of several by one factor."""
    prop = candidate.where[0].partition("[")[0]
    names = [text.rstrip("]").partition("[")[2] for text in candidate.where]
    if len(names) == 1:
        _unknown(study, prop, names[0])
    else:
        _unknown(study, prop, names, factor=True)


def _varies(study: Tables, candidate: Candidate, strength: float) -> None:
    """A parameter with a value of its own in each record; its scatter is chosen by the data."""
    name = candidate.where[0]
    for entry in study["unknown"]:
        label = entry.get("name") or ", ".join(str(text) for text in as_list(entry["elements"]))
        if f"{entry['property']}[{label}]" == name and not entry.get("each"):
            entry["varies"] = True
            return
    raise NoEditError(f"{name} is one of several parameters of an [[unknown]]; declare it alone to let it vary")


def _of_responses(study: Tables, why_not: str) -> list[Tables]:
    """The records, all of frequency responses."""
    records = _records(study)
    if any("time" in record or "modes" in record for record in records):
        raise NoEditError(why_not)
    return records


def _window(study: Tables, candidate: Candidate, strength: float) -> None:
    for record in _of_responses(study, "a window's decay is a parameter of frequency responses only"):
        _append(record, "channel_error", {"property": "window_decay", "start": _round(strength)})


def _leakage(study: Tables, candidate: Candidate, strength: float) -> None:
    for record in _of_responses(study, "only averaged frequency responses read what leaks between lines"):
        record["leakage"] = "hann"


def _other_modes(study: Tables, candidate: Candidate, strength: float) -> None:
    _record(study, candidate).setdefault("modes", {})["use"] = [int(text) for text in candidate.others]


def _aimed(study: Tables, candidate: Candidate, angle: float) -> None:
    """A sensor that is turned by `angle`, rad, from the first direction of the candidate towards the second."""
    record, names = _record(study, candidate), candidate.where
    if abs(abs(angle) - np.pi / 2) < _SQUARE:
        _rename(record, {names[0]: names[1] if angle > 0 else f"{names[1]}-"})
        return
    if names[0] in record.get("sensors", {}):
        raise NoEditError(f"the direction of {names[0]} is given in the study already")
    vector = [0.0, 0.0, 0.0]
    for name, part in zip(names, (np.cos(angle), np.sin(angle)), strict=False):
        dof = parse_dof(name)
        vector[dof.axis] = dof.sign * _round(float(part))
    record.setdefault("sensors", {})[names[0]] = {"direction": vector}


def _load_aimed(study: Tables, candidate: Candidate, angle: float) -> None:
    """A load that is turned likewise acts on a node of its own, whose direction is the sum of both."""
    names = candidate.where
    dof = parse_dof(names[0])
    label = _new_node(study, dof.node)
    parts = [[name, _round(float(part))] for name, part in zip(names, (np.cos(angle), np.sin(angle)), strict=True)]
    acts = f"{label}{dof.direction}"
    entry = {"name": _named(study, f"drive {names[0]}"), "dependent": acts, "depends_on": parts}
    _append(study["structure"], "constraint", entry)
    for place in _holding(study):
        held = [f"{label}{direction}" for direction in candidate.others if direction != dof.direction]
        place["fixed"] = [*as_list(place.get("fixed", [])), *held]
    _rename(_record(study, candidate), {f"load {names[0]}": acts})


def _between(study: Tables, candidate: Candidate, part: float) -> None:
    """A sensor or load at a new node between two others, which follows them as the beam or bar between them does."""
    first, second = (parse_dof(name) for name in candidate.where)
    label, nodes = _new_node(study, first.node), study["structure"]["nodes"]
    ends = [np.array([float(x) for x in as_list(nodes[str(dof.node)])]) for dof in (first, second)]
    nodes[str(label)] = [_round(x) for x in (ends[0] + part * (ends[1] - ends[0])).tolist()]
    acts, follows = f"{label}{first.direction}", following(ends, first.axis, part, bool(candidate.detail["bends"]))
    pairs = [
        [f"{dof.node}{direction}", _round(weight)]
        for dof, own in zip((first, second), follows.tolist(), strict=True)
        for direction, weight in zip(DIRECTIONS, own, strict=True)
        if direction in candidate.others and _round(weight)
    ]
    entry = {"name": _named(study, f"between {' '.join(candidate.where)}"), "dependent": acts, "depends_on": pairs}
    _append(study["structure"], "constraint", entry)
    for place in _holding(study):
        held = [f"{label}{direction}" for direction in candidate.others if direction != first.direction]
        place["fixed"] = [*as_list(place.get("fixed", [])), *held]
    of = "load " if candidate.kind.startswith("load") else ""
    _rename(_record(study, candidate), {f"{of}{candidate.where[0]}": acts})


#: Kinds whose spring may have a `loss_factor` among what it is made of.
WITH_LOSS = ("spring", "support", "joint")
_EDITS: dict[str, Callable[[Tables, Candidate, float], None]] = {
    "spring": _spring,
    "support": _support,
    "dashpot": _dashpot,
    "friction": _friction,
    "mass": _mass,
    "sensor_mass": _sensor_mass,
    "inertia": _inertia,
    "offset": _offset,
    "appendage": _appendage,
    "joint": _joint,
    "untied stiffness": _untied,
    "untied mass": _untied,
    "untied set": _untied_set,
    "sensor_gain": _channel_error("outputs", "gain"),
    "load_gain": _channel_error("inputs", "gain"),
    "delay": _channel_error("outputs", "delay"),
    "load_delay": _channel_error("inputs", "delay"),
    "mesh": _mesh,
    "shear": _shear,
    "damping_law": _damping_law,
    "held": _held,
    "varies": _varies,
    "window": _window,
    "leakage": _leakage,
    "channel": _left_out,
    "outlying_lines": _excluded,
    "tone": _tones,
    "record": _without_record,
    "extra_mode": _other_modes,
    **dict.fromkeys(("polarity", "load_polarity", "place", "load_place", "swap", "load_swap"), _relabel),
    **dict.fromkeys(("between", "load_between"), _between),
    "direction": _aimed,
    "load_direction": _load_aimed,
}
