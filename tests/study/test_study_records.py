"""Several records in one study file, errors of their channels, and set-ups that change the structure."""

from __future__ import annotations

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest

from structid import InputError, load_study, run_study
from structid.records.formats import write_record
from structid.report.identification import report_page
from structid.report.rendering.png import pictures
from structid.study.results.folder import write_results
from structid.study.run.check import check_study
from study_cases import CHAIN, NOISE, TRUE, chain_record, line_of, replaced, write_chain

GAIN = """
[[record.channel_error]]
property = "gain"
outputs = "1X"
name = "A"
"""
HEAD = CHAIN[: CHAIN.index("[record]")]
METHOD = "\n[method]\nband = [0.5, 12.0]\nrestarts = 0\n"
FIRST = """
[[record]]
name = "as built"
path = "frf.npz"
[record.noise]
relative = 0.01
"""
SECOND = """
[[record]]
name = "loaded"
path = "loaded.npz"
[record.noise]
relative = 0.01
"""
ADDED = """
[[record.structure.point_mass]]
name = "added"
nodes = 2
mass = 0.5
"""
TWO = (
    HEAD
    + FIRST
    + GAIN
    + 'prior = { mean = 1.0, std = 0.05 }\n[[record.channel_error]]\nproperty = "polarity"\noutputs = "3X"\n'
    + SECOND
    + GAIN
    + ADDED
    + METHOD
)


def loaded_record(seed=3, gain=1.04):
    """The chain with half a kilogram more on mass 2, by inversion written out."""
    frequency = np.arange(0.5, 12, 0.05)
    stiffness = np.array([[2000.0, -1000, 0], [-1000, 2000, -1000], [0, -1000, 1000]]) * (1 + 0.02j)
    w = 2 * np.pi * frequency[:, None, None]
    dynamic = stiffness + 1j * w * np.diag([3.0, 0, 0]) - w**2 * np.diag([2.0, 3.5, 1.0])
    values = -(w**2) * np.linalg.inv(dynamic)[:, [0, 2], :][:, :, [2]] * np.array([gain, 1.0])[:, None]
    random = np.random.default_rng(seed)
    error = random.standard_normal(values.shape) + 1j * random.standard_normal(values.shape)
    return chain_record(values=values * (1 + NOISE * error / np.sqrt(2)))


def turned_record():
    """The first record with a gain on 1X and the wrong sense on 3X."""
    first = chain_record()
    return chain_record(values=first.values * np.array([1.04, -1.0])[:, None])


def write_two(folder, text=TWO):
    path = write_chain(folder, text, turned_record())
    write_record(folder / "loaded.npz", loaded_record())
    return path


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    return run_study(load_study(write_two(tmp_path_factory.mktemp("two"))))


def test_two_records_of_two_set_ups_give_one_answer(result):
    found = result.identification.estimate
    assert found.covariance_basis == "noise"
    for name, value in {**TRUE, "gain[A]": 1.04}.items():
        got, std = found[name].value, found.std_noise[found.names.index(name)]
        assert abs(got - value) < 3.5 * std < 0.02 * value, name
    assert [fit.name for fit in result.identification.fits] == ["as built", "loaded"]
    assert result.identification.fits[0].polarities == {"polarity[3X+]": -1}
    assert "as built: polarity[3X+] is -1" in " ".join(result.identification.warnings)
    assert abs(result.identification.mass.total - 6.0) < 0.02  # of the first set-up, without the added mass


