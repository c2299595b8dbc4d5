"""The command of a study's solver: what a user confirms of it, and the word before it runs."""

from __future__ import annotations

import hashlib
import json
import os
import shlex
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from structid.core.errors import InputError
from structid.files import digest

#: Environment variable with the confirmation of the one command that may run; where it is set, no other runs.
CONFIRMED = "STRUCTID_CONFIRMED_SOLVER"
#: Who hears of commands, and the confirmations of those that were told.
_teller: ContextVar[tuple[Callable[[str, Path], None] | None, set[str]]] = ContextVar("teller", default=(None, set()))


def command_words(command: str, deck: str, study: Path) -> list[str]:
    """Arguments of `command` with ``{deck}``, ``{stem}`` and ``{study}`` filled in.

    `deck` is the deck's file name, whose stem is ``{stem}``; `study` is the folder of the study.

    Raises
    ------
    InputError
        If quotes are unbalanced, or another name stands in braces.
    """
    values = {"deck": deck, "stem": Path(deck).stem, "study": str(study.resolve())}
    try:
        return [word.format(**values) for word in shlex.split(command)]
    except (ValueError, KeyError, IndexError, AttributeError) as error:
        raise InputError(
            f"`command` {command!r} cannot be read ({error}); it may hold {{deck}}, {{stem}} and {{study}},"
            " and quotes in pairs"
        ) from error


def confirmation_of(command: str, study: Path, inputs: Sequence[Path]) -> str:
    """SHA-256 digest, in hexadecimal, that a user confirms before the command runs.

    It covers the command, the study folder, the contents of `inputs`, and those of files in the folder that the command
    names by their absolute path, as ``{study}`` gives it.

    Parameters
    ----------
    command : str
        Command with ``{deck}``, ``{stem}`` and ``{study}``.
    study : Path
        Folder of the study file.
    inputs : sequence of Path
        The deck, which must come first, further decks and files that a run gets.

    Raises
    ------
    InputError
        If the command cannot be read.
    """
    folder = study.resolve()
    words = [Path(word) for word in command_words(command, inputs[0].name, folder)]
    named = [word for word in words if word.is_absolute() and word.resolve().is_relative_to(folder) and word.is_file()]
    parts = [command, str(folder), *(f"{path.name} {digest(path)}" for path in [*inputs, *named])]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


@contextmanager
def commands_told(tell: Callable[[str, Path], None]) -> Iterator[None]:
    """Context manager that calls `tell(command, study folder)` before a command first runs in the block.

    A command whose files have changed in between is reported again.
    """
    token = _teller.set((tell, set()))
    try:
        yield
    finally:
        _teller.reset(token)


def tell_command(command: str, study: Path, confirmation: str) -> None:
    """Report that `command` is about to run, unless nobody listens (`commands_told`) or it was reported before.

    `study` is the folder of the study, `confirmation` the digest of the command and its files, by which a report is
    known.
    """
    tell, reported = _teller.get()
    if tell is not None and confirmation not in reported:
        reported.add(confirmation)
        tell(command, study)


def require_confirmed(command: str, confirmation: str) -> None:
    """Raise `InputError` if this process is bound to a confirmed command and `confirmation` is not its digest."""
    if os.environ.get(CONFIRMED, confirmation) != confirmation:
        raise InputError(
            f"[structure.solver] runs `{command}`, which was not confirmed as it is now: command, deck or files have"
            " changed since; start the run again in the workbench, which shows what would run"
        )
