"""Degrees of freedom by name: a node label, a direction and a sense, written `12Z+`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from structid.core.errors import InputError, naming

DIRECTIONS = ("X", "Y", "Z", "RX", "RY", "RZ")

_WORD = re.compile(
    r"^\s*(?P<node>\d{1,15})(?:\s*[:_])?\s*(?:(?P<before>[+-])\s*)?(?P<direction>R?[XYZ])\s*(?:(?P<after>[+-])\s*)?$",
    re.IGNORECASE,
)
_SEVERAL = re.compile(r"^\s*(\d+)((?:\s+R?[XYZ]){2,})\s*$", re.IGNORECASE)
_LOAD = "load "
_NUMBER = re.compile(r"^\s*(?P<node>\d{1,15})\.0?(?P<component>[1-6])\s*(?:(?P<after>[+-])\s*)?$")


@dataclass(frozen=True, order=True)
class Dof:
    """One direction at one node, with the sense in which a sensor or a load counts as positive.

    Parameters
    ----------
    node : int
        Label of the node, as the user numbers it.
    direction : str
        One of ``X Y Z`` (translations, m) and ``RX RY RZ`` (rotations, rad).
    sign : int
        +1, or -1 for a sensor or load that points against the axis.
    """

    node: int
    direction: str
    sign: int = 1

    def __post_init__(self) -> None:
        """Raise `InputError` if the direction or the sign is not an allowed one."""
        if self.direction not in DIRECTIONS:
            raise InputError(f"`direction` must be one of {' '.join(DIRECTIONS)}, got {self.direction!r}")
        if self.sign not in (1, -1):
            raise InputError(f"`sign` must be 1 or -1, got {self.sign!r}")

    @property
    def axis(self) -> int:
        """Index of the direction, 0 to 5 for X Y Z RX RY RZ."""
        return DIRECTIONS.index(self.direction)

    @property
    def is_rotation(self) -> bool:
        return self.direction.startswith("R")

    @property
    def unsigned(self) -> Dof:
        """Copy with sign +1."""
        return self if self.sign > 0 else Dof(self.node, self.direction)

    @property
    def place(self) -> str:
        """Node and direction without the sign, such as ``12Z``."""
        return f"{self.node}{self.direction}"

    def __str__(self) -> str:
        return f"{self.place}{'+' if self.sign > 0 else '-'}"


def parse_dof(text: str | Dof) -> Dof:
    """The degree of freedom named by `text`: `12Z+`, `12Z`, `12:+Z`, `12_z`, `3RX-` or `12.03`.

    In the dotted form the digits after the point are 1 to 3 for translations, 4 to 6 for rotations.
    The sense is never lost: `12:-Z` is `12Z-`.

    Raises
    ------
    InputError
        If `text` is none of these forms.

    Examples
    --------
    >>> str(parse_dof("12_z"))
    '12Z+'
    >>> str(parse_dof("12:-Z")), str(parse_dof("12.04"))
    ('12Z-', '12RX+')
    """
    return _parsed(text)


def _parsed(text: str | Dof, also: str = "") -> Dof:
    """The degree of freedom that `text` names, such as ``12Z+``, ``12:-Z``, ``3RX`` or ``3.4``; a `Dof` as it is.

    ``3.4`` is node and component from 1. Without a sense it is +. Raises `InputError` for another form; `also` ends its
    message, with what else may stand there.
    """
    if isinstance(text, Dof):
        return text
    word = _WORD.match(text) if isinstance(text, str) else None
    if word:
        senses = (word["before"] or "") + (word["after"] or "")
        if len(senses) > 1:
            raise InputError(f"degree of freedom {text!r} has two signs; write one, as in 12Z- or 12:-Z")
        return Dof(int(word["node"]), word["direction"].upper(), -1 if senses == "-" else 1)
    number = _NUMBER.match(text) if isinstance(text, str) else None
    if number:
        direction = DIRECTIONS[int(number["component"]) - 1]
        return Dof(int(number["node"]), direction, -1 if number["after"] == "-" else 1)
    raise InputError(
        f"cannot read {text!r} as a degree of freedom; write node, direction and sense, as in 12Z+ or 3RX-{also}"
    )


def as_dof(text: str) -> Dof | None:
    """The degree of freedom that `text` names, see `parse_dof`; None if it names none."""
    try:
        return parse_dof(text)
    except InputError:
        return None


def parse_dofs(texts: Iterable[str | Dof], argument: str = "") -> tuple[Dof, ...]:
    """Degrees of freedom named by `texts`, in order; a single text is a list of one.

    Raises
    ------
    InputError
        If an entry cannot be read; the message begins with the name of the `argument`, where it is given.
    """
    with naming(argument):
        if not isinstance(texts, Iterable):
            raise InputError(f'a list of degrees of freedom is needed, such as ["1X", "2Y"], got {texts!r}')
        return tuple(parse_dof(text) for text in ([texts] if isinstance(texts, str) else texts))


def is_whole_number(text: str) -> bool:
    """True if `text` is 1 to 15 digits, as numbers of nodes are; `int` refuses some signs that count as digits, such as ``²``."""
    return text.isdecimal() and len(text) <= 15


def dofs_of_text(text: str | Dof) -> list[Dof]:
    """Degrees of freedom that a text names: ``1X-`` is one, ``1 X RZ`` two of node 1, and ``1`` all six of node 1.

    Raises
    ------
    InputError
        If it is none of these forms.
    """
    words: list[str | Dof] = [text]
    if isinstance(text, str):
        several = _SEVERAL.match(text)
        if several:
            words = [several[1] + direction for direction in several[2].split()]
        elif is_whole_number(text.strip()):
            words = [f"{text.strip()}{direction}" for direction in DIRECTIONS]
    return [_parsed(word, ', or a whole node, as in "12"') for word in words]


def renamed(
    sensors: Sequence[Dof], loads: Sequence[Dof], names: Mapping[str, str]
) -> tuple[tuple[Dof, ...], tuple[Dof, ...]]:
    """`sensors` and `loads` with their channels renamed by `names`.

    Parameters
    ----------
    sensors, loads : sequence of Dof
        Channels as the record names them.
    names : mapping of str to str
        True name of a channel by its name in the record: the sensors of that name whatever their sign, or the
        loads where no sensor has it; ``load 3Z`` is the load in any case. A name such as ``3Z-`` reverses the sign.

    Raises
    ------
    InputError
        If there is no channel of a name, or two would have the same one.

    Examples
    --------
    >>> sensors, loads = renamed(parse_dofs(["3Z-", "5Z"]), parse_dofs(["3Z"]), {"3Z": "5Z", "5Z": "3Z"})
    >>> [str(dof) for dof in (*sensors, *loads)]
    ['5Z-', '3Z+', '3Z+']
    """
    of_sensors, of_loads = {dof.unsigned for dof in sensors}, {dof.unsigned for dof in loads}
    wanted: tuple[dict[Dof, Dof], dict[Dof, Dof]] = ({}, {})
    for text, other in names.items():
        is_load = text.startswith(_LOAD)
        old, new = parse_dof(text.removeprefix(_LOAD)), parse_dof(other)
        if old.unsigned not in of_loads and (is_load or old.unsigned not in of_sensors):
            known = ", ".join(dict.fromkeys(str(channel) for channel in (*sensors, *loads)))
            raise InputError(f"there is no {'load' if is_load else 'channel'} {old.place}; the record has {known}")
        chosen = wanted[is_load or old.unsigned not in of_sensors]
        if old.unsigned in chosen:
            raise InputError(f"{text} is renamed twice; give it one name")
        chosen[old.unsigned] = Dof(new.node, new.direction, new.sign * old.sign)
    return _rename_dofs(sensors, wanted[0]), _rename_dofs(loads, wanted[1])


def _rename_dofs(dofs: Sequence[Dof], names: Mapping[Dof, Dof]) -> tuple[Dof, ...]:
    """Copy of `dofs` in order with new names and combined signs.

    `names` maps unsigned degrees of freedom to new ones; others keep theirs. Raises `InputError` if two would have the
    same name.
    """
    before: dict[Dof, Dof] = {}
    for dof in dict.fromkeys(dof.unsigned for dof in dofs):
        new = names.get(dof, dof).unsigned
        other = before.setdefault(new, dof)
        if other != dof:
            raise InputError(
                f"{other.place} and {dof.place} would both be called {new.place}; give one of them another name"
            )
    now = [names.get(dof.unsigned, dof.unsigned) for dof in dofs]
    return tuple(Dof(new.node, new.direction, new.sign * dof.sign) for new, dof in zip(now, dofs, strict=True))
