"""Measured components in a study file: read, identified, told of, explained, and what is refused with its place."""

import json
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from measured_cases import BENDING, FREQUENCY, MOUNT, NODES, asked, beam_on_machine, machine_receptance
from structid import FrfRecord, PointMass, TimeRecord, Unknown, parameters, simulated_record
from structid.cli.app import app
from structid.records import write_record
from structid.study.run.run import run_study
from structid.study.run.start import prepare_study
from structid.study.schema.study import edited_study, load_study

STUDY = """
title = "A beam that carries a machine"
[structure]
subdivide = 1  # the records are simulated with these elements
active = ["Y", "RZ"]
fixed = ["0 Y RZ"]
[structure.nodes]
NODES
[[structure.beam]]
name = "beam"
nodes = [[0, 1], [1, 2], [2, 3], [3, 4]]
mass = 3.0
bending_stiffness = 1600.0
loss_factor = 0.02
[[structure.spring]]
name = "mount"
first = ["2Y", "4Y"]
second = ["11Y", "12Y"]
stiffness = [3.6e4, 4.2e4]
loss_factor = 0.05

[[structure.measured_component]]
name = "machine"
path = "machine.npz"
relabel = { "101Y" = "11Y", "load 101Y" = "11Y", "102Y" = "12Y-", "load 102Y" = "12Y-" }
interface = ["11Y", "12Y"]

[[unknown]]
property = "stiffness"
elements = "mount"
each = true
[[unknown]]
property = "bending_stiffness"
elements = "beam"

[record]
path = "frf.npz"
[record.noise]
relative = 0.01
""".replace("NODES", "\n".join(f"{label} = {place}" for label, place in NODES.items()))
UNKNOWNS = [Unknown("stiffness", "mount", each=True), Unknown("bending_stiffness", "beam")]
PATH = 'path = "machine.npz"'
INTERFACE = 'interface = ["11Y", "12Y"]\n'
RELABEL = next(line for line in STUDY.splitlines() if line.startswith("relabel")) + "\n"


def machine_record(**changes) -> FrfRecord:
    """Accelerances of the machine, one of whose places looks the other way and both of which have names of their own."""
    s = 2j * np.pi * FREQUENCY[:, None, None]
    values = machine_receptance() * s**2 * np.array([[1, -1], [-1, 1]])
    given = {"frequency": FREQUENCY, "values": values, "outputs": ["101Y", "102Y"], "inputs": ["101Y", "102Y"]}
    return FrfRecord(**{**given, "kind": "accelerance", **changes})


@pytest.fixture
def folder(tmp_path):
    write_record(tmp_path / "machine.npz", machine_record())
    true = beam_on_machine()
    unknown = parameters(true, UNKNOWNS)
    like = asked(outputs=("1Y", "3Y", "4Y"), kind="accelerance")
    write_record(tmp_path / "frf.npz", simulated_record(true, unknown, like, 0.01, np.random.default_rng(1)))
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    return tmp_path


def run(*arguments: object):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def changed(folder, *pairs: tuple[str, str]):
    text = STUDY
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    (folder / "study.toml").write_text(text, encoding="utf-8")
    return folder / "study.toml"


def refused(folder, *pairs: tuple[str, str]) -> str:
    done = run("check", changed(folder, *pairs))
    assert done.exit_code == 2, done.output
    assert done.exception is None or isinstance(done.exception, SystemExit)
    return " ".join((done.output + done.stderr).split())


def test_stated_noise_of_a_component_is_in_the_intervals(folder):
    write_record(folder / "machine.npz", machine_record())
    plain = run_study(load_study(folder / "study.toml")).identification
    noisy = changed(folder, (INTERFACE, INTERFACE + "noise = { relative = 0.05 }\n"))
    study = load_study(noisy)
    [component] = study.structure.measured
    assert component.variance == pytest.approx((0.05 * np.abs(component.receptance)) ** 2)
    found = run_study(study).identification
    assert (found.estimate.std_noise > 1.5 * plain.estimate.std_noise).all()
    assert not any("not in the intervals" in words for words in found.warnings)


