"""Measured modes as records of a study: pipeline, ratios, joint fits, and what is refused."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import linalg, sparse
from typer.testing import CliRunner

from structid import InputError, ModalRecord
from structid.cli import app as cli
from structid.dynamics.normal_modes import modes
from structid.modal.formats.files import read_modes, write_modes
from structid.records.formats import write_record
from structid.report.identification import report_page
from structid.report.identification_tables import modal_facts
from structid.report.rendering import png
from structid.study.results.folder import write_results
from structid.study.results.stored_model import stored_model_error
from structid.study.run.check import check_study
from structid.study.run.run import run_study
from structid.study.run.start import prepare_study, study_problems
from structid.study.schema.records.modes import ModeDeviations
from structid.study.schema.study import load_study
from study_cases import CHAIN, NOISE, TRUE, chain_record, replaced, write_chain

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "ambient_storeys"
FRAMES = ROOT.parent / "shared" / "data" / "smu_shear_frames"
needs_frames = pytest.mark.skipif(not FRAMES.exists(), reason="measured modes under GPL-3, kept outside the package")
TRUTH = np.array([2.4e6, 2.0e6, 1.5e6, 1.1e6])
FREE = '[[unknown]]\nproperty = "mass"\nelements = "floor"\n\n[record]'


def storeys(folder, old="", new=""):
    """The example's study with one passage changed, its modes beside it."""
    folder.mkdir(parents=True, exist_ok=True)
    write_modes(folder / "modes.json", read_modes(EXAMPLE / "modes.json"))
    text = (EXAMPLE / "study.toml").read_text(encoding="utf-8")
    path = folder / "study.toml"
    path.write_text(replaced(old, new, text) if old else text, encoding="utf-8")
    return path


def invoke(*arguments):
    return CliRunner().invoke(cli.app, [str(argument) for argument in arguments])


def test_ambient_storeys_example_gives_the_true_stiffnesses_within_their_intervals():
    found = run_study(load_study(EXAMPLE / "study.toml")).identification
    estimate = found.estimate
    assert estimate.status.value == "converged"
    np.testing.assert_array_less(np.abs(estimate.values - TRUTH), 4 * estimate.std)
    assert (estimate.std_noise < 0.005 * TRUTH).all()
    np.testing.assert_allclose(estimate.values[0], 2.398e6, rtol=1e-3)  # pinned
    assert found.mass.ratios is None
    assert not found.warnings


def test_modes_with_unknown_masses_give_ratios_with_intervals_and_exit_1(tmp_path):
    done = invoke("identify", storeys(tmp_path, "[record]", FREE), "--out", tmp_path / "out", "--no-report")
    assert done.exit_code == 1
    result = json.loads((tmp_path / "out" / "estimate.json").read_text(encoding="utf-8"))
    assert (result["status"], result["rank"]) == ("not_identifiable", 4)
    assert any("ratios of stiffness to mass, not kilograms" in words for words in result["warnings"])
    assert "common scale is free" in result["unidentifiable_directions"][0]["words"]
    assert all(entry["std"] is None for entry in result["parameters"])
    ratios = result["ratios"]
    assert ratios["reference"] == "mass[floor]"
    fixed = run_study(load_study(storeys(tmp_path / "known"))).identification.estimate
    np.testing.assert_allclose([r["ratio"] for r in ratios["parameters"]], fixed.values, rtol=1e-6)
    np.testing.assert_allclose([r["std"] for r in ratios["parameters"]], fixed.std_noise, rtol=1e-4)
    low, high = np.array([r["interval_95"] for r in ratios["parameters"]]).T
    np.testing.assert_allclose(np.sqrt(low * high), fixed.values, rtol=1e-6)  # symmetric in the logarithm
    np.testing.assert_allclose(np.log(high / low) / 2, 1.96 * fixed.std_noise / fixed.values, rtol=1e-3)
    scale = result["parameters"][-1]["value"]
    assert 0.7 < scale < 1.4  # what is free stays near its start


def test_a_prior_on_the_mass_fixes_the_scale(tmp_path):
    prior = FREE.replace("\n\n[record]", "\nprior = { mean = 1.0, std = 0.05 }\n\n[record]")
    found = run_study(load_study(storeys(tmp_path, "[record]", prior))).identification
    assert found.estimate.status.value == "converged"
    assert found.mass.ratios is None
    relative = found.estimate.std / found.estimate.values
    np.testing.assert_allclose(relative, 0.05, rtol=0.05)  # of the prior, in everything


