"""Solid meshes from scikit-fem as element sets: a plate in plane strain, and a block."""

import numpy as np
import skfem
from skfem.helpers import dot
from skfem.models.elasticity import lame_parameters, linear_elasticity

import structid as sid
from structid.fem.elements.element import (
    LOSS_FACTOR,
    ElementMatrixTerm,
    ElementSet,
    Nodes,
    Values,
    declared,
    element,
)

YOUNG, POISSON, DENSITY, LOSS = 70e9, 0.3, 2700.0, 0.02


@element
class Solid(ElementSet):
    """Elements with a factor on stiffness and on mass each, and one loss factor each."""

    nodes: Nodes = declared("Node labels")
    local: tuple = declared("Codes, stiffness and mass of each")
    density: Values = declared("Factor on the mass", "mass", "1", default=1.0)
    young: Values = declared("Factor on the stiffness", "stiffness", "1", default=1.0)
    loss_factor: Values = declared(*LOSS_FACTOR, default=LOSS)

    def matrices(self, positions, present):
        codes, stiffness, mass = self.local
        return {"density": (ElementMatrixTerm(codes, mass),), "young": (ElementMatrixTerm(codes, stiffness),)}


def solid(shape, size, groups=1, loss=LOSS):
    """A clamped plate (two numbers in `shape`) or block (three) of elements along each edge, in `groups` element sets.

    Parameters
    ----------
    shape : (2,) or (3,) sequence of int
    size : sequence of float, m
    groups : int
        Slices along the first axis.
    """
    axes = [np.linspace(0.0, length, count + 1) for count, length in zip(shape, size, strict=True)]
    if len(shape) == 2:
        mesh, one = skfem.MeshQuad.init_tensor(*axes), skfem.ElementQuad1()
    else:
        mesh, one = skfem.MeshHex.init_tensor(*axes), skfem.ElementHex1()
    basis = skfem.Basis(mesh, skfem.ElementVector(one), intorder=2)
    stiffness = linear_elasticity(*lame_parameters(YOUNG, POISSON)).coo_data(basis).tolocal()
    mass = DENSITY * skfem.BilinearForm(lambda u, v, w: dot(u, v)).coo_data(basis).tolocal()
    codes = np.empty(basis.N, dtype=int)
    for axis, dofs in enumerate(basis.nodal_dofs):
        codes[dofs] = 6 * np.arange(mesh.p.shape[1]) + axis
    local = codes[basis.element_dofs.T]
    middle = mesh.p[0][mesh.t].mean(axis=0)
    group = np.minimum((middle / size[0] * groups).astype(int), groups - 1)
    sets = [
        Solid(
            f"part{g + 1}",
            mesh.t.T[group == g],
            (local[group == g], stiffness[group == g], mass[group == g]),
            loss_factor=loss,
        )
        for g in range(groups)
    ]
    directions = ("X", "Y", "Z")[: len(shape)]
    held = [f"{node}{d}" for node in np.flatnonzero(mesh.p[0] < 1e-9) for d in directions]
    return sid.Structure(dict(enumerate(mesh.p.T)), sets, held, active=directions)


def spread_dofs(structure, count, direction="Y"):
    """`count` degrees of freedom in `direction`, spread over the free nodes."""
    usable = [dof for dof in structure.dofs if dof.direction == direction]
    return tuple(usable[i] for i in np.linspace(0, len(usable) - 1, count).astype(int))


def empty_record(structure, frequency, n_sensors, n_loads=1):
    """FRFs of ones at spread sensors, for the model to fill."""
    sensors = spread_dofs(structure, n_sensors)
    loads = spread_dofs(structure, n_loads + 2)[1:-1] if n_loads > 1 else sensors[-1:]
    values = np.ones((len(frequency), len(sensors), len(loads)))
    return sid.FrfRecord(np.asarray(frequency, float), values, sensors, loads, "receptance")


def group_unknowns(structure):
    """Stiffness and mass of every element set but the mass of the first."""
    names = [element.name for element in structure.elements]
    return [sid.Unknown("young", name) for name in names] + [sid.Unknown("density", name) for name in names[1:]]
