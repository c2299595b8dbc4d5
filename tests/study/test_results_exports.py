"""Files of an identified model, read back by other libraries: meshio, pyuff, SciPy, and columns cut by hand."""

import csv
import json

import meshio
import numpy as np
import pytest
import pyuff
from scipy import sparse
from scipy.io import loadmat, mmread
from scipy.linalg import eigh

from structid.core.errors import FileError
from structid.fem import Beam, PointMass, RigidLink, Shell, Solid, SpaceBeam, Spring, Structure
from structid.fem.importers import read_matrices, read_matrix, read_numbering
from structid.fem.meshes import read_mesh
from structid.modal.formats.files import read_modes
from structid.modal.formats.options import ModeFileOptions
from structid.prediction.identified_model import identified_model
from structid.prediction.predict import parameter_points, predict
from structid.prediction.quantities import NaturalModes
from structid.study.results.stored_model import ParameterSpread
from structid.study.run.exports import (
    export_matrices,
    export_mesh,
    export_modes,
    matrix_files,
    model_modes,
    modes_covariance,
)
from structid.unknowns import Unknown, parameters

STD, RATIO = 0.02, {"deck": 0.9, "post": 1.1, "spring": 1.3}


@pytest.fixture(scope="module")
def model():
    """A table of shells on two posts, one on a spring, with a block and a mass; three parameters are 10 and 30 % off."""
    nodes = {10 * i + j: (0.5 * i, 0.4 * j, 1.0) for i in range(1, 4) for j in range(1, 3)}
    nodes |= {101: (0.5, 0.4, 0.0), 102: (1.5, 0.4, 0.0), 103: (0.5, 0.4, 1.3)}
    nodes |= {200 + 4 * k + i: (0.5 + 0.1 * x, 0.4 + 0.1 * y, 1.3 + 0.1 * k) for k in range(2)
              for i, (x, y) in enumerate([(0, 0), (1, 0), (1, 1), (0, 1)])}  # fmt: skip
    post = {"mass": 8.0, "bending_stiffness_y": 2e5, "bending_stiffness_z": 3e5, "axial_stiffness": 2e8,
            "torsional_stiffness": 1.6e5, "polar_inertia": 0.02}  # fmt: skip
    elements = [
        Shell(
            "deck",
            [[11, 21, 22, 12], [21, 31, 32, 22]],
            youngs_modulus=7e10,
            density=2700.0,
            thickness=0.01,
            poisson=0.3,
        ),
        SpaceBeam("post", [[101, 11], [102, 31]], orientation=[1.0, 0.0, 0.0], **post),
        Spring("spring", "102Z", stiffness=1e7, loss_factor=0.02),
        Solid("block", [[200, 201, 202, 203, 204, 205, 206, 207]], youngs_modulus=7e10, density=2700.0, poisson=0.3),
        PointMass("load", [22], mass=3.0),
    ]
    fixed = [
        *(f"101{d}" for d in ("X", "Y", "Z", "RX", "RY", "RZ")),
        *(f"102{d}" for d in ("X", "Y", "RX", "RY", "RZ")),
    ]
    ties = [RigidLink("foot", 11, [200, 201, 202, 203, 103])]
    structure = Structure(nodes, elements, fixed, ties)
    unknowns = [
        Unknown("youngs_modulus", "deck", each=True),
        Unknown("bending_stiffness_y", "post"),
        Unknown("stiffness", "spring"),
    ]
    unknown = parameters(structure, unknowns)
    factors = np.array([RATIO["deck"], RATIO["deck"], RATIO["post"], RATIO["spring"]])
    covariance = np.diag((STD * unknown.start) ** 2)
    made = identified_model(
        structure, unknown, factors * unknown.start, covariance, {"density[deck]": 0.01}, np.zeros((4, 1))
    )
    return made, ParameterSpread(unknown.start, covariance)


