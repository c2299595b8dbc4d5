"""The ``[record.frf]`` of a study file: how time histories become frequency response functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from structid.core.constraints import Limits
from structid.core.dof import Dof, parse_dofs
from structid.core.errors import InputError
from structid.records import FrfRecord, TimeRecord
from structid.records.record import LOADS
from structid.records.transforms.spectra import frf_from_time, require_repeated
from structid.study.schema.kinds import COUNT, NUMBER, TEXT, TEXTS, Kind, as_list, choice, limited
from structid.study.schema.section import Section
from structid.study.schema.tables import Given, Key, table_of

_MOTIONS = ("displacement", "velocity", "acceleration")
_WINDOW = Kind(
    'a window of scipy.signal.get_window, as in "hann" or ["exponential", 0.0, 200.0]',
    {"anyOf": [TEXT.schema, {"type": "array", "minItems": 1, "items": {"anyOf": [TEXT.schema, NUMBER.schema]}}]},
    lambda value: isinstance(value[0], str),
    lambda value: tuple(value) if isinstance(value, list) else value,
)
FRF = table_of(
    frf_from_time,
    ("records", "inputs", "outputs"),
    overlap=limited(NUMBER, Limits(least=0, below=1)),
    segment_length=COUNT,
    window=_WINDOW,
    quantity=choice(*_MOTIONS),
) | {
    "inputs": Key(TEXTS, "Force channels; all that the record has by default"),
    "outputs": Key(TEXTS, "Motion channels; all by default"),
}


@dataclass(frozen=True, eq=False)
class FrfSettings:
    """Arguments of `frf_from_time`.

    Attributes
    ----------
    section : Section
        ``[record.frf]``, for the place of errors.
    inputs, outputs : tuple of Dof
        Force and motion channels; all that the record has if empty.
    others : dict
        The other arguments, by name.
    """

    section: Section
    inputs: tuple[Dof, ...]
    outputs: tuple[Dof, ...]
    others: Given


def read_frf(section: Section, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> FrfSettings:
    """The settings in ``[record.frf]``; its channels default to those of ``[record]``."""
    values = section.values(FRF)
    channels = {}
    for key, outer in (("inputs", inputs), ("outputs", outputs)):
        with section.located(key):
            channels[key] = parse_dofs(as_list(values.pop(key, list(outer))))
    return FrfSettings(section, channels["inputs"], channels["outputs"], values)


def spectral_frf(records: Sequence[TimeRecord], settings: FrfSettings) -> FrfRecord:
    """FRFs from averaged spectra of one time record, or of repeats.

    Raises
    ------
    StudyError
        If channels are missing or the settings do not fit the record.
    """
    require_repeated(records)
    with settings.section.located():
        inputs = settings.inputs or _channels(records[0], LOADS)
        if not inputs:
            raise InputError(
                "the record has no force channel; say which channel is the load with `units` or `quantities`"
            )
        wanted = settings.others.get("quantity")
        motions = (wanted,) if wanted else _MOTIONS
        outputs = settings.outputs or _channels(records[0], motions)
        if wanted and not outputs:
            available = ", ".join(dict.fromkeys(records[0].quantities))
            raise InputError(f"no channel of the record is of {wanted}; they are of {available}", "quantity")
        return frf_from_time(records, inputs, outputs, **settings.others)


def _channels(record: TimeRecord, quantities: tuple[str, ...]) -> tuple[Dof, ...]:
    pairs = zip(record.channels, record.quantities, strict=True)
    return tuple(dict.fromkeys(dof for dof, quantity in pairs if quantity in quantities))
