"""Bands against closed forms, shared errors that cancel, and changes against structures made with them."""

from functools import partial
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from scipy import stats

import structid as sid
from structid.core.errors import InputError, NoAnswerError
from structid.prediction.changes import changed_model
from structid.prediction.identified_model import identified_model
from structid.prediction.model_error import ModelError
from structid.prediction.predict import predict_together
from structid.study.results.stored_model import stored_band
from structid.study.run import predicting

NODES = {i: float(i) for i in range(4)}


def make_chain(**changes):
    sets = [
        sid.PointMass("m", [1, 2, 3], mass=[2.0, 3.0, 1.5]),
        sid.Spring("k", ["1X", "2X", "3X"], second=None, stiffness=[4e3, 0.0, 0.0]),
        sid.Spring("between", ["2X", "3X"], ["1X", "2X"], stiffness=[3e3, 2e3]),
        sid.Dashpot("c", ["1X"], viscous_damping=[4.0]),
    ]
    return sid.Structure(NODES, sets, active=["X"], **changes)


def make_oscillator(std=0.02, mass_std=0.0):
    """One mass on a spring; the mass is fixed within a tolerance, and the stiffness follows it so that the frequency stays."""
    sets = [
        sid.PointMass("m", [1], mass=2.0),
        sid.Spring("k", "1X", stiffness=8e3),
        sid.Dashpot("c", "1X", viscous_damping=3.0),
    ]
    structure = sid.Structure({1: 0.0}, sets, active=["X"])
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", "k")])
    fixed = {"mass[m]": mass_std} if mass_std else None
    changes = np.array([[8e3 * mass_std]]) if mass_std else None
    return identified_model(structure, parameters, parameters.start, np.array([[(8e3 * std) ** 2]]), fixed, changes)


def test_modes_are_followed_by_their_energy_where_a_mass_is_taken_out():
    """Rotations of short waves are large numbers, displacements of long ones small: the mass matrix makes them comparable."""
    beam = sid.Beam("mast", [[i, i + 1] for i in range(8)], mass=6.0, bending_stiffness=2000.0)
    sets = [beam, sid.PointMass("sign", [8], mass=2.0), sid.Spring("foot", "0RZ", stiffness=4e4)]
    structure = sid.Structure({i: 0.5 * i for i in range(9)}, sets, fixed=["0Y"])
    parameters = sid.parameters(structure, [sid.Unknown("bending_stiffness", "mast")])
    model = identified_model(structure, parameters, parameters.start, np.zeros((1, 1)))
    told = sid.predict_change(model, sid.NaturalModes(8), [sid.Remove("sign")], n_draws=50)
    ratio = told.after.values[:, 0] / told.before.values[:, 0]
    assert ((ratio > 1.0) & (ratio < 1.2)).all(), ratio


def test_every_use_starts_from_an_identification_and_says_so_of_anything_else():
    """One sensor named by a bare text does too."""
    structure = make_oscillator().structure
    unknown = sid.parameters(structure, [sid.Unknown("stiffness", "k")])
    like = sid.FrfRecord(np.linspace(5.0, 15.0, 40), np.ones((40, 1, 1)), ("1X",), ("1X",), "receptance")
    frf = sid.simulated_record(structure, unknown, like, 0.01, np.random.default_rng(1))
    fit = sid.identify(structure, unknown, sid.with_declared_noise(frf, relative=0.01))
    force = np.random.default_rng(0).standard_normal((200, 1))
    record = sid.TimeRecord(100.0, np.hstack([force, 0.1 * force]), ["1X", "1X"], ["force", "acceleration"])
    assert sid.sense(fit, record, "1X", n_draws=2).values.shape == (200, 1)
    assert sid.state_space(fit, "1X", "1X", (5.0, 15.0)).a.shape == (2, 2)
    assert sid.predict(fit, sid.Frf("1X", "1X", [10.0])).values.shape == (1, 1, 1)
    for use in (
        lambda: sid.predict(fit.estimate, sid.NaturalModes(1)),
        lambda: sid.sense(fit.estimate, record, "1X"),
        lambda: sid.state_space(fit.estimate, "1X", "1X", (5.0, 15.0)),
        lambda: sid.tune_damper(fit.estimate, "1X", 0.1),
    ):
        with pytest.raises(InputError, match=r"an identification is needed, .*got Estimate"):
            use()


