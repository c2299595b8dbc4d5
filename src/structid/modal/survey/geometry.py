"""Where the sensors of a record are: a file that the user gives, or what a universal file holds itself."""

from __future__ import annotations

from pathlib import Path

from structid.dof import Dof
from structid.errors import InputError
from structid.records import FrfRecord, Geometry, Record, read_geometry
from structid.records.io.uff.blocks import dataset_lines
from structid.records.io.uff.uff import SUFFIXES


def record_geometry(path: Path, record: Record, given: Path | None) -> Geometry | None:
    """The geometry in the file `given`, or else in the record's file `path`; None where there is none.

    Raises
    ------
    FileError
        If a geometry is there and damaged.
    InputError
        If the file that was given lacks a node with a sensor.
    """
    if given is None:
        own = path.suffix.lower() in SUFFIXES and any(dataset_lines(path, number) for number in (15, 2411))
        found = read_geometry(path) if own else None
        return found if found is not None and not _missing(record, found) else None
    geometry = read_geometry(given)
    missing = _missing(record, geometry)
    if missing:
        known = ", ".join(str(node) for node in list(geometry.nodes)[:12])
        raise InputError(
            f"{given}: has no node {missing[0].node}, where {missing[0]} is measured; its nodes are {known}"
        )
    return geometry


def _missing(record: Record, geometry: Geometry) -> list[Dof]:
    """Sensors at nodes that have no position."""
    sensors = record.outputs if isinstance(record, FrfRecord) else record.channels
    return [dof for dof in sensors if dof.node not in geometry.nodes]
