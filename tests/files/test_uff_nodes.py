"""Nodes and coordinate systems of universal files against files written here and positions computed by hand."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from structid.core.errors import FileError
from structid.files.uff.geometry import read_nodes
from structid.records import read_geometry

FIELD_FILES = Path(__file__).parents[1] / "records" / "field_files"


def dataset(number, *lines):
    return "\n".join(["    -1", f"{number:6d}", *lines, "    -1", ""])


def e13(*numbers):
    return "".join(f"{x:13.5E}" for x in numbers)


def d25(*numbers):
    return "".join(f"{x:25.16E}" for x in numbers).replace("E", "D")


def matrix_system(label, kind, axes, origin):
    rows = [d25(*row) for row in axes] + [d25(*origin)]
    return dataset(2420, f"{1:10d}", "part", f"{label:10d}{kind:10d}{8:10d}", f"CS{label}", *rows)


def point_system(label, kind, reference, origin, on_x, in_xz):
    head = "".join(f"{n:10d}" for n in (label, kind, reference, 8, 1))
    return dataset(18, head, "NAME", e13(*origin, *on_x), e13(*in_xz))


def short_node(label, definition, displacement, xyz):
    return dataset(15, "".join(f"{n:10d}" for n in (label, definition, displacement, 11)) + e13(*xyz))


def long_node(label, definition, displacement, xyz, number=2411):
    return dataset(number, "".join(f"{n:10d}" for n in (label, definition, displacement, 11)), d25(*xyz))


def turn(axis, degrees):
    """Rows are the global axes turned about one of them."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    rows = np.eye(3)
    rows[i, i], rows[i, j], rows[j, i], rows[j, j] = c, s, -s, c
    return rows


def place(kind, axes, origin, u):
    """Where the coordinates `u` of a system are."""
    first, second, third = u
    a, b, c = axes
    if kind == 0:
        return origin + first * a + second * b + third * c
    if kind == 1:
        angle = np.radians(second)
        return origin + first * (np.cos(angle) * a + np.sin(angle) * b) + third * c
    polar, around = np.radians(second), np.radians(third)
    level = np.cos(around) * a + np.sin(around) * b
    return origin + first * (np.sin(polar) * level + np.cos(polar) * c)


def directions(kind, axes, origin, u):
    """Unit vectors along which a place moves when one coordinate grows, by differences."""
    rows = []
    for i in range(3):
        step = np.zeros(3)
        step[i] = 1e-5
        way = place(kind, axes, origin, u + step) - place(kind, axes, origin, u - step)
        rows.append(way / np.linalg.norm(way))
    return np.array(rows)


AXES = turn(2, 30) @ turn(0, -50)
ORIGIN = np.array([0.5, -2.0, 3.0])
PLACES = {0: (1.0, 2.0, -3.0), 1: (2.0, 130.0, -1.0), 2: (1.5, 70.0, -140.0)}


@pytest.mark.parametrize("kind", [0, 1, 2])
@pytest.mark.parametrize("length", [1.0, 1e3])
@pytest.mark.parametrize("number", [18, 2420])
def test_positions_and_axes_of_every_kind_of_system(tmp_path, kind, length, number):
    """Dataset 164 in m or mm; the system is that of the position and of the motion."""
    u = np.array(PLACES[kind])
    lengths = np.array({0: [1, 1, 1], 1: [1, 0, 1], 2: [1, 0, 0]}[kind], dtype=bool)
    written = np.where(lengths, u * length, u)
    if number == 2420:
        system = matrix_system(7, kind, AXES, ORIGIN * length)
    else:
        points = [ORIGIN, ORIGIN + 2 * AXES[0], ORIGIN + 3 * AXES[2] - AXES[0]]
        system = point_system(7, kind, 0, *(point * length for point in points))
    units = dataset(164, f"{1 if length == 1 else 10:10d}{'x':20s}{2:10d}", d25(length, 1.0, 1.0), d25(273.15))
    path = tmp_path / "a.unv"
    path.write_text(units + system + long_node(12, 7, 7, written) + long_node(13, 0, 0, 1000 * np.eye(3)[0]))
    nodes = read_nodes(path)
    digits = 1e-12 if number == 2420 else 1e-4
    np.testing.assert_allclose(nodes.points[12], place(kind, AXES, ORIGIN, u), atol=digits)
    np.testing.assert_allclose(nodes.points[13], [1000 / length, 0, 0])
    np.testing.assert_allclose(nodes.axes(12), directions(kind, AXES, ORIGIN, u), atol=max(digits, 1e-9))
    assert nodes.axes(13) is None
    assert read_geometry(path).nodes == nodes.points


