"""`structid compare`: two studies, two results folders, or one of each; what it writes and how it ends."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from typer.testing import CliRunner

import structid as sid
from structid.cli import app as cli
from structid.compare.options import CompareOptions
from structid.compare.states import carried, compare, stored_state, unchanged_parameters
from structid.core.errors import InputError
from structid.inversion.state_comparison import Comparison
from structid.report.comparison import comparison_table
from study_cases import chain_record, replaced, write_chain

RUN = CliRunner()
#: The damper known, so that the model is right and the estimates small.
COMPARED = replaced(
    "viscous_damping = 2.0",
    "viscous_damping = 3.0",
    replaced('[[unknown]]\nproperty = "viscous_damping"\nelements = "damper"\n', ""),
)


def weaker(seed, loss=0.1):
    """The chain with its upper spring at masses 2 and 3 weaker by `loss`, and as accurate a record."""
    like = chain_record(seed)
    masses = sid.PointMass("m", [1, 2, 3], [2.0, 3.0, 1.0])
    first, second = (["1X", "1X", "2X"], [None, "2X", "3X"])
    springs = [
        sid.Spring(f"s{i}", a, b, stiffness=k, loss_factor=0.02)
        for i, (a, b, k) in enumerate(zip(first, second, [1000.0, 1000.0, 1000.0 * (1 - loss)], strict=True))
    ]
    damper = sid.Dashpot("d", "1X", viscous_damping=3.0)
    structure = sid.Structure({1: 0.0, 2: 1.0, 3: 2.0}, [masses, *springs, damper], active=["X"])
    truth = sid.parameters(structure, [sid.Unknown("mass", "m")])
    return sid.simulated_record(structure, truth, like, 0.01, np.random.default_rng(seed))


@pytest.fixture
def states(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = write_chain(tmp_path / "before", COMPARED, chain_record(1))
    after = write_chain(tmp_path / "after", COMPARED, weaker(2))
    return before, after


def invoke(*arguments):
    return RUN.invoke(cli.app, [str(argument) for argument in arguments])


def test_two_studies_with_unchanged_masses_locate_the_weaker_spring(states, tmp_path):
    before, after = states
    done = invoke("compare", before, after, "--unchanged", "mass", "--png")
    assert (done.exit_code, done.stderr) == (0, "")
    folder = tmp_path / "chain_comparison"
    assert done.stdout.splitlines()[-1].endswith("compare.html")
    assert sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*.*")) == [
        "compare.html", "compare.json", "figures/changes.png", "figures/map.png"
    ]  # fmt: skip
    stored = json.loads((folder / "compare.json").read_text())
    rows = {row["name"]: row for row in stored["changes"]}
    assert [name for name, row in rows.items() if row["changed"]] == ["stiffness[upper:2]"]
    assert rows["stiffness[upper:2]"]["relative_change"] == pytest.approx(-0.1, abs=0.01)
    assert stored["basis"] == "joint"
    assert set(stored["unchanged"]) == {"mass[mass 1]", "mass[mass 2]", "mass[mass 3]"}
    assert stored["complete"] is True
    assert "changed (joint risk 5 %): stiffness[upper:2] (-10" in done.stdout
    page = (folder / "compare.html").read_text().split("<script")[0]
    assert "stiffness[upper:2]" in page
    assert "http" not in page.replace("http-equiv", "")


def test_small_changes_and_limits_are_not_shown_as_zero(states, tmp_path):
    found = compare(*states, CompareOptions(unchanged=("mass",)))
    told = found.comparison
    small = replace(told, after=told.before + 1e-4 * told.change, covariance=1e-8 * told.covariance)
    table = comparison_table(replace(found, comparison=small))
    for row in table.rows:
        shown = [row[table.header.index(name)] for name in ("Change", "Std", "Detection limit")]
        assert all(re.search("[1-9]", cell) for cell in shown), row


def test_folders_give_what_the_studies_give(states, tmp_path):
    before, after = states
    for study, name in ((before, "one"), (after, "two")):
        assert invoke("identify", study, "--no-report", "--out", tmp_path / name).exit_code == 0
    folders = compare(tmp_path / "one", tmp_path / "two", CompareOptions(level=0.01))
    studies = compare(before, after, CompareOptions(level=0.01))
    assert folders.basis == studies.basis == "independent"
    assert folders.comparison.names == studies.comparison.names
    assert folders.comparison.p_values == pytest.approx(studies.comparison.p_values, rel=1e-3, abs=1e-12)
    assert folders.baseline.drawn is not None
    mixed = compare(tmp_path / "one", after, CompareOptions(unchanged=["mass"]))
    joint = compare(before, after, CompareOptions(unchanged=["mass[*]"]))
    assert (mixed.basis, joint.basis) == ("carried", "joint")
    assert [c.name for c in mixed.later.result.identification.problem.parameters.couplings] == ["baseline"]
    assert joint.later.result.identification.problem.parameters.couplings == ()
    assert mixed.comparison.relative_change == pytest.approx(joint.comparison.relative_change, abs=2e-3)
    assert mixed.comparison.std == pytest.approx(joint.comparison.std, rel=0.05)
    place = studies.comparison.names.index("stiffness[upper:2]")
    assert joint.comparison.std[1] < studies.comparison.std[place]


def test_what_changed_cannot_be_named_as_unchanged(states, tmp_path):
    """The spring that lost a tenth, held the same: chi-square of both states is far above the sum of each, which ends in words."""
    before, after = states
    done = invoke("compare", before, after, "--unchanged", "stiffness", "--no-report", "--out", tmp_path / "frozen")
    assert done.exit_code == 3
    assert (
        "the data contradict that stiffness[ground], stiffness[upper:1], stiffness[upper:2] did not change"
        in done.stdout
    )
    assert "What changed was named as unchanged: stiffness[upper:2] (-10 %" in done.stdout
    assert "no parameter changed" not in done.stdout
    stored = json.loads((tmp_path / "frozen" / "compare.json").read_text())
    test = stored["unchanged_test"]
    assert test["contradicted"] is True
    assert test["chi_square"] > test["chi_square_separate"] + 100
    assert invoke("identify", before, "--no-report", "--out", tmp_path / "one").exit_code == 0
    carried = compare(tmp_path / "one", after, CompareOptions(unchanged="stiffness"))
    assert carried.basis == "carried"
    assert carried.is_contradicted


def test_what_did_not_change_is_allowed(states):
    test = compare(*states, CompareOptions(unchanged=("mass",))).unchanged
    assert not test.is_contradicted
    assert 1e-3 < test.probability <= 1
    assert test.words.startswith("the data allow that mass[mass 1], mass[mass 2], mass[mass 3] did not change")


def test_changes_stand_by_their_size_and_less_than_the_least_is_not_declared(states):
    every = compare(*states, CompareOptions(level=0.49, correction="benjamini_hochberg")).comparison
    size = np.abs(every.relative_change)[every.order]
    declared = int(every.changed.sum())
    assert (np.diff(size[:declared]) <= 0).all()
    assert (np.diff(size[declared:]) <= 0).all()
    assert every.changed[every.order][:declared].all()
    found = compare(*states, CompareOptions(unchanged="mass", least="5 %")).comparison
    assert [n for n, c in zip(found.names, found.changed, strict=True) if c] == ["stiffness[upper:2]"]
    assert "changed by more than 5 % (joint risk" in found.words
    assert not replace(found, least=0.15).changed.any()
    assert (replace(found, least=0.15).relative_detection_limit > 0.15).all()


def test_p_value_of_a_least_change_is_that_of_the_nearest_change_allowed():
    """d = 3, s = 1, least 2: the chance of a distance of 3 or more from 0, the truth at 2: P(N > 1) + P(N < -5)."""
    found = Comparison(
        names=("k",), kinds=("stiffness",), units=("N/m",), before=np.array([100.0]), after=np.array([103.0]),
        covariance_before=np.array([[0.5]]), covariance_after=np.array([[0.5]]), carried=(), only_before=(), only_after=(),
        covariance=np.array([[1.0]]), level=0.05, power=0.9, correction="holm", status=sid.Status.CONVERGED,
    )  # fmt: skip
    least = replace(found, least=0.02)
    assert least.p_values == pytest.approx([1 - stats.norm.cdf(1) + stats.norm.cdf(-5)], rel=1e-12)
    assert found.p_values == pytest.approx([2 * stats.norm.cdf(-3)], rel=1e-12)


@pytest.mark.parametrize(("given", "part"), [(0.01, 0.01), ("1 %", 0.01), ("1%", 0.01), ("0.02", 0.02), (0, 0.0)])
def test_the_least_change_is_a_part_or_in_per_cent(given, part):
    assert CompareOptions(least=given).least == pytest.approx(part)


@pytest.mark.parametrize("given", ["a little", "-1 %", 1.0, "200%"])
def test_a_least_change_that_is_none_is_refused(given):
    with pytest.raises(InputError, match="`least` must be at least 0 and below 1"):
        CompareOptions(least=given)


def test_the_same_record_twice_is_no_change_and_says_so(states, tmp_path):
    before, _ = states
    again = write_chain(tmp_path / "again", COMPARED, chain_record(1))
    done = invoke(
        "compare", before, again, "--no-report", "--out", tmp_path / "none", "--correction", "benjamini_hochberg"
    )
    assert done.exit_code == 0
    assert "no parameter changed (false discovery rate 5 %)" in done.stdout
    assert "both states read the same frf.npz" in done.stdout
    assert [p.name for p in (tmp_path / "none").iterdir()] == ["compare.json"]


def test_parameters_of_one_state_only_are_named(states, tmp_path):
    before, _ = states
    fixed = COMPARED.replace('elements = "mass 1"\n', 'elements = "mass 1"\nfixed = true\nstart = 2.0\n')
    found = compare(before, write_chain(tmp_path / "fixed", fixed, weaker(3)))
    assert found.comparison.only_before == ("mass[mass 1]",)
    assert any("mass[mass 1]: identified in the baseline only" in w for w in found.warnings)


def test_a_state_held_by_regularization_says_what_its_tests_are_worth(states, tmp_path):
    before, _ = states
    term = '[[regularization]]\nkind = "sparsity"\nproperty = "stiffness"\nelements = "upper"\n[record]'
    assert invoke("identify", before, "--no-report", "--out", tmp_path / "one").exit_code == 0
    held = write_chain(tmp_path / "held", replaced("[record]", term, COMPARED), weaker(3))
    assert invoke("identify", held, "--no-report", "--out", tmp_path / "two").exit_code == 0
    found = compare(tmp_path / "one", tmp_path / "two")
    assert found.later.regularizations == ("sparsity of stiffness[upper]",)
    assert any(w.startswith("sparsity of stiffness[upper]: standard deviations") for w in found.warnings)


def test_a_state_that_is_not_determined_ends_with_1_and_results(states, tmp_path):
    before, _ = states
    noisy = replaced("relative = 0.01", "absolute = 1000.0", COMPARED)
    done = invoke("compare", before, write_chain(tmp_path / "noisy", noisy, weaker(4)), "--out", tmp_path / "out")
    assert done.exit_code == 1
    assert "do not determine every change" in done.stderr
    stored = json.loads((tmp_path / "out" / "compare.json").read_text())
    assert (stored["status"], stored["complete"]) == ("not_identifiable", False)
    assert not any(row["changed"] for row in stored["changes"])
    assert "later state:" in done.stdout


def test_a_state_whose_model_is_wrong_ends_with_3_and_its_verdict(states, tmp_path):
    """One sensor is turned round: whatever its values are, they are no change of the structure."""
    before, _ = states
    turned = replaced("[record]\n", '[record]\nrelabel = {"1X" = "1X-"}\n', COMPARED)
    wrong = write_chain(tmp_path / "wrong", turned, chain_record(1))
    done = invoke("compare", before, wrong, "--no-report", "--out", tmp_path / "out")
    assert done.exit_code == 3
    assert "the answer of the later state is not sound" in done.stdout
    assert "Wrong model: " in done.stdout
    assert "what is declared changed is no finding" in done.stderr
    assert (tmp_path / "out" / "compare.json").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["{before}", "{after}", "--unchanged", "masss"], "must name parameters that both states identify"),
        (["{before}", "{after}", "--level", "2"], "--level must lie between"),
        (["{before}", "{after}", "--correction", "none"], "--correction must be"),
        (["{before}", "nowhere.toml"], "there is no such file"),
        (["{folder}", "{after}"], "holds no estimate.json"),
        (["{before}", "{folder}", "--unchanged", "mass"], "later state as a study file"),
    ],
)
def test_unusable_input_ends_with_2_and_nothing_written(states, tmp_path, arguments, words):
    before, after = states
    places = {"before": before, "after": after, "folder": before.parent}
    done = invoke("compare", *(a.format(**places) for a in arguments))
    assert done.exit_code == 2
    assert words in done.stderr
    assert not (tmp_path / "chain_comparison").exists()


def test_a_broken_results_folder_is_refused(states, tmp_path):
    before, _ = states
    invoke("identify", before, "--no-report", "--out", tmp_path / "one")
    (tmp_path / "one" / "estimate.h5").write_bytes(b"no HDF5")
    with pytest.raises(sid.InputError, match=r"estimate\.h5: is damaged, cut short or not HDF5"):
        stored_state(tmp_path / "one")


def test_carried_parameters_start_at_the_baseline_with_its_covariance():
    masses = sid.PointMass("m", [1, 2], [2.0, 3.0])
    spring = sid.Spring("s", "1X", "2X", stiffness=5.0)
    structure = sid.Structure({1: 0.0, 2: 1.0}, [masses, spring, sid.Spring("g", "1X", stiffness=4.0)], active=["X"])
    unknown = sid.parameters(structure, [sid.Unknown("mass", "m", each=True), sid.Unknown("stiffness", "g")])
    record = sid.FrfRecord(np.linspace(0.05, 1, 30), np.ones((30, 2, 1)), ("1X", "2X"), ("2X",), "accelerance")
    noisy = sid.simulated_record(structure, unknown, record, 0.05, np.random.default_rng(0))
    baseline = sid.estimate(sid.FrfProblem(structure, unknown, noisy))
    names = unchanged_parameters(baseline, unknown, ["mass"])
    assert names == ("mass[m:1]", "mass[m:2]")
    made = carried(baseline, unknown, names)
    assert made.start == pytest.approx(baseline.values)
    _, rows = made.prior_rows(made.start)
    information = rows.T @ rows
    assert information[:2, :2] == pytest.approx(np.linalg.inv(baseline.covariance[:2, :2]), rel=1e-8)
    assert (information[2] == 0).all()
    residual, _ = made.prior_rows(made.start * np.exp([0.1, 0.0, 0.0]))
    assert residual == pytest.approx(0.1 * baseline.values[0] * rows[:, 0], rel=1e-8)  # straight in the logarithm
    assert not carried(baseline, unknown, ()).has_priors
