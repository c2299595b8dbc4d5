"""What people hand over by mistake: single things in place of lists, and objects of another class."""

import numpy as np
import pytest

import structid as sid
from structid.core.errors import InputError
from structid.identification.identify import identify_together


def cantilever(fixed=("0Y", "0RZ")):
    beam = sid.Beam("beam", [[0, 1], [1, 2]], mass=2.0, bending_stiffness=150.0, loss_factor=0.01)
    return sid.Structure({0: 0.0, 1: 0.3, 2: 0.6}, beam, fixed)


CANTILEVER = cantilever()
MASS = sid.Unknown("mass", "beam")
LINES = np.arange(5.0, 50.0)
RECORD = sid.FrfRecord(LINES, np.ones((45, 1, 1)), "2Y", "2Y", "accelerance")


def test_one_thing_alone_is_a_list_of_one():
    assert [dof.place for dof in cantilever("0Y").fixed] == ["0Y"]
    assert len(cantilever().elements) == 1
    assert [dof.place for dof in RECORD.outputs] == ["2Y"]
    assert sid.parameters(cantilever(), MASS).names == ("mass[beam]",)


@pytest.mark.parametrize(
    "structure, unknown, record, words",
    [
        (None, None, RECORD, "`structure` must be of class Structure, got NoneType; make it by `Structure"),
        (cantilever(), [MASS], RECORD, "`unknown` must be of class Parameters, got list; make it by `parameters"),
        (cantilever(), None, "hammer.csv", "`record` must be of class FrfRecord, got str; make it by `read_record`"),
    ],
)
def test_arguments_of_another_class_are_refused_with_what_makes_them(structure, unknown, record, words):
    unknown = unknown or sid.parameters(cantilever(), [MASS])
    with pytest.raises(InputError) as refused:
        sid.identify(structure, unknown, record)
    assert str(refused.value).startswith(words)


def test_nodes_unknowns_and_rates_of_another_kind_are_refused():
    with pytest.raises(InputError, match="`nodes` must be a mapping of label to position, got list"):
        sid.Structure([0.0, 0.3], [])
    with pytest.raises(InputError, match="declarations of class Unknown, got tuple"):
        sid.parameters(cantilever(), [("mass", "beam")])
    with pytest.raises(InputError, match="`sampling_rate` must be one positive number, got an array; the samples come"):
        sid.TimeRecord(np.zeros((9, 1)), 100.0, ["2Y"], ["force"])


def setup_of(**more):
    given = {"structure": CANTILEVER, "parameters": sid.parameters(CANTILEVER, MASS), "record": RECORD} | more
    return sid.Setup(**given)


@pytest.mark.parametrize(
    ("setups", "words"),
    [
        (None, "`setups` must be of class Iterable, got NoneType; give a list of set-ups"),
        (5, "`setups` must be of class Iterable, got int; give a list of set-ups"),
        ((one for one in [5]), "`setups[0]` must be of class RecordSetup, got int; make it by `Setup`"),
        (
            [setup_of(parameters=[MASS])],
            "`setups[0].parameters` must be of class Parameters, got list; make it by `par",
        ),
        ([setup_of(record="x")], "`setups[0].record` must be of class FrfRecord, got str; make it by `read_record`"),
        (
            [setup_of(parameters=sid.parameters(CANTILEVER, []), channel_unknowns=[sid.ChannelUnknown("gain", "2Y")])],
            "nothing is unknown beside the errors of channels; give `parameters(structure, unknowns)` at least one",
        ),
    ],
)
def test_setups_of_another_kind_are_refused_with_what_makes_them(setups, words):
    with pytest.raises(InputError) as refused:
        identify_together(setups)
    assert str(refused.value).startswith(words)
