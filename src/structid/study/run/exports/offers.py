"""The files that a results folder can give."""

from __future__ import annotations

from dataclasses import dataclass

from structid.core.errors import InputError
from structid.modal.formats.options import WRITTEN_SUFFIXES
from structid.prediction.identified_model import IdentifiedModel
from structid.study.run.exports.deck import deck_path
from structid.study.run.exports.matrices import MATRIX_SUFFIXES
from structid.study.run.exports.mesh import MESH_SUFFIXES
from structid.study.schema.study import Study


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
