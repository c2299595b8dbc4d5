"""The frame of the IASC-ASCE benchmark with floors that are rigid in their plane: frequencies of its generating model.

Johnson, Lam, Katafygiotis and Beck (2004), J. Eng. Mech. 130, 3-15: 2.5 m x 2.5 m in plan, four storeys of 0.9 m, nine
columns a storey, two braces a face and storey, four slabs a floor. The frequencies are those of the benchmark's own program.
"""

import numpy as np
import pytest

from structid import Bar, InputError, PointMass, RigidLink, RotaryInertia, SpaceBeam, Structure
from structid.core.dof import DIRECTIONS
from structid.dynamics.normal_modes import modes

E, G, RHO = 2e11, 2e11 / 2.6, 7800.0
BAY, HEIGHT = 1.25, 0.9
#: A, I about the two axes and their sum's torsion constant, m^2 and m^4.
COLUMN = (1.133e-3, 1.97e-6, 0.664e-6, 8.01e-9)
BEAM = (1.430e-3, 0.249e-6, 1.22e-6, 38.2e-9)
BRACE = 0.141e-3
SLABS = (800.0, 600.0, 600.0, 400.0)


def node(floor: int, i: int, j: int) -> int:
    return 100 * floor + 3 * j + i + 1


def frame(heavy: float = 400.0) -> Structure:
    """120 free degrees of freedom; `heavy` is the mass of one slab of the roof."""
    grid = [(i, j) for j in range(3) for i in range(3)]
    nodes = {node(f, i, j): (i * BAY, j * BAY, f * HEIGHT) for f in range(5) for i, j in grid}
    columns = [[node(f, i, j), node(f + 1, i, j)] for f in range(4) for i, j in grid]
    along_x = [[node(f, i, j), node(f, i + 1, j)] for f in range(1, 5) for j in range(3) for i in range(2)]
    along_y = [[node(f, i, j), node(f, i, j + 1)] for f in range(1, 5) for j in range(2) for i in range(3)]
    braces = []
    for f in range(4):
        for side in (0, 2):
            braces += [[node(f, 0, side), node(f + 1, 1, side)], [node(f + 1, 1, side), node(f, 2, side)]]
            braces += [[node(f, side, 0), node(f + 1, side, 1)], [node(f + 1, side, 1), node(f, side, 2)]]
    lumps: dict[int, float] = dict.fromkeys(nodes, 0.0)
    turns: dict[str, dict[int, float]] = {d: dict.fromkeys(nodes, 0.0) for d in ("RX", "RY", "RZ")}
    for table, area, polar, axis in (
        (columns, COLUMN[0], COLUMN[1] + COLUMN[2], "RZ"),
        (along_x, BEAM[0], BEAM[1] + BEAM[2], "RX"),
        (along_y, BEAM[0], BEAM[1] + BEAM[2], "RY"),
        (braces, BRACE, 0.0, "RX"),
    ):
        for pair in table:
            length = np.linalg.norm(np.subtract(nodes[pair[1]], nodes[pair[0]]))
            for end in pair:
                lumps[end] += RHO * area * length / 2
                turns[axis][end] += RHO * polar * length / 2
    free = [label for label in nodes if label > 100]
    slabs, weights = [], []
    for f, mass in enumerate(SLABS, 1):
        for k, (x, y) in enumerate([(0.625, 0.625), (1.875, 0.625), (0.625, 1.875), (1.875, 1.875)]):
            slabs.append(1000 * f + k)
            weights.append(heavy if f == 4 and k == 0 else mass)
            nodes[slabs[-1]] = (x, y, f * HEIGHT)

    def bending(name, table, section, orientation):
        area, about_y, about_z, torsion = section
        return SpaceBeam(name, table, 0.0, E * about_y, E * about_z, E * area, G * torsion, orientation=orientation)

    sets = [
        Bar("braces", braces, 0.0, E * BRACE),
        PointMass("members", free, [lumps[label] for label in free]),
        PointMass("slabs", slabs, weights, directions=("X", "Y")),
        RotaryInertia("slab turns", slabs, np.multiply(weights, 2 * BAY**2 / 12), "RZ"),
        *(RotaryInertia(f"member turns {d}", free, [turns[d][label] for label in free], d) for d in turns),
        bending("columns", columns, COLUMN, (0.0, 1.0, 0.0)),
        bending("beams along x", along_x, BEAM, (0.0, 0.0, 1.0)),
        bending("beams along y", along_y, BEAM, (0.0, 0.0, 1.0)),
    ]
    floors = [
        RigidLink(
            f"floor {f}",
            node(f, 1, 1),
            [label for label, place in nodes.items() if place[2] == f * HEIGHT and label != node(f, 1, 1)],
            directions=("X", "Y", "RZ"),
        )
        for f in range(1, 5)
    ]
    feet = [f"{node(0, i, j)}{d}" for i, j in grid for d in DIRECTIONS]
    return Structure(nodes, sets, feet, floors)


def test_frequencies_of_the_frame_are_those_of_the_benchmark():
    structure = frame()
    assert structure.n_dofs == 120
    found = modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=8).frequency
    printed = [8.588, 9.181, 14.580, 23.452, 25.946, 36.813, 40.646, 42.210]
    assert found == pytest.approx(printed, rel=1e-4)
    masses = [
        structure.matrix("mass").diagonal()[structure.dofs.index(d)] for d in structure.dofs if d.direction == "X"
    ]
    assert masses == pytest.approx([3452.4, 2652.4, 2652.4, 1809.9], abs=0.06)


@pytest.mark.parametrize("directions", [["W"], []])
def test_directions_of_a_link_are_checked(directions):
    with pytest.raises(InputError, match="`directions` of rigid link 'floor' must be among X Y Z"):
        RigidLink("floor", 1, [2], directions)
