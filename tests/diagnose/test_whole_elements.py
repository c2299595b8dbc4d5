"""An element that is soft in all its stiffnesses, and a mount that is soft in all its springs, are named as that."""

import numpy as np
import pytest
from test_causes_elsewhere import beam
from test_kindred_causes import SPACE, written_in_space

import structid as sid
from structid.diagnose.causes import DifferingElement, DifferingSet, candidates
from structid.diagnose.causes.separate_element import DifferingProperty
from structid.diagnose.modified_model import base_model
from structid.diagnose.receptances import receptances_at
from structid.diagnose.score_test import point_at
from structid.diagnose.tested_model import TestedModel
from structid.forward import FrfProblem
from structid.study.run.diagnosis import suggestion_text
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study

FEET = {1: (-0.5, -0.3, 0.0), 2: (0.5, -0.3, 0.0), 3: (0.5, 0.3, 0.0), 4: (-0.5, 0.3, 0.0)}
CENTRE, CORNER = (0.05, -0.02, 0.25), (0.45, 0.25, 0.5)
SEEN = ["1X", "2Y", "3Z", "4Z", "6X", "6Y", "6Z"]
PIPE = {1: (0.0, 0.0, 0.0), 2: (0.0, 0.0, 0.5), 3: (0.0, 0.0, 1.0), 4: (0.4, 0.0, 1.0), 5: (0.8, 0.0, 1.0)}
OF_PIPE = ["2X", "2Y", "3X", "3Y", "4Y", "4Z", "5Y", "5Z"]


