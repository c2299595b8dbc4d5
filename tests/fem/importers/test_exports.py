"""Numbering files, the two-exports way, units, total mass, semidefiniteness, and the formats of SciPy and Ansys."""

import importlib
import sys
import types

import h5py
import numpy as np
import pytest
import scipy.io
from matrix_cases import imported, numbered, random_matrix
from scipy import sparse

from structid.core.dof import Dof
from structid.core.errors import FileError, InputError
from structid.fem import Beam, Structure
from structid.fem.importers import (
    FORMATS,
    ImportedMatrix,
    ansys,
    dof_table,
    dofs_of,
    group_from_exports,
    in_si,
    matrix_files,
    on_dofs,
    read_matrices,
    read_matrix,
    read_numbering,
    require_total_mass,
    total_mass,
    write_abaqus,
    write_matrix,
)
from structid.fem.importers.checks import require_semidefinite
from structid.files import contained as contained_process
from structid.files import worker


@pytest.mark.parametrize("suffix", [".op4", ".npz", ".npy", ".mtx"])
def test_one_matrix_is_written_by_its_suffix_and_read_back_exactly(tmp_path, suffix):
    item = imported(5)
    write_matrix(tmp_path / f"kaa{suffix}", item)
    back = read_matrix(tmp_path / f"kaa{suffix}")
    assert back.name == "KAA"
    np.testing.assert_array_equal(back.matrix.toarray(), item.matrix.toarray())


def harwell_boeing(path, item):
    scipy.io.hb_write(str(path), sparse.csc_matrix(item.matrix))


def calculix(path, item):
    upper = sparse.triu(item.matrix).tocoo()
    entries = zip(upper.row + 1, upper.col + 1, upper.data, strict=True)
    path.write_text("".join(f"{row} {column}  {value:.13e}\n" for row, column, value in entries))
    path.with_suffix(".dof").write_text("".join(f"{node}.{component}\n" for node, component in item.dofs))


#: How a file of each format comes to be, by its first suffix; Ansys files need its library, see below.
SAMPLES = {
    ".op4": write_matrix,
    ".pch": write_matrix,
    ".mtx": write_abaqus,
    ".npz": write_matrix,
    ".hb": harwell_boeing,
    ".sti": calculix,
}


@pytest.mark.parametrize("suffix", [m.SUFFIXES[0] for m in FORMATS if m.SUFFIXES[0] != ".full"])
def test_every_format_gives_its_matrix_and_tells_a_file_that_is_cut(tmp_path, suffix):
    full = sparse.csc_array(np.add.outer(np.arange(6.0), np.arange(6.0)) + np.eye(6))
    item, path = ImportedMatrix("KAA", full, numbered(6)), tmp_path / f"kaa{suffix}"
    SAMPLES[suffix](path, item)
    np.testing.assert_allclose(read_matrix(path).matrix.toarray(), full.toarray(), rtol=1e-12)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    if suffix != ".mtx":  # lines of entries, of which nothing tells how many there should be
        with pytest.raises(FileError, match=f"kaa{suffix}"):
            read_matrices(path)


NEW_FORMAT = '''
"""Matrices as lists of rows."""

import json

import numpy as np
from scipy import sparse

from structid.fem.importers import ImportedMatrix

SUFFIXES = (".rows",)


def read(path):
    return [ImportedMatrix(name, sparse.csc_array(np.array(rows))) for name, rows in json.loads(path.read_text()).items()]
'''


def test_a_new_format_is_a_module_and_a_line_in_the_registry(tmp_path, monkeypatch):
    (tmp_path / "rows_of_matrices.py").write_text(NEW_FORMAT)
    (tmp_path / "two.rows").write_text('{"K": [[2.0, -1.0], [-1.0, 2.0]], "M": [[1.0, 0.0], [0.0, 1.0]]}')
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(matrix_files, "FORMATS", (*FORMATS, importlib.import_module("rows_of_matrices")))
    assert list(read_matrices(tmp_path / "two.rows")) == ["K", "M"]
    np.testing.assert_array_equal(read_matrix(tmp_path / "two.rows", "K").matrix.toarray(), [[2, -1], [-1, 2]])
    (tmp_path / "a.xyz").write_text("1")
    with pytest.raises(FileError, match=r"known matrix format; .*\.rows"):
        read_matrices(tmp_path / "a.xyz")


