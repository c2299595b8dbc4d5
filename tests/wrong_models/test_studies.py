"""The studies themselves: structid reads every one as it was meant, and finds the simulator's responses at the true values."""

import json
import math
import tomllib

import numpy as np
import pytest
from typer.testing import CliRunner
from wrong_models.assembly import assembled, shaken
from wrong_models.cases import ALIASES, DEVELOPMENT, FRESH, HELD_OUT, SETS, cases
from wrong_models.faults import FAULTS, Fault, Readings
from wrong_models.measuring import RELATIVE, measured
from wrong_models.response import frf
from wrong_models.rigs import RIGS
from wrong_models.study_files import MODES_COMMAND, Case, written
from wrong_models.telling_apart import can_look_into, told_apart

from structid.cli import app as cli
from structid.forward import simulated_record
from structid.identification.setups.time import frfs_of
from structid.modal.formats.files import read_modes
from structid.records.formats import ReadOptions, read_record
from structid.study.run.run import run_prepared
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study
from wrong_models import record_files

ELEMENTS = [rig for rig, made in RIGS.items() if not made().exported]  # matrices come with loss factors
EVERY = [one for which in SETS for one in cases(which)]


TESTS = [
    *((rig, "frf2" if "base" not in RIGS[rig]().table else "shaken") for rig in RIGS),
    *((rig, "time" if "base" not in RIGS[rig]().table else "quake") for rig in ELEMENTS),
]


@pytest.mark.parametrize("rig, record", TESTS)
def test_structid_finds_the_same_responses_at_the_true_values(tmp_path, rig, record):
    case = Case(f"{rig} as it is", rig, record, start="far")
    made = case.measured_rig()
    truth = written(case, tmp_path)["parameters"]
    [setup] = prepare_study(load_study(tmp_path / "study.toml")).setups
    assert list(truth) == list(setup.parameters.names)
    at_truth = setup.parameters.started_at(np.array(list(truth.values())))
    read = setup.record if record in ("frf2", "shaken") else frfs_of(setup.record)
    found = simulated_record(setup.structure, at_truth, read).values
    loads = [str(dof).rstrip("+") for dof in read.inputs]
    system = assembled(shaken(made.table) if "base" in made.table else made.table)
    own = frf(system, read.frequency, [{s: 1.0} for s in made.sensors], loads, made.kind)
    assert abs(found - own).max() < 1e-8 * abs(own).max()
    off = abs(setup.parameters.start / np.array(list(truth.values())) - 1)
    assert off.min() > 0.13


@pytest.mark.parametrize("suffix", ["npz", "mat", "csv", "uff"])
def test_files_hold_the_readings(tmp_path, suffix):
    rig, rng = RIGS["portal"](), np.random.default_rng(0)
    made = measured(rig, rig.table, "frf2", [], rng)
    section = record_files.frf_file(tmp_path / f"frf.{suffix}", made, rig.kind)
    options = {key: tuple(v) if isinstance(v, list) else v for key, v in section.items() if key != "path"}
    read = read_record(tmp_path / section["path"], ReadOptions(**options))
    np.testing.assert_allclose(read.values, made.motion, rtol=1e-9)
    np.testing.assert_allclose(read.frequency, made.axis, rtol=1e-12)
    assert [str(dof) for dof in read.outputs] == [f"{s}+" for s in made.sensors]
    force = rng.standard_normal((64, 1))
    motion = rng.standard_normal((64, len(rig.sensors)))
    history = Readings(np.arange(64) / 200, motion, list(rig.sensors), [rig.loads[0]], force)
    section = record_files.history_file(tmp_path / f"time.{suffix}", history, "velocity")
    options = {key: tuple(v) if isinstance(v, list) else v for key, v in section.items() if key != "path"}
    read = read_record(tmp_path / section["path"], ReadOptions(**options))
    np.testing.assert_allclose(read.values, np.hstack([force, motion]), rtol=1e-9)
    assert read.quantities == ("force", *["velocity"] * 5)
    assert read.sampling_rate == pytest.approx(200)


@pytest.mark.parametrize("seed", [0, 1])
def test_modes_hold_the_shapes(tmp_path, monkeypatch, seed):
    monkeypatch.setattr(Case, "seed", property(lambda self: seed))
    written(Case("m", "portal", "modal"), tmp_path)
    [setup] = prepare_study(load_study(tmp_path / "study.toml")).setups
    made = measured(RIGS["portal"](), RIGS["portal"]().table, "modal", [], np.random.default_rng(0), noisy=False)
    assert [str(dof) for dof in setup.record.channels] == [f"{s}+" for s in made.sensors] or seed == 0
    np.testing.assert_allclose(setup.record.frequency, made.axis, rtol=0.006)
    order = [[str(dof).rstrip("+") for dof in setup.record.channels].index(s) for s in made.sensors]
    mac = [
        abs(a @ b) ** 2 / (a @ a) / (b @ b) for a, b in zip(setup.record.mode_shapes[order].T, made.motion, strict=True)
    ]
    assert min(mac) > 0.995


@pytest.mark.parametrize("name", ["tower-modal-far-twin", "tower again"])
def test_modes_that_have_to_cross_on_the_way_are_found(tmp_path, name):
    """Paired by shapes alone, searches from the start end where the sixth measured mode has the seventh of the model."""
    truth = written(Case(name, "tower", "modal", start="far"), tmp_path)["parameters"]
    ready = prepare_study(load_study(tmp_path / "study.toml"))
    estimate = run_prepared(ready).identification.estimate
    assert estimate.chi_square_per_dof < 1.5
    off = (estimate.values - [truth[one] for one in estimate.names]) / estimate.std
    assert np.abs(off).max() < 3.5