def frequencies_of(matrices, n_modes=10):
    """Natural frequencies by a dense solution."""
    mass, stiffness = (matrices[name] for name in ("MAA", "KAA"))
    return np.sqrt(np.abs(eigh(stiffness.toarray(), mass.toarray(), eigvals_only=True)[:n_modes])) / (2 * np.pi)


def test_grid_read_by_meshio_has_every_element_with_its_change(model, tmp_path):
    identified, spread = model
    structure = identified.structure
    (line,) = export_mesh(identified, spread, 4, tmp_path / "table.vtu")
    assert "16 nodes" not in line
    assert "`element_set` is 1 deck, 2 post, 3 spring, 4 block, 5 load" in line
    grid = meshio.read(tmp_path / "table.vtu")
    labels = grid.point_data["node_id"]
    np.testing.assert_array_equal(grid.points, [structure.nodes[label] for label in labels.tolist()])
    assert [block.type for block in grid.cells] == ["quad", "line", "vertex", "hexahedron", "vertex"]
    for block, element in zip(grid.cells, structure.elements, strict=True):
        np.testing.assert_array_equal(
            labels[block.data], np.where(element.nodes < 0, 0, element.nodes)[:, : block.data.shape[1]]
        )
    data = {name: np.concatenate(parts) for name, parts in grid.cell_data.items()}
    sets = data["element_set"]
    assert sets.tolist() == [1, 1, 2, 2, 3, 4, 5]
    modulus, change = data["youngs_modulus [Pa]"], data["youngs_modulus relative change"]
    np.testing.assert_allclose(modulus[sets == 1], 7e10 * RATIO["deck"], rtol=1e-14)
    np.testing.assert_allclose(change[:2], -0.1, rtol=1e-12)
    assert np.isnan(change[2:]).all()
    np.testing.assert_allclose(data["bending_stiffness_y deviation [N m^2]"][2:4], STD * 2e5, rtol=1e-12)
    np.testing.assert_allclose(data["bending_stiffness_y significance"][2:4], 0.1 / STD, rtol=1e-12)
    assert (data["mass [kg/m]"][2], data["mass [kg]"][6]) == (8.0, 3.0)
    np.testing.assert_allclose(data["stiffness [N/m]"][4], 1.3e7)
    assert "mass_damping [N s/m^4]" not in data  # 0 throughout, and not sought
    np.testing.assert_allclose(data["stiffness significance"][4], 0.3 / STD)
    np.testing.assert_allclose(data["density [kg/m^3]"][5], 2700.0)
    computed = model_modes(identified, 4)
    for number, hertz in enumerate(computed.frequency, 1):
        motion = grid.point_data[f"mode {number:02d}: {hertz:.5g} Hz"]
        at = {label: motion[row] for row, label in enumerate(labels.tolist())}
        assert not at[101].any()
        free = structure.dofs.index(next(dof for dof in structure.dofs if str(dof) == "22Y+"))
        assert at[22][1] == computed.mode_shapes[free, number - 1]
        turn = np.array([computed.mode_shapes[structure.dofs.index(dof), number - 1] for dof in structure.dofs
                         if dof.node == 11])  # fmt: skip
        arm = np.array(structure.nodes[201]) - np.array(structure.nodes[11])
        np.testing.assert_allclose(at[201], turn[:3] + np.cross(turn[3:], arm), atol=1e-12 * np.abs(turn).max())


def test_grid_is_a_mesh_for_structid_again(model, tmp_path):
    export_mesh(*model, 2, tmp_path / "table.vtu")
    mesh = read_mesh(tmp_path / "table.vtu")
    np.testing.assert_array_equal(mesh.cells("element_set=1"), model[0].structure.elements[0].nodes)


