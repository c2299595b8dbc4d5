"""Parts that the commands of `structid` share: exit codes, errors as one message, results folders, and flags from options.

A parameter of a command that is a dataclass of options becomes one flag for each of its fields. A flag is named after its field,
and its help is what the docstring of the dataclass says of it. Fields that hold lists are given as one text, which the dataclass
takes apart.
"""

from __future__ import annotations

import inspect
import os
import re
import shlex
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import MISSING, Field, fields, is_dataclass
from pathlib import Path
from typing import Annotated, TypeVar, get_type_hints

import typer
from typer.models import OptionInfo

from structid.core.errors import NoAnswerError, StructidError, StudyError

DONE, NOT_DETERMINED, UNUSABLE_INPUT, WRONG_MODEL, INTERRUPTED = 0, 1, 2, 3, 130
#: What each exit code means, in the words of the help.
EXIT_CODES = {
    DONE: "done",
    NOT_DETERMINED: "the search failed or the data do not determine the answer (the reason is on stderr; results are"
    " written where there are any)",
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


T = TypeVar("T")
_AS_THEY_ARE = (bool, int, float, str, int | None, float | None, str | None, Path | None)
_PAIR = tuple[float, float] | None
#: Flags of options whose text is the path of a file.
_FILES = ("deck", "dofs", "write_dofs")
#: Flags by another name than that of their field.
_NAMES = {
    "quantities": ("--quantity", "--quantities"),
    **{f"n_{name}": (f"--{name}",) for name in ("sensors", "loads", "frequencies")},
}


#: An option in a message, alone or with a value.
_OPTION = re.compile(r"`(?P<name>\w+)(?: = (?P<value>[^`]+))?`")


def command(function: Callable[..., None]) -> Callable[..., None]:
    """The function for typer made of `function`, whose dataclasses of options become one flag for each field.

    An error of the user's input ends it with one message on stderr and an exit code.
    """
    signature = inspect.signature(function, eval_str=True)
    options: dict[str, type] = {
        p.name: p.annotation
        for p in signature.parameters.values()
        if isinstance(p.annotation, type) and is_dataclass(p.annotation)
    }
    groups = {name: list(_flags(kind)) for name, kind in options.items()}

    def run(**given: object) -> None:
        """Call `function` with its dataclasses of options made from the flags in `given`, values by name.

        Paths become absolute. Errors are printed, with names of flags, and end the process with an exit code.
        """
        from structid.core.isolation import absolute_paths, isolated  # the help needs none of it
        from structid.external.confirmation import commands_told
        from structid.records.formats.options import options_given_as_flags

        reads_records = any("csv_skip_rows" in {flag.name for flag in flags} for flags in groups.values())
        with (
            reported(lambda message: name_flags(message, flag_spellings(function))),
            isolated(),
            commands_told(_tell_command),
            options_given_as_flags() if reads_records else nullcontext(),
        ):
            given = {name: absolute_paths(value) for name, value in given.items()}
            for name, flags in groups.items():
                values = {flag.name: given.pop(flag.name) for flag in flags}
                chosen = {flag.name: values[flag.name] for flag in flags if values[flag.name] != flag.default}
                chosen |= {flag: str(absolute_paths(Path(str(chosen[flag])))) for flag in _FILES if chosen.get(flag)}
                given[name] = _make_options(options[name], chosen)
            function(**given)

    parameters = [flag for p in signature.parameters.values() for flag in groups.get(p.name, [p])]
    keyword_only = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in parameters]
    run.__name__, run.__doc__ = function.__name__, function.__doc__
    run.__annotations__ = {p.name: p.annotation for p in parameters}
    vars(run)["__signature__"] = signature.replace(parameters=keyword_only)
    return run


