"""Fast Bayesian FFT method: likelihood and gradient as written, known modes, posterior spread, bad input."""

from pathlib import Path

import numpy as np
import pytest
from modal_cases import ambient_chain, chain_modes
from spectral_cases import CLOSE, close_pair, covariances, drawn_lines, modes_of, pair_shapes

from structid import InputError, TimeRecord
from structid.modal import ModalOptions, identify_modes
from structid.modal.correlations import outputs
from structid.modal.spectral.bayesian_fft import (
    Posterior,
    _band_warnings,
    _inverse,
    bayesian_fft,
    chart,
    coordinates,
    gradient,
    hessian,
    modes_at,
    negative_log_likelihood,
    posterior,
    transfer,
)
from structid.modal.spectral.peaks import Band
from structid.similarity import mac

PALISADEN = Path(__file__).parents[3] / "shared" / "data" / "palisaden_building" / "acc_20Hz_full90min.npy"
SIZES = [(5, 2, 2), (4, 1, 1), (1, 1, 0), (3, 3, 2), (1, 2, 1)]
LINES = np.linspace(1.8, 2.3, 60)


def shifted(n, m, seed=1):
    """Modes, a chart about them, and coordinates away from its centre."""
    modes = modes_of(n, m)
    place = chart(modes)
    return modes, place, coordinates(place) + 0.1 * np.random.default_rng(seed).standard_normal(place.size)


def differences(function, x, step=1e-5):
    return np.array([(function(x + e) - function(x - e)) / (2 * step) for e in step * np.eye(len(x))])


@pytest.mark.parametrize(("n", "m", "derivative"), SIZES)
def test_likelihood_is_that_of_the_covariance_as_written(n, m, derivative):
    """1e-9: rounding times the power of the modes over the noise, which is 1e7 at resonance, and less."""
    modes, place, x = shifted(n, m)
    data = drawn_lines(0, LINES, modes, derivative)
    there = modes_at(place, x)
    dense = 0.0
    for line, matrix in zip(data.lines, covariances(LINES, there, derivative), strict=True):
        dense += np.linalg.slogdet(matrix)[1] + (line.conj() @ np.linalg.solve(matrix, line)).real
    assert negative_log_likelihood(data, there) == pytest.approx(dense, rel=1e-9)
    assert gradient(data, place, x)[0] == pytest.approx(dense, rel=1e-9)
    centre = modes_at(place, coordinates(place))
    assert np.abs(centre.force - modes.force).max() <= 1e-12
    assert np.abs(centre.shapes - modes.shapes).max() <= 1e-12


@pytest.mark.parametrize(("n", "m", "derivative"), SIZES)
def test_gradient_agrees_with_differences(n, m, derivative):
    """1e-6 of the greatest slope: rounding of values of 1e3 over steps of 1e-5."""
    modes, place, x = shifted(n, m)
    data = drawn_lines(0, LINES, modes, derivative)
    slope = gradient(data, place, x)[1]
    numeric = differences(lambda x: gradient(data, place, x)[0], x)
    assert np.abs(slope - numeric).max() <= 1e-6 * np.abs(slope).max()


