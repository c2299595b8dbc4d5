"""NPY and NPZ: every type and order comes back; what a header declares must be there, before memory is taken for it."""

import io
import zipfile

import numpy as np
import pytest

from structid.core.errors import FileError
from structid.files.npy import npy_array, npz_arrays

ARRAYS = [
    np.arange(12.0).reshape(3, 4), np.asfortranarray(np.arange(12).reshape(3, 4)), np.array(3.5), np.zeros((0, 2)),
    np.array(["ä", "bc"]), np.array(b"csc"), np.arange(5, dtype=">i4"), np.ones(3, complex), np.array([True, False]),
]  # fmt: skip


@pytest.mark.parametrize("number", range(len(ARRAYS)))
def test_arrays_come_back_bit_for_bit(tmp_path, number):
    array = ARRAYS[number]
    np.save(tmp_path / "a.npy", array)
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "a.npz", a=array, b=np.arange(2))
        for found in (npy_array(tmp_path / "a.npy"), npz_arrays(tmp_path / "a.npz")["a"]):
            assert (found.dtype, found.shape, found.flags.f_contiguous) == (
                array.dtype, array.shape, array.flags.f_contiguous
            )  # fmt: skip
            assert found.tobytes() == array.tobytes()


def header(shape: str, descr: str = "'<f8'") -> bytes:
    text = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}".encode()
    text += b" " * (64 - (10 + len(text) + 1) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


BAD = {
    "more than there is": (header("(1000000000000,)") + bytes(16), "declares 8000000000000 bytes of values, 16 follow"),
    "less than there is": (header("(1,)") + bytes(16), "declares 8 bytes of values, 16 follow"),
    "negative": (header("(-2,)") + bytes(16), "shape"),
    "nested": (header("(" * 90 + ")" * 90), "not a whole NPY"),
    "unclosed": (header("((2,)") + bytes(16), "not a whole NPY"),
    "no type": (header("(2,)", "'<q99'") + bytes(16), "not a whole NPY"),
    "objects": (header("(2,)", "'|O'") + bytes(16), "can run code"),
    "version": (b"\x93NUMPY\x09\x00" + header("(2,)")[8:] + bytes(16), "version"),
}


@pytest.mark.parametrize("case", BAD)
def test_headers_that_are_not_so_are_refused(tmp_path, case):
    data, words = BAD[case]
    (tmp_path / "a.npy").write_bytes(data)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a.npy", data)
    with pytest.raises(FileError, match=words) as caught:
        npy_array(tmp_path / "a.npy")
    assert str(caught.value).startswith(str(tmp_path / "a.npy"))
    with pytest.raises(FileError, match=words.replace("NPY", "NPZ")):
        npz_arrays(tmp_path / "a.npz")


def test_a_member_cannot_be_larger_than_deflate_makes_it(tmp_path):
    content = io.BytesIO()
    np.savez_compressed(content, a=np.ones(50))
    data = bytearray(content.getvalue())
    at = data.rindex(b"PK\x01\x02") + 24
    data[at : at + 4] = (2**31).to_bytes(4, "little")
    (tmp_path / "a.npz").write_bytes(data)
    with pytest.raises(FileError, match=r"a\.npy says 2147483648 bytes, its .* cannot hold them"):
        npz_arrays(tmp_path / "a.npz")


def test_memory_that_is_not_there_is_called_so(tmp_path, monkeypatch):
    np.save(tmp_path / "a.npy", np.ones(3))

    def none(*_args, **_options):
        raise MemoryError("Unable to allocate 3 TiB")

    monkeypatch.setattr(np, "fromfile", none)
    with pytest.raises(FileError, match=r"a\.npy: does not fit in memory \(Unable to allocate 3 TiB\); free some"):
        npy_array(tmp_path / "a.npy")
