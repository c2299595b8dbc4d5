"""Causes in words."""

from __future__ import annotations

import math

from structid.core.display import join_words
from structid.core.dof import parse_dof
from structid.core.units import MISTAKEN_FORCES, mistaken_motions, mistaken_unit
from structid.criticism.candidate import Candidate

#: Difference of a gain's logarithm from that of another unit within which it is taken for it.
_UNIT = 0.05
#: Places of one cause that are named.
_SHOWN = 3
#: Kinds that results call otherwise.
_KINDS = {
    "untied stiffness": "untied",
    "untied mass": "untied",
    "untied set": "untied",
    "held": "untied",
    "load_delay": "delay",
    "load_polarity": "polarity",
    "load_direction": "direction",
    "between": "place",
    "load_between": "load_place",
    "tone": "outlying_lines",
    "leakage": "window",
}


def cause_kind(candidate: Candidate, value: float | None) -> str:
    """The kind as results have it: what it turned out to be."""
    if unit_of(candidate, value):
        return "unit"
    return _KINDS.get(candidate.kind, candidate.kind)


def unit_of(candidate: Candidate, gain: float | None) -> str:
    """The mistaken unit that a gain of a channel stands for; "" where it is that of none."""
    if candidate.kind not in ("sensor_gain", "load_gain") or gain is None or gain <= 0:
        return ""
    if candidate.kind == "load_gain":
        return mistaken_unit(-math.log(gain), MISTAKEN_FORCES, _UNIT)
    return mistaken_unit(math.log(gain), mistaken_motions(parse_dof(candidate.where[0]).is_rotation), _UNIT)


def cause_words(candidate: Candidate, value: float | None) -> str:
    """What a change says, in a clause."""
    where = candidate.where
    first = where[0]
    lack = "missing in the model" if value is None or value > 0 else "too much in the model"
    words = {
        "support": f"the supports {join_words(where)} are flexible" if len(where) > 1 else f"the support {first} is flexible",
        "spring": f"something holds {first}: a spring to the ground",
        "dashpot": f"a damper acts {'between' if len(where) > 1 else 'at'} {' and '.join(where)}",
        "friction": f"something rubs at {first}",
        "mass": f"a mass at node {first} is {lack}" + (f" in {_record(where[1])}" if len(where) > 1 else ""),
        "sensor_mass": f"each sensor has a mass that is {lack}: at nodes {join_words(where, _SHOWN)}",
        "inertia": f"a rotary inertia at {first} is {lack}",
        "offset": f"the mass {first} sits off its node along {where[-1]}",
        "appendage": f"a local resonance acts at {first} that the model lacks (an appendage, a cable, a loose part)",
        "joint": f"the end of {first} at {where[-1]} turns against its node",
        "untied stiffness": f"the stiffness of {first} is not that of its group",
        "untied mass": f"the mass of {first} is not that of its group",
        "untied set": f"the {' '.join(candidate.others).replace('_', ' ')} of all of {first} is not that of its group",
        "mesh": "the mesh is too coarse for the highest frequencies",
        "shear": f"{first} shears: it is no slender beam",
        "damping_law": f"damping of {join_words(where[:-1])} is {where[-1]}",
        "held": f"{join_words(where)}, which the study fixes, "
        + ("are off by one factor" if len(where) > 1 else "is not what the model says"),
        "varies": f"{first} differs from record to record",
        "window": "the records were windowed, which adds damping",
        "leakage": "resonances leak into the lines beside them: averages of segments of random motion under a Hann window",
        "delay": (
            f"sensors {join_words(where)} are late by one time, as of one card" if len(where) > 1 else f"sensor {first} is late"
        ),
        "load_delay": f"the force at {first} is late",
        "polarity": f"sensor {first} reads with the opposite sense",
        "load_polarity": f"the force at {first} acts with the opposite sense",
        "place": f"sensor {first} sits at {where[-1]}",
        "load_place": f"the force at {first} acts at {where[-1]}",
        "between": f"sensor {first} sits between its node and that of {where[-1]}",
        "load_between": f"the force at {first} acts between its node and that of {where[-1]}",
        "swap": f"the cables of {' and '.join(where)} are exchanged",
        "load_swap": f"the forces at {' and '.join(where)} are exchanged",
        "direction": f"sensor {first} is turned towards {where[-1]}",
        "load_direction": f"the force at {first} is turned towards {where[-1]}",
        "channel": f"sensor {first} fits far worse than the others: noisy, clipped, dead, or turned",
        "outlying_lines": f"lines at {_few(where)} do not go with the others",
        "tone": f"a tone at {_few(where)} that no force made, such as mains, is in the record",
        "extra_mode": f"the mode at {first} is none of this structure",
        "record": f"{_record(first)} is of another state than the others",
        "noise_level": "the noise is not what it was taken for; it is"
        + ("" if value is None else f" {value:.3g} times that"),
    }  # fmt: skip
    if candidate.kind in ("sensor_gain", "load_gain"):
        what = f"sensor {first}" if candidate.kind == "sensor_gain" else f"the force at {first}"
        unit = unit_of(candidate, value)
        if unit:
            return f"{what} is in another unit than stated: {unit}"
        return f"the calibration of {what} is off" + ("" if value is None else f" by a factor of {value:.4g}")
    return words[candidate.kind]


def _record(title: str) -> str:
    """A record by its name, or by the number that stands for it."""
    return title if title.startswith("record ") else f"record {title}"


def _few(places: tuple[str, ...]) -> str:
    """All of few places, the first of many and how many more there are."""
    return join_words(places) if len(places) <= _SHOWN + 1 else f"{join_words(places, _SHOWN)} stretches"
