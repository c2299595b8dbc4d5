"""
Frequency responses: every element of a cantilever
==================================================

Two accelerometers and a shaker at the tip of a cantilever give mass and bending stiffness of each of six elements,
with 1 % noise on every value. One learns the shortest way from a model and a record to an answer with its
uncertainty. Nothing but the noise is between the answer and the truth here.
"""

import numpy as np

import structid as sid

mass, stiffness = [1.0, 0.9, 1.1, 1.2, 0.8, 1.0], [10.0, 11.0, 9.0, 8.0, 9.5, 10.0]
beam = sid.Beam("beam", [[i, i + 1] for i in range(6)], mass, stiffness, loss_factor=0.02)
structure = sid.Structure({i: float(i) for i in range(7)}, [beam], fixed=["0Y", "0RZ"])
unknown = [sid.Unknown(p, "beam", each=True) for p in ("mass", "bending_stiffness")]
truth = sid.parameters(structure, [*unknown, sid.Unknown("loss_factor", "beam")])

# %%
# The record, simulated
# ---------------------
rng = np.random.default_rng(1)
lines = np.linspace(0.02, 1.6, 400)
like = sid.FrfRecord(lines, np.ones((400, 2, 1)), ("6Y+", "3Y+"), ("6Y+",), "accelerance")
record = sid.simulated_record(structure, truth, like, relative_noise=0.01, rng=rng)
record

# %%
# The answer, from values that are 15 % off
# -----------------------------------------
start = truth.started_at(truth.start * np.exp(0.15 * rng.standard_normal(truth.n_params)))
found = sid.identify(structure, start, record)
print(found.estimate)
parameters = found.plot_parameters()
fit = found.plot_frf("6Y", "6Y")
