"""Errors of meshes: against frequencies in closed form, silent where the mesh is fine, and said where it cannot be judged."""

from itertools import pairwise

import numpy as np
import pytest

from structid import Bar, Base, Beam, Joint, MatrixGroup, Plate, PointMass, Solid, SpaceBeam, Spring, Structure
from structid.diagnose.checks.mesh import mesh_errors, refined
from structid.dynamics.normal_modes import modes
from structid.fem.elements import Membrane

#: (beta L) of a cantilever; Blevins (1979), Formulas for Natural Frequency and Mode Shape, table 8-1.
CANTILEVER = np.array([1.87510407, 4.69409113, 7.85475744, 10.99554073])


TRIANGLE = ((0.0, 0.0), (1.0, 0.0), (0.3, 1.0))


def cantilever(n, subdivide=1, loss_factor=0.02):
    """Length 1 m, 1 kg/m, 1 N m^2, so that omega = (beta L)^2."""
    nodes = {i: (i / n, 0.0) for i in range(n + 1)}
    rows = [[i, i + 1] for i in range(n)]
    made = Beam("beam", rows, mass=1.0, bending_stiffness=1.0, axial_stiffness=1e6, loss_factor=loss_factor)
    return Structure(nodes, [made], ["0X", "0Y", "0RZ"], subdivide=subdivide)


def test_errors_of_a_cantilever_are_those_of_the_closed_form():
    structure = cantilever(2)
    found = mesh_errors(structure, structure.values, (0.1, 15.0))
    exact = CANTILEVER**2 / (2 * np.pi)
    true = found.frequency / exact[: len(found.frequency)] - 1
    assert len(true) >= 3
    np.testing.assert_allclose(found.error, true, rtol=0.1, atol=1e-5)
    worst = int(np.argmax(true))
    assert true[worst] > 0.1
    assert (
        f"mode {worst + 1} at {found.frequency[worst]:.4g} Hz is {100 * found.error[worst]:.2g} % too high"
        in found.words
    )


def test_what_a_mode_may_be_off_by_is_the_deviation_of_measured_modes_where_that_is_less():
    structure = cantilever(6)
    band = (0.1, 15.0)
    assert (
        mesh_errors(structure, structure.values, band, 0.01).words
        == mesh_errors(structure, structure.values, band).words
    )
    found = mesh_errors(structure, structure.values, band, 1e-4)
    worst = found.error.max()
    assert found.tolerance == 1e-4
    assert f"{worst / 1e-4:.2g} times the deviation that is stated of measured modes" in found.words
    exact = CANTILEVER[: len(found.error)] ** 2 / (2 * np.pi)
    finer = cantilever(6, found.needed)
    off = modes(finer.matrix("mass"), finer.matrix("stiffness")).frequency[: len(exact)] / exact - 1
    assert abs(off).max() < 1e-4


def test_the_pieces_asked_for_are_enough_and_hardly_more_than_needed():
    structure = cantilever(3)
    band = (0.1, 15.0)
    found = mesh_errors(structure, structure.values, band)
    assert f"`subdivide = {found.needed}`" in found.words
    assert found.n_elements == 3 * found.needed
    exact = CANTILEVER[:3] ** 2 / (2 * np.pi)

    def off(subdivide):
        finer = cantilever(3, subdivide)
        return abs(modes(finer.matrix("mass"), finer.matrix("stiffness")).frequency[:3] / exact - 1).max()

    assert found.tolerance == pytest.approx(0.001)  # a tenth of 1 %
    assert off(found.needed) < found.tolerance
    assert off(max(found.needed - 2, 1)) > found.tolerance


def test_a_fine_mesh_is_silent():
    structure = cantilever(3, subdivide=6)
    found = mesh_errors(structure, structure.values, (0.1, 15.0))
    assert (found.needed, found.words, found.passed_over.size) == (0, "", 0)
    assert abs(found.error).max() < 1e-4


def test_joints_stay_what_they_are_when_lines_are_cut():
    """A hinge at mid-span of a cut cantilever: its mode shapes are matched end by end."""
    nodes = {0: (0.0, 0.0), 1: (1.0, 0.0), 2: (2.0, 0.0)}
    beam = Beam("beam", [[0, 1], [1, 2]], mass=1.0, bending_stiffness=1.0, axial_stiffness=1e6)
    hinge = Joint("hinge", "beam:2", "1RZ", stiffness=0.2)
    for subdivide in (1, 3):
        structure = Structure(nodes, [beam, hinge], ["0X", "0Y", "0RZ"], subdivide=subdivide)
        found = mesh_errors(structure, structure.values, (0.01, 1.0))
        assert found.passed_over.size == 0
        assert len(found.frequency) == 2
        assert (abs(found.error) < 0.02 / subdivide).all()
    assert found.needed == 0


