"""Ranges in a text are compared with what can be, before they fill memory."""

import pytest

from structid.core.errors import FileError
from structid.fem.importers import read_numbering
from structid.fem.meshes import read_mesh


def test_sets_of_nastran_and_abaqus_have_a_longest_range(tmp_path):
    (tmp_path / "dofs.pch").write_text("ASET1   12      1       THRU    99999999\n")
    with pytest.raises(FileError, match="from 1 to 99999999 is too long"):
        read_numbering(tmp_path / "dofs.pch")
    mesh = "*NODE\n1, 0, 0\n2, 1, 0\n*NSET, NSET=a, GENERATE\n1, 999999999999, 1\n*ELEMENT, TYPE=B31\n1, 1, 2\n"
    (tmp_path / "a.inp").write_text(mesh)
    with pytest.raises(FileError, match=r"line 4: .* from 1 to 999999999999 has more than"):
        read_mesh(tmp_path / "a.inp")
