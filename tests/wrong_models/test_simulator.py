"""The simulator of the wrong-model studies against textbook solutions."""

import copy

import numpy as np
import pytest
from wrong_models.assembly import assembled
from wrong_models.faults import joint, mesh, shear, support, untied
from wrong_models.measuring import straightened
from wrong_models.response import band_limited, frf, h1, history, modes, steady

MASS, EI, LENGTH = 3.0, 400.0, 1.2


def line_beam(n, fixed, **more):
    """A beam on a line in n elements."""
    beam = {"name": "beam", "nodes": [[i, i + 1] for i in range(n)], "mass": MASS, "bending_stiffness": EI, **more}
    nodes = {i: [LENGTH * i / n] for i in range(n + 1)}
    return {"active": ["Y", "RZ"], "fixed": fixed.split(), "nodes": nodes, "beam": [beam]}


def compliance(table, dof):
    """Displacement of a degree of freedom under a unit force there."""
    system = assembled(table)
    column = system.column(dof)
    return column @ np.linalg.solve(system.stiffness.real, column)


def test_beam_on_two_supports_has_the_frequencies_of_the_continuum():
    found, _, _ = modes(assembled(line_beam(24, "0Y 24Y")), 4)
    exact = np.pi / 2 * np.arange(1, 5) ** 2 / LENGTH**2 * np.sqrt(EI / MASS)
    np.testing.assert_allclose(found, exact, rtol=1e-4)


def test_bent_and_sheared_cantilever():
    table = line_beam(3, "0Y 0RZ")
    assert compliance(table, "3Y") == pytest.approx(LENGTH**3 / (3 * EI), rel=1e-10)
    shear(table, "beam", "9e3")
    assert compliance(table, "3Y") == pytest.approx(LENGTH**3 / (3 * EI) + LENGTH / 9e3, rel=1e-10)


def test_sheared_beam_has_the_frequencies_of_timoshenko_without_rotary_inertia():
    wave = np.pi * np.arange(1, 4) / LENGTH
    exact = wave**2 * np.sqrt(EI / MASS) / np.sqrt(1 + EI * wave**2 / 1e4) / (2 * np.pi)
    errors = []
    for n in (16, 48):
        table = line_beam(n, f"0Y {n}Y")
        shear(table, "beam", "1e4")
        errors.append(modes(assembled(table), 3)[0] / exact - 1)
    assert abs(errors[1]).max() < 1.5e-3
    np.testing.assert_allclose(errors[0] / errors[1], 9, rtol=0.1)  # of second order


def test_soft_support_and_joint_add_their_compliance():
    table = line_beam(3, "0Y 0RZ")
    support(table, "0RZ", "700")
    assert compliance(table, "3Y") == pytest.approx(LENGTH**3 / (3 * EI) + LENGTH**2 / 700, rel=1e-10)
    table = line_beam(3, "0Y 0RZ")
    joint(table, "beam:2/1RZ", "500")
    arm = 2 * LENGTH / 3
    assert compliance(table, "3Y") == pytest.approx(LENGTH**3 / (3 * EI) + arm**2 / 500, rel=1e-10)


def test_hinge_divides_a_beam():
    table = line_beam(2, "0Y 0RZ 2Y 2RZ")
    joint(table, "beam:2/1RZ", "0")
    assert compliance(table, "1Y") == pytest.approx((LENGTH / 2) ** 3 / (6 * EI), rel=1e-10)


def test_refined_mesh_keeps_statics_and_lowers_frequencies():
    coarse = line_beam(2, "0Y 2Y")
    fine = copy.deepcopy(coarse)
    mesh(fine, "beam", "4")
    assert compliance(fine, "1Y") == pytest.approx(compliance(coarse, "1Y"), rel=1e-9)
    exact = np.pi / 2 * 9 / LENGTH**2 * np.sqrt(EI / MASS)
    errors = [modes(assembled(table), 3)[0][2] / exact - 1 for table in (coarse, fine)]
    assert errors[0] > 0.05
    assert 0 < errors[1] < 2e-3


def test_plane_beam_stretches_and_turns_with_its_axis():
    beam = {"name": "b", "nodes": [[1, 2]], "mass": MASS, "bending_stiffness": EI, "axial_stiffness": 5e4}
    table = {
        "active": ["X", "Y", "RZ"],
        "fixed": ["1X", "1Y", "1RZ"],
        "nodes": {1: [0, 0], 2: [0.9, 1.2]},
        "beam": [beam],
    }
    system, length = assembled(table), 1.5
    c, s = 0.6, 0.8
    flexible = np.linalg.inv(system.stiffness.real)[:2, :2]
    along, across = np.array([c, s]), np.array([-s, c])
    assert along @ flexible @ along == pytest.approx(length / 5e4)
    assert across @ flexible @ across == pytest.approx(length**3 / (3 * EI))
    assert along @ flexible @ across == pytest.approx(0.0, abs=1e-12)


