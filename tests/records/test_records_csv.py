"""Tables as spreadsheets write them, and complaints that name line and column."""

import os

import numpy as np
import pytest

from structid.core.errors import FileError, InputError
from structid.records import ReadOptions, read_record, write_record
from structid.records.formats import CsvLayout

TIME = "time_s,12Z+ [mm/s^2],3Z- [kN]\n0.0,1,2\n0.1,3,4\n0.2,5,6\n"
FRF = (
    "frequency_hz,1X/3Z- [g/lbf] re,1X/3Z- [g/lbf] im,1X/3Z- coherence,1X/3Z- [g/lbf] std\n"
    "1,1,2,0.5,0.1\n2,3,4,0.25,0.2\n"
)


def read(tmp_path, text, encoding="utf-8"):
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode(encoding))
    return read_record(path)


VARIANTS = {
    "plain": TIME,
    "windows": TIME.replace("\n", "\r\n"),
    "mark": "\ufeff" + TIME,
    "blank lines": TIME + "\n,,\n\n",
    "blank columns": TIME.replace("\n", ",,\n"),
    "quoted": TIME.replace("12Z+ [mm/s^2]", '"12Z+ [mm/s^2]"'),
    "spaces": TIME.replace(",", " , "),
    "tabs": TIME.replace(",", "\t"),
    "tabs and decimal comma": TIME.replace(",", "\t").replace("0.", "0,"),
    "semicolons": TIME.replace(",", ";"),
    "semicolons and decimal comma": TIME.replace(",", ";").replace("0.", "0,"),
    "other header": TIME.replace("time_s", "Time [s]"),
    "other unit forms": TIME.replace("mm/s^2", "mm/s²"),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_time_table(tmp_path, name):
    record = read(tmp_path, VARIANTS[name])
    np.testing.assert_allclose(record.values, [[1e-3, 2e3], [3e-3, 4e3], [5e-3, 6e3]], rtol=1e-15)
    assert [str(d) for d in record.channels] == ["12Z+", "3Z-"]
    assert record.quantities == ("acceleration", "force")
    assert record.sampling_rate == pytest.approx(10, rel=1e-14)
    assert record.start == 0


def test_frf_table(tmp_path):
    record = read(tmp_path, FRF)
    factor = 9.80665 / 4.4482216152605
    np.testing.assert_allclose(record.values.ravel(), np.array([1 + 2j, 3 + 4j]) * factor, rtol=1e-15)
    np.testing.assert_allclose(record.variance.ravel(), (np.array([0.1, 0.2]) * factor) ** 2, rtol=1e-14)
    np.testing.assert_array_equal(record.coherence.ravel(), [0.5, 0.25])
    assert (record.kind, record.noise_source) == ("accelerance", "declared")
    assert [str(d) for d in (*record.outputs, *record.inputs)] == ["1X+", "3Z-"]


@pytest.mark.parametrize(
    "old, new, word",
    [
        ("3,4", "3,x", r"line 3, column 3 \(3Z- \[kN\]\) must be a number, got 'x'"),
        ("3,4", "3,", "line 3, column 3"),
        ("3,4", "3", "line 3 has 2 cells"),
        ("3,4", "3,4,5", "line 3 has 4 cells"),
        ("3,4", "nan,4", "line 3, column 2 .*NaN"),
        ("3,4", "inf,4", "line 3, column 2 .*NaN or infinite"),
        ("0.1,", "0.1000003,", "line 3, column 1: time must be even"),
        ("0.2,", "0.1,", r"column 1: time must be even.*1 times are not later than .*remove repeated lines"),
        ("0.2,", "-0.2,", "time must increase"),
        ("time_s", "strain", "line 1: no column is headed as time, as in time_s"),
        ("mm/s^2", "furlong", "line 1, column 2 .*furlong"),
        (" [mm/s^2]", "", "line 1, column 2 .*with degree of freedom and unit"),
        ("12Z+", "12Q", "line 1, column 2 .*12Q"),
        ("12Z+", "12RZ+", "line 1, column 2 .*rotation"),
        ("12Z+ [mm/s^2]", "3Z- [N]", "twice"),
        ("12Z+", '"12Z+', "not a CSV table|line 1"),
        ("0.1,3,4\n0.2,5,6\n", "", "sampling rate"),
    ],
)
def test_time_table_complaint(tmp_path, old, new, word):
    assert TIME.count(old) == 1
    with pytest.raises(FileError if word != "twice" else ValueError, match=word) as caught:
        read(tmp_path, TIME.replace(old, new))
    assert str(caught.value).startswith(str(tmp_path / "a.csv"))


@pytest.mark.parametrize(
    "old, new, word",
    [
        (" re,", " first,", r"line 1, column 2 .*re \(or im, .*`parts = .re,im.` in \[record.csv\]"),
        ("1X/3Z- [g/lbf] im", "1X/4Z- [g/lbf] im", r"no column 1X\+/4Z- re"),
        ("1X/3Z- [g/lbf] im", "1X/3Z- [g/lbf] re", "twice"),
        ("1X/3Z- [g/lbf] im", "1X/3Z- [mm/lbf] im", "one kind"),
        ("1X/3Z- [g/lbf] im", "1X/3Z- [g/N] im", r"line 1, column 3 .*real and imaginary parts are in different units"),
        ("1X/3Z- coherence", "2X/3Z- coherence", r"no column 2X\+/3Z- re"),
        ("\n2,", "\n0.5,", r"lines 2 and 3, column 1 \(frequency_hz\): .*must increase, got 1 Hz followed by 0.5 Hz"),
        ("0.25", "1.25", r"line 3, column 4 \(1X/3Z- coherence\) must be from 0 to 1, got 1.25 at 2 Hz"),
        ("0.5", "-0.5", "line 2, column 4 .*must be from 0 to 1, got -0.5 at 1 Hz"),
        ("0.25,0.2", "0.25,-0.2", "line 3, column 5 .*must be at least 0, got -0.2 at 2 Hz"),
    ],
)
def test_frf_table_complaint(tmp_path, old, new, word):
    with pytest.raises(ValueError, match=word) as caught:
        read(tmp_path, FRF.replace(old, new))
    assert str(caught.value).startswith(str(tmp_path / "a.csv"))


def test_frequencies_in_a_complaint_are_in_hz(tmp_path):
    """Of lines in kHz the message gives the numbers in the unit that it names."""
    kilohertz = FRF.replace("frequency_hz", "frequency (kHz)")
    with pytest.raises(FileError, match=r"must increase, got 1000 Hz followed by 500 Hz"):
        read(tmp_path, kilohertz.replace("\n2,", "\n0.5,"))
    with pytest.raises(FileError, match=r"must be from 0 to 1, got 1.25 at 2000 Hz"):
        read(tmp_path, kilohertz.replace("0.25", "1.25"))


@pytest.mark.parametrize("unit", ["1", "-", " - "])
def test_a_ratio_without_unit_is_transmissibility(tmp_path, unit):
    pair = FRF.replace("1X/3Z- [g/lbf]", f"1RX/3RZ- [{unit}]").replace("1X/3Z-", "1RX/3RZ-")
    for text in (pair, pair.replace("R", "")):
        record = read(tmp_path, text)
        assert (record.kind, record.is_per_motion) == ("transmissibility", True)
        np.testing.assert_array_equal(record.values.ravel(), [1 + 2j, 3 + 4j])
        np.testing.assert_allclose(record.variance.ravel(), [0.01, 0.04])
    with pytest.raises(
        FileError, match=r"line 1, column 2 .* is a ratio of one motion .* one of 1X\+ and 3RZ- is a rotation"
    ):
        read(tmp_path, pair.replace("1RX", "1X"))


def test_a_header_below_other_lines_is_complained_of_at_its_line(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("shaker\nday 2\n" + FRF.replace(" im,", " second,"), encoding="utf-8")
    with pytest.raises(FileError, match=r"line 3, column 3 .*1X/3Z"):
        read_record(path, ReadOptions(csv=CsvLayout(skip_rows=2)))


def test_time_is_even_to_the_written_tolerance(tmp_path):
    assert read(tmp_path, TIME.replace("0.1,", "0.10000005,")).sampling_rate == pytest.approx(10)


def test_bytes_of_a_picture_are_told_from_an_encoding_and_a_folder_from_a_file(tmp_path):
    (tmp_path / "photo.csv").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(50))
    with pytest.raises(FileError, match=r"photo.csv: holds null bytes, so it is no text; export it as CSV"):
        read_record(tmp_path / "photo.csv")
    with pytest.raises(FileError, match="is a folder; give a file in it"):
        read_record(tmp_path)


def test_latin_text_is_refused(tmp_path):
    with pytest.raises(FileError, match="save it as CSV UTF-8"):
        read(tmp_path, TIME.replace("mm", "µm"), "latin-1")


def test_written_headers(tmp_path, frf, history):
    path = tmp_path / "a.csv"
    write_record(path, history)
    assert path.read_text().splitlines()[0] == "time_s,1X- [m/s^2],2RZ+ [rad/s],1X- [N]"
    write_record(path, frf)
    header = path.read_text().splitlines()[0].split(",")
    assert header[:5] == ["frequency_hz", "1X-/3Z- [(m/s)/N] re", "1X-/3Z- [(m/s)/N] im", "1X-/3Z- coherence",
                          "1X-/3Z- [(m/s)/N] std"]  # fmt: skip
    assert header[-4] == "12Z-/4RX+ [(m/s)/(N m)] re"
    assert header[13] == "2RZ+/4RX+ [(rad/s)/(N m)] re"


def test_a_unit_beside_one_in_the_header_is_that_one_or_refused(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(FRF, encoding="utf-8")
    read_record(path, ReadOptions(unit="g/lbf"))
    with pytest.raises(FileError, match=r"line 1 says the unit of each column, but `unit` 'g/N' was given"):
        read_record(path, ReadOptions(unit="g/N"))


def dated(step, head="Time [s]", first=46000.4):
    """A table of eight samples whose times are days since 1900, as a spreadsheet counts them."""
    return f"{head},1X [m/s^2]\n" + "".join(f"{first + step * i:.11f},{i % 3}\n" for i in range(8))


def test_dates_of_a_spreadsheet_are_no_seconds(tmp_path):
    """Days 46000.4 and on at 256 Hz would be seconds at 22 MHz; seconds of a day at 1 kHz stay what they are."""
    step = 1 / 256 / 86400
    with pytest.raises(
        InputError, match=r"from 46000.4 in steps of 4.5e-08, .* give `axis_unit = .day.`.*write \[day\]"
    ):
        read(tmp_path, dated(step))
    assert read(tmp_path, dated(step, "Time [days]")).sampling_rate == pytest.approx(256, rel=1e-4)
    path = tmp_path / "a.csv"
    path.write_text(dated(step, "Time"))
    assert read_record(path, ReadOptions(axis_unit="day")).sampling_rate == pytest.approx(256, rel=1e-4)
    with pytest.raises(InputError, match="dates of a spreadsheet"):
        read_record(path, ReadOptions(axis_unit="s"))
    assert read(tmp_path, dated(1e-3)).sampling_rate == pytest.approx(1000)
    assert read(tmp_path, dated(step, first=0.4)).sampling_rate == pytest.approx(256 * 86400, rel=1e-3)


def test_any_object_that_stands_for_a_path_is_one(tmp_path):
    read(tmp_path, TIME)
    with os.scandir(tmp_path) as entries:
        (entry,) = entries
    record = read_record(entry)
    np.testing.assert_array_equal(record.values, read_record(tmp_path / "a.csv").values)
    write_record(entry, record)
    assert read_record(entry).values.shape == record.values.shape
