"""What the page draws of a structure, against plain loops over its elements."""

from __future__ import annotations

import base64
from collections import Counter
from itertools import combinations

import numpy as np
import pytest
from app_cases import ROOT

from structid.study.schema.model.structure import read_structure
from structid.study.schema.section import read_root
from structid.study.templates import TEMPLATES, template_with, write_study
from structid.workbench.work.scene import placed_channels, read_model, scene

CUBES = """\
title = "Two cubes"
[structure]
active = ["X", "Y", "Z"]
fixed = ["1", "2"]
[structure.nodes]
1 = [0.0, 0.0, 0.0]
2 = [1.0, 0.0, 0.0]
3 = [1.0, 1.0, 0.0]
4 = [0.0, 1.0, 0.0]
15 = [0.0, 0.0, 1.0]
16 = [1.0, 0.0, 1.0]
17 = [1.0, 1.0, 1.0]
18 = [0.0, 1.0, 1.0]
9 = [0.0, 0.0, 2.0]
10 = [1.0, 0.0, 2.0]
11 = [1.0, 1.0, 2.0]
12 = [0.0, 1.0, 2.0]
[[structure.solid]]
name = "cubes"
nodes = [[1, 2, 3, 4, 15, 16, 17, 18], [15, 16, 17, 18, 9, 10, 11, 12]]
youngs_modulus = 7e10
density = 2700.0
poisson = 0.3
"""


def row(text: str, kind=np.uint32) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), kind)


def test_of_solids_the_outer_faces_are_drawn(tmp_path):
    (tmp_path / "cubes.toml").write_text(CUBES, encoding="utf-8")
    found = scene(tmp_path / "cubes.toml")
    labels, cubes = row(found["labels"], np.int32), found["sets"][0]
    triangles = labels[row(cubes["triangles"]).reshape(-1, 3)]
    assert len(triangles) == 2 * 10  # ten of twelve faces: the one between the cubes is inside
    inner = {15, 16, 17, 18}
    assert not any(set(t) <= inner for t in triangles.tolist())
    places = np.array(
        [row(found["places"], np.float32).reshape(-1, 3)[labels.tolist().index(n)] for n in triangles.ravel()]
    )
    a, b, c = places.reshape(-1, 3, 3).transpose(1, 0, 2)
    assert 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() == pytest.approx(10.0)
    sides = {frozenset(pair) for pair in labels[row(cubes["edges"]).reshape(-1, 2)].tolist()}
    assert len(sides) == 20
    assert Counter(row(cubes["owners"]).tolist()) == {0: 10, 1: 10}
    assert {labels[one["node"]] for one in found["supports"]} == {1, 2}


def test_what_floats_is_told_with_its_nodes_and_the_corners_of_its_elements(tmp_path):
    """The upper cube on nodes of its own, with the lower one held; and a support where nothing is."""
    apart = CUBES.replace("[15, 16, 17, 18, 9,", "[25, 26, 27, 28, 9,").replace(
        'fixed = ["1", "2"]', 'fixed = ["1", "2", "50X"]'
    )
    nodes = (
        "25 = [0.0, 0.0, 1.5]\n26 = [1.0, 0.0, 1.5]\n27 = [1.0, 1.0, 1.5]\n28 = [0.0, 1.0, 1.5]\n50 = [5.0, 0.0, 0.0]\n"
    )
    (tmp_path / "cubes.toml").write_text(apart.replace("[[structure.solid]]", nodes + "[[structure.solid]]"), "utf-8")
    idle, loose = scene(tmp_path / "cubes.toml")["findings"]
    assert idle["nodes"] == [50]
    assert loose["nodes"] == [9, 10, 11, 12, 25, 26, 27, 28]
    rings = {frozenset(outline) for outline in loose["outlines"]}
    sides = [(25, 26, 9, 10), (26, 27, 10, 11), (27, 28, 11, 12), (28, 25, 12, 9)]
    assert rings == {frozenset(ring) for ring in [(25, 26, 27, 28), (9, 10, 11, 12), *sides]}
    assert scene(write_cubes(tmp_path))["findings"] == []


def write_cubes(folder):
    path = folder / "whole.toml"
    path.write_text(CUBES, encoding="utf-8")
    return path


def test_a_plate_has_all_its_area_and_its_sides_once(tmp_path):
    path = write_study(
        template_with(TEMPLATES["plate"], {"elements_along": 5, "elements_across": 4}), tmp_path / "p.toml"
    )
    plate = scene(path)["sets"][0]
    assert len(row(plate["triangles"])) == 3 * 2 * 20
    assert len(row(plate["edges"])) == 2 * (5 * 5 + 4 * 6)
    assert plate["count"] == 20


def test_the_frame_has_its_beams_springs_and_properties():
    path = ROOT / "examples" / "three_storey_frame" / "study.toml"
    found = scene(path)
    root, files = read_root(path)
    structure = read_structure(root.inner("structure"), files)
    labels = row(found["labels"], np.int32)
    by_name = {one["name"]: one for one in found["sets"]}
    for element in structure.elements:
        shown = by_name[element.name]
        values = {p.term.property: p.term.values for p in structure.properties if p.element == element.name}
        assert {p["name"]: (p["low"], p["high"]) for p in shown["properties"]} == {
            k: (v.min(), v.max()) for k, v in values.items()
        }
        if "lines" in shown:
            assert labels[row(shown["lines"])].reshape(-1, 2).tolist() == element.nodes.tolist()
    assert by_name["rocking"]["connectors"] == [{"from": labels.tolist().index(100), "to": None, "direction": "RY"}]
    assert len(found["links"]) == 4
    free = {(dof.node, dof.direction) for dof in structure.dofs}
    linked = {node for tie in structure.ties for node in getattr(tie, "dependents", ())}
    for label, moves in zip(labels.tolist(), row(found["moves"], np.uint8), strict=True):
        if label not in linked:
            assert {d for d, bit in zip("XYZ", (1, 2, 4), strict=True) if moves & bit} == {
                d for d in "XYZ" if (label, d) in free
            }


def test_channels_stand_where_the_study_puts_them(tmp_path):
    text = CUBES + '\n[record]\npath = "r.npz"\n[record.sensors]\n"101Z" = { node = 9, direction = [0.0, 3.0, 4.0] }\n'
    (tmp_path / "cubes.toml").write_text(text, encoding="utf-8")
    found = placed_channels(
        read_model(tmp_path / "cubes.toml"),
        [("12X-", "sensor"), ("101Z-", "sensor"), ("77X+", "load"), ("9Y+", "load")],
    )
    assert [one["node"] for one in found] == [12, 9, None, 9]
    np.testing.assert_allclose(found[0]["direction"], [-1.0, 0.0, 0.0])
    np.testing.assert_allclose(found[1]["direction"], [0.0, -0.6, -0.8])
    assert [one["declared"] for one in found] == [False, True, False, False]
    assert all(a is not b for a, b in combinations(found, 2))
