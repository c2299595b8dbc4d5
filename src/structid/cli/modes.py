"""The command `structid modes`: natural frequencies, damping ratios and mode shapes of a record."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from structid.cli.base import NOT_DETERMINED, Png, Report, check_png, fail, reported, words
from structid.cli.console import standard_output
from structid.modal.survey.survey import MODES_PAGE, ModesOptions, ModesResult, modes_of_file
from structid.records.io import ReadOptions
from structid.study.results.folder import staged_folder
from structid.study.results.modes import parse_numbers, parse_orders, write_modes_results

RecordPath = Annotated[
    Path, typer.Argument(metavar="RECORD", help="Time histories (NPZ, NPY, HDF5, MAT, CSV, UFF) or FRFs.")
]
Method = Annotated[
    str | None, typer.Option(help="See docs/modes.md [default: by the kind of record].", show_default=False)
]
Band = Annotated[tuple[float, float] | None, typer.Option(metavar="LOW HIGH", help="Hz: look for modes there only.")]
Nodes = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Positions of the nodes: UFF, or CSV of node,x,y,z and line,1,2.")
]
Out = Annotated[
    Path | None, typer.Option("--out", metavar="FOLDER", help="Results folder [default: <record name>_modes].")
]


def modes(
    record: RecordPath,
    method: Method = None,
    band: Band = None,
    frequencies: Annotated[str, typer.Option(help="Hz: the modes wanted, by hand, as in 1.9,2.4.")] = "",
    orders: Annotated[str, typer.Option(help="Numbers of states to try, as in 2:60 or 20,30,40.")] = "",
    rate: Annotated[float | None, typer.Option(help="Hz: decimate time histories to this sampling rate.")] = None,
    detrend: Annotated[str, typer.Option(help="Taken off each time history: mean, linear, none or a degree.")] = "mean",
    geometry: Nodes = None,
    sampling_rate: Annotated[float | None, typer.Option(help="Samples per second of a bare time array.")] = None,
    channels: Annotated[
        str, typer.Option(help="Channels of a bare time array, as in 1X+,2X+; else those to use.")
    ] = "",
    quantities: Annotated[
        str, typer.Option("--quantity", "--quantities", help="As in acceleration, one for all.")
    ] = "",
    units: Annotated[str, typer.Option(help="Units of time channels, as in g, or one for all.")] = "",
    array: Annotated[str, typer.Option(help="Name of the array in NPZ, MAT or HDF5; frf or time in UFF.")] = "",
    frequency_array: Annotated[str, typer.Option(help="Name of the array of frequencies of a bare FRF array.")] = "",
    outputs: Annotated[str, typer.Option(help="Sensors of a bare FRF array, as in 1X+,2X+; else those to use.")] = "",
    inputs: Annotated[str, typer.Option(help="Loads of a bare FRF array, as in 3X+; else those to use.")] = "",
    kind: Annotated[str, typer.Option(help="receptance, mobility or accelerance of a bare FRF array.")] = "",
    unit: Annotated[str, typer.Option(help="Unit of a bare FRF array, as in g/N.")] = "",
    out: Out = None,
    report: Report = True,
    png: Png = False,
) -> None:
    """Find the modes of a record, each with its uncertainty; write modes.json, modes.csv, modes.uff and report.html.

    No option is needed for a file that describes itself. Time histories may be free or ambient motion: forces in them
    are not used. Exit code 1: no mode is stable, or its uncertainty is not determined.

    \b
    Examples:
      structid modes ambient.uff
      structid modes ambient.npy --sampling-rate 100 --channels 1X+,1Y+,2X+ --quantity acceleration
      structid modes ambient.h5 --band 1 4 --geometry nodes.csv --out tower
      structid modes frf.uff --frequencies 21.6,50.1,68.4
    """
    with reported():
        check_png(report, png)
        options = ModesOptions(
            method, band, parse_numbers("frequencies", frequencies), parse_orders(orders), rate,
            int(detrend) if detrend.isdigit() else detrend,
        )  # fmt: skip
        read = ReadOptions(
            sampling_rate, words(channels), words(quantities), words(units), array, frequency_array, words(outputs),
            words(inputs), kind, unit,
        )  # fmt: skip
        found = modes_of_file(record, options, read, geometry)
        folder = out if out is not None else Path(f"{record.stem}_modes")
        with staged_folder(folder, MODES_PAGE) as staged:
            name = _written(found, staged, report, png)
        from structid.report.modes.text import modes_text  # imported here, so that nothing else waits for it

        for part in modes_text(found):
            standard_output().print(part)
        typer.echo(str(folder / name))
        if not found.is_determined:
            fail("the data do not determine the uncertainty of every mode; see the warnings", NOT_DETERMINED)


def _written(found: ModesResult, folder: Path, report: bool, png: bool) -> str:
    """The name of the page in `folder`, or of modes.json; drawing is imported here, so that nothing else waits for it."""
    write_modes_results(found, folder)
    if not report:
        return "modes.json"
    from structid.report.modes.page import modes_page

    return modes_page(found).write(folder, png).name