def test_table_of_elements_says_the_same_as_the_grid(model, tmp_path):
    export_mesh(*model, 0, tmp_path / "table.csv")
    with (tmp_path / "table.csv").open() as stream:
        rows = {(row["element set"], row["element"], row["property"]): row for row in csv.DictReader(stream)}
    spring = rows["spring", "1", "stiffness"]
    assert [float(spring[key]) for key in ("value", "deviation", "initial")] == pytest.approx([1.3e7, STD * 1e7, 1e7])
    assert float(rows["deck", "2", "youngs_modulus"]["relative change"]) == pytest.approx(-0.1)
    density = rows["deck", "1", "density"]
    assert (float(density["deviation"]), density["significance"]) == (pytest.approx(27.0), "")  # by its tolerance


def test_modes_read_by_pyuff_and_from_the_columns_of_a_punch_file(model, tmp_path):
    identified, _ = model
    computed = model_modes(identified, 5)
    for name in ("table.uff", "table.pch", "table.csv", "table.json"):
        export_modes(identified, 5, "Table", tmp_path / name)
    sets = [one for one in pyuff.UFF(str(tmp_path / "table.uff")).read_sets() if one["type"] == 55]
    punched = _punched(tmp_path / "table.pch")
    complete = json.loads((tmp_path / "table.json").read_text())
    table = read_modes(tmp_path / "table.csv")
    assert (len(sets), len(punched)) == (5, 5)
    for k, (stored, (eigenvalue, rows)) in enumerate(zip(sets, punched, strict=True)):
        assert stored["freq"] == pytest.approx(computed.frequency[k], rel=1e-5)
        assert stored["modal_damp_vis"] == pytest.approx(computed.damping_ratio[k], rel=1e-5)
        assert np.sqrt(eigenvalue) / (2 * np.pi) == pytest.approx(computed.frequency[k], rel=1e-7)
        node = stored["node_nums"].tolist().index(32)
        for axis, (direction, key) in enumerate(zip("XYZ", ("r1", "r2", "r3"), strict=True)):
            row = [str(dof) for dof in identified.structure.dofs].index(f"32{direction}+")
            value = computed.mode_shapes[row, k]
            assert stored[key][node] == pytest.approx(value, rel=1e-5, abs=1e-12)
            assert rows[32][axis] == pytest.approx(value, rel=1e-6, abs=1e-12)
            assert table.mode_shapes[[str(dof) for dof in table.channels].index(f"32{direction}+"), k] == pytest.approx(
                value
            )
    np.testing.assert_array_equal(complete["frequency_hz"], computed.frequency)
    drawn = predict(identified, NaturalModes(5), n_draws=150).std[:, 0]
    np.testing.assert_allclose(complete["frequency_std_hz"], drawn, rtol=0.25)
    np.testing.assert_allclose(np.sqrt(np.diag(table.covariance))[:5], complete["frequency_std_hz"])
    again = read_modes(tmp_path / "table.pch", ModeFileOptions(length_unit="m"))
    np.testing.assert_allclose(again.frequency, computed.frequency, rtol=1e-7)
    assert len(again.channels) > 3 * 13


@pytest.mark.parametrize("force", [-10.0, 10.0])
def test_an_axial_force_of_either_sign_moves_by_its_deviation(force):
    """Points of a reduction, and deviations of exported modes beside those of random models."""
    beam = Beam("mast", [[i, i + 1] for i in range(4)], mass=6.0, bending_stiffness=200.0, axial_force=force)
    structure = Structure({i: 0.5 * i for i in range(5)}, [beam], fixed=["0Y", "0RZ"])
    unknown = parameters(structure, [Unknown("axial_force", "mast")])
    made = identified_model(structure, unknown, unknown.start, np.array([[4.0]]))
    nominal, moved = (point.tolist() for point in parameter_points(made))
    assert (nominal, [abs(moved[0] - force)]) == ([force], [pytest.approx(4.0)])
    drawn = predict(made, NaturalModes(2), n_draws=300).std[:, 0]
    np.testing.assert_allclose(np.sqrt(np.diag(modes_covariance(made, 2)))[:2], drawn, rtol=0.15)