def test_a_whole_study(folder, monkeypatch):
    monkeypatch.chdir(folder)
    checked = run("check", "study.toml")
    assert checked.exit_code == 0, checked.output
    assert "the model has no modes without measured component 'machine' (machine.npz)" in " ".join(
        checked.output.split()
    )
    done = run("identify", "study.toml")
    assert done.exit_code == 0, done.output
    found = json.loads((folder / "study_results" / "estimate.json").read_text(encoding="utf-8"))
    assert found["verdict"] == "sound"
    mesh, warning = found["warnings"]
    assert mesh.startswith("the mesh moves ")  # the record is of as coarse a beam
    assert "errors of its FRFs are not in the intervals" in warning
    values = {one["name"]: one for one in found["parameters"]}
    for name, true in zip(values, [*MOUNT, BENDING], strict=True):
        assert abs(values[name]["value"] - true) < 4 * values[name]["std"]
    assert set(found["provenance"]["inputs"]) == {"study.toml", "machine.npz", "frf.npz"}
    page = (folder / "study_results" / "report.html").read_text(encoding="utf-8")
    assert "A beam that carries a machine" in page


@pytest.mark.long
def test_a_missing_mass_is_found_beside_the_machine(folder, monkeypatch):
    monkeypatch.chdir(folder)
    true = beam_on_machine()
    true = replace(true, elements=[*true.elements, PointMass("forgotten", [3], mass=0.8)])
    like = asked(outputs=("1Y", "3Y", "4Y"), kind="accelerance", frequency=FREQUENCY[::2])
    record = simulated_record(true, parameters(true, UNKNOWNS), like, 0.01, np.random.default_rng(2))
    write_record(folder / "frf.npz", record)
    done = run("explain", "study.toml")
    assert done.exit_code == 3, done.output
    assert "a mass at node 3 is missing in the model" in " ".join(done.output.split())
    again = run("identify", "study_results/suggestions/1-mass-3.toml", "--no-report")
    assert again.output.startswith("Sound"), again.output


def test_a_record_without_the_machine_and_one_with_it(folder):
    bare = beam_on_machine([], mount=MOUNT)
    like = asked(outputs=("1Y", "11Y"), kind="mobility")
    bare = replace(bare, elements=[*bare.elements, PointMass("still", [11, 12], mass=1.0)])
    write_record(
        folder / "bare.npz", simulated_record(bare, parameters(bare, UNKNOWNS), like, 0.01, np.random.default_rng(3))
    )
    record = STUDY[STUDY.index("[record]") :]
    other = """
[[record]]
path = "bare.npz"
[record.structure]
without = "machine"
[[record.structure.point_mass]]
name = "dummies"
nodes = [11, 12]
mass = 1.0
[record.noise]
relative = 0.01
"""
    found = run_study(
        load_study(changed(folder, (record, record.replace("[record]", "[[record]]") + other)))
    ).identification
    first, second = found.problems
    assert first.structure.measured
    assert not second.structure.measured
    assert np.abs((found.estimate.values - [*MOUNT, BENDING]) / found.estimate.std).max() < 4
    assert found.estimate.chi_square_per_dof == pytest.approx(1.0, abs=0.1)


def test_what_holds_of_a_component_is_said_once_for_all_records(folder):
    record = STUDY[STUDY.index("[record]") :].replace("[record]", "[[record]]")
    path = changed(folder, (STUDY[STUDY.index("[record]") :], f"{record}\n{record}"))
    for warnings in (run_study(load_study(path)).identification.warnings, prepare_study(load_study(path)).warnings):
        [words] = [one for one in warnings if "masses told are without it" in one]
        assert words.startswith("measured component 'machine'")


def test_a_component_is_read_once_for_all_that_is_made_of_a_study(folder):
    """Its file is read again where it, or the component's table, is another."""
    study = load_study(folder / "study.toml")
    [own] = study.structure.measured

    def edited(of, change):
        tables = deepcopy(dict(of.root.table))
        change(tables["structure"])
        return edited_study(of, tables)

    def stiffer(structure):
        structure["beam"][0]["bending_stiffness"] *= 1.1

    once = edited(study, stiffer)
    twice = edited(once, stiffer)
    assert once.structure is not study.structure
    assert once.structure.measured[0] is twice.structure.measured[0] is own
    assert twice.digests == study.digests
    turned = edited(study, lambda structure: structure["measured_component"][0].update(interface=["12Y", "11Y"]))
    np.testing.assert_array_equal(turned.structure.measured[0].receptance[:, 0, 0], own.receptance[:, 1, 1])
    write_record(folder / "machine.npz", machine_record(values=2 * machine_record().values))
    np.testing.assert_allclose(edited(study, stiffer).structure.measured[0].receptance, 2 * own.receptance)


