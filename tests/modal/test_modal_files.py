"""Modes in files: what is written comes back, other programs can read it, and damage is named."""

import json
from dataclasses import MISSING, fields, replace

import numpy as np
import pytest
import pyuff

from structid.core.errors import FileError, InputError
from structid.modal import ModalRecord
from structid.modal.formats.csv import is_modes_table
from structid.modal.formats.files import read_modes, write_modes
from structid.modal.formats.options import ModeFileOptions
from structid.modal.modal_record import ModalChanges, unit_largest
from structid.records import Geometry, read_geometry

CHANNELS = ("1X-", "1Y+", "2X+", "7Z-")


def modes(is_complex=True, scaling="unit_largest", channels=CHANNELS, known=True, seed=0):
    rng = np.random.default_rng(seed)
    n, m = 3, len(channels)
    shapes = rng.standard_normal((m, n)) + (0.2j * rng.standard_normal((m, n)) if is_complex else 0)
    factor = rng.standard_normal((2 * n, 2 * n)) * 1e-3
    return ModalRecord(
        np.array([1.881234567, 2.42, 30.5]), np.array([0.0158, 0.0147 if known else np.nan, 0.002]),
        unit_largest(shapes) if scaling == "unit_largest" else shapes, channels,
        covariance=factor @ factor.T if known else None, shape_std=0.01 + rng.random((m, n)) if known else None,
        warnings=("short record; measure longer",) if known else (), source="ssi_cov, 30 block rows", scaling=scaling,
    )  # fmt: skip


def same(first, second):
    return (first is None and second is None) or np.array_equal(first, second, equal_nan=True)


@pytest.mark.parametrize("is_complex", [False, True])
@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("scaling", ["unit_largest", "mass"])
def test_json_keeps_everything_to_the_last_bit(tmp_path, is_complex, known, scaling):
    written = modes(is_complex, scaling, known=known)
    write_modes(tmp_path / "modes.json", written)
    back = read_modes(tmp_path / "modes.json")
    for name in ("frequency", "damping_ratio", "mode_shapes", "covariance", "shape_std"):
        assert same(getattr(back, name), getattr(written, name)), name
    for name in ("channels", "warnings", "source", "scaling"):
        assert getattr(back, name) == getattr(written, name)
    assert back.mode_shapes.dtype == written.mode_shapes.dtype


def test_json_forgets_no_field_and_no_digit(tmp_path):
    random = np.random.default_rng(1)
    changes = ModalChanges(
        random.standard_normal((5, 3)), random.standard_normal((5, 3)), random.standard_normal((5, 4, 3, 2)) @ (1, 1j)
    )
    written = replace(modes(scaling="mass"), changes=changes)
    write_modes(tmp_path / "modes.json", written)
    back = read_modes(tmp_path / "modes.json")
    for one, other in ((written, back), (written.changes, back.changes)):
        for field in fields(one):
            value, found = getattr(one, field.name), getattr(other, field.name)
            if field.default is not MISSING:
                assert isinstance(value, np.ndarray) or value != field.default, field.name
            if field.name != "changes":
                assert same(value, found) if isinstance(value, np.ndarray) else value == found, field.name


@pytest.mark.parametrize("is_complex", [False, True])
@pytest.mark.parametrize("scaling", ["unit_largest", "mass"])
def test_csv_keeps_all_but_how_errors_move_together(tmp_path, is_complex, scaling):
    written = modes(is_complex, scaling)
    write_modes(tmp_path / "modes.csv", written)
    back = read_modes(tmp_path / "modes.csv")
    for name in ("frequency", "damping_ratio", "mode_shapes", "shape_std"):
        assert same(getattr(back, name), getattr(written, name)), name
    np.testing.assert_allclose(np.diag(back.covariance), np.diag(written.covariance), rtol=1e-15)
    assert np.count_nonzero(back.covariance) == 6
    assert (back.channels, back.scaling) == (written.channels, written.scaling)


