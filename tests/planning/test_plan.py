"""Plans: predictions against the dense bound, choices against all choices, and the command as a user meets it."""

import json
import re
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import structid as sid
from structid import InputError
from structid.cli.app import app
from structid.core.dof import parse_dofs
from structid.core.errors import SingularModelError
from structid.forward.frf.response import response
from structid.planning.plan import PlanOptions, plan
from structid.records.formats import read_record, write_record
from structid.reproduce.chapter_4 import CASE_2, GRID, TIP, Noise, Reading, cantilever, hertz_of, noisy_record
from structid.study.schema.plan import load_plan, planned
from structid.unknowns.priors import priors_of
from structid.unknowns.tolerances import EXACT, Tolerances
from study_cases import CHAIN, RIGID, chain_record, replaced, write_chain

DEFLECTIONS = parse_dofs([f"{n}Y" for n in range(1, 7)])
TARGET = 5e-3
LINES = tuple(np.linspace(0.02, 1.5, 40))
PLAN = """
[plan]
sensors = ["1X", "2X", "3X"]
loads = ["3X", "1X"]
kind = "accelerance"
band = [0.5, 12.0]
n_lines = 60
[plan.noise]
relative = 0.01
absolute = 0.001
"""
WITHOUT_RECORD = CHAIN[: CHAIN.index("[record]")]


def beam_unknowns(structure):
    return sid.parameters(structure, [sid.Unknown(p, "beam", each=True) for p in ("mass", "bending_stiffness")])


@pytest.fixture(scope="module")
def beam():
    structure = cantilever(CASE_2.actual)
    return structure, beam_unknowns(structure)


def beam_options(**changes):
    given = {
        "sensors": DEFLECTIONS,
        "loads": parse_dofs(["6Y", "3Y"]),
        "kind": "mobility",
        "relative_noise": 0.01,
        "absolute_noise": 1e-3,
        "n_sensors": 2,
        "n_loads": 1,
    }
    return PlanOptions(LINES, **{**given, **changes})


def dense_std(structure, unknown, test, options):
    """Its standard deviations."""
    return np.sqrt(np.diag(dense_covariance(structure, unknown, test, options)))


def dense_covariance(structure, unknown, test, options):
    """The bound from the whole whitened Jacobian of a record at the model's own values."""
    blank = np.ones((len(test.frequency), len(test.sensors), len(test.loads)))
    record = sid.FrfRecord(test.frequency, blank, test.sensors, test.loads, options.kind)
    record = sid.simulated_record(structure, unknown, record)
    record = sid.with_declared_noise(record, options.relative_noise, options.absolute_noise)
    problem = sid.FrfProblem(structure, unknown, record)
    jacobian = problem.linearize(problem.theta_start).jacobian
    return np.linalg.inv(jacobian.T @ jacobian)  # theta is the logarithm, so this is relative


def test_predictions_are_the_dense_bound(beam):
    found = plan(*beam, beam_options(n_frequencies=25))
    assert len(found.tests) == 6
    for test in found.tests:
        assert test.std == pytest.approx(dense_std(*beam, test, found.options), rel=1e-6)


def held_at_both_ends():
    """Three masses between two bases, with every stiffness and damping unknown."""
    first, second = [f"{i}X" for i in range(4)], [f"{i}X" for i in range(1, 5)]
    structure = sid.Structure(
        {i: float(i) for i in range(5)},
        [
            sid.PointMass("m", [1, 2, 3], 2.0),
            sid.Spring("k", first, second, stiffness=[900.0, 1000.0, 1100.0, 800.0]),
            sid.Dashpot("c", first, second, viscous_damping=[0.8, 1.0, 0.7, 0.9]),
        ],
        fixed=["0X", "4X"],
        active=["X"],
        bases=[sid.Base("left", "0X"), sid.Base("right", "4X")],
    )
    kinds = ("stiffness", "k"), ("viscous_damping", "c")
    return structure, sid.parameters(structure, [sid.Unknown(p, e, each=True) for p, e in kinds])


