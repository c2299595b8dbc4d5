"""Errors of channels: what they do to an FRF, their derivatives, and that simulated ones are found again."""

from dataclasses import replace

import numpy as np
import pytest

from structid import (
    ChannelUnknown,
    FrfProblem,
    FrfRecord,
    Friction,
    IdentifyOptions,
    InputError,
    PointMass,
    Prior,
    Spring,
    Structure,
    Unknown,
    channel_errors,
    identify,
    parameters,
    with_declared_noise,
)
from structid.forward.frf.response import response
from structid.forward.record_problem import decide_polarities
from structid.unknowns.tolerances import EXACT

FREQUENCY = np.arange(0.5, 12, 0.1)
TRUE = np.array([2.0, 3.0, 1.0, 1000.0, 1100.0, 900.0, 0.02])
UNKNOWNS = [
    *(Unknown("mass", f"m{i}") for i in (1, 2, 3)),
    Unknown("stiffness", "ground"),
    Unknown("stiffness", "upper", each=True),
    Unknown("loss_factor", ["ground", "upper"], name="springs", factor=False),
]


def chain(*more):
    masses = [PointMass(f"m{i}", [i], 1.4) for i in (1, 2, 3)]
    ground = Spring("ground", "1X", stiffness=1200.0, loss_factor=0.03)
    upper = Spring("upper", ["1X", "2X"], ["2X", "3X"], stiffness=900.0, loss_factor=0.03)
    return Structure({1: 0.0, 2: 1.0, 3: 2.0}, [*masses, ground, upper, *more], active=["X"])


def dense(laplace, outputs, inputs, kind):
    """Textbook: invert the dynamic stiffness at s, written out, hysteretic damping as i times stiffness."""
    stiffness = np.array([[2100.0, -1100, 0], [-1100, 2000, -900], [0, -900, 900]]) * (1 + 0.02j)
    s = laplace[:, None, None]
    power = {"receptance": 0, "mobility": 1, "accelerance": 2}[kind]
    return s**power * np.linalg.inv(s**2 * np.diag([2.0, 3.0, 1.0]) + stiffness)[:, outputs, :][:, :, inputs]


def record(values, outputs=("1X", "3X"), inputs=("3X",), kind="accelerance", seed=None, noise=0.01):
    if seed is not None:
        rng = np.random.default_rng(seed)
        error = rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape)
        values = values * (1 + noise * error / np.sqrt(2))
    return with_declared_noise(FrfRecord(FREQUENCY, values, outputs, inputs, kind), noise)


def axis(decay=0.0):
    return decay + 2j * np.pi * FREQUENCY


def measured(gains=(1.0, 1.0), delays=(0.0, 0.0), decay=0.0, kind="accelerance", **more):
    s = axis(decay)
    values = dense(s, [0, 2], [2], kind) * np.array(gains)[:, None]
    values = values * np.exp(-s[:, None, None] * np.array(delays)[:, None])
    return record(values, kind=kind, **more)


def differences(problem, theta, step=1e-5):
    columns = []
    for unit in np.eye(len(theta)):
        far, near = (
            problem.residual(theta + k * step * unit) - problem.residual(theta - k * step * unit) for k in (2, 1)
        )
        columns.append((8 * near - far) / (12 * step))
    return np.array(columns).T


@pytest.mark.parametrize("form", ["output", "log", "pole_free"])
def test_gains_and_delays_have_the_derivatives_of_differences(form):
    data = measured((1.1, 0.9), (1e-3, 2e-3), seed=1)
    declared = [
        ChannelUnknown("gain", "all", each=True, prior=Prior(1.0, 0.05)),
        ChannelUnknown("gain", inputs="3X", bounds=(0.5, 2.0)),
        ChannelUnknown("delay", "all", each=True, start=1e-3, prior=Prior(0.0, 1e-3)),
        ChannelUnknown("polarity", "1X"),
    ]
    unknown = parameters(chain(), UNKNOWNS)
    problem = FrfProblem(chain(), unknown, data, form, channels=channel_errors(data, declared))
    theta = problem.theta_start + 0.02 * np.random.default_rng(2).standard_normal(len(problem.names))
    theta[-2:] = [1.3e-3, 1.8e-3]
    expected = differences(problem, theta)
    assert np.abs(problem.linearize(theta).jacobian - expected).max() < 1e-7 * np.abs(expected).max()


@pytest.mark.parametrize("kind", ["receptance", "mobility", "accelerance"])
def test_a_windows_decay_has_the_derivative_of_differences(kind):
    data = measured(decay=0.7, kind=kind, seed=1)
    declared = [ChannelUnknown("window_decay", start=0.5), ChannelUnknown("delay", "1X", start=1e-3)]
    problem = FrfProblem(chain(), parameters(chain(), UNKNOWNS), data, channels=channel_errors(data, declared))
    theta = problem.theta_start + 0.01
    expected, found = differences(problem, theta), problem.linearize(theta).jacobian
    for column, own in zip(expected.T, found.T, strict=True):
        assert np.abs(own - column).max() < 1e-7 * np.abs(column).max()


