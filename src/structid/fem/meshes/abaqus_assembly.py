"""Parts, instances and assemblies of Abaqus input files: nodes, elements and sets with labels of their own."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from structid.core.arrays import FloatArray
from structid.fem.meshes.abaqus_keywords import KeywordBlock, numbers_of
from structid.fem.meshes.coordinate_systems import CoordinateSystem, axes_from_x, axes_of_points, rectangular

#: Sets of labels by name in capitals.
Sets = dict[str, set[int]]
_MOST_MEMBERS = 20_000_000
#: In place of the number of nodes of an element: each line is one.
ONE_LINE = -1
_NUMBER = re.compile(r"-?\d+")
_FORMS = {"": "R", "R": "R", "RECTANGULAR": "R", "C": "C", "CYLINDRICAL": "C", "S": "S", "SPHERICAL": "S"}


@dataclass(eq=False)
class PartData:
    """Data read so far of a flat file, a part, an instance or the assembly itself.

    Attributes
    ----------
    name : str
    nodes : dict of label to position
        Positions in the file's unit, moved with the instance.
    elements : dict of (type, number of nodes) to dict of label to nodes
        Types in capitals; nodes as words, as those of an assembly may be of an instance.
    node_sets, cell_sets : Sets
    names : dict of str to str
        Names of sets as written.
    blocks : list of KeywordBlock
        Keywords that are not nodes, elements or sets.
    system : CoordinateSystem, optional
        Coordinate system in which nodes are given.
    turn : (3, 3) float array
        Rotation of the instance.
    overlong : set of str
        Types of elements of which lines name more nodes than they have.
    unsorted : set of str
        Names, in capitals, of node sets whose order counts (UNSORTED).
    ranges : list of (keyword, range)
        Labels that sets name from a first to a last one (GENERATE), by NSET or ELSET.
    shift : (3,) float array
        Where the instance puts the origin of its part, in the file's unit.
    """

    name: str = ""
    nodes: dict[int, list[float]] = field(default_factory=dict)
    elements: dict[str, dict[int, list[str]]] = field(default_factory=dict)
    node_sets: Sets = field(default_factory=dict)
    cell_sets: Sets = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    blocks: list[KeywordBlock] = field(default_factory=list)
    system: CoordinateSystem | None = None
    turn: FloatArray = field(default_factory=lambda: np.eye(3))
    overlong: set[str] = field(default_factory=set)
    unsorted: set[str] = field(default_factory=set)
    ranges: list[tuple[str, range]] = field(default_factory=list)
    shift: FloatArray = field(default_factory=lambda: np.zeros(3))

    def take(self, block: KeywordBlock, counts: Mapping[str, int]) -> None:
        """Take up a keyword with its data lines: nodes, elements, a set or a system; others are stored in `blocks`.

        `counts` maps element types whose data fill several lines to their numbers of nodes. Raises `ValueError` or
        `KeyError` if labels repeat, a set is not there, or a line cannot be read.
        """
        options, rows = block.options, block.rows
        if block.keyword == "NODE":
            self._take_nodes(options, rows)
        elif block.keyword == "ELEMENT":
            kind = options.get("TYPE", "").upper()
            table, too_many = element_rows(rows, counts.get(kind, 0))
            self.overlong |= {kind} if too_many else set()
            twice = next((label for label in table if any(label in other for other in self.elements.values())), None)
            if twice is not None:
                raise ValueError(f"element {twice} stands twice, as it does where a file has several parts")
            self.elements.setdefault(kind, {}).update(table)
            if options.get("ELSET"):
                self.set_of(self.cell_sets, options["ELSET"]).update(table)
        elif block.keyword in ("NSET", "ELSET"):
            sets = self.node_sets if block.keyword == "NSET" else self.cell_sets
            name = options.get(block.keyword, "")
            members = self.set_of(sets, name)
            for row in rows:
                if "GENERATE" in options:
                    members.update(self.take_range(row, block.keyword))
                else:
                    members.update(_members_of_row(row, sets))
            if block.keyword == "NSET" and options.get("ELSET"):
                if options["ELSET"].upper() not in self.cell_sets:
                    raise ValueError(f"there is no element set {options['ELSET']!r} before this line")
                members.update(self.nodes_of_cells(self.cell_sets[options["ELSET"].upper()]))
            self.unsorted |= {name.upper()} if "UNSORTED" in options else set()
        elif block.keyword == "SYSTEM":
            self.system = _read_system(rows)
        else:
            self.blocks.append(block)

    def _take_nodes(self, options: dict[str, str], rows: list[list[str]]) -> None:
        """Add the nodes in the data lines of a *NODE to `nodes`, and to the node set that it names, if any.

        Their coordinates in the file are in the current coordinate system. `options` are those of the keyword, `rows`
        the words of its data lines. Raises `ValueError` if a node repeats, coordinates may have decimal commas, or
        SYSTEM is neither rectangular nor cylindrical.
        """
        _require_decimal_points(rows)
        labels = [int(row[0]) for row in rows]
        for label in labels:
            if label in self.nodes:
                raise ValueError(f"node {label} stands twice, as it does where a file has several parts")
        coordinates = np.array([numbers_of(row[1:], 3) for row in rows]).reshape(-1, 3)
        form = system_form(options.get("SYSTEM", ""))
        if form not in ("R", "C"):
            raise ValueError(
                f"coordinates of SYSTEM={options['SYSTEM']} are not read; write the nodes in rectangular ones (SYSTEM=R)"
            )
        positions = rectangular(form, coordinates)
        if self.system is not None:
            positions = self.system.to_basic(positions)
        repeated = len(labels) - len(set(labels))
        if repeated:
            raise ValueError("a node stands twice, as it does where a file has several parts")
        self.nodes.update(zip(labels, positions.tolist(), strict=True))
        if options.get("NSET"):
            self.set_of(self.node_sets, options["NSET"]).update(labels)

    def set_of(self, sets: Sets, name: str) -> set[int]:
        """The set called `name` in upper or lower case; a new empty one if there is none."""
        self.names.setdefault(name.upper(), name)
        return sets.setdefault(name.upper(), set())

    def take_range(self, row: list[str], keyword: str) -> range:
        """Labels on a data line of a set with GENERATE: first, last and step, which is 1 if left out; both ends count.

        They are kept in `ranges`, as not each needs to be there. Raises `ValueError` if steps from the first do not come
        to the last label, or there are too many.
        """
        labels = _range_of(row)
        self.ranges.append((keyword, labels))
        return labels

    def nodes_of_cells(self, labels: Iterable[int]) -> set[int]:
        """Labels of the nodes of some elements."""
        wanted = set(labels)
        return {int(n) for table in self.elements.values() for label in wanted & set(table) for n in table[label]}

    def instance(self, name: str) -> PartData:
        """A copy of a part."""
        return PartData(
            name,
            dict(self.nodes),
            {kind: dict(table) for kind, table in self.elements.items()},
            {key: set(members) for key, members in self.node_sets.items()},
            {key: set(members) for key, members in self.cell_sets.items()},
            dict(self.names),
            list(self.blocks),
            overlong=set(self.overlong),
            unsorted=set(self.unsorted),
            ranges=list(self.ranges),
        )

    def move(self, rows: list[list[str]]) -> None:
        """Move the nodes to the place of the instance: by a shift, then by a rotation about a line; sets `shift`, `turn`.

        `rows` are the words of the data lines: the shift, then two points of the line and an angle in degrees; none if
        not moved. A first line of more than three numbers is one that turns. Raises `ValueError` if the line that turns
        has not seven numbers, or both points are one.
        """
        if not rows:
            return
        if any(rows[0][3:]):
            rows = [[], *rows]
        self.shift = np.array(numbers_of(rows[0], 3))
        if len(rows) > 1 and any(rows[1]):
            numbers = numbers_of(rows[1], 7)
            if len(rows[1]) < 7 or any(rows[1][7:]):
                raise ValueError("an instance is turned by two points and an angle")
            start, end, degrees = np.array(numbers[:3]), np.array(numbers[3:6]), numbers[6]
            self.turn = _rotation_matrix(end - start, degrees)
            self.shift = start + self.turn @ (self.shift - start)
        positions = np.array(list(self.nodes.values())).reshape(-1, 3) @ self.turn.T + self.shift
        self.nodes = dict(zip(self.nodes, positions.tolist(), strict=True))


def _require_decimal_points(rows: list[list[str]]) -> None:
    """Raise `ValueError` if lines of nodes may have decimal commas, which Abaqus takes as the ends of numbers.

    `rows` are the words of each line: label, three coordinates and, if given, the direction of the normal. Decimal
    commas leave no point in any of them, and what follows the third number is no direction, or one along no axis or
    diagonal.
    """
    if any("." in word for row in rows for word in row[1:]):
        return
    for row in rows:
        normal = [float(word) for word in row[4:] if word]
        if normal and not (any(normal) and {abs(x) for x in normal} <= {0.0, 1.0}):
            raise ValueError(
                f"node {row[0]} has {len(row) - 1} numbers and none has a decimal point, as where decimals are written with commas;"
                " write at least one number with a point, as in 1.0"
            )


def _members_of_row(row: list[str], sets: Sets) -> set[int]:
    """Labels in the words of a data line of a set: numbers, and members of other `sets`.

    Raises `ValueError` if a named set is not there.
    """
    members: set[int] = set()
    for word in filter(None, row):
        if _NUMBER.fullmatch(word):
            members.add(int(word))
            continue
        key = word.replace('"', "").upper()
        if key not in sets:
            raise ValueError(f"there is no set {word!r} before this line")
        members |= sets[key]
    return members


def _range_of(row: list[str]) -> range:
    """Labels from the first to the last word of `row` in steps of the third, which is 1 if left out; both ends count.

    Raises `ValueError` if there are other words, or steps from the first do not come to the last label.
    """
    words = [*row, "", "", ""]
    if not (words[0] and words[1]) or any(words[3:]):
        raise ValueError(f"a range is a first label, a last and a step, not {', '.join(row)!r}")
    first, last, step = int(words[0]), int(words[1]), int(words[2] or 1)
    if first == last:
        return range(first, first + 1)
    if not step or (last - first) % step or (last - first) // step < 0:
        raise ValueError(
            f"steps of {step} do not lead from {first} to {last}, so that the members of the set are not clear"
        )
    if (last - first) // step > _MOST_MEMBERS:
        raise ValueError(f"a set from {first} to {last} has more than {_MOST_MEMBERS} members")
    return range(first, last + (1 if step > 0 else -1), step)


def system_form(word: str) -> str:
    """Form of a coordinate system, R, C or S, that `word` names by its letter or in full; R if empty, "" if none."""
    return _FORMS.get(word.upper(), "")


def _read_system(rows: list[list[str]]) -> CoordinateSystem | None:
    """The rectangular coordinate system of a *SYSTEM keyword; None if it has no data, which ends the system before.

    `rows` are the words of its data lines: origin and a point on x, then a point in x-y, by default in the global x-y
    plane. Raises `ValueError` if the points lie on a line.
    """
    lines = [[float(word or 0) for word in row] for row in rows if any(row)]
    if not lines:
        return None
    origin = np.array([*lines[0], 0.0, 0.0, 0.0][:3])
    on_x = np.array([*lines[0][3:6], 0.0, 0.0, 0.0][:3]) if any(rows[0][3:6]) else origin + np.array([1.0, 0.0, 0.0])
    if len(lines) > 1:
        in_xy = np.array([*lines[1], 0.0, 0.0, 0.0][:3])
        axes = axes_from_x(origin, on_x, in_xy)
    else:
        flat = (on_x - origin) * np.array([1.0, 1.0, 0.0])
        axes = axes_of_points(origin, origin + np.array([0.0, 0.0, 1.0]), origin + flat)
    if axes is None:
        raise ValueError("the points of the system lie on a line")
    return CoordinateSystem("R", origin, axes)


def _rotation_matrix(axis: FloatArray, degrees: float) -> FloatArray:
    """Rotation matrix (3, 3) about `axis` (3,) by an angle in degrees (Rodrigues).

    Raises `ValueError` if the axis has no length.
    """
    if not np.linalg.norm(axis):
        raise ValueError("the two points of the axis of rotation are one")
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(degrees)
    rotation: FloatArray = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return rotation


def element_rows(rows: list[list[str]], count: int) -> tuple[dict[int, list[str]], bool]:
    """Nodes (as words) of each element by label, and True if lines have more nodes than the element.

    CalculiX accepts such lines. With `count` nodes an element, its data run over several lines until it is complete;
    with 0, over lines that end in a comma; with `ONE_LINE`, each line is an element. `rows` are the words of the data
    lines. Raises `ValueError` if a label repeats, nodes are missing, or several lines do not end with the last node of
    an element.
    """
    table: dict[int, list[str]] = {}
    pending: list[str] = []
    too_many = False
    lines = 0
    for row in rows:
        pending += [word for word in row if word]
        lines += any(row)
        if not pending or (len(pending) < count + 1 if count else row[-1] == ""):
            continue
        label = int(pending[0])
        if count > 0 and len(pending) > count + 1:
            too_many = True
            if lines > 1:
                raise ValueError(
                    f"element {label} of {count} nodes has {len(pending) - 1} on {lines} lines, as where one is missing or too many"
                )
        if label in table:
            raise ValueError(f"element {label} stands twice, as it does where a file has several parts")
        table[label] = pending[1 : count + 1] if count > 0 else pending[1:]
        pending, lines = [], 0
    if pending and count:
        raise ValueError(f"element {pending[0]} has {len(pending) - 1} nodes instead of {count}")
    if pending:
        table[int(pending[0])] = pending[1:]
    return table, too_many


@dataclass(eq=False)
class Assembly:
    """Instances with one numbering of all nodes and elements.

    Attributes
    ----------
    scopes : list of PartData
        The instances in order; one alone for a flat file.
    own : PartData, optional
        The assembly itself: reference points, elements between instances and sets of its own.
    node_sets, cell_sets : dict of str to dict of str to set of int
        Sets of the assembly: labels by instance, by name in capitals.
    shifts : dict of str to int
        Number that is added to the labels of each instance, by its name in capitals.
    owners : dict of str to str
        Name of the part of a single instance, under which its sets go.
    unknown : tuple of str
        Sentences on sets that name nodes or elements which are not there.
    """

    scopes: list[PartData]
    own: PartData | None = None
    node_sets: dict[str, dict[str, set[int]]] = field(default_factory=dict)
    cell_sets: dict[str, dict[str, set[int]]] = field(default_factory=dict)
    shifts: dict[str, int] = field(default_factory=dict)
    owners: dict[str, str] = field(default_factory=dict)
    unknown: tuple[str, ...] = ()

    @property
    def all_scopes(self) -> list[PartData]:
        """The instances in order, and behind them the assembly itself if there is one."""
        return [*self.scopes, *([self.own] if self.own is not None else [])]

    def number(self) -> None:
        """Set the shift of the labels of each instance and of the assembly itself, in `shifts` by name in capitals.

        It is 0 if no node or element label repeats those before, else the index of the instance times the power of ten
        above the highest label.
        """
        labels = [_labels(scope) for scope in self.all_scopes]
        highest = max((max(pair[k], default=0) for pair in labels for k in (0, 1)), default=0)
        step = 10 ** len(str(highest))
        used: tuple[set[int], set[int]] = (set(), set())
        for index, (scope, pair) in enumerate(zip(self.all_scopes, labels, strict=True)):
            repeats = bool(used[0] & pair[0] or used[1] & pair[1])
            self.shifts[scope.name.upper()] = index * step if repeats else 0
            shift = self.shifts[scope.name.upper()]
            for labels_used, new in zip(used, pair, strict=True):
                labels_used.update(label + shift for label in new)

    def scope(self, name: str) -> PartData:
        """The instance called `name`, in any case of its letters; raises `ValueError` if there is none."""
        for scope in self.scopes:
            if scope.name.upper() == name.upper():
                return scope
        raise ValueError(f"there is no instance {name!r}")

    def shift(self, scope: PartData) -> int:
        return self.shifts[scope.name.upper()]

    def node(self, scope: PartData, word: str) -> int:
        """The label in the mesh of the node that `word` names in a scope: ``12``, or ``INSTANCE.12`` in an assembly."""
        owner, dot, label = word.replace('"', "").rpartition(".")
        return int(label) + self.shift(self.scope(owner) if dot else scope)

    def nodes(self, scope: PartData, word: str) -> list[int]:
        """Labels in the mesh, sorted, of the node or node set called `word`: ``12``, ``TOP``, ``PART-1.TOP``.

        Names are looked up in `scope`, a part, an instance or the assembly, unless `word` names the instance.

        Raises
        ------
        ValueError
            If there is no node set or instance of that name.
        """
        if _NUMBER.fullmatch(word.replace('"', "").rpartition(".")[2]):
            return [self.node(scope, word)]
        key = word.replace('"', "").upper()
        if scope is self.own and key in self.node_sets:
            return sorted(
                label + self.shifts[owner] for owner, labels in self.node_sets[key].items() for label in labels
            )
        owner, dot, name = key.rpartition(".")
        holder = self.scope(owner) if dot else scope
        if name not in holder.node_sets:
            raise ValueError(f"there is no node set {word!r}")
        return sorted(label + self.shift(holder) for label in holder.node_sets[name])

    def take_set(self, block: KeywordBlock) -> None:
        """Add the members of a *NSET or *ELSET block of the assembly to its sets, by the instance that they belong to.

        They are labels, sets or ranges (GENERATE) of one instance (option INSTANCE) or of the assembly, INSTANCE.LABEL,
        INSTANCE.SET, and, for a *NSET with the option ELSET, the nodes of those elements. Raises `ValueError` if a
        named set or instance is not there.
        """
        assert self.own is not None
        is_nodes = block.keyword == "NSET"
        every = self.node_sets if is_nodes else self.cell_sets
        name = block.options.get(block.keyword, "")
        self.own.names.setdefault(name.upper(), name)
        members = every.setdefault(name.upper(), {})
        holder = self.scope(block.options["INSTANCE"]) if block.options.get("INSTANCE") else self.own
        labels_of_owners: list[tuple[str, Iterable[int]]] = []
        for row in block.rows:
            if "GENERATE" in block.options:
                labels_of_owners.append((holder.name.upper(), holder.take_range(row, block.keyword)))
                continue
            for word in filter(None, row):
                labels_of_owners += self._members_of_name(holder, word, is_nodes).items()
        if is_nodes and block.options.get("ELSET"):
            cells = self._members_of_name(holder, block.options["ELSET"], False)
            for owner, labels in cells.items():
                labels_of_owners += self._nodes_of_cells(owner, labels)
        for owner, of_owner in labels_of_owners:
            members.setdefault(owner, set()).update(of_owner)
        self.own.unsorted |= {name.upper()} if "UNSORTED" in block.options else set()

    def drop_unknown(self) -> tuple[str, ...]:
        """Take labels without a node or element out of all sets; returns a sentence for each set that named some.

        Ranges (GENERATE) may pass over labels that are not there: these are left out without a sentence.
        """
        sentences = []
        for keyword, word in (("NSET", "node"), ("ELSET", "element")):
            shared = self.node_sets if keyword == "NSET" else self.cell_sets
            every = [
                (scope.names.get(key, key), scope, labels)
                for scope in self.all_scopes
                for key, labels in (scope.node_sets if keyword == "NSET" else scope.cell_sets).items()
            ]
            for key, by_owner in shared.items():
                for owner, labels in by_owner.items():
                    is_own = self.own is not None and owner == self.own.name.upper()
                    holder = self.own if is_own and self.own is not None else self.scope(owner)
                    every.append((self.own.names.get(key, key) if self.own is not None else key, holder, labels))
            known = {scope.name: _labels(scope)[keyword == "ELSET"] for scope in self.all_scopes}
            passed: dict[str, set[int]] = {}
            for name, holder, labels in every:
                unknown = labels - known[holder.name]
                if not unknown:
                    continue
                labels -= unknown
                if holder.name not in passed:
                    ranges = (labels_of_range for kind, labels_of_range in holder.ranges if kind == keyword)
                    passed[holder.name] = set().union(*ranges)
                if missing := sorted(unknown - passed[holder.name]):
                    of = f" of {holder.name}" if holder.name else ""
                    more = f" and {len(missing) - 5} more" if len(missing) > 5 else ""
                    sentences.append(
                        f"*{keyword} {name} names {word} {', '.join(map(str, missing[:5]))}{more}{of}, which the file does not"
                        " have: left out"
                    )
        return tuple(dict.fromkeys(sentences))

    def _nodes_of_cells(self, owner: str, labels: Iterable[int]) -> list[tuple[str, set[int]]]:
        """Pairs (instance in capitals, labels) of the nodes of elements `labels` of the instance or assembly `owner`."""
        assert self.own is not None
        if owner != self.own.name.upper():
            return [(owner, self.scope(owner).nodes_of_cells(labels))]
        wanted = set(labels)
        words = {word for table in self.own.elements.values() for label in wanted & set(table) for word in table[label]}
        return [pair for word in sorted(words) for pair in self._members_of_name(self.own, word, True).items()]

    def _members_of_name(self, holder: PartData, word: str, is_nodes: bool) -> dict[str, set[int]]:
        """Labels that `word` stands for, by instance name in capitals.

        It is a label or set of `holder`, an instance or the assembly, a set of the assembly, INSTANCE.SET or
        INSTANCE.LABEL. `is_nodes` says that node sets are meant, not element sets. Raises `ValueError` if there is
        none.
        """
        every = self.node_sets if is_nodes else self.cell_sets
        key = word.replace('"', "").upper()
        named = holder.node_sets if is_nodes else holder.cell_sets
        if holder is not self.own and key in named:
            return {holder.name.upper(): set(named[key])}
        if key in every:
            return {owner: set(labels) for owner, labels in every[key].items()}
        owner, dot, name = key.rpartition(".")
        holder = self.scope(owner) if dot else holder
        sets = holder.node_sets if is_nodes else holder.cell_sets
        if _NUMBER.fullmatch(name):
            return {holder.name.upper(): {int(name)}}
        if name not in sets:
            raise ValueError(f"there is no set {word!r} before this line")
        return {holder.name.upper(): set(sets[name])}


def _labels(scope: PartData) -> tuple[set[int], set[int]]:
    return set(scope.nodes), {label for table in scope.elements.values() for label in table}
