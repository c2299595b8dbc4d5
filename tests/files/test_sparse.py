"""Indices are looked at before compiled code follows them."""

from contextlib import suppress

import numpy as np
import pytest
import scipy.io
from scipy import sparse

from structid.core.errors import FileError
from structid.fem.importers import read_matrix

DENSE = np.array([[4.0, -2, 0, 0], [-2, 5, -1.5, 0], [0, -1.5, 3, 1], [0, 0, 1, 2]])


@pytest.mark.parametrize("form", ["csc", "csr", "coo", "dia"])
@pytest.mark.parametrize("kind", [sparse.csc_array, sparse.csc_matrix])
def test_every_form_of_save_npz_comes_back(tmp_path, form, kind):
    sparse.save_npz(tmp_path / "k.npz", kind(DENSE[:3]).asformat(form))
    np.testing.assert_array_equal(read_matrix(tmp_path / "k.npz").matrix.toarray(), DENSE[:3])


@pytest.mark.parametrize("form", ["csc", "csr"])
@pytest.mark.parametrize(
    "name, change, words",
    [
        ("indices", lambda a: a + 1, "counted from 0"),  # as MATLAB and Fortran count
        ("indices", lambda a: a - 1, "row -1 of 4"),
        ("indices", lambda a: np.where(a == 3, 2**30, a), "row 1073741824 of 4"),
        ("indices", lambda a: a + 0.5, "whole numbers"),
        ("indptr", lambda a: np.where(a == a.max(), 10**9, a), "do not rise"),
        ("indptr", lambda a: a[::-1].copy(), "do not rise"),
        ("indptr", lambda a: a[:-1], "need 5 starts, got 4"),
        ("shape", lambda a: a * 10**12, "shape|starts"),
        ("shape", lambda a: -a, "shape"),
        ("data", lambda a: a[:3], "do not rise"),
        ("format", lambda a: np.array(b"bsr"), "form 'bsr'"),
    ],
)
def test_parts_that_do_not_fit_are_refused(tmp_path, form, name, change, words):
    path = tmp_path / "k.npz"
    sparse.save_npz(path, sparse.csc_array(DENSE).asformat(form))
    with np.load(path) as found:
        parts = {key: found[key] for key in found.files}
    np.savez(path, **{**parts, name: change(parts[name])})
    with pytest.raises(FileError, match=words) as caught:
        read_matrix(path)
    assert str(caught.value).startswith(str(path))


def test_coordinates_outside_are_refused(tmp_path):
    path = tmp_path / "k.npz"
    np.savez(path, format=b"coo", shape=[4, 4], row=[0, 4], col=[0, 1], data=[1.0, 2.0])
    with pytest.raises(FileError, match="entry 2 is in row 4 of 4"):
        read_matrix(path)


@pytest.mark.parametrize("step", [11, pytest.param(3, marks=pytest.mark.long), pytest.param(1, marks=pytest.mark.slow)])
def test_any_byte_of_a_sparse_mat_file_may_change(tmp_path, step):
    """Of an uncompressed sparse matrix, as SciPy itself follows without looking; every eleventh by default."""
    scipy.io.savemat(tmp_path / "whole.mat", {"K": sparse.csc_matrix(DENSE)})
    data = (tmp_path / "whole.mat").read_bytes()
    path, refused = tmp_path / "k.mat", 0
    for at in range(124, len(data), step):
        for value in (0xFF, data[at] ^ 1):
            path.write_bytes(data[:at] + bytes([value]) + data[at + 1 :])
            with suppress(FileError):
                assert read_matrix(path).matrix.shape[0] >= 1
                refused -= 1
            refused += 1
    assert refused > 180 / step
