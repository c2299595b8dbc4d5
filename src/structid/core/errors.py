"""Exceptions of structid: every error that a user can cause names the place and the remedy."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class StructidError(Exception):
    """Base of every error that structid raises on purpose."""


class InputError(StructidError, ValueError):
    """Something given by the user cannot be used as it is; the message says where and what to do.

    `option` is the option that is wrong, where it is known: a study then names the line of that key.
    """

    def __init__(self, message: str = "", option: str = "") -> None:
        super().__init__(message)
        self.option = option


class MissingNameError(InputError, KeyError):
    """A name that is asked for does not exist; the message has the nearest names, then the first that do exist."""

    __str__ = InputError.__str__  # a KeyError shows its message in quotes


class FileError(InputError):
    """A file cannot be read or written as asked; the message begins with its path."""


class StudyError(InputError):
    """Something in a study file cannot be used; the message begins with file, line, section and key."""


class StoredSpectraError(FileError):
    """A file holds spectra or correlation functions of motion, which are no record of frequency responses or histories.

    `kind` is ``spectrum`` or ``correlation``: see `read_spectrum`, `read_correlation`.
    """

    def __init__(self, message: str, kind: str) -> None:
        super().__init__(message)
        self.kind = kind


class NoLinesError(InputError):
    """The band, or what is left out of it, leaves no line of a record; `option` is which, where it is known."""


class UnnamedChannelsError(InputError):
    """A bare array of time histories does not say where its channels were measured; `count` is how many it has."""

    def __init__(self, message: str, count: int) -> None:
        super().__init__(message)
        self.count = count


def require_class(argument: str, value: object, kind: type | tuple[type, ...], remedy: str) -> None:
    """Raise `InputError` unless the argument's `value` is of class `kind`, or of one of several.

    `remedy` ends the message.
    """
    if isinstance(value, kind):
        return
    names = " or ".join(each.__name__ for each in (kind if isinstance(kind, tuple) else (kind,)))
    raise InputError(f"`{argument}` must be of class {names}, got {type(value).__name__}; {remedy}")


@contextmanager
def about(option: str) -> Iterator[None]:
    """Context manager that gives an `InputError` raised in its block the `option` at fault, unless it names one."""
    try:
        yield
    except InputError as error:
        error.option = error.option or option
        raise


@contextmanager
def naming(argument: str) -> Iterator[None]:
    """Context manager that puts the name of an `argument` before the message of an `InputError` raised in its block.

    The new `InputError` names `argument` as the option at fault too, unless the first named one. "" leaves errors as
    they are.
    """
    try:
        yield
    except InputError as error:
        if not argument:
            raise
        raise InputError(f"`{argument}`: {error}", error.option or argument) from error


class NoAnswerError(StructidError):
    """All that was given can be used, and the search ends without an answer: exit code 1 of the command line."""


class NoModesError(NoAnswerError, InputError):
    """The record was read and searched, and shows no mode that can be relied on."""


class SingularModelError(StructidError, ArithmeticError):
    """The model's matrices cannot be factorized where they must be (supports or mass are missing)."""
