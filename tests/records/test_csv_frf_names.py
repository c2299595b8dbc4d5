"""Tables of FRFs whose headers name sensors and loads, as a laboratory writes them."""

import re

import numpy as np
import pytest

from structid.core.errors import FileError, InputError
from structid.core.units import STANDARD_GRAVITY
from structid.records.formats import read_record
from structid.records.formats.options import CsvLayout, ReadOptions, options_given_as_flags

FREQUENCY = np.arange(1.0, 5.0)
#: Response of sensor s to load l, in the file's unit.
VALUES = {(s, load): (10 * s + load) * (1 + 0.1j * s) * FREQUENCY for s in (1, 2, 3) for load in (1, 2)}


def table(path, heads):
    """A table of columns headed by texts, each of (sensor, load, part)."""
    columns = [
        np.real(VALUES[s, load]) if part == "re" else np.imag(VALUES[s, load]) for s, load, part in heads.values()
    ]
    rows = np.column_stack([FREQUENCY, *columns]).tolist()
    lines = [",".join(["Frequency [Hz]", *heads]), *(",".join(map(repr, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def heads(form, order):
    """Headers by `form`, with what their columns hold, in `order` of the loops over sensors, loads and parts."""
    words = {"re": "Real", "im": "Imaginary"}
    keys = [(s, load, part) for s in (1, 2, 3) for load in (1, 2) for part in ("re", "im")]
    return {form.format(s=s, load=load, part=words[part]): (s, load, part) for s, load, part in sorted(keys, key=order)}


ORDERS = {
    "sensors first": lambda key: (key[0], key[1], key[2] != "re"),
    "loads first": lambda key: (key[1], key[0], key[2] != "re"),
    "parts first": lambda key: (key[2] != "re", key[0], key[1]),
}


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(
    "form", ["A{s}/H{load} (g/N) {part}", "A{s}/H{load} [g/N] {part}", "H{load}/A{s} (g/N) {part}"]
)
def test_columns_are_read_by_their_names_in_any_order(tmp_path, form, order):
    options = ReadOptions(outputs=("1X", "2X", "3X"), inputs=("1X", "2X"))
    record = read_record(table(tmp_path / "lab.csv", heads(form, ORDERS[order])), options)
    assert record.kind == "accelerance"
    for (s, load), values in VALUES.items():
        i, j = (
            [str(dof)[0] for dof in record.outputs].index(str(s)),
            [str(dof)[0] for dof in record.inputs].index(str(load)),
        )
        np.testing.assert_allclose(record.values[:, i, j], values * STANDARD_GRAVITY, rtol=1e-12)


@pytest.mark.parametrize("order", ["loads first", "parts first"])
def test_parts_that_contradict_the_headers_are_refused(tmp_path, order):
    path = table(tmp_path / "lab.csv", heads("A{s}/H{load} (g/N) {part}", ORDERS[order]))
    options = ReadOptions(
        outputs=("1X", "2X", "3X"), inputs=("1X", "2X"), unit="g/N", csv=CsvLayout(parts=("re", "im"))
    )
    with pytest.raises((FileError, InputError), match="the header contradicts `parts`, `outputs` and `inputs`"):
        read_record(path, options)


def test_headers_that_name_other_degrees_of_freedom_than_stated_are_refused(tmp_path):
    path = table(tmp_path / "lab.csv", heads("{s}X/{load}X (g/N) {part}", ORDERS["sensors first"]))
    options = ReadOptions(
        outputs=("1X", "2X", "5X"), inputs=("1X", "2X"), unit="g/N", csv=CsvLayout(parts=("re", "im"))
    )
    with pytest.raises((FileError, InputError), match="the header contradicts `parts`, `outputs` and `inputs`"):
        read_record(path, options)


def test_parts_that_agree_with_the_headers_are_read(tmp_path):
    path = table(tmp_path / "lab.csv", heads("A{s}/H{load} (g/N) {part}", ORDERS["sensors first"]))
    options = ReadOptions(
        outputs=("1X", "2X", "3X"), inputs=("1X", "2X"), unit="g/N", csv=CsvLayout(parts=("re", "im"))
    )
    record = read_record(path, options)
    np.testing.assert_allclose(record.values[:, 2, 1], VALUES[3, 2] * STANDARD_GRAVITY, rtol=1e-12)


def test_hints_name_what_the_reader_can_give(tmp_path):
    path = tmp_path / "lab.csv"
    path.write_text("made by a logger\non a day\ntime_s,1X [m/s^2]\n0.0,1.0\n0.1,2.0\n", encoding="utf-8")
    with pytest.raises(FileError, match=r"give `skip_rows = 2` in \[record.csv\]"):
        read_record(path)
    with options_given_as_flags(), pytest.raises(FileError, match="give --csv-skip-rows 2"):
        read_record(path)


@pytest.mark.parametrize("form", [
    "H1 {s}X/{load}X [g/N] {part}",
    "H {s}X+/{load}X+ (g/N) {part}", "FRF: {s}X/{load}X [g/N] {part}", "{part} Hv {s}X/{load}X [g/N]",
    "{part} {s}X+/{load}X+ [g/N]", "H2_{s}:+X/{load}:+X_{part} [g/N]",
])  # fmt: skip
def test_the_estimator_and_the_part_may_stand_before_a_pair(tmp_path, form):
    """The response comes first, the reference behind it."""
    record = read_record(table(tmp_path / "lab.csv", heads(form, ORDERS["loads first"])))
    for (s, load), values in VALUES.items():
        i, j = (
            [str(dof) for dof in record.outputs].index(f"{s}X+"),
            [str(dof) for dof in record.inputs].index(f"{load}X+"),
        )
        np.testing.assert_allclose(record.values[:, i, j], values * STANDARD_GRAVITY, rtol=1e-12)


@pytest.mark.parametrize("head, words", [
    ("H11X/2X [g/N] Real", "'H11X'"), ("H1 P1/2X [g/N] Real", "'H1 P1'"), ("H1 [g/N] Real", "head a pair"),
])  # fmt: skip
def test_what_could_be_an_estimator_or_a_name_is_asked_for(tmp_path, head, words):
    path = tmp_path / "lab.csv"
    rows = "".join(f"{f},1,2\n" for f in FREQUENCY)
    path.write_text(f"Frequency [Hz],{head},{head.replace('Real', 'Imag')}\n{rows}")
    with pytest.raises(FileError, match=words):
        read_record(path)


@pytest.mark.parametrize("names, words", [
    (["P1", "2X", "P3"], "(outputs: P1, 2X, P3), in this order"),
    ([f"P{k}" for k in range(1, 13)], "P7, P8 and 4 more), in this order"),
])  # fmt: skip
def test_all_names_that_need_a_meaning_are_listed_beside_degrees_of_freedom(tmp_path, names, words):
    """As many as `outputs` must have."""
    path = tmp_path / "lab.csv"
    columns = [f"{name}/9X [g/N] {part}" for name in names for part in ("Real", "Imag")]
    rows = "".join(f"{f}{',1' * len(columns)}\n" for f in FREQUENCY)
    path.write_text(f"Frequency [Hz],{','.join(columns)}\n{rows}")
    with pytest.raises(FileError, match=re.escape(words)):
        read_record(path)
    given = ReadOptions(outputs=tuple(f"{k}X" for k in range(11, 11 + len(names))))
    assert len(read_record(path, given).outputs) == len(names)


@pytest.mark.parametrize("form", ["H1({s}:+X/{load}:+X) {part} (g/N)", "FRF[{s}X/{load}X] {part} (g/N)"])
def test_a_pair_in_brackets_behind_an_estimator_is_a_pair(tmp_path, form):
    record = read_record(table(tmp_path / "lab.csv", heads(form, ORDERS["sensors first"])))
    assert [str(dof) for dof in record.outputs] == ["1X+", "2X+", "3X+"]
    assert [str(dof) for dof in record.inputs] == ["1X+", "2X+"]
    for (s, load), values in VALUES.items():
        np.testing.assert_allclose(record.values[:, s - 1, load - 1], values * STANDARD_GRAVITY, rtol=1e-12)


def decibels(path, head, phase="1X/3X phase (deg)", reference=1.0):
    """A table of one FRF as magnitude in dB of `reference` (in the file's unit) and phase in degrees; returns the FRF too."""
    values = VALUES[1, 1] * np.exp(1j * FREQUENCY)
    columns = [FREQUENCY, 20 * np.log10(np.abs(values) / reference), np.degrees(np.angle(values))]
    rows = [",".join(map(repr, row)) for row in np.column_stack(columns).tolist()]
    path.write_text("\n".join([f"Frequency [Hz],{head},{phase}", *rows]) + "\n", encoding="utf-8")
    return path, values


@pytest.mark.parametrize(
    ("head", "reference", "to_si"),
    [
        ("1X/3X magnitude (dB re 1 g/N)", 1.0, STANDARD_GRAVITY),
        ("1X/3X magnitude [dB re g/N]", 1.0, STANDARD_GRAVITY),
        ("1X/3X [dB(g/N)] magnitude", 1.0, STANDARD_GRAVITY),
        ("1X/3X magnitude (dB ref. 1e-3 (m/s^2)/N)", 1e-3, 1.0),
        ("1X/3X magnitude (dB rel 20 mm/N)", 20.0, 1e-3),
        ("1X/3X magnitude (dB re 10^-6 m/N)", 1e-6, 1.0),
        ("1X/3X magnitude (dB re 1.0e-6m/N)", 1e-6, 1.0),
    ],
)
def test_magnitudes_in_decibels_are_read_by_their_reference(tmp_path, head, reference, to_si):
    path, values = decibels(tmp_path / "lab.csv", head, reference=reference)
    np.testing.assert_allclose(read_record(path).values[:, 0, 0], values * to_si, rtol=1e-12)


def test_decibels_of_a_reference_of_0_are_refused(tmp_path):
    path, _ = decibels(tmp_path / "lab.csv", "1X/3X magnitude (dB re 0 g/N)")
    with pytest.raises(FileError, match="does not say what 0 dB is"):
        read_record(path)


def test_decibels_without_a_reference_need_the_unit(tmp_path):
    path, values = decibels(tmp_path / "lab.csv", "1X/3X magnitude (dB)")
    with pytest.raises(
        FileError, match=r"line 1, column 2 .*does not say what 0 dB is; head it as in .* or say the unit"
    ):
        read_record(path)
    record = read_record(path, ReadOptions(unit="g/N"))
    np.testing.assert_allclose(record.values[:, 0, 0], values * STANDARD_GRAVITY, rtol=1e-12)
    path, values = decibels(tmp_path / "real.csv", "1X/3X re (dB re 1 g/N)", "1X/3X im (g/N)")
    with pytest.raises(FileError, match="'dB' stands for a level"):
        read_record(path)
