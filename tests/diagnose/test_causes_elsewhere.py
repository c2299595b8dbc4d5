"""Causes in structures that neither bend nor stand like the portal frame: made with matrices of the tests' own."""

import numpy as np
import pytest

from structid.records import FrfRecord
from structid.records.formats import write_record
from structid.study.run.diagnosis import diagnose_study
from structid.study.run.run import run_prepared
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study

TAIL = """
[record]
path = "frf.npz"

[record.noise]
relative = 0.01
absolute = {floor}

[method]
restarts = 0
"""


FLOORS = """
[structure]
active = ["X"]

[structure.nodes]
1 = 1.0
2 = 2.0
3 = 3.0
4 = 4.0

[[structure.point_mass]]
name = "floors"
nodes = [1, 2, 3, 4]
mass = 5.3

[[structure.spring]]
name = "storeys"
first = ["1X", "2X", "3X"]
second = ["2X", "3X", "4X"]
stiffness = 7400.0
loss_factor = 0.02

[[structure.spring]]
name = "ground"
first = "1X"
stiffness = 8300.0
loss_factor = 0.02

[[unknown]]
property = "mass"
elements = "floors"

[[unknown]]
property = "stiffness"
elements = ["ground", "storeys"]
each = true

"""


def answered(folder, text, frequency, receptance, outputs, inputs, seed=3):
    """Causes of a study whose record are receptances (n_lines, n_outputs, 1) with 1 % noise and a floor."""
    floor = 1e-3 * float(np.sqrt((np.abs(receptance) ** 2).mean()))
    rng = np.random.default_rng(seed)
    noise = (rng.standard_normal(receptance.shape) + 1j * rng.standard_normal(receptance.shape)) / np.sqrt(2)
    values = receptance + noise * np.hypot(0.01 * np.abs(receptance), floor)
    write_record(folder / "frf.npz", FrfRecord(frequency, values, outputs, inputs, "receptance"))
    (folder / "study.toml").write_text(text + TAIL.format(floor=floor), encoding="utf-8")
    ready = prepare_study(load_study(folder / "study.toml"))
    return diagnose_study(ready, run_prepared(ready))[0].diagnosis


def chain(inertia, stiffness, swinging=0.0, frequency=0.0):
    """Mass and complex stiffness of a free chain of discs, with one more that swings on the last."""
    n = len(inertia)
    m, k = np.diag([*inertia, swinging][: n + (swinging > 0)]).astype(float), np.zeros((n + 1, n + 1), complex)
    for i, c in enumerate(stiffness):
        k[i : i + 2, i : i + 2] += c * (1 + 0.02j) * np.array([[1, -1], [-1, 1]])
    if swinging:
        k[n - 1 :, n - 1 :] += swinging * (2 * np.pi * frequency) ** 2 * (1 + 0.05j) * np.array([[1, -1], [-1, 1]])
    return m, k[: len(m), : len(m)]


@pytest.mark.long
def test_what_swings_of_its_own_on_a_drive_train_is_named_first(tmp_path):
    """A damper of torsional vibration that the model lacks."""
    inertia, stiffness = [0.8, 0.12, 0.3, 0.4, 0.9], [6000.0, 9000.0, 9000.0, 7000.0]
    discs = "".join(
        f'[[structure.rotary_inertia]]\nname = "disc {i}"\nnodes = [{i}]\nrotary_inertia = {j}\ndirection = "RX"\n\n'
        for i, j in enumerate(inertia, 1)
    )
    springs = "".join(
        f'[[structure.spring]]\nname = "shaft {i}"\nfirst = "{i}RX"\nsecond = "{i + 1}RX"\nstiffness = {c}\nloss_factor = 0.02\n\n'
        for i, c in enumerate([5800.0, 9400.0, 8800.0, 7200.0], 1)
    )
    nodes = "".join(f"{i} = [{float(i)}]\n" for i in range(1, 6))
    unknown = "".join(f'[[unknown]]\nproperty = "stiffness"\nelements = "shaft {i}"\n\n' for i in range(1, 5))
    text = f'[structure]\nactive = ["RX"]\n\n[structure.nodes]\n{nodes}\n{discs}{springs}{unknown}'
    mass, k = chain(inertia, stiffness, 0.03, 24.0)
    frequency = np.linspace(2.0, 60.0, 150)
    omega = 2 * np.pi * frequency[:, None, None]
    receptance = np.linalg.inv(k - omega**2 * mass)[:, :5, :1]
    found = answered(tmp_path, text, frequency, receptance, [f"{i}RX" for i in range(1, 6)], ["1RX"])
    first, *_ = found.causes
    assert (first.kind, first.where) == ("appendage", ("5RX",))
    assert first.chi_square_per_dof == pytest.approx(1.0, abs=0.15)
    values = {name.partition("[")[0]: value for name, value, _ in first.found}
    assert values["rotary_inertia"] == pytest.approx(0.03, rel=0.05)


