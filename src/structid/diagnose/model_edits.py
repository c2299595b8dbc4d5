"""Edits of a model and its records, each of which acts on set-ups and can be written into a study file as well."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np

from structid.core.dof import DIRECTIONS, Dof, dofs_of_text, parse_dof
from structid.core.errors import InputError
from structid.core.json_types import Tables, as_list
from structid.diagnose.study_tables import (
    NoStudyTextError,
    append,
    element_table,
    is_declaration_of,
    keep_elements,
    label_of,
    record_tables,
    release,
    rename_channels,
    support_tables,
    take_out_element,
)
from structid.diagnose.tested_model import ModelDraft, TestedModel
from structid.fem import ELEMENT_TYPES, Base, Constraint, RigidLink
from structid.fem.measuring_points import AimedSensor, unit_direction
from structid.forward import ChannelUnknown
from structid.identification import setups
from structid.records import FrfRecord, TimeRecord
from structid.records.record import segment_duration
from structid.unknowns import Unknown

if TYPE_CHECKING:
    from structid.modal import ModalRecord

_DIGITS = 6
_TIES: dict[str, type[RigidLink] | type[Constraint]] = {"rigid_link": RigidLink, "constraint": Constraint}


class Edit(Protocol):
    """One edit of a model and its records."""

    def apply(self, draft: ModelDraft) -> None:
        """Make the edit.

        Raises
        ------
        InputError
            If the model or its records have no place for it.
        """

    def write(self, study: Tables) -> None:
        """Write it into the tables of a study.

        Raises
        ------
        NoStudyTextError
            If the study has no line for it.
        """


Edits: TypeAlias = Sequence[Edit]


def rounded(value: float) -> float:
    """The value rounded to six significant digits, as it is written into a study."""
    return float(f"{value:.{_DIGITS}g}")


@dataclass(frozen=True)
class AddPart:
    """An element set, or a tie, in the structure of one record or of all.

    Attributes
    ----------
    table : str
        Type of the element set or tie as a study calls it, such as ``spring`` or ``rigid_link``.
    entry : mapping
        Arguments of the type, which are the keys of its table in a study.
    record : int, optional
        Position of the only record whose structure gets the part; None for all.
    """

    table: str
    entry: Mapping[str, Any]
    record: int | None = None

    def apply(self, draft: ModelDraft) -> None:
        """Add the element set or tie of type `self.table`, with the arguments `self.entry`, to a model draft.

        The draft changes in place: the structure of record `self.record`, or of all records where that is None.
        """
        structures = draft.structures if self.record is None else [draft.structure_of(self.record)]
        for structure in structures:
            if self.table in _TIES:
                structure.set("ties", (*structure.get("ties"), _TIES[self.table](**self.entry)))
            else:
                structure.set("elements", (*structure.get("elements"), ELEMENT_TYPES[self.table](**self.entry)))

    def write(self, study: Tables) -> None:
        table = study if self.record is None else record_tables(study)[self.record]
        append(table.setdefault("structure", {}), self.table, _plain_copy(self.entry))


@dataclass(frozen=True)
class AddUnknown:
    """A property of element sets among the unknowns, where a structure has them."""

    entry: Mapping[str, Any]

    def apply(self, draft: ModelDraft) -> None:
        """Declare the unknown in every record of the draft whose structure has some of its elements, for those alone.

        A record with fewer of the elements gets the unknown under the joint name of all, so that records share it.
        Records with none are unchanged.
        """
        names = as_list(self.entry["elements"])
        for record in draft.records:
            there = {element.name for element in record.structure.get("elements")}
            there |= {item.element for item in record.structure.original.properties}
            there |= {f"node {node}" for node in record.structure.get("sliding")}
            kept = [name for name in names if name in there or str(name).rpartition(":")[0] in there]
            label = ", ".join(names) if len(kept) < len(names) else None
            if kept:
                given = {"name": label, **self.entry, "elements": kept if len(kept) > 1 else kept[0]}
                record.unknowns.append(Unknown(**given))

    def write(self, study: Tables) -> None:
        append(study, "unknown", _plain_copy(self.entry))


@dataclass(frozen=True)
class ReleaseSupport:
    """A degree of freedom that is not held any more."""

    dof: Dof

    def apply(self, draft: ModelDraft) -> None:
        for structure in draft.structures:
            structure.set("fixed", tuple(held for held in structure.get("fixed") if held.unsigned != self.dof))

    def write(self, study: Tables) -> None:
        freed = [release(table, self.dof) for table in support_tables(study)]
        if not any(freed):
            raise NoStudyTextError(f"{self.dof.place} is held by a group of a mesh; hold it by `fixed` to release it")


@dataclass(frozen=True)
class HoldSupports:
    """Degrees of freedom that are held from now on."""

    dofs: tuple[str, ...]

    def apply(self, draft: ModelDraft) -> None:
        for structure in draft.structures:
            structure.set("fixed", (*structure.get("fixed"), *map(parse_dof, self.dofs)))

    def write(self, study: Tables) -> None:
        for table in support_tables(study):
            table["fixed"] = [*as_list(table.get("fixed", [])), *self.dofs]


@dataclass(frozen=True)
class AddNode:
    """A new node, by its distance from another.

    Attributes
    ----------
    label, beside : int
    towards : int, optional
        Another node, `part` of the way to which it is.
    part : float
    offset : (float, float, float)
        In m, besides.
    """

    label: int
    beside: int
    towards: int | None = None
    part: float = 0.0
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def _position(self, nodes: Mapping[Any, Any], key: Callable[[int], Any]) -> list[float]:
        """Coordinates, m, of the new node: those of node `self.beside` plus `self.offset`, moved towards another node.

        It is moved by `self.part` of the distance from node `self.beside` to `self.towards`, if that is not None, and
        then rounded to six digits. `nodes` maps keys to coordinates, and `key` makes such a key of a node label. There
        are as many coordinates as node `self.beside` has.
        """
        first = np.atleast_1d(np.asarray(nodes[key(self.beside)], dtype=float))
        moved = first + np.array(self.offset[: len(first)])
        if self.towards is not None:
            moved = moved + self.part * (np.asarray(nodes[key(self.towards)], dtype=float) - first)
            return [rounded(x) for x in moved.tolist()]
        return moved.tolist()

    def apply(self, draft: ModelDraft) -> None:
        for structure in draft.structures:
            nodes = structure.get("nodes")
            structure.set("nodes", {**nodes, self.label: self._position(nodes, int)})

    def write(self, study: Tables) -> None:
        """Write the new node, with its coordinates, into [structure.nodes] of the tables `study`, in place.

        Raises
        ------
        NoStudyTextError
            If the study does not list there the node that it lies beside.
        """
        nodes = study["structure"].get("nodes")
        if nodes is None or str(self.beside) not in nodes:
            raise NoStudyTextError(
                f"a new node beside node {self.beside} needs [structure.nodes], where that is listed"
            )
        nodes[str(self.label)] = self._position({key: as_list(x) for key, x in nodes.items()}, str)


@dataclass(frozen=True)
class LetNodeSlide:
    """A node whose position along its bars and beams is a property."""

    node: int

    def apply(self, draft: ModelDraft) -> None:
        for structure in draft.structures:
            structure.set("sliding", (*structure.get("sliding"), self.node))

    def write(self, study: Tables) -> None:
        table = study["structure"]
        table["sliding"] = [*as_list(table.get("sliding", [])), self.node]


@dataclass(frozen=True)
class MoveBaseSupport:
    """Edit: the support at `dof` that drives the structure passes, with its direction and sign, to the node `label`."""

    dof: Dof
    label: int

    def apply(self, draft: ModelDraft) -> None:
        """Move the driving support of the bases in a model draft to the node `label`, in the same direction."""
        for structure in draft.structures:
            bases = [
                Base(base.name, [self._moved(support) for support in base.supports]) for base in structure.get("bases")
            ]
            structure.set("bases", tuple(bases))

    def _moved(self, support: Dof) -> Dof:
        return Dof(self.label, support.direction, support.sign) if support.unsigned == self.dof else support

    def write(self, study: Tables) -> None:
        """Replace the driving support by that of the new node, in place, in each [[structure.base]] of `study`.

        A support with a minus sign keeps it; bases without the support stay.
        """
        for base in study["structure"].get("base", []):
            supports = [one for text in as_list(base["supports"]) for one in dofs_of_text(str(text))]
            if all(one.unsigned != self.dof for one in supports):
                continue
            moved = [self._moved(one) for one in supports]
            base["supports"] = [one.place if one.sign > 0 else f"{one.place}-" for one in moved]


@dataclass(frozen=True)
class RenameChannels:
    """Channels of a record by other names; ``load 3X`` is a load.

    `sensors` and `loads` are the present names of all its channels, such as ``3X``; see `renamed_channels`.
    """

    record: int
    names: Mapping[str, str]
    sensors: frozenset[str]
    loads: frozenset[str]

    def apply(self, draft: ModelDraft) -> None:
        draft.records[self.record].rename_channels(dict(self.names))

    def write(self, study: Tables) -> None:
        """Write the new names of channels into the ``relabel`` table of the record in the tables `study`, in place.

        Raises
        ------
        NoStudyTextError
            If a channel is listed in [record.sensors], where it must be renamed, or the study leaves open whether a
            name is of a sensor or of a load.
        """
        record = record_tables(study)[self.record]
        if any(name.removeprefix("load ") in record.get("sensors", {}) for name in self.names):
            raise NoStudyTextError("a channel of [record.sensors] is renamed there")
        rename_channels(record, dict(self.names), self.sensors, self.loads)


def renamed_channels(model: TestedModel, record: int, names: Mapping[str, str]) -> RenameChannels:
    """Edit that gives channels of the record at index `record` of `model` other names, by present ones (``load 3X``)."""
    channels = dict(model.setups[record].channels)
    sensors, loads = (frozenset(dof.place for dof in channels.get(role, ())) for role in ("output", "input"))
    return RenameChannels(record, names, sensors, loads)


@dataclass(frozen=True)
class AimSensor:
    """Edit: the sensor at `dof` of a record reads along `direction`, parts along global X, Y and Z.

    It then sits at a new node, `label`, that is tied to its own.
    """

    record: int
    dof: Dof
    direction: tuple[float, float, float]
    label: int

    def apply(self, draft: ModelDraft) -> None:
        """Make the sensor of a record of the draft read along `self.direction`, at a new node tied to its node.

        The new node has the label `self.label` and the same position; the channel is renamed to its first translation
        that the model has.

        Raises
        ------
        InputError
            If nodes of the model do not translate.
        """
        structure = draft.structure_of(self.record)
        moves = [d for d in DIRECTIONS[:3] if d in (structure.original.active or ())]
        if not moves:
            raise InputError(
                f"{self.dof} cannot be aimed: nodes of this model only turn; let them move along X, Y or Z too"
            )
        seen = moves[0]
        tie = AimedSensor(
            f"sensor {self.dof.place}", self.dof.place, self.label, seen, self.dof.node, unit_direction(self.direction)
        )
        nodes = structure.get("nodes")
        structure.set("nodes", {**nodes, self.label: nodes[self.dof.node]})
        structure.set("ties", (*structure.get("ties"), tie))
        draft.records[self.record].rename_channels({self.dof.place: f"{self.label}{seen}"})

    def write(self, study: Tables) -> None:
        """Write the direction of the sensor into [record.sensors] of its record in the tables `study`, in place.

        Raises
        ------
        NoStudyTextError
            If the study has an entry for this sensor there.
        """
        sensors = record_tables(study)[self.record].setdefault("sensors", {})
        if self.dof.place in sensors:
            raise NoStudyTextError(f"the direction of {self.dof.place} is given in the study already")
        sensors[self.dof.place] = {"direction": list(self.direction)}


@dataclass(frozen=True)
class AddChannelError:
    """An error of channels of a record among the unknowns."""

    record: int
    entry: Mapping[str, Any]

    def apply(self, draft: ModelDraft) -> None:
        """Declare the channel error as an unknown of its record in a model draft.

        Raises
        ------
        InputError
            If the record is of modes and the error is no sensor gain, or if it is of histories that are not fitted as spectra.
        """
        record, entry = draft.records[self.record], self.entry
        is_sensor_gain = "outputs" in entry and entry["property"] == "gain"
        if not isinstance(record.get("record"), FrfRecord | TimeRecord) and not is_sensor_gain:
            raise InputError("of errors of channels, modes show the gains of sensors only")
        if isinstance(record.get("record"), TimeRecord) and record.get("settings").fit != "spectra":
            raise InputError("errors of channels are parameters of histories only where they are fitted as spectra")
        record.channel_unknowns.append(ChannelUnknown(**entry))

    def write(self, study: Tables) -> None:
        append(record_tables(study)[self.record], "channel_error", _plain_copy(self.entry))


@dataclass(frozen=True)
class UseChannels:
    """Edit: only the sensors `outputs` of a record are used."""

    record: int
    outputs: tuple[str, ...]

    def apply(self, draft: ModelDraft) -> None:
        draft.records[self.record].use_channels(self.outputs)

    def write(self, study: Tables) -> None:
        record_tables(study)[self.record]["channels_used"] = list(self.outputs)


@dataclass(frozen=True)
class ExcludeLines:
    """Stretches of frequency, Hz, that are left out."""

    spans: tuple[tuple[float, float], ...]

    def apply(self, draft: ModelDraft) -> None:
        draft.options = replace(draft.options, exclude=(*draft.options.exclude, *self.spans))

    def write(self, study: Tables) -> None:
        method = study.setdefault("method", {})
        method["exclude"] = [*(list(span) for span in method.get("exclude", [])), *(list(s) for s in self.spans)]


@dataclass(frozen=True)
class AddTones:
    """Steady tones, Hz, in histories of a record."""

    record: int
    tones: tuple[float, ...]

    def apply(self, draft: ModelDraft) -> None:
        record = draft.records[self.record]
        settings = record.get("settings")
        record.set("settings", replace(settings, tones=(*settings.tones, *self.tones)))

    def write(self, study: Tables) -> None:
        time = record_tables(study)[self.record]["time"]
        time["tones"] = [*as_list(time.get("tones", [])), *self.tones]


@dataclass(frozen=True)
class RemoveRecord:
    """Edit: the record at index `record`, from 0, is left out; `InputError` if it is the only one."""

    record: int

    def apply(self, draft: ModelDraft) -> None:
        if len(draft.records) < 2:
            raise InputError("the only record cannot be left out")
        del draft.records[self.record]

    def write(self, study: Tables) -> None:
        del study["record"][self.record]


@dataclass(frozen=True)
class UseModes:
    """Edit: only the given modes of a record are used, by their numbers from 1."""

    record: int
    numbers: tuple[int, ...]

    def apply(self, draft: ModelDraft) -> None:
        record = draft.records[self.record]
        record.set("record", setups.chosen_modes(record.get("record"), self.numbers))

    def write(self, study: Tables) -> None:
        modes = record_tables(study)[self.record].setdefault("modes", {})
        before = modes.get("use") or ()
        modes["use"] = [before[number - 1] for number in self.numbers] if before else list(self.numbers)


@dataclass(frozen=True)
class AverageSegments:
    """The FRFs of all records are averages of segments under a Hann window."""

    def apply(self, draft: ModelDraft) -> None:
        """Declare the FRFs of all records of the draft averages of Hann segments.

        Each segment is as long (s) as the inverse of the line spacing (Hz).

        Raises
        ------
        InputError
            If a record is not of FRFs, or its lines are uneven.
        """
        for record in draft.records:
            frfs = record.get("record")
            if not isinstance(frfs, FrfRecord):
                raise InputError("only averaged frequency responses read what leaks between lines")
            record.set("record", replace(frfs, segment=segment_duration(frfs)))

    def write(self, study: Tables) -> None:
        for record in record_tables(study):
            record["leakage"] = "hann"


@dataclass(frozen=True)
class ScaleAxis:
    """All frequencies of all records times a factor, those of the band too."""

    factor: float

    def apply(self, draft: ModelDraft) -> None:
        """Multiply frequencies, sampling rates, tones, bands and excluded spans of a model draft by `self.factor`."""
        for record in draft.records:
            record.set("record", self._scale_axis(record.get("record")))
            if isinstance(record.get("record"), TimeRecord):
                shown, settings = record.get("shown"), record.get("settings")
                record.set("shown", None if shown is None else self._scale_axis(shown))
                record.set("settings", replace(settings, tones=tuple(self.factor * tone for tone in settings.tones)))
        options = draft.options
        bands = {name: self._span(getattr(options, name)) for name in ("band", "evaluation_band")}
        draft.options = replace(options, exclude=tuple(map(self._span, options.exclude)), **bands)

    def _span(self, span: tuple[float, float] | None) -> Any:
        return None if span is None else (self.factor * span[0], self.factor * span[1])

    def _scale_axis(self, record: FrfRecord | TimeRecord | ModalRecord) -> FrfRecord | TimeRecord | ModalRecord:
        """Record with its frequencies or sampling rate multiplied by `self.factor`, and segment lengths divided by it.

        In the covariance of modal parameters the rows and columns of frequencies are scaled, those of damping ratios
        are not.
        """
        if isinstance(record, TimeRecord):
            return replace(record, sampling_rate=self.factor * record.sampling_rate)
        if isinstance(record, FrfRecord):
            segment = None if record.segment is None else record.segment / self.factor
            return replace(record, frequency=self.factor * record.frequency, segment=segment)
        sizes = np.repeat([self.factor, 1.0], record.n_modes)
        covariance = None if record.covariance is None else record.covariance * np.outer(sizes, sizes)
        return replace(record, frequency=self.factor * record.frequency, covariance=covariance)

    def write(self, study: Tables) -> None:
        """Write the scaled sampling rates, tones, bands and exclusions into the tables `study`, in place.

        Raises
        ------
        NoStudyTextError
            If a record has no ``sampling_rate`` in the study.
        """
        for record in record_tables(study):
            if "sampling_rate" not in record:
                raise NoStudyTextError("the record file says its axis; correct it there")
            record["sampling_rate"] = rounded(self.factor * float(record["sampling_rate"]))
            fit = record.get("time", {})
            if "tones" in fit:
                fit["tones"] = [rounded(self.factor * float(tone)) for tone in as_list(fit["tones"])]
        method = study.get("method", {})
        for key in ("band", "evaluation_band"):
            if key in method:
                method[key] = [rounded(self.factor * end) for end in method[key]]
        if "exclude" in method:
            method["exclude"] = [[rounded(self.factor * end) for end in span] for span in method["exclude"]]


@dataclass(frozen=True)
class SubdivideElements:
    """Edit: each beam is cut into `pieces` equal elements."""

    pieces: int

    def apply(self, draft: ModelDraft) -> None:
        for structure in draft.structures:
            structure.set("subdivide", self.pieces)

    def write(self, study: Tables) -> None:
        study["structure"]["subdivide"] = self.pieces


@dataclass(frozen=True)
class SetProperty:
    """Edit: the property `property_name` of the element set `name` gets another nominal `value`, SI unit."""

    name: str
    property_name: str
    value: float | list[float]

    def apply(self, draft: ModelDraft) -> None:
        for structure in draft.structures:
            elements = tuple(
                replace(element, **{self.property_name: self.value}) if element.name == self.name else element
                for element in structure.get("elements")
            )
            structure.set("elements", elements)

    def write(self, study: Tables) -> None:
        element_table(study, self.name)[self.property_name] = self.value


@dataclass(frozen=True)
class MoveMass:
    """Edit: point mass `number`, from 1, of the set `name` sits at the node `label`.

    The set gets the `directions` if it has none of its own.
    """

    name: str
    number: int
    label: int
    directions: tuple[str, ...]

    def apply(self, draft: ModelDraft) -> None:
        for structure in draft.structures:
            structure.set("elements", tuple(self._moved(element) for element in structure.get("elements")))

    def _moved(self, element: Any) -> Any:
        """Element set with its mass `self.number` (from 1) at the new node; other sets are returned as they are.

        It moves in `self.directions` if it states no directions.
        """
        if element.name != self.name:
            return element
        nodes = element.nodes.ravel().copy()
        nodes[self.number - 1] = self.label
        return replace(element, nodes=nodes, directions=element.directions or self.directions)

    def write(self, study: Tables) -> None:
        """Write the new node of the mass, and the directions in which it moves, into the table of its element set.

        The tables `study` are changed in place. Directions that the table has stay.

        Raises
        ------
        NoStudyTextError
            If the table of the set lists no nodes.
        """
        entry = element_table(study, self.name)
        if "nodes" not in entry:
            raise NoStudyTextError(f"{self.name}:{self.number} is at no node that the study lists")
        nodes = list(as_list(entry["nodes"]))
        nodes[self.number - 1] = self.label
        entry["nodes"] = nodes
        entry.setdefault("directions", list(self.directions))


@dataclass(frozen=True)
class SeparateElement:
    """One element of a set, or a whole set of several, with a parameter of its own: a factor on what it has.

    Attributes
    ----------
    where : str
        Such as ``girder:2`` or ``girder``.
    property_name : str
    start : float
        Value at which the factor starts.
    count : int
        Elements of the set.
    nominal : mapping of str to tuple of float
        What the model says of the property, of each element of each set that has it.
    follows : str, optional
        Parameter whose factor it takes instead.
    """

    where: str
    property_name: str
    start: float
    count: int
    nominal: Mapping[str, tuple[float, ...]] = field(hash=False)
    follows: str | None = None

    def _take_out(self, entries: Sequence[Tables]) -> None:
        """Take the element or set out of those unknowns in `entries` (tables, changed in place) that declare its property.

        Raises
        ------
        InputError
            If it has a parameter already, or if it is a whole set and an unknown is for this set alone or for parts of
            it.
        """
        name, _, number = self.where.rpartition(":")
        name = name or self.where
        own = [entry for entry in entries if is_declaration_of(entry, name, self.property_name)]
        if any(entry.get("each") or entry.get("field") for entry in own):
            raise InputError(f"{self.where} has a parameter of its own already")
        for entry in own:
            texts = [str(text) for text in as_list(entry["elements"])]
            values = {value for text in texts for value in self.nominal.get(text, self._of_span(text))}
            if ":" in self.where:
                take_out_element(entry, name, int(number), self.count, len(values) > 1)
                continue
            kept = [text for text in texts if text != name]
            if len(kept) in (0, len(texts)):
                raise InputError(f"{name} is no whole set of a group with one value")
            keep_elements(entry, kept, len(values) > 1)

    def _of_span(self, text: str) -> tuple[float, ...]:
        """Nominal values of the elements of the set in a text such as ``girder:2-3``; empty if the set is not known."""
        return self.nominal.get(text.rpartition(":")[0], ())

    def apply(self, draft: ModelDraft) -> None:
        """Declare a separate factor for the element or set in every record of a model draft.

        Raises
        ------
        InputError
            If it has a separate parameter already, or is no whole set of a group with one value.
        """
        for record in draft.records:
            entries = _as_tables(record.unknowns)
            self._take_out(entries)
            record.unknowns[:] = [Unknown(**entry) for entry in entries if as_list(entry["elements"])]
        AddUnknown(self._entry).apply(draft)

    @property
    def _entry(self) -> dict[str, Any]:
        what = {"property": self.property_name, "elements": self.where, "factor": True}
        return what | ({"start": self.start} if self.follows is None else {"tied_to": self.follows})

    def write(self, study: Tables) -> None:
        self._take_out(study["unknown"])
        AddUnknown(self._entry).write(study)


@dataclass(frozen=True)
class LetVary:
    """A parameter with a value of its own in each record."""

    name: str

    def _mark(self, entries: Sequence[Tables]) -> bool:
        """Mark the first of the unknowns `entries` that is named `self.name` as varying from record to record.

        True if there is one. The entries are changed in place. Unknowns declared with ``each`` do not count.
        """
        for entry in entries:
            if label_of(entry) == self.name and not entry.get("each"):
                entry["varies"] = True
                return True
        return False

    def apply(self, draft: ModelDraft) -> None:
        """Let the parameter vary from record to record in a model draft.

        Raises
        ------
        InputError
            If no unknown declares this parameter alone.
        """
        marked = False
        for record in draft.records:
            entries = _as_tables(record.unknowns)
            marked = self._mark(entries) or marked
            record.unknowns[:] = [Unknown(**entry) for entry in entries]
        if not marked:
            raise InputError(
                f"{self.name} is one of several parameters of a declaration; declare it alone to let it vary"
            )

    def write(self, study: Tables) -> None:
        if not self._mark(study["unknown"]):
            raise NoStudyTextError(f"{self.name} is one of several parameters of an [[unknown]]")


def _as_tables(unknowns: Sequence[Unknown]) -> list[dict[str, Any]]:
    """The unknowns as tables of a study, one dict of field names and values for each."""
    return [{item.name: getattr(one, item.name) for item in fields(Unknown)} for one in unknowns]


def _plain_copy(entry: Mapping[str, Any]) -> dict[str, Any]:
    """A copy of a table in which tuples, and tuples in lists, are lists, as TOML needs them."""
    return {
        key: [list(x) if isinstance(x, tuple) else x for x in value] if isinstance(value, tuple | list) else value
        for key, value in entry.items()
    }
