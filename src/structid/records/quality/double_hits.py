"""Double hits: a hammer that strikes twice, whose force has gaps in its spectrum."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from structid.core.arrays import FloatArray
from structid.records.quality.findings import Finding, channel_name
from structid.records.record import TimeRecord

#: Force over its peak from which on it is a blow; part of the record beyond which the force is none of a hammer.
_BLOW, _MOST_OF_RECORD = 0.1, 0.1
#: Durations of contact within which a second blow belongs to the first: blows that are meant are farther apart.
_CLOSE = 50.0


def double_hit(record: TimeRecord, index: int) -> Finding | None:
    """Finding on the first blow of a force channel that another follows closely; None if there is none.

    Parameters
    ----------
    record : TimeRecord
    index : int
        Column of the force channel, from 0.
    """
    force = np.abs(record.values[:, index])
    for (first, last), (second, end) in pairwise(_blows(force)):
        contact = max(last - first, end - second) + 1
        peaks = [start + int(np.argmax(force[start : stop + 1])) for start, stop in ((first, last), (second, end))]
        gap, sizes = (peaks[1] - peaks[0]) / record.sampling_rate, force[peaks].tolist()
        if second - first < _CLOSE * contact:
            name = channel_name(record, index)
            words = (
                f"channel {name} hits twice within {gap:.3g} s, at sample {first} and with {100 * sizes[1] / sizes[0]:.0f} % of"
                f" that force after it: its spectrum has gaps every {1 / gap:.3g} Hz, where FRFs are noise; leave this blow out"
            )
            return Finding("double_hit", words, "warning", name)
    return None


def _blows(force: FloatArray) -> list[tuple[int, int]]:
    """First and last sample of each hammer blow in `force` (n_times,), the magnitude of a force channel.

    Empty if the force is large for too much of the record, as that of a shaker.
    """
    loud = np.flatnonzero(force > _BLOW * force.max())
    if not 0 < len(loud) <= _MOST_OF_RECORD * len(force):
        return []
    blows = [[int(loud[0]), int(loud[0])]]
    for sample in loud[1:].tolist():
        length = blows[-1][1] - blows[-1][0] + 1
        if sample - blows[-1][1] <= 2 * length:  # it rings, or dips in between
            blows[-1][1] = sample
        else:
            blows.append([sample, sample])
    return [(first, last) for first, last in blows]
