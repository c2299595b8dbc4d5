"""Edits of a study's text: keys set, tables added and taken out; comments and order of all else stay as they were."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import AoT, Item, Table
from tomlkit.toml_document import TOMLDocument

from structid.errors import InputError

#: Names of tables and keys, and positions in arrays of tables.
KeyPath = Sequence[str | int]
_BARE = re.compile(r"[A-Za-z0-9_-]+")


def edited(text: str, edits: Sequence[Mapping[str, Any]]) -> str:
    """`text` with `edits` made, in order.

    Parameters
    ----------
    text : str
        A TOML text.
    edits : sequence of mappings
        ``{"set": path, "to": value}``, the value as it would be written, such as ``1.6e6`` or ``["1X"]``;
        ``{"remove": path}``; ``{"add": path, "table": {key: value}}``, a new entry of an array of tables.

    Raises
    ------
    InputError
        If the text is no TOML, a value is none, or a path leads nowhere.
    """
    for edit in edits:
        text = _edited(text, edit)
    return text


def _edited(text: str, edit: Mapping[str, Any]) -> str:
    try:
        if "add" in edit:
            return _added(text, edit["add"], edit["table"])
        document = tomlkit.parse(text)
        if "remove" in edit:
            _remove(document, edit["remove"])
        else:
            _set(document, edit["set"], str(edit["to"]))
        found = tomlkit.dumps(document)
        tomllib.loads(found)
        return found
    except (TOMLKitError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"the study is no TOML as it stands, so nothing was changed: {error}") from error


def value_of(text: str) -> Item:
    """The value that `text` writes.

    Raises
    ------
    InputError
        If it is not exactly one value.
    """
    try:
        found = tomlkit.parse(f"value = {text}\n")
    except TOMLKitError as error:
        raise InputError(f"{text!r} is no value; write a number, \"a text\", or a list in brackets") from error
    if list(found) != ["value"] or "\n" in text.strip():
        raise InputError(f"{text!r} is more than one value")
    return found["value"]  # type: ignore[return-value]


def _set(document: TOMLDocument, path: KeyPath, value: str) -> None:
    item = value_of(value)
    holder: Any = document
    for part, after in zip(path, [*path[1:], ""], strict=True):
        if after == "":
            break
        if isinstance(part, str) and part not in holder and isinstance(after, str):
            _new_table(document, holder, part)
        holder = _inner(holder, part)
    key = path[-1]
    if isinstance(holder, AoT) or not isinstance(key, str):
        raise InputError(f"{path}: a key must be named")
    if key in holder and isinstance(holder[key], Item):
        item.trivia.comment, item.trivia.comment_ws = holder[key].trivia.comment, holder[key].trivia.comment_ws
        holder[key] = item
        return
    if isinstance(holder, Table):
        _append(holder, key, item)
    else:
        holder[key] = item


def _append(holder: Table, key: str, item: Item) -> None:
    """A new key after the last own key of a table: before blank lines, comments and tables that follow it."""
    own = [name for name, value in holder.items() if not isinstance(value, Table | AoT)]
    made = tomlkit.key(key if _BARE.fullmatch(key) else [key])
    if own:
        holder.value._insert_after(own[-1], made, item)
    elif len(holder):
        holder.value._insert_at(0, made, item)
    else:
        holder.append(made, item)


def _new_table(document: TOMLDocument, holder: Any, part: str) -> None:
    made = tomlkit.table()
    if holder is document:
        if document.as_string() and not document.as_string().endswith("\n\n"):
            document.add(tomlkit.nl())
    elif isinstance(holder, Table) and len(holder):
        last = holder.as_string()
        if not last.endswith("\n\n"):
            holder.add(tomlkit.nl())
    holder[part] = made


def _inner(holder: Any, part: str | int) -> Any:
    try:
        return holder[part]
    except (KeyError, IndexError, TypeError) as error:
        raise InputError(f"the study has no {part!r} there any more; it was changed since") from error


def _remove(document: TOMLDocument, path: KeyPath) -> None:
    holder: Any = document
    for part in path[:-1]:
        holder = _inner(holder, part)
    _inner(holder, path[-1])
    del holder[path[-1]]
    if isinstance(holder, AoT) and not len(holder):
        _remove(document, path[:-1])


def _added(text: str, path: KeyPath, table: Mapping[str, str]) -> str:
    """A new entry behind the last one of its array, or at the end of the text; by lines, so that all else stays."""
    name = ".".join(str(part) if _BARE.fullmatch(str(part)) else tomlkit.string(str(part)).as_string() for part in path)
    keys = "".join(f"{key} = {_checked(value)}\n" for key, value in table.items())
    lines = text.splitlines(keepends=True)
    header = f"[[{name}]]"
    starts = [k for k, line in enumerate(lines) if line.split("#")[0].strip().replace(" ", "") == header.replace(" ", "")]
    if not starts:
        return text.rstrip("\n") + ("\n\n" if text.strip() else "") + f"{header}\n{keys}"
    end = next((k for k in range(starts[-1] + 1, len(lines)) if lines[k].lstrip().startswith("[")), len(lines))
    while end > starts[-1] + 1 and (not lines[end - 1].strip() or lines[end - 1].lstrip().startswith("#")):
        end -= 1
    found = "".join(lines[:end]).rstrip("\n") + f"\n\n{header}\n{keys}" + "".join(lines[end:])
    tomllib.loads(found)
    return found


def _checked(value: str) -> str:
    value_of(value)
    return value.strip()
