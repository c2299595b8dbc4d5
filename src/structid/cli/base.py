"""What the commands of `structid` share: exit codes, errors as one message, and lists in one text."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer

from structid.errors import NoModesError, StructidError
from structid.study.run.run import SearchFailedError

DONE, NOT_DETERMINED, UNUSABLE_INPUT, INTERRUPTED = 0, 1, 2, 130


@contextmanager
def reported() -> Iterator[None]:
    """Turns what a user can cause into one message on stderr and an exit code."""
    try:
        with _terminable():
            yield
    except KeyboardInterrupt:
        fail("interrupted; nothing was written", INTERRUPTED)
    except (SearchFailedError, NoModesError) as error:
        fail(str(error), NOT_DETERMINED)
    except StructidError as error:
        fail(str(error), UNUSABLE_INPUT)
    except BrokenPipeError:  # the reader of stdout left, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(NOT_DETERMINED) from None
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        fail(f"{place}{error.strerror or error}; check the disk and the permissions", UNUSABLE_INPUT)


@contextmanager
def _terminable() -> Iterator[None]:
    """A request to end, as batch systems send it before they kill, is taken like Ctrl-C."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def fail(message: str, code: int) -> None:
    """Exit with `code`, the message on stderr; what would steer a terminal in it is shown by its number."""
    shown = "".join(letter if letter.isprintable() or letter == "\n" else f"\\x{ord(letter):02x}" for letter in message)
    typer.echo(f"error: {shown}", err=True)
    raise typer.Exit(code) from None


def words(text: str) -> tuple[str, ...]:
    """The parts of `text` between commas."""
    return tuple(word.strip() for word in text.split(",") if word.strip())