def with_unknown(is_complex, scaling="unit_largest"):
    """Two entries of one mode and the whole shape of another are unknown."""
    whole = modes(is_complex, scaling)
    shapes = np.array(whole.mode_shapes)
    shapes[[0, 2], 1], shapes[:, 2] = np.nan, np.nan
    if scaling == "unit_largest":
        shapes = unit_largest(shapes)
    return replace(whole, mode_shapes=shapes)


@pytest.mark.parametrize("suffix", [".csv", ".json"])
@pytest.mark.parametrize("is_complex", [False, True])
@pytest.mark.parametrize("scaling", ["unit_largest", "mass"])
def test_unknown_entries_come_back_as_unknown(tmp_path, suffix, is_complex, scaling):
    written = with_unknown(is_complex, scaling)
    write_modes(tmp_path / f"modes{suffix}", written)
    back = read_modes(tmp_path / f"modes{suffix}")
    assert back.known.sum(axis=0).tolist() == [4, 2, 0]
    for name in ("frequency", "damping_ratio", "mode_shapes", "shape_std", "known"):
        assert same(getattr(back, name), getattr(written, name)), name
    assert np.isnan(back.shape_std[~back.known]).all()  # of an entry that is unknown nothing is
    assert "6 of 12 shape entries unknown, 1 mode without a shape" in repr(back)


def test_a_universal_file_is_refused_unknown_entries(tmp_path):
    with pytest.raises(FileError, match=r"no sign for the 6 unknown entries of the mode shapes; write \.json or \.csv"):
        write_modes(tmp_path / "modes.uff", with_unknown(True))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("blank", ["", "nan", " NaN "])
def test_blank_cells_of_a_published_table_are_unknown(tmp_path, blank):
    path = tmp_path / "table.csv"
    path.write_text(f"frequency_hz,1X,2X,3X\n20.5,4,{blank},-2\n8.1,{blank},{blank},{blank}\n")
    back = read_modes(path)
    assert back.known.T.tolist() == [[False] * 3, [True, False, True]]
    np.testing.assert_allclose(back.mode_shapes[:, 1], [1.0, np.nan, -0.5])


