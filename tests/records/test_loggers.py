"""Files that other libraries write are read as they are; what is damaged, missing or does not fit is refused in words."""

import sys
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from logger_cases import FILE_NAMES, NAMES, RATE, SAYS_UNITS, STARTS, UNITS, VALUES, WRITERS, is_there, write

from structid.core.errors import FileError, InputError
from structid.files.loggers import PACKAGES, logger
from structid.records import ReadOptions, read_record, write_record
from structid.records.formats import LOGGERS

BY_KIND = {one.kind: one for one in LOGGERS}
FACTORS = np.array([9.80665, 1.0, 1.0])


def whole(kind, tmp_path):
    if not is_there(PACKAGES[kind]):
        pytest.skip(f"{PACKAGES[kind]} is not installed: pip install structid[{BY_KIND[kind].extra}]")
    path = tmp_path / f"a{BY_KIND[kind].SUFFIXES[0]}"
    write(kind, path)
    return path


def options(kind, **more):
    units = {} if kind in SAYS_UNITS else {"units": UNITS}
    return ReadOptions(**{"channels": "1X,2Y-,3Z", **units, **more})


def test_every_format_has_a_file_of_its_own_library():
    assert set(BY_KIND) == set(WRITERS) == set(PACKAGES)


@pytest.mark.parametrize("kind", WRITERS)
def test_a_file_of_its_own_library(kind, tmp_path):
    record = read_record(whole(kind, tmp_path), options(kind))
    np.testing.assert_allclose(record.values, VALUES * FACTORS, rtol=1e-12)
    assert record.sampling_rate == pytest.approx(RATE, rel=1e-12)
    assert record.start == pytest.approx(STARTS[kind])
    assert [str(dof) for dof in record.channels] == ["1X+", "2Y-", "3Z+"]
    assert record.quantities == ("acceleration", "acceleration", "force")
    assert f"3 channels, 300 samples at 512 Hz, units g, m/s^2, N, {BY_KIND[kind].words}" in record.source


@pytest.mark.parametrize("kind", WRITERS)
def test_channels_are_chosen_by_name_and_number(kind, tmp_path):
    path, names = whole(kind, tmp_path), FILE_NAMES.get(kind, NAMES)
    first = 2 if kind == "parquet" else 1
    given = {} if kind in SAYS_UNITS else {"units": "N,g"}
    found = read_record(path, ReadOptions(columns=(names[2], first), channels="7X,8X", **given))
    np.testing.assert_allclose(found.values, (VALUES * FACTORS)[:, [2, 0]], rtol=1e-12)
    with pytest.raises(InputError, match=r"no column 'Strain'; the file has \d '"):
        read_record(path, options(kind, columns="Strain,1,2"))
    with pytest.raises(InputError, match=r"`channels` must have 3 entries"):
        read_record(path, options(kind, channels="1X,2X"))
    with pytest.raises(InputError, match=r"channel \d \('.*'\): .*`channels`, in the order of the columns"):
        read_record(path)
    if kind != "parquet":  # its clock is a column
        with pytest.raises(InputError, match="512 Hz, but `sampling_rate` 500"):
            read_record(path, options(kind, sampling_rate=500))


def read_or_refused(path, given):
    """The record at `path`, None where it is refused as it should."""
    try:
        return read_record(path, given)
    except FileError as error:
        message = str(error)
    assert message.startswith(f"{path}: ")
    return None


@pytest.mark.parametrize("kind", WRITERS)
def test_damage_is_refused(kind, tmp_path):
    path = whole(kind, tmp_path)
    data = path.read_bytes()
    read = 0
    for cut in (len(data) * np.array([0.1, 0.4, 0.75, 0.97])).astype(int):
        path.write_bytes(data[:cut])
        found = read_or_refused(path, options(kind))
        if found is not None:
            read += 1  # whole blocks of a stream are a shorter stream, of the same samples
            np.testing.assert_allclose(found.values, (VALUES * FACTORS)[: len(found.values)], rtol=1e-12)
    assert read <= (3 if kind in ("miniseed", "tdms") else 0)
    for junk in (b"", b"\0" * 700, data[:60] + b"\xff" * 60 + data[120:200]):
        path.write_bytes(junk)
        with pytest.raises(FileError) as caught:
            read_record(path, options(kind))
        assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize("kind", [kind for kind in WRITERS if BY_KIND[kind].extra])
