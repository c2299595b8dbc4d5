"""Short random records with noise on force and motion: averaged FRFs against finite spectra with their transient.

A chain of four masses (damping ratios below 1 %), 20 s under a random multisine, a start that is not at rest, two
accelerometers, 2 % noise on them and 10 % on the force. Twelve unknowns: every mass, spring and dashpot. Each way starts
at the truth, so that what is compared is bias and scatter and not convergence. Repeat k has seed k; all of them count.

    python benchmarks/accuracy/short_records.py [--repeats 100] [--force-noise 0.1]
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import structid as sid
from structid.forward.time.spectra import spectra_problem

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from short_record_cases import SENSORS, chain, record, unknowns  # one chain and one exact record for both

BAND = (0.1, 12.0)


def answers(seed: int, force_noise: float) -> dict[str, sid.Estimate]:
    """The estimate of each way on one record."""
    structure = chain()
    truth = unknowns(structure)
    noisy = record(structure, truth.values(truth.start), np.random.default_rng(seed), 0.02, force_noise)
    found = {}
    for estimator in ("H1", "Hv"):
        for segments in (2, 4):
            length = len(noisy.values) // segments
            frf = sid.frf_from_time(noisy, ["4X"], SENSORS, estimator, segment_length=length).band(*BAND)
            found[f"{estimator}, Hann, {segments} segments"] = sid.estimate(sid.FrfProblem(structure, truth, frf))
    found["finite spectra, no transient"] = sid.estimate(spectra_problem(structure, truth, noisy, BAND, False))
    found["finite spectra"] = sid.estimate(spectra_problem(structure, truth, noisy, BAND))
    return found


def main() -> None:
    """Print error, bound, coverage and chi-square of each way."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=100)
    parser.add_argument("--force-noise", type=float, default=0.1)
    options = parser.parse_args()
    truth = unknowns(chain()).start
    runs = [answers(seed, options.force_noise) for seed in range(options.repeats)]
    print(f"{options.repeats} records, seeds 0 to {options.repeats - 1}, {options.force_noise:.0%} noise on the force")
    print(
        f"{'way':30s} {'rms m, k':>9s} {'rms c':>9s} {'bias m, k':>10s} {'bound m, k':>10s} {'coverage':>9s}"
        f" {'chi-square':>10s} {'converged':>9s}"
    )
    stiff = np.arange(len(truth)) < 8
    for way in runs[0]:
        estimates = [run[way] for run in runs]
        error = np.array([e.values / truth - 1 for e in estimates])
        std = np.array([e.std_noise / truth for e in estimates])
        inside = np.abs(error) < 1.96 * std
        converged = sum(e.status is not sid.Status.NOT_CONVERGED for e in estimates)
        print(
            f"{way:30s} {np.sqrt((error[:, stiff] ** 2).mean()):9.4f} {np.sqrt((error[:, ~stiff] ** 2).mean()):9.4f}"
            f" {np.abs(error[:, stiff].mean(axis=0)).mean():10.4f} {np.sqrt((std[:, stiff] ** 2).mean()):10.4f}"
            f" {inside.mean():9.1%} {np.mean([e.chi_square_per_dof for e in estimates]):10.2f} {converged:9d}"
        )


if __name__ == "__main__":
    main()
