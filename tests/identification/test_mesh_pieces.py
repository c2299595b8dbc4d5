"""`subdivide = "auto"`: beams are cut until the mesh moves no value by much of its deviation, and what is left is said."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

import structid as sid
from structid.cli import app as cli
from structid.compare.correlation import correlate
from structid.identification.mesh_pieces import MeshPieces, judge_pieces
from structid.identification.options import IdentifyOptions
from structid.records.formats import write_record
from structid.study.results.stored_model import stored_model, stored_study
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
    count = found.structure.subdivide
    assert 8 < count <= 20
    assert f"beams are cut into {count} pieces: the mesh moves no value by more than 0." in found.assumption
    assert found.warnings == ()
    np.testing.assert_array_less(np.abs(found.estimate.values - [BENDING, HOLD]), 3 * found.estimate.std_noise)
    coarse = written(tmp_path, record, STUDY.replace('"auto"', "1"))
    whole = run_study(load_study(coarse)).identification
    assert (np.abs(whole.estimate.values - [BENDING, HOLD]) > 3 * whole.estimate.std_noise).any()
    assert whole.mesh == ""
    assert whole.warnings[0].startswith("the mesh moves ")
    assert 'so do not rely on these intervals: write `subdivide = "auto"`, or ' in whole.warnings[0]
    assert not MeshPieces(4, 0.19, "a").warning


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


def test_the_console_and_the_results_say_what_was_chosen(tmp_path, record):
    study = written(tmp_path, record)
    done = CliRunner().invoke(
        cli.app, ["identify", str(study), "--out", str(tmp_path / "out"), "--no-report", "--verbose"]
    )
    assert done.exit_code == 0
    assert "the mesh moves no value by more than 0." in done.output
    result = json.loads((tmp_path / "out" / "estimate.json").read_text(encoding="utf-8"))
    assert "the mesh moves no value by more than 0." in result["assumption"]
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
    study, setups, _ = load_setups(load_study(written(tmp_path, record)))
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


def test_where_nothing_can_be_cut_it_is_said(tmp_path):
    """Bars of a truss, whose pieces nothing would hold sideways."""
    bars = sid.Bar("bar", [[1, 2]], 1.0, 1e6)
    truss = sid.Structure({1: [0.0, 0.0], 2: [1.0, 0.0]}, [bars, sid.Spring("side", "2Y", stiffness=1e4)], ["1X", "1Y"])
    lines = np.arange(1.0, 60.0)
    like = sid.FrfRecord(lines, np.ones((len(lines), 1, 1)), ("2Y",), ("2Y",), "accelerance")
    unknown = sid.parameters(truss, [sid.Unknown("stiffness", "side")])
    simulated = sid.simulated_record(truss, unknown, like, 0.01, np.random.default_rng(1))
    setup = sid.Setup(truss, unknown, simulated)
    mesh = judge_pieces([setup], sid.identify_together([setup]), IdentifyOptions(), 1)
    assert not mesh.is_enough
    assert mesh.words == "beams are not cut: no beam can be cut, and no bar that pieces would leave held sideways"


@pytest.mark.parametrize("wrong", ['"fine"', "0", "true"])
def test_other_words_than_auto_are_refused(tmp_path, record, wrong):
    study = written(tmp_path, record, STUDY.replace('"auto"', wrong))
    with pytest.raises(
        sid.InputError, match='subdivide: must be a whole number of at least 1 and at most 100, or "auto"'
    ):
        load_study(study)