def test_check_of_modes_says_that_kilograms_are_missing(tmp_path):
    found = check_study(load_study(storeys(tmp_path, "[record]", FREE)))
    assert not found.determined
    assert any("not kilograms" in words for words in found.warnings)
    known = check_study(load_study(EXAMPLE / "study.toml"))
    assert known.determined
    assert not known.warnings
    assert [words[:7] for words in known.records] == ["4 modes"]
    done = invoke("check", EXAMPLE / "study.toml")
    assert done.exit_code == 0
    assert "record: 4 modes from 1.1309 to 5.6408 Hz at 3 sensors" in done.stdout


def test_damping_ratios_that_are_left_out_are_told_where_damping_is_sought(tmp_path):
    damped = FREE.replace("mass", "loss_factor").replace("floor", "storey")
    text = storeys(tmp_path, "stiffness = 1.6e6", "stiffness = 1.6e6\nloss_factor = 0.02")
    text.write_text(replaced("[record]", damped, text.read_text(encoding="utf-8")), encoding="utf-8")
    left, found = check_study(load_study(text)), run_study(load_study(text)).identification
    for told in (left.warnings, found.warnings):
        (words,) = (words for words in told if "use_damping" in words)
        assert "damping is not determined (loss_factor[storey])" in words
        assert words.endswith("write `use_damping = true` in [record.modes]")
    text.write_text(text.read_text(encoding="utf-8") + "use_damping = true\n", encoding="utf-8")
    found = run_study(load_study(text)).identification
    assert found.estimate.identified.all()
    assert not any("use_damping" in words for words in found.warnings)


def test_report_of_modes_shows_pairs_and_no_responses(tmp_path, monkeypatch):
    written, write = set(), png.write_pngs

    def write_those_of_modes(figures, folder):
        """Others are drawn by tests of the report."""
        written.update(png.pictures(figures))
        chosen = [name for name in figures if name.startswith(("modal_fit_1", "correlation_1_"))]
        write({name: figures[name] for name in chosen}, folder)

    monkeypatch.setattr(png, "write_pngs", write_those_of_modes)
    done = invoke("identify", storeys(tmp_path, "[record]", FREE), "--out", tmp_path / "out", "--png")
    assert done.exit_code == 1
    text = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for words in (
        "Measured and fitted modes",
        "Ratios, which a free common scale leaves determined",
        "modal-fit-1",
        "figure-modal_fit_1",
        "Test and model side by side",
        "Initial model: 4 of 4 measured modes paired",
    ):
        assert words in text
    assert 'id="responses"' not in text
    drawn = {
        "correlation_1_modes_comac", "correlation_1_modes_mac", "correlation_1_modes_shapes", "modal_fit_1"
    }  # fmt: skip
    assert {path.stem for path in (tmp_path / "out" / "figures").iterdir()} == drawn
    assert written == drawn | {"convergence", "correlation", "modes", "parameters", "shapes", "structure"}
    import h5py

    with h5py.File(tmp_path / "out" / "estimate.h5") as file:
        assert set(file) == {"parameters", "modes", "modes_initial", "modal_record_1", "subdivide"}
        np.testing.assert_allclose(file["modal_record_1/mac_fitted"], 1.0, atol=1e-3)


def chain_modes(noise=1e-3, seed=1):
    """Modes of the chain of `study_cases` at its two sensors, with noise."""
    stiffness = np.array([[2000.0, -1000, 0], [-1000, 2000, -1000], [0, -1000, 1000]])
    found = modes(sparse.csc_array(np.diag([2.0, 3.0, 1.0])), sparse.csc_array(stiffness))
    rng = np.random.default_rng(seed)
    shapes = found.mode_shapes[[0, 2]] / np.abs(found.mode_shapes[[0, 2]]).max(axis=0)
    std = noise * found.frequency
    covariance = np.diag(np.concatenate([std, np.full(3, 1e-3)]) ** 2)
    return ModalRecord(
        found.frequency + std * rng.standard_normal(3),
        np.full(3, 0.01),
        shapes + 0.01 * rng.standard_normal(shapes.shape),
        ("1X", "3X"),
        covariance,
        np.full(shapes.shape, 0.01),
    )


