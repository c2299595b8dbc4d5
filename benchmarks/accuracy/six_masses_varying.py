"""Six masses with a clamp that differs from arrangement to arrangement: chosen on the healthy state, then the losses.

What varies, and the error of the frequencies beside it, are chosen by arrangements of the healthy state that had no part in
the fit; see `six_masses_model.py`.

    python benchmarks/accuracy/six_masses_varying.py
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from six_masses_model import ERROR, LENGTH, MASSES, STATES, Model, ResonanceProblem, answer, loss, problems, shared

import structid as sid
from structid.identification.search import SearchOutcome
from structid.inversion.state_comparison import LATER

CHOICES = {
    "nothing": (),
    "clamp stiffness": ("clamp",),
    "clamp inertia": ("clamp inertia",),
    "both": ("clamp", "clamp inertia"),
    "accelerometer": ("tip",),
}


def of_state(state: str, arrangements: Sequence[int], model: Model) -> tuple[list[ResonanceProblem], list[str]]:
    """The problems of a state and what their records are called."""
    return problems(state, arrangements, model), [f"{state} {k + 1}" for k in arrangements]


def healthy(arrangements: Sequence[int], model: Model) -> tuple[SearchOutcome, Model]:
    """The healthy state, with the error of a frequency at which chi-square is what it should be."""
    for _ in range(6):
        found = answer(*of_state("healthy", arrangements, model))
        ratio = float(np.sqrt(found.estimate.chi_square_per_dof))
        if abs(ratio - 1) < 0.02:
            break
        model = replace(model, error=model.error * ratio)
    return found, model


def predictive(found: SearchOutcome, arrangements: Sequence[int], model: Model) -> tuple[np.ndarray, float]:
    """Errors in % of arrangements that had no part in a fit, and the logarithm of their density, per frequency.

    The covariance of an arrangement's errors is that of its frequencies plus what its own clamp and the parameters add.
    """
    known = dict(zip(found.estimate.names, found.estimate.values, strict=True))
    scatter = {one.name: one.scatter for one in found.varied}
    errors, density, n = [], 0.0, 0
    for part in problems("healthy", arrangements, model):
        theta = part.unknowns.transforms.free(np.array([known[name] for name in part.names]))
        at = part.linearize(theta)
        rows = at.jacobian[: part.n_data]
        place = [found.estimate.names.index(name) for name in part.names]
        free = found.estimate.spread.covariance_noise[np.ix_(place, place)] / np.outer(
            part.slope(theta), part.slope(theta)
        )
        for name, std in scatter.items():
            free[part.names.index(name), part.names.index(name)] += std**2
        covariance = rows @ free @ rows.T + np.eye(part.n_data)
        residual = at.residual[: part.n_data]
        density -= 0.5 * float(residual @ np.linalg.solve(covariance, residual) + np.linalg.slogdet(covariance)[1])
        density -= part.n_data * (0.5 * float(np.log(2 * np.pi)) + float(np.log(100 * model.error)))
        n += part.n_data
        errors.append(100 * model.error * residual)
    return np.array(errors), density / n


def report_choices(arrangements: Sequence[int], names: Sequence[str], model: Model) -> None:
    """Each choice of what varies on the healthy state."""
    print(
        "HEALTHY: what varies; error of a frequency; scatter; held out (thirds in turn): rms in %, log density a frequency"
    )
    for name in names:
        chosen = replace(model, varies=CHOICES[name])
        found, fitted = healthy(arrangements, chosen)
        errors, density = [], []
        for third in range(3):
            judged = list(arrangements[third::3])
            rest = answer(*of_state("healthy", [k for k in arrangements if k not in judged], fitted))
            part = predictive(rest, judged, fitted)
            errors.append(part[0])
            density.append(part[1])
        of = found.estimate
        masses = " ".join(f"{100 * of[f'mass[{one}]'][0] / LENGTH:.2f}" for one in MASSES)
        words = "; ".join(one.words for one in found.varied)
        outlying = [words for one in found.varied for words in one.outlying_words]
        rms = np.sqrt((np.concatenate(errors) ** 2).mean())
        print(
            f"  {name:32s} error {100 * fitted.error:.3f} % | held out {rms:.3f} %, density {np.mean(density):+.3f}"
            f" (thirds {' '.join(f'{one:+.2f}' for one in density)}) | {of.status.value} | masses {masses} | {words} | {outlying}",
            flush=True,
        )


def both(state: str, arrangements: Sequence[int], model: Model) -> SearchOutcome:
    """The healthy and a later state in one fit: masses are each state's own, all mountings differ."""
    first, titles = of_state("healthy", arrangements, model)
    later, more = of_state(state, arrangements, model)
    same = set(shared(sid.JointProblem(tuple(first))))
    renamed = [
        part.with_parts([replace(part.parameters, names=tuple(n if n in same else n + LATER for n in part.names))])
        for part in later
    ]
    return answer([*first, *renamed], [*titles, *more])


def report_losses(arrangements: Sequence[int], model: Model) -> None:
    """What each later state lost."""
    for state, reference in STATES.items():
        found = both(state, arrangements, model)
        share, std, _ = loss(found.estimate, accelerometer=False)
        low, high = share - 1.96 * std, share + 1.96 * std
        varied = found.varied
        print(
            f"  {state}: lost {share:.2f} +- {std:.2f} % [{low:.2f}, {high:.2f}], reference {reference:.2f}"
            f" {'inside' if low <= reference <= high else 'OUTSIDE'}; chi2/dof {found.estimate.chi_square_per_dof:.2f},"
            f" {found.estimate.status.value}, std from {found.estimate.covariance_basis};"
            f" {'; '.join(one.words for one in varied)}; {[w for one in varied for w in one.outlying_words]}",
            flush=True,
        )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arrangements", type=int, default=24, help="how many, from the first")
    parser.add_argument("--choices", nargs="*", default=list(CHOICES), choices=list(CHOICES), help="what may vary")
    parser.add_argument("--losses", choices=list(CHOICES), help="the losses with this choice")
    parser.add_argument(
        "--error", type=float, default=ERROR, help="error of a frequency in parts, from which it is sought"
    )
    chosen = parser.parse_args()
    arrangements, model = list(range(chosen.arrangements)), Model(error=chosen.error)
    report_choices(arrangements, chosen.choices, model)
    if chosen.losses:
        fitted = healthy(arrangements, replace(model, varies=CHOICES[chosen.losses]))[1]
        print(
            f"LOSSES in % of beam and masses, {chosen.losses} varying, error of a frequency {100 * fitted.error:.3f} %"
        )
        report_losses(arrangements, fitted)


if __name__ == "__main__":
    main()
