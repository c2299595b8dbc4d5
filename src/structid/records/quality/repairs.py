"""Spikes and short drop-outs replaced by interpolation, each sample counted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from structid.records.quality.findings import channel_name
from structid.records.quality.sample_faults import filled, spikes
from structid.records.quality.signal_checks import lost_samples
from structid.records.record import TimeRecord


def repaired(record: TimeRecord, dropouts: bool, outliers: bool, longest_gap: int = 10) -> tuple[TimeRecord, list[str]]:
    """`record` with drop-outs up to `longest_gap` samples, then spikes, replaced by cubics; and what was done.

    Spikes in force channels stay: impacts look alike.
    """
    values, steps = np.array(record.values), []
    for i in range(len(record.channels)):
        name, n = channel_name(record, i), len(values)
        if dropouts and np.ptp(values[:, i]):
            lost = lost_samples(record, i)
            flags = np.zeros(n, dtype=bool)
            for start, stop in lost:
                flags[start:stop] = stop - start <= longest_gap
            if flags.any():
                values[:, i] = filled(values[:, i], flags)
                steps.append(
                    f"{flags.sum()} of {n} samples of channel {name} invented: drop-outs, by cubic interpolation"
                )
            long = [part for part in lost if part[1] - part[0] > longest_gap]
            if long:
                steps.append(
                    f"{len(long)} drop-outs of channel {name} left as they are, {sum(b - a for a, b in long)} samples: "
                    f"longer than {longest_gap} samples each; cut them with `interval`"
                )
        if outliers and record.quantities[i] != "force":
            flags = spikes(values[:, i])
            if flags.any():
                values[:, i] = filled(values[:, i], flags)
                steps.append(f"{flags.sum()} of {n} samples of channel {name} invented: spikes, by cubic interpolation")
    return (replace(record, values=values) if steps else record), steps
