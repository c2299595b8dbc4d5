"""The command `structid init`: a new study from a template and a few numbers."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from structid.cli.base import beside_call, command_line, say
from structid.core.errors import InputError
from structid.study.templates import (
    TEMPLATES,
    Template,
    TemplateQuestion,
    asked_of,
    asked_value,
    template_with,
    write_study,
)


def init(
    template: Annotated[str, typer.Argument(metavar="TEMPLATE", help=f"One of {', '.join(TEMPLATES)}.")],
    study: Annotated[
        Path | None, typer.Argument(metavar="[STUDY.toml]", help="File to write [default: TEMPLATE.toml].")
    ] = None,
    given: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="A number that the template asks for; may be repeated."),
    ] = None,
) -> None:
    """Write a new study from a template: a few numbers make structure and unknowns; the record comes later.

    On a terminal the numbers that are not given are asked for; elsewhere they take their defaults.

    \b
    Examples:
      structid init beam
      structid init bridge crossing.toml --set spans=4 --set length=25
      structid init mesh plate.toml --set path=plate.msh --set length_unit=mm --set held=clamp
      structid init own-matrices model.toml --set mass=M.npz --set stiffness=K.npz
    """
    if template not in TEMPLATES:
        raise InputError(f"there is no template {template!r}; take one of {', '.join(TEMPLATES)}")
    kind = TEMPLATES[template]
    values = _parse_settings(given or [])
    made = template_with(kind, values)  # so that what is wrong shows before anything is asked
    if sys.stdin.isatty():
        made = template_with(kind, values | _ask_values(kind, set(values)))
    path = write_study(made, study or beside_call(f"{template}.toml"))
    say(f"{path} is written.")
    say(f"Look at it: `{command_line('app', path.parent)}`")
    say(f"Before the test: `{command_line('plan', path)}`")
    say(f"After the test: name its file under [record], then `{command_line('check', path)}`")


def _parse_settings(pairs: list[str]) -> dict[str, str]:
    """Values by name from `pairs`, texts ``NAME=VALUE`` of a flag; hyphens in names become underscores.

    Raises `InputError` if a text has no "=".
    """
    values = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not equals:
            raise InputError(f"--set takes NAME=VALUE, as in --set length=2.5, got {pair!r}")
        values[name.strip().replace("-", "_")] = value
    return values


def _ask_values(kind: type[Template], answered: set[str]) -> dict[str, str]:
    """Values by name, as valid text, that the user types for the numbers of a template; the defaults are offered.

    Questions whose names are in `answered` are not asked.
    """
    found = {}
    for one in asked_of(kind):
        if one.name not in answered:
            unit = f", {one.unit}" if one.unit else ""
            found[one.name] = typer.prompt(
                f"{one.name} ({one.words}{unit})", default=str(one.default), value_proc=partial(_check_answer, one)
            )
    return found


def _check_answer(question: TemplateQuestion, text: str) -> str:
    """Answer `text` unchanged if it is valid for the question; `BadParameter` if not, after which typer asks again."""
    try:
        asked_value(question, text)
    except InputError as error:
        raise typer.BadParameter(str(error)) from error
    return text
