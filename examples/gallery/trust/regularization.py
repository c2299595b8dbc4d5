"""
More unknowns than the data hold: smoothness
============================================

Twenty stiffnesses from one sensor at the tip are too many. Smoothness says that neighbours differ little, as strongly
as the data make most probable. One learns what it buys, what it assumes, and that sharp changes are rounded by it.
"""

import numpy as np
from matplotlib.figure import Figure

import structid as sid
from structid.unknowns.tolerances import EXACT

n = 20
place = (np.arange(n) + 0.5) / n
true = 80.0 * (1 - 0.25 * np.exp(-((place - 0.35) ** 2) / 0.02))


def beam(stiffness):
    """A cantilever of twenty elements."""
    elements = sid.Beam("beam", [[i, i + 1] for i in range(n)], 2.0, stiffness, loss_factor=0.01)
    return sid.Structure({i: 1.2 * i / n for i in range(n + 1)}, [elements], ["0Y", "0RZ"])


truth, model = beam(true), beam(np.full(n, 80.0))
lines = np.arange(2.0, 160.0, 1.0)
like = sid.FrfRecord(lines, np.ones((len(lines), 1, 1)), (f"{n}Y",), (f"{n}Y",), "accelerance")
record = sid.simulated_record(truth, sid.parameters(truth, []), like, 0.02, np.random.default_rng(3))
unknown = sid.parameters(model, [sid.Unknown("bending_stiffness", "beam", each=True, factor=False)])

# %%
# With and without
# ----------------
# (mass, damping and calibration of this simulated beam are known exactly, which no drawing is)
smoothness = [sid.Smoothness("bending_stiffness", "beam")]
smooth = sid.identify(model, unknown, record, sid.IdentifyOptions(regularization=smoothness, tolerances=EXACT)).estimate
alone = sid.identify(model, unknown, record, sid.IdentifyOptions(tolerances=EXACT)).estimate
figure = Figure(figsize=(7, 3.4), layout="constrained")
axes = figure.subplots()
axes.errorbar(place - 0.008, alone.values, 1.96 * alone.std, fmt="o", capsize=3, color="0.6", label="data alone")
axes.errorbar(place + 0.008, smooth.values, 1.96 * smooth.std, fmt="o", capsize=3, label="with smoothness")
axes.plot(place, true, "k-", lw=1, label="truth")
axes.set_ylim(40, 110)
axes.set_xlabel("place along the beam, parts of its length")
axes.set_ylabel("bending stiffness (N m²), 95 %")
axes.legend(frameon=False)
