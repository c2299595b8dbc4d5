"""A plate on springs as a component: one iteration and the answer beside those of the whole model, in one run.

``python benchmarks/component.py``: a plate of 10,092 degrees of freedom on four springs of unknown stiffness, 100 lines, 8
sensors amid the plate, 1 % noise. ``--cells 30``: a smaller one. ``--up-to``: highest frequency of the component's modes.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

import structid as sid
from structid.dynamics.factorization import factorizer
from structid.fem import Component, Structure
from structid.forward import FrfProblem

TRUE = np.array([2e4, 3e4, 1e4, 1.5e4])
SIZE, BAND, LINES = (1.2, 0.9), (4.0, 100.0), 100


def plate(cells: int) -> tuple[Structure, str, list[str]]:
    """The whole structure, the load and the sensors."""
    across = cells + 1
    nodes = {
        1 + i + j * across: (i * SIZE[0] / cells, j * SIZE[1] / cells, 0.0)
        for j in range(across)
        for i in range(across)
    }
    first = [1 + i + j * across for j in range(cells) for i in range(cells)]
    skin = sid.Plate(
        "skin", [[n, n + 1, n + 1 + across, n + across] for n in first], youngs_modulus=70e9, density=2700.0, poisson=0.3,
        thickness=0.004, loss_factor=0.01,
    )  # fmt: skip
    corners = [1, across, cells * across + 1, across**2]
    legs = sid.Spring("legs", [f"{n}Z" for n in corners], stiffness=TRUE, loss_factor=0.02)
    place = [(0.3, 0.3), (0.5, 0.5), (0.2, 0.7), (0.8, 0.4), (0.65, 0.85), (0.1, 0.1), (0.9, 0.9), (0.4, 0.15)]
    sensors = [f"{1 + round(x * cells) + round(y * cells) * across}Z" for x, y in place]
    return Structure(nodes, [skin, legs], active=("Z", "RX", "RY")), sensors[0], sensors


def problem(structure: Structure, record: sid.FrfRecord) -> FrfProblem:
    """The springs unknown, 10 % off."""
    unknown = sid.parameters(structure, [sid.Unknown("stiffness", "legs", each=True)])
    return FrfProblem(structure, unknown.started_at(1.1 * TRUE), record)


def main() -> None:
    """Time, fit and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, default=57, help="along each edge")
    parser.add_argument("--up-to", type=float, default=300.0, help="Hz")
    parser.add_argument("--rounds", type=int, default=3, help="timings, alternating")
    given = parser.parse_args()
    whole, load, sensors = plate(given.cells)
    frequency = np.linspace(*BAND, LINES)
    empty = sid.FrfRecord(frequency, np.ones((LINES, len(sensors), 1)), sensors, [load], "accelerance")
    exact = sid.simulated_record(whole, sid.parameters(whole, [sid.Unknown("stiffness", "legs", each=True)]), empty)
    size = 0.01 * np.sqrt((np.abs(exact.values) ** 2).mean(axis=0, keepdims=True)) * np.ones_like(exact.values.real)
    generator = np.random.default_rng(0)
    noise = generator.standard_normal((2, *size.shape)) * size / np.sqrt(2)
    record = replace(exact, values=exact.values + noise[0] + 1j * noise[1], variance=size**2)
    begun = time.perf_counter()
    reduced = replace(whole, components=(Component("plate", "skin", given.up_to, load),))
    made = time.perf_counter() - begun
    print(f"{factorizer().words}; {reduced.reductions[0].words}: {reduced.n_dofs} left, made in {made:.2f} s")
    problems = [problem(structure, record) for structure in (whole, reduced)]
    seconds = np.empty((given.rounds, 2))
    for one in problems:
        one.linearize(one.theta_start)  # patterns and analyses are made once
    for row in seconds:
        for place, one in enumerate(problems):
            begun = time.perf_counter()
            one.linearize(one.theta_start)
            row[place] = time.perf_counter() - begun
    median = np.median(seconds, axis=0)
    ratios = ", ".join(f"{ratio:.0f}" for ratio in seconds[:, 0] / seconds[:, 1])
    print(
        f"one iteration: whole {median[0]:.3f} s, reduced {median[1]:.4f} s; ratio {median[0] / median[1]:.0f} ({ratios})"
    )
    estimates = [sid.estimate(one) for one in problems]
    values, std = (np.array([getattr(one, key) for one in estimates]) for key in ("values", "std"))
    apart = np.abs(values[1] / values[0] - 1).max()
    print(f"answers {values[0] / TRUE} and {values[1] / TRUE} of the truth, standard deviations {std[0] / TRUE}")
    print(f"largest difference {apart:.1e}, {np.abs((values[1] - values[0]) / std[0]).max():.2g} standard deviations")
    fields = [one.predicted(one.parameters.transforms.free(TRUE)) for one in problems]
    error = np.abs(fields[1] - fields[0]).max(axis=(1, 2)) / np.abs(fields[0]).max(axis=(1, 2))
    print(
        f"FRFs at the truth: largest difference {error.max():.1e} of the largest of a line, median {np.median(error):.1e}"
    )


if __name__ == "__main__":
    main()
