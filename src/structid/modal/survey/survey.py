"""Modes of one record file from start to end: read, prepare, identify, and what lies behind the answer."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray

from structid._version import __version__
from structid.core.arrays import FloatArray
from structid.core.display import Overview, Shown
from structid.core.dof import Dof
from structid.core.errors import InputError, NoModesError, StoredSpectraError, UnnamedChannelsError
from structid.core.provenance import Provenance
from structid.files import digest
from structid.files.uff.datasets import dataset_lines
from structid.modal.close_modes import NOT_TOLD_APART
from structid.modal.correlations import outputs
from structid.modal.full_field import SharedMotions, at_all_channels, shared_motions
from structid.modal.identification import modal_identification
from structid.modal.method import ModalIdentification
from structid.modal.modal_record import ModalRecord
from structid.modal.poles.window_damping import without_window_damping
from structid.modal.spectral.peaks import singular_spectrum, stored_spectrum, unexplained_peaks
from structid.modal.survey.options import ModesOptions
from structid.modal.survey.rates import FLAT, join_frequency, joined, look_rates
from structid.plotting import ModesPlots
from structid.records import (
    Finding,
    FrfRecord,
    Geometry,
    Preparation,
    ReadOptions,
    Record,
    TimeRecord,
    Tone,
    harmonic_indicator,
    prepare,
    read_geometry,
    read_record,
)
from structid.records.formats import UFF, how_read
from structid.records.formats.spectra import CORRELATION, SPECTRUM, read_correlation, read_spectrum
from structid.records.stored_averages import CorrelationRecord, SpectrumRecord

#: Name of the page that is written beside modes.json.
MODES_PAGE = "report.html"
#: Damping ratio below which a machine or the mains may be behind a mode of time histories.
HARDLY_DAMPED = 1e-3
_SHORTEST_SEGMENT, _LONGEST_SEGMENT, _SEGMENTS = 512, 4096, 8
_RATE_OVER_BAND, _FEWEST_SAMPLES = 4.0, 500
#: Channels from which on those are looked at that they share, and how many of these at most.
_MANY_CHANNELS, _SHARED = 200, 40
#: Peaks that no mode explains, as many as are named.
_MOST_PEAKS = 8


@dataclass(frozen=True, eq=False)
class ModeSpectra:
    """Spectra that are drawn behind the poles.

    Attributes
    ----------
    frequency : (n_lines,) float array
        Hz.
    values : (n_lines, n_values) float array
        Singular values, greatest first.
    name, unit : str
    is_power : bool
        Whether they are powers, as of spectra of motion; else amplitudes, as of FRFs.
    """

    frequency: FloatArray
    values: FloatArray
    name: str
    unit: str
    is_power: bool = True


@dataclass(frozen=True, eq=False, repr=False)
class ModesResult(Shown, ModesPlots):
    """Modes of a record, with what they were found from.

    Attributes
    ----------
    title : str
        Name of the record.
    record : Record, SpectrumRecord or CorrelationRecord
        As identified, after its preparation.
    identification : ModalIdentification
    spectra : ModeSpectra
    geometry : Geometry or None
        Where the sensors are; None where nothing says it.
    steps : tuple of str
        What was done to the record before.
    findings : tuple of Finding
        What is doubtful about the signals.
    tones : tuple of Tone
        What `ModesOptions.remove_tones` took off; of several set-ups those of each.
    kurtosis : (n_modes,) float array
        Kurtosis of the signal in a narrow band at each mode, median over the channels: 1.5 for a pure tone, 3 for a mode under
        random forces; NaN where damping leaves no doubt.
    options : ModesOptions
        As asked for.
    provenance : Provenance
    """

    title: str
    record: Record | SpectrumRecord | CorrelationRecord
    identification: ModalIdentification
    spectra: ModeSpectra
    geometry: Geometry | None
    provenance: Provenance
    steps: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    options: ModesOptions = field(default_factory=ModesOptions)
    kurtosis: FloatArray = field(default_factory=lambda: np.zeros(0))
    tones: tuple[Tone, ...] = ()

    def overview(self) -> Overview:
        """Line on title, method, modes and channels, and a table with a row for each mode, as `ModalRecord` shows it."""
        modes = self.modes.overview()
        return Overview(f"{self.title}, by {self.identification.method}: {modes.words}", modes.header, modes.rows)

    @property
    def modes(self) -> ModalRecord:
        return self.identification.modes

    @property
    def std(self) -> FloatArray:
        """`ModalRecord.std` of the modes."""
        return self.modes.std

    @property
    def is_determined(self) -> bool:
        """True if the covariance, where the method gives one, is complete."""
        return self.modes.covariance is None or bool(np.isfinite(self.modes.covariance).all())

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings on the signals, then on the modes."""
        doubtful = (finding.words for finding in self.findings if finding.severity != "note")
        return (*doubtful, *self.modes.warnings)

    @property
    def scale_words(self) -> str:
        """Words on the scale of the mode shapes, and what the modes cannot tell because of it.

        They name a modal mass of 1 kg, or say that the scale is arbitrary and no modal mass is known.
        """
        if self.modes.scaling == "mass":
            return "mode shapes are scaled to a modal mass of 1 kg, from the measured forces"
        if isinstance(self.record, TimeRecord | SpectrumRecord | CorrelationRecord):
            return (
                "no force was used: output-only data give frequencies, damping ratios and mode shapes of arbitrary"
                " scale, but no masses or stiffnesses; they tell ratios, until one mass, stiffness or force is known"
            )
        return "the largest entry of each mode shape is 1: their scale is arbitrary, so they hold no modal masses"


