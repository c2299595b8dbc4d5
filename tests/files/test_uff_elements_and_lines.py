"""Descriptors of universal elements, and lines of texts in other encodings."""

from pathlib import Path

import pytest

from structid.core.errors import FileError
from structid.files.uff.datasets import UffDataset
from structid.files.uff.geometry import _BESIDE, _CELLS, read_elements


def test_membranes_number_their_cells_the_other_way():
    """Dataset 2412: 71 is a linear quadrilateral and 74 a linear triangle, in all other families 1 and 4 the other way."""
    assert [_CELLS[70 + k] for k in (1, 2, 4, 5)] == ["quad", "triangle6", "triangle", "quad8"]
    for base in (40, 50, 60, 90):
        assert [_CELLS[base + k] for k in (1, 2, 4, 5)] == ["triangle", "triangle6", "quad", "quad8"]


def test_springs_dampers_and_gaps_have_their_names():
    names = {
        136: "spring between nodes",
        139: "rotational spring to ground",
        142: "damper to ground",
        151: "gap between nodes",
    }
    assert {number: _BESIDE[number] for number in names} == names


def test_a_text_of_another_encoding_has_the_lines_of_its_line_ends_only():
    content = "first … 1\r\nsecond\x0b 2\nthird µ\n".encode("cp1252")
    assert len(UffDataset(1, 58, "    58", content).lines) == 3
    assert UffDataset(1, 58, "    58", "a\u2028b\nc".encode()).lines == ["a\u2028b", "c"]


def test_a_line_with_a_node_in_its_middle_as_salome_writes_it():
    """Salome gives curved lines the descriptor of tapered beams, with three nodes."""

    def rows(*nodes):
        lines = [f"{7:10d}{22:10d}{1:10d}{1:10d}{7:10d}{len(nodes):10d}", f"{0:10d}{1:10d}{1:10d}"]
        text = "\n".join([*lines, "".join(f"{n:10d}" for n in nodes), ""])
        return read_elements(Path("a.unv"), [UffDataset(1, 2412, "  2412", text.encode())]).nodes

    assert rows(1, 3, 2) == {"line3": [[1, 2, 3]]}
    assert rows(1, 2) == {"line": [[1, 2]]}
    with pytest.raises(FileError, match="has 4 nodes instead of 2"):
        rows(1, 2, 3, 4)
