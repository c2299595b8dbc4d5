"""Supports, ties and selections of a structure."""

import numpy as np
import pytest

from structid import (
    Beam,
    Constraint,
    Dashpot,
    InputError,
    PointMass,
    RigidLink,
    RotaryInertia,
    SpaceBeam,
    Spring,
    Structure,
    from_matrices,
    parse_dof,
)
from structid.dynamics.normal_modes import modes

CLAMP = [f"1{d}" for d in ("X", "Y", "Z", "RX", "RY", "RZ")]


def test_cantilever_frequencies_are_those_of_the_continuous_beam():
    """Euler-Bernoulli cantilever, (beta L)^2 = 3.51602, 22.0345, 61.6972; cubics on 20 elements are within 2e-5."""
    n = 20
    beam = Beam("beam", [[i, i + 1] for i in range(n)], 1.0, 1.0)
    structure = Structure({i: i / n for i in range(n + 1)}, [beam], ["0Y", "0RZ"])
    found = modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=3)
    assert 2 * np.pi * found.frequency == pytest.approx([3.516015, 22.03449, 61.69721], rel=2e-5)


def test_rigid_link_adds_mass_where_the_parallel_axis_theorem_puts_it():
    arm = np.array([0.3, -0.2, 0.5])
    structure = Structure(
        {1: (0, 0, 0), 2: arm},
        [RotaryInertia("i", [1], 1.0, "RZ"), PointMass("m", [2], 4.0)],
        ties=[RigidLink("r", 1, 2)],
    )
    mass = structure.matrix("mass").toarray()
    about = {d.direction: i for i, d in enumerate(structure.dofs)}
    assert all(d.node == 1 for d in structure.dofs)
    assert mass[about["RZ"], about["RZ"]] == pytest.approx(1.0 + 4.0 * (arm[0] ** 2 + arm[1] ** 2))
    assert mass[about["RX"], about["RY"]] == pytest.approx(-4.0 * arm[0] * arm[1])
    assert mass[about["X"], about["RY"]] == pytest.approx(4.0 * arm[2])


def test_selection_reads_through_a_link_with_its_sign():
    structure = Structure(
        {1: (0, 0, 0), 2: (0, 0, 1), 3: (0.1, 0.2, 1)},
        [SpaceBeam("c", [1, 2], 1.0, 1.0, 1.0, 1.0, 1.0)],
        CLAMP,
        [RigidLink("r", 2, 3)],
    )
    reading = structure.selection([parse_dof("3X-")]).toarray()[:, 0]
    expected = {"2X+": -1.0, "2RZ+": 0.2}
    assert {str(d): v for d, v in zip(structure.dofs, reading, strict=True) if v} == expected


def test_a_selection_cannot_be_changed_and_only_the_last_are_kept():
    structure = Structure(
        {i: (float(i), 0, 0) for i in range(40)}, [PointMass("m", list(range(40)), 1.0)], active=["X"]
    )
    dofs = [parse_dof(f"{i}X-") for i in (3, 1)]
    columns = structure.selection(dofs)
    for array in (columns.data, columns.indices, columns.indptr):
        with pytest.raises(ValueError, match="read-only"):
            array *= -7
    np.testing.assert_array_equal(columns.toarray()[[3, 1]], -np.eye(2))
    np.testing.assert_array_equal((columns.T @ columns).toarray(), np.eye(2))
    np.testing.assert_array_equal((columns[:, [1]] - abs(columns[:, [0]])).toarray()[[3, 1], 0], [-1, -1])
    assert structure.selection(dofs) is columns
    for i in range(40):
        structure.selection([parse_dof(f"{i}X+")])
    assert structure.selection([parse_dof("39X+")]) is structure.selection([parse_dof("39X+")])
    assert len(structure._selections) < 40


def test_constraint_equals_a_very_stiff_spring():
    parts = [
        PointMass("m", [1, 2, 3], [1.0, 2.0, 3.0]),
        Spring("k", ["1X", "2X"], ["2X", "3X"], stiffness=[50.0, 70.0]),
    ]
    ground = Spring("g", "1X", stiffness=10.0)
    nodes = {1: 0.0, 2: 1.0, 3: 2.0}
    tied = Structure(nodes, [*parts, ground], ties=[Constraint("c", "3X", [("1X", 1.0)])])
    stiff = Structure(nodes, [*parts, ground, Spring("s", "3X", "1X", stiffness=1e9)])
    frequencies = [modes(s.matrix("mass"), s.matrix("stiffness")).frequency for s in (tied, stiff)]
    assert len(frequencies[0]) == 2
    assert frequencies[0] == pytest.approx(frequencies[1][:2], rel=1e-6)


