"""Tables of a study file, declared: their keys, what these hold, which are required, and what each of them is.

A `Kind` is what a key holds: words for messages, the JSON Schema and the value that is made of it.
"""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, TypedDict, TypeVar, get_args, get_origin

from structid.core.constraints import Limits, alternatives, declared_types, parameter_descriptions
from structid.core.dof import Dof
from structid.core.json_types import JsonValue, as_list
from structid.fem.elements.element import (
    At,
    End,
    Ends,
    Nodes,
    OptionalSignedValues,
    OptionalValues,
    OtherEnd,
    OtherEnds,
    Tolerance,
    Translations,
    Values,
    Vector,
)

T = TypeVar("T")
_LARGEST = 1e100  # its square is still finite, and that of its reciprocal no zero
_TYPES: Mapping[str, type | tuple[type, ...]] = {
    "string": str, "integer": int, "number": (int, float), "boolean": bool, "array": list, "object": dict,
}  # fmt: skip
#: The keywords of JSON Schema that study files use.
Schema = TypedDict(
    "Schema",
    {
        "$ref": str,
        "type": str,
        "description": str,
        "default": JsonValue,
        "anyOf": "list[Schema]",
        "enum": list[str],
        "pattern": str,
        "items": "Schema",
        "minItems": int,
        "maxItems": int,
        "minimum": float,
        "exclusiveMinimum": float,
        "maximum": float,
        "exclusiveMaximum": float,
        "properties": "dict[str, Schema]",
        "required": list[str],
        "additionalProperties": "bool | Schema",
        "patternProperties": "dict[str, Schema]",
        "minProperties": int,
    },
    total=False,
)


def fits(value: JsonValue, schema: Schema) -> bool:
    """True if a value of a TOML file satisfies `schema`, by the keywords of JSON Schema that kinds use.

    Besides, the magnitude of a number other than 0 must be between 1e-100 and 1e100, integers must fit 64 bits, and a text must
    hold printable characters, line ends and tabs only.
    """
    if "anyOf" in schema:
        return any(fits(value, one) for one in schema["anyOf"])
    if not isinstance(value, _TYPES[schema["type"]]) or isinstance(value, bool) != (schema["type"] == "boolean"):
        return False
    if isinstance(value, str):
        shown = all(letter.isprintable() or letter in "\n\t" for letter in value)
        return (
            shown and value in schema.get("enum", (value,)) and re.search(schema.get("pattern", ""), value) is not None
        )
    if isinstance(value, list):
        few, many = schema.get("minItems", 0), schema.get("maxItems", len(value))
        return few <= len(value) <= many and all(fits(entry, schema["items"]) for entry in value)
    if isinstance(value, int | float) and not isinstance(value, bool):
        low, high = schema.get("minimum", -math.inf), schema.get("maximum", math.inf)
        above, below = schema.get("exclusiveMinimum", -math.inf), schema.get("exclusiveMaximum", math.inf)
        return _has_square(value) and low <= value <= high and above < value < below
    return True


def _has_square(value: int | float) -> bool:
    if value == 0:
        return True
    return 1 / _LARGEST <= abs(value) <= _LARGEST and (isinstance(value, float) or abs(value) < 2**63)


def _same(value: T) -> T:
    return value


def _any(value: JsonValue) -> bool:
    return True


@dataclass(frozen=True, eq=False)
class Kind:
    """Kind of value of a key: its words and its JSON Schema.

    Parameters
    ----------
    words : str
        As errors say it after "must be".
    schema : mapping
        As JSON Schema says it; `fits` tells by it.
    rule : callable
        What it cannot say, such as that two numbers increase.
    made : callable
        What is made of the value.
    remedy : str
        What to write in place of a value that is refused, where the words do not say it.
    """

    words: str
    schema: Schema
    rule: Callable[[Any], bool] = _any
    made: Callable[[Any], Any] = _same
    remedy: str = ""

    def accepts(self, value: JsonValue) -> bool:
        """True if the key may hold `value`."""
        return fits(value, self.schema) and self.rule(value)


def list_of(schema: Schema, size: int | None = None) -> Schema:
    limits: Schema = {"minItems": 1} if size is None else {"minItems": size, "maxItems": size}
    return {"type": "array", "items": schema, **limits}


def _tuple(value: JsonValue) -> JsonValue:
    return tuple(map(_tuple, value)) if isinstance(value, list) else value


def choice(*names: str) -> Kind:
    """The kind of a text that is one of `names`."""
    return Kind("one of " + ", ".join(f'"{name}"' for name in names), {"type": "string", "enum": list(names)})


