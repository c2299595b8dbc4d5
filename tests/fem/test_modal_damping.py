"""One damping ratio in all modes: its matrix, and how it changes with every mass and stiffness."""

import numpy as np
import pytest
from scipy import linalg

from structid import (
    Base,
    Beam,
    Component,
    Dashpot,
    InputError,
    MatrixGroup,
    Plate,
    PointMass,
    Spring,
    Structure,
)
from structid.core.errors import SingularModelError
from structid.fem import modal_damping as module
from structid.identification.record_fit import structure_modes
from structid.report.identification_tables import structure_facts

LINE = {i: 0.5 * i for i in range(6)}
PAIRS = [[i, i + 1] for i in range(5)]


def beam(ratio=0.02, held=("0Y", "0RZ"), mass=2.0, shear=9e4, **options):
    """A beam with masses, some of whose properties multiply several matrices."""
    sets = [
        Beam("beam", PAIRS, mass, [1e3, 1.2e3, 0.7e3, 1e3, 1e3], shear_stiffness=shear, loss_factor=0.01),
        PointMass("masses", [2, 4, 5], [1.0, 2.0, 1.5], directions=["Y"]),
        Spring("end", "5Y", stiffness=500.0),
        Dashpot("damper", "3Y", viscous_damping=3.0),
    ]
    return Structure(LINE, sets, held, active=["Y", "RZ"], damping_ratio=ratio, **options)


def strip(**options):
    nodes = {1: (0, 0), 2: (0.3, 0.0), 3: (0.6, 0.05), 4: (0.0, 0.4), 5: (0.3, 0.45), 6: (0.6, 0.5)}
    plate = Plate("plate", [[1, 2, 5, 4], [2, 3, 6, 5]], 7e10, 2700.0, [2e-3, 3e-3], 0.3)
    return Structure(nodes, [plate], ["1Z", "1RX", "1RY", "4Z"], damping_ratio=0.03, **options)


def textbook(structure, ratio, values=None):
    """M Phi (2 zeta Omega) Phi' M."""
    mass, stiffness = (structure.matrix(kind, values).toarray() for kind in ("mass", "stiffness"))
    squares, shapes = linalg.eigh(stiffness, mass)
    return mass @ shapes @ np.diag(2 * ratio * np.sqrt(np.maximum(squares, 0))) @ shapes.T @ mass


def damping_of(structure, values=None):
    """What modal damping adds to the viscous matrix."""
    part = structure.contributions[-1]
    return part.blocks.assemble(part.weights(structure.values if values is None else values)).toarray()


@pytest.mark.parametrize("structure", [beam(), strip()], ids=["beam", "plate"])
def test_the_matrix_is_that_of_the_textbook_at_any_values(structure):
    ratio = structure.values[-1]
    moved = structure.values * np.random.default_rng(3).uniform(0.6, 1.5, len(structure.values))
    for values in (structure.values, moved):
        expected = textbook(structure, values[-1], values)
        assert damping_of(structure, values) == pytest.approx(expected, abs=1e-10 * np.abs(expected).max())
    assert structure.properties[-1].label == "damping_ratio[all modes]"
    assert f"damping ratio {ratio:g} of all modes" in str(structure)


def test_every_mode_has_the_damping_ratio_and_more_where_elements_damp():
    bare = Structure(LINE, [Beam("beam", PAIRS, 2.0, 1e3)], ["0Y", "0RZ"], active=["Y", "RZ"], damping_ratio=0.05)
    assert structure_modes(bare, bare.values, 8).damping_ratio == pytest.approx(0.05, rel=1e-8)
    both = beam()
    assert (structure_modes(both, both.values, 4).damping_ratio > 0.02 + 0.005 - 1e-9).all()  # and half the loss factor


SLOPES = {
    "beam": beam(),
    "plate with thicknesses": strip(),
    "free beam": beam(held=()),
    "massless turns": beam(mass=0.0),
    "a node that slides": beam(shear=None, sliding=[2]),
    "component": strip(components=[Component("all", "plate", 500.0, "6Z")]),
}


