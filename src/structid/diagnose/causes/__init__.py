"""Causes of a misfit: one class a kind, in one file, with its sentence, its places, its effect and its edits.

To add a cause: a file with a class of `Candidate` here, a line in `CAUSES`, and a fault in `tests/diagnose/faults.py`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np

from structid.core.arrays import FloatArray
from structid.diagnose.causes.appendage import Appendage
from structid.diagnose.causes.axial_force import AxialForce
from structid.diagnose.causes.between import LoadBetween, SensorBetween
from structid.diagnose.causes.candidate import Candidate, has_places
from structid.diagnose.causes.channel_left_out import FaultyChannel
from structid.diagnose.causes.clock import Clock
from structid.diagnose.causes.damping_law import DampingLaw
from structid.diagnose.causes.dashpot import Dashpot
from structid.diagnose.causes.delay import LoadDelay, SensorDelay
from structid.diagnose.causes.direction import LoadDirection, SensorDirection
from structid.diagnose.causes.extra_mode import ExtraMode
from structid.diagnose.causes.fixed_value import FixedValue
from structid.diagnose.causes.friction import DryFriction
from structid.diagnose.causes.gain import LoadGain, RecordGain, SensorGain
from structid.diagnose.causes.joint import FlexibleJoint
from structid.diagnose.causes.leakage import Leakage
from structid.diagnose.causes.mass import Mass
from structid.diagnose.causes.mesh import CoarseMesh
from structid.diagnose.causes.node_place import NodePlace
from structid.diagnose.causes.offset import MassOffset
from structid.diagnose.causes.outlying_lines import OutlyingLines
from structid.diagnose.causes.polarity import LoadPolarity, SensorPolarity
from structid.diagnose.causes.position import LoadPosition, SensorPosition
from structid.diagnose.causes.record_left_out import OtherState
from structid.diagnose.causes.rotary_inertia import AddedRotaryInertia
from structid.diagnose.causes.sensor_mass import SensorMass
from structid.diagnose.causes.separate_element import DifferingElement
from structid.diagnose.causes.separate_set import DifferingSet
from structid.diagnose.causes.shear import ShearFlexibility
from structid.diagnose.causes.spring import SpringToGround
from structid.diagnose.causes.support import Support
from structid.diagnose.causes.swap import SwappedLoads, SwappedSensors
from structid.diagnose.causes.tone import Tone
from structid.diagnose.causes.turned_section import TurnedSection
from structid.diagnose.causes.variation import RecordVariation
from structid.diagnose.causes.window import ExponentialWindow
from structid.diagnose.receptances import Receptances
from structid.diagnose.tested_model import TestedModel
from structid.forward import RecordProblem

#: Changes of the model whose effects follow from its receptances.
OF_MODEL: tuple[type[Candidate], ...] = (
    Support, FlexibleJoint, SpringToGround, Dashpot, DryFriction, Appendage, AddedRotaryInertia, MassOffset, Mass,
    SensorMass, DifferingElement, DifferingSet,
)  # fmt: skip
#: Changes of channels: those that any model shows, and those that need its receptances.
OF_CHANNELS: tuple[type[Candidate], ...] = (
    SensorGain, LoadGain, RecordGain, SensorDelay, LoadDelay, SensorPolarity, LoadPolarity, SwappedSensors, SwappedLoads,
)  # fmt: skip
OF_PLACES: tuple[type[Candidate], ...] = (SensorDirection, LoadDirection, SensorBetween, LoadBetween)
#: Changes whose effect is that of the changed model itself.
OF_SETS: tuple[type[Candidate], ...] = (
    CoarseMesh, ShearFlexibility, DampingLaw, FixedValue, RecordVariation, ExponentialWindow, Leakage, Clock, AxialForce,
    NodePlace, TurnedSection,
)  # fmt: skip
#: Data that are left out, or have a part that no force made.
OF_DATA = (FaultyChannel, OtherState)
OF_RESIDUAL = (ExtraMode, OutlyingLines, Tone)
#: Changes that follow from the look at others; see `structid.diagnose.screening.derived_candidates`.
DERIVED: tuple[type[Candidate], ...] = (SensorPosition, LoadPosition)
#: Every kind of cause.
CAUSES: tuple[type[Candidate], ...] = (
    *OF_MODEL, *OF_CHANNELS, *OF_PLACES, *OF_SETS, *OF_DATA, *OF_RESIDUAL, *DERIVED,
)  # fmt: skip

LeftOut = FaultyChannel | OtherState | ExtraMode | OutlyingLines


def candidates(records: Sequence[Receptances], record_names: Sequence[str] = ("",)) -> list[Candidate]:
    """All candidates whose effects follow from receptances, for records of one structure at one set of parameters.

    Parameters
    ----------
    records : sequence of Receptances
        The first gives the structure; a change of the structure is one in all records.
    record_names : sequence of str
        Name of each record. Where there are several, each may have additional masses alone.

    Returns
    -------
    list of Candidate
        Without those of nodes and elements where the model is too large for them.
    """
    kinds = (*OF_MODEL, *OF_CHANNELS, *OF_PLACES) if has_places(records[0].problem) else OF_CHANNELS
    return list(chain.from_iterable(kind.from_receptances(records, record_names) for kind in kinds))


def exchanged_channels(records: Sequence[Receptances]) -> list[Candidate]:
    """Candidates for exchanged and reversed sensors and loads, which have no strength to fit.

    A model that was fitted to such channels is bent to them, so that they are looked for at the initial model.
    """
    kinds = (SensorPolarity, LoadPolarity, SwappedSensors, SwappedLoads)
    return list(chain.from_iterable(kind.from_receptances(records, ("",)) for kind in kinds))


def set_candidates(model: TestedModel, problems: Sequence[RecordProblem]) -> list[Candidate]:
    """Candidates whose effect needs the changed model itself: those of whole sets, the mesh, the records, and nodes."""
    return list(chain.from_iterable(kind.from_model(model, problems) for kind in OF_SETS))


def data_candidates(
    problems: Sequence[RecordProblem], record_names: Sequence[str]
) -> Iterator[FaultyChannel | OtherState]:
    """Candidates that leave out a record, then those that leave out a channel; `record_names` has the name of each record."""
    yield from OtherState.from_data(problems, record_names)
    yield from FaultyChannel.from_data(problems, record_names)


def residual_candidates(problems: Sequence[RecordProblem], residual: FloatArray) -> list[Candidate]:
    """Modes, lines and tones that stand out from the whitened data rows (n_rows,) of all problems."""
    return list(chain.from_iterable(kind.from_residual(problems, residual) for kind in OF_RESIDUAL))


def rows_left_out(candidate: Candidate, problems: Sequence[RecordProblem]) -> np.ndarray:
    """A mask (n_rows,) over the data rows of all problems, True where `candidate` leaves them out.

    `candidate` must be of a kind that leaves data out.
    """
    assert isinstance(candidate, LeftOut)
    return np.concatenate([
        candidate.rows_left_out(problem) if number == candidate.record else np.zeros(problem.n_data, dtype=bool)
        for number, problem in enumerate(problems)
    ])  # fmt: skip