def limit_kind(kind: Kind, limits: Limits) -> Kind:
    """The kind `kind` of a number, restricted to `limits`, which its words for error messages then name."""
    words = ("of " if limits.words.startswith("at least") else "") + limits.words
    schema: Schema = {**kind.schema}
    if limits.least is not None:
        schema["minimum"] = limits.least
    if limits.above is not None:
        schema["exclusiveMinimum"] = limits.above
    if limits.most is not None:
        schema["maximum"] = limits.most
    if limits.below is not None:
        schema["exclusiveMaximum"] = limits.below
    return replace(kind, words=f"{kind.words.partition(',')[0]} {words}", schema=schema)


def several(kind: Kind) -> Kind:
    """A kind that accepts a value of `kind` or a list of them, and makes a tuple of it."""
    plural = {NUMBER.words: "a number or a list of numbers", TEXT.words: "a text or a list of texts"}
    words = plural.get(kind.words, f"{kind.words}, or a list of these")
    return Kind(words, {"anyOf": [kind.schema, list_of(kind.schema)]}, made=_tuple)


def or_none(kind: Kind) -> Kind:
    """Kind that takes the values of `kind`, or an empty list for none."""
    return Kind(f"{kind.words}, or []", {"anyOf": [kind.schema, {"type": "array", "maxItems": 0}]}, made=_tuple)


def either(*kinds: Kind) -> Kind:
    """A kind that accepts what any of `kinds` accepts; a value is converted by the first of them that accepts it."""

    def made(value: JsonValue) -> Any:
        return next(kind for kind in kinds if kind.accepts(value)).made(value)

    words = " or ".join(kind.words for kind in kinds)
    return Kind(
        words,
        {"anyOf": [kind.schema for kind in kinds]},
        lambda value: any(kind.accepts(value) for kind in kinds),
        made,
    )


def _increase(pair: Sequence[float]) -> bool:
    return pair[0] < pair[1]


def _increase_all(pairs: Sequence[Sequence[float]]) -> bool:
    return all(map(_increase, pairs))


def _floats(pair: Sequence[float]) -> tuple[float, ...]:
    return tuple(map(float, pair))


_LABEL: Schema = {"type": "integer", "minimum": 0, "maximum": 2**31 - 1}
_NUMBER: Schema = {"type": "number"}
_TEXT: Schema = {"type": "string", "pattern": r"\S"}
_PAIR = list_of(_NUMBER, 2)

NUMBER = Kind("a number, as in 0.4", _NUMBER)
WHOLE = Kind("a whole number", {"type": "integer", "maximum": 2**31 - 1})
INTEGER = limit_kind(WHOLE, Limits(least=0))
COUNT = limit_kind(WHOLE, Limits(least=1))
BOOLEAN = Kind("true or false", {"type": "boolean"})
TEXT = Kind("a text in quotes", _TEXT)
TEXTS = several(TEXT)
NUMBERS = several(NUMBER)
PROPERTY = several(limit_kind(NUMBER, Limits(least=0)))
#: Degrees of freedom, of nodes that must exist.
DOF, DOFS = replace(TEXT), replace(TEXTS)
POSITION = Kind(
    "one to three coordinates in m, as in [0.0, 1.5]",
    {"anyOf": [_NUMBER, {**list_of(_NUMBER), "maxItems": 3}]},
    made=_tuple,
)
VECTOR = Kind("three numbers that are not all 0, as in [0, 1, 0]", list_of(_NUMBER, 3), any)
NODES = Kind(
    "node numbers, as in [[1, 2], [2, 3]]",
    {"anyOf": [_LABEL, list_of(_LABEL), list_of(list_of(_LABEL))]},
    lambda value: len({len(row) for row in as_list(value) if isinstance(row, list)}) < 2,
)
RANGE = Kind("two increasing numbers, as in [4.5, 85.0]", _PAIR, _increase, _floats)
RANGES = Kind(
    "a list of pairs of increasing numbers, as in [[49.5, 50.5]]",
    list_of(_PAIR),
    _increase_all,
    lambda value: tuple(map(_floats, value)),
)

WEIGHTED = Kind(
    'a list of degrees of freedom with coefficients, as in [["1X", 1.0]]',
    list_of(list_of({"anyOf": [_TEXT, _NUMBER]}, 2)),
    lambda value: all(TEXT.accepts(dof) and NUMBER.accepts(factor) for dof, factor in value),
)

