"""Components: the textbook's reduction, its kinds, what it leaves to the rest of the structure, and what is refused."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg

from structid import (
    Base,
    Beam,
    Component,
    Dashpot,
    FrfRecord,
    Friction,
    InputError,
    Joint,
    MatrixGroup,
    PlanOptions,
    Plate,
    PointMass,
    RigidLink,
    Smoothness,
    Spring,
    Structure,
    Unknown,
    parameters,
)
from structid.dynamics.normal_modes import modes
from structid.fem.measuring_points import AimedSensor
from structid.forward import FrfProblem
from structid.forward.frf.response import response
from structid.identification.record_fit import frf_truncation, modes_truncation
from structid.planning.plan import resolve_options
from structid.unknowns import penalty

LAWS = ("mass", "damping", "stiffness", "structural_damping")
WAYS = ("Z", "RX", "RY")


def plate(
    up_to: float | None = 300.0, more=(), nx: int = 5, ny: int = 4, fixed=(), loss=0.01, **component
) -> Structure:
    """A plate on three springs at its corners, as a component."""
    across = nx + 1
    nodes = {1 + i + j * across: (0.2 * i, 0.2 * j + 0.03 * i, 0.0) for j in range(ny + 1) for i in range(across)}
    first = [1 + i + j * across for j in range(ny) for i in range(nx)]
    cells = [[n, n + 1, n + 1 + across, n + across] for n in first]
    sets = [
        Plate("left", cells[::2], youngs_modulus=7e10, density=2700.0, poisson=0.3, thickness=5e-3, loss_factor=loss),
        Plate("right", cells[1::2], youngs_modulus=6e10, density=2600.0, poisson=0.3, thickness=4e-3, loss_factor=0.01),
        Spring("legs", ["1Z", f"{across}Z", f"{across * ny + 1}Z"], stiffness=[2e4, 3e4, 1e4], loss_factor=0.02),
        *more,
    ]
    parts = () if up_to is None else (Component("panel", ["left", "right"], up_to, **component),)
    return Structure(nodes, sets, fixed, active=WAYS, components=parts)


def matrices(structure: Structure) -> dict[str, np.ndarray]:
    return {kind: structure.matrix(kind).toarray() for kind in LAWS}


def receptance(structure: Structure, outputs, inputs, frequency, values=None) -> np.ndarray:
    m, c, k, h = (structure.matrix(kind, values).toarray() for kind in LAWS)
    s, f = structure.selection(parse(outputs)).toarray(), structure.selection(parse(inputs)).toarray()
    w = 2 * np.pi * np.atleast_1d(frequency)
    return np.array([s.T @ np.linalg.solve(k + 1j * h + 1j * x * c - x**2 * m, f) for x in w])


def parse(dofs):
    return FrfRecord(np.ones(1), np.ones((1, len(dofs), 1)), dofs, ["1Z"], "receptance").outputs


def apart(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.abs(one - other).max() / np.abs(other).max())


def test_it_is_the_reduction_of_the_textbook():
    """Craig and Bampton's basis with the static answer to inertia, dense and in coordinates of its own."""
    found, whole = plate(150.0), plate(None)
    m, c, k, h = (matrices(whole)[kind] for kind in LAWS)
    border = [whole.dofs.index(dof) for dof in parse(["1Z", "6Z", "25Z"])]
    inside = np.setdiff1d(np.arange(whole.n_dofs), border)
    at, bt = np.ix_(inside, inside), np.ix_(inside, border)
    springs = plate(None).matrix("stiffness", np.where(["legs" not in p for p in labels(whole)], 0.0, whole.values))
    own = k - springs.toarray()
    constraint = -np.linalg.solve(own[at], own[bt])
    squares, shapes = linalg.eigh(own[at], m[at])
    kept = shapes[:, squares <= (2 * np.pi * 150.0) ** 2]
    static = np.linalg.solve(own[at], m[bt] + m[at] @ constraint)
    static = static - kept @ (kept.T @ (m[at] @ static))
    static = static / np.linalg.norm(static, axis=0)
    basis = np.zeros((whole.n_dofs, 3 + kept.shape[1] + 3))
    basis[border, :3] = np.eye(3)
    basis[inside] = np.concatenate([constraint, kept, static], axis=1)
    assert found.n_dofs == basis.shape[1]
    assert found.reductions[0].n_modes == kept.shape[1] > 3
    small = [basis.T @ a @ basis for a in (m, c, k, h)]
    expected = np.sqrt(linalg.eigh(small[2], small[0], eigvals_only=True)) / (2 * np.pi)
    assert modes(found.matrix("mass"), found.matrix("stiffness")).frequency == pytest.approx(expected, rel=1e-8)
    s = basis.T @ whole.selection(parse(["15Z", "16RX", "1Z"])).toarray()
    f = basis.T @ whole.selection(parse(["22Z"])).toarray()
    lines = np.array([5.0, 31.0, 90.0])
    answer = [
        s.T @ np.linalg.solve(small[2] + 1j * small[3] + 1j * w * small[1] - w**2 * small[0], f)
        for w in 2 * np.pi * lines
    ]
    assert apart(receptance(found, ["15Z", "16RX", "1Z"], ["22Z"], lines), np.array(answer)) < 1e-8


