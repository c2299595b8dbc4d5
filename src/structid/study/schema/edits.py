"""Edits of a study's text: keys set, tables added and taken out; every other letter stays as it was."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import tomlkit
from tomlkit.items import Array

from structid.core.errors import InputError
from structid.study.schema.toml_lines import KeyPath, TomlTokens, header, parse_toml, read_key, words_of


@dataclass(frozen=True)
class _Span:
    """Indices in a text: where the line of a key begins, where its value begins and ends, and the next line begins."""

    start: int
    value: int
    end: int
    line_end: int


@dataclass
class TomlBlock:
    """A header and the keys under it; the first block, without a path, has the keys above all headers.

    `start` is where the line of the header begins, `own_end` where the line after the last of its keys begins.
    """

    path: KeyPath
    start: int
    own_end: int
    pairs: dict[KeyPath, _Span] = field(default_factory=dict)


def blocks_of(text: str) -> list[TomlBlock]:
    """Tables of a valid TOML text in order, each with the positions of its keys and values.

    The first block has no header; it holds the keys above all headers.
    """
    tokens = words_of(text, " \t#\n")
    blocks = [TomlBlock((), 0, 0)]
    counts: dict[KeyPath, int] = {}
    while tokens:
        if tokens[-1][0] == "[" and _begins_line(text, tokens[-1][1]):
            start = tokens[-1][1]
            path = header(tokens, counts, {})
            blocks.append(TomlBlock(path, text.rfind("\n", 0, start) + 1, _after_line(text, start)))
        else:
            _add_key(text, tokens, blocks[-1])
    return blocks


def _begins_line(text: str, offset: int) -> bool:
    return not text[text.rfind("\n", 0, offset) + 1 : offset].strip()


def _after_line(text: str, offset: int) -> int:
    end = text.find("\n", offset)
    return len(text) if end < 0 else end + 1


def _add_key(text: str, tokens: TomlTokens, block: TomlBlock) -> None:
    """Move the key and value that come next in `tokens` into `block`, with their positions in `text`.

    `tokens` are words with their indices in `text`, the next one last; those of key and value are removed from them.
    """
    parts, start = read_key(tokens, "=")
    begin = tokens[-1][1]
    end = _value_end(tokens)
    line_start = text.rfind("\n", 0, start) + 1
    block.pairs[tuple(parts)] = _Span(line_start, begin, end, _after_line(text, end))
    block.own_end = _after_line(text, end)


def _value_end(tokens: TomlTokens) -> int:
    """Index in the text after the end of the next value, whose words (with their indices) are removed from `tokens`."""
    token, at = tokens.pop()
    end = at + len(token)
    if token in ("[", "{"):
        depth = 1
        while depth:
            token, at = tokens.pop()
            depth += (token in "[{") - (token in "]}")
            end = at + len(token)
        return end
    while tokens and tokens[-1][1] == end and tokens[-1][0] not in "[]{},=":
        token, at = tokens.pop()
        end = at + len(token)
    return end


#: Sections of a study in the order in which they are written.
_ORDER = ("structure", "unknown", "record", "method", "regularization", "plan")
_BARE = re.compile(r"[A-Za-z0-9_-]+")


def edited(text: str, edits: Sequence[Mapping[str, Any]]) -> str:
    """TOML text after all `edits`, made in order.

    Parameters
    ----------
    text : str
        A TOML text.
    edits : sequence of mappings
        ``{"set": path, "to": text}`` changes a key, or adds it, and its table if that is missing; ``{"remove":
        path}``; ``{"add": path, "table": {key: text}}`` appends to an array of tables, which is begun if missing.
        Paths are lists of names, and of positions (from 0) in arrays of tables. ``{"list": path}`` makes a table
        the first of an array of tables. The texts are TOML values, such as ``1.6e6`` or ``["1X"]``.

    Raises
    ------
    InputError
        If the text is not TOML, a text is not a TOML value, or a path leads to an entry of an array, or to
        something to remove, that is not there; nothing is changed then.
    """
    if edits:
        _require_toml(text, "the study is no TOML as it stands")
    for edit in edits:
        text = _after_edit(text, edit)
        _require_toml(text, "this edit would break the study")
    return text


def _after_edit(text: str, edit: Mapping[str, Any]) -> str:
    """TOML text after one edit; it may be no TOML any more.

    `edit` has the key "add", "list", "remove" or "set" with the path, and "table" or "to" with the new content.
    `InputError` if the edit cannot be made, also because an edit before it left no TOML.
    """
    try:
        return _edited_once(text, edit)
    except InputError:
        raise
    except (ValueError, LookupError) as error:
        action, path = next((key, edit[key]) for key in ("add", "list", "remove", "set") if key in edit)
        raise InputError(
            f"{action} {_words(tuple(path))}: cannot be done as the study is written; edit the study file"
        ) from error


def _edited_once(text: str, edit: Mapping[str, Any]) -> str:
    """TOML text after one edit, a mapping with the key ``add``, ``list``, ``remove`` or ``set``.

    This key holds the path that is changed, of names and positions (from 0). ``add`` comes with ``table`` (TOML texts
    by key), ``set`` with ``to`` (a TOML value). The text is not checked. `InputError`, `ValueError` or `LookupError` if
    the edit cannot be made.
    """
    if "add" in edit:
        return _with_entry(text, tuple(edit["add"]), edit["table"])
    if "list" in edit:
        return _as_array_of_tables(text, tuple(edit["list"]))
    if "remove" in edit:
        return _without_key(text, tuple(edit["remove"]))
    return _with_value(text, tuple(edit["set"]), value_of(str(edit["to"])))


def changed_text(text: str, change: Callable[[dict[str, Any]], None]) -> str:
    """TOML text after `change` of its content; unchanged lines and all comments stay as they were.

    Parameters
    ----------
    text : str
        A TOML text.
    change : callable
        Changes the content, plain tables and lists, in place: keys are set or deleted, entries of arrays of tables changed,
        deleted or appended.

    Raises
    ------
    InputError
        If the text is not TOML, or is written in a way that has no line for the change.
    """
    after: Any = _require_toml(text, "the study is no TOML as it stands")
    entries = list(_numbered_entries(after))  # kept alive: a new table could have the identity of one that is gone
    numbers = {id(entry): number for entry, number in entries}
    change(after)
    for edit in _edits_between((), parse_toml(text), after, numbers):
        text = _after_edit(text, edit)
    if _require_toml(text, "this change would break the study") != after:
        raise InputError("the study is written in a way that has no line for the change; write its tables in blocks")
    return text


def _numbered_entries(content: Any) -> Iterator[tuple[dict[str, Any], int]]:
    """Pairs of each table in a list and its position there (from 0), through nested lists and tables.

    `content` is a parsed TOML text or a part of it.
    """
    for number, value in enumerate(content.values() if isinstance(content, dict) else content):
        if isinstance(content, list) and isinstance(value, dict):
            yield value, number
        if isinstance(value, dict | list):
            yield from _numbered_entries(value)


def _edits_between(path: KeyPath, before: Any, after: Any, numbers: Mapping[int, int]) -> Iterator[dict[str, Any]]:
    """Edits, as mappings, that turn the content `before` under `path` into `after` when made one after another.

    In an array of tables, entries that are still there are changed, those that are gone are removed from the last one
    on, and new ones are appended; other lists are written anew. `numbers` gives the position, from 0, that each table
    of an array in `after` had before, by the `id` of the table; a table without a number is new.
    """
    if isinstance(before, dict) and isinstance(after, dict):
        for key in before:
            if key not in after:
                yield {"remove": [*path, key]}
        for key, value in after.items():
            if key in before:
                yield from _edits_between((*path, key), before[key], value, numbers)
            elif _is_list_of_tables(value):
                yield from _added_entries((*path, key), value)
            else:
                yield {"set": [*path, key], "to": _value_text(value)}
    elif isinstance(after, list) and _is_list_of_tables(before) and all(isinstance(entry, dict) for entry in after):
        kept = {numbers[id(entry)]: entry for entry in after if id(entry) in numbers}
        for number, entry in kept.items():
            yield from _edits_between((*path, number), before[number], entry, numbers)
        for number in reversed(range(len(before))):
            if number not in kept:
                yield {"remove": [*path, number]}
        yield from _added_entries(path, [entry for entry in after if id(entry) not in numbers])
    elif before != after:
        yield {"set": [*path], "to": _value_text(after)}


def _is_list_of_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(entry, dict) for entry in value)


def _added_entries(path: KeyPath, entries: Sequence[Mapping[str, Any]]) -> Iterator[dict[str, Any]]:
    """Edits, as `edited` takes them, that append `entries` to the array of tables at `path`."""
    for entry in entries:
        yield {"add": [*path], "table": {key: _value_text(value) for key, value in entry.items()}}


def _value_text(value: Any) -> str:
    """TOML text, on one line, of a value: a number, text, list or table."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_name((key,))} = {_value_text(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_value_text, value)) + "]"
    return str(tomlkit.item(value).as_string())


