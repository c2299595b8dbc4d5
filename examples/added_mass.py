"""Absolute masses with an accelerometer that was never calibrated: measure twice, once with a known mass added."""

from dataclasses import replace

import numpy as np

import structid as sid

GAIN = 1.13


def main() -> sid.Identification:
    """A cantilever of eight elements, heavier by a fifth in its outer half than its model, and 0.2 kg on its middle."""
    unknowns = [
        sid.Unknown("mass", "inner"),
        sid.Unknown("mass", "outer"),
        sid.Unknown("bending_stiffness", ["inner", "outer"]),
    ]
    gain = sid.ChannelUnknown("gain", "all", name="accelerometer")
    rng = np.random.default_rng(3)
    setups = []
    for name, added in (("bare", 0.0), ("with 0.2 kg", 0.2)):
        parts = [
            sid.Beam(half, [[i, i + 1] for i in range(first, first + 4)], 1.0, 40.0, loss_factor=0.01)
            for half, first in (("inner", 0), ("outer", 4))
        ]
        if added:
            parts.append(sid.PointMass("added", [4], added))
        structure = sid.Structure({i: 0.1 * i for i in range(9)}, parts, ["0Y", "0RZ"])
        model = sid.parameters(structure, unknowns)
        like = sid.FrfRecord(np.arange(5.0, 160.0, 0.5), np.ones((310, 2, 1)), ("8Y", "5Y"), ("3Y",), "accelerance")
        true = sid.simulated_record(structure, model.started_at(np.array([1.0, 1.2, 40.0])), like, 0.01, rng)
        record = sid.with_declared_noise(replace(true, values=GAIN * true.values), 0.01)
        setups.append(sid.Setup(structure, model, record, [gain], name))
    found = sid.identify_together(setups)
    print(found.estimate)
    return found


if __name__ == "__main__":
    main()