def test_the_values_asked_for_count_and_not_the_nominal_ones():
    structure = cantilever(2)
    values = structure.values.copy()
    [bending] = [p for p in structure.properties if p.term.property == "bending_stiffness"]
    values[bending.values] *= 4
    found = mesh_errors(structure, values, (0.1, 8.0))
    np.testing.assert_allclose(found.frequency[0], 2 * CANTILEVER[0] ** 2 / (2 * np.pi), rtol=1e-3)


def test_a_mode_that_the_elements_lack_is_named():
    """One element between supports has no mode of its own inside but that of its two rotations."""
    nodes = {0: (0.0, 0.0), 1: (1.0, 0.0), 2: (2.0, 0.0)}
    beam = Beam("beam", [[0, 1], [1, 2]], mass=1.0, bending_stiffness=1.0, axial_stiffness=1e6)
    structure = Structure(nodes, [beam], [*(f"{n}{d}" for n in (0, 2) for d in "XY"), "0RZ", "2RZ", "1X"])
    found = mesh_errors(structure, structure.values, (0.1, 12.0))
    assert found.passed_over.size
    assert "that it lacks with these" in found.words


def test_what_cannot_be_refined_is_said():
    shell = MatrixGroup("shell", ["1X", "2X"], mass=np.eye(2), stiffness=[[2, -1], [-1, 2]])
    structure = Structure(dict(enumerate(TRIANGLE)), [shell], ["0X", "0Y", "1Y"])
    assert "come from elsewhere" in mesh_errors(structure, structure.values, (0.01, 100.0))


def test_masses_and_springs_have_no_mesh():
    structure = Structure({1: 0.0}, [PointMass("m", [1], 1.0), Spring("k", "1X", stiffness=9.0)], active=["X"])
    assert mesh_errors(structure, structure.values, (0.1, 10.0)) == ""


def test_a_truss_has_no_mesh():
    """Pieces of its bars would move sideways."""
    truss = Bar("truss", [[0, 1], [1, 2], [0, 2]], mass=1.0, axial_stiffness=1e4)
    structure = Structure(dict(enumerate(TRIANGLE)), [truss], ["0X", "0Y", "1Y"])
    assert mesh_errors(structure, structure.values, (0.01, 100.0)) == ""


@pytest.mark.parametrize("subdivide", [1, 2])
def test_beams_beside_bars_are_judged_and_the_bars_stay_whole(subdivide):
    """As where the bars are springs along X and the mass that they have at the tip."""
    nodes = {i: (0.0, i / 2) for i in range(3)} | {8: (1.0, 1.0)}
    mast = Beam("mast", [[0, 1], [1, 2]], mass=1.0, bending_stiffness=1.0, axial_stiffness=1e6, loss_factor=0.02)
    fixed = ["0X", "0Y", "0RZ", "8X", "8Y"]
    strut = [Bar("strut", [[8, 2]], mass=0.3, axial_stiffness=5.0)]
    alike = [PointMass("tip", [2], 0.1), Spring("spring", "2X", stiffness=5.0)]
    one, other = (Structure(nodes, [mast, *own], fixed, subdivide=subdivide) for own in (strut, alike))
    found, made = (mesh_errors(each, each.values, (0.1, 15.0)) for each in (one, other))
    np.testing.assert_allclose(found.error, made.error, rtol=1e-5, atol=1e-9)
    assert len(found.error) >= 3
    assert found.words == made.words
    assert found.needed > 1


def test_a_column_whose_ends_do_not_turn_is_judged():
    """It bends about X between ends without rotation about X: pieces turn there, whatever `active` leaves out."""
    properties = {
        "bending_stiffness_y": 1.0,
        "bending_stiffness_z": 1.0,
        "axial_stiffness": 1e3,
        "torsional_stiffness": 1.0,
    }
    column = SpaceBeam("column", [[1, 2]], mass=1.0, polar_inertia=0.1, **properties)
    nodes = {1: (0, 0, 0), 2: (0, 0, 1)}
    held = Structure(nodes, [column], ["1X", "1Y"], active=["X", "Y", "RY"])
    free = Structure(nodes, [column], ["1X", "1Y", "1RX", "2RX"], active=["X", "Y", "RX", "RY"])
    both = (mesh_errors(one, one.values, (0.01, 10.0)) for one in (held, free))
    np.testing.assert_allclose(*(one.error for one in both), rtol=1e-9)


