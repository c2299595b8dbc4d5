"""The noise floor that neighbouring lines tell, on chains and noise made here with NumPy alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from structid import IdentifyOptions, PointMass, Spring, Structure, Unknown, explain, identify, parameters
from structid.identification.setups.frf import Setup
from structid.records import FrfRecord, with_declared_noise
from structid.records.noise_floor import line_scatter, missing_floor, with_noise_floor

_FREQUENCY = np.linspace(5.0, 150.0, 600)
_MASSES, _STIFFNESSES = np.diag([2.0, 1.5, 1.0]), (4e5, 3e5, 2e5)


def _accelerance(frequency, loss_factor=0.01):
    a, b, c = _STIFFNESSES
    stiffness = np.array([[a + b, -b, 0.0], [-b, b + c, -c], [0.0, -c, c]]) * (1 + 1j * loss_factor)
    omega = 2 * np.pi * np.asarray(frequency)
    return np.array([-(w**2) * np.linalg.inv(stiffness - w**2 * _MASSES)[:, 2:] for w in omega])


def _floor(record):
    return line_scatter(record, np.ones(record.values.shape)).floor


def _missing(record):
    return missing_floor(record, 0.0, is_assumed=False)


def _noisy(seed, floor=0.0, relative=0.0, frequency=_FREQUENCY):
    rng, values = np.random.default_rng(seed), _accelerance(frequency)
    noise = (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape)) / np.sqrt(2)
    values = values + noise * np.hypot(floor, relative * np.abs(values))
    return FrfRecord(frequency, values, outputs=["1X", "2X", "3X"], inputs=["3X"], kind="accelerance")


@pytest.mark.parametrize("n_lines", [150, 600, 2000])
def test_the_floor_has_the_size_of_the_noise(n_lines):
    told = [_floor(_noisy(seed, 0.04, frequency=np.linspace(5, 150, n_lines))) for seed in range(20)]
    assert np.all(np.array(told) > 0)
    assert np.mean(told) == pytest.approx(0.04, rel=0.04)


def test_a_response_without_noise_has_no_floor():
    for loss_factor in (0.002, 0.01, 0.05):
        for n_lines in (120, 600, 2000):
            frequency = np.linspace(5.0, 150.0, n_lines)
            record = FrfRecord(
                frequency,
                _accelerance(frequency, loss_factor),
                outputs=["1X", "2X", "3X"],
                inputs=["3X"],
                kind="accelerance",
            )
            assert not _floor(record).any()


def test_lines_that_are_few_or_uneven_tell_no_floor():
    assert not _floor(_noisy(1, 0.04, frequency=np.linspace(5, 150, 60))).any()
    assert not _floor(_noisy(1, 0.04, frequency=np.geomspace(5, 150, 600))).any()
    assert not _floor(_noisy(1, 0.04, frequency=np.linspace(5, 150, 4))).any()


@pytest.mark.parametrize("delay", [0.35, 0.4, 0.5, 0.6])
def test_a_delay_that_turns_the_values_from_line_to_line_is_no_noise(delay):
    """The delay is in parts of the reciprocal line spacing: half of it changes the sign at each line."""
    record = _noisy(1)
    turned = np.exp(-2j * np.pi * delay * np.arange(len(_FREQUENCY)))[:, None, None]
    assert not _floor(replace(record, values=record.values * turned)).any()


def test_modes_between_the_lines_are_no_floor():
    """One mode a line, a third of a line wide: the response scatters, on loud lines as on quiet ones."""
    rng, lines = np.random.default_rng(4), np.arange(1600)
    poles, residues = rng.uniform(0, 1600, 1600), rng.standard_normal((2, 1600))
    values = (residues / (poles - lines[:, None] + 0.3j)[:, None, :]).sum(axis=-1)[:, :, None]
    record = FrfRecord(10 + 0.1 * lines, values, outputs=["1X", "2X"], inputs=["2X"], kind="accelerance")
    assert not missing_floor(record, 0.1, is_assumed=True).any()


def test_a_residual_that_reads_no_variance_has_no_floor_added():
    record, structure = with_declared_noise(_noisy(7, 0.04), relative=0.01), _chain()
    unknown = parameters(structure, [Unknown("stiffness", "ground"), Unknown("stiffness", "upper", each=True)])
    said = {
        form: " ".join(Setup(structure, unknown, record).prepared(IdentifyOptions(residual=form)).warnings)
        for form in ("equation", "output")
    }
    assert "noise floor" not in said["equation"]
    assert "noise floor" in said["output"]


def test_a_gap_between_lines_is_left_out():
    frequency = np.concatenate([np.linspace(5, 60, 300), np.linspace(90, 145, 300)])
    floor = _floor(_noisy(3, 0.04, frequency=frequency))
    assert floor == pytest.approx(np.full((3, 1), 0.04), rel=0.25)


def test_a_floor_is_missing_where_the_statement_leaves_it_out_and_not_where_the_noise_has_one_other_size():
    with_floor, of_size = _noisy(5, 0.04), _noisy(5, relative=0.03)
    assert np.all(_missing(with_declared_noise(with_floor, relative=0.01)) > 0)
    assert not _missing(with_declared_noise(with_floor, absolute=0.04)).any()
    assert not _missing(with_declared_noise(of_size, relative=0.01)).any()
    assert not _missing(with_declared_noise(of_size, relative=0.03)).any()


def test_an_assumed_part_has_a_floor_beside_it_unless_that_is_negligible():
    assert np.all(missing_floor(_noisy(5, 0.04), 0.1, is_assumed=True) > 0)
    assert not missing_floor(_noisy(5, relative=0.01), 0.1, is_assumed=True).any()
    assert not missing_floor(_noisy(5, 0.04), 0.1, is_assumed=False)[1:].any()


def test_a_floor_is_added_to_the_variance():
    record, floor = with_declared_noise(_noisy(5), relative=0.01), np.array([[0.1], [0.0], [0.2]])
    added = with_noise_floor(record, floor)
    assert added.variance - record.variance == pytest.approx(np.broadcast_to(floor**2, record.values.shape))
    assert added.noise_source == "declared"
    assert with_noise_floor(record, 0 * floor) is record
    assert with_noise_floor(_noisy(5), floor).noise_source == "scatter"


def _chain():
    masses = [PointMass(f"mass {node}", node, mass=mass) for node, mass in ((1, 2.0), (2, 1.5), (3, 1.0))]
    ground = Spring("ground", "1X", stiffness=3e5, loss_factor=0.01)
    upper = Spring("upper", ["1X", "2X"], ["2X", "3X"], stiffness=3e5, loss_factor=0.01)
    return Structure({1: 0.0, 2: 1.0, 3: 2.0}, [*masses, ground, upper], active=["X"])


@pytest.mark.parametrize("relative", [0.0, 0.01])
def test_a_right_model_is_right_with_a_floor_that_nobody_stated(relative):
    record = _noisy(7, 0.04)
    record = with_declared_noise(record, relative=relative) if relative else record
    structure = _chain()
    unknown = [Unknown("stiffness", "ground"), Unknown("stiffness", "upper", each=True)]
    found = identify(structure, parameters(structure, unknown), record)
    assert explain(found).judgement.verdict in ("sound", "approximate")
    assert found.estimate.values == pytest.approx(_STIFFNESSES, rel=0.003)
    said = " ".join(found.warnings)
    assert ("stated noise is too small between the resonances" in said) == bool(relative)
    assert "noise floor of 0.0" in said
