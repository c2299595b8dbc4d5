"""Free decays from ambient motion: correlations of all outputs with reference channels (NExT).

Under white forces E[y_i(t + tau) y_r(t)] for tau > 0 is a free decay with the poles and shapes of the structure, in which
outputs i take the place of sensors and each reference r that of a start. Noise that is white and on one channel only
enters at tau = 0, which is left out.

References
----------
James, Carne and Lauffer (1993), The natural excitation technique (NExT) for modal parameter extraction from operating
wind turbines, Sandia report SAND92-1666, Eq. (14); Bartlett (1946), On the theoretical specification and sampling
properties of autocorrelated time-series, J. R. Stat. Soc. Suppl. 8, 27-41.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from structid.arrays import FloatArray
from structid.dof import Dof, parse_dofs
from structid.errors import InputError
from structid.modal.correlations import Outputs, outputs, require_length
from structid.records import TimeRecord

_LEAST_LAGS = 64
_LONGEST_PART = 8  # of the shortest record: correlations of longer lags rest on too little independent motion
_BLOCK = 16
_STANDING_OUT = 20.0  # signal over error, in power; longer decays bring poles that are error only


def natural_excitation(
    records: TimeRecord | Sequence[TimeRecord],
    n_lags: int | None = None,
    references: Iterable[str | Dof] | None = None,
) -> tuple[TimeRecord, ...]:
    """Free-decay records, one for each reference, from ambient motion.

    Parameters
    ----------
    records : TimeRecord or sequence of them
        Displacement, velocity or acceleration under forces without marked frequencies, which need not be measured;
        forces are left out. Several records are averaged.
    n_lags : int, optional
        Samples of each decay. By default as long as correlations stand out of their random error, at least 64 and at
        most an eighth of the shortest record.
    references : iterable of str or Dof, optional
        Channels that stand for the start; by default all. Those that move in every mode, and have little noise, serve
        best. All quantities measured at such a place count.

    Returns
    -------
    tuple of TimeRecord
        E[y_i(t + tau) y_r(t)] at tau from one sample on, its `start`. Each channel keeps its quantity, since
        derivatives of y_i are derivatives of the decay; the values are those of the channel times the unit of the
        reference, so that shapes and ratios between channels are right, while the size of each record is not a motion.

    Raises
    ------
    InputError
        If records do not fit together or are too short, or a reference is no channel.

    Examples
    --------
    >>> import numpy as np
    >>> motion = np.tile([[1.0], [0.0], [-1.0], [0.0]], (64, 1))
    >>> decay = natural_excitation(TimeRecord(4.0, motion, ("1Z",), ("velocity",)), n_lags=4)[0]
    >>> np.abs(decay.values[:, 0].round(3)).tolist(), decay.start
    ([0.0, 0.5, 0.0, 0.5], 0.25)
    """
    data = outputs(records)
    chosen = _references(data, references)
    shortest = min(len(y) for y in data.series)
    longest = max(shortest // _LONGEST_PART, 1) if n_lags is None else n_lags
    if longest < 2:
        raise InputError(f"`n_lags` must be at least 2, got {longest}; lengthen the record or raise it")
    require_length(data, longest, 0)
    found = _correlations(data, longest, chosen)
    if n_lags is None:
        found = found[: _standing_out(data, found, chosen) + 1]
    first = records if isinstance(records, TimeRecord) else records[0]
    source = f"correlations with {{}} of {first.source or 'the record'}"
    return tuple(
        TimeRecord(
            data.sampling_rate, found[1:, :, k] * data.scale * data.scale[r], data.channels, data.quantities,
            start=1 / data.sampling_rate, source=source.format(f"{data.quantities[r]} {data.channels[r]}"),
        )
        for k, r in enumerate(chosen)
    )  # fmt: skip


def _references(data: Outputs, given: Iterable[str | Dof] | None) -> list[int]:
    if given is None:
        return list(range(data.n_channels))
    wanted = parse_dofs([given] if isinstance(given, str | Dof) else given)
    for dof in wanted:
        if dof not in data.channels:
            listed = ", ".join(map(str, dict.fromkeys(data.channels)))
            raise InputError(f"`references` must be among the channels {listed}, got {dof}; name one of them")
    if not wanted:
        raise InputError("`references` must name at least one channel, got none; leave it out for all")
    return [i for i, channel in enumerate(data.channels) if channel in wanted]


def _correlations(data: Outputs, n_lags: int, references: Sequence[int]) -> FloatArray:
    """R_k, k = 0 .. n_lags, of the scaled channels with the references, (n_lags + 1, n_channels, n_references)."""
    total = np.zeros((n_lags + 1, data.n_channels, len(references)))
    lag = np.arange(n_lags + 1)
    for y in data.series:
        length = 1 << int(len(y) + n_lags).bit_length()
        lines = np.fft.rfft(y, length, axis=0)
        for k, r in enumerate(references):
            total[:, :, k] += np.fft.irfft(lines * lines[:, r, None].conj(), length, axis=0)[: n_lags + 1]
    pairs = np.sum([len(y) - lag for y in data.series], axis=0)
    return np.asarray(total / pairs[:, None, None])


def _standing_out(data: Outputs, found: FloatArray, references: Sequence[int]) -> int:
    """Lags before the correlations of the references with themselves first sink into their random error.

    Bartlett's variance at long lags, the sum of all squared correlations over the number of samples, against the mean
    square over 16 lags.
    """
    own = np.mean([found[:, r, k] ** 2 for k, r in enumerate(references)], axis=0)
    n_samples = sum(len(y) for y in data.series)
    error = (own[0] + 2 * np.sum(own[1:])) / n_samples
    n_blocks = max((len(own) - 1) // _BLOCK, 1)
    blocks = own[1 : 1 + n_blocks * _BLOCK].reshape(n_blocks, -1).mean(axis=1)
    below = np.flatnonzero(blocks < _STANDING_OUT * error)
    stop = _BLOCK * int(below[0]) if len(below) else len(own) - 1
    return min(max(stop, _LEAST_LAGS), len(own) - 1)
