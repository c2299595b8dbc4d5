"""The deck that a study took its mesh from, with the identified numbers in it: everything else stays as it was, byte for byte."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from structid.core.display import join_words
from structid.core.dof import is_whole_number
from structid.core.errors import FileError, InputError
from structid.core.units import FORCES, LENGTHS
from structid.external.deck import WIDTH, number_text
from structid.external.marks import Card, CardField, DeckPosition, KeywordEntry, cards_in, keywords_in
from structid.fem import PointMass, Structure
from structid.fem.elements import ELEMENT_TYPES
from structid.fem.meshes import ABAQUS, NASTRAN, Mesh, read_mesh
from structid.files import atomic_write, require_readable
from structid.files.uff.datasets import real_number
from structid.prediction.identified_model import ElementValues
from structid.study.schema.study import Study

DECK_SUFFIXES = (*NASTRAN.SUFFIXES, *ABAQUS.SUFFIXES)
#: Relative difference of numbers that count as one, and of a number in the deck from the one that the study begins at.
_SAME, _DIGITS = 1e-9, 1e-3
#: Fields of MAT1 by property, and entries of the material of Abaqus.
_MAT1 = {"youngs_modulus": 3, "density": 6, "loss_factor": 9}
_MATERIAL = {"youngs_modulus": "*ELASTIC", "density": "*DENSITY"}
#: Cards of properties, and the fields in which they name materials; the first of them is the one of cells that are solid or thin.
_PROPERTY_CARDS = {
    "PSHELL": (3, 5, 7, 12), "PSOLID": (3,), "PCOMP": (13, 17), "PBAR": (3,), "PBARL": (3,), "PBEAM": (3,), "PBEAML": (3,),
    "PROD": (3,), "PTUBE": (3,), "PSHEAR": (3,),
}  # fmt: skip
_SECTIONS = ("SHELL SECTION", "SOLID SECTION", "MEMBRANE SECTION", "BEAM SECTION")
_WTMASS = re.compile(r"^[ \t]*PARAM[ \t]*[, \t][ \t]*WTMASS[ \t]*[, \t][ \t]*([^,\s$]+)", re.IGNORECASE | re.MULTILINE)


@dataclass(frozen=True)
class DeckNumber:
    """A number of a deck that was identified.

    Attributes
    ----------
    mark : CardField or KeywordEntry
    value, initial : float
        Identified, and where the search began, in the units of the deck.
    label : str
        Such as ``youngs_modulus[skin]``.
    """

    mark: CardField | KeywordEntry
    value: float
    initial: float
    label: str


@dataclass(frozen=True, eq=False)
class _DeckModel:
    """A deck, its mesh and the element sets of the study on it.

    Attributes
    ----------
    name, text : str
        Of the deck.
    mesh : Mesh
    group_of : mapping of str to str or None
        The group of the mesh that each element set of cells stands on; None for all cells.
    values : mapping of (str, str) to ElementValues
        By element set and property.
    scales : mapping of str to float
        What an SI value of each property is multiplied by to be in the units of the deck.
    """

    name: str
    text: str
    mesh: Mesh
    group_of: Mapping[str, str | None]
    values: Mapping[tuple[str, str], ElementValues]
    scales: Mapping[str, float]

    def number(self, element: str, name: str, index: int | None = None) -> tuple[float, float]:
        """(identified, initial) value of the property `name` of the element set `element`, in the units of the deck.

        `index` is the row of one element in the set, from 0; None takes the whole set, with `InputError` if its values
        differ.
        """
        item = self.values[element, name]
        rows = slice(None) if index is None else slice(index, index + 1)
        value, initial = item.value[rows], item.initial[rows]
        if np.ptp(value) > _SAME * abs(value[0]):
            raise InputError(
                f"{name} of {element!r} differs from element to element ({value.min():g} to {value.max():g} {item.unit}), and"
                f" {self.name} has one number for all of them; give parts of it properties of their own in the deck, or export"
                " the elements with --mesh"
            )
        scale = self.scales["rotational stiffness" if item.unit == "N m/rad" else name]
        return float(value[0]) * scale, float(initial[0]) * scale


def deck_path(study: Study) -> Path:
    """Path of the deck that a study takes its mesh from.

    Raises
    ------
    InputError
        If the study has no mesh, or one of a format without materials.
    """
    stated = study.root.inner("structure").table.get("mesh")
    path = stated.get("path") if isinstance(stated, dict) else stated
    if path is None:
        raise InputError("the study takes no mesh from a deck of another program (`path` in [structure.mesh])")
    deck = study.path.parent / str(path)
    if deck.suffix.lower() not in DECK_SUFFIXES:
        raise InputError(f"{deck.name} holds a mesh without materials; decks are {' '.join(DECK_SUFFIXES)}")
    return deck


def export_deck(study: Study, values: Sequence[ElementValues], path: Path) -> list[str]:
    """Write the deck of the study's mesh with the identified values in place of its numbers.

    Parameters
    ----------
    study : Study
        Study with a mesh from a deck of Nastran or Abaqus.
    values : sequence of ElementValues
        Properties of the identified model; only those that were parameters are written.
    path : Path
        New file, with the suffix of the deck.

    Returns
    -------
    list of str
        A line on the file, then one on each number that was changed.

    Raises
    ------
    InputError
        If the study has no deck, nothing identified is a number of the deck, or elements of another value share a number.
    FileError
        If the suffix differs from that of the deck, or the deck cannot be read or written.
    """
    original = require_readable(deck_path(study))
    if path.suffix.lower() != original.suffix.lower():
        raise FileError(f"{path}: must end in {original.suffix}, as the deck {original.name} that it is made of")
    source = _read_source(study, original, values)
    is_nastran = original.suffix.lower() in NASTRAN.SUFFIXES
    find_numbers = _nastran_numbers if is_nastran else _abaqus_numbers
    numbers: dict[CardField | KeywordEntry, DeckNumber] = {}
    absent: list[str] = []
    for item in values:
        if not item.is_sought.any():
            continue
        label = f"{item.name}[{item.element}]"
        deck_numbers = list(find_numbers(source, study.structure, item))
        if not deck_numbers:
            absent.append(label)
        for number in deck_numbers:
            earlier = numbers.setdefault(number.mark, number)
            if not math.isclose(earlier.value, number.value, rel_tol=_SAME):
                raise InputError(
                    f"{number.mark.words} in {original.name} belongs to {earlier.label} and {label}, whose identified values differ"
                    f" ({earlier.value:g} and {number.value:g}); give each a material of its own in the deck"
                )
    if not numbers:
        raise InputError(
            f"nothing that was identified ({join_words(absent)}) is a number of {original.name}; take --matrices"
        )
    text, lines = _replace_numbers(source, list(numbers.values()))
    with atomic_write(path) as temporary:
        temporary.write_bytes(text.encode("latin-1"))
    left = f"; not in the deck: {join_words(absent)}" if absent else ""
    return [f"{path}: {original.name} with {len(lines)} numbers changed{left}", *(f"  {line}" for line in lines)]


def _read_source(study: Study, path: Path, values: Sequence[ElementValues]) -> _DeckModel:
    """The deck at `path` as text and mesh, with the mesh group of each element set, `values`, and unit factors.

    Factors are from SI units to those stated for the mesh of the study, by default m and N; PARAM WTMASS of the deck
    scales masses.
    """
    section = study.root.inner("structure")
    stated = section.table["mesh"]
    options = stated if isinstance(stated, dict) else {}
    length_unit, force_unit = str(options.get("length_unit", "m")), str(options.get("force_unit", "N"))
    length, force = LENGTHS[length_unit], FORCES[force_unit]
    text = path.read_bytes().decode("latin-1")
    factors = {real_number(word) for word in _WTMASS.findall(text)} or {1.0}
    mass = length / force / factors.pop()
    scales = {
        "youngs_modulus": length**2 / force, "density": mass * length**3, "thickness": 1 / length, "mass": mass,
        "stiffness": length / force, "loss_factor": 1.0,
        "rotational stiffness": 1 / (length * force),
    }  # fmt: skip
    group_of = {
        str(entry.table["name"]): None if entry.table.get("group") is None else str(entry.table["group"])
        for kind in ELEMENT_TYPES
        for entry in section.sections(kind)
        if not ELEMENT_TYPES[kind].follows and not {"nodes", "first"} & set(entry.table) and "name" in entry.table
    }
    mesh = read_mesh(path, length_unit, force_unit)
    return _DeckModel(path.name, text, mesh, group_of, {(item.element, item.name): item for item in values}, scales)


def _replace_numbers(source: _DeckModel, numbers: Sequence[DeckNumber]) -> tuple[str, list[str]]:
    """The text of the deck after its numbers are replaced, and a sentence on each replacement, in the order of the text.

    New numbers fill the field of the old ones where there is room, aligned as they were.
    """
    placed = [(number.mark.locate({source.name: source.text}), number) for number in numbers]
    text, lines = source.text, []
    for position, number in sorted(placed, key=lambda pair: -pair[0].start):
        width = position.width or WIDTH
        written = number_text(number.value, width)
        before = text[position.start : position.end]
        is_right = before[:1].isspace() and not before[-1:].isspace()
        padded = (
            written.rjust(len(before))
            if is_right
            else written.ljust(len(before))
            if before != before.strip()
            else written
        )
        text = text[: position.start] + padded + text[position.end :]
        lines.append(_change_words(position, number, before.strip(), written))
    return text, lines[::-1]


def _change_words(position: DeckPosition, number: DeckNumber, before: str, after: str) -> str:
    """Sentence on the change of one number of the deck; it also says if the study began at another value than the deck's.

    `before` and `after` are the number as text in the old and the new deck.
    """
    words = f"line {position.line}, {number.mark.words}, {number.label}: {before} becomes {after}"
    if not math.isclose(position.value, number.initial, rel_tol=_DIGITS):
        words += f" (the study began at {number.initial:g}, not at the number of the deck)"
    return words


def _nastran_numbers(source: _DeckModel, structure: Structure, element_property: ElementValues) -> Iterator[DeckNumber]:
    """New numbers for the cards of a Nastran deck that hold a property of an element set; none if no card does.

    `element_property` has the name of the set and of the property, and the identified values, one an element. Cards are
    PSHELL, MAT1, PELAS and CONM2. `InputError` if values differ within a set that has one number, a node has no or
    several cards CONM2, or a material cannot be written.
    """
    label = f"{element_property.name}[{element_property.element}]"
    if element_property.element in source.group_of:
        numbers = _property_numbers(source, element_property.element)
        if element_property.name == "thickness":
            yield from (
                DeckNumber(
                    CardField("PSHELL", 4, n), *source.number(element_property.element, element_property.name), label
                )
                for n in numbers
            )
        elif element_property.name in _MAT1:
            yield from _mat1_numbers(source, element_property, numbers)
        return
    element = next((one for one in structure.elements if one.name == element_property.element), None)
    pelas = re.fullmatch(r"celas1 (\d+)", element_property.element)
    if pelas and element_property.name == "stiffness":
        yield DeckNumber(
            CardField("PELAS", 3, int(pelas[1])), *source.number(element_property.element, element_property.name), label
        )
    elif element_property.element == "conm2" and element_property.name == "mass" and isinstance(element, PointMass):
        for index, node in enumerate(element.nodes[:, 0].tolist()):
            cards = [card for card in cards_in(source.name, source.text, "CONM2") if _field(card, 3) == str(node)]
            if len(cards) != 1:
                raise InputError(
                    f"{source.name}: node {node} has {len(cards)} cards CONM2; make it one, so that its mass is told"
                )
            if element_property.is_sought[index]:
                mark = CardField("CONM2", 5, int(cards[0].first))
                yield DeckNumber(
                    mark,
                    *source.number(element_property.element, element_property.name, index),
                    f"mass[conm2:{index + 1}]",
                )


def _field(card: Card, number: int) -> str:
    return card.fields[number].text if number in card.fields else ""


def _property_numbers(source: _DeckModel, element: str) -> list[int]:
    """Property identification numbers (PID) of the cells of an element set of a Nastran deck.

    They are all of the deck, increasing, for a set on the whole mesh; else at most one. It is empty for a group that is
    no property.
    """
    group = source.group_of[element]
    by_number = {key: rows for key, rows in source.mesh.groups.items() if is_whole_number(key)}
    if group is None:
        return sorted(int(key) for key in by_number)
    rows = source.mesh.groups[group]
    return [int(key) for key, others in by_number.items() if key == group or others is rows][:1]


def _mat1_numbers(source: _DeckModel, element_property: ElementValues, numbers: Sequence[int]) -> Iterator[DeckNumber]:
    """New numbers for the MAT1 cards that the properties `numbers` (PIDs) of an element set refer to.

    A shear modulus on the card is scaled with Young's modulus. `InputError` if a material also belongs to elements with another
    value, or a property names no material.
    """
    users: dict[int, set[int]] = {}
    for name, fields in _PROPERTY_CARDS.items():
        for card in cards_in(source.name, source.text, name):
            for field in fields:
                if is_whole_number(_field(card, field)) and is_whole_number(card.first):
                    users.setdefault(int(_field(card, field)), set()).add(int(card.first))
    materials = sorted(material for material, of in users.items() if of & set(numbers))
    without = set(numbers) - {number for of in users.values() for number in of}
    if without:
        raise InputError(
            f"{source.name}: property {min(without)} of {element_property.element!r} names no material on a PSHELL, PSOLID or line"
        )
    owner_of = {number: element for element in source.group_of for number in _property_numbers(source, element)}
    value, initial = source.number(element_property.element, element_property.name)
    label = f"{element_property.name}[{element_property.element}]"
    for material in materials:
        for other in sorted(users[material] - set(numbers)):
            _require_same(
                source,
                f"MAT1 {material}",
                element_property,
                owner_of.get(other),
                value,
                str(other) in source.mesh.groups,
            )
        yield DeckNumber(CardField("MAT1", _MAT1[element_property.name], material), value, initial, label)
        material_card = next((c for c in cards_in(source.name, source.text, "MAT1") if c.first == str(material)), None)
        if element_property.name == "youngs_modulus" and material_card is not None and _field(material_card, 4):
            modulus, shear = (
                CardField("MAT1", field, material).locate({source.name: source.text}).value for field in (3, 4)
            )
            yield DeckNumber(
                CardField("MAT1", 4, material), shear * value / modulus, shear, f"shear modulus with {label}"
            )


def _require_same(
    source: _DeckModel, where: str, element_property: ElementValues, other_set: str | None, value: float, is_used: bool
) -> None:
    """Raise `InputError` where elements share a number of the deck though different values were identified for them.

    Parameters
    ----------
    source : _DeckModel
        The deck.
    where : str
        Name of the material or property in the deck.
    element_property : ElementValues
        Property of the element set that is written.
    other_set : str or None
        Another element set that has the same number; None if no set of the study has it.
    value : float
        New value, in the units of the deck.
    is_used : bool
        True if elements outside the study may have the same number.
    """
    if other_set is not None and (other_set, element_property.name) in source.values:
        other_value = source.number(other_set, element_property.name)[0]
        if math.isclose(other_value, value, rel_tol=_SAME):
            return
        sharing = f"of {other_set!r}, whose {element_property.name} is {other_value:g} and not {value:g}"
    elif is_used:
        sharing = "of elements that the study does not have"
    else:
        return
    raise InputError(
        f"{where} in {source.name} is the material of {element_property.element!r} and {sharing}; give each a material of its own"
    )


def _abaqus_numbers(source: _DeckModel, structure: Structure, element_property: ElementValues) -> Iterator[DeckNumber]:
    """New numbers for the keyword lines of an Abaqus deck that hold a property of an element set.

    `element_property` has the name of the set and of the property, and the identified values, one an element. Nothing is
    yielded if no line holds it. `InputError` if the set has no section, its values differ, elements with another value share the
    material, or the material has more than one number.
    """
    label = f"{element_property.name}[{element_property.element}]"
    kind, _, name = element_property.element.partition(" ")
    simple = {("mass", "mass"): ("*MASS", 1), ("spring", "stiffness"): ("*SPRING", 2)}
    if element_property.element not in source.group_of:
        if (kind, element_property.name) in simple and name:
            keyword, line = simple[kind, element_property.name]
            yield DeckNumber(
                KeywordEntry(f"{keyword}, ELSET={name}", 1, line),
                *source.number(element_property.element, element_property.name),
                label,
            )
        return
    sections = [block for block in keywords_in(source.name, source.text) if block.name in _SECTIONS]
    group = source.group_of[element_property.element]
    sections_of_group = [
        block for block in sections if group is None or block.options.get("ELSET", "").upper() == _bare(group)
    ]
    if not sections_of_group:
        raise InputError(
            f"{source.name}: no section has ELSET={group}, the group of {element_property.element!r}; give it a section of its own"
        )
    if element_property.name not in (*_MATERIAL, "thickness"):
        return
    value, initial = source.number(element_property.element, element_property.name)
    for block in sections_of_group:
        elset, material = block.options.get("ELSET", ""), block.options.get("MATERIAL", "")
        if element_property.name == "thickness" and block.name != "SOLID SECTION":
            yield DeckNumber(KeywordEntry(f"*{block.name}, ELSET={elset}", 1), value, initial, label)
        elif element_property.name in _MATERIAL:
            for other in sections:
                if other.options.get("MATERIAL", "").upper() == material.upper() and other not in sections_of_group:
                    theirs = other.options.get("ELSET", "").upper()
                    owner = next((e for e, g in source.group_of.items() if g and _bare(str(g)) == theirs), None)
                    _require_same(source, f"*MATERIAL {material}", element_property, owner, value, True)
            mark = KeywordEntry(_MATERIAL[element_property.name], 1, of=f"*MATERIAL, NAME={material}")
            _require_single(source, mark, material)
            yield DeckNumber(mark, value, initial, label)


def _bare(group: str) -> str:
    """Name of an element set without that of its instance, in capitals."""
    return group.rpartition(".")[2].upper()


def _require_single(source: _DeckModel, mark: KeywordEntry, material: str) -> None:
    """Raise `InputError` unless the Abaqus keyword at `mark` gives one number: isotropic, and at one temperature.

    `source` has the text of the deck; `material` is the material's name, for the message.
    """
    position = mark.locate({source.name: source.text})
    block = next(
        block for block in keywords_in(source.name, source.text)
        if block.data and block.line <= position.line <= block.data[-1][0]
    )  # fmt: skip
    if len(block.data) > 1 or block.options.get("TYPE", "ISOTROPIC").upper() not in ("ISO", "ISOTROPIC"):
        raise InputError(
            f"{source.name}, line {block.line}: {mark.keyword} of {material} has more than one number (temperatures, directions);"
            " structid identifies one"
        )
