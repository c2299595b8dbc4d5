"""Tables of laboratories: what is recognised, what is said of it, and what is refused with its remedy."""

import numpy as np
import pytest

from structid.core.errors import FileError, InputError
from structid.records import CsvLayout, ReadOptions, read_record
from structid.records.formats import keep_records
from structid.records.formats.csv.table import read_table
from structid.records.formats.options import options_given_as_flags

ROWS = np.array([[0.5, -1.25, 100.0], [1.5, 2.25, 110.0], [-2.5, 3.25, 120.0], [0.25, 0.75, 130.0], [1.0, -0.5, 90.0]])
RATE = 512.0


def table(separator=",", comma=False, head=(), time="{:.9f}", rows=ROWS, end="", names=("Acc A", "Acc B", "Load")):
    lines = list(head) or [separator.join(["t_s", *names])]
    for i, row in enumerate(rows):
        cells = [time.format(i / RATE)] if time else []
        cells += [f"{x:.4f}" for x in row]
        lines.append(separator.join(cell.replace(".", ",") if comma else cell for cell in cells))
    return "\n".join([*lines, *([end] if end else [])]) + "\n"


def read(tmp_path, text, encoding="utf-8", **options):
    path = tmp_path / "lab.csv"
    path.write_bytes(text.encode(encoding))
    return read_record(path, ReadOptions(**options))


THREE = {"channels": "1X,2X-,2X", "units": "g,g,kN"}
UNITS = ";".join(["Zeit;Acc A;Acc B;Load", "s;g;g;kN"]).replace("Load;s", "Load\ns")


@pytest.mark.parametrize(
    ("text", "options", "said"),
    [
        (table(";", True), THREE, "separated by semicolons, decimal commas, names in line 1"),
        (table("\t"), THREE, "separated by tabs, decimal points"),
        (table(" ", head=["t_s a b c"]), THREE, "separated by spaces, decimal points"),
        (table(), THREE, "separated by commas, decimal points"),
        (table(";", True, head=UNITS.split("\n")), {"channels": "1X,2X-,2X"}, "names in line 1, units in line 2"),
        (table(head=["Time [s],A [g],B (g),Force [kN]"]), {"channels": "1X,2X-,2X"}, "units g, kN"),
        (table(head=["t_s,1X (g),2X- (g),2X (kN)"]), {}, "units g, kN"),
        (
            table(";", True, head=["Operator: N.N.", "Date;1.2.2026", *UNITS.split("\n")]),
            {"channels": "1X,2X-,2X", "csv": CsvLayout(skip_rows=2)},
            "names in line 3, units in line 4",
        ),
        (table(time="", head=["A,B,C"]), {**THREE, "sampling_rate": RATE}, "sampling rate as given"),
        (table(time="", head=[]).partition("\n")[2], {**THREE, "sampling_rate": RATE}, "no header"),
        (table(end="Mean,1,2,3"), {**THREE, "csv": CsvLayout(footer_rows=1)}, "1 footer line left out"),
        (table(time="{:.4f}"), {**THREE, "sampling_rate": RATE}, "times rounded to 0.0001 s"),
        (table(head=["sample clock,A,B,C"]), {**THREE, "time_column": "sample clock", "axis_unit": "s"}, "3 columns"),
        (table(head=["q,A,B,C"]), {**THREE, "time_column": "1", "axis_unit": "s"}, "3 columns"),
        (table(), {**THREE, "columns": "Acc A,3,Load"}, "Acc A is 1X+, Acc B is 2X-, Load is 2X+"),
    ],
)
def test_a_table_is_understood_and_says_so(tmp_path, text, options, said):
    record = read(tmp_path, text, **options)
    g = 9.80665
    np.testing.assert_allclose(record.values, ROWS * [g, g, 1e3], rtol=1e-12)
    assert [str(dof) for dof in record.channels] == ["1X+", "2X-", "2X+"]
    assert record.quantities == ("acceleration", "acceleration", "force")
    assert record.sampling_rate == pytest.approx(RATE, rel=1e-6)
    assert said in record.source
    assert "5 samples at 512 Hz" in record.source


def test_columns_are_taken_in_the_order_asked_for(tmp_path):
    record = read(tmp_path, table(), columns="Load,2", channels="7X,8Z", units="N,m/s^2")
    np.testing.assert_allclose(record.values, ROWS[:, [2, 0]])


