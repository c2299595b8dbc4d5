"""Beams are divided until the mesh moves no value by much of its deviation, and what is left is said."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

import structid as sid
from structid.cli import app as cli
from structid.compare.correlation import correlate
from structid.compare.states import compare
from structid.core.dof import parse_dofs
from structid.identification.mesh_pieces import MESH_WARNINGS, MeshPieces, judge_pieces, undivided_words
from structid.identification.options import IdentifyOptions
from structid.records.formats import write_record
from structid.study.results.stored_model import stored_model, stored_study
from structid.study.run import run as study_run
from structid.study.run.check import check_study
from structid.study.run.long_run import Checkpoint, LongRun, fingerprint
from structid.study.run.run import run_study
from structid.study.run.start import load_setups, with_pieces
from structid.study.schema.study import load_study
from structid.unknowns.tolerances import EXACT

LENGTH, MASS, BENDING, HOLD = 2.0, 3.0, 450.0, 9e3

STUDY = """\
title = "Cantilever on a soft clamp"
[structure]
subdivide = "auto"
fixed = ["0Y"]
tolerance = 0
[structure.nodes]
0 = 0.0
1 = 1.0
2 = 2.0
[[structure.beam]]
name = "beam"
nodes = [[0, 1], [1, 2]]
mass = 3.0
bending_stiffness = 400.0
loss_factor = 0.01
[[structure.spring]]
name = "clamp"
first = "0RZ"
stiffness = 8e3
[[unknown]]
property = "bending_stiffness"
elements = "beam"
[[unknown]]
property = "stiffness"
elements = "clamp"
[record]
path = "frf.npz"
calibration = 0
[record.noise]
relative = 0.05
[method]
band = [1.0, 60.0]
"""


def cantilever(bending, hold, pieces):
    beam = sid.Beam("beam", [[0, 1], [1, 2]], MASS, bending, loss_factor=0.01)
    clamp = sid.Spring("clamp", "0RZ", stiffness=hold)
    return sid.Structure({0: 0.0, 1: 1.0, 2: LENGTH}, [beam, clamp], ["0Y"], subdivide=pieces)


@pytest.fixture(scope="module")
def record():
    """Of a beam whose mesh is finer than what is chosen, 5 % noise."""
    truth = cantilever(BENDING, HOLD, 64)
    lines = np.arange(1.0, 60.0, 0.5)
    like = sid.FrfRecord(lines, np.ones((len(lines), 2, 1)), ("1Y", "2Y"), ("2Y",), "accelerance")
    return sid.simulated_record(truth, sid.parameters(truth, []), like, 0.05, np.random.default_rng(3))


def written(folder, record, text=STUDY):
    write_record(folder / "frf.npz", record)
    (folder / "study.toml").write_text(text, encoding="utf-8")
    return folder / "study.toml"


def test_the_mesh_is_cut_until_it_moves_no_value_by_a_fifth_of_its_deviation(tmp_path, record):
    found = run_study(load_study(written(tmp_path, record))).identification
    assert found.structure.subdivide == 16
    assert found.mesh == (
        "each element of beam was divided into 16 equal pieces, which moved values by more than 100 standard deviations"
        " (bending_stiffness[beam]); `subdivide = 1` in [structure] keeps the mesh as drawn"
    )
    assert found.warnings == ()
    np.testing.assert_array_equal(found.estimate.initial, [400.0, 8e3])
    as_default = run_study(load_study(written(tmp_path, record, STUDY.replace('subdivide = "auto"\n', ""))))
    np.testing.assert_array_equal(as_default.identification.estimate.values, found.estimate.values)
    np.testing.assert_array_less(np.abs(found.estimate.values - [BENDING, HOLD]), 3 * found.estimate.std_noise)
    coarse = written(tmp_path, record, STUDY.replace('"auto"', "1"))
    whole = run_study(load_study(coarse)).identification
    assert (np.abs(whole.estimate.values - [BENDING, HOLD]) > 3 * whole.estimate.std_noise).any()
    assert whole.mesh == ""
    assert whole.warnings[0].startswith("the mesh moves bending_stiffness[beam] by more than 100, stiffness[clamp] by ")
    assert 'so do not rely on these intervals: write `subdivide = "auto"`, or ' in whole.warnings[0]
    assert not MeshPieces(4, 0.19, "a").warning


def test_a_check_divides_beams_by_the_modes_in_the_band(tmp_path, record):
    """Its figures are those of a study that states as many pieces; the digits of one that states 1 stay its own."""
    found = check_study(load_study(written(tmp_path, record)))
    pieces = found.study.structure.subdivide
    assert pieces > 1
    assert found.division.startswith(f"each element of beams and bars in {pieces} pieces for this check")
    stated, drawn = (
        check_study(load_study(written(tmp_path, record, STUDY.replace('"auto"', count))))
        for count in (str(pieces), "1")
    )
    np.testing.assert_array_equal(found.std, stated.std)
    assert found.mesh.words == stated.mesh.words == stated.division == drawn.division == ""
    assert np.abs(drawn.std / found.std - 1).max() > 0.01


def test_modes_that_the_drawn_elements_lack_are_told_with_the_pieces_that_have_them(tmp_path, record):
    single = sid.FrfRecord(record.frequency, record.values[:, 1:], ("2Y",), ("2Y",), "accelerance")
    text = STUDY.replace("1 = 1.0\n", "").replace("[[0, 1], [1, 2]]", "[[0, 2]]")
    found = check_study(load_study(written(tmp_path, single, text)))
    pieces = found.study.structure.subdivide
    assert pieces > 1
    assert found.warnings[0].startswith("with smaller elements the model has modes at ")
    assert found.warnings[0].endswith(f"; `subdivide = {pieces}` in [structure] starts the search with them")
    stated = check_study(load_study(written(tmp_path, single, text.replace('"auto"', str(pieces)))))
    assert not any("smaller elements" in words for words in stated.warnings)


def test_a_check_takes_as_many_pieces_as_an_identification_may_and_warns_where_they_are_too_few(tmp_path, record):
    """One element, band to 1600 Hz: 32 pieces, the most, leave mode 17 too high."""
    lines = np.arange(1.0, 1600.0, 4.0)
    single = sid.FrfRecord(lines, np.ones((len(lines), 1, 1), complex), ("2Y",), ("2Y",), "accelerance")
    text = STUDY.replace("1 = 1.0\n", "").replace("[[0, 1], [1, 2]]", "[[0, 2]]").replace("60.0]", "1600.0]")
    found = check_study(load_study(written(tmp_path, single, text)))
    assert found.study.structure.subdivide == 32
    mesh = found.mesh.words
    assert mesh.startswith("the mesh is too coarse: mode ")
    assert found.warnings[0].endswith(f"`subdivide = 32` in [structure] starts the search with them; {mesh}")


def test_a_search_without_the_modes_of_the_band_is_begun_anew_with_the_pieces_that_have_them(
    tmp_path, record, monkeypatch
):
    """The second search has the pieces of a check, and the starts of the study instead of what the first one found."""
    tried = []
    run_prepared = study_run.run_prepared

    def run(ready, progress=None, work=None, near=None):
        tried.append((ready.setups[0].structure.subdivide, dict(near or {})))
        return run_prepared(ready, progress, work, near)

    monkeypatch.setattr(study_run, "run_prepared", run)
    single = sid.FrfRecord(record.frequency, record.values[:, 1:], ("2Y",), ("2Y",), "accelerance")
    text = STUDY.replace("1 = 1.0\n", "").replace("[[0, 1], [1, 2]]", "[[0, 2]]")
    study = load_study(written(tmp_path, single, text))
    estimate = run_study(study).identification.estimate
    assert tried[:2] == [(1, {}), (check_study(study).study.structure.subdivide, {})]
    np.testing.assert_array_less(np.abs(estimate.values - [BENDING, HOLD]), 3 * estimate.std)


@pytest.mark.parametrize(("pieces", "tolerances"), [(8, EXACT), (3, None)])
def test_the_shift_that_is_said_is_what_a_finer_mesh_does_to_the_answer(record, pieces, tolerances):
    """Two identifications of one record, one with twice the pieces: values apart by what the first says of itself.

    With three pieces the values move by many widths of a resonance, and one linear step says a quarter less.
    """
    structures = [cantilever(400.0, 8e3, count) for count in (pieces, 2 * pieces)]
    unknown = [sid.Unknown("bending_stiffness", "beam"), sid.Unknown("stiffness", "clamp")]
    setups = [sid.Setup(made, sid.parameters(made, unknown), record) for made in structures]
    options = IdentifyOptions(band=(1.0, 60.0), **({} if tolerances is None else {"tolerances": tolerances}))
    found = [sid.identify_together([setup], options) for setup in setups]
    coarse, fine = (one.estimate for one in found)
    mesh = judge_pieces(setups[:1], found[0], options, pieces)
    fixed = 0.0 if coarse.fixed is None else coarse.fixed.std
    moved = np.abs(fine.values - coarse.values) / np.hypot(coarse.std_noise, fixed)
    assert mesh.moved == pytest.approx(moved.max(), rel=0.1)
    assert mesh.needed > pieces


def test_the_mesh_of_a_model_that_is_wrong_on_any_mesh_is_judged_by_the_deviations_that_its_misfit_gives(record):
    """A mass is missing: pieces that noise alone would ask for move no value by much of the error that the model makes.

    On a coarse mesh, which is a part of the misfit, the shifts are counted in deviations from noise.
    """
    beam = sid.Beam("beam", [[0, 1], [1, 2]], MASS, BENDING, loss_factor=0.01)
    clamp, crate = sid.Spring("clamp", "0RZ", stiffness=HOLD), sid.PointMass("crate", [1], 1.0)
    truth = sid.Structure({0: 0.0, 1: 1.0, 2: LENGTH}, [beam, clamp, crate], ["0Y"], subdivide=64)
    heavy = sid.simulated_record(truth, sid.parameters(truth, []), record, 0.005, np.random.default_rng(3))
    unknown = [sid.Unknown("bending_stiffness", "beam"), sid.Unknown("stiffness", "clamp")]
    options = IdentifyOptions(band=(1.0, 60.0), tolerances=EXACT)
    in_noise, judged = {}, {}
    for pieces in (1, 8):
        structure = cantilever(400.0, 8e3, pieces)
        setup = sid.Setup(structure, sid.parameters(structure, unknown), heavy)
        found = sid.identify_together([setup], options)
        judged[pieces] = judge_pieces([setup], found, options, pieces)
        quiet = replace(found.estimate, goodness=replace(found.estimate.goodness, chi_square=1.0, least_chi_square=1.0))
        in_noise[pieces] = judge_pieces([setup], replace(found, estimate=quiet), options, pieces)
    assert in_noise[8].moved > 0.2 > judged[8].moved
    assert judged[1].moved == in_noise[1].moved > 0.2


@pytest.mark.parametrize(
    ("drawn", "noise", "fault", "makes_misfit"),
    [(7, 0.01, "", True), (7, 0.02, "crate", False), (8, 0.01, "stiffer", False)],
)
def test_finer_pieces_are_chosen_where_they_take_most_of_a_misfit(record, drawn, noise, fault, makes_misfit):
    """The mesh moves no loss factor. Pieces stay where a mass of 5 g is missing, and where a record fits the drawn ones."""
    crate = [sid.PointMass("crate", [1], 0.005)] if fault == "crate" else []
    bending, pieces = (BENDING * (1 + 2.5e-4), drawn) if fault == "stiffer" else (BENDING, 64)
    fine = cantilever(bending, HOLD, pieces)
    truth = sid.Structure(fine.nodes, [*fine.elements, *crate], ["0Y"], subdivide=pieces)
    measured = sid.simulated_record(truth, sid.parameters(truth, []), record, noise, np.random.default_rng(3))
    options = IdentifyOptions(band=(1.0, 60.0), tolerances=EXACT)

    def identified(count):
        structure = cantilever(BENDING, HOLD, count)
        setup = sid.Setup(structure, sid.parameters(structure, [sid.Unknown("loss_factor", "beam")]), measured)
        return setup, sid.identify_together([setup], options)

    setup, found = identified(drawn)
    mesh = judge_pieces([setup], found, options, drawn)
    assert mesh.moved < 0.2
    assert mesh.makes_misfit is makes_misfit
    assert mesh.is_enough is not makes_misfit
    before, after = (one.estimate.goodness for one in (found, identified(drawn + drawn // 2)[1]))
    beyond = before.chi_square * (1 - 1 / before.misfit)
    assert (before.chi_square - after.chi_square > 0.5 * beyond) is makes_misfit
    if makes_misfit:
        assert mesh.needed == drawn + drawn // 2
        assert mesh.warning.startswith("the mesh makes a misfit beyond noise, though it moves no value: write ")


def test_no_more_than_32_pieces_are_wanted():
    assert MeshPieces(24, 0.1, makes_misfit=True).needed == 32


def test_the_console_and_the_results_say_what_was_chosen(tmp_path, record):
    study = written(tmp_path, record)
    done = CliRunner().invoke(cli.app, ["identify", str(study), "--out", str(tmp_path / "out")])
    assert done.exit_code == 0
    assert "each element of beam was divided into 16 equal pieces" in done.output
    result = json.loads((tmp_path / "out" / "estimate.json").read_text(encoding="utf-8"))
    assert "was divided into 16 equal pieces" in result["assumption"]
    assert "was divided into 16 equal pieces" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    source = stored_study(tmp_path / "out")
    correlated = correlate(load_study(study), at=tmp_path / "out")
    assert correlated.study.structure.subdivide == source.structure.subdivide > 1
    np.testing.assert_allclose(correlated.responses[0].frac, 1.0, atol=0.01)
    predicted = sid.predict(stored_model(tmp_path / "out", source), sid.NaturalModes(3), n_draws=50)
    np.testing.assert_allclose(
        predicted.values[:, 0], [mode["frequency_hz"] for mode in result["modes"][:3]], rtol=1e-9
    )


def test_pieces_change_no_start_and_no_prior_that_a_study_was_given(tmp_path, record):
    """As by a comparison, whose later state begins with the baseline's answer as prior."""
    study = load_study(written(tmp_path, record))
    setups = load_setups(study)
    (source,) = study.setups
    begun = sid.parameters(
        source.structure,
        [
            sid.Unknown("bending_stiffness", "beam", start=555.0, prior=sid.Prior(555.0, 5.0)),
            sid.Unknown("stiffness", "clamp"),
        ],
    )
    cut, _ = with_pieces(replace(study, setups=(replace(source, parameters=begun),)), setups, 5)
    assert cut.structure.subdivide == 5
    np.testing.assert_array_equal(cut.parameters.start, begun.start)
    assert cut.parameters.has_priors


