"""A real model of another code (3390 degrees of freedom): round trips, its own modes, and its two blocks as groups."""

import numpy as np
import pytest
from matrix_cases import SIERRA, block, sierra

from structid import Unknown, parameters
from structid.dynamics.normal_modes import modes
from structid.fem import from_matrices
from structid.fem.importers import (
    ImportedMatrix,
    Op4Options,
    dofs_of,
    on_dofs,
    read_matrices,
    read_matrix,
    total_mass,
    write_dmig,
    write_matrix,
    write_op4,
)
from structid.fem.importers.checks import require_semidefinite

pytestmark = pytest.mark.skipif(
    not SIERRA.exists(), reason="the Sierra/SD matrices (GPL) are not part of the package: shared/data is missing"
)


@pytest.fixture(scope="module")
def model():
    return sierra()


@pytest.fixture(scope="module")
def blocks(model):
    return [block(model[3], name) for name in ("hex_block1", "hex_block2")]


def test_sierra_matrices_go_through_every_format(model, tmp_path):
    stiffness, mass, table, _ = model
    pair = [ImportedMatrix("KAA", stiffness, table), ImportedMatrix("MAA", mass, table)]
    for options in (Op4Options(), Op4Options(layout="sparse", byte_order="big", words=64)):
        write_op4(tmp_path / "a.op4", pair, options)
        back = read_matrices(tmp_path / "a.op4")
        assert all(abs(back[item.name].matrix - item.matrix).nnz == 0 for item in pair)
    write_op4(tmp_path / "a.op4", [pair[0]], Op4Options(binary=False))
    assert abs(read_matrix(tmp_path / "a.op4").matrix - stiffness).nnz == 0
    write_matrix(tmp_path / "k.mtx", pair[0])
    assert abs(read_matrix(tmp_path / "k.mtx").matrix - stiffness).nnz == 0
    write_dmig(tmp_path / "a.pch", pair)
    for item, back in zip(pair, read_matrices(tmp_path / "a.pch").values(), strict=True):
        difference = (on_dofs(back, table) - item.matrix).tocoo()
        true = np.asarray(item.matrix[difference.row, difference.col])
        assert (abs(difference.data) <= 5e-12 * abs(true)).all()  # eleven or twelve digits fit a large field


def test_sierra_modes_and_mass_are_those_of_its_own_solver(model):
    stiffness, mass, table, mesh = model
    dofs = dofs_of(table)
    for direction in "XYZ":
        assert total_mass(mass, dofs, direction) == pytest.approx(30.4237, abs=5e-5)
    for name, matrix in (("stiffness", stiffness), ("mass", mass)):
        require_semidefinite(name, matrix, dofs)
    structure = from_matrices({"all": {"mass": mass, "stiffness": stiffness}}, dofs)
    found = modes(structure.matrix("mass"), structure.matrix("stiffness"), n_modes=50)
    np.testing.assert_allclose(found.frequency[6:], mesh["reference_freq_hz"][6:], rtol=1e-10)
    assert found.frequency[:6].max() < 1e-2


def test_sierra_stiffness_is_the_sum_of_its_two_blocks_in_elements_with_incompatible_modes(model, blocks):
    stiffness, mass, _, _ = model
    (first, first_mass, nodes, _), (second, second_mass, others, _) = blocks
    assert len(np.intersect1d(nodes, others)) == 25
    size = abs(stiffness).max()
    assert abs(first + second - stiffness).max() < 1e-13 * size
    # the density is known to seven digits only
    total = first_mass + second_mass
    np.testing.assert_allclose(total.sum() / mass.sum(), 1.0, rtol=2e-7)
    assert abs(total * (mass.sum() / total.sum()) - mass).max() < 1e-9 * abs(mass).max()
    assert [round(part.sum() / 3, 2) for part in (first_mass, second_mass)] == [13.52, 16.90]


def two_blocks(table, blocks, mesh):
    """The assembly as two groups, its unknown factors (the mass of block 1 is known), and factors to be found."""
    groups = {f"block {i}": {"stiffness": k, "mass": m} for i, (k, m, _, _) in enumerate(blocks, 1)}
    structure = from_matrices(groups, dofs_of(table), dict(enumerate(mesh["xyz_m"], 1)))
    unknowns = [Unknown("stiffness", "block 1"), Unknown("stiffness", "block 2"), Unknown("mass", "block 2")]
    return (
        structure,
        parameters(structure, [*unknowns, Unknown("mass", "block 1", fixed=True)]),
        np.array([0.9, 1.15, 1.05]),
    )


def part_of(structure):
    """Stiffness of block 1 and 2 and mass of block 2, in the order of the structure's degrees of freedom."""
    elastic = [part for part in structure.contributions if part.matrix_kind == "stiffness"]
    return [*elastic, [part for part in structure.contributions if part.matrix_kind == "mass"][1]]


def elastic_modes(structure, values, count):
    found = modes(structure.matrix("mass", values), structure.matrix("stiffness", values), n_modes=count + 6)
    return found.frequency[6:], found.mode_shapes[:, 6:]


def test_factors_of_both_sierra_blocks_follow_from_frequencies_and_one_known_mass(model, blocks):
    """Gauss-Newton on the logarithms of frequencies; slopes phi' (K_g - omega^2 M_g) phi / (2 omega^2)."""
    structure, unknown, truth = two_blocks(model[2], blocks, model[3])
    measured, seen = elastic_modes(structure, unknown.values(truth), 6)
    first, second, second_mass = (c.blocks.matrices[0] for c in part_of(structure))
    mass = structure.matrix("mass")
    theta = np.ones(3)
    for _ in range(4):
        frequency, shapes = elastic_modes(structure, unknown.values(theta), 9)
        pair = abs(seen.T @ mass @ shapes).argmax(axis=1)
        frequency, shapes = frequency[pair], shapes[:, pair]
        squared = (2 * np.pi * frequency) ** 2
        terms = [np.einsum("ij,ij->j", shapes, part @ shapes) for part in (first, second, second_mass)]
        slopes = np.stack([terms[0], terms[1], -squared * terms[2]], axis=1) / (2 * squared[:, None])
        step, *_ = np.linalg.lstsq(slopes, np.log(measured / frequency), rcond=None)
        theta = theta + step
    np.testing.assert_allclose(theta, truth, rtol=1e-6)
    assert structure.mass_of(unknown.values(theta)) == pytest.approx(13.52 + 1.05 * 16.90, abs=0.02)
