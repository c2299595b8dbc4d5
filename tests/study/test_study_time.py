"""Time histories fitted themselves from a study file: every way, together with FRFs, and what is refused."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from short_record_cases import RATE, SENSORS, chain, chain_tables, record, unknowns
from structid import (
    FrfRecord,
    InputError,
    TimeRecord,
    Unknown,
    parameters,
    simulated_record,
    simulated_time_record,
    write_record,
)
from structid.cli.app import app
from structid.dynamics.transient import sampled_transient
from structid.forward import TimeOptions
from structid.study.run.run import run_study
from structid.study.run.start import prepare_study
from structid.study.schema.study import load_study

CHAIN = (
    'title = "Chain of four masses"\n'
    + chain_tables(2.2, 900.0, 0.9)
    + """
[[unknown]]
property = "mass"
elements = "m"
each = true
[[unknown]]
property = "stiffness"
elements = "k"
each = true
[[unknown]]
property = "viscous_damping"
elements = "c"
each = true
[record]
path = "time.npz"
[record.time]
relative_noise = 0.01
[method]
band = [0.1, 12.0]
"""
)


def write_study(folder, text=CHAIN, histories=None):
    structure = chain()
    truth = unknowns(structure)
    if histories is None:
        histories = record(structure, truth.values(truth.start), np.random.default_rng(0))
    write_record(folder / "time.npz", replace(histories, variance=None))
    (folder / "study.toml").write_text(text)
    return folder / "study.toml", truth


def test_a_record_that_neither_starts_nor_ends_at_rest_is_identified_without_leakage(tmp_path):
    path, truth = write_study(tmp_path)
    result = run_study(load_study(path))
    found = result.identification.estimate
    assert found.status.value == "converged"
    assert found.covariance_basis == "noise"
    assert found.chi_square_per_dof == pytest.approx(1.0, abs=0.12)
    assert (np.abs(found.values - truth.start) < 4 * found.std).all()
    # the same record through averaged FRFs misses its own noise level by far
    averaged = CHAIN.replace("[record.time]\nrelative_noise = 0.01\n", "[record.frf]\nsegment_length = 200\n")
    other = run_study(load_study(write_study(tmp_path, averaged)[0])).identification.estimate
    assert np.sqrt(np.mean((other.values / truth.start - 1) ** 2)) > 10 * np.sqrt(
        np.mean((found.values / truth.start - 1) ** 2)
    )


def test_identify_writes_results_and_report_of_a_time_fit(tmp_path):
    path, _ = write_study(tmp_path)
    ran = CliRunner().invoke(app, ["identify", str(path), "--out", str(tmp_path / "out")])
    assert ran.exit_code == 0, ran.output
    summary = json.loads((tmp_path / "out" / "estimate.json").read_text())
    assert summary["status"] == "converged"
    assert (tmp_path / "out" / "report.html").exists()
    checked = CliRunner().invoke(app, ["check", str(path)])
    assert checked.exit_code == 0, checked.output


def test_histories_and_frfs_of_two_tests_are_fitted_together(tmp_path):
    structure = chain()
    truth = unknowns(structure)
    like = FrfRecord(np.linspace(0.5, 8.0, 60), np.zeros((60, 1, 1)), ("1X",), ("4X",), "receptance")
    write_record(tmp_path / "frf.npz", simulated_record(structure, truth, like, 0.01, np.random.default_rng(1)))
    several = CHAIN.replace("[record]", "[[record]]").replace(
        "[method]", '[[record]]\npath = "frf.npz"\nnoise = { relative = 0.01 }\n[method]'
    )
    alone = run_study(load_study(write_study(tmp_path)[0])).identification.estimate
    both = run_study(load_study(write_study(tmp_path, several)[0])).identification
    assert len(both.fits) == 2
    assert (both.estimate.std_noise < alone.std_noise).all()
    assert (np.abs(both.estimate.values - truth.start) < 4 * both.estimate.std).all()


def sampled_record(sensors=SENSORS, noise=0.01):
    """Accelerations from rest under a force that runs straight between its samples, 300 of them."""
    structure = chain()
    values = unknowns(structure).values(unknowns(structure).start)
    mass, damping, stiffness = (structure.matrix(kind, values) for kind in ("mass", "damping", "stiffness"))
    rng = np.random.default_rng(2)
    force = rng.standard_normal(300)
    load = np.array([[0.0], [0.0], [0.0], [1.0]])
    motion = sampled_transient(mass, stiffness, load, force[:, None], RATE, damping)
    table = np.column_stack([force, *(motion.acceleration[:, int(name[0]) - 1] for name in sensors)])
    std = np.array([0.0, *[noise] * len(sensors)]) * np.sqrt((table**2).mean(axis=0))
    return TimeRecord(
        RATE,
        table + std * rng.standard_normal(table.shape),
        ("4X", *sensors),
        ("force", *["acceleration"] * len(sensors)),
    )


def test_output_error_is_reached_from_the_study_file(tmp_path):
    text = CHAIN.replace("relative_noise = 0.01", 'fit = "output_error"\nrelative_noise = [0.0, 0.01, 0.01]')
    path, truth = write_study(tmp_path, text.replace("band = [0.1, 12.0]", ""), sampled_record())
    found = run_study(load_study(path)).identification.estimate
    assert found.status.value == "converged"
    assert found.chi_square_per_dof == pytest.approx(1.0, abs=0.2)
    assert (np.abs(found.values - truth.start) < 4 * found.std).all()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("relative_noise = 0.01", "", r"\[record.time\]: needs the noise of the channels"),
        ("relative_noise = 0.01", "relative_noise = [0.01, 0.02]", r"must be one number or 3"),
        ("relative_noise = 0.01", "noise = -1.0", r"got -1 for channel 1 \("),
        (
            "relative_noise = 0.01",
            "noise = [0.1, 0.1, -2.0]",
            r"noise: .*must not be negative, got -2 for channel 3 \(",
        ),
        ("relative_noise = 0.01", 'relative_noise = 0.01\nfit = "wrong"', "fit"),
        ("relative_noise = 0.01", 'relative_noise = 0.01\ninitial = "rest"', "does not use it"),
        (
            "relative_noise = 0.01",
            "relative_noise = 0.01\ntones = [1.0, 4000.0]",
            "tones: `tones`: 4000 Hz is not below half",
        ),
        ("relative_noise = 0.01", "relative_noise = 0.01\ntones = [-50.0]", "must be a number greater than 0"),
        ('path = "time.npz"', 'repeats = ["time.npz", "time.npz"]', "takes one time record"),
        (
            "relative_noise = 0.01",
            "relative_noise = 0.01\n[record.noise]\nrelative = 0.5",
            "noise: is of frequency responses; with \\[record.time\\]",
        ),
    ],
)
def test_what_a_time_fit_cannot_use_is_named(tmp_path, old, new, words):
    path, _ = write_study(tmp_path, CHAIN.replace(old, new))
    with pytest.raises(InputError, match=words):
        prepare_study(load_study(path))


def test_a_record_of_zeros_is_said_to_be_one(tmp_path):
    record = sampled_record()
    path, _ = write_study(tmp_path, CHAIN, replace(record, values=np.zeros_like(record.values)))
    with pytest.raises(InputError, match="the record is 0 at every sample"):
        prepare_study(load_study(path))


@pytest.mark.parametrize("fit", ["spectra", "output_error"])
def test_accelerations_without_a_load_are_told_at_the_record(tmp_path, fit):
    structure = chain()
    truth = unknowns(structure)
    whole = record(structure, truth.values(truth.start), np.random.default_rng(0))
    of_motion = [quantity == "acceleration" for quantity in whole.quantities]
    ambient = TimeRecord(RATE, whole.values[:, of_motion], SENSORS, ["acceleration"] * 2)
    text = CHAIN.replace("relative_noise = 0.01", f'relative_noise = 0.01\nfit = "{fit}"')
    path, _ = write_study(tmp_path, text.replace("band = [0.1, 12.0]\n", "") if fit != "spectra" else text, ambient)
    place = f"{path}, line {text[: text.index('[record]')].count(chr(10)) + 1}: [record]: "
    with pytest.raises(InputError, match="^" + re.escape(place) + ".*structid modes"):
        prepare_study(load_study(path))


@pytest.mark.parametrize("place", ["band", "evaluation_band"])
def test_a_band_without_lines_of_histories_is_placed(tmp_path, place):
    path, _ = write_study(tmp_path, CHAIN + "evaluation_band = [0.1, 12.0]\n")
    text = path.read_text().replace(f"\n{place} = [0.1, 12.0]", f"\n{place} = [3.01, 3.02]")
    path.write_text(text)
    with pytest.raises(InputError, match=rf"\[method\] {place}: no (frequency )?line"):
        prepare_study(load_study(path))


def test_a_time_section_on_frfs_is_refused(tmp_path):
    path, truth = write_study(tmp_path, CHAIN.replace("time.npz", "frf.npz"))
    like = FrfRecord(np.linspace(0.5, 8.0, 60), np.zeros((60, 1, 1)), ("1X",), ("4X",), "receptance")
    write_record(tmp_path / "frf.npz", simulated_record(chain(), truth, like, 0.01, np.random.default_rng(1)))
    with pytest.raises(InputError, match=r"\[record.time\]: the record holds frequency response functions"):
        prepare_study(load_study(path))


GAIN = '[[record.channel_error]]\nproperty = "gain"\noutputs = "2X"\n'


def with_error(error, text=CHAIN):
    return text.replace("[method]", f"{error}[method]")


def test_a_sensors_gain_is_identified_with_the_structure_and_told_everywhere(tmp_path):
    structure = chain()
    truth = unknowns(structure)
    histories = record(structure, truth.values(truth.start), np.random.default_rng(0))
    read = replace(histories, values=histories.values * [1.0, 1.0, 0.9])  # force, 4X, 2X
    plain, _ = write_study(tmp_path, histories=read)
    assert run_study(load_study(plain)).identification.estimate.chi_square_per_dof > 5
    path, _ = write_study(tmp_path, with_error(GAIN), read)
    ran = CliRunner().invoke(app, ["identify", str(path), "--out", str(tmp_path / "out")])
    assert ran.exit_code == 0, ran.output
    assert "gain[2X+]" in ran.output
    summary = json.loads((tmp_path / "out" / "estimate.json").read_text())
    [gain] = [entry for entry in summary["parameters"] if entry["name"] == "gain[2X+]"]
    assert gain["value"] == pytest.approx(0.9, abs=4 * gain["std"])
    assert gain["std"] < 0.005
    assert summary["verdict"] == "sound"
    assert "gain[2X+]" in (tmp_path / "out" / "report.html").read_text()
    fit = run_study(load_study(path)).identification.fits[0]
    assert np.median(fit.relative_error[:, 1]) < 0.5 * np.median(fit.initial_relative_error[:, 1])


def test_one_sensor_of_histories_and_frfs_has_one_gain(tmp_path):
    structure = chain()
    truth = unknowns(structure)
    like = FrfRecord(np.linspace(0.5, 8.0, 60), np.zeros((60, 1, 1)), ("2X",), ("4X",), "receptance")
    frf = simulated_record(structure, truth, like, 0.01, np.random.default_rng(1))
    write_record(tmp_path / "frf.npz", replace(frf, values=0.9 * frf.values))
    histories = record(structure, truth.values(truth.start), np.random.default_rng(0))
    read = replace(histories, values=histories.values * [1.0, 1.0, 0.9])
    several = CHAIN.replace("[record]", "[[record]]").replace(
        "[method]", GAIN + f'[[record]]\npath = "frf.npz"\nnoise = {{ relative = 0.01 }}\n{GAIN}[method]'
    )
    found = run_study(load_study(write_study(tmp_path, several, read)[0])).identification.estimate
    assert [name for name in found.names if name.startswith("gain")] == ["gain[2X+]"]
    assert found["gain[2X+]"][0] == pytest.approx(0.9, abs=4 * found["gain[2X+]"][1])


@pytest.mark.parametrize(
    ("error", "fit", "words"),
    [
        (GAIN.replace("2X", "3X"), "", "must name channels of the record, got '3X'"),
        ('[[record.channel_error]]\nproperty = "window_decay"\nstart = 1.0\n', "", "is no error of histories"),
        (GAIN, 'fit = "output_error"\n', "fit 'output_error' takes no errors of channels; take fit = 'spectra'"),
    ],
)
def test_errors_of_channels_that_histories_do_not_have_are_told_with_their_line(tmp_path, error, fit, words):
    path, _ = write_study(tmp_path, with_error(error, CHAIN.replace("relative_noise", f"{fit}relative_noise")))
    ran = CliRunner().invoke(app, ["identify", str(path)])
    assert ran.exit_code == 2
    assert "[[record.channel_error]]" in "".join(ran.output.split())  # a long path breaks the line anywhere
    assert "[[record.channel_error]]" in ran.output


def test_output_error_refuses_a_band(tmp_path):
    text = CHAIN.replace("relative_noise = 0.01", 'fit = "output_error"\nrelative_noise = 0.01')
    path, _ = write_study(tmp_path, text)
    with pytest.raises(InputError, match="takes one record, all of it"):
        run_study(load_study(path))


DASHPOTS = CHAIN[CHAIN.index("[[structure.dashpot]]") : CHAIN.index('[[unknown]]\nproperty = "mass"')]
MODAL = (
    CHAIN.replace(DASHPOTS, "")
    .replace('active = ["X"]', 'active = ["X"]\ndamping_ratio = 0.02')
    .replace(
        'property = "viscous_damping"\nelements = "c"\neach = true',
        'property = "damping_ratio"\nelements = "all modes"',
    )
)


@pytest.mark.parametrize("fit", ["spectra", "output_error"])
def test_a_damping_ratio_of_all_modes_is_found_from_histories(tmp_path, fit):
    structure = load_study(write_study(tmp_path, MODAL)[0]).setups[0].structure
    sought = [Unknown("mass", "m", each=True), Unknown("stiffness", "k", each=True)]
    truth = parameters(structure, [*sought, Unknown("damping_ratio", "all modes", start=0.03)])
    rng = np.random.default_rng(5)
    values = np.column_stack([rng.standard_normal(1200), np.zeros((1200, 3))])
    blank = TimeRecord(RATE, values, ("4X", "1X", "2X", "4X"), ("force", *["acceleration"] * 3))
    clean = simulated_time_record(structure, truth, blank, TimeOptions(force="first"))
    noise = 0.02 * clean.values[:, 1:].std() * rng.standard_normal((1200, 3))
    noisy = replace(clean, values=clean.values + np.column_stack([np.zeros(1200), noise]))
    std = float(0.02 * clean.values[:, 1:].std())
    lines = f'fit = "{fit}"\nhold = "first"\n'
    text = MODAL.replace("relative_noise = 0.01", lines + f"noise = [0.0, {std}, {std}, {std}]")
    write_study(tmp_path, text if fit == "spectra" else text.replace("[method]\nband = [0.1, 12.0]\n", ""), noisy)
    ran = CliRunner().invoke(app, ["identify", str(tmp_path / "study.toml"), "--out", str(tmp_path / "out")])
    assert ran.exit_code == 0, ran.output
    summary = json.loads((tmp_path / "out" / "estimate.json").read_text())
    found = {one["name"]: (one["value"], one["std"]) for one in summary["parameters"]}
    for name, true in zip(truth.names, truth.start.tolist(), strict=True):
        value, deviation = found[name]
        assert abs(value - true) < 4 * deviation, name
    assert found["damping_ratio[all modes]"][1] < 0.001


def test_a_damping_ratio_in_per_cent_or_of_massless_structures_is_refused_with_its_place(tmp_path):
    path, _ = write_study(tmp_path, MODAL.replace("damping_ratio = 0.02", "damping_ratio = 2.0"))
    with pytest.raises(InputError, match=r"study.toml.*\[structure\] damping_ratio.* at least 0 and less than 1"):
        load_study(path)