@pytest.mark.parametrize("structure", SLOPES.values(), ids=SLOPES.keys())
def test_slopes_are_differences_of_the_matrix(structure):
    part, values = structure.contributions[-1], structure.values
    largest = np.abs(part.weights(values)).max()
    for number, place in enumerate(part.value_indices):
        index = int(np.asarray(place).ravel()[0])
        step = 1e-4 * max(abs(values[index]), 0.0) or 1e-6
        move = step * np.eye(len(values))[index]
        if (values - 2 * move < 0).any():
            continue  # a mass of 0: damping changes with its root
        near, far = (part.weights(values + k * move) - part.weights(values - k * move) for k in (1, 2))
        difference = (8 * near - far) / (12 * step)
        assert part.slope(values, number) == pytest.approx(difference, abs=1e-6 * largest / max(abs(values[index]), 1))


def test_slopes_that_are_kept_cannot_be_changed():
    structure = beam()
    factor = structure.contributions[-1].scale
    kept = factor.slope(structure.values, 0)
    with pytest.raises(ValueError, match="read-only"):
        kept[0] = 1.0


def test_rigid_bodies_and_massless_motions_are_not_damped():
    free = Structure(LINE, [Beam("beam", PAIRS, 2.0, 1e3)], active=["Y", "RZ"], damping_ratio=0.1)
    damping = damping_of(free)
    turn = np.array([LINE[dof.node] if dof.direction == "Y" else 1.0 for dof in free.dofs])
    shift = np.array([float(dof.direction == "Y") for dof in free.dofs])
    for rigid in (turn, shift):
        assert np.abs(damping @ rigid).max() < 1e-6 * np.abs(damping).max()
    frame = beam(mass=0.0)
    massless = np.diag(frame.matrix("mass").toarray()) == 0
    assert massless.sum() == 7
    assert np.abs(damping_of(frame)[massless]).max() < 1e-6 * np.abs(damping_of(frame)).max()
    # as without them: the massless motions eliminated
    mass, stiffness = (frame.matrix(kind).toarray() for kind in ("mass", "stiffness"))
    follow = -np.linalg.solve(stiffness[np.ix_(massless, massless)], stiffness[np.ix_(massless, ~massless)])
    held = stiffness[np.ix_(~massless, ~massless)] + stiffness[np.ix_(~massless, massless)] @ follow
    squares, shapes = linalg.eigh(held, mass[np.ix_(~massless, ~massless)])
    scaled = mass[np.ix_(~massless, ~massless)] @ shapes
    expected = scaled @ np.diag(2 * 0.02 * np.sqrt(squares)) @ scaled.T
    assert damping_of(frame)[np.ix_(~massless, ~massless)] == pytest.approx(expected, abs=1e-9 * expected.max())


def test_what_modal_damping_cannot_be_of_is_named(monkeypatch):
    for wrong in (-0.1, 1.0, np.nan):
        with pytest.raises(InputError, match=r"`damping_ratio` must be at least 0 and less than 1, as 0.01 for 1 %"):
            beam(wrong)
    with pytest.raises(InputError, match="needs masses and stiffnesses"):
        Structure({1: 0.0}, [PointMass("m", 1, 1.0)], active=["X"], damping_ratio=0.01)
    with pytest.raises(InputError, match="two parts of the structure are called 'all modes'"):
        Structure({1: 0.0}, [PointMass("all modes", 1, 1.0)], active=["X"], damping_ratio=0.01)
    sets = [PointMass("m", [1, 2], [1.0, 0.0]), Spring("k", "1X", stiffness=1.0)]
    loose = Structure({1: 0.0, 2: 1.0}, sets, active=["X"], damping_ratio=0.01)
    with pytest.raises(SingularModelError, match="mass or stiffness in every motion"):
        loose.matrix("damping")
    base = Base("table", "0Y")
    with pytest.raises(InputError, match="base 'table' drives the structure, and modal damping"):
        beam(bases=[base]).release_supports((base,))
    monkeypatch.setattr(module, "_MOST_DOFS", 9)
    with pytest.raises(
        InputError, match=r"up to 9 degrees of freedom.* and the structure has 10 .*components, or use loss"
    ):
        beam()
    group = MatrixGroup("all", ["1X", "2X"], mass=np.eye(2), stiffness=[[2, -1], [-1, 2]])
    assert Structure({1: 0.0, 2: 1.0}, [group], active=["X"], damping_ratio=0.01).n_dofs == 2


def test_a_report_says_it():
    assert ("Damping ratio of all modes", "0.02") in structure_facts(beam())
    assert not any("Damping" in label for label, _ in structure_facts(beam(None)))
