"""Gaps and unequal clocks in files: named with channel, sample and remedy, and the remedy works."""

import numpy as np
import pytest

from structid import FileError, InputError
from structid.records import ReadOptions, TimeRecord, read_record, write_record
from structid.records.formats.uff import uff

N, RATE = 400, 100.0
TIME = np.arange(N) / RATE
CLEAN = np.stack([np.sin(2 * TIME), np.cos(3 * TIME)], axis=1)


def spoiled():
    values = np.array(CLEAN)
    values[100:103, 1] = np.nan
    values[250, 1] = np.inf
    return values


def csv(path, values, blank=False):
    cells = [[repr(float(t)), *("" if blank and not np.isfinite(v) else repr(float(v)) for v in row)]
             for t, row in zip(TIME, values, strict=True)]  # fmt: skip
    path.write_text("time_s,1X+ [m],2X+ [m]\n" + "".join(",".join(row) + "\n" for row in cells))


@pytest.fixture(params=["npy", "npz", "csv", "csv_blank", "uff"])
def gapped(request, tmp_path):
    """A file with two gaps in its second channel, of three samples and of one; and the options to read it."""
    options = {}
    path = tmp_path / f"a.{request.param.partition('_')[0]}"
    if request.param.startswith("csv"):
        csv(path, spoiled(), blank=request.param == "csv_blank")
    elif request.param == "uff":
        record = TimeRecord(
            RATE, np.where(np.isfinite(spoiled()), spoiled(), 77.0), ("1X", "2X"), ("displacement",) * 2
        )
        write_record(path, record)
        data, mark = path.read_bytes(), np.float64(77.0).tobytes()
        assert data.count(mark) == 4
        path.write_bytes(data.replace(mark, np.float64(np.nan).tobytes()))
    else:
        np.save(path, spoiled()) if request.param == "npy" else np.savez(path, motion=spoiled())
        options = {"sampling_rate": RATE, "channels": "1X,2X", "quantities": "displacement"}
    return path, options


def test_gap_named_with_remedies_that_work(gapped):
    path, options = gapped
    with pytest.raises(FileError) as caught:
        read_record(path, ReadOptions(**options))
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    for words in (
        "channel 2X+",
        "for 3 samples from sample 100 (1 s) on",
        "in 1 of 2 channels there are 2 gaps of 4 samples",
    ):
        assert words in message
    assert "`start = 2.51` and `stop = 3.99` in the study, beside `path`, or in ReadOptions (--start" in message
    assert "`longest_gap = 3` in the study, beside `path`, or in ReadOptions (--longest-gap 3" in message
    cut = read_record(path, ReadOptions(**options, start=2.51, stop=3.99))
    assert np.allclose(cut.values, CLEAN[251:], atol=1e-15)
    assert cut.start == pytest.approx(2.51)
    whole = read_record(path, ReadOptions(**options, longest_gap=3))
    assert np.abs(whole.values - CLEAN).max() < 1e-5
    assert whole.source == f"{path}; samples invented to fill gaps, of 400: 2X+ 4"
    with pytest.raises(FileError, match="longest_gap = 3"):
        read_record(path, ReadOptions(**options, longest_gap=2))


def test_gap_of_a_channel_left_out_does_not_count(tmp_path):
    csv(tmp_path / "a.csv", spoiled())
    with pytest.raises(FileError, match=r"line 102, column 3 \(channel 2X\+\).*leave the channel out with `channels`"):
        read_record(tmp_path / "a.csv")
    record = read_record(tmp_path / "a.csv", ReadOptions(channels="1X"))
    assert np.array_equal(record.values[:, 0], CLEAN[:, 0])
    assert record.source == str(tmp_path / "a.csv")


def test_gap_at_the_end_is_not_filled(tmp_path):
    values = np.array(CLEAN)
    values[-2:, 0] = np.nan
    csv(tmp_path / "a.csv", values)
    with pytest.raises(FileError) as caught:
        read_record(tmp_path / "a.csv", ReadOptions(longest_gap=5))
    assert "longest_gap" not in str(caught.value)
    assert "`start = 0.0` and `stop = 3.97` in the study, beside `path`" in str(caught.value)


def test_missing_lines_are_counted(tmp_path):
    path = tmp_path / "a.csv"
    csv(path, CLEAN)
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:100] + lines[105:]))
    with pytest.raises(FileError, match=r"line 101, column 1: time must be even.*5 lines are missing"):
        read_record(path)


def test_unequal_clocks_named(tmp_path):
    """Channels of other rates, lengths or starts in one universal file."""
    first = TimeRecord(RATE, CLEAN[:, :1], ("1X",), ("displacement",))
    others = {
        "slow": (TimeRecord(50.0, CLEAN[::2, 1:], ("2X",), ("displacement",)), "200 samples every 0.02 s"),
        "late": (TimeRecord(RATE, CLEAN[:, 1:], ("2X",), ("displacement",), start=0.005), "from 0.005 s on"),
        "drift": (TimeRecord(RATE * 1.001, CLEAN[:, 1:], ("2X",), ("displacement",)), "every 0.00999001 s"),
    }
    for name, (other, words) in others.items():
        path = tmp_path / f"{name}.uff"
        path.write_bytes(b"".join(uff.file_bytes(path, first, None)) + b"".join(uff.file_bytes(path, other, None)))
        with pytest.raises(FileError, match=r"channel 2X\+ runs on another clock than channel 1X\+") as caught:
            read_record(path)
        assert str(caught.value).startswith(f"{path}: ")
        assert words in str(caught.value)
        assert "`prepare`" in str(caught.value)


@pytest.mark.parametrize("settings", [{"start": 9.0}, {"stop": -1.0}])
def test_empty_interval_refused(tmp_path, settings):
    csv(tmp_path / "a.csv", CLEAN)
    with pytest.raises(InputError, match=r"no sample is left of 0-3\.99 s"):
        read_record(tmp_path / "a.csv", ReadOptions(**settings))


@pytest.mark.parametrize("settings", [{"start": np.nan}, {"stop": "3"}, {"longest_gap": 0}, {"longest_gap": 1.5}])
def test_options_refused(settings):
    with pytest.raises(InputError, match=f"`{next(iter(settings))}`"):
        ReadOptions(**settings)


@pytest.mark.parametrize("suffix", [".npz", ".h5", ".mat", ".csv", ".uff"])
def test_part_of_a_whole_file(tmp_path, suffix):
    record = TimeRecord(RATE, CLEAN, ("1X", "2X"), ("displacement",) * 2, start=5.0)
    write_record(tmp_path / f"a{suffix}", record)
    part = read_record(tmp_path / f"a{suffix}", ReadOptions(start=6.0, stop=7.0))
    assert np.array_equal(part.values, CLEAN[100:201])
    assert part.start == pytest.approx(6.0)
    assert np.array_equal(read_record(tmp_path / f"a{suffix}", ReadOptions(longest_gap=4)).values, CLEAN)


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_options_of_histories_refused_for_frfs(tmp_path, suffix, frf):
    write_record(tmp_path / f"a{suffix}", frf)
    with pytest.raises(InputError, match="leave out `start`"):
        read_record(tmp_path / f"a{suffix}", ReadOptions(start=1.0))
