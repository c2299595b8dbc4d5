"""The command `structid export`: state equations and matrices of an identified model, for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from structid.cli.base import say
from structid.core.errors import FileError, InputError
from structid.prediction.options import ExportOptions


def export(
    results: Annotated[Path, typer.Argument(metavar="RESULTS", help="Results folder of `structid identify`.")],
    options: ExportOptions,
    state_space: Annotated[
        Path | None, typer.Option("--state-space", metavar="FILE", help="State equations, as .mat, .npz or .h5.")
    ] = None,
    matrices: Annotated[
        Path | None,
        typer.Option("--matrices", metavar="FILE", help="Mass, damping and stiffness, as .op4, .pch or .mat."),
    ] = None,
    study: Annotated[
        Path | None, typer.Option("--study", metavar="STUDY.toml", help="The study, where it has moved since.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write files even where they exist.")] = False,
) -> None:
    """Write an identified model for other programs: state equations of low order, or its matrices.

    State equations come with the largest error of their FRFs in the band, and with --draws those of models within the uncertainty,
    for robust design. Matrices are those of the free degrees of freedom, with a file of node and component of each row.

    \b
    Examples:
      structid export beam_results --state-space beam.mat --loads 8Y --sensors 4Y,8Y --band 0.5 60
      structid export beam_results --state-space beam.npz --loads 8Y --sensors 8Y --band 0.5 60 --sampling-rate 500 --draws 50
      structid export frame_results --matrices frame.op4
    """
    from structid.fem.importers import FORMATS as MATRIX_FORMATS  # the help needs none of these
    from structid.study.results.stored_model import stored_model, stored_study
    from structid.study.run.exporting import export_matrices, export_state_space

    if state_space is None and matrices is None:
        suffixes = ", ".join(sorted({suffix for module in MATRIX_FORMATS for suffix in module.SUFFIXES}))
        raise InputError(f"say what to write: --state-space FILE (.mat, .npz, .h5) or --matrices FILE ({suffixes})")
    for path in (state_space, matrices):
        if path is not None and path.exists() and not force:
            raise FileError(f"{path}: exists already; add --force to write it anew, or write to another file")
    model = stored_model(results, stored_study(results, study))
    if state_space is not None:
        say(export_state_space(model, options, state_space))
    if matrices is not None:
        for line in export_matrices(model, matrices):
            say(line)
