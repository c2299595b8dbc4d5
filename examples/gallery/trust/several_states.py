"""
Several states of one structure
===============================

A frame was measured new and three times later. Each later state is compared with the first, storey by storey; masses
are the same in all. One learns to tell change from scatter: with four tests a comparison, no declaration is made at a
level that would cry wolf.
"""

import numpy as np
from matplotlib.figure import Figure

import structid as sid

storeys = range(1, 5)


def frame(stiffness):
    """Four floors of 4 t that are weighed."""
    here, below = [f"{i}X" for i in storeys], [f"{i - 1}X" for i in storeys]
    spring = sid.Spring("storey", below, here, stiffness=stiffness, loss_factor=0.03)
    return sid.Structure(
        {i: 3.0 * i for i in range(5)}, [sid.PointMass("floor", list(storeys), 4000.0), spring], ["0X"], active=["X"]
    )


states = {"new": [1, 1, 1, 1], "1 year": [1, 1, 1, 1], "2 years": [0.97, 1, 1, 1], "3 years": [0.95, 1, 0.96, 1]}
lines = np.arange(0.5, 8.0, 0.02)
like = sid.FrfRecord(lines, np.ones((len(lines), 2, 1)), ("2X", "4X"), ("4X",), "accelerance")
rng = np.random.default_rng(9)
model = frame(2.0e6)
unknown = sid.parameters(model, [sid.Unknown("stiffness", "storey", each=True, factor=False)])
answers = {}
for state, part in states.items():
    truth = frame(2.2e6 * np.array(part))
    record = sid.simulated_record(truth, sid.parameters(truth, []), like, 0.05, rng)
    answers[state] = sid.identify(model, unknown, record).estimate

# %%
# Changes since new
# -----------------
figure = Figure(figsize=(7, 3.4), layout="constrained")
axes = figure.subplots()
for k, (state, later) in enumerate(list(answers.items())[1:]):
    found = sid.compare_states(answers["new"], later)
    std = np.sqrt(np.diag(found.covariance)) / found.before
    axes.errorbar(
        np.arange(1, 5) + 0.12 * (k - 1), 100 * found.relative_change, 196 * std, fmt="o", capsize=3, label=state
    )
    print(
        state,
        "-",
        [name for name, changed in zip(found.names, found.changed, strict=True) if changed] or "nothing changed",
    )
axes.axhline(0, color="black", lw=0.6)
axes.set_xticks(range(1, 5))
axes.set_xlabel("storey")
axes.set_ylabel("change since new (%), 95 %")
axes.legend(frameon=False)
