"""Beams and bars under a static axial force: exact frequencies of strings and columns, buckling, planes, pieces, derivatives."""

import numpy as np
import pytest
from scipy import integrate, linalg

from structid import Bar, Beam, InputError, Joint, SpaceBeam, Structure, Unknown, parameters
from structid.dynamics.normal_modes import modes
from structid.unknowns.tolerances import Tolerances, fixed_properties

LENGTH, EI, MASS = 4.0, 2.1e5, 7.8
EULER = np.pi**2 * EI / LENGTH**2


def exact_frequency(tension, n, bending=EI):
    """Hz, of a pinned beam in tension: (n pi / L)^2 sqrt(EI / m) sqrt(1 + T L^2 / (n^2 pi^2 EI))."""
    k = n * np.pi / LENGTH
    return np.sqrt((bending * k**4 + tension * k**2) / MASS) / (2 * np.pi)


def pinned(tension, count=16, **more):
    nodes = {i: LENGTH * i / count for i in range(count + 1)}
    beam = Beam("tie", [[i, i + 1] for i in range(count)], MASS, EI, axial_force=tension, **more)
    return Structure(nodes, [beam], fixed=["0Y", f"{count}Y"])


def frequencies(structure, count=5):
    mass, stiffness = (structure.matrix(law) for law in ("mass", "stiffness"))
    return modes(mass, stiffness, n_modes=count).frequency


@pytest.mark.parametrize("tension", [-0.9 * EULER, 0.0, 0.5 * EULER, 40 * EULER])
def test_a_pinned_beam_has_the_frequencies_of_a_beam_in_tension(tension):
    exact = exact_frequency(tension, np.arange(1, 6))
    np.testing.assert_allclose(frequencies(pinned(tension)), exact, rtol=1e-3)
    error = [np.abs(frequencies(pinned(tension, count)) / exact - 1).max() for count in (8, 16)]
    assert error[1] < error[0] / 10  # of fourth order


def test_the_frequency_is_zero_at_the_buckling_load_and_not_before():
    """The matrix's own critical force, from its eigenvalues, is Euler's to 1e-5: of sixteen cubics, above it."""
    with_unit, without = pinned(1.0), pinned(0.0)
    geometric = (with_unit.matrix("stiffness") - without.matrix("stiffness")).toarray()
    critical = 1 / linalg.eigh(geometric, without.matrix("stiffness").toarray(), eigvals_only=True)[-1]
    assert 1.0 < critical / EULER < 1 + 1e-5
    assert frequencies(pinned(-critical))[0] < 1e-3 * frequencies(without)[0]
    assert frequencies(pinned(-0.999 * critical))[0] == pytest.approx(
        np.sqrt(0.001) * frequencies(without)[0], rel=1e-3
    )


def test_the_matrix_is_that_of_przemieniecki_and_of_a_beam_that_shears_the_integral_of_its_slopes():
    nodes, h = {0: 0.0, 1: 1.7}, 1.7
    plain = Structure(nodes, [Beam("b", [[0, 1]], 1.0, 3.0, axial_force=1.0)]).matrix("stiffness")
    bare = Structure(nodes, [Beam("b", [[0, 1]], 1.0, 3.0)]).matrix("stiffness")
    book = np.array([[36, 3 * h, -36, 3 * h], [3 * h, 4 * h**2, -3 * h, -(h**2)],
                     [-36, -3 * h, 36, -3 * h], [3 * h, -(h**2), -3 * h, 4 * h**2]]) / (30 * h)  # fmt: skip
    np.testing.assert_allclose((plain - bare).toarray(), book, atol=1e-12)
    shear, bending = 2.0, 3.0
    share = shear / (shear + 12 / h**2 * bending)
    odd = np.array([1, h / 2, -1, h / 2])

    def slope(x):
        return (np.array([0, (1 - x) * h, 0, x * h]) - odd + share * (1 - 6 * x + 6 * x**2) * odd) / h

    exact = [
        [integrate.quad(lambda x, i=i, j=j: h * slope(x)[i] * slope(x)[j], 0, 1)[0] for j in range(4)] for i in range(4)
    ]
    made = [
        Structure(nodes, [Beam("b", [[0, 1]], 1.0, bending, shear_stiffness=shear, axial_force=force)]).matrix(
            "stiffness"
        )
        for force in (1.0, 0.0)
    ]
    np.testing.assert_allclose((made[0] - made[1]).toarray(), exact, atol=1e-12)


def test_a_chain_of_bars_is_a_string_and_has_no_motion_sideways_without_tension():
    count, tension = 12, 5e4
    nodes = {i: [0.6 * LENGTH * i / count, 0.0, 0.8 * LENGTH * i / count] for i in range(count + 1)}
    ends = [f"{n}{d}" for n in (0, count) for d in "XYZ"]
    bars = [[i, i + 1] for i in range(count)]

    def string(force):
        return Structure(nodes, [Bar("cable", bars, MASS, 1e9, axial_force=force)], fixed=ends)

    found = frequencies(string(tension), 4)
    exact = np.repeat(np.arange(1, 3), 2) * np.sqrt(tension / MASS) / (2 * LENGTH)
    np.testing.assert_allclose(found, exact, rtol=0.02)
    stretched = string(tension).matrix("stiffness") - string(0.0).matrix("stiffness")
    along = np.tile([0.6, 0.0, 0.8], count - 1)
    assert np.abs(stretched @ along).max() < 1e-9 * tension


