"""Friction elements that slide with the model's own amplitude."""

from __future__ import annotations

from dataclasses import dataclass

from scipy import sparse

from structid.observation.frf.sliding import require_one_load
from structid.records import FrfRecord
from structid.structure import Friction, Structure


@dataclass(frozen=True, eq=False)
class Contact:
    """A friction element that slides with the model's own amplitude: where its law and its force stand."""

    law: int
    value: int


def sliding_contacts(
    structure: Structure, laws: tuple[str, ...], record: FrfRecord, measured: set[str]
) -> tuple[tuple[Contact, ...], sparse.csc_array]:
    """Friction elements in harmonic balance, and the columns that read their sliding motion."""
    contacts, columns = [], [sparse.csc_array((structure.n_dofs, 0))]
    for element in structure.elements:
        if isinstance(element, Friction) and element.name not in measured:
            require_one_load(element, record)
            value = next(p.values.start for p in structure.properties if p.element == element.name)
            contacts.append(Contact(laws.index(f"friction:{element.name}"), value))
            slide = structure.selection(element.first)
            columns.append(slide if element.second is None else slide - structure.selection(element.second))
    return tuple(contacts), sparse.csc_array(sparse.hstack(columns))