def transmissibilities(values, frequency):
    """Motion of the masses per motion of each base, written out, (n_lines, 3, 2)."""
    k, c = values[:4], values[4:]
    s = 2j * np.pi * np.asarray(frequency)
    link = k[:, None] + c[:, None] * s
    whole = np.zeros((len(s), 5, 5), dtype=complex)
    for i in range(4):
        whole[:, i : i + 2, i : i + 2] += link[i][:, None, None] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    inner = whole[:, 1:4, 1:4] + (s**2)[:, None, None] * 2.0 * np.eye(3)
    return -np.linalg.solve(inner, whole[:, 1:4][:, :, [0, 4]])


@pytest.mark.parametrize("chunk", [48_000_000, 1])
def test_predictions_for_driven_supports_are_those_of_the_equations_written_out(chunk, monkeypatch):
    monkeypatch.setattr("structid.planning.plan._CHUNK_BYTES", chunk)
    structure, unknown = held_at_both_ends()
    options = PlanOptions(
        tuple(np.linspace(0.5, 9.0, 60)), kind="transmissibility", relative_noise=0.02, absolute_noise=0.01, n_loads=2
    )
    found = plan(structure, unknown, options)
    assert [str(dof) for dof in found.options.loads] == ["0X+", "4X+"]
    test = found.everything
    start = np.array(unknown.start)
    size = np.abs(transmissibilities(start, test.frequency))
    noise = np.hypot(0.02 * size, 0.01) / np.sqrt(2)
    rows = []
    for i in range(len(start)):
        step = 1e-6 * start[i] * np.eye(len(start))[i]
        up, down = (transmissibilities(start + sign * step, test.frequency) for sign in (1, -1))
        change = (up - down) / 2e-6 / noise
        rows.append(np.concatenate([change.real.ravel(), change.imag.ravel()]))
    jacobian = np.array(rows).T
    assert test.std == pytest.approx(np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian))), rel=1e-6)


def test_transmissibility_without_a_base_is_refused(beam):
    with pytest.raises(InputError, match=r"add a \[\[structure.base\]\]"):
        plan(*beam, beam_options(kind="transmissibility", loads=()))


@pytest.mark.parametrize("record", [True, False])
def test_a_study_that_supports_drive_is_planned(tmp_path, record):
    """The shaken building: its record gives the base, and so does [plan] without one."""
    example = Path(__file__).parents[2] / "examples" / "shaken_building"
    text = (example / "study.toml").read_text(encoding="utf-8").replace("record.csv", str(example / "record.csv"))
    if not record:
        text = text[: text.index("[record]")] + '[plan]\nloads = ["0X"]\nband = [0.5, 18.0]\n'
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    found = planned(load_plan(tmp_path / "study.toml"))
    assert found.options.kind == "transmissibility"
    assert [str(dof) for dof in found.chosen.loads] == ["0X+"]
    assert found.determined


@pytest.mark.parametrize(
    ("key", "named", "words"),
    [
        ("sensors", '"2X", "0X"', "sensors: 0X+ is held at zero by the supports"),
        ("installed_sensors", '"0X"', "installed_sensors: 0X+ is held at zero by the supports"),
        ("loads", '"0X", "2X"', "loads: 2X+ is a force, and others are motions of supports"),
    ],
)
def test_only_loads_may_be_supports_that_drive(tmp_path, key, named, words):
    text = (Path(__file__).parents[2] / "examples" / "shaken_building" / "study.toml").read_text(encoding="utf-8")
    text = text[: text.index("[record]")] + f"[plan]\nband = [0.5, 18.0]\n{key} = [{named}]\n"
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(f"[plan] {words}")):
        load_plan(tmp_path / "study.toml")


def test_predictions_do_not_depend_on_stretches(beam, monkeypatch):
    whole = plan(*beam, beam_options(n_frequencies=25))
    monkeypatch.setattr("structid.planning.plan._CHUNK_BYTES", 1)
    pieces = plan(*beam, beam_options(n_frequencies=25))
    for one, other in zip(whole.tests, pieces.tests, strict=True):
        assert one.sensors == other.sensors
        assert one.std == pytest.approx(other.std, rel=1e-8)