def test_one_bar_in_tension_is_cut_into_pieces_and_without_is_not():
    nodes, ends = {0: [0.0, 0.0], 1: [LENGTH, 0.0]}, ["0X", "0Y", "1X", "1Y"]
    taut = Structure(nodes, [Bar("cable", [[0, 1]], MASS, 1e9, axial_force=5e4)], fixed=ends, subdivide=10)
    np.testing.assert_allclose(frequencies(taut, 1), np.sqrt(5e4 / MASS) / (2 * LENGTH), rtol=0.01)


def test_a_space_beam_feels_its_force_in_both_planes_whatever_its_direction():
    along = np.array([1.0, 2.0, -2.0]) / 3
    count = 12
    nodes = {i: LENGTH * i / count * along for i in range(count + 1)}
    line = [[i, i + 1] for i in range(count)]
    tension = 3 * EULER
    beam = SpaceBeam("tie", line, MASS, EI, 4 * EI, 1e9, 1e5, 0.01, axial_force=tension)
    fixed = [f"{n}{d}" for n in (0, count) for d in "XYZ"]
    found = frequencies(Structure(nodes, [beam], fixed=fixed), 30)
    for n in (1, 2):
        for bending in (EI, 4 * EI):
            assert np.abs(found / exact_frequency(tension, n, bending) - 1).min() < 1e-3


def test_the_force_is_a_linear_parameter_of_either_sign_without_loss():
    structure = pinned(-0.4 * EULER, 6, loss_factor=0.02)
    unknown = parameters(structure, [Unknown("axial_force", "tie")])
    assert unknown.kinds == ("axial_force",)
    assert unknown.units == ("N",)
    assert unknown.transforms.kinds == ("linear",)
    values = [unknown.values(np.array([force])) for force in (-1e3, 2e3, 5e3)]
    first, second, third = (structure.matrix("stiffness", one) for one in values)
    assert abs((third - first) - 2 * (second - first)).max() < 1e-6
    lossless = Structure(
        structure.nodes, [Beam("tie", structure.elements[0].nodes, MASS, EI, loss_factor=0.02)], fixed=["0Y", "6Y"]
    )
    np.testing.assert_allclose(
        structure.matrix("structural_damping").toarray(), lossless.matrix("structural_damping").toarray(), rtol=1e-12
    )
    both = parameters(structure, [Unknown("stiffness", "tie")])
    assert both.names == ("stiffness[tie]",)
    np.testing.assert_array_equal(both.start, [EI])  # the force is no stiffness of the element
    bounded = parameters(structure, [Unknown("axial_force", "tie", bounds=(-1e5, 0.0))])
    assert bounded.transforms.kinds == ("interval",)


def test_a_held_force_has_the_tolerance_of_stiffnesses_and_one_of_its_own():
    structure = pinned(1e4, 4)
    unknown = parameters(structure, [Unknown("mass", "tie")])
    held = {one.label: one.tolerance for one in fixed_properties(structure, unknown, Tolerances())}
    assert held["axial_force[tie]"] == 0.01
    own = pinned(1e4, 4, tolerance={"axial_force": 0.2})
    held = {
        one.label: one.tolerance
        for one in fixed_properties(own, parameters(own, [Unknown("mass", "tie")]), Tolerances())
    }
    assert held["axial_force[tie]"] == 0.2


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda: pinned(np.nan), "must be finite"),
        (lambda: pinned([1.0, 2.0]), "one number or 16"),
        (
            lambda: Structure({0: 0.0, 1: 1.0}, [Bar("b", [[0, 1]], 1.0, 1.0, axial_force=1.0)]).matrix("stiffness"),
            "plane or in space",
        ),
    ],
)
def test_forces_that_cannot_be_are_refused(made, words):
    with pytest.raises(InputError, match=words):
        made()


def test_a_joint_of_a_beam_in_compression_keeps_its_force():
    """A hinge in the middle of a column: two pinned halves, each with the force; soft hinges buckle earlier than stiff ones."""
    nodes = {0: 0.0, 1: 0.5 * LENGTH, 2: LENGTH}
    beam = Beam("column", [[0, 1], [1, 2]], MASS, EI, axial_force=-0.3 * EULER)

    def lowest(stiffness):
        joint = Joint("hinge", "column:1", "1RZ", stiffness)
        return frequencies(Structure(nodes, [beam, joint], fixed=["0Y", "2Y"], subdivide=4), 1)[0]

    assert lowest(1e9) == pytest.approx(exact_frequency(-0.3 * EULER, 1), rel=1e-3)
    assert lowest(0.5 * EI) < 0.6 * lowest(1e9)
