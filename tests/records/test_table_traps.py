"""Tables whose numbers could be taken for others without a word: refused, or read as the logger meant them."""

import numpy as np
import pytest

from structid.core.errors import FileError, InputError
from structid.core.units import STANDARD_GRAVITY
from structid.records import CsvLayout, ReadOptions, read_record

RATE = 100.0
VALUES = np.random.default_rng(3).normal(size=(400, 2)).round(4)
TWO = {"channels": "1X,2X", "units": "g"}


def read(tmp_path, text, **options):
    path = tmp_path / "trap.csv"
    path.write_text(text)
    return read_record(path, ReadOptions(**options))


def rows(separator=",", *first):
    """Lines of `VALUES`, each behind the cells that the functions `first` make of the number of the line."""
    return "".join(
        separator.join([*(make(i) for make in first), *(f"{x:.4f}" for x in row)]) + "\n"
        for i, row in enumerate(VALUES)
    )


@pytest.mark.parametrize("column", [lambda i: f"{i / RATE:.3f}", lambda i: str(10_000 * i), str])
def test_times_and_counts_without_a_header_are_no_channel(tmp_path, column):
    text = rows("\t", column)
    with pytest.raises(InputError, match=r"line 1, column 1 .* rises in even steps of .*`time_column = 1`"):
        read(tmp_path, text, sampling_rate=5 * RATE, channels="1X,2X,3X", units="g")
    record = read(tmp_path, text, sampling_rate=RATE, columns="2,3", **TWO)
    np.testing.assert_allclose(record.values, VALUES * STANDARD_GRAVITY)


def test_a_header_that_counts_the_columns_is_no_sample(tmp_path):
    text = "0,1\n" + rows()
    with pytest.raises(
        FileError, match=r"line 1 counts 0, 1, as numbers of columns do.*`header_rows = 1`.*`header_rows = 0`"
    ):
        read(tmp_path, text, sampling_rate=RATE, **TWO)
    for header_rows, count in ((1, 400), (0, 401)):
        layout = CsvLayout(header_rows=header_rows)
        assert len(read(tmp_path, text, sampling_rate=RATE, csv=layout, **TWO).values) == count


@pytest.mark.parametrize("dated", [False, True])
def test_a_point_among_decimal_commas_is_refused_in_every_line(tmp_path, dated):
    """The layout is recognised from a sample of the lines, which line 303 is not in."""
    date = "27.11.2026 12:00:{:05.2f}" if dated else "{:.2f}"
    lines = [date.format(i / RATE % 60) + ";" + ";".join(f"{x:.4f}" for x in row) for i, row in enumerate(VALUES)]
    lines = [line if dated else line.replace(".", ",") for line in lines]
    lines = [date + ";" + rest.replace(".", ",") for date, _, rest in (line.partition(";") for line in lines)]
    text = "Zeit [s];1X [g];2X [g]\n".replace(" [s]", "" if dated else " [s]")
    np.testing.assert_allclose(read(tmp_path, text + "\n".join(lines) + "\n").values, VALUES * STANDARD_GRAVITY)
    lines[301] = lines[301].rpartition(";")[0] + ";1.234"
    with pytest.raises(FileError, match=r"line 303, column 3 .* is 1\.234, where other numbers have decimal commas"):
        read(tmp_path, text + "\n".join(lines) + "\n")


def toa5(statistics="Smp", name="A"):
    head = [
        '"TOA5","CR6","CR6","1","CR6.Std.10","CPU:a.CR6","1","Fast"',
        f'"TIMESTAMP","RECORD","{name}","B"',
        '"TS","RN","g","g"',
        f'"","","{statistics}","Smp"',
    ]
    stamp = lambda i: f'"2026-06-25 10:00:{i / RATE:05.2f}"'  # noqa: E731
    return "\n".join(head) + "\n" + rows(",", stamp, str)


def test_toa5_tables_have_three_lines_of_header(tmp_path):
    record = read(tmp_path, toa5(), columns="A,B", channels="1X,2X")
    assert record.sampling_rate == pytest.approx(RATE)
    assert "names in line 2, units in line 3" in record.source
    np.testing.assert_allclose(record.values, VALUES * STANDARD_GRAVITY)


@pytest.mark.parametrize(
    "text", [toa5("Avg"), toa5("Max"), toa5("Tot"), toa5("StdDev"), toa5("Med"), toa5("Cov"), toa5(name="A_Std")]
)
def test_statistics_of_intervals_are_no_samples(tmp_path, text):
    with pytest.raises(
        FileError,
        match=r"line 2, column 3 .*'(Avg|Max|Tot|StdDev|Med|Cov|Std)' stands for a level, a statistic or a density",
    ):
        read(tmp_path, text, columns="3,4", channels="1X,2X")


