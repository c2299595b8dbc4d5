"""Beams that shear: the Timoshenko element and beam of the textbooks, and shear as an unknown with exact derivatives."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

from structid import Beam, FrfRecord, InputError, PointMass, RigidLink, SpaceBeam, Structure, Unknown, parameters
from structid.core.dof import DIRECTIONS
from structid.dynamics.normal_modes import modes
from structid.forward.frf.response import response
from structid.forward.sensitivity import require_linear_weights, sensitive_elements, slope_value_indices

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
    assert line.matrix("stiffness").toarray() == pytest.approx(timoshenko(EI, GA, L), rel=1e-12)
    values = line.values.copy()
    for item in line.properties:
        if item.term.property == "shear_stiffness":
            values[item.values] = 3.0
        if item.term.property == "bending_stiffness":
            values[item.values] = 7.0
    assert line.matrix("stiffness", values).toarray() == pytest.approx(timoshenko(7.0, 3.0, L), rel=1e-12)


def test_both_planes_of_a_space_beam_shear_on_their_own():
    """Tip deflections of a cantilever: L^3 / 3 EI + L / GA."""
    made = SpaceBeam("e", [1, 2], 1.0, 3.0, 5.0, 7.0, 11.0, shear_stiffness_y=20.0, shear_stiffness_z=40.0)
    fixed = [f"1{d}" for d in ("X", "Y", "Z", "RX", "RY", "RZ")]
    structure = Structure({1: (0.0, 0.0, 0.0), 2: (L, 0.0, 0.0)}, [made], fixed)
    flexibility = np.diag(np.linalg.inv(structure.matrix("stiffness").toarray()))
    expected = [L**3 / (3 * 5.0) + L / 20.0, L**3 / (3 * 3.0) + L / 40.0]
    assert flexibility[1:3] == pytest.approx(expected, rel=1e-12)
    assert flexibility[4:] == pytest.approx([L / 3.0, L / 5.0], rel=1e-12)
    stiff = Structure(
        structure.nodes, [SpaceBeam("e", [1, 2], 1.0, 3.0, 5.0, 7.0, 11.0, shear_stiffness_y=np.inf)], fixed
    )
    assert [p.term.property for p in stiff.properties if "shear" in p.term.property] == []


def frequencies(structure: Structure, n: int) -> np.ndarray:
    return modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=n).frequency


def deep(fixed: list[str], pieces: int) -> Structure:
    """Five times as long as deep: rectangular, steel, shear coefficient 5 / 6."""
    beam = Beam("e", [1, 2], 7800.0, 2e11 / 12, shear_stiffness=2e11 / 2.6 * 5 / 6, rotary_inertia=7800.0 / 12)
    return Structure({1: 0.0, 2: 5.0}, [beam], fixed, subdivide=pieces)


def end_condition(omega: float, rows: slice, columns: slice) -> float:
    """Determinant of the transfer matrix of w, theta, M, V over the deep beam (Huang 1961); 0 at its frequencies."""
    mass, ei, ga, inertia = 7800.0, 2e11 / 12, 2e11 / 2.6 * 5 / 6, 7800.0 / 12
    scale = np.array([1.0, 1.0, 1e10, 1e10])
    slope = np.zeros((4, 4))
    slope[0, 1], slope[0, 3], slope[1, 2] = 1.0, 1 / ga, 1 / ei
    slope[2, 1], slope[2, 3], slope[3, 0] = -inertia * omega**2, -1.0, -mass * omega**2
    transfer = expm(5.0 * slope * scale / scale[:, None])
    return float(np.linalg.det(transfer[rows, columns]))


@pytest.mark.parametrize(
    ("fixed", "unknown_at_start", "rigid"), [(["1Y", "1RZ"], slice(2, 4), 0), ([], slice(0, 2), 2)]
)
def test_deep_beams_have_the_frequencies_of_timoshenko(fixed, unknown_at_start, rigid):
    """A cantilever and a free beam; the error falls with the square of the pieces."""
    coarse, fine = (frequencies(deep(fixed, pieces), rigid + 4)[rigid:] for pieces in (50, 100))
    ends = slice(2, 4), unknown_at_start
    exact = [brentq(end_condition, 0.995 * 2 * np.pi * f, 1.005 * 2 * np.pi * f, ends, xtol=1e-9) for f in fine]
    exact = np.array(exact) / (2 * np.pi)
    slender = (
        np.array([1.8751, 4.6941] if fixed else [4.7300, 7.8532]) ** 2 / (10 * np.pi) / 5 * np.sqrt(2e11 / 12 / 7800)
    )
    assert (exact[:2] < [0.99, 0.85] * slender).all()
    assert fine == pytest.approx(exact, rel=5e-4)
    assert (4 * fine - coarse) / 3 == pytest.approx(exact, rel=1e-6)


def test_stiff_in_shear_is_euler_bernoulli():
    stiff, plain = (Beam("e", [1, 2], 3.0, EI, shear_stiffness=ga, rotary_inertia=0.2) for ga in (1e17 * EI, None))
    pair = [Structure({1: 0.0, 2: L}, [beam], ["1Y", "1RZ"], subdivide=8) for beam in (stiff, plain)]
    for kind in ("mass", "stiffness"):
        made, expected = (one.matrix(kind).toarray() for one in pair)
        assert np.abs(made - expected).max() <= 1e-12 * np.abs(expected).max()
    assert frequencies(pair[0], 6) == pytest.approx(frequencies(pair[1], 6), rel=1e-10)


@pytest.mark.parametrize("ratio", [1.0, 1e-3, 1e-6])
def test_thin_beams_do_not_lock(ratio):
    """One element gives the tip deflection L^3 / 3 EI + L / GA at any slenderness, and a patch its uniform curvature."""
    beam = Beam("e", [[1, 2], [2, 3]], 1.0, EI, shear_stiffness=GA / ratio)
    structure = Structure({1: 0.0, 2: 0.3 * L, 3: L}, [beam], ["1Y", "1RZ"])
    flexibility = np.linalg.inv(structure.matrix("stiffness").toarray())
    assert flexibility[2, 2] == pytest.approx(L**3 / (3 * EI) + L * ratio / GA, rel=1e-9)
    place = [0.3 * L, L]
    assert flexibility[:, 3] == pytest.approx(np.ravel([[x**2 / (2 * EI), x / EI] for x in place]), rel=1e-9)


def test_a_simply_supported_beam_of_mostly_shear():
    """Without rotary inertia omega_n^2 = (EI / m) k^4 / (1 + EI k^2 / G A_s), k = n pi / L (Timoshenko 1921).

    What a piece of length h leaves out is its shear under its own inertia: m h^2 / 12 G A_s of 1 / omega^2.
    """
    pieces, mass = 40, 2.0
    beam = Beam("e", [1, 2], mass, EI, shear_stiffness=GA)
    found = 2 * np.pi * frequencies(Structure({1: 0.0, 2: L}, [beam], ["1Y", "2Y"], subdivide=pieces), 4)
    k = np.arange(1, 5) * np.pi / L
    exact = np.sqrt(EI / mass * k**4 / (1 + EI * k**2 / GA))
    assert (found > exact).all()
    assert 1 / found**2 + mass * (L / pieces) ** 2 / (12 * GA) == pytest.approx(1 / exact**2, rel=1e-4)
    assert exact[3] < 0.4 * np.sqrt(EI / mass) * k[3] ** 2


def test_cantilever_with_masses_beside_its_axis():
    """NAFEMS (1990), Selected Benchmarks for Natural Frequency Analysis, FV4: printed digits."""
    diameter, length, n = 0.5, 10.0, 20
    area, second, shear = np.pi * diameter**2 / 4, np.pi * diameter**4 / 64, 2e11 / 2.6
    nodes = {i: (length * i / n, 0.0, 0.0) for i in range(n + 1)}
    nodes |= {n + 1: (length, 2.0, 0.0), n + 2: (length, -2.0, 0.0)}
    beam = SpaceBeam(
        "beam",
        [[i, i + 1] for i in range(n)],
        8000 * area,
        2e11 * second,
        2e11 * second,
        2e11 * area,
        2 * shear * second,
        2 * 8000 * second,
        rotary_inertia_y=8000 * second,
        rotary_inertia_z=8000 * second,
    )
    masses, arms = PointMass("masses", [n + 1, n + 2], [1e4, 1e3]), RigidLink("arms", n, [n + 1, n + 2])
    structure = Structure(nodes, [beam, masses], [f"0{d}" for d in DIRECTIONS], [arms])
    assert frequencies(structure, 6) == pytest.approx([1.723, 1.727, 7.413, 9.972, 18.155, 26.957], abs=6e-4)


def portal(n: int) -> Structure:
    """A frame of two sets that shear, one with stiffnesses of every element's own."""
    nodes = {k: (0.0, 0.1 * k) for k in range(n + 1)} | {n + k: (0.1 * k, 0.1 * n) for k in range(1, n + 1)}
    up, along = ([[s + k, s + k + 1] for k in range(n)] for s in (0, n))
    some = np.linspace(3.0, 5.0, n)
    sets = [
        Beam("up", up, 1.0, 6.0, 900.0, 0.01, 0.3, 1e-4, 400.0, 1e-3),
        Beam("along", along, 1.0, some, 900.0, 0.02, shear_stiffness=100 * some, rotary_inertia=2e-3),
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
            Unknown("rotary_inertia", "along"),
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
    steering = set(slope_value_indices(structure, unknown, sensitive_elements(structure, unknown)).tolist())
    for name in ("bending_stiffness", "shear_stiffness", "loss_factor"):
        assert steering.issuperset(range(places[name].start, places[name].stop))
    for name, steers in (("mass", True), ("axial_stiffness", False)):
        assert steering.isdisjoint(range(places[name].start, places[name].stop)) != steers


def test_methods_that_are_linear_in_the_parameters_refuse_bending_beside_shear():
    structure = portal(2)
    for wanted in ("bending_stiffness", "shear_stiffness"):
        with pytest.raises(InputError, match=rf"{wanted}\[up\] must be known here.* leave the shear out"):
            require_linear_weights(structure, parameters(structure, [Unknown(wanted, "up")]))
    require_linear_weights(structure, parameters(structure, [Unknown("mass", "up")]))


def test_a_common_factor_on_all_stiffnesses_scales_shear_too():
    structure = portal(2)
    unknown = parameters(structure, [Unknown("stiffness", ["up", "along"], factor=True)])
    doubled = structure.matrix("stiffness", unknown.values(np.array([2.0]))).toarray()
    assert doubled == pytest.approx(2 * structure.matrix("stiffness").toarray(), rel=1e-12)