def test_times_in_milliseconds_and_as_dates(tmp_path):
    text = table(head=["Time [ms],A,B,C"], time="").splitlines()
    milli = "\n".join([text[0], *(f"{2 * i}.5,{line}" for i, line in enumerate(text[1:]))]) + "\n"
    record = read(tmp_path, milli, **THREE)
    assert (record.sampling_rate, record.start) == (pytest.approx(500), pytest.approx(0.5e-3))
    dates = "\n".join([text[0].replace(" [ms]", ""), *(f"2026-11-22 20:17:{59 + i // 2 % 1}.{2 * i:03d},{line}"
                                                       for i, line in enumerate(text[1:]))]) + "\n"  # fmt: skip
    assert read(tmp_path, dates, **THREE).sampling_rate == pytest.approx(500)


def test_rounded_times_do_not_hide_a_lost_sample(tmp_path):
    rows = np.tile(ROWS, (400, 1))
    text = table(time="{:.4f}", rows=rows)
    assert read(tmp_path, text, **THREE).sampling_rate == 512.0
    lines = text.splitlines(keepends=True)
    for lost in (2, 60, 1500, 1998):
        with pytest.raises(FileError, match="time must be even"):
            read(tmp_path, "".join(lines[:lost] + lines[lost + 1 :]), **THREE)
    with pytest.raises(FileError, match="time must be even"):  # 2 ms as 2 digits of 1 ms: too coarse to be sure
        read(tmp_path, table(time="{:.3f}", rows=rows), **THREE)


@pytest.mark.parametrize("time", ["{:.6g}", "{:.5e}"])
def test_times_of_so_many_digits_are_even_however_large_they_are(tmp_path, time):
    """0.00195312 first and 13.6719 last, zeros at the ends left out: coarser and coarser."""
    rows = np.tile(ROWS, (1400, 1))
    text = table(time=time, rows=rows)
    found = read(tmp_path, text, **THREE)
    assert found.sampling_rate == RATE
    lines = text.splitlines(keepends=True)
    for lost in (2, 60, 1500, 6998):
        with pytest.raises(FileError, match="time must be even"):
            read(tmp_path, "".join(lines[:lost] + lines[lost + 1 :]), **THREE)