def beam(stiffness, mass, length, n):
    """Mass and stiffness of a beam of n equal parts that is free at both ends, by cubic shape functions."""
    h, m, k = length / n, np.zeros((2 * n + 2, 2 * n + 2)), np.zeros((2 * n + 2, 2 * n + 2))
    bending = np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2]])
    bending = np.vstack([bending, -bending[0], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]) * stiffness / h**3
    inertia = np.array([
        [156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2],
        [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2],
    ]) * mass * h / 420  # fmt: skip
    for i in range(n):
        own = slice(2 * i, 2 * i + 4)
        m[own, own] += inertia
        k[own, own] += bending
    return m, k


@pytest.mark.long
@pytest.mark.parametrize("turning", [3e3, 1e9])
def test_a_pin_that_is_a_clamp_or_half_of_one_is_named_first(tmp_path, turning):
    """A girder over two spans whose first end is drawn free to turn; neighbours held instead explain much of it."""
    nodes = "".join(f"{i} = {0.5 * i}\n" for i in range(9))
    text = f"""
[structure]
active = ["Y", "RZ"]
fixed = ["0Y", "4Y", "8Y"]

[structure.nodes]
{nodes}
[[structure.beam]]
name = "left"
nodes = [[0, 1], [1, 2], [2, 3], [3, 4]]
mass = 30.0
bending_stiffness = 2200.0
loss_factor = 0.02

[[structure.beam]]
name = "right"
nodes = [[4, 5], [5, 6], [6, 7], [7, 8]]
mass = 30.0
bending_stiffness = 1850.0
loss_factor = 0.02

[[unknown]]
property = "bending_stiffness"
elements = "left"

[[unknown]]
property = "bending_stiffness"
elements = "right"

[[unknown]]
property = "mass"
elements = ["left", "right"]
"""
    mass, k = beam(2000.0, 30.0, 4.0, 8)
    k[1, 1] += turning / (1 + 0.02j).real
    free = [i for i in range(18) if i not in (0, 8, 16)]
    frequency = np.linspace(1.0, 60.0, 200)
    omega = 2 * np.pi * frequency[:, None, None]
    whole = np.linalg.inv(k[np.ix_(free, free)] * (1 + 0.02j) - omega**2 * mass[np.ix_(free, free)])
    places = [free.index(2 * i) for i in (1, 2, 3, 5, 6, 7)]
    found = answered(
        tmp_path, text, frequency, whole[:, places][:, :, [places[1]]], ["1Y", "2Y", "3Y", "5Y", "6Y", "7Y"], ["2Y"]
    )
    first, *_ = found.causes
    assert (first.kind, first.where) == ("spring", ("0RZ",))
    assert first.chi_square_per_dof == pytest.approx(1.0, abs=0.15)


