"""The models and records of an identification, and drafts in which edits change them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from structid.core.dof import renamed
from structid.core.errors import InputError
from structid.fem import Structure
from structid.fem.measuring_points import AimedSensor
from structid.forward import ChannelUnknown
from structid.identification.options import IdentifyOptions
from structid.identification.setups.setup import AnySetup
from structid.records import FrfRecord, TimeRecord
from structid.records.record import rename_channels
from structid.unknowns import Unknown
from structid.unknowns.parameters import redeclared


@dataclass(frozen=True, eq=False)
class TestedModel:
    """The set-ups of an identification and its options: all that a cause may change.

    Attributes
    ----------
    setups : tuple of RecordSetup
    options : IdentifyOptions
    """

    __test__ = False  # no class of tests

    setups: tuple[AnySetup, ...]
    options: IdentifyOptions

    def unique_name(self, words: str) -> str:
        """`words` as a name for a new part, with a number behind (from 2) where an element set or tie has this name already."""
        taken = {element.name for setup in self.setups for element in setup.structure.elements}
        taken |= {tie.name for setup in self.setups for tie in setup.structure.ties}
        return next(name for name in (words, *(f"{words} {k}" for k in range(2, 1000))) if name not in taken)

    def new_node(self) -> int:
        """An unused node label: one more than the largest of all structures, channels and aimed sensors."""
        labels = [max(setup.structure.nodes) for setup in self.setups]
        labels += [dof.node for setup in self.setups for _, dofs in setup.channels for dof in dofs]
        labels += [tie.label for setup in self.setups for tie in setup.structure.ties if isinstance(tie, AimedSensor)]
        return max(labels) + 1


class StructureDraft:
    """A structure while it is edited; records on the same structure share it."""

    def __init__(self, original: Structure) -> None:
        self.original = original
        self._changes: dict[str, Any] = {}
        self._built: Structure | None = None

    def get(self, argument: str) -> Any:
        """Current value of an argument of `Structure`, edits included."""
        return self._changes.get(argument, getattr(self.original, argument))

    def set(self, argument: str, value: object) -> None:
        self._changes[argument] = value

    def build(self) -> Structure:
        """The edited structure, made once; the original where nothing was edited."""
        if self._built is None:
            self._built = replace(self.original, **self._changes) if self._changes else self.original
        return self._built

    def copy(self) -> StructureDraft:
        """A separate draft of the same structure with all edits so far, for records that are edited alone."""
        twin = StructureDraft(self.original)
        twin._changes = dict(self._changes)
        return twin


class RecordDraft:
    """One record and its model while they are edited."""

    def __init__(self, setup: AnySetup, structure: StructureDraft) -> None:
        """A draft with the unknowns and channel unknowns of a set-up, on the draft of its structure.

        Records with the same structure may share that draft.
        """
        self.setup = setup
        self.structure = structure
        self.unknowns: list[Unknown] = list(setup.parameters.unknowns)
        self.channel_unknowns: list[ChannelUnknown] = list(setup.channel_unknowns)
        self._changes: dict[str, Any] = {}

    def get(self, argument: str) -> Any:
        """Current value of an argument of the set-up, edits included."""
        return self._changes.get(argument, getattr(self.setup, argument))

    def set(self, argument: str, value: object) -> None:
        self._changes[argument] = value

    def rename_channels(self, names: dict[str, str]) -> None:
        """Rename channels of the record by a mapping from old names to new ones, such as ``3X`` to ``4X-``.

        A name such as ``load 3X`` stands for a load; a minus at the end of a new name reverses the sign.
        """
        record = self.get("record")
        if not isinstance(record, FrfRecord | TimeRecord):
            self.set("record", replace(record, channels=renamed(record.channels, (), names)[0]))
            return
        self.set("record", rename_channels(record, names))
        if isinstance(record, TimeRecord):
            shown = self.get("shown")
            self.set("shown", None if shown is None else _renamed_where_there(shown, names))

    def use_channels(self, outputs: Sequence[str]) -> None:
        """Keep only the sensors of the record at the degrees of freedom `outputs`, such as ``3X``; loads stay.

        Support motions stay too. FRFs averaged from a history are cut in the same way.
        """
        record = self.get("record")
        if isinstance(record, FrfRecord):
            self.set("record", record.channels(tuple(dof for dof in record.outputs if dof.place in outputs)))
        elif isinstance(record, TimeRecord):
            is_load = [quantity in ("force", "support_acceleration") for quantity in record.quantities]
            pairs = zip(record.channels, is_load, strict=True)
            keep = [k for k, (dof, load) in enumerate(pairs) if load or dof.place in outputs]
            kept = replace(
                record,
                values=record.values[:, keep],
                channels=tuple(record.channels[k] for k in keep),
                quantities=tuple(record.quantities[k] for k in keep),
                variance=None if record.variance is None else record.variance[keep],
            )
            self.set("record", kept)
            shown = self.get("shown")
            if shown is not None:
                self.set("shown", shown.channels(tuple(dof for dof in shown.outputs if dof.place in outputs)))
        else:
            self.set(
                "record", record.some_channels([k for k, dof in enumerate(record.channels) if dof.place in outputs])
            )

    def build(self) -> AnySetup:
        """The edited set-up; the original object where nothing was edited.

        Raises
        ------
        InputError
            If the unknowns must be declared again, and the parameters were not made from declarations.
        """
        setup, structure = self.setup, self.structure.build()
        is_declared_anew = self.unknowns != list(setup.parameters.unknowns)
        if is_declared_anew or structure is not setup.structure:
            if not setup.parameters.unknowns:
                raise InputError("`parameters` must be made by `parameters` of unknowns, which a change declares again")
            unknown = redeclared(setup.parameters, structure, self.unknowns)
        else:
            unknown = setup.parameters
        errors = tuple(self.channel_unknowns)
        is_same_model = structure is setup.structure and unknown is setup.parameters
        if is_same_model and errors == tuple(setup.channel_unknowns) and not self._changes:
            return setup
        changed: AnySetup = replace(setup, **self._changes) if self._changes else setup  # type: ignore[type-var]
        return changed.modelled_by(structure, unknown, errors)


class ModelDraft:
    """A tested model while edits are made."""

    def __init__(self, model: TestedModel) -> None:
        """Drafts of all records of `model`; records with the same structure share its draft."""
        self.model = model
        self.options = model.options
        drafts: dict[int, StructureDraft] = {}
        self.records = [
            RecordDraft(setup, drafts.setdefault(id(setup.structure), StructureDraft(setup.structure)))
            for setup in model.setups
        ]

    def is_kept(self, number: int) -> bool:
        """True if the record at index `number` of the model as it was is still in the draft."""
        return any(record.setup is self.model.setups[number] for record in self.records)

    @property
    def structures(self) -> list[StructureDraft]:
        """The structures of all records, each once."""
        return list({id(record.structure): record.structure for record in self.records}.values())

    def structure_of(self, number: int) -> StructureDraft:
        """Draft of one record's structure, split off from those of other records so that edits change it alone.

        `number` is the index of the record, from 0.
        """
        record = self.records[number]
        if sum(other.structure is record.structure for other in self.records) > 1:
            record.structure = record.structure.copy()
        return record.structure

    def build(self) -> TestedModel:
        """The edited model.

        Raises
        ------
        InputError
            If there is no such model.
        """
        return TestedModel(tuple(record.build() for record in self.records), self.options)


def _renamed_where_there(record: FrfRecord, names: dict[str, str]) -> FrfRecord:
    """FRFs with new names for those channels that they have; names of other channels in `names`, old to new, are ignored."""
    places = {dof.place for dof in record.outputs} | {f"load {dof.place}" for dof in record.inputs}
    places |= {dof.place for dof in record.inputs}
    return rename_channels(record, {name: other for name, other in names.items() if name in places})
