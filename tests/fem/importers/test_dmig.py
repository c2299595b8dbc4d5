"""DMIG cards: every field form, what another program writes, odd texts, and damage named by line."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matrix_cases import DATA, imported, numbered, outcome, random_matrix

from structid.core.errors import FileError
from structid.fem.importers import ImportedMatrix, dofs_of, on_dofs, read_matrices, read_matrix, write_dmig

TRUTH = dict(np.load(DATA / "truth.npz"))


def aligned(item, n):
    return on_dofs(item, numbered(n)).toarray()


@pytest.mark.parametrize("name", ["small", "large"])
def test_dmig_of_another_program_is_read_to_its_digits(name):
    found = read_matrices(DATA / f"pynastran_dmig_{name}.bdf")
    for key, n in (("KAA", 7), ("CPLX", 4)):
        true = TRUTH[key][:n, :n]
        got = aligned(found[key], n)
        for a, b in ((got.real, true.real), (got.imag, true.imag)):
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=0)  # ten digits, cut and not rounded


@settings(max_examples=40)
@given(
    seed=st.integers(0, 10_000),
    field=st.sampled_from(["large", "small", "free"]),
    is_complex=st.booleans(),
    symmetric=st.booleans(),
)
def test_dmig_round_trip_keeps_the_digits_of_its_fields(tmp_path_factory, seed, field, is_complex, symmetric):
    path = tmp_path_factory.mktemp("dmig") / "a.pch"
    item = imported(seed, symmetric=symmetric, is_complex=is_complex)
    write_dmig(path, [item], field)
    got, true = aligned(read_matrix(path), 12), item.matrix.toarray()
    limit = {"large": 5e-11, "small": 5e-2, "free": 0.0}[field]
    for a, b in ((got.real, true.real), (got.imag, true.imag)):
        np.testing.assert_allclose(a, b, rtol=limit, atol=0)


ODD = """\
$ a comment, and a card of the bulk data with a continuation of its own
GRID*                  5               0 0.600000000E+03 0.000000000E+00
*        0.300000000E+03               0               0               0

dmig,stif,0,6,3,4
DMIG    STIF          27       1               2       3   3.+5    3.+3$ comment
               2       4  2.5+10     0.0      50            1.0     0.0
+             51       2  -1.-20  1.5D-3                                STIF0001
DMIG*   B                      0               1               1
*                      1
\tDMIG
DMIG\tB\t1\t1\t\t1\t1\t2.5D+3
,2,1,-1.-2,,3,1,7.
ENDDATA
"""


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_dmig_in_odd_but_right_texts_is_read(tmp_path, end):
    (tmp_path / "a.dat").write_bytes(ODD.replace("\tDMIG\n", "").replace("\n", end).encode())
    found = read_matrices(tmp_path / "a.dat")
    stiffness = found["STIF"]
    assert stiffness.dofs.tolist() == [[2, 3], [2, 4], [27, 1], [50, 0], [51, 2]]
    column = stiffness.matrix.toarray()[2]
    np.testing.assert_array_equal(column, [3e5 + 3e3j, 2.5e10, 0, 1, -1e-20 + 1.5e-3j])
    np.testing.assert_array_equal(stiffness.matrix.toarray(), stiffness.matrix.toarray().T)
    np.testing.assert_array_equal(found["B"].matrix.toarray()[:, 0], [2500.0, -0.01, 7.0])
    assert [str(dof) for dof in dofs_of(stiffness.dofs)] == ["2Z+", "2RX+", "27X+", "50RX+", "51Y+"]


def test_dmig_in_polar_form_is_amplitude_and_degrees(tmp_path):
    (tmp_path / "a.dat").write_text("DMIG,C,0,1,4,0,1\nDMIG,C,1,1,,1,1,2.0,90.0\n")
    np.testing.assert_allclose(read_matrix(tmp_path / "a.dat").matrix.toarray(), [[2j]], atol=1e-15)


def test_rectangular_dmig_has_columns_of_its_own(tmp_path):
    item = ImportedMatrix("R", random_matrix(2).tocsc()[:, :5], numbered(12), np.array([[i, 0] for i in range(1, 6)]))
    for field in ("large", "free"):
        write_dmig(tmp_path / "a.pch", [item], field)
        back = read_matrix(tmp_path / "a.pch")
        used = np.diff(item.matrix.tocsr().indptr) > 0
        np.testing.assert_allclose(back.matrix.toarray(), item.matrix.toarray()[used][:, [0, 1, 2, 4]], rtol=5e-11)
        assert back.columns.tolist() == [[1, 0], [2, 0], [3, 0], [5, 0]]


GOOD = "DMIG,K,0,6,2\nDMIG,K,1,1,,1,1,2.0\nDMIG,K,2,1,,2,1,3.0\n"


@pytest.mark.parametrize(
    "text, words",
    [
        ("GRID,1,,0.,0.,0.\n", ["holds no DMIG", "EXTSEOUT"]),
        ("DMIG,K,1,1,,1,1,2.0\n", ["line 1", "'K' has no header"]),
        ("DMIG,K,0,6,2\n", ["line 1", "no column", "cut short"]),
        (GOOD + GOOD, ["line 4", "second header", "line 1"]),
        (GOOD + "DMIG,K,2,1,,2,1,3.0\n", ["line 4", "[2, 1]", "second time", "line 3"]),
        (GOOD.replace("3.0", "3.0.1"), ["line 3", "a real number", "'3.0.1'"]),
        (GOOD.replace(",2,1,3.0", ",2.5,1,3.0"), ["line 3", "grid point", "a whole number", "'2.5'"]),
        (GOOD.replace(",2,1,3.0", ",2,7,3.0"), ["line 3", "0 to 6", "2, 7"]),
        (GOOD.replace("K,0,6,2", "K,0,5,2"), ["line 1", "form 5"]),
        (GOOD + "DMIG,K,3,1,,1,1,5.0\nDMIG,K,1,1,,3,1,6.0\n".replace("K,1,1,,3", "K,1,1,,3"), ["declared symmetric", "5", "6"]),
        ("DMIG,R,0,9,2,,,,1\nDMIG,R,1,,,1,1,1.0\nDMIG,R,2,,,1,1,1.0\n", ["2 columns", "says 1"]),
    ],
)  # fmt: skip
def test_dmig_that_is_damaged_names_the_line(tmp_path, text, words):
    (tmp_path / "a.pch").write_text(text)
    with pytest.raises(FileError) as caught:
        read_matrices(tmp_path / "a.pch")
    for word in ["a.pch", *words]:
        assert word in str(caught.value)


@pytest.mark.parametrize("field", ["large", "small", "free"])
def test_dmig_with_any_byte_changed_is_read_or_refused_by_name(tmp_path, field):
    write_dmig(tmp_path / "a.pch", [imported(6)], field)
    content = (tmp_path / "a.pch").read_bytes()
    rng = np.random.default_rng(1)
    for at in rng.integers(0, len(content), 100):
        changed = bytearray(content)
        changed[at] = rng.integers(0, 256)
        (tmp_path / "b.pch").write_bytes(changed)
        found, message = outcome(tmp_path / "b.pch")
        assert found or "b.pch" in message


def test_dmig_refuses_what_the_format_does_not_hold(tmp_path):
    with pytest.raises(FileError, match="give `dofs`"):
        write_dmig(tmp_path / "a.pch", [ImportedMatrix("K", random_matrix(1))])
    with pytest.raises(FileError, match="1 to 8 letters"):
        write_dmig(tmp_path / "a.pch", [imported(name="K-A")])
