"""Files of modes by an independent writer, over the variations of header that the formats allow: each is read right or refused."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from fuzz.true_modes import MAKERS, run

from structid.core.errors import FileError
from structid.modal.formats.files import read_modes

FIELD = Path(__file__).parent / "field_files"


def test_no_variation_of_a_header_is_read_wrongly(tmp_path):
    counts, bad = run("suite", 240, tmp_path)
    assert bad == []
    outcomes = Counter(outcome for _, outcome in counts.elements())
    assert outcomes["right"] > 150
    assert outcomes["refused"] > 20
    assert len({name for name, _ in counts}) >= 9 > len(MAKERS)


@pytest.mark.parametrize(
    ("name", "frequency", "scaling", "shape", "words"),
    [
        ("m_react.unv", 10.0, "unit_largest", {"1Z+": 1.0, "2Z+": -0.5}, "left out: reaction force"),
        ("m_rot_mm.unv", 10.0, "unit_largest", {"1Z+": 0.5, "1RY+": 1.0, "2Z+": -0.25, "2RY+": 0.5}, ""),
        ("m_mmN.unv", 10.0, "mass", {"1Z+": 4000**-0.5, "2Z+": -0.5 * 4000**-0.5}, ""),
        ("m_cplx_acc.unv", abs(-1 + 62.8319j) / (2 * np.pi), "mass", {"1Z+": 1 + 0.1j, "2Z+": -0.5 + 0.05j}, "taken as SI"),
        ("m_wide.unv", 10.0, "unit_largest", {"1Z+": 1.0, "60101Z+": -0.5}, ""),
        ("one_spcf.f06", 10.0, "unit_largest", {"2Z+": 0.5, "3Z+": 1.0}, "displacement systems of the points taken as global"),
    ],
)  # fmt: skip
def test_files_of_the_field(name, frequency, scaling, shape, words):
    record = read_modes(FIELD / name)
    assert record.frequency == pytest.approx([frequency], rel=1e-6)
    assert record.scaling == scaling
    assert {str(dof): row[0] for dof, row in zip(record.channels, record.mode_shapes, strict=True)} == {
        name: pytest.approx(value, abs=5e-6) for name, value in shape.items()
    }
    assert words in record.source


def test_strains_are_no_modes():
    with pytest.raises(FileError, match=r"m_strain\.unv: holds no modes .*; it holds strain; export the mode shapes"):
        read_modes(FIELD / "m_strain.unv")
