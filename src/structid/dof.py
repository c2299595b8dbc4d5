"""Degrees of freedom by name: a node label, a direction and a sense, written `12Z+`."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from structid.errors import InputError

DIRECTIONS = ("X", "Y", "Z", "RX", "RY", "RZ")

_WORD = re.compile(
    r"^\s*(?P<node>\d{1,15})\s*[:_ ]?\s*(?P<before>[+-]?)\s*(?P<direction>R?[XYZ])\s*(?P<after>[+-]?)\s*$",
    re.IGNORECASE,
)
_NUMBER = re.compile(r"^\s*(?P<node>\d{1,15})\.0?(?P<component>[1-6])\s*(?P<after>[+-]?)\s*$")


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
        if self.direction not in DIRECTIONS:
            raise InputError(f"`direction` must be one of {' '.join(DIRECTIONS)}, got {self.direction!r}")
        if self.sign not in (1, -1):
            raise InputError(f"`sign` must be 1 or -1, got {self.sign!r}")

    @property
    def axis(self) -> int:
        """0 to 5 for X Y Z RX RY RZ."""
        return DIRECTIONS.index(self.direction)

    @property
    def is_rotation(self) -> bool:
        return self.direction.startswith("R")

    @property
    def unsigned(self) -> Dof:
        """The same place and direction, counted positive along the axis."""
        return self if self.sign > 0 else Dof(self.node, self.direction)

    def __str__(self) -> str:
        return f"{self.node}{self.direction}{'+' if self.sign > 0 else '-'}"


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
    if isinstance(text, Dof):
        return text
    word = _WORD.match(text)
    if word:
        senses = word["before"] + word["after"]
        if len(senses) > 1:
            raise InputError(f"degree of freedom {text!r} has two signs; write one, as in 12Z- or 12:-Z")
        return Dof(int(word["node"]), word["direction"].upper(), -1 if senses == "-" else 1)
    number = _NUMBER.match(text)
    if number:
        direction = DIRECTIONS[int(number["component"]) - 1]
        return Dof(int(number["node"]), direction, -1 if number["after"] == "-" else 1)
    raise InputError(
        f"cannot read {text!r} as a degree of freedom; write node, direction and sense, as in 12Z+ or 3RX-"
    )


def parse_dofs(texts: Iterable[str | Dof]) -> tuple[Dof, ...]:
    """Every text of `texts` as a `Dof`, in order."""
    return tuple(parse_dof(text) for text in texts)
