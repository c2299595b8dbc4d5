"""Measured modes that the model cannot have: never called approximate, however the shapes fit."""

from dataclasses import replace

import numpy as np
import pytest
from chain_cases import SENSORS, STIFFNESS, chain, record
from scipy import linalg

from structid import Beam, ModalRecord, Spring, Status, Structure, Unknown, identify, parameters
from structid.diagnose.verdict import clock_or_stiffness, judged
from structid.identification.identify import identify_together
from structid.identification.setups.modal import ModalSettings, ModalSetup
from structid.modal.modal_record import independent_errors


def measured(coupling):
    """All modes of the chain with a spring from each mass to the one after the next, to 0.1 %, shapes to 0.3 %."""
    own = chain()
    beside = Spring("beside", ["1X", "2X"], ["3X", "4X"], stiffness=coupling)
    true = Structure(own.nodes, [*own.elements, beside], own.fixed, active=["X"])
    squares, shapes = linalg.eigh(true.matrix("stiffness").toarray(), true.matrix("mass").toarray())
    frequency = np.sqrt(squares) / (2 * np.pi)
    shapes = shapes / shapes[np.abs(shapes).argmax(axis=0), np.arange(4)]
    covariance = np.diag(np.r_[1e-3 * frequency, np.full(4, 1e-3)] ** 2)
    std = np.full(shapes.shape, 3e-3)
    return ModalRecord(frequency, np.full(4, 0.01), shapes, [f"{i}X" for i in range(1, 5)], covariance, shape_std=std)


def found(coupling, **settings):
    unknown = parameters(chain(), [Unknown("stiffness", "k", each=True)])
    return identify_together([ModalSetup(chain(), unknown, measured(coupling), ModalSettings(**settings))])


def test_modes_that_the_model_misses_make_it_wrong():
    answer = found(200.0)
    assert answer.estimate.status is Status.CONVERGED
    judgement = judged(answer)
    assert judgement.verdict == "wrong_model"
    assert "misses the resonance at" in judgement.words


@pytest.mark.parametrize(("coupling", "settings"), [(1e-6, {}), (200.0, {"frequency_error": 0.1, "shape_error": 0.2})])
def test_modes_within_what_is_stated_of_them_do_not(coupling, settings):
    assert judged(found(coupling, **settings)).verdict in ("sound", "approximate")


@pytest.mark.parametrize("away", [(), (0,)])
def test_a_wrong_model_that_is_not_determined_is_wrong_all_the_same(away):
    unknown = parameters(chain((900.0,) * 4), [Unknown("stiffness", "k")])
    answer = identify(chain((900.0,) * 4), unknown, record(chain(STIFFNESS, (2.0, 2.0, 3.0, 1.5))))
    lost = replace(answer, ran_away=away, estimate=replace(answer.estimate, status=Status.NOT_IDENTIFIABLE))
    assert judged(lost).verdict == "wrong_model"


@pytest.mark.parametrize(
    ("scale", "starts", "is_told"),
    [
        (1.03, STIFFNESS, True),
        (0.97, STIFFNESS, True),
        (1.0, STIFFNESS, False),
        (1.03, tuple(k * f for k, f in zip(STIFFNESS, (1, 1, 1.3, 0.8), strict=True)), False),
    ],
)
def test_stiffnesses_that_all_moved_together_may_be_a_clock(scale, starts, is_told):
    """All frequencies are `scale` times those of the model; it is not told where the starts differ from it one by one."""
    modes = measured(1e-6)
    modes = replace(modes, frequency=scale * modes.frequency)
    begun = chain(starts)
    unknown = parameters(begun, [Unknown("stiffness", "k", each=True)])
    judgement = judged(identify_together([ModalSetup(begun, unknown, modes)]))
    assert judgement.verdict in ("sound", "approximate")
    assert ("All stiffnesses moved together" in judgement.words) is is_told
    if is_told:
        assert f"read 3 % too {'high' if scale > 1 else 'low'}" in judgement.words


