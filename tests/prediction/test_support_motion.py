"""Moving supports against a large mass under a force, two masses on a moving ground, and the quasi-static motion of a beam."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import structid as sid
from structid.core.errors import InputError
from structid.dynamics import sampled_transient
from structid.fem import Base
from structid.prediction.identified_model import identified_model
from structid.prediction.linear_response import support_base
from structid.prediction.options import PredictOptions
from structid.prediction.quantities import support_acceleration
from structid.report.prediction import heading
from structid.study.run.predicting import StudyPrediction, _history, kind_under

RATE = 400.0


def model_of(structure):
    """A model that is known exactly."""
    item = next(item for item in structure.properties if item.term.kind == "stiffness")
    parameters = sid.parameters(structure, [sid.Unknown(item.term.property, item.element)])
    return identified_model(structure, parameters, parameters.start, np.zeros((1, 1)))


def storeys(**options):
    """Two masses of 2 and 1 kg on bars of 900 and 400 N/m and on a dashpot between them; the ground is node 0."""
    parts = [
        sid.PointMass("m", [1, 2], mass=[2.0, 1.0]),
        sid.Bar("bars", [[0, 1], [1, 2]], mass=0.0, axial_stiffness=[900.0, 400.0], stiffness_damping=[5.0, 2.0]),
    ]
    return sid.Structure({0: 0.0, 1: 1.0, 2: 2.0}, parts, fixed=["0X"], active=["X"], **options)


def shaking(n=800):
    t = np.arange(n) / RATE
    return (np.sin(9 * t) * np.sin(np.pi * t / t[-1]) ** 2)[:, None]


def history(model, outputs, inputs, loads, motion="acceleration", relative=False):
    return sid.predict(model, sid.History(outputs, inputs, loads, RATE, motion, relative), n_draws=50).values


def test_two_storeys_on_a_moving_ground():
    """Chopra (2017), Dynamics of Structures, Eq. 9.4.4: M u'' + C u' + K u = -M 1 a for motion u against the ground."""
    m, k, c = np.diag([2.0, 1.0]), np.array([[1300.0, -400], [-400, 400]]), np.array([[7.0, -2], [-2, 2]])
    a = shaking()
    relative = sampled_transient(m, k, -m @ np.ones((2, 1)), a, RATE, c)
    ground = Base("ground", ["0X"])
    found = history(model_of(storeys()), ["1X", "2X"], [ground], a, "displacement", relative=True)
    assert found == pytest.approx(relative.displacement, abs=2e-4 * np.abs(relative.displacement).max())
    whole = history(model_of(storeys()), ["1X", "2X", "0X"], [ground], a)
    assert whole[:, :2] == pytest.approx(relative.acceleration + a, abs=2e-3 * np.abs(whole).max())
    assert whole[:, 2] == pytest.approx(a[:, 0], abs=1e-9)
    shear = history(model_of(storeys()), ["N[bars:1@1]"], [ground], a)[:, 0]
    expected = 900 * relative.displacement[:, 0] + 5 * relative.velocity[:, 0]
    assert shear == pytest.approx(expected, abs=1e-3 * np.abs(expected).max())


def frame():
    """A beam on two supports of its own and a clamped foot, which damps and has mass down to the ground."""
    beam = sid.Beam(
        "beam",
        [[i, i + 1] for i in range(6)],
        mass=3.0,
        bending_stiffness=60.0,
        stiffness_damping=0.3,
        mass_damping=0.4,
    )
    return sid.Structure({i: 0.3 * i for i in range(7)}, [beam], fixed=["0Y", "0RZ", "6Y"])


@pytest.mark.parametrize("supports", [["0Y", "6Y"], ["6Y"]], ids=["together", "alone"])
def test_moved_supports_are_those_of_a_large_mass(supports):
    structure, base, heavy = frame(), Base("moved", supports), 1e7
    parts = [*structure.elements, sid.PointMass("large", [6], mass=heavy)]
    ties = [sid.Constraint("one", "0Y", [("6Y", 1.0)])] if len(supports) == 2 else []
    fixed = ["0RZ"] if ties else ["0Y", "0RZ"]
    loose = sid.Structure(structure.nodes, parts, fixed=fixed, ties=ties)
    a, dofs = shaking(), [str(dof) for dof in loose.dofs]
    m, k, c = (loose.matrix(law).toarray() for law in ("mass", "stiffness", "damping"))
    push = heavy * np.array([[float(dof == "6Y+")] for dof in dofs])
    exact = sampled_transient(m, k, push, a, RATE, c)
    outputs = ["2Y", "4RZ", "5Y"]
    index = [dofs.index(f"{dof}+") for dof in outputs]
    for motion in ("displacement", "velocity", "acceleration"):
        found = history(model_of(structure), outputs, [base], a, motion)
        table = getattr(exact, motion)[:, index]
        assert found == pytest.approx(table, abs=1e-3 * np.abs(table).max())


