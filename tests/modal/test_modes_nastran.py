"""Modes that Nastran printed: listings page by page, punch files, and what is wrong with them."""

import re

import numpy as np
import pytest

from structid import InputError
from structid.core.errors import FileError
from structid.external.outputs import read_shapes
from structid.modal.formats.files import read_modes, write_modes
from structid.modal.formats.nastran import read_modes_nastran
from structid.modal.formats.options import ModeFileOptions

NODES = [1, 2, 15, 101]
FREQUENCY = [0.0, 12.5, 47.25]
SHAPES = np.random.default_rng(7).standard_normal((3, 4, 6)) * 10.0 ** np.random.default_rng(8).integers(
    -3, 3, (3, 4, 6)
)
SHAPES[:, 0] = 0.0  # held
SHAPES[:, :, 2] = 0.0  # in the x-y plane


def listing(nodes=NODES, frequency=FREQUENCY, shapes=SHAPES, page=2, subcase=None):
    """As MSC Nastran prints SOL 103: a table of eigenvalues, and vectors over several pages."""
    title = "1    FRAME WITH LINE 7                         NOVEMBER  23, 2026  MSC.NASTRAN  9/ 9/05   PAGE    10\n0"
    title += "\n" if subcase is None else f"{'SUBCASE':>116s} {subcase}\n"
    text = title + "                                   R E A L   E I G E N V A L U E S\n"
    text += "   MODE    EXTRACTION      EIGENVALUE            RADIANS             CYCLES         GENERALIZED      GENERALIZED\n"
    text += "    NO.       ORDER                                                                  MASS             STIFFNESS\n"
    for k, own in enumerate(frequency, 1):
        omega = 2 * np.pi * own
        five = "".join(f"{x:20.6E}" for x in (omega**2, omega, own, 1.0, omega**2))
        text += f"{k:9d}{k:10d}{five}\n"
    for k, (own, shape) in enumerate(zip(frequency, shapes, strict=True), 1):
        for first in range(0, len(nodes), page):
            text += title + f"      EIGENVALUE = {(2 * np.pi * own) ** 2:13.6E}\n"
            text += f"          CYCLES = {own:13.6E}         R E A L   E I G E N V E C T O R   N O . {k:10d}\n \n"
            text += "      POINT ID.   TYPE          T1             T2             T3             R1           R2           R3\n"
            for node, values in zip(nodes[first : first + page], shape[first : first + page], strict=True):
                # MSC prints zeros as 0.0
                text += (
                    f"{node:14d}      G   "
                    + "".join("   0.0         " if v == 0 else f"{v:15.6E}" for v in values)
                    + "\n"
                )
    return text


def punched(nodes=NODES, frequency=FREQUENCY, shapes=SHAPES, kind="$REAL OUTPUT"):
    """As VECTOR(PUNCH) = ALL writes it: two lines a point, each with its number in columns 73 to 80."""
    lines = []
    for k, (own, shape) in enumerate(zip(frequency, shapes, strict=True), 1):
        lines += ["$TITLE   = FRAME", "$SUBTITLE=", "$LABEL   =", "$EIGENVECTOR", kind, "$SUBCASE ID =           1"]
        lines.append(f"$EIGENVALUE = {(2 * np.pi * own) ** 2:14.7E}  MODE = {k:5d}")
        for node, values in zip(nodes, shape, strict=True):
            lines.append(f"{node:10d}       G" + "".join(f"{v:18.6E}" for v in values[:3]))
            lines.append("-CONT-            " + "".join(f"{v:18.6E}" for v in values[3:]))
    return "".join(f"{line:<72}{number:8d}\n" for number, line in enumerate(lines, 1))


TEXTS = {"modes.f06": listing, "modes.pch": punched, "modes.pun": punched}


