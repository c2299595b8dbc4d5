"""Each change screened by algebra is the change that its study makes: both give the same responses."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from frame_cases import FREQUENCY, STUDY, shaken, written, written_histories, written_shaken, written_with_machine
from threadpoolctl import threadpool_info, threadpool_limits

from structid import Beam, FrfRecord, PointMass, RigidLink, RotaryInertia, Spring, Structure, Unknown, parameters
from structid.core.dof import parse_dofs
from structid.core.errors import StructidError
from structid.diagnose.causes import CAUSES, OF_DATA, OF_RESIDUAL, OF_SETS, candidates, set_candidates
from structid.diagnose.causes.appendage import Appendage
from structid.diagnose.causes.polarity import LoadPolarity, SensorPolarity
from structid.diagnose.causes.swap import SwappedSensors
from structid.diagnose.effects import direction_of, effect_of_addition
from structid.diagnose.model_edits import ScaleAxis
from structid.diagnose.modified_model import base_model
from structid.diagnose.receptances import receptances_at
from structid.diagnose.refits import FittedModel
from structid.diagnose.score_test import _CandidateScreening, point_at
from structid.diagnose.search import _simpler
from structid.diagnose.study_tables import NoStudyTextError
from structid.diagnose.tested_model import TestedModel
from structid.forward import FrfProblem, SpectraProblem
from structid.records.formats import read_record, write_record
from structid.study.run.diagnosis import suggestion_text
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study

#: Changes of another kind than of one response: left out data, meshes and laws of whole sets, which the model itself shows.
BY_MODEL = {kind.kind for kind in (*OF_SETS, *OF_DATA, *OF_RESIDUAL)}


#: Changes of channels, which act on the histories themselves too.
OF_CHANNELS = {"sensor_gain", "load_gain", "delay", "load_delay"}


@pytest.fixture(scope="module", params=[written, written_histories, written_shaken, written_with_machine])
def trial(tmp_path_factory, request):
    ready = prepare_study(load_study(request.param(tmp_path_factory.mktemp("effects"), seed=None)))
    [problem] = ready.problems
    model = TestedModel(ready.setups, ready.study.options)
    found = base_model(model, ready.problems, problem.theta_start)
    object.__setattr__(found, "study", ready.study)
    return found


def some_candidates(trial):
    fields = receptances_at(trial.views[0].problem, trial.views[0].problem.theta_start)
    chosen = {}
    for one in candidates([fields]):
        chosen.setdefault((one.place[0], len(chosen) % 3), one)  # some places of every kind
    return fields, list(chosen.values())


def test_every_kind_that_is_written_is_tried(trial):
    kinds = {one.kind for one in some_candidates(trial)[1]}
    # one load has none to be exchanged with or to share a gain with, and no linear look is taken at other places
    of_several = {"load_swap", "load_polarity", "record_gain"}
    every = {kind.kind for kind in CAUSES} - of_several - {"offset", "place", "load_place"}
    assert kinds | BY_MODEL >= every - untold(trial)


def untold(trial):
    """Dry friction takes no motion of supports, and a table has its direction from them."""
    of_loads = {"friction", "load_direction", "load_between"}
    return of_loads if trial.views[0].problem.record.kind == "transmissibility" else set()


def test_effects_are_those_of_the_changed_studies(trial):
    fields, chosen = some_candidates(trial)
    base = trial.views[0].problem
    compared = set()
    for one in chosen:
        strengths = one.strengths[[0, len(one.strengths) // 2]] if len(one.strengths) > 1 else one.strengths
        for q in strengths.tolist():
            try:
                changed = trial.changed(one, q)
            except StructidError:
                continue  # such as a node that has a part of its own already
            problem = changed.views[0].problem
            predicted = problem.with_lines(np.arange(len(base.frequency))).predicted(problem.theta_start)
            if one.kind in ("swap", "direction", "polarity", "between"):
                continue  # the record is called otherwise, and the model seen at other places: see the next test
            lines = np.searchsorted(base.frequency, fields.problem.frequency)
            own = predicted[lines] - fields.frf
            found = one.effect(fields, np.array([q]))[0]
            # strengths are written with six digits
            assert np.abs(found - own).max() < 1e-3 * np.abs(own).max() + 1e-9 * np.abs(fields.frf).max(), (
                one.kind,
                one.where,
                q,
            )
            compared.add(one.kind)
            if one.kind in OF_CHANNELS and isinstance(trial.problems[0], SpectraProblem):
                spectra = changed.problems[0].predicted(changed.problems[0].theta_start)
                alike = np.searchsorted(changed.problems[0].frequency, fields.problem.frequency)
                assert np.abs(spectra[alike] - fields.frf - found).max() < 1e-3 * np.abs(found).max()
    structural = {"support", "spring", "dashpot", "friction", "mass", "sensor_mass", "inertia", "appendage", "joint"}
    every = structural | {"untied", "untied set"}
    every |= {"load_direction", "load_between"} | OF_CHANNELS
    untried = untold(trial) if isinstance(trial.problems[0], FrfProblem) else {"friction"}
    assert compared >= every - untried


@pytest.mark.parametrize("where", ["1X", "6X"])
def test_a_foot_gives_way_against_the_table_that_moves_it(tmp_path, where):
    """It hangs on a new node that the table moves in its place; the channel of the table is that node's then."""
    ready = prepare_study(load_study(written_shaken(tmp_path, seed=None)))
    trial = base_model(TestedModel(ready.setups, ready.study.options), ready.problems, ready.problems[0].theta_start)
    fields, _ = some_candidates(trial)
    [foot] = [one for one in candidates([fields]) if one.kind == "support" and one.where == (where,)]
    view = trial.changed(foot, 1e-5).views[0].problem
    lines = np.searchsorted(view.frequency, fields.problem.frequency)
    own = view.with_lines(np.arange(len(view.frequency))).predicted(view.theta_start)[lines] - fields.frf
    found = foot.effect(fields, np.array([1e-5]))[0]
    assert np.abs(own).max() > 1e-3 * np.abs(fields.frf).max()
    assert np.abs(found - own).max() < 1e-6 * np.abs(own).max()
    assert view.record.inputs[0].place == ("7X" if where == "1X" else "1X")