def test_csv_of_published_modes_needs_two_columns_only(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("frequency_hz,1X,2X\n20.5,4,-2\n8.1,1,2\n")
    back = read_modes(path)
    assert back.frequency.tolist() == [8.1, 20.5]
    assert back.mode_shapes.tolist() == [[0.5, 1.0], [1.0, -0.5]]
    assert np.isnan(back.damping_ratio).all()
    assert back.covariance is None


@pytest.mark.parametrize("channels", [CHANNELS, ("1X-", "1RZ+", "2RX-", "2Y+")])
@pytest.mark.parametrize("is_complex", [False, True])
@pytest.mark.parametrize("scaling", ["unit_largest", "mass"])
def test_universal_file_keeps_six_digits_in_positive_senses(tmp_path, channels, is_complex, scaling):
    written = modes(is_complex, scaling, channels)
    write_modes(tmp_path / "modes.uff", written)
    back = read_modes(tmp_path / "modes.uff")
    assert {str(dof) for dof in back.channels} == {str(dof.unsigned) for dof in written.channels}
    assert back.scaling == scaling
    np.testing.assert_allclose(back.frequency, written.frequency, rtol=6e-6)  # half a unit of the sixth digit
    np.testing.assert_allclose(back.damping_ratio, written.damping_ratio, rtol=1.2e-5)
    signs = np.array([dof.sign for dof in written.channels])[:, None]
    expected = signs * written.mode_shapes
    order = [back.channels.index(dof.unsigned) for dof in written.channels]
    if scaling == "unit_largest":
        expected = unit_largest(expected)
    np.testing.assert_allclose(back.mode_shapes[order], expected, rtol=0, atol=2e-5 * np.abs(expected).max())


def test_damping_that_is_not_known_comes_back_as_not_known(tmp_path):
    write_modes(tmp_path / "modes.uff", modes(known=False))
    assert np.isnan(read_modes(tmp_path / "modes.uff").damping_ratio).tolist() == [False, True, False]


@pytest.mark.parametrize("is_complex", [False, True])
def test_universal_file_is_read_by_pyuff(tmp_path, is_complex):
    written, geometry = (
        modes(is_complex),
        Geometry({1: (0.0, 0.0, 0.0), 2: (1.5, 0.0, 0.0), 7: (0.0, 2.0, 0.25)}, ((1, 2, 7),)),
    )
    write_modes(tmp_path / "modes.uff", written, geometry)
    file = pyuff.UFF(str(tmp_path / "modes.uff"))
    kinds = file.get_set_types().astype(int).tolist()
    assert kinds == [164, 15, 2411, 82, 55, 55, 55]
    for k in range(3):
        found = file.read_sets(4 + k)
        assert found["mode_n"] == k + 1
        assert found["node_nums"].tolist() == [1, 2, 7]
        x = found["r1"]
        np.testing.assert_allclose(x, [-written.mode_shapes[0, k], written.mode_shapes[2, k], 0], atol=1e-5)
        np.testing.assert_allclose(found["r3"][2], -written.mode_shapes[3, k], atol=1e-5)
        if is_complex:
            s = 2 * np.pi * written.frequency[k] * np.exp(1j * np.arccos(-written.damping_ratio[k]))
            assert found["eig"] == pytest.approx(s, rel=1e-5)
        else:
            assert found["freq"] == pytest.approx(written.frequency[k], rel=1e-5)
            assert found["modal_damp_vis"] == pytest.approx(written.damping_ratio[k], rel=1e-5)
    assert read_geometry(tmp_path / "modes.uff") == geometry


def test_modes_of_other_programs_are_read(tmp_path):
    path = tmp_path / "other.unv"
    for k, (f, mass) in enumerate(((12.5, 4.0), (3.0, 9.0))):
        pyuff.UFF(str(path)).write_sets(
            {
                "type": 55, "model_type": 1, "analysis_type": 2, "data_ch": 2, "spec_data_type": 8, "load_case": 1,
                "mode_n": k + 1, "freq": f, "modal_m": mass, "modal_damp_vis": 0.01 * (k + 1), "modal_damp_his": 0.0,
                "node_nums": [3, 5], "r1": np.array([1.0, 2.0]), "r2": np.zeros(2), "r3": np.array([0.0, 6.0]),
            },
            "add",
        )  # fmt: skip
    back = read_modes(path)
    assert back.frequency.tolist() == [3.0, 12.5]
    assert back.damping_ratio.tolist() == [0.02, 0.01]
    assert list(map(str, back.channels)) == ["3X+", "5X+", "5Z+"]
    np.testing.assert_allclose(back.mode_shapes, np.outer([1, 2, 6], [1 / 3, 1 / 2]))  # over the roots of modal masses
    assert back.scaling == "mass"


def test_two_channels_of_one_direction_do_not_fit_a_universal_file(tmp_path):
    with pytest.raises(FileError, match="two channels measure 1X"):
        write_modes(tmp_path / "modes.uff", modes(channels=("1X+", "1X-", "2X+")))
    assert list(tmp_path.iterdir()) == []


def _json_with(**changes):
    def change(text):
        return json.dumps({**json.loads(text), **changes})

    return change


@pytest.mark.parametrize(
    "suffix, damage, words",
    [
        (".json", lambda t: t[: len(t) // 2], "is not JSON"),
        (".json", lambda t: "[1, 2]", "no `frequency_hz`"),
        (".json", _json_with(frequency_hz=["a", 1, 2]), "`frequency_hz` must hold numbers"),
        (".json", _json_with(frequency_hz=[3.0, 1.0, 2.0]), "`frequency` must be at least 0 and increase"),
        (".json", _json_with(damping_ratio=0.1), "`damping_ratio` must be a list of 1 levels"),
        (".json", _json_with(mode_shapes=[[1.0]]), "`mode_shapes` must hold `real`"),
        (".json", _json_with(mode_shapes={"real": [[1.0], [2.0, 3.0]]}), "`mode_shapes.real` must hold numbers"),
        (".json", _json_with(channels=[1, 2]), "`channels` must be a list of texts"),
        (".json", _json_with(channels=["1Q"]), "cannot read '1Q'"),
        (".json", _json_with(covariance=[[1.0]]), "`covariance` must have shape"),
        (".json", _json_with(scaling="modal"), "`scaling` must be"),
        (".csv", lambda t: t.replace("frequency_hz", "f"), "must have a column `frequency_hz`"),
        (".csv", lambda t: t.replace("2.42", "2,42"), "line 3 has"),
        (".csv", lambda t: t.replace("30.5", "high"), "line 4, column `frequency_hz` must be a number, got 'high'"),
        (".csv", lambda t: t.replace("7Z- imaginary", "7Z- phase"), "'7Z- phase' must end in"),
        (".csv", lambda t: t.replace("2X+", "sensor"), "column 'sensor real' is no channel"),
        (".csv", lambda t: t.replace("unit_largest", "unit", 1), "`scaling` must be unit_largest or mass"),
        (".csv", lambda t: "frequency_hz,1X,2X\n3,1,2\n4,0,0\n", "line 3 has a mode shape of zeros"),
        (".csv", lambda t: "frequency_hz,1X,2X\n3,1,2\n,4,0\n", "the mode of line 3 has no `frequency_hz`"),
        (".csv", lambda t: "frequency_hz,1X,2X\n,,\n3,1,2\nnan,4,0\n", "the mode of line 4 has no `frequency_hz`"),
        (".csv", lambda t: "frequency_hz,1X\n3,1\n-4,1\n", "line 3, column `frequency_hz` must not be negative, got -4"),
        (".csv", lambda t: "frequency_hz,3,,5\n1X,1,0,2\n", "the mode of column 3 has no `frequency_hz`"),
        (".csv", lambda t: "frequency_hz,3,4\n1X,1,0\n2X,2,\n", "column 3 has a mode shape of zeros"),
        (".csv", lambda t: "frequency_hz,1X real,1X imaginary,2X\n3,,1,2\n", "line 2, column `1X real` is empty beside"),
        (".csv", lambda t: "frequency_hz,1X,2X\n3,1,2\n4,-,1\n", "must be a number, got '-'; leave it blank"),
        (".csv", lambda t: "frequency_hz,1X,2X\n3,1,inf\n", "line 2, column `2X` must be finite, got inf"),
        (".uff", lambda t: t[: t.rfind("    -1")], "the file is truncated"),
        (".uff", lambda t: t.replace("    55", "    57"), "holds no modes"),
        (".uff", lambda t: t.replace("         3         2         8", "         3         2      oops"), "record 6"),
        (".uff", lambda t: t.replace("\n         7\n", "\n         2\n"), "gives node 2 twice"),
        (".uff", lambda t: t.replace("\n         7\n", "\n         7\n  abc"), "node 7"),
        (".uff", lambda t: t.replace("\n         7\n", "\n         9\n", 1), "other nodes than the first"),
        (".txt", lambda t: t, "of no format for modes"),
    ],
)  # fmt: skip
def test_broken_files_are_named_with_the_field(tmp_path, suffix, damage, words):
    source = tmp_path / f"whole{'.json' if suffix == '.txt' else suffix}"
    write_modes(source, modes())
    path = tmp_path / f"broken{suffix}"
    text = source.read_text()
    damaged = damage(text)
    assert damaged != text or suffix == ".txt"
    path.write_text(damaged)
    with pytest.raises(FileError) as caught:
        read_modes(path)
    assert str(caught.value).startswith(f"{path}:")
    assert words in str(caught.value)


def test_missing_file_is_named_with_its_neighbour(tmp_path):
    write_modes(tmp_path / "modes.json", modes())
    with pytest.raises(FileError, match=r"did you mean modes\.json"):
        read_modes(tmp_path / "mode.json")


TABLE = (
    "frequency_hz,frequency_std_hz,damping_ratio,damping_std,1X,1X std,2X-\n"
    "8.5,0.01,0.012,0.002,1,0.05,-0.5\n20.25,0.02,0.02,0.003,0.5,0.04,1\n"
)
SAME = {
    "own": TABLE,
    "semicolons and decimal commas": TABLE.replace(",", ";").replace(".", ","),
    "tabs": TABLE.replace(",", "\t"),
    "one column a mode": "\n".join(map(",".join, zip(*(row.split(",") for row in TABLE.splitlines()), strict=True))) + "\n",
    "of another program": "Mode,Frequency [Hz],Std. Frequency [Hz],Damping [%],Std. Damping [%],Complexity [%],1X,1X std,2X-\n"
    "1,8.5,0.01,1.2,0.2,3.1,1,0.05,-0.5\n2,20.25,0.02,2.0,0.3,0,0.5,0.04,1\n",
    "of one more": "No.,Natural Frequency (Hz),Frequency Std (Hz),Damping Ratio,Standard deviation of damping ratio,1X,1X std,2X-\n"
    "1,8.5,0.01,0.012,0.002,1,0.05,-0.5\n2,20.25,0.02,0.02,0.003,0.5,0.04,1\n",
}  # fmt: skip


@pytest.mark.parametrize("name", SAME)
def test_tables_of_modes_as_others_lay_them_out(tmp_path, name):
    (tmp_path / "modes.csv").write_text(SAME[name])
    found = read_modes(tmp_path / "modes.csv")
    np.testing.assert_allclose(found.frequency, [8.5, 20.25])
    np.testing.assert_allclose(found.damping_ratio, [0.012, 0.02])
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), [0.01, 0.02, 0.002, 0.003])
    np.testing.assert_allclose(found.mode_shapes, [[1, 0.5], [-0.5, 1]])
    np.testing.assert_allclose(found.shape_std, [[0.05, 0.04], [np.nan, np.nan]])
    assert [str(dof) for dof in found.channels] == ["1X+", "2X-"]


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("own", "0.02,0.02", "-0.02,0.02", "line 3, column `frequency_std_hz` must not be negative, got -0.02"),
        ("one column a mode", "0.01,0.02", "0.01,x", "row `frequency_std_hz`, column 3 must be a number, got 'x'"),
        ("of another program", "Damping [%],S", "Frequency [Hz],S", "two columns `frequency_hz`"),
        (
            "semicolons and decimal commas",
            "20,25",
            "1.020",
            "has decimal commas, as in 8,5, and 1.020, whose point may be",
        ),
        ("of one more", "No.", "Story", "column 'Story' is no channel"),
    ],
)
def test_wrong_cells_of_such_tables_are_named(tmp_path, name, old, new, words):
    assert SAME[name].count(old) == 1
    (tmp_path / "modes.csv").write_text(SAME[name].replace(old, new))
    with pytest.raises(FileError, match=words):
        read_modes(tmp_path / "modes.csv")


