"""Modes from records: one method a file, Record to ModalRecord."""

from structid.modal.full_field import full_field_modes
from structid.modal.identification import METHODS, identify_modes, modal_identification
from structid.modal.merging.joint_setups import joint_modes
from structid.modal.merging.merging import Merging, merge_modes, merged_setups
from structid.modal.modal_identification import ModalIdentification, ModalOptions
from structid.modal.modal_record import ModalRecord
from structid.modal.poles import HardCriteria, Poles
from structid.modal.rayleigh.pseudo_rayleigh import StationaryValues, pseudo_rayleigh, stationary_values
from structid.modal.spectral.bayesian_fft import bayesian_fft
from structid.modal.spectral.efdd import efdd
from structid.modal.spectral.fdd import fdd
from structid.modal.subspace.natural_excitation import natural_excitation
from structid.modal.window_damping import without_window_damping

__all__ = [
    "METHODS",
    "HardCriteria",
    "Merging",
    "ModalIdentification",
    "ModalOptions",
    "ModalRecord",
    "Poles",
    "StationaryValues",
    "bayesian_fft",
    "efdd",
    "fdd",
    "full_field_modes",
    "identify_modes",
    "joint_modes",
    "merge_modes",
    "merged_setups",
    "modal_identification",
    "natural_excitation",
    "pseudo_rayleigh",
    "stationary_values",
    "without_window_damping",
]