def test_modes_and_responses_are_fitted_together(tmp_path):
    write_modes(tmp_path / "modes.json", chain_modes())
    write_record(tmp_path / "frf.npz", chain_record())
    both = replaced("[record]\n", "[[record]]\nname = 'ambient'\npath = 'modes.json'\n[record.modes]\n\n[[record]]\n")
    path = tmp_path / "study.toml"
    path.write_text(both, encoding="utf-8")
    found = run_study(load_study(path)).identification
    assert (len(found.fits), len(found.modal_fits)) == (1, 1)
    assert found.modal_fits[0].name == "ambient"
    assert found.estimate.status.value == "converged"
    truth = np.array([TRUE[name] for name in found.estimate.names])
    np.testing.assert_array_less(np.abs(found.estimate.values - truth), 4 * found.estimate.std)
    write_record(tmp_path / "frf.npz", chain_record())
    (tmp_path / "one.toml").write_text(CHAIN, encoding="utf-8")
    alone = run_study(load_study(tmp_path / "one.toml")).identification.estimate
    assert (found.estimate.std <= 1.001 * alone.std).all()  # more data
    assert found.estimate.goodness.degrees_of_freedom > alone.goodness.degrees_of_freedom
    names = [test.name for test in found.estimate.goodness.residual_tests.series]
    assert "ambient: shape at 1X+" in names
    assert NOISE == 0.01
    text = report_page(found).text
    for words in ("frequency response functions and modes", 'id="modal-fit-1"', 'id="responses"', "Modes: ambient"):
        assert words in text


def test_modes_of_two_states_are_compared(tmp_path):
    given = read_modes(EXAMPLE / "modes.json")
    later = storeys(tmp_path / "later")
    softer = 0.98 * given.frequency
    write_modes(
        tmp_path / "later" / "modes.json",
        ModalRecord(softer, given.damping_ratio, given.mode_shapes, given.channels, given.covariance, given.shape_std),
    )
    invoke("identify", EXAMPLE / "study.toml", "--out", tmp_path / "stored", "--no-report")
    for baseline in (tmp_path / "stored", EXAMPLE / "study.toml"):
        done = invoke("compare", baseline, later, "--out", tmp_path / "changed", "--no-report")
        assert done.exit_code == 0
        result = json.loads((tmp_path / "changed" / "compare.json").read_text(encoding="utf-8"))
        assert any(change["changed"] for change in result["changes"])


def test_modes_that_are_not_used_and_sensors_left_out_change_the_fit(tmp_path):
    path = storeys(tmp_path, 'form = "output"', 'form = "dynamic"\nuse = [3, 1]')
    found = run_study(load_study(path)).identification
    assert found.modal_fits[0].measured.n_modes == 2
    assert found.modal_fits[0].problem.settings.form == "dynamic"
    np.testing.assert_allclose(found.modal_fits[0].fitted.passed_over, [2.878], atol=0.05)
    assert any("no measured mode is paired with" in words for words in found.warnings)
    path = storeys(tmp_path, 'path = "modes.json"', 'path = "modes.json"\nchannels_used = ["4X", "1X"]')
    problem = run_study(load_study(path)).identification.modal_fits[0].problem
    assert [str(dof) for dof in problem.record.channels] == ["4X+", "1X+"]


def test_uniqueness_starts_search_modes_more_than_once(tmp_path):
    path = storeys(tmp_path, "[record]", "[method]\nuniqueness_starts = 2\n\n[record]")
    estimate = run_study(load_study(path)).identification.estimate
    assert (estimate.search.n_starts, estimate.search.n_agreeing) == (3, 3)


def test_a_measured_mode_without_a_like_in_the_model_is_named(tmp_path):
    given = read_modes(EXAMPLE / "modes.json")
    path = storeys(tmp_path, "each = true", "each = false")  # a model that cannot bend to any shape
    shapes = given.mode_shapes.copy()
    shapes[:, 2] = shapes[:, 0]
    write_modes(
        tmp_path / "modes.json",
        ModalRecord(given.frequency, given.damping_ratio, shapes, given.channels, given.covariance, given.shape_std),
    )
    found = run_study(load_study(path)).identification
    assert any("measured at 4.2906 Hz matches no mode of the model" in words for words in found.warnings)


