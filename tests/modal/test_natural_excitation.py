"""Free decays from correlations of ambient motion, and their modes."""

import numpy as np
import pytest
from modal_cases import ambient_chain, beam_decay, chain_modes, nearest

from structid import InputError, TimeRecord
from structid.modal import identify_modes, modal_identification
from structid.modal.correlations import outputs
from structid.modal.subspace.natural_excitation import natural_excitation
from structid.modal.subspace.pole_uncertainty import free_decay_fit, is_free_decay, is_mostly_explained
from structid.similarity import mac


def test_values_are_correlations_in_units_of_channel_and_reference():
    """Against plain sums over all pairs of samples, from one sample on: rounding."""
    record = ambient_chain(0, 60.0)
    found = natural_excitation(record, 20, ["3X"])[0]
    y = record.values
    expected = [y[lag:].T @ y[: len(y) - lag, 2] / (len(y) - lag) for lag in range(1, 21)]
    np.testing.assert_allclose(found.values, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    assert found.start == pytest.approx(0.1)
    assert found.channels == record.channels
    assert found.quantities == record.quantities
    assert found.sampling_rate == 10.0
    assert "correlations with velocity 3X+" in found.source


def test_records_are_averaged_and_every_channel_is_a_reference():
    first, second = ambient_chain(0, 60.0), ambient_chain(1, 120.0)
    found = natural_excitation([first, second], 10)
    assert len(found) == 4
    both = [record.values for record in (first, second)]
    lag, n = 4, sum(len(y) - 4 for y in both)
    expected = sum(y[lag:].T @ y[:-lag, 1] for y in both) / n
    np.testing.assert_allclose(found[1].values[lag - 1], expected, rtol=1e-10)


def test_correlations_of_long_ambient_motion_are_a_free_decay():
    """An hour: the true modes explain 90 % of the decays, and almost nothing of the motion itself."""
    record = ambient_chain(0, 3600.0)
    s = chain_modes()[0] * (-0.01 + 1j)
    for given, share in ((natural_excitation(record), (0.0, 0.1)), (record, (0.8, 1.1))):
        data = outputs(given)
        rest = free_decay_fit(data, s)[1]
        left = sum(np.sum(e**2) for e in rest) / sum(np.sum(y**2) for y in data.series)
        assert share[0] <= left <= share[1]
        assert is_mostly_explained(data, rest) == (share[1] < 0.5)
        assert not is_free_decay(data, rest, s)  # what is left gathers at the modes


def test_decays_last_as_long_as_they_stand_out():
    """A record twenty times longer is worth longer decays; short ones keep 64 samples."""
    short, long = (natural_excitation(ambient_chain(2, duration), None, ["1X"])[0] for duration in (300.0, 6000.0))
    assert len(short.values) == 64
    assert 128 <= len(long.values) <= 600


@pytest.mark.parametrize("method", ["era", "itd", "pencil"])
def test_modes_of_the_decays_are_those_of_the_structure(method):
    """As near as SSI comes: 1 % of frequency, MAC 0.98."""
    omega, shapes = chain_modes()
    found = identify_modes(natural_excitation(ambient_chain(4)), method, n_pieces=0)
    near = nearest(found.omega, omega)
    assert np.abs(found.omega[near] / omega - 1).max() <= 0.01
    assert np.diag(mac(found.mode_shapes[:, near], shapes)).min() >= 0.98


def test_next_era_is_era_of_the_decays():
    record = ambient_chain(1)
    result = modal_identification(record, "next_era")
    assert result.method == "next_era"
    expected = identify_modes(natural_excitation(record), "era")
    np.testing.assert_array_equal(result.modes.frequency, expected.frequency)
    assert result.modes.n_modes == 4
    assert result.modes.covariance is None
    assert any("ssi_cov and pencil give it" in words for words in result.modes.warnings)


@pytest.mark.parametrize("method", ["era", "itd"])
def test_ambient_motion_given_to_a_method_for_free_decays_names_the_remedy(method):
    found = identify_modes(ambient_chain(0), method, orders=[8], block_rows=20)
    assert found.covariance is None
    assert any(f"no free decay of these modes, as {method} assumes" in note for note in found.warnings)
    assert any("next_era" in note and "natural_excitation" in note for note in found.warnings)
    decay = identify_modes(beam_decay(0.01, 0.005), method, orders=[24], block_rows=20)
    assert not any("free decay" in note for note in decay.warnings)


def test_references_and_lags_out_of_range_are_named():
    record = ambient_chain(0, 60.0)
    with pytest.raises(InputError, match=r"`references` must be among the channels 1X\+, 2X\+, 3X\+, 4X\+, got 7X\+"):
        natural_excitation(record, 10, ["7X"])
    with pytest.raises(InputError, match="`references` must name at least one channel"):
        natural_excitation(record, 10, [])
    with pytest.raises(InputError, match="`n_lags` must be at least 2, got 1"):
        natural_excitation(record, 1)
    with pytest.raises(InputError, match=r"at least 900 samples for lags up to 300 samples, got 600"):
        natural_excitation(record, 300)
    with pytest.raises(InputError, match="got forces only"):
        natural_excitation(TimeRecord(1.0, np.ones((100, 1)), ("1X",), ("force",)), 10)
