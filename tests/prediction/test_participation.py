"""Effective masses against closed forms, their deviation against differences, and what the command writes."""

import numpy as np
import pytest
from scipy import linalg

import structid as sid
from structid.prediction.identified_model import identified_model


def tower(stiffness=(3e5, 2e5, 1e5), std=0.0):
    """Three storeys; the second stiffness is uncertain by the part `std`."""
    spring = sid.Spring("storey", ["0X", "1X", "2X"], ["1X", "2X", "3X"], stiffness=list(stiffness), tolerance=0)
    floors = sid.PointMass("floor", [1, 2, 3], [30.0, 20.0, 10.0], tolerance=0)
    structure = sid.Structure({i: float(i) for i in range(4)}, [floors, spring], ["0X"], active=["X"])
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", "storey:2")])
    return identified_model(structure, parameters, parameters.start, np.array([[(stiffness[1] * std) ** 2]]))


def parts_of(stiffness):
    """Effective masses of the tower over its mass, from its eigenvectors."""
    a, b, c = stiffness
    mass = np.diag([30.0, 20.0, 10.0])
    shapes = linalg.eigh(np.array([[a + b, -b, 0], [-b, b + c, -c], [0, -c, c]]), mass)[1]
    return (shapes.T @ mass @ np.ones(3)) ** 2 / 60.0


def test_effective_masses_are_those_of_the_eigenvectors_and_add_up_to_the_mass():
    found = sid.predict(tower(), sid.ModalParticipation("X", 3), n_draws=50)
    assert found.values[:, 2] == pytest.approx(parts_of((3e5, 2e5, 1e5)), rel=1e-9)
    assert found.values[:, 1].sum() == pytest.approx(60.0)
    assert found.values[:, 0] ** 2 == pytest.approx(found.values[:, 1])
    assert found.std.max() <= 1e-9


def test_parts_of_a_clamped_beam_are_the_published_ones():
    """A uniform cantilever on ground that moves across it: 0.613, 0.188, 0.065 (Chopra, Dynamics of Structures, table 17.3.1)."""
    n = 40
    beam = sid.Beam("mast", [[i, i + 1] for i in range(n)], 6.0, 2000.0, tolerance=0)
    structure = sid.Structure({i: 3.0 * i / n for i in range(n + 1)}, [beam], ["0Y", "0RZ"])
    parameters = sid.parameters(structure, [sid.Unknown("bending_stiffness", "mast")])
    model = identified_model(structure, parameters, parameters.start, np.array([[200.0**2]]))
    found = sid.predict(model, sid.ModalParticipation("Y", 3), n_draws=50)
    assert found.values[:, 2] == pytest.approx([0.613, 0.188, 0.065], abs=6e-4)
    assert found.values[:, 1] == pytest.approx(18.0 * found.values[:, 2])  # all mass counts, that on the support too
    assert found.std[:, 2].max() <= 1e-6  # one stiffness for all changes no shape


def test_the_deviation_is_that_of_the_parameter():
    std = 0.03
    found = sid.predict(tower(std=std), sid.ModalParticipation("X", 3), n_draws=1000, seed=4)
    slope = (parts_of((3e5, 2e5 * 1.001, 1e5)) - parts_of((3e5, 2e5 * 0.999, 1e5))) / 0.002
    assert found.std[:, 2] == pytest.approx(std * np.abs(slope), rel=0.1)


def test_close_modes_share_their_mass_and_their_sum_is_told():
    """Two equal towers across each other, weakly coupled: small changes turn their modes into each other."""
    n, std = 3, 0.02
    springs = [
        sid.Spring(
            f"storey{axis}",
            [f"{i}{axis}" for i in range(n)],
            [f"{i + 1}{axis}" for i in range(n)],
            stiffness=[1e5] * n,
            tolerance=0,
        )
        for axis in "XY"
    ]
    between = sid.Spring("between", ["2X"], ["2Y"], stiffness=[1e-3], tolerance=0)
    floors = sid.PointMass("floor", list(range(1, n + 1)), 10.0, tolerance=0)
    nodes = {i: (0.0, 0.0, float(i)) for i in range(n + 1)}
    structure = sid.Structure(nodes, [*springs, between, floors], ["0X", "0Y"], active=["X", "Y"])
    parameters = sid.parameters(structure, [sid.Unknown("stiffness", f"storey{axis}:2") for axis in "XY"])
    model = identified_model(structure, parameters, parameters.start, np.diag((std * parameters.start) ** 2))
    found = sid.predict(model, sid.ModalParticipation("X", 2 * n), n_draws=50)
    parts = found.draws[:, :, 2]
    assert found.std[0, 2] > 0.3  # either of the first two has the mass of both
    assert parts.sum(axis=1) == pytest.approx(np.ones(50))
    first = parts[:, :2].sum(axis=1)
    assert first == pytest.approx(np.full(50, found.values[:2, 2].sum()), abs=0.02)


def test_a_change_is_followed_and_directions_without_mass_are_told():
    told = sid.predict_change(tower(), sid.ModalParticipation("X", 3), [sid.AddMass(3, 5.0)], n_draws=50)
    assert told.after.values[:, 1].sum() == pytest.approx(65.0)
    assert told.difference.values[:, 1].sum() == pytest.approx(5.0)
    with pytest.raises(sid.InputError, match="no mass moves along Y"):
        sid.predict(tower(), sid.ModalParticipation("Y", 3), n_draws=50)
    with pytest.raises(sid.InputError, match="must be one of X, Y, Z"):
        sid.ModalParticipation("RX")


def test_fewer_modes_than_asked_for_have_as_many_labels_as_rows():
    for quantity in (sid.ModalParticipation("X", 10), sid.NaturalModes(10)):
        found = sid.predict(tower(), quantity, n_draws=50)
        assert found.quantity.axes["mode"] == ("1", "2", "3")
        assert len(found.values) == 3
        assert " of 3 modes, " in str(found)


@pytest.mark.parametrize("count", [0, -1, 1.5, "3"])
def test_a_number_of_modes_is_a_whole_one_of_at_least_1(count):
    for make in (lambda: sid.ModalParticipation("X", count), lambda: sid.NaturalModes(count)):
        with pytest.raises(sid.InputError, match="`n_modes` must be a whole number of at least 1, got"):
            make()