@pytest.mark.parametrize("criterion", ["d", "a"])
def test_chosen_places_are_the_best_of_all(beam, criterion):
    structure, unknown = beam
    options = beam_options(criterion=criterion)
    found = plan(structure, unknown, options)

    def score(sensors, load):
        covariance = dense_covariance(
            structure, unknown, replace(found.chosen, sensors=sensors, loads=(load,)), options
        )
        return np.linalg.slogdet(covariance)[1] if criterion == "d" else np.trace(covariance)

    scores = {
        (frozenset(pair), load): score(pair, load)
        for pair in combinations(DEFLECTIONS, 2)
        for load in parse_dofs(["6Y", "3Y"])
    }
    assert min(scores, key=scores.get) == (frozenset(found.chosen.sensors), found.chosen.loads[0])


def test_nuisance_parameters_stay_unknown_but_do_not_count(beam):
    structure, unknown = beam
    found = plan(structure, unknown, beam_options(of_interest=["mass", "bending_stiffness[beam:6]"], n_sensors=1))
    assert found.chosen.of_interest.tolist() == [True] * 6 + [False] * 5 + [True]
    assert found.chosen.std == pytest.approx(dense_std(structure, unknown, found.chosen, found.options), rel=1e-6)
    std = found.chosen.std[found.chosen.of_interest]
    assert found.chosen.worst_std == std.max()
    assert found.chosen.rms_std == pytest.approx(np.sqrt(np.mean(std**2)))


def test_places_for_parameters_of_interest_are_the_best_of_all(beam):
    structure, unknown = beam
    options = beam_options(of_interest=["mass[beam:1]", "mass[beam:6]"], n_sensors=1)
    found = plan(structure, unknown, options)
    counts = found.chosen.of_interest

    def score(sensor, load):
        test = replace(found.chosen, sensors=(sensor,), loads=(load,))
        return np.linalg.slogdet(dense_covariance(structure, unknown, test, options)[np.ix_(counts, counts)])[1]

    scores = {(s, i): score(s, i) for s in DEFLECTIONS for i in parse_dofs(["6Y", "3Y"])}
    assert min(scores, key=scores.get) == (found.chosen.sensors[0], found.chosen.loads[0])
    every = plan(structure, unknown, beam_options(n_sensors=1)).chosen
    assert (every.sensors, every.loads) != (found.chosen.sensors, found.chosen.loads)


def test_priors_add_their_information(beam):
    structure, unknown = beam
    options = beam_options(n_sensors=1)
    without = plan(structure, unknown, options)
    mean = unknown.start[1]
    informed = replace(unknown, priors=priors_of(sid.Prior(mean, 1e-4 * mean) if i == 1 else None for i in range(12)))
    found = plan(structure, informed, options)
    assert found.chosen.std[1] < 1e-4
    assert found.chosen.std[1] == pytest.approx(
        dense_std(structure, informed, found.chosen, found.options)[1], rel=1e-6
    )
    assert (found.everything.std < without.everything.std).all()


def test_installed_sensors_come_before_and_one_more_is_better(beam):
    found = plan(*beam, beam_options(installed_sensors=parse_dofs(["6Y-"]), installed_loads=parse_dofs(["6Y"])))
    assert found.installed is not None
    assert found.installed.sensors == parse_dofs(["6Y-"])
    assert len(found.next_sensors) == 5
    for test in found.next_sensors:
        assert test.sensors[0] == parse_dofs(["6Y-"])[0]
        assert (test.std <= found.installed.std).all()
        assert (test.std >= found.everything.std * (1 - 1e-9)).all()


def test_next_sensor_is_the_best_of_all(beam):
    structure, unknown = beam
    options = beam_options(installed_sensors=DEFLECTIONS[5:], installed_loads=DEFLECTIONS[5:], criterion="a")
    found = plan(structure, unknown, options)
    traces = {}
    for sensor in DEFLECTIONS[:5]:
        test = replace(found.installed, sensors=(*found.installed.sensors, sensor))
        traces[sensor] = (dense_std(structure, unknown, test, found.options) ** 2).sum()
    assert found.next_sensors[0].sensors[-1] == min(traces, key=traces.get)
    ranked = [traces[test.sensors[-1]] for test in found.next_sensors]
    assert ranked == sorted(ranked)


def test_target_is_reached_by_the_fewest_taken_greedily(beam):
    found = plan(*beam, beam_options(n_sensors=1, target=TARGET))
    enough = found.enough
    assert enough.averages == pytest.approx((found.chosen.worst_std / TARGET) ** 2)
    assert enough.sensors.worst_std <= TARGET < found.chosen.worst_std
    assert enough.frequencies is None
    reached = plan(*beam, beam_options(n_sensors=3, target=0.01)).enough.frequencies
    assert reached.worst_std <= 0.01
    assert len(reached.frequency) < len(LINES)