@pytest.mark.parametrize(("kind", "is_told"), [("accelerance", True), ("receptance", False)])
def test_accelerations_cannot_tell_a_clock_from_all_stiffnesses_either(kind, is_told):
    """Of displacements a clock changes the size as well: 1.03 times the frequencies are no common factor on stiffnesses."""
    measured_frf = record(chain(tuple(1.03**2 * k for k in STIFFNESS))).as_kind(kind)
    unknown = parameters(chain(), [Unknown("stiffness", "k", each=True)])
    words = judged(identify(chain(), unknown, measured_frf)).words
    assert ("All stiffnesses moved together, to 1.06 times their starts: accelerations cannot" in words) is is_told


def test_a_fixed_stiffness_tells_a_clock_from_stiffnesses():
    """Stiffnesses that all moved by 6 % beside a fixed spring, whose modes are not those of a clock."""
    own, factors = chain(), (1.0, 1.06)
    held = [Structure(own.nodes, [*chain(tuple(f * k for k in STIFFNESS)).elements,
                                  Spring("held", ["4X"], stiffness=300.0)], own.fixed, active=["X"]) for f in factors]  # fmt: skip
    unknown = parameters(held[0], [Unknown("stiffness", "k", each=True)])
    answer = identify_together([ModalSetup(held[0], unknown, modes_of(held[1], SENSORS))])
    assert answer.estimate.values == pytest.approx(1.06 * np.array(STIFFNESS), rel=1e-3)
    assert clock_or_stiffness(answer) == ""


@pytest.mark.parametrize(
    ("force", "factor", "axial_stiffness", "unknown_force", "is_told"),
    [
        (0.0, 1.0, 0.0, False, True),
        (0.0, 1.0, 1e6, False, True),  # no axial motion is in the model
        (4000.0, 1.0, 0.0, False, False),
        (4000.0, 1.0, 0.0, True, False),
        (4000.0, 1.1, 0.0, True, True),
        (-1000.0, 1.1, 0.0, True, True),
    ],
)
def test_an_axial_force_counts_as_a_stiffness(force, factor, axial_stiffness, unknown_force, is_told):
    """The bending stiffnesses are 10 % larger than their starts, the force is `factor` times its start."""

    def beam(stiffer, tenser):
        nodes = {i + 1: (float(i), 0.0) for i in range(7)}
        parts = [
            Beam(name, [(i, i + 1) for i in range(first, first + 3)], mass=2.0, bending_stiffness=stiffer * bending,
                 axial_stiffness=axial_stiffness, axial_force=tenser * force)
            for name, first, bending in (("left", 1, 1e4), ("right", 4, 2e4))
        ]  # fmt: skip
        return Structure(nodes, parts, ["1Y", "7Y"], active=["Y", "RZ"])

    properties = ("bending_stiffness", "axial_force") if unknown_force else ("bending_stiffness",)
    sought = [Unknown(what, name) for what in properties for name in ("left", "right")]
    start = beam(1.0, 1.0)
    record = modes_of(beam(1.1, factor), [f"{i}Y" for i in range(2, 7)])
    answer = identify_together([ModalSetup(start, parameters(start, sought), record)])
    assert answer.estimate.values[:2] == pytest.approx([1.1e4, 2.2e4], rel=1e-3)
    words = clock_or_stiffness(answer)
    assert ("moved together, to 1.1 times" in words) is is_told
    assert ("axial forces" in words) is (is_told and unknown_force)


def modes_of(structure, channels):
    """The first four modes of a structure at `channels`, frequencies to 0.1 %, shapes to 0.3 %."""
    squares, shapes = linalg.eigh(structure.matrix("stiffness").toarray(), structure.matrix("mass").toarray())
    names = [str(dof).rstrip("+") for dof in structure.dofs]
    frequency, shapes = np.sqrt(squares[:4]) / (2 * np.pi), shapes[[names.index(name) for name in channels], :4]
    shapes = shapes / np.abs(shapes).max(axis=0)
    none = np.full(4, np.nan)
    errors = independent_errors(np.r_[1e-3 * frequency, none])
    return ModalRecord(frequency, none, shapes, channels, errors, shape_std=np.full(shapes.shape, 3e-3))