def test_other_encodings_are_named_and_read(tmp_path):
    text = table(head=["t_s,A [µm],B [µm],C [N]"])
    with pytest.raises(FileError, match='give `encoding = "cp1252"`'):
        read(tmp_path, text, "cp1252", channels="1X,2X,3X")
    record = read(tmp_path, text, "cp1252", channels="1X,2X,3X", csv=CsvLayout(encoding="cp1252"))
    np.testing.assert_allclose(record.values, ROWS * [1e-6, 1e-6, 1])
    assert read(tmp_path, text, "utf-16", channels="1X,2X,3X", csv=CsvLayout(encoding="utf-16")).sampling_rate > 0


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("unit", ["um", "µm"])
def test_utf_16_without_a_mark_is_named_and_read(tmp_path, encoding, unit):
    text = table(head=[f"t_s,A [{unit}],B [{unit}],C [N]"])
    with pytest.raises(
        FileError, match=f'is UTF-16 text .*give `encoding = "{encoding}"` in .record.csv., or save it as'
    ):
        read(tmp_path, text, encoding, channels="1X,2X,3X")
    assert read(tmp_path, text, encoding, channels="1X,2X,3X", csv=CsvLayout(encoding=encoding)).sampling_rate > 0


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        (table(end="Mean;1;2;3"), THREE, r"line 7 \(Mean;1;2;3\) ends the numbers: a footer.*footer_rows = 1"),
        (table(end="Mean,1,2,3\nMax,1,2,3"), THREE, r"line 7 \(Mean, 1, 2, 3\).*footer_rows = 2"),
        (table(head=["Sensors,,,", "t_s,A,B,C"]), THREE, "lines 1 to 2 stand above.*line 2 .t_s, A, B, C.*skip_rows = 1`"),
        (table(head=["Test 7", *UNITS.replace(";", ",").split("\n")]), THREE, "line 2 .*skip_rows = 1`"),
        (table(head=["t_s,Acc,,Load"]), THREE, "line 1, column 3 has no name, as where cells were merged"),
        (table(";", True, head=["t_s,A,B,C"]), THREE, "line 1 names 1 columns, but line 2 has 4 cells: other separators"),
        (table(comma=True), THREE, "line 1 names 4 columns, but line 2 has 8 cells.*decimal commas between commas"),
        (table(";", True).replace("0,5000;", "0.5000;"), THREE, "line [23] has decimal commas and line 2 decimal points"),
        (table(";").replace("1.5000;", "1.500,0;"), THREE, "line 3, column 2 .*'1.500,0'.*thousands separators"),
        (table(), {}, r"line 1, column 2 \('Acc A'\).*say what each of the 3 columns is by `channels`"),
        (table(), {"channels": "1X,2X", "units": "g"}, "`channels` must have 3 entries.*Acc A, Acc B, Load, got 2"),
        (table(), {"channels": "1X,2X,3X"}, "line 1, column 2 .*has no unit.*give `units`"),
        (table(head=["t_s,A [V],B [V],C [V]"]), {"channels": "1X,2X,3X"}, "line 1, column 2 .*'V' .*V at 100 mV/g"),
        (table(head=["t_s,A [g],B [g],C [N]"]), {"channels": "1X,2X,3X", "units": "g"}, "column 4 .*is in N"),
        (table(), {**THREE, "columns": "Acc A,Acc B,Force"}, "no column 'Force'; the file has 2 'Acc A', 3 'Acc B', 4 'Load'"),
        (table(names=("A", "A", "B")), {**THREE, "columns": "A,A,B"}, "2 columns are called 'A'; choose by their numbers 2, 3"),
        (table(), {**THREE, "sampling_rate": 500}, "says sampling_rate 512"),
        (table(head=["Time [d],A,B,C"]), THREE, "holds times: cannot read 'd' as the unit of a time.*give `sampling_rate`"),
        (table(time="{:.4f}"), THREE, "rounded to 0.0001 s.*to 1.3 % only; give `sampling_rate`"),
        (table(time="", head=["A,B,C"]), THREE, "no column is headed as time.*`time_column` .*or `sampling_rate`"),
        (table(), {**THREE, "csv": CsvLayout(skip_rows=9)}, "leave none; lower them"),
        (table()[:-1], THREE, "its last line has no end.*footer_rows = 1"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_with_its_remedy(tmp_path, text, options, words):
    with pytest.raises(InputError, match=words) as caught:
        read(tmp_path, text, **options)
    assert str(caught.value).startswith(str(tmp_path / "lab.csv"))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"skip_rows": -1}, "`skip_rows`"),
        ({"header_rows": 3}, "0, 1 .names. or 2"),
        ({"parts": ("re", "phase")}, "must hold re and im, or magnitude and phase"),
        ({"parts": ("re", "im", "noise")}, "must be of re, im, magnitude"),
        ({"separator": "colon"}, "`separator` must be one of"),
        ({"separator": "comma", "decimal": "comma"}, "cannot both be comma"),
        ({"encoding": "klingon"}, "`encoding`"),
    ],
)
def test_a_layout_that_cannot_be(wrong, words):
    with pytest.raises(InputError, match=words):
        CsvLayout(**wrong)


def test_columns_of_a_file_without_names_are_refused(tmp_path):
    np.save(tmp_path / "a.npy", ROWS)
    with pytest.raises(InputError, match="no named columns"):
        read_record(tmp_path / "a.npy", ReadOptions(columns="1", sampling_rate=5, **THREE))
    with pytest.raises(InputError, match="no table"):
        read_record(tmp_path / "a.npy", ReadOptions(csv=CsvLayout(), sampling_rate=5, **THREE))


FRF = "Frequency [Hz];A/H [g/N] re;A/H [g/N] im;B/H [g/N] re;B/H [g/N] im\n1,0;1,0;2,0;3,0;4,0\n2,0;5,0;6,0;7,0;8,0\n"


def test_frfs_whose_sensors_have_names_of_their_own(tmp_path):
    record = read(tmp_path, FRF, outputs="7Z-,8Z", inputs="3Z")
    assert [str(dof) for dof in (*record.outputs, *record.inputs)] == ["7Z-", "8Z+", "3Z+"]
    np.testing.assert_allclose(record.values[:, :, 0], 9.80665 * np.array([[1 + 2j, 3 + 4j], [5 + 6j, 7 + 8j]]))
    assert record.source.endswith("; A is 7Z-, B is 8Z, H is 3Z")


