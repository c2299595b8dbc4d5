"""
Solids: modulus and density of a block
======================================

A short cantilever of solid elements, too stout for a beam. With the force measured, modulus and density both come out
in their units. One learns that the same few lines serve every family of elements.
"""

import itertools

import numpy as np

import structid as sid

n = (6, 2, 2)
label = np.arange(1, np.prod([k + 1 for k in n]) + 1).reshape([k + 1 for k in n])
nodes = {int(label[i]): [0.4 / 6 * i[0], 0.04 * i[1], 0.03 * i[2]] for i in np.ndindex(label.shape)}
corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
cells = [[label[tuple(np.add(at, c))] for c in corners] for at in itertools.product(*map(range, n))]
held = [f"{node}{d}" for node in label[0].ravel() for d in "XYZ"]


def block(modulus, density):
    """A bar of 0.4 x 0.08 x 0.06 m, clamped at one end."""
    return sid.Structure(nodes, [sid.Solid("block", np.array(cells), modulus, density, 0.3, loss_factor=0.01)], held)


truth, model = block(3.1e9, 1180.0), block(2.8e9, 1250.0)
lines = np.linspace(20.0, 900.0, 60)
tip = label[-1, -1, -1]
like = sid.FrfRecord(lines, np.ones((60, 2, 1)), (f"{tip}Y", f"{tip}Z"), (f"{tip}Z",), "accelerance")
record = sid.simulated_record(truth, sid.parameters(truth, []), like, 0.01, np.random.default_rng(6))

# %%
# The answer
# ----------
unknown = sid.parameters(model, [sid.Unknown("youngs_modulus", "block"), sid.Unknown("density", "block")])
found = sid.identify(model, unknown, record)
print(found.estimate)
structure = found.structure.plot_structure()
figure = found.plot_frf(f"{tip}Z")
