"""The command `structid convert` of matrices and modes: round trips over all formats, what is lost said, nothing half written."""

import itertools

import numpy as np
import pytest
from scipy import sparse
from typer.testing import CliRunner

from structid.cli import app
from structid.core.dof import parse_dofs
from structid.fem.importers import (
    FORMATS,
    ImportedMatrix,
    dof_table,
    read_matrices,
    read_matrix,
    write_dmig,
    write_matrices,
)
from structid.modal import ModalRecord
from structid.modal.formats.files import read_modes, write_modes
from structid.records import FrfRecord, read_record, write_record

RUN = CliRunner()
ROWS = ["1X", "1Y", "4RZ", "7Z"]
MASS = np.array([[2.0, 0.25, 0, 0], [0.25, 3.0, 0, 1e-9], [0, 0, 0.125, 0], [0, 1e-9, 0, 1 / 3]])
WRITTEN = (".op4", ".pch", ".mtx", ".npz", ".npy", ".mat")


def convert(*words):
    done = RUN.invoke(app.app, ["convert", *map(str, words)])
    return done.exit_code, done.stdout, done.stderr


def matrix(name="MAA", values=MASS, rows=ROWS):
    return ImportedMatrix(name, sparse.csc_array(values), None if rows is None else dof_table(parse_dofs(rows)))


def test_all_formats_that_are_read_and_written_are_converted_here():
    read = {suffix for module in FORMATS for suffix in module.SUFFIXES}
    assert set(WRITTEN) <= read
    assert read - set(WRITTEN) == {
        ".ou1", ".pun", ".dmig", ".bdf", ".nas", ".bulk", ".blk", ".dat",  # others of OP4 and DMIG
        ".full", ".emat", ".hb", ".rb", ".rua", ".rsa", ".matrix", ".sti", ".mas",  # read only
    }  # fmt: skip


@pytest.mark.parametrize(("first", "second"), [*itertools.product(WRITTEN, WRITTEN)])
def test_matrices_keep_their_numbers_there_and_back(tmp_path, first, second):
    write_dmig(tmp_path / "a.bdf", [matrix()], "free")
    (tmp_path / "rows.txt").write_text("\n".join(ROWS))
    kept = ("--dofs", tmp_path / "rows.txt")
    assert convert(tmp_path / "a.bdf", tmp_path / f"b{first}", "--name", "MAA")[0] == 0
    needed = kept if second == ".pch" and first != ".pch" else ()
    words = ("--contents", "matrices", "--name", "MAA", *needed)
    code, out, err = convert(tmp_path / f"b{first}", tmp_path / f"c{second}", *words)
    assert (code, err) == (0, "")
    assert f"c{second}: MAA, 4 x 4, real, 8 entries" in out
    back = read_matrix(tmp_path / f"c{second}")
    digits = 1e-11 if ".pch" in (first, second) else 0
    np.testing.assert_allclose(back.matrix.toarray(), MASS, rtol=digits, atol=0)
    assert (back.dofs is not None) == (second == ".pch")
    if back.dofs is not None:
        assert np.array_equal(back.dofs, dof_table(parse_dofs(ROWS)))


def test_the_forms_of_abaqus_and_the_numbering_beside(tmp_path):
    write_dmig(tmp_path / "a.bdf", [matrix(), matrix("KAA", 5 * MASS)])
    words = ("--matrix", "kaa", "--mtx", "labels")
    code, out, _ = convert(tmp_path / "a.bdf", tmp_path / "k.mtx", *words)
    assert (code, out) == (0, f"{tmp_path}/k.mtx: KAA, 4 x 4, real, 8 entries\n")
    assert (tmp_path / "k.mtx").read_text().startswith("1,1, 1,1, 1.0000000000000000e+01\n")
    assert np.array_equal(read_matrix(tmp_path / "k.mtx").dofs, dof_table(parse_dofs(ROWS)))
    code, out, _ = convert(tmp_path / "a.bdf", tmp_path / "c.mtx", "--matrix", "KAA", "--mtx", "coordinate")
    assert code == 0
    assert "not kept by .mtx: node and component of the rows (write them with --write-dofs FILE)" in out
    code, out, _ = convert(tmp_path / "a.bdf", tmp_path / "both.op4", "--write-dofs", tmp_path / "rows.txt")
    assert code == 0
    assert (tmp_path / "rows.txt").read_text() == "1 1\n1 2\n4 6\n7 3\n"
    assert list(read_matrices(tmp_path / "both.op4")) == ["MAA", "KAA"]
    code, _, _ = convert(tmp_path / "both.op4", tmp_path / "back.pch", "--dofs", tmp_path / "rows.txt")
    assert code == 0
    back = read_matrices(tmp_path / "back.pch")
    np.testing.assert_allclose(back["KAA"].matrix.toarray(), 5 * MASS, rtol=1e-10)