def test_results_and_report_show_every_record(result, tmp_path):
    write_results(result, tmp_path)
    summary = json.loads((tmp_path / "estimate.json").read_text())
    assert [r["name"] for r in summary["records"]] == ["as built", "loaded"]
    assert summary["records"][0]["polarities"] == {"polarity[3X+]": -1}
    assert all(r["median_relative_error"] < 0.012 for r in summary["records"])
    assert summary["parameters"][-1]["name"] == "gain[A]"
    assert summary["parameters"][-1]["prior_std"] == 0.05
    with h5py.File(tmp_path / "estimate.h5") as file:
        assert file["record_2"].attrs["name"] == "loaded"
        second = file["record_2/frf"]
        assert np.abs(second["residual"][()] / second["measured"][()]).max() < 0.06
        assert not np.allclose(file["record_2/modes/frequency"][()], file["modes/frequency"][()], rtol=1e-3)
    found = result.identification
    page = report_page(found, "Two")
    text = page.text
    assert "<summary>loaded</summary>" in text
    assert 'id="figure-record_2_frf"' in text
    assert "record_2_frf_magnitude" in pictures(page.figures)


def test_check_predicts_from_all_records(tmp_path):
    both = check_study(load_study(write_two(tmp_path / "two")))
    alone = check_study(load_study(write_two(tmp_path / "one", HEAD + FIRST + GAIN + METHOD)))
    assert both.names == (*TRUE, "gain[A]")
    assert (both.of_data.std < 0.99 * alone.of_data.std).all()
    assert both.determined
    assert {channel.channel.split(":")[0] for channel in both.channels} == {"as built", "loaded"}


def test_a_single_record_may_be_written_either_way(tmp_path):
    plain, listed = (
        run_study(load_study(write_chain(tmp_path / name, text))).identification
        for name, text in (("a", CHAIN), ("b", replaced("[record]", "[[record]]")))
    )
    assert np.array_equal(plain.estimate.values, listed.estimate.values)
    assert np.array_equal(plain.estimate.covariance, listed.estimate.covariance)
    assert plain.estimate.names == tuple(TRUE)


def test_unknown_masses_of_a_set_up_are_parameters_of_it_alone(tmp_path):
    unknown = '[[unknown]]\nproperty = "mass"\nelements = "added"\n'
    study = load_study(write_two(tmp_path, replaced("\n[[record]]", "\n" + unknown + "[[record]]", TWO)))
    first, second = study.setups
    assert "mass[added]" not in first.parameters.names
    assert second.parameters.names == (*first.parameters.names, "mass[added]")
    assert check_study(study).names[-1] == "mass[added]"
    shared = replaced('elements = "mass 3"', 'elements = ["mass 3", "added"]\nfactor = false', TWO)
    study = load_study(write_two(tmp_path, shared))
    assert all("mass[mass 3, added]" in setup.parameters.names for setup in study.setups)


def test_a_set_up_can_be_without_elements_and_otherwise_fixed(tmp_path):
    changes = '[record.structure]\nwithout = ["damper"]\nfixed = "2X"\n'
    text = replaced(ADDED, changes, TWO)
    first, second = load_study(write_two(tmp_path, text)).setups
    assert "damper" in [e.name for e in first.structure.elements]
    assert "damper" not in [e.name for e in second.structure.elements]
    assert (first.structure.n_dofs, second.structure.n_dofs) == (3, 2)
    assert "viscous_damping[damper]" not in second.parameters.names
    nodes = (
        "[record.structure.nodes]\n9 = 3.0\n[[record.structure.rigid_link]]\nname = 'arm'\nmain = 3\ndependents = [9]\n"
    )
    second = load_study(write_two(tmp_path, replaced(ADDED, nodes, TWO))).setups[1]
    assert 9 in second.structure.nodes
    assert [tie.name for tie in second.structure.ties] == ["arm"]


def test_a_known_window_decay_is_read(tmp_path):
    text = replaced('path = "frf.npz"', 'path = "frf.npz"\nwindow_decay = 2.5')
    problem = run_study(load_study(write_chain(tmp_path, text + "restarts = 0\n"))).identification.problem
    assert np.array_equal(problem.record.decay, np.full(len(problem.record.frequency), 2.5))


