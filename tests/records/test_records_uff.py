"""Universal files against files that pyuff writes and reads: ASCII, signs, units, geometry, gaps."""

import numpy as np
import pytest
import pyuff

from structid.core.errors import FileError, InputError
from structid.records import Geometry, ReadOptions, TimeRecord, read_geometry, read_record
from structid.records.formats.uff import uff

FREQUENCY = np.arange(4, 14) * 0.25


def function(response, reference, data, func_type=4, x=FREQUENCY, ordinate=12, denominator=13, **more):
    """A dataset 58 as `pyuff` takes it; `response` and `reference` are (node, direction)."""
    return {
        "type": 58, "binary": 0, "func_type": func_type, "rsp_node": response[0], "rsp_dir": response[1],
        "ref_node": reference[0], "ref_dir": reference[1], "data": np.asarray(data), "x": x, "abscissa_spacing": 1,
        "id1": "a", "id2": "", "id3": "", "id4": "", "id5": "", "load_case_id": 0, "func_id": 0, "ver_num": 0,
        "ordinate_spec_data_type": ordinate, "orddenom_spec_data_type": denominator,
        "abscissa_spec_data_type": 17 if func_type == 1 else 18, **more,
    }  # fmt: skip


def units(length=1.0, force=1.0):
    return {"type": 164, "units_code": 9, "units_description": "x", "temp_mode": 1, "length": length, "force": force,
            "temp": 1.0, "temp_offset": 0.0}  # fmt: skip


def header():
    return {"type": 151, "model_name": "m", "description": "d", "db_app": "x", "program": "p"}


def write(path, datasets):
    pyuff.UFF(str(path)).write_sets(datasets, mode="add")
    return path


@pytest.fixture
def values(rng):
    return rng.normal(size=(10, 2, 2)) + 1j * rng.normal(size=(10, 2, 2))


def frfs(values, **more):
    outputs, inputs = [(1, -3), (7, 5)], [(2, 1), (2, -6)]
    return [function(o, i, values[:, a, b], **more) for a, o in enumerate(outputs) for b, i in enumerate(inputs)]


def test_reads_what_pyuff_writes(tmp_path, values):
    path = write(tmp_path / "a.uff", [header(), units(), *frfs(values)])
    record = read_record(path)
    assert [str(d) for d in (*record.outputs, *record.inputs)] == ["1Z-", "7RY+", "2X+", "2RZ-"]
    np.testing.assert_allclose(record.values, values, rtol=1e-11)  # ASCII has 12 digits
    np.testing.assert_allclose(record.frequency, FREQUENCY, rtol=1e-14)
    assert record.kind == "accelerance"


def test_no_unit_is_assumed(tmp_path, values):
    path = write(tmp_path / "a.unv", frfs(values)[:1])
    with pytest.raises(FileError, match=r"nothing says the unit of the acceleration at 1Z-.*--unit "):
        read_record(path)
    record = read_record(path, ReadOptions(unit="(m/s^2)/N"))
    np.testing.assert_allclose(record.values[:, 0, 0], values[:, 0, 0], rtol=1e-11)
    assert record.source.endswith("a.unv; in (m/s^2)/N as given; frequencies in Hz, as the format has them")


@pytest.mark.parametrize(
    "label, words", [("g", "in (m/s^2)/N as given, though the file says g per N;"), ("m/s^2", "in (m/s^2)/N as given;")]
)
def test_a_unit_that_is_given_against_the_file_is_said(tmp_path, values, label, words):
    labels = {"ordinate_axis_units_lab": label, "orddenom_axis_units_lab": "N"}
    path = write(tmp_path / "a.unv", [frfs(values)[0] | labels])
    record = read_record(path, ReadOptions(unit="(m/s^2)/N"))
    np.testing.assert_allclose(record.values[:, 0, 0], values[:, 0, 0], rtol=1e-11)
    assert words in record.source


