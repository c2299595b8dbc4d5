"""Modes from any record, with their covariance: one door for all methods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from structid.errors import InputError
from structid.modal.frf.modes import lscf
from structid.modal.method import ModalIdentification, ModalOptions
from structid.modal.modal_record import ModalRecord
from structid.modal.poles import HardCriteria
from structid.modal.spectral.bayesian_fft import bayesian_fft
from structid.modal.spectral.efdd import efdd
from structid.modal.spectral.fdd import fdd_modes
from structid.modal.subspace.modes import SUBSPACE_METHODS, subspace_modes
from structid.modal.subspace.natural_excitation import natural_excitation
from structid.records import FrfRecord, TimeRecord

#: Methods for frequency response functions; all others take time records.
FRF_METHODS: tuple[str, ...] = ("lscf",)
#: Methods for ambient motion that look at its spectra.
SPECTRAL_METHODS = {"fdd": fdd_modes, "efdd": efdd, "bayesian_fft": bayesian_fft}
#: Names of all methods.
METHODS: tuple[str, ...] = (*SUBSPACE_METHODS, "next_era", *SPECTRAL_METHODS, *FRF_METHODS)
_NO_COVARIANCE = "no covariance: errors of correlation functions gather at the modes; ssi_cov and pencil give it"


def identify_modes(
    records: TimeRecord | Sequence[TimeRecord] | FrfRecord,
    method: str | None = None,
    orders: Sequence[int] | None = None,
    block_rows: int | None = None,
    criteria: HardCriteria | None = None,
    frequencies: Sequence[float] | None = None,
    n_pieces: int = 40,
    segment: int | None = None,
    bands: Sequence[tuple[float, float]] | None = None,
) -> ModalRecord:
    """Frequencies, damping ratios and mode shapes of free motion, ambient motion or FRFs, with covariance.

    Parameters
    ----------
    records : TimeRecord, sequence of them, or FrfRecord
        Any mixture of displacement, velocity and acceleration; forces are left out. Channels, quantities and
        sampling rates agree between records. Records excited in different ways separate repeated modes.
    method : str, optional
        By default ``pencil`` for time records, which serves free and ambient motion alike, and ``lscf`` for FRFs.
        ``era``, ``era_dc`` and ``itd`` are for free decays, ``ssi_cov`` and ``ssi_data`` for ambient motion, and
        ``next_era`` for ERA of its correlations (`natural_excitation`), ``fdd`` (no damping), ``efdd`` and
        ``bayesian_fft`` (close modes too) for its spectra.
    orders : sequence of int, optional
        Numbers of states to try; by default 2, 4, ... as far as channels and delays have room, at most 60. One
        order only gives all its poles that meet `criteria`.
    block_rows : int, optional
        Delays on either side; by default 30, less for short records, more for few channels.
    criteria : HardCriteria, optional
        What poles must meet; by default a damping ratio from -1 % to 20 %.
    frequencies : sequence of float, optional
        Hz: the modes wanted, by hand. Each takes the nearest cluster of stable poles.
    n_pieces : int
        Pieces the record is cut into for the covariance; 0 or 1 for none.
    segment, bands : optional
        See `ModalOptions`; for ``fdd``, ``efdd`` and ``bayesian_fft``, and the bands also for ``lscf``.

    Returns
    -------
    ModalRecord
        Complex mode shapes with largest entry 1, one row a degree of freedom, as displacement where quantities are
        mixed; of modal mass 1 for ``lscf`` with a driving point.

    Raises
    ------
    InputError
        If records do not fit together or to the method, a channel is dead, or the record is too short.

    Notes
    -----
    Covariances are of first order and hold no bias. In ambient motion they come from pieces of the record, batches of
    which must be long against the memory of the slowest mode, 1 / (zeta omega). Free decays are refined by ``pencil``
    (`decay_fit`), with the covariance of that; for other methods it comes from the noise that the decay leaves (about
    twice too wide for ``ssi_data``), and there is none for ``era`` and ``itd`` of other motion. For ``lscf`` see `lscf`.

    References
    ----------
    See `pencil`, `era`, `ssi_cov`, `stabilization` and `pole_uncertainty` in this package.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.arange(400)[:, None] * 0.05
    >>> both = np.exp(-0.02 * t) * (np.cos(2 * t) * [[1.0, 1.0]] + np.cos(5 * t) * [[1.0, -1.0]])
    >>> record = TimeRecord(20.0, both, ("1Z", "2Z"), ("displacement",) * 2)
    >>> identify_modes(record, orders=[4]).omega.round(4).tolist()
    [2.0001, 5.0]
    """
    options = ModalOptions(orders, block_rows, criteria or HardCriteria(), frequencies, n_pieces, segment, bands)
    return modal_identification(records, method, options).modes


def modal_identification(
    records: TimeRecord | Sequence[TimeRecord] | FrfRecord,
    method: str | None = None,
    options: ModalOptions | None = None,
) -> ModalIdentification:
    """As `identify_modes`, with the poles of all orders and their clusters, for a stabilization diagram.

    Raises
    ------
    InputError
        If `method` is unknown or does not suit the kind of record, and as `identify_modes` does.
    """
    options = options or ModalOptions()
    if method is None:
        method = "lscf" if isinstance(records, FrfRecord) else "pencil"
    if method not in METHODS:
        raise InputError(f"`method` must be one of {', '.join(METHODS)}, got {method!r}")
    if isinstance(records, FrfRecord):
        if method not in FRF_METHODS:
            raise InputError(
                f"`method` must be {' or '.join(FRF_METHODS)} for an FrfRecord, got {method!r}, which needs time records"
            )
        return lscf(records, options)
    if method in FRF_METHODS:
        raise InputError(
            f"method {method!r} needs FRFs, got time records; compute them with frf_from_time, which needs a force "
            "channel, or use pencil or ssi_cov, which need none"
        )
    _require_below_nyquist(records, options)
    if method in SPECTRAL_METHODS:
        return SPECTRAL_METHODS[method](records, options)
    if method == "next_era":
        found = subspace_modes(natural_excitation(records), "era", options)
        notes = found.modes.warnings if found.modes.covariance is not None else (*found.modes.warnings, _NO_COVARIANCE)
        return replace(found, modes=replace(found.modes, warnings=notes), method=method)
    return subspace_modes(records, method, options)


def _require_below_nyquist(records: TimeRecord | Sequence[TimeRecord], options: ModalOptions) -> None:
    """Refuse frequencies that the records cannot hold."""
    given = (records,) if isinstance(records, TimeRecord) else tuple(records)
    limit = min((r.sampling_rate / 2 for r in given if isinstance(r, TimeRecord)), default=np.inf)
    bands = [f for band in options.bands or () for f in band]
    asked = [f for f in (*options.criteria.frequency, *(options.frequencies or ()), *bands) if np.isfinite(f)]
    if max(asked, default=0.0) > limit:
        raise InputError(
            f"frequencies asked for must be at most {limit:g} Hz, half the sampling rate, got {max(asked):g} Hz; lower "
            "`criteria`, `frequencies` or `bands`, or measure faster"
        )