@pytest.mark.parametrize(
    ("header", "factor", "words"),
    [
        ("Frequency [kHz]", 1e3, ""),
        ("Natural Frequency (rad/s)", 1 / (2 * np.pi), ""),
        ("Freq. [rpm]", 1 / 60, ""),
        ("frequency_hz", 1.0, ""),
        ("Frequency", 1.0, "; frequencies taken as Hz"),
    ],
)
def test_units_of_frequencies_in_headers_are_followed_or_said(tmp_path, header, factor, words):
    (tmp_path / "modes.csv").write_text(f"{header},Damping [%],1X\n60,1.5,1\n90,2,1\n")
    record = read_modes(tmp_path / "modes.csv")
    assert record.frequency == pytest.approx([60 * factor, 90 * factor])
    assert record.damping_ratio == pytest.approx([0.015, 0.02])
    assert record.source == f"modes.csv{words}"


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ("Frequency [orders],Damping [%]", r"modes\.csv: cannot read 'orders' as the unit of a frequency"),
        (
            "Frequency [Hz],Damping [dB]",
            r"modes\.csv: column 'Damping \[dB\]' is in a unit that is not known; write \[%\]",
        ),
        (
            "Frequency [Hz],Damping",
            r"line 2, column `damping_ratio` must be a ratio below 1, got 1\.5; write `Damping \[%\]`",
        ),
    ],
)
def test_units_that_are_not_known_are_refused(tmp_path, header, words):
    (tmp_path / "modes.csv").write_text(f"{header},1X\n60,1.5,1\n90,2,1\n")
    with pytest.raises(FileError, match=words):
        read_modes(tmp_path / "modes.csv")