def labels(structure: Structure) -> list[str]:
    return [p.label for p in structure.properties for _ in p.term.values]


def test_its_mass_and_rigid_motions_stay_and_its_frequencies_come_from_above():
    found, whole = plate(120.0), plate(None)
    assert found.n_dofs < whole.n_dofs / 3
    assert found.mass_of() == pytest.approx(whole.mass_of(), rel=1e-12)
    assert [p.label for p in found.properties if p.element == "panel"] == [
        "mass[panel]",
        "stiffness[panel]",
        "loss_factor[panel]",
    ]
    assert found.mass_gradient()[labels(found).index("mass[panel]")] == pytest.approx(whole.mass_of(), rel=1e-12)
    for matrix in matrices(found).values():
        assert np.abs(matrix - matrix.T).max() <= 1e-12 * max(np.abs(matrix).max(), 1e-300)
        assert np.linalg.eigvalsh(matrix).min() >= -1e-9 * np.abs(matrix).max()
    values = np.where([label.endswith("[legs]") for label in labels(found)], 0.0, found.values)
    loose = linalg.eigh(found.matrix("stiffness", values).toarray(), found.matrix("mass").toarray(), eigvals_only=True)
    assert np.abs(loose[:3]).max() < 1e-7 * loose[3]  # heave, pitch and roll
    few, many = (modes(s.matrix("mass"), s.matrix("stiffness"), n_modes=12).frequency for s in (found, whole))
    assert (few >= many * (1 - 1e-9)).all()
    assert few[:6] == pytest.approx(many[:6], rel=1e-5)


def test_with_all_modes_nothing_changes():
    found, whole = plate(1e9), plate(None)
    assert found.n_dofs == whole.n_dofs
    lines = np.array([10.0, 80.0, 400.0])
    pair = [receptance(s, ["16Z", "16RX"], ["9Z"], lines) for s in (found, whole)]
    assert apart(*pair) < 1e-7


def test_errors_fall_with_the_modes_kept_and_loads_amid_it_want_an_interface():
    whole, lines = plate(None), np.linspace(3.0, 60.0, 40)
    exact = receptance(whole, ["16Z", "3Z"], ["9Z"], lines)
    limits = (100.0, 200.0, 400.0)
    far, near = (
        [apart(receptance(plate(up, interface=i), ["16Z", "3Z"], ["9Z"], lines), exact) for up in limits]
        for i in ((), "9Z")
    )
    assert near[0] > 10 * near[1] > 50 * near[2]
    assert near[2] < 1e-6
    assert (np.array(far[1:]) > 20 * np.array(near[1:])).all()


def test_unreduced_has_the_same_properties_and_all_degrees_of_freedom():
    found, whole = plate(120.0, loss=0.03), plate(None, loss=0.03)
    again = found.unreduced
    assert labels(again) == labels(found)
    assert again.n_dofs == whole.n_dofs
    for kind in LAWS:
        one, other = again.matrix(kind).toarray(), whole.matrix(kind).toarray()
        assert np.abs(one - other).max() <= 1e-12 * max(np.abs(other).max(), 1e-300)
    assert "not reduced" in again.reductions[0].words


