"""Small files after those of people who do this job, each of a kind that was read wrongly once: read right, or refused truly."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from structid.cli.app import app
from structid.core.errors import FileError, InputError
from structid.records import ReadOptions, read_record

FILES = Path(__file__).parent / "field_files"
FIRST = -1.08604e-3 + 2.17753e-6j  # of the FRFs, at 1 Hz
GRAVITY, POUND = 9.80665, 0.45359237 * 9.80665


def read(name, **options):
    return read_record(FILES / name, ReadOptions(**options))


@pytest.mark.parametrize(
    "name, factor, words",
    [
        ("lab_G_LB.unv", GRAVITY / POUND, "in G per LB"),
        ("lab_in.unv", 0.0254 / POUND, "in in/sec^2 per lbs"),
        ("u12_khz.unv", 1, "frequencies in kHz"),
        ("u12_rads.unv", 1, "frequencies in rad/s"),
        ("u12_rpm.unv", 1, "frequencies in rpm"),
        ("u1_padded.unv", 1, ""),
        ("u15_dexp.unv", 1, ""),
        ("u15_fortran3.unv", 1e-150, ""),
    ],
)
def test_frfs_in_si(name, factor, words):
    record = read(name)
    np.testing.assert_allclose(record.frequency, np.arange(1, 51.1, 0.5), rtol=2e-6)
    np.testing.assert_allclose(record.values[0, 0, 0], FIRST * factor, rtol=1e-5)
    assert record.kind == "accelerance"
    assert record.source == "; ".join(filter(None, (str(FILES / name), words)))


@pytest.mark.parametrize(
    "name, words",
    [
        ("lab_tEU.unv", r"unit label of 1Z\+ .*'EU' .*engineering units.*--units "),
        ("lab_volts.unv", r"unit label of 1Z\+ .*'V' .*V at 100 mV/g.*--unit "),
        ("mag_only.unv", r"function 1, the FRF of 1Z\+/1Z\+, .*a magnitude without its phase"),
        ("u4_mixed.unv", "response of function 3, at node 9, has direction 0.*`channels`.*`columns`"),
    ],
)
def test_what_a_file_does_not_say_is_asked_for(name, words):
    with pytest.raises(FileError, match=words):
        read(name)


def test_voltages_with_their_sensors_become_si():
    record = read("lab_volts.unv", unit="(V at 100 mV/g)/(V at 10 mV/N)")
    np.testing.assert_allclose(record.values[0, 0, 0], FIRST * GRAVITY / 0.1 * 0.01, rtol=1e-5)


def test_times_in_ms():
    record = read("u12_ms.unv")
    assert record.sampling_rate == pytest.approx(1000, rel=1e-9)
    assert record.source.endswith("; times in ms")


def test_sensors_of_a_turned_node_are_along_global_axes():
    record = read("cs_frf.unv")
    assert [str(dof) for dof in (*record.outputs, *record.inputs)] == ["1Y+", "2Y+", "1Y+"]
    assert "1X+ is 1Y+ in global axes" in record.source
    np.testing.assert_allclose(record.values[0, 0, 0], FIRST, rtol=1e-5)
    named = read("cs_frf.unv", axes="named")
    assert [str(dof) for dof in (*named.outputs, *named.inputs)] == ["1X+", "2X+", "1X+"]


def test_what_is_wanted_is_chosen_before_units_are_asked():
    by_name, by_number = read("u4_mixed.unv", channels="1Z,2Z"), read("u4_mixed.unv", columns="1,2")
    np.testing.assert_array_equal(by_name.values, by_number.values)
    assert [str(dof) for dof in by_name.channels] == ["1Z+", "2Z+"]
    called = read("u4_mixed.unv", columns="2,1", channels="5X,6X")
    assert [str(dof) for dof in called.channels] == ["5X+", "6X+"]
    np.testing.assert_array_equal(called.values, by_name.values[:, ::-1])
    scalar = read("u4_mixed.unv", columns=[3], channels="9Z", units="g")  # a direction that the file does not say
    np.testing.assert_allclose(scalar.values[1, 0], 1.24958e-1 * GRAVITY, rtol=1e-5)


def test_an_object_beside_arrays_is_passed_over():
    record = read("opaque_and_plain.mat", sampling_rate=100, channels="1X,2X", units="g")
    assert record.values.shape == (2000, 2)


@pytest.mark.parametrize("head", ["Time ms", "time_ms", "millis", "Time [ms]", "t_ms"])
def test_times_of_a_table_in_ms(tmp_path, head):
    text = (FILES / "time_ms_short.csv").read_text()
    path = tmp_path / "a.csv"
    path.write_text(text.replace("Time ms", head, 1))
    options = ReadOptions(channels="1X,1Y", time_column=head)
    assert read_record(path, options).sampling_rate == pytest.approx(200, rel=1e-9)
    path.write_text(text.replace("Time ms", "Time", 1))
    with pytest.raises(InputError, match=r"does not say the unit of its times; give `axis_unit`.*: s, ms"):
        read_record(path, ReadOptions(channels="1X,1Y"))
    assert read_record(path, ReadOptions(channels="1X,1Y", axis_unit="ms")).sampling_rate == pytest.approx(200)


def test_times_that_count_milliseconds_from_1970_are_not_read_as_seconds(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("Time,1X [g]\n" + "".join(f"{1764237600000 + 4 * k},{k % 3}\n" for k in range(9)))
    with pytest.raises(FileError, match=r"line 2, column 1 \(Time\) is 1764237600000, which would be 55,905 years"):
        read_record(path, ReadOptions(axis_unit="s", time_column=1))
    assert read_record(path, ReadOptions(axis_unit="ms", time_column=1)).sampling_rate == pytest.approx(250, rel=1e-5)


@pytest.mark.parametrize(
    ("head", "said", "stated"),
    [("Hz", "rad/s", "Hz"), ("Angular frequency [rad/s]", "Hz", "rad/s"), ("X kHz", "Hz", "kHz"), ("ms", "s", "ms")],
)
def test_a_unit_in_the_head_of_an_axis_is_not_overruled_in_silence(tmp_path, head, said, stated):
    path = tmp_path / "a.csv"
    columns = "1X [g]" if head == "ms" else "1X/2X [g/N] re,1X/2X [g/N] im"
    path.write_text(
        f"{head},{columns}\n" + "".join(f"{4 * k},{k % 3}{'' if head == 'ms' else ',1'}\n" for k in range(1, 9))
    )
    times = {"time_column": 1} if head == "ms" else {}
    with pytest.raises(InputError, match=f"`axis_unit` {said} was given; give `axis_unit = .{stated}.`"):
        read_record(path, ReadOptions(axis_unit=said, **times))
    read_record(path, ReadOptions(axis_unit=stated, **times))
    if not times:
        with pytest.raises(FileError, match=f"of frequency responses `axis_unit = .{stated}.`"):
            read_record(path)


def test_times_of_a_clock_go_on_after_midnight(tmp_path):
    path = tmp_path / "a.csv"
    clock = ["23:59:59.50", "23:59:59.75", "00:00:00.00", "00:00:00.25", "0:00:00.50", "0:00:00.75"]
    path.write_text("Time;1X [g]\n" + "".join(f"{t};{k % 3},5\n" for k, t in enumerate(clock)))
    record = read_record(path)
    assert record.sampling_rate == pytest.approx(4)
    assert record.values[:, 0] == pytest.approx(9.80665 * (np.arange(6) % 3 + 0.5))
    path.write_text(path.read_text().replace("23:59:59.75", "22:59:59.75"))
    with pytest.raises(FileError, match="line 3"):
        read_record(path)
    path.write_text("Zeit;1X [g]\n" + "".join(f"27.11.26 10:00:{k:02d};{k}\n" for k in range(9)))
    with pytest.raises(FileError, match=r"times such as '27.11.26 10:00:00' are not understood; write them in s"):
        read_record(path)


@pytest.mark.parametrize(
    ("head", "times"),
    [
        ("Datum", [f"05.03.2026 23:59:5{9 - k}" for k in range(1, -1, -1)] + ["06.03.2026 0:00:00"]),
        ("Timestamp", ["03/05/2026 11:59:58 PM", "03/05/2026 11:59:59 PM", "03/06/2026 12:00:00 AM"]),
        ("Timestamp", ["13/05/2026 12:59:58", "13/05/2026 12:59:59", "13/05/2026 13:00:00"]),
        ("Date;Time", ["2026-03-05;23:59:58", "2026-03-05;23:59:59", "2026-03-06;00:00:00"]),
        ("Date;Time", ["05.03.2026;11:59:58 AM", "05.03.2026;11:59:59 AM", "05.03.2026;12:00:00 PM"]),
    ],
)
def test_dates_of_europe_and_america_are_read(tmp_path, head, times):
    path = tmp_path / "a.csv"
    path.write_text(f"{head};1X [g]\n" + "".join(f"{t};{k},25\n" for k, t in enumerate(times)))
    record = read_record(path)
    assert record.sampling_rate == pytest.approx(1)
    assert record.values[:, 0] == pytest.approx(9.80665 * np.array([0.25, 1.25, 2.25]))
    assert ("Date left out" in record.source) == ("Date;" in head)
    path.write_text(path.read_text().replace("58", "57", 1))
    with pytest.raises(FileError, match="must be even"):
        read_record(path)


@pytest.mark.parametrize(
    ("head", "lines"),
    [
        ("Datum;Uhrzeit", ["05.03.2026;10:00:00", "05.03.2026;10:00:01", "05.03.2026;10:00:02"]),
        ("Date;Clock", ["2026-03-05;23:59:59", "2026-03-06;00:00:00", "2026-03-06;00:00:01"]),
        ("Sample;Stamp", ["1;2026-03-05 10:00:00", "2;2026-03-05 10:00:01", "3;2026-03-05 10:00:02"]),
        ("Date;Time [s]", ["2026-03-05 00:00:00;0", "2026-03-05 00:00:00;1", "2026-03-05 00:00:00;2"]),
    ],
)
def test_the_column_with_a_time_of_day_is_the_clock(tmp_path, head, lines):
    """Whatever its header; dates that all are midnight are days."""
    path = tmp_path / "a.csv"
    path.write_text(f"{head};1X [g]\n" + "".join(f"{line};{k},25\n" for k, line in enumerate(lines)))
    columns = ["1X"] if head.startswith("Sample") else []
    assert read_record(path, ReadOptions(columns=columns) if columns else None).sampling_rate == pytest.approx(1)


def test_two_clocks_that_disagree_are_refused(tmp_path):
    """Stamps that begin at midnight are no bare days."""
    path = tmp_path / "a.csv"
    path.write_text("Date;Time [s];1X [g]\n" + "".join(f"2026-03-05 00:00:0{k};{k / 2};{k}.25\n" for k in range(3)))
    with pytest.raises(FileError, match=r"column 2 \('Time \[s\]'\)"):
        read_record(path)


def test_a_second_header_and_overloads_are_told(tmp_path):
    path = tmp_path / "a.csv"
    run = "Time [s];1X [g]\n" + "".join(f"{k};{k},5\n" for k in range(9))
    path.write_text(run + run)
    with pytest.raises(FileError, match=r"line 11, column 1 \(Time \[s\]\) .*the header stands here again"):
        read_record(path)
    path.write_text(run.replace(";4,5", ";OVL"))
    with pytest.raises(FileError, match=r"line 6, column 2 .*clear the cell"):
        read_record(path)


@pytest.mark.parametrize("decimals", [7, 9])
def test_clocks_of_more_decimals_than_microseconds_are_even(tmp_path, decimals):
    """As .NET and LabVIEW write them: 3000 Hz, a step of 333.333333 us."""
    path, step = tmp_path / "a.csv", 1 / 3000
    for day in ("", "2026-11-27T"):
        rows = [f"{day}12:00:{k * step:0{decimals + 3}.{decimals}f}+01:00;{k % 3}" for k in range(300)]
        rows = rows if day else [row.replace("+01:00", "") for row in rows]
        path.write_text("Time;1X [g]\n" + "\n".join(rows) + "\n")
        assert read_record(path).sampling_rate == pytest.approx(3000, rel=1e-5)


@pytest.mark.parametrize("hours", [23, 99, 100])
def test_times_gone_by_may_be_longer_than_a_day(tmp_path, hours):
    path = tmp_path / "a.csv"
    seconds = 3599.5 + 0.25 * np.arange(8)
    clock = [f"{hours + int(t // 3600)}:{int(t % 3600 // 60):02d}:{t % 60:05.2f}" for t in seconds]
    path.write_text("Time;1X [g]\n" + "".join(f"{t};{k % 3},5\n" for k, t in enumerate(clock)))
    record = read_record(path)
    assert record.sampling_rate == pytest.approx(4)
    assert len(record.values) == 8


def run(*words):
    ran = CliRunner().invoke(app, list(map(str, words)))
    return ran.exit_code, " ".join(ran.output.split())


def test_a_mode_at_the_end_of_the_band_is_refused_in_words():
    bare = "--array h --frequency-array f --outputs 1Z,2Z --inputs 1Z --kind accelerance --no-report --band 1 20"
    code, output = run("modes", FILES / "good.npz", *bare.split())
    assert code == 1
    assert "leaves this band when it is refined; put the ends of the band between resonances" in output


def test_a_study_weighs_the_mass_whose_frfs_are_in_g_and_pounds(tmp_path):
    """1.047 kg, and not the 2.309 kg of numbers that are taken as SI."""
    for name in ("sdof.toml", "lab_G_LB.unv"):
        shutil.copy(FILES / name, tmp_path)
    code, output = run(
        "identify", tmp_path / "sdof.toml", "--no-report", "--no-explain", "--verbose", "--out", tmp_path / "out"
    )
    assert code in (0, 3)
    assert "Total mass: 1.047" in output