def modes_of_file(
    path: str | Path,
    options: ModesOptions | None = None,
    read: ReadOptions | None = None,
    geometry: str | Path | None = None,
) -> ModesResult:
    """The modes of the record in the file at `path`.

    Parameters
    ----------
    path : str or Path
        Time histories or FRFs. Columns of a bare array of histories whose channels nothing names are numbered 1X+, 2X+ and so on.
    options : ModesOptions, optional
    read : ReadOptions, optional
        What the file does not say about itself.
    geometry : str or Path, optional
        File with the positions of the nodes: universal file or CSV; by default what a universal file holds itself.

    Raises
    ------
    NoModesError
        If no mode is stable.
    InputError
        If a file or an option cannot be used.
    """
    return read_and_identify(Path(path), options or ModesOptions(), read, geometry, alone=True)


def read_and_identify(
    path: Path, options: ModesOptions, read: ReadOptions | None, geometry: str | Path | None, alone: bool
) -> ModesResult:
    """Modes of the record in the file at `path`, read by `read`, prepared and identified by `options`.

    Columns without names are numbered 1X+, 2X+, ... if it stands `alone`, that is, if no other set-up is merged with
    it; else they raise `UnnamedChannelsError`. Stored spectra and correlation functions are recognized. None for `read`
    takes the defaults. `geometry` is a file of node positions, or None for those that a universal file holds itself.

    Raises
    ------
    NoModesError
        If no mode is stable.
    InputError
        If a file or an option cannot be used.
    """
    read = read or ReadOptions()
    if read.kind in (SPECTRUM, CORRELATION):
        return _modes_of_averages(path, options, read, geometry, read.kind)
    try:
        record, read, numbered = _read_or_number_columns(path, read, alone)
    except StoredSpectraError as error:
        return _modes_of_averages(path, options, read, geometry, error.kind)
    places = record_geometry(path, record, None if geometry is None else Path(geometry))
    ready, steps, findings, tones = _prepare_record(record, options)
    understood = how_read(record.source, path)
    steps = (f"read: {understood}", *steps) if understood else steps
    looked_at, motions = shared_or_whole(ready)
    identification, more = _identify_at_rates(looked_at, options)
    spectra = mode_spectra(looked_at)
    identification = _with_unexplained_peaks(identification, spectra)
    kurtosis = _tone_kurtosis(looked_at, identification)
    if motions is not None and isinstance(ready, TimeRecord):
        identification = at_all_channels(identification, motions, ready.channels)
    if options.window is not None and isinstance(ready, TimeRecord):
        modes = without_window_damping(identification.modes, 1 / options.window)
        identification = replace(identification, modes=modes)
    return ModesResult(
        title=path.name,
        record=ready,
        identification=identification,
        spectra=spectra,
        geometry=places,
        provenance=modes_provenance((path, geometry), options, read),
        steps=(*numbered, *steps, *more, *_unit_of_length(places)),
        findings=findings,
        options=options,
        kurtosis=kurtosis,
        tones=tones,
    )