def five_modes(folder, frequency, like=2, stiffness="1.6e6", is_bare=False):
    """The example's study with a mode at `frequency` (Hz) more than its model has, of the shape of mode `like`, from 0.

    `stiffness` is the initial one, and with `is_bare` no shape of the mode is known.
    """
    path, given = storeys(folder, "stiffness = 1.6e6", f"stiffness = {stiffness}"), read_modes(EXAMPLE / "modes.json")
    order = np.argsort([*given.frequency, frequency])
    more = [
        np.append(values, values[..., like : like + 1], axis=-1)[..., order]
        for values in (given.damping_ratio, given.mode_shapes)
    ]
    covariance = np.diag(1e-6 * np.ones(10))
    std = 1e-3 * np.ones((len(given.channels), 5))
    if is_bare:
        more[1][:, order == 4] = std[:, order == 4] = np.nan
    write_modes(
        folder / "modes.json",
        ModalRecord(np.append(given.frequency, frequency)[order], *more, given.channels, covariance, std),
    )
    return path


@pytest.mark.parametrize(
    ("frequency", "others"),
    [
        (12.23, {}),
        (12.23, {"is_bare": True}),
        (12.23, {"stiffness": "0.8e6", "like": 3}),
        (0.21, {}),
        (0.21, {"is_bare": True}),
    ],
)
def test_a_mode_far_beyond_all_of_the_model_is_named_and_left_out(tmp_path, frequency, others):
    prepared = prepare_study(load_study(five_modes(tmp_path, frequency, **others)))
    (problem,) = prepared.problems
    np.testing.assert_array_equal(problem.record.frequency, read_modes(EXAMPLE / "modes.json").frequency)
    assert any(
        "at its initial values the model has 4 modes" in words
        and f"none for {frequency} Hz: left out of the fit" in words
        for words in prepared.warnings
    )


@pytest.mark.parametrize(
    ("frequency", "others"),
    [
        (4.9, {}),
        (7.3, {}),
        (0.7, {}),
        (4.9, {"is_bare": True}),
        (4.9, {"stiffness": "0.8e6", "like": 3}),
        (3.0, {"stiffness": "0.8e6", "like": 3}),
        (3.0, {"stiffness": "0.1e6", "like": 3}),
    ],
)
def test_a_mode_too_many_that_other_values_may_reach_is_refused_with_the_remedy(tmp_path, frequency, others):
    """Soft initial values leave true modes unpaired: none of them is left out for a false one."""
    study = load_study(five_modes(tmp_path, frequency, **others))
    words = r"\[record.modes\]: at its initial values .* none is left for [\d.]+ Hz; .* none of the structure out with `use`"
    for prepared in (prepare_study, study_problems):
        with pytest.raises(InputError, match=words):
            prepared(study)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('form = "output"', "use = [1, 5]", r"line 35: \[record.modes\] use: must be different numbers from 1 to 4"),
        ('form = "output"', "forms = 1", r"\[record.modes\] forms: unknown key; the nearest is `form`"),
        ('path = "modes.json"', 'path = "modes.json"\n[record.noise]\nrelative = 0.1', r"noise: unknown key"),
        ('path = "modes.json"', 'path = "gone.json"', r"gone.json"),
        ('path = "modes.json"\n', "", r"\[record\]: `path` is missing"),
        ('path = "modes.json"', 'path = "modes.json"\nchannels_used = "3X"', r"no sensor 3X\+; they have 1X\+, 2X\+"),
        ('"3X", "4X"]\nstiffness', '"3X", "4X"]\nstiffness', None),
    ],
)
def test_records_of_modes_that_cannot_be_used_are_told_with_their_place(tmp_path, old, new, words):
    path = storeys(tmp_path, old, new)
    if words is None:
        write_modes(tmp_path / "modes.json", replace_uncertainty(read_modes(EXAMPLE / "modes.json")))
        words = r"\[record.modes\]: the record has no uncertainty of its frequencies; give .* or `frequency_error`"
    with pytest.raises(InputError, match=words):
        run_study(load_study(path))


def replace_uncertainty(given):
    return ModalRecord(given.frequency, given.damping_ratio, given.mode_shapes, given.channels)