def test_target_that_all_do_not_reach_has_no_smallest_set(beam):
    enough = plan(*beam, beam_options(target=1e-9)).enough
    assert enough.sensors is None
    assert enough.frequencies is None


def test_planned_lines_beat_lines_spread_evenly(beam):
    found = plan(*beam, beam_options(n_frequencies=20))
    assert len(found.frequencies.frequency) == len(found.spread.frequency) == 20
    assert found.frequencies.rms_std < 0.8 * found.spread.rms_std
    assert (found.frequencies.std >= found.chosen.std).all()


def test_bounds_of_the_single_sensor_are_those_of_the_reference(beam):
    """Chapter 4, case 2, 0.01 % real relative noise: 26 on the printed grid, 1.1e-3 in Hz, 6.9e-5 on 24 log-spaced lines."""
    tip = parse_dofs((TIP,))
    spread = tuple(np.geomspace(0.1, 60, 24) / (2 * np.pi))
    for lines, bound in ((hertz_of(*GRID), 26.0), (GRID, 1.13e-3), (spread, 6.9e-5)):
        options = PlanOptions(lines, tip, tip, kind="receptance", relative_noise=np.sqrt(2) * 1e-4)
        assert plan(*beam, options).chosen.rms_std == pytest.approx(bound, rel=5e-3)


def test_planned_lines_attain_their_bound(beam):
    """Four seeds from the printed start, 3 % off: squared errors in units of the predicted covariance."""
    tip = parse_dofs((TIP,))
    lines = tuple(np.geomspace(0.1, 60, 48) / (2 * np.pi))
    options = PlanOptions(lines, tip, tip, kind="receptance", relative_noise=np.sqrt(2) * 1e-4, n_frequencies=24)
    test = plan(*beam, options).frequencies
    assert test.rms_std < 1e-4
    structure = cantilever(CASE_2.postulated)
    errors = []
    for seed in range(4):
        reading = Reading("planned", tuple(test.frequency), (TIP,))
        record = noisy_record(CASE_2, reading, Noise(1e-4), np.random.default_rng(seed))
        record = sid.with_declared_noise(record, np.sqrt(2) * 1e-4, 0.0)
        found = sid.identify(structure, beam_unknowns(structure), record).estimate
        errors.append(found.values / CASE_2.actual - 1)
    ratio = np.sqrt(np.mean(np.square(errors) / test.std**2))
    assert 0.6 < ratio < 1.4  # 48 squares, correlated within each seed; 1 is expected


def test_printed_noisy_case_is_refused_with_its_bound():
    reading = Reading("printed", hertz_of(*GRID), (TIP,))
    record = noisy_record(CASE_2, reading, Noise(1e-4), np.random.default_rng(0))
    structure = cantilever(CASE_2.actual)
    found = sid.identify(
        structure, beam_unknowns(structure), sid.with_declared_noise(record, np.sqrt(2) * 1e-4, 0.0)
    ).estimate
    assert found.status is sid.Status.NOT_IDENTIFIABLE
    assert "at the initial values the Cramér-Rao bound is 2600 % of the value (RMS of 12 parameters)" in found.message