def test_mat_and_harwell_boeing_files_are_read(tmp_path):
    matrix = random_matrix(3)
    scipy.io.savemat(tmp_path / "a.mat", {"K": sparse.csc_matrix(matrix), "M": np.eye(12), "note": "text", "n": 3})
    found = read_matrices(tmp_path / "a.mat")
    assert list(found) == ["K", "M"]
    np.testing.assert_array_equal(found["K"].matrix.toarray(), matrix.toarray())
    with h5py.File(tmp_path / "new.mat", "w", userblock_size=512) as file:  # version 7.3
        file.create_dataset("K", data=np.array([[2.0, -1.0], [-1.5, 2.0]]).T).attrs["MATLAB_class"] = np.bytes_(
            "double"
        )
    with (tmp_path / "new.mat").open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    np.testing.assert_array_equal(read_matrix(tmp_path / "new.mat").matrix.toarray(), [[2.0, -1.0], [-1.5, 2.0]])
    scipy.io.hb_write(str(tmp_path / "a.rb"), sparse.csc_matrix(matrix))
    np.testing.assert_allclose(read_matrix(tmp_path / "a.rb").matrix.toarray(), matrix.toarray(), rtol=1e-14)


def test_every_suffix_is_of_one_format_but_mtx_which_its_first_line_tells(tmp_path):
    known = [suffix for module in FORMATS for suffix in module.SUFFIXES]
    assert sorted({s for s in known if known.count(s) > 1}) == [".mtx"]
    (tmp_path / "a.xyz").write_text("1")
    with pytest.raises(FileError, match="no known matrix format"):
        read_matrices(tmp_path / "a.xyz")
    with pytest.raises(FileError, match="no such file"):
        read_matrices(tmp_path / "none.op4")
    with pytest.raises(FileError, match="cannot be written"):
        write_matrix(tmp_path / "a.xyz", imported())


PUNCH = """\
BEGIN SUPER       75
ASET1   123     1       THRU    3
ASET1*               456               5
ASET           2    3456       4       2$
QSET1,0,101,THRU,102
"""


@pytest.mark.parametrize(
    "name, text, expected",
    [
        ("a.txt", "# rows\n1X, 2Y-\n12.03 3RX # last\n", ["1X+", "2Y-", "12Z+", "3RX+"]),
        ("a.csv", "node,component\n".replace("node,component\n", "") + "12,3\n4 6\n", ["12Z+", "4RZ+"]),
        ("a.mapping", " Matrix Eqn  Node  DOF\n  1   5  UX\n  2   5  ROTZ\n", ["5X+", "5RZ+"]),
        ("a.pch", "EXTRN          3      13      11       2\n         2995001       0\n" + PUNCH,
         ["3X+", "3Z+", "11Y+", "2995001RX+"]),
        ("b.pch", PUNCH, ["1X+", "1Y+", "1Z+", "2X+", "2Y+", "2Z+", "2RX+", "2RY+", "2RZ+", "3X+", "3Y+", "3Z+",
                          "4Y+", "5RX+", "5RY+", "5RZ+", "101RX+", "102RX+"]),
    ],
)  # fmt: skip
def test_numbering_of_every_kind_is_read_in_order(tmp_path, name, text, expected):
    (tmp_path / name).write_text(text)
    assert [str(dof) for dof in read_numbering(tmp_path / name)] == expected


@pytest.mark.parametrize(
    "text, words",
    [
        ("1X\n2Q\n", ["line 2", "'2Q'"]),
        (" Matrix Eqn  Node  DOF\n 1 5 UX\n 2 5 TEMP\n", ["line 3", "UX to ROTZ"]),
        ("ASET           2    37\n", ["digits from 0 to 6"]),
        ("ASET1   123     1.5\n", ["grid point's number", "1.5"]),
        ("ASET1,123,9,THRU,5\n", ["a set from 9 to 5 is empty"]),
        ("1 1\n1 1\n", ["1X", "two rows"]),
    ],
)
def test_numbering_that_cannot_be_read_is_named(tmp_path, text, words):
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(FileError) as caught:
        read_numbering(tmp_path / "a.txt")
    for word in ["a.txt", *words]:
        assert word in str(caught.value)


def test_rows_are_put_in_the_order_asked_for_or_refused():
    item = imported(2)
    order = np.random.default_rng(0).permutation(12)
    wider = np.concatenate([numbered(12)[order], [[99, 1]]])
    got = on_dofs(item, wider).toarray()
    np.testing.assert_array_equal(got[:12, :12], item.matrix.toarray()[np.ix_(order, order)])
    assert not got[12].any()
    with pytest.raises(InputError, match="component 1 of node 10, which is not among"):
        on_dofs(item, numbered(12)[1:])
    with pytest.raises(InputError, match="no numbering of its own"):
        on_dofs(ImportedMatrix("K", item.matrix), numbered(12))
    assert dof_table(dofs_of(numbered(12))).tolist() == numbered(12).tolist()