def test_frfs_with_names_of_their_own_name_what_is_missing(tmp_path):
    with pytest.raises(
        FileError, match=r"column 2 .*cannot read 'A'.*\(outputs: A, B; inputs: H\).*`outputs` and `inputs`"
    ):
        read(tmp_path, FRF)
    with options_given_as_flags(), pytest.raises(FileError, match=r"in this order, by --outputs --inputs$"):
        read(tmp_path, FRF)
    with pytest.raises(InputError, match=r"`outputs` must have 2 entries, one for each of A, B, .* got 1"):
        read(tmp_path, FRF, outputs="7Z", inputs="3Z")
    own = FRF.replace("A/H", "7Z/3Z").replace("B/H", "8Z/3Z")
    assert [str(dof) for dof in read(tmp_path, own, outputs="8Z").outputs] == ["8Z+"]


LINES = np.array([2.0, 2.5, 3.0])
RESPONSES = np.array([[1.5 - 0.2j, -0.25 + 0.03j], [2.5 - 0.4j, -0.5 + 2e-5j], [-3.0 - 0.1j, 0.125 + 0.01j]])
PAIRS = ("1X/2X", "2X/2X")


def frf_table(
    head="Frequency [Hz]", parts=(" [m/N] re", " [m/N] im"), columns=None, lines=LINES, second="", comma=False
):
    """Both responses, in `columns` of each: functions of the response."""
    columns = columns or (lambda h: f"{h.real:.9g}", lambda h: f"{h.imag:.9g}")
    header = [head, *(pair + part for pair in PAIRS for part in parts)]
    rows = [
        [f"{f:.9g}", *(column(h) for h in row for column in columns)] for f, row in zip(lines, RESPONSES, strict=True)
    ]
    separator = ";" if comma else ","
    cells = [[cell.replace(".", ",") for cell in row] for row in rows] if comma else rows
    return "\n".join(separator.join(row) for row in [header, *([second.split(",")] if second else []), *cells]) + "\n"


def degrees(h):
    return f"{np.rad2deg(np.angle(h)):.9g}"


def radians(h):
    return f"{np.angle(h):.9g}"


def size(h):
    return f"{abs(h):.9g}"


def cell(h):
    return f"{h.real:.9g}{h.imag:+.9g}i"


POLAR = (" mag [m/N]", " phase [deg]")
NUMBERED = {"outputs": "1X,2X", "inputs": "2X", "unit": "m/N"}


