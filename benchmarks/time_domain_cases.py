"""Chains and meshes for `time_domain.py`, their dense regressions, and a pass in a process of its own."""

from __future__ import annotations

import numpy as np
from scipy import sparse

import structid as sid
from structid.forward.motion.equations import TimeEquations, time_equations

Rows = tuple[np.ndarray, sparse.csr_array, int]
PROPERTIES = ("mass", "mass_damping", "bending_stiffness")


def chain(n: int) -> tuple[sid.Structure, sid.Parameters]:
    """A cantilever of n beams with every mass, damping and stiffness unknown."""
    beam = sid.Beam("beam", np.stack([np.arange(n), np.arange(1, n + 1)], axis=1), 1.0, 1.0, mass_damping=1.0)
    structure = sid.Structure({i: float(i) for i in range(n + 1)}, [beam], ["0Y", "0RZ"], active=["Y", "RZ"])
    return structure, sid.parameters(structure, [sid.Unknown(p, "beam", each=True) for p in PROPERTIES])


def chain_rows(n: int) -> Rows:
    """Columns, operator and number of parameters of `chain`."""
    equations: TimeEquations = time_equations(*chain(n))
    return equations.columns, equations.operator, equations.unknown.n_params


def mesh_rows(cells: tuple[int, ...]) -> Rows:
    """The same of a block of quadrilaterals (two numbers) or bricks (three), all degrees of freedom free."""
    nodes = np.arange(np.prod([n + 1 for n in cells])).reshape([n + 1 for n in cells])
    corners = np.stack(np.meshgrid(*[[0, 1]] * len(cells), indexing="ij"), axis=-1).reshape(-1, len(cells))
    parts = [nodes[tuple(slice(c, n + c) for c, n in zip(corner, cells, strict=True))].ravel() for corner in corners]
    dofs = (np.stack(parts, axis=1)[:, :, None] * len(cells) + np.arange(len(cells))).reshape(len(parts[0]), -1)
    mass, stiffness = element_matrices(corners)
    n_elements, n_local = dofs.shape
    n = nodes.size * len(cells)
    row = np.broadcast_to(dofs[:, :, None], (n_elements, n_local, n_local))
    column = np.broadcast_to(dofs[:, None, :], row.shape)
    element = np.broadcast_to(np.arange(n_elements)[:, None, None], row.shape)
    entries = [
        (row, column + law * n, element * 3 + law, np.broadcast_to(matrix, row.shape))
        for law, matrix in enumerate((mass, stiffness, stiffness))
    ]
    row, field, parameter, value = (np.concatenate([e[k].ravel() for e in entries]) for k in range(4))
    keep = value != 0
    row, field, parameter, value = row[keep], field[keep], parameter[keep], value[keep]
    n_params = 3 * n_elements
    pairs = np.unique(row * n_params + parameter)
    first = np.searchsorted(pairs // n_params, np.arange(n))
    width = int(np.bincount(pairs // n_params).max())
    columns = np.full((n, width), -1)
    columns[pairs // n_params, np.arange(len(pairs)) - first[pairs // n_params]] = pairs % n_params
    slot = np.searchsorted(pairs, row * n_params + parameter) - first[row]
    at = np.concatenate([row * (width + 1) + slot, np.arange(n) * (width + 1) + width])
    table = (np.concatenate([value, np.ones(n)]), (at, np.concatenate([field, 3 * n + np.arange(n)])))
    return columns, sparse.csr_array(sparse.coo_array(table, (n * (width + 1), 4 * n))), n_params


def element_matrices(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mass and stiffness of a linear unit cell, Young's modulus 1, Poisson's ratio 0.3, plane strain in 2-D."""
    dimension = corners.shape[1]
    lame = 0.3 / (1.3 * 0.4), 1 / 2.6
    points = (corners - 0.5) / np.sqrt(3) + 0.5
    mass = np.zeros((len(corners) * dimension,) * 2)
    stiffness = np.zeros_like(mass)
    for point in points:
        factor = np.where(corners == 1, point, 1 - point)
        shape = factor.prod(axis=1)
        sign = np.where(corners == 1, 1.0, -1.0)
        slope = np.stack([sign[:, i] * np.delete(factor, i, axis=1).prod(axis=1) for i in range(dimension)], axis=1)
        mass += np.kron(np.outer(shape, shape), np.eye(dimension)) / len(points)
        strain = np.einsum("ai,jk->ijak", slope, np.eye(dimension))  # d u_k,i of corner a, direction j = k
        sym = (strain + np.swapaxes(strain, 0, 1)) / 2
        flat = sym.reshape(dimension, dimension, -1)
        trace = np.einsum("iia->a", flat)
        energy = 2 * lame[1] * np.einsum("ija,ijb->ab", flat, flat) + lame[0] * np.outer(trace, trace)
        stiffness += energy / len(points)
    return mass, stiffness


def dense_rows(
    columns: np.ndarray, operator: sparse.csr_array, n_params: int, fields: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The textbook's matrix B and right-hand side c."""
    n, width = columns.shape
    rows = (operator @ fields).reshape(n, width + 1, -1)
    dense = np.zeros((n, fields.shape[1], n_params))
    for slot in range(width):
        used = np.flatnonzero(columns[:, slot] >= 0)
        dense[used, :, columns[used, slot]] = rows[used, slot]
    return dense.reshape(-1, n_params), rows[:, -1].ravel()


#: Prints by how many bytes the resident memory grows while a record on disk is reduced and solved.
PASS_IN_A_PROCESS = """
import ctypes, gc, sys, threading, time
import numpy as np
from structid import Beam, Structure, TimeRecord, Unknown, parameters
from structid.inversion.regression.local_reduction import FoldingKernels
from structid.forward import motion_fit
from structid.forward.motion.stream import motion_solution, reduced_by_chunks
from structid.records.formats import ReadOptions
from structid.records.on_disk import MemoryRecord, open_record
n, path = int(sys.argv[1]), sys.argv[2]
beam = Beam("beam", np.stack([np.arange(n), np.arange(1, n + 1)], axis=1), 1.0, 1.0, mass_damping=1.0)
structure = Structure({i: float(i) for i in range(n + 1)}, [beam], ["0Y", "0RZ"], active=["Y", "RZ"])
unknown = parameters(structure, [Unknown(p, "beam", each=True) for p in ("mass", "mass_damping", "bending_stiffness")])
names = tuple(str(dof) for dof in structure.dofs)
kinds = tuple(np.repeat(["acceleration", "velocity", "displacement", "force"], len(names)).tolist())
record = open_record(path, ReadOptions(sampling_rate=1.0, channels=names * 4, quantities=kinds))
work = FoldingKernels("numba")
beam = Beam("beam", [[0, 1], [1, 2], [2, 3]], 1.0, 1.0, mass_damping=1.0)
small = Structure({i: float(i) for i in range(4)}, [beam], ["0Y", "0RZ"], active=["Y", "RZ"])
few = tuple(str(dof) for dof in small.dofs)
kinds = tuple(np.repeat(["acceleration", "velocity", "displacement", "force"], len(few)).tolist())
values = np.random.default_rng(0).standard_normal((64, 4 * len(few)))
short = MemoryRecord(TimeRecord(1.0, values, few * 4, kinds))
properties = ("mass", "mass_damping", "bending_stiffness")
loaded = motion_fit(small, parameters(small, [Unknown(p, "beam", each=True) for p in properties]))
motion_solution(reduced_by_chunks(loaded, small, short, work), work)  # loads and compiles
def resident():
    return int(open("/proc/self/statm").read().split()[1]) * 4096
gc.collect()
ctypes.CDLL(None).malloc_trim(0)  # memory that is free already does not count as there before
before, peak, done = resident(), [0], threading.Event()
def watch():
    while not done.is_set():
        peak[0] = max(peak[0], resident())
        time.sleep(0.001)
thread = threading.Thread(target=watch)
thread.start()
motion_solution(reduced_by_chunks(motion_fit(structure, unknown), structure, record, work), work)
done.set()
thread.join()
print(peak[0] - before)
"""
