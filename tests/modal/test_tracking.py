"""Modes followed over records: by shape where frequencies cross, over pauses, and as the command shows them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from modal_cases import chain_modes
from typer.testing import CliRunner

from structid import InputError, ModalRecord
from structid.cli.app import app
from structid.modal.formats.files import write_modes
from structid.modal.shape_uncertainty import mac_with_std
from structid.modal.tracking import track_modes

SENSORS = ("1X", "2X", "3X", "4X")


def record(frequency, columns, seed=0, noise=0.01, sensors=SENSORS):
    """Modes of the chain's shapes `columns` at `frequency`, in order of frequency, each in a phase of its own."""
    rng, shapes = np.random.default_rng(seed), chain_modes()[1][:, columns]
    order = np.argsort(frequency)
    rows = [int(name[0]) - 1 for name in sensors]
    signs = np.array([-1.0 if name.endswith("-") else 1.0 for name in sensors])[:, None]
    seen = (
        (shapes + noise * rng.standard_normal(shapes.shape))[rows]
        * signs
        * np.exp(2j * np.pi * rng.random(len(columns)))
    )
    seen = seen[:, order] / np.abs(seen[:, order]).max(axis=0)
    n = len(columns)
    return ModalRecord(np.array(frequency)[order], np.full(n, 0.01), seen, sensors, np.diag(np.full(2 * n, 1e-6)))


def test_tracks_follow_shapes_where_frequencies_cross_and_over_pauses():
    """Mode 2 rises through mode 3; mode 4 pauses for two records, mode 1 has its sensors turned in one of them."""
    records, rises = [], np.linspace(2.0, 3.2, 13)
    for k, second in enumerate(rises):
        frequency, columns = [1.0 - 0.002 * k, second, 2.6], [0, 1, 2]
        if k not in (5, 6):
            frequency, columns = [*frequency, 4.0], [*columns, 3]
        sensors = SENSORS if k != 8 else ("4X-", "1X", "3X", "2X-")
        records.append(record(frequency, columns, seed=k, sensors=sensors))
    tracks = track_modes(records)
    assert tracks.n_tracks == 4
    places = [int(np.nanargmin(np.abs(tracks.frequency[0] - f))) for f in (1.0, 2.0, 2.6, 4.0)]
    np.testing.assert_allclose(tracks.frequency[:, places[0]], 1.0 - 0.002 * np.arange(13))
    np.testing.assert_allclose(tracks.frequency[:, places[1]], rises)
    np.testing.assert_allclose(tracks.frequency[:, places[2]], 2.6)
    assert np.isnan(tracks.frequency[[5, 6], places[3]]).all()
    assert (tracks.members[:, places[3]] == -1).sum() == 2
    np.testing.assert_allclose(tracks.change[-1, places[1]], 0.6)
    np.testing.assert_allclose(tracks.frequency_std[0], 1e-3)
    assert np.nanmin(tracks.likeness) > 0.98
    assert np.isnan(tracks.likeness_std).all()  # no shape has a deviation
    assert not tracks.alone


def test_modes_that_one_record_alone_shows_are_named():
    tracks = track_modes([record([1.0, 2.0], [0, 1]), record([1.0, 2.0, 3.0], [0, 1, 2])], names=["a", "b"])
    assert tracks.n_tracks == 2
    assert tracks.alone == ((1, 3.0),)


@pytest.mark.parametrize(
    ("records", "words"),
    [
        ([record([1.0], [0])], "two or more"),
        ([record([1.0], [0]), record([1.0], [3])], "no mode in common"),
        ([record([1.0], [0], sensors=("1X", "2X")), record([1.0], [0], sensors=("3X", "4X"))], "a sensor in common"),
    ],
)
def test_what_cannot_be_followed_is_said(records, words):
    with pytest.raises(InputError, match=words):
        track_modes(records)


def test_the_command_follows_a_folder_of_modes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "year").mkdir()
    for k in range(3):
        write_modes(tmp_path / "year" / f"day{k}.json", record([1.0 - 0.01 * k, 2.0], [0, 1], seed=k))
    done = CliRunner().invoke(app, ["modes", "year", "--track", "--out", "followed"])
    assert done.exit_code == 0, done.stderr
    assert "2 modes followed over 3 records" in done.stdout
    assert "-2.00" in done.stdout
    told = json.loads((tmp_path / "followed" / "tracks.json").read_text())
    np.testing.assert_allclose(np.array(told["frequency_hz"])[:, 0], [1.0, 0.99, 0.98])
    assert told["mac_with_the_last"][0] == [None, None]
    page = (tmp_path / "followed" / "report.html").read_text()
    assert "Change of the frequencies" in page


def test_likeness_has_the_deviation_of_both_shapes_where_they_state_one():
    """Sensors turned and in another order in the second record: as between shapes in one order."""
    first, second = (
        record([1.0, 2.0], [0, 1], k, sensors=s) for k, s in enumerate((SENSORS, ("4X-", "1X", "3X", "2X-")))
    )
    first, second = (replace(part, shape_std=np.full((4, 2), 0.01)) for part in (first, second))
    tracks = track_modes([first, second])
    turned = np.array(second.mode_shapes)[[1, 3, 2, 0]] * [[1], [-1], [1], [-1]]
    straight = replace(second, channels=first.channels, mode_shapes=turned)
    np.testing.assert_allclose(tracks.likeness_std[1], np.diag(mac_with_std(first, straight).std), rtol=0.2)
    assert np.isnan(tracks.likeness_std[0]).all()
