"""Modes from any record, with their covariance: one door for all methods."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np

from structid.core.errors import InputError, require_class
from structid.modal.frf.lscf_modes import lscf
from structid.modal.method import ModalIdentification, ModalOptions
from structid.modal.modal_record import ModalRecord
from structid.modal.spectral.bayesian_fft import bayesian_fft
from structid.modal.spectral.fdd import efdd, fdd
from structid.modal.subspace.stored_correlations import correlation_modes
from structid.modal.subspace.subspace_modes import SUBSPACE_METHODS, subspace_modes
from structid.records import FrfRecord, TimeRecord
from structid.records.stored_averages import CorrelationRecord, SpectrumRecord

Records = TimeRecord | Sequence[TimeRecord] | FrfRecord | SpectrumRecord | CorrelationRecord


@dataclass(frozen=True)
class Method:
    """One method: what finds the modes, and whether in FRFs or in time records."""

    identify: Callable[[Any, ModalOptions], ModalIdentification]
    of_frfs: bool = False


#: All methods by name, the default of either kind of record first.
METHODS: dict[str, Method] = {
    **{name: Method(partial(subspace_modes, method=name)) for name in SUBSPACE_METHODS},
    "fdd": Method(fdd),
    "bayesian_fft": Method(bayesian_fft),
    "lscf": Method(lscf, of_frfs=True),
}
#: Relative rounding of a frequency.
_ROUNDING = 1e-9
#: Methods of spectra and of correlation functions that another program averaged, the defaults first.
SPECTRUM_METHODS: dict[str, Callable[..., ModalIdentification]] = {"efdd": efdd, "fdd": fdd}
CORRELATION_METHODS: dict[str, Callable[..., ModalIdentification]] = {
    "ssi_cov": correlation_modes,
    "efdd": efdd,
    "fdd": fdd,
}
_GONE = {
    "efdd": "bayesian_fft, whose errors and intervals are better, in close modes too; efdd is for stored spectra alone",
    "era": "pencil, which is ERA with data correlations, ends with maximum likelihood and has half the error",
    "era_dc": "pencil, which is the same",
    "itd": "pencil, which has half the error and needs no more",
    "next_era": "ssi_cov or pencil, which take the same correlations, find more modes and give their uncertainty",
}


def identify_modes(
    records: Records, method: str | None = None, *, options: ModalOptions | None = None, **settings: Any
) -> ModalRecord:
    """Frequencies, damping ratios and mode shapes of free motion, ambient motion or FRFs, with covariance.

    Parameters
    ----------
    records : TimeRecord, sequence of them, FrfRecord, SpectrumRecord or CorrelationRecord
        Any mixture of displacement, velocity and acceleration; forces are left out. Channels, quantities and
        sampling rates agree between records. Records excited in different ways separate repeated modes.
    method : str, optional
        By default ``pencil`` for time records, which serves free and ambient motion alike, and ``lscf`` for FRFs.
        ``ssi_cov`` and ``ssi_data`` are for ambient motion, and ``fdd`` (no damping) and ``bayesian_fft`` for its
        spectra. A `SpectrumRecord` takes ``efdd`` (its default) or ``fdd``, a `CorrelationRecord` ``ssi_cov`` (its
        default), ``efdd`` or ``fdd``.
    options : ModalOptions, optional
    **settings
        Fields of `ModalOptions` in place of `options`, as in ``orders=[4]``.

    Returns
    -------
    ModalRecord
        Complex mode shapes with largest entry 1, one row a degree of freedom, as displacement where quantities are
        mixed; of modal mass 1 for ``lscf`` with a driving point.

    Raises
    ------
    InputError
        If records do not fit together or to the method, a channel is dead, or the record is too short.
    NoModesError
        If no mode can be relied on.

    Notes
    -----
    Covariances are of first order and hold no bias. In ambient motion they come from pieces of the record, batches of
    which must be long against the memory of the slowest mode, 1 / (zeta omega). Free decays are refined by ``pencil``
    (`decay_fit`), with the covariance of that; for other methods it comes from the noise that the decay leaves (about
    twice too wide for ``ssi_data``). For ``lscf`` see `lscf`.

    References
    ----------
    See `poles.stabilization`, `subspace.methods` and `subspace.pole_uncertainty` in this package.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.arange(400)[:, None] * 0.05
    >>> both = np.exp(-0.02 * t) * (np.cos(2 * t) * [[1.0, 1.0]] + np.cos(5 * t) * [[1.0, -1.0]])
    >>> record = TimeRecord(20.0, both, ("1Z", "2Z"), ("displacement",) * 2)
    >>> identify_modes(record, orders=[4]).omega.round(4).tolist()
    [2.0001, 5.0]
    """
    if method is not None:
        require_class("method", method, str, f"it is one of {', '.join(METHODS)}; settings follow by their names")
    have = [each.name for each in fields(ModalOptions)]
    for name in settings:
        if name not in have:
            raise InputError(f"`{name}` is no setting of `identify_modes`; there are {', '.join(have)}")
    return modal_identification(records, method, replace(options or ModalOptions(), **settings)).modes


def modal_identification(
    records: Records, method: str | None = None, options: ModalOptions | None = None
) -> ModalIdentification:
    """Modes of records by `method`, with the poles of all model orders and their clusters where the method has them.

    `method` None is ``pencil`` for time records, ``lscf`` for FRFs, ``efdd`` for spectra and ``ssi_cov`` for
    correlation functions. Modes with a relative standard deviation of frequency above `options.deviation`, where that
    is set, go to `left_out`. None for `options` takes the defaults.

    Raises
    ------
    InputError
        If `records` are empty or of another class, the method does not exist or does not suit them, or a frequency
        asked for lies above half the sampling rate, or the last line of stored spectra.
    NoModesError
        If no mode can be relied on.
    """
    options = options or ModalOptions()
    of_frfs = isinstance(records, FrfRecord)
    if isinstance(records, SpectrumRecord | CorrelationRecord):
        is_spectra = isinstance(records, SpectrumRecord)
        methods, words = (SPECTRUM_METHODS, "spectra") if is_spectra else (CORRELATION_METHODS, "correlation functions")
        if method is not None and method not in methods:
            raise InputError(
                f"`method` must be {' or '.join(methods)} for stored {words}, got {method!r}, which needs histories or FRFs"
            )
        _require_measured(records, options)
        return _without_uncertain_modes(methods[method or next(iter(methods))](records, options), options)
    if method is None:
        method = next(name for name, known in METHODS.items() if known.of_frfs == of_frfs)
    if method in _GONE:
        raise InputError(f"`method` {method!r} is gone; use {_GONE[method]}")
    if method not in METHODS:
        raise InputError(f"`method` must be one of {', '.join(METHODS)}, got {method!r}")
    if METHODS[method].of_frfs and not of_frfs:
        raise InputError(
            f"method {method!r} needs FRFs, got time records; compute them with frf_from_time, which needs a force "
            "channel, or use pencil or ssi_cov, which need none"
        )
    if of_frfs and not METHODS[method].of_frfs:
        suits = " or ".join(name for name, known in METHODS.items() if known.of_frfs)
        raise InputError(f"`method` must be {suits} for an FrfRecord, got {method!r}, which needs time records")
    if not isinstance(records, FrfRecord):
        if not isinstance(records, TimeRecord | Sequence):
            raise InputError(
                f"`records` must be one or more records, got {type(records).__name__}; read them from a file, or take the"
                " `record` of what `remove_tones` gives"
            )
        _require_measured(records, options)
    return _without_uncertain_modes(METHODS[method].identify(records, options), options)


def _without_uncertain_modes(found: ModalIdentification, options: ModalOptions) -> ModalIdentification:
    """Identification without modes whose frequency has a standard deviation above `options.deviation` of itself.

    These go to `left_out`, with a warning. It is returned as it is where `deviation` is None; modes with an unknown
    standard deviation stay. `NoModesError` if none is left.
    """
    if options.deviation is None:
        return found
    uncertain = found.modes.frequency_std > options.deviation * found.modes.frequency
    words = f"modes with a standard deviation of frequency above {100 * options.deviation:g} % of it"
    return found.kept(~uncertain, words)


def _require_measured(
    records: TimeRecord | Sequence[TimeRecord] | SpectrumRecord | CorrelationRecord, options: ModalOptions
) -> None:
    """Raise `InputError` if a limit, frequency or band of `options` exceeds the highest frequency of the records.

    That is half the lowest sampling rate of histories or correlation functions. Of spectra it is one line after the last,
    which programs that write no line at half the rate leave out.
    """
    if isinstance(records, SpectrumRecord):
        first, last = float(records.frequency[0]), float(records.frequency[-1])
        limit, words = last + (last - first) / (len(records.frequency) - 1), "one line after the last of the spectra"
    else:
        given = (records,) if isinstance(records, TimeRecord | CorrelationRecord) else tuple(records)
        rates = [r.sampling_rate for r in given if isinstance(r, TimeRecord | CorrelationRecord)]
        limit, words = min(rates, default=np.inf) / 2, "half the sampling rate"
    bands = [f for band in (() if options.bands is None else options.bands) for f in band]
    named = () if options.frequencies is None else options.frequencies
    asked = [f for f in (*options.criteria.frequency, *named, *bands) if np.isfinite(f)]
    if max(asked, default=0.0) > limit * (1 + _ROUNDING):
        raise InputError(
            f"frequencies asked for must be at most {limit:g} Hz, {words}, got {max(asked):g} Hz; lower `criteria`,"
            " `frequencies` or `bands`, or measure faster"
        )
