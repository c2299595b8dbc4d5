"""Six movable masses on a measured cantilever: masses from all healthy arrangements at once, then what three states lost.

Masses are in units of the beam's own. Every choice was made on the healthy state; see `six_masses_model.py`.

    python benchmarks/accuracy/six_masses.py [--arrangements 24] [--short]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from six_masses_model import (
    ERROR,
    LENGTH,
    MASSES,
    METAL,
    STATES,
    Model,
    both_states,
    fitted,
    held_out,
    loss,
    rms,
    scatter,
    scatter_later,
)

import structid as sid

MODELS = {
    "rigid clamp that turns": Model(("rotation",), rotary=False),
    "  and rotary inertia of the masses": Model(("rotation",)),
    "  and of the accelerometer": Model(("rotation",), accelerometer=True),
    "  and inertia of the clamp, not the masses'": Model(rotary=False),
    "inertia of clamp and masses (chosen)": Model(),
    "  without the prior of a metal beam": Model(metal=0.0),
    "  and of the accelerometer too": Model(accelerometer=True),
    "  and a clamp that also moves sideways": Model(("rotation", "inertia", "lift", "mass")),
    "  six equal masses": Model(equal=True),
}


def said(found: sid.Estimate) -> str:
    """Whether the modes ask for different values, as words that follow others."""
    return "" if found.spread.disagreement is None else f"\n  {found.spread.disagreement.words}"


def report_models(arrangements: Sequence[int]) -> None:
    """Each model on the healthy state, judged by arrangements held out."""
    print("\nHEALTHY: models, error of frequencies in % (f1 ... f5, all), fitted and held out (thirds in turn)")
    for name, model in MODELS.items():
        found = fitted("healthy", arrangements, model)
        inside = rms(scatter(found, "healthy", arrangements, model))
        out = rms(held_out(arrangements, model))
        masses = [v / LENGTH for n, v in zip(found.names, found.values, strict=True) if n[5:-1] in (*MASSES, "each")]
        words = " ".join(f"{100 * m:.2f}" for m in masses)
        stiffness = found.values[0] / METAL
        chi = f"chi2 {found.goodness.chi_square:6.1f}, {found.goodness.degrees_of_freedom} dof"
        print(f"  {name:44s} fit {inside} | held out {out} | {chi}")
        print(
            f"  {'':44s} masses {words} % of the beam; stiffness over mass {stiffness:.3f} of a metal beam's",
            flush=True,
        )


def report_healthy(arrangements: Sequence[int], model: Model) -> sid.Estimate:
    """Masses with intervals, how they correlate, whether they are equal, and what one arrangement alone says."""
    found = fitted("healthy", arrangements, model)
    print(
        f"\nHEALTHY: {len(arrangements)} arrangements together; {found.status.value}, std from {found.covariance_basis}"
    )
    print(f"  chi-square per dof {found.chi_square_per_dof:.2f} with errors of {100 * ERROR:g} %{said(found)}")
    rows = zip(found.names, found.values, found.interval(), found.std, found.std_noise, found.units, strict=True)
    for name, value, (low, high), std, noise, unit in rows:
        scale, word = (100 / LENGTH, "% of the beam") if name.startswith("mass") else (1.0, unit)
        print(
            f"  {name:30s} {scale * value:10.4g} [{scale * low:.4g}, {scale * high:.4g}] {word};"
            f" std {100 * std / value:.0f} %, by noise alone {100 * noise / value:.0f} %"
        )
    index = [found.names.index(f"mass[{m}]") for m in MASSES]
    print("  correlations of m1 ... m6, stiffness, tip mass")
    more = [*index, 0, found.names.index("mass[tip]")]
    for row in found.spread.correlation[np.ix_(more, more)]:
        print("   " + " ".join(f"{x:5.2f}" for x in row))
    equal = fitted("healthy", arrangements, replace(model, equal=True))
    print(
        f"  six equal masses: chi-square {equal.goodness.chi_square - found.goodness.chi_square:+.1f} for 5 parameters fewer"
    )
    one = fitted("healthy", [0], model)
    print(
        f"  arrangement 1 alone: {one.status.value}, rank {one.identifiability.rank} of {len(one.names)} from its data"
    )
    return found


def report_states(arrangements: Sequence[int], model: Model) -> None:
    """What each damaged state lost; looked at once, after all choices."""
    for state, reference in STATES.items():
        found, changes = both_states(state, arrangements, model)
        print(f"\n{state}: joint fit with the healthy state; {found.status.value}, std from {found.covariance_basis}")
        print(f"  chi-square per dof {found.chi_square_per_dof:.2f}; {changes.words}{said(found)}")
        for i, name in enumerate(changes.names):
            scale = 100 / LENGTH if name.startswith("mass") else 1.0
            print(
                f"  {name:24s} {scale * changes.before[i]:9.3g} -> {scale * changes.after[i]:9.3g}, change"
                f" {scale * changes.change[i]:+9.3g} +- {scale * changes.std[i]:.2g}, adjusted p {changes.adjusted[i]:.1e}"
            )
        for words, tip in (("beam and masses", False), ("beam, masses and accelerometer", True)):
            share, std, total = loss(found, tip)
            noise = loss(found, tip, found.spread.covariance_noise)[1]
            print(
                f"  lost {share:.2f} % of {words} ({total:.3f} beams), 95 % [{share - 1.96 * std:.2f},"
                f" {share + 1.96 * std:.2f}]; std {std:.2f}, by noise alone {noise:.2f}; reference {reference:.2f} %"
            )
        errors = scatter_later(found, state, arrangements, model)
        print(f"  errors of its frequencies {rms(errors)} %", flush=True)


def report_choices(arrangements: Sequence[int]) -> None:
    """The losses with other models that follow the healthy state about as well, and with frequencies left out."""
    chosen = Model()
    wide = ("rotation", "inertia", "lift", "mass")
    others = {
        "chosen": chosen,
        "without the prior of a metal beam": replace(chosen, metal=0.0),
        "clamp that also moves sideways": replace(chosen, clamp=wide),
        "masses without rotary inertia": replace(chosen, rotary=False),
        **{f"without f{m}": replace(chosen, modes=tuple(n for n in chosen.modes if n != m)) for m in (1, 4, 5)},
        "f4 freed of the resonance at 777 Hz": replace(chosen, pull=60.0),
    }
    print("\nLOSSES in % of beam and masses with other choices: value, std, masses declared changed (Holm, 5 %)")
    for name, model in others.items():
        cells = []
        for state in STATES:
            found, changes = both_states(state, arrangements, model)
            share, std, _ = loss(found, accelerometer=False)
            declared = [
                n[5:-1] for n, c in zip(changes.names, changes.changed, strict=True) if c and n.startswith("mass")
            ]
            cells.append(f"{share:5.2f} +- {std:.2f} ({' '.join(declared)}; {found.status.value})")
        print(f"  {name:36s} " + " | ".join(cells), flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arrangements", type=int, default=24, help="how many, from the first")
    parser.add_argument("--short", action="store_true", help="leave out the tables of other models and choices")
    chosen = parser.parse_args()
    arrangements = list(range(chosen.arrangements))
    model = Model()
    if not chosen.short:
        report_models(arrangements)
    report_healthy(arrangements, model)
    report_states(arrangements, model)
    if not chosen.short:
        report_choices(arrangements)


if __name__ == "__main__":
    main()
