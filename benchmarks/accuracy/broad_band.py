"""How far from the answer a search may start: FRFs over a broad band, few sensors, every element unknown.

Mass, stiffness and stiffness-like damping of every element are unknown; true damping is C = 0.01 M + 0.001 K, of which
the mass-like part is known. Start k has seed k: masses and stiffnesses are off in a random log-normal direction with
exactly the stated RMS of the log error, each damping coefficient by a factor of e, up or down; the noise, 1 % of each
value, is of the same seed. Cases named impact_... take accelerations and the force of one hammer impact instead, with
noise of 1 % of each channel's largest value. A start counts as converged if the logarithm of every parameter ends
within 5 standard deviations, and its failure as recognized if chi-square then rejects the fit. Results are kept as JSON
lines, one a start, so that a run can be stopped and taken up again.

    python benchmarks/accuracy/broad_band.py run --case cantilever --rms 50 --repeats 100 --out results [--workers 1]
    python benchmarks/accuracy/broad_band.py table --out results
    python benchmarks/accuracy/broad_band.py picture --out results --image docs/images/convergence.png
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from functools import cache
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from broad_band_cases import FINE, Case, case, measured
from scipy import special

import structid as sid
from structid.core.arrays import FloatArray
from structid.core.errors import SingularModelError
from structid.forward.frf.continuation import START_ERROR, thinned_lines
from structid.inversion import minimize

TARGETS = {("cantilever", 50): 99, ("cantilever", 80): 90, ("free_beam", 30): 99, ("free_beam", 50): 90}
#: Beyond these, the last steps go stretch by stretch to spare memory and time.
MANY_LINES = 20_000
METHODS = ("continuation", "levenberg_marquardt", "classical")
KINDS = ("mass", "stiffness", "viscous_damping")


@cache
def bound(name: str, n_lines: int) -> FloatArray:
    """Cramer-Rao bound of the relative standard deviations at the truth."""
    one = case(name, n_lines)
    record = measured(one, np.random.default_rng(0))
    problem = sid.FrfProblem(one.structure, one.truth, record)
    triangle = np.linalg.qr(problem.linearize(one.truth.theta_start).jacobian, mode="r")
    return np.linalg.norm(np.linalg.inv(triangle), axis=1)


def started(truth: sid.Parameters, rms: float, rng: np.random.Generator) -> sid.Parameters:
    """Initial values off by `rms` in the logarithm of masses and stiffnesses, and by a factor of e in damping."""
    off = rng.standard_normal(truth.n_params)
    damping = np.array(truth.kinds) == KINDS[2]
    off[~damping] *= rms / np.sqrt(np.mean(off[~damping] ** 2))
    off[damping] = np.sign(off[damping])
    return truth.started_at(truth.start * np.exp(off))


def one_start(arguments: tuple[str, int, str, float, int]) -> dict[str, object]:
    """One start: where it ended and what it says of itself."""
    name, n_lines, method, rms, seed = arguments
    one, rng = case(name, n_lines), np.random.default_rng(seed)
    record = measured(one, rng)
    start = started(one.truth, rms / 100, rng)
    began = time.process_time()
    if method == "continuation":
        problem = sid.FrfProblem(one.structure, start, record, start_error=START_ERROR)
        many = len(record.frequency) > MANY_LINES
        part, plans = problem.subsampled(), problem.schedules()
        searched, sample = (part or problem, None) if many else (problem, part)
        found = sid.estimate(searched, plans=plans, search=sid.Search(restarts=2), sample=sample)
        searches = found.search.n_starts
        values, std, chi_square, accepted = found.values, found.std, found.chi_square_per_dof, agrees(found)
        if many and accepted:
            values, std, chi_square, accepted = polished(problem, found.theta)
    else:
        values, std, chi_square, accepted = plain_search(one, record, start, method)
        searches = 1
    seconds = time.process_time() - began
    limit = bound(name, n_lines)
    damping = np.array(one.truth.kinds) == KINDS[2]
    with np.errstate(all="ignore"):
        error = np.log(np.maximum(values / one.truth.start, 1e-300))
        worst = float(np.max(np.abs(error) / (std / values)))
    return {
        "case": name,
        "lines": n_lines,
        "method": method,
        "rms": rms,
        "seed": seed,
        "converged": bool(worst <= 5),
        "worst": worst,
        "accepted": bool(accepted),
        "chi_square": float(chi_square),
        "error": [float(np.sqrt(np.mean(error[part] ** 2))) for part in (~damping, damping)],
        "bound": [float(np.sqrt(np.mean(limit[part] ** 2))) for part in (~damping, damping)],
        "normalized": float(np.sqrt(np.mean((error / limit) ** 2))),
        "searches": searches,
        "seconds": seconds,
    }


def agrees(found: sid.Estimate) -> bool:
    """Whether chi-square lets the fit pass."""
    return found.covariance_basis == "noise"


def polished(problem: sid.FrfProblem, theta: FloatArray) -> tuple[FloatArray, FloatArray, float, bool]:
    """Two Gauss-Newton steps on all lines from the minimum of a part of them, stretch by stretch to spare memory."""
    count = len(problem.record.frequency)
    stretches = [np.arange(first, min(first + 5000, count)) for first in range(0, count, 5000)]
    parts = [replace(problem, record=problem.record.lines(lines)) for lines in stretches]
    for _ in range(2):
        information, gradient = np.zeros((len(theta),) * 2), np.zeros(len(theta))
        for part in parts:
            at = part.linearize(theta)
            information += at.jacobian.T @ at.jacobian
            gradient += at.jacobian.T @ at.residual
        theta = theta - np.linalg.solve(information, gradient)
    freedom = problem.n_data - len(theta)
    chi_square = sum(float(np.sum(part.residual(theta) ** 2)) for part in parts)
    std = np.sqrt(np.diag(np.linalg.inv(information))) * problem.slope(theta)
    accepted = special.gammaincc(freedom / 2, chi_square / 2) >= 1e-3
    return problem.physical(theta), std, chi_square / freedom, bool(accepted)


def plain_search(
    one: Case, record: sid.FrfRecord, start: sid.Parameters, method: str
) -> tuple[FloatArray, FloatArray, float, bool]:
    """Values, standard deviations, chi-square per degree of freedom and verdict of a search without any help.

    On lines that are a logarithmic step apart (about 2000), as the continuation searches too. The classical iteration
    weights by equation error; ten Gauss-Newton steps on the output error follow it, which favours it.
    """
    used = record.lines(thinned_lines(record.omega))
    problem = sid.FrfProblem(one.structure, start, used)
    n = len(start.start)
    try:
        with np.errstate(all="ignore"):
            theta = ended(problem, method)
            at = problem.linearize(theta)
            std = np.linalg.norm(np.linalg.pinv(np.linalg.qr(at.jacobian, mode="r")), axis=1) * problem.slope(theta)
    except (np.linalg.LinAlgError, SingularModelError, ValueError):  # it ran away to where nothing can be computed
        return np.full(n, np.nan), np.ones(n), np.inf, False
    chi_square = float(at.residual @ at.residual) / (problem.n_data - n)
    return problem.physical(theta), std, chi_square, chi_square < 1 + 4 * np.sqrt(2 / problem.n_data)


def ended(problem: sid.FrfProblem, method: str) -> FloatArray:
    """Free variables at the end of a plain search; NaN where it left the positive numbers."""
    if method == "levenberg_marquardt":
        settings = sid.LevenbergMarquardt(max_iterations=100, acceleration=0)
        return minimize(problem, settings, problem.theta_start).theta
    theta = classical(replace(problem, form="equation"))
    return minimize(problem, sid.GaussNewton(max_iterations=10), theta).theta if np.isfinite(theta).all() else theta


def classical(problem: sid.FrfProblem, n_iterations: int = 40) -> FloatArray:
    """The iteration of Norris (1986), Eqs. (4.17) and (4.26): full steps in the parameters themselves."""
    values = np.array(problem.parameters.start)
    linear = replace(
        problem.parameters, transforms=replace(problem.parameters.transforms, kinds=("linear",) * len(values))
    )
    plain = replace(problem, parameters=linear)
    with np.errstate(all="ignore"):
        for _ in range(n_iterations):
            try:
                at = plain.linearize(values)
                step = -np.linalg.lstsq(at.jacobian, at.residual, rcond=None)[0]
            except (np.linalg.LinAlgError, SingularModelError):
                return np.full(len(values), np.nan)
            values = values + step
            if np.abs(step / values).max() < 1e-9:
                break
    return np.log(values) if (values > 0).all() else np.full(len(values), np.nan)


def run(chosen: argparse.Namespace) -> None:
    """Make the starts that the output folder lacks."""
    folder = Path(chosen.out)
    folder.mkdir(parents=True, exist_ok=True)
    done = {(r["case"], r["lines"], r["method"], r["rms"], r["seed"]) for r in results(folder)}
    wanted = [
        (name, chosen.lines, method, rms, seed)
        for name in chosen.case
        for rms in chosen.rms
        for method in chosen.method
        for seed in range(chosen.seed, chosen.seed + chosen.repeats)
    ]
    wanted = [arguments for arguments in wanted if arguments not in done]
    with ProcessPoolExecutor(chosen.workers) as pool:
        for future in as_completed([pool.submit(one_start, arguments) for arguments in wanted]):
            with (folder / f"{os.getpid()}.jsonl").open("a") as file:
                file.write(json.dumps(future.result()) + "\n")


def results(folder: Path) -> list[dict]:
    """All starts in the folder."""
    return [json.loads(line) for path in sorted(folder.glob("*.jsonl")) for line in path.read_text().splitlines()]


def cells(folder: Path) -> dict[tuple, list[dict]]:
    """Starts by case, lines, method and initial error."""
    found = defaultdict(list)
    for result in results(folder):
        found[(result["case"], result["lines"], result["method"], result["rms"])].append(result)
    return dict(sorted(found.items()))


def wilson(successes: int, count: int) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927), %."""
    z = 1.959964
    share = successes / count
    centre = (share + z**2 / (2 * count)) / (1 + z**2 / count)
    half = z / (1 + z**2 / count) * np.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
    return 100 * (centre - half), 100 * (centre + half)


