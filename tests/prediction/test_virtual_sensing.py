"""The smoother against a batch estimate with whole covariance matrices, and its words."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import linalg, signal

import structid as sid
from structid.core.errors import InputError, NoAnswerError
from structid.prediction.identified_model import identified_model
from structid.prediction.recovery import parse_output
from structid.prediction.sensing import force_search, kalman_filter
from structid.prediction.sensing import sense as sensing
from structid.prediction.sensing.force_search import ChosenForces
from structid.prediction.sensing.kalman_filter import error_spectra, sum_of_powers
from structid.prediction.sensing.state_equations import ForceModel, ForceProcess, combine_forces

RATE, CORRELATION, FORCE = 50.0, 0.1, 20.0


def make_model(std=0.0, free=False, foot=2e3):
    sets = [
        sid.PointMass("m", [1, 2], mass=[2.0, 1.0]),
        sid.Spring("k", ["2X"], ["1X"], stiffness=[900.0]),
        sid.Dashpot("c", ["2X"], ["1X"], viscous_damping=[4.0]),
    ]
    if not free:
        sets += [sid.Spring("foot", "1X", stiffness=foot), sid.Dashpot("air", "1X", viscous_damping=6.0)]
    structure = sid.Structure({1: 0.0, 2: 1.0}, sets, active=["X"])
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", "k")])
    return identified_model(structure, parameters, parameters.start, np.array([[(900.0 * std) ** 2]]))


def make_linked_model():
    """The model of `make_model` with a third point that rigidly follows the second mass."""
    structure = sid.Structure(
        {1: 0.0, 2: 1.0, 3: 1.0}, make_model().structure.elements, active=["X"], ties=[sid.RigidLink("link", 2, [3])]
    )
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", "k")])
    return identified_model(structure, parameters, parameters.start, np.zeros((1, 1)))


def system():
    """Continuous matrices of the two masses with the force at mass 2 as a fifth state."""
    k, c, m = np.array([[2900.0, -900], [-900, 900]]), np.array([[10.0, -4], [-4, 4]]), np.diag([2.0, 1.0])
    a = np.zeros((5, 5))
    a[:2, 2:4] = np.eye(2)
    a[2:4, :2], a[2:4, 2:4], a[3, 4] = -np.linalg.solve(m, k), -np.linalg.solve(m, c), 1.0
    a[4, 4] = -1 / CORRELATION
    q = np.zeros((5, 5))
    q[4, 4] = 2 * FORCE**2 / CORRELATION
    return a, q


def simulate(n, seed):
    """A stationary record of the motions and the force, by the exact covariance between samples."""
    a, q = system()
    stationary = linalg.solve_continuous_lyapunov(a, -q)
    step = linalg.expm(a / RATE)
    noise = stationary - step @ stationary @ step.T
    rng = np.random.default_rng(seed)
    root, first = (linalg.cholesky(s + 1e-14 * np.trace(s) * np.eye(5), lower=True) for s in (noise, stationary))
    states = [first @ rng.standard_normal(5)]
    for _ in range(n - 1):
        states.append(step @ states[-1] + root @ rng.standard_normal(5))
    return np.array(states), step, stationary, rng


def measured(states, rng, std):
    a, _ = system()
    acceleration = states @ a[2:4].T
    return acceleration[:, [0]] + std * rng.standard_normal((len(states), 1))


def batch_estimate(step, stationary, read, std, y):
    """Mean and deviation (n_times, n_states) of all samples at once: E[x | y] = C_xy C_yy^-1 y with whole covariance matrices."""
    n, size = len(y), len(step)
    powers = [np.eye(size)]
    for _ in range(n - 1):
        powers.append(step @ powers[-1])
    lag, apart = np.array(powers) @ stationary, np.subtract.outer(np.arange(n), np.arange(n))
    blocks = lag[np.abs(apart)]
    blocks[apart < 0] = np.swapaxes(blocks[apart < 0], 1, 2)
    whole = np.swapaxes(blocks, 1, 2).reshape(size * n, size * n)
    rows = np.kron(np.eye(n), read)
    cross = whole @ rows.T
    gain = np.linalg.solve(rows @ cross + std**2 * np.eye(n), cross.T).T
    left = np.diag(whole) - np.einsum("ij,ij->i", gain, cross)
    return (gain @ y[:, 0]).reshape(n, size), np.sqrt(left).reshape(n, size)


@pytest.mark.parametrize("n", [360, 7])
def test_smoothed_motion_is_that_of_a_batch_estimate(n):
    """Gaussian conditioning of all samples at once: E[x | y] = C_xy C_yy^-1 y, of a record that begins in motion."""
    std = 0.3
    states, step, stationary, rng = simulate(n, 1)
    y = measured(states, rng, std)
    record = sid.TimeRecord(RATE, y, ["1X"], ["acceleration"], variance=np.array([std**2]))
    unknown = sid.UnknownForces(["2X"], CORRELATION, FORCE)
    found = sid.sense(make_model(), record, ["2X"], "displacement", unknown, n_draws=0, is_filtered=False)
    values, deviations = batch_estimate(step, stationary, system()[0][2:3], std, y)
    for value, deviation, state in ((found.values, found.std, 1), (found.forces, found.force_std, 4)):
        assert value[:, 0] == pytest.approx(values[:, state], abs=1e-4 * np.abs(values[:, state]).max())
        assert deviation[:, 0] == pytest.approx(deviations[:, state], rel=1e-3)


def test_more_forces_than_modes_are_those_of_a_batch_estimate():
    """Three forces at two masses, read by one sensor; two of them act at one mass, so that their difference moves nothing."""
    n, std, (a, _) = 120, 0.3, system()
    wide, noise = np.zeros((7, 7)), np.zeros((7, 7))
    wide[:4, :4], wide[4:, 4:] = a[:4, :4], -np.eye(3) / CORRELATION
    wide[2, 4], wide[3, 5:] = 1 / 2.0, 1.0
    noise[4:, 4:] = 2 * FORCE**2 / CORRELATION * np.eye(3)
    stationary, step = linalg.solve_continuous_lyapunov(wide, -noise), linalg.expm(wide / RATE)
    model = make_linked_model()
    states, _, _, rng = simulate(n, 3)
    y = measured(states, rng, std)
    record = sid.TimeRecord(RATE, y, ["1X"], ["acceleration"], variance=np.array([std**2]))
    unknown = sid.UnknownForces(["1X", "2X", "3X"], CORRELATION, FORCE)
    found = sid.sense(model, record, ["2X"], "displacement", unknown, n_draws=0, is_filtered=False)
    values, deviations = batch_estimate(step, stationary, wide[2:3], std, y)
    assert found.values[:, 0] == pytest.approx(values[:, 1], abs=1e-4 * np.abs(values[:, 1]).max())
    assert found.forces == pytest.approx(values[:, 4:], abs=1e-4 * np.abs(values[:, 4:]).max())
    assert found.force_std == pytest.approx(deviations[:, 4:], rel=1e-3)
    assert any("3 unknown forces act and 1 sensors measure" in sentence for sentence in found.words)


def test_a_correlation_time_without_a_steady_filter_is_never_the_likeliest(monkeypatch):
    """Its covariance has lost its digits, so that it is indefinite, and its likelihood is no number."""
    states, _, _, rng = simulate(400, 3)
    record = sid.TimeRecord(RATE, measured(states, rng, 0.3), ["1X"], ["acceleration"], variance=np.array([0.09]))

    def sensed_time():
        unknown = sid.UnknownForces(["2X"])
        return sid.sense(make_model(), record, ["2X"], unknown=unknown, n_draws=0, is_filtered=False).correlation_time

    expected, calls, covariance = sensed_time(), [], kalman_filter._predicted_covariance

    def indefinite_once(system):
        calls.append(system)
        return covariance(system) * (-1e9 if len(calls) == 1 else 1)

    monkeypatch.setattr(kalman_filter, "_predicted_covariance", indefinite_once)
    assert sensed_time() == pytest.approx(expected)


def test_deviations_are_those_of_the_errors_and_the_sensor_left_out_agrees():
    states, _, _, rng = simulate(4000, 2)
    y = np.hstack([measured(states, rng, 0.3), states[:, [1]] + 1e-4 * rng.standard_normal((4000, 1))])
    record = sid.TimeRecord(RATE, y, ["1X", "2X"], ["acceleration", "displacement"], variance=np.array([0.09, 1e-8]))
    unknown = sid.UnknownForces(["2X"], CORRELATION)
    found = sid.sense(make_model(), record, ["1X"], "velocity", unknown, ["2X"], n_draws=0, is_filtered=False)
    assert found.prior_std == pytest.approx(FORCE, rel=0.15)
    z = (found.values[:, 0] - states[:, 2]) / found.std[:, 0]
    assert np.sqrt((z[200:] ** 2).mean()) == pytest.approx(1.0, abs=0.12)
    assert found.checks[0][1] == pytest.approx(1.0, abs=0.12)


def test_a_model_that_misses_a_resonance_does_not_make_the_forces_larger():
    """Lightly damped, with both stiffnesses 30 % off: the noise of good sensors would make far larger forces likelier."""
    rng, fade = np.random.default_rng(10), np.exp(-1 / RATE / CORRELATION)
    parts = [
        sid.PointMass("m", [1, 2], mass=[2.0, 1.0]),
        sid.Spring("k", ["2X"], ["1X"], stiffness=[900.0]),
        sid.Spring("foot", "1X", stiffness=2e3),
        sid.Dashpot("c", ["2X"], ["1X"], viscous_damping=[0.2]),
        sid.Dashpot("air", "1X", viscous_damping=0.3),
    ]
    structure = sid.Structure({1: 0.0, 2: 1.0}, parts, active=["X"])
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", name) for name in ("k", "foot")])
    models = [identified_model(structure, parameters, f * parameters.start, np.zeros((2, 2))) for f in (1.0, 1.3)]
    force = FORCE * signal.lfilter([1.0], [1.0, -fade], np.sqrt(1 - fade**2) * rng.standard_normal((1500, 1)), axis=0)
    motion = sid.predict(models[0], sid.History(["1X", "2X"], ["2X"], force, RATE), n_draws=50).values
    noisy = motion + 0.02 * rng.standard_normal(motion.shape)
    record = sid.TimeRecord(RATE, noisy, ["1X", "2X"], ["acceleration"] * 2, variance=np.full(2, 4e-4))
    unknown = sid.UnknownForces(["2X"], CORRELATION)
    right, wrong = (sid.sense(m, record, ["2X"], unknown=unknown, n_draws=0, is_filtered=False) for m in models)
    assert right.prior_std == pytest.approx(force.std(), rel=0.4)
    assert right.is_explained
    assert "likelihood prefers far larger forces" not in "; ".join(right.words)
    assert wrong.prior_std == pytest.approx(force.std(), rel=0.5)
    assert "likelihood prefers far larger forces" in wrong.words[0]


@pytest.mark.parametrize(
    ("both", "foot", "words"),
    [
        (True, 2e3, ""),
        (False, 2e3, ""),
        (True, 2.6e3, "no choice of these forces explains"),
        (False, 2.6e3, "these sensors cannot tell which"),
    ],
)
def test_innovations_contradict_a_wrong_model(both, foot, words):
    """One sensor for one force leaves only the spectrum of the force to tell; a second one is what the force cannot move alone."""
    states, _, _, rng = simulate(1500, 12)
    y = states @ system()[0][2:4].T + 0.1 * rng.standard_normal((1500, 2))
    sensors = ["1X", "2X"] if both else ["1X"]
    n = len(sensors)
    record = sid.TimeRecord(RATE, y[:, :n], sensors, ["acceleration"] * n, variance=np.full(n, 0.01))
    found = sid.sense(
        make_model(0.01, foot=foot), record, ["2X"], unknown=sid.UnknownForces(["2X"]), n_draws=10, is_filtered=False
    )
    assert found.is_explained == (not words)
    assert words in found.contradiction
    assert not words or "does not explain the record" in found.contradiction


@pytest.mark.parametrize(
    ("noise", "foot", "is_stated", "words"),
    [
        (0.01, 2e3, True, "the model is wrong, or the unknown forces have another spectrum"),
        (0.5, 2e3, True, "the model is wrong, or the unknown forces have another spectrum"),
        (0.01, 2.6e3, True, "no choice of these forces explains"),
        (0.5, 2.6e3, True, "no choice of these forces explains"),
        (1.0, 2e3, False, "the record states no noise"),
    ],
)
def test_a_force_of_another_spectrum_does_not_make_a_right_model_wrong(noise, foot, is_stated, words):
    """White noise to 20 Hz, whose exact periodic response a force of a correlation time can only come near to."""
    rng, (a, _) = np.random.default_rng(1), system()
    lines = np.fft.rfftfreq(600, 1 / RATE)
    force = (rng.standard_normal(len(lines)) + 1j * rng.standard_normal(len(lines))) * ((lines > 0) & (lines < 20))
    force *= FORCE / np.fft.irfft(force, 600).std()
    s = 2j * np.pi * lines[:, None, None]
    states = np.linalg.solve(s * np.eye(4) - a[:4, :4], np.broadcast_to(a[:4, 4:], (len(lines), 4, 1)))
    motion = np.fft.irfft((s * states)[:, 2:4, 0] * force[:, None], 600, axis=0)
    noisy = motion + noise * rng.standard_normal(motion.shape)
    variance = np.full(2, noise**2) if is_stated else None
    record = sid.TimeRecord(RATE, noisy, ["1X", "2X"], ["acceleration"] * 2, variance=variance)
    sensed = sid.sense(make_model(foot=foot), record, ["2X"], unknown=sid.UnknownForces(["2X"]), n_draws=0)
    assert sensed.is_explained == (foot == 2e3)
    assert words in "; ".join((sensed.contradiction, *sensed.words))


@pytest.mark.parametrize("is_stated", [False, True])
def test_readings_that_the_model_explains_nothing_of_contradict_it_whatever_their_noise(is_stated):
    """White readings, whose errors show no correlation in time, beside a force that has nothing to do with them."""
    readings = np.random.default_rng(0).standard_normal((600, 3))
    variance = np.array([1e-4, 1e-4, 1e-4]) if is_stated else None
    record = sid.TimeRecord(
        RATE, readings, ["1X", "2X", "2X"], ["acceleration", "acceleration", "force"], variance=variance
    )
    sensed = sid.sense(make_model(0.01), record, ["2X"], n_draws=5)
    noise = "than stated" if is_stated else "than the 1 % of its reading that is assumed"
    assert f"the sensors have more noise {noise}" in sensed.contradiction


def steep_record(sensors, seed, n=300):
    """Accelerations with 1 % noise under a force at mass 2 behind three low-passes of first order, at eight times the rate."""
    rng, fade = np.random.default_rng(seed), np.exp(-8 / 3 / 0.3 / (8 * RATE))
    fine = rng.standard_normal((8 * (n + 500), 1))
    for _ in range(3):
        fine = signal.lfilter([1 - fade], [1, -fade], fine, axis=0)
    history = sid.History(["1X", "2X"], ["2X"], FORCE * fine / fine.std(), 8 * RATE)
    motion = sid.predict(make_model(), history, n_draws=50).values[::8][-n:, [int(name[0]) - 1 for name in sensors]]
    noise = 0.01 * motion.std(axis=0)
    noisy = motion + noise * rng.standard_normal(motion.shape)
    return sid.TimeRecord(RATE, noisy, sensors, ["acceleration"] * len(sensors), variance=noise**2)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_steeper_spectrum_explains_a_force_behind_low_passes(seed):
    record = steep_record(["1X", "2X"], seed)
    sensed = sid.sense(make_model(), record, ["1X"], unknown=sid.UnknownForces(["2X"]), n_draws=0)
    assert sensed.force_order > 1
    assert sensed.is_explained
    assert not sensed.words


def test_a_steeper_spectrum_of_one_sensor_explains_the_record_with_a_doubt():
    """One sensor cannot tell a force behind low-passes from a wrong model, so that what was said without them is told."""
    sensed = sid.sense(make_model(), steep_record(["2X"], 1), ["1X"], unknown=sid.UnknownForces(["2X"]), n_draws=0)
    assert sensed.force_order == 3
    assert sensed.is_explained
    assert (
        "whose spectrum falls with f^-6, as the record makes likelier than f^-2, explain the record" in sensed.words[0]
    )
    assert "under those that fall with f^-2 the model does not explain the record" in sensed.words[0]


def test_a_steeper_spectrum_does_not_make_a_wrong_model_right():
    record = steep_record(["1X", "2X"], 1)
    sensed = sid.sense(make_model(foot=2.1e3), record, ["1X"], unknown=sid.UnknownForces(["2X"]), n_draws=0)
    assert sensed.force_order > 1
    assert not sensed.is_explained
    assert "no choice of these forces explains" in sensed.contradiction


def test_more_forces_than_sensors_leave_a_doubt_and_no_contradiction():
    """Neither force is of the spectrum that is tried first, and a mode of the model is off; one sensor cannot tell."""
    record = steep_record(["1X"], 1)
    for foot in (2e3, 3e3):
        unknown = sid.UnknownForces(["1X", "2X"], 0.3)
        sensed = sid.sense(make_model(foot=foot), record, ["1X"], unknown=unknown, n_draws=0)
        assert sensed.is_explained
        assert "more unknown forces than sensors cannot tell which" in sensed.words[0]
        assert "use more sensors" not in sensed.words[0]


def test_more_forces_than_sensors_above_all_modes_have_no_answer():
    values = np.random.default_rng(0).standard_normal((50, 1))
    record = sid.TimeRecord(1.0, values, ["1X"], ["acceleration"], variance=np.array([0.01]))
    with pytest.raises(NoAnswerError, match="all modes lie above 1 Hz, the sampling rate"):
        sid.sense(make_model(), record, ["2X"], unknown=sid.UnknownForces(["1X", "2X"]), n_draws=0)


def test_forces_at_one_rigid_part_count_as_one_in_the_verdict():
    """Three sensors, three forces, two of them on one rigid part, and a sensor that reads 30 % low."""
    model = make_linked_model()
    states, _, _, rng = simulate(300, 3)
    acceleration = (states @ system()[0][2:4].T)[:, [0, 1, 1]]
    noisy = acceleration * [1.0, 1.0, 0.7] + 0.3 * rng.standard_normal((300, 3))
    sensors = ["1X", "2X", "3X"]
    record = sid.TimeRecord(RATE, noisy, sensors, ["acceleration"] * 3, variance=np.full(3, 0.09))
    unknown = sid.UnknownForces(sensors, CORRELATION, FORCE)
    sensed = sid.sense(model, record, ["2X"], unknown=unknown, n_draws=0, is_filtered=False)
    assert "no choice of these forces explains" in sensed.contradiction


def test_a_record_of_one_sample_and_a_negative_seed_are_no_crash():
    record = sid.TimeRecord(RATE, [[1.0, 0.0]], ["1X", "2X"], ["acceleration"] * 2, variance=np.full(2, 0.01))
    unknown = sid.UnknownForces(["2X"])
    assert np.isfinite(sid.sense(make_model(), record, ["2X"], unknown=unknown, n_draws=0).values).all()
    with pytest.raises(InputError, match="`seed` must be at least 0, got -1"):
        sid.sense(make_model(), record, ["2X"], unknown=unknown, n_draws=0, seed=-1)


def test_a_sine_is_found_as_a_force_about_a_frequency():
    """The second sensor agrees with the model, so that the spectrum of the force was wrong at first."""
    rng, model = np.random.default_rng(13), make_model()
    fine = FORCE * np.sin(2 * np.pi * 3.3 * np.arange(5600) / RATE / 8)[:, None]
    history = sid.History(["1X", "2X"], ["2X"], fine, 8 * RATE)
    motion, force = sid.predict(model, history, n_draws=50).values[::8], fine[::8]
    noisy = motion + 0.1 * rng.standard_normal(motion.shape)
    record = sid.TimeRecord(RATE, noisy, ["1X", "2X"], ["acceleration"] * 2, variance=np.full(2, 0.01))
    found = sid.sense(model, record, ["2X"], unknown=sid.UnknownForces(["2X"]), n_draws=0)
    assert found.is_explained
    assert found.force_frequency == pytest.approx(3.3, rel=0.01)
    error = (found.forces - force)[50:-50]
    assert np.abs(error).max() < 0.05 * FORCE
    assert (np.abs(error) < 1.96 * found.force_std[50:-50]).mean() > 0.93


def test_no_force_of_a_frequency_is_so_large_that_it_hides_sensors_in_each_others_place():
    rng, model = np.random.default_rng(13), make_model()
    fine = FORCE * np.sin(2 * np.pi * 3.3 * np.arange(2400) / RATE / 8)[:, None]
    motion = sid.predict(model, sid.History(["1X", "2X"], ["2X"], fine, 8 * RATE), n_draws=50).values[::8]
    noisy = motion + 0.1 * rng.standard_normal(motion.shape)
    record = sid.TimeRecord(RATE, noisy, ["2X", "1X"], ["acceleration"] * 2, variance=np.full(2, 0.01))
    found = sid.sense(model, record, ["2X"], unknown=sid.UnknownForces(["2X"]), n_draws=0)
    assert "the model does not explain the record" in found.contradiction
    assert found.prior_std < 100 * FORCE


def test_bands_of_slow_motion_that_rest_on_the_spectrum_of_the_forces_are_told():
    states, _, _, rng = simulate(600, 3)
    record = sid.TimeRecord(RATE, measured(states, rng, 5.0), ["1X"], ["acceleration"], variance=np.full(1, 25.0))

    def words(motion, *stated):
        unknown = sid.UnknownForces(["2X"], *stated)
        found = sid.sense(make_model(), record, ["2X"], motion, unknown, n_draws=0, is_filtered=False)
        return " ".join(found.words)

    assert "Hz these sensors tell less than half of the displacement at 2X+, and" in words("displacement", CORRELATION)
    assert "such a band rests on the spectrum" not in words("acceleration", CORRELATION)
    assert "such a band rests on the spectrum" not in words("displacement", CORRELATION, FORCE)


def test_each_output_whose_band_rests_on_the_spectrum_is_named(monkeypatch):
    """The slow part of one output is not hidden by those that are told, or do not move at all."""
    frequency = np.geomspace(1 / 10.0, RATE / 2, sensing._LOOKED_AT)
    flat, slow = np.ones(len(frequency)), np.where(frequency < 1.0, 1.0, 1e-3)
    before = np.column_stack([flat, slow, 0 * flat, *[1e6 * flat] * 5, *[slow] * 4])
    after = np.column_stack([0.4 * flat, slow, 0 * flat, *[4e5 * flat] * 5, *[slow] * 4])
    monkeypatch.setattr(sensing, "error_spectra", lambda *_: (before, after))
    setup = SimpleNamespace(rate=RATE, driving=np.zeros((500, 0)))
    force = parse_output("N[bars:1@0]")
    outputs = (*(sid.parse_dof(f"{k}X") for k in range(1, 9)), force, *(sid.parse_dof(f"{k}X") for k in (9, 10, 11)))
    (words,) = sensing.slow_motion_words(setup, None, None, outputs, "velocity")
    assert "less than half of the velocity at 2X+, N[bars:1@0], the velocity at 9X+ and 2 more, and" in words
    assert "nan" not in words
    assert sensing.slow_motion_words(setup, None, None, outputs[:1], "velocity") == ()


def test_trials_of_a_frequency_without_an_answer_are_no_end_of_the_search(monkeypatch):
    """The first size and some trials have none."""
    original, tried = force_search.state_equations, []

    def failing(setup, reduced, process):
        tried.extend([1] * bool(process.frequency))
        if process.frequency and len(tried) in (1, 2, 6, 9):
            raise np.linalg.LinAlgError if len(tried) % 2 else NoAnswerError
        return original(setup, reduced, process)

    chosen = ChosenForces(ForceProcess(CORRELATION, FORCE), True, -1e9)
    monkeypatch.setattr(sensing, "likeliest_time", lambda *_: chosen)
    monkeypatch.setattr(sensing, "likeliest_order", lambda *_: None)
    monkeypatch.setattr(force_search, "_MOST_TRIALS", 12)
    monkeypatch.setattr(force_search, "state_equations", failing)
    fine = FORCE * np.sin(2 * np.pi * 3.3 * np.arange(1200) / RATE / 8)[:, None]
    motion = sid.predict(make_model(), sid.History(["1X", "2X"], ["2X"], fine, 8 * RATE), n_draws=50).values[::8]
    noisy = motion + 0.1 * np.random.default_rng(13).standard_normal(motion.shape)
    record = sid.TimeRecord(RATE, noisy, ["1X", "2X"], ["acceleration"] * 2, variance=np.full(2, 0.01))
    unknown = sid.UnknownForces(["2X"])
    found = sid.sense(make_model(), record, ["2X"], unknown=unknown, n_draws=0, is_filtered=False)
    assert np.isfinite(found.values).all()
    assert len(tried) > 9


def test_spectra_of_what_the_record_leaves_open_sum_to_the_variance(monkeypatch):
    states, _, _, rng = simulate(400, 3)
    record = sid.TimeRecord(RATE, measured(states, rng, 0.5), ["1X"], ["acceleration"], variance=np.full(1, 0.25))
    judged = []
    within = sensing._within_uncertainty
    monkeypatch.setattr(sensing, "_within_uncertainty", lambda *given: judged.append(given) or within(*given))
    unknown = sid.UnknownForces(["2X"], CORRELATION, FORCE)
    found = sid.sense(make_model(), record, ["2X"], unknown=unknown, n_draws=0, is_filtered=False)
    [(setup, process, reduced, _, _)] = judged
    lines = (np.arange(2000) + 0.5) / 2000 * RATE / 2
    before, after = error_spectra(setup, reduced, process, lines)
    assert after.mean(axis=0)[0] == pytest.approx(found.std[200, 0] ** 2, rel=1e-3)
    assert before.mean(axis=0)[-1] == pytest.approx(FORCE**2, rel=1e-3)


@pytest.mark.parametrize("frequency", [0.0, 4.0])
@pytest.mark.parametrize("order", [1, 2, 3])
def test_forces_of_higher_order_fall_steeply_and_their_correlation_has_the_stated_integral(order, frequency):
    """Impulse responses of the chain of low-passes by matrix exponentials; far above the band its power falls by 4 an octave."""
    force = ForceModel.of(ForceProcess(0.3, 1.0, frequency, order), None)
    covariance = linalg.solve_continuous_lyapunov(force.dynamics, -np.diag(force.noise))
    step = linalg.expm(0.01 * force.dynamics)
    correlation, state = [], covariance @ force.output
    for _ in range(500):
        correlation.append(force.output @ state)
        state = step @ state

    def power(hertz):
        gain = np.linalg.solve(
            2j * np.pi * hertz * np.eye(len(force.dynamics)) - force.dynamics, np.diag(force.noise**0.5)
        )
        return float((np.abs(force.output @ gain) ** 2).sum())

    assert correlation[0] == pytest.approx(1.0)
    if not frequency:
        assert np.trapezoid(correlation, dx=0.01) == pytest.approx(0.3, rel=0.01)
    assert power(4000.0) / power(8000.0) == pytest.approx(4.0**order, rel=0.02)


def test_known_forces_leave_nothing_but_noise():
    rng = np.random.default_rng(3)
    force = rng.standard_normal((600, 1)).cumsum(axis=0)
    model = make_model()
    history = sid.History(["1X", "2X"], ["2X"], force, RATE, "displacement")
    motion = sid.predict(model, history, n_draws=50).values
    record = sid.TimeRecord(RATE, np.hstack([force, motion[:, [0]]]), ["2X", "1X"], ["force", "displacement"],
                            variance=np.array([0.0, 1e-12]))  # fmt: skip
    found = sid.sense(model, record, ["2X"], n_draws=0, is_filtered=False)
    assert found.values[:, 0] == pytest.approx(motion[:, 1], abs=1e-4 * np.abs(motion).max())


def test_known_forces_of_filtered_records_are_not_weakened_between_samples():
    """White noise up to half the rate, simulated at 16 times that; straight lines between samples weaken it at the modes."""
    factor, n = 16, 1500
    force = np.random.default_rng(14).standard_normal((n, 1))
    fine = signal.resample(force, factor * n, axis=0)
    history = sid.History(["1X", "2X"], ["2X"], fine, RATE * factor, "displacement")
    moved = sid.predict(make_model(), history, n_draws=50).values[::factor]
    values = np.column_stack(
        [force, moved[:, 0] + 10 * moved[:, 0].std() * np.random.default_rng(15).standard_normal(len(moved))]
    )
    record = sid.TimeRecord(RATE, values, ["2X", "1X"], ["force", "displacement"],
                            variance=np.array([0.0, 100 * moved[:, 0].var()]))  # fmt: skip
    errors = []
    for is_filtered in (True, False):
        found = sid.sense(make_model(), record, ["2X"], n_draws=0, is_filtered=is_filtered)
        errors.append(float((found.values[:, 0] - moved[:, 1])[700:-20].std() / moved[:, 1].std()))
    assert errors[0] < 0.007
    assert errors[1] > 0.015


def test_a_history_under_filtered_loads_is_that_of_what_the_filter_left():
    """White noise up to half the rate at 16 times that; acceleration at the loaded mass follows the load at once too."""
    factor, n = 16, 600
    force = np.random.default_rng(14).standard_normal((n, 1))
    fine = signal.resample(force, factor * n, axis=0)
    places = ["1X", "2X"], ["2X"]
    true = sid.predict(make_model(), sid.History(*places, fine, RATE * factor), n_draws=50).values[::factor]
    errors = []
    for is_filtered in (True, False):
        history = sid.History(*places, force, RATE, is_filtered=is_filtered)
        error = sid.predict(make_model(), history, n_draws=50).values - true
        errors.append(error[100:-20].std(axis=0) / true.std(axis=0))
    assert (errors[0] < 0.015).all()
    assert (errors[1] > 2 * errors[0]).all()


@pytest.mark.parametrize("size", [0.0, 500.0])
def test_known_forces_do_not_hide_the_size_of_unknown_ones(size):
    """A known force at one mass, none to far larger than the unknown force at the other."""
    rng, fade, n, model = np.random.default_rng(0), np.exp(-1 / RATE / CORRELATION), 800, make_model()
    hidden = FORCE * signal.lfilter([1.0], [1.0, -fade], np.sqrt(1 - fade**2) * rng.standard_normal(n))
    pushed = size * rng.standard_normal(n)
    history = sid.History(["1X", "2X"], ["1X", "2X"], np.column_stack([pushed, hidden]), RATE)
    motion = sid.predict(model, history, n_draws=50).values
    noisy = motion + 0.05 * rng.standard_normal(motion.shape)
    record = sid.TimeRecord(RATE, np.column_stack([pushed, noisy]), ["1X", "1X", "2X"],
                            ["force", "acceleration", "acceleration"], variance=np.array([0.0, 0.0025, 0.0025]))  # fmt: skip
    found = sid.sense(
        model, record, ["2X"], unknown=sid.UnknownForces(["2X"], CORRELATION), n_draws=0, is_filtered=False
    )
    assert found.prior_std == pytest.approx(hidden.std(), rel=0.3)
    assert found.is_explained
    assert "likelihood prefers far larger forces" not in "; ".join(found.words)


@pytest.mark.parametrize("tap", [0.0, 1e-3])
def test_a_decay_under_a_known_force_of_nothing_has_an_honest_deviation(tap):
    """The record begins in motion that the force in it cannot have made."""
    force = np.zeros((700, 1))
    force[20] = 100.0
    model = make_model()
    history = sid.History(["1X", "2X"], ["2X"], force, RATE, "displacement")
    motion = sid.predict(model, history, n_draws=50).values[60:460]
    noise = 0.01 * motion[:, 0].std()
    measured = motion[:, 0] + noise * np.random.default_rng(0).standard_normal(400)
    known = np.eye(1, 400, 300)[0] * tap
    record = sid.TimeRecord(RATE, np.column_stack([known, measured]), ["2X", "1X"], ["force", "displacement"],
                            variance=np.array([0.0, noise**2]))  # fmt: skip
    found = sid.sense(model, record, ["2X"], n_draws=0, is_filtered=False)
    error = found.values[:, 0] - motion[:, 1]
    assert np.abs(error).max() < 5 * noise
    assert 0.2 < np.sqrt(np.mean((error / found.std[:, 0])[:30] ** 2)) < 2.5


def test_information_on_states_that_hardly_fade_keeps_its_digits():
    step, matrix = np.diag([1 - 1e-14, 0.5]), np.array([[1.0, 0.1], [0.1, 2.0]])
    direct = sum(np.linalg.matrix_power(step.T, k) @ matrix @ np.linalg.matrix_power(step, k) for k in range(13))
    assert sum_of_powers(step.T, matrix, step, 13) == pytest.approx(direct, rel=1e-12)


def test_uncertain_models_widen_the_deviation():
    states, _, _, rng = simulate(500, 4)
    record = sid.TimeRecord(RATE, measured(states, rng, 0.3), ["1X"], ["acceleration"], variance=np.array([0.09]))
    unknown = sid.UnknownForces(["2X"], CORRELATION, FORCE)
    sure, unsure = (sid.sense(make_model(std), record, ["2X"], unknown=unknown) for std in (0.0, 0.3))
    assert np.median(unsure.std) > 1.2 * np.median(sure.std)


def test_what_cannot_be_told_is_named():
    record = sid.TimeRecord(RATE, np.ones((50, 1)), ["1X"], ["acceleration"], variance=np.array([1.0]))
    with pytest.raises(InputError, match="`unknown` names 1X\\+ twice"):
        sid.sense(make_model(), record, ["2X"], unknown=sid.UnknownForces(["1X+", "1X-"], 0.1))
    with pytest.raises(NoAnswerError, match="the structure is unsupported"):
        sid.sense(make_model(free=True), record, ["2X"], unknown=sid.UnknownForces(["2X"], 0.1, 1.0))
    with pytest.raises(InputError, match="`leave_out` names 2X"):
        sid.sense(make_model(), record, ["2X"], leave_out=["2X"])
    with pytest.raises(InputError, match="`correlation_time` must be greater than 0"):
        sid.UnknownForces(["2X"], 0.0)


def test_an_element_is_sensed_as_the_differences_of_its_ends():
    """The force in the bar between the masses is k (u2 - u1) + c (v2 - v1), with the deviation that the smoother has for it."""
    parts = [
        sid.PointMass("m", [1, 2], mass=[2.0, 1.0]),
        sid.Bar("k", [[1, 2]], mass=0.0, axial_stiffness=900.0, stiffness_damping=4.0),
        sid.Spring("foot", "1X", stiffness=2e3),
        sid.Dashpot("air", "1X", viscous_damping=6.0),
    ]
    structure = sid.Structure({1: 0.0, 2: 1.0}, parts, active=["X"])
    parameters = sid.parameters(structure, [sid.Unknown("axial_stiffness", "k")])
    model = identified_model(structure, parameters, parameters.start, np.zeros((1, 1)))
    states, _, _, rng = simulate(1500, 5)
    record = sid.TimeRecord(RATE, measured(states, rng, 0.3), ["1X"], ["acceleration"], variance=np.array([0.09]))
    unknown = sid.UnknownForces(["2X"], CORRELATION, FORCE)
    found = sid.sense(model, record, ["N[k:1@1]"], unknown=unknown, n_draws=0, is_filtered=False)
    force = 900 * (states[:, 1] - states[:, 0]) + 4 * (states[:, 3] - states[:, 2])
    z = (found.values[:, 0] - force) / found.std[:, 0]
    assert np.sqrt((z[200:] ** 2).mean()) == pytest.approx(1.0, abs=0.15)
    with pytest.raises(InputError, match="is not linear in the motion"):
        sid.sense(model, record, ["von_mises[k:1@top]"], unknown=unknown)


def test_a_record_that_was_filtered_has_no_force_above_half_its_rate():
    """Simulated at 16 times the rate and decimated: deviations of accelerations are too wide without the filter."""
    factor, n = 16, 2400
    a, _ = system()
    step, fade = linalg.expm(a[:4, :4] / RATE / factor), np.exp(-1 / RATE / factor / CORRELATION)
    held = linalg.solve(a[:4, :4], (step - np.eye(4))[:, [3]])[:, 0]
    rng = np.random.default_rng(6)
    force = signal.lfilter([1.0], [1.0, -fade], FORCE * np.sqrt(1 - fade**2) * rng.standard_normal(n * factor))
    state, states = np.zeros(4), np.zeros((n * factor, 4))
    for k in range(n * factor - 1):
        state = step @ state + held * force[k]
        states[k + 1] = state
    acceleration = states @ a[2:4, :4].T + np.outer(force, [0.0, 1.0])
    acceleration = signal.decimate(acceleration, factor, ftype="fir", axis=0)
    y = acceleration[:, [0]] + 0.05 * rng.standard_normal((n, 1))
    record = sid.TimeRecord(RATE, y, ["1X"], ["acceleration"], variance=np.array([0.05**2]))
    unknown = sid.UnknownForces(["2X"], CORRELATION, FORCE)
    z = []
    for is_filtered in (True, False):
        found = sid.sense(make_model(), record, ["2X"], "acceleration", unknown, n_draws=0, is_filtered=is_filtered)
        z.append(float(np.sqrt((((found.values - acceleration[:, [1]]) / found.std)[300:-20] ** 2).mean())))
    assert z[0] == pytest.approx(1.0, abs=0.12)
    assert z[1] < 0.8 * z[0]


def test_combinations_of_forces_that_move_no_sensor_are_named():
    """Two forces of the same place up to sign: their difference cannot be told, each of them a little."""
    states, _, _, rng = simulate(400, 7)
    y = np.hstack([measured(states, rng, 0.3), states[:, [3]] + 0.01 * rng.standard_normal((400, 1))])
    record = sid.TimeRecord(RATE, y, ["1X", "2X"], ["acceleration", "velocity"], variance=np.array([0.09, 1e-4]))
    sets = [
        *make_model().structure.elements,
        sid.PointMass("light", [3], mass=1e-6),
        sid.Spring("stiff", "3X", "2X", stiffness=1e7),
    ]
    structure = sid.Structure({1: 0.0, 2: 1.0, 3: 2.0}, sets, active=["X"])
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", "k")])
    model = identified_model(structure, parameters, parameters.start, np.zeros((1, 1)))
    found = sid.sense(model, record, ["1X"], unknown=sid.UnknownForces(["2X", "3X"], CORRELATION, FORCE), n_draws=0)
    assert any("1 2X - 1 3X" in words or "1 3X - 1 2X" in words or "- 1 2X + 1 3X" in words for words in found.words), (
        found.words
    )


def free_record(quantity="displacement", values=None, variance=1e-6):
    rng = np.random.default_rng(8)
    table = rng.standard_normal((300, 1)).cumsum(axis=0) if values is None else values
    return sid.TimeRecord(RATE, table, ["1X"], [quantity], variance=None if variance is None else np.array([variance]))


def test_free_structures_are_sensed_from_a_displacement_without_a_stated_force():
    """Two masses, then one that has nothing but its rigid motion; the likeliest force is of the size that moved it."""
    found = sid.sense(make_model(free=True), free_record(), ["2X"], unknown=sid.UnknownForces(["1X"], 0.1), n_draws=0)
    assert np.isfinite(found.std).all()
    parts = [sid.PointMass("m", [1], mass=2.0)]
    structure = sid.Structure({1: 0.0}, parts, active=["X"])
    parameters = sid.parameters(structure, [sid.Unknown("mass", "m")])
    model = identified_model(structure, parameters, parameters.start, np.zeros((1, 1)))
    rng = np.random.default_rng(9)
    force = FORCE * signal.lfilter([1.0], [1.0, -0.8], 0.6 * rng.standard_normal((600, 1)), axis=0)
    motion = sid.predict(model, sid.History(["1X"], ["1X"], force, RATE, "displacement"), n_draws=50).values
    record = free_record(values=motion + 1e-4 * rng.standard_normal(motion.shape), variance=1e-8)
    found = sid.sense(model, record, ["1X"], unknown=sid.UnknownForces(["1X"], 0.09), n_draws=0)
    assert np.isfinite(found.values).all()
    assert found.prior_std == pytest.approx(FORCE, rel=0.5)
    assert found.values[:, 0] == pytest.approx(motion[:, 0], abs=1e-3)


def test_records_that_cannot_be_used_are_named():
    silent = sid.TimeRecord(RATE, np.ones((50, 1)), ["1X"], ["acceleration"])
    with pytest.raises(InputError, match="sensor 1X\\+ states no noise and reads a constant"):
        sid.sense(make_model(), silent, ["2X"], unknown=sid.UnknownForces(["2X"], 0.1))
    with pytest.raises(InputError, match="has a noise of 0"):
        sid.sense(
            make_model(), free_record("acceleration", variance=0.0), ["2X"], unknown=sid.UnknownForces(["2X"], 0.1)
        )
    with pytest.raises(InputError, match="`dofs` of unknown forces must name"):
        sid.UnknownForces([], 0.1)
    values = np.random.default_rng(0).standard_normal((50, 2))
    record = sid.TimeRecord(RATE, values, ["2X", "1X"], ["force", "acceleration"], variance=np.array([0.0, 1.0]))
    with pytest.raises(InputError, match="`leave_out` names 2X\\+, a force of the record"):
        sid.sense(make_model(), record, ["2X"], leave_out=["2X"])


@pytest.mark.parametrize("std", [None, FORCE])
def test_the_likeliest_correlation_time_is_that_of_the_force(std):
    """Its size is stated or not; the force that they give is off by its stated deviation."""
    states, _, _, rng = simulate(3000, 11)
    y = np.hstack([measured(states, rng, 0.05), states[:, [1]] + 1e-4 * rng.standard_normal((3000, 1))])
    record = sid.TimeRecord(RATE, y, ["1X", "2X"], ["acceleration", "displacement"], variance=np.array([0.0025, 1e-8]))
    found = sid.sense(
        make_model(), record, ["1X"], unknown=sid.UnknownForces(["2X"], std=std), n_draws=0, is_filtered=False
    )
    assert found.correlation_time == pytest.approx(CORRELATION, rel=0.35)
    assert found.prior_std == pytest.approx(FORCE, rel=0.25)
    z = (found.forces[:, 0] - states[:, 4]) / found.force_std[:, 0]
    assert np.sqrt((z**2).mean()) == pytest.approx(1.0, abs=0.12)


@pytest.mark.parametrize("n_draws", [0, 3])
def test_draws_of_a_model_that_is_known_exactly_do_not_excuse_more_noise_than_stated(n_draws):
    states, _, _, rng = simulate(400, 12)
    y = states @ system()[0][2:4].T + 0.6 * rng.standard_normal((400, 2))
    record = sid.TimeRecord(RATE, y, ["1X", "2X"], ["acceleration"] * 2, variance=np.full(2, 0.09))
    unknown = sid.UnknownForces(["2X"], CORRELATION, FORCE)
    found = sid.sense(make_model(), record, ["2X"], unknown=unknown, n_draws=n_draws, is_filtered=False)
    assert not found.is_explained
    assert "the sensors have more noise than stated" in found.contradiction


def test_forces_that_move_no_mode_are_no_combination_and_have_no_size():
    """Two forces along Y, where stiff springs put all modes far above the record, and one sensor along X."""
    combined, parts = combine_forces(np.zeros((3, 2)))
    assert (combined.shape, parts.shape) == ((3, 0), (2, 0))
    sets = [
        sid.PointMass("m", [1, 2], mass=[2.0, 1.0], directions=["X", "Y"]),
        *make_model().structure.elements[1:],
        sid.Spring("side", ["1Y", "2Y"], stiffness=1e12),
    ]
    structure = sid.Structure({1: (0.0, 0.0), 2: (1.0, 0.0)}, sets, active=["X", "Y"])
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", "k")])
    model = identified_model(structure, parameters, parameters.start, np.zeros((1, 1)))
    accelerations = 0.1 * np.random.default_rng(0).standard_normal((100, 1))
    record = sid.TimeRecord(RATE, accelerations, ["1X"], ["acceleration"], variance=np.array([0.01]))
    stated = sid.sense(model, record, ["2X"], unknown=sid.UnknownForces(["1Y", "2Y"], CORRELATION, FORCE), n_draws=0)
    assert stated.forces == pytest.approx(0.0)
    assert stated.force_std == pytest.approx(FORCE, rel=1e-9)
    for times in ((CORRELATION,), ()):
        with pytest.raises(NoAnswerError, match="no sensor moves with the unknown forces"):
            sid.sense(model, record, ["2X"], unknown=sid.UnknownForces(["1Y", "2Y"], *times), n_draws=0)