def test_the_sets_are_large_enough_and_share_no_structure():
    for which in ("development", "heldout"):
        chosen = cases(which)
        count = [sum(len(one.faults) == n and not one.harmless for one in chosen) for n in (1, 2)]
        assert count[0] >= 60
        assert count[1] >= 20
        assert sum(one.is_twin for one in chosen) >= 60
    assert len(DEVELOPMENT) >= 6
    assert len(HELD_OUT) >= 4
    assert len({*DEVELOPMENT, *HELD_OUT, *FRESH}) == len(DEVELOPMENT) + len(HELD_OUT) + len(FRESH)
    assert len({one.name for one in EVERY}) == len(EVERY)
    assert {fault.kind for one in cases("development") for fault in one.faults} == set(FAULTS)


def test_every_fault_can_be_seen_and_small_ones_do_not_matter():
    found = json.loads(ALIASES.read_text())
    looked = [one for one in EVERY if can_look_into(one)]
    assert set(found) == {one.name for one in looked}
    for one in (one for one in looked if one.name in found):
        if one.harmless:
            assert found[one.name]["bias"] < 0.01, one.name
        else:
            assert found[one.name]["chi_square"] > 60, one.name


@pytest.mark.long
def test_a_joint_looks_like_that_of_the_next_element():
    one = Case("j", "two_span", "frf", (Fault("joint", "left:3/4RZ", "800"),))
    found = told_apart(one)
    assert ["joint", "left:4 4"] in found["aliases"]
    assert found["chi_square"] > 1e6
    assert found["bias"] > 0.05


def test_noise_is_what_the_study_says(tmp_path):
    rig = RIGS["truss"]()
    clean = measured(rig, rig.table, "frf", [], np.random.default_rng(0), noisy=False).motion
    noisy = measured(rig, rig.table, "frf", [], np.random.default_rng(1)).motion
    size = RELATIVE * abs(clean)
    strong = abs(clean) > 0.3 * abs(clean).max()
    assert (abs(noisy - clean)[strong] ** 2).mean() == pytest.approx((size[strong] ** 2).mean(), rel=0.15)
    stated = []
    for name, faults in (("plain", ()), ("small", (Fault("noise_level", "any", "0.1"),))):
        written(Case(name, "truss", "frf", faults), tmp_path / name)
        stated.append(tomllib.loads((tmp_path / name / "study.toml").read_text())["record"]["noise"])
    assert stated[0]["relative"] == 0.01
    assert stated[0]["absolute"] == pytest.approx(3e-4 * np.sqrt((abs(clean) ** 2).mean()), rel=0.02)
    for key in ("relative", "absolute"):
        assert stated[1][key] == pytest.approx(0.1 * stated[0][key], rel=0.02)


@pytest.mark.parametrize(
    "fault, check",
    [
        ("sensor_gain 4X 1.5", lambda a, b: np.allclose(b[:, 0], 1.5 * a[:, 0]) and np.array_equal(b[:, 1:], a[:, 1:])),
        ("load_gain 4X 2", lambda a, b: np.allclose(b, a / 2)),
        ("swap 4X 7Y", lambda a, b: np.array_equal(b[:, 0], a[:, 2]) and np.array_equal(b[:, 2], a[:, 0])),
        ("polarity 2X", lambda a, b: np.array_equal(b[:, 3], -a[:, 3])),
        ("delay 4X 1e-3", lambda a, b: np.allclose(np.angle(b[0, 0] / a[0, 0]), -2 * math.pi * 2 * 1e-3)),
        ("unit all 9.80665", lambda a, b: np.allclose(b, 9.80665 * a)),
    ],
)
def test_faults_of_channels(fault, check):
    rig = RIGS["portal"]()
    plain, wrong = (
        measured(rig, rig.table, "frf", faults, np.random.default_rng(0), noisy=False).motion
        for faults in ([], [Fault(*fault.split())])
    )
    assert check(plain, wrong)


def test_a_sensor_that_points_elsewhere():
    rig = RIGS["portal"]()
    straight, turned = (
        measured(rig, rig.table, "frf", faults, np.random.default_rng(0), noisy=False)
        for faults in ([], [Fault("direction", "5Y", "X@30")])
    )
    across = frf(assembled(rig.table), straight.axis, [{"5X": 1.0}], ["4X"], rig.kind)[:, 0]
    np.testing.assert_allclose(turned.motion[:, 1], np.sqrt(0.75) * straight.motion[:, 1] + 0.5 * across, rtol=1e-9)


@pytest.mark.long
def test_the_edge_of_ambient_forces_is_no_mode(tmp_path, monkeypatch):
    """Forces that end at 150 Hz leave two stable poles there, whose channels move in no one phase."""
    [case] = [one for one in EVERY if one.name == "portal-ambient-near-twin"]
    written(case, tmp_path)
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(cli.app, json.loads((tmp_path / MODES_COMMAND).read_text()))
    assert done.exit_code == 0, done.output
    found = read_modes(tmp_path / "modes" / "modes.json")
    assert found.n_modes == 8
    assert found.frequency.max() < 120
    assert "without a shape in one phase" in done.stdout
    assert "148.4" in done.stdout