def measured(frequency, values, outputs, inputs, seed=1):
    """FRFs (n_lines, n_outputs, n_inputs) with 1 % of noise and a floor, as a record."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape)
    size = np.hypot(0.01 * np.abs(values), 1e-4 * np.abs(values).max())
    noisy = values + noise / np.sqrt(2) * size
    return sid.FrfRecord(frequency, noisy, outputs, inputs, "receptance", variance=size**2)


def lever(place):
    """Motion (3, 6) of a place of a rigid body by the translation and rotation of its centre."""
    x, y, z = np.subtract(place, CENTRE)
    return np.hstack([np.eye(3), [[0, z, -y], [-z, 0, x], [y, -x, 0]]])


def machine(soft):
    """FRFs of a rigid machine on four mounts; `soft` are factors on the stiffnesses of single feet along X, Y and Z."""
    frequency, places = np.linspace(3.0, 45.0, 160), {**FEET, 6: CORNER}
    inertia = np.diag([90.0, 90.0, 90.0, 6.0, 12.0, 14.0])
    stiffness = np.zeros((6, 6))
    for foot, place in FEET.items():
        springs = np.array([2.1e5, 2.6e5, 5.5e5]) * soft.get(foot, 1.0)
        stiffness += lever(place).T @ np.diag(springs) @ lever(place)
    reading = np.array([lever(places[int(name[0])])["XYZ".index(name[1])] for name in SEEN])
    s = 2j * np.pi * frequency[:, None, None]
    values = reading @ np.linalg.inv(s**2 * inertia + (1 + 0.06j) * stiffness) @ reading[[4, 5, 6]].T
    return measured(frequency, values, SEEN, ["6X", "6Y", "6Z"])


def model_of_machine():
    mounts = [
        sid.Spring(f"mounts_{d.lower()}", [f"{foot}{d}" for foot in FEET], stiffness=k, loss_factor=0.06)
        for d, k in (("X", 2e5), ("Y", 2.8e5), ("Z", 5e5))
    ]
    turning = (("RX", 6.0), ("RY", 12.0), ("RZ", 14.0))
    inertias = [sid.RotaryInertia(f"inertia {d}", [5], value, d) for d, value in turning]
    body = sid.RigidLink("body", 5, [*FEET, 6])
    structure = sid.Structure(
        {**FEET, 5: CENTRE, 6: CORNER}, [sid.PointMass("machine", [5], 90.0), *inertias, *mounts], ties=[body]
    )
    unknown = sid.parameters(structure, [sid.Unknown("stiffness", one.name) for one in mounts])
    return structure, unknown


def beam_matrices(length, mass, stiffnesses, polar):
    """Mass and stiffness matrices (12, 12) of a beam along local x: its axis, its torsion and its two planes, by the textbook."""
    along_z, along_y, axial, torsion = stiffnesses
    stretch, share = np.array([[1, -1], [-1, 1]]) / length, np.array([[2, 1], [1, 2]]) * length / 6
    heavy, bend = beam(1.0, mass, length, 1)
    sign = np.diag([1, -1, 1, -1])
    m, k = np.zeros((12, 12)), np.zeros((12, 12))
    for rows, elastic, inertial in (
        ([0, 6], axial * stretch, mass * share),
        ([3, 9], torsion * stretch, polar * share),
        ([1, 5, 7, 11], along_y * bend, heavy),
        ([2, 4, 8, 10], along_z * sign @ bend @ sign, sign @ heavy @ sign),
    ):
        k[np.ix_(rows, rows)] += elastic
        m[np.ix_(rows, rows)] += inertial
    return m, k


def pipe(soft):
    """FRFs of an L-shaped pipe, two elements up and two along X; `soft` are factors on stiffnesses of single elements."""
    frequency = np.linspace(4.0, 250.0, 240)
    mass, stiffness = np.zeros((30, 30)), np.zeros((30, 30))
    for k in range(4):
        x = np.subtract(PIPE[k + 2], PIPE[k + 1])
        length = np.linalg.norm(x)
        x, y = x / length, np.array([0.0, 1.0, 0.0])
        turn = np.kron(np.eye(4), [x, y, np.cross(x, y)])
        stiffnesses = np.array([220.0, 190.0, 4e5, 150.0] if k < 2 else [130.0, 120.0, 3e5, 90.0])
        own = beam_matrices(length, 1.5, stiffnesses * soft.get(k, 1.0), 4e-4)
        rows = np.ix_(*2 * [range(6 * k, 6 * k + 12)])
        mass[rows] += turn.T @ own[0] @ turn
        stiffness[rows] += turn.T @ own[1] @ turn
    mass[range(24, 27), range(24, 27)] += 0.6
    reading = np.array([6 * int(name[0]) - 12 + "XYZ".index(name[1]) for name in OF_PIPE])
    s = 2j * np.pi * frequency[:, None, None]
    flexibility = np.linalg.inv(s**2 * mass[6:, 6:] + (1 + 0.02j) * stiffness[6:, 6:])
    loads = reading[[6, 7]]
    return measured(frequency, flexibility[:, reading[:, None], loads], OF_PIPE, ["5Y", "5Z"])


def model_of_pipe():
    more = {"mass": 1.5, "polar_inertia": 4e-4, "loss_factor": 0.02}
    column = sid.SpaceBeam("column", [[1, 2], [2, 3]], bending_stiffness_y=200.0, bending_stiffness_z=200.0,
                           axial_stiffness=4e5, torsional_stiffness=150.0, **more)  # fmt: skip
    arm = sid.SpaceBeam("arm", [[3, 4], [4, 5]], bending_stiffness_y=125.0, bending_stiffness_z=125.0,
                        axial_stiffness=3e5, torsional_stiffness=90.0, **more)  # fmt: skip
    structure = sid.Structure(
        PIPE,
        [column, arm, sid.PointMass("valve", [5], 0.6)],
        fixed=[f"1{d}" for d in ("X", "Y", "Z", "RX", "RY", "RZ")],
    )
    bending = [f"bending_stiffness_{axis}" for axis in "yz"]
    unknown = sid.parameters(structure, [sid.Unknown(prop, name) for name in ("column", "arm") for prop in bending])
    return structure, unknown


RIGS = [
    (machine, model_of_machine, 2, ("mounts_x:2", "mounts_y:2", "mounts_z:2"), [2.1 / 2.0, 2.6 / 2.8, 5.5 / 5.0]),
    (pipe, model_of_pipe, 2, ("arm:1",), [1.04, 0.96, 1.0]),
]
#: One unknown for each plane of bending, and for the springs of each direction.
PLANES = "".join(f'[[unknown]]\nproperty = "bending_stiffness_{axis}"\nelements = "legs"\n\n' for axis in "yz")
MOUNTS = "".join(
    f'[[structure.spring]]\nname = "mounts {d}"\nfirst = ["2{d}", "3{d}", "4{d}"]\nstiffness = {k}\n\n'
    for d, k in (("X", 3e3), ("Y", 2e3), ("Z", 4e3))
)
OF_MOUNTS = "".join(f'[[unknown]]\nproperty = "stiffness"\nelements = "mounts {d}"\n\n' for d in "XY")
ALONE = PLANES.replace('"legs"\n', '"legs"\neach = true\n')


def wholes(records):
    return [one for one in candidates(records) if isinstance(one, DifferingElement | DifferingSet) and one.is_whole]


@pytest.mark.parametrize(("simulated", "model", "soft", "where", "ratios"), RIGS)
def test_what_is_soft_in_all_stiffnesses_ranks_first(simulated, model, soft, where, ratios):
    """Its group has the right values already; the pipe's element has 0.75 of them, the mount 0.75 along X, Y and Z."""
    structure, unknown = model()
    problem = FrfProblem(structure, unknown, simulated({soft: 0.75}))
    truth = [2.1e5, 2.6e5, 5.5e5] if simulated is machine else [220.0, 190.0, 130.0, 120.0]
    point = point_at([problem], np.log(truth) + 0.002)
    rows = point.screened(point.candidates([""]))
    first = min(rows, key=lambda row: row.left)
    assert first.candidate.where == where
    assert first.candidate.is_whole
    assert first.strength == pytest.approx(-0.25, abs=0.02)
    others = [row.left for row in rows if row.candidate.where != where]
    assert first.left < 0.2 * min(others) < 0.2 * point.left


