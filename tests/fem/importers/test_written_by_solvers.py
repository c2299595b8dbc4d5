"""Traits of matrix files that Ansys, Abaqus and NX Nastran write, each in a small file of our own."""

import numpy as np
import pytest

from structid import Structure
from structid.core.errors import FileError
from structid.fem import Plane
from structid.fem.importers import read_matrices, read_matrix, read_numbering

#: Lower triangle by columns of a symmetric matrix of five rows, as HBMAT writes it: one number a line, exponents with D.
POINTERS, ROWS, VALUES = [1, 3, 5, 7, 9, 10], [1, 2, 2, 3, 3, 4, 4, 5, 5], [4.0, -1.0] * 4 + [1e-3]


def hbmat(kind="RSA", right=True, values=VALUES, form="(d25.15)"):
    """A file like those of Ansys; with the right-hand side that follows the values."""
    counts = [len(POINTERS), len(ROWS), len(values), 5 if right else 0]
    lines = [
        "     Mass matrix from ANSYS FULL file dumped into Harwell-Boeing format         ",
        "".join(f"{n:14d}" for n in [sum(counts), *counts]),
        f"{kind}           {5:14d}{5:14d}{9:14d}{0:14d}",
        f"(I14)           (I14)           {form}            (d25.15)            ",
        *(["F" + " " * 13 + f"{1:14d}{5:14d}"] if right else []),
        *(f"{n:14d}" for n in POINTERS + ROWS),
        *(f"{v:25.15E}".replace("E", "D") for v in [*values, *([0.0] * 5 if right else [])]),
    ]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("right", [True, False])
@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_symmetric_harwell_boeing_files_of_ansys_are_read(tmp_path, right, ends):
    path = tmp_path / "MMatrix.matrix"
    path.write_bytes(hbmat(right=right).replace("\n", ends).encode())
    found = read_matrix(path)
    wanted = np.diag([4.0, 4.0, 4.0, 4.0, 1e-3]) - np.diag(np.ones(4), 1) - np.diag(np.ones(4), -1)
    assert found.name == "MMATRIX"
    np.testing.assert_array_equal(found.matrix.toarray(), wanted)


def test_numbers_without_blanks_between_them_and_unsymmetric_or_complex_values_are_read(tmp_path):
    text = hbmat("RUA", right=False)
    head, numbers = text.split("\n")[:4], text.split("\n")[4:]
    head[3] = "(8I2)           (10I1)          (1P,3D10.3)"
    packed = ["".join(f"{n:2d}" for n in POINTERS), "".join(map(str, ROWS))]
    values = [f"{v:10.3E}".replace("E", "D") for v in [-4.0] * 9]
    path = tmp_path / "a.rua"
    path.write_text("\n".join([*head, *packed, *("".join(values[i : i + 3]) for i in (0, 3, 6)), ""]))
    found = read_matrix(path).matrix.toarray()
    assert found[1, 0] == -4.0
    assert found[0, 1] == 0.0
    assert len(numbers) > 10
    path.write_text(hbmat("CSA", right=False, values=[x for v in VALUES for x in (v, 2.0)]))
    assert read_matrix(path).matrix[0, 1] == -1 + 2j


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda t: t[:-26], "there are fewer numbers than it says"),
        (lambda t: "\n".join(t.split("\n")[:15]), "there are fewer lines than it says"),
        (lambda t: t + t.split("\n")[-2] + "\n", "there are more lines than it says"),
        (lambda t: t.replace("RSA", "PSA"), "is of type PSA; assembled matrices with real or complex values"),
        (lambda t: t.replace("D-03", "D-0X"), "must hold numbers, got '1.000000000000000D-0X'"),
        (lambda t: t.replace(f"{10:14d}", f"{11:14d}", 1), "the columns do not add up to the number of entries"),
        (lambda t: t.replace("RSA", "RZA"), "is skew or Hermitian"),
        (lambda t: "title\n", "holds no Harwell-Boeing matrix that can be read"),
    ],
)
def test_damaged_harwell_boeing_files_are_told(tmp_path, change, words):
    path = tmp_path / "k.matrix"
    path.write_text(change(hbmat(right=False)))
    with pytest.raises(FileError) as error:
        read_matrices(path)
    assert words in str(error.value)
    assert str(error.value).startswith(str(path))