def test_factors_of_the_whole_leave_its_modes_as_they_are():
    """Stiffness 1.44 and mass 0.9 times: what a component with such properties is reduced to, limits in proportion."""
    found = plate(120.0)
    values = found.values.copy()
    for name, factor in (("mass[panel]", 0.9), ("stiffness[panel]", 1.44)):
        values[labels(found).index(name)] = factor
    scaled = []
    for element in plate(None).elements[:2]:
        scaled.append(replace(element, youngs_modulus=1.44 * element.youngs_modulus, density=0.9 * element.density))
    made = replace(
        found,
        elements=(*scaled, *found.elements[2:]),
        components=(Component("panel", ["left", "right"], 120.0 * np.sqrt(1.44 / 0.9)),),
    )
    assert made.n_dofs == found.n_dofs
    lines = np.array([7.0, 44.0])
    one, other = receptance(found, ["16Z"], ["1Z"], lines, values), receptance(made, ["16Z"], ["1Z"], lines)
    assert apart(one, other) < 1e-8


def test_several_loss_factors_are_one_factor_that_goes_with_the_stiffness():
    found = plate(1e9, loss=0.05)
    assert "loss_factor[panel]" not in labels(found)
    values = found.values.copy()
    for name, factor in (("stiffness[panel]", 2.0), ("structural_damping[panel]", 3.0)):
        values[labels(found).index(name)] = factor
    whole = plate(None, loss=0.05)
    for kind, factor in (("stiffness", 2.0), ("structural_damping", 6.0)):
        own = whole.values.copy()
        legs = np.array([label.endswith("[legs]") for label in labels(whole)])
        expected = factor * whole.matrix(kind, np.where(legs, 0.0, own)).toarray()
        panel = values.copy()
        panel[[i for i, label in enumerate(labels(found)) if label.endswith("[legs]")]] = 0.0
        one = np.sort(
            linalg.eigh(found.matrix(kind, panel).toarray(), found.matrix("mass").toarray(), eigvals_only=True)
        )
        other = np.sort(linalg.eigh(expected, whole.matrix("mass").toarray(), eigvals_only=True))
        assert one[6:] == pytest.approx(other[6:], rel=1e-6)


def test_derivatives_of_its_factors_and_of_springs_are_differences():
    structure = plate(120.0, loss=0.03, more=[Dashpot("damper", "30Z", viscous_damping=40.0)])
    names = [("stiffness", "legs"), ("mass", "panel"), ("stiffness", "panel"), ("structural_damping", "panel")]
    unknown = parameters(structure, [Unknown(*name) for name in [*names, ("viscous_damping", "damper")]])
    lines = np.linspace(3.0, 60.0, 7)
    record = FrfRecord(lines, np.ones((7, 2, 1)), ["16Z", "3RX"], ["1Z"], "accelerance")
    made = response(structure, unknown, record)
    _, found = made.derivatives_at(unknown.start)
    for i, start in enumerate(unknown.start):
        step = np.zeros(unknown.n_params)
        step[i] = 1e-5 * start
        change = (made.values_at(unknown.start + step) - made.values_at(unknown.start - step)) / (2e-5 * start)
        assert apart(found[..., i], change) < 1e-6


def test_an_interface_that_does_not_hold_it_serves_too():
    """A plate that hangs on one spring: it swings about it without force."""
    nodes = plate(None).nodes
    left, right = plate(None).elements[:2]
    spring = Spring("wire", "1Z", stiffness=2e4)
    whole = Structure(nodes, [left, right, spring], active=WAYS)
    found = replace(whole, components=(Component("panel", ["left", "right"], 300.0),))
    values = [
        linalg.eigh(s.matrix("stiffness").toarray(), s.matrix("mass").toarray(), eigvals_only=True)
        for s in (found, whole)
    ]
    assert np.abs(values[0][:2]).max() < 1e-7 * values[1][2]
    assert values[0][2:8] == pytest.approx(values[1][2:8], rel=1e-6)