def test_space_beam_bends_in_two_planes_stretches_and_twists():
    own = {
        "name": "b", "nodes": [[1, 2]], "mass": MASS, "bending_stiffness_y": 500.0, "bending_stiffness_z": 300.0,
        "axial_stiffness": 4e4, "torsional_stiffness": 90.0, "polar_inertia": 0.01,
    }  # fmt: skip
    every = ["X", "Y", "Z", "RX", "RY", "RZ"]
    table = {
        "active": every,
        "fixed": [f"1{d}" for d in every],
        "nodes": {1: [0, 0, 0], 2: [2.0, 0, 0]},
        "space_beam": [own],
    }
    for dof, exact in (
        ("2X", 2 / 4e4),
        ("2Y", 8 / 900),
        ("2Z", 8 / 1500),
        ("2RX", 2 / 90),
        ("2RY", 2 / 500),
        ("2RZ", 2 / 300),
    ):
        assert compliance(table, dof) == pytest.approx(exact)
    assembly = assembled(table)
    turning = assembly.column("2RX")
    assert turning @ assembly.mass @ turning == pytest.approx(0.01 * 2 / 3)


def test_rod_and_truss():
    n = 20
    own = {"name": "rod", "nodes": [[i, i + 1] for i in range(n)], "mass": 2.0, "axial_stiffness": 8e4}
    table = {"active": ["X"], "fixed": ["0X"], "nodes": {i: [i / n] for i in range(n + 1)}, "bar": [own]}
    np.testing.assert_allclose(modes(assembled(table), 2)[0], np.array([1, 3]) / 4 * 200, rtol=3e-3)
    inclined = {"name": "v", "nodes": [[1, 3], [2, 3]], "mass": 1.0, "axial_stiffness": 1e5}
    nodes = {1: [-3.0, 0.0], 2: [3.0, 0.0], 3: [0.0, 4.0]}
    table = {"active": ["X", "Y"], "fixed": ["1X", "1Y", "2X", "2Y"], "nodes": nodes, "bar": [inclined]}
    assert compliance(table, "3Y") == pytest.approx(5 / (2 * 1e5 * 0.8**2))


def grid(n):
    nodes = {(n + 1) * i + j: [i / n, j / n] for i in range(n + 1) for j in range(n + 1)}
    firsts = [(n + 1) * i + j for i in range(n) for j in range(n)]
    cells = [[a, a + n + 1, a + n + 2, a + 1] for a in firsts]
    edge = [f"{k}Z" for k, (x, y) in nodes.items() if x in (0, 1) or y in (0, 1)]
    return nodes, cells, edge


def test_square_membrane_and_plate_on_their_edges():
    nodes, cells, edge = grid(12)
    halves = [triangle for a, b, c, d in cells for triangle in ([a, b, c], [a, c, d])]
    own = {"name": "skin", "nodes": halves, "mass": 1.3, "tension": 800.0}
    table = {"active": ["Z"], "fixed": edge, "nodes": nodes, "membrane": [own]}
    exact = np.sqrt(800 / 1.3) / 2 * np.sqrt([2, 5, 5])
    np.testing.assert_allclose(modes(assembled(table), 3)[0], exact, rtol=0.03)
    own = {"name": "plate", "nodes": cells, "mass": 5.0, "bending_stiffness": 100.0, "poisson": 0.3}
    table = {"active": ["Z", "RX", "RY"], "fixed": edge, "nodes": nodes, "plate": [own]}
    exact = np.pi / 2 * np.sqrt(100 / 5) * np.array([2, 5, 5])
    np.testing.assert_allclose(modes(assembled(table), 3)[0], exact, rtol=0.008)


OSCILLATOR = {
    "active": ["X"], "fixed": [], "nodes": {1: [0.0]}, "point_mass": [{"name": "m", "nodes": [1], "mass": 2.0}],
    "spring": [{"name": "k", "first": ["1X"], "stiffness": 800.0, "loss_factor": 0.03}],
    "dashpot": [{"name": "c", "first": ["1X"], "viscous_damping": 1.5}],
}  # fmt: skip


