"""Best values of a tuned mass damper: Den Hartog's for one undamped mass, and those that hold over an uncertainty."""

import numpy as np
import pytest

import structid as sid
from structid.core.errors import InputError
from structid.prediction.identified_model import identified_model

MASS, STIFFNESS = 10.0, 4e4


def make_mass(std):
    parts = [sid.PointMass("m", [1], mass=MASS), sid.Spring("k", "1X", stiffness=STIFFNESS)]
    structure = sid.Structure({1: 0.0}, parts, active=["X"])
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", "k")])
    return identified_model(structure, parameters, parameters.start, np.array([[(std * STIFFNESS) ** 2]]))


@pytest.mark.parametrize("ratio", [0.02, 0.1])
def test_one_undamped_mass_takes_den_hartogs_damper(ratio):
    """Den Hartog (1985), Mechanical Vibrations, Eqs. 3.29, 3.32 and 3.35; his damping is within 1 % of the exact least peak."""
    own = np.sqrt(STIFFNESS / MASS) / (2 * np.pi)
    found = sid.tune_damper(make_mass(1e-9), "1X", ratio * MASS)
    assert found.change.frequency == pytest.approx(own / (1 + ratio), rel=3e-3)
    assert found.change.damping_ratio == pytest.approx(np.sqrt(3 * ratio / (8 * (1 + ratio))), rel=0.02)
    assert found.peak * STIFFNESS == pytest.approx(np.sqrt(1 + 2 / ratio), rel=5e-3)


def test_an_uncertain_structure_takes_more_damping_and_gains_over_the_nominal_damper():
    found = sid.tune_damper(make_mass(0.08), "1X", 0.02 * MASS)
    assert found.change.damping_ratio > 1.2 * found.nominal.damping_ratio
    assert found.peak < 0.95 * found.nominal_peak < found.peak_before
    assert "best over the uncertainty" in str(found)


def test_the_mode_that_is_tuned_to_may_be_far_below_the_others():
    """A soft mode at a thousandth of the highest frequency is no rigid motion."""
    beam = sid.Beam("mast", [[i, i + 1] for i in range(8)], mass=6.0, bending_stiffness=2000.0)
    structure = sid.Structure(
        {i: 0.5 * i for i in range(9)}, [beam, sid.Spring("foot", "0RZ", stiffness=1e3)], fixed=["0Y"]
    )
    parameters = sid.parameters(structure, [sid.Unknown("bending_stiffness", "mast")])
    model = identified_model(structure, parameters, parameters.start, np.zeros((1, 1)))
    [lowest] = sid.predict(model, sid.NaturalModes(1), n_draws=50).values[:, 0]
    low, high = sid.tune_damper(model, "8Y", 1.0, n_draws=50).band
    assert low < lowest < high


def test_the_coupled_damper_is_that_of_a_structure_with_it():
    """Receptances with a damper coupled to them equal those of a structure that has its mass, spring and dashpot."""
    model, mass = make_mass(0.0), 0.3
    found = sid.tune_damper(model, "1X", mass)
    frf = sid.Frf(["1X"], ["1X"], np.linspace(*found.band, 1200), "receptance")
    after = sid.predict_change(model, frf, [found.change], n_draws=50).after.values
    assert np.abs(after).max() == pytest.approx(found.peak, rel=1e-9)


def test_a_band_chooses_the_mode_that_the_damper_is_tuned_to():
    """Two masses in a row: the first mode dominates the flexibility, and the band leaves the second alone."""
    parts = [
        sid.PointMass("m", [1, 2], mass=[4.0, 2.0]),
        sid.Spring("k", "1X", stiffness=3e4),
        sid.Spring("c", "2X", "1X", stiffness=4e4),
    ]
    structure = sid.Structure({1: 0.0, 2: 1.0}, parts, active=["X"])
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", "k")])
    model = identified_model(structure, parameters, parameters.start, np.array([[1.0]]))
    squares = np.linalg.eigvals(np.linalg.solve(np.diag([4.0, 2.0]), [[7e4, -4e4], [-4e4, 4e4]]))
    first, second = np.sort(np.sqrt(squares)) / (2 * np.pi)
    assert sid.tune_damper(model, "2X", 0.05).change.frequency == pytest.approx(first, rel=0.05)
    found = sid.tune_damper(model, "2X", 0.05, band=(0.7 * second, 1.3 * second))
    assert found.change.frequency == pytest.approx(second, rel=0.05)
    assert found.peak < 0.3 * found.peak_before
    with pytest.raises(InputError, match="no mode between 1 and 2 Hz"):
        sid.tune_damper(model, "2X", 0.05, band=(1.0, 2.0))


def test_dampers_that_cannot_be_are_named():
    with pytest.raises(InputError, match="along X, Y or Z"):
        sid.tune_damper(make_mass(0.1), "1RZ", 1.0)
    with pytest.raises(InputError, match="`mass` must be greater than 0"):
        sid.tune_damper(make_mass(0.1), "1X", 0.0)
    with pytest.raises(sid.InputError, match=r"must be at most .* kg, what the mode at"):
        sid.tune_damper(make_mass(0.1), "1X", 1e9)
    with pytest.raises(InputError, match="`quantile` must be at least"):
        sid.tune_damper(make_mass(0.1), "1X", 1.0, quantile=1.0)
    with pytest.raises(InputError, match="`n_draws` must be at least 1, got 0"):
        sid.tune_damper(make_mass(0.1), "1X", 1.0, n_draws=0)
    with pytest.raises(InputError, match="9X"):
        sid.tune_damper(make_mass(0.1), "9X", 1.0)