def shear_study(folder, masses, stiffness, record, errors):
    """A shear chain whose storey stiffnesses are unknown, in the units of the source."""
    n = len(masses)
    write_modes(folder / "modes.json", record)
    nodes = "\n".join(f"{i} = {float(i)}" for i in range(n + 1))
    below, here = [f"{i}X" for i in range(n)], [f"{i + 1}X" for i in range(n)]
    path = folder / "frame.toml"
    path.write_text(
        f"""[structure]
active = ["X"]
fixed = ["0X"]
[structure.nodes]
{nodes}
[[structure.point_mass]]
name = "floor"
nodes = {list(range(1, n + 1))}
mass = {[float(m) for m in masses]}
[[structure.spring]]
name = "story"
first = {json.dumps(below)}
second = {json.dumps(here)}
stiffness = {[float(k) for k in stiffness]}
[[unknown]]
property = "stiffness"
elements = "story"
each = true
[record]
path = "modes.json"
[record.modes]
use = [1, 2]
frequency_error = {errors[0]}
shape_error = {errors[1]}
[method]
restarts = 0
"""
    )
    return path


@needs_frames
def test_four_story_frame_as_a_study_gives_a_published_set_and_predicts_the_modes_left_out(tmp_path):
    data = np.load(FRAMES / "four_story_lab_frame.npz")
    record = ModalRecord(data["test_frequency_hz"], np.full(4, np.nan), data["test_mode"][:3], ("1X", "2X", "3X"))
    masses = data["floor_weight_lb"] / 386.088
    path = shear_study(tmp_path, masses, np.full(4, 10.0), record, (0.002, 0.02))
    found = run_study(load_study(path)).identification
    published = 10 * (1 + data["published_alpha_form1_mac"])
    np.testing.assert_allclose(found.estimate.values, published, rtol=0.01)  # asked: 5 %
    np.testing.assert_allclose(found.estimate.values, [7.389, 7.821, 8.742, 15.330], rtol=1e-3)  # pinned
    np.testing.assert_allclose(found.modes.frequency[2:], data["test_frequency_hz"][2:], rtol=0.01)


@needs_frames
def test_eighteen_story_frame_as_a_study_says_what_is_not_determined(tmp_path):
    data = np.load(FRAMES / "eighteen_story_edefense_frame.npz")
    channels = tuple(f"{floor}X" for floor in (3, 6, 9, 12, 15, 18))
    n = len(data["freq_hz"])
    record = ModalRecord(data["freq_hz"], np.full(n, np.nan), data["mode_shape"][:, :n], channels)
    path = shear_study(
        tmp_path, data["weight_kN"] / 9.8, data["nominal_story_stiffness_kN_per_m"], record, (0.005, 0.02)
    )
    found = run_study(load_study(path)).identification
    assert found.estimate.status.value == "not_identifiable"
    assert found.estimate.identifiability.rank <= 12
    told = [words for words in found.warnings if words.startswith("the data determine stiffness[story")]
    assert len(told) == 18 - found.estimate.identifiability.rank
    assert found.mass.ratios is None  # masses are weighed


def as_uff(folder, keys):
    """The example's study with its modes in a universal file, which keeps no deviations, and these keys beside them."""
    path = storeys(folder)
    write_modes(folder / "modes.uff", read_modes(folder / "modes.json"))
    text = path.read_text(encoding="utf-8").replace("modes.json", "modes.uff")
    head, mark, tail = text.partition("[record.modes]")
    assert mark
    path.write_text(f"{head}{mark}\n{keys}{tail.partition(chr(10))[2]}", encoding="utf-8")
    return path


