"""What docs/errata.md says of the equations of Norris (1986), equation by equation, where it can be computed."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial import Polynomial, legendre

from arrow_system import ArrowSystem
from structid import Beam, FrfRecord, Structure, Unknown, parameters
from structid.dynamics.normal_modes import modes
from structid.forward.frf.response import response

ACTUAL = np.array([0.92, 1.28, 1.17, 0.63, 1.11, 0.98, 1.38, 0.68, 1.24, 0.56, 0.76, 1.12])  # Table 4.1, case 1
POSTULATED = np.array([0.90, 1.15, 1.20, 0.50, 1.20, 0.90, 1.30, 0.60, 1.10, 0.50, 0.90, 1.20])
UNKNOWNS = [Unknown(p, "beam", each=True, positive=False) for p in ("mass", "bending_stiffness")]
XI = Polynomial([0.0, 1.0])
CUBICS = [3 * XI**2 - 2 * XI**3, XI**2 - XI**3, 1 - 3 * XI**2 + 2 * XI**3, -XI + 2 * XI**2 - XI**3]  # Eq. (3.17)
PHI_M = [[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]]  # Eq. (3.19b) times 420 / h
PHI_K = [[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]]  # Eq. (3.20b)


def beam(values, fixed=("0Y", "0RZ")):
    n = len(values) // 2
    elements = Beam("beam", [[i, i + 1] for i in range(n)], values[:n], values[n:])
    return Structure({i: float(i) for i in range(n + 1)}, [elements], fixed)


def integral(first, second):
    return (first * second).integ()(1.0) - (first * second).integ()(0.0)


def test_eq_2_4_modes_are_orthogonal_with_the_mass_as_weight():
    structure = beam(ACTUAL)
    mass = structure.matrix("mass")
    shapes = modes(mass, structure.matrix("stiffness")).mode_shapes
    unit = beam(np.concatenate([np.ones(6), ACTUAL[6:]])).matrix("mass")
    assert shapes.T @ (mass @ shapes) == pytest.approx(np.eye(12), abs=1e-10)
    printed = shapes.T @ (unit @ shapes)
    size = np.sqrt(np.outer(np.diag(printed), np.diag(printed)))
    assert np.abs(printed / size - np.eye(12)).max() > 0.1


def test_eq_2_12_the_form_with_the_operator_vanishes_for_cubics():
    """int (L phi) phi' of (2.12b) and (2.12c) is 0 with constant EI; the energy product is the printed matrix."""
    strong = np.array([[integral(a.deriv(4), b) for b in CUBICS] for a in CUBICS])
    energy = np.array([[integral(a.deriv(2), b.deriv(2)) for b in CUBICS] for a in CUBICS])
    assert np.array_equal(strong, np.zeros((4, 4)))
    assert energy == pytest.approx(np.array(PHI_K), abs=1e-12)


def test_eq_3_19a_takes_all_four_functions():
    right = np.array([[420 * integral(a, b) for b in CUBICS] for a in CUBICS])
    read = [CUBICS[0], CUBICS[1], CUBICS[1], CUBICS[3]]
    wrong = np.array([[420 * integral(a, b) for b in read] for a in read])
    assert right == pytest.approx(np.array(PHI_M), abs=1e-10)
    assert np.abs(wrong - np.array(PHI_M)).max() > 10


def columns(blocks, motion):
    """K_e w for every element e, (n_dofs, n_elements)."""
    return blocks.bilinear(np.eye(len(motion)), motion[:, None])[..., 0].T


def test_eq_3_21_columns_are_the_printed_ones():
    """a_1 and a_2 from accelerations, a_29 and a_30 from displacements, with 15 elements of length 1."""
    structure = beam(np.ones(30), fixed=())
    motion = np.random.default_rng(3).standard_normal(32)
    inertia, elastic = (
        next(c for c in structure.contributions if c.matrix_kind == kind) for kind in ("mass", "stiffness")
    )
    by_mass, by_stiffness = columns(inertia.blocks, motion), columns(elastic.blocks, motion)
    for column, matrix, first in (
        (by_mass[:, 0], np.array(PHI_M) / 420, 0),
        (by_mass[:, 1], np.array(PHI_M) / 420, 2),
        (by_stiffness[:, 13], np.array(PHI_K), 26),
        (by_stiffness[:, 14], np.array(PHI_K), 28),
    ):
        expected = np.zeros(32)
        expected[first : first + 4] = matrix @ motion[first : first + 4]
        assert column == pytest.approx(expected, abs=1e-13)


