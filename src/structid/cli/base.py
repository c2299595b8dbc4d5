"""Parts that the commands of `structid` share: exit codes, errors as one message, arguments, results folders."""

from __future__ import annotations

import os
import shlex
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from typer.models import OptionInfo

from structid.core.errors import NoAnswerError, StructidError, StudyError

DONE, NOT_DETERMINED, UNUSABLE_INPUT, WRONG_MODEL, INTERRUPTED = 0, 1, 2, 3, 130
#: What each exit code means, in the words of the help.
EXIT_CODES = {
    DONE: "done",
    NOT_DETERMINED: "the search failed or the data do not determine the answer (results are written, the reason is on"
    " stderr)",
    UNUSABLE_INPUT: "the input cannot be used or the disk is full",
    WRONG_MODEL: "the model does not explain the record (results are written and marked)",
    INTERRUPTED: "interrupted",
}

#: A run writes at most one file of its checkpoint in this time, s: a killed run may have to do so much again.
CHECKPOINT_SECONDS = 5.0

StudyPath = Annotated[Path, typer.Argument(metavar="STUDY.toml", help="Study file; see docs/study-file.md.")]
Workers = Annotated[int | None, typer.Option("--workers", metavar="N", help="Work on N processes [default: 1].")]
Scheduler = Annotated[
    str | None, typer.Option("--scheduler", metavar="ADDRESS", help="Work on this Dask cluster, as in tcp://host:8786.")
]
Report = Annotated[bool, typer.Option("--report/--no-report", help="Write the results as a page.")]
Png = Annotated[bool, typer.Option("--png", help="Write the figures of the page as PNG files too.")]


def results_folder(default: str) -> OptionInfo:
    """Declaration of the option ``--out``, whose help names the folder `default`; the path must not be a file."""
    option: OptionInfo = typer.Option(
        "--out", metavar="FOLDER", help=f"Results folder [default: {default}].", callback=_no_file
    )
    return option


def _no_file(folder: Path | None) -> Path | None:
    """Path `folder` unchanged, None included; the command ends with exit code 2 if it is a file."""
    if folder is not None:
        from structid.files import require_no_file  # the help needs none of it

        with reported():
            require_no_file(folder)
    return folder


@contextmanager
def reported(reword: Callable[[str], str] = str) -> Iterator[None]:
    """Context manager that turns errors into one message on stderr and an exit code.

    Exit codes: 1 for no answer or a reader of stdout that left, 2 for unusable input or a system error, 130 for an
    interruption. `reword` changes the message, except that of an error in a study file.
    """
    try:
        with _terminable():
            yield
    except KeyboardInterrupt:
        fail("interrupted; nothing was written", INTERRUPTED)
    except StudyError as error:
        fail(str(error), UNUSABLE_INPUT)
    except NoAnswerError as error:
        fail(reword(str(error)), NOT_DETERMINED)
    except StructidError as error:
        fail(reword(str(error)), UNUSABLE_INPUT)
    except BrokenPipeError:  # the reader of stdout left, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(NOT_DETERMINED) from None
    except OSError as error:
        prefix = f"{error.filename}: " if error.filename else ""
        fail(f"{prefix}{error.strerror or error}; check the disk and the permissions", UNUSABLE_INPUT)


@contextmanager
def _terminable() -> Iterator[None]:
    """Context manager in which SIGTERM raises `KeyboardInterrupt`, as Ctrl-C does.

    Without effect outside the main thread.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def fail(message: str, code: int) -> None:
    """Print an error message on stderr and exit with `code`; control characters in it are shown as numbers."""
    say(f"error: {message}", err=True)
    raise typer.Exit(code) from None


def say(text: object, err: bool = False, is_exact: bool = False) -> None:
    """Print `text` as a line on stdout, or on stderr if `err`.

    Characters that cannot be printed, except line ends, are shown by their hexadecimal codes. Paths are shortened
    to how the user typed them, unless `is_exact`.
    """
    from structid.core.isolation import paths_as_called  # the help needs none of it

    shown = str(text) if is_exact else paths_as_called(str(text))
    escaped = "".join(letter if letter.isprintable() or letter == "\n" else f"\\x{ord(letter):02x}" for letter in shown)
    typer.echo(escaped, err=err)


def command_line(*words: object) -> str:
    """The call of `structid` with `words` as it is typed in a shell, quoted where a word has blanks."""
    return shlex.join(["structid", *map(str, words)])


def beside_call(name: str) -> Path:
    """The path of `name` in the folder in which the command was called."""
    from structid.core.isolation import calling_folder

    return calling_folder() / name


def check_png(report: bool, png: bool) -> None:
    """Exit with an error if figures of the page are wanted (`png`) but not the page (`report`)."""
    if png and not report:
        fail("--png writes the figures of the page; leave out --no-report", UNUSABLE_INPUT)
