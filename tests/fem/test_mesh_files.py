"""Traits of mesh files that Nastran, Abaqus/CAE, Patran, Femap, HyperMesh and Gmsh write, each in a file of our own."""

import struct

import numpy as np
import pytest

from structid import InputError
from structid.core.errors import FileError
from structid.fem import Shell, Solid
from structid.fem.elements.cells import CELLS
from structid.fem.meshes import read_mesh, require_sound


def written(tmp_path, name, text):
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def binary_msh(version, order):
    """Two triangles and an edge of a square, nodes 7 5 3 1, as Gmsh writes bytes; `order` is < or >."""
    one = struct.pack(f"{order}i", 1)
    names = b'$PhysicalNames\n2\n1 4 "edge"\n2 9 "the skin"\n$EndPhysicalNames\n'
    labels, points = [7, 5, 3, 1], [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    head = b"$MeshFormat\n%s 1 8\n" % version.encode() + one + b"\n$EndMeshFormat\n" + names
    if version == "2.2":
        nodes = b"".join(struct.pack(f"{order}i3d", n, *p) for n, p in zip(labels, points, strict=True))
        lines = struct.pack(f"{order}3i", 1, 1, 2) + struct.pack(f"{order}5i", 1, 4, 1, 7, 5)
        cells = struct.pack(f"{order}3i", 2, 2, 2)
        cells += struct.pack(f"{order}6i", 2, 9, 1, 7, 5, 3) + struct.pack(f"{order}6i", 3, 9, 1, 7, 3, 1)
        return head + b"$Nodes\n4\n" + nodes + b"\n$EndNodes\n$Elements\n3\n" + lines + cells + b"\n$EndElements\n"
    box = struct.pack(f"{order}6d", 0, 0, 0, 1, 1, 0)
    entities = struct.pack(f"{order}4Q", 1, 1, 1, 0)
    entities += struct.pack(f"{order}i3dQ", 1, 0, 0, 0, 0)
    entities += struct.pack(f"{order}i", 1) + box + struct.pack(f"{order}QiQ2i", 1, 4, 2, 1, -2)
    entities += struct.pack(f"{order}i", 1) + box + struct.pack(f"{order}QiQi", 1, 9, 1, 1)
    nodes = struct.pack(f"{order}4Q", 2, 4, 1, 7)
    nodes += struct.pack(f"{order}3iQ1Q", 0, 1, 0, 1, 7) + struct.pack(f"{order}3d", *points[0])
    nodes += struct.pack(f"{order}3iQ3Q", 2, 1, 1, 3, 5, 3, 1)  # with two parametric coordinates each
    nodes += b"".join(struct.pack(f"{order}5d", *p, 0.5, 0.5) for p in points[1:])
    cells = struct.pack(f"{order}4Q", 2, 3, 1, 3)
    cells += struct.pack(f"{order}3iQ3Q", 1, 1, 1, 1, 1, 7, 5)
    cells += struct.pack(f"{order}3iQ8Q", 2, 1, 2, 2, 2, 7, 5, 3, 3, 7, 3, 1)
    sections = {b"Entities": entities, b"Nodes": nodes, b"Elements": cells}
    parts = [b"$%s\n%s\n$End%s\n" % (name, body, name) for name, body in sections.items()]
    return head + b"".join(parts)


@pytest.mark.parametrize("version", ["2.2", "4.1"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_binary_gmsh_files_keep_node_numbers_and_groups(tmp_path, version, order):
    data = binary_msh(version, order)
    mesh = read_mesh(written(tmp_path, "a.msh", data), "cm")
    assert mesh.cells("the skin").tolist() == [[7, 5, 3], [7, 3, 1]]
    assert mesh.group_nodes("edge").tolist() == [5, 7]
    assert mesh.nodes[3] == pytest.approx([0.01, 0.01, 0.0])
    assert mesh.labels.tolist() == [7, 5, 3, 1]
    for cut in (30, 90, len(data) // 2, len(data) - 20):
        with pytest.raises(FileError, match=r"is cut short: .*; copy the file again, or save the mesh again"):
            read_mesh(written(tmp_path, "cut.msh", data[:cut]))


@pytest.mark.parametrize("kind", ["triangle6", "quad8", "quad9", "tetra10", "pyramid", "hexahedron20", "hexahedron27"])  # fmt: skip
@pytest.mark.parametrize("binary", [False, True])
def test_nodes_of_every_gmsh_cell_stand_where_the_element_has_them(tmp_path, kind, binary):
    meshio = pytest.importorskip("meshio")
    corners = CELLS[kind].corners
    points = np.pad(corners, ((0, 0), (0, 3 - corners.shape[1])))
    path = tmp_path / "a.msh"
    cells = [(kind, [list(range(len(points)))])]
    for form in ("gmsh22", "gmsh"):
        meshio.write(path, meshio.Mesh(points, cells), file_format=form, binary=binary)
        mesh = read_mesh(path)
        (block,) = mesh.blocks
        assert block.kind == kind
        assert np.array([mesh.nodes[n] for n in block.nodes[0]]) == pytest.approx(points, abs=1e-12)


def test_old_gmsh_versions_are_named(tmp_path):
    text = "$MeshFormat\n4 0 8\n$EndMeshFormat\n"
    with pytest.raises(FileError, match=r"is of version 4; save it as version 4.1 or 2.2"):
        read_mesh(written(tmp_path, "a.msh", text))
    with pytest.raises(FileError, match=r"has no \$MeshFormat"):
        read_mesh(written(tmp_path, "a.msh", "$NOD\n1\n1 0 0 0\n$ENDNOD\n"))


def test_physical_names_of_gmsh_without_dimension_and_with_words_behind_them(tmp_path):
    """Version 2.0 has numbers and names alone; other programs add words of their own."""
    text = """$MeshFormat
2.0 0 8
$EndMeshFormat
$PhysicalNames
2
3 "a skin"
1 4 "edge" lower_dimensional_block
$EndPhysicalNames
$Nodes
3
1 0 0 0
2 1 0 0
4 0 1 0
$EndNodes
$Elements
2
1 2 2 3 1 1 2 4
2 1 2 4 1 1 2
$EndElements
"""
    mesh = read_mesh(written(tmp_path, "a.msh", text))
    assert mesh.cells("a skin").tolist() == [[1, 2, 4]]
    assert mesh.group_nodes("edge").tolist() == [1, 2]
    with pytest.raises(FileError, match="no name in quotation marks"):
        read_mesh(written(tmp_path, "a.msh", text.replace('"edge"', "edge")))


PATRAN = """SOL 101
CEND
BEGIN BULK
PARAM    POST    -1
INCLUDE 'parts/geom.inc'
GRID     13             .5      .5      3.
GRID     5              1.      1.      1.
GRID     6               0.     1.      1.
GRID     7               0.      0.     1.
GRID     8              1.       0.     1.
GRID*    1               0               1.              1.
*        0.
GRID     2               0.     1.      -0.+0
GRID,3,,0.,0.,0.
GRID     4              1.       0.      0.
CORD2C   2       0       0.      0.      0.      0.      0.      1.
         1.      0.      0.
ENDDATA 58e050da
"""
INCLUDED = """CHEXA    1       2       1       2       3       4       5       6
         7       8
$ Elements and Element Properties for region : cap
PSOLID   7       1       0
CPYRAM,2,7,5,6,7,8,13
$\tYES\t1.\t.25
CBAR     13      1       3       7      0.     1.       0.
"""


def test_patran_files_with_includes_blank_continuations_and_all_field_forms(tmp_path):
    written(tmp_path, "parts/geom.inc", INCLUDED)
    for text in (PATRAN, PATRAN.replace("\n", "\r\n"), PATRAN.lower().replace("'parts/geom.inc'", "parts/geom.inc")):
        mesh = require_sound(read_mesh(written(tmp_path, "a.bdf", text)))
        assert [b.kind for b in mesh.blocks] == ["hexahedron", "pyramid", "line"]
        assert mesh.cells("2").tolist() == [[1, 2, 3, 4, 5, 6, 7, 8]]
        assert mesh.cells("cap").tolist() == [[5, 6, 7, 8, 13]]
        assert mesh.nodes[1] == pytest.approx([1.0, 1.0, 0.0])
    solid = Solid("s", mesh.cells(), 1.0, 1.0, 0.3)
    density = next(term for term in solid.property_matrices(mesh.nodes, np.zeros(0, int)) if term.property == "density")
    assert density.matrix_terms[0].local[0].sum() / 3 == pytest.approx(1.0)


CORNERS = "         1       1      10      20      30"
FEMAP = """ID FEMAP,FEMAP
CEND
BEGIN BULK
CORD2C         1       0      0.      0.      0.      0.      0.      1.+FEMAPC1
+FEMAPC1      1.      0.      1.
CORD2S         2       1      0.      0.      5.      0.      0.      6.
+             1.      0.      5.
CORD1R         3      10      20      30
$ Femap Property 1 : Upper skin
PBEAM          1       1      0.      0.      0.      0.      0.      0.+PR    1
+PR    1      0.      0.      0.      0.      0.      0.      0.      0.+PA    1
$HMNAME PROP         6"Lower skin" 4
PSHELL         6       1      .1
GRID          10       1      2.     90.      1.       0
GRID          20       1      2.     90.      2.
GRID          30       0      0.      3.      1.
GRID          40       2      1.     90.     90.
GRID          50       3      1.      0.      2.
GRID          60      -0   434.2-258.195     1.5
GRID          60           434.2-258.195     1.5
ctria3         1       1      10      20      30
CQUAD4         2       6      10      20      40      50
CTRIA3         3       6      10      20      60
ENDDATA
"""


def test_grid_points_in_cylinders_spheres_and_systems_of_grid_points_come_to_basic_coordinates(tmp_path):
    mesh = read_mesh(written(tmp_path, "a.nas", FEMAP))
    assert mesh.nodes[10] == pytest.approx([0.0, 2.0, 1.0])  # radius 2, 90 degrees
    assert mesh.nodes[40] == pytest.approx([0.0, 1.0, 5.0])  # a sphere in system 1: origin at z = 5
    # system 3: origin at 10, z along 20 - 10 = Z, x towards 30 = Y; so x = 1 is at y = 3
    assert mesh.nodes[50] == pytest.approx([0.0, 3.0, 3.0])
    assert mesh.nodes[60] == pytest.approx([434.2, -258.195, 1.5])
    assert mesh.labels.tolist() == [10, 20, 30, 40, 50, 60]
    assert mesh.cells("Lower skin").tolist() == [[10, 20, 60, -1], [10, 20, 40, 50]]
    assert mesh.cells("Upper skin").tolist() == [[10, 20, 30]]


@pytest.mark.parametrize(
    "old, new, words",
    [
        ("434.2-258.195     1.5\nctria3", "434.3-258.195     1.5\nctria3", "GRID 60 stands twice, at two places"),
        ("CORD2S         2       1", "CORD2S         2       2", "coordinate system 2 is defined by itself"),
        ("CORD1R         3      10      20      30", "CORD1R         3      10      20      99", "names GRID 99"),
        ("CORD1R         3      10      20      30", "CORD1R         3      10      20      20", "lie on a line"),
        ("CTRIA3         3", "CTRIAX         3", "elements CTRIAX are not read"),
    ],
)  # fmt: skip
def test_what_bulk_data_lack_is_named(tmp_path, old, new, words):
    text = FEMAP.replace(old, new)
    assert text != FEMAP
    with pytest.raises(FileError) as error:
        read_mesh(written(tmp_path, "a.nas", text))
    assert words in str(error.value)


@pytest.mark.parametrize("card, kind", [("CHEXA", "hexahedron20"), ("CPENTA", "wedge15"), ("CTETRA", "tetra10")])
def test_quadratic_solids_of_nastran_have_their_middles_where_vtk_has_them(tmp_path, card, kind):
    corners = CELLS[kind].corners
    count = {"CHEXA": 8, "CPENTA": 6, "CTETRA": 4}[card]
    middles = range(count, len(corners))
    by_height = middles if card == "CTETRA" else sorted(middles, key=lambda k: (round(corners[k, 2], 6), k))
    order = [*range(count), *by_height]  # bottom, between, top
    lines = [f"GRID,{k + 1},,{x},{y},{z}" for k, (x, y, z) in enumerate(corners[order])]
    nodes = [str(k + 1) for k in range(len(corners))]
    rows = [nodes[:6], *(nodes[i : i + 8] for i in range(6, len(nodes), 8))]
    cell = [f"{card},1,1," + ",".join(rows[0]), *("," + ",".join(row) for row in rows[1:])]
    mesh = read_mesh(written(tmp_path, "a.bdf", "\n".join(["BEGIN BULK", *lines, *cell, "ENDDATA", ""])))
    (block,) = mesh.blocks
    assert block.kind == kind
    assert np.array([mesh.nodes[n] for n in block.nodes[0]]) == pytest.approx(corners)


CAE = """*Heading
** Job name: Job-1 Model name: Model-1
*Preprint, echo=NO, model=NO, history=NO, contact=NO
*Part, name=Part-1
*Node
      1,           0.,           0.
      2,           1.,           0.,   0.
      3,           1.,           1.
      4,           0.,           1.
*Element, type=S4R
1, 1, 2, 3, 4
*Nset, nset=Set-1, generate
 1, 4, 1
*Elset, elset=Skin
 1,
*Shell Section, elset=Skin, material=Steel
0.01, 5
*End Part
**
*Assembly, name=Assembly
**
*Instance, name=Part-1-1, part=Part-1
          5.,           0.,           0.
          5.,           0.,           0.,           5.,           0.,           1.,          60.
*End Instance
*Node
      1,          0.5,          0.5,          1.
*Nset, nset=m_Set-1
 1,
*Nset, nset=Set-1, instance=Part-1-1
 1,  4
*Element, type=Dashpot1, elset=X-dashpot
1, Part-1-1.4
*Dashpot, elset=X-dashpot
3
*End Assembly
*Material, name=Steel
*Step, name=matrix
*matrix generate,stiffness,mass
*end step
"""


def test_assemblies_of_abaqus_cae_are_where_the_instance_puts_them(tmp_path):
    mesh = require_sound(read_mesh(written(tmp_path, "a.inp", CAE)))
    assert mesh.nodes[1] == pytest.approx([5.0, 0.0, 0.0])
    assert mesh.nodes[2] == pytest.approx([5.5, np.sqrt(0.75), 0.0])
    assert mesh.cells("Skin").tolist() == [[1, 2, 3, 4]]
    assert mesh.group_nodes("Set-1").tolist() == [1, 4]  # that of the assembly
    assert mesh.group_nodes("Part-1.Set-1").tolist() == [1, 2, 3, 4]
    assert len(mesh.blocks) == 1  # dashpots and the reference point of the assembly are left out


@pytest.mark.parametrize(
    ("shift", "turn", "second"),
    [
        (", , 2.", "", [1.0, 0.0, 2.0]),
        ("5.", "", [6.0, 0.0, 0.0]),
        (",", ", , , , , 1., 90.", [0.0, 1.0, 0.0]),
        ("5., 0., 0.,", "5., , , 5., , 1., 90.,", [5.0, 1.0, 0.0]),
    ],
)
def test_blank_words_of_an_instance_are_0_and_move_no_others(tmp_path, shift, turn, second):
    old = CAE[CAE.index("          5.,") : CAE.index("*End Instance")]
    new = f"{shift}\n{turn}\n" if turn else f"{shift}\n"
    mesh = read_mesh(written(tmp_path, "a.inp", CAE.replace(old, new)))
    assert mesh.nodes[2] == pytest.approx(second)


def test_a_mesh_within_the_instance_and_an_included_file_are_read(tmp_path):
    part = CAE[CAE.index("*Node") : CAE.index("*End Part")]
    inside = CAE.replace(part, "").replace("*End Instance\n", "*INCLUDE, INPUT=mesh.inc\n*End Instance\n")
    written(tmp_path, "mesh.inc", part)
    mesh = read_mesh(written(tmp_path, "a.inp", inside))
    assert mesh.nodes[2] == pytest.approx([5.5, np.sqrt(0.75), 0.0])
    assert mesh.group_nodes("Part-1-1.Set-1").tolist() == [1, 2, 3, 4]


def test_second_instances_are_put_where_the_assembly_has_them_with_numbers_of_their_own(tmp_path):
    text = CAE.replace(
        "*End Instance\n", "*End Instance\n*Instance, name=Part-1-2, part=Part-1\n1., 0., 0.\n*End Instance\n"
    )
    mesh = require_sound(read_mesh(written(tmp_path, "a.inp", text)))
    assert mesh.labels.tolist() == [1, 2, 3, 4, 11, 12, 13, 14]
    assert mesh.nodes[2] == pytest.approx([5.5, np.sqrt(0.75), 0.0])
    assert mesh.nodes[13] == pytest.approx([2.0, 1.0, 0.0])
    assert mesh.cells("Part-1-2.Skin").tolist() == [[11, 12, 13, 14]]
    assert len(mesh.cells("Skin")) == 2
    assert mesh.group_nodes("Set-1").tolist() == [1, 4]


HYPERMESH = """**
** ABAQUS Input Deck Generated by HyperMesh Version  : 14.0.120.28
*NODE , Nset = nset_csys0
         1,  0.0       ,  0.0      ,  0.0
         2,  1.0       ,  0.0      ,  0.0
         3,  1.0       ,  1.0      ,  0.0
         4,  0.0       ,  1.0      ,  0.0
*ELEMENT,TYPE=S3,ELSET=Skin
         1,         1,         2,         3
         2,         1,         3,
         4
*ELSET, ELSET=ALL,
 UNSORTED
SKIN
"""


def test_set_names_are_found_in_any_case_and_keyword_lines_go_on(tmp_path):
    mesh = read_mesh(written(tmp_path, "a.inp", HYPERMESH))
    assert mesh.cells("ALL").tolist() == mesh.cells("Skin").tolist() == [[1, 2, 3], [1, 3, 4]]
    assert mesh.group_nodes("nset_csys0").tolist() == [1, 2, 3, 4]


def test_brick_nodes_of_abaqus_stand_where_vtk_has_them(tmp_path):
    corners = CELLS["hexahedron27"].corners
    abaqus = [*range(20), 26, 24, 25, 22, 21, 23, 20]  # middle, bottom, top, front, right, back, left
    lines = [f"{k + 1}, {x}, {y}, {z}" for k, (x, y, z) in enumerate(corners[abaqus])]
    cell = "1," + ",".join(map(str, range(1, 16))) + ",\n" + ",".join(map(str, range(16, 28)))
    mesh = read_mesh(written(tmp_path, "a.inp", "\n".join(["*NODE", *lines, "*ELEMENT, TYPE=C3D27R", cell, ""])))
    assert np.array([mesh.nodes[n] for n in mesh.blocks[0].nodes[0]]) == pytest.approx(corners)


def test_cells_without_an_element_are_named_where_they_are_used(tmp_path):
    text = HYPERMESH[: HYPERMESH.index("*ELEMENT")] + "*ELEMENT, TYPE=SC6R, ELSET=Skin\n1, 1, 2, 3, 4, 5, 6\n"
    mesh = read_mesh(written(tmp_path, "a.inp", text))
    with pytest.raises(InputError, match=r"cells of type 'SC6R' in a.inp cannot be used; mesh with one of"):
        mesh.cells("Skin")
    with pytest.raises(InputError, match="it can have 3"):
        Shell("shell", [[1, 2, 3, 4, 5]], 1.0, 1.0, 1.0, 0.3)


def universal(*datasets):
    """Datasets of number and lines."""
    return "".join(f"    -1\n{number:6d}\n" + "\n".join(lines) + "\n    -1\n" for number, lines in datasets)


def columns(*numbers):
    return "".join(f"{n:10d}" for n in numbers)


def universal_nodes(points, system=1):
    rows = [(columns(n, system, 1, 11), "".join(f"{x:25.16E}" for x in p)) for n, p in enumerate(points.tolist(), 1)]
    return 2411, [line for row in rows for line in row]


#: Corners and mid-side nodes of each cell in the order of a universal file: around each face, mid-side nodes between corners.
WALKS = {
    "triangle6": (92, "0 01 1 12 2 20"),
    "quad8": (95, "0 01 1 12 2 23 3 30"),
    "tetra10": (118, "0 01 1 12 2 20 03 13 23 3"),
    "wedge15": (113, "0 01 1 12 2 20 03 14 25 3 34 4 45 5 53"),
    "hexahedron20": (116, "0 01 1 12 2 23 3 30 04 15 26 37 4 45 5 56 6 67 7 74"),
}


@pytest.mark.parametrize("kind", WALKS)
def test_nodes_of_universal_cells_stand_where_the_element_has_them(tmp_path, kind):
    descriptor, walk = WALKS[kind]
    corners = np.pad(CELLS[kind].corners, ((0, 0), (0, 3 - CELLS[kind].corners.shape[1])))
    points = np.array([np.mean([corners[int(c)] for c in word], axis=0) for word in walk.split()])
    labels = list(range(1, len(points) + 1))
    nodes = [columns(*labels[i : i + 8]) for i in range(0, len(labels), 8)]
    text = universal(universal_nodes(points), (2412, [columns(5, descriptor, 1, 1, 7, len(points)), *nodes]))
    (block,) = (mesh := read_mesh(written(tmp_path, "a.unv", text))).blocks
    assert block.kind == kind
    assert np.array([mesh.nodes[n] for n in block.nodes[0]]) == pytest.approx(corners, abs=1e-12)


def test_universal_meshes_follow_units_systems_and_beams(tmp_path):
    points = np.array([[1000.0, 0, 0], [1000.0, 90.0, 500.0]])
    system = (
        2420,
        [
            columns(1),
            "part",
            columns(5, 1, 0),
            "CYL",
            *("".join(f"{x:25.16E}" for x in row) for row in (*np.eye(3), np.zeros(3))),
        ],
    )
    units = (164, [f"{10:10d}{'mm':<20s}{2:10d}", f"{1000:25.17E}{1:25.17E}{1:25.17E}", f"{273.15:25.17E}"])
    beam = (
        2412,
        [columns(3, 21, 1, 1, 7, 2), columns(0, 1, 1), columns(1, 2), columns(4, 136, 1, 1, 7, 2), columns(1, 2)],
    )
    path = written(tmp_path, "a.unv", universal(units, system, universal_nodes(points, system=5), beam))
    mesh = read_mesh(path)
    assert mesh.positions == pytest.approx(np.array([[1.0, 0, 0], [0, 1.0, 0.5]]), abs=1e-12)
    assert mesh.cells().tolist() == [[1, 2]]
    assert [(part.kind, part.count, part.obstacle) for part in mesh.parts] == [
        ("spring between nodes", 1, "it is not read")
    ]
    assert read_mesh(path, "mm").positions == pytest.approx(mesh.positions)
    with pytest.raises(
        FileError, match=r"dataset 164 states a unit of length of 0\.001 m, `length_unit` one of 0\.0254 m"
    ):
        read_mesh(path, "in")


@pytest.mark.parametrize(
    ("elements", "words"),
    [
        ([columns(7, 91, 1, 1, 7, 3), columns(1, 2)], r"dataset 2 \(2412\): element 7 of type 91 has 2 nodes instead of 3"),
        ([columns(7, 82, 1, 1, 7, 3), columns(1, 2, 3)], "element 7 is axisymmetric"),
        ([columns(7, 91, 1, 1, 7, 3)], "ends within it"),
        ([columns(7, 91, 1, 1, 7) + "     three", columns(1, 2, 3)], "must hold whole numbers in its line 1"),
        ([columns(7, 161, 1, 1, 7, 1), columns(1)], "holds no elements"),
    ],
)  # fmt: skip
def test_universal_elements_that_cannot_be_used_are_named(tmp_path, elements, words):
    with pytest.raises(FileError, match=words):
        read_mesh(written(tmp_path, "a.unv", universal(universal_nodes(np.eye(3)), (2412, elements))))
