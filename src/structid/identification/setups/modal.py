"""Measured modes as a record of a study: how they are fitted, and what the fit shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, NamedTuple, Self

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.display import join_words, plural
from structid.core.dof import Dof
from structid.core.errors import InputError
from structid.fem import Structure
from structid.forward import ChannelUnknown, ModalProblem, ModalSettings
from structid.forward.channel_errors import ChannelErrors, ChannelsOfRecord, channel_errors
from structid.forward.modal.output import unpaired_modes
from structid.identification.modal_fit import ModalFit, modal_fit
from structid.identification.options import IdentifyOptions
from structid.identification.record_fit import FittedUnknowns
from structid.identification.setups.setup import Prepared, RecordSetup
from structid.modal import ModalRecord
from structid.unknowns import Parameters

_BY_MAC = (
    "shapes count by their MAC, which has no noise model: intervals and verdict are those of the weight `shape_error`; leave"
    " `shape_form` out to judge the answer"
)
_BARE = (
    "no shape entry is known: modes are paired by frequency alone, and one that the test missed, or that the model has"
    " elsewhere, moves all values; one shape entry at one sensor helps"
)
#: Factor beyond the model's range of frequencies, at its initial values, from where on a measured mode is none of the model
#: whatever the values are: initial stiffnesses are rarely off by more than a factor of 4, which moves frequencies by 2.
_FAR_BEYOND = 2.0


class _Sensors(NamedTuple):
    """Channels that errors may be declared on: sensors, no loads, and the frequencies (n_modes,) of the modes, Hz."""

    outputs: tuple[Dof, ...]
    inputs: tuple[Dof, ...]
    frequency: FloatArray


@dataclass(frozen=True, eq=False)
class ModalSetup(RecordSetup[ModalProblem]):
    """Measured modes and what they were measured on.

    Parameters
    ----------
    structure : Structure
    parameters : Parameters
    record : ModalRecord
        With its covariance, which the parameters inherit.
    settings : ModalSettings
    name : str
    channel_unknowns : sequence of ChannelUnknown
        Gains of sensors; one at least keeps its own, as shapes have no scale.
    """

    record_class: ClassVar = ModalRecord

    structure: Structure
    parameters: Parameters
    record: ModalRecord
    settings: ModalSettings = field(default_factory=ModalSettings)
    name: str = ""
    channel_unknowns: Sequence[ChannelUnknown] = ()

    def prepared(self, options: IdentifyOptions) -> Prepared[ModalProblem]:
        """The problem of the measured modes, with warnings of the record; `options` are not used.

        Further warnings say where shapes count by MAC, or no shape is known.
        """
        errors = self.channel_errors(self.channel_unknowns)
        problem = ModalProblem(self.structure, self.parameters, self.record, self.settings, errors)
        weighed = (_BY_MAC,) if self.settings.shape_form == "mac" else ()
        bare = () if problem.data.has_shapes else (_BARE,)
        return Prepared(problem, (*self.record.warnings, *weighed, *bare))

    def without_modes_beyond_model(self) -> Self:
        """The set-up without measured modes far beyond those of a model with too few; itself if there are none.

        The record gets a warning that names them. A mode is far beyond if it lies by a factor of more than 2 above, or below, all
        frequencies of the model at its initial values and all measured ones that are kept. The set-up is left as it is too in
        the form ``dynamic``, which needs no pairing, and if the sensors see no mode of the model.

        Raises
        ------
        InputError
            If the model has too few modes, and those that it leaves unpaired are not far beyond, with what to do.
        """
        if self.settings.form == "dynamic":  # needs no pairing
            return self
        problem = ModalProblem(self.structure, self.parameters, self.record, self.settings)
        state = problem.model.state(problem.physical(problem.theta_start))
        left, model = unpaired_modes(problem.data, state)
        if not left.size or not model.size:
            return self
        frequency, low, high = self.record.frequency[left], model.min(), model.max()
        listed = join_words([f"{f:.5g}" for f in frequency])
        counts = (
            f"at its initial values the model has {plural(len(model), 'mode')} that the sensors see, from {low:.5g} to {high:.5g}"
            " Hz,"
        )
        keep = np.setdiff1d(np.arange(self.record.n_modes), left)
        kept = self.record.frequency[keep]
        is_above = frequency > _FAR_BEYOND * max(high, kept.max())
        is_below = frequency < min(low, kept.min()) / _FAR_BEYOND
        if not (is_above | is_below).all():
            raise InputError(
                f"{counts} and {len(problem.data.measured)} are measured: none is left for {listed} Hz; refine the model,"
                " or leave a mode that is none of the structure out with `use`"
            )
        words = (
            f"{counts} and none for {listed} Hz: left out of the fit; refine the model if it is a mode of the structure"
        )
        record = self.record.some_modes(keep)
        return replace(self, record=replace(record, warnings=(*record.warnings, words)))

    def modelled_by(
        self, structure: Structure, parameters: Parameters, channel_unknowns: Sequence[ChannelUnknown] = ()
    ) -> ModalSetup:
        return replace(self, structure=structure, parameters=parameters, channel_unknowns=channel_unknowns)

    def channel_errors(
        self, unknowns: Sequence[ChannelUnknown], lines: ChannelsOfRecord | None = None
    ) -> ChannelErrors | None:
        sensors = lines or _Sensors(self.record.channels, (), self.record.frequency)
        return channel_errors(sensors, unknowns) if unknowns else None

    @property
    def channels(self) -> tuple[tuple[str, tuple[Dof, ...]], ...]:
        return (("output", self.record.channels),)

    def words(self, options: IdentifyOptions) -> str:
        """Sentence part on the modes of the record: number, frequencies, sensors, source."""
        record = self.record
        span = f"{record.frequency[0]:.5g} to {record.frequency[-1]:.5g} Hz"
        return f"{record.n_modes} modes from {span} at {len(record.channels)} sensors{record.unknown_words}, {record.source}"

    def modal_fit(
        self, title: str, problem: ModalProblem, fitted: FittedUnknowns, options: IdentifyOptions
    ) -> ModalFit:
        return modal_fit(title, problem, fitted, options.n_modes)


def chosen_modes(record: ModalRecord, numbers: Sequence[int]) -> ModalRecord:
    """Record with only the modes of these `numbers`, counted from 1, in increasing order; all of them without numbers.

    Raises
    ------
    InputError
        If a number is none of a mode, or is given twice.
    """
    if not numbers:
        return record
    if len(set(numbers)) < len(numbers) or not set(numbers) <= set(range(1, record.n_modes + 1)):
        raise InputError(f"must be different numbers from 1 to {record.n_modes}, got {list(numbers)}")
    return record.some_modes(np.asarray(numbers) - 1)
