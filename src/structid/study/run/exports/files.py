"""Files for other programs: those that a results folder can give, and those that are asked for, written."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

from structid.core.errors import FileError, InputError
from structid.modal.formats.options import WRITTEN_SUFFIXES
from structid.prediction.element_values import element_values
from structid.prediction.identified_model import IdentifiedModel
from structid.prediction.options import ExportOptions
from structid.study.results.stored_model import stored_model, stored_spread, stored_study
from structid.study.run.exports.deck import deck_path, export_deck
from structid.study.run.exports.matrices import MATRIX_SUFFIXES, export_matrices, export_state_space, matrix_files
from structid.study.run.exports.mesh import MESH_SUFFIXES, export_mesh
from structid.study.run.exports.mode_shapes import export_modes
from structid.study.schema.study import Study


@dataclass(frozen=True)
class ExportFiles:
    """Files to write; None for those that are not wanted.

    Parameters
    ----------
    mode_shapes, mesh, matrices, deck, state_space : Path, optional
    """

    mode_shapes: Path | None = None
    mesh: Path | None = None
    matrices: Path | None = None
    deck: Path | None = None
    state_space: Path | None = None

    @property
    def paths(self) -> tuple[Path, ...]:
        """Every file that may be written, with those that belong to the matrices."""
        single = [getattr(self, item.name) for item in fields(self) if item.name != "matrices"]
        beside = [] if self.matrices is None else matrix_files(self.matrices)
        return (*(path for path in single if path is not None), *beside)


def write_exports(
    results: Path, files: ExportFiles, options: ExportOptions, study: Path | None = None, force: bool = False
) -> list[str]:
    """Write files from the identified model of a results folder, and return lines that describe them.

    `results` is the folder, `files` the paths by kind of content, and `study` the study file if it was moved since.

    Raises
    ------
    FileError
        If a file exists already and `force` is not set, a suffix is of no format, or the folder is of another version.
    InputError
        If the model has no such content or is not determined, two files are one, or an option cannot be used.
    """
    for path in files.paths:
        if files.paths.count(path) > 1:
            raise InputError(f"{path} is named for two kinds of content; give each a file of its own")
        if path.exists() and not force:
            raise FileError(f"{path}: exists already; add --force to write it anew, or write to another file")
    source = stored_study(results, study)
    return write_model_files(results, source, stored_model(results, source), files, options)


def write_model_files(
    results: Path, source: Study, model: IdentifiedModel, files: ExportFiles, options: ExportOptions
) -> list[str]:
    """Write files from a loaded model over those that exist, and return lines that describe them.

    `source` and `model` are the study and the identified model of the folder `results`; errors are those of `write_exports`.
    """
    lines: list[str] = []
    if files.mode_shapes is not None:
        lines += export_modes(model, options.modes, source.title or "structid", files.mode_shapes)
    if files.mesh is not None:
        lines += export_mesh(model, stored_spread(results, source), options.modes, files.mesh)
    if files.deck is not None:
        spread = stored_spread(results, source)
        lines += export_deck(source, element_values(model, spread.initial, spread.covariance), files.deck)
    if files.matrices is not None:
        lines += export_matrices(model, files.matrices)
    if files.state_space is not None:
        lines.append(export_state_space(model, options, files.state_space))
    return lines


@dataclass(frozen=True)
class Offer:
    """One kind of file that `structid export` writes.

    Attributes
    ----------
    flag : str
        Such as ``--mesh``.
    content : str
        In words.
    suffixes : tuple of str
    obstacle : str
        Why this results folder cannot give it; "" if it can.
    """

    flag: str
    content: str
    suffixes: tuple[str, ...]
    obstacle: str = ""


def list_offers(model: IdentifiedModel, study: Study) -> tuple[Offer, ...]:
    """Every kind of file that `structid export` writes, with a text on why this model cannot give it; "" if it can."""
    obstacle = deck_obstacle = ""
    try:
        model.structure.require_modes("it", "predict FRFs")
    except InputError as error:
        obstacle = str(error)
    suffixes: tuple[str, ...] = ()
    try:
        suffixes = (deck_path(study).suffix.lower(),)
    except InputError as error:
        deck_obstacle = str(error)
    return (
        Offer("--mode-shapes", "natural modes at all nodes", WRITTEN_SUFFIXES, obstacle),
        Offer("--mesh", "elements with values, changes, deviations, significance; mode shapes", MESH_SUFFIXES),
        Offer("--matrices", "mass, damping and stiffness matrices, with the numbering", MATRIX_SUFFIXES, obstacle),
        Offer("--deck", "the deck of the mesh with the identified numbers in it", suffixes, deck_obstacle),
        Offer(
            "--state-space",
            "state equations of low order; needs --sensors, --loads, --band",
            (".mat", ".npz", ".h5"),
            obstacle,
        ),
    )
