"""Errors of channels in histories that are fitted themselves: the likelihood, its gradient, and errors found again."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg

from short_record_cases import RATE, chain, exact_motion, record, unknowns
from structid import ChannelUnknown, IdentifyOptions, InputError, TimeRecord, channel_errors, identify_together
from structid.forward import SpectraProblem
from structid.forward.record_problem import with_polarities
from structid.identification.setups.time import TimeFit, TimeSetup
from structid.records.spectra import finite_spectra

BAND = (0.1, 12.0)
EVERY = [
    ChannelUnknown("gain", "4X", start=1.1),
    ChannelUnknown("gain", "2X", inputs="4X", start=0.9, name="cards"),
    ChannelUnknown("delay", "2X", start=1e-3),
    ChannelUnknown("delay", inputs="4X", start=-2e-3),
    ChannelUnknown("polarity", "2X"),
]


def spectra_with(errors, decay=0.0, seed=2, **more):
    structure = chain()
    unknown = unknowns(structure)
    noisy = record(structure, unknown.values(unknown.start), np.random.default_rng(seed), force_noise=0.1)
    spectra = finite_spectra(noisy, band=(0.3, 8.0), decay=decay)
    return SpectraProblem(structure, unknown, spectra, channels=channel_errors(spectra, errors), **more)


@pytest.mark.parametrize("decay", [0.0, 0.7])
def test_the_likelihood_with_errors_of_channels_is_that_of_the_textbook(decay):
    problem = with_polarities(spectra_with(EVERY, decay, order=2), [-1.0])
    structure, spectra = problem.structure, problem.spectra
    values = problem.parameters.values(problem.parameters.start)
    mass, damping, stiffness = (structure.matrix(law, values).toarray() for law in ("mass", "damping", "stiffness"))
    load, pick = (structure.selection(dofs).toarray() for dofs in (spectra.inputs, spectra.outputs))
    rows, right = [], []
    for line, s in enumerate(spectra.laplace):
        inverse = np.linalg.inv(s**2 * mass + s * damping + stiffness)
        reads = np.diag([1.1, -0.9 * np.exp(-s * 1e-3)]) @ pick.T * s**2
        h = reads @ inverse @ load / (0.9 * np.exp(s * 2e-3))
        noise = np.diag(spectra.motion_variance[line]) + spectra.force_variance[line] * h @ h.conj().T
        root = linalg.sqrtm(np.linalg.inv(noise)) * np.sqrt(2)
        poly = np.kron(np.eye(2), (s / abs(spectra.laplace[-1])) ** np.arange(3))
        rows.append(root @ np.hstack([reads @ inverse @ mass, s * reads @ inverse @ mass, poly]))
        right.append(root @ (h @ spectra.force[line] - spectra.motion[line]))
    table, error = np.concatenate(rows), np.concatenate(right)
    table, error = np.concatenate([table.real, table.imag]), np.concatenate([error.real, error.imag])
    scale = np.linalg.norm(table, axis=0)
    misfit = error - table / scale @ np.linalg.lstsq(table / scale, error, rcond=1e-12)[0]
    at = problem.linearize(problem.theta_start)
    assert at.residual @ at.residual == pytest.approx(misfit @ misfit, rel=1e-9)


def test_the_jacobian_gives_the_gradient_of_the_likelihood_in_gains_and_delays():
    problem = spectra_with(EVERY)
    theta = problem.theta_start + 0.03 * np.random.default_rng(1).standard_normal(16)
    theta[-2:] = [1.3e-3, -1.8e-3]
    at = problem.linearize(theta)
    np.testing.assert_allclose(at.residual, problem.residual(theta), rtol=1e-9, atol=1e-9)
    gradient, step = 2 * at.jacobian.T @ at.residual, 1e-4
    costs = np.array(
        [[np.sum(problem.residual(theta + k * step * e) ** 2) for k in (2, 1, -1, -2)] for e in np.eye(16)]
    )
    difference = costs @ [-1, 8, -8, 1] / (12 * step)
    for kind in set(problem.unknowns.kinds):  # of each kind: a second is as much as many newtons
        own = [k for k, other in enumerate(problem.unknowns.kinds) if other == kind]
        np.testing.assert_allclose(gradient[own], difference[own], atol=1e-6 * np.abs(gradient[own]).max())


def test_no_transient_and_no_noise_on_the_force_leave_the_errors_of_frfs():
    """Every column, not the gradient alone, where nothing is solved for inside."""
    problem = spectra_with(EVERY, transient=False)
    spectra = replace(problem.spectra, force_variance=np.zeros((1, 1)))
    problem = replace(problem, spectra=spectra)
    theta = problem.theta_start + 0.01
    theta[-2:] = [1.3e-3, -1.8e-3]
    step = 1e-5
    columns = [
        (problem.residual(theta + step * e) - problem.residual(theta - step * e)) / (2 * step) for e in np.eye(16)
    ]
    found = problem.linearize(theta).jacobian
    for own, other in zip(found.T, columns, strict=True):
        assert np.abs(own - other).max() < 1e-6 * np.abs(other).max()


def measured(rng, gains=(1.0, 1.0), late=0, load_gain=1.0, load_late=0, noise=0.01):
    """Acceleration at 4X and 2X with gains, the second late by whole samples, and the force's reading."""
    structure, more = chain(), max(late, load_late)
    unknown = unknowns(structure)
    n_times = 800 + more
    force, motion = exact_motion(structure, unknown.values(unknown.start), rng, n_times)
    first, second = motion["acceleration"][:, 3] * gains[0], motion["acceleration"][:, 1] * gains[1]
    own = [np.roll(signal, k)[more:] for signal, k in ((force * load_gain, load_late), (first, 0), (second, late))]
    table = np.column_stack(own)
    std = noise * np.sqrt((table**2).mean(axis=0))
    table = table + std * rng.standard_normal(table.shape)
    quantities = ("force", "acceleration", "acceleration")
    return TimeRecord(RATE, table, ("4X", "4X", "2X"), quantities, variance=std**2)