@pytest.mark.parametrize("name", TEXTS)
def test_translations_that_move_are_read_from_every_page(tmp_path, name):
    (tmp_path / name).write_text(TEXTS[name]())
    found = read_modes(tmp_path / name)
    assert found.frequency == pytest.approx(FREQUENCY, rel=1e-6)
    assert [str(dof) for dof in found.channels] == ["2X+", "2Y+", "15X+", "15Y+", "101X+", "101Y+"]
    expected = SHAPES[:, 1:, :2].reshape(3, 6).T
    largest = np.abs(expected).argmax(axis=0)
    expected = expected / expected[largest, np.arange(3)]
    assert found.mode_shapes == pytest.approx(expected, rel=2e-6, abs=1e-12)
    assert np.isnan(found.damping_ratio).all()
    assert found.covariance is None
    assert found.source.startswith(f"{name}; ")
    assert "displacement systems of the points taken as global" in found.source
    assert "rotations left out (give `length_unit` to keep them)" in found.source
    # the loop of a solver takes rotations as well, in the unit of its deck
    shapes = read_shapes(tmp_path / name)
    assert shapes.dofs.tolist() == [[node, axis] for node in NODES for axis in range(1, 7)]
    assert shapes.values == pytest.approx(SHAPES.reshape(3, 24).T, rel=1e-6, abs=1e-12)


def test_translations_alone_are_read_whatever_the_columns(tmp_path):
    row = re.compile(r"^( +\d+      G   )(.*)$", re.MULTILINE)
    narrow = row.sub(lambda match: match[1] + "  ".join(match[2].split()[:3]), listing())
    (tmp_path / "narrow.f06").write_text(narrow)
    (tmp_path / "wide.f06").write_text(listing())
    found, expected = (read_modes(tmp_path / name) for name in ("narrow.f06", "wide.f06"))
    assert found.channels == expected.channels
    assert np.array_equal(found.mode_shapes, expected.mode_shapes)


def test_modes_come_in_order_and_other_punched_tables_are_passed_over(tmp_path):
    displacements = "$DISPLACEMENTS\n$REAL OUTPUT\n$SUBCASE ID =   1\n" + punched().split("\n", 8)[8].split("$TITLE")[0]
    (tmp_path / "modes.pch").write_text(punched(frequency=FREQUENCY[::-1]) + displacements)
    found = read_modes(tmp_path / "modes.pch")
    assert found.frequency == pytest.approx(FREQUENCY)
    assert found.mode_shapes[0, 0] / found.mode_shapes[1, 0] == pytest.approx(
        SHAPES[2, 1, 0] / SHAPES[2, 1, 1], rel=2e-6
    )