@pytest.mark.parametrize(
    ("text", "options", "layout"),
    [
        *((frf_table(head), {}, {}) for head in ("f [Hz]", "Freq [Hz]", "Freq. (Hz)", "Frequenz [Hz]", "f / Hz")),
        (frf_table("Frequency [kHz]", lines=LINES / 1e3), {}, {}),
        (frf_table("omega [rad/s]", lines=LINES * 2 * np.pi), {}, {}),
        (frf_table("Frequency"), {"axis_unit": "Hz"}, {}),
        (frf_table("Line", lines=LINES * 2 * np.pi), {"axis_unit": "rad/s"}, {}),
        (frf_table("Frequency", (" re", " im"), second="Hz,m/N,m/N,m/N,m/N"), {}, {}),
        (frf_table("Frequency", (" re", " im"), second="[Hz],[m/N],[m/N],[m/N],[m/N]"), {}, {}),
        (frf_table(parts=(" re", " im")), {"unit": "m/N"}, {}),
        (frf_table(parts=(" [m/N] Real", " [m/N] Imag")), {}, {}),
        (frf_table(parts=(" (Real) [m/N]", " (Imaginary) [m/N]")), {}, {}),
        (frf_table(parts=POLAR, columns=(size, degrees)), {}, {}),
        (frf_table(parts=POLAR, columns=(size, degrees), comma=True), {}, {}),
        (frf_table(parts=(" [m/N] magnitude", " [m/N] phase"), columns=(size, degrees)), {}, {}),
        (frf_table(parts=(" [m/N] Amplitude", " Phase"), columns=(size, radians)), {}, {"phase_unit": "rad"}),
        (frf_table(parts=(" [m/N] magnitude", " [m/N] phase"), columns=(size, radians)), {}, {"phase_unit": "rad"}),
        (frf_table(parts=("_abs_re", "_abs_im")), NUMBERED | {"unit": "m/N"}, {"parts": ("re", "im")}),
        (frf_table(parts=(" [m/N] abs", " angle (rad)"), columns=(size, radians)), {}, {}),
        (frf_table(parts=(" [m/N]",), columns=(cell,)), {}, {}),
        (frf_table(parts=(" [m/N]",), columns=(cell,), comma=True), {}, {}),
        (frf_table(parts=(" first", " second")), NUMBERED, {"parts": ("re", "im")}),
        (frf_table(parts=(" a", " b"), columns=(degrees, size)), NUMBERED, {"parts": "phase, magnitude"}),
        (frf_table(parts=("",), columns=(cell,)), NUMBERED, {"parts": ("re", "im")}),
        (frf_table().partition("\n")[2], NUMBERED | {"axis_unit": "Hz"}, {"parts": ("re", "im")}),
    ],
)  # fmt: skip
def test_frfs_as_laboratories_write_them(tmp_path, text, options, layout):
    record = read(tmp_path, text, **options, csv=CsvLayout(**layout))
    np.testing.assert_allclose(record.frequency, LINES, rtol=1e-8)
    np.testing.assert_allclose(record.values[:, :, 0], RESPONSES, rtol=1e-7, atol=1e-9)
    assert (record.kind, [str(dof) for dof in record.outputs], str(record.inputs[0])) == (
        "receptance",
        ["1X+", "2X+"],
        "2X+",
    )


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        (frf_table("Frequency"), {}, r"does not say the unit of its frequencies, .* give `axis_unit = .Hz.`"),
        (frf_table("Line"), {}, r"of frequency responses `axis_unit = .Hz.`"),
        (frf_table(parts=(" [m/N] abs", " angle"), columns=(size, radians)), {}, '`phase_unit = "deg"` in'),
        (frf_table(parts=(" [m/N]",), columns=(cell,)).replace("2.5-0.4i", "2.5"), {}, "line 3, column 2 .* a complex number"),
        (frf_table(), {"csv": CsvLayout(parts=("re", "im"))}, "4 columns follow the frequencies, but 0 `outputs` x 0 `inputs`"),
        (frf_table(parts=(" re", " im")), {}, r"line 1, column 2 .*has no unit; .* or give `unit` in \[record\]"),
        (frf_table(parts=(" [m/N] abs", " [m/N] re"), columns=(size, degrees)), {}, r"no column 1X\+/2X\+ phase"),
        (frf_table() + "\n,,\nMean,,,\n", {}, r"line 7 \(Mean, , , \) ends the numbers.*`footer_rows = 3`"),
        (
            "Hammer\n" + frf_table("f", (" re", " im"), second="Hz,m/N,m/N,m/N,m/N"), {},
            r"line 2 \(f, 1X/2X re, .* names the columns, give `skip_rows = 1` in \[record.csv\]$",
        ),
    ],
)  # fmt: skip
def test_what_frfs_of_laboratories_lack_is_named_with_a_remedy(tmp_path, text, options, words):
    with pytest.raises((FileError, InputError), match=words):
        read(tmp_path, text, **options)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig"])
def test_an_encoding_that_the_file_marks_need_not_be_said(tmp_path, encoding):
    text = table("\t", head=["Zeit [s]\tA [m/s²]\tB [g]\tKraft [N]"])
    assert read(tmp_path, text, encoding, channels="1X,2X,1X").values[1, 0] == 1.5


@pytest.mark.parametrize(
    ("cell", "words"),
    [
        ("#NV", "line 4, column 2 .* clear the cell where a sample is missing"),
        ("n/a", "clear the cell where a sample is missing"),
        ("---", "clear the cell where a sample is missing"),
        ("12x", "must be a number, got '12x'$"),
    ],
)
def test_words_in_place_of_a_missing_sample_are_told(tmp_path, cell, words):
    lines = table().splitlines()
    lines[3] = f"{2 / RATE:.9f},{cell},1,2"
    with pytest.raises(FileError, match=words):
        read(tmp_path, "\n".join(lines) + "\n", **THREE)


@pytest.mark.parametrize("cell", ["1.234,5", "1 234,5", "-12.345.678,0"])
def test_thousands_that_are_set_apart_are_told(tmp_path, cell):
    text = "Zeit_s;Acc A\n" + "".join(f"{k / 8};{cell}\n".replace(".125", ",125") for k in range(5))
    with pytest.raises(FileError, match=f"'{cell}' looks like thousands separators: export without them"):
        read(tmp_path, text, channels="1X", units="g")