def identified(histories, errors, masses_known=False):
    structure = chain()
    unknown = unknowns(structure)
    if masses_known:
        unknown = unknown.kept_near_start(1e-5)
    setup = TimeSetup(structure, unknown.started_at(1.03 * unknown.start), histories, channel_unknowns=errors)
    return identify_together([setup], IdentifyOptions(band=BAND, restarts=0))


@pytest.mark.parametrize(
    ("made", "errors", "truth"),
    [
        ({"late": 2}, [ChannelUnknown("delay", "2X")], {"delay[2X+]": 0.05}),
        ({"gains": (1.0, 0.9)}, [ChannelUnknown("gain", "2X")], {"gain[2X+]": 0.9}),
        ({"gains": (9.80665, 1.0)}, [ChannelUnknown("gain", "4X")], {"gain[4X+]": 9.80665}),
        ({"late": 1}, [ChannelUnknown("delay", "2X")], {"delay[2X+]": 0.025}),
        ({"load_late": 1}, [ChannelUnknown("delay", inputs="4X")], {"delay[load 4X+]": 0.025}),
        (
            {"gains": (1.0, -1.2), "late": 1},
            [ChannelUnknown("gain", "2X"), ChannelUnknown("delay", "2X", start=0.01), ChannelUnknown("polarity", "2X")],
            {"gain[2X+]": 1.2, "delay[2X+]": 0.025},
        ),
    ],
)
def test_errors_of_channels_are_found_again_within_their_intervals(made, errors, truth):
    scores = []
    for seed in range(3):
        found = identified(measured(np.random.default_rng(seed), **made), errors)
        assert found.estimate.status.value == "converged"
        assert found.estimate.chi_square_per_dof == pytest.approx(1.0, abs=0.12)
        scores += [(found.estimate[name][0] - value) / found.estimate[name][1] for name, value in truth.items()]
        assert all(found.estimate[name][1] < 0.01 * abs(value) for name, value in truth.items())
        if any(error.property == "polarity" for error in errors):
            assert found.fits[0].polarities == {"polarity[2X+]": -1}
    assert np.abs(scores).max() < 3.5


def test_a_free_gain_of_the_load_leaves_only_ratios_and_says_so():
    found = identified(measured(np.random.default_rng(0), load_gain=1.1), [ChannelUnknown("gain", inputs="4X")])
    assert found.estimate.identifiability.rank == len(found.estimate.names) - 1
    [words] = [d.words for d in found.estimate.identifiability.directions]
    assert words.endswith("only as ratios: their absolute size is proportional to gain[load 4X+]")
    assert any("absolute masses and stiffnesses are not measured" in warning for warning in found.warnings)


def test_what_histories_do_not_have_is_refused():
    histories = measured(np.random.default_rng(0))
    structure = chain()
    window, gain = ChannelUnknown("window_decay", start=0.5), ChannelUnknown("gain", "2X")
    with pytest.raises(InputError, match="window's decay is no error of histories"):
        TimeSetup(structure, unknowns(structure), histories, channel_unknowns=[window]).prepared(IdentifyOptions())
    spectra = finite_spectra(histories)
    with pytest.raises(InputError, match="window's decay is no error of histories"):
        SpectraProblem(structure, unknowns(structure), spectra, channels=channel_errors(spectra, [window]))
    with pytest.raises(InputError, match="fit 'output_error' takes no errors of channels"):
        TimeSetup(structure, unknowns(structure), histories, TimeFit("output_error"), channel_unknowns=[gain]).prepared(
            IdentifyOptions()
        )
    two = replace(histories, channels=("4X", "2X", "2X"), quantities=("force", "acceleration", "displacement"))
    with pytest.raises(InputError, match="names 2X, which several channels read"):
        TimeSetup(structure, unknowns(structure), two, channel_unknowns=[gain]).prepared(IdentifyOptions())


def test_errors_of_channels_show_in_the_averaged_responses_too():
    """Those of another order and without a channel that has an error; a known error is no misfit there."""
    histories = measured(np.random.default_rng(0), (1.0, 2.0))
    errors = channel_errors(
        finite_spectra(histories),
        [ChannelUnknown("gain", ["2X"], start=2.0), ChannelUnknown("delay", "4X", start=1e-3)],
    )
    turned = replace(finite_spectra(histories), outputs=histories.channels[:0:-1])
    seen = errors.seen_by(turned)
    s = np.array([1j, 2j])
    np.testing.assert_allclose(seen.factor(errors.start, s), errors.factor(errors.start, s)[:, ::-1], rtol=1e-14)
    one = errors.seen_by(replace(finite_spectra(histories, outputs=["4X"])))
    np.testing.assert_allclose(one.factor(errors.start, s)[:, 0], errors.factor(errors.start, s)[:, 0], rtol=1e-14)
    assert one.names == errors.names
