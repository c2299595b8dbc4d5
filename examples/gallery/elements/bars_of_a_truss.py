"""
Bars: which member of a truss is loose?
=======================================

Ten bars of a plane truss, each with an axial stiffness of its own as the unknown; one of them lost a fifth. Three
accelerometers and one force find it with 1 % noise. One learns that a picture of the structure, coloured by the
change, answers faster than a table.
"""

import numpy as np

import structid as sid

nodes = {1: [0, 0], 2: [0, 1], 3: [1, 0], 4: [1, 1], 5: [2, 0], 6: [2, 1]}
members = [[1, 3], [3, 5], [2, 4], [4, 6], [3, 4], [5, 6], [1, 4], [2, 3], [3, 6], [4, 5]]
held = ["1X", "1Y", "2X", "2Y"]


def truss(stiffness):
    """Members of 2 kg/m; masses of 5 kg at the joints."""
    bars = sid.Bar("bar", members, 2.0, stiffness, loss_factor=0.005)
    return sid.Structure(nodes, [bars, sid.PointMass("joint", [3, 4, 5, 6], 5.0)], held, active=["X", "Y"])


lines = np.arange(5.0, 150.0, 0.25)
like = sid.FrfRecord(lines, np.ones((len(lines), 3, 1)), ("4Y", "6X", "6Y"), ("6Y",), "accelerance")
damaged = truss(4e6 * np.where(np.arange(10) == 6, 0.8, 1.0))
record = sid.simulated_record(damaged, sid.parameters(damaged, []), like, 0.01, np.random.default_rng(2))

# %%
# The answer
# ----------
model = truss(np.full(10, 4e6))
found = sid.identify(model, sid.parameters(model, [sid.Unknown("axial_stiffness", "bar", each=True)]), record)
print(found.estimate)
figure = found.plot_structure()