def test_a_comparison_tells_of_both_states_what_the_mesh_moves(tmp_path, record):
    """One state is run, the other read from its results folder; both carry the sentence of their identification."""
    run, cut = CliRunner(), written(tmp_path, record, STUDY.replace('"auto"', "1"))
    stored = tmp_path / "stored"
    run.invoke(cli.app, ["identify", str(cut), "--out", str(stored), "--no-report", "--no-explain"])
    run.invoke(cli.app, ["compare", str(cut), str(stored), "--out", str(tmp_path / "compared"), "--no-report"])
    words = json.loads((stored / "estimate.json").read_text(encoding="utf-8"))["warnings"][0]
    assert words.startswith("the mesh moves ")
    warnings = json.loads((tmp_path / "compared" / "compare.json").read_text(encoding="utf-8"))["warnings"]
    assert [one for one in warnings if "mesh" in one.partition(":")[2][:20]] == [
        f"baseline: {words}", f"later state: {words}"
    ]  # fmt: skip


def test_a_mesh_that_moves_no_value_leaves_the_answer_as_it_is(tmp_path, record):
    """Of a study with 32 elements, digits and words are those with `subdivide = 1`."""
    nodes = "\n".join(f"{i} = {i / 16}" for i in range(33))
    pairs = str([[i, i + 1] for i in range(32)])
    fine = STUDY.replace("0 = 0.0\n1 = 1.0\n2 = 2.0", nodes).replace("[[0, 1], [1, 2]]", pairs)
    own = replace(record, outputs=parse_dofs(["16Y", "32Y"]), inputs=parse_dofs(["32Y"]))
    found, kept = (
        run_study(load_study(written(tmp_path, own, fine.replace('"auto"', word)))).identification
        for word in ('"auto"', "1")
    )
    assert found.structure.subdivide == 1
    np.testing.assert_array_equal(found.estimate.values, kept.estimate.values)
    assert (found.mesh, found.assumption, found.warnings) == (kept.mesh, kept.assumption, kept.warnings)


