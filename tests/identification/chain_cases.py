"""Four masses in a row, hung at one end, with a record of all of them under a force on the first."""

import numpy as np

from structid import FrfProblem, FrfRecord, identify, parameters, with_declared_noise
from structid.fem import PointMass, Spring, Structure
from structid.unknowns import Unknown

STIFFNESS = (1000.0, 800.0, 1200.0, 900.0)
SENSORS = ("1X", "2X", "3X", "4X")


def chain(stiffness=STIFFNESS, mass=(2.0,) * 4, loss=0.03):
    springs = Spring("k", SENSORS, ("0X", *SENSORS[:3]), stiffness=list(stiffness), loss_factor=loss)
    nodes = {i: float(i) for i in range(5)}
    return Structure(nodes, [PointMass("m", [1, 2, 3, 4], list(mass)), springs], fixed=["0X"], active=["X"])


def record(structure, noise=0.01, seed=0):
    """120 lines from 0.5 to 8 Hz with noise in proportion to each value."""
    frequency, known = np.linspace(0.5, 8.0, 120), parameters(structure, [Unknown("stiffness", "k")])
    blank = FrfRecord(frequency, np.ones((120, 4, 1)), SENSORS, ("1X",), "accelerance")
    exact = FrfProblem(structure, known, with_declared_noise(blank, noise)).predicted(known.theta_start)
    parts = np.random.default_rng(seed).standard_normal((2, *exact.shape)) / np.sqrt(2)
    measured = FrfRecord(frequency, exact * (1 + noise * (parts[0] + 1j * parts[1])), SENSORS, ("1X",), "accelerance")
    return with_declared_noise(measured, noise)


def bounded(bounds, start=None):
    """All stiffnesses unknown, the second between bounds."""
    starts = (1050.0, start or 0.5 * sum(bounds), 1100.0, 950.0)
    own = [Unknown("stiffness", f"k:{i + 1}", start=starts[i]) for i in (0, 2, 3)]
    own.insert(1, Unknown("stiffness", "k:2", start=starts[1], bounds=bounds))
    return parameters(chain(), own)


def found(bounds, start=None):
    return identify(chain(), bounded(bounds, start), record(chain()))