def test_chained_ties_resolve_and_circles_are_refused():
    nodes = {1: 0.0, 2: 1.0, 3: 2.0}
    mass = PointMass("m", [1, 2, 3], 1.0, directions=("X",))
    chain = [Constraint("a", "2X", [("1X", 2.0)]), Constraint("b", "3X", [("2X", 3.0)])]
    assert Structure(nodes, [mass], ties=chain).matrix("mass").toarray() == pytest.approx(np.array([[1 + 4 + 36.0]]))
    circle = [Constraint("a", "2X", [("1X", 1.0)]), Constraint("b", "1X", [("2X", 1.0)])]
    with pytest.raises(InputError, match="circle"):
        Structure(nodes, [mass], ties=circle)


def test_from_matrices_equals_the_same_elements():
    beam = Beam("beam", [[0, 1], [1, 2]], [2.0, 3.0], [5.0, 7.0])
    whole = Structure({0: 0.0, 1: 1.0, 2: 2.0}, [beam])
    groups = {
        f"part {e}": {
            "mass": whole.contributions[0].blocks.assemble(np.eye(2)[e] * beam.mass),
            "stiffness": whole.contributions[1].blocks.assemble(np.eye(2)[e] * beam.bending_stiffness),
        }
        for e in range(2)
    }
    imported = from_matrices(groups, whole.dofs, fixed=["0Y", "0RZ"])
    direct = Structure(whole.nodes, [beam], ["0Y", "0RZ"])
    assert imported.dofs == direct.dofs
    for kind in ("mass", "stiffness"):
        assert imported.matrix(kind).toarray() == pytest.approx(direct.matrix(kind).toarray())
    assert imported.mass_of(direction="Y") == pytest.approx(5.0)


def test_dashpot_enters_the_damping_matrix_only():
    structure = Structure({1: 0.0, 2: 1.0}, [Dashpot("d", "1X", "2X-", viscous_damping=3.0)])
    assert structure.matrix("damping").toarray() == pytest.approx(np.array([[3.0, 3.0], [3.0, 3.0]]))
    assert structure.matrix("stiffness").nnz == 0


NODES = {1: (0.0, 0.0), 2: (1.0, 0.0)}


@pytest.mark.parametrize(
    ("make", "fragment"),
    [
        (lambda: Structure({}, []), "at least one node"),
        (lambda: Structure({1: 0.0, 2: (1.0, 2.0)}, []), "1, 2 or 3 coordinates"),
        (lambda: Structure({1: np.nan}, []), "finite"),
        (lambda: Structure(NODES, [Beam("a", [[1, 5]], 1.0, 1.0)]), "uses node 5"),
        (lambda: Structure(NODES, [PointMass("a", [1], 1.0), PointMass("a", [2], 1.0)]), "called 'a'"),
        (lambda: Structure(NODES, [PointMass("a", [1], 1.0)], ["7X"]), "node 7"),
        (lambda: Structure(NODES, [PointMass("a", [1, 2], 1.0)]).selection([parse_dof("12X+")]), "node 12"),
        (lambda: Structure(NODES, [PointMass("a", [1], 1.0)]).selection([parse_dof("1Z+")]), "moves in 1X\\+, 1Y\\+"),
        (lambda: Structure(NODES, [PointMass("a", [1], 1.0)], ["1X"]).selection([parse_dof("1X+")]), "held at zero"),
        (
            lambda: Structure(NODES, [PointMass("a", [1, 2], 1.0)], ["2X"], [RigidLink("r", 1, 2)]),
            "fixed and also depends",
        ),
        (
            lambda: Structure(NODES, [PointMass("a", [1, 2], 1.0)], ties=[RigidLink("r", 1, 2), RigidLink("s", 1, 2)]),
            "depends twice",
        ),
        (lambda: from_matrices({"g": {"mass": [[1.0, 2.0], [0.0, 1.0]]}}, ["1X", "2X"]), "symmetric"),
        (lambda: from_matrices({"g": {"mass": np.eye(3)}}, ["1X", "2X"]), r"\(2, 2\)"),
    ],
)
def test_bad_structures_are_refused_with_the_place(make, fragment):
    with pytest.raises(InputError, match=fragment):
        make()


def test_total_mass_is_along_a_direction_that_is_active():
    """A beam has mass along itself too; of a model that moves across it only, that across is the total."""
    parts = [Beam("beam", [[1, 2]], 3.0, 1.0), PointMass("floor", [2], 4.0, directions=["Y"])]
    structure = Structure({1: [0.0, 0.0], 2: [2.0, 0.0]}, parts, ["1Y", "1RZ"], active=["Y", "RZ"])
    assert structure.mass_of() == pytest.approx(10.0)
    assert structure.mass_of(direction="X") == pytest.approx(6.0)
