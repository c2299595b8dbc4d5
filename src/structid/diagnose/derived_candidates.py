"""Changes that no linear look is taken at, which follow from those that one promises much of."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from structid.core.dof import Dof
from structid.core.errors import InputError
from structid.diagnose.causes import LoadPosition, SensorPolarity, SensorPosition
from structid.diagnose.causes.delay import SensorDelay
from structid.diagnose.causes.fixed_value import fixed_values
from structid.diagnose.causes.offset import MassOffset
from structid.diagnose.causes.separate_element import DifferingElement
from structid.diagnose.refits import FittedModel
from structid.diagnose.score_test import Screened
from structid.diagnose.screening import Shortlist
from structid.diagnose.thresholds import (
    MOST_NEIGHBOURS,
    OTHER_LEVERS,
    SAME_DELAY,
)
from structid.fem import Structure


def derived_candidates(base: FittedModel, shortlist: Shortlist) -> list[Screened]:
    """Further changes worth a fit, without a linear look, that follow from the most promising screened ones.

    In this order: fixed values of sets one of whose elements looks different, sensors that are late together, other
    offsets of masses, sensors of opposite sense and at other nodes where they are better left out, loads at other nodes,
    and supports that become flexible in several rotations.
    """
    rows = shortlist.rows
    lost = shortlist.lost
    return [
        *_of_whole_sets(base, rows),
        *_of_one_card(rows),
        *_off_otherwise(rows),
        *_turned(rows, lost),
        *_misplaced(base, lost),
        *shortlist.feet,
    ]


def _of_whole_sets(base: FittedModel, rows: Sequence[Screened]) -> list[Screened]:
    """Candidates that a fixed property of a whole set is wrong, for sets of which `rows` have an element that differs in it.

    A linear step from a fit that is far off promises little of a fixed value, while elements are screened at other points too.
    """
    setup = base.modified.setups[0]
    of_set = {value.where[0]: value for value in fixed_values(setup.structure, setup.parameters)}
    first: dict[str, Screened] = {}
    for row in rows:
        if isinstance(row.candidate, DifferingElement) and len(row.candidate.properties) == 1:
            differing = row.candidate.properties[0]
            first.setdefault(f"{differing.property}[{differing.element.rpartition(':')[0]}]", row)
    return [Screened(of_set[name], 1.0, row.left) for name, row in first.items() if name in of_set]


def _of_one_card(screened_rows: Sequence[Screened]) -> list[Screened]:
    """Candidate delays common to sensors of one record that are late by about the same time (of one acquisition card).

    There is one for the two most telling sensors, one for the first three, and so on; empty for fewer than two.
    """
    late = [row for row in screened_rows if isinstance(row.candidate, SensorDelay)]
    alike = [
        row
        for row in late
        if row.candidate.record == late[0].candidate.record
        and 1 / SAME_DELAY < row.strength / late[0].strength < SAME_DELAY
    ]
    screened = []
    for count in range(2, len(alike) + 1):
        places = tuple(row.candidate.where[0] for row in alike[:count])
        strength = float(np.median([row.strength for row in alike[:count]]))
        shared = replace(late[0].candidate, where=places)
        screened.append(Screened(shared, strength, late[0].left))
    return screened


def _turned(rows: Sequence[Screened], lost: Sequence[Screened]) -> list[Screened]:
    """Candidates that sensors which are better left out (`lost`) have the opposite sense, where `rows` do not have these."""
    known = {row.candidate.where for row in rows if isinstance(row.candidate, SensorPolarity)}
    return [
        Screened(SensorPolarity(where=row.candidate.where, record=row.candidate.record), 1.0, row.left)
        for row in lost
        if row.candidate.where not in known
    ]


def _misplaced(base: FittedModel, left_out: Sequence[Screened]) -> list[Screened]:
    """Candidate positions, at up to four of the nearest nodes, of all loads and of the sensors of `left_out`.

    `left_out` are screened changes that leave out a sensor. Motions of driven supports have no candidates.
    """
    screened = []
    better_out = {(row.candidate.record, row.candidate.where[0]) for row in left_out}
    for number, setup in enumerate(base.modified.setups):
        for role, dofs in setup.channels:
            is_load, measured = role == "input", {dof.unsigned for dof in dofs}
            if is_load and setup.structure.driven(dofs):
                continue
            for dof in dofs:
                if is_load or (number, dof.place) in better_out:
                    others = [one for one in _dofs_nearby(setup.structure, dof) if one not in measured]
                    kind = LoadPosition if is_load else SensorPosition
                    pairs = [(dof.place, one.place) for one in others]
                    screened += [Screened(kind(where=pair, record=number), 1.0, base.misfit) for pair in pairs]
    return screened


def _dofs_nearby(structure: Structure, dof: Dof) -> list[Dof]:
    """Degrees of freedom in the direction of `dof` at up to four of the nearest other nodes that can move in it."""
    nodes = {label: np.asarray(position) for label, position in structure.nodes.items()}
    distance = {label: float(np.linalg.norm(x - nodes[dof.node])) for label, x in nodes.items() if label != dof.node}
    neighbours = []
    for label in sorted(distance, key=lambda label_of: distance[label_of])[: 2 * MOST_NEIGHBOURS]:
        with suppress(InputError):
            other = Dof(label, dof.direction)
            structure.require_dofs([other])
            neighbours.append(other)
    return neighbours[:MOST_NEIGHBOURS]


def _off_otherwise(rows: Sequence[Screened]) -> list[Screened]:
    """Masses off their nodes with other levers: each of the first three in `rows` with its strength times `OTHER_LEVERS`.

    Needed since the misfit depends on the lever and its square: it has minima to the other side, and at less.
    """
    off = [row for row in rows if isinstance(row.candidate, MassOffset)][:3]
    return [replace(row, strength=factor * row.strength) for row in off for factor in OTHER_LEVERS]
