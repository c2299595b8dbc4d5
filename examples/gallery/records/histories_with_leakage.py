"""
A short record leaks: spectra with their transient
==================================================

Twenty seconds of a lightly damped chain that is neither at rest at first nor at last. Averaged responses of it leak:
their fit shows 17 % more damping than there is, three of its standard deviations, and these are many times as large as
those of the finite Fourier transforms, which are fitted with the transient as an unknown and do not leak. One learns
when to take ``[record.time]`` in place of averages.
"""

import numpy as np
from matplotlib.figure import Figure
from scipy import signal

import structid as sid

here, back = [f"{i}X" for i in range(1, 5)], [f"{i}X" for i in range(4)]
parts = [
    sid.PointMass("m", [1, 2, 3, 4], 2.0),
    sid.Spring("k", here, back, stiffness=1000.0),
    sid.Dashpot("c", here, back, viscous_damping=0.7),
]
structure = sid.Structure({i: float(i) for i in range(5)}, parts, ["0X"], active=["X"])
unknown = [sid.Unknown(p, e, each=True) for p, e in (("mass", "m"), ("stiffness", "k"))]
truth = sid.parameters(structure, [*unknown, sid.Unknown("viscous_damping", "c")])

# %%
# Eighty seconds are simulated at 640 Hz, the twenty in the middle are the record, at 40 Hz; 1 % noise on all channels.
rng = np.random.default_rng(3)
force = signal.sosfiltfilt(signal.butter(8, 10.0, fs=640.0, output="sos"), rng.standard_normal(51200))
channels, kinds = ("2X", "4X", "4X"), ("acceleration", "acceleration", "force")
blank = sid.TimeRecord(640.0, np.column_stack([np.zeros((51200, 2)), force]), channels, kinds)
whole = sid.simulated_time_record(structure, truth, blank).values[19200:32000:16]
std = 0.01 * whole.std(axis=0)
record = sid.TimeRecord(40.0, whole + std * rng.standard_normal(whole.shape), channels, kinds, std**2)

# %%
# Averages of segments, and the histories themselves
# --------------------------------------------------
start = truth.started_at(truth.start * np.exp(0.1 * rng.standard_normal(truth.n_params)))
averaged = sid.frf_from_time(record, ["4X"], ["2X", "4X"], segment_length=400)
options = sid.IdentifyOptions(band=(0.3, 8.0))
by_averages = sid.identify(structure, start, averaged, options).estimate
by_spectra = sid.identify_together([sid.TimeSetup(structure, start, record)], options).estimate
print(by_spectra)

# %%
# Stiffnesses over the true 1000 N/m:
figure = Figure(figsize=(7, 3.2), layout="constrained")
axes = figure.subplots()
at = np.arange(4, 8)
for shift, one, name in ((-0.1, by_averages, "averaged responses"), (0.1, by_spectra, "spectra with transient")):
    axes.errorbar(at - 3 + shift, one.values[at] / 1000, 1.96 * one.std[at] / 1000, fmt="o", capsize=4, label=name)
axes.axhline(1.0, color="black", lw=0.8)
axes.set_xticks(range(1, 5))
axes.set_xlabel("spring")
axes.set_ylabel("found over true, 95 %")
axes.legend(frameon=False)