HARD = [
    "t_s,1X [g],2X [g]\n" + "".join(f"{k / 8},{k},{-k}\n" for k in range(6)),
    "t_s;1X [g];2X [g]\n" + "".join(f"{k / 8};{k}.5;{-k}e-3\n".replace(".", ",") for k in range(6)),
    "t_s;1X [g];2X [g]\n" + "".join(f"{k / 8};{k};{-k};\n" for k in range(6)),
    "t_s 1X 2X\n" + "".join(f"  {k / 8}  {k}\t{-k} \n" for k in range(6)),
    "t_s,1X [g],2X [g]\n0,1,\n0.125,,2\n0.25,,\n0.375,3,4\n0.5,3,4\n",
    "t_s,1X [g],2X [g]\n0,1, \n0.125,nan,2\n0.25,inf,1\n0.375,3,4\n",
    "t_s,1X [g],2X [g],\n0,1,2,\n0.125,1,2\n0.25,1,,\n0.375,1,2,3\n",
    "t_s,1X [g],2X [g]\n0,1,2\n\n0.25,1,2\n0.375,1,2\n",
    "t_s,1X [g],2X [g]\n0,1,2\n0.125,1\n0.25,1,2\n",
    "t_s,1X [g],2X [g]\n0,1,2\n0.125,1,2,3\n0.25,1,2\n",
    "t_s,1X [g],2X [g]\n0,1,2\n0.125,1,two\n0.25,1,2\n",
    "t_s,1X [g],2X [g]\n0,1,2\n,1,2\n0.25,1,2\n",
    't,1X [g],2X [g]\n0,"1",2\n0.125,1,2\n0.25,1,2\n',
    "t_s,1X [g],2X [g]\n0,1_0,2\n0.125,1,2\n0.25,1,2\n",
    "t_s,1X [g],2X [g]\n2026-02-01T10:00:00,1,2\n2026-02-01T10:00:00.5,1,\n2026-02-01T10:00:01,1,2\n",
    "frequency_hz,1X/1X [(m/s^2)/N] re,1X/1X [(m/s^2)/N] im\n1,2,3\n2,4,5\n3,4,6\n",
    "frequency_hz,1X/1X [(m/s^2)/N] re,1X/1X [(m/s^2)/N] im\n1,2,3\n2,,5\n3,4,6\n",
    "frequency_hz,1X/1X [(m/s^2)/N] re,1X/1X [(m/s^2)/N] im\n1,2,3\n2,nan,5\n3,4,6\n",
    "t_s,1X [g],2X [g]\n0,1,2\n0.125,1,2\n0.25,1,2\nMean,1,2\n",
]  # fmt: skip


@pytest.mark.parametrize("text", HARD)
def test_all_lines_at_once_are_read_as_one_by_one(tmp_path, monkeypatch, text):
    """The same values, or the same words on what is wrong."""
    (tmp_path / "lab.csv").write_text(text, encoding="utf-8")

    def outcome():
        try:
            return read_table(tmp_path / "lab.csv")
        except FileError as error:
            return str(error)

    quick = outcome()
    monkeypatch.setattr("structid.records.formats.csv.table._parse_fast", lambda *_: None)
    slow = outcome()
    if isinstance(slow, str):
        assert quick == slow
        return
    np.testing.assert_array_equal(quick.values, slow.values)
    assert [quick.column(j) for j in (0, 2)] == [[row[j].strip() for row in slow.texts] for j in (0, 2)]


@pytest.mark.parametrize("text", [*HARD[:5], HARD[14], HARD[15]])
def test_plain_tables_are_read_at_once(tmp_path, monkeypatch, text):
    def slow(*_):
        raise AssertionError("line by line")

    monkeypatch.setattr("structid.records.formats.csv.table._parse_cells", slow)
    (tmp_path / "lab.csv").write_text(text, encoding="utf-8")
    assert len(read_table(tmp_path / "lab.csv").values) == text.count("\n") - 1


def test_a_record_is_kept_until_its_file_changes(tmp_path, monkeypatch):
    """In a process that asks for it, by what was said of the file, and no more bytes than were allowed."""
    path = tmp_path / "lab.csv"
    path.write_text(HARD[0], encoding="utf-8")
    assert read_record(path) is not read_record(path)
    keep_records(150)  # 2 channels of 6 samples, 96 bytes
    try:
        first = read_record(path)
        assert read_record(path, ReadOptions()) is first
        one = read_record(path, ReadOptions(columns="1X"))
        assert len(one.channels) == 1
        assert read_record(path) is first
        path.write_text(HARD[0].replace("0.5", "0.50"), encoding="utf-8")
        assert read_record(path) is not first
        assert read_record(path, ReadOptions(columns="1X")) is not one
        path.write_text(HARD[0] + "".join(f"{k / 8},{k},{-k}\n" for k in range(6, 20)), encoding="utf-8")
        assert read_record(path) is not read_record(path)  # too large
    finally:
        keep_records(0)
