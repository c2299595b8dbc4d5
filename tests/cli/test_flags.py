"""Flags made from dataclasses of options: every field is one, with its words, and comes back in its place."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from dataclasses import dataclass, fields, is_dataclass
from importlib import import_module

import pytest
import typer
from typer.testing import CliRunner

from structid.cli.app import COMMANDS, JOBS, app
from structid.cli.base import EXIT_CODES, command, flag_spellings, name_flags, reported
from structid.core.errors import InputError, NoModesError, StudyError
from structid.modal.survey.options import ModesOptions
from structid.records import CsvLayout, ReadOptions

RUN = CliRunner()


@dataclass(frozen=True)
class Options:
    """Some options.

    Parameters
    ----------
    size : float
        How large `it` is,
        in m.
    band : (float, float), optional
        From where to where.
    names, marks : tuple of str
        As in a,b.
    """

    size: float = 2.5
    band: tuple[float, float] | None = None
    names: tuple[str, ...] = ()
    marks: str | int = "none"

    def __post_init__(self) -> None:
        if self.size < 0:
            raise InputError("`size` must be at least 0")


def called(*words: str):
    found = []

    def look(place: str, options: Options, loud: bool = False) -> None:
        """Look."""
        if place == "nowhere":
            raise NoModesError("nothing there")
        found.append((place, options, loud))

    alone = typer.Typer()
    alone.command()(command(look))
    done = RUN.invoke(alone, list(words))
    return done, found


def test_flags_arrive_as_the_dataclass():
    done, found = called("here")
    assert (done.exit_code, found) == (0, [("here", Options(), False)])
    _, found = called("here", "--size", "3", "--band", "1", "4.5", "--names", "a,b", "--marks", "7", "--loud")
    assert found == [("here", Options(3.0, (1.0, 4.5), "a,b", "7"), True)]


def test_help_is_what_the_docstring_says():
    text = re.sub(r"[\s│]+", " ", called("--help")[0].output)
    for words in ("How large it is, in m.", "From where to where.", "LOW HIGH", "default: 2.5", "default: none"):
        assert words in text
    assert text.count("As in a,b.") == 2


def test_options_that_cannot_be_used_are_one_message_and_a_code():
    done, _ = called("here", "--size", "-1")
    assert (done.exit_code, done.stderr) == (2, "error: --size must be at least 0\n")
    done, _ = called("nowhere")
    assert (done.exit_code, done.stderr) == (1, "error: nothing there\n")


@pytest.mark.parametrize("name, options", [("convert", ReadOptions), ("modes", ReadOptions), ("modes", ModesOptions)])
def test_every_field_is_a_flag(name, options):
    text = RUN.invoke(app, [name, "--help"]).output
    names = [field.name for field in fields(options) if field.name != "csv"]
    names += [f"csv_{field.name}" for field in fields(CsvLayout)] if options is ReadOptions else []
    for name in names:
        assert f"--{name.replace('_', '-')} " in text


def test_flags_of_a_dataclass_inside_arrive_in_it():
    found = {}

    def here(read: ReadOptions) -> None:
        found["read"] = read

    app = typer.Typer()
    app.command()(command(here))
    assert RUN.invoke(app, ["--csv-skip-rows", "3", "--csv-decimal", "comma", "--columns", "A,2"]).exit_code == 0
    assert found["read"] == ReadOptions(csv=CsvLayout(skip_rows=3, decimal="comma"), columns=("A", "2"))
    assert RUN.invoke(app, []).exit_code == 0
    assert found["read"] == ReadOptions()


def test_the_help_names_every_command_and_exit_code():
    text = " ".join(RUN.invoke(app, ["--help"]).output.split())
    for code, words in EXIT_CODES.items():
        assert f"{code} {words}" in text
    for name in COMMANDS:
        own = " ".join(RUN.invoke(app, [name, "--help"]).output.split("\n\n")[1].split())
        assert f"{name} {own}" in text
    assert "Did you mean 'modes'?" in RUN.invoke(app, ["mods"]).output


def test_every_command_has_a_job_and_the_help_lists_it_there():
    assert sorted(COMMANDS) == sorted(name for names in JOBS.values() for name in names)
    text = RUN.invoke(app, ["--help"]).output
    places = [text.index(f"\n{job}:\n") for job in JOBS]
    assert places == sorted(places)
    at = list(JOBS).index("From a study to the answer")
    assert places[at] < text.index("\n  identify ") < places[at + 1]


def test_a_shell_completes_commands_without_loading_them(monkeypatch):
    for name, value in {"_STRUCTID_COMPLETE": "complete_bash", "COMP_WORDS": "structid co", "COMP_CWORD": "1"}.items():
        monkeypatch.setenv(name, value)
    code = "import sys; sys.argv = ['structid']; from structid.cli.app import main\n"
    code += "try: main()\nfinally: assert 'numpy' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["correlate", "compare", "convert"]


def command_function(name: str):
    return vars(import_module(f"structid.cli.commands.{name}"))[name]


#: Options out of their limits, each with the words that must be in the message: one a kind of check of each dataclass of options.
REFUSED = [
    ("predict x --lines 1", "--lines"),
    ("predict x --kind none", "--kind"),
    ("predict x --band 5 1", "--band"),
    ("predict x --duration -1", "--duration"),
    ("predict x --sampling-rate 0", "--sampling-rate"),
    ("predict x --sine 1,2@3X", "--duration must be given with --sine"),
    ("predict x --sine 1,2@3X --half-sine 1,2@3X", "got --half-sine and --sine"),
    ("sense x y --draws -1", "--draws"),
    ("sense x y --sampling-rate -5", "--sampling-rate"),
    ("export x --modes 0", "--modes"),
    ("export x --error 3", "--error"),
    ("modes x --band 5 1", "--band"),
    ("modes x --remove-tones soon", "--remove-tones"),
    ("modes x --orders few", "--orders"),
    ("modes x --longest-gap 0", "--longest-gap"),
    ("modes x --csv-decimal dot", "--csv-decimal"),
    ("convert x y --resample linear", "--resample"),
    ("correlate x --least-mac -1", "--least-mac"),
    ("compare x y --least 2", "--least"),
]


@pytest.mark.parametrize("words, told", REFUSED, ids=[words for words, _ in REFUSED])
def test_messages_name_the_flag_that_was_typed(words, told):
    done = RUN.invoke(app, words.split())
    assert done.exit_code == 2
    assert told in done.stderr
    assert "`" not in done.stderr


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_of_a_command_has_the_flag_that_its_help_shows(name):
    function = command_function(name)
    kinds = [p.annotation for p in inspect.signature(function, eval_str=True).parameters.values()]
    options = [field.name for kind in kinds if is_dataclass(kind) for field in fields(kind) if field.name != "csv"]
    flags, shown = flag_spellings(function), RUN.invoke(app, [name, "--help"]).output
    assert set(options) <= set(flags)
    for option, flag in flags.items():
        assert re.search(rf"{flag}[ ,]", shown)
        assert name_flags(f"x.csv: `{option}` must be greater than 0", flags) == f"x.csv: {flag} must be greater than 0"
        assert name_flags(f"give `{option} = 3`", flags) == f"give {flag} 3"


@pytest.mark.parametrize("error, words", [(StudyError, "`band` must rise"), (InputError, "--band must rise")])
def test_an_error_on_a_key_of_a_study_keeps_the_name_of_the_key(error, words, capsys):
    with pytest.raises(typer.Exit) as end, reported(lambda message: name_flags(message, {"band": "--band"})):
        raise error("`band` must rise")
    assert end.value.exit_code == 2
    assert capsys.readouterr().err == f"error: {words}\n"


def test_what_is_no_option_keeps_its_marks():
    assert (
        name_flags("give `[record]` or `structid app`", {"record": "--record"}) == "give `[record]` or `structid app`"
    )
    assert name_flags("`span = 3` is a key", {"band": "--band"}) == "`span = 3` is a key"
