"""Compiled libraries read in a child: what ends, hangs or fills it is told with the name of the file."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import psutil
import pytest

from structid.core.errors import FileError
from structid.files import contained as module
from structid.files.contained import ReaderError, hdf5_datasets, hdf5_fields, hdf5_part, read_in_child
from structid.records import ReadOptions, TimeRecord, read_record, write_record
from structid.records.on_disk import open_record

VALUES = np.random.default_rng(1).standard_normal((50, 2))
HISTORY = TimeRecord(10.0, VALUES, ("1X", "2X"), ("force", "velocity"))
BARE = ReadOptions(sampling_rate=10.0, channels="1X,2X", units="N", array="a")

#: A child that ends, sleeps, or answers in part, as the path says.
STRANGE = """
import json, os, sys, time
print("ready", flush=True)
for n, line in enumerate(sys.stdin):
    request = json.loads(line)
    name = os.path.basename(request["path"])
    if name.startswith("crash") or (name.startswith("second") and n > 0):
        os.abort()
    if name.startswith("hang"):
        time.sleep(60)
    if name.startswith("half"):
        print(json.dumps({"tree": {"array": 0}, "arrays": [["<f8", [100]]]}), flush=True)
        os._exit(0)
    if name.startswith("error"):
        print(json.dumps({"error": "ValueError", "words": "no such thing"}), flush=True)
    else:
        print(json.dumps({"tree": {"list": [name, n]}, "arrays": []}), flush=True)
"""


@pytest.fixture
def strange(tmp_path, monkeypatch):
    (tmp_path / "strange.py").write_text(STRANGE)
    module.end()
    monkeypatch.setattr(module, "_SCRIPT", str(tmp_path / "strange.py"))
    yield lambda name: read_in_child(named(tmp_path, name), "any")
    module.end()


def named(folder: Path, name: str) -> Path:
    (folder / name).write_text("x")
    return folder / name


def test_what_ends_the_child_is_told_and_the_next_file_is_read(strange, tmp_path, monkeypatch):
    assert strange("good") == ["good", 0]
    with pytest.raises(FileError, match=r"crash\.h5: cannot be read: the library that reads such files ended on it"):
        strange("crash.h5")
    assert strange("good") == ["good", 0]
    with pytest.raises(FileError, match=r"half\.h5: cannot be read"):
        strange("half.h5")
    with pytest.raises(ReaderError, match="no such thing"):
        strange("error.h5")
    assert strange("good") == ["good", 0]  # a new child: damage may have left the old one in any state
    monkeypatch.setattr(module, "_SECONDS", 0.2)
    with pytest.raises(FileError, match=r"hang\.h5: cannot be read: .* took more than 0 s"):
        strange("hang.h5")


def test_a_mistake_of_a_reader_is_no_damage_of_a_file(tmp_path, monkeypatch):
    """An attribute that does not exist is missed by the reader's own line; one that h5py misses tells of the file."""
    worker = Path(module._SCRIPT)
    script = tmp_path / worker.name
    slip = (
        "def hdf5_shapes(path):\n    return None.shape\n\n\ndef hdf5_attributes(path):\n    return json.loads(None)\n"
    )
    text = worker.read_text().replace("READERS: dict", f"{slip}\n\nREADERS: dict")
    script.write_text(text)
    module.end()
    monkeypatch.setattr(module, "_SCRIPT", str(script))
    path = named(tmp_path, "a.h5")
    try:
        with pytest.raises(RuntimeError, match=r"the reader of .*a\.h5 has a mistake: .*'shape'"):
            hdf5_datasets(path)
        with pytest.raises(FileError, match=r"a\.h5: is damaged, cut short or not HDF5"):
            module.hdf5_attributes(path)
    finally:
        module.end()


def test_texts_where_numbers_belong_are_damage_of_the_file(tmp_path):
    """NumPy's compiled code raises on them in a line of the reader."""
    texts = np.zeros(4, [("real", "S4"), ("imag", "S4")])
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["a"] = texts
    with h5py.File(tmp_path / "b.mat", "w", userblock_size=512) as file:
        file["a"] = texts
        file["a"].attrs["MATLAB_class"] = np.bytes_("double")
    with (tmp_path / "b.mat").open("r+b") as opened:
        opened.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    with pytest.raises(FileError, match=r"a\.h5: is damaged, cut short or not HDF5"):
        hdf5_fields(tmp_path / "a.h5", ["a"])
    with pytest.raises(FileError, match=r"b\.mat: "):
        read_record(tmp_path / "b.mat", BARE)


def test_a_child_that_others_have_left_damaged_is_no_reason_to_refuse_a_file(strange):
    assert strange("good") == ["good", 0]
    assert strange("second.h5") == ["second.h5", 0]