def bending(stiffness, thickness=1.0):
    beams = [Beam("a", [[0, 1], [1, 2]], 1.0, 5.0), Beam("b", [[2, 3], [3, 4]], 1.0, stiffness * thickness**3)]
    return Structure({i: 0.5 * i for i in range(5)}, beams, fixed=["0Y", "0RZ"]).matrix("stiffness")


def test_two_exports_give_the_matrix_of_the_group():
    group = group_from_exports(bending(3.0), bending(6.0), 2.0)
    alone = bending(3.0) - bending(0.0)
    assert abs(group - alone).max() < 1e-12 * abs(alone).max()
    assert group[:2, :2].nnz == 0  # nothing is left of what does not depend on the parameter
    third = group_from_exports(bending(3.0), bending(6.0), 2.0, bending(15.0), 5.0)
    np.testing.assert_array_equal(third.toarray(), group.toarray())


@pytest.mark.parametrize(
    "call, words",
    [
        (
            lambda: group_from_exports(bending(3, 1), bending(3, 2), 2.0, bending(3, 1.5), 1.5),
            ["power 3", "8 and 3.375"],
        ),
        (
            lambda: group_from_exports(bending(3), bending(6), 2.0, bending(9, 1.1), 3.0),
            ["linear dependence", "no single power"],
        ),
        (lambda: group_from_exports(bending(3), bending(3), 2.0), ["`changed` must differ"]),
        (lambda: group_from_exports(bending(3), np.eye(3), 2.0), ["(8, 8)", "(3, 3)"]),
        (lambda: group_from_exports(bending(3), bending(6), 1.0), ["`factor` must be positive and not 1"]),
        (lambda: group_from_exports(bending(3), bending(6), 2.0, bending(6), 2.0), ["`third_factor` must differ"]),
        (lambda: group_from_exports(bending(3), bending(6), 2.0, bending(6)), ["given together"]),
    ],
)
def test_exports_that_do_not_give_a_group_are_refused(call, words):
    with pytest.raises(InputError) as caught:
        call()
    for word in words:
        assert word in str(caught.value)


def test_round_off_of_printed_exports_does_not_leak_into_the_group():
    rng = np.random.default_rng(4)
    printed = [sparse.csc_array(k * (1 + 1e-11 * rng.uniform(-1, 1, k.shape))) for k in (bending(3.0), bending(6.0))]
    group = group_from_exports(*printed, 2.0)
    assert group[:2, :2].nnz == 0


def test_total_mass_is_that_of_rigid_translation():
    beam = Structure({0: (0, 0), 1: (3, 4)}, [Beam("b", [[0, 1]], 2.0, 5.0)])
    mass, dofs = beam.matrix("mass"), beam.dofs
    for direction in "XY":
        assert total_mass(mass, dofs, direction) == pytest.approx(10.0, rel=1e-12)
    turned = sparse.diags_array([-1.0 if dof.node == 1 else 1.0 for dof in dofs])
    named = [Dof(dof.node, dof.direction, -1 if dof.node == 1 else 1) for dof in dofs]
    assert total_mass(turned @ mass @ turned, named) == pytest.approx(10.0, rel=1e-12)
    with pytest.raises(InputError, match="must name the 6 rows"):
        total_mass(mass, dofs[:4])
    with pytest.raises(InputError, match="X, Y or Z"):
        total_mass(mass, dofs, "RX")


@pytest.mark.parametrize(
    "found, words",
    [
        (30.42e-3, ["0.001", "tonnes", "length_unit"]),
        (30.42e3, ["1000", "grams"]),
        (30.42 / 175.1268, ["lbf s^2/in"]),
        (30.42 / 0.45359, ["pounds"]),
        (15.2, ["a half"]),
        (40.0, ["1.31", "held in the export"]),
        (0.0, ["is missing"]),
    ],
)
def test_total_mass_that_differs_names_the_factor_and_its_likely_cause(found, words):
    require_total_mass(30.0, 30.42)
    with pytest.raises(InputError) as caught:
        require_total_mass(found, 30.42)
    for word in ["30.42", *words]:
        assert word in str(caught.value)


