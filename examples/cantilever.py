"""Six masses and six bending stiffnesses of a cantilever from two accelerometers: a twin with 1 % noise."""

import numpy as np

import structid as sid


def main() -> sid.Identification:
    """Simulate a test, identify from values 15 % off, and compare."""
    mass, stiffness = [1.0, 0.9, 1.1, 1.2, 0.8, 1.0], [10.0, 11.0, 9.0, 8.0, 9.5, 10.0]
    beam = sid.Beam("beam", [[i, i + 1] for i in range(6)], mass, stiffness, loss_factor=0.02)
    structure = sid.Structure({i: float(i) for i in range(7)}, [beam], fixed=["0Y", "0RZ"])
    unknown = [sid.Unknown(p, "beam", each=True) for p in ("mass", "bending_stiffness")]
    truth = sid.parameters(structure, [*unknown, sid.Unknown("loss_factor", "beam")])

    rng = np.random.default_rng(1)
    lines = np.linspace(0.02, 1.6, 400)
    like = sid.FrfRecord(lines, np.ones((400, 2, 1)), ("6Y+", "3Y+"), ("6Y+",), "accelerance")
    record = sid.simulated_record(structure, truth, like, relative_noise=0.01, rng=rng)

    start = truth.started_at(truth.start * np.exp(0.15 * rng.standard_normal(truth.n_params)))
    found = sid.identify(structure, start, record)
    print(found.estimate)
    print(f"largest error {np.abs(found.estimate.values / truth.start - 1).max():.2%}")
    return found


if __name__ == "__main__":
    main()
