"""Stiffness factors of two substructures that came as matrices from another finite element code."""

import numpy as np
from scipy import sparse

import structid as sid


def main() -> sid.Identification:
    """A chain of 40 masses in two groups; the second is really 10 % softer than its model."""
    n = 40
    spring = np.array([[1.0, -1.0], [-1.0, 1.0]])

    def assembled(elements: range) -> sparse.csc_array:
        matrix = sparse.lil_array((n, n))
        for e in elements:
            at = [i for i in (e - 1, e) if i >= 0]
            matrix[np.ix_(at, at)] += 1e5 * spring[-len(at) :, -len(at) :]
        return sparse.csc_array(matrix)

    groups = {
        "lower": {"mass": 0.5 * sparse.eye_array(n), "stiffness": assembled(range(20)), "loss_factor": 0.01},
        "upper": {"stiffness": assembled(range(20, n)), "loss_factor": 0.01},
    }
    structure = sid.from_matrices(groups, [f"{i}X" for i in range(1, n + 1)])
    unknown = sid.parameters(structure, [sid.Unknown("stiffness", "lower"), sid.Unknown("stiffness", "upper")])
    like = sid.FrfRecord(np.linspace(0.5, 12.0, 300), np.ones((300, 2, 1)), ("40X+", "20X+"), ("40X+",), "mobility")
    truth = unknown.started_at(np.array([1.0, 0.9]))
    record = sid.simulated_record(structure, truth, like, relative_noise=0.02, rng=np.random.default_rng(2))
    found = sid.identify(structure, unknown, record)
    print(found.estimate)
    return found


if __name__ == "__main__":
    main()