def table(folder: Path) -> None:
    """Print one row a cell."""
    print("converged: every parameter within 5 standard deviations; [95 % Wilson interval]; target where there is one")
    print("error/bound: RMS over all parameters of error / Cramer-Rao bound, over converged starts; m and k, c: RMS")
    print("error and its bound; missed: not converged, yet accepted by chi-square; refused: converged, yet rejected")
    for (name, lines, method, rms), rows in cells(folder).items():
        good = [r for r in rows if r["converged"]]
        low, high = wilson(len(good), len(rows))
        target = TARGETS.get((name, rms)) if method == "continuation" and lines == 0 else None
        missed = sum(r["accepted"] and not r["converged"] for r in rows)
        refused = sum(r["converged"] and not r["accepted"] for r in rows)
        seeds = sorted(r["seed"] for r in rows if not r["converged"])
        shown = 8100 if name.startswith("impact") else lines or len(FINE)
        print(
            f"{name:17s} {shown:6d} lines {method:20s} from {rms:4g} %: {len(good):3d} of {len(rows):3d}"
            f" [{low:.0f}, {high:.0f}] %" + (f", target {target} %" if target else "")
        )
        if (
            good and method == "continuation"
        ):  # the others stop on part of the lines, to which the bound does not belong
            error, limit = (np.sqrt(np.mean(np.square([r[key] for r in good]), axis=0)) for key in ("error", "bound"))
            ratio = np.sqrt(np.mean([r["normalized"] ** 2 for r in good]))
            print(
                f"    error/bound {ratio:.3f} (target 0.90 to 1.10); m and k {error[0]:.2e} / {limit[0]:.2e}, c {error[1]:.2e} /"
                f" {limit[1]:.2e}; chi-square {np.mean([r['chi_square'] for r in good]):.4f}"
            )
        print(
            f"    missed {missed}, refused {refused}; searches {np.mean([r['searches'] for r in rows]):.2f} a start;"
            f" {np.median([r['seconds'] for r in rows]):.1f} s a start (median CPU)"
            + (f"; failed seeds {seeds[:12]}" + (" ..." if len(seeds) > 12 else "") if seeds else "")
        )