def test_reads_uneven_axis_and_unknown_datasets(tmp_path, values):
    axis = np.array([1, 2, 4, 7, 8, 9, 10, 20, 21, 22.0])
    path = write(tmp_path / "a.uff", [units(), *frfs(values, x=axis, abscissa_spacing=0)])
    path.write_text("    -1\n  9999\nsome other thing\n    -1\n" + path.read_text())
    record = read_record(path)
    np.testing.assert_allclose(record.frequency, axis, rtol=1e-14)
    np.testing.assert_allclose(record.values, values, rtol=1e-11)


def test_pyuff_reads_what_is_written(tmp_path, frf):
    path = tmp_path / "a.uff"
    uff.write(path, frf)
    sets = pyuff.UFF(str(path)).read_sets()
    pairs = {(d["rsp_node"], d["rsp_dir"], d["ref_node"], d["ref_dir"]): d for d in sets if d.get("func_type") == 4}
    assert set(pairs) == {(o, od, i, id_) for o, od in ((1, -1), (2, 6), (12, -3)) for i, id_ in ((3, -3), (4, 4))}
    dataset = pairs[12, -3, 4, 4]
    np.testing.assert_array_equal(dataset["data"], frf.values[:, 2, 1])
    np.testing.assert_array_equal(dataset["x"], frf.frequency)
    assert (dataset["ord_data_type"], dataset["ordinate_spec_data_type"], dataset["binary"]) == (6, 11, 1)
    assert dataset["n_bytes"] == 16 * frf.frequency.size
    assert dataset["orddenom_axis_units_lab"] == "N m"


def test_mm_and_kn_become_si(tmp_path, values):
    """Dataset 164: numbers are divided by its factors; moments by both, rotations by none."""
    record = read_record(write(tmp_path / "a.uff", [units(length=1e3, force=1e-3), *frfs(values)]))
    per_force, per_moment = 1 / 1e3, 1 / 1e3 * 1e3  # N per kN, then N m per (kN mm)
    expected = values * [[1e-3 * per_force, 1e-3 / (1e3 * 1e-3)], [per_force, 1 / (1e3 * 1e-3)]]
    assert per_moment == 1
    np.testing.assert_allclose(record.values, expected, rtol=1e-11)


def test_labels_give_units_without_164(tmp_path, values):
    data = [function((1, 3), (2, 3), values[:, 0, 0], ordinate_axis_units_lab="g", orddenom_axis_units_lab="kN")]
    np.testing.assert_allclose(
        read_record(write(tmp_path / "a.uff", data)).values[:, 0, 0], values[:, 0, 0] * 9.80665e-3, rtol=1e-11
    )
    data = [function((1, 3), (2, 3), values[:, 0, 0], ordinate_axis_units_lab="mm/N", ordinate=0, denominator=0)]
    record = read_record(write(tmp_path / "b.uff", data))
    assert record.kind == "receptance"
    np.testing.assert_allclose(record.values[:, 0, 0], values[:, 0, 0] * 1e-3, rtol=1e-11)


def test_contradicting_units_are_not_guessed(tmp_path, values):
    data = [units(), function((1, 3), (2, 3), values[:, 0, 0], ordinate_axis_units_lab="g")]
    path = write(tmp_path / "a.uff", data)
    with pytest.raises(FileError, match=r"unit 'g' .*dataset 164 says 1; tell which is right: give `unit` .*--unit "):
        read_record(path)
    record = read_record(path, ReadOptions(unit="g/N"))
    np.testing.assert_allclose(record.values[:, 0, 0], values[:, 0, 0] * 9.80665, rtol=1e-11)


def test_a_unit_that_contradicts_dataset_164_is_proposed_as_the_labels_have_it(tmp_path, values):
    labels = {"ordinate_axis_units_lab": "g", "orddenom_axis_units_lab": "lbf"}
    path = write(tmp_path / "a.uff", [units(1 / 0.0254), function((1, 3), (2, 3), values[:, 0, 0], **labels)])
    with pytest.raises(FileError, match=r'give `unit = "\(g\)/\(lbf\)"`.* if the labels are, else that of dataset 164'):
        read_record(path)
    record = read_record(path, ReadOptions(unit="(g)/(lbf)"))
    np.testing.assert_allclose(record.values[:, 0, 0], values[:, 0, 0] * 9.80665 / 4.4482216152605, rtol=1e-11)


