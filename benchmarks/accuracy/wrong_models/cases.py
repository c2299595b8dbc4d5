"""The table of cases: rig, test, start, faults.

A line is `test [far] kind where size [+ kind where size]`; the tests are in `measuring`, the faults in `faults`. `far`: the
parameters start 15 to 30 % off, otherwise 3 to 10 %. Held-out structures are for the last examination only: nobody who
tunes anything looks at their results.
"""

from __future__ import annotations

import json
from pathlib import Path

from wrong_models.faults import Fault
from wrong_models.study_files import Case

ALIASES = Path(__file__).with_name("aliases.json")

DEVELOPMENT = {
    "two_span": """
        frf      support 9Y 3e5
        frf far  support 5Y 6e4
        frf      joint left:3/4RZ 800
        frf      mass 6 0.02
        frf      inertia 4RZ 0.001
        frf far  dashpot 4Y 1
        frf      untied right:2 bending_stiffness*0.93
        frf      mesh left,right 3
        frf      sensor_gain 6Y 1.08
        frf far  polarity 7Y
        frf      noise_level any 0.1
        random   friction 6Y 1.0
        hits30   untied left:2 mass*1.2
        time     mass 8 0.1
        time     clipping 4Y 0.35
        time far unit 6Y 9.80665
        modal    support 9Y 1e5
        modal far untied left:1 bending_stiffness*0.7
        frf      support 9Y 3e5 + sensor_gain 4Y 0.9
        frf      joint left:3/4RZ 800 + mass 8 0.1
        time     mass 6 0.1 + delay 7Y 4e-4
    """,
    "portal": """
        frf      support 11RZ 8000
        frf      joint girder:1/4RZ 4e4
        frf far  mass 9 0.05
        frf far  inertia 6RZ 0.005
        frf      appendage 7Y 0.15@40
        frf      shear left,girder,right 2e5
        frf far  load_gain 4X 0.93
        frf      direction 5Y X@25
        frf      unit 9X 9.80665
        frf2     load_swap any
        states   record mass_on_5 left:bending_stiffness*0.9
        random   window any 1
        time     sensor_gain 7Y 0.92
        time     untied girder:2 bending_stiffness*0.8
        modal    joint girder:4/8RZ 3000
        modal    mass 3 0.5
        modal    inertia 6RZ 0.05
        modalstates record bare girder:bending_stiffness*0.85
        frf      support 1RZ 8000 + load_gain 4X 0.95
        frf      mass 9 0.3 + polarity 2X
        modal    joint girder:1/4RZ 3000 + polarity 9X
    """,
    "shear": """
        frf      mass 4 6
        frf far  dashpot 5X 60
        frf      delay 2X 4e-3
        frf      swap 2X 4X
        frf      appendage 5X 3@3
        frf far  damping_law any
        frf      window any 0.05
        frf      noise_level any 8
        hits30   sensor_gain 5X 0.9
        time     polarity 4X
        time     load_gain 6X 1.1
        time     dashpot 2X 1500
        time far swap 1X 5X
        modal    mass 2 30
        ambient  mass 5 40
        modal    sensor_gain 3X 1.2
        frf      mass 4 25 + sensor_gain 2X 1.1
        frf      dashpot 5X 1200 + delay 4X 4e-3
        time     mass 2 20 + outlying_lines 5 0.3
    """,
    "tower": """
        frf      support 3X 6e5
        frf      untied lower:3 stiffness*0.93
        frf      joint rings:2/7RZ 3000
        frf far  direction 10Y X@90
        frf      swap 9X 12X
        frf      unit 11X 4.44822
        frf      mass 6 0.1
        frf      outlying_lines 25 0.5
        time     channel 7Y dead
        time     direction 6X Y@30
        modal    untied upper:1 stiffness*0.75
        modal    swap 9X 7Y
        frf      untied lower:3 stiffness*0.85 + unit 10Y 9.80665
        frf      mass 6 0.4 + swap 9X 12X
        modal    untied upper:1 stiffness*0.75 + mass 7 1.0
    """,
    "grillage": """
        frf      mass 13 0.03
        frf far  untied long:2 bending_stiffness_y*0.75
        frf      shear long,cross 4e5
        frf      support 6RY 4e4
        frf      channel 9Z 0.3
        frf      sensor_gain 15Z 1.15
        frf2     mass 8 0.3
        frf      inertia 8RX 0.002
        states   record mass_on_14 long:mass*1.05
        time     outlying_lines 50 0.2
        time     appendage 15Z 0.1@12
        modal    support 6RY 1500
        modal far noise_level any 0.1
        frf      mass 13 0.25 + untied long:6 bending_stiffness_y*0.8
        frf      support 6RY 3000 + sensor_gain 9Z 0.92
    """,
    "truss": """
        frf      untied diagonals:2 axial_stiffness*0.75
        frf      mass 9 2
        frf      support 7Y 5e7
        frf far  dashpot 4Y 150
        frf      delay 6Y 3e-4
        frf      direction 9X Y@30
        frf      load_gain 3Y 1.06
        time     support 7Y 5e7
        time     noise_level any 0.1
        modal    untied bottom:3 axial_stiffness*0.8
        modal    sensor_gain 4Y 1.2
        modal    extra_mode 40
        ambient  support 7Y 3e7
        frf      untied diagonals:2 axial_stiffness*0.75 + load_gain 3Y 1.06
        frf      mass 9 12 + delay 6Y 3e-4
    """,
    "rail": """
        frf      untied bed:3 stiffness*0.85
        frf      joint rail:4/5RZ 4000
        frf      mass 8 0.05
        frf far  sensor_gain 1Y 0.9
        frf      mesh rail 3
        frf      outlying_lines 50 1.0
        random   friction 9Y 2.0
        h1       window any 512
        time     joint rail:6/7RZ 3000
        modal    direction 6Y X@40
        modal    untied bed:6 stiffness*0.5
        frf      untied bed:3 stiffness*0.5 + dashpot 7Y 15
        frf      mass 8 0.25 + polarity 3Y
    """,
    "hall": """
        frf      support 4RZ 1.2e5
        frf      mass 12 0.1
        frf      swap 10Y 12Y
        frf      load_gain 6X 0.9
        frf far  dashpot 8X 1
        frf      appendage 12Y 0.2@50
        modal    support 7RZ 5000
        modal    polarity 12Y
        frf      support 4RZ 9000 + mass 11 0.3
        frf      mass 12 0.4 + unit 3X 9.80665
    """,
}  # fmt: skip

