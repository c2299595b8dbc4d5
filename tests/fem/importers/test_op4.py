"""OUTPUT4: what other programs write, round trips of every layout, and files that are damaged."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matrix_cases import DATA, imported, outcome, random_matrix
from scipy import sparse

from structid.core.errors import FileError, InputError
from structid.fem.importers import ImportedMatrix, Op4Options, read_matrices, read_matrix, write_op4

TRUTH = dict(np.load(DATA / "truth.npz"))
LAYOUTS = [(layout, binary) for layout in ("dense", "sparse", "bigmat") for binary in (True, False)]


@pytest.mark.parametrize("path", sorted(DATA.glob("*.op4")), ids=lambda p: p.stem)
def test_op4_of_other_programs_is_read_to_all_digits(path):
    found = read_matrices(path)
    assert list(found) == ["KAA", "RECT", "CPLX"]
    tolerance = 1e-7 if "single" in path.stem else 0.0
    for name, true in TRUTH.items():
        got = found[name].matrix.toarray()
        np.testing.assert_allclose(got, true, rtol=tolerance, atol=tolerance * abs(true).max() * 1e-8)


@settings(max_examples=40)
@given(
    seed=st.integers(0, 10_000),
    layout=st.sampled_from(["dense", "sparse", "bigmat"]),
    binary=st.booleans(),
    order=st.sampled_from(["little", "big"]),
    words=st.sampled_from([32, 64]),
    is_complex=st.booleans(),
    symmetric=st.booleans(),
    single=st.booleans(),
)
def test_op4_round_trip_keeps_every_digit(
    tmp_path_factory, seed, layout, binary, order, words, is_complex, symmetric, single
):
    path = tmp_path_factory.mktemp("op4") / "a.op4"
    first = imported(seed, "KAA", symmetric=symmetric, is_complex=is_complex)
    random = np.random.default_rng(seed)
    second = ImportedMatrix("B2", sparse.csc_array(random.random((5, 9)) * (random.random((5, 9)) < 0.3)))
    write_op4(path, [first, second], Op4Options(binary, layout, order, words, single))
    back = read_matrices(path)
    assert list(back) == ["KAA", "B2"]
    for item in (first, second):
        got, true = back[item.name].matrix.toarray(), item.matrix.toarray()
        # binary with 64-bit words has no single precision; text has ten digits
        exact = not single or (binary and words == 64)
        limit = 0.0 if exact else 6e-8 if binary else 6e-10
        parts = [(got.real, true.real), (got.imag, true.imag)]
        for a, b in parts:
            np.testing.assert_allclose(a, b, rtol=limit, atol=0)


def test_op4_text_survives_windows_line_ends_lower_case_and_fortran_exponents(tmp_path):
    item = imported(3)
    for layout in ("dense", "sparse", "bigmat"):
        write_op4(tmp_path / "a.op4", [item], Op4Options(False, layout))
        text = (tmp_path / "a.op4").read_text()
        changed = (
            text.replace("E+", "D+").replace("E-", "d-").replace("\n", "\r\n").replace("3D24", "3E24") + "\r\n\r\n"
        )
        (tmp_path / "b.op4").write_bytes(changed.replace("KAA", "kaa").encode())
        assert abs(read_matrix(tmp_path / "b.op4", "Kaa").matrix - item.matrix).nnz == 0


def test_op4_of_a_symmetric_matrix_with_one_triangle_is_completed(tmp_path):
    item = imported(4)
    half = ImportedMatrix("KAA", sparse.tril(item.matrix).tocsc())
    write_op4(tmp_path / "a.op4", [half], Op4Options(layout="dense"))
    content = bytearray((tmp_path / "a.op4").read_bytes())
    content[12:16] = struct.pack("<i", 6)  # the form, as a solver declares it
    (tmp_path / "a.op4").write_bytes(content)
    assert abs(read_matrix(tmp_path / "a.op4").matrix - item.matrix).nnz == 0
    content[12:16] = struct.pack("<i", 4)  # a triangular factor stays one
    (tmp_path / "a.op4").write_bytes(content)
    assert abs(read_matrix(tmp_path / "a.op4").matrix - half.matrix).nnz == 0


@pytest.mark.parametrize("layout, binary", LAYOUTS)
def test_op4_cut_short_anywhere_is_refused_by_name(tmp_path, layout, binary):
    write_op4(tmp_path / "a.op4", [imported(5)], Op4Options(binary, layout))
    content = (tmp_path / "a.op4").read_bytes()
    whole = read_matrix(tmp_path / "a.op4").matrix
    refused = 0
    cuts = np.unique(np.linspace(1, len(content) - 1, 150).astype(int))
    for cut in cuts:
        (tmp_path / "b.op4").write_bytes(content[:cut])
        found, message = outcome(tmp_path / "b.op4")
        refused += found is None
        assert found or "b.op4" in message
        if found:  # only the closing number is missing, which says nothing
            assert not binary
            assert abs(found["KAA"].matrix - whole).nnz == 0
    assert refused >= len(cuts) - 8


@pytest.mark.parametrize("layout, binary", LAYOUTS)
def test_op4_with_any_byte_changed_is_read_or_refused_by_name(tmp_path, layout, binary):
    write_op4(tmp_path / "a.op4", [imported(6)], Op4Options(binary, layout))
    content = (tmp_path / "a.op4").read_bytes()
    rng = np.random.default_rng(0)
    for at in rng.integers(0, len(content), 100):
        changed = bytearray(content)
        changed[at] = rng.integers(0, 256)
        (tmp_path / "b.op4").write_bytes(changed)
        found, message = outcome(tmp_path / "b.op4")
        assert found or "b.op4" in message


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda t: t.replace("       1       0", "       1      -3", 1), ["line 2", "row -3"]),
        (lambda t: t.replace("E+00", "X+00", 1), ["line", "columns"]),
        (lambda t: t.replace("     -12", "      -2", 1), ["possible"]),
        (lambda t: "something else\n" + t, ["line 1", "title of a matrix"]),
    ],
)
def test_op4_text_that_is_damaged_names_the_line(tmp_path, change, words):
    write_op4(tmp_path / "a.op4", [imported(7)], Op4Options(False))
    (tmp_path / "a.op4").write_text(change((tmp_path / "a.op4").read_text()))
    with pytest.raises(FileError) as caught:
        read_matrices(tmp_path / "a.op4")
    for word in ["a.op4", *words]:
        assert word in str(caught.value)


def test_op4_record_whose_two_lengths_differ_is_refused(tmp_path):
    write_op4(tmp_path / "a.op4", [imported(8)])
    content = bytearray((tmp_path / "a.op4").read_bytes())
    content[28] += 1  # the length behind the header
    (tmp_path / "a.op4").write_bytes(content)
    with pytest.raises(FileError, match="byte 0: the header of a matrix does not end where it says"):
        read_matrices(tmp_path / "a.op4")


def test_op4_refuses_what_the_format_does_not_hold(tmp_path):
    with pytest.raises(FileError, match="1 to 8"):
        write_op4(tmp_path / "a.op4", [imported(name="STIFFNESS")])
    with pytest.raises(FileError, match="NaN"):
        write_op4(tmp_path / "a.op4", [ImportedMatrix("K", sparse.csc_array([[np.nan]]))])
    big = ImportedMatrix("K", sparse.eye_array(70_000).tocsc())
    with pytest.raises(FileError, match="65535"):
        write_op4(tmp_path / "a.op4", [big], Op4Options(layout="sparse"))
    with pytest.raises(InputError, match="layout"):
        Op4Options(layout="band")
    assert not (tmp_path / "a.op4").exists()


def test_op4_matrices_are_found_by_name_and_the_nearest_is_offered(tmp_path):
    write_op4(tmp_path / "a.op4", [imported(1, "KAA"), imported(2, "MAA")])
    np.testing.assert_array_equal(read_matrix(tmp_path / "a.op4", "maa").matrix.toarray(), random_matrix(2).toarray())
    with pytest.raises(FileError, match="KAA, MAA"):
        read_matrix(tmp_path / "a.op4")
    with pytest.raises(FileError, match="nearest is 'MAA'"):
        read_matrix(tmp_path / "a.op4", "MXX")