def of_both(folder, kinds):
    """A study of the shaken frame with records of the table ("1X", "6X") and of a force ("4Y")."""
    text, _, _ = shaken().partition("# how the test was made")
    for at in kinds:
        kind = "receptance" if at == "4Y" else "transmissibility"
        ones = np.ones((len(FREQUENCY), 3, 1), complex)
        write_record(folder / f"{at}.npz", FrfRecord(FREQUENCY, ones, ["2X", "3X", "5Y"], [at], kind))
        text += f'[[record]]\nname = "at {at}"\npath = "{at}.npz"\n\n[record.noise]\nrelative = 0.01\n\n'
    path = folder / "study.toml"
    path.write_text(text, encoding="utf-8")
    ready = prepare_study(load_study(path))
    return base_model(TestedModel(ready.setups, ready.study.options), ready.problems, ready.problems[0].theta_start)


@pytest.mark.parametrize("kinds", [("1X", "4Y"), ("4Y", "1X"), ("1X", "6X")])
def test_changes_are_the_same_of_records_that_hold_what_others_drive(tmp_path, kinds):
    """Each record has degrees of freedom of its own; a place is the same in all."""
    trial = of_both(tmp_path, kinds)
    fields = [receptances_at(view.problem, view.problem.theta_start) for view in trial.views]
    structural = [one for one in candidates(fields) if one.record is None and one.kind != "friction"]
    chosen = {(one.kind, one.where): one for one in structural[::7]}
    always = ("support", "mass", "sensor_mass", "inertia")
    chosen |= {(one.kind, one.where): one for one in structural if one.kind in always}
    seen = set()
    for one in chosen.values():
        q = float(one.strengths[len(one.strengths) // 2])
        try:
            changed = trial.changed(one, q)
        except StructidError:
            continue
        for own, view in zip(fields, (one.problem for one in changed.views), strict=True):
            predicted = view.with_lines(np.searchsorted(view.frequency, own.problem.frequency)).predicted(
                view.theta_start
            )
            change = predicted - own.frf
            found = one.effect(own, np.array([q]))[0]
            assert np.abs(found - change).max() < 1e-3 * np.abs(change).max() + 1e-9 * np.abs(own.frf).max(), one.where
        seen.add((one.kind, one.where))
    assert {("support", ("1X",)), ("support", ("6X",)), ("support", ("6RZ",))} <= seen
    assert {"mass", "sensor_mass", "inertia", "joint"} <= {kind for kind, _ in seen}


def test_a_mass_of_one_record_changes_that_one_alone(tmp_path):
    trial = of_both(tmp_path, ("1X", "4Y"))
    fields = [receptances_at(view.problem, view.problem.theta_start) for view in trial.views]
    assert not [one for one in candidates(fields) if one.kind == "mass" and one.record is not None]
    own = [
        one for one in candidates(fields, ["shaken", "struck"]) if one.kind == "mass" and one.where == ("3", "struck")
    ]
    [mass] = own
    q = float(mass.strengths[3])
    changed = trial.changed(mass, q)
    assert changed.target.names[-1] == "mass[mass 3 struck]"
    for number, (view, before) in enumerate(zip((one.problem for one in changed.views), fields, strict=True)):
        lines = np.searchsorted(view.frequency, before.problem.frequency)
        change = view.with_lines(lines).predicted(view.theta_start) - before.frf
        found = mass.effect(before, np.array([q]))[0] * (number == mass.record)
        assert np.abs(found).any() == (number == 1)
        assert np.abs(found - change).max() < 1e-3 * np.abs(found).max() + 1e-9 * np.abs(before.frf).max()


def test_sensors_that_move_from_record_to_record_weigh_where_they_are(tmp_path):
    """Each set-up has masses at its own sensors, one unknown of all."""
    text, _, _ = STUDY.partition("# how the test was made")
    for name, outputs in (("first", ["2X", "4Y"]), ("second", ["3X", "3Y", "5Y"])):
        ones = np.ones((len(FREQUENCY), len(outputs), 1), complex)
        write_record(tmp_path / f"{name}.npz", FrfRecord(FREQUENCY, ones, outputs, ["4Y"], "receptance"))
        text += f'[[record]]\nname = "{name}"\npath = "{name}.npz"\n\n[record.noise]\nrelative = 0.01\n\n'
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    ready = prepare_study(load_study(tmp_path / "study.toml"))
    trial = base_model(TestedModel(ready.setups, ready.study.options), ready.problems, ready.problems[0].theta_start)
    fields = [receptances_at(view.problem, view.problem.theta_start) for view in trial.views]
    [weighing] = [one for one in candidates(fields) if one.kind == "sensor_mass"]
    assert (weighing.where, weighing.nodes) == (("2", "4", "3", "5"), ("2 4", "3 5"))
    changed = trial.changed(weighing, 0.3)
    assert changed.target.names[-1] == "mass[mass of each sensor]"
    assert len(changed.target.names) == len(trial.target.names) + 1
    for before, view in zip(fields, (one.problem for one in changed.views), strict=True):
        lines = np.searchsorted(view.frequency, before.problem.frequency)
        change = view.with_lines(lines).predicted(view.theta_start) - before.frf
        found = weighing.effect(before, np.array([0.3]))[0]
        assert np.abs(change).max() > 1e-3 * np.abs(before.frf).max()
        assert np.abs(found - change).max() < 1e-3 * np.abs(change).max() + 1e-9 * np.abs(before.frf).max()


@pytest.mark.parametrize(
    "more",
    [
        '[record.relabel]\n"13X" = "3X-"\n',
        '[record.structure]\nfixed = ["1 X Y RZ", "6 X Y RZ"]\n',
        'relabel = { "11X" = "1X" }\n',
    ],
)
def test_a_foot_gives_way_whatever_the_record_says_of_channels_and_supports(tmp_path, more):
    path = written_shaken(tmp_path, seed=None)
    record = read_record(tmp_path / "frf.npz")
    names = {"13X": {"3X": "13X-"}, "11X": {"1X": "11X"}}
    called = next((names[key] for key in names if key in more), {})
    outputs = [called.get(dof.place, dof) for dof in record.outputs]
    inputs = [called.get(dof.place, dof) for dof in record.inputs]
    write_record(tmp_path / "frf.npz", replace(record, outputs=outputs, inputs=inputs))
    text = path.read_text(encoding="utf-8")
    head, tail = text.split("[record.noise]")
    path.write_text(f"{head}{more}\n[record.noise]{tail}", encoding="utf-8")
    ready = prepare_study(load_study(path))
    trial = base_model(TestedModel(ready.setups, ready.study.options), ready.problems, ready.problems[0].theta_start)
    fields, _ = some_candidates(trial)
    [foot] = [one for one in candidates([fields]) if one.kind == "support" and one.where == ("1X",)]
    view = trial.changed(foot, 1e-5).views[0].problem
    lines = np.searchsorted(view.frequency, fields.problem.frequency)
    own = view.predicted(view.theta_start)[lines] - fields.frf
    assert np.abs(own).max() > 1e-3 * np.abs(fields.frf).max()
    assert np.abs(foot.effect(fields, np.array([1e-5]))[0] - own).max() < 1e-6 * np.abs(own).max()


def test_a_damper_is_tried_across_a_spring_that_stands_on_the_table(tmp_path):
    text = shaken(STUDY.replace('second = "4X"', 'second = "6X"'))
    ready = prepare_study(load_study(written(tmp_path, text, text, seed=None)))
    trial = base_model(TestedModel(ready.setups, ready.study.options), ready.problems, ready.problems[0].theta_start)
    fields, _ = some_candidates(trial)
    [across] = [one for one in candidates([fields]) if one.kind == "dashpot" and len(one.where) == 2]
    assert across.where == ("2X", "6X")
    view = trial.changed(across, 5.0).views[0].problem
    own = view.predicted(view.theta_start)[np.searchsorted(view.frequency, fields.problem.frequency)] - fields.frf
    assert np.abs(across.effect(fields, np.array([5.0]))[0] - own).max() < 1e-6 * np.abs(own).max()


def _channel_editor(record, sensors, loads):
    """A function that writes the edits of a candidate into the table `record` of a study with channels of these names."""
    model = SimpleNamespace(
        setups=[SimpleNamespace(channels=(("output", parse_dofs(sensors)), ("input", parse_dofs(loads))))]
    )

    def edit(candidate):
        for one in candidate.edits(model, 1.0):
            one.write({"structure": {}, "record": record})

    return edit


def test_a_load_that_was_renamed_without_saying_load_keeps_its_entry():
    record = {"relabel": {"13X": "4Y", "14Y": "3X"}}
    edit = _channel_editor(record, ["3X"], ["4Y"])
    edit(LoadPolarity(where=("4Y",)))
    assert record["relabel"] == {"13X": "4Y-", "14Y": "3X"}
    edit(SensorPolarity(where=("3X",)))
    assert record["relabel"] == {"13X": "4Y-", "14Y": "3X-"}


@pytest.mark.parametrize("kind", [LoadPolarity, SensorPolarity])
def test_an_entry_that_may_be_of_a_sensor_or_a_load_is_left_to_the_user(kind):
    record = {"relabel": {"14Y": "4Y"}}
    edit = _channel_editor(record, ["4Y", "3X"], ["4Y"])
    with pytest.raises(NoStudyTextError, match="'14Y' 4Y, which a sensor and a load are called"):
        edit(kind(where=("4Y",)))
    edit(SensorPolarity(where=("3X",)))
    assert record["relabel"] == {"14Y": "4Y", "3X": "3X-"}


def test_a_clock_scales_the_tones_of_a_history_too():
    record = {"sampling_rate": 100.0, "time": {"tones": [25.0, 50.0]}}
    study = {"record": record, "method": {"band": [5.0, 40.0]}}
    ScaleAxis(0.98).write(study)
    assert record == {"sampling_rate": 98.0, "time": {"tones": [24.5, 49.0]}}
    assert study["method"] == {"band": [4.9, 39.2]}


def test_channels_that_have_other_names_already_are_turned_and_exchanged(tmp_path):
    record = {"relabel": {"13X": "3X-", "load 14Y": "4Y"}}
    edit = _channel_editor(record, ["3X", "5X"], ["4Y"])

    edit(SensorPolarity(where=("3X",)))
    assert record["relabel"] == {"13X": "3X", "load 14Y": "4Y"}
    edit(SwappedSensors(where=("3X", "5X")))
    assert record["relabel"] == {"13X": "5X", "load 14Y": "4Y", "5X": "3X"}
    edit(LoadPolarity(where=("4Y",)))
    assert record["relabel"]["load 14Y"] == "4Y-"


def test_supports_of_beams_in_several_pieces_give_way(tmp_path):
    """Pieces have degrees of freedom of their own, which stay when supports are taken away."""
    path = written(tmp_path, STUDY.replace("subdivide = 1", "subdivide = 2", 1), seed=None)
    ready = prepare_study(load_study(path))
    trial = base_model(TestedModel(ready.setups, ready.study.options), ready.problems, ready.problems[0].theta_start)
    base = trial.views[0].problem
    fields = receptances_at(base, base.theta_start)
    one = next(c for c in candidates([fields]) if c.kind == "support" and c.where == ("6RZ",))
    q = float(one.strengths[3])
    [problem] = trial.changed(one, q).problems
    lines = np.searchsorted(base.frequency, fields.problem.frequency)
    own = problem.with_lines(np.arange(len(base.frequency))).predicted(problem.theta_start)[lines] - fields.frf
    assert one.effect(fields, np.array([q]))[0] == pytest.approx(own, rel=1e-3, abs=1e-3 * np.abs(own).max())


def test_an_element_whose_stiffness_is_one_parameter_differs_as_a_whole(tmp_path):
    """Bending and axial stiffness of a piece of the girder go together, where the study holds them together."""
    bending = 'property = "bending_stiffness"\nelements = "girder"'
    tied = written(tmp_path, STUDY.replace(bending, bending.replace("bending_stiffness", "stiffness")), seed=None)
    ready = prepare_study(load_study(tied))
    trial = base_model(TestedModel(ready.setups, ready.study.options), ready.problems, ready.problems[0].theta_start)
    base = trial.views[0].problem
    fields = receptances_at(base, base.theta_start)
    found = [
        one for one in candidates([fields]) if one.place[0] == "untied stiffness" and one.where[0].startswith("girder")
    ]
    assert [(one.where, one.properties[0].property) for one in found] == [
        ((f"girder:{k}",), "stiffness") for k in (1, 2)
    ]
    [problem] = trial.changed(found[1], 0.4).problems
    lines = np.searchsorted(base.frequency, fields.problem.frequency)
    own = problem.with_lines(np.arange(len(base.frequency))).predicted(problem.theta_start)[lines] - fields.frf
    assert found[1].effect(fields, np.array([0.4]))[0] == pytest.approx(own, rel=1e-6, abs=1e-9 * np.abs(own).max())


def test_degrees_of_freedom_move_where_they_follow_free_ones(trial):
    fields = receptances_at(trial.views[0].problem, trial.views[0].problem.theta_start)
    codes = np.unique(np.concatenate([one.codes for one in fields.elements(("stiffness",))]))
    following = fields.reached(codes).any(axis=1)
    assert set(following) == {False, True}
    assert [fields.moves(codes[k : k + 1]) for k in range(len(codes))] == following.tolist()
    assert fields.moves(codes)
    assert not fields.moves(np.append(codes[~following], 10**9))


def test_cables_exchanged_and_sensors_turned_read_as_their_studies(trial):
    """The misfit of a study that calls channels otherwise is that of the responses read the other way."""
    _, chosen = some_candidates(trial)
    for one in chosen:
        if one.kind not in ("swap", "direction", "polarity", "between"):
            continue
        q = float(one.strengths[min(3, len(one.strengths) - 1)])
        problem = trial.changed(one, q).views[0].problem
        residual = np.sort(np.abs(problem.residual(problem.theta_start)[: problem.n_data]))
        whole = receptances_at(trial.views[0].problem, trial.views[0].problem.theta_start)
        lines = np.searchsorted(problem.frequency, whole.problem.frequency)
        own = problem.with_lines(lines)
        residual = own.residual(own.theta_start)[: own.n_data]
        rows = whole.problem.data_rows(whole.frf + one.effect(whole, np.array([q])))[:, 0]
        assert np.sum(residual**2) == pytest.approx(np.sum(rows**2), rel=0.02), (one.kind, one.where)


@pytest.mark.parametrize("kind", ["mass", "inertia"])
def test_a_screened_candidate_leaves_what_least_squares_leave(trial, kind):
    point = point_at([view.problem for view in trial.views], trial.views[0].problem.theta_start + 0.05)
    one = next(c for c in candidates(point.records) if c.kind == kind)
    [found] = point.screened([one])
    [fields] = point.records
    rows = fields.problem.data_rows(fields.frf + one.effect(fields, np.array([found.strength])))[:, 0]
    at = fields.problem.linearize(trial.views[0].problem.theta_start + 0.05)
    step, *_ = np.linalg.lstsq(at.jacobian, rows, rcond=None)
    assert found.left == pytest.approx(np.sum((rows - at.jacobian @ step) ** 2), rel=1e-8)
    assert found.left <= point.left * (1 + 1e-12)


def test_a_support_gives_way_beside_a_node_that_has_slid():
    nodes = {1: 0.0, 2: 0.5, 3: 1.0}
    beam = Beam("beam", [[1, 2], [2, 3]], 2.0, 40.0, loss_factor=0.02)
    parts = [beam, PointMass("load", [2], 0.7)]
    supports = ["1Y", "1RZ", "3Y"]
    drawn = Structure(nodes, parts, supports, sliding=[2])
    slid = parameters(drawn, [Unknown("position", "node 2", start=0.62)])
    lines = np.linspace(1.0, 30.0, 40)
    record = FrfRecord(lines, np.ones((40, 2, 1)), ["2Y", "3RZ"], ["2Y"], "receptance", variance=np.ones((40, 2, 1)))
    fields = receptances_at(FrfProblem(drawn, slid, record), slid.theta_start)
    [support] = [one for one in candidates([fields]) if one.kind == "support" and one.where == ("3Y",)]
    loose = Structure(nodes, [*parts, Spring("ground", "3Y", stiffness=900.0)], supports[:2], sliding=[2])
    there = parameters(loose, [Unknown("position", "node 2", start=0.62)])
    changed = FrfProblem(loose, there, record).predicted(there.theta_start) - fields.frf
    found = support.effect(fields, np.array([1 / 900.0]))[0]
    assert np.abs(found - changed).max() < 1e-9 * np.abs(changed).max()


def test_rotary_inertia_adds_to_one_diagonal_entry_and_none_is_too_much_that_is_not_there():
    """Two cubic beams on a line and a disc, by the matrices of the textbook; nodes on a rigid link turn as its main node."""
    nodes = {1: 0.0, 2: 0.5, 3: 1.0, 4: 1.1}
    beam, disc = Beam("beam", [[1, 2], [2, 3]], 2.0, 40.0, loss_factor=0.02), RotaryInertia("disc", [2], 0.06, "RZ")
    structure = Structure(nodes, [beam, disc], ["1Y", "1RZ"], ties=[RigidLink("plate", 3, [4], ("Y", "RZ"))])
    record = FrfRecord(
        np.linspace(1.0, 30.0, 40),
        np.ones((40, 2, 1)),
        ["2Y", "3Y"],
        ["3Y"],
        "receptance",
        variance=np.ones((40, 2, 1)),
    )
    unknown = parameters(structure, [Unknown("mass", "beam")])
    fields = receptances_at(FrfProblem(structure, unknown, record), unknown.theta_start)
    found = {one.where: one for one in candidates([fields]) if one.kind == "inertia"}
    assert set(found) == {("2RZ",), ("3RZ",)}
    h = 0.5
    stiff = 40.0 / h**3 * np.array([[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                                    [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]])  # fmt: skip
    heavy = 2.0 * h / 420 * np.array([[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2],
                                      [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]])  # fmt: skip
    k, m = np.zeros((6, 6)), np.zeros((6, 6))
    for first in (0, 2):
        k[first : first + 4, first : first + 4] += stiff
        m[first : first + 4, first : first + 4] += heavy
    m[3, 3] += 0.06
    for at, where in ((3, "2RZ"), (5, "3RZ")):
        one = found[where,]
        assert one.bounds == pytest.approx((-m[at, at], np.inf))
        assert one.strengths.min() > -m[at, at]
        strengths = np.array([0.03, -0.5 * m[at, at]])
        for q, effect in zip(strengths, one.effect(fields, strengths), strict=True):
            changed = m.copy()
            changed[at, at] += q
            of = [
                np.linalg.inv(fields.laplace[:, None, None] ** 2 * mass[2:, 2:] + k[2:, 2:] * (1 + 0.02j))
                for mass in (changed, m)
            ]
            own = (of[0] - of[1])[:, [0, 2], 2][..., None]
            assert np.abs(effect - own).max() < 1e-9 * np.abs(own).max()


@pytest.mark.parametrize("along", ["X", "Y"])
def test_a_mass_off_its_node_moves_as_on_a_rigid_link_to_it(tmp_path, along):
    text = STUDY.replace(
        "[[unknown]]", '[[structure.point_mass]]\nname = "pumps"\nnodes = [2, 4]\nmass = 0.5\n\n[[unknown]]', 1
    )
    ready = prepare_study(load_study(written(tmp_path, text, text, seed=None)))
    trial = base_model(TestedModel(ready.setups, ready.study.options), ready.problems, ready.problems[0].theta_start)
    fields, _ = some_candidates(trial)
    found = {one.where: one for one in candidates([fields]) if one.kind == "offset"}
    assert set(found) == {(f"pumps:{k}", axis) for k in (1, 2) for axis in "XY"}
    one = found["pumps:2", along]
    for length in (0.1, -0.2):
        changed = trial.changed(one, length)
        view = changed.views[0].problem
        assert view.structure.nodes[7] == pytest.approx([0.6 + length * (along == "X"), 1.0 + length * (along == "Y")])
        own = view.predicted(view.theta_start)[np.searchsorted(view.frequency, fields.problem.frequency)] - fields.frf
        assert np.abs(own).max() > 1e-3 * np.abs(fields.frf).max()
        assert np.abs(one.effect(fields, np.array([length]))[0] - own).max() < 1e-8 * np.abs(own).max()


@pytest.mark.parametrize(("ratio", "kind"), [(100.0, "mass"), (1.5, "mass"), (0.0, None), (0.01, "spring")])
def test_what_swings_outside_all_lines_is_offered_as_the_mass_or_spring_that_it_is(trial, ratio, kind):
    base = FittedModel(trial, trial.target.theta_start, 1.0)
    lines = np.concatenate([problem.frequency for problem in trial.problems])
    frequency = ratio * (lines.max() if ratio > 1 else lines[lines > 0].min()) if ratio else lines.mean()
    swinging = Appendage(where=("4Y",), frequency=float(frequency))
    changed = trial.changed(swinging, 0.3)
    offered = _simpler(base, FittedModel(changed, changed.target.theta_start, 0.5))
    assert [candidate.kind for candidate, _, _ in offered] == ([] if kind is None else [kind])
    for candidate, size, theta in offered:
        expected = 0.3 if kind == "mass" else 0.3 * (2 * np.pi * frequency) ** 2
        assert candidate.where == (("4",) if kind == "mass" else ("4Y",))
        assert size == pytest.approx(expected, rel=1e-3)
        added = {name: v for name, v in trial.changed(candidate, size).values(theta).items() if name not in base.values}
        assert list(added.values()) == pytest.approx([expected], rel=1e-3)


def test_damping_of_all_sets_is_tried_as_viscous_at_once(trial):
    [every] = [
        one for one in set_candidates(trial.model, trial.problems) if one.kind == "damping_law" and len(one.where) > 2
    ]
    assert every.where == ("left", "girder", "right", "viscous")
    [strength] = every.strengths.tolist()
    changed = trial.changed(every, strength)
    assert set(changed.target.names) - set(trial.target.names) == {
        "stiffness_damping[left, girder, right]",
        "mass_damping[left, girder, right]",
    }
    damping, stiffness, mass = (
        changed.setups[0].structure.matrix(law, changed.setups[0].structure.values).toarray()
        for law in ("damping", "stiffness", "mass")
    )
    omega = 2 * np.pi * every.frequency
    rotations = [
        i for i, dof in enumerate(trial.setups[0].structure.dofs) if dof.direction == "RZ"
    ]  # the brace has none
    own = np.ix_(rotations, rotations)
    expected = 0.5 * strength * (stiffness + omega**2 * mass)
    assert damping[own] == pytest.approx(expected[own], rel=1e-4, abs=1e-4 * np.abs(expected[own]).max())


def test_places_that_move_alike_are_looked_at_once(trial):
    _, chosen = some_candidates(trial)
    spring = next(one for one in chosen if one.kind == "spring")
    looks = []

    @dataclass(frozen=True, eq=False, kw_only=True)
    class Counted(type(spring)):
        shared: bool = True

        def effect(self, receptances, strengths):
            looks.append(len(strengths))
            return spring.effect(receptances, strengths)

        def alike_by(self):
            return spring.alike_by() if self.shared else None

    point = point_at([trial.views[0].problem], trial.views[0].problem.theta_start)
    one = Counted(where=spring.where, strengths=spring.strengths)
    [alone], n_alone = point.screened([one]), sum(looks)
    looks.clear()
    both = point.screened([one, replace(one, where=("a place beside it",))])
    assert sum(looks) == n_alone
    assert [(each.strength, each.left) for each in both] == [(alone.strength, alone.left)] * 2
    assert [each.candidate.where for each in both] == [spring.where, ("a place beside it",)]
    looks.clear()
    point.screened([one, replace(one, shared=False)])
    assert sum(looks) == 2 * n_alone


def test_each_effect_has_one_slice_per_strength_and_is_screened_alone_as_with_others(trial):
    """Of every kind some candidates, those of one strength too, in an order that mixes kinds."""
    point = point_at([trial.views[0].problem], trial.views[0].problem.theta_start + 0.01)
    [fields] = point.records
    chosen = {}
    for one in point.candidates([""]):
        assert one.effect(fields, one.strengths[:3]).shape == (len(one.strengths[:3]), *fields.frf.shape), one.kind
        chosen.setdefault((one.kind, len(chosen) % 2), one)
    several = list(chosen.values())[::-1]
    together = point.screened(several)
    for one, found in zip(several, together, strict=True):
        [alone] = point.screened([one])
        assert alone.strength == pytest.approx(found.strength, rel=1e-6), (one.kind, one.where)
        assert alone.left == pytest.approx(found.left, rel=1e-9), (one.kind, one.where)


def test_screening_takes_one_thread_of_blas(trial):
    """Products of its size lose time to more."""
    _, chosen = some_candidates(trial)
    spring = next(one for one in chosen if one.kind == "spring")
    threads = set()

    @dataclass(frozen=True, eq=False, kw_only=True)
    class Watched(type(spring)):
        def effect(self, receptances, strengths):
            threads.update(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")
            return spring.effect(receptances, strengths)

    point = point_at([trial.views[0].problem], trial.views[0].problem.theta_start)
    watched = [Watched(where=spring.where, strengths=spring.strengths)]
    with threadpool_limits(2, user_api="blas"):
        point.screened(watched)
        point.requested(watched)
    assert threads == {1}


def test_unit_responses_of_the_directions_last_asked_for_are_kept(trial, monkeypatch):
    monkeypatch.setattr("structid.diagnose.receptances._MOST_UNIT_RESPONSES", 2)
    fields, _ = some_candidates(trial)
    first, second, third = (direction_of((dof, 1.0)) for dof in list(fields.columns)[:3])
    for direction in (first, second, first, third):
        effect_of_addition(fields, direction, np.ones(len(fields.laplace)), np.ones(1))
    assert [codes for codes, _ in fields.unit_responses.keys] == [one.codes.tobytes() for one in (first, third)]


def test_strengths_that_leave_as_little_but_for_rounding_give_the_first(trial):
    _, chosen = some_candidates(trial)
    for left in ([3.0, 2.0, 2.0 - 4e-16], [3.0, 2.0, 2.0 + 4e-16]):
        assert _CandidateScreening(np.array([1.0, 2.0, 3.0]), np.array(left), 0.0, 0.0).best(chosen[0]).strength == 2.0
    ruled_out = _CandidateScreening(np.array([1.0, 2.0]), np.array([np.inf, np.inf]), 0.0, 0.0).best(chosen[0])
    assert (ruled_out.strength, ruled_out.left) == (1.0, np.inf)


def test_edits_of_a_model_are_those_written_into_its_study(trial):
    """A model that is read from the edited text answers as the edited model does, for every kind of cause."""
    source = trial.study.path
    _, chosen = some_candidates(trial)
    several = [*chosen, *set_candidates(trial.model, trial.problems)]
    compared = set()
    for one in several:
        q = float(one.strengths[len(one.strengths) // 2])
        try:
            changed = trial.changed(one, q)
        except StructidError:
            continue
        try:
            text, lines = suggestion_text(trial.study, changed.changes)
        except NoStudyTextError:
            assert one.kind == "clock"  # the record file says its axis
            continue
        path = source.with_name("edited.toml")
        path.write_text(text, encoding="utf-8")
        again = prepare_study(load_study(path))
        read = base_model(TestedModel(again.setups, again.study.options), again.problems, again.problems[0].theta_start)
        assert read.target.names == changed.target.names, one.where
        assert read.target.theta_start == pytest.approx(changed.target.theta_start, rel=1e-5, abs=1e-9), one.where
        theta = changed.target.theta_start
        expected = changed.target.residual(theta)
        assert np.abs(read.target.residual(theta) - expected).max() < 1e-5 * np.abs(expected).max() + 1e-9, one.where
        assert lines
        compared.add(one.kind)
    assert len(compared) > 20
