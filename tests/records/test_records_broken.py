"""Broken files come out as `FileError` or `InputError` that begin with the path; no file is half written."""

import os
import subprocess
import sys

import numpy as np
import pytest

from structid.core.errors import FileError, InputError
from structid.records import ReadOptions, read_record, write_record
from structid.records.formats import FORMATS

#: One of every format; NPY files are read only.
EVERY = tuple(module.SUFFIXES[0] for module in FORMATS)
SUFFIXES = tuple(suffix for suffix in EVERY if suffix != ".npy")
#: Formats that are read in a process of their own, which begins anew behind each damaged file.
APART = (".mat", ".h5")
BARE = ReadOptions(sampling_rate=10, channels="1X,2X,3X", units="g")


def one_wrong(value):
    array = np.full((7, 3, 2), 0.5)
    array[3, 1, 1] = value
    return array


def refused(path, options=None):
    """Whether reading `path` fails as it should; False where it is read."""
    try:
        read_record(path, options)
    except InputError as error:
        message = str(error)
    else:
        return False
    assert message.startswith(f"{path}:")
    return True


@pytest.mark.parametrize("suffix", EVERY)
@pytest.mark.parametrize("content", ["frf", "history"])
@pytest.mark.parametrize(("n_apart", "n_other"), [(4, 40), pytest.param(20, 300, marks=pytest.mark.long)])
def test_truncated(tmp_path, suffix, content, n_apart, n_other, request):
    path = tmp_path / f"a{suffix}"
    record = request.getfixturevalue(content)
    if suffix == ".npy":
        np.save(path, np.ones((50, 3)))
    else:
        write_record(path, record)
    options = BARE if suffix == ".npy" else None
    data = path.read_bytes()
    assert not refused(path, options)
    for cut in np.linspace(0, len(data) - 1, n_apart if suffix in APART else n_other).astype(int)[:-1]:
        path.write_bytes(data[:cut])
        # a table cut between its lines is a shorter table, a universal file behind a data set one of fewer: nothing tells
        ends = {".csv": (b"\n",), ".uff": (b"    -1", b"    -1\n")}.get(suffix, ())
        if not data[:cut].rstrip(b" ").endswith(ends):
            assert refused(path, options), f"{cut} of {len(data)} bytes were read"