def test_massless_degrees_of_freedom_inside_follow_exactly():
    """Springs in a row with masses at the ends and amid: all that has no mass is left out."""
    nodes = {k: float(k) for k in range(1, 8)}
    row = Spring("row", [f"{k}X" for k in range(1, 7)], [f"{k}X" for k in range(2, 8)], stiffness=range(1, 7))
    sets = [row, PointMass("amid", [4], 2.0), PointMass("ends", [1, 7], 3.0), Spring("ground", "1X", stiffness=2.0)]
    whole = Structure(nodes, sets, active=["X"])
    found = replace(whole, components=(Component("chain", ["row", "amid"], 1e3),))
    assert {str(dof.unsigned) for dof in found.dofs} >= {"1X+", "7X+"}
    assert found.n_dofs == 3
    pair = [receptance(s, ["2X", "4X", "6X"], ["1X"], [0.01, 0.2]) for s in (found, whole)]
    assert apart(*pair) < 1e-12


def test_ties_and_supports_and_sensors_keep_their_places():
    """A rigid link to nodes of it and supports amid it; a sensor that only reads it is no part of its interface."""
    link = RigidLink("plate to block", 40, [12, 18])
    sensor = AimedSensor("sensor 50Z", "50Z", 50, "Z", 16, (0.0, 0.6, 0.8))
    nodes = {**plate(None).nodes, 40: np.array([1.2, 0.5, 0.0]), 50: np.array([0.6, 0.4, 0.0])}
    whole = Structure(
        nodes,
        [*plate(None).elements, PointMass("block", [40], 2.0)],
        ["8Z", "9RX"],
        [link, sensor],
        active=WAYS,
    )
    found = replace(whole, components=(Component("panel", ["left", "right"], 300.0),))
    at_sensor = replace(whole, components=(Component("panel", ["left", "right"], 300.0, "50Z"),))
    assert at_sensor.reductions[0].n_interface == 1 + found.reductions[0].n_interface
    kept = {dof.node for dof in found.dofs}
    assert {40, 1, 6, 25} <= kept
    assert found.n_dofs < whole.n_dofs / 2
    assert found.reductions[0].n_interface == 3 + 6
    lines = np.array([4.0, 20.0])
    pair = [receptance(s, ["50Z", "12RX", "16Z"], ["40Z"], lines) for s in (found, whole)]
    assert apart(*pair) < 1e-7


def test_nodes_that_others_follow_are_its_interface():
    """A block on an arm at node 12: the mass follows a node of the component."""
    nodes = {**plate(None).nodes, 40: np.array([1.2, 0.5, 0.0])}
    block = PointMass("block", [40], 2.0)
    whole = Structure(nodes, [*plate(None).elements, block], ties=[RigidLink("arm", 12, 40)], active=WAYS)
    found = replace(whole, components=(Component("panel", ["left", "right"], 300.0),))
    assert found.reductions[0].n_interface == 3 + 3
    assert {"12Z+", "12RX+", "12RY+"} <= {str(dof) for dof in found.dofs}
    pair = [receptance(s, ["40Z", "16Z"], ["40Z"], [4.0, 20.0]) for s in (found, whole)]
    assert apart(*pair) < 1e-7


def frame(**options) -> Structure:
    """A portal whose girder is a component of three beams in pieces, with a joint at each end."""
    nodes = {1: (0.0, 0.0), 2: (0.0, 3.0), 3: (1.0, 3.0), 4: (3.0, 3.0), 5: (4.0, 3.0), 6: (4.0, 0.0)}
    sets = [
        Beam("columns", [[1, 2], [6, 5]], 20.0, 1e6, 1e8, loss_factor=0.02),
        Beam("girder", [[2, 3], [3, 4], [4, 5]], 30.0, 2e6, 2e8, loss_factor=0.02),
        Joint("corner", "girder:1", "2RZ", 3e6),
        Joint("inner", "girder:2", "3RZ", 3e6, 0.02),
    ]
    return Structure(nodes, sets, ["1X", "1Y", "1RZ", "6X", "6Y", "6RZ"], subdivide=4, **options)


