"""State equations against FRFs of the whole model, in continuous time and from sample to sample, and their files."""

import re

import h5py
import numpy as np
import pytest
from scipy import signal
from scipy.io import loadmat

import structid as sid
from structid.core.errors import FileError, InputError
from structid.prediction.identified_model import identified_model
from structid.prediction.state_space import _Equations, _reflect_unstable_poles

OUTPUTS, INPUTS, BAND = ("20Y", "7Y"), ("20Y", "13Y"), (0.5, 40.0)


def make_model(fixed=("0Y", "0RZ")):
    beam = sid.Beam("beam", [[i, i + 1] for i in range(20)], mass=2.0, bending_stiffness=50.0, loss_factor=0.004)
    structure = sid.Structure({i: 0.1 * i for i in range(21)}, [beam], fixed=fixed)
    parameters = sid.parameters(structure, [sid.Unknown("bending_stiffness", "beam")])
    return identified_model(structure, parameters, parameters.start, np.array([[(0.5) ** 2]]))


@pytest.mark.parametrize("fixed", [("0Y", "0RZ"), ()], ids=["clamped", "free"])
@pytest.mark.parametrize(("motion", "kind"), [("displacement", "receptance"), ("acceleration", "accelerance")])
def test_the_error_of_the_order_is_the_one_that_is_stated(fixed, motion, kind):
    model = make_model(fixed)
    made = sid.state_space(model, OUTPUTS, INPUTS, BAND, motion)
    hertz = sid.predict(model, sid.NaturalModes(8), n_draws=50).values[:, 0]
    hertz = hertz[(hertz > BAND[0]) & (hertz < BAND[1])]
    across = (hertz * (1 + 0.002 * np.linspace(-3, 3, 61)[:, None])).ravel()
    frequency = np.unique(np.concatenate([np.linspace(*BAND, 800), across]))
    exact = sid.predict(model, sid.Frf(OUTPUTS, INPUTS, frequency, kind), n_draws=50).values
    error = np.abs(made.frf(frequency) - exact).max() / np.abs(exact).max()
    assert error == pytest.approx(made.error, rel=0.2)
    assert error < 0.02
    assert len(made.a) <= 16


def test_stable_and_low_order_is_found_for_other_programs():
    made = sid.state_space(make_model(), OUTPUTS, INPUTS, BAND, "velocity")
    assert np.linalg.eigvals(made.a).real.max() < 0
    frequency = np.linspace(1, 40, 50)
    for j in range(2):
        system = signal.StateSpace(made.a, made.b, made.c, made.d)
        column = signal.StateSpace(system.A, system.B[:, [j]], system.C[[0]], system.D[[0]][:, [j]])
        _, response = signal.freqresp(column, 2 * np.pi * frequency)
        assert response == pytest.approx(made.frf(frequency)[:, 0, j], rel=1e-6)


