"""The public names, each with its place; `structid.lazy` reads them from here."""

from structid.records.formats import CsvLayout as CsvLayout
from structid.records.formats import Geometry as Geometry
from structid.records.formats import ReadOptions as ReadOptions
from structid.records.formats import read_geometry as read_geometry
from structid.records.formats import read_record as read_record
from structid.records.formats import write_record as write_record
from structid.records.formats.spectra import read_spectrum as read_spectrum
from structid.records.quality.findings import Finding as Finding
from structid.records.quality.preparation import Preparation as Preparation
from structid.records.quality.preparation import Prepared as Prepared
from structid.records.quality.preparation import prepare as prepare
from structid.records.quality.signal_checks import signal_checks as signal_checks
from structid.records.quality.spectral_checks import harmonic_indicator as harmonic_indicator
from structid.records.record import FrfRecord as FrfRecord
from structid.records.record import Record as Record
from structid.records.record import TimeRecord as TimeRecord
from structid.records.record import coherence_variance as coherence_variance
from structid.records.record import from_repeats as from_repeats
from structid.records.record import with_coherence_noise as with_coherence_noise
from structid.records.record import with_declared_noise as with_declared_noise
from structid.records.spectrum import SpectrumRecord as SpectrumRecord
from structid.records.transforms.finite_spectra import FiniteSpectra as FiniteSpectra
from structid.records.transforms.finite_spectra import finite_spectra as finite_spectra
from structid.records.transforms.half_plane import right_half_plane as right_half_plane
from structid.records.transforms.spectra import effective_averages as effective_averages
from structid.records.transforms.spectra import frf_from_time as frf_from_time