@pytest.mark.parametrize(
    ("quantity", "changes", "words"),
    [
        ("3Y", None, r"`quantity` must be an Frf, .* got '3Y'; for a sensor give its FRFs, such as Frf"),
        (sid.NaturalModes, None, "`quantity` must be an Frf, .* got <class .*NaturalModes"),
        ("3Y", [sid.AddMass(1, 1.0)], "`quantity` must be an Frf, .* got '3Y'"),
        (
            sid.NaturalModes(1),
            sid.AddMass,
            r"`changes` must be a sequence .*AddMass\(node=12, mass=5.0\)\], got <class",
        ),
        (sid.NaturalModes(1), [sid.AddMass], "`changes` must be a sequence .*, got <class"),
        (sid.NaturalModes(1), sid.AddMass(1, 1.0), r"`changes` must be a sequence .*, got AddMass\(node=1, mass=1.0\)"),
    ],
)
def test_what_is_no_quantity_or_no_change_is_named(quantity, changes, words):
    use = sid.predict if changes is None else partial(sid.predict_change, changes=changes)
    with pytest.raises(InputError, match=words):
        use(make_oscillator(0.02), quantity)


def test_a_prediction_counts_its_entries_in_words():
    shown = repr(sid.predict(make_oscillator(0.02), sid.Frf(["1X"], ["1X"], np.linspace(5.0, 15.0, 30)), n_draws=50))
    assert "Frf of 30 frequencies, 1 output, 1 input, (m/s^2)/N" in shown


def test_band_of_a_frequency_is_half_that_of_the_stiffness():
    found = sid.predict(make_oscillator(0.02), sid.NaturalModes(1), n_draws=1000)
    f = np.sqrt(8e3 / 2.0) / (2 * np.pi)
    assert found.values[0, 0] == pytest.approx(f)
    assert found.std[0, 0] == pytest.approx(0.01 * f, rel=0.07)
    assert (found.low[0, 0], found.high[0, 0]) == pytest.approx((f * (1 - 0.0196), f * (1 + 0.0196)), rel=3e-3)


class Stiffness:
    """The first parameter itself."""

    axes, units, unit = {"output": ("k",)}, ("N/m",), "N/m"

    def evaluator(self, structure, parameters, points):
        return lambda physical: physical[:1]


def test_a_band_of_few_random_models_holds_the_truth_as_often_as_one_of_many():
    model, coverage = make_oscillator(0.02), []
    for seed in range(100):
        found = sid.predict(model, Stiffness(), n_draws=60, seed=seed)
        ends = stats.norm.cdf(np.log([found.low[0], found.high[0]] / found.values[0]) / 0.02)
        coverage.append(ends[1] - ends[0])
    assert np.mean(coverage) == pytest.approx(0.95, abs=0.008)  # 0.92 between the quantiles of the draws


def test_an_error_that_mass_and_stiffness_share_cancels_in_the_frequency_and_not_in_the_static_response():
    model = make_oscillator(1e-9, 0.03)
    modes = sid.predict(model, sid.NaturalModes(1), n_draws=200)
    assert modes.std[0, 0] < 1e-3 * modes.values[0, 0]
    static = sid.predict(model, sid.Frf(["1X"], ["1X"], [0.01], "receptance"), n_draws=1000)
    assert static.std[0, 0, 0] == pytest.approx(0.03 / 8e3, rel=0.07)