def test_a_missing_library_is_named_with_its_extra(kind, tmp_path, monkeypatch):
    path = tmp_path / f"a{BY_KIND[kind].SUFFIXES[0]}"
    path.write_bytes(b"x")
    monkeypatch.setattr("structid.records.formats.loggers.find_spec", lambda name: None)
    with pytest.raises(FileError, match=rf"need the package \w+; pip install structid\[{kind}\]"):
        read_record(path, options(kind))


def test_they_are_not_written(tmp_path, history):
    for one in LOGGERS:
        with pytest.raises(FileError, match=f"{one.words} files are read only; write .npz"):
            write_record(tmp_path / f"a{one.SUFFIXES[0]}", history)


@pytest.mark.parametrize(
    ("name", "words"),
    [("a.dxd", "export as UFF, TDMS, MAT or CSV from DewesoftX"), ("a.xlsx", "save the sheet as CSV UTF-8")],
)
def test_files_that_others_must_export_say_how(tmp_path, name, words):
    with pytest.raises(FileError, match=words):
        read_record(tmp_path / name)


def test_wav_of_whole_numbers_is_in_parts_of_full_scale(tmp_path):
    from scipy.io import wavfile

    counts = np.array([[0, 16384], [-32768, 8192], [1, 2]], dtype=np.int16)
    wavfile.write(tmp_path / "a.wav", 100, counts)
    found = read_record(tmp_path / "a.wav", ReadOptions(channels="1X,2X", units="m/s^2"))
    np.testing.assert_allclose(found.values, counts / 32768)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_gaps_and_other_starts_of_miniseed(tmp_path):
    obspy = pytest.importorskip("obspy", reason="needs structid[miniseed]")
    path, start = tmp_path / "a.mseed", obspy.UTCDateTime(2026, 1, 1)

    def trace(name, first, last, shift=0.0):
        header = {"channel": name, "sampling_rate": RATE, "starttime": start + first / RATE + shift}
        return obspy.Trace(VALUES[first:last, 0].copy(), header=header)

    given = ReadOptions(channels="1X,2X", units="N", longest_gap=None)
    obspy.Stream([trace("HNX", 0, 300), trace("HNY", 20, 290)]).write(str(path), format="MSEED")
    found = read_record(path, given)
    np.testing.assert_allclose(found.values, np.repeat(VALUES[20:290, :1], 2, axis=1))
    assert (found.start, "cut to the span that all channels have" in found.source) == (
        pytest.approx(20 / RATE, abs=1e-6),
        True,
    )
    obspy.Stream([trace("HNX", 0, 300), trace("HNY", 0, 100), trace("HNY", 102, 300)]).write(str(path), format="MSEED")
    with pytest.raises(FileError, match=r"channel 2X\+ is NaN or infinite for 2 samples from sample 100"):
        read_record(path, given)
    obspy.Stream([trace("HNX", 0, 300), trace("HNY", 0, 300, 0.4 / RATE)]).write(str(path), format="MSEED")
    with pytest.raises(InputError, match=r"sampled 0\.4 of a step beside the others"):
        read_record(path, given)


def test_a_file_that_ends_early_says_so(tmp_path):
    """What is there is read, as after a power failure; how it was read tells that it is not all."""
    nptdms = pytest.importorskip("nptdms", reason="needs structid[tdms]")
    path, given = tmp_path / "a.tdms", ReadOptions(channels="1X")
    with nptdms.TdmsWriter(str(path)) as writer:
        writer.write_segment(
            [nptdms.ChannelObject("a", "b", VALUES[:, 0], properties={"wf_increment": 0.01, "unit_string": "N"})]
        )
    assert "ends within" not in read_record(path, given).source
    path.write_bytes(path.read_bytes()[:-800])
    found = read_record(path, given)
    np.testing.assert_array_equal(found.values[:, 0], VALUES[:-100, 0])
    assert "the file ends within its last segment: the copy, or the logger, broke off" in found.source