def test_a_single_sensor_whose_name_ends_like_a_statistic_is_read(tmp_path):
    two = {"columns": "2,3", **TWO}
    clock = lambda i: f"{i / RATE:.2f}"  # noqa: E731
    for name in ("Pos max", "A_std", "Node_Min"):
        record = read(tmp_path, f"Time (s),{name},B\n" + rows(",", clock), **two)
        np.testing.assert_allclose(record.values, VALUES * STANDARD_GRAVITY)
    for names in ("A_Max,A_Min", "A_Avg,B"):
        with pytest.raises(FileError, match="stands for a level, a statistic or a density"):
            read(tmp_path, f"Time (s),{names}\n" + rows(",", clock), **two)


def test_a_load_that_rises_evenly_is_a_channel_where_its_unit_says_so(tmp_path):
    lines = "".join(f"{i / RATE:.2f},{0.5 * i:.1f},{row[1]:.4f}\n" for i, row in enumerate(VALUES))
    record = read(tmp_path, "Time (s),Load (N),B (g)\n" + lines, columns="2,3", channels="1X,2X")
    np.testing.assert_allclose(record.values[:, 0], 0.5 * np.arange(400))
    with pytest.raises(InputError, match=r"column 2 \('Load'\) rises in even steps"):
        read(tmp_path, "Time (s),Load,B (g)\n" + lines, columns="2,3", units="N,g", channels="1X,2X")


def paired(step, start=0.0, n_second=400):
    """Times and samples of two channels in turn: the second has `n_second`, in steps of `step` from `start` on, in s."""
    second = [f"{start + i * step:.2f},{row[1]:.4f}" if i < n_second else "," for i, row in enumerate(VALUES)]
    lines = [
        f"{i / RATE:.2f},{row[0]:.4f},{cells}\n" for i, (row, cells) in enumerate(zip(VALUES, second, strict=True))
    ]
    return "Time (s),A (g),Time (s),B (g)\n" + "".join(lines)


def test_channels_with_clocks_of_their_own_are_not_read_by_one(tmp_path):
    two = {"columns": "2,4", "channels": "1X,2X"}
    np.testing.assert_allclose(read(tmp_path, paired(0.01), **two).values, VALUES * STANDARD_GRAVITY)
    with pytest.raises(InputError, match=r"line 1: columns 1 and 3 hold times that differ: 3\.99 s and 7\.98 s in all"):
        read(tmp_path, paired(0.02), **two)
    second = read(tmp_path, paired(0.02), time_column=3, columns="4", channels="2X")
    assert second.sampling_rate == pytest.approx(50.0)
    with pytest.raises(InputError, match=r"columns 1 and 3 hold times that differ: the second is 0\.05 s ahead"):
        read(tmp_path, paired(0.01, start=0.05), **two)
    with pytest.raises(InputError, match=r"columns 1 and 3 hold times that differ: 1\.99 s and 3\.98 s in all"):
        read(tmp_path, paired(0.02, n_second=200), **two)


@pytest.mark.parametrize("stamp", [lambda i: "1.7e9", lambda i: f"{(86399 + i / RATE) % 86400:.2f}"])
def test_a_column_that_does_not_rise_is_no_second_clock(tmp_path, stamp):
    text = "Time (s),Time stamp (s),A,B\n" + rows(",", lambda i: f"{i / RATE:.2f}", stamp)
    np.testing.assert_allclose(read(tmp_path, text, columns="3,4", **TWO).values, VALUES * STANDARD_GRAVITY)


def test_seconds_since_1970_beside_seconds_since_the_start_are_one_clock(tmp_path):
    text = "Time (s),Timestamp (s),A,B\n" + rows(",", lambda i: f"{i / RATE:.2f}", lambda i: f"{1.7e9 + i / RATE:.2f}")
    np.testing.assert_allclose(read(tmp_path, text, columns="3,4", **TWO).values, VALUES * STANDARD_GRAVITY)


def test_a_last_line_without_an_end_is_read_if_it_is_surely_whole(tmp_path):
    comma, semicolon = (
        "Time [s],A,B\n" + rows(",", lambda i: f"{i / RATE:.2f}"),
        ("Zeit [s];A;B\n" + rows(";", lambda i: f"{i / RATE:.2f}")).replace(".", ","),
    )
    two = {"columns": "2,3", **TWO}
    for text in (comma, semicolon):
        np.testing.assert_allclose(read(tmp_path, text[:-1], **two).values, VALUES * STANDARD_GRAVITY)
        with pytest.raises(FileError, match="its last line has no end, so it may be truncated"):
            read(tmp_path, text[:-2], **two)