def grid(n):
    nodes = {i * (n + 1) + j + 1: (i / n, j / n) for i in range(n + 1) for j in range(n + 1)}
    corners = [(i * (n + 1) + j + 1, i, j) for i in range(n) for j in range(n)]
    quads = [[a, a + n + 1, a + n + 2, a + 1] for a, _, _ in corners]
    rim = [node for node, (x, y) in nodes.items() if x in (0, 1) or y in (0, 1)]
    return nodes, quads, rim


def test_a_square_membrane_and_plate_are_off_by_what_the_closed_forms_say():
    """Blevins (1979), tables 10-16 and 11-4: f = sqrt(m^2 + n^2) / 2, and (m^2 + n^2) pi / 2 sqrt(D / mass)."""
    nodes, quads, rim = grid(8)
    squares = np.array([2, 5, 5, 8])
    triangles = [t for q in quads for t in ([q[0], q[1], q[2]], [q[0], q[2], q[3]])]
    membrane = Structure(nodes, [Membrane("skin", triangles, mass=1.0, tension=1.0)], [f"{n}Z" for n in rim])
    found = mesh_errors(membrane, membrane.values, (0.1, 1.45))
    true = found.frequency / (np.sqrt(squares[: len(found.frequency)]) / 2) - 1
    np.testing.assert_allclose(found.error, true, rtol=0.02)
    plate = Plate("plate", quads, youngs_modulus=12 * 0.91e9, density=1000.0, thickness=0.01, poisson=0.3)
    structure = Structure(nodes, [plate], [f"{n}Z" for n in rim])
    found = mesh_errors(structure, structure.values, (0.1, 125.0))
    true = found.frequency / (squares[: len(found.frequency)] * np.pi / 2 * np.sqrt(1e3 / 10)) - 1
    assert len(true) == 4
    np.testing.assert_allclose(found.error, true, rtol=0.02)
    assert "cells 1/" in found.words
    assert "too low" in found.words


def bricks(n):
    nodes, ids = {}, {}
    for i in range(n + 1):
        for b in range(2):
            for a in range(2):
                ids[i, a, b] = len(nodes) + 1
                nodes[ids[i, a, b]] = (i / n, 0.1 * a, 0.1 * b)
    around = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    cells = [[ids[i + x, a, b] for x, a, b in around] for i in range(n)]
    held = [f"{ids[0, a, b]}{d}" for a in range(2) for b in range(2) for d in "XYZ"]
    return nodes, cells, held


@pytest.mark.parametrize("kind", ["hexahedron", "tetra"])
def test_split_solids_fill_the_same_space_and_are_held_alike(kind):
    nodes, cells, held = bricks(4)
    if kind == "tetra":
        split = ([0, 1, 2, 5], [0, 2, 3, 7], [0, 5, 7, 4], [2, 5, 6, 7], [0, 2, 7, 5])
        cells = [[cell[a] for a in part] for cell in cells for part in split]
    made = Solid("bar", cells, youngs_modulus=np.linspace(1e9, 2e9, len(cells)), density=1000.0, poisson=0.0)
    structure = Structure(nodes, [made], held)
    finer = refined(structure, structure.values, 2, 10**6)
    assert len(finer.structure.elements[0].nodes) == 8 * len(cells)
    assert len([d for d in finer.structure.fixed if d.direction == "X"]) == 9
    assert finer.structure.mass_of(finer.values) == pytest.approx(structure.mass_of(structure.values))
    # under a stretch u = x, strain energy E A L / 2 is exact on any mesh: the values went to the right children
    energy = []
    for one, values in ((structure, structure.values), (finer.structure, finer.values)):
        u = np.array([one.nodes[d.node][0] if d.direction == "X" else 0.0 for d in one.dofs])
        energy.append(u @ one.matrix("stiffness", values) @ u)
    assert energy[1] == pytest.approx(energy[0], rel=1e-9)


