"""A shear building that its ground shakes: are stiffnesses over mass as good as their bound, and their intervals right?

Three storeys on the ground, whose acceleration is measured; no force is. Every stiffness, damping and mass is unknown, so
that one common scale is free and ratios to the first mass are what is determined. Each repeat is a stretch of 1024
samples at 25 Hz out of a longer motion, with noise of 5 % (floors) and 1 % (ground) of each channel's rms; repeat k has
seed k. Printed for every ratio: mean and root mean square error over the Cramer-Rao bound at the truth, and how often
the 95 % interval holds the truth.

    python benchmarks/accuracy/base_motion.py [--repeats 400]
"""

from __future__ import annotations

import argparse
import os
import sys
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from structid import Base, Dashpot, PointMass, Spring, Structure, TimeRecord, Unknown, estimate, parameters
from structid.core.arrays import FloatArray
from structid.forward import SpectraProblem
from structid.identification.ratios import ratios
from structid.records.spectra import finite_spectra
from structid.unknowns import Parameters

MASS, STIFFNESS, DAMPING = np.array([12.0, 10.0, 8.0]), np.array([2.4e4, 1.8e4, 2.0e4]), np.array([35.0, 25.0, 30.0])
RATE, N_TIMES, BAND, NOISE = 25.0, 1024, (0.3, 10.0), (0.01, 0.05, 0.05, 0.05)
NAMES = ("mass", "stiffness", "viscous_damping")
SETS = ("floor", "storey", "loss")


def building() -> Structure:
    below, above = [f"{k}X" for k in range(3)], [f"{k + 1}X" for k in range(3)]
    sets = [
        PointMass("floor", [1, 2, 3], MASS),
        Spring("storey", below, above, stiffness=STIFFNESS),
        Dashpot("loss", below, above, viscous_damping=DAMPING),
    ]
    return Structure(dict.fromkeys(range(4), 0.0), sets, ["0X"], active=["X"], bases=[Base("ground", "0X")])


def shaken(rng: np.random.Generator) -> FloatArray:
    """Accelerations of ground and floors: a third of a periodic motion, by dense matrices."""
    lines = np.fft.rfftfreq(3 * N_TIMES, 1 / RATE)
    ground = np.exp(2j * np.pi * rng.random(len(lines))) * ((lines < 0.4 * RATE) & (lines > 0))
    drift = np.eye(3) - np.eye(3, k=-1)
    k, c = (drift.T @ np.diag(values) @ drift for values in (STIFFNESS, DAMPING))
    s = 2j * np.pi * lines[:, None, None]
    moved = np.linalg.solve(s**2 * np.diag(MASS) + s * c + k, np.tile(-MASS[:, None], (len(lines), 1, 1)))
    spectra = ground[:, None] * np.column_stack([np.ones(len(lines)), 1 + (s**2 * moved)[..., 0]])
    values = np.fft.irfft(spectra, 3 * N_TIMES, axis=0)[N_TIMES : 2 * N_TIMES]
    return values / values[:, 0].std()


def problem(structure: Structure, unknown: Parameters, seed: int) -> SpectraProblem:
    """One repeat; the starts of `unknown` are where the search begins."""
    rng = np.random.default_rng(seed)
    values = shaken(rng)
    noise = NOISE * values.std(axis=0)
    values = values + noise * rng.standard_normal(values.shape)
    kinds = ("support_acceleration", "acceleration", "acceleration", "acceleration")
    record = TimeRecord(RATE, values, [f"{k}X" for k in range(4)], kinds, variance=noise**2)
    return SpectraProblem(structure, unknown, finite_spectra(record, band=BAND), record=record)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=400)
    repeats = parser.parse_args().repeats
    structure, begun = building(), time.perf_counter()
    unknown = parameters(structure, [Unknown(p, e, each=True) for p, e in zip(NAMES, SETS, strict=True)])
    truth = np.concatenate([MASS, STIFFNESS, DAMPING])
    values = truth[1:] / truth[0]
    off = np.exp(0.2 * np.random.default_rng(7).standard_normal(len(truth)))
    errors, bounds, held, names = [], [], [], ()
    for seed in range(repeats):
        one = problem(structure, unknown.started_at(truth * off), seed)
        found = ratios(one, estimate(one))
        assert found is not None
        names = found.names
        errors.append(np.log(found.values / values))
        held.append((found.ends[:, 0] <= values) & (values <= found.ends[:, 1]))
        jacobian = one.linearize(np.log(truth)).jacobian  # of the logarithms
        scaled = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-12)
        contrast = np.eye(len(truth))[1:] - np.eye(len(truth))[0]
        bounds.append(np.sqrt(np.einsum("ij,jk,ik->i", contrast, scaled, contrast)))
    relative, inside = np.array(errors) / np.mean(bounds, axis=0), np.array(held)
    for i, name in enumerate(names):
        print(
            f"{name + ' / mass[floor:1]':45s} bias {relative[:, i].mean():+.3f}  rms {np.sqrt((relative[:, i] ** 2).mean()):.3f}"
            f" of the bound  interval holds {100 * inside[:, i].mean():.1f} %"
        )
    rms, coverage = float(np.sqrt((relative**2).mean())), 100 * float(inside.mean())
    print(
        f"all: rms {rms:.3f} of the bound, intervals hold {coverage:.1f} %; {repeats} repeats, {time.perf_counter() - begun:.0f} s"
    )
    return 0 if abs(rms - 1) <= 0.1 and 93 <= coverage <= 97 else 1


if __name__ == "__main__":
    sys.exit(main())