def test_a_record_that_only_the_drawn_elements_fit_keeps_them(tmp_path, record):
    coarse = cantilever(BENDING, HOLD, 1)
    simulated = sid.simulated_record(coarse, sid.parameters(coarse, []), record, 0.05, np.random.default_rng(3))
    kept = run_study(load_study(written(tmp_path, simulated))).identification
    stated = run_study(load_study(written(tmp_path, simulated, STUDY.replace('"auto"', "1")))).identification
    assert kept.structure.subdivide == 1
    np.testing.assert_array_equal(kept.estimate.values, stated.estimate.values)
    assert kept.mesh.startswith("the record fits the elements of ")
    assert " as drawn (chi-square 1.0 times what is expected) and not divided into 2 pieces (" in kept.mesh
    assert not any(words.startswith(MESH_WARNINGS) for words in kept.warnings)


def test_halves_tell_of_a_record_that_only_the_drawn_elements_fit(tmp_path, record, monkeypatch):
    """Where very many pieces would be asked for, two of them are enough to see that none fit, and no more are tried.

    Their fit alone is looked at, not their intervals.
    """
    tried: list[int] = []
    options: list[IdentifyOptions] = []
    identify_all = study_run.identify_together
    monkeypatch.setattr(study_run, "identify_together", lambda *args: options.append(args[1]) or identify_all(*args))
    monkeypatch.setattr(
        study_run, "judge_pieces", lambda *args: replace(judge_pieces(*args), moved=1e5, finer_minimum={"": 0.0})
    )
    monkeypatch.setattr(study_run, "with_pieces", lambda *args: tried.append(args[-1]) or with_pieces(*args))
    coarse = cantilever(BENDING, HOLD, 1)
    simulated = sid.simulated_record(coarse, sid.parameters(coarse, []), record, 0.05, np.random.default_rng(3))
    study = load_study(written(tmp_path, simulated))
    asked = replace(study, options=replace(study.options, intervals="profile", uniqueness_starts=1))
    kept = run_study(asked).identification
    assert tried == [2]
    assert [(used.intervals, used.uniqueness_starts, used.restarts) for used in options] == [
        ("profile", 1, study.options.restarts), ("laplace", 0, study.options.restarts)
    ]  # fmt: skip
    assert " and not divided into 2 pieces (" in kept.mesh
    assert kept.mesh.endswith("`subdivide = 32` in [structure] divides them")
    assert kept.structure.subdivide == 1