def test_friction_takes_one_load_at_a_time():
    masses = [sid.PointMass("m", [1, 2], [2.0, 2.0], directions=["X"])]
    springs = [sid.Spring("ground", "1X", stiffness=1e3, loss_factor=0.02), sid.Spring("up", "1X", "2X", stiffness=1e3)]
    pad = sid.Friction("pad", "1X", friction_force=0.02)
    structure = sid.Structure({1: 0.0, 2: 1.0}, [*masses, *springs, pad], active=["X"])
    unknown = sid.parameters(structure, [sid.Unknown("stiffness", "up"), sid.Unknown("friction_force", "pad")])
    options = PlanOptions(tuple(np.linspace(1, 8, 30)), n_sensors=1)
    found = plan(structure, unknown, options)
    alone = plan(structure, unknown, replace(options, loads=found.chosen.loads, sensors=found.chosen.sensors))
    assert found.chosen.std == pytest.approx(alone.chosen.std, rel=1e-9)
    with pytest.raises(InputError, match="must be 1 for a structure with friction"):
        plan(structure, unknown, replace(options, n_loads=2))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"n_sensors": 7}, "`n_sensors`, or --sensors, must be from 1 to 6, the number of candidates, got 7"),
        ({"n_loads": 0}, "`n_loads`, or --loads, must be from 1 to 2"),
        ({"n_frequencies": 41}, "`n_frequencies`, or --frequencies, must be from 1 to 40"),
        ({"sensors": parse_dofs(["0Y"])}, "held at zero"),
        ({"loads": parse_dofs(["99Y"])}, "which the structure does not have"),
        ({"relative_noise": 0.0, "absolute_noise": 0.0}, "without noise every test is perfect"),
        ({"of_interest": ["masses"]}, "'masses', which is no parameter; the nearest is 'mass'"),
        ({"target": -1.0}, "`target` must be greater than 0"),
        ({"criterion": "e"}, "`criterion` must be one of d, a, got 'e'"),
        ({"kind": "compliance"}, "`kind` must be one of"),
    ],
)
def test_options_that_cannot_be_used_are_told(beam, changes, message):
    with pytest.raises(InputError, match=message):
        plan(*beam, beam_options(**changes))


@pytest.mark.parametrize("lines", [(), (1.0, 1.0), (2.0, 1.0), (-1.0, 1.0), (1.0, np.nan)])
def test_lines_that_cannot_be_used_are_told(beam, lines):
    with pytest.raises(InputError, match="`frequency` must"):
        plan(*beam, replace(beam_options(), frequency=lines))


def test_too_many_pairs_are_refused_before_memory_runs_out(beam, monkeypatch):
    monkeypatch.setattr("structid.planning.plan._LARGEST_BYTES", 1000)
    with pytest.raises(InputError, match="6 sensors times 2 loads with 12 parameters are too many"):
        plan(*beam, beam_options())


# ---- the study file and the command


def written(folder, text):
    folder.mkdir(exist_ok=True)
    path = folder / "chain.toml"
    path.write_text(text, encoding="utf-8")
    return path


def run(*arguments):
    return CliRunner().invoke(app, ["plan", *map(str, arguments)])


def test_plan_needs_no_record(tmp_path):
    path = written(tmp_path, WITHOUT_RECORD + PLAN)
    result = run(path, "--sensors", 2, "--frequencies", 12, "--target", 0.02, "--out", tmp_path / "out", "--png")
    assert result.exit_code == 0, result.output
    found = json.loads((tmp_path / "out" / "plan.json").read_text())
    study = load_plan(path, n_sensors=2, n_frequencies=12, target=0.02)
    again = planned(study)
    assert found["tests"][0]["relative_std"] == pytest.approx(again.tests[0].std.tolist())
    assert found["options"]["n_sensors"] == 2
    assert found["options"]["relative_noise"] == 0.01
    assert found["options"]["absolute_noise"] == 0.001
    assert len(found["options"]["frequency_hz"]) == 60
    assert found["enough"]["target"] == 0.02
    assert (tmp_path / "out" / "study.toml").read_text() == path.read_text()
    assert {p.name for p in (tmp_path / "out" / "figures").iterdir()} >= {
        "plan_places.png",
        "plan_std.png",
        "plan_lines.png",
    }
    for test in found["tests"]:
        assert test["label"] in result.output
    assert "chosen sensors: " in result.output
    page = (tmp_path / "out" / "plan.html").read_text().split("<script")[0]
    assert "http" not in page.replace("http-equiv", "")