@pytest.mark.parametrize("sign", [",", ";"])
def test_a_whole_number_behind_a_date_has_no_decimals(tmp_path, sign):
    """A last 1234 may be cut to 123, as nine lines above hold three digits."""
    lines = "".join(f"2026-01-01 10:00:{i / 10:04.1f}{sign}{500 + i}\n" for i in range(400))
    with pytest.raises(FileError, match="its last line has no end, so it may be truncated"):
        read(tmp_path, f"time{sign}A\n{lines}"[:-1], columns="A", channels="1X", units="g")


@pytest.mark.parametrize("scale, unit", [(1e3, "ms"), (1e6, "us")])
def test_clocks_that_count_from_1970_tell_the_rate_to_the_last_digit(tmp_path, scale, unit):
    stamp = lambda i: str(round(1764244800 * scale + i * scale / RATE))  # noqa: E731
    record = read(tmp_path, "timestamp,A,B\n" + rows(",", stamp), axis_unit=unit, sampling_rate=RATE, **TWO)
    assert (record.sampling_rate, record.start) == (RATE, 1764244800.0)


@pytest.mark.parametrize(
    "text",
    [
        "x,y,z\n" + rows(",", lambda i: "0.5"),
        ",x,y\n" + rows(",", str),
        '"","x","y"\n' + rows(",", lambda i: f'"{i + 1}"'),
        "# x y\n" + rows(" "),
        "%x\ty\n" + rows("\t"),
        "#x,y\n#g,g\n" + rows(","),
    ],
)
def test_names_as_programs_save_them(tmp_path, text):
    """Directions of space are no times; row numbers without a name and signs of comments are left out."""
    columns = "y,z" if text[0] == "x" else "x,y"
    record = read(tmp_path, text, sampling_rate=RATE, columns=columns, **TWO)
    np.testing.assert_allclose(record.values, VALUES * STANDARD_GRAVITY)
    assert ("row numbers left out" in record.source) == (",x" in text or ',"x' in text)


def test_a_first_column_without_a_name_that_counts_nothing_is_refused(tmp_path):
    with pytest.raises(FileError, match="line 1, column 1 has no name"):
        read(tmp_path, ",x,y\n" + rows(",", lambda i: str(i + 7)), sampling_rate=RATE, **TWO)


def test_of_columns_without_a_name_the_one_that_is_no_count_of_rows_is_told(tmp_path):
    text = ",time_s,,2Z+ [m/s^2]\n" + "".join(f"{i},{i / RATE:.6f},{i % 7},{i % 5}\n" for i in range(20))
    with pytest.raises(FileError, match="line 1, column 3 has no name"):
        read(tmp_path, text)


def test_row_numbers_are_no_frequencies(tmp_path):
    text = ",1X/2X [g/N] re,1X/2X [g/N] im\n" + rows(",", str)
    with pytest.raises(FileError, match="column 1 has no name and counts the rows, where frequencies must stand"):
        read(tmp_path, text, axis_unit="Hz")


@pytest.mark.parametrize("n_lines", [1, 2, 3, 4])
def test_toa5_tables_cut_within_their_header_are_refused(tmp_path, n_lines):
    with pytest.raises(FileError):
        read(tmp_path, "".join(toa5().splitlines(keepends=True)[:n_lines]))


def test_signs_that_belong_to_names_or_lines_left_out_are_not_stripped(tmp_path):
    record = read(tmp_path, "#1,#2\n" + rows(), sampling_rate=RATE, columns="#1,#2", **TWO)
    np.testing.assert_allclose(record.values, VALUES * STANDARD_GRAVITY)
    record = read(tmp_path, "#1.5 2.5\n" + rows(" "), sampling_rate=RATE, **TWO)
    np.testing.assert_allclose(record.values, VALUES * STANDARD_GRAVITY)


@pytest.mark.parametrize(
    ("head", "separator", "words"),
    [
        ("time_s,x,y\n\n", ",", "names in line 1"),
        ("Time,x,y\n(s),(g),(g)\n\n", ",", "units in line 2"),
        ("sep=;\ntime_s;x;y\n", ";", "names in line 2"),
    ],
)
def test_blank_lines_and_separators_above_the_numbers_are_no_rows(tmp_path, head, separator, words):
    record = read(tmp_path, head + rows(separator, lambda i: f"{i / RATE:.3f}"), **TWO)
    assert record.sampling_rate == pytest.approx(RATE)
    np.testing.assert_allclose(record.values, VALUES * STANDARD_GRAVITY)
    assert words in record.source


@pytest.mark.parametrize("second", ["", ",,"])
def test_blank_lines_that_are_stated_as_header_are_one(tmp_path, second):
    text = f"time_s,x,y\n{second}\n" + rows(",", lambda i: f"{i / RATE:.3f}")
    for header_rows, more in ((2, ""), (2, "\n"), (1, "")):
        layout = CsvLayout(header_rows=header_rows)
        record = read(tmp_path, text.replace("\n0.000", f"\n{more}0.000"), csv=layout, **TWO)
        np.testing.assert_allclose(record.values, VALUES * STANDARD_GRAVITY)
    with pytest.raises(FileError, match=r"line 2, column 1 .* must be a number"):
        read(tmp_path, text.replace("y\n", "y\nm,n,o\n"), csv=CsvLayout(header_rows=1), **TWO)


