"""Laws that every element type keeps: symmetry, rigid-body motion, total mass, textbook matrices."""

import numpy as np
import pytest
from element_cases import CASES, LAWS, cases

from structid import Beam, InputError, RotaryInertia, SpaceBeam, Spring, Structure
from structid.fem import ELEMENT_TYPES
from structid.fem.elements.beam import hermite_mass, hermite_stiffness


@pytest.mark.parametrize("law", LAWS, ids=[law.__name__ for law in LAWS])
@pytest.mark.parametrize("case", cases())
def test_every_element_type(law, case, tmp_path):
    law(case, tmp_path)


def test_every_element_type_has_a_case_of_its_own():
    assert set(CASES) == set(ELEMENT_TYPES)
    for name, own in CASES.items():
        assert {type(case.element) for case in own} == {ELEMENT_TYPES[name]}


def test_hermite_matrices_equal_quadrature_of_shape_functions():
    """Independent oracle: Gauss quadrature of the cubics and their second derivatives."""
    h = 1.7
    points, weights = np.polynomial.legendre.leggauss(6)
    x, w = 0.5 * (points + 1), 0.5 * weights * h
    shape = np.array([1 - 3 * x**2 + 2 * x**3, h * (x - 2 * x**2 + x**3), 3 * x**2 - 2 * x**3, h * (x**3 - x**2)])
    curvature = np.array([-6 + 12 * x, h * (-4 + 6 * x), 6 - 12 * x, h * (6 * x - 2)]) / h**2
    assert hermite_mass(np.array([h]))[0] == pytest.approx((shape * w) @ shape.T, rel=1e-12)
    assert hermite_stiffness(np.array([h]))[0] == pytest.approx((curvature * w) @ curvature.T, rel=1e-12)


def test_space_beam_bends_as_the_plane_beam_does():
    plane = Structure({1: (0.0, 0.0), 2: (0.3, 0.4)}, [Beam("e", [1, 2], 2.0, 5.0, 11.0)])
    space = Structure(
        {1: (0.0, 0.0, 0.0), 2: (0.3, 0.4, 0.0)},
        [SpaceBeam("e", [1, 2], 2.0, 9.0, 5.0, 11.0)],
        active=("X", "Y", "RZ"),
    )
    assert plane.dofs == space.dofs
    for law in ("mass", "stiffness"):
        assert space.matrix(law).toarray() == pytest.approx(plane.matrix(law).toarray(), abs=1e-12)


def test_space_beam_tip_deflections_and_twist_are_those_of_the_textbook():
    length, ei_y, ei_z, ea, gj = 2.0, 3.0, 5.0, 7.0, 11.0
    beam = SpaceBeam("e", [1, 2], 1.0, ei_y, ei_z, ea, gj, orientation=(0.0, 1.0, 0.0))
    fixed = [f"1{d}" for d in ("X", "Y", "Z", "RX", "RY", "RZ")]
    structure = Structure({1: (0.0, 0.0, 0.0), 2: (length, 0.0, 0.0)}, [beam], fixed)
    flexibility = np.linalg.inv(structure.matrix("stiffness").toarray())
    expected = [length / ea, length**3 / (3 * ei_z), length**3 / (3 * ei_y), length / gj, length / ei_y, length / ei_z]
    assert np.diag(flexibility) == pytest.approx(expected, rel=1e-12)
    assert flexibility[2, 4] == pytest.approx(-(length**2) / (2 * ei_y), rel=1e-12)  # w' = -rotation about y
    assert flexibility[1, 5] == pytest.approx(length**2 / (2 * ei_z), rel=1e-12)


def test_rotary_inertia_sits_on_its_axis():
    structure = Structure({1: (0.0, 0.0, 0.0)}, [RotaryInertia("e", [1], 0.5, "RY")])
    assert [str(d) for d in structure.dofs] == ["1RY+"]
    assert structure.matrix("mass").toarray() == pytest.approx(np.array([[0.5]]))


@pytest.mark.parametrize(
    ("make", "fragment"),
    [
        (lambda: Beam("e", [[1, 2, 3]], 1.0, 1.0), "2 labels"),
        (lambda: Beam("e", [[1, 2]], [1.0, 2.0], 1.0), "`mass` of 'e'"),
        (lambda: Beam("e", [[1, 2]], -1.0, 1.0), "at least 0"),
        (lambda: Beam("e", [[1.5, 2]], 1.0, 1.0), "whole numbers"),
        (lambda: Structure({1: 0.0, 2: 0.0}, [Beam("e", [[1, 2]], 1.0, 1.0)]), "no length"),
        (lambda: Structure({1: 1.0, 2: 0.0}, [Beam("e", [[1, 2]], 1.0, 1.0)]), "along \\+X"),
        (lambda: Structure({1: (0, 0, 0), 2: (0, 0, 1)}, [Beam("e", [[1, 2]], 1.0, 1.0)]), "space_beam"),
        (lambda: Spring("e", ["1X"], ["2RX"], stiffness=1.0), "translation with a rotation"),
        (lambda: Spring("e", ["1X"], ["1X-"], stiffness=1.0), "with itself"),
        (lambda: RotaryInertia("e", [1], 1.0, "X"), "RX, RY, RZ"),
        (lambda: SpaceBeam("e", [1, 2], 1.0, 1.0, 1.0, orientation=(0.0, 0.0, 0.0)), "must be a direction"),
    ],
)
def test_bad_elements_are_refused_by_name(make, fragment):
    with pytest.raises(InputError, match=fragment):
        make()


def test_text_is_refused_as_a_property():
    with pytest.raises(InputError, match="`mass` of 'b' must be one number or 1, one for each element, got text: '2'"):
        Beam("b", [[1, 2]], mass="2", bending_stiffness=3.0)
