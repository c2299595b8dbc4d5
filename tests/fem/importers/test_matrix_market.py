"""MatrixMarket: what SciPy writes, exponents as Fortran writes them, and what is wrong told with its line."""

from io import BytesIO

import numpy as np
import pytest
import scipy.io
from scipy import sparse

from structid.core.errors import FileError
from structid.fem.importers import read_matrix

RANDOM = np.random.default_rng(8)


def written(tmp_path, text):
    path = tmp_path / "a.mtx"
    path.write_bytes(text.encode("latin-1"))
    return path


def matrices():
    full = RANDOM.standard_normal((5, 5))
    half = sparse.csr_array(RANDOM.random((6, 6)) * (RANDOM.random((6, 6)) < 0.4))
    turned = full + 1j * RANDOM.standard_normal((5, 5))
    yield from (full, full[:, :3], full + full.T, full - full.T, turned, turned + turned.T.conj(), turned + turned.T)
    yield from (half, half + half.T, half - half.T, sparse.coo_array(half * 1j + half), np.arange(6).reshape(2, 3))


@pytest.mark.parametrize("number", range(12))
def test_every_form_that_scipy_writes_comes_back(tmp_path, number):
    matrix = list(matrices())[number]
    stream = BytesIO()
    scipy.io.mmwrite(stream, matrix, precision=17)
    path = tmp_path / "a.mtx"
    path.write_bytes(stream.getvalue())
    dense = matrix.toarray() if sparse.issparse(matrix) else matrix
    np.testing.assert_allclose(read_matrix(path).matrix.toarray(), dense, rtol=1e-15)


HEAD = "%%MatrixMarket matrix coordinate real general\n% a comment\n\n2 3 3\n"


def test_exponents_of_fortran_are_exponents(tmp_path):
    path = written(tmp_path, HEAD + "1 1 1.5D+03\n2 3 1.5+3\n% more\n1 2\t-2.5d-1\r\n")
    assert read_matrix(path).matrix.toarray().tolist() == [[1500.0, -0.25, 0.0], [0.0, 0.0, 1500.0]]


BAD = {
    "comma": (HEAD + "1 1 4,5\n1 2 1\n1 3 1\n", r"line 5: word 3 must be a finite number, got '4,5'"),
    "four columns": (HEAD + "1 1 4 5\n1 2 1\n1 3 1\n", r"line 5: must have 3 numbers, got '1 1 4 5'"),
    "two columns": (HEAD + "1 1 4\n1 2\n1 3 1\n", r"line 6: must have 3 numbers"),
    "cut": (HEAD + "1 1 4\n1 2 5\n", r"says 3 entries and has 2 lines"),
    "no sizes": ("%%MatrixMarket matrix coordinate real general\n", "has no line of sizes"),
    "damaged sizes": ("%%MatrixMarket matrix coordinate real general\n2 x 1\n1 1 1\n", r"line 2: word 2 must be a whole"),
    "negative": ("%%MatrixMarket matrix coordinate real general\n-2 2 1\n1 1 1\n", "must not be negative"),
    "large": ("%%MatrixMarket matrix coordinate real general\n2 99999999999 1\n1 1 1\n", "declares shape"),
    "outside": (HEAD + "1 1 4\n1 4 5\n1 1 1\n", r"line 6: column must be from 1 to 3, got 4"),
    "zero": (HEAD + "0 1 4\n1 3 5\n1 1 1\n", r"line 5: row must be from 1 to 2, got 0"),
    "long": (HEAD + f"1 1 {'1' * 5000}\n1 3 5\n1 1 1\n", "line 5: word 3"),
    "many digits": (HEAD + "1 99999999999999999999 4\n1 3 5\n1 1 1\n", "line 5: word 2 must be a whole number"),
    "infinite": (HEAD + "1 1 4\n1 3 1e400\n1 1 1\n", r"line 6: word 3 must be a finite number, got '1e400'"),
    "nan": (HEAD + "1 1 4\n1 3 nan\n1 1 1\n", "line 6"),
    "underscore": (HEAD + "1 1 4\n1 3 1_0\n1 1 1\n", "line 6"),
    "latin": ("%%MatrixMarket matrix coordinate reäl general\n2 2 1\n1 1 1\n", "line 1: must read %%MatrixMarket"),
    "pattern": ("%%MatrixMarket matrix coordinate pattern general\n2 2 1\n1 1\n", "line 1: must read"),
    "both sides": (
        "%%MatrixMarket matrix coordinate real symmetric\n2 2 2\n1 2 1\n2 1 1\n", "on one side of the diagonal only"
    ),
    "not square": ("%%MatrixMarket matrix coordinate real symmetric\n2 3 1\n2 1 1\n", "2 rows and 3 columns"),
    "array": ("%%MatrixMarket matrix array real general\n2 2\n1\n2\n3\n", "2 x 2 entries need 4 lines, got 3"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_what_is_not_as_the_format_has_it_is_refused(tmp_path, case):
    text, words = BAD[case]
    path = written(tmp_path, text)
    with pytest.raises(FileError, match=words) as caught:
        read_matrix(path)
    assert str(caught.value).startswith(str(path))
