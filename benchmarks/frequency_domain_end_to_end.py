"""Large identifications from FRFs, start to end, with wall time and peak memory: a solid and a plate.

``python benchmarks/frequency_domain_end_to_end.py solid``: a block of 100,000 degrees of freedom, 50 lines, 20 sensors,
30 groups whose moduli are unknown, 10 iterations of ``structid identify`` by reduced sweeps (``--reduced 0``: without).
``python benchmarks/frequency_domain_end_to_end.py plate``: a plate of 20,000 elements, every element's stiffness
unknown, held by smoothness alone; a soft spot is looked for. ``--stored 0`` applies the Jacobian from fields.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import structid as sid
from frequency_domain_solid import errors, identify, simulate, write_study
from structid.dynamics.factorization import factorizer
from structid.forward.frf.response import response
from structid.inversion.search.least_squares import dense_search_fits
from structid.unknowns import Smoothness, penalty

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from mesh_cases import empty_record, solid


class Clock:
    """Lines with the wall time since the start and the peak memory."""

    def __init__(self) -> None:
        self.start = time.perf_counter()

    def say(self, text: str) -> None:
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        print(f"{time.perf_counter() - self.start:8.1f} s  {peak:6.2f} GB  {text}", flush=True)


def main() -> None:
    """Run one of the cases."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("case", choices=("solid", "plate"))
    parser.add_argument("--shape", type=int, nargs="+", help="elements along each edge")
    parser.add_argument("--lines", type=int)
    parser.add_argument("--iterations", type=int)
    parser.add_argument("--noise", type=float, default=0.01, help="part of each channel's rms")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", type=Path, help="solid: where its files are kept")
    parser.add_argument("--reduced", type=float, help="solid: error of reduced sweeps; 0: every line")
    parser.add_argument("--simulate", action="store_true", help="solid: write mesh and record, and stop")
    parser.add_argument("--stored", type=float, default=1e9, help="plate: largest Jacobian that is stored, bytes")
    parser.add_argument("--strength", type=float, default=100.0, help="plate: of the smoothness")
    parser.add_argument("--draws", type=int, default=16, help="plate: posterior draws")
    given = parser.parse_args()
    clock = Clock()
    if not given.simulate:
        clock.say(factorizer().words)
    (run_solid if given.case == "solid" else run_plate)(given, clock)


def measured(given: argparse.Namespace, model: sid.Structure, unknown: sid.Parameters, truth: np.ndarray, lines: list):
    """Simulated FRFs with noise of its standard deviation."""
    generator = np.random.default_rng(given.seed)
    record = empty_record(model, np.linspace(*lines, given.lines), 20)
    exact = response(model, unknown, record).values_at(truth)
    size = given.noise * np.sqrt((np.abs(exact) ** 2).mean(axis=0, keepdims=True)) * np.ones_like(exact.real)
    noise = generator.standard_normal((2, *exact.shape)) * size / np.sqrt(2)
    return replace(record, values=exact + noise[0] + 1j * noise[1], variance=size**2)


def run_solid(given: argparse.Namespace, clock: Clock) -> None:
    """Simulate in one process, identify by the command line in another, and compare."""
    shape, lines = tuple(given.shape or (45, 25, 27)), given.lines or 50
    with tempfile.TemporaryDirectory() as place:
        folder = given.folder or Path(place)
        command = [
            sys.executable,
            __file__,
            "solid",
            "--simulate",
            "--folder",
            str(folder),
            "--noise",
            str(given.noise),
        ]
        command += ["--seed", str(given.seed), "--lines", str(lines), "--shape", *map(str, shape)]
        if given.simulate:
            simulate(folder, shape, lines, given.noise, given.seed)
            return
        subprocess.run(command, check=True)
        clock.say("record simulated by another process")
        write_study(folder, given.iterations or 10, given.reduced)
        used = identify(folder)
        relative, off = errors(folder)
    print(
        f"structid identify: wall {used['wall']:.0f} s, processor {used['processor']:.0f} s, peak memory"
        f" {used['peak']:.2f} GB"
    )
    print(
        f"errors of the {len(off)} moduli: largest {np.abs(relative).max():.2%}; in standard deviations rms"
        f" {np.sqrt((off**2).mean()):.2f}, largest {np.abs(off).max():.2f}"
    )


def run_plate(given: argparse.Namespace, clock: Clock) -> None:
    shape, given.lines = tuple(given.shape or (200, 100)), given.lines or 30
    structure = solid(shape, (2.0, 1.0), 1)
    unknown = sid.parameters(structure, [sid.Unknown("young", "part1", each=True)])
    middle = np.array([np.mean([structure.nodes[n] for n in row], axis=0) for row in structure.elements[0].nodes])
    place = np.array([1.3, 0.6])
    truth = 1 - 0.3 * np.exp(-((middle - place) ** 2).sum(axis=1) / (2 * 0.12**2))
    clock.say(f"{structure.n_dofs} degrees of freedom, {unknown.n_params} parameters, {given.lines} lines")
    record = measured(given, structure, unknown, truth, [50.0, 2500.0])
    smooth = penalty(structure, unknown, Smoothness("young", "part1", given.strength)).scaled(given.strength)
    at = sid.FrfProblem(structure, unknown.coupled(smooth), record)
    clock.say(f"smoothness of {len(smooth.target)} pairs; {dense_search_fits(len(at.names), at.n_data)[1]}")
    whole = at.linearize_operator
    object.__setattr__(at, "linearize_operator", lambda theta: whole(theta, given.stored))
    found = sid.estimate(
        at,
        sid.MatrixFree(max_iterations=given.iterations or 50, draws=given.draws),
        progress=lambda _, count, cost: clock.say(f"iteration {count}: sum of squares {cost:.6g}"),
    )
    clock.say(f"{found.status.value}: {found.message}")
    lowest = int(found.values.argmin())
    print(f"chi-square {found.goodness.chi_square:.0f} of {found.goodness.n_data} data")
    print(
        f"least stiffness {found.values[lowest]:.3f} at {middle[lowest].round(2)} m; true {truth.min():.3f} at {place} m"
    )
    rms = np.sqrt(((found.values - truth) ** 2).mean())
    print(f"rms error {rms:.4f}; median standard deviation {np.nanmedian(found.std):.4f}")
    inside = np.abs(found.values - truth) <= 1.96 * found.std
    print(f"95 % intervals that hold the truth: {inside.mean():.1%}")


if __name__ == "__main__":
    main()