def test_a_support_that_moves_slowly_bends_the_beam_quasi_statically():
    """A clamped and simply supported span L whose far support moves by d: the clamp has the moment 3 EI d / L^2."""
    t = np.arange(4000) / RATE
    d = 0.5 * (1 - np.cos(np.pi * t / t[-1]))[:, None]
    a = support_acceleration(d, RATE)
    found = history(model_of(frame()), ["M[beam:1@0]"], [Base("far", ["6Y"])], a)
    assert found[-1, 0] == pytest.approx(3 * 60.0 / 1.8**2, rel=0.02)
    moved = history(model_of(frame()), ["6Y", "3Y"], [Base("far", ["6Y"])], a, "displacement")
    assert moved[:, 0] == pytest.approx(d[:, 0], abs=1e-5)
    beyond = history(model_of(frame()), ["3Y"], [Base("far", ["6Y"])], a, "displacement", relative=True)
    xi = 0.5
    assert moved[-1, 1] - beyond[-1, 0] == pytest.approx((3 * xi**2 - xi**3) / 2, rel=1e-4)


@pytest.mark.parametrize("is_filtered", [False, True])
def test_a_file_of_forces_and_displacements_is_filtered_where_it_holds_forces(tmp_path, is_filtered):
    """Displacements follow their spline either way; forces are those of a filtered record where this is said."""
    rng = np.random.default_rng(1)
    way, force = 1e-3 * np.cumsum(shaking(), axis=0)[:, 0], rng.standard_normal(800)
    way -= way[0]
    record = sid.TimeRecord(RATE, np.column_stack([way, force]), ["0X", "2X"], ["displacement", "force"])
    sid.write_record(tmp_path / "loads.h5", record)
    options = PredictOptions(history=tmp_path / "loads.h5", filtered=is_filtered)
    model, outputs = model_of(storeys()), (sid.parse_dof("1X"),)
    quantity, words = _history(model.structure, outputs, options)
    between = "band-limited" if is_filtered else "in straight lines"
    spline = "displacements of supports along a cubic spline through the samples"
    assert words == f"loads of loads.h5, {spline}, all others {between} between samples; 0X+ moves"
    assert quantity.is_filtered == (False, is_filtered)
    a, ground = support_acceleration(way[:, None], RATE), Base("ground", ["0X"])
    each = [
        sid.History(["1X"], [ground], a, RATE),
        sid.History(["1X"], ["2X"], force[:, None], RATE, is_filtered=is_filtered),
    ]
    together, *alone = (sid.predict(model, one, n_draws=50).values for one in (quantity, *each))
    assert together == pytest.approx(sum(alone), abs=1e-9 * np.abs(together).max())
    with pytest.raises(InputError, match="one for each of 2 inputs, got 1"):
        sid.History(["1X"], [ground, "2X"], quantity.loads, RATE, is_filtered=[True])


def test_each_input_is_filtered_or_not_and_nothing_else():
    loads = np.ones((8, 2))

    def filtered(value):
        return sid.History(["1X"], ["1X", "2X"], loads, RATE, is_filtered=value).is_filtered

    assert filtered(np.True_) == (True, True)
    assert filtered(np.array([False, True])) == (False, True)
    assert all(type(value) is bool for value in filtered(np.array([False, True])))
    for wrong in ([0, 1], [1, 1], [2, 2], 1, None, "no", np.array([0, 1])):
        with pytest.raises(
            InputError, match="`is_filtered` must be True or False, or one of them for each of 2 inputs"
        ):
            filtered(wrong)
    with pytest.raises(InputError, match="one for each of 2 inputs, got 3"):
        filtered([True, False, True])


def test_a_file_of_displacements_alone_cannot_be_filtered(tmp_path):
    way = np.cumsum(shaking(), axis=0)[:, :1]
    sid.write_record(tmp_path / "way.h5", sid.TimeRecord(RATE, way - way[0], ["0X"], ["displacement"]))
    options = PredictOptions(history=tmp_path / "way.h5", filtered=True)
    with pytest.raises(InputError, match=r"way\.h5: 0X\+ is a displacement, .* leave `filtered` out") as caught:
        _history(model_of(storeys()).structure, (sid.parse_dof("1X"),), options)
    assert caught.value.option == "filtered"