JUNK = [
    b"", b"junk", b"\x89HDF\r\n\x1a\n" + b"y" * 90, b"MATLAB 7.3 MAT-file" + b" " * 600,
    b"MATLAB 5.0 MAT-file" + b" " * 600, b" ", b"\0" * 700, b"PK\x03\x04" + b"x" * 40, b"\xff\xfe\x00" * 99,
    b"    -1\n    58\n", b"    -1\n    -1\n", b"time_s,1X [m]\n", b"time_s,1X [m]\n0,1\n1,2", b"\x93NUMPY\x01\x00",
    "time_s;\u00e4\n".encode("latin-1"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("suffix", "junk"),
    [
        pytest.param(suffix, junk, marks=[pytest.mark.long] if suffix in APART and k > 4 else [])
        for suffix in EVERY
        for k, junk in enumerate(JUNK)
    ],
)
def test_junk(tmp_path, suffix, junk):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(junk)
    with pytest.raises(FileError) as caught:
        read_record(path, BARE)
    assert str(caught.value).startswith(f"{path}:")


@pytest.mark.parametrize("suffix", [".npz", ".h5", ".mat"])
@pytest.mark.parametrize(
    "field, value, word",
    [
        ("values", np.full((7, 3, 2), np.nan + 0j), "values.*finite"),
        ("frequency", np.array([1, 2, 3, 3, 4, 5, 6.0]), "must increase, got 3 followed by 3 at index 3"),
        (
            "frequency",
            np.array([1, 2, 3.00000001, 3, 4, 5, 6]),
            "must increase, got 3.00000001 followed by 3 at index 3",
        ),
        ("frequency", -np.arange(7.0), "must not|must increase"),
        ("outputs", ("1X-", "1X-", "2X+"), "twice"),
        ("outputs", ("1X-", "1Q-", "2X+"), "1Q-"),
        ("values", np.ones((7, 3, 1), complex), "shape"),
        ("kind", "inertance", "receptance, mobility"),
        ("structid_record", "frf 99", "update structid"),
        ("coherence", np.full((7, 3, 2), 1.5), r"0 to 1, got 1.5 of 1X-/3Z- at 1 Hz \(42 such values\)"),
        ("coherence", one_wrong(1.5), r"0 to 1, got 1.5 of 2RZ\+/4RX\+ at 2.5 Hz \(1 such value\)"),
        ("variance", one_wrong(-0.5), r"at least 0, got -0.5 of 2RZ\+/4RX\+ at 2.5 Hz"),
        ("frequency", None, "no field 'frequency'"),
    ],
)
def test_damaged_field(tmp_path, suffix, field, value, word, frf):
    """Files in structid's layout with one field spoiled, written past the checks of the record."""
    from structid.records.formats import layout

    fields = layout.fields_of(frf)
    fields[field] = value
    if value is None:
        del fields[field]
    path = tmp_path / f"a{suffix}"
    with pytest.MonkeyPatch.context() as patch:
        module = sys.modules[{".npz": "structid.records.formats.npz", ".h5": "structid.records.formats.hdf5"}.get(
            suffix, "structid.records.formats.mat")]  # fmt: skip
        patch.setattr(module, "fields_of", lambda record: fields)
        write_record(path, frf)
    with pytest.raises(InputError, match=word) as caught:
        read_record(path)
    assert str(caught.value).startswith(f"{path}:")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_missing_file_suggests(tmp_path, suffix, frf):
    write_record(tmp_path / f"hammer{suffix}", frf)
    with pytest.raises(FileError, match=f"did you mean hammer{suffix}"):
        read_record(tmp_path / f"hamer{suffix}")


FULL_DISK = """
import os, resource, signal, sys
from structid.core.errors import FileError
from structid.records import FrfRecord, TimeRecord, write_record
import numpy as np
import h5py, pyuff, scipy.io
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
folder = sys.argv[1]
rng = np.random.default_rng(1)
record = TimeRecord(100.0, rng.normal(size=(20000, 1)), ("1X+",), ("force",))
frf = FrfRecord(np.arange(1.0, 9001), rng.normal(size=(9000, 1, 1)) + 0j, ("1X+",), ("1X+",), "mobility")
resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))
for suffix in sys.argv[2:]:
    for value in (record, frf):
        path = os.path.join(folder, "a" + suffix)
        try:
            write_record(path, value)
        except FileError as error:
            assert str(error).startswith(path + ": cannot be written"), error
            assert "disk space" in str(error), error
        else:
            raise SystemExit(f"{suffix} was written beyond the limit")
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="limits of file size are of POSIX")
def test_disk_full_keeps_old_files(tmp_path):
    """The system refuses to let any file grow: the nearest to a full disk that needs no privileges."""
    old = {}
    for suffix in SUFFIXES:
        (tmp_path / f"a{suffix}").write_text(f"old {suffix}")
        old[f"a{suffix}"] = f"old {suffix}"
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(tmp_path), *SUFFIXES], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert {entry.name: entry.read_text() for entry in tmp_path.iterdir()} == old


def test_import_is_light():
    heavy = ("h5py", "pyuff", "scipy.io", "scipy.signal")
    code = f"import sys, structid.records; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("suffix", [".npz", ".h5", ".mat"])
def test_complex_histories_are_refused(tmp_path, suffix, history):
    """Their imaginary part was lost with a warning of Python."""
    from structid.records.formats import layout

    fields = {**layout.fields_of(history), "values": history.values * (1 + 1j)}
    with pytest.MonkeyPatch.context() as patch:
        name = {".npz": "npz", ".h5": "hdf5", ".mat": "mat"}[suffix]
        patch.setattr(sys.modules[f"structid.records.formats.{name}"], "fields_of", lambda record: fields)
        write_record(tmp_path / f"a{suffix}", history)
    with pytest.raises(FileError, match="must hold real numbers, got complex"):
        read_record(tmp_path / f"a{suffix}")


def test_convert_to_hdf5_is_made_in_memory(tmp_path, history, monkeypatch):
    """A library that writes to a full disk itself crashes when it closes the file."""
    import h5py

    opened = []
    real = h5py.File

    def watched(name, *arguments, **options):
        opened.append(name)
        return real(name, *arguments, **options)

    monkeypatch.setattr(h5py, "File", watched)
    write_record(tmp_path / "a.h5", history)
    assert not any(isinstance(name, str | os.PathLike) for name in opened)
