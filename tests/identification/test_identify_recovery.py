"""Identification of noise-free twins: exact at full and at partial sensors, plain words where it cannot be."""

import numpy as np
import pytest

from structid import (
    Beam,
    Dashpot,
    FrfRecord,
    IdentifyOptions,
    PointMass,
    Prior,
    Spring,
    Status,
    Structure,
    Unknown,
    from_repeats,
    identify,
    parameters,
    simulated_record,
    with_declared_noise,
)
from structid.identification.setups.frf import used_lines

BAND = np.linspace(0.02, 1.6, 160)


def cantilever():
    mass, stiffness = [1.0, 0.9, 1.1, 1.2, 0.8, 1.0], [10.0, 11.0, 9.0, 8.0, 9.5, 10.0]
    beam = Beam("beam", [[i, i + 1] for i in range(6)], mass, stiffness, loss_factor=0.02, mass_damping=0.02)
    structure = Structure({i: float(i) for i in range(7)}, [beam], ["0Y", "0RZ"])
    unknowns = [Unknown("mass", "beam", each=True), Unknown("bending_stiffness", "beam", each=True)]
    return structure, parameters(
        structure, [*unknowns, Unknown("loss_factor", "beam"), Unknown("mass_damping", "beam")]
    )


def simulated(structure, truth, sensors, loads=("6Y+",), kind="accelerance"):
    like = FrfRecord(BAND, np.ones((len(BAND), len(sensors), len(loads))), sensors, loads, kind)
    return with_declared_noise(simulated_record(structure, truth, like), relative=0.01)


SENSORS = {
    "all motions": tuple(f"{n}{d}" for n in range(1, 7) for d in ("Y", "RZ")),
    "three sensors": ("6Y-", "4Y+", "2Y+"),
    "two sensors": ("6Y+", "3Y+"),
}


@pytest.mark.parametrize("kind", ["receptance", "accelerance"])
@pytest.mark.parametrize("sensors", SENSORS)
def test_noise_free_records_give_the_truth_back(sensors, kind):
    structure, truth = cantilever()
    record = simulated(structure, truth, SENSORS[sensors], kind=kind)
    rng = np.random.default_rng(3)
    for _ in range(3):
        start = truth.started_at(truth.start * np.exp(0.1 * rng.standard_normal(truth.n_params)))
        found = identify(structure, start, record)
        assert found.estimate.status is Status.CONVERGED
        assert np.abs(found.estimate.values / truth.start - 1).max() <= 1e-9
        assert found.estimate.initial == pytest.approx(start.start, rel=1e-12)
        assert found.mass.total == pytest.approx(6.0, rel=1e-9)
        assert found.modes.frequency[:3] == pytest.approx([0.0499, 0.2840, 0.8575], rel=1e-3)


def test_two_loads_and_evaluation_outside_the_band():
    structure, truth = cantilever()
    record = simulated(structure, truth, ("6Y+", "3Y-"), ("6Y+", "2Y+"))
    start = truth.started_at(1.1 * truth.start)
    found = identify(structure, start, record, IdentifyOptions(band=(0.1, 1.0), evaluation_band=(0.02, 1.6)))
    assert np.abs(found.estimate.values / truth.start - 1).max() <= 1e-9
    assert found.relative_error.shape == (160, 2, 2)
    assert found.fits[0].predicted.shape[0] < 160
    assert found.relative_error.max() <= 1e-7


def series():
    """Two springs in series between the ground and a mass; the node between them has no sensor and no mass."""
    elements = [
        PointMass("m", [3], 2.0),
        Spring("lower", "2X", stiffness=100.0),
        Spring("upper", "3X", "2X", stiffness=100.0),
        Dashpot("d", "3X", viscous_damping=1.0),
    ]
    return Structure({1: 0.0, 2: 1.0, 3: 2.0}, elements)


def test_springs_in_series_are_refused_in_words():
    structure = series()
    unknowns = [Unknown("stiffness", "lower"), Unknown("stiffness", "upper"), Unknown("mass", "m")]
    truth = parameters(structure, unknowns)
    record = simulated(structure, truth, ("3X",), ("3X",))
    found = identify(structure, truth.started_at(np.array([110.0, 95.0, 2.1])), record)
    assert found.estimate.status is Status.NOT_IDENTIFIABLE
    assert found.estimate.identifiability.rank == 2
    words = " ".join(found.warnings)
    assert "stiffness[lower] and stiffness[upper] only" in words
    assert "reciprocals" in words
    assert np.isnan(found.estimate.std[:2]).all()
    assert np.isfinite(found.estimate.std[2])
    assert found.mass.std == pytest.approx(found.estimate.std[2])


def test_a_prior_settles_what_the_data_cannot_and_is_named():
    structure = series()
    unknowns = [
        Unknown("stiffness", "lower", prior=Prior(100.0, 5.0)),
        Unknown("stiffness", "upper", start=95.0),
        Unknown("mass", "m", start=2.1),
    ]
    truth = parameters(structure, unknowns)
    exact = truth.started_at(np.array([100.0, 100.0, 2.0]))
    record = simulated(structure, exact, ("3X",), ("3X",))
    found = identify(structure, truth, record)
    assert found.estimate.status is Status.CONVERGED
    assert found.estimate.values == pytest.approx(exact.start, rel=1e-6)
    assert found.estimate.std[0] == pytest.approx(5.0, rel=0.01)
    assert found.estimate.identifiability.rank == 2
    assert any("only" in w for w in found.warnings)


def test_scatter_of_repeats_is_the_noise_of_their_mean():
    structure, truth = cantilever()
    clean = simulated(structure, truth, ("6Y+", "3Y+"))
    rng = np.random.default_rng(9)
    repeats = [simulated_record(structure, truth, clean, 0.02, rng) for _ in range(8)]
    record = from_repeats(repeats)
    expected = (0.02 * np.abs(clean.values)) ** 2 / 8
    assert np.median(record.variance / expected) == pytest.approx(1.0, abs=0.1)
    found = identify(structure, truth.started_at(1.1 * truth.start), record).estimate
    assert (np.abs(found.values - truth.start) <= 5 * found.std).all()


def test_wrong_sense_of_the_driving_sensor_is_warned_of():
    structure, truth = cantilever()
    record = simulated(structure, truth, ("6Y+", "3Y+"))
    flipped = FrfRecord(record.frequency, -record.values, record.outputs, record.inputs, record.kind, record.variance)
    assert not any("driving point" in w for w in identify(structure, truth, record).warnings)
    assert any("driving point 6Y+ / 6Y+" in w for w in identify(structure, truth, flipped).warnings)


def test_every_fourth_line_of_the_band_is_used():
    structure, truth = cantilever()
    record = simulated(structure, truth, ("6Y+", "3Y+"))
    whole, thin = (used_lines(record, IdentifyOptions(band=(0.1, 1.0), every=every)) for every in (1, 4))
    np.testing.assert_array_equal(thin.frequency, whole.frequency[::4])
    found = identify(structure, truth.started_at(1.1 * truth.start), record, IdentifyOptions(every=4))
    assert found.fits[0].predicted.shape[0] == -(-len(BAND) // 4)
    assert np.abs(found.estimate.values / truth.start - 1).max() <= 1e-9