def test_predictions_are_the_textbook_inverse_with_every_error_on():
    s = axis(0.4)
    data = measured((1.1, -0.9), (1e-3, 0.0), 0.4)
    declared = [
        ChannelUnknown("gain", "1X", start=1.1),
        ChannelUnknown("gain", "3X", start=1.8),
        ChannelUnknown("gain", inputs="3X", start=2.0),
        ChannelUnknown("delay", ["1X"], start=3e-3),
        ChannelUnknown("delay", inputs="3X", start=2e-3),
        ChannelUnknown("polarity", "3X"),
        ChannelUnknown("window_decay", start=0.4),
    ]
    unknown = parameters(chain(), UNKNOWNS).started_at(TRUE)
    problem = FrfProblem(chain(), unknown, data, channels=channel_errors(data, declared))
    problem = decide_polarities(problem, problem.theta_start)
    true = dense(s, [0, 2], [2], "accelerance")[:, :, 0]
    expected = true * np.array([1.1 / 2.0, -1.8 / 2.0]) * np.exp(-s[:, None] * np.array([1e-3, -2e-3]))
    assert np.allclose(problem.predicted(problem.theta_start)[:, :, 0], expected, rtol=1e-10)
    other = problem.predicted_on(replace(data, frequency=FREQUENCY + 0.03), problem.unknowns.start)
    moved = s + 2j * np.pi * 0.03
    again = dense(moved, [0, 2], [2], "accelerance")[:, 0, 0] * 0.55 * np.exp(-moved * 1e-3)
    assert np.allclose(other[:, 0, 0], again, rtol=1e-10)


def test_a_known_window_decay_is_corrected_exactly():
    data = measured(decay=0.4)
    known = replace(data, decay=np.full(len(FREQUENCY), 0.4))
    model = response(chain(), parameters(chain(), UNKNOWNS), known)
    assert np.allclose(model.values_at(TRUE), data.values, rtol=1e-12)
    once = IdentifyOptions(restarts=0, pole_free_start=False)
    near = parameters(chain(), UNKNOWNS).started_at(1.05 * TRUE)
    found = identify(chain(), near, known, once).estimate
    assert np.allclose(found.values, TRUE, rtol=1e-6)
    biased = identify(chain(), near, data, once).estimate
    assert biased["loss_factor[springs]"][0] > 2 * 0.02


def test_gains_delays_and_polarities_are_found_with_the_masses():
    data = measured((1.06, -0.92), (2e-3, -1e-3), seed=3)
    declared = [
        ChannelUnknown("gain", "all", each=True),
        ChannelUnknown("delay", "all", each=True),
        ChannelUnknown("polarity", "all"),
    ]
    known = [replace(u, fixed=True, start=3.0) if u.elements == "m2" else u for u in UNKNOWNS]
    made = parameters(chain(), known)
    found = identify(chain(), made, data, IdentifyOptions(tolerances=EXACT), channel_unknowns=declared)
    assert found.fits[0].polarities == {"polarity[1X+]": 1, "polarity[3X+]": -1}
    assert found.estimate.covariance_basis == "noise"
    truth = {"mass[m1]": 2.0, "mass[m3]": 1.0, "gain[1X+]": 1.06, "gain[3X+]": 0.92}
    truth |= {"delay[1X+]": 2e-3, "delay[3X+]": -1e-3}
    for name, value in truth.items():
        got, std = found.estimate[name]
        assert abs(got - value) < 3.5 * std < 0.02 * max(abs(value), 0.1), name
    assert any("polarity[3X+] is -1" in warning for warning in found.warnings)


def test_an_unknown_window_decay_is_found():
    found = identify(
        chain(),
        parameters(chain(), UNKNOWNS),
        measured(decay=0.4, seed=4),
        channel_unknowns=[ChannelUnknown("window_decay", start=0.1)],
    ).estimate
    value, std = found["window_decay[all channels]"]
    assert abs(value - 0.4) < 3.5 * std < 0.02
    value, std = found["loss_factor[springs]"]
    assert abs(value - 0.02) < 3.5 * std < 0.002