def test_hessian_agrees_with_second_differences():
    modes, place, x = shifted(3, 2)
    data = drawn_lines(0, LINES, modes)
    step = 1e-3
    found, e = hessian(data, place, x), step * np.eye(len(x))
    for i, j in ((0, 0), (0, 1), (1, 5), (3, 3), (2, 9), (4, 8), (12, 12), (7, 12)):
        corners = [gradient(data, place, x + a * e[i] + b * e[j])[0] for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
        numeric = (corners[0] - corners[1] - corners[2] + corners[3]) / (4 * step**2)
        assert found[i, j] == pytest.approx(numeric, rel=1e-3, abs=1e-5 * np.abs(found).max())


def test_information_is_the_mean_of_hessians():
    """tr(E^-1 dE_i E^-1 dE_j) over lines, by differences of E, against 300 draws; five standard errors of the mean."""
    modes = modes_of(3, 2, noise=0.05)
    place = chart(modes)
    x = coordinates(place)
    slopes = [np.array(d) for d in differences(lambda x: covariances(LINES, modes_at(place, x), 2), x)]
    inverse = np.linalg.inv(covariances(LINES, modes, 2))
    turned = [inverse @ d for d in slopes]
    expected = np.array([[np.einsum("kij,kji->", a, b).real for b in turned] for a in turned])
    scores = np.array([gradient(drawn_lines(seed, LINES, modes), place, x)[1] for seed in range(300)])
    size = np.sqrt(np.diag(expected))
    assert np.abs(scores.mean(axis=0) / size).max() <= 5 / np.sqrt(300)
    assert np.abs(np.cov((scores / size).T) - expected / np.outer(size, size)).max() <= 5 * np.sqrt(2 / 300)


def test_one_mode_is_the_most_probable_of_all():
    """No slope is left in any coordinate, and the shape is the principal eigenvector of the spectrum weighted as in Au
    (2011), Eqs. (22) to (27): w = S |h|^2 / (S |h|^2 + S_e).
    """
    data, start = drawn_lines(3, LINES, modes_of(5, 1)), modes_of(5, 1)
    modes = posterior(data, [2.02]).modes
    place = chart(modes)
    value, slope = gradient(data, place, coordinates(place))
    assert slope @ np.linalg.solve(hessian(data, place, coordinates(place)), slope) <= 1e-4
    assert value < negative_log_likelihood(data, start)
    spectrum = modes.force[0, 0].real * np.abs(transfer(data, modes)[0][:, 0]) ** 2
    weight = spectrum / (spectrum + modes.noise)
    principal = np.linalg.eigh((data.lines.T @ (weight[:, None] * data.lines.conj())).real)[1][:, -1]
    assert abs(principal @ modes.shapes[:, 0]) == pytest.approx(1.0, abs=1e-9)


def test_long_data_follow_the_uncertainty_law():
    """Au (2014): var f / f^2 = zeta / (2 pi N_c B_f), var zeta / zeta^2 = 1 / (2 pi zeta N_c B_zeta); 5 % of the std.

    Data of five draws, high signal over noise, band of f (1 +- kappa zeta).
    """
    kappa, n_periods, modes = 8.0, 4000, modes_of(4, 1, noise=1e-4)
    f, zeta = modes.frequency[0], modes.damping_ratio[0]
    lines = np.arange(f * (1 - kappa * zeta), f * (1 + kappa * zeta), f / n_periods)
    angle, edge = np.arctan(kappa), kappa / (kappa**2 + 1)
    of_f = 2 / np.pi * (angle - edge)
    of_zeta = 2 / np.pi * (angle + edge - 2 * angle**2 / kappa)
    found = np.mean([np.diag(posterior(drawn_lines(seed, lines, modes), [f]).covariance) for seed in range(5)], axis=0)
    assert np.sqrt(found[0]) / f == pytest.approx(np.sqrt(zeta / (2 * np.pi * n_periods * of_f)), rel=0.05)
    assert np.sqrt(found[1]) / zeta == pytest.approx(1 / np.sqrt(2 * np.pi * zeta * n_periods * of_zeta), rel=0.05)


@pytest.mark.parametrize(("m", "repeats"), [(1, 20), (2, 4)])
def test_posterior_spread_is_that_of_repeats(m, repeats):
    """Mean square of errors over their standard deviations: 1, within four standard errors of it."""
    modes, lines = modes_of(4, m), np.linspace(1.8, 2.3, 200)
    errors = []
    for seed in range(repeats):
        found = posterior(drawn_lines(seed, lines, modes), list(modes.frequency))
        assert found.converged
        order = np.argsort(found.modes.frequency)
        std = np.sqrt(np.diag(found.covariance))
        errors.append((found.modes.frequency - modes.frequency)[order] / std[:m][order])
        errors.append((found.modes.damping_ratio[order] - modes.damping_ratio) / std[m:][order])
    square = np.mean(np.square(errors))
    assert abs(square - 1) <= 4 * np.sqrt(2 / (2 * m * repeats))


def test_shapes_of_unit_norm_have_no_spread_along_themselves():
    modes = modes_of(4, 2)
    found = posterior(drawn_lines(0, np.linspace(1.7, 2.4, 400), modes), [2.0, 2.06])
    for shape, spread in zip(found.modes.shapes.T, found.shape_covariance, strict=True):
        assert np.linalg.norm(shape) == pytest.approx(1.0, rel=1e-12)
        assert np.abs(spread @ shape).max() <= 1e-10 * np.abs(spread).max()
        assert np.linalg.matrix_rank(spread) == 3


def test_modes_of_the_chain_are_found_by_themselves():
    """Within four standard deviations, which are those of ambient motion of this length."""
    omega, shapes = chain_modes()
    found = identify_modes(ambient_chain(4), "bayesian_fft")
    truth = np.concatenate([omega / (2 * np.pi), np.full(4, 0.01)])
    std = np.sqrt(np.diag(found.covariance))
    assert found.n_modes == 4
    assert not np.iscomplexobj(found.mode_shapes)
    assert (np.abs(np.concatenate([found.frequency, found.damping_ratio]) - truth) <= 4 * std).all()
    periods = omega / (2 * np.pi) * 600.0
    assert std[4:] / 0.01 == pytest.approx(1 / np.sqrt(2 * np.pi * 0.01 * periods), rel=0.5)
    largest = np.abs(found.mode_shapes).argmax(axis=0)
    error = found.mode_shapes - shapes / shapes[largest, range(4)]
    free = found.shape_std > 0
    assert free.sum() == 12
    assert (np.abs(error[free]) <= 4 * found.shape_std[free]).all()
    assert any(note.startswith("bands (number of modes): ") and note.count("Hz (1)") == 4 for note in found.warnings)


def test_two_close_modes_part_with_their_spread():
    """Half a half-power bandwidth apart: within four standard deviations, shapes within MAC 0.95, turned a little."""
    found = identify_modes(close_pair(0), "bayesian_fft")
    assert found.n_modes == 2
    std = np.sqrt(np.diag(found.covariance))
    error = np.concatenate([found.frequency - CLOSE, found.damping_ratio - 0.01])
    assert (np.abs(error) <= 4 * std).all()
    assert (std[:2] < 0.003).all()
    assert np.diag(mac(found.mode_shapes, pair_shapes())).min() >= 0.95


def test_two_modes_that_cannot_be_told_apart_have_no_covariance():
    """One frequency and one damping ratio: any turn of shapes and forces in their plane explains the same."""
    same = modes_of(4, 2)
    same = type(same)(np.full(2, 2.0), np.full(2, 0.01), pair_shapes(), np.eye(2, dtype=complex), 1e-3)
    place = chart(same)
    mean = covariances(LINES, same, 2)
    vectors = np.linalg.cholesky(mean)
    data = drawn_lines(0, LINES, same)
    whole = type(data)(np.repeat(LINES, 4), np.concatenate([2 * v.T for v in vectors]), 2)  # mean as the model has it
    values = np.linalg.eigvalsh(hessian(whole, place, coordinates(place)))
    assert values[0] <= 1e-6 * values[-1]
    lost = Posterior(same, np.full((4, 4), np.nan), np.full((2, 4, 4), np.nan), True)
    note = _band_warnings(1, Band(1.8, 2.3, (2.0, 2.0)), lost, outputs(ambient_chain(0, 60.0)))[0]
    assert "do not determine all that 2 modes need, so no covariance is given" in note
    assert _inverse(np.diag([1.0, 0.0])) is None


def test_two_records_know_as_much_as_one_of_twice_the_length():
    whole = ambient_chain(4, 1200.0)
    parts = [TimeRecord(10.0, part, whole.channels, whole.quantities) for part in np.split(whole.values, 2)]
    options = ModalOptions(bands=[(1.4, 1.8)])
    one, two = (bayesian_fft(given, options).modes for given in (whole, parts))
    assert two.frequency == pytest.approx(one.frequency, rel=2e-3)
    assert np.diag(two.covariance) == pytest.approx(np.diag(one.covariance), rel=0.3)


def test_quantities_are_brought_together():
    """Two channels as acceleration, exact line by line: the same modes."""
    record = ambient_chain(4)
    lines = np.fft.rfft(record.values - record.values.mean(axis=0), axis=0)
    omega = 2 * np.pi * np.fft.rfftfreq(len(record.values), 0.1)
    turned = np.fft.irfft(1j * omega[:, None] * lines, len(record.values), axis=0)
    values = np.concatenate([record.values[:, :2], turned[:, 2:]], axis=1)
    mixed = TimeRecord(10.0, values, record.channels, ("velocity",) * 2 + ("acceleration",) * 2)
    options = ModalOptions(bands=[(1.4, 1.8)])
    one, two = (bayesian_fft(given, options).modes for given in (record, mixed))
    assert two.frequency == pytest.approx(one.frequency, rel=1e-6)
    assert two.mode_shapes == pytest.approx(one.mode_shapes, rel=1e-4)


def test_palisaden_building_shows_its_three_modes():
    """Within 0.5 % of the published frequencies, bands found automatically below 3 Hz; certain to 0.005 Hz."""
    if not PALISADEN.exists():
        pytest.skip("the ambient record of the Palisaden building is not part of the package: shared/data is missing")
    values = np.load(PALISADEN).astype(float)
    record = TimeRecord(20.0, values, ("1X", "1Y", "2X", "2Y", "3X", "3Y"), ("acceleration",) * 6)
    found = bayesian_fft(record, ModalOptions(frequencies=[1.88, 2.42, 2.69])).modes
    assert found.frequency == pytest.approx([1.882, 2.422, 2.687], rel=0.005)
    assert (np.sqrt(np.diag(found.covariance))[:3] < 0.005).all()


# ---- bad input and doubtful data


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"bands": [(4.0, 6.0)]}, r"`bands` must lie between 0 and 5 Hz, got \(4, 6\)"),
        ({"bands": [(1.59, 1.592)]}, r"`bands` must hold at least 4 lines for 1 modes, got [0-3] in"),
        (
            {"bands": [(1.4, 1.8)], "frequencies": [3.0]},
            "`frequencies` must name a mode in every band, got none in 1.4",
        ),
        ({"bands": [(1.0, 2.0), (1.9, 2.5)]}, "`bands` must not overlap, got one to 2 Hz and one from 1.9 Hz"),
        ({"frequencies": [9.0]}, "`frequencies` must lie between 0 and 5 Hz"),
    ],
)
def test_bands_and_frequencies_out_of_place_are_named(options, words):
    record = ambient_chain(4, 200.0)
    with pytest.raises(InputError, match=words):
        bayesian_fft(record, ModalOptions(**options))


