"""
A flexible joint between two girders
====================================

Two girders meet at a bolted joint that turns a little. The joint is a spring between the end of an element and its
node; its stiffness is an unknown as any other. One learns that the girders and their joint are told apart by modes
that bend the joint and modes that do not.
"""

import numpy as np

import structid as sid


def bridge(joint, bending):
    """Two spans of 2 m on three supports, joined over the middle one."""
    girder = sid.Beam("girder", [[i, i + 1] for i in range(1, 9)], 12.0, bending, loss_factor=0.006)
    bolt = sid.Joint("bolt", "girder:4", "5RZ", joint)
    return sid.Structure({i: 0.5 * (i - 1) for i in range(1, 10)}, [girder, bolt], ["1Y", "5Y", "9Y"])


truth, model = bridge(3.0e4, 2.1e4), bridge(6.0e4, 2.0e4)
lines = np.arange(5.0, 150.0, 0.25)
like = sid.FrfRecord(lines, np.ones((len(lines), 3, 1)), ("2Y", "4Y", "7Y"), ("2Y",), "accelerance")
record = sid.simulated_record(truth, sid.parameters(truth, []), like, 0.01, np.random.default_rng(8))

# %%
# The answer
# ----------
unknown = sid.parameters(model, [sid.Unknown("stiffness", "bolt"), sid.Unknown("bending_stiffness", "girder")])
found = sid.identify(model, unknown, record)
print(found.estimate)
figure = found.plot_frf("7Y")
