"""What FRFs a solver must give: the lines and channels of the records of a study."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import Dof
from structid.identification.options import IdentifyOptions
from structid.identification.setups.frf import used_lines
from structid.records import FrfRecord
from structid.study.schema.method import read_method
from structid.study.schema.records.record import load_record, read_source
from structid.study.schema.root import InputFiles, record_sections
from structid.study.schema.section import Section

#: Sections of a record for which FRFs alone do not do, and what stands in place of each.
_NOT_OF_FRFS = {
    "modes": "measured modes ask for modes of the solver",
    "time": "time histories are fitted by matrices or modes of the solver; average them by [record.frf]",
    "structure": "a structure that differs from record to record asks for matrices or modes of the solver",
    "sensors": "sensors that are turned ask for matrices or modes of the solver; let it write FRFs in their directions",
    "leakage": "leakage is taken into account by matrices or modes of the solver",
    "window_decay": "a window is taken into account by matrices or modes of the solver; correct the record for it",
}


class WantedFrfs(NamedTuple):
    """Lines (n_lines,), Hz, and channels, each once."""

    frequency: FloatArray
    outputs: tuple[Dof, ...]
    inputs: tuple[Dof, ...]


def wanted_frfs(own: Section, files: InputFiles) -> WantedFrfs:
    """The lines and channels that all records need from the solver; lines only inside the band or the evaluation band.

    Parameters
    ----------
    own : Section
        ``[structure.solver]``.
    files : InputFiles

    Raises
    ------
    StudyError
        If there is no record, or one that no FRFs explain, or the structure holds more than the solver.
    """
    root = Section(own.source, (), own.source.table)
    structure = root.inner("structure")
    for key, value in structure.table.items():
        if key == "tolerance" and value != 0:
            raise structure.error(
                "cannot be carried where a solver gives FRFs alone, which do not say what its model holds: leave it out, or write"
                ' 0; the `calibration` of a [record] is carried, and `gives = "matrices"` or `"modes"` carries tolerances',
                key,
            )
        if key not in ("solver", "nodes", "tolerance"):
            raise structure.error(
                "stands beside a solver that gives FRFs alone, so that it cannot act on them; put it in the deck, or take `gives ="
                ' "matrices"` or `"modes"`',
                key,
            )
    sections = record_sections(root)
    if not sections:
        raise own.error(
            '`gives = "frfs"` needs a [record]: it says at which lines and places the solver is to give FRFs'
        )
    options = read_method(root.section("method"))
    records = [_read_frf_record(one, files) for one in sections]
    lines = [line for record in records for line in _lines(record, options)]
    outputs = tuple(dict.fromkeys(dof.unsigned for record in records for dof in record.outputs))
    inputs = tuple(dict.fromkeys(dof.unsigned for record in records for dof in record.inputs))
    return WantedFrfs(np.unique(lines), outputs, inputs)


def _read_frf_record(section: Section, files: InputFiles) -> FrfRecord:
    """The FRF record of a section; `StudyError` if it is nothing that a solver's FRFs can be compared with."""
    for key, words in _NOT_OF_FRFS.items():
        if key in section.table:
            raise section.error(f'is nothing for a solver with `gives = "frfs"`: {words}', key)
    record = load_record(read_source(section, files))
    if record.is_per_motion:
        raise section.error(
            'holds transmissibilities, and the solver gives motion per force; take `gives = "matrices"`'
        )
    return record


def _lines(record: FrfRecord, options: IdentifyOptions) -> list[float]:
    used = used_lines(record, options).frequency.tolist()
    return used if options.evaluation_band is None else used + record.band(*options.evaluation_band).frequency.tolist()
