"""The ``[method]`` of a study file as `IdentifyOptions`: every field of it and of its groups is a key."""

from __future__ import annotations

import re
from dataclasses import fields, is_dataclass
from typing import Any

from structid.declared import alternatives, declared_types, declared_words
from structid.identification.identify import IdentifyOptions
from structid.study.schema.kinds import choice
from structid.study.schema.section import Section
from structid.study.schema.tables import Key, Table, table_of

#: Fields that the file knows by another name.
_NAMES = {"direction": "total_mass_direction"}
#: Fields that tables of their own give.
_ELSEWHERE = ("regularization",)
#: Which of several groups is meant; without a Jacobian there is none, but a field says so.
_SEARCH, _MATRIX_FREE = "search", "matrix_free"


def read_method(section: Section | None) -> IdentifyOptions:
    """The options that ``[method]`` gives; the defaults where there is none."""
    if section is None:
        return IdentifyOptions()
    given = section.values(method_table())
    search = given.pop(_SEARCH, None)
    made: IdentifyOptions = _made(IdentifyOptions, given, search)
    for name in given:
        raise section.error(f"is none of this `{_SEARCH}`; leave it out, or choose another search", name)
    return made


def method_table(options: type = IdentifyOptions) -> Table:
    """All keys of ``[method]``, or those that one group of its options makes."""
    types, words = declared_types(options), declared_words(options)
    groups = {item.name: _groups(types[item.name]) for item in fields(options)}
    plain = [name for name, kinds in groups.items() if not kinds and name not in (*_ELSEWHERE, _MATRIX_FREE)]
    own = table_of(options, [name for name in groups if name not in plain])
    made = Table({_NAMES.get(name, name): own.keys[name] for name in plain})
    for name, kinds in groups.items():
        for kind in kinds:
            keys = method_table(kind).keys
            made |= {key: Key(one.holds, one.words) if key in made.keys else one for key, one in keys.items()}
        if len(kinds) > 1:
            made |= {_SEARCH: Key(choice(*map(_name, kinds), _MATRIX_FREE), words[name])}
    return made


def _made(options: type, given: dict[str, Any], search: str | None) -> Any:
    """An object of this class from keys, which are taken out of `given`, and the `search` that is asked for."""
    types, usual, arguments = declared_types(options), options(), {}
    for item in fields(options):
        kinds = _groups(types[item.name])
        if kinds:
            chosen = [kind for kind in kinds if _name(kind) == search] or [type(getattr(usual, item.name))]
            arguments[item.name] = _made(chosen[0], given, search)
        elif item.name == _MATRIX_FREE and search is not None:
            arguments[item.name] = search == _MATRIX_FREE
        elif _NAMES.get(item.name, item.name) in given:
            arguments[item.name] = given.pop(_NAMES.get(item.name, item.name))
    return options(**arguments)


def _groups(annotation: Any) -> tuple[type, ...]:
    """Classes whose fields are keys, in place of a field of this annotation."""
    parts = alternatives(annotation)
    return parts if all(map(is_dataclass, parts)) else ()


def _name(kind: type) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", kind.__name__).lower()