def test_deviations_of_a_universal_file_are_given_in_the_study(tmp_path):
    own = read_modes(EXAMPLE / "modes.json")
    std = np.sqrt(np.diag(own.covariance)[: own.n_modes])
    keys = f"frequency_std = {std.tolist()}\nshape_std = 0.01\n"
    record = load_study(as_uff(tmp_path, keys)).setups[0].record.modes.load()
    np.testing.assert_allclose(np.diag(record.covariance)[: len(std)], std**2)
    assert np.isnan(np.diag(record.covariance)[len(std) :]).all()
    largest = np.abs(record.mode_shapes).max(axis=0)
    np.testing.assert_allclose(record.shape_std, np.broadcast_to(0.01 * largest, record.shape_std.shape))
    found = run_study(load_study(tmp_path / "study.toml")).identification
    np.testing.assert_array_less(np.abs(found.estimate.values - TRUTH), 0.02 * TRUTH)
    pull = dict(modal_facts(found.modal_fits[0], False))["What pulls"]
    assert re.match(r"shapes \(\d+ values\) determine .* of 4 parameters and make", pull)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("frequency_std = 0.0\nshape_std = 0.1\n", "frequency_std: must be a number greater than 0"),
        ("frequency_std = [0.1, 0.1]\nshape_std = 0.1\n", "`frequency_std` must be one number or"),
        (
            "",
            "no uncertainty of its frequencies; give the scatter of the test by `frequency_std` in Hz in [record.modes], or",
        ),
    ],
)
def test_deviations_that_cannot_be_exit_2(tmp_path, keys, words):
    done = invoke("check", as_uff(tmp_path, keys))
    assert done.exit_code == 2
    assert words in " ".join(done.stderr.split())


def test_deviations_beside_those_of_the_file_are_refused(tmp_path):
    path = storeys(tmp_path)
    path.write_text(path.read_text().replace("[record.modes]", "[record.modes]\nfrequency_std = 0.1"))
    done = invoke("check", path)
    assert done.exit_code == 2
    assert "has standard deviations of frequencies of its own" in " ".join(done.stderr.split())


def test_deviations_that_the_file_lacks_are_stated_beside_those_it_has(tmp_path):
    path = storeys(tmp_path)
    record = read_modes(tmp_path / "modes.json")
    n = record.n_modes
    write_modes(
        tmp_path / "modes.csv", replace(record, covariance=independent(record.frequency_std, np.full(n, np.nan)))
    )
    text = path.read_text().replace("modes.json", "modes.csv")
    path.write_text(text.replace("[record.modes]", "[record.modes]\ndamping_std = 0.002\nuse_damping = true"))
    done = invoke("check", path)
    assert done.exit_code == 0, done.stderr
    path.write_text(text.replace("[record.modes]", "[record.modes]\nfrequency_std = 0.1"))
    done = invoke("check", path)
    assert "has standard deviations of frequencies of its own" in " ".join(done.stderr.split())


def independent(*stds):
    return np.diag(np.concatenate(stds) ** 2)


def test_shapes_by_mac_are_a_choice_of_the_study_and_said(tmp_path):
    path = storeys(tmp_path)
    path.write_text(
        path.read_text().replace("[record.modes]", '[record.modes]\nshape_form = "mac"\nshape_error = 0.02')
    )
    found = run_study(load_study(path)).identification
    np.testing.assert_array_less(np.abs(found.estimate.values - TRUTH), 0.02 * TRUTH)
    assert any("shapes count by their MAC" in words for words in found.warnings)
    assert "1 - MAC" in dict(modal_facts(found.modal_fits[0], False))["Residual"]