def _modes_of_averages(
    path: Path, options: ModesOptions, read: ReadOptions, geometry: str | Path | None, kind: str
) -> ModesResult:
    """Modes of the stored spectra or correlation functions in a file; `kind` is "spectrum" or "correlation".

    `options` are those of the identification, `read` those of reading. `geometry` is a file of node positions, or None
    for those that a universal file holds itself. Raises `InputError` if an option is set that the method does not use,
    `NoModesError` if no mode is found.
    """
    record = read_spectrum(path, read) if kind == SPECTRUM else read_correlation(path, read)
    is_subspace = kind == CORRELATION and options.method in (None, "ssi_cov")
    words = "stored spectra" if kind == SPECTRUM else "stored correlation functions"
    unused: tuple[str, ...] = ("rate", "deviation", "remove_tones")
    unused += () if is_subspace else ("orders", "damping")
    for name in (*unused, *(("window",) if kind == SPECTRUM else ())):
        if getattr(options, name) is not None:
            raise InputError(f"`{name}` is not about modes of {words} by this method; leave it out", name)
    identification = modal_identification(record, options.method, options.modal)
    if options.window is not None:
        modes = without_window_damping(identification.modes, 1 / options.window)
        identification = replace(identification, modes=modes)
    _, spectrum = stored_spectrum(record)
    places = record_geometry(path, record, None if geometry is None else Path(geometry))
    understood = how_read(record.source, path)
    return ModesResult(
        title=path.name,
        record=record,
        identification=identification,
        spectra=ModeSpectra(
            spectrum.frequency, spectrum.values, f"singular values of the {words}, channels scaled", "1"
        ),
        geometry=places,
        provenance=modes_provenance((path, geometry), options, read),
        steps=(*((f"read: {understood}",) if understood else ()), *_unit_of_length(places)),
        options=options,
        kurtosis=np.full(identification.modes.n_modes, np.nan),
    )


def _read_or_number_columns(path: Path, read: ReadOptions, alone: bool) -> tuple[Record, ReadOptions, tuple[str, ...]]:
    """Record read from `path`, the read options used, and words on numbered channels (empty if they are named).

    Columns without names are numbered 1X+, 2X+, ... if `alone`; else `UnnamedChannelsError` is raised.
    """
    try:
        return read_record(path, read), read, ()
    except UnnamedChannelsError as error:
        if not alone:
            raise
        numbered = replace(read, channels=tuple(f"{i}X+" for i in range(1, error.count + 1)))
    words = f"channels numbered by their columns, 1X+ to {len(numbered.channels)}X+, since nothing names them"
    return read_record(path, numbered), numbered, (words,)


def _prepare_record(
    record: Record, options: ModesOptions
) -> tuple[Record, tuple[str, ...], tuple[Finding, ...], tuple[Tone, ...]]:
    """Record prepared for identification, words on the steps, findings on doubtful signals, and tones removed.

    FRFs are only cut to `options.band` and given the decay of an exponential window; findings and tones are then empty.
    Raises `InputError` for options that do not suit FRFs, or frequencies above half the sampling rate.
    """
    steps: list[str] = []
    if options.window is not None:
        steps.append(f"damping of an exponential window of {options.window:g} s taken off the modes")
    if isinstance(record, FrfRecord):
        for name, remedy in (("rate", "leave it out, or give `band`"), ("remove_tones", "leave it out")):
            if getattr(options, name) is not None:
                raise InputError(f"`{name}` is for time histories, but the record holds FRFs; {remedy}")
        kept = record if options.band is None else record.band(*options.band)
        if options.band is not None:
            low, high = options.band
            steps.append(f"{len(kept.frequency)} of {len(record.frequency)} lines kept, {low:g}-{high:g} Hz")
        if options.window is not None:
            kept = replace(kept, decay=np.full(len(kept.frequency), 1 / options.window))
        return kept, tuple(steps), (), ()
    _require_below_nyquist(record, options)
    wanted = Preparation(options.detrend, sampling_rate=rate_for(record, options), remove_tones=options.remove_tones)
    ready = prepare(record, wanted)
    return ready.record, (*ready.steps, *steps), ready.findings, ready.tones


def shared_or_whole(record: Record) -> tuple[Record, SharedMotions | None]:
    """Record reduced to at most 40 motions that its channels share, and these motions; else the record itself and None.

    Reduced are time records of more than 200 channels, or of more channels than samples.

    Raises
    ------
    InputError
        If such a record holds more than one quantity.
    """
    if not isinstance(record, TimeRecord) or len(record.channels) <= min(_MANY_CHANNELS, len(record.values)):
        return record, None
    quantity = record.quantities[0]
    if set(record.quantities) != {quantity}:
        kinds = ", ".join(dict.fromkeys(record.quantities))
        raise InputError(
            f"{len(record.channels)} channels must be of one quantity, got {kinds}; choose with `channels`"
        )
    motions = shared_motions(record.values, min(_SHARED, *record.values.shape))
    return motions.record(record.sampling_rate, quantity), motions


