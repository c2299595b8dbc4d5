"""
Matrices of another finite element code
=======================================

Two groups of matrices came from elsewhere; each has a factor of nominal value 1 that the record determines. The
second is really a tenth softer. One learns how little structid needs to know of a model: matrices and the names of
their rows.
"""

import numpy as np
from scipy import sparse

import structid as sid

n = 40
spring = np.array([[1.0, -1.0], [-1.0, 1.0]])


def assembled(elements):
    """Springs of 100 kN/m in a row, the first to the ground."""
    matrix = sparse.lil_array((n, n))
    for e in elements:
        at = [i for i in (e - 1, e) if i >= 0]
        matrix[np.ix_(at, at)] += 1e5 * spring[-len(at) :, -len(at) :]
    return sparse.csc_array(matrix)


groups = {
    "lower": {"mass": 0.5 * sparse.eye_array(n), "stiffness": assembled(range(20)), "loss_factor": 0.01},
    "upper": {"stiffness": assembled(range(20, n)), "loss_factor": 0.01},
}
structure = sid.from_matrices(groups, [f"{i}X" for i in range(1, n + 1)], {i: [0.1 * i] for i in range(1, n + 1)})
unknown = sid.parameters(structure, [sid.Unknown("stiffness", "lower"), sid.Unknown("stiffness", "upper")])
like = sid.FrfRecord(np.linspace(0.5, 12.0, 300), np.ones((300, 2, 1)), ("40X+", "20X+"), ("40X+",), "mobility")
truth = unknown.started_at(np.array([1.0, 0.9]))
record = sid.simulated_record(structure, truth, like, relative_noise=0.02, rng=np.random.default_rng(2))

# %%
# The answer
# ----------
found = sid.identify(structure, unknown, record)
print(found.estimate)
figure = found.plot_parameters()
