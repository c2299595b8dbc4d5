"""Abaqus matrix files: labels, coordinates, element by element, user elements, held rows, and damage named by line."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matrix_cases import imported, numbered
from scipy import sparse

from structid.core.errors import FileError, InputError
from structid.fem.importers import (
    ElementEntries,
    ImportedMatrix,
    of_elements,
    on_dofs,
    read_matrices,
    read_matrix,
)
from structid.fem.importers import write_abaqus as write


@settings(max_examples=40)
@given(seed=st.integers(0, 10_000), symmetric=st.booleans(), form=st.sampled_from(["labels", "coordinate"]))
def test_abaqus_round_trip_keeps_every_digit(tmp_path_factory, seed, symmetric, form):
    path = tmp_path_factory.mktemp("mtx") / "a.mtx"
    item = imported(seed, symmetric=symmetric)
    write(path, item, form)
    back = read_matrix(path)
    got = back.matrix if form == "coordinate" else on_dofs(back, numbered(12))
    np.testing.assert_array_equal(got.toarray(), item.matrix.toarray())


def springs(n=4):
    """Springs in a row as elements 7, 8 ..., with their sum."""
    element = np.repeat(np.arange(7, 7 + n), 4)
    first = np.repeat(np.arange(n), 4)
    row, column = first + np.tile([0, 0, 1, 1], n), first + np.tile([0, 1, 0, 1], n)
    value = np.tile([1.0, -1.0, -1.0, 1.0], n) * (first + 1.0)
    total = sparse.coo_array((value, (row, column)), (n + 1, n + 1)).tocsc()
    return ImportedMatrix(
        "K", total, [[i, 1] for i in range(1, n + 2)], elements=ElementEntries(element, row, column, value)
    )


def test_element_by_element_files_keep_the_elements_apart(tmp_path):
    chain = springs()
    write(tmp_path / "k.mtx", chain, "elements")
    assert (tmp_path / "k.mtx").read_text().splitlines()[0].startswith("7, 1,1, 1,1, 1.0")
    back = read_matrix(tmp_path / "k.mtx")
    np.testing.assert_array_equal(back.matrix.toarray(), chain.matrix.toarray())
    two = of_elements(back, [8, 10]).matrix.toarray()
    np.testing.assert_array_equal(two.diagonal(), [0, 2, 2, 4, 4])
    np.testing.assert_array_equal(
        sum(of_elements(back, [e]).matrix for e in (7, 8, 9, 10)).toarray(), chain.matrix.toarray()
    )
    with pytest.raises(InputError, match=r"no element 3 .* from 7 to 10"):
        of_elements(back, [3, 7])
    with pytest.raises(InputError, match="is assembled"):
        of_elements(imported(), [3])


USER = """\
**
** ELEMENT NUMBER           11 STEP NUMBER            2 INCREMENT NUMBER            1
** ELEMENT TYPE B21
*USER ELEMENT, NODES=            2, LINEAR
** ELEMENT NODES
**          101,         102
1, 2, 6
2, 1
*MATRIX,TYPE=STIFFNESS
 4.00000000000000    ,
 1.0 , 5.0D+00
 0.0 , 2.0, 6.0
 -1.0, 0.0
 0.5, 7.0E0
