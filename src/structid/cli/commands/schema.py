"""The command `structid schema`: the JSON Schema of study files, for editors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from structid.cli.base import say
from structid.core.errors import FileError

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

    content = study_schema()
    text = json.dumps(content, indent=2, ensure_ascii=False) + "\n"
    if target is None:
        typer.echo(text, nl=False)
        return
    if target.is_file() and not _is_schema(target, content["title"]):
        raise FileError(
            f"{target}: is there already and is no schema of studies; give another name, as in study.schema.json"
        )
    with atomic_write(target) as temporary:
        temporary.write_text(text, encoding="utf-8")
    say(target)


def _is_schema(path: Path, title: object) -> bool:
    """True if the file at `path` is a JSON object with this title."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        return False
    return isinstance(content, dict) and content.get("title") == title