def test_a_small_file_costs_little(tmp_path):
    """Behind the first file of a process, which starts the child; processor time of both."""
    write_record(tmp_path / "a.h5", HISTORY)
    read_record(tmp_path / "a.h5")

    def used() -> float:
        child = psutil.Process(module._running[0].process.pid).cpu_times()
        return time.process_time() + child.user + child.system

    begun = used()
    for _ in range(20):
        read_record(tmp_path / "a.h5")
    assert used() - begun < 20 * 0.05


def test_declared_sizes_do_not_take_memory(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("a", shape=(10**9, 2), chunks=(1000, 2), dtype="f8")[:1000] = 1.0
    with pytest.raises(FileError, match=r"'a' declares 16000000000 bytes in a file of"):
        read_record(tmp_path / "a.h5", BARE)


def test_values_in_other_files_are_refused(tmp_path):
    """A file could otherwise bring the bytes of any other into a result, and read as zeros where that is gone."""
    (tmp_path / "secret").write_bytes(VALUES.tobytes())
    with h5py.File(tmp_path / "outside.h5", "w") as file:
        file.create_dataset("a", (50, 2), "f8", external=[(str(tmp_path / "secret"), 0, 800)])
    with h5py.File(tmp_path / "source.h5", "w") as file:
        file["a"] = VALUES
    with h5py.File(tmp_path / "linked.h5", "w") as file:
        file["deep/a"] = h5py.ExternalLink("source.h5", "/a")
    layout = h5py.VirtualLayout((50, 2), "f8")
    layout[:] = h5py.VirtualSource("gone.h5", "a", (50, 2))
    with h5py.File(tmp_path / "virtual.h5", "w") as file:
        file.create_virtual_dataset("a", layout)
    with h5py.File(tmp_path / "empty.h5", "w") as file:
        file.create_dataset("a", (50, 2), "f8")
    words = {
        "outside.h5": "'a' has its values in another file",
        "linked.h5": "'deep/a' is a link to another file",
        "virtual.h5": "'a' is put together from other files",
        "empty.h5": "'a' was never written",
    }
    for name, said in words.items():
        with pytest.raises(FileError, match=said) as caught:
            read_record(tmp_path / name, BARE)
        assert str(caught.value).startswith(str(tmp_path / name))
        with pytest.raises(FileError, match=said):
            list(open_record(tmp_path / name, BARE).chunks())


def test_contiguous_datasets_are_read_from_where_they_lie(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w", userblock_size=1024) as file:
        file["whole"], file["text"] = VALUES, "words"
        file.create_dataset("big", data=VALUES, dtype=">f4")
        file.create_dataset("pieces", data=VALUES, chunks=(7, 2), compression="gzip")
    found = hdf5_datasets(tmp_path / "a.h5")
    assert [found[name].offset for name in ("pieces", "text")] == [None, None]
    for name in ("whole", "big"):
        values = np.fromfile(tmp_path / "a.h5", found[name].dtype, 100, offset=found[name].offset)
        np.testing.assert_array_equal(values.reshape(50, 2), VALUES.astype(found[name].dtype))
    np.testing.assert_array_equal(hdf5_part(tmp_path / "a.h5", "pieces", 5, 9, 0), VALUES[5:9])
    np.testing.assert_array_equal(hdf5_part(tmp_path / "a.h5", "pieces", 1, 2, 1), VALUES[:, 1:2])
    assert hdf5_fields(tmp_path / "a.h5", ["text"]) == {"text": "words"}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="of POSIX")
def test_a_forked_process_has_a_child_of_its_own(tmp_path):
    write_record(tmp_path / "a.h5", HISTORY)
    code = (
        "import os, sys, numpy as np\nfrom structid.records import read_record\n"
        "first = read_record(sys.argv[1])\npid = os.fork()\n"
        "again = read_record(sys.argv[1])\nassert np.array_equal(first.values, again.values)\n"
        "if pid:\n    assert os.waitpid(pid, 0)[1] == 0\n    read_record(sys.argv[1])\n"
    )
    import subprocess

    words = [sys.executable, "-W", "ignore::DeprecationWarning", "-c", code, str(tmp_path / "a.h5")]
    done = subprocess.run(words, capture_output=True, text=True, timeout=600, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit of processor time")
def test_a_child_that_nobody_is_left_to_end_ends_itself(tmp_path):
    """A reader that never comes back, its parent gone: the limit of its processor time ends it."""
    script = tmp_path / "spin.py"
    text = Path(module._SCRIPT).read_text(encoding="utf-8")
    spin = 'def spin(path):\n    while True:\n        pass\n\n\nREADERS["spin"] = spin\n\n\nif __name__'
    script.write_text(text.replace("if __name__", spin), encoding="utf-8")
    request = json.dumps({"reader": "spin", "path": str(script), "options": {}, "seconds": 0.5})
    child = subprocess.Popen([sys.executable, "-P", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        assert child.stdin is not None
        child.stdin.write(request.encode() + b"\n")
        child.stdin.flush()
        assert child.wait(timeout=600) < 0
    finally:
        child.kill()
        for stream in (child.stdin, child.stdout):
            assert stream is not None
            stream.close()