def test_after_eq_3_15_columns_vanish_for_rigid_motion():
    """a_r = K_r w is 0 in rigid motion, not merely orthogonal to w."""
    structure = beam(np.concatenate([ACTUAL, ACTUAL]), fixed=())
    elastic = next(c for c in structure.contributions if c.matrix_kind == "stiffness")
    x = np.array([float(dof.node) for dof in structure.dofs])
    turning = np.array([dof.is_rotation for dof in structure.dofs])
    rigid = np.where(turning, 0.3, 2.0 + 0.3 * x)
    bent = np.where(turning, 0.2 * x, 0.1 * x**2)
    assert np.abs(columns(elastic.blocks, rigid)).max() <= 1e-13
    assert np.abs(columns(elastic.blocks, bent)).max(axis=0).min() > 0.1


def test_table_3_1_mass_is_per_length():
    """Phi_M carries h: an element of length 2 with m = 3 weighs 6."""
    element = Structure({0: 0.0, 1: 2.0}, [Beam("beam", [[0, 1]], 3.0, 1.0)])
    along = np.array([float(not dof.is_rotation) for dof in element.dofs])
    assert along @ (element.matrix("mass") @ along) == pytest.approx(6.0)


def record_at(values, outputs, frequency, fixed=("0Y", "0RZ"), load="6Y+"):
    structure = beam(values, fixed)
    record = FrfRecord(frequency, np.ones((len(frequency), len(outputs), 1)), outputs, (load,), "receptance")
    known = parameters(structure, UNKNOWNS)
    model = response(structure, known, record)
    return replace(record, values=model.values_at(known.start)), model.derivatives_at(known.start)[1]


def test_eq_4_21_and_4_22_sizes_and_sign():
    """A has 3N + r columns for each frequency, and the sign of E changes the pseudo-parameters only."""
    frequency = np.arange(1, 7) * 0.5 / (2 * np.pi)
    record, _ = record_at(ACTUAL, ("1Y+", "3Y+", "4RZ+", "6Y+"), frequency)
    structure = beam(POSTULATED)
    system = ArrowSystem(structure, parameters(structure, UNKNOWNS), record)
    matrix, right = system.system()
    assert matrix.shape == (12 * 6, 12 + 8 * 6)
    other = matrix.real.copy()
    other[:, 12:] *= -1
    turned = np.linalg.lstsq(other, right.real, rcond=None)[0]
    straight = np.linalg.lstsq(matrix.real, right.real, rcond=None)[0]
    assert turned[:12] == pytest.approx(straight[:12], rel=1e-9)
    assert turned[12:] == pytest.approx(-straight[12:], rel=1e-9)
    assert np.abs(straight[12:]).max() > 0.1


def test_common_scale_of_all_parameters_scales_the_response_inversely():
    """J p + w = 0: a known force fixes the scale, and an error of its amplitude is one of every parameter."""
    record, derivative = record_at(ACTUAL, ("6Y+", "3RZ+"), np.array([0.05, 0.2, 0.7]))
    assert np.abs(derivative @ ACTUAL + record.values).max() <= 1e-11 * np.abs(record.values).max()
    louder, _ = record_at(ACTUAL / 1.005, ("6Y+", "3RZ+"), np.array([0.05, 0.2, 0.7]))
    assert louder.values == pytest.approx(1.005 * record.values, rel=1e-9)


def test_frequencies_enough_by_number_do_not_make_full_rank():
    """m >= 2N / (n - r) holds, but a symmetric beam seen from its middle hides which half a parameter is in."""
    pinned = np.ones(12)
    _, derivative = record_at(pinned, ("3Y+",), 0.05 * np.arange(1, 13), fixed=("0Y", "6Y"), load="3Y+")
    jacobian = derivative.real.reshape(12, 12)
    singular = np.linalg.svd(jacobian, compute_uv=False)
    assert (singular > 1e-10 * singular[0]).sum() <= 6