@pytest.mark.parametrize(
    ("more", "several", "properties"),
    [
        ("", ("legs:1",), [("stiffness", None)]),
        (
            PLANES,
            ("legs:1",),
            [
                ("bending_stiffness_y", None),
                ("bending_stiffness_z", None),
                ("axial_stiffness", None),
                ("torsional_stiffness", "axial_stiffness[legs:1]"),
            ],
        ),
        ("", ("girder",), [("stiffness", None)]),
        (
            PLANES.replace('"legs"', '["legs", "girder"]'),
            ("legs",),
            [
                ("bending_stiffness_y", None),
                ("bending_stiffness_z", None),
                ("axial_stiffness", None),
                ("torsional_stiffness", "axial_stiffness[legs]"),
            ],
        ),
        (
            MOUNTS + OF_MOUNTS,
            ("mounts X:2", "mounts Y:2", "mounts Z:2"),
            [("stiffness", None), ("stiffness", None), ("stiffness", None)],
        ),
        (
            MOUNTS + OF_MOUNTS.replace('"mounts X"', '["mounts X", "mounts Z"]', 1),
            ("mounts X:2", "mounts Y:2", "mounts Z:2"),
            [("stiffness", None), ("stiffness", None), ("stiffness", "stiffness[mounts X:2]")],
        ),
    ],
)
def test_the_look_the_edited_model_and_the_edited_study_say_the_same(tmp_path, more, several, properties):
    path = written_in_space(tmp_path, SPACE)
    path.write_text(SPACE.replace("[[unknown]]", more + "[[unknown]]", 1), encoding="utf-8")
    ready = prepare_study(load_study(path))
    trial = base_model(TestedModel(ready.setups, ready.study.options), ready.problems, ready.problems[0].theta_start)
    base = trial.views[0].problem
    fields = receptances_at(base, base.theta_start)
    [whole] = [one for one in wholes([fields]) if one.where == several]
    assert [one[1:] for one in sorted(whole.properties, key=lambda one: one.element)] == properties
    changed = trial.changed(whole, -0.3)
    assert len(changed.target.names) == len(trial.target.names) + sum(follows is None for _, follows in properties)
    [problem] = changed.problems
    lines = np.searchsorted(base.frequency, fields.problem.frequency)
    change = problem.predicted(problem.theta_start)[lines] - fields.frf
    assert np.abs(change).max() > 1e-3 * np.abs(fields.frf).max()
    assert np.abs(whole.effect(fields, np.array([-0.3]))[0] - change).max() < 1e-6 * np.abs(change).max()
    text, _ = suggestion_text(ready.study, changed.changes)
    path.write_text(text, encoding="utf-8")
    again = prepare_study(load_study(path)).problems[0]
    assert again.names == problem.names
    assert again.theta_start == pytest.approx(problem.theta_start, rel=1e-5)
    assert again.predicted(again.theta_start) == pytest.approx(problem.predicted(problem.theta_start), rel=1e-5)


