"""Modes from records: one method a file, Record to ModalRecord."""

from structid.modal.modal_record import ModalRecord
from structid.modal.pseudo_rayleigh import StationaryValues, pseudo_rayleigh, stationary_values

__all__ = ["ModalRecord", "StationaryValues", "pseudo_rayleigh", "stationary_values"]
