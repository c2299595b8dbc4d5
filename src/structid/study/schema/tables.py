"""Tables of a study file, declared: their keys, what these hold, which are required, and what each of them is."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, is_dataclass
from functools import cache, cached_property
from typing import Annotated, Any, TypeAlias, get_args, get_origin

from structid.core.constraints import alternatives, declared_types, parameter_descriptions
from structid.core.dof import Dof
from structid.study.schema.kinds import Kind, Schema, kind_of

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
