"""The records of a study file, each with what the structure was like then and the errors of its channels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from structid.fem import Structure
from structid.forward import ChannelUnknown
from structid.identification.setups.setup import AnySetup
from structid.study.schema.model.structure import read_structure
from structid.study.schema.records.record import RecordSource, read_source
from structid.study.schema.records.sensors import channel_names
from structid.study.schema.root import InputFiles, record_sections
from structid.study.schema.section import Section
from structid.study.schema.unknowns import CHANNEL_ERROR, read_parameters, read_prior
from structid.unknowns import Parameters


@dataclass(frozen=True, eq=False)
class SetupSource:
    """One record of a study and what it was measured on; nothing of the record's content has been read yet.

    Attributes
    ----------
    name : str
        "" where the study gives none.
    structure : Structure
        With the changes that ``[record.structure]`` makes.
    parameters : Parameters
        Of that structure.
    record : RecordSource
    channel_unknowns : tuple of ChannelUnknown
    """

    name: str
    structure: Structure
    parameters: Parameters
    record: RecordSource
    channel_unknowns: tuple[ChannelUnknown, ...]

    @property
    def section(self) -> Section:
        """``[record]``."""
        return self.record.section

    def require_channels(self, setup: AnySetup) -> None:
        """Raise `StudyError` at a ``channel_error`` whose channel the record of `setup` lacks, or that repeats an entry."""
        for count, entry in enumerate(self.section.sections("channel_error"), 1):
            with entry.located():
                setup.channel_errors(self.channel_unknowns[:count])


def read_setups(root: Section, files: InputFiles, before: Sequence[SetupSource] = ()) -> tuple[SetupSource, ...]:
    """The set-ups of ``[record]`` or several ``[[record]]``; those with the same tables share one structure.

    Parameters
    ----------
    root : Section
        The whole study file.
    files : InputFiles
        List of input files, to which those of the set-ups are added.
    before : sequence of SetupSource
        Set-ups of an earlier version of the study; their structures are reused where their tables are equal.

    Raises
    ------
    StudyError
        If one of them, the structure or the unknowns cannot be read, or two records have the same name.
    """
    records, structure = record_sections(root), root.inner("structure")
    if not records:
        raise root.error("holds no record; write [record] or [[record]] above its keys", "record")
    made_of = [(_structure_tables(source.section), source.structure) for source in before]
    for record in records:
        tables = _structure_tables(record)
        made = next((known for own, known in made_of if own == tables), None)
        made_of.append((tables, made or read_structure(structure, files, record.section("structure"), record)))
    structures = [made for _, made in made_of[len(before) :]]
    known = frozenset(element.name for made in structures for element in (*made.elements, *made.sets))
    names: set[str] = set()
    setups = []
    for record, made in zip(records, structures, strict=True):
        unknown = read_parameters(root, made, known)
        errors = tuple(_channel_error(entry) for entry in record.sections("channel_error"))
        aimed = channel_names(made)
        source = read_source(record, files, aimed, made.base_supports)
        name = str(record.table.get("name", ""))
        if name and name in names:
            raise record.error(f"two records are called {name!r}; give one of them another name", "name")
        names.add(name)
        setups.append(SetupSource(name, made, unknown, source, errors))
    return tuple(setups)


def _structure_tables(record: Section) -> tuple[object, ...]:
    """All tables that the structure of a record is made of."""
    return record.source.table["structure"], record.table.get("structure"), record.table.get("sensors")


def _channel_error(entry: Section) -> ChannelUnknown:
    return ChannelUnknown(**entry.values(CHANNEL_ERROR), prior=read_prior(entry))
