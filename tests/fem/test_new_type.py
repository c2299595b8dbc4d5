"""To add an element type, one touches two places: its module and the registry. What is added here keeps every law."""

import importlib
import sys

import numpy as np
import pytest
from element_cases import LAWS, Case

import structid as sid
from structid.fem import ELEMENT_TYPES
from structid.records import write_record
from structid.study.json_schema import study_schema

MODULE = '''
"""Rubber bands: springs whose stiffness is a modulus times a section over the length between their nodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from structid.core.arrays import IntArray
from structid.fem.elements.beam import rod_mass, rod_stiffness
from structid.fem.elements.element import (
    LOSS_FACTOR, ElementMatrixTerm, ElementSet, Nodes, NodeCoordinates, Values, declared, element, element_vectors, node_codes,
    node_table,
)


@element
class RubberBand(ElementSet):
    """Rubber bands along X."""

    nodes: Nodes = declared("Node labels of the two ends", stored=node_table(2))
    mass: Values = declared("Mass per length", "mass", "kg/m")
    section: Values = declared("Modulus times section", "stiffness", "N")
    loss_factor: Values = declared(*LOSS_FACTOR, default=0.0)
    colour: Literal["red", "blue"] = declared("What it looks like", default="red")

    def matrices(self, positions: NodeCoordinates, present: IntArray) -> Mapping[str, Sequence[ElementMatrixTerm]]:
        """See `ElementSet.matrices`."""
        length, _ = element_vectors(self.name, self.nodes, positions)
        codes = node_codes(self.nodes, ("X",))
        mass, stiffness = rod_mass(length), rod_stiffness(length)
        return {"mass": (ElementMatrixTerm(codes, mass),), "section": (ElementMatrixTerm(codes, stiffness),)}
'''
STUDY = """
[structure]
active = ["X"]
fixed = ["1X"]
[structure.nodes]
1 = 0.0
2 = 0.5
3 = 1.5
[[structure.rubber_band]]
name = "bands"
nodes = [[1, 2], [2, 3]]
mass = 0.1
section = [900.0, 1100.0]
loss_factor = 0.02
colour = "blue"
[[structure.point_mass]]
name = "masses"
nodes = [2, 3]
mass = 2.0
[[unknown]]
property = "section"
elements = "bands"
each = true
[record]
path = "frf.npz"
[record.noise]
relative = 0.01
[method]
restarts = 0
"""


@pytest.fixture
def rubber_band(tmp_path, monkeypatch):
    (tmp_path / "rubber_bands.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    kind = importlib.import_module("rubber_bands").RubberBand
    monkeypatch.setitem(ELEMENT_TYPES.places, "rubber_band", "rubber_bands:RubberBand")
    yield kind
    del sys.modules["rubber_bands"]


def test_a_new_element_type_keeps_every_law(rubber_band, tmp_path):
    nodes = {1: 0.0, 2: 0.7, 3: 2.0}
    case = Case("on a line", nodes, rubber_band("e", [[1, 2], [2, 3]], 2.0, 5.0, 0.1), mass=4.0)
    for law in LAWS:
        law(case, tmp_path)


def test_a_study_with_a_new_element_type_finds_its_properties(rubber_band, tmp_path):
    bands = rubber_band("bands", [[1, 2], [2, 3]], 0.1, [1000.0, 1000.0], 0.02)
    masses = sid.PointMass("masses", [2, 3], 2.0)
    structure = sid.Structure({1: 0.0, 2: 0.5, 3: 1.5}, [bands, masses], ["1X"], active=["X"])
    frequency = np.arange(0.5, 12.0, 0.1)
    empty = sid.FrfRecord(frequency, np.ones((len(frequency), 2, 1)), ("2X", "3X"), ("3X",), "receptance")
    truth = sid.parameters(structure, [sid.Unknown("section", "bands", each=True)])
    record = sid.with_declared_noise(sid.simulated_record(structure, truth, empty), 0.01)
    write_record(tmp_path / "frf.npz", record)
    (tmp_path / "study.toml").write_text(STUDY)
    found = sid.run_study(sid.load_study(tmp_path / "study.toml")).identification.estimate
    assert found.names == ("section[bands:1]", "section[bands:2]")
    assert found.values == pytest.approx([1000.0, 1000.0], rel=1e-6)
    (tmp_path / "study.toml").write_text(STUDY.replace('"blue"', '"green"'))
    with pytest.raises(sid.InputError, match=r'line 15: .*"bands" colour: must be one of "red", "blue", got \'green\''):
        sid.load_study(tmp_path / "study.toml")
    own = study_schema()["$defs"]["rubber_band"]
    assert own["properties"]["section"]["description"] == "Modulus times section, N."
    assert own["required"] == ["name", "mass", "section"]