def test_a_byte_order_that_the_bytes_contradict_is_refused(tmp_path, frf):
    path = tmp_path / "a.uff"
    uff.write(path, frf)
    little, big = b"    58b     1     2", b"    58b     2     2"
    assert little in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(little, big))
    with pytest.raises(FileError, match=r"says byte order 2 in its first line, but .*write 1 there"):
        read_record(path)


def test_a_missing_sample_does_not_make_the_byte_order_doubtful(tmp_path):
    counts = np.random.default_rng(3).integers(-900, 900, 400).astype(float)
    path = tmp_path / "a.uff"
    uff.write(path, TimeRecord(100, counts[:, None], ("1X",), ("acceleration",)))
    sample = np.float64(counts[100:104]).tobytes()
    assert path.read_bytes().count(sample) == 1
    path.write_bytes(path.read_bytes().replace(sample, np.float64([np.nan, *counts[101:104]]).tobytes()))
    with pytest.raises(FileError, match=r"channel 1X. is NaN or infinite for 1 samples from sample 100"):
        read_record(path)
    record = read_record(path, ReadOptions(start=1.01))
    np.testing.assert_array_equal(record.values[:, 0], counts[101:])


def test_a_few_numbers_do_not_make_the_byte_order_doubtful(tmp_path):
    """The swapped bytes of these two are of one size by chance."""
    path, values = tmp_path / "a.uff", np.array([0.02, 1.5e-193])
    uff.write(path, TimeRecord(100, np.tile(values, 20)[:, None], ("1X",), ("acceleration",)))
    np.testing.assert_array_equal(read_record(path).values[:, 0], np.tile(values, 20))


def test_a_file_of_modes_is_called_so(tmp_path):
    path = tmp_path / "a.uff"
    path.write_text("    -1\n    55\nNONE\n    -1\n    -1\n   164\n         1\n    -1\n")
    with pytest.raises(FileError, match=r"only datasets 55, 164; give modes as such, by \[record\.modes\]"):
        read_record(path)


@pytest.mark.parametrize("ordinate, kind", [(8, "receptance"), (11, "mobility"), (12, "accelerance")])
def test_kind_by_data_type(tmp_path, values, ordinate, kind):
    path = write(tmp_path / "a.uff", [units(), function((1, 3), (2, 3), values[:, 0, 0], ordinate=ordinate)])
    assert read_record(path).kind == kind


def test_time_responses(tmp_path, rng):
    time = 0.5 + np.arange(20) * 0.002
    data = rng.normal(size=(20, 3))
    sets = [units(length=1e3)] + [
        function(place, (0, 0), data[:, i], 1, time, quantity, 0)
        for i, (place, quantity) in enumerate([((1, 3), 12), ((1, 3), 8), ((2, -1), 13)])
    ]
    record = read_record(write(tmp_path / "a.uff", sets))
    np.testing.assert_allclose(record.values, data * [1e-3, 1e-3, 1], rtol=1e-10)
    assert record.quantities == ("acceleration", "displacement", "force")
    assert [str(c) for c in record.channels] == ["1Z+", "1Z+", "2X-"]
    assert record.sampling_rate == pytest.approx(500, rel=1e-12)
    assert record.start == 0.5


def test_six_digit_step_may_be_stated_exactly(tmp_path, rng):
    path = write(
        tmp_path / "a.uff", [units(), function((1, 3), (0, 0), rng.normal(size=9), 1, np.arange(9) / 1200, 12, 0)]
    )
    assert read_record(path).sampling_rate == pytest.approx(1200, rel=1e-5)
    assert read_record(path).sampling_rate != 1200
    assert read_record(path, ReadOptions(sampling_rate=1200)).sampling_rate == 1200
    with pytest.raises(InputError, match="1300"):
        read_record(path, ReadOptions(sampling_rate=1300))