def test_a_band_may_end_at_half_the_rate_where_no_line_lies():
    """Segments of 301 samples have their last line at 4.98 Hz, the record one at 5 Hz."""
    record = ambient_chain(4, 200.0)
    found = bayesian_fft(record, ModalOptions(bands=[(1.4, 5.0)], frequencies=[1.6], segment=301)).modes
    assert 1.4 < found.frequency[0] < 1.8


def test_a_frequency_near_no_peak_is_named():
    """One pure tone, whose window falls without a second peak."""
    t = np.arange(1500) / 10.0
    tone = TimeRecord(10.0, np.cos(2 * np.pi * t)[:, None] * [[1.0, 2.0]], ("1X", "2X"), ("velocity",) * 2)
    with pytest.raises(InputError, match=r"`frequencies` must be near peaks .* got 0\.4 Hz"):
        bayesian_fft(tone, ModalOptions(frequencies=[0.4], segment=50))


def test_one_channel_is_enough():
    record = ambient_chain(4)
    first = TimeRecord(10.0, record.values[:, :1], record.channels[:1], record.quantities[:1])
    found = identify_modes(first, "bayesian_fft", frequencies=[1.59, 2.44])
    assert found.frequency == pytest.approx([1.592, 2.438], rel=0.01)
    assert found.mode_shapes.shape == (1, 2)
    assert np.isfinite(found.covariance).all()


def test_noise_without_a_peak_is_named():
    values = np.random.default_rng(0).standard_normal((3000, 3))
    record = TimeRecord(10.0, values, ("1X", "2X", "3X"), ("velocity",) * 3)
    with pytest.raises(InputError, match="no peak of the first singular value that stands out"):
        bayesian_fft(record)
    forced = bayesian_fft(record, ModalOptions(bands=[(1.0, 2.0)])).modes
    assert any("no peak stands out between 1 and 2 Hz" in note for note in forced.warnings)


def test_a_record_short_for_its_damping_is_warned_of():
    found = bayesian_fft(ambient_chain(4, 150.0), ModalOptions(bands=[(0.4, 0.7)])).modes
    assert any(
        "half-power bandwidth of the mode at 0.55" in note and "Measure longer" in note for note in found.warnings
    )
