"""Modes from records: one method a file, Record to ModalRecord."""

from structid.modal.fdd import fdd
from structid.modal.identification import METHODS, identify_modes, modal_identification
from structid.modal.modal_identification import ModalIdentification, ModalOptions
from structid.modal.modal_record import ModalRecord
from structid.modal.poles import HardCriteria, Poles
from structid.modal.pseudo_rayleigh import StationaryValues, pseudo_rayleigh, stationary_values

__all__ = [
    "METHODS",
    "HardCriteria",
    "ModalIdentification",
    "ModalOptions",
    "ModalRecord",
    "Poles",
    "StationaryValues",
    "fdd",
    "identify_modes",
    "modal_identification",
    "pseudo_rayleigh",
    "stationary_values",
]