HELD_OUT = {
    "shaft": """
        frf      joint thick:2/5RZ 3e4
        frf      mass 5 0.3
        frf far  untied thin:4 bending_stiffness*0.8
        frf      appendage 1Y 0.1@180
        frf      shear thin,thick 2e6
        frf      dashpot 5Y 150
        frf      untied bearings:2 stiffness*0.7
        frf      sensor_gain 3Y 0.92
        frf far  delay 5Y 1e-4
        frf      polarity 1Y
        frf      mesh thin,thick 3
        random   friction 8Y 2.0
        hits30   swap 3Y 5Y
        time     untied thin:3 mass*1.3
        time     sensor_gain 1Y 1.12
        time     clipping 5Y 0.4
        modal    untied bearings:2 stiffness*0.75
        modal    joint thick:2/5RZ 2e4
        modal    extra_mode 175
        frf      joint thick:2/5RZ 3e4 + sensor_gain 3Y 0.92
        frf      untied bearings:2 stiffness*0.7 + swap 3Y 5Y
        frf      mass 5 0.3 + polarity 1Y
        time     untied thin:4 bending_stiffness*0.8 + unit 5Y 9.80665
    """,
    "mast": """
        frf      support 1RZ 3e6
        frf far  joint arm:1/6RZ 8e4
        frf      mass 4 0.3
        frf      dashpot 5X 10
        frf      appendage 6X 0.8@9
        frf      untied foot:1 bending_stiffness*0.8
        frf      direction 8Y X@25
        frf far  load_gain 4X 1.08
        frf      unit 3X 9.80665
        frf      damping_law any
        frf2     load_swap any
        states   record mass_on_7 guys:axial_stiffness*0.8
        random   window any 1
        time     support 1RZ 3e6
        time     delay 6X 6e-4
        time     outlying_lines 50 0.2
        modal    untied foot:1 bending_stiffness*0.7
        modal    mass 4 4
        modalstates record mass_on_5 head:bending_stiffness*0.85
        frf      support 1RZ 3e6 + load_gain 4X 1.08
        frf      mass 4 1.5 + direction 8Y X@25
        frf      dashpot 5X 30 + swap 2X 3X
    """,
    "drum": """
        frf      mass 24 0.004
        frf      dashpot 19Z 1
        frf far  appendage 33Z 0.03@25
        frf      sensor_gain 38Z 1.1
        frf      swap 10Z 33Z
        frf      outlying_lines 16.7 0.6
        frf      channel 18Z 0.3
        frf far  window any 0.2
        frf      noise_level any 0.12
        hits30   mass 40 0.06
        time     polarity 27Z
        time     channel 33Z dead
        modal    mass 24 0.15
        modal    sensor_gain 18Z 1.25
        frf      mass 24 0.05 + sensor_gain 38Z 1.1
        frf      dashpot 19Z 1 + mass 40 0.06
        modal    mass 24 0.15 + sensor_gain 18Z 1.25
    """,
    "plate": """
        frf      support 3RY 300
        frf far  mass 13 0.01
        frf      appendage 24Z 0.05@60
        frf      dashpot 28Z 2
        frf      load_gain 21Z 0.92
        frf      polarity 12Z
        frf      delay 30Z 2e-4
        frf      noise_level any 6
        modal    mass 28 0.2
        modal    swap 18Z 24Z
        modal    support 3RY 100
        frf      mass 13 0.1 + polarity 12Z
        frf      support 3RY 300 + sensor_gain 26Z 1.1
        frf      dashpot 28Z 2 + load_gain 21Z 0.92
    """,
    "dome": """
        frf      untied legs:5 axial_stiffness*0.9
        frf      untied ring:2 axial_stiffness*0.75
        frf far  mass 12 0.2
        frf      support 3Z 5e6
        frf      direction 9X Y@90
        frf      unit 8Z 4.44822
        frf      dashpot 10Z 60
        states   record bare ring:axial_stiffness*0.9
        time     untied crown:4 axial_stiffness*0.7
        time     swap 7Z 10Z
        time far load_gain 8Z 0.9
        modal    untied legs:9 axial_stiffness*0.65
        ambient  mass 9 2.0
        frf      untied legs:5 axial_stiffness*0.7 + mass 10 0.8
        modal    untied legs:9 axial_stiffness*0.65 + polarity 13Z
        time     untied crown:4 axial_stiffness*0.7 + swap 7Z 10Z
    """,
    "branches": """
        frf      untied long_springs:2 stiffness*0.95
        frf      mass 5 0.6
        frf      dashpot 8X 20
        frf far  delay 7X 5e-4
        frf      swap 1X 3X
        frf      sensor_gain 5X 0.93
        frf      damping_law any
        frf      appendage 3X 1.0@12
        random   friction 8X 2.0
        h1       window any 256
        time     mass 7 0.8
        time     unit 6X 9.80665
        time     noise_level any 0.1
        modal    mass 5 1.0
        modal    noise_level any 0.1
        frf      untied long_springs:2 stiffness*0.8 + mass 8 0.5
        time     mass 5 0.6 + polarity 3X
        frf      dashpot 8X 20 + sensor_gain 5X 0.93
        frf      appendage 3X 1.0@12 + polarity 7X
    """,
}  # fmt: skip