def test_frf_and_time_in_one_file_are_chosen(tmp_path, values):
    path = write(
        tmp_path / "a.uff", [units(), *frfs(values), function((1, 3), (0, 0), np.ones(9), 1, np.arange(9) / 8, 12, 0)]
    )
    with pytest.raises(InputError, match=r'`array` in .*"frf" or "time"'):
        read_record(path)
    assert read_record(path, ReadOptions(array="frf")).kind == "accelerance"
    assert read_record(path, ReadOptions(array="time")).sampling_rate == 8


def test_coherence_and_averages(tmp_path, values, rng):
    g2 = rng.uniform(size=(10, 2, 2))
    sets = [units(), *frfs(values, id4="Hanning, averages: 25")]
    path = write(tmp_path / "a.uff", [*sets, *frfs(g2, func_type=6, ordinate=0, denominator=0)])
    record = read_record(path)
    np.testing.assert_allclose(record.coherence, g2, rtol=1e-11)
    assert record.averages == 25
    path = write(tmp_path / "b.uff", [*sets, *frfs(g2, func_type=6, ordinate=0, denominator=0)[:3]])
    assert read_record(path).coherence is None


def test_missing_and_doubled_pairs_are_named(tmp_path, values):
    with pytest.raises(FileError, match=r"no FRF of 7RY\+/2X\+ \(output/input\)"):
        read_record(write(tmp_path / "a.uff", [units(), *(d for i, d in enumerate(frfs(values)) if i != 2)]))
    part = read_record(tmp_path / "a.uff", ReadOptions(outputs="1Z-"))
    np.testing.assert_allclose(part.values, values[:, :1], rtol=1e-11)
    with pytest.raises(FileError, match=r"1Z-/2X\+ twice"):
        read_record(write(tmp_path / "b.uff", [units(), *frfs(values), frfs(values)[0]]))


@pytest.mark.parametrize(
    "change, word",
    [
        ({"func_type": 2}, r"spectra of responses \(auto spectrum\)"), ({"func_type": 12}, "only spectrum"),
        ({"func_type": 9}, "power spectral density.*export the time histories"),
        ({"func_type": 3}, "cross spectrum"), ({"rsp_dir": 0}, "direction 0"), ({"ordinate_spec_data_type": 3}, "type 3"),
        ({"ordinate_spec_data_type": 13}, "force per force"), ({"orddenom_spec_data_type": 11}, "per velocity"),
        ({"ordinate_spec_data_type": 0}, "of type 0 .* or say what they are: give `unit = \"g/N\"`"),
        ({"ordinate_axis_units_lab": "mm"}, "acceleration by their type but displacement"),
    ],
)  # fmt: skip
def test_unusable_functions_are_refused(tmp_path, values, change, word):
    data = function((1, 3), (2, 3), values[:, 0, 0]) | change
    path = write(tmp_path / "a.uff", [units(), data | {"func_type": min(data["func_type"], 9)}])
    if data["func_type"] == 12:  # which pyuff does not write
        path.write_text(path.read_text().replace("\n    9         0", "\n   12         0"))
    with pytest.raises(FileError, match=word):
        read_record(path)


def test_other_frequencies_are_refused(tmp_path, values):
    sets = [units(), *frfs(values)]
    sets[4]["x"] = FREQUENCY + 0.25
    with pytest.raises(FileError, match=r"7RY\+/2RZ- has other frequencies"):
        read_record(write(tmp_path / "a.uff", sets))


@pytest.mark.parametrize("end", ["junk", "    -1\n", "    -1\n    58\n", "-1\n", "\n 5 \n"])
def test_trailing_junk_is_refused(tmp_path, values, end):
    path = write(tmp_path / "a.uff", [units(), *frfs(values)])
    read_record(path)
    path.write_text(path.read_text() + end)
    with pytest.raises(FileError, match=f"^{path}"):
        read_record(path)
    path.write_text(path.read_text()[: -len(end)] + " \n\x1a")  # blanks and an end-of-file mark are harmless
    read_record(path)