def test_stiffeners_are_split_with_their_plate():
    nodes, quads, rim = grid(4)
    nodes = {node: (*at, 0.0) for node, at in nodes.items()}
    plate = Plate("plate", quads, youngs_modulus=7e10, density=2700.0, thickness=0.003, poisson=0.3, loss_factor=0.02)
    axis = [11, 12, 13, 14, 15]
    rows = [[a, b] for a, b in pairwise(axis)]
    properties = {"bending_stiffness_y": 50.0, "bending_stiffness_z": 50.0, "torsional_stiffness": 5.0}
    rib = SpaceBeam("rib", rows, mass=0.5, axial_stiffness=1e6, polar_inertia=1e-4, **properties)
    structure = Structure(nodes, [plate, rib], [f"{n}Z" for n in rim], active=["Z", "RX", "RY"])
    finer = refined(structure, structure.values, 2, 10**6).structure
    assert [len(made.nodes) for made in finer.elements] == [64, 8]
    assert set(np.unique(finer.elements[1].nodes)) <= set(np.unique(finer.elements[0].nodes))
    assert not isinstance(mesh_errors(structure, structure.values, (1.0, 60.0)), str)


def test_split_cells_keep_base_and_damping_ratio_of_all_modes():
    nodes, quads, rim = grid(2)
    plate = Plate("plate", quads, youngs_modulus=7e10, density=2700.0, thickness=0.003, poisson=0.3)
    whole = Structure(
        nodes, [plate], [f"{n}Z" for n in rim], bases=[Base("rim", [f"{n}Z" for n in rim])], damping_ratio=0.02
    )
    found = refined(whole, np.append(whole.values[:-1], 0.03), 2, 10**6)
    assert found.structure.bases == whole.bases
    matrices = (found.structure.matrix(law, found.values) for law in ("mass", "stiffness", "damping"))
    assert modes(*matrices).damping_ratio[:4] == pytest.approx(0.03, rel=1e-6)


@pytest.mark.parametrize("n_bars", [1, 2])
def test_split_cells_keep_the_uncertain_length_of_a_line_set(n_bars):
    """One value of the set, however many bars it has, and before the damping ratio of all modes."""
    nodes, quads, rim = grid(2)
    triangles = [t for q in quads for t in ([q[0], q[1], q[2]], [q[0], q[2], q[3]])]
    skin = Membrane("skin", triangles, mass=1.0, tension=1.0)
    edge = Bar("edge", [[1, 2], [2, 3]][:n_bars], 1.0, 1e3, tolerance={"length": 0.01})
    whole = Structure(nodes, [skin, edge], [f"{n}Z" for n in rim], damping_ratio=0.02)
    finer = refined(whole, np.append(whole.values[:-2], [1.005, 0.03]), 2, 10**6)
    assert len(finer.values) == len(finer.structure.values)
    assert finer.values[-2:].tolist() == [1.005, 0.03]
    assert [p.element for p in finer.structure.properties][-2:] == ["edge", "all modes"]


def test_sliding_nodes_beside_cells_are_not_judged():
    """Their places count from the next node, which would be another in a split line."""
    nodes, quads, _ = grid(2)
    plate = Plate("plate", quads, youngs_modulus=7e10, density=2700.0, thickness=0.003, poisson=0.3)
    nodes = {node: (*at, 0.0) for node, at in nodes.items()} | {90 + i: (float(i), 9.0, 0.0) for i in range(3)}
    properties = {"bending_stiffness_y": 50.0, "bending_stiffness_z": 50.0, "torsional_stiffness": 5.0}
    beam = SpaceBeam("beam", [[90, 91], [91, 92]], mass=0.5, axial_stiffness=1e6, polar_inertia=1e-4, **properties)
    whole = Structure(nodes, [plate, beam], ["90Z", "90RX", "92Z"], active=["Z", "RX", "RY"], sliding=[91])
    assert "beside lines with joints, `sliding`" in mesh_errors(whole, whole.values, (0.1, 10.0))


def test_a_model_too_large_is_not_solved(monkeypatch):
    monkeypatch.setattr("structid.diagnose.checks.mesh._MOST_DOFS", 10)
    structure = cantilever(3)
    assert "more than 10 degrees of freedom" in mesh_errors(structure, structure.values, (0.1, 15.0))


def test_bars_amid_cells_are_split_along_their_edges_only():
    nodes, quads, rim = grid(2)
    triangles = [t for q in quads for t in ([q[0], q[1], q[2]], [q[0], q[2], q[3]])]
    skin = Membrane("skin", triangles, mass=1.0, tension=1.0)
    sets = [skin, Bar("edge", [[1, 2], [2, 3]], 1.0, 1e3), Bar("brace", [[1, 10]], 1.0, 1e3)]
    structure = Structure(nodes | {10: (3.0, 4.0)}, sets, [f"{n}Z" for n in rim])
    finer = refined(structure, structure.values, 4, 10**5).structure
    assert [len(one.nodes) for one in finer.elements] == [128, 8, 1]
    assert finer.elements[2].nodes.tolist() == [[1, 10]]
