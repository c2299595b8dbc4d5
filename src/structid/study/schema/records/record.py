"""The ``[record]`` of a study file: where the measurement is, how it is read, and its noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from structid.core.constraints import Count, NotNegative, Positive
from structid.core.dof import Dof, parse_dofs
from structid.identification import setups
from structid.records import FrfRecord, TimeRecord, from_repeats, with_coherence_noise, with_declared_noise
from structid.records.formats import CsvLayout, ReadOptions, how_read, read_record
from structid.records.quality import CHANNEL_FAULTS, Finding
from structid.records.record import LOADS, Quantity, as_recorded, rename_channels, segment_duration
from structid.study.schema import records as record_kinds
from structid.study.schema.records.sensors import SENSORS, used_names
from structid.study.schema.section import InputFiles, Section
from structid.study.schema.tables import (
    CHANNEL_NAMES,
    NOISE_PART,
    PART,
    TEXT,
    TEXTS,
    Key,
    Table,
    as_list,
    choice,
    deferred,
    kind_of_argument,
    table_of,
)
from structid.study.schema.unknowns import CHANNEL_ERROR
from structid.unknowns.tolerances import Tolerances


@dataclass(frozen=True)
class NoiseSource:
    """Source of the noise of a record; the record's own statement if all fields have their defaults.

    Attributes
    ----------
    relative : float
        Noise as a part of each value's magnitude.
    absolute : float
        Noise in the SI unit of the record, added in quadrature.
    from_coherence : bool
        Whether it comes from the coherence and averages.
    averages : int, optional
        Number of averages behind the coherence, where the record does not say.
    """

    relative: Annotated[float, NOISE_PART] = 0.0
    absolute: NotNegative = 0.0
    from_coherence: bool = False
    averages: Count | None = None


@dataclass(frozen=True, eq=False)
class ChannelSource:
    """Choice of the channels of a record, and the names that the study gives them.

    Attributes
    ----------
    used : tuple of Dof
        Sensors used; all if empty.
    relabel : mapping of str to str
        See `renamed`.
    aimed : mapping of str to str
        What channels of ``[record.sensors]`` are called in the structure, by their name after `relabel`.
    supports : frozenset of Dof
        Those that drive the structure: accelerations there are inputs, see `Base`.
    """

    used: tuple[Dof, ...] = ()
    relabel: Mapping[str, str] = field(default_factory=dict)
    aimed: Mapping[str, str] = field(default_factory=dict)
    supports: frozenset[Dof] = frozenset()


@dataclass(frozen=True, eq=False)
class RecordSource:
    """Everything that is needed to read the record of a study.

    Attributes
    ----------
    section : Section
        ``[record]``, for the place of errors.
    paths : tuple of Path
        One file, or repeated measurements.
    options : ReadOptions
    channels : ChannelSource
    noise : NoiseSource
    frf : FrfSettings, optional
        How time histories become frequency response functions.
    window_decay : float, optional
        Known decay of an exponential window, 1/s: the FRF is H at s = decay + i omega.
    leakage : str, optional
        "hann" where segments of random motion under that window were averaged, each as long as one over the line spacing.
    time : TimeSource, optional
        How time histories are fitted themselves; their FRFs then only show the fit.
    modes : ModesSource, optional
        Measured modes in place of responses; what is told of responses then does not count.
    calibration : float, optional
        Standard deviation of the common gain of all channels, a part.
    """

    section: Section
    paths: tuple[Path, ...]
    options: ReadOptions
    channels: ChannelSource
    noise: NoiseSource
    frf: record_kinds.FrfSettings | None = None
    window_decay: float | None = None
    leakage: str | None = None
    time: record_kinds.TimeSource | None = None
    modes: record_kinds.ModesSource | None = None
    calibration: float | None = None


_ALWAYS = {
    "name": Key(TEXT, "What reports call the record"),
    "path": Key(TEXT, "The file: NPZ, NPY, HDF5, CSV, MAT or UFF by its suffix; of modes JSON, UFF or CSV"),
    "relabel": Key(
        CHANNEL_NAMES, "What sensors, or loads where no sensor is called so, are in truth, by their name in the file"
    ),
    "channels_used": Key(TEXTS, "Sensors used, whatever their sense; all by default"),
    "sensors": SENSORS,
}


def record_table(changes: Table) -> Table:
    """All keys of ``[record]``; `changes` are those of its ``[record.structure]``."""
    return table_of(ReadOptions) | {
        **_ALWAYS,
        "repeats": Key(TEXTS, "In place of `path`: two files or more of the same measurement, which give its noise"),
        "window_decay": Key(
            kind_of_argument(Positive), "Known decay of an exponential window on force and response, 1/s"
        ),
        "leakage": Key(
            choice("hann"),
            "Window of the segments of random motion that were averaged, each as long as one over the line spacing: lines"
            " then read what leaks from their neighbours",
        ),
        "calibration": Key(
            PART,
            "Standard deviation of the common gain of all channels, sensors over loads, a part; 0 where it is exact",
            default=Tolerances().calibration,
        ),
        "noise": Key(table_of(NoiseSource), "Noise that the file does not state"),
        "frf": Key(deferred(lambda: record_kinds.FRF), "How time histories become frequency response functions"),
        "time": Key(deferred(lambda: record_kinds.TIME), "How time histories are fitted themselves"),
        "modes": Key(deferred(lambda: record_kinds.MODES), "How measured modes are fitted"),
        "channel_error": Key(CHANNEL_ERROR, "Errors of sensors and load cells that are unknown", listed=True),
        "structure": Key(changes, "How the structure differed then"),
    }


def read_source(
    section: Section,
    files: InputFiles,
    aimed: Mapping[str, str] | None = None,
    supports: frozenset[Dof] = frozenset(),
    keys: Table | None = None,
) -> RecordSource:
    """The source that ``[record]`` describes; its files must exist but are not read, and are added to `files`.

    `aimed` gives the structure's names of sensors aimed in any direction, by channel; `supports` are the supports that
    drive the structure, in their positive directions. `keys` are the valid keys of another section that says where FRFs
    are; None for those of ``[record]``.

    Raises
    ------
    StudyError
        If a key cannot be used or a file is missing.
    """
    called = aimed or {}
    table = keys or record_table(Table())
    if "modes" in section.table:
        table = table.only(*_ALWAYS, "structure", "modes", "channel_error") | {
            "path": replace(_ALWAYS["path"], required=True)
        }
        modes = record_kinds.read_modes_source(section, table, files, called)
        channels = ChannelSource(modes.channels_used, modes.relabel, called)
        return RecordSource(section, (modes.path,), ReadOptions(), channels, NoiseSource(), modes=modes)
    values = section.values(table)
    if ("path" in values) == ("repeats" in values):
        raise section.error('needs `path = "frf.npz"`, or `repeats` with two files or more, and not both')
    key = "path" if "path" in values else "repeats"
    names = as_list(values[key])
    if key == "repeats" and len(names) < 2:
        raise section.error(f"noise from repeats needs at least 2 files, got {len(names)}", key)
    with section.located(key):
        paths = tuple(files.path(name) for name in names)
    with section.located("channels_used"):
        used = parse_dofs(as_list(values.get("channels_used", [])))
    frf = None
    inner, timed = section.section("frf"), section.section("time")
    if inner is not None:
        ends = {end: tuple(as_list(values.pop(end, []))) for end in ("inputs", "outputs")}
        frf = record_kinds.read_frf(inner, ends["inputs"], ends["outputs"])
    option_names = {item.name for item in fields(ReadOptions)}
    laid_out = section.section("csv")
    if laid_out is not None:
        values["csv"] = laid_out.read(CsvLayout)
    with section.located():
        options = ReadOptions(**{name: value for name, value in values.items() if name in option_names})
    time = None if timed is None else record_kinds.read_time(timed)
    if time is not None and section.section("noise") is not None:
        raise section.error(
            "is of frequency responses; with [record.time], `noise` or `relative_noise` there says the noise", "noise"
        )
    channels, noise = ChannelSource(used, values.get("relabel", {}), called, supports), declared_noise(section)
    decay, leakage = values.get("window_decay"), values.get("leakage")
    if leakage is not None and time is not None:
        raise section.error("is of averaged segments; [record.time] fits histories as they are", "leakage")
    if leakage is not None and frf is not None and frf.others.get("window", leakage) != leakage:
        raise section.error(f"is {leakage!r}, and the window in [record.frf] is another", "leakage")
    return RecordSource(
        section, paths, options, channels, noise, frf, decay, leakage, time, calibration=values.get("calibration")
    )


def declared_noise(section: Section) -> NoiseSource:
    """The noise that ``[record.noise]`` in the `section` of a record declares; no noise without it. Reads no file.

    Raises
    ------
    StudyError
        If it states no noise, declares it and takes it from coherence too, or stands beside repeats that give it.
    """
    repeats = "repeats" in section.table and "frf" not in section.table
    inner = section.section("noise")
    if inner is None:
        return NoiseSource()
    noise = inner.read(NoiseSource)
    declared = noise.relative + noise.absolute > 0
    if declared and (noise.from_coherence or noise.averages is not None):
        raise inner.error("gives noise both declared and from coherence; keep one of them")
    if repeats and (declared or noise.from_coherence):
        raise inner.error("the noise comes from `repeats`; leave [record.noise] out, or give one `path`")
    if not declared and not noise.from_coherence:
        raise inner.error("needs `relative` or `absolute` greater than 0, or `from_coherence = true`")
    return noise


def read_files(source: RecordSource) -> list[FrfRecord | TimeRecord]:
    """The records of a source as they are in its files, one for each file, with channels relabelled.

    Raises
    ------
    StudyError
        If a file is damaged, or holds what cannot be used.
    """
    with source.section.located("path" if "path" in source.section.table else "repeats"):
        return _read_files(source)


def faults(records: Sequence[FrfRecord | TimeRecord]) -> tuple[Finding, ...]:
    """Faults of single channels of time histories: dead, constant, clipped, with drop-outs, spikes or double hits.

    They come by record and channel; other findings on channels, as of an unusual level, and FRFs are left out.
    """
    histories = [record for record in records if isinstance(record, TimeRecord)]
    if not histories:
        return ()
    from structid.records.quality import channel_checks  # for histories alone

    checks = [one for record in histories for one in channel_checks(record)]
    return tuple(one for one in checks if one.kind in CHANNEL_FAULTS)


def load_record(source: RecordSource, read: Sequence[FrfRecord | TimeRecord] | None = None) -> FrfRecord:
    """The FRF record of a source, with its noise and the used sensors; time histories are averaged to FRFs.

    `read` are the records of its files if these were read before; by default they are read here.

    Raises
    ------
    StudyError
        If a file is damaged, holds what cannot be used, or lacks what the study asks for.
    """
    with source.section.located("path" if "path" in source.section.table else "repeats"):
        record = _make_frf_record(_read_files(source) if read is None else read, source)
    with (source.section.section("noise") or source.section).located():
        record = _add_noise(record, source.noise)
    if source.window_decay is not None:
        record = replace(record, decay=np.full(len(record.frequency), source.window_decay))
    if source.leakage is not None:
        with source.section.located("leakage"):
            record = replace(record, segment=segment_duration(record))
    with source.section.located("channels_used"):
        record = record.channels(as_recorded(source.channels.used, record)) if source.channels.used else record
    with source.section.located("sensors"):
        return rename_channels(record, used_names(source.channels.aimed, (*record.outputs, *record.inputs)))


def load_histories(
    source: RecordSource, time: record_kinds.TimeSource, read: Sequence[FrfRecord | TimeRecord] | None = None
) -> TimeRecord:
    """The time record of a source that is fitted as it is, with its noise, the used sensors and all loads.

    `read` are the records of its files if these were read before; by default they are read here. All sensors are used
    if the source names none.

    Raises
    ------
    StudyError
        If a file is damaged, holds FRFs, or lacks what the study asks for.
    """
    with source.section.located("path" if "path" in source.section.table else "repeats"):
        histories = [
            record for record in (_read_files(source) if read is None else read) if isinstance(record, TimeRecord)
        ]
        if not histories:
            raise time.section.error("the record holds frequency response functions; leave this section out")
        record = time.with_noise(histories)
    used = [dof.unsigned for dof in source.channels.used]
    pairs = list(zip(record.channels, record.quantities, strict=True))
    keep = [i for i, (dof, kind) in enumerate(pairs) if not used or kind in LOADS or dof.unsigned in used]
    missing = [
        str(dof) for dof in source.channels.used if dof.unsigned not in [dof_there.unsigned for dof_there, _ in pairs]
    ]
    if missing:
        raise source.section.error(f"the record has no channel {', '.join(missing)}", "channels_used")
    variance = None if record.variance is None else record.variance[keep]
    record = replace(
        record,
        values=record.values[:, keep],
        channels=tuple(record.channels[i] for i in keep),
        quantities=tuple(record.quantities[i] for i in keep),
        variance=variance,
    )
    with source.section.located("sensors"):
        return rename_channels(record, used_names(source.channels.aimed, record.channels))


def read_histories(source: RecordSource) -> list[TimeRecord]:
    """The time histories in the files of a source; an empty list where it holds FRFs or modes."""
    if source.modes is not None or (source.frf is None and source.time is None):
        return []
    return [record for record in _read_files(source) if isinstance(record, TimeRecord)]


def _read_files(source: RecordSource) -> list[FrfRecord | TimeRecord]:
    """The records of all files of a source, relabelled, with accelerations of supports that drive the structure as inputs."""
    records = [read_record(path, source.options) for path in source.paths]
    with source.section.located("relabel"):
        records = [rename_channels(record, source.channels.relabel) for record in records]
    with source.section.located("sensors"):
        for record in records:
            rename_channels(
                record, source.channels.aimed
            )  # whether every channel is there; they get these names when all is chosen
    driven = [_mark_support_motion(record, source.channels.supports) for record in records]
    return [
        replace(record, source=_named_shortly(record.source, path))
        for record, path in zip(driven, source.paths, strict=True)
    ]


def _named_shortly(source: str, path: Path) -> str:
    """The name of the file at `path`, then "; " and how it was read if `source` says so."""
    return "; ".join(filter(None, (path.name, how_read(source, path))))


def _mark_support_motion(record: FrfRecord | TimeRecord, supports: frozenset[Dof]) -> FrfRecord | TimeRecord:
    """The record with accelerations of `supports`, which drive the structure, marked as inputs.

    FRFs of accelerations become transmissibilities if all their inputs are such supports, since a force there would
    have no effect. Other records are returned unchanged.
    """
    if isinstance(record, FrfRecord):
        moved = record.kind == "accelerance" and all(dof.unsigned in supports for dof in record.inputs)
        return replace(record, kind="transmissibility") if moved else record
    pairs = zip(record.channels, record.quantities, strict=True)
    inputs = [quantity == "acceleration" and dof.unsigned in supports for dof, quantity in pairs]
    kinds: list[Quantity] = [
        "support_acceleration" if moved else quantity for moved, quantity in zip(inputs, record.quantities, strict=True)
    ]
    return replace(record, quantities=tuple(kinds))


def _make_frf_record(records: Sequence[FrfRecord | TimeRecord], source: RecordSource) -> FrfRecord:
    """A single FRF record from one file or from repeats, of FRFs or of histories, whose spectra are averaged.

    `StudyError` if the files are of both kinds, histories have no settings that say how to fit them, or FRFs have
    settings for histories.
    """
    responses = [record for record in records if isinstance(record, FrfRecord)]
    histories = [record for record in records if isinstance(record, TimeRecord)]
    if responses and histories:
        raise source.section.error(
            f"{histories[0].source} holds time histories and {responses[0].source} frequency response functions; give one kind",
            "repeats",
        )
    if histories:
        if source.frf is not None:
            return record_kinds.spectral_frf(histories, source.frf)
        if source.time is not None:
            return setups.frfs_of(histories[0])
        is_record = source.section.path[0] == "record"
        fit = ", or [record.time] with `relative_noise = 0.02` to fit them as they are" if is_record else ""
        raise source.section.error(
            f'the record holds time histories; add [{source.section.joined("frf")}], as in estimator = "H1", segment_length = 2048'
            f"{fit}"
        )
    if source.frf is not None:
        raise source.frf.section.error("the record holds frequency response functions already; leave this section out")
    return responses[0] if len(responses) == 1 else from_repeats(responses)


def _add_noise(record: FrfRecord, noise: NoiseSource) -> FrfRecord:
    """The FRF record with variances from declared noise or from coherence; else unchanged.

    Declared noise replaces that of the record; coherence is used if declared, or if the record has it and no variance.
    """
    if noise.relative + noise.absolute > 0:
        return with_declared_noise(record, noise.relative, noise.absolute)
    has_coherence = record.coherence is not None and record.averages is not None
    if noise.from_coherence or (record.variance is None and has_coherence):
        return with_coherence_noise(record, noise.averages)
    return record