def test_pieces_that_are_needed_are_tried_where_halves_cannot_be_identified(tmp_path, record, monkeypatch):
    tried: list[int] = []

    def run(ready, *args):
        tried.append(ready.setups[0].structure.subdivide)
        if tried[-1] == 2:
            raise study_run.SearchFailedError("singular with two pieces")
        return run_prepared(ready, *args)

    run_prepared = study_run.run_prepared
    monkeypatch.setattr(study_run, "run_prepared", run)
    monkeypatch.setattr(
        study_run, "judge_pieces", lambda *args: replace(judge_pieces(*args), moved=20.0, finer_minimum={"": 0.0})
    )
    coarse = cantilever(BENDING, HOLD, 1)
    simulated = sid.simulated_record(coarse, sid.parameters(coarse, []), record, 0.05, np.random.default_rng(3))
    kept = run_study(load_study(written(tmp_path, simulated))).identification
    assert tried == [1, 2, 4]
    assert " and not divided into 4 pieces (" in kept.mesh
    assert not any("cannot be identified" in words for words in kept.warnings)


def test_two_states_of_a_comparison_have_as_many_pieces(tmp_path, record):
    """The later state alone would be divided into fewer: of its narrow band the mesh moves less."""
    narrow = STUDY.replace("[1.0, 60.0]", "[1.0, 12.0]")
    for name, text in (("wide", STUDY), ("narrow", narrow)):
        (tmp_path / name).mkdir()
        written(tmp_path / name, record, text)
    alone = run_study(load_study(tmp_path / "narrow" / "study.toml")).identification
    compared = compare(tmp_path / "wide" / "study.toml", tmp_path / "narrow" / "study.toml")
    assert "which moved values by up to " in alone.mesh
    assert alone.structure.subdivide < compared.baseline.pieces == compared.later.pieces == 16
    assert not any("beams are of" in words for words in compared.warnings)


