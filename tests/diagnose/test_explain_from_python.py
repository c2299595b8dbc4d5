"""An identification made in Python is diagnosed there: printed, it begins with its verdict, and its cause is named."""

import numpy as np
import pytest

import structid as sid
from structid.forward import simulated_record
from structid.unknowns.tolerances import EXACT

NODES = {n: 0.25 * n for n in range(5)}
FREQUENCY = np.linspace(2.0, 120.0, 120)


def beam(fixed, *more):
    parts = [[k, k + 1] for k in range(4)]
    return sid.Structure(
        NODES, [sid.Beam("rail", parts, mass=2.0, bending_stiffness=40.0, loss_factor=0.02), *more], fixed
    )


def identified(truth, model):
    unknown = sid.parameters(truth, [sid.Unknown("bending_stiffness", "rail")])
    lines = sid.FrfRecord(FREQUENCY, np.ones((len(FREQUENCY), 3, 1)), ["1Y", "2Y", "4Y"], ["2Y"], "receptance")
    record = simulated_record(truth, unknown, lines, 0.01, np.random.default_rng(3))
    sought = sid.parameters(model, [sid.Unknown("bending_stiffness", "rail", start=45.0), sid.Unknown("mass", "rail")])
    exact = sid.IdentifyOptions(restarts=0, tolerances=EXACT)
    return sid.identify(model, sought, record, exact)


@pytest.fixture(scope="module")
def clamped():
    """A foot that is drawn clamped, and turns."""
    turning = sid.Spring("foot", "0RZ", stiffness=150.0)
    return identified(beam(["0Y"], turning), beam(["0Y", "0RZ"]))


def test_a_printed_identification_begins_with_its_verdict(clamped):
    assert str(clamped).startswith(("Wrong model: ", "Approximate: "))
    right = identified(beam(["0Y", "0RZ"]), beam(["0Y", "0RZ"]))
    assert str(right).startswith("Sound: ")


def test_a_sound_answer_names_what_the_data_determine_weakly():
    model = beam(["0Y", "0RZ"], sid.Spring("wire", "4Y", stiffness=0.15))
    unknown = sid.parameters(model, [sid.Unknown("bending_stiffness", "rail"), sid.Unknown("stiffness", "wire")])
    lines = sid.FrfRecord(FREQUENCY, np.ones((len(FREQUENCY), 3, 1)), ["1Y", "2Y", "4Y"], ["2Y"], "receptance")
    record = simulated_record(model, unknown, lines, 0.01, np.random.default_rng(3))
    found = sid.identify(model, unknown, record, sid.IdentifyOptions(restarts=0, tolerances=EXACT))
    words = str(found).splitlines()[0]
    percent = 100 * found.estimate.std[1] / found.estimate.values[1]
    assert percent > 50
    assert words.endswith(f"the data determine every parameter but stiffness[wire] (to ± {percent:.2g} %).")


def test_the_cause_is_named_without_a_study(clamped):
    diagnosis = sid.explain(clamped, seconds=20.0)
    assert diagnosis.judgement.verdict == "wrong_model"
    first = diagnosis.causes[0]
    assert (first.kind, first.where) in (("support", ("0RZ",)), ("joint", ("rail:1/0RZ",)))
    [(_, stiffness, unit)] = first.found
    assert stiffness == pytest.approx(150.0, rel=0.02)
    assert unit == "N m/rad"
    assert (first.study, first.lines) == ("", ())
    assert str(diagnosis).startswith(diagnosis.judgement.words)
    assert first.words in str(diagnosis)


def test_a_force_of_either_sign_near_zero_is_not_called_weakly_determined():
    parts = [[k, k + 1] for k in range(4)]
    slack = sid.Beam("rail", parts, mass=2.0, bending_stiffness=40.0, loss_factor=0.02, axial_force=0.3)
    model = sid.Structure(NODES, [slack], ["0Y", "0RZ"])
    unknown = sid.parameters(model, [sid.Unknown("axial_force", "rail", positive=False)])
    lines = sid.FrfRecord(FREQUENCY, np.ones((len(FREQUENCY), 3, 1)), ["1Y", "2Y", "4Y"], ["2Y"], "receptance")
    truth = beam(["0Y", "0RZ"])
    record = simulated_record(truth, sid.parameters(truth, []), lines, 0.01, np.random.default_rng(3))
    found = sid.identify(model, unknown, record, sid.IdentifyOptions(restarts=0, tolerances=EXACT))
    assert abs(found.estimate.values[0]) < 1
    assert str(found).splitlines()[0].endswith("the data determine every parameter.")


@pytest.mark.parametrize("stated", [10.0, 300.0])
def test_a_tension_is_named_where_beams_are_drawn_on_a_line(stated):
    """A small one and one of three quarters of the Euler load: resonances move by one and by many of their widths."""
    parts = [[k, k + 1] for k in range(4)]
    tight = sid.Beam("rail", parts, mass=2.0, bending_stiffness=40.0, loss_factor=0.02, axial_force=stated)
    found = identified(sid.Structure(NODES, [tight], ["0Y", "0RZ"]), beam(["0Y", "0RZ"]))
    first = sid.explain(found, seconds=20.0).causes[0]
    assert (first.kind, first.where) == ("axial_force", ("rail",))
    [(_, force, unit)] = first.found
    assert force == pytest.approx(stated, rel=0.02)
    assert unit == "N"


def test_a_limit_of_no_time_is_refused(clamped):
    with pytest.raises(sid.InputError, match="`seconds` must be greater than 0, got 0"):
        sid.explain(clamped, seconds=0)
    with pytest.raises(sid.InputError, match=r"`identification` must be what `identify` or .* gives, got int"):
        sid.explain(3)
