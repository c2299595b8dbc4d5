"""Beams that shear: the Timoshenko element and beam of the textbooks, and shear as an unknown with exact derivatives."""

import numpy as np
import pytest

from structid import Beam, FrfRecord, InputError, SpaceBeam, Structure, Unknown, parameters
from structid.dynamics.modes import modes
from structid.observation.frf.response import response
from structid.observation.sensitive import require_linear_weights, sensitive_elements, steering_values

EI, GA, L = 5.0, 30.0, 0.7


def timoshenko(ei: float, ga: float, length: float) -> np.ndarray:
    """Przemieniecki (1968), Eq. (5.116), order w1 theta1 w2 theta2, phi = 12 EI / (G A_s L^2)."""
    h, phi = length, 12 * ei / (ga * length**2)
    rows = [
        [12, 6 * h, -12, 6 * h],
        [6 * h, (4 + phi) * h**2, -6 * h, (2 - phi) * h**2],
        [-12, -6 * h, 12, -6 * h],
        [6 * h, (2 - phi) * h**2, -6 * h, (4 + phi) * h**2],
    ]
    return ei / (h**3 * (1 + phi)) * np.array(rows)


def test_the_element_is_that_of_the_textbook():
    line = Structure({1: 0.0, 2: L}, [Beam("e", [1, 2], 1.0, EI, shear_stiffness=GA)])
    assert line.matrix("elastic").toarray() == pytest.approx(timoshenko(EI, GA, L), rel=1e-12)
    values = line.values.copy()
    for item in line.properties:
        if item.term.property == "shear_stiffness":
            values[item.values] = 3.0
        if item.term.property == "bending_stiffness":
            values[item.values] = 7.0
    assert line.matrix("elastic", values).toarray() == pytest.approx(timoshenko(7.0, 3.0, L), rel=1e-12)


def test_both_planes_of_a_space_beam_shear_on_their_own():
    """Tip deflections of a cantilever: L^3 / 3 EI + L / GA."""
    made = SpaceBeam("e", [1, 2], 1.0, 3.0, 5.0, 7.0, 11.0, shear_stiffness_y=20.0, shear_stiffness_z=40.0)
    fixed = [f"1{d}" for d in ("X", "Y", "Z", "RX", "RY", "RZ")]
    structure = Structure({1: (0.0, 0.0, 0.0), 2: (L, 0.0, 0.0)}, [made], fixed)
    flexibility = np.diag(np.linalg.inv(structure.matrix("elastic").toarray()))
    expected = [L**3 / (3 * 5.0) + L / 20.0, L**3 / (3 * 3.0) + L / 40.0]
    assert flexibility[1:3] == pytest.approx(expected, rel=1e-12)
    assert flexibility[4:] == pytest.approx([L / 3.0, L / 5.0], rel=1e-12)
    stiff = Structure(
        structure.nodes, [SpaceBeam("e", [1, 2], 1.0, 3.0, 5.0, 7.0, 11.0, shear_stiffness_y=np.inf)], fixed
    )
    assert [p.term.property for p in stiff.properties if "shear" in p.term.property] == []


def test_a_simply_supported_beam_has_the_frequencies_of_timoshenko():
    """Without rotary inertia omega_n^2 = (EI / m) k^4 / (1 + EI k^2 / G A_s), k = n pi / L (Timoshenko 1921)."""
    pieces, mass = 40, 2.0
    beam = Beam("e", [1, 2], mass, EI, shear_stiffness=GA)
    structure = Structure({1: 0.0, 2: L}, [beam], ["1Y", "2Y"], subdivide=pieces)
    found = modes(structure.matrix("inertia"), structure.matrix("elastic"), n_modes=4).frequency
    k = np.arange(1, 5) * np.pi / L
    exact = np.sqrt(EI / mass * k**4 / (1 + EI * k**2 / GA))
    assert 2 * np.pi * found == pytest.approx(exact, rel=3e-3)
    assert exact[3] < 0.4 * np.sqrt(EI / mass) * k[3] ** 2
    finer = Structure({1: 0.0, 2: L}, [beam], ["1Y", "2Y"], subdivide=2 * pieces)
    closer = modes(finer.matrix("inertia"), finer.matrix("elastic"), n_modes=4).frequency
    errors = [np.abs(2 * np.pi * one - exact) for one in (found, closer)]
    assert (errors[1] < 0.3 * errors[0]).all()