def test_frf_of_an_oscillator():
    frequency = np.linspace(0.5, 6, 20)
    omega = 2 * np.pi * frequency
    found = frf(assembled(OSCILLATOR), frequency, [{"1X": 0.5}], ["1X"], "mobility")[:, 0, 0]
    exact = 0.5j * omega / (800 * (1 + 0.03j) - 2 * omega**2 + 1.5j * omega)
    np.testing.assert_allclose(found, exact, rtol=1e-12)


def test_window_shifts_the_line():
    frequency, decay = np.array([1.0, 3.0]), 0.7
    s = decay + 2j * np.pi * frequency
    found = frf(assembled(OSCILLATOR), frequency, [{"1X": 1.0}], ["1X"], "receptance", decay)[:, 0, 0]
    np.testing.assert_allclose(found, 1 / (800 * (1 + 0.03j) + 2 * s**2 + 1.5 * s), rtol=1e-12)


def test_oscillator_under_a_step():
    table = {**OSCILLATOR, "spring": [{"name": "k", "first": ["1X"], "stiffness": 800.0}], "dashpot": []}
    time = np.arange(400) * 0.01
    place, speed, acceleration = history(assembled(table), np.full((400, 1), 5.0), ["1X"], 0.01)
    omega = 20.0
    np.testing.assert_allclose(place[:, 0], 5 / 800 * (1 - np.cos(omega * time)), atol=1e-12)
    np.testing.assert_allclose(speed[:, 0], 5 / 800 * omega * np.sin(omega * time), atol=1e-11)
    np.testing.assert_allclose(acceleration[:, 0], 5 / 2 * np.cos(omega * time), atol=1e-10)


def test_friction_sticks_and_slides():
    block = {"name": "m", "nodes": [1], "mass": 2.0, "directions": ["X"]}
    soft = {"name": "soft", "first": ["1X"], "stiffness": 1e-9}
    table = {"active": ["X"], "fixed": [], "nodes": {1: [0.0]}, "point_mass": [block], "spring": [soft]}
    force = np.concatenate([np.full(100, 0.9), np.full(101, 3.0), np.zeros(400)])[:, None]
    place, speed, _ = history(assembled(table), force, ["1X"], 0.01, [("1X", 1.0)])
    assert abs(speed[:100]).max() < 1e-12
    np.testing.assert_allclose(np.diff(speed[110:190, 0]) / 0.01, (3.0 - 1.0) / 2, rtol=1e-9)
    np.testing.assert_allclose(np.diff(speed[210:300, 0]) / 0.01, -1.0 / 2, rtol=1e-8)
    assert speed[-1, 0] == pytest.approx(0.0, abs=1e-12)
    assert place[-1, 0] == pytest.approx(place[-50, 0])


def test_repeating_motion_is_what_stepping_settles_at_and_h1_finds_the_frf():
    rng, rate, fine = np.random.default_rng(3), 64.0, 8
    system = assembled({**OSCILLATOR, "spring": [{"name": "k", "first": ["1X"], "stiffness": 800.0}]})
    force = band_limited(rng, 512 * fine, rate * fine, 1.0, 20.0)[:, None]
    stepped = history(system, np.tile(straightened(force), (7, 1)), ["1X"], 1 / (rate * fine))[0][-512 * fine :: fine]
    found = steady(system, force[::fine], rate, [{"1X": 1.0}], ["1X"], "receptance")
    np.testing.assert_allclose(stepped[:, [0]], found, atol=2e-4 * abs(found).max())
    values, coherence, n = h1(np.tile(force[::fine, 0], 3), np.tile(found, (3, 1)), 512, "boxcar")
    lines = np.arange(10, 150)
    exact = frf(system, lines * rate / 512, [{"1X": 1.0}], ["1X"], "receptance")[:, :, 0]
    np.testing.assert_allclose(values[lines], exact, rtol=1e-9)
    assert coherence[lines].min() > 1 - 1e-9
    assert n == 3


def test_damping_ratios():
    _, ratio, _ = modes(assembled(OSCILLATOR), 1)
    assert ratio[0] == pytest.approx(0.03 / 2 + 1.5 / (2 * 2 * 20))


def test_one_element_differs_from_its_set():
    table = line_beam(3, "0Y 0RZ")
    untied(table, "beam:3", "bending_stiffness*0.5")
    third = LENGTH / 3
    assert compliance(table, "3Y") == pytest.approx(LENGTH**3 / (3 * EI) + third**3 / (3 * EI))
