"""Records on disk by chunks: the same samples as the whole, whatever the layout, and what is wrong named by its place."""

import h5py
import numpy as np
import pytest

from structid import FileError, InputError, TimeRecord
from structid.records.formats import ReadOptions, write_record
from structid.records.on_disk import MemoryRecord, open_record

CHANNELS, QUANTITIES = ("1X", "2X-", "1X"), ("acceleration", "velocity", "force")
OPTIONS = ReadOptions(sampling_rate=50.0, channels=CHANNELS, quantities=QUANTITIES)
VALUES = np.random.default_rng(0).standard_normal((23, 3))


def whole(record, **part):
    return np.concatenate(list(record.chunks(**part)), axis=1).T


def files(folder):
    """The same record in every layout."""
    np.save(folder / "rows.npy", VALUES)
    np.save(folder / "columns.npy", VALUES.T.copy())
    np.save(folder / "fortran.npy", np.asfortranarray(VALUES))
    with h5py.File(folder / "bare.h5", "w") as file:
        file.create_dataset("test/all", data=VALUES, chunks=(4, 2), compression="gzip")
        file["other"] = np.arange(3.0)
    return ["rows.npy", "columns.npy", "fortran.npy", "bare.h5"]


@pytest.mark.parametrize("longest", [None, 1, 7, 23, 100])
def test_chunks_are_the_record_in_every_layout(tmp_path, longest):
    for name in files(tmp_path):
        record = open_record(tmp_path / name, OPTIONS)
        assert (record.n_times, record.sampling_rate, record.quantities) == (23, 50.0, QUANTITIES)
        assert [str(dof) for dof in record.channels] == ["1X+", "2X-", "1X+"]
        parts = list(record.chunks(longest=longest))
        assert max(part.shape[1] for part in parts) <= (longest or 23)
        assert np.array_equal(np.concatenate(parts, axis=1).T, VALUES)
        assert np.array_equal(whole(record, first=5, last=19, longest=longest), VALUES[5:19])


def test_own_layout_describes_itself_and_memory_records_serve_too(tmp_path):
    kept = TimeRecord(50.0, VALUES, CHANNELS, QUANTITIES)
    write_record(tmp_path / "own.h5", kept)
    for record in (open_record(tmp_path / "own.h5"), MemoryRecord(kept)):
        assert record.channels == kept.channels
        assert (record.quantities, record.n_times, record.sampling_rate) == (QUANTITIES, 23, 50.0)
        assert np.array_equal(whole(record, longest=10), VALUES)


def test_units_and_single_precision_become_si_in_double(tmp_path):
    np.save(tmp_path / "g.npy", VALUES.astype(np.float32))
    units = ReadOptions(sampling_rate=50.0, channels=CHANNELS, units=("g", "mm/s", "kN"))
    found = whole(open_record(tmp_path / "g.npy", units), longest=6)
    assert found.dtype == np.float64
    assert found == pytest.approx(VALUES.astype(np.float32).astype(float) * [9.80665, 1e-3, 1e3], rel=1e-14)


def test_gap_is_named_by_its_sample_and_channel(tmp_path):
    values = VALUES.copy()
    values[17, 1] = np.nan
    values[20, 0] = np.inf
    np.save(tmp_path / "gap.npy", values)
    record = open_record(tmp_path / "gap.npy", OPTIONS)
    assert np.array_equal(whole(record, last=17, longest=5), VALUES[:17])
    with pytest.raises(InputError, match=r"velocity 2X- is missing .* at sample 17, 0.34 s; repair the record"):
        whole(record, longest=5)


def test_large_but_finite_samples_are_no_gap(tmp_path):
    np.save(tmp_path / "large.npy", np.full((4, 3), 1e308))
    with np.errstate(over="ignore"):
        assert whole(open_record(tmp_path / "large.npy", OPTIONS)).max() == 1e308


@pytest.mark.parametrize("name", ["rows.npy", "bare.h5"])
def test_record_that_shrinks_while_it_is_read_is_told_with_the_sample(tmp_path, name):
    files(tmp_path)
    record = open_record(tmp_path / name, OPTIONS)
    chunks = record.chunks(longest=5)
    next(chunks), next(chunks)
    if name == "rows.npy":
        np.save(tmp_path / name, VALUES[:12])
    else:
        with h5py.File(tmp_path / name, "w") as file:
            file["test/all"] = VALUES[:12]
    with pytest.raises(FileError, match=r"had 23 samples, and has 12 at sample 10; .* resume from sample 10"):
        next(chunks)


def test_file_cut_short_is_told(tmp_path):
    files(tmp_path)
    record = open_record(tmp_path / "rows.npy", OPTIONS)
    data = (tmp_path / "rows.npy").read_bytes()
    (tmp_path / "rows.npy").write_bytes(data[:-50])
    with pytest.raises(FileError, match=r"cannot be read at sample 0 .* cut short: copy or write it again"):
        next(record.chunks())
    with pytest.raises(FileError, match="cut short"):
        open_record(tmp_path / "rows.npy", OPTIONS)
    data = (tmp_path / "bare.h5").read_bytes()
    (tmp_path / "bare.h5").write_bytes(data[: len(data) // 2])
    with pytest.raises(FileError, match="cut short"):
        open_record(tmp_path / "bare.h5", OPTIONS)


BAD = {
    "no rate": ("rows.npy", ReadOptions(channels=CHANNELS, quantities=QUANTITIES), "give `sampling_rate` in"),
    "no quantities": ("rows.npy", ReadOptions(sampling_rate=1.0, channels=CHANNELS), "quantities"),
    "channels": (
        "rows.npy",
        ReadOptions(sampling_rate=1.0, channels=("1X", "2X"), quantities=("force", "velocity")),
        "samples by 2 channels, got shape \\(23, 3\\)",
    ),
    "twice": (
        "rows.npy",
        ReadOptions(sampling_rate=1.0, channels=("1X", "1X-", "2X"), quantities=("velocity",)),
        "velocity 1X\\+ is there twice",
    ),
    "start": (
        "rows.npy",
        ReadOptions(sampling_rate=1.0, channels=CHANNELS, quantities=QUANTITIES, start=2.0),
        "does not use start",
    ),
    "array": (
        "bare.h5",
        ReadOptions(sampling_rate=1.0, channels=CHANNELS, quantities=QUANTITIES, array="x"),
        "holds the arrays test/all.*; say which to read with `array` in the study.*--array",
    ),
    "format": ("text.csv", OPTIONS, "read by chunks from .npy, .h5 or .hdf5; convert it"),
    "complex": ("complex.npy", OPTIONS, "must hold real numbers"),
    "empty": ("empty.npy", OPTIONS, "holds no sample"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused_with_what_would_help(tmp_path, case):
    name, options, words = BAD[case]
    files(tmp_path)
    (tmp_path / "text.csv").write_text("1,2,3\n")
    np.save(tmp_path / "complex.npy", VALUES * 1j)
    np.save(tmp_path / "empty.npy", VALUES[:0])
    with pytest.raises((InputError, FileError), match=words):
        open_record(tmp_path / name, options)


def test_part_of_a_record_must_lie_within_it(tmp_path):
    files(tmp_path)
    record = open_record(tmp_path / "rows.npy", OPTIONS)
    with pytest.raises(InputError, match="must lie from 0 to 23 in this order, got 5 and 40"):
        whole(record, first=5, last=40)
    with pytest.raises(InputError, match="`longest` must be 1 or more"):
        whole(record, longest=0)