def portal(n: int) -> Structure:
    """A frame of two sets that shear, one with stiffnesses of every element's own."""
    nodes = {k: (0.0, 0.1 * k) for k in range(n + 1)} | {n + k: (0.1 * k, 0.1 * n) for k in range(1, n + 1)}
    up, along = ([[s + k, s + k + 1] for k in range(n)] for s in (0, n))
    some = np.linspace(3.0, 5.0, n)
    sets = [
        Beam("up", up, 1.0, 6.0, 900.0, 0.01, 0.3, 1e-4, 400.0),
        Beam("along", along, 1.0, some, 900.0, 0.02, shear_stiffness=100 * some),
    ]
    return Structure(nodes, sets, ["0X", "0Y", "0RZ", f"{2 * n}Y"])


@pytest.mark.parametrize("n", [3, 60])
def test_derivatives_to_shear_and_bending_are_differences_in_every_way(n):
    structure = portal(n)
    unknown = parameters(
        structure,
        [
            Unknown("shear_stiffness", "along"),
            Unknown("shear_stiffness", "up", name="plain"),
            Unknown("bending_stiffness", "along"),
            Unknown("loss_factor", ["up", "along"]),
            Unknown("stiffness_damping", "up"),
            Unknown("mass", "up"),
        ],
    )
    assert unknown.names[:2] == ("shear_stiffness[along]", "shear_stiffness[plain]")
    assert unknown.units[1] == "N"
    frequency = np.linspace(0.5, 12.0, 5)
    sensors = [f"{n}X", f"{n + 1}Y", f"{2 * n}X"]
    like = FrfRecord(frequency, np.ones((5, 3, 1)), sensors, [f"{n}X"], "accelerance")
    model = response(structure, unknown, like)
    start = np.array(unknown.start)
    _, slopes = model.derivatives_at(start)
    for k, step in enumerate(1e-4 * start):
        move = step * np.eye(len(start))[k]
        near, far = (model.values_at(start + m * move) - model.values_at(start - m * move) for m in (1, 2))
        difference = (8 * near - far) / (12 * step)
        assert np.abs(slopes[..., k] - difference).max() <= 2e-6 * np.abs(difference).max()


def test_slopes_follow_every_value_that_a_share_depends_on():
    structure = portal(3)
    unknown = parameters(structure, [Unknown("bending_stiffness", "along")])
    places = {p.term.property: p.values for p in structure.properties if p.element == "along"}
    steering = set(steering_values(structure, unknown, sensitive_elements(structure, unknown)).tolist())
    for name in ("bending_stiffness", "shear_stiffness", "loss_factor"):
        assert steering.issuperset(range(places[name].start, places[name].stop))
    assert steering.isdisjoint(range(places["mass"].start, places["mass"].stop))


def test_methods_that_are_linear_in_the_parameters_refuse_bending_beside_shear():
    structure = portal(2)
    for wanted in ("bending_stiffness", "shear_stiffness"):
        with pytest.raises(InputError, match=rf"{wanted}\[up\] must be known in the time domain.* leave the shear out"):
            require_linear_weights(structure, parameters(structure, [Unknown(wanted, "up")]))
    require_linear_weights(structure, parameters(structure, [Unknown("mass", "up")]))


def test_a_common_factor_on_all_stiffnesses_scales_shear_too():
    structure = portal(2)
    unknown = parameters(structure, [Unknown("stiffness", ["up", "along"], factor=True)])
    doubled = structure.matrix("elastic", unknown.values(np.array([2.0]))).toarray()
    assert doubled == pytest.approx(2 * structure.matrix("elastic").toarray(), rel=1e-12)