@pytest.mark.long
def test_an_added_mass_that_is_not_what_the_study_says_is_named_with_its_record(tmp_path):
    """Four storeys, bare and with 2 kg on the third that are 2.6 in truth; one record has nothing to be compared with."""
    stiffness, k = [9000.0, 8000.0, 7000.0, 6000.0], np.zeros((4, 4), complex)
    k[0, 0] = 9000.0
    for i, c in enumerate(stiffness[1:]):
        k[i : i + 2, i : i + 2] += c * np.array([[1, -1], [-1, 1]])
    frequency = np.linspace(1.0, 16.0, 120)
    rng, text = np.random.default_rng(5), FLOORS
    for name, extra in (("bare", 0.0), ("loaded", 2.6)):
        mass = np.diag([5.0, 5.0, 5.0 + extra, 5.0])
        omega = 2 * np.pi * frequency[:, None, None]
        values = np.linalg.inv(k * (1 + 0.02j) - omega**2 * mass)[:, :, 1:2]
        noise = (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape)) / np.sqrt(2)
        values = values + noise * np.hypot(0.01 * np.abs(values), 2e-7)
        write_record(
            tmp_path / f"{name}.npz", FrfRecord(frequency, values, ["1X", "2X", "3X", "4X"], ["2X"], "receptance")
        )
        text += (
            f'[[record]]\nname = "{name}"\npath = "{name}.npz"\n\n[record.noise]\nrelative = 0.01\nabsolute = 2e-7\n\n'
        )
        if extra:
            text += '[[record.structure.point_mass]]\nname = "known"\nnodes = 3\nmass = 2.0\n'
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    ready = prepare_study(load_study(tmp_path / "study.toml"))
    found = diagnose_study(ready, run_prepared(ready))[0].diagnosis
    first, *_ = found.causes
    assert (first.kind, first.where) == ("mass", ("3", "loaded"))
    assert first.words == "a mass at node 3 is missing in the model in record loaded"
    [(name, value, _)] = first.found
    assert (name, value) == ("mass[mass 3 loaded]", pytest.approx(0.6, rel=0.05))
    assert first.chi_square_per_dof == pytest.approx(1.0, abs=0.15)
    assert "+ [[record.structure.point_mass]]" in first.lines


MOUNTS = (
    FLOORS[: FLOORS.index("[[structure.spring]]")]
    + "".join(
        f'[[structure.spring]]\nname = "storey {k}"\n{ends}\nstiffness = {stiffness}\nloss_factor = 0.02\n\n'
        for k, ends, stiffness in (
            (1, 'first = "1X"', 8300.0),
            (2, 'first = "1X"\nsecond = "2X"', 7400.0),
            (3, 'first = "2X"\nsecond = "3X"', 6500.0),
            (4, 'first = "3X"\nsecond = "4X"', 5600.0),
        )
    )
    + '[[unknown]]\nproperty = "mass"\nelements = "floors"\n\n'
    + '[[unknown]]\nproperty = "stiffness"\nelements = ["storey 1", "storey 2", "storey 3", "storey 4"]\nfactor = true\n'
)


@pytest.mark.long
def test_a_set_that_is_tied_to_others_and_differs_from_them_is_named_first(tmp_path):
    """Four storeys of one factor, each a set of its own; the third is a third softer than the drawings say."""
    stiffness, k = [9130.0, 8140.0, 7150.0 * 0.65, 6160.0], np.zeros((4, 4))
    k[0, 0] = stiffness[0]
    for i, c in enumerate(stiffness[1:]):
        k[i : i + 2, i : i + 2] += c * np.array([[1, -1], [-1, 1]])
    frequency = np.linspace(1.0, 16.0, 120)
    omega = 2 * np.pi * frequency[:, None, None]
    receptance = np.linalg.inv(k * (1 + 0.02j) - omega**2 * 5.0 * np.eye(4))[:, :, 1:2]
    found = answered(tmp_path, MOUNTS, frequency, receptance, ["1X", "2X", "3X", "4X"], ["2X"])
    first, *_ = found.causes
    assert (first.kind, first.where) == ("untied", ("storey 3",))
    assert first.words == "the stiffness of all of storey 3 is not that of its group"
    [(name, value, unit)] = first.found
    assert (name, value, unit) == ("stiffness[storey 3]", pytest.approx(0.65 * 1.1, rel=0.02), "1")
    assert first.chi_square_per_dof == pytest.approx(1.0, abs=0.15)
    assert '+ elements = ["storey 1", "storey 2", "storey 4"]' in first.lines