def test_sampled_equations_give_the_same_samples_under_held_loads():
    model, rate = make_model(), 400.0
    whole, sampled = (
        sid.state_space(model, OUTPUTS, INPUTS, BAND, "displacement", 8, sampling_rate=r) for r in (None, rate)
    )
    force = np.repeat(np.random.default_rng(0).standard_normal((40, 2)), 50, axis=0)
    states = np.zeros(len(whole.a))
    fine = signal.cont2discrete((whole.a, whole.b, whole.c, whole.d), 1 / rate / 50)
    exact = []
    for k, u in enumerate(force):
        if k % 50 == 0:
            exact.append(whole.c @ states + whole.d @ u)
        states = fine[0] @ states + fine[1] @ u
    state, found = np.zeros(len(sampled.a)), []
    for u in force[::50]:
        found.append(sampled.c @ state + sampled.d @ u)
        state = sampled.a @ state + sampled.b @ u
    assert np.array(found) == pytest.approx(np.array(exact), rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("suffix", [".mat", ".npz", ".h5"])
def test_files_hold_what_was_made(tmp_path, suffix):
    made = sid.state_space(make_model(), OUTPUTS, INPUTS, BAND, "displacement", 6, n_draws=3)
    path = tmp_path / f"beam{suffix}"
    made.write(path)
    if suffix == ".mat":
        content = loadmat(path)
    elif suffix == ".npz":
        content = np.load(path)
    else:
        content = {name: data[()] for name, data in h5py.File(path).items()}
    assert np.asarray(content["a"]) == pytest.approx(made.a)
    assert np.asarray(content["b_draws"]).shape == (3, 6, 2)
    assert float(np.ravel(content["largest_error"])[0]) == pytest.approx(made.error)


def test_bad_input_is_named(tmp_path):
    model = make_model()
    with pytest.raises(InputError, match="`band` must run"):
        sid.state_space(model, OUTPUTS, INPUTS, (40.0, 5.0))
    with pytest.raises(InputError, match="`order` must be from 2"):
        sid.state_space(model, OUTPUTS, INPUTS, BAND, order=5000)
    with pytest.raises(FileError, match=r"\.mat, \.npz, \.h5"):
        sid.state_space(model, OUTPUTS, INPUTS, BAND, order=4).write(tmp_path / "beam.txt")


def test_more_states_miss_less_and_all_are_stable():
    """Balancing on the band alone makes unstable equations of some orders, whose poles outside the band are reflected."""
    columns, rows = 8, 6
    corners = np.array([0, 1, columns + 2, columns + 1])
    cells = [(j * (columns + 1) + i + corners).tolist() for j in range(rows) for i in range(columns)]
    nodes = {j * (columns + 1) + i: [0.15 * i, 0.15 * j] for j in range(rows + 1) for i in range(columns + 1)}
    plate = sid.Plate(
        "plate", cells, density=2700.0, youngs_modulus=7e10, thickness=4e-3, poisson=0.33, loss_factor=0.02
    )
    fixed = [f"{node}{d}" for node, (x, _) in nodes.items() if x == 0.0 for d in ("Z", "RX", "RY")]
    structure = sid.Structure(nodes, [plate], fixed=fixed)
    parameters = sid.parameters(structure, [sid.Unknown("youngs_modulus", "plate")])
    model = identified_model(structure, parameters, parameters.start, np.zeros((1, 1)))
    made = [sid.state_space(model, ["62Z", "33Z"], ["62Z", "13Z"], (5.0, 85.0), order=n) for n in range(20, 32, 2)]
    errors = np.array([each.error for each in made])
    assert (errors[1:] < 1.5 * errors[:-1]).all(), errors
    assert max(np.linalg.eigvals(each.a).real.max() for each in made) < 0


def make_chain(n):
    """Equal masses between two walls, the end springs uncertain: the middle moves in every second mode alone."""
    ends, mid = [f"{i}X" for i in range(2, n + 1)], [f"{i}X" for i in range(1, n)]
    parts = [
        sid.PointMass("m", list(range(1, n + 1)), mass=[1.0] * n),
        sid.Spring("k", ends, mid, stiffness=[900.0] * (n - 1)),
        sid.Dashpot("c", ends, mid, viscous_damping=[0.5] * (n - 1)),
        sid.Spring("feet", ["1X", f"{n}X"], stiffness=[900.0] * 2),
        sid.Dashpot("air", ["1X", f"{n}X"], viscous_damping=[0.5] * 2),
    ]
    structure = sid.Structure({i: float(i) for i in range(1, n + 1)}, parts, active=["X"])
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", "feet")])
    return identified_model(structure, parameters, parameters.start, 90.0**2 * np.eye(len(parameters.start)))


def test_states_that_cannot_be_had_are_named_and_draws_have_as_many_as_the_model():
    model = make_chain(15)
    with pytest.raises(InputError, match="see no more states") as refusal:
        sid.state_space(model, ["8X"], ["8X"], (0.3, 4.0), order=20)
    most = int(re.search(r"at most (\d+), got 20", str(refusal.value))[1])
    assert most in (16, 18)  # eight modes move the middle; rounding decides whether one more is seen
    made = sid.state_space(model, ["8X"], ["8X"], (0.3, 4.0), order=most, n_draws=2)
    assert {draw[0].shape for draw in made.draws} == {(most, most)}
    short = _Equations(*(np.array([[value]]) for value in (-3.0, 1.0, 2.0, 0.5)), 0, False)
    padded = short.padded(3, 9.0)
    assert padded.n_states == 3
    assert padded.frf(np.array([1.0, 4.0])) == pytest.approx(short.frf(np.array([1.0, 4.0])))


def test_poles_that_neither_grow_nor_decay_are_made_to_decay():
    a = np.array([[-1e-14, 10.0, 1.0], [-10.0, -1e-14, 0.0], [0.0, 0.0, -2.0]])
    poles = np.linalg.eigvals(_reflect_unstable_poles(a, 1e-4))
    assert sorted(poles.real) == pytest.approx([-2.0, -1e-3, -1e-3], rel=1e-6)


def test_a_free_mass_is_its_rigid_motion():
    structure = sid.Structure({1: 0.0}, [sid.PointMass("m", [1], mass=2.0)], active=["X"])
    parameters = sid.parameters(structure, [sid.Unknown("mass", "m")])
    model = identified_model(structure, parameters, parameters.start, np.zeros((1, 1)))
    made = sid.state_space(model, ["1X"], ["1X"], (0.5, 8.0))
    assert made.frf(np.array([1.0, 5.0]))[:, 0, 0] == pytest.approx([0.5, 0.5])