@pytest.mark.long
@pytest.mark.parametrize(
    ("rig", "kind", "drawn"),
    [("cantilever", "frf", 2.0), ("bridge", "frf", 2.0), ("cantilever", "histories", 5.0), ("bridge", "modes", 0.0)],
)
def test_values_from_long_elements_are_those_of_continuous_beams(tmp_path, rig, kind, drawn):
    """Of two elements a span, against responses by exact dynamic stiffnesses; `drawn` is the least error as drawn."""
    from benchmarks.accuracy.mesh_pieces import errors_of

    assert np.abs(errors_of(rig, kind, "", 3, False, tmp_path)).max() < 4
    assert np.abs(errors_of(rig, kind, "subdivide = 1", 1, False, tmp_path)).max() > drawn


def test_an_identification_stopped_on_the_finer_mesh_resumes_to_the_same_bits(tmp_path, record):
    study, calls = load_study(written(tmp_path, record)), []
    whole = run_study(study, lambda *words: calls.append(words)).identification

    def stop(*words):
        calls.pop()
        if len(calls) < 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(study, stop, LongRun(checkpoint=Checkpoint(tmp_path / "c", fingerprint(study), seconds=0.0)))
    kept = Checkpoint(tmp_path / "c", fingerprint(study), resume=True, seconds=0.0)
    again = run_study(study, lambda *words: calls.append(words), LongRun(checkpoint=kept)).identification
    assert len(calls) < 5  # nothing that was done is done again
    np.testing.assert_array_equal(again.estimate.values, whole.estimate.values)
    np.testing.assert_array_equal(again.estimate.covariance, whole.estimate.covariance)
    assert (again.mesh, again.structure.subdivide) == (whole.mesh, 16)


