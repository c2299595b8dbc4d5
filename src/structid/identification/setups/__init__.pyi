"""The names that others use, each with its place; `structid.lazy` reads them from here."""

from structid.identification.setups.frf import Setup as Setup
from structid.identification.setups.modal import ModalSetup as ModalSetup
from structid.identification.setups.modal import chosen_modes as chosen_modes
from structid.identification.setups.time import TimeFit as TimeFit
from structid.identification.setups.time import TimeSetup as TimeSetup
from structid.identification.setups.time import frfs_of as frfs_of
