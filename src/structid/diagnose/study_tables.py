"""The tables of a study file, found and changed: plain ones, or those of an editor of TOML that keeps comments."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from structid.core.dof import Dof, dofs_of_text, parse_dof
from structid.core.errors import InputError
from structid.core.json_types import Tables, as_list

#: Tables that tie nodes together: no elements.
_TIES = ("rigid_link", "constraint")


class NoStudyTextError(InputError):
    """The edit cannot be written in this study file, which is written in a way that has no line for it."""


def element_tables(study: Tables) -> Iterator[tuple[str, Tables]]:
    """Pairs (type, table) of every element set and tie of a study, such as ``spring`` and its entries."""
    for kind, entries in study["structure"].items():
        for entry in entries if isinstance(entries, list) else ():
            if isinstance(entry, dict):
                yield kind, entry


def element_table(study: Tables, name: str) -> Tables:
    """The table of the element set with the name `name`; a tie of this name does not count.

    Raises
    ------
    NoStudyTextError
        If the study has no such table.
    """
    for kind, entry in element_tables(study):
        if entry.get("name") == name and kind not in _TIES:
            return entry
    raise NoStudyTextError(f"{name} is no table of the study")


def append(table: Tables, key: str, entry: Tables) -> None:
    """Append `entry` to the array of tables under `key` in `table`, which is made if it is missing."""
    if key in table:
        table[key].append(entry)
    else:
        table[key] = [entry]


def record_tables(study: Tables) -> list[Tables]:
    """The table of every record in the study, in order."""
    return list(as_list(study["record"]))


def support_tables(study: Tables) -> list[Tables]:
    """The tables that may hold supports by ``fixed``: that of the structure, then those of records that have the key."""
    return [study["structure"], *(r["structure"] for r in record_tables(study) if "fixed" in r.get("structure", {}))]


def release(table: Tables, dof: Dof) -> bool:
    """Take the degree of freedom `dof` out of the ``fixed`` of a table, in place; True if it was held there."""
    kept: list[str] = []
    is_there = False
    for text in as_list(table.get("fixed", [])):
        held = dofs_of_text(text)
        others = [one.direction for one in held if one.unsigned != dof]
        if len(others) == len(held):
            kept.append(str(text))
            continue
        is_there = True
        kept += [f"{dof.node} {' '.join(others)}" if len(others) > 1 else f"{dof.node}{others[0]}"] if others else []
    if is_there:
        table["fixed"] = kept
    return is_there


def rename_channels(record: Tables, changes: dict[str, str], sensors: Collection[str], loads: Collection[str]) -> None:
    """Give channels of a record other names in its ``relabel`` table, which may rename them already; changed in place.

    `changes` maps present names, such as ``3X`` or for a load ``load 3X``, to new ones, which are without ``load``; one
    such as ``5X-`` reverses the sign. Of a channel that the table renames already, the entry gets the new name with the
    product of both signs. `sensors` and `loads` are the present names of all channels, such as ``3X``. An entry without
    ``load`` is of a load where no sensor has its new name.

    Raises
    ------
    NoStudyTextError
        If an entry without ``load`` may be of a sensor or of a load, which have one name.
    """
    given = record.setdefault("relabel", {})
    called: dict[tuple[str, str], str] = {}
    for key, name in given.items():
        place = parse_dof(name).place
        sides = ("load",) if " " in key else tuple(side for side, of in (("", sensors), ("load", loads)) if place in of)
        if len(sides) > 1 and any(old.removeprefix("load ") == place for old in changes):
            raise NoStudyTextError(
                f"relabel names {key!r} {name}, which a sensor and a load are called; correct it there"
            )
        called |= {(side, place): key for side in sides}
    for old, new in changes.items():
        *side, place = old.split()
        key = called.get(("load" if side or place not in sensors else "", place))
        if key is None:
            given[old] = new
            continue
        wanted, before = parse_dof(new), parse_dof(given[key])
        given[key] = wanted.place if wanted.sign == before.sign else f"{wanted.place}-"


def is_declaration_of(entry: Tables, name: str, prop: str) -> bool:
    """True if the unknown `entry` declares the property `prop` of the set `name` or of elements of it.

    An unknown ``stiffness`` stands for every property with that word in its name.
    """
    is_property = entry["property"] in (prop, "stiffness") if "stiffness" in prop else entry["property"] == prop
    return is_property and any(text == name or text.rpartition(":")[0] == name for text in as_list(entry["elements"]))


def label_of(entry: Tables) -> str:
    """Name of the parameter that an unknown with a single value declares, such as ``stiffness[spring]``."""
    label = entry.get("name") or ", ".join(str(text) for text in as_list(entry["elements"]))
    return f"{entry['property']}[{label}]"


def take_out_element(entry: Tables, name: str, number: int, count: int, is_factor: bool) -> None:
    """Take element `number` (from 1) of the set `name` out of the unknown `entry`, changed in place.

    The unknown keeps its name, by default that of all its elements before. `count` is the number of elements of the
    set; `is_factor` makes the unknown a factor on nominal values.
    """
    texts = [str(text) for text in as_list(entry["elements"])]
    kept: list[str] = []
    for text in texts:
        own, _, span = text.rpartition(":")
        if text == name:
            kept += _spans(name, [k for k in range(1, count + 1) if k != number])
        elif own == name:
            low, _, high = span.partition("-")
            kept += _spans(name, [k for k in range(int(low), int(high or low) + 1) if k != number])
        else:
            kept.append(text)
    keep_elements(entry, kept, is_factor)


def keep_elements(entry: Tables, kept: list[str], is_factor: bool) -> None:
    """Leave the unknown `entry` only the elements `kept`, in place; without a name it is named after all before.

    `is_factor` makes it a factor on nominal values, unless it says otherwise.
    """
    if entry.get("factor") is None and is_factor:
        entry["factor"] = True
    name = ", ".join(str(text) for text in as_list(entry["elements"]))
    entry["elements"] = kept
    if entry.get("name") is None:
        entry["name"] = name


def _spans(name: str, numbers: list[int]) -> list[str]:
    """Texts ``name:2-4`` or ``name:6`` for elements of the set `name`, one for each run of consecutive `numbers`.

    The numbers must ascend.
    """
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return [f"{name}:{run[0]}" if len(run) == 1 else f"{name}:{run[0]}-{run[-1]}" for run in runs]
