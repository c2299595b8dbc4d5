"""Meshes: files of every format, node numbers and groups kept, and what is wrong with a mesh named with the remedy."""

import builtins

import numpy as np
import pytest

from structid import Shell, Structure
from structid.core.errors import FileError, InputError
from structid.fem.meshes import (
    FORMATS,
    CellBlock,
    Mesh,
    describe_unassigned_cells,
    duplicate_nodes,
    orphan_nodes,
    read_mesh,
    require_sound,
)

GMSH_41 = """$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
3
1 3 "clamped edge"
2 1 "skin"
2 2 "doubler"
$EndPhysicalNames
$Entities
0 1 2 0
7 0 0 0 0 1 0 1 3 0
1 0 0 0 1 1 0 1 1 0
2 1 0 0 2 1 0 1 2 0
$EndEntities
$Nodes
2 6 10 60
2 1 0 4
10
20
30
40
0 0 0
1 0 0
1 1 0
0 1 0
2 2 0 2
60
50
2 0 0
2 1 0
$EndNodes
$Elements
3 4 1 4
1 7 1 1
1 10 40
2 1 3 1
2 10 20 30 40
2 2 2 2
3 20 60 30
4 60 50 30
$EndElements
"""
GMSH_22 = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
1
2 1 "skin"
$EndPhysicalNames
$Nodes
6
10 0 0 0
20 1 0 0
30 1 1 0
40 0 1 0
60 2 0 0
50 2 1 0
$EndNodes
$Elements
4
1 1 2 3 7 10 40
2 3 2 1 1 10 20 30 40
3 2 2 2 2 20 60 30
4 2 2 2 2 60 50 30
$EndElements
"""
NASTRAN = """SOL 103
BEGIN BULK
$ a plate
GRID,10,,0.,0.,0.
GRID,20,,1.,0.,0.
GRID          30              1.      1.      0.
GRID          40              0.      1.      0.
GRID          60              2.      0.      0.
GRID          50              2.      1.      0.
CQUAD4         1       1      10      20      30      40
CTRIA3         2       2      20      60      30
CTRIA3         3       2      60      50      30
ENDDATA
"""
ABAQUS = """*HEADING
a plate
** comment
*NODE, NSET=all
10, 0., 0., 0.
20, 1., 0., 0.
30, 1., 1., 0.
40, 0., 1.
60, 2., 0., 0.
50, 2., 1., 0.
*Element, type=S4R, elset=skin
1, 10, 20, 30, 40
*ELEMENT, TYPE=S3
2, 20, 60, 30
3, 60, 50,
30
*ELSET, ELSET=doubler, GENERATE
2, 3, 1
*ELSET, ELSET=all cells
skin, doubler
*NSET, NSET=clamped edge
10, 40
*STEP
"""


def columns(*numbers):
    return "".join(f"{n:10d}" for n in numbers)


def universal(*datasets):
    """Datasets of number and lines."""
    return "".join(f"    -1\n{number:6d}\n" + "\n".join(lines) + "\n    -1\n" for number, lines in datasets)


_POINTS = {10: (0, 0), 20: (1, 0), 30: (1, 1), 40: (0, 1), 60: (2, 0), 50: (2, 1)}
_POINT_LINES = [
    line
    for n, (x, y) in _POINTS.items()
    for line in (columns(n, 1, 1, 11), f"{x:25.16E}{y:25.16E}{0:25.16E}".replace("E", "D"))
]
UNIVERSAL = universal(
    (2411, _POINT_LINES),
    (2412, [columns(1, 94, 1, 1, 7, 4), columns(10, 20, 30, 40), columns(2, 91, 1, 1, 7, 3), columns(20, 60, 30),
            columns(3, 91, 1, 1, 7, 3), columns(60, 50, 30), columns(9, 161, 1, 1, 7, 1), columns(60)]),
    (2467, [columns(7, 0, 0, 0, 0, 0, 0, 0), "an empty group and its line", "",
            columns(1, 0, 0, 0, 0, 0, 0, 1), "skin", columns(8, 1, 0, 0), columns(2, 0, 0, 0, 0, 0, 0, 2), "doubler",
            columns(8, 2, 0, 0, 8, 3, 0, 0), columns(3, 0, 0, 0, 0, 0, 0, 2), "clamped edge",
            columns(7, 40, 0, 0, 7, 10, 0, 0)]),
)  # fmt: skip


def written(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    "name, text, skin, doubler, edge",
    [
        ("a.msh", GMSH_41, "skin", "doubler", "clamped edge"),
        ("b.msh", GMSH_22, "skin", "2", "3"),
        ("c.bdf", NASTRAN, "1", "2", None),
        ("d.inp", ABAQUS, "skin", "doubler", "clamped edge"),
        ("e.unv", UNIVERSAL, "skin", "doubler", "clamped edge"),
    ],
)
def test_files_keep_node_numbers_and_groups(tmp_path, name, text, skin, doubler, edge):
    mesh = read_mesh(written(tmp_path, name, text), "mm")
    assert mesh.nodes[60] == pytest.approx([0.002, 0.0, 0.0])
    assert mesh.nodes[50] == pytest.approx([0.002, 0.001, 0.0])
    assert mesh.cells(skin).tolist() == [[10, 20, 30, 40]]
    assert mesh.cells(doubler).tolist() == [[20, 60, 30], [60, 50, 30]]
    assert sorted(map(tuple, mesh.cells().tolist())) == [(10, 20, 30, 40), (20, 60, 30, -1), (60, 50, 30, -1)]
    if edge:
        assert mesh.group_nodes(edge).tolist() == [10, 40]
    assert mesh.dimension == 2
    assert require_sound(mesh) is mesh


def test_abaqus_sets_of_sets_join_blocks(tmp_path):
    mesh = read_mesh(written(tmp_path, "d.inp", ABAQUS))
    assert len(mesh.cells("all cells")) == 3
    assert mesh.group_nodes("all").tolist() == [10, 20, 30, 40, 50, 60]


def text_of_grid(tmp_path, suffix):
    meshio = pytest.importorskip("meshio")
    points = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 1, 0], [2, 0, 0]]
    cells = [("quad", [[0, 1, 2, 3]]), ("triangle", [[1, 5, 2], [5, 4, 2]])]
    data = {"node_id": np.array([10, 20, 30, 40, 50, 60])}
    meshio.write(tmp_path / f"grid{suffix}", meshio.Mesh(np.array(points, float), cells, point_data=data))
    return (tmp_path / f"grid{suffix}").read_bytes()


#: The plate in every format, by the first suffix of the format.
SAMPLES = {
    ".msh": lambda folder, suffix: GMSH_41.encode(),
    ".bdf": lambda folder, suffix: NASTRAN.encode(),
    ".inp": lambda folder, suffix: ABAQUS.encode(),
    ".vtu": text_of_grid,
    ".unv": lambda folder, suffix: UNIVERSAL.encode(),
}


@pytest.mark.parametrize("module, suffix", [pytest.param(m, s, id=s) for m in FORMATS for s in m.SUFFIXES])
def test_every_format_gives_the_same_mesh_and_tells_a_file_that_is_cut(tmp_path, module, suffix):
    content = SAMPLES[module.SUFFIXES[0]](tmp_path, suffix)
    path = tmp_path / f"plate{suffix.upper()}"
    path.write_bytes(content)
    mesh = read_mesh(path, "cm")
    assert mesh.nodes[60] == pytest.approx([0.02, 0.0, 0.0])
    assert sorted(map(tuple, mesh.cells().tolist())) == [(10, 20, 30, 40), (20, 60, 30, -1), (60, 50, 30, -1)]
    assert mesh.source == path.name
    path.write_bytes(content[: len(content) // 3])
    with pytest.raises(FileError) as error:
        require_sound(read_mesh(path))
    assert str(error.value).startswith(f"{path}")


@pytest.mark.parametrize("suffix", ["vtu", "vtk", "msh", "bdf"])
def test_meshes_of_meshio_come_back(tmp_path, suffix):
    meshio = pytest.importorskip("meshio")
    rng = np.random.default_rng(1)
    points = rng.standard_normal((9, 3)).round(3)
    cells = [("hexahedron", [[0, 1, 2, 3, 4, 5, 6, 7]]), ("tetra", [[0, 1, 2, 8], [1, 2, 3, 8]])]
    data = {"part": [np.array([4]), np.array([5, 4])]} if suffix in ("vtu", "vtk") else {}
    path = tmp_path / f"mesh.{suffix}"
    options = {"file_format": "gmsh22", "binary": False} if suffix == "msh" else {}
    meshio.write(path, meshio.Mesh(points, cells, cell_data=data), **options)
    mesh = read_mesh(path)
    assert mesh.labels.tolist() == list(range(1, 10))
    assert mesh.positions == pytest.approx(points, abs=1e-6)
    assert [b.kind for b in mesh.blocks] == ["hexahedron", "tetra"]
    assert mesh.cells().shape == (3, 8)
    if data:
        assert [len(mesh.cells(f"part={k}")) for k in (4, 5)] == [2, 1]


@pytest.mark.parametrize(
    "name, change, words",
    [
        ("a.msh", lambda t: t[:-20], "is cut short: $Elements is not closed; copy the file again"),
        ("a.msh", lambda t: t[: t.index("60\n50")], "is cut short: $Nodes is not closed; copy the file again"),
        ("a.msh", lambda t: t[: t.index("$Elements")], "is cut short: there is no $Elements; copy the file again"),
        (
            "a.msh",
            lambda t: t.replace("4.1 0 8", "4.1 1 8"),
            "cannot be read as gmsh (the number one is missing behind $MeshFormat)",
        ),
        (
            "a.msh",
            lambda t: t.replace("2 10 20 30 40", "2 10 20 30 45"),
            "lacks node 45 of 1 cell of type quad (the first has nodes 10, 20, 30, 45); save the mesh again with all its nodes",
        ),
        (
            "a.msh",
            lambda t: t.replace("20 60 30\n4 60 50 30", "20 61 30\n4 61 51 30"),
            "lacks node 51, 61 of 2 cells of type triangle (the first has nodes 20, 61, 30); save the mesh again",
        ),
        ("c.bdf", lambda t: t.replace("BEGIN BULK", "CEND"), "there is a CEND but no BEGIN BULK behind it"),
        (
            "c.bdf",
            lambda t: t.replace("GRID,10,,", "GRID,10,7,"),
            "coordinate system 7 is not in the file; export its CORD card",
        ),
        ("c.bdf", lambda t: t.replace("      40\n", "      4Q\n", 1), "field 7 must be a whole number, got '4Q'"),
        (
            "c.bdf",
            lambda t: t.replace("CTRIA3         2       2      20", "CTRIA3         2       2        "),
            "lacks some",
        ),
        ("c.bdf", lambda t: t.replace("$ a plate", "INCLUDE 'rest.bdf'"), "line 3: the included file cannot be read"),
        ("d.inp", lambda t: t.replace("*STEP", "*INCLUDE, INPUT=rest.inp"), "the included file cannot be read"),
        ("d.inp", lambda t: t.replace("*STEP", "*NGEN"), "*NGEN is not read"),
        ("d.inp", lambda t: t.replace("30\n*ELSET", "\n*ELSET", 1), "element 3 has 2 nodes instead of 3"),
        (
            "d.inp",
            lambda t: t + "*NODE\n10, 0., 0.\n",
            "node 10 stands twice, as it does where a file has several parts",
        ),
        ("d.inp", lambda t: t.replace("skin, doubler", "skins"), "there is no set 'skins' before this line"),
        ("d.inp", lambda t: "*HEADING\n", "holds no *NODE and *ELEMENT lines"),
        ("d.txt", lambda t: t, "the suffix of a mesh must be one of .msh .bdf"),
    ],
)
def test_bad_files_are_told_with_the_remedy(tmp_path, name, change, words):
    text = {"a": GMSH_41, "c": NASTRAN, "d": ABAQUS}[name[0]]
    with pytest.raises(FileError) as error:
        read_mesh(written(tmp_path, name, change(text)))
    assert words in str(error.value)
    assert str(error.value).startswith(str(tmp_path / name))


def test_files_cut_anywhere_give_a_mesh_or_an_input_error(tmp_path):
    refused = {}
    for name, text in (("a.msh", GMSH_41), ("b.msh", GMSH_22), ("c.bdf", NASTRAN), ("d.inp", ABAQUS)):
        ends = range(1, len(text) - 10, 23)
        refused[name] = []
        for end in ends:
            try:
                require_sound(read_mesh(written(tmp_path, name, text[:end])))
            except InputError as error:
                refused[name].append(str(error))
        if name not in ("c.bdf", "d.inp"):  # which need no end
            assert len(refused[name]) == len(ends)


def test_without_meshio_the_message_says_how_to_install_it(tmp_path, monkeypatch):
    real = builtins.__import__

    def missing(name, *given, **options):
        if name == "meshio":
            raise ImportError(name)
        return real(name, *given, **options)

    monkeypatch.setattr("importlib.import_module", missing)
    with pytest.raises(
        FileError, match=r"vtu files need the package meshio; install it by `pip install structid\[mesh\]`"
    ):
        read_mesh(written(tmp_path, "a.vtu", "<VTKFile>"))


def mesh_of(points, *blocks, groups=None):
    labels = np.arange(1, len(points) + 1)
    made = tuple(CellBlock(kind, np.array(nodes)) for kind, nodes in blocks)
    return Mesh(labels, np.array(points, dtype=float), made, groups or {}, {}, "test.msh")


TWO = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (1, 0, 0), (2, 0, 0), (2, 1, 0), (1, 1, 0)]


def test_nodes_at_one_place_are_refused_merged_or_kept():
    mesh = mesh_of(TWO, ("quad", [[1, 2, 3, 4], [5, 6, 7, 8]]))
    assert duplicate_nodes(mesh).tolist() == [[2, 5], [3, 8]]
    with pytest.raises(InputError, match=r"nodes 2 and 5, 3 and 8 of test.msh lie at one place \(2 pairs in all\)"):
        require_sound(mesh)
    assert require_sound(mesh, duplicates="keep") is mesh
    merged = require_sound(mesh, duplicates="merge")
    assert merged.cells().tolist() == [[1, 2, 3, 4], [2, 6, 7, 3]]
    assert merged.labels.tolist() == [1, 2, 3, 4, 6, 7]


def test_orphans_are_refused_or_dropped():
    mesh = mesh_of([*TWO[:4], (9, 9, 9)], ("quad", [[1, 2, 3, 4]]))
    assert orphan_nodes(mesh).tolist() == [5]
    with pytest.raises(InputError, match=r"node 5 of test.msh belongs to no cell; delete them in the mesher, or set"):
        require_sound(mesh)
    assert require_sound(mesh, drop_orphans=True).labels.tolist() == [1, 2, 3, 4]


def test_missing_nodes_and_groups_and_unknown_cells_are_named():
    with pytest.raises(InputError, match=r"cells of test.msh name node 9, which it does not have"):
        require_sound(mesh_of(TWO[:4], ("quad", [[1, 2, 3, 9]])))
    groups = {"skin": (np.array([0]), np.array([], int)), "core": (np.array([], int), np.array([0]))}
    mesh = mesh_of(TWO[:4], ("quad", [[1, 2, 3, 4]]), ("polygon4", [[1, 2, 3, 4]]), groups=groups)
    with pytest.raises(
        InputError, match=r"there is no group of cells 'skim' in test.msh; the nearest is 'skin'; it has skin"
    ):
        mesh.cells("skim")
    with pytest.raises(InputError, match=r"cells of type 'polygon4' in test.msh cannot be used; mesh with one of"):
        mesh.cells("core")


def test_cells_without_an_element_set_are_told():
    groups = {"skin": (np.array([0]),), "rib": (np.array([1]),)}
    mesh = mesh_of(TWO, ("quad", [[1, 2, 3, 4], [5, 6, 7, 8]]), groups=groups)
    assert describe_unassigned_cells(mesh, [mesh.cells("skin")]) == "1 cells (quad), in group rib"
    assert describe_unassigned_cells(mesh, [mesh.cells()]) is None


def test_the_nearest_node_comes_with_its_distance_and_the_size_of_the_cells():
    mesh = mesh_of(TWO[:4], ("quad", [[1, 2, 3, 4]]))
    label, distance, size = mesh.nearest([1.1, 0.9, 0.0])
    assert (label, size) == (3, 1.0)
    assert distance == pytest.approx(np.hypot(0.1, 0.1))
    assert mesh.nearest([1.1, 0.9, 0.0], among=[1, 2])[0] == 2
    assert mesh.nodes_at({"x": (0.0, 0.0)}).tolist() == [1, 4]
    assert mesh.nodes_at({"x": (0.5, 2.0), "y": (1.0, 1.0)}).tolist() == [3]


def test_every_format_gives_the_same_shell(tmp_path):
    found = []
    for name, text in (("a.msh", GMSH_41), ("b.msh", GMSH_22), ("c.bdf", NASTRAN), ("d.inp", ABAQUS)):
        mesh = read_mesh(written(tmp_path, name, text), "mm")
        shell = Shell("skin", mesh.cells(), 70e9, 2700.0, 1e-5, 0.3)
        found.append(Structure(mesh.nodes, [shell]))
    assert found[0].n_dofs == 36
    for law in ("stiffness", "mass"):
        first = found[0].matrix(law).toarray()
        for other in found[1:]:
            assert np.abs(other.matrix(law).toarray() - first).max() <= 1e-14 * np.abs(first).max()
