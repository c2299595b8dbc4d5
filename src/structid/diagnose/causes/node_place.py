"""A node is elsewhere along its beams or bars than the model has it: a length is drawn wrongly."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar

from structid.core.errors import InputError
from structid.diagnose.causes.candidate import Candidate, spread
from structid.diagnose.model_edits import AddUnknown, Edits, LetNodeSlide
from structid.diagnose.tested_model import TestedModel
from structid.diagnose.thresholds import MOST_NODE_PLACES
from structid.fem import Structure
from structid.fem.node_positions import node_positions
from structid.forward import RecordProblem


@dataclass(frozen=True, eq=False, kw_only=True)
class NodePlace(Candidate):
    """A node at another place of the straight line through its neighbours, which is a parameter from its drawn place on."""

    kind: ClassVar[str] = "node_place"

    @classmethod
    def from_model(cls, model: TestedModel, problems: Sequence[RecordProblem]) -> Iterator[Candidate]:
        """A candidate position along the line for each node whose position may become a property; 20 nodes at most.

        Of more nodes 20 are evenly chosen. Bars and beams meet there in a straight line, or an element ends; nodes are
        those of the first record's structure. `problems` are not used.
        """
        structure = model.setups[0].structure
        for node in spread(_nodes_that_may_slide(structure), MOST_NODE_PLACES):
            yield cls(where=(str(node),))

    def edits(self, model: TestedModel, strength: float) -> Edits:
        node = int(self.where[0])
        return [LetNodeSlide(node), AddUnknown({"property": "position", "elements": f"node {node}"})]

    def sentence(self, value: float | None) -> str:
        return f"node {self.where[0]} is elsewhere along its line than drawn: a length is wrong"


def _nodes_that_may_slide(structure: Structure) -> list[int]:
    """Labels of the nodes whose position may become a property of the structure, in the order of `structure.nodes`.

    Left out are nodes whose position is one already, and those where elements or ties forbid it. Empty for structures
    with components.
    """
    nodes = []
    for node in structure.nodes if not structure.components else ():
        if node not in structure.sliding:
            with suppress(InputError):
                node_positions([node], structure.elements, structure.nodes, structure.ties)
                nodes.append(node)
    return nodes