def test_truncated_ascii(tmp_path, values):
    path = write(tmp_path / "a.uff", [header(), units(), *frfs(values)])
    data = path.read_bytes()
    for cut in np.linspace(1, len(data) - 3, 40).astype(int):
        path.write_bytes(data[:cut])
        with pytest.raises(FileError, match=f"^{path}"):
            read_record(path)


def test_too_few_points_in_ascii(tmp_path, values):
    path = write(tmp_path / "a.uff", [function((1, 3), (2, 3), values[:, 0, 0])])
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:-2] + lines[-1:]))
    with pytest.raises(FileError, match="8 of its 10 points"):
        read_record(path)


NODES = {1: (0.0, 1 / 3, -2.5), 12: (1e-3, 2e3, 0.1), 300: (-1.0, -1 / 7, 1.0)}


def test_geometry_round_trip(tmp_path, frf):
    geometry = Geometry(NODES, ((1, 12, 300), (12, 0, 300, 1)))
    uff.write(tmp_path / "a.uff", frf, geometry)
    back = read_geometry(tmp_path / "a.uff")
    assert back.nodes == NODES
    assert back.lines == geometry.lines
    np.testing.assert_array_equal(read_record(tmp_path / "a.uff").values, frf.values)


def test_geometry_from_pyuff_in_mm(tmp_path):
    nodes = {"type": 15, "node_nums": [1, 2], "x": [1.0, 2.0], "y": [3.0, 4.0], "z": [5.0, -6.0]}
    line = {"type": 82, "trace_num": 1, "nodes": np.array([1, 2])}
    assert not read_geometry(write(tmp_path / "c.uff", [nodes, line])).has_unit
    back = read_geometry(write(tmp_path / "a.uff", [units(length=1e3), nodes, line]))
    assert back.has_unit
    assert back.nodes == {1: (1e-3, 3e-3, 5e-3), 2: (2e-3, 4e-3, -6e-3)}
    assert back.lines == ((1, 2),)
    with pytest.raises(FileError, match="no frequency response function"):
        read_record(tmp_path / "a.uff")
    with pytest.raises(FileError, match="joins node 2"):
        read_geometry(write(tmp_path / "b.uff", [dict(nodes, node_nums=[1, 3]), line]))


def test_no_geometry(tmp_path, frf):
    uff.write(tmp_path / "a.uff", frf)
    with pytest.raises(FileError, match="has no nodes"):
        read_geometry(tmp_path / "a.uff")


def test_complex_histories_are_refused(tmp_path, values):
    dataset = function((1, 3), (0, 0), values[:, 0, 0], func_type=1, abscissa_spec_data_type=17)
    with pytest.raises(FileError, match=r"1Z\+ has complex samples"):
        read_record(write(tmp_path / "a.uff", [header(), units(), dataset]))


def test_elements_draw_the_geometry_where_no_trace_lines_are(tmp_path):
    def columns(*numbers):
        return "".join(f"{n:10d}" for n in numbers)

    points = {1: (0, 0), 2: (1, 0), 3: (1, 1), 4: (0, 1)}
    nodes = [line for n, (x, y) in points.items() for line in (columns(n, 1, 1, 11), f"{x:25.16E}{y:25.16E}{0:25.16E}")]
    elements = [
        columns(1, 91, 1, 1, 7, 3),
        columns(1, 2, 3),
        columns(2, 21, 1, 1, 7, 2),
        columns(0, 1, 1),
        columns(3, 4),
    ]
    text = "".join(
        "\n".join(["    -1", f"{k:6d}", *lines, "    -1", ""]) for k, lines in ((2411, nodes), (2412, elements))
    )
    (tmp_path / "a.unv").write_text(text)
    geometry = read_geometry(tmp_path / "a.unv")
    assert sorted(geometry.lines) == [(1, 2), (1, 3), (2, 3), (3, 4)]
    assert geometry.nodes[3] == (1.0, 1.0, 0.0)