def test_what_a_file_holds_is_found_out(tmp_path):
    write_matrices(tmp_path / "a.npz", [matrix()])
    assert "4 x 4, real" in convert(tmp_path / "a.npz", tmp_path / "b.npz")[1]  # SciPy's, so matrices
    frf = FrfRecord(np.arange(1.0, 4), np.ones((3, 1, 1)) + 0j, ("1X",), ("1X",), "mobility")
    write_record(tmp_path / "frf.npz", frf)
    assert "mobility, 3 lines" in convert(tmp_path / "frf.npz", tmp_path / "frf.uff")[1]
    assert read_record(tmp_path / "frf.uff").kind == "mobility"
    write_modes(tmp_path / "modes.uff", ModalRecord([2.0], [0.01], [[1.0], [0.5]], ("1X", "2X")))
    assert "1 mode at 2 channels" in convert(tmp_path / "modes.uff", tmp_path / "modes.csv")[1]
    assert "1 mode at 2 channels" in convert(tmp_path / "modes.csv", tmp_path / "modes.json")[1]
    assert "frequency responses" not in convert(tmp_path / "modes.json", tmp_path / "again.csv")[1]
    assert read_modes(tmp_path / "again.csv").mode_shapes.tolist() == [[1.0], [0.5]]


@pytest.mark.parametrize("is_complex", [False, True])
@pytest.mark.parametrize(("first", "second"), [*itertools.product((".json", ".uff", ".csv"), repeat=2)])
def test_modes_there_and_back(tmp_path, first, second, is_complex):
    shapes = np.array([[1.0, 0.25], [-0.5, 1.0], [0.125, -0.75]]) * (1.0 if not is_complex else np.exp(0.5j))
    record = ModalRecord([2.5, 7.25], [0.01, 0.02], shapes, ("1X", "2Y", "3RZ"), scaling="mass")
    write_modes(tmp_path / f"a{first}", record)
    code, out, err = convert(tmp_path / f"a{first}", tmp_path / f"b{second}")
    assert (code, err) == (0, "")
    assert ("digits beyond the sixth" in out) == (second == ".uff")
    assert convert(tmp_path / f"b{second}", tmp_path / "c.json")[0] == 0
    back = read_modes(tmp_path / "c.json")
    assert (list(map(str, back.channels)), back.scaling) == (["1X+", "2Y+", "3RZ+"], "mass")
    np.testing.assert_allclose(back.mode_shapes, shapes, rtol=3e-5, atol=1e-12)
    np.testing.assert_allclose(back.damping_ratio, record.damping_ratio, rtol=2e-5)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("a.op4", "a.op4"), "a.op4: is the file that is read; write to another one"),
        (("a.op4", "there.mtx"), "there.mtx: exists already; add --force to write it anew"),
        (("a.op4", "b.mtx"), "b.mtx: the format holds one matrix, not 2 (MAA, KAA); choose one by its name"),
        (("a.op4", "b.mtx", "--mtx", "labels"), "a.op4: holds 2 matrices, b.mtx one; choose it with --matrix"),
        (("a.op4", "b.pch"), "'MAA' has no node and component of its rows, which DMIG needs"),
        (("a.op4", "b.xyz", "--matrix", "KAA"), "b.xyz: cannot be written; take one of .op4 .pch .mtx .npz .npy .mat"),
        (("a.op4", "b.mat", "--matrix", "KBB"), "holds no matrix 'KBB', only MAA, KAA"),
        (("a.op4", "b.mat", "--matrix", "KAA", "--name", "1K"), "b.mat: '1K' is no name of a MATLAB variable"),
        (("a.op4", "b.mtx", "--name", "K"), "--name is for one matrix, not MAA, KAA; choose one with --matrix"),
        (("a.op4", "b.mtx", "--mtx", "ansys"), "--mtx must be matrixmarket, labels or coordinate, got 'ansys'"),
        (("a.op4", "b.op4", "--dofs", "short.txt"), "short.txt: names 1 rows, 'MAA' has 4"),
        (("a.op4", "b.op4", "--write-dofs", "rows.txt"), "no matrix has node and component of its rows"),
        (("a.op4", "b.mtx", "--sampling-rate", 3), "a.op4: holds matrices; leave out the options of a record, or set --contents"),
        (("a.op4", "b.mtx", "--contents", "mesh"), "--contents must be one of record, matrices, modes, got 'mesh'"),
        (("m.uff", "b.json", "--subcase", 2), "m.uff: --subcase is about files of Nastran; leave it out"),
        (("m.uff", "b.json", "--length-unit", "km/h"), "--length-unit must be one of m km dm cm mm"),
        (("m.uff", "b.f06"), "the suffix '.f06' is of no format for modes"),
        (("m.uff", "none/b.json"), "none does not exist; create it first"),
        (("none.op4", "b.mtx"), "none.op4: there is no such file"),
    ],
)  # fmt: skip
def test_refusals_leave_everything_as_it_was(tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    write_matrices("a.op4", [matrix(rows=None), matrix("KAA", 5 * MASS, None)])
    write_modes("m.uff", ModalRecord([2.0], [0.01], [[1.0], [0.5]], ("1X", "2X")))
    (tmp_path / "there.mtx").write_text("mine")
    (tmp_path / "short.txt").write_text("1X")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    code, out, err = convert(*words)
    assert (code, out) == (2, "")
    assert err.startswith("error: ")
    assert message in err
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_force_writes_anew(tmp_path):
    write_matrices(tmp_path / "a.op4", [matrix(rows=None)])
    (tmp_path / "b.mtx").write_text("old")
    assert convert(tmp_path / "a.op4", tmp_path / "b.mtx", "--force")[0] == 0
    assert read_matrix(tmp_path / "b.mtx").matrix.toarray().tolist() == MASS.tolist()
