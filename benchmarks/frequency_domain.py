"""Frequency responses of large models: every figure is a ratio of processor times, both sides in one run.

``python benchmarks/frequency_domain.py`` prints the table, ``--json FILE`` writes it as well; ``--only WORD`` runs the
rows with that word, ``--repeats`` sets how many times each side runs (medians), in turn. One thread.
Meshes are clamped plates (plane strain) and blocks of scikit-fem; loss factor 0.02, one load, 20 sensors.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["MKL_NUM_THREADS"] = "1"
os.environ["OMP_NUM_THREADS"] = "1"
os.environ["STRUCTID_THREADS"] = "1"

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

import structid as sid
from structid.dynamics.factorization import factorizer, installed_factorizers
from structid.dynamics.normal_modes import modes
from structid.dynamics.receptance import reduced_sweep, single_blas
from structid.forward.frf.response import Response, ResponseCache, response
from structid.forward.frf.solvers import SparseSolver

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "published"))
from arrow_system import ArrowSystem
from mesh_cases import empty_record, group_unknowns, solid

PLATES = {"2-D 1k": (32, 16), "2-D 10k": (100, 50), "2-D 50k": (224, 112)}
BLOCKS = {"3-D 4k": (16, 9, 7), "3-D 10k": (20, 13, 12)}
SIZES = {2: (2.0, 1.0), 3: (1.5, 1.0, 1.0)}


@dataclass(frozen=True)
class Row:
    """One ratio: `time` of the first side over that of the second, or its inverse where `at_least`."""

    what: str
    ratio: float
    bar: float
    at_least: bool
    note: str

    @property
    def met(self) -> bool:
        return self.ratio >= self.bar if self.at_least else self.ratio <= self.bar

    @property
    def table(self) -> dict[str, object]:
        """What a table of all benchmarks shows."""
        bar = f"{'>=' if self.at_least else '<='} {self.bar:g}"
        return {"what": self.what, "bar": bar, "figure": self.ratio, "met": self.met, "detail": self.note}


def rows(quick: bool) -> list[dict[str, object]]:
    """All rows as tables; `quick` takes three repeats and leaves the largest plate and block out."""
    return [row.table for made in BENCHMARKS.values() for row in made(3 if quick else 5, quick)]


def use_tiny_models() -> None:
    """Put models of some hundred degrees of freedom in the place of all others."""
    BLOCKS.update(dict.fromkeys(BLOCKS, (16, 4, 4)))
    PLATES.update(dict.fromkeys(PLATES, (30, 10)))


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true", help="leave the largest plate and block out")
    parser.add_argument("--only", default="")
    parser.add_argument(
        "--tiny", action="store_true", help="models of some hundred degrees of freedom, to see that all of it runs"
    )
    given = parser.parse_args()
    if given.tiny:
        use_tiny_models()
    print(f"factorizers: {', '.join(factorizer(name).words for name in installed_factorizers())}")
    print(f"medians of {given.repeats}, one thread, processor time\n")
    print(f"{'what':64s} {'ratio':>8s} {'bar':>9s}        note")
    made = []
    for name, benchmark in BENCHMARKS.items():
        if given.only in name:
            for row in benchmark(given.repeats, given.quick):
                made.append(row.table)
                bar, met = row.table["bar"], "met   " if row.met else "MISSED"
                print(f"{row.what:64s} {row.ratio:8.3f} {bar:>9s} {met} {row.note}", flush=True)
    if given.json:
        given.json.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")


def medians(sides: list[Callable[[], object]], repeats: int) -> list[float]:
    """Median processor time of each side, run in turn; the first round warms up and does not count."""
    taken: list[list[float]] = [[] for _ in sides]
    for turn in range(repeats + 1):
        for own, side in zip(taken, sides, strict=True):
            start = time.process_time()
            side()
            if turn:
                own.append(time.process_time() - start)
    return [float(np.median(own)) for own in taken]


def problem(
    shape: tuple[int, ...], n_lines: int, each: bool = False, name: str | None = None, n_params: int = 10
) -> sid.FrfProblem:
    """FRFs of a plate or block with parameters of groups, or the stiffness of every element, its noise 1 %."""
    structure = solid(shape, SIZES[len(shape)], 10 if n_params <= 10 else 16)
    record = empty_record(structure, np.linspace(50.0, 2000.0, n_lines), 20)
    sets = [element.name for element in structure.elements]
    unknowns = (
        [sid.Unknown("young", part, each=True) for part in sets] if each else group_unknowns(structure)[:n_params]
    )
    made = sid.parameters(structure, unknowns)
    record = replace(record, values=response(structure, made, record).values_at(made.start))
    noisy = replace(record, variance=(0.01 * np.abs(record.values)) ** 2)
    return sid.FrfProblem(structure, made, noisy, cache=ResponseCache(name))


def shapes(quick: bool) -> dict[str, tuple[int, ...]]:
    """Elements along each side of every mesh by its name; one block, of the size that `quick` has time for."""
    plates = {name: shape for name, shape in PLATES.items() if not (quick and name == "2-D 50k")}
    return {**plates, block_name(quick): BLOCKS[block_name(quick)]}


def block_name(quick: bool) -> str:
    """Name of the block of hexahedra that is measured."""
    return "3-D 4k" if quick else "3-D 10k"


def jacobian_rows(repeats: int, quick: bool) -> Iterator[Row]:
    for name in installed_factorizers():
        for label, shape in shapes(quick).items():
            at = problem(shape, 6 if label != "2-D 50k" else 3, name=name, n_params=30)
            theta = at.theta_start
            plain, whole = medians(
                [partial(at.model.values_at, at.unknowns.start), partial(at.linearize, theta)], repeats
            )
            bar = 1.6 if len(shape) == 2 else 1.2
            note = (
                f"{at.structure.n_dofs} DOFs, 30 parameters, plain line {1e3 * plain / len(at.record.frequency):.1f} ms"
            )
            yield Row(f"residual + Jacobian / plain sweep, {label}, {name}", whole / plain, bar, False, note)


def every_element_rows(repeats: int, quick: bool) -> Iterator[Row]:
    for label, shape in shapes(quick).items():
        if label in ("2-D 1k", "2-D 50k"):
            continue
        few, all_of_them = problem(shape, 4), problem(shape, 4, each=True)
        ten, every = medians(
            [
                partial(few.model.derivatives_at, few.unknowns.start),
                partial(all_of_them.model.derivatives_at, all_of_them.unknowns.start),
            ],
            repeats,
        )
        note = f"{all_of_them.parameters.n_params} and {few.parameters.n_params} parameters"
        yield Row(f"Jacobian of every element / of 10 groups, {label}", every / ten, 1.1, False, note)


def arrow_rows(repeats: int, quick: bool) -> Iterator[Row]:
    def cantilever(factor: float) -> sid.Structure:
        stiffness = np.linspace(1.0, 0.8, 20) * np.linspace(1.0, factor, 20)
        beam = sid.Beam("beam", [[i, i + 1] for i in range(20)], np.linspace(1.0, 1.2, 20), stiffness)
        return sid.Structure({i: float(i) for i in range(21)}, [beam], ["0Y", "0RZ"])

    unknowns = [sid.Unknown(p, "beam", each=True, positive=False) for p in ("mass", "bending_stiffness")]
    postulated, actual = cantilever(1.0), cantilever(1.02)
    outputs = ("5Y+", "10Y+", "15Y+", "20Y+")
    record = sid.FrfRecord(np.linspace(0.001, 0.6, 30), np.ones((30, 4, 1)), outputs, ("20Y+",), "receptance")
    known = sid.parameters(actual, unknowns)
    record = replace(record, values=response(actual, known, record).values_at(known.start))
    unknown = sid.parameters(postulated, unknowns)
    at = sid.FrfProblem(postulated, unknown, record, "equation")

    def short() -> np.ndarray:
        linear = at.linearize(at.theta_start)
        return -np.linalg.lstsq(linear.jacobian, linear.residual, rcond=None)[0]

    def arrow() -> np.ndarray:
        return ArrowSystem(postulated, unknown, record).step()

    ours, dense = medians([short, arrow], repeats)
    off = np.abs(short() - arrow()).max() / np.abs(arrow()).max()
    yield Row(
        "dense arrow system / ours, N = 20, 4 sensors, 30 lines", dense / ours, 50, True, f"steps differ by {off:.0e}"
    )


def matrix_free_rows(repeats: int, quick: bool) -> Iterator[Row]:
    generator = np.random.default_rng(0)
    for label, shape in shapes(quick).items():
        if label == "2-D 1k":
            continue
        at = problem(shape, 20 if label != "2-D 50k" else 10, each=True)
        products = at.linearize_operator(at.theta_start, stored_bytes=0)
        v, u = generator.standard_normal(products.n_params), generator.standard_normal(products.n_data)
        off = abs(u @ products.forward(v) - v @ products.adjoint(u)) / abs(u @ products.forward(v))
        there, back, line = medians(
            [
                partial(products.forward, v),
                partial(products.adjoint, u),
                partial(at.model.values_at, at.unknowns.start),
            ],
            repeats,
        )
        note = f"J v {there / line:.3f}, J'u {back / line:.3f}, adjoint identity to {off:.0e}"
        bar = 0.12 if len(shape) == 2 else 0.05
        yield Row(f"J v + J'u without J / one forward line, {label}", (there + back) / line, bar, False, note)


def sparse_solver(model: Response) -> SparseSolver:
    assert isinstance(model.solver, SparseSolver)
    return model.solver


def factorizer_rows(repeats: int, quick: bool) -> Iterator[Row]:
    for label, shape in shapes(quick).items():
        if label == "2-D 1k":
            continue
        at = problem(shape, 2)
        model = at.model
        lines, right = sparse_solver(model), model.channels.columns.toarray()
        entries, pattern = (
            lines.stiffness(at.unknowns.start, model.fixed_coefficients).entries(1),
            lines.pattern.indices,
        )
        n = len(right)
        matrix = sparse.csc_matrix((entries, *pattern), (n, n))
        analyses = {name: factorizer(name).analyse(*pattern, right.any(axis=1)) for name in installed_factorizers()}

        def ours(name: str, analyses=analyses, entries=entries, right=right) -> np.ndarray:
            return analyses[name].factor(entries).solve(right)

        def default(matrix=matrix, right=right) -> np.ndarray:
            return splu(matrix).solve(right.astype(complex))

        with single_blas():
            taken = medians([default, *(lambda name=name: ours(name) for name in analyses)], repeats)
        default_time, times = taken[0], dict(zip(analyses, taken[1:], strict=True))
        note = f"{n} DOFs, factor and {right.shape[1]} right-hand sides; default {default_time:.3f} s"
        yield Row(f"SciPy's splu defaults / ours, {label}", default_time / times["superlu"], 1.4, True, note)
        if "pardiso" in times:
            note = ", ".join(f"{name} {times[name]:.3f} s" for name in times)
            yield Row(f"our SuperLU / PARDISO, {label}", times["superlu"] / times["pardiso"], 2.0, True, note)


def reduced_rows(repeats: int, quick: bool) -> Iterator[Row]:
    label = block_name(quick)
    at = problem(BLOCKS[label], 2)
    structure = at.structure
    lowest = modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=11).frequency
    record = empty_record(structure, np.linspace(0.3 * lowest[0], lowest[10], 50), 20)
    for name in installed_factorizers():
        model = response(structure, at.parameters, record, cache=ResponseCache(name))
        lines, channels = sparse_solver(model), model.channels
        stiffness, pattern = lines.stiffness(at.unknowns.start, model.fixed_coefficients), lines.pattern.indices
        loads = channels.columns[:, np.unique(channels.inputs[0])].toarray()
        sides = [
            lambda s=stiffness, p=pattern, b=loads, c=channels: reduced_sweep(s, p, b, c.sensors, 1e-6),
            lambda m=model: m.values_at(at.unknowns.start),
        ]
        with single_blas():
            reduced, full = medians(sides, 1 if name == "superlu" else repeats)
            found, exact = sides[0](), sides[1]()
        error = (np.abs(found.values - exact).max((1, 2)) / np.abs(exact).max((1, 2))).max()
        note = (
            f"{structure.n_dofs} DOFs, {found.n_factorizations} factorizations, {found.n_basis} vectors, verified"
            f" {found.error:.0e}, true largest error {error:.0e}"
        )
        yield Row(f"full sweep / reduced, {label}, 50 lines, 10 modes, {name}", full / reduced, 5, True, note)
        yield linearized(
            response(structure, at.parameters, record, reduced=1e-6, cache=ResponseCache(name)),
            model,
            at.unknowns.start,
            f"{label}, 50 lines, {name}",
        )


def linearized(reduced: Response, full: Response, start: np.ndarray, label: str) -> Row:
    """Values and Jacobian of 20 sensors from one reduced sweep; each side once, at values that it has not seen."""
    reduced.derivatives_at(1.1 * start)  # warms up
    full.derivatives_at(1.1 * start)
    taken = []
    for side in (reduced, full):
        begin = time.process_time()
        side.derivatives_at(start)
        taken.append(time.process_time() - begin)
    short, long = taken
    values, slopes = reduced.derivatives_at(start)
    exact, true = full.derivatives_at(start)
    error = (np.abs(values - exact).max((1, 2)) / np.abs(exact).max((1, 2))).max()
    size = np.linalg.norm(true, axis=(1, 2))
    off = np.sqrt(((np.linalg.norm(slopes - true, axis=(1, 2)) / size) ** 2).mean(axis=1)).max()
    sweep = reduced.solver.last_sweep
    note = f"{sweep.n_basis} vectors; true largest error {error:.0e}, of derivatives (rms over parameters) {off:.0e}"
    return Row(f"full values + Jacobian / reduced, {label}", long / short, 5, True, note)


BENCHMARKS = {
    "jacobian": jacobian_rows,
    "every_element": every_element_rows,
    "arrow": arrow_rows,
    "matrix_free": matrix_free_rows,
    "factorizer": factorizer_rows,
    "reduced": reduced_rows,
}


if __name__ == "__main__":
    main()