def test_systems_of_dataset_18_refer_to_each_other(tmp_path):
    """System 4 stands in the cylindrical system 3, which is given behind it."""
    outer = point_system(3, 1, 0, (1, 1, 0), (1, 2, 0), (1, 1, 5))  # its axes are Y, -X, Z
    inner = point_system(4, 0, 3, (2, 90, 1), (3, 90, 1), (2, 90, 4))  # origin at 2 along -X, its x axis that way
    path = tmp_path / "a.unv"
    path.write_text(inner + outer + short_node(5, 4, 4, (10, 20, 30)))
    nodes = read_nodes(path)
    np.testing.assert_allclose(nodes.axes(5), [[-1, 0, 0], [0, -1, 0], [0, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(nodes.points[5], [1 - 2 - 10, 1 - 20, 1 + 30], atol=1e-12)


def test_labels_0_and_1_are_global_where_they_are_not_defined(tmp_path):
    path = tmp_path / "a.unv"
    path.write_text(short_node(1, 0, 1, (1, 2, 3)) + long_node(2, 1, 0, (4, 5, 6), number=781))
    nodes = read_nodes(path)
    assert nodes.points == {1: (1, 2, 3), 2: (4, 5, 6)}
    assert nodes.turned == {}
    path.write_text(matrix_system(1, 0, turn(2, 90), (0, 0, 0)) + short_node(1, 1, 1, (1, 2, 3)))
    np.testing.assert_allclose(read_nodes(path).points[1], (-2, 1, 3), atol=1e-12)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (short_node(1, 9, 0, (1, 2, 3)), "position of node 1 is in coordinate system 9, which the file does not define"),
        (matrix_system(7, 3, np.eye(3), (0, 0, 0)), "system 7 is of type 3"),
        (matrix_system(7, 0, 2 * np.eye(3), (0, 0, 0)), "axes of coordinate system 7 must be three rows of length 1"),
        (matrix_system(7, 0, np.diag([1, 1, -1.0]), (0, 0, 0)), "right-handed"),
        (matrix_system(7, 0, np.eye(3), (0, 0, 0)) + matrix_system(7, 0, turn(0, 5), (0, 0, 0)), "system 7 twice"),
        (point_system(7, 0, 7, (0, 0, 0), (1, 0, 0), (0, 0, 1)), "refers to itself"),
        (point_system(7, 0, 5, (0, 0, 0), (1, 0, 0), (0, 0, 1)), "refers to 5, which the file does not define"),
        (point_system(7, 0, 0, (0, 0, 0), (1, 0, 0), (2, 0, 0)), "must not lie on one line"),
        (short_node(1, 0, 0, (1, 2, 3)) + short_node(1, 0, 0, (1, 2, 4)), "gives node 1 two positions"),
        (short_node(1, 0, 0, (1, 2, np.nan)), "position of node 1 is not finite"),
        (dataset(2411, f"{1:10d}{0:10d}{0:10d}{0:10d}"), "ends within a node"),
        (dataset(164, f"{5:10d}{'mm':20s}{2:10d}", d25(1, 1, 1), d25(0)), "units code 5, which stands for factors 1000"),
    ],
)  # fmt: skip
def test_what_cannot_be_followed_is_refused(tmp_path, text, words):
    path = tmp_path / "a.unv"
    path.write_text(text)
    with pytest.raises(FileError, match=words) as caught:
        read_nodes(path)
    assert str(caught.value).startswith(str(path))


def test_axes_that_cannot_be_told_are_refused_where_they_are_asked_for(tmp_path):
    path = tmp_path / "a.unv"
    path.write_text(
        matrix_system(7, 1, np.eye(3), (0, 0, 0)) + long_node(1, 0, 7, (0, 0, 3)) + long_node(2, 0, 8, (1, 0, 3))
    )
    nodes = read_nodes(path)
    assert nodes.points == {1: (0, 0, 3), 2: (1, 0, 3)}
    with pytest.raises(FileError, match="node 1 lies on the axis of coordinate system 7"):
        nodes.axes(1)
    with pytest.raises(FileError, match=r"node 2 is given in coordinate system 8, .*; leave it"):
        nodes.axes(2, "leave it")


def test_cylindrical_nodes_of_a_test_are_where_they_are(tmp_path):
    path = shutil.copy(FIELD_FILES / "g2411cyl.unv", tmp_path)
    np.testing.assert_allclose(list(read_geometry(path).nodes.values()), [[1, 0, 0], [0, 1, 0], [-1, 0, 0]], atol=1e-15)
