"""What is worth a warning in a record before anything is estimated from it."""

from __future__ import annotations

import numpy as np

from structid.records import FrfRecord
from structid.structure import Structure


def record_warnings(structure: Structure, record: FrfRecord) -> tuple[str, ...]:
    """Signs, coherence and units of `record` that do not look right for `structure`.

    A driving point must have a real part of its mobility of at least 0 (it can only take power in); a record whose
    mobility there is negative at most lines has a sensor or load with the wrong sense or another sign convention.
    """
    warnings = []
    for i, load in enumerate(record.inputs):
        for o, sensor in enumerate(record.outputs):
            if sensor.unsigned == load.unsigned and record.frequency[-1] > 0:
                warnings.extend(_driving_point(record, o, i))
    if record.coherence is not None:
        low = (record.coherence < 0.8).mean(axis=(0, 2))
        for sensor, part in zip(record.outputs, low, strict=True):
            if part > 0.2:
                warnings.append(f"coherence of {sensor} is below 0.8 at {100 * part:.0f} % of the lines")
    return tuple(warnings)


def _driving_point(record: FrfRecord, o: int, i: int) -> list[str]:
    keep = record.frequency > 0
    mobility = record.lines(np.flatnonzero(keep)).as_kind("mobility").values[:, o, i]
    sense = record.outputs[o].sign * record.inputs[i].sign
    negative = float((sense * mobility.real < 0).mean())
    if negative <= 0.5:
        return []
    return [
        f"driving point {record.outputs[o]} / {record.inputs[i]}: the real part of mobility is negative at"
        f" {100 * negative:.0f} % of the lines; check the sense of the sensor, the load and the sign convention of the FRF"
    ]
