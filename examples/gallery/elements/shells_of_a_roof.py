"""
Shells: how thick is a curved panel?
====================================

A cylindrical panel stretches and bends, so that its frequencies tell modulus and thickness apart, which those of a
flat plate do not. One learns what a parameter that enters with two powers, thickness and its cube, looks like in an
answer.
"""

import numpy as np

import structid as sid

nx, ny, radius = 6, 6, 1.0
angle, length = np.linspace(-0.5, 0.5, nx + 1), np.linspace(0.0, 1.0, ny + 1)
label = np.arange(1, (nx + 1) * (ny + 1) + 1).reshape(nx + 1, ny + 1)
nodes = {
    int(label[i, j]): [radius * np.sin(angle[i]), length[j], radius * np.cos(angle[i])]
    for i in range(nx + 1)
    for j in range(ny + 1)
}
cells = [[label[i, j], label[i + 1, j], label[i + 1, j + 1], label[i, j + 1]] for i in range(nx) for j in range(ny)]
held = [f"{n}{d}" for n in (*label[0], *label[-1]) for d in ("X", "Y", "Z", "RX", "RY", "RZ")]


def panel(modulus, thickness):
    """Clamped along both straight edges."""
    shell = sid.Shell("panel", np.array(cells), modulus, 2700.0, thickness, 0.33, loss_factor=0.01)
    return sid.Structure(nodes, [shell], held)


truth, model = panel(68e9, 4.3e-3), panel(72e9, 4.0e-3)
lines = np.linspace(60.0, 400.0, 50)
sensors = [f"{label[i, j]}Z" for i, j in ((3, 3), (2, 3), (3, 0))]
like = sid.FrfRecord(lines, np.ones((50, 3, 1)), sensors, (sensors[1],), "accelerance")
record = sid.simulated_record(truth, sid.parameters(truth, []), like, 0.01, np.random.default_rng(5))

# %%
# The answer
# ----------
unknown = sid.parameters(model, [sid.Unknown("youngs_modulus", "panel"), sid.Unknown("thickness", "panel")])
found = sid.identify(model, unknown, record)
print(found.estimate)
figure = found.plot_frf(sensors[0])