@pytest.mark.parametrize(
    "names, is_refused",
    [
        (("wing", "wing", "body"), True),  # 12 of the wing and 12 of the body
        (("wing", "wing", "wing"), False),
        (("12+Z", "13+Z", "12+X"), False),  # labels of channels
        (("wing", "wing", "NONE"), False),
        (("", "", ""), False),
    ],
)
def test_a_node_number_of_two_components_is_refused(tmp_path, rng, names, is_refused):
    places = [(12, 3), (13, 3), (12, 1)]
    sets = [
        function(place, (0, 0), rng.normal(size=10), 1, denominator=0, rsp_ent_name=name, ref_ent_name="NONE")
        for place, name in zip(places, names, strict=True)
    ]
    path = write(tmp_path / "a.uff", [units(), *sets])
    if is_refused:
        with pytest.raises(FileError, match="node 12 stands beside the names wing and body"):
            read_record(path)
        path_options = ReadOptions(columns="1,2,3", channels="12Z,13Z,112X")
        assert [str(dof) for dof in read_record(path, path_options).channels] == ["12Z+", "13Z+", "112X+"]
    else:
        assert [str(dof) for dof in read_record(path).channels] == ["12Z+", "13Z+", "12X+"]


@pytest.mark.parametrize(
    "weighting, window, words",
    [
        (0, 0, ""),
        (0, 1, ""),
        (0, 4, "an exponential window lies on 1 function"),
        (0, 6, "1 function"),
        (1, 0, "A weighting"),
    ],
)
def test_what_a_dataset_says_of_window_and_weighting_is_used(tmp_path, values, weighting, window, words):
    path = write(tmp_path / "a.uff", [units(), *frfs(values)[:2]])
    reals = f"{0.0:15.7E}" * 4
    qualifiers = [
        f"{1:12d}" + f"{0:12d}" * 5, f"{weighting:6d}{window:6d}" + f"{0:6d}" * 10, *[f"{reals}{3.0:15.7E}"] * 3, "", "NONE",
    ]  # fmt: skip
    path.write_text(path.read_text() + "\n".join(["    -1", "  1858", *qualifiers, "    -1", ""]))
    if weighting:
        with pytest.raises(FileError, match="function 2 has A weighting"):
            read_record(path)
        assert len(read_record(path, ReadOptions(columns="1")).inputs) == 1
    else:
        source = read_record(path).source
        assert words in source
        assert ("window" in source) == bool(words)


def qualifiers(octave=0, weighting=0, window=0):
    reals = f"{0.0:15.7E}" * 5
    lines = [
        f"{1:12d}{octave:12d}" + f"{0:12d}" * 4,
        f"{weighting:6d}{window:6d}" + f"{0:6d}" * 10,
        *[reals] * 3,
        "X+  X+",
    ]
    return "\n".join(["    -1", "  1858", *lines, "NONE", "    -1", ""])


def test_qualifiers_belong_to_the_function_behind_them_where_a_file_begins_with_them(tmp_path, values):
    parts = (units(), *frfs(values)[:2])
    units_text, *functions = (write(tmp_path / f"{k}.uff", [part]).read_text() for k, part in enumerate(parts))
    before, behind = tmp_path / "before.uff", tmp_path / "behind.uff"
    first, second = qualifiers(), qualifiers(weighting=1)
    before.write_text(units_text + first + functions[0] + second + functions[1])
    behind.write_text(units_text + functions[0] + first + functions[1] + second)
    for path in (before, behind):
        assert len(read_record(path, ReadOptions(columns="1")).inputs) == 1
        with pytest.raises(FileError, match="function 2 has A weighting"):
            read_record(path)


def test_functions_in_octaves_are_refused(tmp_path, values):
    path = write(tmp_path / "a.uff", [units(), *frfs(values)[:1]])
    path.write_text(path.read_text() + qualifiers(octave=3))
    with pytest.raises(FileError, match=r"function 1 is in 1/3 octaves \(dataset 1858\); export it line by line"):
        read_record(path)
