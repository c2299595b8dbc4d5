"""Modes from records: one method a file, Record to ModalRecord."""

from structid.modal.fdd import fdd
from structid.modal.identification import identify_modes
from structid.modal.modal_record import ModalRecord
from structid.modal.poles import HardCriteria, Poles
from structid.modal.pseudo_rayleigh import StationaryValues, pseudo_rayleigh, stationary_values

__all__ = [
    "HardCriteria",
    "ModalRecord",
    "Poles",
    "StationaryValues",
    "fdd",
    "identify_modes",
    "pseudo_rayleigh",
    "stationary_values",
]
