"""Templates of a study: a dataclass of the numbers that it asks for, and the study text that it makes of them."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import ClassVar, TypeVar

from structid.core.errors import FileError, InputError
from structid.files import atomic_write, make_folder

T = TypeVar("T")

#: What stands at the end of every new study until a record is there.
NO_RECORD = """
# The record, once it is there (`structid app` writes this section, too):
# [record]
# path = "record.csv"
# outputs = ["2Y", "3Y"]  # nodes and directions of a table of FRFs whose columns have names of their own, in its order
# inputs = ["2Y"]
# averages = 10  # with the coherence in the file they say the noise
"""


class Template(ABC):
    """Template of a study for one kind of structure; a subclass is a frozen dataclass whose fields are its questions."""

    words: ClassVar[str] = ""

    @abstractmethod
    def text(self, folder: Path) -> str:
        """The study file, for `folder`, where the files are that it names."""


def asked(words: str, unit: str, default: T, choices: tuple[str, ...] = ()) -> T:
    """A field of a template: what it is, its unit, the value that stands where none is given, and all that it may be."""
    return field(default=default, metadata={"words": words, "unit": unit, "default": default, "choices": choices})


@dataclass(frozen=True)
class TemplateQuestion:
    """One number or text that a template asks for."""

    name: str
    words: str
    unit: str
    default: float | int | str
    choices: tuple[str, ...]


def asked_of(template: type[Template]) -> tuple[TemplateQuestion, ...]:
    """Questions that `template` asks, one for each of its fields that has a text, in order."""
    found = (one for one in fields(template) if "words" in one.metadata)  # type: ignore[arg-type]
    return tuple(TemplateQuestion(one.name, **one.metadata) for one in found)


def template_with(template: type[Template], answers: Mapping[str, object]) -> Template:
    """A `template` of this class filled with the values in `answers`, text or numbers by name, and defaults for the others.

    Raises
    ------
    InputError
        If a name is unknown, or a value cannot be used, see `asked_value`.
    """
    questions = {question.name: question for question in asked_of(template)}
    values: dict[str, float | int | str] = {}
    for name, value in answers.items():
        if name not in questions:
            listed = ", ".join(
                f"{question.name} ({question.words}, {question.unit or 'no unit'})" for question in questions.values()
            )
            raise InputError(f"there is no {name!r} to give; this template asks for {listed}")
        values[name] = asked_value(questions[name], str(value))
    return template(**values)


def asked_value(question: TemplateQuestion, answer: str) -> float | int | str:
    """The text `answer` as the number or text that a question asks for.

    Raises
    ------
    InputError
        If it is not a number greater than 0, a count outside 1 to 2000, a text with quotes, or none of the choices.
    """
    text = answer.strip()
    if question.choices and text not in question.choices:
        raise InputError(f"{question.name} must be one of {', '.join(question.choices)}, got {text!r}")
    if isinstance(question.default, str):
        if not text or any(not letter.isprintable() or letter in '"\\' for letter in text):
            raise InputError(f"{question.name} must be a text without quotes, as in {question.default}, got {text!r}")
        return text
    try:
        number = float(text)
    except ValueError:
        raise InputError(f"{question.name} must be a number, as in {question.default}, got {text!r}") from None
    if isinstance(question.default, int):
        if number != int(number) or not 1 <= number <= 2000:
            raise InputError(f"{question.name} must be a whole number from 1 to 2000, got {text}")
        return int(number)
    if not 0 < number < float("inf"):
        raise InputError(f"{question.name} must be greater than 0 ({question.unit or 'no unit'}), got {text}")
    return number


def study_file(path: Path) -> Path:
    """`path` with the suffix by which studies are known."""
    return path if path.suffix.lower() == ".toml" else path.with_name(f"{path.name}.toml")


def write_study(template: Template, path: Path) -> Path:
    """Write the study of `template` to a new file, `path` with the suffix ``.toml``, and return the path of the file.

    Raises
    ------
    FileError
        If there is a file of that name already, it cannot be written, or a file that the template reads is damaged.
    """
    path = study_file(path)
    if path.exists():
        raise FileError(f"{path}: is there already; give another name, or remove it first")
    text = template.text(path.parent)
    make_folder(path.parent)
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def node_lines(positions: Mapping[int, Sequence[float]]) -> str:
    """The lines of ``[structure.nodes]``."""
    return "\n".join(f"{label} = [{', '.join(number(x) for x in place)}]" for label, place in positions.items())


def number(value: float) -> str:
    """`value` as TOML has it, to nine digits."""
    text = f"{value:.9g}"
    return text if any(letter in text for letter in ".e") else f"{text}.0"


def unknown(property: str, elements: str, each: bool = False) -> str:
    """An ``[[unknown]]`` table."""
    return f'\n[[unknown]]\nproperty = "{property}"\nelements = {json.dumps(elements, ensure_ascii=False)}\n' + (
        "each = true\n" if each else ""
    )
