"""
Where a standard deviation misleads: profiles
=============================================

Where a parameter is hardly determined, value and standard deviation mislead: the likelihood is skewed. The profile
follows it, posterior draws sample it. One learns when the quick (Laplace) interval will do, and what an open interval
says.
"""

import numpy as np
from matplotlib.figure import Figure

import structid as sid
from structid.inversion import profile


def beam(clamp):
    """A strip whose clamp is nearly rigid."""
    parts = [
        sid.Beam("strip", [[i, i + 1] for i in range(4)], 1.0, 40.0, loss_factor=0.01),
        sid.Spring("clamp", "0RZ", stiffness=clamp),
    ]
    return sid.Structure({i: 0.2 * i for i in range(5)}, parts, ["0Y"])


truth, model = beam(3e4), beam(1e4)
lines = np.arange(3.0, 60.0, 3.0)
like = sid.FrfRecord(lines, np.ones((len(lines), 1, 1)), ("4Y",), ("4Y",), "accelerance")
record = sid.simulated_record(truth, sid.parameters(truth, []), like, 0.05, np.random.default_rng(10))
unknown = sid.parameters(model, [sid.Unknown("stiffness", "clamp"), sid.Unknown("bending_stiffness", "strip")])
problem = sid.FrfProblem(model, unknown, record)
found = sid.estimate(problem)
print(found)

# %%
# Laplace and profile of the clamp
# --------------------------------
name = "stiffness[clamp]"
laplace = found.interval(0.95)[found.names.index(name)]
curve = profile(problem, found, name)
print(f"Laplace: {laplace[0]:.3g} to {laplace[1]:.3g} N m/rad")
print(f"profile: {curve.lower:.3g} to {curve.upper:.3g} N m/rad; {curve.words}")

# %%
# The likelihood falls off on one side only: however stiff the clamp is, the record would look the same.
figure = Figure(figsize=(7, 3), layout="constrained")
axes = figure.subplots()
axes.plot(curve.values, curve.deviance, "o-", ms=3, label="profile")
axes.axhline(3.84, color="0.6", lw=0.8, label="95 %")
axes.axvspan(*laplace, alpha=0.15, label="Laplace interval")
axes.set_xscale("log")
axes.set_xlim(1e3, 1e9)
axes.set_ylim(0, 8)
axes.set_xlabel("stiffness of the clamp (N m/rad)")
axes.set_ylabel("deviance")
axes.legend(frameon=False)
