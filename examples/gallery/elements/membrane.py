"""
A membrane: the tension of a drumhead
=====================================

A drum is tuned by the tension of its head, which the responses tell with the head's mass. One learns how cells of a
mesh are made in Python, and that a single sensor is enough where the unknowns are few.
"""

import numpy as np
from scipy.spatial import Delaunay

import structid as sid

rings = [(0.0, 0.0)] + [
    (0.15 * r / 6 * np.cos(a), 0.15 * r / 6 * np.sin(a))
    for r in range(1, 7)
    for a in np.linspace(0, 2 * np.pi, 6 * r, endpoint=False)
]
points = np.array(rings)
triangles = Delaunay(points).simplices + 1
rim = [f"{i + 1}Z" for i in np.flatnonzero(np.hypot(*points.T) > 0.149)]


def drum(mass, tension):
    """A head of 0.3 m."""
    skin = sid.Membrane("head", triangles, mass, tension, loss_factor=0.01)
    return sid.Structure({i + 1: p for i, p in enumerate(points)}, [skin], rim)


truth, model = drum(0.26, 2600.0), drum(0.25, 2300.0)
lines = np.linspace(80.0, 800.0, 300)
like = sid.FrfRecord(lines, np.ones((300, 1, 1)), ("12Z",), ("12Z",), "mobility")
record = sid.simulated_record(truth, sid.parameters(truth, []), like, 0.01, np.random.default_rng(7))

# %%
# The answer
# ----------
unknown = sid.parameters(model, [sid.Unknown("mass", "head"), sid.Unknown("tension", "head")])
found = sid.identify(model, unknown, record)
print(found.estimate)
figure = found.plot_frf()
