"""The pool: every single change of a model and of its records that is held against a misfit."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from functools import partial
from itertools import combinations
from typing import NamedTuple, TypeVar

import numpy as np

from structid.core.arrays import ComplexArray, FloatArray, IntArray
from structid.core.dof import DIRECTIONS, Dof
from structid.core.units import MISTAKEN_FORCES, mistaken_motions
from structid.criticism.between import between_nodes
from structid.criticism.candidate import (
    Candidate,
    Places,
    added,
    of_channel,
    picked_by,
    place_of,
    rearranged,
    released,
    replaced,
    rubbing,
    steps,
)
from structid.criticism.data import misfit_of_lines
from structid.criticism.fields import ElementMatrix, Fields
from structid.fem import PointMass, Spring
from structid.fem.elements.element import dof_code, dof_of_code

T = TypeVar("T")

_APPENDAGE_LOSS = 0.03
_APPENDAGE_FREQUENCIES, _APPENDAGE_NODES = 10, 24
_APPENDAGE_MASSES = np.array([0.01, 0.03, 0.1, 0.3, 1.0, 3.0])
#: Friction forces per unit of drive.
_RUBBING = np.array([0.003, 0.01, 0.03, 0.1, 0.2, 0.4, 0.7, 1.0, 1.4, 2.0, 4.0])
#: By which a sensor may be turned, rad.
_ANGLES = np.radians([3.0, 8.0, 15.0, 25.0, 40.0, 60.0, 90.0, -3.0, -8.0, -15.0, -25.0, -40.0, -60.0, -90.0])
#: By which a mass may sit off its node, in parts of the largest extent of the structure.
_OFFSETS = np.array([0.005, 0.01, 0.02, 0.05, 0.1, 0.2, -0.005, -0.01, -0.02, -0.05, -0.1, -0.2])
_FACTORS = np.array([0.005, 0.02, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0])
_PARTS = np.array([-0.9, -0.7, -0.5, -0.3, -0.15, -0.05, 0.05, 0.2, 0.4, 0.8, 1.5, 3.0, 8.0])
#: Of larger models a part is tried.
_MOST_NODES, _MOST_ELEMENTS = 60, 150
#: Degrees of freedom of a set, and in how many ways it, or all sensors together, may move to be tried as a whole.
_MOST_CODES, _MOST_WAYS = 300, 60
#: Of larger ones changes of the records alone, which need no Z^-1: it is formed at some forty lines.
MOST_DOFS = 1200
#: Strengths of what cannot be negative.
_POSITIVE = (0.0, np.inf)
_TRANSLATIONS = ("X", "Y", "Z")
#: Power of s with which properties enter the dynamic stiffness.
_POWERS = {"mass": 2, "rotary_inertia": 2, "viscous_damping": 1}


def pool(records: Sequence[Fields], names: Sequence[str] = ("",)) -> list[Candidate]:
    """All candidates for records of one structure, whose `Fields` are at one point of the parameters.

    Parameters
    ----------
    records : sequence of Fields
        The first gives the structure; a change of it is one of all.
    names : sequence of str
        Of the records. Where there are several, each may have masses of its own.
    """
    first, found = records[0], list[Candidate]()
    if first.structure.n_dofs <= MOST_DOFS:
        found += [
            *_supports(records),
            *_joints(first),
            *_additions(first),
            *_of_sensors(records),
            *_untied(first),
            *_apart(first),
        ]
    for number, fields in enumerate(records):
        found += _channels(fields, number)
        if len(names) > 1 and fields.structure.n_dofs <= MOST_DOFS:
            found += _masses(fields, number, names[number])
    return found


def exchanges(records: Sequence[Fields]) -> Iterator[Candidate]:
    """Those of `pool` that exchange or turn channels: without a strength, and far from a model that was bent to them."""
    for number, fields in enumerate(records):
        yield from (one for one in _channels(fields, number) if len(one.strengths) == 1)


def _spread(items: list[T], most: int) -> list[T]:
    """All, or as many as `most` of them, evenly."""
    if len(items) <= most:
        return items
    return [items[i] for i in np.linspace(0, len(items) - 1, most).round().astype(int)]


def _inertia(fields: Fields) -> ComplexArray:
    return fields.laplace**2


def _velocity(fields: Fields) -> ComplexArray:
    return fields.laplace


def _constant(fields: Fields) -> ComplexArray:
    return np.ones_like(fields.laplace)


def _scale(fields: Fields, places: Places, law: ComplexArray) -> float:
    """Strength at which an added part is as stiff as what it is added to, at most lines."""
    rows, directions = places.rows(fields)
    d = directions[:, 0]
    size = np.abs(law * (d @ fields.flexibility[:, rows[:, None], rows] @ d))
    return float(1 / np.median(size))


def _additions(fields: Fields) -> Iterator[Candidate]:
    """Springs to the ground, dashpots, masses, rotary inertias and appendages."""
    chosen = _chosen(fields)
    few, frequencies = set(_spread(sorted(chosen), _APPENDAGE_NODES)), _swinging(fields)
    moving = {dof.node for dof in fields.columns if not dof.is_rotation}
    for dof in fields.columns:
        if dof.node not in chosen:
            continue
        where, at = (dof.place,), place_of((dof, 1.0))
        rubs = (
            Candidate("friction", where, rubbing(at), _RUBBING, _POSITIVE, places=at)
            if len(fields.problem.record.inputs) == 1 and fields.problem.facts.measures_force
            else None
        )
        for kind, law, alike in (("spring", _constant, None), ("dashpot", _velocity, rubs)):
            strengths = steps(_scale(fields, at, law(fields)))
            yield Candidate(kind, where, added(at, law), strengths, _POSITIVE, alike=alike, places=at)
        if rubs is not None:
            yield rubs
        if dof.node in few and not (dof.is_rotation and dof.node in moving):  # of drive trains what twists alone
            yield from _appendages(fields, dof, at, frequencies)
    yield from _turning(fields, chosen)
    yield from _eccentric(fields)
    yield from _masses(fields)
    for pair, apart in _spread(list(_pairs(fields)), _MOST_ELEMENTS):
        strengths = steps(_scale(fields, apart, _velocity(fields)))
        yield Candidate("dashpot", pair, added(apart, _velocity), strengths, _POSITIVE)


def _chosen(fields: Fields) -> set[int]:
    """The nodes where something may be added."""
    return set(_spread(list(dict.fromkeys(dof.node for dof in fields.columns)), _MOST_NODES))


def _masses(fields: Fields, record: int | None = None, name: str = "") -> Iterator[Candidate]:
    """Masses of either sign that move in all directions of a node, in all records or in one of them."""
    nodes: dict[int, list[Places]] = {}
    chosen = _chosen(fields)
    for dof in fields.columns:
        if dof.node in chosen and not dof.is_rotation:
            nodes.setdefault(dof.node, []).append(place_of((dof, 1.0)))
    for node, ways in nodes.items():
        scale = min(_scale(fields, at, _inertia(fields)) for at in ways)
        where = (str(node),) if record is None else (str(node), name)
        yield Candidate("mass", where, added(_all_of(ways), _inertia), steps(scale, (1, -1)), record=record)


def _of_sensors(records: Sequence[Fields]) -> Iterator[Candidate]:
    """The same mass at the node of every sensor, of each record at its own, such as of accelerometers that weigh something."""
    nodes = list(dict.fromkeys(node for fields in records for node in _sensed(fields)))
    most = max(len(_moves_of(fields, _sensed(fields))) for fields in records)
    if len(nodes) > 1 and most <= _MOST_WAYS:
        first = next(fields for fields in records if _sensed(fields))
        scale = min(_scale(first, place_of((dof, 1.0)), _inertia(first)) for dof in _moves_of(first, _sensed(first)))
        of_record = tuple(" ".join(map(str, _sensed(fields))) for fields in records)
        where = tuple(str(node) for node in nodes)
        yield Candidate("sensor_mass", where, _weighing, steps(scale, (1, -1)), others=of_record)


def _sensed(fields: Fields) -> tuple[int, ...]:
    """The nodes of the sensors that read translations, those that move."""
    nodes = dict.fromkeys(dof.node for dof in fields.problem.record.outputs if not dof.is_rotation)
    return tuple(node for node in nodes if _moves_of(fields, (node,)))


def _moves_of(fields: Fields, nodes: Collection[int]) -> list[Dof]:
    """The translations of some nodes that are free."""
    return [dof for dof in fields.columns if dof.node in nodes and not dof.is_rotation]


def _weighing(fields: Fields, strengths: FloatArray) -> ComplexArray:
    """Of a mass at the node of every sensor of a record."""
    ways = [place_of((dof, 1.0)) for dof in _moves_of(fields, _sensed(fields))]
    if not ways:
        return np.zeros((len(strengths), *fields.frf.shape), complex)
    return added(_all_of(ways), _inertia)(fields, strengths)


def _all_of(ways: Sequence[Places]) -> Places:
    """Some single directions, each by itself."""
    return Places(np.concatenate([at.codes for at in ways]), np.eye(len(ways)))


def _turning(fields: Fields, nodes: Collection[int]) -> Iterator[Candidate]:
    """Rotary inertias at free rotations of some nodes of the study; none is too much by more than the model has there."""
    own, free = fields.structure.matrix("inertia", fields.values), set(fields.structure.numbering.free)
    for dof, follow in fields.columns.items():
        is_own = dof_code(dof.node, dof.direction) in free and dof.node in fields.structure.nodes
        if dof.is_rotation and is_own and dof.node in nodes:
            at, most = place_of((dof, 1.0)), float(follow @ (own @ follow))
            strengths = steps(_scale(fields, at, _inertia(fields)), (1, -1))
            bounds = (-most, np.inf)
            yield Candidate("inertia", (dof.place,), added(at, _inertia), strengths[strengths > -most], bounds)


def _eccentric(fields: Fields) -> Iterator[Candidate]:
    """Point masses that sit off their nodes, along each axis; strengths are lengths, m."""
    nodes = {one.name: one.nodes.ravel() for one in fields.structure.elements if isinstance(one, PointMass)}
    size = float(np.ptp(list(fields.structure.nodes.values()), axis=0).max())
    masses = [one for one in fields.elements(("mass",)) if one.element in nodes and size > 0]
    for one in _spread(masses, _MOST_NODES):
        node = int(nodes[one.element][one.number])
        codes = np.array([dof_code(node, direction) for direction in DIRECTIONS])
        moves = np.isin(codes[:3], one.codes)
        along = tuple(direction for direction, there in zip(_TRANSLATIONS, moves, strict=True) if there)
        for axis, direction in enumerate(_TRANSLATIONS[: len(fields.structure.nodes[node])]):
            lever = np.cross(np.eye(3), np.eye(3)[axis]).T * moves[:, None]
            if (lever @ fields.reached(codes[3:])).any():
                effect = rearranged(Places(codes, np.eye(6)), partial(_displaced, float(one.matrix.max()), lever))
                where = (f"{one.element}:{one.number + 1}", direction)
                yield Candidate("offset", where, effect, size * _OFFSETS, (-size, size), others=along)


def _displaced(mass: float, lever: FloatArray, fields: Fields, strengths: FloatArray) -> ComplexArray:
    """Change of Z between the translations and rotations of a node whose mass moves by u + q lever theta, not by u."""
    first, second = np.zeros((6, 6)), np.zeros((6, 6))
    first[:3, 3:], first[3:, :3], second[3:, 3:] = lever, lever.T, lever.T @ lever
    q = strengths[:, None, None, None]
    return mass * _inertia(fields)[:, None, None] * (q * first + q**2 * second)


def _pairs(fields: Fields) -> Iterator[tuple[tuple[str, str], Places]]:
    """Where springs are between two ends that both move: these, and how they move apart."""
    for element in fields.structure.elements:
        if isinstance(element, Spring) and element.second is not None:
            for first, second in zip(element.first, element.second, strict=True):
                apart = place_of((second.unsigned, float(second.sign)), (first.unsigned, -float(first.sign)))
                moves = fields.reached(apart.codes)
                if moves.any(axis=1).all() and (apart.weights[:, 0] @ moves)[fields.undriven].any():
                    yield (first.place, second.place), apart


def _swinging(fields: Fields) -> list[float]:
    """Frequencies at which something may swing of its own: where the misfit of lines peaks, and some over the band."""
    problem = fields.problem
    frequency = problem.frequency
    misfit = misfit_of_lines(problem, problem.data_rows(fields.frf))
    inner = misfit[1:-1]
    peaks = 1 + np.flatnonzero((inner >= misfit[:-2]) & (inner >= misfit[2:]))
    best = peaks[np.argsort(-misfit[peaks])][:_APPENDAGE_FREQUENCIES]
    spread = np.geomspace(frequency[frequency > 0][0], frequency[-1], _APPENDAGE_FREQUENCIES)
    return np.unique(np.concatenate([frequency[best], spread])).tolist()


def _appendages(fields: Fields, dof: Dof, at: Places, frequencies: Sequence[float]) -> Iterator[Candidate]:
    scale = _scale(fields, at, _inertia(fields))
    effects = {f: added(at, partial(_appendage, f)) for f in frequencies if f > 0}
    for f, effect in effects.items():
        masses = scale * _APPENDAGE_MASSES
        yield Candidate("appendage", (dof.place,), effect, masses, _POSITIVE, detail={"frequency": f}, places=at)


def _appendage(frequency: float, fields: Fields) -> ComplexArray:
    """s^2 k / (s^2 + k) of a unit mass on a spring k = (2 pi f)^2 (1 + i eta)."""
    k = (2 * np.pi * frequency) ** 2 * (1 + 1j * _APPENDAGE_LOSS)
    found: ComplexArray = fields.laplace**2 * k / (fields.laplace**2 + k)
    return found


def _supports(records: Sequence[Fields]) -> Iterator[Candidate]:
    """Directions that some record holds or drives, and that give way."""
    inputs = [{dof.unsigned for dof in fields.problem.record.inputs} for fields in records]
    scales = {
        dof.unsigned: float(1 / np.median(np.abs(own)))
        for fields in reversed(records)
        for dof, own in zip(fields.loose[0], fields.loose[2].T, strict=True)
    }
    for dof, scale in scales.items():
        driven = tuple(number for number, own in enumerate(inputs) if dof in own)
        effect = released(partial(_loose, dof))
        yield Candidate("support", (dof.place,), effect, steps(scale), _POSITIVE, driven=driven)


def _loose(dof: Dof, fields: Fields) -> tuple[ComplexArray, ComplexArray]:
    held, coupling, own = fields.loose
    places = [i for i, one in enumerate(held) if one.unsigned == dof]
    if not places:  # this record neither holds nor drives it
        return np.zeros(fields.under_loads.shape[:2], complex), np.zeros_like(fields.laplace)
    return coupling[:, :, places[0]], own[:, places[0]]


class _Column(NamedTuple):
    """One column of an element matrix: the codes of its rows, it, its kind and its loss factor."""

    codes: IntArray
    column: FloatArray
    diagonal: float
    kind: str
    loss: float


def _joints(fields: Fields) -> Iterator[Candidate]:
    """Ends of elements that turn against their nodes."""
    ends: dict[tuple[str, int, int], list[_Column]] = {}
    for one in fields.elements(("mass", "rotary_inertia", "viscous_damping", "stiffness", "axial_force")):
        for j, code in enumerate(one.codes.tolist()):
            if code >= 0 and dof_of_code(code).is_rotation:
                part = _Column(one.codes, one.matrix[:, j], float(one.matrix[j, j]), one.kind, one.loss)
                ends.setdefault((one.element, one.number, code), []).append(part)
    for (name, e, code), columns in _spread(list(ends.items()), _MOST_ELEMENTS):
        if any(part.kind == "stiffness" and part.diagonal > 0 for part in columns):
            coupling = partial(_joint, tuple(columns))
            scale = float(1 / np.median(np.abs(coupling(fields)[1])))
            where = (f"{name}:{e + 1}", dof_of_code(code).place)
            yield Candidate("joint", where, released(coupling), steps(scale), _POSITIVE)


def _joint(columns: Sequence[_Column], fields: Fields) -> tuple[ComplexArray, ComplexArray]:
    """Z between the end of an element that turns and the free degrees of freedom, and of the end alone."""
    coupling = np.zeros((len(fields.laplace), fields.structure.n_dofs), dtype=np.complex128)
    own = np.zeros(len(fields.laplace), dtype=np.complex128)
    for part in columns:
        power = _POWERS.get(part.kind)
        law = np.full_like(fields.laplace, 1 + 1j * part.loss) if power is None else fields.laplace**power
        coupling += law[:, None] * (part.column @ fields.reached(part.codes))
        own += law * part.diagonal
    return coupling, own


def _untied(fields: Fields) -> Iterator[Candidate]:
    """Elements that differ from their group, in stiffness or mass; strengths are parts of what they have."""
    items = list(_held_together(fields))
    counts = Counter((one.element, one.property) for one in items)
    for one in _spread([one for one in items if counts[one.element, one.property] > 1], 2 * _MOST_ELEMENTS):
        yield from _differing(fields, one, f"untied {one.kind}", f"{one.element}:{one.number + 1}")


def _held_together(fields: Fields) -> Iterator[ElementMatrix]:
    """Stiffness and mass of elements; properties of an element that one parameter moves are one, called as their kind."""
    parts: dict[tuple[object, ...], list[ElementMatrix]] = {}
    for one, moved_by in _moved(fields):
        parts.setdefault((one.element, one.number, one.kind, moved_by or one.property), []).append(one)
    for items in parts.values():
        yield _sum(items)


def _moved(fields: Fields) -> Iterator[tuple[ElementMatrix, tuple[int, ...]]]:
    """Stiffness and mass of elements, each with the parameters that move it."""
    design = fields.problem.parameters.design.tocsr()
    for one in fields.elements(("stiffness", "mass")):
        yield one, tuple(design.indices[design.indptr[one.row] : design.indptr[one.row + 1]].tolist())


def _sum(items: Sequence[ElementMatrix]) -> ElementMatrix:
    """Several as one, called as their kind where they are of several properties."""
    first, *more = items
    if not more:
        return first
    codes = np.unique(np.concatenate([one.codes[one.codes >= 0] for one in items]))
    matrix = np.zeros((len(codes), len(codes)))
    for one in items:
        there = one.codes >= 0
        place = np.searchsorted(codes, one.codes[there])
        matrix[np.ix_(place, place)] += one.matrix[np.ix_(there, there)]
    prop = first.property if len({one.property for one in items}) == 1 else first.kind
    return first._replace(property=prop, codes=codes, matrix=matrix)


def _apart(fields: Fields) -> Iterator[Candidate]:
    """Whole sets that one parameter ties to others, and that differ from them, such as one of several mounts."""
    groups: dict[tuple[str, tuple[int, ...]], dict[str, list[ElementMatrix]]] = {}
    for one, moved_by in _moved(fields):
        if len(moved_by) == 1:
            groups.setdefault((one.kind, moved_by), {}).setdefault(one.element, []).append(one)
    tied = [_sum(items) for sets in groups.values() if len(sets) > 1 for items in sets.values()]
    for one in _spread(tied, _MOST_ELEMENTS):
        if len(one.codes) <= _MOST_CODES:
            yield from _differing(fields, one, "untied set", one.element, _MOST_WAYS)


def _differing(fields: Fields, one: ElementMatrix, kind: str, where: str, most: float = np.inf) -> Iterator[Candidate]:
    """A stiffness or mass that is not what it is taken for; none where nothing moves that has it, or it moves in too many ways."""
    size, vectors = np.linalg.eigh(one.matrix)
    keep = size > 1e-9 * max(size[-1], 0.0)
    places = Places(one.codes, vectors[:, keep] * np.sqrt(size[keep]))
    if 0 < keep.sum() <= most and len(places.rows(fields)[0]):
        law = _inertia if one.kind == "mass" else partial(_lossy, one.loss)
        yield Candidate(kind, (where,), added(places, law), _PARTS, (-1.0, np.inf), others=(one.property,))


def _lossy(loss: float, fields: Fields) -> ComplexArray:
    return np.full_like(fields.laplace, 1 + 1j * loss)


def _channels(fields: Fields, number: int) -> Iterator[Candidate]:
    """Calibration, delay, sense and order of sensors and loads."""
    record, s = fields.problem.record, fields.laplace[:, None, None]
    delays = np.concatenate([sign * _FACTORS * 2 / (2 * np.pi * record.frequency[-1]) for sign in (1, -1)])
    for axis, dofs in ((1, record.outputs), (2, record.inputs)):
        side = "sensor" if axis == 1 else "load"
        for i, dof in enumerate(dofs):
            where = (dof.place,)
            units = np.log(
                [factor for factor, _, _ in (mistaken_motions(dof.is_rotation) if axis == 1 else MISTAKEN_FORCES)]
            )
            logs = np.concatenate([_FACTORS, -_FACTORS, units, -units])
            make = partial(Candidate, where=where, record=number)
            if len(dofs) > 1 or axis == 2 or len(record.outputs) > 1:
                gained = replaced(partial(_scaled, axis, i))
                yield make(f"{side}_gain", effect=gained, strengths=logs)
            late = replaced(partial(_late, axis, i, s))
            yield make("delay" if axis == 1 else "load_delay", effect=late, strengths=delays)
            if len(dofs) > 1 or axis == 1:
                turned = replaced(partial(_turned, axis, i))
                yield make("polarity" if axis == 1 else "load_polarity", effect=turned)
        for i, k in combinations(range(len(dofs)), 2):
            swapped = replaced(partial(_swapped, axis, i, k))
            pair = (dofs[i].place, dofs[k].place)
            kind = "swap" if axis == 1 else "load_swap"
            yield Candidate(kind, pair, swapped, record=number)
    if fields.structure.n_dofs > MOST_DOFS:
        return
    angles = (_ANGLES, (-np.pi, np.pi))
    for i, dof in enumerate(record.outputs):
        for place, column in _other_directions(fields, dof):
            seen = partial(_aimed, 1, i, column)
            yield Candidate("direction", (dof.place, place), seen, *angles, number)
    for j, dof in enumerate(record.inputs if fields.problem.facts.measures_force else ()):
        for place, column in _other_directions(fields, dof):
            pushed, held = partial(_aimed, 2, j, dof.sign * column), fields.structure.active or ()
            yield Candidate("load_direction", (dof.place, place), pushed, *angles, record=number, others=held)
    yield from between_nodes(fields, number)


def _other_directions(fields: Fields, dof: Dof) -> Iterator[tuple[str, FloatArray]]:
    """The other directions of the same kind in which the node of `dof` moves, with what picks them."""
    for other, column in fields.columns.items():
        if other.node == dof.node and other.direction != dof.direction and other.is_rotation == dof.is_rotation:
            yield other.place, column


def _picked(h: ComplexArray, axis: int, i: int) -> FloatArray:
    chosen = np.zeros(h.shape[axis])
    chosen[i] = 1.0
    return chosen[:, None] if axis == 1 else chosen[None, :]


def _scaled(axis: int, i: int, h: ComplexArray, q: float) -> ComplexArray:
    return h * (1 + _picked(h, axis, i) * np.expm1(q))


def _late(axis: int, i: int, s: ComplexArray, h: ComplexArray, q: float) -> ComplexArray:
    return h * (1 + _picked(h, axis, i) * np.expm1(-s * q))


def _turned(axis: int, i: int, h: ComplexArray, q: float) -> ComplexArray:
    return h * (1 - 2 * q * _picked(h, axis, i))


def _swapped(axis: int, i: int, k: int, h: ComplexArray, q: float) -> ComplexArray:
    order = np.arange(h.shape[axis])
    order[[i, k]] = k, i
    return h + q * (np.take(h, order, axis) - h)


def _aimed(axis: int, i: int, column: FloatArray, fields: Fields, strengths: FloatArray) -> ComplexArray:
    """A channel that is turned by angles, rad, towards another direction of its node."""
    angles, own = strengths[:, None, None], fields.frf.take(i, axis)
    turned = (np.cos(angles) - 1) * own + np.sin(angles) * picked_by(fields, axis, i, column[None])
    return of_channel(fields, axis, i, turned)
