"""Damping that is sought and is not there: the data say how small it is, and determine all else."""

import numpy as np
import pytest

from structid import Dashpot, FrfRecord, PointMass, Spring, Structure, Unknown, identify, parameters
from structid.diagnose.verdict import judged
from structid.inversion import Status

MASS, STIFFNESS, DAMPING = np.array([100.0, 100, 100, 80]), np.array([2e5, 1.8e5, 1.6e5, 1.5e5]), 120.0
FREQUENCY = np.arange(0.5, 15, 0.1)


def chain(values: np.ndarray) -> np.ndarray:
    """Matrix of four links from the ground up."""
    links = np.eye(4) - np.eye(4, k=-1)
    return links.T @ np.diag(values) @ links


def measured(loss_factor: float, seed: int) -> FrfRecord:
    """Accelerance of the chain under a force at its top, 1 % noise."""
    s = 2j * np.pi * FREQUENCY[:, None, None]
    z = s**2 * np.diag(MASS) + s * chain(np.full(4, DAMPING)) + chain(STIFFNESS) * (1 + 1j * loss_factor)
    values = s**2 * np.linalg.inv(z)[:, :, [3]]
    rng = np.random.default_rng(seed)
    noise = 0.01 * np.abs(values) / np.sqrt(2)
    values = values + noise * (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape))
    outputs = [f"{k}X" for k in range(1, 5)]
    return FrfRecord(FREQUENCY, values, outputs, ["4X"], "accelerance", variance=2 * noise**2, noise_source="declared")


def found(loss_factor: float, seed: int, start: float = 0.02):
    first, second = ["0X", "1X", "2X", "3X"], ["1X", "2X", "3X", "4X"]
    parts = [
        PointMass("floor", [1, 2, 3, 4], MASS),
        Spring("storey", first, second, stiffness=1.7e5, loss_factor=start),
        Dashpot("loss", first, second, viscous_damping=80.0),
    ]
    structure = Structure({k: float(k) for k in range(5)}, parts, ["0X"], active=["X"])
    unknown = [
        Unknown("stiffness", "storey", each=True),
        Unknown("loss_factor", "storey"),
        Unknown("viscous_damping", "loss"),
    ]
    return identify(structure, parameters(structure, unknown), measured(loss_factor, seed))


@pytest.mark.parametrize("loss_factor", [0.0, 1e-4])
def test_an_absent_loss_factor_leaves_the_answer_sound_and_its_interval_holds(loss_factor):
    """Beside the right viscous damping; seeds 0 to 9: of 60 intervals 3 may miss, 8 at most.

    The noise of seed 4 alternates by chance (98 runs at 3X where 73 are expected): that one answer may be doubted.
    """
    missed, verdicts = 0, []
    for seed in range(10):
        answer = found(loss_factor, seed)
        assert answer.estimate.status is Status.CONVERGED
        verdicts.append(judged(answer).verdict)
        truth = np.array([*STIFFNESS, loss_factor, DAMPING])
        low, high = answer.intervals.ends.T
        missed += int((~((low <= truth) & (truth <= high))).sum())
        assert high[4] < 1e-3
    assert set(verdicts[:4] + verdicts[5:]) == {"sound"}
    assert verdicts[4] in ("sound", "approximate")
    assert missed <= 8


def test_what_is_not_told_from_nothing_is_said_with_its_limit():
    one = found(0.0, seed=1)
    [words] = [words for words in one.warnings if "not significantly different from 0" in words]
    limit = one.intervals.ends[4, 1]
    assert f"loss_factor[storey] is not significantly different from 0 (95 % interval up to {limit:.2g})" in words
    assert one.intervals.ends[4, 0] == 0
    [draws] = one.estimate.drawn(200, np.random.default_rng(0))
    assert np.isfinite(draws).all()
    assert 0 <= draws[:, 4].min() <= draws[:, 4].max() < 4 * limit


def test_what_is_less_than_the_data_can_show_is_not_determined():
    """Of a loss factor that is sought about 1e-5 the record can only say that it is below ten times that."""
    one = found(0.0, seed=1, start=1e-5)
    assert one.estimate.status is Status.NOT_IDENTIFIABLE
    assert one.estimate.identified.tolist() == [True, True, True, True, False, True]
