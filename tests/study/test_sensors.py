"""[record.sensors]: channels along directions of their own, at nodes or at the nodes nearest to points."""

import sys
from pathlib import Path

import numpy as np
import pytest

from structid import AimedSensor, InputError, Structure, load_study, nearest_nodes
from structid.core.dof import Dof
from structid.study.run.check import check_study

sys.path.insert(0, str(Path(__file__).parents[1] / "compare"))
import mast


def test_every_channel_reads_its_node_along_its_direction(tmp_path):
    study = load_study(mast.written(tmp_path))
    record = study.setups[0].record.modes.load()
    plain = mast.mast()
    columns = study.structure.selection(record.channels).toarray()
    for column, (node, direction) in zip(columns.T, mast.CHANNELS.values(), strict=True):
        vector = np.array(direction) / np.linalg.norm(direction)
        assert column == pytest.approx(plain.selection([Dof(node, d) for d in "XYZ"]).toarray() @ vector, abs=1e-12)
    said = {one.channel: one.seen for one in check_study(study).channels}
    assert said["101X+"] == "+0.707 4Y +0.707 4X" or said["101X+"] == "+0.707 4X +0.707 4Y"
    assert "nearest node, 0.01 m away" in said["102X+"]


def test_the_sense_of_a_channel_stays_and_other_channels_keep_their_names(tmp_path):
    text = mast.STUDY.replace('path = "modes.csv"', 'path = "modes.csv"\nrelabel = { "9X" = "9X-" }') + mast.SENSORS
    study = load_study(mast.written(tmp_path, text))
    channels = study.setups[0].record.modes.load().channels
    assert [str(dof) for dof in channels] == ["101X+", "102X+", "103X-", "104X+", "6X+", "6Y+"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("direction = [1.0, 1.0, 0.0]", "direction = [0.0, 0.0, 0.0]", r"101X\] direction: must be three numbers that are"),
        ("direction = [1.0, 1.0, 0.0]", "direction = [1.0, 0.0]", r"sensors.101X\] direction: must be three numbers"),
        ("node = 4", "node = 40", r"101X: node 40 does not exist"),
        ("node = 4", "node = 4, point = [0.0, 0.0, 3.0]", r"101X: has `node` and `point`"),
        ("[0.01, 0.0, 6.0]", "[1.0, 0.0, 6.0]", r"102X: point \(1, 0, 6\) m is 1 m from the nearest node 7, farther than 0.05 m"),
        ('"101X" =', '"first" =', r"cannot read 'first'"),
        ('"101X" =', '"111X" =', r"sensors: there is no channel 111X; the record has 101X"),
        ('"101X" =', '"101RX" =', "must be a translation"),
        ("node = 4", "nodes = 4", "unknown key; the nearest is `node`"),
    ],
)  # fmt: skip
def test_what_cannot_be_a_sensor_is_refused_with_its_place(tmp_path, old, new, words):
    text = (mast.STUDY + mast.SENSORS).replace(old, new)
    with pytest.raises(InputError, match=words):
        load_study(mast.written(tmp_path, text)).setups[0].record.modes.load()


def test_a_declared_sensor_need_not_be_used(tmp_path):
    text = mast.STUDY.replace('path = "modes.csv"', 'path = "modes.csv"\nchannels_used = ["101X", "9Y", "6X"]')
    channels = load_study(mast.written(tmp_path, text + mast.SENSORS)).setups[0].record.modes.load().channels
    assert [str(dof) for dof in channels] == ["101X+", "104X+", "6X+"]


def test_a_direction_in_which_nothing_moves_is_refused():
    plain = mast.mast()
    sensor = AimedSensor("sensor 20X", "20X", 20, "X", 9, (0.0, 0.0, 1.0))
    nodes = {**plain.nodes, 20: plain.nodes[9]}
    with pytest.raises(InputError, match="points where node 9 does not move"):
        Structure(nodes, plain.elements, plain.fixed, [sensor], active=["X", "RY"])


def test_a_sensor_in_no_direction_of_its_node_is_refused_in_its_section_and_its_part_that_moves_is_read(tmp_path):
    """Nodes on a line may move in X and Y, and the beam on them moves in Y alone."""
    beam = """
[structure]
nodes = { 1 = [0.0], 2 = [0.5], 3 = [1.0] }
fixed = ["1Y", "1RZ"]
beam = [{ name = "beam", nodes = [[1, 2], [2, 3]], mass = 1.0, bending_stiffness = 25.0, loss_factor = 0.01 }]
[record]
path = "modes.csv"
[record.modes]
frequency_std = 0.01
shape_error = 0.02
[record.sensors]
102Y = { node = 2, direction = [0.6, 0.8, 0.0] }
103Y = { node = 3, direction = [WAY] }
[[unknown]]
property = "mass"
elements = "beam"
"""
    (tmp_path / "modes.csv").write_text("frequency_hz,102Y,103Y\n3,0.3,1\n", encoding="utf-8")
    path = tmp_path / "study.toml"
    path.write_text(beam.replace("WAY", "0.0, 1.0, 0.0"), encoding="utf-8")
    assert "+0.8 2Y" in [one.seen for one in check_study(load_study(path)).channels]
    path.write_text(beam.replace("WAY", "1.0, 0.0, 0.0"), encoding="utf-8")
    with pytest.raises(InputError, match=r"\[record.sensors.*103Y.*node 3 does not move; it moves in Y, RZ"):
        load_study(path)


def test_the_nearest_nodes_are_those_of_all_distances():
    rng = np.random.default_rng(1)
    nodes = {int(k): x for k, x in zip(rng.permutation(50), rng.random((50, 3)), strict=True)}
    points = rng.random((20, 3))
    found = nearest_nodes(points.tolist(), nodes, 1.0)
    for point, node, distance in zip(points, found.nodes, found.distance, strict=True):
        away = {label: float(np.linalg.norm(x - point)) for label, x in nodes.items()}
        assert node == min(away, key=away.get)
        assert distance == pytest.approx(away[node], rel=1e-12)
    with pytest.raises(InputError, match=r"farther than 0\.0173 m"):
        nearest_nodes([[2.0, 2.0, 2.0]], {1: np.zeros(3), 2: np.ones(3)})