CHANNEL_NAMES = Kind(
    'a table of names of channels, as in { "3Z" = "5Z", "5Z" = "3Z" }',
    {"type": "object", "minProperties": 1, "additionalProperties": _TEXT},
    lambda table: bool(table) and all(map(TEXT.accepts, table.values())),
)

_PART: Schema = {"type": "number", "minimum": 0, "maximum": 1}
PART = Kind("a number of at least 0 and at most 1, as in 0.01 for 1 %", _PART)
NOISE_PART = replace(PART, remedy="noise above 100 % of each value is given by `absolute`")
TOLERANCE = Kind(
    "a part from 0 to 1, as in 0.02 for 2 %, or a table of them, as in { mass = 0.02 }",
    {"anyOf": [_PART, {"type": "object", "minProperties": 1, "additionalProperties": _PART}]},
    lambda value: not isinstance(value, Mapping) or (bool(value) and all(map(PART.accepts, value.values()))),
    remedy="write 0.015 for 1.5 %, 0 for an exact value, or leave it out",
)

_PLAIN: dict[object, Kind] = {
    float: NUMBER,
    int: INTEGER,
    bool: BOOLEAN,
    str: TEXT,
    Path: TEXT,
    Dof: DOF,
    Values: PROPERTY,
    OptionalValues: PROPERTY,
    OptionalSignedValues: NUMBERS,
    Nodes: NODES,
    Tolerance: TOLERANCE,
    Vector: VECTOR,
    At: DOF,
    End: DOF,
    OtherEnd: DOF,
    Ends: DOFS,
    OtherEnds: DOFS,
    Translations: TEXTS,
    tuple[float, float]: RANGE,
    Sequence[tuple[float, float]]: RANGES,
}


def kind_of(annotation: object) -> Kind:
    """The kind of value that a key may hold for a field or argument with the type `annotation`.

    A kind in ``Annotated`` is taken as it is, limits restrict the number, and None in a union is ignored.

    Raises
    ------
    TypeError
        If no TOML value could.
    """
    if annotation in _PLAIN:
        return _PLAIN[annotation]
    parts, origin = alternatives(annotation), get_origin(annotation)
    if len(parts) > 1:
        lists = [part for part in parts if _is_list(part)]
        kinds = tuple(map(kind_of, lists or parts))
        return kinds[0] if len({kind.words for kind in kinds}) == 1 else either(*kinds)
    if parts != (annotation,):
        return kind_of(parts[0])
    if origin is Literal:
        return choice(*get_args(annotation))
    if origin is Annotated:
        inner, *marks = get_args(annotation)
        for mark in marks:
            if isinstance(mark, Kind):
                return mark
            if isinstance(mark, Limits):
                return limit_kind(WHOLE if inner is int else NUMBER, mark)
        return kind_of(inner)
    if _is_list(annotation):
        return several(kind_of(get_args(annotation)[0]))
    raise TypeError(f"no value of a study file could be {annotation}")


def _is_list(annotation: object) -> bool:
    origin = get_origin(annotation)
    return isinstance(origin, type) and issubclass(origin, Iterable) and not issubclass(origin, Mapping)


def flat(nodes: int | Sequence[int | Sequence[int]]) -> list[int]:
    """Node numbers from a number, a list of numbers or a list of lists, in one list."""
    rows = [nodes] if isinstance(nodes, int) else nodes
    return [node for row in rows for node in ([row] if isinstance(row, int) else row)]


#: Values of the keys of a table, each as its kind makes it.
Given: TypeAlias = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Key:
    """Declaration of one key of a table.

    Parameters
    ----------
    holds : Kind or Table
    words : str or callable
        What it is; a callable gives the words when they are asked for.
    required : bool
    default : object
        None where there is none, or it is not a plain value.
    listed : bool
        Whether it holds an array of tables: 1 or more of ``[[...]]``.
    """

    holds: Kind | Table
    words: str | Callable[[], str] = ""
    required: bool = False
    default: object = None
    listed: bool = False

    @property
    def description(self) -> str:
        """Words on the key for schemas and forms; "" where nothing says it."""
        return self.words() if callable(self.words) else self.words

    @property
    def holds_tables(self) -> bool:
        """True if it may hold a table, or several."""
        return isinstance(self.holds, Table) or "object" in _types(self.holds.schema)

    @property
    def holds_values(self) -> bool:
        """True if it may hold something other than tables."""
        return not self.listed and _types(self.holds.schema) != {"object"}

    @property
    def schema(self) -> Schema:
        """The key as JSON Schema, with its description and default if it has them.

        An array of items if the key is `listed`.
        """
        schema: Schema = {"type": "array", "items": self.holds.schema} if self.listed else {**self.holds.schema}
        if self.description:
            schema["description"] = self.description
        if isinstance(self.default, str | int | float | list):
            schema["default"] = self.default
        return schema


