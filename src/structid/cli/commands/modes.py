"""The command `structid modes`: natural frequencies, damping ratios and mode shapes of a record."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from structid.cli.base import NOT_DETERMINED, Png, Report, beside_call, check_png, fail, results_folder, say
from structid.core.errors import InputError
from structid.modal.survey.options import ModesOptions
from structid.records.formats.options import ReadOptions


def modes(
    records: Annotated[
        list[Path],
        typer.Argument(
            metavar="RECORD...",
            help="Time histories (NPZ, NPY, HDF5, MAT, CSV, UFF, TDMS, MDF, miniSEED, WAV, Parquet) or FRFs; several are set-ups,"
            " whose modes are merged.",
        ),
    ],
    options: ModesOptions,
    read: ReadOptions,
    geometry: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Positions of the nodes: UFF, or CSV of node,x,y,z and line,1,2."),
    ] = None,
    merge: Annotated[
        bool, typer.Option("--merge", help="The files hold modes of set-ups (JSON, UFF, CSV): merge these.")
    ] = False,
    track: Annotated[
        bool,
        typer.Option(
            "--track",
            help="Records in the order of time, or a folder of them, or of modes: follow each mode over them.",
        ),
    ] = False,
    out: Annotated[Path | None, results_folder("<first record>_modes")] = None,
    report: Report = True,
    png: Png = False,
) -> None:
    """Find the modes of a record, each with its uncertainty; write modes.json, modes.csv, modes.uff and report.html.

    No option is needed for a file that describes itself. Time histories may be free or ambient motion: forces in them
    are not used. Several records are set-ups of one structure with common reference sensors: the modes of each are merged
    to shapes at all sensors. Exit code 1: no mode is stable, or its uncertainty is not determined.

    \b
    Examples:
      structid modes ambient.uff
      structid modes ambient.npy --sampling-rate 100 --channels 1X+,1Y+,2X+ --quantity acceleration
      structid modes lab.csv --columns "Acc 1,Acc 2" --channels 1X+,2X+ --units g --csv-skip-rows 4
      structid modes ambient.h5 --band 1 4 --geometry nodes.csv --out tower
      structid modes frf.uff --frequencies 21.6,50.1,68.4
      structid modes lower_floors.uff upper_floors.uff --out tower
      structid modes year_2026 --track --out followed
      structid modes modes_of_a.uff modes_of_b.uff --merge --out tower
    """
    from structid.cli.console import show  # the help needs none of these
    from structid.modal.survey.setups import modes_of_setups
    from structid.modal.survey.survey import MODES_PAGE, modes_of_file
    from structid.report.modes import modes_page, modes_text
    from structid.study.results.folder import staged_folder
    from structid.study.results.modes import write_modes_results

    check_png(report, png)
    if merge and track:
        raise InputError("`--merge` puts set-ups together and `--track` follows records; give one of them")
    if track:
        _track(records, options, read, geometry, out, report, png)
        return
    if merge:
        _merge(records, options, read, geometry, out)
        return
    if len(records) > 1:
        result = modes_of_setups(records, options, read, geometry)
    else:
        result = modes_of_file(records[0], options, read, geometry)
    folder, name = out if out is not None else beside_call(f"{records[0].stem}_modes"), "modes.json"
    with staged_folder(folder, name, MODES_PAGE) as staged:
        write_modes_results(result, staged)
        if report:
            name = modes_page(result).write(staged, png).name
    show(modes_text(result))
    say(folder / name)
    if not result.is_determined:
        fail("the data do not determine the uncertainty of every mode; see the warnings", NOT_DETERMINED)


def _track(
    results: list[Path],
    options: ModesOptions,
    read: ReadOptions,
    geometry: Path | None,
    out: Path | None,
    report: bool,
    png: bool,
) -> None:
    """Track modes over several records or files of modes, in the order given; write and print the tracks.

    A folder in `results` stands for its files, sorted by name. Modes of a record are identified with `options`, the
    record being read with `read`. `geometry` is a file of node positions or None, `out` the results folder (None for
    its default name); `report` and `png` ask for the page and its figures.
    """
    from structid.cli.console import show  # the help needs none of these
    from structid.core.display import file_names
    from structid.modal.formats.files import read_modes
    from structid.modal.formats.recognition import holds_modes
    from structid.modal.survey.survey import MODES_PAGE, modes_of_file
    from structid.modal.tracking import track_modes
    from structid.report.modes import tracks_page, tracks_text
    from structid.study.results.folder import staged_folder
    from structid.study.results.modes import write_tracks

    paths = [
        path
        for path_or_folder in results
        for path in (_files_of(path_or_folder) if path_or_folder.is_dir() else [path_or_folder])
    ]
    modes = [
        read_modes(path) if holds_modes(path) else modes_of_file(path, options, read, geometry).modes for path in paths
    ]
    tracks = track_modes(modes, file_names(paths))
    folder, name = out if out is not None else beside_call(f"{results[0].stem}_tracks"), "tracks.json"
    with staged_folder(folder, name, MODES_PAGE) as staged:
        write_tracks(tracks, staged)
        if report:
            name = tracks_page(tracks).write(staged, png).name
    show(tracks_text(tracks))
    say(folder / name)


def _files_of(folder: Path) -> list[Path]:
    """The files in `folder` by name; what begins with a dot is left out."""
    return sorted(path for path in folder.iterdir() if path.is_file() and not path.name.startswith("."))


def _merge(
    paths: list[Path], options: ModesOptions, read: ReadOptions, geometry: Path | None, out: Path | None
) -> None:
    """Merge the modes of several set-ups from files of modes.

    Write them in the formats that a study can read, and print them. `geometry` is a file of node positions or None,
    `out` the results folder (None for its default name). `InputError` if `options` or `read`, which have no use here,
    are not the defaults.
    """
    from structid.cli.console import show
    from structid.core.display import file_names
    from structid.modal.formats.files import read_modes
    from structid.modal.merging import merged_setups
    from structid.modal.survey.survey import MODES_PAGE
    from structid.records.formats.geometry import read_geometry
    from structid.report.modes import merged_text
    from structid.study.results.folder import staged_folder
    from structid.study.results.modes import write_merged

    if options != ModesOptions() or read != ReadOptions():
        raise InputError(
            "`--merge` takes files of modes as they are; leave the options of reading and identification out"
        )
    names = file_names(paths)
    merging = merged_setups([read_modes(path) for path in paths], names=names)
    nodes = None if geometry is None else read_geometry(geometry)
    folder = out if out is not None else beside_call(f"{paths[0].stem}_modes")
    with staged_folder(folder, "modes.json", MODES_PAGE) as staged:
        write_merged(merging.modes, staged, nodes)
    show(merged_text(names, merging))
    if nodes is not None and nodes.unit_words:
        say(nodes.unit_words)
    say(folder / "modes.json")
