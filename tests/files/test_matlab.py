"""MAT files of versions 4 and 5 are read as SciPy reads whole ones."""

import struct

import numpy as np
import pytest
import scipy.io
from scipy import sparse

from structid.core.errors import FileError
from structid.files.contained import matlab_variables

RANDOM = np.random.default_rng(2)
NUMBERS = {
    "real": RANDOM.standard_normal((3, 4)),
    "turned": RANDOM.standard_normal((2, 3, 4)) + 1j * RANDOM.standard_normal((2, 3, 4)),
    "single": RANDOM.standard_normal((2, 2)).astype(np.float32),
    "whole": np.arange(-3, 3, dtype=np.int16).reshape(2, 3),
    "bytes": np.arange(6, dtype=np.uint8).reshape(1, 6),
    "wide": np.array([[2**62, -(2**62)]]),
    "none": np.zeros((0, 3)),
    "one": np.array([[2.5]]),
    "logical": np.array([[True, False]]),
}


@pytest.mark.parametrize("packed", [False, True])
def test_numbers_of_every_type_come_back(tmp_path, packed):
    scipy.io.savemat(tmp_path / "a.mat", NUMBERS, do_compression=packed)
    found = matlab_variables(tmp_path / "a.mat")
    assert list(found) == list(NUMBERS)
    for name, array in NUMBERS.items():
        assert found[name].shape == array.shape
        np.testing.assert_array_equal(found[name], array)


@pytest.mark.parametrize("packed", [False, True])
def test_texts_cells_structs_and_sparse_matrices_come_back(tmp_path, packed):
    square = sparse.csc_matrix(np.diag([1.0, 2, 0, 4]))
    cells = np.array(["1X+", "2Ä-", ""], dtype=object)
    inner = {"x": np.eye(2), "word": "deep", "more": {"y": 3.0}}
    given = {
        "text": "hällo",
        "cells": cells,
        "k": square,
        "c": square * 1j,
        "s": inner,
        "mixed": np.array(["a", 1], object),
    }
    scipy.io.savemat(tmp_path / "a.mat", given, do_compression=packed, oned_as="column")
    found = matlab_variables(tmp_path / "a.mat")
    assert (found["text"], found["cells"]) == ("hällo", ("1X+", "2Ä-", ""))
    np.testing.assert_array_equal(found["k"].toarray(), square.toarray())
    np.testing.assert_array_equal(found["c"].toarray(), square.toarray() * 1j)
    np.testing.assert_array_equal(found["s.x"], np.eye(2))
    assert (found["s.word"], found["s.more.y"].item()) == ("deep", 3.0)
    assert "mixed" not in found


def test_version_4(tmp_path):
    square = sparse.csc_matrix(np.diag([1.0, 2, 0, 4]))
    given = {"a": NUMBERS["real"], "b": NUMBERS["turned"][0], "text": "word", "k": square, "c": square * 1j}
    scipy.io.savemat(tmp_path / "a.mat", given, format="4")
    found = matlab_variables(tmp_path / "a.mat")
    assert found["text"] == "word"
    for name in ("a", "b"):
        np.testing.assert_array_equal(found[name], given[name])
    for name in ("k", "c"):
        np.testing.assert_array_equal(found[name].toarray(), given[name].toarray())


def test_the_other_byte_order(tmp_path):
    body = struct.pack(">IIII", 6, 8, 6, 0) + struct.pack(">IIii", 5, 8, 1, 2) + struct.pack(">HHc3x", 1, 1, b"k")
    body += struct.pack(">IIdd", 9, 16, 1.5, -2.0)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack(">H", 0x0100) + b"MI"
    (tmp_path / "a.mat").write_bytes(head + struct.pack(">II", 14, len(body)) + body)
    assert matlab_variables(tmp_path / "a.mat")["k"].tolist() == [[1.5, -2.0]]


def test_nested_cells_come_to_an_end(tmp_path):
    def cell(inner: bytes) -> bytes:
        body = struct.pack("<IIII", 6, 8, 1, 0) + struct.pack("<IIii", 5, 8, 1, 1) + struct.pack("<II", 1, 0) + inner
        return struct.pack("<II", 14, len(body)) + body

    data = b""
    for _ in range(3000):
        data = cell(data)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    (tmp_path / "a.mat").write_bytes(head + data)
    with pytest.raises(FileError, match=r"a\.mat: "):
        matlab_variables(tmp_path / "a.mat")
