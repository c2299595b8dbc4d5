"""Sensors and loads named along the axes of their nodes, in global axes."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.dof import DIRECTIONS, Dof
from structid.core.errors import FileError
from structid.files.uff.nodes import UniversalNodes
from structid.records.formats.options import option_words

#: Part of a direction along another axis that rounding of a file explains.
_ROUNDED = 1e-5
_COUNTS = {2: "two", 3: "three"}


class GlobalAxes(NamedTuple):
    """Channels in global axes.

    Attributes
    ----------
    dofs : tuple of Dof
    matrix : (n_channels, n_channels) float array, optional
        What turns the channels, in their order, into these; None where they keep their values.
    words : str
        What was done.
    """

    dofs: tuple[Dof, ...]
    matrix: FloatArray | None
    words: str


def in_global_axes(
    path: Path,
    nodes: UniversalNodes,
    dofs: Sequence[Dof],
    groups: Sequence[Hashable] | None = None,
    is_load: bool = False,
) -> GlobalAxes:
    """Channels along the local axes of their nodes, transformed to global axes.

    A channel along a global axis is only renamed. The others of a node are transformed together if there are as many of them as
    global axes that they span: all three, or the radial and the tangential one of a cylinder. Returns new channels, the
    transformation matrix (n_channels, n_channels), None if values stay, and words on it.

    Parameters
    ----------
    path : Path
        File, named in errors.
    nodes : UniversalNodes
        Nodes with their axes; nodes that the file does not define have global axes.
    dofs : sequence of Dof
        Degree of freedom of each channel in local axes.
    groups : sequence, optional
        Kind of each channel, such as its quantity: only channels of the same kind are transformed together.
    is_load : bool
        True if the channels are loads, for messages.

    Raises
    ------
    FileError
        If a channel lies along no global axis, and the other channels of its node that are needed are missing.
    """
    named = option_words(axes="named")
    kinds: Sequence[Hashable] = [""] * len(dofs) if groups is None else groups
    matrix, renamed, words, is_turned = np.eye(len(dofs)), list(dofs), [], False
    skewed: dict[Hashable, list[int]] = {}
    for j, dof in enumerate(dofs):
        axes = nodes.axes(dof.node, f"export the coordinate systems too, or take directions as they are named: {named}")
        if axes is None:
            continue
        direction = dof.sign * axes[dof.axis % 3]
        along = int(np.argmax(np.abs(direction)))
        if np.abs(np.delete(direction, along)).max() <= _ROUNDED:
            renamed[j] = _global(dof, along, 1 if direction[along] > 0 else -1)
            words.append(f"{dof} is {renamed[j]} in global axes")
        else:
            skewed.setdefault((dof.node, dof.is_rotation, kinds[j]), []).append(j)
    for columns in skewed.values():
        local = [dofs[j] for j in columns]
        node = local[0].node
        axes = nodes.axes(node)
        assert axes is not None
        parts = axes[[dof.axis % 3 for dof in local]]
        spanned = np.flatnonzero((np.abs(parts) > _ROUNDED).any(axis=0)).tolist()
        if len(spanned) != len(columns) or len({dof.axis for dof in local}) < len(local):
            raise FileError(f"{path}: {_describe_skewed(local[0], axes, is_load)}; {named}")
        signs = np.array([dof.sign for dof in local])
        for j, axis in zip(columns, spanned, strict=True):
            matrix[j, columns] = signs * parts[:, axis]
            renamed[j] = _global(local[0], axis, 1)
        is_turned = True
        words.append(f"the {_COUNTS[len(columns)]} of node {node} are turned into global axes")
    return GlobalAxes(tuple(renamed), matrix if is_turned else None, ", ".join(words))


def _global(dof: Dof, axis: int, sign: int) -> Dof:
    return Dof(dof.node, DIRECTIONS[axis + 3 * dof.is_rotation], sign)


def _describe_skewed(dof: Dof, axes: FloatArray, is_load: bool) -> str:
    """Text of the error on a channel along no global axis, which says how to state its direction in a study.

    `axes` (3, 3) holds the local axes of its node as rows, in global coordinates.
    """
    way = ", ".join(f"{part:.5g}" for part in axes[dof.axis % 3])
    name = f"{'load ' if is_load else ''}{dof.place}"
    if dof.is_rotation:
        return (
            f"{dof} turns about ({way}) in global axes and the other two rotations of node {dof.node} are not there to turn it"
            " with; export all three, or leave it out; or take directions as they are named"
        )
    return (
        f"{dof} {'acts' if is_load else 'reads'} along ({way}) in global axes and the other two of node {dof.node} are not there to"
        f' turn it with; say its direction in a study, [record.sensors] "{name}" = {{ direction = [{way}] }}, and take directions'
        " as they are named"
    )