def test_what_has_values_of_its_own_or_no_group_is_not_offered(tmp_path):
    path = written_in_space(tmp_path, SPACE)
    offered = {}
    lone = MOUNTS.replace('["2X", "3X", "4X"]', '["2X"]').replace('["2Y", "3Y", "4Y"]', '["2Y"]') + OF_MOUNTS
    one_plane = PLANES.partition("\n\n")[0] + "\n\n"
    for name, more in (("held", ""), ("alone", ALONE), ("plane", one_plane), ("lone", lone)):
        path.write_text(SPACE.replace("[[unknown]]", more + "[[unknown]]", 1), encoding="utf-8")
        [problem] = prepare_study(load_study(path)).problems
        offered[name] = {one.where for one in wholes([receptances_at(problem, problem.theta_start)])}
    girder = {("girder:1",), ("girder:2",)}
    legs = {("legs:1",), ("legs:2",)}
    assert offered["held"] == offered["lone"] == legs | girder | {("legs",), ("girder",)}
    assert offered["plane"] == legs | girder | {("girder",)}
    assert offered["alone"] == girder | {("girder",)}


def test_words_name_the_element_or_the_node_of_the_mount():
    mount = DifferingElement(where=("a:1", "b:1"), properties=(), is_whole=True, nodes=(4,))
    between = DifferingElement(where=("a:1", "b:1"), properties=(), is_whole=True, nodes=(4, 14))
    assert mount.sentence(None) == "all springs at node 4 differ from their groups: a:1, b:1"
    assert between.sentence(None) == "all springs between nodes 4 and 14 differ from their groups: a:1, b:1"
    element = DifferingElement(where=("arm:1",), properties=(), is_whole=True)
    assert element.sentence(None) == "arm:1 differs from its group in all its stiffnesses"
    column = DifferingSet(where=("column",), properties=(), is_whole=True)
    assert column.sentence(None) == "all of column differs from its group in all its stiffnesses"
    held = DifferingSet(where=("column",), properties=(DifferingProperty("column", "stiffness"),), is_whole=True)
    assert held.sentence(None) == "the stiffnesses of all of column, which the study fixes, are off by one factor"


@pytest.mark.long
@pytest.mark.parametrize(("simulated", "model", "soft", "where", "ratios"), RIGS)
def test_what_is_soft_in_all_stiffnesses_is_the_first_cause(simulated, model, soft, where, ratios):
    """Factors are on the initial values of the study, from which its group is off by `ratios`."""
    factor = 0.7 if simulated is machine else 0.75
    structure, unknown = model()
    identified = sid.identify(structure, unknown, simulated({soft: factor}), sid.IdentifyOptions(restarts=0))
    explained = sid.explain(identified)
    assert explained.judgement.verdict == "wrong_model"
    first = explained.causes[0]
    assert (first.kind, first.where) == ("untied", where)
    assert first.leaves_noise
    found = [value for _, value, _ in first.found]
    assert found == pytest.approx([factor * ratio for ratio in ratios], rel=0.05)


@pytest.mark.long
@pytest.mark.parametrize(("simulated", "model"), [rig[:2] for rig in RIGS])
def test_a_right_model_has_no_such_cause(simulated, model):
    structure, unknown = model()
    explained = sid.explain(sid.identify(structure, unknown, simulated({}), sid.IdentifyOptions(restarts=0)))
    assert explained.judgement.verdict == "sound"
    assert not explained.causes