def test_the_mapping_beside_it_names_the_rows(tmp_path):
    path = tmp_path / "MMatrix.mapping"
    path.write_text(
        "    Matrix Eqn          Node    DOF     \n             1            50    UY  \n"
        "             2            50    ROTZ\n             3         10002    UY  \n"
    )
    assert [str(dof) for dof in read_numbering(path)] == ["50Y+", "50RZ+", "10002Y+"]


#: A plane stress square of side 1 (E = 200, nu = 0.3, type CPS4) as Abaqus prints it: rows run over several lines.
CPS4 = """**
** ELEMENT NUMBER 11 STEP NUMBER 2 INCREMENT NUMBER 1
** ELEMENT TYPE CPS4
*USER ELEMENT, NODES= 4, LINEAR
** ELEMENT NODES
** 101, 102, 103, 104
1, 2
*MATRIX,TYPE=STIFFNESS
98.901098901099 ,
35.714285714286 , 98.901098901099
-60.439560439561 , 2.7472527472527 , 98.901098901099
-2.7472527472527 , 10.989010989011 , -35.714285714286 , 98.901098901099
-49.450549450549 , -35.714285714286 , 10.989010989011 , 2.7472527472528
98.901098901099 ,
-35.714285714286 , -49.450549450549 , -2.7472527472527 , -60.439560439561
35.714285714286 , 98.901098901099
10.989010989011 , -2.7472527472527 , -49.450549450549 , 35.714285714286
-60.439560439561 , 2.7472527472528 , 98.901098901099
2.7472527472527 , -60.439560439561 , 35.714285714286 , -49.450549450549
-2.7472527472527 , 10.989010989011 , -35.714285714286 , 98.901098901099
"""


def test_an_element_that_abaqus_printed_is_our_plane_element(tmp_path):
    path = tmp_path / "Stiffness.mtx"
    path.write_text(CPS4)
    found = read_matrix(path)
    assert found.dofs.tolist() == [[n, c] for n in (101, 102, 103, 104) for c in (1, 2)]
    nodes = {101: (0.0, 0.0), 102: (1.0, 0.0), 103: (1.0, 1.0), 104: (0.0, 1.0)}
    own = Structure(nodes, [Plane("p", [list(nodes)], 200.0, 1.0, 1.0, 0.3, formulation="full")])
    assert own.matrix("stiffness").toarray() == pytest.approx(found.matrix.toarray(), rel=1e-12)


def test_text_of_output4_with_one_word_a_number_in_sixteen_digits_is_read(tmp_path):
    """NX with 64-bit words: type 1, columns of strings whose headers hold length and row in one number."""
    one = " 1.000000000000000E+00\n"
    strings = {  # total words, and length + 1 and row of each string in one number
        1: (3, f"{65536 * 3 + 1:11d}\n 2.000000000000000E+00-1.000000000000000E+00\n"),
        2: (5, f"{65536 * 3 + 1:11d}\n-1.000000000000000E+00 2.500000000000000E+00\n{65536 * 2 + 3:11d}\n-5.000000000000000E-01\n"),
        3: (3, f"{65536 * 3 + 2:11d}\n-5.000000000000000E-01 1.000000000000000E+00\n"),
    }  # fmt: skip
    text = "       3       3       6       1KAA     1P,3E22.15\n"
    text += "".join(f"{k:8d}       0{words:8d}\n{part}" for k, (words, part) in strings.items())
    text += f"       4       1       1\n{one}       1       1       6       1MUG1OB  1P,3E22.15\n       2       1       1\n{one}"
    path = tmp_path / "se.op4"
    path.write_text(text)
    wanted = [[2.0, -1.0, 0.0], [-1.0, 2.5, -0.5], [0.0, -0.5, 1.0]]
    np.testing.assert_array_equal(read_matrix(path, "KAA").matrix.toarray(), wanted)
    assert read_matrix(path, "MUG1OB").matrix.nnz == 0