def test_lines_below_one_that_says_the_separator_are_counted_from_the_top(tmp_path):
    text = "sep=;\nTitle;;\nmore;;\ntime_s;x;y\n" + rows(";", lambda i: f"{i / RATE:.3f}")
    with pytest.raises(FileError, match=r"lines 2 to 4 stand above .* line 4 \(time_s, x, y\) names .*`skip_rows = 3`"):
        read(tmp_path, text, **TWO)
    for layout in (CsvLayout(skip_rows=3), CsvLayout(skip_rows=3, separator="semicolon")):
        np.testing.assert_allclose(read(tmp_path, text, csv=layout, **TWO).values, VALUES * STANDARD_GRAVITY)
    told = text.replace("Title;;\nmore;;\n", "")
    record = read(tmp_path, told, csv=CsvLayout(separator="semicolon"), **TWO)
    np.testing.assert_allclose(record.values, VALUES * STANDARD_GRAVITY)
    with pytest.raises(FileError, match="line 2 counts 0, 1, as numbers of columns do"):
        read(tmp_path, "sep=;\n0;1\n" + rows(";"), sampling_rate=RATE, **TWO)
    with pytest.raises(FileError, match="holds no header"):
        read(tmp_path, "sep=;\n", **TWO)


def test_a_bad_cell_below_a_blank_line_is_told_with_its_line(tmp_path):
    text = "time_s,x,y\n\n" + rows(",", lambda i: f"{i / RATE:.3f}")
    lines = text.splitlines(keepends=True)
    lines[6] = lines[6].replace(lines[6].split(",")[1], "abc")
    with pytest.raises(FileError, match=r"line 7, column 2 \(x\) must be a number, got 'abc'"):
        read(tmp_path, "".join(lines), **TWO)


def test_voltages_in_a_line_of_units_are_units(tmp_path):
    text = "Time,Channel A,Channel B\n(ms),(mV),(mV)\n\n" + rows(",", lambda i: f"{1000 * i / RATE:.2f}")
    record = read(tmp_path, text, channels="1X,2X", units="mV at 100 mV/g")
    assert record.sampling_rate == pytest.approx(RATE)
    np.testing.assert_allclose(record.values, VALUES * STANDARD_GRAVITY / 100)
    with pytest.raises(InputError, match="a voltage says nothing without its sensor"):
        read(tmp_path, text, channels="1X,2X")


@pytest.mark.parametrize("quoted", [False, True])
def test_exponents_of_fortran_are_read(tmp_path, quoted):
    lines = "".join(f"{i / RATE:.4E},{a:.6E},{b:.6E}\n" for i, (a, b) in enumerate(VALUES)).replace("E", "D")
    if quoted:
        lines = "".join(",".join(f'"{cell}"' for cell in line.split(",")) + "\n" for line in lines.splitlines())
    record = read(tmp_path, "time_s,x,y\n" + lines, **TWO)
    np.testing.assert_allclose(record.values, VALUES * STANDARD_GRAVITY)


@pytest.mark.parametrize(
    ("cell", "words"),
    [("1.#INF", "clear the cell"), ("-1.#IND00", "clear the cell"), ("1\u202f364.1", "without thousands separators")],
)
def test_marks_of_programs_in_place_of_numbers_are_told(tmp_path, cell, words):
    text = "time_s,x,y\n" + rows(",", lambda i: f"{i / RATE:.3f}")
    lines = text.splitlines(keepends=True)
    lines[9] = lines[9].replace(lines[9].split(",")[1], cell)
    with pytest.raises(FileError, match=rf"line 10, column 2 \(x\) must be a number.*{words}"):
        read(tmp_path, "".join(lines), **TWO)


def test_blank_lines_above_numbers_without_a_header_are_passed_over(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("Number of averages\t10\n\n\n" + "".join(f"{5 * k}\t{k}\t{2 * k}\n" for k in range(1, 6)))
    layout = CsvLayout(skip_rows=1, header_rows=0, parts=("re", "im"))
    options = ReadOptions(csv=layout, outputs="2Z", inputs="1Z", unit="m/N", axis_unit="Hz")
    record = read_record(path, options)
    assert record.frequency.tolist() == [5.0, 10.0, 15.0, 20.0, 25.0]
    assert record.values[:, 0, 0].tolist() == [1 + 2j, 2 + 4j, 3 + 6j, 4 + 8j, 5 + 10j]