def test_lines_in_pieces_and_joints_in_and_beside_it():
    whole = frame()
    found = frame(components=(Component("beam", ["girder", "inner"], 500.0),))
    assert found.n_dofs < 0.8 * whole.n_dofs
    pair = [receptance(s, ["3Y", "4RZ", "2X"], ["2X"], [5.0, 20.0]) for s in (found, whole)]
    assert apart(*pair) < 1e-6
    assert found.mass_of() == pytest.approx(whole.mass_of(), rel=1e-12)


@pytest.mark.parametrize("supports", [[["1X", "6X"]], [["1X"], ["6X"]]])
def test_a_support_of_it_drives_the_structure(supports):
    """The table shakes columns that are components: the base is at their feet."""
    bases = [Base(f"table {k}", own) for k, own in enumerate(supports)]
    found = frame(bases=bases, components=(Component("legs", "columns", 300.0),))
    assert found.n_dofs < frame().n_dofs
    record = FrfRecord(np.array([3.0, 9.0, 15.0]), np.ones((3, 2, 1)), ["2X", "4Y"], ["1X"], "transmissibility")
    pair = []
    for structure in (found, frame(bases=bases)):
        unknown = parameters(structure, [Unknown("stiffness", "corner")])
        pair.append(response(structure, unknown, record).values_at(unknown.start))
    assert apart(*pair) < 1e-8


def test_matrices_of_another_code_are_a_component_too():
    whole = plate(None)
    panel = Structure(whole.nodes, whole.elements[:2], active=WAYS)
    group = MatrixGroup(
        "imported", panel.dofs, mass=panel.matrix("mass"), stiffness=panel.matrix("stiffness"), loss_factor=0.01
    )
    made = Structure(whole.nodes, [group, whole.elements[2]], active=WAYS)
    found = replace(made, components=(Component("panel", "imported", 200.0),))
    pair = [receptance(s, ["16Z"], ["1Z"], [7.0, 33.0]) for s in (found, plate(200.0))]
    assert apart(*pair) < 1e-8


def test_two_components_meet_at_their_interface():
    whole = plate(None)
    found = replace(whole, components=(Component("a", "left", 800.0), Component("b", "right", 800.0)))
    small, large = (modes(s.matrix("mass"), s.matrix("stiffness"), n_modes=8).frequency for s in (found, whole))
    assert small == pytest.approx(large, rel=1e-4)


def test_it_travels_and_shows():
    found = pickle.loads(pickle.dumps(plate(120.0)))
    assert found.dofs == plate(120.0).dofs
    assert [row[0] for row in found.overview().rows] == ["legs", "panel"]


@pytest.mark.parametrize(
    ("change", "fragment"),
    [
        ({"elements": []}, "component 'panel' has no element sets"),
        ({"up_to": 0.0}, "`up_to` of component 'panel' must be a frequency above 0"),
        ({"elements": ["left", "rihgt"]}, "component 'panel': there is no element set 'rihgt'; the nearest is 'right'"),
        ({"interface": "15X"}, "15X of `interface` is no degree of freedom of it; the nearest is 15Z"),
        ({"elements": ["left", "right", "legs"]}, "component 'panel' has no interface: nothing else"),
        ({"elements": "legs"}, "component 'panel' has no degrees of freedom inside: all 3 belong"),
        ({"name": "legs"}, "two parts of the structure are called 'legs'"),
    ],
)
def test_what_cannot_be_a_component_is_refused(change, fragment):
    given = {"name": "panel", "elements": ["left", "right"], "up_to": 100.0, **change}
    with pytest.raises(InputError, match=fragment):
        replace(plate(None), components=(Component(**given),))