def _require_below_nyquist(record: TimeRecord, options: ModesOptions) -> None:
    """Raise `InputError` if `band` or `frequencies` of `options` reach half the sampling rate that will be used.

    That is the rate of `record`, or `options.rate` if it is lower.
    """
    highest = max([*(options.band or ())[1:], *(options.frequencies or ())], default=0.0)
    rate = record.sampling_rate if options.rate is None else min(options.rate, record.sampling_rate)
    if highest >= rate / 2:
        raise InputError(
            f"modes up to {highest:g} Hz need a sampling rate above {2.5 * highest:g} Hz, got {rate:g} Hz; "
            "lower the band, or measure faster"
        )


def rate_for(record: TimeRecord, options: ModesOptions) -> float | None:
    """Sampling rate (Hz) to decimate to: `options.rate`, else about 4 times the highest frequency wanted.

    That is the highest of `options.band` and `options.frequencies`; at least about 500 samples of `record` are left.
    None, to keep the record's rate, without these, or if not even every second sample can be spared.
    """
    if options.rate is not None:
        return options.rate
    highest = max([*(options.band or ())[1:], *(options.frequencies or ())], default=None)
    if highest is None:
        return None
    factor = min(int(record.sampling_rate / (_RATE_OVER_BAND * highest)), len(record.values) // _FEWEST_SAMPLES)
    return record.sampling_rate / factor if factor > 1 else None


def _identify_at_rates(record: Record, options: ModesOptions) -> tuple[ModalIdentification, tuple[str, ...]]:
    """Modes of the record, joined from its own and lower sampling rates, and words on the latter (() if none is used).

    Lower rates are tried only for time records, where no method, rate, band or frequencies are set. They are joined at
    a frequency far from modes of both; `NoModesError` if no rate shows a mode.
    """
    settings = options.modal
    asked = (options.method, options.rate, options.band, options.frequencies)
    if isinstance(record, FrfRecord) or any(given is not None for given in asked):
        return modal_identification(record, options.method, settings), ()
    best: ModalIdentification | None = None
    steps: list[str] = []
    try:
        best = modal_identification(record, None, settings)
    except NoModesError:
        if not look_rates(record):
            raise
    for rate in look_rates(record) if best is None or best.sweep else ():
        slow = prepare(record, Preparation(detrend="none", sampling_rate=rate))
        try:
            low = modal_identification(slow.record, None, settings)
        except NoModesError:
            continue
        if best is None:
            best = low
            steps += slow.steps
            continue
        split = join_frequency(low.modes, best.modes, rate)
        steps.append(f"modes below {split:.4g} Hz from a further look, the surer of both: {'; '.join(slow.steps)}")
        best = joined(low, best, split, FLAT * rate)
    return (modal_identification(record, None, settings) if best is None else best), tuple(steps)


def _with_unexplained_peaks(identification: ModalIdentification, spectra: ModeSpectra) -> ModalIdentification:
    """Identification with a warning on spectral peaks inside the frequency limits that no mode explains, if any.

    It is returned unchanged where `frequencies` were asked for. `spectra` have the first singular value at each line.
    """
    low, high = identification.options.criteria.frequency
    level = spectra.values[:, 0] if spectra.is_power else spectra.values[:, 0] ** 2
    peaks = unexplained_peaks(spectra.frequency, level, identification.modes)
    peaks = peaks[(peaks >= low) & (peaks <= high)]
    if not len(peaks) or identification.options.frequencies is not None:
        return identification
    words = (
        f"the first singular value of the spectra peaks at {', '.join(f'{f:.4g}' for f in peaks[:_MOST_PEAKS])} Hz"
        f"{' and elsewhere' if len(peaks) > _MOST_PEAKS else ''}, where no mode was found: look at the spectrum, and ask for"
        f" {'it' if len(peaks) == 1 else 'these'} by `frequencies`, or in a narrower band"
    )
    modes = identification.modes
    return replace(identification, modes=replace(modes, warnings=(*modes.warnings, words)))


def _tone_kurtosis(record: Record, identification: ModalIdentification) -> FloatArray:
    """Median kurtosis over channels of narrow-band motion at each mode, (n_modes,): 1.5 for a tone, 3 if random.

    The motion is that of `record` at the modes of `identification`. NaN for FRFs, for damping ratios of 0.001 and more,
    for modes of a free decay whose damping is significant (no tone dies out), and for frequencies above 0.8 of half the
    sampling rate.
    """
    modes = identification.modes
    kurtosis = np.full(modes.n_modes, np.nan)
    if not isinstance(record, TimeRecord):
        return kurtosis
    suspect = (modes.damping_ratio < HARDLY_DAMPED) & ~dies_out(identification)
    for k in np.flatnonzero(suspect):
        f = float(modes.frequency[k])
        if f > 0 and 1.25 * f < record.sampling_rate / 2:
            kurtosis[k] = np.nanmedian(harmonic_indicator(record, f))
    return kurtosis


def dies_out(identification: ModalIdentification) -> NDArray[np.bool_]:
    """Mask (n_modes,) of modes of a free decay whose damping ratio exceeds 0 significantly; all false otherwise.

    Significant is more than `NOT_TOLD_APART` standard deviations.
    """
    modes = identification.modes
    damping_std = modes.std[modes.n_modes :]
    return np.asarray(identification.is_free_decay & (modes.damping_ratio > NOT_TOLD_APART * damping_std))


def mode_spectra(record: Record) -> ModeSpectra:
    """Singular values, greatest first, of the spectral matrix of a time record, or of the FRF matrix, for every line.

    The singular values are (n_lines, n_values). Those of a time record are powers in 1/Hz of channels scaled to a root
    mean square of 1, without the line at 0 Hz; those of FRFs are in the unit of the record.
    """
    if isinstance(record, FrfRecord):
        values = np.linalg.svd(record.values, compute_uv=False)
        return ModeSpectra(record.frequency, values, "singular values of the FRF matrix", record.unit, is_power=False)
    n = len(record.values)
    segment = min(n, 2 ** int(np.log2(np.clip(n // _SEGMENTS, _SHORTEST_SEGMENT, _LONGEST_SEGMENT))))
    found = singular_spectrum(outputs(record), segment)
    name = "singular values of the spectral matrix, channels scaled to equal power"
    return ModeSpectra(found.frequency[1:], found.values[1:], name, "1/Hz")


def modes_provenance(paths: Sequence[str | Path | None], options: ModesOptions, read: ReadOptions | None) -> Provenance:
    inputs = {Path(path).name: digest(path) for path in paths if path is not None}
    given: dict[str, object] = {} if read is None else {name: getattr(read, name) for name in read.given()}
    return Provenance(
        structid=__version__, numpy=np.__version__, scipy=scipy.__version__, python=platform.python_version(),
        inputs=inputs, seed=None, settings={**asdict(options), **given},
    )  # fmt: skip


def record_geometry(
    path: Path, record: Record | SpectrumRecord | CorrelationRecord, given: Path | None
) -> Geometry | None:
    """Geometry from the file `given`, else from a universal file's own nodes; None if there is none.

    The file's own is passed over (None) where it lacks a node with a sensor.

    Raises
    ------
    FileError
        If a geometry file is damaged.
    InputError
        If the file `given` lacks a node with a sensor.
    """
    if given is None:
        own = path.suffix.lower() in UFF.SUFFIXES and any(dataset_lines(path, number) for number in (15, 2411))
        found = read_geometry(path) if own else None
        return found if found is not None and not _missing(record, found) else None
    geometry = read_geometry(given)
    missing = _missing(record, geometry)
    if missing:
        known = ", ".join(str(node) for node in list(geometry.nodes)[:12])
        raise InputError(
            f"{given}: has no node {missing[0].node}, where {missing[0]} is measured; its nodes are {known}"
        )
    return geometry


def _unit_of_length(geometry: Geometry | None) -> tuple[str, ...]:
    """Words on the positions where their file says no unit of length, which modes.uff takes as m; else none."""
    if geometry is None or geometry.has_unit:
        return ()
    return (f"{geometry.unit_words} So modes.uff says m; where they are in mm or ft, give `geometry` as a table in m",)


def _missing(record: Record | SpectrumRecord | CorrelationRecord, geometry: Geometry) -> list[Dof]:
    """Sensors at nodes that have no position."""
    sensors = record.outputs if isinstance(record, FrfRecord) else record.channels
    return [dof for dof in sensors if dof.node not in geometry.nodes]
