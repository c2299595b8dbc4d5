"""Fields of decks that are out of range, zero, blank or no number: no value is made of them in silence."""

import numpy as np
import pytest

from structid.core.errors import FileError
from structid.fem.meshes import read_mesh

GRIDS = """BEGIN BULK
GRID,1,,0.,0.,0.
GRID,2,,1.,0.,0.
GRID,3,,1.,1.,0.
GRID,4,,0.,1.,0.
GRID,5,,2.,0.5,1.
CQUAD4,1,1,1,2,3,4
"""
PANEL = """*NODE
1, 0., 0., 0.
2, 1., 0., 0.
3, 1., 1., 0.
4, 0.1, 0.2, 0.3
*ELEMENT, TYPE=S3
1, 1, 2, 3
"""


@pytest.fixture
def bulk(tmp_path):
    def read(cards):
        path = tmp_path / "a.bdf"
        path.write_text(f"{GRIDS}{cards}\nENDDATA\n")
        return read_mesh(path)

    return read


@pytest.fixture
def keywords(tmp_path):
    def read(lines):
        path = tmp_path / "a.inp"
        path.write_text(f"{PANEL}{lines}\n")
        return read_mesh(path)

    return read


def part_of(mesh, kind):
    [part] = [part for part in mesh.parts if part.kind == kind]
    return part


def test_points_that_only_rounding_keeps_off_a_line_make_no_axes(bulk, keywords):
    assert np.cross([0.1, 0.2, 0.3], [0.3, 0.6, 0.9]).any()
    with pytest.raises(FileError, match="coordinate system 7 lie on a line"):
        bulk("GRID,9,7,1.,0.,0.\nCORD2C,7,0,0.,0.,0.,0.1,0.2,0.3\n,0.3,0.6,0.9")
    for kind, points in (("R", "0.1, 0.2, 0.3, 0.3, 0.6, 0.9"), ("S", "0., 0., 0., 0.3, 0.6, 0.9")):
        with pytest.raises(FileError, match="the points of the system lie on a line"):
            keywords(f"*NSET, NSET=N\n4\n*TRANSFORM, NSET=N, TYPE={kind}\n{points}")


def test_directions_of_transforms_are_those_of_their_points(keywords):
    turned = keywords("*NSET, NSET=N\n2\n*TRANSFORM, NSET=N, TYPE=R\n0., 2., 0., -3., 1., 0.")
    np.testing.assert_allclose(turned.displacement_axes[2], [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-15)
    round_a_pole = keywords("*NSET, NSET=N\n3\n*TRANSFORM, NSET=N, TYPE=S\n1., 0., 0., 1., 0., 5.")
    np.testing.assert_allclose(round_a_pole.displacement_axes[3], [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-15)
