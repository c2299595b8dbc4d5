"""The command `structid`: parses, calls, prints, exits."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, cast

import typer

from structid._version import __version__
from structid.cli.base import DONE, NOT_DETERMINED, fail, reported, words
from structid.cli.console import (
    check_summary,
    record_summary,
    reproduction_summary,
    standard_output,
)
from structid.cli.doctor import doctor
from structid.cli.identify import StudyPath, identify
from structid.cli.modes import modes
from structid.cli.motion import motion
from structid.cli.progress import item_progress, run_progress
from structid.comparison.comparing import COMPARE_PAGE, CompareOptions, ComparisonResult, comparison_summary
from structid.comparison.comparing import compare as compared
from structid.errors import FileError
from structid.estimation import Status
from structid.estimation.comparison.multiple_tests import Correction
from structid.files import claimed
from structid.planning.planned import Plan
from structid.records.io import ReadOptions, read_record, write_record
from structid.study.results.folder import json_text, staged_folder
from structid.study.results.plan import PLAN_PAGE, write_plan
from structid.study.run.check import check_study
from structid.study.run.plan import planned
from structid.study.run.run import load_study
from structid.study.schema.plan import PlanStudy, load_plan

app = typer.Typer(
    name="structid", add_completion=False, no_args_is_help=True, rich_markup_mode=None, pretty_exceptions_enable=False
)


def main() -> None:
    """Run the command line and exit with its code."""
    app()


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"structid {__version__}")
        raise typer.Exit(DONE)


@app.callback()
def structid(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Mass, damping and stiffness of a structure from vibration measurements, with honest uncertainty.

    \b
    Examples:
      structid plan frame.toml --sensors 4
      structid check frame.toml
      structid doctor frame.toml
      structid identify frame.toml --out frame_results
      structid compare before.toml after.toml --unchanged mass
      structid modes ambient.uff
      structid motion bridge.toml --threads 2
      structid convert measured.uff measured.npz
      structid reproduce --chapter 4

    Exit codes: 0 done; 1 the search failed or the data do not determine the answer (results are written, the reason
    is on stderr); 2 the input cannot be used or the disk is full; 130 interrupted.
    """


app.command()(identify)


@app.command()
def check(study: StudyPath) -> None:
    """Read all of a study and say what it can determine: units, sensors, coverage, rank, predicted accuracy.

    Nothing is estimated or written. The exit code is 1 where the data do not determine every parameter.

    \b
    Examples:
      structid check frame.toml
    """
    with reported():
        result = check_study(load_study(study))
        for part in check_summary(result):
            standard_output().print(part)
        if not result.determined:
            fail(f"{Status.NOT_IDENTIFIABLE.words} (predicted at the initial values)", NOT_DETERMINED)


@app.command()
def plan(
    study: StudyPath,
    sensors: Annotated[int | None, typer.Option(help="How many sensors to choose.")] = None,
    loads: Annotated[int | None, typer.Option(help="How many loads to choose.")] = None,
    frequencies: Annotated[int | None, typer.Option(help="How many lines to choose [default: all are used].")] = None,
    criterion: Annotated[str | None, typer.Option(help="d (determinant) or a (trace) [default: d].")] = None,
    target: Annotated[float | None, typer.Option(help="Wanted relative standard deviation, as in 0.02.")] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FOLDER", help="Results folder [default: <study name>_plan].")
    ] = None,
    report: Annotated[bool, typer.Option("--report/--no-report", help="Write plan.html and figures.")] = True,
) -> None:
    """Predict what a test will tell before it is run, and choose its sensors, loads and lines; write plan.json.

    Options left out come from [plan] in the study, or from its record; neither is needed. The exit code is 1 where
    even all candidates together do not determine every parameter.

    \b
    Examples:
      structid plan frame.toml --sensors 4
      structid plan frame.toml --sensors 4 --loads 1 --frequencies 24 --target 0.02 --out frame_plan
    """
    with reported():
        given = {"n_sensors": sensors, "n_loads": loads, "n_frequencies": frequencies, "criterion": criterion}
        changes = {name: value for name, value in {**given, "target": target}.items() if value is not None}
        read = load_plan(study, **changes)
        found = planned(read)
        folder = out if out is not None else Path(f"{study.stem}_plan")
        with staged_folder(folder, PLAN_PAGE) as staged:
            name = _write_plan(found, read, staged, report)
        from structid.report.planning.text import plan_text  # imported here, so that nothing else waits for it

        for part in plan_text(found, read.title, read.notes):
            standard_output().print(part)
        typer.echo(str(folder / name))
        if not found.determined:
            fail(f"even all candidates together do not determine {', '.join(found.undetermined[:6])}", NOT_DETERMINED)


def _write_plan(found: Plan, read: PlanStudy, folder: Path, report: bool) -> str:
    """The name of the page in `folder`, or of plan.json; drawing is imported here, so that nothing else waits for it."""
    write_plan(found, read, folder)
    if not report:
        return "plan.json"
    from structid.report.planning.page import write_plan_page

    return write_plan_page(found, folder, read.title, read.notes).name