def test_motion_per_motion_of_a_support_is_that_of_one_mass():
    """(k + i w c) / (k + i w c - w^2 m), and the force in its bar per acceleration of the ground."""
    parts = [
        sid.PointMass("m", [1], mass=2.0),
        sid.Bar("bars", [[0, 1]], mass=0.0, axial_stiffness=900.0, stiffness_damping=6.0),
    ]
    structure = sid.Structure({0: 0.0, 1: 1.0}, parts, fixed=["0X"], active=["X"])
    frequency = np.linspace(0.5, 8, 30)
    w = 2 * np.pi * frequency
    held = 900 + 6j * w
    exact = held / (held - 2 * w**2)
    base, model = Base("ground", ["0X"]), model_of(structure)
    found = sid.predict(model, sid.Frf(["1X"], [base], frequency, "transmissibility"), n_draws=50)
    assert found.values[:, 0, 0] == pytest.approx(exact, rel=1e-8)
    force = sid.predict(model, sid.Frf(["N[bars:1@1]"], [base], frequency, "transmissibility"), n_draws=50)
    assert force.values[:, 0, 0] == pytest.approx(-2.0 * exact, rel=1e-8)
    assert force.quantity.unit == "(N)/(m/s^2)"
    modes = sid.predict(model, sid.NaturalModes(1), n_draws=50)
    shown = StudyPrediction(Path("results"), "mass", modes, found, None, None, ())
    assert heading(shown) == "transmissibilities (motion per motion of the supports) and modes predicted from results"


def test_force_per_motion_is_refused_where_supports_move():
    ground, load = Base("ground", ["0X"]), sid.parse_dof("1X")
    assert kind_under([ground], "accelerance") == kind_under([ground], "transmissibility") == "transmissibility"
    assert kind_under([load], "receptance") == "receptance"
    for kind in ("receptance", "mobility"):
        with pytest.raises(InputError, match=f"where a support moves, as 0X\\+ does, got {kind}; leave it out"):
            kind_under([ground], kind)


def test_damping_of_all_modes_is_of_motion_against_the_ground():
    parts = [sid.PointMass("m", [1], mass=2.0), sid.Bar("bars", [[0, 1]], mass=0.0, axial_stiffness=800.0)]
    structure = sid.Structure({0: 0.0, 1: 1.0}, parts, fixed=["0X"], active=["X"], damping_ratio=0.05)
    a = shaking()
    solved = solve_ivp(
        lambda t, y: [y[1], -np.interp(t, np.arange(len(a)) / RATE, a[:, 0]) - 2.0 * y[1] - 400.0 * y[0]],
        (0, (len(a) - 1) / RATE), [0, 0], t_eval=np.arange(len(a)) / RATE, rtol=1e-8, atol=1e-10,
    )  # fmt: skip
    found = history(model_of(structure), ["1X"], [Base("ground", ["0X"])], a, "displacement", relative=True)
    assert found[:, 0] == pytest.approx(solved.y[0], abs=1e-5 * np.abs(solved.y[0]).max())


def test_supports_that_move_are_found_by_name_and_what_cannot_move_is_named():
    structure = frame()
    assert [str(dof) for dof in support_base(structure, sid.parse_dof("6Y")).supports] == ["6Y+", "0Y+"]
    assert [str(dof) for dof in support_base(structure, sid.parse_dof("6Y-"), together=False).supports] == ["6Y-"]
    with pytest.raises(InputError, match="3Y\\+ cannot be moved: it is no support"):
        support_base(structure, sid.parse_dof("3Y"))
    with pytest.raises(InputError, match="must begin at 0"):
        support_acceleration(np.ones((10, 1)), RATE)
    with pytest.raises(InputError, match="no input is a base"):
        sid.History(["3Y"], ["2Y"], np.ones((5, 1)), RATE, relative=True)
    with pytest.raises(InputError, match="of kind transmissibility"):
        sid.Frf(["3Y"], [Base("far", ["6Y"])], [1.0])
    parts = [sid.PointMass("m", [1, 2], mass=1.0), sid.Bar("bars", [[0, 1]], mass=0.0, axial_stiffness=9.0)]
    hanging = sid.Structure({0: 0.0, 1: 1.0, 2: 2.0}, parts, fixed=["0X"], active=["X"])
    with pytest.raises(InputError, match="rigid body even with its supports"):
        history(model_of(hanging), ["1X"], [Base("ground", ["0X"])], shaking())


def test_a_change_is_shown_as_a_table_and_loads_are_not_printed():
    change = sid.predict_change(model_of(storeys()), sid.NaturalModes(2), [sid.AddMass(2, 0.5)], n_draws=50)
    assert repr(change) == "<PredictedChange: NaturalModes before and after a change, Hz, 1>"
    shown = change.overview()
    assert [row[0] for row in shown.rows] == ["1 frequency", "1 damping ratio", "2 frequency", "2 damping ratio"]
    values = (change.before.values[1, 0], change.after.values[1, 0], change.difference.values[1, 0])
    assert [float(cell) for cell in shown.rows[2][1:4]] == pytest.approx(values, rel=1e-2)
    assert len(repr(sid.History(["1X"], ["2X"], np.zeros((5000, 1)), RATE))) < 300
