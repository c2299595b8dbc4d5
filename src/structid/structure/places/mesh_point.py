"""A sensor's or load's place on a mesh: a node of its own that moves as the nearest node of the mesh."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from structid.arrays import FloatArray
from structid.errors import InputError
from structid.structure.elements import ElementSet
from structid.structure.elements.element import dof_code, dof_of_code, joined_codes
from structid.structure.meshes import Mesh
from structid.structure.supports import Equations


@dataclass(frozen=True)
class MeshPoint:
    """A node that moves as the nearest node of a mesh.

    Attributes
    ----------
    name : str
        Such as ``point 101``.
    label : int
        Its own label, which sensors and loads name.
    node : int
        The mesh's node that it follows.
    distance : float
        Between the two, m.
    directions : tuple of str
        In which that node moves.
    """

    name: str
    label: int
    node: int
    distance: float
    directions: tuple[str, ...]

    def equations(self, positions: Mapping[int, FloatArray], active: Sequence[str]) -> Equations:
        """Own codes with those of the node; see `Tie.equations`."""
        return {dof_code(self.label, d): {dof_code(self.node, d): 1.0} for d in self.directions if d in active}


def mesh_points(
    mesh: Mesh, elements: Iterable[ElementSet], points: Mapping[int, Sequence[float]]
) -> tuple[MeshPoint, ...]:
    """One `MeshPoint` for each of `points`, at the nearest node that elements use.

    Raises
    ------
    InputError
        If a label is that of a node, or the nearest node is farther than the cells are long there.
    """
    sets = list(elements)
    used = {int(n) for element in sets for n in element.nodes.ravel() if n in mesh.nodes}
    found = []
    for label, position in points.items():
        if label in mesh.nodes:
            raise InputError(f"point {label} is a node of {mesh.source} already; take another number for the point")
        node, distance, size = mesh.nearest(position, used)
        if distance > size:
            raise InputError(
                f"point {label} is {distance:.3g} m from the nearest node {node} of {mesh.source}, farther than the cells"
                f" there are long ({size:.3g} m); correct its position (in m), or the unit of the mesh"
            )
        found.append(MeshPoint(f"point {label}", label, node, distance, _directions(sets, node, mesh)))
    return tuple(found)


def _directions(elements: list[ElementSet], node: int, mesh: Mesh) -> tuple[str, ...]:
    """In which directions elements let a node move."""
    used = [element.codes(mesh.nodes) for element in elements if (element.nodes == node).any()]
    codes = joined_codes(used)
    return tuple(dof_of_code(code).direction for code in codes[codes // 6 == node].tolist())