def test_a_vague_positive_parameter_stays_positive_at_the_points_of_a_reduction():
    sets = [PointMass("m", [1], mass=2.0), Spring("k", "1X", stiffness=8e3)]
    structure = Structure({1: 0.0}, sets, active=["X"])
    for limits in ({}, {"bounds": (1.0, 1e5)}):
        unknown = parameters(structure, [Unknown("stiffness", "k", **limits)])
        made = identified_model(structure, unknown, unknown.start, np.array([[8e3**2]]))
        signs = [made.moved_parameters(np.array([z])).item() for z in (-2.0, 2.0)]
        assert sorted(signs) == pytest.approx([8.0, 24e3])


def _punched(path):
    """Eigenvalue, and six numbers of each grid point, of every vector of a punch file, by its columns."""
    vectors, node = [], 0
    for line in path.read_text().splitlines():
        assert len(line) == 80
        if line.startswith("$EIGENVALUE"):
            vectors.append((float(line.split("=")[1].split()[0]), {}))
        elif not line.startswith("$"):
            numbers = [float(line[18 * k : 18 * k + 18]) for k in (1, 2, 3)]
            if line.startswith("-CONT-"):
                vectors[-1][1][node] += numbers
            else:
                node = int(line[:10])
                assert line[17] == "G"
                vectors[-1][1][node] = numbers
    return vectors


@pytest.mark.parametrize("suffix", [".op4", ".pch", ".mat", ".inp", ".mtx", ".npz", ".npy"])
def test_matrices_of_every_format_give_the_frequencies_of_the_model(model, tmp_path, suffix):
    identified, _ = model
    lines = export_matrices(identified, tmp_path / f"table{suffix}")
    assert "K4AA" in lines[0]
    read = {
        ".op4": lambda: {name: item.matrix for name, item in read_matrices(tmp_path / "table.op4").items()},
        ".pch": lambda: {name: item.matrix for name, item in read_matrices(tmp_path / "table.pch").items()},
        ".mat": lambda: {k: v for k, v in loadmat(tmp_path / "table.mat").items() if k.endswith("AA")},
        ".mtx": lambda: {n: sparse.csc_array(mmread(tmp_path / f"table_{n}.mtx")) for n in ("MAA", "KAA", "K4AA")},
        ".npz": lambda: {n: sparse.load_npz(tmp_path / f"table_{n}.npz") for n in ("MAA", "KAA", "K4AA")},
        ".npy": lambda: {n: sparse.csc_array(np.load(tmp_path / f"table_{n}.npy")) for n in ("MAA", "KAA", "K4AA")},
        ".inp": lambda: {n: read_matrix(tmp_path / f"table_{n}.mtx").matrix for n in ("MAA", "KAA", "K4AA")},
    }[suffix]()
    assert set(read) == {"MAA", "KAA", "K4AA"}
    assert all(abs(matrix - matrix.T).max() == 0 for matrix in read.values())  # form 6, one triangle
    expected = model_modes(identified, 10).frequency
    np.testing.assert_allclose(frequencies_of(read), expected, rtol=1e-6 if suffix == ".pch" else 1e-9)
    written = [path for path in matrix_files(tmp_path / f"table{suffix}") if path.exists()]
    assert sorted(written) == sorted(tmp_path.iterdir())
    numbering = read_numbering(tmp_path / "table.dofs.txt")
    assert [str(dof) for dof in numbering] == [str(dof.unsigned) for dof in identified.structure.dofs]


def test_what_cannot_be_written_is_named(model, tmp_path):
    for export, name in ((export_matrices, "a.xyz"), (lambda m, p: export_mesh(m, model[1], 1, p), "a.vtk")):
        with pytest.raises(FileError, match="the suffix must be one of"):
            export(model[0], tmp_path / name)
    with pytest.raises(FileError, match="is of no format for modes"):
        export_modes(model[0], 2, "", tmp_path / "a.vtu")
    assert not list(tmp_path.iterdir())
