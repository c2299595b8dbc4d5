"""The public names, each with its place; `structid.lazy` reads them from here."""

from structid.modal.full_field import full_field_modes as full_field_modes
from structid.modal.identification import METHODS as METHODS
from structid.modal.identification import identify_modes as identify_modes
from structid.modal.identification import modal_identification as modal_identification
from structid.modal.merging import MergedModes as MergedModes
from structid.modal.merging import merge_modes as merge_modes
from structid.modal.merging import merged_setups as merged_setups
from structid.modal.method import ModalIdentification as ModalIdentification
from structid.modal.method import ModalOptions as ModalOptions
from structid.modal.modal_record import ModalRecord as ModalRecord
from structid.modal.poles.poles import HardCriteria as HardCriteria
from structid.modal.poles.poles import Poles as Poles
from structid.modal.poles.window_damping import without_window_damping as without_window_damping
from structid.modal.rayleigh import StationaryValues as StationaryValues
from structid.modal.rayleigh import pseudo_rayleigh as pseudo_rayleigh
from structid.modal.rayleigh import stationary_values as stationary_values
from structid.modal.spectral.bayesian_fft import bayesian_fft as bayesian_fft
from structid.modal.spectral.fdd import fdd as fdd