def test_two_components_of_one_set_friction_sliding_and_mechanisms_are_refused():
    whole = plate(None)
    with pytest.raises(InputError, match="element set 'left' is in component 'a' already"):
        replace(whole, components=(Component("a", "left", 9.0), Component("b", ["right", "left"], 9.0)))
    rubbing = plate(None, more=[Friction("pad", "9Z", friction_force=1.0)])
    with pytest.raises(InputError, match="component 'a': element set 'pad' rubs"):
        replace(rubbing, components=(Component("a", ["left", "right", "pad"], 9.0),))
    line = Structure({1: 0.0, 2: 1.0, 3: 2.0}, [Beam("beam", [[1, 2], [2, 3]], 1.0, 1.0)], sliding=[2])
    with pytest.raises(InputError, match="element set 'beam' has an end that slides"):
        replace(line, components=(Component("a", "beam", 9.0, "1Y"),))
    made = Beam("beam", [[1, 2], [2, 3]], 1.0, 1.0, tolerance={"length": 0.01})
    with pytest.raises(InputError, match="element set 'beam' has a `tolerance` of its length"):
        replace(Structure({1: 0.0, 2: 1.0, 3: 2.0}, [made]), components=(Component("a", "beam", 9.0, "1Y"),))
    row = Spring("row", ["1X", "2X"], ["2X", "4X"], stiffness=[1.0, 0.0])
    sets = [row, PointMass("ends", [1, 4], 1.0), Dashpot("oil", "3X", "2X", viscous_damping=1.0)]
    loose = Structure({k: float(k) for k in (1, 2, 3, 4)}, sets, active=["X"])
    with pytest.raises(InputError, match="component 'a' can move inside with neither stiffness nor mass"):
        replace(loose, components=(Component("a", ["row", "oil"], 9.0),))


def test_a_plan_takes_places_amid_it():
    found = plate(120.0)
    options = PlanOptions(frequency=(5.0, 10.0), relative_noise=0.01)
    places = resolve_options(found, parameters(found, [Unknown("stiffness", "legs")]), options).sensors
    assert [str(dof) for dof in places] == [f"{node}Z+" for node in sorted(found.nodes)]


def test_an_unknown_inside_is_refused_with_the_remedy():
    found = plate(120.0)
    with pytest.raises(
        InputError, match=r"element set 'left' is in component 'panel', .* take it out of the `elements`"
    ):
        parameters(found, [Unknown("youngs_modulus", "left")])
    with pytest.raises(InputError, match="element set 'left' is in component"):
        parameters(found, [Unknown("youngs_modulus", "left:1-3", each=True)])
    unknown = parameters(found, [Unknown("stiffness", ["panel", "legs"], each=True)])
    assert unknown.names == ("stiffness[panel]", "stiffness[legs:1]", "stiffness[legs:2]", "stiffness[legs:3]")
    assert penalty(found, unknown, Smoothness("stiffness", ["panel", "legs"])) is not None


def test_what_truncation_changes_is_told_with_a_remedy_where_it_is_much():
    lines = np.linspace(3.0, 60.0, 60)
    record = FrfRecord(lines, np.ones((60, 2, 1)), ["16Z", "1Z"], ["9Z"], "accelerance")

    def seen(structure):
        problem = FrfProblem(structure, parameters(structure, [Unknown("stiffness", "legs")]), record, model_error=0.1)
        return frf_truncation(problem, problem.theta_start)

    assert seen(plate(None)) is None
    much, little = seen(plate(100.0)), seen(plate(400.0, interface="9Z"))
    assert little.error < 1e-4 < 1e-3 < much.error
    assert little.warning == ""
    assert "raise `up_to` of the component, or name where it is loaded in its `interface`" in much.warning
    whole, few = plate(None), plate(70.0)
    exact = receptance(whole, ["16Z", "1Z"], ["9Z"], lines)
    found = receptance(plate(100.0), ["16Z", "1Z"], ["9Z"], lines)
    worst = np.abs(found - exact).max(axis=(1, 2)) / np.abs(exact).max(axis=(1, 2))
    assert much.error <= worst.max() * 1.001
    assert np.isclose(much.error, worst, rtol=1e-4).any()
    told = modes_truncation(few, few.values, 60.0)
    pair = [modes(s.matrix("mass"), s.matrix("stiffness"), n_modes=20).frequency for s in (few, whole)]
    inside = np.flatnonzero(pair[0] <= 60.0)
    assert told.error == pytest.approx((pair[0][inside] / pair[1][inside] - 1).max(), rel=1e-3)
    assert modes_truncation(few, few.values, 500.0).words == modes_truncation(few, few.values, 70.0).words
    assert modes_truncation(whole, whole.values, 60.0) is None
    assert "no mode in the band" in modes_truncation(few, few.values, 0.01).words
