"""Linearly dependent forces: histories are fitted with them, and FRFs are shown under independent joint forces."""

from dataclasses import replace

import numpy as np
import pytest

import structid as sid
from structid.core.dof import parse_dof
from structid.fem.measuring_points import joint_weights, with_joint_forces
from structid.forward import ResponseCache
from structid.identification.options import IdentifyOptions
from structid.records import TimeRecord
from structid.unknowns.tolerances import EXACT

RATE, ANGLE = 128.0, 0.5
LOADS = tuple(parse_dof(name) for name in ("3X", "3Y-"))


def floors():
    """Two masses on springs along X and Y."""
    nodes = {1: [0.0, 0.0], 2: [0.0, 1.0], 3: [0.0, 2.0]}
    springs = [
        sid.Spring(f"k{axis}", [f"1{axis}", f"2{axis}"], [f"2{axis}", f"3{axis}"], stiffness=stiffness)
        for axis, stiffness in (("X", [900.0, 700.0]), ("Y", [500.0, 600.0]))
    ]
    dashpots = [
        sid.Dashpot(f"c{axis}", [f"1{axis}", f"2{axis}"], [f"2{axis}", f"3{axis}"], viscous_damping=[1.5, 1.0])
        for axis in "XY"
    ]
    masses = sid.PointMass("floors", [2, 3], 2.0)
    return sid.Structure(nodes, [masses, *springs, *dashpots], ["1X", "1Y"], active=["X", "Y"])


def record(structure, seed=3, n=1200):
    """One shaker on a diagonal, its force given in two parts, the one along Y in the other sense."""
    rng = np.random.default_rng(seed)
    shaken = np.convolve(rng.standard_normal(n), np.hanning(9), "same")
    force = np.outer(shaken, [np.cos(ANGLE), -np.sin(ANGLE)])
    unknown = sid.parameters(structure, [sid.Unknown("mass", "floors", each=True)])
    at = unknown.values(unknown.start)
    mass, damping, stiffness = (structure.matrix(law, at) for law in ("mass", "damping", "stiffness"))
    loads = structure.selection(LOADS).toarray()
    motion = sid.sampled_transient(mass, stiffness, loads, force, RATE, damping)
    sensors = ("2X", "3X", "2Y", "3Y")
    seen = motion.acceleration @ structure.selection([parse_dof(s) for s in sensors]).toarray()
    std = 0.01 * seen.std(axis=0)
    seen = seen + std * rng.standard_normal(seen.shape)
    kinds = ("force", "force", *["acceleration"] * 4)
    return TimeRecord(
        RATE, np.hstack([force, seen]), (*LOADS, *sensors), kinds, variance=np.concatenate([[0.0, 0.0], std**2])
    )


def test_series_that_are_never_apart_are_made_of_fewer():
    rng = np.random.default_rng(1)
    two = rng.standard_normal((500, 2))
    mixing = np.array([[1.0, 2.0, 0.0], [1e4, 0.0, -3e4]])
    parts = joint_weights(two @ mixing)
    assert parts.shape == (3, 2)
    assert parts.T @ parts == pytest.approx(np.eye(2), abs=1e-12)
    values = two @ mixing
    assert values @ parts @ parts.T == pytest.approx(values, abs=1e-9 * np.abs(values).max())
    assert joint_weights(rng.standard_normal((500, 3))) is None
    assert joint_weights(two[:, :1]) is None


def test_the_response_to_a_joint_force_is_that_to_its_parts():
    structure = replace(floors(), bases=(sid.Base("ground", "1X"),))
    parts = np.array([[0.8], [0.6]])
    [made] = [parse_dof("77X")]
    changed = with_joint_forces(structure, [made], LOADS, parts)
    assert changed.n_dofs == structure.n_dofs
    assert changed.bases == structure.bases
    column = changed.selection([made]).toarray()
    assert column == pytest.approx(structure.selection(LOADS).toarray() @ parts, abs=1e-15)


@pytest.mark.parametrize("fit", ["spectra", "output_error"])
def test_one_shaker_on_a_diagonal_given_in_two_parts_is_identified(fit):
    structure = floors()
    start = sid.parameters(structure, [sid.Unknown("mass", "floors", each=True, start=2.5)])
    setup = sid.TimeSetup(structure, start, record(structure), sid.TimeFit(fit), cache=ResponseCache())
    options = IdentifyOptions(band=(1.0, 12.0) if fit == "spectra" else None, tolerances=EXACT)
    assert "forces at 3X+, 3Y- are linearly dependent" in setup.words(options)
    found = sid.identify_together([setup], options)
    assert found.estimate.values == pytest.approx([2.0, 2.0], abs=4 * found.estimate.std.max())
    assert found.estimate.std.max() < 0.02
    assert len(found.fits[0].measured.inputs) == 1
    fit = found.fits[0]
    driven = (fit.evaluation.frequency > 1) & (fit.evaluation.frequency < 12)
    assert np.median(fit.relative_error[driven]) < 0.1
