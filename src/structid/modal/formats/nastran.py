"""Modes of Nastran: listings (``.f06``), punch files and binary results (``.op2``) as records."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray, IntArray
from structid.core.errors import FileError
from structid.fem.meshes.bulk_cards import SYSTEM_CARDS, BulkSystems, bulk_text, cards_of
from structid.files import damage_told, require_readable
from structid.modal.formats.f06 import f06_modes
from structid.modal.formats.op2 import op2_modes
from structid.modal.formats.options import F06_SUFFIXES, OP2_SUFFIXES, ModeFileOptions
from structid.modal.formats.printed import RUN_AGAIN, PrintedModes, printed_record
from structid.modal.formats.punch import punch_modes
from structid.modal.modal_record import ModalRecord

#: Coordinate system in which a deck wants displacements printed.
_OUTPUT_SYSTEM = re.compile(rb"^[ \t]*PARAM\*?[\s,]+OUGCORD[\s,]+(\w+)", re.MULTILINE | re.IGNORECASE)


def nastran_modes(path: Path, options: ModeFileOptions | None = None) -> PrintedModes:
    """Modes as printed in the Nastran listing, punch file or binary file at `path`, in the units of the model.

    None for `options` takes the defaults.

    Raises
    ------
    FileError
        If there are no eigenvectors, or only those of scalar points.
    """
    options = options or ModeFileOptions()
    if path.suffix.lower() in OP2_SUFFIXES:
        printed = op2_modes(path, options)
    else:
        text = path.read_text(encoding="latin-1")
        printed = (f06_modes if path.suffix.lower() in F06_SUFFIXES else punch_modes)(path, text, options)
    if not printed.modes:
        raise FileError(f"{path}: holds no eigenvectors of vibration; {RUN_AGAIN}")
    if not any(len(mode.nodes) for mode in printed.modes):
        raise FileError(
            f"{path}: the vectors hold scalar points only, which have no place and direction; print those of grid points"
        )
    return printed


def read_modes_nastran(path: Path, options: ModeFileOptions | None = None) -> ModalRecord:
    """The modes of a Nastran listing, punch file or binary file at the directions that move, largest entry 1.

    The scaling is modal mass 1 where `options` state units of length and force. Rotations are left out unless they
    state the unit of length: beside translations they have a meaning only in metres. With `options.deck`, motions are
    turned from the displacement systems that this bulk data file defines to global axes; else they are taken as global.

    Raises
    ------
    FileError
        If there are none, points differ from mode to mode, the deck lacks a point, a point states a system of its own
        and no deck is named, or both units are stated but generalized masses are missing, as in any punch file.
    """
    options = options or ModeFileOptions()
    printed = nastran_modes(path, options)
    if options.deck is None:
        return printed_record(path, printed, options)
    deck = require_readable(options.deck)
    axes = printed_axes(path, deck, printed.modes[0].nodes, is_stated=bool((printed.modes[0].systems > 0).any()))
    if axes is None:
        raise FileError(f"{deck}: holds no GRID, so that it is not the deck of {path.name}; name its bulk data")
    words = f"motions turned to global axes by {deck.name}" if axes else f"global axes by {deck.name}"
    return printed_record(path, printed, options, axes, [words])


def printed_axes(
    path: Path, deck: Path, nodes: IntArray, linked: Mapping[str, Path] | None = None, is_stated: bool = False
) -> dict[int, FloatArray] | None:
    """Axes (3, 3), as rows in global axes, of each point whose displacement system in the `deck` is not the global one.

    Keys are node labels. There are none where the deck asks for motions in the basic system; the result is None where
    it has no GRID. `linked` has included files by name that do not lie beside the deck. With `is_stated` the file
    `path` states systems itself, as that of MYSTRAN, which passes over PARAM,OUGCORD.

    Raises
    ------
    FileError
        If the deck is damaged, lacks one of the points `nodes` that the file `path` prints, or asks for motions in
        another system.
    """
    with damage_told(deck, "Nastran bulk data", "export it again"):
        text = bulk_text(deck, linked)
        cards = cards_of(text, ("GRID", "GRDSET", *SYSTEM_CARDS))
        asked = _OUTPUT_SYSTEM.search(text.case_control + b"\n" + text.content)
        system = asked[1].decode("latin-1").upper() if asked and not is_stated else "GLOBAL"
        if system not in ("GLOBAL", "BASIC"):
            raise FileError(f"{deck}: asks for motions in system {system} (PARAM,OUGCORD); leave it out")
        if "GRID" not in cards:
            return None
        if system == "BASIC":
            return {}
        systems = BulkSystems(deck, cards)
        missing = np.setdiff1d(nodes, systems.labels)
        if missing.size:
            raise FileError(f"{deck}: has no GRID {missing[0]}, which {path.name} prints; name the deck of that run")
        return systems.displacement_axes(systems.labels, systems.basic_positions())
