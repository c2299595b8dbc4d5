"""
Timoshenko against Bernoulli: a beam that shears
================================================

A stout beam shears as it bends, and its higher modes lie lower than those of a slender one. Without shear the bending
stiffness comes out too low, and the residual says so. One learns when a beam needs a shear stiffness and the rotary
inertia of its sections.
"""

import numpy as np

import structid as sid


def beam(bending, **more):
    """Clamped, 0.6 m long, of twelve elements."""
    elements = sid.Beam("beam", [[i, i + 1] for i in range(12)], 15.6, bending, loss_factor=0.01, **more)
    return sid.Structure({i: 0.05 * i for i in range(13)}, [elements], ["0Y", "0RZ"])


stout = {"shear_stiffness": 1.3e7, "rotary_inertia": 0.0083}
truth = beam(1.1e5, **stout)
lines = np.arange(50.0, 4000.0, 10.0)
like = sid.FrfRecord(lines, np.ones((len(lines), 2, 1)), ("6Y", "12Y"), ("12Y",), "accelerance")
record = sid.simulated_record(truth, sid.parameters(truth, []), like, 0.01, np.random.default_rng(11))

# %%
# Without shear
# -------------
slender = beam(1.0e5)
without = sid.identify(slender, sid.parameters(slender, [sid.Unknown("bending_stiffness", "beam")]), record)
print(without.estimate)
wrong = without.plot_frf("12Y")

# %%
# With shear, whose stiffness is an unknown too
# ---------------------------------------------
model = beam(1.0e5, shear_stiffness=1.6e7, rotary_inertia=0.0083)
unknown = [sid.Unknown("bending_stiffness", "beam"), sid.Unknown("shear_stiffness", "beam")]
found = sid.identify(model, sid.parameters(model, unknown), record)
print(found.estimate)
right = found.plot_frf("12Y")