def test_modes_of_two_set_ups_merge_to_a_record(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = storeys(tmp_path)
    whole = read_modes(tmp_path / "modes.json")
    n = len(whole.channels)
    for name, rows in (("lower", range(n - 1)), ("upper", range(1, n))):
        part = whole.some_channels(list(rows))
        write_modes(tmp_path / f"{name}.uff", part)
        write_modes(tmp_path / f"{name}.json", part)
    for suffix in ("uff", "json"):
        page_of_before = tmp_path / f"merged_{suffix}" / "report.html"
        page_of_before.parent.mkdir()
        page_of_before.write_text("modes of another record")
        page_of_before.with_name("modes.json").write_text("{}")
        done = invoke("modes", f"lower.{suffix}", f"upper.{suffix}", "--merge", "--out", f"merged_{suffix}")
        assert (done.exit_code, done.stderr) == (0, "")
        assert not page_of_before.exists()
        assert f"{whole.n_modes} modes at {n} sensors\n" in done.stdout
        assert "modes.uff" not in done.stdout
        merged = read_modes(tmp_path / f"merged_{suffix}" / "modes.json")
        assert {dof.unsigned for dof in merged.channels} == {dof.unsigned for dof in whole.channels}
        np.testing.assert_allclose(merged.frequency, whole.frequency, rtol=1e-5)
    path.write_text(path.read_text().replace("modes.json", "merged_json/modes.json"))
    found = run_study(load_study(path)).identification
    np.testing.assert_array_less(np.abs(found.estimate.values - TRUTH), 0.02 * TRUTH)
    done = invoke("modes", "lower.uff", "upper.uff", "--merge", "--band", "1", "9")
    assert (done.exit_code, "leave the options of reading and identification out" in done.stderr) == (2, True)
    done = invoke("modes", "lower.uff", "--merge")
    assert (done.exit_code, "two set-ups or more are merged, got lower.uff;" in done.stderr) == (2, True)
    shutil.copy("lower.uff", tmp_path / "merged_uff" / "lower.uff")
    done = invoke("modes", "lower.uff", "merged_uff/lower.uff", "--merge")
    assert (done.exit_code, "lower.uff and merged_uff/lower.uff hold the same modes" in done.stderr) == (2, True)


def test_unknown_entries_of_set_ups_go_through_merging_to_a_fit(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = storeys(tmp_path, "modes.json", "merged/modes.csv")
    whole = read_modes(tmp_path / "modes.json")
    n = len(whole.channels)
    for name, rows, dead in (("lower", range(n - 1), 0), ("upper", range(1, n), -1)):
        part = whole.some_channels(list(rows))
        shapes = np.array(part.mode_shapes)
        shapes[dead, 1] = np.nan
        write_modes(tmp_path / f"{name}.json", replace(part, mode_shapes=shapes))
    done = invoke("modes", "lower.json", "upper.json", "--merge", "--out", "merged")
    assert (done.exit_code, done.stderr) == (0, "")
    assert "shape entries unknown" in done.stdout
    assert "modes.uff is not written: UFF has no sign for an unknown entry" in done.stdout
    assert sorted(file.name for file in (tmp_path / "merged").iterdir()) == [
        "modes.csv",
        "modes.json",
    ]  # UFF has no sign
    merged = read_modes(tmp_path / "merged" / "modes.csv")
    assert (~merged.known).sum(axis=0).tolist() == [0, 2, *[0] * (whole.n_modes - 2)]
    found = run_study(load_study(path)).identification
    np.testing.assert_array_less(np.abs(found.estimate.values - TRUTH), 0.02 * TRUTH)


def test_deviations_of_a_study_are_in_parts_of_the_largest_known_entry(tmp_path):
    (tmp_path / "modes.csv").write_text("frequency_hz,1X,2X,3X\n2,2,4,\n5,,,\n", encoding="utf-8")
    record = ModeDeviations(shape_std=(0.1,)).added_to(read_modes(tmp_path / "modes.csv"))
    np.testing.assert_allclose(record.mode_shapes, [[0.5, np.nan], [1, np.nan], [np.nan, np.nan]])
    np.testing.assert_allclose(record.shape_std, [[0.1, np.nan], [0.1, np.nan], [np.nan, np.nan]])


LISTING = """1    STOREYS                                                                   MSC.NASTRAN  6/17/05   PAGE    {page}

0{subcase:>115s}
      EIGENVALUE = {square:13.6E}
          CYCLES = {cycles:13.6E}         R E A L   E I G E N V E C T O R   N O .          1

      POINT ID.   TYPE          T1             T2             T3             R1             R2             R3
"""


def as_listing(folder, keys):
    """The example's study with one mode in a listing of two subcases, its points turned by 90 deg about Z by their deck."""
    path = storeys(folder)
    record = read_modes(folder / "modes.json")
    text = ""
    for number, factor in ((1, 1.0), (2, 3.0)):
        cycles = factor * record.frequency[0]
        text += LISTING.format(
            page=number, subcase=f"SUBCASE {number}", square=(2 * np.pi * cycles) ** 2, cycles=cycles
        )
        for dof, value in zip(record.channels, np.real(record.mode_shapes[:, 0]), strict=True):
            motion = np.zeros(3)
            motion[dof.axis] = dof.sign * value
            along = np.array([motion[1], -motion[0], motion[2]])  # of the system turned by 90 deg
            text += f"{dof.node:14d}      G   " + "".join(f"{x:15.6E}" for x in (*along, 0, 0, 0)) + "\n"
    (folder / "modes.f06").write_text(text)
    grids = [f"GRID,{node},,{node}.,0.,0.,4" for node in sorted({dof.node for dof in record.channels})]
    deck = ["CEND", "BEGIN BULK", "CORD2R,4,,0.,0.,0.,0.,0.,1.,", ",0.,1.,0.", *grids, "ENDDATA", ""]
    (folder / "frame.bdf").write_text("\n".join(deck))
    head, mark, tail = path.read_text(encoding="utf-8").replace("modes.json", "modes.f06").partition("[record.modes]")
    path.write_text(
        f"{head}{mark}\nfrequency_std = 0.1\nshape_std = 0.1\n{keys}{tail.partition(chr(10))[2]}", encoding="utf-8"
    )
    return path, record


def test_subcase_and_deck_of_a_listing_are_said_in_the_study(tmp_path):
    path, truth = as_listing(tmp_path, 'subcase = 2\ndeck = "frame.bdf"\n')
    record = load_study(path).setups[0].record.modes.load()
    assert record.frequency == pytest.approx([3 * truth.frequency[0]], rel=1e-6)
    assert record.source == "modes.f06; motions turned to global axes by frame.bdf"
    expected = {
        dof.unsigned: dof.sign * value for dof, value in zip(truth.channels, truth.mode_shapes[:, 0].real, strict=True)
    }
    own = {dof: row[0] for dof, row in zip(record.channels, record.mode_shapes, strict=True)}
    assert own.keys() == expected.keys()
    size = max(expected.values(), key=abs)
    assert [own[dof] for dof in expected] == pytest.approx([value / size for value in expected.values()], abs=2e-6)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("", r"path: .*modes\.f06: holds modes of 2 runs \(subcase 1; subcase 2\); choose with `subcase`"),
        ("subcase = 7\n", r"has no modes of subcase 7, only of subcase 1; subcase 2"),
        ('subcase = 1\ndeck = "none.bdf"\n', r"deck: .*none\.bdf: there is no such file"),
        ('subcase = 1\nlength_unit = "feet"\n', r"length_unit.* must be one of m km"),
    ],
)
def test_what_a_study_says_wrongly_of_a_listing_is_named(tmp_path, keys, words):
    path, _ = as_listing(tmp_path, keys)
    with pytest.raises(InputError, match=words):
        load_study(path).setups[0].record.modes.load()


