"""`structid modes`: what it prints, writes and returns, and what it says of records that cannot be used."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from modes_cases import FREQUENCY, RATIO, SHAPES, ambient, frfs
from structid.cli import app as cli
from structid.core.errors import InputError
from structid.modal import METHODS, ModalIdentification, ModalRecord, Poles
from structid.modal.formats.files import read_modes
from structid.modal.identification import CORRELATION_METHODS, SPECTRUM_METHODS
from structid.modal.poles.stabilization import Cluster
from structid.modal.survey.options import ModesOptions
from structid.modal.survey.rates import join_frequency, joined, lower_rate
from structid.modal.survey.survey import modes_of_file, record_geometry
from structid.records import Geometry, TimeRecord, write_record
from structid.records.formats.uff import uff
from structid.similarity import mac

RUN = CliRunner()
FAST = ("--method", "ssi_cov", "--no-report")


def invoke(*arguments):
    return RUN.invoke(cli.app, ["modes", *map(str, arguments)])


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_record("tower.npz", ambient())
    return tmp_path


def test_no_option_is_needed(place):
    done = invoke("tower.npz")
    assert (done.exit_code, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert lines[0] == "tower.npz: 3 modes"
    assert lines[-1].endswith("report.html")
    assert "no masses or stiffnesses" in lines[-2]
    assert len(re.findall(r"0\.99\d ± 0\.\d+|1\.000 ± [\d.e-]+", done.stdout)) == 3  # collinearity of each mode
    folder = place / "tower_modes"
    assert {p.name for p in folder.iterdir()} == {"modes.json", "modes.csv", "modes.uff", "report.html"}
    data = json.loads((folder / "modes.json").read_text())
    np.testing.assert_allclose(data["frequency_hz"], FREQUENCY, rtol=0.01)
    np.testing.assert_allclose(data["damping_ratio"], RATIO, atol=4 * max(data["damping_std"]))
    assert len(data["count"]) == data["n_modes"] == 3
    assert min(data["count"]) > 5
    assert data["provenance"]["inputs"].keys() == {"tower.npz"}
    assert data["preparation"] == ["mean taken off each channel"]
    assert data["options"]["orders"][:3] == [2, 4, 6]
    shapes = np.array(data["mode_shapes"]["real"]) * np.array(
        [[1], [-1], [1]]
    )  # the second sensor points the other way
    assert (np.diag(mac(shapes, SHAPES)) > 0.99).all()


def test_three_files_hold_the_same_modes(place):
    assert invoke("tower.npz", *FAST, "--orders", "10,12").exit_code == 0
    found = [read_modes(place / "tower_modes" / f"modes.{suffix}") for suffix in ("json", "csv", "uff")]
    for other in found[1:]:
        np.testing.assert_allclose(other.frequency, found[0].frequency, rtol=6e-6)  # six digits in a universal file
        np.testing.assert_allclose(np.diag(mac(other.mode_shapes, np.abs(found[0].mode_shapes) * np.sign(
            (found[0].mode_shapes * ([[1], [-1], [1]] if other is found[2] else 1)).real))), 1, atol=1e-3)  # fmt: skip
    assert not (place / "tower_modes" / "report.html").exists()


def test_the_same_record_gives_the_same_bytes(place):
    for out in ("a", "b"):
        assert invoke("tower.npz", *FAST, "--orders", "10,12", "--out", out).exit_code == 0
    for name in ("modes.json", "modes.csv", "modes.uff"):
        assert (place / "a" / name).read_bytes() == (place / "b" / name).read_bytes()


def test_bare_arrays_take_the_options_of_convert(place):
    np.save("tower.npy", ambient().values)
    done = invoke("tower.npy", "--sampling-rate", 25, "--channels", "1X+,2X-,3X+", "--quantity", "displacement", *FAST)
    assert done.exit_code == 0
    found = read_modes(place / "tower_modes" / "modes.json")
    np.testing.assert_allclose(found.frequency, FREQUENCY, rtol=0.01)
    assert list(map(str, found.channels)) == ["1X+", "2X-", "3X+"]
    missing = invoke("tower.npy")
    assert missing.exit_code == 2
    assert "--sampling-rate" in missing.stderr


def test_columns_without_names_are_numbered_unless_set_ups_are_merged(place):
    np.save("tower.npy", ambient().values)
    bare = ("--sampling-rate", 25, "--quantity", "displacement", *FAST)
    done = invoke("tower.npy", *bare)
    assert done.exit_code == 0, done.output
    assert "channels numbered by their columns, 1X+ to 3X+" in done.stdout
    assert list(map(str, read_modes(place / "tower_modes" / "modes.json").channels)) == ["1X+", "2X+", "3X+"]
    np.save("other.npy", ambient(seed=1).values)
    both = invoke("tower.npy", "other.npy", *bare)
    assert both.exit_code == 2
    assert "--channels" in both.stderr


def test_band_orders_and_frequencies_choose(place):
    low = 0.5 * (FREQUENCY[0] + FREQUENCY[1])
    done = invoke("tower.npz", "--band", low, 8, "--orders", "4:40:4", *FAST, "--out", "band")
    assert done.exit_code == 0
    found = json.loads((place / "band" / "modes.json").read_text())
    np.testing.assert_allclose(found["frequency_hz"], FREQUENCY[1:], rtol=0.01)
    assert found["options"]["orders"] == list(range(4, 41, 4))
    done = invoke("tower.npz", "--frequencies", f"{FREQUENCY[1]:.3f}", *FAST, "--out", "hand")
    assert done.exit_code == 0
    np.testing.assert_allclose(read_modes(place / "hand" / "modes.json").frequency, FREQUENCY[1], rtol=0.01)


def test_rate_is_a_step_of_preparation(place):
    done = invoke("tower.npz", "--rate", 12.5, "--detrend", "linear", *FAST)
    assert done.exit_code == 0
    found = json.loads((place / "tower_modes" / "modes.json").read_text())
    assert found["record"]["sampling_rate_hz"] == 12.5
    assert found["preparation"][0].startswith("straight line")
    assert found["preparation"][1].startswith("decimated by 2 to 12.5 Hz")


def test_frfs_give_modes_of_known_scale(place):
    write_record("frf.npz", frfs())
    done = invoke("frf.npz", "--no-report")
    assert (done.exit_code, done.stderr) == (0, "")
    found = read_modes(place / "frf_modes" / "modes.json")
    np.testing.assert_allclose(found.frequency, FREQUENCY, rtol=1e-3)
    assert found.scaling == "mass"
    np.testing.assert_allclose(np.abs(found.mode_shapes), np.abs(SHAPES), atol=0.02)
    assert "modal mass of 1 kg" in done.stdout


def test_low_modes_of_a_fast_record_are_found_by_a_second_look(place):
    fast = ambient(duration=100.0, rate=100.0)
    assert lower_rate(fast) == 20.0  # 14 samples a period of the lowest mode
    write_record("fast.npz", fast)
    found = modes_of_file("fast.npz")
    nearest = np.abs(found.modes.frequency[:, None] / FREQUENCY - 1).min(axis=0)
    assert (nearest < 0.02).all()
    assert any("decimated by" in step for step in found.steps)
    clusters, sweep = found.identification.clusters, found.identification.sweep
    assert len(clusters) == found.modes.n_modes
    for cluster, f, shape in zip(clusters, found.modes.frequency, found.modes.mode_shapes.T, strict=True):
        poles = [(sweep[n].frequency[i], sweep[n].order) for n, i in zip(cluster.number, cluster.index, strict=True)]
        np.testing.assert_array_equal([p for p, _ in poles], cluster.frequency)
        chosen = sweep[cluster.number[cluster.chosen]]
        i = cluster.index[cluster.chosen]
        assert chosen.frequency[i] == pytest.approx(f, rel=1e-12)
        assert mac(chosen.shapes[:, i], shape).item() == pytest.approx(1, abs=1e-9)
    for poles in sweep:
        assert (np.diff(poles.omega) >= 0).all()


def test_records_sampled_for_their_modes_are_looked_at_once(place):
    assert lower_rate(ambient()) is None


@pytest.mark.parametrize(("seed", "left_out"), [(5, True), (10, False)])
def test_a_steady_tone_is_not_called_a_mode_without_a_remark(place, seed, left_out):
    """Its pole lies on the axis: on the side without damping it is no mode of ambient motion at all."""
    record = ambient(seed=seed)
    tone = 0.5 * record.values.std() * np.sin(2 * np.pi * 9.0 * record.time)[:, None] * [1.0, 0.6, -0.8]
    write_record("tone.npz", replace(record, values=record.values + tone))
    done = invoke("tone.npz", *FAST)
    assert done.exit_code == 0
    rows = [line for line in done.stdout.splitlines() if " 9.0" in line or "9.00" in line.split(" ± ")[0]]
    assert len(rows) == (0 if left_out else 1)
    assert all("steady tone" in row for row in rows)
    assert ("noise or the tone of a machine, are left out: 9 Hz" in done.stdout) == left_out
    others = [line for line in done.stdout.splitlines() if "steady tone" in line]
    assert others == rows


@pytest.mark.parametrize("asked", ["auto", "9.0,7.0"])
def test_tones_are_taken_off_on_request_and_told(place, asked):
    record = ambient()
    size = 3 * record.values.std()
    tone = size * np.sin(2 * np.pi * 9.0 * record.time)[:, None] * [1.0, 0.6, -0.8]
    write_record("tone.npz", replace(record, values=record.values + tone))
    done = invoke("tone.npz", "--method", "ssi_cov", "--remove-tones", asked)
    assert done.exit_code == 0
    data = json.loads((place / "tone_modes" / "modes.json").read_text())
    (removed,) = data["tones_removed"]
    assert removed["frequency_hz"] == pytest.approx(9.0, abs=1e-4)
    np.testing.assert_allclose(removed["amplitude"], size * np.array([1.0, 0.6, 0.8]), rtol=0.01)
    np.testing.assert_allclose(data["frequency_hz"], FREQUENCY, rtol=0.01)
    assert "tone at 9 Hz taken off" in data["preparation"][1]
    assert "tone taken off (Hz)" in done.stdout
    assert "tone taken off (Hz)" in (place / "tone_modes" / "report.html").read_text()
    assert ("no tone stands out at 7 Hz" in done.stdout) == (asked != "auto")


def test_no_stable_mode_ends_with_code_1(place):
    done = invoke("tower.npz", "--band", 0.02, 0.3, "--rate", 25, *FAST)
    assert done.exit_code == 1
    assert "no mode that is stable" in done.stderr
    assert not (place / "tower_modes").exists()


def test_geometry_comes_from_a_table_or_the_file_itself(place):
    nodes = {1: (0.0, 0.0, 1.0), 2: (0.0, 0.0, 2.0), 3: (0.0, 0.0, 3.5), 9: (0.0, 0.0, 0.0)}
    rows = ["node,x,y,z", *(f"{n},{x},{y},{z}" for n, (x, y, z) in nodes.items()), "line,9,1,2,3"]
    Path("nodes.csv").write_text("\n".join(rows) + "\n")
    geometry, record = Geometry(nodes, ((9, 1, 2, 3),)), ambient(duration=20.0)
    assert record_geometry(Path("tower.npz"), record, Path("nodes.csv")) == geometry
    uff.write("tower.uff", record, geometry)
    assert record_geometry(Path("tower.uff"), record, None) == geometry
    assert record_geometry(Path("tower.npz"), record, None) is None
    assert record_geometry(Path("tower.uff"), record, Path("nodes.csv")) == geometry


@pytest.mark.parametrize(
    "unit", ["", "   164\n         1SI                           1\n 1.0 1.0 1.0\n 273.15\n    -1\n    -1\n"]
)
def test_positions_without_a_unit_of_length_are_told(place, unit):
    rows = "".join(f"{n:10d}{0:10d}{0:10d}{1:10d}{0:13.5e}{0:13.5e}{z:13.5e}\n" for n, z in ((1, 1), (2, 2), (3, 3.5)))
    Path("nodes.uff").write_text(f"    -1\n{unit}    15\n{rows}    -1\n")
    done = invoke("tower.npz", *FAST, "--geometry", "nodes.uff", "--orders", "10,12")
    assert done.exit_code == 0, done.output
    assert ("no unit of length" in done.stdout) != bool(unit)
    assert ("no unit of length" in (place / "tower_modes" / "modes.json").read_text()) != bool(unit)


def _constant(record):
    values = np.array(record.values)
    values[:, 1] = 3.0
    return replace(record, values=values)


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["nothing.npz"], "there is no such file"),
        (["tower.npz", "--method", "magic"], "--method must be one of"),
        (["tower.npz", "--method", "lscf"], "needs FRFs"),
        (["tower.npz", "--band", "4", "2"], "--band must run from 0 Hz or more to a higher frequency, got 4 to 2 Hz"),
        (["tower.npz", "--band", "2", "20"], "need a sampling rate above 50 Hz"),
        (["tower.npz", "--band", "2", "8", "--rate", "12.5"], "need a sampling rate above 20 Hz"),
        (["tower.npz", "--frequencies", "2,three"], "--frequencies must be numbers"),
        (["tower.npz", "--frequencies", "0"], "--frequencies must be greater than 0"),
        (["tower.npz", "--orders", "2:x"], "--orders must be numbers"),
        (["tower.npz", "--orders", "2:4000"], "--orders must lie from"),
        (["tower.npz", "--rate", "-1"], "--rate must be greater than 0"),
        (["tower.npz", "--detrend", "often"], "--detrend must be"),
        (["tower.npz", "--geometry", "few.csv"], "few.csv: has no node 2, where 2X- is measured"),
        (["tower.npz", "--geometry", "bad.csv"], "bad.csv: line 2"),
        (["tower.npz", "--geometry", "lines.csv"], "joins node 8"),
        (["constant.npz"], "2X- is dead or constant"),
        (["short.npz"], "16 samples"),
        (["force.npz"], "forces only"),
        (["broken.npz"], "is not a whole NPZ archive"),
        (["frf.npz", "--rate", "5"], "--rate is for time histories"),
        (["frf.npz", "--remove-tones", "auto"], "--remove-tones is for time histories"),
        (["tower.npz", "--remove-tones", "all"], "--remove-tones must be numbers with commas, as in 1.9,2.4, or auto"),
        (["tower.npz", "--remove-tones", "-4"], "--remove-tones must be greater than 0 Hz"),
        (["frf.npz", "--method", "ssi_cov"], "needs time records"),
        (["frf.npz", "--band", "20", "30"], "no frequency line is left"),
    ],
)  # fmt: skip
def test_input_that_cannot_be_used_ends_with_code_2(place, arguments, words):
    record = ambient()
    write_record("frf.npz", frfs())
    write_record("constant.npz", _constant(record))
    write_record("short.npz", replace(record, values=record.values[:12]))
    write_record("force.npz", TimeRecord(25.0, record.values, record.channels, ("force",) * 3))
    (place / "broken.npz").write_bytes((place / "tower.npz").read_bytes()[:300])
    (place / "few.csv").write_text("node,x,y,z\n1,0,0,1\n3,0,0,1\n")
    (place / "bad.csv").write_text("node,x,y,z\n1,0,0\n")
    (place / "lines.csv").write_text("1,0,0,1\n2,0,0,1\n3,0,0,1\nline,1,8\n")
    before = sorted(place.iterdir())
    done = invoke(*arguments)
    assert done.exit_code == 2, done.output
    assert words in done.stderr
    assert done.stderr.startswith("error: ")
    assert sorted(place.iterdir()) == before


def test_orders_are_lists_or_ranges():
    assert ModesOptions().orders is None
    assert ModesOptions(orders="10, 20,30").orders == (10, 20, 30)
    assert ModesOptions(orders="2:8").orders == (2, 4, 6, 8)
    assert ModesOptions(orders="4:12:4").orders == (4, 8, 12)
    for wrong in ("8:2", "2:4:6:8", "a"):
        with pytest.raises(InputError, match="`orders`"):
            ModesOptions(orders=wrong)


def test_a_band_far_below_the_rate_is_decimated_to(place):
    record = ambient(duration=100.0, rate=100.0)
    write_record("fast.npz", record)
    found = modes_of_file("fast.npz", ModesOptions("ssi_cov", band=(0.5, 6.0)))
    assert found.record.sampling_rate == 25.0
    np.testing.assert_allclose(found.modes.frequency, FREQUENCY, rtol=0.02)


def _identification(frequencies, orders):
    """Modes of these frequencies in every order, each with a cluster of all its poles."""
    n = len(frequencies)
    omega = 2 * np.pi * np.array(frequencies)
    rng = np.random.default_rng(n)
    sweep, shapes = [], rng.standard_normal((3, n)) + 0j
    for order in orders:
        s = omega * np.exp(1j * np.arccos(-0.01)) * (1 + 1e-4 * rng.standard_normal(n))
        sweep.append(Poles(s, shapes, order))
    clusters = tuple(
        Cluster(
            np.arange(len(orders)), np.full(len(orders), k), np.array([p.frequency[k] for p in sweep]),
            np.array([p.damping_ratio[k] for p in sweep]), k % len(orders),
        )
        for k in range(n)
    )  # fmt: skip
    covariance = np.diag(rng.random(2 * n))
    modes = ModalRecord(omega / 2 / np.pi, np.full(n, 0.01), shapes, ("1X", "2X", "3X"), covariance, np.abs(shapes))
    return ModalIdentification(modes, "pencil", tuple(sweep), clusters)


def test_two_looks_are_joined_with_poles_clusters_and_covariance_in_their_places():
    low = _identification([1.0, 2.0, 3.0, 9.0], [2, 4, 6])
    high = _identification([1.1, 2.1, 8.0, 10.0, 20.0], [4, 6, 8])
    found = joined(low, high, 5.0)
    assert found.modes.frequency.tolist() == [1.0, 2.0, 3.0, 8.0, 10.0, 20.0]
    assert found.orders == (2, 4, 6, 8)
    assert [(poles.order, len(poles.poles)) for poles in found.sweep] == [
        (2, 3),
        (4, 3),
        (6, 3),
        (4, 3),
        (6, 3),
        (8, 3),
    ]
    sources = [*low.clusters[:3], *high.clusters[2:]]
    for cluster, source in zip(found.clusters, sources, strict=True):
        there = [found.sweep[n].frequency[i] for n, i in zip(cluster.number, cluster.index, strict=True)]
        np.testing.assert_array_equal(there, source.frequency)
        assert cluster.frequency[cluster.chosen] == source.frequency[source.chosen]
    variance = np.diag(found.modes.covariance)
    parts = [np.diag(part.modes.covariance) for part in (low, high)]
    np.testing.assert_array_equal(variance, np.concatenate([parts[0][:3], parts[1][2:5], parts[0][4:7], parts[1][7:]]))
    assert np.count_nonzero(found.modes.covariance) == 12
    np.testing.assert_array_equal(found.modes.shape_std, np.abs(found.modes.mode_shapes))
    assert "two sampling rates" in found.modes.warnings[-1]
    assert 0.30 * 20 <= join_frequency(low.modes, high.modes, 20.0) <= 0.38 * 20


def test_a_window_is_taken_off_decays_and_frfs_alike(place):
    """Under e^(-t / 2 s) the damping ratios of 1 % are up to six times as large; --window brings them back."""
    time = np.arange(4000) / 50.0
    omega = 2 * np.pi * FREQUENCY
    decay = np.exp(-RATIO * omega * time[:, None]) * np.cos(omega * np.sqrt(1 - RATIO**2) * time[:, None]) @ SHAPES.T
    decay = decay + 1e-4 * np.random.default_rng(0).standard_normal(decay.shape)
    window = np.exp(-0.5 * time)[:, None]
    write_record("decay.npz", TimeRecord(50.0, decay * window, ("1X", "2X", "3X"), ("displacement",) * 3))
    write_record("windowed.npz", frfs(noise=1e-3, decay=0.5))
    for name, more in (("decay", ["--detrend", "none"]), ("windowed", [])):
        found = {}
        for words in ([], ["--window", 2.0]):
            done = invoke(f"{name}.npz", *more, *words, "--no-report", "--out", f"{name}{len(words)}")
            assert done.exit_code == 0, done.stderr
            found[len(words)] = read_modes(place / f"{name}{len(words)}" / "modes.json")
        assert (found[0].damping_ratio > RATIO + 0.4 * 0.5 / omega).all()
        np.testing.assert_allclose(found[2].damping_ratio, RATIO, rtol=0.03)
        np.testing.assert_allclose(found[2].frequency, FREQUENCY, rtol=2e-4)
    steps = json.loads((place / "decay2" / "modes.json").read_text())["preparation"]
    assert "damping of an exponential window of 2 s taken off the modes" in steps


def test_more_channels_than_samples_are_looked_at_by_the_motions_they_share(place):
    time, places = np.arange(300) * 0.05, np.linspace(0.0, np.pi, 400)
    field = np.exp(-0.02 * time)[:, None] * (
        np.cos(2 * time)[:, None] * np.sin(places) + np.cos(5 * time)[:, None] * np.sin(2 * places)
    )
    field = field + 1e-4 * np.random.default_rng(0).standard_normal(field.shape)
    channels = [f"{i + 1}Z" for i in range(400)]
    write_record("field.npz", TimeRecord(20.0, field, channels, ("displacement",) * 400))
    done = invoke("field.npz", "--no-report", "--detrend", "none")
    assert done.exit_code == 0, done.stderr
    found = read_modes(place / "field_modes" / "modes.json")
    np.testing.assert_allclose(found.omega, [2.0, 5.0], rtol=1e-3)
    assert len(found.channels) == 400
    np.testing.assert_allclose(np.abs(found.mode_shapes[:, 0]), np.sin(places), atol=1e-3)
    assert "400 channels by 2 shared motions" in done.stdout
    write_record("two.npz", TimeRecord(20.0, field, channels, ("displacement",) * 399 + ("velocity",)))
    assert "must be of one quantity" in invoke("two.npz").stderr


def test_several_records_are_set_ups_whose_modes_are_merged(place):
    for name, sensors, seed in (("low", [0, 1], 3), ("high", [0, 2], 4)):
        whole = ambient(duration=800.0, seed=seed)
        channels = tuple(whole.channels[i] for i in sensors)
        write_record(
            f"{name}.npz",
            replace(whole, values=whole.values[:, sensors], channels=channels, quantities=whole.quantities[:2]),
        )
    done = invoke("low.npz", "high.npz", "--out", "both", "--method", "ssi_cov")
    assert (done.exit_code, done.stderr) == (0, "")
    assert done.stdout.splitlines()[0] == "low.npz, high.npz: 3 modes"
    found = read_modes(place / "both" / "modes.json")
    assert list(map(str, found.channels)) == ["1X+", "2X+", "3X+"]
    np.testing.assert_allclose(found.frequency, FREQUENCY, rtol=0.01)
    assert (np.diag(mac(found.mode_shapes, SHAPES)) > 0.99).all()
    assert (place / "both" / "report.html").exists()
    written = json.loads((place / "both" / "modes.json").read_text())
    assert set(written["provenance"]["inputs"]) == {"low.npz", "high.npz"}
    assert "high.npz: 3 modes" in written["preparation"]
    alone = invoke("low.npz", "tower.npz", "nothing.npz")
    assert alone.exit_code == 2
    assert "nothing.npz" in alone.stderr


def test_limits_of_damping_and_deviation_are_flags(place):
    done = invoke("tower.npz", *FAST, "--damping", 0, 0.5 * RATIO, "--out", "none")
    assert done.exit_code == 1
    every = modes_of_file("tower.npz", ModesOptions("ssi_cov")).modes
    limit = float(np.sort(every.frequency_std / every.frequency)[:2].mean())
    done = invoke("tower.npz", *FAST, "--deviation", limit, "--out", "few")
    assert done.exit_code == 0
    found = read_modes(place / "few" / "modes.json")
    assert 0 < found.n_modes < 3
    assert (found.frequency_std <= limit * found.frequency).all()
    assert "--deviation must be greater than 0" in invoke("tower.npz", "--deviation", -1).stderr


def test_help_and_page_name_the_methods_of_the_registries():
    every = {*METHODS, *SPECTRUM_METHODS, *CORRELATION_METHODS}
    page = Path(__file__).parents[2] / "docs" / "modes.md"
    table = page.read_text(encoding="utf-8").split("## Which method when")[1].split("##")[0]
    assert sorted(re.findall(r"^\| `(\w+)` \|", table, re.M)) == sorted(every)
    words = " ".join(invoke("--help").stdout.split()).split("--method <str> ")[1].split(", see docs")[0]
    assert sorted(words.replace(" or, of stored spectra, ", ", ").split(", ")) == sorted(every)
