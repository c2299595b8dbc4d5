"""The membrane element against scikit-fem, the continuum, and what every element keeps."""

import numpy as np
import pytest
import skfem
from skfem.helpers import dot, grad

from structid import InputError, PointMass, Structure
from structid.dynamics.normal_modes import modes
from structid.fem import ELEMENT_TYPES, Membrane

RNG = np.random.default_rng(5)


def scattered(n_nodes=8):
    """Random nodes and their triangles: points, (n_triangles, 3)."""
    mesh = skfem.MeshTri.init_tensor(np.linspace(0, 2, n_nodes // 2), np.linspace(0, 1, 3))
    points = mesh.p.T + 0.08 * RNG.standard_normal(mesh.p.T.shape)
    return points, mesh.t.T


def structure_of(points, triangles, **given):
    given = {"mass": 2.0, "tension": 3.0} | given
    return Structure({i + 1: p for i, p in enumerate(points)}, [Membrane("skin", triangles + 1, **given)])


def test_matrices_are_those_of_scikit_fem():
    points, triangles = scattered()
    basis = skfem.Basis(skfem.MeshTri(points.T, triangles.T), skfem.ElementTriP1(), intorder=4)
    mass = skfem.asm(skfem.BilinearForm(lambda u, v, _: 2.0 * u * v), basis).toarray()
    stiffness = skfem.asm(skfem.BilinearForm(lambda u, v, _: 3.0 * dot(grad(u), grad(v))), basis).toarray()
    structure = structure_of(points, triangles)
    assert structure.matrix("mass").toarray() == pytest.approx(mass, abs=1e-14)
    assert structure.matrix("stiffness").toarray() == pytest.approx(stiffness, abs=1e-12)


def test_each_triangle_has_a_weight_of_its_own():
    points, triangles = scattered()
    mass, tension = RNG.uniform(1, 2, (2, len(triangles)))
    structure = structure_of(points, triangles, mass=mass, tension=tension)
    for kind, values, unit in (("mass", mass, {"tension": 0.0}), ("stiffness", tension, {"mass": 0.0})):
        total = sum(
            value * structure_of(points, triangles, **({"mass": e, "tension": e} | unit)).matrix(kind).toarray()
            for value, e in zip(values, np.eye(len(triangles)), strict=True)
        )
        assert structure.matrix(kind).toarray() == pytest.approx(total, abs=1e-13)


@pytest.mark.parametrize("lumped", [False, True])
def test_matrices_keep_the_laws_of_every_element(lumped):
    points, triangles = scattered()
    structure = structure_of(points, triangles, lumped=lumped, mass_damping=0.5)
    mass, stiffness = structure.matrix("mass").toarray(), structure.matrix("stiffness").toarray()
    area = structure_of(points, triangles, mass=1.0).mass_of()
    assert structure.mass_of() == pytest.approx(2.0 * area, rel=1e-13)
    assert np.abs(stiffness @ np.ones(len(points))).max() <= 1e-12
    assert mass == pytest.approx(mass.T)
    assert stiffness == pytest.approx(stiffness.T, abs=1e-13)
    assert np.linalg.eigvalsh(mass).min() > 0
    assert np.linalg.eigvalsh(stiffness)[1] > 1e-3
    assert (np.count_nonzero(mass - np.diag(np.diag(mass))) == 0) == lumped
    assert structure.matrix("damping").toarray() == pytest.approx(0.25 * mass, rel=1e-13)


def test_lumped_mass_is_the_row_sum_of_the_consistent_mass():
    points, triangles = scattered()
    consistent = structure_of(points, triangles).matrix("mass").toarray()
    lumped = structure_of(points, triangles, lumped=True).matrix("mass").toarray()
    assert np.diag(lumped) == pytest.approx(consistent.sum(axis=1), rel=1e-13)


def square(n, **given):
    """n by n squares on the unit square, cut alternately, held at the rim."""
    mesh = skfem.MeshTri.init_sqsymmetric().refined(n)
    points = mesh.p.T
    rim = [f"{i + 1}Z" for i, p in enumerate(points) if ((p == 0) | (p == 1)).any()]
    skin = Membrane("skin", mesh.t.T + 1, 2.0, 3.0, **given)
    return Structure({i + 1: p for i, p in enumerate(points)}, [skin], rim)


@pytest.mark.parametrize(("lumped", "side"), [(False, 1.0), (True, -1.0)])
def test_frequencies_of_a_square_converge_to_the_continuum_from_one_side(lumped, side):
    """omega^2 = (tension/mass) pi^2 (i^2 + j^2); halving the sides divides the error by four (a tenth of slack)."""
    exact = np.pi * np.sqrt(1.5 * np.array([2.0, 5.0, 5.0, 8.0]))
    errors = []
    for n in (2, 3):
        structure = square(n, lumped=lumped)
        found = modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=4).frequency
        errors.append(2 * np.pi * found / exact - 1)
    assert (side * errors[1] > 0).all()
    assert errors[0] / errors[1] == pytest.approx(np.full(4, 4.0), rel=0.1)
    assert np.abs(errors[1]).max() <= 2e-2


def test_loss_factor_weighs_the_tension():
    points, triangles = scattered()
    structure = structure_of(points, triangles, loss_factor=0.02)
    expected = 0.02 * structure.matrix("stiffness").toarray()
    assert structure.matrix("structural_damping").toarray() == pytest.approx(expected, rel=1e-13)


def test_nodes_in_space_and_in_the_plane_give_one_membrane():
    points, triangles = scattered()
    space = np.concatenate([points, np.full((len(points), 1), 0.7)], axis=1)
    flat, lifted = structure_of(points, triangles), structure_of(space, triangles)
    assert flat.dofs == lifted.dofs
    assert {dof.direction for dof in flat.dofs} == {"Z"}
    for kind in ("mass", "stiffness"):
        assert flat.matrix(kind).toarray() == pytest.approx(lifted.matrix(kind).toarray(), abs=1e-14)


def test_point_mass_rides_on_a_membrane_in_two_dimensions():
    points, triangles = scattered()
    skin = Membrane("skin", triangles + 1, 2.0, 3.0)
    nodes = {i + 1: p for i, p in enumerate(points)}
    structure = Structure(nodes, [skin, PointMass("lump", [4], 5.0)])
    bare = Structure(nodes, [skin])
    assert structure.dofs == bare.dofs
    assert structure.mass_of() == pytest.approx(bare.mass_of() + 5.0, rel=1e-13)


def test_structures_without_membrane_move_in_their_plane_only():
    assert Structure({1: (0.0, 0.0)}, [PointMass("lump", [1], 5.0)]).active == ("X", "Y", "RZ")
    assert ELEMENT_TYPES["membrane"] is Membrane


PLANE = {1: (0.0, 0.0), 2: (1.0, 0.0), 3: (2.0, 0.0), 4: (0.0, 1.0)}


@pytest.mark.parametrize(
    ("make", "fragment"),
    [
        (lambda: Membrane("skin", [[1, 2]], 1.0, 1.0), "2 nodes; it can have 3"),
        (lambda: Membrane("skin", [[1, 2, 4]], -1.0, 1.0), "`mass` of 'skin'"),
        (lambda: Membrane("skin", [[1, 2, 4]], 1.0, [1.0, 2.0]), "`tension` of 'skin'"),
        (lambda: Structure(PLANE, [Membrane("skin", [[1, 2, 4], [1, 2, 3]], 1.0, 1.0)]), "element 2 .* has no area"),
        (lambda: Structure(PLANE, [Membrane("skin", [[1, 2, 2]], 1.0, 1.0)]), "no area"),
        (lambda: Structure({1: 0.0, 2: 1.0, 3: 2.0}, [Membrane("skin", [[1, 2, 3]], 1.0, 1.0)]), "needs 2-D nodes"),
        (
            lambda: Structure(
                {1: (0.0, 0.0, 0.0), 2: (1.0, 0.0, 0.0), 3: (0.0, 1.0, 0.5)}, [Membrane("skin", [[1, 2, 3]], 1.0, 1.0)]
            ),
            "not parallel to the x-y plane",
        ),
    ],
)
def test_bad_membranes_are_refused_by_name(make, fragment):
    with pytest.raises(InputError, match=fragment):
        make()