#: Made after the last change to how causes are found, and run once: nothing was drawn from it.
FRESH = {
    "crane": """
        frf      support 1RZ 2e5
        frf      joint jib:3/6RZ 2e4
        frf far  mass 7 0.5
        frf      dashpot 8Y 15
        frf      appendage 5X 0.9@7
        frf      untied jib:4 bending_stiffness*0.75
        frf      untied stay:2 axial_stiffness*0.7
        frf      sensor_gain 8Y 0.93
        frf far  delay 6Y 4e-4
        frf      polarity 10Y
        frf      load_gain 8Y 1.12
        frf2     load_swap any
        random   friction 10Y 3.0
        time     mass 3 1.5
        time     swap 6Y 8Y
        modal    support 1RZ 1e5
        modal    untied column:2 bending_stiffness*0.7
        states   record mass_on_9 stay:axial_stiffness*0.8
        frf      support 1RZ 2e5 + sensor_gain 8Y 0.93
        frf      mass 7 1.0 + polarity 10Y
        frf      dashpot 8Y 15 + delay 6Y 4e-4
    """,
    "rack": """
        frf      joint upper:1/5RZ 1500
        frf      untied plates:2 stiffness*0.6
        frf far  mass 10 1.0
        frf      dashpot 13X 25
        frf      appendage 17Y 1.0@14
        frf      untied posts:5 bending_stiffness*0.8
        frf      swap 16Y 17Y
        frf      unit 18Y 9.80665
        frf      damping_law any
        frf      outlying_lines 16.7 0.5
        frf      noise_level any 0.1
        frf far  channel 12X 0.4
        hits30   mass 3 2.0
        time     support 1X 5e5
        time     sensor_gain 17Y 1.15
        time     noise_level any 0.1
        modal    mass 10 5
        modal    joint upper:1/5RZ 800
        modal    extra_mode 20
        frf      untied plates:2 stiffness*0.6 + mass 10 2.0
        frf      joint upper:1/5RZ 1500 + swap 16Y 17Y
        time     mass 3 3.0 + polarity 18Y
    """,
    "wing": """
        frf      support 1RZ 3e5
        frf      joint outer:1/5RZ 4e4
        frf      untied outer:3 bending_stiffness*0.85
        frf far  mass 3 0.8
        frf      dashpot 7Y 12
        frf      appendage 4Y 1.5@25
        frf      shear inner,outer 4e6
        frf      mesh inner,outer 3
        frf      sensor_gain 6Y 1.07
        frf      polarity 5Y
        frf far  window any 0.3
        time     untied inner:2 mass*1.3
        time far delay 8Y 4e-4
        time     channel 3Y dead
        time     clipping 9Y 0.4
        modal    support 1RZ 1.5e5
        modal    sensor_gain 8Y 1.2
        modal    swap 3Y 5Y
        frf      support 1RZ 3e5 + mass 8 0.8
        frf      untied outer:3 bending_stiffness*0.7 + sensor_gain 6Y 1.07
    """,
}  # fmt: skip