def test_frf_is_that_of_a_dense_solution():
    structure = make_chain()
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", "between", each=True)])
    model = identified_model(structure, parameters, parameters.start, np.zeros((2, 2)))
    frequency = np.linspace(1, 12, 40)
    found = sid.predict(model, sid.Frf(["3X", "1X"], ["2X"], frequency), n_draws=50)
    k = np.array([[4e3 + 3e3, -3e3, 0], [-3e3, 5e3, -2e3], [0, -2e3, 2e3]])
    w = 2 * np.pi * frequency[:, None, None]
    z = k + 1j * w * np.diag([4.0, 0, 0]) - w**2 * np.diag([2.0, 3.0, 1.5])
    exact = -(w**2) * np.linalg.inv(z)[:, [2, 0]][:, :, [1]]
    assert found.values == pytest.approx(exact, rel=1e-9)
    assert found.low == pytest.approx(np.abs(exact), rel=1e-9)


@pytest.mark.parametrize(
    ("change", "matrices"),
    [
        (sid.AddMass(2, 0.7), (np.diag([2.0, 3.7, 1.5]), [4e3, 3e3, 2e3])),
        (sid.Scale("stiffness[between:2]", 1.3), (np.diag([2.0, 3.0, 1.5]), [4e3, 3e3, 2.6e3])),
        (sid.Scale("stiffness[between]", 1.3), (np.diag([2.0, 3.0, 1.5]), [4e3, 3.9e3, 2.6e3])),
    ],
)
def test_changes_are_those_of_the_matrices(change, matrices):
    structure = make_chain()
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", "between", each=True)])
    changed, moved = changed_model(structure, parameters, [change])
    values, (mass, (a, b, c)) = moved.values(parameters.start), matrices
    assert changed.matrix("mass", values).toarray() == pytest.approx(mass)
    stiffness = [[a + b, -b, 0], [-b, b + c, -c], [0, -c, c]]
    assert changed.matrix("stiffness", values).toarray() == pytest.approx(np.array(stiffness))


def test_a_support_and_a_set_taken_out():
    structure = make_chain()
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", "between", each=True)])
    held, moved = changed_model(structure, parameters, [sid.AddSupport("2X"), sid.Remove("c")])
    assert [str(dof.unsigned) for dof in held.dofs] == ["1X+", "3X+"]
    assert held.matrix("stiffness", moved.values(parameters.start)).toarray() == pytest.approx(np.diag([7e3, 2e3]))
    assert held.matrix("damping", moved.values(parameters.start)).nnz == 0


def test_a_tuned_mass_damper_lowers_its_resonance_as_den_hartog_says():
    """Den Hartog (1985), Mechanical Vibrations, Eq. 3.32: the two fixed points of an undamped mass lie at sqrt(1 + 2 / ratio)."""
    ratio, mass, stiffness = 0.05, 10.0, 4e4
    sets = [sid.PointMass("m", [1], mass=mass), sid.Spring("k", "1X", stiffness=stiffness)]
    structure = sid.Structure({1: 0.0}, sets, active=["X"])
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", "k")])
    model = identified_model(structure, parameters, parameters.start, np.array([[1e-6]]))
    own = np.sqrt(stiffness / mass) / (2 * np.pi)
    damping = np.sqrt(3 * ratio / (8 * (1 + ratio)))
    damper = sid.AddTunedMassDamper("1X", ratio * mass, own / (1 + ratio), damping)
    frf = sid.Frf(["1X"], ["1X"], np.linspace(0.7 * own, 1.3 * own, 2000), "receptance")
    found = sid.predict_change(model, frf, [damper], n_draws=50)
    assert np.abs(found.after.values).max() * stiffness == pytest.approx(np.sqrt(1 + 2 / ratio), rel=0.02)


def test_errors_of_both_states_cancel_in_a_change():
    found = sid.predict_change(make_oscillator(0.02), sid.NaturalModes(1), [sid.AddMass(1, 0.1)], n_draws=400)
    assert found.difference.std[0, 0] == pytest.approx(abs(found.difference.values[0, 0]) * 0.01, rel=0.2)
    assert found.before.std[0, 0] > 30 * found.difference.std[0, 0]