def test_channels_of_two_rates_are_chosen_from(tmp_path):
    nptdms = pytest.importorskip("nptdms", reason="needs structid[tdms]")
    path = tmp_path / "a.tdms"
    parts = [
        nptdms.ChannelObject("fast", "a", np.arange(40.0), properties={"wf_increment": 0.01, "unit_string": "N"}),
        nptdms.ChannelObject("slow", "a", np.arange(4.0), properties={"wf_increment": 0.1, "unit_string": "N"}),
        nptdms.ChannelObject("notes", "t", ["x", "y"]),
    ]
    with nptdms.TdmsWriter(str(path)) as writer:
        writer.write_segment(parts)
    with pytest.raises(InputError, match="'slow/a' is sampled at 10 Hz and 'fast/a' at 100 Hz; choose"):
        read_record(path, ReadOptions(channels="1X,2X"))
    assert read_record(path, ReadOptions(columns="slow/a", channels="1X")).sampling_rate == pytest.approx(10)


def test_uneven_times_and_times_without_a_rate(tmp_path):
    pa = pytest.importorskip("pyarrow", reason="needs structid[parquet]")
    from pyarrow import parquet

    path = tmp_path / "a.parquet"
    time = np.arange(50) * 2.0

    def written(**columns):
        parquet.write_table(pa.table(columns), str(path))
        return path

    milli = written(**{"t [ms]": time, "1X [N]": np.arange(50.0)})
    assert read_record(milli).sampling_rate == pytest.approx(500)
    with pytest.raises(InputError, match="even, increasing times"):
        read_record(written(**{"t [ms]": time**2, "1X [N]": np.arange(50.0)}))
    with pytest.raises(InputError, match="does not say its sampling rate; give `sampling_rate`"):
        read_record(written(**{"1X [N]": np.arange(50.0)}))
    stamps = pa.array((time * 1e6).astype("int64"), pa.timestamp("ns"))
    assert read_record(written(**{"timestamp": stamps, "1X [N]": np.arange(50.0)})).sampling_rate == pytest.approx(500)
    with pytest.raises(FileError, match="no channel besides its times"):
        read_record(written(time=time))


@pytest.mark.parametrize(("jitter", "words"), [(0.0, "holds 500 times a second"), (0.2, "hold 500 samples a second")])
def test_a_stated_rate_must_agree_with_the_times(tmp_path, jitter, words):
    pa = pytest.importorskip("pyarrow", reason="needs structid[parquet]")
    from pyarrow import parquet

    path, numbers = tmp_path / "a.parquet", np.arange(51.0)
    times = numbers + jitter * np.sin(np.pi * numbers / 4) * (numbers > 0) * (numbers < 50)
    parquet.write_table(pa.table({"t [ms]": 2.0 * times, "1X [N]": numbers}), str(path))
    assert read_record(path, ReadOptions(sampling_rate=500, resample="spline")).sampling_rate == pytest.approx(500)
    with pytest.raises(InputError, match=rf"{words}, but `sampling_rate` 1000 was given"):
        read_record(path, ReadOptions(sampling_rate=1000, resample="spline"))


def test_what_the_library_of_miniseed_warns_of_is_told_and_the_file_is_read(monkeypatch):
    """Records are checked one by one there, so that a warning is no damage."""
    stats = SimpleNamespace(npts=4, sampling_rate=10.0, starttime=0.0)
    trace = SimpleNamespace(id="XX.A..HNZ", stats=stats, data=np.arange(4.0))

    class Stream(list):
        def merge(self, method):
            warnings.warn("record 7 has an odd encoding", UserWarning, stacklevel=2)

    monkeypatch.setitem(sys.modules, "obspy", SimpleNamespace(read=lambda path, format: Stream([trace])))
    channel = logger("a.mseed", "miniseed")[0]
    np.testing.assert_array_equal(channel.values, np.arange(4.0))
    assert channel.note == "record 7 has an odd encoding"