def test_leakage_of_segments_as_long_as_the_line_spacing_says_is_read(tmp_path):
    text = replaced('path = "frf.npz"', 'path = "frf.npz"\nleakage = "hann"')
    study = load_study(write_chain(tmp_path, text + "restarts = 0\n"))
    record = run_study(study).identification.problem.record
    assert record.segment == pytest.approx(1 / np.diff(record.frequency).mean())
    uneven = chain_record().lines(np.array([4, 5, 7, 8, 9, 10, 11, 12]))
    with pytest.raises(InputError, match=r"leakage.*not evenly spaced"):
        run_study(load_study(write_chain(tmp_path / "uneven", text, uneven)))


@pytest.mark.parametrize(
    ("old", "new", "place", "words"),
    [
        ('outputs = "1X"', 'outputs = "8X"', "[[record.channel_error]]", "must name channels of the record, got '8X'"),
        ('name = "A"', 'nam = "A"', "nam =", "unknown key; the nearest is `name`"),
        ('property = "gain"', 'property = "gein"', 'property = "gein"', "must be one of"),
        ("std = 0.05", "std = -1", "prior =", "must be a number greater than 0"),
        ('name = "loaded"', 'name = "as built"', 'name = "as built"\npath = "loaded', "two records are called 'as built'"),
        (ADDED, '[record.structure]\nwithout = ["dampers"]\n', "without", "the nearest is 'damper'"),
        (ADDED, "[record.structure.nodes]\n2 = 4.0\n", "", "node 2 is in [structure.nodes] already"),
        (ADDED, "[record.structure]\nactive = ['X']\n", "active = ['X']", "unknown key"),
        ("nodes = 2\nmass = 0.5", "nodes = 7\nmass = 0.5", "nodes = 7", "node 7 does not exist"),
        ('name = "added"', 'name = "mass 2"', "", "mass 2"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_a_set_up_is_told_with_its_line(tmp_path, old, new, place, words):
    text = TWO[: TWO.index(FIRST)] + replaced(old, new, TWO[TWO.index(FIRST) :])
    path = write_two(tmp_path, text)
    with pytest.raises(InputError) as caught:
        check_study(load_study(path))
    assert words in str(caught.value)
    if place:
        assert f"line {line_of(place, text)}:" in str(caught.value)


@pytest.mark.parametrize(("name", "words"), [('name = "loaded"\n', "loaded: "), ("", "record 2: ")])
@pytest.mark.parametrize("key", ["band", "evaluation_band"])
def test_the_record_without_a_line_in_the_band_is_named(tmp_path, name, words, key):
    text = replaced('name = "loaded"\n', name, TWO).replace("\nband = ", "\nband = [0.5, 90.0]\nevaluation_band = ")
    text = text if key == "evaluation_band" else text.replace("band = [0.5, 90.0]\nevaluation_", "")
    path = write_two(tmp_path, text)
    second = loaded_record()
    write_record(tmp_path / "loaded.npz", replace(second, frequency=second.frequency + 50))
    with pytest.raises(
        InputError, match=rf"line {line_of(key + ' =', text)}: \[method\] {key}: {words}no frequency line"
    ):
        check_study(load_study(path))


def test_channels_errors_with_one_name_but_other_bounds_are_told(tmp_path):
    text = TWO.replace(GAIN, GAIN + "bounds = [0.5, 2.0]\n", 1)
    with pytest.raises(InputError, match=r"gain\[A\] must have the same bounds and transform in all problems"):
        check_study(load_study(write_two(tmp_path, text)))


def test_a_set_up_that_nothing_holds_says_so_with_an_empty_list(tmp_path):
    held = HEAD.replace("[structure]\n", '[structure]\nfixed = "3X"\n', 1)
    assert held != HEAD
    text = held + FIRST + "[record.structure]\nfixed = []\n" + METHOD
    structure = load_study(write_chain(tmp_path, text)).setups[0].structure
    assert structure.fixed == ()
    with pytest.raises(InputError, match=r"fixed: must be a text or a list of texts, or \[\], got 3"):
        load_study(write_chain(tmp_path / "wrong", text.replace("fixed = []", "fixed = 3")))
