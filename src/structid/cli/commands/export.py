"""The command `structid export`: modes, grids, matrices and state equations of an identified model, for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from structid.cli.base import say
from structid.prediction.options import ExportOptions


def export(
    results: Annotated[Path, typer.Argument(metavar="RESULTS", help="Results folder of `structid identify`.")],
    options: ExportOptions,
    mode_shapes: Annotated[
        Path | None,
        typer.Option("--mode-shapes", metavar="FILE", help="Modes: .uff (55), .pch (Nastran punch), .csv, .json."),
    ] = None,
    mesh: Annotated[
        Path | None,
        typer.Option("--mesh", metavar="FILE", help="Elements with their changes: .vtu (ParaView) or .csv."),
    ] = None,
    matrices: Annotated[
        Path | None,
        typer.Option(
            "--matrices",
            metavar="FILE",
            help="Mass, damping, stiffness: .op4, .pch (DMIG), .inp (Abaqus), .mtx (MatrixMarket), .npz, .npy, .mat.",
        ),
    ] = None,
    deck: Annotated[
        Path | None,
        typer.Option(
            "--deck", metavar="FILE", help="The deck of the mesh (.bdf, .inp ...) with the identified numbers."
        ),
    ] = None,
    state_space: Annotated[
        Path | None, typer.Option("--state-space", metavar="FILE", help="State equations: .mat, .npz, .h5.")
    ] = None,
    study: Annotated[
        Path | None, typer.Option("--study", metavar="STUDY.toml", help="The study, where it has moved since.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write files even where they exist.")] = False,
) -> None:
    """Write an identified model for other programs: modes, a grid with the changes, matrices, its deck, state equations.

    Without a file to write, list what the results folder can give. Modes have unit modal mass and stand at all nodes. The grid
    has value, relative change, deviation and significance (change over deviation) of every element. Matrices are those of the
    free degrees of freedom, with a file of node and component of each row. In the deck the identified numbers change and nothing
    else. State equations come with the largest error of their
    FRFs in the band, and with --draws those of models within the uncertainty, for robust design.

    \b
    Examples:
      structid export beam_results
      structid export frame_results --mode-shapes frame.uff --mesh frame.vtu --modes 12
      structid export frame_results --matrices frame.op4
      structid export wing_results --deck wing_identified.bdf
      structid export beam_results --state-space beam.mat --loads 8Y --sensors 4Y,8Y --band 0.5 60
      structid export beam_results --state-space beam.npz --loads 8Y --sensors 8Y --band 0.5 60 --sampling-rate 500 --draws 50
    """
    from structid.cli.console import new_table, show  # the help needs none of these
    from structid.study.results.stored_model import stored_model, stored_study
    from structid.study.run.exports import ExportFiles, list_offers, write_exports

    files = ExportFiles(mode_shapes, mesh, matrices, deck, state_space)
    if files.paths:
        for line in write_exports(results, files, options, study, force):
            say(line)
        return
    source = stored_study(results, study)
    table = new_table("Flag", "Content", "Files")
    offers = list_offers(stored_model(results, source), source)
    for offer in offers:
        table.add_row(offer.flag, offer.content, "-" if offer.obstacle else " ".join(offer.suffixes))
    show([f"{results} can give", table])
    for words in dict.fromkeys(offer.obstacle for offer in offers if offer.obstacle):
        say(words)
