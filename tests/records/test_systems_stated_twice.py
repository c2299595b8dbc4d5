"""What universal files and listings state twice: once where it is the same, refused where it is not."""

import numpy as np
import pytest
from header_cases import dataset, fortran

from structid.core.errors import FileError
from structid.fem.meshes import read_mesh
from structid.files.uff.geometry import read_nodes
from structid.modal.formats.files import read_modes


def system_18(label, kind, points):
    rows = ["".join(fortran(x, 13, 5) for x in points[:6]), "".join(fortran(x, 13, 5) for x in points[6:])]
    return ["".join(f"{n:10d}" for n in (label, kind, 0, 8, 1)), "name", *rows]


def node_15(label, system):
    return dataset(
        15, "".join(f"{n:10d}" for n in (label, 0, system, 11)) + "".join(fortran(x, 13, 5) for x in (1, 2, 3))
    )


def node_2411(label, system):
    head = "".join(f"{n:10d}" for n in (label, 0, system, 11))
    return dataset(2411, head, "".join(fortran(x, 25, 16, "D") for x in (1, 2, 3)))


POINTS = (0.0, 0, 0, 0, 1, 0, 0, 0, 1)
TURNED = (0.0, 0, 0, 0, 0, 1, 1, 0, 0)


@pytest.mark.parametrize(
    "blocks, words",
    [
        ([dataset(18, *system_18(5, 0, POINTS), *system_18(5, 0, POINTS))], ""),
        ([dataset(18, *system_18(5, 0, POINTS)), dataset(18, *system_18(5, 0, POINTS))], ""),
        ([dataset(18, *system_18(5, 0, POINTS), *system_18(5, 0, TURNED))], "coordinate system 5 twice, differently"),
        (
            [dataset(18, *system_18(5, 0, POINTS)), dataset(18, *system_18(5, 1, POINTS))],
            "coordinate system 5 twice, differently",
        ),
    ],
)
def test_systems_that_stand_twice(tmp_path, blocks, words):
    path = tmp_path / "a.unv"
    path.write_bytes(b"".join([*blocks, node_2411(3, 5)]))
    if words:
        with pytest.raises(FileError, match=words):
            read_nodes(path)
    else:
        assert read_nodes(path).turned[3] == pytest.approx(np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]))


def test_an_origin_that_is_zero_but_for_rounding_is_one_place(tmp_path):
    rows = [[0, 1, 0], [-1, 0, 0], [0, 0, 1], [1e-12, 0, 0]]
    lines = ["".join(fortran(float(x), 25, 16) for x in row) for row in rows]
    matrix = dataset(2420, f"{1:10d}", "part", f"{5:10d}{0:10d}{8:10d}", "CS", *lines)
    (tmp_path / "a.unv").write_bytes(matrix + dataset(18, *system_18(5, 0, POINTS)) + node_2411(3, 5))
    assert 3 in read_nodes(tmp_path / "a.unv").turned


@pytest.mark.parametrize("first, second, is_refused", [(5, 5, False), (0, 1, False), (0, 5, True), (5, 0, True)])
def test_nodes_of_two_datasets_move_along_one_system(tmp_path, first, second, is_refused):
    path = tmp_path / "a.unv"
    path.write_bytes(dataset(18, *system_18(5, 0, POINTS)) + node_15(3, first) + node_2411(3, second))
    if is_refused:
        with pytest.raises(FileError, match=f"node 3 stands in two datasets, .* systems {first} and {second}"):
            read_nodes(path)
    else:
        assert read_nodes(path).points[3] == pytest.approx((1, 2, 3))


def listing(imaginary):
    head = (
        "      POINT ID.   TYPE          T1             T2             T3             R1             R2             R3"
    )
    page = ["1    FRAME" + " " * 60 + "PAGE     7"]
    page += ["      COMPLEX EIGENVALUE = -1.000000E+00,  6.283185E+01",
            " " * 39 + "C O M P L E X   E I G E N V E C T O R   NO.          1",
            " " * 58 + "(REAL/IMAGINARY)", "", head]  # fmt: skip
    lines = []
    for part in imaginary:
        lines += page
        lines.append("0            7      G   " + "".join(f"{x:13.6E}  " for x in (1, 2, 3, 4, 5, 6)))
        lines.append(" " * 24 + "".join(f"{x:13.6E}  " for x in (part, 2, 3, 4, 5, 6)))
    return "\n".join([*lines, ""])


def test_points_of_complex_vectors_that_are_printed_twice(tmp_path):
    path = tmp_path / "a.f06"
    path.write_text(listing([1.0, 1.0]))
    assert read_modes(path).mode_shapes[:, 0] == pytest.approx(np.array([1 + 1j, 2 + 2j, 3 + 3j]) / (3 + 3j))
    path.write_text(listing([1.0, 1.5]))
    with pytest.raises(FileError, match="point 7 is printed twice in mode 1 with different motions"):
        read_modes(path)


def mode_55(frequency=10.0, ratio=0.01, values=(1.0, 2, 3)):
    numbers = ["".join(f"{x:10d}" for x in row) for row in ((1, 2, 2, 8, 2, 3), (2, 4, 0, 1))]
    return dataset(55, *["NONE"] * 5, *numbers, "".join(fortran(float(x), 13, 5) for x in (frequency, 2.0, ratio, 0.0)),
                   f"{1:10d}", "".join(fortran(float(x), 13, 5) for x in values))  # fmt: skip


@pytest.mark.parametrize(
    "blocks, words",
    [
        ([mode_55(), mode_55(values=(3, -1, 0))], ""),
        ([mode_55(), mode_55(frequency=11.0)], ""),
        ([mode_55(), mode_55()], "repeats the mode before it"),
        ([mode_55(ratio=1.5)], "states a damping ratio of 1.5, with which nothing vibrates"),
    ],
)
def test_modes_that_stand_twice_or_do_not_vibrate(tmp_path, blocks, words):
    path = tmp_path / "a.unv"
    path.write_bytes(b"".join(blocks))
    if words:
        with pytest.raises(FileError, match=words):
            read_modes(path)
    else:
        assert read_modes(path).n_modes == 2


@pytest.mark.parametrize(
    "second, count", [((1, 94, 1, 2, 3, 4), 1), ((2, 94, 1, 2, 3, 4), 2), ((1, 94, 1, 2, 4, 3), 0)]
)
def test_elements_of_universal_files_that_stand_twice(tmp_path, second, count):
    points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    nodes = [
        line
        for label, point in enumerate(points, 1)
        for line in (
            "".join(f"{n:10d}" for n in (label, 0, 0, 11)),
            "".join(fortran(float(x), 25, 16, "D") for x in point),
        )
    ]
    elements = [
        line
        for label, kind, *corners in ((1, 94, 1, 2, 3, 4), second)
        for line in ("".join(f"{n:10d}" for n in (label, kind, 1, 1, 7, 4)), "".join(f"{n:10d}" for n in corners))
    ]
    path = tmp_path / "a.unv"
    path.write_bytes(dataset(2411, *nodes) + dataset(2412, *elements))
    if count:
        assert len(read_mesh(path).cells()) == count
    else:
        with pytest.raises(FileError, match="gives element 1 twice, with other nodes"):
            read_mesh(path)