def flag_spellings(function: Callable[..., None]) -> dict[str, str]:
    """Flag of each option of the command `function`, such as ``--sampling-rate``, by the option's name in Python.

    Fields of its dataclasses of options are included; of several names of an option the first one counts.
    """
    spellings: dict[str, str] = {}
    for parameter in inspect.signature(function, eval_str=True).parameters.values():
        kind = parameter.annotation
        if isinstance(kind, type) and is_dataclass(kind):
            for _, field, _, name in _option_fields(kind):
                spellings[field.name] = _flag_names(name)[0]
        for option in getattr(kind, "__metadata__", ()):
            if isinstance(option, OptionInfo):
                # typer keeps the first name of an annotated option as its default
                names = [*map(str, (option.default, *(option.param_decls or ()))), *_flag_names(parameter.name)]
                spellings[parameter.name] = next(name for name in names if name.startswith("--")).split("/")[0]
    return spellings


def name_flags(message: str, flags: Mapping[str, str]) -> str:
    """`message` with options named by the flags that a user types.

    Examples
    --------
    >>> name_flags("`sampling_rate` must be above 0", {"sampling_rate": "--sampling-rate"})
    '--sampling-rate must be above 0'
    """
    return _OPTION.sub(lambda text: flags.get(text["name"], text[0]) + _flag_value(text, flags), message)


def _flag_value(text: re.Match[str], flags: Mapping[str, str]) -> str:
    """Value in the matched text, with a space before it, to follow the flag; "" if there is none or the option has no flag."""
    return f" {text['value']}" if text["value"] and text["name"] in flags else ""


def _tell_command(command: str, study: Path) -> None:
    say(f"runs the command of the study in {study}: {command}", err=True, is_exact=True)


def _inner(kind: object) -> type | None:
    """Dataclass that a field of the type `kind` holds, also as one of several types; None if it holds none."""
    from structid.core.constraints import alternatives  # not needed until a command is loaded

    return next((part for part in alternatives(kind) if isinstance(part, type) and is_dataclass(part)), None)


def _make_options(options: type[T], values: Mapping[str, object]) -> T:
    """Instance of the dataclass `options` from flag values by name; missing fields keep their defaults.

    A field that is a dataclass is made from the values whose names begin with ``<field>_``; without any it keeps its
    default.
    """
    kinds, remaining = get_type_hints(options), dict(values)
    for field in inspect.signature(options).parameters:
        inner, prefix = _inner(kinds[field]), f"{field}_"
        if inner is not None:
            of_inner = [name for name in remaining if name.startswith(prefix)]
            parts = {name.removeprefix(prefix): remaining.pop(name) for name in of_inner}
            remaining |= {field: _make_options(inner, parts)} if parts else {}
    return options(**remaining)


def _option_fields(options: type, prefix: str = "") -> Iterator[tuple[type, Field[object], object, str]]:
    """Yield dataclass, field, type and option name of each field of a dataclass of options.

    The fields of a dataclass inside it stand in its place; `prefix` is the beginning of their option names.
    """
    kinds = get_type_hints(options)
    for field in fields(options):
        inner = _inner(kinds[field.name])
        if inner is None:
            yield options, field, kinds[field.name], prefix + field.name
        else:
            yield from _option_fields(inner, f"{prefix}{field.name}_")


def _flags(options: type) -> Iterator[inspect.Parameter]:
    """Yield the parameters of a command line function, one for each field of a dataclass of options.

    Numbers, texts, paths and pairs of numbers keep their types; anything else, such as a list, becomes text, "" by
    default. The help is the field's description.
    """
    from structid.core.constraints import parameter_descriptions

    descriptions: dict[type, dict[str, str]] = {}
    for owner, field, kind, name in _option_fields(options):
        if owner not in descriptions:
            descriptions[owner] = parameter_descriptions(owner)
        default = None if field.default is MISSING else field.default
        if kind not in (*_AS_THEY_ARE, _PAIR):
            kind, default = str, str(default) if default else ""
        words = descriptions[owner][field.name].replace("`", "")
        option = typer.Option(*_flag_names(name), help=words, metavar="LOW HIGH" if kind == _PAIR else None)
        yield inspect.Parameter(
            name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, option]
        )


def _flag_names(name: str) -> tuple[str, ...]:
    """Flags of the option `name`, the preferred flag first; `name` includes those of the dataclasses around it."""
    return _NAMES.get(name, (f"--{name.replace('_', '-')}",))
