"""The six masses: resonances of three later states, predicted from the healthy one and the masses that were taken off.

All 24 healthy arrangements are fitted together. Of each later arrangement the resonances are predicted with the masses off that its
state lost (m1; m1 and m3; m1, m3 and m5: a finding of `six_masses.py`, the record says the total alone). An interval has the
uncertainty of the parameters and the error of a frequency, which the healthy fit shows mode by mode. Of changes against the healthy
record of the same arrangement, errors of the clamp and the beam cancel, and two errors of frequencies are left.

    python benchmarks/accuracy/six_masses_predicted.py [--arrangements 24]
"""

from __future__ import annotations

import argparse

import numpy as np
import six_masses_model as six

import structid as sid
from structid.prediction.changes import Change, Remove, Scale
from structid.prediction.identified_model import identified_model
from structid.prediction.predict import Prediction, predict_change
from structid.prediction.quantities import NaturalModes

LOST = {"d296": (1,), "d592": (1, 3), "d887": (1, 3, 5)}
N_MODES, DRAWS = 5, 100


def predicted(found: sid.Estimate, k: int, lost: tuple[int, ...]) -> tuple[Prediction, Prediction]:
    """Frequencies of an arrangement with these masses off, and their change."""
    structure, model = six.cantilever(k, six.Model()), six.Model()
    unknown = six.unknowns(structure, model)
    index = [found.names.index(name) for name in unknown.names]
    identified = identified_model(structure, unknown, found.values[index], found.covariance[np.ix_(index, index)])
    changes: list[Change] = [Remove(f"m{j}") for j in lost]
    changes += [Scale(f"rotary_inertia[masses:{j}]", 1e-6) for j in lost]
    told = predict_change(identified, NaturalModes(N_MODES), changes, n_draws=DRAWS, seed=k)
    return told.after, told.difference


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arrangements", type=int, default=24)
    arrangements = range(parser.parse_args().arrangements)
    found = six.fitted("healthy", arrangements, six.Model())
    error = np.sqrt((six.scatter(found, "healthy", arrangements, six.Model()) ** 2).mean(axis=0)) / 100
    print(f"{len(arrangements)} healthy arrangements; error of a frequency, %, f1 ... f5: {np.round(100 * error, 2)}")
    for state, lost in LOST.items():
        z, changed, missed, unpredicted = [], [], [], []
        for k in arrangements:
            healthy, measured = (six.poles(which, k)[:, 0] for which in ("healthy", state))
            after, difference = predicted(found, k, lost)
            spread = np.hypot(after.std[:, 0], error * measured)
            z.append((after.values[:, 0] - measured) / spread)
            wide = np.hypot(difference.std[:, 0], np.sqrt(2) * error * measured)
            changed.append((difference.values[:, 0] - (measured - healthy)) / wide)
            missed.append(100 * (after.values[:, 0] / measured - 1))
            unpredicted.append(100 * (healthy / measured - 1))
        inside, of_changes = (100 * (np.abs(each) < 1.96) for each in (z, changed))
        print(
            f"{state}, without {', '.join(f'm{j}' for j in lost)}: resonances inside their 95 % intervals {inside.mean():.0f} %"
            f" (f1 ... f5: {np.round(inside.mean(axis=0)).astype(int)}), changes {of_changes.mean():.0f} %"
            f" ({np.round(of_changes.mean(axis=0)).astype(int)})"
        )
        print(f"  error of predicted frequencies, rms %, f1 ... f5, all: {six.rms(np.array(missed))}")
        print(f"  the same if nothing had changed:                      {six.rms(np.array(unpredicted))}", flush=True)


if __name__ == "__main__":
    main()
