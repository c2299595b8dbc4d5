"""Noise that is a part of each value's size: values unbiased, intervals that cover, whoever says how large it is."""

from dataclasses import replace

import numpy as np
import pytest

import structid as sid
from structid.unknowns.tolerances import EXACT

TRUTH = {"k.1": 4e5, "k.2": 3e5, "k.3": 3.5e5, "m.1": 20.0, "m.2": 22.0, "m.3": 18.0}
LINES = np.linspace(2.0, 45.0, 180)
LOSS = 0.02


def exact():
    """Receptances of three storeys under a force at the top, by a solve at every line."""
    k, m = [TRUTH[f"k.{i}"] for i in (1, 2, 3)], [TRUTH[f"m.{i}"] for i in (1, 2, 3)]
    stiffness = np.array([[k[0] + k[1], -k[1], 0], [-k[1], k[1] + k[2], -k[2]], [0, -k[2], k[2]]])
    omega = 2 * np.pi * LINES
    dynamic = (1 + 1j * LOSS) * stiffness - omega[:, None, None] ** 2 * np.diag(m)
    return np.linalg.inv(dynamic)[:, :, 2:]


def tower():
    storeys = [
        sid.Spring("k", ["1X", "2X", "3X"], ["0X", "1X", "2X"], stiffness=[TRUTH[f"k.{i}"] for i in (1, 2, 3)], loss_factor=LOSS),
        sid.PointMass("m", [1, 2, 3], mass=[TRUTH[f"m.{i}"] for i in (1, 2, 3)], directions=["X"]),
    ]  # fmt: skip
    structure = sid.Structure({i: float(i) for i in range(4)}, storeys, ["0X"])
    unknowns = [sid.Unknown("stiffness", "k", each=True), sid.Unknown("mass", "m", each=True)]
    return structure, sid.parameters(structure, unknowns)


def noisy(values, size, rng):
    noise = rng.standard_normal((2, *values.shape))
    return sid.FrfRecord(
        LINES, values * (1 + size * (noise[0] + 1j * noise[1]) / np.sqrt(2)), ("1X", "2X", "3X"), ("3X",), "receptance"
    )


def declared(values, rng):
    return sid.with_declared_noise(noisy(values, 0.1, rng), 0.1), {}


def of_the_model(values, rng):
    return noisy(values, 0.1, rng), {"model_error": 0.1}


def of_repeats(values, rng):
    return sid.from_repeats([noisy(values, 0.2, rng) for _ in range(4)]), {}


def with_a_floor(values, rng):
    record, floor = noisy(values, 0.1, rng), 0.02 * np.abs(values).mean()
    floor_noise = rng.standard_normal((2, *values.shape))
    both = replace(record, values=record.values + floor * (floor_noise[0] + 1j * floor_noise[1]) / np.sqrt(2))
    return sid.with_declared_noise(both, 0.1, floor), {}


@pytest.mark.parametrize(
    ("simulated", "repeats"),
    [
        (declared, 5),
        *(
            pytest.param(kind, 30, marks=pytest.mark.long)
            for kind in (declared, of_the_model, of_repeats, with_a_floor)
        ),
    ],
)
def test_relative_noise_leaves_no_bias(simulated, repeats):
    """30 repeats (seed 11): the mean error of every value within 3.5 of its own deviations, 90 to 99 % of intervals cover.

    Of 5 repeats the coverage may be three and a half binomial deviations of the 30 values below 95 %.

    The simulated model and record are exact but for the noise, and the options say so.
    """
    rng, values = np.random.default_rng(11), exact()
    structure, unknown = tower()
    truth = np.array(list(TRUTH.values()))
    errors, covered = [], []
    for _ in range(repeats):
        record, options = simulated(values, rng)
        found = sid.identify(structure, unknown, record, sid.IdentifyOptions(tolerances=EXACT, **options)).estimate
        errors.append((found.values - truth) / found.std)
        low, high = found.interval().T
        covered.append((low <= truth) & (truth <= high))
    assert np.abs(np.mean(errors, axis=0)).max() < 3.5 / np.sqrt(repeats)
    least, most = (0.90, 0.99) if repeats == 30 else (0.81, 1.0)
    assert least <= np.mean(covered) <= most
