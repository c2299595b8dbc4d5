"""The command `structid schema`: the JSON Schema of study files, for editors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from structid.cli.base import say

Target = Annotated[
    Path | None,
    typer.Argument(metavar="[FILE.json]", help="Write it there, instead of showing it.", show_default=False),
]


def schema(target: Target = None) -> None:
    """Write the JSON Schema of study files, by which editors complete keys and mark what is wrong.

    Name it in the first line of a study: #:schema study.schema.json

    \b
    Examples:
      structid schema study.schema.json
      structid schema | less
    """
    from structid.files import atomic_write  # the help needs none of these
    from structid.study.json_schema import study_schema

    text = json.dumps(study_schema(), indent=2, ensure_ascii=False) + "\n"
    if target is None:
        typer.echo(text, nl=False)
        return
    with atomic_write(target) as temporary:
        temporary.write_text(text, encoding="utf-8")
    say(target)