def value_of(text: str) -> str:
    """The text of one TOML value without blanks around it; `InputError` unless it is exactly one value on one line."""
    written = text.strip()
    try:
        count = len(parse_toml(f"value = [{written}]")["value"])
        parse_toml(f"value = {written}\n")
    except (ValueError, RecursionError, KeyError) as error:
        raise InputError(f'{text!r} is no value; write a number, "a text", or a list in brackets') from error
    if "\n" in written or count != 1:
        raise InputError(f"{text!r} is not one value")
    return written


def _require_toml(text: str, words: str) -> dict[str, Any]:
    """Content of the TOML text `text`; `InputError`, whose message begins with `words`, if it is no TOML."""
    try:
        return parse_toml(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{words}, so nothing was changed: {error}") from error


def _with_value(text: str, path: KeyPath, value: str) -> str:
    """TOML text with the key at `path` set to `value` (TOML text), changed in place or added to its table.

    A table that is missing is added too, and an inline table sets one that is written in blocks key by key.
    `InputError` if the path ends in a position or a table, or leads to an entry that is not there.
    """
    blocks = blocks_of(text)
    if value.startswith("{") and _is_spread(blocks, path):
        return _set_spread(text, path, value)
    if not path or not isinstance(path[-1], str):
        raise InputError(f"{_words(path)}: the last part of a path must be the name of a key")
    for block in blocks:
        for key, span in block.pairs.items():
            if block.path + key == path:
                return text[: span.value] + value + text[span.end :]
            if len(block.path + key) < len(path) and path[: len(block.path + key)] == block.path + key:
                return _changed_inline(text, span, path[len(block.path + key) :], value)
    if any(block.path[: len(path)] == path for block in blocks):
        raise InputError(f"{_words(path)}: is a table; change the keys in it")
    for block in blocks:
        for key, span in block.pairs.items():
            if len(key) > 1 and block.path + key[:-1] == path[:-1]:  # its neighbours are written with points
                return _inserted_line(text, span.line_end, f"{_name((*key[:-1], path[-1]))} = {value}\n")
    holder = next((block for block in blocks if block.path == path[:-1]), None)
    for length in range(1, len(path)):
        if isinstance(path[length - 1], int) and not any(block.path[:length] == path[:length] for block in blocks):
            raise InputError(f"the study has no {_words(path[:length])} any more; it was changed since")
    line = f"{_name(path[-1:])} = {value}\n"
    if holder is not None:
        return _inserted_line(text, holder.own_end, line)
    return _inserted_block(text, blocks, path[:-1], f"[{_name(path[:-1])}]\n{line}")


def _is_spread(blocks: Sequence[TomlBlock], path: KeyPath) -> bool:
    """True if the table at `path` has a header of its own, or dotted keys, and is not an inline table."""
    named = [block.path + key[:-1] for block in blocks for key in block.pairs if len(key) > 1]
    return path in [*(block.path for block in blocks), *named]


def _set_spread(text: str, path: KeyPath, value: str) -> str:
    """TOML text with the table at `path`, written in block form, set key by key, so that comments stay.

    `value` is the new table as TOML text; keys that it lacks are removed.
    """
    wanted: Any = tomlkit.value(value)
    there = [block.path + key for block in blocks_of(text) for key in block.pairs]
    for key in there:
        if key[: len(path)] == path and key[len(path)] not in wanted:
            text = _without_key(text, key)
    for name, one in wanted.items():
        text = _with_value(text, (*path, str(name)), one.as_string())
    return text


def _changed_inline(text: str, span: _Span, keys: KeyPath, value: str | None) -> str:
    """TOML text with the entry at `keys` inside an inline table or list set to `value`, or removed if that is None.

    `span` is the position of the whole inline value. If that is a list and becomes empty, its key is removed too.
    `InputError` if `keys` leads nowhere in the value.
    """
    whole: Any = tomlkit.value(text[span.value : span.end])
    try:
        container = whole
        for part in keys[:-1]:
            container = container[part]
        if value is None:
            del container[keys[-1]]
        else:
            container[keys[-1]] = tomlkit.value(value)
    except (LookupError, TypeError):
        raise InputError(
            f"{_words(keys)}: is not in {text[span.value : span.end]!r} and cannot be put there; edit the study file"
        ) from None
    if isinstance(whole, Array) and not len(whole):
        return text[: span.start] + text[span.line_end :]
    return text[: span.value] + whole.as_string() + text[span.end :]


def _without_key(text: str, path: KeyPath) -> str:
    """TOML text without the key or table at `path`, with all that is in it; `InputError` if it is not there."""
    blocks = blocks_of(text)
    for block in blocks:
        for key, span in block.pairs.items():
            if block.path + key == path:
                return text[: span.start] + text[span.line_end :]
            if path[: len(block.path + key)] == block.path + key:
                return _changed_inline(text, span, path[len(block.path + key) :], None)
    dotted = [
        span
        for block in blocks
        for key, span in block.pairs.items()
        if len(block.path) < len(path) and (block.path + key)[: len(path)] == path
    ]
    if dotted:
        for span in reversed(dotted):
            text = text[: span.start] + text[span.line_end :]
        return text
    gone = [block for block in blocks if block.path and block.path[: len(path)] == path]
    if not gone:
        raise InputError(f"the study has no {_words(path)} any more; it was changed since")
    for block in reversed(gone):
        after = text[block.own_end :].lstrip("\n")
        before = text[: block.start]
        text = before + after if after else before.rstrip("\n") + "\n"
    return text


def _as_array_of_tables(text: str, path: KeyPath) -> str:
    """TOML text with the header ``[path]`` turned into ``[[path]]``, that of the first entry of an array of tables.

    `InputError` if the table has no header of its own.
    """
    first = next((block for block in blocks_of(text) if block.path[: len(path)] == path), None)
    if first is None or first.path != path:
        raise InputError(
            f"{_words(path)}: cannot become one of several as it is written; put [{_name(path)}] above its keys"
        )
    begin = text.index("[", first.start)
    end = text.index("]", begin)
    return f"{text[:begin]}[{text[begin : end + 1]}]{text[end + 1 :]}"


def _with_entry(text: str, path: KeyPath, table: Mapping[str, str]) -> str:
    """TOML text with a new entry at the end of the array of tables at `path`, which is begun if there is none.

    `table` has TOML texts by key, each one value, else `InputError`.
    """
    keys = "".join(f"{_name((key,))} = {value_of(str(value))}\n" for key, value in table.items())
    entry = f"[[{_name(path)}]]\n{keys}"
    blocks = blocks_of(text)
    for block in blocks:
        for key, span in block.pairs.items():
            if block.path + key == path:
                listed: Any = tomlkit.value(text[span.value : span.end])
                if isinstance(listed, Array):
                    listed.append(tomlkit.value(f"{{ {', '.join(keys.splitlines())} }}"))
                    return text[: span.value] + listed.as_string() + text[span.end :]
    same = [block for block in blocks if block.path[: len(path)] == path and len(block.path) > len(path)]
    if same:
        return _inserted_text(text, max(block.own_end for block in same), entry)
    return _inserted_block(text, blocks, path, entry)


def _inserted_block(text: str, blocks: Sequence[TomlBlock], path: KeyPath, entry: str) -> str:
    """TOML text with the new table `entry` (TOML text) inserted after related tables, or at its customary position.

    `blocks` are the tables of `text`, `path` is that of the new table. Tables are related by the longest common start
    of their paths; without any, sections stand in the order structure, unknown, record, method, regularization, plan,
    and others last.
    """
    for length in range(len(path) - 1, 0, -1):
        near = [block for block in blocks if block.path and block.path[:length] == path[:length]]
        if near:
            return _inserted_text(text, max(block.own_end for block in near), entry)
    names = list(_ORDER[_ORDER.index(str(path[0])) + 1 :]) if path[0] in _ORDER else []
    later = [block for block in blocks if block.path and block.path[0] in names]
    if later:
        at = _above_comments(text, later[0].start)
        return text[:at] + entry + "\n" + text[at:]
    return _inserted_text(text, len(text), entry)


def _inserted_line(text: str, offset: int, line: str) -> str:
    before = text[:offset]
    return before + ("" if not before or before.endswith("\n") else "\n") + line + text[offset:]


def _inserted_text(text: str, offset: int, entry: str) -> str:
    """TOML text with the table `entry` (TOML text) inserted at `offset`, after a blank line."""
    before = text[:offset].rstrip("\n")
    return before + ("\n\n" if before else "") + entry + text[offset:]


def _above_comments(text: str, offset: int) -> int:
    """Index in `text` where the comment lines directly above position `offset` begin; `offset` itself if there are none."""
    while offset > 0:
        start = text.rfind("\n", 0, offset - 1) + 1
        if not text[start:offset].startswith("#"):
            break
        offset = start
    return offset


def _name(path: KeyPath) -> str:
    parts = [part for part in path if isinstance(part, str)]
    return ".".join(part if _BARE.fullmatch(part) else json.dumps(part) for part in parts)


def _words(path: KeyPath) -> str:
    return ".".join(str(part) for part in path)