def test_a_rigid_mode_below_zero_by_rounding_has_no_frequency(tmp_path):
    (tmp_path / "modes.pch").write_text(
        punched().replace("$EIGENVALUE =  0.0000000E+00", "$EIGENVALUE = -3.1000000E-07")
    )
    assert read_modes(tmp_path / "modes.pch").frequency[0] == 0


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.f06", "nothing\n", "holds no eigenvectors of vibration; let the solver print"),
        ("a.pch", "$DISPLACEMENTS\n", "holds no eigenvectors of vibration"),
        ("a.f06", listing() + " *** USER FATAL MESSAGE 9137\n", "line 57: .* USER FATAL MESSAGE 9137; correct the deck"),
        ("a.f06", listing() + " *ERROR  1234: NO MASS\n", "NO MASS; correct the deck"),
        ("a.f06", listing().replace("CYCLES = ", "cycles = "), r"no frequency, as of a buckling analysis; run normal modes \(SOL"),
        ("a.f06", listing().replace("CYCLES =  1.250000E+01", "CYCLES =  1.260000E+01"), "which is not its root over 2 pi"),
        ("a.f06", listing().replace("  1.000000E+00", "           0.0"), "all generalized masses are 0, as of a buckling analysis"),
        ("a.f06", listing(frequency=[5.0, 6.0, 7.0]).replace("EIGENVALUE =  9.869604E+02", "EIGENVALUE = -9.869604E+02"),
         "negative eigenvalue -986.96; the model is unstable"),
        ("a.f06", listing().rstrip()[:-1], "line 56: ends within a row; the file is cut short"),
        ("a.f06", listing().rstrip()[:-3], "line 56: must hold a point and its six motions"),
        ("a.f06", listing().replace("POINT ID.   TYPE", "POINT-ID"), "printed in columns 'POINT-ID T1 T2 T3 R1 R2 R3', not by"),
        ("a.f06", listing() + listing(shapes=2 * SHAPES), "line 72: point 2 is printed twice in mode 1 with different motions"),
        ("a.f06", listing() + listing(frequency=[1.0, 2.0, 3.0]), "mode 1 is printed with the eigenvalues"),
        ("a.f06", listing(subcase=1) + listing(subcase=2), r"modes of 2 runs \(subcase 1; subcase 2\); choose with `subcase`"),
        ("a.f06", listing().replace("    15      G", "    16      G", 1), "has other points than the first"),
        ("a.f06", listing().replace("      G   ", "      S   "), "the vectors hold scalar points only"),
        ("a.pch", "\n".join(punched().split("\n")[:-2]) + "\n", "point 101 of mode 3 has 3 of its 6 numbers; the file is cut"),
        ("a.pch", "\n".join(punched().split("\n")[:-3]) + "\n", "mode 3 has other points than the first; the file is cut"),
        ("a.pch", punched().replace("        15       G", "       1x5       G"), "line 12: '1x5' is no label of a point"),
        ("a.pch", punched().replace("$EIGENVALUE =  0.0", "$EIGENVALUE =  x.0"), "line 7: must hold the eigenvalue and number"),
        ("a.f06", listing(shapes=0 * SHAPES), "a mode has no translation anywhere"),
        ("a.pch", punched(nodes=[1, 2, 2, 101]), "line 12: point 2 is punched twice"),
        ("a.pch", punched(shapes=np.where(np.arange(4)[:, None] == 2, np.nan, SHAPES)), "NaN or infinite at point 15"),
        ("a.f06", listing(shapes=np.where(np.arange(4)[:, None] == 2, np.nan, SHAPES)), "NaN or infinite at point 15"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_named(tmp_path, name, text, words):
    (tmp_path / name).write_text(text)
    with pytest.raises(FileError, match=words):
        read_modes(tmp_path / name)


@pytest.mark.parametrize("end", ["\n", "\n ", "\n   \n\x0c"])
def test_blanks_after_the_last_row_do_not_cut_a_listing_short(tmp_path, end):
    (tmp_path / "modes.f06").write_text(listing().rstrip() + end)
    assert read_modes(tmp_path / "modes.f06").n_modes == len(FREQUENCY)


@pytest.mark.parametrize("kind", ["F", "B"])
def test_modes_of_calculix(tmp_path, kind):
    """As CalculiX writes *FREQUENCY, and *BUCKLE, which are no modes."""
    rows = "".join(
        f" -1{n:10d}" + "".join(f"{v:12.5E}" for v in own[:3]) + "\n" for n, own in zip(NODES, SHAPES[1], strict=True)
    )
    name = "1MODAL      1" if kind == "F" else "1           1"
    head = (
        f"    1PGM                4.000000E+00\n  100CL  101 12.50000000           4                     2    {name}\n"
    )
    text = head + " -4  DISP        4    1\n -5  D1          1    2    1    0\n" + rows + " -3\n 9999\n"
    (tmp_path / "a.frd").write_text(text)
    if kind == "B":
        with pytest.raises(FileError, match=r"a\.frd: holds no modes of vibration with displacements; run \*FREQUENCY"):
            read_modes(tmp_path / "a.frd")
        return
    record = read_modes(tmp_path / "a.frd", ModeFileOptions(length_unit="mm", force_unit="N"))
    assert (record.frequency.tolist(), record.scaling) == ([12.5], "mass")
    expected = SHAPES[1, 1:, :2].ravel() / np.sqrt(4000.0)  # a modal mass of 4 t
    assert record.mode_shapes[:, 0] == pytest.approx(expected, rel=2e-5)
    assert read_shapes(tmp_path / "a.frd").values[:, 0] == pytest.approx(
        SHAPES[1, :, :3].ravel() / 2, rel=2e-5, abs=1e-12
    )
    (tmp_path / "a.frd").write_text(text.replace(" 9999\n", ""))
    with pytest.raises(FileError, match="has no last line 9999; the file is cut short"):
        read_modes(tmp_path / "a.frd")


def test_binary_results_are_refused_with_what_to_do(tmp_path):
    (tmp_path / "a.op2").write_bytes(b"\0" * 8)
    with pytest.raises(FileError, match=r"a\.op2: does not begin as a binary file of Nastran's results does"):
        read_modes(tmp_path / "a.op2")


def test_nothing_is_written_as_nastran_does(tmp_path):
    (tmp_path / "modes.pch").write_text(punched())
    found = read_modes_nastran(tmp_path / "modes.pch")
    with pytest.raises(
        InputError, match=r"suffix '.f06' is of no format for modes; use one of .json .uff .unv .uf .csv"
    ):
        write_modes(tmp_path / "other.f06", found)