def test_the_model_error_of_frfs_is_the_same_whichever_record_comes_first(tmp_path):
    head = CHAIN[: CHAIN.index("[[unknown]]")]
    head += '[[unknown]]\nproperty = "stiffness"\nelements = "ground"\n'
    head += '[[unknown]]\nproperty = "viscous_damping"\nelements = "damper"\n'
    of_modes = (
        '[[record]]\nname = "modes"\npath = "modes.json"\n[record.modes]\nfrequency_error = 0.05\nshape_error = 0.1\n'
    )
    of_modes += '[record.structure]\nwithout = ["damper"]\n'  # which is an unknown of the FRFs alone
    of_frfs = '[[record]]\nname = "frfs"\npath = "frf.npz"\n[record.noise]\nrelative = 0.001\n'
    stiffness = np.array([[2000.0, -1000.0, 0.0], [-1000.0, 2000.0, -1000.0], [0.0, -1000.0, 1000.0]])
    squares, shapes = linalg.eigh(stiffness, np.diag([2.0, 3.0, 1.0]))
    record = ModalRecord(np.sqrt(squares) / (2 * np.pi), [np.nan] * 3, shapes, ["1X", "2X", "3X"])
    parts = []
    for name, records in (("modes", of_modes + of_frfs), ("frfs", of_frfs + of_modes)):
        text = head + records + "[method]\nrestarts = 0\nuniqueness_starts = 0\n"
        path = write_chain(tmp_path / name, text, chain_record().lines(np.arange(20, 170, 5)))
        write_modes(path.parent / "modes.json", record)
        result = run_study(load_study(path))
        assert result.identification.estimate.covariance_basis == "model_error"
        write_results(result, path.parent)
        parts.append(stored_model_error(path.parent, result.study).part)
    assert parts[0].max() > 0.01
    np.testing.assert_allclose(parts[0], parts[1], rtol=1e-4, atol=1e-6)