def motion(omega, amplitude, phase, duration, order=0, n_samples=400_001):
    time = np.linspace(0.0, duration, n_samples)
    return amplitude * omega**order * np.cos(omega * time + phase + order * np.pi / 2)


def average(first, second):
    return np.trapezoid(first * second) / (len(first) - 1)


def test_eq_5_7_needs_different_frequencies_and_no_rigid_body_mode():
    first, second = (motion(1.3, a, p, 2000.0) for a, p in ((2.0, 0.3), (1.5, 1.1)))
    other = motion(1.9, 1.5, 1.1, 2000.0)
    assert average(first, second) == pytest.approx(2.0 * 1.5 * np.cos(0.8) / 2, rel=1e-3)
    assert abs(average(first, other)) < 2e-3
    drift = [average(np.linspace(0, t, 1001), np.linspace(0, t, 1001)) for t in (100.0, 200.0)]
    assert drift[1] == pytest.approx(4 * drift[0])


def test_eq_5_9_and_5_10_acceleration_and_displacement_correlate_negatively():
    omega, duration = 1.3, 2000.0
    u, v, a = (motion(omega, 2.0, 0.3, duration, order) for order in (0, 1, 2))
    assert average(a, u) / average(u, u) == pytest.approx(-(omega**2), rel=1e-3)
    assert average(v, v) / average(u, u) == pytest.approx(omega**2, rel=1e-3)


def test_eq_5_14_gradient_of_the_quotient():
    """By central differences: the corrected gradient of (5.13) agrees, the printed one does not."""
    rng = np.random.default_rng(11)
    a, q, w2 = rng.standard_normal(5), rng.uniform(0.3, 3.0, 5), rng.uniform(1.0, 9.0, 5)

    def quotient(x):
        return (w2 * q) @ x**2 / (q @ x**2)

    step = 1e-6
    gradient = np.array([(quotient(a + step * e) - quotient(a - step * e)) / (2 * step) for e in np.eye(5)])
    corrected = 2 * a * q * [(w - w2) @ (q * a**2) for w in w2] / (q @ a**2) ** 2
    printed = 2 * a * [(w * p - w2 * q) @ a**2 for w, p in zip(w2, q, strict=True)] / np.sum(a**2) ** 2
    assert corrected == pytest.approx(gradient, abs=1e-7)
    assert np.abs(printed - gradient).max() > 0.1


def test_eq_5_26_values_at_points_carry_quadrature_weights():
    """Legendre polynomials at Gauss points, orthonormal as eigenfunctions are: V = Phi^-T is weight times value."""
    points, weights = legendre.leggauss(7)
    shapes = legendre.legvander(points, 6) * np.sqrt(np.arange(7) + 0.5)
    vectors = np.linalg.inv(shapes).T
    assert vectors == pytest.approx(weights[:, None] * shapes, abs=1e-12)
    cosine = np.sum(vectors * shapes, axis=0) / np.linalg.norm(vectors, axis=0) / np.linalg.norm(shapes, axis=0)
    assert (cosine**2).min() < 0.97


def test_eq_5_32_eigenfunctions_are_normalized_for_the_stated_beam():
    x = np.linspace(0.0, 10.0, 100_001)
    for r in (1, 4):
        shape = np.sqrt(1 / 5) * np.sin(r * np.pi * x / 10)
        assert np.trapezoid(shape**2, x) == pytest.approx(1.0, rel=1e-9)


def test_highest_order_that_counts_as_natural():
    """Below (2.2): the bending moment EI w'' has order p = 2 and is natural, for functions without it converge.

    x (L - x) has the wrong moment at both ends, and with Hermite cubics, which do not force it either, the pinned beam
    reaches (r pi / L)^4: no function has to satisfy the condition of order p.
    """
    pinned = beam(np.ones(40), ("0Y", "20Y"))
    found = modes(pinned.matrix("mass"), pinned.matrix("stiffness"))
    assert 2 * np.pi * found.frequency[:3] == pytest.approx(
        (np.arange(1, 4) * np.pi / 20) ** 2, rel=5e-5
    )  # element error
