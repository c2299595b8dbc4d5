"""Laws that every element type keeps: symmetry, rigid-body motion, total mass, textbook matrices."""

import numpy as np
import pytest

from structid import Bar, Beam, InputError, PointMass, RotaryInertia, SpaceBeam, Spring, Structure
from structid.structure.elements.beam import hermite_mass, hermite_stiffness

RNG = np.random.default_rng(20261121)


def space_positions():
    return {1: RNG.standard_normal(3), 2: RNG.standard_normal(3), 3: RNG.standard_normal(3)}


def plane_positions():
    return {1: RNG.standard_normal(2), 2: RNG.standard_normal(2), 3: RNG.standard_normal(2)}


PAIRS = [[1, 2], [2, 3]]
CASES = {
    "beam on a line": lambda: ({1: 0.0, 2: 0.7, 3: 2.0}, Beam("e", PAIRS, [2.0, 3.0], [5.0, 7.0], mass_damping=1.0)),
    "beam in a plane": lambda: (plane_positions(), Beam("e", PAIRS, 2.0, 5.0, 11.0, stiffness_damping=1.0)),
    "beam in space": lambda: (space_positions(), SpaceBeam("e", PAIRS, 2.0, 5.0, 6.0, 11.0, 3.0, 0.1)),
    "bar on a line": lambda: ({1: 0.0, 2: 0.7, 3: 2.0}, Bar("e", PAIRS, 2.0, 5.0)),
    "bar in a plane": lambda: (plane_positions(), Bar("e", PAIRS, 2.0, 5.0)),
    "bar in space": lambda: (space_positions(), Bar("e", PAIRS, [2.0, 1.0], 5.0, stiffness_damping=0.5)),
    "point mass": lambda: (space_positions(), PointMass("e", [1, 3], [4.0, 5.0])),
    "spring": lambda: ({1: 0.0, 2: 1.0}, Spring("e", ["1X"], ["2X"], stiffness=3.0)),
}


@pytest.mark.parametrize("case", CASES)
def test_matrices_are_symmetric_and_positive_semidefinite(case):
    nodes, element = CASES[case]()
    for part in Structure(nodes, [element]).contributions:
        matrix = part.blocks.assemble(np.ones(part.blocks.n_elements)).toarray()
        assert np.abs(matrix - matrix.T).max() <= 1e-13 * np.abs(matrix).max()
        assert np.linalg.eigvalsh(matrix).min() >= -1e-12 * np.abs(matrix).max()


def rigid_motions(structure):
    """All rigid motions of the structure as columns on its degrees of freedom."""
    motions = np.zeros((structure.n_dofs, 6))
    for i, dof in enumerate(structure.dofs):
        x = np.zeros(3)
        x[: structure.dimension] = structure.nodes[dof.node]
        if dof.is_rotation:
            motions[i, 3 + dof.axis - 3] = 1.0
        else:
            motions[i, dof.axis] = 1.0
            for turn in range(3):
                axis = np.zeros(3)
                axis[turn] = 1.0
                motions[i, 3 + turn] = np.cross(axis, x)[dof.axis]
    return motions


@pytest.mark.parametrize(
    "case", ["beam on a line", "beam in a plane", "beam in space", "bar in a plane", "bar in space"]
)
def test_stiffness_resists_no_rigid_motion(case):
    nodes, element = CASES[case]()
    structure = Structure(nodes, [element])
    stiffness = structure.matrix("elastic").toarray()
    allowed = {1: [1, 5], 2: [0, 1, 5], 3: range(6)}[structure.dimension]
    motions = rigid_motions(structure)[:, list(allowed)]
    assert np.abs(stiffness @ motions).max() <= 1e-12 * np.abs(stiffness).max() * np.abs(motions).max()


@pytest.mark.parametrize("case", ["beam on a line", "beam in a plane", "beam in space", "bar in space", "point mass"])
def test_rigid_translation_carries_the_whole_mass(case):
    nodes, element = CASES[case]()
    structure = Structure(nodes, [element])
    if isinstance(element, PointMass):
        expected = element.mass.sum()
    else:
        length = [np.linalg.norm(structure.nodes[b] - structure.nodes[a]) for a, b in element.nodes]
        expected = float(np.dot(element.mass, length))
    for axis in range(3):
        motion = np.array([float(d.axis == axis) for d in structure.dofs])
        if motion.any():
            assert motion @ (structure.matrix("inertia") @ motion) == pytest.approx(expected, rel=1e-13)
    assert structure.mass_of() == pytest.approx(expected, rel=1e-13)


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
    for law in ("inertia", "elastic"):
        assert space.matrix(law).toarray() == pytest.approx(plane.matrix(law).toarray(), abs=1e-12)


def test_space_beam_tip_deflections_and_twist_are_those_of_the_textbook():
    length, ei_y, ei_z, ea, gj = 2.0, 3.0, 5.0, 7.0, 11.0
    beam = SpaceBeam("e", [1, 2], 1.0, ei_y, ei_z, ea, gj, orientation=(0.0, 1.0, 0.0))
    fixed = [f"1{d}" for d in ("X", "Y", "Z", "RX", "RY", "RZ")]
    structure = Structure({1: (0.0, 0.0, 0.0), 2: (length, 0.0, 0.0)}, [beam], fixed)
    flexibility = np.linalg.inv(structure.matrix("elastic").toarray())
    expected = [length / ea, length**3 / (3 * ei_z), length**3 / (3 * ei_y), length / gj, length / ei_y, length / ei_z]
    assert np.diag(flexibility) == pytest.approx(expected, rel=1e-12)
    assert flexibility[2, 4] == pytest.approx(-(length**2) / (2 * ei_y), rel=1e-12)  # w' = -rotation about y
    assert flexibility[1, 5] == pytest.approx(length**2 / (2 * ei_z), rel=1e-12)


def test_rotary_inertia_sits_on_its_axis():
    structure = Structure({1: (0.0, 0.0, 0.0)}, [RotaryInertia("e", [1], 0.5, "RY")])
    assert [str(d) for d in structure.dofs] == ["1RY+"]
    assert structure.matrix("inertia").toarray() == pytest.approx(np.array([[0.5]]))


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
