"""Modes with unknown shape entries beside a model: each measure is that of the known entries, and pages are made."""

import json
import re
from dataclasses import replace

import mast
import numpy as np
import pytest
from typer.testing import CliRunner

from structid import InputError, correlated_modes, load_study, pair_modes
from structid.cli import app as cli
from structid.compare.correlation import correlate, expanded_record
from structid.compare.mode_correlation import expand
from structid.core.dof import parse_dofs
from structid.dynamics.normal_modes import modes
from structid.modal.formats.files import read_modes, write_modes

RUN = CliRunner()


def blanked(folder, *cells, bare=()):
    """The mast's study with the entries (channel, mode) of `cells`, and whole shapes of `bare`, unknown."""
    study = mast.written(folder)
    record = read_modes(folder / "modes.csv")
    shapes = np.array(record.mode_shapes)
    for cell in cells:
        shapes[cell] = np.nan
    shapes[:, list(bare)] = np.nan
    write_modes(folder / "modes.csv", replace(record, mode_shapes=shapes))
    return study


def test_known_entries_are_held_against_the_model_and_carried_on(tmp_path):
    (whole,) = correlate(load_study(mast.written(tmp_path / "whole"))).modes
    (part,) = correlate(load_study(blanked(tmp_path / "part", (2, 0), (3, 0), bare=[2]))).modes
    known = part.measured.known
    assert known.sum(axis=0).tolist() == [4, 6, 0, 6]
    assert part.pairing.number.tolist() == whole.pairing.number.tolist() == [1, 0, 3, 2]
    rows = np.flatnonzero(known[:, 0])
    for k in np.flatnonzero((part.pairing.mac > 0).any(axis=0)).tolist():
        x, y = part.shapes[rows, 0], part.seen[rows, k]
        assert part.pairing.mac[0, k] == pytest.approx((x @ y) ** 2 / ((x @ x) * (y @ y)), abs=1e-12)
    assert part.pairing.mac[[1, 3]] == pytest.approx(whole.pairing.mac[[1, 3]])
    assert np.isnan(part.pairing.mac[2]).all()
    assert part.remark(2) == "no shape entry is known: paired by frequency alone"
    assert np.isfinite(part.comac).all()
    assert part.self_orthogonality[np.ix_([1, 3], [1, 3])] == pytest.approx(
        whole.self_orthogonality[np.ix_([1, 3], [1, 3])]
    )
    assert np.isnan(part.self_orthogonality[0]).all()
    assert np.isnan(part.cross_orthogonality[[0, 2]]).all()
    record = expanded_record(part)
    assert record.known.all(axis=0).tolist() == [True, True, False, True]
    assert not record.known[:, 2].any()
    few = correlated_modes(part.structure, part.structure.values, part.measured.some_channels(rows))
    again = correlated_modes(part.structure, part.structure.values, part.measured)
    assert again.expanded.shapes[:, 0] == pytest.approx(few.expanded.shapes[:, 0], rel=1e-9, abs=1e-12)
    assert again.expanded.std[:, 0] == pytest.approx(few.expanded.std[:, 0], rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("is_dynamic", [False, True])
def test_each_shape_is_expanded_from_the_sensors_at_which_it_is_known(is_dynamic):
    structure = mast.mast()
    mass, stiffness = structure.matrix("mass"), structure.matrix("stiffness")
    model = modes(mass, stiffness, n_modes=8)
    sensors = structure.selection(parse_dofs(["4X", "7Y", "9X", "9Y", "6X", "6Y"]))
    psi = np.asarray(sensors.T @ model.mode_shapes[:, :2])
    psi[1, 0] = psi[4, 0] = np.nan
    dynamic = (mass, stiffness) if is_dynamic else None
    std = np.full(psi.shape, 0.01)
    found = expand(
        psi, model.frequency[:2], sensors, model, [(0, 1), (1, 0)], shape_std=std, model_error=0.01, dynamic=dynamic
    )
    own = [0, 2, 3, 5]
    alone = expand(
        psi[own, :1], model.frequency[:1], sensors[:, own], model, [(0, 1)], shape_std=std[own, :1], model_error=0.01,
        dynamic=dynamic,
    )  # fmt: skip
    for name in ("shapes", "std"):
        assert getattr(found, name)[:, 0] == pytest.approx(getattr(alone, name)[:, 0], rel=1e-12)
    for name in ("residual", "noise"):
        assert getattr(found, name)[own, 0] == pytest.approx(getattr(alone, name)[:, 0], rel=1e-12, abs=1e-15)
        assert np.isnan(getattr(found, name)[[1, 4], 0]).all()
    bare = expand(np.full_like(psi, np.nan), model.frequency[:2], sensors, model, [(0,), (1,)], shape_std=std)
    assert np.isnan(bare.shapes).all()
    assert bare.basis == ((), ())


def test_a_mode_without_a_shape_is_paired_with_the_free_mode_nearest_in_frequency():
    hz, shapes = np.array([2.0, 5.0, 9.0, 14.0]), np.linalg.qr(np.random.default_rng(4).standard_normal((6, 4)))[0]
    measured = shapes[:, :3].copy()
    measured[:, 1] = np.nan
    found = pair_modes([2.0, 5.1, 9.0], measured, hz, shapes)
    assert found.number.tolist() == [0, 1, 2]
    assert np.isnan(found.likeness).tolist() == [False, True, False]
    unseen = shapes.copy()
    unseen[:, 1] = 0.0  # the mode at 5 Hz moves no sensor, which speaks for it
    assert pair_modes([2.0, 5.1, 9.0], measured, hz, unseen).number.tolist() == [0, 1, 2]
    close = np.array([2.0, 5.0, 5.05, 14.0])
    turned = shapes.copy()
    turned[:, 1:3] = shapes[:, 1:3] @ [[0.8, -0.6], [0.6, 0.8]]
    turned[[0, 4], [1, 2]] = np.nan
    spans = pair_modes(close, turned, close, shapes, closeness=0.02)
    assert spans.groups == (((1, 2), (1, 2)),)
    assert spans.likeness[1:3] == pytest.approx(np.ones(2), abs=1e-9)  # at the sensors where both are known


def test_close_modes_are_a_span_past_a_mode_without_a_shape():
    hz, shapes = np.array([5.0, 10.0, 10.05, 10.1]), np.linalg.qr(np.random.default_rng(4).standard_normal((8, 4)))[0]
    turned = shapes.copy()
    turned[:, [1, 3]] = shapes[:, [1, 3]] @ [[0.8, -0.6], [0.6, 0.8]]
    turned[:, 2] = np.nan
    found = pair_modes(hz, turned, hz, shapes)
    assert found.number.tolist() == [0, 1, 2, 3]
    assert found.groups == (((1, 3), (1, 3)),)
    assert found.likeness[[1, 3]] == pytest.approx(np.ones(2), abs=1e-9)


def test_a_record_without_a_known_entry_is_refused(tmp_path):
    with pytest.raises(InputError, match="no mode above 0 Hz with a shape"):
        correlate(load_study(blanked(tmp_path, bare=[0, 1, 2, 3])))


@pytest.mark.parametrize("command", ["correlate", "identify", "check"])
def test_commands_take_blank_cells(tmp_path, command):
    study = blanked(tmp_path, (2, 0), (3, 0), (5, 3), bare=[2])
    out = ["--out", str(tmp_path / "out")]
    done = RUN.invoke(cli.app, [command, str(study), *([] if command == "check" else out)])
    assert (done.exit_code, done.stderr) == (0, ""), done.output
    assert not re.search(r"\bnan\b", done.stdout)
    assert ("9 of 24 shape entries unknown, 1 mode without a shape" in " ".join(done.stdout.split())) == (
        command != "identify"
    )
    if command == "correlate":
        told = json.loads((tmp_path / "out" / "correlation.json").read_text())["modal_records"][0]
        assert told["modes"][2]["mac"] is None
        assert told["modes"][2]["model_mode"] == 4
        assert read_modes(tmp_path / "out" / "expanded_modes.csv").n_modes == 4
    if command == "identify":
        told = json.loads((tmp_path / "out" / "estimate.json").read_text())["modal_records"][0]
        assert [row["mac"] is None for row in told["modes"]] == [False, False, True, False]
        page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
        assert "9 of 24 shape entries unknown" in page