def test_modes_are_followed_by_their_shapes_where_a_change_adds_one_or_takes_one_away():
    structure = make_chain()
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", "between", each=True)])
    model = identified_model(structure, parameters, parameters.start, np.diag([30.0, 20.0]) ** 2)
    k = np.array([[4e3 + 3e3, -3e3, 0], [-3e3, 5e3, -2e3], [0, -2e3, 2e3]])
    mass = np.array([2.0, 3.0, 1.5])
    before = np.sqrt(np.linalg.eigvalsh(k / np.sqrt(np.outer(mass, mass)))) / (2 * np.pi)
    damper = sid.AddTunedMassDamper("3X", 0.05, before[1], 0.05)
    own = 0.05 * (2 * np.pi * before[1]) ** 2
    wider = np.pad(k, ((0, 1), (0, 1)))
    wider[2:, 2:] += own * np.array([[1.0, -1.0], [-1.0, 1.0]])
    four = np.append(mass, 0.05)
    after = np.sqrt(np.linalg.eigvalsh(wider / np.sqrt(np.outer(four, four)))) / (2 * np.pi)
    found = sid.predict_change(model, sid.NaturalModes(8), [damper], n_draws=50)
    assert found.before.values[:, 0] == pytest.approx(before)
    assert found.after.values[[0, 2], 0] == pytest.approx(after[[0, 3]])  # the second has become two
    assert min(abs(found.after.values[1, 0] - after[1:3])) < 1e-6
    assert np.abs(found.difference.values[[0, 2], 0]).max() < 0.05
    held = sid.predict_change(model, sid.NaturalModes(8), [sid.AddSupport("1X")], n_draws=50)
    pair = np.sqrt(np.linalg.eigvalsh(k[1:, 1:] / np.sqrt(np.outer(mass[1:], mass[1:])))) / (2 * np.pi)
    assert sorted(held.after.values[:, 0]) == pytest.approx(pair)


def test_root_mean_square_under_white_noise():
    """One mass under white noise S moves by sqrt(S / (4 c k)), root mean square; Crandall and Mark (1963), Eq. 2.45."""
    density, frequency = 3.0, np.linspace(0.01, 400, 40_000)
    frf = sid.Frf(["1X"], ["1X"], frequency, "receptance")
    found = sid.predict(
        make_oscillator(1e-6), sid.RootMeanSquare(sid.Spectrum(frf, np.full((40_000, 1), density))), n_draws=50
    )
    assert found.values[0] == pytest.approx(np.sqrt(density / (4 * 3.0 * 8e3)), rel=1e-3)


def test_maxima_are_those_of_the_history():
    force = np.zeros((200, 1))
    force[:10] = 50.0
    history = sid.History(["1X"], ["1X"], force, 500.0, "displacement")
    motion, largest = (
        sid.predict(make_oscillator(), quantity, n_draws=50) for quantity in (history, sid.Maxima(history))
    )
    assert largest.values == pytest.approx(np.abs(motion.values).max(axis=0))
    assert largest.low[0] < largest.values[0] < largest.high[0]