def test_elements_that_cannot_be_divided_are_named():
    """Bars of a truss, whose pieces nothing would hold sideways."""
    bars = sid.Bar("bar", [[1, 2]], 1.0, 1e6)
    truss = sid.Structure({1: [0.0, 0.0], 2: [1.0, 0.0]}, [bars, sid.Spring("side", "2Y", stiffness=1e4)], ["1X", "1Y"])
    like = sid.FrfRecord(np.arange(1.0, 9.0), np.ones((8, 1, 1)), ("2Y",), ("2Y",), "accelerance")
    words = undivided_words([sid.Setup(truss, sid.parameters(truss, []), like)])
    assert words == "± takes the mesh of bar as it is: only beams are divided"


def test_what_keeps_the_mesh_from_being_judged_is_said(tmp_path, record, monkeypatch):
    monkeypatch.setattr("structid.identification.mesh_pieces.MOST_DOFS", 5)
    found = run_study(load_study(written(tmp_path, record))).identification
    assert found.structure.subdivide == 1
    assert found.warnings[0] == (
        "what the mesh moves the values by is not known: with pieces half as long the model has more than 5 degrees of freedom"
    )


@pytest.mark.parametrize("wrong", ['"fine"', "0", "true"])
def test_other_words_than_auto_are_refused(tmp_path, record, wrong):
    study = written(tmp_path, record, STUDY.replace('"auto"', wrong))
    with pytest.raises(
        sid.InputError, match='subdivide: must be a whole number of at least 1 and at most 100, or "auto"'
    ):
        load_study(study)