def test_a_waveform_of_labview_in_ms(tmp_path):
    from nptdms import ChannelObject, TdmsWriter

    clock = {"wf_increment": 5.0, "wf_start_offset": 100.0, "wf_xunit_string": "ms", "unit_string": "g"}
    for unit, rate in (("ms", 200), ("s", 0.2)):
        path = tmp_path / f"{unit}.tdms"
        with TdmsWriter(str(path)) as writer:
            writer.write_segment([ChannelObject("a", "b", np.arange(9.0), clock | {"wf_xunit_string": unit})])
        assert read_record(path, ReadOptions(channels="1X")).sampling_rate == pytest.approx(rate)
    path = tmp_path / "spectrum.tdms"
    with TdmsWriter(str(path)) as writer:
        writer.write_segment([ChannelObject("a", "b", np.arange(9.0), clock | {"wf_xunit_string": "Hz"})])
    with pytest.raises(FileError, match="'Hz' as the unit of a time"):
        read_record(path, ReadOptions(channels="1X"))


def test_a_point_in_an_lvm_file_of_decimal_commas_is_refused(tmp_path):
    path = whole("lvm", tmp_path)
    before, _, after = path.read_text().rpartition(",")
    path.write_text(f"{before}.{after}")
    with pytest.raises(FileError, match="its head says decimal commas, and it holds "):
        read_record(path, options("lvm"))


def test_an_lvm_file_of_several_segments_is_sound_and_said_to_hold_them(tmp_path):
    path = whole("lvm", tmp_path)
    text = path.read_text(encoding="cp1252")
    end = text.index("***End_of_Header***") + len("***End_of_Header***\n")
    path.write_text(text + text[end:], encoding="cp1252")
    with pytest.raises(FileError, match=r"it holds 2 segments, .*save each in a file of its own") as told:
        read_record(path, options("lvm"))
    assert "damaged" not in str(told.value)


@pytest.mark.parametrize("old, new, words", [
    ("X_Dimension\tTime", "X_Dimension\tFrequency", "over Frequency, not over time"),
    ("X_Columns\tNo", "X_Columns\tMulti", "3 channels, and it has 2 names"), ("LabVIEW", "Lab", "does not begin with LabVIEW"),
    ("Samples\t300\t300\t300", "Samples\t150\t150\t150", "it holds 300; several writings without times"),
    ("Samples\t300", "Samples\t301", "says 301 samples of 'Acc A', and it holds 300"),
    ("***End_of_Header***\nChannels", "***End_of_Header***\n***End_of_Header***\nChannels", "it holds 2 segments"),
])  # fmt: skip
def test_text_of_labview_that_says_something_else_is_refused(tmp_path, old, new, words):
    path = whole("lvm", tmp_path)
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(FileError, match=words):
        read_record(path, options("lvm"))


def test_channels_of_labview_that_start_at_other_times_are_brought_together(tmp_path):
    from datetime import datetime

    from nptdms import ChannelObject, TdmsWriter

    path = tmp_path / "a.tdms"
    clock = {"wf_increment": 0.01, "unit_string": "N"}
    starts = {"1X": datetime(2026, 1, 1, 12, 0, 0), "2X": datetime(2026, 1, 1, 12, 0, 0, 300000)}
    with TdmsWriter(str(path)) as writer:
        writer.write_segment([
            ChannelObject("T", name, np.arange(100.0), clock | {"wf_start_time": start}) for name, start in starts.items()
        ])  # fmt: skip
    record = read_record(path)
    assert record.start == pytest.approx(0.3)
    np.testing.assert_array_equal(record.values, np.stack([np.arange(30.0, 100), np.arange(70.0)], axis=1))


def test_a_channel_of_labview_without_a_start_beside_others_is_said(tmp_path):
    from datetime import datetime

    from nptdms import ChannelObject, TdmsWriter

    path, clock = tmp_path / "a.tdms", {"wf_increment": 0.01, "unit_string": "N"}
    with TdmsWriter(str(path)) as writer:
        writer.write_segment([
            ChannelObject("T", "1X", np.arange(9.0), clock | {"wf_start_time": datetime(2026, 1, 1)}),
            ChannelObject("T", "2X", np.arange(9.0), clock),
        ])  # fmt: skip
    record = read_record(path)
    assert "2X does not say when it starts, taken as the first that does" in record.source
    assert "1X does not say" not in record.source


