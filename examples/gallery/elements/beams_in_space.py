"""
Beams in space: a portal that sways, twists and bends
=====================================================

A small frame of space beams: two bending stiffnesses and a torsional stiffness for its columns are sought from
responses in two directions. One learns which motion tells which stiffness: without a sensor that sees the twist, the
torsional stiffness would be the worst known.
"""

import numpy as np

import structid as sid

corners = {1: (0, 0), 2: (1, 0), 3: (1, 0.6), 4: (0, 0.6)}
nodes = {i: [x, y, 0.0] for i, (x, y) in corners.items()} | {10 + i: [x, y, 1.2] for i, (x, y) in corners.items()}
held = [f"{i}{d}" for i in corners for d in ("X", "Y", "Z", "RX", "RY", "RZ")]


def frame(strong, weak, twist):
    """Four columns clamped at their feet, four girders on top that are known."""
    rest = {"axial_stiffness": 2e8, "polar_inertia": 2e-3, "loss_factor": 0.01}
    feet = [[i, 10 + i] for i in corners]
    column = sid.SpaceBeam("column", feet, 4.0, weak, strong, torsional_stiffness=twist, orientation=[1, 0, 0], **rest)
    top = [[11, 12], [12, 13], [13, 14], [14, 11]]
    girder = sid.SpaceBeam("girder", top, 5.0, 9e3, 9e3, torsional_stiffness=6e3, **rest)
    return sid.Structure(nodes, [column, girder], held, subdivide=2)


truth, model = frame(8e3, 5e3, 2.0e3), frame(7e3, 6e3, 1.5e3)
lines = np.arange(2.0, 120.0, 0.25)
sensors = ("11X", "11Y", "13X", "13Y")
like = sid.FrfRecord(lines, np.ones((len(lines), 4, 2)), sensors, ("11X", "11Y"), "accelerance")
record = sid.simulated_record(truth, sid.parameters(truth, []), like, 0.01, np.random.default_rng(3))

# %%
# The answer
# ----------
properties = ("bending_stiffness_y", "bending_stiffness_z", "torsional_stiffness")
found = sid.identify(model, sid.parameters(model, [sid.Unknown(p, "column") for p in properties]), record)
print(found.estimate)
structure = found.structure.plot_structure()
modes = found.plot_frequencies()