@app.command()
def compare(
    baseline: Annotated[Path, typer.Argument(metavar="BASELINE", help="Study file, or results folder of identify.")],
    later: Annotated[Path, typer.Argument(metavar="LATER", help="The same of the later state.")],
    unchanged: Annotated[
        str, typer.Option(help="What is the same in both states, as in mass or 'mass[beam:*],loss_factor'.")
    ] = "",
    level: Annotated[float, typer.Option(help="Accepted rate of false declarations.")] = 0.05,
    power: Annotated[float, typer.Option(help="Probability that belongs to the detection limit.")] = 0.9,
    correction: Annotated[str, typer.Option(help="holm (family-wise) or benjamini_hochberg.")] = "holm",
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FOLDER", help="Results folder [default: <later>_comparison].")
    ] = None,
    report: Annotated[bool, typer.Option("--report/--no-report", help="Write compare.html and figures.")] = True,
) -> None:
    """Say what changed between two states of a structure, where, and what could not have been seen; write compare.json.

    Every change is tested, corrected for their number. Exit code 1: a state is not determined (results are written).

    \b
    Examples:
      structid compare before.toml after.toml --unchanged mass
      structid compare before_results after_results --level 0.01
      structid compare before_results after.toml --unchanged mass --out damage
    """
    with reported():
        from structid.report.comparison.text import comparison_text  # imported here, so that nothing else waits for it

        options = CompareOptions(words(unchanged), level, power, cast(Correction, correction))
        with run_progress(100) as progress:
            found = compared(baseline, later, options, progress.search)
        folder = out if out is not None else Path(f"{later.stem if later.is_file() else later.name}_comparison")
        with staged_folder(folder, COMPARE_PAGE) as staged:
            name = _write_comparison(found, staged, report)
        for part in comparison_text(found):
            standard_output().print(part)
        typer.echo(str(folder / name))
        if not found.comparison.is_complete:
            fail("the data do not determine every change; see the warnings", NOT_DETERMINED)


def _write_comparison(found: ComparisonResult, folder: Path, report: bool) -> str:
    """The name of the page in `folder`, or of compare.json; drawing is imported here, so that nothing else waits."""
    (folder / "compare.json").write_text(json_text(comparison_summary(found)), encoding="utf-8")
    if not report:
        return "compare.json"
    from structid.report.comparison.page import write_comparison_page

    return write_comparison_page(found, folder).name


@app.command()
def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="Record: NPZ, NPY, HDF5, CSV, MAT or UFF.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="File to write; the suffix gives the format.")],
    sampling_rate: Annotated[float | None, typer.Option(help="Samples per second of a bare time array.")] = None,
    channels: Annotated[str, typer.Option(help="Channels of a bare time array, as in 1X+,2X+.")] = "",
    quantities: Annotated[str, typer.Option("--quantity", "--quantities", help="As in acceleration,force.")] = "",
    units: Annotated[str, typer.Option(help="Units of time channels, as in g,N, or one for all.")] = "",
    array: Annotated[str, typer.Option(help="Name of the array in NPZ, MAT or HDF5.")] = "",
    frequency_array: Annotated[str, typer.Option(help="Name of the array of frequencies, Hz.")] = "",
    coherence_array: Annotated[str, typer.Option(help="Name of the array of coherences.")] = "",
    outputs: Annotated[str, typer.Option(help="Sensors of a bare FRF array, as in 1X+,2X+.")] = "",
    inputs: Annotated[str, typer.Option(help="Loads of a bare FRF array, as in 3X+.")] = "",
    kind: Annotated[str, typer.Option(help="receptance, mobility or accelerance.")] = "",
    unit: Annotated[str, typer.Option(help="Unit of a bare FRF array, as in g/N.")] = "",
    averages: Annotated[int | None, typer.Option(help="Number of averages behind each FRF value.")] = None,
) -> None:
    """Read a record and write it in another format, in SI units; the suffix of each file gives its format.

    \b
    Examples:
      structid convert measured.uff measured.h5
      structid convert impact.npy impact.csv --sampling-rate 1024 --channels 1X+,2X+ --units g,N
      structid convert frf.npz frf.uff --array accelerance --frequency-array freq_hz
          --outputs 1X-,2X+ --inputs 1X+ --kind accelerance
    """
    with reported():
        options = ReadOptions(
            sampling_rate=sampling_rate,
            channels=words(channels),
            quantities=words(quantities),
            units=words(units),
            array=array,
            frequency_array=frequency_array,
            coherence_array=coherence_array,
            outputs=words(outputs),
            inputs=words(inputs),
            kind=kind,
            unit=unit,
            averages=averages,
        )
        if target.exists() and source.exists() and target.samefile(source):
            raise FileError(f"{target}: is the file that is read; write to another one")
        record = read_record(source, options)
        with claimed(target):
            write_record(target, record)
        typer.echo(record_summary(record, target))


app.command()(modes)
app.command()(doctor)
app.command()(motion)


@app.command()
def reproduce(
    chapter: Annotated[int | None, typer.Option("--chapter", metavar="N", help="3, 4 or 5 [default: all].")] = None,
    out: Annotated[Path, typer.Option("--out", metavar="FOLDER", help="Results folder.")] = Path("reproduction"),
) -> None:
    """Compute the tables and figures of the dissertation beside the printed numbers, with a verdict for each.

    Writes reproduction.html, reproduction.json and the figures as PNG files. It takes a few minutes.

    \b
    Examples:
      structid reproduce
      structid reproduce --chapter 4 --out chapter_4
    """
    with reported():
        from structid.report.reproduce.page import (
            write_reproduction,  # imported here, so that nothing else waits for it
        )
        from structid.reproduce.run import CHAPTERS
        from structid.reproduce.run import reproduce as reproduced

        with item_progress() as progress:
            items = reproduced(CHAPTERS if chapter is None else (chapter,), progress)
        page = write_reproduction(items, out)
        for part in reproduction_summary(items):
            standard_output().print(part)
        typer.echo(str(page))