def test_channels_of_labview_without_a_clock_or_not_chosen_are_not_said(tmp_path):
    from datetime import datetime

    from nptdms import ChannelObject, TdmsWriter

    path, clock = tmp_path / "a.tdms", {"wf_increment": 0.01, "unit_string": "N"}
    started = clock | {"wf_start_time": datetime(2026, 1, 1)}
    with TdmsWriter(str(path)) as writer:
        writer.write_segment([
            ChannelObject("T", "1X", np.arange(9.0), started),
            ChannelObject("T", "2X", np.arange(9.0), clock),
            ChannelObject("S", "peak", np.arange(3.0), {"unit_string": "N"}),
        ])  # fmt: skip
    assert (
        "2X does not say when it starts"
        in read_record(path, ReadOptions(columns=("T/1X", "T/2X"), channels="1X,2X")).source
    )
    assert "does not say" not in read_record(path, ReadOptions(columns=("T/1X",), channels="1X")).source
    assert not [one.note for one in logger(str(path), "tdms") if one.name == "S/peak" and one.note]


def test_decimal_numbers_of_parquet_are_numbers(tmp_path):
    pa = pytest.importorskip("pyarrow", reason="needs structid[parquet]")
    from pyarrow import parquet

    exact = pa.array(np.arange(20.0) / 4).cast(pa.decimal128(9, 2))
    columns = {"time [s]": pa.array(np.arange(20.0) / 8), "1X [N]": np.arange(20.0), "2X [N]": exact}
    parquet.write_table(pa.table(columns), str(tmp_path / "a.parquet"))
    record = read_record(tmp_path / "a.parquet")
    assert [dof.place for dof in record.channels] == ["1X", "2X"]
    assert record.values[:, 1].tolist() == (np.arange(20.0) / 4).tolist()


def test_text_of_labview_in_ms_and_with_times_that_its_head_contradicts(tmp_path):
    path = whole("lvm", tmp_path)
    text = path.read_text()
    head = "X_Dimension\tTime\tTime\tTime\n"
    path.write_text(text.replace(head, f"{head}X_Unit_Label\tms\tms\tms\n"))
    record = read_record(path, options("lvm"))
    assert (record.sampling_rate, record.start) == pytest.approx((1e3 * RATE, 0.25e-3))
    lines = text.replace("X_Columns\tNo", "X_Columns\tOne").splitlines()
    rows = len(lines) - len(VALUES)
    for step, is_refused in ((1 / RATE, False), (2 / RATE, True)):
        timed = [f"{k * step:.6f}".replace(".", ",") + line for k, line in enumerate(lines[rows:])]
        path.write_text("\n".join([*lines[:rows], *timed, ""]))
        if is_refused:
            with pytest.raises(FileError, match="its X_Value column runs in steps of"):
                read_record(path, options("lvm"))
        else:
            assert read_record(path, options("lvm")).sampling_rate == pytest.approx(RATE)


def labview_text(head, segment, names, rows):
    """An LVM file with decimal points, each line ended as LabVIEW ends them."""
    parts = (["LabVIEW Measurement", "Writer_Version\t2", *head], segment, [])
    lines = [line for part in parts[:2] for line in (*part, "***End_of_Header***")]
    return "\n".join([*lines, "\t".join([*names, "Comment"]), *("\t".join([*row, ""]) for row in rows), ""])


