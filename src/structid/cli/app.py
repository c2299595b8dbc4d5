"""The command `structid`: its commands, each loaded when it is called."""

from __future__ import annotations

import ast
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import CompletionItem, TyperCommand, TyperGroup

from structid._version import __version__
from structid.cli.base import DONE, EXIT_CODES, command

if TYPE_CHECKING:
    from typer._click import Command, Context, HelpFormatter

#: Commands by the job that they do, in the order of a project. Each is the function of that name in the module of that
#: name in `commands`; its docstring is the help.
JOBS = {
    "Begin": ("init", "app"),
    "Before the test and before the fit": ("plan", "check", "doctor"),
    "From a study to the answer": ("identify", "explain", "correlate", "compare", "motion"),
    "From the answer to its use": ("predict", "sense", "export"),
    "From a record alone": ("modes", "convert"),
    "Also": ("schema", "reproduce"),
}
COMMANDS = tuple(name for names in JOBS.values() for name in names)
_WIDEST = max(map(len, COMMANDS))

_HELP = f"""Mass, damping and stiffness of a structure from vibration measurements, with honest uncertainty.

\b
Examples:
  structid init beam
  structid app
  structid plan frame.toml --sensors 4
  structid check frame.toml
  structid doctor frame.toml
  structid identify frame.toml --out frame_results
  structid explain frame.toml
  structid correlate frame.toml
  structid compare before.toml after.toml --unchanged mass
  structid modes ambient.uff
  structid motion bridge.toml --threads 2
  structid schema study.schema.json
  structid convert measured.uff measured.npz
  structid reproduce --chapter 4

Exit codes: {"; ".join(f"{code} {words}" for code, words in EXIT_CODES.items())}.
"""
_typer = partial(typer.Typer, rich_markup_mode=None, pretty_exceptions_enable=False)


class _OnCall(TyperGroup):
    """Commands that are imported when they are called; the list of them needs none."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = {name: TyperCommand(name) for name in COMMANDS}
        self._loaded: set[str] = set()

    def get_command(self, ctx: Context, cmd_name: str) -> Command | None:
        """Command called `cmd_name`, whose module is imported at its first use; None if there is none of this name.

        `ctx` is not used.
        """
        if cmd_name in self.commands and cmd_name not in self._loaded:
            alone = _typer(add_completion=False)
            alone.command(cmd_name)(command(vars(import_module(_module(cmd_name)))[cmd_name]))
            self.commands[cmd_name] = typer.main.get_command(alone)
            self._loaded.add(cmd_name)
        return self.commands.get(cmd_name)

    def format_commands(self, ctx: Context, formatter: HelpFormatter) -> None:
        for job, names in JOBS.items():
            with formatter.section(job):
                formatter.write_dl([(f"{name:<{_WIDEST}}", _summary(name)) for name in names])

    def shell_complete(self, ctx: Context, incomplete: str) -> list[CompletionItem]:
        """Completions for a shell: command names that begin with `incomplete`, with their summaries.

        No command is imported. Text that begins with "-" is completed as an option.
        """
        if incomplete.startswith("-"):
            return super().shell_complete(ctx, incomplete)
        return [CompletionItem(name, help=_summary(name)) for name in COMMANDS if name.startswith(incomplete)]


def _module(name: str) -> str:
    return f"structid.cli.commands.{name}"


def _summary(name: str) -> str:
    """First line of the docstring of the command `name`, read from its source without importing it."""
    spec = find_spec(_module(name))
    source: str = spec.loader.get_source(spec.name)  # type: ignore[union-attr]
    body = ast.parse(source).body
    function = next(node for node in body if isinstance(node, ast.FunctionDef) and node.name == name)
    return (ast.get_docstring(function) or "").splitlines()[0]


app = _typer(name="structid", cls=_OnCall, no_args_is_help=True)


def main() -> None:
    """Run the command line and exit with its code."""
    app()


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"structid {__version__}")
        raise typer.Exit(DONE)


@app.callback(help=_HELP)
def structid(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """The command itself, before its commands."""
