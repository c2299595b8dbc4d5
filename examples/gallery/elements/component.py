"""
A panel reduced once
====================

The mounts of a panel are sought, its mesh is not in question. As a component the panel is reduced once, to its mounts and its
lowest modes: a search then solves for a few dozen motions instead of thousands. One learns what that changes, and why a load
amid the panel belongs to its interface.
"""

import time
from dataclasses import replace

import numpy as np

import structid as sid

n = 20
nodes = {1 + i + j * (n + 1): (0.06 * i, 0.045 * j, 0.0) for j in range(n + 1) for i in range(n + 1)}
cells = [[k, k + 1, k + n + 2, k + n + 1] for k in (1 + i + j * (n + 1) for j in range(n) for i in range(n))]
panel = sid.Plate("skin", cells, youngs_modulus=70e9, density=2700.0, poisson=0.3, thickness=4e-3, loss_factor=0.01)
corners = [f"{k}Z" for k in (1, n + 1, n * (n + 1) + 1, (n + 1) ** 2)]
mounts = sid.Spring("mount", corners, stiffness=[2e4, 3e4, 1e4, 1.5e4], loss_factor=0.02)
whole = sid.Structure(nodes, [panel, mounts], active=("Z", "RX", "RY"))
parts = sid.Component("panel", "skin", up_to=240.0, interface="134Z")
reduced = replace(whole, components=(parts,))
print(reduced.reductions[0].words)

# %%
# A record of the whole mesh, with noise
# --------------------------------------
sought = [sid.Unknown("stiffness", "mount", each=True)]
like = sid.FrfRecord(np.linspace(4.0, 80.0, 40), np.ones((40, 3, 1)), ["134Z", "250Z", "405Z"], ["134Z"], "accelerance")
exact = sid.parameters(whole, sought)
record = sid.simulated_record(whole, exact, like, relative_noise=0.01, rng=np.random.default_rng(3))

# %%
# Both models, from starts 20 % off
# ---------------------------------
answers = {}
for name, structure in (("whole", whole), ("reduced", reduced)):
    unknown = sid.parameters(structure, sought)
    begun = time.perf_counter()
    found = sid.estimate(sid.FrfProblem(structure, unknown.started_at(1.2 * exact.start), record))
    answers[name] = found
    print(
        f"{name}: {time.perf_counter() - begun:.2f} s, {found.search.n_iterations} iterations; {found.values.round(1)} N/m"
    )

# %%
# What reduction changes
# ----------------------
# `identify` solves a few lines with nothing reduced at the answer, and says how far off they are.
unknown = sid.parameters(reduced, sought)
identified = sid.identify(reduced, unknown.started_at(1.2 * exact.start), record, sid.IdentifyOptions(restarts=0))
print(identified.truncations[0].words)
figure = identified.plot_frf("405Z")