*Matrix, type=mass
1., 0., 1., 0., 0., 1., 0., 0., 0.,
2.
** ELEMENT NUMBER           12 STEP NUMBER            2 INCREMENT NUMBER            1
*USER ELEMENT, NODES=            2, LINEAR, UNSYMM
** ELEMENT NODES
**          102,
**          103
1
*MATRIX,TYPE=STIFFNESS
1., 3., 2., 4.
"""


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_user_elements_are_assembled_by_node_and_component(tmp_path, end):
    (tmp_path / "e.mtx").write_bytes(USER.replace("\n", end).encode())
    found = read_matrices(tmp_path / "e.mtx")
    stiffness, mass = found["STIFFNESS"], found["MASS"]
    assert stiffness.dofs.tolist() == [[101, 1], [101, 2], [101, 6], [102, 1], [103, 1]]
    expected = np.zeros((5, 5))
    expected[:4, :4] = [[4, 1, 0, -1], [1, 5, 2, 0], [0, 2, 6, 0.5], [-1, 0, 0.5, 7]]
    expected[3:, 3:] += [[1, 2], [3, 4]]  # stored by columns
    np.testing.assert_array_equal(stiffness.matrix.toarray(), expected)
    np.testing.assert_array_equal(mass.matrix.toarray(), np.diag([1, 1, 1, 2]))
    np.testing.assert_array_equal(of_elements(stiffness, [12]).matrix.toarray()[3:, 3:], [[1, 2], [3, 4]])


def test_user_elements_without_numbers_are_counted_and_numbers_stand_at_all_or_none(tmp_path):
    path, numbers = tmp_path / "e.mtx", re.compile(r"\*\* ELEMENT NUMBER.*\n")
    path.write_text(numbers.sub("", USER))
    stiffness, mass = (read_matrices(path)[kind] for kind in ("STIFFNESS", "MASS"))
    assert set(stiffness.elements.element.tolist()) == {1, 2}
    assert set(mass.elements.element.tolist()) == {1}
    for last in (False, True):
        part = USER.rpartition("** ELEMENT NUMBER")
        half = numbers.sub("", part[0]) + part[1] + part[2] if last else part[0] + numbers.sub("", part[1] + part[2])
        path.write_text(half)
        with pytest.raises(
            FileError, match=r"line \d+: \*USER ELEMENT must have .* above it for each element or for none"
        ):
            read_matrices(path)


def test_components_of_user_elements_hold_until_they_change(tmp_path):
    (tmp_path / "e.mtx").write_text(
        "*USER ELEMENT, NODES=4, LINEAR\n** ELEMENT NODES\n** 5, 6, 7, 8\n1, 2\n2, 3\n4, 1\n"
        "*MATRIX,TYPE=MASS\n1., 0., 2., 0., 0., 3., 0., 0., 0., 4., 0., 0., 0., 0., 5.\n"
    )
    mass = read_matrix(tmp_path / "e.mtx")
    assert mass.dofs.tolist() == [[5, 1], [5, 2], [6, 3], [7, 3], [8, 1]]
    np.testing.assert_array_equal(mass.matrix.diagonal(), [1, 2, 3, 4, 5])


def test_held_degrees_of_freedom_are_taken_out_and_listed(tmp_path):
    (tmp_path / "a.mtx").write_text(
        "** K\n1,1, 1,1, 1.0e+36\n2,1, 2,1, 5.0\n3,1, 2,1, -2.D0\n\n3,1, 3,1, 2.0\n3,1,1,1,-7.\n"
    )
    item = read_matrix(tmp_path / "a.mtx")
    assert item.constrained.tolist() == [[1, 1]]
    assert item.dofs.tolist() == [[2, 1], [3, 1]]
    np.testing.assert_array_equal(item.matrix.toarray(), [[5, -2], [-2, 2]])


@pytest.mark.parametrize(
    "text, words",
    [
        ("1,1, 1,1, 2.0\n1,1, 2,1\n", ["line 2", "must have 5 numbers"]),
        ("1,1, 1,1, 2.0\n** comment\n1,1, 2,1, 2.0x\n", ["line 3", "'1 1  2 1  2.0x'"]),
        ("1,1, 5.0\n", ["load vector"]),
        ("1 1 1 5.0\n", ["without nodes", "MATRIX INPUT"]),
        ("1 1 1 5.0 3 4 5\n", ["3 to 6 values"]),
        ("-2 1 5.0\n", ["row -2", "internal"]),
        ("1.5,1, 1,1, 5.0\n", ["entry 1", "whole numbers"]),
        ("", ["empty"]),
        ("** nothing\n", ["3 to 6 values"]),
        (
            USER.replace("** ELEMENT NODES\n**          101,         102\n", ""),
            ["line 7", "element 11", "2 nodes, but 0"],
        ),
        (USER.replace(" 1.0 , 5.0D+00\n", ""), ["stiffness of element 11 has 8 values", "need 10"]),
        (USER.replace("5.0D+00", "5.0Z"), ["element 11", "no number"]),
        (USER.replace("NODES=            2, LINEAR\n", "LINEAR\n"), ["line 4", "NODES="]),
        (USER.replace("TYPE=STIFFNESS", "TYPE=STIFNESS"), ["line 9", "TYPE=STIFFNESS or MASS"]),
        (USER.replace("1, 2, 6\n", "1, b\n"), ["line 7", "degrees of freedom"]),
    ],
)
def test_abaqus_files_that_are_damaged_name_the_line(tmp_path, text, words):
    (tmp_path / "a.mtx").write_text(text)
    with pytest.raises(FileError) as caught:
        read_matrices(tmp_path / "a.mtx")
    for word in ["a.mtx", *words]:
        assert word in str(caught.value)


def test_internal_nodes_of_the_solver_are_refused_as_degrees_of_freedom(tmp_path):
    from structid.fem.importers import dofs_of

    (tmp_path / "a.mtx").write_text("-3,1, -3,1, 1.0\n2,1, 2,1, 1.0\n")
    item = read_matrix(tmp_path / "a.mtx")
    with pytest.raises(InputError, match="node -3 is internal to the solver"):
        dofs_of(item.dofs)
    with pytest.raises(InputError, match="component 8 of node 1"):
        dofs_of(np.array([[1, 8]]))
    with pytest.raises(InputError, match=r"1X.* is named by two rows"):
        dofs_of(np.array([[1, 1], [2, 1], [1, 1]]))