def test_what_the_data_do_not_determine_is_not_predicted():
    structure = make_chain()
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", "between", each=True)])
    with pytest.raises(NoAnswerError, match=r"do not determine stiffness\[between:2\]"):
        identified_model(structure, parameters, parameters.start, np.diag([1.0, np.nan]))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (sid.AddMass(9, 1.0), "no node 9"),
        (sid.AddMass(1, -1.0), "`mass` must be greater than 0"),
        (sid.AddMass(1, 1e30), "`mass` must be at most 1000 times the mass of the structure"),
        (sid.AddTunedMassDamper("1X", 1e9, 1.0, 0.1), "`mass` must be at most the mass of the structure"),
        (sid.AddTunedMassDamper("1X", 0.1, 1.0, 1e9), "`damping_ratio` must be at most 10"),
        (sid.Scale("stiffness[betwen]", 1.1), r"nearest is 'stiffness\[between\]'"),
        (sid.Scale("stiffness[between:3]", 1.1), "has elements 1 to 2, got 3"),
        (sid.Remove("d"), "no element set 'd'"),
        (sid.AddSupport("7X"), "7X"),
        (sid.AddTunedMassDamper("1RZ", 1.0, 1.0, 0.1), "along X, Y or Z"),
    ],
)
def test_changes_of_what_is_not_there_are_named(change, words):
    structure = make_chain()
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", "between", each=True)])
    with pytest.raises(InputError, match=words):
        changed_model(structure, parameters, [change])


def test_friction_has_no_history():
    sets = [
        sid.PointMass("m", [1], mass=1.0),
        sid.Spring("k", "1X", stiffness=10.0),
        sid.Friction("rub", "1X", friction_force=0.1),
    ]
    structure = sid.Structure({1: 0.0}, sets, active=["X"])
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", "k")])
    model = identified_model(structure, parameters, parameters.start, np.array([[0.01]]))
    with pytest.raises(InputError, match="dry friction of 'rub'"):
        sid.predict(model, sid.History(["1X"], ["1X"], np.ones((10, 1)), 10.0))


def test_what_a_model_misses_widens_histories_maxima_and_spectra():
    """An error of 10 % of the response at every frequency: 10 % of the energy's root, most of it where the response is."""
    lines = np.linspace(0.5, 30.0, 600)
    error = ModelError(lines, np.full(600, 0.1), np.ones(600), "accelerance")
    push = np.zeros((1024, 1))
    push[512:520] = 20.0
    history = sid.History(["1X"], ["1X"], push, 64.0, "displacement")
    spectrum = sid.Spectrum(sid.Frf(["1X"], ["1X"], lines), np.ones((600, 1)))
    quantities = [history, sid.Maxima(history), spectrum, sid.RootMeanSquare(spectrum)]
    motion, largest, density, mean = predict_together(make_oscillator(1e-9), quantities, 400, model_error=error)
    size, missed = np.sqrt((motion.values**2).mean()), np.sqrt((motion.std**2).mean())
    assert missed == pytest.approx(0.1 * size, rel=0.15)
    assert np.sqrt((motion.std[:448] ** 2).mean()) < 0.25 * missed
    assert 0.03 < largest.std[0] / largest.values[0] < 0.15
    assert density.std == pytest.approx(np.sqrt(2) * 0.1 * density.values, rel=0.25)
    assert 0 < mean.std[0] < 0.1 * mean.values[0]
    assert "what the fit misses" in motion.words
    [sure] = predict_together(make_oscillator(1e-9), [sid.NaturalModes(1)], 50, model_error=error)
    assert "what the fit misses" not in sure.words


@pytest.mark.parametrize(("lines", "expected"), [([0.0, 3.0, 8.0], (3.0, 8.0)), ([0.0], None), ([], None)])
def test_fitted_frfs_without_a_line_above_0_hz_have_no_band(tmp_path, lines, expected):
    with h5py.File(tmp_path / "estimate.h5", "w") as file:
        file["frf/frequency"] = np.array(lines)
    assert stored_band(tmp_path) == expected


@pytest.mark.parametrize(
    ("stated", "expected"), [((0.0, 40.0), (0.0, 40.0)), ((None, 40.0), (2.0, 40.0)), (None, (2.0, 50.0))]
)
def test_a_band_that_the_study_states_from_0_hz_is_taken_as_stated(monkeypatch, tmp_path, stated, expected):
    monkeypatch.setattr(predicting, "stored_band", lambda folder: (2.0, 50.0))
    study = SimpleNamespace(options=SimpleNamespace(band=stated))
    assert predicting._predicted_band(tmp_path, study) == expected
