"""Cost of one Gauss-Newton step (residual and Jacobian) against a plain sweep of the same FRFs, side by side.

300-element beam, 60 parameters, 5 sensors, 1 load, 200 frequencies, one thread: ``python benchmarks/gauss_newton_step.py``.
The plain sweep solves for the load only, with the same factorizer; every figure is a median over pairs of runs.
"""

from __future__ import annotations

import os
import statistics
import time
from dataclasses import replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import structid as sid
from structid.forward.frf.response import response

N_ELEMENTS, N_GROUPS, N_LINES, PAIRS = 300, 30, 200, 9


def main() -> None:
    """Print the ratio."""
    nodes = {i: float(i) for i in range(N_ELEMENTS + 1)}
    beam = sid.Beam("beam", [[i, i + 1] for i in range(N_ELEMENTS)], 1.0, 1e6, loss_factor=0.01)
    structure = sid.Structure(nodes, [beam], ["0Y", "0RZ"])
    size = N_ELEMENTS // N_GROUPS
    groups = [f"beam:{i * size + 1}-{(i + 1) * size}" for i in range(N_GROUPS)]
    unknown = sid.parameters(structure, [sid.Unknown(p, g) for p in ("mass", "bending_stiffness") for g in groups])
    sensors = tuple(f"{N_ELEMENTS * (i + 1) // 5}Y+" for i in range(5))
    blank = np.ones((N_LINES, 5, 1))
    record = sid.FrfRecord(np.linspace(0.01, 2.0, N_LINES), blank, sensors, (f"{N_ELEMENTS}Y+",), "accelerance")
    model = response(structure, unknown, record)
    exact = replace(record, values=model.values_at(unknown.start))
    record = sid.with_declared_noise(exact, relative=0.01)
    problem = sid.FrfProblem(structure, unknown, record)
    theta = problem.theta_start
    ratios, sweeps, steps = [], [], []
    for _ in range(PAIRS):
        start = time.process_time()
        model.values_at(unknown.start)
        middle = time.process_time()
        at = problem.linearize(theta)
        np.linalg.lstsq(at.jacobian, at.residual, rcond=None)
        end = time.process_time()
        sweeps.append(middle - start)
        steps.append(end - middle)
        ratios.append(steps[-1] / sweeps[-1])
    print(f"parameters {unknown.n_params}, degrees of freedom {structure.n_dofs}, lines {N_LINES}, sensors 5")
    print(f"plain sweep        {statistics.median(sweeps):8.3f} s (median of {PAIRS}, processor time)")
    print(f"Gauss-Newton step  {statistics.median(steps):8.3f} s")
    print(
        f"ratio              {statistics.median(ratios):8.2f}   ({min(ratios):.2f} to {max(ratios):.2f}); aim: at most 3"
    )


if __name__ == "__main__":
    main()