def test_a_free_gain_of_the_load_leaves_only_ratios_and_says_so():
    data = measured(seed=5)
    unknown = parameters(chain(), UNKNOWNS)
    free = identify(chain(), unknown, data, channel_unknowns=[ChannelUnknown("gain", inputs="all")])
    assert free.estimate.identifiability.rank == len(free.estimate.names) - 1
    [words] = [d.words for d in free.estimate.identifiability.directions]
    assert words.endswith("only as ratios: their absolute size is proportional to gain[load 3X+]")
    assert any("absolute masses and stiffnesses are not measured" in warning for warning in free.warnings)
    ratio = free.estimate.values[1] / free.estimate.values[0]
    assert abs(ratio - 1.5) < 0.01
    held = [ChannelUnknown("gain", inputs="all", prior=Prior(1.0, 0.02))]
    known = identify(chain(), unknown, data, IdentifyOptions(tolerances=EXACT), channel_unknowns=held)
    value, std = known.estimate["mass[m2]"]
    assert 0.019 < std / value < 0.021
    assert abs(value - 3.0) < 3 * std
    fixed = [replace(u, fixed=True, start=3.0) if u.elements == "m2" else u for u in UNKNOWNS]
    scaled = identify(
        chain(), parameters(chain(), fixed), data, channel_unknowns=[ChannelUnknown("gain", inputs="all")]
    )
    assert not any("absolute masses" in warning for warning in scaled.warnings)
    assert abs(scaled.estimate["gain[load 3X+]"][0] - 1.0) < 0.01


def test_errors_that_are_at_rest_change_no_estimate():
    data = measured(seed=6)
    plain = identify(chain(), parameters(chain(), UNKNOWNS), data).estimate
    declared = [
        ChannelUnknown("gain", "1X", prior=Prior(1.0, 1e-9)),
        ChannelUnknown("delay", "3X", prior=Prior(0, 1e-12)),
    ]
    held = identify(chain(), parameters(chain(), UNKNOWNS), data, channel_unknowns=declared).estimate
    assert np.allclose(held.values[: len(plain.values)], plain.values, rtol=1e-6)


def test_a_delay_near_zero_counts_as_identified():
    declared = [ChannelUnknown("delay", "1X")]
    found = identify(chain(), parameters(chain(), UNKNOWNS), measured(seed=7), channel_unknowns=declared).estimate
    value, std = found["delay[1X+]"]
    assert abs(value) < 3.5 * std
    assert found.identified.all()
    assert found.status.value == "converged"


@pytest.mark.parametrize(
    ("declared", "words"),
    [
        ([ChannelUnknown("gain", "7X")], "`outputs` must name channels of the record, got '7X'; the nearest is"),
        ([ChannelUnknown("gain")], "gain names no channel"),
        ([ChannelUnknown("gain", "1X"), ChannelUnknown("gain", ["1X", "3X"])], "claim the same channel"),
        ([ChannelUnknown("gain", "1X", name="a"), ChannelUnknown("gain", "3X", name="a")], "are called gain"),
        ([ChannelUnknown("window_decay")], "needs a `start`"),
        ([ChannelUnknown("window_decay", "1X", start=1.0)], "belongs to all channels"),
        ([ChannelUnknown("polarity", "1X", start=1.0)], r"takes no `start`"),
        ([ChannelUnknown("phase", "1X")], "must be one of gain, delay, window_decay, polarity"),
        ([ChannelUnknown("gain", "1X", start=-1.0)], "must lie between 0 and inf, got -1"),
        ([ChannelUnknown("gain", "1X", bounds=(2.0, 1.0))], "must increase"),
        ([ChannelUnknown("gain", "1X", prior=Prior(1.0, 0.0))], "prior of"),
        ([ChannelUnknown("delay", "1X", prior=Prior(1.0, 0.1, "lognormal"))], "takes no log-normal prior"),
    ],
)
def test_bad_declarations_are_told(declared, words):
    with pytest.raises(InputError, match=words):
        channel_errors(measured(), declared)


def test_what_cannot_be_combined_is_told():
    data = measured()
    window = channel_errors(data, [ChannelUnknown("window_decay", start=0.2)])
    unknown = parameters(chain(), UNKNOWNS)
    deeper = FrfProblem(chain(), unknown, replace(data, decay=np.full(len(FREQUENCY), 0.3)), channels=window)
    model = response(chain(), unknown, replace(data, decay=np.full(len(FREQUENCY), 0.5)))
    assert np.allclose(deeper.predicted(deeper.theta_start), model.values_at(unknown.start), rtol=1e-12)
    with pytest.raises(InputError, match="form 'equation'"):
        FrfProblem(chain(), unknown, data, "equation", channels=window)
    rubbing = chain(Friction("pad", "1X", friction_force=0.1))
    with pytest.raises(InputError, match="without friction"):
        FrfProblem(rubbing, parameters(rubbing, UNKNOWNS), data, channels=window)


def test_groups_share_one_parameter_and_names_say_which():
    data = measured()
    made = channel_errors(
        data,
        [
            ChannelUnknown("gain", "all", name="accelerometers"),
            ChannelUnknown("delay", "all", inputs="3X", each=True, name="filter"),
        ],
    )
    assert made.names == ("gain[accelerometers]", "delay[filter:1X+]", "delay[filter:3X+]", "delay[filter:load 3X+]")
    assert made.units == ("1", "s", "s", "s")
    assert np.array_equal(made.exponents[0], [[1.0], [1.0]])
    assert np.array_equal(made.exponents[3], [[-1.0], [-1.0]])