def test_same_plan_gives_the_same_bytes(tmp_path):
    path = written(tmp_path, WITHOUT_RECORD + PLAN)
    for name in ("one", "two"):
        assert run(path, "--out", tmp_path / name, "--png").exit_code == 0
    for file in ("plan.json", "plan.html", "figures/plan_places.png", "figures/plan_std.png"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()


def test_study_without_plan_or_record_takes_defaults_and_says_so(tmp_path):
    study = load_plan(written(tmp_path, WITHOUT_RECORD))
    assert [str(d) for d in study.options.sensors] == ["1X+", "2X+", "3X+"]
    assert len(study.options.frequency) == 400
    assert any("no noise is given" in note for note in study.notes)
    assert any("no band is given" in note for note in study.notes)


def test_record_gives_the_defaults(tmp_path):
    study = load_plan(write_chain(tmp_path))
    assert [str(d) for d in study.options.installed_sensors] == ["1X+", "3X+"]
    assert [str(d) for d in study.options.installed_loads] == ["3X+"]
    assert study.options.kind == "accelerance"
    assert study.options.relative_noise == 0.01
    assert study.options.frequency[0] == 0.5
    found = planned(study)
    assert found.installed.sensors == study.options.installed_sensors
    assert str(found.next_sensors[0].sensors[-1]) == "2X+"


def test_noise_of_a_record_is_that_of_the_lines_where_it_has_power(tmp_path):
    path = write_chain(tmp_path)
    record = read_record(tmp_path / "frf.npz")
    size = np.abs(record.values)
    relative = np.where(np.arange(len(size)) < len(size) // 2, 0.05, 3.0)[:, None, None]
    write_record(tmp_path / "frf.npz", replace(record, variance=(relative * size) ** 2))
    path.write_text(re.sub(r"\[record.noise\]\n(\w+ = .*\n)+", "", path.read_text()))
    study = load_plan(path)
    assert study.options.relative_noise == pytest.approx(0.05)
    assert any(
        "the noise is the median of the record, 5 %, over the 50 % of its values above their noise" in note
        for note in study.notes
    )


def test_a_model_without_damping_is_told_beside_its_predictions(tmp_path):
    path = written(tmp_path, WITHOUT_RECORD + PLAN)
    damped, words = (
        run(path, "--out", tmp_path / "damped"),
        "assume noise of 1 % of each value and 0.001 (m/s^2)/N and a model",
    )
    assert "without any damping" not in damped.stdout
    springs = CHAIN[: CHAIN.index("[[structure.dashpot]]")].replace("loss_factor = 0.03\n", "")
    path.write_text(springs + '[[unknown]]\nproperty = "stiffness"\nelements = "upper"\n' + PLAN)
    undamped = run(path, "--out", tmp_path / "undamped")
    assert words in " ".join(undamped.stdout.split())
    assert "without any damping, whose resonances" in (tmp_path / "undamped" / "plan.html").read_text()


def test_prediction_agrees_with_check(tmp_path):
    """What `check` says of the record as it is, `plan` says of the installed sensors, but for the noise of the values.

    Plans take what the model holds as exact.
    """
    from structid.study.run.check import check_study
    from structid.study.schema.study import load_study

    path = write_chain(tmp_path)
    installed = planned(load_plan(path)).installed
    checked = check_study(load_study(path))
    assert installed.std == pytest.approx(checked.of_data.std / np.abs(checked.study.parameters.start), rel=0.6)


def test_record_that_is_not_there_yet_is_left_out(tmp_path):
    study = load_plan(written(tmp_path, CHAIN + PLAN))
    assert "the record frf.npz is not there yet: planned without it" in study.notes
    assert study.options.installed_sensors == ()


def test_declared_noise_of_a_record_that_is_not_there_yet_counts(tmp_path):
    study = load_plan(written(tmp_path, replaced("relative = 0.01", "relative = 0.2")))
    assert study.options.relative_noise == 0.2
    assert not any("no noise is given" in note for note in study.notes)


#: Channel 7X reads mass 2, and 3X mass 1 from the other side.
AIMED = '[record.sensors]\n"7X" = { node = 2 }\n"3X" = { node = 1, direction = [-1.0, 0.0, 0.0] }\n'


@pytest.mark.parametrize("key", ["sensors", "installed_sensors"])
def test_sensors_of_the_record_are_planned_where_they_are(tmp_path, key):
    plain = replaced('sensors = ["1X", "2X", "3X"]', f'{key} = ["2X", "1X"]', CHAIN + PLAN)
    named = replaced("[method]", AIMED + "[method]", replaced(f'{key} = ["2X", "1X"]', f'{key} = ["7X", "3X"]', plain))
    there, found = (load_plan(written(tmp_path / name, text)) for name, text in (("plain", plain), ("named", named)))
    assert [dof.place for dof in getattr(found.options, key)] == ["7X", "8X"]
    assert "candidates along directions of [record.sensors]: 7X, 3X (called 8X here)" in found.notes
    assert planned(found).tests[0].std == pytest.approx(planned(there).tests[0].std, rel=1e-9)
    assert run(tmp_path / "named" / "chain.toml", "--out", tmp_path / "out", "--png").exit_code == 0


def test_channels_of_a_record_are_planned_as_its_sensors_say(tmp_path):
    text = replaced("[method]", AIMED + "[method]")
    study = load_plan(write_chain(tmp_path, text, chain_record(outputs=("7X", "3X-"))))
    assert [str(dof) for dof in study.options.installed_sensors] == ["7X+", "8X-"]


def test_sensors_of_the_record_that_the_plan_does_not_name_are_told(tmp_path):
    notes = load_plan(written(tmp_path, replaced("[method]", AIMED + "[method]") + PLAN)).notes
    assert (
        "no candidates: 7X, 3X of [record.sensors]; name them in `sensors` of [plan] to choose from them" not in notes
    )
    assert any(
        note.startswith("candidates along directions of [record.sensors]: 3X (called 8X here)") for note in notes
    )
    assert "no candidates: 7X of [record.sensors]; name them in `sensors` of [plan] to choose from them" in notes


def test_model_error_adds_to_the_noise(tmp_path):
    text = replaced("band = [0.5, 12.0]\n", "band = [0.5, 12.0]\nmodel_error = 0.03\n")
    study = load_plan(write_chain(tmp_path, text))
    assert study.options.relative_noise == pytest.approx(np.hypot(0.01, 0.03))


def test_identify_leaves_the_plan_alone(tmp_path):
    from structid.study.schema.study import load_study

    assert load_study(write_chain(tmp_path, CHAIN + PLAN)).title == "Chain of three masses"


def test_parameters_that_no_candidate_tells_apart_exit_1_with_results(tmp_path):
    path = written(tmp_path, RIGID[: RIGID.index("[record]")])
    result = run(path, "--out", tmp_path / "out", "--no-report")
    assert result.exit_code == 1
    assert "even all candidates together do not determine mass[mass 2], mass[mass 3]" in result.stderr
    found = json.loads((tmp_path / "out" / "plan.json").read_text())
    assert found["determined"] is False
    assert found["tests"][-1]["worst_relative_std"] is None
    assert "mass[mass 2] and mass[mass 3] only as a sum" in [d["words"] for d in found["undetermined_directions"]]
    assert not (tmp_path / "out" / "plan.html").exists()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('sensors = ["1X", "2X", "3X"]', 'sensors = ["1X", "9X"]', "[plan] sensors: 9X+ is at node 9"),
        ('sensors = ["1X", "2X", "3X"]', 'sensors = ["1Q"]', "[plan] sensors: cannot read '1Q'"),
        ("n_lines = 60", "n_lines = 60\nn_sensors = 9", "`n_sensors`, or --sensors, must be from 1 to 3"),
        ("n_lines = 60", "lines = 60", "[plan] lines: unknown key; the nearest is"),
        ("n_lines = 60", "frequency = [1.0, 2.0]", "[plan]: gives lines both by"),
        ("band = [0.5, 12.0]\nn_lines", "band = [0.0, 12.0]\nspacing = \"log\"\nn_lines", "[plan] band: must begin above 0 Hz"),
        ("relative = 0.01", "relative = 2", "[plan.noise] relative: must be a number of at least 0 and at most 1"),
        ("absolute = 0.001", "absolute = -1.0", "[plan.noise] absolute: must be a number of at least 0"),
        ("relative = 0.01\nabsolute = 0.001", "relative = 0.0", "[plan.noise]: needs `relative` or `absolute`"),
        ("n_lines = 60", 'n_lines = 60\nof_interest = "mas"', "which is no parameter"),
        ("n_lines = 60", 'n_lines = 60\ncriterion = "e"', "[plan] criterion: must be one of"),
        ("n_lines = 60", "n_lines = 60\n[plan", "not TOML"),
    ],
)  # fmt: skip
def test_plan_section_that_cannot_be_used_is_told_with_its_place(tmp_path, old, new, message):
    path = written(tmp_path, replaced(old, new, WITHOUT_RECORD + PLAN))
    result = run(path, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert message in result.stderr.replace("\n", " ")
    assert "chain.toml, line" in result.stderr
    assert not (tmp_path / "out").exists()


def test_more_sensors_than_candidates_and_missing_file_exit_2(tmp_path):
    path = written(tmp_path, WITHOUT_RECORD + PLAN)
    assert run(path, "--sensors", 4, "--out", tmp_path / "out").exit_code == 2
    assert run(path, "--criterion", "x", "--out", tmp_path / "out").exit_code == 2
    assert run(tmp_path / "none.toml").exit_code == 2


def test_mechanism_is_told(tmp_path):
    text = replaced('first = "1X"\nstiffness = 1200.0', 'first = "1X"\nstiffness = 0.0', WITHOUT_RECORD)
    with pytest.raises((SingularModelError, InputError), match=r"chain.toml, line"):
        planned(load_plan(written(tmp_path, text + "[plan]\nband = [0.0, 12.0]\n")))


def test_tolerances_add_what_they_add_to_an_identification():
    """K S K' of a plan is that of an identification of the same lines whose record is the model's own."""
    masses = [sid.PointMass(f"m{i}", [i], mass=2.0 + i) for i in (1, 2)]
    springs = [
        sid.Spring(f"k{i}", f"{i}X", second=f"{i - 1}X" if i > 1 else None, stiffness=3e4, loss_factor=0.04)
        for i in (1, 2)
    ]
    structure = sid.Structure({1: 0.0, 2: 1.0}, [*masses, *springs], active=["X"])
    unknown = sid.parameters(structure, [sid.Unknown("stiffness", "k1"), sid.Unknown("mass", "m2")])
    frequency, tolerances = (
        np.linspace(5.0, 35.0, 60),
        Tolerances(mass=0.02, stiffness=0.01, damping=0.2, calibration=0.005),
    )
    options = PlanOptions(frequency, ["1X", "2X"], ["2X"], n_sensors=2, relative_noise=0.01, absolute_noise=0.001)
    planned_test = sid.plan(structure, unknown, options, tolerances)
    blank = sid.FrfRecord(frequency, np.zeros((60, 2, 1), dtype=complex), ["1X", "2X"], ["2X"], "accelerance")
    values = response(structure, unknown, blank).values_at(unknown.start)
    record = replace(blank, values=values, variance=np.abs(0.01 * values) ** 2 + 0.001**2)
    found = sid.identify(structure, unknown, record, sid.IdentifyOptions(tolerances=tolerances)).estimate
    added = np.linalg.norm(found.fixed.changes, axis=1) / unknown.start
    assert planned_test.chosen.of_tolerances == pytest.approx(added, rel=1e-3)
    assert planned_test.chosen.std == pytest.approx(found.std_noise / unknown.start, rel=1e-3)
    assert planned_test.chosen.std_with_tolerances == pytest.approx(found.std / unknown.start, rel=1e-3)
    assert (
        planned_test.assumption
        == "2 % of fixed masses, 1 % of fixed stiffnesses, 20 % of fixed dampings, 0.5 % of the calibration"
    )
    exact = sid.plan(structure, unknown, options, EXACT).chosen
    assert not exact.of_tolerances.any()
    half = replace(options, n_frequencies=60)  # all of the lines, by their own sums
    assert sid.plan(structure, unknown, half, tolerances).frequencies.of_tolerances == pytest.approx(added, rel=1e-3)


# ---- the page that explains it


def test_page_shows_what_the_command_prints(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "plan.md").read_text(encoding="utf-8")
    study = page.split("```toml\n")[1].split("```")[0]
    shown = page.split("the table of the parameters follows):\n\n```\n")[1].split("```")[0]
    path = written(tmp_path, study)
    result = run(path, "--no-report", "--out", tmp_path / "out")
    printed = [line.rstrip() for line in result.output.splitlines()]
    assert result.exit_code == 0
    assert printed[: len(shown.splitlines())] == shown.splitlines()


def test_pages_example_runs_in_python():
    page = (Path(__file__).parents[2] / "docs" / "plan.md").read_text(encoding="utf-8")
    names = {"print": lambda *words: None}
    exec(page.split("```python\n")[1].split("```")[0], names)
    assert names["planned"].determined
