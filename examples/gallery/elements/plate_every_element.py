"""
A plate with a parameter for every element
==========================================

Damage has no group of its own in a mesh: each of 50 elements has its own modulus, neighbours are held together by
smoothness, and the data choose how strongly. One learns that far fewer combinations are determined than there are
parameters, and that the soft place is found all the same.
"""

import numpy as np

import structid as sid

nx, ny = 10, 5
label = np.arange(1, (nx + 1) * (ny + 1) + 1).reshape(nx + 1, ny + 1)
nodes = {int(label[i, j]): [0.06 * i, 0.08 * j] for i in range(nx + 1) for j in range(ny + 1)}
cells = [[label[i, j], label[i + 1, j], label[i + 1, j + 1], label[i, j + 1]] for i in range(nx) for j in range(ny)]
clamped = [f"{n}{d}" for n in label[0] for d in ("Z", "RX", "RY")]


def plate(modulus):
    """Aluminium, 3 mm."""
    skin = sid.Plate("skin", np.array(cells), modulus, 2700.0, 3e-3, 0.33, loss_factor=0.01)
    return sid.Structure(nodes, [skin], clamped)


middle = np.array([[0.06 * i + 0.03, 0.08 * j + 0.04] for i in range(nx) for j in range(ny)])
soft = 1 - 0.35 * np.exp(-((middle - [0.27, 0.2]) ** 2).sum(axis=1) / 0.07**2)
truth, model = plate(70e9 * soft), plate(np.full(nx * ny, 70e9))
sensors = [f"{label[i, j]}Z" for i in (3, 6, 10) for j in (0, 3, 5)]
lines = np.linspace(5.0, 250.0, 40)
like = sid.FrfRecord(lines, np.ones((40, 9, 1)), sensors, (f"{label[10, 0]}Z",), "accelerance")
record = sid.simulated_record(truth, sid.parameters(truth, []), like, 0.01, np.random.default_rng(4))

# %%
# The answer
# ----------
unknown = sid.parameters(model, [sid.Unknown("youngs_modulus", "skin", each=True)])
options = sid.IdentifyOptions(regularization=[sid.Smoothness("youngs_modulus", "skin")])
found = sid.identify(model, unknown, record, options)
change = found.estimate.values / 70e9
print(
    "softest element:",
    found.estimate.names[int(change.argmin())],
    f"{change.min():.2f} of nominal, truly {soft.min():.2f}",
)

# %%
# The map, over its size when it was made
# ---------------------------------------
figure = found.plot_structure()