#: Structures that their supports drive.
SHAKEN = {
    "chimney": """
        shaken   support 1RZ 4e3
        shaken   joint upper:1/4RZ 3000
        shaken far mass 3 0.5
        shaken   dashpot 7Y 2
        shaken   appendage 8Y 0.2@12
        shaken   untied upper:2 bending_stiffness*0.8
        shaken   mesh lower,upper 3
        shaken   sensor_gain 5Y 1.07
        shaken   load_gain 1Y 1.1
        shaken   delay 1Y 3e-4
        shaken far polarity 7Y
        shaken   swap 5Y 7Y
        shaken   damping_law any
        shaken   channel 4Y 0.3
        shaken   noise_level any 0.1
        quake    support 1RZ 4e3
        quake    mass 5 0.4
        quake    load_gain 1Y 1.1
        quake    delay 5Y 6e-4
        shaken   support 1RZ 4e3 + sensor_gain 7Y 0.9
        quake    mass 3 0.5 + polarity 5Y
    """,
    "podium": """
        shaken   mass 5 40
        shaken   dashpot 5X 900
        shaken far appendage 7X 20@5
        shaken   unit 3X 9.80665
        shaken   delay 9X 2e-3
        shaken   swap 5X 7X
        shaken   untied floors:3 mass*1.25
        shaken   outlying_lines 5.1 0.5
        quake    mass 6 40
        quake far sensor_gain 6X 0.9
        quake    load_gain 9X 0.9
        quake    polarity 5X
        quake    channel 2X dead
        quake    unit 9X 9.80665
        shaken   mass 5 40 + sensor_gain 3X 1.1
    """,
    "shelf": """
        shaken   support 8Y 2e5
        shaken   untied plates:2 stiffness*0.5
        shaken   joint girder:1/3RZ 1500
        shaken far mass 6 1.0
        shaken   dashpot 3X 15
        shaken   direction 2X Y@25
        shaken   load_gain 1X 1.08
        shaken   untied posts:2 bending_stiffness*0.75
        quake    untied plates:1 stiffness*0.5
        quake    mass 3 1.0
        quake    delay 1X 5e-4
        quake far swap 4Y 5Y
        shaken   untied plates:2 stiffness*0.5 + delay 5Y 5e-4
    """,
}  # fmt: skip