def test_text_of_labview_with_times_for_each_channel_and_channels_without_samples(tmp_path):
    """Each channel has its own times and time of day; one that was not sampled is left out."""
    path = tmp_path / "a.lvm"
    rows = [[f"{0.25 * i:.6f}", f"{i}.5", "", "", f"{0.25 * i:.6f}", f"-{i}.25"] for i in range(6)]
    segment = [
        "Channels\t3", "Samples\t6\t\t0\t\t6\t", "Date\t2024/05/01\t\t2024/05/01\t\t2024/05/02",
        "Time\t23:59:59.75\t\t00:00:00\t\t00:00:00.250", "Y_Unit_Label\tg\t\tN\t\tm/s^2\t", "Delta_X\t0.25\t\t1\t\t0.25\t",
    ]  # fmt: skip
    names = ["X_Value", "1X", "X_Value", "off", "X_Value", "2X"]
    path.write_text(labview_text(["X_Columns\tMulti"], segment, names, rows))
    record = read_record(path)
    assert (record.sampling_rate, record.start) == (4, 0.5)
    np.testing.assert_allclose(record.values / [9.80665, 1], [[2.5, -0.25], [3.5, -1.25], [4.5, -2.25], [5.5, -3.25]])
    other = [line.replace("2024/05/0", "5/1/202").replace("5/1/2022", "5/2/2024") for line in segment]
    path.write_text(labview_text(["X_Columns\tMulti"], other, names, rows))
    with pytest.raises(
        FileError, match=r"start at different times, and 5/1/2021 23:59:59.75 is none as LabVIEW writes it"
    ):
        read_record(path)
    rows[2][4] = "0.550000"
    path.write_text(labview_text(["X_Columns\tMulti"], segment, names, rows))
    with pytest.raises(FileError, match=r"'2X' is not sampled evenly: a sample is 0.2 steps off"):
        read_record(path)


@pytest.mark.parametrize(
    "date, hour", [("31.01.2026\t31.01.2026", "12:00:00.5\t12:00:00.500001"), ("2026/01/31\t", "12:00:00\t")]
)
@pytest.mark.parametrize("layout", ["One", "No"])
def test_times_of_day_in_text_of_labview_count_only_without_a_column_of_times(tmp_path, layout, date, hour):
    path = tmp_path / "a.lvm"
    segment = [
        "Channels\t2", "Samples\t6\t6", f"Date\t{date}", f"Time\t{hour}", "Y_Unit_Label\tN\tN", "Delta_X\t0.25\t0.25",
    ]  # fmt: skip
    rows = [[f"{0.25 * i:.6f}" if layout == "One" else "", f"{i}.5", f"-{i}.25"] for i in range(6)]
    path.write_text(labview_text([f"X_Columns\t{layout}"], segment, ["X_Value", "1X", "2X"], rows))
    if layout == "No" and "." in date:
        with pytest.raises(FileError, match=r"start at different times, and 31\.01\.2026 12:00:00\.5 is none"):
            read_record(path)
        return
    record = read_record(path)
    assert (record.sampling_rate, record.start, len(record.values)) == (4, 0, 6)
    assert ("2X does not say when it starts, taken as the first" in record.source) == (layout == "No")
    assert "1X does not say" not in record.source


@pytest.mark.parametrize("layout, step, rate", [
    ("No", "0.000977", 0),
    ("No", "0.000250", 4000), ("No", "9.765625E-4", 1024), ("One", "0.000977", 1024), ("One", "0.000250", 4000),
])  # fmt: skip
def test_a_step_of_labview_with_few_digits_is_not_taken_as_exact(tmp_path, layout, step, rate):
    """A step of 0.000977 s is one of 1/1024 s to 0.05 %: the printed times of a long record tell it better, or the user."""
    path = tmp_path / "a.lvm"
    times = [f"{i / (rate or 1024):.6f}" if layout == "One" else "" for i in range(2500)]
    segment = ["Channels\t1", "Samples\t2500", "Y_Unit_Label\tg", "X_Dimension\tTime", "X0\t0.0", f"Delta_X\t{step}"]
    path.write_text(labview_text([f"X_Columns\t{layout}"], segment, ["X_Value", "1X"], [[t, "0.5"] for t in times]))
    if rate:
        assert read_record(path).sampling_rate == rate
        return
    with pytest.raises(InputError, match=r"its sampling rate 1023.54 Hz to 0.051 % only"):
        read_record(path)
    assert read_record(path, ReadOptions(sampling_rate=1024)).sampling_rate == 1024
    with pytest.raises(InputError, match="`sampling_rate` 1025 was given"):
        read_record(path, ReadOptions(sampling_rate=1025))
