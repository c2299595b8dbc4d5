"""The command `structid app`: the workbench in the browser."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from structid.core.errors import InputError

_NEEDED = ("starlette", "uvicorn")


def app(
    folder: Annotated[Path, typer.Argument(metavar="[FOLDER]", help="Folder of studies and records.")] = Path(),
    port: Annotated[int, typer.Option("--port", metavar="N", min=0, max=65535, help="0: any that is free.")] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")] = True,
) -> None:
    """Open a folder of studies and records in the browser: structure, records, modes, runs and results.

    Serves on this machine only, with a token in the address, until Ctrl-C; runs go on without it. See docs/workbench.md.

    \b
    Examples:
      structid app
      structid app measurements --port 8765 --no-browser
    """
    missing = [name for name in _NEEDED if find_spec(name) is None]
    if missing:
        raise InputError(f"the workbench needs {' and '.join(missing)}; install them with: pip install 'structid[app]'")
    from structid.workbench.server import serve

    serve(folder, port, browser)