def test_tables_of_other_programs_and_averaged_histories_are_read_as_records_are(folder):
    write_record(folder / "machine.uff", machine_record())
    relabelled = (PATH, 'path = "machine.uff"')
    assert load_study(changed(folder, relabelled)).structure.measured[0].source == "machine.uff"
    own = load_study(changed(folder, relabelled)).structure.measured[0]
    np.testing.assert_allclose(own.receptance, machine_receptance(), rtol=1e-4, atol=1e-12)


def test_what_is_no_component_is_refused_with_its_place(folder):
    place = "[[structure.measured_component]]"
    row = machine_record(values=machine_record().values[:, :, :1], outputs=["11Y", "12Y"], inputs=["11Y"])
    write_record(folder / "row.npz", row)
    words = refused(folder, (PATH, 'path = "row.npz"'), (RELABEL, ""))
    assert (
        f'study.toml, line 31: {place} "machine" interface: row.npz has no input 12Y: a component needs FRFs' in words
    )
    assert "no input 12Y" in refused(folder, (PATH, 'path = "row.npz"'), (RELABEL, ""), (INTERFACE, ""))
    assert "node 13 does not exist" in refused(folder, (INTERFACE, 'interface = ["11Y", "13Y"]\n'))
    aside = (RELABEL, RELABEL.replace('"11Y"', '"11X"')), (INTERFACE, 'interface = "11X"\n')
    words = refused(folder, *aside)
    assert "node 11 moves in 11Y+; join the component to" in words
    assert f'{place} "machine"' in words
    write_record(folder / "ratio.npz", machine_record(kind="transmissibility"))
    assert "transmissibility cannot become receptance" in refused(folder, (PATH, 'path = "ratio.npz"'))
    short = machine_record(frequency=FREQUENCY[:90], values=machine_record().values[:90])
    write_record(folder / "short.npz", short)
    assert "(short.npz) was measured from 2 to 77.554 Hz" in refused(folder, (PATH, 'path = "short.npz"'))
    inside = "relative = 0.01\n[method]\nband = [2.0, 70.0]\nevaluation_band = [2.0, 80.0]\n"
    words = refused(folder, (PATH, 'path = "short.npz"'), ("relative = 0.01\n", inside))
    assert "(short.npz) was measured from 2 to 77.554 Hz, and a line lies at 78.4029 Hz" in words
    write_record(folder / "same.npz", machine_record(values=machine_record().values[:, :1, :1] * np.ones((2, 2))))
    assert "(same.npz): the condition number of its FRFs" in refused(folder, (PATH, 'path = "same.npz"'))
    history = TimeRecord(
        100.0, np.random.default_rng(0).standard_normal((500, 2)), ["11Y", "11Y"], ["acceleration", "force"]
    )
    write_record(folder / "history.npz", history)
    words = refused(folder, (PATH, 'path = "history.npz"'), (RELABEL, ""))
    assert "the record holds time histories; add [structure.measured_component.frf], as in" in words
    assert "nowhere.npz: there is no such file" in refused(folder, (PATH, 'path = "nowhere.npz"'))
    assert "unknown key" in refused(folder, (PATH, PATH + "\nwindow_decay = 3"))


def test_what_needs_lines_beside_those_of_the_record_is_refused_with_it(folder):
    path = 'path = "frf.npz"\n'
    words = refused(folder, (path, path + 'leakage = "hann"\n'))
    assert "is known by its FRFs alone, which leakage of segments cannot be computed with; leave `leakage` out" in words
    words = refused(
        folder, ("[record.noise]", '[[record.channel_error]]\nproperty = "window_decay"\nstart = 1.0\n[record.noise]')
    )
    assert "alone, which a window's decay cannot be computed with; correct the record for it, or take a model" in words


def test_records_of_histories_and_modes_are_refused_with_it(folder):
    rng = np.random.default_rng(0)
    history = TimeRecord(400.0, rng.standard_normal((2000, 2)), ["1Y", "3Y"], ["acceleration", "force"])
    write_record(folder / "frf.npz", history)
    noise = "[record.noise]\nrelative = 0.01\n"
    for fit in ("spectra", "output_error"):
        words = refused(folder, (noise, f'[record.time]\nfit = "{fit}"\nnoise = 0.1\n'))
        assert "is known by its FRFs alone, which histories cannot be computed with" in words
    (folder / "modes.csv").write_text("frequency,damping_ratio,1Y,3Y\n5.4,0.01,0.4,1.0\n", encoding="utf-8")
    words = refused(
        folder,
        ('path = "frf.npz"', 'path = "modes.csv"'),
        (noise, "[record.modes]\nfrequency_std = 0.01\nshape_std = 0.1\n"),
    )
    assert "which modes cannot be computed with" in words