def test_damping_without_a_unit_is_said_to_be_taken_as_a_ratio(tmp_path):
    (tmp_path / "modes.csv").write_text("Frequency [Hz],Damping,1X\n60,0.015,1\n")
    record = read_modes(tmp_path / "modes.csv")
    assert (record.damping_ratio.tolist(), record.source) == ([0.015], "modes.csv; damping taken as a ratio, not in %")


@pytest.mark.parametrize("header", ["1X,1x", "1X,1X+", "1X,1X real", "1X,2X,1X std,1X+ std"])
def test_columns_of_one_entry_are_refused(tmp_path, header):
    path, count = tmp_path / "a.csv", header.count(",") + 1
    path.write_text(f"frequency_hz,{header}\n10{',1' * count}\n")
    with pytest.raises(FileError, match=r"columns '.*' and '.*' are of the same entries of 1X\+"):
        read_modes(path)


def shapes_of_skewed_node(path, angle, measured):
    """One real mode of node 5 in axes turned about X, as test software writes it: `measured` directions, 0 in the others."""
    c, s_ = np.float32(np.cos(angle)), np.float32(np.sin(angle))
    rows = [(1, 0, 0), (0, c, s_), (0, -s_, c), (0, 0, 0)]
    system = ["\n".join("".join(f"{x:25.16E}" for x in map(float, row)) for row in rows)]
    node = [f"{5:10d}{0:10d}{3:10d}{8:10d}", "".join(f"{x:25.16E}" for x in (1.0, 2.0, 3.0))]
    kind = "".join(f"{n:10d}" for n in (1, 2, 2, 8, 2, 3))
    head = [
        "a",
        "NONE",
        "NONE",
        "NONE",
        "NONE",
        kind,
        "".join(f"{n:10d}" for n in (2, 4, 1, 1)),
        "".join(f"{x:13.5E}" for x in (8, 1, 0.01, 0)),
    ]
    shape = "".join(f"{x * (j in measured):13.5E}" for j, x in enumerate((0.5, 0.25, 2.0)))
    sets = {
        2420: [f"{1:10d}", "part", f"{3:10d}{0:10d}{8:10d}", "CS", *system],
        2411: node,
        55: [*head, f"{5:10d}", shape],
    }
    lines = [line for number, body in sets.items() for line in ("    -1", f"{number:6d}", *body, "    -1")]
    path.write_text("\n".join([*lines, ""]))
    return path


