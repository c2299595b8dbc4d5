"""The names that others use, each with its place; `structid.lazy` reads them from here."""

from structid.study.schema.records.histories import FRF as FRF
from structid.study.schema.records.histories import TIME as TIME
from structid.study.schema.records.histories import FrfSettings as FrfSettings
from structid.study.schema.records.histories import TimeSource as TimeSource
from structid.study.schema.records.histories import read_frf as read_frf
from structid.study.schema.records.histories import read_time as read_time
from structid.study.schema.records.histories import spectral_frf as spectral_frf
from structid.study.schema.records.modes import MODES as MODES
from structid.study.schema.records.modes import ModesSource as ModesSource
from structid.study.schema.records.modes import read_modes_source as read_modes_source