def picture(folder: Path, image: Path) -> None:
    """Share of starts that converge against the initial error, one panel a structure."""
    import matplotlib.pyplot as plt

    from structid.report.drawing.palette import BLUE, GRID, MUTED, ORANGE, VERMILLION

    styles = {
        "continuation": ("continuation from the right half-plane", VERMILLION, "o", 1.0),
        "levenberg_marquardt": ("Levenberg-Marquardt", BLUE, "s", 0.94),
        "classical": ("classical iteration (chapter 4)", ORANGE, "^", 1.06),
    }
    found = cells(folder)
    panels = [
        ("cantilever", "cantilever, 6 elements, 18 unknowns, 1 sensor"),
        ("free_beam", "free beam, 15 elements, 45 unknowns, 2 sensors"),
    ]
    panels = [panel for panel in panels if any(key[0] == panel[0] and key[1] == 0 for key in found)]
    starts: list[int] = []
    figure, axes = plt.subplots(1, len(panels), figsize=(5.2 * len(panels), 3.9), squeeze=False, sharey=True)
    for axis, (name, title) in zip(axes[0], panels, strict=True):
        for method, (label, colour, marker, beside) in styles.items():
            rows = [(k[3], v) for k, v in found.items() if k[:3] == (name, 0, method)]
            if not rows:
                continue
            at = beside * np.array([rms for rms, _ in rows])
            counts = [(sum(r["converged"] for r in v), len(v)) for _, v in rows]
            share = np.array([100 * good / count for good, count in counts])
            bars = np.array([wilson(*pair) for pair in counts]).T
            error = np.maximum([share - bars[0], bars[1] - share], 0)
            starts.extend(count for _, count in counts)
            axis.errorbar(at, share, error, color=colour, marker=marker, label=label, capsize=3, lw=1.6, ms=6)
        axis.set(
            xscale="log",
            xlim=(0.8, 100),
            xlabel="RMS error of the initial masses and stiffnesses (%)",
            ylim=(-4, 104),
            title=title,
        )
        axis.set_xticks([1, 3, 10, 30, 50, 80], ["1", "3", "10", "30", "50", "80"])
        axis.minorticks_off()
        axis.title.set_fontsize(10)
        axis.grid(color=GRID)
    axes[0, 0].set_ylabel("starts that converge (%)")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", bbox_to_anchor=(0.5, 0.045), ncols=3, frameon=False, fontsize=9)
    note = f"{min(starts)} to {max(starts)} starts a point, 95 % Wilson intervals; markers set beside each other"
    figure.text(0.5, 0.015, note, ha="center", fontsize=8, color=MUTED)
    figure.tight_layout(rect=(0, 0.11, 1, 1))
    image.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(image, dpi=160)


def main() -> None:
    """Run starts, print the table or draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("run", "table", "picture"))
    parser.add_argument("--case", nargs="+", default=["cantilever", "free_beam"])
    parser.add_argument("--rms", nargs="+", type=float, default=[50.0], help="initial RMS log errors, %%")
    parser.add_argument("--method", nargs="+", choices=METHODS, default=["continuation"])
    parser.add_argument("--lines", type=int, default=0, help="equally spaced lines up to 85 rad/s; 0: 85000")
    parser.add_argument("--repeats", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--out", default="broad_band_results")
    parser.add_argument("--image", default="docs/images/convergence.png")
    chosen = parser.parse_args()
    if chosen.command == "run":
        run(chosen)
    elif chosen.command == "table":
        table(Path(chosen.out))
    else:
        picture(Path(chosen.out), Path(chosen.image))


if __name__ == "__main__":
    main()
