"""Descriptors of universal elements, and lines of texts in other encodings."""

from structid.files.uff.blocks import Block
from structid.files.uff.elements import _BESIDE, _CELLS


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
    assert len(Block(1, 58, "    58", content).lines) == 3
    assert Block(1, 58, "    58", "a\u2028b\nc".encode()).lines == ["a\u2028b", "c"]
