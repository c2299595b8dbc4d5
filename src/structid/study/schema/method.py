"""The ``[method]`` of a study file as `IdentifyOptions`: every field of it and of its groups is a key."""

from __future__ import annotations

import inspect
import re
from dataclasses import fields, is_dataclass
from typing import TypeVar

from structid.core.constraints import declared_types, parameter_descriptions
from structid.identification.options import IdentifyOptions
from structid.inversion.search.levenberg_marquardt import GaussNewton, LevenbergMarquardt
from structid.study.schema.section import Section
from structid.study.schema.tables import Given, Key, Table, choice, table_of

#: Fields that the file knows by another name.
_NAMES = {"direction": "total_mass_direction"}
#: Fields that other tables give.
_ELSEWHERE = ("regularization", "matrix_free", "tolerances")
#: Groups of which `search` says which; of a search without a Jacobian it is the first, and a field says so.
_SEARCHES = {"method": (LevenbergMarquardt, GaussNewton)}
_MATRIX_FREE = "matrix_free"

T = TypeVar("T")


def read_method(section: Section | None) -> IdentifyOptions:
    """The options that the section ``[method]`` states; the defaults if `section` is None.

    `StudyError` if a key does not belong to the chosen `search`, or the options cannot be used.
    """
    if section is None:
        return IdentifyOptions()
    values = section.values(method_table())
    with section.located():
        options = _make_options(IdentifyOptions, values, values.pop("search", None))
    for name in values:
        raise section.error("is none of this `search`; leave it out, or choose another search", name)
    return options


def method_table(options: type = IdentifyOptions) -> Table:
    """All keys of ``[method]``, or, for another dataclass `options`, those that its fields contribute.

    A field that holds a dataclass gives the keys of that class; a field with a choice of searches gives the keys of all
    of them, and the key ``search``.
    """
    groups = {item.name: _key_classes(options, item.name) for item in fields(options)}
    table = table_of(options, [name for name, kinds in groups.items() if kinds or name in _ELSEWHERE])
    merged = Table({_NAMES.get(name, name): key for name, key in table.keys.items()})
    for name, kinds in groups.items():
        for keys in (method_table(kind).keys for kind in kinds):
            merged |= {
                key: Key(known_key.holds, known_key.words) if key in merged.keys else known_key
                for key, known_key in keys.items()
            }
        if name in _SEARCHES:
            merged |= {"search": Key(choice(*map(_name, kinds), _MATRIX_FREE), parameter_descriptions(options)[name])}
    return merged


def _make_options(options: type[T], values: Given, search: str | None) -> T:
    """An object of the class `options` made from `values`, from which the keys that it takes are removed.

    Arguments that are dataclasses are made from `values` too; keys that are missing keep the defaults of the class,
    whose errors are not caught. `search` is the name of the search method; None for the default.
    """
    arguments: Given = {}
    for item in inspect.signature(options).parameters:
        kinds, name = _key_classes(options, item), _NAMES.get(item, item)
        if kinds:
            chosen = next((kind for kind in kinds if _name(kind) == search), kinds[0])
            arguments[item] = _make_options(chosen, values, search)
        elif item == _MATRIX_FREE and search is not None:
            arguments[item] = search == _MATRIX_FREE
        elif name in values:
            arguments[item] = values.pop(name)
    return options(**arguments)


def _key_classes(options: type, name: str) -> tuple[type, ...]:
    """Classes whose fields are keys of ``[method]`` in place of the field `name` of the dataclass `options`.

    They are those of all searches for the field of the search method. The tuple is empty if the field is a key itself,
    or is stated elsewhere in the study.
    """
    kind = declared_types(options)[name]
    if name in _ELSEWHERE:
        return ()
    return _SEARCHES.get(name, (kind,) if isinstance(kind, type) and is_dataclass(kind) else ())


def _name(kind: type) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", kind.__name__).lower()
