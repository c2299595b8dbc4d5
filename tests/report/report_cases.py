"""Identifications that the report is tried on: small, seeded, each with a feature of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import structid as si
from structid.core.dof import parse_dofs
from structid.forward.frf.response import response
from structid.identification.identify import Identification, IdentifyOptions, identify
from structid.prediction.sensing.sense import LeftOutSensor, SensedMotion
from structid.records import FrfRecord
from structid.unknowns.tolerances import EXACT


def synthetic_record(
    structure: si.Structure,
    unknown: si.Parameters,
    frequency: np.ndarray,
    outputs: list[str],
    inputs: list[str],
    noise: float,
    kind: str = "accelerance",
) -> FrfRecord:
    """What `structure` answers with the start values of `unknown`, with complex noise in proportion."""
    shape = (len(frequency), len(outputs), len(inputs))
    record = FrfRecord(frequency, np.ones(shape, complex), outputs, inputs, kind, source="synthetic")
    record = replace(record, values=response(structure, unknown, record).values_at(unknown.start))
    random = np.random.default_rng(7)
    error = (random.standard_normal(shape) + 1j * random.standard_normal(shape)) / np.sqrt(2)
    noisy = replace(record, values=record.values * (1 + noise * error))
    return si.with_declared_noise(noisy, relative=noise)


def cantilever(n_lines: int = 300) -> Identification:
    """A 6-element cantilever, damaged: mass and bending stiffness of each element and one loss factor."""
    nodes = {i: 0.2 * i for i in range(7)}
    table = [[i, i + 1] for i in range(6)]

    def built(mass: np.ndarray, stiffness: np.ndarray, loss: float) -> tuple[si.Structure, si.Parameters]:
        beam = si.Beam("beam", table, mass, stiffness, loss_factor=loss)
        structure = si.Structure(nodes, [beam], fixed=["0Y", "0RZ"])
        unknown = [
            si.Unknown("mass", "beam", each=True, factor=False, prior=si.Prior(2.0, 0.2)),
            si.Unknown("bending_stiffness", "beam", each=True, factor=False),
            si.Unknown("loss_factor", "beam"),
        ]
        return structure, si.parameters(structure, unknown)

    change = np.array([1.0, 1.0, 0.75, 1.0, 1.1, 1.0])
    true = built(2.0 * np.array([1, 1, 1, 1.05, 1, 1]), 80.0 * change, 0.012)
    frequency = np.linspace(2.0, 160.0, n_lines)
    record = synthetic_record(*true, frequency, ["3Y+", "6Y+"], ["6Y+"], 0.01)
    coherence = np.clip(1 - 0.02 * np.random.default_rng(1).random(record.values.shape), 0, 1)
    return identify(
        *built(np.full(6, 2.0), np.full(6, 80.0), 0.02),
        replace(record, coherence=coherence, averages=20),
        IdentifyOptions(band=(5.0, 150.0), exclude=[(60.0, 66.0)], n_modes=6),
    )


def _frame_nodes() -> dict[int, list[float]]:
    nodes = {}
    for floor in range(4):
        z = 0.18 * floor
        nodes[10 * floor] = [0.15, 0.125, z]
        for corner, (x, y) in enumerate([(0, 0), (0.3, 0), (0.3, 0.25), (0, 0.25)], start=1):
            nodes[10 * floor + corner] = [x, y, z]
    return nodes


def frame_model(off: float = 0.0, loss: float = 0.01, force: float = 0.02) -> tuple[si.Structure, si.Parameters]:
    """Four plates on columns, the base on a ground spring, dashpot and slide with friction."""
    up, down = 1.0 + off, 1.0 - off
    plates = [si.PointMass(f"plate {i}", [10 * i], 6.5 * (down if i % 2 else up)) for i in range(4)]
    inertias = [si.RotaryInertia(f"inertia {d.lower()}", [0, 10, 20, 30], 0.07, d) for d in ("RX", "RY", "RZ")]
    columns = [
        si.SpaceBeam(
            f"story {i}",
            [[10 * (i - 1) + c, 10 * i + c] for c in range(1, 5)],
            mass=0.42,
            bending_stiffness_y=9.0 * (down if i % 2 else up),
            bending_stiffness_z=150.0,
            axial_stiffness=5e6,
            torsional_stiffness=10.0,
            loss_factor=loss,
        )
        for i in range(1, 4)
    ]
    base = [
        si.Spring("base spring", "0X", stiffness=3.0e3 * up),
        si.Dashpot("base dashpot", "0X", viscous_damping=20.0 * down),
        si.Spring("rocking", "0RY", stiffness=4.0e4),
        si.Friction("slide", "0X", friction_force=force),
        si.Dashpot("damper", "10X", "20X", viscous_damping=5.0 * up),
    ]
    ties = [si.RigidLink(f"floor {i}", 10 * i, [10 * i + c for c in range(1, 5)]) for i in range(4)]
    structure = si.Structure(
        _frame_nodes(), [*plates, *inertias, *columns, *base], fixed=["0Y", "0Z", "0RX", "0RZ"], ties=ties
    )
    unknown = [si.Unknown("mass", f"plate {i}", prior=si.Prior(6.5, 1.0)) for i in range(4)]
    unknown += [si.Unknown("bending_stiffness_y", f"story {i}") for i in range(1, 4)]
    unknown += [
        si.Unknown("loss_factor", ["story 1", "story 2", "story 3"], name="stories"),
        si.Unknown("stiffness", "base spring"),
        si.Unknown("viscous_damping", "base dashpot"),
        si.Unknown("viscous_damping", "damper"),
        si.Unknown("friction_force", "slide"),
    ]
    return structure, si.parameters(structure, unknown)


def frame() -> Identification:
    """The 3-D frame from starts 20 % off."""
    structure, true = frame_model()
    frequency = np.linspace(3.0, 85.0, 250)
    outputs = ["1X-", "2X+", "11X-", "12X+", "21X-", "22X+", "31X-", "32X+", "0X+"]
    record = synthetic_record(structure, true, frequency, outputs, ["2X+"], 0.02)
    return identify(*frame_model(0.2, 0.012, 0.016), record, IdentifyOptions(band=(4.5, 80.0), n_modes=8))


def springs_in_series() -> Identification:
    """Two springs in series with no sensor (and no mass) between: only their sum of flexibilities shows."""

    def built(stiffness: float) -> tuple[si.Structure, si.Parameters]:
        parts = [
            si.Spring("lower <1>", "1X", stiffness=stiffness),
            si.Spring("upper & outer", "1X", "2X", stiffness=stiffness),
            si.Dashpot("damper", "2X", viscous_damping=0.5),
            si.PointMass("block", [2], 2.0),
            si.PointMass("second", [3], 1.0),
            si.Spring("link", "2X", "3X", stiffness=4.0e3, loss_factor=0.01),
        ]
        structure = si.Structure({1: 0.1, 2: 0.2, 3: 0.3}, parts, active=["X"])
        names = ["lower <1>", "upper & outer", "link"]
        unknown = [si.Unknown("stiffness", name) for name in names] + [si.Unknown("mass", ["block"])]
        return structure, si.parameters(structure, unknown)

    structure, true = built(1000.0)
    record = synthetic_record(structure, true, np.linspace(0.5, 20.0, 120), ["2X", "3X"], ["2X"], 0.01, "receptance")
    return identify(*built(1200.0), record, IdentifyOptions(tolerances=EXACT))


def many(n_lines: int = 220, iterations: int = 100) -> Identification:
    """A beam of 58 elements with 60 parameters and 40 channels; elements beyond the sensors are not determined."""
    n = 58
    nodes = {i: 0.05 * i for i in range(n + 1)}
    table = [[i, i + 1] for i in range(n)]

    def built(stiffness: np.ndarray, mass: float, loss: float) -> tuple[si.Structure, si.Parameters]:
        beam = si.Beam("beam", table, mass, stiffness, loss_factor=loss)
        structure = si.Structure(nodes, [beam], fixed=["0Y", "0RZ", f"{n}Y"])
        unknown = [
            si.Unknown("bending_stiffness", "beam", each=True, factor=False),
            si.Unknown("mass", "beam"),
            si.Unknown("loss_factor", "beam"),
        ]
        return structure, si.parameters(structure, unknown)

    change = np.ones(n)
    change[20:24] = 0.7
    true = built(400.0 * change, 3.0, 0.01)
    sensors = [f"{i}Y{'+' if i % 2 else '-'}" for i in range(1, 58)][:40]
    record = synthetic_record(*true, np.linspace(3.0, 250.0, n_lines), sensors, ["17Y+"], 0.01)
    options = IdentifyOptions(
        n_modes=10, method=si.LevenbergMarquardt(max_iterations=iterations), pole_free_start=False
    )
    return identify(*built(np.full(n, 420.0), 3.1, 0.015), record, options)


def plane_frame() -> Identification:
    """A portal in the plane from two groups: one line, turned sensors, moments, odd names, a start at 0."""
    portal = si.Beam("träger $x$ 梁", [[0, 1], [1, 2], [2, 3]], 3.0, 900.0, 4e6, loss_factor=0.02)
    seat = si.Spring("seat", ["3X", "3RZ"], stiffness=[2.0e5, 3.0e3])
    nodes = {0: [0, 0], 1: [0, 1], 2: [1.5, 1], 3: [1.5, 0]}
    structure = si.Structure(nodes, [portal, seat], fixed=["0X", "0Y", "0RZ", "3Y"])
    unknown = si.parameters(
        structure,
        [
            si.Unknown("mass", portal.name, each=True, factor=False),
            si.Unknown("stiffness", "seat"),
            si.Unknown("mass_damping", portal.name, positive=False),
        ],
    )
    record = synthetic_record(structure, unknown, np.array([12.0]), ["1X+", "2RZ-"], ["2Y-", "1RZ+"], 0.02, "mobility")
    return identify(structure, unknown, record, IdentifyOptions(pole_free_start=False, tolerances=EXACT))


def matrix_groups() -> Identification:
    """Two groups of matrices with no geometry."""
    groups = {
        "ends": {"mass": np.diag([1.0, 0.0, 1.0]), "stiffness": 4e3 * np.diag([1.0, 0.0, 1.0])},
        "middle": {
            "mass": np.diag([0.0, 2.0, 0.0]),
            "stiffness": 3e3 * (2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)),
        },
    }
    structure = si.from_matrices(groups, ["1X", "2X", "3X"])
    unknown = si.parameters(structure, [si.Unknown(p, g) for g in groups for p in ("mass", "stiffness")])
    record = synthetic_record(structure, unknown, np.linspace(0.0, 20.0, 60)[1:], ["1X", "3X"], ["1X"], 0.01)
    return identify(
        structure, unknown.started_at(np.full(4, 1.1)), record, IdentifyOptions(n_modes=3, tolerances=EXACT)
    )


def sensed(contradiction: str = "", n: int = 40) -> SensedMotion:
    """A sensed displacement, an acceleration that was left out and a force, over `n` samples, with bands that widen."""
    time = np.arange(n) / 10.0
    value, std = np.sin(time), 0.1 + 0.01 * time
    one, two = parse_dofs(["1X", "2X"])
    left = LeftOutSensor(two, "acceleration", value + std, value, std)
    return SensedMotion(
        time, (one,), "displacement", value[:, None], std[:, None], (two,), 5 * value[:, None], 5 * std[:, None], 5.0, 0.2,
        (left,), ("the record hardly determines the force at 2X+",), contradiction,
    )  # fmt: skip


CASES = {
    "cantilever": cantilever,
    "frame": frame,
    "series": springs_in_series,
    "many": many,
    "plane": plane_frame,
    "groups": matrix_groups,
}