@pytest.mark.parametrize("length, force", [("mm", "N"), ("mm", "mN"), ("in", "lbf"), ("ft", "lbf"), ("m", "kN")])
def test_matrices_in_other_units_become_those_of_si(length, force):
    """A beam of EI, m and length stated in other units has the same matrices once converted."""
    metre = {"mm": 1e3, "in": 1 / 0.0254, "ft": 1 / 0.3048, "m": 1.0}[length]
    newton = {"N": 1.0, "mN": 1e3, "lbf": 1 / 4.4482216152605, "kN": 1e-3}[force]
    mass_unit = newton / metre  # force s^2 / length

    def beam(x, m, ei):
        return Structure({0: (0, 0), 1: (0.7 * x, 1.1 * x)}, [Beam("b", [[0, 1]], m, ei, axial_stiffness=0.0)])

    given = beam(metre, 2.0 * mass_unit / metre, 5.0 * newton * metre**2)
    wanted = beam(1.0, 2.0, 5.0)
    for kind in ("mass", "stiffness"):
        got = in_si(given.matrix(kind), given.dofs, length, force).toarray()
        np.testing.assert_allclose(got, wanted.matrix(kind).toarray(), rtol=1e-12, atol=1e-12)
    with pytest.raises(InputError, match="length_unit"):
        in_si(np.eye(1), ["1X"], "parsec")


def test_semidefinite_matrices_pass_and_others_are_named():
    dofs = [Dof(i, "X") for i in range(1, 6)]
    free = sparse.csc_array(np.diag([1.0, 2, 2, 2, 1]) - np.diag(np.ones(4), 1) - np.diag(np.ones(4), -1))
    require_semidefinite("stiffness", free, dofs)
    require_semidefinite("stiffness", free * 1e12, dofs)
    require_semidefinite("mass", sparse.csc_array((5, 5)), dofs)
    wrong = free.tolil()
    wrong[2, 2] = -2
    with pytest.raises(InputError, match="diagonal is -2 at 3X"):
        require_semidefinite("stiffness", wrong.tocsc(), dofs)
    wrong[2, 2] = 0
    with pytest.raises(InputError, match="entry of"):
        require_semidefinite("stiffness", wrong.tocsc(), dofs)
    wrong[2, 2] = 1.9
    with pytest.raises(InputError, match="1 negative eigenvalues"):
        require_semidefinite("stiffness", wrong.tocsc(), dofs)


class FakeFull:
    """What `ansys-mapdl-reader` gives for a .full file of two springs, the third row held."""

    const = np.array([[4, 0]])

    def load_km(self, sort):
        upper = sparse.csc_matrix(np.array([[3.0, -1.0, 0], [0, 1.0, 0], [0, 0, 0]]))
        return np.array([[2, 0], [3, 5], [4, 0]]), upper, None


class FakeEmat:
    """The same for a .emat file: two elements of two nodes, six components a node of which UX alone is used."""

    neqv, eeqv, n_dof, n_elements = np.array([20, 10, 30]), np.array([5, 4]), 6, 2

    def read_element(self, index):
        where = [np.array([6, 0]), np.array([0, 12])][index]
        return where, {"stress": np.array([1.0, -1.0, 1.0]) * (index + 1), "mass": np.array([0.5, 0.5])}


def test_ansys_files_are_read_through_the_library(tmp_path, monkeypatch):
    """The reader that runs in a child, called here with a library that is none."""
    monkeypatch.setattr(ansys, "read_in_child", lambda path, reader: worker.READERS[reader](str(path)))
    library = types.ModuleType("ansys.mapdl.reader")
    library.read_binary = lambda path: FakeFull() if path.endswith(".full") else FakeEmat()
    for name in ("ansys", "ansys.mapdl"):
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    monkeypatch.setitem(sys.modules, "ansys.mapdl.reader", library)
    for name in ("a.full", "a.emat"):
        (tmp_path / name).write_bytes(b"x")
    full = read_matrix(tmp_path / "a.full")
    assert full.name == "STIFFNESS"
    assert full.dofs.tolist() == [[2, 1], [3, 6]]
    assert full.constrained.tolist() == [[4, 1]]
    np.testing.assert_array_equal(full.matrix.toarray(), [[3, -1], [-1, 1]])
    elements = read_matrices(tmp_path / "a.emat")
    assert elements["STIFFNESS"].dofs.tolist() == [[10, 1], [20, 1], [30, 1]]
    np.testing.assert_array_equal(elements["STIFFNESS"].matrix.toarray(), [[1, -1, 0], [-1, 3, -2], [0, -2, 2]])
    np.testing.assert_array_equal(elements["MASS"].matrix.toarray(), np.diag([0.5, 1.0, 0.5]))
    assert set(elements["MASS"].elements.element) == {4, 5}


def test_ansys_files_without_the_library_say_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    (tmp_path / "ansys").mkdir()
    (tmp_path / "ansys" / "__init__.py").touch()
    (tmp_path / "a.full").write_bytes(b"x")
    contained_process.end()
    with pytest.raises(FileError, match="pip install ansys-mapdl-reader"):
        read_matrices(tmp_path / "a.full")