SETS = {"development": DEVELOPMENT, "heldout": HELD_OUT, "fresh": FRESH, "shaken": SHAKEN}

#: Right models: each line for each rig. With `~` the model has errors that do not matter.
TWINS = """
    frf
    frf far
    frf far
    hits5 far
    time
    time far
    modal
    modal far
    states far
    frf ~ scatter all 0.002
"""
#: The same of structures that their supports drive.
SHAKEN_TWINS = """
    shaken
    shaken far
    shaken far
    quake
    quake far
    quake far
    shaken ~ scatter all 0.002
"""
#: Right models of single rigs.
FURTHER_TWINS = {
    "two_span": "random, frf ~ support 9Y 1e9", "shear": "ambient, h1 far, frf ~ mass 4 0.1",
    "portal": "ambient, frf2 far", "truss": "random", "rail": "h1, hits5",
    "shaft": "random", "mast": "ambient, frf ~ support 1RZ 5e8", "drum": "ambient", "dome": "ambient",
    "branches": "h1, frf ~ mass 5 0.005",
}  # fmt: skip


def _case(rig: str, line: str, taken: set[str], aliases: dict[str, list[list[str]]]) -> Case:
    words, _, changes = line.strip().partition(" ")
    start = "far" if changes.split()[:1] == ["far"] else "near"
    changes = changes.strip().removeprefix("far").strip()
    harmless = changes.startswith("~")
    faults = tuple(Fault(*part.split()) for part in changes.removeprefix("~").split("+") if part.strip())
    about = (
        "-".join(f"{f.kind}-{f.where}" for f in faults).replace("/", "-").replace(":", "-").replace(",", "-") or "twin"
    )
    base = f"{rig}-{words}-{start}-{'small-' if harmless else ''}{about}"
    name = base
    for number in range(2, 100):
        if name not in taken:
            break
        name = f"{base}-{number}"
    taken.add(name)
    return Case(name, rig, words, faults, start, harmless, tuple((k, w) for k, w in aliases.get(name, ())))


def cases(which: str) -> list[Case]:
    """All cases of one of the `SETS`, faults first."""
    table = SETS[which]
    known = json.loads(ALIASES.read_text(encoding="utf-8")) if ALIASES.exists() else {}
    aliases = {name: one["aliases"] for name, one in known.items()}
    taken: set[str] = set()
    made = [_case(rig, line, taken, aliases) for rig, text in table.items() for line in text.strip().splitlines()]
    twins = SHAKEN_TWINS if which == "shaken" else TWINS
    for rig in table:
        lines = [line for line in twins.strip().splitlines() if not (rig in ("hall", "plate") and "time" in line)]
        lines += FURTHER_TWINS.get(rig, "").split(", ") if rig in FURTHER_TWINS else []
        made += [_case(rig, line, taken, aliases) for line in lines]
    return made
