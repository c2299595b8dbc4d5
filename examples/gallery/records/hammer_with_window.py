"""
A hammer test under an exponential window
=========================================

Force and response of an impact are multiplied by a decaying window so that the record ends at rest. The window adds
damping to the measured response. structid evaluates the model where the window has moved the data, at s = decay + iω,
so that none of it is left in the answer. One learns to state the window instead of correcting for it.
"""

from dataclasses import replace

import numpy as np

import structid as sid

parts = [
    sid.PointMass("mass", [1, 2], [2.0, 1.5]),
    sid.Spring("spring", ["0X", "1X"], ["1X", "2X"], stiffness=[4e4, 3e4]),
    sid.Dashpot("damper", ["0X", "1X"], ["1X", "2X"], viscous_damping=[4.0, 3.0]),
]
structure = sid.Structure({0: 0.0, 1: 1.0, 2: 2.0}, parts, ["0X"], active=["X"])
properties = (("mass", "mass"), ("stiffness", "spring"), ("viscous_damping", "damper"))
truth = sid.parameters(structure, [sid.Unknown(p, e, each=True) for p, e in properties])

# %%
# Five blows on mass 2, two seconds each, which still ring at the end; simulated at eight times the sampling rate.
rng = np.random.default_rng(5)
rate, n = 512.0, 1024
pulse = np.zeros(8 * n)
pulse[80:140] = 80 * np.sin(np.pi * np.arange(60) / 60) ** 2
channels, kinds = ("1X", "2X", "2X"), ("acceleration", "acceleration", "force")
blows = []
for strength in rng.uniform(0.8, 1.2, 5):
    blank = sid.TimeRecord(8 * rate, np.column_stack([np.zeros((8 * n, 2)), strength * pulse]), channels, kinds)
    values = sid.simulated_time_record(structure, truth, blank, sid.TimeOptions(force="first")).values[::8]
    noisy = values + 2e-3 * values.max(axis=0) * rng.standard_normal(values.shape)
    blows.append(sid.TimeRecord(rate, noisy, channels, kinds))
window = ("exponential", 0.0, 120.0)
record = sid.frf_from_time(blows, ["2X"], ["1X", "2X"], segment_length=n, window=window, detrend="none")
record = replace(record, decay=np.full(len(record.frequency), rate / 120.0))  # 1/s

# %%
# The answer
# ----------
start = truth.started_at(truth.start * np.exp(0.1 * rng.standard_normal(truth.n_params)))
found = sid.identify(structure, start, record, sid.IdentifyOptions(band=(5.0, 60.0)))
print(found.estimate)
figure = found.plot_frf("2X", "2X")