def deferred(declare: Callable[[], Table], short: Kind | None = None) -> Table:
    """A table whose module loads when its keys are asked for; `short` is its short form, which is known before."""
    return Table(DeferredKeys(lambda: declare().keys), short=short)


@dataclass(frozen=True, eq=False)
class DeferredKeys(Mapping[str, Key]):
    """Keys of a table whose module loads when they are asked for: a study without that table needs none of it.

    Parameters
    ----------
    declare : callable
        The keys.
    """

    declare: Callable[[], Mapping[str, Key]]

    @cached_property
    def _keys(self) -> Mapping[str, Key]:
        return self.declare()

    def __getitem__(self, name: str) -> Key:
        return self._keys[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._keys)

    def __len__(self) -> int:
        return len(self._keys)


@dataclass(frozen=True, eq=False)
class Table:
    """A table and all its keys.

    Parameters
    ----------
    keys : mapping of str to Key
    labels : Kind, optional
        What keys that are whole numbers hold, of a table by label of node.
    short : Kind, optional
        What may stand in place of the table.
    """

    keys: Mapping[str, Key] = field(default_factory=dict)
    labels: Kind | None = None
    short: Kind | None = None

    def __or__(self, more: Mapping[str, Key | Kind | Table]) -> Table:
        """Table with the keys of both; those of `more` replace equal names."""
        made = {name: one if isinstance(one, Key) else Key(one) for name, one in more.items()}
        return Table({**self.keys, **made}, self.labels, self.short)

    def only(self, *names: str) -> Table:
        """Table with the keys `names` alone, in their order."""
        return Table({name: self.keys[name] for name in names}, self.labels, self.short)

    @property
    def defaults(self) -> Given:
        """Default of each key that has one, by the name of the key."""
        return {name: key.default for name, key in self.keys.items() if key.default is not None}

    @property
    def schema(self) -> Schema:
        """The table as JSON Schema: an object with its keys and no others, but for numbers as keys if it has `labels`.

        Where the table may be written as one value instead (`short`), the schema allows either.
        """
        schema: Schema = {"type": "object", "additionalProperties": False}
        if self.keys:
            schema["properties"] = {name: key.schema for name, key in self.keys.items()}
        required = [name for name, key in self.keys.items() if key.required]
        if required:
            schema["required"] = required
        if self.labels is not None:
            schema["patternProperties"] = {"^[0-9]{1,9}$": self.labels.schema}
        return schema if self.short is None else {"anyOf": [self.short.schema, schema]}


def table_of(make: Callable[..., object], leave_out: Collection[str] = (), **others: Kind | Table) -> Table:
    """The table whose keys are the arguments of a class or function, from their annotations and its docstring.

    Parameters
    ----------
    make : class or function
        Its docstring, or a text in the annotation, describes each key.
    leave_out : collection of str
        Arguments that are no keys.
    **others : Kind or Table
        Kind or table of keys whose annotation does not say it, and of keys besides the arguments.
    """
    types, words = declared_types(make), parameter_descriptions(make)
    keys = {}
    for name, item in inspect.signature(make).parameters.items():
        if name not in leave_out:
            required = item.default is inspect.Parameter.empty
            default = None if required else item.default
            holds = others.pop(name, None) or kind_of_argument(types[name])
            keys[name] = Key(holds, words.get(name) or _annotated_words(types[name]), required, default)
    return Table(keys) | others


#: The same without more said, kept for the next entry of its kind.
own_table: Callable[[Callable[..., object]], Table] = cache(table_of)


def kind_of_argument(annotation: object) -> Kind | Table:
    """The table (for a dataclass) or kind of value that a key for an argument with this annotation holds."""
    parts = alternatives(annotation)
    if len(parts) == 1 and isinstance(parts[0], type) and is_dataclass(parts[0]) and parts[0] is not Dof:
        return table_of(parts[0])
    return kind_of(annotation)


def _types(schema: Schema) -> set[str]:
    """Every type that JSON Schema lets a value have."""
    return {schema["type"]} if "type" in schema else set().union(*map(_types, schema["anyOf"]))


def _annotated_words(annotation: object) -> str:
    """The text in an ``Annotated`` annotation, which describes a key; "" if there is none."""
    marks = get_args(annotation)[1:] if get_origin(annotation) is Annotated else ()
    return next((mark for mark in marks if isinstance(mark, str)), "")
