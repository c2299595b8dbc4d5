"""Natural modes of an identified model at all its nodes, as a record of modes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from structid.core.arrays import FloatArray
from structid.core.display import plural
from structid.dynamics import Modes, modes
from structid.fem import Structure
from structid.fem.elements.element import dof_of_code
from structid.modal import ModalRecord
from structid.modal.formats.files import write_modes
from structid.modal.formats.options import CSV_SUFFIXES, JSON_SUFFIXES
from structid.prediction.identified_model import IdentifiedModel
from structid.prediction.quantities import NaturalModes
from structid.records.formats.geometry import Geometry


def model_modes(model: IdentifiedModel, n_modes: int) -> Modes:
    """The `n_modes` lowest natural modes of an identified model, at most one for each degree of freedom."""
    structure = model.structure
    structure.require_modes("modes")
    mass, stiffness, damping, loss = (
        structure.matrix(matrix_kind, model.values)
        for matrix_kind in ("mass", "stiffness", "damping", "structural_damping")
    )
    return modes(mass, stiffness, damping, loss, min(n_modes, structure.n_dofs))


def modes_covariance(model: IdentifiedModel, n_modes: int) -> FloatArray:
    """Covariance of frequencies (Hz), then damping ratios, of the lowest modes, (2 n_modes, 2 n_modes), to first order.

    Each independent error of the parameters is moved by one standard deviation; modes are matched by their shapes.
    """
    structure, n_factors = model.structure, model.factor.shape[1]
    evaluate = NaturalModes(n_modes).evaluator(structure, model.parameters, [model.physical])
    least = 1e-3 * np.abs(model.physical)
    moved = [np.maximum(model.parameters_at(z), least) for z in np.eye(n_factors)]
    nominal = evaluate(model.physical).real
    changes = np.array([(evaluate(physical).real - nominal).T.ravel() for physical in moved]).reshape(
        n_factors, 2 * n_modes
    )
    return np.asarray(changes.T @ changes)


def model_modes_record(model: IdentifiedModel, n_modes: int, source: str, with_covariance: bool = False) -> ModalRecord:
    """The `n_modes` lowest modes of an identified model with unit modal mass, at all moving degrees of freedom of its nodes.

    `source` is the text on their origin. The covariance of frequencies and damping ratios is None unless asked for by
    `with_covariance`.
    """
    structure, computed = model.structure, model_modes(model, n_modes)
    rows = [
        row
        for row, code in enumerate(structure.numbering.codes.tolist())
        if code // 6 in structure.nodes
        and structure.numbering.matrix.indptr[row + 1] > structure.numbering.matrix.indptr[row]
    ]
    return ModalRecord(
        computed.frequency,
        computed.damping_ratio,
        (structure.numbering.matrix @ computed.mode_shapes)[rows],
        tuple(dof_of_code(structure.numbering.codes[row]) for row in rows),
        modes_covariance(model, len(computed.frequency)) if with_covariance else None,
        source=source,
        scaling="mass",
    )


def node_translations(structure: Structure, mode_shapes: FloatArray) -> FloatArray:
    """Translations of all nodes, fixed and tied ones included, (n_modes, n_nodes, 3), from `mode_shapes` (n_dofs, n_modes)."""
    row_of = {node: row for row, node in enumerate(structure.nodes)}
    motion = np.zeros((mode_shapes.shape[1], len(row_of), 3))
    moved = structure.numbering.matrix @ mode_shapes
    for values, code in zip(moved, structure.numbering.codes.tolist(), strict=True):
        node, axis = divmod(code, 6)
        if node in row_of and axis < 3:
            motion[:, row_of[node], axis] = values
    return motion


def export_modes(model: IdentifiedModel, n_modes: int, title: str, path: Path) -> list[str]:
    """Write the `n_modes` lowest natural modes to `path` in the format of its suffix; return one line on the content.

    `title` is stored in the file. The shapes have unit modal mass.

    Raises
    ------
    InputError
        If the structure has no modes.
    FileError
        If the suffix is of no format, or the format cannot hold the modes.
    """
    record = model_modes_record(model, n_modes, title, path.suffix.lower() in (*JSON_SUFFIXES, *CSV_SUFFIXES))
    write_modes(path, record, _geometry(model.structure))
    ends = f"{record.frequency[0]:.4g} to {record.frequency[-1]:.4g} Hz"
    return [
        f"{path}: {plural(record.n_modes, 'mode')}, {ends}, of unit modal mass, at {len(record.channels)} degrees of freedom"
    ]


def _geometry(structure: Structure) -> Geometry:
    """Nodes of a structure with three coordinates (m), and each line element as a line through its nodes.

    A line with node 0 is left out, since 0 lifts the pen in the file format.
    """
    nodes: dict[int, tuple[float, float, float]] = {}
    for node, position in structure.nodes.items():
        padded = [*position.tolist(), 0.0, 0.0]
        nodes[node] = (padded[0], padded[1], padded[2])
    lines = tuple(
        tuple(int(node) for node in row if node >= 0)
        for element in structure.elements
        if element.is_line
        for row in element.nodes
        if 0 not in row  # which lifts the pen
    )
    return Geometry(nodes, lines)