def shapes_of_turned_nodes(path, angle, *modes):
    """Real modes as datasets 2414, at 8 Hz and its multiples: 3 or 6 numbers a node, along axes turned by `angle` about X."""
    c, s_ = np.cos(angle), np.sin(angle)
    system = ["".join(f"{x:25.16E}" for x in row) for row in ((1, 0, 0), (0, c, s_), (0, -s_, c), (0, 0, 0))]
    place = "".join(f"{x:25.16E}" for x in (1.0, 2.0, 3.0))
    width = len(next(iter(modes[0].values())))
    kind = "".join(f"{n:10d}" for n in (1, 2, width // 3 + 1, 8, 2, width))
    sets = [
        (2420, [f"{1:10d}", "part", f"{3:10d}{0:10d}{8:10d}", "CS", *system]),
        (2411, [line for node in modes[0] for line in (f"{node:10d}{0:10d}{3:10d}{8:10d}", place)]),
    ]
    for k, motions in enumerate(modes, 1):
        numbers = [f"{0:10d}" * 8] * 2 + ["".join(f"{x:13.5E}" for x in (0, 8 * k, 0, 1, 0.01, 0)), f"{0.0:13.5E}" * 6]
        values = [line for node, xs in motions.items() for line in (f"{node:10d}", "".join(f"{x:13.5E}" for x in xs))]
        sets.append((2414, [f"{k:10d}", "mode", f"{1:10d}", *["NONE"] * 5, kind, *numbers, *values]))
    lines = [line for number, body in sets for line in ("    -1", f"{number:6d}", *body, "    -1")]
    path.write_text("\n".join([*lines, ""]))
    return path


def test_a_node_that_is_held_along_its_own_axis_spoils_no_other(tmp_path):
    """Node 5 does not move along its y. In shapes with rotations that are computed ones, y is held; else it may not be known."""
    c, s_ = np.cos(0.6), np.sin(0.6)
    held, free = (0.5, 0.0, 2.0), {6: (0.1, 0.2, 0.3), 7: (0.4, 0.5, 0.6)}
    known = {"5X+": 0.5, "5Y+": -2 * s_, "5Z+": 2 * c, "6X+": 0.1, "6Y+": 0.2 * c - 0.3 * s_, "6Z+": 0.2 * s_ + 0.3 * c}
    turning = {node: (*motion, 0.01, 0.0, 0.0) for node, motion in {5: held, **free}.items()}
    computed = read_modes(shapes_of_turned_nodes(tmp_path / "a.unv", 0.6, turning))
    shape = dict(zip(map(str, computed.channels), computed.mode_shapes[:, 0], strict=True))
    scale = shape["5X+"] / 0.5
    assert {name: shape[name] / scale for name in known} == pytest.approx(known, rel=1e-5)
    path = shapes_of_turned_nodes(tmp_path / "b.unv", 0.6, {5: held, **free})
    measured = read_modes(path)
    assert [str(dof) for dof in measured.channels] == ["6X+", "6Y+", "6Z+", "7X+", "7Y+", "7Z+"]
    assert "left out: node 5, held or not measured along directions that are no global axes" in measured.source
    assert "motions of 2 nodes turned from their displacement systems to global axes" in measured.source
    shape = dict(zip(map(str, measured.channels), measured.mode_shapes[:, 0], strict=True))
    assert shape["6Y+"] / shape["6X+"] == pytest.approx(known["6Y+"] / 0.1, rel=1e-5)
    with pytest.raises(FileError, match="node 5 was measured in 2 of the directions"):
        read_modes(shapes_of_turned_nodes(tmp_path / "c.unv", 0.6, {5: held, 6: held, 7: free[7]}))


def test_modes_that_move_only_nodes_that_are_left_out_are_left_out_too(tmp_path):
    still = (0.0, 0.0, 0.0)
    first = {5: (0.5, 0.0, 2.0), 6: (0.1, 0.2, 0.3), 7: (0.4, 0.5, 0.6)}
    second = {5: (0.5, 0.0, 1.0), 6: still, 7: still}
    found = read_modes(shapes_of_turned_nodes(tmp_path / "a.unv", 0.6, first, second))
    assert found.frequency == pytest.approx([8.0])
    assert np.isfinite(found.mode_shapes).all()
    assert "left out: modes at 16 Hz, which move no other nodes" in found.source
    with pytest.raises(FileError, match=r"only nodes that .* along no global axes move; export shapes in global"):
        read_modes(shapes_of_turned_nodes(tmp_path / "b.unv", 0.6, second))


def test_a_sensor_along_no_global_axis_is_refused_or_taken_as_it_is_named(tmp_path):
    """A turn of 90 degrees in single precision is one: its rounding is no direction."""
    turned = read_modes(shapes_of_skewed_node(tmp_path / "a.unv", np.pi / 2, (2,)))
    assert [str(dof) for dof in turned.channels] == ["5Y+"]
    path = shapes_of_skewed_node(tmp_path / "b.unv", 0.6, (2,))
    with pytest.raises(
        FileError, match=r'node 5 was measured in 1 of the directions .* `shape_axes = "named"` in \[record.modes\]'
    ):
        read_modes(path)
    named = read_modes(path, ModeFileOptions(shape_axes="named"))
    assert [str(dof) for dof in named.channels] == ["5Z+"]
    assert "directions as they are named" in named.source
    two = read_modes(shapes_of_skewed_node(tmp_path / "c.unv", 0.6, (1, 2)))
    expected = np.array([0.25 * np.cos(0.6) - 2 * np.sin(0.6), 0.25 * np.sin(0.6) + 2 * np.cos(0.6)])
    np.testing.assert_allclose(two.mode_shapes[:, 0] / two.mode_shapes[1, 0], expected / expected[1], rtol=1e-6)
    with pytest.raises(InputError, match="`shape_axes` is about universal files"):
        read_modes(tmp_path / "a.f06", ModeFileOptions(shape_axes="named"))


@pytest.mark.parametrize(
    "table",
    [
        "frequency_hz,zeta,1X,2X\n10,0.01,1,0.5\n20,0.02,1,-0.8\n",
        "Eigenfrequenz [Hz];Dämpfung [%];1X;2X\n10,0;1,0;1;0,5\n20;2;1;-0,8\n",
        "Fréquence [Hz],Amortissement [%],1X,2X\n10,1,1,0.5\n20,2,1,-0.8\n",
        "Nr.,Fre\u0301quence [Hz],Amortissement [%],1X,2X\n1,10,1,1,0.5\n2,20,2,1,-0.8\n",
        "channel,Mode 1,Mode 2\nfrequency_hz,10,20\ndamping ratio,.01,.02\n1X,1,1\n2X,.5,-.8\n",
    ],
)
def test_tables_of_modes_in_other_words(tmp_path, table):
    path = tmp_path / "a.csv"
    path.write_text(table, encoding="utf-8")
    assert is_modes_table(path)
    modes = read_modes(path)
    np.testing.assert_allclose(modes.frequency, [10, 20])
    np.testing.assert_allclose(modes.damping_ratio, [0.01, 0.02])
    np.testing.assert_allclose(modes.mode_shapes, [[1, 1], [0.5, -0.8]])
    assert ("damping taken as a ratio, not in %" in modes.source) == ("zeta" in table)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("frequency_hz,Q,1X\n10,50,1\n", r"column 'Q' is damping of another form; write `damping_ratio`.*1 / \(2 Q\)"),
        ("frequency_hz,loss factor,1X\n10,.02,1\n", "half the loss factor"),
        ("frequency_hz,loss_factor,1X\n10,.02,1\n", "half the loss factor"),
        ("frequency_hz,log_decrement,1X\n10,.02,1\n", "logarithmic decrement over 2 pi"),
        ("frequency_hz,damping_ratio,1X\n10,.02+.1i,1\n", r"got '.02\+.1i'; leave it blank where it is not known"),
        ("frequency_hz,damping_ratio,1X\n10+1i,.02,1\n", r"must be a number, got '10\+1i'$"),
        ("frequency_hz,1X\n10,1+0.1i\n", "got '1\\+0.1i'; write two columns, `1X real` and `1X imaginary`"),
    ],
)
def test_damping_and_shapes_of_other_forms_are_refused_with_a_remedy(tmp_path, table, words):
    path = tmp_path / "a.csv"
    path.write_text(table)
    with pytest.raises(FileError, match=words):
        read_modes(path)
