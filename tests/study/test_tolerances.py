"""Tolerances and calibrations as a study file states them, and what of them is refused."""

from __future__ import annotations

import pytest

from structid.core.errors import StructidError
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study
from structid.unknowns.tolerances import EXACT, Tolerances
from study_cases import CHAIN, write_chain


def study(folder, structure="", record="", upper=""):
    text = CHAIN.replace('active = ["X"]\n', f'active = ["X"]\n{structure}\n', 1)
    text = text.replace('path = "frf.npz"\n', f'path = "frf.npz"\n{record}\n', 1)
    text = text.replace('name = "upper"\n', f'name = "upper"\n{upper}\n', 1)
    return load_study(write_chain(folder, text))


@pytest.mark.parametrize(
    ("line", "tolerances"),
    [
        ("", Tolerances()),
        ("tolerance = 0.005", Tolerances(0.005, 0.005)),
        ("tolerance = 0", Tolerances(0.0, 0.0, 0.0, 0.01)),
        ("tolerance = { stiffness = 0.03, damping = 0.5 }", Tolerances(stiffness=0.03, damping=0.5)),
    ],
)
def test_the_structure_states_tolerances(tmp_path, line, tolerances):
    assert study(tmp_path, structure=line).options.tolerances == tolerances


def test_a_record_states_its_calibration(tmp_path):
    assert study(tmp_path).setups[0].record.calibration is None
    assert prepare_study(study(tmp_path, record="calibration = 0.03")).setups[0].calibration == 0.03
    assert EXACT.calibration == 0.0


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (
            {"structure": "tolerance = -0.1"},
            r"line 5: \[structure\] tolerance: must be a part from 0 to 1.*got -0.1; write 0.015 for 1.5 %",
        ),
        (
            {"structure": "tolerance = { mass = -0.2 }"},
            "'mass': -0.2}; write 0.015 for 1.5 %, 0 for an exact value, or leave",
        ),
        ({"structure": "tolerance = { length = 0.1 }"}, "takes mass, stiffness, damping, got 'length'"),
        ({"record": "calibration = 1.5"}, r"\[record\] calibration: must be a number of at least 0 and at most 1"),
        ({"record": "tolerance = 0.1"}, r"\[record\] tolerance: unknown key; the nearest is `calibration`"),
        ({"upper": "tolerance = 1.5"}, r'"upper" tolerance: must be a part from 0 to 1'),
        (
            {"upper": "tolerance = { mass = 0.1 }"},
            "must name its properties, got 'mass'; they are stiffness, loss_factor",
        ),
        ({"upper": "tolerance = 0.02"}, "`tolerance` of 'upper' is of stiffness, which is an unknown"),
    ],
)
def test_bad_tolerances_are_named_with_their_place(tmp_path, lines, words):
    with pytest.raises(StructidError, match=words):
        study(tmp_path, **lines)
